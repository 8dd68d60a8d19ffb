"""From the records of a run to figures with their uncertainty, and to differences between methods, or between runs.

Records of one group (of an apartment, or of a cluster of a data set) share their luck, so whole groups are resampled,
always with the same seed, and whole groups have their sign flipped.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from eagor._values import lazy
from eagor.errors import EagorError, FormatError
from eagor.lab.agents.methods import EVERY, ORACLE
from eagor.lab.envs.places import APARTMENT
from eagor.lab.eval import log
from eagor.lab.tasks.task import Metric, Record, Task, check_records, config_of, finished, group_of, load, sample_of
from eagor.statistics import bootstrap_interval, calibration_error, paired_difference, reliability, share_interval

SEED, RESAMPLES, LEVEL = 20260, 2000, 0.95
BINS = 10  # of stated probabilities
OURS = "eagor"  # our default method
ORDER = (*EVERY, ORACLE)

Summary = dict[str, Any]


class Result(NamedTuple):
    """What one method made of one sample: `answer` is the part of the `record` that is the method's own."""

    record: Record
    answer: Record


@dataclass(frozen=True)
class Run:
    """A run as it was read from its folder: its task, ``run.json`` and its records."""

    task: Task
    settings: Mapping[str, Any]
    records: Sequence[Record]

    @property
    def simulated(self) -> bool:
        """Whether its records have several methods in episodes, and not one agent's answers to published data."""
        return not hasattr(self.task, "agents")

    @property
    def unit(self) -> str:
        """What a group of its samples is called."""
        place = "apartment" if self.settings.get("world", APARTMENT) == APARTMENT else "scene"
        return place if self.simulated else "cluster"

    def results(self, label: str = "") -> dict[str, list[Result]]:
        """By method, in the order of tables; of a run with one agent, under its `label`."""
        good = finished(self.records)
        if not self.simulated:
            return {label or labels_of([self])[0]: [Result(record, record) for record in good]}
        names = ordered(dict.fromkeys(name for record in good for name in record["methods"]))
        return {name: [Result(r, r["methods"][name]) for r in good if name in r["methods"]] for name in names}

    @lazy
    def planned(self) -> int | None:
        """How many records the whole run has; None where that cannot be told, as the data are not there."""
        try:
            return len(self.task.samples(config_of(self.task, self.settings)))
        except (EagorError, OSError, LookupError, TypeError, ValueError):
            return None


def read(folder: Path) -> Run:
    """The run in `folder`.

    Raises `FormatError` if it is none, or for a malformed record, which it names; `EagorError` if it has no records, or
    its task is not known.
    """
    settings = log.description(folder)
    known = isinstance(settings.get("task"), str)
    fields = msgspec.structs.fields(load(settings["task"]).Config) if known else ()
    for name in [field.name for field in fields if field.required] or ["task"]:
        if name not in settings or not known:
            raise FormatError(f"{Path(folder) / log.RUN} does not name its {name}; restore it")
    if not (records := log.read(folder)):
        raise EagorError(f"{folder} has no records yet; run something into it first")
    return made(settings, records)


def made(settings: Mapping[str, Any], records: Sequence[Record]) -> Run:
    """A run of these settings and records. Raises as `read`."""
    task = load(settings["task"])
    if names := {record.get("task") for record in records} - {None, task.name}:
        raise EagorError(f"the records of {task.name} hold some of {', '.join(map(str, names))}; restore the log")
    check_records(task, records)
    return Run(task, settings, records)


def labels_of(runs: Sequence[Run]) -> list[str]:
    """What runs with one agent are called: the agent, and who looked or talked, without addresses and options.

    With a number where two would be the same.
    """
    found: list[str] = []
    for run in runs:
        who = re.sub(r"(@https?://|\?).*", "", run.settings.get("perception") or run.settings.get("model") or "")
        found.append(" · ".join(filter(None, (str(run.settings.get("agent")), who))))
    return [f"{each} ({found[: k + 1].count(each)})" if found.count(each) > 1 else each for k, each in enumerate(found)]


