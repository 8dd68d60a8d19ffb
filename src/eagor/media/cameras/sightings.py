"""The same things seen twice: by two lenses of a camera at once, or by a camera that turned in place."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from eagor.media.cameras.rig import Rig
from eagor.media.cameras.stitching import Stitcher
from eagor.media.features import FIELD, Features, features_of, match
from eagor.media.two_views import Turn, turn_between

__all__ = ["Pairs", "Points", "pairs_of", "points_of", "turns_of"]

RIM = math.radians(1.5)  # from the rim, where the border of the circle makes points of its own
LEAST, MOST = 320, 1024  # pixels of a view in which points are looked for
ROWS = 2048  # of the panorama that a lens is laid out on, at most
FOR_TURNS = 1200  # points of a moment that are compared to find its turn
SHORT = 400  # pairs that tell a turn; more only take longer
EACH = 6  # up to so many moments are compared each with each; of more, each with the next ones
NEXT = 3


@dataclass(frozen=True, eq=False)
class Points:
    """What one lens sees of one moment: pixel coordinates ``(n, 2)``, descriptors ``(n, 128)``."""

    moment: int
    lens: int
    pixels: np.ndarray
    descriptors: np.ndarray


@dataclass(frozen=True, eq=False)
class Pairs:
    """`n` pairs of sightings of one thing, a and b: moments ``(n, 2)``, lenses ``(n, 2)``, pixels ``(n, 2, 2)``."""

    moments: np.ndarray
    lenses: np.ndarray
    pixels: np.ndarray

    def __len__(self) -> int:
        return len(self.moments)


@dataclass(frozen=True, eq=False)
class _Seen:
    """Points of a moment, in the body: features, lenses ``(n,)``, pixels ``(n, 2)``."""

    features: Features
    lenses: np.ndarray
    pixels: np.ndarray


def points_of(rig: Rig, moments: Sequence[Sequence[np.ndarray]], on_step: Callable[[], None]) -> list[Points]:
    """The points in each lens' picture of each moment, found on views that are straight as far as `rig` knows."""
    stitcher = Stitcher(rig, min(ROWS, rig.rows))
    size = max(LEAST, min(MOST, round(2 * math.tan(FIELD / 2) * stitcher.grid.height / math.pi)))
    found = []
    for moment, pictures in enumerate(moments):
        for index, lens in enumerate(rig.lenses):
            shown, _ = stitcher.alone(index, *pictures)
            features = features_of(shown, size)
            x, y, depth = lens.project(features.directions)
            inside = depth > RIM
            pixels = np.stack([x[inside], y[inside]], axis=1)
            found.append(Points(moment, index, pixels, features.descriptors[inside]))
        on_step()
    return found


def turns_of(rig: Rig, points: Sequence[Points]) -> dict[tuple[int, int], Turn]:
    """How the camera turned between any two moments, where their points tell."""
    moments = sorted({each.moment for each in points})
    seen = {moment: _thinned(_joined(rig, points, moment)) for moment in moments}
    turns = {}
    for i, j in combinations(moments, 2):
        here, there = seen[i].features, seen[j].features
        first, second = match(here, there)
        step = max(1, math.ceil(len(first) / SHORT))
        first, second = first[::step], second[::step]
        turn = turn_between(here.directions[first], there.directions[second], moves=False) if len(first) else None
        if turn is not None:
            turns[i, j] = turn
    return turns


def pairs_of(rig: Rig, points: Sequence[Points], world_R_body: np.ndarray, gate: float, turned: bool) -> Pairs:
    """Pairs whose rays are less than `gate` (radians) apart, with the lenses of `rig` and rotations ``(m, 3, 3)``.

    Between the lenses at each moment, and if the camera `turned` in place, between moments.
    """
    moments = sorted({each.moment for each in points})
    parts: list[Pairs] = []
    for moment in moments:
        lenses = [_only(rig, each) for each in points if each.moment == moment]
        parts += [_matched(a, b, (moment, moment), world_R_body, gate) for a, b in combinations(lenses, 2)]
    if turned:
        seen = [_joined(rig, points, moment) for moment in moments]
        n = len(moments)
        ahead = [(i, j) for i, j in combinations(range(n), 2) if n <= EACH or min(j - i, n - j + i) <= NEXT]
        parts += [_matched(seen[i], seen[j], (moments[i], moments[j]), world_R_body, gate) for i, j in ahead]
    return Pairs(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("moments", "lenses", "pixels")))


def _matched(a: _Seen, b: _Seen, moments: tuple[int, int], world_R_body: np.ndarray, gate: float) -> Pairs:
    first, second = match(a.features, b.features)
    here = a.features.directions[first] @ world_R_body[moments[0]].T
    there = b.features.directions[second] @ world_R_body[moments[1]].T
    near = np.linalg.norm(here - there, axis=1) < gate
    first, second = first[near], second[near]
    return Pairs(
        np.tile(moments, (len(first), 1)),
        np.stack([a.lenses[first], b.lenses[second]], axis=1),
        np.stack([a.pixels[first], b.pixels[second]], axis=1),
    )


def _only(rig: Rig, points: Points) -> _Seen:
    """The points of one lens."""
    directions = rig.lenses[points.lens].unproject(points.pixels[:, 0], points.pixels[:, 1])
    return _Seen(Features(directions, points.descriptors), np.full(len(directions), points.lens), points.pixels)


def _joined(rig: Rig, points: Sequence[Points], moment: int) -> _Seen:
    """All points of a moment, each thing once.

    Where two lenses see the same, only the points of the lens that sees it deeper are taken: twins would fail the
    comparison of the best match with the second.
    """
    parts = []
    for each in (_only(rig, each) for each in points if each.moment == moment):
        depth = np.stack([lens.project(each.features.directions)[2] for lens in rig.lenses])
        parts.append((each, np.flatnonzero(depth.argmax(axis=0) == each.lenses)))
    directions = np.concatenate([each.features.directions[own] for each, own in parts])
    descriptors = np.concatenate([each.features.descriptors[own] for each, own in parts])
    lenses = np.concatenate([each.lenses[own] for each, own in parts])
    return _Seen(Features(directions, descriptors), lenses, np.concatenate([each.pixels[own] for each, own in parts]))


def _thinned(seen: _Seen) -> _Seen:
    step = max(1, math.ceil(len(seen.features) / FOR_TURNS))
    features = Features(seen.features.directions[::step], seen.features.descriptors[::step])
    return _Seen(features, seen.lenses[::step], seen.pixels[::step])
