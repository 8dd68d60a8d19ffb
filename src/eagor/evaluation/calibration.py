"""Fitting how the looks of a perception are read, and how its targets come to move, by log score.

Development episodes are recorded once: poses, and looks for two queries, one of which nothing there answers. A trial
reads them with other settings; its score (nats) is the log density given to the true direction plus the log of the
probability given to the truth about presence, which only honest beliefs maximise (Good, 1952). `READING` and
`DETECTING` are the numbers of response maps and detections, `MOVING` those of `MotionModel`; what can be counted is
`counted`. `eagor.evaluation.fitting` searches.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eagor._files import written
from eagor.errors import EagorError, QueryError, WorldError
from eagor.evaluation.detector_em import expected_look_alikes, short
from eagor.evaluation.detector_fit import fitted_model
from eagor.evaluation.labelled_looks import LabelledLook
from eagor.evidence import Evidence
from eagor.evidence.detector import DetectorModel
from eagor.metrics import angular_error_deg
from eagor.perception import load, rows_of
from eagor.sphere import FORWARD
from eagor.tasks import task as tasks
from eagor.tasks.episodes import Slot
from eagor.tasks.models import is_privileged
from eagor.tasks.places import APARTMENT, DEVELOPMENT, load_place
from eagor.tasks.play import MASS, Player, Recording
from eagor.tasks.rules import Camera, Disturbances, as_dict
from eagor.tasks.tracking import TrackingEpisode
from eagor.tracking.config import TrackerConfig
from eagor.tracking.motion import MotionModel
from eagor.tracking.tracker import DirectionTracker
from eagor.worlds.render import PAINTS

TASKS = ("waypoint", "tracking")
PER_PLACE = 2  # episodes of each task in an apartment: many apartments tell more than many episodes in one
EVERY = 3  # steps between the readings that are scored: neighbours say nearly the same
SMALLEST = 1e-9  # a probability of presence below it counts as this


@dataclass(frozen=True)
class Parameter:
    """One number of the fit: drawn evenly in the logarithm between `low` and `high`; `flipped`: of 1 minus it.

    `or_none`: at its lowest place it is 0, which has no logarithm.
    """

    name: str
    low: float
    high: float
    flipped: bool = False
    or_none: bool = False

    def value(self, place: float) -> float:
        """The number at `place` in [0, 1]."""
        if self.or_none and place <= 0:
            return 0.0
        found = math.exp(math.log(self.low) + min(max(place, 0.0), 1.0) * math.log(self.high / self.low))
        return max(1 - found, 0.0) if self.flipped else found

    def place(self, value: float) -> float:
        """Where `value` lies in [0, 1]."""
        given = min(max(1 - value if self.flipped else value, self.low), self.high)
        return math.log(given / self.low) / math.log(self.high / self.low)


READING = (  # of `Calibration`
    Parameter("floor", 0.01, 1.0),
    Parameter("neutral", 0.003, 0.3),
    Parameter("temperature", 0.03, 30.0),
    Parameter("persistence", 0.05, 1.0, flipped=True),
    Parameter("spread", math.radians(2), math.radians(12), or_none=True),
)
STRONGEST = 100.0
DETECTING = (  # of `DetectorModel`; `share` and `strength` are mean and sum of the two numbers of its habit
    Parameter("stated", 0.1, 10.0),  # above 1: false alarms as they were counted; below: learnt with the belief
    Parameter("spread", math.radians(0.5), math.radians(20)),
    Parameter("offset", math.radians(0.5), math.radians(12), or_none=True),
    Parameter("look_alikes", 0.01, 5.0),
    Parameter("share", 0.02, 0.98, flipped=True),
    Parameter("strength", 0.3, STRONGEST),
)
MOVING = (  # of `MotionModel`; its `wander` is the slow and the fast kind
    Parameter("slow", math.radians(0.5), math.radians(6)),
    Parameter("fast", math.radians(6), math.radians(40)),
    Parameter("start", 1e-4, 0.1),
    Parameter("stop", 1e-3, 1.0),
    Parameter("jump", 1e-4, 1.0),
)


def motion_values(motion: MotionModel) -> dict[str, float]:
    """The numbers of `MOVING`, as a model has them; of more kinds of wandering the slowest and the fastest."""
    wander = motion.wander or MotionModel().wander
    rates = {name: getattr(motion, name) for name in ("start", "stop", "jump")}
    return {"slow": min(wander), "fast": max(wander), **rates}


def habit_values(model: DetectorModel) -> dict[str, float]:
    """`share` and `strength` of its habit, and the number of `look_alikes`, also where it is not stated."""
    found = {"look_alikes": expected_look_alikes(model)}
    if model.detection_probability is not None:
        return found | {"share": model.detection_probability, "strength": STRONGEST}
    return found | {"share": model.habit[0] / sum(model.habit), "strength": sum(model.habit)}


def with_habit(share: float, strength: float) -> dict[str, Any]:
    """The fields of a model whose habit has these."""
    return {"detection_probability": None, "habit": (short(share * strength), short((1 - share) * strength))}


def counted(recordings: Sequence[Recording]) -> DetectorModel | None:
    """The detector's model as `fit_detector` finds it on the recordings; None where they hold no detections."""
    looks = [look for number, recording in enumerate(recordings) for look in _labelled(recording, str(number))]
    return fitted_model(looks, looks[0].detections.model) if looks else None


