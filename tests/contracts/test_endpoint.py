"""A model on a server: what reaches it, what comes back, and what happens when it fails."""

import json
import math
import threading
import time
from contextlib import nullcontext
from email.utils import formatdate
from functools import reduce

import numpy as np
import pytest
from contract_server import ContractServer, Reply, Request, reddish, wait_until
from served_model import IMAGE_TOKENS, served, write_model

from eagor.errors import AnswerError, EagorError, QueryError, ServerError
from eagor.evidence import Evidence
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.perception import check_perception, load
from eagor.perception.endpoint import EndpointPerception, ServedChat, from_text
from eagor.perception.vlm import IMAGE, Message
from eagor.sources.panorama import view
from eagor.sphere import angular_distance, direction, world_R_body

openai = pytest.importorskip("openai")

QWEN = "Qwen/Qwen2.5-VL-7B-Instruct"
FAMILIES = {
    "qwen2_5_vl": QWEN,
    "qwen3_vl": "qwen3-vl:8b",
    "gemma3": "google/gemma-3-4b-it",
    "llava": "llava-hf/llava-1.5-7b-hf",
    "janus": "deepseek-community/Janus-Pro-7B",
    "internvl": "OpenGVLab/InternVL3-8B-hf",
    "gemini": "gemini-2.5-flash",
    "kimi_vl": "moonshotai/Kimi-VL-A3B-Instruct",
    "molmo": "allenai/Molmo-7B-D-0924",
    "other": "some-model",
}
SIZES = {  # (height, width) of a panorama as it is sent
    "qwen2_5_vl": (700, 1400),
    "qwen3_vl": (704, 1408),
    "gemma3": (896, 896),
    "llava": (336, 336),
    "janus": (384, 384),
    "internvl": (448, 896),
    "gemini": (672, 1344),
    "kimi_vl": (700, 1400),
    "molmo": (700, 1400),
    "other": (700, 1400),
}


def ball(azimuth_deg: float, elevation_deg: float, radius_deg: float = 6, rows: int = 256) -> np.ndarray:
    """A panorama with one red disc on grey."""
    grid = ErpGrid(rows, 2 * rows)
    centre = direction(math.radians(azimuth_deg), math.radians(elevation_deg))
    panorama = np.full((rows, 2 * rows, 3), 150, dtype=np.uint8)
    panorama[angular_distance(grid.directions, centre) < math.radians(radius_deg)] = (220, 10, 10)
    return panorama


def error_deg(evidence: Evidence, azimuth_deg: float, elevation_deg: float) -> float:
    """Degrees between the mean direction of the response and where the thing is."""
    response = np.asarray(evidence.response) * evidence.grid.weights
    mean = (response[..., None] * evidence.grid.directions).sum(axis=(0, 1))
    truth = direction(math.radians(azimuth_deg), math.radians(elevation_deg))
    return math.degrees(float(angular_distance(mean, truth)))


@pytest.fixture
def server():
    with ContractServer(reddish, tuple(FAMILIES.values())) as running:
        yield running


def asking(server: ContractServer, model: str = QWEN, **options) -> EndpointPerception:
    """A perception that asks `server`, small and impatient unless told otherwise."""
    chosen = {"pixels": 196 * 392, "backoff": 0.01, "timeout": 20.0} | options
    return EndpointPerception(model, server.url, **chosen)


# --- what reaches the server -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("family", FAMILIES)
def test_pictures_have_the_exact_size_and_orientation(server, family):
    height, width = SIZES[family]
    panorama = np.zeros((512, 1024, 3), dtype=np.uint8)
    panorama[:256, :512], panorama[:256, 512:] = (250, 20, 20), (20, 250, 20)  # up left red, up right green
    panorama[256:, :512], panorama[256:, 512:] = (20, 20, 250), (250, 250, 20)  # down left blue, down right yellow
    asking(server, FAMILIES[family], extractor="boxes", pixels=0)(panorama, "thing")
    straight, rolled = sorted((request.image for request in server.requests), key=lambda image: -int(image[9, 9, 0]))
    assert straight.shape == rolled.shape == (height, width, 3)
    top, bottom, left, right = height // 4, 3 * height // 4, width // 4, 3 * width // 4
    assert [straight[row, col].tolist() for row in (top, bottom) for col in (left, right)] == [
        [250, 20, 20],
        [20, 250, 20],
        [20, 20, 250],
        [250, 250, 20],
    ]
    # The other look is the same picture rolled by whole cells, near half a turn.
    shifts = [shift for shift in range(width) if np.array_equal(np.roll(straight[top], shift, axis=0), rolled[top])]
    (shift,) = shifts
    np.testing.assert_array_equal(np.roll(straight, shift, axis=1), rolled)
    cell = asking(server, FAMILIES[family]).family.cell
    assert shift % cell == 0
    assert abs(shift - width / 2) <= cell / 2


