"""The camera's rotation over time from the gyroscope and the accelerometer in a video.

A gyroscope alone drifts. Gravity, as the accelerometer feels it, corrects roll and pitch; the heading has no such
reference and drifts with the gyroscope's bias. The whole track is known, so the correction looks both ways in time: a
complementary filter (W. T. Higgins, IEEE Trans. AES 11, 1975) without its delay.

What is read is the trailer that Insta360 cameras append to their videos. Its format is not published by its maker; this
follows public descriptions (ExifTool's tag tables and the project telemetry-parser), little-endian: the file's last 72
bytes are 32 of padding, the trailer's length, its version and a magic text; before them lie records, each followed by
its format, id and length. (The package telemetry-parser takes 2 GB for ten minutes at 1 kHz, and a damaged file ends
the process.)
"""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from eagor._values import lazy
from eagor.errors import FormatError, PoseError
from eagor.odometry import Pose

__all__ = ["MotionTrack", "Trailer", "read_insta360"]

RATE = 100.0  # poses per second that are taken from a track
MARGIN = 0.1  # seconds beyond the ends of the track in which its first or last orientation holds
# Seconds over which accelerations are averaged: longer than a step or a swing of the arm (1 to 2 s), so that they
# cancel; short enough that a gyroscope with a bias of 0.5 degrees per second turns by 2.5 degrees meanwhile.
SMOOTHING = 5.0
GRAVITY = (4.9, 14.7)  # m/s^2: half to one and a half of gravity; outside, the camera is shaken, falls, or is no camera
FASTEST = 100.0  # radians per second: 5700 degrees; gyroscopes in cameras measure up to 4000
LONGEST = 4_000_000  # samples: an hour at 1 kHz

MAGIC = b"8db42d694ccc418790edff439fe026bf"
ENDING = 72  # bytes: padding, length, version, magic
ABOUT, IMU = 1, 3  # ids of records; ExifTool writes 0x101 and 0x300, with the format as one of the two bytes
LARGEST = 1 << 28  # bytes of one record: a gyroscope at 1 kHz for an hour has 2e8
CAMERA_NAME, FIRST, LATER, HAS_LATER, RAW, RANGES = 2, 24, 28, 29, 62, 65  # fields of the record ABOUT
G = 9.80665  # m/s^2
ABSURD = 1e5  # a value as large as that is no measurement: raw ones have 16 bits


