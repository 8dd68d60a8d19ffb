"""A whole track as one HTML file: the answer, the frames to look through, the time line, a table, what was used.

The file needs nothing else: it opens from disk and sends no request. All words from outside are escaped.
"""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

import numpy as np

from eagor._files import written
from eagor._values import wide
from eagor._version import __version__
from eagor.drawing.step import StepPainter
from eagor.drawing.style import (
    candidates_in_words,
    far_in_words,
    in_words,
    signed,
    status_in_words,
)
from eagor.drawing.timeline import Thinned, TimeLine, TimelinePoint
from eagor.errors import EagorError
from eagor.grids import PerspectiveGrid
from eagor.tracking.estimate import Estimate

__all__ = ["BeliefPage"]

PICTURES = 60  # of `as_address`: 7.4 MB as text, so that the page can be sent by mail
WIDTH = 1120  # columns of a picture
LARGEST = 92_000  # bytes of a picture
ROWS = 1500  # of the table
NAMED = 50  # problems that are listed
WIDE = 914  # user units of the time line's axis, in the template


class BeliefPage(AbstractContextManager["BeliefPage"]):
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

    Folders above it are made. Raises `EagorError` for another suffix.
    """

    def __init__(
        self, path: str | Path, *, query: str, used: Mapping[str, str] | None = None, span: float | None = None
    ) -> None:
        self.path, self.query, self.used = Path(path), query, dict(used or {})
        if self.path.suffix.lower() not in (".html", ".htm"):
            raise EagorError(f"{path} ends in {self.path.suffix or 'nothing'}; wanted a page, .html")
        self.line = TimeLine(span)
        self.notes: list[str] = []  # sentences under "What was left out"
        self.painter = StepPainter(WIDTH, bare=True)
        self._pictures, self._rows = Thinned(PICTURES), Thinned(ROWS)
        self._problems: list[str] = []
        self._last: tuple[int, str, TimelinePoint]  # what is known of the newest frame, and all that is drawn of it
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
        """Append one frame with its `name`; other arguments as for `StepPainter.paint`.

        Raises `TimeError` unless the stamps grow.
        """
        moment = TimelinePoint.of(estimate, stamp, problem)
        self.line.add(moment)
        name = name or f"frame {self._rows.count}"
        if problem:
            self._problems.append(f"{name}: {problem}")
        self._ordinary = self._ordinary or grid is not None
        self._last, self._newest = (self._rows.count, name, moment), (picture, estimate, problem, grid)
        if not self._pictures.wants and grid is not None and picture is not None:  # it is part of what is around
            self.painter.mosaic.add(picture, grid, estimate.world_R_body)
        self._pictures.add((self._painted() if self._pictures.wants else None, *self._last))
        self._rows.add(self._last)

    def _painted(self) -> str:
        """The picture of the frame that was added last."""
        picture, estimate, problem, grid = self._newest
        return as_address(self.painter.paint(picture, estimate, problem=problem, grid=grid))

    def close(self) -> None:
        """Write the page; nothing without steps. Raises `StorageError`."""
        if not self._closed and self.line.last is not None:
            self._closed = True
            written(self.path, self._page())

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None:
            why = "it was interrupted" if isinstance(error, KeyboardInterrupt) else str(error) or type(error).__name__
            self.notes.insert(0, f"The run did not end ({why}); the page holds what came before.")
        self.close()

    def _page(self) -> str:
        pictures = self._pictures.items
        if pictures[-1][1] != self._last[0]:  # the answer above is that of the last frame: it is shown first
            pictures = [*pictures, (self._painted(), *self._last)]
        steps = [
            {
                "picture": picture,
                "said": _said(name, moment),
                "name": name,
                "at": round(moment.stamp - self.line.first, 4),
                "row": index,
                "x": None if self._ordinary or moment.azimuth is None else round(0.5 - moment.azimuth / math.tau, 4),
            }
            for picture, index, name, moment in pictures
        ]
        data = {"steps": steps, "span": self.line.span}
        used = self.used | {"frames": str(self._rows.count), "version": f"eagor {__version__}"}
        shown = {index: number for number, (_, index, _, _) in enumerate(pictures)}
        more = [f"and {len(self._problems) - NAMED} more frames"] if len(self._problems) > NAMED else []
        left_out = [*self.notes, *self._problems[:NAMED], *more]
        thinned = []
        if (kept := self._pictures).stride > 1:
            thinned.append(f"One of {kept.stride} frames has a picture ({kept.count} frames).")
        if self._rows.stride > 1:
            thinned.append(f"The table has one of {self._rows.stride} frames.")
        scale, last, (_, estimate, *_) = WIDE / self.line.span, self._last[2], self._newest
        words, far = candidates_in_words(estimate), far_in_words(estimate)
        folder = files("eagor.drawing") / "templates"
        page, css = ((folder / name).read_text(encoding="utf-8") for name in ("track.html", "track.css"))
        return Template(page).substitute(
            css=css,
            version=__version__,
            query=escape(" ".join(self.query.split())),
            data=json.dumps(data, ensure_ascii=False).replace("<", "\\u003c").replace("&", "\\u0026"),
            answer=escape(f"{words[0].upper()}{words[1:]}{f', {far} away' if far else ''}"),
            status=last.status,
            meaning=status_in_words(last.status, last.presence),
            here=f"{last.presence:.2f}",
            belief="" if last.cone is None else f"The belief: {estimate.certainty}.",
            shown=pictures[-1][0],
            said=escape(steps[-1]["said"]),
            most=len(pictures) - 1,
            count=len(pictures),
            seen="ordinary" if self._ordinary else "whole",
            pictures=" ".join(thinned),
            scale=f"{scale:.6g}",
            ticks="".join(f'<text x="{scale * at:.2f}">{name}</text>' for at, name in self.line.ticks()),
            **{name: path(boxes) for name, boxes in self.line.boxes().items()},
            rows="\n".join(_row(index, name, moment, shown.get(index)) for index, name, moment in self._rows.items),
            used="".join(f"<dt>{escape(name)}</dt><dd>{escape(str(value))}</dd>" for name, value in used.items()),
            left_out="".join(f"<li>{escape(text)}</li>" for text in left_out or ["Nothing: every frame was used."]),
        )


def as_address(pixels: np.ndarray) -> str:
    """A picture as a data URL of a JPEG of at most `LARGEST` bytes; a picture too busy for that is made smaller."""
    from PIL import Image

    picture, quality = Image.fromarray(pixels), 82
    while True:
        buffer = io.BytesIO()
        picture.save(buffer, "JPEG", quality=quality, optimize=True)
        if buffer.tell() <= LARGEST:
            return f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
        quality -= 8
        if quality < 40:
            picture, quality = picture.resize((picture.width * 3 // 4, picture.height * 3 // 4)), 74


def path(boxes: Iterable[Iterable[float]]) -> str:
    """An SVG path around boxes: begin, end, and two values."""
    return "".join(f"M{b:.3f} {v:.3f}V{w:.3f}H{e:.3f}V{v:.3f}Z" for b, e, v, w in boxes)


def _said(name: str, moment: TimelinePoint) -> str:
    """A frame and its answer in a line; its time only once, if it is in the name too."""
    where, at = "direction not known", f"{moment.stamp:.2f} s"
    if moment.azimuth is not None and moment.elevation is not None and moment.cone is not None:
        where = in_words(moment.azimuth, moment.elevation)
        where += "" if moment.status == "ambiguous" else f", 90 % within {wide(moment.cone)}"
    said = f"{where}; {moment.status}; presence {moment.presence:.2f}"
    said += f"; left out: {moment.problem}" if moment.problem else ""
    return f"{name}: {said}" if name.endswith(at) else f"{name}: {at}, {said}"


def _row(index: int, name: str, moment: TimelinePoint, picture: int | None) -> str:
    """A row of the table; `picture`: the number of its picture, if it has one."""
    cone = "–" if moment.cone is None else f"{math.degrees(moment.cone):.1f}"
    angles = ["–" if angle is None else signed(angle).replace("-", "−") for angle in (moment.azimuth, moment.elevation)]
    show = "–"
    if picture is not None:
        show = f'<button type="button" data-step="{picture}" aria-label="show {escape(name)}">show</button>'
    status = f"{moment.status}, left out" if moment.problem else moment.status
    cells = [f"{moment.stamp:.3f}", show, *angles, cone, f"{moment.presence:.2f}", status]
    return f'<tr id="row{index}"><td>{escape(name)}</td>{"".join(f"<td>{cell}</td>" for cell in cells)}</tr>'
