"""Fit lenses to things seen twice: robust least squares with weak priors, and what the pairs leave open.

A thing is seen twice by two lenses of a camera at once, or by a camera that turned in place (`pairs_of`). Unknown are,
for each fisheye lens, its centre, focal length, polynomial and rotation, and for a camera that turned in place its
rotation at each moment. A pair says that two rays meet: ``R_i B_a ray_a = R_j B_b ray_b``, with the rotations R of the
camera and B of the lenses, and ray = unproject(pixel). Nothing tells how the rig as a whole sits on the body: the
priors keep the lenses' rotations near the first ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from eagor.lenses import FisheyeLens, inverted
from eagor.media.rigs import Rig
from eagor.media.stitching import Stitcher
from eagor.odometry.features import FIELD, Features, Views, match
from eagor.odometry.two_views import RelativeRotation, bin_index, estimate_relative_rotation

__all__ = ["Pairs", "Points", "Solution", "gaps_of", "pairs_of", "points_of", "solve", "turns_of"]

RIM = math.radians(1.5)  # from the rim, where the border of the circle makes points of its own
LEAST_PIXELS, MOST_PIXELS = 320, 1024  # pixels of a view in which points are looked for
ROWS = 2048  # of the panorama that a lens is laid out on, at most
FOR_TURNS = 1200  # points of a moment that are compared to find its turn
SHORT = 400  # pairs that tell a turn; more only take longer
EACH = 6  # up to so many moments are compared each with each; of more, each with the next ones
NEXT = 3

TERMS = 4  # of the polynomial
OWN = 3 + TERMS  # centre x, y (in radii), logarithm of the focal length, polynomial
PER_LENS = OWN + 3  # and the rotation
CENTRE = 0.03  # prior deviation of the centre, in radii
FOCAL = 0.05  # of the focal length, as a share
CURVE = 0.10  # of each term of the polynomial at the rim, as a share of the angle
ALIKE = 0.3  # share of the last two by which the lenses of one camera, of one make, differ
TILT = math.radians(3.0)  # of a lens' rotation, per axis
TURN = math.radians(90.0)  # of the camera's rotation at a moment: nothing is known
NOISE, FINEST = math.radians(0.3), math.radians(0.05)  # of a pair, per axis: at first; SIFT is no better on the whole
# The centres of two lenses are 3 cm apart: things at 3 m are seen half a degree apart. A camera that turns in place
# sees them so from all sides, and the errors cancel; at one heading they do not.
PARALLAX = math.radians(0.3)
ROUNDS = 6  # of estimating the noise
HEAVY = 2.4  # noises at which Cauchy's loss begins to level off
STEP = 1e-6  # of numerical derivatives: radii, shares, factors
MOST = 4000  # pairs that are fitted; of more, every second, third, ...
HIGHEST = 2.6  # radians: no lens sees farther off its axis
SIDES = 8  # directions around the axis in which a lens is judged


# --- things seen twice ---


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
    size = max(LEAST_PIXELS, min(MOST_PIXELS, round(2 * math.tan(FIELD / 2) * stitcher.grid.height / math.pi)))
    found = []
    for moment, pictures in enumerate(moments):
        for index, lens in enumerate(rig.lenses):
            shown, _ = stitcher.alone(index, *pictures)
            features = Views.of(shown, size=size).features
            x, y, depth = lens.project(features.directions)
            inside = depth > RIM
            pixels = np.stack([x[inside], y[inside]], axis=1)
            found.append(Points(moment, index, pixels, features.descriptors[inside]))
        on_step()
    return found


def turns_of(rig: Rig, points: Sequence[Points]) -> dict[tuple[int, int], RelativeRotation]:
    """How the camera turned between any two moments, where their points tell."""
    moments = sorted({each.moment for each in points})
    joined = {moment: _joined(rig, points, moment).features for moment in moments}
    thinned = {moment: all_[:: max(1, math.ceil(len(all_) / FOR_TURNS))] for moment, all_ in joined.items()}
    turns = {}
    for i, j in combinations(moments, 2):
        here, there = thinned[i], thinned[j]
        first, second = match(here, there)
        step = max(1, math.ceil(len(first) / SHORT))
        first, second = first[::step], second[::step]
        old, new = here.directions[first], there.directions[second]
        turn = estimate_relative_rotation(old, new, moves=False) if len(first) else None
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
        own = depth.argmax(axis=0) == each.lenses
        parts.append((each.features[own], each.lenses[own], each.pixels[own]))
    features, lenses, pixels = zip(*parts, strict=True)
    joined = Features(*(np.concatenate([getattr(f, name) for f in features]) for name in ("directions", "descriptors")))
    return _Seen(joined, np.concatenate(lenses), np.concatenate(pixels))


# --- the fit ---


@dataclass(frozen=True, eq=False)
class Solution:
    """`rig`; `world_R_body` ``(m, 3, 3)`` of the moments; `gaps` ``(n,)`` of the pairs and their `noise`, radians.

    `parameters` ``(p,)``: differences from the start: per lens centre (radii), log focal, polynomial, rotation
    (radians, axes of the lens); then the rotations of the moments but the first. `covariance` ``(p, p)`` of them, with
    one independent point in each part of a lens and moment.
    """

    rig: Rig
    world_R_body: np.ndarray
    gaps: np.ndarray
    noise: float
    parameters: np.ndarray
    covariance: np.ndarray
    counts: tuple[int, int]

    def spread(self, lens: int, angles: np.ndarray) -> np.ndarray:
        """By how much directions of a lens at `angles` ``(k,)`` off its axis may be off: radians, ``(k,)``.

        The root mean square, over all sides, of the standard deviation, with the rig as a whole turned so that all its
        lenses fit best: how it sits on the body is not part of it.
        """
        lenses = [_fisheye(each) for each in self.rig.lenses]
        rays, changes = [], []
        for index, each in enumerate(lenses):
            at = np.concatenate([angles if index == lens else [], np.linspace(0.05, 1.0, 8) * each.reach])
            pixels = _rings(each, at)
            change = np.zeros((len(pixels), 3, len(self.covariance)))
            own, turn = _derivatives(each, pixels)
            change[:, :, index * PER_LENS : index * PER_LENS + OWN] = each.body_R_lens @ own
            change[:, :, index * PER_LENS + OWN : (index + 1) * PER_LENS] = each.body_R_lens @ turn
            rays.append(each.unproject(pixels[:, 0], pixels[:, 1]))
            changes.append(change)
        begin = sum(len(each) for each in rays[:lens])
        flat = np.concatenate(changes).reshape(-1, len(self.covariance))
        turns = -_crossing(np.concatenate(rays)).reshape(-1, 3)
        flat = flat - turns @ np.linalg.lstsq(turns, flat, rcond=None)[0]
        variance = np.einsum("ip,pq,iq->i", flat, self.covariance, flat).reshape(-1, 3).sum(axis=1)
        return np.sqrt(variance[begin : begin + SIDES * len(angles)].reshape(len(angles), SIDES).mean(axis=1))


def solve(
    rig: Rig, pairs: Pairs, world_R_body: np.ndarray, start: np.ndarray | None = None, turned: bool = True
) -> Solution:
    """The most likely lenses near those of `rig`, all fisheyes.

    `world_R_body` ``(m, 3, 3)``: the camera's rotations at the moments, to begin with, or unless it `turned` in place,
    for good; `start`: `parameters` of an earlier solution. Raises `GridError` if the result is no lens.
    """
    from scipy.optimize import least_squares

    step = max(1, math.ceil(len(pairs) / MOST))
    used = Pairs(pairs.moments[::step], pairs.lenses[::step], pairs.pixels[::step])
    problem = _Problem(rig, used, world_R_body, turned)
    x = np.zeros(problem.size)
    if start is not None:
        x[: len(rig.lenses) * PER_LENS] = start[: len(rig.lenses) * PER_LENS]
    gaps = np.linalg.norm(problem.gaps(x), axis=1)
    noise = max(NOISE, _deviation(gaps))
    independent = _independent(problem.lenses, used) * (len(world_R_body) if turned else 1)
    floor = FINEST if turned else PARALLAX
    scale = np.ones(len(used))
    for _ in range(ROUNDS):
        # Weights of Cauchy's law for the pairs; priors are Gaussian. Neighbouring points share their errors, so a part
        # of a lens counts as one point, however many there are.
        weights = 1 / (1 + (gaps / (HEAVY * noise)) ** 2)
        scale = np.sqrt(weights * min(1.0, independent / max(1, len(used)))) / noise
        found = least_squares(problem.residuals, x, problem.jacobian, args=(scale,), max_nfev=15)  # pyright: ignore[reportArgumentType]
        x = found.x
        gaps = np.linalg.norm(problem.gaps(x), axis=1)
        noise = max(floor, _deviation(gaps))
    jacobian = problem.jacobian(x, scale)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    lenses, turns = problem.at(x)
    every = np.linalg.norm(_Problem(rig, pairs, world_R_body, turned).gaps(x), axis=1)
    within = int((pairs.moments[:, 0] == pairs.moments[:, 1]).sum())
    counts = (within, len(pairs) - within)
    return Solution(Rig(rig.sizes, tuple(lenses)), turns, every, noise, x, covariance, counts)


def _deviation(gaps: np.ndarray) -> float:
    """Per axis, of gaps that follow Rayleigh's law but for mistakes: from their median."""
    return float(np.median(gaps)) / math.sqrt(2 * math.log(2))


