"""Target Direction Estimation: a ball in an apartment; it moves, or the camera does, or it is away for a while."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import islice
from typing import Any

import numpy as np

from eagor import metrics
from eagor.errors import WorldError
from eagor.lab.envs.episodes import Episode, EpisodeSpec
from eagor.lab.envs.place_env import AnsweringEnv
from eagor.lab.envs.places import LOOK_ROWS, Place, load_place
from eagor.lab.envs.rules import LOST, SEEN, VISIBLE, Camera, TrackingRules
from eagor.lab.tasks.sim.play import Rollout
from eagor.lab.tasks.sim.task import CALM, COVERAGE, JUMP, SimTask
from eagor.lab.tasks.task import Metric, degrees
from eagor.lab.worlds.navmesh import follow_path, stroll
from eagor.lab.worlds.render import PAINTS, Ball, with_ball
from eagor.sphere import angular_distance, rotation, world_R_body

SCENARIOS = ("moving target", "moving camera", "target gone")
RADIUS = (0.2, 0.32)  # metres, range for the balls
TRIES = 60  # plans tried until one shows the ball often enough; after that, the best of them
EVERY = 4  # steps between checks whether a plan shows the ball
_BALL = 1 << 20  # an id that no instance has
_HOLD = (
    "a filter with a short memory gives up the old place sooner; ours weighs all past evidence, which keeps hidden "
    "targets"
)
SEEN_PIXELS = 6  # of a 64 x 128 panorama: the ball is in plain view at the start


def _draft(
    place: Place, scenario: str, radius: float, camera: Camera, rules: TrackingRules, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray | None]] | None:
    """One plan of a scenario: the ball's first place ``(3,)``, the camera's route ``(steps, 3)``, the ball per step.

    None if the place drawn for the camera does not suit.
    """
    xy, yaw = place.ground.sample(rng), float(rng.uniform(-math.pi, math.pi))
    first = _spot(place, xy, radius, camera, rng)
    if first is None:
        return None
    still = np.tile([*xy, yaw], (rules.steps, 1))
    if scenario == "moving target":
        rolling = islice(stroll(place.ground, first[:2], rules.speed * camera.seconds, rng), rules.steps)
        return first, still, [place.eye(spot, radius) for spot in rolling]
    if scenario == "moving camera":
        rows = still[:1]
        for _ in range(20):  # random goals, one after another
            path = place.ground.path(rows[-1, :2], place.ground.sample(rng))
            steps = follow_path(path, float(rows[-1, 2]), camera.step, math.radians(camera.turn))
            rows = np.concatenate([rows, steps])
            if len(rows) >= rules.steps:
                return first, rows[: rules.steps], [first] * rules.steps
        return None
    second = _spot(place, xy, radius, camera, rng)
    if second is None or np.linalg.norm(second - first) < 1.0:
        return None
    away, back = rules.away
    # The camera turns meanwhile, so a remembered direction has to be turned, too.
    still[:, 2] = yaw + 0.8 * np.sin(np.arange(rules.steps) * 0.25)
    return first, still, [first] * away + [None] * (back - away) + [second] * (rules.steps - back)


def _share_in_view(place: Place, route: np.ndarray, balls: list, radius: float, camera: Camera) -> float:
    """Of the steps with the ball present, the share that shows it; sampled at every `EVERY`-th step."""
    steps = [(pose[:2], ball) for pose, ball in zip(route, balls, strict=True)][::EVERY]
    shown = [_pixels_at(place, xy, camera)(ball, radius) for xy, ball in steps if ball is not None]
    return float(np.mean(np.array(shown) >= VISIBLE))


def _spot(place: Place, xy: np.ndarray, radius: float, camera: Camera, rng: np.random.Generator) -> np.ndarray | None:
    """A point ``(3,)`` on the floor, 1 to 5 m from `xy`, where the ball is in plain view."""
    pixels = _pixels_at(place, xy, camera)
    for _ in range(10):
        spot = place.eye(place.ground.sample(rng), radius)
        if 1.0 <= np.linalg.norm(spot[:2] - xy) <= 5.0 and pixels(spot, radius) >= SEEN_PIXELS:
            return spot
    return None


def _pixels_at(place: Place, xy: np.ndarray, camera: Camera) -> Callable[[np.ndarray, float], int]:
    """The number of pixels that show a ball at a point ``(3,)``, of a radius, to a camera at `xy` ``(2,)``."""
    position = place.eye(xy, camera.height)
    frame = place.renderer.panorama(position, world_R_body(0.0), LOOK_ROWS, rgb=False)

    def pixels(ball: np.ndarray, radius: float) -> int:
        shown = with_ball(frame, position, np.eye(3), Ball(ball, radius, "red"), _BALL)
        return int(np.count_nonzero(shown.ids == _BALL))

    return pixels


def measure(result: Rollout) -> dict[str, float | None]:
    """The columns of one episode, over the steps with the ball present; None where one does not apply.

    `tc`: the angle between an estimate and the previous one, moved along by the true motions. `recovery`: seconds from
    the ball's return until the error is small again, or to the end.
    """
    present = np.array(result.truth["present"], dtype=bool)
    errors = np.array([math.nan if e is None else e for e in result.trace["error_deg"]])
    lost = errors[present] > LOST
    recovery = None
    returns = np.flatnonzero(present[1:] & ~present[:-1]) + 1
    if len(returns):
        good = np.flatnonzero(errors[returns[0] :] <= LOST)
        steps = int(good[0]) if len(good) else len(errors) - int(returns[0])
        recovery = steps * result.camera.seconds
    return {
        "error": metrics.mean_error(errors[present]),
        "tc": _consistency(result.directions, result.estimates, result.motions[0], present),
        "time_lost": 100 * float(lost.mean()),
        "recovery": recovery,
        "coverage": result.coverage,
    }


def _consistency(
    directions: np.ndarray, estimates: np.ndarray, rotations: np.ndarray, present: np.ndarray
) -> float | None:
    """Changes of the estimate that neither the camera's turn nor the change of the true bearing explains (deg/step)."""
    steps = np.flatnonzero(present[1:] & present[:-1])
    if not len(steps):
        return None
    carried = [_turn(rotations[k] @ directions[k], directions[k + 1]) @ rotations[k] @ estimates[k] for k in steps]
    return float(metrics.angular_error_deg(estimates[steps + 1], np.array(carried)).mean())


