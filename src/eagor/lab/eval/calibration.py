"""Calibrating a perception on development episodes: how its looks are read, by log score.

Episodes are recorded once: poses, and looks for two queries, one of which nothing there answers. What a detector does
is counted on them, as on labelled looks. How response maps are read is searched: a trial reads the recordings with
another `Calibration`; its score (nats) is the log density given to the true direction plus the log of the probability
given to the truth about presence, which only honest beliefs maximise (Good, 1952).

Draws come from a normal distribution in the logarithms of the parameters, which moves to the best quarter of each round
(cross-entropy method; Rubinstein, 1999). Tried once, with 48 trials: scipy's differential evolution hardly left the
start. Half of the apartments are searched on, the others judge.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np

from eagor._version import __version__
from eagor.errors import EagorError, QueryError, WorldError
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.lab.agents.methods import BASE
from eagor.lab.agents.models import is_privileged
from eagor.lab.envs.episodes import EpisodeSpec
from eagor.lab.envs.places import load_place
from eagor.lab.eval.detector_fit import fitted_model, short
from eagor.lab.eval.labelled_looks import LabelledLook, development_specs
from eagor.lab.tasks.sim.rollout import Rollout, Runner
from eagor.lab.worlds.render import PAINTS
from eagor.perception import load
from eagor.perception.calibrated import READING, Calibrated
from eagor.statistics import bootstrap_interval
from eagor.tracking.config import TrackerConfig
from eagor.tracking.refresh import Follower

TASKS = ("waypoint", "tracking")
PER_PLACE = 2  # episodes of each task in an apartment: many apartments tell more than many episodes in one
EVERY = 3  # steps between the readings that are scored: neighbours say nearly the same
SMALLEST = 1e-9  # a probability of presence below it counts as this
DRAWS, ELITE = 16, 4  # settings in a round, of which so many are kept
SPREAD, LEAST = 0.25, 0.03  # standard deviation of the first round, of the range of each parameter; the least of any
# The ranges of the fields in `READING`, drawn from evenly in the logarithm; of the persistence, of 1 minus it. The
# spread is 0 at its lowest place.
LOW = np.array([0.01, 0.003, 0.03, 0.05, math.radians(2)])
HIGH = np.array([1.0, 0.3, 30.0, 1.0, math.radians(12)])


def at_places(calibration: Calibration, places: np.ndarray) -> Calibration:
    """`calibration` with the numbers of `READING` at `places` ``(5,)``, each in [0, 1] of its range."""
    *values, persistence, spread = (LOW * (HIGH / LOW) ** places).tolist()
    values += [max(1 - persistence, 0.0), spread * (places[-1] > 0)]
    return replace(calibration, **dict(zip(READING, map(short, values), strict=True)))


def places_of(calibration: Calibration) -> np.ndarray:
    """The places ``(5,)`` of a calibration's numbers; the nearest, where one is beyond its range."""
    *values, persistence, spread = (getattr(calibration, name) for name in READING)
    return np.log(np.clip([*values, 1 - persistence, spread], LOW, HIGH) / LOW) / np.log(HIGH / LOW)


# --- recordings -------------------------------------------------------------------------------------------------------


def make_runners(perception: str, rows: int | None = None) -> dict[str, Runner]:
    """For each of `TASKS` what records its episodes as this perception sees them, in panoramas of so many `rows`."""
    loaded = load(perception)
    return {task: Runner({"task": task, "perception": perception, "rows": rows}, loaded) for task in TASKS}


def record(runner: Runner, spec: EpisodeSpec) -> Rollout:
    """An episode with responses to its query and to one that nothing there answers.

    Raises `WorldError` for a spec that cannot be planned, `QueryError` if the perception does not know the words.
    """
    episode, rng = runner.plan(spec), spec.rng("absent")
    if episode.colour is not None:
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
    """The recordings of `count` development episodes of `TASKS`, `PER_PLACE` of each in an apartment.

    `left_out` is told of what cannot be planned, and of unknown words: a task whose words the perception does not know
    is left out whole. Raises `EagorError` if nothing is left.
    """
    runners, recordings = make_runners(perception, rows), []
    for spec in development_specs(TASKS, count, seed, PER_PLACE):
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


# --- the score and the fit --------------------------------------------------------------------------------------------


