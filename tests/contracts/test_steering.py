"""Steering hands on what the loop knows: ages, faults, velocities."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("cyclonedds")

from eagor.lab.worlds.painted import painted_room
from eagor.live.events import Answer, Fault, PoseReceived
from eagor.media import Pose
from eagor.perception.colour import ColourPerception
from eagor.robots.safety.gate import GateStatus, Mode
from eagor.robots.safety.walking import Odometer, WalkSettings, steer
from eagor.tracking import DirectionTracker


class Guarded(dict):
    """A guard that keeps what it is told."""

    state = GateStatus(None, Mode.ARMED)

    def set_velocity(self, *velocity):
        self["velocity"] = velocity

    def report(self, **known):
        self.update(known)

    def pose(self, age):
        self["pose"] = age


class Loop(list):
    """A live loop that gives these answers; its clock is that of the last one, 20 ms later."""

    @property
    def clock(self):
        return SimpleNamespace(now=lambda: self[-1].stamp + 0.02)


def steered(faults=(), **ages):
    """What the guard is told of an answer, and the answer's step."""
    tracker, perceive, guard = DirectionTracker(), ColourPerception(), Guarded()
    for stamp in range(4):
        tracker.add_pose(float(stamp), np.eye(3))
        tracker.observe(perceive(painted_room(64, 128), "red chair", stamp=float(stamp)))
    ages = {"pose_age": 0.01, "look_age": 1.0, "image_age": 0.2} | ages
    answer = Answer(4.0, "red chair", tracker.estimate(4.0), faults=faults, **ages)
    (step,) = steer(Loop([answer]), guard, Odometer(guard, lambda: 4.0), WalkSettings())
    return guard, step


def test_ages_grow_by_what_the_answer_took_and_faults_of_devices_are_handed_on():
    words = {"camera": "the camera is unplugged", "poses": "a pose is left out", "recording": "the disk is full"}
    guard, step = steered(tuple(Fault(part, text, 1.0) for part, text in words.items()))
    assert guard == {
        "pose_age": pytest.approx(0.03), "look_age": pytest.approx(1.02), "image_age": pytest.approx(0.22),
        "presence": step.answer.estimate.presence, "faults": ("the camera is unplugged",),
        "velocity": step.command.velocity,
    }  # fmt: skip
    assert step.command.doing in ("turning", "walking")
    assert steered(pose_age=None)[0]["pose_age"] is None  # a still camera


def test_the_odometer_tells_of_poses_as_they_come():
    guard = Guarded()
    odometer = Odometer(guard, lambda: 10.02)
    odometer.take(PoseReceived(10.01, Pose(10.0, np.eye(3), np.array([1.99, 0.0, 0.3]))), ())
    assert guard == {"pose": pytest.approx(0.02)}
    assert odometer.xy == pytest.approx((1.99, 0.0))
