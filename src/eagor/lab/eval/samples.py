"""From records to values by case, and from those to means and differences with their uncertainty.

Cases of one group share luck (the episodes of one apartment its rooms and light; those of a benchmark's cluster its
scene or target), so whole groups are resampled, always with the same seed.

Before a record is counted, its shape is judged: one that does not fit is named, and nothing is made of the rest. A
shape is a `Kind`; a list of one shape, for lists of such; or a dict of shapes by name, where a name that ends in "?"
may be missing, and "*" is for all others. What a shape does not mention may be anything.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor._checks import shown, whole, within
from eagor.errors import EagorError, FormatError
from eagor.lab.tasks.benchmark import Figure
from eagor.lab.tasks.task import Column
from eagor.statistics import bootstrap_interval, paired_difference, share_interval, wilson_interval

SEED = 20260
RESAMPLES = 2000
LEVEL = 0.95
FEW = 10  # groups (apartments, clusters), below which intervals that resample them are too narrow to be trusted

Record = Mapping[str, Any]
Measured = Column | Figure  # a column of the table of a simulated task, or of a benchmark


def few_groups(count: int, unit: str) -> list[str]:
    """What so few groups of this kind (apartment, cluster) cannot tell; nothing where there are enough, or none."""
    if count == 1:
        return [f"Only one {unit}: nothing can be said about how far the figures carry over to others."]
    return [f"Only {count} {unit}s: intervals that resample so few are too narrow."] if 0 < count < FEW else []


@dataclass(frozen=True)
class Gap:
    """A mean difference over `n` shared episodes with its interval, and p before and after Holm's correction."""

    difference: float
    low: float
    high: float
    p: float
    n: int
    groups: int
    p_holm: float | None = None


@dataclass(frozen=True)
class Sample:
    """The values of one column by case, and which group each case shares its luck with.

    `kinds`: of a figure that is a mean of means, the kind of each case; else empty.
    """

    values: dict[str, float]
    groups: dict[str, Any]
    kinds: dict[str, str]

    def only(self, cases: Sequence[str]) -> Sample:
        """The part with these cases."""
        return Sample(*({case: part[case] for case in cases if part} for part in vars(self).values()))

    @property
    def mean(self) -> float:
        """Of all values, or of the means of the kinds."""
        values = np.array(list(self.values.values()))
        return _mean_of_means(values, self.kinds)(np.arange(len(values))) if self.kinds else float(values.mean())


def case_of(record: Record) -> str:
    """What a result is called: the case of a benchmark, the episode of a simulated task."""
    return record["case"] if "case" in record else record["episode"]["id"]


def group_of(record: Record) -> Any:
    """Which cases share luck: those of one scene, whatever its seed is, or of one cluster of a benchmark."""
    if "cluster" in record:
        return record["cluster"]
    episode = record["episode"]
    # The storeys of a building have hashes of their own: the scenes of a file are told apart by their seeds.
    return episode.get("seed" if "slot" in episode else "scene_hash", episode.get("seed", episode["id"]))


def numbers(values: Sequence[float | bool | None]) -> np.ndarray:
    """A list of a trace as an array, NaN where it has nothing."""
    return np.array([np.nan if value is None else float(value) for value in values])


def finished(records: Iterable[Record]) -> list[Record]:
    """The records that hold a result."""
    return [record for record in records if record["status"] == "ok"]


def played_by(records: Iterable[Record], method: str | None) -> list[Record]:
    """The records with a result of `method`; of a benchmark (None), all with a result."""
    return [record for record in finished(records) if method is None or method in record["methods"]]


def cause_of(record: Record) -> str | None:
    """Why a benchmark's case failed ("wrong" where the benchmark names no cause); None for one that did not fail."""
    cause = record.get("cause")
    return str(cause or "wrong") if cause or record.get("score", 1) < 1 else None


def failures(records: Iterable[Record]) -> list[dict[str, Any]]:
    """What the records without a result say: key, attempt, error."""
    return [
        {"key": record["key"], "attempt": record["attempt"], "error": record.get("error", "")}
        for record in records
        if record["status"] != "ok"
    ]


def computing_time(records: Iterable[Record]) -> str:
    """How long all units took together, in words."""
    hours = sum(float(record.get("seconds") or 0.0) for record in records) / 3600
    return f"{hours:.2f} process hours" if hours >= 0.1 else f"{60 * hours:.1f} process minutes"


