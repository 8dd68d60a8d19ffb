"""Tables of simulated tasks; the order of their methods, and what the papers printed (``published.toml``).

And what the steps of episodes say: errors around turns and seam crossings and along the way; where they come from.
Before the first sighting, errors are the price of the search; in sight, the perception's; hidden, the memory's. Per
episode first (the mean over its events or steps), then the mean over the episodes, with intervals that resample
apartments.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from eagor.errors import EagorError
from eagor.lab.agents.methods import EVERY, ORACLE
from eagor.lab.eval.page import Curve, in_columns, number
from eagor.lab.eval.samples import (
    IN_LEGS,
    SIMULATED,
    WALKED,
    WATCHED,
    Gap,
    Measured,
    Record,
    Sample,
    checked,
    clustered,
    failures,
    finished,
    gap,
    group_of,
    holm,
    mean_intervals,
    method_names,
    numbers,
    played_by,
    sample,
)
from eagor.lab.tasks.task import Column, Task, known, load
from eagor.metrics import seam_crossings
from eagor.sphere import direction

OURS, PAPERS = "eagor", "eagor_paper"  # our default, and the method as published
RIVALS = ("centroid", "cent_circ", "grid")  # what the paper compares itself with
ORDER = (*EVERY, ORACLE)

_PRINTED = tomllib.loads((Path(__file__).parent / "published.toml").read_text(encoding="utf-8"))
FIGURES: dict[str, dict[str, dict[str, float]]] = {
    task: {name: dict(zip(rows["columns"], row, strict=False)) for name, row in rows.items() if name != "columns"}
    for task, rows in _PRINTED["figures"].items()
}
FAILURE_TAGS: dict[str, dict[str, tuple[float, float]]] = _PRINTED["failure_tags"]
RESOLUTION_DEG = {7: 25.0}  # "about 25 degrees of angular resolution", by degree


def ordered(names: Iterable[str]) -> list[str]:
    """Method names in the order of the tables: plain, the paper's, the further rivals, ours, the oracle, ablations."""
    place = {name: index for index, name in enumerate(ORDER)}
    return sorted(names, key=lambda name: (place.get(name, len(place)), *_natural(name)))


def is_ablation(name: str) -> bool:
    """Whether the method is a variation of another one: "eagor:degree=7"."""
    return ":" in name


def varied_by(name: str) -> tuple[str, tuple[str, ...]]:
    """The varied method, and the names of the settings: "eagor:degree=7" is ("eagor", ("degree",))."""
    base, _, text = name.partition(":")
    return base, tuple(item.partition("=")[0] for item in text.split(","))


def degree_of(name: str) -> int | None:
    """The degree that a variant such as "eagor:degree=7" sets; None where it sets none."""
    value = name.rpartition("=")[2]
    return int(value) if value.isdecimal() else None


def is_rival(name: str) -> bool:
    """Whether the method competes: neither a variation nor one that is told the truth."""
    return not is_ablation(name) and name != ORACLE


def compared_with(name: str, reference: str) -> str:
    """What a method is measured against: an ablation against the method that it varies, all others against one."""
    return name.partition(":")[0] if is_ablation(name) else reference


def _natural(name: str) -> tuple[str, float, str]:
    """A sort key that puts degree=7 before degree=15."""
    head, _, value = name.rpartition("=")
    try:
        return head, float(value), ""
    except ValueError:
        return (head or name), 0.0, value


# --- from the records of a simulated run to its table -----------------------------------------------------------------

_WORDS = {True: "yes", False: "no"}
SIGNIFICANT = 0.05


