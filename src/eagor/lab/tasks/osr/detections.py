"""Detections of every category in a scene's picture, from a belief per category, or from the truth.

The truth is the file physical_truth.json in the scene's folder. It is not part of the benchmark; the scenes that
are made for tests have it, and others may have it, too::

    {"frame": "x right, y forward (ERP centre), camera at origin, metres",
     "camera": 1.5,                                     height above the floor, optional
     "objects": [{"name": "sofa", "xy": [1.2, 2.0], "size": [0.9, 1.8, 0.8], "z_centre": 0.4,
                  "corners": [[x, y], ...]}, ...],      footprint, optional: else `size` along the axes
     "walls": [[x, y], ...]}                            foot of the walls, all around, optional
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from eagor._arrays import to_numpy
from eagor._checks import parsed
from eagor.belief import Belief
from eagor.errors import DirectionError, EagorError, FormatError, QueryError
from eagor.evidence import Evidence
from eagor.evidence.shapes import MIN_SPREAD
from eagor.grids import ErpGrid
from eagor.lab.agents.models import recalibrator, shared
from eagor.lab.tasks.osr.data import Scene
from eagor.lab.tasks.osr.geometry import HANGING, Detection, FloorLine
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
class SceneDetections:
    """What is around: `things`, the foot of the walls if known, and the camera's height above the floor (metres).

    `unknown_queries`: names that the perception did not understand.
    """

    things: tuple[Detection, ...]
    walls: FloorLine | None = None
    height: float = HEIGHT
    unknown_queries: tuple[str, ...] = ()


Detector = Callable[[Scene, Sequence[str]], SceneDetections]  # looks at a scene for things with these names


def open_detector(perception: str, settings: Mapping[str, Any]) -> Detector:
    """The detector for truth (true places from the data; truth:outline without contacts), or for any perception."""
    name, _, how = perception.partition(":")
    if name == TRUTH:
        if how not in ("", "exact", "outline"):
            raise EagorError(f"perception {perception!r}; wanted truth, truth:exact or truth:outline for osr")
        return lambda scene, names: true_places(scene, names, how != "outline")
    depth, height = settings["range"] == "depth", settings["camera_height"]
    return BeliefDetector(shared(perception), settings["degree"], height, depth, recalibrator(settings))


# From a perception


@dataclass(frozen=True, eq=False)
class BeliefDetector:
    """Detections from a perception: its evidence for a category gives a belief, whose peaks are the things.

    `degree`: of the belief; `height`: of the camera above the floor, metres; `depth`: take ranges from depth.npy in the
    scene's folder (metres along the ray, an equirectangular array (H, W), 0 or infinite if unknown); `read`:
    recalibrates looks.
    """

    perception: Perception
    degree: int = 15
    height: float = HEIGHT
    depth: bool = False
    read: Callable[[Evidence], Evidence] = lambda evidence: evidence

    def __call__(self, scene: Scene, names: Sequence[str]) -> SceneDetections:
        from eagor.media.panorama import read_panorama

        panorama = read_panorama(scene.picture)
        ranges = read_depth(scene.folder) if self.depth else None
        if self.depth and ranges is None:
            raise FormatError(f"{scene.folder} has no {DEPTH_FILE}; put one there, or take ranges from the floor")
        things: list[Detection] = []
        unknown = []
        for name in names:
            try:
                evidence = self.read(self.perception(panorama, name.replace("_", " "), stamp=0.0))
            except QueryError:
                unknown.append(name)
                continue
            found = detections_in(evidence, name, self.degree)
            things += [each if ranges is None else replace(each, depth=depth_at(ranges, each)) for each in found]
        return SceneDetections(tuple(things), None, self.height, tuple(unknown))


def detections_in(evidence: Evidence, name: str, degree: int) -> list[Detection]:
    """The things in the evidence about `name`: peaks of its belief at which they are likelier than not."""
    belief = Belief.uniform(degree).update(evidence)
    directions, weights = belief.modes(MOST, PROMINENCE)
    above = to_numpy(belief.log_ratio(directions)) > 0
    found = []
    for where, weight in zip(directions[above], weights[above], strict=True):
        plain = Detection.at(name, where, weight=float(weight), contact=name not in HANGING)
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


def depth_at(ranges: np.ndarray, thing: Detection) -> float | None:
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

_Length = Annotated[float, msgspec.Meta(ge=0, le=_FARTHEST)]
_Place = Annotated[float, msgspec.Meta(ge=-_FARTHEST, le=_FARTHEST)]
_Outline = Annotated[list[tuple[_Place, _Place]], msgspec.Meta(min_length=3)]


class _Object(msgspec.Struct):
    name: str
    size: tuple[_Length, _Length, _Length]
    z_centre: _Place
    xy: tuple[_Place, _Place] | None = None
    corners: _Outline | None = None


class _Truth(msgspec.Struct):
    objects: list[_Object]
    camera: Annotated[float, msgspec.Meta(gt=0, le=_FARTHEST)] = HEIGHT
    walls: _Outline | None = None


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


@dataclass(frozen=True, eq=False)
class Room:
    """The things around a camera, its height above the floor (metres), and the foot of the walls if known."""

    bodies: tuple[Body, ...]
    camera: float = HEIGHT
    walls: FloorLine | None = None


def true_places(scene: Scene, names: Sequence[str], exact: bool) -> SceneDetections:
    """Detections from the truth in the scene's folder; `exact`: see `true_detections`."""
    room = read_room(scene.folder)
    if room is None:
        raise FormatError(f"{scene.folder} has no {FILE}, which the perception truth reads; name another perception")
    return SceneDetections(tuple(true_detections(room, names, exact)), room.walls, room.camera)


