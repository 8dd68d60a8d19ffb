"""A camera walks past a thing, and nobody knows where it is: what is worth that the tracker expects parallax?

    python benchmarks/parallax.py [--runs 100] [--seed 8900]

The thing is 1 to 5 m ahead and up to 2.5 m aside; the camera walks at 0.4 to 1.2 m/s and turns by up to 9 degrees a
second, as the poses say. For 12 s a detector looks twice a second: it finds the thing in 85 % of the looks, 1.1 degrees
off per axis, with a false alarm in one of 20. `expects` is `DirectionTracker.expect_parallax`, which a loop calls where
the pictures tell poses; `positions` knows where the camera is. Errors in degrees, the share of 90 % regions that hold
the truth, and the log density there; 95 % bootstrap intervals over runs.
"""

from __future__ import annotations

import math

import common
import numpy as np

import eagor
from eagor.lab.agents.methods import make_estimator
from eagor.sphere import angular_distance, unit, world_R_body

LOOKS, STEP, FOUND, ALARMS, SPREAD = 24, 0.5, 0.85, 0.05, 0.02
OURS, RIVALS = ("eagor", "expects", "positions"), ("last_detection", "vmf", "grid_filter", "particle_filter")
Row = tuple[float, float, float]


def played(seed: int) -> dict[str, Row]:
    """One walk: each method's mean error, share of regions that hold the truth, and log density (NaN: it has none)."""
    rng = np.random.default_rng(seed)
    thing = rng.uniform([1, -2.5, -1], [5, 2.5, 0.5])
    pace, turn = rng.uniform(0.4, 1.2), rng.uniform(-0.15, 0.15)
    trackers = {name: eagor.DirectionTracker() for name in OURS}
    trackers["expects"].expect_parallax()
    rivals = {name: make_estimator(name, np.random.default_rng(seed)) for name in RIVALS}
    rows: dict[str, list[Row]] = {name: [] for name in (*RIVALS, *OURS)}
    for stamp in STEP * np.arange(LOOKS):
        position, pose = np.array([pace * stamp, 0.0, 0.0]), world_R_body(turn * stamp)
        truth, found = unit(thing - position) @ pose, np.zeros((0, 3))
        if rng.random() < FOUND:
            found = unit(truth + SPREAD * rng.normal(size=(1, 3)))
        if rng.random() < ALARMS:
            found = np.vstack([found, unit(rng.normal(size=(1, 3)))])
        look = eagor.Evidence.from_points(found, detector=eagor.DetectorModel(), stamp=stamp)
        for name, rival in rivals.items():
            rival.move(stamp, pose, None)
            rival.see(look)
            above = rival.mass_above(truth)
            off = math.degrees(angular_distance(rival.direction(), truth))
            rows[name].append((off, math.nan if above is None else above <= 0.9, math.nan))
        for name, tracker in trackers.items():
            tracker.add_pose(stamp, pose, position if name == "positions" else None)
            tracker.observe(look)
            told = tracker.estimate(stamp)
            off = 90.0 if told.direction is None else math.degrees(angular_distance(told.direction, truth))
            rows[name].append((off, told.mass_above(truth) <= 0.9, float(told.log_density(truth))))
    return {name: tuple(np.mean(each, axis=0)) for name, each in rows.items()}


def main() -> None:
    given = common.parser(__doc__, runs=100, seed=8900).parse_args()
    runs = [played(given.seed + run) for run in range(given.runs)]
    print(f"{'method':16s}{'error, deg':>24s}{'90 % regions hold':>24s}{'log density':>24s}")
    for name in (*RIVALS, *OURS):
        columns = np.array([run[name] for run in runs]).T
        print(f"{name:16s}" + "".join(f"{common.shown(column):>24s}" for column in columns))


if __name__ == "__main__":
    main()
