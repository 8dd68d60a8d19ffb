"""Shared by the benchmarks with published data, H*Bench and OSR-Bench."""

from __future__ import annotations

import math
import warnings
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.sphere import world_R_body
from eagor.tasks.benchmark import Record
from eagor.tasks.models import recalibration
from eagor.tasks.places import Place


def finished(records: Iterable[Record], wanted: str) -> list[Record]:
    """The records of finished cases. Raises `EagorError` with what is `wanted` if there are none."""
    done = [record for record in records if record.get("status", "ok") == "ok"]
    if not done:
        raise EagorError(f"{wanted}; name a run with results")
    return done


def reader(settings: Mapping[str, Any]) -> Callable[[Evidence], Evidence]:
    """The recalibration of looks in a run: from its settings, otherwise none."""
    calibrated = recalibration(settings)
    return calibrated.reread if calibrated is not None else lambda evidence: evidence


def luck(seed: int, case: str) -> list[int]:
    """The seed of one case; independent of all other cases."""
    return [seed, zlib.crc32(case.encode())]


def picture_size(file: Path | IO[bytes], upright: bool = False) -> tuple[int, int] | None:
    """Width and height of a picture, None if it cannot be read; `upright`: after its orientation tag was followed."""
    from PIL import Image

    from eagor.media.panorama import FORMATS, ORIENTATION

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with Image.open(file, formats=FORMATS) as picture:
                turned = upright and picture.getexif().get(ORIENTATION, 1) >= 5  # by a quarter
                width, height = picture.size
                return (height, width) if turned else (width, height)
        except Exception:  # decoders may raise anything for damaged files
            return None


def save_panorama(place: Place, position: np.ndarray, yaw: float, rows: int, path: Path) -> None:
    """Save what a camera at `position` ``(3,)`` sees of a place, as a panorama of `rows` rows."""
    from PIL import Image

    rgb = place.renderer.panorama(position, world_R_body(yaw), rows, range=False, ids=False).rgb
    assert rgb is not None
    Image.fromarray(rgb).save(path)


def any_yaw(rng: np.random.Generator) -> float:
    """A uniform random angle (radians)."""
    return float(rng.uniform(-math.pi, math.pi))
