"""Steps of a body over a navigation mesh: Habitat's own, but that no body is left on the edge of the mesh."""

from __future__ import annotations

import math

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.habitat.surface import Surface

__all__ = ["stepped"]

HELD = 1e-4  # metres by which a step falls short that has collided: the mesh is in single precision
SHORT = 1e-3  # metres off the edge at which a step without sliding ends: no step leads away from the edge itself
FAR = 2.0  # metres within which an edge is looked for


def stepped(surface: Surface, xy: np.ndarray, step: np.ndarray, slide: bool) -> tuple[np.ndarray, bool]:
    """The end of a step ``(2,)`` from a free point ``(2,)``, and whether it collided: Habitat's ``try_step``.

    A blocked step slides along the edge of the mesh (`slide`), or the body stops a millimetre off every edge: for
    Habitat-Sim 0.3.4 every step of a body that stands on the edge crosses it. It never leaves the storey. Raises
    `WorldError` if the start is not free or the step not finite.
    """
    start, way = np.asarray(xy, dtype=np.float64), np.asarray(step, dtype=np.float64)
    if not np.isfinite(way).all():
        raise WorldError(f"step = ({way[0]}, {way[1]}); wanted two finite numbers, metres")
    surface.check_free(start)
    if not way.any():
        return start.copy(), False
    feet, ahead = surface.feet(start), surface.frames.to_habitat(np.array([*(start + way), 0.0]))
    ahead[1] = feet[1]
    tried = surface.pathfinder.try_step if slide else surface.pathfinder.try_step_no_sliding
    end = surface.frames.from_habitat(np.array(tried(feet, ahead.astype(np.float32)), dtype=np.float64))[:2]
    moved = end - start
    if not np.isfinite(end).all() or np.hypot(*moved) > np.hypot(*way) + HELD or not surface.is_free(end):
        return start.copy(), True
    # Freely moved, the body is where the step led, not where single precision has put it.
    if np.hypot(*(moved - way)) <= HELD:
        return start + way, False
    return (end if slide else _off_the_edge(surface, start, moved)), True


def _off_the_edge(surface: Surface, start: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The first place ``(2,)`` on the way that comes within about `SHORT` of an edge.

    Habitat's own step can cross a notch of the mesh and end behind it, so the way is followed from its start: each time
    as far as nothing can be met.
    """
    length, gone, clear = float(np.hypot(*moved)), 0.0, math.inf
    if length == 0:
        return start.copy()
    while gone < length and clear > SHORT + HELD:
        here = surface.feet(start + moved * (gone / length))
        clear = float(surface.pathfinder.distance_to_closest_obstacle(here, FAR))
        gone += max(0.0, clear - SHORT)
    return start + moved * min(1.0, gone / length)
