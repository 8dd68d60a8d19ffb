"""The test that every simulated task has to pass, so that figures are comparable."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from eagor.errors import QueryError
from eagor.grids import ErpGrid
from eagor.lab.agents.methods import ORACLE, Estimator
from eagor.lab.envs.episodes import Episode, EpisodeSpec
from eagor.lab.envs.places import APARTMENT
from eagor.lab.envs.rules import from_dict
from eagor.lab.tasks.sim.play import Runner
from eagor.lab.tasks.sim.task import SimTask
from eagor.lab.tasks.task import require
from eagor.queries import matching, parse_query
from eagor.sphere import angular_distance

STEPS = 5000  # an episode that has not ended by then counts as endless
WALKED = ("success", "spl", "mae")  # figures that reports need of walked tasks
NEAR_DEG = 20.0  # from the direction of the target's middle to the nearest of its pixels


def check_simulation(
    task: SimTask, world: str = APARTMENT, seed: int = 0, index: int = 0, settings: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Raise `AssertionError` unless `task` keeps the contract on one episode; returns a perfect estimator's figures.

    The episode is the `index`-th of the scene that `world` makes of `seed`; `settings` override rules. The same spec
    must always give the same episode; answers must not change the camera's path (unless the task is walked); the truth
    must be true; and better answers must score better.
    """
    _check_description(task)
    rules = _check_rules(task, dict(settings or {}))
    config = {"task": task.name, "perception": "truth:ideal", "rules": rules}
    runner = Runner(config, kind=task)
    episode = _check_plan(task, runner, EpisodeSpec(task.name, world, seed, index, index))
    _check_path(task, runner, episode)
    return _check_figures(task, runner, episode)


def _check_description(task: SimTask) -> None:
    require(isinstance(task, SimTask), f"is a {type(task).__name__}; wanted an eagor.lab.tasks.sim.task.SimTask")
    named = re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", task.name)
    require(named, f"has the name {task.name!r}; wanted lower-case letters and digits with dashes between them")
    keys = [metric.key for metric in task.metrics]
    require(keys and len(set(keys)) == len(keys), f"has the metrics {keys}; wanted at least one, each key once")
    require(task.headline in keys, f"has the headline {task.headline!r}; wanted one of its metrics, {', '.join(keys)}")
    for key, better in ((metric.key, metric.better) for metric in task.metrics):
        wanted = "wanted 'low', 'high' or None"
        require(better in ("low", "high", None), f"says that {better!r} is better in the metric {key}; {wanted}")


