"""Laws and closed forms of the intervals and tests; scipy and textbook figures as oracles."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from eagor import statistics
from eagor.errors import EagorError


def generator(seed=0):
    return np.random.default_rng(seed)


def wilson(successes, n):
    return binomtest(successes, n).proportion_ci(method="wilson")


# Intervals


def test_a_share_of_groups_that_share_luck_is_held_as_often_as_is_said_where_wilson_is_too_sure():
    rng = generator(3)
    held = np.zeros(2)
    groups = np.repeat(np.arange(20), 5)
    for _ in range(300):
        outcomes = (rng.random(100) < np.repeat(rng.beta(2, 2, 20), 5)).astype(float)
        found = statistics.share_interval(outcomes, groups), wilson(int(outcomes.sum()), 100)
        held += [one.low <= 0.5 <= one.high for one in found]
    assert 0.92 < held[0] / 300 < 0.99
    assert held[1] / 300 < 0.9


def test_a_share_of_single_cases_is_wilsons_but_for_students_quantile():
    outcomes = np.repeat([1.0, 0.0], [700, 300])
    found, plain = statistics.share_interval(outcomes, np.arange(1000)), wilson(700, 1000)
    assert (found.low, found.high) == pytest.approx((plain.low, plain.high), abs=1e-4)
    all_right = statistics.share_interval(np.ones(40), np.repeat(np.arange(10), 4))
    assert all_right.high == pytest.approx(1)
    assert all_right.low == pytest.approx(10 / (10 + 2.262157**2), abs=1e-6)
    with pytest.raises(EagorError, match="at least 2"):
        statistics.share_interval(np.ones(5), np.zeros(5))


def test_bootstrap_holds_the_truth_as_often_as_it_says():
    rng = generator(1)
    hits = 0
    for _ in range(300):
        found = statistics.bootstrap_interval(rng.normal(5, 2, 60), rng, level=0.8, resamples=300)
        hits += found.low <= 5 <= found.high
    assert 0.72 < hits / 300 < 0.86


def test_cluster_bootstrap_holds_the_truth_where_the_plain_one_is_far_too_sure():
    rng = generator(2)
    plain = clustered = 0
    groups = np.repeat(np.arange(25), 12)
    for _ in range(150):
        values = np.repeat(rng.normal(0, 1, 25), 12) + rng.normal(0, 0.2, 300)
        a = statistics.bootstrap_interval(values, rng, resamples=200)
        b = statistics.bootstrap_interval(values, rng, groups=groups, resamples=200)
        plain += a.low <= 0 <= a.high
        clustered += b.low <= 0 <= b.high
    assert plain / 150 < 0.6
    assert clustered / 150 > 0.85


def test_bootstrap_groups_of_unequal_size_weigh_each_value_alike():
    found = statistics.bootstrap_interval([0, 0, 0, 1], generator(), groups=["a", "a", "a", "b"])
    assert (found.low, found.high) == (0.0, 1.0)
    mean = statistics.bootstrap_interval([2.0] * 4, generator(), groups=["a", "a", "a", "b"])
    assert (mean.low, mean.high) == (2.0, 2.0)


@pytest.mark.parametrize(
    ("values", "options"),
    [
        ([], {}),
        ([1.0], {}),
        ([1.0, np.nan], {}),
        ([[1.0, 2.0]], {}),
        ([1.0, 2.0], {"level": 95}),
        ([1.0, 2.0], {"groups": ["a"]}),
        ([1.0, 2.0], {"groups": ["a", "a"]}),
        ([1.0, 2.0], {"resamples": 0}),
    ],
)
def test_bootstrap_refuses_what_has_no_interval(values, options):
    with pytest.raises(EagorError):
        statistics.bootstrap_interval(values, generator(), **options)


# Paired comparisons


@given(st.lists(st.integers(-20, 20), min_size=2, max_size=7))
def test_sign_flip_p_is_the_share_of_patterns_as_extreme(differences):
    values = np.array(differences, dtype=float)
    found = statistics.paired_difference(values, np.zeros(len(values)), generator())
    sums = np.array([np.dot(signs, values) for signs in itertools.product([1, -1], repeat=len(values))])
    assert found.p == pytest.approx(np.mean(np.abs(sums) >= abs(values.sum()) - 1e-9))
    assert found.difference == pytest.approx(values.mean())


def test_groups_flip_together():
    # 60 pairs, but 3 worlds: the smallest p that 2^3 patterns allow is 2 / 8.
    found = statistics.paired_difference(np.ones(60), np.zeros(60), generator(), groups=["a", "b", "c"] * 20)
    assert (found.p, found.n, found.groups) == (0.25, 60, 3)


def test_no_difference_and_random_patterns():
    same = statistics.paired_difference(np.ones(40), np.ones(40), generator())
    assert (same.difference, same.p) == (0.0, 1.0)
    assert (same.interval.low, same.interval.high) == (0.0, 0.0)
    clear = statistics.paired_difference(np.ones(40), np.zeros(40), generator(), resamples=999)
    assert 0 < clear.p <= 0.01  # never 0
    ps = [statistics.paired_difference(*generator(k).normal(size=(2, 12)), generator(k)).p for k in range(100)]
    assert 0.35 < np.mean(ps) < 0.65  # uniform where nothing differs
    with pytest.raises(EagorError, match="a has 3, b has 2"):
        statistics.paired_difference([1, 2, 3], [1, 2], generator())


# Calibration


def test_reliability_table():
    table = statistics.reliability([0.1, 0.2, 0.9, 1.0, 0.5], [False, True, True, True, False], bins=2)
    assert [(row.lower, row.upper, row.n) for row in table] == [(0.0, 0.5, 2), (0.5, 1.0, 3)]
    assert table[0].stated == pytest.approx(0.15)
    assert table[0].frequency == 0.5
    assert table[1].stated == pytest.approx(0.8)
    assert table[1].frequency == pytest.approx(2 / 3)
    gap = (2 * 0.35 + 3 * (0.8 - 2 / 3)) / 5
    assert statistics.calibration_error(table) == pytest.approx(gap)
    empty = statistics.reliability([0.05], [False], bins=10)
    assert [row.n for row in empty] == [1] + [0] * 9
    assert empty[5].stated is empty[5].frequency is None


@given(st.lists(st.floats(0, 1), min_size=1, max_size=60), st.integers(1, 20))
def test_reliability_loses_no_statement(stated, bins):
    table = statistics.reliability(stated, [p > 0.5 for p in stated], bins)
    assert sum(row.n for row in table) == len(stated)
    assert sum(row.n * row.stated for row in table if row.n) == pytest.approx(sum(stated))
    assert all(row.lower - 1e-9 <= row.stated <= row.upper + 1e-9 for row in table if row.n)
    assert 0 <= statistics.calibration_error(table) <= 1


def test_honest_statements_have_a_small_calibration_error():
    rng = generator(8)
    stated = rng.uniform(size=5000)
    happened = rng.uniform(size=5000) < stated
    assert statistics.calibration_error(statistics.reliability(stated, happened)) < 0.03
    assert statistics.calibration_error(statistics.reliability(1 - stated, happened)) > 0.4
    for wrong in ([1.5], [np.nan], []):
        with pytest.raises(EagorError):
            statistics.reliability(wrong, [True] * len(wrong))
    with pytest.raises(EagorError, match="bins"):
        statistics.reliability([0.5], [True], bins=0)
    with pytest.raises(EagorError, match="no statements"):
        statistics.calibration_error([])