def summarise(records: Iterable[Record], reference: str = OURS) -> dict[str, Any]:
    """The table of one task, as plain values; each method is compared with `reference`.

    - "methods" {name: {column: value}}, "counts" and "intervals" (95 %, of whole apartments: Wilson's for shares of
      success, else a bootstrap) alike; "episodes" with a result, "apartments", "failed" units and "failures".
    - "differences" {name: {column: {difference, low, high, p, p_holm, n, groups}}}: method minus reference over shared
      episodes; p by sign flips of apartments, p_holm corrected for all tests. Ablations are a family of their own, each
      compared with the method that it varies.
    - "strata" {title: {label: {"episodes", "methods", "intervals", "counts"}}}.

    Raises `EagorError` for records of several tasks, or of an unknown one; `FormatError` for one that no task writes.
    """
    records = list(records)
    task = task_of(records)
    checked(records, WALKED if task.walked else WATCHED)
    if any("leg" in record.get("truth", {}) for record in finished(records)):
        checked(records, IN_LEGS)
    columns = task.columns
    good = finished(records)
    cells, samples = _cells(good, columns)
    return {
        "task": task.name,
        "episodes": len({record["episode"]["id"] for record in good}),
        "apartments": len({group_of(record) for record in good}),
        "failed": len(records) - len(good),
        **cells,
        "reference": reference,
        "differences": _differences(samples, columns, reference),
        "strata": {title: _strata(good, columns, name) for name, title in task.strata.items()},
        "failures": failures(records),
    }


def task_of(records: Sequence[Record]) -> Task:
    """The one task that records are of. Raises as `summarise`."""
    checked(records, SIMULATED)
    names = {record.get("task") for record in records} - {None}
    if len(names) != 1:
        found = sorted(map(str, names)) or "none"
        raise EagorError(f"the records are of the tasks {found}; wanted one of {', '.join(known())}")
    return load(str(names.pop()))


def as_text(summary: dict[str, Any]) -> list[str]:
    """The table for a terminal: a line per method, one with the numbers of cases, and what the marks mean."""
    columns = shown_columns(summary)
    if not summary["methods"]:
        return [f"{load(summary['task']).title}: no results; {summary['failed']} failed"]
    rows = [["", *(f"{column.title} {column.unit}".strip() for column in columns)]]
    marks = set()
    for name in summary["methods"]:
        row = [name]
        for column in columns:
            found = mark(summary, name, column)
            marks.add(found)
            figure = shown(summary["methods"][name][column.key], column)
            row.append(f"{figure}{found or ' '}{own_cases(summary, name, column)}")
        rows.append(row)
    counts = [summary["counts"][name] for name in summary["methods"]]
    rows.append(["cases", *(f"{_span([count[column.key] for count in counts])} " for column in columns)])
    head = f"{load(summary['task']).title}: {summary['episodes']} episodes"
    if summary["failed"]:
        head += f"; {summary['failed']} could not be run"
    notes = [text for sign, text in (("-", "- worse"), ("+", "+ better")) if sign in marks]
    other = f"{summary['reference']} (a variant: than what it varies)"
    judged = [summary["judged"]] if summary.get("judged") else []
    tail = [f"{', '.join(notes)} than {other}: p < {SIGNIFICANT}, corrected for the number of tests"] if notes else []
    return [head, *in_columns(rows), *judged, *tail]


def own_cases(summary: dict[str, Any], name: str, column: Column) -> str:
    """How many cases a method has in a column, where methods differ in that; else nothing."""
    counts = {count[column.key] for count in summary["counts"].values()} - {0}
    return f"({summary['counts'][name][column.key]})" if len(counts) > 1 else ""


def mark(summary: dict[str, Any], name: str, column: Column) -> str:
    """Whether a method differs from its reference beyond chance: "-" it is worse, "+" it is better, "" neither."""
    found = summary["differences"].get(name, {}).get(column.key)
    if found is None or column.better is None or found["p_holm"] >= SIGNIFICANT or found["difference"] == 0:
        return ""
    return "-" if (found["difference"] > 0) == (column.better == "low") else "+"


