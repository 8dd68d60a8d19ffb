"""From the records of a run to figures with their uncertainty, and to differences between methods, or between runs.

Records of one group (of an apartment, or of a cluster of a data set) share their luck, so whole groups are resampled,
always with the same seed, and whole groups have their sign flipped.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from eagor._values import lazy
from eagor.errors import EagorError, FormatError
from eagor.lab.agents.methods import EVERY, ORACLE
from eagor.lab.envs.places import APARTMENT
from eagor.lab.eval import log
from eagor.lab.tasks.task import Metric, Record, Task, check_records, config_of, finished, group_of, load, sample_of
from eagor.statistics import (
    Interval,
    PairedDifference,
    calibration_error,
    paired_difference,
    reliability,
    share_interval,
)

SEED, RESAMPLES, LEVEL = 20260, 2000, 0.95
ENDS = (1 - LEVEL) / 2, (1 + LEVEL) / 2
FEW = 10  # groups, below which intervals that resample them are too narrow to be trusted
SIGNIFICANT = 0.05
BINS = 10  # of stated probabilities
OURS, PAPERS = "eagor", "eagor_paper"  # our default, and the method as published
RIVALS = ("centroid", "cent_circ", "grid")  # what the paper compares itself with
ORDER = (*EVERY, ORACLE)
SAME = "scene_hash", "query", "targets", "stratum"  # of an episode: whether two runs have played the same one

Summary = dict[str, Any]


@dataclass(frozen=True)
class Result:
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
        if not self.simulated:
            return "cluster"
        return "scene" if self.settings.get("world", APARTMENT) != APARTMENT else "apartment"

    def results(self, label: str = "") -> dict[str, list[Result]]:
        """By method, in the order of tables; of a run with one agent, under its `label`."""
        good = finished(self.records)
        if not self.simulated:
            return {label or label_of(self.settings): [Result(record, record) for record in good]}
        found: dict[str, list[Result]] = {}
        for record in good:
            for name, answer in record["methods"].items():
                found.setdefault(name, []).append(Result(record, answer))
        return {name: found[name] for name in ordered(found)}

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
    if not isinstance(settings.get("task"), str):
        raise FormatError(f"{Path(folder) / log.RUN} does not name its task; restore it")
    for field in msgspec.structs.fields(load(settings["task"]).Config):
        if field.required and field.name not in settings:
            raise FormatError(f"{Path(folder) / log.RUN} does not name its {field.name}; restore it")
    if not (records := log.read(folder)):
        raise EagorError(f"{folder} has no records yet; run something into it first")
    return made(settings, records)


def made(settings: Mapping[str, Any], records: Sequence[Record]) -> Run:
    """A run of these settings and records. Raises as `read`."""
    task = load(settings["task"])
    names = {record.get("task") for record in records} - {None, task.name}
    if names:
        raise EagorError(f"the records of {task.name} hold some of {', '.join(map(str, names))}; restore the log")
    check_records(task, records)
    return Run(task, settings, records)


# --- names of methods and runs ----------------------------------------------------------------------------------------


def label_of(settings: Mapping[str, Any]) -> str:
    """What a run with one agent is called: the agent, and who looked or talked, without addresses and options."""
    who = re.sub(r"(@https?://|\?).*", "", settings.get("perception") or settings.get("model") or "")
    return " · ".join(filter(None, (str(settings.get("agent")), who)))


def labels_of(runs: Sequence[Run]) -> list[str]:
    """`label_of` each, with a number where two would be the same."""
    found = [label_of(run.settings) for run in runs]
    return [
        f"{label} ({found[: index + 1].count(label)})" if found.count(label) > 1 else label
        for index, label in enumerate(found)
    ]


def ordered(names: Sequence[str] | Mapping[str, Any]) -> list[str]:
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


def compared_with(name: str, reference: str) -> str:
    """What a method is measured against: a variant against the method that it varies, all others against one."""
    return name.partition(":")[0] if is_variant(name) else reference


# --- values, means, intervals, differences ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Values:
    """The values ``(n,)`` of one metric, and the sample, the group and the kind of each.

    The mean is that of the means of the kinds, which are all the same where a metric has none.
    """

    samples: list[str]
    array: np.ndarray
    groups: list[Any]
    kinds: list[str]

    def only(self, samples: Sequence[str]) -> Values:
        """The part with these samples, in their order."""
        places = {name: index for index, name in enumerate(self.samples)}
        at = [places[name] for name in samples]
        groups, kinds = ([each[index] for index in at] for each in (self.groups, self.kinds))
        return Values(list(samples), self.array[at], groups, kinds)

    @property
    def columns(self) -> np.ndarray:
        """The values ``(n, kinds)``, each in the column of its kind, and NaN beside it."""
        _, kind = np.unique(self.kinds, return_inverse=True)
        found = np.full((len(kind), int(kind.max(initial=0)) + 1), np.nan)
        found[np.arange(len(kind)), kind] = self.array
        return found

    @property
    def mean(self) -> float:
        """Of the means of the kinds."""
        return float(np.nanmean(self.columns, axis=0).mean())

    def interval(self, share: float | None = None) -> list[float] | None:
        """The 95 % interval of the mean, by whole groups; None with fewer than two.

        A bootstrap; of values that are 0 or `share`, `eagor.statistics.share_interval`.
        """
        if len(set(self.groups)) < 2:
            return None
        if share is not None and len(set(self.kinds)) == 1 and np.isin(self.array, (0.0, share)).all():
            ends = share_interval(self.array / share, self.groups, LEVEL)
            return [share * ends.low, share * ends.high]
        return np.quantile(np.nanmean(resampled_means(self.columns, self.groups), axis=1), ENDS).tolist()


def values_of(results: Sequence[Result], metric: Metric) -> Values:
    """The values of `metric`, of the samples that have one. Raises `EagorError` for a sample with two results."""
    rows = [(result, value) for result in results if (value := metric.of(result.answer)) is not None]
    samples = [sample_of(result.record) for result, _ in rows]
    if twice := [name for name, count in Counter(samples).items() if count > 1]:
        raise EagorError(f"{twice[0]!r} has two results; give each episode or case an id of its own")
    kinds = [metric.over(result.answer) if metric.over else "" for result, _ in rows]
    return Values(samples, np.array([v for _, v in rows]), [group_of(result.record) for result, _ in rows], kinds)


def resampled_means(columns: np.ndarray, groups: Sequence[Any]) -> np.ndarray:
    """The means of `columns` ``(n, k)``, NaN where there is no case, in resamples of whole groups ``(RESAMPLES, k)``.

    NaN where a resample has no case. As in `eagor.statistics.bootstrap_interval`, for many columns at once.
    """
    member = list(map(list(dict.fromkeys(map(str, groups))).index, map(str, groups)))
    sums, counts = np.zeros((2, max(member) + 1, columns.shape[1]))
    np.add.at(sums, member, np.nan_to_num(columns))
    np.add.at(counts, member, np.isfinite(columns))
    drawn = np.random.default_rng(SEED).integers(len(sums), size=(RESAMPLES, len(sums)))
    times = np.apply_along_axis(np.bincount, 1, drawn, minlength=len(sums)).astype(float)
    with np.errstate(invalid="ignore"):
        return (times @ sums) / (times @ counts)


def mean_intervals(columns: np.ndarray, groups: Sequence[Any]) -> np.ndarray:
    """95 % intervals ``(2, k)`` of the means of `columns` ``(n, k)``; NaN with cases of fewer than two groups."""
    found = np.full((2, columns.shape[1]), np.nan)
    names = np.array(list(map(str, groups)))
    enough = [len(set(names[there])) > 1 for there in np.isfinite(columns).T]
    if any(enough):
        found[:, enough] = np.nanquantile(resampled_means(columns, groups)[:, enough], ENDS, axis=0)
    return found


def shared(a: Values, b: Values) -> tuple[Values, Values]:
    """Both, over the samples that both have."""
    there = set(b.samples)
    both = [name for name in a.samples if name in there]
    return a.only(both), b.only(both)


def difference(a: Values, b: Values) -> PairedDifference | None:
    """Mean of a - b over the samples that both have, p before any correction; None with fewer than two groups."""
    a, b = shared(a, b)
    if len(set(a.groups)) < 2:
        return None
    # With these weights a plain mean is the mean of the kinds' means.
    sizes = Counter(a.kinds)
    weights = np.array([len(a.samples) / (len(sizes) * sizes[kind]) for kind in a.kinds])
    rng = np.random.default_rng(SEED)
    found = paired_difference(weights * a.array, weights * b.array, rng, groups=a.groups, level=LEVEL)
    if len(sizes) == 1:
        return found
    # Groups that are drawn hold other shares of the kinds.
    ends = replace(a, array=a.array - b.array).interval()
    return found if ends is None else replace(found, interval=Interval(ends[0], ends[1], LEVEL))


def lowest_p(groups: int, tests: int = 1) -> float:
    """The p of `difference` where all `groups` agree, times the number of `tests`, as `holm` has it."""
    return tests * 2.0 ** (1 - groups)


def holm(p: Sequence[float]) -> list[float]:
    """Holm's correction (Scandinavian Journal of Statistics 6, 1979): valid however the tests depend on each other."""
    order = np.argsort(p, kind="stable")
    steps = np.minimum(1.0, (len(p) - np.arange(len(p))) * np.asarray(p, dtype=float)[order])
    corrected = np.empty(len(p))
    corrected[order] = np.maximum.accumulate(steps)
    return corrected.tolist()


