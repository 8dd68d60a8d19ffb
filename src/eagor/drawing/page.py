"""A whole track as one HTML file: the answer, the frames to look through, the time line, a table, what was used.

The file needs nothing else: it opens from disk and sends no request. All words from outside are escaped.
"""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from types import TracebackType

import numpy as np

from eagor._files import written
from eagor._version import __version__
from eagor.drawing.step import ScenePainter
from eagor.drawing.style import STATUS, candidates_in_words, far_in_words, in_words, signed
from eagor.drawing.timeline import COLOURS, SIDES, Moment, Thinned, TimeLine, ticks
from eagor.errors import EagorError, StorageError
from eagor.grids import PerspectiveGrid
from eagor.tracking.estimate import Estimate

__all__ = ["BeliefPage", "Step", "as_address", "write_page"]

PICTURES = 60  # of `as_address`: 7.4 MB as text, so that the page can be sent by mail
WIDTH = 1120  # columns of a picture
ROWS = 1500  # of the table
NAMED = 50  # problems that are listed
COLUMNS = ("frame", "time (s)", "picture", "azimuth (°)", "elevation (°)", "90 % cone (°)", "presence", "status")
FULL, LEFT, WIDE = 1000, 64, 914  # user units: the whole width, where the axis begins, its width
AZIMUTH_STRIP, PRESENCE_STRIP, STATUS_STRIP = (8, 148), (158, 186), (194, 206)  # rows: from, to
TALL = 226  # the whole height
LARGEST = 92_000  # bytes of a picture
QUALITIES = (82, 74, 66, 58, 48, 36)  # of JPEG, best first


@dataclass(frozen=True, eq=False)
class Step:
    """One frame: its picture ``(H, W, 3)``, or None if it cannot be read; the answer; when; its name; a problem.

    The picture is a panorama, or what an ordinary camera with this `grid` saw.
    """

    picture: np.ndarray | None
    estimate: Estimate
    stamp: float | None = None
    name: str = ""
    problem: str | None = None
    grid: PerspectiveGrid | None = None


