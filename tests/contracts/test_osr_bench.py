"""OSR-Bench keeps the contract of benchmarks, over a scene that is made here, and over the shared samples."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import osr_data
import pytest

from eagor.errors import FormatError
from eagor.lab.tasks.osr import DIRECTION, MAP, SUFFIXES
from eagor.lab.tasks.osr import load as load_scenes
from eagor.lab.tasks.osr.bench import Eagor, Reply, Vlm, record_of, seen_layout
from eagor.lab.tasks.osr.geometry import Detection, SceneLayout, place
from eagor.lab.tasks.task import check_task, configure, load
from eagor.perception.vlm import IMAGE, ChatReply, Message

SAMPLES = Path(__file__).parents[2] / ".." / "shared" / "bench_samples"
NAME, PLACES = osr_data.NAME, osr_data.PLACES


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A scene in the published layout, with its true places; one label is empty."""
    return osr_data.write(tmp_path)


def config(data: Path, **settings: Any) -> Any:
    return configure(load("osr"), {"data": str(data), **settings})


def played(data: Path, **settings: Any) -> list[Any]:
    """The records of our agent, which sees the true places."""
    found = config(data, agent="oracle", **settings)
    agent = Eagor(osr_data.true_layout, "negative" in found.suffix)
    scenes = load_scenes(data, found.suffix)
    return [record_of(scene, q, agent(scene, q), found) for scene in scenes for q in scene.questions]


def figure(records: Sequence[dict[str, Any]], key: str) -> float | None:
    read = next(metric.read for metric in load("osr").metrics if metric.key == key)
    values = [value for record in records if (value := read(record)) is not None]
    return float(np.mean(values)) if values else None


@pytest.mark.skipif(not SAMPLES.exists(), reason="the shared benchmark samples are not here")
def test_the_contract_holds_over_the_published_samples() -> None:
    check_task(load("osr"), data=str(SAMPLES), agent="oracle")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_kind_of_file_is_read_and_empty_labels_are_not_asked(data: Path, suffix: str) -> None:
    (scene,) = load_scenes(data, suffix)
    assert scene.skipped == 1
    assert not any(question.id.endswith("/99") for question in scene.questions)
    assert (scene.map_question is None) == suffix.endswith("without_cogmap")
    assert scene.image.is_file()


def test_true_places_answer_with_the_corrected_labels_and_not_with_the_published_ones(data: Path) -> None:
    records = played(data, labels="both", suffix="qa")
    # Four answers at most are exact: those on a border of cells cannot be known.
    clear = [r for r in records if "clear" in r["tags"] and "tied" not in r["tags"]]
    assert len(clear) >= 4
    assert all(record["scores"]["corrected"] == 1 for record in clear)
    wrong = [record for record in clear if record["answer"] not in ("Front", "Back")]
    assert wrong
    assert all(r["scores"]["official"] == 0 and r["cause"] == "left and right exchanged" for r in wrong)
    assert figure(records, "counting") == 1
    mapped = next(record for record in records if record["skill"] == MAP)
    assert mapped["scores"]["corrected"] == 1 > mapped["scores"]["official"]


def test_errors_are_answered_only_where_something_may_be_absent(data: Path) -> None:
    negative = played(data, suffix="qa_with_negative_without_cogmap")
    absent = [record for record in negative if "absent" in record["tags"]]
    assert absent
    assert {record["score"] for record in absent} == {1.0}


@pytest.mark.parametrize(("suffix", "turns"), [("qa_without_cogmap", 1), ("qa", 3)])
def test_the_model_is_asked_with_the_map_and_without(data: Path, suffix: str, turns: int) -> None:
    heard: list[list[Message]] = []

    def model(messages: Sequence[Message]) -> ChatReply:
        heard.append(list(messages))
        return ChatReply('{"tv": [[5, 0]]}' if "[Task]" in messages[-1].text else "Front Left")

    (scene,) = load_scenes(data, suffix)
    agent = Vlm(model)
    asked = [question for question in scene.questions if question.skill == DIRECTION]
    assert {agent(scene, question).text for question in asked} == {"Front Left"}
    assert len(heard) == len(asked) + (turns > 1)  # the map is asked for once
    last = heard[-1]
    assert [message.role for message in last] == ["user", "assistant", "user"][:turns]
    assert sum(len(message.images) for message in last) == 1
    assert last[0].text.count(IMAGE) == 1
    assert asked[-1].text in last[-1].text


