"""Your own footage: `eagor track` and `locate` on videos and photographs, as people have them.

Clips are made here, of the painted room, turned by known rotations.
"""

import contextlib
import json
import math
import os
import subprocess
import sys

import av
import numpy as np
import pytest
from clips import clip, trailer
from commands import answer, eagor, refused
from PIL import Image
from scipy.spatial import cKDTree

from eagor.cli import checks
from eagor.grids import ErpGrid
from eagor.lab.worlds.painted import EYE, Room, bearing, painted_room
from eagor.sources import Frame, Pose
from eagor.sources.odometry import GivenPoses, PosedFrames
from eagor.sources.panorama import turn
from eagor.sphere import angular_distance, azimuth_elevation, direction, world_R_body

RED = bearing(Room().balls[0], EYE, np.eye(3))[0]
ROWS, COUNT, RATE = 192, 12, 4  # of a clip: rows, pictures, pictures per second
ROOM = painted_room(ROWS, 2 * ROWS)
GOOD = {"crf": "12"}
POSES = [world_R_body(math.radians(9 * k), math.radians(8 * math.sin(k / 2)), math.radians(6 * math.sin(k / 3)))
         for k in range(COUNT)]  # fmt: skip
HEADING = [world_R_body(math.radians(9 * k), 0.0, 0.0) for k in range(COUNT)]


def turned(poses, panorama=ROOM):
    return [turn(panorama, pose.T) for pose in poses]


def elsewhere(ball):
    """Another place: grey flagstones all around, and a red ball in the direction `ball` (3,)."""
    rng, rays = np.random.default_rng(5), ErpGrid(ROWS, 2 * ROWS).directions
    centres = rng.normal(size=(500, 3))
    stone = cKDTree(centres / np.linalg.norm(centres, axis=1, keepdims=True)).query(rays)[1]
    picture = rng.integers(40, 220, 500)[stone][..., None].repeat(3, axis=-1).astype(np.uint8)
    picture[rays @ ball > math.cos(math.radians(7))] = (200, 30, 35)
    return picture


def filmed(path, pictures, rate=RATE, **more):
    return clip(path, pictures, rate=rate, options=GOOD, **more)


@pytest.fixture(scope="module")
def tilting(tmp_path_factory):
    """A clip of a camera that turns, nods and rolls."""
    return filmed(tmp_path_factory.mktemp("clips") / "clip.mp4", turned(POSES))


def error_deg(entry, truth):
    found = direction(math.radians(entry["azimuth_deg"]), math.radians(entry["elevation_deg"]))
    return math.degrees(angular_distance(found, truth))


# --- where the poses come from ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "poses", "words"),
    [
        ("clip", POSES, "orientations from the pictures themselves"),
        ("folder", POSES, "orientations from the pictures themselves"),
        ("level", HEADING, "headings from the pictures themselves, which are taken as level"),
        ("imu", HEADING, "orientations from the video's IMU"),
    ],
)
def test_without_poses_the_recording_tells_how_the_camera_turned(tmp_path, kind, poses, words):
    path, level = tmp_path / "frames", ("--poses", "level") if kind == "level" else ()
    if kind == "folder":
        path.mkdir()
        for number, picture in enumerate(turned(poses)):
            Image.fromarray(picture).save(path / f"{number}.png")
    else:
        path = filmed(tmp_path / "küche 1.mp4", turned(poses))
    if kind == "imu":
        up, left = (0.0, 0.0, 1.0), (0.0, 0.0, math.radians(9 * RATE))  # gravity, and the turn, a second
        path.write_bytes(path.read_bytes() + trailer([(0.01 * k, up, left) for k in range(310)]))
    found = answer("track", path, "red", "--rate", RATE, *level)
    assert found["poses"] == words
    entries = found["frames"]
    assert entries[0]["frame"] == ("0.png" if kind == "folder" else "küche 1.mp4 at 0.00 s")
    assert [entry["stamp"] for entry in entries] == [k / RATE for k in range(COUNT)]
    assert not any("lost" in entry for entry in entries)
    for entry, pose in list(zip(entries, poses, strict=True))[3:]:
        assert error_deg(entry, pose.T @ RED) < 4
    assert entries[-1]["status"] == "tracking"
    assert entries[-1]["credible_angle_deg"] < entries[0]["credible_angle_deg"]


