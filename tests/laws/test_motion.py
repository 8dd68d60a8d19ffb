"""Absent, standing or wandering: what there can be, weighed by what it foretold."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor.belief.ranged import log_ranges
from eagor.evidence import Evidence
from eagor.evidence.detector import DetectorModel
from eagor.harmonics.peaks import decoding_grid
from eagor.sphere import angular_distance, direction, unit
from eagor.tracking.config import MotionModel, TrackerConfig
from eagor.tracking.imm import TargetHypotheses
from eagor.tracking.scan import Scan
from eagor.tracking.stationary import StationaryTarget
from eagor.tracking.tracker import DirectionTracker

DEGREE = 11
GRID = decoding_grid(DEGREE)
MODEL = DetectorModel(0.7, 0.2, math.radians(8), look_alikes=0)  # looks are independent
STILL = MotionModel.still()
ONE = MotionModel(wander=(0.2,), turn=(), start=0.02, stop=0.02, jump=0.0, birth=0.0, death=0.0)
RANGES = log_ranges(count=8)


def look(towards, stamp=None, model=MODEL):
    points = np.zeros((0, 3)) if towards is None else [unit(towards)]
    return Evidence.from_points(points, detector=model, stamp=stamp)


def seen(hypotheses, towards):
    scan = Scan.of([look(towards)], DEGREE, 0.0, np.eye(3), np.zeros(3))
    return hypotheses.updated(scan, None, None, None)[0]


def prior(motion=ONE, ranged=False):
    return TargetHypotheses.prior(motion, StationaryTarget.uniform(DEGREE, RANGES if ranged else None))


def passed(hypotheses, elapsed, motion=ONE, step=None):
    return hypotheses.after(elapsed, motion, step, None)


def resultant(density):
    return np.einsum("ij,ijk->k", density * GRID.weights, GRID.directions) / (4 * math.pi)


def told(motion, towards, steps, ranged=False, every=0.5):
    hypotheses = prior(motion, ranged)
    for step in range(steps):
        hypotheses = seen(passed(hypotheses, every, motion), towards(step))
    return hypotheses


# --- how time passes --------------------------------------------------------------------------------------------------


@given(st.floats(0.0, 2 * math.pi), st.floats(-1.4, 1.4), st.floats(0.1, 3.0), st.floats(0.02, 0.4))
@settings(max_examples=20)
def test_wandering_is_diffusion_of_the_density(azimuth, elevation, elapsed, wander):
    """The heat kernel shortens the mean resultant by exp(-sigma^2), and turns it nowhere."""
    motion = replace(ONE, wander=(wander,), start=0.0, stop=0.0)
    before = seen(prior(motion), direction(azimuth, elevation))
    after = passed(before, elapsed, motion)
    moment = resultant(before.wandering.densities[0])
    assert np.allclose(resultant(after.wandering.densities[0]), math.exp(-(wander**2) * elapsed) * moment, atol=2e-3)


def test_what_jumps_may_be_anywhere():
    motion = replace(ONE, wander=(0.02,), start=0.0, stop=0.0, jump=0.1)
    before = seen(prior(motion), direction(0.5, 0.0))
    after = passed(before, 7.0, motion)
    kept = math.exp(-0.7)
    (then,), (now,) = before.wandering.densities, after.wandering.densities
    assert np.allclose(resultant(now), kept * resultant(then), atol=5e-3)
    assert now.min() == pytest.approx(1 - kept + kept * then.min(), abs=0.02)


@given(st.floats(0.05, 20.0))
def test_nothing_known_stays_so(elapsed):
    after = passed(prior(MotionModel()), elapsed, MotionModel())
    assert np.ptp(after.field.values) < 1e-9
    assert after.presence == pytest.approx(0.5), "birth and death are in balance"
    assert after.moving == pytest.approx(MotionModel().moving), "and so are start and stop"


def test_after_long_enough_all_is_as_at_the_start():
    motion = MotionModel(birth=0.01, death=0.03)
    hypotheses = told(motion, lambda step: direction(0.4, 0.1), 6)
    assert hypotheses.presence > 0.95
    waited = passed(hypotheses, 1e5, motion)
    assert waited.presence == pytest.approx(0.25, abs=1e-3)
    assert waited.moving == pytest.approx(motion.moving, abs=1e-3)
    assert passed(hypotheses, 0.0, motion) is hypotheses


# --- what a look says -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ranged", [False, True])
def test_the_belief_is_the_mixture_of_the_cases(ranged):
    hypotheses = told(ONE, lambda step: direction(0.1 * step, 0.0), 6, ranged)
    where = unit(np.random.default_rng(0).normal(size=(60, 3)))
    shares = hypotheses.weights[1:] / hypotheses.weights[1:].sum()
    stands = np.exp(hypotheses.standing.field(where) - hypotheses.standing.log_mean)
    roams = np.exp(replace(hypotheses.field, values=np.log(hypotheses.wandering.densities[0]), patches=())(where))
    expected = shares[0] * stands + shares[1] * roams
    assert np.allclose(np.exp(hypotheses.field(where)), expected, rtol=0.08, atol=0.01)
    assert hypotheses.field.log_mean == pytest.approx(0, abs=0.04), "a density over a uniform one"


def test_each_case_is_weighed_by_what_it_foretold():
    """Bayes' rule: of two cases that foretold a detection with densities a and b, the odds change by their ratio."""
    hypotheses = passed(told(ONE, lambda step: direction(0.3, 0.0), 5), 0.5)
    towards = direction(0.5, 0.1)
    after = seen(hypotheses, towards)
    ratio = look(towards).detections.ratio(GRID.directions)
    stood = np.exp(hypotheses.standing.field(GRID) - hypotheses.standing.log_mean)
    densities = (stood, hypotheses.wandering.densities[0])
    means = [float(np.sum(ratio * density * GRID.weights)) / (4 * math.pi) for density in densities]
    expected = hypotheses.weights * np.array([1.0, *means])
    assert np.allclose(after.weights, expected / expected.sum(), atol=0.03)


