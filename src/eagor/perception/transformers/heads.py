"""From captured attention to responses, and the heads that attend to what is asked for.

With localisation heads the map is the attention of a few heads, relative to uniform attention. Without them it is
relative attention (Zhang et al., ICLR 2025, arXiv 2502.17422): attention for the question over attention for a question
without content. That removes attention sinks, the background tokens that get attention whatever is asked (Kang et al.,
arXiv 2503.03321).

Some heads attend to what is asked for (Kang et al., arXiv 2503.06287). They are found on labelled panoramas, as those
with the most attention on the targets; the result is a small JSON file per model.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from eagor._checks import parsed
from eagor._files import read_file, written
from eagor.errors import EagorError
from eagor.grids import Grid, PatchGrid
from eagor.perception.json_files import checked, need
from eagor.perception.things import blurred
from eagor.sphere import angular_distance

SATURATION = 2.0  # excess of the ratio over 1 at which the response is one half
_EARLIEST = 2  # layers before this one attend to tokens, not yet to things
_LEAST = 1.05  # least attention on the targets, relative to uniform: anything lower is rounding or luck
_AIM = 0.7  # response to a typical labelled target

Maps = Mapping[int, np.ndarray]  # layer to the attention (..., H, h, w) of its heads per cell
Names = Sequence[tuple[int, int]]  # heads: (layer, head)


def of_heads(maps: Maps, heads: Names) -> np.ndarray:
    """Mean attention ``(..., h, w)`` of some heads, each first scaled to a mean of 1 over the cells."""
    return np.mean([densities(maps[layer][..., head, :, :]) for layer, head in heads], axis=0)


def densities(cells: np.ndarray) -> np.ndarray:
    """`cells` ``(..., h, w)`` divided by their mean; ones where they are all zero."""
    mean = cells.mean(axis=(-2, -1), keepdims=True)
    return np.where(mean > 0, cells / np.where(mean > 0, mean, 1.0), 1.0)


def relative(asked: np.ndarray, general: np.ndarray) -> np.ndarray:
    """The ratio ``(B, h, w)`` of two attention maps; 1 where the question makes no difference.

    The median of the general map is added to both, since the plain ratio explodes where nothing gets attention.
    """
    floor = np.maximum(np.median(general, axis=(-2, -1), keepdims=True), np.finfo(np.float32).tiny)
    return (asked + floor) / (general + floor)


def saturated(ratio: np.ndarray, saturation: float = SATURATION, wrap: bool = True) -> np.ndarray:
    """A response in [0, 1), float32, from a ratio ``(..., h, w)``: x / (x + saturation) for an excess x over 1.

    The scale is fixed. Scaling by the map's own maximum would turn "nothing here" into a detection. The ratio is
    blurred over 3 x 3 cells first; `wrap` if the left and right edge meet.
    """
    excess = np.maximum(blurred(ratio, wrap) - 1.0, 0.0)
    return (excess / (excess + saturation)).astype(np.float32)


@dataclass(frozen=True)
class Heads:
    """Localisation heads (layer, head) of one model, best first; `model_type` as in its configuration.

    `saturation`: the excess over uniform attention at which the response is one half. `found_by`: for information.
    """

    model: str
    model_type: str
    heads: tuple[tuple[int, int], ...]
    saturation: float
    found_by: dict[str, Any] = field(default_factory=dict)

    def write(self, file: Path) -> None:
        """Store it as JSON. Raises `StorageError` if it cannot be written."""
        written(file, json.dumps(asdict(self), indent=1) + "\n")


def read_heads(file: str | Path) -> Heads:
    """The heads in a file. Raises `EagorError` if it cannot be read or holds something else."""
    try:
        found = checked(parsed(read_file(file)), Heads, "the file")
        usable = len(found.heads) > 0 and min(map(min, found.heads)) >= 0
        need(usable, "heads", found.heads, "pairs (layer, head), from 0 on")
        need(0 < found.saturation < math.inf, "saturation", found.saturation, "a number above 0")
        return found
    except (OSError, ValueError) as error:
        raise EagorError(
            f"{file} cannot be read as localisation heads ({error}); wanted what `eagor calibrate heads` writes"
        ) from error


@dataclass(frozen=True, eq=False)
class Observed:
    """The attention of all heads for one labelled panorama, or for the view of it that shows the target best.

    `maps`: layer to attention ``(H, h, w)`` per cell of `grid`. `direction` ``(3,)``, `radius` (radians): the target.
    """

    maps: dict[int, np.ndarray]
    grid: Grid
    direction: np.ndarray
    radius: float

    @property
    def near(self) -> np.ndarray:
        """The cells ``(h, w)`` of the target: those within its radius, at least the nearest."""
        angle = np.asarray(angular_distance(self.grid.directions, self.direction))
        return (angle <= self.radius) | (angle <= angle.min() + 1e-12)

    def mean(self, heads: Names) -> np.ndarray:
        """The mean map ``(h, w)`` of some heads, before saturation."""
        return blurred(of_heads(self.maps, heads), isinstance(self.grid, PatchGrid))

    def error(self, heads: Names) -> float:
        """The angle (radians) between the target and the maximum of the mean map of these heads."""
        return float(angular_distance(self.grid.directions.reshape(-1, 3)[self.mean(heads).argmax()], self.direction))


def fit_heads(observed: Sequence[Observed], model: str, model_type: str, take: int = 3) -> Heads:
    """The localisation heads in what a model observed on labelled panoramas.

    With nine panoramas or more, every third is held out to measure the error of the heads. Raises `EagorError` if there
    are no panoramas, or no head attends to the targets more than elsewhere.
    """
    if not observed:
        raise EagorError("there are no labelled panoramas; give 20 or more")
    held_out = observed[2::3] if len(observed) >= 9 else ()
    looks = [look for index, look in enumerate(observed) if not held_out or index % 3 != 2]
    layers = [layer for layer in looks[0].maps if layer >= _EARLIEST] or list(looks[0].maps)
    gains: dict[tuple[int, int], float] = {}
    for layer in layers:
        on_target = [densities(look.maps[layer])[:, look.near].mean(axis=1) for look in looks]
        gains |= {(layer, head): gain for head, gain in enumerate(np.median(on_target, axis=0).tolist())}
    chosen = [name for name in sorted(gains, key=lambda name: -gains[name]) if gains[name] > _LEAST][:take]
    if not chosen:
        raise EagorError(
            f"no head of {model} looks at the labelled targets more than elsewhere (best: {max(gains.values()):.2f} "
            f"times uniform attention, over {len(looks)} panoramas). Try more panoramas, larger pictures, or another "
            "extractor"
        )
    peaks = [float(look.mean(chosen)[look.near].max()) for look in looks]
    saturation = max(float(np.median(peaks)) - 1.0, 0.1) * (1 - _AIM) / _AIM
    figures = [{"head": list(name), "gain": gains[name]} for name in chosen]
    found_by: dict[str, Any] = {"panoramas": len(looks), "of": len(gains), "heads": figures}
    if held_out:
        error = round(math.degrees(np.median([look.error(chosen) for look in held_out])), 2)
        found_by["held_out"] = {"panoramas": len(held_out), "median_error_deg": error}
    return Heads(model, model_type, tuple(chosen), saturation, found_by)
