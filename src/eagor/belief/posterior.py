"""Reading a belief: modes, regions and integrals of exp(f) for a field f on the sphere. NumPy.

`Posterior` samples one field finely enough for its sharpest peak; `Readable` is what `Belief` and `RangedBelief` share,
batches included.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eagor._arrays import Array, to_numpy
from eagor._values import lazy, where, wide
from eagor.belief.basins import PROMINENCE, basins
from eagor.belief.density import Masses
from eagor.errors import EagorError
from eagor.grids import ErpGrid, ErpWindow
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import FLAT, decoding_grid, peak_on_grid, refine
from eagor.sphere import azimuth_elevation

CELLS_PER_SIGMA = 3.0  # grid spacing against the width of the sharpest peak: integrals converge long before that
CELLS_FOR_REGIONS = 8.0  # the same for the border of a region, which needs finer cells than an integral
MAX_ROWS = 1024  # 0.18 degrees: fine enough for a camera robot
MAX_CELLS = 1 << 18  # a window may always have so many, however fine: thousands of nats make finer peaks
ERROR = 1e-4  # of the probability: a coarse cell with a larger error of the midpoint rule is refined
SHARE = 0.01  # of the probability: a cell that holds more is refined too
MIN_WEIGHT = 0.02  # of the belief: what holds so much is a mode
RIVAL = 0.6  # of the best mode's height over a typical direction: what rises so high is a mode too
CLEAR = 9.0  # nats: the most that counts as that height, so that one very sure mode does not hide the others
RIPPLE = 0.1  # of the best mode's height: less is ringing (the first sidelobe of a truncated peak has 0.07)


def typical(values: np.ndarray, weights: np.ndarray) -> float:
    """The median over cells of these solid angles."""
    values, areas = values.reshape(-1), weights.reshape(-1)
    order = np.argsort(values)
    return float(values[order][np.searchsorted(np.cumsum(areas[order]), areas.sum() / 2)])


Field = Callable[[ErpGrid | ErpWindow], np.ndarray]  # evaluates f on a grid, or on a part of one


@dataclass(frozen=True, eq=False)
class CredibleRegion:
    """The smallest part of the sphere that holds `mass` of a belief (highest-density region).

    `area` in steradians; `angle` (radians): half-angle of the cone that is centred on the `mode` and holds the same
    mass, wide if there are several modes; `threshold`: log density (per steradian) at the region's border.
    """

    mass: float
    threshold: float
    area: float
    angle: float
    mode: np.ndarray
    log_density: Callable[[np.ndarray], Array]

    def __repr__(self) -> str:
        mode = where(*(float(angle) for angle in azimuth_elevation(self.mode)))
        size = f"{self.area:.3g} sr, within {wide(self.angle)} of {mode}"
        return f"CredibleRegion({100 * self.mass:g} %, {size})"

    def contains(self, directions: np.ndarray) -> np.ndarray:
        """Which of the directions ``(..., 3)`` lie in the region, bool ``(...)``."""
        return to_numpy(self.log_density(np.asarray(directions))) >= self.threshold - 1e-9


@dataclass(frozen=True, eq=False)
class _Part:
    """Cells of one size: f on them, a mask of those `used`, and the coarse cell around each."""

    cells: ErpWindow
    field: np.ndarray
    used: np.ndarray
    home: np.ndarray

    @classmethod
    def whole(cls, grid: ErpGrid, field: np.ndarray) -> _Part:
        """All cells of the coarse grid."""
        cells = ErpWindow(grid, 0, 0, *grid.shape)
        return cls(cells, field, np.ones(grid.shape, dtype=bool), np.arange(field.size).reshape(grid.shape))

    @lazy
    def _around(self) -> tuple[np.ndarray, np.ndarray]:
        """f with its neighbours to both sides, and with those above and below."""
        wraps = self.cells.cols == self.cells.whole.width
        wide = np.pad(self.field, ((0, 0), (1, 1)), mode="wrap" if wraps else "edge")
        return wide, np.pad(self.field, ((1, 1), (0, 0)), mode="edge")

    @lazy
    def _slopes(self) -> tuple[np.ndarray, np.ndarray]:
        wide, tall = self._around
        return (wide[:, 2:] - wide[:, :-2]) / 2, (tall[2:] - tall[:-2]) / 2

    @property
    def spread(self) -> np.ndarray:
        """The range of f within each cell: no more to either side than f rises or falls to the next cell."""
        (wide, tall), (side, down), f = self._around, self._slopes, self.field
        side = np.minimum(np.abs(side), np.minimum(np.abs(wide[:, 2:] - f), np.abs(wide[:, :-2] - f)))
        down = np.minimum(np.abs(down), np.minimum(np.abs(tall[2:] - f), np.abs(tall[:-2] - f)))
        return np.maximum(np.hypot(side, down), 1e-9)

    @property
    def bend(self) -> np.ndarray:
        """Second differences of exp(f), relative to it."""
        wide, tall = self._around
        side, down = self._slopes
        return wide[:, 2:] + wide[:, :-2] + tall[2:] + tall[:-2] - 4 * self.field + side**2 + down**2


@dataclass(frozen=True, eq=False)
class Posterior(Masses):
    """exp(f), sampled finely enough for its sharpest peak. One belief, no batch.

    `evaluate` gives f on a grid. `coarse` ``(H, W)`` is f on `rows` rows, which resolve f itself: peaks and basins are
    found there. Around the highest peaks exp(f) is sharper than f, and a `window` of finer cells replaces the coarse
    ones; together they cover the sphere. All is computed on demand: a direction alone needs no fine grid.
    """

    evaluate: Field
    rows: int
    cells_per_sigma: float = CELLS_PER_SIGMA

    @property
    def grid(self) -> ErpGrid:
        """The grid of `coarse`."""
        return ErpGrid(self.rows, 2 * self.rows)

    @lazy
    def coarse(self) -> np.ndarray:
        """f on `grid`."""
        return self.evaluate(self.grid)

    @lazy
    def window(self) -> ErpWindow:
        """The part where exp(f) is sharp, in cells fine enough for it; the whole coarse grid if there is none."""
        values, rows = self.coarse, self.rows
        _, sigma = refine(self.grid, values.reshape(-1), int(values.argmax()))
        part = _Part.whole(self.grid, values)
        mass = np.exp(values - values.max()) * self.grid.weights
        mass /= mass.sum()
        finer = (CELLS_PER_SIGMA / self.cells_per_sigma) ** 3
        rough = (mass * np.abs(part.bend) / 24 > ERROR * finer) | (mass > SHARE * finer)
        times = math.ceil(self.cells_per_sigma * math.pi / sigma / rows)
        if times <= 1 or not rough.any():
            return part.cells
        size = math.prod(ErpWindow.around(rough, 1).shape)
        return ErpWindow.around(rough, min(times, max(1, MAX_ROWS // rows, math.isqrt(MAX_CELLS // size))))

    @lazy
    def _parts(self) -> tuple[_Part, ...]:
        """The cells that cover the sphere: those of the window, and the coarse ones outside of it."""
        whole = _Part.whole(self.grid, self.coarse)
        if self.window.whole == self.grid:
            return (whole,)
        times = self.window.whole.height // self.rows
        home_rows = (self.window.top + np.arange(self.window.rows)) // times
        home = home_rows[:, None] * self.grid.width + self.window.columns // times
        outside = np.ones(self.grid.shape, dtype=bool)
        outside.reshape(-1)[np.unique(home)] = False
        fine = self.evaluate(self.window)
        return _Part(self.window, fine, np.ones(fine.shape, dtype=bool), home), replace(whole, used=outside)

    def _all(self, read: Callable[[_Part], np.ndarray]) -> np.ndarray:
        """The values of `read` for all cells ``(n, ...)``."""
        return np.concatenate([read(part)[part.used] for part in self._parts])

    @lazy
    def values(self) -> np.ndarray:  # type: ignore[override]
        """f of all cells ``(n,)``."""
        return self._all(lambda part: part.field)

    @lazy
    def weights(self) -> np.ndarray:  # type: ignore[override]
        """Solid angles of all cells ``(n,)``."""
        return self._all(lambda part: part.cells.weights)

    @property
    def directions(self) -> np.ndarray:  # type: ignore[override]
        """The middles of all cells ``(n, 3)``."""
        return self._all(lambda part: part.cells.directions)

    @lazy
    def mode(self) -> np.ndarray:
        """The direction of highest density ``(3,)``."""
        return peak_on_grid(self.grid, self.coarse)

    def level(self, mass: float) -> tuple[float, float]:
        """The value of f above which `mass` lies, and the solid angle above it.

        Cells at the border count in part: f is treated as uniform over its range in the cell.
        """
        spread, bend = self._all(lambda part: part.spread), self._all(lambda part: part.bend)
        # Correct the midpoint rule by the second differences of exp(f).
        p, v, top = self.mass * (1 + np.clip(bend / 24, -0.5, 0.5)), self.values, float(self.values.max())
        p /= p.sum()
        low, high = float(v.min()) - 1, top + 1
        whole = -np.expm1(-spread)
        for _ in range(40):
            middle = (low + high) / 2
            # Relative to the cell's highest value: f may vary by thousands of nats within a cell.
            share = -np.expm1(np.clip(middle - v, -spread / 2, spread / 2) - spread / 2) / whole
            if float(np.sum(p * share)) >= mass:
                low = middle
            else:
                high = middle
        return low, float(np.sum(self.weights * np.clip(0.5 + (v - low) / spread, 0, 1)))

    def modes(self, count: int, prominence: float, min_weight: float) -> tuple[np.ndarray, np.ndarray]:
        """Directions ``(n, 3)`` and weights ``(n,)`` of at most `count` modes, highest density first.

        Each cell climbs to its peak; basins whose peak stands less than `prominence` nats above the saddle to a higher
        one join that one.

        A mode's weight is its share of what stands out: the probability in its basin in excess of a typical direction's
        (the median of f over the sphere). For a sharp belief that is the probability of the basin; early on, when most
        of the belief still lies anywhere, it keeps the candidates comparable. Its height is how far f rises there above
        the typical direction, relative to the best, or to `CLEAR` where that is less. Modes below both `min_weight` and
        `RIVAL` are left out: looks that repeat each other turn a small difference in height into any difference in
        weight. So is what rises by less than `RIPPLE` of the best: a small thing rings all around.
        """
        label = basins(self.coarse, prominence)
        peaks, inverse = np.unique(label, return_inverse=True)
        if len(peaks) == 1:
            return self.mode[None], np.ones(1)
        middle = typical(self.coarse, self.grid.weights)
        excess = np.maximum(self.mass - np.exp(middle - self.log_total) * self.weights, 0.0)
        basin = inverse.reshape(-1)[self._all(lambda part: part.home)]
        weight = np.bincount(basin, excess, minlength=len(peaks))
        weight = weight / weight.sum()
        flat = self.coarse.reshape(-1)
        height, best = flat[peaks] - middle, flat.max() - middle
        stands = height / min(best, CLEAR)
        kept = (height >= RIPPLE * best) & ((weight >= min_weight) | (stands >= RIVAL))
        order = [i for i in np.argsort(-flat[peaks]) if kept[i]][:count]
        return np.array([refine(self.grid, flat, int(peaks[i]))[0] for i in order]), weight[order]


class Readable:
    """What can be read from any posterior over directions; `Belief` and `RangedBelief` supply the field.

    Results have the belief's leading batch dimensions. They are computed in NumPy, whatever arrays the belief holds.
    """

    @property
    def degree(self) -> int:
        """The highest degree of the harmonics."""
        raise NotImplementedError

    @property
    def basis(self) -> RealHarmonics:
        """The basis of the coefficients."""
        return RealHarmonics(self.degree)

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading dimensions."""
        raise NotImplementedError

    def _field(self, index: tuple[int, ...]) -> Field:
        """A function that evaluates the log-posterior of one belief of the batch (up to a constant), in NumPy.

        It must not refer to the belief, which caches it: a reference cycle would stay in memory until the garbage
        collector runs.
        """
        raise NotImplementedError

    @lazy
    def posteriors(self) -> np.ndarray:
        """The `Posterior` of each belief of the batch, an object array (cached)."""
        found = np.empty(self.batch_shape, dtype=object)
        for index in np.ndindex(*self.batch_shape):
            found[index] = Posterior(self._field(index), decoding_grid(self.degree).height)
        return found

    def _told(self) -> str:
        """A short summary of one belief; of a batch, its shape."""
        if self.batch_shape:
            return f"batch {self.batch_shape}"
        posterior = self.posterior
        if not np.isfinite(posterior.coarse).all():
            return "not finite"
        if float(np.ptp(posterior.coarse)) < FLAT:
            return "nothing known"
        azimuth, elevation = (float(angle) for angle in azimuth_elevation(posterior.mode))
        return f"{where(azimuth, elevation)}, 90 % within {wide(posterior.cone(0.9, posterior.mode))}"

    def _repr_html_(self) -> str:
        """A small picture, for notebooks; text only for a batch or values that are not finite."""
        from eagor import thumbnail

        if self.batch_shape or not np.isfinite(self.posterior.coarse).all():
            return thumbnail.text_html(repr(self))
        region = self.credible_region(0.9)
        return thumbnail.density_html(repr(self), self.log_density, region.threshold, region.area)

    @property
    def posterior(self) -> Posterior:
        """The posterior of a belief without batch dimensions."""
        self._check_single()
        found: Any = self.posteriors[()]
        return found

    def _check_single(self) -> None:
        if self.batch_shape:
            raise EagorError(f"this reads one belief, and got a batch {self.batch_shape}; index it: belief[i]")

    def modes(
        self, k: int = 3, prominence: float = PROMINENCE, min_weight: float = MIN_WEIGHT
    ) -> tuple[np.ndarray, np.ndarray]:
        """At most `k` separate peaks, highest density first: directions ``(..., n, 3)`` and weights ``(..., n)``.

        A mode stands at least `prominence` nats above the saddle around it. Its weight is the share of its basin in the
        density above that of a typical direction. Modes lighter than `min_weight` are left out unless they rise nearly
        as high as the best. n is the largest number in the batch; beliefs with fewer modes are filled up with weight 0
        and the first direction.
        """
        found = [p.modes(k, prominence, min_weight) for p in self.posteriors.reshape(-1)]
        most = max((len(weights) for _, weights in found), default=0)
        directions = [np.concatenate([d, np.repeat(d[:1], most - len(d), axis=0)]) for d, _ in found]
        weights = [np.concatenate([w, np.zeros(most - len(w))]) for _, w in found]
        shape = self.batch_shape
        return np.reshape(directions, (*shape, most, 3)), np.reshape(weights, (*shape, most))

    def credible_angle(self, mass: float = 0.9) -> Any:
        """Half-angle (radians, ``(...)``) of the cone that is centred on the mode and holds `mass` of the belief."""
        return self._each(lambda p: p.cone(checked_mass(mass), p.mode))

    def credible_region(self, mass: float = 0.9) -> CredibleRegion:
        """The smallest region that holds `mass` of the belief (highest density). One belief at a time."""
        self._check_single()
        posterior = Posterior(self._field(()), decoding_grid(self.degree).height, CELLS_FOR_REGIONS)
        level, area = posterior.level(checked_mass(mass))
        return CredibleRegion(
            mass=mass,
            threshold=level - posterior.log_total,
            area=area,
            angle=posterior.cone(mass, posterior.mode),
            mode=posterior.mode,
            log_density=self.log_density,
        )

    def mass_above(self, direction: np.ndarray) -> float:
        """The mass of the smallest highest-density region that reaches `direction` ``(3,)``. One belief at a time.

        If it is below 0.9, `direction` lies in the 90 % region. For true directions and calibrated beliefs it is
        uniform in [0, 1].
        """
        density = float(to_numpy(self.log_density(np.asarray(direction, dtype=np.float64))))
        return self.posterior.mass_over(density + self.posterior.log_total)

    def entropy(self) -> Any:
        """Differential entropy ``(...)`` in nats: log(4 pi) = 2.53 for a uniform belief, negative for a sharp one."""
        return self._each(lambda p: p.entropy())

    def presence(self, prior: float = 0.5) -> Any:
        """Probability ``(...)`` that the target is present.

        prior Z / (prior Z + 1 - prior), where Z = (1 / 4 pi) integral of exp(f) is the likelihood ratio of all evidence
        so far, averaged over directions.
        """
        from scipy.special import expit, logit

        if not 0 <= prior <= 1:
            raise EagorError(f"prior = {prior!r}; wanted a probability in [0, 1]")
        odds = logit(prior) - math.log(4 * math.pi)  # infinite for 0 and 1
        return self._each(lambda p: expit(odds + p.log_total))

    def log_density(self, directions: Array) -> Array:
        """log p per steradian at unit vectors ``(n..., 3)``: ``(..., n...)``; integrates to 1."""
        raise NotImplementedError

    def _log_totals(self, ndim: int) -> np.ndarray:
        """log of the integral of exp(f), shaped to be subtracted from values of `ndim` dimensions."""
        totals = np.asarray(self._each(lambda p: p.log_total))
        return totals.reshape(self.batch_shape + (1,) * (ndim - len(self.batch_shape)))

    def _each(self, read: Callable[[Posterior], float]) -> Any:
        values = [read(p) for p in self.posteriors.reshape(-1)]
        return np.reshape(values, self.batch_shape) if self.batch_shape else float(values[0])


def checked_mass(mass: float) -> float:
    """`mass` itself. Raises `EagorError` unless it is strictly between 0 and 1."""
    if not 0 < mass < 1:
        raise EagorError(f"mass = {mass!r}; wanted a probability strictly between 0 and 1, such as 0.9")
    return mass
