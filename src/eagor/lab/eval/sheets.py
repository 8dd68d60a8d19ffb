"""The tables and charts of a report, the same for the page and for Markdown; each chart with its numbers as a table.

The band-limited delta at angle t from its centre is ``K(t) = sum over l <= L of (2 l + 1) / (4 pi) P_l(cos t)``:
how wide a point becomes when it is cut at a degree, and how high its ripples are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from eagor.lab.eval import page, tables
from eagor.lab.eval.page import Box, Curve, Part, Row, Section, Series, Sheet, box, line_chart, look_of, span
from eagor.lab.eval.samples import Gap, Record, few_groups, gap, lowest_p, method_names, sample
from eagor.lab.eval.tables import (
    FIGURES,
    OURS,
    PAPERS,
    RESOLUTION_DEG,
    RIVALS,
    SIGNIFICANT,
    best,
    corrected,
    degree_of,
    headed,
    is_ablation,
    is_rival,
    mark,
    ordered,
    own_cases,
    shown,
    shown_columns,
    varied_by,
)
from eagor.lab.tasks.task import Column, Task, load

DAGGER = {"-": "†", "+": "‡", "": ""}
KEYS = {
    "degree": "degree of the harmonics",
    "decode": "how the belief is read",
    "floor": "calibration: floor",
    "neutral": "calibration: neutral response",
    "temperature": "calibration: temperature",
    "shells": "range shells",
    "persistence": "calibration: persistence",
    "spread": "calibration: spread",
    "false_alarms_per_look": "detector: false alarms per look",
    "dspread": "detector: spread",
    "detection_probability": "detector: probability of detection",
    "habit": "detector: how often things are found",
    "look_alikes": "detector: number of look-alikes",
    "look_alike_habit": "detector: how often look-alikes are found",
    "offset": "detector: error that a place keeps",
    "spread_of_size": "detector: spread that grows with the size of a box",
    "offset_of_size": "detector: error that a place keeps and that grows with the size of a box",
    "parts": "detector: how many boxes show only a part of a thing",
    "kept_for": "detector: how long places keep their habits",
    "kept_within": "detector: how far places keep their habits",
    "wander": "how far a target wanders, if it does",
    "turn": "how fast a target turns, if it does",
    "start": "how often a target starts to move",
    "stop": "how often a target comes to stand",
    "jump": "how often a target turns up elsewhere",
    "birth": "how often a target appears",
    "death": "how often a target disappears",
    "drift": "drift of the odometry",
}


def main_sheet(summary: dict[str, Any]) -> Sheet:
    """The table laid out like the paper's, with the published row below each method that has one."""
    columns = shown_columns(summary)
    names = [name for name in summary["methods"] if not is_ablation(name)]
    rivals = [name for name in names if is_rival(name)]
    published = FIGURES.get(summary["task"], {})
    rows = []
    for name in names:
        rows.append(_row(name, _boxes(summary, name, columns, rivals)))
        if name in published:
            figures = [Box(shown(published[name].get(column.key), column)) for column in columns]
            rows.append(Row("as published", tuple(figures), "paper"))
    notes = [
        _cases(summary, names, columns),
        f"† worse, ‡ better than {summary['reference']}: p < {SIGNIFICANT} over the episodes that both have, sign "
        "flips of whole apartments, Holm's correction over all tests of this table. Bold: the best of its column.",
    ]
    if summary["reference"] == OURS in names and summary["apartments"] > 1:
        notes.append(_behind(summary, rivals, columns))
    notes += _few(summary, rivals)
    if published:
        notes.append(
            "As published: the paper's figures, from the paper's own setting (its worlds, perception and rules). They "
            "cannot be compared with ours one to one."
        )
    return Sheet(
        f"{load(summary['task']).title}: {summary['episodes']} episodes", _heads(columns), tuple(rows), tuple(notes)
    )


def _few(summary: dict[str, Any], rivals: Sequence[str]) -> list[str]:
    """What so few apartments cannot tell; nothing where there are enough, or none."""
    apartments = summary["apartments"]
    notes = few_groups(apartments, "apartment")
    if apartments == 1:
        return notes
    tests = sum(found is not None for name in rivals for found in summary["differences"].get(name, {}).values())
    lowest = lowest_p(apartments, tests)
    if tests and lowest >= SIGNIFICANT:
        notes.append(
            f"With {apartments} apartments and {tests} tests no p can be below {min(lowest, 1.0):.2g} after the "
            "correction: whatever the figures are, none of their differences is told from chance."
        )
    return notes


