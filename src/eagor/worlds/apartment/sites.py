"""Candidate places for a piece of furniture: footprints with scores, before any check."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor.worlds.apartment.cells import WallFace
from eagor.worlds.apartment.placement import Floor

GAP = 0.02  # between the back of a piece and the wall: more than a skirting board


@dataclass(frozen=True, eq=False)
class Sites:
    """Candidates: footprints ``(n, 5)`` and scores ``(n,)``, more is better."""

    boxes: np.ndarray
    scores: np.ndarray

    def best(self, good: np.ndarray, most: int) -> np.ndarray:
        """Indices of the `most` best ones among those that are `good` ``(n,)``, best first."""
        places = np.flatnonzero(good)
        return places[np.argsort(-self.scores[places], kind="stable")][:most]


def joined(*several: Sites) -> Sites:
    """All candidates together."""
    if not several:
        return Sites(np.zeros((0, 5)), np.zeros(0))
    return Sites(np.concatenate([s.boxes for s in several]), np.concatenate([s.scores for s in several]))


def facing(face: WallFace) -> float:
    """The angle of a piece with its back to a wall."""
    if face.axis == 0:
        return math.copysign(math.pi / 2, face.side)
    return 0.0 if face.side > 0 else math.pi


def on_face(face: WallFace, along: np.ndarray, away: float, size: np.ndarray) -> np.ndarray:
    """Footprints ``(n, 5)`` of a `size`: middles `along` ``(n,)`` a wall, backs `away` metres from it."""
    boxes = np.zeros((len(along), 5))
    boxes[:, face.axis] = along
    boxes[:, 1 - face.axis] = face.line + face.side * (away + size[0] / 2)
    boxes[:, 2:] = size[0] / 2, size[1] / 2, facing(face)
    return boxes


def along_walls(
    floor: Floor, room: int, size: np.ndarray, rng: np.random.Generator, *,
    corner: float = 0.0, middle: float = 0.0, gap: float = GAP, side: float = 0.04,
) -> Sites:  # fmt: skip
    """Backs to walls: in the corners (score `corner`), the `middle`, and between; `side` metres free at the ends."""
    found = []
    for face in floor.faces:
        if face.room != room or face.end - face.start - size[1] - 2 * side < 0:
            continue
        first, last = face.start + side + size[1] / 2, face.end - side - size[1] / 2
        along = np.concatenate([[first, last, (first + last) / 2], rng.uniform(first, last, 5)])
        scores = rng.uniform(0, 0.5, len(along)) + np.array([corner, corner, middle, 0, 0, 0, 0, 0])
        found.append(Sites(on_face(face, along, gap, size), scores))
    return joined(*found)


def in_room(floor: Floor, room: int, size: np.ndarray, rng: np.random.Generator, count: int = 60) -> Sites:
    """Anywhere in a room, axis-aligned or turned by a quarter, preferably near its middle."""
    rectangles = floor.rooms[room].rectangles
    area = (rectangles[:, 2] - rectangles[:, 0]) * (rectangles[:, 3] - rectangles[:, 1])
    picked = rectangles[rng.choice(len(rectangles), count, p=area / area.sum())]
    spot = rng.random((count, 2))
    middle = (rectangles[area.argmax(), :2] + rectangles[area.argmax(), 2:]) / 2
    boxes = np.zeros((count, 5))
    boxes[:, :2] = picked[:, :2] + spot * (picked[:, 2:] - picked[:, :2])
    boxes[:, 2:4] = size[:2] / 2
    boxes[:, 4] = rng.integers(0, 2, count) * (math.pi / 2)
    off = np.linalg.norm(boxes[:, :2] - middle, axis=1)
    return Sites(boxes, rng.uniform(0, 0.3, count) - 0.3 * off)


def relative(box: np.ndarray, forward: float, left: float, size: np.ndarray, turn: float = 0.0) -> np.ndarray:
    """The footprint of something `forward` and to the `left` of another's middle, turned relative to it (radians)."""
    c, s = math.cos(box[4]), math.sin(box[4])
    x, y = box[0] + forward * c - left * s, box[1] + forward * s + left * c
    return np.array([x, y, size[0] / 2, size[1] / 2, math.remainder(box[4] + turn, 2 * math.pi)])


def advanced(boxes: np.ndarray, reach: np.ndarray | float) -> np.ndarray:
    """Footprints ``(n, 5)`` moved `reach` metres forward."""
    boxes = np.atleast_2d(boxes).copy()
    boxes[:, 0] += reach * np.cos(boxes[:, 4])
    boxes[:, 1] += reach * np.sin(boxes[:, 4])
    return boxes


def before(boxes: np.ndarray, depth: float) -> np.ndarray:
    """The floor ``(n, 5)`` in front of footprints, `depth` metres deep."""
    zone = advanced(boxes, np.atleast_2d(boxes)[:, 2] + depth / 2)
    zone[:, 2] = depth / 2 - 1e-3
    return zone


def reversed_(boxes: np.ndarray) -> np.ndarray:
    """Footprints ``(n, 5)`` that look the other way."""
    back = boxes.copy()
    back[:, 4] = np.remainder(boxes[:, 4] + 2 * math.pi, 2 * math.pi) - math.pi
    return back
