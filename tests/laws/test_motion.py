"""A target that stands still or wanders: two hypotheses and their mixture."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor.belief import Belief
from eagor.estimate import TrackerConfig
from eagor.evidence import Evidence
from eagor.motion import ANYWHERE, StillOrMoving, Wanderer
from eagor.peaks import decoding_grid
from eagor.ranged import RangedBelief, log_ranges
from eagor.sphere import angular_distance, direction, rotation, unit
from eagor.tracker import DirectionTracker

DEGREE = 11
GRID = decoding_grid(DEGREE)


def look(towards, concentration=40.0, score=0.8, stamp=None):
    return Evidence.from_points([unit(towards)], concentration, [score], stamp=stamp)


def seen(*towards):
    wanderer = Wanderer.uniform(DEGREE)
    for where in towards:
        wanderer = Wanderer(wanderer.spread, wanderer.looks + look(where).coefficients(DEGREE), wanderer.least)
    return wanderer


def density(field):
    values = np.exp(field - field.max())
    return values / np.sum(values * GRID.weights)


def resultant(wanderer):
    return np.einsum("ij,ijk->k", density(wanderer.field) * GRID.weights, GRID.directions)


@given(st.floats(0.0, 2 * math.pi), st.floats(-1.4, 1.4), st.floats(0.1, 3.0), st.floats(0.02, 0.4))
@settings(max_examples=20)
def test_wandering_is_diffusion_of_the_density(azimuth, elevation, elapsed, wander):
    """The heat kernel shortens the mean resultant by exp(-sigma^2), and turns it nowhere."""
    before = seen(direction(azimuth, elevation), direction(azimuth + 0.2, elevation))
    after = before.after(elapsed, wander, keep=1.0)
    kept = math.exp(-(wander**2) * elapsed) * math.exp(-ANYWHERE * elapsed)
    moment = after.spread[[3, 1, 2]] * math.sqrt(4 * math.pi / 3)
    assert np.allclose(moment, kept * resultant(before), atol=1e-6)
    assert np.allclose(resultant(after), moment, atol=0.05)  # what rings below zero is cut off
    assert after.evidence == before.evidence


@given(st.floats(0.05, 2.0))
def test_whoever_may_be_anywhere_stays_so(elapsed):
    after = Wanderer.uniform(DEGREE).after(elapsed, 0.2, keep=0.9)
    assert np.ptp(after.field) < 1e-9


def test_time_may_pass_in_pieces():
    once = seen(direction(0.4, 0.1)).after(1.0, 0.2, keep=0.9)
    twice = seen(direction(0.4, 0.1)).after(0.4, 0.2, keep=0.9**0.4).after(0.6, 0.2, keep=0.9**0.6)
    assert np.allclose(density(once.field), density(twice.field), atol=2e-3)


def test_no_density_is_negative_or_zero():
    wanderer = seen(*[direction(0.4, 0.1)] * 12).after(0.1, 0.05, keep=1.0)
    assert np.isfinite(wanderer.field).all()
    assert density(wanderer.field).min() > 0


def filled(target, steps=6, ranged=True):
    still = RangedBelief.uniform(DEGREE, log_ranges(count=8)) if ranged else Belief.uniform(DEGREE)
    belief = StillOrMoving.uniform(still)
    for step in range(steps):
        found = look(target(step)).coefficients(DEGREE)
        carried = belief.still.forget(0.95)
        belief = belief.after(carried, 0.5, wander=0.2, restless=0.02, keep=0.95)
        field = carried.shells if isinstance(carried, RangedBelief) else carried.coefficients
        more = RangedBelief(field + found, carried.ranges) if ranged else Belief(field + found)
        belief = belief.update(more, found)
    return belief


@pytest.mark.parametrize("ranged", [True, False])
def test_the_belief_is_the_mixture_of_the_two(ranged):
    belief = filled(lambda step: direction(0.1 * step, 0.0), ranged=ranged)
    where = unit(np.random.default_rng(0).normal(size=(40, 3)))
    q = belief.wanderer.evaluator()
    total = np.log(np.sum(np.exp(q(GRID)) * GRID.weights))
    expected = np.logaddexp(
        math.log1p(-belief.moving) + belief.still.log_density(where), math.log(belief.moving) + q(where) - total
    )
    assert np.allclose(belief.log_density(where), expected, atol=5e-3)
    assert abs(np.sum(np.exp(belief.log_density(GRID.directions)) * GRID.weights) - 1) < 5e-3


def test_what_is_known_of_the_field_is_what_would_be_computed():
    belief = filled(lambda step: direction(0.1 * step, 0.0))
    assert belief.field_of_still is not None
    assert np.allclose(belief.field_of_still, belief.still.posterior.coarse, atol=1e-6)


def test_a_standing_target_is_taken_for_one_and_a_wandering_one_for_one():
    rng = np.random.default_rng(1)
    jitter = rng.normal(0, 0.1, (30, 2))
    still = filled(lambda step: direction(*jitter[step]), steps=30)
    roaming = filled(lambda step: direction(0.2 * step + jitter[step, 0], jitter[step, 1]), steps=30)
    assert still.moving < 0.2
    assert roaming.moving > 0.8
    assert still.presence() > 0.99
    assert roaming.presence() > 0.99


def test_a_place_is_forgotten_only_where_it_was_left_for_another():
    """Both cases may agree on the place, whichever is the likelier: then nothing fades."""
    here = filled(lambda step: direction(0.3, 0.0), steps=10)
    there = filled(lambda step: direction(0.3 if step < 6 else 2.3, 0.0), steps=10)
    assert here.moved < 0.1
    assert here.fading(1.0, 0.8) > 0.9
    assert there.moved > 0.2
    assert there.fading(1.0, 0.8) == pytest.approx(math.exp(-there.moved / 0.8))
    assert there.fading(0.4, 0.8) * there.fading(0.6, 0.8) == pytest.approx(there.fading(1.0, 0.8))


def test_the_answer_is_that_of_the_likelier_case():
    """A sharp peak in the less likely case does not outdo a blunt one in the other."""
    belief = filled(lambda step: direction(0.3, 0.0), steps=10)
    elsewhere = Wanderer.uniform(DEGREE).after(1.0, 0.2, keep=1.0)
    elsewhere = Wanderer(elsewhere.spread, look(direction(-2.0, 0.0), 10.0).coefficients(DEGREE), elsewhere.least)
    for moving, towards in ((0.4, direction(0.3, 0.0)), (0.6, direction(-2.0, 0.0))):
        mixed = StillOrMoving(belief.still, elsewhere, moving)
        assert angular_distance(mixed.likelier.mode, towards) < 0.1
        assert angular_distance(mixed.posterior.mode, direction(0.3, 0.0)) < 0.1


def test_nothing_seen_speaks_for_neither():
    belief = StillOrMoving.uniform(Belief.uniform(DEGREE))
    nothing = Evidence.from_points(np.zeros((0, 3)), 1.0).coefficients(DEGREE)
    after = belief.update(Belief(belief.still.coefficients + nothing), nothing)
    assert math.isclose(after.moving, 0.5, abs_tol=1e-9)
    assert after.presence() < 0.5


def test_where_looks_repeat_each_other_only_what_is_new_is_judged():
    """Whether a thing moves: one that vanishes where it was seen on and on, and appears elsewhere, has moved."""
    place, other = direction(0.5, 0.0), direction(-1.5, 0.0)

    def told(persistence, last):
        belief, newest = StillOrMoving.uniform(Belief.uniform(DEGREE)), None
        for where in [place] * 8 + [last] * 2:
            found = look(where).coefficients(DEGREE)
            carried = belief.after(belief.still, 0.5, wander=0.2, restless=0.0, keep=1.0)
            share = 1 - persistence
            belief = carried.update(carried.still.plus(share * found), found, share, newest)
            newest = persistence * found
        return belief.moving

    assert told(0.8, place) < 0.5 < told(0.8, other)
    assert told(0.0, other) < told(0.8, other), "a row of looks that repeat each other proves less that it stands there"


def follow(config, steps=60, speed=0.12):
    """Errors (degrees) while a ball circles around a standing camera; it is missed at times."""
    tracker, errors, rng = DirectionTracker(config), [], np.random.default_rng(4)
    for step in range(steps):
        stamp, true = 0.5 * step, direction(speed * step, -0.3)
        tracker.rotate(stamp, np.eye(3), np.zeros(3))
        found = unit(true + 0.1 * rng.normal(size=3))
        score = 0.0 if rng.random() < 0.3 else 0.8
        tracker.observe(look(found, score=score, stamp=stamp))
        errors.append(math.degrees(angular_distance(tracker.estimate(stamp).direction, true)))
    return np.array(errors[10:])


def test_a_wanderer_is_followed_where_a_long_memory_lags_behind():
    both = follow(TrackerConfig(degree=DEGREE))
    alone = follow(TrackerConfig(degree=DEGREE, wander=0.0))
    assert both.mean() < 20
    assert both.mean() < alone.mean() - 5


def test_late_evidence_finds_its_place():
    stamps = [0.5 * k for k in range(8)]
    on_time, late = DirectionTracker(TrackerConfig(degree=7)), DirectionTracker(TrackerConfig(degree=7))
    looks = [look(direction(0.2 * k, 0.0), stamp=stamp) for k, stamp in enumerate(stamps)]
    for tracker in (on_time, late):
        for k, stamp in enumerate(stamps):
            tracker.rotate(stamp, rotation((0, 0, 1), 0.3 * k), np.array([0.2 * k, 0.0, 1.2]))
    for given_ in looks:
        on_time.observe(given_)
    for k in (0, 2, 1, 5, 3, 4, 7, 6):
        late.observe(looks[k])
    a, b = on_time.estimate(4.0), late.estimate(4.0)
    assert np.allclose(a.direction, b.direction, atol=1e-12)
    assert math.isclose(a.moving, b.moving, rel_tol=1e-9)
    assert math.isclose(a.distance, b.distance, rel_tol=1e-9)
