"""Parts of the studio's server, each alone: messages, mailboxes, answers, questions, who may speak, names of runs."""

import asyncio
import io
import json
import math
import queue
import threading
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from starlette.datastructures import Headers

from eagor.cameras import Lens
from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.lab.eval.results import Run
from eagor.live.core import LiveCore, LoopSettings
from eagor.live.events import Answer, Diagnostic, ImageReceived, ObservationReceived, PoseReceived, Tick
from eagor.live.loop import Loop
from eagor.sources import Pose
from eagor.sources.camera_sources import open_footage
from eagor.sphere import angular_distance, direction, world_R_body
from eagor.studio import runs
from eagor.studio.answers import belief_of, lens_of, picture_of, plan_of, step_of
from eagor.studio.messages import LONGEST, Message, Opening, PageError, merged, packed, read, rounded
from eagor.studio.replays import EpisodeReplay
from eagor.studio.server import Auth
from eagor.studio.sessions import Page
from eagor.studio.stream import PacedFootage, StudioSink
from eagor.tracking import DirectionTracker


def step(number, **blobs):
    return Message({"type": "step", "number": number} | {name: {"of": number} for name in blobs}, blobs)


def test_numbers_that_json_lacks_are_refused_and_rounding_removes_them():
    with pytest.raises(ValueError, match="JSON"):
        packed(Message({"type": "step", "number": math.nan}))
    assert rounded({"a": [math.inf, np.array([1.0000004, math.nan])]}) == {"a": [None, [1.0, None]]}


def test_a_slow_page_misses_steps_but_no_picture_and_no_belief():
    found = merged(merged(step(1, panorama=b"p1", belief=b"b1"), step(2, belief=b"b2")), step(3))
    assert found.header["number"] == 3
    assert found.header["panorama"] == {"of": 1}
    assert found.blobs == {"panorama": b"p1", "belief": b"b2"}


def test_a_mailbox_never_grows_gives_words_first_and_a_new_scene_drops_the_steps_of_the_old_one():
    async def scenario():
        box = Page()
        for number in range(1000):
            box.put(step(number, belief=bytes(100)))
            box.put(Message.status(str(number)))
        got = [await box.get() for _ in range(33)]
        box.put(step(1))
        box.put(Message({"type": "scene"}))
        box.put(step(2))
        got += [await box.get() for _ in range(2)]
        box.put(step(3))
        box.clear()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(box.get(), 0.01)
        return [message.header for message in got]

    got = asyncio.run(scenario())
    assert [header["words"] for header in got[:32]] == [str(number) for number in range(968, 1000)]
    assert got[32]["number"] == 999
    assert [(header["type"], header.get("number")) for header in got[33:]] == [("scene", None), ("step", 2)]


# --- what a page may say ---


@pytest.mark.parametrize(
    "text",
    [
        "", "null", "[]", "{}", "{", '{"type":1}', '{"type":"no"}', '{"type":"open"}', '{"type":"ask","query":"..."}',
        '{"type":"ask","query":"a\\u0000"}', '{"type":"ask","query":"' + "x" * 300 + '"}',
        '{"type":"drive","forward":NaN}', '{"type":"drive","forward":1e999}', '{"type":"drive","seconds":9}',
        '{"type":"open","source":"live","hfov":"wide"}', '{"type":"pause","on":1}', "[" * 3000, "x" * (LONGEST + 1),
    ],
)  # fmt: skip
def test_rubbish_is_refused_with_what_was_wanted(text):
    with pytest.raises(PageError) as refused:
        read(text)
    assert refused.value.problem
    assert refused.value.change


def test_a_message_gets_the_defaults_of_its_fields_and_one_space_between_words():
    found = read('{"type":"open","source":"live","query":" red   chair "}')
    assert (found.query, found.drive, found.hfov) == ("red chair", "", None)


@given(st.one_of(st.text(max_size=200), st.binary(max_size=200)))
def test_no_text_breaks_the_reader(text):
    with suppress(PageError):
        assert read(text)


def refusal(auth, path="/api/state", query="", **headers):
    raw = [(name.encode(), value.encode("utf-8")) for name, value in headers.items()]
    told = auth.refusal({"type": "http", "path": path, "query_string": query.encode(), "headers": raw})
    assert Headers(raw=raw)
    return None if told is None else told[0]


