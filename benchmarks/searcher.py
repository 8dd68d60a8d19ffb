"""What a step of the search costs: CPU milliseconds of the steering alone, over episodes of development apartments.

    python benchmarks/searcher.py [--episodes 10] [--seed 100] [--methods eagor vmf]

Prints one JSON object: milliseconds per step (median, 95th percentile, largest), steps, and metres of floor that were
known at the end of the largest search.
"""

from __future__ import annotations

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import argparse
import json
import sys
import time

import numpy as np

from eagor.tasks import task as tasks
from eagor.tasks.episodes import Slot
from eagor.tasks.floor_map import CELL
from eagor.tasks.places import APARTMENT
from eagor.tasks.play import Player
from eagor.tasks.rules import Camera, Disturbances, NavigationRules, as_dict
from eagor.tasks.search_space import SteeringInput
from eagor.tasks.searcher import Searcher

EACH = 5  # episodes in an apartment


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--episodes", type=int, default=10)
    options.add_argument("--seed", type=int, default=100)
    options.add_argument("--methods", nargs="+", default=["eagor", "vmf"])
    given = options.parse_args()
    spent: list[float] = []
    largest = [0.0, 0.0]
    plain = Searcher.walk

    def timed(self: Searcher, now: SteeringInput) -> tuple[float, float]:
        begun = time.process_time()
        found = plain(self, now)
        spent.append(1000 * (time.process_time() - begun))
        largest[:] = max(largest, [CELL * size for size in self.known.state.shape])
        return found

    Searcher.walk = timed
    rules = {"rules": as_dict(NavigationRules()), "disturbances": as_dict(Disturbances())}
    player = Player({"task": "navigation", "perception": "truth", "camera": as_dict(Camera()), "rows": 256} | rules)
    kind = tasks.load("navigation")
    for number in range(given.episodes):
        slot = Slot(kind.name, APARTMENT, given.seed + number // EACH, number % EACH, number)
        player.play(slot, given.methods)
    low, high, most = np.quantile(spent, [0.5, 0.95, 1.0])
    report = {"steps": len(spent), "cpu_ms_per_step": {"p50": low, "p95": high, "max": most}, "floor_m": largest}
    print(json.dumps(report, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
