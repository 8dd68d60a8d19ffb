"""Direction and distance together."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import field, rotations

from eagor.belief import Belief
from eagor.belief.ranged import RangedBelief, height_prior, log_ranges
from eagor.errors import EagorError, PoseError, RotationError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.harmonics.shells import translate
from eagor.sphere import angular_distance, direction, rotation


def bearing(position, target):
    offset = target - position
    return offset / np.linalg.norm(offset)


def walk(target, steps, stride, noise=0.0, seed=0, degree=12, turn=0.0):
    """Walk along a line past `target`, looking at it at every step; the belief and the true bearing at the end."""
    rng = np.random.default_rng(seed)
    belief, position, heading = RangedBelief.uniform(degree), np.zeros(3), np.eye(3)
    for _ in range(steps):
        position = position + stride
        new_R_old = rotation((0, 0, 1), -turn)
        heading = heading @ new_R_old.T
        seen = bearing(position, target) + noise * rng.normal(size=3)
        look = Evidence.from_points([heading.T @ seen / np.linalg.norm(seen)], 50.0, [0.9])
        belief = belief.predict(new_R_old, heading.T @ stride).update(look)
    return belief, heading.T @ bearing(position, target), np.linalg.norm(target - position)


@pytest.mark.parametrize("turn", [0.0, 0.15])
@pytest.mark.parametrize("distance", [1.5, 3.0, 5.0])
def test_walking_past_a_target_tells_its_distance(distance, turn):
    target = np.array([0.5 * distance, distance, 0.2])
    belief, truth, away = walk(target, 12, np.array([distance / 8, 0, 0]), turn=turn)
    assert np.degrees(angular_distance(belief.mode(), truth)) < 4
    assert belief.distance() == pytest.approx(away, rel=0.2)
    assert belief.distance_spread() < 0.3 < 0.8 < RangedBelief.uniform(12).distance_spread()


def test_without_moving_the_distance_stays_the_prior():
    belief, _, _ = walk(np.array([2.0, 2.0, 0]), 6, np.zeros(3))
    assert np.allclose(belief.range_probabilities(), RangedBelief.uniform(12).range_probabilities(), atol=1e-6)
    prior = np.gradient(np.log(log_ranges()))
    assert np.allclose(belief.range_probabilities(), prior / prior.sum(), atol=1e-6)


@given(rotations())
@settings(max_examples=15)
def test_rotation_alone_is_the_belief_on_every_shell(R):
    look = Evidence.from_points([[0.6, 0.64, 0.48]], 40.0)
    ranged = RangedBelief.uniform(7).update(look).predict(R)
    flat = Belief.uniform(7).update(look).predict(R)
    for shell in ranged.shells:
        assert np.allclose(shell, flat.coefficients, atol=1e-12)
    assert np.degrees(angular_distance(ranged.mode(), flat.mode())) < 1e-3
    assert np.allclose(ranged.direction_belief().coefficients, flat.coefficients, atol=1e-6)
    assert ranged.presence() == pytest.approx(flat.presence(), abs=1e-9)
    assert ranged.entropy() == pytest.approx(flat.entropy(), abs=1e-9)


def test_a_range_cue_enters_shell_by_shell():
    belief = RangedBelief.uniform(7, log_ranges(1, 8, 7))
    ranges = belief.ranges
    looks = [Evidence.from_points([[1, 0, 0]], 40.0, [math.exp(-8 * math.log(r / 4) ** 2)]) for r in ranges]
    for _ in range(5):
        belief = belief.update(looks)
    assert belief.distance() == pytest.approx(4, rel=0.1)
    assert ranges[belief.range_probabilities().argmax()] == pytest.approx(4, rel=0.01)
    with pytest.raises(EagorError, match="7"):
        belief.update(looks[:3])


@pytest.mark.parametrize("camera", [0.4, 1.25, 1.7])
def test_a_prior_over_heights_is_a_likelihood_ratio_of_mean_one(camera):
    """It favours some places and rules none out; presence is not moved by it."""
    blank = RangedBelief.uniform(15, log_ranges(count=20))
    expecting = RangedBelief(blank.shells, blank.ranges, height_prior(15, blank.ranges, camera))
    assert expecting.presence() == pytest.approx(0.5, abs=0.01)
    assert expecting.log_density(direction(0.3, 1.2)) < blank.log_density(direction(0.3, 1.2)) - 0.3, "not overhead"
    level = direction(0.3, math.atan2(0.7 - camera, 4.0))
    assert expecting.log_density(level) > blank.log_density(level) + 0.3


def test_looks_below_the_horizon_tell_a_distance_where_the_floor_is_known():
    blank = RangedBelief.uniform(15, log_ranges(count=20))
    expecting = RangedBelief(blank.shells, blank.ranges, height_prior(15, blank.ranges, camera=1.25))

    def looked(belief, depression):
        for _ in range(4):
            belief = belief.update(Evidence.from_points([direction(0.4, -math.radians(depression))], 200.0, [0.9]))
        return belief

    assert looked(blank, 12).distance() == pytest.approx(blank.distance(), rel=1e-3), "without a floor, nothing"
    far, near = looked(expecting, 12), looked(expecting, 45)
    assert near.distance() < 0.6 * far.distance()
    assert near.distance_spread() < 0.75 * blank.distance_spread()


def test_the_distance_of_one_of_two_is_not_that_of_the_other():
    """Two things alike, one near and one far: over all of the sphere the range is neither's."""
    near, far, position = np.array([1.0, 1.5, 0.0]), np.array([1.5, -6.0, 0.0]), np.zeros(3)
    belief = RangedBelief.uniform(12, log_ranges(count=20))
    for _ in range(12):
        position = position + np.array([0.2, 0, 0])
        look = Evidence.from_points(
            [bearing(position, near), bearing(position, far)], 50.0, [0.9] * 2, calibration=Calibration()
        )
        belief = belief.predict(np.eye(3), np.array([0.2, 0, 0])).update(look)
    for thing in (near, far):
        about, away = bearing(position, thing), np.linalg.norm(thing - position)
        assert belief.distance(about) == pytest.approx(away, rel=0.2)
        assert belief.distance_spread(about) < 0.3
    nowhere = belief.range_probabilities(np.array([0.0, 0.0, 1.0]))
    assert np.isfinite(nowhere).all(), "also where nothing is"
    assert nowhere.sum() == pytest.approx(1)


