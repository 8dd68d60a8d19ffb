"""Responses from captured attention, and the localisation heads of a frozen model.

With localisation heads the map is the attention of a few heads, relative to uniform attention. Without them it is
relative attention (Zhang et al., ICLR 2025, arXiv 2502.17422): attention for the question over attention for a question
without content. That removes attention sinks, the background tokens that get attention whatever is asked (Kang et al.,
arXiv 2503.03321).

Localisation heads attend to what is asked for. They are found as by Kang et al. (arXiv 2503.06287). First, heads with
enough attention on the image (at or above the elbow of the sorted sums) are ranked by how often their maps are among
the least scattered (spatial entropy of the connected regions). Then, as directions are known here, the shortlist is
sorted by the attention on the target. The result is a small JSON file per model.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from eagor._files import read_file, written
from eagor._json import parsed
from eagor._lazy import lazy
from eagor.errors import EagorError
from eagor.grids import Grid, PatchGrid
from eagor.perception.json_files import checked, need
from eagor.perception.things import blurred, connected
from eagor.perception.transformers.inputs import Layout
from eagor.sphere import angular_distance, unit

SATURATION = 2.0  # excess of the ratio over 1 at which the response is one half


def mean_over_heads(rows: Mapping[int, torch.Tensor], layout: Layout) -> np.ndarray:
    """Attention per cell ``(B, h, w)``, the mean over all captured layers and heads."""
    total = sum(tensor.mean(dim=1).cpu().numpy().astype(np.float64) for tensor in rows.values())
    return layout.cells(np.asarray(total) / len(rows))


def of_heads(rows: Mapping[int, torch.Tensor], heads: Sequence[tuple[int, int]], layout: Layout) -> np.ndarray:
    """Mean attention ``(B, h, w)`` of some (layer, head), each first scaled to a mean of 1 over the cells."""
    maps = [layout.cells(rows[layer][:, head].cpu().numpy().astype(np.float64)) for layer, head in heads]
    return np.mean([densities(one) for one in maps], axis=0)


def densities(cells: np.ndarray) -> np.ndarray:
    """`cells` ``(..., h, w)`` divided by their mean; ones where they are all zero."""
    mean = cells.mean(axis=(-2, -1), keepdims=True)
    return np.where(mean > 0, cells / np.where(mean > 0, mean, 1.0), 1.0)


def relative(asked: np.ndarray, general: np.ndarray) -> np.ndarray:
    """The ratio ``(B, h, w)`` of two attention maps; 1 where the question makes no difference.

    The median of the general map is added to both, since the plain ratio explodes where nothing gets attention.
    """
    floor = np.median(general, axis=(-2, -1), keepdims=True)
    floor = np.maximum(floor, np.finfo(np.float32).tiny)
    return (asked + floor) / (general + floor)


def saturated(ratio: np.ndarray, saturation: float = SATURATION, wrap: bool = True) -> np.ndarray:
    """A response in [0, 1), float32, from a ratio ``(..., h, w)``: x / (x + saturation) for an excess x over 1.

    The scale is fixed. Scaling by the map's own maximum would turn "nothing here" into a detection. The ratio is
    blurred over 3 x 3 cells first; `wrap` if the left and right edge meet.
    """
    excess = np.maximum(blurred(ratio, wrap) - 1.0, 0.0)
    return (excess / (excess + saturation)).astype(np.float32)


# --- localisation heads -----------------------------------------------------------------------------------------------

TAKE = 3
SHORTLIST = 10
_EARLIEST = 2  # layers before this one attend to tokens, not yet to things
_LEAST = 1.05  # least attention on the targets, relative to uniform: anything lower is rounding or luck
_AIM = 0.7  # response to a typical labelled target


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

    @property
    def layers(self) -> tuple[int, ...]:
        """The layers of the heads."""
        return tuple(sorted({layer for layer, _ in self.heads}))

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
    except OSError as error:
        raise EagorError(f"the heads {file} cannot be read ({error}); make them: `eagor calibrate heads`") from error
    except ValueError as error:
        raise EagorError(
            f"{file} holds no localisation heads ({error}); wanted what `eagor calibrate heads` writes"
        ) from error


@dataclass(frozen=True, eq=False)
class Observed:
    """The attention of all heads for one labelled panorama, or for the view of it that shows the target best.

    `maps`: layer to attention ``(H, h, w)`` per cell of `grid`. `mass`: layer to the share of attention ``(H,)`` on
    the image. `direction` ``(3,)`` and `radius` (radians): of the target.
    """

    maps: dict[int, np.ndarray]
    mass: dict[int, np.ndarray]
    grid: Grid
    direction: np.ndarray
    radius: float

    @property
    def wrap(self) -> bool:
        """Whether the left and right edge of the picture meet."""
        return isinstance(self.grid, PatchGrid)

    @lazy
    def near(self) -> np.ndarray:
        """The cells ``(h, w)`` of the target: those within its radius, at least the nearest."""
        angle = np.asarray(angular_distance(self.grid.directions, unit(np.asarray(self.direction, dtype=float))))
        return (angle <= self.radius) | (angle <= angle.min() + 1e-12)

    def mean(self, heads: Sequence[tuple[int, int]]) -> np.ndarray:
        """The mean map ``(h, w)`` of some (layer, head), before saturation."""
        return blurred(np.mean([densities(self.maps[layer][head]) for layer, head in heads], axis=0), self.wrap)

    def error(self, heads: Sequence[tuple[int, int]]) -> float:
        """The angle (radians) between the target and the maximum of the mean map of these heads."""
        cells = self.mean(heads)
        best = self.grid.directions[np.unravel_index(np.argmax(cells), cells.shape)]
        return float(angular_distance(best, unit(np.asarray(self.direction, dtype=float))))


def fit_heads(observed: Iterable[Observed], model: str, model_type: str, take: int = TAKE) -> Heads:
    """The localisation heads in what `eagor.perception.transformers.language` observed on labelled panoramas.

    Raises `EagorError` if there are no panoramas, or no head attends to the targets more than elsewhere.
    """
    looks = list(observed)
    if not looks:
        raise EagorError("there are no labelled panoramas; give 20 or more")
    layers = [layer for layer in looks[0].maps if layer >= _EARLIEST] or list(looks[0].maps)
    names = [(layer, head) for layer in layers for head in range(len(looks[0].mass[layer]))]
    mass = np.array([np.mean([look.mass[layer][head] for look in looks]) for layer, head in names])
    attentive = [name for name, share in zip(names, mass, strict=True) if share >= elbow(mass)]
    votes = dict.fromkeys(attentive, 0)
    for look in looks:
        scatter = {name: spatial_entropy(look.maps[name[0]][name[1]], look.wrap) for name in attentive}
        for name in sorted(scatter, key=lambda name: scatter[name])[:SHORTLIST]:
            votes[name] += bool(np.isfinite(scatter[name]))
    shortlist = sorted(attentive, key=lambda name: -votes[name])[:SHORTLIST]
    gains = {name: float(np.median([_gain(look, name) for look in looks])) for name in shortlist}
    chosen = [name for name in sorted(shortlist, key=lambda name: -gains[name]) if gains[name] > _LEAST][:take]
    if not chosen:
        best = max(gains.values(), default=0.0)
        raise EagorError(
            f"no head of {model} looks at the labelled targets more than elsewhere (best: {best:.2f} times uniform "
            f"attention, over {len(looks)} panoramas). Try more panoramas, larger pictures, or another extractor"
        )
    peaks = [float(look.mean(chosen)[look.near].max()) for look in looks]
    saturation = max(float(np.median(peaks)) - 1.0, 0.1) * (1 - _AIM) / _AIM
    figures = [{"head": list(name), "gain": gains[name], "votes": votes[name]} for name in chosen]
    found_by = {"panoramas": len(looks), "attentive": len(attentive), "of": len(names), "heads": figures}
    return Heads(model, model_type, tuple(chosen), saturation, found_by)


def judged(found: Heads, held_out: Sequence[Observed]) -> Heads:
    """`found` with its error (degrees) on held-out panoramas."""
    if not held_out:
        return found
    errors = np.degrees([look.error(found.heads) for look in held_out])
    figures = {"panoramas": len(errors), "median_error_deg": round(float(np.median(errors)), 2)}
    return replace(found, found_by=found.found_by | {"held_out": figures})


def elbow(values: np.ndarray) -> float:
    """The value at the elbow of sorted `values`: farthest below the chord from the first to the last."""
    rising = np.sort(np.asarray(values, dtype=float))
    if len(rising) < 3 or rising[-1] <= rising[0]:
        return float(rising[0])
    along = np.linspace(0, 1, len(rising))
    below = along - (rising - rising[0]) / (rising[-1] - rising[0])
    return float(rising[int(below.argmax())])


def spatial_entropy(cells: np.ndarray, wrap: bool = True) -> float:
    """Scatter of a map ``(h, w)`` over a panorama: entropy (nats) of the shares of its connected regions.

    Regions exceed twice the mean; they connect diagonally and, with `wrap`, across the seam. Infinite for a map that is
    highest in the bottom row (as of some heads whatever is asked) or has no region.
    """
    lit = np.maximum(cells - 2 * cells.mean(), 0.0)
    if not lit.any() or lit[-1].sum() > 0.5 * lit.sum():
        return float("inf")
    shares = np.bincount(connected(lit > 0, wrap).reshape(-1), lit.reshape(-1))[1:] / lit.sum()
    return float(-(shares * np.log(shares)).sum())


def _gain(look: Observed, name: tuple[int, int]) -> float:
    """The mean attention of a head on the target, relative to uniform attention over the cells."""
    return float(densities(look.maps[name[0]][name[1]])[look.near].mean())
