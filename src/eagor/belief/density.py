"""Reading a field of log densities: peaks, their masses, regions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor._values import lazy
from eagor.belief.basins import PROMINENCE, labelled
from eagor.belief.field import FINER, Patch, SphereField
from eagor.evidence.detections import tangent_frames
from eagor.sphere import unit

HEAVY = 0.002  # of the belief: cells that hold more are refined
NEAR = math.radians(20)  # of a peak: within this angle it is the same thing, which parallax may move
FINEST = math.radians(0.02)  # of a peak's place
# The nine points about a place, in steps, and what of their values gives the slopes ``(2,)`` and the second derivatives
# ``(3,)`` along, across and mixed, of a quadratic (Savitzky and Golay, Analytical Chemistry 36(8), 1964).
STENCIL = np.array([(u, v) for u in (-1.0, 0.0, 1.0) for v in (-1.0, 0.0, 1.0)])
_SLOPE = STENCIL / 6
_BEND = np.column_stack([(STENCIL**2 - 2 / 3), STENCIL[:, :1] * STENCIL[:, 1:] / 4])
DEEP = 12.0  # nats below the highest peak: deeper values are clipped


def log_integral(values: np.ndarray, weights: np.ndarray) -> float:
    """log of the integral of exp(values) over cells of these solid angles, without overflow."""
    top = float(values.max())
    return top + math.log(float(np.sum(np.exp(values - top) * weights)))


class Masses:
    """What is read of exp(f) from small cells that cover the sphere.

    `values` ``(n,)`` of f, solid angles `weights` ``(n,)``, `directions` ``(n, 3)``.
    """

    values: np.ndarray
    weights: np.ndarray
    directions: np.ndarray

    @lazy
    def log_total(self) -> float:
        """log of the integral of exp(f) over the sphere."""
        return log_integral(self.values, self.weights)

    @lazy
    def mass(self) -> np.ndarray:
        """Probability ``(n,)`` of each cell; they sum to 1."""
        return np.exp(self.values - self.log_total) * self.weights

    def entropy(self) -> float:
        """Differential entropy in nats; log(4 pi) = 2.53 for a uniform belief."""
        return self.log_total - float(self.mass @ self.values)

    def mass_over(self, value: float) -> float:
        """The probability of all directions where f exceeds `value`."""
        return float(self.mass[self.values > value].sum())

    def within(self, angle: float, about: np.ndarray) -> float:
        """The probability of the cone of half-angle `angle` (radians) about a direction ``(3,)``."""
        return float(self.mass[self.directions @ about >= math.cos(min(angle, math.pi))].sum())

    def cosine(self, about: np.ndarray) -> float:
        """The expected cosine of the angle to a direction ``(3,)``: -1 to 1."""
        return float(self.mass @ (self.directions @ about))

    def cone(self, mass: float, about: np.ndarray) -> float:
        """Half-angle (radians) of the cone that is centred on a direction ``(3,)`` and holds `mass`."""
        cosine = self.directions @ about
        near = cosine > math.cos(NEAR)  # mostly, what is farther away does not count, and sorting it takes long
        for kept in (near, np.ones_like(near)):
            probability = self.mass[kept]
            order = np.argsort(-cosine[kept])
            probability = probability[order]
            reached = np.cumsum(probability) - probability / 2
            if len(reached) and reached[-1] >= mass:
                break
        cosine = cosine[kept][order]
        return math.acos(max(-1.0, min(1.0, float(np.interp(mass, reached, cosine)))))


@dataclass(frozen=True, eq=False)
class Density(Masses):
    """Reads a field: log of (density / uniform density), up to a constant. Directions are in the field's axes.

    Below `least` it has no peaks.
    """

    field: SphereField
    least: float = -math.inf

    values = property(lambda self: self._parts[0])  # type: ignore[assignment]
    weights = property(lambda self: self._parts[1])  # type: ignore[assignment]
    directions = property(lambda self: self._parts[2])  # type: ignore[assignment]

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The values, solid angles and directions of the cells."""
        return self._parts[:3]

    @lazy
    def _parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
        """The `parts`, and the cell of the grid ``(n,)`` that each lies in; so many of the first are not refined."""
        field, grid = self.field, self.field.grid
        row_weights = grid.weights[:, 0]

        def of_cells(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return field.values.reshape(-1)[cells], row_weights[cells // grid.width]

        free = field.layout.free
        values, weights = of_cells(free)
        heavy = np.exp(values - field.log_mean) * weights / (4 * math.pi) > HEAVY
        light = free[~heavy]
        found = [(*of_cells(light), grid.directions.reshape(-1, 3).take(light, axis=0), light)]
        if heavy.any():
            home = free[heavy]
            rows, columns = np.divmod(home, grid.width)
            at = (np.arange(FINER) + 0.5) / FINER
            y = (rows[:, None, None] + at[None, :, None]) + np.zeros((1, 1, FINER))
            x = (columns[:, None, None] + at[None, None, :]) + np.zeros((1, FINER, 1))
            cells = grid.unproject(x, y).reshape(-1, 3)
            cosine = np.cos(math.pi / 2 - math.pi * y / grid.height)
            shares = cosine / cosine.sum(axis=(1, 2), keepdims=True) * weights[heavy][:, None, None]
            found.append((field.smooth(cells), shares.reshape(-1), cells, np.repeat(home, FINER * FINER)))
        for patch, (counts, shares, cells, home) in zip(field.patches, field.layout.fine, strict=True):
            found.append((patch.finer().reshape(-1).take(counts), shares, cells, home))
        values, weights, directions, homes = (np.concatenate(column) for column in zip(*found, strict=True))
        return values, weights, directions, homes, len(light)

    def mass_above(self, direction: np.ndarray) -> float:
        """The mass of the smallest region of highest density that reaches `direction` ``(3,)``."""
        return self.mass_over(float(self.field(direction[None])[0]))

    def region(self, mass: float) -> tuple[float, float]:
        """The log density (per steradian) at the border of the smallest region that holds `mass`, and its area."""
        values = self.values
        order = np.argsort(-values, kind="stable")
        reached = np.cumsum(self.mass[order]) - self.mass[order] / 2
        place = min(int(np.searchsorted(reached, mass)), len(order) - 1)
        return float(values[order[place]]) - self.log_total, float(self.weights[order[: place + 1]].sum())

    @lazy
    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Masses ``(n,)`` and directions ``(n, 3)`` of cells and nodes: fewer than the `parts`."""
        values, layout = self.field.logs, self.field.layout
        mass = np.exp(values - values.max()) * layout.weights
        return mass / mass.sum(), layout.directions

    def _refined(self, tops: np.ndarray) -> np.ndarray:
        """The highest points ``(m, 3)`` of the field beside `tops` ``(m, 3)``: in a patch, by its nodes alone."""
        found, free = tops.copy(), np.ones(len(tops), dtype=bool)
        for place, direction in enumerate(tops):
            for patch in self.field.patches:
                places, inside = patch.places(direction)
                if inside:
                    found[place], free[place] = _top_of_patch(patch, places), False
                    break
        if free.any():
            found[free] = self._climbed(tops[free])
        return found

    def _climbed(self, tops: np.ndarray) -> np.ndarray:
        """The highest points ``(m, 3)`` of the field beside `tops` ``(m, 3)``, to `FINEST`.

        Each goes to the top of a quadratic through nine points about it, or, where that is no higher, to the best of
        the nine; then they draw nearer.
        """
        step = math.pi / self.field.grid.height / FINER
        tops, best = tops.copy(), self.field(tops)
        while step > FINEST:
            before = tops.copy()
            frames = step * tangent_frames(tops)  # (m, 2, 3)
            around = unit(tops[:, None] + np.einsum("sk,mki->msi", STENCIL, frames))
            values = self.field(around)
            slope, bend = np.moveaxis(np.tensordot(values, _SLOPE, 1), -1, 0), np.tensordot(values, _BEND, 1)
            (a, c), b = np.moveaxis(bend[:, :2], -1, 0), bend[:, 2]
            det = a * c - b * b
            curved = (a < 0) & (det > 0)
            det = np.where(curved, det, 1.0)
            jump = np.stack([b * slope[1] - c * slope[0], b * slope[0] - a * slope[1]], axis=-1) / det[:, None]
            jump = np.where(curved[:, None], np.clip(jump, -1.0, 1.0), 0.0)
            jumped = unit(tops + np.einsum("mk,mki->mi", jump, frames))
            highest = np.arange(len(tops)), values.argmax(axis=1)
            for direction, height in ((jumped, self.field(jumped)), (around[highest], values[highest])):
                higher = height > best
                tops[higher], best[higher] = direction[higher], height[higher]
            moved = 1 - np.einsum("mi,mi->m", before, tops).min() > step * step / 4
            step = step if moved else step / 3
        return tops

    @lazy
    def _basins(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The basins, heaviest first: masses and tops (indices of parts) ``(b,)``; the basin ``(n,)`` of each part.

        Parts further from their top than `NEAR` belong to no basin: a slope all around the sphere is not a place.
        """
        values, _, directions, home, whole = self._parts
        grid = self.field.grid
        tops = self.field.values.reshape(-1).copy()
        if self.field.patches:
            tops[~self.field.layout.outside.reshape(-1)] = -np.inf
            np.maximum.at(tops, home[whole:], values[whole:])
            lost = np.flatnonzero(~np.isfinite(tops))  # cells without own nodes
            if len(lost):
                cells = self.field.values.reshape(-1)[lost]
                tops[lost] = self.field.with_patches(cells, grid.directions.reshape(-1, 3).take(lost, axis=0))
        tops = np.maximum(tops, max(tops.max() - DEEP, min(self.least, tops.max() - 1)))
        count, cells = labelled(tops.reshape(grid.shape), PROMINENCE)
        of_part = cells.reshape(-1).take(home)
        highest = np.full(count, -np.inf)
        np.maximum.at(highest, of_part, values)
        tied = (values == highest.take(of_part)).nonzero()[0]
        top = np.zeros(count, dtype=np.intp)
        top[of_part[tied]] = tied  # of equal ones the last
        near = np.einsum("ij,ij->i", directions, directions[top].take(of_part, axis=0)) > math.cos(NEAR)
        masses = np.bincount(of_part, self.mass * near, minlength=count)
        order = np.argsort(-masses, kind="stable")
        rank = np.empty_like(order)
        rank[order] = np.arange(count)
        return masses[order], top[order], rank[of_part]

    def modes(self, count: int, least: float) -> tuple[np.ndarray, np.ndarray]:
        """Directions ``(m, 3)`` and masses ``(m,)`` of the basins that hold at least `least`, at most `count`.

        Each small cell belongs to the peak at the end of its steepest ascent; a peak less than `PROMINENCE` nats above
        the saddle to a higher one is merged into it. A mode holds its cells within `NEAR`. Heaviest first, at least
        one; the masses sum to less than 1.
        """
        masses, tops, _ = self._basins
        kept = max(1, min(count, int((masses >= least).sum())))
        return self._refined(self.directions[tops[:kept]]), masses[:kept]


def _top_of_patch(patch: Patch, places: np.ndarray) -> np.ndarray:
    """The direction ``(3,)`` of the peak of a patch near `places` ``(2,)``: from the highest node beside them."""
    last = patch.values.shape[0] - 1
    step = 2 / last
    row, column = (min(max(round((place + 1) / step), 1), last - 1) for place in places.tolist())
    up, left = divmod(int(patch.values[row - 1 : row + 2, column - 1 : column + 2].argmax()), 3)
    row, column = (min(max(k, 1), last - 1) for k in (row + up - 1, column + left - 1))
    s, t = row * step - 1, column * step - 1
    (a, b, c), (d, e, f), (g, h, i) = patch.values[row - 1 : row + 2, column - 1 : column + 2].tolist()
    gu, gv, huu, hvv, huv = (h - b) / 2, (f - d) / 2, h + b - 2 * e, f + d - 2 * e, (i + a - g - c) / 4
    det = huu * hvv - huv * huv
    if huu < 0 and det > 0:
        along, across = (huv * gv - hvv * gu) / det, (huv * gu - huu * gv) / det
        if max(abs(along), abs(across)) < 1:
            s, t = s + along * step, t + across * step
    (half, other), (bend, beside) = patch.half.tolist(), patch.bend.tolist()
    u, v = half * math.sinh(bend * s) / math.sinh(bend), other * math.sinh(beside * t) / math.sinh(beside)
    found = np.array([1.0, u, v]) @ patch.frame
    return found / math.sqrt(1 + u * u + v * v)
