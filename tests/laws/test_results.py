"""What must hold for the figures of any run, and for the differences between two."""

import copy
import json
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import synthetic_runs as runs
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor.errors import EagorError
from eagor.lab.eval import tables
from eagor.lab.eval.report import compare
from eagor.lab.eval.results import OURS, RESAMPLES, SEED, Run, Value, holm, interval, made, ordered, summarise
from eagor.lab.tasks.published import score_metric
from eagor.lab.tasks.task import load
from eagor.statistics import bootstrap_interval, paired_difference, share_interval

MAKERS = {"waypoint": runs.waypoint, "navigation": runs.navigation, "tracking": runs.tracking}
FEW = ("grid", "eagor_paper", "vmf", "eagor")


def run_of(records):
    return made({"task": records[0]["task"]}, json.loads(json.dumps(records)))


@cache
def summarised(task):
    found = run_of(MAKERS[task](apartments=5, methods=FEW))
    return found, summarise(found)


@pytest.fixture(params=MAKERS)
def run(request):
    return summarised(request.param)


@pytest.fixture
def navigation():
    return summarised("navigation")


def metric(task, key):
    return next(m for m in load(task).metrics if m.key == key)


def test_means_are_over_the_episodes_that_have_a_case(run):
    found, summary = run
    assert list(summary["methods"]) == ordered(summary["methods"])
    for name, row in summary["methods"].items():
        answers = [r["methods"][name] for r in found.records if r["status"] == "ok" and name in r["methods"]]
        assert list(row) == [m.key for m in found.task.metrics]
        for column in found.task.metrics:
            values = [v for answer in answers if (v := column.of(answer)) is not None]
            value, interval = row[column.key], summary["intervals"][name][column.key]
            assert summary["counts"][name][column.key] == len(values)
            assert value == (pytest.approx(np.mean(values)) if values else None)
            assert interval is None or interval[0] - 1e-9 <= value <= interval[1] + 1e-9


def test_the_order_of_the_records_does_not_matter(run):
    found, summary = run
    mixed = [found.records[i] for i in np.random.default_rng(3).permutation(len(found.records))]
    again = summarise(Run(found.task, found.settings, mixed))
    assert summarise(found) == summary  # the generator is seeded
    for part in ("methods", "counts"):
        assert flat(again[part]) == pytest.approx(flat(summary[part]), abs=1e-9)
    assert (again["episodes"], again["failed"]) == (summary["episodes"], summary["failed"])


def flat(tree):
    if not isinstance(tree, dict):
        return {"": tree}
    return {f"{key}.{inner}": value for key, part in tree.items() for inner, value in flat(part).items()}


def test_failed_units_are_counted_and_listed_but_in_no_figure(run):
    found, summary = run
    failed = {"key": "x/1", "task": summary["task"], "attempt": 2, "status": "failed", "error": "no way"}
    more = summarise(Run(found.task, found.settings, [*found.records, failed]))
    assert more["failed"] == summary["failed"] + 1
    assert more["failures"][-1] == {"key": "x/1", "attempt": 2, "error": "no way"}
    same = set(summary) - {"failed", "failures"}
    assert {key: more[key] for key in same} == {key: summary[key] for key in same}


def test_differences_are_paired_by_episode_and_clustered_by_apartment(run):
    found, summary = run
    column = found.task.metrics[0]
    pairs = {}
    for record in found.records:
        if record["status"] == "ok":
            for name in {"grid", OURS} & set(record["methods"]):
                value = column.of(record["methods"][name])
                pairs.setdefault((record["episode"]["id"], record["episode"]["seed"]), {})[name] = value
    pairs = {where: pair for where, pair in pairs.items() if len(pair) == 2}
    a, b = ([pair[name] for pair in pairs.values()] for name in ("grid", OURS))
    wanted = paired_difference(a, b, np.random.default_rng(SEED), groups=[seed for _, seed in pairs])
    row = summary["differences"]["grid"][column.key]
    assert row["difference"] == pytest.approx(wanted.difference)
    assert [row["low"], row["high"]] == pytest.approx([wanted.interval.low, wanted.interval.high])
    assert (row["p"], row["n"], row["groups"]) == (pytest.approx(wanted.p), wanted.n, wanted.groups)
    assert row["p"] <= row["p_holm"] <= 1
    assert OURS not in summary["differences"]


def test_variants_are_compared_with_what_they_vary():
    methods = ("grid", "eagor_paper", "eagor", "eagor:degree=7", "eagor:degree=15", "eagor_paper:decode=mode")
    found = run_of(runs.waypoint(apartments=4, each=1, methods=methods))
    summary = summarise(found)
    rows = summary["methods"]
    for name, other in (("eagor:degree=7", "eagor"), ("eagor_paper:decode=mode", "eagor_paper"), ("grid", "eagor")):
        row = summary["differences"][name]["L1"]["difference"]
        assert row == pytest.approx(rows[name]["L1"] - rows[other]["L1"])
    made_of = tables.variant_tables(found.task, summary)
    assert [table.title for table in made_of] == ["Variants of eagor: degree", "Variants of eagor_paper: decode"]
    assert [row.head for row in made_of[0].rows] == ["eagor (as it is)", "eagor:degree=7", "eagor:degree=15"]


def test_strata_divide_the_episodes(navigation):
    _, summary = navigation
    for labels in summary["strata"].values():
        assert sum(part["episodes"] for part in labels.values()) == summary["episodes"]
        for name in summary["methods"]:
            parts = [(part["methods"][name]["sr"], part["counts"][name]["sr"]) for part in labels.values()]
            whole = sum(value * count for value, count in parts) / sum(count for _, count in parts)
            assert whole == pytest.approx(summary["methods"][name]["sr"])