def score(recording: Rollout, config: TrackerConfig) -> tuple[float, float]:
    """The log score of a tracker with this configuration on one recording, and its log density, nats.

    Means over its readings: log density at the true direction (NaN where the target was never there), plus the log of
    the probability of the truth about presence, of the target and of what is not there in equal parts.
    """
    follower, absent = Follower(config), Follower(config)
    present, missing, densities = [], [], []
    for index, moment in enumerate(recording.steps):
        for each, evidence in ((follower, moment.evidence), (absent, moment.other)):
            each.move(moment.stamp, moment.world_R_body, moment.position)
            if evidence is not None:
                each.observe(evidence)
        if index % EVERY:
            continue
        if moment.other is not None:
            missing.append(math.log(max(1 - absent.estimate(moment.stamp).presence, SMALLEST)))
        if recording.truth["present"][index]:
            estimate = follower.estimate(moment.stamp)
            present.append(math.log(max(estimate.presence, SMALLEST)))
            densities.append(estimate.log_density(recording.directions[index]))
    density, presence = np.mean(densities or [math.nan]), np.mean(present or [math.nan]) + np.mean(missing or [0.0])
    return float(density + presence / 2), float(density)


_recordings: list[Rollout] = []  # of this process: each is given them once


def _begin(recordings: Sequence[Rollout]) -> None:
    _recordings[:] = recordings


def _scores(indices: Sequence[int], config: TrackerConfig) -> list[tuple[float, float]]:
    """The scores of the recordings with these indices."""
    return [score(_recordings[index], config) for index in indices]


def fit(
    perception: str,
    recordings: Sequence[Rollout],
    trials: int = 96,
    workers: int = 1,
    on_trial: Callable[[], object] = lambda: None,
) -> Calibrated:
    """The calibration or the detector's model of a perception, on one half of the apartments of `recordings`.

    The other half judges. `trials`: of response maps; `on_trial` is called after each. Raises `EagorError` if there are
    too few apartments.
    """
    of = [recording.episode.spec.seed for recording in recordings]
    seeds = sorted(set(of))
    halves = [[index for index, seed in enumerate(of) if seeds.index(seed) % 2 == half] for half in (0, 1)]
    if not all(halves):
        raise EagorError(f"{len(recordings)} episodes of {len(seeds)} apartment; calibrating needs at least two")
    detector, start, best = counted([recordings[index] for index in halves[0]]), None, None
    _begin(recordings)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read by the processes that start now
    with get_context("spawn").Pool(workers, _begin, (recordings,)) if workers > 1 else nullcontext() as pool:
        run = map if pool is None else pool.imap
        if detector is None:
            looks = (moment.evidence for index in halves[0] for moment in recordings[index].steps)
            now = next(evidence.calibration for evidence in looks if evidence is not None)
            start = replace(now, scale_to_max=False)
            best = _searched(start, trials, lambda configs: run(partial(_scores, halves[0]), configs), on_trial)
        configs = BASE.fitted(start, None, {}), BASE.fitted(best, detector, {})
        groups = [of[index] for index in halves[1]]
        before, after = (_means(scores, groups) for scores in run(partial(_scores, halves[1]), configs))
    found_by = {"apartments": seeds, "episodes": len(recordings), "trials": 0 if start is None else trials}
    found_by |= {"judged by": sorted(set(groups)), "before": before, "after": after, "version": __version__}
    return Calibrated(perception, best, found_by=found_by, detector=detector)


def _searched(start: Calibration, trials: int, run: Callable[..., Any], advance: Callable[[], object]) -> Calibration:
    """The best of so many `trials`, of which `start` is the first; `run` gives the scores of configurations."""
    rng, mean = np.random.default_rng(7), places_of(start)
    spread = np.full(len(mean), SPREAD)
    tried: list[tuple[float, np.ndarray]] = []
    while len(tried) < trials:
        draws = np.clip(mean + spread * rng.standard_normal((DRAWS, len(mean))), 0, 1)[: trials - len(tried)]
        if not tried:
            draws[0] = mean
        results = run([BASE.fitted(at_places(start, places), None, {}) for places in draws])
        for places, scores in zip(draws, results, strict=True):
            tried.append((float(np.nanmean([total for total, _ in scores])), places))
            advance()
        tried.sort(key=lambda entry: -entry[0])
        elite = np.array([places for _, places in tried[:ELITE]])
        mean, spread = elite.mean(axis=0), np.maximum(elite.std(axis=0), LEAST)
    return at_places(start, tried[0][1])


def _means(scores: Sequence[tuple[float, float]], groups: Sequence[int]) -> dict[str, list[float | None]]:
    """Means with 95 % intervals over apartments, the `groups` of the scores; None where there is only one."""
    means: dict[str, list[float | None]] = {}
    for name, values in zip(("log score", "log density"), np.array(scores).T, strict=True):
        known = np.isfinite(values)  # a target that was never there has no density
        means[name] = [round(float(values[known].mean()), 3), None, None]
        if len(np.unique(of := np.array(groups)[known])) > 1:  # one apartment says nothing about the spread
            interval = bootstrap_interval(values[known], np.random.default_rng(0), groups=of)
            means[name][1:] = [round(interval.low, 3), round(interval.high, 3)]
    return means
