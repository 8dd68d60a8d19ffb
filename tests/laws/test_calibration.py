"""Fitting by log score: it finds what it should, judges on apartments that it has not seen, and its file is checked."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eagor.errors import EagorError
from eagor.evaluation.calibration import (
    DETECTING,
    MOVING,
    READING,
    Recorder,
    counted,
    development_slots,
    motion_values,
    score,
    score_ratios,
)
from eagor.evaluation.fitting import LEARNT, fit
from eagor.evaluation.lasting import lasting
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import PatchGrid
from eagor.perception.calibrated import Calibrated, from_json, read_calibrated
from eagor.sphere import direction, unit, world_R_body
from eagor.tasks.episodes import Episode, Slot
from eagor.tasks.play import Moment, Recording
from eagor.tracking.config import TrackerConfig
from eagor.tracking.motion import MotionModel

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
    return episode_of(seed, moments, target)


def episode_of(seed, moments, target):
    steps = len(moments)
    directions = np.array([moment.world_R_body.T @ target for moment in moments])
    truth = {"present": [True] * steps, "visible": [True] * steps}
    episode = Episode(Slot("waypoint", "none", seed, 0, 0), "none", "", "chair", (0,), (0.0, 0.0), 0.0, 1.0)
    return Recording(episode, truth, tuple(moments), directions, np.zeros((0, 3, 3)), np.zeros((0, 3)))


def detecting(seed, steps=24, pd=0.7, alarms=0.5, spread=0.105):
    """A standing camera and a detector with these rates, whose scores tell right from false in part."""
    rng, of_other = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    target, moments = direction(rng.uniform(-3, 3), rng.uniform(-0.4, 0.2)), []

    def alarms_now(stream):
        count = stream.poisson(alarms)
        return list(unit(stream.normal(size=(count, 3)))), list(stream.beta(2, 4, count))

    for k in range(steps):
        turn = world_R_body(0.1 * k)
        (seen, scores), (others, other_scores) = alarms_now(rng), alarms_now(of_other)
        if rng.random() < pd:
            seen.append(unit(turn.T @ target + spread * rng.normal(size=3)))
            scores.append(rng.beta(4, 2))
        looks = ((seen, scores), (others, other_scores))
        evidence = [Evidence.from_points(np.array(at).reshape(-1, 3), None, s, stamp=0.5 * k) for at, s in looks]
        moments.append(Moment(0.5 * k, turn, np.zeros(3), *evidence))
    return episode_of(seed, moments, target)


DEFAULTS = {
    READING: vars(Calibration()),
    DETECTING: {**vars(DetectorModel()), "stated": LEARNT},
    MOVING: motion_values(MotionModel()),
}


@pytest.mark.parametrize("group", DEFAULTS, ids=["reading", "detecting", "moving"])
@given(place=st.floats(0, 1))
def test_every_parameter_has_its_place(group, place):
    for parameter in group:
        assert parameter.place(parameter.value(place)) == pytest.approx(place, abs=1e-9)
        default = DEFAULTS[group][parameter.name]
        assert parameter.value(parameter.place(default)) == pytest.approx(default, abs=1e-9), "where the search starts"


def test_honest_beliefs_score_best():
    """A detector that is wrong in two frames of five must not be believed as if it were never wrong."""
    recordings = [recording(seed) for seed in range(6)]

    def total(temperature):
        config = TrackerConfig(degree=7, ranges=None, calibration=Calibration(0.05, 0.05, temperature))
        return np.mean([score(one, config).total for one in recordings])

    assert total(0.8) > total(8.0)
    assert total(0.8) > total(0.02)


def fitted(found, base):
    return base.fitted(found.calibration, found.detector, found.forgetting)


def test_the_fit_is_better_on_apartments_that_it_has_not_seen(monkeypatch):
    monkeypatch.setattr("eagor.evaluation.fitting.BASE", SMALL)
    rounds, trials = [], []
    best = fit("a detector", [recording(s) for s in range(8)], 32, 1, lambda: trials.append(1), rounds.append)
    assert len(trials) == 32
    assert len(rounds) == 2
    before, after = best.found_by["before"], best.found_by["after"]
    assert after["log score"][0] > before["log score"][0]
    assert best.found_by["judged by"] == [1, 3, 5, 7]
    assert fitted(best, SMALL).calibration == best.calibration


def test_what_a_detector_does_is_counted():
    model = counted([detecting(seed, steps=60) for seed in range(6)])
    assert model.detection_probability == pytest.approx(0.7, abs=0.08)
    assert model.false_alarms_per_look == pytest.approx(0.5, abs=0.12)
    assert model.spread == pytest.approx(math.radians(6), rel=0.15)
    ratios = [ratio for _, ratio in model.score_ratios]
    assert ratios == sorted(ratios)
    assert ratios[0] < 0.6 < 1.6 < ratios[-1]
    assert counted([recording(0)]) is None, "response maps are not counted"


def lagged(rng, count, share, seconds, step):
    """Numbers of variance 1 whose correlation at lag t is share exp(-t / seconds)."""
    kept, slow = math.exp(-step / seconds), rng.normal(size=count)
    for k in range(1, count):
        slow[k] = kept * slow[k - 1] + math.sqrt(1 - kept**2) * slow[k]
    return math.sqrt(share) * slow + math.sqrt(1 - share) * rng.normal(size=count)


def mistaking(seed, share, seconds, steps=80, pd=0.7, spread=0.08, step=0.25):
    """A rolling camera and a detector that misses and errs with this share of mistakes that lasts for so long."""
    rng = np.random.default_rng(seed)
    offsets = spread * np.array([lagged(rng, steps, share, seconds, step) for _ in range(2)]).T
    target, moments, slow = direction(rng.uniform(-3, 3), rng.uniform(-0.4, 0.2)), [], rng.random() < pd
    left = unit(np.cross((0.0, 0.0, 1.0), target))
    for k in range(steps):
        slow = slow if rng.random() < math.exp(-step / seconds) else rng.random() < pd
        found = slow if rng.random() < math.sqrt(share) else rng.random() < pd
        turn = world_R_body(0.1 * k, 0.0, 0.2 * k)
        at = unit(target + offsets[k, 0] * left + offsets[k, 1] * np.cross(target, left))
        looks = [Evidence.from_points((turn.T @ at)[None][:found], stamp=step * k), None]
        moments.append(Moment(step * k, turn, np.zeros(3), *looks))
    return episode_of(seed, moments, target)


@pytest.mark.parametrize(("share", "seconds"), [(0.5, 1.0), (0.6, 3.0), (0.0, 1.0), (0.5, 1e9)])
def test_how_long_mistakes_last_is_counted(share, seconds):
    """To a third of the time, and 0.1 of the share, on thirty recordings; None where it does not fall."""
    model = counted([mistaking(seed, share, seconds) for seed in range(30)])
    assert model.repeats == pytest.approx(share, abs=0.1)
    if share == 0 or seconds > 20:
        assert model.repeats_for is None
    else:
        assert model.repeats_for == pytest.approx(seconds, rel=0.35)


def test_without_pairs_of_looks_nothing_lasts():
    assert lasting([], []) == (0.0, None)
    assert lasting([np.zeros(1)] * 3, [np.ones((1, 2))] * 3) == (0.0, None)
    assert lasting([np.arange(9.0)], [np.full((9, 2), np.nan)]) == (0.0, None)


def test_scores_tell_something_only_where_there_are_enough_of_both():
    rng = np.random.default_rng(0)
    assert score_ratios(rng.random(100), rng.random(5)) is None
    assert score_ratios(np.full(100, 0.9), np.full(100, 0.9)) is None
    assert max(abs(math.log(ratio)) for _, ratio in score_ratios(rng.random(4000), rng.random(4000))) < 0.15


def test_a_detector_is_fitted_as_a_detector(monkeypatch):
    monkeypatch.setattr("eagor.evaluation.fitting.BASE", SMALL)
    best = fit("a detector", [detecting(seed) for seed in range(6)], 17, 1)
    assert best.calibration is None
    assert {"detector", "forgetting"} <= best.as_json().keys()
    assert (
        best.found_by["after"]["log score"][0] > best.found_by["before"]["log score"][0] - 0.15
    )  # chance, of three episodes
    assert best.detector.detection_probability is None or 0.4 < best.detector.detection_probability < 0.95
    assert best.detector.score_ratios is not None
    assert fitted(best, SMALL).detector == best.detector


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
    made = Calibrated("scout", Calibration(0.1, 0.02, 1.5), {"jump": 0.2, "wander": (0.1, 0.3)}, {"trials": 3})
    made.write(tmp_path / "new" / "file.json")
    found = read_calibrated(tmp_path / "new" / "file.json")
    assert found == made
    config = fitted(found, TrackerConfig(degree=7))
    assert (config.degree, config.target_motion.jump, config.calibration) == (7, 0.2, made.calibration)
    assert config.target_motion.wander == (0.1, 0.3)
    model = DetectorModel(0.6, None, 0.1, 0.3, ((0.2, 0.5), (0.8, 4.0)))
    made = Calibrated("colour", None, {"start": 0.01}, {}, model)
    made.write(tmp_path / "detector.json")
    assert read_calibrated(tmp_path / "detector.json") == made


def test_how_long_mistakes_last_is_written_and_files_without_it_are_read(tmp_path):
    for calibration, detector in (
        (Calibration(persistence=0.5, persists_for=2.5), None),
        (Calibration(persistence=0.5, persists_within=0.7), None),
        (None, DetectorModel(repeats=0.3, repeats_for=1.5)),
    ):
        made = Calibrated("scout", calibration, {}, {}, detector)
        made.write(tmp_path / "file.json")
        assert read_calibrated(tmp_path / "file.json") == made
    assert from_json(GOOD, "it").calibration.persists_for is None
    assert from_json(GOOD | {"calibration": READ | {"persists_for": None}}, "it").calibration.persists_for is None
    assert from_json(GOOD | {"detector": {"repeats": 0.2}}, "it").detector == DetectorModel(repeats=0.2)


READ = {"floor": 0.1, "neutral": 0.1, "temperature": 1, "persistence": 0.5, "spread": 0.1}
GOOD = {"perception": "scout", "calibration": READ, "forgetting": {}}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"calibration": {"floor": 0.1}}, "is not a calibration"),
        ({"calibration": READ | {"floor": -1}}, "floor"),
        ({"calibration": READ | {"floor": "much"}}, "is not a calibration"),
        ({"forgetting": {"keep_per_second": 0.9}}, "sets 'keep_per_second'; known are wander, start"),
        ({"forgetting": {"jump": -7}}, "jump"),
        ({"forgetting": {"wander": [0.1, "x"]}}, "is not a calibration"),
        ({"detector": {"spread": 9}}, "spread"),
        ({"detector": {"repeats_for": 0}}, "repeats_for = 0.0; wanted seconds above 0"),
        ({"calibration": READ | {"persists_for": -1}}, "persists_for"),
        ({"detector": {"recall": 0.9}}, "recall"),
        ({"calibration": None}, "neither"),
        ({"forgetting": None}, "is not a calibration"),
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
    with pytest.raises(EagorError, match="is not JSON"):
        read_calibrated(tmp_path / "bad.json")
    (tmp_path / "list.json").write_text(json.dumps([1]))
    with pytest.raises(EagorError, match="is not a calibration"):
        read_calibrated(tmp_path / "list.json")
