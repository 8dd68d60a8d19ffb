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
from eagor.lab.agents.methods import ORACLE
from eagor.lab.envs.episodes import Episode, Slot
from eagor.lab.envs.places import APARTMENT, Place, load_place
from eagor.lab.envs.rules import Camera, Disturbances, as_dict, from_dict
from eagor.lab.tasks.sim.play import Player
from eagor.lab.tasks.sim.task import SimTask
from eagor.queries import matching, parse_query
from eagor.sphere import angular_distance

PERCEPTION = "truth:ideal"  # without mistakes
STEPS = 5000  # an episode that has not ended by then counts as endless
WALKED = ("success", "spl", "mae")  # figures that reports need of walked tasks
CLOSE = 1e-6
NEAR_DEG = 20.0  # from the direction of the target's middle to the nearest of its pixels


def check_simulation(
    task: SimTask, world: str = APARTMENT, seed: int = 0, index: int = 0, settings: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Raise `AssertionError` unless `task` keeps the contract on one episode; returns the figures of a perfect method.

    The episode is the `index`-th of the scene that `world` makes of `seed`; `settings` override rules. The same slot
    must always give the same episode; answers must not change the camera's path (unless the task is walked); the truth
    must be true; and better answers must score better.
    """
    _check_description(task)
    rules = _check_rules(task, dict(settings or {}))
    config = {"task": task.name, "perception": PERCEPTION, "camera": as_dict(Camera()), "rows": 32}
    config |= {"rules": as_dict(rules), "disturbances": as_dict(Disturbances())}
    player = Player(config, kind=task)
    episode = _check_plan(task, player, Slot(task.name, world, seed, index, index))
    place = load_place(world, seed, player.camera.radius)
    _check_start(episode, place, player)
    _check_way(task, player, episode)
    found = _check_figures(task, player, episode)
    for key in task.strata:
        _require(
            key in episode.stratum,
            f"reports the stratum {key!r}, but its episode has {sorted(episode.stratum) or 'none'}; wanted that key in "
            "Episode.stratum",
        )
    return found


def _check_description(task: SimTask) -> None:
    """Check the name and the metrics."""
    _require(isinstance(task, SimTask), f"is a {type(task).__name__}; wanted an eagor.lab.tasks.sim.task.SimTask")
    _require(
        bool(re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", task.name)),
        f"is called {task.name!r}; wanted lower-case letters and digits with dashes between them: it is typed, and "
        "used as a folder name",
    )
    keys = [metric.key for metric in task.metrics]
    _require(bool(keys) and len(set(keys)) == len(keys), f"has the metrics {keys}; wanted at least one, each key once")
    _require(task.headline in keys, f"has the headline {task.headline!r}; wanted one of its metrics, {', '.join(keys)}")
    for metric in task.metrics:
        said = f"says that {metric.better!r} is better in the metric {metric.key}; wanted 'low', 'high' or None"
        _require(metric.better in ("low", "high", None), said)


def _check_rules(task: SimTask, settings: dict[str, Any]) -> Any:
    """Check that the rules can be made without arguments, written and read."""
    kind = task.rules
    frozen = dataclasses.is_dataclass(kind) and getattr(kind, "__dataclass_params__").frozen  # noqa: B009 (for pyright)
    _require(frozen, f"has rules of type {kind.__name__}; wanted a frozen dataclass")
    try:
        rules = kind(**settings)
        back = from_dict(kind, json.loads(json.dumps(as_dict(rules), allow_nan=False)))
    except (TypeError, ValueError) as error:
        raise AssertionError(
            f"the task {task.name} has rules that cannot be made, written and read again: {error}. Wanted a default "
            "for each, and numbers, texts, booleans and tuples of them"
        ) from error
    said = f"has the rules {rules}, which JSON turns into {back}; wanted plain values and tuples"
    _require(back == rules, said)
    return rules


def _check_plan(task: SimTask, player: Player, slot: Slot) -> Episode:
    """Check that a slot always gives the same episode, whatever was planned before, and other slots other ones."""
    episode, other = player.plan(slot), player.plan(dataclasses.replace(slot, index=slot.index + 1))
    _require(isinstance(episode, Episode), f"plans a {type(episode).__name__}; wanted an eagor.lab.envs.Episode")
    _require(
        player.plan(slot) == episode,
        f"plans another episode for slot {slot.id} the second time; wanted the same: draw everything from "
        "slot.rng(purpose), and keep no state between plans",
    )
    _require(episode.slot == slot, f"plans an episode of slot {episode.slot} for {slot}; wanted slot=slot")
    _require(
        dataclasses.replace(other, slot=slot) != episode,
        f"plans the same episode for slots {slot.id} and {other.slot.id}; wanted different ones: slot.rng depends on "
        "the index",
    )
    try:
        json.dumps(episode.as_json(), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise AssertionError(
            f"the task {task.name} plans an episode that JSON cannot write ({error}); wanted plain numbers, texts and "
            "tuples in it: float(x), not NumPy's"
        ) from error
    return episode


def _check_start(episode: Episode, place: Place, player: Player) -> None:
    """Check that the body can stand at the start, and that the target exists."""
    made = place.scene.hash
    said = f"plans in scene {episode.scene_hash}, and the world makes {made}; wanted place.scene.hash"
    _require(episode.scene_hash == made, said)
    _require(
        bool(place.ground.is_free(np.array(episode.start))) and math.isfinite(episode.yaw),
        f"starts at {episode.start}, yaw {episode.yaw}; wanted a point on which the body can stand "
        "(place.ground.sample(rng)) and a finite yaw",
    )
    labels = player.env.reset(options={"episode": episode})[1]["instances"]["labels"]
    try:
        meant = matching(parse_query(episode.query, {thing.category for thing in labels}), labels)
    except QueryError as error:
        raise AssertionError(f"the task asks for something that is not in the scene: {error}") from error
    _require(
        tuple(sorted(episode.targets)) == tuple(meant),
        f"asks for {episode.query!r}, which means things {meant}, but has the targets {episode.targets}; wanted the "
        "same: place.nameable() lists the queries with a unique target",
    )


def _check_way(task: SimTask, player: Player, episode: Episode) -> None:
    """Check that the path ends, is reproducible and, unless walked, independent of the answers; and check the truth."""
    first = _played(player, episode, 1.0)
    _require(
        _same_way(first, _played(player, episode, 1.0)),
        "takes another path when the same episode is played again; wanted the same: draw from episode.slot.rng(...)",
    )
    _require(
        task.walked or _same_way(first, _played(player, episode, -1.0)),
        "takes another path when other answers are given; wanted the same for all answers, so that all methods get "
        "the same evidence. If the answer is meant to steer the body, set walked=True",
    )
    off = []
    for number, (_, truth, ids) in enumerate(first):
        if not truth["present"]:
            continue
        direction = np.asarray(truth["direction"], dtype=np.float64)
        said = f"says at step {number} that the target"
        unit = direction.shape == (3,) and abs(float(np.linalg.norm(direction)) - 1) < CLOSE
        _require(unit, f"{said} lies in direction {direction}; wanted a unit vector, body frame")
        _require(0 < truth["distance"] < math.inf, f"{said} is {truth['distance']} m away; wanted metres above 0")
        shown = np.isin(ids, episode.targets)
        if truth["visible"] and shown.any():
            seen = ErpGrid(*ids.shape).directions[shown]
            off.append(math.degrees(float(np.min(angular_distance(seen, direction)))))
    _require(
        not off or float(np.median(off)) <= NEAR_DEG,
        f"says that the target lies {np.median(off) if off else 0:.0f} degrees (median) from the nearest pixel that "
        f"shows it; wanted at most {NEAR_DEG:g}: true directions are world_R_body.T @ (point - position), body frame",
    )


_Step = tuple[np.ndarray, dict[str, Any], np.ndarray]  # pose, truth and ids from the environment


def _same_way(a: list[_Step], b: list[_Step]) -> bool:
    return len(a) == len(b) and all(np.array_equal(x[0], y[0]) for x, y in zip(a, b, strict=True))


def _played(player: Player, episode: Episode, sign: float) -> list[_Step]:
    """The steps of an episode in which the answer (walked: the heading) is `sign` times the true direction."""
    observation, info = player.env.reset(options={"episode": episode})
    found, over = [(observation["pose"], info["truth"], info["instances"]["ids"])], False
    while not over:
        _require(len(found) <= STEPS, f"has not ended after {STEPS} steps; wanted terminated or truncated before that")
        direction = sign * np.asarray(info["truth"]["direction"])
        action: Any = direction.astype(np.float32)
        if player.task.walked:
            action = np.array([math.atan2(direction[1], direction[0]), player.camera.step])
        observation, reward, terminated, truncated, info = player.env.step(action)
        _require(math.isfinite(reward), f"gives the reward {reward} at step {len(found)}; wanted a finite number")
        found.append((observation["pose"], info["truth"], info["instances"]["ids"]))
        over = terminated or truncated
    return found


class _Known:
    """A method that is given the true directions, and answers with `sign` times them."""

    def __init__(self, directions: np.ndarray, sign: float) -> None:
        self._answers = iter(sign * directions)

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        self._answer = next(self._answers)

    def see(self, evidence: Any) -> None:
        pass

    def direction(self) -> np.ndarray:
        return self._answer

    def mass_above(self, direction: np.ndarray) -> float | None:
        return 0.0 if float(self._answer @ direction) > 0 else 1.0

    def distance(self) -> float | None:
        return None


def _check_figures(task: SimTask, player: Player, episode: Episode) -> dict[str, Any]:
    """Check that there are figures for every metric, and that better answers get better figures."""
    if task.walked:
        found = player.play(episode.slot, [ORACLE])["methods"][ORACLE]["metrics"]
        _check_metrics(task, found)
        return found
    recording = player.record(episode)
    right, wrong = (player.judge(recording, _Known(recording.directions, sign))["metrics"] for sign in (1.0, -1.0))
    for metrics in (right, wrong):
        _check_metrics(task, metrics)
    for metric in task.metrics:
        good, bad = metric.of({"metrics": right}), metric.of({"metrics": wrong})
        if metric.better is None or good is None or bad is None:
            continue
        _require(
            good <= bad if metric.better == "low" else good >= bad,
            f"gives a method that is always right {good:g} in the metric {metric.key}, and one that is always wrong "
            f"{bad:g}, though {metric.better} is better; wanted the reverse: change `better`, or measure()",
        )
    return right


def _check_metrics(task: SimTask, found: dict[str, Any]) -> None:
    """Check that every metric has a plain figure."""
    for key, value in found.items():
        plain = value is None or (isinstance(value, int | float) and math.isfinite(value))
        _require(plain, f"measures {key} = {value!r}; wanted a finite number, or None if it does not apply")
    wanted = {metric.key for metric in task.metrics if metric.read is None} | set(WALKED if task.walked else ())
    missing = sorted(wanted - found.keys())
    _require(not missing, f"measures {', '.join(found)}; wanted also {', '.join(missing)}, which its table shows")
    for metric in task.metrics:
        value = metric.of({"metrics": found})
        _require(
            not metric.share or value in (0, metric.scale, None),
            f"measures {value} in the metric {metric.key}, which is a share; wanted 0 or 1 per episode, or share=False",
        )


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(f"the task {text}")
