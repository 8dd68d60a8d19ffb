"""Target Direction Estimation: a ball in an apartment; it moves, or the camera does, or it is away for a while."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import islice

import numpy as np
from scipy.spatial.transform import Rotation

from eagor import metrics
from eagor.errors import WorldError
from eagor.lab.envs.episodes import Episode, EpisodeSpec
from eagor.lab.envs.place_env import AnsweringEnv
from eagor.lab.envs.places import LOOK_ROWS, Place, load_place
from eagor.lab.envs.rules import LOST, SEEN, VISIBLE, TrackingRules
from eagor.lab.tasks.sim.rollout import Rollout
from eagor.lab.tasks.sim.task import CALM, COVERAGE, JUMP, SimTask
from eagor.lab.tasks.task import Metric, degrees
from eagor.lab.worlds.navmesh import follow_path
from eagor.lab.worlds.render import PAINTS, Ball, with_ball

SCENARIOS = ("moving target", "moving camera", "target gone")
RADIUS = (0.2, 0.32)  # metres, range for the balls
TRIES = 60  # plans tried until one shows the ball often enough; after that, the best of them
EVERY = 4  # steps between checks whether a plan shows the ball
_HOLD = (
    "a filter with a short memory gives up the old place sooner; ours weighs all past evidence, which keeps hidden "
    "targets"
)
SEEN_PIXELS = 6  # of a 64 x 128 panorama: the ball is in plain view at the start


def measure(result: Rollout) -> dict[str, float | None]:
    """The columns of one episode, over the steps with the ball present; None where one does not apply.

    `tc`: changes of the estimate, degrees per step, that neither the camera's turn nor the change of the true bearing
    explains. `recovery`: seconds from the ball's return until the error is small again, or to the end.
    """
    present = np.array(result.truth["present"])
    errors = np.array([math.nan if e is None else e for e in result.trace["error_deg"]])
    recovery = None
    for back in np.flatnonzero(present[1:] & ~present[:-1])[:1] + 1:
        good = np.flatnonzero(errors[back:] <= LOST)
        recovery = float(good[0] if len(good) else len(errors) - back) * result.camera.seconds
    jumps, true, turns, estimates = [], result.directions, result.motions[0], result.estimates
    for k in np.flatnonzero(present[1:] & present[:-1]):
        carried = Rotation.align_vectors(true[k + 1], turns[k] @ true[k])[0].apply(turns[k] @ estimates[k])
        jumps.append(float(metrics.angular_error_deg(estimates[k + 1], carried)))
    return {
        "error": metrics.mean_error(errors[present]),
        "tc": float(np.mean(jumps)) if jumps else None,
        "time_lost": 100 * float((errors[present] > LOST).mean()),
        "recovery": recovery,
        "coverage": result.coverage,
    }


class TargetTrackingEnv(AnsweringEnv):
    """Name the direction of a ball while it moves, while the camera moves, or after it was away."""

    task = "tracking"
    rules = TrackingRules()

    def plan(self, spec: EpisodeSpec) -> Episode:
        place, rng = load_place(spec.world, spec.seed, self.camera.radius), spec.rng("plan")
        scenario = SCENARIOS[spec.number % len(SCENARIOS)]
        radius, colour = float(rng.uniform(*RADIUS)), str(rng.choice(sorted(PAINTS)))
        in_view, best = -1.0, None
        for _ in range(TRIES):
            draft = self._draft(place, scenario, radius, rng)
            if draft is None:
                continue
            steps = [(pose[:2], ball) for pose, ball in zip(*draft, strict=True)][::EVERY]
            pixels = [self._pixels(place, xy)(ball, radius) for xy, ball in steps if ball is not None]
            if (share := float(np.mean(np.array(pixels) >= VISIBLE))) > in_view:
                in_view, best = share, draft
            if in_view >= SEEN:
                break
        if best is None:
            raise WorldError(f"{place.scene.source} has no room for a ball in view ({scenario})")
        route, balls = best
        x, y, yaw = route[0].tolist()
        assert balls[0] is not None
        return Episode(
            spec=spec, scene=place.scene.source, scene_hash=place.scene.hash, query=f"{colour} ball",
            targets=(len(place.scene.instances),), start=(x, y), yaw=yaw,
            shortest=float(place.ground.field(route[0, None, :2]).distance(balls[0][:2])),
            stratum={"scenario": scenario, "in view": round(in_view, 3)}, route=tuple(map(tuple, route.tolist())),
            balls=tuple(None if ball is None else tuple(ball.tolist()) for ball in balls), radius=radius, colour=colour,
        )  # fmt: skip

    def _draft(
        self, place: Place, scenario: str, radius: float, rng: np.random.Generator
    ) -> tuple[np.ndarray, list[np.ndarray | None]] | None:
        """The camera's route ``(steps, 3)`` and the ball ``(3,)`` at each step; None if the places do not suit."""
        camera, count = self.camera, self.rules.steps
        xy, yaw = place.ground.sample(rng), float(rng.uniform(-math.pi, math.pi))
        first = self._spot(place, xy, radius, rng)
        if first is None:
            return None
        still = np.tile([*xy, yaw], (count, 1))
        if scenario == "moving target":
            rolling = islice(place.ground.stroll(first[:2], self.rules.speed * camera.seconds, rng), count)
            return still, [place.eye(spot, radius) for spot in rolling]
        if scenario == "moving camera":
            rows = still[:1]
            for _ in range(20):  # random goals, one after another
                path = place.ground.path(rows[-1, :2], place.ground.sample(rng))
                steps = follow_path(path, float(rows[-1, 2]), camera.step, math.radians(camera.turn))
                rows = np.concatenate([rows, steps])
                if len(rows) >= count:
                    return rows[:count], [first] * count
            return None
        second = self._spot(place, xy, radius, rng)
        if second is None or np.linalg.norm(second - first) < 1.0:
            return None
        away, back = self.rules.away
        # The camera turns meanwhile, so a remembered direction has to be turned, too.
        still[:, 2] = yaw + 0.8 * np.sin(np.arange(count) * 0.25)
        return still, [first] * away + [None] * (back - away) + [second] * (count - back)

    def _spot(self, place: Place, xy: np.ndarray, radius: float, rng: np.random.Generator) -> np.ndarray | None:
        """A point ``(3,)`` on the floor, 1 to 5 m from `xy`, where the ball is in plain view."""
        pixels = self._pixels(place, xy)
        for _ in range(10):
            spot = place.eye(place.ground.sample(rng), radius)
            if 1.0 <= np.linalg.norm(spot[:2] - xy) <= 5.0 and pixels(spot, radius) >= SEEN_PIXELS:
                return spot
        return None

    def _pixels(self, place: Place, xy: np.ndarray) -> Callable[[np.ndarray, float], int]:
        """The number of pixels that show a ball at a point ``(3,)``, of a radius, to the camera at `xy` ``(2,)``."""
        position = place.eye(xy, self.camera.height)
        frame, index = place.renderer.panorama(position, np.eye(3), LOOK_ROWS, rgb=False), len(place.scene.instances)

        def pixels(ball: np.ndarray, radius: float) -> int:
            shown = with_ball(frame, position, np.eye(3), Ball(ball, radius, "red"), index)
            return int(np.count_nonzero(shown.ids == index))

        return pixels


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
