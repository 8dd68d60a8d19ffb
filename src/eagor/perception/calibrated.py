"""How to read a perception and how to forget what it saw: what ``eagor calibrate`` writes and other commands take."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from eagor._files import written
from eagor._json import number, parsed, shown
from eagor.calibration import Calibration
from eagor.errors import EagorError
from eagor.estimate import TrackerConfig

READING = ("floor", "neutral", "temperature", "persistence", "spread")  # fields of `Calibration`
FORGETTING = ("keep_per_second", "wander", "restless", "surest", "settle")  # fields of `TrackerConfig`, SI, nats


@dataclass(frozen=True)
class Calibrated:
    """A calibration, and the fields of `TrackerConfig` that were fitted with it.

    `found_by`: apartments, trials and scores, for people.
    """

    perception: str
    calibration: Calibration
    forgetting: dict[str, float]
    found_by: dict[str, Any] = field(default_factory=dict)

    def config(self, base: TrackerConfig | None = None) -> TrackerConfig:
        """`base` (default: the default tracker) with what was fitted."""
        return replace(base or TrackerConfig(), calibration=self.calibration, **self.forgetting)

    def as_json(self) -> dict[str, Any]:
        """As it is stored."""
        reading = {key: value for key, value in asdict(self.calibration).items() if key in READING}
        parts = {"calibration": reading, "forgetting": self.forgetting, "found_by": self.found_by}
        return {"perception": self.perception, **parts}

    def write(self, file: Path) -> None:
        """Store it as JSON. Raises `StorageError` if the disk does not take it."""
        written(file, json.dumps(self.as_json(), indent=1) + "\n")


def calibration_of(values: Mapping[str, float]) -> Calibration:
    """The calibration with these numbers. Raises `KeyError` if one of `READING` is missing."""
    floor, neutral, temperature, persistence, spread = (values[name] for name in READING)
    return Calibration(floor, neutral, temperature, persistence, spread)


def from_json(stored: Any, source: str) -> Calibrated:
    """The calibration in what `as_json` gave; `source` is for errors. Raises `EagorError` for anything else."""
    try:
        reading, forgetting = (
            {key: number(value) for key, value in stored[part].items()} for part in ("calibration", "forgetting")
        )
        unknown = sorted((reading.keys() - {*READING}) | (forgetting.keys() - {*FORGETTING}))
        if unknown:
            raise EagorError(f"sets {shown(', '.join(unknown))}; known are {', '.join((*READING, *FORGETTING))}")
        found_by = {**stored.get("found_by", {})}
        found = Calibrated(str(stored["perception"]), calibration_of(reading), forgetting, found_by)
        found.config()  # complains about numbers that are out of range
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, EagorError):
            raise EagorError(f"{source}: {error}") from error
        raise EagorError(
            f"{source} is no calibration ({type(error).__name__}: {error}); wanted what `eagor calibrate` writes"
        ) from error
    return found


def read_calibrated(file: Path) -> Calibrated:
    """The calibration in a file. Raises `EagorError` if it cannot be read or is something else."""
    try:
        stored = parsed(Path(file).read_bytes())
    except OSError as error:
        raise EagorError(f"the calibration {file} cannot be read ({error}); `eagor calibrate` makes one") from error
    except ValueError as error:
        raise EagorError(f"{file} is no JSON ({error}); wanted what `eagor calibrate` writes") from error
    return from_json(stored, str(file))