def test_a_request_is_what_servers_understand(server):
    asking(server, seam=False, max_tokens=77)(ball(0, 0), "red ball")
    (request,) = server.requests
    body = request.body
    assert body["model"] == QWEN
    assert [part["type"] for part in body["messages"][0]["content"]] == ["image_url", "text"]  # equal beginnings
    assert (body["temperature"], body["max_tokens"], body["logprobs"]) == (0, 77, True)
    schema = body["response_format"]["json_schema"]["schema"]
    assert body["response_format"]["type"] == "json_schema"
    assert schema["items"]["properties"]["bbox_2d"]["items"] == {"type": "integer"}
    assert "red ball" in request.text
    assert "stream" not in body


def test_the_key_is_the_one_that_was_named(server, monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", "not for this server")
    asking(server, seam=False)(ball(0, 0), "red ball")
    monkeypatch.setenv("HOUSE_KEY", "secret-7")
    asking(server, seam=False, key="HOUSE_KEY")(ball(0, 0), "red ball")
    assert [request.headers["authorization"] for request in server.requests] == ["Bearer none", "Bearer secret-7"]
    monkeypatch.delenv("HOUSE_KEY")
    with pytest.raises(EagorError, match="HOUSE_KEY"):
        asking(server, key="HOUSE_KEY")(ball(0, 0), "red ball")


# --- what comes back -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("family", "azimuth"),
    [(family, (-180, 45)[index % 2]) for index, family in enumerate(FAMILIES)],
)
def test_boxes_point_where_the_thing_is(server, family, azimuth):
    perception = asking(server, FAMILIES[family], extractor="boxes")
    evidence = perception(ball(azimuth, 15), "red ball", stamp=2.5)
    assert error_deg(evidence, azimuth, 15) < 1.5
    assert np.asarray(evidence.response).max() > 0.8
    assert evidence.stamp == 2.5


@pytest.mark.parametrize("azimuth", [-180, -91, 0, 90])
@pytest.mark.parametrize("options", [{}, {"extractor": "views", "per_view": "boxes"}], ids=["looks", "views"])
def test_boxes_are_detections_and_a_thing_in_several_pictures_is_one(server, azimuth, options):
    perception = asking(server, **{"extractor": "boxes", "pixels": 392 * 784} | options)
    evidence = perception(ball(azimuth, 15, 8), "red ball", stamp=2.5)
    found = evidence.detections
    assert len(found) == 1
    assert found.model == DetectorModel()
    truth = direction(math.radians(azimuth), math.radians(15))
    assert math.degrees(float(angular_distance(found.directions[0], truth))) < 1
    assert found.views == ()
    assert evidence.source["images"] > 1
    told = asking(server, extractor="boxes", detector=DetectorModel(0.8))(ball(azimuth, 15), "red ball")
    assert told.detections.model.detection_probability == 0.8
    assert len(perception(np.full((64, 128, 3), 150, np.uint8), "red ball").detections) == 0


def test_a_box_in_an_ordinary_picture_is_a_detection_in_that_view(server):
    grid = PerspectiveGrid(180, 320, math.radians(100), world_R_body(0.5, -0.2))
    picture = view(ball(40, 20, 6), grid)
    found = asking(server, extractor="boxes").view(picture, grid, "red ball", stamp=1.0).detections
    assert len(found) == 1
    truth = direction(math.radians(40), math.radians(20))
    assert math.degrees(float(angular_distance(found.directions[0], truth))) < 1.5
    assert float(found.share(np.array([[-1.0, 0.0, 0.0]]))[0]) == 0


def test_without_the_second_look_a_cut_thing_is_two(server):
    counts = [len(asking(server, seam=seam)(ball(180, 0, 20), "red ball").detections) for seam in (False, True)]
    assert counts == [2, 1]


