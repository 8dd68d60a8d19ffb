"""The search behind ``eagor calibrate``: settings whose beliefs give the truth the best log score.

Draws come from a normal distribution in the logarithms of the parameters, which moves to the best quarter of each round
(cross-entropy method; Rubinstein, 1999). Half of the apartments are searched on; the others judge.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import pickle
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from eagor._version import __version__
from eagor.errors import EagorError
from eagor.evaluation.calibration import (
    DETECTING,
    MOVING,
    READING,
    Parameter,
    Score,
    counted,
    habit_values,
    motion_values,
    score,
    with_habit,
)
from eagor.evaluation.detector_em import short
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.perception.calibrated import Calibrated
from eagor.statistics import bootstrap_interval
from eagor.tasks.methods import BASE
from eagor.tasks.play import Recording
from eagor.tracking.config import TrackerConfig

DRAWS = 16  # settings in a round,
ELITE = 4  # of which so many are kept
SPREAD = 0.25  # standard deviation of the first round, of the range of each parameter,
LEAST = 0.03  # ... and the smallest of any round
LEARNT = 0.4  # of `stated`: the search begins with false alarms that are learnt

Map = Callable[[Callable[[Any], Any], Sequence[Any]], Any]


def fit(
    perception: str,
    recordings: Sequence[Recording],
    trials: int = 96,
    workers: int = 1,
    on_trial: Callable[[], object] = lambda: None,
    on_round: Callable[[Calibrated], object] = lambda fitted: None,
) -> Calibrated:
    """The settings with the best log score on `recordings`, of which apartments are dealt into two halves.

    `on_trial` is called after each trial, `on_round` with the best so far. Raises `EagorError` if there are too few.
    """
    seeds = sorted({recording.episode.slot.seed for recording in recordings})
    halves = [[r for r in recordings if seeds.index(r.episode.slot.seed) % 2 == half] for half in (0, 1)]
    if not all(halves):
        raise EagorError(f"{len(recordings)} episodes of {len(seeds)} apartment; calibrating needs at least two")
    space = _Space.of(perception, halves[0])
    start = space.start()
    with tempfile.TemporaryDirectory() as folder, _mapping(workers) as run:
        files = [Path(folder) / f"half-{half}" for half in (0, 1)]
        for file, half in zip(files, halves, strict=True):
            file.write_bytes(pickle.dumps(half))
        best = start
        for best in _rounds(partial(_trial, space, files[0]), start, trials, run, on_trial):
            on_round(space.at(best))
        judged = [_judged(space, files[1], len(halves[1]), at, run) for at in (start, best)]
    found_by = {
        "apartments": seeds,
        "episodes": len(recordings),
        "trials": trials,
        "judged by": sorted({recording.episode.slot.seed for recording in halves[1]}),
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
    def of(cls, perception: str, recordings: Sequence[Recording]) -> _Space:
        """The space of a perception that gave these recordings."""
        found = counted(recordings)
        if found is not None:
            return cls(perception, DETECTING + MOVING, found)
        seen = (moment.evidence for recording in recordings for moment in recording.moments)
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


def _trial(space: _Space, file: Path, places: np.ndarray) -> float:
    config = _config(space, places)
    return float(np.mean([score(recording, config).total for recording in _stored(file)]))


def _judged(space: _Space, file: Path, count: int, places: np.ndarray, run: Map) -> dict[str, Any]:
    """Scores on the other half of the apartments, with 95 % intervals over apartments."""
    scores: list[Score] = list(run(partial(_one, space, file, places), list(range(count))))
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


def _one(space: _Space, file: Path, places: np.ndarray, index: int) -> Score:
    return score(_stored(file)[index], _config(space, places), regions=True)


def _config(space: _Space, places: np.ndarray) -> TrackerConfig:
    found = space.at(places)
    return BASE.fitted(found.calibration, found.detector, found.forgetting)


@lru_cache(maxsize=2)
def _stored(file: Path) -> list[Recording]:
    """The recordings of a half: each process reads them once."""
    found: list[Recording] = pickle.loads(file.read_bytes())
    return found


@contextmanager
def _mapping(workers: int) -> Iterator[Map]:
    """What maps a function over jobs, in this process or in several."""
    if workers == 1:
        yield map
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read by the processes that start now
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield pool.imap
