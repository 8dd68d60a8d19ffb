"""Fitting a detector's model on labelled looks: it recovers what made them, and says little where they say little."""

import math
from itertools import product

import numpy as np
import pytest

from eagor.errors import DirectionError, EagorError, ResponseError
from eagor.evaluation.detector_em import Estimate
from eagor.evaluation.detector_fit import fit_detector
from eagor.evaluation.labelled_looks import LabelledLook, rows_of
from eagor.evaluation.score_curve import ScoreCurve, fitted_curve, knots_of
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.sphere import FORWARD, direction, unit, world_R_body

NOTHING = np.zeros((0, 3))


def kept(rng, before, fresh, share):
    """`fresh`, or with probability `share` what was `before`."""
    return before if before is not None and rng.random() < share else fresh


def looks_of(
    rng, groups=12, each=20, recall=0.7, alarms=0.5, spread=0.1, repeats=0.0, targets=(0, 1, 2), right=(4, 2),
    false=(2, 4),
):  # fmt: skip
    """Looks of a detector with these numbers; scores of right and false detections are Beta distributed."""
    found = []
    for group in range(groups):
        at = unit(rng.normal(size=(targets[group % len(targets)], 3))) if targets[group % len(targets)] else NOTHING
        hits, errors, wrong = [None] * len(at), [None] * len(at), None
        for step in range(each):
            hits = [kept(rng, hit, rng.random() < recall, repeats) for hit in hits]
            errors = [kept(rng, error, spread * rng.normal(size=3), repeats) for error in errors]
            wrong = kept(rng, wrong, rng.normal(size=(rng.poisson(alarms), 3)), repeats)
            seen = [true + error for true, error, hit in zip(at, errors, hits, strict=True) if hit]
            scores = np.concatenate([rng.beta(*right, size=len(seen)), rng.beta(*false, size=len(wrong))])
            places = np.concatenate([np.reshape(seen, (-1, 3)), wrong])
            found.append(
                LabelledLook(Evidence.from_points(places, scores=scores, stamp=0.5 * step), at, None, str(group))
            )
    return found


@pytest.mark.parametrize(
    "truth",
    [
        {},
        {"recall": 0.95, "alarms": 3.0, "spread": 0.03},
        {"recall": 0.4, "alarms": 0.1, "spread": 0.2},
        {"targets": (3, 2), "groups": 10, "each": 12},
    ],
    ids=["usual", "sharp among many false alarms", "blunt", "three at once"],
)
def test_each_number_lies_in_its_interval(truth):
    made = {"recall": 0.7, "alarms": 0.5, "spread": 0.1} | truth
    names = {"detection_probability": "recall", "false_alarms_per_look": "alarms", "spread": "spread"}
    held = 0
    for seed in range(3):
        looks = looks_of(np.random.default_rng(seed), **truth)
        found = fit_detector(looks, resamples=40)
        for name, key in names.items():
            low, high = found.intervals[name]
            held += low <= made[key] <= high
            assert low <= getattr(found.model, name) <= high
            assert getattr(found.model, name) == pytest.approx(made[key], rel=0.3, abs=0.05)
            assert high - low < 0.5 * made[key] + 0.2, "an interval of everything says nothing"
        assert found.model.repeats < 0.15
        assert found.targets == sum(len(look.targets) for look in looks)
        assert found.matched == pytest.approx(made["recall"] * found.targets, rel=0.2)
    assert held >= 7, "of 9 intervals of 95 %"


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_mistakes_that_repeat_are_counted(share):
    looks = looks_of(np.random.default_rng(3), groups=20, repeats=share, targets=(1, 1, 0))
    found = fit_detector(looks, resamples=25)
    low, high = found.intervals["repeats"]
    assert low - 0.02 <= share <= high + 0.02
    assert found.model.repeats == pytest.approx(share, abs=0.12)
    scrambled = [LabelledLook(look.evidence, look.targets, None, str(number)) for number, look in enumerate(looks)]
    assert fit_detector(scrambled, resamples=0).model.repeats == 0, "without consecutive looks nothing is known of it"
    assert fit_detector(scrambled, DetectorModel(repeats=0.4), resamples=0).model.repeats == 0.4


