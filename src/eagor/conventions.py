"""Converters to and from the conventions of other software; each has a test on an asymmetric scene.

Ours: body x forward, y left, z up; azimuth positive left, elevation positive up, radians; real harmonics without
Condon-Shortley phase, index l*l + l + m. No other module converts.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from eagor.errors import EagorError, RotationError
from eagor.sphere import azimuth_elevation, check_rotation, direction

__all__ = [
    "E3NN_R_BODY", "GLTF_R_WORLD", "HABITAT_R_BODY", "OPTICAL_R_BODY", "direction_from_hstar", "from_gltf",
    "from_habitat", "from_healpix_alm", "from_optical", "from_pyshtools", "hstar_from_direction", "is_optical",
    "pose_from_habitat",
    "pose_to_habitat", "rotation_from_habitat", "rotation_from_wxyz", "rotation_from_xyzw", "rotation_to_e3nn",
    "to_e3nn_direction", "to_gltf", "to_habitat", "to_healpix_alm", "to_optical", "to_pyshtools", "wxyz_from_rotation",
    "xyzw_from_rotation",
]  # fmt: skip

# --- quaternions (ROS messages are xyzw; many papers, MuJoCo and Unitree are wxyz) ---


def rotation_from_wxyz(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices ``(..., 3, 3)`` from quaternions ``(..., 4)``, scalar first, of any positive length."""
    return _from_quaternion(quaternion, scalar_first=True)


