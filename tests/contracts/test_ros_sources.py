"""Cameras and odometry on topics, live over DDS and from bags: stamps, frames, and what cannot be."""

from __future__ import annotations

import math
import threading
import time
import warnings
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from eagor.robots.ros.graph import DdsGraph
from rosmaking import camera_info

from eagor.errors import DeviceError, FormatError, ImageError, PoseError
from eagor.lab.worlds.painted import painted_room
from eagor.media import Pose, check_camera
from eagor.media import ros_messages as m
from eagor.media.bag_sources import BagCamera, BagPoses
from eagor.media.bags import BagWriter
from eagor.media.camera_sources import open_camera
from eagor.media.intrinsics import camera_of
from eagor.robots.dds import Link, free_domain
from eagor.sphere import world_R_body

ROOM = painted_room(32, 64)
START = 1_700_000_000.0
CAMERA_HIGH = m.transform_message(0.0, "base_link", "x3_link", world_R_body(math.pi / 2, 0, 0), (0.1, 0, 0.5))


@contextmanager
def speaking(domain, speak, rate=50.0):
    """A robot that calls ``speak(publish, number)`` `rate` times a second, on a link of its own."""
    ended, writers = threading.Event(), {}
    with Link(domain, "lo") as link:

        def publish(topic, kind, message, **qos):
            if topic not in writers:
                writers[topic] = link.publish(topic, kind, **qos)
            writers[topic].write(message)

        def run():
            number = 0
            while not ended.wait(1 / rate):
                with suppress(DeviceError):  # a reader that does not keep up
                    speak(publish, number)
                number += 1

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield link
        finally:
            ended.set()
            thread.join()


def picture(number, stamp=None):
    return m.image_message(np.roll(ROOM, number, axis=1), time.time() if stamp is None else stamp, "x3_link")


def odometry(number, yaw=0.1):
    turn = world_R_body(math.remainder(yaw * number, math.tau), 0, 0)
    return m.odometry_message(Pose(time.time(), turn, np.array([number, 0.0, 0.0])))


def test_a_camera_on_a_topic_keeps_the_contract_of_cameras():
    domain = free_domain()
    with speaking(domain, lambda publish, n: publish("/image", m.IMAGE, picture(n))):
        check_camera(RosCamera("/image", domain=domain, interface="lo"), frames=5)
        camera = open_camera(f"ros:/image?domain={domain}&interface=lo", rows=16)
        assert camera.grid.shape == (16, 32)
        check_camera(camera)
        check_camera(open_camera(f"ros:/image?domain={domain}&interface=lo", camera=camera_of(70.0, None)))


def test_stamps_are_those_of_the_headers_and_topics_are_guessed():
    domain, jpeg = free_domain(), m.COMPRESSED

    def speak(publish, n):
        publish("/x3/image/compressed", jpeg, m.compressed_message(ROOM, START + n, "x3_link", kind="png"))

    with speaking(domain, speak), DdsGraph(domain, "lo") as graph:
        camera = RosCamera(graph=graph, latency=0.25)
        assert (camera.topic, camera.kind, camera.frame) == ("/x3/image/compressed", jpeg, "x3_link")
        frame = next(iter(camera))
        assert (frame.stamp - START + 0.25) % 1 == 0
        np.testing.assert_array_equal(frame.picture, ROOM)
        camera.close()


def test_a_camera_without_times_is_stamped_by_arrival():
    domain = free_domain()
    with (
        speaking(domain, lambda publish, n: publish("/image", m.IMAGE, picture(n, 0.0))),
        DdsGraph(domain, "lo") as graph,
    ):
        camera = RosCamera(graph=graph, latency=0.5)
        before = time.time()
        with pytest.warns(UserWarning, match=r"/image tells no times .* its arrival less the latency \(0.5 s\)"):
            frame = next(iter(camera))
        assert before - 5 < frame.stamp + 0.5 <= time.time()
        camera.close()


def test_a_slow_reader_gets_the_newest_picture():
    domain = free_domain()
    with (
        speaking(domain, lambda publish, n: publish("/image", m.IMAGE, picture(n, START + n))),
        DdsGraph(domain, "lo") as graph,
    ):
        camera = RosCamera(graph=graph)
        frames = iter(camera)
        first = next(frames)
        while camera.dropped < 10:
            time.sleep(0.01)
        assert next(frames).stamp >= first.stamp + 10
        camera.close()
        assert list(frames) == []


