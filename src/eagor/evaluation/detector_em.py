"""The likeliest numbers of a `DetectorModel` for labelled looks, by expectation-maximisation.

The assignments of detections to targets (`labelled_looks`), then each number from them. Weak priors hold where the
looks say little: a Beta for the detection probability, a Gamma for the false alarms, a log-normal about the stated
spread, a normal for the rises of the score curve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from eagor.evaluation.labelled_looks import Assigned, Rows, sums
from eagor.evaluation.score_curve import ScoreCurve, fitted_curve, knots_of
from eagor.evidence.detector import RECALL_WEIGHTS, RECALLS, DetectorModel

__all__ = ["Estimate", "Fitting"]

RECALL_PRIOR = 2.0  # targets that the prior of the detection probability counts for
ALARMS_PRIOR = (0.5, 1.0)  # false alarms, and looks, that the prior of the false alarms counts for
SPREAD_PRIOR = 2.0  # detections that the prior of the spread counts for
REPEATS_PRIOR = 4.0  # pairs of looks that the prior of `repeats` counts for
NARROWEST, WIDEST = math.radians(0.2), math.radians(40)  # spreads that are tried
STARTS = (0.4, 1.0, 2.5)  # times the stated spread: where the search begins
STEPS, SETTLED = 60, 1e-3  # most steps, and the relative change of every number at which they end
MOST_RECALL, MOST_REPEATS = 0.99, 0.95


@dataclass(frozen=True, eq=False)
class Estimate:
    """Numbers of the model, and what they were counted on: sums over looks and their weights.

    `targets` in view; `detections`, of which `matched` are of a target; `log`: the log posterior density.
    """

    recall: float
    alarms: float
    spread: float
    curve: ScoreCurve
    repeats: float = 0.0
    looks: float = 0.0
    targets: float = 0.0
    detections: float = 0.0
    matched: float = 0.0
    log: float = -math.inf

    def of(self, rows: Rows) -> Assigned:
        """The assignments of looks under these numbers."""
        return rows.assigned(self.recall, self.alarms, self.spread, self.curve.at(rows.scores))

    def log_likelihoods(self, rows: Rows) -> np.ndarray:
        """Log likelihood of each look ``(L,)``, up to what none of these numbers changes."""
        return self.of(rows).log_likelihoods(self.recall, self.alarms)

    def model(self, base: DetectorModel) -> DetectorModel:
        """The detector's model; what could not be counted is as in `base`."""
        ratios = tuple((short(at), short(ratio)) for at, ratio in self.curve.pairs)
        return replace(
            base,
            detection_probability=short(self.recall) if self.targets else base.detection_probability,
            false_alarms_per_look=short(self.alarms),
            spread=short(self.spread),
            repeats=short(self.repeats),
            score_ratios=ratios if self.detections else base.score_ratios,
        )


