"""ROS 2 messages: to our types and back is the identity, in axes and signs as REP-103 says."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from eagor.errors import ImageError, PoseError, TimeError
from eagor.robots.frames import Pose
from eagor.robots.ros import messages as m
from eagor.sphere import direction, world_R_body

ANGLE = st.floats(-3.1, 3.1)
METRES = st.floats(-1e6, 1e6)
PICTURE = np.random.default_rng(0).integers(0, 256, (6, 12, 3), dtype=np.uint8)
COLOURS = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255], [10, 20, 30]]], dtype=np.uint8)


@given(yaw=ANGLE, pitch=st.floats(-1.5, 1.5), roll=ANGLE, place=st.tuples(METRES, METRES, METRES))
def test_poses_come_back(yaw, pitch, roll, place):
    pose = Pose(1_700_000_000.25, world_R_body(yaw, pitch, roll), np.array(place))
    for made in (m.odometry_message(pose), m.pose_message(pose)):
        found = m.pose_of(made)
        assert found.stamp == pose.stamp
        np.testing.assert_allclose(found.world_R_body, pose.world_R_body, atol=1e-9)
        np.testing.assert_array_equal(found.position, pose.position)
    found = m.pose_of(m.imu_message(pose))
    assert found.position is None
    np.testing.assert_allclose(found.world_R_body, pose.world_R_body, atol=1e-9)


def test_a_left_turn_is_a_positive_z():
    """REP-103; the scalar part is w, which a mix-up of xyzw and wxyz would show."""
    found = m.quaternion(world_R_body(math.radians(90), 0, 0))
    np.testing.assert_allclose([found.x, found.y, found.z, found.w], [0, 0, math.sqrt(0.5), math.sqrt(0.5)], atol=1e-12)
    found.x, found.y, found.z, found.w = 0.0, 0.0, math.sin(math.radians(15)), math.cos(math.radians(15))
    np.testing.assert_allclose(m.rotation_of(found)[:, 0], direction(math.radians(30), 0), atol=1e-12)


@given(st.floats(1e9, 2.0**31 - 1))
def test_times_of_this_century_come_back_as_the_same_float(stamp):
    assert m.seconds(m.time_message(stamp)) == stamp


@given(st.integers(0, 2**31 * 10**9 - 10**9))
def test_times_are_right_to_the_nanosecond_that_a_float_holds(nanos):
    stamp = nanos / 10**9
    assert abs(m.nanoseconds(stamp) - nanos) <= max(1, math.ulp(stamp) * 1e9)


@pytest.mark.parametrize("stamp", [-1.0, 2.0**31, math.nan, math.inf])
def test_times_that_no_message_holds(stamp):
    with pytest.raises(TimeError, match="takes seconds from 0 to"):
        m.time_message(stamp)


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "bgra8"])
def test_pictures_come_back(encoding):
    made = m.image_message(PICTURE, 5.0, "x3", encoding)
    assert (made.height, made.width, made.encoding) == (6, 12, encoding)
    np.testing.assert_array_equal(m.panorama_of(made), PICTURE)


def test_colours_are_those_that_the_encoding_names():
    """By hand, not by our own writer: red is 255, 0, 0 in rgb8 and 0, 0, 255 in bgr8."""
    made = m.image_message(COLOURS, 5.0, "x3")
    for encoding, pixels in {
        "rgb8": [255, 0, 0, 0, 255, 0, 0, 0, 255, 10, 20, 30],
        "bgr8": [0, 0, 255, 0, 255, 0, 255, 0, 0, 30, 20, 10],
        "rgba8": [255, 0, 0, 9, 0, 255, 0, 9, 0, 0, 255, 9, 10, 20, 30, 9],
        "bgra8": [0, 0, 255, 9, 0, 255, 0, 9, 255, 0, 0, 9, 30, 20, 10, 9],
    }.items():
        made.encoding, made.step, made.data = encoding, len(pixels), np.array(pixels, dtype=np.uint8)
        np.testing.assert_array_equal(m.panorama_of(made), COLOURS)
    made.encoding, made.step, made.data = "mono8", 4, np.array([1, 2, 3, 4], dtype=np.uint8)
    np.testing.assert_array_equal(m.panorama_of(made)[0, :, 1], [1, 2, 3, 4])


@given(st.integers(0, 40))
def test_rows_may_be_padded(more):
    made = m.image_message(PICTURE, 5.0, "x3")
    rows = np.full((6, 36 + more), 77, dtype=np.uint8)
    rows[:, :36] = PICTURE.reshape(6, 36)
    made.step, made.data = 36 + more, rows.reshape(-1)
    np.testing.assert_array_equal(m.panorama_of(made), PICTURE)


def test_fields_as_rclpy_gives_them():
    """Its octets are an array.array or bytes."""
    import array

    made = m.image_message(PICTURE, 5.0, "x3")
    for data in (array.array("B", PICTURE.tobytes()), PICTURE.tobytes()):
        made.data = data
        np.testing.assert_array_equal(m.panorama_of(made), PICTURE)


def test_compressed_pictures():
    np.testing.assert_array_equal(m.panorama_of(m.compressed_message(PICTURE, 5.0, "x3", kind="png")), PICTURE)
    smooth = np.repeat(np.arange(0, 256, 16, dtype=np.uint8)[None, :, None], 8, axis=0) * np.ones(3, dtype=np.uint8)
    found = m.panorama_of(m.compressed_message(smooth, 5.0, "x3"))
    assert np.abs(found.astype(int) - smooth).mean() < 3
    made = m.compressed_message(PICTURE, 5.0, "x3", kind="png")
    made.format = "bgr8; png compressed bgr8"  # as image_transport says; the file itself has the right colours
    np.testing.assert_array_equal(m.panorama_of(made), PICTURE)
    grey = io.BytesIO()
    Image.fromarray(PICTURE[..., 0]).save(grey, "png")
    made.data = np.frombuffer(grey.getvalue(), dtype=np.uint8)
    np.testing.assert_array_equal(m.panorama_of(made)[..., 2], PICTURE[..., 0])


def test_maps_are_floats_or_octets():
    values = np.linspace(0, 1, 8, dtype=np.float32).reshape(2, 4)
    made = m.image_message(values, 5.0, "base_link")
    assert (made.encoding, made.step, made.is_bigendian) == ("32FC1", 16, 0)
    np.testing.assert_array_equal(np.frombuffer(made.data, "<f4").reshape(2, 4), values)
    assert m.image_message(np.zeros((2, 4), np.uint8), 5.0, "x").encoding == "mono8"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"encoding": "mono16"}, "has the encoding 'mono16'; wanted one of rgb8, bgr8"),
        ({"encoding": "bayer_rggb8"}, "bayer_rggb8"),
        ({"step": 35}, "has 35 bytes a row"),
        ({"height": 7}, "of 12 x 7 pixels"),
        ({"width": 0}, "of 0 x 6 pixels"),
        ({"data": np.zeros(0, np.uint8)}, "and 0 in all"),
    ],
)
def test_pictures_that_do_not_hold_together(change, said):
    made = m.image_message(PICTURE, 5.0, "x3")
    for name, value in change.items():
        setattr(made, name, value)
    with pytest.raises(ImageError, match=said):
        m.panorama_of(made)


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff", bytes(100)])
def test_compressed_pictures_that_cannot_be_decoded(data):
    made = m.compressed_message(PICTURE, 5.0, "x3")
    made.data = np.frombuffer(data, dtype=np.uint8)
    with pytest.raises(
        ImageError, match=r"a CompressedImage of \d+ bytes, which says that its format is 'jpeg', cannot"
    ):
        m.panorama_of(made)


def test_poses_that_are_none():
    made = m.pose_message(Pose(5.0, np.eye(3), np.zeros(3)))
    made.pose.orientation.w = 0.0
    with pytest.raises(PoseError, match="has the length 0, wanted 1: is it unset"):
        m.pose_of(made)
    made.pose.orientation.w = math.nan
    with pytest.raises(PoseError, match="length nan"):
        m.pose_of(made)
    made.pose.orientation.w, made.pose.position.y = 1.0, math.inf
    with pytest.raises(PoseError, match="wanted finite metres"):
        m.pose_of(made)
    imu = m.imu_message(Pose(5.0, np.eye(3)))
    imu.orientation_covariance[0] = -1
    with pytest.raises(PoseError, match="an Imu says that it has no orientation"):
        m.pose_of(imu)
