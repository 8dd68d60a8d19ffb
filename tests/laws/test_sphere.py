"""Frames, angles and rotations."""

import math
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import directions, random_directions, rotations

from eagor.errors import DirectionError, RotationError
from eagor.sphere import (
    angular_distance,
    azimuth_elevation,
    check_rotation,
    check_unit,
    direction,
    interpolate_rotation,
    rotation,
    unit,
    world_R_body,
    wrap,
)


def test_left_is_positive_and_up_is_positive():
    assert np.allclose(direction(math.pi / 2, 0.0), [0, 1, 0])
    assert np.allclose(direction(0.0, math.pi / 2), [0, 0, 1])
    azimuth, elevation = azimuth_elevation(np.array([1.0, 1.0, math.sqrt(2)]))
    assert azimuth == pytest.approx(math.pi / 4)
    assert elevation == pytest.approx(math.pi / 4)


@given(directions())
def test_angles_and_directions_are_inverse(d):
    assert angular_distance(direction(*azimuth_elevation(d)), d) < 1e-12


@given(directions(), st.floats(0, math.pi), rotations())
def test_distance_is_the_angle_of_the_turn_and_invariant(d, angle, R):
    axis = np.cross(d, [0.3, -0.5, 0.8])
    turned = rotation(axis, angle) @ d
    assert angular_distance(d, turned) == pytest.approx(angle, abs=1e-14 + 1e-14 * angle)
    assert angular_distance(R @ d, R @ turned) == pytest.approx(angle, abs=1e-12)


@pytest.mark.parametrize("tiny", [1e-15, 1e-12, 1e-9])
def test_distance_keeps_its_digits_near_zero_and_pi(tiny):
    """The arc cosine of the dot product returns 0 for all of these."""
    a, b = np.array([1.0, 0, 0]), np.array([math.cos(tiny), math.sin(tiny), 0])
    assert angular_distance(a, b) == pytest.approx(tiny, rel=1e-9)
    assert math.pi - angular_distance(a, -b) == pytest.approx(tiny, abs=5e-16)


def test_yaw_turns_left_pitch_turns_the_nose_down_and_roll_lowers_the_right():
    assert np.allclose(world_R_body(math.pi / 2) @ [1, 0, 0], [0, 1, 0])
    assert (world_R_body(0, 0.3) @ [1, 0, 0])[2] < 0
    assert (world_R_body(0, 0, 0.3) @ [0, -1, 0])[2] < 0  # REP-103: positive roll about x lowers the right side


@given(rotations())
def test_every_rotation_passes_and_its_reflection_does_not(R):
    assert check_rotation(R) is R
    assert check_rotation(np.stack([R, R])).shape == (2, 3, 3)
    with pytest.raises(RotationError, match="reflection"):
        check_rotation(R @ np.diag([1.0, 1, -1]))


@pytest.mark.parametrize(
    ("matrix", "text"),
    [
        (np.eye(3) * 1.01, "not orthogonal"),
        (np.full((3, 3), np.nan), "NaN"),
        (np.eye(4), "shape"),
        (np.zeros((3, 3)), "not orthogonal"),
        ([[1.0, 0, 0], [0, 1, 0], [0, 0, -1]], "LEFT"),
    ],
)
def test_what_is_no_rotation_is_refused_with_a_reason(matrix, text):
    with pytest.raises(RotationError, match=text):
        check_rotation(np.array(matrix))


