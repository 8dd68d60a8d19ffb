"""Steering hands on what the loop knows: ages, faults, velocities; and the report shows what happened."""

import math
import re
from dataclasses import dataclass, field

import numpy as np
import pytest
from eagor.robots.run_page import Plan, RobotPage, Sample, summary

from eagor.grids import PerspectiveGrid
from eagor.lab.worlds.painted import painted_room
from eagor.live.events import Answer, Fault, FrameCame, PoseCame
from eagor.media import Pose
from eagor.perception.colour import ColourPerception
from eagor.robots.safety.gate import Mode
from eagor.robots.safety.messages import GuardState
from eagor.robots.safety.walking import Odometer, WalkSettings, steer
from eagor.tracking import DirectionTracker


@dataclass
class Guarded:
    """A guard that notes what it is told."""

    state: GuardState = field(default_factory=lambda: GuardState(0.0, Mode.ARMED))
    said: list = field(default_factory=list)

    def command(self, *velocity):
        self.said.append(("command", velocity))

    def status(self, **known):
        self.said.append(("status", known))

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
    assert kind == "status"
    assert known["pose_age"] == pytest.approx(0.03)
    assert known["belief_age"] == pytest.approx(1.02)
    assert known["image_age"] == pytest.approx(0.22)
    assert known["presence"] == estimate.presence
    assert known["faults"] == ["the camera is unplugged"]
    assert velocity == step.wish.velocity.parts
    assert step.wish.doing in ("turning", "walking")


def test_a_still_camera_counts_as_one_without_poses():
    guard = Guarded()
    answer = Answer(4.0, "red chair", estimate_of(), pose_age=None, look_age=1.0, image_age=0.2)
    list(steer(Loop([answer]), guard, Odometer(guard, lambda: 4.0), WalkSettings()))
    assert guard.said[0][1]["pose_age"] == math.inf


def test_the_odometer_tells_of_poses_as_they_come_but_not_of_each():
    guard, now = Guarded(), 10.0
    odometer = Odometer(guard, lambda: now + 0.001)
    for index in range(200):
        now = 10.0 + index * 0.005
        odometer.take(PoseCame(now, Pose(now, np.eye(3), np.array([index * 0.01, 0.0, 0.3]))), ())
    assert 40 <= len(guard.said) <= 51
    assert odometer.xy == pytest.approx((1.99, 0.0))
    picture = painted_room(16, 32)
    odometer.take(FrameCame(now, now, "1", picture), ())
    assert odometer.frame.picture is picture


def samples(count=100, **changes):
    made = []
    for index in range(count):
        made.append(
            Sample(
                index * 0.05, "tracking", 0.9, 0.1, 0.2, 2.0, "walking", "it walks: 2.0 m", (0.3, 0.0, 0.1),
                None if index < 20 else (0.3, 0.0, 0.1), 0, "standing" if index < 20 else "armed", (), 0.2, 0.0,
                (0.02 * index, 0.0), 0.0, (0.02 * index, 0.01), 0.03, **changes,
            )
        )  # fmt: skip
    return made


def test_a_walk_as_a_page(tmp_path):
    plan = Plan(np.ones((40, 60), bool), np.eye(40, 60, dtype=bool), (-1.0, -1.0), 0.1, [(3.0, 0.5)])
    page = RobotPage("<b>chair</b> & co", {"robot": "<i>"}, plan)
    estimate, room = estimate_of(), painted_room(64, 128)
    for sample in samples():
        page.add(sample, room, estimate, PerspectiveGrid(64, 128, 1.5) if sample.time > 3 else None)
    text = page.write(tmp_path / "report.html").read_text()
    assert "&lt;b&gt;chair&lt;/b&gt; &amp; co" in text
    assert "<b>chair" not in text
    assert "<i>" not in text
    assert text.count("<img ") == 5  # one per second
    assert 'class="true"' in text
    assert 'class="wall"' in text
    assert len(re.findall(r"<rect", text)) == 3  # standing, armed; tracking
    facts = summary(page.samples)
    assert facts["metres"] == pytest.approx(1.98, abs=0.1)
    assert facts["median_error_deg"] == pytest.approx(math.degrees(0.03))


def test_a_walk_without_places_pictures_or_answers(tmp_path):
    page = RobotPage("chair")
    unknown = Sample(
        0.0, "searching", 0.5, None, None, None, "searching", "it searches", (0.0, 0.0, 0.4), None, 0, "dry run",
        ("there was no picture yet",), math.nan, math.nan, None, 0.0,
    )  # fmt: skip
    page.add(unknown)
    text = page.write(tmp_path / "report.html").read_text()
    assert "The odometry gave no places." in text
    assert "No picture came." in text
    assert "there was no picture yet" in text
    assert "NaN" not in text
    assert summary([]) == {}


def test_swaying_is_no_way():
    swaying = [
        Sample(
            index * 0.05, "searching", 0.5, None, None, None, "searching", "", (0, 0, 0), None, 0, "armed", (), 0.0,
            0.0, (0.03 * math.sin(index), 0.02), 0.0,
        )
        for index in range(400)
    ]  # fmt: skip
    assert summary(swaying)["metres"] == 0.0
