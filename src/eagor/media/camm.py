"""Motion tracks of the type ``camm`` (Google, Camera Motion Metadata Spec).

Each sample: two bytes reserved, two for its type, then its values, all little-endian. The camera's axes are x right,
y down, z forward; those of the world are right-handed with y down along gravity.
"""

from __future__ import annotations

import struct
from array import array
from typing import BinaryIO

import numpy as np
from scipy.spatial.transform import Rotation

from eagor.conventions import OPTICAL_R_BODY
from eagor.media.boxes import Movie, samples
from eagor.media.motion import MotionTrack

__all__ = ["read_camm"]

# Type: the floats that are read of it.
ANGLE_AXIS, EXPOSURE, GYRO, ACCELERATION, POSITION, GPS, FULL_GPS, MAGNETIC = range(8)
VECTORS = (ANGLE_AXIS, GYRO, ACCELERATION)


def read_camm(movie: Movie, file: BinaryIO) -> tuple[MotionTrack | None, tuple[str, ...]]:
    """The motion that the ``camm`` track of `file` tells, and sentences about it. None if there is none.

    Orientations (type 0) have priority over the gyroscope (type 2) and the accelerometer (type 3). Raises
    `FormatError` if the track is damaged.
    """
    track = next((track for track in movie.tracks if track.entry == "camm"), None)
    if track is None:
        return None, ()
    rows, kinds = {kind: array("d") for kind in VECTORS}, set()
    for time, data in samples(track, file):
        kind = struct.unpack_from("<H", data, 2)[0] if len(data) >= 4 else None
        kinds.add(kind)
        if kind in VECTORS and len(data) >= 16:
            rows[kind].extend((time, *struct.unpack_from("<3f", data, 4)))
    tables = {kind: np.frombuffer(rows[kind], dtype=np.float64).reshape(-1, 4) for kind in VECTORS}
    tables = {kind: table[np.isfinite(table).all(axis=1)] for kind, table in tables.items()}
    said = ["it has a motion track (camm)"]
    if kinds & {POSITION, GPS, FULL_GPS}:
        said.append("the motion track also tells positions, which are not used")
    if len(tables[ANGLE_AXIS]):
        # y is down in both the camera and the world: the axes of both are mapped, and with them the turn's axis.
        turns = _in_body(tables[ANGLE_AXIS])
        turned = Rotation.from_rotvec(turns[:, 1:])
        return MotionTrack.of_orientations(turns[:, 0], turned, "camm, orientations"), tuple(said)
    if len(tables[GYRO]) < 2:
        return None, (*said, "the motion track tells no rotations")
    gyro, felt = (_in_body(tables[kind]) for kind in (GYRO, ACCELERATION))
    if not len(felt):
        said.append("the motion track has no accelerometer: its first orientation is taken for level")
    return MotionTrack.of_imu(gyro, felt, "camm, gyroscope"), tuple(said)


def _in_body(table: np.ndarray) -> np.ndarray:
    """Rows of time and vector ``(N, 4)``, from the camera's optical axes to ours."""
    return np.concatenate([table[:, :1], table[:, 1:] @ OPTICAL_R_BODY], axis=1)
