"""What pictures of a scene must obey, whatever the scene, the pose and the grid."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rooms import two_rooms
from strategies import at_most, rotations

from eagor.errors import GridError, PoseError, RotationError
from eagor.grids import ErpGrid, FisheyeGrid, PatchGrid, PerspectiveGrid
from eagor.lab.worlds import light as light_module
from eagor.lab.worlds.light import Lattice, bake, light_of
from eagor.lab.worlds.render import Renderer
from eagor.lab.worlds.scene import Instance, Lamp, Material, Scene
from eagor.sphere import rotation, world_R_body

SIZE = np.array([5.0, 4.0, 2.6])
EYE = (2.2, 2.7, 1.4)


def scene_of(faces, material, **more):
    """One thing of faces: a corner and two sides each, seen from the side that their product points to; uv 0 to 1."""
    corner, along, up = (np.array(part, dtype=np.float32) for part in zip(*faces, strict=True))
    vertices = np.stack([corner, corner + along, corner + along + up, corner + up], axis=1).reshape(-1, 3)
    triangles = (4 * np.arange(len(faces))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    uv = np.tile(np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)[[[0, 1, 2], [0, 2, 3]]], (len(faces), 1, 1))
    zeros, thing = np.zeros(len(triangles), np.int32), Instance("wall", None, None, vertices.min(0), vertices.max(0))
    return Scene(vertices, triangles.astype(np.int32), zeros, zeros, uv, (thing,), (material,), **more)


def bare():
    """An empty white room without a source of light."""
    (x, y, z), o = np.diag(SIZE), np.zeros(3)
    faces = [(o, x, y), (z, y, x), (o, z, x), (o, y, z), (x, z, y), (y, x, z)]
    return scene_of(faces, Material("white", (0.8, 0.8, 0.8)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("light")


@pytest.fixture(autouse=True)
def _own_cache(folder, monkeypatch):
    monkeypatch.setenv("EAGOR_CACHE", str(folder))


@pytest.fixture(scope="module")
def renderer(folder):
    return Renderer(two_rooms(), cache=folder)


@given(st.floats(-math.pi, math.pi), st.integers(-70, 70), st.sampled_from([16, 33]))
@at_most(40)
def test_turning_by_whole_columns_rolls_the_panorama_bit_for_bit(renderer, start, columns, height):
    turn = columns * 2 * math.pi / (2 * height)
    before = renderer.panorama(EYE, world_R_body(start), height)
    after = renderer.panorama(EYE, world_R_body(start + turn), height)
    for name in ("rgb", "range", "ids"):
        # Turning left moves what is seen to the right.
        assert np.array_equal(np.roll(getattr(before, name), columns, axis=1), getattr(after, name))


@given(rotations())
@settings(max_examples=25)
def test_range_in_an_empty_room_is_the_closed_form_in_any_pose(pose):
    frame = Renderer(bare()).panorama(EYE, pose, 16, rgb=False)
    ways = ErpGrid(16, 32).directions @ pose.T
    with np.errstate(divide="ignore"):
        expected = np.min(np.where(ways > 0, (SIZE - EYE) / ways, -np.array(EYE) / ways), axis=-1)
    assert np.allclose(frame.range, expected, rtol=1e-4)
    assert (frame.range.dtype, frame.ids.dtype) == (np.float32, np.int32)
    assert not frame.ids.any()


GRIDS = {
    "perspective": PerspectiveGrid(40, 60, math.radians(80), rotation((0, 0, 1), 0.4)),
    "patches": PatchGrid(9, 20),
    "fisheye": FisheyeGrid(40, math.radians(190)),
    "erp": ErpGrid(32, 64),
}


@pytest.mark.parametrize("name", GRIDS)
def test_a_view_agrees_with_the_panorama_and_what_a_grid_does_not_see_is_black_endless_and_nothing(renderer, name):
    grid, pose = GRIDS[name], world_R_body(0.7, 0.2, -0.3)
    view = renderer.view(EYE, pose, grid)
    panorama = renderer.panorama(EYE, pose, 180)
    x, y, _ = ErpGrid(180, 360).project(grid.directions)
    row, column = np.clip(y.astype(int), 0, 179), x.astype(int) % 360
    seen = grid.weights > 0
    same = (panorama.ids[row, column] == view.ids) & seen
    assert view.rgb.shape == (*grid.shape, 3)
    assert same[seen].mean() > 0.95
    ratio = panorama.range[row, column] / np.where(np.isfinite(view.range), view.range, np.nan)
    assert np.nanmedian(np.abs(ratio - 1)[same]) < 0.01
    assert np.quantile(np.abs(panorama.rgb[row, column].astype(int) - view.rgb)[same], 0.9) <= 6
    assert not view.rgb[~seen].any()
    assert np.isinf(view.range[~seen]).all()
    assert (view.ids[~seen] == -1).all()


def test_light_of_one_lamp_is_the_inverse_square_law():
    power = np.array([3.0, 2.0, 1.0])
    lamps = (Lamp(np.array([0, 0, 2.0]), power),)
    scene = scene_of([([-4, -4, 0], [8, 0, 0], [0, 8, 0])], Material("black", (0, 0, 0)), lamps=lamps)
    scene = replace(scene, daylight=(0.0, 0.0, 0.0))
    lattice = Lattice.of(scene)
    position, _, of_slot = lattice.points
    found, place = bake(scene, lattice), position[of_slot]
    square = (place**2)[:, :2].sum(axis=1) + 4
    expected = 2 / square[:, None] ** 1.5 * power
    inner = square < 13
    assert np.allclose(found[inner], expected[inner], rtol=0.03)


def test_light_is_kept_on_disk_for_the_same_walls_and_rooms_and_made_anew_if_it_is_damaged(tmp_path, monkeypatch):
    scene = two_rooms()
    lattice = Lattice.of(scene)
    light = light_of(scene, lattice, cache=tmp_path)
    (file,) = tmp_path.iterdir()
    for damaged in (b"", b"not an archive", file.read_bytes()[:-200]):
        file.write_bytes(damaged)
        assert np.array_equal(light_of(scene, lattice, cache=tmp_path), light)
    monkeypatch.setattr(light_module, "bake", lambda *_: pytest.fail("the light was in the cache"))
    assert np.array_equal(light_of(scene, lattice, cache=tmp_path), light)
    closed = replace(scene, rooms=())  # without rooms nobody knows which windows lead outdoors
    assert closed.hash == scene.hash
    with pytest.raises(pytest.fail.Exception):
        light_of(closed, Lattice.of(closed), cache=tmp_path)


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda r: r.panorama((1, 2), np.eye(3), 8), PoseError),
        (lambda r: r.panorama((1, 2, math.nan), np.eye(3), 8), PoseError),
        (lambda r: r.panorama(EYE, np.ones((3, 3)), 8), RotationError),
        (lambda r: r.view(EYE, -np.eye(3), ErpGrid(4, 8)), RotationError),
        (lambda r: r.panorama(EYE, np.eye(3), 0), GridError),
    ],
)
def test_bad_arguments_are_refused(renderer, call, error):
    with pytest.raises(error):
        call(renderer)
