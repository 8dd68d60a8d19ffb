"""Runs an episode: every estimator on the same responses, with a record of the results; and the test of a task.

Waypoint and tracking episodes are open loop. In navigation each estimator runs alone, with mistakes of the same seed.
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor import metrics
from eagor.conventions import rotation_from_wxyz, wxyz_from_rotation
from eagor.evidence import Evidence
from eagor.grids import ErpGrid
from eagor.lab.agents.methods import BASE, ORACLE, Estimator, make_estimator
from eagor.lab.agents.models import EpisodePerception, is_privileged, shared
from eagor.lab.agents.search_space import Chance, SteeringInput
from eagor.lab.agents.steering import search_config, steering_for
from eagor.lab.envs.episodes import Episode, EpisodeSpec
from eagor.lab.envs.places import APARTMENT
from eagor.lab.envs.rules import Camera, NoiseModel, from_dict
from eagor.lab.tasks.task import load, require
from eagor.perception import rows_of
from eagor.perception.calibrated import from_json
from eagor.sphere import angular_distance, azimuth_elevation

if TYPE_CHECKING:
    from eagor.lab.envs.place_env import Picture, PlaceEnv

STANDS = 1e-6  # metres of a step in which the body only turns: no metres at all would call stop
MASS = 0.9  # of the credible regions whose coverage is measured


def _no_picture(rows: int) -> None:
    """Rollouts are kept in files, so their steps have pictures only while somebody watches."""


@dataclass(frozen=True, eq=False)
class StepInfo:
    """One step of an episode: pose by odometry, evidence that arrives, and that of the `other` query.

    `picture` renders what the camera shows, with so many rows. For whoever watches also the `method` after its answer
    (None: the oracle), and the true direction in the body frame, `truth` ``(3,)``, None while the target is away.
    """

    stamp: float
    world_R_body: np.ndarray
    position: np.ndarray
    evidence: Evidence | None
    other: Evidence | None = None
    picture: Picture = _no_picture
    method: Estimator | None = None
    truth: np.ndarray | None = None

    @property
    def pose(self) -> np.ndarray:
        """By odometry ``(7,)``: x, y, z (metres) and a quaternion (w, x, y, z), world_R_body."""
        return np.array([*self.position, *wxyz_from_rotation(self.world_R_body)])


Watch = Callable[[StepInfo], object]
Act = Callable[[StepInfo, np.ndarray, Evidence | None, dict[str, Any]], np.ndarray]


@dataclass(frozen=True, eq=False)
class Rollout:
    """An episode of n steps.

    - `truth`: lists of n values for the record: pose, azimuth_deg, elevation_deg, range_m, visible, present, seam, leg.
    - `directions` ``(n, 3)``: the true ones, body frame, held while the target is away.
    - `rotations` ``(n - 1, 3, 3)``, `translations` ``(n - 1, 3)``: the camera's true motions.
    - `looked`: metadata and cost of the perception.
    """

    episode: Episode
    truth: dict[str, list[Any]]
    steps: tuple[StepInfo, ...]
    directions: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray
    looked: dict[str, Any] | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class EpisodeResult(Rollout):
    """An episode and what one method made of it, for `SimTask.measure` (`eagor.lab.tasks.sim.task`).

    - `trace`: lists of n values: azimuth_deg, elevation_deg, error_deg, mass_above, inside, distance_m.
    - `estimates` ``(n, 3)``: the method's directions, body frame.
    - `info`: the environment's last one, and the metres `walked`. Only for a walked task.
    """

    trace: dict[str, list[Any]]
    estimates: np.ndarray
    rules: Any
    camera: Camera
    info: Mapping[str, Any] = field(default_factory=dict)
    walked: float = 0.0

    @property
    def coverage(self) -> float | None:
        """The share of steps with the truth inside the stated 90 % region; None for methods without regions."""
        inside = [value for value in self.trace["inside"] if value is not None]
        return float(np.mean(inside)) if inside else None


class Runner:
    """Runs the episodes of one run: `config` is the JSON of a `eagor.lab.tasks.sim.task.SimConfig`, or a part of it.

    `perception` and `kind` (the task): the objects, if they exist already.
    """

    def __init__(self, config: dict[str, Any], perception: Any = None, kind: Any = None) -> None:
        self.config = config
        self.perception = shared(config["perception"]) if perception is None else perception
        self.task: Any = kind or load(config["task"])
        self.camera = from_dict(Camera, config.get("camera", {}))
        self.noise = from_dict(NoiseModel, config.get("disturbances", {}))
        self.rules: Any = from_dict(self.task.rules, config.get("rules", {}))
        self.ours = BASE
        if given := config.get("calibrated"):
            found = from_json(given, "the run's calibration")
            self.ours = BASE.fitted(found.calibration, found.detector, found.forgetting)
        self.ours = search_config(self.rules, self.ours)
        rows = None if is_privileged(self.perception) else int(config.get("rows") or rows_of(self.perception))
        self.env: PlaceEnv = self.task.environment(
            rules=self.rules, camera=self.camera, disturbances=self.noise, panorama=rows
        )

    def plan(self, spec: EpisodeSpec) -> Episode:
        """The episode of this spec."""
        return self.env.plan(spec)

    def run_episode(self, spec: EpisodeSpec, names: list[str], watch: Watch | None = None) -> dict[str, Any]:
        """The record of one episode; `watch` is called after each answer of each estimator."""
        episode = self.plan(spec)
        body: dict[str, Any] = {"task": self.task.name, "episode": episode.as_json()}
        if self.task.walked:
            return body | {"methods": {name: self._walk(episode, name, watch) for name in names}}
        rollout = self.record(episode, watched=watch is not None)
        scores = {name: self.score(rollout, self.method(name, spec), watch=watch) for name in names}
        looked = {"looked": rollout.looked} if rollout.looked else {}
        return body | looked | {"truth": rollout.truth, "methods": scores}

    def method(self, name: str, spec: EpisodeSpec) -> Estimator:
        """A new estimator of this name, configured for this perception."""
        fit = {part: getattr(self.perception, part, None) for part in ("calibration", "detector")}
        return make_estimator(name, spec.rng("method"), self.config["perception"], ours=self.ours, **fit)

    def record(self, episode: Episode, other: str = "", watched: bool = False) -> Rollout:
        """An episode that is not walked, for all estimators; `other`: a second query; `watched`: with pictures."""
        return self._roll_out(episode, lambda step, true, look, info: true, other, watched)[0]

    def _roll_out(self, episode: Episode, act: Act, other: str, watched: bool) -> tuple[Rollout, dict[str, Any]]:
        """An episode, and the environment's last info. `act` gets a step, the true direction, the look, and the info.

        A walked episode ends with its last action, another one with the last observation.
        """
        observation, info = self.env.reset(options={"episode": episode})
        eye, second = (
            EpisodePerception(self.perception, episode.spec, info["instances"]["labels"], purpose)
            for purpose in ("perception", "other")
        )
        truth: dict[str, list[Any]] = defaultdict(list)
        steps, under_way, directions, poses, over = list[StepInfo](), list[Evidence | None](), [], [], False
        while not (over and self.task.walked):
            stamp, pose, true = info["num_steps"] * self.camera.seconds, observation["pose"], info["truth"]
            look = eye.look(observation, info, stamp)
            under_way.append(look)
            due = under_way.pop(0) if len(under_way) > self.noise.latency else None
            also = second.look(observation, info, stamp, other) if other else None
            picture = self.env.picture() if watched else _no_picture
            steps.append(StepInfo(stamp, rotation_from_wxyz(pose[3:]), pose[:3], due, also, picture))
            directions.append(true["direction"] if true["present"] else directions[-1])
            poses.append((true["world_R_body"], true["position"]))
            _note_truth(truth, info)
            if over:
                break
            observation, _, terminated, truncated, info = self.env.step(act(steps[-1], directions[-1], look, info))
            over = terminated or truncated
        truth["seam"] = metrics.seam_crossings(np.array(directions)).tolist()
        motion = metrics.ego_motion(*(np.array(part) for part in zip(*poses, strict=True)))
        rollout = Rollout(episode, dict(truth), tuple(steps), np.array(directions), *motion, eye.account() or None)
        return rollout, info

    def _walk(self, episode: Episode, name: str, watch: Watch | None) -> dict[str, Any]:
        """One estimator through one episode in which it steers the body."""
        method = None if name == ORACLE else self.method(name, episode.spec)
        steering = steering_for(self.rules, self.camera)
        trace: dict[str, list[Any]] = defaultdict(list)
        answers = list[np.ndarray]()

        def act(step: StepInfo, true: np.ndarray, look: Evidence | None, info: dict[str, Any]) -> np.ndarray:
            answers.append(_answer(method, step, true, trace, watch))
            now = self._steering_input(answers[-1], method, look, step, info, steering.needs_floor_mask)
            turn, metres = steering.walk(now)
            if steering.needs_floor_mask:
                trace["searching"].append(steering.searching)
            return np.array([turn, 0.0 if steering.arrived else max(metres, STANDS)])

        rollout, info = self._roll_out(episode, act, "", watch is not None)
        trace |= {key: rollout.truth[key] for key in ("pose", "visible")}
        trace |= {f"true_{key}": rollout.truth[key] for key in ("azimuth_deg", "elevation_deg", "range_m")}
        found = self._measured(rollout, trace, answers, info=info, walked=self.env.body.walked)
        return found | ({"looked": rollout.looked} if rollout.looked else {})

    def _measured(self, rollout: Rollout, trace: dict, answers: Sequence, **walk: Any) -> dict[str, Any]:
        """The metrics and trace of an estimator."""
        given = {"rules": self.rules, "camera": self.camera} | walk
        result = EpisodeResult(**vars(rollout), trace=trace, estimates=np.array(answers), **given)
        figures = self.task.measure(result).items()
        rounded = {key: round(value, 7) if isinstance(value, float) else value for key, value in figures}
        return {"metrics": rounded, "trace": dict(trace)}

    def _steering_input(
        self, direction: np.ndarray, method: Estimator | None, look: Evidence | None, step: StepInfo, info: dict,
        with_floor: bool,
    ) -> SteeringInput:  # fmt: skip
        """What steers the body at a step; only a policy that asks for the floor gets it, and what is believed."""
        true, belief = info["truth"], method if with_floor else None  # the oracle is sure
        pose = true["position"], true["world_R_body"]
        distance = true["distance"] if method is None else method.sure_distance()
        return SteeringInput(
            azimuth=float(azimuth_elevation(direction)[0]),
            progress=1.0 if belief is None else belief.progress(),
            presence=1.0 if belief is None else belief.presence(),
            distance=None if distance is None else distance * math.hypot(float(direction[0]), float(direction[1])),
            position=np.array([*step.position[:2], self.camera.height]),
            world_R_body=step.world_R_body,
            floor=self.env.place.floor_in(info["instances"]["ids"], *pose) if with_floor else None,
            chance=Chance.of(look, self.camera.seconds) if look is not None and with_floor else None,
        )

    def score(
        self, rollout: Rollout, method: Estimator, regions: bool = True, watch: Watch | None = None
    ) -> dict[str, Any]:
        """The metrics and trace of an estimator; without `regions` no coverage and distance, in half of the time."""
        trace: dict[str, list[Any]] = defaultdict(list)
        answers = [
            _answer(method, step, direction if present else None, trace, watch, regions)
            for step, direction, present in zip(
                rollout.steps, rollout.directions, rollout.truth["present"], strict=True
            )
        ]
        return self._measured(rollout, trace, answers)


def _answer(
    method: Estimator | None, step: StepInfo, true: np.ndarray | None, trace: dict[str, list[Any]], watch: Watch | None,
    regions: bool = True,
) -> np.ndarray:  # fmt: skip
    """The estimator's direction at a step (None: the oracle's), noted in `trace`, and shown to `watch`.

    Its error is None while the target is away (`true` is None).
    """
    if method is None:
        assert true is not None
        direction = true
    else:
        method.move(step.stamp, step.world_R_body, step.position)
        if step.evidence is not None:
            method.see(step.evidence)
        direction = method.direction()
    _note_direction(trace, direction)
    error = None if true is None else float(metrics.angular_error_deg(direction, true))
    mass = None if true is None or method is None or not regions else method.mass_above(true)
    distance = method.distance() if method is not None and regions else None
    trace["error_deg"].append(None if error is None else round(error, 3))
    trace["mass_above"].append(None if mass is None else round(mass, 4))
    trace["inside"].append(None if mass is None else bool(mass < MASS))
    trace["distance_m"].append(None if distance is None else round(distance, 3))
    if watch is not None:
        watch(replace(step, method=method, truth=true))
    return direction


def _note_truth(lists: dict[str, list[Any]], info: Mapping[str, Any]) -> None:
    true = info["truth"]
    pose = [*true["position"], *wxyz_from_rotation(true["world_R_body"])]
    lists["pose"].append([round(float(value), 5) for value in pose])
    _note_direction(lists, true["direction"])
    lists["range_m"].append(round(float(true["distance"]), 3))
    for key in ("visible", "present"):
        lists[key].append(bool(true[key]))
    if "leg" in info:
        lists["leg"].append(info["leg"])


def _note_direction(lists: dict[str, list[Any]], direction: np.ndarray) -> None:
    for name, angle in zip(("azimuth_deg", "elevation_deg"), azimuth_elevation(direction), strict=True):
        lists[name].append(round(math.degrees(float(angle)), 2))


# --- the contract, tested ---------------------------------------------------------------------------------------------

STEPS = 5000  # an episode that has not ended by then counts as endless
NEAR_DEG = 20.0  # from the direction of the target's middle to the nearest of its pixels


def check_simulation(
    task: Any, world: str = APARTMENT, seed: int = 0, index: int = 0, settings: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Raise `AssertionError` unless a `SimTask` keeps the contract on one episode; a perfect estimator's figures.

    The episode is the `index`-th of the scene that `world` makes of `seed`; `settings` override rules. The same spec
    must always give the same episode; answers must not change the camera's path (unless the task is walked); the truth
    must be true; and better answers must score better.
    """
    written = json.loads(json.dumps(asdict(task.rules(**(settings or {})))))
    runner = Runner({"task": task.name, "perception": "truth:ideal", "rules": written}, kind=task)
    require(asdict(runner.rules) == asdict(task.rules(**(settings or {}))), "has rules that JSON turns into others")
    spec = EpisodeSpec(task.name, world, seed, index, index)
    episode, again, other = (runner.plan(each) for each in (spec, spec, replace(spec, index=index + 1)))
    wanted = "draw everything from spec.rng(purpose), and keep no state between plans"
    require(episode == again and episode.spec == spec, f"plans another episode for {spec.id} the second time; {wanted}")
    require(replace(other, spec=spec) != episode, f"plans the same episode for specs {spec.id} and {other.spec.id}")
    missing = sorted(set(task.strata) - set(episode.stratum))
    require(not missing, f"reports the strata {missing}, which Episode.stratum lacks")
    (poses, off), (repeated, _), (opposite, _) = (_play(runner, episode, sign) for sign in (1.0, 1.0, -1.0))
    require(np.array_equal(poses, repeated), "takes another path when the same episode is played again")
    require(
        task.walked or np.array_equal(poses, opposite),
        "takes another path when other answers are given. If the answer is meant to steer the body, set walked=True",
    )
    require(
        not off or float(np.median(off)) <= math.radians(NEAR_DEG),
        f"says that the target lies farther than {NEAR_DEG:g} degrees (median) from the nearest pixel that shows it; "
        "wanted true directions: world_R_body.T @ (point - position), body frame",
    )
    if task.walked:
        return _checked(task, runner.run_episode(spec, [ORACLE])["methods"][ORACLE])["metrics"]
    rollout = runner.record(episode)
    right, wrong = (_checked(task, runner.score(rollout, _Known(sign * rollout.directions))) for sign in (1.0, -1.0))
    for metric in task.metrics:
        good, bad = metric.of(right), metric.of(wrong)
        if metric.better is None or good is None or bad is None:
            continue
        require(
            good <= bad if metric.better == "low" else good >= bad,
            f"gives an estimator that is always right {good:g} in the metric {metric.key}, and one that is always "
            f"wrong {bad:g}, though {metric.better} is better",
        )
    return right["metrics"]


