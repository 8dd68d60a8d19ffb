"""ROS 2 messages: to our types and back is the identity, in axes and signs as REP-103 says."""

from __future__ import annotations

import io
import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from rosmaking import image_of, imu_message, pose_message

from eagor.errors import ImageError, PoseError, TimeError
from eagor.sources import Pose
from eagor.sources import ros_messages as m
from eagor.sphere import direction, world_R_body

ANGLE = st.floats(-3.1, 3.1)
METRES = st.floats(-1e6, 1e6)
PICTURE = np.random.default_rng(0).integers(0, 256, (6, 12, 3), dtype=np.uint8)


@given(yaw=ANGLE, pitch=st.floats(-1.5, 1.5), roll=ANGLE, place=st.tuples(METRES, METRES, METRES))
def test_poses_come_back(yaw, pitch, roll, place):
    pose = Pose(1_700_000_000.25, world_R_body(yaw, pitch, roll), np.array(place))
    for made in (m.odometry_message(pose), pose_message(pose)):
        found = m.pose_from_msg(made)
        assert found.stamp == pose.stamp
        np.testing.assert_allclose(found.world_R_body, pose.world_R_body, atol=1e-9)
        np.testing.assert_array_equal(found.position, pose.position)
    found = m.pose_from_msg(imu_message(pose))
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
    assert m.seconds(m.header(stamp, "").stamp) == stamp


@given(st.integers(0, 2**31 * 10**9 - 10**9))
def test_times_are_right_to_the_nanosecond_that_a_float_holds(nanos):
    stamp = nanos / 10**9
    assert abs(m.nanoseconds(stamp) - nanos) <= max(1, math.ulp(stamp) * 1e9)


@pytest.mark.parametrize("stamp", [-1.0, 2.0**31, math.nan, math.inf])
def test_times_that_no_message_holds(stamp):
    with pytest.raises(TimeError, match="takes seconds from 0 to"):
        m.header(stamp, "")


@pytest.mark.parametrize(("bits", "big"), [(8, False), (16, False), (16, True)])
def test_colours_are_those_that_the_encoding_names(bits, big):
    """By hand, not by our own writer: red comes first in rgb; a value of 16 bits is the same share of white."""
    wide = PICTURE if bits == 8 else (PICTURE.astype(np.uint16) * 257).astype(">u2" if big else "<u2")
    alpha = np.full((6, 12, 1), 77, wide.dtype)
    for encoding, pixels in {
        "rgb": wide,
        "bgr": wide[..., ::-1],
        "rgba": np.concatenate([wide, alpha], axis=-1),
        "bgra": np.concatenate([wide[..., ::-1], alpha], axis=-1),
    }.items():
        np.testing.assert_array_equal(m.image_from_msg(image_of(f"{encoding}{bits}", pixels, big=big)), PICTURE)
    grey = m.image_from_msg(image_of(f"mono{bits}", wide[..., 0], big=big))
    np.testing.assert_array_equal(grey, np.repeat(PICTURE[..., :1], 3, axis=-1))


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(("encoding", "bits"), [("mono16", 12), ("bgr16", 10), ("bayer_rggb16", 14), ("mono16", 16)])
def test_values_of_fewer_bits_than_16_are_not_black_and_that_is_said(encoding, bits, big):
    pixels = np.full((6, 12, 3 if "bgr" in encoding else 1), (1 << bits) - 1, ">u2" if big else "<u2")
    received = image_of(encoding, pixels, big=big, padded=8)
    assert (m.image_from_msg(received) == 255).all()
    assert m.taken_as(received) == (
        f"its 16-bit values are taken for {bits} bits: none is larger" if bits < 16 else None
    )


@pytest.mark.parametrize("padded", [0, 10])
def test_pictures_of_yuv_are_as_opencv_reads_them(padded):
    rng = np.random.default_rng(1)
    y, u, v = (rng.integers(16, 256, (6, 12), dtype=np.uint8) for _ in range(3))  # Y has no values below black
    packed = lambda *parts: np.stack(parts, axis=-1).reshape(6, 24)  # noqa: E731
    two = lambda *parts: np.stack(parts, axis=-1).reshape(len(parts[0]), -1)  # noqa: E731
    for names, pixels, code in (
        (("uyvy", "yuv422"), packed(u[:, ::2], y[:, ::2], v[:, ::2], y[:, 1::2]), cv2.COLOR_YUV2RGB_UYVY),
        (("yuyv", "yuv422_yuy2"), packed(y[:, ::2], u[:, ::2], y[:, 1::2], v[:, ::2]), cv2.COLOR_YUV2RGB_YUY2),
        (("nv12",), np.vstack([y, two(u[:3, :6], v[:3, :6])]), cv2.COLOR_YUV2RGB_NV12),
        (("nv21",), np.vstack([y, two(v[:3, :6], u[:3, :6])]), cv2.COLOR_YUV2RGB_NV21),
    ):
        shape = (6, 12, 2) if pixels.shape == (6, 24) else pixels.shape
        truth = cv2.cvtColor(np.ascontiguousarray(pixels).reshape(shape), code).astype(int)
        for name in names:
            found = m.image_from_msg(image_of(name, pixels, padded=padded, size=(6, 12)))
            assert found.shape == PICTURE.shape
            assert np.abs(found.astype(int) - truth).max() <= 2
    # OpenCV has no NV24. Where four pixels share a colour it says the same as NV21, but for the order of U and V.
    wide = lambda part: np.repeat(np.repeat(part[:3, :6], 2, axis=0), 2, axis=1)  # noqa: E731
    both = two(wide(u), wide(v)).reshape(12, 12)
    flat = image_of("nv24", np.vstack([y, both]), size=(6, 12))
    np.testing.assert_array_equal(
        m.image_from_msg(flat),
        m.image_from_msg(image_of("nv21", np.vstack([y, two(v[:3, :6], u[:3, :6])]), size=(6, 12))),
    )


