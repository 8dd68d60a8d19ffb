"""The examples run, and what they print is true."""

import io
import json
import math
import re
import runpy
import sys
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
FILES = sorted(EXAMPLES.glob("[0-9]*.py"))
NUMBER = r"-?\d+(?:\.\d+)?"


@pytest.fixture
def printed(tmp_path, monkeypatch):
    """What an example prints, line by line, run where there is nothing else, with warnings as errors."""

    def run(name, *words):
        (file,) = EXAMPLES.glob(f"{name}*.py")
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
        monkeypatch.setattr(sys, "argv", [str(file), *words])
        with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
            runpy.run_path(str(file), run_name="__main__")
        assert err.getvalue() == ""
        return out.getvalue().splitlines()

    return run


def numbers(line, *before):
    """The numbers in `line` that stand right before each of these words."""
    return [float(re.search(rf"({NUMBER}){re.escape(word)}", line).group(1)) for word in before]


def test_they_are_numbered_short_and_say_what_is_learnt():
    assert [int(file.name[:2]) for file in FILES] == list(range(1, 10))
    listed = (EXAMPLES / "README.md").read_text()
    for file in FILES:
        text = file.read_text()
        most = 87 if "train" in file.name else 60  # it brings a wrapper of its own
        assert len(text.splitlines()) < most, file.name
        assert "What is learnt:" in text.split('"""')[1], file.name
        assert not re.search(r"(import|\.|\s)_[a-z]", text), f"{file.name} uses what is private"
        assert f"]({file.name})" in listed


def test_a_belief_turns_with_the_camera_and_grows_surer(printed):
    first, turned, later = (numbers(line, " deg left", " deg off", " deg\n") for line in _ended(printed("01")))
    assert (first[0], turned[0], later[0]) == pytest.approx((90.0, 60.0, 60.0), abs=0.15)
    assert max(first[1], turned[1], later[1]) <= 0.5
    assert turned[2] == first[2] > 1.5 * later[2], "turning changes nothing about how sure it is; looks do"


def test_a_detector_feeds_a_tracker_through_a_file(printed):
    record, *lines = printed("02")
    assert '"label": "red ball"' in record
    azimuths = [numbers(line, " deg, ", " deg off") for line in lines]
    assert len(azimuths) == 6
    assert all(off < 1.0 for _, off in azimuths)
    assert all(19 < a[0] - b[0] < 21 for a, b in pairwise(azimuths)), "20 degrees per look"
    assert all(line.endswith("tracking") for line in lines[1:]), "one look may be a look-alike"


def test_late_evidence_counts_for_when_it_was_captured(printed):
    lines = printed("03")
    assert len(lines) == 4
    for line in lines:
        right, wrong = (float(value) for value in re.findall(rf"({NUMBER}) deg off", line))
        assert right < 0.5
        assert wrong == pytest.approx(60, abs=1), "40 degrees per second for 1.5 seconds"


def test_walking_past_tells_the_distance(printed):
    off, distance, spread, true = np.transpose(
        [numbers(line, " deg off", " m away", " %", " m)") for line in printed("04")]
    )
    assert (off < 3).all()
    assert (np.diff(spread) <= 0).all()
    assert (np.abs(distance - true) / true < spread / 100).all()
    assert abs(distance[-1] - true[-1]) < 0.2


def test_several_targets_are_followed_and_a_missing_one_is_searched_for(printed):
    *there, missing = printed("05")
    assert [line.split()[0] for line in there] == ["red", "blue", "yellow", "green"]
    for line in there:
        off, distance, true = numbers(line, " deg off", " m away", " m)")
        assert line.split()[2] == "tracking"
        assert off < 5
        assert abs(distance - true) / true < 0.35
    assert missing.startswith("purple ball  searching")
    assert numbers(missing, " %")[0] < 20


def test_the_checker_finds_what_a_perception_forgets(printed):
    fails, passes, found = printed("06")
    assert re.match("Forgetful fails: .*stamp=12.5", fails)
    assert passes == "Darkest passes"
    assert numbers(found, " deg off")[0] < 2


@pytest.mark.slow  # runs and reports are tried by their commands, too
def test_a_benchmark_runs_goes_on_and_is_reported(printed):
    lines = printed("07")
    assert lines[0].startswith("3 episodes played; the second time 0, since 3 are recorded")
    said = next(line for line in lines if line.startswith("mean error of eagor"))
    ours, pixel = (float(value) for value in re.findall(rf"({NUMBER}) deg", said))
    assert ours < 30 < pixel
    assert Path(lines[-1].removeprefix("the report: ")).is_file()


@pytest.mark.slow
def test_a_policy_is_trained_and_measured_against_random_actions(printed):
    pytest.importorskip("stable_baselines3")
    trained, random, _ = printed("08", "--steps", "1024", "--apartments", "2")
    for line in (trained, random):
        share, low, high = (float(value) for value in re.findall(NUMBER, line))
        assert 0 <= low <= share <= high <= 100


def _ended(lines):
    return [f"{line}\n" for line in lines]


def test_the_notebook_runs_as_written_and_finds_the_ball(tmp_path, monkeypatch):
    pytest.importorskip("av")
    pytest.importorskip("cv2")
    notebook = json.loads((EXAMPLES / "footage.ipynb").read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in cells)
    monkeypatch.chdir(tmp_path)
    space = {}
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        for cell in cells:
            exec("".join(cell["source"]), space)
    assert err.getvalue() == ""
    azimuth = numbers(out.getvalue(), ", elevation ")[0]
    assert azimuth == pytest.approx(-math.degrees(0.4 * 2.5) - 23.5, abs=5), (
        "the ball is 23.5 degrees to the right at first"
    )
    assert (tmp_path / "out.mp4").stat().st_size > 10_000
