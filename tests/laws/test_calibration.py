"""Fitting by log score: it finds what it should, judges on apartments that it has not seen, and its file is checked."""

from dataclasses import replace

import numpy as np
import pytest
from detections_made_up import detected

from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import PatchGrid
from eagor.lab.envs.episodes import Episode, EpisodeSpec
from eagor.lab.eval.calibration import TASKS, counted, fit, score
from eagor.lab.eval.labelled_looks import development_specs
from eagor.lab.tasks.sim.rollout import Rollout, Step
from eagor.perception.calibrated import Calibrated, from_json, read_calibrated
from eagor.sphere import direction, world_R_body
from eagor.tracking.config import TrackerConfig

GRID = PatchGrid(16, 32)
SMALL = TrackerConfig(degree=7, ranges=None)


def recording(seed, steps=16, right=0.6, height=0.0):
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
        moments.append(Step(0.5 * k, world_R_body(0.1 * k), np.array([0.0, 0.0, height]), *evidence))
    return episode_of(seed, moments, target)


def episode_of(seed, moments, target):
    there = {"present": True, "visible": True, "distance": 1.0}
    steps = []
    for moment in moments:
        pose = {"world_R_body": moment.world_R_body, "position": moment.position}
        steps.append(replace(moment, state=there | pose | {"direction": moment.world_R_body.T @ target}))
    episode = Episode(EpisodeSpec("waypoint", "none", seed, 0, 0), "none", "", "chair", (0,), (0.0, 0.0), 0.0, 1.0)
    return Rollout(episode, tuple(steps))


def detecting(seed, steps=24, height=0.0, **made):
    """A standing camera and a detector with these rates, asked for one thing, and for another that is nowhere."""
    looks = detected(np.random.default_rng(seed), 1, steps, targets=(1,), **made)
    others = detected(np.random.default_rng([seed, 1]), 1, steps, targets=(0,), **made)
    moments = [
        Step(look.stamp, look.world_R_body, np.array([0.0, 0.0, height]), look.evidence, other.evidence)
        for look, other in zip(looks, others, strict=True)
    ]
    return episode_of(seed, moments, looks[0].world_R_body @ looks[0].targets[0])


def test_honest_beliefs_score_best():
    """A detector that is wrong in two frames of five must not be believed as if it were never wrong."""
    recordings = [recording(seed) for seed in range(6)]

    def total(temperature):
        config = TrackerConfig(degree=7, ranges=None, calibration=Calibration(0.05, 0.05, temperature))
        return np.mean([score(one, config)[0] for one in recordings])

    assert total(0.8) > total(8.0)
    assert total(0.8) > total(0.02)


def test_the_fit_is_judged_on_apartments_that_it_has_not_seen(monkeypatch):
    monkeypatch.setattr("eagor.lab.eval.calibration.BASE", SMALL)
    best = fit("a detector", [detecting(seed, 12) for seed in range(8)], 48, 1)
    assert best.found_by["judged by"] == [1, 3, 5, 7]
    assert (best.calibration, best.forgetting) == (None, {})
    assert 0.2 < best.detector.habits.mean < 0.97
    assert best.detector.score_ratios is not None


def test_what_a_detector_does_is_counted():
    """Look-alikes, and boxes that sit beside the thing, too: in axes of the world, the camera tumbles."""
    made = {"habit": (8.0, 2.0), "alarms": 0.1, "spread": 0.03, "offset": 0.08, "alikes": 1.0, "alike": (5.0, 5.0)}
    model = counted([detecting(seed, 20, **made) for seed in range(20, 40)])
    assert model.look_alikes == pytest.approx(1, abs=0.3)
    assert model.false_alarms_per_look == pytest.approx(0.1, abs=0.05)
    assert model.spread == pytest.approx(0.03, rel=0.2)
    assert model.offset == pytest.approx(0.08, rel=0.25)
    assert model.habits.mean == pytest.approx(0.8, abs=0.1)
    assert model.detection_probability is None
    assert counted([recording(0)]) is None, "response maps are not counted"


def test_one_apartment_cannot_judge_itself():
    with pytest.raises(EagorError, match="at least two"):
        fit("a detector", [recording(3), recording(3)], 4)


def test_episodes_alternate_and_stay_among_the_development_seeds():
    specs = development_specs(TASKS, 10, 100, 2)
    assert [spec.task for spec in specs[:4]] == ["waypoint", "tracking"] * 2
    assert sorted({spec.seed for spec in specs}) == [100, 101, 102]
    assert len({(spec.task, spec.id) for spec in specs}) == 10
    for count, seed in ((4, 2000), (40, 1995)):
        with pytest.raises(EagorError, match="results"):
            development_specs(TASKS, count, seed, 2)


def test_several_processes_find_the_same(monkeypatch):
    made = [recording(seed, steps=6, height=1.3) for seed in range(2)]
    monkeypatch.setattr("eagor.lab.eval.calibration.DRAWS", 2)
    assert fit("a detector", made, 2, 2) == fit("a detector", made, 2, 1)


@pytest.mark.parametrize(
    ("calibration", "forgetting", "detector"),
    [
        (Calibration(0.1, 0.02, 1.5, persistence=0.5), {"jump": 0.2, "wander": (0.1, 0.3)}, None),
        (
            None,
            {"start": 0.01},
            DetectorModel(None, None, 0.1, ((0.2, 0.5), (0.8, 4.0)), kept_for=None, kept_within=0.02),
        ),
        (None, {}, DetectorModel(detection_probability=0.8, look_alikes=0.0, look_alike_habit=(1.0, 5.0), offset=0.1)),
    ],
)
def test_what_is_written_is_read_again(tmp_path, calibration, forgetting, detector):
    made = Calibrated("scout", calibration, forgetting, {"trials": 3}, detector)
    made.write(tmp_path / "new" / "file.json")
    found = read_calibrated(tmp_path / "new" / "file.json")
    assert found == made
    config = TrackerConfig(degree=7).fitted(found.calibration, found.detector, found.forgetting)
    assert config.degree == 7
    assert {name: getattr(config.target_motion, name) for name in forgetting} == forgetting


READ = {"floor": 0.1, "neutral": 0.1, "temperature": 1, "persistence": 0.5, "spread": 0.1}
GOOD = {"perception": "scout", "calibration": READ, "forgetting": {}}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"calibration": {"floor": 0.1}}, "it is not a calibration: calibration lacks neutral, persistence, spread"),
        ({"forgetting": {"keep_per_second": 0.9}}, "forgetting sets 'keep_per_second'; known are wander, start"),
        ({"forgetting": {"wander": [0.1, "x"]}}, r"wander\[1\] is 'x'; wanted `float`"),
        ({"calibration": None}, "neither"),
    ],
)
def test_files_that_are_no_calibration_are_refused(changes, says):
    assert from_json(GOOD, "it").calibration.floor == 0.1
    with pytest.raises(EagorError, match=says):
        from_json(GOOD | changes, "it")