@dataclass(frozen=True, eq=False)
class MotionTrack:
    """A `PoseSource`: orientations of the camera at known times, from its IMU; iterating gives `RATE` per second.

    `stamps` ``(N,)``: seconds on the video's clock, increasing. `rotations`: world_R_body at each; the world has z up.
    `source`: for texts.
    """

    stamps: np.ndarray
    rotations: Rotation = field(repr=False)
    source: str = ""

    def __iter__(self) -> Iterator[Pose]:
        first, last = self.stamps[[0, -1]].tolist()
        for number in range(int((last - first) * RATE) + 1):
            yield Pose(stamp := first + number / RATE, self.world_R_body(stamp))

    def close(self) -> None:
        """Nothing is held."""

    def world_R_body(self, stamp: float) -> np.ndarray:
        """The pose ``(3, 3)`` at `stamp`, on the shortest turn between the samples around it.

        Raises `PoseError` more than `MARGIN` beyond the ends of the track.
        """
        first, last = self.stamps[[0, -1]].tolist()
        if not first - MARGIN <= stamp <= last + MARGIN:
            raise PoseError(
                f"the motion track ({self.source}) tells no orientation at {stamp:.3f} s: it goes from {first:.3f} to "
                f"{last:.3f} s. Take pictures from within these times, or give the poses in another way"
            )
        return self._between(min(max(stamp, first), last)).as_matrix()

    @lazy
    def _between(self) -> Slerp:
        return Slerp(self.stamps, self.rotations)

    @classmethod
    def of_imu(cls, gyro: np.ndarray, acceleration: np.ndarray | None, source: str) -> MotionTrack:
        """From a gyroscope ``(N, 4)`` and an accelerometer ``(M, 4)`` or None: seconds, then x, y, z in the body frame.

        Radians per second, and metres per second squared (at rest: gravity, upwards). The heading is 0 at first.
        Raises `FormatError` if nothing can be made of them.
        """
        gyro = _in_order(gyro)
        gyro = gyro[np.linalg.norm(gyro[:, 1:], axis=1) < FASTEST]
        if not 2 <= len(gyro) <= LONGEST:
            raise FormatError(f"{source} holds {len(gyro)} gyroscope samples; wanted 2 to {LONGEST}")
        stamps, rates = gyro[:, 0], gyro[:, 1:]
        # The products of all turns up to each sample are made by doubling (Hillis & Steele, Comm. ACM 29, 1986).
        steps = np.diff(stamps)[:, None] * (rates[1:] + rates[:-1]) / 2
        turned, reach = Rotation.from_rotvec(np.concatenate([np.zeros((1, 3)), steps])), 1
        while reach < len(stamps):
            turned = Rotation.concatenate([turned[:reach], turned[:-reach] * turned[reach:]])
            reach *= 2
        felt = np.zeros((0, 4)) if acceleration is None else _in_order(acceleration)
        size = np.linalg.norm(felt[:, 1:], axis=1)
        felt = felt[(size > GRAVITY[0]) & (size < GRAVITY[1])]
        if len(felt):
            turned = _levelled(stamps, turned, felt[:, 0], felt[:, 1:])
        forward = turned.apply([1.0, 0.0, 0.0])[0]
        return cls(stamps, Rotation.from_rotvec([0.0, 0.0, -np.arctan2(forward[1], forward[0])]) * turned, source)


def _levelled(stamps: np.ndarray, turned: Rotation, times: np.ndarray, felt: np.ndarray) -> Rotation:
    """`turned` (N, at `stamps`) corrected so that gravity, `felt` ``(M, 3)`` at `times`, points up on average.

    What is felt is brought to the axes of `turned`, where gravity changes as slowly as the gyroscope drifts, and
    averaged over `SMOOTHING`. Each orientation is then turned by the least angle that brings it to z.
    """
    nearest = np.clip(np.searchsorted(stamps, times), 0, len(stamps) - 1)
    sums = np.concatenate(
        [np.zeros((1, 3)), np.cumsum(Rotation.from_quat(turned.as_quat()[nearest]).apply(felt), axis=0)]
    )
    low = np.searchsorted(times, stamps - SMOOTHING / 2)
    high = np.searchsorted(times, stamps + SMOOTHING / 2, side="right")
    low = np.where(high <= low, np.clip(low, 0, len(times) - 1), low)  # where nothing was felt, a near time counts
    up = sums[np.maximum(high, low + 1)] - sums[low]
    x, y, z = (up / np.linalg.norm(up, axis=1, keepdims=True)).T
    least = np.stack([y, -x, np.zeros_like(x), 1 + z], axis=1)  # about the axis up x (0, 0, 1)
    least[1 + z < 1e-12] = (1.0, 0.0, 0.0, 0.0)  # it points down
    return Rotation.from_quat(least) * turned


def _in_order(samples: np.ndarray) -> np.ndarray:
    """Finite samples ``(N, 4)`` in order of time, each time once."""
    samples = np.asarray(samples, dtype=np.float64).reshape(-1, 4)
    samples = samples[np.isfinite(samples).all(axis=1)]
    return samples[np.unique(samples[:, 0], return_index=True)[1]]


# --- Insta360 ---


class Trailer(NamedTuple):
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
        up = np.sum(self.acceleration[:, 1:], axis=0)
        axis = int(np.abs(up).argmax())
        z, x = np.eye(3)[axis] * np.sign(up[axis] or 1.0), np.eye(3)[(axis + 1) % 3]
        to_body = np.eye(4)  # of a row: its time stays
        to_body[1:, 1:] = np.stack([x, np.cross(z, x), z], axis=1)
        return MotionTrack.of_imu(self.gyro @ to_body, self.acceleration @ to_body, "Insta360 gyroscope")


