"""No sequence of inputs leads to motion while a fault holds; limits, latch and dry run hold in every sequence."""

import math
from collections import namedtuple
from dataclasses import replace

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from eagor.errors import EagorError
from eagor.robots.safety import Gate, Inputs, Limits, Mode, RobotState, State, Velocity
from eagor.robots.safety.gate import BLIND_TURN, PERIOD, RESUME, Stop
from eagor.robots.safety.limits import STILL, faults_of

LIMITS = Limits()
WANTED = Velocity(0.4, 0.0, 0.3)
odd = st.sampled_from([math.nan, math.inf, -math.inf, -1e9, 1e9])
speeds = st.one_of(st.floats(-2, 2), odd)


def good(now, wanted=WANTED, **changes):
    """Inputs at which nothing is wrong."""
    known = Inputs(wanted, now, now, now, now, 0.9, robot=RobotState(now, 0.02, -0.03), deadman=True)
    return replace(known, **changes)


@st.composite
def wrongs(draw):
    """Changes of good inputs: a function of the time that gives the fields to replace. Many steps change nothing."""
    late, name = draw(st.one_of(st.none(), odd, st.floats(-0.2, 5.0))), draw(st.sampled_from(["image", "pose", "look"]))
    value, wanted, number = draw(speeds), Velocity(*draw(st.tuples(speeds, speeds, speeds))), draw(st.integers(0, 50))
    kind = draw(st.integers(-5, 14))

    def change(now, robot):
        stamp = None if late is None else now - late
        return {} if kind < 0 else [
            {name: stamp}, {"command": stamp}, {"wanted": wanted}, {"presence": abs(value) / 2},
            {"stated": ("it smells",)}, {"robot": replace(robot, roll=value)}, {"robot": replace(robot, error_code=7)},
            {"robot": replace(robot, stamp=now - 1.0 if stamp is None else stamp)}, {"deadman": False},
            {"emergency": True}, {"reset": True}, {"robot": replace(robot, speed=value, turn=value)}, {"robot": None},
            {"wanted": Velocity(turn=0.3 * (number % 2))}, {"acknowledged": number},
        ][kind]  # fmt: skip

    return change


Step = namedtuple("Step", "now inputs before after output")  # one step of a sequence as it was played
clocks = st.one_of(st.just(PERIOD), st.just(PERIOD), st.sampled_from([0.0, 0.3, 1.0, -0.5, -1e6, 1e6, math.nan]))
spells = st.lists(st.tuples(wrongs(), st.integers(1, 60), clocks, st.booleans()), min_size=1, max_size=12)
many = settings(max_examples=150, deadline=None)


def play(gate, spells, warm=40):
    """Spells of steps: in each the same thing is wrong for some steps, and the clock jumps once at its start."""
    now, state, steps, told, heard = 100.0, State(), [], Velocity(), 0
    plan = [(lambda now, robot: {}, warm, PERIOD, True), *spells]
    for change, count, jump, acknowledges in plan:
        for index in range(count):
            pace = jump if index == 0 else PERIOD
            time = now + pace
            now = time if math.isfinite(time) else now
            robot = RobotState(now, 0.0, 0.0, 0.8 * abs(told.forward), 0.8 * told.turn)
            inputs = replace(good(now, robot=robot), acknowledged=heard)
            inputs = replace(inputs, **change(now, robot))
            before = state
            state, output = gate.step(state, time, inputs)
            steps.append(Step(time, inputs, before, state, output))
            if isinstance(output.send, Stop):
                told, heard = Velocity(), output.send.number if acknowledges else heard
            elif output.send is not None:
                told = output.send
    return steps


def moves(output):
    return isinstance(output.send, Velocity) and output.send != STILL


def armed():
    """A gate that has let the robot move for a while, as a function: a step, with good inputs but for changes."""
    gate, state, now = Gate(armed=True), State(), 0.0

    def step(seconds=PERIOD, wanted=WANTED, **changes):
        nonlocal state, now
        now += seconds
        changes = {name: change(now) if callable(change) else change for name, change in changes.items()}
        state, output = gate.step(state, now, good(now, wanted, **{"acknowledged": state.stops} | changes))
        return now, state, output

    for _ in range(60):
        _, _, output = step()
    assert moves(output)
    return step


