"""The common base of the environments: a camera in a place, what it sees, how it walks, and how it answers.

Observations (Dict):

- ``panorama`` ``(H, 2H, 3)`` uint8, equirectangular, in the layout of `eagor.sphere`; absent with ``panorama=None``.
- ``range`` ``(H, 2H)`` float32, Euclidean metres, 0 without a hit; only with ``with_range=True``.
- ``pose`` ``(7,)`` float64: x, y, z of the camera in metres (within 10 km of the origin) and its orientation
  ``world_R_body`` as a quaternion w, x, y, z; from the odometry, which may drift (`NoiseModel`).
- ``rotation`` ``(3, 3)`` float64: new_R_old since the last step, from the same odometry.

``info`` holds `num_steps`, the ``query``, the ``episode_id`` (``episode`` is left to wrappers' statistics), and two
privileged entries that agents must not use: ``instances`` (``ids``, the instance in each direction, and at reset
``labels``) and ``truth`` (true pose, direction, distance, visibility).

An action is a Box: where the agent walks, heading (radians, left) and metres; where it answers, x, y, z (body frame).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from eagor import conventions
from eagor._extras import how_to_install
from eagor.errors import MissingExtraError, WorldError
from eagor.lab.envs.episodes import PER_PLACE, Episode, EpisodeSpec
from eagor.lab.envs.places import APARTMENT, DEVELOPMENT, LOOK_ROWS, Place, load_place, pixels_of
from eagor.lab.envs.rules import VISIBLE, Camera, NoiseModel
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.render import Ball, Frame, with_ball
from eagor.queries import Query
from eagor.sphere import world_R_body

try:
    import gymnasium as gymnasium  # for the modules that build on these spaces
    from gymnasium import spaces
except ImportError as error:
    raise MissingExtraError(f"a simulated task needs gymnasium: {how_to_install('sim')}") from error


BOBS_PER_SECOND = 2.0
FAR = 100.0  # metres: ranges in observations are clipped to this
EXTENT = 1e4  # metres, bound of positions in observations; rendering in single precision gets inexact beyond it
POSE_BOUNDS = np.array([EXTENT] * 3 + [1.0] * 4)


@dataclass(frozen=True, eq=False)
class Pose:
    """Camera pose: `position` ``(3,)`` metres, `world_R_body` ``(3, 3)``."""

    position: np.ndarray
    world_R_body: np.ndarray

    def towards(self, point: np.ndarray) -> tuple[np.ndarray, float]:
        """Direction ``(3,)`` in the body frame and distance (metres) of a point in the world frame."""
        offset = self.world_R_body.T @ (np.asarray(point) - self.position)
        distance = float(np.linalg.norm(offset))
        return (offset / distance if distance > 0 else np.array([1.0, 0.0, 0.0])), distance


@dataclass(eq=False)
class MobileBase:
    """A round body with a camera on the `ground`, at `xy` ``(2,)``, `yaw` in radians, with bobbing and swaying.

    `rng` draws the odometry's drift, which measures its height above the floor, too. `walked`: metres so far.
    """

    ground: Ground
    xy: np.ndarray
    yaw: float
    camera: Camera = field(default_factory=Camera)
    noise: NoiseModel = field(default_factory=NoiseModel)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    steps: int = 0
    walked: float = 0.0

    def __post_init__(self) -> None:
        self.xy = self._odometry_xy = np.array(self.xy, dtype=np.float64)
        self.floor, self._odometry_yaw = float(self.ground.height(self.xy)), self.yaw
        self._scale = 1.0 + self.noise.scale_drift * float(self.rng.standard_normal())
        self._phase = float(self.rng.uniform(0, 2 * math.pi))

    def walk(self, turn: float, metres: float, slide: bool = True) -> bool:
        """One step: turn, radians to the left, and go ahead (back, if negative); whether something was in the way."""
        yaw = math.remainder(self.yaw + turn, 2 * math.pi)
        xy, collided = self.xy, False
        if metres:
            ahead = metres * np.array([math.cos(yaw), math.sin(yaw)])
            xy, collided = self.ground.move(self.xy, ahead, slide=slide)
        self.carry(xy, yaw)
        return collided

    def carry(self, xy: np.ndarray, yaw: float) -> None:
        """One step, to the given place and heading."""
        step, floor = xy - self.xy, float(self.ground.height(xy))
        length = float(np.hypot(*step))
        slip = math.radians(self.noise.yaw_drift) * math.sqrt(length) * float(self.rng.standard_normal())
        # The odometry measures the step in the body frame, with errors in scale and heading.
        off = self._odometry_yaw - self.yaw
        c, s = math.cos(off), math.sin(off)
        moved = np.array([c * step[0] - s * step[1], s * step[0] + c * step[1]])
        self._odometry_xy = self._odometry_xy + self._scale * moved
        self._odometry_yaw += math.remainder(yaw - self.yaw, 2 * math.pi) + slip
        self.walked += math.hypot(length, floor - self.floor)
        self.xy, self.yaw, self.floor = np.asarray(xy, dtype=np.float64), yaw, floor
        self.steps += 1

    @property
    def pose(self) -> Pose:
        """The true camera pose."""
        return self._pose(self.xy, self.yaw)

    @property
    def odometry(self) -> Pose:
        """The camera pose according to the odometry."""
        return self._pose(self._odometry_xy, self._odometry_yaw)

    def _pose(self, xy: np.ndarray, yaw: float) -> Pose:
        # 0.93: not in step with panoramas.
        phase = self._phase + 2 * math.pi * BOBS_PER_SECOND * (self.steps * self.camera.seconds) * 0.93
        height = self.floor + self.camera.height + self.noise.bob * math.sin(phase)
        sway = math.radians(self.noise.sway)
        turned = world_R_body(yaw, sway * math.sin(phase / 2 + 1.0), sway * math.sin(phase / 2))
        return Pose(np.array([*xy, height]), turned)


class PlaceEnv(gymnasium.Env[dict[str, np.ndarray], Any]):
    """Base class of the environments: a camera in a place, and a target.

    Args of all: `rules` of the task; `world` ("apartment", or the path of a GLB file); `seeds`, the apartments to draw
    from; `panorama`, rows of the image (None: none); `with_range`; `camera`; `disturbances`; `render_mode` "rgb_array".
    ``reset(options={"episode": episode})`` plays a given episode.

    A task says its name, its default `rules`, its `action_space`, and implements `plan` and `_act`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012 (Gymnasium's own form)
    task = ""
    rules: Any = None

    def __init__(
        self,
        rules: Any = None,
        world: str = APARTMENT,
        seeds: range = DEVELOPMENT,
        panorama: int | None = 128,
        with_range: bool = False,
        camera: Camera | None = None,
        disturbances: NoiseModel | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise WorldError(f"render_mode = {render_mode!r}; wanted None or 'rgb_array'")
        if panorama is not None and panorama < 8:
            raise WorldError(f"panorama = {panorama} rows; wanted at least 8, or None for no image")
        self.rules = rules or self.rules
        self.world, self.seeds, self.rows, self.with_range = world, seeds, panorama, with_range
        self.render_mode = render_mode
        self.camera, self.disturbances = camera or Camera(), disturbances or NoiseModel()
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

    def plan(self, spec: EpisodeSpec) -> Episode:
        """The episode of this spec: the same one each time. Raises `WorldError` if the world has none."""
        raise NotImplementedError

    def _act(self, action: np.ndarray) -> tuple[float, bool, bool]:
        """One step by a finite action: its reward, and whether the episode is terminated or truncated."""
        raise NotImplementedError

    def _ball(self) -> Ball | None:
        """The ball in the place at this step, if any."""
        balls = self.episode.balls or (None,)
        centre = balls[min(self.body.steps, len(balls) - 1)]
        return None if centre is None else Ball(np.array(centre), self.episode.radius, self.episode.colour)

    def target(self) -> np.ndarray | None:
        """The point ``(3,)`` in the world frame that the true direction leads to; None while the target is away."""
        if self.episode.balls is not None:
            return ball.centre if (ball := self._ball()) else None
        centres = (self.place.scene.instances[index].centre for index in self.episode.targets)
        return min(centres, key=lambda point: float(np.linalg.norm(point - self.body.pose.position)))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        super().reset(seed=seed)
        chosen = (options or {}).get("episode")
        if chosen is None:
            rng = self.np_random
            draws = int(rng.choice(self.seeds)), int(rng.integers(PER_PLACE)), int(rng.integers(6))
            chosen = self.plan(EpisodeSpec(self.task, self.world, *draws))
        self.episode, spec = chosen, chosen.spec
        self.place: Place = load_place(spec.world, spec.seed, self.camera.radius)
        if chosen.scene_hash != self.place.scene.hash:
            raise WorldError(
                f"episode {spec.id} was made for scene {chosen.scene_hash}, but this version of the world makes "
                f"{self.place.scene.hash} of {chosen.scene}; plan the episode again"
            )
        rng = spec.rng("odometry")
        self.body = MobileBase(
            self.place.ground, np.array(chosen.start), chosen.yaw, self.camera, self.disturbances, rng
        )
        if np.abs(start := self.body.pose.position).max() > EXTENT:
            wanted = f"a scene within {EXTENT / 1000:g} km of the origin of its coordinates: move it there"
            raise WorldError(f"episode {spec.id} starts at {start} m; wanted {wanted}")
        self._collisions, self._collided, self._stopped, self._before = 0, False, False, self.body.odometry
        observation, info = self._shown()
        ball = [] if chosen.balls is None else [Query("ball", chosen.colour)]
        info["instances"]["labels"] = (*self.place.scene.instances, *ball)  # in the order of their ids
        return observation, info

    def step(self, action: Any) -> tuple[dict, float, bool, bool, dict]:
        values = np.asarray(action, dtype=np.float64).reshape(self.action_space.shape)
        if not np.isfinite(values).all():
            raise WorldError(f"action {action!r}; wanted {len(values)} finite numbers, as {self.task} takes them")
        self._before = self.body.odometry
        reward, terminated, truncated = self._act(values)
        observation, info = self._shown()
        return observation, reward, terminated, truncated, info

    def view(self) -> Callable[..., Frame]:
        """Renders a panorama of so many rows, as the camera shows it at this step, also after later steps."""
        place, pose, ball = self.place, self.body.pose, self._ball()

        def look(rows: int, rgb: bool = True, range: bool = False, ids: bool = False) -> Frame:
            range = range or ball is not None  # needed to draw the ball
            frame = place.renderer.panorama(pose.position, pose.world_R_body, rows, rgb=rgb, range=range, ids=ids)
            if ball is not None:
                frame = with_ball(frame, pose.position, pose.world_R_body, ball, len(place.scene.instances))
            return frame

        return look

    def _shown(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """The observation of this step, and its info."""
        look, odometry = self.view(), self.body.odometry
        found: dict[str, Any] = {
            "pose": np.concatenate([odometry.position, conventions.wxyz_from_rotation(odometry.world_R_body)]),
            "rotation": np.clip(odometry.world_R_body.T @ self._before.world_R_body, -1.0, 1.0),
        }
        if self.rows is not None or self.with_range:
            frame: Any = look(self.rows or LOOK_ROWS, rgb=self.rows is not None, range=True)
            metres = np.minimum(np.where(np.isfinite(frame.range), frame.range, 0.0), FAR).astype(np.float32)
            found |= {"panorama": frame.rgb} if self.rows is not None else {}
            found |= {"range": metres} if self.with_range else {}
        return found, self._info(np.asarray(look(LOOK_ROWS, rgb=False, ids=True).ids))

    def _info(self, ids: np.ndarray) -> dict[str, Any]:
        pose, target, legs = self.body.pose, self.target(), self.episode.legs
        direction, distance = pose.towards(target) if target is not None else (np.zeros(3), 0.0)
        visible = pixels_of(ids, self.episode.targets) >= getattr(self.rules, "visible_pixels", VISIBLE)
        return {
            "query": self.episode.query,
            "episode_id": self.episode.spec.id,
            "num_steps": self.body.steps,
            "truth": {
                "position": pose.position,
                "world_R_body": pose.world_R_body,
                "direction": direction,
                "distance": distance,
                "present": target is not None,
                "visible": visible,
            }
            | ({} if legs is None else {"leg": legs[min(self.body.steps, len(legs) - 1)]}),
            "instances": {"ids": ids},
        }

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """The panorama at this step, at least 128 rows, uint8."""
        return self.view()(max(self.rows or 0, 128)).rgb if self.render_mode == "rgb_array" else None


class AnsweringEnv(PlaceEnv):
    """The camera is carried along, and the action is the answer: a direction ``(3,)`` in the body frame.

    The path is the episode's `route`. The answer given to `step` is about the observation before it. The reward is
    minus its error, in radians.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.action_space: spaces.Space[Any] = spaces.Box(-1.0, 1.0, (3,), np.float32)

    def _act(self, action: np.ndarray) -> tuple[float, bool, bool]:
        target, route, reward = self.target(), self.episode.route, 0.0
        if target is not None:
            length = float(np.linalg.norm(action))
            cosine = float(action @ self.body.pose.towards(target)[0]) / length if length > 0 else -1.0
            reward = -math.acos(min(1.0, max(-1.0, cosine)))
        *xy, yaw = route[min(self.body.steps + 1, len(route) - 1)]
        self.body.carry(np.array(xy), yaw)
        return reward, self.body.steps >= len(route) - 1, False
