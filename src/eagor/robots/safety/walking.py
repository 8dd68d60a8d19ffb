"""From an answer to a wanted velocity: turn towards it, walk to it, stop before it. The gate stands behind it.

`walk` is pure. The robot turns in place until the answer is ahead, and walks only while it stays there. It slows down
as the distance shrinks, and stops at the wanted one. Where the distance is not known, it walks slowly, and only so
far. While nothing is known it turns to search; while the answer is ambiguous or old it stands.

`steer` takes the answers of the live loop through it to the guard. That runs in the thread that iterates, so a loop
that hangs is a program that hangs, and the guard's process stops the robot.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from eagor._checks import above, require, within
from eagor.live.events import Answer, Event, FrameCame, PoseCame
from eagor.robots.safety.gate import Mode
from eagor.robots.safety.limits import STILL, Velocity
from eagor.robots.safety.messages import GateClient, GuardState
from eagor.sphere import azimuth_elevation, heading
from eagor.tracking.estimate import Estimate, Status

__all__ = ["Doing", "Odometer", "Sight", "Steering", "Step", "Walk", "WalkSettings", "Wish", "steer", "walk"]

Doing = Literal["searching", "turning", "walking", "arrived", "holding"]
STEEP = math.radians(70)  # of elevation: beyond, an azimuth says little about where to go
UNHEARD = 1.0  # seconds between two sights after which the way in between is not counted

PARTS = ("camera", "perception")  # of the loop, whose faults stop the robot; ages tell of poses and clocks
RANGED = 0.5  # seconds for which a distance holds: reading one takes as long as an answer
UNKNOWN = (math.inf, math.inf)  # a distance that is not known, and its spread
POSES = 0.02  # seconds between two words to the guard that poses come


@dataclass(frozen=True)
class WalkSettings:
    """How to walk.

    - `distance`: metres over the ground from the camera to the thing, at which it stops; `again`: metres beyond that
      from which it follows a thing that goes away.
    - `cone`: radians of azimuth within which it walks; `ahead`: radians within which it begins to.
    - `speed` (m/s), `turn` (rad/s): the fastest. `turn_gain`: rad/s per radian of azimuth. `speed_gain`: m/s per metre
      that is left. A Go2 follows a command after 0.45 s; gains of 1 per second and less do not overshoot by much.
    - `slowest`: m/s on the last stretch.
    - `spread`: standard deviation of the logarithm of the distance up to which a distance counts as known.
    - `nearest`: metres; it stops where the thing may be as near as this (one standard deviation).
    - `blind`: metres that it walks, at `blind_speed`, without knowing the distance.
    - `search_turn`: rad/s of searching; `search_turns`: whole turns before it gives that up until something is seen.
    - `stuck`: seconds of walking without getting on after which it stands; `progress`: metres that count as getting on.
    """

    distance: float = 1.0
    again: float = 0.3
    cone: float = math.radians(20)
    ahead: float = math.radians(10)
    speed: float = 0.4
    turn: float = 0.6
    turn_gain: float = 0.9
    speed_gain: float = 0.6
    slowest: float = 0.12
    spread: float = 0.35
    nearest: float = 0.4
    blind: float = 3.0
    blind_speed: float = 0.2
    search_turn: float = 0.4
    search_turns: float = 2.0
    stuck: float = 4.0
    progress: float = 0.1

    def __post_init__(self) -> None:
        angles = {name: (within(getattr(self, name), 0.01, math.pi), "radians") for name in ("cone", "ahead")}
        rest = [name for name in self.__dataclass_fields__ if name not in angles and name != "blind"]
        fields = angles | {name: (above(getattr(self, name), 0, 1000), "a number above 0") for name in rest}
        require(self, fields | {"blind": (within(self.blind, 0, 1000), "metres, from 0 on")})
        require(self, {"ahead": (self.ahead <= self.cone, f"at most cone, {self.cone:.2f}")})


@dataclass(frozen=True)
class Sight:
    """What is known at one time: of the answer, and of the robot's own way (odometry).

    `stamp`: seconds; `azimuth`, `elevation`: radians, body frame, None while nothing is known; `distance`: metres to
    the thing, with `spread`, the standard deviation of its logarithm. `xy`: metres; `yaw`: radians; None: not known.
    """

    stamp: float
    status: Status
    azimuth: float | None = None
    elevation: float | None = None
    distance: float | None = None
    spread: float | None = None
    xy: tuple[float, float] | None = None
    yaw: float | None = None

    @classmethod
    def of(
        cls, estimate: Estimate, xy: tuple[float, float] | None = None, far: tuple[float, float] | None = None
    ) -> Sight:
        """What an estimate says; its pose gives the heading. `xy`: the odometry's place at that time.

        `far`: distance and its spread, where they are known already: reading them from an estimate takes long.
        """
        if far is None and estimate.distance is not None and estimate.distance_spread is not None:
            far = estimate.distance, estimate.distance_spread
        distance, spread = (None, None) if far is None or estimate.azimuth is None else far
        yaw = heading(estimate.world_R_body)
        return cls(estimate.stamp, estimate.status, estimate.azimuth, estimate.elevation, distance, spread, xy, yaw)

    @property
    def ground(self) -> float | None:
        """Metres to the thing over the ground."""
        return None if self.distance is None else self.distance * math.cos(self.elevation or 0.0)


@dataclass(frozen=True)
class Walk:
    """What the policy remembers between two sights."""

    doing: Doing = "holding"
    last: Sight | None = None
    side: float = 1.0  # to search: 1 left, -1 right; where the thing was last
    turned: float = 0.0  # radians, while searching
    blind: float = 0.0  # metres walked since the distance was known
    mark: tuple[float, float] | None = None  # where the way was counted last
    anchor: tuple[float, tuple[float, float]] | None = None  # when and where it last got on
    blocked: bool = False


@dataclass(frozen=True)
class Wish:
    """The wanted velocity, what the robot is doing, and why, in words."""

    velocity: Velocity
    doing: Doing
    words: str


def walk(settings: WalkSettings, state: Walk, sight: Sight, held: bool = False) -> tuple[Walk, Wish]:
    """The next state and the wanted velocity, from what is known now. Call it for every answer.

    `held`: the gate does not let it move. That time does not count: nothing is known then of what is in its way.
    """
    if held and state.anchor is not None and state.last is not None:
        when, where = state.anchor
        state = replace(state, anchor=(when + sight.stamp - state.last.stamp, where))
    state = _moved(settings, state, sight)
    state, wish = _wish(settings, state, sight)
    walks = wish.velocity.walks
    anchor = state.anchor if walks else None
    if walks and anchor is None and sight.xy is not None:
        anchor = sight.stamp, sight.xy
    return replace(state, doing=wish.doing, last=sight, anchor=anchor), wish


def _moved(settings: WalkSettings, state: Walk, sight: Sight) -> Walk:
    """Count the way and the turn since the last sight."""
    last, searching = state.last, sight.status == "searching"
    if not searching:
        side = math.copysign(1.0, sight.azimuth) if sight.azimuth else state.side
        state = replace(state, turned=0.0, side=side)
    if last is None or not 0 <= sight.stamp - last.stamp <= UNHEARD:
        return replace(state, anchor=None, mark=sight.xy)
    gone, mark = 0.0, state.mark or sight.xy
    if sight.xy is not None and mark is not None:
        # A camera on a walking robot sways: only what adds up is a way.
        if (away := math.dist(sight.xy, mark)) >= settings.progress:
            gone, mark = away, sight.xy
    elif state.doing == "walking":  # without odometry: as if it had gone as fast as it was told
        gone = settings.blind_speed * (sight.stamp - last.stamp)
    turned = 0.0
    if sight.yaw is not None and last.yaw is not None:
        turned = abs(math.remainder(sight.yaw - last.yaw, 2 * math.pi))
    known = _known(settings, sight)
    state = replace(state, blind=0.0 if known else state.blind + gone, mark=mark)
    state = replace(state, turned=state.turned + turned if searching and state.doing == "searching" else state.turned)
    if state.anchor is not None and sight.xy is not None:
        when, where = state.anchor
        if math.dist(sight.xy, where) >= settings.progress:
            return replace(state, anchor=(sight.stamp, sight.xy))
        if sight.stamp - when > settings.stuck:
            return replace(state, blocked=True)
    return state


def _known(settings: WalkSettings, sight: Sight) -> bool:
    return sight.distance is not None and sight.spread is not None and sight.spread <= settings.spread


def _wish(settings: WalkSettings, state: Walk, sight: Sight) -> tuple[Walk, Wish]:
    if sight.status == "searching" or sight.azimuth is None:
        return state, _search(settings, state)
    if sight.status != "tracking":
        why = "several places are likely" if sight.status == "ambiguous" else "the answer is old"
        return state, Wish(STILL, "holding", f"{why}: it stands")
    if sight.elevation is not None and abs(sight.elevation) > STEEP:
        where = "above" if sight.elevation > 0 else "below"
        return state, Wish(STILL, "arrived", f"the thing is right {where} the camera")
    turn = min(max(settings.turn_gain * sight.azimuth, -settings.turn), settings.turn)
    away = abs(sight.azimuth)
    if away > (settings.cone if state.doing == "walking" else settings.ahead):
        # What was in the way may not be on the new heading.
        state = replace(state, blocked=state.blocked and away <= settings.cone)
        words = f"it turns {'left' if turn > 0 else 'right'}: the answer is {math.degrees(away):.0f}° off"
        return state, Wish(Velocity(turn=turn), "turning", words)
    speed, words = _speed(settings, state, sight)
    if speed == 0:
        return state, Wish(Velocity(turn=turn), "arrived" if _known(settings, sight) else "holding", words)
    if state.blocked:
        return state, Wish(STILL, "holding", "it does not get on: something is in the way")
    return state, Wish(Velocity(speed * math.cos(sight.azimuth), 0.0, turn), "walking", words)


def _search(settings: WalkSettings, state: Walk) -> Wish:
    if state.turned >= 2 * math.pi * settings.search_turns:
        return Wish(STILL, "holding", f"nothing was found in {settings.search_turns:g} turns: it stands and looks")
    side = "left" if state.side > 0 else "right"
    return Wish(Velocity(turn=state.side * settings.search_turn), "searching", f"it searches, turning {side}")


def _speed(settings: WalkSettings, state: Walk, sight: Sight) -> tuple[float, str]:
    """How fast to walk straight on, 0 to stop; and why."""
    if not _known(settings, sight) or sight.ground is None or sight.spread is None:
        if state.blind >= settings.blind:
            return 0.0, f"the distance is still not known after {settings.blind:g} m: it stands"
        more = settings.blind - state.blind
        return settings.blind_speed, f"it walks slowly: the distance is not known ({more:.1f} m left)"
    left = sight.ground - settings.distance
    least = sight.ground * math.exp(-sight.spread)
    told = f"{sight.ground:.1f} m (68 %: {least:.1f} to {sight.ground * math.exp(sight.spread):.1f} m)"
    if least <= settings.nearest:
        return 0.0, f"the thing may be as near as {least:.1f} m: it stands"
    if left <= (settings.again if state.doing == "arrived" else 0.0):
        return 0.0, f"it is there: {told}"
    # The cautious distance sets the speed, the likely one where to stop.
    speed = min(settings.speed, settings.speed_gain * (least - settings.distance))
    return max(speed, settings.slowest), f"it walks: {told}"


@dataclass(frozen=True, eq=False)
class Step:
    """One answer, and what became of it.

    `panorama`: the newest picture ``(H, W, 3)`` uint8, older than the answer; `sight`: what the policy knew, of the
    odometry and the distance too; `wish`: what it wants; `state`: of the guard, at its newest step.
    """

    answer: Answer
    panorama: np.ndarray | None
    sight: Sight
    wish: Wish
    state: GuardState


class Odometer:
    """A watcher of the live loop (`eagor.live.loop.Watcher`): the newest place and picture.

    It tells the guard of poses as they come, which is more often than answers are given. `now`: the loop's clock.
    """

    def __init__(self, guard: GateClient, now: Callable[[], float]) -> None:
        self.xy: tuple[float, float] | None = None
        self.panorama: np.ndarray | None = None
        self._guard, self._now = guard, now
        self._told = -math.inf

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop."""
        if isinstance(event, FrameCame):
            self.panorama = event.picture
        elif isinstance(event, PoseCame):
            place = event.pose.position
            self.xy = None if place is None else (float(place[0]), float(place[1]))
            if event.arrival - self._told >= POSES:
                self._told = event.arrival
                self._guard.pose(max(0.0, self._now() - event.pose.stamp))

    def close(self) -> None:
        """Nothing is held."""


