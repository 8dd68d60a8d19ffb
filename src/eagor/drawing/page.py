"""A whole track as one HTML file: the answer, the frames to look through, the time line, a table, what was used.

The file needs nothing else: it opens from disk and sends no request. All words from outside are escaped.
"""

from __future__ import annotations

import json
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
from eagor.drawing.animation import Thinned
from eagor.drawing.page_parts import FULL, LEFT, WIDE, as_address, key, moment_in_words, row, time_line
from eagor.drawing.step import ScenePainter
from eagor.drawing.timeline import Moment, TimeLine
from eagor.drawing.words import STATUS, answer_in_words, far_in_words
from eagor.errors import EagorError, StorageError
from eagor.tracking.estimate import Estimate

__all__ = ["BeliefPage", "Step", "write_page"]

PICTURES = 60  # of `as_address`: 7.4 MB as text, so that the page can be sent by mail
WIDTH = 1120  # columns of a picture
ROWS = 1500  # of the table
NAMED = 50  # problems that are listed
COLUMNS = ("frame", "time (s)", "picture", "azimuth (°)", "elevation (°)", "90 % cone (°)", "presence", "status")


@dataclass(frozen=True, eq=False)
class Step:
    """One frame: its panorama ``(H, W, 3)``, or None if it cannot be read; the answer; when; its name; a problem."""

    panorama: np.ndarray | None
    estimate: Estimate
    stamp: float | None = None
    name: str = ""
    problem: str | None = None


class BeliefPage:
    """Takes the steps of a track one by one and writes the page to `path` when it is closed.

    Use it as a context manager: the page is written after Ctrl-C or an error too, and says that the run did not end.
    Of more than 60 frames every second picture is dropped (again and again), and of more than 1500 every second row of
    the table; the page says so. It has at most about 8 MB.

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
        self._closed = False

    def add(
        self,
        panorama: np.ndarray | None,
        estimate: Estimate,
        *,
        stamp: float | None = None,
        name: str = "",
        problem: str | None = None,
    ) -> None:
        """Append one step, as in `Step`. Raises `TimeError` unless the stamps grow."""
        moment = Moment.of(estimate, stamp, problem)
        self.line.add(moment)
        self._last = estimate
        name = name or f"frame {self._rows.count}"
        if problem:
            self._problems.append((name, problem))
        picture = None
        if self._pictures.wants:
            picture = as_address(self._painter.paint(panorama, estimate, problem))
        self._pictures.add((picture, self._rows.count, name, moment))
        self._rows.add((self._rows.count, name, moment))

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
        shown = {index: number for number, (_, index, _, _) in enumerate(pictures)}
        return Template((templates / "track.html").read_text(encoding="utf-8")).substitute(
            title=escape(f"Where is “{query}”?"),
            css=(templates / "track.css").read_text(encoding="utf-8"),
            script=(templates / "track.js").read_text(encoding="utf-8"),
            data=json.dumps(data, ensure_ascii=False).replace("<", "\\u003c").replace("&", "\\u0026"),
            answer=escape(self._answer()),
            status=escape(self._status()),
            first=pictures[0][0],
            said=escape(steps[0]["said"]),
            most=len(pictures) - 1,
            count=len(pictures),
            pictures=escape(self._thinned()),
            line=time_line(self.line),
            key=key(),
            heads="".join(f'<th scope="col">{head}</th>' for head in COLUMNS),
            rows="\n".join(row(index, name, moment, shown.get(index)) for index, name, moment in self._rows.items),
            used="".join(f"<dt>{escape(str(k))}</dt><dd>{escape(str(v))}</dd>" for k, v in self._facts().items()),
            left_out=self._left_out(),
            version=__version__,
        )

    def _answer(self) -> str:
        last, estimate = self.line.last, self._last
        assert last is not None
        assert estimate is not None
        if last.azimuth is None:
            return "No direction is known."
        words, far = answer_in_words(estimate), far_in_words(estimate)
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

    def _facts(self) -> dict[str, str]:
        return self.used | {"frames": str(self._rows.count), "version": f"eagor {__version__}"}

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
            page.add(step.panorama, step.estimate, stamp=step.stamp, name=step.name, problem=step.problem)
    if page.line.last is None:
        raise EagorError(f"{path}: there are no steps; wanted at least one frame")
    return page.path


def _said(name: str, moment: Moment) -> str:
    """A frame and its answer in a line; its time only once, if it is in the name too."""
    at, words = f"{moment.stamp:.2f} s", moment_in_words(moment)
    return f"{name}: {words.removeprefix(f'{at}, ') if name.endswith(at) else words}"