@pytest.mark.parametrize("family", ["qwen2_5_vl", "gemma3"])
@pytest.mark.parametrize("per_view", ["presence", "boxes"])
def test_views_point_where_the_thing_is(server, family, per_view):
    for azimuth, elevation in ((130, 40), (-30, -70), (180, 0)):
        perception = asking(server, FAMILIES[family], extractor="views", per_view=per_view, pixels=224 * 224)
        evidence = perception(ball(azimuth, elevation, 8), "red ball")
        # Presence knows no more than which views show the thing.
        assert error_deg(evidence, azimuth, elevation) < (1.5 if per_view == "boxes" else 50)
        assert np.asarray(evidence.response).max() > 0.8
        assert np.asarray(evidence.response).min() < 0.05
        assert evidence.source is not None
        assert evidence.source["images"] == evidence.source["requests"] == 6


def test_presence_is_a_probability_where_given_and_a_word_otherwise(server):
    perception = asking(server, extractor="views", pixels=112 * 112)
    likely = np.asarray(perception(ball(0, 0, 8), "red ball").response)
    assert (likely.max(), likely.min()) == pytest.approx((0.9, 0.04), abs=0.005)
    server.logprobs = False
    plain = np.asarray(perception(ball(0, 0, 8), "red ball").response)
    assert (plain.max(), plain.min()) == pytest.approx((1.0, 0.0), abs=0.005)


@pytest.mark.parametrize("lacks", ["response_format", "logprobs"])
def test_servers_that_refuse_an_option_are_asked_without_it(server, lacks):
    server.knows = {"response_format", "logprobs"} - {lacks}
    perception = asking(server)
    for _ in range(2):
        assert error_deg(perception(ball(60, 0), "red ball"), 60, 0) < 1.5
    assert all((lacks in request.body) is False for request in server.requests)
    assert server.tries - len(server.requests) <= 2  # refused at most once for each request of the first look


def test_token_probabilities_are_the_confidence_of_a_box(server):
    pieces = [("[", -0.1), ('{"', -0.5), ("bbox", 0), ("_2d", 0), ('": [', 0)]
    for number in ("100", "50", "150", "90"):
        for index, digit in enumerate(number):
            pieces.append((digit, -0.2 if index == 0 else -3.0))
        pieces.append((", " if number != "90" else "]", 0))
    pieces += [(', "label": "ball"}]', 0)]
    server.answer = lambda request: Reply("", pieces)
    (score,) = asking(server, seam=False)(ball(0, 0), "red ball").detections.scores
    assert score == pytest.approx(math.exp(-0.1 - 0.5 - 0.2), rel=1e-3)
    server.logprobs = False
    assert asking(server, seam=False)(ball(0, 0), "red ball").detections.scores == [1]


def test_thoughts_come_before_the_verdict(server):
    pieces = [("<think>", 0), ("No", -0.1), ("?", 0), ("</think>", 0), ("Yes", -0.3)]
    others = [[], [("No", -0.1)], [], [], [("Yes", math.log(0.75)), ("No", math.log(0.25))]]
    server.answer = lambda request: Reply("", pieces, others)
    response = asking(server, extractor="views", pixels=112 * 112)(ball(0, 0), "red ball").response
    np.testing.assert_allclose(response, 0.75, atol=1e-6)


@pytest.mark.parametrize(
    ("pieces", "share"),
    [
        ([("{", 0), ('"present"', 0), (": ", 0), ("false", math.log(0.8)), ("}", 0)], 0.2),
        ([("It", 0), (" is", 0), (" not", 0), (" hard", 0), (":", 0), (" yes", math.log(0.7))], 0.7),
        ([("No", 0), (" doubt", 0), (",", 0), (" Yes", math.log(0.6))], 0.6),
    ],
)
def test_the_word_that_decides_gives_the_probability(server, pieces, share):
    server.answer = lambda request: Reply("", pieces)
    response = asking(server, extractor="views", pixels=112 * 112)(ball(0, 0), "red ball").response
    np.testing.assert_allclose(response, share, atol=1e-6)


def test_several_queries_are_asked_of_the_same_pictures(server):
    def answer(request: Request) -> Reply | str:
        return reddish(request) if "red ball" in request.text else "[]"

    server.answer = answer
    perception = asking(server)
    found = perception.observe(ball(60, 0), ["red ball", "giraffe"], stamp=1.5)
    assert [len(each.detections) for each in found] == [1, 0]
    assert [each.stamp for each in found] == [1.5, 1.5]
    assert perception.observe(ball(60, 0), []) == []


