"""How many times likelier a target gives a score than a false alarm does: a rising curve from labelled scores.

The ratio of two densities is a logistic regression of "right or false" on the score (Prentice and Pyke, Biometrika
66(3), 1979). The logarithm of the ratio is linear between a few knots and never falls. A normal prior on its rises
draws it towards 1 for every score: few scores say little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

__all__ = ["ScoreCurve", "fitted_curve", "knots_of"]

KNOTS = 5  # most places of the curve
EACH = 8  # scores that each knot asks for
FEWEST = 1.0  # right or false scores, below which nothing is known of the curve


@dataclass(frozen=True, eq=False)
class ScoreCurve:
    """Logarithms of ratios `logs` ``(K,)`` at scores `knots` ``(K,)``; linear between, constant beyond."""

    knots: np.ndarray
    logs: np.ndarray

    @classmethod
    def flat(cls) -> ScoreCurve:
        """Ratio 1 for every score."""
        return cls(np.array([0.0, 1.0]), np.zeros(2))

    def at(self, scores: np.ndarray) -> np.ndarray:
        """Logarithms of the ratios ``(n,)``."""
        return np.interp(scores, self.knots, self.logs)

    @property
    def pairs(self) -> tuple[tuple[float, float], ...]:
        """As `DetectorModel.score_ratios` has it."""
        return tuple((float(at), math.exp(log)) for at, log in zip(self.knots, self.logs, strict=True))


def knots_of(scores: np.ndarray) -> np.ndarray:
    """The places ``(K,)`` of a curve for these scores ``(n,)``: quantiles; fewer than two where all are alike."""
    count = min(KNOTS, max(2, len(scores) // EACH))
    return np.unique(np.quantile(scores, np.linspace(0, 1, count))) if len(scores) else np.zeros(0)


def fitted_curve(
    scores: np.ndarray, right: np.ndarray, weights: np.ndarray, knots: np.ndarray, deviation: float
) -> ScoreCurve:
    """The curve for scores ``(n,)``, of which `right` ``(n,)`` says how probably each is of a target.

    `weights` ``(n,)``: how often each counts. `deviation`: standard deviation, in the prior, of the logarithm of the
    ratio between the lowest and the highest score; 0: the flat curve.
    """
    positive, negative = weights * right, weights * (1 - right)
    if deviation <= 0 or len(knots) < 2 or min(positive.sum(), negative.sum()) < FEWEST:
        return ScoreCurve.flat()
    from scipy.optimize import minimize

    rises = len(knots) - 1
    # Column k is how far a score lies through the k-th gap between knots, in [0, 1].
    through = np.clip((scores[:, None] - knots[:-1]) / np.diff(knots), 0, 1)
    variance = deviation**2 / rises

    def loss(values: np.ndarray) -> tuple[float, np.ndarray]:
        odds = values[0] + through @ values[1:]
        above = positive @ np.logaddexp(0, -odds) + negative @ np.logaddexp(0, odds)
        slope = weights / (1 + np.exp(-np.clip(odds, -500, 500))) - positive
        gradient = np.concatenate([[slope.sum()], slope @ through + values[1:] / variance])
        return float(above + values[1:] @ values[1:] / (2 * variance)), gradient

    prior = math.log(positive.sum() / negative.sum())
    start = np.concatenate([[prior], np.zeros(rises)])
    bounds = [(None, None), *[(0, None)] * rises]
    found = minimize(loss, start, jac=True, bounds=bounds, method="L-BFGS-B").x
    return ScoreCurve(knots, found[0] - prior + np.concatenate([[0.0], np.cumsum(found[1:])]))