def _behind(summary: dict[str, Any], rivals: Sequence[str], columns: Sequence[Column]) -> str:
    """In which columns ours is worse than a rival beyond chance, by how much, and why that is."""
    found = []
    for column in columns:
        ahead = [name for name in rivals if mark(summary, name, column) == "+"]
        if ahead:
            figures = ", ".join(f"{name} {shown(summary['methods'][name][column.key], column)}" for name in ahead)
            ours = shown(summary["methods"][OURS][column.key], column)
            found.append(f"{column.title}: {ours} against {figures}{f' ({column.why})' if column.why else ''}")
    if not found:
        return f"In no column is {OURS} behind another method beyond chance."
    return f"Where {OURS} is behind beyond chance: {'; '.join(found)}."


def strata_sheets(summary: dict[str, Any]) -> list[Sheet]:
    """One table per stratum and label: the same columns, over some of the episodes."""
    found = []
    for title, labels in summary["strata"].items():
        for label, part in labels.items():
            view = {**summary, **part, "differences": {}}
            columns = shown_columns(view)
            names = [name for name in part["methods"] if not is_ablation(name)]
            rivals = list(filter(is_rival, names))
            rows = tuple(_row(name, _boxes(view, name, columns, rivals)) for name in names)
            what = f"{title}: {label} ({part['episodes']} episodes)"
            found.append(Sheet(what, _heads(columns), rows, (_cases(view, names, columns),)))
    return found


def ordering_sheet(records: Sequence[Record], task: str) -> Sheet | None:
    """How far the paper's ordering carries over: what its method gains over each rival, published and measured."""
    published = FIGURES.get(task, {})
    columns = [column for column in load(task).columns if published and column.key in published[PAPERS]]
    samples = {name: {column.key: sample(records, name, column) for column in columns} for name in (PAPERS, *RIVALS)}
    gaps: dict[tuple[str, ...], Gap | None] = {}
    for rival in RIVALS:
        for column in columns:
            pair = samples[rival][column.key], samples[PAPERS][column.key]
            gaps[rival, column.key] = gap(*(pair if column.better == "low" else pair[::-1]))
    if not any(gaps.values()):
        return None
    rows, verdicts = [], []
    for (rival,), measured in corrected(gaps).items():
        claimed, boxes = [], []
        for column in columns:
            ahead = published[rival][column.key] - published[PAPERS][column.key]
            margin, value = ahead * (1 if column.better == "low" else -1), measured[column.key]
            claimed.append(Box(shown(margin, column, True)))
            verdicts.append(verdict(margin, value))
            ends = span((value.low, value.high), column.digits, True) if value else ""
            boxes.append(Box(shown(value and value.difference, column, True), ends, verdicts[-1]))
        rows.append(Row(f"over {rival}: published", tuple(claimed), "paper"))
        rows.append(Row(f"over {rival}: measured", tuple(boxes)))
    counts = {said: verdicts.count(said) for said in ("holds", "open", "reversed")}
    notes = (
        f"Margins of {PAPERS} (the method as published) over the paper's rivals; positive: it is better. Of "
        f"{sum(counts.values())} comparisons {counts['holds']} hold (the 95 % interval lies on the published side of 0 "
        f"and p < {SIGNIFICANT}), {counts['reversed']} are reversed (on the other side), {counts['open']} are open. "
        "Each is judged for itself, without a correction for their number.",
        "Measured: paired over the episodes that both have. Published margins are differences of the printed figures.",
    )
    return Sheet(f"What {PAPERS} gains over the paper's rivals", _heads(columns, "margin"), tuple(rows), notes)


def verdict(published: float, measured: Gap | None) -> str:
    """Whether a measured margin confirms the published one: "holds", "reversed", "open"; "" where it has no case."""
    if measured is None:
        return ""
    if (measured.low > 0 or measured.high < 0) and measured.p < SIGNIFICANT:
        return "holds" if (measured.low > 0) == (published > 0) else "reversed"
    return "open"


