"""No sequence of inputs leads to motion while a fault holds; limits, latch and dry run hold in every sequence."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from eagor.errors import EagorError
from eagor.robots.go2.plant import Plant, PlantSettings
from eagor.robots.safety import Body, Gate, Inputs, Limits, Mode, State, Velocity
from eagor.robots.safety.gate import Stop
from eagor.robots.safety.limits import faults_of, heard, look_age, picture_age

LIMITS = Limits()
PERIOD = LIMITS.period
WANTED = Velocity(0.4, 0.0, 0.3)
odd = st.sampled_from([math.nan, math.inf, -math.inf, -1e9, 1e9])
speeds = st.one_of(st.floats(-2, 2), odd)


def good(now, wanted=WANTED, **changes):
    """Inputs at which nothing is wrong."""
    body = Body(now, 0.02, -0.03, 0.0, 0.0)
    known = Inputs(wanted, now, now, now, now, 0.9, now, body=body, deadman=True)
    return replace(known, **changes)


@st.composite
def wrongs(draw):
    """Changes of good inputs: a function of the time that gives the fields to replace. Many steps change nothing."""
    late = draw(st.one_of(st.none(), odd, st.floats(-0.2, 5.0)))
    name = draw(st.sampled_from(["image", "pose", "belief", "heartbeat", "command"]))
    kind = draw(st.sampled_from(["nothing"] * 4 + [
        "stamp", "wanted", "presence", "gone", "stated", "tilt", "state", "code", "deadman", "emergency", "reset",
        "odd body", "no body", "slow", "acknowledged",
    ]))  # fmt: skip
    value, wanted, flag = draw(speeds), Velocity(*draw(st.tuples(speeds, speeds, speeds))), draw(st.booleans())
    number = draw(st.integers(-1, 50))

    def change(now, body):
        return {
            "nothing": {}, "stamp": {name: None if late is None else now - late}, "wanted": {"wanted": wanted},
            "presence": {"presence": abs(value) / 2}, "gone": {"gone": True}, "stated": {"stated": ("it smells",)},
            "tilt": {"body": replace(body, roll=value)}, "code": {"body": replace(body, error_code=7)},
            "state": {"body": replace(body, stamp=now - (late if late is not None else 1.0))},
            "deadman": {"deadman": False}, "emergency": {"emergency": True}, "reset": {"reset": True},
            "odd body": {"body": replace(body, speed=value, turn=value)}, "no body": {"body": None},
            "slow": {"wanted": Velocity(0.0, 0.0, 0.3 if flag else 0.0)}, "acknowledged": {"acknowledged": number},
        }[kind]  # fmt: skip

    return change


@dataclass
class Step:
    """One step of a sequence as it was played."""

    now: float
    inputs: Inputs
    before: State
    after: State
    output: object


clocks = st.one_of(st.just(PERIOD), st.just(PERIOD), st.sampled_from([0.0, 0.3, 1.0, -0.5, -1e6, 1e6, math.nan]))
spells = st.lists(st.tuples(wrongs(), st.integers(1, 60), clocks, st.booleans()), min_size=1, max_size=12)


def play(gate, spells, warm=40):
    """Spells of steps: in each the same thing is wrong for some steps, and the clock jumps once at its start."""
    now, state, steps, told, heard = 100.0, State(), [], Velocity(), 0
    plan = [(lambda now, body: {}, warm, PERIOD, True), *spells]
    for change, count, jump, acknowledges in plan:
        for index in range(count):
            pace = jump if index == 0 else PERIOD
            time = now + pace
            now = time if math.isfinite(time) else now
            body = Body(now, 0.0, 0.0, 0.8 * abs(told.forward), 0.8 * told.turn)
            inputs = replace(good(now, body=body), acknowledged=heard)
            inputs = replace(inputs, **change(now, body))
            before = state
            state, output = gate.step(state, time, inputs)
            steps.append(Step(time, inputs, before, state, output))
            if isinstance(output.send, Stop):
                told, heard = Velocity(), output.send.number if acknowledges else heard
            elif output.send is not None:
                told = output.send
    return steps


def moves(output):
    return isinstance(output.send, Velocity) and not output.send.still


def test_that_it_moves_when_nothing_is_wrong_and_not_before_it_has_settled():
    steps = play(Gate(armed=True), [], warm=200)
    first = next(step for step in steps if moves(step.output))
    assert LIMITS.settle <= first.now - steps[0].now <= LIMITS.settle + 2 * PERIOD
    assert steps[-1].output.send == Velocity(0.4, 0.0, 0.3)
    assert steps[-1].output.mode is Mode.ARMED
    assert steps[-1].output.reasons == ()


@settings(max_examples=150, deadline=None)
@given(spells)
def test_nothing_moves_while_a_fault_holds(spells):
    for step in play(Gate(armed=True), spells):
        if faults_of(LIMITS, step.now, step.inputs, step.before.sent) or step.inputs.emergency:
            assert not isinstance(step.output.send, Velocity)
            assert step.output.mode is not Mode.ARMED
            assert step.output.reasons or step.inputs.emergency
        for value in getattr(step.output.send, "parts", ()):
            assert math.isfinite(value)


@settings(max_examples=150, deadline=None)
@given(spells)
def test_a_moving_robot_is_stopped_in_the_step_of_the_fault_and_until_it_acknowledges(spells):
    waiting = None  # the number of the first StopMove that must be acknowledged
    for step in play(Gate(armed=True), spells):
        if step.before.mode is Mode.ARMED and step.output.faults:
            assert isinstance(step.output.send, Stop)
        if waiting is not None and not isinstance(step.output.send, Stop):
            heard = (step.inputs.acknowledged or 0) >= waiting
            assert not isinstance(step.output.send, Velocity) or step.after.mode is Mode.STOPPING or heard
            if step.after.mode is Mode.STANDING:
                assert heard
                waiting = None
        if step.before.mode is not Mode.STOPPING and step.after.mode is Mode.STOPPING:
            waiting = step.output.send.number


@settings(max_examples=150, deadline=None)
@given(spells)
def test_speed_and_acceleration_stay_within_the_limits(spells):
    last, when = Velocity(), None
    for step in play(Gate(armed=True), spells):
        sent = step.output.send
        if not isinstance(sent, Velocity):
            last = Velocity() if isinstance(sent, Stop) else last
            when = step.now if math.isfinite(step.now) else when
            continue
        assert -LIMITS.backward <= sent.forward <= LIMITS.forward
        assert abs(sent.left) <= LIMITS.sideways
        assert abs(sent.turn) <= LIMITS.turn
        gone = max(step.now - when, 0.0) if when is not None else 0.0
        rates = (LIMITS.acceleration, LIMITS.acceleration, LIMITS.turn_acceleration)
        for before, after, rate in zip(last.parts, sent.parts, rates, strict=True):
            speeding = abs(after) - abs(before) if before * after >= 0 else abs(after)
            assert speeding <= rate * min(gone, 2 * PERIOD) + 1e-9
        last, when = sent, step.now


@settings(max_examples=100, deadline=None)
@given(spells, spells)
def test_the_emergency_stop_stays_until_somebody_releases_it(first, second):
    gate = Gate(armed=True)
    pressed = (lambda now, body: {"emergency": True}, 1, PERIOD, True)
    steps = play(gate, [*first, pressed, *second])
    at = 40 + sum(spell[1] for spell in first)
    assert isinstance(steps[at].output.send, Stop) or steps[at].before.latched or steps[at].before.mode is Mode.STOPPING
    for step in steps[at:]:
        if step.inputs.reset and not step.inputs.emergency:
            break
        assert not isinstance(step.output.send, Velocity)
        assert step.output.mode in (Mode.STOPPING, Mode.LATCHED)


@settings(max_examples=100, deadline=None)
@given(spells)
def test_a_dry_run_sends_nothing_but_says_what_it_would(spells):
    steps = play(Gate(armed=False), spells)
    assert all(step.output.send is None for step in steps)
    assert {step.output.mode for step in steps} <= {Mode.DRY_RUN, Mode.LATCHED}
    assert any(isinstance(step.output.would, Velocity) and not step.output.would.still for step in steps)


@settings(max_examples=100, deadline=None)
@given(wrongs(), st.integers(1, 30))
def test_after_a_fault_only_what_is_wanted_since_it_cleared_counts(change, count):
    """The same old command, kept young by a clock that stands, never moves the robot again."""
    gate = Gate(armed=True)
    steps = play(gate, [(change, count, PERIOD, True)])
    assume(steps[-1].output.faults)
    state, now = steps[-1].after, steps[-1].now
    old = now + 0.9 * PERIOD
    for index in range(1, 120):
        body = Body(now + index * PERIOD, 0.0, 0.0, 0.0, 0.0)
        inputs = replace(good(now + index * PERIOD, body=body), command=old, acknowledged=state.stops, reset=True)
        state, output = gate.step(state, now + index * PERIOD, inputs)
        assert not moves(output)
    state, output = gate.step(state, now + 120 * PERIOD, good(now + 120 * PERIOD, acknowledged=state.stops))
    assert moves(output)


@given(st.floats(0, 0.4), st.integers(0, 40))
def test_the_command_is_zero_before_it_is_stale(early, more):
    """Whatever the phase of the steps: no step sends motion for a command older than `command_age`."""
    gate, state, now = Gate(armed=True), State(), 10.0 + early * PERIOD
    for _ in range(60):
        now += PERIOD
        state, output = gate.step(state, now, good(now))
    assert moves(output)
    last = now
    for _ in range(40 + more):
        now += PERIOD
        state, output = gate.step(state, now, good(now, command=last, acknowledged=state.stops))
        # What is sent now holds until the next step.
        assert not moves(output) or now + PERIOD - last <= LIMITS.command_age + 1e-9
    assert output.mode is Mode.STANDING


def play_looks(stamps, until):
    """The gate's steps while looks are captured at `stamps`, each heard of `arrives` seconds later: time and output."""
    gate, state, now, steps = Gate(armed=True), State(), 0.0, []
    while now < until:
        now += PERIOD
        newest = max((stamp for stamp, arrives in stamps if arrives <= now), default=None)
        body = Body(now, 0.0, 0.0, 0.8 * state.sent.forward, 0.8 * state.sent.turn)
        state, output = gate.step(state, now, good(now, belief=newest, body=body, acknowledged=state.stops))
        steps.append((now, output))
    return steps


