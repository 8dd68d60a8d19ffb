"""The test that every simulated task has to pass: what makes figures comparable."""

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
from eagor.queries import matching, parse_query
from eagor.sphere import angular_distance
from eagor.tasks.episodes import Episode, Slot
from eagor.tasks.methods import ORACLE
from eagor.tasks.places import APARTMENT, Place, load_place
from eagor.tasks.play import Player
from eagor.tasks.rules import Camera, Disturbances, as_dict, from_dict
from eagor.tasks.task import Task

PERCEPTION = "truth:ideal"  # sees what is there, without mistakes
STEPS = 5000  # an episode that has not ended by then never does
WALKED = ("success", "spl", "mae")  # figures that reports read of tasks that are walked
CLOSE = 1e-6
NEAR_DEG = 20.0  # from the true direction (of the middle of the target) to the nearest pixel of it


def check_task(
    task: Task, world: str = APARTMENT, seed: int = 0, index: int = 0, settings: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Raise `AssertionError` unless `task` keeps the contract on one episode; returns the figures of a perfect method.

    The episode is the `index`-th of the scene that `world` makes of `seed`; `settings` are rules other than the
    defaults. A slot must always be the same episode, the camera go its way whatever is answered (unless walked), the
    truth be true, and better answers score better.
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
            f"reports the stratum {key!r}, and its episode has {sorted(episode.stratum) or 'none'}; wanted that key in "
            "Episode.stratum",
        )
    return found


def _check_description(task: Task) -> None:
    """A task whose name can be typed, with columns that can be told apart."""
    _require(isinstance(task, Task), f"is a {type(task).__name__}; wanted an eagor.tasks.task.Task")
    _require(
        bool(re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", task.name)),
        f"is called {task.name!r}; wanted lower-case letters and digits with dashes between them: it is typed, and "
        "names folders",
    )
    keys = [column.key for column in task.columns]
    _require(bool(keys) and len(set(keys)) == len(keys), f"has the columns {keys}; wanted one at least, each key once")
    _require(task.headline in keys, f"has the headline {task.headline!r}; wanted one of its columns, {', '.join(keys)}")
    for column in task.columns:
        said = f"says that {column.better!r} is better in the column {column.key}; wanted 'low', 'high' or None"
        _require(column.better in ("low", "high", None), said)


def _check_rules(task: Task, settings: dict[str, Any]) -> Any:
    """Rules that can be made without arguments, printed, written and read."""
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
    said = f"has the rules {rules}, which come back from JSON as {back}; wanted plain values and tuples"
    _require(back == rules, said)
    return rules


def _check_plan(task: Task, player: Player, slot: Slot) -> Episode:
    """The same slot is the same episode, whatever was planned before; another one is another."""
    episode, other = player.plan(slot), player.plan(dataclasses.replace(slot, index=slot.index + 1))
    _require(isinstance(episode, Episode), f"plans a {type(episode).__name__}; wanted an eagor.tasks.episodes.Episode")
    _require(
        player.plan(slot) == episode,
        f"plans another episode for slot {slot.id} the second time; wanted the same: draw everything from "
        "slot.rng(purpose), nothing from what was planned before",
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
    """Somebody can stand where it starts, and what is asked for is there."""
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
        raise AssertionError(f"the task asks for something that is not there: {error}") from error
    _require(
        tuple(sorted(episode.targets)) == tuple(meant),
        f"asks for {episode.query!r}, which is things {meant}, and has the targets {episode.targets}; wanted the same: "
        "place.nameable() tells what a query singles out",
    )


def _check_way(task: Task, player: Player, episode: Episode) -> None:
    """It ends, is the same each time, and, unless it is walked, whatever is answered; the truth is true."""
    first = _played(player, episode, 1.0)
    _require(
        _same_way(first, _played(player, episode, 1.0)),
        "goes another way when the same episode is played again; wanted the same: draw from episode.slot.rng(...)",
    )
    _require(
        task.walked or _same_way(first, _played(player, episode, -1.0)),
        "goes another way when other answers are given; wanted the same whatever is answered, so that all methods "
        "get the same evidence. If the answer is to decide where the body goes, say walked=True",
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


_Step = tuple[np.ndarray, dict[str, Any], np.ndarray]  # the pose, the truth and the ids that the environment shows


def _same_way(a: list[_Step], b: list[_Step]) -> bool:
    return len(a) == len(b) and all(np.array_equal(x[0], y[0]) for x, y in zip(a, b, strict=True))


def _played(player: Player, episode: Episode, sign: float) -> list[_Step]:
    """The steps of an episode in which `sign` times the true direction is answered (walked: gone along)."""
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


class _Told:
    """A method that is told the true directions, and answers them times `sign`."""

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


def _check_figures(task: Task, player: Player, episode: Episode) -> dict[str, Any]:
    """Figures for every column, and the better the answers the better the figures."""
    if task.walked:
        found = player.play(episode.slot, [ORACLE])["methods"][ORACLE]["metrics"]
        _check_metrics(task, found)
        return found
    recording = player.record(episode)
    right, wrong = (player.judge(recording, _Told(recording.directions, sign))["metrics"] for sign in (1.0, -1.0))
    for metrics in (right, wrong):
        _check_metrics(task, metrics)
    for column in task.columns:
        good, bad = right[column.metric], wrong[column.metric]
        if column.better is None or good is None or bad is None:
            continue
        _require(
            good <= bad if column.better == "low" else good >= bad,
            f"gives a method that is always right {good:g} in the column {column.key}, and one that is always wrong "
            f"{bad:g}, though {column.better} is better; wanted it the other way round: turn `better`, or measure()",
        )
    return right


def _check_metrics(task: Task, found: dict[str, Any]) -> None:
    """Plain figures, one for every column."""
    for key, value in found.items():
        plain = value is None or (isinstance(value, int | float) and math.isfinite(value))
        _require(plain, f"measures {key} = {value!r}; wanted a finite number, or None where there is no case")
    wanted = [column.metric for column in task.columns] + [c.only_if for c in task.columns if c.only_if]
    missing = sorted({*wanted, *(WALKED if task.walked else ())} - found.keys())
    _require(not missing, f"measures {', '.join(found)}; wanted also {', '.join(missing)}, which its table shows")
    for column in task.columns:
        _require(
            not column.share or found[column.metric] in (0, 1, None),
            f"measures {column.metric} = {found[column.metric]}, whose column {column.key} is a share; wanted 0 or 1 "
            "per episode, or share=False",
        )


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(f"the task {text}")