def test_scores_that_tell_are_believed_and_others_are_not():
    """Beta(4, 2) over Beta(2, 4) is (s / (1 - s))^2."""
    telling = fit_detector(looks_of(np.random.default_rng(1), groups=20), resamples=0).model
    logs = np.log([telling.ratios(np.array([score]), 1)[0] for score in (0.25, 0.5, 0.75)])
    assert logs == pytest.approx(2 * np.log([1 / 3, 1, 3]), abs=0.7)
    ratios = [ratio for _, ratio in telling.score_ratios]
    assert ratios == sorted(ratios)
    alike = fit_detector(looks_of(np.random.default_rng(1), groups=20, false=(4, 2)), resamples=0).model
    scores = np.linspace(0.3, 0.9, 7)
    assert np.abs(np.log(alike.ratios(scores, 7))).mean() < 0.25 < np.abs(np.log(telling.ratios(scores, 7))).mean() / 4
    same = [LabelledLook(Evidence.from_points([FORWARD], scores=[0.6]), FORWARD)] * 9
    assert fit_detector(same).model.score_ratios == ((0.0, 1.0), (1.0, 1.0)), "one score for all says nothing"


def test_a_score_curve_never_falls_and_few_scores_say_little():
    rng = np.random.default_rng(0)
    scores = np.concatenate([rng.beta(2, 4, 300), rng.beta(4, 2, 300)])
    upside_down = np.arange(600) < 300
    falling = fitted_curve(scores, upside_down, np.ones(600), knots_of(scores), 2.0)
    assert falling.logs == pytest.approx(np.zeros(len(falling.logs)), abs=1e-6)
    many = fitted_curve(scores, ~upside_down, np.ones(600), knots_of(scores), 1.0)
    few = fitted_curve(scores, ~upside_down, np.full(600, 0.01), knots_of(scores), 1.0)
    assert np.ptp(few.logs) < 0.5 * np.ptp(many.logs)
    none_right = fitted_curve(scores, np.zeros(600), np.ones(600), knots_of(scores), 1.0)
    assert none_right.pairs == ScoreCurve.flat().pairs


def test_the_fit_mends_looks_that_it_has_not_seen():
    found = fit_detector(looks_of(np.random.default_rng(2), alarms=3.0, recall=0.9, spread=0.03), resamples=0)
    judged = found.held_out
    assert judged.density[1] > judged.density[0] + 0.5
    assert judged.presence[1] > judged.presence[0]
    assert judged.interval[0] > 0
    assert judged.interval[0] <= judged.gain <= judged.interval[1]


def test_a_box_is_spread_beyond_its_own_size():
    """The truth lies anywhere in a box: what its size explains is no error of the detector."""
    rng, grid, looks, points = np.random.default_rng(4), ErpGrid(512, 1024), [], []
    for number in range(200):
        x, y, half = rng.uniform(100, 900), rng.uniform(200, 300), 40
        at = grid.unproject(np.array(x + rng.uniform(-half, half)), np.array(y + rng.uniform(-half, half)))
        box = [x - half, y - half, x + half, y + half]
        looks.append(LabelledLook(Evidence.from_boxes([box], grid), at, None, str(number)))
        middle = grid.unproject(np.array(x), np.array(y))
        points.append(LabelledLook(Evidence.from_points(middle), at, None, str(number)))
    assert fit_detector(looks, resamples=0).model.spread < math.radians(3)
    size = math.radians(80 * 360 / 1024) / math.sqrt(12)
    assert fit_detector(points, resamples=0).model.spread == pytest.approx(size, rel=0.1)


