"""Fitting a detector's model on looks: it recovers what made them, and says little where they say little."""

import math
from dataclasses import replace

import numpy as np
import pytest
from detections_made_up import detected
from scipy.spatial.transform import Rotation

from eagor.errors import DirectionError, EagorError, ResponseError, RotationError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detections import View
from eagor.evidence.detector import LOOK_ALIKES, DetectorModel
from eagor.grids import ErpGrid
from eagor.lab.eval.detector_fit import assign, fit_detector, fitted_model, log_score
from eagor.lab.eval.labelled_looks import DetectionTable, LabelledLook, segments
from eagor.sphere import FORWARD, unit

NOTHING = np.zeros((0, 3))
BASE = DetectorModel()


def looks_of(rng, **made):
    """The looks of a detector with these numbers, with their truth."""
    found = detected(rng, **made)
    return [LabelledLook(each.evidence, each.targets, None, str(each.group), each.world_R_body) for each in found]


def share(model):
    return model.habit[0] / sum(model.habit)


MADE = {"habit": (1.5, 1.0), "alarms": 0.3, "spread": 0.04, "offset": 0.06, "alikes": 1.0, "alike": (2.0, 2.0)}


def test_every_number_of_a_detector_is_recovered_and_lies_in_its_interval():
    """Also what a place keeps from what differs between looks, and look-alikes from false alarms that pass."""
    looks = looks_of(np.random.default_rng(2), groups=60, targets=(1, 2), **MADE)
    found = fit_detector(looks, resamples=20, judged=False)
    model = found.model
    assert model.detection_probability is None
    assert found.counts["targets"] == sum(len(look.targets) for look in looks)
    told = {"detection_share": share(model), "look_alikes": model.look_alikes, "spread": model.spread}
    told |= {"false_alarms_per_look": model.false_alarms_per_look, "offset": model.offset}
    wanted = {"detection_share": 0.6, "look_alikes": 1.0, "spread": 0.04, "false_alarms_per_look": 0.3, "offset": 0.06}
    for number, value in wanted.items():
        low, high = found.intervals[number]
        assert low <= told[number] <= high
        assert told[number] == pytest.approx(value, rel=0.25), number
        assert low - 0.1 * value <= value <= high + 0.1 * value, number
        assert high - low < 0.5 * value + 0.3, "an interval of everything says nothing"
    assert sum(model.habit) == pytest.approx(2.5, rel=0.5)
    lasting = model.look_alikes * model.look_alike_habit[0] / sum(model.look_alike_habit)
    assert lasting == pytest.approx(0.5, abs=0.1), "how many come again in a look"
    logs = np.log(model.ratios(np.array([0.25, 0.5, 0.75]), 3))
    assert logs == pytest.approx(2 * np.log([1 / 3, 1, 3]), abs=0.7), "Beta(4, 2) over Beta(2, 4): (s / (1 - s))^2"
    blind = fitted_model([LabelledLook(look.evidence, look.targets, None, look.group) for look in looks], BASE)
    assert blind.false_alarms_per_look == pytest.approx(0.8, abs=0.1), "without poses all that is false is counted"


def test_what_a_box_errs_by_its_size_is_told_from_what_it_errs_anyhow():
    rng, looks = np.random.default_rng(5), []
    for group in range(60):
        at, size = unit(rng.normal(size=3)), rng.choice([0.02, 0.2])
        kept = at + np.hypot(0.02, 0.4 * size) * rng.normal(size=3)
        for step in range(12):
            turn = Rotation.random(rng=rng).as_matrix()
            seen = unit(kept + np.hypot(0.01, 0.2 * size) * rng.normal(size=3)) @ turn
            look = Evidence.from_moments([(seen, size**2 * np.eye(2))], None, View(ErpGrid(32, 64)), stamp=step)
            looks.append(LabelledLook(look, (at @ turn)[None], None, str(group), turn))
    model = fitted_model(looks, BASE)
    assert model.spread_of_size == pytest.approx(0.2, rel=0.15)
    assert model.offset_of_size == pytest.approx(0.4, rel=0.25)
    assert model.spread == pytest.approx(0.01, rel=0.25)
    assert model.offset == pytest.approx(0.02, rel=0.3)


@pytest.mark.parametrize(
    ("stamps", "metres", "wanted"),
    [
        ([0, 50, 70, 120], [0, 0, 0, 0], [0, 0, 1, 1]),
        ([0, 1, 2, 3], [0, 0.6, 1.2, 1.4], [0, 0, 1, 1]),
        ([0, 30, 31], [0, 0.4, 0.6], [0, 0, 1]),
    ],
    ids=["seconds", "metres", "both"],
)
def test_a_view_lasts_as_long_as_its_habits(stamps, metres, wanted):
    looks = [
        LabelledLook(Evidence.from_points([]), NOTHING, at, "a", np.eye(3), np.array([x, 0.0, 0.0]))
        for at, x in zip(stamps, metres, strict=True)
    ]
    assert segments(looks, BASE).tolist() == wanted


