"""Videos: every picture at its time, whatever the container; the pictures that were asked for; what the file says."""

import struct
from fractions import Fraction

import av
import clips
import numpy as np
import pytest

from eagor.grids import ErpGrid
from eagor.lab.worlds.painted import painted_room
from eagor.sources.video import Video
from eagor.sphere import angular_distance, direction

ROOM = clips.ROOM


def marked(shape, azimuth, elevation):
    """A grey panorama with a white square at a direction (degrees)."""
    image = np.full((*shape, 3), 60, np.uint8)
    row, column = round((90 - elevation) / 180 * shape[0]), round((180 - azimuth) / 360 * shape[1])
    image[row - 2 : row + 2, np.arange(column - 2, column + 2) % shape[1]] = 255
    return image


def mark(image):
    """The direction of the brightest place."""
    grey = image.astype(float).sum(axis=2)
    weight = np.where(grey > 0.6 * grey.max(), grey, 0.0)
    return (ErpGrid(*image.shape[:2]).directions * weight[..., None]).sum(axis=(0, 1))


def degrees(a, b):
    return np.degrees(angular_distance(a, b))


def toward(azimuth, elevation):
    return direction(np.radians(azimuth), np.radians(elevation))


# --- times -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "codec"),
    [("a.mp4", "libx264"), ("a.mov", "libx264"), ("a.mkv", "libx264"), ("a.webm", "libvpx-vp9"), ("a.ts", "libx264"),
     ("a.avi", "mpeg4"), ("a: b%03d.mp4", "libx264")],
)  # fmt: skip
def test_all_pictures_come_in_order_with_their_times(tmp_path, name, codec):
    video = Video(clips.clip(tmp_path / name, codec=codec))
    frames = list(video)
    assert video.shape == (64, 128)
    assert (video.count, video.frame_rate) == (30, 30.0)
    assert video.duration == pytest.approx(1.0, abs=0.05)
    assert (video.motion, video.level_R_body, video.unseen) == (None, None, None)
    assert [f.stamp for f in frames] == pytest.approx([k / 30 for k in range(30)], abs=6e-4)
    for k, frame in enumerate(frames):
        assert frame.picture.dtype == np.uint8
        # Compressed, so that each picture is nearest to its own original.
        distances = [np.abs(frame.picture.astype(int) - p).mean() for p in clips.rolled(30)]
        assert int(np.argmin(distances)) == k
    assert [f.stamp for f in video] == [f.stamp for f in frames]  # again


def test_variable_rates_keep_their_times(tmp_path):
    times = [0, 40, 50, 400, 410, 1000, 1001, 1500, 3000]
    for name in ("a.mp4", "a.mkv"):
        video = Video(clips.clip(tmp_path / name, clips.rolled(len(times)), times=times))
        assert [f.stamp for f in video] == pytest.approx([t / 1000 for t in times], abs=1e-6)
        taken = [f.stamp for f in Video(video.path, rate=2.0)]
        assert taken == pytest.approx([0.0, 1.0, 1.5, 3.0])  # 0.5 is seen at 1.0, which is that tick's as well


@pytest.fixture(scope="module")
def sixty(tmp_path_factory):
    """Clips of two seconds, by the ending of their names."""
    folder = tmp_path_factory.mktemp("sixty")
    return {name: clips.clip(folder / name, clips.rolled(60)) for name in ("a.mp4", "a.mkv")}


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
@pytest.mark.parametrize("rate", [0.7, 4.0, 7.0, 30.0, 1000.0])
@pytest.mark.parametrize(("start", "end"), [(0.0, None), (0.4, 1.3), (1.01, None)])
def test_the_first_picture_at_or_after_each_tick(sixty, name, rate, start, end):
    path = sixty[name]
    stamps, rounding = ([round(k / 30, 3) for k in range(60)], 5e-4) if name == "a.mkv" else (
        [k / 30 for k in range(60)], 1e-9
    )  # fmt: skip
    inside = [s for s in stamps if s >= start - rounding and (end is None or s < end - rounding)]
    ticks = [start + k / rate for k in range(int(2 * rate) + 2)]
    wanted = sorted({next((s for s in inside if s >= t - rounding), 9.0) for t in ticks} - {9.0})
    video = Video(path, rate=rate, start=start, end=end)
    taken = [f.stamp for f in video]
    assert taken == pytest.approx(wanted, abs=6e-4)
    assert video.count == pytest.approx(len(taken), abs=1)


