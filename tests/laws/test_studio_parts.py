"""Parts of the studio's server, each alone: messages, slots, plans, who may speak, names of runs, how a body walks."""

import asyncio
import io
import json
import math
import struct
from contextlib import suppress
from dataclasses import replace
from multiprocessing import Pipe
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from starlette.datastructures import Headers

from eagor.cameras import Lens
from eagor.errors import EagorError, ImageError
from eagor.evidence import Evidence
from eagor.grids import PerspectiveGrid
from eagor.lab.eval.results import Run
from eagor.live.core import LiveCore, LoopSettings
from eagor.live.events import Answer, Asked, EvidenceCame, FrameCame, PoseCame, Trouble
from eagor.media import Pose
from eagor.media.intrinsics import ShapeError
from eagor.sphere import angular_distance, world_R_body
from eagor.studio import eye, runs
from eagor.studio.guard import Gate
from eagor.studio.houses import Body, Walker, outlines
from eagor.studio.hub import Channel, Slot
from eagor.studio.live import Shown, Waiting, watch
from eagor.studio.messages import LONGEST, Blob, Message, PageError, merged, packed, read, rounded
from eagor.studio.picture import PictureSession, VideoSession
from eagor.studio.replays import Redrawn
from eagor.studio.runs import page_of
from eagor.studio.session import Loaded, Opened, Opening, Outbox, Question, Refused, See, Seen, Turn, Turned
from eagor.studio.steps import lens_of, shown_jpeg
from eagor.tracking import Around, TrackerConfig
from eagor.tracking.follower import Follower


def unpacked(frame):
    (length,) = struct.unpack("<I", frame[:4])
    header, rest = json.loads(frame[4 : 4 + length]), frame[4 + length :]
    blobs = {}
    for each in header["blobs"]:
        blobs[each["name"]], rest = rest[: each["bytes"]], rest[each["bytes"] :]
    assert rest == b""
    return header, blobs


def step(number, **parts):
    blobs = {name: Blob("float32", content) for name, content in parts.items()}
    return Message({"type": "step", "number": number} | {name: {"of": number} for name in parts}, blobs)


def test_a_frame_holds_its_header_and_its_blobs():
    message = step(3, belief=b"12345678", panorama=b"")
    header, blobs = unpacked(packed(message))
    assert header["number"] == 3
    assert blobs == {"belief": b"12345678", "panorama": b""}


def test_numbers_that_json_lacks_are_refused_and_rounding_removes_them():
    with pytest.raises(ValueError, match="JSON"):
        packed(Message({"type": "step", "number": math.nan}))
    assert rounded({"a": [math.inf, np.array([1.0000004, math.nan])]}) == {"a": [None, [1.0, None]]}


def test_a_slow_client_misses_steps_but_no_picture_and_no_belief():
    found = merged(merged(step(1, panorama=b"p1", belief=b"b1"), step(2, belief=b"b2")), step(3))
    assert found.header["number"] == 3
    assert found.header["panorama"] == {"of": 1}
    assert {name: blob.content for name, blob in found.blobs.items()} == {"panorama": b"p1", "belief": b"b2"}


def test_a_slot_never_grows_and_gives_words_before_steps():
    async def scenario():
        slot = Slot()
        for number in range(1000):
            slot.put(step(number, belief=bytes(100)))
            slot.put(Message({"type": "status", "words": str(number)}))
        got = [await slot.get() for _ in range(33)]
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(slot.get(), 0.01)
        return got

    got = asyncio.run(scenario())
    assert [message.header["words"] for message in got[:-1]] == [str(number) for number in range(968, 1000)]
    assert got[-1].header["number"] == 999


def test_a_slot_that_is_cleared_as_its_reader_wakes_waits_on():
    async def scenario():
        slot = Slot()
        reader = asyncio.create_task(slot.get())
        await asyncio.sleep(0)  # it waits
        slot.put(step(1))
        slot.clear()  # another view is opened before the reader has its turn
        await asyncio.sleep(0)
        slot.put(step(2))
        return (await reader).header["number"]

    assert asyncio.run(scenario()) == 2