def test_nothing_seen_speaks_against_presence_and_for_neither():
    before = prior()
    after = seen(before, None)
    assert after.moving == pytest.approx(before.moving)
    assert after.presence == pytest.approx(0.3 / 1.3)


def test_a_standing_target_is_taken_for_one_and_a_wandering_one_for_one():
    rng, motion = np.random.default_rng(1), MotionModel()
    jitter = rng.normal(0, 0.1, (30, 2))
    still = told(motion, lambda step: direction(*jitter[step]), 30)
    roaming = told(motion, lambda step: direction(0.2 * step + jitter[step, 0], jitter[step, 1]), 30)
    assert still.moving < 0.3
    assert roaming.moving > 0.8
    assert still.presence > 0.99
    assert roaming.presence > 0.99


@pytest.mark.parametrize("alikes", [0.0, 0.7])
def test_whether_a_thing_moves_is_judged_by_what_is_new_in_a_look(alikes):
    """What is detected where it always was speaks for standing; what is detected elsewhere instead, for moving."""
    place, other = direction(0.5, 0.0), direction(-1.5, 0.0)
    found = {}
    for last in ("here", "there", "both"):
        tracker = DirectionTracker(TrackerConfig(ranges=None))
        for t in range(11):
            where = [place] if last == "here" or t < 8 else [other] if last == "there" else [place, other]
            model = DetectorModel(false_alarms_per_look=0.2, spread=math.radians(8), look_alikes=alikes)
            tracker.observe(Evidence.from_points(where, detector=model, stamp=float(t)))
        found[last] = tracker.estimate(10.0).moving
    assert found["here"] < found["there"]
    assert max(found["here"], found["both"]) < 0.1, "a second place with the thing in it does not make the first move"


# --- following --------------------------------------------------------------------------------------------------------


def follow(config, steps=60, speed=0.12):
    """Errors (degrees) while a ball circles around a standing camera; it is missed at times."""
    tracker, errors, rng = DirectionTracker(config), [], np.random.default_rng(4)
    for step in range(steps):
        stamp, true = 0.5 * step, direction(speed * step, -0.3)
        tracker.add_pose(stamp, np.eye(3), np.zeros(3))
        found = unit(true + 0.1 * rng.normal(size=3)) if rng.random() > 0.3 else None
        tracker.observe(look(found, stamp))
        said = tracker.estimate(stamp).direction
        errors.append(math.degrees(angular_distance(direction(0, 0) if said is None else said, true)))
    return np.array(errors[10:])


def test_a_wanderer_is_followed_where_a_long_memory_lags_behind():
    both = follow(TrackerConfig(degree=DEGREE))
    alone = follow(TrackerConfig(degree=DEGREE, target_motion=STILL))
    assert both.mean() < 12
    assert both.mean() < alone.mean() - 5


def test_a_target_that_comes_to_stand_is_found_where_it_stands():
    tracker = DirectionTracker(TrackerConfig(degree=DEGREE, ranges=None))
    for t in range(60):
        tracker.observe(look(direction(0.2 * min(t, 20), 0.0), float(t)))
        if t == 20:
            assert tracker.estimate(20.0).moving > 0.7
    estimate = tracker.estimate(59.0)
    assert estimate.moving < 0.3
    assert math.degrees(angular_distance(estimate.direction, direction(4.0, 0.0))) < 1
    assert math.degrees(estimate.credible_angle) < 10