def _turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The smallest rotation ``(3, 3)`` that takes unit vector `start` to `end`."""
    axis = np.cross(start, end)
    if np.linalg.norm(axis) < 1e-9:  # the same, or opposite: any perpendicular axis
        axis = np.cross(start, np.eye(3)[int(np.argmin(np.abs(start)))])
    return rotation(axis, float(angular_distance(start, end)))


class TargetTrackingEnv(AnsweringEnv):
    """Name the direction of a ball while it moves, while the camera moves, or after it was away."""

    task = "tracking"
    rules = TrackingRules()

    def plan(self, spec: EpisodeSpec) -> Episode:
        place, rng = load_place(spec.world, spec.seed, self.camera.radius), spec.rng("plan")
        scenario = SCENARIOS[spec.number % len(SCENARIOS)]
        radius, colour = float(rng.uniform(*RADIUS)), str(rng.choice(sorted(PAINTS)))
        best: tuple[float, np.ndarray, np.ndarray, list[np.ndarray | None]] | None = None
        for _ in range(TRIES):
            draft = _draft(place, scenario, radius, self.camera, self.rules, rng)
            if draft is None:
                continue
            in_view = _share_in_view(place, *draft[1:], radius, self.camera)
            if best is None or in_view > best[0]:
                best = in_view, *draft
            if in_view >= SEEN:
                break
        if best is None:
            raise WorldError(f"{place.scene.source} has no room for a ball in view ({scenario})")
        in_view, first, route, balls = best
        x, y, yaw = route[0].tolist()
        return Episode(
            spec=spec, scene=place.scene.source, scene_hash=place.scene.hash, query=f"{colour} ball",
            targets=(len(place.scene.instances),), start=(x, y), yaw=yaw,
            shortest=float(place.ground.field(route[0, None, :2]).distance(first[:2])),
            stratum={"scenario": scenario, "in view": round(in_view, 3)}, route=tuple(map(tuple, route.tolist())),
            balls=tuple(None if ball is None else tuple(ball.tolist()) for ball in balls), radius=radius, colour=colour,
        )  # fmt: skip


TRACKING = SimTask(
    name="tracking",
    title="Target Direction Estimation",
    what="name the direction of a ball that moves, or is away, or that the camera walks past",
    environment=TargetTrackingEnv,
    rules=TrackingRules,
    measure=measure,
    metrics=(
        degrees("error", "Error", "mean direction error"),
        degrees("tc", "TC", f"{JUMP} (rotation and translation)", "°/step", why=CALM),
        Metric("time_lost", "Time lost", "share of steps at which the target is lost", better="low", scale=1.0),
        degrees("recovery", "Recovery", "from the target's return until it is found again", "s", why=_HOLD),
        COVERAGE,
    ),
    headline="error",
    strata={"scenario": "Scenario"},
)  # fmt: skip
