"""Fit the settings of every filter on development episodes: same episodes, same number of trials, same aim for each.

    python benchmarks/fit.py [--perception scout] [--methods eagor vmf ...] [--episodes 60] [--trials 48] [--seed 100]
                             [--workers 2]

Waypoint Following and `tracking` are open loop: their episodes are recorded once (poses and responses), and every
trial reads the recordings, which are those of ``eagor calibrate``. A trial is a random draw from the method's space;
the first is the setting in use now. All trials see the episodes of half of the apartments; the best eighth of them is
judged by the other half, and that ranking is printed. Seeds, from --seed on, are of development apartments only; others
are refused.

The aim is one number, in degrees: waypoint (error + TC) + tracking (error + TC), each a mean over episodes. It asks for
what a user sees: to be right, and not to jump.
"""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import common
import numpy as np

from eagor.lab.eval.calibration import TASKS, make_runners, record_episodes
from eagor.lab.tasks.sim.rollout import Rollout

AIMS = {"waypoint": ("mae", "tc"), "tracking": ("error", "tc")}

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

    def __init__(self, recordings: Sequence[Rollout], perception: str) -> None:
        self.recordings = {task: [r for r in recordings if r.episode.spec.task == task] for task in TASKS}
        self.runners = make_runners(perception)

    def aim(self, name: str, half: int) -> float:
        """What is minimised, degrees: means over the episodes in even or odd apartments that have a case."""
        found = 0.0
        for task, columns in AIMS.items():
            runner = self.runners[task]
            judged = [
                runner.score(recording, runner.method(name, recording.episode.spec), regions=False)["metrics"]
                for recording in self.recordings[task]
                if recording.episode.spec.seed % 2 == half
            ]
            for column in columns:
                found += float(np.mean([metrics[column] for metrics in judged if metrics[column] is not None]))
        return found


_judge: Judge


def _begin(recordings: Sequence[Rollout], perception: str) -> None:
    global _judge
    _judge = Judge(recordings, perception)


def _try(job: tuple[str, int]) -> tuple[float, str]:
    return _judge.aim(*job), job[0]


def trials(base: str, count: int, seed: int) -> Iterator[str]:
    """Names of variants of a method: what is in use, then random draws."""
    yield base
    rng = np.random.default_rng([seed, 17])
    for _ in range(count - 1):
        drawn = {key: value if isinstance(value, str) else f"{value:.3g}" for key, value in SPACES[base](rng).items()}
        yield f"{base}:" + ",".join(f"{key}={value}" for key, value in drawn.items())


def main() -> None:
    known = {"perception": "scout", "methods": tuple(SPACES), "episodes": 60, "trials": 48, "seed": 100, "workers": 2}
    options = common.parser(__doc__, **known).parse_args()
    print(f"{options.episodes} episodes of {', '.join(TASKS)}, apartments from {options.seed}", flush=True)
    recordings = record_episodes(options.perception, options.episodes, options.seed, left_out=print)
    begin = _begin, (recordings, options.perception)
    with multiprocessing.get_context("spawn").Pool(options.workers, *begin) as pool:
        for base in options.methods:
            names = list(trials(base, options.trials, options.seed))
            first = sorted(pool.imap_unordered(_try, [(name, 0) for name in names]))
            kept = [name for _, name in first[: max(4, options.trials // 8)]]
            kept += [base] if base not in kept else []
            second = sorted(pool.imap_unordered(_try, [(name, 1) for name in kept]))
            print(f"\n{base}: {len(names)} trials; the best on the other half of the apartments, degrees")
            for value, name in second:
                print(f"  {value:6.2f}  {name}", flush=True)


if __name__ == "__main__":
    main()
