"""Lenses and stitching: projecting and its inverse, agreement with other code, and that nothing is lost on the way."""

import math

import numpy as np
import pytest
import rigs
from hypothesis import given
from hypothesis import strategies as st
from rigs import seen_by
from strategies import directions, rotations

from eagor.cameras import Lens, Rig, dual_fisheye
from eagor.errors import GridError, ImageError
from eagor.grids import ErpGrid, FisheyeGrid, PerspectiveGrid
from eagor.lab.worlds.painted import painted_room
from eagor.sources.rigs import read_rig, write_rig
from eagor.sources.stitching import Stitcher
from eagor.sphere import angular_distance, world_R_body

cv2 = pytest.importorskip("cv2")


@st.composite
def fisheyes(draw):
    """A fisheye with a curve that is not straight, at any place and pose."""
    polynomial = [draw(st.floats(-0.03, 0.03)), draw(st.floats(-0.004, 0.004)), draw(st.floats(0.0, 0.0004))]
    return Lens.fisheye(
        "lens",
        (200, 200),
        (draw(st.floats(90, 110)), draw(st.floats(90, 110))),
        draw(st.floats(60, 120)),
        math.radians(draw(st.floats(120, 220))),
        distortion=tuple(polynomial),
        body_R_lens=draw(rotations()),
    )


@given(fisheyes(), directions())
def test_a_fisheye_sees_a_direction_at_the_pixel_that_looks_there(lens, direction):
    x, y, depth = lens.project(direction)
    if depth > 1e-6:
        assert angular_distance(lens.unproject(x, y), direction) < 1e-6
        assert np.hypot(x - lens.centre[0], y - lens.centre[1]) <= lens.radius + 1e-6
    axis = angular_distance(direction, lens.body_R_lens[:, 0])
    assert depth == pytest.approx(lens.reach - axis, abs=1e-9)


@given(fisheyes())
def test_the_rim_is_at_the_reach(lens):
    rim = lens.unproject(lens.centre[0] + lens.radius, lens.centre[1])
    assert angular_distance(rim, lens.body_R_lens[:, 0]) == pytest.approx(lens.reach, abs=2e-4)


@given(rotations(), st.floats(1.0, 2 * math.pi))
def test_without_a_curve_the_angle_grows_with_the_radius_and_a_grid_samples_it(rotation, fov):
    grid = FisheyeGrid(64, fov, rotation)
    lens = Lens("lens", (64, 64), (64 / fov,) * 2, (32, 32), (), rotation, kind="fisheye", radius=32)
    right, down = np.array([-22.0, 8.0, 1e-9]), np.array([-11.5, 1.0, 0.0])
    angle, around = np.hypot(right, down) * fov / 64, np.arctan2(down, right)
    rays = np.stack([np.cos(angle), -np.sin(angle) * np.cos(around), -np.sin(angle) * np.sin(around)], axis=-1)
    for seen in (lens, grid):
        assert np.abs(seen.unproject(32 + right, 32 + down) - rays @ rotation.T).max() < 1e-12
        x, y, inside = seen.project(rays @ rotation.T)
        assert np.abs([x - 32 - right, y - 32 - down]).max() < 1e-9
        assert (inside > 0).all()


def test_an_ideal_fisheye_may_see_all_around_and_no_more():
    everything = Lens("lens", (100, 100), (50 / math.pi,) * 2, (50, 50), kind="fisheye", radius=50.0)
    assert everything.reach == pytest.approx(math.pi, abs=1e-12)
    assert everything.project(np.array([-1.0, 0, 0]))[2] == pytest.approx(0, abs=1e-12)
    with pytest.raises(GridError, match="never reaches the radius of 50 pixels within 180 degrees"):
        Lens("lens", (100, 100), (49 / math.pi,) * 2, (50, 50), kind="fisheye", radius=50.0)


@given(rotations(), st.floats(0.1, math.radians(179)))
def test_without_distortion_a_pinhole_is_a_plane_and_a_grid_samples_it(rotation, hfov):
    grid = PerspectiveGrid(48, 64, hfov, rotation)
    focal = 32 / math.tan(hfov / 2)
    lens = Lens("lens", (64, 48), (focal, focal), (32, 24), (), rotation)
    right, down = np.array([-29.0, 31.0, 0.0]), np.array([-23.0, 23.0, 0.0])
    rays = np.column_stack([np.full(3, focal), -right, -down])
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    for seen in (lens, grid):
        assert np.abs(seen.unproject(32 + right, 24 + down) - rays @ rotation.T).max() < 1e-12
        x, y, inside = seen.project(rays @ rotation.T)
        assert np.abs([x - 32 - right, y - 24 - down]).max() < 1e-7
        assert (inside > 0).all()
        assert not (seen.project(-rays @ rotation.T)[2] > 0).any()


def test_the_distortion_is_that_of_opencv():
    coefficients = (-0.21, 0.05, 0.001, -0.002, 0.01, 0.02, -0.01, 0.003)
    lens = Lens("lens", (640, 480), (410.0, 405.0), (322.0, 238.0), coefficients)
    plane = np.random.default_rng(3).uniform(-0.6, 0.6, (50, 2)) * (1, 0.8)  # right, down at distance 1
    rays = np.column_stack([np.ones(50), -plane])
    x, y, depth = lens.project(rays / np.linalg.norm(rays, axis=1, keepdims=True))
    matrix = np.array([[410.0, 0, 322.0], [0, 405.0, 238.0], [0, 0, 1]])
    points = np.column_stack([plane, np.ones(50)])
    wanted, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(coefficients))
    inside = depth > 0
    assert inside.sum() > 20
    assert np.abs(np.column_stack([x, y])[inside] - wanted.reshape(-1, 2)[inside]).max() < 1e-6
    again = lens.unproject(x[inside], y[inside])
    assert angular_distance(again, rays[inside]).max() < 1e-6


