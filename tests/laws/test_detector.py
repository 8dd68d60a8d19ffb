"""A set of detections as evidence: closed forms, how rates are learnt, and what a model refuses."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import directions, random_directions

from eagor.belief import Belief
from eagor.errors import ResponseError
from eagor.evidence import Evidence
from eagor.evidence.detections import resolved
from eagor.evidence.detector import ALARMS as NUMBERS
from eagor.evidence.detector import ClutterRate, DetectorModel, Spread, model_as_json, parse_model
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.sphere import angular_distance, direction, rotation, unit
from eagor.tracking.config import MotionModel, TrackerConfig
from eagor.tracking.tracker import DirectionTracker

PD, ALARMS = 0.7, 0.2
Z = 1 - PD + PD / ALARMS  # the mean of L after one detection: 3.8
STILL = MotionModel.still()


def model(spread_deg=8.0, **changes):
    """A detector whose looks are independent: section 8 exactly."""
    stated = {"detection_probability": PD, "false_alarms_per_look": ALARMS, "look_alikes": 0.0, "offset": 0.0}
    return DetectorModel(**{**stated, **changes}, spread=math.radians(spread_deg))


def one(where, how=None, stamp=None, **more):
    return Evidence.from_points([where], detector=how or model(), stamp=stamp, **more)


def bump(spread, angle):
    """The mass of a von Mises-Fisher distribution of this spread within an angle (radians) of its mean."""
    kappa = spread**-2
    return math.expm1(-2 * kappa * math.sin(angle / 2) ** 2) / math.expm1(-2 * kappa)


def closed_form(spread, angle):
    """The posterior mass within an angle of one detection, after one look all around."""
    return ((1 - PD) * math.sin(angle / 2) ** 2 + PD / ALARMS * bump(spread, angle)) / Z


def mass_within(belief, centre, angle):
    """The share of a belief in the cone of half-angle `angle` about `centre`."""
    grid = ErpGrid(360, 720)
    mass = np.exp(belief.log_ratio(grid)) * grid.weights
    return float(mass[angular_distance(grid.directions, centre) <= angle].sum() / mass.sum())


def tracked(evidence, degree=15, config=None):
    tracker = DirectionTracker(config or TrackerConfig(degree=degree, target_motion=STILL))
    tracker.observe(evidence)
    return tracker.estimate(evidence.stamp)


SPREADS = (0.1, 0.5, 2.0, 5.0, 8.0, 15.0, 30.0)
WHERE = direction(0.7, -0.3)


@pytest.mark.parametrize("degree", [7, 15, 31])
@pytest.mark.parametrize("spread", SPREADS)
def test_one_detection_gives_the_closed_form_in_a_belief(degree, spread):
    """However narrow it is: widened to what the degree holds, it keeps its mass."""
    belief = Belief.uniform(degree).update(one(WHERE, model(spread)))
    held = max(math.radians(spread), resolved(degree))
    assert belief.presence() == pytest.approx(Z / (Z + 1), abs=0.02)
    angle = min(3 * held, math.pi)
    assert mass_within(belief, WHERE, angle) == pytest.approx(closed_form(held, angle), abs=0.02)


@pytest.mark.parametrize("spread", SPREADS)
@pytest.mark.parametrize("degree", [7, 15, 31])
def test_one_detection_gives_the_closed_form_in_a_tracker(spread, degree):
    """With its own spread (from 1/22 of what the degree resolves on), or as many times that as is reckoned with."""
    how = model(spread)
    estimate = tracked(one(WHERE, how, stamp=0.0), degree)
    held = max(math.radians(spread), resolved(degree) / 22)
    angle = min(3 * held, math.pi)
    assert np.degrees(angular_distance(estimate.direction, WHERE)) < 0.02 * math.degrees(held) + 0.005
    assert estimate.presence == pytest.approx(Z / (Z + 1), abs=0.02)
    unsure = Spread.unsure()
    expected = [closed_form(max(scale * math.radians(spread), resolved(degree) / 22), angle) for scale in unsure.scales]
    found = estimate.within(angle) / estimate.presence
    assert found == pytest.approx(float(unsure.weights @ expected), abs=0.02)


@given(directions(), st.floats(1, 20), st.floats(0.05, 0.95), st.floats(0.05, 5))
@settings(max_examples=25)
def test_the_likelihood_ratio_is_the_formula(where, spread, pd, alarms):
    at = random_directions(30, 3)
    look = one(where, model(spread, detection_probability=pd, false_alarms_per_look=alarms)).detections
    kappa = math.radians(spread) ** -2
    density = kappa / (2 * math.pi * -math.expm1(-2 * kappa)) * np.exp(kappa * (at @ unit(where) - 1))
    assert np.allclose(look.ratio(at), 1 - pd + pd * density * 4 * math.pi / alarms, rtol=1e-9)


def test_scores_count_by_their_odds():
    """Over those of the boxes at large; without scores the ratio is 1."""
    at = WHERE[None]

    def speaks(score, how=None):
        return float(one(WHERE, how, scores=None if score is None else [score]).detections.ratio(at)[0]) - (1 - PD)

    plain = speaks(None)
    assert speaks(0.3) == pytest.approx(plain)
    assert speaks(0.5) == pytest.approx(plain * 7 / 3)
    assert speaks(0.5, model(prior_correct=0.5)) == pytest.approx(plain)
    assert speaks(0.0) == pytest.approx(speaks(0.1))
    assert speaks(0.1) == pytest.approx(plain * 7 / 27), "no score is a proof"
    assert speaks(1.0) == pytest.approx(speaks(0.9))
    assert speaks(0.9) == pytest.approx(plain * 21)
    curve = model(score_ratios=((0.2, 0.1), (0.6, 1.0), (1.0, 10.0)))
    found = [float(one(WHERE, curve, scores=[score]).detections.ratios[0]) for score in (0.0, 0.4, 0.6, 0.8)]
    assert found == pytest.approx([0.1, math.sqrt(0.1), 1.0, math.sqrt(10.0)])


def test_where_nobody_looked_nothing_is_said():
    view = PerspectiveGrid(60, 60, math.radians(90))
    inside, outside = direction(0.1, 0.1), direction(2.0, 0.0)
    look = one(inside, grid=view).detections
    assert look.ratio(outside[None]) == pytest.approx(1.0)
    none = Evidence.from_points(np.zeros((0, 3)), grid=view, detector=model()).detections
    assert none.ratio(inside[None]) == pytest.approx(1 - PD)
    whole = one(inside).detections
    # The same false alarms on a sixth of the sphere are six times as dense: a detection there proves less.
    assert look.area == pytest.approx(4 * math.pi / 6, rel=0.05)
    assert look.ratio(inside[None]) < whole.ratio(inside[None])


def test_an_uneven_clutter_makes_a_detection_there_prove_less():
    grid, clutter = ErpGrid(32, 64), np.ones((32, 64))
    clutter[:, :32] = 5.0  # to the left
    left, right = direction(1.5, 0.0), direction(-1.5, 0.0)
    ratios = [float(one(at, model(clutter=clutter)).detections.ratio(at[None])[0]) for at in (left, right)]
    assert (ratios[1] - (1 - PD)) == pytest.approx(5 * (ratios[0] - (1 - PD)), rel=0.01)
    assert np.sum(model(clutter=clutter).clutter * grid.weights) == pytest.approx(4 * math.pi)


def looks(rng, target, pd, alarms, count, spread_deg, how):
    """Looks of a turning camera, each with its pose; target None: nothing is there."""
    for stamp in range(count):
        pose = rotation(unit(rng.normal(size=3)), rng.uniform(0, math.pi))
        seen = list(unit(rng.normal(size=(rng.poisson(alarms), 3))))
        if target is not None and rng.random() < pd:
            kappa = math.radians(spread_deg) ** -2
            cosine = 1 + math.log1p(rng.random() * math.expm1(-2 * kappa)) / kappa
            side = unit(np.cross(target, rng.normal(size=3)))
            seen.append(pose.T @ (cosine * target + math.sqrt(max(1 - cosine**2, 0)) * side))
        found = np.array(seen).reshape(-1, 3)
        yield pose, found, Evidence.from_points(found, detector=how, stamp=float(stamp))


@pytest.mark.parametrize("stated", [8.0, 16.0])
def test_place_and_spread_are_believed_in_jointly(stated):
    """Bayes' rule on a grid for each scale of the spread, against the tracker: density at the truth, and the scales."""
    grid, unsure, behind = ErpGrid(90, 180), Spread.unsure(), []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        target, tracker = unit(rng.normal(size=3)), DirectionTracker(TrackerConfig(target_motion=STILL))
        x, y, _ = grid.project(target)
        near = grid.directions[int(y), int(x)]
        log = np.zeros((len(unsure.scales), *grid.shape)) + np.log(unsure.weights)[:, None, None]
        for pose, _, look in looks(rng, target, PD, ALARMS, 12, 8.0, model(stated)):
            tracker.add_pose(look.stamp, pose)
            tracker.observe(look)
            estimate = tracker.estimate(look.stamp)
            spoken = look.detections.speaks(grid.directions @ pose, unsure.scales, ClutterRate.prior(model()))[0]
            log += np.log(1 - PD + PD * spoken)
            joint = np.exp(log - log.max()) * grid.weights
            expected = joint.sum(axis=(1, 2)) / joint.sum()
            density = joint[:, int(y), int(x)].sum() / joint.sum() / grid.weights[int(y), int(x)]
            behind.append(math.log(density) - float(estimate.log_density(pose.T @ near)))
        spread = estimate.hypotheses.standing.spread
        told = [float(spread.weights[spread.scales == scale].sum()) for scale in unsure.scales]
        assert np.allclose(told, expected, atol=0.05)
    assert abs(np.mean(behind)) < 0.05