def test_one_target_is_assigned_as_the_model_says():
    """The likelihood ratio of `Detections`, exactly."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        model = DetectorModel(rng.uniform(0.1, 0.9), rng.uniform(0.1, 3), rng.uniform(0.02, 0.5))
        places, target = unit(rng.normal(size=(rng.integers(1, 5), 3))), unit(rng.normal(size=3))
        look = LabelledLook(
            Evidence.from_points(places, scores=rng.uniform(0.1, 1, len(places)), detector=model), target
        )
        rows = rows_of([look], model)
        joint = rows.assigned(
            model.detection_probability, model.false_alarms_per_look, model.spread, np.log(rows.scores)
        )
        ratio = look.detections.ratio(target[None])[0]
        assert joint.logs[0] == pytest.approx(math.log(ratio / (1 - model.detection_probability)), abs=1e-9)


def test_several_targets_are_assigned_as_an_enumeration_says():
    rng, errors = np.random.default_rng(1), []
    for _ in range(20):
        at = unit(np.array(FORWARD) + 0.15 * rng.normal(size=(2, 3)))
        places = unit(np.array(FORWARD) + 0.15 * rng.normal(size=(3, 3)))
        look = LabelledLook(Evidence.from_points(places), at)
        rows = rows_of([look], DetectorModel())
        joint = rows.assigned(0.7, 0.5, 0.1, np.zeros(3))
        odds = np.exp(rows.log_densities(0.1)).reshape(2, 3) * 0.7 / 0.3 / (0.5 / (4 * math.pi))
        total, shares = 0.0, np.zeros((2, 3))
        for one, two in product((None, 0, 1, 2), repeat=2):
            if one is not None and one == two:
                continue
            weight = (1 if one is None else odds[0, one]) * (1 if two is None else odds[1, two])
            total += weight
            for target, detection in ((0, one), (1, two)):
                if detection is not None:
                    shares[target, detection] += weight
        errors.append(np.abs(joint.shares.reshape(2, 3) - shares / total).max())
        assert joint.logs[0] == pytest.approx(math.log(total), abs=0.5)
    assert np.max(errors) < 0.2
    assert np.median(errors) < 0.05


# --- little, and nothing ---------------------------------------------------------------------------------------------


def test_few_looks_shrink_to_the_prior():
    base = DetectorModel(spread=math.radians(8))
    one = LabelledLook(Evidence.from_points([FORWARD]), FORWARD)
    found = fit_detector([one], base)
    assert found.held_out is None
    assert 0.57 < found.model.detection_probability < 0.9
    assert math.radians(4) < found.model.spread < math.radians(8)
    low, high = found.intervals["detection_probability"]
    assert high - low > 0.5, "one look is not much"
    more = fit_detector([one] * 100, base, resamples=0).model
    assert more.detection_probability > 0.97
    assert more.spread < math.radians(2)


def test_an_absent_thing_tells_of_false_alarms_only():
    looks = [LabelledLook(Evidence.from_points(unit(np.eye(3)[: n % 3])), [], n) for n in range(30)]
    base = DetectorModel()
    found = fit_detector(looks, base, resamples=20)
    assert found.model.detection_probability is None
    assert "detection_probability" not in found.intervals
    assert found.model.false_alarms_per_look == pytest.approx(1, abs=0.05)
    assert found.model.spread == pytest.approx(base.spread, rel=1e-2)
    assert found.held_out.density is None


def test_a_detector_that_never_answers():
    looks = [LabelledLook(Evidence.from_points([]), FORWARD, n) for n in range(20)]
    found = fit_detector(looks, resamples=20)
    assert found.model.detection_probability < 0.1
    assert found.model.false_alarms_per_look < 0.05
    assert found.model.score_ratios is None
    assert found.detections == found.matched == 0


def test_what_a_view_does_not_show_is_not_missed():
    view = PerspectiveGrid(64, 64, math.radians(60), world_R_body(0.0))
    behind = [LabelledLook(Evidence.from_boxes([], view), [direction(math.pi, 0.0)], n) for n in range(20)]
    ahead = [LabelledLook(Evidence.from_boxes([[28, 28, 36, 36]], view), FORWARD, n) for n in range(20)]
    assert fit_detector(behind, resamples=0).targets == 0
    assert fit_detector(behind + ahead, resamples=0).model.detection_probability > 0.9


def test_what_cannot_be_fitted_is_refused():
    grid = ErpGrid(8, 16)
    mapped = Evidence.from_response(np.zeros((8, 16)), grid, Calibration())
    with pytest.raises(EagorError, match="there are no labelled looks"):
        fit_detector([])
    with pytest.raises(ResponseError, match="a response map has no detections"):
        LabelledLook(mapped, NOTHING)
    with pytest.raises(ResponseError, match=r"wanted eagor\.Evidence"):
        LabelledLook([[1, 2, 3]], NOTHING)
    with pytest.raises(DirectionError, match=r"wanted \(n, 3\)"):
        LabelledLook(Evidence.from_points([]), [[0.1, 0.2]])
    assert Estimate(0.5, 1.0, 0.1, ScoreCurve.flat()).model(DetectorModel()).detection_probability is None
