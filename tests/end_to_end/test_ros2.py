"""The node among real nodes of ROS 2: a robot that turns, and a listener, in processes of their own."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from eagor.cli import main
from eagor.robots.dds import free_domain

rclpy = pytest.importorskip("rclpy", reason="ROS 2 has wheels for x86-64 Linux alone")
from ros_peer import BALL  # noqa: E402

pytestmark = pytest.mark.xdist_group("real time")
WALKER = Path(__file__).parents[2] / "examples" / "09_twist_mux.py"
PEER = Path(__file__).parents[1] / "ros_peer.py"
RED = ("-p", "perception:=colour", "-p", 'queries:=["red ball"]')
CAMERA = ("-r", "image:=/x3/image", "-r", "odom:=/wheels")


@pytest.fixture
def domain(monkeypatch, tmp_path):
    number = free_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    monkeypatch.setenv("PYTHONPATH", f"{PEER.parent}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    return number


@pytest.fixture
def start(domain, tmp_path):
    """Start a process: of a robot (settings of `ros_peer`), or of the node (arguments after --ros-args)."""
    running = []

    def begin(*arguments, **settings):
        if arguments:
            command = [sys.executable, "-m", "eagor", "ros", "--ros-args", *arguments]
        else:
            command = [sys.executable, str(PEER), json.dumps({"seconds": 300.0, **settings})]
        log = (tmp_path / f"{len(running)}.log").open("w+b")
        running.append((subprocess.Popen(command, stdout=log, stderr=log), log))
        return running[-1][0]

    yield begin
    for process, log in running:
        process.kill()
        process.wait()
        log.close()


class Listener:
    """A node that keeps what it hears, for as long as it is asked."""

    def __init__(self):
        from diagnostic_msgs.msg import DiagnosticArray
        from std_msgs.msg import String

        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("listener", context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.answers, self.status, self.arrived = [], {}, []
        self.hear(String, "/eagor/answers", self._answered)
        self.hear(DiagnosticArray, "/diagnostics", lambda told: self.status.update({s.name: s for s in told.status}))

    def hear(self, kind, topic, heard):
        return self.node.create_subscription(kind, topic, heard, 100)

    def _answered(self, message):
        self.answers.append(json.loads(message.data))
        self.arrived.append(time.time())

    def until(self, what, most=60.0):
        """Spin until something is so; fails after `most` seconds."""
        end = time.monotonic() + most
        while not (found := what()):
            assert time.monotonic() < end, f"it did not happen; {self.answers[-1:]}, {self.status}"
            self.executor.spin_once(0.05)
        return found

    def query(self, name="red ball"):
        """The newest answer to a query."""
        return next((each for each in (self.answers or [[]])[-1] if each["query"] == name), None)

    def tracks(self, name="red ball"):
        found = self.query(name)
        return found is not None and found["status"] == "tracking" and found

    def call(self, kind, service, request, most=30.0):
        client = self.node.create_client(kind, service)
        self.until(client.service_is_ready, most)
        future = client.call_async(request)
        self.until(future.done, most)
        self.node.destroy_client(client)
        return future.result()

    def set(self, name, value):
        """Set a parameter of the node through its service; why it is refused, or ""."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        told = Parameter(name, value=value).to_parameter_msg()
        result = self.call(SetParameters, "/eagor/set_parameters", SetParameters.Request(parameters=[told])).results[0]
        return "" if result.successful else result.reason


@pytest.fixture
def listener(domain):
    found = Listener()
    yield found
    found.executor.shutdown()
    found.node.destroy_node()
    found.context.try_shutdown()


def _yaws(listener):
    """How far the robot has turned, by stamps in nanoseconds, as its odometry will tell."""
    from nav_msgs.msg import Odometry

    found = {}

    def moved(told):
        turn = told.pose.pose.orientation
        found[told.header.stamp.sec * 10**9 + told.header.stamp.nanosec] = 2 * math.atan2(turn.z, turn.w)

    listener.hear(Odometry, "/wheels", moved)
    return found


def off(answer, yaw):
    """Degrees between an answer and the ball, of a robot that has turned so far."""
    there = BALL - yaw
    truth = np.array([math.cos(there), math.sin(there), 0.0])
    return math.degrees(math.acos(float(np.clip(truth @ answer["direction"], -1, 1))))


