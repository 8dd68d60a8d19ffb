"""``eagor track BAG``: directions from a recorded bag, right in the painted room; and what cannot be."""

from __future__ import annotations

import json
import math
from functools import cache

import numpy as np
import pytest
from commands import answer, eagor, refused
from rosmaking import camera_info, imu_message

from eagor.cameras import Lens
from eagor.conventions import OPTICAL_R_BODY
from eagor.grids import PerspectiveGrid
from eagor.lab.worlds.painted import Room, bearing, paint
from eagor.sources import Pose
from eagor.sources import ros_messages as m
from eagor.sources.bags import BagWriter
from eagor.sources.panorama import view
from eagor.sphere import angular_distance, direction, world_R_body

START = 1_700_000_000.125
ROOM = Room()
MOUNT = world_R_body(math.radians(40), 0, 0), np.array([0.05, 0.0, 0.3])  # of the camera on the body
COUNT = 12


def body_at(t):
    """The body's pose, `t` seconds after the start: it turns, and walks a little."""
    return world_R_body(0.4 * t, 0, 0), np.array([-0.5 + 0.1 * t, 0.2, 1.0])


def camera_at(t):
    turn, place = body_at(t)
    return turn @ MOUNT[0], place + turn @ MOUNT[1]


@cache
def panorama_at(t):
    """What the camera sees; painted once for all bags."""
    turn, place = camera_at(t)
    return paint(ROOM, tuple(place), turn, 64, 128)


def as_it_is(t):
    return t


def set_back(t):
    """A clock that is set back by a second, once."""
    return t - (t >= 1.5)


def recorded(
    path, *, odometry=m.ODOMETRY, mounted=True, compressed=False, at_zero=False, frame="x3", lost=(), poses_at=as_it_is,
    pictures_at=as_it_is, at_risk=1.0,
):  # fmt: skip
    """Pictures at 4 Hz and odometry at 20 Hz for three seconds; the pictures are recorded 0.2 s after their capture.

    Of the poses with the numbers `lost` the place is beyond all reason. `poses_at(t)` and `pictures_at(t)` are what the
    headers say.
    """
    messages = []
    for k in range(COUNT):
        t = 0.25 * k
        panorama = panorama_at(t)
        if compressed:
            messages.append(
                (t + 0.2, "/x3/image/compressed", m.COMPRESSED, m.compressed_message(panorama, START + t, "x3"))
            )
        else:
            stamp = 0.0 if at_zero else START + pictures_at(t)
            late = 0.0 if at_zero else 0.2
            messages.append((t + late, "/x3/image", m.IMAGE, m.image_message(panorama, stamp, frame)))
    for k in range(-2, 62):
        t = 0.05 * k
        turn, place = body_at(t)
        pose = Pose(START + poses_at(t), turn, place + 1e30 * (k in lost))
        if odometry == m.ODOMETRY:
            messages.append((t, "/odom", m.ODOMETRY, m.odometry_message(pose)))
        elif odometry == m.IMU:
            messages.append((t, "/imu", m.IMU, imu_message(pose, "base_link")))
        elif odometry == m.TRANSFORMS:
            moved = m.transform_message(START + t, "odom", "base_link", turn, place)
            messages.append((t, "/tf", m.TRANSFORMS, m.transforms_message(moved)))
    with BagWriter(path, at_risk=at_risk) as bag:
        if mounted:
            fixed = m.transform_message(START, "base_link", "x3", *MOUNT)
            bag.write("/tf_static", m.TRANSFORMS, m.transforms_message(fixed), START - 1)
        for t, topic, kind, message in sorted(messages, key=lambda each: each[0]):
            bag.write(topic, kind, message, START + t)
    return path