def rotation_from_xyzw(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices ``(..., 3, 3)`` from quaternions ``(..., 4)``, scalar last, as in ROS messages."""
    return _from_quaternion(quaternion, scalar_first=False)


def wxyz_from_rotation(matrix: np.ndarray) -> np.ndarray:
    """Unit quaternions ``(..., 4)``, scalar first and not negative, from rotation matrices ``(..., 3, 3)``."""
    matrix = np.asarray(check_rotation(matrix, "matrix"))
    from scipy.spatial.transform import Rotation

    found = Rotation.from_matrix(matrix.reshape(-1, 3, 3)).as_quat(canonical=True, scalar_first=True)
    return found.reshape(*matrix.shape[:-2], 4)


def xyzw_from_rotation(matrix: np.ndarray) -> np.ndarray:
    """Unit quaternions ``(..., 4)``, scalar last, from rotation matrices ``(..., 3, 3)``."""
    return np.roll(wxyz_from_rotation(matrix), -1, axis=-1)


def _from_quaternion(quaternion: np.ndarray, scalar_first: bool) -> np.ndarray:
    quaternion = np.asarray(quaternion, dtype=np.float64)
    order = "w, x, y, z" if scalar_first else "x, y, z, w"
    if quaternion.shape[-1:] != (4,) or not np.isfinite(quaternion).all():
        raise RotationError(f"quaternion = {quaternion.tolist()}; wanted four finite numbers {order}")
    # One alone in plain floats, which takes a third of the time.
    parts = quaternion.tolist() if quaternion.ndim == 1 else np.moveaxis(quaternion, -1, 0)
    w, x, y, z = parts if scalar_first else (parts[3], *parts[:3])
    squared = w * w + x * x + y * y + z * z
    if np.any(squared < 1e-12):
        raise RotationError(f"a quaternion of length zero is not a rotation; is the message unset? wanted {order}")
    s = 2 / squared
    found = np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    )
    return found if quaternion.ndim == 1 else np.moveaxis(found, (0, 1), (-2, -1))


# --- H*Bench: yaw 0 at the image centre, positive to the RIGHT, 0 to 360; pitch positive up; degrees ---


def hstar_from_direction(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """H*Bench (yaw, pitch) in degrees, yaw in [0, 360), of directions ``(..., 3)``."""
    azimuth, elevation = azimuth_elevation(directions)
    return np.degrees(-azimuth) % 360.0 % 360.0, np.degrees(elevation)  # the first rounds a hair below 0 to 360


def direction_from_hstar(yaw_deg: np.ndarray, pitch_deg: np.ndarray) -> np.ndarray:
    """Directions ``(..., 3)`` from H*Bench yaw (positive right) and pitch (positive up), degrees."""
    return direction(-np.radians(yaw_deg), np.radians(pitch_deg))


# --- camera and simulator axes ---

# Rows: the axes of the other frame in ours, so that OTHER_R_BODY @ direction_body = direction_other.
HABITAT_R_BODY = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])  # x right, y up, z backward (also OpenGL)
OPTICAL_R_BODY = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # x right, y down, z forward (ROS REP-103 optical)
# e3nn's polar axis is its second. Hand it our (y, z, x) as its (x, y, z), and the same numbers describe the same
# field, with the same index l*l + l + m.
E3NN_R_BODY = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])


def to_habitat(directions: np.ndarray) -> np.ndarray:
    """Directions or points ``(..., 3)`` from our body frame to Habitat's (x right, y up, z backward)."""
    return np.asarray(directions) @ HABITAT_R_BODY.T


def from_habitat(directions: np.ndarray) -> np.ndarray:
    """Directions or points ``(..., 3)`` from Habitat's frame to ours."""
    return np.asarray(directions) @ HABITAT_R_BODY


def rotation_from_habitat(matrix: np.ndarray) -> np.ndarray:
    """A rotation or pose ``(..., 3, 3)`` between Habitat frames as one between ours; a left turn stays a left turn."""
    return HABITAT_R_BODY.T @ check_rotation(np.asarray(matrix, dtype=np.float64), "matrix") @ HABITAT_R_BODY


def is_optical(frame: str) -> bool:
    """Whether a ROS frame is an optical one by its name: REP-103's ``_optical``, as and where drivers write it.

    Such as cam_optical_frame, camera_link_optical, robot1/left_optical_link, CameraOpticalFrame, cam_optical_left; but
    not a sensor of optical flow, nor what such a frame is mounted on.
    """
    return re.search(r"(?<!pan)optic(al)?(?![a-z]*[_-]?(flow|fib)|.*mount)", frame, re.IGNORECASE) is not None


def to_optical(directions: np.ndarray) -> np.ndarray:
    """Directions or points ``(..., 3)`` from our body frame to an optical frame (x right, y down, z forward)."""
    return np.asarray(directions) @ OPTICAL_R_BODY.T


def from_optical(directions: np.ndarray) -> np.ndarray:
    """Directions or points ``(..., 3)`` from a camera's optical frame to ours."""
    return np.asarray(directions) @ OPTICAL_R_BODY


def to_e3nn_direction(directions: np.ndarray) -> np.ndarray:
    """Points ``(..., 3)`` for e3nn (normalization="integral", normalize=True): coefficients then need no reordering."""
    return np.asarray(directions) @ E3NN_R_BODY.T


def rotation_to_e3nn(matrix: np.ndarray) -> np.ndarray:
    """Our rotation `matrix` ``(..., 3, 3)`` in e3nn's axes."""
    return E3NN_R_BODY @ check_rotation(np.asarray(matrix, dtype=np.float64), "matrix") @ E3NN_R_BODY.T


# --- worlds: ours has z up; glTF, and with it a scene in Habitat, has Y up: its x is ours, its Z our -y ---

GLTF_R_WORLD = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def to_gltf(points: np.ndarray) -> np.ndarray:
    """Points ``(..., 3)`` of our world, z up, in a glTF scene or Habitat's world: (x, z, -y)."""
    return np.asarray(points) @ GLTF_R_WORLD.T.astype(np.asarray(points).dtype)


def from_gltf(points: np.ndarray) -> np.ndarray:
    """Points ``(..., 3)`` of a glTF scene or Habitat's world, Y up, in ours."""
    return np.asarray(points) @ GLTF_R_WORLD.astype(np.asarray(points).dtype)


def pose_to_habitat(world_R_body: np.ndarray) -> np.ndarray:
    """The rotation ``(..., 3, 3)`` for Habitat's AgentState, from our `world_R_body`."""
    return GLTF_R_WORLD @ check_rotation(np.asarray(world_R_body, dtype=np.float64), "world_R_body") @ HABITAT_R_BODY.T


def pose_from_habitat(rotation: np.ndarray) -> np.ndarray:
    """Our `world_R_body` ``(..., 3, 3)`` from the rotation of Habitat's agent."""
    return GLTF_R_WORLD.T @ check_rotation(np.asarray(rotation, dtype=np.float64), "rotation") @ HABITAT_R_BODY


# --- coefficient orders. All three use the same orthonormal functions up to sign, order or axes. ---


def to_healpix_alm(coefficients: np.ndarray) -> np.ndarray:
    """Complex a_lm ``(..., n)`` for ducc0 and healpy: m >= 0, m-major, Condon-Shortley phase, colatitude and longitude.

    The field is the same function of direction: longitude = azimuth, colatitude = pi/2 - elevation. For m > 0,
    a_lm = (-1)^m (c_lm - i c_l-m) / sqrt(2).
    """
    coefficients = np.asarray(coefficients, dtype=np.float64)
    m, l = np.triu_indices(_degree(coefficients) + 1)
    cosine, sine = coefficients[..., l * l + l + m], coefficients[..., l * l + l - m]
    return np.where(m == 0, cosine, (-1.0) ** m * (cosine - 1j * sine) / math.sqrt(2))


def from_healpix_alm(alm: np.ndarray) -> np.ndarray:
    """Our coefficients ``(..., (degree + 1)^2)`` from the complex a_lm of ducc0 and healpy."""
    alm = np.asarray(alm, dtype=np.complex128)
    degree = (math.isqrt(8 * alm.shape[-1] + 1) - 3) // 2
    if (degree + 1) * (degree + 2) // 2 != alm.shape[-1]:
        raise EagorError(f"{alm.shape[-1]} values do not form a triangle of a_lm; wanted (lmax + 1)(lmax + 2) / 2")
    m, l = np.triu_indices(degree + 1)
    scaled: Any = np.where(m == 0, 1.0, (-1.0) ** m * math.sqrt(2)) * alm
    found = np.zeros((*alm.shape[:-1], (degree + 1) ** 2))
    found[..., l * l + l - m] = -scaled.imag
    found[..., l * l + l + m] = scaled.real
    return found


def to_pyshtools(coefficients: np.ndarray) -> np.ndarray:
    """cilm ``(..., 2, degree + 1, degree + 1)`` for pyshtools, normalization="ortho", csphase=1: cosines, sines."""
    coefficients = np.asarray(coefficients, dtype=np.float64)
    degree = _degree(coefficients)
    found = np.zeros((*coefficients.shape[:-1], 2, degree + 1, degree + 1))
    l, m = np.tril_indices(degree + 1)
    found[..., 1, l, m] = coefficients[..., l * l + l - m]
    found[..., 0, l, m] = coefficients[..., l * l + l + m]
    found[..., 1, :, 0] = 0.0
    return found


def from_pyshtools(cilm: np.ndarray) -> np.ndarray:
    """Our coefficients from pyshtools' cilm ``(..., 2, degree + 1, degree + 1)``, normalization="ortho", csphase=1."""
    cilm = np.asarray(cilm, dtype=np.float64)
    if cilm.ndim < 3 or cilm.shape[-3:] != (2, cilm.shape[-1], cilm.shape[-1]):
        raise EagorError(f"cilm has shape {cilm.shape}; wanted (..., 2, degree + 1, degree + 1)")
    l, m = np.tril_indices(cilm.shape[-1])
    found = np.zeros((*cilm.shape[:-3], cilm.shape[-1] ** 2))
    found[..., l * l + l - m] = cilm[..., 1, l, m]
    found[..., l * l + l + m] = cilm[..., 0, l, m]
    return found


def _degree(coefficients: np.ndarray) -> int:
    size = coefficients.shape[-1]
    degree = math.isqrt(size) - 1
    if (degree + 1) ** 2 != size:
        raise EagorError(f"{size} coefficients do not form a full triangle; wanted (degree + 1)^2")
    return degree
