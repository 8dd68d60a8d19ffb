"""Our policy as an agent of habitat-lab: its ObjectNav, with its stop action and its measures of success.

    env = habitat.Env(config)                       # sensors: equirectangular rgb and depth, gps, compass, objectgoal
    agent = HabitatAgent(eagor.perception.load("scout"), categories_of(env), CAMERA)
    observations = env.reset(); agent.reset()
    while not env.episode_over:
        observations = env.step(agent.act(observations))

habitat-lab is not imported: any object with `reset` and `act` is an agent to it (`habitat.core.agent.Agent`). What the
searching policy knows of the floor comes from the depth camera.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eagor.errors import AnswerError, EagorError
from eagor.grids import ErpGrid
from eagor.lab.agents.methods import BASE, answer_at, make_estimator
from eagor.lab.agents.search_space import SteeringInput
from eagor.lab.agents.steering import search_config, steering_for
from eagor.lab.envs.rules import Camera, NavigationRules
from eagor.lab.worlds.habitat import read_category
from eagor.perception import Perception, infer
from eagor.sphere import world_R_body

CAMERA = Camera(height=0.88)  # as in habitat-lab's ObjectNav on HM3D
NEAR = 0.75  # metres to the thing within which it stops: nobody is told where the view points are
FLOOR = 0.1  # metres: so near to the height of the feet is floor


def categories_of(env: Any) -> list[str]:
    """The words of an environment's goals, by the number that its objectgoal sensor gives."""
    numbers: Mapping[str, int] = env.task._dataset.category_to_task_category_id
    return [read_category(name) for name in sorted(numbers, key=lambda name: numbers[name])]


class HabitatAgent:
    """Searches for the goal, goes there, and stops where it believes that it has arrived.

    `categories`: words by number. Observations: "rgb" ``(H, 2 H, 3 or 4)`` uint8 and "depth" ``(H, 2 H)`` metres of an
    equirectangular sensor that looks ahead (as habitat-lab gives them: depth is measured along the axis of a cube's
    face; a normalised one is multiplied by `depth_range`), "gps" (metres ahead and to the right of the start),
    "compass" (radians to the left of it), "objectgoal".
    """

    def __init__(
        self,
        perception: Perception,
        categories: Sequence[str],
        camera: Camera = CAMERA,
        rules: NavigationRules | None = None,
        estimator: str = "eagor",
        depth_range: float = 1.0,
        seed: int = 0,
    ) -> None:
        self._perception, self._categories, self._camera = perception, categories, camera
        self._rules = rules or NavigationRules(success_distance=NEAR, stop="call", sliding=False)
        self._estimator, self._depth_range, self._rng = estimator, depth_range, np.random.default_rng(seed)
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        calibration, detector = (getattr(self._perception, part, None) for part in ("calibration", "detector"))
        ours = search_config(self._rules, BASE)
        self._method = make_estimator(self._estimator, self._rng, calibration=calibration, ours=ours, detector=detector)
        self._steering = steering_for(self._rules, self._camera)
        self._plan: float | None = None  # the heading to turn to before the next step
        self._count = 0

    def act(self, observations: Mapping[str, Any]) -> dict[str, str]:
        """The next action: stop, move_forward, turn_left or turn_right. Raises `EagorError` for a sensor that lacks."""
        if lacking := {"rgb", "depth", "gps", "compass", "objectgoal"} - observations.keys():
            raise EagorError(f"the observations have no {', '.join(sorted(lacking))}; add these sensors to the agent")
        ahead, right = (float(value) for value in np.ravel(observations["gps"])[:2])
        yaw = float(np.ravel(observations["compass"])[0])
        turn, position = world_R_body(yaw), np.array([ahead, -right, self._camera.height])
        stamp, self._count = self._count * self._camera.seconds, self._count + 1
        query = self._categories[int(np.ravel(observations["objectgoal"])[0])]
        picture = np.ascontiguousarray(np.asarray(observations["rgb"])[..., :3])
        try:
            evidence = infer(self._perception, picture, query, stamp=stamp, world_R_body=turn)
        except AnswerError:  # one among hundreds costs its step
            evidence = None
        direction = answer_at(self._method, stamp, turn, position, evidence)
        if self._plan is None:
            depth = self._depth_range * np.asarray(observations["depth"], dtype=float).reshape(picture.shape[:2])
            floor = self._floor(depth) if self._steering.needs_floor_mask else None
            looked = floor, evidence, self._camera.seconds
            azimuth = self._steering.walk(SteeringInput.of(self._method, direction, position, turn, *looked))
            if self._steering.arrived:
                return {"action": "stop"}
            self._plan = yaw + azimuth
        off = math.remainder(self._plan - yaw, 2 * math.pi)
        if abs(off) > math.radians(self._camera.turn) / 2:
            return {"action": "turn_left" if off > 0 else "turn_right"}
        self._plan = None
        return {"action": "move_forward"}

    def _floor(self, depth: np.ndarray) -> np.ndarray:
        """Which pixels ``(H, 2 H)`` show the floor; a depth of 0 is nothing."""
        rays = ErpGrid(*depth.shape).directions
        away = depth / np.abs(rays).max(axis=-1)
        return (depth > 0) & (np.abs(self._camera.height + away * rays[..., 2]) < FLOOR)
