"""Map-Free Navigation: start facing away from the target, and walk by fixed steps until it is reached.

Episodes come in strata. In two thirds of them the target is visible at the start. In half of them the path is longer
than the straight line by more than a fifth, so that walking straight leads into walls.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from eagor import metrics
from eagor.errors import WorldError
from eagor.lab.envs.episodes import Episode, EpisodeSpec, choose_target
from eagor.lab.envs.place_env import PlaceEnv, gymnasium
from eagor.lab.envs.places import load_place, pixels_of
from eagor.lab.envs.rules import FACING_AWAY, RATIO, VISIBLE, WINDING, NavigationRules
from eagor.lab.tasks.sim.rollout import Rollout
from eagor.lab.tasks.sim.task import COVERAGE, SimTask, success_where
from eagor.lab.tasks.task import Metric, degrees
from eagor.sphere import azimuth_elevation, world_R_body

# (visible at the start, winding path), cyclic: two thirds visible, half winding.
STRATA = ((True, False), (False, True), (True, True), (True, False), (False, True), (True, False))
AT_SEAM = math.radians(5)  # of an equirectangular picture, behind the body
TRIES = 40  # starts tried per target and stratum


def distance_to_box(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Straight distance (metres) ``(n,)`` of points ``(n, 2)`` on the floor from a footprint."""
    return np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=-1)


def measure(result: Rollout) -> dict[str, Any]:
    """The errors of the estimate in one episode, and Habitat's measures of the path."""
    info = result.info
    return {
        "mae": metrics.mean_error(result.trace["error_deg"]),
        "seam_crossings": int(metrics.seam_crossings(result.directions).sum()),
        "starts_at_seam": float(abs(azimuth_elevation(result.directions[0])[0]) > math.pi - AT_SEAM),
        "coverage": result.coverage,
        **{key: info[key] for key in ("success", "spl", "soft_spl")},
        "distance_to_goal": info["distance_to_goal"] if math.isfinite(info["distance_to_goal"]) else None,
        "steps": info["num_steps"],
        "path_m": info["path_length"],
        "shortest_m": result.episode.shortest,
        "collisions": info["collisions"]["count"],
        "undone": backtracking_rate(np.array(result.trace["pose"])[:, :2], result.camera.step),
    }


def backtracking_rate(places: np.ndarray, step: float) -> float:
    """The share of steps that lead back: they end less than half a step from where the body was before.

    `places` ``(n, 2)``: before each step and after the last.
    """
    if len(places) < 2:
        return 0.0
    apart = np.linalg.norm(places[1:, None] - places[None, :-1], axis=-1)
    earlier = np.tri(len(places) - 1, k=-1, dtype=bool)
    return float(np.mean(np.any((apart < step / 2) & earlier, axis=1)))


