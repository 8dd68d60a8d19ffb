"""Fitting how the looks of a perception are read, and how its targets come to move, by log score.

Development episodes are recorded once: poses, and looks for two queries, one of which nothing there answers. A trial
reads them with other settings; its score (nats) is the log density given to the true direction plus the log of the
probability given to the truth about presence, which only honest beliefs maximise (Good, 1952). `READING` and
`DETECTING` are the numbers of response maps and detections, `MOVING` those of `MotionModel`; what can be counted is
`counted`.

`fit` searches. Draws come from a normal distribution in the logarithms of the parameters, which moves to the best
quarter of each round (cross-entropy method; Rubinstein, 1999). Tried once, with 48 trials on maps: scipy's differential
evolution hardly left the start. Half of the apartments are searched on, the others judge.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from eagor._version import __version__
from eagor.errors import EagorError, QueryError, WorldError
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.lab.agents.methods import BASE
from eagor.lab.agents.models import is_privileged
from eagor.lab.envs.episodes import EpisodeSpec
from eagor.lab.envs.places import APARTMENT, DEVELOPMENT, load_place
from eagor.lab.envs.rules import Camera, NoiseModel, as_dict
from eagor.lab.eval.assignments import expected_look_alikes
from eagor.lab.eval.detector_fit import fitted_model, short
from eagor.lab.eval.labelled_looks import LabelledLook
from eagor.lab.tasks.sim.play import MASS, Player
from eagor.lab.tasks.sim.tracking import TrackingEpisode
from eagor.lab.tasks.task import load as load_task
from eagor.lab.worlds.render import PAINTS
from eagor.metrics import angular_error_deg
from eagor.perception import load, rows_of
from eagor.perception.calibrated import Calibrated
from eagor.sphere import FORWARD
from eagor.statistics import bootstrap_interval
from eagor.tracking.config import MotionModel, TrackerConfig
from eagor.tracking.follower import Follower

TASKS = ("waypoint", "tracking")
PER_PLACE = 2  # episodes of each task in an apartment: many apartments tell more than many episodes in one
EVERY = 3  # steps between the readings that are scored: neighbours say nearly the same
SMALLEST = 1e-9  # a probability of presence below it counts as this
DRAWS = 16  # settings in a round,
ELITE = 4  # of which so many are kept
SPREAD = 0.25  # standard deviation of the first round, of the range of each parameter,
LEAST = 0.03  # ... and the smallest of any round
LEARNT = 0.4  # of `stated`: the search begins with false alarms that are learnt

Map = Callable[[Callable[[Any], Any], Sequence[Any]], Any]


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


def counted(recordings: Sequence[Rollout]) -> DetectorModel | None:
    """The detector's model as `fit_detector` finds it on the recordings; None where they hold no detections."""
    looks = [look for number, recording in enumerate(recordings) for look in _labelled(recording, str(number))]
    return fitted_model(looks, looks[0].detections.model) if looks else None


def _labelled(recording: Rollout, group: str) -> list[LabelledLook]:
    """The looks of a recording that gave detections; the target counts where it is in sight."""
    place: dict[float | None, int] = {moment.stamp: index for index, moment in enumerate(recording.steps)}
    found = []
    for moment in recording.steps:
        if moment.evidence is None or moment.evidence.detections is None:
            continue
        index = place.get(moment.evidence.stamp, place[moment.stamp])
        then, target = recording.steps[index], recording.directions[index][None]
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
        config |= {"camera": as_dict(Camera()), "disturbances": as_dict(NoiseModel())}
        self.players = {
            task: Player(config | {"task": task, "rules": as_dict(load_task(task).rules())}, seeing)
            for task in TASKS  # type: ignore[attr-defined]
        }

    def record(self, spec: EpisodeSpec) -> Rollout:
        """An episode with responses to its query and to one that nothing there answers.

        Raises `WorldError` for a spec that cannot be planned, `QueryError` if the perception does not know the words.
        """
        runner, rng = self.runners[spec.task], spec.rng("absent")
        episode = runner.plan(spec)
        if isinstance(episode, TrackingEpisode):
            other = f"{rng.choice(sorted({*PAINTS} - {episode.colour}))} ball"
        else:
            place = load_place(spec.world, spec.seed, runner.camera.radius)
            other = str(place.missing(rng, is_privileged(runner.perception)))
        return runner.record(episode, other)


