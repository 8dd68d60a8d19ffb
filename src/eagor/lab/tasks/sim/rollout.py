"""Runs an episode: every estimator on the same responses, with a record of the results; and the test of a task.

Waypoint and tracking episodes are open loop. In navigation each estimator runs alone, with mistakes of the same seed.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor import metrics
from eagor._values import lazy
from eagor.conventions import rotation_from_wxyz, wxyz_from_rotation
from eagor.evidence import Evidence
from eagor.grids import ErpGrid
from eagor.lab.agents.methods import BASE, ORACLE, Estimator, Oracle, answer_at, make_estimator
from eagor.lab.agents.models import EpisodePerception, is_privileged, shared
from eagor.lab.agents.search_space import SteeringInput
from eagor.lab.agents.steering import search_config, steering_for
from eagor.lab.envs.episodes import Episode, EpisodeSpec
from eagor.lab.envs.places import APARTMENT
from eagor.lab.envs.rules import Camera
from eagor.lab.tasks.task import config_of, load, require
from eagor.perception import rows_of
from eagor.perception.calibrated import from_json
from eagor.sphere import angular_distance, azimuth_elevation

if TYPE_CHECKING:
    from eagor.lab.envs.place_env import PlaceEnv
    from eagor.lab.worlds.render import Frame

MASS = 0.9  # of the credible regions whose coverage is measured
Columns = dict[str, list[Any]]  # a value for each step


@dataclass(frozen=True, eq=False)
class Step:
    """One step of an episode.

    - `world_R_body`, `position`: by odometry. `evidence`: what arrives, of the query, and of the `other` one.
    - `state`: the true one, as in the environment's ``info["truth"]``.
    - For whoever watches: `view` renders what the camera shows, with so many rows; the `method` after its answer.
    """

    stamp: float
    world_R_body: np.ndarray
    position: np.ndarray
    evidence: Evidence | None
    other: Evidence | None = None
    state: Mapping[str, Any] = field(default_factory=dict)
    view: Callable[..., Frame] | None = None
    method: Estimator | None = None

    @property
    def truth(self) -> np.ndarray | None:
        """The true direction ``(3,)`` in the body frame; None while the target is away."""
        return self.state["direction"] if self.state["present"] else None

    def answered_by(self, method: Estimator) -> np.ndarray:
        """The estimator's direction ``(3,)`` at this step, which it is told after all before it."""
        return answer_at(method, self.stamp, self.world_R_body, self.position, self.evidence)


Watch = Callable[[Step], object]
Act = Callable[[Step, Evidence | None, dict[str, Any]], np.ndarray]


@dataclass(frozen=True, eq=False)
class Rollout:
    """An episode of n steps, and what one method made of it, for `SimTask.measure` (`eagor.lab.tasks.sim.task`).

    - `cost`: "looked", metadata and cost of the perception, if it has some. `info`: the environment's last one.
    - `trace`: lists of n values: azimuth_deg, elevation_deg, error_deg, mass_above, inside, distance_m.
    - `estimates` ``(n, 3)``: the method's directions, body frame.
    """

    episode: Episode
    steps: tuple[Step, ...]
    rules: Any = None
    camera: Camera = field(default_factory=Camera)
    cost: dict[str, Any] = field(default_factory=dict)
    info: Mapping[str, Any] = field(default_factory=dict)
    trace: Mapping[str, list[Any]] = field(default_factory=dict)
    estimates: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    @lazy
    def directions(self) -> np.ndarray:
        """The true ones ``(n, 3)``, body frame, held while the target is away."""
        found = list[np.ndarray]()
        for step in self.steps:
            found.append(found[-1] if step.truth is None else step.truth)
        return np.array(found)

    @lazy
    def motions(self) -> tuple[np.ndarray, np.ndarray]:
        """The camera's true turns ``(n - 1, 3, 3)`` and shifts ``(n - 1, 3)``."""
        poses = (np.array([step.state[key] for step in self.steps]) for key in ("world_R_body", "position"))
        return metrics.ego_motion(*poses)

    @lazy
    def truth(self) -> Columns:
        """Lists of n values for the record: pose, azimuth_deg, elevation_deg, range_m, visible, present, seam, leg."""
        states = [step.state for step in self.steps]
        poses = [[*state["position"], *wxyz_from_rotation(state["world_R_body"])] for state in states]
        found: Columns = {"pose": [[round(float(value), 5) for value in pose] for pose in poses]}
        found |= _angles([state["direction"] for state in states])
        found["range_m"] = [round(float(state["distance"]), 3) for state in states]
        found |= {key: [bool(state[key]) for state in states] for key in ("visible", "present")}
        found["seam"] = metrics.seam_crossings(self.directions).tolist()
        return found | ({"leg": [state["leg"] for state in states]} if "leg" in states[0] else {})

    @property
    def coverage(self) -> float | None:
        """The share of steps with the truth inside the stated 90 % region; None for methods without regions."""
        inside = [value for value in self.trace["inside"] if value is not None]
        return float(np.mean(inside)) if inside else None


