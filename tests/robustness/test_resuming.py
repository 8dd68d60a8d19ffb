"""Promised: a run goes on only with what it began with (data, files, model, code), or, forced to, says so."""

import json
import shutil
from textwrap import dedent

import hstar_data
import numpy as np
import pytest
from PIL import Image
from processes import limited

from eagor.cli import main
from eagor.errors import EagorError
from eagor.evaluation import ledger, workers


@pytest.fixture
def run(tmp_path):
    data, out = hstar_data.write(tmp_path / "data"), tmp_path / "run"
    words = ["bench", "run", "hstar-hos", "--data", str(data), "--perception", "truth", "--out", str(out), "--json"]
    assert main([*words, "--limit", "3"]) == 0
    return words, data, out


def more(path):
    found = json.loads(path.read_text())
    path.write_text(json.dumps(found) + "\n\n")


def picture(path):
    Image.fromarray(np.zeros((8, 16, 3), np.uint8)).save(path)


CHANGES = {
    "annotations": lambda data: more(next(data.rglob("annotation.json"))),
    "sizes": lambda data: picture(next(data.rglob("*.png"))),
    "files": lambda data: picture(next(data.rglob("*.png")).with_name("new.png")),
}


@pytest.mark.parametrize("what", CHANGES)
def test_changed_data_is_refused_or_told(run, capsys, what):
    words, data, out = run
    CHANGES[what](data)
    before = (out / ledger.RUN).read_bytes()
    capsys.readouterr()
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert f"inputs.data.{what} is" in said.err
    assert "--force" in said.err
    assert (out / ledger.RUN).read_bytes() == before
    assert main([*words, "--force"]) == 0
    assert f"inputs.data.{what} is" in capsys.readouterr().err
    assert f"inputs.data.{what} is" in ledger.description(out)["resumed"][0]
    if what == "files":
        assert main(words) == 0  # it is now a run of these
        assert main(["bench", "report", str(out)]) == 0
        assert f"inputs.data.{what}" in (out / "tables.md").read_text()


def test_changed_code_is_refused(run, capsys, monkeypatch):
    words, _, out = run
    assert len(ledger.description(out)["inputs"]["code"]) == 16
    monkeypatch.setattr(workers, "_code", lambda: "other")
    capsys.readouterr()
    assert main(words) == 2
    assert 'inputs.code is "' in capsys.readouterr().err


def test_other_settings_are_refused_with_force_too(run, capsys):
    words, *_ = run
    assert main([*words, "--set", "sure=0.7", "--force"]) == 2
    assert "holds another run: sure is" in capsys.readouterr().err


def test_a_run_can_get_more_episodes_but_not_fewer(tmp_path, capsys):
    out = tmp_path / "run"
    words = ["bench", "run", "tracking", "--perception", "truth", "--methods", "centroid", "--set", "steps=4"]
    words += ["--out", str(out), "--json", "--episodes"]
    assert main([*words, "1"]) == 0
    (first,) = ledger.read(out)
    assert main([*words, "3"]) == 0
    assert ledger.description(out)["episodes"] == 3
    assert len(ledger.read(out)) == 3
    assert first in ledger.read(out)
    capsys.readouterr()
    assert main([*words, "2"]) == 2
    assert "episodes is 3 there and 2 was asked for (a run can get more, not fewer)" in capsys.readouterr().err
    assert main([*words, "4", "--seed", "7"]) == 2
    assert "holds another run: seed is 2000 there" in capsys.readouterr().err
    assert ledger.description(out)["episodes"] == 3


