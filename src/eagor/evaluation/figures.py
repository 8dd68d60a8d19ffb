"""The charts of a report, each with its numbers as a table; and the kernel: what cutting harmonics does to a point.

The band-limited delta at angle t from its centre is ``K(t) = sum over l <= L of (2 l + 1) / (4 pi) P_l(cos t)``: how
wide a point becomes when it is cut at a degree, and how high its ripples are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from eagor.evaluation import traces
from eagor.evaluation.page import (
    Curve,
    Folded,
    Heading,
    Part,
    Pictures,
    Row,
    Section,
    Series,
    Sheet,
    Text,
    box,
    line_chart,
    look_of,
)
from eagor.evaluation.samples import Record, method_names
from eagor.evaluation.tables import OURS, PAPERS, RESOLUTION_DEG, RIVALS, degree_of, is_rival, ordered, varied_by
from eagor.tasks.task import Task

_ANGLES = np.linspace(0.0, math.pi, 36001)  # 0.005 degrees apart


def curve_sections(records: Sequence[Record], task: Task) -> list[Section]:
    """Errors against steps, for the methods of the paper and for the others, each beside ours."""
    if not task.walked and not any("leg" in record["truth"] for record in records):
        return _by_kind(records, task)
    seam = _panels(
        records,
        lambda method: traces.around(records, method, traces.crossings, traces.ABOUT_SEAM, traces.ABOUT_SEAM),
        "Error around seam crossings",
        "steps from the crossing",
        "seam",
    )
    if task.walked:
        steps = _panels(records, partial(traces.by_step, records), "Error by step")
        note = Text(
            "Every method goes its own way. A line ends where fewer than half of its episodes go on: those that arrive "
            "early leave it, so the right end of a line is about the harder episodes.",
            "note",
        )
        first = Section("steps", "Error by step", [*steps, note] if steps else [])
    else:
        turn = _panels(
            records,
            lambda method: traces.around(records, method, traces.turns, traces.BEFORE, traces.AFTER, alone=True),
            "Error after a turn",
            "steps from the first step of a leg",
            "turn",
        )
        first = Section("turns", "Error after a turn", turn)
    return [section for section in (first, Section("seam", "Error around seam crossings", seam)) if section.parts]


def _by_kind(records: Sequence[Record], task: Task) -> list[Section]:
    """Errors by step, for each kind of episode by itself (the first of the task's strata)."""
    key = next(iter(task.strata), "")
    parts: list[Part] = []
    labels = dict.fromkeys(record["episode"].get("stratum", {}).get(key) for record in records)
    for label in labels:
        some = [r for r in records if r["episode"].get("stratum", {}).get(key) == label]
        said = "all episodes" if label is None else str(label)
        parts.append(Heading(said))
        parts += _panels(records, lambda name, some=some: traces.by_step(some, name), f"Error by step, {said}")
    return [Section("steps", "Error by step", parts)] if parts else []


def _panels(
    records: Sequence[Record],
    curve_of: Callable[[str], Curve | None],
    title: str,
    x_label: str = "step",
    event: str = "",
) -> list[Part]:
    """Two charts with one scale: the paper's methods and ours, the further rivals and ours; none without any case."""
    names = [name for name in ordered(method_names(records)) if is_rival(name)]
    found = {name: curve for name in names if (curve := curve_of(name)) is not None}
    if not found:
        return []
    top = max(v for curve in found.values() for v in (*curve.y, *curve.high) if v is not None)
    pictures, lines = [], []
    paper = (*RIVALS, PAPERS)
    for label, group in (
        ("the paper's methods", [name for name in found if name in paper]),
        ("further methods", [name for name in found if name not in paper and name != OURS]),
    ):
        chosen = [*group, *([OURS] if OURS in found else [])]
        if not group and pictures:
            continue
        series = [Series(name, found[name], look_of(name), name == OURS) for name in chosen]
        if not series:
            continue
        whole = f"{title}: {label} and {OURS}" if group and OURS in chosen else title
        chart = line_chart(series, whole, x_label, "error, degrees", (0.0, 1.03 * top), event)
        pictures.append((chart, f"{whole}. Means over {_episodes(series)}; bands: 95 % intervals."))
        lines += [line for line in series if line not in lines]
    return [Pictures(pictures), Folded("The numbers", [_numbers(title, x_label, lines)])]


def _numbers(title: str, x_label: str, series: Sequence[Series]) -> Sheet:
    """A chart's numbers as a table."""
    xs = sorted({x for line in series for x in line.curve.x})
    rows = []
    for line in series:
        known = dict(zip(line.curve.x, zip(line.curve.y, line.curve.low, line.curve.high, strict=True), strict=True))
        cells = (known.get(x, (None, None, None)) for x in xs)
        rows.append(Row(line.name, tuple(box(y, ends) for y, *ends in cells)))
    heads = (x_label, *(f"{x:g}".replace("-", "−") for x in xs))
    return Sheet(title, heads, tuple(rows), (f"Means over {_episodes(series)}.",))


def _episodes(series: Sequence[Series]) -> str:
    """How many episodes are behind the lines."""
    counts = [max(line.curve.n) for line in series]
    low, high = min(counts), max(counts)
    return f"{high} episodes" if low == high else f"{low} to {high} episodes, by method"


def reliability_chart(records: Sequence[Record]) -> list[Part]:
    """Stated against found, for regions of every mass, where the records say enough."""
    names = [name for name in ordered(method_names(records)) if is_rival(name)]
    found = [
        Series(name, curve, look_of(name), name == OURS)
        for name in names
        if (curve := traces.reliability(records, name)) is not None
    ]
    if not found:
        return []
    title = "Regions of every mass: stated, and found to hold the truth"
    chart = line_chart(
        found, title, "stated mass of the region, %", "steps with the truth inside, %", (0.0, 100.0), diagonal=True
    )
    caption = "On the dotted line statements are true; below it they are overconfident, above it too cautious."
    return [Pictures([(chart, f"{title}. {caption}")]), Folded("The numbers", [_numbers(title, "stated, %", found)])]


def kernel_chart(summary: dict[str, Any], degrees: dict[str, int]) -> list[Part]:
    """The band-limited point at each degree that was tried."""
    tried = {degree_of(name) for name in summary["methods"] if varied_by(name)[1] == ("degree",)}
    if not tried:
        return []
    wanted = sorted({degree for degree in tried if degree is not None} | set(degrees.values()))
    angles = np.arange(0.0, 181.0, 1.0)
    series = []
    for index, degree in enumerate(wanted):
        values = tuple(float(v) for v in kernel(degree, np.radians(angles)))
        nothing = (None,) * len(values)
        curve = Curve(tuple(angles.tolist()), values, nothing, nothing, (0,) * len(values))
        series.append(Series(f"degree {degree}", curve, f"x{index % 8}", degree == degrees.get(OURS)))
    title = "A point, cut at a degree"
    chart = line_chart(series, title, "angle from the point, degrees", "of the peak", (-0.3, 1.0))
    paper = "; ".join(
        f"the paper states about {width:g}° of resolution at degree {d}" for d, width in RESOLUTION_DEG.items()
    )
    return [Pictures([(chart, f"{title}: width against ripples ({paper}).")])]


def kernel(degree: int, angles: np.ndarray) -> np.ndarray:
    """``K(t) / K(0)`` at `angles` (radians)."""
    from scipy.special import eval_legendre

    orders = np.arange(degree + 1)
    terms = (2 * orders[:, None] + 1) * eval_legendre(orders[:, None], np.cos(np.ravel(angles))[None, :])
    return terms.sum(axis=0).reshape(np.shape(angles)) / (degree + 1) ** 2


def half_width_deg(degree: int) -> float | None:
    """The angle (degrees) at which the kernel has fallen to half of its height; None if it never does (degree 0)."""
    values = kernel(degree, _ANGLES)
    below = np.flatnonzero(values <= 0.5)
    if not len(below):
        return None
    k = int(below[0])
    share = (values[k - 1] - 0.5) / (values[k - 1] - values[k])
    return math.degrees(float(_ANGLES[k - 1] + share * (_ANGLES[k] - _ANGLES[k - 1])))


def highest_sidelobe(degree: int) -> float | None:
    """The largest ``|K(t)| / K(0)`` beyond the kernel's first zero; None if it has none (degree 0)."""
    values = kernel(degree, _ANGLES)
    below = np.flatnonzero(values <= 0.0)
    return float(np.abs(values[below[0] :]).max()) if len(below) else None