def test_poses_of_a_file_are_interpolated_at_the_times_of_the_frames(tmp_path):
    """Where they begin too late, nothing is begun; where they end early, nothing that was computed is lost."""
    path = filmed(tmp_path / "clip.mp4", turned(HEADING))

    def poses(first, last):
        stamps = np.arange(first, last + 1e-9, 0.17)
        lines = [f"{t:.4f},{9 * RATE * t:.5f},0,0" for t in [*stamps, last]]
        (tmp_path / "poses.csv").write_text("\n".join(["stamp,yaw_deg,pitch_deg,roll_deg", *dict.fromkeys(lines)]))

    words = ("track", path, "red", "--rate", RATE, "--poses", tmp_path / "poses.csv")
    poses(-0.1, 3.03)
    entries = answer(*words)["frames"]
    assert [entry["stamp"] for entry in entries] == [k / RATE for k in range(COUNT)]
    for entry, pose in zip(entries, HEADING, strict=True):
        assert error_deg(entry, pose.T @ RED) < 4
    poses(0.5, 3.03)
    said = refused(*words)
    assert "clip.mp4 at 0.00 s has no pose" in said
    assert "0.5 to 3.03 s" in said
    assert "--start" in said
    entries = answer(*words, "--start", 0.5, "--end", 2.5)["frames"]
    assert [entry["stamp"] for entry in entries] == [k / RATE for k in range(2, 10)]
    poses(0, 1.2)
    done = eagor(*words, "--json")
    assert done.returncode == 3
    assert "has no pose" in done.stderr
    assert [entry["stamp"] for entry in json.loads(done.stdout)["frames"]] == [k / RATE for k in range(6)]


def test_a_cut_begins_the_belief_anew_and_is_said(tmp_path):
    """Another room, and a red ball in another direction: what was believed says nothing about it."""
    there, page = direction(math.radians(130), math.radians(-25)), tmp_path / "page.html"
    path = filmed(tmp_path / "cut.mp4", turned(HEADING[:6]) + turned(HEADING[6:], elsewhere(there)))
    done = eagor("track", path, "red", "--rate", RATE, "--page", page, "--json")
    found = json.loads(done.stdout)
    assert [entry.get("lost", False) for entry in found["frames"]] == [k == 6 for k in range(COUNT)]
    said = "cut.mp4 at 1.50 s does not fit to the frames before it: the belief starts anew"
    assert [line for line in done.stderr.splitlines() if "warning" in line] == [f"eagor: warning: {said}"]
    for entry, pose in list(zip(found["frames"], HEADING, strict=True))[8:]:
        assert error_deg(entry, pose.T @ there) < 4
    assert f"{said}." in page.read_text(encoding="utf-8")


