"""A detector's measurement model: what a set of detections says about where the target is, and whether it is present.

One target that may be absent (a Bernoulli random finite set; Ristic, Vo, Vo and Farina, IEEE Transactions on Signal
Processing 61(13), 2013). A look sees the share v(w) of direction w. A target there is detected with probability P_D,
at a place with density g(z | w), among false alarms that are Poisson with intensity lambda(z) per steradian. Against
"not here", the set Z of one look has the likelihood ratio

    L(w) = 1 - v(w) P_D + v(w) P_D sum_i s_i g(z_i | w) / lambda(z_i),    s_i = p(score_i | thing) / p(score_i | false).

Its logarithm is the evidence. P_D and lambda are unknown in a new scene; by default both are learnt with the belief
(`Rates`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache

import numpy as np

from eagor._checks import above, require, within
from eagor.errors import ResponseError
from eagor.evidence.repeating import METRES, SECONDS
from eagor.grids import ErpGrid

__all__ = ["DetectorModel", "Rates", "Spread", "model_as_json", "parse_model"]

CLUTTER_FLOOR = 1e-3  # least relative density of false alarms: no single detection is a proof
# The prior of the rates: probabilities of detection and mean numbers of false alarms, with weights.
RECALLS, RECALL_WEIGHTS = (0.1, 0.3, 0.5, 0.7, 0.9), (0.1, 0.2, 0.2, 0.25, 0.25)
ALARMS = (0.02, 0.06, 0.2, 0.6, 2.0, 6.0)
# Factors by which the true spread may differ from the stated one, and their prior weights.
SCALES, SCALE_WEIGHTS = (0.5, 1.0, 2.0), (0.04, 0.88, 0.08)
UNLIKELY = 1e-3  # scales with less weight are dropped


@dataclass(frozen=True)
class DetectorModel:
    """How a detector errs. Each number can be counted on a few labelled frames.

    - `detection_probability` (P_D): the probability that a target in view is detected. None: learnt with the belief.
    - `false_alarms_per_look`: mean number of false alarms in what one look covers. None: learnt.
    - `spread`: radians (standard deviation per axis) of a detection about the direction of the thing.
    - `repeats`: share of the mistakes of a look that the next one repeats, in [0, 1); 0: looks are independent. A
      poster is taken for the target again, and a target overlooked once is overlooked again. Only the share 1 - repeats
      of a repeated look adds up.
    - `repeats_for`: seconds in which mistakes fade: a look repeats the share repeats exp(-elapsed / repeats_for) of the
      look `elapsed` seconds before it. None: they do not fade with time.
    - `repeats_within`: the same in metres of the camera's way. None: they do not fade with distance.
    - `score_ratios`: pairs (score, ratio) by rising score: how many times likelier the target gives this score than a
      false alarm does; the logarithm is interpolated between them. None: the ratio is the score itself.
    - `clutter`: relative density of false alarms ``(H, W)`` over a panorama in the body frame; its scale does not
      matter. None: uniform.
    """

    detection_probability: float | None = None
    false_alarms_per_look: float | None = None
    spread: float = math.radians(5)
    repeats: float = 0.0
    score_ratios: tuple[tuple[float, float], ...] | None = None
    clutter: np.ndarray | None = field(default=None, compare=False, repr=False)
    repeats_for: float | None = None
    repeats_within: float | None = None

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
            "repeats_for": (self.repeats_for is None or above(self.repeats_for, 0), SECONDS),
            "repeats_within": (self.repeats_within is None or above(self.repeats_within, 0), METRES),
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
        """s ``(n,)``: how much likelier each score is for the target than for a false alarm; 1 without scores."""
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
    """The posterior of a detector's rates: joint weights ``(R, A)`` of `recalls` ``(R,)`` and `alarms` ``(A,)``.

    A rate that the model states has a single value, and nothing is learnt.
    """

    recalls: np.ndarray
    alarms: np.ndarray
    weights: np.ndarray

    @classmethod
    def prior(cls, model: DetectorModel) -> Rates:
        """Before any look."""
        known, number = model.detection_probability, model.false_alarms_per_look
        recalls = np.array(RECALLS if known is None else (known,))
        share = np.array(RECALL_WEIGHTS if known is None else (1.0,))
        alarms = np.array(ALARMS if number is None else (number,))
        weights = share[:, None] * np.full(len(alarms), 1 / len(alarms))
        return cls(recalls, alarms, weights)

    def given(self, count: int) -> Rates:
        """Updated by a look of `count` detections, all of them false alarms."""
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
        """The mean of P_D / (number of false alarms), the weight of one detection."""
        return float(self.recalls @ self.weights @ (1 / self.alarms))

    def learnt(self, presence: float, covered: float, expected: float) -> Rates:
        """After a look whose number of detections `given` has taken in.

        `presence`: probability of the target before the look; `covered`: share of its density that was looked at;
        `expected`: the sum over the detections of s_i g(z_i) / lambda(z_i) at one false alarm per look, with g under
        that density.
        """
        recalls = self.recalls[:, None]
        seen = 1 - recalls * covered + (recalls / self.alarms) * expected
        weights = self.weights * (1 - presence + presence * seen)
        return replace(self, weights=weights / weights.sum())


@dataclass(frozen=True, eq=False)
class Spread:
    """The width of detections: `weights` ``(S,)`` of the factors `scales` ``(S,)`` on the stated spread.

    `otherwise` ``(S,)``: the weights if the target moves, since motion looks like a wide spread.
    """

    scales: np.ndarray
    weights: np.ndarray
    otherwise: np.ndarray
    doubted: bool = False  # whether scales other than 1 were ever considered

    @classmethod
    def unsure(cls) -> Spread:
        """The prior, before any look."""
        return cls(np.array(SCALES), np.array(SCALE_WEIGHTS), np.array(SCALE_WEIGHTS), True)

    def mixed(self, stands: float) -> Spread:
        """The weights, if the target stands with probability `stands`."""
        return replace(self, weights=stands * self.weights + (1 - stands) * self.otherwise)

    @property
    def precision(self) -> float:
        """The mean of 1 / scale^2 if the target moves."""
        return float(self.otherwise @ self.scales**-2.0)

    @property
    def logs(self) -> np.ndarray:
        """Logarithms of the weights, for values ``(S, K, n, n)``."""
        return np.log(self.weights)[:, None, None, None]


STATED = Spread(np.ones(1), np.ones(1), np.ones(1))


@lru_cache(maxsize=1)
def _names() -> dict[str, str]:
    same = {name: name for name in ("spread", "repeats", "repeats_for", "repeats_within")}
    return {"pd": "detection_probability", "clutter": "false_alarms_per_look", **same}


def parse_model(text: str, base: DetectorModel | None = None) -> DetectorModel:
    """The model in a line of text: ``pd=0.7,clutter=0.2,spread=5,repeats=0.3,repeats_for=2,repeats_within=1``.

    The spread is in degrees, `repeats_for` in seconds, `repeats_within` in metres. What the text leaves out is taken
    from `base` (default: `DetectorModel()`); ``pd=?`` and ``clutter=?`` say "not known". Raises `ResponseError`.
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
            raise ResponseError(f"{part!r} in {text!r}: {value!r} is not a number") from None
        found[_names()[key]] = math.radians(number) if key == "spread" else number
    return replace(base or DetectorModel(), **found)  # type: ignore[arg-type]


def model_as_json(model: DetectorModel) -> dict[str, object]:
    """The numbers of a model, for files (without a map of clutter)."""
    return {f.name: getattr(model, f.name) for f in fields(model) if f.name != "clutter"}