def test_the_evidence_tells_what_produced_it(server):
    source = asking(server)(ball(60, 0), "red ball").source
    assert source is not None
    assert source["model"] == source["served_as"] == QWEN
    assert (source["family"], source["extractor"], source["revision"]) == ("qwen2_5_vl", "boxes", "fp_7")
    assert source["pixels"] == [196, 392]
    assert source["server"] == server.url
    assert (source["images"], source["requests"], source["prompt_tokens"]) == (2, 2, 4000)
    assert source["answer_tokens"] > 20
    assert source["milliseconds"] > 0
    assert json.loads(json.dumps(source)) == source


def test_the_only_model_of_a_server_needs_no_name(server):
    with pytest.raises(QueryError, match="10 models"):
        asking(server, "")(ball(0, 0), "red ball")
    server.models = (QWEN,)
    evidence = asking(server, "")(ball(0, 0), "red ball")
    assert evidence.source is not None
    assert evidence.source["model"] == QWEN


@pytest.mark.parametrize("extractor", ["boxes", "views"])
def test_it_keeps_the_contract(server, extractor):
    perception = asking(server, extractor=extractor, pixels=28 * 28 * 72)
    check_perception(perception, ball(30, 10, rows=84), "red ball")


# --- what goes wrong -------------------------------------------------------------------------------------------------


def test_passing_failures_are_tried_again(server):
    server.faults = ["500", "500"]
    evidence = asking(server, concurrency=1)(ball(60, 0), "red ball")
    assert error_deg(evidence, 60, 0) < 1.5
    assert evidence.source is not None
    assert evidence.source["requests"] == 4  # two pictures, two failures
    for fault in ("429", "drop"):
        server.faults = [fault]
        assert error_deg(asking(server)(ball(60, 0), "red ball"), 60, 0) < 1.5


@pytest.mark.parametrize(
    ("fault", "kind", "says"),
    [
        ("500", ServerError, r"refused the request \(tried 3 times; HTTP 500\): CUDA error"),
        ("429", ServerError, r"tried 3 times; HTTP 429"),
        ("drop", ServerError, r"no server answers at http.*tried 3 times"),
        ("slow", ServerError, r"no answer within 0\.2 s \(tried 3 times\)\. Allow more time"),
        ("401", ServerError, "It wants a key.*key=VARIABLE"),
        ("404 model", QueryError, r"has no model 'qwen'.*it has 'a', 'b'"),
        ("404 path", ServerError, "HTTP 404"),
        ("400 context", ServerError, r"context length is 512.*too large for it, send fewer pixels.*longer context"),
        ("404 model ollama", QueryError, "has no model 'qwen'.*it has 'a', 'b'"),
        ("400 image", ServerError, r"is not a multimodal model\. Is 'qwen' a vision-language model.*--mmproj"),
        ("500 image llama.cpp", ServerError, "provide the mmproj.*--mmproj"),
        ("400 other", ServerError, r"refused the request \(tried once; HTTP 400\): temperature must be positive"),
        ("empty", AnswerError, "empty answer.*max_tokens"),
        ("html", ServerError, "other than a chat completion.*OpenAI-compatible"),
        ("cut", ServerError, "other than a chat completion"),
    ],
)
def test_lasting_failures_say_what_to_change(server, fault, kind, says):
    server.models = ("a", "b") if "404 model" in fault else ("qwen",)
    server.lasting = fault
    timeout = 0.2 if fault == "slow" else 60.0  # a busy machine must not be taken for a slow server
    with pytest.raises(kind, match=says):
        asking(server, "qwen", frame="pixels", cell=28, retries=2, timeout=timeout, seam=False)(ball(0, 0), "red ball")
    if fault[:3] not in ("500", "429", "dro", "slo"):
        assert server.tries <= 3  # what will not pass is not tried again, but without what it names, and the features


NONSENSE = {  # what a completion may hold instead of what is documented, by where; None: it does not matter
    ("choices",): ({"a": 1}, "other than a chat completion"),
    ("choices", 0, "message", "content"): ({"text": "[]"}, "other than a chat completion"),
    ("choices", 0, "logprobs", "content", 0, "logprob"): (math.nan, None),
    ("choices", 0, "logprobs", "content", 0, "top_logprobs"): ([{"token": 3, "logprob": []}], None),
    ("usage", "prompt_tokens"): ("many", None),
    ("model",): (7, None),
    ("system_fingerprint",): ([1], None),
}