def read_insta360(file: BinaryIO) -> Trailer | None:
    """The trailer of `file`; None if it has none. Raises `FormatError` if it is damaged."""
    size = file.seek(0, os.SEEK_END)
    at = file.seek(max(size - ENDING, 0))
    ending = file.read(ENDING)
    if len(ending) < ENDING or not ending.endswith(MAGIC):
        return None
    length = struct.unpack_from("<I", ending, 32)[0]
    if not ENDING <= length <= size:
        raise FormatError(f"has a damaged Insta360 trailer: it claims {length} bytes, in a file of {size}")
    records: dict[int, bytes] = {}
    while at - 6 >= size - length:  # the last one first
        file.seek(at - 6)
        _, kind, count = struct.unpack("<BBI", file.read(6))
        at -= 6 + count
        if at < size - length:
            break
        if kind in (ABOUT, IMU) and kind not in records and count <= LARGEST:
            file.seek(at)
            records[kind] = file.read(count)
    about = _fields(records.get(ABOUT, b""))
    camera = about.get(CAMERA_NAME)
    name = camera.decode("utf-8", "replace") if isinstance(camera, bytes) else ""
    return Trailer(name, *_samples(records.get(IMU, b""), about))


def _samples(data: bytes, about: dict[int, int | bytes]) -> tuple[np.ndarray, np.ndarray]:
    """Gyroscope and accelerometer, ``(N, 4)`` each, with times from the first picture."""
    raw = about.get(RAW, 0) == 1
    kind = np.dtype([("t", "<u8"), ("v", "<u2" if raw else "<f8", 6)])
    table = np.frombuffer(data, kind, len(data) // kind.itemsize)
    table = table[(np.abs(table["v"]) < ABSURD).all(axis=1)]  # NaN fails the comparison
    values, g, turn = table["v"].astype(np.float64), G, 1.0
    if raw:  # 16 bits for the whole range
        ranges = _fields(about.get(RANGES, b""))
        most = [ranges.get(field) for field in (1, 2)]
        acceleration, rate = (m if isinstance(m, int) and m else n for m, n in zip(most, (16, 2000), strict=True))
        values, g, turn = (values - 32768) / 32768, G * acceleration, np.radians(rate)
    first, later = about.get(FIRST), about.get(LATER) if about.get(HAS_LATER) == 1 else None
    shift = struct.unpack("<d", later)[0] if isinstance(later, bytes) and len(later) == 8 else 0.0
    times = (table["t"].astype(np.float64) - (first if isinstance(first, int) else 0)) / (1e6 if raw else 1e3)
    times = (times - (shift / 1e3 if np.isfinite(shift) else 0.0))[:, None]  # milliseconds from the pictures to the IMU
    return np.concatenate([times, values[:, 3:] * turn], axis=1), np.concatenate([times, values[:, :3] * g], axis=1)


def _fields(data: int | bytes) -> dict[int, int | bytes]:
    """The fields of a message (Protocol Buffers, "Encoding"): numbers as int, all else as bytes. Ends where damaged."""
    found: dict[int, int | bytes] = {}
    left = io.BytesIO(data if isinstance(data, bytes) else b"")
    try:
        while True:
            tag = _varint(left)
            if tag & 7 == 0:
                found[tag >> 3] = _varint(left)
            else:
                size = _varint(left) if tag & 7 == 2 else {1: 8, 5: 4}[tag & 7]
                if len(value := left.read(min(size, LARGEST))) < size:
                    return found
                found[tag >> 3] = value
    except (IndexError, KeyError):  # it ends, or is of another kind
        return found


def _varint(data: BinaryIO) -> int:
    value = shift = 0
    while shift < 64:
        byte = data.read(1)[0]
        value, shift = value | (byte & 127) << shift, shift + 7
        if byte < 128:
            return value
    raise IndexError("a number of more than 64 bits")
