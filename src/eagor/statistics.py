"""Confidence intervals, and tests of whether one method is better than another.

Episodes share worlds and targets, so their results are not independent: where `groups` is given, whole groups are
resampled or have their sign flipped, never single values. Randomness comes from a Generator: the same state gives the
same figures. Every function raises `EagorError` on samples that are empty, not finite, or do not fit each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from eagor.errors import EagorError

__all__ = [
    "Interval", "PairedDifference", "ReliabilityBin", "bootstrap_interval", "calibration_error",
    "outcomes", "paired_difference", "reliability", "share_interval",
]  # fmt: skip


@dataclass(frozen=True)
class Interval:
    """A confidence interval of probability `level`."""

    low: float
    high: float
    level: float


@dataclass(frozen=True)
class PairedDifference:
    """Mean of a - b over `n` pairs in `groups` groups, with its interval and two-sided p (sign flips)."""

    difference: float
    interval: Interval
    p: float
    n: int
    groups: int


@dataclass(frozen=True)
class ReliabilityBin:
    """The `n` stated probabilities in [lower, upper): their mean, and how often the event happened."""

    lower: float
    upper: float
    n: int
    stated: float | None
    frequency: float | None


def finite_values(values: ArrayLike, name: str) -> np.ndarray:
    """`values` as a float64 array; `EagorError`, with their `name`, if they are empty or not finite."""
    array = np.asarray(values, dtype=np.float64)
    if array.size == 0:
        raise EagorError(f"{name} is empty; wanted at least one value: leave out a table cell that has no cases")
    bad = int(np.count_nonzero(~np.isfinite(array)))
    if bad:
        raise EagorError(
            f"{name} has {bad} values of {array.size} that are NaN or infinite; find out why, or drop them"
        )
    return array


def outcomes(values: ArrayLike, name: str) -> np.ndarray:
    """`values`, one dimension of booleans (or 0 and 1), as a boolean array ``(n,)``; `EagorError` on anything else."""
    array = finite_values(values, name)
    if array.ndim != 1 or not np.isin(array, (0.0, 1.0)).all():
        raise EagorError(f"{name} must be (n,) booleans; got shape {array.shape} with values such as {array.flat[0]:g}")
    return array.astype(bool)


def same_length(**arrays: np.ndarray) -> None:
    """Raise `EagorError` unless all `arrays`, given by name, have the same first dimension."""
    if len({len(array) for array in arrays.values()}) > 1:
        found = ", ".join(f"{name} has {len(array)}" for name, array in arrays.items())
        raise EagorError(f"one entry per case is wanted in each: {found}; pass all of them for the same cases")


def bootstrap_interval(
    values: ArrayLike,
    rng: np.random.Generator,
    level: float = 0.95,
    statistic: Callable[[np.ndarray], float] = np.mean,
    groups: Sequence | np.ndarray | None = None,
    resamples: int = 2000,
) -> Interval:
    """Percentile bootstrap interval of ``statistic(values)``; a cluster bootstrap where `groups` are given.

    Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13. With few groups (under about 30) or
    a long tail it is too narrow by a few percent of coverage; for a share of successes use `share_interval`.

    Args:
        values: ``(n,)``.
        rng: decides which groups are drawn.
        level: probability that the interval is stated to hold, in (0, 1).
        statistic: maps the values drawn, ``(m,)``, to a number.
        groups: ``(n,)``, the label of each value's group; None makes every value a group of its own.
        resamples: how many samples are drawn.

    Raises:
        EagorError: also for fewer than two groups: one alone says nothing about the spread.
    """
    values = _vector(values, "values")
    _check_level(level)
    members = _members(groups, len(values))
    if resamples < 1:
        raise EagorError(f"got {resamples} resamples; wanted at least 1, usually 2000")
    choice = rng.integers(len(members), size=(resamples, len(members)))
    if statistic is np.mean:  # all at once: a mean needs only each group's sum and size
        sums, sizes = np.array([values[m].sum() for m in members]), np.array([len(m) for m in members])
        drawn = sums[choice].sum(axis=1) / sizes[choice].sum(axis=1)
    else:
        drawn = [statistic(values[np.concatenate([members[i] for i in row])]) for row in choice]
    low, high = np.quantile(drawn, [(1 - level) / 2, (1 + level) / 2])
    return Interval(float(low), float(high), level)


def share_interval(outcomes: ArrayLike, groups: Sequence | np.ndarray, level: float = 0.95) -> Interval:
    """Wilson's interval of a share, for outcomes ``(n,)`` (0 or 1) that come in groups which share their luck.

    It takes as many independent cases as the outcomes are worth: those that would give the share's variance over whole
    groups, at most n. Where all agree there is no such variance, and each group counts as one case. The quantile is
    Student's, with a degree of freedom less than there are groups. After Korn and Graubard, Confidence intervals for
    proportions with small expected number of positive counts estimated from survey data, Survey Methodology 24, 1998.
    """
    _check_level(level)
    values = _vector(outcomes, "outcomes")
    members = _members(groups, len(values))
    share, count = float(values.mean()), len(members)
    over = np.array([(values[one] - share).sum() for one in members]) / len(values)
    variance = count / (count - 1) * float((over**2).sum())
    worth = min(len(values), share * (1 - share) / variance) if variance > 0 else count
    from scipy.stats import t

    z = float(t.ppf((1 + level) / 2, count - 1)) ** 2 / worth
    centre, half = share + z / 2, float(np.sqrt(z * share * (1 - share) + z**2 / 4))
    return Interval((centre - half) / (1 + z), (centre + half) / (1 + z), level)


def paired_difference(
    a: ArrayLike,
    b: ArrayLike,
    rng: np.random.Generator,
    groups: Sequence | np.ndarray | None = None,
    level: float = 0.95,
    resamples: int = 10_000,
) -> PairedDifference:
    """Whether `a` and `b` ``(n,)``, measured on the SAME cases, differ in the mean: a - b, its interval, and p.

    p is of the sign-flip permutation test: if the methods are equal, each group's difference is as likely to have the
    other sign. All 2^groups sign patterns are tried if they are at most `resamples`, else that many random ones.
    p is twice the share of patterns that reach as far to the side of the found difference, at most 1; of random ones
    that share is (hits + 1) / (resamples + 1), so p is never 0. The interval is `bootstrap_interval`'s.
    """
    a, b = _vector(a, "a"), _vector(b, "b")
    same_length(a=a, b=b)
    difference = a - b
    members = _members(groups, len(difference))
    from scipy.stats import permutation_test

    test = permutation_test(
        (np.array([difference[m].sum() for m in members]),),
        lambda sums, axis: sums.sum(axis=axis),
        permutation_type="samples",
        vectorized=True,
        n_resamples=resamples,
        batch=1000,
        rng=rng,
    )
    interval = bootstrap_interval(difference, rng, level=level, groups=groups)
    return PairedDifference(float(difference.mean()), interval, float(test.pvalue), len(difference), len(members))


def reliability(stated: ArrayLike, happened: ArrayLike, bins: int = 10) -> tuple[ReliabilityBin, ...]:
    """The reliability table: stated probabilities in `bins` equal bins, against how often it happened.

    Args:
        stated: probabilities ``(n,)`` in [0, 1]; 1 itself belongs to the last bin.
        happened: ``(n,)`` booleans.
        bins: how many. A bin without statements has n = 0 and None for both shares.
    """
    stated, happened = _vector(stated, "stated"), outcomes(happened, "happened")
    same_length(stated=stated, happened=happened)
    if stated.min() < 0 or stated.max() > 1:
        raise EagorError(f"stated probabilities span {stated.min():g} to {stated.max():g}; wanted all in [0, 1]")
    if bins < 1:
        raise EagorError(f"got {bins} bins; wanted at least 1")
    edges = np.linspace(0.0, 1.0, bins + 1)
    place = np.searchsorted(edges[1:-1], stated, side="right")
    table = []
    for k in range(bins):
        here = place == k
        n = int(here.sum())
        mean, frequency = (float(stated[here].mean()), float(happened[here].mean())) if n else (None, None)
        table.append(ReliabilityBin(float(edges[k]), float(edges[k + 1]), n, mean, frequency))
    return tuple(table)


def calibration_error(table: Sequence[ReliabilityBin]) -> float:
    """Expected calibration error of a `reliability` table: mean gap between stated and observed, weighted by cases."""
    said = [row for row in table if row.n]
    if not said:
        raise EagorError("the table holds no statements; pass what `reliability` returned")
    gaps = [abs((row.stated or 0.0) - (row.frequency or 0.0)) for row in said]
    return float(np.average(gaps, weights=[row.n for row in said]))


def _vector(values: ArrayLike, name: str) -> np.ndarray:
    array = finite_values(values, name)
    if array.ndim != 1:
        raise EagorError(f"{name} has shape {array.shape}; wanted (n,): one number per case")
    return array


def _check_level(level: float) -> None:
    if not 0.0 < level < 1.0:
        raise EagorError(f"level is {level}; wanted a probability between 0 and 1, such as 0.95")


def _members(groups: Sequence | np.ndarray | None, n: int) -> list[np.ndarray]:
    """The indices that make up each group, in order of first appearance; `EagorError` for fewer than two groups."""
    labels = range(n) if groups is None else groups.tolist() if isinstance(groups, np.ndarray) else list(groups)
    if len(labels) != n:
        raise EagorError(f"groups has {len(labels)} labels for {n} values; wanted one per value")
    found: dict[object, list[int]] = {}
    for index, label in enumerate(labels):
        found.setdefault(label, []).append(index)
    if len(found) < 2:
        raise EagorError(
            f"got {len(found)} group(s) of values; wanted at least 2: one alone says nothing about the spread"
        )
    return [np.array(indices) for indices in found.values()]
