"""Sources of pictures: files, streams, pipes; each keeps the contract, and says in words what is wrong."""

import io
import math
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise

import clips
import numpy as np
import pytest
from PIL import Image
from rigs import seen_by

from eagor.cameras import Lens, Rig, dual_fisheye
from eagor.errors import DeviceError, FormatError, ImageError, TimeError
from eagor.lab.worlds.painted import painted_room
from eagor.odometry.clocks import PROBATION, TimestampDejitter
from eagor.sources import check_camera
from eagor.sources.camera_sources import open_source
from eagor.sources.intrinsics import camera_of
from eagor.sources.live_camera import BYTES, FrameGrabber, LiveCamera, Stream, device, raw_pipe
from eagor.sphere import world_R_body

av = pytest.importorskip("av")
ROOM = clips.ROOM
LENSES = dual_fisheye(256, 128)
CIRCLES = seen_by(LENSES, painted_room(128, 256))[0]
WAIT = 30.0  # seconds: far more than anything here takes


def until(holds, what):
    """Wait for an event."""
    end = time.monotonic() + WAIT
    while not holds():
        assert time.monotonic() < end, f"no {what} within {WAIT:g} s"
        time.sleep(0.01)


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def sending(address, *, picture=ROOM, rate=25, container="mpegts"):
    """A thread that sends pictures to an address in real time; yields the function that stops it."""
    stop = threading.Event()

    def send():
        with av.open(address, "w", format=container) as output:
            stream = output.add_stream("libx264", rate=rate)
            stream.height, stream.width = picture.shape[:2]
            stream.pix_fmt, stream.options = "yuv420p", {"g": "5", "tune": "zerolatency", "preset": "ultrafast"}
            begin, k = time.monotonic(), 0
            while not stop.is_set():
                frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
                frame.pts = k
                output.mux(stream.encode(frame))
                k += 1
                stop.wait(max(0.0, begin + k / rate - time.monotonic()))

    thread = threading.Thread(target=send, daemon=True)
    thread.start()

    def ended():
        stop.set()
        thread.join(WAIT)

    try:
        yield ended
    finally:
        ended()


def raw(pictures, stamps=None):
    """Pictures as bytes, each after its stamp if there are stamps."""
    heads = [b""] * len(pictures) if stamps is None else [struct.pack("<d", stamp) for stamp in stamps]
    return io.BytesIO(b"".join(head + picture.tobytes() for head, picture in zip(heads, pictures, strict=True)))


# --- files -----------------------------------------------------------------------------------------------------------


def folder(tmp_path, pictures, names=None):
    place = tmp_path / "frames"
    place.mkdir()
    for number, picture in enumerate(pictures):
        Image.fromarray(picture).save(place / (f"{number}.png" if names is None else names[number]))
    return place


@pytest.mark.parametrize("kind", ["folder", "video"])
def test_recordings_keep_the_contract(tmp_path, kind):
    place = folder(tmp_path, clips.rolled(12)) if kind == "folder" else clips.clip(tmp_path / "a.mp4", rate=4)
    check_camera(open_source(str(place)))
    check_camera(open_source(str(place), camera=camera_of(70.0, None), rows=50))
    camera = open_source(str(place), rate=4, latency=0.5, rows=32)
    frames = [frame for frame, _ in zip(camera, range(12), strict=False)]
    assert [frame.stamp for frame in frames] == pytest.approx([k / 4 - 0.5 for k in range(12)], abs=1e-3)
    assert frames[0].picture.shape == (32, 64, 3)
    assert not camera.live
    if kind == "folder":
        assert [frame.name for frame in frames] == [f"{k}.png" for k in range(12)], "10 comes after 9"


def test_a_picture_of_a_folder_that_cannot_be_used_says_why_and_is_counted(tmp_path):
    place = folder(tmp_path, clips.rolled(4))
    (place / "1.png").write_bytes(b"nothing")
    Image.fromarray(ROOM[:, :100]).save(place / "2.png")
    camera = open_source(str(place))
    problems = {frame.name: frame.problem for frame in camera if frame.picture is None}
    assert "1.png" in problems["1.png"]
    assert "not 2:1" in problems["2.png"]
    assert camera.dropped == len(problems) == 2


