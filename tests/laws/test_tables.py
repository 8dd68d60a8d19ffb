"""What must hold for the tables of any run."""

import copy
import csv
import io
import itertools

import numpy as np
import pytest
import synthetic_runs as runs
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor.errors import EagorError
from eagor.harmonics import RealHarmonics
from eagor.lab.eval import tables
from eagor.lab.eval.samples import RESAMPLES, SEED, Gap, holm, mean_intervals
from eagor.lab.eval.sheets import half_width_deg, highest_sidelobe, kernel, main_sheet, ordering_sheet, verdict
from eagor.lab.eval.study import FIELDS, table_csv
from eagor.lab.eval.tables import FIGURES, OURS, as_text, best, mark, ordered, shown, summarise, varied_by
from eagor.lab.tasks.task import load
from eagor.sphere import direction
from eagor.statistics import bootstrap_interval, paired_difference, share_interval

MAKERS = {"waypoint": runs.waypoint, "navigation": runs.navigation, "tracking": runs.tracking}
KEYS = {
    "waypoint": "L1 L2 L3 L4 delta occ seam tc tc_rotation coverage",
    "navigation": "sr spl soft_spl steps undone mae seam_success seam_start coverage",
    "tracking": "error tc time_lost recovery coverage",
}


FEW = ("grid", "eagor_paper", "vmf", "eagor")


@pytest.fixture(scope="module", params=MAKERS)
def run(request):
    records = MAKERS[request.param](apartments=5, methods=FEW)
    return records, summarise(records)


@pytest.fixture(scope="module")
def navigation():
    records = runs.navigation(apartments=5, methods=FEW)
    return records, summarise(records)


def column(task, key):
    return next(c for c in load(task).columns if c.key == key)


def test_the_columns_are_those_of_the_task_and_every_cell_says_how_many_cases_it_has(run):
    _, summary = run
    for name, row in summary["methods"].items():
        assert list(row) == KEYS[summary["task"]].split()
        for key, value in row.items():
            count, interval = summary["counts"][name][key], summary["intervals"][name][key]
            assert (value is None) == (count == 0)
            if interval is not None:
                assert interval[0] <= value + 1e-9
                assert value <= interval[1] + 1e-9
    assert list(summary["methods"]) == ordered(summary["methods"])


def test_means_are_over_the_episodes_that_have_a_case(run):
    records, summary = run
    for name, row in summary["methods"].items():
        metrics = [r["methods"][name]["metrics"] for r in records if r["status"] == "ok" and name in r["methods"]]
        for key, value in row.items():
            of = column(summary["task"], key)
            found = [m[of.metric] for m in metrics if not of.only_if or m[of.only_if] > 0]
            found = [v * of.scale for v in found if v is not None]
            assert summary["counts"][name][key] == len(found)
            assert value == (pytest.approx(np.mean(found)) if found else None)


def test_the_order_of_the_records_does_not_matter(run):
    records, summary = run
    again = summarise([records[i] for i in np.random.default_rng(3).permutation(len(records))])
    assert summarise(records) == summary  # the generator is seeded
    for part in ("methods", "counts"):
        assert flat(again[part]) == pytest.approx(flat(summary[part]), abs=1e-9)
    assert (again["episodes"], again["failed"]) == (summary["episodes"], summary["failed"])


def test_failed_units_are_counted_and_listed_but_in_no_figure(run):
    records, summary = run
    failed = {"key": "x/1", "task": summary["task"], "attempt": 2, "status": "failed", "error": "no way"}
    more = summarise([*records, failed])
    assert more["failed"] == summary["failed"] + 1
    assert more["failures"][-1] == {"key": "x/1", "attempt": 2, "error": "no way"}
    same = set(summary) - {"failed", "failures"}
    assert {key: more[key] for key in same} == {key: summary[key] for key in same}