def ordered(names: Iterable[str]) -> list[str]:
    """Names of methods in the order of the tables: plain, the paper's, the further rivals, ours, the oracle, variants.

    Variants by their number: degree=7 before degree=15.
    """

    def place(name: str) -> tuple[int, str, float]:
        known = ORDER.index(name) if name in ORDER else len(ORDER)
        head, _, value = name.rpartition("=")
        try:
            return known, head, float(value)
        except ValueError:
            return known, head or name, 0.0

    return sorted(names, key=place)


def is_variant(name: str) -> bool:
    """Whether the method varies another one: "eagor:degree=7"."""
    return ":" in name and " · " not in name


def is_rival(name: str) -> bool:
    """Whether the method competes: neither a variant nor one that is told the truth."""
    return not is_variant(name) and name != ORACLE


# --- values, means, intervals, differences ----------------------------------------------------------------------------


class Value(NamedTuple):
    """What one sample has of a metric; its group, and its kind: a mean is that of the means of the kinds."""

    value: float
    group: str
    kind: str = ""


Values = dict[str, Value]  # by sample


def values_of(results: Sequence[Result], metric: Metric) -> Values:
    """The values of `metric`, of the samples that have one. Raises `EagorError` for a sample with two results."""
    found: Values = {}
    for record, answer in results:
        if (value := metric.of(answer)) is not None:
            if (name := sample_of(record)) in found:
                raise EagorError(f"{name!r} has two results; give each episode or case an id of its own")
            found[name] = Value(value, str(group_of(record)), metric.over(answer) if metric.over else "")
    return found


def mean(values: Values) -> float:
    """Of the means of the kinds."""
    array, _, kinds = _arrays(values)
    return _mean(array, kinds)


def interval(values: Values, share: float | None = None) -> list[float] | None:
    """The 95 % interval of the mean, by whole groups; None with fewer than two.

    A bootstrap; of values that are 0 or `share`, `eagor.statistics.share_interval`.
    """
    array, groups, kinds = _arrays(values)
    if len(set(groups)) < 2:
        return None
    alone = len(set(kinds)) == 1
    if share is not None and alone and np.isin(array, (0.0, share)).all():
        ends = share_interval(array / share, groups, LEVEL)
        return [share * ends.low, share * ends.high]
    rng = np.random.default_rng(SEED)
    if alone:
        ends = bootstrap_interval(array, rng, LEVEL, groups=groups, resamples=RESAMPLES)
    else:  # groups that are drawn hold other shares of the kinds

        def drawn(at: np.ndarray) -> float:
            return _mean(array[at.astype(int)], kinds[at.astype(int)])

        ends = bootstrap_interval(np.arange(len(array)), rng, LEVEL, drawn, groups, RESAMPLES)
    return [ends.low, ends.high]


def difference(a: Values, b: Values) -> dict[str, Any] | None:
    """Mean of a - b over the samples that both have, with "low", "high", "p" (before any correction), "n", "groups".

    None with fewer than two groups.
    """
    both = {name: value._replace(value=value.value - b[name].value) for name, value in a.items() if name in b}
    array, groups, kinds = _arrays(both)
    if len(set(groups)) < 2:
        return None
    sizes = Counter(kinds)
    # With these weights a plain mean is the mean of the kinds' means.
    weights = np.array([len(both) / (len(sizes) * sizes[kind]) for kind in kinds])
    rng = np.random.default_rng(SEED)
    found = paired_difference(weights * array, 0.0 * array, rng, groups=groups, level=LEVEL)
    ends = [found.interval.low, found.interval.high] if len(sizes) == 1 else interval(both)
    low, high = ends or (None, None)
    return {"difference": found.difference, "low": low, "high": high, "p": found.p, "n": found.n,
            "groups": found.groups}  # fmt: skip


def _arrays(values: Values) -> tuple[np.ndarray, list[str], np.ndarray]:
    """Values, groups and kinds, each ``(n,)``."""
    array, groups, kinds = zip(*values.values(), strict=True) if values else ((), (), ())
    return np.array(array), list(groups), np.array(kinds)


