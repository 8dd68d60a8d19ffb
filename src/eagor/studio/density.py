"""The belief for the wire: a few terms, each the exponential of harmonics, which a browser evaluates anywhere.

A belief has peaks of one or two degrees on a broad ground. One set of harmonics would need a degree above 100 for that.
So a narrow peak is a term of its own, of degree 2: the exponential of a quadratic form of the direction, a lobe that is
elliptical and Gaussian where it is narrow (Fisher-Bingham; Mardia and Jupp, Directional Statistics, section 9.3). The
rest of the sphere is one term of the degree that is asked for. Narrow peaks are those of the patches, and elsewhere
what this term cannot follow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import ndimage

from eagor.belief.field import SphereField
from eagor.belief.reading import Reading
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.thumbnail import undrawn

__all__ = ["Density", "Term", "density_of"]

DEGREE = 15
LOBE = 2  # degree of a peak's term
DEEPEST = 12.0  # nats below the highest value: what lies deeper is nothing that is seen
LEAST = 1e-4  # of the belief: what holds less is left out
LOBES = 3  # per peak
PEAKS = 6  # outside of patches, at most
MISSED = 0.7  # nats by which a peak is higher than the ground that is drawn: it is a term of its own
NEAR = math.radians(10)  # from the top of such a peak to its end
ROUNDS = 12  # of expectation maximisation
WIDEST = 0.5  # radians: the standard deviation of a lobe at most
MASS = 0.9  # of the region that is drawn


@dataclass(frozen=True, eq=False)
class Term:
    """`weight` times exp(Y . `coefficients`), which integrates to 1; ``((degree + 1)²,)`` float32."""

    weight: float
    degree: int
    coefficients: np.ndarray

    def __call__(self, directions: np.ndarray) -> np.ndarray:
        """Its share of the density ``(...)`` at unit vectors ``(..., 3)``."""
        exponent = RealHarmonics(self.degree).synthesise(self.coefficients.astype(np.float64), directions)
        return self.weight * np.exp(exponent)


@dataclass(frozen=True, eq=False)
class Density:
    """A density per steradian: the sum of its `terms`, in world axes. `level`: at the border of the 90 % region.

    `undrawn`: why that border is not drawn; empty if it is.
    """

    terms: tuple[Term, ...]
    level: float
    undrawn: str = ""

    def __call__(self, directions: np.ndarray) -> np.ndarray:
        """The density ``(...)`` at unit vectors ``(..., 3)``."""
        return np.sum([term(directions) for term in self.terms], axis=0)

    @property
    def blob(self) -> bytes:
        """All coefficients one after another, little-endian float32."""
        return b"".join(term.coefficients.astype("<f4").tobytes() for term in self.terms)


def density_of(reading: Reading, degree: int = DEGREE) -> Density:
    """The density that a reading answers from, as terms; the widest has this degree.

    The level is that of the region of these terms which holds 90 % of the true belief. Where the true belief is flat at
    that border, the terms' ripples would decide where it runs: it is not drawn, by the rule of the panoramas.
    """
    logs, weights, directions = reading.parts
    mass, field = reading.mass, reading.field
    values = field.values - reading.log_total
    hidden = ~field.layout.outside if field.patches else np.zeros(values.shape, dtype=bool)
    ground = _ground(field, values, hidden, degree)
    tops = _missed(reading, ground, degree)
    if len(tops):
        near = (field.grid.directions @ tops.T > math.cos(NEAR)).any(axis=-1)
        ground = _ground(field, values, hidden | near, degree)
    under = np.exp(RealHarmonics(degree).synthesise(ground, field.grid)).reshape(-1)[_cell(field.grid, directions)]
    found = under.copy()
    terms = [_normalised(ground, degree)]
    free = np.ones(len(mass), dtype=bool)
    for patch in field.patches:
        own = patch.places(directions)[1] & free
        free &= ~own
        above = np.maximum(mass[own] - under[own] * weights[own], 0.0)
        if float(above.sum()) > LEAST:
            for lobe in _lobes(patch.frame, directions[own], above):
                terms.append(lobe)
                found += lobe(directions)
    for top in tops:
        own = (directions @ top > math.cos(NEAR)) & free
        free &= ~own
        above = np.maximum(mass[own] - under[own] * weights[own], 0.0)
        if float(above.sum()) > LEAST:
            # A cell of the field is the peak's finest detail; between cells it is linear.
            for lobe in _lobes(_frame(top), directions[own], above, (math.pi / field.grid.height) ** 2 / 6):
                terms.append(lobe)
                found += lobe(directions)
    terms = [term for term in terms if term.weight > LEAST]
    total = sum(term.weight for term in terms)
    terms = [replace(term, weight=term.weight / total) for term in terms]
    order = np.argsort(-found, kind="stable")
    reached = np.cumsum(mass[order]) - mass[order] / 2
    place = min(int(np.searchsorted(reached, MASS)), len(order) - 1)
    missing = undrawn(logs - reading.log_total, weights, *reading.region(MASS))
    return Density(tuple(terms), float(found[order[place]] / total), missing)


def _ground(field: SphereField, values: np.ndarray, hidden: np.ndarray, degree: int) -> np.ndarray:
    """Coefficients of the log density `values` ``(H, W)``; where it is hidden it goes on as it is around there."""
    if hidden.any():
        values = _filled(values, hidden)
    return np.asarray(RealHarmonics(degree).analyse(np.maximum(values, values.max() - DEEPEST), field.grid))


def _missed(reading: Reading, ground: np.ndarray, degree: int) -> np.ndarray:
    """The tops ``(k, 3)`` of the peaks outside of patches that the ground does not follow."""
    tops, _ = reading.modes(PEAKS, LEAST)
    outside = np.ones(len(tops), dtype=bool)
    for patch in reading.field.patches:
        outside &= ~patch.places(tops)[1]
    drawn = RealHarmonics(degree).synthesise(ground, tops)
    return tops[outside & (reading.field(tops) - reading.log_total - drawn > MISSED)]


def _frame(top: np.ndarray) -> np.ndarray:
    """A direction ``(3,)`` and two axes of its tangent plane, as rows ``(3, 3)``."""
    return np.concatenate([top[None], np.linalg.svd(top[None])[2][1:]])


def _cell(grid: ErpGrid, directions: np.ndarray) -> np.ndarray:
    """The flat index of the cell of each direction."""
    x, y, _ = grid.project(directions)
    return np.minimum(y.astype(np.intp), grid.height - 1) * grid.width + x.astype(np.intp) % grid.width


def _normalised(coefficients: np.ndarray, degree: int) -> Term:
    """exp(Y . coefficients), as a term with its integral as its weight."""
    values = RealHarmonics(degree).synthesise(coefficients, _fine())
    top = float(values.max())
    log_total = top + math.log(float(np.sum(np.exp(values - top) * _fine().weights)))
    shifted = np.array(coefficients, dtype=np.float64)
    shifted[0] -= log_total * math.sqrt(4 * math.pi)  # Y_00 = 1 / sqrt(4 pi)
    return Term(math.exp(log_total), degree, shifted.astype(np.float32))


def _filled(values: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Values ``(H, W)`` with the hidden cells taken from the nearest others, across the seam too."""
    if hidden.all():
        return np.zeros_like(values)
    width = values.shape[1]
    wide, masked = np.tile(values, 3), np.tile(hidden, 3)
    nearest = np.asarray(ndimage.distance_transform_edt(masked, return_distances=False, return_indices=True))
    return wide[nearest[0], nearest[1]][:, width : 2 * width]


