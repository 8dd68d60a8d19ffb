"""The calibration of one perception, and the rates at which its targets change: what ``eagor calibrate`` writes."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import msgspec

from eagor._files import read_file, written
from eagor._json import parsed, shown
from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel, model_as_json
from eagor.perception import short_name
from eagor.perception.json_files import checked
from eagor.tracking.config import MotionModel

_WRITTEN = "wanted what `eagor calibrate` writes"
_DETECTOR = tuple(model_as_json(DetectorModel()))
READING = ("floor", "neutral", "temperature", "persistence", "spread")  # fields of `Calibration` that are fitted
FORGETTING = ("wander", "start", "stop", "jump", "birth", "death")  # of `MotionModel`: radians, rates per second


class _File(msgspec.Struct):
    perception: Annotated[str, msgspec.Meta(description="the name of a perception")]
    forgetting: Annotated[MotionModel, msgspec.Meta(description="an object")]
    calibration: Calibration | None = None
    detector: DetectorModel | None = None
    found_by: dict[str, Any] = {}


@dataclass(frozen=True)
class Calibrated:
    """The calibration of one perception.

    `perception`: its name, as `eagor.perception.load` reads it. `calibration`: of its response maps, `detector`: of
    its detections; None keeps the perception's own. `forgetting`: fields of `MotionModel`. `found_by`: the apartments,
    trials and scores of the fit, for information.
    """

    perception: str
    calibration: Calibration | None
    forgetting: dict[str, float | tuple[float, ...]] = field(default_factory=dict)
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
        return _calibrated(stored)
    except EagorError as error:
        raise EagorError(f"{source} is not a calibration: {error}; {_WRITTEN}") from error


def _calibrated(stored: Any) -> Calibrated:
    parts = {name: values for name, values in stored.items() if values is not None} if isinstance(stored, dict) else {}
    for name, known in (("calibration", READING), ("detector", _DETECTOR), ("forgetting", FORGETTING)):
        if isinstance(part := parts.get(name), dict) and (unknown := sorted(part.keys() - {*known})):
            raise EagorError(f"{name} sets {shown(', '.join(unknown))}; known are {', '.join(known)}")
    if isinstance(reading := parts.get("calibration"), dict) and (lacking := sorted({*READING} - reading.keys())):
        raise EagorError(f"calibration lacks {', '.join(lacking)}")
    if isinstance(rates := parts.get("forgetting"), dict) and "wander" in rates:
        wander = rates["wander"] if isinstance(rates["wander"], list | tuple) else [rates["wander"]]
        parts["forgetting"] = rates = rates | {"wander": [] if list(wander) == [0] else wander}
    found = checked(parts if isinstance(stored, dict) else stored, _File, "the file")
    if found.calibration is None and found.detector is None:
        raise EagorError("it has neither a calibration nor a detector")
    forgetting = {name: getattr(found.forgetting, name) for name in rates or ()}
    return Calibrated(found.perception, found.calibration, forgetting, found.found_by, found.detector)


def read_calibrated(file: Path) -> Calibrated:
    """The calibration in a file. Raises `EagorError` if it cannot be read or holds something else."""
    try:
        stored = parsed(read_file(file))
    except OSError as error:
        raise EagorError(f"the calibration {file} cannot be read ({error}); `eagor calibrate` makes one") from error
    except ValueError as error:
        raise EagorError(f"{file} is not JSON ({error}); {_WRITTEN}") from error
    return from_json(stored, str(file))