def _mean(array: np.ndarray, kinds: np.ndarray) -> float:
    return float(np.mean([array[kinds == kind].mean() for kind in np.unique(kinds)]))


def holm(p: Sequence[float]) -> list[float]:
    """Holm's correction (Scandinavian Journal of Statistics 6, 1979): valid however the tests depend on each other."""
    order = np.argsort(p, kind="stable")
    steps = np.minimum(1.0, (len(p) - np.arange(len(p))) * np.asarray(p, dtype=float)[order])
    corrected = np.empty(len(p))
    corrected[order] = np.maximum.accumulate(steps)
    return corrected.tolist()


def summarise(runs: Run | Sequence[Run]) -> Summary:
    """The figures of runs of one task, as plain values ready for JSON.

    - "methods" {name: {metric: value}}, "intervals" (95 %, by whole groups) and "counts" alike; "episodes" with a
      result, "groups", "failed" units and "failures".
    - "differences" {name: {metric: {difference, low, high, p, p_holm, n, groups}}}: method minus "reference" over
      shared samples; p by sign flips of groups, p_holm corrected for all tests. Variants are a family of their own,
      each compared with the method that it varies.
    - "strata" {title: {label: {"episodes", "methods", "intervals", "counts"}}};
    - of answers to published data: "answers" {name: {"by_turn", "views", "calibration_error", "sure", "tags", ...}}.
    """
    runs = [runs] if isinstance(runs, Run) else runs
    task = runs[0].task
    results: dict[str, list[Result]] = {}
    for run, label in zip(runs, labels_of(runs), strict=True):
        results |= run.results(label)
    records = [record for run in runs for record in run.records]
    good, failed = finished(records), [record for record in records if record["status"] != "ok"]
    reference = next((name for name in (OURS, *results) if name in results and name.startswith(OURS)), OURS)
    summary = {
        "task": task.name,
        "episodes": len({sample_of(record) for record in good}),
        "groups": len({str(group_of(record)) for record in good}),
        "unit": runs[0].unit,
        "failed": len(failed),
        **_figures(results, task.metrics),
        "reference": reference,
        "differences": _differences(results, task.metrics, reference),
        "strata": {title: _strata(results, task.metrics, key) for key, title in getattr(task, "strata", {}).items()},
        "failures": [{key: record.get(key, "") for key in ("key", "attempt", "error")} for record in failed],
    }
    if not runs[0].simulated:
        summary["answers"] = {name: _answers(task, [each.record for each in rows]) for name, rows in results.items()}
    return summary


def as_json(summary: Summary, run: Run) -> dict[str, Any]:
    """What ``eagor bench run --json`` says. Of a run with one agent, its figures are at the top, too."""
    keys = ("task", "episodes", "groups", "failed", "methods", "intervals", "counts", "failures", "success")
    found = {key: summary[key] for key in keys if key in summary}
    for name, part in summary.get("answers", {}).items():
        found |= {key: run.settings.get(key) for key in ("agent", "perception", "model")}
        found |= summary["methods"][name] | part
    return found


def _figures(results: Mapping[str, Sequence[Result]], metrics: Sequence[Metric]) -> dict[str, Any]:
    """Values, intervals and counts by method and metric."""
    found: dict[str, dict[str, dict[str, Any]]] = {"methods": {}, "intervals": {}, "counts": {}}
    for name, rows in results.items():
        for metric in metrics:
            values, share = values_of(rows, metric), metric.scale if metric.share else None
            figure = (mean(values), interval(values, share)) if values else (None, None)
            for part, value in zip(found.values(), (*figure, len(values)), strict=True):
                part.setdefault(name, {})[metric.key] = value
    return found


