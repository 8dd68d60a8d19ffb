"""Searches of an ordinary camera that turns on the spot: who chooses where it looks next, and what becomes of it.

The body stays level and turns its heading; the camera is tilted on it. A tracker follows all looks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from eagor.evidence import Evidence
from eagor.grids import PerspectiveGrid
from eagor.sphere import azimuth_elevation, world_R_body
from eagor.tasks.hstar.play import SWEEP
from eagor.tracking import DirectionTracker, Estimate, Heights, TrackerConfig, TurningCamera

PRESENT = 0.9  # presence from which on a search is sure
SECONDS = 1.0  # between looks

Heading = tuple[float, float]  # azimuth, positive left, and elevation, degrees, world frame
Look = Callable[[np.ndarray, PerspectiveGrid, float], Evidence]  # the body's pose, the view in the body, the time


@dataclass(frozen=True, eq=False)
class LookTaken:
    """One look: the body's orientation ``(3, 3)``, the pixels of the camera, and the estimate after it."""

    world_R_body: np.ndarray
    grid: PerspectiveGrid
    estimate: Estimate

    @property
    def sure(self) -> bool:
        """Whether a direction is known and the thing is likely here."""
        return self.estimate.direction is not None and self.estimate.presence > PRESENT


Choice = Callable[[LookTaken, TurningCamera, int, float], Heading]


def _next_look(last: LookTaken, camera: TurningCamera, turn: int, start: float) -> Heading:
    toward = last.estimate.next_look(camera, Heights(), last.grid.body_R_view).direction
    return _heading(last, toward)


def _follow(last: LookTaken, camera: TurningCamera, turn: int, start: float) -> Heading:
    known = last.estimate.direction
    return _heading(last, last.grid.body_R_view[:, 0] if known is None else known)


def _sweep(last: LookTaken, camera: TurningCamera, turn: int, start: float) -> Heading:
    yaw, pitch = SWEEP[turn % len(SWEEP)]
    return start - yaw, pitch


def _ring(last: LookTaken, camera: TurningCamera, turn: int, start: float) -> Heading:
    return start - 90.0 * turn, 0.0


CHOICES: dict[str, tuple[Choice, str]] = {
    "next": (_next_look, "looks where a look is expected to tell most"),
    "follow": (_follow, "looks where the estimate points"),
    "sweep": (_sweep, "ten views in a fixed order: around the horizon, below it, above it; then again"),
    "ring": (_ring, "four views around the horizon, again and again"),
}


def search(
    look: Look,
    choice: str,
    view: PerspectiveGrid,
    most: int,
    start: float = 0.0,
    config: TrackerConfig | None = None,
) -> Iterator[LookTaken]:
    """At most so many looks for one thing, one a second; `choice` is one of `CHOICES`, and `view` looks forward.

    The first look is level and at the azimuth `start` (degrees). Raises what `look` raises, and `GridError` for a view
    that `TurningCamera` refuses.
    """
    camera = TurningCamera.of_view(view)
    tracker, heading = DirectionTracker(config), (start, 0.0)
    for turn in range(1, most + 1):
        stamp, pose = SECONDS * turn, world_R_body(math.radians(heading[0]))
        grid = replace(view, body_R_view=world_R_body(0.0, -math.radians(heading[1])))
        tracker.add_pose(stamp, pose)
        tracker.observe(look(pose, grid, stamp))
        taken = LookTaken(pose, grid, tracker.estimate(stamp))
        yield taken
        heading = CHOICES[choice][0](taken, camera, turn, start)


def _heading(last: LookTaken, toward: np.ndarray) -> Heading:
    """In the world, to whole degrees."""
    azimuth, elevation = np.degrees(azimuth_elevation(last.world_R_body @ toward))
    return float(round(float(azimuth))), float(round(float(elevation)))
