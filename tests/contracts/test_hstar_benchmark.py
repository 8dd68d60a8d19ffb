"""H*Bench as a benchmark: its files as published, the contract, its agents, and models that talk."""

import math
import random
import shutil
from pathlib import Path

import hstar_data
import msgspec
import numpy as np
import pytest
from PIL import Image

from eagor.errors import EagorError, FormatError
from eagor.grids import PerspectiveGrid
from eagor.lab.tasks.hstar import View, open_panorama, parse_action, render_view, system_text, turn_text
from eagor.lab.tasks.hstar.agents import VlmAgent, open_detector
from eagor.lab.tasks.hstar.bench import CAUSES, HOS, HPS, cause_of, read_episodes, run_episode, tag_of
from eagor.lab.tasks.published import head_of, phrase_of, thing_of
from eagor.lab.tasks.task import check_task, configure
from eagor.perception import load
from eagor.perception.partial import infer_view
from eagor.perception.vlm import IMAGE, ChatReply

MINI = Path(__file__).parents[2] / ".." / "shared" / "bench_samples" / "hstar_mini"


def config(folder, **more):
    return configure(HOS, {"data": str(folder), "agent": "oracle"} | more)


def played(folder, **more):
    settings = config(folder, **more)
    do = HOS.runner(settings)
    return [do(sample.payload) for sample in HOS.samples(settings)]


# Files


def ids(folder, kind="hos"):
    return [episode.id for episode in read_episodes(folder, kind)]


def test_the_order_is_the_published_shuffle_also_in_nested_folders(tmp_path):
    plain = hstar_data.write(tmp_path / "plain")
    nested = hstar_data.write(tmp_path / "nested", split="download/hos_bench/hos_bench")
    order = [f"{s}/{e}/{y}" for s in ("hall", "shop") for e in (0, 1) for y in (0, 90, 180, 270)]
    random.Random(42).shuffle(order)
    assert ids(plain) == ids(plain / "hos_bench") == ids(nested) == order


def test_what_is_missing_in_the_annotations_is_filled_in_or_told(tmp_path):
    folder = hstar_data.write(tmp_path, strip=("initial yaw", "level"))
    found = {episode.id: episode for episode in read_episodes(folder, "hos")}
    assert len(found) == 16
    assert found["hall/0/0"].level == "medium"  # 10 of its 30 degrees are in the first view
    assert found["shop/0/0"].level == "easy"
    assert found["hall/0/180"].level == "hard"


def test_paths_have_no_pitch_and_no_place_among_objects(tmp_path):
    folder = hstar_data.write(tmp_path, "hps_bench", paths=True, suffix="jpg")
    assert len(ids(folder, "hps")) == 16
    with pytest.raises(FormatError, match="not HOS data"):
        read_episodes(folder, "hos")
    hstar_data.write(tmp_path, "hos_bench")
    assert len(ids(folder)) == len(ids(folder, "hps")) == 16


def test_other_endings_are_skipped_as_published_and_told(tmp_path):
    folder = hstar_data.write(tmp_path)
    hall = folder / "hos_bench" / "hall"
    for ending in ("PNG", "jpeg", "JPG"):
        (hall / "pano.png").rename(hall / f"pano.{ending}")
        assert {episode.scene for episode in read_episodes(folder, "hos")} == {"shop"}
        (hall / f"pano.{ending}").rename(hall / "pano.png")
    (hall / "pano.png").rename(hall / "pano.PNG")
    assert ["hall" in each for each in HOS.info(folder)["skipped"]] == [True]
    shutil.rmtree(folder / "hos_bench")
    hall.mkdir(parents=True)
    (hall / "annotation.json").write_text("[]")
    with pytest.raises(FormatError, match=r"lower case.*hall has annotation\.json, but no such picture"):
        read_episodes(folder, "hos")


def test_a_picture_is_turned_by_its_orientation_tag_even_onto_its_side(tmp_path):
    """As published; other panoramas of ours lie, whatever their tag says."""
    folder = hstar_data.write(tmp_path)
    whole = Image.fromarray(hstar_data.panorama(hstar_data.TARGETS["hall"]))
    tag = Image.Exif()
    tag[0x0112] = 6  # to be shown turned to the right: stored turned to the left
    whole.transpose(Image.Transpose.ROTATE_90).save(folder / "hos_bench" / "hall" / "pano.png", exif=tag)
    episode = next(each for each in read_episodes(folder, "hos") if each.scene == "hall")
    assert np.array_equal(open_panorama(episode.panorama), np.asarray(whole))


