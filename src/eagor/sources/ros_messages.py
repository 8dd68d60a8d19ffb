"""ROS 2 messages without ROS: to and from our types.

Messages are `rosbags`' dataclasses; those of `rclpy` have the same fields, and are read as well. Quaternions are xyzw,
frames REP-103 and REP-105, stamps times of capture.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np
from PIL import Image

from eagor._extras import require_extra
from eagor.conventions import rotation_from_xyzw, xyzw_from_rotation
from eagor.errors import ImageError, PoseError, TimeError
from eagor.sources import Pose
from eagor.sources.panorama import depth_in_words, read_image, to_8_bits
from eagor.tracking.poses import FARTHEST

__all__ = [
    "CAMERA_INFO", "COMPRESSED", "IMAGE", "IMU", "MOTION", "NANO", "ODOMETRY", "PICTURES", "POSE",
    "POSE_WITH_COVARIANCE", "TEXT", "TRANSFORM", "TRANSFORMS", "VECTOR", "compressed_message", "header",
    "image_from_msg", "image_message", "message", "odometry_message", "pose_from_msg", "quaternion", "seconds",
    "stamp_of", "store", "taken_as", "transform_message", "transforms_message", "vector",
]  # fmt: skip

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
IMU, ODOMETRY, POSE = "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
TRANSFORMS, VECTOR, TEXT = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/Vector3Stamped", "std_msgs/msg/String"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
PICTURES = (IMAGE, COMPRESSED)
MOTION = (ODOMETRY, POSE, IMU, TRANSFORMS, POSE_WITH_COVARIANCE, TRANSFORM)  # the best first

NANO = 10**9
LATEST = 2**31  # seconds: builtin_interfaces/Time counts them as int32
_NORM = 0.01  # by which a quaternion's length may differ from 1
# Encodings of sensor_msgs/Image (sensor_msgs/image_encodings.hpp): values a pixel, and which of them are R, G, B. Those
# with 16 in their names have two bytes a value.
ENCODINGS: Mapping[str, tuple[int, slice | list[int]]] = {
    **{f"{order}{bits}": (len(order), slice(3) if order[0] == "r" else slice(2, None, -1))
       for order in ("rgb", "bgr", "rgba", "bgra") for bits in (8, 16)},
    "mono8": (1, [0, 0, 0]), "mono16": (1, [0, 0, 0]),
}  # fmt: skip
# Types of OpenCV's matrices, whose colours lie as OpenCV has them; 16UC1 is depth.
AS_OPENCV = {"8UC1": "mono8", "8UC3": "bgr8", "8UC4": "bgra8", "16UC3": "bgr16", "16UC4": "bgra16"}
BAYER = {f"bayer_{pattern}{bits}": pattern for pattern in ("rggb", "bggr", "gbrg", "grbg") for bits in (8, 16)}
DEPTH = ("16UC1", "32FC1", "compressedDepth")  # REP-118
# As OpenCV calls them; the longer names are older ones. Of NV24, which it does not have, every second U and V is taken.
YUV = {
    "uyvy": "UYVY", "yuv422": "UYVY", "yuyv": "YUY2", "yuv422_yuy2": "YUY2", "nv12": "NV12", "nv21": "NV21",
    "nv24": "NV12",
}  # fmt: skip


def message(kind: str, **fields: Any) -> Any:
    """A message of a ROS 2 type that `eagor.sources.ros_messages.store` knows; all fields have to be given."""
    return store().types[kind](**fields)


# --- time ---


def nanoseconds(stamp: float) -> int:
    """Seconds as whole nanoseconds: back in seconds, times of this century are the same float. Raises `TimeError`."""
    if not 0 <= stamp < LATEST:
        raise TimeError(f"stamp = {stamp!r}; a ROS 2 message takes seconds from 0 to {LATEST}")
    whole = math.floor(stamp)
    return whole * NANO + round((stamp - whole) * NANO)


def seconds(time: Any) -> float:
    """The seconds of a builtin_interfaces/Time."""
    return (time.sec * NANO + time.nanosec) / NANO


def stamp_of(received: Any) -> float:
    """The seconds of a message's header; 0 if its sender did not set it."""
    return seconds(received.header.stamp)


