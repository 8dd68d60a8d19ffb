"""Still pictures: beliefs over panoramas, and errors over time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.belief.posterior import Readable
from eagor.drawing.heat import heat_of
from eagor.drawing.marks import Marks, Mosaic, backdrop, paint_marks
from eagor.drawing.step import StepPainter
from eagor.drawing.style import DARK, DESIGN, GRID_LINE, INK, QUIET, WORDS, figure, image, painted, plain
from eagor.errors import EagorError
from eagor.grids import PerspectiveGrid
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL.Image import Image

__all__ = ["draw_belief", "draw_errors", "draw_strip", "paint_belief"]


def draw_belief(
    picture: np.ndarray,
    belief: Estimate | Readable,
    title: str = "",
    width: int = 1200,
    grid: PerspectiveGrid | None = None,
    mosaic: Mosaic | None = None,
    **more: Any,
) -> Image:
    """`belief` as heat over `picture` ``(H, W, 3)``, with the border of its 90 % region.

    The region is not drawn, and a note says so, if it is larger than half of the sphere or if its border depends on
    ripples alone. Nothing is drawn for a uniform belief.

    Args:
        picture: the image, uint8: a panorama in the body frame of the belief, or with `grid` what an ordinary camera
            saw, and then `belief` is an `Estimate`.
        belief: an `Estimate`, drawn with its answer, an arrow from forward to it (unless 90 % of the belief need a cone
            of more than 90 degrees about it), and its candidates; or a single belief, which has no answer.
        title: a line above the picture.
        width: of the picture in pixels.
        grid: which directions of the body the pixels of an ordinary camera show. An arrow at the edge points to an
            answer out of view; a small panorama beside it shows the whole belief.
        mosaic: what an ordinary camera was shown before, for the small panorama; this picture is added.
        more: `truth`, `others` and `modes`, as in `Marks`.

    Raises `EagorError` for a picture of another shape.
    """
    if grid is None:
        sheet = figure(width, round(width * 0.595))
        axes = sheet.add_axes((0.055, 0.145, 0.92, 0.775))
        paint_belief(axes, picture, belief, **more)
        axes.set_xlabel("azimuth in degrees, positive to the left", color=INK)
        axes.set_ylabel("elevation", color=INK)
        sheet.text(0.055, 0.945, title, fontsize=13, color=INK, weight="bold")
        _legend(sheet)
        return image(sheet)
    from PIL import Image

    if not isinstance(belief, Estimate):
        raise EagorError(f"with a grid the belief is a {type(belief).__name__}; wanted an Estimate, which has a pose")
    painter = StepPainter(width, bare=True, mosaic=mosaic)
    head = figure(painter.width, round(0.05 * width), 100 * width / DESIGN)
    head.text(0.012, 0.5, title, fontsize=14, color=WORDS, weight="bold", va="center")
    seen = painter.paint(picture, belief, grid=grid, more=Marks(**more))
    return Image.fromarray(np.concatenate([painted(head, DARK), seen]))


def draw_strip(panels: Sequence[Mapping[str, Any]], columns: int = 2, width: int = 1400) -> Image:
    """Several beliefs in one picture, row by row: each panel has the arguments of `paint_belief`, and a title."""
    rows = math.ceil(len(panels) / columns)
    left, gap, head, foot, legend = 48, 52, 30, 30, 44  # pixels around the panels
    wide = (width - left - gap * (columns - 1) - 28) / columns
    total = rows * (head + wide / 2 + foot) + legend
    sheet = figure(width, round(total))
    for index, panel in enumerate(panels):
        row, column = divmod(index, columns)
        x, y = left + column * (wide + gap), total - (row + 1) * (head + wide / 2) - row * foot
        axes = sheet.add_axes((x / width, y / total, wide / width, wide / 2 / total))
        paint_belief(axes, **{name: value for name, value in panel.items() if name != "title"})
        axes.set_title(panel.get("title", ""), loc="left", fontsize=11, color=INK, weight="bold", pad=6)
        axes.set_xticks(axes.get_xticks()[::2])
        if column:
            axes.set_yticklabels([])
    _legend(sheet)
    return image(sheet)


def paint_belief(axes: Axes, panorama: np.ndarray, belief: Estimate | Readable, **more: Any) -> None:
    """The contents of `draw_belief` for a panorama, drawn into `axes`, which have their size already."""
    axes.set(xlim=(180, -180), ylim=(-90, 90), xticks=range(180, -181, -45), yticks=range(-90, 91, 30))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(lambda angle, _: f"{angle:+.0f}°" if angle else "0°")
    plain(axes)
    heat, (width, height) = heat_of(belief), (max(1, round(size)) for size in axes.bbox.size)
    ground = backdrop(panorama, None if heat is None else heat.rgba, width, height)
    axes.imshow(ground, extent=(180, -180, -90, 90), aspect="auto", interpolation="antialiased", zorder=0)
    paint_marks(axes, belief, heat, Marks(**more))


def _legend(sheet: Figure) -> None:
    """One legend for everything that is drawn."""
    found: dict[str, Any] = {}
    for axes in sheet.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    labels = sorted(found, key=lambda label: (not label.startswith("estimate"), label != "truth"))
    if labels:
        legend = sheet.legend(
            [found[label] for label in labels], labels, loc="lower center", ncols=len(labels), fontsize=10,
            facecolor="#3a4152", edgecolor="none", labelcolor="white", handletextpad=0.5, columnspacing=1.6,
            borderpad=0.45, bbox_to_anchor=(0.5, 0.004),
        )  # fmt: skip
        for handle in legend.get_lines():
            handle.set_markersize(9)


# --- errors over time ------------------------------------------------------------------------------------------------

CURVES = (
    "#00838f", "#b26a00", "#c2185b", "#5e35b1", "#d84315", "#558b2f", "#546e7a", "#6d4c41", "#9e9d24", "#1565c0",
)  # fmt: skip
LEAST = 0.5  # degrees: less than the width of anything that is looked for
TICKS = (0.5, 1, 2, 5, 10, 20, 50, 100, 180)


def draw_errors(
    stamps: Sequence[float],
    errors: Mapping[str, Sequence[float | None]],
    shaded: Sequence[tuple[float, float, str]] = (),
    title: str = "",
    width: int = 1200,
) -> Image:
    """Direction errors (degrees) of several methods over time (seconds); the first method is drawn on top, and thick.

    The axis is logarithmic, so that methods that are nearly right can be told apart beside one that is lost. Errors
    below 0.5 degrees are drawn at 0.5. A method with fewer values than stamps ended earlier; one without values is
    listed with a dash. None and NaN leave a gap in the curve. `shaded` marks intervals: begin, end, and label
    (which is left out of narrow ones beside wider ones).

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
    every = np.concatenate([*known.values(), [180.0] if not any(map(len, known.values())) else []])
    highest = next((tick for tick in TICKS[3:] if tick >= every.max()), TICKS[-1])
    lowest = max(tick for tick in TICKS if tick <= max(min(every.min(), highest / 10), LEAST))
    sheet = figure(width, round(width * 0.42))
    axes = sheet.add_axes((0.06, 0.13, 0.69, 0.76 if title else 0.83))
    roomy = min(0.1 * (stamps[-1] - stamps[0]), max((end - begin for begin, end, _ in shaded), default=0.0))
    for begin, end, label in shaded:
        axes.axvspan(begin, end, color="#eceff4", zorder=0, linewidth=0)
        if end - begin < roomy:  # its label would lie over its neighbours'
            continue
        middle, place = (begin + end) / 2, axes.get_xaxis_transform()
        axes.text(middle, 0.975, label, ha="center", va="top", fontsize=9, color=QUIET, transform=place)
    ends = []
    for index, (name, values) in enumerate(curves.items()):
        colour, first = CURVES[index % len(CURVES)], index == 0
        how: dict[str, Any] = {"linewidth": 3, "zorder": 5} if first else {"linewidth": 1.4, "zorder": 3}
        how["marker"] = "o" if len(values) == 1 else None  # a line needs two
        axes.plot(stamps[: len(values)], np.maximum(values, LEAST), color=colour, label=name, **how)
        ends.append((float(known[name].mean()) if len(known[name]) else math.inf, name, colour, first))
    if stamps[0] < stamps[-1]:
        axes.set_xlim(stamps[0], stamps[-1])
    ticks = [tick for tick in TICKS if lowest <= tick <= highest]
    axes.set(yscale="log", ylim=(lowest, highest))
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_yticks([], minor=True)
    axes.set_xlabel("time (s)", color=INK)
    axes.set_ylabel("direction error (degrees, log scale)", color=INK)
    axes.grid(color=GRID_LINE, linewidth=0.8)
    plain(axes)
    sheet.text(0.06, 0.935, title, fontsize=13, color=INK, weight="bold")
    sheet.text(0.77, 0.925, "mean direction error over the run", fontsize=9.5, color=QUIET)
    for row, (mean, name, colour, first) in enumerate(sorted(ends, key=lambda end: end[0])):
        y, how = 0.86 - 0.07 * row, {"fontsize": 10.5, "va": "center", "weight": "bold" if first else "normal"}
        sheet.text(0.77, y, "■", color=colour, fontsize=12, va="center")
        sheet.text(0.79, y, name, color=INK, **how)
        sheet.text(0.985, y, f"{mean:.1f}°" if mean < math.inf else "–", color=INK, ha="right", **how)
    return image(sheet)
