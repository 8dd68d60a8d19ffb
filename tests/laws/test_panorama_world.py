"""Looking around in one picture: which way things move when the camera turns, and what a view shows."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from strategies import at_most

from eagor.errors import EagorError, ImageError, PoseError, RotationError
from eagor.grids import ErpGrid, FisheyeGrid, PatchGrid, PerspectiveGrid
from eagor.lab.worlds.painted import BALL_COLOURS, EYE, Ball, Room, bearing, paint, painted_room
from eagor.sources.panorama import read_panorama, turn, view
from eagor.sphere import angular_distance, direction, world_R_body

ANGLES = st.floats(-math.pi, math.pi)


def smooth_picture(height=96, width=192):
    """Low-order polynomials of the direction, one per channel, without any symmetry; uint8."""
    x, y, z = np.moveaxis(ErpGrid(height, width).directions, -1, 0)
    channels = [x + 0.5 * y * z, y - 0.4 * x * z + 0.2 * z, z + 0.6 * x * y]
    return np.rint(127 + 80 * np.stack(channels, axis=-1)).astype(np.uint8)


def blob(azimuth, elevation, height=180, width=360):
    """A picture (H, W), float64, with one bright spot of 4 degrees at the given direction."""
    angle = angular_distance(ErpGrid(height, width).directions, direction(azimuth, elevation))
    return np.exp(-0.5 * (angle / math.radians(4)) ** 2)


def brightest(picture, grid):
    """The mean direction of what is bright."""
    weight = np.where(picture > 0.3 * picture.max(), picture, 0) * grid.weights
    return np.einsum("ij,ijk->k", weight, grid.directions)


@pytest.mark.parametrize("columns", [1, 37, -50, 96])
def test_a_turn_to_the_left_by_whole_columns_rolls_the_picture_to_the_right(columns):
    picture = np.random.default_rng(1).integers(0, 256, (48, 192, 3), dtype=np.uint8)
    yaw = columns * 2 * math.pi / 192
    new_R_old = (world_R_body(yaw)).T @ world_R_body(0)  # what was at azimuth a is now at a - yaw
    assert np.array_equal(turn(picture, new_R_old), np.roll(picture, columns, axis=1))


def test_no_turn_changes_nothing_and_types_are_kept():
    for picture in (smooth_picture(), smooth_picture()[..., 0], smooth_picture() / 255.0, np.float32(blob(1, 0))):
        turned = turn(picture, np.eye(3))
        assert turned.dtype == picture.dtype
        assert turned.shape == picture.shape
        assert np.allclose(turned, picture, atol=1e-6)


@given(ANGLES, st.floats(-1.5, 1.5), ANGLES, ANGLES, ANGLES)
@at_most(40)
def test_a_marker_appears_where_the_rotation_says(azimuth, elevation, yaw, pitch, roll):
    new_R_old = world_R_body(yaw, pitch, roll).T
    turned = turn(blob(azimuth, elevation), new_R_old)
    error = angular_distance(brightest(turned, PatchGrid(180, 360)), new_R_old @ direction(azimuth, elevation))
    assert math.degrees(error) < 0.5


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (0.5, 0), (0, 0.3), (0.4, -0.25), (-0.6, 0.1)])
def test_a_view_shows_a_marker_where_its_grid_says(azimuth, elevation):
    """And that is: what is left on the left, what is high above (test_grids)."""
    grid = PerspectiveGrid(101, 151, math.radians(100))
    seen = view(blob(azimuth, elevation), grid)
    assert math.degrees(angular_distance(brightest(seen, grid), direction(azimuth, elevation))) < 0.5


def test_a_turned_view_is_a_view_of_the_turned_panorama():
    picture, pose = smooth_picture(), world_R_body(2.2, -0.3, 0.7)
    one = view(picture, PerspectiveGrid(60, 80, 1.5, pose))
    other = view(turn(picture, pose.T), PerspectiveGrid(60, 80, 1.5))
    assert np.abs(one.astype(int) - other).max() <= 3


def test_a_fisheye_is_black_where_it_sees_nothing():
    seen = view(np.full((40, 80, 3), 200, np.uint8), FisheyeGrid(64, math.pi))
    assert seen.shape == (64, 64, 3)
    assert (seen[0, 0] == 0).all()
    assert (seen[32, 32] == 200).all()


def test_a_transparent_palette_is_read_without_a_warning(tmp_path):
    image = Image.new("P", (8, 4), 1)
    image.putpalette([0, 0, 0, 250, 10, 10])
    image.save(tmp_path / "p.png", transparency=b"\x00\x80")
    picture = read_panorama(tmp_path / "p.png")
    assert (picture == [250, 10, 10]).all()
    assert picture.flags.writeable


def test_an_image_of_another_shape_maps_longitude_and_latitude_apart():
    new_R_old = world_R_body(0.9, -0.4, 0.3).T
    turned = turn(blob(0.5, 0.6, 200, 300), new_R_old)
    error = angular_distance(brightest(turned, PatchGrid(200, 300)), new_R_old @ direction(0.5, 0.6))
    assert math.degrees(error) < 0.7


def test_unreadable_images_say_what_to_do(tmp_path):
    for path, says in ((tmp_path / "missing.png", "no file"), (tmp_path, "folder")):
        with pytest.raises(ImageError, match=says):
            read_panorama(path)
    Image.fromarray(smooth_picture()).save(tmp_path / "good.jpg")
    good = (tmp_path / "good.jpg").read_bytes()
    for content, says in (
        (b"", r"empty \(0 bytes\)"),
        (b"not an image", "cannot be read as an image"),
        (good[: len(good) // 2], "fetch or export it again"),
    ):
        (tmp_path / "bad.jpg").write_bytes(content)
        with pytest.raises(ImageError, match=says):
            read_panorama(tmp_path / "bad.jpg")
    Image.fromarray(np.zeros((2, 4), np.float32)).save(tmp_path / "float.tif")
    with pytest.raises(ImageError, match="tone-map"):
        read_panorama(tmp_path / "float.tif")


def test_bad_arrays_and_rotations_are_refused():
    with pytest.raises(ImageError, match="is an array"):
        turn(np.zeros((0, 4, 3)), np.eye(3))
    with pytest.raises(ImageError, match="shape"):
        view(np.zeros(5), PerspectiveGrid(4, 4, 1.0))
    with pytest.raises(RotationError):
        turn(smooth_picture(), np.diag([1.0, -1.0, 1.0]))


# --- the painted room ------------------------------------------------------------------------------------------------


def colour_mask(picture, rgb):
    """Pixels whose linear colour is a multiple of `rgb`: lit and shaded parts of one ball."""
    wanted, seen = (np.asarray(c, float) / 255 for c in (rgb, picture))
    wanted, seen = wanted**2.2, seen**2.2
    length = np.linalg.norm(seen, axis=-1) * np.linalg.norm(wanted)
    return (seen @ wanted > 0.995 * length) & (length > 1e-4)


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), ANGLES, st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
@settings(max_examples=12, deadline=None)
def test_a_ball_is_seen_at_its_true_direction_and_size(x, y, yaw, pitch, roll):
    ball, grid = Ball((2.2, 1.4, 1.2), 0.35, "purple"), PatchGrid(180, 360)
    position, pose = (x, y, 1.4), world_R_body(yaw, pitch, roll)
    mask = colour_mask(paint(Room(balls=(ball,)), position, pose, *grid.shape, samples=1), ball.rgb)
    towards, distance = bearing(ball, position, pose)
    assert math.degrees(angular_distance(brightest(mask.astype(float), grid), towards)) < 1.0
    radius = math.asin(ball.radius / distance)
    solid_angle = 2 * math.pi * (1 - math.cos(radius))
    assert abs(grid.weights[mask].sum() / solid_angle - 1) < 0.15  # the highlight is not purple


def test_turning_in_the_room_is_turning_its_panorama():
    pose = world_R_body(1.0, 0.3, -0.4)
    painted = paint(Room(), EYE, pose, 128, 256).astype(float)
    turned = turn(painted_room(128, 256), pose.T).astype(float)
    assert np.median(np.abs(painted - turned)) < 1.0
    assert np.abs(painted - turned).mean() < 3.0  # edges differ by the resampling


def test_the_room_says_what_is_wrong():
    with pytest.raises(PoseError, match="outside the room"):
        paint(Room(), (9.0, 0.0, 1.0))
    with pytest.raises(EagorError, match="radius"):
        Ball((0, 0, 1), -1.0)
    with pytest.raises(EagorError, match=next(iter(BALL_COLOURS))):
        Ball((0, 0, 1), 0.2, "mauve")
    assert Ball((0, 0, 1), 0.2, (1, 2, 3)).rgb == (1, 2, 3)