@settings(max_examples=25, deadline=None)
@given(st.floats(0.05, 1.4), st.floats(0.05, 1.0), st.integers(8, 12), st.floats(0, 1))
def test_a_perception_that_hangs_stops_the_robot_after_three_of_its_usual_intervals(interval, share, looks, odd):
    """Looks take a share of the interval; one of them takes twice as long. Then no more come."""
    stamps, at = [], 1.0
    for index in range(looks):
        stamps.append((at, at + share * interval))
        at += interval * (2 if index == int(odd * (looks - 2)) else 1)
    (last, arrives), allowed = stamps[-1], min(LIMITS.belief_age, max(0.5, 3 * interval))
    steps = play_looks(stamps, last + 4.0)
    hangs = [now for now, output in steps if output.faults and now > arrives + PERIOD]
    assert hangs[0] - last == pytest.approx(allowed, abs=3 * PERIOD)
    assert not any(moves(output) for now, output in steps if now >= hangs[0])
    before = [now for now, output in steps if output.faults and stamps[0][1] < now < hangs[0]]
    assert not before or interval * (2 + share) > LIMITS.belief_age  # so slow that a look comes too late even so


def test_looks_that_overlap_may_be_older_than_three_intervals():
    stamps = [(0.1 * index, 0.1 * index + 1.5) for index in range(60)]
    steps = play_looks(stamps, 9.0)
    assert moves(next(output for now, output in steps if now > 7.0))
    hangs = next(now for now, output in steps if now > 7.0 and output.faults)
    assert hangs - stamps[-1][0] == pytest.approx(1.5 + 2 * 0.1, abs=2 * PERIOD)


