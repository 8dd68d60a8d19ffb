"""From the records of a run to figures with their uncertainty, and to differences between methods, or between runs.

Records of one group (of an apartment, or of a cluster of a data set) share their luck, so whole groups are resampled,
always with the same seed, and whole groups have their sign flipped.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
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
    bootstrap_interval,
    calibration_error,
    mcnemar,
    paired_difference,
    reliability,
    share_interval,
)

SEED, RESAMPLES, LEVEL = 20260, 2000, 0.95
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
        listed = self.settings.get("episodes_file") is not None
        return "scene" if listed or self.settings.get("world", APARTMENT) != APARTMENT else "apartment"

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


@dataclass(frozen=True)
class Values:
    """The values of one metric by sample, and the group of each; `kinds`: of a mean of means, the kind of each."""

    values: dict[str, float]
    groups: dict[str, Any]
    kinds: dict[str, str]

    def only(self, samples: Sequence[str]) -> Values:
        """The part with these samples."""
        return Values(*({name: part[name] for name in samples if part} for part in vars(self).values()))

    @property
    def array(self) -> np.ndarray:
        """All values ``(n,)``."""
        return np.array(list(self.values.values()))

    @property
    def labels(self) -> list[Any]:
        """The group of each."""
        return list(self.groups.values())

    @property
    def mean(self) -> float:
        """Of all values, or of the means of the kinds."""
        return mean_of_means(self.array, self.kinds)(np.arange(len(self.values))) if self.kinds else self.array.mean()


def values_of(results: Sequence[Result], metric: Metric) -> Values:
    """The values of `metric`, of the samples that have one. Raises `EagorError` for a sample with two results."""
    found = Values({}, {}, {})
    for result in results:
        if (value := metric.of(result.answer)) is None:
            continue
        name = sample_of(result.record)
        if name in found.values:
            raise EagorError(f"{name!r} has two results; give each episode or case an id of its own")
        found.values[name] = value
        found.groups[name] = group_of(result.record)
        if metric.over:
            found.kinds[name] = metric.over(result.answer)
    return found


def interval_of(found: Values, share: float | None = None) -> list[float] | None:
    """The 95 % interval of the mean, by whole groups; None with fewer than two.

    A bootstrap; of values that are 0 or `share`, `eagor.statistics.share_interval`.
    """
    if len(set(found.labels)) < 2:
        return None
    if share is not None and not found.kinds and np.isin(found.array, (0.0, share)).all():
        ends = share_interval(found.array / share, found.labels, LEVEL)
        return [share * ends.low, share * ends.high]
    if found.kinds:
        ends = _ends(mean_of_means(found.array, found.kinds), found.labels)
        return [ends.low, ends.high]
    low, high = mean_intervals(found.array[:, None], found.labels)
    return None if low[0] is None or high[0] is None else [low[0], high[0]]


def _ends(statistic: Callable[[np.ndarray], float], labels: Sequence[Any]) -> Interval:
    """The bootstrap's interval of a statistic of the indices of the samples."""
    return bootstrap_interval(np.arange(len(labels)), np.random.default_rng(SEED), LEVEL, statistic, labels, RESAMPLES)


def mean_of_means(values: np.ndarray, kinds: Mapping[str, str]) -> Callable[[np.ndarray], float]:
    """What takes indices into `values` ``(n,)`` and returns the mean over their `kinds` of the mean over each kind."""
    place = np.unique(list(kinds.values()), return_inverse=True)[1]

    def mean(indices: np.ndarray) -> float:
        rows = indices.astype(np.intp)
        sums, counts = np.bincount(place[rows], values[rows]), np.bincount(place[rows])
        return float((sums[counts > 0] / counts[counts > 0]).mean())

    return mean


