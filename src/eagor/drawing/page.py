"""A whole track as one HTML file: the answer, the frames to look through, the time line, a table, what was used.

The file needs nothing else: it opens from disk and sends no request. All words from outside are escaped.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from html import escape
from pathlib import Path
from types import TracebackType

import numpy as np

from eagor._files import written
from eagor._values import wide
from eagor._version import __version__
from eagor.drawing.html_parts import FULL, Strips, as_address, facts, filled, items, key
from eagor.drawing.step import ScenePainter
from eagor.drawing.style import STATUS, candidates_in_words, far_in_words, in_words, signed, status_in_words
from eagor.drawing.timeline import COLOURS, SIDES, Moment, Thinned, TimeLine
from eagor.errors import EagorError, StorageError
from eagor.grids import PerspectiveGrid
from eagor.tracking.estimate import Estimate

__all__ = ["BeliefPage"]

PICTURES = 60  # of `as_address`: 7.4 MB as text, so that the page can be sent by mail
WIDTH = 1120  # columns of a picture
ROWS = 1500  # of the table
NAMED = 50  # problems that are listed
COLUMNS = ("frame", "time (s)", "picture", "azimuth (°)", "elevation (°)", "90 % cone (°)", "presence", "status")
LEFT, WIDE = 64, 914  # user units of the time line: where the axis begins, its width
AZIMUTH_STRIP, PRESENCE_STRIP, STATUS_STRIP = (8, 148), (158, 186), (194, 206)  # rows: from, to
TALL = 226  # the whole height
AROUND = (  # what a picture of a panorama shows
    "The middle of a picture is ahead of the camera, its edges are behind it. Cyan: the answer, with an arrow that "
    "shows which way to turn where 90 % lie within 90 degrees of it."
)
IN_VIEW = (  # and one of an ordinary camera
    "Large: the camera's picture. Small: all around, with straight ahead in the middle and the outline of the picture; "
    "what was not looked at yet is dark. Cyan: the answer; out of view, an arrow at the edge of the picture leads to "
    "it, unless it may be anywhere. “80 % sure”: the probability that it is here, and within 15 degrees of the answer "
    "or half its own size."
)


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
        self._problems: list[str] = []
        self._last: tuple[int, str, Moment]  # what is known of the newest frame, and all that is drawn of it
        self._newest: tuple[np.ndarray | None, Estimate, str | None, PerspectiveGrid | None]
        self._ordinary = self._closed = False

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
        """Append one frame: what was seen, the answer, when, its name, why it could not be used.

        `picture` ``(H, W, 3)``: a panorama, or what an ordinary camera with this `grid` saw; None if it cannot be read.
        Raises `TimeError` unless the stamps grow.
        """
        moment = Moment.of(estimate, stamp, problem)
        self.line.add(moment)
        name = name or f"frame {self._rows.count}"
        if problem:
            self._problems.append(f"{name}: {problem}")
        self._ordinary = self._ordinary or grid is not None
        self._last, self._newest = (self._rows.count, name, moment), (picture, estimate, problem, grid)
        if not self._pictures.wants:
            self._painter.look(picture, estimate, grid)
        self._pictures.add((self._painted() if self._pictures.wants else None, *self._last))
        self._rows.add(self._last)

    def _painted(self) -> str:
        """The picture of the frame that was added last."""
        return as_address(self._painter.paint(*self._newest))

    def note(self, text: str) -> None:
        """A sentence under "What was left out"."""
        self.notes.append(text)

    def close(self) -> None:
        """Write the page; nothing without steps. Raises `StorageError`."""
        if self._closed or self.line.last is None:
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
        query, pictures = " ".join(self.query.split()), self._pictures.items
        if pictures[-1][1] != self._last[0]:  # the answer above is that of the last frame: it is shown first
            pictures = [*pictures, (self._painted(), *self._last)]
        steps = [
            {
                "picture": picture,
                "said": _said(name, moment),
                "name": name,
                "at": round(moment.stamp - self.line.first, 4),
                "row": index,
                "x": None if self._ordinary or moment.azimuth is None else round(0.5 - moment.azimuth / (2 * np.pi), 4),
            }
            for picture, index, name, moment in pictures
        ]
        data = {"steps": steps, "left": LEFT, "wide": WIDE, "full": FULL, "span": self.line.span}
        used = self.used | {"frames": str(self._rows.count), "version": f"eagor {__version__}"}
        shown = {index: number for number, (_, index, _, _) in enumerate(pictures)}
        more = [f"and {len(self._problems) - NAMED} more frames"] if len(self._problems) > NAMED else []
        left_out = [*self.notes, *self._problems[:NAMED], *more]
        lines = [("answer", "answer, presence"), ("band", "azimuths of its 90 % cone")]
        return filled(
            "track.html", "track.css",
            title=escape(f"Where is “{query}”?"),
            data=json.dumps(data, ensure_ascii=False).replace("<", "\\u003c").replace("&", "\\u0026"),
            answer=escape(self._answer()),
            status=escape(self._status()),
            shown=pictures[-1][0],
            said=escape(steps[-1]["said"]),
            most=len(pictures) - 1,
            count=len(pictures),
            seen=escape(IN_VIEW if self._ordinary else AROUND),
            pictures=escape(self._thinned()),
            line=time_line(self.line),
            key=key([*lines, *((status, f"status: {status}") for status in COLOURS)]),
            heads="".join(f'<th scope="col">{head}</th>' for head in COLUMNS),
            rows="\n".join(_row(index, name, moment, shown.get(index)) for index, name, moment in self._rows.items),
            used=facts(used),
            left_out=items(left_out) if left_out else "<p>Nothing: every frame was used.</p>",
        )  # fmt: skip

    def _answer(self) -> str:
        _, estimate, *_ = self._newest
        words, far = candidates_in_words(estimate), far_in_words(estimate)
        return f"{words[0].upper()}{words[1:]}{f', {far} away' if far else ''}, in the last frame."

    def _status(self) -> str:
        _, _, last = self._last
        estimate = self._newest[1]
        texts = [f"The status is {last.status}: {status_in_words(last.status, last.presence)}."]
        texts.append(f"The probability that it is here at all is {last.presence:.2f}.")
        if last.cone is not None:
            texts.append(f"The belief: {estimate.certainty}.")
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


def time_line(line: TimeLine) -> str:
    """The time line as SVG, with a line ``now`` that can be moved."""
    strips, (top, bottom) = Strips(LEFT, WIDE, 0.0, line.span), AZIMUTH_STRIP
    for at, name in SIDES:
        y = bottom - (bottom - top) * (at + 180) / 360
        strips.rule(y)
        strips.text(name, y)
    for row, name in ((PRESENCE_STRIP, "presence"), (STATUS_STRIP, "status")):
        strips.text(name, sum(row) / 2)
    strips.boxes(line.bands(), AZIMUTH_STRIP, -180, 180, "band")
    strips.steps(line.answers(), AZIMUTH_STRIP, -180, 180, "given", joined=False)
    strips.boxes(np.insert(line.presence(), 2, 0.0, axis=1), PRESENCE_STRIP, 0, 1, "presence")
    strips.stretches(line.stretches(), STATUS_STRIP, {})
    now = f'<line id="now" class="now" x1="{LEFT}" x2="{LEFT}" y1="{top}" y2="{STATUS_STRIP[1]}"/>'
    said = "Azimuth of the answer with its 90 percent cone, presence and status over time"
    return strips.svg(TALL, said, line.first if 0 <= line.first < 1e5 else 0.0, now, ' id="timeline"')


def _said(name: str, moment: Moment) -> str:
    """A frame and its answer in a line; its time only once, if it is in the name too."""
    where, at = "direction not known", f"{moment.stamp:.2f} s"
    if moment.azimuth is not None and moment.elevation is not None and moment.cone is not None:
        where = in_words(moment.azimuth, moment.elevation)
        where += "" if moment.status == "ambiguous" else f", 90 % within {wide(moment.cone)}"
    said = f"{where}; {moment.status}; presence {moment.presence:.2f}"
    said += f"; left out: {moment.problem}" if moment.problem else ""
    return f"{name}: {said}" if name.endswith(at) else f"{name}: {at}, {said}"


def _row(index: int, name: str, moment: Moment, picture: int | None) -> str:
    """A row of the table; `picture`: the number of its picture, if it has one."""
    cone = "–" if moment.cone is None else f"{math.degrees(moment.cone):.1f}"
    angles = ["–" if angle is None else signed(angle).replace("-", "−") for angle in (moment.azimuth, moment.elevation)]
    show = "–"
    if picture is not None:
        show = f'<button type="button" data-step="{picture}" aria-label="show {escape(name)}">show</button>'
    status = f"{moment.status}, left out" if moment.problem else moment.status
    cells = [f"{moment.stamp:.3f}", show, *angles, cone, f"{moment.presence:.2f}", status]
    return f'<tr id="row{index}"><td>{escape(name)}</td>{"".join(f"<td>{cell}</td>" for cell in cells)}</tr>'