def small_cluster_warning(count: int, unit: str) -> list[str]:
    """What so few groups of this kind (apartment, cluster) cannot tell; nothing where there are enough, or none."""
    if count == 1:
        return [f"Only one {unit}: nothing can be said about how far the figures carry over to others."]
    return [f"Only {count} {unit}s: intervals that resample so few are too narrow."] if 0 < count < FEW else []


# --- the summary of one run, or of several ----------------------------------------------------------------------------


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
    good = finished(records)
    found = _tabled(results, task.metrics)
    reference = next((name for name in (OURS, *found) if name in found and name.startswith(OURS)), OURS)
    summary = {
        "task": task.name,
        "episodes": len({sample_of(record) for record in good}),
        "groups": len({str(group_of(record)) for record in good}),
        "unit": runs[0].unit,
        "failed": len(records) - len(good),
        **_cells(found, task.metrics),
        "reference": reference,
        "differences": _differences(found, task.metrics, reference),
        "strata": {title: _strata(results, task.metrics, key) for key, title in getattr(task, "strata", {}).items()},
        "failures": [
            {"key": record["key"], "attempt": record["attempt"], "error": record.get("error", "")}
            for record in records
            if record["status"] != "ok"
        ],
    }
    if not runs[0].simulated:
        summary["answers"] = {name: _answers(task, [each.record for each in rows]) for name, rows in results.items()}
    return summary


