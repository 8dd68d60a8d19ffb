"""Odd pictures given to the odometer: an error that says what is wrong, or a documented answer."""

import math

import numpy as np
import pytest
from moving_rooms import PatternRoom

from eagor.errors import ImageError, MissingExtraError
from eagor.grids import PerspectiveGrid
from eagor.odometry.visual import VisualOdometer
from eagor.sphere import world_R_body

pytest.importorskip("cv2")


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((64, 128, 3)),
        np.zeros((64, 128), np.uint8),
        np.zeros((64, 128, 4), np.uint8),
        np.zeros((0, 0, 3), np.uint8),
    ],
)
def test_other_arrays_are_refused_and_change_nothing(picture):
    room, odometer = PatternRoom(1), VisualOdometer()
    odometer.add(room.panorama(np.eye(3)))
    with pytest.raises(ImageError, match="uint8"):
        odometer.add(picture)
    assert not odometer.add(room.panorama(world_R_body(0.3))).lost


@pytest.mark.parametrize("shape", [(1, 2), (1, 1), (2, 4), (3, 7), (16, 32), (50, 10)])
@pytest.mark.parametrize("level", [False, True])
def test_tiny_and_blank_pictures_hold_the_rotation(shape, level):
    odometer = VisualOdometer(level=level)
    for picture in (np.zeros((*shape, 3), np.uint8), np.full((*shape, 3), 255, np.uint8)):
        turned = odometer.add(picture)
        assert np.array_equal(turned.world_R_body, np.eye(3))
        assert turned.matches == 0
        assert math.isfinite(turned.std)


def test_sizes_may_change_from_picture_to_picture():
    room, odometer = PatternRoom(2), VisualOdometer()
    for index, rows in enumerate((256, 200, 384)):
        pose = world_R_body(0.2 * index, 0.1 * index)
        turned = odometer.add(room.panorama(pose, rows=rows))
        assert not turned.lost
        assert np.abs(turned.world_R_body - pose).max() < 0.005


def test_without_opencv_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("eagor._extras.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match="photos"):
        VisualOdometer().add(np.zeros((64, 128, 3), np.uint8))


def test_a_grid_that_does_not_fit_and_another_kind_of_camera_are_refused():
    grid, odometer = PerspectiveGrid(90, 120, 1.0), VisualOdometer()
    picture = PatternRoom(1).panorama(np.eye(3))
    odometer.add(np.ascontiguousarray(picture[:90, :120]), 0.0, grid)
    with pytest.raises(ImageError, match=r"120 x 80, its grid is for 120 x 90; wanted the same size"):
        odometer.add(np.ascontiguousarray(picture[:80, :120]), 0.1, grid)
    with pytest.raises(ImageError, match=r"a panorama .* after ordinary pictures"):
        odometer.add(picture, 0.2)
    assert not odometer.add(np.ascontiguousarray(picture[:90, :120]), 0.3, grid).lost
    small = grid.resized(45, 60)
    assert odometer.add(np.ascontiguousarray(picture[:90:2, :120:2]), 0.4, small).matches > 0


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (9, 16), (400, 3)])
def test_tiny_and_blank_ordinary_pictures_hold_the_rotation(shape):
    odometer, grid = VisualOdometer(), PerspectiveGrid(*shape, 1.0)
    for number in range(3):
        turned = odometer.add(np.zeros((*shape, 3), np.uint8), number / 10, grid)
        assert turned.matches == 0
        assert math.isfinite(turned.std)
