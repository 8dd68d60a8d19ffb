"""The camera's rotation over time, from the motion track of a video: orientations, or gyroscope and accelerometer.

A gyroscope alone drifts. Gravity, as the accelerometer feels it, corrects roll and pitch; the heading has no such
reference and drifts with the gyroscope's bias. The whole track is known, so the correction looks both ways in time:
`complementary` is the complementary filter (W. T. Higgins, IEEE Trans. AES 11, 1975; R. Mahony et al., IEEE Trans.
Automatic Control 53, 2008) without its delay.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from eagor._lazy import lazy
from eagor.errors import FormatError, PoseError
from eagor.sphere import interpolate_rotation

__all__ = ["MotionTrack", "complementary", "integrate"]

MARGIN = 0.1  # seconds beyond the ends of the track in which its first or last orientation holds
# Seconds over which accelerations are averaged: longer than a step or a swing of the arm (1 to 2 s), so that they
# cancel; short enough that a gyroscope with a bias of 0.5 degrees per second turns by 2.5 degrees meanwhile.
SMOOTHING = 5.0
GRAVITY = (4.9, 14.7)  # m/s^2: half to one and a half of gravity; outside, the camera is shaken, falls, or is no camera
FASTEST = 100.0  # radians per second: 5700 degrees; gyroscopes in cameras measure up to 4000
LONGEST = 4_000_000  # samples: an hour at 1 kHz


@dataclass(frozen=True, eq=False)
class MotionTrack:
    """Orientations of the camera at known times.

    `stamps` ``(N,)``: seconds on the video's clock, increasing. `rotations`: world_R_body at each; the world has z up.
    `source`: for texts.
    """

    stamps: np.ndarray
    rotations: Rotation = field(repr=False)
    source: str = ""

    @lazy
    def start(self) -> float:
        """The first stamp."""
        return float(self.stamps[0])

    @lazy
    def end(self) -> float:
        """The last stamp."""
        return float(self.stamps[-1])

    def world_R_body(self, stamp: float) -> np.ndarray:
        """The pose ``(3, 3)`` at `stamp`, on the shortest turn between the samples around it.

        Raises `PoseError` more than `MARGIN` beyond the ends of the track.
        """
        if not self.start - MARGIN <= stamp <= self.end + MARGIN:
            raise PoseError(
                f"the motion track ({self.source}) tells no orientation at {stamp:.3f} s: it goes from "
                f"{self.start:.3f} to {self.end:.3f} s. Take pictures from within these times, or "
                "give the poses in another way"
            )
        after = int(np.searchsorted(self.stamps, stamp))
        if after == 0 or after == len(self.stamps):
            return self.rotations[min(after, len(self.stamps) - 1)].as_matrix()
        share = (stamp - self.stamps[after - 1]) / (self.stamps[after] - self.stamps[after - 1])
        start, end = self.rotations[after - 1 : after + 1].as_matrix()
        return interpolate_rotation(start, end, float(share))

    @classmethod
    def of_orientations(cls, stamps: np.ndarray, rotations: Rotation, source: str) -> MotionTrack:
        """From samples in any order; of several at one time the first counts."""
        stamps, first = np.unique(stamps, return_index=True)
        return cls(stamps, Rotation.from_quat(rotations.as_quat()[first]), source)

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
        turned = integrate(gyro[:, 0], gyro[:, 1:])
        felt = np.zeros((0, 4)) if acceleration is None else _in_order(acceleration)
        size = np.linalg.norm(felt[:, 1:], axis=1)
        felt = felt[(size > GRAVITY[0]) & (size < GRAVITY[1])]
        if len(felt):
            turned = complementary(gyro[:, 0], turned, felt[:, 0], felt[:, 1:])
        forward = turned.apply([1.0, 0.0, 0.0])[0]
        heading = np.arctan2(forward[1], forward[0])
        turned = Rotation.from_rotvec([0.0, 0.0, -heading]) * turned
        return cls(gyro[:, 0], turned, source)


def integrate(stamps: np.ndarray, rates: np.ndarray) -> Rotation:
    """Orientations (N) from angular rates ``(N, 3)`` (radians per second, body frame) at `stamps` ``(N,)``.

    The rate of each interval is the mean of its ends. The first orientation is the identity. The products of all
    turns up to each sample are made by doubling (W. D. Hillis and G. L. Steele, Comm. ACM 29, 1986).
    """
    steps = np.diff(stamps)[:, None] * (rates[1:] + rates[:-1]) / 2
    total = Rotation.from_rotvec(np.concatenate([np.zeros((1, 3)), steps]))
    reach = 1
    while reach < len(stamps):
        joined = total[:-reach] * total[reach:]
        total = Rotation.concatenate([total[:reach], joined])
        reach *= 2
    return total


def complementary(stamps: np.ndarray, turned: Rotation, times: np.ndarray, felt: np.ndarray) -> Rotation:
    """`turned` (N, at `stamps`) corrected so that gravity, `felt` ``(M, 3)`` at `times`, points up on average.

    What is felt is brought to the axes of `turned`, where gravity changes as slowly as the gyroscope drifts, and
    averaged over `SMOOTHING`. Each orientation is then turned by the least angle that brings it to z.
    """
    nearest = np.clip(np.searchsorted(stamps, times), 0, len(stamps) - 1)
    up = Rotation.from_quat(turned.as_quat()[nearest]).apply(felt)
    up = _smoothed(times, up, stamps)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return _to_z(up) * turned


def _smoothed(times: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The mean of `values` ``(M, 3)`` within `SMOOTHING` / 2 of each time `at`; where there is none, a near one."""
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(values, axis=0)])
    low = np.searchsorted(times, at - SMOOTHING / 2)
    high = np.searchsorted(times, at + SMOOTHING / 2, side="right")
    empty = high <= low
    low = np.where(empty, np.clip(low, 0, len(times) - 1), low)
    high = np.where(empty, low + 1, high)
    return (sums[high] - sums[low]) / (high - low)[:, None]


def _to_z(up: np.ndarray) -> Rotation:
    """The least turns that bring unit vectors ``(N, 3)`` to z; by half a turn about x where they point down."""
    x, y, z = up.T
    quaternion = np.stack([y, -x, np.zeros_like(x), 1 + z], axis=1)  # axis: up x (0, 0, 1)
    quaternion[1 + z < 1e-12] = (1.0, 0.0, 0.0, 0.0)
    return Rotation.from_quat(quaternion)


def _in_order(samples: np.ndarray) -> np.ndarray:
    """Finite samples ``(N, 4)`` in order of time, each time once."""
    samples = np.asarray(samples, dtype=np.float64).reshape(-1, 4)
    samples = samples[np.isfinite(samples).all(axis=1)]
    return samples[np.unique(samples[:, 0], return_index=True)[1]]
