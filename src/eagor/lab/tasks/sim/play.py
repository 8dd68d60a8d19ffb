"""Plays an episode: every method on the same responses, with a record of the results.

Waypoint and tracking episodes are open loop. In navigation each method plays alone, with mistakes of the same seed.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor import metrics
from eagor.conventions import rotation_from_wxyz, wxyz_from_rotation
from eagor.evidence import Evidence
from eagor.lab.agents.methods import BASE, ORACLE, Method, Steers, answer_at, method_for
from eagor.lab.agents.models import Delay, EpisodePerception, is_privileged, shared
from eagor.lab.agents.search_space import Chance, SteeringInput, along_floor
from eagor.lab.agents.steering import seeking, steering_for
from eagor.lab.envs.episodes import Episode, FileSlot, Slot
from eagor.lab.envs.places import in_view, mask_of
from eagor.lab.envs.rules import Camera, Disturbances, from_dict
from eagor.lab.tasks.task import load
from eagor.perception.calibrated import from_json
from eagor.sphere import azimuth_elevation

if TYPE_CHECKING:
    from eagor.lab.envs.place_env import Picture, PlaceEnv

STANDS = 1e-6  # metres of a step in which the body only turns: no metres at all would call stop
MASS = 0.9  # of the credible regions whose coverage is measured


@dataclass(frozen=True, eq=False)
class Played:
    """The results of one method in one episode of n steps, for `SimTask.measure` (`eagor.lab.tasks.sim.task`).

    - `truth`: lists of n values: pose, azimuth_deg, elevation_deg, range_m, visible, present, optionally leg. For a
      walked task they are in `trace`, with the prefix true_.
    - `trace`: lists of n values: azimuth_deg, elevation_deg, error_deg (None while the target is away), mass_above,
      inside, distance_m.
    - `directions`, `estimates` ``(n, 3)``: the true ones (held while the target is away) and the method's, body frame.
    - `rotations` ``(n - 1, 3, 3)``, `translations` ``(n - 1, 3)``: the camera's true motions
      (`eagor.metrics.ego_motion`).
    - `info`: the environment's last one; metres `walked` and `shortest`. Only for a walked task.
    """

    truth: dict[str, list[Any]]
    trace: dict[str, list[Any]]
    directions: np.ndarray
    estimates: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray
    rules: Any
    camera: Camera
    info: Mapping[str, Any] = field(default_factory=dict)
    walked: float = 0.0
    shortest: float = math.inf

    @property
    def coverage(self) -> float | None:
        """The share of steps with the truth inside the stated 90 % region; None for methods without regions."""
        inside = [value for value in self.trace["inside"] if value is not None]
        return metrics.credible_coverage(inside) if inside else None


@dataclass(frozen=True, eq=False)
class Moment:
    """One step of an open-loop episode: pose by odometry, evidence that arrives, and that of the `other` query.

    `picture`: as in `Seen`; None unless somebody watches, since recordings are kept in files.
    """

    stamp: float
    world_R_body: np.ndarray
    position: np.ndarray
    evidence: Evidence | None
    other: Evidence | None = None
    picture: Picture | None = None


@dataclass(frozen=True, eq=False)
class Seen:
    """One step for whoever watches a method play: the `method` after its answer, and what it was given.

    `picture` renders what the camera shows, with so many rows as it is asked for, whatever the perception looked at;
    `pose` ``(7,)`` by odometry: x, y, z (metres) and a quaternion (w, x, y, z), world_R_body; `evidence` that arrived;
    `truth` ``(3,)``: the true direction in the body frame, None while the target is away.
    """

    stamp: float
    method: Method | None
    picture: Picture
    pose: np.ndarray
    evidence: Evidence | None
    truth: np.ndarray | None

    @property
    def position(self) -> np.ndarray:
        """By odometry, metres ``(3,)``."""
        return self.pose[:3]


Watch = Callable[[Seen], object]


@dataclass(frozen=True, eq=False)
class Recording:
    """An open-loop episode of n steps.

    `truth`: lists for the record; `directions` ``(n, 3)``: to the target, body frame (held while away); `rotations`,
    `translations`: the camera's true motions; `looked`: metadata and cost of the perception.
    """

    episode: Episode
    truth: dict[str, list[Any]]
    moments: tuple[Moment, ...]
    directions: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray
    looked: dict[str, Any] | None = None


class Player:
    """Plays the episodes of one run.

    `config`: task, perception, rules, camera, disturbances (JSON of `eagor.lab.envs.rules`), rows of the panorama, and
    optionally calibrated and episodes_file. `perception` and `kind` (the task): the objects, if they exist already.
    """

    def __init__(self, config: dict[str, Any], perception: Any = None, kind: Any = None) -> None:
        if perception is None:
            perception = shared(config["perception"])
        self.config = config
        self.task: Any = kind or load(config["task"])
        self.perception = perception
        self.camera = from_dict(Camera, config["camera"])
        self.disturbances = from_dict(Disturbances, config["disturbances"])
        self.rules: Any = from_dict(self.task.rules, config["rules"])
        self.ours = BASE
        if given := config.get("calibrated"):
            found = from_json(given, "the run's calibration")
            self.ours = BASE.fitted(found.calibration, found.detector, found.forgetting)
        self.ours = seeking(self.rules, self.ours)
        rows = None if is_privileged(perception) else int(config["rows"])
        self.env: PlaceEnv = self.task.environment(
            rules=self.rules, camera=self.camera, disturbances=self.disturbances, panorama=rows
        )

    def plan(self, slot: Slot) -> Episode:
        """The episode of this slot."""
        if isinstance(slot, FileSlot) and self.task.listed is not None:
            return self.task.listed(slot, self.config["episodes_file"], self.camera, self.rules)
        return self.env.plan(slot)

    def play(self, slot: Slot, names: list[str], watch: Watch | None = None) -> dict[str, Any]:
        """The record of one episode: its description, the truth, and each method's metrics and trace.

        `watch` is called after each answer of each method.
        """
        episode = self.plan(slot)
        body: dict[str, Any] = {"task": self.task.name, "episode": episode.as_json()}
        if self.task.walked:
            return body | {"methods": {name: self._walk(episode, name, watch) for name in names}}
        recording = self.record(episode, watched=watch is not None)
        judged = {name: self.judge(recording, self.method(name, slot), watch=watch) for name in names}
        looked = {"looked": recording.looked} if recording.looked else {}
        return body | looked | {"truth": recording.truth, "methods": judged}

    def method(self, name: str, slot: Slot) -> Steers:
        """A new method of this name, configured for this perception."""
        return method_for(name, self.perception, self.config["perception"], slot.rng("method"), self.ours)

    def _begin(self, episode: Episode) -> tuple[dict, dict, EpisodePerception]:
        observation, info = self.env.reset(options={"episode": episode})
        return observation, info, EpisodePerception(self.perception, episode.slot, info["instances"]["labels"])

    def _look(self, eye: EpisodePerception, observation: dict, info: dict, query: str = "") -> Evidence | None:
        """The evidence of this step, stamped with the time of capture; None if an answer could not be read."""
        found = eye.look(observation, info, info["num_steps"] * self.camera.seconds, query)
        mask = mask_of(self.camera)
        return found if found is None or mask is None else found.covered(mask)

    def _walk(self, episode: Episode, name: str, watch: Watch | None) -> dict[str, Any]:
        """One method through one episode in which it steers the body."""
        observation, info, eye = self._begin(episode)
        method = None if name == ORACLE else self.method(name, episode.slot)
        trace: dict[str, list[Any]] = defaultdict(list)
        steering = steering_for(self.rules, self.camera)
        delay = Delay(self.disturbances.latency)
        directions, said, poses, places, over = [], [], [], [], False
        path = [self._feet()]
        while not over:
            look = self._look(eye, observation, info)
            due = delay.due(look)
            stamp, pose = info["num_steps"] * self.camera.seconds, observation["pose"]
            direction = info["truth"]["direction"] if method is None else answer_at(method, stamp, pose, due)
            directions.append(info["truth"]["direction"])
            said.append(direction)
            poses.append(info["truth"]["world_R_body"])
            places.append(info["truth"]["position"])
            _note_truth(trace, info, "true_")
            _note_answer(trace, method, direction, directions[-1])
            if watch is not None:
                watch(Seen(stamp, method, self.env.picture(), pose, due, directions[-1]))
            now = self._steering_input(direction, method, look, pose, info, steering.looks_down)
            turn, metres = steering.walk(now)
            if steering.looks_down:
                trace["searching"].append(steering.searching)
            metres = 0.0 if steering.arrived else max(metres, STANDS)
            observation, _, terminated, truncated, info = self.env.step(np.array([turn, metres]))
            path.append(self._feet())
            over = terminated or truncated
        motion = metrics.ego_motion(np.array(poses), np.array(places))
        played = Played(
            trace, trace, np.array(directions), np.array(said), *motion, self.rules, self.camera, info,
            self.env.body.walked, episode.shortest,
        )  # fmt: skip
        found, looked = _rounded(self.task.measure(played)), eye.account()
        walked = {"path": path} if isinstance(episode.slot, FileSlot) else {}  # to be judged by habitat-lab, too
        return {"metrics": found, "trace": dict(trace)} | walked | ({"looked": looked} if looked else {})

    def _steering_input(
        self, direction: np.ndarray, method: Steers | None, look: Evidence | None, pose: np.ndarray, info: dict,
        looks_down: bool,
    ) -> SteeringInput:  # fmt: skip
        """What steers the body at a step; only a policy that `looks_down` gets the floor, and what is believed."""
        true, ids = info["truth"], info["instances"]["ids"]
        believing = method if looks_down else None  # the oracle is sure
        return SteeringInput(
            azimuth=float(azimuth_elevation(direction)[0]),
            progress=1.0 if believing is None else believing.progress(),
            presence=1.0 if believing is None else believing.presence(),
            distance=along_floor(true["distance"] if method is None else method.sure_distance(), direction),
            position=np.array([*pose[:2], self.camera.height]),
            world_R_body=rotation_from_wxyz(pose[3:]),
            floor=self.env.place.floor_in(ids, true["position"], true["world_R_body"]) if looks_down else None,
            seen=in_view(self.camera, len(ids)),
            chance=Chance.of(look, self.camera.seconds) if look is not None and looks_down else None,
        )

    def _feet(self) -> list[float]:
        """Where the body stands: x, y, z."""
        return [round(float(value), 9) for value in (*self.env.body.xy, self.env.body.floor)]

    def record(self, episode: Episode, other: str = "", watched: bool = False) -> Recording:
        """An episode that is not walked, as every method gets it; `other`: a second query; `watched`: with pictures."""
        observation, info, eye = self._begin(episode)
        second = EpisodePerception(self.perception, episode.slot, info["instances"]["labels"], "other")
        truth: dict[str, list[Any]] = defaultdict(list)
        moments, directions, poses, places = [], [], [], []
        delay, over = Delay(self.disturbances.latency), False
        while True:
            due = delay.due(self._look(eye, observation, info))
            true, pose = info["truth"], observation["pose"]
            stamp = info["num_steps"] * self.camera.seconds
            also = self._look(second, observation, info, other) if other else None
            picture = self.env.picture() if watched else None
            moments.append(Moment(stamp, rotation_from_wxyz(pose[3:]), pose[:3], due, also, picture))
            _note_truth(truth, info, "")
            truth["present"].append(bool(true["present"]))
            if "leg" in info:
                truth["leg"].append(info["leg"])
            directions.append(true["direction"] if true["present"] else directions[-1])
            poses.append(true["world_R_body"])
            places.append(true["position"])
            if over:
                break
            observation, _, terminated, truncated, info = self.env.step(directions[-1])
            over = terminated or truncated
        true_directions = np.array(directions)
        truth["seam"] = metrics.seam_crossings(true_directions).tolist()
        motion = metrics.ego_motion(np.array(poses), np.array(places))
        return Recording(episode, dict(truth), tuple(moments), true_directions, *motion, eye.account() or None)

    def judge(
        self, recording: Recording, method: Method, regions: bool = True, watch: Watch | None = None
    ) -> dict[str, Any]:
        """The metrics and trace of a method on a recorded episode.

        Without `regions`, coverage and distance are left out, which saves half of the time.
        """
        trace: dict[str, list[Any]] = defaultdict(list)
        said = []
        for index, moment in enumerate(recording.moments):
            method.move(moment.stamp, moment.world_R_body, moment.position)
            if moment.evidence is not None:
                method.see(moment.evidence)
            said.append(method.direction())
            true = recording.directions[index] if recording.truth["present"][index] else None
            _note_answer(trace, method if regions else None, said[-1], true)
            if watch is not None and moment.picture is not None:
                pose = np.array([*moment.position, *wxyz_from_rotation(moment.world_R_body)])
                watch(Seen(moment.stamp, method, moment.picture, pose, moment.evidence, true))
        played = Played(
            recording.truth, trace, recording.directions, np.array(said), recording.rotations, recording.translations,
            self.rules, self.camera,
        )  # fmt: skip
        return {"metrics": _rounded(self.task.measure(played)), "trace": dict(trace)}


def _note_truth(trace: dict[str, list[Any]], info: dict, prefix: str) -> None:
    true = info["truth"]
    pose = [*true["position"], *wxyz_from_rotation(true["world_R_body"])]
    trace["pose"].append([round(float(value), 5) for value in pose])
    azimuth, elevation = azimuth_elevation(true["direction"])
    trace[f"{prefix}azimuth_deg"].append(round(math.degrees(float(azimuth)), 2))
    trace[f"{prefix}elevation_deg"].append(round(math.degrees(float(elevation)), 2))
    trace[f"{prefix}range_m"].append(round(float(true["distance"]), 3))
    trace["visible"].append(bool(true["visible"]))


def _note_answer(
    trace: dict[str, list[Any]], method: Method | None, direction: np.ndarray, true: np.ndarray | None
) -> None:
    """Append the answer, and its error (None while the target is away)."""
    azimuth, elevation = azimuth_elevation(direction)
    trace["azimuth_deg"].append(round(math.degrees(float(azimuth)), 2))
    trace["elevation_deg"].append(round(math.degrees(float(elevation)), 2))
    error = None if true is None else float(metrics.angular_error_deg(direction, true))
    mass = None if true is None or method is None else method.mass_above(true)
    distance = method.distance() if method is not None else None
    trace["error_deg"].append(None if error is None else round(error, 3))
    trace["mass_above"].append(None if mass is None else round(mass, 4))
    trace["inside"].append(None if mass is None else bool(mass < MASS))
    trace["distance_m"].append(None if distance is None else round(distance, 3))


def _rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: round(value, 7) if isinstance(value, float) else value for key, value in values.items()}