@pytest.mark.slow
def test_an_ordinary_camera_s_lens_is_told_beside_its_pictures():
    domain = free_domain()
    narrow = np.zeros((30, 40, 3), np.uint8)

    def speak(publish, n):
        publish("/front/camera_info", m.CAMERA_INFO, camera_info((40, 30), (30, 30, 19.5, 14.5), frame="lens"))
        publish("/front/image_raw", m.IMAGE, m.image_message(narrow, time.time(), ""))

    with speaking(domain, speak), DdsGraph(domain, "lo") as graph:
        for info in (None, "/front/camera_info"):
            camera = RosCamera(graph=graph, info=info)
            assert (camera.frame, camera.grid.shape) == ("lens", (30, 40))
            assert camera.grid.hfov == pytest.approx(2 * math.atan(20 / 30))
            camera.close()
        with pytest.raises(DeviceError, match="has no topic /else; it has /front/camera_info"):
            RosCamera(graph=graph, info="/else")


@pytest.mark.slow
def test_several_cameras_take_turns_and_one_that_is_silent_leaves_the_others(monkeypatch):
    """What panoramas alone can be looked at gets both in one."""
    monkeypatch.setattr("eagor.robots.ros.sources.SILENT", 0.2)
    domain, narrow, names = free_domain(), np.zeros((30, 40, 3), np.uint8), ("front", "left")
    ended, front = threading.Event(), m.transform_message(0.0, "base_link", "front", np.eye(3))
    left = m.transform_message(0.0, "base_link", "left", world_R_body(math.pi / 2))

    def speak(publish, n):
        if n == 0:
            publish("/tf_static", m.TRANSFORMS, m.transforms_message(front, left), transient=True)
        for name in names[: 1 if ended.is_set() else 2]:
            publish(f"/{name}/camera_info", m.CAMERA_INFO, camera_info((40, 30), (30, 30, 19.5, 14.5), frame=name))
            publish(f"/{name}/image", m.IMAGE, m.image_message(narrow, START + n, name))

    topics = "/front/image,/left/image"
    with speaking(domain, speak), DdsGraph(domain, "lo") as graph:
        camera = RosCamera(topics, graph=graph, stitched=True)
        frame = next(iter(camera))
        assert (frame.grid, frame.picture.shape[1]) == (None, 2 * frame.picture.shape[0])
        camera.close()
        check_camera(RosCamera(topics, graph=graph), frames=6)
        camera = RosCamera(topics, graph=graph)
        frames = iter(camera)
        seen = [next(frames) for _ in range(4)]
        assert sorted(each.lens for each in seen) == [0, 0, 1, 1]  # each pair in the order in which it came
        yaws = {each.lens: math.atan2(*each.grid.body_R_view[[1, 0], 0]) for each in seen}
        assert yaws == {0: pytest.approx(0.0), 1: pytest.approx(math.pi / 2)}
        ended.set()
        while camera.problem is None:
            assert next(frames).stamp
        assert camera.problem.startswith("no picture on /left/image for ")
        camera.close()


def test_a_lens_that_was_told_once_before_is_heard():
    """Its publisher keeps it for who comes later (transient local), and says it never again."""
    domain = free_domain()
    narrow = np.zeros((30, 40, 3), np.uint8)

    def speak(publish, n):
        publish("/image", m.IMAGE, m.image_message(narrow, time.time(), ""))

    with speaking(domain, speak) as by:
        latched = by.publish("/camera_info", m.CAMERA_INFO, depth=1, transient=True)
        latched.write(camera_info((40, 30), (30, 30, 19.5, 14.5), frame="lens"))
        with DdsGraph(domain, "lo") as graph:
            camera = RosCamera(graph=graph)
            assert (camera.frame, camera.grid.shape) == ("lens", (30, 40))
            camera.close()


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: m.image_message(np.zeros((30, 40, 3), np.uint8), START, "x"), "40 x 30, not 2:1"),
        (lambda: m.image_message(np.zeros((8, 16), np.float32), START, "x"), "encoding '32FC1'"),
    ],
)
def test_pictures_that_are_no_panoramas(made, said):
    domain = free_domain()
    with (
        speaking(domain, lambda publish, n: publish("/image", m.IMAGE, made())),
        DdsGraph(domain, "lo") as graph,
        pytest.raises(ImageError, match=said),
    ):
        RosCamera(graph=graph)


