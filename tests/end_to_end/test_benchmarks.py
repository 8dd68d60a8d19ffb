"""Benchmarks with published data from the command line: runs that stop and go on, shards, scores, reports."""

import json
from functools import partial

import commands
import hstar_data
import pytest

from eagor.lab.eval import log

bench, answer, refused = (partial(run, "bench") for run in (commands.eagor, commands.answer, commands.refused))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return hstar_data.write(tmp_path_factory.mktemp("hstar"))


@pytest.fixture(scope="module")
def runs(folder, tmp_path_factory):
    """One run of the oracle and one of ours, for everything that only reads."""
    place = tmp_path_factory.mktemp("runs")
    oracle = answer("run", "hstar-hos", "--data", folder, "--agent", "oracle", "--out", place / "oracle")
    ours = answer("run", "hstar-hos", "--data", folder, "--perception", "truth:miss=0.5", "--out", place / "ours")
    return place, oracle, ours


def test_the_summary_of_a_run(runs):
    _, oracle, ours = runs
    assert (oracle["task"], oracle["agent"], oracle["episodes"], oracle["failed"]) == ("hstar-hos", "oracle", 16, 0)
    assert [oracle[key] for key in ("overall", "easy", "medium", "hard", "official", "strict")] == [100.0] * 6
    assert (ours["agent"], ours["perception"], ours["groups"]) == ("eagor", "truth:miss=0.5", 4)
    low, high = ours["intervals"]["eagor · truth:miss=0.5"]["overall"]
    assert low < ours["overall"] < high or ours["overall"] == high
    assert len(ours["by_turn"]["success"]) == 10
    assert ours["by_turn"]["success"][-1] == pytest.approx(ours["overall"])


def test_errors_are_told_apart_from_failures(folder, tmp_path):
    told = ("run", "hstar-hos", "--data", folder, "--agent", "vlm", "--limit", 2, "--set", "resolution=36")
    good = answer(
        *told, "--model", "hstar_data:patient", "--out", tmp_path / "good", "--engine", "threads", "--workers", 2
    )
    assert (good["episodes"], good["failed"], good["views"]) == (2, 0, 3.0)
    done = bench(*told, "--model", "hstar_data:lost", "--out", tmp_path / "lost", "--json")
    assert done.returncode == 1
    assert "nobody answers" in done.stderr
    lost = json.loads(done.stdout)
    assert (lost["episodes"], lost["failed"], lost["overall"]) == (0, 2, None)
    assert {failure["attempt"] for failure in lost["failures"]} == {2}


def test_scores_by_other_rules_and_of_predictions(folder, runs, tmp_path):
    place, _, ours = runs
    strict = answer("score", place / "ours", "--set", "scoring=strict")
    assert strict["overall"] == ours["strict"]
    lines = [{"case": r["case"], **r["answer"]} for r in log.read(place / "oracle")]
    file = tmp_path / "pred.jsonl"
    file.write_text("\n".join(map(json.dumps, lines[:10])))
    found = answer("score", file, "--task", "hstar-hos", "--data", folder, "--out", tmp_path / "kept", code=3)
    assert (found["episodes"], found["missing"], found["overall"]) == (10, 6, 100.0)
    assert len(log.read(tmp_path / "kept")) == 10
    again = answer("score", file, "--task", "hstar-hos", "--data", folder, "--out", tmp_path / "kept", code=3)
    assert again == found
    file.write_text(json.dumps(lines[0] | {"yaw": 0, "pitch": 90}))
    said = refused("score", file, "--task", "hstar-hos", "--data", folder, "--out", tmp_path / "kept")
    assert f"another result for {lines[0]['case']}" in said
    file.write_text('{"doc_id": 0, "text": "<answer>submit(1,2)</answer>"}\n{"doc_id": 1, "text": "?"}\n')
    found = answer("score", file, "--task", "hstar-hos", "--data", folder, code=3)
    assert (found["episodes"], found["causes"].get("format")) == (2, 1)
    file.write_text('{"case": "nowhere/0/0", "yaw": 1}\n')
    assert "line 1" in refused("score", file, "--task", "hstar-hos", "--data", folder)


