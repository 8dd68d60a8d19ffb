"""How long a perception's mistakes last: how their correlation falls with the lag, which no log score can tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

TIMES, SHORTEST, LONGEST = 80, 0.5, 2.0  # that are tried: from so much of the shortest lag to so much of the longest
MOST = 0.95  # share of mistakes that repeats
ENOUGH = 12.0  # by how much a share, or that it falls, has to mend the sum of squares; of noise it does so rarely


def lasting(stamps: Sequence[np.ndarray], mistakes: Sequence[np.ndarray]) -> tuple[float, float | None]:
    """The share of mistakes that repeats, and the seconds in which that fades.

    Of each recording: `stamps` ``(n,)`` of its looks and their `mistakes` ``(n, d)``, of mean 0 over all recordings,
    NaN where there is none. To their correlation at each lag t ``share * exp(-t / seconds)`` is fitted by least
    squares, weighed by the number of pairs. Seconds are None where the correlation does not fall over these lags, or is
    none.
    """
    gaps = np.concatenate([np.zeros(0), *(np.diff(times) for times in stamps)])
    gaps = gaps[gaps > 0]
    if not len(gaps):
        return 0.0, None
    step = float(np.median(gaps))
    found, pairs = _correlations(stamps, mistakes, step)
    lags = step * (1 + np.flatnonzero(pairs))
    return _fitted(lags, found[pairs > 0], pairs[pairs > 0])


def _correlations(
    stamps: Sequence[np.ndarray], mistakes: Sequence[np.ndarray], step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Correlations ``(K,)`` at lags of 1 to K steps, and from how many pairs each of them is."""
    every = np.concatenate(mistakes)
    squares = np.nansum(np.square(every), axis=0) / np.maximum(np.isfinite(every).sum(axis=0), 1)
    most = max(round(float(np.ptp(times)) / step) // 2 for times in stamps if len(times))
    sums, pairs = np.zeros(most + 1), np.zeros(most + 1)
    for times, values in zip(stamps, mistakes, strict=True):
        first, second = np.triu_indices(len(times), 1)
        lags = np.rint(np.abs(times[second] - times[first]) / step).astype(int)
        for column, square in zip(np.transpose(values), squares, strict=True):
            products = column[first] * column[second]
            counts = np.isfinite(products) & (lags >= 1) & (lags <= most) & (square > 0)
            sums += np.bincount(lags[counts], products[counts] / square, most + 1)
            pairs += np.bincount(lags[counts], minlength=most + 1)
    return sums[1:] / np.maximum(pairs[1:], 1), pairs[1:]


def _fitted(lags: np.ndarray, found: np.ndarray, pairs: np.ndarray) -> tuple[float, float | None]:
    """Share and seconds for correlations `found` at `lags`; seconds None if a constant fits as well."""
    if not len(lags):
        return 0.0, None
    times = np.append(np.geomspace(SHORTEST * lags[0], LONGEST * lags[-1], TIMES), np.inf)
    curves = np.exp(-lags / times[:, None])
    shares = np.clip(curves @ (pairs * found) / (curves**2 @ pairs), 0, MOST)
    errors = np.square(found - shares[:, None] * curves) @ pairs
    best = int(errors.argmin())
    if float(np.square(found) @ pairs) - errors[best] < ENOUGH:
        return 0.0, None
    if errors[-1] - errors[best] < ENOUGH:
        return float(shares[-1]), None
    return float(shares[best]), float(times[best])