def test_a_new_scene_drops_the_steps_of_the_old_one():
    async def scenario():
        slot = Slot()
        slot.put(step(1))
        slot.put(Message({"type": "scene"}))
        slot.put(step(2))
        return [(await slot.get()).header for _ in range(2)]

    assert [(header["type"], header.get("number")) for header in asyncio.run(scenario())] == [
        ("scene", None),
        ("step", 2),
    ]


def test_a_page_that_reads_nothing_delays_no_other():
    from eagor.studio.hub import Page
    from eagor.studio.server import _send

    class Web:
        def __init__(self, blocked):
            self.sent, self.blocked = [], blocked

        async def send_bytes(self, frame):
            if self.blocked:
                await asyncio.Event().wait()
            self.sent.append(unpacked(frame)[0]["number"])

    async def scenario():
        pages, webs = [Page(), Page()], [Web(True), Web(False)]
        tasks = [asyncio.create_task(_send(page, web)) for page, web in zip(pages, webs, strict=True)]
        for number in range(50):
            for page in pages:
                page.slot.put(step(number, panorama=bytes(1000)))
            await asyncio.sleep(0)
            await asyncio.sleep(0)
        for task in tasks:
            task.cancel()
        return webs

    slow, quick = asyncio.run(scenario())
    assert slow.sent == []
    assert quick.sent == list(range(50))


def test_who_comes_late_to_a_live_source_gets_all_that_is_needed():
    async def scenario():
        channel, slot = Channel(), Slot()
        for message in (Message({"type": "scene"}), step(1, panorama=b"p"), step(2, belief=b"b"), step(3)):
            channel.put(message)
        channel.join(slot)
        return [await slot.get() for _ in range(2)]

    scene, found = asyncio.run(scenario())
    assert scene.header["type"] == "scene"
    assert found.header["number"] == 3
    assert set(found.blobs) == {"panorama", "belief"}


# --- what a page may say ---


def test_a_message_gets_the_defaults_of_its_fields():
    found = read('{"type":"open","view":"walk","query":" red   chair "}')
    assert found["query"] == "red chair"
    assert (found["drive"], found["seed"], found["methods"]) == ("policy", None, [])
    assert read('{"type":"drive","turn":1}') == {
        "type": "drive",
        "by": "person",
        "forward": 0.0,
        "turn": 1.0,
        "seconds": 0.0,
    }


@pytest.mark.parametrize(
    "text",
    [
        "", "null", "[]", "{}", '"open"', "{", '{"type":1}', '{"type":["open"]}', '{"type":"no"}', '{"type":"open"}',
        '{"type":"open","view":"attic"}', '{"type":"open","view":"walk","seed":-1}',
        '{"type":"open","view":"walk","seed":1.5}', '{"type":"open","view":"walk","seed":true}',
        '{"type":"query","text":"' + "x" * 300 + '"}', '{"type":"query","text":"..."}',
        '{"type":"query","text":"a\\u0000"}',
        '{"type":"drive","forward":NaN}', '{"type":"drive","forward":1e999}', '{"type":"drive","seconds":9}',
        '{"type":"camera","yaw":"up"}',
        '{"type":"degree","L":64}', '{"type":"methods","names":"vmf"}', '{"type":"pause","on":1}',
        '{"type":"seek","frame":' + "9" * 400 + "}", "[" * 300 + "]" * 300, "x" * (LONGEST + 1),
    ],
)  # fmt: skip
def test_rubbish_is_refused_with_what_was_wanted(text):
    with pytest.raises(PageError) as refused:
        read(text)
    assert refused.value.problem
    assert refused.value.change


@given(st.one_of(st.text(max_size=200), st.binary(max_size=200)))
def test_no_text_breaks_the_reader(text):
    with suppress(PageError):
        assert read(text)["type"]


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@given(
    st.sampled_from(["open", "query", "drive", "camera", "pause", "seek", "degree", "methods", "restart"]),
    st.dictionaries(
        st.sampled_from(["view", "query", "seed", "text", "forward", "yaw", "on", "L", "names", "id"]), JSON
    ),
)
def test_no_field_breaks_the_reader(kind, fields):
    with suppress(PageError):
        assert read(json.dumps({**fields, "type": kind}))["type"] == kind