def test_a_perception_is_not_shown_the_cross(tmp_path):
    episode = read_episodes(
        hstar_data.write(tmp_path, targets={"hall": {"red": ([170.0, 190.0], [-5.0, 5.0])}}), "hos"
    )[0]
    asked = msgspec.structs.replace(episode, item=episode.item | {"task": "Find the green square"})
    perception = load("colour")
    view = View(0.0, 0.0)
    drawn = render_view(open_panorama(asked.panorama), 0.0, 0.0, 54)
    ahead = PerspectiveGrid(54, drawn.shape[1], math.radians(100))
    assert infer_view(perception, drawn, ahead, "green square").response.max() > 0.5
    seen = open_detector(perception, asked, 0, 54)(view).evidence
    assert seen.response.max() < 0.2


# The contract


@pytest.mark.parametrize("task", [HOS, HPS], ids=["objects", "paths"])
def test_the_contract_holds(tmp_path, task):
    folder = hstar_data.write(tmp_path, f"{task.name[-3:]}_bench", paths=task is HPS)
    assert [record["score"] for record in check_task(task, data=str(folder), agent="oracle")] == [1.0] * 16


@pytest.mark.skipif(not MINI.exists(), reason="the shared samples are not here")
def test_the_oracle_finds_everything_in_the_shared_samples():
    found = check_task(HOS, data=str(MINI), agent="oracle")
    assert len(found) == 44
    assert all(record["scores"] == {"official": 1.0, "strict": 1.0} for record in found)
    assert {record["level"] for record in found} == {"easy", "medium", "hard"}


def test_what_cannot_be_played_is_refused_before_anything_is_played(tmp_path):
    folder = hstar_data.write(tmp_path)
    for more, words in (
        ({"agent": "nobody"}, "no agent 'nobody'"),
        ({"agent": "eagor"}, "needs a perception"),
        ({"agent": "vlm"}, "--model"),
        ({"agent": "vlm", "model": "hstar_data:missing"}, "missing"),
        ({"turns": 0}, "turns = 0: Expected `int` >= 1 .views at most"),
        ({"agent": "vlm", "model": "llava:latest"}, "or llava:latest@http://localhost:11434 for a model on a server"),
        (
            {"agent": "vlm", "model": "hstar_data:panorama"},
            "wanted a function without arguments that returns the model",
        ),
        ({"agent": "sweep", "perception": "truth:miss=2"}, "miss"),
    ):
        with pytest.raises(EagorError, match=words):
            config(folder, **more)


@pytest.mark.parametrize("agent", ["eagor", "sweep", "grid", "centroid"])
def test_agents_that_look_find_everything_with_an_ideal_eye(tmp_path, agent):
    found = played(hstar_data.write(tmp_path), agent=agent, perception="truth:ideal", scoring="strict")
    assert np.mean([record["score"] for record in found]) >= 0.9
    for record in found:
        assert len(record["by_turn"]) == 10
        assert 1 <= record["views"] == len(record["steps"]) <= 10
        assert record["by_turn"][-1] == record["score"]
        assert record["score"] == 1 or record["cause"] in CAUSES


def test_pictures_are_looked_at_through_any_perception(tmp_path):
    """From pixels: the colour perception knows panoramas only, and is shown views."""
    folder = hstar_data.write(tmp_path)
    settings = config(folder, agent="eagor", perception="colour", resolution=270, scoring="strict")
    do = HOS.runner(settings)
    found = [do(each.payload) for each in HOS.samples(settings) if each.id.endswith("/90")]  # one start each
    assert [record["score"] for record in found] == [1.0] * 4
    assert np.mean([record["views"] for record in found]) < 7


# Words and causes


@pytest.mark.parametrize(
    ("task", "thing", "phrase", "head"),
    [
        ("Find the TCL TV", "TCL TV", "TCL TV", "tv"),
        ("Find the vase of flowers on the cabinet", "vase of flowers on the cabinet", "vase", "vase"),
        ("find a red chair.", "red chair", "red chair", "chair"),
        ("Go to the exit", "exit", "exit", "exit"),
        ("Find the dreamcatchers on the wall", "dreamcatchers on the wall", "dreamcatchers", "dreamcatcher"),
    ],
)
def test_tasks_are_taken_apart(task, thing, phrase, head):
    assert (thing_of(task), phrase_of(task), head_of(task)) == (thing, phrase, head)


def test_tags_are_given_in_order():
    def item(task, yaw=(10, 30), pitch=(0, 20)):
        return {"task": task, "yaw": list(yaw), "pitch": list(pitch)}

    assert tag_of(item("Find the TCL TV")) == "ocr_fine"
    assert tag_of(item("Find the sign that says exit")) == "ocr_fine"
    assert tag_of(item("Find the chair", (10, 12), (0, 3))) == "ocr_fine"
    assert tag_of(item("Find the red chair"), [item("Find the blue chair")]) == "multi_instance"
    assert tag_of(item("Find the theodolite")) == "rare"
    assert tag_of(item("Find the red chair"), [item("Find the table")]) == "plain"


