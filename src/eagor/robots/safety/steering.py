"""A robot walks to a thing: the answers of the live loop go through the policy to the guard.

Everything here runs in the thread that iterates, so a loop that hangs is a program that hangs, and the guard's process
stops the robot.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from eagor.live.events import Answer, Event, FrameCame, PoseCame
from eagor.robots.safety.guard import GuardState
from eagor.robots.safety.walking import Sight, Walk, WalkSettings, Wish, walk
from eagor.sphere import azimuth_elevation

__all__ = ["Guarding", "Odometer", "Steering", "Step", "steer"]

PARTS = ("camera", "perception")  # of the loop, whose faults stop the robot; ages tell of poses and clocks
RANGED = 0.5  # seconds for which a distance holds: reading one takes as long as an answer
UNKNOWN = (math.inf, math.inf)  # a distance that is not known, and its spread
POSES = 0.02  # seconds between two words to the guard that poses come


class Guarding(Protocol):
    """What steering needs of `eagor.robots.safety.guard.Guard`."""

    @property
    def state(self) -> GuardState: ...
    def command(self, forward: float, left: float, turn: float) -> None: ...
    def status(
        self,
        *,
        image_age: float | None,
        pose_age: float | None,
        belief_age: float | None,
        presence: float | None,
        faults: Sequence[str] = (),
    ) -> None: ...
    def pose(self, age: float) -> None: ...


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

    def __init__(self, guard: Guarding, now: Callable[[], float]) -> None:
        self.xy: tuple[float, float] | None = None
        self.panorama: np.ndarray | None = None
        self._guard, self._now = guard, now
        self._told = -math.inf

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop."""
        if isinstance(event, FrameCame):
            self.panorama = event.panorama
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

    def __init__(self, guard: Guarding, odometer: Odometer, settings: WalkSettings, now: Callable[[], float]) -> None:
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
        self._state, wish = walk(self._settings, self._state, sight)
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


def steer(loop: Any, guard: Guarding, odometer: Odometer, settings: WalkSettings) -> Iterator[Step]:
    """Walk by the answers of `loop` (`eagor.live.loop.LiveLoop`, with one query) until it ends.

    `odometer` has to be one of its watchers. Raises what the loop and the guard raise.
    """
    steering = Steering(guard, odometer, settings, loop.clock.now)
    for answer in loop:
        yield steering.step(answer)
