"""The answers of a whole clip over time: what a time line shows, for videos (pixels) and pages (SVG) alike.

An answer holds from its time until the next one, and is drawn so: nothing is interpolated between two answers. A
robot's walk, its distances and speeds over the same time, is drawn as SVG here too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.errors import TimeError
from eagor.tracking.estimate import Estimate

__all__ = ["COLOURS", "MODES", "SIDES", "Moment", "Plan", "Sample", "Thinned", "TimeLine", "map_of", "time_lines"]

# By status. They differ in brightness too, and each is named beside the time line.
COLOURS = {"searching": "#7d8796", "tracking": "#2fd0e6", "ambiguous": "#ffb000", "stale": "#b48cff"}
# Azimuths in degrees, and what they are called.
SIDES = ((180, "behind"), (90, "left"), (0, "ahead"), (-90, "right"), (-180, "behind"))
MOST = 2400  # moments that are kept for curves: more than a picture has columns
SPANS = (1, 2, 5)  # the steps, times powers of ten, by which a time line of unknown length grows


class Thinned:
    """At most `most` items of a stream of unknown length, evenly spread: when it is full, every second one goes."""

    def __init__(self, most: int) -> None:
        self.items: list[Any] = []
        self.count, self.stride, self.most = 0, 1, most

    @property
    def wants(self) -> bool:
        """Whether the next item would be kept."""
        return self.count % self.stride == 0

    def add(self, item: Any) -> None:
        """Append an item, or pass over it."""
        if self.wants:
            self.items.append(item)
        self.count += 1
        if len(self.items) > self.most:
            self.items, self.stride = self.items[::2], 2 * self.stride


@dataclass(frozen=True)
class Moment:
    """The answer at one time.

    `stamp`: seconds; `azimuth`, `elevation`, `cone` (half-angle of the 90 % cone): radians, None while nothing is
    known; `problem`: why the frame could not be used, if so.
    """

    stamp: float
    status: str
    presence: float
    azimuth: float | None = None
    elevation: float | None = None
    cone: float | None = None
    problem: str | None = None

    @classmethod
    def of(cls, estimate: Estimate, stamp: float | None = None, problem: str | None = None) -> Moment:
        """The answer of `estimate`, for a frame of time `stamp` (None: the estimate's)."""
        known = estimate.azimuth is not None
        return cls(
            float(estimate.stamp if stamp is None else stamp), estimate.status, float(estimate.presence),
            estimate.azimuth, estimate.elevation, float(estimate.credible_angle) if known else None,
            problem,
        )  # fmt: skip

    @property
    def half_width(self) -> float:
        """Half of the range of azimuths (radians) that the cone about the answer covers; pi if it holds a pole.

        The meridians that touch a cap of radius r at elevation e are asin(sin r / cos e) off its centre.
        """
        if self.cone is None or self.elevation is None:
            return 0.0
        if self.cone + abs(self.elevation) >= math.pi / 2:
            return math.pi
        return math.asin(min(1.0, math.sin(self.cone) / math.cos(self.elevation)))


class TimeLine:
    """The moments so far, in order of time.

    `span`: the seconds, from the first stamp on, that the axis shows, if the length of the clip is known. Without it
    the axis grows with the moments. Of more than 2400 moments every second one is dropped from the curves; statuses
    keep all their changes.
    """

    def __init__(self, span: float | None = None) -> None:
        if span is not None and not (math.isfinite(span) and span >= 0):
            raise TimeError(f"a time line of {span} seconds; wanted the length of the clip, or None")
        self.given = span
        self.last: Moment | None = None
        self.first = 0.0
        self._kept = Thinned(MOST)
        self._stretches: list[tuple[float, str]] = []  # since when, which status

    def add(self, moment: Moment) -> None:
        """Append a moment. Raises `TimeError` unless its stamp is finite and later than the last one."""
        if not math.isfinite(moment.stamp):
            raise TimeError(f"the stamp {moment.stamp}; wanted a finite time in seconds")
        if self.last is not None and moment.stamp <= self.last.stamp:
            raise TimeError(
                f"the stamp {moment.stamp:g} s comes after {self.last.stamp:g} s; wanted frames in order of time"
            )
        if self.last is None:
            self.first = moment.stamp
        if self.last is None or moment.status != self.last.status:
            self._stretches.append((moment.stamp, moment.status))
        self._kept.add(moment)
        self.last = moment

    @property
    def now(self) -> float:
        """Seconds since the first stamp."""
        return 0.0 if self.last is None else self.last.stamp - self.first

    @property
    def span(self) -> float:
        """Seconds on the axis."""
        if self.given is not None:
            return max(self.given, self.now, 1e-3)
        decade = 10.0 ** math.floor(math.log10(max(self.now, 1.0)))
        return next(step * decade for step in (*SPANS, 10) if step * decade >= self.now)

    @property
    def end(self) -> float:
        """Until when the last answer is drawn: for as long as the one before it, within the axis."""
        if len(self._kept.items) < 2 or self.last is None:
            return min(self.span, self.now + self.span / 200)
        before = [kept for kept in self._kept.items[-2:] if kept is not self.last][-1]
        return min(self.span, self.now + (self.last.stamp - before.stamp))

    def stretches(self) -> list[tuple[float, float, str]]:
        """Begin and end (seconds since the first stamp) of each stretch of one status."""
        begins = [begin - self.first for begin, _ in self._stretches]
        return [
            (begin, end, status)
            for begin, end, (_, status) in zip(begins, [*begins[1:], self.end], self._stretches, strict=False)
        ]

    def presence(self) -> np.ndarray:
        """Begin, end (seconds) and presence of each moment ``(n, 3)``."""
        return np.array([(begin, end, m.presence) for begin, end, m in self._lasting()]).reshape(-1, 3)

    def answers(self) -> np.ndarray:
        """Begin, end (seconds) and azimuth (degrees) of each answer ``(n, 3)``."""
        found = [(b, e, math.degrees(m.azimuth)) for b, e, m in self._lasting() if m.azimuth is not None]
        return np.array(found, dtype=float).reshape(-1, 3)

    def bands(self) -> np.ndarray:
        """Begin, end (seconds), lowest and highest azimuth (degrees) of the 90 % cones ``(n, 4)``; cut at the seam."""
        found = []
        for begin, end, moment in self._lasting():
            if moment.azimuth is None:
                continue
            middle, half = math.degrees(moment.azimuth), math.degrees(moment.half_width)
            low, high = middle - half, middle + half
            if half >= 180:
                found.append((begin, end, -180.0, 180.0))
            elif low < -180:
                found += [(begin, end, -180.0, high), (begin, end, low + 360, 180.0)]
            elif high > 180:
                found += [(begin, end, low, 180.0), (begin, end, -180.0, high - 360)]
            else:
                found.append((begin, end, low, high))
        return np.array(found, dtype=float).reshape(-1, 4)

    def _lasting(self) -> list[tuple[float, float, Moment]]:
        """The kept moments with begin and end (seconds since the first stamp)."""
        begins = [moment.stamp - self.first for moment in self._kept.items]
        return list(zip(begins, [*begins[1:], self.end], self._kept.items, strict=False))


def ticks(span: float, most: int = 8) -> Sequence[float]:
    """Round times from 0 to `span`, at most `most` + 1."""
    rough = span / most
    decade = 10.0 ** math.floor(math.log10(rough))
    step = next(step * decade for step in (*SPANS, 10) if step * decade >= rough)
    return [round(step * index, 9) for index in range(math.floor(span / step + 1e-9) + 1)]


# --- a robot's walk as SVG --------------------------------------------------------------------------------------------

# The colour of each mode of the gate, among the names of the page's style.
MODES = {"dry run": "band", "armed": "tracking", "stopping": "alarm", "standing": "searching", "latched": "stale"}
_CLASS = {"dry run": "dry"}
FULL, LEFT, WIDE = 1000, 84, 896  # user units: the whole width, where the axis begins, its width
SIDE = 560  # of the map, at most
MARGIN = 0.6  # metres around the path
LEAST = 2.0  # metres that the map shows at least
ROWS = (  # name, top, bottom
    ("azimuth", 8, 118), ("error", 130, 180), ("presence", 192, 222), ("speed", 234, 284), ("turning", 296, 346),
    ("mode", 358, 372), ("status", 378, 392),
)  # fmt: skip
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
    scale = WIDE / span

    def x(time: float) -> float:
        return round(LEFT + scale * (time - begin), 1)

    parts = []
    for name, top, bottom in ROWS:
        parts.append(f'<text x="{LEFT - 8}" y="{(top + bottom) / 2 + 4}" text-anchor="end">{name}</text>')
        if bottom - top > 20:
            parts.append(f'<line class="line" x1="{LEFT}" x2="{LEFT + WIDE}" y1="{bottom}" y2="{bottom}"/>')
    rows = {name: (top, bottom) for name, top, bottom in ROWS}
    times = [sample.time for sample in samples]
    parts.append(_cones(samples, rows["azimuth"], x))
    errors = [None if sample.error is None else math.degrees(sample.error) for sample in samples]
    largest = max((error for error in errors if error is not None), default=0.0)
    parts.append(_curve(times, errors, rows["error"], (0.0, max(5.0, largest)), x, "curve"))
    if any(error is not None for error in errors):
        parts.append(f'<text x="{LEFT + 4}" y="{rows["error"][0] + 10}">{max(5.0, largest):.0f}°</text>')
    parts.append(_curve(times, [sample.presence for sample in samples], rows["presence"], (0.0, 1.0), x, "curve"))
    for name, which, most in (("speed", 0, 0.6), ("turning", 2, 0.9)):
        span_of = (-0.25 * most if name == "speed" else -most, most)
        wanted = [sample.wanted[which] for sample in samples]
        sent = [0.0 if sample.sent is None else sample.sent[which] for sample in samples]
        parts.append(_curve(times, wanted, rows[name], span_of, x, "wanted"))
        parts.append(_curve(times, sent, rows[name], span_of, x, "curve"))
    for name, value in (("mode", "mode"), ("status", "status")):
        parts.append(_stretches(samples, value, rows[name], x))
    for time in ticks(span):
        parts.append(f'<text x="{x(begin + time)}" y="{TALL - 4}" text-anchor="middle">{time:g} s</text>')
    said = "Azimuth of the answer, error, presence, speeds, mode of the guard and status over time"
    return f'<svg viewBox="0 0 {FULL} {TALL}" role="img" aria-label="{said}">{"".join(parts)}</svg>'


def _curve(
    times: Sequence[float],
    values: Sequence[float | None],
    row: tuple[float, float],
    span: tuple[float, float],
    x: Callable[[float], float],
    kind: str,
) -> str:
    """Values as steps; broken where they are None."""
    (top, bottom), (low, high) = row, span
    path, before = "", None
    for time, value in zip(times, values, strict=True):
        if value is None or not math.isfinite(value):
            before = None
            continue
        y = round(bottom - (bottom - top) * (min(max(value, low), high) - low) / (high - low), 1)
        path += f"M{x(time)} {y}" if before is None else f"H{x(time)}V{y}"
        before = y
    return f'<path class="{kind}" d="{path}"/>' if path else ""


def _cones(samples: Sequence[Sample], row: tuple[float, float], x: Callable[[float], float]) -> str:
    """The answer's azimuth, left is up, with its cone; both edges are straight behind."""
    (top, bottom), bands, answers = row, "", ""
    per = (bottom - top) / (2 * math.pi)

    def y(azimuth: float) -> float:
        return round(bottom - per * (azimuth + math.pi), 1)

    for sample, after in zip(samples, [*samples[1:], samples[-1]], strict=True):
        if sample.azimuth is None:
            continue
        begin, end = x(sample.time), x(after.time) + 0.3
        cone = min(sample.cone or 0.0, math.pi)
        for turn in (-2 * math.pi, 0.0, 2 * math.pi):
            low = max(sample.azimuth - cone + turn, -math.pi)
            high = min(sample.azimuth + cone + turn, math.pi)
            if low < high:
                bands += f"M{begin} {y(low)}V{y(high)}H{end}V{y(low)}Z"
        answers += f"M{begin} {y(sample.azimuth)}H{end}"
    middle = (top + bottom) / 2
    ahead = f'<line class="line" x1="{LEFT}" x2="{LEFT + WIDE}" y1="{middle}" y2="{middle}"/>'
    return f'<path class="band" d="{bands}"/>{ahead}<path class="given" fill="none" d="{answers}"/>'


def _stretches(samples: Sequence[Sample], name: str, row: tuple[float, float], x: Callable[[float], float]) -> str:
    """Boxes over the times in which a word stays the same."""
    parts, begin = [], 0
    for index in range(1, len(samples) + 1):
        value = getattr(samples[begin], name)
        if index < len(samples) and getattr(samples[index], name) == value:
            continue
        end = samples[min(index, len(samples) - 1)].time
        wide = max(0.5, x(end) - x(samples[begin].time))
        title = f"{value}, {end - samples[begin].time:.2f} s"
        parts.append(
            f'<rect class="{_CLASS.get(value, value)}" x="{x(samples[begin].time)}" y="{row[0]}" width="{wide:.1f}" '
            f'height="{row[1] - row[0]}"><title>{title}</title></rect>'
        )
        begin = index
    return "".join(parts)
