"""Fields on small grids: splines as SciPy has them, and which cells of a sphere a patch covers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from eagor import ErpGrid
from eagor.belief.field import Patch, SphereField, interpolated


@pytest.mark.parametrize("shape", [(11, 9), (12, 11, 7)])
def test_splines_are_those_of_scipy(shape):
    rng = np.random.default_rng(0)
    ends = np.array(shape) - 1.0
    fields, places = rng.normal(size=(2, *shape)), rng.random((len(shape), 40, 5)) * ends[:, None, None]
    places[:, 0, 0], places[:, 0, 1] = 0.0, ends
    theirs = [map_coordinates(field, places, order=3, mode="mirror") for field in fields]
    np.testing.assert_allclose(interpolated(fields, places), theirs, atol=1e-12)
    np.testing.assert_allclose(interpolated(fields[0], places), theirs[0], atol=1e-12)


def test_the_cells_of_a_patch_are_those_whose_middles_lie_inside():
    grid = ErpGrid(32, 64)
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    patch = Patch(turn, np.array([0.3, 0.2]), np.zeros((5, 5)))
    inside = patch.places(grid.directions)[1]
    assert 0 < inside.sum() == len(patch.cells(grid))
    assert inside.reshape(-1)[patch.cells(grid)].all()
    assert (SphereField(grid, np.zeros(grid.shape), (patch,)).layout.outside == ~inside).all()


def test_a_field_goes_on_across_the_seam_and_the_poles():
    grid = ErpGrid(48, 96)
    way = np.array([0.3, -0.5, 0.81])
    field = SphereField(grid, grid.directions @ way)
    around = np.linspace(0, 2 * np.pi, 50)
    ring = np.array([np.cos(around), 0 * around, np.sin(around)]).T  # over both poles
    level = np.array([np.cos(around), np.sin(around), 0 * around]).T  # across the seam
    for directions in (ring, level):
        np.testing.assert_allclose(field(directions), directions @ way, atol=1e-3)
    assert float(field.smooth(ring[3], 1)) == pytest.approx(ring[3] @ way, abs=0.01)
