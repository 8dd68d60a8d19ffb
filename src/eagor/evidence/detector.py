"""A detector's measurement model: what a set of detections says about where the target is, and whether it is present.

One target that may be absent (a Bernoulli random finite set; Ristic, Vo, Vo and Farina, IEEE Transactions on Signal
Processing 61(13), 2013). A look sees the share v(w) of direction w. A target there is detected with probability P_D,
at a place with density g(z | w), among false alarms that are Poisson with intensity lambda(z) per steradian. Against
"not here", the set Z of one look has the likelihood ratio

    L(w) = 1 - v(w) P_D + v(w) P_D sum_i s_i g(z_i | w) / lambda(z_i),    s_i = p(score_i | thing) / p(score_i | false).

Looks at the same place are not independent: P_D, the score and what is mistaken for the thing are habits of the place
(`Habits`). `eagor.belief.bank` keeps them over many looks. The number of false alarms that do not last
is learnt with the belief (`ClutterRate`).

Places have habits: why looks at the same thing are not independent.

A detector finds one thing in nearly every look and another in few of them, and what it once took for the thing it takes
for it again. The share of looks in which a place is detected is drawn once, and kept while the view stays the same: a
random effect (beta-binomial instead of binomial; Skellam, Journal of the Royal Statistical Society B 10(2), 1948), and
for mistakes a clutter map. `Habits` holds its distributions over a few levels, for places where the thing is and for
look-alikes. When the camera has moved by m metres, or s seconds have passed, a place draws its habit anew with
probability

    1 - exp(-m / kept_within - s / kept_for).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np

from eagor._checks import above, require, within
from eagor._values import changed
from eagor.errors import ResponseError
from eagor.grids import ErpGrid

__all__ = ["ClutterRate", "DetectorModel", "Spread", "model_as_json", "parse_model"]

# Shares of looks that habits are told apart by, and the borders between them: evenly spaced in the angle asin(sqrt p),
# in which looks tell shares apart equally well everywhere (Anscombe, Biometrika 35, 1948). So a thing that is found
# never, or always, is as likely as the distribution says. They are the same for things and look-alikes: else the
# roundings of the two would grow apart with each look.
_ANGLES = np.linspace(0.0, math.pi / 2, 17)
LEVELS, BORDERS = np.sin(_ANGLES[1::2]) ** 2, np.sin(_ANGLES[::2]) ** 2
# Beta distributions of the share of looks in which a place is detected: of the thing, and of a look-alike.
HABIT, LOOK_ALIKE_HABIT = (0.8, 0.8), (0.5, 2.0)
LOOK_ALIKES = 0.7  # expected on the whole sphere, where that is not known
# Of the look-alikes, those that are found as often as the thing: mirrors, pictures of it, other things of its shape.
EQUALS = 0.1
BETA = (0.001, 500.0)  # beyond, a distribution is a step or a point
KEPT_FOR, KEPT_WITHIN = 60.0, 1.0  # seconds, metres


@dataclass(frozen=True, eq=False)
class Habits:
    """How often a place is detected, and how long that lasts.

    `levels` ``(P,)`` with weights `shares` ``(P,)``: of places where the thing is. `alike_levels`, `alike_shares`
    ``(A,)``: of look-alikes, of which there are `look_alikes` on the whole sphere on average. A is 0 if there are none.
    """

    levels: np.ndarray
    shares: np.ndarray
    alike_levels: np.ndarray
    alike_shares: np.ndarray
    look_alikes: float
    kept_for: float | None
    kept_within: float | None

    def same(self, other: Habits) -> bool:
        """Whether all numbers are equal."""
        if self is other:
            return True
        ours, theirs = ([getattr(each, f.name) for f in fields(each)] for each in (self, other))
        return all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))

    @property
    def mean(self) -> float:
        """The mean share of looks in which the thing is detected."""
        return float(self.levels @ self.shares)

    @property
    def correlation(self) -> float:
        """The correlation of two looks at one thing: 1 if it is found always or never, 0 if looks are independent."""
        mean = self.mean
        spread = float(self.levels**2 @ self.shares) - mean**2
        return spread / (mean * (1 - mean)) if 0 < mean < 1 else 0.0

    def renewal_probability(self, elapsed: float, moved: float = 0.0) -> float:
        """The probability that a place has drawn its habit anew after `elapsed` seconds and `moved` metres."""
        faded = 0.0 if self.kept_for is None else elapsed / self.kept_for
        return -math.expm1(-faded - (0.0 if self.kept_within is None else moved / self.kept_within))


@lru_cache(maxsize=64)
def habits(
    detection_probability: float | None,
    habit: tuple[float, float],
    look_alikes: float | None,
    look_alike_habit: tuple[float, float],
    kept_for: float | None,
    kept_within: float | None,
    hidden: float,
) -> Habits:
    """The habits with these numbers, the fields of `DetectorModel`."""
    levels, shares = LEVELS, _weights(habit)
    if detection_probability is not None:
        levels, shares = np.array([detection_probability]), np.ones(1)
    if hidden:
        levels, shares = np.append(0.0, levels), np.append(hidden, (1 - hidden) * shares)
    if look_alikes is None:
        look_alikes = LOOK_ALIKES if detection_probability is None else 0.0
    alike_levels, alike_shares = LEVELS, (1 - EQUALS) * _weights(look_alike_habit) + EQUALS * _weights(habit)
    if look_alikes == 0:
        alike_levels = alike_shares = np.zeros(0)
    return Habits(levels, shares, alike_levels, alike_shares, look_alikes, kept_for, kept_within)


def _weights(habit: tuple[float, float]) -> np.ndarray:
    """The probabilities ``(P,)`` of the `LEVELS`: what a beta distribution holds between the borders of each."""
    from scipy.special import betainc

    return np.diff(betainc(*habit, BORDERS))


def checks(model: object) -> dict[str, tuple[bool, str]]:
    """Whether the fields of `habits` hold what they should, and what that is."""
    values = {name: getattr(model, name) for name in ("habit", "look_alikes", "look_alike_habit")}
    seconds, metres = (getattr(model, name) for name in ("kept_for", "kept_within"))
    beta = f"two numbers from {BETA[0]:g} to {BETA[1]:g}, of a beta distribution"
    return {
        "habit": (_is_beta(values["habit"]), beta),
        "look_alike_habit": (_is_beta(values["look_alike_habit"]), beta),
        "look_alikes": (
            values["look_alikes"] is None or within(values["look_alikes"], 0),
            "an expected number on the whole sphere, from 0 on, or None",
        ),
        "kept_for": (seconds is None or above(seconds, 0), "seconds above 0, or None if habits last however long"),
        "kept_within": (metres is None or above(metres, 0), "metres above 0, or None if habits last however far"),
    }


def _is_beta(found: object) -> bool:
    return isinstance(found, tuple) and len(found) == 2 and all(within(each, *BETA) for each in found)


RESPONSES = habits(1.0, HABIT, 0.0, LOOK_ALIKE_HABIT, None, None, 0.0)  # of response maps, whose looks just add up


CLUTTER_FLOOR = 1e-3  # least relative density of false alarms: no single detection is a proof
ALARMS = (0.02, 0.06, 0.2, 0.6, 2.0, 6.0)  # mean numbers of false alarms, alike likely before any look
# Factors by which the true spread may differ from the stated one, and their prior weights.
SCALES, SCALE_WEIGHTS = (0.5, 1.0, 2.0), (0.02, 0.94, 0.04)
# Radians (0.7 degrees), and a share: measured with `coco` on photographs of rooms. A fit gives a share of 0.25, but
# takes errors as normal, and beds are further off: with 0.35 the regions hold as much as they say, at the same score.
OFFSET, OFFSET_OF_SIZE = 0.0122, 0.35
LEAST_SCORE = 0.1  # and 0.9 at most: no score is a proof, and nobody has measured the last tenth
LEAST_OF_SIZE = 0.01  # of `spread_of_size`: with 0 a box's size would be lost
UNLIKELY = 1e-3  # scales with less weight are dropped


@dataclass(frozen=True)
class DetectorModel:
    """How a detector errs. Each number can be counted on a few labelled frames, or learnt from footage.

    - `detection_probability` (P_D): the probability that a target in view is detected, if it is the same at every
      place. None: it differs from place to place, as `habit` says.
    - `false_alarms_per_look`: mean number of false alarms in what one look covers, of those that do not come again.
      None: learnt with the belief.
    - `spread`: radians (standard deviation per axis) of a detection about the direction of the thing.
    - `score_ratios`: pairs (score, ratio) by rising score: how many times likelier the target gives this score than a
      false alarm does; the logarithm is interpolated between them. None: a score is the probability that the box is
      right, so the ratio is the odds of the score over those of `prior_correct`. A score is a habit: it counts
      once for each place.
    - `prior_correct`: the share of the detector's boxes that are right, whatever their score: where nothing else is
      known, about the lowest score that it reports. Without `score_ratios` only.
    - `look_alikes`: how many places on the whole sphere are taken for the thing again and again, on average. None: 0
      where `detection_probability` is stated, since looks are independent then, otherwise 0.7.
    - `habit`, `look_alike_habit`: two numbers of a beta distribution: the share of looks in which a place is detected
      where the thing is, and where a look-alike is.
    - `kept_for`, `kept_within`: seconds, and metres of the camera's way, in which places lose their habits
      (`eagor.evidence.detector`). None: they last.
    - `hidden`: the share of view points from which a thing cannot be seen, behind a wall or a door: about 0 in one
      room, about 0.5 on a way through several. A habit like the others: it is drawn anew within `kept_within`.
    - `offset`: radians (standard deviation per axis), an error on top of `spread` that a place keeps: a box that sits
      beside the thing does so in the next look. No number of looks averages it out.
    - `spread_of_size`, `offset_of_size`: what a box or a mask adds to `spread` and to `offset`, as shares of the
      standard deviation of its own area along each axis (0.29 of its width, 0.29 of its height): the box of a large
      thing is off by more than that of a small one.
    - `parts`: the share of the boxes on a thing that show only a part of it. To what moves these are no news.
    - `clutter`: relative density of false alarms ``(H, W)`` over a panorama in the body frame; its scale does not
      matter. None: uniform.

        >>> model = eagor.DetectorModel(detection_probability=0.7, false_alarms_per_look=0.2, look_alikes=0)
        >>> look = eagor.Evidence.from_points([[1, 0, 0]], detector=model)
        >>> round(float(look.detections.ratio(np.array([0.0, 1.0, 0.0]))), 3)  # seen, and nothing found: 1 - 0.7
        0.3
    """

    detection_probability: float | None = None
    false_alarms_per_look: float | None = None
    spread: float = math.radians(5)
    score_ratios: tuple[tuple[float, float], ...] | None = None
    prior_correct: float = 0.3
    look_alikes: float | None = None
    habit: tuple[float, float] = HABIT
    look_alike_habit: tuple[float, float] = LOOK_ALIKE_HABIT
    kept_for: float | None = KEPT_FOR
    kept_within: float | None = KEPT_WITHIN
    hidden: float = 0.0
    offset: float = OFFSET
    spread_of_size: float = 1.0
    offset_of_size: float = OFFSET_OF_SIZE
    parts: float = 0.15  # measured with `coco` on photographs of rooms
    clutter: np.ndarray | None = field(default=None, compare=False, repr=False)

    def __repr__(self) -> str:
        """The fields that differ from their defaults."""
        return changed(self)

    def __post_init__(self) -> None:
        known, alarms = self.detection_probability, self.false_alarms_per_look
        wanted = {
            "detection_probability": (
                known is None or (above(known, 0, 1) and known < 1),
                "a probability above 0 and below 1 (0.99 for a very good detector), or None for `habit`",
            ),
            "false_alarms_per_look": (alarms is None or above(alarms, 0), "a mean number above 0, or None to learn it"),
            "spread": (
                within(self.spread, math.radians(0.01), math.radians(60)),
                "radians, from 0.01 to 60 degrees (given in degrees? use math.radians)",
            ),
            "score_ratios": (_is_curve(self.score_ratios), "pairs (score, ratio), scores rising, ratios above 0"),
            "prior_correct": (
                above(self.prior_correct, 0, 1) and self.prior_correct < 1,
                "a share of the boxes, above 0 and below 1",
            ),
            "hidden": (within(self.hidden, 0, 1) and self.hidden < 1, "a share of the view points, from 0, below 1"),
            "offset": (within(self.offset, 0, math.radians(60)), "radians, from 0 to 60 degrees"),
            "spread_of_size": (
                within(self.spread_of_size, LEAST_OF_SIZE, 2),
                f"a share of the deviation of a box's area, from {LEAST_OF_SIZE:g} to 2",
            ),
            "offset_of_size": (within(self.offset_of_size, 0, 2), "a share of that deviation, from 0 to 2"),
            "parts": (within(self.parts, 0, 1), "a share of the boxes on a thing, from 0 to 1"),
            **checks(self),
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

    @classmethod
    def reporting_from(cls, threshold: Any) -> DetectorModel:
        """Of a detector that reports boxes from a score of `threshold` on, of which nothing else is known."""
        known = within(threshold, 0, 1)
        return cls(prior_correct=min(max(float(threshold), LEAST_SCORE), 1 - LEAST_SCORE)) if known else cls()

    @property
    def habits(self) -> Habits:
        """How often places are detected, and for how long."""
        return habits(
            self.detection_probability,
            self.habit,
            self.look_alikes,
            self.look_alike_habit,
            self.kept_for,
            self.kept_within,
            self.hidden,
        )

    def ratios(self, scores: np.ndarray | None, count: int) -> np.ndarray:
        """s ``(n,)``: how much likelier each score is for the target than for a false alarm; 1 without scores."""
        if scores is None:
            return np.ones(count)
        if self.score_ratios is None:
            sure = np.clip(np.asarray(scores, dtype=np.float64), LEAST_SCORE, 1 - LEAST_SCORE)
            return sure / (1 - sure) * ((1 - self.prior_correct) / self.prior_correct)
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
class ClutterRate:
    """The posterior of the mean number of false alarms in a look: weights ``(A,)`` of `numbers` ``(A,)``.

    A number that the model states has weight 1, and nothing is learnt.
    """

    numbers: np.ndarray
    weights: np.ndarray

    @classmethod
    def prior(cls, model: DetectorModel) -> ClutterRate:
        """Before any look."""
        stated = model.false_alarms_per_look
        numbers = np.array(ALARMS if stated is None else (stated,))
        return cls(numbers, np.full(len(numbers), 1 / len(numbers)))

    def after(self, explained: np.ndarray) -> ClutterRate:
        """After a look with n detections.

        `explained` ``(n,)``: the density of detections at each of them that has other causes, relative to that of one
        false alarm per look.
        """
        if len(self.numbers) == 1:
            return self
        log = np.log(self.numbers[:, None] + explained).sum(axis=1) - self.numbers
        weights = self.weights * np.exp(log - log.max())
        return replace(self, weights=weights / weights.sum())

    @property
    def mean_inverse_rate(self) -> float:
        """The mean of 1 / number, the weight of one detection."""
        return float(self.weights @ (1 / self.numbers))

    def share(self, explained: np.ndarray) -> np.ndarray:
        """The weights ``(n,)`` of detections with such other causes (see `after`), relative to `mean_inverse_rate`."""
        return self.weights @ (1 / (self.numbers[:, None] + explained)) / self.mean_inverse_rate


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


_WORDS = tuple(f.name for f in fields(DetectorModel) if f.name not in ("clutter", "score_ratios"))
_UNKNOWN = ("detection_probability", "false_alarms_per_look", "look_alikes", "kept_for", "kept_within")  # may be None
_DEGREES = ("spread", "offset")


def parse_model(text: str, base: DetectorModel | None = None) -> DetectorModel:
    """The model in a line of text: ``detection_probability=0.7,false_alarms_per_look=0.2,spread=5,look_alikes=0``.

    The words are the fields of `DetectorModel`; angles in degrees, a beta distribution as ``habit=0.8+0.8``. What the
    text leaves out is taken from `base` (default: `DetectorModel()`); ``false_alarms_per_look=?`` says "not known".
    Raises `ResponseError`.
    """
    found: dict[str, Any] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        key, _, value = (piece.strip() for piece in part.partition("="))
        if key not in _WORDS or not value or key in found:
            raise ResponseError(f"{part!r} in {text!r}; wanted spread=5,look_alikes=0 with some of {', '.join(_WORDS)}")
        found[key] = parsed_field(key, value, part, text)
    return replace(base or DetectorModel(), **found)


def parsed_field(key: str, value: str, part: str, text: str) -> Any:
    """The value of one field of `DetectorModel` from text. Raises `ResponseError` that names the `part` of `text`."""
    if value == "?" and key in _UNKNOWN:
        return None
    try:
        numbers = [float(each) for each in value.split("+")]
    except ValueError:
        raise ResponseError(f"{part!r} in {text!r}: {value!r} is not a number") from None
    if key.endswith("habit"):
        return tuple(numbers)
    if len(numbers) > 1:
        raise ResponseError(f"{part!r} in {text!r}: wanted one number")
    return math.radians(numbers[0]) if key in _DEGREES else numbers[0]


def model_as_json(model: DetectorModel) -> dict[str, object]:
    """The numbers of a model, for files (without a map of clutter)."""
    return {f.name: getattr(model, f.name) for f in fields(model) if f.name != "clutter"}