def true_detections(room: Room, names: Sequence[str] | None = None, exact: bool = True) -> list[Detection]:
    """The things (with these names) as the camera sees them, without any error.

    With `exact`, the foot is the floor point below the middle, as a labelled contact would be. Otherwise only the
    outline of the box is given, as from a detector, and the range has to be derived from its lower edge.
    """
    return [_detection(body, room.camera, exact) for body in room.bodies if names is None or body.name in names]


def _detection(body: Body, camera: float, exact: bool) -> Detection:
    centre, rim, stands = body.centre, body.footprint, body.low < TOUCHING
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
    foot = math.atan2(-camera, away) if exact and stands else None
    half = min((left - right) / 2, math.pi / 2)
    return Detection(body.name, azimuth, middle, bottom, top, half, foot, contact=stands)


def read_room(folder: Path) -> Room | None:
    """The room of a scene's folder; None without the file. Raises `FormatError` if it is not as described above."""
    path = folder / FILE
    if not path.is_file():
        return None
    try:
        truth = msgspec.convert(parsed(path.read_bytes(), strict=True), _Truth)
        line = None if truth.walls is None else FloorLine(_turned(np.array(truth.walls)))
        return Room(tuple(map(_body, truth.objects)), truth.camera, line)
    except (OSError, ValueError, msgspec.ValidationError, DirectionError) as error:
        raise FormatError(f"{path} is not a room ({type(error).__name__}: {error}); see {__name__}") from None


def _body(item: _Object) -> Body:
    if item.corners is None and item.xy is None:
        raise ValueError(f"{item.name!r} has neither corners nor xy; wanted its footprint, or its middle, in metres")
    half = np.array(item.size[:2]) / 2 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    corners = np.array(item.corners) if item.corners is not None else np.array([item.xy]) + half
    low = item.z_centre - item.size[2] / 2
    return Body(item.name, _turned(corners), low, item.z_centre + item.size[2] / 2)


def _turned(points: np.ndarray) -> np.ndarray:
    """From x right, y forward to x forward, y left ``(n, 2)``."""
    return np.stack([points[:, 1], -points[:, 0]], axis=1)
