"""The trailer that Insta360 cameras append to their videos: gyroscope, accelerometer, name of the camera.

The format is not published by its maker. What is read here follows public descriptions (ExifTool's tag tables and the
project telemetry-parser): the file's last 72 bytes are 32 of padding, the trailer's length, its version and a magic
text; before them lie records, each followed by its format, id and length. All numbers are little-endian.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from eagor.errors import FormatError
from eagor.media.motion import MotionTrack

__all__ = ["Trailer", "read_trailer"]

MAGIC = b"8db42d694ccc418790edff439fe026bf"
ENDING = 72  # bytes: padding, length, version, magic
ABOUT, GYRO = 1, 3  # ids of records; ExifTool writes 0x101 and 0x300, with the format as one of the two bytes
LARGEST = 1 << 28  # bytes of one record: a gyroscope at 1 kHz for an hour has 2e8
CAMERA, FIRST, LATER, HAS_LATER, RAW, RANGES = 2, 24, 28, 29, 62, 65  # fields of the record ABOUT
G = 9.80665  # m/s^2
ABSURD = 1e5  # a value as large as that is no measurement: raw ones have 16 bits


@dataclass(frozen=True, eq=False)
class Trailer:
    """What a trailer says: the `camera` ("" if unknown) and its IMU, rows of seconds, x, y, z in the IMU's own axes.

    `gyro` ``(N, 4)``: radians per second. `acceleration` ``(N, 4)``: m/s^2.
    """

    camera: str
    gyro: np.ndarray
    acceleration: np.ndarray

    def motion(self) -> MotionTrack | None:
        """The camera's rotation; None without a gyroscope.

        The IMU's axes are not documented, and differ between cameras. The axis that feels gravity most, over the whole
        recording, is taken for the camera's up, and the next one (x, y, z, x) for its forward. So turns of the heading
        are right for a camera that was held upright or upside down; tilts may be about another axis.
        """
        if len(self.gyro) < 2:
            return None
        imu_R_body = _upright(np.sum(self.acceleration[:, 1:], axis=0))
        gyro, felt = (
            np.concatenate([table[:, :1], table[:, 1:] @ imu_R_body], axis=1)
            for table in (self.gyro, self.acceleration)
        )
        return MotionTrack.of_imu(gyro, felt, "Insta360 gyroscope")


def _upright(up: np.ndarray) -> np.ndarray:
    """imu_R_body ``(3, 3)``: z is the IMU's axis nearest to `up`, with its sign; x is the axis after it."""
    axis = int(np.abs(up).argmax())
    z = np.eye(3)[axis] * np.sign(up[axis] or 1.0)
    x = np.eye(3)[(axis + 1) % 3]
    return np.stack([x, np.cross(z, x), z], axis=1)


def read_trailer(file: BinaryIO) -> Trailer | None:
    """The trailer of `file`; None if it has none. Raises `FormatError` if it is damaged."""
    size = file.seek(0, os.SEEK_END)
    if size < ENDING:
        return None
    file.seek(size - ENDING)
    ending = file.read(ENDING)
    if not ending.endswith(MAGIC):
        return None
    length = struct.unpack_from("<I", ending, 32)[0]
    if not ENDING <= length <= size:
        raise FormatError(f"has a damaged Insta360 trailer: it claims {length} bytes, in a file of {size}")
    records = {}
    for kind, start, count in _records(file, size, size - length):
        if kind in (ABOUT, GYRO) and kind not in records and count <= LARGEST:
            file.seek(start)
            records[kind] = file.read(count)
    about = dict(_fields(records.get(ABOUT, b"")))
    camera = about.get(CAMERA, b"")
    name = camera.decode("utf-8", "replace") if isinstance(camera, bytes) else ""
    return Trailer(name, *_imu(records.get(GYRO, b""), about))


def _records(file: BinaryIO, size: int, begin: int) -> Iterator[tuple[int, int, int]]:
    """Id, start and length of each record, the last one first."""
    at = size - ENDING
    while at - 6 >= begin:
        file.seek(at - 6)
        _, kind, length = struct.unpack("<BBI", file.read(6))
        start = at - 6 - length
        if start < begin:
            return
        yield kind, start, length
        at = start


def _imu(data: bytes, about: dict[int, int | bytes]) -> tuple[np.ndarray, np.ndarray]:
    """Gyroscope and accelerometer, ``(N, 4)`` each, with times from the first picture."""
    raw = about.get(RAW, 0) == 1
    kind = np.dtype([("t", "<u8"), ("v", "<u2" if raw else "<f8", 6)])
    table = np.frombuffer(data, kind, len(data) // kind.itemsize)
    table = table[(np.abs(table["v"].astype(np.float64)) < ABSURD).all(axis=1)]  # NaN fails the comparison
    values = table["v"].astype(np.float64)
    g, turn = G, 1.0
    if raw:  # 16 bits for the whole range
        ranges = dict(_fields(about.get(RANGES, b"")))
        most = [ranges.get(field) for field in (1, 2)]
        acceleration, rate = (m if isinstance(m, int) and m else n for m, n in zip(most, (16, 2000), strict=True))
        values, g, turn = (values - 32768) / 32768, G * acceleration, np.radians(rate)
    first = about.get(FIRST, 0)
    later = about.get(LATER) if about.get(HAS_LATER) == 1 else None  # milliseconds from the pictures to the IMU
    shift = struct.unpack("<d", later)[0] if isinstance(later, bytes) and len(later) == 8 else 0.0
    times = (table["t"].astype(np.float64) - (first if isinstance(first, int) else 0)) / (1e6 if raw else 1e3)
    times = (times - (shift / 1e3 if np.isfinite(shift) else 0.0))[:, None]
    return np.concatenate([times, values[:, 3:] * turn], axis=1), np.concatenate([times, values[:, :3] * g], axis=1)


def _fields(data: int | bytes) -> Iterator[tuple[int, int | bytes]]:
    """The fields of a message (Protocol Buffers, "Encoding"): numbers as int, all else as bytes. Ends where damaged."""
    data = data if isinstance(data, bytes) else b""
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        kind = tag & 7
        if kind == 0:
            value, at = _varint(data, at)
            yield tag >> 3, value
            continue
        length, at = _varint(data, at) if kind == 2 else ({1: 8, 5: 4}.get(kind, len(data) + 1), at)
        if at + length > len(data):
            return
        yield tag >> 3, data[at : at + length]
        at += length


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of variable length and its end; beyond the end of `data` if it is cut off."""
    value = shift = 0
    while at < len(data) and shift < 64:
        value |= (data[at] & 127) << shift
        shift, at = shift + 7, at + 1
        if data[at - 1] < 128:
            return value, at
    return value, len(data) + 1
