"""Places on the floor from what one camera sees, and answers from these places: as they are, or rounded to cells.

"Standing by P and facing O, where is Q?" needs ranges, not directions alone. On a level floor they come from contact
points: a camera at height h that sees one at elevation e (negative) is h / tan(-e) away from it. The answers do not
depend on h, which scales the whole room, as long as all ranges come from contact points.

A thing without floor contact stands on another thing, or hangs on a wall, and takes the range from that.

The labels of OSR-Bench derive from layouts of whole cells, so rounding decides near the border between two answers.
Even with all places known exactly, 19 of 20 published answers (left and right corrected) would be met. So the rounding
is modelled: layouts are drawn along the walls in each of the four orientations (any orientation if no wall is known),
with uncertain places drawn anew each time. The most frequent label is the answer, its share the probability
(`LayoutSamples`).

Frame: the camera's body, x forward, y left, z up; metres on the floor, the camera above the origin; angles in radians.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from eagor.errors import DirectionError
from eagor.lab.tasks.osr.scoring import SIZE, named, products, swapped
from eagor.sphere import azimuth_elevation, direction, wrap

Source = Literal["depth", "contact", "support", "wall", "height", "beyond", "guess"]
SURE: tuple[Source, ...] = ("depth", "contact", "support", "wall")
FARTHEST = 20.0  # metres: beyond, contact points are too near the horizon to give a range
SLACK = 0.25  # tolerance, as a share, for a thing that seems to stand beyond the rims of its support
# Things that hang on a wall or are part of it, in the words of the benchmark and of our apartments.
HANGING = frozenset(
    "window picture painting mirror curtain blinds whiteboard clock switch vent wall_light".split()  # noqa: SIM905
)
MIDDLE = 0.45  # metres above the floor: assumed middle of a standing thing without a visible contact
OUTSIDE = 1.15  # a contact this many times as far away as the wall behind it is rejected
MARGIN = 0.3  # metres from the middle of a thing at a wall to the wall
GUESS = 3.0  # metres, if there is no other range
WIDEST = math.radians(60)  # half width of things so near that their outline no longer gives their depth
DEPTH, DEEPEST = 0.85, 0.4  # a thing's half depth: this share of its half width, and at most this many metres
RECESS = {"window": 0.1}  # metres by which the middle of a thing lies behind the face of the wall
# Standard deviation of a range: metres, by what it was taken from, and the share of the range for outlines.
SPREAD = {"depth": 0.1, "contact": 0.0, "support": 0.15, "wall": 0.05, "height": 0.6, "beyond": 0.4, "guess": 1.5}
OUTLINE_SPREAD, OUTLINE_SHARE = 0.15, 0.05
DRAWS = 16  # for each of the four orientations


@dataclass(frozen=True)
class Detection:
    """One thing as seen: its category, and the azimuth and elevation of its middle.

    - `bottom`, `top`: elevations of its lowest and highest edge; `half_width`: half of its angular width.
    - `foot`: the elevation at which its middle meets the floor, if known better than `bottom`.
    - `contact`: whether its lowest edge touches the floor. `depth`: metres along the ray to its middle.
    - `weight`: its strength of belief, relative to others.
    """

    name: str
    azimuth: float
    elevation: float
    bottom: float | None = None
    top: float | None = None
    half_width: float = 0.0
    foot: float | None = None
    contact: bool = True
    depth: float | None = None
    weight: float = 1.0

    @classmethod
    def at(cls, name: str, where: np.ndarray, **rest: object) -> Detection:
        """The detection of a thing in the direction `where` ``(3,)``."""
        azimuth, elevation = azimuth_elevation(np.asarray(where, dtype=np.float64))
        return cls(name, float(azimuth), float(elevation), **rest)  # type: ignore[arg-type]

    @property
    def direction(self) -> np.ndarray:
        """Unit vector ``(3,)`` to its middle."""
        return np.asarray(direction(np.float64(self.azimuth), np.float64(self.elevation)))


@dataclass(frozen=True)
class Placed:
    """A thing on the floor: `xy` in metres, the source of its range, and the range's standard deviation in metres."""

    name: str
    xy: tuple[float, float]
    source: Source
    weight: float = 1.0
    spread: float = 0.0