def test_a_turning_robot_two_queries_and_a_camera_that_dies_and_comes_back(start, listener):
    from geometry_msgs.msg import PoseStamped, TwistStamped, Vector3Stamped
    from std_msgs.msg import String

    yaws, directions, poses = _yaws(listener), {}, {}
    listener.hear(Vector3Stamped, "/eagor/direction", lambda told: directions.update({told.header.stamp.nanosec: told}))
    listener.hear(PoseStamped, "/eagor/pose", lambda told: poses.update({told.header.stamp.nanosec: told}))
    robot = start(transport="compressed")
    node = start(*CAMERA, *RED, "-p", "image_transport:=compressed", "-p", "rate:=20")
    listener.until(listener.tracks)
    listener.until(lambda: len(listener.answers) > 40)
    known = [each for tick in listener.answers for each in tick if each["direction"] is not None]
    placed = [each for each in known if each["stamp_ns"] in yaws]  # stamps are those of the odometry, to the nanosecond
    assert len(placed) > 0.9 * len(known)
    assert all(each["stamp"] == each["stamp_ns"] / 10**9 for each in known)
    errors = np.array([off(each, yaws[each["stamp_ns"]]) for each in placed])
    assert np.median(errors) < 1.0
    assert np.mean(errors <= [each["credible_angle_deg"] for each in placed]) > 0.85
    answer = listener.tracks()
    told = listener.until(lambda: directions.get(answer["stamp_ns"] % 10**9))
    assert told.header.frame_id == answer["frame"] == "base_link"
    assert [told.vector.x, told.vector.y, told.vector.z] == pytest.approx(answer["direction"], abs=1e-5)
    turn = listener.until(lambda: poses.get(answer["stamp_ns"] % 10**9)).pose.orientation
    assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(math.radians(answer["azimuth_deg"]), abs=0.01)
    listener.until(lambda: "eagor" in listener.status and listener.status["eagor"].message == "all is well")

    # A volatile publisher, as rqt and Foxglove have them, and the parameter's service.
    ask = listener.node.create_publisher(String, "/eagor/query", 10)
    listener.until(lambda: ask.get_subscription_count())
    second = []
    listener.hear(Vector3Stamped, "/eagor/a_red_thing/direction", second.append)
    ask.publish(String(data="+A red thing!"))
    listener.until(lambda: listener.query("A red thing!"))
    assert [each["query"] for each in listener.answers[-1]] == ["red ball", "A red thing!"]
    listener.until(lambda: second)
    assert listener.set("queries", ["sky hook"]) == ""  # the detector alone knows that it means nothing to it
    listener.until(lambda: "sky hook" in listener.status["eagor"].message)
    assert listener.set("queries", ["red ball"]) == ""
    listener.until(listener.tracks)
    listener.until(lambda: listener.query("A red thing!") is None)
    assert "deactivate" in listener.set("rate", 5.0)

    velocities = []
    listener.hear(TwistStamped, "/eagor_vel", velocities.append)
    walker = subprocess.Popen([sys.executable, str(WALKER)])
    listener.until(lambda: len(velocities) > 5)
    assert velocities[-1].header.frame_id == "base_link"

    robot.kill()
    robot.wait()
    listener.until(lambda: any("no picture" in each for each in listener.query()["faults"]))
    listener.until(lambda: listener.status["eagor"].level == b"\x02")
    moved, ticks = len(velocities), len(listener.answers)
    listener.until(lambda: len(listener.answers) > ticks + 20)
    assert len(velocities) == moved, "an old answer moves nothing"
    walker.kill()
    walker.wait()
    start(transport="compressed", start=1.0)
    listener.until(lambda: listener.tracks() and not listener.query()["faults"])
    node.send_signal(signal.SIGINT)
    assert node.wait(20) == 130