def test_each_lens_may_have_its_own_file(tmp_path):
    """Two videos with a comma between, or the two recordings that an Insta360 camera makes of one moment."""
    halves = [np.ascontiguousarray(CIRCLES[:, :128]), np.ascontiguousarray(CIRCLES[:, 128:])]
    text = (
        "pictures:\n  - {width: 128, height: 128}\n  - {width: 128, height: 128}\nlenses:\n"
        "  - {name: front, centre: [64, 64], radius: 64, field_deg: 200}\n"
        "  - {name: back, picture: 1, centre: [64, 64], radius: 64, field_deg: 200, rotation: {yaw_deg: 180}}\n"
    )
    rig = tmp_path / "rig.yaml"
    rig.write_text(text)
    names = ["VID_20260101_120000_00_001.insv", "VID_20260101_120000_10_001.insv"]
    videos = [clips.clip(tmp_path / f"{k}.mp4", [half] * 5, options={"crf": "10"}) for k, half in enumerate(halves)]
    both = f"{videos[0]},{videos[1]}"
    wanted = next(iter(open_source(both, rig=rig))).picture
    for video, name in zip(videos, names, strict=True):
        video.rename(tmp_path / name)
    found = next(iter(open_source(str(tmp_path / names[1]), rig=rig))).picture
    assert np.array_equal(found, wanted), "the front lens comes first, whichever file is named"
    whole = open_source(str(folder(tmp_path, [CIRCLES])), rig=LENSES)
    assert np.abs(next(iter(whole)).picture.astype(int) - found).mean() < 6
    with pytest.raises(ImageError, match="the rig is for 2 pictures at a time"):
        open_source(str(tmp_path / "frames"), rig=rig)


def two_cameras():
    """A rig of two ordinary cameras, front and back, of 64 x 48 pixels."""
    ahead = Lens("front", (64, 48), (50.0, 50.0), (32.0, 24.0))
    return Rig((ahead.size,) * 2, (ahead, replace(ahead, name="back", picture=1, body_R_lens=world_R_body(math.pi))))


def test_ordinary_cameras_of_a_rig_are_one_panorama_with_a_mask(tmp_path):
    rig, grey = two_cameras(), [np.full((48, 64, 3), level, np.uint8) for level in (60, 180)]
    for name, picture in zip(("front", "back"), grey, strict=True):
        clips.clip(tmp_path / f"{name}.mp4", [picture] * 4, rate=10, options={"crf": "10"})
        (tmp_path / name).mkdir()
        for number in range(4):
            Image.fromarray(picture).save(tmp_path / name / f"{number}.png")
    for kind in ("", ".mp4"):
        both = ",".join(str(tmp_path / f"{name}{kind}") for name in ("front", "back"))
        check_camera(open_source(both, rig=rig), 4)
        camera = open_source(both, rig=rig)
        assert camera.grid.height == pytest.approx(math.pi * 50, abs=2), "as fine as the sharpest lens"
        ahead, behind = camera.grid.directions[..., 0] > 0.95, camera.grid.directions[..., 0] < -0.95
        frames = list(camera)
        assert len(frames) == 4
        for frame in frames:
            assert np.abs(frame.picture[ahead].mean() - 60) < 8
            assert np.abs(frame.picture[behind].mean() - 180) < 8
            assert (frame.picture[frame.unseen] == 0).all()
            solid = 4 * math.asin(32 * 24 / math.hypot(50, 32) / math.hypot(50, 24))
            share = float((camera.grid.weights * ~frame.unseen).sum())
            assert share == pytest.approx(2 * solid, rel=0.15), "but for the rims"


def test_a_new_picture_of_the_first_camera_goes_with_the_newest_of_the_others():
    size, streams = (48, 64), []
    for stamps in ((100.0, 100.1, 100.2, 100.3), (100.0, 100.1)):
        data = raw([np.zeros((*size, 3), np.uint8)] * len(stamps), stamps)
        streams.append(raw_pipe(f"pipe:rgb24:{size[1]}x{size[0]}:stamped", data))
    camera = LiveCamera(streams, rig=two_cameras())
    until(lambda: [grabber.newest.stamp for grabber in camera._grabbers] == [100.3, 100.1], "end")
    assert [frame.stamp for frame in camera] == [100.3]
    assert camera.dropped == 3
    assert "0.20 s apart" in camera.problem