# --- who may speak ---


def scope(query=""):
    return {"query_string": query.encode()}


def test_without_a_token_only_this_machine_is_spoken_to():
    gate = Gate("127.0.0.1")
    assert gate.names("127.0.0.1:8360")
    assert gate.names("localhost:8360")
    assert gate.names("[::1]:8360")
    for host in ("evil.example", "127.0.0.1.evil.example", "", "192.168.0.7:8360"):
        assert not gate.names(host)


def test_pages_of_other_sites_are_refused():
    gate = Gate("127.0.0.1")
    here = {"host": "127.0.0.1:8360"}
    assert gate.from_here(Headers(here))  # no page at all
    assert gate.from_here(Headers(here | {"origin": "http://127.0.0.1:8360"}))
    for origin in ("http://evil.example", "http://127.0.0.1:9999", "null", "http://127.0.0.1:8360.evil.example"):
        assert not gate.from_here(Headers(here | {"origin": origin}))


def test_the_token_is_known_from_the_address_the_cookie_or_a_header():
    gate = Gate("0.0.0.0", "a-long-enough-token")
    assert gate.knows(scope("token=a-long-enough-token"), Headers({}))
    assert gate.knows(scope(), Headers({"cookie": "other=1; eagor_token=a-long-enough-token"}))
    assert gate.knows(scope(), Headers({"authorization": "Bearer a-long-enough-token"}))
    for query, headers in (("", {}), ("token=wrong", {}), ("", {"cookie": "eagor_token=ä"}), ("token=", {})):
        assert not gate.knows(scope(query), Headers(headers))


# --- the plan ---


def area(line):
    x, y = line[:, 0].astype(float), line[:, 1].astype(float)
    return 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


@given(st.lists(st.lists(st.booleans(), min_size=5, max_size=5), min_size=1, max_size=7))
def test_outlines_enclose_exactly_the_cells(cells):
    mask = np.array(cells)
    lines = outlines(mask)
    assert sum(area(line) for line in lines) == pytest.approx(mask.sum())  # holes count negative
    for line in lines:
        assert (line[0] == line[-1]).all()
        steps = np.diff(line, axis=0)
        assert ((steps == 0).sum(axis=1) == 1).all()  # along the axes
        assert (np.sign(steps) != np.sign(np.roll(steps, 1, axis=0))).any(axis=1).all()  # corners alone


# --- names of runs ---


@given(st.text(max_size=30), st.text(max_size=30))
def test_keys_are_safe_in_an_address_and_tell_cases_apart(a, b):
    assert not {*runs.key_of(a)} & {*"/%?#\\"}
    assert (runs.key_of(a) == runs.key_of(b)) == (a == b)


def test_a_run_is_found_by_its_name_alone(tmp_path):
    root, outside = tmp_path / "runs", tmp_path / "outside"
    for folder in (root / "mine", outside):
        folder.mkdir(parents=True)
        (folder / "run.json").write_text("{}")
    (root / "link").symlink_to(outside)
    (root / ".hidden").mkdir()
    (root / ".hidden" / "run.json").write_text("{}")
    (root / "empty").mkdir()
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
    assert not runs.episodes_of(run)["playable"]
    with pytest.raises(EagorError, match=says):
        runs.episode_of(run, None)


# --- the body ---


class Hall:
    """An empty floor, with a wall at x = 1."""

    def move(self, xy, step, slide=True):
        there = xy + step
        return (np.array([min(there[0], 1.0), there[1]]), there[0] > 1.0)

    def height(self, xy):
        return 0.0