def test_differences_are_paired_by_episode_and_clustered_by_apartment(run):
    records, summary = run
    key = KEYS[summary["task"]].split()[0]
    metric, scale = column(summary["task"], key).metric, column(summary["task"], key).scale
    pairs = {}
    for record in records:
        if record["status"] == "ok":
            for name in {"grid", OURS} & set(record["methods"]):
                value = record["methods"][name]["metrics"][metric]
                pairs.setdefault((record["episode"]["id"], record["episode"]["seed"]), {})[name] = scale * value
    pairs = {where: pair for where, pair in pairs.items() if len(pair) == 2}
    a, b = ([pair[name] for pair in pairs.values()] for name in ("grid", OURS))
    wanted = paired_difference(a, b, np.random.default_rng(SEED), groups=[seed for _, seed in pairs])
    found = summary["differences"]["grid"][key]
    assert found["difference"] == pytest.approx(wanted.difference)
    assert [found["low"], found["high"]] == pytest.approx([wanted.interval.low, wanted.interval.high])
    assert (found["p"], found["n"], found["groups"]) == (pytest.approx(wanted.p), wanted.n, wanted.groups)
    assert found["p"] <= found["p_holm"] <= 1
    assert OURS not in summary["differences"]


def test_variants_are_compared_with_what_they_vary():
    methods = ("grid", "eagor_paper", "eagor", "eagor:degree=7", "eagor_paper:decode=mode")
    summary = summarise(runs.waypoint(apartments=4, each=1, methods=methods))
    rows = summary["methods"]
    for name, other in (("eagor:degree=7", "eagor"), ("eagor_paper:decode=mode", "eagor_paper"), ("grid", "eagor")):
        found = summary["differences"][name]["L1"]["difference"]
        assert found == pytest.approx(rows[name]["L1"] - rows[other]["L1"])
    assert varied_by("eagor:floor=0.2,temperature=2") == ("eagor", ("floor", "temperature"))


def test_strata_divide_the_episodes(navigation):
    _, summary = navigation
    for labels in summary["strata"].values():
        assert sum(part["episodes"] for part in labels.values()) == summary["episodes"]
        for name in summary["methods"]:
            parts = [(part["methods"][name]["sr"], part["counts"][name]["sr"]) for part in labels.values()]
            whole = sum(value * count for value, count in parts) / sum(count for _, count in parts)
            assert whole == pytest.approx(summary["methods"][name]["sr"])


def test_shares_have_the_interval_of_a_share_of_whole_apartments(navigation):
    records, summary = navigation
    played = [r for r in records if r["status"] == "ok" and "grid" in r["methods"]]
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
    (low,), (high,) = mean_intervals(np.array(values)[:, None], groups)
    wanted = bootstrap_interval(values, np.random.default_rng(SEED), groups=groups, resamples=RESAMPLES)
    assert [low, high] == pytest.approx([wanted.low, wanted.high], abs=1e-9)


def test_one_apartment_has_no_interval_and_no_difference():
    summary = summarise(runs.waypoint(apartments=1, each=3, methods=FEW))
    assert summary["intervals"]["eagor"]["L1"] is None
    assert summary["differences"]["grid"]["L1"] is None
    assert summary["methods"]["eagor"]["L1"] is not None


def test_the_seeds_of_one_scene_are_one_group():
    records = runs.waypoint(apartments=4, each=1, methods=FEW)
    for record in records:
        record["episode"] |= {"world": "house.glb", "scene_hash": "of the house"}
    summary = summarise(records)
    assert summary["apartments"] == 1
    assert summary["intervals"]["eagor"]["L1"] is None
    for number, record in enumerate(records):  # storeys of two buildings that a file lists
        record["episode"] |= {"slot": {}, "seed": 10_000 + number % 2, "scene_hash": f"storey {number}"}
    assert summarise(records)["apartments"] == 2


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


def test_holm_by_hand():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_marks_say_who_is_worse_and_the_best_is_as_shown():
    summary = summarise(runs.waypoint(apartments=20, each=1, methods=("centroid", "vmf", "eagor")))
    low = column("waypoint", "L4")
    assert mark(summary, "centroid", low) == "-"
    assert mark(summary, "eagor", low) == ""
    assert best(summary, low, ["centroid", "vmf", "eagor"]) == {"eagor"}
    assert best(summary, column("waypoint", "coverage"), ["vmf", "eagor"]) == set()
    turned = copy.deepcopy(summary)
    turned["differences"]["vmf"]["L4"] |= {"difference": -1.0, "p_holm": 0.01}
    assert mark(turned, "vmf", low) == "+"
    assert any(line.startswith("- worse, + better than eagor") for line in as_text(turned))
    text = as_text(summary)
    assert text[0] == "Waypoint Following: 20 episodes"
    assert [line.split()[0] for line in text[2:6]] == ["centroid", "vmf", "eagor", "cases"]


