"""Promised: a video holds what was drawn, at its own times, and what was drawn is not lost, whatever ends the run."""

import os
import signal
import subprocess
import sys
import textwrap
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence
from tracks_drawn import PANORAMA, turning

from eagor.drawing import video
from eagor.drawing.marks import OURS
from eagor.drawing.video import BeliefVideo
from eagor.errors import EagorError, MissingExtraError, StorageError, TimeError
from eagor.sphere import azimuth_elevation

av = pytest.importorskip("av")
CYAN = np.array([int(OURS[at : at + 2], 16) for at in (1, 3, 5)])
STAMPS = (7.0, 7.5, 7.6, 9.1, 9.2)
VIDEOS = [".mp4", ".mkv", ".webm"]


def write(path, count=5, **how):
    """A video of a track, its estimates, and the painter's measures."""
    estimates = turning(count)
    with BeliefVideo(path, **{"size": 640, "rate": 2, **how}) as video:
        for index, estimate in enumerate(estimates):
            video.add(PANORAMA, estimate, stamp=STAMPS[index] if count <= len(STAMPS) else 0.5 * index, query="door")
    return estimates, video.painter


def read(path, cut=False):
    """Times and pictures of a video; `cut`: the last one may be there in part, which players pass over."""
    frames = []
    with suppress(av.error.InvalidDataError) if cut else nullcontext(), av.open(str(path)) as container:
        for frame in container.decode(video=0):
            frames.append((frame.time, frame.to_ndarray(format="rgb24")))
    return [time for time, _ in frames], [picture for _, picture in frames]


def test_the_suffix_decides_and_others_are_refused(tmp_path):
    for name in ("out.avi", "out", "out.mp4.txt", "out.png"):
        with pytest.raises(EagorError, match=r"wanted a video \(.mp4, .mkv, .webm\) or a moving picture"):
            BeliefVideo(tmp_path / name)
    with BeliefVideo(tmp_path / "OUT.MP4", size=320) as video:
        video.add(PANORAMA, turning(1)[0])
    assert read(tmp_path / "OUT.MP4")[0] == [0.0]


@pytest.mark.parametrize("suffix", VIDEOS)
def test_what_is_read_back_is_what_was_drawn_at_its_own_time(tmp_path, suffix):
    path = tmp_path / f"out{suffix}"
    estimates, painter = write(path)
    times, pictures = read(path)
    assert times == pytest.approx([stamp - STAMPS[0] for stamp in STAMPS], abs=6e-4)
    for estimate, picture in zip(estimates, pictures, strict=True):
        assert picture.shape == (painter.height, painter.width, 3)
        azimuth, elevation = (float(angle) for angle in azimuth_elevation(estimate.direction))
        x = (0.5 - azimuth / (2 * np.pi)) * painter.width
        y = painter.head + (0.5 - elevation / np.pi) * painter.rows
        at = picture[round(y - 0.5), round(x - 0.5)].astype(int)
        assert np.abs(at - CYAN).max() < 70, at  # the colours are coded, at half the resolution
        far = picture[round(y - 0.5), round(x - 0.5) - painter.width // 2].astype(int)
        assert np.abs(far - CYAN).max() > 90
    with av.open(str(path)) as container:
        (stream,) = container.streams
        assert stream.codec_context.name in ("h264", "mpeg4", "vp9")
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert container.duration / 1e6 == pytest.approx(2.3, abs=0.02)  # the last is shown as long as the one before
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_the_second_encoder_is_used_where_the_first_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(av, "codecs_available", set(av.codecs_available) - {"libx264"})
    write(tmp_path / "out.mp4")
    with av.open(str(tmp_path / "out.mp4")) as container:
        assert container.streams[0].codec_context.name == "mpeg4"
        assert len(list(container.decode(video=0))) == len(STAMPS)
    monkeypatch.setattr(av, "codecs_available", set())
    with pytest.raises(EagorError, match=r"no encoder for .webm \(libvpx-vp9\); name a file that ends in .mp4 or .mkv"):
        BeliefVideo(tmp_path / "out.webm")
    assert [entry.name for entry in tmp_path.iterdir()] == ["out.mp4"]


@pytest.mark.parametrize("suffix", [".webp", ".gif"])
def test_moving_pictures_for_pages(tmp_path, suffix, monkeypatch):
    path = tmp_path / f"out{suffix}"
    write(path, size=320)
    with Image.open(path) as image:
        frames = [(np.asarray(frame.convert("RGB")), frame.info["duration"]) for frame in ImageSequence.Iterator(image)]
    assert [duration for _, duration in frames] == [500, 100, 1500, 100, 100]
    assert len({picture.tobytes() for picture, _ in frames}) == 5
    monkeypatch.setattr(video, "MOST", 4)
    write(path, count=9, size=320)
    with Image.open(path) as image:
        durations = [frame.copy() and frame.info["duration"] for frame in ImageSequence.Iterator(image)]
    assert durations == [2000, 2000, 500]  # of nine, every fourth: 0, 4 and 8
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("suffix", "error"), [(".mkv", RuntimeError), (".mp4", KeyboardInterrupt), (".webp", KeyboardInterrupt)]
)
def test_what_was_drawn_before_an_error_or_ctrl_c_is_kept(tmp_path, suffix, error):
    path = tmp_path / f"out{suffix}"
    path.write_text("an older file")
    with pytest.raises(error), BeliefVideo(path, size=320, rate=2) as video:  # noqa: PT012
        for estimate in turning(3):
            assert path.read_text() == "an older file"
            video.add(PANORAMA, estimate)
        raise error
    if suffix == ".webp":
        with Image.open(path) as image:
            assert image.n_frames == 3
    else:
        assert read(path)[0] == pytest.approx([0, 0.5, 1.0], abs=1e-3)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_without_pictures_nothing_is_written(tmp_path, suffix):
    path = tmp_path / f"out{suffix}"
    path.write_text("an older file")
    with pytest.raises(TimeError), BeliefVideo(path) as video:
        video.add(PANORAMA, turning(1)[0], stamp=float("nan"))
    assert path.read_text() == "an older file"
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_frames_out_of_order_are_refused(tmp_path):
    first, second = turning(2)
    with BeliefVideo(tmp_path / "out.mp4", size=320) as video:
        video.add(PANORAMA, second, stamp=1.0)
        with pytest.raises(TimeError, match="wanted frames in order of time"):
            video.add(PANORAMA, first, stamp=0.5)
        with pytest.raises(TimeError, match="less than 1/60000 s after"):
            video.add(PANORAMA, first, stamp=1.0 + 1e-9)
        video.add(PANORAMA, first, stamp=2.0)
    assert read(tmp_path / "out.mp4")[0] == [0.0, 1.0]


