"""A window about one peak: a small grid over direction and distance that moves and narrows with the belief.

The field over the whole sphere has a limited degree, and its shells of range lie far apart. A peak soon gets narrower
than both. So the log-likelihood about each peak is kept on its own, finer grid: a point-mass filter with a moving grid
(Bucy and Senne, Automatica 7, 1971; Simandl, Kralovec and Soederstroem, Automatica 42, 2006). Nodes are points of a
tangent plane times ranges, evenly spaced in the logarithm. The log-likelihood is smooth there; cubic splines carry it
from one grid to the next.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor._values import altered, known, lazy
from eagor.belief.bank import Bank, mixed
from eagor.belief.field import EVEN, Nodes, Patch, bent, interpolated
from eagor.evidence.detections import resolved, tangent_frame
from eagor.sphere import cross

NODES = 11  # along each side
RANGES = 12  # nodes along the range, where positions are known
REACH = 5.0  # standard deviations from the middle to a border
WIDEST = math.radians(25)  # largest half width: beyond, even nodes are coarser than the cells of the whole field
SKIRTS = 3.3  # standard deviations of the narrowest bump of a degree, at which its skirts end
FURTHEST = math.radians(45)  # largest half width of a plane
_BENDS = np.linspace(EVEN, 5.0, 500)  # with a larger bend, sums over the nodes are wrong by some percent
_RATIOS = np.sinh(_BENDS) / _BENDS  # how much denser the nodes in the middle are than even ones
DEEP = 4.5  # nats below the peak: the connected nodes above this are the peak
FAINT = 10.0  # nats below the likeliest range: lower ranges are left out
OVER = 0.5  # nats: what a spline may exceed the nodes by, where detections add up without bound
SLACK = 1.25  # a window too large by this factor is redrawn


@dataclass(frozen=True, eq=False)
class Window(Nodes):
    """Log-likelihood ratios ``(S, K, n, n)`` about one peak, world axes, origin at the body.

    The nodes are about a standard deviation apart in the middle, and further towards the border. There is one set of
    values for each scale of the detector's spread (`eagor.evidence.Spread`), which includes the logarithm of its
    weight: a joint belief over place and spread.

    `bank`: the habits at the nodes ``(C, n, n)``, the same for all ranges and scales; None before any detection.

    `frame`, `half`, `bend`: as for `field.Nodes`. `logs` ``(K,)``: logarithms of the ranges, evenly spaced; None
    without ranges (K = 1). `limits`: least and greatest logarithm of a range. `border`: least half width, in units of
    the plane.
    """

    logs: np.ndarray | None = None
    limits: tuple[float, float] = (0.0, 1.0)
    border: float = 0.0
    bank: Bank | None = None

    @property
    def habits(self) -> Bank:
        """The `bank` of a window that is part of a belief."""
        assert self.bank is not None
        return self.bank

    @classmethod
    def about(cls, centre: np.ndarray, width: float, degree: int) -> Window:
        """A window for a peak at `centre` ``(3,)`` of this `width` (radians), in a field of this degree; values 0."""
        border = math.tan(skirts(degree))
        half, bend = _extent(np.full(2, width), border)
        frame = np.concatenate([centre[None], tangent_frame(centre)])
        return cls(frame, half, np.zeros((1, 1, NODES, NODES)), bend, border=border)

    @lazy
    def shares(self) -> np.ndarray:
        """Prior probability ``(K,)`` of the ranges: even in the logarithm."""
        if self.logs is None:
            return np.ones(1)
        share = np.full(len(self.logs), (self.logs[-1] - self.logs[0]) / (len(self.logs) - 1))
        share[[0, -1]] /= 2
        return share / (self.limits[1] - self.limits[0])

    def plus(self, log_ratios: np.ndarray) -> Window:
        """With log ratios added ``(S or 1, K or 1, n, n)``."""
        return self.like(self.values + log_ratios)

    def marginal(self, prior: np.ndarray | None = None) -> np.ndarray:
        """log of the mean likelihood over the ranges ``(n, n)``; `prior` ``(K, n, n)``: log ratios to add."""
        return _summed(self.by_scale(prior))

    def by_scale(self, prior: np.ndarray | None = None) -> np.ndarray:
        """The same ``(S, n, n)`` for each scale."""
        values = self.values if prior is None else self.values + prior
        if values.shape[1] == 1:
            return values[:, 0]
        top = values.max(axis=1)
        return np.log(np.einsum("k,skij->sij", self.shares, np.exp(values - top[:, None]))) + top

    @lazy
    def by_range(self) -> np.ndarray:
        """Summed over the scales: ``(K, n, n)``."""
        return _summed(self.values)

    def patch(self, prior: np.ndarray | None = None) -> Patch:
        """The window as a part of a field over directions."""
        found = Patch(self.frame, self.half, self.marginal(prior), self.bend)
        return known(found, directions=self.directions, weights=self.weights)

    def finest(self, directions: np.ndarray) -> np.ndarray:
        """Spacing of the nodes (radians, ``(n,)``) at directions ``(n, 3)``: narrower detections are widened to it."""
        at = np.clip(self.located(directions)[0], -1, 1)
        return 2 / (NODES - 1) * bent(at, self.half, self.bend)[1].min(axis=0)

    def holds(self, centre: np.ndarray, width: float) -> bool:
        """Whether the nodes are dense enough for a detection of this `width` (radians) at `centre` ``(3,)``."""
        return bool(self.places(centre)[1]) and float(self.finest(centre[None])[0]) <= SLACK * width

    def points(self) -> np.ndarray:
        """The nodes ``(K, n, n, 3)``, metres."""
        return np.exp(self.logs)[:, None, None, None] * self.directions  # type: ignore[arg-type]

    @staticmethod
    def peak_at_border(values: np.ndarray) -> bool:
        """Whether `values` ``(n, n)`` still rise at the border: the peak is not in the window."""
        row, column = divmod(int(values.argmax()), values.shape[1])
        return min(row, column) < 2 or max(row, column) > values.shape[0] - 3

    def moved(self, step: np.ndarray, prior: np.ndarray | None, border: float) -> tuple[Window, np.ndarray | None]:
        """After the body has moved by `step` ``(3,)`` metres, in the axes of the window; at least `border` wide.

        Also returns the mask ``(K, n, n)`` of the nodes outside of the old window, whose values are unknown.
        """
        if self.logs is None:
            return self, None
        return self.drawn(self._wanted(prior, step, border), step)

    def focused(self, prior: np.ndarray | None, border: float) -> tuple[Window, np.ndarray | None]:
        """Refined to the width of the peak (or unchanged if it fits); mask and `border` as for `moved`."""
        wanted = self._wanted(prior, None, border)
        fits = (
            wanted.border <= self.border
            and (wanted.spacing * SLACK >= self.spacing).all()
            and (wanted.half <= self.half * 1.1).all()
        )
        centred = wanted.frame[0] @ self.frame[0] > math.cos(1.25 * math.atan(float(self.spacing.min())))
        if fits and centred and self._spans(wanted.logs):
            return self, None
        return self.drawn(wanted, None)

    def _spans(self, logs: np.ndarray | None) -> bool:
        return self.logs is None or logs is None or (logs[-1] - logs[0]) * SLACK >= self.logs[-1] - self.logs[0]

    def _wanted(self, prior: np.ndarray | None, step: np.ndarray | None, border: float) -> Window:
        """The window, without values, that fits the peak after a `step`; at least `border` wide."""
        values = self.by_range if prior is None else self.by_range + prior
        mass = np.exp(values - values.max())
        mean = mixed(self.shares, mass)
        peak = _component(np.log(np.maximum(mean, 1e-300)))
        if self.logs is None:
            points, shares = self.directions[peak], mean[peak] * self.weights[peak]
            shares, logs = shares / shares.sum(), None
        else:
            joint = mass[:, peak] * self.shares[:, None] * self.weights[peak]
            by_range = np.log(np.maximum(joint.sum(axis=1), 1e-300) / self.shares)
            kept = np.flatnonzero(by_range > by_range.max() - FAINT)
            span = slice(max(kept[0] - 1, 0), min(kept[-1] + 2, len(by_range)))
            points = np.exp(self.logs[span])[:, None, None] * self.directions[peak]
            if step is not None:
                points = points - step
            joint = joint[span]
            shares = (joint / joint.sum()).reshape(-1)
            points = points.reshape(-1, 3)
            distances = np.sqrt(np.einsum("ij,ij->i", points, points))
            points = points / np.maximum(distances, 1e-9)[:, None]
            counts = shares > 1e-5 * shares.max()
            log = np.log(np.maximum(distances[counts], 1e-9))
            slack = (self.logs[1] - self.logs[0]) / 2
            low, high = max(log.min() - slack, self.limits[0]), min(log.max() + slack, self.limits[1])
            low, high = min(low, self.limits[1] - 0.02), max(high, self.limits[0] + 0.02)
            logs = np.linspace(low, max(high, low + 0.02), RANGES)
        middle = shares @ points
        middle /= math.sqrt(float(middle @ middle))
        axes = self.frame[1:] - (self.frame[1:] @ middle)[:, None] * middle
        axes[0] /= math.sqrt(float(axes[0] @ axes[0]))
        axes[1] = cross(middle, axes[0])
        ahead = points @ middle
        plane = (points @ axes.T) / np.maximum(ahead, 0.1)[:, None]
        covariance = (plane * shares[:, None]).T @ plane
        variances, turn = np.linalg.eigh(covariance)
        sigma = np.sqrt(np.maximum(variances, (0.1 * self.spacing.min()) ** 2))
        across = turn[:, 0] @ axes
        frame = np.array([middle, across, cross(middle, across)])
        half, bend = _extent(sigma, border)
        return Window(frame, half, np.zeros((1, 1, NODES, NODES)), bend, logs, self.limits, border)

    def drawn(self, new: Window, step: np.ndarray | None = None) -> tuple[Window, np.ndarray | None]:
        """The field on the nodes of another window, and the mask of those outside of this one."""
        logs = new.logs
        points, depth = new.directions, np.zeros(0)
        if logs is not None:
            points = np.exp(logs)[:, None, None, None] * new.directions
            if step is not None:
                points = points + step
            distances = np.sqrt(np.einsum("...i,...i->...", points, points))
            first, spacing = self.logs[0], self.logs[1] - self.logs[0]  # type: ignore[index]
            depth = np.clip((np.log(np.maximum(distances, 1e-9)) - first) / spacing, 0, RANGES - 1)
        places, beyond = self._places(points)
        over = None if self.bank is None else OVER
        if logs is None:
            values, beyond, across = interpolated(self.values, places, over), beyond[None], places
        else:
            values = interpolated(self.values, np.concatenate([depth[None], places]), over)
            likely = 0 if self.bank is None else int(np.exp(values - values.max()).sum(axis=(0, 2, 3)).argmax())
            across = places[:, likely]  # habits are carried along at the likeliest range
        bank = None if self.bank is None else self.bank.at_nodes(across)
        return altered(new.like(values), bank=bank), beyond if beyond.any() else None

    def _places(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Indices ``(2, ...)`` of points ``(..., 3)``, clipped at the borders, and which lie beyond them."""
        found, ahead = self.located(points)
        beyond = (np.abs(found).max(axis=0) > 1.001) | (ahead <= 0)
        return (np.clip(found, -1, 1) + 1) * ((NODES - 1) / 2), beyond


