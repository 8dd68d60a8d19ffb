"""A robot's walk as SVG: the path from above, and its answers, speeds and modes over time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eagor.drawing.html_parts import FULL, Strips
from eagor.drawing.timeline import cone_bands

__all__ = ["MODES", "Plan", "Sample", "map_of", "time_lines"]

# The colour of each mode of the gate, among the names of the page's style.
MODES = {"dry run": "band", "armed": "tracking", "stopping": "alarm", "standing": "searching", "latched": "stale"}
LEFT, WIDE = 84, 896  # user units of the time line: where the axis begins, its width
SIDE = 560  # of the map, at most
MARGIN = 0.6  # metres around the path
LEAST = 2.0  # metres that the map shows at least
ROWS = {  # top and bottom
    "azimuth": (8, 118), "error": (130, 180), "presence": (192, 222), "speed": (234, 284), "turning": (296, 346),
    "mode": (358, 372), "status": (378, 392),
}  # fmt: skip
TALL = 412


@dataclass(frozen=True)
class Sample:
    """The robot at one time: what was known, wanted and done. Angles in radians, lengths in metres, times in seconds.

    `time`: since the start. `azimuth`, `cone`: of the answer, None while nothing is known. `wanted`, `sent`:
    velocities (forward, left, turn); `sent` None: nothing was sent. `stops`: StopMove so far. `xy`, `yaw`: odometry.
    `true_xy`, `error` (angle between answer and truth): where the truth is known.
    """

    time: float
    status: str
    presence: float
    azimuth: float | None
    cone: float | None
    distance: float | None
    doing: str
    words: str
    wanted: tuple[float, float, float]
    sent: tuple[float, float, float] | None
    stops: int
    mode: str
    reasons: tuple[str, ...]
    speed: float
    turn: float
    xy: tuple[float, float] | None
    yaw: float
    true_xy: tuple[float, float] | None = None
    error: float | None = None


@dataclass(frozen=True, eq=False)
class Plan:
    """The floor from above: `free` and `walls` ``(rows, columns)`` bool, `origin` ``(2,)`` and `cell` in metres.

    Row 0 is at the lowest y, column 0 at the lowest x. `targets` ``(n, 2)``: where the things are.
    """

    free: np.ndarray
    walls: np.ndarray
    origin: tuple[float, float]
    cell: float
    targets: Sequence[tuple[float, float]] = ()


def map_of(samples: Sequence[Sample], plan: Plan | None) -> tuple[str, str]:
    """The path from above as SVG, and what it shows in words. x points right, y up; metres."""
    told = np.array([sample.xy for sample in samples if sample.xy is not None]).reshape(-1, 2)
    true = np.array([sample.true_xy for sample in samples if sample.true_xy is not None]).reshape(-1, 2)
    targets = np.array([] if plan is None else plan.targets).reshape(-1, 2)
    points = np.concatenate([told, true, targets])
    if not len(points):
        return "<p>The odometry gave no places.</p>", ""
    low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
    middle, size = (low + high) / 2, np.maximum(high - low, LEAST)
    low, high = middle - size / 2, middle + size / 2
    scale = min(FULL / size[0], SIDE / size[1])
    wide, tall = scale * size

    def at(x: float, y: float) -> tuple[float, float]:
        return round(scale * (x - low[0]), 1), round(tall - scale * (y - low[1]), 1)

    parts = [] if plan is None else [_floor(plan, low, high, at)]
    for places, kind in ((true, "true"), (told, "path")):
        if len(places) > 1:
            line = "L".join(f"{x} {y}" for x, y in (at(*place) for place in places))
            parts.append(f'<path class="{kind}" d="M{line}"/>')
    for place in targets:
        x, y = at(*place)
        parts.append(f'<path class="mark" d="M{x} {y - 9}L{x + 9} {y}L{x} {y + 9}L{x - 9} {y}Z"/>')
    begun = true if len(true) else told
    if len(begun):
        x, y = at(*begun[0])
        parts.append(f'<circle class="start" cx="{x}" cy="{y}" r="6"/>')
    x, y = at(low[0], low[1])
    parts.append(f'<path class="line" d="M{x + 12} {y - 12}h{scale:.1f}" style="stroke:var(--ink);stroke-width:3"/>')
    parts.append(f'<text x="{x + 12}" y="{y - 18}">1 m</text>')
    said = "Circle: the start. Line: where the robot was by its odometry."
    said += " Dashed: where it really was." if len(true) else ""
    said += " Diamond: the thing." if len(targets) else ""
    svg = f'<svg viewBox="0 0 {wide:.0f} {tall:.0f}" role="img" aria-label="the path from above">{"".join(parts)}</svg>'
    return svg, said


def _floor(plan: Plan, low: np.ndarray, high: np.ndarray, at: Callable[[float, float], tuple[float, float]]) -> str:
    """Walls, and where the robot cannot be, as runs of cells along each row."""
    parts = []
    for mask, kind in ((~plan.free & ~plan.walls, "full"), (plan.walls, "wall")):
        path = []
        for row in range(mask.shape[0]):
            y = plan.origin[1] + row * plan.cell
            if not low[1] - plan.cell <= y <= high[1]:
                continue
            edges = np.flatnonzero(np.diff(np.concatenate([[0], mask[row].astype(np.int8), [0]])))
            for begin, end in edges.reshape(-1, 2):
                x0, x1 = (plan.origin[0] + column * plan.cell for column in (begin, end))
                if x1 < low[0] or x0 > high[0]:
                    continue
                (a, b), (c, d) = at(max(x0, low[0]), y), at(min(x1, high[0]), y + plan.cell)
                path.append(f"M{a} {b}H{c}V{d}H{a}Z")
        parts.append(f'<path class="{kind}" d="{"".join(path)}"/>')
    return "".join(parts)


def time_lines(samples: Sequence[Sample]) -> str:
    """Azimuth with its cone, error, presence, speeds (wanted and sent), mode and status over time, as SVG."""
    if not samples:
        return "<p>There was no answer.</p>"
    begin, span = samples[0].time, max(samples[-1].time - samples[0].time, 1.0)
    strips, ends = Strips(LEFT, WIDE, begin, span), [*(sample.time for sample in samples[1:]), samples[-1].time]
    for name, (top, bottom) in ROWS.items():
        strips.text(name, (top + bottom) / 2)
        if bottom - top > 20:
            strips.rule(bottom)

    def curve(name: str, values: Sequence[float | None], low: float, high: float, kind: str = "curve") -> None:
        """Values as steps; broken where they are None."""
        lasting = zip(samples, ends, values, strict=True)
        rows = [(each.time, end, v) for each, end, v in lasting if v is not None and math.isfinite(v)]
        strips.steps(np.array(rows).reshape(-1, 3), ROWS[name], low, high, kind, joined=kind != "given")

    cones = [
        (s.time, end, s.azimuth, s.cone or 0.0) for s, end in zip(samples, ends, strict=True) if s.azimuth is not None
    ]
    strips.boxes(cone_bands(cones), ROWS["azimuth"], -180, 180, "band")
    strips.rule(sum(ROWS["azimuth"]) / 2)
    curve("azimuth", [None if s.azimuth is None else math.degrees(s.azimuth) for s in samples], -180, 180, "given")
    errors = [None if s.error is None else math.degrees(s.error) for s in samples]
    if known := [error for error in errors if error is not None]:
        largest = max(5.0, *known)
        curve("error", errors, 0.0, largest)
        strips.text(f"{largest:.0f}°", ROWS["error"][0] + 6, LEFT + 4, "start")
    curve("presence", [sample.presence for sample in samples], 0.0, 1.0)
    for name, which, low, high in (("speed", 0, -0.15, 0.6), ("turning", 2, -0.9, 0.9)):
        curve(name, [sample.wanted[which] for sample in samples], low, high, "wanted")
        curve(name, [0.0 if sample.sent is None else sample.sent[which] for sample in samples], low, high)
    strips.stretches(_stretches(samples, "mode"), ROWS["mode"], {"dry run": "dry"})
    strips.stretches(_stretches(samples, "status"), ROWS["status"], {})
    return strips.svg(TALL, "Azimuth of the answer, error, presence, speeds, mode of the guard and status over time")


def _stretches(samples: Sequence[Sample], name: str) -> list[tuple[float, float, str]]:
    """Begin and end of each stretch in which a word stays the same, and the word."""
    words = [getattr(sample, name) for sample in samples]
    begins = [index for index in range(len(words)) if index == 0 or words[index] != words[index - 1]]
    ends = [*(samples[index].time for index in begins[1:]), samples[-1].time]
    return [(samples[index].time, end, words[index]) for index, end in zip(begins, ends, strict=True)]
