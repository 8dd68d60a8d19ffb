"""Sightings of every category in a scene's picture, from a belief per category, or from the truth.

The truth is the file physical_truth.json in the scene's folder. It is not part of the benchmark; the scenes that
are made for tests have it, and others may have it, too::

    {"frame": "x right, y forward (ERP centre), camera at origin, metres",
     "camera": 1.5,                                     height above the floor, optional
     "objects": [{"name": "sofa", "xy": [1.2, 2.0], "size": [0.9, 1.8, 0.8], "z_centre": 0.4,
                  "corners": [[x, y], ...]}, ...],      footprint, optional: else `size` along the axes
     "walls": [[x, y], ...]}                            foot of the walls, all around, optional
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from eagor._arrays import to_numpy
from eagor._checks import number, parsed, shown
from eagor.belief import Belief
from eagor.errors import EagorError, FormatError, QueryError
from eagor.evidence import Evidence
from eagor.evidence.shapes import MIN_SPREAD
from eagor.grids import ErpGrid
from eagor.lab.agents.models import recalibrator, shared
from eagor.lab.tasks.osr.data import Scene
from eagor.lab.tasks.osr.geometry import HANGING, FloorLine, Sighting
from eagor.perception import Perception
from eagor.sphere import wrap

FILE = "physical_truth.json"
TRUTH = "truth"
DEPTH_FILE = "depth.npy"
HEIGHT = 1.5  # metres of the camera above the floor, by default
TOUCHING = 0.05  # metres above the floor: a thing that begins below stands on it
MOST = 9  # things of one category
PROMINENCE = 0.5  # nats by which one thing has to stand out from the next
SKIRT = 0.35  # share of a peak's height down to which the response around it belongs to the thing
NEAR = math.radians(50)
CELLS = 6  # the number of parameters of a bump
_FARTHEST = 1e6  # metres from the camera; more is taken for a mistake


@dataclass(frozen=True, eq=False)
class Seen:
    """What is around: `things`, the foot of the walls if known, and the camera's height above the floor (metres).

    `strange`: names that the perception did not understand.
    """

    things: tuple[Sighting, ...]
    walls: FloorLine | None = None
    height: float = HEIGHT
    strange: tuple[str, ...] = ()


Looker = Callable[[Scene, Sequence[str]], Seen]  # looks at a scene for things with these names


def open_looker(perception: str, settings: Mapping[str, Any]) -> Looker:
    """The looker for truth (true places from the data; truth:outline without contacts), or for any perception."""
    name, _, how = perception.partition(":")
    if name == TRUTH:
        if how not in ("", "exact", "outline"):
            raise EagorError(f"perception {perception!r}; wanted truth, truth:exact or truth:outline for osr")
        return lambda scene, names: true_places(scene, names, how != "outline")
    depth, height = settings["range"] == "depth", settings["camera_height"]
    return BeliefLooker(shared(perception), settings["degree"], height, depth, recalibrator(settings))


# From a perception


@dataclass(frozen=True, eq=False)
class BeliefLooker:
    """Sightings from a perception: its evidence for a category gives a belief, whose peaks are the things.

    `degree`: of the belief; `height`: of the camera above the floor, metres; `depth`: take ranges from depth.npy in the
    scene's folder (metres along the ray, an equirectangular array (H, W), 0 or infinite if unknown); `read`:
    recalibrates looks.
    """

    perception: Perception
    degree: int = 15
    height: float = HEIGHT
    depth: bool = False
    read: Callable[[Evidence], Evidence] = lambda evidence: evidence

    def __call__(self, scene: Scene, names: Sequence[str]) -> Seen:
        from eagor.media.panorama import read_panorama

        panorama = read_panorama(scene.picture)
        ranges = read_depth(scene.folder) if self.depth else None
        if self.depth and ranges is None:
            raise FormatError(f"{scene.folder} has no {DEPTH_FILE}; put one there, or take ranges from the floor")
        things: list[Sighting] = []
        strange = []
        for name in names:
            try:
                evidence = self.read(self.perception(panorama, name.replace("_", " "), stamp=0.0))
            except QueryError:
                strange.append(name)
                continue
            found = sightings_in(evidence, name, self.degree)
            things += [each if ranges is None else replace(each, depth=depth_at(ranges, each)) for each in found]
        return Seen(tuple(things), None, self.height, tuple(strange))


def sightings_in(evidence: Evidence, name: str, degree: int) -> list[Sighting]:
    """The things in the evidence about `name`: peaks of its belief at which they are likelier than not."""
    belief = Belief.uniform(degree).update(evidence)
    directions, weights = belief.modes(MOST, PROMINENCE)
    above = to_numpy(belief.log_ratio(directions)) > 0
    found = []
    for where, weight in zip(directions[above], weights[above], strict=True):
        plain = Sighting.at(name, where, weight=float(weight), contact=name not in HANGING)
        if across := extent(evidence, where):
            wide, tall = across
            bottom, top = max(plain.elevation - tall, -math.pi / 2), min(plain.elevation + tall, math.pi / 2)
            turn = min(wide / max(math.cos(plain.elevation), 0.2), math.pi / 2)
            plain = replace(plain, bottom=bottom, top=top, half_width=turn)
        found.append(plain)
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
    side = np.cross(up, where)
    ahead = cells @ where
    near = np.flatnonzero(ahead > math.cos(NEAR))
    peak = float(response[near].max(initial=0.0, where=ahead[near] > math.cos(NEAR / 5)))
    near = near[response[near] >= SKIRT * peak]
    if peak <= 0 or len(near) < CELLS + 2:
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


def read_depth(folder: Path) -> np.ndarray | None:
    """The ranges ``(H, W)``, metres, of a scene's depth.npy, None without one. Raises `FormatError` for other data."""
    path = folder / DEPTH_FILE
    if not path.is_file():
        return None
    try:
        found = np.lib.format.open_memmap(path, mode="r")  # mapped: the header may claim more than the file holds
    except Exception as error:  # the header is Python and may fail in many ways
        raise FormatError(f"{path} cannot be read as a NumPy array ({type(error).__name__}: {error})") from None
    if found.ndim != 2 or found.dtype.kind not in "fiu" or not found.size:
        raise FormatError(f"{path} has shape {found.shape}, {found.dtype}; wanted ranges (H, W) in metres")
    return np.array(found)


