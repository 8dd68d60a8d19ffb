"""Files that are no good videos: a sentence each, what can be read first; bounded memory; nothing left open."""

import os
import re
import subprocess
import sys
import tempfile
import wave
from pathlib import Path

import av
import clips
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mutations import damaged, reads
from PIL import Image
from strategies import HOSTILE

from eagor.errors import ImageError, TimeError
from eagor.grids import FisheyeGrid
from eagor.lab.worlds.painted import painted_room
from eagor.sources.metadata import GPANO, properties
from eagor.sources.panorama import view
from eagor.sources.video import Video
from eagor.sphere import world_R_body

# --- arguments -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "kind", "said"),
    [
        ({"rate": 0}, TimeError, "rate = 0; wanted pictures per second, more than 0"),
        ({"rate": -2.0}, TimeError, "rate = -2.0"),
        ({"rate": float("nan")}, TimeError, "rate = nan"),
        ({"start": -1.0}, TimeError, "start = -1.0; wanted seconds"),
        ({"start": 1.0}, TimeError, "start = 1 s is beyond the end of .*, which lasts 1.00 s"),
        ({"start": 0.5, "end": 0.5}, TimeError, "end = 0.5; wanted seconds of the file after start = 0.5"),
        ({"end": float("inf")}, TimeError, "end = inf"),
        ({"rows": 0}, ImageError, "rows = 0; wanted a whole number of at least 1"),
        ({"rows": 2.5}, ImageError, "rows = 2.5"),
    ],
)
def test_impossible_arguments(tmp_path, given, kind, said):
    path = clips.clip(tmp_path / "a.mp4")
    with pytest.raises(kind, match=said):
        Video(path, **given)


def test_no_picture_between_the_times(tmp_path):
    path = clips.clip(tmp_path / "a.mp4")
    frames, error = clips.taken(Video(path, start=0.501, end=0.510))
    assert not frames
    assert isinstance(error, TimeError)
    assert re.search("no picture from start = 0.501 s to end = 0.51 s; it was read up to 0.53 s", str(error))


# --- other files -----------------------------------------------------------------------------------------------------


def sound(path):
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(bytes(16000))