@pytest.mark.parametrize(
    ("value", "key", "said"),
    [
        (None, "L1", "–"),
        (12.34, "L1", "12.3"),
        (-0.04, "delta", "0.0"),
        (-3.0, "delta", "−3.0"),
        (3.0, "delta", "+3.0"),
    ],
)
def test_figures_as_text(value, key, said):
    assert shown(value, column("waypoint", key)) == said


def test_records_that_are_no_run_of_one_task_are_refused():
    with pytest.raises(EagorError, match="none"):
        summarise([])
    with pytest.raises(EagorError, match=r"navigation.*waypoint"):
        summarise([*runs.waypoint(apartments=1, each=1), *runs.navigation(apartments=1, each=1)])
    twice = runs.waypoint(apartments=1, each=1)
    with pytest.raises(EagorError, match="two results"):
        summarise([*twice, *copy.deepcopy(twice)])


def test_csv_has_a_row_for_every_cell_with_the_same_numbers(run):
    _, summary = run
    rows = list(csv.DictReader(io.StringIO(table_csv(summary))))
    assert tuple(rows[0]) == FIELDS
    whole = [row for row in rows if not row["stratum"]]
    assert len(whole) == sum(len(row) for row in summary["methods"].values())
    for row in whole:
        value = summary["methods"][row["method"]][row["column"]]
        assert row["value"] == ("" if value is None else str(value))
        assert row["n"] == str(summary["counts"][row["method"]][row["column"]])
    assert {row["stratum"] for row in rows} == {""} | {
        f"{title}: {label}" for title, labels in summary["strata"].items() for label in labels
    }


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
            assert list(FIGURES[task][name].values()) == [float(figure) for figure in figures]
            assert set(FIGURES[task][name]) <= {c.key for c in load(task).columns}


@pytest.mark.parametrize(
    ("published", "low", "high", "p", "said"),
    [(5, 1, 3, 0.01, "holds"), (5, -3, -1, 0.01, "reversed"), (5, -1, 3, 0.2, "open"), (-5, -3, -1, 0.01, "holds"),
     (5, 1, 3, 0.2, "open")],
)  # fmt: skip
def test_verdicts_on_the_papers_ordering(published, low, high, p, said):
    assert verdict(published, Gap((low + high) / 2, low, high, p, 10, 10)) == said


def test_margins_are_positive_where_the_published_method_is_better():
    records = runs.waypoint(apartments=12, each=1, methods=("centroid", "cent_circ", "grid", "eagor_paper"))
    sheet = ordering_sheet(records, "waypoint")
    published, measured = sheet.rows[0], sheet.rows[1]
    assert published.boxes[0].text == "+4.4"  # 25.5 - 21.1
    assert [box.mark for box in measured.boxes[:4]] == ["holds"] * 4
    assert ordering_sheet(runs.tracking(apartments=2), "tracking") is None


# Curves


def walk(errors, seam=(), legs=None, seed=1, **more):
    count = len(errors)
    return {
        "status": "ok",
        "episode": {"id": str(seed), "seed": seed},
        "methods": {"m": {"trace": {"error_deg": errors, **more}}},
        "truth": {
            "seam": [k in seam for k in range(count)],
            "leg": legs or ["L1"] * count,
            "visible": [k % 2 == 0 for k in range(count)],
        },
    }


def test_errors_are_aligned_at_the_events():
    records = [walk([0, 1, 2, 3, 4, 5, 6, 7], seam=[2, 6]), walk([10, 10, 10, 10, 10, 10, 10, 10], seam=[4], seed=2)]
    curve = tables.around(records, "m", tables.crossings, 1, 1)
    assert curve.x == (-1, 0, 1)
    assert curve.y == pytest.approx((((1 + 5) / 2 + 10) / 2, ((2 + 6) / 2 + 10) / 2, ((3 + 7) / 2 + 10) / 2))
    assert curve.n == (2, 2, 2)
    assert tables.around([walk([1, 2])], "m", tables.crossings, 1, 1) is None