def depth_at(ranges: np.ndarray, thing: Sighting) -> float | None:
    """The median range (metres along the ray) over the middle of a thing; None without measurements there."""
    x, y, _ = ErpGrid(*ranges.shape).project(thing.direction)
    tall = (thing.top - thing.bottom) / 4 if thing.top is not None and thing.bottom is not None else math.radians(1)
    rows = max(1, round(tall / math.pi * ranges.shape[0]))
    columns = max(1, round(thing.half_width / 2 / (2 * math.pi) * ranges.shape[1]))
    i = np.clip(int(y) + np.arange(-rows, rows + 1), 0, ranges.shape[0] - 1)
    j = (int(x) + np.arange(-columns, columns + 1)) % ranges.shape[1]
    part = np.asarray(ranges[np.ix_(i, j)], dtype=np.float64)
    part = part[np.isfinite(part) & (part > 0)]
    return float(np.median(part)) if len(part) else None


# From the truth


@dataclass(frozen=True, eq=False)
class Body:
    """A thing: `name`, its footprint ``(n, 2)`` (x forward, y left, metres) and heights above the floor, metres."""

    name: str
    footprint: np.ndarray
    low: float
    high: float

    @property
    def centre(self) -> np.ndarray:
        """The centre ``(2,)`` of the footprint's bounds."""
        return (self.footprint.min(axis=0) + self.footprint.max(axis=0)) / 2

    @property
    def stands(self) -> bool:
        """Whether it touches the floor."""
        return self.low < TOUCHING


@dataclass(frozen=True, eq=False)
class Room:
    """The things around a camera, its height above the floor (metres), and the foot of the walls if known."""

    bodies: tuple[Body, ...]
    camera: float = HEIGHT
    walls: FloorLine | None = None


def true_places(scene: Scene, names: Sequence[str], exact: bool) -> Seen:
    """Sightings from the truth in the scene's folder; `exact`: see `sightings`."""
    room = read_room(scene.folder)
    if room is None:
        raise FormatError(f"{scene.folder} has no {FILE}, which the perception truth reads; name another perception")
    return Seen(tuple(sightings(room, names, exact)), room.walls, room.camera)


def sightings(room: Room, names: Sequence[str] | None = None, exact: bool = True) -> list[Sighting]:
    """The things (with these names) as the camera sees them, without any error.

    With `exact`, the foot is the floor point below the middle, as a labelled contact would be. Otherwise only the
    outline of the box is given, as from a detector, and the range has to be derived from its lower edge.
    """
    return [_sighting(body, room.camera, exact) for body in room.bodies if names is None or body.name in names]