def test_what_a_run_began_with_stays_when_it_grows(tmp_path):
    begin, made = ledger.begin, {"code": "a"}
    begin(tmp_path, {"task": "x", "episodes": 4, "development": False}, made)
    begin(tmp_path, {"task": "x", "episodes": 6, "development": True}, made)
    assert ledger.description(tmp_path) == {"task": "x", "episodes": 6, "development": True, "inputs": made}
    for episodes in (6, 8):
        with pytest.raises(EagorError, match="made of something else"):
            begin(tmp_path, {"task": "x", "episodes": episodes, "development": True}, {"code": "b"})
    assert ledger.description(tmp_path)["episodes"] == 6
    with pytest.warns(UserWarning, match="goes on with changed inputs"):
        begin(tmp_path, {"task": "x", "episodes": 8, "development": True}, {"code": "b"}, force=True)
    begin(tmp_path, {"task": "x", "episodes": 9, "development": True}, {"code": "b"})
    found = ledger.description(tmp_path)
    assert (found["episodes"], found["inputs"], len(found["resumed"])) == (9, {"code": "b"}, 1)
    with pytest.raises(EagorError, match="development is true there"):
        begin(tmp_path, {"task": "x", "episodes": 9, "development": False}, {"code": "b"})


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

    monkeypatch.setattr("eagor.evaluation.workers.carry_out", interrupted)
    capsys.readouterr()
    assert main(words) == 130
    said = " ".join(capsys.readouterr().err.split())
    assert f"3 of 16 units are in {out}; the same command goes on from there" in said
    assert said.endswith("eagor: interrupted")


def test_what_does_not_belong_to_the_data_changes_nothing(run):
    words, data, out = run
    assert main([*words, "--limit", "4"]) == 0  # another part of the run is the same run
    shutil.copytree(out, data / "runs" / "mine")
    (data / ".hidden").write_text("x")
    assert main(words) == 0


def test_files_and_models_that_settings_name_are_inputs(tmp_path):
    told, model = tmp_path / "told.jsonl", tmp_path / "model"
    told.write_text("{}")
    model.mkdir()
    (model / "config.json").write_text("{}")
    settings = {"perception": f"replay:{told}", "model": f"{model}?pixels=3", "world": "apartment"}
    before = workers.inputs_of(settings)
    assert before.keys() == {"code", "perception", "model"}
    told.write_text("{ }")
    (model / "model.safetensors").write_bytes(b"weights")
    after = workers.inputs_of(settings)
    assert all(before[name] != after[name] for name in ("perception", "model"))
    assert before["code"] == after["code"]


def test_every_file_that_an_option_names_counts_whatever_its_name(tmp_path):
    model, heads = tmp_path / "run=3, step:7?" / "model", tmp_path / "heads.json"
    model.mkdir(parents=True)
    for path in (model / "config.json", heads):
        path.write_text("{}")
    settings = {"perception": f"{model}?heads={heads}&pixels=3&note={'long' * 100}"}
    for path in (model / "config.json", heads):
        before = workers.inputs_of(settings)["perception"]
        path.write_text("[]")
        assert workers.inputs_of(settings)["perception"] != before
    assert workers.inputs_of({"perception": "::?x=&&"}).keys() == {"code"}


def test_one_byte_of_a_models_weights_is_noticed(tmp_path):
    model = tmp_path / "model"
    (model / "templates").mkdir(parents=True)
    files = {"config.json": b"{}", "model.safetensors": bytes(3 << 20), "templates/chat.jinja": b"{{ a }}"}
    for name, content in files.items():
        (model / name).write_bytes(content)
    before = workers.inputs_of({"perception": str(model)})
    assert workers.inputs_of({"perception": str(model)}) == before
    for name, content in files.items():
        (model / name).write_bytes(content[:-1] + b"!")  # the size is the same
        assert workers.inputs_of({"perception": str(model)})["perception"] != before["perception"]
        (model / name).write_bytes(content)
    assert workers.inputs_of({"perception": str(model)}) == before


def test_weights_are_read_a_piece_at_a_time(tmp_path):
    code = """
        (folder / "config.json").write_text("{}")
        with (folder / "model.safetensors").open("wb") as file:
            file.truncate(300 << 20)
        print(len(inputs_of({"model": str(folder)})["model"]))
    """
    assert limited("from eagor.evaluation.workers import inputs_of\n", dedent(code), tmp_path, 100) == ["16"]