def tracked(*words, code=0):
    """The frames of ``eagor track WORDS``, and what it says."""
    done = eagor("track", *words, "--json")
    assert done.returncode == code, done.stderr
    return json.loads(done.stdout)["frames"], done.stderr


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A bag as most are."""
    return recorded(tmp_path_factory.mktemp("plain") / "bag")


def check_directions(frames, degrees=2.5):
    assert len(frames) >= 5
    for frame in frames[1:]:
        truth, _ = bearing(ROOM.balls[0], camera_at(frame["stamp"] - START)[1], camera_at(frame["stamp"] - START)[0])
        found = direction(math.radians(frame["azimuth_deg"]), math.radians(frame["elevation_deg"]))
        assert math.degrees(angular_distance(truth, found)) < degrees, frame


@pytest.mark.parametrize("kind", [m.ODOMETRY, m.TRANSFORMS, m.IMU])
def test_directions_from_a_bag_are_right(tmp_path, kind):
    bag = recorded(tmp_path / "bag", odometry=kind)
    done = eagor("track", bag, "red", "--rate", "4", "--json")
    found = json.loads(done.stdout)
    topic = {m.ODOMETRY: "/odom", m.TRANSFORMS: "/tf", m.IMU: "/imu"}[kind]
    assert found["poses"] == f"poses from {topic}"
    assert len(found["frames"]) == COUNT
    assert found["frames"][3]["stamp"] == START + 0.75
    assert "12 pictures of /x3/image" in done.stderr
    check_directions(found["frames"])
    with_distance = [frame["distance_m"] is not None for frame in found["frames"]]
    assert any(with_distance) == (kind != m.IMU)


def test_a_single_file_named_topics_and_a_cut(tmp_path):
    bag = recorded(tmp_path / "bag", compressed=True) / "bag.mcap"
    frames, _ = tracked(
        bag, "red", "--image-topic", "x3/image/compressed", "--odom-topic", "/odom", "--rate", "2", "--start", "0.5",
        "--end", "2.6",
    )  # fmt: skip
    assert [frame["stamp"] - START for frame in frames] == [0.5, 1.0, 1.5, 2.0, 2.5]
    check_directions(frames)


def test_a_recording_that_was_killed(tmp_path):
    file = recorded(tmp_path / "bag", at_risk=0) / "bag.mcap"
    file.write_bytes(file.read_bytes()[: 3 * file.stat().st_size // 4])
    (tmp_path / "bag" / "metadata.yaml").unlink()
    frames, said = tracked(tmp_path / "bag", "red", "--rate", "4")
    assert "bag.mcap was cut off (it ends in the middle of a record); its first" in said
    check_directions(frames)


def test_pages_and_tables_are_written(plain, tmp_path):
    done = eagor("track", plain, "red", "--out", tmp_path / "o.csv", "--page", tmp_path / "p.html")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[1].split()[0] == "0.000"  # seconds from the first picture
    assert "the table's stamps are seconds from 1700000000.125" in done.stderr
    assert (tmp_path / "p.html").is_file()
    assert (tmp_path / "o.csv").read_text().splitlines()[1].split(",")[:2] == [
        "/x3/image at 1700000000.125 s",
        str(START),
    ]
    assert "1700000000" not in lines[1]


def test_a_bag_without_odometry_turns_by_its_pictures(tmp_path):
    found = answer("track", recorded(tmp_path / "bag", odometry=None), "red", "--rate", "4")
    assert found["poses"] == "orientations from the pictures themselves"


SENSOR, K, D = (160, 120), (130.0, 131.0, 78.0, 61.0), (-0.2, 0.05, 0.001, -0.001, 0.0)


@pytest.fixture(scope="module")
def narrow(tmp_path_factory):
    """A bag of an ordinary camera that turns past the red ball, with its camera_info; rectified pictures as well."""
    lens = Lens("camera", SENSOR, K[:2], (K[2] + 0.5, K[3] + 0.5), D)
    plain = Lens("camera", SENSOR, (110.0, 110.0), (80.5, 60.5))
    grids = {"image_raw": PerspectiveGrid.of_lens(lens), "image_rect": PerspectiveGrid.of_lens(plain)}
    place, path = np.array([-0.5, 0.2, 1.0]), tmp_path_factory.mktemp("narrow") / "bag"
    ahead = math.atan2(*bearing(ROOM.balls[0], place, np.eye(3))[0][[1, 0]])
    with BagWriter(path) as bag:
        for k in range(5):
            stamp, turn = START + 0.5 * k, world_R_body(ahead + 0.3 - 0.15 * k, 0, 0)
            seen = paint(ROOM, tuple(place), turn, 256, 512)
            frame = "lens_optical_frame"
            fixed = m.transform_message(stamp, "base_link", frame, OPTICAL_R_BODY.T)
            if k == 0:
                bag.write("/tf_static", m.TRANSFORMS, m.transforms_message(fixed), stamp)
            bag.write("/odom", m.ODOMETRY, m.odometry_message(Pose(stamp, turn, place)), stamp)
            info = camera_info(SENSOR, K, D, p=(110, 110, 80, 60), stamp=stamp, frame=frame)
            bag.write("/front/camera_info", m.CAMERA_INFO, info, stamp)
            for name, grid in grids.items():
                bag.write(f"/front/{name}", m.IMAGE, m.image_message(view(seen, grid), stamp, frame), stamp)
    return path


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--image-topic", "/front/image_raw"], "an ordinary camera, 67.5 x 53.3 degrees, says /front/camera_info"),
        (["--image-topic", "/front/image_rect", "--camera-info", "front/camera_info"], "72.1 x 57.2 degrees"),
        (["--image-topic", "/front/image_rect", "--hfov", "72.05"], "72.0 x 57.2 degrees, says --hfov 72.05"),
    ],
)
def test_an_ordinary_camera_of_a_bag_has_the_lens_that_is_told(narrow, words, said):
    frames, err = tracked(narrow, "red", "--rate", "4", *words)
    assert said in err
    for k, frame in enumerate(frames):
        assert frame["azimuth_deg"] == pytest.approx(math.degrees(0.15 * k - 0.3), abs=1)


YAWS = {"front_optical_frame": 0.0, "side": math.pi / 2}  # of two cameras on the body
RATE = math.radians(44)  # radians per second, to the right: between the cameras, neither shows a part of it


def of_two_cameras(path, frames=tuple(YAWS)):
    """A bag of a body that turns the red ball out of its front camera and into the one at its left.

    `frames`: those whose places on the body are told.
    """
    place = np.array([-0.5, 0.2, 1.0])
    ahead = math.atan2(*bearing(ROOM.balls[0], place, np.eye(3))[0][[1, 0]])
    grid = PerspectiveGrid(120, 160, math.radians(60))
    k = grid.focal, grid.focal, 79.5, 59.5
    with BagWriter(path) as bag:
        for frame in frames:
            turn = world_R_body(YAWS[frame]) @ (OPTICAL_R_BODY.T if "optical" in frame else np.eye(3))
            fixed = m.transform_message(START, "base_link", frame, turn)
            bag.write("/tf_static", m.TRANSFORMS, m.transforms_message(fixed), START)
        for number in range(5):
            for late, (frame, yaw) in enumerate(YAWS.items()):  # the cameras are not synchronous
                at, name = START + 0.5 * number + 0.1 * late, frame.partition("_")[0]
                turn = ahead - RATE * (at - START)
                pose = Pose(at, world_R_body(turn), place)
                bag.write("/odom", m.ODOMETRY, m.odometry_message(pose), at)
                seen = paint(ROOM, tuple(place), world_R_body(turn + yaw), 128, 256)
                bag.write(f"/{name}/camera_info", m.CAMERA_INFO, camera_info((160, 120), k, stamp=at, frame=frame), at)
                bag.write(f"/{name}/image_raw", m.IMAGE, m.image_message(view(seen, grid), at, frame), at)
    return path


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    return of_two_cameras(tmp_path_factory.mktemp("two") / "bag")


TWO = ("--image-topic", "/front/image_raw,/side/image_raw")
TWO_YAML = """
pictures: [{width: 160, height: 120}, {width: 160, height: 120}]
lenses:
  - {name: front, kind: pinhole, focal: 138.56, centre: [80, 60]}
  - {name: side, kind: pinhole, picture: 1, focal: 138.56, centre: [80, 60], rotation: {yaw_deg: 90}}
