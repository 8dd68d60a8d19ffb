"""Charts as SVG, written by hand: they scale, follow the page's light or dark colours, and can be read aloud.

A method is told apart by its colour, its dashes and the shape of its marks, so that colour alone is never needed. The
colours themselves are in the page's style sheet, as the CSS variable ``--c`` of the class ``s-<name>``.
"""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from eagor.evaluation.curves import Curve

WIDTH, HEIGHT = 480, 300
LEFT, RIGHT, TOP, BOTTOM = 46, 16, 12, 42
STYLES = {
    "eagor": ("", "circle"),
    "eagor_paper": ("7 3", "square"),
    "centroid": ("2 3", "triangle"),
    "cent_circ": ("9 3 2 3", "down"),
    "grid": ("5 3", "diamond"),
    "vmf": ("3 2", "cross"),
    "grid_filter": ("10 4", "plus"),
    "particle_filter": ("1 3", "ring"),
    "oracle": ("", "ring"),
    "plain": ("1 2", "diamond"),
}
SHAPES = ("circle", "square", "triangle", "diamond", "down", "cross", "plus", "ring")
SPARE = 8  # colours for series that are no methods


@dataclass(frozen=True)
class Series:
    """A line of a chart: what it is called, its points, and the class of its looks."""

    name: str
    curve: Curve
    look: str
    strong: bool = False


def look_of(name: str, index: int = 0) -> str:
    """The class of a method's looks; others get one of the spare ones, by `index`."""
    return name if name in STYLES else f"x{index % SPARE}"


def line_chart(
    series: Sequence[Series],
    title: str,
    x_label: str,
    y_label: str,
    y_range: tuple[float, float] | None = None,
    event: str = "",
    diagonal: bool = False,
) -> str:
    """Lines with their 95 % bands; the strong ones come last, on top.

    `event` names what happens at x = 0, where a line is drawn; `diagonal` draws y = x.
    """
    xs = [x for line in series for x in line.curve.x]
    values = [v for line in series for v in (*line.curve.y, *line.curve.low, *line.curve.high) if v is not None]
    x_axis = Axis.over(min(xs), max(xs), LEFT, WIDTH - RIGHT)
    low, high = y_range or (0.0, max(values, default=1.0) * 1.04)
    y_axis = Axis.over(low, max(high, low + 1e-6), HEIGHT - BOTTOM, TOP)
    parts = [_axes(x_axis, y_axis, x_label, y_label)]
    if event and x_axis.low < 0 < x_axis.high:
        at = x_axis(0)
        parts.append(f'<line class="event" x1="{at:.1f}" x2="{at:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>')
        parts.append(f'<text class="event" x="{at + 4:.1f}" y="{TOP + 11}">{html.escape(event)}</text>')
    if diagonal:
        ends = max(x_axis.low, y_axis.low), min(x_axis.high, y_axis.high)
        points = " ".join(f"{x_axis(v):.1f},{y_axis(v):.1f}" for v in ends)
        parts.append(f'<polyline class="event" points="{points}"/>')
    ranked = sorted(series, key=lambda line: line.strong)
    parts += [_band(line, x_axis, y_axis) for line in ranked]
    parts += [_line(line, x_axis, y_axis, index) for index, line in enumerate(ranked)]
    return svg("".join(parts), WIDTH, HEIGHT, title, _in_words(series, x_label, y_label))


def legend(series: Sequence[Series]) -> str:
    """A list of the lines' names, each with a sample."""
    items = []
    for line in series:
        dashes, shape = style_of(line.look)
        sample = (
            f'<svg class="s-{line.look}" viewBox="0 0 36 12" width="36" height="12" aria-hidden="true">'
            f'<line class="line{" strong" if line.strong else ""}" x1="1" x2="35" y1="6" y2="6"{_dashed(dashes)}/>'
            f"{mark(shape, 18, 6)}</svg>"
        )
        items.append(f"<li>{sample} {html.escape(line.name)}</li>")
    return f'<ul class="legend">{"".join(items)}</ul>'


def svg(content: str, width: float, height: float, title: str, words: str) -> str:
    """An SVG picture with a title and a description for those who do not see it."""
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{html.escape(f"{title}. {words}")}">'
        f"<title>{html.escape(title)}</title>{content}</svg>"
    )


def mark(shape: str, x: float, y: float, size: float = 3.6) -> str:
    """A small mark at a point; its colour is that of its surroundings."""
    r = size
    outlines = {
        "square": [(-r, -r), (r, -r), (r, r), (-r, r)],
        "triangle": [(0, -1.2 * r), (1.1 * r, r), (-1.1 * r, r)],
        "down": [(0, 1.2 * r), (1.1 * r, -r), (-1.1 * r, -r)],
        "diamond": [(0, -1.35 * r), (1.35 * r, 0), (0, 1.35 * r), (-1.35 * r, 0)],
    }
    if shape in outlines:
        points = " ".join(f"{x + dx:.1f},{y + dy:.1f}" for dx, dy in outlines[shape])
        return f'<polygon class="mark" points="{points}"/>'
    if shape in ("cross", "plus"):
        d = r if shape == "plus" else 0.8 * r
        ends = [(-d, 0, d, 0), (0, -d, 0, d)] if shape == "plus" else [(-d, -d, d, d), (-d, d, d, -d)]
        strokes = "".join(f"M{x + a:.1f} {y + b:.1f}L{x + c:.1f} {y + e:.1f}" for a, b, c, e in ends)
        return f'<path class="open mark" d="{strokes}"/>'
    kind = "open mark" if shape == "ring" else "mark"
    return f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{r:g}"/>'


