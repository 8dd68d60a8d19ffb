"""The parts of a track's page: the time line as SVG, rows of the table, a moment in words, a picture as an address."""

from __future__ import annotations

import base64
import io
import math
from html import escape

import numpy as np

from eagor.drawing.timeline import COLOURS, Moment, TimeLine, ticks
from eagor.drawing.words import in_words, signed

__all__ = ["FULL", "LEFT", "WIDE", "as_address", "key", "moment_in_words", "row", "time_line"]

FULL, LEFT, WIDE = 1000, 64, 914  # user units: the whole width, where the axis begins, its width
AZIMUTH, PRESENCE, STATUS, TALL = (8, 148), (158, 186), (194, 206), 226  # rows: from, to; the whole height
LARGEST = 92_000  # bytes of a picture
QUALITIES = (82, 74, 66, 58, 48, 36)  # of JPEG, best first
SIDES = ((180, "behind"), (90, "left"), (0, "ahead"), (-90, "right"), (-180, "behind"))


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

    (top, bottom), parts = AZIMUTH, []
    for at, name in SIDES:
        y = bottom - (bottom - top) * (at + 180) / 360
        parts.append(f'<line class="line" x1="{LEFT}" x2="{LEFT + WIDE}" y1="{y}" y2="{y}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4}" text-anchor="end">{name}</text>')
    for (a, b), name in ((PRESENCE, "presence"), (STATUS, "status")):
        parts.append(f'<text x="{LEFT - 6}" y="{(a + b) / 2 + 4}" text-anchor="end">{name}</text>')
    parts.append(boxes(line.bands(), *AZIMUTH, -180, 180, "band"))
    path = "".join(
        f"M{x(begin)} {bottom - (bottom - top) * (at + 180) / 360:.1f}H{x(end)}" for begin, end, at in line.answers()
    )
    parts.append(f'<path class="given" fill="none" d="{path}"/>' if path else "")
    parts.append(boxes(np.insert(line.presence(), 2, 0.0, axis=1), *PRESENCE, 0, 1, "presence"))
    for begin, end, status in line.stretches():
        where = f'x="{x(begin)}" y="{STATUS[0]}" width="{max(0.5, scale * (end - begin)):.2f}" height="12"'
        parts.append(f'<rect class="{status}" {where}><title>{status}, {end - begin:.2f} s</title></rect>')
    offset = line.first if 0 <= line.first < 1e5 else 0.0
    for time in ticks(line.span):
        parts.append(f'<text x="{x(time)}" y="{TALL - 5}" text-anchor="middle">{offset + time:g} s</text>')
    parts.append(f'<line id="now" class="now" x1="{LEFT}" x2="{LEFT}" y1="{top}" y2="{STATUS[1]}"/>')
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
