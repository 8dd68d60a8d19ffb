"""How the camera turned between two panoramas, from matched directions, and how sure that is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor.media.consensus import Agreement, Parts, agreeing_motion, agreeing_rotation
from eagor.media.likelihood import Moving, Standing, covariance, evidence, maximise, right

FALSE_ALARM = 1e-5  # expected number of agreements among unrelated pairs; above it an agreement counts as chance


@dataclass(frozen=True, eq=False)
class Turn:
    """`old_R_new` ``(3, 3)`` with the `covariance` ``(3, 3)`` of its error (radians squared, axes of the old frame).

    `direction`: unit vector ``(3,)`` of the camera's motion in the old frame, or None if it stood still as far as the
    pictures tell. `inliers`: booleans ``(n,)``. `noise`: deviation of one pair, radians per axis.
    """

    old_R_new: np.ndarray
    covariance: np.ndarray
    direction: np.ndarray | None
    inliers: np.ndarray
    noise: float


def turn_between(old: np.ndarray, new: np.ndarray, *, level: bool = False, moves: bool = True) -> Turn | None:
    """The turn from matched unit vectors `old` and `new` ``(n, 3)``; None if they agree no better than by chance.

    A camera that stood still and one that moved are both fitted; the Bayesian information criterion decides. `level`:
    turns are about z only. `moves`: False leaves out the second model. The same input gives the same result: the random
    samples have a fixed seed.
    """
    random = np.random.default_rng(0)
    still = agreeing_rotation(old, new, random, level)
    if still is None:
        return None
    moved = agreeing_motion(old, new, still.rotation, random) if moves else None
    if min(each.log_chance for each in (still, moved) if each is not None) > math.log(FALSE_ALARM):
        return None
    axes = np.array([[0.0, 0.0, 1.0]]) if level else np.eye(3)
    parts = Parts(old)
    found: list[tuple[float, Standing | Moving, np.ndarray]] = []
    found.append(_fitted(Standing(old, new, still.rotation, axes, parts), still))
    if moved is not None:
        assert moved.direction is not None
        guess = _yaw_of(moved.rotation) if level else moved.rotation
        found.append(_fitted(Moving(old, new, guess, axes, parts, moved.direction), moved))
    _, model, parameters = max(found, key=lambda each: each[0])
    d = len(axes)
    spread = covariance(model, parameters)
    if spread is None:
        return None
    direction = model.direction if isinstance(model, Moving) else None
    inliers = right(model, parameters) > 0.5
    return Turn(model.rotation, axes.T @ spread @ axes, direction, inliers, math.exp(parameters[d]))


def _fitted(model: Standing | Moving, agreement: Agreement) -> tuple[float, Standing | Moving, np.ndarray]:
    """Evidence for the model, the model about its most likely pose, its parameters."""
    parameters = maximise(model, model.start(agreement.inliers))
    centred, left = model.at(parameters)
    return evidence(model, parameters), centred, left


def _yaw_of(rotation: np.ndarray) -> np.ndarray:
    """The rotation about z that is nearest."""
    yaw = math.atan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
