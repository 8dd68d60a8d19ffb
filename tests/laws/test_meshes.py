"""Primitives: where they lie, that they are closed and wound outwards, and that their texture is measured in metres."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from strategies import at_most, rotations

from eagor.lab.worlds.apartment import mesh as m
from eagor.lab.worlds.scene import Material

LENGTHS = st.floats(0.05, 2.0)
SIZES = st.tuples(LENGTHS, LENGTHS, LENGTHS)
PLACES = st.tuples(*[st.floats(-3, 3)] * 3)


def volume(mesh):
    a, b, c = (mesh.vertices.astype(float) - mesh.low)[mesh.triangles].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", np.cross(a, b), c)) / 6


def areas(mesh):
    a, b, c = mesh.vertices.astype(float)[mesh.triangles].transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def texture_areas(mesh):
    (ax, ay), (bx, by) = (
        (mesh.uv[:, 1] - mesh.uv[:, 0]).T.astype(float),
        (mesh.uv[:, 2] - mesh.uv[:, 0]).T.astype(float),
    )
    return np.abs(ax * by - ay * bx) / 2


def is_closed(mesh):
    """Every edge is walked once in each direction, once vertices at the same place are one."""
    places = np.round((mesh.vertices - mesh.low) / np.ptp(mesh.vertices, axis=0).max(), 5)
    _, welded = np.unique(places, axis=0, return_inverse=True)
    triangles = welded.reshape(-1)[mesh.triangles]
    edges = [tuple(edge) for pair in ((0, 1), (1, 2), (2, 0)) for edge in triangles[:, pair].tolist()]
    return len(set(edges)) == len(edges) and {(b, a) for a, b in edges} == set(edges)


def is_sound(mesh):
    assert mesh.vertices.dtype == np.float32
    assert mesh.uv.dtype == np.float32
    assert mesh.triangles.dtype == np.int32
    assert np.isfinite(mesh.vertices).all()
    assert np.isfinite(mesh.uv).all()
    assert mesh.uv.shape == (len(mesh.triangles), 3, 2)
    assert set(np.unique(mesh.triangles)) == set(range(len(mesh.vertices)))
    assert areas(mesh).min() > 1e-9
    return True


def fills(mesh, low, high):
    return np.allclose(mesh.low, low, atol=1e-5) and np.allclose(mesh.high, high, atol=1e-5)


@given(PLACES, SIZES, st.sampled_from([None, 0, 1, 2]))
def test_a_box_has_its_volume_and_its_texture_is_in_metres(low, size, grain):
    low = np.array(low)
    made = m.box(low, low + size, grain)
    assert is_sound(made)
    assert is_closed(made)
    assert fills(made, low, low + size)
    assert volume(made) == pytest.approx(math.prod(size), rel=1e-3)
    assert np.allclose(texture_areas(made), areas(made), rtol=1e-3, atol=1e-6)


@given(SIZES, st.sampled_from([0, 1, 2]))
def test_grain_runs_along_u(size, grain):
    made = m.box((0, 0, 0), size, grain)
    corners = made.vertices[made.triangles]
    holds = np.ptp(corners[:, :, grain], axis=1) > 0
    assert np.allclose(made.uv[holds, :, 0], corners[holds, :, grain])
    board = m.board((0, 0, 0), size)
    assert np.abs(board.uv[..., 0]).max() == pytest.approx(max(size), rel=1e-5)


@given(PLACES, SIZES, st.floats(0.001, 0.5), st.integers(1, 4))
def test_a_bevelled_box_fills_its_box_and_loses_little(low, size, radius, segments):
    low = np.array(low)
    radius = min(radius, 0.49 * min(size))
    made = m.bevelled(low, low + size, radius, segments)
    assert is_sound(made)
    assert is_closed(made)
    assert fills(made, low, low + size)
    x, y, z = size
    inner = (x - 2 * radius) * (y - 2 * radius) * (z - 2 * radius)
    assert inner < volume(made) <= x * y * z
    # From inside, as an octahedron for one segment, to the round solid (Steiner's formula) for many.
    a, b, c = (np.array(size) - 2 * radius).tolist()
    steiner = a * b * c + 2 * radius * (a * b + b * c + c * a) + math.pi * radius**2 * (a + b + c) + 4.19 * radius**3
    assert volume(made) <= 1.001 * steiner


@given(PLACES, SIZES, st.floats(0.0, 0.2), st.floats(0.01, 0.3))
def test_a_cushion_stays_in_its_box_and_reaches_its_faces(low, size, puff, radius):
    low = np.array(low)
    made = m.cushion(low, low + size, puff, radius)
    assert is_sound(made)
    assert is_closed(made)
    assert (made.low >= low - 1e-5).all()
    assert (made.high <= low + size + 1e-5).all()
    assert np.allclose(made.high - made.low, size, atol=1e-5)
    assert 0.3 * math.prod(size) < volume(made) < math.prod(size)


@given(LENGTHS, LENGTHS, st.floats(0.05, 0.3), st.integers(3, 8))
def test_a_pillow_is_closed_and_thickest_in_the_middle(width, height, thickness, cells):
    made = m.pillow(width, height, thickness, cells)
    assert is_sound(made)
    assert is_closed(made)
    assert volume(made) > 0.2 * width * height * thickness
    assert np.allclose(made.high[1:], [width / 2, height / 2], atol=1e-5)
    assert made.high[0] <= thickness / 2 + 1e-6


@given(PLACES, LENGTHS, LENGTHS, st.integers(3, 32))
def test_a_cylinder_has_the_volume_of_its_polygon(centre, radius, height, sides):
    made = m.cylinder(centre, radius, height, sides)
    polygon = sides / 2 * math.sin(2 * math.pi / sides) * radius**2
    assert is_sound(made)
    assert is_closed(made)
    assert volume(made) == pytest.approx(polygon * height, rel=1e-3)
    assert made.low[2] == pytest.approx(centre[2], abs=1e-5)


@given(st.lists(st.floats(0.05, 1.0), min_size=1, max_size=8), st.integers(3, 24))
def test_a_lathed_shape_on_the_axis_is_closed(radii, sides):
    profile = [(0.0, 0.0), *((r, 0.2 * k + 0.1) for k, r in enumerate(radii)), (0.0, 0.2 * len(radii) + 0.1)]
    made = m.lathe(profile, sides)
    assert is_sound(made)
    assert is_closed(made)
    assert volume(made) > 0


@given(st.integers(0, 2**32 - 1), st.integers(3, 12))
def test_a_tube_keeps_its_thickness_round_bends_and_does_not_twist(seed, sides):
    rng = np.random.default_rng(seed)
    turns = rng.normal(size=(5, 3)) * 0.5 + rng.normal(size=3)
    path = np.cumsum(turns / np.linalg.norm(turns, axis=1, keepdims=True), axis=0)
    legs = np.diff(path, axis=0)
    assume((np.einsum("ij,ij->i", legs[:-1], legs[1:]) > -0.5).all())
    made = m.tube(path, 0.02, sides)
    polygon = sides / 2 * math.sin(2 * math.pi / sides) * 0.02**2
    assert is_sound(made)
    assert is_closed(made)
    # A mitred bar of even section has the volume of its axis times its section; its corners cannot be off the axis.
    assert volume(made) == pytest.approx(polygon * np.linalg.norm(legs, axis=1).sum(), rel=2e-2)


def test_a_handle_bent_twice_by_right_angles_is_a_whole_tube():
    made = m.tube([(0, 0, 0), (0.1, 0, 0), (0.1, 0.5, 0), (0, 0.5, 0)], 0.01, 8)
    assert volume(made) == pytest.approx(4 * math.sin(math.pi / 4) * 1e-4 * 0.7, rel=1e-3)


@given(LENGTHS, LENGTHS, st.floats(0.01, 0.5), st.integers(1, 6))
def test_a_prism_has_the_volume_of_its_outline(width, depth, radius, segments):
    outline = m.rounded_rectangle(width, depth, radius, segments)
    x, y = outline.T
    area = 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    made = m.prism(outline, 0.1, 0.4)
    assert 0.5 * width * depth <= area <= width * depth
    assert is_sound(made)
    assert is_closed(made)
    assert volume(made) == pytest.approx(0.3 * area, rel=1e-3)
    assert (made.low[2], made.high[2]) == (pytest.approx(0.1), pytest.approx(0.4))


@given(st.booleans(), st.integers(3, 9), st.integers(2, 7))
def test_a_lofted_bar_of_even_section_is_its_prism(smooth, corners, rings):
    angle = np.arange(corners) * (2 * math.pi / corners)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    stations = np.empty((rings, corners, 3))
    stations[..., :2], stations[..., 2] = ring, np.linspace(0, 1, rings)[:, None]
    made = m.loft(stations, smooth)
    assert is_sound(made)
    assert is_closed(made)
    assert volume(made) == pytest.approx(corners / 2 * math.sin(2 * math.pi / corners), rel=1e-3)


@given(st.integers(0, 2**32 - 1), st.integers(2, 8), st.integers(2, 8))
def test_a_slab_is_closed_and_as_thick_as_asked(seed, rows, columns):
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(np.arange(rows) * 0.3, np.arange(columns) * 0.3, indexing="ij")
    z = rng.uniform(-0.02, 0.02, x.shape)
    made = m.slab(np.stack([x, y, z], axis=-1), 0.05)
    assert is_sound(made)
    assert is_closed(made)
    assert volume(made) == pytest.approx(0.05 * areas(m.sheet(np.stack([x, y, z], axis=-1))).sum(), rel=0.1)
    assert made.low[2] < -0.03  # below the sheet, whose outside is where columns x rows points: up


@given(rotations(), PLACES)
def test_moving_turning_and_mirroring_keep_volume_and_outside(R, offset):
    made = m.cushion((0, 0, 0), (0.5, 0.7, 0.2))
    want = volume(made)
    assert volume(m.turned(m.moved(made, offset), R, offset)) == pytest.approx(want, rel=1e-3)
    assert volume(m.mirrored(m.moved(made, offset))) == pytest.approx(want, rel=1e-3)
    both = m.merged(made, m.moved(made, (2, 0, 0)))
    assert is_sound(both)
    assert volume(both) == pytest.approx(2 * want, rel=1e-3)


def test_a_part_measures_its_texture_in_repeats():
    face = m.quad([(0, 0, 0), (2, 0, 0), (2, 0, 1), (0, 0, 1)])
    assert np.allclose(m.part(face, Material("plain"), 0.5).uv.reshape(-1, 2).max(axis=0), [4, 2])
    assert np.allclose(m.part(face, Material("whole"), (2.0, 1.0)).uv.reshape(-1, 2).max(axis=0), [1, 1])


test_a_tube_keeps_its_thickness_round_bends_and_does_not_twist = at_most(40)(
    test_a_tube_keeps_its_thickness_round_bends_and_does_not_twist
)