def test_a_window_about_a_turn_holds_no_step_of_another_turn():
    legs = ["L1"] * 3 + ["L2"] * 2 + ["L3"] * 4
    record = walk([0, 1, 2, 3, 4, 5, 6, 7, None], legs=legs)
    assert tables.turns(record, "m") == [3, 5]
    curve = tables.around([record], "m", tables.turns, 4, 3, alone=True)
    assert curve.x == tuple(range(-4, 3))  # nothing is known of the third step after either turn
    assert curve.y == (None, 0.0, pytest.approx((1 + 3) / 2), pytest.approx((2 + 4) / 2), 4.0, 5.0, 7.0)


def test_a_curve_by_step_ends_where_fewer_than_half_go_on():
    records = [walk([1] * length, seed=length) for length in (3, 5, 5, 9)]
    assert tables.by_step(records, "m").x == (0, 1, 2, 3, 4)
    assert tables.by_step(records, "m").n == (4, 4, 4, 3, 3)


def test_honest_regions_lie_on_the_diagonal():
    rng = np.random.default_rng(0)
    records = [walk([1.0] * 4000, seed=seed, mass_above=rng.random(4000).tolist()) for seed in range(3)]
    curve = tables.reliability(records, "m")
    assert curve.y == pytest.approx(curve.x, abs=2)
    assert tables.reliability([walk([1.0])], "m") is None


def test_coverage_in_and_out_of_sight():
    record = walk([1.0] * 6, inside=[True, False, True, False, False, None])
    assert tables.coverage([record], "m", True).mean == pytest.approx(200 / 3)
    assert tables.coverage([record], "m", False).mean == 0.0


# Kernels


@pytest.mark.parametrize("degree", [1, 7, 31])
def test_the_kernel_is_that_of_the_harmonics(degree):
    angles = np.linspace(0, np.pi, 50)
    basis = RealHarmonics(degree)
    values = basis.evaluate(direction(angles, 0 * angles)) @ basis.evaluate(np.array([1.0, 0, 0]))
    assert kernel(degree, angles) == pytest.approx(values / values[0], abs=1e-9)


def test_width_and_sidelobe_in_closed_form():
    # Degree 1: K = (1 + 3 cos t) / 4, half at cos t = 1/3, and -1/2 at the far side.
    assert half_width_deg(1) == pytest.approx(np.degrees(np.arccos(1 / 3)), abs=1e-3)
    assert highest_sidelobe(1) == pytest.approx(0.5)
    assert half_width_deg(0) is None
    assert highest_sidelobe(0) is None


def test_a_higher_degree_is_narrower():
    widths = [half_width_deg(degree) for degree in (1, 3, 7, 15, 31)]
    assert all(a > b for a, b in itertools.pairwise(widths))
    for degree, width in zip((1, 3, 7, 15, 31), widths, strict=True):
        assert kernel(degree, np.radians(width)) == pytest.approx(0.5, abs=1e-4)


def flat(tree):
    if not isinstance(tree, dict):
        return {"": tree}
    return {f"{key}.{inner}": value for key, part in tree.items() for inner, value in flat(part).items()}


def test_what_so_few_apartments_cannot_tell_is_said(run):
    _, summary = run
    found = [f for row in summary["differences"].values() for f in row.values() if f is not None]
    lowest = len(found) * 2.0 ** (1 - summary["apartments"])
    assert min(f["p_holm"] for f in found) >= min(lowest, 1.0)
    notes = " ".join(main_sheet(summary).notes)
    assert "Only 5 apartments" in notes
    assert f"{len(found)} tests no p can be below {min(lowest, 1.0):.2g}" in notes
    many = summarise(runs.waypoint(apartments=14, each=1, methods=("vmf", "eagor"), steps=8))
    assert "apartments" not in " ".join(main_sheet(many).notes).replace("whole apartments", "")


def test_where_ours_is_behind_is_said_with_the_figures(run):
    _, summary = run
    summary = copy.deepcopy(summary)
    note = next(note for note in main_sheet(summary).notes if "behind another" in note or "is behind beyond" in note)
    chosen = next(c for c in load(summary["task"]).columns if c.better and c.key in summary["differences"]["vmf"])
    gap = {"difference": -1e3 if chosen.better == "low" else 1e3, "p_holm": 1e-4}
    summary["differences"]["vmf"][chosen.key] = gap
    changed = next(n for n in main_sheet(summary).notes if "is behind beyond" in n)
    assert changed != note
    assert f"{chosen.title}: " in changed
    assert f"vmf {shown(summary['methods']['vmf'][chosen.key], chosen)}" in changed
