"""What is truly around the camera of a scene, where somebody wrote it down: physical_truth.json.

The file is no part of the benchmark; scenes that we make have it, and so may others::

    {"frame": "x right, y forward (ERP centre), camera at origin, metres",
     "camera": 1.5,                                     height above the floor, optional
     "objects": [{"name": "sofa", "xy": [1.2, 2.0], "size": [0.9, 1.8, 0.8], "z_centre": 0.4,
                  "corners": [[x, y], ...]}, ...],      footprint, optional: else `size` along the axes
     "walls": [[x, y], ...]}                            foot of the walls, all around, optional

It gives sightings without any perception, to measure what is done with them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eagor._json import number, parsed, shown
from eagor.errors import FormatError
from eagor.sphere import wrap
from eagor.tasks.osr.geometry import FloorLine, Sighting

FILE = "physical_truth.json"
HEIGHT = 1.5  # metres of the camera above the floor, where nobody says
_FARTHEST = 1e6  # metres from the camera; more is a mistake
TOUCHING = 0.05  # metres above the floor: what begins below stands on it


@dataclass(frozen=True, eq=False)
class Body:
    """A thing: `name`, its footprint ``(n, 2)`` (x forward, y left, metres) and heights above the floor, metres."""

    name: str
    footprint: np.ndarray
    low: float
    high: float

    @property
    def centre(self) -> np.ndarray:
        """The middle of the footprint's bounds ``(2,)``."""
        return (self.footprint.min(axis=0) + self.footprint.max(axis=0)) / 2

    @property
    def stands(self) -> bool:
        """Whether it touches the floor."""
        return self.low < TOUCHING


@dataclass(frozen=True, eq=False)
class Room:
    """What is around a camera, its height above the floor (metres), and the foot of the walls where it is known."""

    bodies: tuple[Body, ...]
    camera: float = HEIGHT
    walls: FloorLine | None = None


def read_room(folder: Path) -> Room | None:
    """The room of a scene's folder; None without the file. Raises `FormatError` if it is not as above."""
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
        raise FormatError(f"{path} is no room ({type(error).__name__}: {error}); see eagor.tasks.osr.truth") from None


def write_room(room: Room, folder: Path) -> Path:
    """Write a room into a scene's folder."""
    objects = []
    for body in room.bodies:
        corners = _turned_back(body.footprint)
        size = np.ptp(corners, axis=0)
        objects.append(
            {
                "name": body.name,
                "xy": _rounded(_turned_back(body.centre[None])[0]),
                "size": [*_rounded(size), round(body.high - body.low, 4)],
                "z_centre": round((body.low + body.high) / 2, 4),
                "corners": [_rounded(corner) for corner in corners],
            }
        )
    entry: dict[str, Any] = {
        "frame": "x right, y forward (ERP centre), camera at origin, metres",
        "camera": room.camera,
        "objects": objects,
    }
    if room.walls is not None:
        entry["walls"] = [_rounded(point) for point in _turned_back(room.walls.points)]
    path = folder / FILE
    path.write_text(json.dumps(entry, indent=1) + "\n", encoding="utf-8")
    return path


def sightings(room: Room, names: Sequence[str] | None = None, exact: bool = True) -> list[Sighting]:
    """How the things (with these names) look from the camera, without any error.

    With `exact`, the foot is the floor point below the middle, as a labelled contact would be; else only the outline of
    the box is told, as a detector's box would, and the range has to be worked out from its lower edge.
    """
    return [_sighting(body, room.camera, exact) for body in room.bodies if names is None or body.name in names]


def _sighting(body: Body, camera: float, exact: bool) -> Sighting:
    centre = body.centre
    away = float(np.hypot(*centre))
    azimuth = math.atan2(centre[1], centre[0])
    middle = math.atan2((body.low + body.high) / 2 - camera, away)
    sides = wrap(np.arctan2(body.footprint[:, 1], body.footprint[:, 0]) - azimuth)
    reach = np.hypot(*body.footprint.T)
    closest = _closest(body.footprint)
    # Seen from above, the near rim is the lower; from below, the far one.
    bottom = math.atan2(body.low - camera, closest if body.low < camera else float(reach.max()))
    top = math.atan2(body.high - camera, float(reach.max()) if body.high < camera else closest)
    left, right = float(np.max(sides)), float(np.min(sides))
    if not exact and left - right < math.pi:
        azimuth += (left + right) / 2
    foot = math.atan2(-camera, away) if exact and body.stands else None
    return Sighting(
        body.name, azimuth, middle, bottom, top, min((left - right) / 2, math.pi / 2), foot, contact=body.stands
    )


def _closest(footprint: np.ndarray) -> float:
    """Metres from the camera to the nearest point of the footprint's rim."""
    way = np.roll(footprint, -1, axis=0) - footprint
    square = np.maximum((way * way).sum(axis=1), 1e-12)
    share = np.clip(-(footprint * way).sum(axis=1) / square, 0, 1)
    return float(np.hypot(*(footprint + share[:, None] * way).T).min())


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
        raise ValueError(f"{shown(written)} where points [x, y] in metres were wanted")
    return np.array(points)


def _turned(points: np.ndarray) -> np.ndarray:
    """From x right, y forward to x forward, y left."""
    return np.stack([points[:, 1], -points[:, 0]], axis=1)


def _turned_back(points: np.ndarray) -> np.ndarray:
    return np.stack([-points[:, 1], points[:, 0]], axis=1)


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(value), 4) for value in values]