@dataclass(frozen=True, eq=False)
class FloorLine:
    """The foot of the walls, as from a room-layout estimator: `points` ``(n, 2)`` metres, all around."""

    points: np.ndarray

    def __post_init__(self) -> None:
        points = np.asarray(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3 or not np.isfinite(points).all():
            raise DirectionError(
                f"the floor line has shape {points.shape}; wanted at least 3 points (x, y) on the floor, metres"
            )
        object.__setattr__(self, "points", points)

    @property
    def axis(self) -> float:
        """The direction (radians, in [-pi/4, pi/4)) of most walls, up to quarter turns."""
        way = np.roll(self.points, -1, axis=0) - self.points
        length = np.hypot(*way.T)
        usual = length <= max(3 * float(np.median(length)), 1e-9)  # longer ones jump across an opening
        turns = np.exp(4j * np.arctan2(way[:, 1], way[:, 0]))
        return float(np.angle((np.where(usual, length**2, 0.0) * turns).sum()) / 4)

    def range_at(self, azimuth: float) -> float | None:
        """Metres to the wall at `azimuth`: the nearest edge of the line on that side; None if it is open there."""
        ahead = np.array([math.cos(azimuth), math.sin(azimuth)])
        start, way = self.points, np.roll(self.points, -1, axis=0) - self.points
        cross = ahead[0] * way[:, 1] - ahead[1] * way[:, 0]
        safe = np.where(np.abs(cross) < 1e-12, 1.0, cross)
        along = (start[:, 0] * way[:, 1] - start[:, 1] * way[:, 0]) / safe
        share = (start[:, 0] * ahead[1] - start[:, 1] * ahead[0]) / safe
        met = (np.abs(cross) >= 1e-12) & (along > 0) & (share >= -1e-9) & (share <= 1 + 1e-9)
        return float(along[met].min()) if met.any() else None


def floor_range(elevation: float, height: float) -> float | None:
    """Metres on the floor to a point seen at `elevation` from `height` metres above it; None at or over the horizon."""
    if elevation >= 0 or height <= 0:
        return None
    found = height / math.tan(-elevation) if elevation > -math.pi / 2 else 0.0
    return found if found <= FARTHEST else None


def contact_range(detection: Detection, height: float) -> float | None:
    """Metres on the floor to the middle of a thing with floor contact, None if the contact gives no range.

    `foot` gives it directly. The lowest edge is the near one: half of the thing's depth is added, which is assumed to
    be `DEPTH` of its half width (for a round outline and `DEPTH` 1, d becomes d / (1 - sin w)), and at most `DEEPEST`:
    furniture is wider than deep.
    """
    if detection.foot is not None:
        return floor_range(detection.foot, height)
    near = floor_range(detection.bottom, height) if detection.bottom is not None else None
    if near is None:
        return None
    share = DEPTH * math.sin(min(detection.half_width, WIDEST))
    return min(near + min(near * share / (1 - share), DEEPEST), FARTHEST)


def place(detections: Sequence[Detection], height: float, walls: FloorLine | None = None) -> list[Placed]:
    """Every detection on the floor, in the same order; `height` of the camera in metres.

    Ranges come from, in this order: a depth value; the contact with the floor; the contact with the supporting thing;
    the wall behind. The middle of a standing thing without a visible contact is assumed at the height `MIDDLE`. If
    the walls are not known, hanging things are put on a rectangle around the standing ones ("beyond", `enclosing`),
    otherwise at the median range of the others ("guess").
    """
    measured = [(each, _measured(each, height, walls)) for each in detections]
    standing = [(each, found[0]) for each, found in measured if found and found[1] == "contact"]
    known = [(each.azimuth, found[0]) for each, found in measured if found]
    placed = []
    for each, found in measured:
        away, source = found or _inferred(each, standing, known, walls, height)
        outline = source == "contact" and each.foot is None
        spread = OUTLINE_SPREAD + OUTLINE_SHARE * away if outline else SPREAD[source]
        placed.append(Placed(each.name, _on_floor(each.azimuth, away), source, each.weight, spread))
    return placed


def place_on_circle(detections: Sequence[Detection]) -> list[Placed]:
    """Every detection at the same range: all that directions alone allow."""
    return [Placed(each.name, _on_floor(each.azimuth, 1.0), "guess", each.weight) for each in detections]


def _on_floor(azimuth: float, away: float) -> tuple[float, float]:
    return away * math.cos(azimuth), away * math.sin(azimuth)


def _measured(each: Detection, height: float, walls: FloorLine | None) -> tuple[float, Source] | None:
    if each.depth is not None and math.isfinite(each.depth) and each.depth > 0:
        return each.depth * math.cos(each.elevation), "depth"
    if not each.contact:
        return None
    away = contact_range(each, height)
    if away is None and each.foot is None and each.bottom is None:
        away = floor_range(each.elevation, height - MIDDLE)
        return None if away is None else (away, "height")
    if away is None:
        return None
    wall = walls.range_at(each.azimuth) if walls is not None and each.foot is None else None
    return (away, "contact") if wall is None or away <= OUTSIDE * wall else (wall, "wall")


def _inferred(
    each: Detection,
    standing: Sequence[tuple[Detection, float]],
    known: Sequence[tuple[float, float]],
    walls: FloorLine | None,
    height: float,
) -> tuple[float, Source]:
    under = [] if each.name in HANGING else [_range_on(each, other, away, height) for other, away in standing]
    under = [away for away in under if away is not None]
    if under:
        return min(under), "support"
    wall = walls.range_at(each.azimuth) if walls is not None else None
    if wall is not None:
        return wall + RECESS.get(each.name, 0.0), "wall"
    if not known:
        return GUESS, "guess"
    around = enclosing(known)
    reach = around.range_at(each.azimuth) if around is not None else None
    middle = float(np.median([away for _, away in known]))
    return (reach, "beyond") if reach is not None else (middle, "guess")


def _range_on(each: Detection, other: Detection, away: float, height: float) -> float | None:
    """Metres on the floor to `each` if it stands on `other`, which is `away`; None if it cannot.

    The upper edge of a thing below the camera is its far rim, which gives the height of its top. A thing between its
    two rims touches that top as others touch the floor.
    """
    if each.bottom is None or other.top is None or other is each or other.top >= 0:
        return None
    if abs(float(wrap(np.float64(each.azimuth - other.azimuth)))) > other.half_width:
        return None
    reach = away * math.sin(min(other.half_width, WIDEST))
    above = (away + reach) * math.tan(-other.top)  # height of the camera above the top
    found = contact_range(replace(each, foot=None), above)
    near, far = (1 - SLACK) * (away - reach), (1 + SLACK) * (away + reach)
    return found if above < height and found is not None and near <= found <= far else None


def enclosing(known: Sequence[tuple[float, float]]) -> FloorLine | None:
    """Walls estimated from things at these azimuths (radians) and ranges (metres): the smallest rectangle, widened.

    Things stand along walls, with their middles `MARGIN` away. None if they do not surround the camera.
    """
    points = np.array([_on_floor(azimuth, away) for azimuth, away in known])
    if len(points) < 3:
        return None
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = points[ConvexHull(points).vertices]
    except QhullError:  # all in one line
        return None
    found, least = None, math.inf
    for dx, dy in np.roll(hull, -1, axis=0) - hull:  # one side of the smallest rectangle lies on one of the hull
        turn = np.array([[dx, dy], [-dy, dx]]) / math.hypot(dx, dy)
        low, high = (hull @ turn.T).min(axis=0), (hull @ turn.T).max(axis=0)
        if (area := float(np.prod(high - low))) < least:
            (x0, y0), (x1, y1), least = low - MARGIN, high + MARGIN, area
            inside = x0 < 0 < x1 and y0 < 0 < y1
            corners = np.array([[x1, y1], [x0, y1], [x0, y0], [x1, y0]]) @ turn
            found = FloorLine(corners) if inside else None
    return found


def nearest(start: Placed, others: Sequence[Placed]) -> Placed:
    """The one of `others` nearest to `start`."""
    return min(others, key=lambda each: math.dist(start.xy, each.xy))


def direction_between(P: Placed, O: Sequence[Placed], Q: Sequence[Placed]) -> str:
    """The direction of the nearest Q from P facing the nearest O: "Front Left", and so on."""
    facing, asked = (np.subtract(nearest(P, things).xy, P.xy).tolist() for things in (O, Q))
    return named(*products(facing, asked))


@dataclass(frozen=True, eq=False)
class LayoutSamples:
    """Layouts of the same things: `cells` ``(M, n, 2)``, rows and columns of the n things `placed`, mirrored."""

    placed: tuple[Placed, ...]
    cells: np.ndarray

    def directions(self, P: int, O: Sequence[int], Q: Sequence[int]) -> dict[str, float]:
        """The share of each answer, left and right as in the room, for the thing P and the candidates O and Q."""
        start = self.cells[:, P]
        facing, asked = self._nearest(start, O), self._nearest(start, Q)
        signs = np.sign(products(facing.T, asked.T)).astype(int).T
        found: Counter[str] = Counter()
        for (along, aside), count in Counter(map(tuple, signs.tolist())).items():
            found[swapped(named(along, aside))] += count
        del found[""]  # the benchmark leaves such questions out
        total = found.total()
        return {label: count / total for label, count in found.most_common()}

    def nearest(self, P: int, groups: Mapping[str, Sequence[int]]) -> dict[str, float]:
        """The share of layouts in which each of `groups` is the nearest to P (the first of equal ones)."""
        start = self.cells[:, P]
        away = np.stack([(self._nearest(start, members) ** 2).sum(axis=1) for members in groups.values()])
        first = np.bincount(away.argmin(axis=0), minlength=len(groups)) / len(self.cells)
        return dict(zip(groups, first.tolist(), strict=True))

    def _nearest(self, start: np.ndarray, things: Sequence[int]) -> np.ndarray:
        """Steps ``(M, 2)`` to the nearest of the things; of equally near ones to that with the smallest angle."""
        steps = self.cells[:, list(things)] - start[:, None]
        angle = np.arctan2(steps[..., 0], steps[..., 1]) % (2 * math.pi)
        rank = (steps**2).sum(axis=-1) + angle / 7  # squares are whole numbers, so angles only break ties
        return steps[np.arange(len(steps)), rank.argmin(axis=1)]


def draw(
    placed: Sequence[Placed], walls: FloorLine | None, rng: np.random.Generator, draws: int = DRAWS
) -> LayoutSamples:
    """`draws` layouts in each of the four orientations; one each if every place is certain and the walls are known."""
    if not placed:
        return LayoutSamples((), np.zeros((0, 0, 2), dtype=int))
    xy = np.array([each.xy for each in placed])
    spread = np.array([each.spread for each in placed])
    if walls is not None and not spread.any():
        draws = 1
    away = np.maximum(np.hypot(*xy.T), 1e-9)
    # Only ranges have errors: along the ray.
    error = rng.standard_normal((draws, len(placed))) * spread
    moved = xy * np.maximum(1 + error / away, 0.1)[..., None]
    axes = np.full(draws, walls.axis) if walls is not None else rng.uniform(0, math.pi / 2, draws)
    turns = (axes[:, None] + np.arange(4) * math.pi / 2)[..., None]
    x, y = moved[:, None, :, 0], moved[:, None, :, 1]
    ahead, left = np.cos(turns) * x + np.sin(turns) * y, np.cos(turns) * y - np.sin(turns) * x
    points = np.stack([ahead, left], axis=-1).reshape(4 * draws, len(placed), 2)
    return LayoutSamples(tuple(placed), _cells(points, mirror=True))


def layout_from(
    placed: Mapping[str, Sequence[tuple[float, float]]], mirror: bool = False
) -> dict[str, list[list[int]]]:
    """The layout of places (x ahead, y left) on the smallest grid of square cells that holds them all.

    Row 0 is ahead; columns grow to the right, or, with `mirror`, to the left as in the published layouts.
    """
    points = np.array([xy for where in placed.values() for xy in where], dtype=np.float64)
    if not len(points):
        return {}
    each = iter(_cells(points[None], mirror)[0].tolist())
    return {name: [next(each) for _ in where] for name, where in placed.items()}


def _cells(points: np.ndarray, mirror: bool) -> np.ndarray:
    """Rows and columns ``(M, n, 2)`` of points ``(M, n, 2)``, x ahead and y left."""
    x, y = points[..., 0], points[..., 1]
    rows = x.max(axis=1, keepdims=True) - x
    columns = y - y.min(axis=1, keepdims=True) if mirror else y.max(axis=1, keepdims=True) - y
    both = np.stack([rows, columns], axis=-1)
    cell = np.maximum(both.max(axis=(1, 2), keepdims=True), 1e-9) / SIZE
    return np.minimum(both / cell, SIZE - 1).astype(int)
