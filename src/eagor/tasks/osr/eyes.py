"""What is seen in a scene's picture: sightings of every category, from a belief per category, or from the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from eagor._arrays import to_numpy
from eagor.belief import Belief
from eagor.detections import MIN_SPREAD
from eagor.errors import FormatError, QueryError
from eagor.evidence import Evidence
from eagor.grids import ErpGrid
from eagor.perception import Perception
from eagor.perception.calibrated import Calibrated
from eagor.tasks.osr.dataset import Scene
from eagor.tasks.osr.geometry import HANGING, FloorLine, Sighting
from eagor.tasks.osr.truth import FILE, HEIGHT, read_room, sightings

MOST = 9  # things of one category
PROMINENCE = 0.5  # nats by which one thing has to stand out from the next
SKIRT = 0.35  # the part of a response around a peak that is taken for the thing: down to this share of the peak
NEAR = math.radians(50)
CELLS = 6  # as many numbers as a bump has
DEPTH_FILE = "depth.npy"


@dataclass(frozen=True, eq=False)
class Seen:
    """What is around: `things`, the foot of the walls where known, and the camera's height above the floor (metres).

    `strange`: names that meant nothing to the perception.
    """

    things: tuple[Sighting, ...]
    walls: FloorLine | None = None
    height: float = HEIGHT
    strange: tuple[str, ...] = ()


class Looker(Protocol):
    """Looks at a scene for things with these names."""

    def __call__(self, scene: Scene, names: Sequence[str]) -> Seen: ...


@dataclass(frozen=True)
class TruthLooker:
    """Sightings from the file of true places (`eagor.tasks.osr.truth`) in the scene's folder.

    With `exact`, feet are those below the middles of things; else only outlines are told.
    """

    exact: bool = True

    def __call__(self, scene: Scene, names: Sequence[str]) -> Seen:
        room = read_room(scene.folder)
        if room is None:
            raise FormatError(
                f"{scene.folder} has no {FILE}, which the perception truth reads; name another perception"
            )
        return Seen(tuple(sightings(room, names, self.exact)), room.walls, room.camera)


@dataclass(frozen=True, eq=False)
class BeliefLooker:
    """Sightings from a perception: its evidence for a category makes a belief, whose peaks are the things.

    `degree` of the belief; `height` of the camera above the floor, metres; `depth`: take ranges (metres along the ray,
    an equirectangular array (H, W), 0 or infinite where nobody knows) from depth.npy in the scene's folder;
    `calibrated`: how looks are read, None for as the perception does.
    """

    perception: Perception
    degree: int = 15
    height: float = HEIGHT
    depth: bool = False
    calibrated: Calibrated | None = None

    def __call__(self, scene: Scene, names: Sequence[str]) -> Seen:
        from eagor.worlds.panorama import read_panorama

        panorama = read_panorama(scene.picture)
        ranges = read_depth(scene.folder) if self.depth else None
        if self.depth and ranges is None:
            raise FormatError(f"{scene.folder} has no {DEPTH_FILE}; put one there, or take ranges from the floor")
        things: list[Sighting] = []
        strange = []
        for name in names:
            try:
                evidence = self.perception(panorama, name.replace("_", " "), stamp=0.0)
            except QueryError:
                strange.append(name)
                continue
            if self.calibrated is not None:
                evidence = self.calibrated.reread(evidence)
            found = sightings_in(evidence, name, self.degree)
            things += [each if ranges is None else replace(each, depth=depth_at(ranges, each)) for each in found]
        return Seen(tuple(things), None, self.height, tuple(strange))


def sightings_in(evidence: Evidence, name: str, degree: int) -> list[Sighting]:
    """The things that one evidence about `name` shows: peaks of its belief at which they are likelier than not."""
    belief = Belief.uniform(degree).update(evidence)
    directions, weights = belief.modes(MOST, PROMINENCE)
    above = to_numpy(belief.log_ratio(directions)) > 0
    found = []
    for where, weight in zip(directions[above], weights[above], strict=True):
        across = extent(evidence, where)
        plain = Sighting.at(name, where, weight=float(weight), contact=name not in HANGING)
        if across is not None:
            wide, tall = across
            bottom, top = max(plain.elevation - tall, -math.pi / 2), min(plain.elevation + tall, math.pi / 2)
            turn = min(wide / max(math.cos(plain.elevation), 0.2), math.pi / 2)
            plain = replace(plain, bottom=bottom, top=top, half_width=turn)
        found.append(plain)
    return found


def extent(evidence: Evidence, where: np.ndarray) -> tuple[float, float] | None:
    """Half width and half height (radians) of the thing whose response peaks near `where` ``(3,)``; None if too coarse.

    The response around the peak is taken for the bump of a box: a Gaussian whose variances are those of the box, a
    third of its squared half sides, widened by `eagor.detections.MIN_SPREAD`. Its logarithm is fitted by a quadratic.
    """
    response = np.asarray(to_numpy(evidence.response), dtype=np.float64).reshape(-1)
    cells = evidence.grid.directions.reshape(-1, 3)
    up = np.array([0.0, 0.0, 1.0]) - where[2] * where
    if np.linalg.norm(up) < 0.1:
        return None  # straight above or below, sides have no direction
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
        found = np.lib.format.open_memmap(path, mode="r")  # mapped: a header may claim more than is there
    except Exception as error:  # its header is Python, which may be wrong in many ways
        raise FormatError(f"{path} cannot be read as a NumPy array ({type(error).__name__}: {error})") from None
    if found.ndim != 2 or found.dtype.kind not in "fiu" or not found.size:
        raise FormatError(f"{path} has shape {found.shape}, {found.dtype}; wanted ranges (H, W) in metres")
    return np.array(found)


def depth_at(ranges: np.ndarray, thing: Sighting) -> float | None:
    """The median range (metres along the ray) over the middle of a thing; None where nothing was measured."""
    x, y, _ = ErpGrid(*ranges.shape).project(thing.direction)
    tall = (thing.top - thing.bottom) / 4 if thing.top is not None and thing.bottom is not None else math.radians(1)
    rows = max(1, round(tall / math.pi * ranges.shape[0]))
    columns = max(1, round(thing.half_width / 2 / (2 * math.pi) * ranges.shape[1]))
    i = np.clip(int(y) + np.arange(-rows, rows + 1), 0, ranges.shape[0] - 1)
    j = (int(x) + np.arange(-columns, columns + 1)) % ranges.shape[1]
    part = np.asarray(ranges[np.ix_(i, j)], dtype=np.float64)
    part = part[np.isfinite(part) & (part > 0)]
    return float(np.median(part)) if len(part) else None
