"""Errors over time, and paths on a map."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from eagor.drawing.sheet import GRID_LINE, INK, QUIET, figure, image, plain
from eagor.errors import EagorError

if TYPE_CHECKING:
    from PIL.Image import Image

CURVES = ("#00838f", "#b26a00", "#c2185b", "#5e35b1", "#d84315", "#558b2f", "#546e7a", "#6d4c41", "#9e9d24")


def draw_errors(
    stamps: Sequence[float],
    errors: Mapping[str, Sequence[float | None]],
    shaded: Sequence[tuple[float, float, str]] = (),
    title: str = "",
    width: int = 1200,
) -> Image:
    """Direction errors (degrees) of several methods over time (seconds); the first method is drawn on top, and thick.

    A method with fewer values than stamps ended earlier; one without values is listed with a dash. None and NaN leave a
    gap in the curve. `shaded` marks intervals: begin, end, and label.

    Raises `EagorError` without stamps, and for a method with more values than there are stamps.
    """
    if not len(stamps):
        raise EagorError("there are no stamps; wanted the time of at least one step, and the errors of each method")
    curves = {name: np.array(values, dtype=np.float64) for name, values in errors.items()}
    for name, values in curves.items():
        if len(values) > len(stamps):
            raise EagorError(
                f"{name} has {len(values)} errors, but there are {len(stamps)} stamps; wanted a stamp for each error"
            )
    known = {name: values[np.isfinite(values)] for name, values in curves.items()}
    sheet = figure(width, round(width * 0.42))
    axes = sheet.add_axes((0.06, 0.13, 0.69, 0.76 if title else 0.83))
    highest = max((float(values.max()) for values in known.values() if len(values)), default=180.0)
    highest = min(180, 30 * math.ceil(max(highest, 1.0) * 1.05 / 30))
    for begin, end, what in shaded:
        axes.axvspan(begin, end, color="#eceff4", zorder=0, linewidth=0)
        axes.text((begin + end) / 2, 0.975 * highest, what, ha="center", va="top", fontsize=9, color=QUIET)
    ends = []
    for index, (name, values) in enumerate(curves.items()):
        colour, first = CURVES[index % len(CURVES)], index == 0
        axes.plot(
            stamps[: len(values)],
            values,
            color=colour,
            linewidth=3 if first else 1.4,
            zorder=5 if first else 3,
            marker="o" if len(values) == 1 else None,  # a line needs two
            label=name,
        )
        mean = float(known[name].mean()) if len(known[name]) else math.inf
        ends.append((mean, name, colour, first))
    if stamps[0] < stamps[-1]:
        axes.set_xlim(stamps[0], stamps[-1])
    axes.set_ylim(0, highest)
    axes.set_yticks(range(0, highest + 1, 30 if highest > 60 else 10))
    axes.set_xlabel("time (s)", color=INK)
    axes.set_ylabel("direction error (degrees)", color=INK)
    axes.grid(color=GRID_LINE, linewidth=0.8)
    plain(axes)
    sheet.text(0.06, 0.935, title, fontsize=13, color=INK, weight="bold")
    sheet.text(0.77, 0.925, "mean error over the run", fontsize=9.5, color=QUIET)
    for row, (mean, name, colour, first) in enumerate(sorted(ends, key=lambda end: end[0])):
        y = 0.86 - 0.07 * row
        weight = "bold" if first else "normal"
        sheet.text(0.77, y, "■", color=colour, fontsize=12, va="center")
        sheet.text(0.79, y, name, color=INK, fontsize=10.5, va="center", weight=weight)
        said = f"{mean:.1f}°" if mean < math.inf else "–"
        sheet.text(0.985, y, said, color=INK, fontsize=10.5, va="center", ha="right", weight=weight)
    return image(sheet)


def draw_map(
    walls: np.ndarray,
    free: np.ndarray,
    extent: tuple[float, float, float, float],
    paths: Mapping[str, np.ndarray],
    target: np.ndarray,
    width: int = 1200,
) -> Image:
    """Paths on a floor plan from above: x to the right, y up; the first path is drawn on top, and thick.

    Args:
        walls: ``(rows, cols)`` bool, row 0 at the lowest y: cells of the building.
        free: ``(rows, cols)`` bool: walkable cells; cells that are neither are furniture, or out of reach.
        extent: x0, x1, y0, y1 of the two rasters, metres.
        paths: positions ``(n, 2)`` by name, all from the same start.
        target: position of the target ``(2,)`` or ``(3,)``.
        width: of the picture in pixels.
    """
    x0, x1, y0, _ = extent
    used = np.argwhere(walls | free)
    cell = (x1 - x0) / walls.shape[1]
    (bottom, left), (top, right) = used.min(axis=0) * cell, (used.max(axis=0) + 1) * cell
    wide, high = right - left + 0.6, top - bottom + 0.6
    scale = min(0.68 * width / wide, 0.68 * width / high)
    height = round(high * scale) + 70
    sheet = figure(width, height)
    axes = sheet.add_axes((55 / width, 50 / height, wide * scale / width, high * scale / height))
    shade = np.full((*walls.shape, 3), 0.93)
    shade[free], shade[walls] = 1.0, (0.24, 0.27, 0.33)
    shade[~walls & ~free] = (0.87, 0.85, 0.81)
    axes.imshow(shade, origin="lower", extent=extent, interpolation="nearest", zorder=0)
    axes.set_xlim(x0 + left - 0.3, x0 + right + 0.3)
    axes.set_ylim(y0 + bottom - 0.3, y0 + top + 0.3)
    for order, (name, path) in reversed(list(enumerate(paths.items()))):
        first = order == 0
        style = {"linewidth": 3.4 if first else 1.6, "zorder": 4 if first else 3, "alpha": 1.0 if first else 0.85}
        axes.plot(*path[:, :2].T, color=CURVES[order % len(CURVES)], label=name, **style)
        axes.plot(*path[-1, :2], "s", color=CURVES[order % len(CURVES)], markersize=6, zorder=5)
    start = next(iter(paths.values()))[0]
    axes.plot(*start[:2], "o", color=INK, markersize=10, zorder=6, linestyle="none", label="start")
    axes.plot(*target[:2], "*", color="#c8201f", markersize=22, mec="white", mew=1.4, zorder=6, linestyle="none",
              label="target")  # fmt: skip
    axes.set_xlabel("x (m)", color=INK)
    axes.set_ylabel("y (m)", color=INK)
    plain(axes)
    handles, labels = axes.get_legend_handles_labels()
    order = [labels.index(name) for name in (*paths, "start", "target")]
    sheet.legend(
        [handles[i] for i in order], [labels[i] for i in order], loc="upper left",
        bbox_to_anchor=((75 + wide * scale) / width, 0.97), frameon=False, fontsize=10.5, labelspacing=0.9,
    )  # fmt: skip
    return image(sheet)