def test_the_person_steers_and_cannot_be_faster_than_allowed():
    walker = Walker(Body(Hall(), np.zeros(2), 0.0), "person")
    assert not walker.move(60.0, None, False)  # nothing is steered
    walker.steer(100.0, 0.0, 0.1)
    assert 0 < walker.body.xy[0] <= 0.2
    assert walker.move(0.1, None, False)
    for _ in range(20):
        walker.steer(100.0, 0.0, 0.1)
    assert walker.body.xy[0] == 1.0
    walker.steer(0.0, 1.0, 0.4)
    assert walker.body.yaw == pytest.approx(0.4), "as far as the key was held, however late that is read"
    assert walker.move(0.1, None, False)
    walker.steer(0.0, 0.0, 0.1)
    assert not walker.move(0.1, None, False)
    walker.drive("policy")
    walker.steer(100.0, 1.0, 0.5)  # a late message
    assert walker.body.yaw == pytest.approx(0.4)


def test_the_policy_makes_no_leap_after_a_late_tick():
    walker = Walker(Body(Hall(), np.array([-4.0, 0.0]), 0.0))
    walker.move(60.0, np.array([1.0, 0.0, 0.0]), False)
    assert -4.0 < walker.body.xy[0] < -3.5


def test_the_policy_walks_to_the_answer_and_stops_on_arrival():
    walker = Walker(Body(Hall(), np.array([-4.0, 0.0]), 2.0))
    for _ in range(100):
        ahead = walker.body.world_R_body.T @ np.array([1.0, 0.0, 0.0])
        walker.move(0.1, ahead, False)
    assert walker.body.xy[0] > -2.0
    assert not walker.move(0.1, np.array([1.0, 0.0, 0.0]), True)
    yaw = walker.body.yaw
    walker.drive("person")
    walker.drive("policy")
    assert walker.move(0.1, None, False)  # nothing is known: it looks around
    assert walker.body.yaw != yaw


# --- the file of an episode ---


def test_words_from_outside_cannot_leave_their_place_in_the_page(monkeypatch, tmp_path):
    template = tmp_path / "export.html"
    template.write_text('<p>page</p><script type="application/json" id="episode"></script><p>end</p>')
    monkeypatch.setattr("eagor.studio.runs._template", lambda: template)
    scene = {"title": "</script><script>alert(1)</script><!--\u2028", "methods": [{"name": "eagor"}], "method": "eagor"}
    text = page_of(Redrawn(scene, [{"stamp": 0.0, "world_R_camera": [], "error_deg": math.nan}], {0: b"\xff\xd8"}))
    assert text.count("</script>") == 1
    assert text.count("<!--") == 0
    held = json.loads(text.split('id="episode">')[1].split("</script>")[0])
    assert held["scene"]["title"] == scene["title"]
    assert held["steps"][0]["error_deg"] is None
    assert held["steps"][0]["panorama"]["url"].startswith("data:image/jpeg;base64,")


# --- questions ---


class Heard:
    """A session, with what it orders from the eye and says to its page."""

    def __init__(self, kind, opening):
        self.orders, self.said = [], []
        self.session = kind(1, opening, Outbox(lambda _, message: self.said.append(message.header), self.orders.append))
        self.hears(Loaded(1, opening.question.perception, {"words": "", "numbers": {}}))

    def hears(self, *said):
        for each in said:
            self.session.saw(each, 0.0)

    def looks(self):
        """The questions that it has looks taken for, once it has had its turn."""
        self.session.tick(0.0)
        return [order.question for order in self.orders if isinstance(order, See | Turn)]

    def sees(self, evidence=()):
        """The newest look is taken."""
        order = next(order for order in reversed(self.orders) if isinstance(order, See | Turn))
        if isinstance(order, Turn):
            self.frames = getattr(self, "frames", -1) + 1
            self.hears(Turned(1, 0.25 * self.frames, np.eye(3), b"", order.question, tuple(evidence)))
        else:
            self.hears(Seen(1, order.stamp, order.question, tuple(evidence)))

    def told(self, kind):
        return [one for one in self.said if one["type"] == kind]


@pytest.fixture(params=[PictureSession, VideoSession])
def heard(request, tmp_path):
    opening = Opening("picture", Question("red ball", "colour", 1), picture=tmp_path / "a.png", frames=8)
    found = Heard(request.param, opening)
    if request.param is PictureSession:
        found.hears(Opened(1, b"", ()))
    return found


