"""A target that goes around: a mixture of Gaussians over direction and angular velocity."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from eagor import DetectorModel, DirectionTracker, Evidence, MotionModel, TrackerConfig
from eagor.evidence.detector import ClutterRate
from eagor.grids import ErpGrid
from eagor.sphere import angular_distance, rotation, unit
from eagor.tracking.moving import TurningTarget
from eagor.tracking.scan import Measurement, Scan

GRID = ErpGrid(96, 192)
PD = 0.7
MODEL = DetectorModel(detection_probability=PD, false_alarms_per_look=0.2, spread=math.radians(8), look_alikes=0)
RATES = (math.radians(6),)
AXIS = unit(np.array([0.3, -0.2, 1.0]))
FAST = math.radians(10)  # a second


def look(directions, model=MODEL, stamp=0.0):
    evidence = Evidence.from_points(np.reshape(directions, (-1, 3)), detector=model, stamp=stamp)
    return Scan.of([evidence], 15, stamp, np.eye(3), None).read(ClutterRate.prior(model))


def sightings(directions):
    return look(directions).sightings(PD)


def circling(step):
    return rotation(AXIS, FAST * step) @ np.array([1.0, 0.0, 0.0])


def followed(steps=20, noise=0.0, seed=0):
    """After looks of one second each at what circles."""
    rng, turning = np.random.default_rng(seed), TurningTarget.prior(RATES)
    for step in range(steps):
        if step:
            turning = turning.after(1.0, 0.0, 0.0)
        turning, _, _ = turning.updated(sightings(unit(circling(step) + noise * rng.normal(size=3))))
    return turning


def mean(turning):
    """Of the heaviest component: direction and angular velocity."""
    best = int(turning.weights.argmax())
    return turning.directions[best], turning.turns[best]


def test_nothing_is_known_before_a_look():
    assert np.allclose(TurningTarget.prior(RATES).density(GRID.directions), 1)


def test_a_steady_turn_is_learnt():
    """Where it is and how fast it turns, from places alone."""
    place, turn = mean(followed(30))
    assert math.degrees(angular_distance(place, circling(29))) < 2
    assert np.allclose(turn, FAST * AXIS, atol=math.radians(1.5))


def test_what_is_not_seen_goes_on():
    """Six seconds without a look: it is where it was led to, less surely."""
    turning = followed(30, 0.05)
    later = turning.after(6.0, 0.0, 0.0)
    assert math.degrees(angular_distance(mean(later)[0], circling(35))) < 10
    assert np.trace(later.covariances[0, :3, :3]) > np.trace(turning.covariances[0, :3, :3])


def test_the_density_integrates_to_one():
    for turning in (followed(1), followed(2), followed(12, 0.1), followed(12, 0.1).after(3.0, 0.2, 0.05)):
        density = turning.density(GRID.directions)
        assert float(np.sum(density * GRID.weights)) / (4 * math.pi) == pytest.approx(1, abs=0.03)
        assert turning.unseen + turning.weights.sum() == pytest.approx(1)


@pytest.mark.parametrize("aside", [[], [0.0], [0.15], [0.1, 2.0]])
def test_a_look_is_weighed_by_bayes_rule(aside):
    """The gain is the mean of the likelihood ratio under the density; the density becomes their product."""
    before = followed(6, 0.1).after(1.0, 0.05, 0.0)
    seen: Measurement = look([rotation((0, 1, 0), angle) @ circling(6) for angle in aside])
    after, gain, _ = before.updated(seen.sightings(PD))
    assert seen.world is not None
    ratio = seen.world.ratio(GRID.directions, 1.0)
    product = before.density(GRID.directions) * ratio
    total = float(np.sum(product * GRID.weights)) / (4 * math.pi)
    assert gain == pytest.approx(math.log(total), abs=0.1)
    away = np.sum(np.abs(after.density(GRID.directions) - product / total) * GRID.weights) / (4 * math.pi)
    assert float(away) / 2 < 0.12, "of the mass lies elsewhere"


def test_turning_the_world_turns_the_belief():
    turn = rotation(unit(np.array([1.0, 2.0, -0.5])), 1.1)
    ours = theirs = TurningTarget.prior(RATES)
    rng = np.random.default_rng(3)
    for step in range(8):
        place = unit(circling(step) + 0.1 * rng.normal(size=3))
        ours, theirs = (t.after(1.0, 0.0, 0.0) if step else t for t in (ours, theirs))
        (ours, _, _), (theirs, _, _) = ours.updated(sightings(place)), theirs.updated(sightings(turn @ place))
    where = unit(rng.normal(size=(50, 3)))
    assert np.allclose(theirs.density(where @ turn.T), ours.density(where), rtol=1e-6)


def follow(motion, truth, steps=40, model=MODEL, seed=5):
    """Errors (degrees) of the tracker's answers to noisy looks at `truth`, and the last estimate."""
    rng, tracker, errors = np.random.default_rng(seed), DirectionTracker(TrackerConfig(target_motion=motion)), []
    for step in range(steps):
        found = [unit(truth(step) + model.spread * rng.normal(size=3))] if rng.random() < 0.7 else np.zeros((0, 3))
        tracker.observe(Evidence.from_points(found, detector=model, stamp=float(step)))
        estimate = tracker.estimate(float(step))
        if estimate.direction is not None:
            errors.append(math.degrees(angular_distance(estimate.direction, truth(step))))
    return np.array(errors), estimate


def test_what_circles_is_followed_better_than_by_wandering_alone():
    ours, last = follow(MotionModel(), circling)
    theirs, _ = follow(MotionModel(turn=()), circling)
    assert ours[15:].mean() < 0.7 * theirs[15:].mean()
    assert last.moving > 0.9


@pytest.mark.parametrize(("stated", "scale"), [(8, 1.0), (16, 0.5)])
@pytest.mark.parametrize("speed", [4, 10])
def test_a_turn_is_not_taken_for_a_wide_spread(stated, scale, speed):
    """The spread is found out while the target turns; looks are made with 8 degrees."""
    rng, tracker = np.random.default_rng(0), DirectionTracker()
    model = replace(MODEL, spread=math.radians(stated))
    for step in range(40):
        place = rotation(AXIS, math.radians(speed) * step) @ np.array([1.0, 0.0, 0.0])
        found = [unit(place + MODEL.spread * rng.normal(size=3))] if rng.random() < 0.7 else np.zeros((0, 3))
        tracker.observe(Evidence.from_points(found, detector=model, stamp=float(step)))
    estimate = tracker.estimate(39.0)
    spread = estimate.hypotheses.standing.spread
    assert estimate.moving > 0.8
    assert float(spread.otherwise[spread.scales == scale].sum()) > 0.9
