"""Waypoint Following: along a given route of four legs, each beginning with a sharper turn, name the direction.

All methods get the same route and the same responses. Routes are chosen so that the target is hidden for a part of the
route and crosses the seam of the panorama.
"""

from __future__ import annotations

import math
from itertools import islice

import numpy as np

from eagor import metrics
from eagor.errors import WorldError
from eagor.lab.envs.episodes import Episode, EpisodeSpec, choose_target
from eagor.lab.envs.place_env import AnsweringEnv
from eagor.lab.envs.places import Place, load_place
from eagor.lab.envs.rules import LEGS, OCCLUDED, TURNS, VISIBLE, WaypointRules
from eagor.lab.tasks.sim.rollout import Rollout
from eagor.lab.tasks.sim.task import CALM, COVERAGE, JUMP, SimTask
from eagor.lab.tasks.task import degrees
from eagor.lab.worlds.navmesh import follow_path, initial_heading
from eagor.sphere import direction, world_R_body

ORDINALS = ("first", "second", "third", "fourth")
ATTEMPTS = 200  # to find routes at all: small rooms have few legs of four metres
SLACK = 30.0  # degrees by which turns may finally miss their ranges if nothing fits
ROUTES = 8  # routes tried until one hides a target and crosses the seam
GOALS = 6  # ends of a leg tried
LONGER = 3.0  # metres by which a leg may exceed its least length
AHEAD = 0.5  # metres over which the heading of a path is taken, as in `initial_heading`
NEAREST = 0.8  # metres: least distance of the camera from the target's middle


def _leg_path(
    place: Place, xy: np.ndarray, yaw: float | None, turn: tuple[float, float], shortest: float,
    rng: np.random.Generator,
) -> np.ndarray | None:  # fmt: skip
    """A path ``(n, 2)`` from here that begins with a turn in the range (any, if `yaw` is None); None if none does."""
    ground = place.ground
    field = ground.field(xy)
    away = ground.at_points(field)
    fits = (away >= shortest) & (away <= shortest + LONGER)
    if yaw is not None:
        # Paths that begin with such a turn lead through these points, half a metre from here.
        around = np.flatnonzero(np.abs(away - AHEAD) < ground.cell)
        ring = ground.points[around]
        headings = np.arctan2(ring[:, 1] - xy[1], ring[:, 0] - xy[0])
        turns = np.abs((headings - yaw + math.pi) % (2 * math.pi) - math.pi)
        gates = (turns >= turn[0]) & (turns <= turn[1])
        if not gates.any():
            return None
        through = ground.at_points(ground.field(ring[gates], away[around[gates]]))
        fits &= through <= away + ground.cell / 2
    for goal in rng.permutation(ground.points[fits])[:GOALS]:
        path = np.concatenate([xy[None], ground.path(goal, field)[-2::-1]])
        if yaw is None or turn[0] <= abs(math.remainder(initial_heading(path) - yaw, 2 * math.pi)) <= turn[1]:
            return path
    return None


def measure(result: Rollout) -> dict[str, float | None]:
    """The paper's columns for one episode: L1..L4, delta, occ, seam, tc (degrees); None where one does not apply."""
    errors, truth, estimates = np.array(result.trace["error_deg"]), result.truth, result.estimates
    legs = {leg: metrics.mean_error(errors, np.array(truth["leg"]) == leg) for leg in LEGS}
    first, last = legs[LEGS[0]], legs[LEGS[-1]]
    return {
        **legs,
        "delta": None if first is None or last is None else last - first,
        "occ": metrics.mean_error(errors, ~np.array(truth["visible"])),
        "seam": metrics.mean_error(errors, truth["seam"]),
        "tc": metrics.temporal_consistency(estimates, *result.motions, np.array(truth["range_m"])),
        "tc_rotation": metrics.temporal_consistency(estimates, result.motions[0]),
        "mae": metrics.mean_error(errors),
        "coverage": result.coverage,
    }