def _labelled(recording: Recording, group: str) -> list[LabelledLook]:
    """The looks of a recording that gave detections; the target counts where it is in sight."""
    place: dict[float | None, int] = {moment.stamp: index for index, moment in enumerate(recording.moments)}
    found = []
    for moment in recording.moments:
        if moment.evidence is None or moment.evidence.detections is None:
            continue
        index = place.get(moment.evidence.stamp, place[moment.stamp])
        then, target = recording.moments[index], recording.directions[index][None]
        at = target[: int(recording.truth["visible"][index])]
        found.append(LabelledLook(moment.evidence, at, then.stamp, group, then.world_R_body, then.position))
    return found


@dataclass(frozen=True, eq=False)
class Score:
    """How a tracker did on one recording, over its readings.

    `direction`: log densities at the true direction; `presence`: logs of the probabilities of the truth, for the target
    and for what is not there; `error`: degrees; `inside`: whether the truth lay in the 90 % region.
    """

    seed: int
    direction: np.ndarray
    presence: tuple[np.ndarray, np.ndarray]
    error: np.ndarray
    inside: np.ndarray

    @property
    def total(self) -> float:
        """Mean over the readings, nats."""
        return float(self.direction.mean()) + (float(self.presence[0].mean()) + float(self.presence[1].mean())) / 2


class Recorder:
    """Records development episodes as one perception sees them.

    `rows` of the panoramas; None: what the perception works at. Raises `EagorError` if it cannot be made.
    """

    def __init__(self, perception: str, rows: int | None = None) -> None:
        seeing = load(perception)
        config = {"perception": perception, "rows": rows or rows_of(seeing)}
        config |= {"camera": as_dict(Camera()), "disturbances": as_dict(Disturbances())}
        self.players = {
            task: Player(config | {"task": task, "rules": as_dict(tasks.load(task).rules())}, seeing) for task in TASKS
        }

    def record(self, slot: Slot) -> Recording:
        """An episode with responses to its query and to one that nothing there answers.

        Raises `WorldError` for a slot that cannot be planned, `QueryError` if the perception does not know the words.
        """
        player, rng = self.players[slot.task], slot.rng("absent")
        episode = player.plan(slot)
        if isinstance(episode, TrackingEpisode):
            other = f"{rng.choice(sorted({*PAINTS} - {episode.colour}))} ball"
        else:
            place = load_place(slot.world, slot.seed, player.camera.radius)
            other = str(place.missing(rng, is_privileged(player.perception)))
        return player.record(episode, other)


