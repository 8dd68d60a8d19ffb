"""A detector's measurement model: what a set of detections says about where the target is, and whether it is there.

One target that may be absent (a Bernoulli random finite set; Ristic, Vo, Vo and Farina, IEEE Transactions on Signal
Processing 61(13), 2013). A look sees the share v(w) of direction w. A target there is detected with probability P_D,
at a place with density g(z | w), among false alarms that are Poisson with intensity lambda(z) per steradian. Against
"not here", the set Z of one look has the likelihood ratio

    L(w) = 1 - v(w) P_D + v(w) P_D sum_i s_i g(z_i | w) / lambda(z_i),    s_i = p(score_i | thing) / p(score_i | false).

Its logarithm is the evidence. Nobody knows P_D and lambda for a new scene, so that by default both are learnt with the
belief (`Rates`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache

import numpy as np

from eagor._lazy import lazy

from eagor._checks import above, require, within
from eagor.errors import ResponseError
from eagor.grids import ErpGrid, FisheyeGrid, Grid, PerspectiveGrid
from eagor.peaks import decoding_grid
from eagor.sphere import cross

RESOLVED = math.radians(115)  # over degree + 1: the narrowest likelihood whose logarithm a degree holds without loss
CLUTTER_FLOOR = 1e-3  # relative density of false alarms: no place is so clean that one there would be a proof
# The prior of what is learnt: probabilities of detection and mean numbers of false alarms, with their weights.
RECALLS, RECALL_WEIGHTS = (0.1, 0.3, 0.5, 0.7, 0.9), (0.1, 0.2, 0.2, 0.25, 0.25)
ALARMS = (0.02, 0.06, 0.2, 0.6, 2.0, 6.0)
# How many times as wide as stated the spread may turn out, and how likely that is.
UNLIKELY = 1e-4  # a scale with less weight is not reckoned with
SCALES, SCALE_WEIGHTS = (0.5, 1.0, 2.0), (0.06, 0.88, 0.06)


@dataclass(frozen=True)
class DetectorModel:
    """How a detector errs. Each number has a meaning that can be counted on a few labelled frames.

    - `detection_probability` (P_D): that a target in view is detected. None: not known, learnt with the belief.
    - `false_alarms_per_look`: mean number of false alarms in what one look covers. None: learnt.
    - `spread`: radians (standard deviation per axis) of a detection about the direction of the thing.
    - `repeats`: share of the mistakes of a look that the next one repeats, in [0, 1): 0 for independent looks. A poster
      is taken for the target again, and what is overlooked once is overlooked again. Of a look that the next one
      repeats, the share 1 - repeats adds up.
    - `score_ratios`: pairs (score, ratio), by rising score: how many times likelier a thing gives this score than a
      false alarm does; between them the logarithm is interpolated. None: the ratio is the score itself, so that a
      detection of score 1 counts in full.
    - `clutter`: relative density of false alarms ``(H, W)`` over a panorama in the body frame; only its shape counts.
      None: even.
    """

    detection_probability: float | None = None
    false_alarms_per_look: float | None = None
    spread: float = math.radians(5)
    repeats: float = 0.0
    score_ratios: tuple[tuple[float, float], ...] | None = None
    clutter: np.ndarray | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        known, alarms = self.detection_probability, self.false_alarms_per_look
        wanted = {
            "detection_probability": (
                known is None or (above(known, 0, 1) and known < 1),
                "a probability above 0 and below 1 (0.99 for a very good detector), or None to learn it",
            ),
            "false_alarms_per_look": (alarms is None or above(alarms, 0), "a mean number above 0, or None to learn it"),
            "spread": (
                within(self.spread, math.radians(0.01), math.radians(60)),
                "radians, from 0.01 to 60 degrees (given in degrees? use math.radians)",
            ),
            "repeats": (within(self.repeats, 0, 1) and self.repeats < 1, "a share from 0, below 1"),
            "score_ratios": (_is_curve(self.score_ratios), "pairs (score, ratio), scores rising, ratios above 0"),
        }
        require(self, wanted, ResponseError)
        if self.clutter is not None:
            density = np.asarray(self.clutter, dtype=np.float64)
            if density.ndim != 2 or not (np.isfinite(density).all() and (density >= 0).all() and density.any()):
                raise ResponseError("clutter: wanted a map (H, W) of numbers from 0 on, not all of them 0")
            grid = ErpGrid(*density.shape)
            density = density / (np.sum(density * grid.weights) / (4 * math.pi))
            density.setflags(write=False)
            object.__setattr__(self, "clutter", density)

    def ratios(self, scores: np.ndarray | None, count: int) -> np.ndarray:
        """s ``(n,)``: how much likelier each score is for the thing than for a false alarm; 1 without scores."""
        if scores is None:
            return np.ones(count)
        if self.score_ratios is None:
            return np.asarray(scores, dtype=np.float64)
        places, values = np.array(self.score_ratios, dtype=np.float64).T
        return np.exp(np.interp(scores, places, np.log(values)))

    def clutter_at(self, directions: np.ndarray) -> np.ndarray:
        """Relative density ``(n,)`` of false alarms at directions ``(n, 3)`` of the body frame; 1 on the mean."""
        if self.clutter is None:
            return np.ones(len(directions))
        height, width = self.clutter.shape
        x, y, _ = ErpGrid(height, width).project(directions)
        found = self.clutter[np.minimum(y.astype(int), height - 1), x.astype(int) % width]
        return np.maximum(found, CLUTTER_FLOOR)


def _is_curve(curve: Sequence[Sequence[float]] | None) -> bool:
    if curve is None:
        return True
    try:
        pairs = np.array(curve, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    if pairs.ndim != 2 or pairs.shape[1] != 2 or not np.isfinite(pairs).all():
        return False
    return bool((np.diff(pairs[:, 0]) > 0).all() and (pairs[:, 1] > 0).all())


@dataclass(frozen=True, eq=False)
class Rates:
    """What is known of a detector: joint weights ``(R, A)`` of `recalls` ``(R,)`` and `alarms` ``(A,)``.

    Where a rate is stated there is one value of it, and nothing to learn. `spreads` ``(S,)``: weights of the stated
    spread times `scales` ``(S,)``: it is taken as stated until the looks contradict it.
    """

    recalls: np.ndarray
    alarms: np.ndarray
    weights: np.ndarray
    scales: np.ndarray = field(default_factory=lambda: np.ones(1))
    spreads: np.ndarray = field(default_factory=lambda: np.ones(1))
    detected: float = 0.0  # number of detections so far,
    precision_used: float = 0.0  # ... and the sum of the precisions that they were read with, over the stated one

    @classmethod
    def prior(cls, model: DetectorModel, learns: bool = False) -> Rates:
        """Before any look; who `learns` from look to look reckons with another spread than the stated one."""
        known, number = model.detection_probability, model.false_alarms_per_look
        recalls = np.array(RECALLS if known is None else (known,))
        share = np.array(RECALL_WEIGHTS if known is None else (1.0,))
        alarms = np.array(ALARMS if number is None else (number,))
        weights = share[:, None] * np.full(len(alarms), 1 / len(alarms))
        if not learns:
            return cls(recalls, alarms, weights)
        return cls(recalls, alarms, weights, np.array(SCALES), np.array(SCALE_WEIGHTS))

    def given(self, count: int) -> Rates:
        """With a look of `count` detections, none of which was the target."""
        log = count * np.log(self.alarms) - self.alarms
        weights = self.weights * np.exp(log - log.max())
        return replace(self, weights=weights / weights.sum())

    @property
    def recall(self) -> float:
        """The mean of P_D."""
        return float(self.weights.sum(axis=1) @ self.recalls)

    @property
    def false_alarms(self) -> float:
        """The mean number of false alarms in a look."""
        return float(self.weights.sum(axis=0) @ self.alarms)

    @property
    def gain(self) -> float:
        """The mean of P_D over the number of false alarms: what one detection weighs."""
        return float(self.recalls @ self.weights @ (1 / self.alarms))

    def learnt(self, presence: float, covered: float, expected: np.ndarray) -> Rates:
        """After a look, of which `given` knows the number.

        `presence`: of the target before the look; `covered`: share of its density that was looked at; `expected`
        ``(S,)``: for each scale the sum over the detections of s_i g(z_i) / lambda(z_i) at one false alarm a look, g
        under that density.
        """
        recalls = self.recalls[:, None]
        seen = 1 - recalls * covered + (recalls / self.alarms) * float(self.spreads @ expected)
        weights = self.weights * (1 - presence + presence * seen)
        spreads = self.spreads * (1 - presence + presence * (1 - self.recall * covered + self.gain * expected))
        return replace(self, weights=weights / weights.sum(), spreads=spreads / spreads.sum())

    def noted(self, count: int) -> Rates:
        """After `count` more detections were read with these spreads."""
        used = self.precision_used + count * self.precision
        return replace(self, detected=self.detected + count, precision_used=used)

    @property
    def precision(self) -> float:
        """The mean of 1 / scale^2."""
        return float(self.spreads @ self.scales**-2.0)

    @property
    def sharpening(self) -> float:
        """What the precision of a peak is to be multiplied with, now that more is known of the spread."""
        return 1.0 if self.detected == 0 else self.precision * self.detected / self.precision_used


@dataclass(frozen=True, eq=False)
class View:
    """What one picture covered: a grid in the body frame, and how far each of its cells was looked at (None: fully)."""

    grid: Grid
    coverage: np.ndarray | None = None

    @property
    def is_whole(self) -> bool:
        """Whether it is all around."""
        partial = isinstance(self.grid, PerspectiveGrid | FisheyeGrid) and self.grid.depth_inside() is not None
        return not partial and self.coverage is None

    def share(self, directions: np.ndarray) -> np.ndarray:
        """v ``(...)`` in [0, 1] at directions ``(..., 3)`` of the body frame."""
        x, y, inside = self.grid.project(directions)
        share = inside.astype(np.float64)
        if self.coverage is not None:
            height, width = self.grid.shape
            column, row = np.where(inside, x, 0.0).astype(int), np.where(inside, y, 0.0).astype(int)
            share *= self.coverage[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        return share


@dataclass(frozen=True, eq=False)
class Detections:
    """The set Z of one look, in the body frame of its time: n detections among what its `views` covered.

    `directions` ``(n, 3)``, with `scores` ``(n,)``. `axes` ``(n, 2, 3)``: the principal directions across each one, over the standard deviation
    along them (radians). `ratios` ``(n,)``: s. `clutter` ``(n,)``: relative density of false alarms there. `views`:
    empty where the whole sphere was looked at.
    """

    model: DetectorModel
    directions: np.ndarray
    axes: np.ndarray
    ratios: np.ndarray
    clutter: np.ndarray
    scores: np.ndarray
    views: tuple[View, ...] = ()

    @classmethod
    def around(
        cls, model: DetectorModel, directions: np.ndarray, axes: np.ndarray, scores: np.ndarray | None, view: View
    ) -> Detections:
        """A look at one picture."""
        ratios, clutter = model.ratios(scores, len(directions)), model.clutter_at(directions)
        scores = np.ones(len(directions)) if scores is None else scores
        return cls(model, directions, axes, ratios, clutter, scores, () if view.is_whole else (view,))

    def __len__(self) -> int:
        return len(self.directions)

    def __repr__(self) -> str:
        return f"Detections({len(self)} in {'a whole look' if not self.views else f'{len(self.views)} views'})"

    @property
    def rates(self) -> Rates:
        """What is known of the rates before any look."""
        return Rates.prior(self.model)

    def joined(self, other: Detections) -> Detections:
        """One look of two pictures of the same moment."""
        views = () if not self.views or not other.views else (*self.views, *other.views)
        pairs = {
            key: np.concatenate([getattr(self, key), getattr(other, key)])
            for key in ("directions", "axes", "ratios", "clutter", "scores")
        }
        return replace(self, views=views, **pairs)

    def turned(self, new_R_old: np.ndarray) -> Detections:
        """The detections alone in other axes (`share` still asks for those of the body)."""
        return replace(self, directions=self.directions @ new_R_old.T, axes=self.axes @ new_R_old.T)

    def at_least(self, least: float) -> Detections:
        """None narrower than `least` radians: each is widened as a likelihood, so that its mass is kept."""
        if least == 0:
            return self
        lengths = np.linalg.norm(self.axes, axis=-1, keepdims=True)
        return replace(self, axes=self.axes * np.minimum(1.0, 1 / np.maximum(least * lengths, 1e-12)))

    def share(self, directions: np.ndarray) -> np.ndarray | float:
        """v ``(...)``: how far each direction ``(..., 3)`` of the body frame was looked at, by any of the views."""
        if not self.views:
            return 1.0
        missed = np.ones(directions.shape[:-1])
        for view in self.views:
            missed *= 1 - view.share(directions)
        return 1 - missed

    def smooth_share(self, degree: int) -> np.ndarray | float:
        """v on the decoding grid of this degree ``(H, W)``, fading to 0 within pi / (degree + 1) inside the border.

        A field that is cut at a degree cannot end sharply: it would ring far into what nobody looked at.
        """
        if not self.views:
            return 1.0
        grid = decoding_grid(degree)
        share = np.asarray(self.share(grid.directions))
        unseen = share < 0.5
        if not unseen.any():
            return share
        depth = border_distance(grid, unseen)
        return share * np.sin(np.clip(depth * (degree + 1) / 2, 0, math.pi / 2)) ** 2

    @lazy
    def area(self) -> float:
        """Solid angle (steradians) of what was looked at."""
        if not self.views:
            return 4 * math.pi
        grid = decoding_grid(15)
        return max(float(np.sum(np.asarray(self.share(grid.directions)) * grid.weights)), 1e-3)

    def read(self, model: DetectorModel) -> Detections:
        """The same set with another model: its spread takes the place of the former one."""
        lengths = np.linalg.norm(self.axes, axis=-1, keepdims=True)
        own = np.maximum(lengths**-2 - self.model.spread**2, 0.0)  # what is the detection's own, such as a box's size
        axes = self.axes / lengths / np.sqrt(own + model.spread**2)
        ratios, clutter = model.ratios(self.scores, len(self)), model.clutter_at(self.directions)
        return replace(self, model=model, axes=axes, ratios=ratios, clutter=clutter)

    def response(self, directions: np.ndarray) -> np.ndarray:
        """The set drawn as a response ``(...)`` in [0, 1]: the highest of score times bump; for who reads responses."""
        if not len(self):
            return np.zeros(directions.shape[:-1], dtype=np.float32)
        drawn = self.bumps(directions) * self.scores
        return (drawn.max(axis=-1) * (np.asarray(self.share(directions)) > 0)).astype(np.float32)

    def densities(self, directions: np.ndarray) -> np.ndarray:
        """s_i g(z_i | w) over the relative clutter ``(..., n)`` at directions w ``(..., 3)``, per steradian."""
        return self.bumps(directions) * (self.ratios / self.clutter * self._norms)

    def scaled(self, scale: float) -> Detections:
        """Each one as many times as wide."""
        return self if scale == 1 else replace(self, axes=self.axes / scale)

    def bumps(self, directions: np.ndarray) -> np.ndarray:
        """g over its maximum ``(..., n)``: Gaussian in Lambert's equal-area plane about z_i.

        Where both axes are alike that is the von Mises-Fisher distribution.
        """
        ahead = directions @ self.directions.T
        along = directions @ self.axes.reshape(-1, 3).T
        along = (along * along).reshape(*ahead.shape, 2).sum(axis=-1)
        exponent = along / np.maximum(1 + ahead, 1e-9)
        return np.exp(-exponent)

    @property
    def _norms(self) -> np.ndarray:
        """1 over the integral ``(n,)`` of each Gaussian; the plane ends at the antipode, a distance of 2."""
        product = np.linalg.norm(self.axes, axis=-1).prod(axis=-1)
        return product / (2 * math.pi * -np.expm1(-2 * product))

    def ratio(
        self,
        directions: np.ndarray,
        rates: Rates | None = None,
        share: np.ndarray | float | None = None,
        least: float = 0.0,
    ) -> np.ndarray:
        """L ``(...)`` at directions ``(..., 3)``, both in the axes of the detections, with `rates` after `Rates.given`.

        `share`: v there (default: as `share` has it, in the axes of the body). `least`: radians; no detection is taken
        to be narrower.
        """
        rates = self.rates.given(len(self)) if rates is None else rates
        share = self.share(directions) if share is None else share
        found = np.ones(directions.shape[:-1]) - share * rates.recall
        if len(self):
            for scale, weight in zip(rates.scales.tolist(), rates.spreads.tolist(), strict=True):
                if weight > UNLIKELY:
                    density = self.scaled(scale).at_least(least).densities(directions).sum(axis=-1)
                    found += share * (weight * rates.gain * self.area) * density
        return found


def border_distance(grid: ErpGrid, unseen: np.ndarray) -> np.ndarray:
    """Angle (radians, ``(H, W)``) from each cell to the nearest one that is `unseen`."""
    from scipy.spatial import KDTree

    chord = KDTree(grid.directions[unseen]).query(grid.directions)[0]
    return 2 * np.arcsin(np.clip(chord / 2, 0, 1))


def isotropic(directions: np.ndarray, spreads: np.ndarray) -> np.ndarray:
    """The axes ``(n, 2, 3)`` of detections that are as wide in all directions, standard deviations `spreads` ``(n,)``."""
    frames = np.stack([tangent_frame(direction) for direction in directions]) if len(directions) else np.zeros((0, 2, 3))
    return frames / np.reshape(spreads, (-1, 1, 1))


def anisotropic(directions: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """The axes ``(n, 2, 3)`` of detections with covariances ``(n, 2, 2)`` in `tangent_frame` of their directions."""
    if not len(directions):
        return np.zeros((0, 2, 3))
    variances, turns = np.linalg.eigh(covariances)
    frames = np.stack([tangent_frame(direction) for direction in directions])
    return np.einsum("nij,nik->njk", turns, frames) / np.sqrt(variances)[..., None]


def resolved(degree: int) -> float:
    """Radians: the narrowest detection that a field of this degree holds."""
    return RESOLVED / (degree + 1)


def tangent_frame(direction: np.ndarray) -> np.ndarray:
    """Two unit vectors ``(2, 3)`` across a direction ``(3,)`` and each other."""
    helper = np.array([0.0, 0.0, 1.0]) if abs(direction[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    first = cross(helper, direction)
    first /= math.sqrt(float(first @ first))
    return np.array([first, cross(direction, first)])


@lru_cache(maxsize=1)
def _names() -> dict[str, str]:
    return {"pd": "detection_probability", "clutter": "false_alarms_per_look", "spread": "spread", "repeats": "repeats"}


def parse_model(text: str, base: DetectorModel | None = None) -> DetectorModel:
    """The model that a line of text says: ``pd=0.7,clutter=0.2,spread=5,repeats=0.3``, the spread in degrees.

    What is left out stays as in `base` (default: `DetectorModel()`); ``pd=?`` and ``clutter=?`` say "not known". Raises
    `ResponseError`.
    """
    found: dict[str, float | None] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        key, _, value = (piece.strip() for piece in part.partition("="))
        if key not in _names() or not value or _names()[key] in found:
            known = ", ".join(_names())
            raise ResponseError(f"{part!r} in {text!r}; wanted pd=0.7,clutter=0.2,spread=5 with some of {known}, once")
        if value == "?" and key in ("pd", "clutter"):
            found[_names()[key]] = None
            continue
        try:
            number = float(value)
        except ValueError:
            raise ResponseError(f"{part!r} in {text!r}: {value!r} is no number") from None
        found[_names()[key]] = math.radians(number) if key == "spread" else number
    return replace(base or DetectorModel(), **found)  # type: ignore[arg-type]


def model_as_json(model: DetectorModel) -> dict[str, object]:
    """The numbers of a model, for files (a map of clutter is not stored)."""
    return {f.name: getattr(model, f.name) for f in fields(model) if f.name != "clutter"}
