"""Readers of benchmarks' files and of what models answer: a right value, or an error with a name."""

import json
import math

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mutations import as_text, damaged, reads, trees
from strategies import HOSTILE

from eagor._checks import parsed
from eagor.lab.eval import log
from eagor.lab.tasks.hstar import Episode, View, normalised, parse_action, submit_succeeds
from eagor.lab.tasks.hstar.bench import HOS, read_data
from eagor.lab.tasks.osr import SKILLS, load, score, steps
from eagor.lab.tasks.task import Sample, read_config
from eagor.perception.vlm.answers import parse_boxes, parse_presence

ANNOTATION = [
    {"task": "Find the red square", "yaw": [40.0, 70.0], "pitch": [-15, 10], "initial yaw": [0, 90], "level": [0, 1]},
    {"task": "Find the way out", "yaw": [345.0, 20.0], "initial yaw": [0], "level": 2},
]
MAP = [[["sofa"], [], ["chair", "chair"]], [[], ["table"], []], [[], [], []]]
QUESTIONS = {
    "image_id": "data/scene/rgb.png",
    "conversation": [
        {"turn_id": 0, "question": "Draw the map in this scene: {sofa, chair}.", "answer": MAP,
         "skills_tested": "cognitive_map"},
        {"turn_id": 1, "question": "How many chair(s) are in this room?", "answer": "2"},
        {"turn_id": 2, "question": "If I am standing by the sofa and facing the closest table, is the closest chair to "
         "my front, back?", "answer": "Front Left"},
        {"turn_id": 3, "question": "which of these objects (sofa, table) is the closest to the chair in this PANORAMA?",
         "answer": "table", "skills_tested": "relative_distance"},
    ],
}  # fmt: skip
ANSWERS = [
    '```json\n[{"bbox_2d": [100, 150, 220, 310], "label": "chair", "score": 0.9}]\n```',
    "<think>it is (left)</think> There is no chair in the image.",
    "<box>(12,30),(40,80)</box> and {'xmin': 3, \"ymin\": 4, xmax: 50, ymax: 60, // here\n}",
    "[[1, 2, 3, 4], [5, 6, 7",
    "<think><observation>a</observation><reasoning>b</reasoning></think><answer>rotate(90,-10)</answer>",
    "<think>hm</think>\n<answer>submit(12, 3) | rotate(1,1)</answer>",
    "The answer is <answer>Front-Left</answer>, 7 chairs.",
    '{"sofa": [[1, 2]], "chair": [[3, 4], [9, 9]]}',
]
words = st.one_of(
    st.text(max_size=200),
    damaged([answer.encode() for answer in ANSWERS], most=4).map(lambda data: data.decode("utf-8", "replace")),
    st.lists(st.sampled_from([*ANSWERS, "<think>", "</think>", "<answer>", "</answer>", "no ", "[", "{", "1" * 5000,
                              "(", ": ", "submit(", "rotate(", ",0)", "-1e400", "\0"]), max_size=12).map("".join),
)  # fmt: skip


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A folder with one scene of each benchmark, to be overwritten."""
    home = tmp_path_factory.mktemp("data")
    for name in ("hall", "scene"):
        (home / name).mkdir()
    (home / "hall" / "pano.png").write_bytes(b"not looked at")
    (home / "scene" / "rgb.png").write_bytes(b"not looked at")
    return home


def json_of(valid):
    return st.one_of(
        trees([valid]).map(lambda tree: as_text(tree).encode("utf-8", "surrogatepass")),
        damaged([json.dumps(valid).encode()]),
    )


def _object(line):
    """The object in a line of predictions, None where there is none."""
    try:
        found = parsed(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


@HOSTILE
@given(json_of(ANNOTATION))
@example(json.dumps([ANNOTATION[0] | {"level": -1}]).encode())
@example(json.dumps([ANNOTATION[0] | {"yaw": "12"}]).encode())
@example(json.dumps([ANNOTATION[0] | {"initial yaw": "90"}]).encode())
@example(b'[{"task": "Find it", "yaw": [1, 2], "initial yaw": [NaN]}]')
def test_annotations(data, blob):
    (data / "hall" / "annotation.json").write_bytes(blob)
    for episode in (reads(lambda: read_data(data / "hall"), "annotation.json") or ([],))[0]:
        assert math.isfinite(episode.start)
        assert all(0 <= normalised(yaw) <= 360 for yaw in episode.item["yaw"])
        assert msgspec.convert(msgspec.to_builtins(episode), type(episode)) == episode
        submit_succeeds(episode.item, 3, 4)


@HOSTILE
@given(json_of(QUESTIONS))
def test_questions(data, blob):
    path = data / "scene" / "scene_qa.json"
    path.write_bytes(blob)
    for scene in reads(lambda: load(data / "scene", "qa"), "scene") or ():
        assert all(question.skill in SKILLS for question in scene.questions)
        layout = reads(lambda scene=scene: scene.layout)
        for question in scene.questions:
            assert question.names is not None
            said = question.answer if isinstance(question.answer, str) else "x"
            result = reads(lambda question=question, said=said: score(question.skill, question.answer, said))
            assert result is None or 0 <= result <= 1
            if layout:
                reads(lambda layout=layout: steps(layout, "sofa", "table", "chair"))


@HOSTILE
@given(damaged([b"image_id,turn_id,question,answer,skills_tested\ndata/scene/rgb.png,1,How many chair(s) are in this "
                b"room?,2,\ndata/scene/rgb.png,2,Draw,\"[[['sofa']], [[]]]\",cognitive_map\n"]))  # fmt: skip
def test_tables_of_questions(data, blob):
    folder = data / "tables"
    folder.mkdir(exist_ok=True)
    (folder / "qa.csv").write_bytes(blob)
    reads(lambda: load(folder, "qa"), "tables")


@HOSTILE
@given(words)
@example("1" * 5000)
@example("<answer>submit(" + "1" * 4000 + ",0)</answer>")
@example("<think>" + "</think><answer>" * 3000)
@example("no " * 10_000)
@example("[{(" * 3000)
def test_answers(text):
    for frame, order in (("pixels", "xyxy"), ("thousand", "yxyx"), ("unit", "xyxy")):
        boxes = reads(
            lambda frame=frame, order=order: parse_boxes(text, frame, (480, 640), order), "the model answered"
        )
        for box in boxes or ():
            assert 0 <= box.x0 < box.x1 <= 1
            assert 0 <= box.y0 < box.y1 <= 1
            assert 0 <= box.score <= 1
    said = reads(lambda: parse_presence(text))
    assert said is None or 0 <= said <= 1
    action = parse_action(text).action
    if action is not None:
        view = View(12.5, 3.0).after(action)
        assert 0 <= view.yaw <= 360
        assert -90 <= view.pitch <= 90
        submit_succeeds(ANNOTATION[0], action.yaw, action.pitch)
    for skill, truth in zip(SKILLS, ("2", "table", "Front Left", MAP), strict=True):
        assert 0 <= score(skill, truth, text) <= 1


@HOSTILE
@given(
    st.one_of(
        trees([{"yaw": 3, "pitch": 4}, {"text": ANSWERS[4]}]).map(as_text),
        words.map(lambda text: json.dumps({"text": text})),
    )
)
def test_predictions_are_judged_or_refused(line):
    prediction = reads(lambda: _object(line))
    if prediction is None:
        return
    item = {"task": "Find it", "yaw": [40, 70], "pitch": [-15, 10]}
    episode = Episode("hall/0/0", "hall/0", "hall", "hos", item, [], 0.0, "easy", "x")
    sample = Sample("hall/0/0", "hall", msgspec.to_builtins(episode))
    record = reads(lambda: HOS.score(sample, prediction, read_config(HOS, {"data": "."})))
    if record is not None:
        assert record["score"] in (0.0, 1.0)
        assert log.as_line({"key": "hall/0/0", "attempt": 1, "status": "ok", **record})