def record_episodes(
    perception: str,
    count: int,
    seed: int,
    rows: int | None = None,
    advance: Callable[[], object] = lambda: None,
    left_out: Callable[[str], object] = lambda why: None,
) -> list[Recording]:
    """The recordings of `development_slots`; `left_out` is told of what cannot be planned, and of unknown words.

    A task whose words the perception does not know is left out whole. Raises `EagorError` if nothing is left.
    """
    recorder, slots = Recorder(perception, rows), development_slots(count, seed)
    found: list[Recording] = []
    strange: set[str] = set()
    for slot in slots:
        try:
            if slot.task not in strange:
                found.append(recorder.record(slot))
        except WorldError as error:
            left_out(f"{slot.task} {slot.id} is left out: {error}")
        except QueryError as error:
            strange.add(slot.task)
            left_out(f"{slot.task} is left out: {error}")
        advance()
    if not found:
        raise EagorError(f"{perception} could be asked in none of {count} episodes; calibrate it where it knows words")
    return found


def kept_recordings(folder: Path, perception: str, count: int, seed: int, left_out: Callable[[str], object]) -> Path:
    """The file in `folder` that keeps `record_episodes` (a pickled list), which is made where it is missing."""
    file = folder / f"{perception.replace('/', '-')}-{seed}-{count}.pickle"
    if not file.exists():
        written(file, pickle.dumps(record_episodes(perception, count, seed, left_out=left_out)))
    return file


def development_slots(count: int, seed: int) -> list[Slot]:
    """`count` slots, `PER_PLACE` of each task in an apartment. Raises `EagorError` where results are taken from."""
    last = seed + (count - 1) // (PER_PLACE * len(TASKS))
    if seed not in DEVELOPMENT or last not in DEVELOPMENT:
        raise EagorError(
            f"{count} episodes from apartment {seed} on reach apartment {last}; wanted all between {DEVELOPMENT.start} "
            f"and {DEVELOPMENT.stop - 1}: the others are for results"
        )
    found = []
    for number in range(count):
        place, index = divmod(number // len(TASKS), PER_PLACE)
        found.append(Slot(TASKS[number % len(TASKS)], APARTMENT, seed + place, index, number // len(TASKS)))
    return found


def score(recording: Recording, config: TrackerConfig, regions: bool = False) -> Score:
    """A tracker with this configuration on one recording; with `regions`, coverage is read as well."""
    tracker, absent = DirectionTracker(config), DirectionTracker(config)
    direction, error, inside = [], [], []
    presence: tuple[list[float], list[float]] = ([], [])
    for index, moment in enumerate(recording.moments):
        _tell(tracker, moment.stamp, moment.world_R_body, moment.position, moment.evidence, config)
        _tell(absent, moment.stamp, moment.world_R_body, moment.position, moment.other, config)
        if index % EVERY:
            continue
        if moment.other is not None:
            presence[1].append(math.log(max(1 - absent.estimate(moment.stamp).presence, SMALLEST)))
        if recording.truth["present"][index]:
            estimate, true = tracker.estimate(moment.stamp), recording.directions[index]
            presence[0].append(math.log(max(estimate.presence, SMALLEST)))
            direction.append(float(estimate.log_density(true)))
            said = FORWARD if estimate.direction is None else estimate.direction
            error.append(float(angular_error_deg(np.array(said), true)))
            if regions:
                inside.append(estimate.mass_above(true) < MASS)
    told = (np.array(presence[0]), np.array(presence[1] or [0.0]))
    return Score(recording.episode.slot.seed, np.array(direction), told, np.array(error), np.array(inside))


def _tell(
    tracker: DirectionTracker, stamp: float, world_R_body: np.ndarray, position: np.ndarray,
    evidence: Evidence | None, config: TrackerConfig,
) -> None:  # fmt: skip
    tracker.add_pose(stamp, world_R_body, position if config.ranges is not None else None)
    if evidence is not None:
        tracker.observe(evidence)