def test_without_a_token_only_this_machine_and_no_other_sites_page_is_spoken_to():
    auth = Auth(None, "127.0.0.1", None)
    for host in ("127.0.0.1:8360", "localhost:8360", "[::1]:8360"):
        assert refusal(auth, host=host, origin=f"http://{host}") is None
    for host in ("evil.example", "127.0.0.1.evil.example", "192.168.0.7:8360"):
        assert refusal(auth, host=host) == 421
    for origin in ("http://evil.example", "http://127.0.0.1:9999", "null", "http://127.0.0.1:8360.evil.example"):
        assert refusal(auth, host="127.0.0.1:8360", origin=origin) == 403


def test_with_a_token_whoever_has_it_is_spoken_to():
    auth = Auth(None, "0.0.0.0", "a-long-enough-token")
    assert refusal(auth, query="token=a-long-enough-token", host="robot.local") is None
    assert refusal(auth, path="/", host="robot.local") is None  # the page itself tells nothing
    for query in ("", "token=", "token=wrong", "token=%C3%A4"):
        assert refusal(auth, query=query, host="robot.local") == 401
        assert refusal(auth, path="/ws", query=query, host="robot.local") == 401


# --- what a page is told ---


def ball(azimuth=0.1):
    return Evidence.from_points(direction(np.array([azimuth]), np.array([0.0])), scores=np.full(1, 0.9))


def estimate_of(*azimuths, turn=0.0):
    tracker = DirectionTracker()
    tracker.add_pose(0.0, world_R_body(turn))
    found = direction(np.array(azimuths), np.zeros(len(azimuths)))
    for number in range(4):
        tracker.add_pose(0.2 * number + 0.01, world_R_body(turn))
        tracker.observe(Evidence.from_points(found, scores=np.full(len(azimuths), 0.9), stamp=0.2 * number + 0.01))
    return tracker.estimate(0.61)


@pytest.mark.parametrize(("azimuths", "turn"), [((0.4,), 0.0), ((0.4,), 1.0), ((-1.0, 2.5), 0.7), ((), 0.0)])
def test_the_heat_and_the_border_are_those_of_the_belief_in_the_axes_of_the_world(azimuths, turn):
    estimate = estimate_of(*azimuths, turn=turn)
    head, heat = belief_of(estimate)
    if not azimuths:  # all is alike: nothing glows
        assert (head, heat) == (None, b"")
        return
    pixels = np.asarray(Image.open(io.BytesIO(heat))).astype(float)
    grid = ErpGrid(*pixels.shape)
    density = estimate.turned(estimate.stamp, np.eye(3)).density(grid)
    top = grid.directions.reshape(-1, 3)[int(pixels.argmax())]
    nearest = min(angular_distance(top, estimate.world_R_body @ mode.direction) for mode in estimate.modes)
    assert math.degrees(nearest) < 2
    level = float(np.exp(estimate.region(0.9)[0]))
    for azimuth, elevation in np.radians([point for line in head["border"] for point in line]):
        x, y, _ = grid.project(direction(azimuth, elevation))
        around = density[max(0, int(y) - 1) : int(y) + 2, max(0, int(x) - 1) : int(x) + 2]
        assert around.min() * 0.7 <= level <= around.max() * 1.4
    said = step_of(estimate, 1.0)
    assert sum(said["around"]) == pytest.approx(1, abs=1e-3)
    best = max(range(64), key=said["around"].__getitem__)
    assert abs(math.remainder(2 * math.pi * best / 64 - estimate.azimuth, 2 * math.pi)) < 0.2 or len(azimuths) > 1
    assert said["estimate"]["azimuth_deg"] == pytest.approx(estimate.as_dict()["azimuth_deg"], abs=1e-4)


def test_an_ordinary_lens_is_told_in_tangents_and_its_picture_is_sent_as_the_ideal_lens_sees_it():
    picture = np.zeros((200, 300, 3), np.uint8)
    picture[90:110, 240:260] = 255
    bent = Lens("bent", (300, 200), (150.0, 150.0), (150.0, 100.0), (-0.05, 0.0, 0.0, 0.0))
    grid = PerspectiveGrid.of_lens(bent)
    told = lens_of(grid)
    assert lens_of(None) is None
    wide, high = told["plane"]
    assert wide == pytest.approx(math.tan(grid.hfov / 2), abs=1e-5)
    assert high / wide == pytest.approx(2 / 3, abs=1e-5)
    shown = np.asarray(Image.open(io.BytesIO(picture_of(picture, grid, 100))).convert("L")).astype(float)
    assert shown.shape == (100, 150)
    row, column = (float((index * shown).sum() / shown.sum()) for index in np.indices(shown.shape))
    seen = grid.unproject(np.array([250.0]), np.array([100.0]))[0]
    assert column + 0.5 == pytest.approx(75 * (1 - seen[1] / seen[0] / wide), abs=1.5)
    assert row + 0.5 == pytest.approx(50, abs=1)


