"""Fit the lenses of a dual fisheye camera from its pictures: `calibrate`; and how well lenses agree: `overlap_of`.

What both lenses see at once, the overlap, ties them to each other, and fixes their curves there. It tells nothing about
the inside of the pictures: that part then rests on the assumption that the lenses are nearly equidistant. Pictures of a
camera that turned in place (`turned`) fix all of it, since the same things pass through all parts of the lenses, and
a whole turn is 360 degrees. `Calibrated.spread` says how sure each part is. The start, `first_rig`, is where the black
surroundings of the circles tell that they are.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from eagor.errors import ImageError
from eagor.lenses import FisheyeLens
from eagor.media.defects import BLACK
from eagor.media.lens_fitting import Pairs, Points, gaps_of, pairs_of, points_of, solve, turns_of
from eagor.media.panorama import checked_picture
from eagor.media.rigs import Rig, sizes_of
from eagor.media.stitching import Stitcher
from eagor.odometry.features import Features, match
from eagor.odometry.two_views import RelativeRotation, estimate_relative_rotation
from eagor.sphere import world_R_body

__all__ = ["Calibrated", "Overlap", "calibrate", "first_rig", "overlap_of", "with_seam"]

FIELDS = tuple(math.radians(degrees) for degrees in (180, 185, 190, 195, 200, 205, 210, 220))  # tried at first
ROUNDS = 2  # of finding points: the second time on views that the first fit has straightened
GATES = (math.radians(6.0), math.radians(1.5))  # between the rays of a pair, in each round
FEWEST = 20  # pairs between the lenses, in all; less are no basis

RAYS = 256  # directions from the middle in which the rim is looked for
FEWEST_RAYS = 24  # of them that have to meet a rim within the picture; with fewer, the circle fills the picture
AWAY = 2.0  # pixels from the picture's border at which a rim counts
OFF = 0.02  # share of the radius by which a point of the rim may be off the circle: dark places touch the rim

GATE = math.radians(6.0)  # between the two rays of a thing; farther apart, it is probably two things
COLOURS = ((60, 200, 255), (255, 170, 40), (140, 255, 120), (255, 110, 220))  # of the lenses' rims
LINE = 1 / 400  # of the picture's rows: width of a rim


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A fitted `rig` and how well it fits.

    `pairs` between the lenses, and between moments (0 unless the camera turned); `gap`: the median angle between the
    two rays of a pair, radians; `before`: the same with the rig to begin with. `angles` ``(k,)`` off the axis, and
    `spreads` for each lens ``(k,)``: the standard deviation of directions there, radians (`Solution.spread`). `used`:
    how many of the moments tell something.
    """

    rig: Rig
    pairs: tuple[int, int]
    gap: float
    before: float
    angles: np.ndarray
    spreads: tuple[np.ndarray, ...]
    used: int

    @property
    def worst(self) -> float:
        """The largest of the spreads, radians."""
        return float(max(each.max() for each in self.spreads))


def calibrate(
    moments: Sequence[Sequence[np.ndarray]],
    *,
    rig: Rig | None = None,
    fov: float | None = None,
    turned: bool = False,
    on_step: Callable[[], None] = lambda: None,
) -> Calibrated:
    """Fit the lenses to pictures ``(H, W, 3)`` uint8 of two or more `moments`, each one picture, or one per lens.

    `rig`: lenses to begin with; without it, two back to back whose circles are where the pictures show them, with `fov`
    radians across (None: what fits best). `turned`: the camera turned in place between the moments. `on_step` is called
    `ROUNDS` times for each moment. Needs OpenCV. Raises `ImageError` where the pictures tell too little, with what to
    do.
    """
    if len(moments) < 2:
        raise ImageError(f"{len(moments)} picture; wanted two or more, with things in the overlap of the lenses")
    given = rig is not None
    rig = rig or first_rig(moments, fov or math.radians(200))
    rig = rig.scaled(rig.factor_of(sizes_of(moments[0]), "the first picture"))
    if not all(isinstance(lens, FisheyeLens) for lens in rig.lenses) or len(rig.lenses) != 2:
        raise ImageError("the rig has other lenses than two fisheyes; this fits dual fisheye cameras")
    current, solution, before = rig, None, 0.0
    rotations, used = np.eye(3)[None].repeat(len(moments), axis=0), np.arange(len(moments))
    for round_ in range(ROUNDS):
        points = points_of(current, moments, on_step)
        if round_ == 0 and not given:
            rig = current = _placed(rig, points, fov is None)
        if round_ == 0 and turned:
            rotations, used = _chained(turns_of(rig, points), len(moments))
        points = _of(points, used)
        pairs = pairs_of(current, points, rotations, GATES[round_], turned)
        _check(pairs, turned, len(moments))
        if solution is None:
            before = float(np.median(gaps_of(rig, pairs, rotations)))
        solution = solve(rig, pairs, rotations, solution and solution.parameters, turned)
        current, rotations = solution.rig, solution.world_R_body
    assert solution is not None
    angles = np.linspace(0, min(lens.reach for lens in solution.rig.lenses), 7)
    spreads = tuple(solution.spread(index, angles) for index in range(len(rig.lenses)))
    return Calibrated(
        solution.rig, solution.counts, float(np.median(solution.gaps)), before, angles, spreads, len(used)
    )


