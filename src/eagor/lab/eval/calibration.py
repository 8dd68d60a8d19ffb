"""Fitting how the looks of a perception are read, and how its targets come to move, by log score.

Development episodes are recorded once: poses, and looks for two queries, one of which nothing there answers. What a
detector does is counted on them (`counted`). How response maps are read (`READING`) and how targets move (`MOVING`) is
searched: a trial reads the recordings with other settings; its score (nats) is the log density given to the true
direction plus the log of the probability given to the truth about presence, which only honest beliefs maximise (Good,
1952).

Draws come from a normal distribution in the logarithms of the parameters, which moves to the best quarter of each round
(cross-entropy method; Rubinstein, 1999). Tried once, with 48 trials on maps: scipy's differential evolution hardly left
the start. Half of the apartments are searched on, the others judge.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from eagor._version import __version__
from eagor.errors import EagorError, QueryError, WorldError
from eagor.evidence.detector import DetectorModel
from eagor.lab.agents.methods import BASE
from eagor.lab.agents.models import is_privileged
from eagor.lab.envs.episodes import EpisodeSpec
from eagor.lab.envs.places import APARTMENT, load_place
from eagor.lab.eval.detector_fit import fitted_model, short
from eagor.lab.eval.labelled_looks import LabelledLook, check_development
from eagor.lab.tasks.sim.play import MASS, Rollout, Runner
from eagor.lab.tasks.sim.tracking import TrackingEpisode
from eagor.lab.worlds.render import PAINTS
from eagor.metrics import angular_error_deg
from eagor.perception import load
from eagor.perception.calibrated import Calibrated
from eagor.sphere import FORWARD
from eagor.statistics import bootstrap_interval
from eagor.tracking.config import MotionModel, TrackerConfig
from eagor.tracking.follower import Follower

TASKS = ("waypoint", "tracking")
PER_PLACE = 2  # episodes of each task in an apartment: many apartments tell more than many episodes in one
EVERY = 3  # steps between the readings that are scored: neighbours say nearly the same
SMALLEST = 1e-9  # a probability of presence below it counts as this
DRAWS, ELITE = 16, 4  # settings in a round, of which so many are kept
SPREAD, LEAST = 0.25, 0.03  # standard deviation of the first round, of the range of each parameter; the least of any


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
        value = math.exp(math.log(self.low) + min(max(place, 0.0), 1.0) * math.log(self.high / self.low))
        return max(1 - value, 0.0) if self.flipped else value

    def place(self, value: float) -> float:
        """Where `value` lies in [0, 1]."""
        inside = min(max(1 - value if self.flipped else value, self.low), self.high)
        return math.log(inside / self.low) / math.log(self.high / self.low)


READING = (  # of `Calibration`
    Parameter("floor", 0.01, 1.0),
    Parameter("neutral", 0.003, 0.3),
    Parameter("temperature", 0.03, 30.0),
    Parameter("persistence", 0.05, 1.0, flipped=True),
    Parameter("spread", math.radians(2), math.radians(12), or_none=True),
)
MOVING = (  # of `MotionModel`; its `wander` is the slow and the fast kind
    Parameter("slow", math.radians(0.5), math.radians(6)),
    Parameter("fast", math.radians(6), math.radians(40)),
    Parameter("start", 1e-4, 0.1),
    Parameter("stop", 1e-3, 1.0),
    Parameter("jump", 1e-4, 1.0),
)


# --- recordings -------------------------------------------------------------------------------------------------------


def make_runners(perception: str, rows: int | None = None) -> dict[str, Runner]:
    """For each of `TASKS` what records its episodes as this perception sees them.

    `rows` of the panoramas; None: what the perception works at. Raises `EagorError` if it cannot be made.
    """
    loaded = load(perception)
    return {task: Runner({"task": task, "perception": perception, "rows": rows}, loaded) for task in TASKS}


def record(runner: Runner, spec: EpisodeSpec) -> Rollout:
    """An episode with responses to its query and to one that nothing there answers.

    Raises `WorldError` for a spec that cannot be planned, `QueryError` if the perception does not know the words.
    """
    episode, rng = runner.plan(spec), spec.rng("absent")
    if isinstance(episode, TrackingEpisode):
        return runner.record(episode, f"{rng.choice(sorted({*PAINTS} - {episode.colour}))} ball")
    place = load_place(spec.world, spec.seed, runner.camera.radius)
    return runner.record(episode, str(place.missing(rng, is_privileged(runner.perception))))


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
    runners, specs = make_runners(perception, rows), development_specs(count, seed)
    recordings: list[Rollout] = []
    for spec in specs:
        try:
            if spec.task in runners:
                recordings.append(record(runners[spec.task], spec))
        except WorldError as error:
            left_out(f"{spec.task} {spec.id} is left out: {error}")
        except QueryError as error:
            del runners[spec.task]
            left_out(f"{spec.task} is left out: {error}")
        advance()
    if not recordings:
        raise EagorError(f"{perception} could be asked in none of {count} episodes; calibrate it where it knows words")
    return recordings


def development_specs(count: int, seed: int) -> list[EpisodeSpec]:
    """`count` specs, `PER_PLACE` of each task in an apartment. Raises `EagorError` where results are taken from."""
    check_development(count, "episodes", seed, PER_PLACE * len(TASKS))
    specs = []
    for number in range(count):
        pair, task = divmod(number, len(TASKS))
        specs.append(EpisodeSpec(TASKS[task], APARTMENT, seed + pair // PER_PLACE, pair % PER_PLACE, pair))
    return specs


def counted(recordings: Sequence[Rollout]) -> DetectorModel | None:
    """The detector's model as `fit_detector` finds it on the recordings; None where they hold no detections.

    The target counts where it is in sight.
    """
    looks = []
    for number, recording in enumerate(recordings):
        steps = {moment.stamp: step for step, moment in enumerate(recording.steps)}
        for now, moment in enumerate(recording.steps):
            if moment.evidence is None or moment.evidence.detections is None:
                continue
            step = now if moment.evidence.stamp is None else steps.get(float(moment.evidence.stamp), now)
            then, target = recording.steps[step], recording.directions[step][None]
            target = target[: int(recording.truth["visible"][step])]
            pose = then.world_R_body, then.position
            looks.append(LabelledLook(moment.evidence, target, then.stamp, str(number), *pose))
    return fitted_model(looks, looks[0].detections.model) if looks else None


# --- the score --------------------------------------------------------------------------------------------------------


class Score(NamedTuple):
    """How a tracker did on one recording, means over its readings; NaN where the target was never there.

    `density`: log density at the true direction; `presence`: log of the probability of the truth, of the target and of
    what is not there in equal parts; `error`: degrees; `coverage`: how often the truth lay in the 90 % region.
    """

    density: float
    presence: float
    error: float
    coverage: float

    @property
    def total(self) -> float:
        """What is maximised, nats."""
        return self.density + self.presence


def score(recording: Rollout, config: TrackerConfig, regions: bool = False) -> Score:
    """A tracker with this configuration on one recording; with `regions`, coverage is read as well."""
    follower, absent = Follower(config), Follower(config)
    present, missing, rows = [], [], []
    for index, moment in enumerate(recording.steps):
        for each, evidence in ((follower, moment.evidence), (absent, moment.other)):
            each.move(moment.stamp, moment.world_R_body, moment.position)
            if evidence is not None:
                each.look(evidence)
        if index % EVERY:
            continue
        if moment.other is not None:
            missing.append(math.log(max(1 - absent.estimate(moment.stamp).presence, SMALLEST)))
        if recording.truth["present"][index]:
            estimate, true = follower.estimate(moment.stamp), recording.directions[index]
            present.append(math.log(max(estimate.presence, SMALLEST)))
            answer = FORWARD if estimate.direction is None else estimate.direction
            inside = estimate.mass_above(true) < MASS if regions else math.nan
            rows.append((estimate.log_density(true), angular_error_deg(np.array(answer), true), inside))
    density, error, coverage = np.mean(rows, axis=0).tolist() if rows else [math.nan] * 3
    presence = (np.mean(present or [math.nan]) + np.mean(missing or [0.0])) / 2
    return Score(density, float(presence), error, coverage)


# --- the fit ----------------------------------------------------------------------------------------------------------


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
    of = [recording.episode.spec.seed for recording in recordings]
    seeds = sorted(set(of))
    halves = [[index for index, seed in enumerate(of) if seeds.index(seed) % 2 == half] for half in (0, 1)]
    if not all(halves):
        raise EagorError(f"{len(recordings)} episodes of {len(seeds)} apartment; calibrating needs at least two")
    fitted = Calibrated(perception, None, detector=counted([recordings[index] for index in halves[0]]))
    if fitted.detector is None:
        looks = (moment.evidence for index in halves[0] for moment in recordings[index].steps)
        now = next(evidence.calibration for evidence in looks if evidence is not None)
        fitted = replace(fitted, calibration=replace(now, scale_to_max=False))
    start = best = places(fitted)
    with _mapping(workers, recordings) as run:
        for best in _rounds(partial(_scores, fitted, halves[0], False), start, trials, run, on_trial):
            on_round(settings(fitted, best))
        before, after = run(partial(_scores, fitted, halves[1], True), [start, best])
    groups = [of[index] for index in halves[1]]
    found_by = {
        "apartments": seeds,
        "episodes": len(recordings),
        "trials": trials,
        "judged by": sorted(set(groups)),
        "before": _means(before, groups),
        "after": _means(after, groups),
        "version": __version__,
    }
    return replace(settings(fitted, best), found_by=found_by)


def motion_values(motion: MotionModel) -> dict[str, float]:
    """The numbers of `MOVING`, as a model has them; of more kinds of wandering the slowest and the fastest."""
    wander = motion.wander or MotionModel().wander
    rates = {name: getattr(motion, name) for name in ("start", "stop", "jump")}
    return {"slow": min(wander), "fast": max(wander), **rates}


def parameters(start: Calibrated) -> tuple[Parameter, ...]:
    """What is searched from there."""
    return MOVING if start.calibration is None else READING + MOVING


def places(start: Calibrated) -> np.ndarray:
    """Where the search begins ``(parameters,)``: looks are read as `start` says, targets move as in `BASE`."""
    values = (vars(start.calibration) if start.calibration else {}) | motion_values(BASE.target_motion)
    return np.array([parameter.place(values[parameter.name]) for parameter in parameters(start)])


def settings(start: Calibrated, at: np.ndarray) -> Calibrated:
    """The settings at places `at` ``(parameters,)``; else they are those of `start`."""
    pairs = zip(parameters(start), at.tolist(), strict=True)
    values: dict[str, Any] = {parameter.name: short(parameter.value(place)) for parameter, place in pairs}
    moving = {parameter.name: values.pop(parameter.name) for parameter in MOVING}
    forgetting = {"wander": (moving.pop("slow"), moving.pop("fast")), **moving}
    calibration = None if start.calibration is None else replace(start.calibration, **values)
    return replace(start, calibration=calibration, forgetting=forgetting)


Run = Callable[[Callable[[np.ndarray], list[Score]], Sequence[np.ndarray]], Any]


def _rounds(
    trial: Callable[[np.ndarray], list[Score]], start: np.ndarray, trials: int, run: Run, on_trial: Callable[[], object]
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
        for places, scores in zip(draws, run(trial, list(draws)), strict=True):
            tried.append((float(np.mean([each.total for each in scores])), places))
            on_trial()
        tried.sort(key=lambda entry: -entry[0])
        elite = np.array([places for _, places in tried[:ELITE]])
        mean, spread = elite.mean(axis=0), np.maximum(elite.std(axis=0), LEAST)
        yield tried[0][1]


def _means(scores: Sequence[Score], groups: Sequence[int]) -> dict[str, list[float | None]]:
    """Means with 95 % intervals over apartments, the `groups` of the scores; None where there is only one."""
    rows = {"log score": [each.total for each in scores], "log density": [each.density for each in scores]}
    rows |= {"error_deg": [each.error for each in scores], "coverage_%": [100 * each.coverage for each in scores]}
    means: dict[str, list[float | None]] = {}
    for name, values in rows.items():
        known = np.isfinite(values)  # a target that was never there has no error
        kept, of = np.array(values)[known], np.array(groups)[known]
        ends: list[float | None] = [None, None]  # one apartment says nothing about the spread
        if len(np.unique(of)) > 1:
            interval = bootstrap_interval(kept, np.random.default_rng(0), groups=of)
            ends = [round(interval.low, 3), round(interval.high, 3)]
        means[name] = [round(float(kept.mean()), 3), *ends]
    return means


_recordings: list[Rollout] = []  # of this process: each is given them once


def _begin(recordings: Sequence[Rollout]) -> None:
    _recordings[:] = recordings


def _scores(start: Calibrated, indices: Sequence[int], regions: bool, at: np.ndarray) -> list[Score]:
    """The scores of the settings at places `at`, of the recordings with these indices."""
    tried = settings(start, at)
    config = BASE.fitted(tried.calibration, tried.detector, tried.forgetting)
    return [score(_recordings[index], config, regions) for index in indices]


@contextmanager
def _mapping(workers: int, recordings: Sequence[Rollout]) -> Iterator[Run]:
    """What maps a function over jobs, in this process or in several, where `_recordings` are these."""
    if workers == 1:
        try:
            _begin(recordings)
            yield map
        finally:
            _begin([])
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read by the processes that start now
    with multiprocessing.get_context("spawn").Pool(workers, _begin, (recordings,)) as pool:
        yield pool.imap