def test_causes_are_told_apart():
    item = {"task": "Find the red chair", "yaw": [0, 20], "pitch": [0, 20]}
    twin = {"task": "Find the blue chair", "yaw": [180, 200], "pitch": [0, 20]}

    def step(shown=1.0, peak=None, would=False, **more):
        found = {"shown": shown, "would": {"official": would, "strict": would}, **more}
        return found | ({"peak": {"yaw": peak[0], "pitch": peak[1], "score": peak[2]}} if peak else {})

    def cause(steps, answer=(90, 0), others=()):
        return cause_of(item, steps, answer, others, "official")

    assert cause([step()], (190, 10), [twin]) == "wrong_instance"
    assert cause([step(would=True), step()]) == "stopped_wrongly"
    assert cause([step(0.0, (90, 0, 0.9))]) == "never_in_view"
    assert cause([step(0.5, (10, 10, 0.9)), step(0.0, (90, 0, 0.5))]) == "fusion_error"
    assert cause([step(0.5, (90, 0, 0.9))]) == "false_detection"
    assert cause([step(0.5, (200, 0, 0.9))]) == "missed"
    assert cause([step(0.5, (10, 10, 0.1))]) == "missed"


# Models that talk


def episode_of(tmp_path, scene="hall", start=0):
    found = read_episodes(hstar_data.write(tmp_path), "hos")
    return next(e for e in found if e.cluster == f"{scene}/0" and e.start == start)


class Scripted:
    """A model that says what it was given, and keeps what it was shown."""

    def __init__(self, *texts):
        self.texts, self.seen = list(texts), []

    def __call__(self, messages):
        self.seen.append(list(messages))
        return ChatReply(self.texts.pop(0), 100, 10)


def test_a_model_turns_is_told_where_it_looks_and_submits(tmp_path):
    chat = Scripted(
        "<think>left</think><answer>rotate(50,0)</answer>",
        "hm",
        "<answer>submit(55,-3)</answer>",
    )
    record = run_episode(episode_of(tmp_path), VlmAgent(episode_of(tmp_path), chat, 5, 90), "strict")
    assert (record["score"], record["views"], record["reason"]) == (1.0, 3, "submitted")
    assert [step["action"] for step in record["steps"]] == ["rotate(50,0)", None, "submit(55,-3)"]
    assert [step["valid"] for step in record["steps"]] == [True, False, True]
    assert record["by_turn"] == [0, 1, 1, 1, 1, 1, 1, 1, 1, 1]  # it looks at the target from the second turn on
    system, first, reply, second = chat.seen[1]
    assert (system.role, first.role, reply.role, second.role) == ("system", "user", "assistant", "user")
    assert "Human Instruction: Find the red square" in first.text
    assert "(50,0)" in second.text
    assert "['rotate(50,0)']" in second.text
    assert "not executed successfully" in chat.seen[2][-1].text
    assert first.text.count(IMAGE) == len(first.images) == 1
    assert not np.array_equal(first.images[0], second.images[0])


def test_a_model_that_never_submits_runs_out_of_turns_or_of_form(tmp_path):
    for text, reason in (("<answer>rotate(10,0)</answer>", "budget"), ("no idea", "format")):
        chat = Scripted(*[text] * 10)
        record = run_episode(episode_of(tmp_path), VlmAgent(episode_of(tmp_path), chat, 5, 36))
        assert (record["score"], record["views"], record["reason"], record["cause"]) == (0.0, 10, reason, reason)


def test_the_model_is_shown_a_window_of_the_conversation(tmp_path):
    chat = Scripted(*["<answer>rotate(10,0)</answer>"] * 10)
    run_episode(episode_of(tmp_path), VlmAgent(episode_of(tmp_path), chat, 2, 36))
    assert max(map(len, chat.seen)) == 4  # the system message and 2 * window - 1 others
    assert all(messages[0].role == "system" and messages[-1].role == "user" for messages in chat.seen)


@pytest.mark.parametrize("kind", ["hos", "hps"])
def test_prompts_say_what_the_protocol_dictates(kind):
    text = system_text(kind)
    for part in ("rotate(yaw:int,pitch:int)", "submit(yaw:int,pitch:int)", "<answer>", "green cross"):
        assert part in text
    assert str(parse_action(text.rpartition("e.g. ")[2]).action) == "rotate(-45,0)"
    assert turn_text("Find it", View(0.0, 0.0), None).startswith(
        f"[initial observation]:\n{IMAGE}\nHuman Instruction: Find it\n"
    )
