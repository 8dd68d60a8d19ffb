"""Promised: a part of a run is called one, and how it goes on is said."""

import hstar_data
import pytest
from commands import answer, eagor


@pytest.fixture
def run(tmp_path):
    data, out = hstar_data.write(tmp_path / "data"), tmp_path / "run"
    words = ("bench", "run", "hstar-hos", "--data", data, "--perception", "truth", "--out", out)
    answer(*words, "--limit", "3")
    return words, out


def test_a_report_of_a_part_of_a_run_says_so(run):
    words, out = run
    said = eagor("bench", "report", out)
    told = " ".join(said.stderr.split())
    assert f"{out} has 3 of 16 records; the figures are about these" in told
    assert "without --limit and --shard, plays the rest" in told
    assert "3 of 16 cases" in (out / "report.html").read_text()
    assert "Records: 3 of 16 with results, 0 could not be run" in (out / "tables.md").read_text()
    assert answer("bench", "report", out)["runs"] == [{"folder": str(out), "records": 3, "planned": 16}]
    answer(*words)
    assert eagor("bench", "report", out).stderr == ""


def test_an_interrupted_run_says_how_it_goes_on(run, monkeypatch):
    words, out = run

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("eagor.lab.eval.runner.run", interrupted)
    done = eagor(*words)
    assert done.returncode == 130
    said = " ".join(done.stderr.split())
    assert f"3 of 16 units are in {out}; the same command goes on from there" in said
    assert said.endswith("eagor: interrupted")