# --- which frames -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--start", 9), "beyond the end"),
        (("--start", 2, "--end", 1), "end"),
        (("--rate", 0), "--rate 0"),
        (("--fps", "nan"), "--fps nan"),
        (("--modes", 0), "--modes 0"),
        (("--video", "answer.txt"), "answer.txt"),
        (("--video", "nowhere/answer.mp4"), "no folder"),
        (("--page", "page.pdf"), ".html"),
        (("--mask", "nothing.png"), "nothing.png"),
        (("--poses", "nothing.csv"), "nothing.csv"),
        (("--floor", -1), "positions"),
    ],
)
def test_impossible_options_are_refused_at_once(tilting, words, says, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert says in refused("track", tilting, "red", *words)
    assert not list(tmp_path.iterdir())


# --- what comes out ---------------------------------------------------------------------------------------------------


def test_a_video_with_the_answer_drawn_in(tilting, tmp_path):
    """Frames between the looks are only in the video: there the belief moves with the camera."""
    path, pictures, page = tmp_path / "answer.mp4", tmp_path / "pictures", tmp_path / "page.html"
    outputs = ("--video", path, "--fps", RATE, "--pictures", pictures, "--page", page)
    done = eagor("track", tilting, "red", "--end", 1.5, *outputs)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert [float(line.split()[0]) for line in lines[1:]] == [0, 0.5, 1]
    with av.open(str(path)) as container:
        frames = list(container.decode(video=0))
    assert [round(frame.time, 2) for frame in frames] == [k / RATE for k in range(COUNT // 2)]
    assert frames[0].width == 1280
    assert [each.name for each in sorted(pictures.iterdir())] == [f"{k:04d}.png" for k in range(3)]
    text = page.read_text(encoding="utf-8")
    assert text.count("data:image/jpeg;base64,") >= 3
    assert 'src="http' not in text
    assert "clip.mp4 at 0.50 s" in text
    assert "clip.mp4 at 0.50 s: 0.50 s" not in text
    assert "orientations from the pictures themselves" in text
    assert "clip.mp4: h264, 384 x 192 pixels, 3.0 s" in done.stderr
    assert "2 looks per second (--rate 2), orientations from the pictures themselves" in done.stderr


def test_lines_go_to_stdout_also_beside_a_progress_bar(tilting, tmp_path):
    """Somebody watches stderr on a terminal, and sends the results to a file."""
    pty = pytest.importorskip("pty")
    watched, terminal = pty.openpty()
    out = tmp_path / "out.txt"
    words = [sys.executable, "-m", "eagor", "track", tilting, "red", "--end", "1"]
    with out.open("w") as file, subprocess.Popen(words, stdout=file, stderr=terminal) as process:
        os.close(terminal)
        shown = b""
        with contextlib.suppress(OSError):  # the end of a terminal, on Linux
            while part := os.read(watched, 4096):
                shown += part
    os.close(watched)
    assert process.returncode == 0
    assert b"looking" in shown
    assert len(out.read_text().splitlines()) == 3
    assert b"elevation" not in shown


def test_locate_takes_a_frame_of_a_video(tilting):
    assert error_deg(answer("locate", tilting, "red", "--stamp", 1.5), POSES[6].T @ RED) < 4


# --- clips that are broken --------------------------------------------------------------------------------------------


def test_of_a_truncated_clip_comes_what_is_there(tmp_path):
    whole = filmed(tmp_path / "whole.mkv", turned(POSES))
    path, table, video = tmp_path / "cut.mkv", tmp_path / "out.csv", tmp_path / "out.mp4"
    data = whole.read_bytes()
    path.write_bytes(data[: len(data) * 3 // 5])
    done = eagor("track", path, "red", "--rate", 2, "--fps", 2, "--out", table, "--video", video)
    assert done.returncode == 3, done.stderr
    assert "the frames end early" in done.stderr
    lines = done.stdout.splitlines()
    assert 2 < len(lines) < 1 + COUNT // 2
    assert len(table.read_text().splitlines()) == len(lines)
    with av.open(str(video)) as container:
        assert len(list(container.decode(video=0))) == len(lines) - 1


# --- pictures that are no good panoramas ------------------------------------------------------------------------------


def circles(rows=ROWS):
    """Two fisheye circles, side by side."""
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : rows * 1j]
    one = np.where(np.hypot(x, y)[..., None] < 0.97, painted_room(rows, 2 * rows)[:, :rows], 0)
    return np.concatenate([one, one], axis=1).astype(np.uint8)


def test_a_dual_fisheye_is_refused_unless_forced(tmp_path):
    Image.fromarray(circles()).save(tmp_path / "fisheye.png")
    path = filmed(tmp_path / "fisheye.mp4", [circles()] * 4)
    for words in (("locate", tmp_path / "fisheye.png"), ("track", path)):
        said = refused(*words, "red")
        assert "two circles" in said
        assert "--force" in said
        done = eagor(*words, "red", "--force")
        assert done.returncode == 0
        assert done.stderr.count("two circles") == 1


def test_what_a_mask_hides_says_nothing(tmp_path):
    azimuth, _ = azimuth_elevation(RED)
    mask = np.full((ROWS, 2 * ROWS), 255, np.uint8)
    column = round((0.5 - azimuth / (2 * np.pi)) * 2 * ROWS)
    mask[:, column - 40 : column + 40] = 0
    Image.fromarray(mask).save(tmp_path / "mask.png")
    Image.fromarray(ROOM).save(tmp_path / "room.png")
    path = filmed(tmp_path / "still.mp4", [ROOM] * 3)
    words = ("red", "--mask", tmp_path / "mask.png")
    for found in (answer("locate", tmp_path / "room.png", *words), answer("track", path, *words)["frames"][-1]):
        assert found["status"] == "searching"
        assert found["presence"] < 0.5


# --- detectors and packages -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", ["nonsense", None, math.nan, [[1, 2]]])
def test_a_perception_that_returns_nonsense_is_one_line(tilting, monkeypatch, value):
    monkeypatch.setattr(checks, "make_perception", lambda *_, **__: lambda panorama, query, *, stamp=None: value)
    line = refused("track", tilting, "red", "--perception", "nonsense")
    assert line.startswith("eagor: error: the perception returned ")
    assert "wanted eagor.Evidence" in line


@pytest.mark.parametrize("package", ["av", "cv2"])
def test_without_the_extra_it_is_named(tilting, monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    assert "[photos]" in refused("track", tilting, "red")


def test_a_log_of_many_poses_is_known_from_its_beginning():
    """Two minutes at 200 a second, more than a tracker remembers."""
    poses = [Pose(k / 200, world_R_body(math.radians(k / 100))) for k in range(24_000)]
    frames = [Frame(stamp, None, str(stamp)) for stamp in (0.5025, 60.0, 119.0)]
    for step in PosedFrames(frames, GivenPoses(poses)):  # type: ignore[arg-type]
        truth = world_R_body(math.radians(2 * step.frame.stamp))
        assert step.pose is not None
        assert np.allclose(step.pose.world_R_body, truth, atol=1e-9)
