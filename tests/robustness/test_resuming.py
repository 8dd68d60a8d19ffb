"""Promised: a run goes on where it stopped, with the settings that it began with."""

import json

import hstar_data
import pytest

from eagor.cli import main
from eagor.lab.eval import log


@pytest.fixture
def run(tmp_path):
    data, out = hstar_data.write(tmp_path / "data"), tmp_path / "run"
    words = ["bench", "run", "hstar-hos", "--data", str(data), "--perception", "truth", "--out", str(out), "--json"]
    assert main([*words, "--limit", "3"]) == 0
    return words, data, out


def test_changed_data_and_code_are_told_by_the_header_and_stop_nobody(run, capsys, monkeypatch):
    words, data, out = run
    first = log.description(out)
    assert first["samples"]["count"] == 3
    monkeypatch.setattr(log, "commit", lambda: "another")
    annotation = next(data.rglob("annotation.json"))
    annotation.write_text(annotation.read_text() + "\n\n")
    assert main(words) == 0
    assert log.description(out) == first
    assert len(log.read(out)) == 16


def test_other_settings_are_refused(run, capsys):
    words, *_ = run
    assert main([*words, "--set", "sure=0.7"]) == 2
    assert "it differs in sure (" in " ".join(capsys.readouterr().err.split())


def test_a_run_can_get_more_episodes(tmp_path, capsys):
    out = tmp_path / "run"
    words = ["bench", "run", "tracking", "--perception", "truth", "--methods", "centroid", "--set", "steps=4"]
    words += ["--out", str(out), "--json", "--episodes"]
    assert main([*words, "1"]) == 0
    (first,) = log.read(out)
    assert main([*words, "3"]) == 0
    assert log.description(out)["episodes"] == 3
    assert len(log.read(out)) == 3
    assert first in log.read(out)
    capsys.readouterr()
    assert main([*words, "4", "--seed", "7"]) == 2
    assert "it differs in seed (" in " ".join(capsys.readouterr().err.split())
    assert log.description(out)["episodes"] == 3


def test_a_report_of_a_part_of_a_run_says_so(run, capsys):
    words, _, out = run
    capsys.readouterr()
    assert main(["bench", "report", str(out), "--json"]) == 0
    said = capsys.readouterr()
    assert f"{out} has 3 of 16 records; the figures are about these" in " ".join(said.err.split())
    assert json.loads(said.out)["runs"] == [{"folder": str(out), "records": 3, "planned": 16}]
    assert main(words) == 0
    capsys.readouterr()
    assert main(["bench", "report", str(out)]) == 0
    assert capsys.readouterr().err == ""


def test_an_interrupted_run_says_how_it_goes_on(run, capsys, monkeypatch):
    words, _, out = run

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("eagor.lab.eval.runner.run", interrupted)
    capsys.readouterr()
    assert main(words) == 130
    said = " ".join(capsys.readouterr().err.split())
    assert f"3 of 16 units are in {out}; the same command goes on from there" in said
    assert said.endswith("eagor: interrupted")
