"""Our search in H*Bench: a belief about the target's direction, and what the next view is expected to tell.

Every look updates a `Belief` in the world frame. Directions that were looked at without a response lose belief, others
keep theirs. What a view tells is the mutual information between the outcome of the look and the target's direction;
`eagor.lab.agents.steering` chooses by it. The submission is the window with the most belief.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import convolve1d

from eagor._values import lazy
from eagor.belief import Belief
from eagor.evidence import Evidence
from eagor.grids import PatchGrid
from eagor.harmonics.peaks import decoding_grid
from eagor.lab.tasks.hstar import HFOV_DEG, PITCH_TOLERANCE, YAW_TOLERANCE, Kind, View
from eagor.perception.partial import coverage
from eagor.tracking.looking import even_and_usual, information

# Tuned on development apartments (random trials, benchmarks/search.py --fit of commit 5a35d191): the model of a look
# and the probability that is stated; the prior on development scenes with things at all heights.
DEGREE = 15  # of the harmonics
HIT, ALARM = 0.7, 0.2  # model of a look: probabilities of a detection of a target in view, and of a false alarm
# Share of a look that repeats the one before, as a model's errors persist; of the one before that, its square; ...
REPEATS = 0.48
HEIGHT, TILT = -15.0, 20.0  # degrees: mean and standard deviation of the elevation where things usually are
SURE, ELSEWHERE = 0.95, 0.5  # defaults of the settings of these names
# Of the probability stated for a window with the share p of the belief: logit(stated) = SHIFT + SLOPE logit(p) (Platt
# 1999), by the log score at each of ten turns. Looks are read cautiously, so the belief is underconfident.
SHIFT, SLOPE = 1.44, 1.24

STEP = 5  # degrees: cells of the map for planning and decisions
CELLS = PatchGrid(180 // STEP, 360 // STEP)
YAWS = np.arange(0, 360, 15)
PITCHES = (-60, -30, 0, 30, 60)
# Of the views that are weighed: azimuth and elevation ``(n, 2)``, radians, world frame.
HEADINGS = np.radians([(-yaw, pitch) for pitch in PITCHES for yaw in YAWS])


class Answer(NamedTuple):
    """A submission in whole degrees, and its probability of success according to the belief, NaN if it has none."""

    yaw: int
    pitch: int
    probability: float = math.nan


def prior_of(kind: Kind, elsewhere: float = ELSEWHERE) -> np.ndarray:
    """Prior probability of each of `CELLS` ``(H, W)``, up to a factor.

    A share `elsewhere` is even over the sphere; the rest has a normal density in the elevation. For paths all is even.
    """
    if kind == "hps":
        return CELLS.weights
    return even_and_usual(np.degrees(CELLS.latitudes)[:, None], CELLS.weights, HEIGHT, TILT, elsewhere)


def stated(share: float) -> float:
    """The calibrated probability that the window with this share of the belief is right."""
    share = min(max(share, 1e-6), 1 - 1e-6)
    return 1 / (1 + math.exp(-SHIFT - SLOPE * math.log(share / (1 - share))))


@dataclass(frozen=True, eq=False)
class Search:
    """The state after some looks. Immutable: `update` returns a new one.

    Per cell of `CELLS`: `prior`, up to a factor; `shown`, the visible fraction so far; `stale`, the fraction of the
    next look that repeats earlier ones. A look counts for less towards the border of its view, as its evidence does.
    """

    kind: Kind
    prior: np.ndarray
    belief: Belief
    shown: np.ndarray
    stale: np.ndarray

    @classmethod
    def begin(cls, kind: Kind, elsewhere: float = ELSEWHERE) -> Search:
        """The state before the first look; `elsewhere`: of the prior (`prior_of`)."""
        nothing = np.zeros(CELLS.shape)
        return cls(kind, prior_of(kind, elsewhere), Belief.uniform(DEGREE), nothing, nothing)

    def update(self, evidence: Evidence, world_R_capture: np.ndarray, view: View) -> Search:
        """The state after one more look: its evidence, the pose of the evidence's frame, and the view.

        The look counts for less where it repeats recent ones: a model's errors persist.
        """
        belief = self.belief
        if not self.stale.any():
            belief = belief.update(evidence, world_R_capture)
        elif evidence.detections is None:
            new = self._new_at(evidence.grid.directions @ world_R_capture.T)
            belief = belief.update(replace(evidence, drawn=evidence.log_ratio * new), world_R_capture)
        else:
            basis, grid = belief.basis, decoding_grid(DEGREE)
            new = self._new_at(grid.directions @ world_R_capture.T)
            log_ratio = basis.synthesise(evidence.coefficients(DEGREE), grid)
            belief = belief.plus(basis.rotate(basis.analyse(log_ratio * new, grid), world_R_capture))
        shares, weights = _shown_by(view)
        shown, stale = np.maximum(self.shown, shares), REPEATS * np.maximum(self.stale, weights)
        return replace(self, belief=belief, shown=shown, stale=stale)

    def _new_at(self, directions: np.ndarray) -> np.ndarray:
        """The fraction ``(...)`` of a look at directions ``(..., 3)`` of the world that is new."""
        x, y, _ = CELLS.project(directions)
        rows = np.clip(y.astype(np.intp), 0, CELLS.height - 1)
        return 1 - self.stale[rows, x.astype(np.intp) % CELLS.width]

    @lazy
    def probability(self) -> np.ndarray:
        """The probability of each cell of `CELLS` ``(H, W)``; sums to 1.

        The belief counts only where something was looked at: elsewhere it is ringing from its finite degree.
        """
        field = np.asarray(self.belief.log_ratio(CELLS)) * self.shown
        found = np.exp(field - field.max()) * self.prior
        return found / found.sum()

    def answer(self) -> Answer:
        """The submission whose window holds most of the belief, centred on that belief."""
        p = self.probability
        high, wide = (CELLS.height if self.kind == "hps" else PITCH_TOLERANCE // STEP), YAW_TOLERANCE[self.kind] // STEP
        # What the smallest window around each cell holds; cells at its border count half.
        mass = _sums(p, np.r_[0.5, np.ones(2 * high - 1), 0.5], np.r_[0.5, np.ones(2 * wide - 1), 0.5])
        # Of equal windows the one with its belief in the middle.
        near = np.where(mass >= mass.max() - 1e-9, _sums(p, np.ones(3), np.ones(3)), -1.0)
        row, column = np.unravel_index(int(near.argmax()), p.shape)
        rows = np.arange(max(0, row - high), min(CELLS.height, row + high + 1))
        columns = np.arange(column - wide, column + wide + 1) % CELLS.width
        part = p[np.ix_(rows, columns)]
        yaws = -np.degrees(CELLS.longitudes)[columns]
        offset = (yaws - yaws[wide] + 180.0) % 360.0 - 180.0
        yaw = yaws[wide] + float((part * offset).sum() / part.sum())
        pitch = float((part * np.degrees(CELLS.latitudes)[rows][:, None]).sum() / part.sum())
        pitch = 0 if self.kind == "hps" else max(-90, min(90, round(pitch)))
        return Answer(round(yaw) % 360, pitch, stated(float(mass[row, column])))

    def tells(self) -> np.ndarray:
        """Expected information of looks at `HEADINGS` ``(n,)`` about the target's direction, nats."""
        return np.concatenate([_information(self.probability, 1 - self.stale, pitch) for pitch in PITCHES])