class WaypointFollowingEnv(AnsweringEnv):
    """The body is carried along a route of four legs; name the direction at each step.

    ``info["truth"]["leg"]``: the leg.
    """

    task = "waypoint"
    rules = WaypointRules()

    def plan(self, spec: EpisodeSpec) -> Episode:
        place, rng = load_place(spec.world, spec.seed, self.camera.radius), spec.rng("plan")
        targets = list(choose_target(place, rng))
        if not targets:
            raise WorldError(f"{place.scene.source} has no thing with a unique name")
        attempts = (self._route(place, SLACK * attempt / ATTEMPTS, rng) for attempt in range(ATTEMPTS))
        routes = islice((route for route in attempts if route is not None), ROUTES)
        fault, best = math.inf, None
        for (route, legs, seen), (target, query) in ((route, each) for route in routes for each in targets):
            found, hidden = self._fault(place.scene.instances[target].centre[:2], route, seen[:, target])
            if found < fault:
                fault, best = found, (hidden, target, query, route, legs)
            if fault == 0:
                break
        if best is None:
            legs = f"four legs of {self.rules.leg_steps} steps"
            raise WorldError(f"{place.scene.source} has no route of {legs}; shorten the legs")
        hidden, target, query, route, legs = best
        x, y, yaw = route[0].tolist()
        category = place.scene.instances[target].category
        return Episode(
            spec=spec, scene=place.scene.source, scene_hash=place.scene.hash, query=query, targets=(target,),
            start=(x, y), yaw=yaw, shortest=float(place.way_to((target,)).distance(route[0, :2])),
            stratum={"category": category, "occluded": round(hidden, 3), "by design": fault == 0},
            route=tuple(map(tuple, route.tolist())), legs=tuple(legs),
        )  # fmt: skip

    def _route(
        self, place: Place, slack: float, rng: np.random.Generator
    ) -> tuple[np.ndarray, list[str], np.ndarray] | None:
        """Four legs from a random start, or None; a turn may miss its range by `slack` degrees.

        Poses ``(steps, 3)``, their legs, and which instances are visible ``(steps, instances)`` bool.
        """
        step, turn, count = self.camera.step, self.camera.turn, self.rules.leg_steps
        xy, yaw = place.ground.sample(rng), None
        rows, legs = list[np.ndarray](), list[str]()
        for leg, (least, most) in zip(LEGS, TURNS, strict=True):
            least, most = max(0.0, least - slack), min(180.0, most + slack)
            # Half of the steps of the sharpest turn are counted in; legs that are still too short are rejected below.
            shortest = (count - most / turn / 2) * step
            path = _leg_path(place, xy, yaw, (math.radians(least), math.radians(most)), shortest, rng)
            if path is None:
                return None
            if yaw is None:  # the start's yaw follows from the first turn
                first = math.radians(float(rng.uniform(least, most))) * float(rng.choice([-1, 1]))
                yaw = math.remainder(initial_heading(path) - first, 2 * math.pi)
            rows.append(follow_path(path, yaw, step, math.radians(turn)))
            if len(rows[-1]) < count:
                return None
            legs += [leg] * len(rows[-1])
            xy, yaw = rows[-1][-1, :2], float(rows[-1][-1, 2])
        route = np.concatenate(rows)
        views = [place.ids(place.eye(pose[:2], self.camera.height), world_R_body(pose[2])) for pose in route]
        pixels = [np.bincount(ids[ids >= 0], minlength=len(place.scene.instances)) for ids in views]
        return route, legs, np.stack(pixels) >= VISIBLE

    def _fault(self, centre: np.ndarray, route: np.ndarray, seen: np.ndarray) -> tuple[float, float]:
        """The distance of a route from the requirements for a target, and the share at which the target is hidden.

        0: the target is hidden for a while, and crosses the seam; inf: the route comes too near.
        """
        offset = centre - route[:, :2]
        if np.hypot(*offset.T).min() < NEAREST:
            return math.inf, 1.0
        bearing = np.arctan2(offset[:, 1], offset[:, 0]) - route[:, 2]
        hidden, (least, most) = 1 - float(seen.mean()), OCCLUDED
        # A target that is not seen early would have to be found first: that is another task.
        late = 0.0 if seen[: self.rules.leg_steps].any() else 0.5
        crosses = metrics.seam_crossings(direction(bearing, 0.0 * bearing)).any()
        return max(least - hidden, hidden - most, 0.0) + late + (0.0 if crosses else 1.0), hidden


WAYPOINT = SimTask(
    name="waypoint",
    title="Waypoint Following",
    what="name the direction at every step of a given route of four legs",
    environment=WaypointFollowingEnv,
    rules=WaypointRules,
    measure=measure,
    metrics=(
        *(degrees(leg, leg, f"mean error on the {th} leg") for leg, th in zip(LEGS, ORDINALS, strict=True)),
        degrees("delta", "Δ", "growth of the error, L4 minus L1, mean over the episodes"),
        degrees("occ", "Occ", "mean error while the target is hidden"),
        degrees("seam", "Seam", "mean error where the true bearing crosses the seam"),
        degrees("tc", "TC", f"{JUMP} (rotation and translation)", "°/step", why=CALM),
        degrees(
            "tc_rotation", "TC, rotation",
            f"{JUMP} (rotation alone: parallax counts as a jump, so an estimate that ignores it scores low)", "°/step",
            why="it rewards an estimate that ignores parallax: the paper defines it so, we do not optimise it",
        ),
        COVERAGE,
    ),
    headline="L4",
)  # fmt: skip