@pytest.mark.parametrize("extractor", ["boxes", "views"])
@pytest.mark.parametrize("place", NONSENSE, ids=lambda place: place[-1])
def test_a_server_may_answer_with_other_types(server, place, extractor, monkeypatch):
    value, says = NONSENSE[place]

    def changed(body, reply, model, complete=server._completion):
        made = complete(body, reply, model)
        inner = reduce(lambda part, key: part and part[key], place[:-1], made)
        if inner is not None:  # no probabilities where none were asked for
            inner[place[-1]] = value
        return made

    monkeypatch.setattr(server, "_completion", changed)
    perception = asking(server, extractor=extractor, pixels=112 * 112)
    if says is None:
        assert error_deg(perception(ball(60, 0, 12), "red ball"), 60, 0) < 30
        assert ServedChat(QWEN, server.url)([Message("user", f"{IMAGE}Is it red? yes or no", (ball(0, 0),))]).text
    else:
        with pytest.raises(ServerError, match=says):
            perception(ball(60, 0), "red ball")
        with pytest.raises(ServerError, match="other than a chat completion"):
            ServedChat(QWEN, server.url)([Message("user", f"{IMAGE}Is it red? yes or no", (ball(0, 0),))])


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (b"[" * 100_000 + b"]" * 100_000, "RecursionError"),
        (b"", "JSONDecodeError"),
        (b"null", "other than a chat completion"),
    ],
    ids=["deep", "empty", "null"],
)
def test_a_body_that_is_no_completion(server, body, says, monkeypatch):
    write = server._write
    monkeypatch.setattr(server, "_write", lambda handler, status, _, kind: write(handler, status, body, kind))
    with pytest.raises(ServerError, match=says):
        asking(server)(ball(0, 0), "red ball")
    with pytest.raises(ServerError, match="other than a chat completion"):
        asking(server, model="")(ball(0, 0), "red ball")  # the list of its models is no better


@pytest.mark.parametrize(
    ("body", "says", "tries"),
    [
        ({"error": {"message": "busy upstream", "code": 429}}, r"tried 2 times; HTTP 429\): busy upstream", 2),
        ({"error": {"message": "busy", "code": "rate_limit_exceeded"}}, r"HTTP 429\): busy", 2),
        ({"error": "out of memory", "choices": None}, r"HTTP 500\): out of memory", 2),
        ({"choices": [{"error": {"message": "lost", "code": 502}, "message": {"content": ""}}]}, r"502\): lost", 2),
        ({"code": 401, "msg": "no such token"}, r"HTTP 401\): no such token\. It wants a key", 1),
        ({"error": {"message": "maximum context length is 512"}}, "context length is 512", 2),
        ({"error": {"message": "lost", "code": 502}, "choices": [{"message": {"content": "[]"}}]}, r"502\): lost", 2),
    ],
)
def test_an_error_within_a_success_is_that_error(server, body, says, tries, monkeypatch):
    complete = server._completion
    monkeypatch.setattr(server, "_completion", lambda *_: body)
    perception = asking(server, retries=1, seam=False)
    with pytest.raises(ServerError, match=says):
        perception(ball(60, 0), "red ball")
    assert server.tries == tries
    answers = iter([lambda *_: body, complete])
    monkeypatch.setattr(server, "_completion", lambda *about: next(answers)(*about))
    if tries == 2:
        assert error_deg(perception(ball(60, 0), "red ball"), 60, 0) < 1.5


BALL = '[{"bbox_2d": [100, 50, 150, 90]}]'
DRAFT = "Is it [1, 2, 30, 40]?"


@pytest.mark.parametrize(
    "message",
    [
        {"content": [{"type": "text", "text": BALL}]},
        {"content": [BALL[:9], {"type": "text", "text": BALL[9:]}]},
        {
            "content": [
                {"type": "thinking", "thinking": [{"type": "text", "text": DRAFT}]},
                {"type": "text", "text": BALL},
            ]
        },
        {"content": None, "reasoning_content": BALL},
        {"content": "", "reasoning": f"{DRAFT} No.\n\n{BALL}"},
        {"content": None, "reasoning_content": f"{DRAFT} No.</think>{BALL}"},
        {"content": BALL, "reasoning_content": DRAFT},
        {"content": [{"type": "text", "text": DRAFT, "thought": True}, None, {"type": "text", "text": BALL}]},
        {"content": json.loads(BALL)},
        {"content": None, "tool_calls": [{"function": {"name": "report", "arguments": BALL}}]},
    ],
)
def test_the_answer_is_found_in_its_parts_or_where_the_thoughts_are(server, message, monkeypatch):
    complete = server._completion

    def changed(*about):
        made = complete(*about)
        made["choices"][0]["message"] = {"role": "assistant", **message}
        return made

    server.answer, server.logprobs = lambda request: BALL, False
    expected = asking(server, seam=False)(ball(0, 0), "red ball").response
    monkeypatch.setattr(server, "_completion", changed)
    np.testing.assert_array_equal(asking(server, seam=False)(ball(0, 0), "red ball").response, expected)


