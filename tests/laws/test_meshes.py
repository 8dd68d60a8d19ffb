"""Solids are closed, fill their bounds, face outwards, and measure their textures in metres."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from eagor.lab.worlds.apartment import mesh as m
from eagor.lab.worlds.scene import Material

LENGTHS = st.floats(0.05, 3)
SIZES = st.tuples(LENGTHS, LENGTHS, LENGTHS)
PLACES = st.tuples(*[st.floats(-5, 5)] * 3)
GRAINS = st.sampled_from([None, 0, 1, 2])


def volume(mesh):
    """Cubic metres; it has to be closed, and its triangles to look outwards."""
    body = trimesh.Trimesh(mesh.vertices.astype(float), mesh.triangles)
    assert body.is_watertight
    assert body.volume > 0
    return body.volume


@given(PLACES, SIZES, GRAINS)
def test_a_box_has_its_volume_and_its_texture_is_in_metres(low, size, grain):
    mesh = m.box(low, np.add(low, size), grain)
    assert volume(mesh) == pytest.approx(np.prod(size), rel=1e-3)
    edges = np.linalg.norm(np.diff(mesh.vertices[mesh.triangles], axis=1), axis=2)
    assert np.allclose(np.linalg.norm(np.diff(mesh.uv, axis=1), axis=2), edges, atol=1e-4)
    if grain is not None:
        across = np.ptp(mesh.vertices[mesh.triangles][..., grain], axis=1) > 0.5 * size[grain]
        assert np.allclose(np.ptp(mesh.uv[across][..., 0], axis=1), size[grain], atol=1e-4)


@given(PLACES, SIZES, st.floats(0.001, 0.2), st.floats(2, 8))
def test_soft_and_bevelled_boxes_fill_their_bounds(low, size, radius, power):
    high, whole = np.add(low, size), np.prod(size)
    bevel, soft = m.bevelled(low, high, radius), m.cushion(low, high, power)
    for mesh in (bevel, soft):
        assert np.allclose(m.bounds([mesh]), [low, high], atol=1e-5)
    assert 0.4 * whole < volume(soft) < whole
    r = min(radius, 0.998 * min(size) / 2)
    assert volume(bevel) == pytest.approx(whole - 2 * r**2 * sum(size) + 16 / 3 * r**3, rel=1e-3)


@given(st.floats(0.1, 2), st.floats(0.1, 2), st.integers(3, 24))
def test_round_solids_have_the_volume_of_their_polygon(radius, height, sides):
    base = sides / 2 * radius**2 * np.sin(2 * np.pi / sides)
    assert volume(m.cylinder((1, 2, 3), radius, height, sides)) == pytest.approx(base * height, rel=1e-3)
    assert volume(m.tube([(0, 0, 0), (0, height, 0)], radius, sides)) == pytest.approx(base * height, rel=1e-3)
    cone = m.lathe([(0, 0), (radius, 0), (0, height)], sides, (2.0, 1.0))
    assert volume(cone) == pytest.approx(2 * base * height / 3, rel=1e-3)


def test_a_part_measures_its_texture_in_repeats():
    piece = m.Cover(Material("plain"), (0.5, 0.25))(m.quad([(0, 0, 0), (2, 0, 0), (2, 1, 0), (0, 1, 0)]))
    assert piece.uv.reshape(-1, 2).max(axis=0) == pytest.approx([4, 4])
