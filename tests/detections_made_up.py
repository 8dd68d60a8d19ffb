"""A detector with known numbers, in looks of a tumbling camera: for tests of what fits a model to detections."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from eagor.evidence import Evidence
from eagor.sphere import unit


class Detected(NamedTuple):
    """One look: directions in the body frame ``(n, 3)``, of the targets and of what was detected."""

    group: int
    step: int
    world_R_body: np.ndarray
    targets: np.ndarray
    points: np.ndarray
    scores: np.ndarray

    @property
    def stamp(self):
        return 0.5 * self.step

    @property
    def evidence(self):
        return Evidence.from_points(self.points, scores=self.scores, stamp=self.stamp)


def detected(
    rng, groups=12, each=20, habit=(1.5, 1.0), alarms=0.3, spread=0.1, offset=0.0, alikes=0.0, alike=(0.5, 2.0),
    targets=(0, 1, 2), right=(4, 2), false=(2, 4),
):  # fmt: skip
    """`groups` of `each` looks. `right`, `false`: Beta distributions of scores."""
    found = []
    for group in range(groups):
        count, others = targets[group % len(targets)], rng.poisson(alikes)
        at, bad = (unit(rng.normal(size=(n, 3))) if n else np.zeros((0, 3)) for n in (count, others))
        shares, bad_shares = rng.beta(*habit, size=count), rng.beta(*alike, size=others)
        kept = at + offset * rng.normal(size=(count, 3))
        for step in range(each):
            turn = Rotation.random(rng=rng).as_matrix()
            seen = (kept + spread * rng.normal(size=(count, 3)))[rng.random(count) < shares]
            wrong = (bad + spread * rng.normal(size=(others, 3)))[rng.random(others) < bad_shares]
            wrong = np.concatenate([wrong, rng.normal(size=(rng.poisson(alarms), 3))])
            scores = np.concatenate([rng.beta(*right, size=len(seen)), rng.beta(*false, size=len(wrong))])
            found.append(Detected(group, step, turn, at @ turn, np.concatenate([seen, wrong]) @ turn, scores))
    return found