def ball():
    return Evidence.from_points(np.array([[1.0, 0.1, 0.0]]), scores=np.full(1, 0.9))


def test_what_answers_a_question_carries_its_number_and_a_new_one_is_answered_from_its_first_look_on(heard):
    heard.looks()
    heard.sees([ball()])
    heard.looks()
    assert {one["question"] for one in heard.told("step")} == {1}
    heard.session.told({"type": "query", "text": "blue ball", "perception": "", "question": 2}, 0.0)
    while heard.looks()[-1].query != "blue ball":
        heard.sees([ball()])  # what was under way
    assert [one["question"] for one in heard.told("scene")] == [1], "nothing changes before a look is taken"
    heard.sees([ball()])
    heard.looks()
    scene, step = heard.told("scene")[-1], heard.told("step")[-1]
    assert (scene["question"], scene["query"], step["question"]) == (2, "blue ball", 2)


def test_a_question_that_is_refused_changes_nothing(heard):
    heard.looks()
    heard.sees([ball()])
    heard.looks()
    known = heard.told("step")[-1]["estimate"]["presence"]
    heard.session.told({"type": "query", "text": "unicorn", "perception": "", "question": 2}, 0.0)
    while (asked := heard.looks()[-1]).query != "unicorn":
        heard.sees([ball()])
    heard.hears(Refused(1, "query", "there are no unicorns", asked))
    if isinstance(heard.session, VideoSession):
        heard.hears(Turned(1, 9.0, np.eye(3), b"", None))
    heard.looks()
    assert [(one["problem"], one["question"]) for one in heard.told("problem")] == [("there are no unicorns", 2)]
    assert [one["question"] for one in heard.told("scene")] == [1]
    assert heard.told("step")[-1]["question"] == 1
    assert heard.told("step")[-1]["estimate"]["presence"] >= 0.9 * known
    heard.hears(Refused(1, "query", "too late", asked))
    assert len(heard.told("problem")) == 1, "nobody asks for it any more"


def test_what_is_asked_before_a_view_is_ready_is_asked(tmp_path):
    found = Heard(PictureSession, Opening("picture", Question("red ball", "colour", 1), picture=tmp_path / "a.png"))
    found.session.told({"type": "query", "text": "bed", "perception": "coco", "question": 2}, 0.0)
    assert found.orders[-1] == ("perception", 1, "coco")
    found.hears(Opened(1, b"", ()))
    assert found.looks() == [], "its perception is not loaded yet"
    found.hears(Loaded(1, "coco", {"words": "", "numbers": {}}))
    assert found.looks() == [Question("bed", "coco", 2)]
    (scene,) = found.told("scene")
    assert (scene["question"], scene["query"], scene["perception"]) == (2, "bed", "coco")


def test_a_paused_view_answers_a_new_question_and_stands_still_again(heard):
    heard.looks()
    heard.sees([ball()])
    heard.looks()
    heard.session.told({"type": "pause", "on": True}, 0.0)
    if isinstance(heard.session, VideoSession):
        heard.sees()  # the frame that was under way
    before = len(heard.looks())
    heard.session.told({"type": "query", "text": "blue ball", "perception": "", "question": 2}, 0.0)
    assert heard.looks()[before:] == [Question("blue ball", "colour", 2)]
    heard.sees([ball()])
    heard.looks()
    assert heard.told("step")[-1]["question"] == 2
    assert len(heard.looks()) == before + 1


class Loop:
    """What a live source's watcher needs of the loop: it notes what is followed."""

    def __init__(self):
        self.core = SimpleNamespace(config=TrackerConfig(), queries=("ball",), around=None)
        self.followed = []
        self.follow = self.followed.append