def _placed(rig: Rig, points: Sequence[Points], any_field: bool) -> Rig:
    """`rig` with its second lens turned as the points say, and with the field that fits best if `any_field`."""
    own = [[each for each in points if each.lens == lens] for lens in (0, 1)]
    pixels: list[tuple[np.ndarray, np.ndarray]] = []
    for a, b in zip(*own, strict=True):
        here, there = (Features(np.empty((len(each.pixels), 3)), each.descriptors) for each in (a, b))
        first, second = match(here, there)
        pixels.append((a.pixels[first], b.pixels[second]))
    a, b = (np.concatenate([pair[side] for pair in pixels]) for side in (0, 1))
    best, least = None, 0.0
    for fov in FIELDS if any_field else (None,):
        tried = rig if fov is None else _with_field(rig, fov)
        rays = [lens.unproject(*at.T) for lens, at in zip(tried.lenses, (a, b), strict=True)]
        agreed = estimate_relative_rotation(rays[0], rays[1], moves=False) if len(a) else None
        if agreed is not None and agreed.log_nfa < least:
            best, least = (tried, rays), agreed.log_nfa
    if best is None:
        return rig
    tried, rays = best
    turn = estimate_relative_rotation(rays[0], rays[1], moves=False)
    if turn is None:
        return rig
    second = replace(tried.lenses[1], body_R_lens=turn.old_R_new @ tried.lenses[1].body_R_lens)
    return Rig(tried.sizes, (tried.lenses[0], second))


def _with_field(rig: Rig, fov: float) -> Rig:
    lenses = tuple(replace(lens, focal=lens.radius / (fov / 2)) for lens in rig.lenses)  # type: ignore[call-arg]
    return Rig(rig.sizes, lenses)