def test_topics_that_are_not_there_list_those_that_are():
    domain = free_domain()

    def speak(publish, n):
        publish("/odom", m.ODOMETRY, odometry(n))
        publish("/image", m.IMAGE, picture(n))

    with (
        speaking(domain, speak),
        DdsGraph(domain, "lo") as graph,
    ):  # fmt: skip
        from eagor.robots.ros import graph as topics

        pick = lambda kinds, asked: topics.find_topic(graph, kinds, asked, option="--image-topic", wait=1.0)  # noqa: E731
        with pytest.raises(DeviceError, match=r"has no topic /camera; it has /image \(sensor_msgs/msg/Image\), /odom"):
            pick(topics.PICTURES, "camera")
        with pytest.raises(
            DeviceError, match="/odom is of type nav_msgs/msg/Odometry; wanted sensor_msgs/msg/Image or"
        ):
            pick(topics.PICTURES, "/odom")
        assert pick(topics.PICTURES, None) == ("/image", m.IMAGE, 1)
        assert pick(topics.MOTION, "odom") == ("/odom", m.ODOMETRY, 1)
        with speaking(domain, lambda publish, n: publish("/image2", m.IMAGE, picture(n))):
            time.sleep(0.5)
            with pytest.raises(
                DeviceError, match=r"several topics that fit: /image, /image2; say which one with --image"
            ):
                pick(topics.PICTURES, None)
    with (
        DdsGraph(domain, "lo") as graph,
        pytest.raises(DeviceError, match=r"it has none: is the domain .ROS_DOMAIN_ID."),
    ):
        topics.find_topic(graph, topics.PICTURES, None, option="--image-topic", wait=0.1)


def test_a_topic_on_which_nothing_comes():
    domain = free_domain()
    with Link(domain, "lo") as link, DdsGraph(domain, "lo") as graph:
        link.publish("/image", m.IMAGE)
        with pytest.raises(DeviceError, match=r"no picture came on /image within 0\.3 s from its 1 publishers"):
            RosCamera(graph=graph, wait=0.3)


def test_odometry_with_the_camera_mounted_on_the_body():
    """The camera looks to the left of the body, 0.5 m above it."""
    domain = free_domain()

    def speak(publish, n):
        if n == 0:
            publish("/tf_static", m.TRANSFORMS, m.transforms_message(CAMERA_HIGH), transient=True)
        publish("/odom", m.ODOMETRY, odometry(n))

    with speaking(domain, speak), DdsGraph(domain, "lo") as graph:
        time.sleep(0.3)
        poses = RosPoses(graph=graph, camera="x3_link", strict=True)
        pose = next(iter(poses))
        number = round(float(pose.position[0] - (world_R_body(0, 0, 0) @ [0, 0, 0])[0]))
        for n in range(max(0, number - 2), number + 3):
            body = world_R_body(0.1 * n, 0, 0)
            if np.allclose(pose.position, body @ [0.1, 0, 0.5] + [n, 0, 0]):
                np.testing.assert_allclose(pose.world_R_body, body @ world_R_body(math.pi / 2, 0, 0), atol=1e-9)
                break
        else:
            raise AssertionError(pose.position)
        np.testing.assert_allclose(poses.reader.body_R_camera(), world_R_body(math.pi / 2, 0, 0), atol=1e-9)
        poses.close()


def test_two_publishers_of_odometry_are_refused():
    domain = free_domain()
    with (
        speaking(domain, lambda publish, n: publish("/odom", m.ODOMETRY, odometry(n))),
        DdsGraph(domain, "lo") as graph,
    ):
        poses = RosPoses(graph=graph)
        taken = iter(poses)
        next(taken)
        with speaking(domain, lambda publish, n: publish("/odom", m.ODOMETRY, odometry(n, -0.1))):
            with pytest.raises(DeviceError, match="2 publishers write /odom, and their poses would be mixed"):
                for _ in taken:
                    pass
            poses.close()
            with pytest.raises(DeviceError, match="2 publishers write /odom"):
                RosPoses("/odom", graph=graph)


def test_poses_that_are_none_are_left_out_and_counted():
    domain = free_domain()

    def speak(publish, n):
        message = odometry(n)
        if n % 2:
            message.pose.pose.orientation.w = 5.0
        publish("/odom", m.ODOMETRY, message)

    with speaking(domain, speak), DdsGraph(domain, "lo") as graph, warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        poses = RosPoses(graph=graph)
        for pose, _ in zip(poses, range(5), strict=False):
            assert round(float(pose.position[0])) % 2 == 0
        poses.close()
    assert poses.dropped >= 4
    assert [str(each.message)[:32] for each in said] == ["a pose of /odom is left out: a q"]