@pytest.mark.parametrize(
    ("text", "kind", "says"),
    [
        ("/dev/video77", DeviceError, "there is no /dev/video77; this machine has"),
        ("v4l2:78", DeviceError, "there is no /dev/video78"),
        ("/dev/null", DeviceError, r"/dev/null cannot be opened \(Inappropriate ioctl"),
        ("v4l2:0?size=big", DeviceError, "size=big; wanted width and height"),
        ("v4l2:0?zoom=2", DeviceError, "no setting 'zoom'"),
        ("nothing.mp4", DeviceError, "no file or folder 'nothing.mp4'; wanted a folder"),
        ("gopher:x", DeviceError, "no source is called gopher"),
        ("pipe:rgb24:0x10", DeviceError, "at least 1"),
        ("pipe:rgb24", DeviceError, "wanted pipe:FORMAT:WIDTHxHEIGHT"),
        ("pipe:jpeg:10x10", DeviceError, "Formats: rgb24"),
        ("rtsp://viewer:topsecret@127.0.0.1:9/live", DeviceError, r"rtsp://\*\*\*@127.0.0.1:9/live cannot be opened"),
        ("http://127.0.0.1:9/live", DeviceError, "Connection refused"),
    ],
)
def test_what_is_no_camera_is_named_with_what_was_wanted(text, kind, says):
    with pytest.raises(kind, match=says) as caught:
        open_source(text)
    assert "topsecret" not in str(caught.value)


def test_a_file_is_no_device_and_a_rig_has_to_be_one(tmp_path):
    video = clips.clip(tmp_path / "a.mp4")
    with pytest.raises(DeviceError, match="is no device"):
        device(str(video))
    (tmp_path / "rig.yaml").write_text("lens: 3")
    with pytest.raises(FormatError, match="lens, and no camera_matrix"):
        open_source(str(video), rig=tmp_path / "rig.yaml")
    with pytest.raises(ImageError, match="128 x 64, and the rig is for pictures of 400 x 150"):
        open_source(str(video), rig=dual_fisheye(400, 150))


# --- live ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_stream_over_udp_keeps_the_contract_and_tells_of_a_stall():
    address = f"udp://127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    with sending(address) as stop:
        camera = open_source(address, latency=0.125, rows=32)
        assert camera.live
        frames = iter(camera)
        for _ in range(5):
            frame = next(frames)
            assert 0.125 <= time.time() - frame.stamp < WAIT
            assert frame.picture.shape == (32, 64, 3)
        assert camera.problem is None
        stop()
        until(lambda: camera.problem is not None, "word about the stall")
        assert "no picture for" in camera.problem
    waiting = threading.Thread(target=lambda: list(frames), daemon=True)
    waiting.start()
    camera.close()  # although the reader still waits for the network
    waiting.join(WAIT)
    assert not waiting.is_alive()


def test_a_live_camera_keeps_the_contract():
    address = f"udp://127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    with sending(address):
        check_camera(open_source(address))


def test_a_stream_without_pictures_or_with_another_size_is_refused():
    camera = Stream("sine=frequency=440", "a tone", "lavfi")
    with pytest.raises(DeviceError, match="a tone has no pictures, but: audio"):
        LiveCamera([camera])
    picture = Stream("testsrc=size=64x32:rate=10", "the camera", "lavfi", size=(128, 64))
    with pytest.raises(DeviceError, match="pictures of 64 x 32, not 128 x 64"):
        LiveCamera([picture])
    square = Stream("testsrc=size=64x64:rate=10", "the camera", "lavfi")
    with pytest.raises(ImageError, match=r"the camera is 64 x 64, not 2:1"):
        LiveCamera([square])