def test_a_live_source_goes_on_with_the_question_before_one_that_is_refused():
    said, estimate = [], Follower()
    estimate.move(0.0, np.eye(3))
    estimate.look(replace(ball(), stamp=0.0))
    shown = Shown(lambda message: said.append(message.header), "camera", "colour")
    shown.loop = Loop()

    def answers(query, look_age=0.1):
        return [Answer(1.0, query, estimate.estimate(1.0), None, look_age, 0.1)]

    shown.take(Asked(1.0), answers("ball"))
    shown.ask("zzz", 7)
    assert shown.loop.followed[-1] == ["ball", "zzz"]
    shown.take(Asked(1.0), answers("ball") + answers("zzz", math.inf))
    shown.take(Trouble(1.0, "perception", "no such word", "zzz"), [])
    assert shown.loop.followed[-1] == ["ball"]
    assert [(one["problem"], one["question"]) for one in said if one["type"] == "problem"] == [("No such word.", 7)]
    assert {one["question"] for one in said if one["type"] == "step"} == {0}
    shown.ask("cup", 8)
    shown.take(EvidenceCame(1.0, 1.0, None, "cup", (), 0.1), [])
    assert shown.loop.followed[-1] == ["cup"]
    shown.take(Asked(1.0), answers("ball") + answers("cup"))
    assert [(one["type"], one["question"]) for one in said[-2:]] == [("scene", 8), ("step", 8)]
    shown.ask("tv", 10)  # it was seen before anybody asked
    shown.take(Asked(1.0), answers("cup") + answers("tv"))
    assert [(one["type"], one["question"]) for one in said[-2:]] == [("scene", 10), ("step", 10)]
    shown.close()
    shown.ask("ball", 9)
    assert (said[-1]["type"], said[-1]["question"]) == ("problem", 9)


def test_a_live_source_asks_how_wide_its_camera_sees():
    ours, theirs = Pipe()
    tried = []

    def opens(watchers, hfov):
        tried.append(hfov)
        raise ShapeError("it gives 4 x 3, not 2:1; wanted more") if hfov is None else ImageError("it is unplugged")

    for told in (("query", "ball", 1), ("hfov", 65.0), None):
        ours.send(told)
    watch(theirs, "camera", "colour", opens)
    theirs.close()
    first, second = ours.recv().header, ours.recv().header
    assert tried == [None, 65.0]
    assert (first["asks"], first["problem"]) == ("hfov", "It gives 4 x 3, not 2:1.")
    assert ("asks" in second, second["problem"]) == (False, "It is unplugged.")


def test_a_live_picture_waits_for_its_pose_but_not_for_ever():
    waiting, core = Waiting(), LiveCore(LoopSettings(("ball",)))
    for number in range(4):
        frame = FrameCame(1.0 + number / 10, 1.0 + number / 10, str(number))
        core.take(frame)
        waiting.add(frame)
    assert waiting.take(core, 1.4) is None
    core.take(PoseCame(1.4, Pose(1.1, np.eye(3)), of_picture=True))
    assert waiting.take(core, 1.4).name == "1"
    assert waiting.take(core, 1.5) is None
    assert waiting.take(core, 2.5).name == "3"


def test_what_several_cameras_show_is_pasted_together():
    """The page gets one panorama in the body's axes, and no lens; what none has shown is dark."""
    said, estimate = [], Follower()
    estimate.move(0.0, np.eye(3))
    shown = Shown(said.append, "cameras", "colour")
    shown.loop = Loop()
    shown.loop.core = LiveCore(LoopSettings(("ball",)))
    for lens, colour in enumerate((80, 160)):
        grid = PerspectiveGrid(30, 40, math.radians(80), world_R_body(math.pi * lens))
        for number in range(3):  # one of each is taken
            stamp = 1.0 + number / 100 + lens / 1000
            frame = FrameCame(stamp, stamp, "", np.full((30, 40, 3), colour, np.uint8), grid, lens)
            shown.loop.core.take(PoseCame(stamp, Pose(stamp, world_R_body(0.3)), of_picture=False))
            shown.loop.core.take(frame)
            shown.take(frame, [])
    shown.take(Asked(2.5), [Answer(2.5, "ball", estimate.estimate(2.5), None, 0.1, 0.1)])
    scene, step = said
    assert "lens" not in scene.header
    with Image.open(io.BytesIO(step.blobs["panorama"].content)) as picture:
        pixels = np.asarray(picture.convert("L"), dtype=float)
    row, quarter = len(pixels) // 2, len(pixels) // 2
    seen = [pixels[row, at] for at in (2 * quarter, 2, quarter, 3 * quarter)]
    assert seen == pytest.approx([80, 160, 22, 22], abs=6)
    np.testing.assert_allclose(step.header["panorama"]["world_R_camera"], world_R_body(0.3).reshape(9), atol=1e-5)