def test_a_matroska_that_begins_late_is_not_cut_off(tmp_path):
    path = clips.clip(tmp_path / "late.mkv", clips.rolled(8), times=[9000 + 100 * k for k in range(8)])
    assert [frame.stamp for frame in Video(path)] == pytest.approx([0.1 * k for k in range(8)], abs=1e-3)


def test_pictures_without_times_follow_each_other(tmp_path):
    video = Video(clips.clip(tmp_path / "a.h264"))
    assert [f.stamp for f in video] == pytest.approx([k / 25 for k in range(30)])
    assert any("no times" in fact for fact in video.facts)


def test_times_that_run_backwards_are_repaired(tmp_path):
    path = tmp_path / "joined.ts"
    data = clips.clip(tmp_path / "a.ts", options={"bf": "0"}).read_bytes()
    path.write_bytes(data + data)  # the clock starts again
    with pytest.warns(UserWarning, match=r"the times of 30 of 59 pictures are missing or do not increase"):
        frames, error = clips.taken(Video(path))
    assert "1 of its packets could not be decoded" in str(error)  # the one before the joint
    assert len(frames) == 59
    assert (np.diff([f.stamp for f in frames]) > 0).all()


# --- pictures --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rows", [7, 16, 32, 64, 100])
def test_shrinking_is_by_area(tmp_path, rows):
    image = painted_room(64, 128)
    path = clips.clip(tmp_path / "a.mov", [image] * 3, codec="png", pix_fmt="rgb24")
    video = Video(path, rows=rows)
    frame = next(iter(video))
    high = min(rows, 64)
    assert video.shape == (high, 2 * high) == frame.picture.shape[:2]
    if 64 % high == 0:
        step = 64 // high
        mean = image.reshape(high, step, 2 * high, step, 3).mean(axis=(1, 3))
        assert np.abs(frame.picture - mean).max() <= 1.5


def test_pixels_that_are_not_square(tmp_path):
    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(4, 3)
        for _ in range(3):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((64, 96, 3), 90, np.uint8), "rgb24")))
        container.mux(stream.encode())
    assert Video(tmp_path / "a.mkv").shape == (64, 128)


@pytest.mark.parametrize(("turns", "matrix"), [(2, (-1, 0, 0, -1)), (1, (0, -1, 1, 0)), (3, (0, 1, -1, 0))])
def test_display_rotation_is_applied(tmp_path, turns, matrix):
    upright = marked((64, 128), 70, 30)
    stored = np.ascontiguousarray(np.rot90(upright, -turns))
    path = clips.clip(tmp_path / "a.mp4", [stored] * 3)
    a, b, c, d = (v * 65536 for v in matrix)
    numbers = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    clips.into(path, [b"moov", b"trak", b"tkhd"], lambda body: body[:40] + numbers + body[76:])
    video = Video(path)
    assert video.shape == (64, 128)
    assert any(f"turned by {90 * turns} degrees" in fact for fact in video.facts)
    assert degrees(mark(next(iter(video)).picture), toward(70, 30)) < 3