@pytest.mark.slow
def test_closing_lets_go_of_who_waits():
    domain = free_domain()
    with (
        speaking(domain, lambda publish, n: n or publish("/odom", m.ODOMETRY, odometry(1), transient=True), rate=20),
        DdsGraph(domain, "lo") as graph,
        pytest.raises(DeviceError, match=r"no pose came on /odom within 0\.2 s"),
    ):
        RosPoses(graph=graph, wait=0.2)
    ended = threading.Event()
    with (
        speaking(domain, lambda publish, n: publish("/odom", m.ODOMETRY, odometry(1)), rate=20),
        DdsGraph(domain, "lo") as graph,
    ):
        poses = RosPoses(graph=graph)  # its stamps are new, though it stands still

        def read():
            list(poses)
            ended.set()

        threading.Thread(target=read).start()
        poses.close()
        assert ended.wait(20)


@pytest.mark.parametrize("text", ["/a?domain=x", "/a?interfac=lo", "/a?domain"])
def test_addresses_that_say_nothing(text):
    with pytest.raises(DeviceError, match=r"wanted ros:/topic\?domain=N&interface=NAME"):
        RosCamera(text)


# --- bags ---


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
            written.write("/imu/data", m.IMU, m.imu_message(pose), t)
            written.write("/tf", m.TRANSFORMS, tf(t, "odom", "base_link", yaw, pose.position), t)
            if k % 10 == 5:
                written.write("/image", m.IMAGE, m.image_message(np.roll(ROOM, k, axis=1), t - 0.02, "x3_link"), t)
        written.write("/tf_static", m.TRANSFORMS, m.transforms_message(CAMERA_HIGH), START + 10)
    return tmp_path / "bag"


def test_pictures_of_a_bag(bag):
    camera = BagCamera(bag)
    assert (camera.topic, camera.frame, camera.count, camera.grid.shape) == ("/image", "x3_link", 10, (32, 64))
    assert [frame.stamp for frame in camera] == pytest.approx([START + 0.48 + k for k in range(10)], abs=1e-6)
    np.testing.assert_array_equal(next(iter(camera)).picture, np.roll(ROOM, 5, axis=1))
    check_camera(BagCamera(bag, latency=0.1, rows=16))


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
    with pytest.raises(FormatError, match="has no topic /x; it has /image"):
        BagPoses(bag, "/x")
    with pytest.raises(FormatError, match="/image is of type sensor_msgs/msg/Image; wanted nav_msgs/msg/Odometry or"):
        BagPoses(bag, "/image")
    with pytest.raises(FormatError, match="/odom is of type"):
        BagCamera(bag, "/odom")
    with pytest.raises(PoseError, match="/odom gives no pose: /tf_static and /tf do not tell where nowhere is in base"):
        list(BagPoses(bag, "/odom", camera="nowhere", strict=True))
    poses = BagPoses(bag, "/imu/data", camera="x3_link")  # no transform leads to imu_link
    list(poses)
    assert (
        poses.problem == "/tf_static and /tf do not tell where x3_link is in imu_link: its axes are taken for the same"
    )


def test_two_robots_on_one_topic_of_a_bag(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(10):
            pose = Pose(START + k, np.eye(3), np.zeros(3))
            bag.write("/odom", m.ODOMETRY, m.odometry_message(pose, "odom", f"robot{k % 2}"), START + k)
    with pytest.raises(FormatError, match="/odom has poses of robot0 in odom and of robot1 in odom: two publishers"):
        list(BagPoses(tmp_path / "bag"))


def test_a_turning_mount_and_an_optical_frame(tmp_path):
    """The camera is on a turntable; its frame is named as an optical one."""
    from eagor.conventions import OPTICAL_R_BODY

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
                odometry.pose.pose.orientation.w, image.encoding = 0.0, "bayer_rggb8"
            bag.write("/odom", m.ODOMETRY, odometry, START + k)
            bag.write("/image", m.IMAGE, image, START + k)
    poses, camera = BagPoses(tmp_path / "bag"), BagCamera(tmp_path / "bag")
    with pytest.warns(UserWarning, match="a pose of /odom is left out: a quaternion"):
        assert len(list(poses)) == 8
    with pytest.warns(UserWarning, match="a picture of /image is left out: an Image has the encoding 'bayer_rggb8'"):
        assert len(list(camera)) == 8
    assert (poses.dropped, camera.dropped) == (2, 2)
