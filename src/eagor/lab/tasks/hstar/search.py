"""What is searched: a belief about the target in the world frame, the directions looked at, and what looks would tell.

Every look updates a `Belief`: directions that were looked at without a response lose belief, others keep theirs. A grid
records which directions were looked at. What a view tells is the mutual information between the outcome of the look and
the target's direction; `eagor.lab.agents.steering` chooses by it. The submission is the window with the most belief.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np

from eagor._checks import above, require, whole, within
from eagor._values import lazy
from eagor.belief import Belief
from eagor.evidence import Evidence
from eagor.grids import PatchGrid, PerspectiveGrid
from eagor.harmonics.peaks import decoding_grid
from eagor.lab.tasks.hstar.rules import HFOV_DEG, PITCH_TOLERANCE, YAW_TOLERANCE, View, headings_of, size_of
from eagor.perception.partial import coverage
from eagor.sphere import world_R_body
from eagor.tracking.looking import even_and_usual, information

STEP = 5  # degrees: cells of the map for planning and decisions
CELLS = PatchGrid(180 // STEP, 360 // STEP)
YAWS = np.arange(0, 360, 15)
PITCHES = (-60, -30, 0, 30, 60)
_HEADINGS = headings_of(np.tile(YAWS, len(PITCHES)), np.repeat(PITCHES, len(YAWS)))


@dataclass(frozen=True)
class SearchRules:
    """Parameters of the belief and the decisions.

    - `degree`: of the harmonics.
    - `sure`: probability of success from which on it submits.
    - `hit`, `alarm`: model of a look for planning: the probabilities of a detection of a target in view, and of a false
      alarm.
    - `repeats`: share of a look that repeats the look before it where both look, since a model's errors persist for a
      while. Of the look before that one it repeats `repeats` squared, and so on.
    - `elsewhere`: the share of the prior's probability that is even over the sphere. The rest has a normal density in
      the elevation, with the standard deviation `tilt` and the mean `height`, degrees; `tilt` 0: all of it is even.
      Silent looks where things usually are move the belief to the even part, without any further rule.
    - `shift`, `slope`: calibration of the probability stated for a window with the share p of the belief,
      logit(stated) = shift + slope logit(p) (Platt 1999): looks are read cautiously, so the belief is underconfident.

    The defaults were tuned on development apartments (random trials, ``benchmarks/search.py --fit`` of commit
    5a35d191), `shift` and `slope` by the log score of the probability stated at each of ten turns; the prior on
    development scenes with things at all heights.

    Raises `EagorError` for numbers out of range.
    """

    degree: int = 15
    sure: float = 0.95
    hit: float = 0.7
    alarm: float = 0.2
    repeats: float = 0.48
    tilt: float = 20.0
    height: float = -15.0
    elsewhere: float = 0.5
    shift: float = 1.44
    slope: float = 1.24

    def __post_init__(self) -> None:
        wanted = {
            "degree": (whole(self.degree, 1), "a whole number, 1 or more"),
            "sure": (above(self.sure, 0, 1), "a probability above 0, at most 1"),
            "hit": (within(self.hit, 0, 1), "a probability from 0 to 1"),
            "alarm": (within(self.alarm, 0, 1) and self.alarm < 1, "a probability from 0 to below 1"),
            "repeats": (within(self.repeats, 0, 1), "a share from 0 to 1"),
            "tilt": (within(self.tilt, 0), "degrees, 0 or more"),
            "height": (within(self.height, -90, 90), "degrees from -90 to 90"),
            "elsewhere": (above(self.elsewhere, 0, 1), "a share above 0 (nowhere is a target impossible), at most 1"),
            "shift": (within(self.shift, -100, 100), "a number from -100 to 100"),
            "slope": (above(self.slope, 0, 100), "a number above 0, at most 100"),
        }
        require(self, wanted)

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> SearchRules:
        """The rules of a run, whose settings may hold some of them by name. Raises `EagorError`."""
        return cls(**{rule.name: settings[rule.name] for rule in fields(cls) if rule.name in settings})

    def stated(self, share: float) -> float:
        """The calibrated probability that the window with this share of the belief is right."""
        share = min(max(share, 1e-6), 1 - 1e-6)
        return 1 / (1 + math.exp(-self.shift - self.slope * math.log(share / (1 - share))))


@dataclass(frozen=True)
class Answer:
    """A submission in whole degrees, and its probability of success according to the belief."""

    yaw: int
    pitch: int
    probability: float


@dataclass(frozen=True, eq=False)
class Search:
    """The state after some looks: an `eagor.lab.agents.search_space.Space`. Immutable: `update` returns a new one.

    Per cell of `CELLS`: `shown` is the visible fraction so far, 0 to 1; `stale` the fraction of the next look that
    repeats earlier ones. A look counts for less towards the border of its view, as its evidence does there
    (`eagor.evidence.coverage.taper`).
    """

    kind: str
    rules: SearchRules
    belief: Belief
    shown: np.ndarray
    stale: np.ndarray

    @classmethod
    def begin(cls, kind: str, rules: SearchRules | None = None) -> Search:
        """The state before the first look; `kind` is ``hos`` or ``hps``."""
        rules = rules or SearchRules()
        return cls(kind, rules, Belief.uniform(rules.degree), np.zeros(CELLS.shape), np.zeros(CELLS.shape))

    def update(self, evidence: Evidence, world_R_capture: np.ndarray, view: View) -> Search:
        """The state after one more look: its evidence, the pose of the evidence's frame, and the view."""
        pitch = round(view.pitch)
        shown = np.maximum(self.shown, _rolled(_shares(pitch), view.yaw))
        stale = self.rules.repeats * np.maximum(self.stale, _rolled(_weights(pitch, self.rules.degree), view.yaw))
        return Search(self.kind, self.rules, self._with_new_part(evidence, world_R_capture), shown, stale)

    def _with_new_part(self, evidence: Evidence, world_R_capture: np.ndarray) -> Belief:
        """The belief with a look, weakened where it repeats recent looks: a model's errors persist."""
        if not self.stale.any():
            return self.belief.update(evidence, world_R_capture)
        if evidence.detections is None:
            new = self._new_at(evidence.grid.directions @ world_R_capture.T)
            return self.belief.update(replace(evidence, drawn=evidence.log_ratio * new), world_R_capture)
        basis, grid = self.belief.basis, decoding_grid(self.rules.degree)
        log_ratio = basis.synthesise(evidence.coefficients(self.rules.degree), grid)
        new = self._new_at(grid.directions @ world_R_capture.T)
        return self.belief.plus(basis.rotate(basis.analyse(log_ratio * new, grid), world_R_capture))

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
        found = np.exp(field - field.max()) * _prior(self.rules, self.kind)
        return found / found.sum()

    def answer(self) -> Answer:
        """The submission whose window holds most of the belief, centred on that belief."""
        p = self.probability
        mass = _window_mass(p, self.kind)
        best = mass >= mass.max() - 1e-9
        row, column = np.unravel_index(int(np.argmax(np.where(best, _blurred(p), -1.0))), p.shape)
        high, wide = _reach(self.kind)
        rows = np.arange(max(0, row - high), min(CELLS.height, row + high + 1))
        columns = np.arange(column - wide, column + wide + 1) % CELLS.width
        part = p[np.ix_(rows, columns)]
        yaws = -np.degrees(CELLS.longitudes)[columns]
        offset = (yaws - yaws[wide] + 180.0) % 360.0 - 180.0
        yaw = yaws[wide] + float((part * offset).sum() / part.sum())
        pitch = float((part * np.degrees(CELLS.latitudes)[rows][:, None]).sum() / part.sum())
        pitch = 0 if self.kind == "hps" else max(-90, min(90, round(pitch)))
        return Answer(round(yaw) % 360, pitch, self.rules.stated(float(mass[row, column])))

    @property
    def headings(self) -> np.ndarray:
        """The headings ``(n, 2)`` of the views that are weighed: azimuth and elevation, radians, world frame."""
        return _HEADINGS

    def tells(self) -> np.ndarray:
        """Expected information of each of those views ``(n,)`` about the target's direction, nats."""
        p, rules, new = self.probability, self.rules, 1 - self.stale
        shown = [_weights(pitch, rules.degree) for pitch in PITCHES]
        return np.concatenate([_information(p, new, weights, rules.hit, rules.alarm) for weights in shown])