# --- what the file says ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rows", [None, 40])
def test_a_cropped_panorama_lies_where_it_was(tmp_path, rows):
    whole = marked((80, 160), 50, 20)
    seen = np.ascontiguousarray(whole[16:64, 40:120])
    path = clips.with_entry(clips.clip(tmp_path / "a.mp4", [seen] * 3), clips.sv3d(bounds=(0.2, 0.2, 0.25, 0.25)))
    video = Video(path, rows=rows)
    frame = next(iter(video))
    assert frame.picture.shape[:2] == video.shape == ((80, 160) if rows is None else (40, 80))
    assert degrees(mark(frame.picture), toward(50, 20)) < 3
    assert video.unseen.mean() == pytest.approx(1 - 0.6 * 0.5)
    assert (frame.picture[video.unseen] == 0).all()
    assert (frame.picture[~video.unseen] > 20).all()
    assert any("180 x 108 degrees" in fact for fact in video.facts)


def test_an_equirectangular_picture_that_is_squeezed(tmp_path):
    path = clips.with_entry(clips.clip(tmp_path / "a.mp4", [ROOM[:, :96]] * 3), clips.sv3d())
    assert Video(path).shape == (64, 128)
    assert any("it shows 96 x 64, not 2:1, and names no part: taken with all columns" in f for f in Video(path).facts)


def test_half_spheres_that_are_said_to_be_whole_are_asked_about(tmp_path):
    path = clips.with_entry(clips.clip(tmp_path / "a.mp4", [ROOM] * 3), clips.st3d(2), clips.sv3d())
    assert any("it shows 64 x 64, not 2:1" in fact and "--eyes vr180" in fact for fact in Video(path).facts)


@pytest.mark.parametrize(("mode", "axis"), [(1, 0), (2, 1)])
def test_of_two_eyes_the_left_is_taken(tmp_path, mode, axis):
    left, right = marked((64, 128), 30, -20), marked((64, 128), -90, 40)
    both = np.concatenate([left, right], axis=axis)
    path = clips.with_entry(clips.clip(tmp_path / "a.mp4", [both] * 3), clips.st3d(mode), clips.sv3d())
    video = Video(path)
    assert video.shape == (64, 128)
    assert degrees(mark(next(iter(video)).picture), toward(30, -20)) < 3
    assert any("left one is taken" in fact for fact in video.facts)
    assert Video(path, rows=32).shape == (32, 64)


@pytest.mark.parametrize(
    ("pose", "at", "level"),
    [  # where the mark is in the picture, and where it is in the world: azimuth, elevation
        ({"pitch": 20.0}, (0, 0), (0, 20)),
        ({"pitch": -35.0}, (180, 0), (180, 35)),
        ({"roll": 30.0}, (90, 0), (90, -30)),  # the left side is down
        ({"yaw": 40.0, "pitch": 20.0}, (0, 0), (0, 20)),  # the heading is not applied
    ],
)
@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
def test_how_the_camera_was_held(tmp_path, pose, at, level, name):
    picture = marked((64, 128), *at)
    path = tmp_path / name
    if name == "a.mp4":
        clips.with_entry(clips.clip(path, [picture] * 3), clips.sv3d(**pose))
    else:
        matroska(path, picture, pose)
    video = Video(path)
    seen = mark(next(iter(video)).picture)
    assert degrees(video.level_R_body @ seen, toward(*level)) < 3
    assert any("how the camera was held" in fact for fact in video.facts)


def matroska(path, picture, pose):
    """A Matroska file with a Projection element."""
    inside = clips.element(0x7671, b"\1") + clips.element(0x7672, bytes(20))
    for name, key in ((0x7673, "yaw"), (0x7674, "pitch"), (0x7675, "roll")):
        inside += clips.element(name, struct.pack(">d", pose.get(key, 0.0)))
    clips.with_element(clips.clip(path, [picture] * 3), clips.element(0x7670, inside))


def test_a_video_that_says_nothing_and_is_not_2_to_1(tmp_path):
    video = Video(clips.clip(tmp_path / "a.mp4", [ROOM[:, :96]] * 3))
    assert video.shape == (64, 96)
    assert video.hint.focal is None