@dataclass(frozen=True)
class Axis:
    """Maps `low`..`high` to the pixels `begin`..`end`, with round numbers to write at it."""

    low: float
    high: float
    begin: float
    end: float
    ticks: tuple[float, ...]

    @classmethod
    def over(cls, low: float, high: float, begin: float, end: float) -> Axis:
        """An axis for this range."""
        if high <= low:
            high = low + 1.0
        raw = (high - low) / 6
        power = 10.0 ** math.floor(math.log10(raw))
        step = next(power * factor for factor in (1, 2, 3, 5, 10) if power * factor >= raw * 0.999)
        first = math.ceil(low / step - 1e-9)
        count = math.floor((high - first * step) / step + 1e-9)
        return cls(low, high, begin, end, tuple((first + k) * step for k in range(count + 1)))

    def __call__(self, value: float) -> float:
        return self.begin + (value - self.low) / (self.high - self.low) * (self.end - self.begin)


def style_of(look: str) -> tuple[str, str]:
    """Dashes (for SVG) and shape of the marks."""
    if look in STYLES:
        return STYLES[look]
    return "", SHAPES[int(look[1:]) % len(SHAPES)]


def _axes(x_axis: Axis, y_axis: Axis, x_label: str, y_label: str) -> str:
    parts = []
    for value in y_axis.ticks:
        at = y_axis(value)
        parts.append(f'<line class="rule" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{at:.1f}" y2="{at:.1f}"/>')
        parts.append(f'<text text-anchor="end" x="{LEFT - 5}" y="{at + 4:.1f}">{_number(value)}</text>')
    for value in x_axis.ticks:
        at = x_axis(value)
        parts.append(f'<text text-anchor="middle" x="{at:.1f}" y="{HEIGHT - BOTTOM + 16}">{_number(value)}</text>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(
        f'<text class="label" text-anchor="middle" x="{middle}" y="{HEIGHT - 6}">{html.escape(x_label)}</text>'
    )
    parts.append(
        f'<text class="label" text-anchor="middle" transform="translate(12 {(TOP + HEIGHT - BOTTOM) / 2}) rotate(-90)">'
        f"{html.escape(y_label)}</text>"
    )
    return "".join(parts)


def _pieces(line: Series) -> list[list[int]]:
    """The runs of points that have a value."""
    there = [index for index, value in enumerate(line.curve.y) if value is not None]
    return [[k for _, k in run] for _, run in groupby(enumerate(there), key=lambda pair: pair[1] - pair[0])]


def _band(line: Series, x_axis: Axis, y_axis: Axis) -> str:
    parts = []
    for piece in _pieces(line):
        ends = [(k, line.curve.low[k], line.curve.high[k]) for k in piece]
        whole = [(x_axis(line.curve.x[k]), low, high) for k, low, high in ends if low is not None and high is not None]
        if len(whole) < 2:
            continue
        points = [(x, y_axis(_within(high, y_axis))) for x, _, high in whole]
        points += [(x, y_axis(_within(low, y_axis))) for x, low, _ in reversed(whole)]
        outline = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        parts.append(f'<polygon class="band s-{line.look}" points="{outline}"/>')
    return "".join(parts)


def _line(line: Series, x_axis: Axis, y_axis: Axis, index: int) -> str:
    dashes, shape = style_of(line.look)
    parts = []
    for piece in _pieces(line):
        points = [(x_axis(line.curve.x[k]), y_axis(_within(line.curve.y[k] or 0.0, y_axis))) for k in piece]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        parts.append(f'<polyline class="line{" strong" if line.strong else ""}" points="{path}"{_dashed(dashes)}/>')
        every = max(1, math.ceil(len(points) / 7))
        parts += [mark(shape, x, y) for x, y in points[index % every :: every]]
    return f'<g class="s-{line.look}"><title>{html.escape(line.name)}</title>{"".join(parts)}</g>'


def _dashed(dashes: str) -> str:
    return f' stroke-dasharray="{dashes}"' if dashes else ""


def _within(value: float, axis: Axis) -> float:
    return min(max(value, axis.low), axis.high)


def _number(value: float) -> str:
    return f"{value:g}".replace("-", "−")


def _in_words(series: Sequence[Series], x_label: str, y_label: str) -> str:
    """The lines' ends and peaks, for those who do not see them."""
    found = []
    for line in series:
        points = [(x, y) for x, y in zip(line.curve.x, line.curve.y, strict=True) if y is not None]
        if points:
            top = max(points, key=lambda point: point[1])
            found.append(
                f"{line.name}: {points[0][1]:.3g} at {points[0][0]:g}, {points[-1][1]:.3g} at {points[-1][0]:g}, "
                f"at most {top[1]:.3g} at {top[0]:g}"
            )
    return f"{y_label} against {x_label}. " + "; ".join(found)