OTHERS = {
    "missing.mp4": (lambda path: None, "there is no file .*missing.mp4'; give the path of a video"),
    "folder.mp4": (lambda path: path.mkdir(), "is a folder; give one file in it"),
    "pipe.mp4": (lambda path: os.mkfifo(path), "is a pipe or a device"),
    "empty.mp4": (lambda path: path.touch(), "is empty"),
    "text.mp4": (lambda path: path.write_text("hello, this is not a video\n" * 99), "cannot be read as a video"),
    "notes.txt": (lambda path: path.write_text("hello\n" * 99), "is text, not a video|cannot be read as a video"),
    "noise.mkv": (lambda path: path.write_bytes(np.random.default_rng(0).bytes(9999)), "cannot be read as a video"),
    "room.png": (lambda path: Image.fromarray(clips.ROOM).save(path), "is a single picture, not a video; eagor locate"),
    "room.mp4": (lambda path: Image.fromarray(clips.ROOM).save(path, "JPEG"), "is a single picture, not a video"),
    "sound.wav": (sound, "has no stream of pictures, but: audio"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_what_is_no_video(tmp_path, name):
    make, said = OTHERS[name]
    make(tmp_path / name)
    with pytest.raises(ImageError, match=said):
        Video(tmp_path / name)


def test_a_playlist_opens_no_other_file(tmp_path):
    clips.clip(tmp_path / "a.ts")
    listed = tmp_path / "list.mp4"
    listed.write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nhttp://127.0.0.1:9/a.ts\n#EXT-X-ENDLIST\n")
    with pytest.raises(ImageError, match=r"cannot be read as a video|no stream of pictures"):
        Video(listed)


def test_an_unknown_codec(tmp_path):
    path = clips.clip(tmp_path / "a.mp4")
    path.write_bytes(path.read_bytes().replace(b"avc1", b"zzz1"))
    with pytest.raises(ImageError, match="in a codec that this FFmpeg cannot decode; convert it"):
        Video(path)


def test_no_pictures(tmp_path):
    path = clips.clip(tmp_path / "a.mp4")
    data = path.read_bytes()
    start = data.index(b"mdat") + 4
    end = data.index(b"moov") - 4
    path.write_bytes(data[:start] + bytes(end - start) + data[end:])
    with pytest.raises(ImageError, match=r"holds no picture: none of its .* packets can be decoded"):
        Video(path)


def test_pictures_too_large(tmp_path, monkeypatch):
    monkeypatch.setattr("eagor.sources.video.LARGEST", 8000)
    with pytest.raises(ImageError, match="pictures of 128 x 64 pixels; wanted at most 8000"):
        Video(clips.clip(tmp_path / "a.mp4"))


# --- damage ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
@pytest.mark.parametrize("share", [0.5, 0.8])
def test_what_came_before_the_cut_is_delivered(tmp_path, name, share):
    noise = np.random.default_rng(0).integers(0, 255, (90, 64, 128, 3), dtype=np.uint8)
    path = clips.clip(tmp_path / name, list(noise), options={"g": "5"})
    if name == "a.mp4":
        faststart(path)
    whole = [f.stamp for f in Video(path)]
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    frames, error = clips.taken(Video(path))
    assert 0.6 * share * 90 < len(frames) <= share * 90 + 1
    assert [f.stamp for f in frames] == whole[: len(frames)]
    assert isinstance(error, ImageError)
    assert re.search(
        r"is cut off: (of 90 pictures \d+ are there|it should last 3\.00 s); it was read up to", str(error)
    )
    assert not clips.taken(Video(path, end=0.2))[1]  # what lies behind was not wanted


def faststart(path):
    """The index before the pictures, as after an upload."""
    with av.open(str(path)) as source:
        stream = source.streams.video[0]
        moved = path.with_suffix(".tmp.mp4")
        with av.open(str(moved), "w", options={"movflags": "faststart"}) as sink:
            copy = sink.add_stream_from_template(stream)
            for packet in source.demux(stream):
                if packet.dts is not None:
                    packet.stream = copy
                    sink.mux(packet)
    moved.replace(path)


def test_damage_in_the_middle(tmp_path):
    path = clips.clip(tmp_path / "a.mkv", clips.rolled(40), codec="libvpx-vp9")
    data = bytearray(path.read_bytes())
    with av.open(str(path)) as container:
        packet = [packet for packet in container.demux(video=0) if packet.size][20]
    at = data.index(bytes(packet))
    data[at : at + packet.size] = bytes(packet.size)
    path.write_bytes(bytes(data))
    frames, error = clips.taken(Video(path))
    assert len(frames) == 39
    assert isinstance(error, ImageError)
    said = re.search(r"1 of its packets could not be decoded, the first near (\d\.\d\d) s", str(error))
    assert said
    assert packet.pts / 1000 - 0.01 < float(said[1]) < packet.pts / 1000 + 0.35  # decoding threads: 8 pictures at most
    assert frames[-1].stamp == pytest.approx(39 / 30, abs=1e-3)


# --- projections that are not read -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("boxes", "said"),
    [
        ([clips.sv3d(b"cbmp")], "is a cubemap picture, as its metadata says.*v360"),
        ([clips.sv3d(bounds=(0.6, 0.5, 0, 0))], "cannot be read as a video"),
    ],
)
def test_projections_that_are_not_read(tmp_path, boxes, said):
    with pytest.raises(ImageError, match=said):
        Video(clips.with_entry(clips.clip(tmp_path / "a.mp4"), *boxes))


def test_a_recording_that_is_not_stitched(tmp_path):
    room = painted_room(128, 256)
    lenses = [view(room, FisheyeGrid(64, np.radians(190), world_R_body(yaw))) for yaw in (0, np.pi)]
    two = clips.clip(tmp_path / "b.mp4", [lenses[0]] * 3).rename(tmp_path / "b.insv")
    clips.into(two, [b"moov"], lambda body: body + clips.first(body, b"trak"))
    with pytest.raises(ImageError, match="holds 2 tracks of pictures, one for each lens"):
        Video(two)


# --- readers ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("videos")


def spoken():
    """Small files with everything that is read beside pictures."""
    with tempfile.TemporaryDirectory() as place:
        small, folder = clips.rolled(2), Path(place)
        a = clips.with_entry(clips.clip(folder / "a.mp4", small), clips.st3d(0), clips.sv3d(pitch=5))
        c = clips.clip(folder / "c.mp4", small)
        c.write_bytes(c.read_bytes() + clips.trailer([(k / 10, (0, 0, 1), (0.1, 0.2, 0.3)) for k in range(4)]))
        d = clips.with_element(clips.clip(folder / "d.mkv", small), clips.element(0x7670, clips.element(0x7671, b"\1")))
        return [path.read_bytes() for path in (a, c, d)]


SPOKEN = spoken()


@HOSTILE
@given(damaged(SPOKEN))
@example(b"")
@example(b"\0\0\0\1moov" + b"\xff" * 8)
def test_damaged_videos(folder, blob):
    path = folder / "b.insv"
    path.write_bytes(blob)

    def look():
        video = Video(path, rows=16)
        frames, _ = clips.taken(video)
        stamps = [f.stamp for f in frames]
        assert sorted(set(stamps)) == stamps
        assert all(f.picture.shape == (*video.shape, 3) for f in frames)

    reads(look, "b.insv")


@HOSTILE
@given(
    st.binary(max_size=200) | damaged([b'<x xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" GPano:Pose="1"/>'])
)
@example(b'<!DOCTYPE x [<!ENTITY a "aaaa">]><x>&a;</x>')
@example(b"<x>" * 3000)
def test_xmp(data):
    assert isinstance(properties(data, GPANO), dict)


# --- resources -------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="needs /proc")
def test_nothing_stays_open(tmp_path):
    path = clips.clip(tmp_path / "a.mp4")

    def handles():
        names = [f"/proc/self/fd/{n}" for n in os.listdir("/proc/self/fd")]
        return sum(os.path.realpath(name) == str(path) for name in names if os.path.exists(name))

    video = Video(path)
    assert handles() == 0
    pictures = iter(video)
    next(pictures)
    assert handles() == 1
    pictures.close()
    assert handles() == 0
    for _ in video:
        break
    del _
    assert handles() == 0
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ImageError):
        Video(path)
    assert handles() == 0


