"""Steering hands on what the loop knows: ages, faults, velocities."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from eagor.lab.worlds.painted import painted_room
from eagor.live.events import Answer, Fault, PoseCame
from eagor.media import Pose
from eagor.perception.colour import ColourPerception
from eagor.robots.safety.gate import Mode
from eagor.robots.safety.guard import GateStatus
from eagor.robots.safety.walking import Odometer, WalkSettings, steer
from eagor.tracking import DirectionTracker


@dataclass
class Guarded:
    """A guard that notes what it is told."""

    state: GateStatus = field(default_factory=lambda: GateStatus(Mode.ARMED))
    said: list = field(default_factory=list)

    def set_velocity(self, *velocity):
        self.said.append(("velocity", velocity))

    def report(self, **known):
        self.said.append(("report", known))

    def pose(self, age):
        self.said.append(("pose", age))


@dataclass
class Loop:
    """A live loop that gives these answers; its clock is that of the last one, 20 ms later."""

    answers: list

    @property
    def clock(self):
        return self

    def now(self):
        return self.answers[-1].stamp + 0.02

    def __iter__(self):
        return iter(self.answers)


def estimate_of(yaw=0.0, looks=4):
    tracker, perceive = DirectionTracker(), ColourPerception()
    c, s = math.cos(yaw), math.sin(yaw)
    turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    for index in range(looks):
        tracker.add_pose(float(index), turned)
        tracker.observe(perceive(painted_room(64, 128), "red chair", stamp=float(index)))
    return tracker.estimate(float(looks))


def test_ages_grow_by_what_the_answer_took_and_faults_of_devices_are_handed_on():
    guard = Guarded()
    estimate = estimate_of()
    faults = (
        Fault("camera", "the camera is unplugged", 1.0), Fault("poses", "a pose is left out", 1.0),
        Fault("recording", "the disk is full", 1.0),
    )  # fmt: skip
    answer = Answer(4.0, "red chair", estimate, pose_age=0.01, look_age=1.0, image_age=0.2, faults=faults)
    (step,) = steer(Loop([answer]), guard, Odometer(guard, lambda: 4.0), WalkSettings())
    (kind, known), (_, velocity) = guard.said
    assert kind == "report"
    assert known["pose_age"] == pytest.approx(0.03)
    assert known["look_age"] == pytest.approx(1.02)
    assert known["image_age"] == pytest.approx(0.22)
    assert known["presence"] == estimate.presence
    assert known["faults"] == ("the camera is unplugged",)
    assert velocity == step.command.velocity.parts
    assert step.command.doing in ("turning", "walking")


def test_a_still_camera_counts_as_one_without_poses():
    guard = Guarded()
    answer = Answer(4.0, "red chair", estimate_of(), pose_age=None, look_age=1.0, image_age=0.2)
    list(steer(Loop([answer]), guard, Odometer(guard, lambda: 4.0), WalkSettings()))
    assert guard.said[0][1]["pose_age"] is None


def test_the_odometer_tells_of_poses_as_they_come():
    guard = Guarded()
    odometer = Odometer(guard, lambda: 10.02)
    odometer.take(PoseCame(10.01, Pose(10.0, np.eye(3), np.array([1.99, 0.0, 0.3]))), ())
    assert guard.said == [("pose", pytest.approx(0.02))]
    assert odometer.xy == pytest.approx((1.99, 0.0))