def test_the_predictions_of_a_report_score_as_its_run_does(folder, runs, tmp_path):
    place, _, ours = runs
    bench("report", place / "ours", "--out", tmp_path)
    found = answer("score", tmp_path / "predictions.jsonl", "--task", "hstar-hos", "--data", folder)
    assert {key: found[key] for key in ("overall", "official", "strict")} == {
        key: ours[key] for key in ("overall", "official", "strict")
    }


def test_reports_comparisons_and_failures(runs, tmp_path):
    place, _, ours = runs
    assert answer("report", place / "ours", place / "oracle", "--out", tmp_path)["report"].endswith("report.html")
    page = (tmp_path / "report.html").read_text()
    for part in (
        "Success by turn",
        "calibration error",
        "Why cases failed",
        "Qwen2.5-VL-7B + EAGOR, published",
        "oracle",
    ):
        assert part in page
    assert "http" not in page.replace("http://www.w3.org", "")
    assert f"{ours['overall']:.2f}" in (tmp_path / "tables.md").read_text()
    assert not (tmp_path / "predictions.jsonl").exists(), "of which of the two?"
    found = answer("compare", place / "oracle", place / "ours")
    overall = found["figures"]["overall"]
    assert overall["difference"] == pytest.approx(100 - ours["overall"])
    failed = answer("failures", place / "ours")
    assert sum(failed["causes"].values()) == round(16 * (1 - ours["overall"] / 100))
    off = [case["error"] for case in failed["cases"]]
    assert off == sorted(off, reverse=True), "the worst come first"
    assert "No case failed" in bench("failures", place / "oracle").stdout
    for words in (("compare", place / "ours", place / "ours", "--methods"), ("failures", place / "ours", "--method")):
        assert "has one agent" in refused(*words, "eagor")
    assert "tables.md is in the way" in refused("report", place / "ours", "--out", tmp_path / "tables.md")


def test_the_list_and_what_a_folder_holds(folder, tmp_path):
    found = answer("list")
    assert {"waypoint", "hstar-hos", "hstar-hps"} <= found.keys()
    assert "oracle" in found["hstar-hos"]["agents"]
    (told,) = answer("info", folder).values()
    assert answer("info", "hstar-hos", "--data", folder)["hstar-hos"] == told  # as docs/benchmarks.md has it
    assert (told["scenes"], told["targets"], told["episodes"]) == (2, 4, {"hos": 16, "hps": 0})
    assert "holds the data of no known task" in refused("info", tmp_path)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("run", "chess"), "hstar-hos"),
        (("run", "hstar-hos"), "--data"),
        (("run", "navigation", "--data", "somewhere"), "--data is no option of navigation"),
        (
            ("run", "hstar-hos", "--data", "x", "--agent", "oracle", "--episodes", "2"),
            "--episodes is no option of hstar-hos",
        ),
        (("run", "hstar-hos", "--data", "x", "--agent", "oracle", "--shard", "2"), "I/N"),
    ],
)
def test_usage_errors_say_what_to_do(words, said):
    assert said in refused(*words)


# --- a part of a run is called one, and how it goes on is said ---


@pytest.fixture
def part(folder, tmp_path):
    """The words of a run of which three cases are done."""
    words = ("run", "hstar-hos", "--data", folder, "--perception", "truth", "--out", tmp_path / "run")
    answer(*words, "--limit", "3")
    return words, tmp_path / "run"


def test_a_report_of_a_part_of_a_run_says_so(part):
    words, out = part
    said = bench("report", out)
    told = " ".join(said.stderr.split())
    assert f"{out} has 3 of 16 records; the figures are about these" in told
    assert "without --limit and --shard, plays the rest" in told
    assert "3 of 16 cases" in (out / "report.html").read_text()
    assert "Records: 3 of 16 with results, 0 could not be run" in (out / "tables.md").read_text()
    assert answer("report", out)["runs"] == [{"folder": str(out), "records": 3, "planned": 16}]
    answer(*words)
    assert bench("report", out).stderr == ""


def test_an_interrupted_run_says_how_it_goes_on(part, monkeypatch):
    words, out = part

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("eagor.lab.eval.runner.run", interrupted)
    done = bench(*words)
    assert done.returncode == 130
    said = " ".join(done.stderr.split())
    assert f"3 of 16 units are in {out}; the same command goes on from there" in said
    assert said.endswith("eagor: interrupted")
