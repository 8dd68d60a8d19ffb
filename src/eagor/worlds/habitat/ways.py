"""Ways over a navigation mesh: geodesic distances to the nearest of several goals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor._lazy import lazy
from eagor.worlds.geodesics import Field
from eagor.worlds.ground import Ground
from eagor.worlds.habitat.surface import Surface

__all__ = ["NavWay"]


@dataclass(frozen=True, eq=False)
class NavWay:
    """Geodesic distances to the nearest of goals ``(n, 3)``, each starting at its offset ``(n,)``, metres.

    Goals are in Habitat's world, as Habitat is asked for them. `plan`: the same storey in cells, for `over_plan`.
    """

    surface: Surface
    plan: Ground
    goals: np.ndarray
    offsets: np.ndarray

    def distance(self, xy: np.ndarray) -> np.ndarray:
        """Metres ``(...)`` from points ``(..., 2)``; inf without a path, off the ground and for NaN."""
        points = np.asarray(xy, dtype=np.float64)
        flat = [self.nearest(point)[0] for point in points.reshape(-1, 2)]
        return np.array(flat).reshape(points.shape[:-1])

    def nearest(self, xy: np.ndarray) -> tuple[float, int]:
        """The distance from a point ``(2,)``, and the index of the goal at that distance (-1: none)."""
        best, which = math.inf, -1
        if not self.surface.is_free(xy):
            return best, which
        feet = self.surface.feet(xy)
        least = np.linalg.norm(self.goals - feet, axis=1) + self.offsets
        for index in np.argsort(least):
            if least[index] >= best:
                break
            metres = self.surface.between(feet, self.goals[index])[0] + float(self.offsets[index])
            if metres < best:
                best, which = metres, int(index)
        return best, which

    def union(self, *others: NavWay) -> NavWay:
        """The distance to the nearest goal of this one and the others."""
        ways = (self, *others)
        goals, offsets = (np.concatenate([getattr(way, name) for way in ways]) for name in ("goals", "offsets"))
        return NavWay(self.surface, self.plan, goals, offsets)

    @lazy
    def over_plan(self) -> Field:
        """The same over the plan, to its accuracy."""
        points, starts = [], []
        for goal, start in zip(self.surface.frames.from_habitat(self.goals)[:, :2], self.offsets, strict=True):
            near = self.plan.snap(goal, within=2 * self.plan.cell)
            if near is not None:
                points.append(near)
                starts.append(start + float(np.hypot(*(near - goal))))
        return self.plan.field(np.array(points).reshape(-1, 2), np.array(starts))