def record_episodes(
    perception: str,
    count: int,
    seed: int,
    rows: int | None = None,
    advance: Callable[[], object] = lambda: None,
    left_out: Callable[[str], object] = lambda why: None,
) -> list[Rollout]:
    """The recordings of `development_specs`; `left_out` is told of what cannot be planned, and of unknown words.

    A task whose words the perception does not know is left out whole. Raises `EagorError` if nothing is left.
    """
    recorder, specs = Recorder(perception, rows), development_specs(count, seed)
    found: list[Rollout] = []
    strange: set[str] = set()
    for spec in specs:
        try:
            if spec.task not in strange:
                found.append(recorder.record(spec))
        except WorldError as error:
            left_out(f"{spec.task} {spec.id} is left out: {error}")
        except QueryError as error:
            strange.add(spec.task)
            left_out(f"{spec.task} is left out: {error}")
        advance()
    if not found:
        raise EagorError(f"{perception} could be asked in none of {count} episodes; calibrate it where it knows words")
    return found


def development_specs(count: int, seed: int) -> list[EpisodeSpec]:
    """`count` specs, `PER_PLACE` of each task in an apartment. Raises `EagorError` where results are taken from."""
    last = seed + (count - 1) // (PER_PLACE * len(TASKS))
    if seed not in DEVELOPMENT or last not in DEVELOPMENT:
        raise EagorError(
            f"{count} episodes from apartment {seed} on reach apartment {last}; wanted all between {DEVELOPMENT.start} "
            f"and {DEVELOPMENT.stop - 1}: the others are for results"
        )
    found = []
    for number in range(count):
        place, index = divmod(number // len(TASKS), PER_PLACE)
        found.append(EpisodeSpec(TASKS[number % len(TASKS)], APARTMENT, seed + place, index, number // len(TASKS)))
    return found


def score(recording: Rollout, config: TrackerConfig, regions: bool = False) -> Score:
    """A tracker with this configuration on one recording; with `regions`, coverage is read as well."""
    follower, absent = Follower(config), Follower(config)
    direction, error, inside = [], [], []
    presence: tuple[list[float], list[float]] = ([], [])
    for index, moment in enumerate(recording.steps):
        for each, evidence in ((follower, moment.evidence), (absent, moment.other)):
            each.move(moment.stamp, moment.world_R_body, moment.position)
            if evidence is not None:
                each.look(evidence)
        if index % EVERY:
            continue
        if moment.other is not None:
            presence[1].append(math.log(max(1 - absent.estimate(moment.stamp).presence, SMALLEST)))
        if recording.truth["present"][index]:
            estimate, true = follower.estimate(moment.stamp), recording.directions[index]
            presence[0].append(math.log(max(estimate.presence, SMALLEST)))
            direction.append(float(estimate.log_density(true)))
            said = FORWARD if estimate.direction is None else estimate.direction
            error.append(float(angular_error_deg(np.array(said), true)))
            if regions:
                inside.append(estimate.mass_above(true) < MASS)
    told = (np.array(presence[0]), np.array(presence[1] or [0.0]))
    return Score(recording.episode.spec.seed, np.array(direction), told, np.array(error), np.array(inside))


def fit(
    perception: str,
    recordings: Sequence[Rollout],
    trials: int = 96,
    workers: int = 1,
    on_trial: Callable[[], object] = lambda: None,
    on_round: Callable[[Calibrated], object] = lambda fitted: None,
) -> Calibrated:
    """The settings with the best log score on `recordings`, of which apartments are dealt into two halves.

    `on_trial` is called after each trial, `on_round` with the best so far. Raises `EagorError` if there are too few.
    """
    seeds = sorted({recording.episode.spec.seed for recording in recordings})
    halves = [[r for r in recordings if seeds.index(r.episode.spec.seed) % 2 == half] for half in (0, 1)]
    if not all(halves):
        raise EagorError(f"{len(recordings)} episodes of {len(seeds)} apartment; calibrating needs at least two")
    space = _Space.of(perception, halves[0])
    start = space.start()
    with _mapping(workers, halves) as run:
        best = start
        for best in _rounds(partial(_trial, space), start, trials, run, on_trial):
            on_round(space.at(best))
        judged = [_judged(space, halves[1], at, run) for at in (start, best)]
    found_by = {
        "apartments": seeds,
        "episodes": len(recordings),
        "trials": trials,
        "judged by": sorted({recording.episode.spec.seed for recording in halves[1]}),
        "before": judged[0],
        "after": judged[1],
        "version": __version__,
    }
    return space.at(best, found_by)


@dataclass(frozen=True)
class _Space:
    """What is searched: the `parameters`, and how looks are `read` before that."""

    perception: str
    parameters: tuple[Parameter, ...]
    read: Calibration | DetectorModel

    @classmethod
    def of(cls, perception: str, recordings: Sequence[Rollout]) -> _Space:
        """The space of a perception that gave these recordings."""
        found = counted(recordings)
        if found is not None:
            return cls(perception, DETECTING + MOVING, found)
        seen = (moment.evidence for recording in recordings for moment in recording.steps)
        now = next(evidence.calibration for evidence in seen if evidence is not None)
        return cls(perception, READING + MOVING, replace(now, scale_to_max=False))

    def start(self) -> np.ndarray:
        """Where the search begins ``(parameters,)``: how looks are read, as above, and how targets move now."""
        habit = habit_values(self.read) if isinstance(self.read, DetectorModel) else {}
        values = {"stated": LEARNT, **vars(self.read), **habit, **motion_values(BASE.target_motion)}
        return np.array([parameter.place(values[parameter.name]) for parameter in self.parameters])

    def at(self, places: np.ndarray, found_by: dict[str, Any] | None = None) -> Calibrated:
        """The settings at `places` ``(parameters,)``."""
        pairs = zip(self.parameters, places.tolist(), strict=True)
        values: dict[str, Any] = {parameter.name: short(parameter.value(place)) for parameter, place in pairs}
        moving = {parameter.name: values.pop(parameter.name) for parameter in MOVING}
        forgetting = {"wander": (moving.pop("slow"), moving.pop("fast")), **moving}
        if isinstance(self.read, Calibration):
            return Calibrated(self.perception, replace(self.read, **values), forgetting, found_by or {})
        model = self.read
        values |= with_habit(values.pop("share"), values.pop("strength"))
        if values.pop("stated") < 1:
            model = replace(model, false_alarms_per_look=None)
        return Calibrated(self.perception, None, forgetting, found_by or {}, replace(model, **values))


def _rounds(
    trial: Callable[[np.ndarray], float], start: np.ndarray, trials: int, run: Map, on_trial: Callable[[], object]
) -> Iterator[np.ndarray]:
    """The best settings after each round."""
    rng = np.random.default_rng(7)
    mean, spread = start, np.full(len(start), SPREAD)
    tried: list[tuple[float, np.ndarray]] = []
    while len(tried) < trials:
        draws = np.clip(mean + spread * rng.standard_normal((DRAWS, len(start))), 0, 1)
        if not tried:
            draws[0] = start
        draws = draws[: trials - len(tried)]
        for places, value in zip(draws, run(trial, list(draws)), strict=True):
            tried.append((value, places))
            on_trial()
        tried.sort(key=lambda entry: -entry[0])
        elite = np.array([places for _, places in tried[:ELITE]])
        mean, spread = elite.mean(axis=0), np.maximum(elite.std(axis=0), LEAST)
        yield tried[0][1]


def _trial(space: _Space, places: np.ndarray) -> float:
    config = _config(space, places)
    return float(np.mean([score(recording, config).total for recording in _halves[0]]))


def _judged(space: _Space, half: Sequence[Rollout], places: np.ndarray, run: Map) -> dict[str, Any]:
    """Scores on the other half of the apartments, with 95 % intervals over apartments."""
    scores: list[Score] = list(run(partial(_one, space, places), range(len(half))))
    groups = [found.seed for found in scores]

    def line(values: list[float]) -> list[float | None]:
        known = [(value, group) for value, group in zip(values, groups, strict=True) if not math.isnan(value)]
        kept, of = zip(*known, strict=True)
        if len(set(of)) < 2:
            return [round(float(np.mean(kept)), 3), None, None]  # one apartment says nothing about the spread
        interval = bootstrap_interval(kept, np.random.default_rng(0), groups=of)
        return [round(float(value), 3) for value in (np.mean(kept), interval.low, interval.high)]

    return {
        "log score": line([found.total for found in scores]),
        "log density": line([float(found.direction.mean()) for found in scores]),
        "error_deg": line([float(found.error.mean()) for found in scores]),
        "coverage_%": line([100 * float(found.inside.mean()) for found in scores]),
    }


def _one(space: _Space, places: np.ndarray, index: int) -> Score:
    return score(_halves[1][index], _config(space, places), regions=True)


def _config(space: _Space, places: np.ndarray) -> TrackerConfig:
    found = space.at(places)
    return BASE.fitted(found.calibration, found.detector, found.forgetting)


_halves: list[list[Rollout]] = []  # of this process: each is given them once


def _begin(halves: list[list[Rollout]]) -> None:
    _halves[:] = halves


@contextmanager
def _mapping(workers: int, halves: list[list[Rollout]]) -> Iterator[Map]:
    """What maps a function over jobs, in this process or in several, where `_halves` are these."""
    if workers == 1:
        _begin(halves)
        yield map
        _halves.clear()
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read by the processes that start now
    with multiprocessing.get_context("spawn").Pool(workers, _begin, (halves,)) as pool:
        yield pool.imap