def _sighting(body: Body, camera: float, exact: bool) -> Sighting:
    centre, rim = body.centre, body.footprint
    away, azimuth = float(np.hypot(*centre)), math.atan2(centre[1], centre[0])
    middle = math.atan2((body.low + body.high) / 2 - camera, away)
    sides = wrap(np.arctan2(rim[:, 1], rim[:, 0]) - azimuth)
    way = np.roll(rim, -1, axis=0) - rim
    along = np.clip(-(rim * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), 1e-12), 0, 1)
    near, far = float(np.hypot(*(rim + along[:, None] * way).T).min()), float(np.hypot(*rim.T).max())
    # Seen from above, the near rim is the lower one; from below, the far one.
    bottom = math.atan2(body.low - camera, near if body.low < camera else far)
    top = math.atan2(body.high - camera, far if body.high < camera else near)
    left, right = float(np.max(sides)), float(np.min(sides))
    if not exact and left - right < math.pi:
        azimuth += (left + right) / 2
    foot = math.atan2(-camera, away) if exact and body.stands else None
    half = min((left - right) / 2, math.pi / 2)
    return Sighting(body.name, azimuth, middle, bottom, top, half, foot, contact=body.stands)


def read_room(folder: Path) -> Room | None:
    """The room of a scene's folder; None without the file. Raises `FormatError` if it is not as described above."""
    path = folder / FILE
    if not path.is_file():
        return None
    try:
        entry = parsed(path.read_bytes())
        bodies = tuple(_body(item) for item in entry["objects"])
        walls = entry.get("walls")
        line = None if walls is None else FloorLine(_turned(_points(walls)))
        camera = number(entry.get("camera", HEIGHT))
        if camera <= 0:
            raise ValueError(f"camera {camera:g}; wanted metres above the floor, above 0")
        return Room(bodies, camera, line)
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise FormatError(f"{path} is not a room ({type(error).__name__}: {error}); see {__name__}") from None


def write_room(room: Room, folder: Path) -> Path:
    """Write a room into a scene's folder."""
    objects = []
    for body in room.bodies:
        corners = -_turned(body.footprint)
        objects.append(
            {
                "name": body.name,
                "xy": _rounded(-_turned(body.centre[None])[0]),
                "size": [*_rounded(np.ptp(corners, axis=0)), round(body.high - body.low, 4)],
                "z_centre": round((body.low + body.high) / 2, 4),
                "corners": [_rounded(corner) for corner in corners],
            }
        )
    frame = "x right, y forward (ERP centre), camera at origin, metres"
    entry: dict[str, Any] = {"frame": frame, "camera": room.camera, "objects": objects}
    if room.walls is not None:
        entry["walls"] = [_rounded(point) for point in -_turned(room.walls.points)]
    path = folder / FILE
    path.write_text(json.dumps(entry, indent=1) + "\n", encoding="utf-8")
    return path


def _body(item: dict[str, Any]) -> Body:
    size = np.array([number(side) for side in item["size"]])
    if size.shape != (3,) or size.min() < 0:
        raise ValueError(f"{item.get('name')!r} has the size {size.tolist()}; wanted three lengths in metres")
    corners = item.get("corners")
    if corners is None:
        half = size[:2] / 2 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
        corners = (_points([item["xy"]]) + half).tolist()
    middle, footprint = number(item["z_centre"]), _turned(_points(corners))
    if len(footprint) < 3:
        raise ValueError(f"{item.get('name')!r} has a footprint of {len(footprint)} corners; wanted three or more")
    return Body(str(item["name"]), footprint, middle - size[2] / 2, middle + size[2] / 2)


def _points(written: Any) -> np.ndarray:
    """Points ``(n, 2)`` in metres. Raises `ValueError` for anything else."""
    points = [[number(value) for value in point] for point in written]
    if not points or any(len(point) != 2 or max(map(abs, point)) > _FARTHEST for point in points):
        raise ValueError(f"the points are {shown(written)}; wanted [x, y] in metres")
    return np.array(points)


def _turned(points: np.ndarray) -> np.ndarray:
    """From x right, y forward to x forward, y left ``(n, 2)``; the negative of the result is the way back."""
    return np.stack([points[:, 1], -points[:, 0]], axis=1)


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(value), 4) for value in values]