@lru_cache(maxsize=2)
def _fine() -> ErpGrid:
    return ErpGrid(64, 128)


def _lobes(frame: np.ndarray, directions: np.ndarray, mass: np.ndarray, least: float = 1e-7) -> list[Term]:
    """A peak as lobes: a mixture of Gaussians on its tangent plane, by expectation maximisation.

    `frame`: the plane, as of a patch; `least`: of a variance.
    """
    local = directions @ frame.T
    plane = local[:, 1:] / np.maximum(local[:, :1], 1e-6)
    weight = float(mass.sum())
    share = mass / weight
    mixture = _mixture(plane, share, least)
    return [_lobe(frame, middle, cover, weight * part) for part, middle, cover in mixture if weight * part > LEAST]


def _mixture(plane: np.ndarray, share: np.ndarray, least: float) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Weights, middles ``(2,)`` and covariances ``(2, 2)`` of `LOBES` Gaussians that fit weighted points ``(n, 2)``.

    They begin at the highest point, one narrow, others wider: peaks of this package are mixtures of scales.
    """
    top = plane[int(share.argmax())]
    offset = plane - top
    cover = np.einsum("n,ni,nj->ij", share, offset, offset) + 1e-8 * np.eye(2)
    parts = np.full(LOBES, 1 / LOBES)
    middles = np.repeat(top[None], LOBES, axis=0)
    covers = np.array([cover * 4.0 ** (1 - LOBES + index) for index in range(LOBES)])
    for _ in range(ROUNDS):
        logs = np.stack(
            [_log_gaussian(plane, m, c) + math.log(p) for p, m, c in zip(parts, middles, covers, strict=True)]
        )
        logs -= logs.max(axis=0)
        duty = np.exp(logs)
        duty *= share / duty.sum(axis=0)
        parts = np.maximum(duty.sum(axis=1), 1e-12)
        middles = duty @ plane / parts[:, None]
        for index in range(LOBES):
            offset = plane - middles[index]
            covers[index] = np.einsum("n,ni,nj->ij", duty[index] / parts[index], offset, offset) + least * np.eye(2)
    return [(float(p), m, c) for p, m, c in zip(parts, middles, covers, strict=True)]


def _log_gaussian(plane: np.ndarray, middle: np.ndarray, cover: np.ndarray) -> np.ndarray:
    offset = plane - middle
    inverse = np.linalg.inv(cover)
    exponent = -0.5 * np.einsum("ni,ij,nj->n", offset, inverse, offset)
    return exponent - 0.5 * math.log(float(np.linalg.det(cover)))


def _lobe(frame: np.ndarray, middle: np.ndarray, cover: np.ndarray, weight: float) -> Term:
    """The lobe with this middle and covariance on the tangent plane of `frame`, as a term of degree 2.

    exp(k . d + d' A d) with the mean direction m and tangent axes e_i: its second derivatives along e_i are those of
    the Gaussian, and along m it falls towards the far side, so that the lobe is the only one.
    """
    mean = frame[0] + middle @ frame[1:]
    length = float(np.linalg.norm(mean))
    mean = mean / length
    # The plane's metric at the middle: how far one moves on the sphere per unit of the plane.
    jacobian = (frame[1:] - np.outer(frame[1:] @ mean, mean)) / length  # (2, 3)
    width, axes = np.linalg.eigh(jacobian.T @ cover @ jacobian)
    spread = np.clip(width[1:], 1e-8, WIDEST**2)
    minor, major = 1 / spread[0], 1 / spread[1]  # concentrations along the narrow and the wide axis
    # log f = a (m . d) + b (e . d)², with e the narrow axis: curvature a along the wide one, a - 2 b along the narrow.
    linear, square = major, -0.5 * (minor - major)
    narrow = axes[:, 1]

    def log(directions: np.ndarray) -> np.ndarray:
        return linear * (directions @ mean - 1) + square * (directions @ narrow) ** 2

    basis, grid = RealHarmonics(LOBE), _exact()
    coefficients = basis.analyse(log(grid.directions), grid)
    coefficients = np.array(coefficients, dtype=np.float64)
    coefficients[0] -= _log_total(linear, square) * math.sqrt(4 * math.pi)
    return Term(weight, LOBE, coefficients.astype(np.float32))


@lru_cache(maxsize=1)
def _exact() -> ErpGrid:
    """A grid on which harmonics of degree 2 times 2 are summed exactly."""
    return ErpGrid(16, 32)


def _log_total(linear: float, square: float) -> float:
    """log of the integral of exp(linear (cos t - 1) + square sin²t cos²p) over the sphere.

    Over p it is a Bessel function; over t by quadrature, fine where the lobe is.
    """
    from scipy.special import ive

    reach = min(2.0, 40.0 / max(linear, 1e-9))
    height = reach * (np.arange(400) + 0.5) / 400  # 1 - cos t
    across = height * (2 - height)  # sin²t
    bend = 0.5 * square * across
    inner = 2 * math.pi * ive(0, np.abs(bend)) * np.exp(np.abs(bend) + bend)
    return math.log(float(np.sum(np.exp(-linear * height) * inner)) * reach / 400)
