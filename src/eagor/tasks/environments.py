"""The three tasks as Gymnasium environments.

`Eagor/WaypointFollowing-v0`, `Eagor/MapFreeNavigation-v0` and `Eagor/TargetTracking-v0`; ``import eagor.tasks``
registers them. `eagor.tasks.place_env` describes observations and info.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from eagor.tasks import listed_episode, navigation, tracking, waypoint
from eagor.tasks.actions import Actions, answering_walk_space, as_answer_and_walk, as_walk, walking_space
from eagor.tasks.episodes import Episode, Slot
from eagor.tasks.place_env import AnsweringEnv, PlaceEnv
from eagor.tasks.rules import NavigationRules, TrackingRules, WaypointRules
from eagor.worlds.ball import Ball

MOVED = 1e-4  # metres (and 1e-5 of the coordinates): less is no move in habitat-lab's distance to the goal


class MapFreeNavigationEnv(PlaceEnv):
    """Reach the target: `rules` set the distance, the number of steps, and whether stop has to be called.

    `actions`: "continuous" (heading, distance) turns the body to the heading and walks; "discrete" are Habitat's stop,
    forward, left, right. The reward is the geodesic progress of the step in metres, plus 1 on success.
    """

    task = "navigation"

    def __init__(self, rules: NavigationRules | None = None, actions: Actions = "continuous", **settings: Any) -> None:
        super().__init__(**settings)
        self.rules, self.actions = rules or NavigationRules(), actions
        self.action_space = walking_space(actions, self.camera)

    def plan(self, slot: Slot) -> Episode:
        return navigation.plan(slot, self.camera, self.rules)

    def _start(self) -> None:
        self._stopped = False
        self._measured: np.ndarray | None = None
        self._left = self._distance_to_goal()

    def _distance_to_goal(self) -> float:
        if self.rules.goal == "footprint":
            return float(self.place.way_to(self.episode.targets).distance(self.body.xy))
        # habitat-lab's DistanceToGoal measures anew only where the body has moved.
        if self._measured is None or not np.allclose(self._measured, self.body.xy, atol=MOVED):
            self._measured = self.body.xy
            return float(listed_episode.way_to_goal(self.place, self.episode).distance(self.body.xy))
        return self._left

    def _target(self) -> np.ndarray | None:
        if not isinstance(self.episode, listed_episode.ListedEpisode):
            return super()._target()
        return min(self.episode.goals, key=lambda centre: float(np.linalg.norm(centre - self.body.pose.position)))

    def _measures(self) -> dict[str, Any]:
        scores = navigation.score(self.rules, self.episode.shortest, self._left, self.body.walked, self._stopped)
        return {"distance_to_goal": self._left, **scores}

    def step(self, action: Any) -> tuple[dict, float, bool, bool, dict]:
        turn, length, stop = as_walk(action, self.actions, self.camera)
        before = self._left
        self._walk(turn, length, self.rules.sliding)
        self._left = self._distance_to_goal()
        reached = self._left < self.rules.success_distance
        self._stopped = (stop and self.rules.stop == "call") or (reached and self.rules.stop == "reach")
        terminated, truncated = self._stopped, self.body.steps >= self.rules.max_steps and not self._stopped
        info = self._info()
        gained = before - self._left if math.isfinite(before) and math.isfinite(self._left) else 0.0
        return self._observation(), gained + info["success"], terminated, truncated, info


class WaypointFollowingEnv(AnsweringEnv):
    """Follow a route of four legs and name the direction at each step.

    - ``actions="guided"``: the body is carried along the route, and the action is the answer ``(3,)``.
    - ``actions="continuous"`` or ``"discrete"``: the agent walks by itself, and the action is a walk and an answer in
      one: 5 numbers, or 3 whole numbers (`eagor.tasks.actions`). ``info["waypoint"]`` gives the end of the current
      leg: heading (radians), distance (metres) and leg. The episode ends at the last one, or after three times the
      steps of the route.
    """

    task = "waypoint"
    reach = 0.3  # metres from a waypoint at which it counts as reached

    def __init__(
        self,
        rules: WaypointRules | None = None,
        actions: Literal["guided", "continuous", "discrete"] = "guided",
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        self.rules, self.actions = rules or WaypointRules(), actions
        if actions != "guided":
            self.action_space = answering_walk_space(actions, self.camera)

    def plan(self, slot: Slot) -> Episode:
        return waypoint.plan(slot, self.camera, self.rules)

    def _start(self) -> None:
        super()._start()
        legs, route = self.episode.legs, self.episode.route
        last = [i for i, leg in enumerate(legs) if i + 1 == len(legs) or legs[i + 1] != leg]
        self._ends = [(legs[i], np.array(route[i][:2])) for i in last]
        self._leg = 0

    def _measures(self) -> dict[str, Any]:
        guided = self.actions == "guided"
        leg = self.episode.legs[min(self.body.steps, len(self.episode.legs) - 1)] if guided else None
        name, end = self._ends[min(self._leg, len(self._ends) - 1)]
        offset = end - self.body.xy
        heading = math.remainder(math.atan2(offset[1], offset[0]) - self.body.yaw, 2 * math.pi)
        ahead = {"heading": heading, "distance": float(np.hypot(*offset)), "leg": leg or name}
        return {**super()._measures(), "waypoint": ahead}

    def step(self, action: Any) -> tuple[dict, float, bool, bool, dict]:
        if self.actions == "guided":
            return super().step(action)
        answer, walk = as_answer_and_walk(action, self.actions)
        turn, length, _ = as_walk(walk, self.actions, self.camera)
        reward = self._judge(answer)
        self._walk(turn, length, slide=True)
        while self._leg < len(self._ends) and np.hypot(*(self._ends[self._leg][1] - self.body.xy)) < self.reach:
            self._leg += 1
        over = self._leg == len(self._ends)
        late = self.body.steps >= 3 * len(self.episode.route) and not over
        return self._observation(), reward, over, late, self._info()


class TargetTrackingEnv(AnsweringEnv):
    """Name the direction of a ball while it moves, while the camera moves, or after it was away."""

    task = "tracking"

    def __init__(self, rules: TrackingRules | None = None, **settings: Any) -> None:
        super().__init__(**settings)
        self.rules = rules or TrackingRules()

    def plan(self, slot: Slot) -> Episode:
        return tracking.plan(slot, self.camera, self.rules)

    def _ball(self) -> Ball | None:
        place = self.episode.balls[min(self.body.steps, len(self.episode.balls) - 1)]
        return Ball(np.array(place), self.episode.radius, self.episode.colour) if place is not None else None

    @property
    def labels(self) -> tuple[Any, ...]:
        return (*super().labels, tracking.BallLabel("ball", self.episode.colour))

    def _target(self) -> np.ndarray | None:
        ball = self._ball()
        return None if ball is None else ball.centre
