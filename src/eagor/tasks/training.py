"""Wrappers with which training libraries learn in the environments: everything flat, bounded, in numbers.

    env = ForTraining(WithEstimate(gymnasium.make("Eagor/MapFreeNavigation-v0", panorama=None)))

Both are ordinary wrappers: ``gymnasium.make_vec(..., wrappers=[ForTraining])``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from eagor import perception as perceptions
from eagor.conventions import rotation_from_wxyz, wxyz_from_rotation
from eagor.errors import WorldError
from eagor.queries import COLOURS
from eagor.tasks.methods import answer_at, method_for
from eagor.tasks.models import Delay, EpisodePerception, is_privileged
from eagor.tasks.place_env import PlaceEnv, gymnasium, spaces
from eagor.tasks.places import UNTARGETED
from eagor.worlds.apartment import CATEGORIES

__all__ = ["LEVEL", "REACH", "WORDS", "ForTraining", "WithEstimate"]

REACH = 20.0  # metres that become 1 in observations
LEVEL = 0.04  # metres per level of the range picture, whose 255 levels reach 10.2 m
# Of queries, in the order of the observation; the tracking task asks for balls.
WORDS = (*(word for word in CATEGORIES if word not in UNTARGETED), "ball", *COLOURS)


_Wrapper = gymnasium.Wrapper[dict[str, np.ndarray], Any, dict[str, np.ndarray], Any]


class WithEstimate(_Wrapper, gymnasium.utils.RecordConstructorArgs):
    """Adds ``estimate`` ``(3,)`` float32: the direction of the target, body frame, as a method estimates it.

    `perception` and `method` as in ``eagor bench run``: a name, or the perception itself. ``truth`` reads instance ids,
    so its agent is told what only a simulator knows. The `Disturbances.latency` of the environment applies.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], perception: Any = "truth", method: str = "eagor") -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(
            self, perception=perception, method=method, _disable_deepcopy=True
        )
        super().__init__(env)
        self._place = place_env(env)
        self._called = perception if isinstance(perception, str) else ""
        self._perception = perceptions.load(perception) if isinstance(perception, str) else perception
        self._method_name = method
        if is_privileged(self._perception) and not self._place.instances:
            raise WorldError(
                f"the perception {self._called or self._perception!r} reads instance ids; leave instances on"
            )
        if not is_privileged(self._perception) and self._place.rows is None:
            raise WorldError(
                f"the perception {self._called or self._perception!r} sees panoramas; set panorama to its rows"
            )
        method_for(method, self._perception, self._called, np.random.default_rng(0))  # an unknown name fails here
        self.observation_space: spaces.Space[Any] = with_spaces(env, estimate=spaces.Box(-1.0, 1.0, (3,), np.float32))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        observation, info = self.env.reset(seed=seed, options=options)
        slot = self._place.episode.slot
        labels = info["instances"]["labels"] if self._place.instances else ()
        self._eye = EpisodePerception(self._perception, slot, labels)
        self._method = method_for(self._method_name, self._perception, self._called, slot.rng("method"))
        self._delay = Delay(self._place.disturbances.latency)
        return self._told(observation, info), info

    def step(self, action: Any) -> tuple[dict, float, bool, bool, dict]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._told(observation, info), float(reward), terminated, truncated, info

    def _told(self, observation: dict[str, np.ndarray], info: dict[str, Any]) -> dict[str, np.ndarray]:
        stamp = info["num_steps"] * self._place.camera.seconds
        due = self._delay.due(self._eye.look(observation, info, stamp))
        estimate = answer_at(self._method, stamp, observation["pose"], due)
        return observation | {"estimate": np.clip(estimate, -1.0, 1.0).astype(np.float32)}