def test_the_plan_has_the_borders_of_its_cells_without_points_on_the_way():
    cells = np.zeros((6, 8), dtype=bool)
    cells[1:5, 2:7], cells[2, 4] = True, False
    ground = SimpleNamespace(structure=cells, free=~cells, origin=np.array([1.0, 2.0]), cell=0.5)
    place = SimpleNamespace(ground=ground, scene=SimpleNamespace(instances=()))
    outer, hole = sorted(plan_of(place, ())["walls"], key=len, reverse=True)
    assert len(outer) == 9  # a box whose corners are cut
    assert outer[0] == outer[-1]
    assert np.ptp(outer, axis=0) == pytest.approx([2.5, 2.0])
    assert np.mean(hole[:-1], axis=0) == pytest.approx([3.25, 3.25])


# --- questions ---


class Followed:
    """What a sink needs of the loop: it notes what is followed."""

    def __init__(self, core=None):
        self.core = core or LiveCore(LoopSettings(("ball",), poses=False))
        self.followed = []
        self.follow = self.followed.append


def sink_of(said, source=None, core=None):
    sink = StudioSink(said.append, Opening("camera", "camera", "ball", "colour"), source)
    sink.loop = Followed(core)
    return sink


def test_a_stream_goes_on_with_the_question_before_one_that_is_refused():
    messages, estimate = [], estimate_of(0.2)
    sink = sink_of(messages)

    def answers(*queries, look_age=0.1):
        return [Answer(1.0, query, estimate, None, look_age, 0.1) for query in queries]

    def said(kind):
        return [each.header for each in messages if each.header["type"] == kind]

    sink.take(Tick(1.0), answers("ball"))
    sink.ask("zzz", 7)
    assert sink.loop.followed[-1] == ["ball", "zzz"]
    sink.take(Tick(1.0), [*answers("ball"), *answers("zzz", look_age=math.inf)])
    sink.take(Diagnostic(1.0, "perception", "no such word", "zzz"), [])
    assert sink.loop.followed[-1] == ["ball"]
    assert [(one["problem"], one["question"]) for one in said("problem")] == [("No such word.", 7)]
    assert {one["question"] for one in said("step")} == {0}
    sink.ask("cup", 8)
    sink.take(ObservationReceived(1.0, 1.0, 1.0, "cup", (ball(),), 0.1), [])
    assert sink.loop.followed[-1] == ["cup"]
    sink.take(Tick(1.0), answers("ball", "cup"))
    assert [(one.header["type"], one.header["question"]) for one in messages[-2:]] == [("scene", 8), ("step", 8)]
    sink.close()
    sink.ask("ball", 9)
    assert (said("problem")[-1]["question"], "has ended" in said("problem")[-1]["problem"]) == (9, True)


def test_a_picture_waits_for_its_pose_but_not_for_ever():
    messages, core, estimate = [], LiveCore(LoopSettings(("ball",))), estimate_of(0.2)
    sink = sink_of(messages, core=core)

    def pictures(now):
        sink.take(Tick(now), [Answer(now, "ball", estimate, None, 0.1, 0.1)])
        return [each.header["panorama"]["stamp"] for each in messages if "panorama" in each.header]

    for number in range(4):
        frame = ImageReceived(1.0 + number / 10, 1.0 + number / 10, "", np.full((64, 128, 3), number, np.uint8))
        core.take(frame)
        sink.take(frame, [])
    assert pictures(1.4) == []
    core.take(PoseReceived(1.4, Pose(1.1, np.eye(3)), of_picture=True))
    assert pictures(1.4) == [1.1]
    assert pictures(1.7) == [1.1]
    assert pictures(2.5) == [1.1, 1.3]