def _independent(lenses: list[FisheyeLens], pairs: Pairs) -> int:
    """In how many parts of the lenses there are points."""
    count = 0
    for index, lens in enumerate(lenses):
        mine = [pairs.pixels[:, side][pairs.lenses[:, side] == index] for side in (0, 1)]
        rays = _seen(lens, np.zeros(OWN), np.concatenate(mine))
        count += len(np.unique(bin_index(rays))) if len(rays) else 0
    return max(1, count)


def gaps_of(rig: Rig, pairs: Pairs, world_R_body: np.ndarray) -> np.ndarray:
    """The angle between the two rays of each pair with the lenses of `rig`, radians ``(n,)``."""
    problem = _Problem(rig, pairs, world_R_body, False)
    return np.linalg.norm(problem.gaps(np.zeros(problem.size)), axis=1)


class _Problem:
    """Residuals of pairs and priors, and their derivatives, in the parameters of `Solution`."""

    def __init__(self, rig: Rig, pairs: Pairs, world_R_body: np.ndarray, turned: bool) -> None:
        self.lenses = [_fisheye(lens) for lens in rig.lenses]
        self.pairs, self.turns, self.turned = pairs, world_R_body, turned
        own = PER_LENS * len(self.lenses)
        self.size = own + (3 * (len(world_R_body) - 1) if turned else 0)
        deviations, shapes = [], []
        for lens in self.lenses:
            curve = [CURVE / lens.reach ** (2 * k) for k in range(1, TERMS + 1)]
            deviations += [CENTRE, CENTRE, FOCAL, *curve, TILT, TILT, TILT]
            shapes.append(np.array([FOCAL, *curve]))
        self.deviations = np.array([*deviations, *[TURN] * (self.size - own)])
        # Rows that say what is known before: each parameter is small, and the lenses' curves are alike.
        alike = []
        for k, shape in enumerate(shapes[1:], 1):
            for term, deviation in enumerate(shape):
                row = np.zeros(self.size)
                row[[2 + term, k * PER_LENS + 2 + term]] = np.array([1.0, -1.0]) / (deviation * ALIKE)
                alike.append(row)
        self.priors = np.concatenate([np.diag(1 / self.deviations), *([np.array(alike)] if alike else [])])

    def at(self, x: np.ndarray) -> tuple[list[FisheyeLens], np.ndarray]:
        """Lenses and rotations ``(m, 3, 3)`` of the moments."""
        lenses = [_changed(lens, x[k * PER_LENS : (k + 1) * PER_LENS]) for k, lens in enumerate(self.lenses)]
        return lenses, self._turned(x)

    def _turned(self, x: np.ndarray) -> np.ndarray:
        turns = x[PER_LENS * len(self.lenses) :].reshape(-1, 3)
        if not self.turned:
            return self.turns
        by = Rotation.from_rotvec(turns).as_matrix() if len(turns) else np.empty((0, 3, 3))
        return self.turns @ np.concatenate([np.eye(3)[None], by])

    def gaps(self, x: np.ndarray) -> np.ndarray:
        """Between the two rays of each pair, ``(n, 3)``."""
        a, b = (self._rays(x, side)[0] for side in (0, 1))
        return a - b

    def residuals(self, x: np.ndarray, scale: np.ndarray) -> np.ndarray:
        return np.concatenate([(self.gaps(x) * scale[:, None]).ravel(), self.priors @ x])

    def jacobian(self, x: np.ndarray, scale: np.ndarray) -> np.ndarray:
        change = np.zeros((len(self.pairs), 3, self.size))
        for side, sign in ((0, 1.0), (1, -1.0)):
            self._rays(x, side, change, sign)
        return np.concatenate([(change * scale[:, None, None]).reshape(-1, self.size), self.priors])

    def _rays(self, x: np.ndarray, side: int, change: np.ndarray | None = None, sign: float = 1.0):
        """Rays ``(n, 3)`` of one side of the pairs, in the world; their derivatives are added to `change`."""
        moments, owners, pixels = (each[:, side] for each in (self.pairs.moments, self.pairs.lenses, self.pairs.pixels))
        turns = self._turned(x)
        rays = np.empty((len(moments), 3))
        for index, lens in enumerate(self.lenses):
            mine = np.flatnonzero(owners == index)
            part = x[index * PER_LENS : (index + 1) * PER_LENS]
            seen = _seen(lens, part[:OWN], pixels[mine])
            body_R_lens = lens.body_R_lens @ _rotation(part[OWN:])
            world = turns[moments[mine]]
            rays[mine] = np.einsum("nij,nj->ni", world @ body_R_lens, seen)
            if change is None or len(mine) == 0:
                continue
            for k in range(OWN):
                nudged = part[:OWN].copy()
                nudged[k] += STEP
                slope = (_seen(lens, nudged, pixels[mine]) - seen) / STEP
                change[mine, :, index * PER_LENS + k] += sign * np.einsum("nij,nj->ni", world @ body_R_lens, slope)
            tilt = -_crossing(seen) @ _right(part[OWN:])
            columns = slice(index * PER_LENS + OWN, (index + 1) * PER_LENS)
            change[mine, :, columns] += sign * (world @ body_R_lens @ tilt)
            in_body = seen @ body_R_lens.T
            base = PER_LENS * len(self.lenses)
            steps = x[base:].reshape(-1, 3)
            for moment in range(1, len(turns) if self.turned else 0):
                here = moments[mine] == moment
                if here.any():
                    column = base + 3 * (moment - 1)
                    by = -_crossing(in_body[here]) @ _right(steps[moment - 1])
                    change[mine[here], :, column : column + 3] += sign * (turns[moment] @ by)
        return rays, change