def method_names(records: Iterable[Record]) -> set[str]:
    """Every method that has a result."""
    return {name for record in finished(records) for name in record["methods"]}


def sample(records: Iterable[Record], method: str | None, column: Measured) -> Sample:
    """The figures of `method` (None: a benchmark's records have none) in `column`, of the cases that have one."""
    found = Sample({}, {}, {})
    for record in finished(records):
        if (value := column.of(record, method)) is None:
            continue
        case = case_of(record)
        if case in found.values:
            whose = f" of {method}" if method else ""
            raise EagorError(f"{case!r} has two results{whose}; give each episode or case an id of its own")
        found.values[case] = value
        found.groups[case] = group_of(record)
        if column.over:
            found.kinds[case] = column.over(record)
    return found


def wilson(values: Collection[float], scale: float) -> list[float]:
    """Wilson's 95 % interval of the mean of `values`, which are 0 or `scale`."""
    ends = wilson_interval(round(sum(values) / scale), len(values), LEVEL)
    return [scale * ends.low, scale * ends.high]


def clustered(found: Sample, share_of: float | None = None) -> list[float] | None:
    """The 95 % interval of the mean, which knows that a group's cases share their luck; None with fewer than two.

    By a bootstrap of whole groups, or, of values that are 0 or `share_of`, by `eagor.statistics.share_interval`.
    """
    values, labels = np.array(list(found.values.values())), list(found.groups.values())
    if len(set(labels)) < 2:
        return None
    if share_of is not None:
        ends = share_interval(values / share_of, labels, LEVEL)
        return [share_of * ends.low, share_of * ends.high]
    if not found.kinds:
        low, high = mean_intervals(values[:, None], labels)
        return None if low[0] is None or high[0] is None else [low[0], high[0]]
    return _ends(_mean_of_means(values, found.kinds), labels)


def _ends(statistic: Callable[[np.ndarray], float], labels: Sequence[Any]) -> list[float]:
    """The bootstrap's interval of a statistic of the indices of the cases."""
    ends = bootstrap_interval(np.arange(len(labels)), np.random.default_rng(SEED), LEVEL, statistic, labels, RESAMPLES)
    return [ends.low, ends.high]