def test_sim_time_an_ordinary_camera_and_a_query_from_before(start, listener):
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import String

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    listener.node.create_publisher(String, "/eagor/query", latched).publish(String(data="red ball; red!"))
    camera = {"sim_time": True, "hfov_deg": 90.0, "poses": "imu", "turn": 0.02, "frame": "x3_optical_frame"}
    robot = start(reliable=False, **camera)
    node = start(
        "-r", "image:=/x3/image", "-r", "imu:=/wheels", "-p", "pose_source:=imu", "-p", "use_sim_time:=true",
        "-p", "perception:=colour", "-p", "mount_xyz:=[0.1,0.0,0.5]", "-p", "mount_rpy_deg:=[0,0,90]",
    )  # fmt: skip
    answer = listener.until(listener.tracks)
    assert 1000.0 < answer["stamp"] < 1300.0
    # The camera looks to the left of the robot (the mount), whose pictures are made as if it looked ahead.
    listener.until(lambda: len(listener.answers) > 40 and listener.tracks())
    answer = listener.tracks()
    yaw = 0.02 * (answer["stamp"] - 1000.0)
    assert off(answer, yaw - math.pi / 2) < 1.0
    robot.kill()
    robot.wait()
    start(**camera)  # time goes back, and another quality of service
    listener.until(lambda: listener.tracks() and listener.query()["stamp"] < answer["stamp"])
    node.send_signal(signal.SIGTERM)
    node.wait(20)


@pytest.mark.parametrize("source", ["tf", "odom"])
def test_transforms_that_come_late(start, listener, source):
    """The camera looks to the left, with optical axes; before that is known, another answer is not kept."""
    pytest.importorskip("tf2_msgs", reason="tf2_msgs comes with a ROS installation, and with no wheel")
    from geometry_msgs.msg import PoseStamped

    places = []
    listener.hear(PoseStamped, "/eagor/pose", lambda told: places.append(told.pose.position))
    start(tf=True, static_after=12.0, frame="x3_optical_frame", turn=0.3)
    start(*CAMERA, *RED, "-p", f"pose_source:={source}")
    yaw = _yaws(listener)
    listener.until(lambda: places and places[-1].z == pytest.approx(0.5), 120.0)
    answers = len(listener.answers)
    listener.until(lambda: len(listener.answers) > answers + 60 and listener.tracks())
    told = [
        each for tick in listener.answers[answers:] for each in tick if each["stamp_ns"] in yaw and each["direction"]
    ]
    assert np.median([off(each, yaw[each["stamp_ns"]]) for each in told]) < 1.5


def test_the_life_of_a_node_and_what_it_refuses(start, listener, domain):
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState, GetState

    def change(to):
        request = ChangeState.Request(transition=Transition(id=to))
        return listener.call(ChangeState, "/eagor/change_state", request).success

    start(poses="still", turn=0.0, rows=64)
    start(*CAMERA, *RED, "-p", "autostart:=false", "-p", "pose_source:=wheel")
    assert not change(Transition.TRANSITION_CONFIGURE)
    assert listener.set("pose_source", "still") == ""
    for _ in range(2):
        assert change(Transition.TRANSITION_CONFIGURE)
        assert change(Transition.TRANSITION_ACTIVATE)
        listener.until(listener.tracks)
        assert change(Transition.TRANSITION_DEACTIVATE)
        assert change(Transition.TRANSITION_CLEANUP)
        listener.answers.clear()
    state = listener.call(GetState, "/eagor/get_state", GetState.Request()).current_state.label
    assert state == "unconfigured"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-p", "pose_source:=wheel"], "pose_source is 'wheel'; wanted one of odom, pose"),
        (["-p", "image_transport:=theora"], "image_transport is 'theora'; wanted one of raw, compressed"),
        (["-p", "queries:=[broken"], "queries:=[broken"),
    ],
)
def test_what_cannot_be_is_said_at_once(domain, capfd, arguments, said):
    assert main(["ros", "--ros-args", *arguments]) == 2
    assert said in capfd.readouterr().err


@pytest.mark.parametrize(
    ("now", "text", "after"),
    [
        (["a"], " red chair ;blue ball\n", ["red chair", "blue ball"]),
        (["a"], "+blue ball", ["a", "blue ball"]),
        (["a", "b"], "-a; +c", ["b", "c"]),
        (["a", "b"], "-a; c", ["c"]),
        (["a"], "", []),
        (["a"], "a;a", ["a"]),
        ([], ";".join(f"thing {n}" for n in range(20)), [f"thing {n}" for n in range(16)]),
    ],
)
def test_what_a_message_changes(now, text, after):
    from eagor.robots.ros.node import apply_query_command

    assert apply_query_command(now, text) == after


