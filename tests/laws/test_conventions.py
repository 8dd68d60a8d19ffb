"""Converters, on a scene that no mirror leaves alone: a thing to the LEFT, a high one to the RIGHT, one behind."""

import math

import numpy as np
import pytest
from hypothesis import given
from strategies import rotations

from eagor import conventions as conv
from eagor.errors import EagorError, RotationError
from eagor.grids import ErpGrid
from eagor.sphere import azimuth_elevation, direction, rotation, world_R_body, wrap

CHAIR, LAMP, BED = (direction(math.radians(a), math.radians(e)) for a, e in [(40, -10), (-75, 35), (170, -5)])


def test_hstar_yaw_grows_to_the_right_of_the_image_centre():
    for target, yaw, pitch in [(CHAIR, 320, -10), (LAMP, 75, 35), (BED, 190, -5)]:
        found = conv.hstar_from_direction(target)
        assert found == pytest.approx((yaw, pitch))
        assert np.allclose(conv.direction_from_hstar(*found), target)
        # The same place in the picture: yaw 0 is the centre column, 90 a quarter of the width to its right.
        x, y, _ = ErpGrid(512, 1024).project(target)
        assert (x / 1024 * 360 - 180) % 360 == pytest.approx(yaw)
        assert 90 - y / 512 * 180 == pytest.approx(pitch)


def test_yaw_is_below_360_and_wrapped_angles_below_pi_for_a_hair_to_the_left():
    hairs = np.array([1e-18, -1e-18, 1e-300, 0.0, -0.0])
    yaws, _ = conv.hstar_from_direction(np.stack([np.ones(5), hairs, np.zeros(5)], axis=-1))
    assert ((yaws >= 0) & (yaws < 360)).all()
    assert -math.pi <= wrap(np.nextafter(-math.pi, -4)) < math.pi


def test_habitat_looks_along_minus_z_with_x_to_the_right():
    assert np.allclose(conv.to_habitat([1, 0, 0]), [0, 0, -1])
    assert np.allclose(conv.to_habitat([0, 1, 0]), [-1, 0, 0])
    assert np.allclose(conv.to_habitat([0, 0, 1]), [0, 1, 0])
    assert conv.to_habitat(CHAIR)[0] < 0 < conv.to_habitat(LAMP)[0]
    for target in (CHAIR, LAMP, BED):
        assert np.allclose(conv.from_habitat(conv.to_habitat(target)), target)


def test_a_turn_to_the_left_stays_one_in_habitat():
    """Habitat turns left by a positive angle about its +y."""
    habitat = rotation((0, 1, 0), 0.4)
    assert np.allclose(conv.rotation_from_habitat(habitat), world_R_body(0.4))
    assert np.allclose(conv.from_habitat(habitat @ conv.to_habitat(CHAIR)), world_R_body(0.4) @ CHAIR)


def test_optical_frames_look_along_z_with_y_down():
    assert np.allclose(conv.to_optical([1, 0, 0]), [0, 0, 1])
    assert conv.to_optical(CHAIR)[0] < 0, "left is negative x"
    assert conv.to_optical(LAMP)[1] < 0, "up is negative y"
    assert np.allclose(conv.from_optical(conv.to_optical(BED)), BED)


@pytest.mark.parametrize("axes", [conv.HABITAT_R_BODY, conv.OPTICAL_R_BODY, conv.E3NN_R_BODY])
def test_every_change_of_axes_keeps_hands(axes):
    assert np.linalg.det(axes) == pytest.approx(1.0)


@given(rotations())
def test_quaternions_of_both_orders_return(R):
    wxyz, xyzw = conv.wxyz_from_rotation(R), conv.xyzw_from_rotation(R)
    assert np.allclose(np.roll(wxyz, -1), xyzw)
    assert wxyz[0] >= 0
    assert np.allclose(conv.rotation_from_wxyz(wxyz), R, atol=1e-7)
    assert np.allclose(conv.rotation_from_xyzw(-3 * xyzw), R, atol=1e-7)


def test_a_quaternion_of_a_left_turn_turns_left():
    half = math.radians(90) / 2
    turned = conv.rotation_from_wxyz([math.cos(half), 0, 0, math.sin(half)]) @ [1, 0, 0]
    assert azimuth_elevation(turned)[0] == pytest.approx(math.pi / 2)
    many = conv.rotation_from_xyzw(np.tile([0, 0, math.sin(half), math.cos(half)], (2, 3, 1)))
    assert many.shape == (2, 3, 3, 3)
    assert conv.wxyz_from_rotation(many).shape == (2, 3, 4)


@pytest.mark.parametrize("bad", [[0, 0, 0, 0], [1, 0, 0], [math.nan, 0, 0, 1]])
def test_what_is_no_quaternion_is_refused(bad):
    with pytest.raises(RotationError, match="w, x, y, z"):
        conv.rotation_from_wxyz(bad)


def test_incomplete_coefficients_are_refused():
    with pytest.raises(EagorError, match="triangle"):
        conv.to_healpix_alm(np.zeros(63))
    with pytest.raises(EagorError, match="triangle"):
        conv.from_healpix_alm(np.zeros(35))
    for shape in [(8, 8), (2, 8, 7), (1, 8, 8)]:
        with pytest.raises(EagorError, match="cilm"):
            conv.from_pyshtools(np.zeros(shape))