@given(st.lists(st.tuples(st.one_of(st.none(), odd, st.floats(-5, 5)), st.one_of(odd, st.floats(0, 5))), max_size=30))
def test_no_stamps_allow_more_than_the_limit_or_less_than_half_a_second(words):
    rhythm = ()
    for stamp, now in words:
        rhythm = heard(rhythm, stamp, now)
        assert len(rhythm) <= 9
        assert all(before[0] < after[0] <= after[1] + 0.01 for before, after in pairwise(((-math.inf, 0), *rhythm)))
        assert 0.5 <= look_age(rhythm, 3.0) <= 3.0
        assert look_age(rhythm, 0.3) == 0.3
        assert 0.19 <= picture_age(rhythm, 1.0) <= 1.0


@settings(max_examples=25, deadline=None)
@given(st.floats(0.03, 0.4), st.floats(0.0, 0.3), st.floats(0, 1))
def test_a_camera_that_ends_stops_the_robot_within_two_intervals(interval, latency, moment):
    gate, state, now, begun = Gate(armed=True), State(), 0.0, None
    ends = 4.0 + moment * interval
    while begun is None:
        now += PERIOD
        newest = math.floor((min(now, ends) - latency) / interval) * interval  # what is on its way is lost
        body = Body(now, 0.0, 0.0, 0.8 * state.sent.forward, 0.8 * state.sent.turn)
        state, output = gate.step(state, now, good(now, image=newest, body=body, acknowledged=state.stops))
        if now > 3 and output.faults:
            begun = now
        else:
            assert now < 3 or moves(output)
    assert 0 < begun - ends <= max(0.2, 2 * interval) + 2 * PERIOD
    assert [fault.name for fault in output.faults] == ["image"]


