"""Labelled panoramas for calibration: where in a panorama the thing is that a query names.

A file of them has one JSON object per line (JSON Lines, UTF-8)::

    {"image": "rooms/1.png", "query": "red chair", "azimuth_deg": 30.5, "elevation_deg": -12, "radius_deg": 6}
    {"image": "rooms/1.png", "query": "the sofa", "box": [310, 280, 420, 352]}

``image`` is a path, relative to the file's folder; the place is a direction (azimuth positive to the LEFT) with an
angular radius, or a box x0, y0, x1, y1 in the panorama's pixels (x0 > x1 means across the seam).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from eagor.errors import FormatError, ResponseError
from eagor.evidence.shapes import moments
from eagor.grids import ErpGrid
from eagor.perception.json_files import Finite, Tilt, Turn, checked, need, object_of, parsed_lines
from eagor.perception.vlm import phrase
from eagor.sphere import direction

_CORNERS = msgspec.Meta(description="[x0, y0, x1, y1] in pixels")


@dataclass(frozen=True, eq=False)
class Labelled:
    """A panorama ``(H, W, 3)`` uint8, a query, and the direction ``(3,)`` and angular radius of its target."""

    panorama: np.ndarray
    query: str
    direction: np.ndarray
    radius: float


class _Line(msgspec.Struct):
    """A line: the place is a direction with a radius, degrees, or a box in pixels."""

    image: Annotated[str, msgspec.Meta(description="a path")]
    query: Annotated[str, msgspec.Meta(description="words")]
    azimuth_deg: Turn = math.nan
    elevation_deg: Tilt = math.nan
    radius_deg: Annotated[float, msgspec.Meta(gt=0, le=90, description="more than 0, at most 90")] = math.nan
    box: Annotated[tuple[Finite, Finite, Finite, Finite] | None, _CORNERS] = None


def _parsed(line: bytes) -> _Line:
    found = checked(object_of(line), _Line, "the line")
    phrase(found.query)  # raises for a query without words
    for key in ("azimuth_deg", "elevation_deg", "radius_deg") if found.box is None else ():
        need(not math.isnan(getattr(found, key)), key, None, "the three angles of a place, or a box")
    return found


def labelled_lines(file: Path) -> list[tuple[_Line, str]]:
    """The lines of a file of labelled panoramas, checked except for the images, and where they stand.

    Raises `FormatError`.
    """
    found = list(parsed_lines(file, _parsed))
    if not found:
        raise FormatError(f"{file} holds no labels; wanted one JSON object per line")
    return found


def read_labelled(file: Path, read: Callable[[Path], np.ndarray]) -> Iterator[Labelled]:
    """The labelled panoramas that a file lists, one image in memory at a time.

    `read` loads the panorama ``(H, 2 H, 3)`` uint8 of a path (`eagor.media.panorama.read_panorama`). Raises
    `FormatError` for the file, and what `read` raises.
    """
    last: tuple[Path, np.ndarray] | None = None
    for line, where in labelled_lines(file):
        path = Path(file).parent / line.image
        if last is None or last[0] != path:
            last = path, read(path)
        panorama = last[1]
        if line.box is not None:
            grid = ErpGrid(*panorama.shape[:2])
            try:
                centre, _ = moments(np.array(line.box), grid)
            except ResponseError as error:
                raise FormatError(f"{where}: {error}") from error
            yield Labelled(panorama, line.query, centre, _radius(line.box, grid))
        else:
            azimuth, elevation, radius = np.radians([line.azimuth_deg, line.elevation_deg, line.radius_deg]).tolist()
            yield Labelled(panorama, line.query, np.asarray(direction(azimuth, elevation)), radius)


def cap_radius(solid_angle: float) -> float:
    """The angular radius (radians) of the cap with this solid angle (steradians)."""
    return math.acos(1 - min(max(solid_angle, 0.0), 4 * math.pi) / (2 * math.pi))


def _radius(box: Sequence[float], grid: ErpGrid) -> float:
    x0, y0, x1, y1 = box
    width = (x1 - x0 if x1 > x0 else x1 - x0 + grid.width) / grid.width
    top, bottom = (math.pi * (0.5 - min(max(y / grid.height, 0.0), 1.0)) for y in (y0, y1))
    return cap_radius(2 * math.pi * width * (math.sin(top) - math.sin(bottom)))