def test_what_a_recording_shows_last_stays_and_is_given_again_to_whoever_asks(tmp_path):
    for name in "ab":
        Image.fromarray(np.zeros((16, 32, 3), np.uint8)).save(tmp_path / f"{name}.png")
    frames = iter(played := PacedFootage(open_footage([tmp_path], rate=100.0)))
    assert [next(frames).name for _ in range(2)] == ["a.png", "b.png"]
    played.pause(False)
    shown = next(frames)
    assert shown.name == "b.png"
    assert shown.stamp > 0.01
    played.close()
    assert list(frames) == []


@pytest.mark.filterwarnings("ignore")
def test_a_picture_is_answered_before_the_next_one_is_read_and_a_word_that_is_not_known_ends_nothing(tmp_path):
    Image.fromarray(np.full((64, 128, 3), (200, 30, 30), np.uint8)).save(tmp_path / "a.png")
    played, said = PacedFootage(open_footage([tmp_path])), queue.SimpleQueue()
    sink = StudioSink(said.put, Opening("a.png", "a.png", "red ball", "colour", 1, poses="still"), played)
    sink.loop = Loop(played, None, "colour", "red ball", sinks=[sink])
    thread = threading.Thread(target=sink.loop.run, args=[lambda _: None])
    thread.start()
    try:
        for query, number, kind in (("ball", 2, "problem"), ("blue ball", 3, "step")):
            while said.get(timeout=60).header["type"] != "step":
                pass
            sink.ask(query, number)
            while (header := said.get(timeout=60).header)["question"] != number or header["type"] != kind:
                pass
            assert sink.query == {2: "red ball", 3: "blue ball"}[number]
            if number == 2:
                sink.ask("red ball", 4)
    finally:
        sink.loop.stop()
        played.close()
        thread.join()


# --- runs, and the file of an episode ---


@given(st.text(max_size=30), st.text(max_size=30))
def test_keys_are_safe_in_an_address_and_tell_cases_apart(a, b):
    assert not {*runs.key_of(a)} & {*"/%?#\\"}
    assert (runs.key_of(a) == runs.key_of(b)) == (a == b)


def test_a_run_is_found_by_its_name_alone(tmp_path):
    root, outside = tmp_path / "runs", tmp_path / "outside"
    for folder in (root / "mine", outside, root / ".hidden", root / "empty"):
        folder.mkdir(parents=True)
        if folder.name != "empty":
            (folder / "run.json").write_text("{}")
    (root / "link").symlink_to(outside)
    assert list(runs.runs_in(root)) == ["mine"]
    assert runs.folder_of(root, "mine") == root / "mine"
    for name in ("..", "../outside", "/etc", "link", ".hidden", "empty", "", "mine/", "mine/../../outside", "\0"):
        with pytest.raises(EagorError, match="no run"):
            runs.folder_of(root, name)
    assert list(runs.runs_in(outside)) == ["."]
    assert runs.runs_in(tmp_path / "nowhere") == {}


@pytest.mark.parametrize(
    ("task", "settings", "says"),
    [
        ({}, {"task": "navigation"}, "no episode has a result, 2 could not be run"),
        ({"agents": {"eagor": "ours"}}, {"agent": "eagor"}, "still pictures"),
    ],
)
def test_a_run_of_which_no_episode_can_be_shown_says_why(task, settings, says):
    failed = [{"key": f"e{k}", "attempt": 1, "status": "failed", "error": "no"} for k in range(2)]
    run = Run(SimpleNamespace(name="some task", **task), settings, failed)
    with pytest.raises(EagorError, match=says):
        runs.episode_of(run, None)


def test_words_from_outside_cannot_leave_their_place_in_the_page(monkeypatch, tmp_path):
    template = tmp_path / "export.html"
    template.write_text('<p>page</p><script type="application/json" id="episode"></script><p>end</p>')
    monkeypatch.setattr(runs, "TEMPLATE", template)
    scene = {"title": "</script><script>alert(1)</script><!--\u2028", "methods": [{"name": "eagor"}], "method": "eagor"}
    text = runs.page_of(
        EpisodeReplay(scene, [{"stamp": 0.0, "world_R_camera": [], "error_deg": math.nan}], {0: b"\xff"})
    )
    assert text.count("</script>") == 1
    assert text.count("<!--") == 0
    held = json.loads(text.split('id="episode">')[1].split("</script>")[0])
    assert held["scene"]["title"] == scene["title"]
    assert held["steps"][0]["error_deg"] is None
    assert held["steps"][0]["panorama"]["url"].startswith("data:image/jpeg;base64,")