@pytest.mark.parametrize("kind", BYTES)
def test_raw_pictures_of_each_kind_are_read(kind):
    data = av.VideoFrame.from_ndarray(ROOM, format="rgb24").reformat(format=kind).to_ndarray()
    opening = raw_pipe(f"pipe:{kind}:128x64", raw([np.ascontiguousarray(data)] * 2))
    found = [picture.to_ndarray(format="rgb24") for _, picture in opening.pictures(lambda: None)]
    grey = kind == "gray"
    wanted = ROOM.astype(int) @ [0.299, 0.587, 0.114] if grey else ROOM.astype(int)
    shown = found[1].astype(int).mean(axis=2) if grey else found[1]
    assert len(found) == 2
    assert np.abs(shown - wanted).mean() < 6


def test_stamps_of_a_pipe_are_kept_and_a_cut_picture_is_said():
    stamps = [1000.5, 1000.75, 1001.0]
    whole = raw(clips.rolled(3), stamps).getvalue()
    lost = []
    opening = raw_pipe("pipe:rgb24:128x64:stamped", io.BytesIO(whole + b"12345"))
    with pytest.warns(UserWarning, match="ended in the middle of a picture, after 5 of"):
        found = list(opening.pictures(lambda: lost.append(1)))
    assert [told for told, _ in found] == stamps
    assert len(lost) == 1
    with pytest.raises(DeviceError, match="the time before a picture"):
        list(raw_pipe("pipe:rgb24:128x64:stamped", io.BytesIO(ROOM.tobytes() * 2)).pictures(lambda: None))
    with pytest.raises(TimeError, match="come with their times of capture"):
        LiveCamera([opening], latency=0.1)


READER = """
import sys
from eagor.sources.camera_sources import open_source

camera = open_source(sys.argv[1])
frame = next(iter(camera))
print(frame.stamp, frame.picture.shape, int(frame.picture.astype(int).sum()))
"""


def read_by_another(source, data):
    """What a process prints that takes one frame of its standard input, which stays open."""
    with subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", READER, source],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        process.stdin.write(data)
        process.stdin.flush()
        try:
            assert process.wait(2 * WAIT) == 0, process.stderr.read().decode()
            assert process.stderr.read() == b"", "the thread that still waits for standard input is no trouble"
            return process.stdout.read().decode()
        finally:
            process.kill()


def test_standard_input_is_a_camera(tmp_path):
    told = read_by_another("pipe:rgb24:128x64:stamped", raw([ROOM], [2000.5]).getvalue())
    assert told == f"2000.5 (64, 128, 3) {int(ROOM.astype(int).sum())}\n"
    encoded = clips.clip(tmp_path / "a.ts", clips.rolled(60)).read_bytes()
    assert "(64, 128, 3)" in read_by_another("-", encoded)


def test_only_the_newest_is_kept_and_the_rest_is_counted():
    """Nobody asks for 0.5 s: the next frame is the newest, and all others are counted."""
    count = 40
    opening = raw_pipe("pipe:rgb24:128x64:stamped", raw(clips.rolled(count), [100.0 + k for k in range(count)]))
    grabber = FrameGrabber(opening)
    until(lambda: grabber.dropped == count - 1, "end of the pipe")
    assert grabber.take().stamp == 100.0 + count - 1
    assert grabber.take() is None, "it has ended"
    assert grabber.error is None


class Breaking:
    """Gives 3 pictures, breaks, cannot be opened twice, gives 3 more, and so on."""

    name, again, stamped = "the test camera", True, False

    def __init__(self):
        self.opened = 0

    def pictures(self, damaged):
        self.opened += 1
        if self.opened in (2, 3):
            raise DeviceError("the test camera is unplugged")
        for k in range(3):
            yield k / 10, av.VideoFrame.from_ndarray(clips.rolled(3)[k], format="rgb24")
        damaged()


@pytest.mark.filterwarnings("ignore:the test camera tells no times")
def test_a_camera_that_is_unplugged_comes_back():
    opening = Breaking()
    camera = LiveCamera([opening])
    frames = iter(camera)
    first = next(frames)
    until(lambda: "unplugged; trying again" in (camera.problem or ""), "word about the camera")
    until(lambda: opening.opened >= 4, "new try")
    until(lambda: next(frames).stamp > first.stamp, "new frame")
    assert camera.dropped >= 1
    camera.close()


