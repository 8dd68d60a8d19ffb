"""Promised: a part of a run is called one, and how it goes on is said."""

import json

import hstar_data
import pytest

from eagor.cli import main


@pytest.fixture
def run(tmp_path):
    data, out = str(hstar_data.write(tmp_path / "data")), tmp_path / "run"
    words = ["bench", "run", "hstar-hos", "--data", data, "--perception", "truth", "--out", str(out), "--json"]
    assert main([*words, "--limit", "3"]) == 0
    return words, out


def test_a_report_of_a_part_of_a_run_says_so(run, capsys):
    words, out = run
    capsys.readouterr()
    assert main(["bench", "report", str(out), "--json"]) == 0
    said = capsys.readouterr()
    told = " ".join(said.err.split())
    assert f"{out} has 3 of 16 records; the figures are about these" in told
    assert "without --limit and --shard, plays the rest" in told
    assert "3 of 16 cases" in (out / "report.html").read_text()
    assert "Records: 3 of 16 with results, 0 could not be run" in (out / "tables.md").read_text()
    assert json.loads(said.out)["runs"] == [{"folder": str(out), "records": 3, "planned": 16}]
    assert main(words) == 0
    capsys.readouterr()
    assert main(["bench", "report", str(out)]) == 0
    assert capsys.readouterr().err == ""


def test_an_interrupted_run_says_how_it_goes_on(run, capsys, monkeypatch):
    words, out = run

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("eagor.lab.eval.runner.run", interrupted)
    capsys.readouterr()
    assert main(words) == 130
    said = " ".join(capsys.readouterr().err.split())
    assert f"3 of 16 units are in {out}; the same command goes on from there" in said
    assert said.endswith("eagor: interrupted")