class BeliefPage:
    """Takes the steps of a track one by one and writes the page to `path` when it is closed.

    Use it as a context manager: the page is written after Ctrl-C or an error too, and says that the run did not end.
    Of more than 60 frames every second picture is dropped (again and again, but never that of the last frame, which is
    shown first, as the answer above it is that of the last), and of more than 1500 every second row of the table; the
    page says so. It has at most about 8 MB.

    Args:
        path: the file, .html.
        query: what was looked for.
        used: what the answers come from, by name: perception, poses, calibration, ...; the version is added.
        span: length of the clip in seconds, if known.

    Raises `EagorError` for another suffix, or if there is no such folder.
    """

    def __init__(
        self, path: str | Path, *, query: str, used: Mapping[str, str] | None = None, span: float | None = None
    ) -> None:
        self.path, self.query, self.used = Path(path), query, dict(used or {})
        if self.path.suffix.lower() not in (".html", ".htm"):
            raise EagorError(f"{path} ends in {self.path.suffix or 'nothing'}; wanted a page, .html")
        if not self.path.absolute().parent.is_dir():
            raise EagorError(f"{path}: there is no folder {self.path.absolute().parent}; make it first")
        self.line = TimeLine(span)
        self.notes: list[str] = []
        self._painter = ScenePainter(WIDTH)
        self._pictures, self._rows = Thinned(PICTURES), Thinned(ROWS)
        self._problems: list[tuple[str, str]] = []
        self._last: Estimate | None = None
        self._newest: tuple[np.ndarray | None, str | None, PerspectiveGrid | None] = None, None, None
        self._end: tuple[int, str, Moment]
        self._closed = False

    def add(
        self,
        picture: np.ndarray | None,
        estimate: Estimate,
        *,
        stamp: float | None = None,
        name: str = "",
        problem: str | None = None,
        grid: PerspectiveGrid | None = None,
    ) -> None:
        """Append one step, as in `Step`. Raises `TimeError` unless the stamps grow."""
        moment = Moment.of(estimate, stamp, problem)
        self.line.add(moment)
        self._last = estimate
        name = name or f"frame {self._rows.count}"
        if problem:
            self._problems.append((name, problem))
        self._newest = picture, problem, grid
        step = (self._rows.count, name, moment)
        if not self._pictures.wants:
            self._painter.look(picture, estimate, grid)
        self._pictures.add((self._painted() if self._pictures.wants else None, *step))
        self._rows.add(step)
        self._end = step

    def _painted(self) -> str:
        """The picture of the frame that was added last."""
        picture, problem, grid = self._newest
        assert self._last is not None
        return as_address(self._painter.paint(picture, self._last, problem, grid))

    def note(self, text: str) -> None:
        """A sentence under "What was left out"."""
        self.notes.append(text)

    def close(self) -> None:
        """Write the page; nothing without steps. Raises `StorageError`."""
        if self._closed or self._last is None:
            return
        self._closed = True
        written(self.path, self._page())

    def __enter__(self) -> BeliefPage:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            why = "it was interrupted" if isinstance(error, KeyboardInterrupt) else str(error) or type(error).__name__
            self.notes.insert(0, f"The run did not end ({why}); the page holds what came before.")
        try:
            self.close()
        except StorageError:
            if error is None:  # else the first error says what was wrong
                raise

    def _page(self) -> str:
        templates, query = files("eagor.drawing") / "templates", " ".join(self.query.split())
        pictures = self._pictures.items
        if pictures[-1][1] != self._end[0]:  # the answer above is that of the last frame: it is shown first
            pictures = [*pictures, (self._painted(), *self._end)]
        steps = [
            {
                "picture": picture,
                "said": _said(name, moment),
                "name": name,
                "at": round(moment.stamp - self.line.first, 4),
                "row": index,
                "x": None if moment.azimuth is None else round(0.5 - moment.azimuth / (2 * np.pi), 4),
            }
            for picture, index, name, moment in pictures
        ]
        data = {"steps": steps, "left": LEFT, "wide": WIDE, "full": FULL, "span": self.line.span}
        facts = self.used | {"frames": str(self._rows.count), "version": f"eagor {__version__}"}
        shown = {index: number for number, (_, index, _, _) in enumerate(pictures)}
        return Template((templates / "track.html").read_text(encoding="utf-8")).substitute(
            title=escape(f"Where is “{query}”?"),
            css=(templates / "track.css").read_text(encoding="utf-8"),
            script=(templates / "track.js").read_text(encoding="utf-8"),
            data=json.dumps(data, ensure_ascii=False).replace("<", "\\u003c").replace("&", "\\u0026"),
            answer=escape(self._answer()),
            status=escape(self._status()),
            shown=pictures[-1][0],
            said=escape(steps[-1]["said"]),
            most=len(pictures) - 1,
            count=len(pictures),
            pictures=escape(self._thinned()),
            line=time_line(self.line),
            key=key(),
            heads="".join(f'<th scope="col">{head}</th>' for head in COLUMNS),
            rows="\n".join(row(index, name, moment, shown.get(index)) for index, name, moment in self._rows.items),
            used="".join(f"<dt>{escape(str(k))}</dt><dd>{escape(str(v))}</dd>" for k, v in facts.items()),
            left_out=self._left_out(),
            version=__version__,
        )

    def _answer(self) -> str:
        last, estimate = self.line.last, self._last
        assert last is not None
        assert estimate is not None
        if last.azimuth is None:
            return "No direction is known."
        words, far = candidates_in_words(estimate), far_in_words(estimate)
        return f"{words[0].upper()}{words[1:]}{f', {far} away' if far else ''}, in the last frame."

    def _status(self) -> str:
        last = self.line.last
        assert last is not None
        texts = [f"The status is {last.status}: {STATUS[last.status]}."]
        texts.append(f"The probability that it is here at all is {last.presence:.2f}.")
        if last.cone is not None:
            texts.append(f"90 % of the belief lies within {np.degrees(last.cone):.0f} degrees of the answer.")
        whole = max(self.line.end, 1e-9)
        lasting = {name: 0.0 for name in STATUS}
        for begin, end, name in self.line.stretches():
            lasting[name] += end - begin
        shares = [f"{100 * time / whole:.0f} % {name}" for name, time in lasting.items() if time > 0]
        return " ".join(texts) + f" Of {self.line.now:.1f} seconds: {', '.join(shares)}."

    def _thinned(self) -> str:
        texts = []
        if self._pictures.stride > 1:
            texts.append(f"One of {self._pictures.stride} frames has a picture ({self._pictures.count} frames).")
        if self._rows.stride > 1:
            texts.append(f"The table has one of {self._rows.stride} frames.")
        return " ".join(texts)

    def _left_out(self) -> str:
        texts = [*self.notes, *(f"{name}: {problem}" for name, problem in self._problems[:NAMED])]
        if len(self._problems) > NAMED:
            texts.append(f"and {len(self._problems) - NAMED} more frames")
        if not texts:
            return "<p>Nothing: every frame was used.</p>"
        return f"<ul>{''.join(f'<li>{escape(text)}</li>' for text in texts)}</ul>"


def write_page(
    path: str | Path,
    steps: Iterable[Step],
    *,
    query: str,
    used: Mapping[str, str] | None = None,
    span: float | None = None,
) -> Path:
    """Write the page of a whole track; returns its path. Arguments and errors as for `BeliefPage`.

    Raises `EagorError` without steps.
    """
    with BeliefPage(path, query=query, used=used, span=span) as page:
        for step in steps:
            page.add(
                step.picture, step.estimate, stamp=step.stamp, name=step.name, problem=step.problem, grid=step.grid
            )
    if page.line.last is None:
        raise EagorError(f"{path}: there are no steps; wanted at least one frame")
    return page.path


def _said(name: str, moment: Moment) -> str:
    """A frame and its answer in a line; its time only once, if it is in the name too."""
    at, words = f"{moment.stamp:.2f} s", moment_in_words(moment)
    return f"{name}: {words.removeprefix(f'{at}, ') if name.endswith(at) else words}"


# --- the parts: time line, table, pictures ----------------------------------------------------------------------------


