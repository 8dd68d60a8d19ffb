"""The common base of the environments: a camera in a place, what it sees, and how it walks.

Observations (Dict):

- ``panorama`` ``(H, 2H, 3)`` uint8, equirectangular, in the layout of `eagor.sphere`; absent with ``panorama=None``.
- ``range`` ``(H, 2H)`` float32, Euclidean metres, 0 without a hit; only with ``with_range=True``.
- ``pose`` ``(7,)`` float64: x, y, z of the camera in metres (within 10 km of the origin) and its orientation
  ``world_R_body`` as a quaternion w, x, y, z; from the odometry, which may drift (`Disturbances`).
- ``rotation`` ``(3, 3)`` float64: new_R_old since the last step, from the same odometry.

``info`` holds Habitat's measures under their names (`distance_to_goal`, `success`, `spl`, `soft_spl`, `collisions`,
`num_steps`), the ``query``, the ``episode_id`` (``episode`` is left to the statistics of Gymnasium and
Stable-Baselines3), and two privileged entries that agents must not use: ``instances`` (``ids``, the instance
in each direction, and at reset ``labels``) and ``truth`` (true pose, direction, distance, visibility).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from eagor import conventions
from eagor.errors import WorldError
from eagor.tasks.actions import answer_space, gymnasium, spaces
from eagor.tasks.carrier import Carrier, Pose
from eagor.tasks.episodes import PER_PLACE, Episode, Slot
from eagor.tasks.places import APARTMENT, DEVELOPMENT, LOOK_ROWS, Place, cut, load_place, pixels_of
from eagor.tasks.rules import Camera, Disturbances
from eagor.worlds.ball import Ball, with_ball
from eagor.worlds.render import Frame

FAR = 100.0  # metres: ranges in observations are clipped to this
EXTENT = 1e4  # metres, bound of positions in observations; rendering in single precision gets inexact beyond it
POSE_BOUNDS = np.array([EXTENT] * 3 + [1.0] * 4)
VISIBLE = 2  # pixels of a 64 x 128 panorama that make a target visible, if the rules do not say


class PlaceEnv(gymnasium.Env[dict[str, np.ndarray], Any]):
    """Base class of the environments: a camera in a place, and a target.

    Args of all: `world` ("apartment", or the path of a GLB file); `seeds`, the apartments to draw from; `panorama`,
    rows of the image (None: none); `with_range`; `instances`: whether to fill ``info["instances"]``; `camera`;
    `disturbances`; `render_mode` "rgb_array". ``reset(options={"episode": episode})`` plays a given episode.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012 (Gymnasium's own form)
    task = ""

    def __init__(
        self,
        world: str = APARTMENT,
        seeds: range = DEVELOPMENT,
        panorama: int | None = 128,
        with_range: bool = False,
        instances: bool = True,
        camera: Camera | None = None,
        disturbances: Disturbances | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise WorldError(f"render_mode = {render_mode!r}; wanted None or 'rgb_array'")
        if panorama is not None and panorama < 8:
            raise WorldError(f"panorama = {panorama} rows; wanted at least 8, or None for no image")
        self.world, self.seeds, self.rows, self.with_range = world, seeds, panorama, with_range
        self.instances, self.render_mode = instances, render_mode
        self.camera, self.disturbances = camera or Camera(), disturbances or Disturbances()
        space: dict[str, spaces.Space[Any]] = {
            "pose": spaces.Box(-POSE_BOUNDS, POSE_BOUNDS, dtype=np.float64),
            "rotation": spaces.Box(-1.0, 1.0, (3, 3), np.float64),
        }
        if panorama is not None:
            space["panorama"] = spaces.Box(0, 255, (panorama, 2 * panorama, 3), np.uint8)
        if with_range:
            rows = panorama or LOOK_ROWS
            space["range"] = spaces.Box(0.0, FAR, (rows, 2 * rows), np.float32)
        self.observation_space: spaces.Space[Any] = spaces.Dict(space)
        self.episode: Any = None

    # Implemented by each task.
    rules: Any = None

    def plan(self, slot: Slot) -> Episode:
        """The episode of this slot: the same one each time. Raises `WorldError` if the world has none."""
        raise NotImplementedError

    def _measures(self) -> dict[str, Any]:
        raise NotImplementedError

    def _ball(self) -> Ball | None:
        """The ball in the place at this step, if any."""
        return None

    def _target(self) -> np.ndarray | None:
        """The point ``(3,)`` in the world frame that the true direction leads to; None while the target is away."""
        centres = [self.place.scene.instances[i].centre for i in self.episode.targets]
        return min(centres, key=lambda centre: float(np.linalg.norm(centre - self.body.pose.position)))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        super().reset(seed=seed)
        chosen = (options or {}).get("episode")
        if chosen is None:
            slot = Slot(
                self.task,
                self.world,
                int(self.np_random.choice(self.seeds)),
                int(self.np_random.integers(PER_PLACE)),
                int(self.np_random.integers(6)),
            )
            chosen = self.plan(slot)
        self.episode = chosen
        self.place: Place = load_place(chosen.slot.world, chosen.slot.seed, self.camera.radius)
        if chosen.scene_hash != self.place.scene.hash:
            raise WorldError(
                f"episode {chosen.slot.id} was made for scene {chosen.scene_hash}, but this version of the world makes "
                f"{self.place.scene.hash} of {chosen.scene}; plan the episode again"
            )
        rng = chosen.slot.rng("odometry")
        start = np.array(chosen.start)
        floor = self.place.ground.height(start)
        self.body = Carrier(self.camera, self.disturbances, rng, start, chosen.yaw, floor)
        if np.abs(self.body.pose.position).max() > EXTENT:
            raise WorldError(
                f"episode {chosen.slot.id} starts at {self.body.pose.position} m; wanted a scene within "
                f"{EXTENT / 1000:g} km of the origin of its coordinates: move it there"
            )
        self._start()
        self._before: Pose | None = None
        self._collisions, self._collided = 0, False
        self._frame()
        info = self._info()
        if self.instances:
            info["instances"]["labels"] = self.labels
        return self._observation(), info

    def _start(self) -> None:
        """Task-specific start of an episode."""

    @property
    def labels(self) -> tuple[Any, ...]:
        """The things of the place, in the order of their ids; a ball comes last."""
        return self.place.scene.instances

    def _frame(self) -> None:
        """Render from the current camera pose."""
        near = self._seen(LOOK_ROWS, rgb=False, ids=True)
        assert near.ids is not None
        self.ids: np.ndarray = near.ids
        self._picture: Any = None  # a Frame, rendered on demand
        if self.rows is not None or self.with_range:
            self._picture = self._seen(self.rows or LOOK_ROWS, rgb=self.rows is not None, range=True)

    def _seen(self, rows: int, rgb: bool = True, range: bool = False, ids: bool = False) -> Frame:
        """The place from the current camera pose, with the ball, if any, as far as the camera shows it."""
        pose, ball = self.body.pose, self._ball()
        range = range or ball is not None  # needed to draw the ball
        frame = self.place.renderer.panorama(pose.position, pose.world_R_body, rows, rgb=rgb, range=range, ids=ids)
        if ball is not None:
            frame = with_ball(frame, pose.position, pose.world_R_body, ball, len(self.place.scene.instances))
        return cut(frame, self.camera)

    def _observation(self) -> dict[str, np.ndarray]:
        odometry = self.body.odometry
        before = self._before or odometry
        found = {
            "pose": np.concatenate([odometry.position, conventions.wxyz_from_rotation(odometry.world_R_body)]),
            "rotation": np.clip(odometry.world_R_body.T @ before.world_R_body, -1.0, 1.0),
        }
        if self._picture is not None and self.rows is not None:
            found["panorama"] = self._picture.rgb
        if self._picture is not None and self.with_range:
            metres = np.where(np.isfinite(self._picture.range), self._picture.range, 0.0)
            found["range"] = np.minimum(metres, FAR).astype(np.float32)
        return found

    def _info(self) -> dict[str, Any]:
        pose, target = self.body.pose, self._target()
        direction, distance = pose.towards(target) if target is not None else (np.zeros(3), 0.0)
        info: dict[str, Any] = {
            "query": self.episode.query,
            "episode_id": self.episode.slot.id,
            "scene": self.place.scene.source,
            "scene_hash": self.place.scene.hash,
            "num_steps": self.body.steps,
            "collisions": {"count": self._collisions, "is_collision": self._collided},
            "truth": {
                "position": pose.position,
                "world_R_body": pose.world_R_body,
                "direction": direction,
                "distance": distance,
                "present": target is not None,
                "visible": self._visible(),
            },
            **self._measures(),
        }
        if self.instances:
            info["instances"] = {"ids": self.ids}
        return info

    def _visible(self) -> bool:
        return pixels_of(self.ids, self.episode.targets) >= getattr(self.rules, "visible_pixels", VISIBLE)

    def _moved(self, xy: np.ndarray, yaw: float, collided: bool = False) -> None:
        """Move the body to a new place and look again."""
        self._before = self.body.odometry
        self.body.move(xy, yaw, self.place.ground.height(xy))
        self._collided = collided
        self._collisions += collided
        self._frame()

    def _walk(self, turn: float, length: float, slide: bool) -> None:
        """Turn by `turn` (radians, left) and go `length` metres ahead, sliding along walls or stopping at them."""
        yaw = math.remainder(self.body.yaw + turn, 2 * math.pi)
        xy, collided = self.body.xy, False
        if length > 0:
            ahead = length * np.array([math.cos(yaw), math.sin(yaw)])
            xy, collided = self.place.ground.move(self.body.xy, ahead, slide=slide)
        self._moved(xy, yaw, collided)

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """The panorama at this step, at least 128 rows, uint8."""
        if self.render_mode != "rgb_array":
            return None
        return self._seen(max(self.rows or 0, 128), range=True).rgb


class AnsweringEnv(PlaceEnv):
    """The camera is carried along, and the action is the answer: a direction ``(3,)`` in the body frame.

    The path is the episode's `route`, rows of x, y, yaw (metres, radians); the first is the start. The answer given to
    `step` is about the observation before it. The reward is minus its error, in radians.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.action_space: spaces.Space[Any] = answer_space()

    def _start(self) -> None:
        self._error_deg: float | None = None

    def _measures(self) -> dict[str, Any]:
        return {"error_deg": math.nan if self._error_deg is None else self._error_deg}

    def _judge(self, answer: Any) -> float:
        """The reward of an answer about the previous step; 0 while the target is away."""
        target = self._target()
        direction = np.asarray(answer, dtype=np.float64).reshape(3)
        length = float(np.linalg.norm(direction))
        if not math.isfinite(length):
            raise WorldError(f"action {answer!r}; wanted a finite direction (x, y, z) in the body frame")
        if target is None:
            self._error_deg = None
            return 0.0
        true = self.body.pose.towards(target)[0]
        cosine = float(direction @ true) / length if length > 0 else -1.0
        error = math.acos(min(1.0, max(-1.0, cosine)))
        self._error_deg = math.degrees(error)
        return -error

    def step(self, action: Any) -> tuple[dict, float, bool, bool, dict]:
        reward, route = self._judge(action), self.episode.route
        x, y, yaw = route[min(self.body.steps + 1, len(route) - 1)]
        self._moved(np.array([x, y]), yaw)
        return self._observation(), reward, self.body.steps >= len(route) - 1, False, self._info()