def header(stamp: float, frame: str) -> Any:
    """A std_msgs/Header; `stamp`: seconds from 1970. Raises `TimeError`."""
    sec, nanosec = divmod(nanoseconds(stamp), NANO)
    stamped = message("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return message("std_msgs/msg/Header", stamp=stamped, frame_id=frame)


# --- pictures ---


def image_message(panorama: np.ndarray, stamp: float, frame: str) -> Any:
    """A sensor_msgs/Image in rgb8 of ``(H, W, 3)`` uint8 RGB."""
    height, width, _ = panorama.shape
    data, kind = np.ascontiguousarray(panorama, dtype=np.uint8).reshape(-1), {"encoding": "rgb8", "is_bigendian": 0}
    return message(IMAGE, header=header(stamp, frame), height=height, width=width, step=3 * width, data=data, **kind)


def compressed_message(panorama: np.ndarray, stamp: float, frame: str, *, kind: str = "jpeg", quality: int = 90) -> Any:
    """A sensor_msgs/CompressedImage of ``(H, W, 3)`` uint8 RGB or ``(H, W)`` grey: jpeg or png."""
    buffer = io.BytesIO()
    Image.fromarray(np.asarray(panorama)).save(buffer, kind, **({"quality": quality} if kind == "jpeg" else {}))
    data = np.frombuffer(buffer.getvalue(), dtype=np.uint8)
    return message(COMPRESSED, header=header(stamp, frame), format=kind, data=data)


def image_from_msg(received: Any) -> np.ndarray:
    """The picture ``(H, W, 3)`` uint8 RGB of an Image or a CompressedImage. Raises `ImageError`."""
    return _decoded(received) if hasattr(received, "format") else _raw(received)


def taken_as(received: Any) -> str | None:
    """In words, how a picture is read whose encoding does not say its colours, or says unusual ones; else None."""
    if not hasattr(received, "format"):
        name = AS_OPENCV.get(received.encoding)
        if "16" in received.encoding:
            count, _ = ENCODINGS.get(name or received.encoding, (1, 0))
            if how := depth_in_words(_wide(_rows(received, 2 * count), received)):
                return how
        return name and f"the encoding {received.encoding} names no colours; it is read as {name}, as OpenCV has it"
    if _is_swapped(received.format):
        return (
            f"the format {received.format!r} says that blue is where red should be, as image_transport reads it: they "
            "are swapped; wanted '... compressed bgr8'"
        )
    return None


def _raw(received: Any) -> np.ndarray:
    encoding = AS_OPENCV.get(received.encoding) or received.encoding
    if encoding in YUV:
        return _of_yuv(received)
    if encoding not in ENCODINGS and encoding not in BAYER:
        raise _refused("an Image has the encoding", encoding)
    count, places = ENCODINGS.get(encoding, (1, slice(1)))
    values = _rows(received, count * (2 if "16" in encoding else 1))
    if "16" in encoding:
        values = to_8_bits(_wide(values, received))
    picture = np.array(values[..., places], order="C")  # of its own: who looks at it may draw on it
    return _demosaiced(picture[..., 0], BAYER[encoding]) if encoding in BAYER else picture


def _wide(values: np.ndarray, received: Any) -> np.ndarray:
    return np.ascontiguousarray(values).view(">u2" if received.is_bigendian else "<u2")


def _refused(what: str, encoding: str) -> ImageError:
    why = "depth, and no picture (REP-118)" if encoding in DEPTH else "which names no colours that are known here"
    known = ", ".join([*ENCODINGS, *AS_OPENCV, *BAYER, *YUV])
    return ImageError(f"{what} {encoding!r}, {why}; wanted one of {known}")


def _demosaiced(mosaic: np.ndarray, pattern: str) -> np.ndarray:
    """RGB ``(H, W, 3)`` of a Bayer mosaic ``(H, W)`` uint8, whose first two by two are `pattern`; bilinear."""
    if min(mosaic.shape) < 3:
        return np.repeat(mosaic[..., None], 3, axis=-1)
    return _converted(mosaic, f"Bayer{pattern.upper()}2RGB")


def _converted(values: np.ndarray, how: str) -> np.ndarray:
    require_extra("pictures of this encoding", "ros" if find_spec("rclpy") else "robot", "cv2")  # both bring it
    import cv2

    return cv2.cvtColor(np.ascontiguousarray(values), getattr(cv2, f"COLOR_{how}"))


def _rows(received: Any, size: int) -> np.ndarray:
    """The bytes ``(H, W, size)`` of an Image. Raises `ImageError` if there are too few."""
    height, width, step = received.height, received.width, received.step
    data = np.frombuffer(received.data, dtype=np.uint8)
    if height < 1 or width < 1 or step < width * size or len(data) < height * step:
        raise ImageError(
            f"an Image of {width} x {height} pixels of {size} bytes has {step} bytes a row and {len(data)} in all; "
            f"wanted at least {width * size} and {height * max(step, width * size)}"
        )
    return data[: height * step].reshape(height, step)[:, : width * size].reshape(height, width, size)


def _of_yuv(received: Any) -> np.ndarray:
    """RGB ``(H, W, 3)`` uint8 of an Image in YUV (`YUV`). Raises `ImageError` for a size that cannot be shared."""
    height, width, step, encoding = received.height, received.width, received.step, received.encoding
    how, planar = f"YUV2RGB_{YUV[encoding]}", encoding.startswith("nv")  # else Y lies between U and V
    rows = _rows(received, 1 if planar else 2)
    wanted = 0 if not planar else 2 * height * step if encoding == "nv24" else height // 2 * step
    colours = np.frombuffer(received.data, dtype=np.uint8)[height * step :][:wanted]
    if width % 2 or (planar and height % 2) or len(colours) < wanted:
        lacks = f"has {len(colours)} bytes of colour; wanted {wanted}, and even sides" if planar else "has an odd width"
        raise ImageError(f"an Image of {width} x {height} pixels as {encoding} {lacks}: neighbours share a colour")
    if not planar:
        return _converted(rows, how)
    pairs = colours.reshape(height, step, 2)[::2, ::2] if encoding == "nv24" else colours.reshape(-1, step // 2, 2)
    return _converted(np.vstack([rows[..., 0], pairs[:, : width // 2].reshape(height // 2, width)]), how)


def _decoded(received: Any) -> np.ndarray:
    """By compressed_image_transport's format, such as "bayer_rggb8; png compressed ", or only "jpeg"."""
    format_, data = received.format, bytes(received.data)
    encoding = "compressedDepth" if "compressedDepth" in format_ else format_.partition(";")[0].strip()
    if encoding in DEPTH or (encoding not in AS_OPENCV and re.fullmatch(r"\d+[USF]C\d*", encoding)):
        raise _refused("a CompressedImage has the format", encoding)
    try:
        picture = read_image(io.BytesIO(data), len(data))
    except Exception as error:  # Pillow's decoders may raise anything for damaged files
        what = f"a CompressedImage of {len(data)} bytes, which says that its format is {format_!r}, cannot be decoded"
        raise ImageError(f"{what} ({error}); wanted jpeg or png") from error
    if encoding in BAYER and (picture == picture[..., :1]).all():  # else it was demosaiced before it was compressed
        return _demosaiced(picture[..., 0], BAYER[encoding])
    return np.ascontiguousarray(picture[..., ::-1]) if _is_swapped(format_) else picture


def _is_swapped(told: str) -> bool:
    """Whether a format says that the values of a picture in colour lie in the order R, G, B, where OpenCV has B, G, R.

    As compressed_subscriber.cpp has it; compressed_publisher.cpp writes "compressed bgr8".
    """
    encoding, found, how = told.partition(";")
    return bool(found) and encoding[:3] in ("rgb", "bgr") and encoding in ENCODINGS and "compressed bgr" not in how


# --- motion ---


def vector(values: Any) -> Any:
    """A geometry_msgs/Vector3."""
    return message("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, values), strict=True)))


def quaternion(rotation: np.ndarray) -> Any:
    """A geometry_msgs/Quaternion of a rotation ``(3, 3)``."""
    values = map(float, xyzw_from_rotation(rotation))
    return message("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", values, strict=True)))


def odometry_message(
    pose: Pose, frame: str = "odom", child: str = "base_link", *, velocity: Any = (0, 0, 0), turning: Any = (0, 0, 0)
) -> Any:
    """A nav_msgs/Odometry; `velocity` m/s and `turning` rad/s in the axes of the body. No position: the origin."""
    x, y, z = (0.0, 0.0, 0.0) if pose.position is None else map(float, pose.position)
    point = message("geometry_msgs/msg/Point", x=x, y=y, z=z)
    place = message("geometry_msgs/msg/Pose", position=point, orientation=quaternion(pose.world_R_body))
    placed = message("geometry_msgs/msg/PoseWithCovariance", pose=place, covariance=np.zeros(36))
    twist = message("geometry_msgs/msg/Twist", linear=vector(velocity), angular=vector(turning))
    moving = message("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36))
    return message(ODOMETRY, header=header(pose.stamp, frame), child_frame_id=child, pose=placed, twist=moving)


def transform_message(stamp: float, parent: str, child: str, rotation: np.ndarray, translation: Any = (0, 0, 0)) -> Any:
    """A geometry_msgs/TransformStamped: where the frame `child` is in the frame `parent`."""
    transform = message("geometry_msgs/msg/Transform", translation=vector(translation), rotation=quaternion(rotation))
    return message(TRANSFORM, header=header(stamp, parent), child_frame_id=child, transform=transform)


def transforms_message(*transforms: Any) -> Any:
    """A tf2_msgs/TFMessage."""
    return message(TRANSFORMS, transforms=list(transforms))


def pose_from_msg(received: Any) -> Pose:
    """The pose of an Odometry, a PoseStamped, one with covariance, a TransformStamped, or an Imu (without a position).

    Raises `PoseError`.
    """
    if hasattr(received, "transform"):
        turn, place = received.transform.rotation, received.transform.translation
    elif hasattr(received, "orientation_covariance"):
        if received.orientation_covariance[0] == -1:  # sensor_msgs/Imu: there is no orientation
            raise PoseError("an Imu says that it has no orientation; wanted one that has, or odometry")
        turn, place = received.orientation, None
    else:
        inner = received.pose.pose if hasattr(received.pose, "covariance") else received.pose
        turn, place = inner.orientation, inner.position
    return Pose(stamp_of(received), rotation_of(turn), None if place is None else triple(place))


def rotation_of(q: Any) -> np.ndarray:
    """The rotation ``(3, 3)`` of a geometry_msgs/Quaternion. Raises `PoseError` unless its length is 1."""
    values = [float(each) for each in (q.x, q.y, q.z, q.w)]
    length = math.hypot(*values)
    if not abs(length - 1) <= _NORM:
        raise PoseError(f"a quaternion x, y, z, w = {values} has the length {length:.3g}, wanted 1: is it unset?")
    return rotation_from_xyzw(np.array(values))


def triple(place: Any) -> np.ndarray:
    """The numbers ``(3,)`` of a Point or Vector3. Raises `PoseError` unless they can be metres on Earth."""
    values = np.array([place.x, place.y, place.z], dtype=np.float64)
    if not (np.abs(values) <= FARTHEST).all():
        wanted = f"wanted finite metres, each within {FARTHEST:g} of the origin"
        raise PoseError(f"a position is {values.tolist()}; {wanted}")
    return values


@cache
def store() -> Any:
    """`rosbags`' types of ROS 2 Humble, which later releases share."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)
