"""How a camera turned between two pictures, from directions that were matched.

A camera that only turned is compared with one that also moved; what makes the pairs likelier counts. The first is found
by RANSAC (Fischler & Bolles, CACM 24, 1981), the second by pycolmap, for any lens by way of an equirectangular camera.
Without pycolmap (there is no wheel for Linux on ARM) a camera that walks is off by its parallax, and its deviation says
so. In a narrow field a step to the side, or a thing that moves, looks much like a turn: `model_std` tells.
"""

from __future__ import annotations

import ctypes
import math
import signal
import sys
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit, gammaln

from eagor.conventions import from_optical, to_optical

__all__ = ["RelativeRotation", "angle_between", "bin_index", "estimate_relative_rotation"]

SPHERE = 4 * math.pi  # steradians
CHANCE = math.log(1e-5)  # of the expected number of agreements among unrelated pairs; above it one counts as chance
SAMPLES, TRIALS = 512, 1000  # of two pairs for a turn, of five for turn and motion
NEAR = math.radians(0.1)  # two pairs nearer than that are as good
SHARPEST = math.radians(0.02)  # deviation that counts: pairs that are drawn, or fixed to the camera, may seem exact
WIDTH = 4096  # pixels of the equirectangular camera
OFF = 0.5, 0.2  # degrees by which pairs may miss an epipolar circle: over the sphere, in a field of a steradian
TAKEN = ("SIGTERM", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGSEGV")  # by pycolmap's logging
UNSURE = 30.0  # nats by which one kind of motion has to be likelier than the other, to count as sure
# Degrees by which a turn is off for each degree that single pairs are off, where what is left may be parallax or
# distortion, which neighbours share. In rendered walks, at 65 and 90 degrees, 2 to 8.
SHARED = 4.0


@dataclass(frozen=True, eq=False)
class RelativeRotation:
    """`old_R_new` ``(3, 3)`` with the `covariance` ``(3, 3)`` of its error (radians squared, axes of the old frame).

    `direction`: unit vector ``(3,)`` of the camera's motion in the old frame, or None if it stood still as far as the
    pictures tell. `inliers`: booleans ``(n,)``; `log_nfa`: logarithm of the expected number of as many by chance.
    `noise`: deviation of one pair, radians per axis. `model_std`: deviation of the angle by which the turn is off
    because its model may be wrong; not part of the covariance, since turns one after the other err alike.
    """

    old_R_new: np.ndarray
    covariance: np.ndarray
    direction: np.ndarray | None
    inliers: np.ndarray
    log_nfa: float
    noise: float
    model_std: float = 0.0


def estimate_relative_rotation(
    old: np.ndarray,
    new: np.ndarray,
    *,
    level: bool = False,
    moves: bool = True,
    area: float = SPHERE,
    guess: tuple[np.ndarray, float] | None = None,
) -> RelativeRotation | None:
    """The turn from matched unit vectors `old` and `new` ``(n, 3)``; None if they agree no better than by chance.

    `level`: turns are about z only. `moves`: False for a camera that only turns. `area`: steradians that it sees.
    `guess`: a rotation ``(3, 3)``, and by how much (radians) the turn may differ. The same input gives the same result.
    """
    pairs = _Pairs(old, new, area)
    fits = [fit for fit in (_turned(pairs, guess), _moved(pairs) if moves else None) if fit is not None]
    fits = [fit for fit in fits if guess is None or angle_between(guess[0], fit.rotation) <= guess[1]]
    if not fits:
        return None
    best, *other = sorted(fits, key=lambda fit: -fit.evidence)
    covariance = best.covariance()
    most = math.pi if guess is None else min(guess[1], math.pi)
    among = math.log(max((most - math.sin(most)) / math.pi, 1e-9))  # the share of all rotations that the guess allows
    if covariance is None or min(fit.log_nfa for fit in fits) + among > CHANCE:
        return None
    model_std = 0.0
    if moves and best.direction is None and (area < SPHERE or find_spec("pycolmap") is None):
        model_std = SHARED * best.noise
    if area < SPHERE:
        rest = best.right <= 0.5  # a large thing that moves, or all but one
        rival = _turned(_Pairs(old[rest], new[rest], area), guess) if best.direction is None else None
        if rival is not None and rival.log_nfa < CHANCE:
            likely = float(expit((rival.places - best.places) / 3))
            model_std = math.hypot(model_std, likely * angle_between(best.rotation, rival.rotation))
        for fit in other:
            likely = float(expit((fit.evidence - best.evidence) / UNSURE))
            model_std = math.hypot(model_std, likely * angle_between(best.rotation, fit.rotation))
    rotation = best.rotation
    if level:
        yaw = math.atan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])  # of the nearest one
        rotation, covariance = Rotation.from_rotvec([0, 0, yaw]).as_matrix(), covariance * np.diag([0.0, 0, 1])
    return RelativeRotation(
        rotation, covariance, best.direction, best.right > 0.5, best.log_nfa, best.noise, model_std
    )  # fmt: skip


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Radians between two rotations ``(3, 3)``."""
    return float(Rotation.from_matrix(a.T @ b).magnitude())


def bin_index(directions: np.ndarray, parts: int = 4) -> np.ndarray:
    """A number ``(n,)`` for the place of each direction ``(n, 3)``: of `parts` squares along each edge of a cube."""
    axis, row = np.abs(directions).argmax(axis=1), np.arange(len(directions))
    ahead = directions[row, axis]
    plane = np.stack([directions[row, (axis + 1) % 3], directions[row, (axis + 2) % 3]], axis=1) / ahead[:, None]
    square = np.clip(((plane + 1) / 2 * parts).astype(int), 0, parts - 1)
    return ((axis * 2 + (ahead < 0)) * parts + square[:, 0]) * parts + square[:, 1]


class _Pairs:
    """Matched directions ``(n, 3)``, and in which of `count` places they are; `weights`: no place has more than others.

    Neighbours are not independent: a chair seen in two rooms is one coincidence, not thirty, and a tripod with a
    pattern is not more of the world than a wall with few points.
    """

    def __init__(self, old: np.ndarray, new: np.ndarray, area: float) -> None:
        self.old, self.new, self.area = old, new, area
        index = bin_index(old, max(4, math.ceil(math.sqrt(40 * SPHERE / area / 6))))  # 40 in a field, or more
        _, self.bins, sizes = np.unique(index, return_inverse=True, return_counts=True)
        self.count = len(sizes)
        self.weights = ((1 + np.median(sizes)) / (1 + sizes))[self.bins] if len(old) else np.empty(0)

    def aligned(self, shares: np.ndarray) -> np.ndarray:
        """The rotation ``(3, 3)`` that brings `new` nearest to `old`, pairs counting by `shares` ``(n,)`` (Kabsch)."""
        left, _, right = np.linalg.svd((self.old * (self.weights * shares)[:, None]).T @ self.new)
        return left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right


def _turned(pairs: _Pairs, guess: tuple[np.ndarray, float] | None) -> _Fit | None:
    """The rotation with ``rotation @ new = old`` for most pairs: the best of many from two each, then from all."""
    if pairs.count <= 2:
        return None
    chosen = np.random.default_rng(0).choice(len(pairs.old), (SAMPLES, 2), p=pairs.weights / pairs.weights.sum())
    rotations = _frames(pairs.old[chosen]) @ _frames(pairs.new[chosen]).swapaxes(1, 2)
    if guess is not None:
        rotations = rotations[
            np.sum(guess[0] * rotations, axis=(1, 2)) >= 1 + 2 * math.cos(min(guess[1], math.pi)) - 1e-9
        ]
    if not len(rotations):
        return None
    products = (pairs.old[:, :, None] * pairs.new[:, None, :]).reshape(-1, 9)
    scores = np.log(np.maximum(2 - 2 * rotations.reshape(-1, 9) @ products.T, 0) + NEAR**2) @ pairs.weights
    rotation = rotations[scores.argmin()]
    for _ in range(5):
        rotation = pairs.aligned(1 / (np.sum((pairs.old - pairs.new @ rotation.T) ** 2, axis=1) + NEAR**2))
    return _Fit(pairs, pairs.aligned(_Fit(pairs, rotation, None).right), None)


def _frames(vectors: np.ndarray) -> np.ndarray:
    """Axes ``(m, 3, 3)`` of two unit vectors ``(m, 2, 3)`` each: along their sum and their difference, and across."""
    both = np.stack([vectors[:, 0] + vectors[:, 1], vectors[:, 0] - vectors[:, 1]], axis=1)
    both /= np.maximum(np.linalg.norm(both, axis=2, keepdims=True), 1e-12)
    return np.stack([*both.swapaxes(0, 1), np.cross(both[:, 0], both[:, 1])], axis=-1)


def _moved(pairs: _Pairs) -> _Fit | None:
    """The turn and the motion that put most pairs on epipolar circles; None from few places, and without pycolmap."""
    if pairs.count <= 8 or find_spec("pycolmap") is None:
        return None
    pycolmap = import_pycolmap()
    camera: Any = pycolmap.Camera.create_from_model_name(1, "EQUIRECTANGULAR", 1.0, WIDTH, WIDTH // 2)
    options = pycolmap.TwoViewGeometryOptions(compute_relative_pose=True, detect_watermark=False)
    options.ransac.random_seed, options.ransac.max_num_trials = 0, TRIALS
    options.ransac.max_error = min(OFF[0], OFF[1] * math.sqrt(pairs.area)) / 360 * WIDTH
    old, new = (camera.img_from_cam(to_optical(each)) for each in (pairs.old, pairs.new))
    same = np.repeat(np.arange(len(old), dtype=np.uint32)[:, None], 2, axis=1)
    pose = pycolmap.estimate_calibrated_two_view_geometry(camera, old, camera, new, same, options).cam2_from_cam1
    if pose is None or not np.linalg.norm(pose.translation) > 1e-6:
        return None
    back = pose.inverse()
    rotation = from_optical(from_optical(back.rotation.matrix()).T).T
    return _Fit(pairs, rotation, from_optical(back.translation / np.linalg.norm(back.translation)))


def import_pycolmap() -> Any:
    """pycolmap. Its import takes over how SIGTERM and a crash end this process; they are given back to who had them.

    From any thread, which `signal.signal` is not for.
    """
    if "pycolmap" in sys.modules or sys.platform == "win32":
        return import_module("pycolmap")
    libc = ctypes.CDLL(None)
    had = {getattr(signal, name): ctypes.create_string_buffer(256) for name in TAKEN}  # a struct, and more
    for number, action in had.items():
        libc.sigaction(number, None, action)
    pycolmap = import_module("pycolmap")
    for number, action in had.items():
        libc.sigaction(number, action, None)
    return pycolmap


class _Fit:
    """A model of the motion: noise, mistakes, and shifts along the motion (exponential) that fit the pairs best (EM).

    `right` ``(n,)``: the probability that a pair is no mistake; `evidence`: the Bayesian information criterion
    (Schwarz, Annals of Statistics 6, 1978), as a logarithm, each place weighing the same; `log_nfa`: the logarithm of
    the expected number of as good agreements by chance (a contrario: Moisan & Stival, IJCV 57, 2004, equation 12).
    """

    def __init__(self, pairs: _Pairs, rotation: np.ndarray, direction: np.ndarray | None) -> None:
        self.pairs, self.rotation, self.direction = pairs, rotation, direction
        misses, along = self._misses(rotation, direction)
        squares, axes = np.sum(misses**2, axis=1), 2 if direction is None else 1
        right, spread, log_any = NEAR**2 / (NEAR**2 + squares), 0.0, np.zeros(len(squares))
        for _ in range(8):
            weights = pairs.weights * right
            total = max(float(weights.sum()), 1e-9)
            spread = float(weights @ squares) / (axes * total)
            variance = spread + SHARPEST**2
            share = min(max(total / float(pairs.weights.sum()), 0.01), 0.99)
            log_right = math.log(share) - squares / (2 * variance) - axes / 2 * math.log(2 * math.pi * variance)
            if direction is not None:
                mean = float(weights @ along) / total + 1e-4
                log_right -= along / mean + math.log(2 * mean)
            log_any = np.logaddexp(log_right, math.log1p(-share) - math.log(pairs.area))
            right = np.exp(log_right - log_any)
        self.right, self.noise, sample = right, math.sqrt(spread) + 1e-6, 2 if direction is None else 5
        self.evidence = float(log_any @ pairs.weights) - (sample + 3) / 2 * math.log(pairs.weights.sum())
        self.places, n = len(np.unique(pairs.bins[right > 0.5])), pairs.count
        # As near by chance: within a circle, or a band along a great circle of a round field.
        least = np.full(n, np.inf)
        np.minimum.at(least, pairs.bins, squares)
        reach, k = np.maximum(np.sqrt(np.sort(least))[sample:], 2 * NEAR), np.arange(sample + 1, n + 1)
        field = 2 * math.acos(max(1 - pairs.area / (2 * math.pi), -1.0))
        near = math.pi * reach**2 if direction is None else 2 * field * reach
        chances = np.log(np.minimum(near / pairs.area * len(right) / n, 1))
        choices = gammaln(n + 1) - gammaln(n - k + 1) - gammaln(sample + 1) - gammaln(k - sample + 1)
        self.log_nfa = float(np.min(math.log(n) + choices + (k - sample) * chances, initial=0.0))

    def _misses(self, rotation: np.ndarray, direction: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """How far pairs are apart then, ``(n, c)``: in all, or across the motion; and along it ``(n,)``."""
        old, turned = self.pairs.old, self.pairs.new @ rotation.T
        if direction is None:
            return old - turned, np.zeros(len(old))
        normals = np.cross(direction, old)
        sines = np.maximum(np.linalg.norm(normals, axis=1), 1e-6)
        along = np.sum(turned * (old * (old @ direction)[:, None] - direction), axis=1)
        return (np.sum(turned * normals, axis=1) / sines)[:, None], np.abs(along) / sines

    def covariance(self) -> np.ndarray | None:
        """Covariance ``(3, 3)`` of the turn, radians squared; None from too few places.

        The larger of the inverse curvature and the sandwich (Huber 1967), which survives a wrong model. Pairs in one
        place may share their errors, so their scores are added before they are squared (Liang & Zeger, Biometrika 73,
        1986).
        """
        tilts = None if self.direction is None else np.linalg.svd(self.direction[None])[2][1:]

        def misses(change: np.ndarray) -> np.ndarray:
            rotation = Rotation.from_rotvec(change[:3]).as_matrix() @ self.rotation
            return self._misses(rotation, None if tilts is None else self.direction + change[3:] @ tilts)[0]

        k, weights = 3 if tilts is None else 5, self.pairs.weights * self.right
        if self.places <= k:
            return None
        slopes = np.stack([(misses(step) - misses(-step)) / 2e-5 for step in np.eye(k) * 1e-5], axis=-1)
        bread = np.linalg.pinv(np.einsum("n,nci,ncj->ij", weights, slopes, slopes), hermitian=True)
        scores = np.zeros((self.pairs.count, k))
        np.add.at(scores, self.pairs.bins, np.einsum("n,nci,nc->ni", weights, slopes, misses(np.zeros(k))))
        both = bread[:3, :3] * self.noise**2, (bread @ (scores.T @ scores) @ bread)[:3, :3]
        return max(both, key=np.trace) * self.places / (self.places - k)
