"""Tables of simulated tasks; the order of their methods, and what the papers printed (``published.toml``)."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from eagor.errors import EagorError
from eagor.evaluation.page import in_columns, number
from eagor.evaluation.samples import (
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
    method_names,
    sample,
    wilson,
)
from eagor.tasks.methods import EVERY, ORACLE
from eagor.tasks.task import Column, Task, known, load

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

    - "methods" {name: {column: value}}, "counts" and "intervals" (95 %: Wilson's for shares of success, else a
      bootstrap of apartments) alike; "episodes" with a result, "apartments", "failed" units and "failures".
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
            row.append(f"{shown(summary['methods'][name][column.key], column)}{found or ' '}")
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
        "intervals": each(lambda found, c: wilson(found.values.values(), c.scale) if c.share else clustered(found)),
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