def test_shares_have_the_interval_of_a_share_of_whole_apartments(navigation):
    found, summary = navigation
    played = [r for r in found.records if r["status"] == "ok" and "grid" in r["methods"]]
    outcomes = [r["methods"]["grid"]["metrics"]["success"] for r in played]
    wanted = share_interval(outcomes, [r["episode"]["seed"] for r in played])
    assert summary["intervals"]["grid"]["sr"] == pytest.approx([100 * wanted.low, 100 * wanted.high])


@settings(max_examples=20)
@given(
    st.lists(st.tuples(st.integers(0, 5), st.floats(-50, 50)), min_size=2, max_size=25).filter(
        lambda rows: len({group for group, _ in rows}) > 1
    )
)
def test_intervals_are_those_of_the_cluster_bootstrap(rows):
    groups, values = zip(*rows, strict=True)
    wanted = bootstrap_interval(values, np.random.default_rng(SEED), groups=groups, resamples=RESAMPLES)
    for kinds in ("a" * len(rows), ("ab" * len(rows))[: len(rows)]):
        each = zip(values, map(str, groups), kinds, strict=True)
        found = interval({str(k): Value(*value) for k, value in enumerate(each)})
        if len(set(kinds)) == 1:
            assert found == pytest.approx([wanted.low, wanted.high], abs=1e-9)
        assert min(values) - 1e-9 <= found[0] <= found[1] <= max(values) + 1e-9


def test_the_seeds_of_one_scene_are_one_group():
    records = runs.waypoint(apartments=4, each=1, methods=FEW)
    for record in records:
        record["episode"] |= {"world": "house.glb", "scene_hash": "of the house"}
    summary = summarise(run_of(records))
    assert summary["groups"] == 1
    assert summary["intervals"]["eagor"]["L1"] is None
    assert summary["differences"]["grid"]["L1"] is None
    assert summary["methods"]["eagor"]["L1"] is not None


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_holms_correction_rejects_what_the_stepwise_procedure_rejects(p):
    corrected = holm(p)
    assert all(a >= b for a, b in zip(corrected, p, strict=True))
    for level in (0.01, 0.05, 0.3):
        rejected = set()
        for rank, index in enumerate(np.argsort(p, kind="stable")):
            if (len(p) - rank) * p[index] > level:
                break
            rejected.add(int(index))
        assert {k for k, value in enumerate(corrected) if value <= level} == rejected


def test_marks_say_who_is_worse_and_the_best_is_as_shown():
    found = run_of(runs.waypoint(apartments=20, each=1, methods=("centroid", "vmf", "eagor")))
    summary, low = summarise(found), metric("waypoint", "L4")
    assert tables.mark(summary, "centroid", low) == "†"
    assert tables.mark(summary, "eagor", low) == ""
    assert tables.best(summary, low, ["centroid", "vmf", "eagor"]) == {"eagor"}
    assert tables.best(summary, metric("waypoint", "coverage"), ["vmf", "eagor"]) == set()
    text = tables.as_text(found, summary)
    assert text[0] == "Waypoint Following: 20 episodes, 20 apartments"
    assert [line.split()[0] for line in text[2:5]] == ["centroid", "vmf", "eagor"]
    summary["differences"]["vmf"]["L4"] |= {"difference": -1.0, "p_holm": 0.01}
    assert tables.mark(summary, "vmf", low) == "‡"
    assert any(line.startswith("† worse, ‡ better than eagor") for line in tables.as_text(found, summary))


def test_records_of_another_task_and_two_of_one_sample_are_refused():
    with pytest.raises(EagorError, match=r"navigation.*waypoint"):
        run_of([*runs.navigation(apartments=1, each=1), *runs.waypoint(apartments=1, each=1)])
    twice = runs.waypoint(apartments=1, each=1)
    with pytest.raises(EagorError, match="two results"):
        summarise(run_of([*twice, *copy.deepcopy(twice)]))


# Two runs of a task with published data: the kinds of questions weigh alike, the questions do not

METRICS = (
    score_metric("overall", "Overall", "over the kinds", lambda record: record["score"], lambda record: record["kind"]),
    score_metric("plain", "Plain", "over the cases", lambda record: record["score"]),
)
TASK = SimpleNamespace(name="made up", metrics=METRICS, failure=lambda record: None, agents={})
ROOMS = ("a", "a", "b", "b", "c", "d", "c", "d")
KINDS = ("often",) * 6 + ("rare",) * 2


def answers(*found):
    """A run with records of (kind, cluster, score), in order."""
    records = [
        {"key": f"{k}", "case": f"{k:02d}", "attempt": 1, "status": "ok", "kind": kind, "cluster": room, "score": score}
        for k, (kind, room, score) in enumerate(found)
    ]
    return Run(TASK, {"task": "made up", "data": "nowhere", "agent": "somebody"}, records)


LEFT = answers(*zip(KINDS, ROOMS, (1, 1, 1, 1, 1, 0, 0, 1), strict=True))
RIGHT = answers(*zip(KINDS, ROOMS, (1, 0, 0, 0, 0, 0, 1, 1), strict=True))


def test_a_comparison_is_about_the_figures_that_each_run_reports():
    found = compare(LEFT, RIGHT)["figures"]
    for key in ("overall", "plain"):
        a, b = (summarise(run)["methods"]["somebody"][key] for run in (LEFT, RIGHT))
        assert (found[key]["a"], found[key]["b"]) == (pytest.approx(a), pytest.approx(b))
        assert found[key]["difference"] == pytest.approx(a - b)
        assert found[key]["low"] <= found[key]["difference"] <= found[key]["high"]
    assert found["overall"]["difference"] == pytest.approx(100 * (4 / 6 - 1 / 2) / 2)
    assert found["plain"]["difference"] == pytest.approx(100 * 3 / 8)