def mean_intervals(values: np.ndarray, labels: Sequence[Any]) -> tuple[list[float | None], list[float | None]]:
    """95 % intervals of the means of the columns of `values` ``(n, k)``, NaN where there is no case.

    `eagor.statistics.bootstrap_interval` with groups, for many columns at once. None with cases of fewer than two
    groups.
    """
    names, member = np.unique([str(label) for label in labels], return_inverse=True)
    there = np.isfinite(values)
    sums, counts = np.zeros((2, len(names), values.shape[1]))
    np.add.at(sums, member, np.where(there, values, 0.0))
    np.add.at(counts, member, there)
    if len(names) < 2:
        return [None] * values.shape[1], [None] * values.shape[1]
    first = list(dict.fromkeys(member.tolist()))  # groups in the order of their first case, as the bootstrap has them
    drawn = np.random.default_rng(SEED).integers(len(names), size=(RESAMPLES, len(names)))
    times = np.stack([(drawn == index).sum(axis=1) for index in range(len(names))], axis=1).astype(float)
    total = times @ counts[first]
    means = np.where(total > 0, (times @ sums[first]) / np.maximum(total, 1.0), np.nan)
    enough = np.count_nonzero(counts, axis=0) >= 2
    ends = np.nanquantile(np.where(enough, means, 0.0), [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
    low, high = ([float(v) if there else None for v, there in zip(row, enough, strict=True)] for row in ends)
    return low, high


def difference(a: Values, b: Values) -> PairedDifference | None:
    """Mean of a - b over the samples that both have, p before any correction; None with fewer than two groups."""
    shared = [name for name in a.values if name in b.values]
    a, b = a.only(shared), b.only(shared)
    if len(set(a.labels)) < 2:
        return None
    weights = np.ones(len(shared))
    if a.kinds:  # with these, a plain mean is the mean of the kinds' means
        _, place, counts = np.unique(list(a.kinds.values()), return_inverse=True, return_counts=True)
        weights = len(shared) / (len(counts) * counts[place])
    rng = np.random.default_rng(SEED)
    found = paired_difference(weights * a.array, weights * b.array, rng, groups=a.labels, level=LEVEL)
    if not a.kinds:
        return found
    # Groups that are drawn hold other shares of the kinds.
    return replace(found, interval=_ends(mean_of_means(a.array - b.array, a.kinds), a.labels))


def lowest_p(groups: int, tests: int = 1) -> float:
    """The p of `difference` where all `groups` agree, times the number of `tests`, as `holm` has it."""
    return tests * 2.0 ** (1 - groups)


def holm(p: Sequence[float]) -> list[float]:
    """p-values corrected for being many, so that all rejections together are false with at most the stated chance.

    Holm, A simple sequentially rejective multiple test procedure, Scandinavian Journal of Statistics 6, 1979.
    """
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
    - of answers to published data: "answers" {name: {"by_turn", "views", "reliability", "sure", "tags", ...}}.
    """
    runs = [runs] if isinstance(runs, Run) else runs
    task = runs[0].task
    results: dict[str, list[Result]] = {}
    for run, label in zip(runs, labels_of(runs), strict=True):
        results |= run.results(label)
    records = [record for run in runs for record in run.records]
    good = finished(records)
    found = {name: {metric.key: values_of(rows, metric) for metric in task.metrics} for name, rows in results.items()}
    reference = next((name for name in (OURS, *found) if name in found and name.startswith(OURS)), OURS)
    strata = getattr(task, "strata", {})
    summary = {
        "task": task.name,
        "episodes": len({sample_of(record) for record in good}),
        "groups": len({str(group_of(record)) for record in good}),
        "unit": runs[0].unit,
        "failed": len(records) - len(good),
        **_cells(found, task.metrics),
        "reference": reference,
        "differences": _differences(found, task.metrics, reference),
        "strata": {title: _strata(results, task.metrics, key) for key, title in strata.items()},
        "failures": [
            {"key": record["key"], "attempt": record["attempt"], "error": record.get("error", "")}
            for record in records
            if record["status"] != "ok"
        ],
    }
    if not runs[0].simulated:
        summary["answers"] = {
            name: _answers(task, [result.record for result in rows]) for name, rows in results.items()
        }
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


def _cells(found: Mapping[str, Mapping[str, Values]], metrics: Sequence[Metric]) -> dict[str, Any]:
    """Values, intervals and counts by method and metric."""
    cells: dict[str, dict[str, dict[str, Any]]] = {"methods": {}, "intervals": {}, "counts": {}}
    for name, row in found.items():
        for part in cells.values():
            part[name] = {}
        for metric in metrics:
            key, values = metric.key, row[metric.key]
            there = bool(values.values)
            cells["methods"][name][key] = float(values.mean) if there else None
            cells["intervals"][name][key] = (
                interval_of(values, metric.scale if metric.share else None) if there else None
            )
            cells["counts"][name][key] = len(values.values)
    return cells


def _differences(
    found: Mapping[str, Mapping[str, Values]], metrics: Sequence[Metric], reference: str
) -> dict[str, dict[str, Any]]:
    """One family of tests for the methods against the reference, one for the variants against what they vary."""
    tested = [metric.key for metric in metrics if metric.better is not None]
    result: dict[str, dict[str, Any]] = {}
    for family in (is_rival, is_variant):
        pairs = {
            (name, key): difference(row[key], found[other][key])
            for name, row in found.items()
            if family(name) and (other := compared_with(name, reference)) in found and other != name
            for key in tested
        }
        there = {pair: _plain(each) for pair, each in pairs.items() if each is not None}
        for each, p in zip(there.values(), holm([each["p"] for each in there.values()]), strict=True):
            each["p_holm"] = p
        for name, key in pairs:
            result.setdefault(name, {})[key] = there.get((name, key))
    return result


def _plain(found: PairedDifference) -> dict[str, Any]:
    ends = found.interval
    return {"difference": found.difference, "low": ends.low, "high": ends.high, "p": found.p, "n": found.n,
            "groups": found.groups}  # fmt: skip


def _strata(results: Mapping[str, Sequence[Result]], metrics: Sequence[Metric], key: str) -> dict[str, Any]:
    """The cells of each stratum of episodes."""
    words = {True: "yes", False: "no"}
    parts: dict[str, dict[str, list[Result]]] = {}
    for name, rows in results.items():
        for result in rows:
            value = result.record["episode"].get("stratum", {}).get(key)
            if value is not None:
                label = words[value] if isinstance(value, bool) else str(value)
                parts.setdefault(label, {}).setdefault(name, []).append(result)
    return {
        label: {
            "episodes": len({sample_of(result.record) for rows in part.values() for result in rows}),
            **_cells({n: {m.key: values_of(rows, m) for m in metrics} for n, rows in part.items()}, metrics),
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
        low, high = mean_intervals(values, [group_of(record) for record in rows])
        found["by_turn"] = {"success": np.nanmean(values, axis=0).tolist(), "low": low, "high": high}
    if views := [record for record in records if "views" in record]:
        hits = [record["views"] for record in views if record["score"] == 1]
        found["views"] = float(np.mean([record["views"] for record in views]))
        found["views_to_success"] = float(np.mean(hits)) if hits else None
    stated = [(r["stated"], r["score"] == 1) for r in records if r.get("stated") is not None]
    if stated:
        # What would have been submitted at every turn says more about the statements than the last ones alone.
        steps = [
            (step["would"]["p"], bool(step["would"].get(str(record.get("scoring", "official")))))
            for record in records
            for step in record.get("steps", ())
            if (step.get("would") or {}).get("p") is not None
        ]
        table, every = (
            reliability([p for p, _ in rows], [right for _, right in rows], BINS) if rows else ()
            for rows in (stated, steps)
        )
        found["reliability"], found["reliability_by_step"] = (
            [[row.lower, row.upper, row.n, row.stated, row.frequency] for row in rows] for rows in (table, every)
        )
        found["calibration_error"] = calibration_error(table)
        sure = [record for record in records if record.get("sure")]
        found["sure"] = {"episodes": len(sure), **_success(sure)}
    return found


def _success(records: Sequence[Record]) -> dict[str, Any]:
    """The share of successes, per cent, with its interval; None without a record."""
    if not records:
        return {"success": None, "interval": None}
    score = Metric("score", "", "", lambda record: record["score"], share=True)
    found = values_of([Result(record, record) for record in records], score)
    return {"success": float(found.mean), "interval": interval_of(found, 100.0)}


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

    With an interval that resamples whole groups, p by sign flips of groups, and McNemar's exact test where every value
    is an outcome. `methods` of simulated tasks: of both runs, or of a and of b; by default ours. Raises `EagorError` if
    the runs are of different tasks, data or worlds, or share no sample.
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
    keys = dict.fromkeys([*a.settings, *b.settings])
    return {
        "task": a.task.name,
        **({"methods": list(names)} if a.simulated else {}),
        "cases": len(shared),
        "only_in_a": len(left.keys() - right.keys()),
        "only_in_b": len(right.keys() - left.keys()),
        "settings": {
            key: [a.settings.get(key), b.settings.get(key)]
            for key in keys
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
    x, y = values_of(left, metric), values_of(right, metric)
    both = [name for name in x.values if name in y.values]
    if not both:
        return None
    x, y = x.only(both), y.only(both)
    found: dict[str, Any] = {"title": metric.title, "n": len(both), "a": float(x.mean), "b": float(y.mean)}
    found["difference"] = found["a"] - found["b"]
    if (paired := difference(x, y)) is not None:
        found |= {key: value for key, value in _plain(paired).items() if key not in found}
    outcomes = np.array([x.array, y.array]) / metric.scale
    if metric.share and np.isin(outcomes, (0.0, 1.0)).all():
        found["mcnemar"] = asdict(mcnemar(*outcomes))
    return found


def rank(run: Run, method: str) -> list[Result]:
    """The results of `method`, best first by the metrics that the task ranks by; no value is the worst."""
    keys = getattr(run.task, "ranked_by", ()) or ("mae",)
    metrics = [metric for metric in run.task.metrics if metric.key in keys]

    def place(result: Result) -> tuple[float, ...]:
        if not metrics:  # a task without such a figure: the mean error of its steps
            errors = [error for error in result.answer["trace"]["error_deg"] if error is not None]
            return (float(np.mean(errors)),)
        values = [(metric.of(result.answer), metric.better) for metric in metrics]
        return tuple(np.inf if value is None else -value if better == "high" else value for value, better in values)

    return sorted(run.results().get(method, ()), key=place)