def test_places_that_cannot_be_written_to(tmp_path, monkeypatch):
    (tmp_path / "out.mp4").mkdir()
    for place in (tmp_path / "absent" / "out.mp4", tmp_path / "out.mp4"):
        with pytest.raises(EagorError, match=r"it is a folder|there is no folder for it"):
            BeliefVideo(place)
    for rate in (0, -1, float("nan")):
        with pytest.raises(EagorError, match="pictures per second; wanted a number above 0"):
            BeliefVideo(tmp_path / "out.webm", rate=rate)

    def refused(*_, **__):
        raise OSError(13, "Permission denied")

    monkeypatch.setattr(av, "open", refused)
    with pytest.raises(StorageError, match=r"Permission denied.; name a folder that can be"):
        BeliefVideo(tmp_path / "out.mkv")


def test_without_pyav_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("eagor._extras.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"a video needs av: .*pip install .*\[photos\]"):
        BeliefVideo(tmp_path / "out.mp4")
    BeliefVideo(tmp_path / "out.webp").close()


SCRIPT = """
    import sys, numpy as np
    from tracks_drawn import turning
    from eagor.drawing.video import BeliefVideo
    from eagor.errors import StorageError
    rng = np.random.default_rng(0)
    (estimate,) = turning(1)
    try:
        with BeliefVideo(sys.argv[1], size=320, rate=2) as video:
            for index in range(5000):
                noise = rng.integers(0, 255, (160, 320, 3), dtype=np.uint8)
                video.add(noise, estimate, stamp=0.5 * index)
                print(index + 1, flush=True)
    except StorageError as error:
        print(error)
        sys.exit(1)
"""


def started(path, room=None):
    def limited():
        if room is not None:
            import resource

            resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))

    here = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    return subprocess.Popen(
        [sys.executable, "-B", "-c", textwrap.dedent(SCRIPT), str(path)],
        env=os.environ | {"PYTHONPATH": here, "OPENBLAS_NUM_THREADS": "1"},
        stdout=subprocess.PIPE, text=True, preexec_fn=limited,
    )  # fmt: skip


def test_a_full_disk_keeps_the_pictures_that_it_holds(tmp_path):
    pytest.importorskip("resource")
    path = tmp_path / "out.mp4"
    process = started(path, room=100_000)
    *_, said = process.communicate(timeout=300)[0].splitlines()
    assert process.returncode == 1
    assert "takes no more (File too large)" in said
    assert "it has the pictures so far. Make room, or name another place" in said
    times, _ = read(path, cut=True)
    assert len(times) >= 2
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_ctrl_c_leaves_a_video_that_plays(tmp_path):
    path = tmp_path / "out.mp4"
    process = started(path)
    for _ in range(4):
        process.stdout.readline()
    process.send_signal(signal.SIGINT)
    printed = process.communicate(timeout=300)[0].split()
    assert process.returncode != 0
    times, _ = read(path)
    assert len(times) >= max(3, int(printed[-1]) if printed else 0)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
