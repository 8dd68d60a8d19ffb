"""How late a camera's stamps are: the turns that its pictures show, compared with odometry's.

A camera that stamps its pictures `latency` seconds late shows at the stamp t what odometry told for t - latency. For
each step between two pictures both tell how far the body turned about its vertical axis; the latency is the shift at
which the two series have the highest correlation. Its interval is from a moving-block bootstrap (H. Kunsch, Annals of
Statistics 17, 1989): neighbouring steps are not independent.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from eagor.errors import PoseError
from eagor.media import Frame, Pose
from eagor.odometry.visual import VisualOdometer

__all__ = ["Latency", "check_turning", "latency_between", "steps_of"]

GRID = 0.005  # seconds between the shifts that are tried; the peak is found between them
FEWEST = 20  # steps
LEAST_CHANGE = math.radians(3.0)  # per second: by how much the turning rate has to vary to tell anything
LEAST_MATCH = 0.5  # correlation below which the two do not show the same motion
BLOCK, DRAWS = 1.0, 400  # seconds of neighbouring steps that are drawn together, and how often
LONGEST = 1.0  # seconds between two pictures that make a step


@dataclass(frozen=True)
class Latency:
    """`seconds` from capture to stamp, the `interval` that holds it with 95 %, and the correlation there.

    `steps`: how many were compared. `mirrored`: whether the pictures turn the other way than odometry does.
    """

    seconds: float
    interval: tuple[float, float]
    correlation: float
    steps: int
    mirrored: bool = False


def steps_of(frames: Iterable[Frame]) -> np.ndarray:
    """How a camera turned from picture to picture: start, end (seconds), turn to the left about body z (radians).

    ``(n, 3)``, from its pictures; where it got lost, there is no step.
    """
    odometer, before, rows = VisualOdometer(), None, []
    for frame in frames:
        if frame.picture is None:
            continue
        turned = odometer.add(frame.picture)
        if before is not None and not turned.lost and turned.matches and frame.stamp - before[0] <= LONGEST:
            turn = Rotation.from_matrix(before[1].T @ turned.world_R_body).as_rotvec()
            rows.append((before[0], frame.stamp, float(turn[2])))
        before = frame.stamp, turned.world_R_body
    return np.array(rows).reshape(-1, 3)


def latency_between(steps: np.ndarray, poses: Sequence[Pose], *, most: float = 1.0, seed: int = 0) -> Latency:
    """The latency of `steps` (`steps_of`) against `poses` in order of time, from -`most` to `most` seconds.

    Negative: odometry is the later one. Raises `PoseError` where the motion does not tell it: too few steps that both
    cover, too little change of the turning rate, no correlation, or a peak at the end of what is searched.
    """
    slerp = check_turning(poses)
    first, last = poses[0].stamp, poses[-1].stamp
    start, end, turned = steps[(steps[:, 0] - most >= first) & (steps[:, 1] + most <= last)].T
    n = len(start)
    if n < FEWEST:
        span = f"{steps[0, 0]:.2f} to {steps[-1, 1]:.2f} s" if len(steps) else "none that could be compared"
        raise PoseError(
            f"{n} steps between pictures lie within the odometry, {most:g} s off its ends; wanted {FEWEST} or more. "
            f"Pictures: {span}; odometry: {first:.2f} to {last:.2f} s. Both need one clock: shift one of them, or "
            "record longer"
        )
    shifts = np.arange(-most, most + GRID / 2, GRID)
    rates = np.stack([_turned(slerp, start - shift, end - shift) for shift in shifts]) / (end - start)  # (shifts, n)
    seen = turned / (end - start)
    values = _correlation(rates, seen)
    mirrored = bool(values.max() < -values.min() - 0.2)
    if mirrored:
        values, seen = -values, -seen
    at = int(values.argmax())
    if values[at] < LEAST_MATCH:
        raise PoseError(
            f"what the pictures show and what odometry tells do not agree at any shift up to {most:g} s (highest "
            f"correlation {values[at]:.2f}; wanted {LEAST_MATCH:g} or more). Are they of the same time and body, and "
            "is the shift larger (--most SECONDS)?"
        )
    if at in (0, len(shifts) - 1):
        raise PoseError(
            f"the best shift is {shifts[at]:+.2f} s, the end of what was searched; search farther: --most {2 * most:g}"
        )
    random, peaks = np.random.default_rng(seed), []
    block = min(max(1, round(BLOCK / float(np.median(end - start)))), max(1, n // 4))
    for _ in range(DRAWS):
        begins = random.integers(0, n - block + 1, math.ceil(n / block))
        drawn = (begins[:, None] + np.arange(block)).ravel()[:n]
        peaks.append(_peak(shifts, _correlation(rates[:, drawn], seen[drawn])))
    low, high = map(float, np.quantile(peaks, [0.025, 0.975]))
    return Latency(_peak(shifts, values), (low, high), float(values[at]), n, mirrored)


def check_turning(poses: Sequence[Pose]) -> Slerp:
    """The orientations in between. Raises `PoseError` if these turn too evenly to tell a latency."""
    if len(poses) < 2:
        raise PoseError(f"odometry has {len(poses)} poses; wanted those of the time in which the pictures were taken")
    stamps = [pose.stamp for pose in poses]
    slerp = Slerp(stamps, Rotation.from_matrix(np.stack([pose.world_R_body for pose in poses])))
    ticks = np.linspace(stamps[0], stamps[-1], max(2, math.ceil((stamps[-1] - stamps[0]) / 0.1)))
    change = float(np.std(_turned(slerp, ticks[:-1], ticks[1:]) / np.diff(ticks)))
    if change < LEAST_CHANGE:
        raise PoseError(
            f"the turning rate varies by {math.degrees(change):.1f} degrees per second (standard deviation); wanted "
            f"{math.degrees(LEAST_CHANGE):g} or more. Turn the camera left and right about its vertical axis, briskly, "
            "for half a minute"
        )
    return slerp


def _turned(slerp: Slerp, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """How far odometry turned about body z between these times, radians ``(n,)``."""
    return (slerp(start).inv() * slerp(end)).as_rotvec()[:, 2]


def _correlation(rates: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Pearson's, of each row of `rates` ``(s, n)`` with `seen` ``(n,)``."""
    rates, seen = rates - rates.mean(axis=1, keepdims=True), seen - seen.mean()
    return (rates @ seen) / np.maximum(np.linalg.norm(rates, axis=1) * np.linalg.norm(seen), 1e-12)


def _peak(shifts: np.ndarray, values: np.ndarray) -> float:
    """Where the parabola through the highest value and its neighbours is highest."""
    at = min(max(int(values.argmax()), 1), len(shifts) - 2)
    a, b, c = values[at - 1 : at + 2]
    bend = a - 2 * b + c
    return float(shifts[at] + (GRID * 0.5 * (a - c) / bend if bend < -1e-12 else 0.0))