def _through_json(value: Any, name: str) -> Any:
    try:
        return json.loads(json.dumps(value, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise AssertionError(
            f"the task has {name} that JSON cannot write ({error}); wanted plain numbers, texts, booleans and tuples "
            "of them: float(x), not NumPy's"
        ) from error


def _check_rules(task: SimTask, settings: dict[str, Any]) -> dict[str, Any]:
    """Rules can be made without arguments, and written and read; returns them as JSON."""
    kind = task.rules
    frozen = dataclasses.is_dataclass(kind) and getattr(kind, "__dataclass_params__").frozen  # noqa: B009 (for pyright)
    require(frozen, f"has rules of type {kind.__name__}; wanted a frozen dataclass")
    try:
        rules = kind(**settings)
    except TypeError as error:
        raise AssertionError(f"the task cannot make its rules ({error}); wanted a default for each") from None
    written = _through_json(dataclasses.asdict(rules), "rules")
    back = from_dict(kind, written)
    require(back == rules, f"has the rules {rules}, which JSON turns into {back}; wanted plain values and tuples")
    return written


def _check_plan(task: SimTask, runner: Runner, spec: EpisodeSpec) -> Episode:
    """A spec always gives the same episode, other specs other ones; the body can stand there, and the target exists."""
    episode, other = runner.plan(spec), runner.plan(dataclasses.replace(spec, index=spec.index + 1))
    require(isinstance(episode, Episode), f"plans a {type(episode).__name__}; wanted an eagor.lab.envs.Episode")
    require(
        runner.plan(spec) == episode,
        f"plans another episode for spec {spec.id} the second time; wanted the same: draw everything from "
        "spec.rng(purpose), and keep no state between plans",
    )
    require(episode.spec == spec, f"plans an episode of spec {episode.spec} for {spec}; wanted spec=spec")
    require(
        dataclasses.replace(other, spec=spec) != episode,
        f"plans the same episode for specs {spec.id} and {other.spec.id}; wanted different ones: spec.rng depends on "
        "the index",
    )
    _through_json(episode.as_json(), "an episode")
    missing, has = sorted(set(task.strata) - set(episode.stratum)), sorted(episode.stratum) or "none"
    wanted = "wanted those keys in Episode.stratum"
    require(not missing, f"reports the strata {missing}, but its episode has {has}; {wanted}")
    labels = runner.env.reset(options={"episode": episode})[1]["instances"]["labels"]  # also checks the scene's hash
    require(
        runner.env.place.ground.is_free(np.array(episode.start)) and math.isfinite(episode.yaw),
        f"starts at {episode.start}, yaw {episode.yaw}; wanted a point on which the body can stand "
        "(place.ground.sample(rng)) and a finite yaw",
    )
    try:
        meant = matching(parse_query(episode.query, {thing.category for thing in labels}), labels)
    except QueryError as error:
        raise AssertionError(f"the task asks for something that is not in the scene: {error}") from error
    require(
        tuple(sorted(episode.targets)) == tuple(meant),
        f"asks for {episode.query!r}, which means things {meant}, but has the targets {episode.targets}; wanted the "
        "same: place.nameable() lists the queries with a unique target",
    )
    return episode


def _check_path(task: SimTask, runner: Runner, episode: Episode) -> None:
    """The path ends, is reproducible and, unless walked, independent of the answers; and the truth is true."""
    (poses, truths), (again, _), (opposite, _) = (_play(runner, episode, sign) for sign in (1.0, 1.0, -1.0))
    require(
        np.array_equal(poses, again),
        "takes another path when the same episode is played again; wanted the same: draw from episode.spec.rng(...)",
    )
    require(
        task.walked or np.array_equal(poses, opposite),
        "takes another path when other answers are given; wanted the same for all answers, so that all estimators get "
        "the same evidence. If the answer is meant to steer the body, set walked=True",
    )
    off = []
    for number, truth in enumerate(truths):
        if not truth["present"]:
            continue
        direction, says = np.asarray(truth["direction"], dtype=np.float64), f"says at step {number} that the target"
        unit = direction.shape == (3,) and abs(float(np.linalg.norm(direction)) - 1) < 1e-6
        require(unit, f"{says} lies in direction {direction}; wanted a unit vector, body frame")
        require(0 < truth["distance"] < math.inf, f"{says} is {truth['distance']} m away; wanted metres above 0")
        if truth["visible"] and len(truth["pixels"]):
            off.append(float(np.min(angular_distance(truth["pixels"], direction))))
    off_deg = math.degrees(float(np.median(off))) if off else 0.0
    require(
        off_deg <= NEAR_DEG,
        f"says that the target lies {off_deg:.0f} degrees (median) from the nearest pixel that shows it; wanted at "
        f"most {NEAR_DEG:g}: true directions are world_R_body.T @ (point - position), body frame",
    )


def _play(runner: Runner, episode: Episode, sign: float) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """The poses ``(n, 7)`` and the truth of each step if the answer (or heading) is `sign` times the true direction.

    "pixels" in the truth: the directions ``(k, 3)`` of those that show the target.
    """
    observation, info = runner.env.reset(options={"episode": episode})
    poses, truths, over = [], list[dict[str, Any]](), False
    while True:
        ids = info["instances"]["ids"]
        pixels = ErpGrid(*ids.shape).directions[np.isin(ids, episode.targets)]
        poses.append(observation["pose"])
        truths.append(info["truth"] | {"pixels": pixels})
        if over:
            return np.array(poses), truths
        require(len(poses) < STEPS, f"has not ended after {STEPS} steps; wanted terminated or truncated before that")
        direction = sign * np.asarray(info["truth"]["direction"])
        action: Any = direction.astype(np.float32)
        if runner.task.walked:
            action = np.array([math.atan2(direction[1], direction[0]), runner.camera.step])
        observation, reward, terminated, truncated, info = runner.env.step(action)
        require(math.isfinite(reward), f"gives the reward {reward} at step {len(poses)}; wanted a finite number")
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


def _check_figures(task: SimTask, runner: Runner, episode: Episode) -> dict[str, Any]:
    """There are figures for every metric, and better answers get better figures."""
    if task.walked:
        return _checked(task, runner.run_episode(episode.spec, [ORACLE])["methods"][ORACLE])["metrics"]
    rollout = runner.record(episode)
    right, wrong = (_checked(task, runner.score(rollout, _Known(sign * rollout.directions))) for sign in (1.0, -1.0))
    for metric in task.metrics:
        good, bad = metric.of(right), metric.of(wrong)
        if metric.better is None or good is None or bad is None:
            continue
        require(
            good <= bad if metric.better == "low" else good >= bad,
            f"gives an estimator that is always right {good:g} in the metric {metric.key}, and one that is always "
            f"wrong {bad:g}, though {metric.better} is better; wanted the reverse: change `better`, or measure()",
        )
    return right["metrics"]


def _checked(task: SimTask, result: dict[str, Any]) -> dict[str, Any]:
    """`result`, which has a plain figure for every metric."""
    figures = result["metrics"]
    for key, value in figures.items():
        plain = value is None or (isinstance(value, int | float) and math.isfinite(value))
        require(plain, f"measures {key} = {value!r}; wanted a finite number, or None if it does not apply")
    wanted = {metric.key for metric in task.metrics if metric.read is None} | set(WALKED if task.walked else ())
    missing = sorted(wanted - figures.keys())
    require(not missing, f"measures {', '.join(figures)}; wanted also {', '.join(missing)}, which its table shows")
    for metric in task.metrics:
        value = metric.of(result)
        require(
            not metric.share or value in (0, metric.scale, None),
            f"measures {value} in the metric {metric.key}, which is a share; wanted 0 or 1 per episode, or share=False",
        )
    return result