def _chained(turns: dict[tuple[int, int], RelativeRotation], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotations ``(m, 3, 3)`` of the moments, in the axes of the first, and which they are, ``(m,)``.

    Each by way of the turns with the most pairs (a maximum spanning tree, grown from the moment with the most).
    Moments that nothing connects are left out, with a warning.
    """
    sure = {pair: int(turn.inliers.sum()) for pair, turn in turns.items()}
    weight = [sum(n for pair, n in sure.items() if k in pair) for k in range(count)]
    begin = int(np.argmax(weight))
    found = {begin: np.eye(3)}
    while True:
        open_ = {pair: n for pair, n in sure.items() if (pair[0] in found) != (pair[1] in found)}
        if not open_:
            break
        i, j = max(open_, key=lambda pair: open_[pair])
        if i in found:
            found[j] = found[i] @ turns[i, j].old_R_new
        else:
            found[i] = found[j] @ turns[i, j].old_R_new.T
    used = np.array(sorted(found))
    if len(used) < count:
        lost = [str(k + 1) for k in range(count) if k not in found]
        warnings.warn(
            f"of {count} pictures, number {', '.join(lost)} cannot be related to the others, and are left out: were "
            "they taken at the same place?",
            UserWarning,
            stacklevel=3,
        )
    first = found[int(used[0])].T
    return np.stack([first @ found[int(k)] for k in used]), used


def _of(points: Sequence[Points], used: np.ndarray) -> list[Points]:
    """The points of the moments `used`, numbered in this order."""
    place = {int(moment): index for index, moment in enumerate(used)}
    return [replace(each, moment=place[each.moment]) for each in points if each.moment in place]


def _check(pairs: Pairs, turned: bool, count: int) -> None:
    """Raise `ImageError` if there are too few pairs to fit anything."""
    if len(pairs) >= FEWEST:
        return
    where = "between the pictures" if turned else "in the overlap of the lenses"
    raise ImageError(
        f"only {len(pairs)} points were found again {where} of {count} pictures; wanted {FEWEST} or more. Give more "
        "pictures, with things two metres away or farther in all directions, in good light. If the field of the lenses "
        "is known, say so (--field DEG); if they do not overlap, nothing can be fitted"
    )


# --- a start: where the circles are ---


def first_rig(moments: Sequence[Sequence[np.ndarray]], fov: float) -> Rig:
    """An ideal rig of two lenses back to back whose circles are where these pictures show them.

    `moments`: for each moment its picture ``(H, W, 3)`` with both circles side by side, or two pictures, one per lens.
    `fov`: the angle across a circle, radians. Raises `ImageError` unless all have the same size, and one or two
    pictures each.
    """
    sizes = {tuple(checked_picture(p, "a picture").shape[1::-1] for p in pictures) for pictures in moments}
    if len(sizes) != 1:
        raise ImageError(
            f"the pictures have {len(sizes)} different sizes; wanted those of one camera in one mode, all alike"
        )
    (size,) = sizes
    brightest = [np.max([pictures[k] for pictures in moments], axis=(0, 3)) for k in range(len(size))]
    if len(size) == 1:
        width, height = size[0]
        if not 1.8 <= width / height <= 2.2:
            raise ImageError(
                f"the pictures are {width} x {height}; wanted two circles side by side (twice as wide as high), or two "
                "pictures per moment, one for each lens. For another layout, begin with a rig: --rig FILE.yaml"
            )
        half = width // 2
        found = [_circle(brightest[0][:, :half]), _circle(brightest[0][:, half:])]
        places = [(0, 0.0), (0, float(half))]
    elif len(size) == 2:
        found = [_circle(each) for each in brightest]
        places = [(0, 0.0), (1, 0.0)]
    else:
        raise ImageError(
            f"a moment has {len(size)} pictures; wanted one with both circles, or one for each of 2 lenses"
        )
    lenses = []
    for name, yaw, (picture, left), (x, y, radius) in zip(
        ("front", "back"), (0.0, math.pi), places, found, strict=True
    ):
        lens = FisheyeLens.of_field(name, (x + left, y), radius, fov, body_R_lens=world_R_body(yaw), picture=picture)
        lenses.append(lens)
    return Rig(tuple(size), tuple(lenses))


def _circle(brightest: np.ndarray) -> tuple[float, float, float]:
    """Centre x, y and radius (pixels) of the bright circle in ``(H, W)``: the brightest that each pixel ever was."""
    height, width = brightest.shape
    lit = brightest > BLACK
    default = (width / 2, height / 2, min(width, height) / 2)
    if not lit.any():
        return default
    y, x = np.nonzero(lit)
    middle = np.array([np.median(x) + 0.5, np.median(y) + 0.5])
    points = []
    steps = np.arange(0.0, math.hypot(width, height), 0.5)
    for angle in np.linspace(0, 2 * math.pi, RAYS, endpoint=False):
        along = middle + steps[:, None] * (math.cos(angle), math.sin(angle))
        inside = (along >= AWAY).all(axis=1) & (along[:, 0] <= width - AWAY) & (along[:, 1] <= height - AWAY)
        along = along[: int(inside.argmin())] if not inside.all() else along
        bright = lit[along[:, 1].astype(int), along[:, 0].astype(int)]
        last = int(np.flatnonzero(bright)[-1]) if bright.any() else 0
        if 0 < last < len(along) - 2:
            points.append(along[last])
    return _fitted(np.array(points), default) if len(points) >= FEWEST_RAYS else default


def _fitted(points: np.ndarray, default: tuple[float, float, float]) -> tuple[float, float, float]:
    """The circle through most of `points` ``(n, 2)``: least squares (I. Kasa, 1976), without those that are off."""
    kept = points
    centre, radius = np.array(default[:2]), default[2]
    for _ in range(8):
        if len(kept) < FEWEST_RAYS:
            return default
        matrix = np.column_stack([2 * kept, np.ones(len(kept))])
        solution = np.linalg.lstsq(matrix, (kept**2).sum(axis=1), rcond=None)[0]
        centre, radius = solution[:2], math.sqrt(max(float(solution[2] + solution[:2] @ solution[:2]), 1.0))
        off = np.abs(np.linalg.norm(points - centre, axis=1) - radius)
        # What is dark at the rim lies inside: a limit that shrinks leaves those out.
        kept = points[off <= max(OFF * radius, float(np.quantile(off, 0.8)))]
    return float(centre[0]), float(centre[1]), radius


# --- how well lenses agree ---


@dataclass(frozen=True, eq=False)
class Overlap:
    """The error where lenses overlap.

    `share` of the sphere that two lenses see. `gaps` ``(n,)``: angles between the rays of things that both see,
    radians. `grey`: the mean difference in grey levels (of 255); None if nothing overlaps.
    """

    share: float
    gaps: np.ndarray
    grey: float | None


def overlap_of(rig: Rig, pictures: Sequence[np.ndarray], rows: int | None = None) -> Overlap:
    """Measure it in the `pictures` ``(H, W, 3)`` uint8 of one moment. Needs OpenCV. Raises `ImageError`."""
    rig, stitcher, views = _apart(rig, pictures, rows)
    total, levels = 0.0, 0.0
    weights = stitcher.grid.weights
    seen_twice = np.sum([seen for _, seen in views], axis=0) > 1
    for (a, sees_a), (b, sees_b) in combinations(views, 2):
        both = sees_a & sees_b
        difference = np.abs(a[both].astype(np.float64).mean(axis=1) - b[both].astype(np.float64).mean(axis=1))
        levels += float(difference @ weights[both])
        total += float(weights[both].sum())
    area = float(weights[seen_twice].sum()) / (4 * math.pi)
    if len(rig.lenses) < 2:
        return Overlap(0.0, np.empty(0), None)
    pairs = pairs_of(rig, points_of(rig, [tuple(pictures)], lambda: None), np.eye(3)[None], GATE, turned=False)
    rays = np.empty((len(pairs), 2, 3))
    for index, lens in enumerate(rig.lenses):
        for side in (0, 1):
            mine = pairs.lenses[:, side] == index
            rays[mine, side] = lens.unproject(*pairs.pixels[mine, side].T)
    gaps = np.linalg.norm(rays[:, 0] - rays[:, 1], axis=1)
    return Overlap(area, gaps, levels / total if total else None)


def with_seam(rig: Rig, pictures: Sequence[np.ndarray], rows: int | None = None) -> np.ndarray:
    """The stitched panorama over a map of the lenses' difference, ``(2 rows, 2 rows, 3)`` uint8.

    Above, each lens' rim is drawn in its colour: between two rims both see the same. Below, the difference of the
    lenses in grey levels, from black (none) to white (64 or more); what one lens alone sees is dark blue.
    """
    rig, stitcher, views = _apart(rig, pictures, rows)
    shown = stitcher.stitch(*pictures)
    below = np.zeros_like(shown)
    below[:] = (12, 16, 40)
    for (a, sees_a), (b, sees_b) in combinations(views, 2):
        both = sees_a & sees_b
        difference = np.abs(a[both].astype(np.int16).mean(axis=1) - b[both].astype(np.int16).mean(axis=1))
        below[both] = np.clip(4 * difference, 0, 255).astype(np.uint8)[:, None]
    width = max(1, round(LINE * shown.shape[0]))
    for index, (_, seen) in enumerate(views):
        shown[_border(seen, width)] = COLOURS[index % len(COLOURS)]
    return np.concatenate([shown, below])


def _apart(
    rig: Rig, pictures: Sequence[np.ndarray], rows: int | None
) -> tuple[Rig, Stitcher, list[tuple[np.ndarray, np.ndarray]]]:
    """The rig in the size of the pictures, its stitcher, and what each lens sees of a panorama, and where."""
    rig = rig.scaled(rig.factor_of(sizes_of(pictures), "the picture"))
    stitcher = Stitcher(rig, rows)
    return rig, stitcher, [stitcher.alone(index, *pictures) for index in range(len(rig.lenses))]


def _border(seen: np.ndarray, width: int) -> np.ndarray:
    """The inner border of a region of a panorama, so many pixels wide; around the seam too."""
    from scipy import ndimage

    tiled = np.pad(seen, ((1 + width, 1 + width), (0, 0)), mode="edge")
    tiled = np.pad(tiled, ((0, 0), (1 + width, 1 + width)), mode="wrap")
    inner = ndimage.binary_erosion(tiled, np.ones((3, 3), bool), iterations=width)
    crop = slice(1 + width, -1 - width)
    return seen & np.logical_not(inner[crop, crop])