def test_that_it_moves_when_nothing_is_wrong_and_not_before_it_has_settled():
    steps = play(Gate(armed=True), [], warm=200)
    first = next(step for step in steps if moves(step.output))
    assert RESUME <= first.now - steps[0].now <= RESUME + 2 * PERIOD
    assert steps[-1].output.send == WANTED
    assert (steps[-1].output.mode, steps[-1].output.reasons) == (Mode.ARMED, ())


@many
@given(spells)
def test_a_fault_stops_a_moving_robot_at_once_and_nothing_moves_while_it_holds_or_is_not_acknowledged(spells):
    waiting = None  # the number of the first StopMove that must be acknowledged
    for step in play(Gate(armed=True), spells):
        send = step.output.send
        if any(faults_of(LIMITS, step.now, step.inputs, step.before.sent)) or step.inputs.emergency:
            assert not isinstance(send, Velocity)
            assert step.output.mode is not Mode.ARMED
            assert step.output.faults
        assert not isinstance(send, Velocity) or all(map(math.isfinite, send))
        if step.before.mode is Mode.ARMED and step.output.faults:
            assert isinstance(send, Stop)
        if waiting is not None and not isinstance(send, Stop):
            heard = step.inputs.acknowledged >= waiting
            assert not isinstance(send, Velocity) or step.after.mode is Mode.STOPPING or heard
            if step.after.mode is Mode.STANDING:
                assert heard
                waiting = None
        if step.before.mode is not Mode.STOPPING and step.after.mode is Mode.STOPPING:
            waiting = send.number


@many
@given(spells)
def test_speed_and_acceleration_stay_within_the_limits(spells):
    last, when = Velocity(), None
    for step in play(Gate(armed=True), spells):
        sent = step.output.send
        if not isinstance(sent, Velocity):
            last = Velocity() if isinstance(sent, Stop) else last
            when = step.now if math.isfinite(step.now) else when
            continue
        assert -LIMITS.aside <= sent.forward <= LIMITS.forward
        assert abs(sent.left) <= LIMITS.aside
        assert abs(sent.turn) <= LIMITS.turn
        gone = max(step.now - when, 0.0) if when is not None else 0.0
        rates = (LIMITS.acceleration, LIMITS.acceleration, LIMITS.turn_acceleration)
        for before, after, rate in zip(last, sent, rates, strict=True):
            speeding = abs(after) - abs(before) if before * after >= 0 else abs(after)
            assert speeding <= rate * min(gone, 2 * PERIOD) + 1e-9
        last, when = sent, step.now


@many
@given(spells, spells)
def test_the_emergency_stop_stays_until_somebody_releases_it(first, second):
    gate = Gate(armed=True)
    pressed = (lambda now, robot: {"emergency": True}, 1, PERIOD, True)
    steps = play(gate, [*first, pressed, *second])
    at = 40 + sum(spell[1] for spell in first)
    assert isinstance(steps[at].output.send, Stop) or steps[at].before.latched or steps[at].before.mode is Mode.STOPPING
    for step in steps[at:]:
        if step.inputs.reset and not step.inputs.emergency:
            break
        assert not isinstance(step.output.send, Velocity)
        assert step.output.mode in (Mode.STOPPING, Mode.LATCHED)


@many
@given(spells)
def test_a_dry_run_sends_nothing_but_says_what_it_would(spells):
    steps = play(Gate(armed=False), spells)
    assert all(step.output.send is None for step in steps)
    assert {step.output.mode for step in steps} <= {Mode.DRY_RUN, Mode.LATCHED}
    assert any(isinstance(step.output.would, Velocity) and any(step.output.would) for step in steps)


@many
@given(wrongs(), st.integers(1, 30))
def test_after_a_fault_only_what_is_wanted_since_it_cleared_counts(change, count):
    """The same old command, kept young by a clock that stands, never moves the robot again."""
    gate = Gate(armed=True)
    steps = play(gate, [(change, count, PERIOD, True)])
    assume(steps[-1].output.faults)
    state, now = steps[-1].after, steps[-1].now
    old = now + 0.9 * PERIOD
    for index in range(1, 120):
        inputs = good(now + index * PERIOD, command=old, acknowledged=state.stops, reset=True)
        state, output = gate.step(state, now + index * PERIOD, inputs)
        assert not moves(output)
    state, output = gate.step(state, now + 120 * PERIOD, good(now + 120 * PERIOD, acknowledged=state.stops))
    assert moves(output)