class MapFreeNavigationEnv(PlaceEnv):
    """Reach the target: `rules` set the distance, the number of steps, and whether stop has to be called.

    An action (heading, distance), radians to the left and metres up to one step, turns the body to the heading and
    walks; a distance of 0 calls stop. The reward is the geodesic progress of the step in metres, plus 1 on success.
    ``info`` also holds Habitat's `distance_to_goal`, `success`, `spl`, `soft_spl`, `collisions`, and `path_length`.
    """

    task = "navigation"
    rules = NavigationRules()

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        low, high = np.array([-math.pi, 0.0], np.float32), np.array([math.pi, self.camera.step], np.float32)
        self.action_space = gymnasium.spaces.Box(low, high, dtype=np.float32)

    def plan(self, spec: EpisodeSpec) -> Episode:
        place, rng = load_place(spec.world, spec.seed, self.camera.radius), spec.rng("plan")
        first, way = STRATA[spec.number % len(STRATA)]
        # The wanted stratum first, then whatever the apartment offers: few have every kind of start.
        for visible, winding in ((first, way), (first, not way), (not first, way), (not first, not way)):
            for target, query in choose_target(place, rng):
                thing, points = place.scene.instances[target], place.ground.points
                geodesic = place.ground.at_points(place.way_to((target,)))
                ratio = geodesic / np.maximum(distance_to_box(points, thing.low[:2], thing.high[:2]), 1e-6)
                fits = (geodesic >= self.rules.nearest) & (geodesic <= self.rules.farthest) & (ratio <= RATIO)
                for start in rng.permutation(np.flatnonzero(fits & ((ratio > WINDING) == winding)))[:TRIES]:
                    xy = points[start]
                    ids = place.ids(place.eye(xy, self.camera.height), world_R_body(0.0))
                    if (pixels_of(ids, (target,)) >= VISIBLE) != visible:
                        continue
                    # The bearing to the target, turned so that it lies behind, within the tolerance.
                    away = math.pi + math.radians(FACING_AWAY) * float(rng.uniform(-1, 1))
                    x, y = thing.centre[:2] - xy
                    kind = {"visible": visible, "way": "winding" if winding else "direct"}
                    return Episode(
                        spec=spec, scene=place.scene.source, scene_hash=place.scene.hash, query=query,
                        targets=(target,), start=(float(xy[0]), float(xy[1])), shortest=float(geodesic[start]),
                        yaw=math.remainder(float(np.arctan2(y, x)) + away, 2 * math.pi),
                        stratum=kind | {"ratio": round(float(ratio[start]), 3), "category": thing.category},
                    )  # fmt: skip
        raise WorldError(
            f"{place.scene.source} has no target that is {self.rules.nearest} to {self.rules.farthest} m away; "
            "widen the rules, or leave this world out"
        )

    @property
    def left(self) -> float:
        """Geodesic metres to the goal."""
        return float(self.place.way_to(self.episode.targets).distance(self.body.xy))

    def _act(self, action: np.ndarray) -> tuple[float, bool, bool]:
        before, length = self.left, min(max(float(action[1]), 0.0), self.camera.step)
        self._collided = self.body.walk(float(action[0]), length, self.rules.sliding)
        self._collisions += self._collided
        gained = before - self.left
        won = self.left < self.rules.success_distance
        self._stopped = length == 0 if self.rules.stop == "call" else won
        reward = (gained if math.isfinite(gained) else 0.0) + float(won and self._stopped)
        return reward, self._stopped, self.body.steps >= self.rules.max_steps and not self._stopped

    def _info(self, ids: np.ndarray) -> dict[str, Any]:
        left, shortest, walked = self.left, self.episode.shortest, self.body.walked
        won = metrics.success(left, self._stopped, self.rules.success_distance)
        return super()._info(ids) | {
            "collisions": {"count": self._collisions, "is_collision": self._collided},
            "distance_to_goal": left,
            "path_length": walked,
            "success": float(won),
            "spl": metrics.spl(won, shortest, walked),
            "soft_spl": metrics.soft_spl(left, shortest, walked),
        }


NAVIGATION = SimTask(
    name="navigation",
    title="Map-Free Navigation",
    what="start facing away from the thing, and search and walk until it is reached",
    environment=MapFreeNavigationEnv,
    rules=NavigationRules,
    measure=measure,
    metrics=(
        Metric("sr", "SR", "episodes that end at the target", lambda result: result["metrics"]["success"], share=True),
        Metric("spl", "SPL", "success weighted by path length"),
        Metric("soft_spl", "SoftSPL", "progress weighted by path length"),
        Metric("steps", "Steps", "mean number of steps", unit="", better="low", scale=1.0),
        Metric("undone", "Undone", "steps that lead back to where the body was", better="low"),
        degrees("mae", "MAE", "mean direction error"),
        Metric(
            "seam_success", "Seam", "success where the true bearing crossed the seam", success_where("seam_crossings"),
            share=True,
        ),
        Metric(
            "seam_start", "Seam start",
            "success of the episodes that begin with the thing within 5 degrees of the seam, the same for all methods",
            success_where("starts_at_seam"), share=True,
        ),
        COVERAGE,
    ),
    headline="sr",
    ranked_by=("sr", "spl", "mae"),
    strata={"visible": "Target in sight at the start", "way": "Way to the target"},
    walked=True,
)  # fmt: skip