def best(summary: dict[str, Any], column: Column, names: Sequence[str]) -> set[str]:
    """Those of `names` with the best figure of a column, as it is shown; nobody where neither side is better."""
    there = {name: summary["methods"][name][column.key] for name in names}
    figures = {name: round(value, column.digits) for name, value in there.items() if value is not None}
    if column.better is None or not figures:
        return set()
    winner = (min if column.better == "low" else max)(figures.values())
    return {name for name, value in figures.items() if value == winner}


def shown_columns(summary: dict[str, Any]) -> list[Column]:
    """The columns in which some method has a case."""
    rows = summary["methods"].values()
    return [column for column in load(summary["task"]).columns if any(row[column.key] is not None for row in rows)]


def headed(column: Measured) -> str:
    """The head of a column: its title, an arrow to its better side, its unit."""
    arrow = {"low": " ↓", "high": " ↑", None: ""}[column.better]
    return f"{column.title}{arrow}{f', {column.unit}' if column.unit else ''}"


def shown(value: float | None, column: Measured, sign: bool = False) -> str:
    """A figure of a column as text; a dash where there is no case."""
    return number(value, column.digits, sign or column.key == "delta")


def corrected(gaps: dict[tuple[str, ...], Gap | None]) -> dict[tuple[str, ...], dict[str, Gap | None]]:
    """`gaps` with p_holm filled in over all of them; nested by all but the last part of their names."""
    there = [name for name, found in gaps.items() if found is not None]
    values = dict(zip(there, holm([found.p for found in gaps.values() if found is not None]), strict=True))
    nested: dict[tuple[str, ...], dict[str, Gap | None]] = {}
    for name, found in gaps.items():
        nested.setdefault(name[:-1], {})[name[-1]] = None if found is None else replace(found, p_holm=values[name])
    return nested


def _cells(records: Sequence[Record], columns: Sequence[Column]) -> tuple[dict[str, Any], dict[str, dict[str, Sample]]]:
    """Values, intervals and counts by method and column, and the samples they come from."""
    samples = {
        name: {column.key: sample(records, name, column) for column in columns}
        for name in ordered(method_names(records))
    }

    def each(cell: Callable[[Sample, Column], Any], nothing: Any = None) -> dict[str, dict[str, Any]]:
        return {
            name: {c.key: cell(row[c.key], c) if row[c.key].values else nothing for c in columns}
            for name, row in samples.items()
        }

    return {
        "methods": each(lambda found, _: found.mean),
        "intervals": each(lambda found, c: clustered(found, c.scale if c.share else None)),
        "counts": each(lambda found, _: len(found.values), 0),
    }, samples


def _differences(
    samples: dict[str, dict[str, Sample]], columns: Sequence[Column], reference: str
) -> dict[str, dict[str, Any]]:
    """One family of tests for the methods against the reference, one for the ablations against what they vary."""
    tested = [column.key for column in columns if column.better is not None]
    result: dict[str, dict[str, Any]] = {}
    for kind in (is_rival, is_ablation):
        gaps = {
            (name, key): gap(row[key], samples[other][key])
            for name, row in samples.items()
            if kind(name) and (other := compared_with(name, reference)) in samples and other != name
            for key in tested
        }
        for (name,), row in corrected(gaps).items():
            result[name] = {key: found and asdict(found) for key, found in row.items()}
    return result


def _strata(records: Sequence[Record], columns: Sequence[Column], name: str) -> dict[str, Any]:
    """The cells of each stratum."""
    parts: dict[str, list[Record]] = {}
    for record in records:
        value = record["episode"].get("stratum", {}).get(name)
        if value is not None:
            parts.setdefault(_WORDS[value] if isinstance(value, bool) else str(value), []).append(record)
    return {
        label: {"episodes": len({record["episode"]["id"] for record in part}), **_cells(part, columns)[0]}
        for label, part in sorted(parts.items(), reverse="yes" in parts)
    }


def _span(counts: Sequence[int]) -> str:
    low, high = min(counts), max(counts)
    return str(high) if low == high else f"{low}–{high}"


# --- from the steps of a run's episodes -------------------------------------------------------------------------------

