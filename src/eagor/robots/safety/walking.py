"""From an answer to a wanted velocity: turn towards it, walk to it, stop before it. The gate stands behind it.

`walk` is pure. The robot turns in place until the answer is ahead, and walks only while it stays there. It slows down
as the distance shrinks, and stops at the wanted one. Where the distance is not known, it walks slowly, and only so
far. While nothing is known it turns to search; while the answer is ambiguous or old it stands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

from eagor._checks import above, require, within
from eagor.live.events import Answer, Event, PoseReceived
from eagor.robots.safety.gate import GateStatus, Mode
from eagor.robots.safety.guard import Guard
from eagor.robots.safety.limits import STILL, Velocity
from eagor.sphere import heading
from eagor.tracking.estimate import Status

__all__ = ["Behaviour", "Command", "ControllerState", "Odometer", "Step", "TargetView", "WalkSettings", "steer", "walk"]

Behaviour = Literal["searching", "turning", "walking", "arrived", "holding"]

CONE, AHEAD = math.radians(20), math.radians(10)  # of azimuth: within it walks; within it begins to
STEEP = math.radians(70)  # of elevation: beyond, an azimuth says little about where to go
# A Go2 follows a command after 0.45 s; gains of 1 per second and less do not overshoot by much.
TURN, TURN_GAIN = 0.6, 0.9  # rad/s at most; rad/s per radian of azimuth
SPEED_GAIN, SLOWEST = 0.6, 0.12  # m/s per metre that is left; m/s on the last stretch
AGAIN = 0.3  # metres beyond its distance from which it follows a thing that goes away
SPREAD = 0.35  # standard deviation of the logarithm of the distance up to which that counts as known
NEAREST = 0.4  # metres; it stops where the thing may be as near as this (one standard deviation)
BLIND_SPEED = 0.2  # m/s without knowing the distance
SEARCH_TURN, SEARCH_TURNS = 0.4, 2.0  # rad/s; whole turns before it gives up until something is seen
STUCK, PROGRESS = 4.0, 0.1  # seconds of walking without getting on before it stands; metres that count as getting on
UNHEARD = 1.0  # seconds between two views after which the way in between is not counted
PARTS = ("camera", "perception")  # of the loop, whose faults stop the robot; ages tell of poses and clocks
RANGED = 0.5  # seconds for which a distance holds: reading one takes as long as an answer


@dataclass(frozen=True)
class WalkSettings:
    """How to walk.

    `distance`: metres over the ground from the camera to the thing, at which it stops; `speed`: m/s at most; `blind`:
    metres that it walks without knowing the distance.
    """

    distance: float = 1.0
    speed: float = 0.4
    blind: float = 3.0

    def __post_init__(self) -> None:
        fields = {name: (above(getattr(self, name), 0, 1000), "a number above 0") for name in ("distance", "speed")}
        require(self, fields | {"blind": (within(self.blind, 0, 1000), "metres, from 0 on")})


@dataclass(frozen=True)
class TargetView:
    """What is known at one time: of the answer, and of the robot's own way (odometry).

    `stamp`: seconds; `azimuth` (None while nothing is known), `elevation`: radians, body frame; `distance`: metres to
    the thing, with `spread`, the standard deviation of its logarithm. `xy`: metres; `yaw`: radians; None: not known.
    """

    stamp: float
    status: Status
    azimuth: float | None = None
    elevation: float = 0.0
    distance: float | None = None
    spread: float | None = None
    xy: tuple[float, float] | None = None
    yaw: float | None = None

    @property
    def known(self) -> float | None:
        """Metres to the thing over the ground, if that is known well enough."""
        if self.distance is None or self.spread is None or self.spread > SPREAD:
            return None
        return self.distance * math.cos(self.elevation)


@dataclass(frozen=True)
class ControllerState:
    """What the policy remembers between two views."""

    doing: Behaviour = "holding"
    last: TargetView | None = None
    side: float = 1.0  # to search: 1 left, -1 right; where the thing was last
    turned: float = 0.0  # radians, while searching
    blind: float = 0.0  # metres walked since the distance was known
    mark: tuple[float, float] | None = None  # where it last got on
    stuck: float = 0.0  # seconds of walking since then
    blocked: bool = False


class Command(NamedTuple):
    """The wanted velocity, what the robot is doing, and why, in words."""

    velocity: Velocity
    doing: Behaviour
    words: str


def walk(
    settings: WalkSettings, state: ControllerState, view: TargetView, held: bool = False
) -> tuple[ControllerState, Command]:
    """The next state and the wanted velocity, from what is known now. Call it for every answer.

    `held`: the gate does not let it move. That time does not count: nothing is known then of what is in its way.
    """
    state, command = _wanted(settings, _moved(state, view, held), view)
    return replace(state, doing=command.doing, last=view), command


def _moved(state: ControllerState, view: TargetView, held: bool) -> ControllerState:
    """Count the way, the turn, and the time without getting on, since the last view."""
    last, searching, walks = state.last, view.status == "searching", state.doing == "walking"
    if not searching:
        side = math.copysign(1.0, view.azimuth) if view.azimuth else state.side
        state = replace(state, turned=0.0, side=side)
    if last is None or not 0 <= view.stamp - last.stamp <= UNHEARD:
        return replace(state, stuck=0.0, mark=view.xy)
    gone, stuck, mark, seconds = 0.0, state.stuck if walks else 0.0, state.mark or view.xy, view.stamp - last.stamp
    if view.xy is not None and mark is not None:
        # A camera on a walking robot sways: only what adds up is a way.
        if (away := math.dist(view.xy, mark)) >= PROGRESS:
            gone, stuck, mark = away, 0.0, view.xy
        elif walks and not held:
            stuck += seconds
    elif walks:  # without odometry: as if it had gone as fast as it was told
        gone = BLIND_SPEED * seconds
    blind = state.blind + gone if view.known is None else 0.0
    state = replace(state, blind=blind, mark=mark, stuck=stuck, blocked=state.blocked or stuck > STUCK)
    if searching and state.doing == "searching" and view.yaw is not None and last.yaw is not None:
        state = replace(state, turned=state.turned + abs(math.remainder(view.yaw - last.yaw, 2 * math.pi)))
    return state


def _wanted(settings: WalkSettings, state: ControllerState, view: TargetView) -> tuple[ControllerState, Command]:
    if view.status == "searching" or view.azimuth is None:
        if state.turned >= 2 * math.pi * SEARCH_TURNS:
            return state, Command(STILL, "holding", f"nothing was found in {SEARCH_TURNS:g} turns: it stands and looks")
        side = "left" if state.side > 0 else "right"
        return state, Command(Velocity(turn=state.side * SEARCH_TURN), "searching", f"it searches, turning {side}")
    if view.status != "tracking":
        why = "several places are likely" if view.status == "ambiguous" else "the answer is old"
        return state, Command(STILL, "holding", f"{why}: it stands")
    if abs(view.elevation) > STEEP:
        where = "above" if view.elevation > 0 else "below"
        return state, Command(STILL, "arrived", f"the thing is right {where} the camera")
    turn, away = min(max(TURN_GAIN * view.azimuth, -TURN), TURN), abs(view.azimuth)
    if away > (CONE if state.doing == "walking" else AHEAD):
        # What was in the way may not be on the new heading.
        state = replace(state, blocked=state.blocked and away <= CONE)
        words = f"it turns {'left' if turn > 0 else 'right'}: the answer is {math.degrees(away):.0f}° off"
        return state, Command(Velocity(turn=turn), "turning", words)
    speed, words = _speed(settings, state, view)
    if speed == 0:
        return state, Command(Velocity(turn=turn), "holding" if view.known is None else "arrived", words)
    if state.blocked:
        return state, Command(STILL, "holding", "it does not get on: something is in the way")
    return state, Command(Velocity(speed * math.cos(view.azimuth), 0.0, turn), "walking", words)


def _speed(settings: WalkSettings, state: ControllerState, view: TargetView) -> tuple[float, str]:
    """How fast to walk straight on, 0 to stop; and why."""
    ground, spread = view.known, view.spread
    if ground is None or spread is None:
        if (more := settings.blind - state.blind) <= 0:
            return 0.0, f"the distance is still not known after {settings.blind:g} m: it stands"
        return BLIND_SPEED, f"it walks slowly: the distance is not known ({more:.1f} m left)"
    least = ground * math.exp(-spread)
    told = f"{ground:.1f} m (68 %: {least:.1f} to {ground * math.exp(spread):.1f} m)"
    if least <= NEAREST:
        return 0.0, f"the thing may be as near as {least:.1f} m: it stands"
    if ground - settings.distance <= (AGAIN if state.doing == "arrived" else 0.0):
        return 0.0, f"it is there: {told}"
    # The cautious distance sets the speed, the likely one where to stop.
    return max(min(settings.speed, SPEED_GAIN * (least - settings.distance)), SLOWEST), f"it walks: {told}"


class Odometer:
    """A sink of the loop (`eagor.live.loop.Sink`): the newest place, `xy`.

    It tells the guard of poses as they come, which is more often than answers are given. `now`: the loop's clock.
    """

    def __init__(self, guard: Guard, now: Callable[[], float]) -> None:
        self.xy: tuple[float, float] | None = None
        self._guard, self._now = guard, now

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        if isinstance(event, PoseReceived):
            place = event.pose.position
            self.xy = None if place is None else (float(place[0]), float(place[1]))
            self._guard.pose(max(0.0, self._now() - event.pose.stamp))

    def close(self) -> None:
        """Nothing is held."""


class Step(NamedTuple):
    """One answer, what the policy knew and wants, and what the gate did at its newest step."""

    answer: Answer
    view: TargetView
    command: Command
    state: GateStatus


def steer(loop: Any, guard: Guard, odometer: Odometer, settings: WalkSettings) -> Iterator[Step]:
    """Walk by the answers of `loop` (`eagor.live.loop.Loop`, with one query) until it ends, in this thread.

    `odometer` has to be one of its sinks. Raises what the loop and the guard raise.
    """
    state, far, read = ControllerState(), (None, None), -math.inf
    for answer in loop:
        estimate = answer.estimate
        if estimate.direction is None:
            far = None, None
        elif not 0 <= answer.stamp - read < RANGED:
            read, far = answer.stamp, (estimate.distance, estimate.distance_spread)
        view = TargetView(
            estimate.stamp, estimate.status, estimate.azimuth, estimate.elevation or 0.0, *far, odometer.xy,
            heading(estimate.world_R_body),
        )  # fmt: skip
        state, command = walk(settings, state, view, held=guard.state.mode is not Mode.ARMED)
        late = max(0.0, loop.clock.now() - answer.stamp)
        guard.report(
            image_age=answer.image_age + late, look_age=answer.look_age + late, presence=estimate.presence,
            pose_age=None if answer.pose_age is None else answer.pose_age + late,
            faults=tuple(fault.text for fault in answer.faults if fault.part in PARTS),
        )  # fmt: skip
        guard.set_velocity(*command.velocity)
        yield Step(answer, view, command, guard.state)
