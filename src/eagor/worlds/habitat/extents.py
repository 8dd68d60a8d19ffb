"""The boxes of things in Habitat's semantic scenes, repaired from what is seen.

Habitat-Sim 0.3.4 extends the box of every object of HM3D to the origin of its world (its boxes begin as one point
there, not empty). A side that is at 0 may be wrong; all others are right. Such sides are taken from the points that the
thing shows from places all over the ground. A thing that is not seen from any of them is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from eagor.grids import ErpGrid
from eagor.worlds.habitat.frames import Frames
from eagor.worlds.habitat.sessions import Session
from eagor.worlds.habitat.view import euclidean

__all__ = ["from_the_origin", "repaired", "seen_boxes"]

Box = tuple[np.ndarray, np.ndarray]
ROWS = 128  # of the panoramas
FEWEST = 12  # pixels that a thing has to show
TRIM = 0.5  # per cent of the points at each end: edges of things mix near and far


def from_the_origin(boxes: Sequence[Box]) -> bool:
    """Whether all of several boxes, Habitat's world, contain the origin."""
    return len(boxes) > 2 and all((low <= 0).all() and (high >= 0).all() for low, high in boxes)


def repaired(box: Box, seen: Box) -> Box:
    """A box, Habitat's world, with its sides at 0 replaced by those of what was seen."""
    (low, high), (first, last) = box, seen
    return np.where(low == 0, np.clip(first, low, high), low), np.where(high == 0, np.clip(last, low, high), high)


def seen_boxes(session: Session, eyes: np.ndarray) -> Mapping[int, Box]:
    """The extent of what is seen of each semantic id from points ``(n, 3)``, all in Habitat's world."""
    still = Frames()
    directions = ErpGrid(ROWS, 2 * ROWS).directions
    ids, points = [], []
    for eye in eyes:
        looks = session.look(("depth", "semantic"), ROWS, eye, still.quaternion(np.eye(3)))
        metres = euclidean(looks["depth"])
        hit = np.isfinite(metres)
        ids.append(looks["semantic"][hit])
        points.append(eye + still.to_habitat(metres[hit][:, None] * directions[hit]))
    every, where = np.concatenate(ids), np.concatenate(points)
    order = np.argsort(every, kind="stable")
    names, starts = np.unique(every[order], return_index=True)
    parts = zip(names.tolist(), np.split(where[order], starts[1:]), strict=True)
    return {
        name: (np.percentile(part, TRIM, axis=0), np.percentile(part, 100 - TRIM, axis=0))
        for name, part in parts
        if len(part) >= FEWEST
    }
