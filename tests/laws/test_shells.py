"""The shell warp: parallax in coefficient space."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import field, rotations

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
