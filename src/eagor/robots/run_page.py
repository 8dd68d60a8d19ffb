"""A robot's walk as one HTML file: the path from above, the time line, pictures with the belief, what it did and why.

The file needs nothing else: it opens from disk and sends no request. All words from outside are escaped.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from eagor._files import written
from eagor.drawing.html_parts import as_address, facts, filled, key
from eagor.drawing.step import ScenePainter
from eagor.drawing.timeline import Thinned
from eagor.drawing.walk import MODES, Plan, Sample, map_of, time_lines
from eagor.grids import PerspectiveGrid
from eagor.robots.safety.gate import Mode
from eagor.tracking.estimate import Estimate

__all__ = ["Plan", "RobotPage", "Sample", "summary"]

PICTURES, WIDTH, KEPT = 24, 800, 1120  # pictures; columns of each, and of what is kept of one
EVERY = 1.0  # seconds between two pictures, at least
ROWS = 400  # of the table
SWAY = 0.1  # metres

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