def _differences(
    results: Mapping[str, Sequence[Result]], metrics: Sequence[Metric], reference: str
) -> dict[str, dict[str, Any]]:
    """One family of tests for the methods against the reference, one for the variants against what they vary."""
    found: dict[str, dict[str, Any]] = {}
    for family in (is_rival, is_variant):
        tested = []
        for name in filter(family, results):
            other = name.partition(":")[0] if is_variant(name) else reference
            if other in results and other != name:
                pair = results[name], results[other]
                figures = {m.key: difference(*(values_of(rows, m) for rows in pair)) for m in metrics if m.better}
                found[name] = figures
                tested += filter(None, figures.values())
        for each, p in zip(tested, holm([each["p"] for each in tested]), strict=True):
            each["p_holm"] = p
    return found


def _strata(results: Mapping[str, Sequence[Result]], metrics: Sequence[Metric], key: str) -> dict[str, Any]:
    """The figures of each stratum of episodes."""
    parts: dict[str, dict[str, list[Result]]] = {}
    for name, rows in results.items():
        for result in rows:
            value = result.record["episode"].get("stratum", {}).get(key)
            if value is not None:
                label = {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)
                parts.setdefault(label, {}).setdefault(name, []).append(result)
    return {
        label: {
            "episodes": len({sample_of(result.record) for rows in part.values() for result in rows}),
            **_figures(part, metrics),
        }
        for label, part in sorted(parts.items(), reverse="yes" in parts)
    }


def _answers(task: Task, records: Sequence[Record]) -> dict[str, Any]:
    """Of answers to published data: turns, views, statements, tags and causes."""

    def share(
        records: Sequence[Record], read: Callable[[Record], float | None], scale: float | None
    ) -> tuple[Any, Any]:
        """The mean, per cent, and its interval; None without a record."""
        values = values_of([Result(record, record) for record in records], Metric("", "", "", read))
        return (mean(values), interval(values, scale)) if values else (None, None)

    def success(records: Sequence[Record]) -> dict[str, Any]:
        return dict(zip(("success", "interval"), share(records, itemgetter("score"), 100.0), strict=True))

    def causes(records: Sequence[Record]) -> dict[str, int]:
        return dict(Counter(filter(None, map(task.failure, records))).most_common())

    found: dict[str, Any] = {"tags": {}, "causes": causes(records)}
    for tag in sorted({tag for record in records for tag in record.get("tags", ())}):
        part = [record for record in records if tag in record.get("tags", ())]
        figures = {"episodes": len(part), "share": 100 * len(part) / len(records)}
        found["tags"][tag] = {**figures, **success(part), "causes": causes(part)}
    if longest := max((len(record.get("by_turn", ())) for record in records), default=0):
        turns = [
            share(records, lambda r, k=k: dict(enumerate(r.get("by_turn", ()))).get(k), None) for k in range(longest)
        ]
        low, high = zip(*(ends or (None, None) for _, ends in turns), strict=True)
        found["by_turn"] = {"success": [value for value, _ in turns], "low": list(low), "high": list(high)}
    if views := [record for record in records if "views" in record]:
        hits = [record["views"] for record in views if record["score"] == 1]
        found["views"] = float(np.mean([record["views"] for record in views]))
        found["views_to_success"] = float(np.mean(hits)) if hits else None
    if stated := [record for record in records if record.get("stated") is not None]:
        table = reliability([r["stated"] for r in stated], [r["score"] == 1 for r in stated], BINS)
        sure = [record for record in records if record.get("sure")]
        found["calibration_error"], found["sure"] = calibration_error(table), {"episodes": len(sure), **success(sure)}
    return found


def rank(run: Run, method: str) -> list[Result]:
    """The results of `method`, best first by the metrics that the task ranks by; no value is the worst."""
    metrics = [metric for metric in run.task.metrics if metric.key in (getattr(run.task, "ranked_by", ()) or ("mae",))]

    def place(result: Result) -> tuple[float, ...]:
        if not metrics:  # a task without such a figure: the mean error of its steps
            errors = [error for error in result.answer["trace"]["error_deg"] if error is not None]
            return (float(np.mean(errors)),)
        values = [(metric.of(result.answer), metric.better) for metric in metrics]
        return tuple(np.inf if value is None else -value if better == "high" else value for value, better in values)

    return sorted(run.results().get(method, ()), key=place)
