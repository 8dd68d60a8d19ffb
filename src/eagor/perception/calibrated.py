"""What ``eagor calibrate`` reads and writes: labelled panoramas; the calibration of one perception, and its rates.

A file of labelled panoramas has one JSON object per line (JSON Lines, UTF-8)::

    {"image": "rooms/1.png", "query": "red chair", "azimuth_deg": 30.5, "elevation_deg": -12, "radius_deg": 6}
    {"image": "rooms/1.png", "query": "the sofa", "box": [310, 280, 420, 352]}

``image`` is a path, relative to the file's folder; the place is a direction (azimuth positive to the LEFT) with an
angular radius, or a box x0, y0, x1, y1 in the panorama's pixels (x0 > x1 means across the seam).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from eagor._checks import parsed, shown
from eagor._files import read_file, written
from eagor.errors import EagorError, FormatError, ResponseError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel, model_as_json
from eagor.evidence.shapes import moments
from eagor.grids import ErpGrid
from eagor.perception import short_name
from eagor.perception.json_files import Finite, Tilt, Turn, checked, need, object_of, parsed_lines
from eagor.perception.vlm import Labelled, phrase
from eagor.sphere import direction
from eagor.tracking.config import MotionModel

READING = ("floor", "neutral", "temperature", "persistence", "spread")  # fields of `Calibration` that are fitted
FORGETTING = ("wander", "start", "stop", "jump", "birth", "death")  # of `MotionModel`: radians, rates per second
_PARTS = {"calibration": READING, "detector": tuple(model_as_json(DetectorModel())), "forgetting": FORGETTING}


@dataclass(frozen=True)
class Calibrated:
    """The calibration of one perception.

    `perception`: its name, as `eagor.perception.load` reads it. `calibration`: of its response maps, `detector`: of
    its detections; None keeps the perception's own. `forgetting`: fields of `MotionModel`. `found_by`: the apartments,
    trials and scores of the fit, for information.
    """

    perception: str
    calibration: Calibration | None = None
    forgetting: dict[str, Any] = field(default_factory=dict)
    found_by: dict[str, Any] = field(default_factory=dict)
    detector: DetectorModel | None = None

    def reread(self, evidence: Evidence) -> Evidence:
        """`evidence` with this calibration, for callers that use no tracker."""
        if evidence.detections is not None and self.detector is not None:
            return evidence.with_detector(self.detector)
        return evidence if self.calibration is None else evidence.with_calibration(self.calibration)

    def fits(self, perception: str) -> bool:
        """Whether it belongs to this perception; options and record files are ignored."""
        return short_name(self.perception) == short_name(perception)

    def as_json(self) -> dict[str, Any]:
        """The JSON object that `from_json` reads."""
        parts: dict[str, Any] = {"perception": self.perception}
        if self.calibration is not None:
            parts["calibration"] = {key: getattr(self.calibration, key) for key in READING}
        if self.detector is not None:
            parts["detector"] = model_as_json(self.detector)
        return parts | {"forgetting": self.forgetting, "found_by": self.found_by}

    def write(self, file: Path) -> None:
        """Store it as JSON. Raises `StorageError` if it cannot be written."""
        written(file, json.dumps(self.as_json(), indent=1) + "\n")


def from_json(stored: Any, source: str) -> Calibrated:
    """The calibration from the output of `as_json`; errors name `source`. Raises `EagorError` for anything else."""
    try:
        parts = {key: part for key, part in stored.items() if part is not None} if isinstance(stored, dict) else {}
        for name, keys in _PARTS.items():
            if isinstance(part := parts.get(name), dict) and (unknown := sorted(part.keys() - {*keys})):
                raise EagorError(f"{name} sets {shown(', '.join(unknown))}; known are {', '.join(keys)}")
        if isinstance(reading := parts.get("calibration"), dict) and (lacking := sorted({*READING} - reading.keys())):
            raise EagorError(f"calibration lacks {', '.join(lacking)}")
        found = checked(parts if isinstance(stored, dict) else stored, Calibrated, "the file")
        motion = checked(parts.get("forgetting"), MotionModel, "forgetting")
        if found.calibration is None and found.detector is None:
            raise EagorError("it has neither a calibration nor a detector")
    except EagorError as error:
        raise EagorError(f"{source} is not a calibration: {error}; wanted what `eagor calibrate` writes") from error
    return replace(found, forgetting={name: getattr(motion, name) for name in found.forgetting})


def read_calibrated(file: Path) -> Calibrated:
    """The calibration in a file. Raises `EagorError` if it cannot be read or holds something else."""
    try:
        stored = parsed(read_file(file))
    except (OSError, ValueError) as error:
        raise EagorError(f"the calibration {file} cannot be read ({error}); `eagor calibrate` makes one") from error
    return from_json(stored, str(file))


# --- labelled panoramas for calibration -------------------------------------------------------------------------------


class _Line(msgspec.Struct):
    """A line: the place is a direction with a radius, degrees, or a box in pixels."""

    image: str
    query: str
    azimuth_deg: Turn = math.nan
    elevation_deg: Tilt = math.nan
    radius_deg: Annotated[float, msgspec.Meta(gt=0, le=90)] = math.nan
    box: tuple[Finite, Finite, Finite, Finite] | None = None  # x0, y0, x1, y1


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
    if found := list(parsed_lines(file, _parsed)):
        return found
    raise FormatError(f"{file} holds no labels; wanted one JSON object per line")


def read_labelled(file: Path, read: Callable[[Path], np.ndarray]) -> Iterator[Labelled]:
    """The labelled panoramas that a file lists, one image in memory at a time.

    `read` loads the panorama ``(H, 2 H, 3)`` uint8 of a path (`eagor.sources.panorama.read_panorama`). Raises
    `FormatError` for the file, and what `read` raises.
    """
    name, panorama = "", np.zeros((0, 0, 3), np.uint8)
    for line, where in labelled_lines(file):
        if name != line.image:
            name, panorama = line.image, read(Path(file).parent / line.image)
        if line.box is None:
            azimuth, elevation, radius = np.radians([line.azimuth_deg, line.elevation_deg, line.radius_deg]).tolist()
            yield Labelled(panorama, line.query, np.asarray(direction(azimuth, elevation)), radius)
            continue
        (height, width), (x0, y0, x1, y1) = panorama.shape[:2], line.box
        try:
            centre, _ = moments(np.array(line.box), ErpGrid(height, width))
        except ResponseError as error:
            raise FormatError(f"{where}: {error}") from error
        share = (x1 - x0 if x1 > x0 else x1 - x0 + width) / width
        top, bottom = (math.pi * (0.5 - min(max(y / height, 0.0), 1.0)) for y in (y0, y1))
        radius = cap_radius(2 * math.pi * share * (math.sin(top) - math.sin(bottom)))
        yield Labelled(panorama, line.query, centre, radius)


def cap_radius(solid_angle: float) -> float:
    """The angular radius (radians) of the cap with this solid angle (steradians)."""
    return math.acos(1 - min(max(solid_angle, 0.0), 4 * math.pi) / (2 * math.pi))
