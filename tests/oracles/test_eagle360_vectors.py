"""EAGLE-360: what its official evaluator (Sansju/EAGLE-360 at 1afb0d6) makes of answers, calls and directions."""

import json
from pathlib import Path

import numpy as np
import pytest

from eagor.errors import FormatError
from eagor.evidence import Evidence
from eagor.grids import ErpGrid
from eagor.lab.tasks.eagle360 import EAGLE360, TOOL, parse_answer, parse_call, question_of, score
from eagor.lab.tasks.task import check_task, configure
from eagor.perception.vlm import ChatReply

SAMPLES = Path(__file__).parents[2] / ".." / "shared" / "bench_samples"
here = pytest.mark.skipif(not SAMPLES.exists(), reason="the shared benchmark samples are not here")


@here
def test_every_vector_is_the_published_one():
    vectors = json.loads((SAMPLES / "conformance_eagle360.json").read_text())
    assert min(len(vectors[kind]) for kind in ("answer", "tool_call", "score")) >= 100
    for vector in vectors["answer"]:
        assert list(parse_answer(vector["text"], strict=True)) == vector["strict"], vector
        assert list(parse_answer(vector["text"])) == vector["loose"], vector
    for vector in vectors["tool_call"]:
        assert parse_call(vector["text"]) == vector["call"], vector
    for vector in vectors["score"]:
        found = score(vector["metadata"], vector["azimuth"], vector["elevation"])
        assert found["distance"] == pytest.approx(vector["distance"], abs=1e-6), vector
        assert (found["in_bfov"], found["face"]) == (vector["in_bfov"], vector["face"]), vector
    for vector in vectors["question"]:
        assert question_of(vector["item"]) == vector["question"], vector


def test_no_answer_is_off_by_180_degrees():
    assert score({"azimuth_degrees": 1, "elevation_degrees": 2}, None, 3.0)["distance"] == 180.0


@here
def test_the_contract_holds_over_the_samples():
    records = check_task(EAGLE360, data=str(SAMPLES / "eagle360_mini"), agent="oracle")
    assert sum(record["score"] for record in records) == 6
    assert EAGLE360.info(SAMPLES / "eagle360_mini")["missing"] == 0


def test_what_is_no_such_data_says_so(tmp_path):
    with pytest.raises(FormatError, match=r"test\.json is not EAGLE-360"):
        EAGLE360.info(tmp_path)
    (tmp_path / "test.json").write_text('[{"panoramic_image": "a.jpg", "metadata": {"azimuth_degrees": 900}}]')
    with pytest.raises(FormatError, match="azimuth_degrees"):
        EAGLE360.info(tmp_path)


class Brightest:
    """A perception that answers with what is bright in a panorama, a degree at a time."""

    def __init__(self):
        self.sizes = []

    def __call__(self, panorama, query, *, stamp=None):
        self.sizes.append(panorama.shape[0])
        bright = panorama.mean(axis=-1) / 255
        return Evidence.from_response(np.where(bright > 0.8, 1.0, 0.0), ErpGrid(*bright.shape), stamp=stamp)


@pytest.fixture
def lamp(tmp_path):
    """One question over a dark panorama with a bright square 50 degrees to the right, 20 up."""
    from PIL import Image

    picture = np.full((180, 360, 3), 40, np.uint8)
    picture[66:74, 226:234] = 255
    Image.fromarray(picture).save(tmp_path / "room.png")
    box = {"azimuth_degrees": 50, "elevation_degrees": 20, "bbox_width_degrees": 8, "bbox_height_degrees": 8}
    item = {"panoramic_image": "/elsewhere/room.png", "metadata": box, "question": "Locate the lamp in this panorama."}
    (tmp_path / "test.json").write_text(json.dumps([item]))
    return tmp_path


def played(lamp, **values):
    config = configure(EAGLE360, {"data": str(lamp), **values})
    (sample,) = EAGLE360.samples(config)
    return EAGLE360.runner(config)(sample.payload), sample, config


def test_the_belief_looks_at_the_whole_first_and_then_closer(lamp, monkeypatch):
    monkeypatch.setattr("eagor.lab.agents.models.shared", lambda spec: Brightest())
    record, *_ = played(lamp, agent="eagor", perception="brightest")
    assert record["score"] == 1.0
    first, *closer = record["steps"]
    assert "view" not in first
    assert 1 <= len(closer) == record["views"] <= 6
    widths = [step["view"][2] for step in closer]
    assert min(widths) <= 50
    assert abs(closer[0]["view"][0] - 50) < 5
    assert abs(closer[0]["view"][1] - 20) < 5
    alone, *_ = played(lamp, agent="global", perception="brightest")
    assert (alone["views"], alone["score"]) == (0, 1.0)


def test_a_model_looks_with_the_published_tool_and_then_answers(lamp, monkeypatch):
    shown = []

    def chat(messages):
        shown.append(messages)
        if len(shown) < 3:
            call = {"name": TOOL, "arguments": {"azimuth": 50, "elevation": 20, "fov_degrees": 90 / len(shown)}}
            return ChatReply(f"<think>there?</think> <tool_call>{json.dumps(call)}</tool_call>")
        return ChatReply(
            "<think>here</think> <answer>The object is located at:\n- Azimuth: 51°\n- Elevation: 19°</answer>"
        )

    monkeypatch.setattr("eagor.lab.agents.models.shared_chat", lambda spec: chat)
    record, sample, config = played(lamp, agent="vlm", model="somebody")
    assert (record["score"], record["views"], record["answer"]) == (1.0, 2, {"azimuth": 51.0, "elevation": 19.0})
    assert [len(message.images) for message in shown[-1]] == [0, 1, 0, 0, 0, 1], "the panorama and the latest view"
    middle = shown[-1][-1].images[0][236:276, 236:276]
    assert middle.mean() > 200, "the view is of what was asked for"
    assert EAGLE360.score(sample, {"text": record["steps"][-1]["raw"]}, config)["score"] == 1.0
    assert EAGLE360.score(sample, {"azimuth": -50, "elevation": 20}, config)["cause"] == "elsewhere"
    assert EAGLE360.score(sample, {"text": "no idea"}, config)["cause"] == "no_answer"
    with pytest.raises(FormatError, match="wanted azimuth and elevation, or text"):
        EAGLE360.score(sample, {"where": 1}, config)
