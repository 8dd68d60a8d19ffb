"""The figures of a benchmark's run, and the differences between two runs, against each other and by hand."""

from types import SimpleNamespace
from typing import Any

import pytest

from eagor.lab.eval.benchmarks import Published
from eagor.lab.eval.studies import compare
from eagor.lab.tasks.benchmark import Figure

FIGURES = (
    Figure("overall", "Overall", "mean over the kinds", lambda record: record["score"], lambda record: record["kind"]),
    Figure("plain", "Plain", "mean over the cases", lambda record: record["score"]),
)
BENCHMARK: Any = SimpleNamespace(name="made up", figures=FIGURES, work="")
SETTINGS = {"task": "made up", "data": "nowhere"}


def run(*found):
    """Records of (kind, cluster, score), in order."""
    records = [
        {
            "key": f"{k}",
            "case": f"{k:02d}",
            "attempt": 1,
            "status": "ok",
            "kind": kind,
            "cluster": cluster,
            "score": score,
        }
        for k, (kind, cluster, score) in enumerate(found)
    ]
    return Published(BENCHMARK).loaded(SETTINGS, records)


# Six questions of one kind and two of another, in four clusters: the kinds weigh alike, the cases do not.
ROOMS = ("a", "a", "b", "b", "c", "d", "c", "d")
KINDS = ("often",) * 6 + ("rare",) * 2
LEFT = run(*zip(KINDS, ROOMS, (1, 1, 1, 1, 1, 0, 0, 1), strict=True))
RIGHT = run(*zip(KINDS, ROOMS, (1, 0, 0, 0, 0, 0, 1, 1), strict=True))


def test_a_comparison_is_about_the_figures_that_each_run_reports():
    found = compare(LEFT, RIGHT)["figures"]
    for key in ("overall", "plain"):
        a, b = LEFT.summary[key], RIGHT.summary[key]
        assert (found[key]["a"], found[key]["b"]) == (pytest.approx(a), pytest.approx(b))
        assert found[key]["difference"] == pytest.approx(a - b)
        assert found[key]["low"] <= found[key]["difference"] <= found[key]["high"]
    assert found["overall"]["difference"] == pytest.approx(100 * (4 / 6 - 1 / 2) / 2)
    assert found["plain"]["difference"] == pytest.approx(100 * 3 / 8)


def test_the_sign_flips_of_a_mean_over_kinds_weigh_the_kinds_alike():
    """By hand: what each cluster gives to the difference, under every pattern of signs."""
    found = compare(LEFT, RIGHT)["figures"]["overall"]
    parts = (1 / 12, 2 / 12, 1 / 12 - 1 / 4, 0.0)
    reached = [
        sum(part * (1 if pattern >> k & 1 else -1) for k, part in enumerate(parts))
        for pattern in range(2 ** len(parts))
    ]
    assert sum(parts) == pytest.approx(found["difference"] / 100)
    assert found["p"] == pytest.approx(sum(abs(value) >= sum(parts) - 1e-12 for value in reached) / len(reached))
    assert found["mcnemar"] == {"only_a": 4, "only_b": 1, "p": pytest.approx(0.375)}


def test_one_cluster_has_a_difference_without_an_interval():
    alone = run(("often", "a", 1), ("rare", "a", 0)), run(("often", "a", 0), ("rare", "a", 0))
    for figure in compare(*alone)["figures"].values():
        assert figure["difference"] == pytest.approx(50)
        assert figure.keys().isdisjoint({"low", "high", "p"})