def skirts(degree: int) -> float:
    """The distance from a peak (radians) to which a field of this degree smears it."""
    return min(SKIRTS * resolved(degree), FURTHEST)


def with_own_peaks(windows: Sequence[Window], patches: Sequence[Patch]) -> set[int]:
    """The windows with a peak inside, the finer of two with the same one; `patches`: the windows over directions."""
    found: list[int] = []
    tops: list[np.ndarray] = []
    for i in sorted(range(len(windows)), key=lambda i: float(windows[i].spacing.max())):
        window, values = windows[i], patches[i].values
        if window.peak_at_border(values):
            continue
        top = window.directions.reshape(-1, 3)[int(values.argmax())]
        near = math.cos(math.atan(1.5 * float(window.spacing.max())))
        if all(top @ other < near for other in tops):
            found.append(i)
            tops.append(top)
    return {*found}


def _extent(sigma: np.ndarray, border: float) -> tuple[np.ndarray, np.ndarray]:
    """Half widths and bends ``(2,)`` of a window about a peak of standard deviations `sigma` ``(2,)``."""
    half = np.maximum(np.minimum(REACH * np.tan(np.minimum(sigma, 1.0)), math.tan(WIDEST)), border)
    return half, np.interp(2 / (NODES - 1) * half / sigma, _RATIOS, _BENDS)


def _summed(values: np.ndarray) -> np.ndarray:
    """log of the sum of exp(values) ``(S, ...)`` over the first axis."""
    if len(values) == 1:
        return values[0]
    top = values.max(axis=0)
    return np.log(np.exp(values - top).sum(axis=0)) + top


def _component(values: np.ndarray) -> np.ndarray:
    """The nodes ``(n, n)`` connected to the highest one and at most `DEEP` below it."""
    from scipy.ndimage import label

    found: Any = label(values > values.max() - DEEP)
    parts, count = found
    if count == 1:
        return parts > 0
    return parts == parts.reshape(-1)[int(values.argmax())]
