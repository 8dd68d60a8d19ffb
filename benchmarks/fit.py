"""Fit the settings of every filter on development episodes: same episodes, same number of trials, same aim for each.

    python benchmarks/fit.py [--perception scout] [--methods eagor vmf ...] [--trials 48] [--workers 2]

Waypoint Following and `tracking` are open loop: their episodes are recorded once (poses and responses), and every
trial reads the recordings, which are those of ``eagor calibrate``. A trial is a random
draw from the method's space; the first is the setting in use now. All trials see the episodes of half of the
apartments; the best eighth of them is judged by the other half, and that ranking is printed, with intervals over
apartments. Seeds are of development apartments only; others are refused.

The aim is one number, in degrees: waypoint (error + TC) + tracking (error + TC), each a mean over episodes. It asks for
what a user sees: to be right, and not to jump.
"""

from __future__ import annotations

import math
import multiprocessing
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import common
import numpy as np

from eagor.evaluation.calibration import TASKS, Recorder, record_episodes
from eagor.tasks.play import Recording

AIMS = (("waypoint", "mae"), ("waypoint", "tc"), ("tracking", "error"), ("tracking", "tc"))
SHOWN = {
    "waypoint": ("L1", "L2", "L3", "L4", "occ", "seam", "tc"),
    "tracking": ("error", "tc", "time_lost", "recovery"),
}

Settings = dict[str, Any]
Rng = np.random.Generator


def _log(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _reading(rng: Rng) -> Settings:
    return {"floor": _log(rng, 0.03, 1), "neutral": _log(rng, 0.01, 0.15), "temperature": _log(rng, 0.7, 10)}


SPACES: dict[str, Callable[[Rng], Settings]] = {
    "vmf": lambda rng: {**_reading(rng), "noise": _log(rng, 0.5, 15)},
    "grid_filter": lambda rng: {
        **_reading(rng),
        "diffusion": float(rng.choice([0.0, _log(rng, 1.5, 15)])),
        "mixing": _log(rng, 1e-5, 0.03),
    },
    "particle_filter": lambda rng: {
        **_reading(rng),
        "roughening": _log(rng, 0.5, 15),
        "reborn": _log(rng, 0.002, 0.1),
        "kernel": _log(rng, 3, 8),
    },
    "eagor": lambda rng: {
        **_reading(rng),
        "persistence": 1 - _log(rng, 0.05, 1),
        "spread": float(rng.choice([0.0, _log(rng, 2, 12)])),
        "wander": f"{_log(rng, 0.5, 6):.3g}+{_log(rng, 6, 40):.3g}",
        "start": _log(rng, 1e-4, 0.1),
        "stop": _log(rng, 1e-3, 1),
        "jump": _log(rng, 1e-4, 1),
    },
}


class Judge:
    """Plays methods on recordings; each process makes its own."""

    def __init__(self, recordings: Sequence[Recording], perception: str) -> None:
        self.recordings = {task: [r for r in recordings if r.episode.slot.task == task] for task in TASKS}
        self.players = Recorder(perception).players

    def scores(self, name: str, half: int) -> dict[str, list[tuple[int, dict[str, Any]]]]:
        """For each task (apartment, metrics) of the episodes in even or odd apartments."""
        found: dict[str, list[tuple[int, dict[str, Any]]]] = {}
        for task, recordings in self.recordings.items():
            player = self.players[task]
            found[task] = []
            for recording in recordings:
                slot = recording.episode.slot
                if slot.seed % 2 == half:
                    judged = player.judge(recording, player.method(name, slot), regions=False)
                    found[task].append((slot.seed, judged["metrics"]))
        return found


_judge: Judge


def _begin(recordings: Sequence[Recording], perception: str) -> None:
    global _judge
    _judge = Judge(recordings, perception)


def _try(job: tuple[str, int]) -> tuple[str, dict[str, list[tuple[int, dict[str, Any]]]]]:
    return job[0], _judge.scores(*job)


def trials(base: str, count: int, seed: int) -> Iterator[str]:
    """Names of variants of a method: what is in use, then random draws."""
    yield base
    rng = np.random.default_rng([seed, 17])
    for _ in range(count - 1):
        drawn = SPACES[base](rng).items()
        yield f"{base}:" + ",".join(
            f"{key}={value if isinstance(value, str) else f'{value:.3g}'}" for key, value in drawn
        )


def aim(scores: dict[str, list[tuple[int, dict[str, Any]]]]) -> float:
    """What is minimised, degrees."""
    return sum(_mean(scores[task], column)[0] for task, column in AIMS)


def _mean(rows: list[tuple[int, dict[str, Any]]], column: str) -> tuple[float, float, float]:
    """Mean over the episodes that have a case, and its 95 % interval over apartments."""
    there = [(seed, row[column]) for seed, row in rows if row[column] is not None]
    return common.mean_of([value for _, value in there], [seed for seed, _ in there])


def main() -> int:
    arguments = common.parser(__doc__)
    arguments.add_argument("--perception", default="scout")
    arguments.add_argument("--methods", nargs="+", default=list(SPACES), choices=list(SPACES))
    arguments.add_argument("--episodes", type=int, default=60)
    arguments.add_argument("--trials", type=int, default=48)
    arguments.add_argument("--seed", type=int, default=100, help="first apartment, of the development fifth")
    arguments.add_argument("--workers", type=int, default=2)
    options = arguments.parse_args()
    print(f"{options.episodes} episodes of {', '.join(TASKS)}, apartments from {options.seed}", flush=True)
    recordings = record_episodes(options.perception, options.episodes, options.seed, left_out=print)
    begin = _begin, (recordings, options.perception)
    with multiprocessing.get_context("spawn").Pool(options.workers, *begin) as jobs:
        for base in options.methods:
            names = list(trials(base, options.trials, options.seed))
            first = sorted((aim(found), name) for name, found in jobs.imap_unordered(_try, [(n, 0) for n in names]))
            kept = [name for _, name in first[: max(4, options.trials // 8)]]
            kept += [base] if base not in kept else []
            second = sorted(
                ((aim(found), name, found) for name, found in jobs.imap_unordered(_try, [(n, 1) for n in kept])),
                key=lambda entry: entry[0],
            )
            _print(base, len(names), second)
    return 0


def _print(base: str, count: int, entries: list[tuple[float, str, dict[str, Any]]]) -> None:
    print(f"\n{base}: {count} trials; the best on the other half of the apartments")
    heads = [f"{task[0]}.{column}" for task, columns in SHOWN.items() for column in columns]
    print(f"  {'aim':>6s}  " + " ".join(f"{head:>11s}" for head in heads))
    for value, name, scores in entries:
        figures = [_mean(scores[task], column) for task, columns in SHOWN.items() for column in columns]
        print(f"  {value:6.2f}  " + " ".join(f"{f[0]:5.1f} ±{(f[2] - f[1]) / 2:4.1f}" for f in figures))
        print(f"          {name}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
