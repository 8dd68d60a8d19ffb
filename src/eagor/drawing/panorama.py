"""A belief over a panorama: its density as heat, the border of its 90 % region, and the directions of all methods.

An `Estimate` is drawn as it is: its density, region, answer and candidates.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.belief.readable import Readable
from eagor.drawing.sheet import INK, figure, image, plain
from eagor.grids import PatchGrid
from eagor.sphere import azimuth_elevation, unit
from eagor.thumbnail import undrawn
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL.Image import Image

OURS, TRUTH = "#00e5ff", "#39ff6a"
# Markers and colours that can be told apart in grey and by the colour-blind; the first methods get the first ones.
OTHERS = (("s", "#ffb000"), ("D", "#ff5fa8"), ("^", "#b197ff"), ("v", "#ff7043"), ("P", "#9ccc65"), ("X", "#90a4ae"))
ROWS, MOST_ROWS = 360, 720  # of the heat map: more for a small region
CELLS = 40  # least number of cells in a region, so that its border is not just a few straight lines
MASS = 0.9
FLAT = 1e-6  # a density that varies by less than this share of its mean is uniform


def draw_belief(
    panorama: np.ndarray,
    belief: Estimate | Readable,
    truth: np.ndarray | None = None,
    others: Mapping[str, np.ndarray | None] | None = None,
    modes: Sequence[np.ndarray] | None = None,
    title: str = "",
    width: int = 1200,
) -> Image:
    """`belief` as heat over `panorama` ``(H, W, 3)``, with the border of its 90 % region.

    The region is not drawn, and the legend says so, if it is larger than half of the sphere or if its border depends on
    ripples alone. Nothing is drawn for a uniform belief.

    Args:
        panorama: the image, uint8, in the body frame of the belief.
        belief: an `Estimate`, drawn with its answer, an arrow from forward to it, and its candidates; or a single
            belief, which has no answer.
        truth: the true direction ``(3,)``, if known.
        others: other methods' directions by name; None for a method without one.
        modes: directions of candidates; default: those of the estimate.
        title: a line above the picture.
        width: of the picture in pixels.
    """
    sheet = figure(width, round(width * 0.595))
    axes = sheet.add_axes((0.055, 0.145, 0.92, 0.775))
    paint_belief(axes, panorama, belief, truth, others, modes)
    axes.set_xlabel("azimuth in degrees, positive to the left", color=INK)
    axes.set_ylabel("elevation", color=INK)
    sheet.text(0.055, 0.945, title, fontsize=13, color=INK, weight="bold")
    _legend(sheet, [axes])
    return image(sheet)


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
    """The contents of `draw_belief`, drawn into `axes`."""
    axes.set_xlim(180, -180)
    axes.set_ylim(-90, 90)
    axes.set_xticks(range(180, -181, -45), _degrees(range(180, -181, -45)))
    axes.set_yticks(range(-90, 91, 30), _degrees(range(-90, 91, 30)))
    plain(axes)
    whole = (180, -180, -90, 90)
    axes.imshow(_muted(panorama), extent=whole, aspect="auto", interpolation="antialiased", zorder=0)
    for at in (-90, 0, 90):
        axes.axvline(at, color="white", alpha=0.22, linewidth=0.8, zorder=1)
    axes.axhline(0, color="white", alpha=0.22, linewidth=0.8, zorder=1)
    answer = belief.direction if isinstance(belief, Estimate) else None
    if isinstance(belief, Estimate) and answer is None:
        axes.plot([], [], linestyle="none", label="direction not known")
    else:
        _heat(axes, belief)
    if answer is not None:
        _arrow(axes, answer)
    if modes is None:
        modes = [mode.direction for mode in belief.modes] if isinstance(belief, Estimate) else []
    for index, mode in enumerate(modes):
        _mark(axes, mode, "o", "white", 15, "candidate directions" if index == 0 else None, hollow=True, width=1.8)
    for index, (name, where) in enumerate((others or {}).items()):
        marker, colour = OTHERS[index % len(OTHERS)]
        if where is not None:
            _mark(axes, where, marker, colour, 8.5, name)
    if truth is not None:
        _mark(axes, truth, "o", TRUTH, 21, "truth", hollow=True, width=2.6)
    if isinstance(belief, Estimate) and answer is not None:
        _mark(axes, answer, "o", OURS, 8.5, "estimate (an older one, held)" if belief.held else "estimate")


def _heat(axes: Axes, belief: Estimate | Readable) -> None:
    """The density as heat, and the border of its 90 % region; nothing for a uniform belief."""
    from matplotlib import colormaps

    border, area = _region(belief)
    grid = _cells(area)
    log_density = np.asarray(belief.log_density(grid.directions))
    times = 4 * math.pi * np.exp(log_density)  # relative to the uniform density
    most = float(times.max())
    if most - float(times.min()) < FLAT:
        return
    contrast = 1 - 1 / most  # 0 for a uniform belief, 1 for a sharp one
    share = np.sqrt(np.clip((times - 1) / (most - 1), 0, 1))
    rgba = colormaps["inferno"](0.35 + 0.6 * share)
    rgba[..., 3] = 0.85 * contrast * np.clip(1.3 * share, 0, 1)
    axes.imshow(rgba, extent=(180, -180, -90, 90), aspect="auto", interpolation="bilinear", zorder=2)
    if why := undrawn(log_density, grid.weights, border, area):
        axes.plot([], [], linestyle="none", label=f"{100 * MASS:.0f} % region: {why}, not drawn")
        return
    # A few more columns on either side, so that a border that crosses the seam continues into the frame.
    more = 8
    azimuth = np.degrees(math.pi - 2 * math.pi * (np.arange(-more, grid.width + more) + 0.5) / grid.width)
    elevation = np.degrees(grid.latitudes)
    padded = np.concatenate([log_density[:, -more:], log_density, log_density[:, :more]], axis=1)
    for colour, width in (("black", 3.4), ("white", 1.6)):
        axes.contour(
            azimuth, elevation, padded, levels=[border], colors=colour, linewidths=width, linestyles="solid", zorder=3
        )
    axes.plot([], [], color="white", linewidth=1.6, label=f"{100 * MASS:.0f} % region")


def _region(belief: Estimate | Readable) -> tuple[float, float]:
    """The log density (per steradian) at the border of the 90 % region, and its solid angle."""
    if isinstance(belief, Estimate):
        return belief.region(MASS)
    found = belief.credible_region(MASS)
    return found.threshold, found.area


def _cells(area: float) -> PatchGrid:
    """Cells for the heat, fine enough for a region of this solid angle."""
    rows = math.ceil(math.sqrt(CELLS * 2 * math.pi / max(area, 1e-9)))
    rows = min(max(ROWS, 2 * math.ceil(rows / 2)), MOST_ROWS)
    return PatchGrid(rows, 2 * rows)


def _arrow(axes: Axes, where: np.ndarray) -> None:
    """An arrow along the great circle from forward to `where`."""
    end = np.asarray(where, dtype=float)
    angle = math.acos(max(-1.0, min(1.0, float(end[0]))))
    side = np.array([0.0, end[1], end[2]])
    if angle < 1e-6 or np.linalg.norm(side) < 1e-6:
        return
    along = np.linspace(0, angle, 240)[:, None]
    azimuth, elevation = azimuth_elevation(np.cos(along) * np.array([1.0, 0, 0]) + np.sin(along) * unit(side))
    x, y = np.degrees(azimuth), np.degrees(elevation)
    pixels = axes.get_window_extent().width / 360
    clear = pixels * np.hypot(x - x[-1], y - y[-1]) > 18  # the head ends before the rings around the estimate
    x, y = x[clear], y[clear]
    if len(x) < 8:
        return
    axes.plot(x, y, color=OURS, linewidth=1.8, zorder=6, path_effects=_outline(3.6), solid_capstyle="round")
    axes.plot(0, 0, "o", color=OURS, markersize=4.5, markeredgecolor="black", markeredgewidth=0.8, zorder=6)
    head = {
        "arrowstyle": "-|>,head_width=0.32,head_length=0.55",
        "color": OURS,
        "linewidth": 1.8,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    axes.annotate("", xy=(x[-1], y[-1]), xytext=(x[-6], y[-6]), arrowprops=head, zorder=6)


def _mark(
    axes: Axes,
    where: np.ndarray,
    marker: str,
    colour: str,
    size: float,
    label: str | None,
    hollow: bool = False,
    width: float = 1.0,
) -> None:
    """A marker at a direction, twice where it lies on the seam."""
    azimuth, elevation = (math.degrees(float(a)) for a in azimuth_elevation(np.asarray(where)))
    places = [azimuth] + ([azimuth - math.copysign(360, azimuth)] if abs(azimuth) > 172 else [])
    for place in places:
        style = {"markersize": size, "linestyle": "none", "zorder": 7}
        if hollow:  # a dark ring below the bright one
            axes.plot(place, elevation, marker, mfc="none", mec="black", mew=width + 1.8, alpha=0.7, **style)
            axes.plot(place, elevation, marker, mfc="none", mec=colour, mew=width, label=label, **style)
        else:
            axes.plot(place, elevation, marker, mfc=colour, mec="black", mew=width, label=label, **style)
        label = None


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


def _muted(panorama: np.ndarray) -> np.ndarray:
    """The panorama darker and half as colourful, as a background; at most 1600 columns."""
    image = np.asarray(panorama)
    step = max(1, image.shape[1] // 1600)
    image = image[::step, ::step].astype(np.float32) / (255 if image.dtype == np.uint8 else 1)
    grey = image.mean(axis=-1, keepdims=True)
    return np.clip((0.45 * grey + 0.55 * image) * 0.72, 0, 1)


def _degrees(angles: Sequence[int]) -> list[str]:
    return [f"{a:+d}°" if a else "0°" for a in angles]


def _outline(width: float) -> list[Any]:
    from matplotlib import patheffects

    return [patheffects.Stroke(linewidth=width, foreground="black", alpha=0.75), patheffects.Normal()]