BEFORE, AFTER = 4, 14  # steps shown about a turn
ABOUT_SEAM = 6
LEVELS = tuple(round(0.1 * k, 1) for k in range(1, 10))  # masses of the regions in a reliability curve
UNSEEN, IN_SIGHT, HIDDEN = "before it was first seen", "in sight", "hidden again"
PARTS = (UNSEEN, IN_SIGHT, HIDDEN)
SEEN = "after it was first seen"  # in sight or hidden again
BASELINE = 0.1  # of the distance: by so much the camera has to have moved before a distance is asked for

Events = Callable[[Record, str], Sequence[int]]


def errors(record: Record, method: str) -> np.ndarray:
    """Direction error at each step, degrees; NaN where there was nothing to point at."""
    return numbers(record["methods"][method]["trace"]["error_deg"])


def turns(record: Record, method: str) -> list[int]:
    """The steps at which a leg but the first begins."""
    legs = record["truth"]["leg"]
    return [k for k in range(1, len(legs)) if legs[k] != legs[k - 1]]


def crossings(record: Record, method: str) -> list[int]:
    """The steps at which the true bearing crosses the seam; of the method's own way, where each goes its own."""
    if "truth" in record:
        return [int(k) for k in np.flatnonzero(record["truth"]["seam"])]
    azimuth = np.radians(numbers(record["methods"][method]["trace"]["true_azimuth_deg"]))
    return [int(k) for k in np.flatnonzero(seam_crossings(direction(azimuth, 0 * azimuth)))]


def around(
    records: Sequence[Record], method: str, events: Events, before: int, after: int, alone: bool = False
) -> Curve | None:
    """Error of `method` from `before` steps before to `after` steps after the events of each episode; None without any.

    `alone` leaves out steps that belong to the neighbouring events.
    """
    rows, labels = [], []
    for record in played_by(records, method):
        found, where = errors(record, method), events(record, method)
        windows = []
        for index, event in enumerate(where):
            window = np.full(before + after + 1, np.nan)
            first = max(event - before, where[index - 1] if alone and index else 0)
            last = min(event + after, (where[index + 1] if alone and index + 1 < len(where) else len(found)) - 1)
            window[first - event + before : last - event + before + 1] = found[first : last + 1]
            windows.append(window)
        if windows:
            rows.append(_mean(np.array(windows)))
            labels.append(group_of(record))
    return _curve(range(-before, after + 1), rows, labels)


def by_step(records: Sequence[Record], method: str) -> Curve | None:
    """Error of `method` at each step. It ends where fewer than half of the episodes go on."""
    found = [(errors(record, method), group_of(record)) for record in played_by(records, method)]
    longest = max((len(values) for values, _ in found), default=0)
    rows = [np.pad(values, (0, longest - len(values)), constant_values=np.nan) for values, _ in found]
    return _curve(range(longest), rows, [label for _, label in found])


def reliability(records: Sequence[Record], method: str) -> Curve | None:
    """Share of steps, percent, at which the truth lay in the region of each mass (percent); None where none is said."""
    rows, labels = [], []
    for record in played_by(records, method):
        stated = numbers(record["methods"][method]["trace"].get("mass_above") or [])
        stated = stated[np.isfinite(stated)]
        if len(stated):
            rows.append(np.array([100 * float((stated < level).mean()) for level in LEVELS]))
            labels.append(group_of(record))
    return _curve([round(100 * level) for level in LEVELS], rows, labels)


