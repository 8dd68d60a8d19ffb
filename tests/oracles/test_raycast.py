"""Ray casting against closed forms."""

import sys

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import random_directions

from eagor.errors import MissingExtraError
from eagor.lab.worlds.scene import Raycaster

LOW, HIGH = np.array([-3.0, -2.0, 0.0]), np.array([4.0, 2.5, 2.6])


def box():
    """The vertices and the 12 triangles of the axis-aligned box from LOW to HIGH."""
    mesh = trimesh.creation.box(bounds=[LOW, HIGH])
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def soup(count, seed, size=0.4):
    """`count` random triangles in a cube of side 2, and 400 rays that begin in it, some along an axis."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    origins = rng.uniform(-1, 1, (400, 3)).astype(np.float32)
    directions = random_directions(400, seed).astype(np.float32)
    directions[:24] = np.tile(np.concatenate([np.eye(3), -np.eye(3)]), (4, 1))
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), origins, directions


def test_range_in_a_box_is_the_closed_form():
    caster = Raycaster(*box())
    rng = np.random.default_rng(1)
    origins = rng.uniform(LOW + 0.01, HIGH - 0.01, (2000, 3)).astype(np.float32)
    directions = random_directions(2000, 2).astype(np.float32)
    directions[:6] = np.concatenate([np.eye(3), -np.eye(3)])
    walls = np.where(directions > 0, HIGH, LOW)
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.nanmin(np.where(directions == 0, np.inf, (walls - origins) / directions), axis=1)
    found = caster.cast(origins, directions)
    assert np.allclose(found.distance, expected, atol=1e-5)
    assert found.triangle.min() >= 0
    assert (found.distance.dtype, found.triangle.dtype) == (np.float32, np.int32)


@given(st.integers(1, 100), st.integers(0, 2**32 - 1), st.floats(0.05, 2.0))
@settings(max_examples=15)
def test_occluded_is_what_cast_finds_within_reach(count, seed, reach):
    vertices, triangles, origins, directions = soup(count, seed)
    reaches = np.linspace(0.5, 1.5, len(origins)) * reach
    caster = Raycaster(vertices, triangles)
    distance = caster.cast(origins, directions).distance
    finite = np.isfinite(distance)
    for limit in (reach, reaches, np.inf):
        clear = ~finite | (np.abs(np.where(finite, distance, 0) - limit) > 1e-4)
        expected = finite & (distance <= limit)
        assert np.array_equal(caster.occluded(origins, directions, limit)[clear], expected[clear])


def test_without_embree_the_error_says_what_does_without(monkeypatch):
    monkeypatch.setitem(sys.modules, "embreex", None)
    monkeypatch.delitem(sys.modules, "embreex.mesh_construction", raising=False)
    with pytest.raises(MissingExtraError, match=r"pip install .*\[sim\].*eagor\.lab\.worlds\.painted"):
        Raycaster(*box())