PEAK = """
import re, sys
import av
import numpy as np
from eagor.sources.video import Video
if sys.argv[2] == "write":
    base = np.random.default_rng(0).integers(0, 255, (60, 120, 3), dtype=np.uint8).repeat(64, 0).repeat(64, 1)
    with av.open(sys.argv[1], "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.height, stream.width, stream.pix_fmt = *base.shape[:2], "yuv420p"
        plain = "rc-lookahead=0:sync-lookahead=0:bframes=2:ref=4:threads=1"
        stream.options = {"preset": "ultrafast", "x264-params": plain}
        for k in range(10):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.roll(base, 8 * k, axis=1), format="rgb24")))
        container.mux(stream.encode())
else:
    video = Video(sys.argv[1], rows=int(sys.argv[2]) or None)
    print(sum(1 for _ in video), *video.shape)
    # Not ru_maxrss: it begins with what the process had that started this one.
    print(re.search(r"VmHWM:\\s*(\\d+) kB", open("/proc/self/status").read())[1])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is of Linux")
@pytest.mark.slow
def test_8k_stays_below_one_and_a_half_gigabytes(tmp_path):
    def run(what):
        words = [sys.executable, "-c", PEAK, str(tmp_path / "8k.mp4"), what]
        return subprocess.run(words, capture_output=True, text=True, timeout=300, check=True).stdout.splitlines()

    run("write")
    for rows, shape in (("1024", "1024 2048"), ("0", "3840 7680")):
        seen, peak = run(rows)
        assert seen == f"10 {shape}"
        assert int(peak) * 1024 < 1.5e9, f"{int(peak) / 1024:.0f} MiB for {rows} rows"
