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
from eagor.lab.eval.results import (
    OURS,
    RESAMPLES,
    SEED,
    Run,
    compare,
    holm,
    made,
    mean_intervals,
    ordered,
    summarise,
)
from eagor.lab.tasks.published import score_metric
from eagor.lab.tasks.task import load
from eagor.statistics import Interval, PairedDifference, bootstrap_interval, paired_difference, share_interval

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


def test_metrics_are_read_as_their_task_says():
    answer = {"metrics": {"success": 1, "spl": 0.5, "seam_crossings": 0, "starts_at_seam": 1.0}}
    values = {key: metric("navigation", key).of(answer) for key in ("sr", "spl", "seam_success", "seam_start", "mae")}
    assert values == {"sr": 100.0, "spl": 50.0, "seam_success": None, "seam_start": 100.0, "mae": None}


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
    found = mean_intervals(np.array(values)[:, None], groups)[:, 0].tolist()
    wanted = bootstrap_interval(values, np.random.default_rng(SEED), groups=groups, resamples=RESAMPLES)
    assert found == pytest.approx([wanted.low, wanted.high], abs=1e-9)


def test_the_seeds_of_one_scene_are_one_group():
    records = runs.waypoint(apartments=4, each=1, methods=FEW)
    for record in records:
        record["episode"] |= {"world": "house.glb", "scene_hash": "of the house"}
    summary = summarise(run_of(records))
    assert summary["groups"] == 1
    assert summary["intervals"]["eagor"]["L1"] is None
    assert summary["differences"]["grid"]["L1"] is None
    assert summary["methods"]["eagor"]["L1"] is not None
    for number, record in enumerate(records):  # storeys of two buildings that a file lists
        record["episode"] |= {"slot": {}, "seed": 10_000 + number % 2, "scene_hash": f"storey {number}"}
    assert summarise(run_of(records))["groups"] == 2


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
    assert tables.mark(summary, "centroid", low) == "-"
    assert tables.mark(summary, "eagor", low) == ""
    assert tables.best(summary, low, ["centroid", "vmf", "eagor"]) == {"eagor"}
    assert tables.best(summary, metric("waypoint", "coverage"), ["vmf", "eagor"]) == set()
    text = tables.as_text(found, summary)
    assert text[0] == "Waypoint Following: 20 episodes, 20 apartments"
    assert [line.split()[0] for line in text[2:5]] == ["centroid", "vmf", "eagor"]
    summary["differences"]["vmf"]["L4"] |= {"difference": -1.0, "p_holm": 0.01}
    assert tables.mark(summary, "vmf", low) == "+"
    assert any(line.startswith("† worse, ‡ better than eagor") for line in tables.as_text(found, summary))


def test_figures_as_text():
    cells = [(None, "L1"), (12.34, "L1"), (-0.04, "delta"), (-3, "delta"), (3, "delta")]
    found = [tables.shown(value, metric("waypoint", key)) for value, key in cells]
    assert found == ["–", "12.3", "0.0", "−3.0", "+3.0"]


def test_records_of_another_task_and_two_of_one_sample_are_refused():
    with pytest.raises(EagorError, match=r"navigation.*waypoint"):
        run_of([*runs.navigation(apartments=1, each=1), *runs.waypoint(apartments=1, each=1)])
    twice = runs.waypoint(apartments=1, each=1)
    with pytest.raises(EagorError, match="two results"):
        summarise(run_of([*twice, *copy.deepcopy(twice)]))


def test_published_figures_are_those_that_were_printed():
    printed = {
        "waypoint": """
            centroid    25.5 49.4 90.9 66.7 40.3 31.1 59.1 11.6
            cent_circ   25.5 49.3 66.3 72.8 46.4 31.1 51.0 7.3
            grid        23.2 138.9 37.3 75.9 52.3 135.2 42.4 19.2
            eagor_paper 21.1 31.1 40.9 47.1 25.4 15.5 22.9 2.6""",
        "navigation": """
            centroid    82 54.4 61.0 45.9 19.6
            cent_circ   62 41.5 77.8 46.5 33.5
            grid        82 41.4 63.6 54.2 15.8
            eagor_paper 94 56.8 50.2 33.8 70.6""",
    }
    for task, text in printed.items():
        for line in text.split("\n")[1:]:
            name, *figures = line.split()
            assert list(tables.PUBLISHED[task][name].values()) == [float(figure) for figure in figures]
            assert set(tables.PUBLISHED[task][name]) <= {m.key for m in load(task).metrics}


@pytest.mark.parametrize(
    ("published", "low", "high", "p", "word"),
    [(5, 1, 3, 0.01, "holds"), (5, -3, -1, 0.01, "reversed"), (5, -1, 3, 0.2, "open"), (-5, -3, -1, 0.01, "holds"),
     (5, 1, 3, 0.2, "open")],
)  # fmt: skip
def test_verdicts_on_the_papers_ordering(published, low, high, p, word):
    measured = PairedDifference((low + high) / 2, Interval(low, high, 0.95), p, 10, 10)
    assert tables.verdict(published, measured) == word


def test_margins_are_positive_where_the_published_method_is_better():
    found = run_of(runs.waypoint(apartments=12, each=1, methods=("centroid", "cent_circ", "grid", "eagor_paper")))
    table = tables.ordering_table(found.task, found.results())
    published, measured = table.rows[0], table.rows[1]
    assert published.cells[0].text == "+4.4"  # 25.5 - 21.1
    assert [cell.mark for cell in measured.cells[:4]] == ["holds"] * 4
    other = run_of(runs.tracking(apartments=2))
    assert not tables.ordering_table(other.task, other.results()).rows


def test_what_so_few_apartments_cannot_tell_is_said(run):
    found, summary = run
    rows = [f for row in summary["differences"].values() for f in row.values() if f is not None]
    lowest = len(rows) * 2.0 ** (1 - summary["groups"])
    assert min(f["p_holm"] for f in rows) >= min(lowest, 1.0)
    notes = " ".join(tables.main_table(found.task, summary).notes)
    assert "Only 5 apartments" in notes
    assert f"{len(rows)} tests no p can be below {min(lowest, 1.0):.2g}" in notes


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
    assert found["mcnemar"] == {"only_a": 4, "only_b": 1, "p": pytest.approx(0.375), "n": 8}


def test_one_cluster_has_a_difference_without_an_interval():
    alone = answers(("often", "a", 1), ("rare", "a", 0)), answers(("often", "a", 0), ("rare", "a", 0))
    for figure in compare(*alone)["figures"].values():
        assert figure["difference"] == pytest.approx(50)
        assert figure.keys().isdisjoint({"low", "high", "p"})