def _information(p: np.ndarray, new: np.ndarray, shown: np.ndarray, hit: float, alarm: float) -> np.ndarray:
    """Mutual information (nats) of a look, for each of `YAWS`; `shown`: the fraction of each cell in view from yaw 0.

    A target in view is reported there with the probability `hit`, less where the look repeats another; otherwise there
    is a false report with probability `alarm`, uniform over the view.
    """
    rows, columns = np.nonzero(shown)
    places = (columns[None] + (YAWS // STEP)[:, None]) % CELLS.width  # cells in view, for each yaw
    here, share = p[rows[None], places], hit * shown[rows, columns] * new[rows[None], places]
    area = CELLS.weights[rows, columns]
    return information(here, share, alarm, area / area.sum())


def _shares(pitch: int) -> np.ndarray:
    """The fraction of each cell ``(H, W)`` that a view at yaw 0 and this pitch shows."""
    (height, width), pose = size_of(), world_R_body(0.0, -math.radians(pitch))
    return coverage(*CELLS.shape, PerspectiveGrid(height, width, math.radians(HFOV_DEG), pose))


@lru_cache(maxsize=256)
def _weights(pitch: int, degree: int) -> np.ndarray:
    """The weight of a look from yaw 0 at this pitch in each cell ``(H, W)``, 0 to 1.

    The evidence of a view rises from its border as sin^2 and is full pi / (degree + 1) inside.
    """
    rays = CELLS.directions.reshape(-1, 3) @ View(0.0, pitch).world_R_view
    rows, columns = size_of()
    half_width = math.tan(math.radians(HFOV_DEG) / 2)
    half_height = half_width * rows / columns
    to_sides = (half_width * rays[:, 0] - np.abs(rays[:, 1])) / math.hypot(1, half_width)
    to_ends = (half_height * rays[:, 0] - np.abs(rays[:, 2])) / math.hypot(1, half_height)
    depth = np.arcsin(np.clip(np.minimum(to_sides, to_ends), -1, 1)).reshape(CELLS.shape)
    found = _shares(pitch) * np.sin(np.clip(depth * (degree + 1) / 2, 0, math.pi / 2)) ** 2
    found.setflags(write=False)
    return found


def _rolled(shares: np.ndarray, yaw: float) -> np.ndarray:
    """`shares` of a view at yaw 0 moved to `yaw` degrees (columns grow to the right), interpolated between cells."""
    steps = yaw / STEP
    low = math.floor(steps)
    part = steps - low
    found = np.roll(shares, low, axis=1)
    return found if part < 1e-9 else found * (1 - part) + np.roll(shares, low + 1, axis=1) * part


@lru_cache(maxsize=16)
def _prior(rules: SearchRules, kind: str) -> np.ndarray:
    """Prior probability of each cell, up to a factor."""
    if rules.tilt <= 0 or kind == "hps":
        return CELLS.weights
    elevations = np.degrees(CELLS.latitudes)[:, None]
    return even_and_usual(elevations, CELLS.weights, rules.height, rules.tilt, rules.elsewhere)


def _reach(kind: str) -> tuple[int, int]:
    """Half size of the smallest window in cells: rows, columns."""
    return (CELLS.height if kind == "hps" else PITCH_TOLERANCE // STEP), YAW_TOLERANCE[kind] // STEP


def _window_mass(p: np.ndarray, kind: str) -> np.ndarray:
    """The probability within the window around each cell; cells at the window's border count half."""
    from scipy.ndimage import convolve1d

    tall, wide = (np.r_[0.5, np.ones(2 * reach - 1), 0.5] for reach in _reach(kind))
    found = convolve1d(p, wide, axis=1, mode="wrap")
    if kind == "hps":
        return np.broadcast_to(found.sum(axis=0), p.shape)
    return convolve1d(found, tall, axis=0, mode="constant")


def _blurred(p: np.ndarray) -> np.ndarray:
    """`p` averaged over neighbours, to choose among equal windows the one with its belief in the middle."""
    wide = p + np.roll(p, 1, axis=1) + np.roll(p, -1, axis=1)
    padded = np.pad(wide, ((1, 1), (0, 0)))
    return padded[:-2] + padded[1:-1] + padded[2:]
