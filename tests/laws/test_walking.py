"""The policy turns first, walks only towards what is ahead, stops where it should; steering hands on what is known."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("cyclonedds")

from eagor.lab.worlds.painted import painted_room
from eagor.live.events import Answer, Fault, PoseReceived
from eagor.perception.colour import ColourPerception
from eagor.robots.safety import walking as policy
from eagor.robots.safety.gate import GateStatus, Mode
from eagor.robots.safety.walking import ControllerState, Odometer, TargetView, WalkSettings, steer, walk
from eagor.sources import Pose
from eagor.tracking import DirectionTracker

RULES = WalkSettings()
STEP = 0.05
angles = st.floats(-math.pi, math.pi)
statuses = st.sampled_from(["searching", "tracking", "ambiguous", "stale"])
views = st.builds(
    TargetView,
    stamp=st.floats(0, 5), status=statuses, azimuth=st.none() | angles, elevation=st.floats(-1.57, 1.57),
    distance=st.none() | st.floats(0.01, 50), spread=st.none() | st.floats(0, 3),
    xy=st.none() | st.tuples(st.floats(-3, 3), st.floats(-3, 3)), yaw=st.none() | angles,
)  # fmt: skip


def played(goal, seconds=60.0, told=True, goals=None):
    """Walk a Go2 (dead time 0.15 s, lag 0.3 s) to a point; the path (x, y, yaw) and the commands."""
    x = y = yaw = 0.0
    speed, pipe, state, path, commands = np.zeros(3), [np.zeros(3)] * 3, ControllerState(), [], []
    for index in range(int(seconds / STEP)):
        now = index * STEP
        goal = goal if goals is None else goals(now)
        dx, dy = goal[0] - x, goal[1] - y
        azimuth = math.remainder(math.atan2(dy, dx) - yaw, 2 * math.pi)
        far = (math.hypot(dx, dy), 0.1) if told else (None, None)
        view = TargetView(now, "tracking", azimuth, 0.0, *far, (x, y), yaw)
        state, command = walk(RULES, state, view)
        pipe.append(np.array(command.velocity) * (0.8, 0.74, 0.9))
        speed = speed + (1 - math.exp(-STEP / 0.3)) * (pipe.pop(0) - speed)
        yaw += speed[2] * STEP
        x += speed[0] * math.cos(yaw) * STEP
        y += speed[0] * math.sin(yaw) * STEP
        path.append((x, y, yaw))
        commands.append(command)
    return np.array(path), commands


@given(st.lists(views, min_size=1, max_size=12))
def test_it_walks_only_towards_what_is_tracked_and_ahead(many):
    state = ControllerState()
    for view in sorted(many, key=lambda each: each.stamp):
        state, command = walk(RULES, state, view)
        velocity = command.velocity
        assert all(map(math.isfinite, velocity))
        assert velocity.left == 0
        assert 0 <= velocity.forward <= RULES.speed
        assert abs(velocity.turn) <= max(policy.TURN, policy.SEARCH_TURN)
        assert command.words
        if velocity.walks:
            assert view.status == "tracking"
            assert abs(view.azimuth) <= policy.CONE
            assert command.doing == "walking"
        if view.status in ("ambiguous", "stale") and view.azimuth is not None:
            assert not any(velocity)
        if view.status == "tracking" and view.azimuth is not None and velocity.turn:
            assert math.copysign(1, velocity.turn) == math.copysign(1, view.azimuth)


@settings(max_examples=25)
@given(st.floats(1.6, 6), angles)
def test_it_gets_there_and_stops_at_the_distance(far, direction):
    goal = (far * math.cos(direction), far * math.sin(direction))
    path, commands = played(goal, seconds=40)
    assert commands[-1].doing == "arrived"
    assert math.dist(path[-1][:2], goal) == pytest.approx(RULES.distance, abs=0.12)
    nearest = np.hypot(*(path[:, :2] - goal).T).min()
    assert nearest > RULES.distance - 0.12
    first = next(index for index, command in enumerate(commands) if command.doing == "walking")
    assert all(command.doing == "turning" for command in commands[:first])
    assert np.abs(path[:first, :2]).max(initial=0.0) < 1e-9  # it turned in place before it walked: no wide curve
    assert abs(math.remainder(math.atan2(*(np.array(goal) - path[-1, :2])[::-1]) - path[-1, 2], 2 * math.pi)) < 0.2


@pytest.mark.parametrize(
    ("free", "words"), [(0.0, "it walks"), (0.3, "it walks"), (0.7, "in the way"), (1.0, "in the way")]
)
def test_only_the_time_that_the_gate_lets_it_walk_counts_as_stuck(free, words):
    """Ten seconds on the spot, free in that share of each second. The gate, or a dry run, holds it for the rest."""
    state, command = ControllerState(), None
    for index in range(200):
        view = TargetView(index * STEP, "tracking", 0.0, 0.0, 5.0, 0.1, (0.0, 0.0), 0.0)
        state, command = walk(RULES, state, view, held=index % 20 >= 20 * free)
    assert words in command.words
    assert command.doing == ("walking" if words == "it walks" else "holding")


def test_without_a_distance_it_goes_slowly_and_only_so_far():
    path, commands = played((100.0, 0.0), told=False)
    assert max(command.velocity.forward for command in commands) <= policy.BLIND_SPEED
    assert RULES.blind <= path[-1][0] < RULES.blind + 0.2
    assert "not known after 3 m" in commands[-1].words


def test_a_distance_of_large_spread_is_none_and_it_stops_where_the_thing_may_be_very_near():
    def told(distance, spread, rules=RULES):
        return walk(rules, ControllerState(), TargetView(0.0, "tracking", 0.0, 0.0, distance, spread))[1]

    assert told(5.0, 0.2).velocity.forward > 0.3
    assert told(5.0, 1.0).velocity.forward <= policy.BLIND_SPEED
    assert not told(0.5, 0.3).velocity.walks
    near = told(0.5, 0.3, replace(RULES, distance=0.3))
    assert not near.velocity.walks
    assert "may be as near as 0.4 m" in near.words


def test_it_searches_towards_where_the_thing_was_and_gives_up_after_two_turns():
    state, yaw = ControllerState(), 0.0
    state, _ = walk(RULES, state, TargetView(0.0, "tracking", -0.5, 0.0))
    state, _ = walk(RULES, state, TargetView(0.05, "tracking", -0.5, 0.0))
    turned = 0.0
    for index in range(2, 2000):
        state, command = walk(RULES, state, TargetView(index * STEP, "searching", None, xy=(0.0, 0.0), yaw=yaw))
        if command.doing == "holding":
            break
        assert command.velocity.turn == -policy.SEARCH_TURN
        yaw = math.remainder(yaw + command.velocity.turn * STEP, 2 * math.pi)
        turned += abs(command.velocity.turn) * STEP
    assert turned == pytest.approx(4 * math.pi, abs=0.1)
    assert "2 turns" in command.words
    state, command = walk(RULES, state, TargetView(200.0, "tracking", 1.0, 0.0))
    assert command.velocity.turn > 0
    _, command = walk(RULES, state, TargetView(200.05, "searching", None))
    assert command.doing == "searching"


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