def test_batches_are_loops():
    one, two = (walk(np.array([1.0, y, 0.1]), 3, np.array([0.2, 0, 0]), degree=7)[0] for y in (2.0, -1.0))
    batch = RangedBelief(np.stack([one.shells, two.shells]), one.ranges)
    assert np.allclose(batch.mode(), [one.mode(), two.mode()])
    assert np.allclose(batch.distance(), [one.distance(), two.distance()])
    turns = np.stack([rotation((0, 0, 1), 0.3), rotation((0, 1, 0), 0.1)])
    steps = np.array([[0.2, 0, 0], [0, 0.1, 0.0]])
    assert batch[1].distance() == pytest.approx(two.distance())
    assert batch[:1].batch_shape == (1,)
    with pytest.raises(EagorError, match="no batch"):
        one[0]
    moved = batch.predict(turns, steps)
    assert np.allclose(moved.shells[1], two.predict(turns[1], steps[1]).shells, atol=1e-12)
    assert np.allclose(batch.predict(turns[0], steps[0]).shells[1], two.predict(turns[0], steps[0]).shells, atol=1e-12)
    assert np.allclose(batch.log_density(np.eye(3))[0], one.log_density(np.eye(3)))


def test_forgetting_and_diffusion_reach_every_shell():
    belief = walk(np.array([1.0, 2.0, 0.1]), 3, np.array([0.2, 0, 0]), degree=7)[0]
    assert np.allclose(belief.forget(0.3).shells, 0.3 * belief.shells)
    assert belief.diffuse(0.2).entropy() > belief.entropy()


