"""Fit the lenses of a dual fisheye camera from its pictures: `calibrate`.

What both lenses see at once, the overlap, ties them to each other, and fixes their curves there. It tells nothing about
the inside of the pictures: that part then rests on the assumption that the lenses are nearly equidistant. Pictures of a
camera that turned in place (`turned`) fix all of it, since the same things pass through all parts of the lenses, and
a whole turn is 360 degrees. `Calibrated.spread` says how sure each part is.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eagor.errors import ImageError
from eagor.lenses import FisheyeLens
from eagor.media.cameras.circles import first_rig
from eagor.media.cameras.fitting import gaps_of, solve
from eagor.media.cameras.rig import Rig
from eagor.media.cameras.sightings import Pairs, Points, pairs_of, points_of, turns_of
from eagor.media.consensus import agreeing_rotation
from eagor.media.features import Features, match
from eagor.media.two_views import Turn, turn_between

__all__ = ["Calibrated", "calibrate"]

FIELDS = tuple(math.radians(degrees) for degrees in (180, 185, 190, 195, 200, 205, 210, 220))  # tried at first
ROUNDS = 2  # of finding points: the second time on views that the first fit has straightened
GATES = (math.radians(6.0), math.radians(1.5))  # between the rays of a pair, in each round
FEWEST = 20  # pairs between the lenses, in all; less are no basis


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
    sizes = tuple((picture.shape[1], picture.shape[0]) for picture in moments[0])
    rig = rig.scaled(rig.factor_of(sizes, "the first picture"))
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
        agreed = agreeing_rotation(rays[0], rays[1], np.random.default_rng(0)) if len(a) else None
        if agreed is not None and agreed.log_chance < least:
            best, least = (tried, rays), agreed.log_chance
    if best is None:
        return rig
    tried, rays = best
    turn = turn_between(rays[0], rays[1], moves=False)
    if turn is None:
        return rig
    second = replace(tried.lenses[1], body_R_lens=turn.old_R_new @ tried.lenses[1].body_R_lens)
    return Rig(tried.sizes, (tried.lenses[0], second))


def _with_field(rig: Rig, fov: float) -> Rig:
    lenses = tuple(replace(lens, focal=lens.radius / (fov / 2)) for lens in rig.lenses)  # type: ignore[call-arg]
    return Rig(rig.sizes, lenses)


def _chained(turns: dict[tuple[int, int], Turn], count: int) -> tuple[np.ndarray, np.ndarray]:
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
