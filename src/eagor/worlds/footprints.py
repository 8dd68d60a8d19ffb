"""From which points the way to a thing ends with a straight line to its footprint, its bounds seen from above."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from eagor.worlds.scene import Instance, Room

BESIDE = 0.75  # metres that one can reach to a piece of furniture
_NEAREST = 4000  # points looked at where no room tells on which side of the walls the thing is

Crossings = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def beside(
    instance: Instance, points: np.ndarray, rooms: tuple[Room, ...], crossings: Crossings
) -> tuple[np.ndarray, np.ndarray]:
    """Places ``(k,)`` in `points` ``(n, 2)`` beside the instance; their distances ``(k,)`` to its footprint, metres.

    Beside are the points within 0.75 m whose line to the nearest point of the footprint crosses no structure. A thing
    against or on a wall shares cells with it, so crossings close to the end do not count, unless the point lies outside
    the room of the thing: the wall may be as thin as a sheet. Where no point is beside (a vase in the middle of a large
    table), it is those of the same room that are at most 0.75 m farther than the nearest of them; without rooms, the
    same of those whose line is clear. `crossings` tells of lines whether they cross structure anywhere, and whether
    they do so before their last bit.
    """
    nearest = np.clip(points, instance.low[:2], instance.high[:2])
    away = np.hypot(*(nearest - points).T)
    room = next((room for room in rooms if room.name == instance.room), None)
    close = np.flatnonzero(away <= BESIDE)
    anywhere, early = crossings(points[close], nearest[close])
    clear = ~early
    if room is not None:
        clear &= ~anywhere | _inside(room, points[close])
    seeds = close[clear]
    if len(seeds) == 0:
        x, y, _ = instance.centre
        room = room or next((room for room in rooms if room.contains(x, y)), None)
        if room is not None:
            seeds = np.flatnonzero(_inside(room, points))
        else:
            seeds = np.argsort(away, kind="stable")[:_NEAREST]
            seeds = seeds[~crossings(points[seeds], nearest[seeds])[1]]
        seeds = seeds[away[seeds] <= away[seeds].min(initial=np.inf) + BESIDE]
    return seeds, away[seeds]


def _inside(room: Room, points: np.ndarray) -> np.ndarray:
    x, y = points[:, :1], points[:, 1:]
    x0, y0, x1, y1 = room.rectangles.T
    return ((x0 <= x) & (x <= x1) & (y0 <= y) & (y <= y1)).any(axis=1)
