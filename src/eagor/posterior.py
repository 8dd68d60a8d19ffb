"""Reading a belief: modes, regions and integrals of exp(f) for one field f on the sphere, in NumPy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eagor.grids import ErpGrid, ErpWindow
from eagor.peaks import peak_on_grid, refine

CELLS_PER_SIGMA = 3.0  # grid spacing against the width of the sharpest peak: integrals converge long before that
CELLS_FOR_REGIONS = 8.0  # ... but the border of a region of 90 % is only as sharp as the cells that it cuts
MAX_ROWS = 1024  # 0.18 degrees: nothing that a camera robot asks for is finer
NEGLIGIBLE = 18.0  # nats below the top: what lies there holds less than 1e-4 of the sharpest belief
PROMINENCE = 0.7  # nats: a peak counts as a mode if it stands out by a factor of two from the saddle around it
MIN_WEIGHT = 0.02  # ... and holds at least this share of the belief,
RIVAL = 0.75  # or rises above a typical direction by this share of the best one's height


Field = Callable[[ErpGrid | ErpWindow], np.ndarray]  # evaluates f on a grid, or on a part of one


@dataclass(frozen=True, eq=False)
class CredibleRegion:
    """The smallest part of the sphere that holds `mass` of a belief (highest-density region).

    `area` in steradians; `angle` (radians): half-angle of the cone about the `mode` that holds the same mass, which
    for several modes is wide, as it should be; `threshold`: the log-density (per steradian) at the region's border.
    """

    mass: float
    threshold: float
    area: float
    angle: float
    mode: np.ndarray
    log_density: Callable[[np.ndarray], np.ndarray]

    def contains(self, directions: np.ndarray) -> np.ndarray:
        """Which of the directions ``(..., 3)`` lie in the region, bool ``(...)``."""
        return self.log_density(np.asarray(directions)) >= self.threshold - 1e-9


@dataclass(frozen=True, eq=False)
class Posterior:
    """exp(f) where it matters, as finely as its sharpest peak asks for. One belief, no batch.

    `evaluate` gives f on a grid. `coarse` ``(H, W)`` is f on `rows` rows, which resolve f itself: peaks and basins are
    looked for there. `field` is f again on a `window` of a finer grid that resolves exp(f), around all cells that are
    not negligible. Each is computed when it is first asked for: a direction alone needs no fine grid.
    """

    evaluate: Field
    rows: int
    cells_per_sigma: float = CELLS_PER_SIGMA

    @property
    def grid(self) -> ErpGrid:
        """The grid of `coarse`."""
        return ErpGrid(self.rows, 2 * self.rows)

    @cached_property
    def coarse(self) -> np.ndarray:
        """f on `grid`."""
        return self.evaluate(self.grid)

    @cached_property
    def window(self) -> ErpWindow:
        """The cells that matter, as small as the sharpest peak asks for."""
        values, rows = self.coarse, self.rows
        _, sigma = refine(self.grid, values.reshape(-1), int(values.argmax()))
        times = min(math.ceil(self.cells_per_sigma * math.pi / sigma / rows), max(1, MAX_ROWS // rows))
        if times <= 1:
            return ErpWindow(self.grid, 0, 0, *self.grid.shape)
        # Between the coarse cells a sharp peak rises higher than any of them: a little slack for that.
        return ErpWindow.around(values > values.max() - NEGLIGIBLE - 4, times)

    @cached_property
    def field(self) -> np.ndarray:
        """f on `window`."""
        return self.coarse if self.window.whole == self.grid else self.evaluate(self.window)

    @cached_property
    def log_total(self) -> float:
        """log of the integral of exp(f) over the sphere."""
        top = float(self.field.max())
        return top + math.log(float(np.sum(np.exp(self.field - top) * self.window.weights)))

    @cached_property
    def probability(self) -> np.ndarray:
        """Probability of each cell of the window; sums to 1."""
        return np.exp(self.field - self.log_total) * self.window.weights

    @property
    def gain(self) -> float:
        """By how many nats the best direction stands above a uniform belief."""
        return float(self.field.max()) - self.log_total + math.log(4 * math.pi)

    @cached_property
    def mode(self) -> np.ndarray:
        """The direction of highest density ``(3,)``."""
        return peak_on_grid(self.grid, self.coarse)

    def mass_above(self, value: float) -> float:
        """The probability of all directions where f exceeds `value`."""
        return float(self.probability[self.field > value].sum())

    def entropy(self) -> float:
        """Differential entropy in nats; log(4 pi) = 2.53 for the uniform belief."""
        return self.log_total - float(np.sum(self.probability * self.field))

    def cone(self, mass: float) -> float:
        """Half-angle (radians) of the cone about the mode that holds `mass`."""
        keep = self.field > self.field.max() - NEGLIGIBLE
        cosine, probability = self.window.directions[keep] @ self.mode, self.probability[keep]
        order = np.argsort(-cosine)
        cosine, probability = cosine[order], probability[order]
        reached = np.cumsum(probability) - probability / 2
        return math.acos(min(1.0, float(np.interp(mass, reached, cosine))))

    def level(self, mass: float) -> tuple[float, float]:
        """The value of f above which `mass` lies, and the solid angle above it.

        Cells that the border cuts count in part: f is taken as uniform over the range that its slope spans in the cell.
        """
        f, top = self.field, float(self.field.max())
        wide = np.pad(f, ((0, 0), (1, 1)), mode="wrap" if self.window.cols == self.window.whole.width else "edge")
        tall = np.pad(f, ((1, 1), (0, 0)), mode="edge")
        side, down = (wide[:, 2:] - wide[:, :-2]) / 2, (tall[2:] - tall[:-2]) / 2
        spread = np.maximum(np.hypot(side, down), 1e-9)
        # A cell's mass is not its midpoint's: the second differences of exp(f) correct it.
        bent = wide[:, 2:] + wide[:, :-2] + tall[2:] + tall[:-2] - 4 * f + side**2 + down**2
        keep = f > top - NEGLIGIBLE
        probability, weights = self.probability, self.window.weights
        p, v, s = (probability * (1 + np.clip(bent / 24, -0.5, 0.5)))[keep], f[keep], spread[keep]
        low, high = float(v.min()) - 1, top + 1
        above, below = np.exp(s / 2), np.exp(-s / 2)
        for _ in range(40):
            middle = (low + high) / 2
            share = (above - np.exp(np.clip(middle - v, -s / 2, s / 2))) / (above - below)
            if float(np.sum(p * share)) >= mass:
                low = middle
            else:
                high = middle
        return low, float(np.sum(weights[keep] * np.clip(0.5 + (v - low) / s, 0, 1)))

    def _median(self) -> float:
        """The value of f that half of the sphere lies above."""
        values, areas = self.coarse.reshape(-1), self.grid.weights.reshape(-1)
        order = np.argsort(values)
        return float(values[order][np.searchsorted(np.cumsum(areas[order]), areas.sum() / 2)])

    def modes(self, count: int, prominence: float, min_weight: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Directions ``(n, 3)``, weights ``(n,)`` and heights ``(n,)`` of at most `count` modes, highest density first.

        Each cell climbs to its peak; basins whose peak stands less than `prominence` nats above the saddle to a higher
        one join that one.

        A mode's weight is its share of what stands out: the probability in its basin in excess of a typical direction's
        (the median of f over the sphere). For a sharp belief that is the probability of the basin; early on, when most
        of the belief still lies anywhere, it keeps the candidates comparable. Its height is how far f rises there above
        the typical direction, relative to the best. Modes below both `min_weight` and `RIVAL` are left out: looks
        that repeat each other turn a small difference in height into any difference in weight.
        """
        height, width = self.coarse.shape
        label = _merge(self.coarse, _climb(self.coarse), prominence)
        peaks, inverse = np.unique(label, return_inverse=True)
        if len(peaks) == 1:
            return self.mode[None], np.ones(1), np.ones(1)
        typical = self._median()
        excess = np.maximum(self.probability - np.exp(typical - self.log_total) * self.window.weights, 0.0)
        times = self.window.whole.height // height
        rows = (self.window.top + np.arange(self.window.rows)) // times
        basin = inverse.reshape(height, width)[rows[:, None], self.window.columns // times]
        weight = np.bincount(basin.reshape(-1), excess.reshape(-1), minlength=len(peaks))
        weight = weight / weight.sum()
        flat = self.coarse.reshape(-1)
        stands = (flat[peaks] - typical) / (flat.max() - typical)
        order = [i for i in np.argsort(-flat[peaks]) if weight[i] >= min_weight or stands[i] >= RIVAL][:count]
        return np.array([refine(self.grid, flat, int(peaks[i]))[0] for i in order]), weight[order], stands[order]


def _over_pole(row: np.ndarray) -> np.ndarray:
    """The row ``(1, W)`` that lies beyond the pole from this one."""
    return np.roll(row, row.shape[1] // 2, axis=1)


def _neighbours(values: np.ndarray) -> list[np.ndarray]:
    """`values` ``(H, W)`` of each cell's right, lower-left, lower and lower-right neighbours, then the opposites."""
    tall = np.concatenate([_over_pole(values[:1]), values, _over_pole(values[-1:])])
    shifts = [(1, -1), (2, 1), (2, 0), (2, -1), (1, 1), (0, -1), (0, 0), (0, 1)]
    return [np.roll(tall[row : row + len(values)], side, axis=1) for row, side in shifts]


def _climb(field: np.ndarray) -> np.ndarray:
    """For each cell, the index of the peak that steepest ascent leads to ``(H, W)``."""
    index = np.arange(field.size).reshape(field.shape)
    best, target = field.copy(), index.copy()
    for value, where in zip(_neighbours(field), _neighbours(index), strict=True):
        # Equal values lead to the larger index, so that plateaus have one peak and no cycles.
        better = (value > best) | ((value == best) & (where > target))
        best, target = np.where(better, value, best), np.where(better, where, target)
    target = target.reshape(-1)
    while True:
        further = target[target]
        if np.array_equal(further, target):
            return target.reshape(field.shape)
        target = further


def _merge(field: np.ndarray, label: np.ndarray, prominence: float) -> np.ndarray:
    """Labels after basins that do not stand out have joined a higher neighbour (persistence, highest saddle first)."""
    saddles: dict[tuple[int, int], float] = {}
    for value, other in zip(_neighbours(field)[:4], _neighbours(label)[:4], strict=True):
        border = label != other
        height = np.minimum(field[border], value[border])
        for a, b, h in zip(label[border].tolist(), other[border].tolist(), height.tolist(), strict=True):
            key = (a, b) if a < b else (b, a)
            if h > saddles.get(key, -math.inf):
                saddles[key] = h
    flat = field.reshape(-1)
    parent = {int(peak): int(peak) for peak in np.unique(label)}

    def root(peak: int) -> int:
        while parent[peak] != peak:
            peak = parent[peak]
        return peak

    for (a, b), height in sorted(saddles.items(), key=lambda item: -item[1]):
        low, high = sorted((root(a), root(b)), key=lambda peak: flat[peak])
        if low != high and flat[low] - height < prominence:
            parent[low] = high
    table = np.arange(flat.size)
    for peak in parent:
        table[peak] = root(peak)
    return table[label]