def test_a_damaged_stream_goes_on(tmp_path):
    """Bytes in the middle of a transport stream are overwritten: some pictures are lost and counted."""
    data = bytearray(clips.clip(tmp_path / "a.ts", clips.rolled(60)).read_bytes())
    for at in range(len(data) // 3, len(data) // 2, 700):
        data[at : at + 60] = bytes(60)
    (tmp_path / "b.ts").write_bytes(data)
    lost = []
    found = list(Stream(str(tmp_path / "b.ts"), "the stream").pictures(lambda: lost.append(1)))
    assert 10 < len(found) < 60
    assert lost


# --- stamps ----------------------------------------------------------------------------------------------------------


def stamps_of(told, arrivals, latency=0.0):
    clock = TimestampDejitter(latency, now=lambda: 5000.0, monotonic=lambda: 0.0)
    return [clock.stamp(t, arrival) for t, arrival in zip(told, arrivals, strict=True)]


@pytest.mark.parametrize("seed", range(3))
def test_jitter_of_arrival_does_not_enter_the_stamps(seed):
    """Delays of 20 ms plus exponential ones of 30 ms; a clock that is 50 ppm off."""
    random = np.random.default_rng(seed)
    taken = np.arange(0, 60, 1 / 30)
    arrivals = np.maximum.accumulate(taken + 0.02 + random.exponential(0.03, len(taken)))
    found = stamps_of(taken * (1 + 50e-6) + 777.0, arrivals, latency=0.02)
    late = [(s - 5000.0 - t) for s, t in zip(found, taken, strict=True) if s is not None and t > 2 * PROBATION]
    assert len(late) > 0.9 * len(taken) * (60 - 2 * PROBATION) / 60
    assert np.std(late) < 0.002
    assert abs(np.mean(late)) < 0.004
    order = [s for s in found if s is not None]
    assert all(b > a for a, b in pairwise(order))


STEADY = np.arange(0, 20, 0.1)


@pytest.mark.parametrize(
    ("told", "arrivals", "taken"),
    [  # a stall and a burst keep the times of capture; a clock that is set begins anew; a wrong pace does not count
        (STEADY, np.where((STEADY > 10) & (STEADY < 12), 12.0 + 0.001 * (STEADY - 10), STEADY), STEADY),
        ([*np.arange(100, 110, 0.1), *np.arange(3, 13, 0.1)], STEADY, STEADY),
        (np.arange(300) / 25, np.arange(300) / 15, np.arange(300) / 15),
        ([None] * 10, STEADY[:10], STEADY[:10]),
    ],
)
def test_stamps_are_times_of_capture_or_else_of_arrival(told, arrivals, taken):
    found = stamps_of(told, arrivals, latency=0.25)
    assert max(abs(s - 4999.75 - t) for s, t in zip(found, taken, strict=True) if s is not None) < 0.01
    assert sum(s is None for s in found) <= 20


def test_whether_the_times_of_a_stream_count_is_told():
    clock = TimestampDejitter()
    assert [clock.stamp(k / 25, k / 15) is None for k in range(300)] == [False] * 300
    assert clock.timeless
    clock = TimestampDejitter(now=lambda: 10.0, monotonic=lambda: 4.0)
    assert clock.stamp(None, 3.5) == pytest.approx(3.5 + 6.0)
    assert clock.timeless
    assert clock.stamp(None, 3.5) is None, "it is not later"


def test_a_plugin_is_opened_by_its_name(monkeypatch):
    from eagor.sources import camera_sources

    monkeypatch.setitem(camera_sources.BUILT_IN, "fake", f"{__name__}:fake_camera")
    monkeypatch.setitem(sys.modules, __name__, sys.modules[fake_camera.__module__])
    rest, settings = open_source("fake:left/eye", latency=0.25, rows=64)
    assert rest == "left/eye"
    assert (settings["latency"], settings["rows"], settings["rig"]) == (0.25, 64, None)
    rest, settings = open_source("fake:/image?domain=3", rig=LENSES, rate=5)
    assert (rest, settings) == ("/image?domain=3", {"latency": 0.0, "rows": None, "rig": LENSES, "rate": 5})


def fake_camera(rest, **settings):
    return rest, settings
