"""The node's times: answers are stamped as their inputs are, and a simulation's clock may stand, hurry and go back."""

from __future__ import annotations

import math
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from rosgraph import FakeGraph, clock_message
from rosmaking import camera_info

from eagor import Evidence
from eagor.errors import DeviceError
from eagor.grids import PerspectiveGrid
from eagor.lab.worlds.painted import Ball, Room, bearing, paint
from eagor.live.core import LiveCore, LoopSettings
from eagor.live.events import Asked, EvidenceCame, FrameCame, PoseCame
from eagor.media import Pose
from eagor.media import ros_messages as m
from eagor.media.panorama import view
from eagor.robots.ros.graph import find_topic
from eagor.robots.ros.node import Node, NodeSettings, SimClock
from eagor.robots.ros.odometry import PoseReader
from eagor.robots.ros.pose_sources import RosPoses
from eagor.robots.ros.publishing import Stamps
from eagor.robots.ros.sources import RosCamera
from eagor.sphere import angular_distance, world_R_body

pytestmark = pytest.mark.xdist_group("real time")

LONG = 180.0
PLACE = np.array([-0.5, 0.2, 1.0])
YAWS = range(0, 360, 15)


class Robot:
    """A robot that turns, in a process's own graph: `begins` is the stamp at its start, `speed` degrees per second.

    `pace`: seconds of the robot per second of ours; 0: its time stands. `grid`: of an ordinary camera. `mounts`: of
    several of these, by the name of each, how many degrees to the left it looks; one that is `blind` shows black.
    """

    def __init__(
        self, begins, speed=30.0, pace=1.0, ball=(2.0, 1.0, 0.4), frame="base_link", grid=None, mounts=None, blind=""
    ):
        self.mounts, self.blind = {f"/{name}": math.radians(yaw) for name, yaw in (mounts or {"": 0}).items()}, blind
        names = [name.rstrip("/") for name in self.mounts]
        pictures = {f"{name}/image": m.IMAGE for name in names} | {
            f"{name}/camera_info": m.CAMERA_INFO for name in names
        }
        self.graph = FakeGraph({**pictures, "/odom": m.ODOMETRY, "/clock": m.CLOCK, "/tf_static": m.TRANSFORMS})
        if mounts:
            links = [m.transform_message(0.0, frame, n[1:], world_R_body(yaw)) for n, yaw in self.mounts.items()]
            self.graph.latched["/tf_static"] = m.transforms_message(*links)
        self.grid = grid
        self.now, self.speed, self.pace, self.silent = begins, speed, pace, False
        self.frame = frame
        self.show(ball)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def show(self, ball):
        self.room = Room(balls=(Ball(ball, 0.35, "red"),))
        self._seen = [paint(self.room, tuple(PLACE), world_R_body(math.radians(yaw)), 48, 96) for yaw in YAWS]

    def pose(self, stamp):
        return Pose(stamp, world_R_body(math.radians(self.speed * stamp)), PLACE)

    def truth(self, stamp):
        return bearing(self.room.balls[0], PLACE, self.pose(stamp).world_R_body)[0]

    def _run(self):
        before, shown = time.monotonic(), -1
        while not self._ended.wait(0.02):
            real = time.monotonic()
            self.now, before = self.now + self.pace * (real - before), real
            self.graph.feed("/clock", clock_message(self.now))
            if self.silent:
                continue
            self.graph.feed("/odom", m.odometry_message(self.pose(self.now)))
            number = int(self.speed * self.now // 15)
            new, shown = number != shown, number  # a camera shows what it saw when it looked there
            for name in self.mounts:
                self._show(name.rstrip("/"), number, new)

    def _show(self, name, number, new):
        """One camera's lens, and its picture if there is a new one."""
        frame, seen = name[1:] or self.frame, self._seen[number % len(YAWS)]
        if self.grid is not None:
            (high, wide), focal = self.grid.shape, self.grid.shape[1] / 2 / math.tan(self.grid.hfov / 2)
            k = focal, focal, wide / 2 - 0.5, high / 2 - 0.5
            self.graph.feed(f"{name}/camera_info", camera_info((wide, high), k, frame=frame))
        if new:
            if self.grid is not None:
                mount = world_R_body(self.mounts[name or "/"])
                seen = view(seen, PerspectiveGrid(*self.grid.shape, self.grid.hfov, mount)) * (name[1:] != self.blind)
            self.graph.feed(f"{name}/image", m.image_message(seen, 15 * number / self.speed, frame))

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()


@contextmanager
def running(graph, **settings):
    """A node that follows the red ball; what it says, and a thread that it runs in."""
    said, errors = [], []
    node = Node(graph, "colour", ["red ball"], NodeSettings(rate=20.0, **settings), said=said.append)

    def run():
        try:
            node.run()
        except DeviceError as error:
            errors.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield said
    finally:
        node.stop()
        thread.join(LONG)
        assert not thread.is_alive()
    assert not errors


def errors_of(robot, messages):
    """Stamps of directions, and their errors in degrees: each at the pose of its own stamp."""
    stamps = [m.stamp_of(each) for each in messages]
    found = [np.array([each.vector.x, each.vector.y, each.vector.z]) for each in messages]
    return stamps, [
        math.degrees(angular_distance(robot.truth(stamp), d)) for stamp, d in zip(stamps, found, strict=True)
    ]


@pytest.mark.parametrize("begins", [1_500_000_000.0, pytest.param(12.0, marks=pytest.mark.slow)])
def test_directions_are_stamped_with_the_poses_that_they_were_turned_with(begins):
    """The robot's clock is years off. A direction is right for the pose of its stamp, while the robot turns fast."""
    with Robot(begins, speed=60.0) as robot, running(robot.graph):
        robot.graph.until(
            lambda: (
                max(errors_of(robot, robot.graph.of("~/direction")[-10:])[1], default=99) < 4
                and len(robot.graph.of("~/direction")) > 10
            ),
            "directions are right at their stamps",
        )
    stamps, _ = errors_of(robot, robot.graph.of("~/direction"))  # after the node has ended: nothing more is sent
    assert stamps == sorted(stamps)
    assert begins <= stamps[0] <= stamps[-1] <= robot.now + 1e-6  # stamps have nanoseconds
    poses, markers = robot.graph.of("~/direction_pose"), robot.graph.of("~/markers")
    assert {m.stamp_of(each) for each in poses} <= {*stamps}
    assert {m.stamp_of(each) for each in markers[-5].markers} <= {*stamps}


def test_an_ordinary_camera_is_told_where_to_look_next():
    """Its lens comes from camera_info. Where to look stays where it is in the world between two looks."""
    grid = PerspectiveGrid(48, 64, math.radians(100))
    with Robot(12.0, grid=grid) as robot, running(robot.graph):
        told = lambda: robot.graph.of("~/next_look")  # noqa: E731
        robot.graph.until(lambda: len(told()) > 20, "it is told where to look next")
        directions = {m.stamp_of(each) for each in robot.graph.of("~/direction")}
        looks = told()
    assert {m.stamp_of(each) for each in looks} <= directions
    assert {each.header.frame_id for each in looks} == {"base_link"}
    found = [np.array([each.vector.x, each.vector.y, each.vector.z]) for each in looks]
    world = [robot.pose(m.stamp_of(each)).world_R_body @ toward for each, toward in zip(looks, found, strict=True)]
    assert any(angular_distance(a, b) < 1e-6 for a, b in pairwise(world))


def test_several_cameras_count_each_in_its_own_place():
    """Front and back, by `/tf_static`. The front one is covered: what is found was seen by the other."""
    grid = PerspectiveGrid(48, 64, math.radians(100))
    robot = Robot(12.0, grid=grid, mounts={"front": 0, "back": 180}, blind="front")
    with robot, running(robot.graph, image_topic="/front/image,/back/image") as said:
        last = lambda: robot.graph.of("~/direction")[-10:]  # noqa: E731
        robot.graph.until(
            lambda: len(last()) == 10 and max(errors_of(robot, last())[1]) < 4, "directions are right at their stamps"
        )
    assert {each.header.frame_id for each in last()} == {"base_link"}
    assert "the picture stays the same although the camera turns" in " ".join(said)  # that of the covered one


@pytest.mark.slow
def test_a_simulation_at_half_speed_that_goes_back_begins_anew():
    """As `ros2 bag play --clock --loop` does. The ball is elsewhere the second time, and so is the answer at once."""
    with Robot(1000.0, pace=0.5) as robot, running(robot.graph, use_sim_time=True) as said:
        graph = robot.graph
        right = lambda: max(errors_of(robot, graph.of("~/direction")[-10:])[1], default=99) < 4  # noqa: E731
        graph.until(lambda: right() and len(graph.of("~/direction")) > 10, "the ball is found")
        robot.show((-2.0, -1.0, 0.4))
        robot.now = 500.0
        graph.until(lambda: any("the time went back by" in text for text in said), "it is said")
        graph.until(
            lambda: len([each for each in graph.of("~/direction") if m.stamp_of(each) < 900.0]) > 10, "it goes on"
        )
        after = [each for each in graph.of("~/direction") if m.stamp_of(each) < 900.0]
        assert max(errors_of(robot, after)[1]) < 15  # nothing is left of what was believed before
        assert 500.0 <= m.stamp_of(graph.of("/diagnostics")[-1]) < 900.0
        robot.pace = 0.0
        time.sleep(0.3)  # what was begun may end
        before = len(graph.of("~/direction"))
        time.sleep(1.0)
        assert len(graph.of("~/direction")) - before <= 3  # no time passes; 20 at its full speed


@pytest.mark.slow
def test_a_robot_that_is_gone_does_not_fill_the_log():
    """Twenty answers a second say for seconds that no picture and no pose comes: one line each, and one at the end."""
    with Robot(1000.0) as robot, running(robot.graph) as said:
        robot.graph.until(lambda: robot.graph.of("~/direction"), "the ball is found")
        begun = len(said)
        robot.silent = True
        texts = lambda: [s.message for each in robot.graph.of("/diagnostics") for s in each.status]  # noqa: E731
        told = lambda: [text for text in texts() if "no picture for" in text]  # noqa: E731
        robot.graph.until(lambda: len(told()) >= 5, "it is said in the diagnostics, once a second")
        lines = said[begun:]
        assert any("no picture for" in line for line in said)
        assert len(lines) <= 8, lines
        robot.silent = False
        robot.graph.until(lambda: "camera: all is well again" in said, "the end is told")


@pytest.mark.parametrize(
    ("frame", "poses", "said"),
    [
        (
            "",
            "odom",
            "the pictures name no frame (frame_id is empty): the camera's axes are taken for those of base_link",
        ),
        pytest.param(
            "",
            "still",
            "the pictures name no frame (frame_id is empty): the camera's axes are taken for those of base_link",
            marks=pytest.mark.slow,
        ),
        ("x3", "odom", "/tf_static and /tf do not tell where x3 is in base_link: its axes are taken for the same"),
        pytest.param(
            "x3",
            "still",
            "without odometry no transforms are read: the axes of x3 are taken for those of base_link",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_camera_whose_place_on_the_body_is_not_known_is_said(frame, poses, said):
    with Robot(1000.0, frame=frame) as robot, running(robot.graph, poses=poses) as told:
        robot.graph.until(lambda: any(line.startswith(said) for line in told), told)


@pytest.mark.parametrize("left", [pytest.param({}, marks=pytest.mark.slow), {"/image": m.IMAGE, "/odom": m.ODOMETRY}])
def test_a_node_ends_at_once_though_the_robot_is_gone(monkeypatch, left):
    """It looks for a topic, or for a first message, which takes for ever here; and nothing is waited out."""
    monkeypatch.setattr("eagor.live.loop.STALLED", 0.3)
    monkeypatch.setattr("eagor.live.loop.LEAVING", 1e6)
    for waits in (find_topic, RosCamera.__init__, RosPoses.__init__):
        monkeypatch.setitem(waits.__kwdefaults__, "wait", 1e6)
    with Robot(1000.0) as robot:
        with running(robot.graph) as said:
            robot.graph.until(lambda: robot.graph.of("~/direction"), "the ball is found")
            robot.graph.found, robot.silent = {topic: (kind, 1) for topic, kind in left.items()}, True
            robot.graph.until(lambda: "the camera ended; opened again" in said, said)
        running_still = [each.name for each in threading.enumerate() if each.name.startswith("eagor")]
    assert not running_still


def test_without_a_clock_the_node_says_so():
    graph = FakeGraph({"/image": m.IMAGE})
    with pytest.raises(DeviceError, match=r"nothing came on /clock within 0.2 s, and use_sim_time is set"):
        SimClock(graph, print, wait=0.2)


def test_every_step_back_is_told_and_none_forward():
    graph, steps = FakeGraph({}), []
    graph.latched["/clock"] = clock_message(10.0)
    clock = SimClock(graph, steps.append)
    for now in (10.0, 11.0, 500.0, 499.75, 600.0, 0.0):
        graph.feed("/clock", clock_message(now))
        assert clock.now() == now
    assert steps == [0.25, 600.0]
    assert clock.slip() == 0.0
    clock.close()
    graph.feed("/clock", clock_message(77.0))
    assert clock.now() == 0.0


def test_an_answer_is_told_as_of_the_newest_pose_or_else_of_the_newest_picture():
    """The loop may have turned it further, by a turn that it expects: that is undone."""
    core = LiveCore(LoopSettings(("ball",)))
    look = Evidence.from_points(np.array([[1.0, 0.0, 0.0]]), scores=np.array([0.9]), stamp=100.0)
    core.take(PoseCame(100.0, Pose(100.0, np.eye(3))))
    core.take(FrameCame(100.0, 100.0, ""))
    core.take(PoseCame(100.1, Pose(100.1, np.eye(3))))
    core.take(EvidenceCame(100.1, 100.0, 100.0, "ball", (look,)))
    (answer,) = core.take(Asked(100.2))
    ahead = replace(answer, estimate=answer.estimate.turned(100.2, world_R_body(0.5)))
    stamps = Stamps()
    assert stamps.of(ahead, 7.0).stamp == 7.0
    stamps.take(FrameCame(100.0, 3.5, ""), ())
    assert stamps.of(ahead, 7.0).stamp == 3.5
    np.testing.assert_allclose(stamps.of(ahead, 7.0).direction, ahead.direction)
    stamps.take(PoseCame(100.1, Pose(3.25, world_R_body(0.2))), ())
    stamps.take(FrameCame(100.2, 3.75, ""), ())
    found = stamps.of(ahead, 7.0)
    assert found.stamp == 3.25
    np.testing.assert_allclose(found.direction, world_R_body(0.2).T @ answer.direction, atol=1e-9)
    # What is interpolated between two poses of slow odometry may be off, and regions say so.
    near = math.radians(10)
    assert 0.3 * found.estimate.within(near) < stamps.of(ahead, 7.0, near).estimate.within(near)
    assert stamps.of(ahead, 7.0, near).estimate.within(near) < 0.8 * found.estimate.within(near)


def test_odometry_whose_clock_is_set_back_goes_on():
    """Small steps back are messages out of order; after a large one, transforms of before are forgotten."""
    reader = PoseReader("/odom", m.ODOMETRY, camera="x3", rewinds=True)
    strict = PoseReader("/odom", m.ODOMETRY, camera="x3")

    def step(stamp, yaw):
        moved = m.transforms_message(m.transform_message(stamp, "base_link", "x3", world_R_body(yaw)))
        for each in (reader, strict):
            each.transforms(moved, False)
        return [each.take(m.odometry_message(Pose(stamp, np.eye(3), np.zeros(3)))) for each in (reader, strict)]

    assert [len(each) for each in step(100.0, 0.1)] == [1, 1]
    with pytest.warns(UserWarning, match=r"the stamps of /odom go back by 0\.50 s at 100\.000 s"):
        assert [len(each) for each in step(99.5, 0.1)] == [0, 0]
    assert (reader.back, strict.back) == (0, 1)
    (pose,), none = step(50.0, 0.7)
    assert none == []
    np.testing.assert_allclose(pose.world_R_body, world_R_body(0.7), atol=1e-9)
