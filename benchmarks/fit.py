"""Fit the settings of every filter on development episodes: same episodes, same number of trials, same aim for each.

    python benchmarks/fit.py [--perception truth] [--methods eagor vmf ...] [--trials 48] [--workers 2] [--folder DIR]

Waypoint Following and Target Tracking are open loop: their episodes are recorded once (poses and responses), and every
trial reads the recordings. A trial is a random draw from the method's space; the first is the setting in use now. All
trials see the episodes of half of the apartments; the best eighth of them is judged by the other half, and that ranking
is printed, with intervals over apartments. Seeds are of development apartments only; others are refused.

The aim is one number, in degrees: waypoint (error + TC) + tracking (error + TC), each a mean over episodes. It asks for
what a user sees: to be right, and not to jump.
"""

from __future__ import annotations

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import argparse
import json
import math
import multiprocessing
import pickle
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from eagor.errors import EagorError
from eagor.statistics import bootstrap_interval
from eagor.tasks.episodes import PER_PLACE, slots
from eagor.tasks.places import DEVELOPMENT
from eagor.tasks.play import RULES, Player, Recording
from eagor.tasks.rules import Camera, Disturbances, as_dict

AIMS = (("waypoint", "mae"), ("waypoint", "tc"), ("tracking", "error"), ("tracking", "tc"))
SHOWN = {
    "waypoint": ("L1", "L2", "L3", "L4", "occ", "seam", "tc"),
    "tracking": ("error", "tc", "time_lost", "recovery"),
}
EPISODES = {"waypoint": 80, "tracking": 60}

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
        "keep": 1 - _log(rng, 0.01, 0.2),
        "wander": _log(rng, 4, 20),
        "restless": _log(rng, 0.001, 0.1),
    },
}


def record(task: str, perception: str, seed: int, count: int) -> list[Recording]:
    """The development episodes of a task; what cannot be planned is told and left out."""
    if seed not in DEVELOPMENT or seed + count // PER_PLACE not in DEVELOPMENT:
        raise EagorError(f"seed {seed}: fitting is for the apartments {DEVELOPMENT.start} to {DEVELOPMENT.stop - 1}")
    player = _player(task, perception)
    found = []
    for slot in slots(task, count, seed):
        try:
            found.append(player.record(player.plan(slot)))
        except EagorError as error:
            print(f"  {task} {slot.id} left out: {error}", file=sys.stderr)
    return found


def _player(task: str, perception: str) -> Player:
    config = {"task": task, "perception": perception, "rules": as_dict(RULES[task]()), "rows": 256}
    return Player(config | {"camera": as_dict(Camera()), "disturbances": as_dict(Disturbances())})


class Judge:
    """Plays methods on the recordings of a folder; each process makes its own."""

    def __init__(self, folder: str, perception: str) -> None:
        self.recordings = {task: pickle.loads((Path(folder) / f"{task}.pickle").read_bytes()) for task in EPISODES}
        self.players = {task: _player(task, perception) for task in EPISODES}

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


def _begin(folder: str, perception: str) -> None:
    global _judge
    _judge = Judge(folder, perception)


def _try(job: tuple[str, int]) -> tuple[str, dict[str, list[tuple[int, dict[str, Any]]]]]:
    return job[0], _judge.scores(*job)


def trials(base: str, count: int, seed: int) -> Iterator[str]:
    """Names of variants of a method: what is in use, then random draws."""
    yield base
    rng = np.random.default_rng([seed, 17])
    for _ in range(count - 1):
        yield f"{base}:" + ",".join(f"{key}={value:.3g}" for key, value in SPACES[base](rng).items())


def aim(scores: dict[str, list[tuple[int, dict[str, Any]]]]) -> float:
    """What is minimised, degrees."""
    return sum(_mean(scores[task], column)[0] for task, column in AIMS)


def _mean(rows: list[tuple[int, dict[str, Any]]], column: str) -> tuple[float, float, float]:
    """Mean over the episodes that have a case, and its 95 % interval over apartments."""
    there = [(seed, row[column]) for seed, row in rows if row[column] is not None]
    if not there:
        return math.nan, math.nan, math.nan
    seeds, values = zip(*there, strict=True)
    interval = bootstrap_interval(values, np.random.default_rng(0), groups=seeds)
    return float(np.mean(values)), interval.low, interval.high


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--perception", default="truth")
    arguments.add_argument("--methods", nargs="+", default=list(SPACES), choices=list(SPACES))
    arguments.add_argument("--trials", type=int, default=48)
    arguments.add_argument("--seed", type=int, default=100, help="first apartment, of the development fifth")
    arguments.add_argument("--workers", type=int, default=2)
    arguments.add_argument("--folder", help="keeps the recordings, and takes those that lie there")
    arguments.add_argument("--json", metavar="FILE")
    options = arguments.parse_args()
    report: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(options.folder or scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for offset, (task, count) in enumerate(EPISODES.items()):
            file = folder / f"{task}.pickle"
            if not file.exists():
                seed = options.seed + 100 * offset
                print(f"recording {count} episodes of {task}, apartments from {seed}", flush=True)
                file.write_bytes(pickle.dumps(record(task, options.perception, seed, count)))
        jobs = multiprocessing.get_context("spawn").Pool(options.workers, _begin, (str(folder), options.perception))
        with jobs as pool:
            for base in options.methods:
                names = list(trials(base, options.trials, options.seed))
                first = sorted((aim(found), name) for name, found in pool.imap_unordered(_try, [(n, 0) for n in names]))
                kept = [name for _, name in first[: max(4, options.trials // 8)]]
                kept += [base] if base not in kept else []
                second = sorted(
                    ((aim(found), name, found) for name, found in pool.imap_unordered(_try, [(n, 1) for n in kept])),
                    key=lambda entry: entry[0],
                )
                report[base] = [_entry(*entry) for entry in second]
                _print(base, len(names), report[base])
    if options.json:
        Path(options.json).write_text(json.dumps(report, indent=1), encoding="utf-8")
    return 0


def _entry(value: float, name: str, scores: dict[str, list[tuple[int, dict[str, Any]]]]) -> dict[str, Any]:
    columns = {task: {column: _mean(scores[task], column) for column in SHOWN[task]} for task in SHOWN}
    return {"name": name, "aim": value, "columns": columns}


def _print(base: str, count: int, entries: list[dict[str, Any]]) -> None:
    print(f"\n{base}: {count} trials; the best on the other half of the apartments")
    heads = [f"{task[0]}.{column}" for task, columns in SHOWN.items() for column in columns]
    print(f"  {'aim':>6s}  " + " ".join(f"{head:>11s}" for head in heads))
    for entry in entries:
        figures = [entry["columns"][task][column] for task, columns in SHOWN.items() for column in columns]
        print(f"  {entry['aim']:6.2f}  " + " ".join(f"{f[0]:5.1f} ±{(f[2] - f[1]) / 2:4.1f}" for f in figures))
        print(f"          {entry['name']}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
