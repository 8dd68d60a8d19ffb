"""Fitting by log score: it finds what it should, judges on apartments that it has not seen, and its file is checked."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eagor.calibration import Calibration
from eagor.errors import EagorError
from eagor.estimate import TrackerConfig
from eagor.evaluation.calibration import PARAMETERS, Recorder, development_slots, score
from eagor.evaluation.fitting import fit
from eagor.evidence import Evidence
from eagor.grids import PatchGrid
from eagor.perception.calibrated import Calibrated, from_json, read_calibrated
from eagor.sphere import direction, world_R_body
from eagor.tasks.episodes import Episode, Slot
from eagor.tasks.play import Moment, Recording

GRID = PatchGrid(16, 32)
SMALL = TrackerConfig(degree=7, ranges=None)


def recording(seed, steps=16, right=0.6):
    """A standing camera and a detector that points at the target with probability `right`, else anywhere."""
    rng = np.random.default_rng(seed)
    target = direction(rng.uniform(-3, 3), rng.uniform(-0.4, 0.2))
    moments = []
    for k in range(steps):
        seen = target if rng.random() < right else direction(rng.uniform(-3, 3), rng.uniform(-0.5, 0.5))
        other = direction(rng.uniform(-3, 3), 0.0)
        looks = [
            np.exp(30 * (GRID.directions @ at - 1)) * high for at, high in ((seen, 0.8), (other, 0.8 * rng.random()))
        ]
        evidence = [Evidence.from_response(look.astype(np.float32), GRID, stamp=0.5 * k) for look in looks]
        moments.append(Moment(0.5 * k, world_R_body(0.1 * k), np.zeros(3), *evidence))
    directions = np.array([moment.world_R_body.T @ target for moment in moments])
    truth = {"present": [True] * steps, "visible": [True] * steps}
    episode = Episode(Slot("waypoint", "none", seed, 0, 0), "none", "", "chair", (0,), (0.0, 0.0), 0.0, 1.0)
    return Recording(episode, truth, tuple(moments), directions, np.zeros((0, 3, 3)), np.zeros((0, 3)))


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda parameter: parameter.name)
@given(place=st.floats(0, 1))
def test_every_parameter_has_its_place(parameter, place):
    assert parameter.place(parameter.value(place)) == pytest.approx(place, abs=1e-9)
    default = {**vars(TrackerConfig()), **vars(Calibration())}[parameter.name]
    assert parameter.value(parameter.place(default)) == pytest.approx(default, abs=1e-9), (
        "the search starts at the default"
    )


def test_honest_beliefs_score_best():
    """A detector that is wrong in two frames of five must not be believed as if it were never wrong."""
    recordings = [recording(seed) for seed in range(6)]

    def total(temperature):
        config = TrackerConfig(degree=7, ranges=None, calibration=Calibration(0.05, 0.05, temperature))
        return np.mean([score(one, config).total for one in recordings])

    assert total(0.8) > total(8.0)
    assert total(0.8) > total(0.02)


def test_the_fit_is_better_on_apartments_that_it_has_not_seen(monkeypatch):
    monkeypatch.setattr("eagor.evaluation.fitting.BASE", SMALL)
    rounds, trials = [], []
    best = fit("a detector", [recording(s) for s in range(8)], 48, 1, lambda: trials.append(1), rounds.append)
    assert len(trials) == 48
    assert len(rounds) == 3
    before, after = best.found_by["before"], best.found_by["after"]
    assert after["log score"][0] > before["log score"][0]
    assert best.found_by["judged by"] == [1, 3, 5, 7]
    assert best.config().calibration == best.calibration


def test_one_apartment_cannot_judge_itself():
    with pytest.raises(EagorError, match="at least two"):
        fit("a detector", [recording(3), recording(3)], 4)


def test_episodes_alternate_and_stay_among_the_development_seeds():
    slots = development_slots(10, 100)
    assert [slot.task for slot in slots[:4]] == ["waypoint", "tracking"] * 2
    assert sorted({slot.seed for slot in slots}) == [100, 101, 102]
    assert len({(slot.task, slot.id) for slot in slots}) == 10
    for count, seed in ((4, 2000), (40, 1995)):
        with pytest.raises(EagorError, match="results"):
            development_slots(count, seed)


def test_a_recording_asks_for_what_is_there_and_for_what_is_not():
    found = Recorder("truth:ideal").record(development_slots(1, 100)[0])
    peaks = np.array([[np.max(m.evidence.response), np.max(m.other.response)] for m in found.moments])
    seen = np.array(found.truth["visible"])
    assert peaks[seen, 0].mean() > 0.9
    assert peaks[:, 1].max() == 0


def test_what_is_written_is_read_again(tmp_path):
    made = Calibrated("scout", Calibration(0.1, 0.02, 1.5), {"keep_per_second": 0.95, "wander": 0.1}, {"trials": 3})
    made.write(tmp_path / "new" / "file.json")
    found = read_calibrated(tmp_path / "new" / "file.json")
    assert found == made
    config = found.config(TrackerConfig(degree=7))
    assert (config.degree, config.keep_per_second, config.calibration) == (7, 0.95, made.calibration)


READING = {"floor": 0.1, "neutral": 0.1, "temperature": 1, "persistence": 0.5, "spread": 0.1}
GOOD = {"perception": "scout", "calibration": READING, "forgetting": {}}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"calibration": {"floor": 0.1}}, "no calibration"),
        ({"calibration": READING | {"floor": -1}}, "floor"),
        ({"calibration": READING | {"floor": "much"}}, "no calibration"),
        ({"forgetting": {"keep": 0.9}}, "keep_per_second"),
        ({"forgetting": {"keep_per_second": 7}}, "keep_per_second"),
        ({"forgetting": None}, "no calibration"),
    ],
)
def test_files_that_are_no_calibration_are_refused(changes, says):
    assert from_json(GOOD, "it").calibration.floor == 0.1
    with pytest.raises(EagorError, match=says):
        from_json(GOOD | changes, "it")


def test_files_that_cannot_be_read_are_told(tmp_path):
    with pytest.raises(EagorError, match="eagor calibrate"):
        read_calibrated(tmp_path / "none.json")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(EagorError, match="no JSON"):
        read_calibrated(tmp_path / "bad.json")
    (tmp_path / "list.json").write_text(json.dumps([1]))
    with pytest.raises(EagorError, match="no calibration"):
        read_calibrated(tmp_path / "list.json")