"""


@pytest.mark.parametrize("rig", [False, True])
def test_a_bag_of_several_cameras_is_one_panorama_with_a_mask(two, tmp_path, rig):
    """At the times of the first, with the lenses of their camera_info, and their places by the fixed transforms."""
    (tmp_path / "rig.yaml").write_text(TWO_YAML)
    words = ("--rig", tmp_path / "rig.yaml") if rig else ()
    frames, err = tracked(two, "red", "--rate", "2", *TWO, *words)
    assert "5 pictures of /front/image_raw,/side/image_raw" in err
    assert len(frames) > 3
    for each in frames:
        assert each["azimuth_deg"] == pytest.approx(math.degrees(RATE * (each["stamp"] - START)), abs=12)


def test_what_does_not_tell_where_several_cameras_are(two, tmp_path):
    said = refused("track", of_two_cameras(tmp_path / "bag", ["front_optical_frame"]), "red", *TWO)
    assert "/tf_static does not tell where side is in front_optical_frame; cameras of a rig are fixed" in said
    said = refused("track", two, "red", *TWO, "--camera-info", "/front/camera_info")
    assert "names 1 topics, and 2 have pictures; wanted one for each" in said


def test_a_lens_is_told_once(narrow):
    words = ["--image-topic", "/front/image_raw", "--camera-info", "/front/camera_info", "--hfov", "60"]
    said = refused("track", narrow, "red", *words)
    assert "--camera-info /front/camera_info and 60.0: both tell the lens of the pictures; wanted one of them" in said


def test_poses_that_cannot_be_are_left_out(tmp_path):
    frames, err = tracked(recorded(tmp_path / "bag", lost=(13, 20)), "red", "--rate", "4")
    assert len(frames) == COUNT
    check_directions(frames)
    assert err.count("a pose of /odom is left out: a position is [1e+30, 1e+30, 1e+30]; wanted finite metres") == 1


@pytest.mark.parametrize(
    ("what", "topic", "said", "count", "frames"),
    [
        ("poses", "/odom", "go back by 0.95 s at 1700000001.575 s: its poses are left out until", 19, COUNT - 3),
        ("pictures", "/x3/image", "go back by 0.75 s at 1700000001.375 s: its pictures are left out", 3, COUNT - 4),
    ],
)
def test_what_has_stamps_that_go_back_is_left_out_and_counted(tmp_path, what, topic, said, count, frames):
    found, err = tracked(recorded(tmp_path / "bag", **{f"{what}_at": set_back}), "red", "--rate", "4", code=3)
    assert len(found) == frames
    assert err.count(f"the stamps of {topic} {said}") == 1
    assert f"warning: {count} {what} of {topic} whose stamps go back are left out" in err


@pytest.mark.parametrize(("jump", "left_out"), [(1000.0, 5), (1.0, 0)])
def test_pictures_in_a_long_hole_of_the_poses_are_left_out_and_counted(tmp_path, jump, left_out):
    bag = recorded(tmp_path / "bag", poses_at=lambda t: t + jump * (t > 1.52))
    frames, err = tracked(bag, "red", "--rate", "4", code=3 if left_out else 0)
    assert len(frames) == COUNT - left_out
    said = f"{left_out} pictures are left out: /odom has no pose for more than 2 s about them"
    assert (said in err) == bool(left_out)
    assert ("/odom has no pose for 1.05 s about it" in err) == (not left_out)


def test_pictures_that_name_no_frame_are_said(tmp_path):
    frames, err = tracked(recorded(tmp_path / "bag", frame=""), "red")
    assert frames
    said = "the pictures name no frame (frame_id is empty): the camera's axes are taken for those of base_link"
    assert err.count(said) == 1


def test_pictures_without_times_take_those_of_the_recording(tmp_path):
    frames, said = tracked(recorded(tmp_path / "bag", at_zero=True), "red", "--rate", "4")
    assert "/x3/image tells no times" in said
    check_directions(frames)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--image-topic", "/camera"], "has no topic /camera; it has /odom (nav_msgs/msg/Odometry), /tf_static"),
        (["--image-topic", "/odom"], "/odom is of type nav_msgs/msg/Odometry; wanted sensor_msgs/msg/Image or"),
        (["--odom-topic", "/x3/image"], "/x3/image is of type sensor_msgs/msg/Image; wanted nav_msgs/msg/Odometry"),
        (["--odom-topic", "/nothing"], "has no topic /nothing"),
        (["--start", "100"], "there was no frame to look at"),
    ],
)
def test_topics_that_are_not_there(plain, words, said):
    assert said in refused("track", plain, "red", *words, "--json", code=1 if "--start" in words else 2)


def test_clocks_that_have_nothing_in_common(tmp_path):
    turn, place = camera_at(0)
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(4):
            panorama = paint(ROOM, tuple(place), turn, 32, 64)
            bag.write("/image", m.IMAGE, m.image_message(panorama, 50.0 + k, "x3"), START + k)
            bag.write("/odom", m.ODOMETRY, m.odometry_message(Pose(START + k, turn, place)), START + k)
    said = refused("track", tmp_path / "bag", "red")
    assert "no picture has a pose of /odom, which tells those from 1700000000.125 to 1700000003.125 s" in said
    assert "the pictures begin at 50.000 s. Are both stamped by one clock?" in said


@pytest.mark.parametrize(("topic", "poses"), [("", []), ("?topic=/x3/image", ["--poses", "ros:/odom"])])
def test_a_bag_is_played_as_a_live_camera(plain, topic, poses):
    done = eagor("live", f"{plain}{topic}", "red", "--fast", "--json", *poses)
    assert done.returncode == 0, done.stderr
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(answers) == 12
    assert "12 looks, " in done.stderr
    last = answers[-1]
    truth, _ = bearing(ROOM.balls[0], camera_at(0.25 * (COUNT - 1))[1], camera_at(0.25 * (COUNT - 1))[0])
    assert math.degrees(angular_distance(truth, np.array(last["direction"]))) < 4
