"""Actions of the environments: how to walk, and which direction to answer. All are flat: a Box or whole numbers.

| actions | walk | walk and answer |
|---|---|---|
| "continuous" | heading (radians, left), metres | answer x, y, z (body frame), heading, metres |
| "discrete" | Habitat's stop, forward, left, right | one of these, and the answer's azimuth and elevation as indices |
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from eagor._extras import how_to_install
from eagor.errors import MissingExtraError, WorldError
from eagor.sphere import azimuth_elevation, direction
from eagor.tasks.rules import Camera

try:
    import gymnasium as gymnasium  # for the modules that build on these spaces
    from gymnasium import spaces
except ImportError as error:
    raise MissingExtraError(f"a simulated task needs gymnasium: {how_to_install('sim')}") from error

__all__ = [
    "AZIMUTHS",
    "ELEVATIONS",
    "FORWARD",
    "LEFT",
    "RIGHT",
    "STOP",
    "Actions",
    "answer_from_indices",
    "answer_space",
    "answering_walk_space",
    "as_answer_and_walk",
    "as_walk",
    "indices_of_answer",
    "walking_space",
]

Actions = Literal["continuous", "discrete"]
STOP, FORWARD, LEFT, RIGHT = range(4)  # Habitat's order
# Answers as indices: directions 5 degrees apart, so none is farther than 3.6 degrees from one of them.
AZIMUTHS, ELEVATIONS = 72, 37


def answer_space() -> spaces.Box:
    """A direction ``(3,)`` in the body frame, of any length."""
    return spaces.Box(-1.0, 1.0, (3,), np.float32)


def walking_space(actions: str, camera: Camera) -> spaces.Box | spaces.Discrete:
    """Habitat's discrete actions, or (heading, distance): radians to the left, and metres up to one step."""
    if actions == "discrete":
        return spaces.Discrete(4)
    if actions == "continuous":
        low, high = np.array([-math.pi, 0.0], np.float32), np.array([math.pi, camera.step], np.float32)
        return spaces.Box(low, high, dtype=np.float32)
    raise WorldError(f"actions = {actions!r}; wanted 'continuous' (heading, distance) or 'discrete' (Habitat's four)")


def answering_walk_space(actions: str, camera: Camera) -> spaces.Box | spaces.MultiDiscrete:
    """Answer and walk in one action: a Box ``(5,)``, or three whole numbers (walk, azimuth, elevation)."""
    walk, answer = walking_space(actions, camera), answer_space()
    if isinstance(walk, spaces.Box):
        low, high = np.concatenate([answer.low, walk.low]), np.concatenate([answer.high, walk.high])
        return spaces.Box(low, high, dtype=np.float32)
    return spaces.MultiDiscrete([int(walk.n), AZIMUTHS, ELEVATIONS])


def as_walk(action: Any, actions: str, camera: Camera) -> tuple[float, float, bool]:
    """An action as (turn in radians, metres, stop). (heading, 0) means stop, as the discrete action 0 does."""
    if actions == "discrete":
        turn = {LEFT: math.radians(camera.turn), RIGHT: -math.radians(camera.turn)}.get(int(action), 0.0)
        return turn, camera.step if int(action) == FORWARD else 0.0, int(action) == STOP
    heading, distance = (float(value) for value in np.asarray(action, dtype=np.float64).reshape(2))
    if not (math.isfinite(heading) and math.isfinite(distance)):
        raise WorldError(f"action {action!r}; wanted a finite heading (radians) and distance (metres)")
    distance = min(max(distance, 0.0), camera.step)
    return heading, distance, distance == 0.0


def as_answer_and_walk(action: Any, actions: str) -> tuple[np.ndarray, Any]:
    """The answer ``(3,)`` and the walk (for `as_walk`) in an action of `answering_walk_space`.

    Raises `WorldError` for another shape, and for indices that there are not.
    """
    size, said = (3, "walk, azimuth, elevation") if actions == "discrete" else (5, "x, y, z, heading, distance")
    values = None if isinstance(action, dict) else np.asarray(action)
    if values is None or values.shape != (size,):
        raise WorldError(f"action {action!r}; wanted {size} numbers ({said})")
    if actions == "discrete":
        return answer_from_indices(int(values[1]), int(values[2])), int(values[0])
    return np.asarray(values[:3], dtype=np.float64), values[3:]


def answer_from_indices(azimuth: int, elevation: int) -> np.ndarray:
    """The direction ``(3,)`` of an answer in whole numbers: azimuth 5 degrees times the first, elevation from -90 on.

    Raises `WorldError` for an index that there is not.
    """
    if not (0 <= azimuth < AZIMUTHS and 0 <= elevation < ELEVATIONS):
        raise WorldError(
            f"answer ({azimuth}, {elevation}); wanted an azimuth from 0 to {AZIMUTHS - 1} and an elevation from 0 to "
            f"{ELEVATIONS - 1}"
        )
    return direction(2 * math.pi * azimuth / AZIMUTHS, math.pi * (elevation / (ELEVATIONS - 1) - 0.5))


def indices_of_answer(answer: np.ndarray) -> tuple[int, int]:
    """The whole numbers (azimuth, elevation) whose direction is nearest to `answer` ``(3,)`` in both angles."""
    azimuth, elevation = (float(angle) for angle in azimuth_elevation(np.asarray(answer, dtype=np.float64)))
    row = round((elevation / math.pi + 0.5) * (ELEVATIONS - 1))
    return round(azimuth / (2 * math.pi) * AZIMUTHS) % AZIMUTHS, min(max(row, 0), ELEVATIONS - 1)