@pytest.mark.parametrize(
    ("bad", "error"),
    [
        (lambda b: b.predict(np.eye(3), [1.0, 2.0, math.nan]), PoseError),
        (lambda b: b.predict(np.ones((3, 3)), [0.0, 0, 0]), RotationError),
        (lambda b: RangedBelief.uniform(7, [2.0, 1.0]), EagorError),
        (lambda b: RangedBelief.uniform(7, [-1.0, 1.0]), EagorError),
        (lambda b: RangedBelief(np.zeros((3, 64)), log_ranges()), EagorError),
        (lambda b: RangedBelief(np.zeros((3, 50)), np.array([1.0, 2.0, 4.0])), EagorError),
        (lambda b: RangedBelief(np.zeros((3, 64)), np.array([1.0, 2.0, 4.0]), np.zeros((2, 64))), EagorError),
        (lambda b: b.diffuse(-1.0), EagorError),
        (lambda b: RangedBelief.uniform(7, batch_shape=(2,)).credible_region(), EagorError),
    ],
)
def test_bad_arguments_are_refused(bad, error):
    with pytest.raises(error):
        bad(RangedBelief.uniform(7))


# --- the shell warp: parallax in coefficient space ---

RANGES = log_ranges(0.5, 12.0, 14)
STEPS = st.tuples(*[st.floats(-0.2, 0.2)] * 3).map(np.array)


def shells(degree, seed):
    return np.stack([field(degree, seed + k, width=0.3) for k in range(len(RANGES))])


def by_definition(degree, c, ranges, new_R_old, step, grid):
    """Every target direction and range read from where it stood before, by evaluating the basis there."""
    basis, found = RealHarmonics(degree), []
    for r in ranges:
        before = r * grid.directions + step
        distance = np.linalg.norm(before, axis=-1)
        position = np.interp(np.log(distance), np.log(ranges), np.arange(len(ranges)))
        lower = np.minimum(position.astype(int), len(ranges) - 2)
        t = (position - lower)[..., None]
        values = basis.evaluate(before / distance[..., None] @ new_R_old)
        slope = (c[np.minimum(np.arange(len(c)) + 1, len(c) - 1)] - c[np.maximum(np.arange(len(c)) - 1, 0)]) / 2
        mixed = (1 + 2 * t) * (1 - t) ** 2 * c[lower] + t * (1 - t) ** 2 * slope[lower]
        mixed += t * t * (3 - 2 * t) * c[lower + 1] + t * t * (t - 1) * slope[lower + 1]  # Hermite's form
        found.append(basis.analyse(np.sum(values * mixed, axis=-1), grid))
    return np.stack(found)


@given(st.integers(0, 100), rotations(), STEPS)
@settings(max_examples=15)
def test_the_warp_is_its_definition(seed, R, step):
    c = shells(6, seed)
    fine = by_definition(6, c, RANGES, R, step, ErpGrid(60, 120))
    assert np.linalg.norm(translate(6, c, RANGES, R, step) - fine) < 0.01 * np.linalg.norm(fine)


@given(st.integers(0, 100), rotations())
def test_no_step_is_pure_rotation(seed, R):
    c = shells(5, seed)
    assert np.allclose(translate(5, c, RANGES, R, np.zeros(3)), RealHarmonics(5).rotate(c, R), atol=1e-12)


@given(st.integers(0, 50), rotations(), STEPS)
@settings(max_examples=20)
def test_the_warp_commutes_with_turning_the_world(seed, R, step):
    c, basis = shells(5, seed), RealHarmonics(5)
    turned = translate(5, basis.rotate(c, R), RANGES, np.eye(3), R @ step)
    assert np.allclose(turned, basis.rotate(translate(5, c, RANGES, np.eye(3), step), R), atol=1e-10)


def test_a_constant_stays():
    constant = np.zeros((len(RANGES), 81))
    constant[:, 0] = 3.0
    assert np.allclose(translate(8, constant, RANGES, np.eye(3), np.array([0.3, 0, 0.1])), constant, atol=1e-12)


def test_batches_of_shells_are_loops():
    c = np.stack([shells(4, s) for s in (0, 20, 40)])
    step = np.array([0.2, -0.1, 0.05])
    both = translate(4, c, RANGES, np.eye(3), step)
    for one, many in zip(c, both, strict=True):
        assert np.allclose(translate(4, one, RANGES, np.eye(3), step), many, atol=1e-12)
