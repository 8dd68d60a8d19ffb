"""A belief about direction AND distance, for a camera that moves: parallax gives the distance from bearings alone.

There are K fields, one per shell of constant range, log-spaced. A step of the body moves near points (omega, r) more
than far ones, so only the shell at the true range keeps agreeing with later bearings.

Shells hold log-likelihood ratios. The prior is uniform in direction and log range and enters when the belief is read:
the direction belief is the log of the shells' mean likelihood, the distance is a posterior mean. Where the camera's
height is known, a prior from floors takes its place: things stand on them, which relates direction and range.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from eagor._arrays import Array, as_float, frozen, namespace, table_like, to_library, to_numpy
from eagor._values import lazy
from eagor.belief.direction import Belief
from eagor.belief.posterior import Field, Readable
from eagor.errors import EagorError, PoseError
from eagor.evidence import Evidence
from eagor.grids import ErpGrid, ErpWindow
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import decoding_grid, peak_on_grid
from eagor.harmonics.shells import translate
from eagor.sphere import check_rotation

__all__ = ["RangedBelief", "log_ranges", "mean_range", "range_spread"]


def log_ranges(nearest: float = 0.5, farthest: float = 12.0, count: int = 14) -> np.ndarray:
    """`count` ranges (metres) from `nearest` to `farthest`, equally spaced in the logarithm.

    >>> eagor.log_ranges(1.0, 4.0, count=3).tolist()
    [1.0, 2.0, 4.0]
    """
    return np.geomspace(nearest, farthest, count)


NEAR = math.radians(20)  # radius about a direction over which its range is read


@dataclass(frozen=True, eq=False)
class RangedBelief(Readable):
    """Direction and distance: `shells` ``(..., K, (degree + 1)^2)`` at `ranges` ``(K,)`` metres, in the body frame.

    `prior` ``(K, (degree + 1)^2)``, such as `heights.height_prior`: prior knowledge of direction and range, used when
    the belief is read. None: uniform. `predict` turns it but does not translate it, which is right on level ground.

        >>> before, after = eagor.Evidence.from_points([[0, 1, 0]]), eagor.Evidence.from_points([[-0.5, 1, 0]])
        >>> belief = eagor.RangedBelief.uniform(15).update(before).predict(np.eye(3), [0.5, 0.0, 0.0]).update(after)
        >>> belief.distance() < eagor.RangedBelief.uniform(15).distance()  # the bearing has turned: it is near
        True
    """

    shells: Array
    ranges: np.ndarray
    prior: np.ndarray | None = None

    def __post_init__(self) -> None:
        ranges = np.array(self.ranges, dtype=np.float64)
        if ranges.ndim != 1 or len(ranges) < 2 or not (ranges[0] > 0 and (np.diff(ranges) > 0).all()):
            raise EagorError(f"ranges = {ranges.tolist()}; wanted at least two growing positive numbers, in metres")
        if len(self.shells.shape) < 2 or self.shells.shape[-2] != len(ranges):
            raise EagorError(
                f"shells have shape {tuple(self.shells.shape)}; {len(ranges)} ranges want (..., {len(ranges)}, size)"
            )
        Belief(self.shells)  # raises if the number of coefficients fits no degree
        if self.prior is not None and tuple(self.prior.shape) != tuple(self.shells.shape[-2:]):
            raise EagorError(f"the prior has shape {tuple(self.prior.shape)}; wanted {tuple(self.shells.shape[-2:])}")
        object.__setattr__(self, "ranges", frozen(ranges))

    @classmethod
    def uniform(
        cls,
        degree: int,
        ranges: np.ndarray | None = None,
        batch_shape: tuple[int, ...] = (),
        like: Array | None = None,
    ) -> RangedBelief:
        """A uniform belief. `ranges` in metres (default: 14 from 0.5 to 12 m), in arrays like `like`."""
        ranges = log_ranges() if ranges is None else np.asarray(ranges, dtype=np.float64)
        return cls(Belief.uniform(degree, (*batch_shape, len(ranges)), like).coefficients, ranges)

    @property
    def degree(self) -> int:
        """The highest degree of the harmonics."""
        return math.isqrt(self.shells.shape[-1]) - 1

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading dimensions, without that of the shells."""
        return tuple(self.shells.shape[:-2])

    def __getitem__(self, index: Any) -> RangedBelief:
        """Part of a batch."""
        if not self.batch_shape:
            raise EagorError("this belief has no batch dimension to index")
        places = index if isinstance(index, tuple) else (index,)
        return replace(
            self, shells=self.shells[(*places, ..., slice(None), slice(None))]
        )  # the last two are not batch dimensions

    def predict(self, new_R_old: Array, translation: Array | None = None) -> RangedBelief:
        """After the body has turned by `new_R_old` and moved by `translation` (metres, in the NEW body frame).

        Both may have leading dimensions that match the batch. Raises `RotationError`, or `PoseError` for a translation
        that is not three finite numbers.
        """
        turn = to_numpy(check_rotation(new_R_old))
        step = np.zeros(3) if translation is None else np.asarray(to_numpy(translation), dtype=np.float64)
        if step.shape[-1:] != (3,) or not np.isfinite(step).all():
            raise PoseError(
                f"translation = {step.tolist()}; wanted (x, y, z) metres of the body, in the new body frame"
            )
        shells = as_float(self.shells)
        if self.prior is not None and turn.ndim > 2:
            raise EagorError("a belief with a prior turns as one; wanted one rotation (3, 3) for the batch")
        prior = None if self.prior is None else self.basis.rotate(self.prior, turn)
        if turn.ndim == 2 and step.ndim == 1:
            return replace(self, shells=translate(self.degree, shells, self.ranges, turn, step), prior=prior)
        turn = np.broadcast_to(turn, (*self.batch_shape, 3, 3))
        step = np.broadcast_to(step, (*self.batch_shape, 3))
        moved = [
            translate(self.degree, shells[index], self.ranges, turn[index], step[index])
            for index in np.ndindex(*self.batch_shape)
        ]
        xp = namespace(shells)
        return replace(self, shells=xp.reshape(xp.stack(moved), shells.shape), prior=prior)

    def update(self, evidence: Evidence | Sequence[Evidence]) -> RangedBelief:
        """With one more look added: one `Evidence` for all shells, or one per shell.

        Arrays are converted as in `Belief.update`.
        """
        if isinstance(evidence, Evidence):
            return self.plus(evidence.coefficients(self.degree)[..., None, :])
        if len(evidence) != len(self.ranges):
            raise EagorError(f"got evidence for {len(evidence)} shells; wanted one, or {len(self.ranges)}")
        added = [to_library(look.coefficients(self.degree), self.shells) for look in evidence]
        return self.plus(namespace(self.shells).stack(added, axis=-2))

    def plus(self, log_ratios: Array) -> RangedBelief:
        """With log ratios added, given as coefficients: ``(size,)`` for all ranges, or ``(..., K, size)``.

        They are converted to this belief's arrays.
        """
        return replace(self, shells=self.shells + to_library(log_ratios, self.shells))

    def __repr__(self) -> str:
        ranges = f"{len(self.ranges)} ranges {self.ranges[0]:.3g} to {self.ranges[-1]:.3g} m"
        return f"RangedBelief(degree {self.degree}, {ranges}, {self._told()})"

    def between(self, logs: np.ndarray) -> np.ndarray:
        """The shells ``(n, size)`` at these logarithms ``(n,)`` of ranges, by cubic splines."""
        return _between(tuple(self.ranges.tolist()))(logs) @ self.shells

    def forget(self, factor: float) -> RangedBelief:
        """With all log-odds scaled by `factor` in [0, 1]."""
        return replace(self, shells=Belief(self.shells).forget(factor).coefficients)

    def diffuse(self, sigma: float) -> RangedBelief:
        """With each shell's density spread by a Gaussian of `sigma` radians per axis."""
        return replace(self, shells=Belief(self.shells).diffuse(sigma).coefficients)

    def direction_belief(self) -> Belief:
        """The belief over directions alone, projected back to this degree."""
        grid = decoding_grid(self.degree)
        return Belief(self.basis.analyse(self._marginal(grid), grid))

    def log_density(self, directions: Array) -> np.ndarray:
        """log p per steradian at unit vectors ``(n..., 3)``: ``(..., n...)``; integrates to 1."""
        f = to_numpy(self._marginal(directions))
        return f - self._log_totals(f.ndim)

    def mode(self) -> Array:
        """The direction of highest density ``(..., 3)``, over all ranges, in the belief's array library."""
        grid = decoding_grid(self.degree)
        return peak_on_grid(grid, self._marginal(grid))

    def range_probabilities(self, about: np.ndarray | None = None) -> np.ndarray:
        """Probability of each shell ``(..., K)``; `about` ``(3,)``: given that the target lies near that direction.

        "Near" is within `NEAR`: candidates elsewhere do not count.
        """
        return self._range_probabilities if about is None else self._ranges_near(about)

    @lazy
    def _range_probabilities(self) -> np.ndarray:
        return self._ranges_near(None)

    def _ranges_near(self, about: np.ndarray | None) -> np.ndarray:
        coefficients = to_numpy(self._believed).astype(np.float64)
        found = np.zeros((*self.batch_shape, len(self.ranges)))
        for index in np.ndindex(*self.batch_shape):
            posterior: Any = self.posteriors[index]
            # Far from the peaks of the sum over all ranges, the shares are negligible.
            cells: ErpGrid | ErpWindow = posterior.window
            weights = _near(cells, about)
            if not weights.any():
                cells = posterior.grid
                weights = _near(cells, about)
            counts = weights > 0
            field = self.basis.synthesise(coefficients[index], cells)[..., counts]
            mass = np.exp(field - field.max()) @ weights[counts] * self._shares
            found[index] = mass / mass.sum()
        return frozen(found)

    def distance(self, about: np.ndarray | None = None) -> Any:
        """Posterior mean of the range ``(...)``, metres; `about` as for `range_probabilities`."""
        found = mean_range(self.range_probabilities(about), self.ranges)
        return found if self.batch_shape else float(found)

    def distance_spread(self, about: np.ndarray | None = None) -> Any:
        """Relative uncertainty of the distance ``(...)``: standard deviation of the logarithm of the range.

        About 1 for a uniform belief over 0.3 to 8 metres, 0.1 if the distance is known to 10 %. It is never below that
        of a range somewhere in one shell. `about` as for `range_probabilities`.
        """
        found = np.hypot(range_spread(self.range_probabilities(about), self.ranges), self.within_shell)
        return found if self.batch_shape else float(found)

    @property
    def within_shell(self) -> float:
        """The standard deviation of the logarithm of a range that may be anywhere in a shell."""
        return math.sqrt(variance_in_shell(self.ranges))

    @property
    def _shares(self) -> np.ndarray:
        return log_shares(self.ranges)

    @property
    def _believed(self) -> Array:
        """The shells with the prior."""
        if self.prior is None:
            return self.shells
        return self.shells + table_like(self.prior, self.shells)

    def _marginal(self, where: Any) -> Array:
        return _marginal(self.basis, self._shares, self._believed, where)

    def _field(self, index: tuple[int, ...]) -> Field:
        shells, basis, shares = to_numpy(self._believed)[index].astype(np.float64), self.basis, self._shares
        return lambda where: _marginal(basis, shares, shells, where)