def with_a_poor_recall(seed, how):
    """An estimate after thirty looks of a detector that finds the thing in about a third of them; that share, and z."""
    rng, tracker, hits = np.random.default_rng(seed), DirectionTracker(TrackerConfig(target_motion=STILL)), 0
    target = unit(rng.normal(size=3))
    for pose, seen, look in looks(rng, target, 0.35, 0.2, 30, 5.0, how):
        tracker.add_pose(look.stamp, pose)
        tracker.observe(look)
        hits += bool((seen @ pose.T @ target > math.cos(math.radians(15))).any())
    return tracker.estimate(29.0), hits / 30, pose.T @ target


@pytest.mark.parametrize("alikes", [0.0, 0.7])
def test_a_detector_with_a_poor_recall_does_not_erase_what_it_found(alikes):
    """How often the place is detected is learnt there; only look-alikes bound how sure one gets."""
    presences = []
    for seed in range(6):
        estimate, share, truth = with_a_poor_recall(seed, DetectorModel(look_alikes=alikes, kept_for=None))
        presences.append(estimate.presence)
        assert np.degrees(angular_distance(estimate.direction, truth)) < 6
        peak = max(estimate.hypotheses.standing.windows, key=lambda window: window.values.max())
        top = np.unravel_index(peak.values[0, 0].argmax(), peak.values.shape[-2:])
        assert peak.bank.recall[top] == pytest.approx(share, abs=0.15)
    if alikes:
        # About odds of w(f) / (D d(f)) for a share f of looks: 1.5 for a third.
        assert min(presences) > 0.4
        assert max(presences) < 0.85
    else:
        assert min(presences) > 0.8