def _mean_of_means(values: np.ndarray, kinds: Mapping[str, str]) -> Callable[[np.ndarray], float]:
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
    names = list(dict.fromkeys(labels))
    place = {name: index for index, name in enumerate(names)}
    member = np.zeros((len(names), len(labels)))
    member[[place[label] for label in labels], np.arange(len(labels))] = 1.0
    there = np.isfinite(values)
    sums, counts = member @ np.where(there, values, 0.0), member @ there
    if len(names) < 2:
        return [None] * values.shape[1], [None] * values.shape[1]
    drawn = np.random.default_rng(SEED).integers(len(names), size=(RESAMPLES, len(names)))
    times = np.stack([(drawn == index).sum(axis=1) for index in range(len(names))], axis=1).astype(float)
    total = times @ counts
    means = np.where(total > 0, (times @ sums) / np.maximum(total, 1.0), np.nan)
    told = np.count_nonzero(counts, axis=0) >= 2
    ends = np.nanquantile(np.where(told, means, 0.0), [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
    low, high = ([float(v) if there else None for v, there in zip(row, told, strict=True)] for row in ends)
    return low, high


def gap(a: Sample, b: Sample) -> Gap | None:
    """Mean of a - b over the cases that both have; None with fewer than two groups."""
    shared = [case for case in a.values if case in b.values]
    a, b = a.only(shared), b.only(shared)
    labels = list(a.groups.values())
    if len(set(labels)) < 2:
        return None
    x, y = (np.array(list(part.values.values())) for part in (a, b))
    weights = np.ones(len(shared))
    if a.kinds:  # with these, a plain mean is the mean of the kinds' means
        _, place, counts = np.unique(list(a.kinds.values()), return_inverse=True, return_counts=True)
        weights = len(shared) / (len(counts) * counts[place])
    found = paired_difference(weights * x, weights * y, np.random.default_rng(SEED), groups=labels, level=LEVEL)
    low, high = found.interval.low, found.interval.high
    if a.kinds:  # groups that are drawn hold other shares of the kinds
        low, high = _ends(_mean_of_means(x - y, a.kinds), labels)
    return Gap(found.difference, low, high, found.p, found.n, found.groups)


def lowest_p(groups: int, tests: int = 1) -> float:
    """The p of `gap` where all `groups` agree, times the number of `tests` as `holm` has it (so perhaps above 1)."""
    return tests * 2.0 ** (1 - groups)


def holm(p: Sequence[float]) -> list[float]:
    """p-values corrected for being many, so that all rejections together are false with at most the stated chance.

    Holm, A simple sequentially rejective multiple test procedure, Scandinavian Journal of Statistics 6, 1979.
    """
    order = np.argsort(p, kind="stable")
    corrected = np.empty(len(p))
    most = 0.0
    for rank, index in enumerate(order):
        most = max(most, min(1.0, (len(p) - rank) * p[index]))
        corrected[index] = most
    return corrected.tolist()


# --- what a record has to look like before it is counted --------------------------------------------------------------

Shape = Any
_MOST = 1e12  # what is measured is never as large, and sums of such numbers stay finite


@dataclass(frozen=True)
class Kind:
    """A plain value: whether one fits, and what is wanted in words."""

    fits: Callable[[Any], bool]
    wanted: str


def _is_number(value: Any) -> bool:
    return within(value, -_MOST, _MOST)


def _or_null(kind: Kind) -> Kind:
    return Kind(lambda value: value is None or kind.fits(value), f"{kind.wanted}, or null")


def _all(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list) and bool(value) and all(map(fits, value))


NUMBER = Kind(_is_number, "a number")
SHARE = Kind(lambda value: isinstance(value, bool) or within(value, 0, 1), "a number from 0 to 1")
COUNT = Kind(lambda value: whole(value, 0, _MOST), "a whole number from 0 on")
TEXT = Kind(lambda value: isinstance(value, str), "text")
LABEL = Kind(lambda value: isinstance(value, str | bool) or _is_number(value), "text or a number")
FIGURE = _or_null(Kind(lambda value: isinstance(value, bool) or _is_number(value), "a number"))
NUMBERS = Kind(_all(_is_number), "a list of numbers")
FIGURES = Kind(_all(FIGURE.fits), "a list of numbers and nulls")
OBJECT = Kind(lambda value: isinstance(value, dict), "an object")
FLAGS = Kind(_all(lambda value: isinstance(value, bool)), "a list of true and false")
LABELS = Kind(_all(LABEL.fits), "a list of texts")
TAGS = Kind(lambda value: isinstance(value, list) and all(isinstance(tag, str) for tag in value), "a list of texts")
POSES = Kind(
    _all(lambda pose: isinstance(pose, list) and len(pose) == 7 and all(map(_is_number, pose)) and any(pose[3:])),
    "a list of x, y, z, qw, qx, qy, qz",
)
PLACES = Kind(
    _all(lambda at: at is None or (isinstance(at, list) and len(at) == 3 and all(map(_is_number, at)))),
    "a list of x, y, z and nulls",
)

WOULD = Kind(
    lambda value: isinstance(value, dict) and (value.get("p") is None or SHARE.fits(value["p"])),
    "an object, whose p is a number from 0 to 1",
)

_LOOKED = {"looks": COUNT, "unread": COUNT, "milliseconds": _or_null(NUMBER), "source": _or_null(OBJECT)}
SIMULATED: Shape = {
    "episode": {
        "id": TEXT, "seed?": COUNT, "query": TEXT, "scene?": TEXT, "scene_hash?": TEXT, "world?": TEXT,
        "targets": [COUNT], "stratum?": {"*": LABEL}, "balls?": _or_null(PLACES), "radius?": NUMBER,
    },
    "truth?": {
        "pose": POSES, "azimuth_deg": NUMBERS, "elevation_deg": NUMBERS, "range_m": NUMBERS, "visible": FLAGS,
        "present?": FLAGS, "leg?": LABELS, "seam": FLAGS,
    },
    "methods": {
        "*": {
            "metrics": {"*": FIGURE},
            "trace": {
                "azimuth_deg": NUMBERS, "elevation_deg": NUMBERS, "error_deg": FIGURES, "inside?": _or_null(FIGURES),
                "mass_above?": _or_null(FIGURES), "distance_m?": _or_null(FIGURES), "pose?": POSES,
                "true_azimuth_deg?": NUMBERS, "true_elevation_deg?": NUMBERS, "true_range_m?": NUMBERS,
                "visible?": FLAGS, "searching?": FLAGS,
            },
            "looked?": _LOOKED,
        }
    },
    "looked?": _LOOKED,
}  # fmt: skip
WALKED: Shape = {
    "methods": {
        "*": {
            "metrics": {"success": NUMBER, "spl": NUMBER, "mae": NUMBER},
            "trace": {"pose": POSES, "true_azimuth_deg": NUMBERS, "true_range_m": NUMBERS, "visible": FLAGS},
        }
    }
}
WATCHED: Shape = {"truth": {}}  # all methods saw the same
IN_LEGS: Shape = {"truth": {"leg": LABELS}}
PUBLISHED: Shape = {
    "case": TEXT, "cluster": LABEL, "score": SHARE, "level?": TEXT, "tags?": TAGS, "views?": COUNT,
    "by_turn?": Kind(_all(SHARE.fits), "a list of numbers from 0 to 1"), "stated?": _or_null(SHARE),
    "cause?": _or_null(TEXT), "sure?": _or_null(SHARE), "scoring?": TEXT, "scores?": {"*": FIGURE},
    "error?": _or_null(NUMBER), "steps?": [{"would?": _or_null(WOULD)}],
}  # fmt: skip

_WORDS: dict[str, Shape] = {"text": TEXT, "texts": TAGS, "figures": {"*": FIGURE}}


def published(more: Mapping[str, str]) -> Shape:
    """The shape of a benchmark's records, with what it says `more` of them (`eagor.lab.tasks.benchmark.Benchmark`)."""
    return PUBLISHED | {name: _WORDS[kind] for name, kind in more.items()}


def checked(records: Sequence[Record], shape: Shape) -> Sequence[Record]:
    """`records`, those with a result as `shape` says. Raises `FormatError`, which names the record and the place."""
    for record in records:
        wanted = shape if record["status"] == "ok" else {"error?": TEXT}
        fault = _fault(record, {"task?": _or_null(TEXT), "seconds?": _or_null(NUMBER), **wanted}, "") or _uneven(record)
        if fault:
            raise FormatError(
                f"the record {shown(record['key'], 200)} (attempt {record['attempt']}): {fault}. Restore its line, or "
                "delete it: its unit is then done again"
            )
    return records


def _fault(value: Any, shape: Shape, place: str) -> str | None:
    """What is wrong with `value`, in words; None if nothing is."""
    if isinstance(shape, Kind):
        return None if shape.fits(value) else f"{place} is {shown(value)}; wanted {shape.wanted}"
    kind, wanted = (list, "a list") if isinstance(shape, list) else (dict, "an object")
    if not isinstance(value, kind):
        return f"{place} is {shown(value)}; wanted {wanted}"
    for name, inner, each in _parts(value, shape):
        where = f"{place}.{shown(name)[1:-1] if isinstance(name, str) else name}".lstrip(".")
        if each is _MISSING:
            return f"there is no {where}"
        if found := _fault(each, inner, where):
            return found
    return None


_MISSING = object()


def _parts(value: Any, shape: Shape) -> list[tuple[Any, Shape, Any]]:
    """The name, the shape and the value of each part that is to be looked at."""
    if isinstance(shape, list):
        return [(index, shape[0], each) for index, each in enumerate(value)]
    found = []
    for name, inner in shape.items():
        plain = name.removesuffix("?")
        if plain == "*":
            found += [(key, inner, each) for key, each in value.items() if not {key, f"{key}?"} & shape.keys()]
        elif plain == name or plain in value:
            found.append((plain, inner, value.get(plain, _MISSING)))
    return found


def _uneven(record: Record) -> str | None:
    """Lists of one episode must be of one length: of each step there is one value."""
    entries = record.get("methods")
    if record["status"] != "ok" or not isinstance(entries, Mapping):
        return None
    truth = record.get("truth") or {}
    for name, entry in entries.items():
        lists = {f"truth.{key}": each for key, each in truth.items()} | entry["trace"]
        counts = {key: len(each) for key, each in lists.items() if isinstance(each, list)}
        if len(set(counts.values())) > 1:
            return f"the lists of {name} are of different lengths ({shown(counts, 200)})"
    return None