def _mean(rows: np.ndarray) -> np.ndarray:
    """Mean over the rows, without NaN; NaN where there is nothing else."""
    there = np.isfinite(rows)
    count = there.sum(axis=0)
    return np.where(count > 0, np.where(there, rows, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)


def _curve(x: Sequence[float], rows: Sequence[np.ndarray], labels: Sequence[object]) -> Curve | None:
    """The mean of `rows`; it has a value where at least half of them do."""
    if not rows:
        return None
    values = np.array(rows)
    count = np.isfinite(values).sum(axis=0)
    kept = count >= max(1, len(rows) / 2)
    low, high = mean_intervals(values, labels)
    mean = _mean(values)
    last = int(np.flatnonzero(kept)[-1]) + 1 if kept.any() else 0
    if not last:
        return None
    return Curve(
        tuple(x[:last]),
        tuple(float(m) if k else None for m, k in zip(mean[:last], kept, strict=False)),
        tuple(v if k else None for v, k in zip(low[:last], kept, strict=False)),
        tuple(v if k else None for v, k in zip(high[:last], kept, strict=False)),
        tuple(int(c) for c in count[:last]),
    )


@dataclass(frozen=True)
class Part:
    """A mean over the episodes that have such steps, its 95 % interval, their number, and their share of all steps."""

    mean: float
    low: float | None
    high: float | None
    episodes: int
    share: float


def error_in(records: Sequence[Record], method: str, part: str) -> Part | None:
    """Direction error, degrees, over the steps of one part, or of `SEEN`. None where no episode has any."""

    def read(trace: dict, truth: dict) -> tuple[np.ndarray, np.ndarray]:
        found = _parts(truth)
        return numbers(trace["error_deg"]), found != UNSEEN if part == SEEN else found == part

    return _over(records, method, read)


def distance_error(records: Sequence[Record], method: str) -> Part | None:
    """Relative error of the distance, percent, once the camera has moved by `BASELINE` of it since the first sighting.

    None for methods that state no distance.
    """

    def read(trace: dict, truth: dict) -> tuple[np.ndarray, np.ndarray]:
        stated, true = numbers(trace.get("distance_m") or []), numbers(truth.get("range_m") or trace["true_range_m"])
        if not len(stated):
            return np.zeros(0), np.zeros(0, dtype=bool)
        moved = _baselines(np.array(truth["pose"])[:, :3], np.array(truth["visible"], dtype=bool))
        asked = (moved > BASELINE * true) & (true > 0) & np.isfinite(numbers(trace["error_deg"]))
        return 100 * np.abs(stated - true) / np.where(true > 0, true, np.nan), asked

    return _over(records, method, read)


def coverage(records: Sequence[Record], method: str, visible: bool) -> Part | None:
    """Share of steps, percent, with the truth inside the 90 % region, the target in sight or out of it."""

    def read(trace: dict, truth: dict) -> tuple[np.ndarray, np.ndarray]:
        inside = 100 * numbers(trace.get("inside") or [])
        return inside, np.array(truth["visible"], dtype=bool)[: len(inside)] == visible

    return _over(records, method, read)


def _over(
    records: Sequence[Record], method: str, read: Callable[[dict, dict], tuple[np.ndarray, np.ndarray]]
) -> Part | None:
    means, groups, used, steps = [], [], 0, 0
    for record in played_by(records, method):
        trace = record["methods"][method]["trace"]
        values, chosen = read(trace, record.get("truth", trace))
        chosen = chosen & np.isfinite(values)
        steps += int(np.isfinite(numbers(trace["error_deg"])).sum())
        if chosen.any():
            used += int(chosen.sum())
            means.append(float(values[chosen].mean()))
            groups.append(group_of(record))
    if not means:
        return None
    low, high = mean_intervals(np.array(means)[:, None], groups)
    return Part(float(np.mean(means)), low[0], high[0], len(means), used / steps)


def _parts(truth: dict) -> np.ndarray:
    """Which part each step belongs to."""
    seen = np.array(truth["visible"], dtype=bool)
    before = np.cumsum(seen) == 0
    return np.where(before, UNSEEN, np.where(seen, IN_SIGHT, HIDDEN))


def _baselines(positions: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """At each step, the largest distance so far between two places from which the target was in sight, metres."""
    apart = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    apart[~seen], apart[:, ~seen] = 0.0, 0.0
    return np.maximum.accumulate(np.tril(apart).max(axis=1))