def test_walking_needs_presence_turning_does_not():
    gate, state, now = Gate(armed=True), State(), 0.0
    for _ in range(60):
        now += PERIOD
        state, output = gate.step(state, now, good(now))
    assert output.send.walks
    seen = []
    for index in range(120):
        now += PERIOD
        wanted = Velocity(0.4, 0, 0.3) if index < 30 else Velocity(0, 0, 2.0)
        body = Body(now, 0.0, 0.0, 0.0, 0.8 * state.sent.turn)
        state, output = gate.step(state, now, good(now, wanted, presence=0.2, acknowledged=state.stops, body=body))
        assert not isinstance(output.send, Velocity) or not output.send.walks
        seen.append(output)
    assert isinstance(seen[0].send, Stop)
    assert [fault.name for fault in seen[0].faults] == ["presence"]
    assert seen[-1].send == Velocity(0, 0, LIMITS.blind_turn)


def test_a_robot_that_ignores_what_it_is_told_gets_little_until_it_moves():
    gate, state, now = Gate(armed=True), State(), 0.0
    for _ in range(150):
        now += PERIOD
        state, output = gate.step(state, now, good(now))  # its state says that it stands
    assert output.send == Velocity(LIMITS.creep, 0.0, LIMITS.creep_turn)
    assert "does not move" in output.reasons[0]
    now += PERIOD
    state, output = gate.step(state, now, good(now, body=Body(now, 0, 0, 0.1, 0.2)))
    assert LIMITS.creep < output.send.forward < LIMITS.creep + 0.02


def walk_a_go2(plant, wanted, seconds, told=lambda now: None):
    """The gate's steps with a Go2's body: `wanted(now)` is wanted; `told(now)` is what somebody else commands."""
    gate, state, now, steps = Gate(armed=True), State(), 0.0, []
    while now < seconds:
        now += PERIOD
        truth = plant.truth
        speed = float(np.hypot(*truth.velocity[:2]))
        body = Body.of(now, truth.pose.world_R_body, speed, truth.yaw_rate)
        state, output = gate.step(state, now, good(now, wanted(now), body=body, acknowledged=state.stops))
        if isinstance(output.send, Stop):
            plant.stop()
        elif output.send is not None:
            plant.move(*output.send.parts)
        if (other := told(now)) is not None:
            plant.move(*other)
        for _ in range(round(PERIOD / plant.settings.step)):
            plant.advance()
        steps.append((now, output))
    return steps


def strays(output):
    return any(fault.name == "follow" for fault in output.faults)


wishes = st.tuples(st.floats(-0.2, 0.5), st.floats(-0.3, 0.3), st.floats(-0.8, 0.8))