def coverage_sheet(records: Sequence[Record], summary: dict[str, Any]) -> Sheet | None:
    """How often the truth lay in the 90 % region: all steps, in sight, out of sight."""
    column = next((column for column in load(summary["task"]).columns if column.key == "coverage"), None)
    if column is None:
        return None
    rows = []
    for name, row in summary["methods"].items():
        if is_ablation(name) or row["coverage"] is None:
            continue
        found = [_part_box(tables.coverage(records, name, visible)) for visible in (True, False)]
        rows.append(_row(name, [_box(summary, name, column), *found]))
    if not rows:
        return None
    note = (
        "Share of steps, percent, at which the true direction lay in the stated 90 % region; 90 is right, less is "
        "overconfident, more is too cautious. Methods that state no region are left out."
    )
    heads = ("method", "all steps, %", "target in sight, %", "target out of sight, %")
    return Sheet("Coverage of the 90 % regions", heads, tuple(rows), (note,))


def parts_sheet(records: Sequence[Record], summary: dict[str, Any]) -> Sheet | None:
    """What the errors are made of, and how far off the distance is."""
    rows, shares = [], {}
    for name in summary["methods"]:
        if is_ablation(name):
            continue
        found = {part: tables.error_in(records, name, part) for part in tables.PARTS}
        shares |= {part: value.share for part, value in found.items() if value is not None and name == OURS}
        after = tables.error_in(records, name, tables.SEEN)
        boxes = [_part_box(value) for value in (*found.values(), after, tables.distance_error(records, name))]
        rows.append(_row(name, boxes))
    if not rows:
        return None
    steps = ", ".join(f"{100 * share:.0f} % {part}" for part, share in shares.items())
    notes = (
        "Mean direction error over the steps of each kind, over the episodes that have such steps. Before the target "
        "was ever in sight nothing can be known of it but where it is not: that part is the price of the search, and "
        "an estimator that made no mistake would have the others at 0. The fourth column is the second and the third."
        + (f" Of the steps of {OURS}: {steps}." if steps else ""),
        f"Distance: mean relative error once the camera has moved by {100 * tables.BASELINE:.0f} % of it since the "
        "first sighting, for methods that state one.",
    )
    heads = ("method", *(f"{p} ↓, °" for p in (*tables.PARTS, tables.SEEN)), "distance ↓, %")
    return Sheet("What the errors are made of", heads, tuple(rows), notes)


def _part_box(value: tables.Part | None) -> Box:
    return box(value.mean, (value.low, value.high)) if value else box(None)


def ablation_sheets(summary: dict[str, Any], degrees: dict[str, int]) -> list[Sheet]:
    """One table per varied method and set of settings. `degrees`: those of the methods themselves, where known."""
    columns = shown_columns(summary)
    named = [(*varied_by(name), name) for name in summary["methods"] if is_ablation(name)]
    found = []
    for (base, keys), group in groupby(sorted(named, key=lambda item: item[:2]), key=lambda item: item[:2]):
        names = {name for _, _, name in group}
        rows = [base] if base in summary["methods"] else []
        rows += [name for name in summary["methods"] if name in names]
        with_kernel = keys == ("degree",)
        heads = _heads(columns)
        if with_kernel:
            heads = (heads[0], "degree", "half width, °", "highest sidelobe, %", *heads[1:])
        lines = []
        for name in rows:
            extra = _kernel_boxes(degrees.get(name) if name == base else degree_of(name)) if with_kernel else ()
            boxes = (*extra, *_boxes(summary, name, columns, rows))
            lines.append(Row(f"{name} (as it is)" if name == base else name, boxes, "ours" if name == base else ""))
        notes = [
            _cases(summary, rows, columns),
            f"† worse, ‡ better than {base}: p < {SIGNIFICANT}, Holm's correction over all tests of all variants.",
        ]
        if with_kernel:
            notes.append(
                "Half width and highest sidelobe (beyond the first zero, of the peak) are those of a point cut at this "
                "degree: sum over l of (2 l + 1) / 4π · P_l(cos t)."
            )
        what = "; ".join(KEYS.get(key, key) for key in keys)
        found.append(Sheet(f"Variants of {base}: {what}", heads, tuple(lines), tuple(notes)))
    return found