@given(st.integers(0, 40))
def test_rows_may_be_padded(more):
    made = m.image_message(PICTURE, 5.0, "x3")
    rows = np.full((6, 36 + more), 77, dtype=np.uint8)
    rows[:, :36] = PICTURE.reshape(6, 36)
    made.step, made.data = 36 + more, rows.reshape(-1)
    np.testing.assert_array_equal(m.image_from_msg(made), PICTURE)


def test_fields_as_rclpy_gives_them():
    """Its octets are an array.array or bytes."""
    import array

    made = m.image_message(PICTURE, 5.0, "x3")
    for data in (array.array("B", PICTURE.tobytes()), PICTURE.tobytes()):
        made.data = data
        np.testing.assert_array_equal(m.image_from_msg(made), PICTURE)


def test_compressed_pictures():
    np.testing.assert_array_equal(m.image_from_msg(m.compressed_message(PICTURE, 5.0, "x3", kind="png")), PICTURE)
    smooth = np.repeat(np.arange(0, 256, 16, dtype=np.uint8)[None, :, None], 8, axis=0) * np.ones(3, dtype=np.uint8)
    found = m.image_from_msg(m.compressed_message(smooth, 5.0, "x3"))
    assert np.abs(found.astype(int) - smooth).mean() < 3
    made = m.compressed_message(PICTURE, 5.0, "x3", kind="png")
    made.format = "bgr8; png compressed bgr8"  # as image_transport says; the file itself has the right colours
    np.testing.assert_array_equal(m.image_from_msg(made), PICTURE)
    grey = io.BytesIO()
    Image.fromarray(PICTURE[..., 0]).save(grey, "png")
    made.data = np.frombuffer(grey.getvalue(), dtype=np.uint8)
    np.testing.assert_array_equal(m.image_from_msg(made)[..., 2], PICTURE[..., 0])


# Scenes of which a mosaic holds all: a colour that is the same everywhere, and one that changes evenly.
FLAT = np.broadcast_to(np.array([200, 120, 40], np.uint8), (8, 10, 3))
SLOPE = (np.mgrid[0:8, 0:10].sum(axis=0)[..., None] * np.array([5, 8, 11])).astype(np.uint8)


def mosaic(picture, pattern):
    rows, columns = np.indices(picture.shape[:2]) % 2
    which = np.array(["rgb".index(each) for each in pattern])[2 * rows + columns]
    return np.take_along_axis(picture, which[..., None], axis=2)[..., 0]


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_mosaics_are_demosaiced(pattern):
    for picture in (FLAT, SLOPE):
        raw = mosaic(picture, pattern)
        wide = (raw.astype(np.uint16) * 257).astype(">u2")
        png = m.compressed_message(raw, 5.0, "x", kind="png")
        png.format = (
            f"bayer_{pattern}8; png compressed "  # as compressed_image_transport writes it: the mosaic as it is
        )
        for made in (image_of(f"bayer_{pattern}8", raw), image_of(f"bayer_{pattern}16", wide, big=True), png):
            found = m.image_from_msg(made)
            np.testing.assert_allclose(found[1:-1, 1:-1].astype(int), picture[1:-1, 1:-1], atol=1)
    done = m.compressed_message(SLOPE, 5.0, "x", kind="png")
    done.format = f"bayer_{pattern}8; png compressed bgr8"  # demosaiced before
    np.testing.assert_array_equal(m.image_from_msg(done), SLOPE)
    tiny = image_of(f"bayer_{pattern}8", np.full((1, 1), 7, np.uint8))
    assert m.image_from_msg(tiny).max() == 7