@dataclass(frozen=True, eq=False)
class Fitting:
    """Labelled looks as `rows`, with the `pairs` ``(N, 2)`` of consecutive ones, and the prior `base`."""

    rows: Rows
    pairs: np.ndarray
    base: DetectorModel

    @property
    def knots(self) -> np.ndarray:
        """The places of the score curve."""
        return knots_of(self.rows.scores)

    @property
    def prior_recall(self) -> float:
        """The prior mean of the detection probability."""
        return self.base.detection_probability or float(np.dot(RECALLS, RECALL_WEIGHTS))

    def estimate(self, weights: np.ndarray, deviation: float, start: Estimate | None = None) -> Estimate:
        """The likeliest numbers for looks that count `weights` ``(L,)``; from several starts, or from `start` on.

        `deviation`: of the score curve's prior (`fitted_curve`).
        """
        starts = [start] if start else [self._start(weights, factor * self.base.spread) for factor in STARTS]
        best = max((self._climbed(weights, deviation, each) for each in starts), key=lambda each: each.log)
        return replace(best, repeats=self._repeats(weights, best))

    def _start(self, weights: np.ndarray, spread: float) -> Estimate:
        detections = float(weights[self.rows.look_of_detection].sum())
        return Estimate(self.prior_recall, max(detections / weights.sum(), 0.1), spread, ScoreCurve.flat())

    def _climbed(self, weights: np.ndarray, deviation: float, now: Estimate) -> Estimate:
        """The estimate to which the steps from `now` on lead."""
        rows, mean, knots = self.rows, self.prior_recall, self.knots
        of_target, of_detection = weights[rows.look_of_target], weights[rows.look_of_detection]
        targets, detections, looks = (float(part.sum()) for part in (of_target, of_detection, weights))
        for _ in range(STEPS):
            joint = now.of(rows)
            matched = float(of_detection @ joint.right)
            recall = (float(of_target @ joint.found) + RECALL_PRIOR * mean) / (targets + RECALL_PRIOR)
            alarms = (max(detections - matched, 0.0) + ALARMS_PRIOR[0]) / (looks + ALARMS_PRIOR[1])
            spread = self._spread(of_detection[rows.detection] * joint.shares)
            curve = fitted_curve(rows.scores, joint.right, of_detection, knots, deviation)
            before = np.array([now.recall, now.alarms, now.spread])
            now = Estimate(
                min(recall, MOST_RECALL), alarms, spread, curve, 0.0, looks, targets, detections, matched
            )  # fmt: skip
            if np.abs(np.array([now.recall, now.alarms, now.spread]) / before - 1).max() < SETTLED:
                break
        log = float(weights @ now.log_likelihoods(rows))
        log += RECALL_PRIOR * (mean * math.log(now.recall) + (1 - mean) * math.log(1 - now.recall))
        log += ALARMS_PRIOR[0] * math.log(now.alarms) - ALARMS_PRIOR[1] * now.alarms
        return replace(now, log=log - self._doubt(math.log(now.spread)))

    def _doubt(self, log: float) -> float:
        """Minus the log prior of a spread: normal in its logarithm, about the stated one.

        Each of two axes of a detection brings a Fisher information of 2 about that logarithm.
        """
        return 2 * SPREAD_PRIOR * (log - math.log(self.base.spread)) ** 2

    def _spread(self, shares: np.ndarray) -> float:
        """The likeliest spread (radians) of pairs that count `shares` ``(P,)``."""
        from scipy.optimize import minimize_scalar

        kept = shares > 1e-6
        own, squares, counts = self.rows.own[self.rows.detection[kept]], self.rows.squares[kept], shares[kept]

        def loss(log: float) -> float:
            variances = own + math.exp(2 * log)
            terms = (np.log(variances) + squares / variances).sum(axis=1)
            return float(0.5 * counts @ terms) + self._doubt(log)

        found = minimize_scalar(loss, bounds=(math.log(NARROWEST), math.log(WIDEST)), method="bounded")
        return math.exp(found.x)

    def _repeats(self, weights: np.ndarray, found: Estimate) -> float:
        """The share of mistakes that the next look repeats: their correlation from one look to the next.

        The mistakes of a look are targets missed, false alarms, and the offsets of right detections, each less its
        mean.
        """
        rows, joint = self.rows, found.of(self.rows)
        first, second = self.pairs.T
        counts = np.minimum(weights[first], weights[second])
        targets = np.bincount(rows.look_of_target, minlength=rows.count)
        seen = sums(rows.look_of_target, joint.found, rows.count)
        false = sums(rows.look_of_detection, 1 - joint.right, rows.count)
        mistakes = [(seen - found.recall * targets, targets > 0), (false - found.alarms, targets >= 0)]
        one = (targets == 1) & (seen > 0.5)  # of several targets it is not known which is which in the next look
        for offsets in rows.offsets.T:
            total = sums(rows.look_of_target[rows.target], joint.shares * offsets, rows.count)
            mistakes.append((total / np.maximum(seen, 0.5), one))
        products, pairs = REPEATS_PRIOR * self.base.repeats, REPEATS_PRIOR
        for values, known in mistakes:
            square = float((weights * known) @ values**2)
            both = counts * known[first] * known[second]
            if square > 1e-12:
                products += float(both @ (values[first] * values[second])) * float(weights @ known) / square
                pairs += float(both.sum())
        return min(max(products / pairs, 0.0), MOST_REPEATS)


def short(value: float) -> float:
    """`value` with the three digits that mean something."""
    return float(f"{value:.3g}")