def _kernel_boxes(degree: int | None) -> tuple[Box, ...]:
    if degree is None:
        return (box(None),) * 3
    ripple = highest_sidelobe(degree)
    return Box(str(degree)), box(half_width_deg(degree)), box(None if ripple is None else 100 * ripple)


def _row(name: str, boxes: Sequence[Box]) -> Row:
    return Row(name, tuple(boxes), "ours" if name == OURS else "")


def _heads(columns: Sequence[Column], first: str = "method") -> tuple[str, ...]:
    return (first, *map(headed, columns))


def _boxes(summary: dict[str, Any], name: str, columns: Sequence[Column], rivals: Sequence[str]) -> tuple[Box, ...]:
    return tuple(_box(summary, name, column, name in best(summary, column, rivals)) for column in columns)


def _box(summary: dict[str, Any], name: str, column: Column, winner: bool = False) -> Box:
    value, interval = summary["methods"][name][column.key], summary["intervals"][name][column.key]
    small = f"{span(interval, column.digits, column.key == 'delta') or ''} {own_cases(summary, name, column)}".strip()
    return Box(shown(value, column), small, DAGGER[mark(summary, name, column)], winner)


def _cases(summary: dict[str, Any], names: Sequence[str], columns: Sequence[Column]) -> str:
    """How many episodes are behind the figures, column by column, in a few words."""
    spans: dict[str, list[str]] = {}
    for column in columns:
        counts = [n for name in names if (n := summary["counts"][name][column.key])]
        if counts:
            low, high = min(counts), max(counts)
            spans.setdefault(str(high) if low == high else f"{low} to {high}", []).append(column.title)
    cases = "; ".join(f"{', '.join(titles)}: {span}" for span, titles in spans.items())
    return f"Small print: 95 % intervals. Episodes behind each figure: {cases}."


# --- the charts of a report, each with its numbers as a table ---------------------------------------------------------

_ANGLES = np.linspace(0.0, math.pi, 36001)  # 0.005 degrees apart


def curve_sections(records: Sequence[Record], task: Task) -> list[Section]:
    """Errors against steps, for the methods of the paper and for the others, each beside ours."""
    if not task.walked and not any("leg" in record["truth"] for record in records):
        return _by_kind(records, task)
    seam = _panels(
        records,
        lambda method: tables.around(records, method, tables.crossings, tables.ABOUT_SEAM, tables.ABOUT_SEAM),
        "Error around seam crossings",
        "steps from the crossing",
        "seam",
    )
    if task.walked:
        steps = _panels(records, partial(tables.by_step, records), "Error by step")
        note = page.text(
            "Every method goes its own way. A line ends where fewer than half of its episodes go on: those that arrive "
            "early leave it, so the right end of a line is about the harder episodes.",
            "note",
        )
        first = Section("steps", "Error by step", [*steps, note] if steps else [])
    else:
        turn = _panels(
            records,
            lambda method: tables.around(records, method, tables.turns, tables.BEFORE, tables.AFTER, alone=True),
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
        parts.append(page.heading(said))
        parts += _panels(records, lambda name, some=some: tables.by_step(some, name), f"Error by step, {said}")
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
        pictures.append((chart, f"{whole}. Means over {_episodes(series)}{page.bands(series)}."))
        lines += [line for line in series if line not in lines]
    return [page.pictures(pictures), page.folded("The numbers", _numbers(title, x_label, lines))]


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
        if (curve := tables.reliability(records, name)) is not None
    ]
    if not found:
        return []
    title = "Regions of every mass: stated, and found to hold the truth"
    chart = line_chart(
        found, title, "stated mass of the region, %", "steps with the truth inside, %", (0.0, 100.0), diagonal=True
    )
    caption = "On the dotted line statements are true; below it they are overconfident, above it too cautious."
    numbers = page.folded("The numbers", _numbers(title, "stated, %", found))
    return [page.pictures([(chart, f"{title}. {caption}")]), numbers]


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
    return [page.pictures([(chart, f"{title}: width against ripples ({paper}).")])]


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
