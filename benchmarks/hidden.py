"""Walls: from a share of the view points a thing cannot be seen. What is it worth that the detector's model says so?

    python benchmarks/hidden.py [--runs 100] [--seed 8900]

A camera walks 9 m past a thing, which is there in 7 runs of 10, and past something that is taken for it. In each metre
both draw anew how often they are detected (the default habits), and in the second world whether they can be seen at
all. `DetectorModel(hidden=)` is told nothing, 0.3 or 0.5. The score is the log of the probability that was given to the
truth: present and within 15 degrees, or absent; the difference to nothing told is paired by run, intervals are 95 %
bootstrap intervals over runs.
"""

from __future__ import annotations

import math

import common
import numpy as np

import eagor
from eagor.evidence.detector import HABIT, LOOK_ALIKE_HABIT
from eagor.sphere import angular_distance, unit, world_R_body

LOOKS, STEP, PACE = 60, 0.5, 0.15  # looks, seconds from look to look, metres from look to look
SPREAD, ALARMS, THERE = math.radians(4), 0.15, 0.7  # of detections; false alarms a look; share of runs with the thing
WALLS, TOLD = (0.0, 0.5), (0.0, 0.3, 0.5)
EVERY = 6  # looks from answer to answer that is scored
GRID = eagor.ErpGrid(90, 180)
LEAST = 1e-6  # probabilities are clipped from below


def played(seed: int, walls: float, told: float) -> tuple[bool, float, float]:
    """One run: whether the thing is there, the mean score, and the mean error in degrees."""
    rng, tracker = np.random.default_rng(seed), eagor.DirectionTracker()
    model = eagor.DetectorModel(spread=SPREAD, hidden=told)
    here, places = bool(rng.random() < THERE), rng.uniform([[2, -4, 0], [-4, -4, 0.3]], [[6, 4, 0], [4, 4, 0.3]])
    seen, shares, scores, errors, view = np.array([here, True]), np.zeros(2), [], [], -1
    for look in range(LOOKS):
        position, pose = np.array([PACE * look, 0.3 * math.sin(0.2 * look), 0.0]), world_R_body(0.05 * look)
        if int(position[0]) > view:
            seen = (rng.random(2) >= walls * (view >= 0)) & [here, True]
            view, shares = int(position[0]), np.array([rng.beta(*HABIT), rng.beta(*LOOK_ALIKE_HABIT)])
        found = unit(unit((places - position)[seen & (rng.random(2) < shares)]) + SPREAD * rng.normal(size=3))
        found = np.concatenate([found @ pose, unit(rng.normal(size=(rng.poisson(ALARMS), 3)))])
        tracker.add_pose(STEP * look, pose, position)
        tracker.observe(eagor.Evidence.from_points(found, detector=model, stamp=STEP * look))
        if look % EVERY == EVERY - 1:
            estimate, truth = tracker.estimate(STEP * look), unit(places[0] - position) @ pose
            near = GRID.directions @ truth > math.cos(math.radians(15))
            held = estimate.presence * float((estimate.density(GRID) * GRID.weights)[near].sum())
            scores.append(math.log(max(held if here else 1 - estimate.presence, LEAST)))
            known = estimate.direction is not None
            errors.append(math.degrees(angular_distance(estimate.direction, truth)) if known else 90.0)
    return here, float(np.mean(scores)), float(np.mean(errors))


def main() -> None:
    given = common.parser(__doc__, runs=100, seed=8900).parse_args()
    print(f"{'hidden, told':14s}{'score, there':>24s}{'score, absent':>24s}{'error, deg':>24s}{'- 0 told':>24s}")
    for walls in WALLS:
        base = np.zeros(given.runs)
        for told in TOLD:
            rows = [played(given.seed + run, walls, told) for run in range(given.runs)]
            here, scores, errors = (np.array(column) for column in zip(*rows, strict=True))
            base = scores if told == 0 else base
            columns = scores[here], scores[~here], errors[here], scores - base
            print(f"{walls:6.1f}{told:6.1f}  " + "".join(f"{common.shown(column):>24s}" for column in columns))


if __name__ == "__main__":
    main()
