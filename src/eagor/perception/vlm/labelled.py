"""Labelled panoramas for calibration: where in a panorama the thing is that a query names.

A file of them has one JSON object per line (JSON Lines, UTF-8)::

    {"image": "rooms/1.png", "query": "red chair", "azimuth_deg": 30.5, "elevation_deg": -12, "radius_deg": 6}
    {"image": "rooms/1.png", "query": "the sofa", "box": [310, 280, 420, 352]}

``image`` is a path, relative to the file's folder; the place is a direction (azimuth positive to the LEFT) with an
angular radius, or a box x0, y0, x1, y1 in the panorama's pixels (x0 > x1 means across the seam).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eagor._files import read_file
from eagor._json import number, parsed, shown
from eagor.errors import FormatError, ResponseError
from eagor.evidence.shapes import moments
from eagor.grids import ErpGrid
from eagor.perception.vlm.prompts import phrase
from eagor.sphere import direction


@dataclass(frozen=True, eq=False)
class Labelled:
    """A panorama ``(H, W, 3)`` uint8, a query, and the direction ``(3,)`` and angular radius of its target."""

    panorama: np.ndarray
    query: str
    direction: np.ndarray
    radius: float


def labelled_lines(file: Path) -> list[tuple[int, dict[str, Any]]]:
    """The numbered lines of a file of labelled panoramas, checked except for the images. Raises `FormatError`."""
    try:
        text = read_file(file).decode("utf-8-sig")
    except (OSError, ValueError) as error:
        raise FormatError(f"{file} cannot be read ({error}); give the path of a JSONL file of labels") from error
    found = []
    for row, line in enumerate(text.split("\n"), start=1):
        if line.strip():
            try:
                found.append((row, _checked(line)))
            except (ValueError, TypeError, KeyError) as error:
                raise FormatError(f"{file}, line {row}: {_reason(error)}") from error
    if not found:
        raise FormatError(f"{file} holds no labels; wanted one JSON object per line")
    return found


def read_labelled(file: Path, read: Callable[[Path], np.ndarray]) -> Iterator[Labelled]:
    """The labelled panoramas that a file lists, one image in memory at a time.

    `read` loads the panorama ``(H, 2 H, 3)`` uint8 of a path (`eagor.media.panorama.read_panorama`). Raises
    `FormatError` for the file, and what `read` raises.
    """
    last: tuple[Path, np.ndarray] | None = None
    for row, entry in labelled_lines(file):
        path = Path(file).parent / entry["image"]
        if last is None or last[0] != path:
            last = path, read(path)
        panorama = last[1]
        if "box" in entry:
            grid = ErpGrid(*panorama.shape[:2])
            try:
                centre, _ = moments(np.array(entry["box"], dtype=float), grid)
            except ResponseError as error:
                raise FormatError(f"{file}, line {row}: {error}") from error
            yield Labelled(panorama, entry["query"], centre, _radius(entry["box"], grid))
        else:
            azimuth, elevation, radius = (
                math.radians(entry[f"{key}_deg"]) for key in ("azimuth", "elevation", "radius")
            )
            yield Labelled(panorama, entry["query"], np.asarray(direction(azimuth, elevation)), radius)


def cap_radius(solid_angle: float) -> float:
    """The angular radius (radians) of the cap with this solid angle (steradians)."""
    return math.acos(1 - min(max(solid_angle, 0.0), 4 * math.pi) / (2 * math.pi))


def _radius(box: list[float], grid: ErpGrid) -> float:
    x0, y0, x1, y1 = box
    width = (x1 - x0 if x1 > x0 else x1 - x0 + grid.width) / grid.width
    top, bottom = (math.pi * (0.5 - min(max(y / grid.height, 0.0), 1.0)) for y in (y0, y1))
    return cap_radius(2 * math.pi * width * (math.sin(top) - math.sin(bottom)))


def _checked(line: str) -> dict[str, Any]:
    try:
        entry = parsed(line)
    except ValueError as error:
        raise FormatError(f"is not JSON ({error}); wanted one JSON object") from None
    if not isinstance(entry, dict):
        raise TypeError(f"is {type(entry).__name__}; wanted an object with image, query and a place")
    phrase(entry["query"])
    if not isinstance(entry["image"], str):
        raise TypeError(f"image is {shown(entry['image'])}; wanted a path")
    if "box" in entry:
        if not isinstance(entry["box"], list) or len(entry["box"]) != 4:
            raise ValueError(f"box is {shown(entry['box'])}; wanted [x0, y0, x1, y1] in pixels")
        return {"image": entry["image"], "query": entry["query"], "box": [number(value) for value in entry["box"]]}
    angles = {key: number(entry[key]) for key in ("azimuth_deg", "elevation_deg", "radius_deg")}
    if not (abs(angles["azimuth_deg"]) <= 360 and abs(angles["elevation_deg"]) <= 90):
        raise ValueError(f"the place is {angles}; wanted degrees, the azimuth to 360, the elevation to 90 either way")
    if not 0 < angles["radius_deg"] <= 90:
        raise ValueError(f"radius_deg is {angles['radius_deg']:g}; wanted more than 0, at most 90")
    return {"image": entry["image"], "query": entry["query"], **angles}


def _reason(error: Exception) -> str:
    if isinstance(error, KeyError):
        return f"{error.args[0]!r} is missing; wanted image, query, and box or azimuth_deg, elevation_deg, radius_deg"
    return str(error)[:300]