@pytest.mark.parametrize(
    ("encoding", "pixels", "name"),
    [
        ("8UC1", PICTURE[..., 0], "mono8"),
        ("8UC3", PICTURE[..., ::-1], "bgr8"),
        ("8UC4", np.dstack([PICTURE[..., ::-1], PICTURE[..., :1]]), "bgra8"),
        ("16UC3", (PICTURE.astype("<u2") * 257)[..., ::-1], "bgr16"),
        ("16UC4", np.dstack([PICTURE[..., ::-1], PICTURE[..., :1]]).astype("<u2") * 257, "bgra16"),
    ],
)
def test_the_names_of_opencv_have_its_order_which_is_said(encoding, pixels, name):
    made = image_of(encoding, pixels)
    np.testing.assert_array_equal(m.image_from_msg(made), PICTURE if pixels.ndim == 3 else PICTURE[..., [0, 0, 0]])
    assert f"{encoding} names no colours; it is read as {name}" in m.taken_as(made)
    made.encoding = "bgr8"
    assert m.taken_as(made) is None


@pytest.mark.parametrize(
    "values", ["8UC2", "8UC", "16UC2", "8SC3", "16SC1", "32SC4", "32FC3", "64FC1", "16UC1", "32FC1"]
)
def test_numbers_that_are_no_colours_are_refused_by_name(values):
    packed = m.compressed_message(PICTURE, 5.0, "x3", kind="png")
    packed.format = f"{values}; png compressed "
    for made in (image_of(values, np.zeros((6, 12, 32), np.uint8)), packed):
        with pytest.raises(ImageError, match=f"'{values}', .* wanted one of rgb8"):
            m.image_from_msg(made)


@pytest.mark.parametrize("told", ["16UC1; compressedDepth png", "32FC1; compressedDepth", "compressedDepth"])
def test_compressed_depth_is_refused_by_name(told):
    made = m.compressed_message(PICTURE, 5.0, "x3", kind="png")
    made.format = told
    with pytest.raises(ImageError, match="the format 'compressedDepth', depth, and no picture"):
        m.image_from_msg(made)


@pytest.mark.parametrize(
    ("told", "swapped"),
    [
        ("jpeg", False),
        ("bgr8; jpeg compressed bgr8", False),
        ("rgb8; png compressed bgr8", False),
        ("rgba16; png compressed bgr16", False),
        ("8UC3; png compressed ", False),
        ("yuv422_yuy2; jpeg compressed bgr8", False),
        ("rgb8; png compressed ", True),
        ("bgr8; png compressed rgb8", True),
    ],
)
def test_the_order_of_compressed_colours_is_that_of_image_transport(told, swapped):
    """compressed_subscriber.cpp, after imdecode, which gives B, G, R."""
    made = m.compressed_message(PICTURE, 5.0, "x3", kind="png")
    made.format = told
    np.testing.assert_array_equal(m.image_from_msg(made), PICTURE[..., ::-1] if swapped else PICTURE)
    assert (m.taken_as(made) is not None) == swapped


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"encoding": "32FC1"}, r"'32FC1', depth, and no picture .REP-118.; wanted one of rgb8, .* uyvy.* nv21, nv24"),
        ({"encoding": "mono16", "width": 19}, "of 19 x 6 pixels of 2 bytes has 36 bytes a row"),
        ({"encoding": "uyvy", "width": 11}, "of 11 x 6 pixels as uyvy has an odd width"),
        ({"encoding": "nv21", "height": 6, "step": 36}, "as nv21 has 0 bytes of colour; wanted 108, and even sides"),
        ({"encoding": "bayer_rggb16", "step": 23}, "of 12 x 6 pixels of 2 bytes has 23 bytes a row"),
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
        m.image_from_msg(made)


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff", bytes(100)])
def test_compressed_pictures_that_cannot_be_decoded(data):
    made = m.compressed_message(PICTURE, 5.0, "x3")
    made.data = np.frombuffer(data, dtype=np.uint8)
    with pytest.raises(
        ImageError, match=r"a CompressedImage of \d+ bytes, which says that its format is 'jpeg', cannot"
    ):
        m.image_from_msg(made)


def test_poses_that_are_none():
    made = pose_message(Pose(5.0, np.eye(3), np.zeros(3)))
    made.pose.orientation.w = 0.0
    with pytest.raises(PoseError, match="has the length 0, wanted 1: is it unset"):
        m.pose_from_msg(made)
    made.pose.orientation.w = math.nan
    with pytest.raises(PoseError, match="length nan"):
        m.pose_from_msg(made)
    made.pose.orientation.w = 1e308  # whose square has no end
    with pytest.raises(PoseError, match=r"the length 1e.308"):
        m.pose_from_msg(made)
    made.pose.orientation.w, made.pose.position.y = 1.0, math.inf
    with pytest.raises(PoseError, match="wanted finite metres"):
        m.pose_from_msg(made)
    made.pose.position.y = 1e30
    with pytest.raises(PoseError, match=r"wanted finite metres, each within 1e\+09 of the origin"):
        m.pose_from_msg(made)
    imu = imu_message(Pose(5.0, np.eye(3)))
    imu.orientation_covariance[0] = -1
    with pytest.raises(PoseError, match="an Imu says that it has no orientation"):
        m.pose_from_msg(imu)