@pytest.mark.parametrize(
    ("queries", "found"),
    [
        (["a", "Blue  ball!"], ["~", "~/blue_ball"]),
        (["a", "blue ball", "blue-ball"], ["~", "~/blue_ball", "~/query_3"]),
        (["a", "红", "2 chairs"], ["~", "~/query_2", "~/query_3"]),
        (["a", "query 3", "!"], ["~", "~/query_3", "~/query_4"]),
    ],
)
def test_no_two_queries_share_a_topic(queries, found):
    from eagor.robots.ros.node import spaces

    assert spaces(queries) == found


def test_the_markers_stand_about_the_direction():
    from geometry_msgs.msg import Point
    from std_msgs.msg import Header

    from eagor.conventions import rotation_from_xyzw
    from eagor.robots.ros.node import markers
    from eagor.sphere import angular_distance, direction

    toward, place = direction(2.0, -0.4), np.array([0.1, 0.0, 0.5])
    estimate = SimpleNamespace(direction=toward, credible_angle=0.2, status="tracking")
    arrow, cone, words = markers(Header(frame_id="base_link"), "red ball", estimate, place)
    for each in (arrow, cone):
        at, q = each.pose.position, each.pose.orientation
        assert [at.x, at.y, at.z] == pytest.approx(place.tolist())
        assert rotation_from_xyzw(np.array([q.x, q.y, q.z, q.w]))[:, 0] == pytest.approx(toward)
    turn = rotation_from_xyzw(np.array([q.x, q.y, q.z, q.w]))
    rim = np.array([[each.x, each.y, each.z] for each in cone.points if each != Point()]) @ turn.T
    assert len(cone.points) == 3 * 24
    assert angular_distance(rim, toward) == pytest.approx(0.2)
    assert words.text == "red ball: tracking"
    assert {each.ns for each in (arrow, cone, words)} == {"red ball"}


@pytest.mark.parametrize(("kind", "rosbags"), [("pose_with_covariance", True), ("imu", False)])
def test_poses_of_each_kind(start, kind, rosbags, monkeypatch):
    """Also where rclpy alone is there to make the messages."""
    from eagor.robots.ros import RosPoses, topics

    if not rosbags:
        monkeypatch.setattr(topics, "find_spec", lambda name: None)
    start(poses=kind, rows=16)
    with closing(RosPoses("/wheels", camera="base_link")) as poses:
        found = [next(iter(poses)) for _ in range(30)]
    turns = [math.atan2(each.world_R_body[1, 0], each.world_R_body[0, 0]) for each in found]
    rates = np.diff(turns) / np.diff([each.stamp for each in found])
    assert rates == pytest.approx(0.5, abs=0.05)


def test_one_message_that_cannot_be_taken_in_does_not_end_the_hearing(start):
    from rclpy.qos import QoSProfile

    from eagor.robots.ros.topics import TopicListener
    from eagor.sources.ros_messages import ODOMETRY

    start(rows=16)
    ears, heard = TopicListener(), []

    def take(message):
        heard.append(message.header.frame_id)
        assert len(heard) > 1

    ears.subscribe(ODOMETRY, "/wheels", take, QoSProfile(depth=10))
    assert ears.wait(lambda: len(heard) > 3)
    assert set(heard) == {"odom"}
    ears.close()
    assert ears.node.context.ok() is False


def test_raw_pictures_of_a_reliable_publisher_come(start):
    """A best-effort reader gets none of these."""
    from eagor.robots.ros import RosCamera

    start(rows=895, rate=5.0, reliable=True)  # 4.8 MB
    with closing(RosCamera("/x3/image")) as camera:
        frames = iter(camera)
        stamps = [next(frames).stamp]
        missed = camera.dropped  # while the camera was opened
        stamps += [next(frames).stamp for _ in range(20)]
        came = len(stamps) + camera.dropped - missed  # the newest counts, however late this machine is
    sent = 1 + (stamps[-1] - stamps[0]) / 0.2
    assert 0.5 * sent < came < sent + 2  # who sends keeps five, and a busy machine is late by more at times


def test_who_is_not_there_is_named(domain, monkeypatch):
    from eagor.errors import DeviceError
    from eagor.robots.ros import RosCamera, topics

    monkeypatch.setattr(topics.TopicListener.wait, "__defaults__", (0.2,))
    with pytest.raises(DeviceError, match=rf"nobody publishes /nowhere \(ROS_DOMAIN_ID {domain}\)"):
        RosCamera("/nowhere")