class Runner:
    """Runs the episodes of one run: `config` is a `eagor.lab.tasks.sim.task.SimConfig`, or a part of one as JSON.

    `perception` and `kind` (the task): the objects, if they exist already.
    """

    def __init__(self, config: Any, perception: Any = None, kind: Any = None) -> None:
        self.task: Any = kind or load(config["task"] if isinstance(config, Mapping) else config.task)
        self.config = config_of(self.task, config) if isinstance(config, Mapping) else config
        self.perception = shared(self.config.perception) if perception is None else perception
        self.camera, self.noise, self.rules = self.config.camera, self.config.disturbances, self.config.rules
        ours = BASE
        if self.config.calibrated:
            found = from_json(self.config.calibrated, "the run's calibration")
            ours = BASE.fitted(found.calibration, found.detector, found.forgetting)
        self.ours = search_config(self.rules, ours)
        rows = None if is_privileged(self.perception) else self.config.rows or rows_of(self.perception)
        self.env: PlaceEnv = self.task.environment(
            rules=self.rules, camera=self.camera, disturbances=self.noise, panorama=rows
        )

    def plan(self, spec: EpisodeSpec) -> Episode:
        """The episode of this spec."""
        return self.env.plan(spec)

    def run_episode(self, spec: EpisodeSpec, names: Sequence[str], watch: Watch | None = None) -> dict[str, Any]:
        """The record of one episode; `watch` is called after each answer of each estimator."""
        episode = self.plan(spec)
        record: dict[str, Any] = {"task": self.task.name, "episode": episode.as_json()}
        if self.task.walked:
            return record | {"methods": {name: self._walk(episode, name, watch) for name in names}}
        rollout = self.record(episode, watched=watch is not None)
        scores = {name: self.score(rollout, self.method(name, spec), watch=watch) for name in names}
        return record | rollout.cost | {"truth": rollout.truth, "methods": scores}

    def method(self, name: str, spec: EpisodeSpec) -> Estimator:
        """A new estimator of this name, configured for this perception."""
        fit = {part: getattr(self.perception, part, None) for part in ("calibration", "detector")}
        return make_estimator(name, spec.rng("method"), self.config.perception, ours=self.ours, **fit)

    def record(self, episode: Episode, other: str = "", watched: bool = False) -> Rollout:
        """An episode that is not walked, for all estimators; `other`: a second query; `watched`: with pictures."""
        return self.roll_out(episode, lambda step, look, info: np.array([1.0, 0.0, 0.0]), other, watched)

    def roll_out(self, episode: Episode, act: Act, other: str = "", watched: bool = False) -> Rollout:
        """An episode by actions that `act` chooses from a step, its own look, and the environment's info.

        A walked episode ends with its last action, another one with the last observation.
        """
        observation, info = self.env.reset(options={"episode": episode})
        eye, second = (
            EpisodePerception(self.perception, episode.spec, info["instances"]["labels"], purpose)
            for purpose in ("perception", "other")
        )
        steps, under_way, over = list[Step](), list[Evidence | None](), False
        while not (over and self.task.walked):
            stamp, pose = info["num_steps"] * self.camera.seconds, observation["pose"]
            look = eye.infer(observation, info, stamp)
            under_way.append(look)
            due = under_way.pop(0) if len(under_way) > self.noise.latency else None
            also = second.infer(observation, info, stamp, other) if other else None
            view = self.env.view() if watched else None  # rollouts are pickled
            step = Step(stamp, rotation_from_wxyz(pose[3:]), pose[:3], due, also, info["truth"], view)
            steps.append(step)
            if over:
                break
            observation, _, terminated, truncated, info = self.env.step(act(step, look, info))
            over = terminated or truncated
        looked = eye.account()
        return Rollout(episode, tuple(steps), self.rules, self.camera, {"looked": looked} if looked else {}, info)

    def _walk(self, episode: Episode, name: str, watch: Watch | None) -> dict[str, Any]:
        """One estimator through one episode in which it steers the body."""
        method = Oracle() if name == ORACLE else self.method(name, episode.spec)
        trace: Columns = defaultdict(list)
        steering, answers = steering_for(self.rules, self.camera), list[np.ndarray]()

        def act(step: Step, look: Evidence | None, info: dict[str, Any]) -> np.ndarray:
            answers.append(_answer(method, step, trace, watch))
            true, floor = step.state, None
            if steering.needs_floor_mask:
                floor = self.env.place.floor_in(info["instances"]["ids"], true["position"], true["world_R_body"])
            pose = np.array([*step.position[:2], self.camera.height]), step.world_R_body
            turn = steering.walk(SteeringInput.of(method, answers[-1], *pose, floor, look, self.camera.seconds))
            if steering.needs_floor_mask:
                trace["searching"].append(steering.searching)
            return np.array([turn, 0.0 if steering.arrived else self.camera.step])

        rollout = self.roll_out(episode, act, watched=watch is not None)
        trace |= {key: rollout.truth[key] for key in ("pose", "visible")}
        trace |= {f"true_{key}": rollout.truth[key] for key in ("azimuth_deg", "elevation_deg", "range_m")}
        return self._measured(rollout, trace, answers) | rollout.cost

    def score(
        self, rollout: Rollout, method: Estimator, regions: bool = True, watch: Watch | None = None
    ) -> dict[str, Any]:
        """The metrics and trace of an estimator; without `regions` no coverage and distance, in half of the time."""
        trace: Columns = defaultdict(list)
        answers = [_answer(method, step, trace, watch, regions) for step in rollout.steps]
        return self._measured(rollout, trace, answers)

    def _measured(self, rollout: Rollout, trace: Columns, answers: Sequence[np.ndarray]) -> dict[str, Any]:
        """The metrics and trace of an estimator."""
        trace = dict(trace) | _angles(answers)
        figures = self.task.measure(replace(rollout, trace=trace, estimates=np.array(answers))).items()
        rounded = {key: round(value, 7) if isinstance(value, float) else value for key, value in figures}
        return {"metrics": rounded, "trace": trace}


