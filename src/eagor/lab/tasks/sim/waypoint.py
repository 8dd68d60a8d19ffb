"""Waypoint Following: along a given route of four legs, each beginning with a sharper turn, name the direction.

All methods get the same route and the same responses. Routes are chosen so that the target is hidden for a part of the
route and crosses the seam of the panorama.
"""

from __future__ import annotations

import math
from itertools import islice
from typing import NamedTuple

import numpy as np

from eagor import metrics
from eagor.errors import WorldError
from eagor.lab.envs.episodes import Episode, EpisodeSpec, choose_target
from eagor.lab.envs.place_env import AnsweringEnv
from eagor.lab.envs.places import Place, load_place
from eagor.lab.envs.rules import LEGS, OCCLUDED, TURNS, VISIBLE, Camera, WaypointRules
from eagor.lab.tasks.sim.play import Rollout
from eagor.lab.tasks.sim.task import CALM, COVERAGE, JUMP, SimTask
from eagor.lab.tasks.task import degrees
from eagor.lab.worlds.navmesh import follow_path, initial_heading
from eagor.sphere import direction, world_R_body

ATTEMPTS = 200  # to find routes at all: small rooms have few legs of four metres
SLACK = 30.0  # degrees by which turns may finally miss their ranges if nothing fits
ROUTES = 8  # routes tried until one hides a target and crosses the seam
GOALS = 6  # ends of a leg tried
LONGER = 3.0  # metres by which a leg may exceed its least length
AHEAD = 0.5  # metres over which the heading of a path is taken, as in `initial_heading`
NEAREST = 0.8  # metres: least distance of the camera from the target's middle


class _Route(NamedTuple):
    """A route through a place, and which instances are visible along it ``(steps, instances)`` bool."""

    poses: np.ndarray
    legs: list[str]
    seen: np.ndarray


def _route(place: Place, camera: Camera, leg_steps: int, slack: float, rng: np.random.Generator) -> _Route | None:
    """Four legs from a random start, or None; a turn may miss its range by `slack` degrees."""
    xy, yaw = place.ground.sample(rng), None
    rows: list[np.ndarray] = []
    legs: list[str] = []
    for leg, (least, most) in zip(LEGS, TURNS, strict=True):
        least, most = max(0.0, least - slack), min(180.0, most + slack)
        # Half of the steps of the sharpest turn are counted in; legs that are still too short are rejected below.
        shortest = (leg_steps - most / camera.turn / 2) * camera.step
        path = _leg_path(place, xy, yaw, (math.radians(least), math.radians(most)), shortest, rng)
        if path is None:
            return None
        if yaw is None:  # the start's yaw follows from the first turn
            turn = math.radians(float(rng.uniform(least, most))) * float(rng.choice([-1, 1]))
            yaw = math.remainder(initial_heading(path) - turn, 2 * math.pi)
        steps = follow_path(path, yaw, camera.step, math.radians(camera.turn))
        if len(steps) < leg_steps:
            return None
        rows.append(steps)
        legs += [leg] * len(steps)
        xy, yaw = steps[-1, :2], float(steps[-1, 2])
    poses, count = np.concatenate(rows), len(place.scene.instances)
    views = [place.ids(place.eye(pose[:2], camera.height), world_R_body(pose[2])) for pose in poses]
    pixels = np.stack([np.bincount(ids[ids >= 0], minlength=count) for ids in views])
    return _Route(poses, legs, pixels >= VISIBLE)


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


def _fault(place: Place, target: int, route: _Route, leg_steps: int) -> tuple[float, float]:
    """The distance of a route from the requirements for this target, and the share at which the target is hidden.

    0: the target is hidden for a while, and crosses the seam; inf: the route comes too near.
    """
    centre, seen = place.scene.instances[target].centre, route.seen[:, target]
    offset = centre[:2] - route.poses[:, :2]
    if np.hypot(*offset.T).min() < NEAREST:
        return math.inf, 1.0
    bearing = np.arctan2(offset[:, 1], offset[:, 0]) - route.poses[:, 2]
    hidden, (least, most) = 1 - float(seen.mean()), OCCLUDED
    # A target that is not seen early would have to be found first: that is another task.
    late = 0.0 if seen[:leg_steps].any() else 0.5
    crosses = metrics.seam_crossings(direction(bearing, 0.0 * bearing)).any()
    return max(least - hidden, hidden - most, 0.0) + late + (0.0 if crosses else 1.0), hidden


def measure(result: Rollout) -> dict[str, float | None]:
    """The paper's columns for one episode: L1..L4, delta, occ, seam, tc (degrees); None where one does not apply."""
    errors, truth, estimates = np.array(result.trace["error_deg"]), result.truth, result.estimates
    labels = np.array(truth["leg"])
    legs = {leg: metrics.mean_error(errors, labels == leg) for leg in LEGS}
    first, last = legs[LEGS[0]], legs[LEGS[-1]]
    ranges = np.array(truth["range_m"])
    return {
        **legs,
        "delta": None if first is None or last is None else last - first,
        "occ": metrics.mean_error(errors, ~np.array(truth["visible"], dtype=bool)),
        "seam": metrics.mean_error(errors, metrics.seam_crossings(result.directions)),
        "tc": metrics.temporal_consistency(estimates, *result.motions, ranges),
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
        place = load_place(spec.world, spec.seed, self.camera.radius)
        rng = spec.rng("plan")
        targets = list(choose_target(place, rng))
        if not targets:
            raise WorldError(f"{place.scene.source} has no thing with a unique name")
        attempts = (
            _route(place, self.camera, self.rules.leg_steps, SLACK * attempt / ATTEMPTS, rng)
            for attempt in range(ATTEMPTS)
        )
        routes = islice((route for route in attempts if route is not None), ROUTES)
        best: tuple[float, float, int, str, _Route] | None = None
        for route, (target, query) in ((route, each) for route in routes for each in targets):
            fault, hidden = _fault(place, target, route, self.rules.leg_steps)
            if fault < (math.inf if best is None else best[0]):
                best = fault, hidden, target, query, route
            if fault == 0:
                break
        if best is None:
            raise WorldError(
                f"{place.scene.source} has no route of four legs of {self.rules.leg_steps} steps; shorten the legs"
            )
        fault, hidden, target, query, route = best
        x, y, yaw = route.poses[0].tolist()
        category = place.scene.instances[target].category
        kind = {"category": category, "occluded": round(hidden, 3), "by design": fault == 0}
        return Episode(
            spec=spec, scene=place.scene.source, scene_hash=place.scene.hash, query=query, targets=(target,), start=(x, y),
            yaw=yaw, shortest=float(place.way_to((target,)).distance(route.poses[0, :2])), stratum=kind,
            route=tuple(tuple(row) for row in route.poses.tolist()), legs=tuple(route.legs),
        )  # fmt: skip


WAYPOINT = SimTask(
    name="waypoint",
    title="Waypoint Following",
    what="name the direction at every step of a given route of four legs",
    environment=WaypointFollowingEnv,
    rules=WaypointRules,
    measure=measure,
    metrics=(
        degrees("L1", "L1", "mean error on the first leg"),
        degrees("L2", "L2", "mean error on the second leg"),
        degrees("L3", "L3", "mean error on the third leg"),
        degrees("L4", "L4", "mean error on the fourth leg"),
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