def _information(p: np.ndarray, new: np.ndarray, pitch: float) -> np.ndarray:
    """Mutual information (nats) of a look with this pitch, for each of `YAWS`; `new`: the fraction of each cell's look.

    A target in view is reported with the probability `HIT`; else there is a false report, anywhere, with `ALARM`.
    """
    shown = _shown_by(View(0.0, float(pitch)))[1]
    rows, columns = np.nonzero(shown)
    places = (columns[None] + (YAWS // STEP)[:, None]) % CELLS.width  # cells in view, for each yaw
    here, share = p[rows[None], places], HIT * shown[rows, columns] * new[rows[None], places]
    area = CELLS.weights[rows, columns]
    return information(here, share, ALARM, area / area.sum())


@lru_cache(maxsize=256)
def _shown_by(view: View) -> tuple[np.ndarray, np.ndarray]:
    """The fraction of each cell ``(H, W)`` that a view shows, and its weight: less towards the border.

    The evidence of a view rises from its border as sin^2 and is full pi / (DEGREE + 1) inside.
    """
    rays, grid = CELLS.directions @ view.world_R_view, view.grid()
    half_width = math.tan(math.radians(HFOV_DEG) / 2)
    half_height = half_width * grid.height / grid.width
    to_sides = (half_width * rays[..., 0] - np.abs(rays[..., 1])) / math.hypot(1, half_width)
    to_ends = (half_height * rays[..., 0] - np.abs(rays[..., 2])) / math.hypot(1, half_height)
    depth = np.arcsin(np.clip(np.minimum(to_sides, to_ends), -1, 1))
    shares = coverage(*CELLS.shape, grid)
    return shares, shares * np.sin(np.clip(depth * (DEGREE + 1) / 2, 0, math.pi / 2)) ** 2


def _sums(p: np.ndarray, tall: np.ndarray, wide: np.ndarray) -> np.ndarray:
    """The sums of `p` about each cell ``(H, W)``, with these weights of the rows and of the columns around it."""
    return convolve1d(convolve1d(p, wide, axis=1, mode="wrap"), tall, axis=0, mode="constant")