class ForTraining(_Wrapper, gymnasium.utils.RecordConstructorArgs):
    """Observations as pictures and float32 vectors from -1 to 1, actions from -1 to 1, and what only ``info`` says.

    - ``pose`` ``(7,)``: position and quaternion (w, x, y, z, with w >= 0) in the frame of the episode's start; 1 is
      `REACH` metres, farther is clipped.
    - ``rotation`` ``(9,)``: the matrix, row by row.
    - ``range`` ``(H, 2H, 1)`` uint8: a picture with `LEVEL` metres per level, 255 for 10.2 m and more, 0 without a hit.
      ``panorama`` stays as it is.
    - ``query`` ``(len(WORDS),)``: 1 at the words asked for, 0 elsewhere; words of other worlds are in none.
    - ``waypoint`` ``(3,)``, where the agent walks a route by itself: cosine and sine of the heading to the end of the
      leg, and its distance (1 is `REACH`).
    - Actions: -1 and 1 are the bounds of the environment's own; heading, for example, is in units of pi. Whole numbers
      stay as they are.

    ``info["is_success"]``, where an episode can succeed, is what Stable-Baselines3 logs as the success rate.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        place = place_env(env)
        own = env.observation_space
        assert isinstance(own, spaces.Dict)
        self._walks_a_route = place.task == "waypoint" and getattr(place, "actions", "") != "guided"
        changed: dict[str, spaces.Space[Any]] = {
            "pose": _signed(7),
            "rotation": _signed(9),
            "query": spaces.Box(0.0, 1.0, (len(WORDS),), np.float32),
        }
        if self._walks_a_route:
            changed["waypoint"] = _signed(3)
        if "range" in own.spaces:
            changed["range"] = spaces.Box(0, 255, (*own["range"].shape, 1), np.uint8)  # type: ignore[misc]
        self.observation_space: spaces.Space[Any] = with_spaces(env, **changed)
        self._bounds: tuple[np.ndarray, np.ndarray] | None = None
        if isinstance(env.action_space, spaces.Box):
            self._bounds = env.action_space.low.astype(np.float64), env.action_space.high.astype(np.float64)
            self.action_space = spaces.Box(-1.0, 1.0, env.action_space.shape, np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        observation, info = self.env.reset(seed=seed, options=options)
        pose = observation["pose"]
        self._start = pose[:3].copy(), rotation_from_wxyz(pose[3:])
        return self._numbers(observation, info), info

    def step(self, action: Any) -> tuple[dict, float, bool, bool, dict]:
        observation, reward, terminated, truncated, info = self.env.step(self._own(action))
        if "success" in info:
            info["is_success"] = bool(info["success"])
        return self._numbers(observation, info), float(reward), terminated, truncated, info

    def _own(self, action: Any) -> Any:
        """The action within the environment's own bounds."""
        if self._bounds is None:
            return action
        low, high = self._bounds
        share = (np.asarray(action, dtype=np.float64) + 1.0) / 2.0
        return low + np.clip(share, 0.0, 1.0) * (high - low)

    def _numbers(self, observation: dict[str, np.ndarray], info: dict[str, Any]) -> dict[str, np.ndarray]:
        (origin, world_R_start), pose = self._start, observation["pose"]
        moved = world_R_start.T @ (pose[:3] - origin) / REACH
        quaternion = wxyz_from_rotation(world_R_start.T @ rotation_from_wxyz(pose[3:]))
        found = observation | {
            "pose": _clipped(np.concatenate([moved, quaternion])),
            "rotation": _clipped(observation["rotation"].reshape(9)),
            "query": _words(info["query"]),
        }
        if "range" in observation:
            found["range"] = np.minimum(np.rint(observation["range"] / LEVEL), 255).astype(np.uint8)[..., None]
        if self._walks_a_route:
            heading, metres = info["waypoint"]["heading"], info["waypoint"]["distance"]
            found["waypoint"] = _clipped(np.array([math.cos(heading), math.sin(heading), metres / REACH]))
        return found


def place_env(env: gymnasium.Env[Any, Any]) -> PlaceEnv:
    """The environment of this package inside of wrappers. Raises `WorldError` for another."""
    inner = env.unwrapped
    if not isinstance(inner, PlaceEnv):
        raise WorldError(f"{type(inner).__name__} is none of the environments of eagor.tasks; wanted one of them")
    return inner


def with_spaces(env: gymnasium.Env[Any, Any], **more: spaces.Space[Any]) -> spaces.Dict:
    """The observation space of `env` with more parts, or other ones."""
    assert isinstance(env.observation_space, spaces.Dict)
    return spaces.Dict({**env.observation_space.spaces, **more})


def _signed(size: int) -> spaces.Box:
    return spaces.Box(-1.0, 1.0, (size,), np.float32)


def _clipped(values: np.ndarray) -> np.ndarray:
    return np.clip(values, -1.0, 1.0).astype(np.float32)


def _words(query: Any) -> np.ndarray:
    """1 at each of `WORDS` that the query consists of."""
    said = str(query)
    colour = next((word for word in COLOURS if said.startswith(f"{word} ")), None)
    asked = {colour, said.removeprefix(f"{colour} ") if colour else said}
    return np.array([word in asked for word in WORDS], dtype=np.float32)