def as_json(summary: Summary, run: Run) -> dict[str, Any]:
    """What ``eagor bench run --json`` says. Of a run with one agent, its figures are at the top, too."""
    keys = ("task", "episodes", "groups", "failed", "methods", "intervals", "counts", "failures", "success")
    found = {key: summary[key] for key in keys if key in summary}
    if not run.simulated:
        for name in summary["methods"]:
            found |= {key: run.settings.get(key) for key in ("agent", "perception", "model")}
            found |= summary["methods"][name] | summary["answers"][name]
    return found


Tabled = Mapping[str, Mapping[str, Values]]  # by method and metric


def _tabled(results: Mapping[str, Sequence[Result]], metrics: Sequence[Metric]) -> Tabled:
    return {name: {metric.key: values_of(rows, metric) for metric in metrics} for name, rows in results.items()}


def _cells(found: Tabled, metrics: Sequence[Metric]) -> dict[str, Any]:
    """Values, intervals and counts by method and metric."""
    cells: dict[str, dict[str, dict[str, Any]]] = {"methods": {}, "intervals": {}, "counts": {}}
    for name, row in found.items():
        shares = {metric.key: metric.scale if metric.share else None for metric in metrics}
        known = {key: values for key, values in row.items() if values.samples}
        cells["methods"][name] = {key: known[key].mean if key in known else None for key in row}
        cells["intervals"][name] = {key: known[key].interval(shares[key]) if key in known else None for key in row}
        cells["counts"][name] = {key: len(values.samples) for key, values in row.items()}
    return cells


