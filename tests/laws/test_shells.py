"""The shell warp: parallax in coefficient space."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import field, random_directions, rotations

from eagor.belief.ranged import log_ranges
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.harmonics.shells import translate

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


@given(st.integers(0, 100), rotations(), STEPS)
@settings(max_examples=20)
def test_turning_first_and_stepping_then_is_one_step(seed, R, step):
    """The displacement is given in the new frame."""
    c, basis = shells(5, seed), RealHarmonics(5)
    apart = translate(5, basis.rotate(c, R), RANGES, np.eye(3), step)
    assert np.allclose(translate(5, c, RANGES, R, step), apart, atol=1e-10)


@given(st.integers(0, 50), rotations(), STEPS)
@settings(max_examples=20)
def test_the_warp_commutes_with_turning_the_world(seed, R, step):
    c, basis = shells(5, seed), RealHarmonics(5)
    turned = translate(5, basis.rotate(c, R), RANGES, np.eye(3), R @ step)
    assert np.allclose(turned, basis.rotate(translate(5, c, RANGES, np.eye(3), step), R), atol=1e-10)


@pytest.mark.parametrize("step", [(0, 0, 0.25), (0, 0, -0.25), (0.25, 0, 0), (-0.2, 0.1, 0.05), (1e-9, 0, 0)])
def test_a_point_moves_as_parallax_says(step):
    """A blob at a known point: after the step it stands where geometry puts it, nearer or farther."""
    degree, step = 12, np.array(step)
    basis = RealHarmonics(degree)
    for k in (4, 7, 10):
        point = RANGES[k] * np.array([0.6, 0.64, 0.48])
        c = np.zeros((len(RANGES), basis.size))
        for j in range(len(RANGES)):
            c[j] = 10 * math.exp(-0.5 * (j - k) ** 2) * basis.smooth(basis.evaluate(point / np.linalg.norm(point)), 0.2)
        moved = translate(degree, c, RANGES, np.eye(3), step)
        after = point - step
        at = after / np.linalg.norm(after)
        shell = int(np.argmin(np.abs(np.log(RANGES / np.linalg.norm(after)))))
        grid = ErpGrid(90, 180)
        peak = grid.directions.reshape(-1, 3)[basis.synthesise(moved[shell], grid).argmax()]
        assert np.degrees(np.arccos(peak @ at)) < 3.0
        heights = basis.synthesise(moved, at)
        assert abs(int(heights.argmax()) - shell) <= 1


def test_far_shells_hardly_notice_and_constants_never():
    basis, c = RealHarmonics(8), shells(8, 0)
    moved = translate(8, c, RANGES, np.eye(3), np.array([0.05, 0.02, 0.0]))
    assert np.linalg.norm(moved[-1] - c[-1]) < 0.05 * np.linalg.norm(c[-1])
    assert np.linalg.norm(moved[0] - c[0]) > 0.1 * np.linalg.norm(c[0])
    constant = np.zeros((len(RANGES), basis.size))
    constant[:, 0] = 3.0
    assert np.allclose(translate(8, constant, RANGES, np.eye(3), np.array([0.3, 0, 0.1])), constant, atol=1e-12)


def test_batches_of_shells_are_loops():
    c = np.stack([shells(4, s) for s in (0, 20, 40)])
    step = np.array([0.2, -0.1, 0.05])
    both = translate(4, c, RANGES, np.eye(3), step)
    for one, many in zip(c, both, strict=True):
        assert np.allclose(translate(4, one, RANGES, np.eye(3), step), many, atol=1e-12)


def test_many_steps_add_up():
    """A ray ahead on the left, then two metres forward: where each shell cuts the ray follows from geometry."""
    degree, basis = 10, RealHarmonics(10)
    ahead_left = np.array([math.cos(0.5), math.sin(0.5), 0])
    c = np.stack([basis.smooth(basis.evaluate(ahead_left), 0.2)] * len(RANGES))
    moved = c
    for _ in range(8):
        moved = translate(degree, moved, RANGES, np.eye(3), np.array([0.25, 0, 0]))
    d = random_directions(20_000)
    for k in (7, 9, 11):
        along = 2 * ahead_left[0] + math.sqrt((2 * ahead_left[0]) ** 2 - 4 + RANGES[k] ** 2)
        expected = (along * ahead_left - [2, 0, 0]) / RANGES[k]
        found = d[basis.synthesise(moved[k], d).argmax()]
        assert np.degrees(np.arccos(found @ expected)) < 4