@pytest.mark.parametrize(
    ("message", "reason", "says"),
    [
        ({"content": "[]"}, "content_filter", "stopped because of 'content_filter'"),
        ({"content": "There is no"}, "SAFETY", "stopped because of 'SAFETY', and says 'There is no'"),
        ({"content": "[]"}, "error", "stopped because of 'error'"),
        ({"content": "[]", "refusal": "I cannot help."}, "stop", "says 'I cannot help.'"),
        ({"content": "There is no sign at first, but look"}, "length", "was cut off; allow more tokens"),
        ({"content": "No, or perhaps: let me look again"}, "MAX_TOKENS", "was cut off; allow more tokens"),
        ({"content": "Error: no image in the request"}, "stop", "vision-language model"),
        ({"content": "", "reasoning_content": f"{DRAFT} I shall look again."}, "stop", "characters of reasoning"),
    ],
)
def test_what_was_withheld_or_cut_did_not_look_in_vain(server, message, reason, says, monkeypatch):
    made = {"model": "m", "choices": [{"index": 0, "finish_reason": reason, "message": message}]}
    monkeypatch.setattr(server, "_completion", lambda *_: made)
    for extractor in ("boxes", "views"):
        with pytest.raises(AnswerError, match=says):
            asking(server, extractor=extractor, pixels=112 * 112)(ball(0, 0), "red ball")


@pytest.mark.parametrize(
    ("labels", "count", "says"),
    [
        (["red ball", "table"], 1, None),
        (["a red ball.", "ball"], 1, None),
        (["blue ball"], 0, None),
        (["no red ball"], 0, None),
        (["rote Kugel", "blue ball"], 1, "calls what it found for 'red ball' 'rote Kugel'"),
        (["", "ball"], 2, None),
        (["blue ball", "object 1"], 1, None),
    ],
)
def test_what_the_model_calls_something_else_does_not_count(server, labels, count, says):
    boxes = [{"bbox_2d": [200 * at, 50, 200 * at + 40, 90], "label": label} for at, label in enumerate(labels)]
    server.answer = lambda request: json.dumps(boxes)
    perception = asking(server, seam=False)
    with pytest.warns(UserWarning, match=says) if says else nullcontext():
        assert len(perception(ball(0, 0), "red ball").detections) == count
    assert len(perception(ball(0, 0), "red ball").detections) == count, "it warns once"


def test_the_first_choice_is_the_one_that_is_numbered_so(server, monkeypatch):
    choices = [{"index": at, "message": {"content": each}} for at, each in ((1, "[]"), (0, BALL))]
    monkeypatch.setattr(server, "_completion", lambda *_: {"model": "m", "choices": choices})
    assert len(asking(server, seam=False)(ball(0, 0), "red ball").detections) == 1


def test_a_server_that_counts_no_tokens_for_pictures_is_doubted_once(server, monkeypatch):
    made = {"model": "m", "choices": [{"message": {"content": "[]"}}], "usage": {"prompt_tokens": 30}}
    monkeypatch.setattr(server, "_completion", lambda *_: made)
    perception = asking(server)
    with pytest.warns(UserWarning, match=r"counts 60 tokens in 2 questions.*did it get the pictures\?"):
        perception(ball(0, 0), "red ball")
    perception(ball(0, 0), "red ball")


def test_thoughts_that_were_cut_off_are_no_answer(server, monkeypatch):
    thought = {"content": None, "reasoning_content": DRAFT}
    made = {"model": "m", "choices": [{"index": 0, "finish_reason": "length", "message": thought}]}
    monkeypatch.setattr(server, "_completion", lambda *_: made)
    with pytest.raises(AnswerError, match=r"of 'length', after 21 characters of reasoning\).*max_tokens"):
        asking(server)(ball(0, 0), "red ball")


@pytest.mark.parametrize(
    ("name", "words", "then"),
    [
        ("max_tokens", "Unsupported parameter: 'max_tokens' is not supported with this model. Use "
         "'max_completion_tokens' instead.", "max_completion_tokens"),
        ("max_tokens", "body.max_tokens: Extra inputs are not permitted", "max_completion_tokens"),
        ("temperature", "Unsupported value: 'temperature' does not support 0 with this model. Only the default (1) "
         "value is supported.", None),
    ],
)  # fmt: skip
def test_what_reasoning_models_refuse_is_left_out_or_named_otherwise(server, name, words, then):
    server.refuses = {name: words}
    perception = asking(server, seam=False, max_tokens=77)
    for _ in range(2):
        assert error_deg(perception(ball(60, 0), "red ball"), 60, 0) < 1.5
    body = server.requests[-1].body
    assert name not in body
    assert then is None or body[then] == 77
    assert server.tries == 3, "refused once"


