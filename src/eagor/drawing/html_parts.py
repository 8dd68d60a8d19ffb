"""The pieces of single-file pages: a template filled, facts, lists, keys of colours, pictures, rows over one time line.

A page of these needs nothing else: it opens from disk and sends no request. All words from outside are escaped.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from string import Template

import numpy as np

from eagor._version import __version__
from eagor.drawing.timeline import ticks

__all__ = ["Strips", "as_address", "facts", "filled", "items", "key"]

LARGEST = 92_000  # bytes of a picture
QUALITIES = (82, 74, 66, 58, 48, 36)  # of JPEG, best first
FULL = 1000  # user units: the width of a time line

Row = tuple[float, float]  # of a time line: its top and bottom, user units


def filled(template: str, style: str, **values: object) -> str:
    """The page that a template of this package makes of `values`, HTML, with this style sheet."""
    folder = files("eagor.drawing") / "templates"
    page, css = ((folder / name).read_text(encoding="utf-8") for name in (template, style))
    return Template(page).substitute(css=css, version=__version__, **values)


def facts(pairs: Mapping[str, str] | Sequence[tuple[str, str]]) -> str:
    """Names and what they are."""
    told = pairs.items() if isinstance(pairs, Mapping) else pairs
    return f"<dl>{''.join(f'<dt>{escape(str(name))}</dt><dd>{escape(str(value))}</dd>' for name, value in told)}</dl>"


def items(texts: Iterable[str]) -> str:
    """A list."""
    return f"<ul>{''.join(f'<li>{escape(text)}</li>' for text in texts)}</ul>"


def key(colours: Iterable[tuple[str, str]]) -> str:
    """What colours mean: names of the style sheet's colours, and words."""
    told = (f'<li><i style="background:var(--{colour})"></i>{escape(words)}</li>' for colour, words in colours)
    return f'<ul class="key">{"".join(told)}</ul>'


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


class Strips:
    """Rows over one time line, as SVG; classes give the colours.

    `left`, `wide`: where the axis begins, and its width, of `FULL` user units. `begin`, `span`: its times, seconds.
    """

    def __init__(self, left: float, wide: float, begin: float, span: float) -> None:
        self._left, self._wide, self._begin, self._span = left, wide, begin, span
        self._parts: list[str] = []

    def x(self, time: float) -> float:
        """Where a time is."""
        return round(self._left + self._wide * (time - self._begin) / self._span, 2)

    def text(self, words: str, y: float, x: float | None = None, anchor: str = "end") -> None:
        """Words, by default before the axis."""
        at = self._left - 6 if x is None else x
        self._parts.append(f'<text x="{at}" y="{y + 4}" text-anchor="{anchor}">{escape(words)}</text>')

    def rule(self, y: float) -> None:
        """A thin line along the axis."""
        ends = f'x1="{self._left}" x2="{self._left + self._wide}" y1="{y}" y2="{y}"'
        self._parts.append(f'<line class="line" {ends}/>')

    def boxes(self, rows: np.ndarray, row: Row, low: float, high: float, kind: str) -> None:
        """Rectangles ``(n, 4)``: begin, end, and two values between `low` and `high`."""
        y = self._heights(row, low, high)
        self._path("".join(f"M{self.x(b)} {y(v)}V{y(w)}H{self.x(e)}V{y(v)}Z" for b, e, v, w in rows), f'class="{kind}"')

    def steps(self, rows: np.ndarray, row: Row, low: float, high: float, kind: str, joined: bool = True) -> None:
        """Values ``(n, 3)`` with begin and end, between `low` and `high`; `joined` where one follows another."""
        y, path, before = self._heights(row, low, high), "", None
        for begin, end, value in rows:
            path += f"V{y(value)}" if joined and begin == before else f"M{self.x(begin)} {y(value)}"
            path, before = f"{path}H{self.x(end)}", end
        self._path(path, f'class="{kind}" fill="none"')

    def stretches(self, found: Iterable[tuple[float, float, str]], row: Row, kinds: Mapping[str, str]) -> None:
        """Boxes from begin to end of each stretch, with its word as title; `kinds`: the class of a word, if another."""
        for begin, end, word in found:
            where = f'x="{self.x(begin)}" y="{row[0]}" width="{max(0.5, self.x(end) - self.x(begin)):.2f}"'
            shape = f'<rect class="{kinds.get(word, word)}" {where} height="{row[1] - row[0]}">'
            self._parts.append(f"{shape}<title>{escape(word)}, {end - begin:.2f} s</title></rect>")

    def svg(self, tall: float, said: str, offset: float = 0.0, more: str = "", name: str = "") -> str:
        """All of it, `tall` user units high, with times from `offset` on below; `said`: for who does not see it."""
        for time in ticks(self._span):
            self.text(f"{offset + time:g} s", tall - 9, self.x(self._begin + time), "middle")
        inside = "".join([*self._parts, more])
        return f'<svg{name} viewBox="0 0 {FULL} {tall}" role="img" aria-label="{said}">{inside}</svg>'

    def _heights(self, row: Row, low: float, high: float) -> Callable[[float], float]:
        """What gives the height of a value; one beyond the row is drawn at its edge."""
        top, bottom = row
        return lambda value: round(bottom - (bottom - top) * (min(max(value, low), high) - low) / (high - low), 1)

    def _path(self, path: str, look: str) -> None:
        self._parts.append(f'<path {look} d="{path}"/>' if path else "")