@given(st.floats(0, 0.4), st.integers(0, 40))
def test_the_command_is_zero_before_it_is_stale(early, more):
    """Whatever the phase of the steps: no step sends motion for a command older than `command_age`."""
    step = armed()
    last, _, _ = step()
    step(early * PERIOD, command=last)
    for _ in range(40 + more):
        now, _, output = step(command=last)
        # What is sent now holds until the next step.
        assert not moves(output) or now + PERIOD - last <= LIMITS.command_age + 1e-9
    assert output.mode is Mode.STANDING


def test_walking_needs_presence_turning_does_not():
    step, seen = armed(), []
    for index in range(120):
        _, _, output = step(wanted=WANTED if index < 30 else Velocity(0, 0, 2.0), presence=0.2)
        assert not isinstance(output.send, Velocity) or not output.send.walks
        seen.append(output)
    assert isinstance(seen[0].send, Stop)
    assert seen[0].faults == ("the presence is 0.20; walking needs 0.5",)
    assert seen[-1].send == Velocity(0, 0, BLIND_TURN)


@pytest.mark.parametrize(("name", "most", "what"), [
    ("image", 0.5, "picture"), ("look", 2.0, "look of the perception"), ("pose", 0.25, "pose"), ("robot", 0.1, "state"),
])  # fmt: skip
def test_what_is_older_than_its_limit_stops_the_robot_and_no_limit_can_be_loosened(name, most, what):
    for age, stops in ((most - 0.001, False), (most + 0.001, True)):

        def old(now):
            return RobotState(now - age, 0.0, 0.0, 0.3, 0.2) if name == "robot" else now - age  # noqa: B023

        _, _, output = armed()(**{name: old})
        assert isinstance(output.send, Stop) == stops
        assert not stops or f"the newest {what}" in output.faults[0]
    with pytest.raises(EagorError, match=f"at most {most}"):
        Limits(**{f"{'state' if name == 'robot' else name}_age": most + 0.01})


def test_a_short_pause_of_commands_costs_no_stop_and_a_long_one_does():
    step = armed()
    last, _, _ = step()
    steps = [step(command=last) for _ in range(60)]
    sent = [output.send for _, _, output in steps]
    begun = sent.index(STILL)
    assert steps[begun][0] - last < LIMITS.command_age
    assert sent.index(Stop(1)) - begun == pytest.approx(0.5 / PERIOD, abs=1)
    assert steps[-1][2].mode is Mode.STANDING


@given(st.floats(0.21, 20.0))
def test_a_gate_that_was_away_stops_first_and_needs_a_new_command(away):
    step = armed()
    now, state, output = step(away)
    assert isinstance(output.send, Stop)
    assert "the guard itself was away" in output.faults[0]
    for _ in range(60):
        now, state, output = step(command=now if state.clear is None else state.clear)
        assert not moves(output)


def test_a_stop_that_is_acknowledged_goes_on_while_the_robot_moves():
    step = armed()
    outputs = [step(deadman=False, robot=lambda now: RobotState(now, speed=0.3))[2] for _ in range(100)]
    assert all(output.mode is Mode.STOPPING for output in outputs)
    assert sum(isinstance(output.send, Stop) for output in outputs) == 4  # at once, and every 0.5 s
    assert step(deadman=False)[2].mode is Mode.STANDING


def test_error_codes_that_are_none_can_be_named_and_limits_check_themselves():
    inputs = good(1.0, robot=RobotState(1.0, error_code=7))
    assert list(faults_of(LIMITS, 1.0, inputs)) == ["the robot reports error code 7"]
    assert not list(faults_of(LIMITS, 1.0, inputs, ignored_codes=(0, 7)))
    for name, value in (("forward", -1), ("presence", 2), ("tilt", math.nan), ("turn", 9)):
        with pytest.raises(EagorError, match=name):
            Limits(**{name: value})