@pytest.mark.parametrize(
    ("status", "words"),
    [(500, "failed to parse grammar"), (404, "No endpoints found that can handle the requested parameters.")],
)
def test_a_schema_is_left_out_however_it_is_called(server, status, words, monkeypatch):
    refused, send = (status, {"error": {"message": words}}), server._send
    monkeypatch.setattr(server, "_complete", lambda handler, body, complete=server._complete: (
        send(handler, *refused) if "response_format" in body else complete(handler, body)))  # fmt: skip
    assert error_deg(asking(server, seam=False, retries=0)(ball(60, 0), "red ball"), 60, 0) < 1.5


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (b'{"choices": []}', "^qwen returned no choices"),
        (b'{"choices": [{"message": {"content": ""}, "finish_reason": "stop"}]}', r"^qwen gave .* of 'stop'\)"),
    ],
    ids=["no choices", "no words"],
)
def test_an_empty_answer_is_said_of_the_model_that_was_asked(server, body, says, monkeypatch):
    write = server._write
    monkeypatch.setattr(server, "_write", lambda handler, status, _, kind: write(handler, status, body, kind))
    with pytest.raises(AnswerError, match=says):
        asking(server, "qwen")(ball(0, 0), "red ball")


def test_no_server_at_all():
    with ContractServer(reddish) as server:
        url = server.url  # nobody listens there once it is gone
    for model in ("qwen", ""):
        with pytest.raises(ServerError, match=rf"no server answers at {url} .*vllm serve"):
            EndpointPerception(model, url, retries=1, backoff=0.01)(ball(0, 0), "red ball")


@pytest.mark.parametrize("says", ["I like chairs.", "[[1, 2], [3]]", '[{"bbox_2d": [9000, 9000, 9900, 9900]}]'])
def test_an_unreadable_answer_is_asked_for_once_more(server, says):
    server.answer = lambda request: says if request.body["temperature"] == 0 else reddish(request)
    evidence = asking(server)(ball(60, 0), "red ball")
    assert error_deg(evidence, 60, 0) < 1.5
    assert evidence.source is not None
    assert evidence.source["requests"] == 4
    server.answer = lambda request: says
    with pytest.raises(AnswerError, match="the model answered"):
        asking(server)(ball(60, 0), "red ball")


# --- several at once -------------------------------------------------------------------------------------------------


def test_requests_go_out_together_but_no_more_than_allowed(server):
    server.gate = threading.Barrier(3)  # nobody is answered before three have come
    asking(server, concurrency=3).observe(ball(0, 0), ["red ball", "ball", "red thing"])
    assert (server.most_at_once, len(server.requests)) == (3, 6)


@pytest.mark.parametrize("make", [EndpointPerception, ServedChat])
def test_several_servers_want_a_proxy(make):
    """Sharing the work is a proxy's: the error says so, and no password."""
    addresses = "http://u:hunter2-0815@a,http://b:8000/v1"
    says = r"wanted one such as.*several servers.*proxy"
    with pytest.raises(EagorError, match=says) as caught:
        make("qwen", addresses)
    assert "hunter2-0815" not in str(caught.value)


def test_who_waits_for_another_try_keeps_its_place(server):
    """A server that fails is not asked the more for it."""
    server.faults = ["500"] * 3
    asking(server, concurrency=1).observe(ball(0, 0), ["a", "b"])
    assert (server.tries, server.most_at_once) == (3 + 4, 1)


@pytest.mark.parametrize("when", [lambda: "0.4", lambda: formatdate(math.ceil(time.time()) + 1, usegmt=True)])
def test_a_server_that_says_when_is_left_alone_until_then(server, when):
    """As seconds, or as a date, which has whole seconds."""
    server.faults, server.headers = ["429"], {"Retry-After": when()}
    began = time.time()
    asking(server, backoff=0.01, seam=False)(ball(0, 0), "a")
    assert time.time() - began >= 0.4
    assert server.tries == 2