def test_a_noisy_detector_is_not_believed():
    presences, claimed = [], 0
    for seed in range(6):
        rng, tracker = np.random.default_rng(seed), DirectionTracker()
        for pose, _, look in looks(rng, None, 0.0, 2.0, 30, 5.0, DetectorModel()):
            tracker.add_pose(look.stamp, pose)
            tracker.observe(look)
        estimate = tracker.estimate(29.0)
        presences.append(estimate.presence)
        claimed += estimate.status == "tracking"
        assert 1 < estimate.alarms.weights @ estimate.alarms.numbers < 4
    assert np.mean(presences) < 0.35
    assert claimed <= 1, "sixty false alarms in half a minute agree by chance now and then"


def test_the_number_of_false_alarms_is_learnt_by_bayes_rule():
    """Detections with other causes raise the intensity there: each is Poisson with the sum of both."""
    before, others = ClutterRate.prior(DetectorModel()), np.array([0.0, 0.5, 20.0])
    numbers = np.array(NUMBERS)
    assert before.weights.sum() == pytest.approx(1)
    expected = np.exp(-numbers) * (numbers[:, None] + others).prod(axis=1)
    assert np.allclose(before.after(others).weights, expected / expected.sum())
    after = [before.after(np.full(n, of)) for n, of in ((0, 0.0), (6, 0.0), (6, 1e9))]
    none, many, explained = (float(found.weights @ found.numbers) for found in after)
    assert none < before.weights @ numbers < many
    assert explained == pytest.approx(none), "what something else explains is no false alarm"
    assert before.share(np.zeros(2)) == pytest.approx([1, 1])
    shares = before.share(others)
    assert (np.diff(shares) < 0).all(), "and it speaks the less for the target"
    assert shares == pytest.approx(before.weights @ (1 / (numbers[:, None] + others)) / before.mean_inverse_rate)


