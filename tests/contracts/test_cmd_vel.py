"""Velocities for a base: within the rules of the gate, zero at every fault, none while it stands."""

import math
import time

import numpy as np
import pytest

from eagor.live.events import PoseCame
from eagor.media import Pose
from eagor.robots.ros.driving import BASE, TWIST, TwistGate, body_of
from eagor.robots.ros.node import NodeSettings
from eagor.robots.safety.gate import Mode
from eagor.sphere import world_R_body

pytestmark = pytest.mark.xdist_group("real time")

WAIT = 20.0  # seconds, for what takes a tenth of one


class Topic:
    """A graph with one topic; it notes what is written."""

    def __init__(self):
        self.sent, self.closed = [], False

    def publish(self, topic, kind, *, reliable=True, depth=10, transient=False):
        assert (topic, kind, depth) == ("/cmd_vel", TWIST, 1)
        return self

    def write(self, twist):
        self.sent.append((twist.linear.x, twist.linear.y, twist.angular.z))

    def close(self):
        self.closed = True


class Base:
    """A base that is told of velocities, and whose odometry says where it is."""

    def __init__(self, gate, yaw=0.0):
        self.gate, self.place, self.yaw, self.stamp = gate, np.zeros(3), yaw, 0.0

    def tell(self, velocity=(0.2, 0.0, 0.1), *, moves=True, tilt=0.0, **changes):
        """One round of a loop: a pose, what is known, and the wanted velocity."""
        self.stamp += 0.02
        self.place = self.place + np.array([0.1 * 0.02 * moves, 0.0, 0.0])
        self.gate.take(PoseCame(self.stamp, Pose(self.stamp, world_R_body(self.yaw, tilt), self.place)), ())
        known = {"image_age": 0.1, "pose_age": 0.0, "belief_age": 0.2, "presence": 0.9, "faults": ()} | changes
        self.gate.status(**known)
        self.gate.command(*velocity)

    def until(self, what, **told):
        end = time.monotonic() + WAIT
        while not what():
            assert time.monotonic() < end, self.gate.state
            self.tell(**told)
            time.sleep(0.02)


@pytest.fixture
def topic():
    return Topic()


@pytest.fixture
def base(topic):
    gate = TwistGate(topic, "/cmd_vel", lambda stamp: np.eye(3))
    with gate:
        yield Base(gate)
    assert topic.closed


def test_a_wanted_velocity_is_reached_within_the_acceleration(base, topic):
    base.until(lambda: topic.sent[-1:] == [(pytest.approx(0.2), 0.0, pytest.approx(0.1))])
    forward = np.array([velocity[0] for velocity in topic.sent])
    assert (np.diff(forward) >= -1e-9).all()
    assert np.diff(forward).max() <= BASE.acceleration * 2 * BASE.period + 1e-9


@pytest.mark.parametrize(
    ("told", "name"),
    [
        ({"image_age": 5.0}, "image"), ({"velocity": (math.nan, 0.0, 0.0)}, "number"), ({"tilt": 0.8}, "tilt"),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in [
            ({"belief_age": 10.0}, "belief"), ({"presence": 0.2}, "presence"), ({"presence": math.nan}, "number"),
            ({"faults": ("the camera is unplugged",)}, "stated"),
        ]),
    ],
)  # fmt: skip
def test_a_fault_stops_the_base(base, topic, told, name):
    base.until(lambda: base.gate.state.mode is Mode.ARMED and topic.sent[-1][0] > 0.1)
    base.until(lambda: name in [fault for fault, _ in base.gate.state.faults], **told)
    base.until(lambda: topic.sent[-1] == (0.0, 0.0, 0.0), **told)
    base.until(lambda: base.gate.state.mode is Mode.STANDING, moves=False, **told)
    count = len(topic.sent)
    for _ in range(20):
        base.tell(moves=False, **told)
        time.sleep(0.02)
    assert len(topic.sent) == count  # others may drive now


def test_silence_of_the_loop_stops_the_base(base, topic):
    base.until(lambda: base.gate.state.mode is Mode.ARMED and topic.sent[-1][0] > 0.1)
    end = time.monotonic() + WAIT
    while topic.sent[-1] != (0.0, 0.0, 0.0):
        assert time.monotonic() < end
        time.sleep(0.02)


def test_leaving_stops_a_base_that_walks(topic):
    with TwistGate(topic, "/cmd_vel", lambda stamp: np.eye(3)) as gate:
        base = Base(gate)
        base.until(lambda: bool(topic.sent) and topic.sent[-1][0] > 0.1)
    assert topic.sent[-1] == (0.0, 0.0, 0.0)


def test_the_state_of_a_base_is_that_of_its_body_not_of_its_camera():
    mount = world_R_body(math.radians(90), 0.0, math.radians(20))
    body = [world_R_body(0.5, 0.1, -0.2), world_R_body(0.6, 0.1, -0.2)]
    before, now = (
        Pose(0.2 * k, turn @ mount, np.array([0.06 * k, 0.08 * k, 0.0])) for k, turn in enumerate(body)
    )  # fmt: skip
    state = body_of(before, now, mount, 7.0)
    assert state.stamp == 7.0
    assert (state.roll, state.pitch) == pytest.approx((-0.2, 0.1))
    assert state.speed == pytest.approx(0.5)
    assert state.turn == pytest.approx(0.5, rel=0.05)
    assert math.isnan(body_of(now, now, mount, 7.0).speed)


def test_a_base_without_odometry_is_not_driven():
    with pytest.raises(Exception, match="without odometry"):
        NodeSettings(cmd_vel="/cmd_vel", poses="auto")
