"""Comparisons, worst episodes of runs of any task, from the command line."""

from dataclasses import replace
from functools import partial

import commands
import pytest
import synthetic_runs

from eagor.lab.envs.episodes import episode_specs
from eagor.lab.eval import log
from eagor.lab.eval.episodes import runner_of
from eagor.lab.eval.results import read
from eagor.lab.tasks import task
from eagor.lab.tasks.sim.tracking import TRACKING

OURS_ALONE = replace(TRACKING, name="mine", title="Mine")  # as a package would bring it
RULES = {
    "navigation": ("--episodes", 2, "--set", "max_steps=12"),
    "mine": ("--episodes", 2, "--set", "steps=8"),
}


bench, answer, refused = (partial(run, "bench") for run in (commands.eagor, commands.answer, commands.refused))


@pytest.fixture(scope="module", params=RULES)
def played(request, tmp_path_factory):
    """A tiny run by two methods: of a task in which each goes its own way, and of one in which all go the same."""
    out = tmp_path_factory.mktemp(request.param) / "run"
    words = ("--perception", "truth", "--seed", 3, "--methods", "vmf,eagor", *RULES[request.param])
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(task.BUILT_IN, "mine", f"{__name__}:OURS_ALONE")
        assert bench("run", request.param, *words, "--out", out).returncode == 0
        yield out


@pytest.fixture(scope="module")
def made_up(tmp_path_factory):
    """Two runs of one task, the second of fewer apartments, and one of another task."""
    home = tmp_path_factory.mktemp("made up")
    synthetic_runs.write_run(home / "a", synthetic_runs.waypoint(seed=0, apartments=6, methods=("vmf", "eagor")))
    synthetic_runs.write_run(home / "b", synthetic_runs.waypoint(seed=1, apartments=5), perception="scout")
    synthetic_runs.write_run(home / "other", synthetic_runs.tracking(apartments=2))
    return home


def test_two_runs_are_compared_on_the_episodes_that_both_have(made_up):
    found = answer("compare", made_up / "a", made_up / "b")
    assert (found["methods"], found["cases"]) == (["eagor", "eagor"], 15)
    assert (found["only_in_a"], found["only_in_b"]) == (3, 0)
    assert found["settings"]["perception"] == ["oracle", "scout"]
    both = [{r["episode"]["id"]: r for r in log.read(made_up / name)} for name in "ab"]
    gaps = [
        both[0][name]["methods"]["eagor"]["metrics"]["L4"] - record["methods"]["eagor"]["metrics"]["L4"]
        for name, record in both[1].items()
    ]
    figure = found["figures"]["L4"]
    assert figure["difference"] == pytest.approx(figure["a"] - figure["b"]) == pytest.approx(sum(gaps) / len(gaps))
    assert figure["low"] <= figure["difference"] <= figure["high"]
    text = bench("compare", made_up / "a", made_up / "b", "--methods", "vmf,eagor").stdout
    assert "method: a vmf, b eagor" in text
    assert "L4 ↓, ° (15)" in text
    assert "Only 5 apartments" in text


def test_what_cannot_be_compared_is_refused(made_up, tmp_path):
    a = made_up / "a"
    assert "name a second run" in refused("compare", a)
    assert "differ in task" in refused("compare", a, made_up / "other")
    assert "no method 'grid'; it has vmf, eagor" in refused("compare", a, made_up / "b", "--methods", "grid")
    assert "wanted one, or two" in refused("compare", a, made_up / "b", "--methods", "vmf,grid,eagor")
    elsewhere = synthetic_runs.waypoint(apartments=2, methods=("vmf", "grid"))
    assert "no eagor in common" in refused(
        "compare", synthetic_runs.write_run(tmp_path / "two", elsewhere), tmp_path / "two"
    )
    for record in elsewhere:
        record["episode"]["scene_hash"] = "of another version"
    synthetic_runs.write_run(tmp_path / "new", elsewhere)
    assert "another episode in each run" in refused("compare", tmp_path / "new", a, "--methods", "vmf")


def test_the_worst_episodes_come_first_and_can_be_played_again(played):
    found = answer("failures", played)
    assert (found["method"], found["episodes"], len(found["cases"])) == ("eagor", 2, 2)
    run = read(played)
    case = answer("failures", played, "--limit", 1, "--method", "vmf")["cases"][0]
    recorded = next(
        r["methods"]["vmf"]["metrics"]
        for r in run.records
        if r["episode"]["id"] == case["case"] and "vmf" in r["methods"]
    )
    runner, spec = runner_of(run, case["case"])
    again = runner.run_episode(spec, ["vmf"])
    assert again["episode"]["id"] == case["case"]
    assert again["methods"]["vmf"]["metrics"] == pytest.approx(recorded)
    lines = bench("failures", played, "--limit", 1).stdout.splitlines()
    assert lines[0].startswith(f"{found['cases'][0]['case']}  ")
    assert lines[-1] == "... and 1 more (--limit)"
    assert "no method 'grid'" in refused("failures", played, "--method", "grid")


def test_an_episode_is_played_again_with_the_number_that_it_had_in_its_run(tmp_path):
    """Tasks deal their scenarios by it, so an episode of a later apartment is another one with another number."""
    records = synthetic_runs.tracking(apartments=3, methods=("eagor",))
    for record in records:
        record["episode"] |= {"world": "apartment", "index": int(record["episode"]["id"].partition("-")[2])}
    run = read(synthetic_runs.write_run(tmp_path / "run", records, perception="truth", rules={}, disturbances={}))
    wanted = {spec.id: spec for spec in episode_specs("tracking", 15, 2000)}
    names = [record["episode"]["id"] for record in records]
    assert len(names) == 9
    assert all(runner_of(run, name)[1] == wanted[name] for name in names)