@settings(max_examples=25, deadline=None)
@given(st.lists(wishes, min_size=1, max_size=6), st.floats(0.7, 1.05), st.floats(0.1, 0.45), st.floats(0.05, 0.25))
def test_a_go2_that_does_what_it_is_told_is_never_taken_for_one_that_does_not(wanted, gain, lag, dead):
    body = PlantSettings(gain=(gain, gain, gain), lag=lag, dead_time=dead)
    steps = walk_a_go2(
        Plant(body, np.random.default_rng(0)), lambda now: Velocity(*wanted[int(now / 1.3) % 6 % len(wanted)]), 9.0
    )
    assert not any(strays(output) for _, output in steps)
    assert any(moves(output) for _, output in steps) or all(abs(value) < 0.01 for each in wanted for value in each)


@pytest.mark.parametrize("other", [(0.0, 0.0, 0.0), (0.5, 0.0, -0.6), (1.5, 0.0, 0.4), (-0.5, 0.0, -0.4)])
def test_a_robot_that_somebody_else_commands_is_stood_down_soon_and_for_a_while(other):
    """The other one speaks last, from the third second on: the body does what that one wants."""
    begun, ends = 3.0, 6.0
    steps = walk_a_go2(
        Plant(PlantSettings(), np.random.default_rng(0)), lambda now: Velocity(0.5, 0.0, 0.4), 12.0,
        lambda now: other if begun < now < ends else None,
    )  # fmt: skip
    noticed = next(now for now, output in steps if strays(output))
    assert begun + LIMITS.follow < noticed < begun + LIMITS.follow + 0.7  # the body needs a while to show it
    stood = [now for now, output in steps if now >= noticed and not moves(output)]
    assert all(not moves(output) for now, output in steps if noticed <= now < noticed + LIMITS.aside)
    assert len(stood) * PERIOD >= LIMITS.aside
    assert moves(steps[-1][1])  # and it goes on when the other one has gone


def test_a_robot_that_walks_around_obstacles_by_itself_may_do_something_else():
    gate, state, now = Gate(armed=True, obeys=False), State(), 0.0
    for _ in range(300):
        now += PERIOD
        state, output = gate.step(state, now, good(now, body=Body(now, 0.0, 0.0, 0.1, -0.6)))
    assert moves(output)


@given(st.floats(0.21, 20.0))
def test_a_gate_that_was_away_stops_first_and_needs_a_new_command(away):
    gate, state, now = Gate(armed=True), State(), 0.0
    for _ in range(60):
        now += PERIOD
        state, output = gate.step(state, now, good(now))
    assert moves(output)
    now += away
    state, output = gate.step(state, now, good(now))
    assert isinstance(output.send, Stop)
    assert "the guard itself was away" in output.reasons[0]
    for _ in range(60):
        now += PERIOD
        old = state.barrier if math.isfinite(state.barrier) else now - PERIOD
        state, output = gate.step(state, now, good(now, command=old, acknowledged=state.stops))
        assert not moves(output)


def test_a_stop_that_is_acknowledged_goes_on_while_the_robot_moves():
    gate, state, now = Gate(armed=True), State(), 0.0
    for _ in range(60):
        now += PERIOD
        state, output = gate.step(state, now, good(now))
    stops = 0
    for _ in range(100):
        now += PERIOD
        moving = Body(now, 0, 0, 0.3, 0.0)
        state, output = gate.step(state, now, good(now, deadman=False, body=moving, acknowledged=state.stops))
        stops += isinstance(output.send, Stop)
        assert output.mode is Mode.STOPPING
    assert stops == 4  # at once, and every 0.5 s
    state, output = gate.step(state, now + PERIOD, good(now + PERIOD, deadman=False, acknowledged=state.stops))
    assert output.mode is Mode.STANDING


@pytest.mark.parametrize(
    "change", [{"forward": -1}, {"period": 0.2}, {"presence": 2}, {"tilt": math.nan}, {"calm_codes": (1.5,)},
               {"creep": 0.05}, {"settle": 0}, {"turn": 9}],
)  # fmt: skip
def test_limits_check_themselves(change):
    with pytest.raises(EagorError, match=next(iter(change))):
        Limits(**change)