def _differences(found: Tabled, metrics: Sequence[Metric], reference: str) -> dict[str, dict[str, Any]]:
    """One family of tests for the methods against the reference, one for the variants against what they vary."""
    result: dict[str, dict[str, Any]] = {}
    for family in (is_rival, is_variant):
        for name in filter(family, found):
            if (other := compared_with(name, reference)) in found and other != name:
                pairs = {m.key: difference(found[name][m.key], found[other][m.key]) for m in metrics if m.better}
                result[name] = {key: None if each is None else _plain(each) for key, each in pairs.items()}
        tested = [each for name in filter(family, result) for each in result[name].values() if each]
        for each, p in zip(tested, holm([each["p"] for each in tested]), strict=True):
            each["p_holm"] = p
    return result


def _plain(found: PairedDifference) -> dict[str, Any]:
    ends = found.interval
    return {"difference": found.difference, "low": ends.low, "high": ends.high, "p": found.p, "n": found.n,
            "groups": found.groups}  # fmt: skip


def _strata(results: Mapping[str, Sequence[Result]], metrics: Sequence[Metric], key: str) -> dict[str, Any]:
    """The cells of each stratum of episodes."""
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
            **_cells(_tabled(part, metrics), metrics),
        }
        for label, part in sorted(parts.items(), reverse="yes" in parts)
    }


# --- answers to published data: turns, views, statements, tags and causes ---------------------------------------------


def _answers(task: Task, records: Sequence[Record]) -> dict[str, Any]:
    found: dict[str, Any] = {"tags": _tags(task, records), "causes": _causes(task, records)}
    if rows := [record for record in records if record.get("by_turn")]:
        longest = max(len(record["by_turn"]) for record in rows)
        # Runs with fewer turns have nothing to say about later ones.
        turns = [[*map(float, r["by_turn"]), *([np.nan] * (longest - len(r["by_turn"])))] for r in rows]
        values = 100 * np.array(turns)
        ends = mean_intervals(values, [group_of(record) for record in rows])
        low, high = ([None if np.isnan(end) else end for end in side] for side in ends.tolist())
        found["by_turn"] = {"success": np.nanmean(values, axis=0).tolist(), "low": low, "high": high}
    if views := [record for record in records if "views" in record]:
        hits = [record["views"] for record in views if record["score"] == 1]
        found["views"] = float(np.mean([record["views"] for record in views]))
        found["views_to_success"] = float(np.mean(hits)) if hits else None
    if stated := [record for record in records if record.get("stated") is not None]:
        table = reliability([r["stated"] for r in stated], [r["score"] == 1 for r in stated], BINS)
        sure = [record for record in records if record.get("sure")]
        found["calibration_error"], found["sure"] = calibration_error(table), {"episodes": len(sure), **_success(sure)}
    return found


def _success(records: Sequence[Record]) -> dict[str, Any]:
    """The share of successes, per cent, with its interval; None without a record."""
    if not records:
        return {"success": None, "interval": None}
    score = Metric("score", "", "", lambda record: record["score"], share=True)
    found = values_of([Result(record, record) for record in records], score)
    return {"success": found.mean, "interval": found.interval(100.0)}