def test_a_stated_number_of_false_alarms_is_not_learnt():
    stated = ClutterRate.prior(model())
    assert stated.mean_inverse_rate == pytest.approx(1 / ALARMS)
    assert stated.after(np.zeros(6)) is stated
    assert stated.share(np.array([0.3])) == pytest.approx([ALARMS / (ALARMS + 0.3)])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"detection_probability": 0.0}, "detection_probability"),
        ({"false_alarms_per_look": 0.0}, "false_alarms_per_look"),
        ({"spread": 5.0}, "degrees"),
        ({"habit": (0.8, 0.0)}, r"habit = \(0.8, 0.0\); wanted two numbers"),
        ({"look_alike_habit": (1e-4, 1.0)}, "look_alike_habit"),
        ({"look_alikes": -0.1}, "look_alikes = -0.1; wanted an expected number"),
        ({"offset": 5.0}, "offset = 5.0; wanted radians"),
        ({"kept_for": 0.0}, "kept_for = 0.0; wanted seconds above 0"),
        ({"kept_within": -1.0}, "kept_within = -1.0; wanted metres above 0"),
        ({"score_ratios": ((0.5, 1.0), (0.2, 2.0))}, "score_ratios"),
        ({"clutter": np.zeros((4, 8))}, "clutter"),
    ],
)
def test_a_model_without_a_meaning_is_refused(changes, says):
    with pytest.raises(ResponseError, match=says):
        DetectorModel(**changes)


def test_who_states_the_recall_takes_looks_for_independent():
    """Look-alikes are reckoned with where the recall is not known, unless their number is stated."""
    assert DetectorModel().habits.look_alikes > 0
    assert DetectorModel(0.7).habits.same(DetectorModel(0.7, look_alikes=0).habits)
    assert DetectorModel(0.7, look_alikes=0.3).habits.look_alikes == 0.3
    assert not DetectorModel(0.7).habits.same(DetectorModel(0.6).habits)


def test_a_model_is_said_in_a_line():
    text = "detection_probability=0.7, false_alarms_per_look=0.2,spread=5,look_alikes=0"
    assert parse_model(text) == DetectorModel(0.7, 0.2, math.radians(5), look_alikes=0)
    base = DetectorModel(0.7, 0.2, 0.1, look_alikes=0.3, habit=(2.0, 1.0))
    assert parse_model("detection_probability=?", base) == replace(base, detection_probability=None)
    assert parse_model("offset=2,kept_for=2.5") == DetectorModel(offset=math.radians(2), kept_for=2.5)
    assert parse_model("habit=0.9+1.5,look_alike_habit=1+3").habit == (0.9, 1.5)
    assert parse_model("kept_within=?").kept_within is None
    assert parse_model("look_alikes=?", base).look_alikes is None
    assert parse_model("") == DetectorModel()
    assert DetectorModel(**model_as_json(base)) == base


@pytest.mark.parametrize(
    "wrong", ["recall=0.5", "look_alikes=1,look_alikes=2", "habit=?", "look_alikes=1+2", "habit=0.8+0", "clutter=0.2"]
)
def test_a_line_that_says_no_model_is_refused(wrong):
    with pytest.raises(ResponseError):
        parse_model(wrong)


def test_read_with_another_model_a_detection_keeps_what_is_its_own():
    box = [[300.0, 100.0, 380.0, 130.0]]
    first = Evidence.from_boxes(box, ErpGrid(256, 512), [0.8], detector=model(8.0))
    again = first.with_detector(model(3.0)).with_detector(model(8.0))
    at = random_directions(50, 1)
    assert np.allclose(first.detections.ratio(at), again.detections.ratio(at))
    assert again.detections.model == model(8.0)
    same = Evidence.from_boxes(box, ErpGrid(256, 512), [0.8], detector=model(3.0))
    assert np.allclose(first.with_detector(model(3.0)).detections.ratio(at), same.detections.ratio(at))
