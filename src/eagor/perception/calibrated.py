"""The calibration of one perception, and the rates at which its targets change: what ``eagor calibrate`` writes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from eagor._files import read_file, written
from eagor._json import number, parsed, shown
from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel, model_as_json
from eagor.perception import short_name
from eagor.tracking.config import MotionModel

READING = ("floor", "neutral", "temperature", "persistence", "spread")  # fields of `Calibration`
# What older versions wrote of response maps, and of detectors, whose places have habits now.
GONE = ("persists_for", "persists_within", "repeats", "repeats_for", "repeats_within")
FORGETTING = ("wander", "start", "stop", "jump", "birth", "death")  # fields of `MotionModel`: radians, rates per second


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
            told = asdict(self.calibration)
            parts["calibration"] = {key: told[key] for key in READING}
        if self.detector is not None:
            parts["detector"] = model_as_json(self.detector)
        return parts | {"forgetting": self.forgetting, "found_by": self.found_by}

    def write(self, file: Path) -> None:
        """Store it as JSON. Raises `StorageError` if it cannot be written."""
        written(file, json.dumps(self.as_json(), indent=1) + "\n")


def calibration_of(values: Mapping[str, Any]) -> Calibration:
    """The calibration with these values. Raises `KeyError` if one of `READING` is missing."""
    _only(values, READING)
    floor, neutral, temperature, persistence, spread = (number(values[name]) for name in READING)
    return Calibration(floor, neutral, temperature, persistence, spread)


def detector_of(values: Mapping[str, Any]) -> DetectorModel:
    """The detector model from the output of `model_as_json`. Raises `EagorError` for anything else."""
    _only(values, model_as_json(DetectorModel()))
    return DetectorModel(**{key: _field(key, value) for key, value in values.items()})


def _field(key: str, value: Any) -> Any:
    """A field of a detector's model from JSON."""
    if value is None:
        return None
    if key == "score_ratios":
        return tuple((number(score), number(ratio)) for score, ratio in value)
    if key in ("habit", "look_alike_habit"):
        return tuple(number(each) for each in value)
    return number(value)


def from_json(stored: Any, source: str) -> Calibrated:
    """The calibration from the output of `as_json`; errors name `source`. Raises `EagorError` for anything else."""
    try:
        _only(stored["forgetting"], FORGETTING)
        forgetting: dict[str, Any] = {
            key: _rates(value) if key == "wander" else number(value) for key, value in stored["forgetting"].items()
        }
        reading, model = stored.get("calibration"), stored.get("detector")
        if reading is None and model is None:
            raise EagorError("has neither a calibration nor a detector")
        calibration = None
        if reading is not None:
            calibration = calibration_of(reading)
        detector = None if model is None else detector_of(model)
        found = Calibrated(str(stored["perception"]), calibration, forgetting, {**stored.get("found_by", {})}, detector)
        MotionModel(**forgetting)  # raises for rates out of range
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, EagorError):
            raise EagorError(f"{source}: {error}") from error
        raise EagorError(
            f"{source} is not a calibration ({type(error).__name__}: {error}); wanted what `eagor calibrate` writes"
        ) from error
    return found


def _rates(value: Any) -> tuple[float, ...]:
    """Positive numbers from a list or a single number; 0 gives an empty tuple."""
    values = tuple(number(entry) for entry in (value if isinstance(value, list | tuple) else [value]))
    return () if values == (0,) else values


def _only(values: Mapping[str, Any], known: Any) -> None:
    """Raise `EagorError` for a name that is not in `known`."""
    if old := [key for key in GONE if key in values and key not in known]:
        raise EagorError(
            f"sets {', '.join(old)}, as older versions did (detectors have habit and look_alikes now): run "
            "`eagor calibrate` again, or leave these words out"
        )
    if unknown := sorted(values.keys() - {*known}):
        raise EagorError(f"sets {shown(', '.join(unknown))}; known are {', '.join(known)}")


def read_calibrated(file: Path) -> Calibrated:
    """The calibration in a file. Raises `EagorError` if it cannot be read or holds something else."""
    try:
        stored = parsed(read_file(file))
    except OSError as error:
        raise EagorError(f"the calibration {file} cannot be read ({error}); `eagor calibrate` makes one") from error
    except ValueError as error:
        raise EagorError(f"{file} is not JSON ({error}); wanted what `eagor calibrate` writes") from error
    return from_json(stored, str(file))