class Steering:
    """From answers about one query to what the `guard` is told, answer by answer.

    `odometer` has to be a watcher of the loop that gives the answers; `now` is that loop's clock.
    """

    def __init__(self, guard: GateClient, odometer: Odometer, settings: WalkSettings, now: Callable[[], float]) -> None:
        self._guard, self._odometer, self._settings, self._now = guard, odometer, settings, now
        self._state, self._far, self._read = Walk(), UNKNOWN, -math.inf

    def step(self, answer: Answer, body_R_camera: np.ndarray | None = None) -> Step:
        """Tell the guard what this answer wants. `body_R_camera` ``(3, 3)``: None is a camera that faces forward."""
        estimate = answer.estimate
        if estimate.direction is None:
            self._far = UNKNOWN
        elif answer.stamp - self._read >= RANGED or answer.stamp < self._read:
            self._read, far = answer.stamp, (estimate.distance, estimate.distance_spread)
            self._far = UNKNOWN if far[0] is None or far[1] is None else (far[0], far[1])
        sight = Sight.of(estimate, self._odometer.xy, self._far)
        if body_R_camera is not None and estimate.direction is not None:
            azimuth, elevation = azimuth_elevation(body_R_camera @ estimate.direction)
            sight = replace(sight, azimuth=float(azimuth), elevation=float(elevation))
        held = self._guard.state.mode is not Mode.ARMED
        self._state, wish = walk(self._settings, self._state, sight, held)
        late = max(0.0, self._now() - answer.stamp)
        self._guard.status(
            image_age=answer.image_age + late,
            pose_age=math.inf if answer.pose_age is None else answer.pose_age + late,
            belief_age=answer.look_age + late,
            presence=estimate.presence,
            faults=[fault.text for fault in answer.faults if fault.part in PARTS],
        )
        self._guard.command(*wish.velocity.parts)
        return Step(answer, self._odometer.panorama, sight, wish, self._guard.state)


def steer(loop: Any, guard: GateClient, odometer: Odometer, settings: WalkSettings) -> Iterator[Step]:
    """Walk by the answers of `loop` (`eagor.live.loop.LiveLoop`, with one query) until it ends.

    `odometer` has to be one of its watchers. Raises what the loop and the guard raise.
    """
    steering = Steering(guard, odometer, settings, loop.clock.now)
    for answer in loop:
        yield steering.step(answer)