def test_the_fit_mends_looks_that_it_has_not_seen():
    looks = looks_of(np.random.default_rng(2), alarms=3.0, habit=(9.0, 1.0), spread=0.03)
    judged = fit_detector(looks, resamples=0).held_out
    assert 0 < judged.interval.low <= judged.difference <= judged.interval.high
    assert judged.difference > 0.5


def test_what_is_held_out_has_no_part_in_the_fit_that_it_judges():
    """Neither by its scores, between which the curve has its knots, nor by where the search begins."""
    looks = looks_of(np.random.default_rng(3), groups=3, each=6, alarms=1.0, targets=(1, 2))
    others = looks_of(np.random.default_rng(4), groups=1, each=6, alarms=6.0, targets=(2,), right=(90, 10))
    looks[6:12] = [replace(look, group="1") for look in others]
    alone = []
    for group in "012":
        model = fitted_model([look for look in looks if look.group != group], BASE)
        alone += [log_score(look, model) - log_score(look, BASE) for look in looks if look.group == group]
    assert fit_detector(looks, resamples=0).held_out.difference == pytest.approx(np.mean(alone))


def test_one_target_is_assigned_as_the_model_says():
    """The likelihood ratio of `Detections`, exactly."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        curve = ((0.1, 0.1), (1.0, 1.0))
        model = DetectorModel(rng.uniform(0.1, 0.9), rng.uniform(0.1, 3), rng.uniform(0.02, 0.5), curve, offset=0.0)
        places, target = unit(rng.normal(size=(rng.integers(1, 5), 3))), unit(rng.normal(size=3))
        look = LabelledLook(
            Evidence.from_points(places, scores=rng.uniform(0.1, 1, len(places)), detector=model), target
        )
        shares, right = assign(DetectionTable([look], model), model)
        assert right == pytest.approx(shares), "every detection has one target only"
        missed = (1 - model.detection_probability) / look.detections.ratio(target[None])[0]
        assert math.log(1 - shares.sum()) == pytest.approx(math.log(missed), abs=1e-9)


# --- little, and nothing ---------------------------------------------------------------------------------------------


def test_few_looks_shrink_to_the_prior():
    base = DetectorModel(spread=math.radians(8))
    one = LabelledLook(Evidence.from_points([FORWARD]), FORWARD)
    found = fit_detector([one], base, resamples=40)
    assert found.held_out is None
    assert 0.5 < share(found.model) < 0.9
    assert math.radians(4) < found.model.spread < math.radians(8)
    low, high = found.intervals["detection_share"]
    assert high - low > 0.5, "one look is not much"
    more = fit_detector([one] * 100, base, resamples=0)
    assert share(more.model) < 0.9, "nor is one place"
    assert more.model.spread < math.radians(2)
    places = [LabelledLook(one.evidence, FORWARD, None, str(n % 50)) for n in range(200)]
    assert share(fitted_model(places, base)) > 0.95


def test_an_absent_thing_tells_of_false_alarms_only():
    looks = [LabelledLook(Evidence.from_points(unit(np.eye(3)[: n % 3])), [], n) for n in range(30)]
    found = fit_detector(looks, BASE, resamples=20)
    assert found.model.habit == BASE.habit
    assert "detection_share" not in found.intervals
    assert found.model.false_alarms_per_look == pytest.approx(1, abs=0.05)
    assert found.model.spread == pytest.approx(BASE.spread, rel=1e-2)
    posed = [LabelledLook(look.evidence, [], look.stamp, "", np.eye(3)) for look in looks]
    lasting = fitted_model(posed, BASE)
    assert lasting.look_alikes > LOOK_ALIKES, "the same two places, again and again"
    assert lasting.false_alarms_per_look < 0.1


def test_a_thing_in_no_look_with_a_detection_tells_nothing_of_errors():
    looks = looks_of(np.random.default_rng(2), groups=20, targets=(1, 2), **MADE)
    empty = LabelledLook(Evidence.from_points(NOTHING, stamp=0.0), np.array([FORWARD]), None, "missed", np.eye(3))
    model, more = fitted_model(looks, BASE), fitted_model([*looks, empty], BASE)
    assert (more.spread, more.offset) == pytest.approx((model.spread, model.offset), rel=0.01)


def test_what_cannot_be_fitted_is_refused():
    grid = ErpGrid(8, 16)
    mapped = Evidence.from_response(np.zeros((8, 16)), grid, Calibration())
    with pytest.raises(EagorError, match="there are no looks with detections"):
        fit_detector([])
    for evidence in (mapped, [[1, 2, 3]]):
        with pytest.raises(ResponseError, match=r"without detections to count; wanted eagor\.Evidence"):
            LabelledLook(evidence, NOTHING)
    with pytest.raises(DirectionError, match=r"wanted \(\.\.\., 3\)"):
        LabelledLook(Evidence.from_points([]), [[0.1, 0.2]])
    with pytest.raises(RotationError, match="world_R_body"):
        LabelledLook(Evidence.from_points([]), NOTHING, world_R_body=2 * np.eye(3))