@pytest.mark.filterwarnings("error")
def test_an_ordinary_photograph_of_the_page_is_opened_without_a_warning(tmp_path):
    Image.new("RGB", (40, 30)).save(tmp_path / "a.png")
    said = []
    eye._build(("picture", 1, tmp_path / "a.png", 1.0), said.append)
    assert said[0].lens is not None


def test_what_else_is_here_is_listed_and_a_question_for_one_of_it_is_answered_at_once(heard):
    sofa = np.array([[0.2, -1.0, 0.1]])

    def sees():
        around = Around(
            {"ball": ball(), "sofa": Evidence.from_points(sofa, scores=np.full(1, 0.9))},
            Evidence.from_points(np.zeros((0, 3))),
        )
        order = next(order for order in reversed(heard.orders) if isinstance(order, See | Turn))
        if isinstance(order, Turn):
            heard.hears(Turned(1, 0.25, np.eye(3), b"", order.question, (ball(),), around=around))
        else:
            heard.hears(Seen(1, order.stamp, order.question, (ball(),), around))

    def work():
        for number in range(20):
            heard.session.tick(float(number))
        return [step["things"] for step in heard.told("step") if "things" in step][-1]

    heard.looks()
    sees()
    # A video that plays would say it with its next frame.
    heard.session.told({"type": "pause", "on": isinstance(heard.session, VideoSession)}, 0.0)
    assert {(one["query"], one["seen"], one["of"]) for one in work()} == {("ball", 1, 1), ("sofa", 1, 1)}
    heard.session.told({"type": "pause", "on": True}, 0.0)
    heard.session.told({"type": "query", "text": "sofa", "perception": "", "question": 5}, 0.0)
    heard.session.tick(30.0)
    step = heard.told("step")[-1]
    assert step["question"] == 5, "no look for it was taken"
    assert angular_distance(np.array(step["estimate"]["direction"]), sofa[0] / np.linalg.norm(sofa)) < 0.05
    assert {one["query"] for one in step["things"]} == {"ball", "sofa"}, "they outlast a question"
    heard.session.told({"type": "restart"}, 0.0)
    heard.session.tick(31.0)
    assert heard.session._around.names == (), "to begin again is to know nothing"


def test_an_ordinary_lens_is_told_in_tangents_and_its_picture_is_sent_as_the_ideal_lens_sees_it() -> None:
    picture = np.zeros((200, 300, 3), np.uint8)
    picture[90:110, 240:260] = 255
    bent = Lens("bent", (300, 200), (150.0, 150.0), (150.0, 100.0), (-0.05, 0.0, 0.0, 0.0), np.eye(3))
    grid = PerspectiveGrid.of_lens(bent)
    told = lens_of(grid)
    assert told is not None
    assert lens_of(None) is None
    wide, high = told["plane"]
    assert wide == pytest.approx(math.tan(grid.hfov / 2), abs=1e-5)
    assert high / wide == pytest.approx(2 / 3, abs=1e-5)
    shown = np.asarray(Image.open(io.BytesIO(shown_jpeg(picture, grid, 100))).convert("L")).astype(float)
    assert shown.shape == (100, 150)
    row, column = (float((index * shown).sum() / shown.sum()) for index in np.indices(shown.shape))
    seen = grid.unproject(np.array([250.0]), np.array([100.0]))[0]
    assert column + 0.5 == pytest.approx(75 * (1 - seen[1] / seen[0] / wide), abs=1.5)
    assert row + 0.5 == pytest.approx(50, abs=1)
