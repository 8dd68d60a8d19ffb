"""A target that stands still: what every look from everywhere says of where it may stand.

In axes that do not turn, such a target has one place, and looks add. A field over the whole sphere, with shells of
range where the body's positions are known, is searched for peaks; a `Window` about each holds what the field is too
coarse for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from eagor._lazy import given, lazy
from eagor.belief import Belief
from eagor.detection_set import resolved, tangent_frame
from eagor.field import SphereField
from eagor.harmonics import RealHarmonics
from eagor.local import NODES, RANGES, REACH, WIDEST, Window
from eagor.looks import FINER, Look
from eagor.peaks import decoding_grid, neighbours, refine
from eagor.ranged import NEAR, RangedBelief, height_level, height_prior, likely_height, mean_range, range_spread

MOST = 4  # windows
WORTH = 0.02  # of the belief: a peak that holds less gets no window,
LEAST = 0.002  # ... and a window that holds less is closed
WIDE = math.radians(14)  # a peak wider than this is well held by the field itself


@dataclass(frozen=True, eq=False)
class Standing:
    """Log ratios against "not here": `coarse` over the whole sphere, and `windows` about its peaks; world axes.

    `height`: of the camera above the floor, metres, where it is known: things stand on floors (`eagor.ranged`).
    """

    coarse: Belief | RangedBelief
    windows: tuple[Window, ...] = ()
    height: float | None = None

    @classmethod
    def uniform(cls, degree: int, ranges: np.ndarray | None, height: float | None = None) -> Standing:
        """Nothing known."""
        if ranges is None:
            return cls(Belief.uniform(degree))
        return cls(_with_prior(RangedBelief.uniform(degree, ranges), height), (), height)

    def blank(self) -> Standing:
        """A belief of the same kind that knows nothing."""
        ranges = self.coarse.ranges if isinstance(self.coarse, RangedBelief) else None
        return Standing.uniform(self.degree, ranges, self.height)

    @property
    def degree(self) -> int:
        """Of the harmonics of `coarse`."""
        return self.coarse.degree

    @given
    def field(self) -> SphereField:
        """Over directions alone: log of the mean likelihood over the ranges."""
        grid = decoding_grid(self.degree)
        if isinstance(self.coarse, RangedBelief):
            values = self.coarse.posterior.coarse
        else:
            values = RealHarmonics(self.degree).synthesise(self.coarse.coefficients, grid)
        return SphereField(grid, values, tuple(window.patch(self._prior(window)) for window in self.windows))

    @lazy
    def log_mean(self) -> float:
        """log of the mean likelihood ratio over all directions and ranges."""
        return self.field.log_mean

    def moved(self, step: np.ndarray, height: float | None = None) -> Standing:
        """After the body has moved by `step` ``(3,)`` metres, in the axes of the world."""
        if not isinstance(self.coarse, RangedBelief):
            return self
        coarse = _with_prior(self.coarse.predict(np.eye(3), step), height)
        found = Standing(coarse, (), height)
        return replace(found, windows=tuple(found._filled(*w.moved(step, self._prior(w))) for w in self.windows))

    def ranged(self, ranges: np.ndarray, height: float | None) -> Standing:
        """The same over direction and range, from now on: what is known so far holds for all ranges alike."""
        found = RangedBelief.uniform(self.degree, ranges).plus(self.coarse.coefficients)  # type: ignore[union-attr]
        logs = np.log(ranges)
        limits = float(logs[0]), float(logs[-1])
        windows = tuple(
            Window(w.frame, w.half, np.repeat(w.values, RANGES, axis=0), np.linspace(*limits, RANGES), limits)
            for w in self.windows
        )
        return Standing(_with_prior(found, height), windows, height)

    def plus(self, look: Look, share: float = 1.0, since: np.ndarray | None = None) -> Standing:
        """With `share` of a look added, which was taken before the body moved by `since` ``(3,)`` to where it is."""
        if since is None or not since.any() or not isinstance(self.coarse, RangedBelief):
            windows, patches = [], []
            for window, patch in zip(self.windows, self.field.patches, strict=True):
                found = share * look.at(window.directions, least_width(window, self.degree))
                windows.append(window.plus(found))
                patches.append(patch.like(patch.values + found))
            found = Standing(self.coarse.plus(share * look.coefficients), tuple(windows), self.height)
            # What is said of all ranges alike adds as much to the field over directions.
            field = SphereField(self.field.grid, self.field.values + share * look.values, tuple(patches))
            found.__dict__["field"] = field
            return found
        ranges = self.coarse.ranges
        alike = np.broadcast_to(share * look.coefficients, (len(ranges), len(look.coefficients)))
        carried = RangedBelief(alike, ranges).predict(np.eye(3), since).shells
        windows = []
        for window in self.windows:
            points = window.points() + since
            points /= np.sqrt(np.einsum("...i,...i->...", points, points))[..., None]
            windows.append(window.plus(share * look.at(points, least_width(window, self.degree))))
        return Standing(self.coarse.plus(carried), tuple(windows), self.height)

    def scaled(self, factor: float) -> Standing:
        """With all log ratios scaled by `factor` in [0, 1]: the covariance of each peak grows by 1 / factor."""
        windows = tuple(window.like(window.values * factor) for window in self.windows)
        return Standing(self.coarse.forget(factor), windows, self.height)

    def opened(self, look: Look) -> Standing:
        """With windows where the detections of a look are, which is not yet added, if none is there."""
        found = self
        centres, widths = look.centres
        if not len(centres):
            return self
        widths = np.maximum(widths, FINER * resolved(self.degree))
        reached = self.field.smooth(centres, 1) + look.at(centres, 0.0) - self.log_mean
        for centre, width, rise in zip(centres, widths, reached, strict=True):
            if width > WIDE or len(found.windows) >= 2 * MOST or math.exp(min(rise, 50.0)) * width**2 < LEAST:
                continue
            if any(patch.places(centre)[1] for patch in found.field.patches):
                continue
            found = found._with_window(centre, width)
        return found

    def focused(self, fresh: bool = False) -> Standing:
        """With a window about each peak, as fine as the peak is now; `fresh` windows are fine enough."""
        found = self
        windows = tuple(
            window
            if fresh or window.peak_at_border(patch.values)
            else self._filled(*window.focused(self._prior(window)))
            for window, patch in zip(self.windows, self.field.patches, strict=True)
        )
        if any(a is not b for a, b in zip(windows, self.windows, strict=True)):
            found = Standing(self.coarse, windows, self.height)
            patches = tuple(
                patch if a is b else a.patch(self._prior(a))
                for a, b, patch in zip(windows, self.windows, self.field.patches, strict=True)
            )
            found.__dict__["field"] = replace(self.field, patches=patches)
        found = found._searched()
        masses = found.masses()
        alone = found._with_own_peaks()
        keep = [i for i in np.argsort(-masses, kind="stable") if masses[i] > LEAST and i in alone][:MOST]
        return found if len(keep) == len(found.windows) else found._kept(sorted(int(i) for i in keep))

    def _with_own_peaks(self) -> set[int]:
        """The windows with a peak inside, of two with the same one the finer."""
        order = sorted(range(len(self.windows)), key=lambda i: float(self.windows[i].half.max()))
        found: list[int] = []
        tops: list[np.ndarray] = []
        for i in order:
            window, values = self.windows[i], self.field.patches[i].values
            if window.peak_at_border(values):
                continue
            top = window.directions.reshape(-1, 3)[int(values.argmax())]
            near = math.cos(math.atan(3 * float(window.half.max()) / (NODES - 1)))
            if all(top @ other < near for other in tops):
                found.append(i)
                tops.append(top)
        return {*found}

    def masses(self) -> np.ndarray:
        """The share of the belief in each window."""
        pairs = zip(self.field.patches, self.field.shares, strict=True)
        found = [np.sum(np.exp(patch.values - self.log_mean) * share) for patch, share in pairs]
        return np.array(found) / (4 * math.pi)

    def _kept(self, places: list[int]) -> Standing:
        found = Standing(self.coarse, tuple(self.windows[i] for i in places), self.height)
        found.__dict__["field"] = replace(self.field, patches=tuple(self.field.patches[i] for i in places))
        return found

    def _searched(self) -> Standing:
        """With a window about the highest peak that has none, if it holds enough of the belief."""
        if len(self.windows) >= MOST:
            return self
        field, grid = self.field, self.field.grid
        values = np.where(field.outside, field.values, -np.inf) if self.windows else field.values
        best = int(values.argmax())
        flat = field.values.reshape(-1)
        if not math.isfinite(values.reshape(-1)[best]) or flat[neighbours(grid, best)].max() > flat[best]:
            return self
        peak, sigma = refine(grid, flat, best)
        if sigma > WIDE or math.exp(min(flat[best] - self.log_mean, 50.0)) * sigma**2 / 2 < WORTH:
            return self
        return self._with_window(peak, sigma)

    def _with_window(self, centre: np.ndarray, width: float) -> Standing:
        """With a window about `centre` ``(3,)`` for a peak of this `width` (radians), drawn from the coarse field."""
        frame = np.concatenate([centre[None], tangent_frame(centre)])
        half = np.full(2, min(math.tan(min(REACH * width, 1.0)), WIDEST))
        window = Window(frame, half, np.zeros((1, NODES, NODES)))
        if isinstance(self.coarse, RangedBelief):
            limits = math.log(self.coarse.ranges[0]), math.log(self.coarse.ranges[-1])
            window = replace(window, logs=np.linspace(*limits, RANGES), limits=limits)
        window = window.like(self._coarse_at(window.directions, window.logs))
        found = Standing(self.coarse, (*self.windows, window), self.height)
        patch = window.patch(self._prior(window))
        found.__dict__["field"] = replace(self.field, patches=(*self.field.patches, patch))
        return found

    def _coarse_at(self, directions: np.ndarray, logs: np.ndarray | None) -> np.ndarray:
        """The field of the whole sphere ``(K, ...)`` at directions ``(..., 3)`` times ranges of these logarithms."""
        if isinstance(self.coarse, RangedBelief):
            assert logs is not None
            coefficients = _between(tuple(self.coarse.ranges.tolist()))(logs) @ self.coarse.shells
        else:
            coefficients = self.coarse.coefficients[None]
        return RealHarmonics(self.degree).synthesise(coefficients, directions)

    def _filled(self, window: Window, beyond: np.ndarray | None) -> Window:
        """A window with the nodes `beyond` what it held before taken from the field of the whole sphere."""
        if beyond is None:
            return window
        nodes, values = beyond.any(axis=0), window.values.copy()
        found = self._coarse_at(window.directions[nodes], window.logs)
        values[:, nodes] = np.where(beyond[:, nodes], found, values[:, nodes])
        return window.like(values)

    def distance(self, about: np.ndarray) -> tuple[float, float] | None:
        """Mean distance (metres) and standard deviation of its logarithm near a direction; None without ranges."""
        if not isinstance(self.coarse, RangedBelief):
            return None
        for window in self.windows:
            inside = window.directions @ about > math.cos(NEAR)
            if window.patch().places(about)[1] and inside.any():
                prior = self._prior(window)
                values = (window.values if prior is None else window.values + prior)[:, inside]
                mass = np.exp(values - values.max()) @ window.weights[inside] * window.shares
                assert window.logs is not None
                ranges = np.exp(window.logs)
                return float(mean_range(mass / mass.sum(), ranges)), float(range_spread(mass / mass.sum(), ranges))
        probabilities = self.coarse.range_probabilities(about)
        ranges = self.coarse.ranges
        return float(mean_range(probabilities, ranges)), float(range_spread(probabilities, ranges))

    def _prior(self, window: Window) -> np.ndarray | None:
        """What the height of things says at the nodes of a window ``(K, n, n)``, log ratios."""
        if self.height is None or window.logs is None or not isinstance(self.coarse, RangedBelief):
            return None
        level = height_level(self.degree, tuple(self.coarse.ranges.tolist()), self.height)
        rise = np.exp(window.logs)[:, None, None] * window.directions[..., 2]
        return np.log(likely_height(self.height + rise)) - level


def least_width(window: Window, degree: int) -> float:
    """Radians: the narrowest detection that a window and the field around it hold together.

    Narrower than its nodes are apart it would be lost between them. And where the window ends the field goes on, in
    which each detection is as wide as a degree holds: a window that is much finer would count the skirts twice.
    """
    apart = 0.8 * math.atan(2 * float(window.half.min()) / (NODES - 1))
    return max(apart, FINER * resolved(degree))


@lru_cache(maxsize=16)
def _between(ranges: tuple[float, ...]) -> Callable[[np.ndarray], np.ndarray]:
    """The weights ``(K, len(ranges))`` of the shells at logarithms ``(K,)`` of ranges between them: cubic splines."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(np.log(ranges), np.eye(len(ranges)))


def _with_prior(belief: RangedBelief, height: float | None) -> RangedBelief:
    if height is None:
        return belief if belief.prior is None else replace(belief, prior=None)
    return replace(belief, prior=_height_prior(belief.degree, tuple(belief.ranges.tolist()), height))


@lru_cache(maxsize=64)
def _height_prior(degree: int, ranges: tuple[float, ...], height: float) -> np.ndarray:
    found = height_prior(degree, np.array(ranges), height)
    found.setflags(write=False)
    return found
