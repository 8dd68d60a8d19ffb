"""The safety gate: a pure state machine between what a policy wants and what a robot is told.

It reads no clock, sends nothing and draws no random numbers: `Gate.step` takes a state, the time and what is known,
and gives the next state and what to send. So every sequence of inputs can be tried; the tests do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum

from eagor.robots.safety.limits import (
    STILL,
    CommandResponse,
    Fault,
    Inputs,
    Limits,
    Rhythm,
    Velocity,
    faults_of,
    heard,
    responded,
)

__all__ = ["ZERO", "Gate", "Mode", "Output", "State", "Stop"]

ZERO = "zero velocity is wanted"  # the remark where nothing but the wish itself keeps the robot standing


class Mode(StrEnum):
    """What the gate does now."""

    DRY_RUN = "dry run"  # nothing is ever sent
    ARMED = "armed"  # velocities are passed on, within the limits
    STOPPING = "stopping"  # StopMove again and again
    STANDING = "standing"  # the robot stands; nothing is sent
    LATCHED = "latched"  # the emergency stop was pressed: only a reset leads out


@dataclass(frozen=True)
class Stop:
    """Send StopMove. `number` counts them, so that an acknowledgement can be told from an older one."""

    number: int


@dataclass(frozen=True)
class Output:
    """What to send now (a velocity, StopMove, or nothing), the mode, why the robot must not move, and remarks.

    In a dry run `send` is None, and `would` is what would have been sent.
    """

    send: Velocity | Stop | None
    mode: Mode
    faults: tuple[Fault, ...] = ()
    remarks: tuple[str, ...] = ()
    would: Velocity | Stop | None = None

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the robot does not do what is wanted, in words."""
        return tuple(fault.words for fault in self.faults) + self.remarks


@dataclass(frozen=True)
class State:
    """What the gate remembers from step to step. Times are seconds on its clock; None: not so, or never."""

    mode: Mode = Mode.STANDING
    latched: bool = False
    time: float | None = None  # of the last step
    sent: Velocity = field(default=STILL)  # the last velocity that was sent; zero after StopMove
    clear: float | None = None  # no fault since then
    barrier: float = -math.inf  # velocities that were wanted until then do not count
    resting: float | None = None  # zero was sent since then
    stopping: int | None = None  # the number of the first StopMove of this stop
    stops: int = 0  # how many StopMove were sent
    stopped: float = -math.inf  # the last of them
    ignored: float | None = None  # it is told to move since then, and does not
    pictures: Rhythm = ()  # how often they come
    looks: Rhythm = ()
    response: CommandResponse = field(default_factory=CommandResponse)
    astray: tuple[float, str] | None = None  # when it last did something else than it was told for too long, in words


