"""Frames, directions and rotations.

Body frame (ROS REP-103): x forward, y left, z up, right-handed. A *direction* is a unit vector ``(..., 3)`` in it.

- azimuth = atan2(y, x), positive to the LEFT, in (-pi, pi]; elevation = asin(z), positive up.
- Equirectangular image: pixel centres, azimuth = pi - 2 pi (j + 1/2) / W, elevation = pi/2 - pi (i + 1/2) / H.
  The centre of the image is forward, the seam is behind, columns grow to the right.
- Rotations are named by their frames: ``new_R_old @ direction_old = direction_new``; a pose is ``world_R_body``.
- Radians everywhere; degrees only at the command line, in reports and in names that end in ``_deg``.

Converters to the conventions of other software are in `eagor.conventions`.
"""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np

from eagor._arrays import Array, as_float, namespace, to_library, to_numpy
from eagor.errors import DirectionError, RotationError

__all__ = [
    "angular_distance", "azimuth_elevation", "check_directions", "check_rotation", "check_unit", "cross", "direction",
    "heading", "interpolate_rotation", "rotation", "unit", "world_R_body", "wrap",
]  # fmt: skip

FORWARD = (1.0, 0.0, 0.0)
_TURN = math.tau + 1e-6
ORTHOGONAL = 1e-5  # tolerance for the rows of a rotation: products of float32 are off by 1e-6
UNIT = 0.01  # tolerance for the length of a direction: people type two or three decimals


def direction(azimuth: Array, elevation: Array) -> Array:
    """Unit vectors ``(..., 3)``, body frame, from azimuth (positive left) and elevation (positive up), radians.

    Raises `DirectionError` for an elevation beyond a quarter of a turn, and warns of an azimuth beyond a whole one that
    is a whole number: these are degrees.

    >>> left = eagor.direction(math.pi / 2, 0.0)
    >>> left.round(3).tolist()
    [0.0, 1.0, 0.0]
    """
    azimuth, elevation = _common(azimuth, elevation)
    xp = namespace(azimuth, elevation)
    steep = xp.abs(elevation) > _TURN / 4 + 0.01  # rounding passes
    if bool(xp.any(steep)):
        raise DirectionError(_of_degrees("elevation", elevation[steep], _TURN / 4))
    far = (xp.abs(azimuth) > _TURN) & (azimuth % 1 == 0)  # it may go on for many turns, but hardly to whole numbers
    if bool(xp.any(far)):
        warnings.warn(_of_degrees("azimuth", azimuth[far], _TURN), UserWarning, stacklevel=2)
    x, y = xp.cos(elevation) * xp.cos(azimuth), xp.cos(elevation) * xp.sin(azimuth)
    return xp.stack([x, y, xp.sin(elevation) + 0.0 * x], axis=-1)


def _of_degrees(name: str, angles: Array, most: float) -> str:
    worst = float(to_numpy(angles).reshape(-1)[0])
    return f"{name} = {worst:.6g}; wanted radians, {most:.3g} at most: math.radians({worst:.6g}) of degrees"


def azimuth_elevation(directions: Array) -> tuple[Array, Array]:
    """Azimuth and elevation (radians) of directions ``(..., 3)``; they need not have unit length.

    Raises `DirectionError` on another shape.

        >>> azimuth, elevation = eagor.azimuth_elevation(np.array([0.0, 2.0, 2.0]))
        >>> round(math.degrees(azimuth)), round(math.degrees(elevation))
        (90, 45)
    """
    directions = check_directions(as_float(directions))
    xp = namespace(directions)
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    return xp.atan2(y, x), xp.atan2(z, xp.hypot(x, y))


def angular_distance(a: Array, b: Array) -> Array:
    """Great-circle angle (radians) between directions ``(..., 3)``, broadcast.

    atan2(|a x b|, a . b) keeps full precision near 0 and pi, where acos loses half of the digits, and works for any
    length. Raises `DirectionError` on another shape.

        >>> angle = eagor.angular_distance(np.array([1.0, 0.0, 0.0]), np.array([1.0, 1.0, 0.0]))
        >>> round(math.degrees(angle))
        45
    """
    a, b = _common(a, b)
    check_directions(a)
    check_directions(b)
    xp = namespace(a, b)
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    across = xp.hypot(xp.hypot(ay * bz - az * by, az * bx - ax * bz), ax * by - ay * bx)
    return xp.atan2(across, ax * bx + ay * by + az * bz)