def time_line(line: TimeLine) -> str:
    """The time line as SVG; classes give the colours, and the line ``now`` can be moved."""
    scale = WIDE / line.span

    def x(time: float) -> float:
        return round(LEFT + scale * time, 2)

    def boxes(rows: np.ndarray, top: float, bottom: float, low: float, high: float, kind: str) -> str:
        """Rectangles ``(n, 4)``, begin, end, low and high, as one path."""
        per = (bottom - top) / (high - low)
        path = "".join(
            f"M{x(begin)} {bottom - per * (a - low):.1f}V{bottom - per * (b - low):.1f}H{x(end)}"
            f"V{bottom - per * (a - low):.1f}Z"
            for begin, end, a, b in rows
        )
        return f'<path class="{kind}" d="{path}"/>' if path else ""

    (top, bottom), parts = AZIMUTH_STRIP, []
    for at, name in SIDES:
        y = bottom - (bottom - top) * (at + 180) / 360
        parts.append(f'<line class="line" x1="{LEFT}" x2="{LEFT + WIDE}" y1="{y}" y2="{y}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4}" text-anchor="end">{name}</text>')
    for (a, b), name in ((PRESENCE_STRIP, "presence"), (STATUS_STRIP, "status")):
        parts.append(f'<text x="{LEFT - 6}" y="{(a + b) / 2 + 4}" text-anchor="end">{name}</text>')
    parts.append(boxes(line.bands(), *AZIMUTH_STRIP, -180, 180, "band"))
    path = "".join(
        f"M{x(begin)} {bottom - (bottom - top) * (at + 180) / 360:.1f}H{x(end)}" for begin, end, at in line.answers()
    )
    parts.append(f'<path class="given" fill="none" d="{path}"/>' if path else "")
    parts.append(boxes(np.insert(line.presence(), 2, 0.0, axis=1), *PRESENCE_STRIP, 0, 1, "presence"))
    for begin, end, status in line.stretches():
        where = f'x="{x(begin)}" y="{STATUS_STRIP[0]}" width="{max(0.5, scale * (end - begin)):.2f}" height="12"'
        parts.append(f'<rect class="{status}" {where}><title>{status}, {end - begin:.2f} s</title></rect>')
    offset = line.first if 0 <= line.first < 1e5 else 0.0
    for time in ticks(line.span):
        parts.append(f'<text x="{x(time)}" y="{TALL - 5}" text-anchor="middle">{offset + time:g} s</text>')
    parts.append(f'<line id="now" class="now" x1="{LEFT}" x2="{LEFT}" y1="{top}" y2="{STATUS_STRIP[1]}"/>')
    said = "Azimuth of the answer with its 90 percent cone, presence and status over time"
    inside = "".join(parts)
    return f'<svg id="timeline" viewBox="0 0 {FULL} {TALL}" role="img" aria-label="{said}">{inside}</svg>'


def key() -> str:
    """What the colours of the time line mean, as items of a list."""
    statuses = [(f"var(--{status})", f"status: {status}") for status in COLOURS]
    lines = [("var(--answer)", "answer, presence"), ("var(--band)", "azimuths of its 90 % cone")]
    return "".join(f'<li><i style="background:{colour}"></i>{name}</li>' for colour, name in [*lines, *statuses])


def moment_in_words(moment: Moment) -> str:
    """The answer at one time, in a line."""
    where = "direction not known"
    if moment.azimuth is not None and moment.elevation is not None and moment.cone is not None:
        where = f"{in_words(moment.azimuth, moment.elevation)}, 90 % within {math.degrees(moment.cone):.0f}°"
    said = f"{moment.stamp:.2f} s, {where}; {moment.status}; presence {moment.presence:.2f}"
    return f"{said}; left out: {moment.problem}" if moment.problem else said


def row(index: int, name: str, moment: Moment, picture: int | None) -> str:
    """A row of the table; `picture`: the number of its picture, if it has one."""
    cone = "–" if moment.cone is None else f"{math.degrees(moment.cone):.1f}"
    angles = ["–" if angle is None else signed(angle).replace("-", "−") for angle in (moment.azimuth, moment.elevation)]
    show = "–"
    if picture is not None:
        show = f'<button type="button" data-step="{picture}" aria-label="show {escape(name)}">show</button>'
    status = f"{moment.status}, left out" if moment.problem else moment.status
    cells = [f"{moment.stamp:.3f}", show, *angles, cone, f"{moment.presence:.2f}", status]
    return f'<tr id="row{index}"><td>{escape(name)}</td>{"".join(f"<td>{cell}</td>" for cell in cells)}</tr>'


def as_address(pixels: np.ndarray) -> str:
    """A picture as a data URL of a JPEG of at most `LARGEST` bytes; a picture too busy for that is made smaller."""
    from PIL import Image

    picture = Image.fromarray(pixels)
    while True:
        for quality in QUALITIES:
            buffer = io.BytesIO()
            picture.save(buffer, "JPEG", quality=quality, optimize=True)
            if buffer.tell() <= LARGEST:
                return f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
        picture = picture.resize((picture.width * 3 // 4, picture.height * 3 // 4))