def _answer(method: Estimator, step: Step, trace: Columns, watch: Watch | None, regions: bool = True) -> np.ndarray:
    """The estimator's direction at a step, judged in `trace`, and shown to `watch`; without error where no truth is."""
    if isinstance(method, Oracle):
        method.state = dict(step.state)
    direction, true = step.answered_by(method), step.truth
    error = None if true is None else float(metrics.angular_error_deg(direction, true))
    mass = None if true is None or not regions else method.mass_above(true)
    distance = method.distance() if regions else None
    trace["error_deg"].append(None if error is None else round(error, 3))
    trace["mass_above"].append(None if mass is None else round(mass, 4))
    trace["inside"].append(None if mass is None else bool(mass < MASS))
    trace["distance_m"].append(None if distance is None else round(distance, 3))
    if watch is not None:
        watch(replace(step, method=method))
    return direction


def _angles(directions: Sequence[np.ndarray]) -> Columns:
    """Azimuths and elevations, rounded degrees."""
    found = zip(("azimuth_deg", "elevation_deg"), azimuth_elevation(np.array(directions)), strict=True)
    return {name: [round(math.degrees(float(angle)), 2) for angle in angles] for name, angles in found}


# --- the contract, tested ---------------------------------------------------------------------------------------------

STEPS = 5000  # an episode that has not ended by then counts as endless
NEAR_DEG = 20.0  # from the direction of the target's middle to the nearest of its pixels