def test_a_pinhole_sees_nothing_behind_it_or_far_outside():
    """The polynomial of a strong distortion comes back into the picture beyond its corners."""
    lens = Lens("lens", (640, 480), (400.0, 400.0), (320.0, 240.0), (-0.35, 0.1))
    angles = np.radians([50, 60, 75, 88, 100, 150, 180])
    rays = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    assert (lens.project(rays)[2] < 0).all()
    assert lens.project(np.array([1.0, 0, 0]))[2] > 0.4


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"focal": (-1.0, 30.0)}, "above 0"),
        ({"radius": -1.0}, "above 0"),
        ({"distortion": (1,) * 9}, "eight numbers"),
        ({"distortion": (-0.5,)}, "turns back"),
        ({"focal": (10.0, 10.0)}, "never reaches"),
    ],
)
def test_values_that_no_lens_has_are_refused(change, says):
    settings = {"name": "lens", "size": (100, 100), "focal": (30.0, 30.0), "centre": (50.0, 50.0)}
    settings |= {"kind": "fisheye", "radius": 50.0} | change
    with pytest.raises(GridError, match=says):
        Lens(**settings)


# --- stitching -------------------------------------------------------------------------------------------------------


def loss(found, wanted):
    """Peak signal-to-noise ratio in dB, each pixel with its solid angle."""
    weights = ErpGrid(*wanted.shape[:2]).weights
    error = ((found.astype(float) - wanted) ** 2).mean(axis=2)
    return 10 * math.log10(255**2 * weights.sum() / (error * weights).sum())


def test_a_panorama_survives_an_ideal_dual_fisheye():
    """The issue's bar: 50 dB. The panorama holds no detail that is finer than the lens."""
    rig = dual_fisheye(960, 480)
    rough = painted_room(rig.rows, 2 * rig.rows)
    stitcher = Stitcher(rig)
    smooth = stitcher.stitch(*seen_by(rig, cv2.GaussianBlur(rough, (0, 0), 0.8)))
    again = stitcher.stitch(*seen_by(rig, smooth))
    assert loss(again, smooth) > 50
    assert 10 * math.log10(255**2 / ((again.astype(float) - smooth) ** 2).mean()) > 50
    assert stitcher.unseen is None


@pytest.mark.parametrize("rows", [None, 128, pytest.param(300, marks=pytest.mark.slow)])
def test_what_a_distorted_rig_saw_is_put_together_at_any_size(rows):
    rig = rigs.distorted_rig(256)
    room = cv2.GaussianBlur(painted_room(512, 1024), (0, 0), 3)
    stitcher = Stitcher(rig, rows)
    found = stitcher.stitch(*seen_by(rig, room))
    wanted = cv2.resize(room, found.shape[1::-1], interpolation=cv2.INTER_AREA)
    assert found.shape == (*stitcher.grid.shape, 3)
    assert loss(found, wanted) > 33


def test_pictures_of_another_size_are_scaled_and_those_of_another_shape_refused():
    rig = dual_fisheye(512, 256)
    pictures = seen_by(rig, painted_room(256, 512))
    twice = cv2.resize(pictures[0], (1024, 512), interpolation=cv2.INTER_CUBIC)
    stitcher = Stitcher(rig, 128)
    assert loss(stitcher.stitch(twice), stitcher.stitch(*pictures)) > 30
    with pytest.raises(ImageError, match=r"640 x 480.*512 x 256"):
        Stitcher(rig).stitch(np.zeros((480, 640, 3), np.uint8))
    with pytest.raises(ImageError, match="2 pictures"):
        Stitcher(rig).stitch(*pictures, *pictures)


def test_what_no_lens_sees_is_black_and_masked():
    lens = Lens.fisheye("only", (128, 128), (64, 64), 64, math.radians(180))
    rig = Rig(((128, 128),), (lens,))
    stitcher = Stitcher(rig, 64)
    found = stitcher.stitch(np.full((128, 128, 3), 200, np.uint8))
    behind = stitcher.grid.directions[..., 0] < -0.05
    assert stitcher.unseen is not None
    assert stitcher.unseen[behind].all()
    assert (found[behind] == 0).all()
    assert (found[stitcher.grid.directions[..., 0] > 0.1] == 200).all()


def test_lenses_that_differ_in_brightness_leave_no_step():
    """Across the overlap the shares go from one lens to the other, and always sum to 1."""
    rig = dual_fisheye(512, 256)
    picture = np.full((256, 512, 3), 100, np.uint8)
    picture[:, 256:] = 180
    found = Stitcher(rig, 128).stitch(picture).astype(int)[..., 0]
    row = found[64]
    assert row.min() >= 99
    assert row.max() <= 181
    assert np.abs(np.diff(row)).max() < 20


@pytest.mark.filterwarnings("ignore:Gimbal lock")  # of SciPy, for a lens that looks straight up or down
@given(fisheyes())
def test_a_rig_is_read_as_it_was_written(tmp_path_factory, lens):
    side = Lens('side: "b"', (64, 48), (50.0, 51.0), (32.0, 24.5), (-0.1, 0.01), world_R_body(1, 0.2, 3), 1)
    rig = Rig(((200, 200), (64, 48)), (lens, side))
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    write_rig(rig, path, ["a note: with\nlines"])
    found = read_rig(path)
    assert found.sizes == rig.sizes
    for one, other in zip(found.lenses, rig.lenses, strict=True):
        assert (one.name, one.picture) == (other.name, other.picture)
        x, y = np.array([20.0, 30.0]), np.array([15.0, 40.0])
        assert angular_distance(one.unproject(x, y), other.unproject(x, y)).max() < 1e-6
