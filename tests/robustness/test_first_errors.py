"""What a newcomer types wrong: one line that says what to do, exit code 2, nothing left behind."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from eagor.cli import main
from eagor.lab.worlds.painted import painted_room


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with two frames and their poses, which is where the command runs."""
    monkeypatch.chdir(tmp_path)
    for name in "ab":
        Image.fromarray(painted_room(24, 48)).save(tmp_path / f"{name}.png")
    (tmp_path / "poses.csv").write_text("stamp,yaw_deg,pitch_deg,roll_deg\n0,0,0,0\n1,10,0,0\n")
    (tmp_path / "bad.json").write_text("[" * 3000)
    (tmp_path / "torn.glb").write_bytes(b"glTF\x02\0\0\0")
    (tmp_path / "folder").mkdir()
    (tmp_path / "x.png").mkdir()
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "torn").mkdir()
    (tmp_path / "torn" / "run.json").write_text('{"kind": "benchmark", "task": "osr"}')
    return tmp_path


TRACK = ("track", "a.png", "b.png")
LOCATE = ("locate", "a.png", "red")
TRACKING = ("bench", "run", "tracking", "--perception", "truth", "--out", "run")
WAYPOINT = ("bench", "run", "waypoint", "--perception", "truth", "--out", "run")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("locate", "folder", "red"), "is a folder"),
        (("locate", "nowhere.png", "red"), "no file"),
        (("locate", "a.png", "chair", "--perception", "colour"), "names no colour"),
        (("locate", "a.png", "  "), "no words"),
        (
            (*LOCATE, "--perception", "clairvoyance"),
            "known are coco, colour, endpoint, onnx, replay, scout, truth, folders",
        ),
        ((*LOCATE, "--perception", "replay"), "replay:FILE.jsonl"),
        ((*LOCATE, "--perception", "replay:nowhere.jsonl"), "cannot be read"),
        ((*LOCATE, "--degree", "0"), "--degree 0; wanted 1 to 63"),
        ((*LOCATE, "--modes", "0"), "1 or more"),
        ((*LOCATE, "--picture", "where.txt"), ".png"),
        ((*LOCATE, "--picture", "/dev/null/where.png"), "cannot be written"),
        ((*LOCATE, "--out", "a.txt"), "ends in .csv or .jsonl"),
        ((*LOCATE, "--out", "no/a.csv"), "there is no folder"),
        ((*LOCATE, "--out", "a.png"), "is an input"),
        ((*LOCATE, "--out", "folder.csv"), "cannot be written"),
        *(((*LOCATE, "--floor", floor), "wanted a floor below it, such as -1.3") for floor in ("1.3", "0")),
        *(((*LOCATE, "--floor", floor), "wanted a height in metres") for floor in ("nan", "-inf")),
        (("track", "folder", "red", "--poses", "poses.csv"), "no images"),
        (("track", "red", "--poses", "poses.csv"), "wanted FRAMES"),
        ((*TRACK, "red", "--poses", "poses.csv", "--out", "x.txt"), ".csv or .jsonl"),
        ((*TRACKING, "--set", "steps=0"), "rules.steps = '0': Expected `int` >= 1"),
        ((*TRACKING, "--set", "steps=0", "--set=turn=90", "--seed", "1"), "--set comes twice"),
        ((*TRACKING, "--set", "steps=4", "steps=5"), "two values of steps; leave one of them out"),
        ((*TRACKING, "--set", "speed=0.5", "step=nan"), "camera.step = 'nan': Expected `float` > 0"),
        ((*TRACKING, "--set", "latency=-1"), "disturbances.latency = '-1': Expected `int` >= 0"),
        (("locate", "a.png", "red", "--stamp", "nan"), "a finite number"),
        (("locate", "a.png", "red", "--picture", "x.png"), "--picture x.png cannot be written"),
        (("locate", "a.png", "red", "--picture", "folder/../a.png"), "a.png is an input"),
        ((*TRACK, "red", "--poses", "poses.csv", "--out", "poses.csv"), "--out poses.csv is an input"),
        (("track", "folder", "red", "--poses", "poses.csv", "--pictures", "folder"), "--pictures folder is an input"),
        (("locate", "a.png", "red", "--calibration", "bad.json"), "bad.json cannot be read"),
        (("locate", "a.png", "red", "--calibration", "folder"), "folder cannot be read"),
        ((*TRACK, "chair", "--poses", "poses.csv", "--out", "new.csv", "--perception", "colour"), "names no colour"),
        ((*TRACK, "red", "--poses", "poses.csv", "--floor", "nan"), "--floor nan"),
        ((*TRACK, "red", "--poses", "poses.csv", "--out", "nowhere/new.csv"), "no folder"),
        ((*TRACK, "red", "--poses", "folder"), "folder cannot be read"),
        ((*TRACK, "red", "--poses", "levle"), "there is no file levle; --poses takes auto, level, still or a CSV file"),
        ((*TRACK, "red", "--poses", "poses.csv", "--pictures", "bad.json"), "--pictures bad.json cannot be written"),
        (("track", "a.png", f"{'b' * 300}.png", "red", "--poses", "poses.csv"), "there is no file bbb"),
        (("track", "folder", "red", "chair"), 'a query of several words in quotes: "red chair"'),
        (("demo", "--out", "a.png"), "--out a.png cannot be written"),
        (("demo", "--out", "new", "--perception", "nonsense"), "no perception 'nonsense'"),
        (("demo", "--seed", "-1"), "0 to 9999"),
        ((*WAYPOINT, "--workers", "0"), "--workers 0"),
        ((*WAYPOINT, "--episodes", "-1"), "1 or more"),
        ((*WAYPOINT, "--rows", "0"), "--rows 0"),
        ((*WAYPOINT, "--methods", "nonsense"), "no method 'nonsense'"),
        ((*WAYPOINT, "--world", "nowhere.glb"), "nowhere.glb cannot be read"),
        ((*WAYPOINT, "--world", "torn.glb"), "torn.glb"),
        (("bench", "failures", "folder", "--limit", "-1"), "--limit -1"),
        (("bench", "report", "folder"), "no run.json"),
        (("bench", "report", "torn"), "run.json does not name its data"),
        (("bench", "run", "hstar-hos", "--data", "folder", "--agent", "random", "--seed", "-1"), "seed = -1"),
        (("bench", "info", "folder"), "as hstar-hos, hstar-hps: "),
        (("calibrate", "--perception", "truth", "--rows", "-4"), "--rows -4"),
        (("calibrate", "--perception", "truth", "--episodes", "4"), "wanted 5 or more"),
        (("calibrate", "--perception", "truth", "--take", "4"), "--take is for eagor calibrate heads"),
        (
            ("calibrate", "heads", "--perception", "folder", "--trials", "9"),
            "--trials is for eagor calibrate responses",
        ),
        (("calibrate", "--perception", "truth", "--out", "folder"), "--out folder"),
        (("calibrate", "--perception", "truth", "--out", "a.png/x.json"), "cannot be written"),
        (("calibrate", "--perception", "truth", "--seed", "-1"), "between 0 and 1999"),
    ],
)
def test_one_line_and_nothing_left_behind(place, capsys, words, says):
    before = sorted(place.rglob("*"))
    for more in ((), ("--json",)):
        assert main([*words, *more]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert "Traceback" not in said.err
        (line,) = said.err.splitlines()
        assert line.startswith("eagor: error: ")
        assert says in line
    assert sorted(place.rglob("*")) == before


def test_a_folder_that_may_not_be_read_is_refused_as_input(place, capsys, monkeypatch):
    def closed(self):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "iterdir", closed)
    assert main(["track", "folder", "red", "--poses", "poses.csv"]) == 2
    assert "folder cannot be read (Permission denied)" in capsys.readouterr().err


def test_a_table_that_is_there_is_not_lost_to_a_query_that_means_nothing(place, capsys):
    (place / "old.csv").write_text("yesterday's")
    assert main([*TRACK, "chair", "--poses", "poses.csv", "--out", "old.csv", "--perception", "colour"]) == 2
    assert (place / "old.csv").read_text() == "yesterday's"


def test_words_that_are_no_text_are_printed_as_json_escapes_them(place):
    words = [sys.executable, "-m", "eagor", "locate", b"a.png", b"red \xff", "--json"]
    environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}
    done = subprocess.run(words, capture_output=True, timeout=300, env=environment)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["query"] == "red \udcff"
