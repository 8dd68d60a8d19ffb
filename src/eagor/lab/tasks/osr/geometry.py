"""Where things are on the floor: what one camera sees of them, their places, and answers from these places.

"Standing by P and facing O, where is Q?" needs ranges, not directions alone. On a level floor they come from contact
points: a camera at height h that sees one at elevation e (negative) is h / tan(-e) away from it. The answers do not
depend on h, which scales the whole room. What hangs on a wall is put on a rectangle around what stands.

Frame: the camera's body, x forward, y left, z up; metres on the floor, the camera above the origin; angles in radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eagor._arrays import to_numpy
from eagor._values import lazy
from eagor.belief import Belief
from eagor.evidence import Evidence
from eagor.evidence.shapes import MIN_SPREAD
from eagor.lab.tasks.osr import SIZE, named
from eagor.sphere import azimuth_elevation

HEIGHT = 1.5  # metres of the camera above the floor, by default
FARTHEST = 20.0  # metres: beyond, contact points are too near the horizon to give a range
# Things that hang on a wall or are part of it, in the words of the benchmark and of our apartments.
HANGING = frozenset(
    "window picture painting mirror curtain blinds whiteboard clock switch vent wall_light".split()  # noqa: SIM905
)
MIDDLE = 0.45  # metres above the floor: assumed middle of a standing thing without a visible contact
MARGIN = 0.3  # metres from the middle of a thing at a wall to the wall
GUESS = 3.0  # metres, if there is no other range
WIDEST = math.radians(60)  # half width of things so near that their outline no longer gives their depth
DEPTH, DEEPEST = 0.85, 0.4  # a thing's half depth: this share of its half width, and at most this many metres
DEGREE = 15  # of the belief about a category
MOST = 9  # things of one category
PROMINENCE = 0.5  # nats by which one thing has to stand out from the next
SKIRT = 0.35  # share of a peak's height down to which the response around it belongs to the thing
NEAR = math.radians(50)
PARAMETERS = 6  # of a bump

Spot = tuple[float, float]  # on the floor


@dataclass(frozen=True)
class Detection:
    """One thing as seen: its category, and the azimuth and elevation of its middle.

    - `bottom`: the elevation of its lowest edge; `half_width`: half of its angular width.
    - `contact`: whether its lowest edge touches the floor.
    - `weight`: its strength of belief, relative to others.
    - `xy`: once it is placed, where it is in metres, and `range_from`: what its range was taken from.
    """

    name: str
    azimuth: float
    elevation: float
    bottom: float | None = None
    half_width: float = 0.0
    contact: bool = True
    weight: float = 1.0
    xy: Spot = (0.0, 0.0)
    range_from: str = "guess"  # or contact, height, beyond


@dataclass(frozen=True, eq=False)
class SceneLayout:
    """What is around, placed, the likeliest first, and the names that the perception did not understand."""

    placed: Sequence[Detection]
    unknown_queries: Sequence[str] = ()

    @lazy
    def places(self) -> dict[str, list[Spot]]:
        """Where the things are, by name."""
        names = dict.fromkeys(each.name for each in self.placed)
        return {name: [each.xy for each in self.placed if each.name == name] for name in names}

    def notes(self, names: Sequence[str]) -> dict[str, Any]:
        """Where the things with these names were seen and placed, for the record."""
        shown = [each for name in dict.fromkeys(names) for each in self.placed if each.name == name]
        things = [
            {
                "name": each.name,
                "azimuth_deg": round(math.degrees(each.azimuth), 1),
                "elevation_deg": round(math.degrees(each.elevation), 1),
                "xy": [round(value, 2) for value in each.xy],
                "range_from": each.range_from,
            }
            for each in shown
        ]
        guessed = {"guessed": True} if any(each.range_from != "contact" for each in shown) else {}
        unknown = [name for name in names if name in self.unknown_queries]
        return {"things": things, **guessed, **({"strange": unknown} if unknown else {})}


def place(things: Sequence[Detection], height: float = HEIGHT) -> list[Detection]:
    """Every thing on the floor, the likeliest first; `height` of the camera in metres.

    Ranges come from the contact with the floor. The middle of a standing thing without a visible contact is assumed at
    the height `MIDDLE`. Hanging things are put on a rectangle around the standing ones ("beyond"), or, if there is
    none, at the median range of the others ("guess").
    """
    known = {index: away for index, each in enumerate(things) if (away := _range(each, height)) is not None}
    walls = walls_around([_on_floor(things[index].azimuth, away) for index, away in known.items()])
    middle, placed = float(np.median([*known.values()])) if known else GUESS, []
    for index, each in enumerate(things):
        away, source = known.get(index, middle), "guess"
        if index in known:
            source = "height" if each.bottom is None else "contact"
        elif walls:
            away, source = walls(each.azimuth), "beyond"
        placed.append(replace(each, xy=_on_floor(each.azimuth, away), range_from=source))
    return sorted(placed, key=lambda each: -each.weight)


def _on_floor(azimuth: float, away: float) -> Spot:
    return away * math.cos(azimuth), away * math.sin(azimuth)


def _range(thing: Detection, height: float) -> float | None:
    """The range of a thing by the floor; None if it does not touch it, or too far away."""
    if thing.bottom is None or not thing.contact:
        return floor_range(thing.elevation, height - MIDDLE) if thing.contact else None
    if (away := floor_range(thing.bottom, height)) is None:
        return None
    # The lowest edge is the near one: half of the depth is added. It is assumed to be a share of the half width (of a
    # round outline with the share 1, d becomes d / (1 - sin w)), and small: furniture is wider than deep.
    share = DEPTH * math.sin(min(thing.half_width, WIDEST))
    return min(away + min(away * share / (1 - share), DEEPEST), FARTHEST)


def floor_range(elevation: float, height: float) -> float | None:
    """Metres on the floor to a point seen at `elevation` from `height` metres above it; None at or over the horizon."""
    if elevation >= 0 or height <= 0:
        return None
    found = height / math.tan(-elevation) if elevation > -math.pi / 2 else 0.0
    return found if found <= FARTHEST else None


def walls_around(points: Sequence[Spot]) -> Callable[[float], float] | None:
    """Metres from the camera to the walls at an azimuth: those of the smallest rectangle around the places of things.

    Things stand along walls, with their middles `MARGIN` away. None if they do not surround the camera.
    """
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 3:
        return None
    try:
        hull = np.array(points)[ConvexHull(points).vertices]
    except QhullError:  # all in one line
        return None
    sides = np.roll(hull, -1, axis=0) - hull  # one side of the smallest rectangle lies on one of the hull
    ahead = sides / np.hypot(*sides.T)[:, None]
    turned = [(axes, hull @ axes.T) for axes in np.stack([ahead, ahead[:, ::-1] * [-1, 1]], axis=1)]
    axes, along = min(turned, key=lambda each: float(np.prod(np.ptp(each[1], axis=0))))
    low, high = along.min(axis=0) - MARGIN, along.max(axis=0) + MARGIN

    def away(azimuth: float) -> float:
        ahead = axes @ [math.cos(azimuth), math.sin(azimuth)]
        with np.errstate(divide="ignore"):  # along an edge: infinitely far
            return float((np.where(ahead > 0, high, low) / ahead).min(initial=math.inf, where=ahead != 0))

    return away if (low < 0).all() and (high > 0).all() else None


def nearest(start: Spot, others: Sequence[Spot]) -> Spot:
    """The one of `others` nearest to `start`."""
    return min(others, key=lambda other: math.dist(start, other))


def direction_between(P: Spot, O: Sequence[Spot], Q: Sequence[Spot]) -> str:
    """The direction of the nearest Q from P facing the nearest O: "Front Left", and so on."""
    return named(*(np.subtract(nearest(P, things), P).tolist() for things in (O, Q)))


def layout_from(places: Mapping[str, Sequence[Spot]]) -> dict[str, list[list[int]]]:
    """The layout of places on the smallest grid of square cells that holds them all; ``{name: [[row, column], ...]}``.

    Row 0 is ahead; columns grow to the right (in the published layouts to the left).
    """
    if not places:
        return {}
    ahead, left = np.array([xy for where in places.values() for xy in where], dtype=np.float64).T
    both = np.stack([ahead.max() - ahead, left.max() - left], axis=1)
    cell = max(both.max(), 1e-9) / SIZE
    cells = iter(np.minimum(both / cell, SIZE - 1).astype(int).tolist())
    return {name: [next(cells) for _ in where] for name, where in places.items()}


def detections_in(evidence: Evidence, name: str) -> list[Detection]:
    """The things in the evidence about `name`: peaks of its belief at which they are likelier than not."""
    belief, found = Belief.uniform(DEGREE).update(evidence), []
    directions, weights = belief.modes(MOST, PROMINENCE)
    above = to_numpy(belief.log_ratio(directions)) > 0
    for where, weight in zip(directions[above], weights[above].tolist(), strict=True):
        azimuth, elevation = map(float, azimuth_elevation(where))
        bottom, turn = None, 0.0
        if across := extent(evidence, where):
            bottom = max(elevation - across[1], -math.pi / 2)
            turn = min(across[0] / max(math.cos(elevation), 0.2), math.pi / 2)
        found.append(Detection(name, azimuth, elevation, bottom, turn, name not in HANGING, weight))
    return found


def extent(evidence: Evidence, where: np.ndarray) -> tuple[float, float] | None:
    """Half width and half height (radians) of the thing whose response peaks near `where` ``(3,)``; None if too coarse.

    The response around the peak is modelled as the bump of a box: a Gaussian whose variances are those of the box, a
    third of its squared half sides, widened by `MIN_SPREAD`. Its logarithm is fitted by a quadratic.
    """
    response = np.asarray(to_numpy(evidence.response), dtype=np.float64).reshape(-1)
    cells = evidence.grid.directions.reshape(-1, 3)
    up = np.array([0.0, 0.0, 1.0]) - where[2] * where
    if np.linalg.norm(up) < 0.1:
        return None  # straight above or below, width and height have no direction
    up /= np.linalg.norm(up)
    side, ahead = np.cross(up, where), cells @ where
    near = np.flatnonzero(ahead > math.cos(NEAR))
    peak = float(response[near].max(initial=0.0, where=ahead[near] > math.cos(NEAR / 5)))
    near = near[response[near] >= SKIRT * peak]
    if peak <= 0 or len(near) < PARAMETERS + 2:
        return None
    angle = np.arccos(np.clip(ahead[near], -1, 1))
    stretch = angle / np.maximum(np.sin(angle), 1e-9)
    u, v = cells[near] @ side * stretch, cells[near] @ up * stretch
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    _, _, _, uu, uv, vv = np.linalg.lstsq(terms, np.log(response[near]), rcond=None)[0].tolist()
    curved = -np.array([[2 * uu, uv], [uv, 2 * vv]])
    if uu >= 0 or vv >= 0 or np.linalg.det(curved) <= 0:
        return None
    wide, tall = np.diag(np.linalg.inv(curved)) - MIN_SPREAD**2
    return math.sqrt(3 * max(wide, 0.0)), math.sqrt(3 * max(tall, 0.0))