def _fisheye(lens: object) -> FisheyeLens:
    assert isinstance(lens, FisheyeLens), "checked by the caller"
    return lens


def _changed(lens: FisheyeLens, part: np.ndarray) -> FisheyeLens:
    x, y = (c + float(d) * lens.radius for c, d in zip(lens.centre, part[:2], strict=True))
    return replace(
        lens,
        centre=(x, y),
        focal=lens.focal * math.exp(part[2]),
        polynomial=tuple(_terms(lens) + part[3:OWN]),
        body_R_lens=lens.body_R_lens @ _rotation(part[OWN:]),
    )


def _terms(lens: FisheyeLens) -> np.ndarray:
    return np.array([*lens.polynomial, *[0.0] * (TERMS - len(lens.polynomial))])


def _seen(lens: FisheyeLens, part: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Rays ``(n, 3)`` in the lens' frame of pixels ``(n, 2)``, with the parameters' first `OWN`."""
    right, down = (pixels - np.array(lens.centre) - part[:2] * lens.radius).T
    radius = np.maximum(np.hypot(right, down), 1e-9)
    angle = inverted((_terms(lens) + part[3:OWN]).tolist(), radius / (lens.focal * math.exp(part[2])), HIGHEST)
    scale = np.sin(angle) / radius
    return np.stack([np.cos(angle), -right * scale, -down * scale], axis=-1)


def _derivatives(lens: FisheyeLens, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of rays in the lens' frame, by its own parameters ``(n, 3, OWN)`` and by its rotation ``(n, 3, 3)``."""
    seen = _seen(lens, np.zeros(OWN), pixels)
    own = [(_seen(lens, STEP * np.eye(OWN)[k], pixels) - seen) / STEP for k in range(OWN)]
    return np.stack(own, axis=-1), -_crossing(seen)


def _rings(lens: FisheyeLens, angles: np.ndarray) -> np.ndarray:
    """Pixels ``(k * SIDES, 2)`` at `angles` off the axis, on all sides."""
    around = np.arange(SIDES) * (2 * math.pi / SIDES)
    angle, around = (each.ravel() for each in np.meshgrid(angles, around, indexing="ij"))
    rays = np.stack([np.cos(angle), np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around)], axis=-1)
    return np.stack(lens.project(rays @ lens.body_R_lens.T)[:2], axis=-1)


def _rotation(vector: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(vector).as_matrix()


def _right(vector: np.ndarray) -> np.ndarray:
    """The right Jacobian ``(3, 3)`` of SO(3): exp(v + d) = exp(v) exp(J d) (J. Sola et al., arXiv 1812.01537, 143)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-6:
        return np.eye(3)
    cross = _crossing(vector[None])[0]
    return np.eye(3) - (1 - math.cos(angle)) / angle**2 * cross + (angle - math.sin(angle)) / angle**3 * cross @ cross


def _crossing(vectors: np.ndarray) -> np.ndarray:
    """Matrices ``(n, 3, 3)`` with ``matrix @ w = vector x w``."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
