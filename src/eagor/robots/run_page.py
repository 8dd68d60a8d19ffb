"""A robot's walk as one HTML file: the path from above, the time line, pictures with the belief, what it did and why.

The file needs nothing else: it opens from disk and sends no request. All words from outside are escaped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from eagor._files import written
from eagor.drawing.html_parts import FULL, Strips, as_address, facts, filled, key
from eagor.drawing.step import ScenePainter
from eagor.drawing.timeline import Thinned, cone_bands
from eagor.grids import PerspectiveGrid
from eagor.robots.safety.gate import Mode
from eagor.tracking.estimate import Estimate

__all__ = ["Plan", "RobotPage", "Sample", "summary"]

PICTURES, WIDTH, KEPT = 24, 800, 1120  # pictures; columns of each, and of what is kept of one
EVERY = 1.0  # seconds between two pictures, at least
ROWS = 400  # of the table
SWAY = 0.1  # metres

# The colour of each mode of the gate, among the names of the page's style.
MODES = {"dry run": "band", "armed": "tracking", "stopping": "alarm", "standing": "searching", "latched": "stale"}
_KEY = [
    ("answer", "answer, commands sent"), ("band", "90 % cone"), ("ambiguous", "wanted, truth"),
    *((MODES[mode], str(mode)) for mode in Mode),
]  # fmt: skip


class RobotPage:
    """Takes the samples of a walk one by one; `write` makes the page of all of them.

    `query`: what was looked for; `used`: facts, by name; `plan`: the floor, where it is known. Adding is quick, as it
    happens while the robot walks; pictures are painted when the page is written.
    """

    def __init__(self, query: str, used: Mapping[str, str] | None = None, plan: Plan | None = None) -> None:
        self.query, self.used, self.plan = query, dict(used or {}), plan
        self.samples: list[Sample] = []
        self._pictures = Thinned(PICTURES)
        self._due = -math.inf

    def add(
        self,
        sample: Sample,
        picture: np.ndarray | None = None,
        estimate: Estimate | None = None,
        grid: PerspectiveGrid | None = None,
    ) -> None:
        """Append a sample, with the newest picture ``(H, W, 3)`` uint8 and the estimate, to be drawn.

        `grid`: its pixels, if an ordinary camera took it; None: it is a panorama.
        """
        self.samples.append(sample)
        if picture is None or estimate is None or sample.time < self._due:
            return
        self._due = sample.time + EVERY
        if self._pictures.wants:
            step = max(1, -(-picture.shape[1] // KEPT))
            picture = picture[::step, ::step].copy()
            grid = None if grid is None else grid.resized(*picture.shape[:2])
        self._pictures.add((sample, picture, estimate, grid))

    def write(self, path: Path) -> Path:
        """Write the page, .html; returns its path. Raises `StorageError`."""
        return written(path, self._page())

    def _page(self) -> str:
        svg, said = map_of(self.samples, self.plan)
        return filled(
            "robot.html", "track.css",
            title=escape(f"To “{' '.join(self.query.split())}”"),
            answer=escape(f"At the end: {self.samples[-1].words}." if self.samples else "No answer was given."),
            summary=escape(self._summary()),
            map=svg,
            map_key=escape(said),
            line=time_lines(self.samples),
            key=key(_KEY),
            pictures=self._painted(),
            rows="\n".join(self._rows()),
            used=facts(self.used),
        )  # fmt: skip

    def _summary(self) -> str:
        facts = summary(self.samples)
        if not facts:
            return ""
        texts = [f"{facts['seconds']:.1f} s, {facts['metres']:.2f} m by odometry, {facts['stops']} StopMove."]
        if facts["median_error_deg"] is not None:
            texts.append(f"Median error of the direction while it was tracking: {facts['median_error_deg']:.1f}°.")
        return " ".join(texts)

    def _painted(self) -> str:
        painter, parts = ScenePainter(WIDTH), []
        for sample, picture, estimate, grid in self._pictures.items:
            said = escape(f"{sample.time:.1f} s: {sample.status}, presence {sample.presence:.2f}; {sample.words}")
            drawn = as_address(painter.paint(picture, estimate, grid=grid))
            parts.append(f'<figure><img alt="{said}" src="{drawn}"><figcaption>{said}</figcaption></figure>')
        return "".join(parts) or "<p>No picture came.</p>"

    def _rows(self) -> list[str]:
        """One row where something changes."""
        rows, before = [], None
        for sample in self.samples:
            # Numbers change all the time; what it does, the mode and the kind of reasons do not.
            kind = sample.mode, sample.doing, tuple(reason.split(" ")[:3] for reason in sample.reasons)
            if kind == before or len(rows) >= ROWS:
                continue
            before = kind
            cells = sample.mode, f"{sample.doing}: {sample.words}", "; ".join(sample.reasons) or "–"
            words = "".join(f'<td class="words">{escape(cell)}</td>' for cell in cells)
            rows.append(f"<tr><td>{sample.time:.2f}</td>{words}</tr>")
        return rows


def summary(samples: Sequence[Sample]) -> dict[str, float | int | None]:
    """Seconds, metres by odometry, StopMove sent, median error (degrees) while tracking; empty without samples."""
    if not samples:
        return {}
    places = [sample.xy for sample in samples if sample.xy is not None]
    metres, mark = 0.0, places[0] if places else (0.0, 0.0)
    for place in places:  # a camera on a walking robot sways: only what adds up is a way
        if (away := math.dist(place, mark)) >= SWAY:
            metres, mark = metres + away, place
    errors = [sample.error for sample in samples if sample.error is not None and sample.status == "tracking"]
    return {
        "seconds": samples[-1].time - samples[0].time,
        "metres": metres,
        "stops": samples[-1].stops,
        "median_error_deg": math.degrees(float(np.median(errors))) if errors else None,
    }


LEFT, WIDE = 84, 896  # user units of the time line: where the axis begins, its width
SIDE = 560  # of the map, at most
MARGIN = 0.6  # metres around the path
LEAST = 2.0  # metres that the map shows at least
STRIPS = {  # top and bottom
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
    for name, (top, bottom) in STRIPS.items():
        strips.text(name, (top + bottom) / 2)
        if bottom - top > 20:
            strips.rule(bottom)

    def curve(name: str, values: Sequence[float | None], low: float, high: float, kind: str = "curve") -> None:
        """Values as steps; broken where they are None."""
        lasting = zip(samples, ends, values, strict=True)
        rows = [(each.time, end, v) for each, end, v in lasting if v is not None and math.isfinite(v)]
        strips.steps(np.array(rows).reshape(-1, 3), STRIPS[name], low, high, kind, joined=kind != "given")

    cones = [
        (s.time, end, s.azimuth, s.cone or 0.0) for s, end in zip(samples, ends, strict=True) if s.azimuth is not None
    ]
    strips.boxes(cone_bands(cones), STRIPS["azimuth"], -180, 180, "band")
    strips.rule(sum(STRIPS["azimuth"]) / 2)
    curve("azimuth", [None if s.azimuth is None else math.degrees(s.azimuth) for s in samples], -180, 180, "given")
    errors = [None if s.error is None else math.degrees(s.error) for s in samples]
    if known := [error for error in errors if error is not None]:
        largest = max(5.0, *known)
        curve("error", errors, 0.0, largest)
        strips.text(f"{largest:.0f}°", STRIPS["error"][0] + 6, LEFT + 4, "start")
    curve("presence", [sample.presence for sample in samples], 0.0, 1.0)
    for name, which, low, high in (("speed", 0, -0.15, 0.6), ("turning", 2, -0.9, 0.9)):
        curve(name, [sample.wanted[which] for sample in samples], low, high, "wanted")
        curve(name, [0.0 if sample.sent is None else sample.sent[which] for sample in samples], low, high)
    strips.stretches(_stretches(samples, "mode"), STRIPS["mode"], {"dry run": "dry"})
    strips.stretches(_stretches(samples, "status"), STRIPS["status"], {})
    return strips.svg(TALL, "Azimuth of the answer, error, presence, speeds, mode of the guard and status over time")


def _stretches(samples: Sequence[Sample], name: str) -> list[tuple[float, float, str]]:
    """Begin and end of each stretch in which a word stays the same, and the word."""
    words = [getattr(sample, name) for sample in samples]
    begins = [index for index in range(len(words)) if index == 0 or words[index] != words[index - 1]]
    ends = [*(samples[index].time for index in begins[1:]), samples[-1].time]
    return [(samples[index].time, end, words[index]) for index, end in zip(begins, ends, strict=True)]
