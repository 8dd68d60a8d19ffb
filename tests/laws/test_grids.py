"""Which way a cell looks, and how much of the sphere it covers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import random_directions

from eagor.cameras import Lens
from eagor.errors import GridError, RotationError
from eagor.grids import ErpGrid, FisheyeGrid, PatchGrid, PerspectiveGrid, fejer_weights
from eagor.sphere import angular_distance, direction

OFF_CENTRE = Lens("phone", (64, 36), (40.0, 44.0), (30.0, 20.0))
DISTORTED = Lens("wide", (640, 360), (330.0, 332.0), (318.0, 176.0), (-0.28, 0.09, 0.0007, -0.0004, -0.013))
VIEWS = [
    PerspectiveGrid(36, 64, math.radians(100)),
    FisheyeGrid(48, math.radians(190)),
    PerspectiveGrid.of_lens(OFF_CENTRE),
    PerspectiveGrid.of_lens(DISTORTED),
]
WHOLE = [ErpGrid(9, 20), PatchGrid(9, 20), ErpGrid(64, 128), PatchGrid(37, 74)]


@pytest.mark.parametrize("grid", [ErpGrid(4, 8), PatchGrid(4, 8)])
def test_the_image_centre_is_forward_left_is_left_and_the_seam_is_behind(grid):
    d = grid.directions
    assert np.allclose(d[1:3, 3:5].sum(axis=(0, 1)) / np.linalg.norm(d[1:3, 3:5].sum(axis=(0, 1))), [1, 0, 0])
    assert d[2, 2, 1] > 0, "left of the centre is the body's left"
    assert d[0, 0, 2] > 0, "the top row looks up"
    assert d[1, 0, 0] < 0, "the first column looks behind ..."
    assert d[1, 0, 1] > 0, "... on the left side"
    assert d[1, 7, 1] < 0
    # Pixel centres: azimuth = pi - 2 pi (j + 1/2) / W.
    assert np.allclose(d[1, 2], direction(math.pi - 2 * math.pi * 2.5 / 8, math.pi / 2 - math.pi * 1.5 / 4))


def test_patch_weights_are_exact_and_fejer_weights_integrate_polynomials():
    top = 2 * math.pi * (1 - math.sin(math.pi / 2 - math.pi / 9))
    assert PatchGrid(9, 20).weights[0].sum() == pytest.approx(top, rel=1e-13)
    x = np.sin(ErpGrid(12, 1).latitudes)
    for power in range(12):
        exact = 2 / (power + 1) if power % 2 == 0 else 0.0
        assert fejer_weights(12) @ x**power == pytest.approx(exact, abs=1e-14)
    assert abs(np.cos(ErpGrid(12, 1).latitudes).sum() * math.pi / 12 - 2) > 1e-3, "plain cos(latitude) is not exact"


@pytest.mark.parametrize("grid", WHOLE + VIEWS)
def test_projecting_undoes_unprojecting(grid):
    rng = np.random.default_rng(0)
    height, width = grid.shape
    x, y = width * (0.2 + 0.6 * rng.random(50)), height * (0.2 + 0.6 * rng.random(50))
    back_x, back_y, inside = grid.project(grid.unproject(x, y))
    assert np.allclose(back_x, x)
    assert np.allclose(back_y, y)
    assert inside.all()


@pytest.mark.parametrize("grid", WHOLE + VIEWS)
def test_cell_weights_are_the_integral_of_the_density(grid):
    height, width = grid.shape
    nodes, weights = np.polynomial.legendre.leggauss(4)
    row, column = height // 2, width // 3
    x = column + (nodes + 1) / 2
    y = (row + (nodes + 1) / 2)[:, None]
    area = (grid.density(x, y) * weights * weights[:, None]).sum() / 4
    # Fejer's are quadrature weights, not areas; a fisheye's are sampled; the others are exact.
    tolerance = {ErpGrid: 20 / height**2, FisheyeGrid: 1e-4}.get(type(grid), 1e-6)
    assert area == pytest.approx(grid.weights[row, column], rel=tolerance)


def test_a_perspective_view_covers_its_solid_angle():
    """A rectangle seen from distance 1: 4 asin(ab / sqrt((1 + a^2)(1 + b^2)))."""
    grid = PerspectiveGrid(36, 64, math.radians(100))
    a, b = math.tan(math.radians(50)), math.tan(math.radians(50)) * 36 / 64
    exact = 4 * math.asin(a * b / math.sqrt((1 + a * a) * (1 + b * b)))
    assert grid.weights.sum() == pytest.approx(exact, rel=1e-12)


def test_a_fisheye_covers_its_cap():
    grid = FisheyeGrid(200, math.radians(190))
    assert grid.weights.sum() == pytest.approx(2 * math.pi * (1 - math.cos(math.radians(95))), rel=1e-3)
    assert grid.weights[0, 0] == 0, "the corners see nothing"
    assert FisheyeGrid(50, 2 * math.pi).depth_inside() is None


@pytest.mark.parametrize("grid", VIEWS)
def test_depth_inside_is_the_distance_to_the_unseen(grid):
    sphere = random_directions(200_000)
    unseen = sphere[~grid.project(sphere)[2]]
    depth = grid.depth_inside()
    for row, column in [(18, 32), (5, 20), (30, 40)]:
        if grid.weights[row, column] > 0:
            nearest = angular_distance(unseen, grid.directions[row, column]).min()
            assert depth[row, column] == pytest.approx(nearest, abs=0.02)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: ErpGrid(0, 8), "at least one row"),
        (lambda: PatchGrid(4, -1), "at least one row"),
        (lambda: PerspectiveGrid(4, 4, 0.0), "needs 0 < hfov < pi"),
        (lambda: PerspectiveGrid(10, 10, 90), "radians"),
        (lambda: PerspectiveGrid(10, 10, 1.0, -np.eye(3)), "reflection"),
        (lambda: FisheyeGrid(0, 1.0), "size >= 1"),
        (lambda: FisheyeGrid(10, 7.0), "radians"),
    ],
)
def test_impossible_grids_are_refused(make, says):
    with pytest.raises((GridError, RotationError), match=says):
        make()


def test_grids_hand_out_what_nobody_can_change():
    with pytest.raises(ValueError, match="read-only"):
        ErpGrid(4, 8).directions[0, 0, 0] = 5.0


@given(st.integers(1, 40), st.integers(1, 60))
def test_any_size_has_a_full_sphere(height, width):
    for grid in (ErpGrid(height, width), PatchGrid(height, width)):
        assert grid.directions.shape == (height, width, 3)
        assert grid.weights.sum() == pytest.approx(4 * math.pi, rel=1e-13)
        assert (grid.weights > 0).all()