@pytest.mark.parametrize("kind", ["one", "batch", "list", "one float32", "batch float32", "torch"])
def test_one_tolerance_for_rotations_of_every_kind(kind):
    """A batch may not take what a single matrix is refused for, nor the other way around."""

    def as_kind(matrix):
        if kind == "torch":
            return pytest.importorskip("torch").tensor(matrix)
        matrix = np.stack([np.eye(3), matrix]) if "batch" in kind else matrix
        return matrix.tolist() if kind == "list" else matrix.astype(np.float32 if "32" in kind else np.float64)

    def sheared(by):
        return np.array([[1.0, by, 0], [0, 1, 0], [0, 0, 1]])

    for by in (0.0, 2e-6, 9e-6):
        check_rotation(as_kind(sheared(by)))
    for by in (1.1e-5, 5e-5):
        with pytest.raises(RotationError, match="not orthogonal"):
            check_rotation(as_kind(sheared(by)))
    check_rotation(as_kind(sheared(9e-4)), tolerance=1e-3)
    with pytest.raises(RotationError, match="not orthogonal"):
        check_rotation(as_kind(sheared(2e-6)), tolerance=1e-6)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_unit_vectors_lose_their_rounding_and_others_are_refused(dtype):
    exact = random_directions(12).reshape(3, 4, 3).astype(dtype)
    assert check_unit(exact) is exact
    assert np.allclose(np.linalg.norm(check_unit(np.round(exact, 2)), axis=-1), 1, atol=1e-6)
    assert check_unit(np.zeros((0, 3), dtype)).shape == (0, 3)
    for bad, said in (([2, 0, 0], "length 2"), ([0, 0, 0], "length 0"), ([0, np.nan, 1], "length nan"),
                      ([1e30, 0, 0], "length"), ([np.inf, 0, 0], "inf"), ([0.98, 0, 0], "0.98")):  # fmt: skip
        with pytest.raises(DirectionError, match=rf"1 of 2 .*{said}.*wanted"):
            check_unit(np.array([[1, 0, 0], bad], dtype))


@given(rotations(), rotations(), st.floats(0, 1))
def test_interpolation_moves_at_constant_speed_from_start_to_end(a, b, fraction):
    def angle(R):
        return np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2, (np.trace(R) - 1) / 2

    whole = math.atan2(*angle(a.T @ b))
    part = math.atan2(*angle(a.T @ interpolate_rotation(a, b, fraction)))
    if whole < math.pi - 1e-6:
        assert part == pytest.approx(fraction * whole, abs=1e-7)
    assert np.allclose(interpolate_rotation(a, b, 0.0), a)
    assert np.allclose(interpolate_rotation(a, b, 1.0), b)


def test_unit_refuses_what_has_no_direction():
    with pytest.raises(DirectionError, match="zero"):
        unit(np.array([[1.0, 0, 0], [0, 0, 0]]))


@pytest.mark.parametrize("bad", [np.ones(2), np.ones((3, 5)), np.ones(4), 1.0])
def test_directions_have_three_numbers(bad):
    for read in (
        unit,
        azimuth_elevation,
        lambda d: angular_distance(d, np.ones(3)),
        lambda d: angular_distance([1, 0, 0], d),
    ):
        with pytest.raises(DirectionError, match="wanted"):
            read(bad)


@given(st.floats(-50, 50))
def test_wrap_changes_an_angle_by_whole_turns(angle):
    wrapped = wrap(angle)
    assert -math.pi <= wrapped <= math.pi
    assert (angle - wrapped) / (2 * math.pi) == pytest.approx(round((angle - wrapped) / (2 * math.pi)), abs=1e-9)


def test_degrees_are_no_directions():
    with pytest.raises(DirectionError, match=r"elevation = -10; wanted radians, 1.57 at most: math.radians\(-10\)"):
        direction(40, -10)
    with pytest.raises(DirectionError, match="elevation = 30"):
        direction(np.zeros(3), np.array([0.1, 30.0, np.nan]))
    with pytest.warns(UserWarning, match=r"azimuth = 90; wanted radians, 6.28 at most"):
        direction(90, 0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        direction(np.arange(9) * (math.pi * (3 - math.sqrt(5))), np.zeros(9))  # a spiral
        for azimuth, elevation in ((2 * math.pi, math.pi / 2), (np.float32(-math.pi), np.float32(-math.pi / 2))):
            direction(azimuth, elevation)