@dataclass(frozen=True)
class Gate:
    """The rules. `armed`: False is a dry run, which never commands anything.

    `obeys`: whether the robot does what it is told and nothing else. False for one that walks around obstacles by
    itself, or whose speed others limit: then it is no fault if it does not.
    """

    limits: Limits = field(default_factory=Limits)
    armed: bool = False
    obeys: bool = True

    def step(self, state: State, now: float, inputs: Inputs) -> tuple[State, Output]:
        """One step at `now` (seconds, a clock that does not go back): the next state, and what to send.

        Call it every `Limits.period`. It never raises for what `inputs` hold; what it cannot read is a fault.
        """
        if not self.armed:  # a robot that is told nothing acknowledges nothing, and does not move
            stands = inputs.body and replace(inputs.body, speed=0.0, turn=0.0)
            inputs = replace(inputs, acknowledged=state.stops, body=stands)
        pictures, looks = heard(state.pictures, inputs.image, now), heard(state.looks, inputs.belief, now)
        faults = faults_of(self.limits, now, inputs, state.sent, pictures=pictures, looks=looks)
        state = replace(state, pictures=pictures, looks=looks)
        if math.isfinite(now) and state.time is not None and now < state.time:
            faults += (Fault("clock", f"the clock went back by {state.time - now:.2f} s"),)
        latched = inputs.emergency or (state.latched and not inputs.reset)
        pressed = latched and not state.latched
        if self.armed and self.obeys and math.isfinite(now):
            state = self._followed(state, now, inputs)
            if state.astray is not None and now - state.astray[0] < self.limits.aside:
                faults += (Fault("follow", state.astray[1]),)
        if math.isfinite(now) and state.time is not None and now - state.time > self.limits.silence:
            faults += (Fault("guard", f"the guard itself was away for {now - state.time:.2f} s"),)
        if latched:
            faults += (Fault("emergency", "the emergency stop was pressed; it stands until somebody releases that"),)
        blocked = bool(faults)
        time = now if math.isfinite(now) else state.time
        if blocked or time is None:
            state = replace(state, clear=None)
        elif state.clear is None:
            # From here on nothing is wrong. Only what is wanted from now on counts.
            state = replace(state, clear=time, barrier=time)
        state, send, remarks = self._act(replace(state, latched=latched), time, inputs, blocked, pressed)
        mode = state.mode if not (latched and state.mode is Mode.STANDING) else Mode.LATCHED
        state = replace(state, time=time)
        if not self.armed:
            return state, Output(None, Mode.LATCHED if latched else Mode.DRY_RUN, faults, remarks, would=send)
        return state, Output(send, mode, faults, remarks, would=send)

    def _act(
        self, state: State, time: float | None, inputs: Inputs, blocked: bool, pressed: bool
    ) -> tuple[State, Velocity | Stop | None, tuple[str, ...]]:
        """The next state, what to send, and remarks."""
        if time is None:
            return state, None, ()
        if state.mode is Mode.STOPPING or pressed or (state.mode is Mode.ARMED and blocked):
            return self._stop(state, time, inputs)
        if blocked:
            return state, None, ()
        wanted, remark = self._wanted(state, time, inputs)
        if state.mode is Mode.ARMED:
            return self._move(state, time, inputs, wanted, remark)
        if state.clear is None or time - state.clear < self.limits.settle:
            return state, None, (f"nothing may be wrong for {self.limits.settle:g} s before it moves",)
        if wanted.still:
            return state, None, (remark,)
        state = replace(state, mode=Mode.ARMED, sent=STILL, resting=None, ignored=None, response=CommandResponse())
        return self._move(state, time, inputs, wanted, remark)

    def _stop(self, state: State, time: float, inputs: Inputs) -> tuple[State, Stop | None, tuple[str, ...]]:
        """StopMove until one is acknowledged and the robot's own state says that it stands."""
        if state.mode is not Mode.STOPPING or state.stopping is None:
            state = replace(state, mode=Mode.STOPPING, sent=STILL, stopping=state.stops + 1, resting=None, ignored=None)
            return self._stop_again(state, time)
        heard = inputs.acknowledged is not None and inputs.acknowledged >= state.stopping
        stands = self._moves(time, inputs) is False
        if heard and stands:
            return replace(state, mode=Mode.STANDING, stopping=None), None, ()
        remarks = () if heard else ("StopMove is not acknowledged yet",)
        remarks += () if stands else ("the robot's state does not say that it stands",)
        pause = self.limits.again if heard else self.limits.retry
        if not 0 <= time - state.stopped < pause:
            state, send, _ = self._stop_again(state, time)
            return state, send, remarks
        return state, None, remarks

    def _stop_again(self, state: State, time: float) -> tuple[State, Stop, tuple[str, ...]]:
        number = state.stops + 1
        return replace(state, stops=number, stopped=time), Stop(number), ()

    def _moves(self, time: float, inputs: Inputs) -> bool | None:
        """Whether the robot moves, by its own state; None if that is not known."""
        body, limits = inputs.body, self.limits
        if body is None or not abs(time - body.stamp) <= limits.state_age:
            return None
        if not (math.isfinite(body.speed) and math.isfinite(body.turn)):
            return None
        return abs(body.speed) >= limits.still_speed or abs(body.turn) >= limits.still_turn

    def _wanted(self, state: State, time: float, inputs: Inputs) -> tuple[Velocity, str]:
        """The wanted velocity within the limits of speed; zero, with a remark, if there is none or it is old."""
        limits, wanted, stamp = self.limits, inputs.wanted, inputs.command
        if wanted is None or stamp is None:
            return STILL, "no velocity is wanted yet"
        if stamp <= state.barrier:
            return STILL, "no velocity is wanted since the last fault"
        if time + 2 * limits.period - stamp > limits.command_age:  # it would be stale before the next step has acted
            return STILL, f"the wanted velocity is {time - stamp:.2f} s old"
        turn = limits.turn if inputs.presence is not None and inputs.presence >= limits.presence else limits.blind_turn
        found = Velocity(
            _within(wanted.forward, -limits.backward, limits.forward),
            _within(wanted.left, -limits.sideways, limits.sideways),
            _within(wanted.turn, -turn, turn),
        )
        return found, ZERO if found.still else ""

    def _move(
        self, state: State, time: float, inputs: Inputs, wanted: Velocity, remark: str
    ) -> tuple[State, Velocity | Stop | None, tuple[str, ...]]:
        """Pass on what is wanted, as far as the acceleration allows; after a while of zero, StopMove."""
        limits = self.limits
        remarks = (remark,) if remark else ()
        if wanted.still:
            since = time if state.resting is None else state.resting
            if time - since >= limits.rest:
                state, send, more = self._stop(state, time, inputs)
                return state, send, remarks + more
            return replace(state, sent=STILL, resting=since, ignored=None), STILL, remarks
        gone = 0.0 if state.time is None else time - state.time
        before = state.sent if gone <= limits.command_age else STILL  # it was away for long: begin anew
        room = min(max(gone, 0.0), 2 * limits.period)
        ignored = self._ignored(state, time, inputs)
        if ignored is not None and time - ignored >= limits.follow:
            wanted = Velocity(
                _within(wanted.forward, -limits.creep, limits.creep),
                _within(wanted.left, -limits.creep, limits.creep),
                _within(wanted.turn, -limits.creep_turn, limits.creep_turn),
            )
            remarks += (f"the robot does not move although it has been told to for {time - ignored:.1f} s",)
        sent = Velocity(
            _ramp(before.forward, wanted.forward, room * limits.acceleration),
            _ramp(before.left, wanted.left, room * limits.acceleration),
            _ramp(before.turn, wanted.turn, room * limits.turn_acceleration),
        )
        return replace(state, sent=sent, resting=None, ignored=ignored), sent, remarks

    def _followed(self, state: State, time: float, inputs: Inputs) -> State:
        """Whether the robot does what it was told; what it does while it is not told to move is its own affair."""
        body, sent = inputs.body, state.sent
        if state.mode is not Mode.ARMED or state.time is None or body is None or self._moves(time, inputs) is None:
            return replace(state, response=replace(state.response, since=None))
        ignored = self._ignored(state, time, inputs) is not None
        response = responded(self.limits, state.response, time, time - state.time, sent, body, ignored=ignored)
        state = replace(state, response=response)
        if response.since is None or time - response.since < self.limits.follow:
            return state
        words = (
            f"the robot does not do what it is told ({math.hypot(sent.forward, sent.left):.2f} m/s, {sent.turn:.2f} "
            f"rad/s), but {body.speed:.2f} m/s, {body.turn:.2f} rad/s: somebody else commands it, or holds it"
        )
        return replace(state, astray=(time, words))

    def _ignored(self, state: State, time: float, inputs: Inputs) -> float | None:
        """Since when the robot stands although it is told to move fast enough to see it."""
        limits, sent = self.limits, state.sent
        if not self.armed:
            return None
        walks = math.hypot(sent.forward, sent.left) > 2 * limits.still_speed
        told = walks or abs(sent.turn) > 2 * limits.still_turn
        if not told or self._moves(time, inputs) is not False:
            return None
        return time if state.ignored is None else state.ignored


def _within(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def _ramp(before: float, wanted: float, room: float) -> float:
    """`wanted`, or as near to it as `room` allows. Towards zero there is no limit; it stops before it turns round."""
    if before * wanted < 0:
        return 0.0
    return math.copysign(min(abs(wanted), abs(before) + room), wanted)