def variance_in_shell(ranges: np.ndarray) -> float:
    """The variance of the logarithm of a range that may be anywhere from one of `ranges` ``(K,)`` to the next."""
    return (math.log(ranges[-1] / ranges[0]) / max(len(ranges) - 1, 1)) ** 2 / 12  # of an even distribution


def mean_range(probabilities: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    """The mean ``(...)``, metres, of ranges ``(K,)`` with these probabilities ``(..., K)``."""
    return probabilities @ ranges


def range_spread(probabilities: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    """The standard deviation ``(...)`` of the logarithm of ranges ``(K,)`` with these probabilities ``(..., K)``."""
    log_range = np.log(ranges)
    mean = probabilities @ log_range
    return np.sqrt(np.maximum(probabilities @ log_range**2 - mean**2, 0.0))


@lru_cache(maxsize=16)
def _between(ranges: tuple[float, ...]) -> Callable[[np.ndarray], np.ndarray]:
    """The weights ``(n, len(ranges))`` of the shells at logarithms ``(n,)`` of ranges between them."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(np.log(ranges), np.eye(len(ranges)))


def _near(cells: ErpGrid | ErpWindow, about: np.ndarray | None) -> np.ndarray:
    """Solid angles ``(H, W)`` of the cells near a direction, 0 elsewhere; of all cells without one."""
    weights = np.broadcast_to(cells.weights, cells.shape)
    return weights if about is None else np.where(cells.directions @ about >= math.cos(NEAR), weights, 0.0)


def log_shares(ranges: np.ndarray) -> np.ndarray:
    """Prior probability of each shell ``(K,)``: its share of the logarithm of the range."""
    width = np.gradient(np.log(ranges))
    return width / width.sum()


def _marginal(basis: RealHarmonics, shares: np.ndarray, shells: Array, where: Any) -> Array:
    """log of the mean of exp(f_k) over the shells, weighed by their `shares`, on a grid or at directions."""
    xp = namespace(shells)
    if xp is np and shells.ndim == 2:  # in place, and the share as a part of each shell's constant
        shells = shells.copy()
        shells[:, 0] += math.sqrt(4 * math.pi) * np.log(shares)
        f = basis.synthesise(shells, where)
        top = f.max(axis=0)
        f -= top
        return np.log(np.exp(f, out=f).sum(axis=0)) + top
    f = basis.synthesise(shells, where)
    axis = len(shells.shape) - 2
    log_prior = np.log(shares).reshape(-1, *([1] * (len(f.shape) - axis - 1)))
    if xp is not np:
        log_prior = xp.asarray(log_prior, dtype=f.dtype, device=f.device)
    f = f + log_prior
    top = xp.max(f, axis=axis, keepdims=True)
    return xp.log(xp.sum(xp.exp(f - top), axis=axis)) + xp.squeeze(top, axis=axis)


# Heights (metres) of the middles of things above the floor: furniture about half a metre, things on walls or on
# furniture up to two.
MIDDLE, SPREAD = 0.7, 0.5
ODD = 0.02  # share of things at any height


def height_prior(
    degree: int, ranges: np.ndarray, camera: float, middle: float = MIDDLE, spread: float = SPREAD
) -> np.ndarray:
    """The prior that things stand on a floor: ``(K, (degree + 1)^2)`` for `RangedBelief`, z up.

    A thing at range r and elevation e is at the height `camera` + r sin(e) above the floor (metres). Heights are
    normally distributed about `middle`, or with probability `ODD` uniform. The prior is a log ratio against a uniform
    one in direction and log range; its mean likelihood is 1.
    """
    grid, ranges = decoding_grid(degree), np.asarray(ranges, dtype=np.float64)
    likely = likely_height(camera + ranges[:, None, None] * grid.directions[..., 2], middle, spread)
    mean = np.sum(log_shares(ranges)[:, None, None] * likely * grid.weights) / (4 * math.pi)
    return RealHarmonics(degree).analyse(np.log(likely / mean), grid)


def likely_height(height: np.ndarray, middle: float = MIDDLE, spread: float = SPREAD) -> np.ndarray:
    """Density of things at these heights (metres above the floor), over its maximum."""
    return ODD + (1 - ODD) * np.exp(-0.5 * ((height - middle) / spread) ** 2)


@lru_cache(maxsize=64)
def height_level(degree: int, ranges: tuple[float, ...], camera: float) -> float:
    """log of the mean of `likely_height` over all directions and ranges."""
    grid, shells = decoding_grid(degree), np.array(ranges)
    likely = likely_height(camera + shells[:, None, None] * grid.directions[..., 2])
    return math.log(float(np.sum(log_shares(shells)[:, None, None] * likely * grid.weights)) / (4 * math.pi))


def with_heights(belief: RangedBelief, camera: float | None) -> RangedBelief:
    """The same belief with the prior of a camera at this height (metres above the floor; None: unknown)."""
    if camera is None:
        return belief if belief.prior is None else replace(belief, prior=None)
    return replace(belief, prior=_prior(belief.degree, tuple(belief.ranges.tolist()), camera))


def log_heights(belief: RangedBelief, camera: float, rise: np.ndarray) -> np.ndarray:
    """The prior ``(...)`` at points `rise` metres above the camera, not truncated."""
    level = height_level(belief.degree, tuple(belief.ranges.tolist()), camera)
    return np.log(likely_height(camera + rise)) - level


@lru_cache(maxsize=64)
def _prior(degree: int, ranges: tuple[float, ...], camera: float) -> np.ndarray:
    return frozen(height_prior(degree, np.array(ranges), camera))