def check_simulation(
    task: Any, world: str = APARTMENT, seed: int = 0, index: int = 0, settings: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Raise `AssertionError` unless a `SimTask` keeps the contract on one episode; a perfect estimator's figures.

    The episode is the `index`-th of the scene that `world` makes of `seed`; `settings` override rules. The same spec
    must always give the same episode; answers must not change the camera's path (unless the task is walked); the truth
    must be true; and better answers must score better. `eagor.lab.tasks.task.check_task` tests what all tasks promise.
    """
    runner = Runner({"task": task.name, "perception": "truth:ideal", "rules": dict(settings or {})}, kind=task)
    spec = EpisodeSpec(task.name, world, seed, index, index)
    episode, again, other = (runner.plan(each) for each in (spec, spec, replace(spec, index=index + 1)))
    wanted = "draw everything from spec.rng(purpose), and keep no state between plans"
    require(episode == again and episode.spec == spec, f"plans another episode for {spec.id} the second time; {wanted}")
    require(replace(other, spec=spec) != episode, f"plans the same episode for specs {spec.id} and {other.spec.id}")
    missing = sorted(set(task.strata) - set(episode.stratum))
    require(not missing, f"reports the strata {missing}, which Episode.stratum lacks")
    off = list[float]()

    def played(sign: float) -> Rollout:
        def act(step: Step, look: Evidence | None, info: dict[str, Any]) -> np.ndarray:
            require(info["num_steps"] < STEPS, f"has not ended after {STEPS} steps; wanted terminated or truncated")
            ids, direction = info["instances"]["ids"], step.state["direction"]
            pixels = ErpGrid(*ids.shape).directions[np.isin(ids, episode.targets)]
            if step.truth is not None and step.state["visible"] and len(pixels):
                off.append(math.degrees(float(np.min(angular_distance(pixels, direction)))))
            x, y, _ = sign * direction
            return np.array([math.atan2(y, x), runner.camera.step]) if task.walked else sign * direction

        return runner.roll_out(episode, act)

    rollout, repeated, opposite = (played(sign) for sign in (1.0, 1.0, -1.0))
    path, same, turned = ([step.position.tolist() for step in each.steps] for each in (rollout, repeated, opposite))
    require(path == same, "takes another path when the same episode is played again")
    bent = "takes another path when other answers are given. If the answer is meant to steer the body, set walked=True"
    require(task.walked or path == turned, bent)
    require(
        not off or float(np.median(off)) <= NEAR_DEG,
        f"says that the target lies farther than {NEAR_DEG:g} degrees (median) from the nearest pixel that shows it; "
        "wanted true directions: world_R_body.T @ (point - position), body frame",
    )
    if task.walked:
        right = wrong = runner.run_episode(spec, [ORACLE])["methods"][ORACLE]
    else:
        right, wrong = (runner.score(rollout, Oracle(sign)) for sign in (1.0, -1.0))
    for metric in task.metrics:
        known = metric.read is not None or metric.key in right["metrics"]
        require(known, f"measures {', '.join(right['metrics'])}; wanted also {metric.key}, which its table shows")
        good, bad, low = metric.of(right), metric.of(wrong), metric.better == "low"
        require(
            None in (metric.better, good, bad) or (good <= bad if low else good >= bad),  # type: ignore[operator]
            f"gives an estimator that is always right {good} in the metric {metric.key}, and one that is always wrong "
            f"{bad}, though {metric.better} is better",
        )
    return right["metrics"]
