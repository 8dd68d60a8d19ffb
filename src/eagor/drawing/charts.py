"""Errors over time, and a walk from above."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.drawing.sheet import GRID_LINE, INK, QUIET, figure, image, plain

if TYPE_CHECKING:
    from PIL.Image import Image

CURVES = ("#00838f", "#b26a00", "#c2185b", "#5e35b1", "#d84315", "#558b2f", "#546e7a", "#6d4c41", "#9e9d24")


def draw_errors(
    stamps: Sequence[float],
    errors: Mapping[str, Sequence[float]],
    shaded: Sequence[tuple[float, float, str]] = (),
    title: str = "",
    width: int = 1200,
) -> Image:
    """Direction errors (degrees) of several methods over time (seconds); the first method is drawn on top, and thick.

    `shaded` marks stretches: begin, end, and what happened.
    """
    sheet = figure(width, round(width * 0.42))
    axes = sheet.add_axes((0.06, 0.13, 0.69, 0.76 if title else 0.83))
    highest = max((float(np.max(np.asarray(values))) for values in errors.values()), default=180.0)
    highest = min(180, 30 * math.ceil(max(highest, 1.0) * 1.05 / 30))
    for begin, end, what in shaded:
        axes.axvspan(begin, end, color="#eceff4", zorder=0, linewidth=0)
        axes.text((begin + end) / 2, 0.975 * highest, what, ha="center", va="top", fontsize=9, color=QUIET)
    ends = []
    for index, (name, values) in enumerate(errors.items()):
        colour, first = CURVES[index % len(CURVES)], index == 0
        axes.plot(stamps, values, color=colour, linewidth=3 if first else 1.4, zorder=5 if first else 3, label=name)
        mean = float(np.mean(np.asarray(values)))
        ends.append((mean, name, colour, first))
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
        sheet.text(0.985, y, f"{mean:.1f}°", color=INK, fontsize=10.5, va="center", ha="right", weight=weight)
    return image(sheet)


def draw_map(
    path: np.ndarray,
    headings: np.ndarray,
    found: np.ndarray,
    target: np.ndarray,
    distractor: np.ndarray,
    hidden: np.ndarray,
    size: tuple[float, float],
    width: int = 1200,
) -> Image:
    """A walk from above: x to the right, y (the left of a body at yaw 0) up.

    Args:
        path: the camera's positions ``(n, 3)``, metres, world frame.
        headings: where it faced ``(n, 3)``.
        found: where the target was taken to be ``(n, 3)``.
        target: where it was ``(3,)``.
        distractor: where the other thing was ``(n, 3)``.
        hidden: when the camera saw nothing ``(n,)``, bool.
        size: of the room, along x and y, centred on the origin.
        width: of the picture in pixels.
    """
    sheet = figure(width, round(width * 0.6))
    axes = sheet.add_axes((0.05, 0.09, 0.70, 0.88))
    axes.set_aspect("equal")
    axes.set_xlim(-size[0] / 2 - 0.4, size[0] / 2 + 1.2)
    axes.set_ylim(-size[1] / 2 - 0.5, size[1] / 2 + 0.5)
    axes.add_patch(_rectangle(size))
    axes.plot(*distractor[:, :2].T, ":", color="#c98b8b", linewidth=1.6, label="the other red ball")
    axes.plot(*path[:, :2].T, color="#9aa1ad", linewidth=2, label="camera", zorder=3)
    dark = np.where(hidden[:, None], path, np.nan)
    axes.plot(*dark[:, :2].T, color=INK, linewidth=5, label="camera, covered", zorder=4)
    every = slice(0, None, max(1, len(path) // 24))
    arrows = {"color": QUIET, "angles": "xy", "scale": 24, "width": 0.0032, "zorder": 5}
    axes.quiver(*path[every, :2].T, *headings[every, :2].T, **arrows)
    axes.plot(*path[0, :2], "o", color=INK, markersize=9, zorder=6, linestyle="none", label="start")
    axes.plot(
        *target[:2], "o", color="#c8201f", markersize=20, mec="white", mew=2, zorder=6, linestyle="none", label="target"
    )
    dots = {"c": np.linspace(0, 1, len(found)), "cmap": "viridis", "s": 34, "edgecolors": "white", "linewidths": 0.6}
    shade = axes.scatter(*found[:, :2].T, zorder=7, label="target, as we took it to be", **dots)
    axes.set_xlabel("x (m)", color=INK)
    axes.set_ylabel("y (m)", color=INK)
    axes.grid(color=GRID_LINE, linewidth=0.6)
    axes.set_axisbelow(True)
    plain(axes)
    sheet.legend(loc="upper left", bbox_to_anchor=(0.76, 0.96), frameon=False, fontsize=10, labelspacing=1.0)
    bar = sheet.colorbar(shade, cax=sheet.add_axes((0.79, 0.14, 0.014, 0.34)), ticks=[0, 1])
    bar.ax.set_yticklabels(["start", "end"], color=INK, fontsize=9.5)
    return image(sheet)


def _rectangle(size: tuple[float, float]) -> Any:
    from matplotlib.patches import Rectangle

    corner = (-size[0] / 2, -size[1] / 2)
    return Rectangle(corner, size[0], size[1], fill=False, edgecolor=INK, linewidth=2.2, zorder=2)