def _tags(task: Task, records: Sequence[Record]) -> dict[str, Any]:
    """By tag: how many records have it, their share, their success and its interval, their causes."""
    found: dict[str, Any] = {}
    for tag in sorted({tag for record in records for tag in record.get("tags", ())}):
        part = [record for record in records if tag in record.get("tags", ())]
        share = 100 * len(part) / len(records)
        found[tag] = {"episodes": len(part), "share": share, **_success(part), "causes": _causes(task, part)}
    return found


def _causes(task: Task, records: Sequence[Record]) -> dict[str, int]:
    return dict(Counter(filter(None, map(task.failure, records))).most_common())


# --- two runs, or two methods of one run, on the samples that both have -----------------------------------------------


def compare(a: Run, b: Run, methods: Sequence[str] = ()) -> dict[str, Any]:
    """Metric by metric, a minus b, over the samples that both have a result of, ready for JSON.

    With an interval that resamples whole groups, and p by sign flips of groups. `methods` of simulated tasks: of both
    runs, or of a and of b; by default ours. Raises `EagorError` if the runs are of different tasks, data or worlds, or
    share no sample.
    """
    for key in ("task", "data", "world"):
        if (x := a.settings.get(key)) != (y := b.settings.get(key)):
            raise EagorError(f"the runs differ in {key}: {x} and {y}; compare like with like")
    names = _methods(a, b, methods)
    left, right = (
        {sample_of(result.record): result for result in run.results().get(name, ())}
        for run, name in zip((a, b), names, strict=True)
    )
    shared = sorted(left.keys() & right.keys())
    if not shared:
        raise EagorError("the runs share no sample that both have a result of; run the same part of the data with both")
    for name in shared if a.simulated else ():
        for key in SAME:
            x, y = (side[name].record["episode"].get(key) for side in (left, right))
            if x != y:
                raise EagorError(f"{name} is another episode in each run: its {key} is {x} and {y}")
    pairs = [[side[name] for name in shared] for side in (left, right)]
    figures = {metric.key: _compared(metric, *pairs) for metric in a.task.metrics}
    return {
        "task": a.task.name,
        **({"methods": list(names)} if a.simulated else {}),
        "cases": len(shared),
        "only_in_a": len(left.keys() - right.keys()),
        "only_in_b": len(right.keys() - left.keys()),
        "settings": {
            key: [a.settings.get(key), b.settings.get(key)]
            for key in dict.fromkeys([*a.settings, *b.settings])
            if key != "samples" and a.settings.get(key) != b.settings.get(key)
        },
        "figures": {key: figure for key, figure in figures.items() if figure is not None},
    }


def _methods(a: Run, b: Run, names: Sequence[str]) -> tuple[str, str]:
    """Which method of a is compared with which of b."""
    there = [list(run.results()) for run in (a, b)]
    if not a.simulated:
        if names:
            raise EagorError(f"a run of {a.task.name} has one agent; leave out the methods {', '.join(names)}")
        return there[0][0], there[1][0]
    if len(names) > 2:
        raise EagorError(f"the methods {', '.join(names)}; wanted one, or two to be compared with each other")
    both = [name for name in there[0] if name in there[1]]
    if not names and OURS not in both and len(both) != 1:
        raise EagorError(f"the runs have no {OURS} in common; name one or two of their methods with --methods")
    first, second = (*names, *names)[:2] if names else (OURS if OURS in both else both[0],) * 2
    for label, name, known in (("a", first, there[0]), ("b", second, there[1])):
        if name not in known:
            raise EagorError(f"run {label} has no method {name!r}; it has {', '.join(known)}")
    return first, second


def _compared(metric: Metric, left: Sequence[Result], right: Sequence[Result]) -> dict[str, Any] | None:
    """One metric, sample by sample; None without a sample that both have."""
    x, y = shared(values_of(left, metric), values_of(right, metric))
    if not x.samples:
        return None
    found: dict[str, Any] = {"title": metric.title, "n": len(x.samples), "a": x.mean, "b": y.mean}
    found["difference"] = x.mean - y.mean
    if (paired := difference(x, y)) is not None:
        found |= {key: value for key, value in _plain(paired).items() if key not in found}
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
