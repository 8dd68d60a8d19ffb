"""Cameras and odometry of bags: stamps, frames, and what cannot be."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from moving_rooms import PatternRoom
from rosmaking import camera_info, image_of, imu_message

from eagor.conventions import OPTICAL_R_BODY
from eagor.errors import FormatError, ImageError, PoseError
from eagor.lab.worlds.painted import painted_room
from eagor.sources import Pose, check_camera
from eagor.sources import ros_messages as m
from eagor.sources.bags import BagWriter, pick
from eagor.sources.camera_sources import open_source
from eagor.sources.odometry import open_poses
from eagor.sources.panorama import turn
from eagor.sources.ros_frames import PoseReader, optical
from eagor.sources.ros_sources import BagCamera, BagPoses
from eagor.sphere import world_R_body

ROOM = painted_room(32, 64)
START = 1_700_000_000.0
CAMERA_HIGH = m.transform_message(0.0, "base_link", "x3_link", world_R_body(math.pi / 2, 0, 0), (0.1, 0, 0.5))


def tf(stamp, parent, child, yaw, place):
    return m.transforms_message(m.transform_message(stamp, parent, child, world_R_body(yaw, 0, 0), place))


@pytest.fixture
def bag(tmp_path):
    """Ten pictures a second apart, odometry at 10 Hz, the same as transforms and as an IMU; the camera is mounted."""
    with BagWriter(tmp_path / "bag") as written:
        for k in range(100):
            t, yaw = START + 0.1 * k, 0.05 * k
            pose = Pose(t, world_R_body(yaw, 0, 0), np.array([0.01 * k, 0, 0]))
            written.write("/odom", m.ODOMETRY, m.odometry_message(pose), t)
            written.write("/imu/data", m.IMU, imu_message(pose), t)
            written.write("/tf", m.TRANSFORMS, tf(t, "odom", "base_link", yaw, pose.position), t)
            if k % 10 == 5:
                written.write("/image", m.IMAGE, m.image_message(np.roll(ROOM, k, axis=1), t - 0.02, "x3_link"), t)
        written.write("/tf_static", m.TRANSFORMS, m.transforms_message(CAMERA_HIGH), START + 10)
    return tmp_path / "bag"


def test_pictures_of_a_bag(bag):
    camera = BagCamera(bag)
    assert (camera.topic, camera.frame, camera.count) == ("/image", "x3_link", 10)
    frames = [*open_source(str(bag))]
    assert [frame.stamp for frame in frames] == pytest.approx([START + 0.48 + k for k in range(10)], abs=1e-6)
    np.testing.assert_array_equal(frames[0].picture, np.roll(ROOM, 5, axis=1))
    check_camera(open_source(str(bag), latency=0.1, rows=16))


@pytest.mark.parametrize("topic", ["/odom", "/imu/data", "/tf"])
@pytest.mark.parametrize("camera", [None, "x3_link"])
def test_poses_of_a_bag_agree_wherever_they_come_from(bag, topic, camera):
    poses = list(BagPoses(bag, topic, camera=camera))
    assert len(poses) == 100
    for k, pose in enumerate(poses):
        body = world_R_body(0.05 * k, 0, 0)
        turn = np.eye(3) if camera is None or topic == "/imu/data" else world_R_body(math.pi / 2, 0, 0)
        np.testing.assert_allclose(pose.world_R_body, body @ turn, atol=1e-9)
        if topic != "/imu/data":
            arm = [0, 0, 0] if camera is None else body @ [0.1, 0, 0.5]
            np.testing.assert_allclose(pose.position, [0.01 * k + arm[0], arm[1], arm[2]], atol=1e-9)


def test_odometry_is_preferred_and_what_is_missing_is_said(bag):
    assert BagPoses(bag).topic == "/odom"
    poses = BagPoses(bag, "/imu/data", camera="x3_link")  # no transform leads to imu_link
    list(poses)
    said = "/tf_static and /tf do not tell where x3_link is in imu_link: the camera is taken to look ahead along it"
    assert poses.problem == said


def test_two_robots_on_one_topic_of_a_bag(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(10):
            pose = Pose(START + k, np.eye(3), np.zeros(3))
            bag.write("/odom", m.ODOMETRY, m.odometry_message(pose, "odom", f"robot{k % 2}"), START + k)
    with pytest.raises(FormatError, match="/odom has poses of robot0 in odom and of robot1 in odom: two publishers"):
        list(BagPoses(tmp_path / "bag"))


def test_a_turning_mount_and_an_optical_frame(tmp_path):
    """The camera is on a turntable; its frame is named as an optical one."""
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(20):
            t = START + 0.1 * k
            bag.write("/tf", m.TRANSFORMS, tf(t, "odom", "base_link", 0.1 * k, (k, 0, 0)), t)
            if k % 2 == 0:  # at half the rate: interpolated between
                bag.write("/tf", m.TRANSFORMS, tf(t, "base_link", "table", -0.3 * k, (0, 0, 1)), t)
        lens = m.transform_message(0.0, "table", "lens_optical_frame", OPTICAL_R_BODY.T, (0, 0, 0.1))
        bag.write("/tf_static", m.TRANSFORMS, m.transforms_message(lens), START)
    poses = list(BagPoses(tmp_path / "bag", camera="lens_optical_frame"))
    assert len(poses) == 10
    for k, pose in enumerate(poses):
        np.testing.assert_allclose(pose.world_R_body, world_R_body(-0.4 * k, 0, 0), atol=1e-9)
        np.testing.assert_allclose(pose.position, [2 * k, 0, 1.1], atol=1e-9)


def test_odometry_of_which_no_message_is_a_pose_says_why(tmp_path):
    odometry = m.odometry_message(Pose(START, np.eye(3), np.zeros(3)))
    odometry.pose.pose.orientation.w = 0.0
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(3):
            bag.write("/odom", m.ODOMETRY, odometry, START + k)
    poses, said = BagPoses(tmp_path / "bag"), "all 3 messages are left out; the first: a quaternion"
    with pytest.warns(match="a pose of /odom is left out"), pytest.raises(PoseError, match=said):
        list(poses)


def test_damaged_messages_are_left_out_and_counted(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(10):
            odometry = m.odometry_message(Pose(START + k, np.eye(3), np.zeros(3)))
            image = m.image_message(ROOM, START + k, "x3")
            if k in (3, 4):
                odometry.pose.pose.orientation.w, image.encoding = 0.0, "16UC1"
            bag.write("/odom", m.ODOMETRY, odometry, START + k)
            bag.write("/image", m.IMAGE, image, START + k)
    poses = BagPoses(tmp_path / "bag")
    with pytest.warns(UserWarning, match="a pose of /odom is left out: a quaternion"):
        assert len(list(poses)) == 8
    problems = [frame.problem for frame in open_source(str(tmp_path / "bag")) if frame.picture is None]
    assert len(problems) == poses.dropped == 2
    assert all("an Image has the encoding '16UC1'" in problem for problem in problems)


@pytest.mark.parametrize(
    "name",
    ["cam_optical_frame", "cam_optical", "camera_link_optical", "left_optical_link", "robot1/cam_optical_frame",
     "Camera_Optical_Frame", "optical", "cameraOpticalFrame", "rgb_optical_frame_2", "optical_frame_left",
     "cam_optical_frame_link", "cam_optic_frame"],
)  # fmt: skip
def test_optical_frames_by_all_their_names(name):
    np.testing.assert_array_equal(optical(name), OPTICAL_R_BODY)


@pytest.mark.parametrize("name", ["camera_link", "optical_flow_link", "", "x3", "optical_frame_mount", "panoptic"])
def test_frames_that_are_not_optical(name):
    np.testing.assert_array_equal(optical(name), np.eye(3))


LEANING = world_R_body(0.4, 0.3, 0.0)  # to the left, and down


@pytest.mark.parametrize(
    ("name", "mount", "said"),
    [
        ("cam_optical", LEANING @ OPTICAL_R_BODY.T, None),
        ("cam_link", LEANING, None),
        ("cam_link", world_R_body(0.0, math.pi / 2, 0.0), None),  # looks at the floor
        ("cam_link", np.diag([1.0, -1, -1]), None),  # hangs upside down
        (
            "cam_optical_frame",
            LEANING,
            "is named as an optical frame .* with its z axis up: the camera is taken to look",
        ),
        ("cam_link", LEANING @ OPTICAL_R_BODY.T, "is not named as an optical frame, .* name it cam_link_optical_frame"),
    ],
)
def test_a_name_that_contradicts_the_mount_is_said_once(tmp_path, name, mount, said):
    with BagWriter(tmp_path / "bag") as bag:
        fixed = m.transform_message(START, "base_link", name, mount)
        bag.write("/tf_static", m.TRANSFORMS, m.transforms_message(fixed), START)
        for k in range(5):
            bag.write("/odom", m.ODOMETRY, m.odometry_message(Pose(START + k, np.eye(3), np.zeros(3))), START + k)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        poses = list(BagPoses(tmp_path / "bag", camera=name))
    np.testing.assert_allclose(poses[-1].world_R_body, mount @ optical(name), atol=1e-9)
    assert len(told) == (said is not None)
    if said:
        with pytest.warns(UserWarning, match=said):
            list(BagPoses(tmp_path / "bag", camera=name))


def test_poses_before_the_mount_is_known_are_left_out(tmp_path):
    """The camera is on a joint that is told of late: before, nobody knows where it looks."""
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(20):
            t = START + 0.1 * k
            bag.write("/tf", m.TRANSFORMS, tf(t, "odom", "base_link", 0.0, (k, 0, 0)), t)
            bag.write("/odom", m.ODOMETRY, m.odometry_message(Pose(t, np.eye(3), np.zeros(3))), t)
            if k >= 10:
                bag.write("/tf", m.TRANSFORMS, tf(t, "base_link", "neck", 1.0, (0, 0, 1)), t)
    for topic, left in (("/tf", 10), ("/odom", 10)):
        poses = list(BagPoses(tmp_path / "bag", topic, camera="neck"))
        assert 0 < len(poses) <= left
        for pose in poses:
            np.testing.assert_allclose(pose.world_R_body, world_R_body(1.0, 0, 0), atol=1e-9)
    lost = BagPoses(tmp_path / "bag", "/tf", camera="nowhere")
    assert len(list(lost)) == 20
    assert lost.problem == (
        "/tf and /tf_static do not tell where nowhere is: it is taken to look ahead along base_link"
    )  # fmt: skip
    live = PoseReader("/tf", m.TRANSFORMS, camera="neck", strict=True)
    assert live.transforms(tf(1.0, "odom", "base_link", 0.0, (0, 0, 0)), False) == []


@pytest.mark.parametrize("kind", [m.POSE_WITH_COVARIANCE, m.TRANSFORM])
def test_poses_of_localization_and_of_motion_capture(tmp_path, kind):
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(5):
            pose = Pose(START + k, world_R_body(0.1 * k), np.array([k, 0.0, 1.0]))
            whole = m.odometry_message(pose, "map", "base_link")
            made = m.message(m.POSE_WITH_COVARIANCE, header=whole.header, pose=whole.pose)
            if kind == m.TRANSFORM:
                made = m.transform_message(pose.stamp, "map", "base_link", pose.world_R_body, pose.position)
            bag.write("/amcl_pose", kind, made, pose.stamp)
            if k == 0:
                bag.write("/tf_static", m.TRANSFORMS, m.transforms_message(CAMERA_HIGH), START)
    poses = list(BagPoses(tmp_path / "bag", camera="x3_link"))  # it is the only one there is
    assert [pose.position[2] for pose in poses] == [1.5] * 5
    np.testing.assert_allclose(poses[3].world_R_body, world_R_body(0.3 + math.pi / 2), atol=1e-9)


def test_what_is_not_about_where_the_robot_is_is_not_taken_by_itself():
    topics = {"/goal_pose": m.POSE, "/imu": m.IMU, "/image": m.IMAGE, "/depth/compressedDepth": m.COMPRESSED}
    assert pick(topics, (m.POSE, m.IMU), None, where="it", option="-o") == ("/imu", m.IMU)
    assert pick(topics, (m.POSE, m.IMU), "/goal_pose", where="it", option="-o") == ("/goal_pose", m.POSE)
    assert pick(topics, (m.IMAGE, m.COMPRESSED), None, where="it", option="-o") == ("/image", m.IMAGE)


def turning_bag(path, mount=OPTICAL_R_BODY.T, told=lambda R: R, frame="cam_optical_frame", stuck=False):
    """A camera that turns to the left in a room with patterns, on a robot whose odometry is `told` of its poses."""
    room, poses = PatternRoom(4).panorama(np.eye(3), rows=128), [world_R_body(0.3 * k) for k in range(14)]
    with BagWriter(path) as bag:
        for k, pose in enumerate(poses):
            t, said = START + 0.5 * k, Pose(START + 0.5 * k, told(pose), np.zeros(3))
            bag.write("/odom", m.ODOMETRY, m.odometry_message(said), t)
            fixed = m.transform_message(t, "base_link", frame, mount)
            bag.write("/tf_static", m.TRANSFORMS, m.transforms_message(fixed), t)
            bag.write("/image", m.IMAGE, m.image_message(turn(room, pose.T), START if stuck else t, frame), t)
    return poses


@pytest.mark.parametrize(
    ("wrong", "words", "axes"),
    [
        ({}, None, "auto"),
        ({"told": lambda R: R.T}, "the other way round", None),
        ({"told": lambda R: np.eye(3)}, "stamps of the pictures' clock", None),
        ({"frame": "cam_link"}, "--axes optical", "optical"),  # which its mount contradicts, too
        ({"mount": np.eye(3)}, "--axes body", "body"),
        ({"mount": OPTICAL_R_BODY}, "the poses of this camera", None),  # parent and child were swapped
    ],
)
def test_odometry_of_a_bag_that_contradicts_its_pictures_is_said_with_what_settles_it(tmp_path, wrong, words, axes):
    poses, said = turning_bag(tmp_path / "bag", **wrong), []
    open_poses("auto", open_source(str(tmp_path / "bag")), say=said.append)
    assert len(said) == (words is not None)
    assert not words or (said[0].startswith("warning: /odom contradicts the pictures (from ") and words in said[0])
    if axes:
        found = list(open_poses("auto", open_source(str(tmp_path / "bag")), axes=axes, say=said.append))
        np.testing.assert_allclose([each.world_R_body for each in found], poses, atol=1e-9)
        assert len(said) == (words is not None)


def test_stamps_that_stand_still_are_said(tmp_path):
    turning_bag(tmp_path / "bag", stuck=True)
    with pytest.warns(UserWarning, match=f"the stamps of /image stand still at {START:.3f} s: one picture of each"):
        assert len(list(open_source(str(tmp_path / "bag")))) == 1


@pytest.mark.parametrize(("headers", "stamps"), [((0, 1, 2), [0, 1, 2]), ((0, 0, 0), [1e9, 1e9 + 1, 1e9 + 2])])
def test_a_clock_that_begins_at_0_is_none_that_is_not_set(tmp_path, headers, stamps):
    """As that of a simulation, recorded by the clock of the machine."""
    with BagWriter(tmp_path / "bag") as out:
        for at, stamp in enumerate(headers):
            out.write("/image", m.IMAGE, m.image_message(np.zeros((4, 8, 3), np.uint8), stamp, "lens"), 1e9 + at)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        assert [stamp for stamp, _ in BagCamera(tmp_path / "bag").pictures()] == stamps
    assert bool(said) == (headers[1] == 0)


def test_how_colours_without_names_are_read_is_said(tmp_path):
    made = image_of("8UC3", ROOM[..., ::-1], stamp=START)
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/image", m.IMAGE, made, START)
    with pytest.warns(UserWarning, match="/image: the encoding 8UC3 names no colours; it is read as bgr8"):
        (frame,) = open_source(str(tmp_path / "bag"))
    np.testing.assert_array_equal(frame.picture, ROOM)


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: m.image_message(np.zeros((30, 40, 3), np.uint8), START, "x"), "40 x 30, not 2:1"),
        (lambda: image_of("32FC1", np.zeros((8, 16), np.float32)), "encoding '32FC1'"),
    ],
)
def test_pictures_that_are_no_panoramas(tmp_path, made, said):
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/image", m.IMAGE, made(), START)
    with pytest.raises(ImageError, match=said):
        BagCamera(tmp_path / "bag")


def test_the_lens_of_an_ordinary_camera_is_told_beside_its_pictures(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        info = camera_info((40, 30), (30, 30, 19.5, 14.5), frame="lens")
        bag.write("/front/camera_info", m.CAMERA_INFO, info, START)
        bag.write("/front/image_raw", m.IMAGE, m.image_message(np.zeros((30, 40, 3), np.uint8), START, ""), START)
    for told in (None, "/front/camera_info"):
        camera = BagCamera(tmp_path / "bag", info=told)
        view = camera.builder.view
        assert (camera.frame, view.shape) == ("lens", (30, 40))
        assert view.hfov == pytest.approx(2 * math.atan(20 / 30))