def _common(a: Array, b: Array) -> tuple[Array, Array]:
    """Both as floating arrays of one library: if one is a tensor, the other becomes one too."""
    a, b = as_float(a), as_float(b)
    return (to_library(a, b), b) if isinstance(a, np.ndarray) else (a, to_library(b, a))


def unit(vectors: Array) -> Array:
    """`vectors` ``(..., 3)`` scaled to unit length.

    Raises `DirectionError` on another shape, or on a zero or non-finite vector.
    """
    vectors = check_directions(as_float(vectors))
    xp = namespace(vectors)
    length = xp.sqrt(xp.sum(vectors * vectors, axis=-1, keepdims=True))
    if not bool(xp.all(xp.isfinite(length) & (length > 0))):
        raise DirectionError("a direction is the zero vector or not finite; drop it or give a finite (x, y, z)")
    return vectors / length


def check_directions(vectors: Array) -> Array:
    """`vectors`, of any length. Raises `DirectionError` unless their last axis has size 3."""
    if vectors.shape[-1:] != (3,):
        raise DirectionError(f"directions have shape {tuple(vectors.shape)}; wanted (..., 3): x forward, y left, z up")
    return vectors


def check_unit(vectors: Array) -> Array:
    """`vectors` ``(..., 3)``, normalised, once their lengths are 1 to within `UNIT`.

    Raises `DirectionError` on another shape, another length, or what is not finite.
    """
    vectors = check_directions(as_float(vectors))
    xp = namespace(vectors)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    with np.errstate(over="ignore"):
        squared = x * x + y * y + z * z
    off = xp.abs(squared - 1)  # twice the error of the length; NaN fails every comparison
    if bool(xp.all(off <= 8 * xp.finfo(vectors.dtype).eps)):
        return vectors
    if bool(xp.all(off <= 2 * UNIT)):
        return vectors / xp.sqrt(squared)[..., None]
    lengths, good = (np.asarray(to_numpy(a)).reshape(-1) for a in (xp.sqrt(squared), off <= 2 * UNIT))
    raise DirectionError(
        f"{(~good).sum()} of {good.size} directions are not unit vectors (length {float(lengths[~good][0]):g}); wanted "
        "finite (x, y, z) of length 1: eagor.sphere.unit scales them, eagor.sphere.direction takes angles"
    )


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product of two vectors ``(3,)``; `numpy.cross` takes ten times as long for one."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def wrap(angle: Array) -> Array:
    """`angle` (radians) brought to [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) % (2 * math.pi) - math.pi  # the first rounds a hair below 0 to 2 pi


def rotation(axis: Array, angle: float) -> np.ndarray:
    """The matrix ``(3, 3)`` that turns vectors by `angle` (radians, right-hand rule) about `axis` (Rodrigues)."""
    x, y, z = unit(np.asarray(to_numpy(axis), dtype=np.float64))
    c, s, v = math.cos(angle), math.sin(angle), 2 * math.sin(angle / 2) ** 2
    return np.array(
        [
            [c + v * x * x, v * x * y - s * z, v * x * z + s * y],
            [v * x * y + s * z, c + v * y * y, v * y * z - s * x],
            [v * x * z - s * y, v * y * z + s * x, c + v * z * z],
        ]
    )


def world_R_body(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """The pose ``(3, 3)`` of a body turned by `yaw` (left), then `pitch` (nose DOWN), then `roll`, radians.

    A yaw may go on for many turns. Raises `RotationError` for a pitch or a roll of more than one, and warns of a yaw
    that is beyond one turn and looks like degrees: a whole multiple of 45.
    """
    for name, angle in (("pitch", pitch), ("roll", roll)):
        if abs(angle) > _TURN:
            raise RotationError(f"{name} = {float(angle):g}; wanted radians: math.radians({float(angle):g}) of degrees")
    if abs(yaw) > _TURN and yaw % 45 == 0:
        warnings.warn(
            f"yaw = {float(yaw):g} radians is {abs(float(yaw)) / math.tau:.1f} turns; of degrees pass "
            f"math.radians({float(yaw):g})",
            UserWarning,
            stacklevel=2,
        )
    return rotation((0, 0, 1), yaw) @ rotation((0, 1, 0), pitch) @ rotation((1, 0, 0), roll)


def heading(world_R_body: np.ndarray) -> float:
    """The azimuth (radians, in the world frame) of where a body in the pose ``(3, 3)`` faces: its yaw."""
    return float(azimuth_elevation(np.asarray(world_R_body)[:, 0])[0])


def check_rotation(matrix: Any, name: str = "new_R_old", tolerance: float = ORTHOGONAL) -> Array:
    """`matrix` ``(..., 3, 3)``, or a Rotation of SciPy, as a floating array, checked to be a rotation.

    Raises `RotationError` if it has another shape, is not finite, not orthogonal (beyond `tolerance`) or a reflection.
    """
    matrix = as_float(matrix.as_matrix() if hasattr(matrix, "as_matrix") else matrix)
    if matrix.shape == (3, 3) and type(matrix) is np.ndarray:  # the hot path, in plain floats
        (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
        # A rotation's rows are orthonormal and right-handed: the third is the cross product of the first two.
        # NaN fails every comparison, and so raises too.
        if (
            abs(a * a + b * b + c * c - 1) < tolerance
            and abs(d * d + e * e + f * f - 1) < tolerance
            and abs(a * d + b * e + c * f) < tolerance
            and abs(b * f - c * e - g) < tolerance
            and abs(c * d - a * f - h) < tolerance
            and abs(a * e - b * d - i) < tolerance
        ):
            return matrix
    elif matrix.shape[-2:] == (3, 3):
        xp = namespace(matrix)
        rows = [[matrix[..., i, j] for j in range(3)] for i in range(3)]
        (a, b, c), (d, e, f), (g, h, i) = rows
        worst = [a * a + b * b + c * c - 1, d * d + e * e + f * f - 1, a * d + b * e + c * f]
        worst += [b * f - c * e - g, c * d - a * f - h, a * e - b * d - i]
        if all(bool(xp.all(xp.abs(error) < tolerance)) for error in worst):
            return matrix
    raise RotationError(_what_is_wrong(to_numpy(matrix), name))


def checked_pose(matrix: Any, name: str = "world_R_body") -> np.ndarray:
    """`matrix`, or a Rotation of SciPy, as a float64 array ``(3, 3)``.

    Raises `RotationError` unless it is one rotation.
    """
    found = np.asarray(to_numpy(check_rotation(matrix, name)), dtype=np.float64)
    if found.shape != (3, 3):
        raise RotationError(f"{name} has the shape {found.shape}; wanted one rotation (3, 3), such as {name}[0]")
    return found


def _what_is_wrong(matrix: np.ndarray, name: str) -> str:
    """Why `matrix` is not a rotation, and what to change."""
    wanted = f"{name} must be a rotation matrix (..., 3, 3) with {name} @ direction_old = direction_new"
    if matrix.shape[-2:] in ((4, 4), (3, 4)):
        return (
            f"{wanted}; got shape {matrix.shape}, a pose with its position in the last column. Of a matrix M give the "
            "rotation M[:3, :3], and the position M[:3, 3] by itself"
        )
    if matrix.shape[-2:] != (3, 3):
        return f"{wanted}; got shape {matrix.shape}. Quaternions: see eagor.conventions.rotation_from_wxyz"
    if not np.isfinite(matrix).all():
        return f"{wanted}; got NaN or infinity. Check the odometry that it comes from"
    determinant = float(np.linalg.det(matrix).min())
    defect = float(np.abs(matrix @ np.swapaxes(matrix, -1, -2) - np.eye(3)).max())
    if defect < 1e-4 and determinant < 0:
        return (
            f"{wanted}; got a reflection (determinant {determinant:.3f}). One axis has the wrong sign: "
            "the body frame is x forward, y LEFT, z up"
        )
    return (
        f"{wanted}; got a matrix that is not orthogonal (R R^T differs from 1 by {defect:.2g}). "
        "Normalise the quaternion before converting it, and pass no scale"
    )


def interpolate_rotation(start: np.ndarray, end: np.ndarray, fraction: float) -> np.ndarray:
    """The rotation ``(3, 3)`` at `fraction` of the shortest turn from `start` to `end` (geodesic, constant speed)."""
    if fraction <= 0.0 or np.array_equal(start, end):
        return start
    if fraction >= 1.0:
        return end
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(start.T @ end).as_rotvec()
    return start @ Rotation.from_rotvec(fraction * turn).as_matrix()
