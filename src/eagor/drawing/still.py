"""Still pictures of beliefs: one, or several in panels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.belief.posterior import Readable
from eagor.drawing.mosaic import Mosaic
from eagor.drawing.panorama import backdrop, heat_of, paint_marks
from eagor.drawing.sheet import DESIGN, INK, WORDS, blank, figure, ground, image, over, plain
from eagor.drawing.view import ViewScene
from eagor.errors import EagorError
from eagor.grids import PerspectiveGrid
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL.Image import Image

__all__ = ["draw_belief", "draw_strip", "paint_belief"]

WHOLE = (180, -180, -90, 90)  # degrees: left, right, bottom, top


def draw_belief(
    picture: np.ndarray,
    belief: Estimate | Readable,
    truth: np.ndarray | None = None,
    others: Mapping[str, np.ndarray | None] | None = None,
    modes: Sequence[np.ndarray] | None = None,
    title: str = "",
    width: int = 1200,
    grid: PerspectiveGrid | None = None,
    mosaic: Mosaic | None = None,
) -> Image:
    """`belief` as heat over `picture` ``(H, W, 3)``, with the border of its 90 % region.

    The region is not drawn, and a note says so, if it is larger than half of the sphere or if its border depends on
    ripples alone. Nothing is drawn for a uniform belief.

    Args:
        picture: the image, uint8: a panorama in the body frame of the belief, or with `grid` what an ordinary camera
            saw, and then `belief` is an `Estimate`.
        belief: an `Estimate`, drawn with its answer, an arrow from forward to it (unless 90 % of the belief need a cone
            of more than 90 degrees about it), and its candidates; or a single belief, which has no answer.
        truth: the true direction ``(3,)``, if known.
        others: other methods' directions by name; None for a method without one.
        modes: directions of candidates; default: those of the estimate.
        title: a line above the picture.
        width: of the picture in pixels.
        grid: which directions of the body the pixels of an ordinary camera show. An arrow at the edge points to an
            answer out of view; a small panorama beside it shows the whole belief.
        mosaic: what an ordinary camera was shown before, for the small panorama; this picture is added.

    Raises `EagorError` for a picture of another shape.
    """
    if grid is not None:
        return _draw_view(picture, belief, truth, others, modes, title, width, grid, mosaic)
    sheet = figure(width, round(width * 0.595))
    axes = sheet.add_axes((0.055, 0.145, 0.92, 0.775))
    paint_belief(axes, picture, belief, truth, others, modes)
    axes.set_xlabel("azimuth in degrees, positive to the left", color=INK)
    axes.set_ylabel("elevation", color=INK)
    sheet.text(0.055, 0.945, title, fontsize=13, color=INK, weight="bold")
    _legend(sheet, [axes])
    return image(sheet)


def _draw_view(
    picture: np.ndarray,
    belief: Estimate | Readable,
    truth: np.ndarray | None,
    others: Mapping[str, np.ndarray | None] | None,
    modes: Sequence[np.ndarray] | None,
    title: str,
    width: int,
    grid: PerspectiveGrid,
    mosaic: Mosaic | None,
) -> Image:
    """`draw_belief` of what an ordinary camera saw."""
    from PIL import Image

    if not isinstance(belief, Estimate):
        raise EagorError(f"with a grid the belief is a {type(belief).__name__}; wanted an Estimate, which has a pose")
    head, rows = round(0.05 * width), round(0.5 * width)
    sheet = blank(width, head + rows, 100 * width / DESIGN)
    pixels = ground(width, head + rows)
    scene = ViewScene(sheet.figure, (width, head + rows), (0, head, width, rows), mosaic)
    scene.paint(pixels, picture, grid, belief, truth, others, modes)
    sheet.figure.text(
        0.012, 1 - 0.5 * head / (head + rows), title, fontsize=14, color=WORDS, weight="bold", va="center"
    )
    return Image.fromarray(over(sheet, pixels))


def draw_strip(panels: Sequence[Mapping[str, Any]], columns: int = 2, width: int = 1400) -> Image:
    """Several beliefs in one picture: each panel has the arguments of `draw_belief` (without `width`), row by row."""
    rows = math.ceil(len(panels) / columns)
    left, gap, head, foot, legend = 48, 52, 30, 30, 44  # pixels around the panels
    wide = (width - left - gap * (columns - 1) - 28) / columns
    high = wide / 2
    total = rows * (head + high + foot) + legend
    sheet = figure(width, round(total))
    drawn = []
    for index, panel in enumerate(panels):
        row, column = divmod(index, columns)
        x, y = left + column * (wide + gap), total - (row + 1) * (head + high) - row * foot
        axes = sheet.add_axes((x / width, y / total, wide / width, high / total))
        paint_belief(axes, **{name: value for name, value in panel.items() if name != "title"})
        axes.set_title(panel.get("title", ""), loc="left", fontsize=11, color=INK, weight="bold", pad=6)
        axes.set_xticks(range(180, -181, -90), _degrees(range(180, -181, -90)))
        if column:
            axes.set_yticklabels([])
        drawn.append(axes)
    _legend(sheet, drawn)
    return image(sheet)


def paint_belief(
    axes: Axes,
    panorama: np.ndarray,
    belief: Estimate | Readable,
    truth: np.ndarray | None = None,
    others: Mapping[str, np.ndarray | None] | None = None,
    modes: Sequence[np.ndarray] | None = None,
) -> None:
    """The contents of `draw_belief`, drawn into `axes`, which have their size already."""
    axes.set_xlim(180, -180)
    axes.set_ylim(-90, 90)
    axes.set_xticks(range(180, -181, -45), _degrees(range(180, -181, -45)))
    axes.set_yticks(range(-90, 91, 30), _degrees(range(-90, 91, 30)))
    plain(axes)
    heat = heat_of(belief)
    box = axes.get_window_extent()
    ground = backdrop(panorama, heat, max(1, round(box.width)), max(1, round(box.height)))
    axes.imshow(ground, extent=WHOLE, aspect="auto", interpolation="antialiased", zorder=0)
    paint_marks(axes, belief, heat, truth, others, modes)


def _legend(sheet: Figure, drawn: Sequence[Axes]) -> None:
    """One legend for everything drawn in these axes."""
    found: dict[str, Any] = {}
    for axes in drawn:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    if not found:
        return
    labels = sorted(found, key=lambda label: (not label.startswith("estimate"), label != "truth"))
    legend = sheet.legend(
        [found[label] for label in labels],
        labels,
        loc="lower center",
        ncols=len(labels),
        fontsize=10,
        facecolor="#3a4152",
        edgecolor="none",
        labelcolor="white",
        handletextpad=0.5,
        columnspacing=1.6,
        borderpad=0.45,
        bbox_to_anchor=(0.5, 0.004),
    )
    for handle in legend.legend_handles:
        if handle is not None and hasattr(handle, "set_markersize"):
            handle.set_markersize(9)  # type: ignore[attr-defined]


def _degrees(angles: Sequence[int]) -> list[str]:
    return [f"{a:+d}°" if a else "0°" for a in angles]
