"""What a camera's pictures tell of it: the lenses of a dual fisheye camera, how well these agree, how late it stamps.

**Lenses.** The overlap ties them to each other, and fixes their curves there; the inside of the pictures then rests on
the assumption that the lenses are nearly equidistant. If the camera turned in place, the same things pass through all
parts of the lenses, and a whole turn is 360 degrees. Nothing tells how the rig as a whole sits on the body.

**Latency.** A camera that stamps its pictures `latency` seconds late shows at t what odometry told for t - latency: the
shift at which turns about the vertical axis, from picture to picture, have the highest correlation with odometry's. Its
interval is from a moving-block bootstrap (H. Kunsch, Annals of Statistics 17, 1989).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, Slerp

from eagor.cameras import Lens, Rig
from eagor.errors import ImageError, PoseError
from eagor.odometry.features import FIELD, Features, Views, match
from eagor.odometry.two_views import bin_index, estimate_relative_rotation
from eagor.odometry.visual import VisualOdometer
from eagor.sources import Frame, Pose
from eagor.sources.defects import BLACK
from eagor.sources.panorama import checked_picture
from eagor.sources.stitching import Stitcher, sizes_of
from eagor.sphere import world_R_body

__all__ = ["Calibrated", "Latency", "calibrate", "check_turning", "latency_between", "overlap_of", "steps_of"]

FIELDS = np.radians([180, 185, 190, 195, 200, 205, 210, 220])  # of which one is taken to begin with
GATES = np.radians([6.0, 1.5])  # between the rays of a pair, in each round of finding points
STRAY = 0.02  # share of a row or column that is brighter than black beyond the circle at most
FEWEST = 20  # pairs in all; less are no basis
RIM = math.radians(1.5)  # from the rim, where the border of the circle makes points of its own
LEAST_PIXELS, MOST_PIXELS, ROWS = 320, 1024, 2048  # of a view in which points are looked for; of the panorama for it
NEXT = 3  # a moment is compared with so many next ones
FOR_TURNS, MOST = 400, 2000  # pairs that tell a turn, and that are fitted: of more, every second, third, ...

OWN = 10  # parameters of a lens: centre (radii), logarithm of the focal length, polynomial, rotation (radians)
CENTRE, FOCAL, TILT, TURN = 0.03, 0.05, math.radians(3.0), math.radians(90.0)  # prior deviations
CURVE, ALIKE = 0.10, 0.3  # of each term of the polynomial at the rim; share of it by which two lenses of a make differ
# The noise of a pair, per axis: at least what SIFT has on the whole. The centres of two lenses are 3 cm apart: things
# at 3 m are seen half a degree apart. A camera that turns sees them from all sides; at one heading nothing cancels.
FINEST, PARALLAX = math.radians(0.05), math.radians(0.3)
ROUNDS, HEAVY = 4, 2.4  # of estimating the noise; noises at which Cauchy's loss begins to level off

GRID = 0.005  # seconds between the shifts that are tried; the peak is found between them
FEWEST_STEPS, LONGEST = 20, 1.0  # between pictures; seconds between two of them
LEAST_CHANGE = math.radians(3.0)  # per second: by how much the turning rate has to vary to tell anything
LEAST_MATCH = 0.5  # correlation below which the two do not show the same motion
BLOCK, DRAWS = 1.0, 400  # seconds of neighbouring steps that are drawn together, and how often

Sightings = Features  # with moment, lens, x, y (pixels) of each point, ``(n, 4)``, in place of its direction


class Calibrated(NamedTuple):
    """A fitted `rig`, the `pairs` between its lenses, and between moments (0 unless the camera turned).

    `gap`: the median angle between the two rays of a pair, radians; `before`: the same with the rig to begin with.
    """

    rig: Rig
    pairs: tuple[int, int]
    gap: float
    before: float


def calibrate(
    moments: Sequence[Sequence[np.ndarray]],
    *,
    rig: Rig | None = None,
    turned: bool = False,
    on_step: Callable[[], None] = lambda: None,
) -> Calibrated:
    """Fit the lenses to pictures ``(H, W, 3)`` uint8 of two or more `moments`, each one picture, or one per lens.

    `rig`: lenses to begin with; without it, two back to back whose circles are where the pictures show them. `turned`:
    the camera turned in place from each moment to the next. `on_step` is called twice for each moment. Needs OpenCV.
    Raises `ImageError` where the pictures tell too little, with what to do.
    """
    if len(moments) < 2:
        raise ImageError(f"{len(moments)} picture; wanted two or more, with things in the overlap of the lenses")
    start = rig or first_rig(moments)
    start = start.scaled(start.factor_of(sizes_of(moments[0]), "the first picture"))
    if [lens.kind for lens in start.lenses] != ["fisheye"] * 2:
        raise ImageError("the rig has other lenses than two fisheyes; this fits dual fisheye cameras")
    seen = _sightings(start, moments, on_step)
    start = start if rig else _placed(start, seen)
    turns = _chained(start, seen) if turned else None
    fitted, before, x, pairs = start, 0.0, None, np.empty((0, 2, 4))
    for gate in GATES:  # the second time on views that the first fit has straightened
        seen = seen if x is None else _sightings(fitted, moments, on_step)
        pairs = _pairs(fitted, seen, turns, float(gate))
        if len(pairs) < FEWEST:
            where = "between the pictures" if turned else "in the overlap of the lenses"
            raise ImageError(
                f"only {len(pairs)} points were found again {where} of {len(moments)} pictures; wanted {FEWEST}. Give "
                "more pictures, in good light, with things two metres away or farther all around, where lenses overlap"
            )
        before = before or float(np.median(_gaps(start, pairs, turns)))
        fitted, turns, x = _fitted(start, pairs, turns, x)
    within = int((pairs[:, 0, 0] == pairs[:, 1, 0]).sum())
    return Calibrated(fitted, (within, len(pairs) - within), float(np.median(_gaps(fitted, pairs, turns))), before)


def first_rig(moments: Sequence[Sequence[np.ndarray]], fov: float = math.radians(200)) -> Rig:
    """An ideal rig of two lenses back to back, `fov` radians across, whose circles are where these pictures show them.

    Side by side in one picture of each moment, or in two. Raises `ImageError` for others, and for different sizes.
    """
    sizes = {sizes_of(checked_picture(each, "a picture") for each in pictures) for pictures in moments}
    if len(sizes) != 1:
        raise ImageError(f"the pictures have {len(sizes)} different sizes; wanted those of one camera in one mode")
    (size,) = sizes
    (width, height), half = size[0], size[0][0] // 2 if len(size) == 1 else 0
    if len(size) > 2 or (half and not 1.8 <= width / height <= 2.2):
        raise ImageError(
            f"a moment has pictures of {size}; wanted two circles side by side (twice as wide as high), or two "
            "pictures, one for each lens. For another layout, begin with a rig: --rig FILE.yaml"
        )
    lenses = []
    for number, (name, yaw) in enumerate((("front", 0.0), ("back", math.pi))):
        picture, left = (0, number * half) if half else (number, 0)
        brightest = np.max([pictures[picture] for pictures in moments], axis=(0, 3))
        x, y, radius = _circle(brightest[:, left : left + half] if half else brightest)
        pose = world_R_body(yaw)
        lenses.append(Lens.fisheye(name, size[picture], (x + left, y), radius, fov, body_R_lens=pose, picture=picture))
    return Rig(size, tuple(lenses))


def _circle(brightest: np.ndarray) -> tuple[float, float, float]:
    """Centre x, y and radius (pixels) of the bright circle in ``(H, W)``: the brightest that each pixel ever was."""
    lit = brightest > BLACK
    columns, rows = (np.flatnonzero(lit.mean(axis=axis) > STRAY) for axis in (0, 1))
    if not len(columns) or not len(rows):
        columns, rows = map(np.arange, lit.shape[::-1])
    (left, right), (top, bottom) = ((float(each[0]), float(each[-1] + 1)) for each in (columns, rows))
    return (left + right) / 2, (top + bottom) / 2, max(right - left, bottom - top) / 2


def _placed(rig: Rig, seen: Sequence[Sightings]) -> Rig:
    """`rig` with the field that fits best, and its second lens turned as the points say."""
    pairs, best, most = _between_lenses(rig, seen), rig, 0
    for fov in FIELDS:
        lenses = [replace(lens, focal=(lens.radius / (fov / 2),) * 2) for lens in rig.lenses]
        rays = [lens.unproject(*pairs[:, side, 2:].T) for side, lens in enumerate(lenses)]
        turn = estimate_relative_rotation(*rays, moves=False) if len(pairs) else None
        if turn is not None and (count := int(turn.inliers.sum())) > most:
            back = replace(lenses[1], body_R_lens=turn.old_R_new @ lenses[1].body_R_lens)
            best, most = Rig(rig.sizes, (lenses[0], back)), count
    return best


def _chained(rig: Rig, seen: Sequence[Sightings]) -> np.ndarray:
    """Rotations ``(m, 3, 3)`` of the moments, in the axes of the first, each by way of the one before."""
    turns = [np.eye(3)]
    for number, (one, other) in enumerate(pairwise(_deepest(rig, each) for each in seen), 2):
        pairs = _matched(one, other)
        pairs = pairs[:: max(1, math.ceil(len(pairs) / FOR_TURNS))]
        rays = [_rays(rig, pairs[:, side]) for side in (0, 1)]
        turn = estimate_relative_rotation(*rays, moves=False) if len(pairs) else None
        if turn is None:
            raise ImageError(
                f"picture {number} cannot be related to the one before: were they taken at one place, in the order in "
                "which the camera turned, by at most 60 degrees each? Leave it out, or give more"
            )
        turns.append(turns[-1] @ turn.old_R_new)
    return np.stack(turns)


def _sightings(rig: Rig, moments: Sequence[Sequence[np.ndarray]], on_step: Callable[[], None]) -> list[Sightings]:
    """What the lenses see of each moment, found on views that are straight as far as `rig` knows."""
    stitcher, found = Stitcher(rig, min(ROWS, rig.rows)), []
    size = max(LEAST_PIXELS, min(MOST_PIXELS, round(2 * math.tan(FIELD / 2) * stitcher.grid.height / math.pi)))
    for moment, pictures in enumerate(moments):
        points, descriptors = [], []
        for index, lens in enumerate(rig.lenses):
            features = Views.of(stitcher.alone(index, *pictures)[0], size=size).features
            x, y, depth = lens.project(features.directions)
            own = np.stack([np.full(len(x), moment), np.full(len(x), index), x, y], axis=1)
            points, descriptors = [*points, own[depth > RIM]], [*descriptors, features.descriptors[depth > RIM]]
        found.append(Sightings(np.concatenate(points), np.concatenate(descriptors)))
        on_step()
    return found


def _matched(one: Sightings, other: Sightings) -> np.ndarray:
    """Points that look alike, ``(m, 2, 4)``."""
    first, second = match(one, other)
    return np.stack([one.directions[first], other.directions[second]], axis=1)


def _deepest(rig: Rig, seen: Sightings) -> Sightings:
    """The points of a moment, each thing by the lens that sees it deepest: twins would fail the ratio test."""
    depths = np.array([lens.project(_rays(rig, seen.directions))[2] for lens in rig.lenses])
    return seen[depths.argmax(axis=0) == seen.directions[:, 1]]


def _between_lenses(rig: Rig, seen: Sequence[Sightings]) -> np.ndarray:
    """What two lenses see at the same moment, ``(n, 2, 4)``."""
    alone = [[each[each.directions[:, 1] == index] for index in range(len(rig.lenses))] for each in seen]
    return np.concatenate([_matched(*two) for each in alone for two in combinations(each, 2)] or [np.empty((0, 2, 4))])


def _pairs(rig: Rig, seen: Sequence[Sightings], turns: np.ndarray | None, gate: float) -> np.ndarray:
    """Sightings of one thing, ``(n, 2, 4)``, whose rays are less than `gate` (radians) apart.

    By two lenses at each moment, and if the camera turned in place by these `turns`, at two moments.
    """
    pairs, n = [_between_lenses(rig, seen)], len(seen)
    if turns is not None:
        joined = [_deepest(rig, each) for each in seen]
        pairs += [_matched(joined[i], joined[j]) for i, j in combinations(range(n), 2) if min(j - i, n - j + i) <= NEXT]
    found = np.concatenate(pairs)
    return found[_gaps(rig, found, turns) < gate]


def _rays(rig: Rig, points: np.ndarray, turns: np.ndarray | None = None) -> np.ndarray:
    """Where points ``(n, 4)`` are seen, ``(n, 3)``; in the world, by a camera with rotations ``(m, 3, 3)``."""
    rays = np.empty((len(points), 3))
    for index, lens in enumerate(rig.lenses):
        own = points[:, 1] == index
        rays[own] = lens.unproject(*points[own, 2:].T)
    return rays if turns is None else np.einsum("nij,nj->ni", turns[points[:, 0].astype(int)], rays)


def _gaps(rig: Rig, pairs: np.ndarray, turns: np.ndarray | None) -> np.ndarray:
    """The angle between the two rays of each pair, radians ``(n,)``."""
    return np.linalg.norm(_rays(rig, pairs[:, 0], turns) - _rays(rig, pairs[:, 1], turns), axis=1)


def _fitted(
    start: Rig, pairs: np.ndarray, turns: np.ndarray | None, before: np.ndarray | None
) -> tuple[Rig, np.ndarray | None, np.ndarray]:
    """The most likely lenses near those of `start` that make the rays of `pairs` meet, and the camera's turns.

    The third are the differences from the start: of each lens, then the rotations of the moments but the first;
    `before`: those of the fit before. There is one independent point in each part of a lens and moment: neighbours
    share their errors.
    """
    used, own = pairs[:: max(1, math.ceil(len(pairs) / MOST))], OWN * len(start.lenses)
    moments = 1 if turns is None else len(turns)
    size = own + 3 * (moments - 1)
    curves = [CURVE / lens.reach ** (2 * np.arange(1, 5)) for lens in start.lenses]
    priors = [(CENTRE, CENTRE, FOCAL, *curve, TILT, TILT, TILT) for curve in curves]
    deviations = np.concatenate([*priors, np.full(size - own, TURN)])
    parts = np.unique(bin_index(_rays(start, used.reshape(-1, 4)))).size * len(start.lenses)
    share = min(1.0, parts * moments / len(used))

    def at(x: np.ndarray) -> tuple[Rig, np.ndarray | None]:
        """Lenses and rotations ``(m, 3, 3)`` of the moments."""
        lenses = []
        for part, lens in zip(x[:own].reshape(-1, OWN), start.lenses, strict=True):
            terms = np.pad(lens.distortion, (0, 8 - len(lens.distortion))) + np.pad(part[3:7], (0, 4))
            centre = (lens.centre[0] + part[0] * lens.radius, lens.centre[1] + part[1] * lens.radius)
            focal = (lens.focal[0] * math.exp(part[2]), lens.focal[1] * math.exp(part[2]))
            pose = lens.body_R_lens @ Rotation.from_rotvec(part[7:]).as_matrix()
            lenses.append(replace(lens, centre=centre, focal=focal, distortion=tuple(terms), body_R_lens=pose))
        steps = Rotation.from_rotvec(np.concatenate([np.zeros(3), x[own:]]).reshape(-1, 3))
        return Rig(start.sizes, tuple(lenses)), None if turns is None else turns @ steps.as_matrix()

    def residuals(x: np.ndarray, scale: np.ndarray) -> np.ndarray:
        rig, rotations = at(x)
        apart = _rays(rig, used[:, 0], rotations) - _rays(rig, used[:, 1], rotations)
        alike = (x[2:7] - x[OWN + 2 : OWN + 7]) / (ALIKE * deviations[2:7])  # the lenses' curves
        return np.concatenate([(apart * scale[:, None]).ravel(), x / deviations, alike])

    x = np.zeros(size)
    if before is not None:
        x[:own] = before[:own]
    for _ in range(ROUNDS):  # weights of Cauchy's law for the pairs; priors are Gaussian
        gaps = _gaps(at(x)[0], used, at(x)[1])
        noise = max(PARALLAX if turns is None else FINEST, float(np.median(gaps)) / math.sqrt(2 * math.log(2)))
        scale = np.sqrt(share / (1 + (gaps / (HEAVY * noise)) ** 2)) / noise
        x = least_squares(residuals, x, args=(scale,), max_nfev=8, x_scale=deviations).x
    return *at(x), x


def overlap_of(rig: Rig, pictures: Sequence[np.ndarray]) -> tuple[float, np.ndarray, float | None, np.ndarray]:
    """How well the lenses agree in the `pictures` ``(H, W, 3)`` uint8 of one moment. Needs OpenCV. Raises `ImageError`.

    The share of the sphere that two lenses see; the angles ``(n,)`` between the rays of things that both see, radians;
    the mean difference in grey levels (of 255), None if nothing overlaps; and a picture ``(2 rows, 2 rows, 3)`` uint8:
    the panorama, and below it the difference, from black (none) to white (64 or more), blue where one lens sees alone.
    """
    stitcher = Stitcher(rig.scaled(rig.factor_of(sizes_of(pictures), "the picture")))
    rig, weights = stitcher.rig, stitcher.grid.weights
    shown, below = stitcher.stitch(*pictures), np.full((*stitcher.grid.shape, 3), (12, 16, 40), np.uint8)
    views = [stitcher.alone(index, *pictures) for index in range(len(rig.lenses))]
    difference, seen = np.zeros(stitcher.grid.shape), np.zeros(stitcher.grid.shape, bool)
    for (a, sees_a), (b, sees_b) in combinations(views, 2):
        both = sees_a & sees_b
        difference[both] = np.abs(a[both].mean(axis=1) - b[both].mean(axis=1))
        seen |= both
    below[seen] = np.clip(4 * difference[seen], 0, 255).astype(np.uint8)[:, None]
    area = float(weights[seen].sum())
    grey = float((difference * weights)[seen].sum()) / area if area else None
    pairs = _pairs(rig, _sightings(rig, [pictures], lambda: None), None, float(GATES[0]))
    return area / (4 * math.pi), _gaps(rig, pairs, None), grey, np.concatenate([shown, below])


class Latency(NamedTuple):
    """`seconds` from capture to stamp, the `interval` that holds it with 95 %, the `correlation` of so many `steps`."""

    seconds: float
    interval: tuple[float, float]
    correlation: float
    steps: int


def steps_of(frames: Iterable[Frame]) -> np.ndarray:
    """How a camera turned from picture to picture: start, end (seconds), turn to the left about body z (radians).

    ``(n, 3)``, from its pictures; where it got lost, there is no step.
    """
    odometer, before, rows = VisualOdometer(), None, []
    for frame in (each for each in frames if each.picture is not None):
        turned = odometer.add(frame.picture)
        if before is not None and not turned.lost and turned.matches and frame.stamp - before[0] <= LONGEST:
            turn = Rotation.from_matrix(before[1].T @ turned.world_R_body).as_rotvec()
            rows.append((before[0], frame.stamp, float(turn[2])))
        before = frame.stamp, turned.world_R_body
    return np.array(rows).reshape(-1, 3)


def latency_between(steps: np.ndarray, poses: Sequence[Pose], *, most: float = 1.0, seed: int = 0) -> Latency:
    """The latency of `steps` (`steps_of`) against `poses` in order of time, from -`most` to `most` seconds.

    Negative: odometry is the later one. Raises `PoseError` where the motion does not tell it: too few steps that both
    cover, too little change of the turning rate, no correlation, or a peak at the end of what is searched.
    """
    slerp = check_turning(poses)
    first, last = poses[0].stamp, poses[-1].stamp
    start, end, turned = steps[(steps[:, 0] - most >= first) & (steps[:, 1] + most <= last)].T
    n = len(start)
    if n < FEWEST_STEPS:
        span = f"{steps[0, 0]:.2f} to {steps[-1, 1]:.2f} s" if len(steps) else "none that could be compared"
        raise PoseError(
            f"{n} steps between pictures lie within the odometry, {most:g} s off its ends; wanted {FEWEST_STEPS}. "
            f"Pictures: {span}; odometry: {first:.2f} to {last:.2f} s. Shift one to the other's clock, or record longer"
        )
    shifts = np.arange(-most, most + GRID / 2, GRID)
    rates = np.stack([_turned(slerp, start - shift, end - shift) for shift in shifts]) / (end - start)  # (shifts, n)
    seen = turned / (end - start)
    values = _correlation(rates, seen)
    at = int(values.argmax())
    opposite = -values.min() > values.max() + 0.2
    if opposite or values[at] < LEAST_MATCH:
        raise PoseError(
            f"pictures and odometry {'turn the other way' if opposite else 'do not agree'} at any shift up to {most:g} "
            f"s (highest correlation {values[at]:.2f}; wanted {LEAST_MATCH:g}). Are they of one time and body, or "
            "mirrored, or is the shift larger (--most SECONDS)?"
        )
    if at in (0, len(shifts) - 1):
        raise PoseError(f"the best shift is the last one, {shifts[at]:+.2f} s; search farther: --most {2 * most:g}")
    random, peaks = np.random.default_rng(seed), []
    block = min(max(1, round(BLOCK / float(np.median(end - start)))), max(1, n // 4))
    for _ in range(DRAWS):
        begins = random.integers(0, n - block + 1, math.ceil(n / block))
        drawn = (begins[:, None] + np.arange(block)).ravel()[:n]
        peaks.append(_peak(shifts, _correlation(rates[:, drawn], seen[drawn])))
    low, high = map(float, np.quantile(peaks, [0.025, 0.975]))
    return Latency(_peak(shifts, values), (low, high), float(values[at]), n)


def check_turning(poses: Sequence[Pose]) -> Slerp:
    """The orientations in between. Raises `PoseError` if these turn too evenly to tell a latency."""
    if len(poses) < 2:
        raise PoseError(f"odometry has {len(poses)} poses; wanted those of the time in which the pictures were taken")
    stamps = [pose.stamp for pose in poses]
    slerp = Slerp(stamps, Rotation.from_matrix(np.stack([pose.world_R_body for pose in poses])))
    ticks = np.linspace(stamps[0], stamps[-1], max(2, math.ceil((stamps[-1] - stamps[0]) / 0.1)))
    change = float(np.std(_turned(slerp, ticks[:-1], ticks[1:]) / np.diff(ticks)))
    if change < LEAST_CHANGE:
        rates = f"by {math.degrees(change):.1f} degrees per second; wanted {math.degrees(LEAST_CHANGE):g} or more"
        raise PoseError(f"the turning rate varies {rates}. Turn the camera left and right, briskly, for half a minute")
    return slerp


def _turned(slerp: Slerp, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """How far odometry turned about body z between these times, radians ``(n,)``."""
    return (slerp(start).inv() * slerp(end)).as_rotvec()[:, 2]


def _correlation(rates: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Pearson's, of each row of `rates` ``(s, n)`` with `seen` ``(n,)``."""
    rates, seen = rates - rates.mean(axis=1, keepdims=True), seen - seen.mean()
    return (rates @ seen) / np.maximum(np.linalg.norm(rates, axis=1) * np.linalg.norm(seen), 1e-12)


def _peak(shifts: np.ndarray, values: np.ndarray) -> float:
    """Where the parabola through the highest value and its neighbours is highest."""
    at = min(max(int(values.argmax()), 1), len(shifts) - 2)
    a, b, c = values[at - 1 : at + 2]
    bend = a - 2 * b + c
    return float(shifts[at] + (GRID * 0.5 * (a - c) / bend if bend < -1e-12 else 0.0))
