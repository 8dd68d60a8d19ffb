"""What must hold for every field and every rotation."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import directions, field, random_directions, rotations

from eagor.errors import DirectionError, GridError, RotationError
from eagor.grids import ErpGrid, FisheyeGrid, PatchGrid, PerspectiveGrid
from eagor.harmonics import RealHarmonics, projection
from eagor.harmonics.legendre import degrees
from eagor.sphere import rotation

DEGREES = st.sampled_from([1, 2, 7, 12, 15, 20])
SEEDS = st.integers(0, 1000)


@given(st.sampled_from([1, 2, 7, 15, 31, 63]), SEEDS, rotations())
def test_rotating_the_field_is_rotating_its_argument(degree, seed, R):
    """Also by half turns, by nothing, and next to both, where Euler angles lose a direction."""
    basis, c, d = RealHarmonics(degree), field(degree, seed, width=0.05), random_directions(20, seed)
    error = basis.synthesise(basis.rotate(c, R), d @ R.T) - basis.synthesise(c, d)
    assert np.abs(error).max() < 1e-12 * np.abs(c).sum()


@given(DEGREES, SEEDS, rotations(), rotations())
def test_rotations_compose(degree, seed, first, second):
    basis, c = RealHarmonics(degree), field(degree, seed)
    assert np.allclose(basis.rotate(basis.rotate(c, first), second), basis.rotate(c, second @ first), atol=1e-12)


@pytest.mark.parametrize("grid", [ErpGrid(42, 90), PatchGrid(30, 60)])
@pytest.mark.parametrize("shape", [(), (2, 3)])
@pytest.mark.parametrize("degree", [1, 20])
def test_order_by_order_is_all_at_once(monkeypatch, degree, shape, grid):
    basis, rng = RealHarmonics(degree), np.random.default_rng(3)
    values, c = rng.normal(size=(*shape, *grid.shape)), rng.normal(size=(*shape, basis.size))
    wanted = basis.analyse(values, grid), basis.synthesise(c, grid)
    monkeypatch.setattr(projection, "TABLE_BYTES", 0)
    monkeypatch.setattr(projection, "BLOCK_BYTES", 1 << 14)
    for found, one in zip((basis.analyse(values, grid), basis.synthesise(c, grid)), wanted, strict=True):
        assert found.shape == one.shape
        assert np.allclose(found, one, atol=1e-12)


@given(DEGREES, SEEDS, rotations())
def test_rotations_keep_length_and_degrees_apart_and_are_undone(degree, seed, R):
    basis, c = RealHarmonics(degree), field(degree, seed)
    turned = basis.rotate(c, R)
    for l in range(degree + 1):
        part = slice(l * l, (l + 1) ** 2)
        assert np.linalg.norm(turned[part]) == pytest.approx(np.linalg.norm(c[part]), abs=1e-12)
    assert np.allclose(basis.rotate(turned, R.T), c, atol=1e-12)


@given(DEGREES, SEEDS, st.integers(-200, 200))
def test_rolling_the_panorama_is_yaw(degree, seed, columns):
    """Content moves right when the camera turns left: azimuth falls by the yaw."""
    basis, grid = RealHarmonics(degree), ErpGrid(2 * degree + 2, 100)
    image = np.random.default_rng(seed).random(grid.shape)
    yaw = 2 * math.pi * columns / grid.width
    body_R_before = rotation((0, 0, 1), -yaw)
    rolled = basis.analyse(np.roll(image, columns, axis=1), grid)
    assert np.allclose(rolled, basis.rotate(basis.analyse(image, grid), body_R_before), atol=1e-12)


@given(st.sampled_from([3, 7, 15]), SEEDS, rotations())
def test_analysis_commutes_with_rotation(degree, seed, R):
    """Rotate a band-limited field, sample, analyse = sample, analyse, rotate, to 1e-12."""
    basis, c = RealHarmonics(degree), field(degree, seed)
    grid = ErpGrid(2 * degree + 2, 4 * degree + 4)
    seen = basis.synthesise(c, grid.directions @ R)  # the value at new direction d stood at R^T d before
    assert np.abs(basis.analyse(seen, grid) - basis.rotate(c, R)).max() < 1e-12


@given(DEGREES, SEEDS, directions())
def test_reading_a_field_on_a_grid_and_at_points_agrees(degree, seed, d):
    basis, c = RealHarmonics(degree), field(degree, seed)
    grid = ErpGrid(7, 9)
    assert np.allclose(basis.synthesise(c, grid), basis.synthesise(c, grid.directions), atol=1e-12)
    assert basis.synthesise(c, d) == pytest.approx(float(basis.evaluate(d) @ c), abs=1e-12)


@given(st.sampled_from([1, 5, 9]), SEEDS)
def test_what_is_synthesised_is_analysed_again(degree, seed):
    basis, c = RealHarmonics(degree), np.random.default_rng(seed).normal(size=(2, 3, (degree + 1) ** 2))
    grid = ErpGrid(2 * degree + 1, 2 * degree + 2)
    assert np.abs(basis.analyse(basis.synthesise(c, grid), grid) - c).max() < 1e-12


@given(st.integers(2, 9), st.integers(3, 12), SEEDS)
@settings(max_examples=20)
def test_patches_are_integrated_exactly(rows, cols, seed):
    """Against the same map drawn on ever finer pixels, which converges to the same integrals from afar."""
    basis, values = RealHarmonics(7), np.random.default_rng(seed).random((rows, cols))
    exact = basis.analyse(values, PatchGrid(rows, cols))
    errors = []
    for times in (16, 64):
        fine = basis.analyse(np.kron(values, np.ones((times, times))), PatchGrid(rows * times, cols * times))
        errors.append(np.abs(fine - exact).max())
    assert max(errors) < 1e-12


@pytest.mark.parametrize("degree", [7, 15])
@pytest.mark.parametrize(
    ("make", "tolerance"),
    [
        (lambda R: PerspectiveGrid(24, 40, math.radians(100), R), 1e-4),  # cells coarser than the blocks
        (lambda R: PerspectiveGrid(160, 240, math.radians(100), R), 1e-3),  # gathered into blocks
        (lambda R: FisheyeGrid(60, math.radians(190), R), 2e-3),
    ],
)
def test_views_are_integrated_to_their_stated_accuracy(make, tolerance, degree):
    grid = make(rotation((1, 2, 3), 1.1))
    basis = RealHarmonics(degree)
    height, width = grid.shape
    y, x = np.mgrid[0:height, 0:width]
    values = 1 + np.sin(7 * x / width) * np.cos(5 * y / height)
    fine = 4
    offsets = (np.arange(fine) + 0.5) / fine
    exact = np.zeros(basis.size)
    for dy in offsets:
        for dx in offsets:
            d = grid.unproject(x + dx, y + dy)
            inside = grid.project(d)[2]
            share = np.where(inside, grid.density(x + dx, y + dy) * values, 0.0) / fine**2
            for i in range(0, height, 40):
                exact += np.einsum("ij,ijn->n", share[i : i + 40], basis.evaluate(d[i : i + 40]))
    assert np.abs(basis.analyse(values, grid) - exact).max() < tolerance * np.abs(exact).max()


@given(st.floats(0.01, 1.0), st.floats(0.01, 1.0), SEEDS)
def test_smoothing_adds_variances_and_keeps_the_mean(first, second, seed):
    basis, c = RealHarmonics(9), field(9, seed)
    together = basis.smooth(c, math.hypot(first, second))
    assert np.allclose(basis.smooth(basis.smooth(c, first), second), together, atol=1e-13)
    assert together[0] == c[0]


def test_smoothing_is_generated_by_the_laplacian():
    basis, c, step = RealHarmonics(6), field(6, 3), 1e-6
    slope = (basis.smooth(c, math.sqrt(2 * step)) - c) / step
    assert np.allclose(slope, -degrees(6) * (degrees(6) + 1) * c, atol=2e-3)


def test_batches_are_loops():
    basis, rng = RealHarmonics(7), np.random.default_rng(0)
    c = rng.normal(size=(600, 64))
    turns = np.stack([rotation(rng.normal(size=3), rng.uniform(0, 3)) for _ in range(600)])
    turns[1:4] = rotation((0, 0, 1), 0.5), np.eye(3), rotation((1, 0, 0), math.pi)  # pure yaws take a short cut
    turned = basis.rotate(c, turns)
    for i in (0, 1, 2, 3, 255, 256, 599):
        assert np.allclose(turned[i], basis.rotate(c[i], turns[i]), atol=1e-13)
    assert np.allclose(basis.rotate(c[1:3], turns[1:3]), turned[1:3], atol=1e-13), "yaws alone"
    one = basis.rotate(c[0], turns)
    assert one.shape == (600, 64)
    assert np.allclose(one[17], basis.rotate(c[0], turns[17]), atol=1e-13)
    assert np.allclose(basis.rotate(c.reshape(20, 30, 64), turns[3])[4, 5], basis.rotate(c[4 * 30 + 5], turns[3]))
    maps = rng.random((2, 3, 8, 16))
    assert np.allclose(basis.analyse(maps, PatchGrid(8, 16))[1, 2], basis.analyse(maps[1, 2], PatchGrid(8, 16)))


def test_wrong_shapes_say_what_was_wanted():
    basis = RealHarmonics(7)
    with pytest.raises(GridError, match="37, 74"):
        basis.analyse(np.zeros((74, 37)), PatchGrid(37, 74))
    with pytest.raises(GridError, match="64"):
        basis.rotate(np.zeros(63), np.eye(3))
    with pytest.raises(RotationError):
        basis.rotate(np.zeros(64), -np.eye(3))
    for points in (np.ones(4), np.ones((3, 5))):
        with pytest.raises(DirectionError, match="shape"):
            basis.evaluate(points)
        with pytest.raises(DirectionError, match="shape"):
            basis.synthesise(np.zeros(64), points)


@pytest.mark.parametrize("degree", [0, 7.0, 2.5, math.nan, "7", None])
def test_a_degree_is_a_whole_number(degree):
    with pytest.raises(GridError, match="degree"):
        RealHarmonics(degree)
    assert RealHarmonics(np.int64(7)).size == 64
