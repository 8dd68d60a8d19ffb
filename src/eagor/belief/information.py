"""What a look is expected to tell about where a thing is: one measure for all that choose where to look.

The thing is in one of many cells, or nowhere. A look reports it in one of the cells that it shows, reports something
else there, or nothing. The measure is the mutual information of the outcome and the cell: a look is worth taking for
cells that no look has shown, and for cells where what was reported may have been something else.
"""

from __future__ import annotations

import numpy as np

__all__ = ["even_and_usual", "information"]


def information(
    here: np.ndarray, share: np.ndarray, alarm: float | np.ndarray = 0.0, falls: np.ndarray | None = None
) -> np.ndarray:
    """Mutual information ``(n,)``, nats, of the outcome of each of n looks and the thing's cell.

    `here` ``(n, k)``: probability that the thing is in each of the k cells that a look shows; the rest is elsewhere, or
    nowhere. `share` ``(n, k)``: probability that the look reports it, if it is there. `alarm`, of all looks or
    ``(n,)``: probability of a false report where there is no true one, which falls on the cells with the probabilities
    `falls` ``(k,)`` or ``(n, k)``.

    The outcome is a report in one of the cells, or none: I = H(outcome) - sum_i p_i H(outcome | thing in cell i).
    """
    there = here * share
    reported = there.sum(axis=1, keepdims=True)
    if falls is None or not np.any(alarm):
        given = -_xlog(1 - share) - _xlog(share)
        return -_xlog(there).sum(axis=1) - _xlog(1 - reported[:, 0]) - (here * given).sum(axis=1)
    alarms = np.broadcast_to(alarm, len(here))[:, None]
    false = alarms * falls
    there = there + (1 - reported) * false
    outcome = -_xlog(there).sum(axis=1) - _xlog((1 - reported) * (1 - alarms))[:, 0]
    spread = -np.atleast_2d(_xlog(falls)).sum(axis=1)[:, None]  # entropy of a false report's place

    def without(left: np.ndarray) -> np.ndarray:
        """Entropy of the outcome without a true report, which has the probability `left`: no report, or a false one."""
        return -_xlog(left * (1 - alarms)) - _xlog(left * alarms) + left * alarms * spread

    false = (1 - share) * false  # in the cell of the true report
    given = without(1 - share) + (-_xlog(share + false) + _xlog(false))
    out = 1.0 - here.sum(axis=1)
    return outcome - (here * given).sum(axis=1) - out * without(np.ones((1, 1)))[:, 0]


def even_and_usual(
    elevations: np.ndarray, weights: np.ndarray, height: float, tilt: float, elsewhere: float
) -> np.ndarray:
    """Prior probabilities of cells ``(...)`` with these elevations (degrees) and `weights` (solid angles); sum to 1.

    A share `elsewhere` is even over the sphere. The rest has a normal density in the elevation, with the mean `height`
    and the standard deviation `tilt`, degrees. Silent looks where things usually are then move the belief to the even
    part, without any further rule.
    """
    squared = (elevations - height) ** 2
    beyond = squared - squared.min()  # so that the nearest row keeps its weight, however narrow the density is
    usual = np.exp(-0.5 * beyond / max(tilt, 1e-3) ** 2) * weights
    return (1 - elsewhere) * usual / usual.sum() + elsewhere * weights / weights.sum()


def _xlog(x: np.ndarray) -> np.ndarray:
    return x * np.log(np.maximum(x, 1e-300))