def test_one_failure_ends_the_look(server):
    """What was not sent when it happened is not sent any more."""
    server.faults = ["401"]
    with pytest.raises(ServerError, match="wants a key"):
        asking(server, concurrency=1).observe(ball(0, 0), [f"thing {index}" for index in range(20)])
    wait_until(lambda: server.now == 0)
    assert server.tries <= 4


# --- names and options -----------------------------------------------------------------------------------------------


def test_load_reads_the_name(server):
    perception = load(f"endpoint:{QWEN}@{server.url}?extractor=boxes&pixels=76832&seam=false&backoff=0.1")
    assert isinstance(perception, EndpointPerception)
    assert (perception.client.model(), perception.client.address) == (QWEN, server.url)
    options = perception.client.options
    assert (options.pixels, options.seam, options.backoff) == (76832, False, 0.1)
    assert error_deg(perception(ball(60, 0), "red ball"), 60, 0) < 1.5
    assert load("endpoint", retries=7).client.address == "http://localhost:8000/v1"


@pytest.mark.parametrize(
    ("text", "model", "address"),
    [
        ("qwen2.5vl:7b@http://a:11434", "qwen2.5vl:7b", "http://a:11434/v1"),
        ("m@http://a/v1/", "m", "http://a/v1"),
        ("m@http://a/v1/chat/completions", "m", "http://a/v1"),
        ("m@https://b:8/api/v1", "m", "https://b:8/api/v1"),
        ("org/m", "org/m", "http://localhost:8000/v1"),
        ("who@where@http://[::1]:80", "who@where", "http://[::1]:80/v1"),
    ],
)
def test_names_of_all_kinds(text, model, address):
    perception = from_text(text)
    assert (perception.client.model(), perception.client.address) == (model, address)


@pytest.mark.parametrize(
    ("text", "options", "says"),
    [
        ("m@http://a?colour=red", {}, "'colour' is no key of a served model"),
        ("m@http://a?pixels=many", {}, "pixels is 'many'; wanted `int`"),
        ("m@http://a?seam=perhaps", {}, "seam is 'perhaps'; wanted `bool`"),
        ("m@http://a?pixels=1&pixels=1", {}, "pixels=1.*each once"),
        ("m@http://a?extractor=attention", {}, r"extractor is 'attention'; wanted .*boxes\|views"),
        ("m@http://a?frame=metres", {}, r"frame is 'metres'; wanted .*pixels\|thousand\|percent\|unit"),
        ("m@http://a?pixels=-1", {}, "pixels is -1; wanted `int` >= 0"),
        ("m@http://a?timeout=1e10", {}, "timeout is 10000000000.0; wanted `float` <= 86400"),
        ("m@http://a", {"key": 5}, "key is 5; wanted `str`"),
        ("m@http://a?concurrency=0", {}, "concurrency is 0; wanted `int` >= 1"),
        ("m@http://a?backoff=nan", {}, "backoff is nan"),
        ("m@http://a", {"max_tokens": 0.5}, "max_tokens is 0.5; wanted `int`"),
        ("m@ftp://a", {}, "not the address of a server"),
        ("m@http://a:99999", {}, "not the address of a server"),
        ("m@nowhere", {}, "not the address of a server"),
    ],
)
def test_wrong_names_and_options(text, options, says):
    with pytest.raises(EagorError, match=says):
        from_text(text, **options)


# --- a real server ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def gemma(tmp_path_factory):
    """`transformers serve` with a tiny Gemma-3 that writes the same box about every picture: (address, name)."""
    for package in ("transformers", "fastapi", "uvicorn"):
        pytest.importorskip(package)
    folder = tmp_path_factory.mktemp("gemma3")
    write_model(folder, "[[250, 400, 350, 500]]")
    with served(folder) as url:
        yield url, str(folder)


@pytest.mark.slow
def test_transformers_serve_gemma3(gemma):
    """It ignores the schema and the wish for probabilities; the box that it writes arrives where it belongs."""
    url, name = gemma
    options = {"frame": "thousand", "order": "xyxy", "extractor": "boxes", "pixels": 224 * 224}
    evidence = EndpointPerception(name, url, seam=False, **options)(ball(0, 0), "red ball")
    assert error_deg(evidence, 180 - 360 * 0.3, 90 - 180 * 0.45) < 1.5
    source = evidence.source
    assert source is not None
    assert source["prompt_tokens"] > IMAGE_TOKENS
    assert (source["requests"], source["probabilities"]) == (1, False)
    # The same box in the rolled picture is a thing half a turn away.
    assert len(EndpointPerception(name, url, **options)(ball(0, 0), "red ball").detections) == 2