def _play(runner: Runner, episode: Episode, sign: float) -> tuple[np.ndarray, list[float]]:
    """The poses ``(n, 7)``, answering `sign` times the truth, and the angles of that to the target's pixels."""
    observation, info = runner.env.reset(options={"episode": episode})  # also checks the scene's hash
    poses, off, over = [], list[float](), False
    while True:
        ids, truth = info["instances"]["ids"], info["truth"]
        direction = np.asarray(truth["direction"], dtype=np.float64)
        pixels = ErpGrid(*ids.shape).directions[np.isin(ids, episode.targets)]
        poses.append(observation["pose"])
        if truth["present"] and truth["visible"] and len(pixels):
            off.append(float(np.min(angular_distance(pixels, direction))))
        if over:
            return np.array(poses), off
        require(len(poses) < STEPS, f"has not ended after {STEPS} steps; wanted terminated or truncated before that")
        action: Any = (sign * direction).astype(np.float32)
        if runner.task.walked:
            action = np.array([math.atan2(sign * direction[1], sign * direction[0]), runner.camera.step])
        observation, _, terminated, truncated, info = runner.env.step(action)
        over = terminated or truncated


class _Known(Estimator):
    """Gives these answers ``(n, 3)``, one after the other."""

    def __init__(self, answers: np.ndarray) -> None:
        self._answers = iter(answers)

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        self._answer = next(self._answers)

    def see(self, evidence: Any) -> None:
        pass

    def direction(self) -> np.ndarray:
        return self._answer

    def mass_above(self, direction: np.ndarray) -> float | None:
        return 0.0 if float(self._answer @ direction) > 0 else 1.0


def _checked(task: Any, result: dict[str, Any]) -> dict[str, Any]:
    """`result`, which has a plain figure for every metric."""
    figures = result["metrics"]
    for key, value in figures.items():
        plain = value is None or (isinstance(value, int | float) and math.isfinite(value))
        require(plain, f"measures {key} = {value!r}; wanted a finite number, or None if it does not apply")
    missing = sorted({metric.key for metric in task.metrics if metric.read is None} - figures.keys())
    require(not missing, f"measures {', '.join(figures)}; wanted also {', '.join(missing)}, which its table shows")
    return result
