"""The safety gate: a pure state machine between what a policy wants and what a robot is told.

It reads no clock, sends nothing and draws no random numbers: `Gate.step` takes a state, the time and what is known,
and gives the next state and what to send. So every sequence of inputs can be tried; the tests do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import NamedTuple

from eagor.robots.safety.limits import STILL, Inputs, Limits, Velocity, faults_of

__all__ = ["PERIOD", "SILENCE", "Gate", "GateStatus", "Mode", "State", "Stop"]

PERIOD = 0.02  # seconds between two steps
SILENCE = 0.2  # seconds between two steps after which the gate was away for too long: it stops, and begins anew
RETRY, AGAIN = 0.04, 0.5  # seconds between two StopMove until one is acknowledged; then, while the robot still moves
RESUME = 0.5  # seconds without any fault before the robot moves again
REST = 0.5  # seconds of zero velocity after which StopMove is sent
STANDS = 0.05, 0.05  # m/s and rad/s below which the robot stands: a trotting body sways, so not 0
BLIND_TURN = 0.5  # rad/s while the presence is too low


class Mode(str, Enum):
    """What the gate does now."""

    DRY_RUN = "dry run"  # nothing is ever sent
    ARMED = "armed"  # velocities are passed on, within the limits
    STOPPING = "stopping"  # StopMove again and again
    STANDING = "standing"  # the robot stands; nothing is sent
    LATCHED = "latched"  # the emergency stop was pressed: only a reset leads out

    __str__ = str.__str__


class Stop(NamedTuple):
    """Send StopMove. `number` counts them, so that an acknowledgement can be told from an older one."""

    number: int


@dataclass(frozen=True)
class GateStatus:
    """What one step comes to.

    `send`: what to send now, in a dry run nothing; `would`: what would be sent. `faults`: why the robot must not move,
    in words; `remarks`: why it does not, though it might. `stops`: how many StopMove were sent so far.
    """

    send: Velocity | Stop | None
    mode: Mode
    faults: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    would: Velocity | Stop | None = None
    stops: int = 0

    @property
    def reasons(self) -> tuple[str, ...]:
        return self.faults + self.remarks


@dataclass(frozen=True)
class State:
    """What the gate remembers from step to step. Times are seconds on its clock; None: not so, or never."""

    mode: Mode = Mode.STANDING
    latched: bool = False
    time: float | None = None  # of the last step
    sent: Velocity = STILL  # the last velocity that was sent; zero after StopMove
    clear: float | None = None  # no fault since then; velocities that were wanted until then do not count
    stops: int = 0  # how many StopMove were sent
    stopping: int | None = None  # the number of the first StopMove of this stop
    stopped: float = -math.inf  # when the last of them was sent
    resting: float | None = None  # it is told zero since then


@dataclass(frozen=True)
class Gate:
    """The rules. `armed`: False is a dry run, which never commands anything. `ignored_codes`: as for `faults_of`."""

    limits: Limits = field(default_factory=Limits)
    armed: bool = False
    ignored_codes: tuple[int, ...] = (0,)

    def step(self, state: State, now: float, inputs: Inputs) -> tuple[State, GateStatus]:
        """One step at `now` (seconds, a clock that does not go back): the next state, and what to send.

        Call it every `PERIOD`. It never raises for what `inputs` hold; what it cannot read is a fault.
        """
        if not self.armed:  # a robot that is told nothing acknowledges nothing, and does not move
            stands = inputs.robot and replace(inputs.robot, speed=0.0, turn=0.0)
            inputs = replace(inputs, acknowledged=state.stops, robot=stands)
        faults = tuple(faults_of(self.limits, now, inputs, state.sent, self.ignored_codes))
        time = now if math.isfinite(now) else state.time
        gone = 0.0 if time is None or state.time is None else time - state.time
        if not 0 <= gone <= SILENCE:
            faults += (f"the guard itself was away for {gone:.2f} s",)
        latched = inputs.emergency or (state.latched and not inputs.reset)
        if latched:
            faults += ("the emergency stop was pressed; it stands until somebody releases that",)
        pressed = latched and not state.latched
        clear = None if faults else time if state.clear is None else state.clear
        state = replace(state, latched=latched, clear=clear, time=time)
        send, remarks = None, ()
        if time is not None:
            if state.mode is Mode.STOPPING or pressed or (state.mode is Mode.ARMED and faults):
                state, send, remarks = self._stop(state, time, inputs)
            elif not faults:
                state, send, remarks = self._move(state, time, min(gone, 2 * PERIOD), inputs)
        mode = Mode.LATCHED if latched and (state.mode is Mode.STANDING or not self.armed) else state.mode
        if not self.armed and not latched:
            mode = Mode.DRY_RUN
        sent, stops = (send, state.stops) if self.armed else (None, 0)
        return state, GateStatus(sent, mode, faults, remarks, send, stops)

    def _stop(self, state: State, time: float, inputs: Inputs) -> tuple[State, Stop | None, tuple[str, ...]]:
        """StopMove until one is acknowledged and the robot's own state says that it stands."""
        if state.mode is not Mode.STOPPING or state.stopping is None:
            state = replace(state, mode=Mode.STOPPING, sent=STILL, stopping=state.stops + 1, stopped=-math.inf)
        heard = inputs.acknowledged >= (state.stopping or 0)
        robot = inputs.robot
        stands = (
            robot is not None
            and abs(time - robot.stamp) <= self.limits.state_age
            and abs(robot.speed) < STANDS[0]
            and abs(robot.turn) < STANDS[1]
        )
        if heard and stands:
            return replace(state, mode=Mode.STANDING, stopping=None), None, ()
        remarks = () if heard else ("StopMove is not acknowledged yet",)
        remarks += () if stands else ("the robot's state does not say that it stands",)
        if 0 <= time - state.stopped < (AGAIN if heard else RETRY):
            return state, None, remarks
        number = state.stops + 1
        return replace(state, stops=number, stopped=time), Stop(number), remarks

    def _move(
        self, state: State, time: float, gone: float, inputs: Inputs
    ) -> tuple[State, Velocity | Stop | None, tuple[str, ...]]:
        """Pass on what is wanted, as far as the acceleration allows. `gone`: seconds since the last step."""
        wanted, remark = self._wanted(state, time, inputs)
        remarks = (remark,) if remark else ()
        if wanted == STILL and state.mode is not Mode.ARMED:
            return state, None, remarks
        if wanted == STILL:
            since = time if state.resting is None else state.resting
            state = replace(state, sent=STILL, resting=since)
            return (state, STILL, remarks) if time - since < REST else self._stop(state, time, inputs)
        if state.mode is not Mode.ARMED and time - (state.clear or 0.0) < RESUME:
            return state, None, (f"nothing may be wrong for {RESUME:g} s before it moves",)
        rates = self.limits.acceleration, self.limits.acceleration, self.limits.turn_acceleration
        three = zip(state.sent, wanted, rates, strict=True)
        sent = Velocity(*(_ramp(before, after, gone * rate) for before, after, rate in three))
        return replace(state, mode=Mode.ARMED, sent=sent, resting=None), sent, remarks

    def _wanted(self, state: State, time: float, inputs: Inputs) -> tuple[Velocity, str]:
        """The wanted velocity within the limits of speed; zero, with a remark, if there is none or it is old."""
        limits, wanted, stamp = self.limits, inputs.wanted, inputs.command
        if wanted is None or stamp is None:
            return STILL, "no velocity is wanted yet"
        if state.clear is None or stamp <= state.clear:
            return STILL, "no velocity is wanted since the last fault"
        if time + 2 * PERIOD - stamp > limits.command_age:  # it would be stale before the next step has acted
            return STILL, f"the wanted velocity is {time - stamp:.2f} s old"
        turn = limits.turn if (inputs.presence or 0.0) >= limits.presence else BLIND_TURN
        highest = limits.forward, limits.aside, turn
        three = zip(wanted, (-limits.aside, -limits.aside, -turn), highest, strict=True)
        return Velocity(*(min(max(each, low), high) for each, low, high in three)), ""


def _ramp(before: float, wanted: float, room: float) -> float:
    """`wanted`, or as near to it as `room` allows. Towards zero there is no limit; it stops before it turns round."""
    if before * wanted < 0:
        return 0.0
    return math.copysign(min(abs(wanted), abs(before) + room), wanted)