def test_the_prompt_that_asks_for_thoughts_reads_the_answer_between_tags(data: Path) -> None:
    (scene,) = load_scenes(data, "qa")
    question = next(question for question in scene.questions if question.skill == DIRECTION)
    reply = Reply(f"<think>hm</think><answer>{question.answer}</answer>")
    think, plain = (config(data, agent="oracle", prompt=form, suffix="qa") for form in ("think", "vanilla"))
    assert record_of(scene, question, reply, think)["score"] == 1
    assert record_of(scene, question, reply, plain)["cause"] == "format"


def test_predictions_from_elsewhere_are_judged(data: Path) -> None:
    task: Any = load("osr")
    settings = config(data, agent="oracle")
    sample = task.samples(settings)[0]
    for key in ("text", "answer", "model_answer"):
        assert task.score(sample, {key: "1"}, settings)["case"] == sample.id
    with pytest.raises(FormatError, match="wanted"):
        task.score(sample, {"score": 1}, settings)


def test_the_hosted_table_is_read_as_the_files_are(data: Path, tmp_path: Path) -> None:
    (scene,) = load_scenes(data, "qa")
    with (tmp_path / "qa.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["image_id", "turn_id", "question", "answer"])
        for question in scene.questions:
            table.writerow([f"data/{NAME}/rgb.png", question.id.rpartition("/")[2], question.text, question.answer])
    (found,) = load_scenes(tmp_path, "qa")
    assert [(q.id, q.skill, q.answer) for q in found.questions] == [(q.id, q.skill, q.answer) for q in scene.questions]


def test_a_belief_sees_what_a_detector_boxes_and_ranges_it_by_its_foot(data: Path) -> None:
    from eagor.evidence import Evidence
    from eagor.grids import ErpGrid

    grid = ErpGrid(512, 1024)

    def detector(panorama: np.ndarray, query: str, *, stamp: float | None = None) -> Evidence:
        boxes = []
        for x, y in PLACES.get(query, []):
            azimuth, away = np.arctan2(y, x), np.hypot(x, y)
            middle, half = 512 - azimuth / np.pi * 512, np.arcsin(0.2 / away) / np.pi * 512
            top, foot = (256 + np.arctan2(1.5 - z, away - 0.2) / np.pi * 512 for z in (0.7, 0.0))
            boxes.append([middle - half, top, middle + half, foot])
        return Evidence.from_boxes(np.array(boxes), grid, stamp=stamp)

    (scene,) = load_scenes(data, "qa")
    agent = Eagor(lambda scene: seen_layout(detector, lambda evidence: evidence, scene))
    around = agent.around(scene)
    assert sorted(each.name for each in around.placed) == sorted(n for n, where in PLACES.items() for _ in where)
    for each in around.placed:
        assert min(np.hypot(*np.subtract(each.xy, xy)) for xy in PLACES[each.name]) < 0.9
    asked = [question for question in scene.questions if question.skill == DIRECTION]
    assert np.mean([agent(scene, q).text == q.truth("corrected") for q in asked]) >= 0.6


def test_what_is_not_seen_is_guessed_and_said_so(data: Path) -> None:
    (scene,) = load_scenes(data, "qa")
    twice = tuple(Detection(name, 0.3 + k, -0.3, bottom=-0.4) for k, name in enumerate(["tv", "tv", "sofa", "sofa"]))
    for things in ((), twice, twice[:1]):
        agent = Eagor(lambda scene, things=things: SceneLayout(place(things, 1.5)))
        for question in scene.questions:
            reply = agent(scene, question)
            if question.skill == DIRECTION and not {"tv", "sofa"} >= set(question.names):
                assert reply.text in ("Front Left", "Front Right")
                assert reply.notes["problem"].startswith("not seen")


def test_what_is_no_such_data_says_so(tmp_path: Path, data: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(FormatError, match="is it OSR-Bench"):
        load_scenes(empty)
    path = next(data.rglob("*_qa.json"))
    path.write_text('{"conversation": [{"question": "Why?", "answer": "so"}]}')
    with pytest.raises(FormatError, match="known are"):
        load_scenes(data, "qa")


def test_turns_without_numbers_and_counts_that_are_numbers_are_read(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    turns = [
        {"question": osr_data.counting("chair"), "answer": 0},
        {"question": osr_data.counting("table"), "answer": "2"},
    ]
    (tmp_path / "room" / "room_qa.json").write_text(json.dumps({"conversation": turns}))
    (scene,) = load_scenes(tmp_path, "qa")
    assert [(question.id, question.answer) for question in scene.questions] == [("room/qa/0", "0"), ("room/qa/1", "2")]
