"""The belief about a standing target: the sum of all looks.

In world axes such a target has one place, so looks add. A coarse field over the whole sphere (with shells of range, if
positions are known) is searched for peaks, and a `Window` about each peak holds the finer detail.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from eagor._lazy import given, lazy
from eagor.belief.direction import Belief
from eagor.belief.field import SphereField
from eagor.belief.heights import log_heights, with_heights
from eagor.belief.ranged import NEAR, RangedBelief, mean_range, range_spread
from eagor.belief.windows import RANGES, REACH, Window, skirts, with_own_peaks
from eagor.evidence.detector import STATED, UNLIKELY, Spread
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import decoding_grid, neighbours, refine
from eagor.tracking.look import Look

MOST = 4  # windows
WORTH = 0.02  # of the belief: peaks that hold less get no window,
LEAST = 0.002  # ... and windows that hold less are closed
SPILL = 0.02  # of a window's mass: skirts around it that hold less are left out
NOTHING = 12.0  # nats below a peak: if a window's border is lower, there is nothing beyond it
WIDE = math.radians(14)  # the coarse field represents wider peaks well


@dataclass(frozen=True, eq=False)
class Standing:
    """Log ratios against "not here": `coarse` over the whole sphere, and `windows` about its peaks; world axes.

    `height`: of the camera above the floor, metres, if known. `spread`: of the detector; windows have values for each
    of its scales, `coarse` the sum over them.
    """

    coarse: Belief | RangedBelief
    windows: tuple[Window, ...] = ()
    height: float | None = None
    spread: Spread = STATED

    @classmethod
    def uniform(cls, degree: int, ranges: np.ndarray | None, height: float | None = None) -> Standing:
        """A uniform belief."""
        if ranges is None:
            return cls(Belief.uniform(degree))
        return cls(with_heights(RangedBelief.uniform(degree, ranges), height), (), height)

    def blank(self) -> Standing:
        """A uniform belief with the same settings."""
        ranges = self.coarse.ranges if isinstance(self.coarse, RangedBelief) else None
        return replace(Standing.uniform(self.degree, ranges, self.height), spread=self.spread)

    @property
    def degree(self) -> int:
        """The degree of `coarse`."""
        return self.coarse.degree

    @given
    def field(self) -> SphereField:
        """The field over directions: log of the mean likelihood over the ranges."""
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
        """After the body has moved by `step` ``(3,)`` metres, world axes."""
        if not isinstance(self.coarse, RangedBelief):
            return self
        coarse = with_heights(self.coarse.predict(np.eye(3), step), height)
        found = Standing(coarse, (), height, self.spread)
        pairs = zip(self.windows, self._borders(), strict=True)
        return replace(
            found, windows=tuple(found._filled(*w.moved(step, self._prior(w), border)) for w, border in pairs)
        )

    def ranged(self, ranges: np.ndarray, height: float | None) -> Standing:
        """The same belief over direction and range: what is known so far holds for all ranges."""
        found = RangedBelief.uniform(self.degree, ranges).plus(self.coarse.coefficients)  # type: ignore[union-attr]
        logs = np.log(ranges)
        limits = float(logs[0]), float(logs[-1])
        windows = tuple(
            replace(w, values=np.repeat(w.values, RANGES, axis=1), logs=np.linspace(*limits, RANGES), limits=limits)
            for w in self.windows
        )
        return Standing(with_heights(found, height), windows, height, self.spread)

    def plus(self, look: Look, share: float = 1.0, since: np.ndarray | None = None) -> Standing:
        """With `share` of a look added; the body has moved by `since` ``(3,)`` from where it was taken."""
        if since is None or not since.any() or not isinstance(self.coarse, RangedBelief):
            windows, patches = [], []
            for window, patch in zip(self.windows, self.field.patches, strict=True):
                found = share * look.at(window.directions, _least(look, window), self.spread.scales)
                windows.append(window.plus(found[:, None]))
                if len(found) == 1:  # what is said of all ranges alike
                    patches.append(patch.like(patch.values + found[0]))
                else:
                    patches.append(windows[-1].patch(self._prior(window)))
            found = replace(self, coarse=self.coarse.plus(share * look.coefficients), windows=tuple(windows))
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
            found = look.at(points, _least(look, window), self.spread.scales)
            windows.append(window.plus(share * found))
        return replace(self, coarse=self.coarse.plus(carried), windows=tuple(windows))

    def scaled(self, factor: float) -> Standing:
        """With all log ratios scaled by `factor` in [0, 1]: the covariance of each peak grows by 1 / factor."""
        kept = (1 - factor) * self.spread.logs  # what is known of the spread
        windows = tuple(window.like(window.values * factor + kept) for window in self.windows)
        return replace(self, coarse=self.coarse.forget(factor), windows=windows)

    def detecting(self) -> Standing:
        """With a spread that is learnt, from the first detections on."""
        if self.spread.doubted:
            return self
        spread = Spread.unsure()
        windows = tuple(window.like(window.values + spread.logs) for window in self.windows)
        return replace(self, windows=windows, spread=spread)

    def spreading(self, spread: Spread) -> Standing:
        """With other weights of the scales."""
        if not self.spread.doubted:
            return self
        found = replace(self, spread=spread)
        if "field" in self.__dict__:
            found.__dict__["field"] = self.field
        return found

    def judged(self, stands: float, otherwise: np.ndarray) -> Standing:
        """With the spread as learnt from the windows.

        `stands`: probability that the target stands; `otherwise` ``(S,)``: weights of the scales if it does not.
        """
        if len(self.spread.scales) == 1:
            return self
        held = np.zeros(len(self.spread.scales))
        for window, share in zip(self.windows, self.field.shares, strict=True):
            held += np.exp(window.by_scale(self._prior(window)) - self.log_mean).reshape(len(held), -1) @ share.ravel()
        held /= 4 * math.pi
        held += max(1 - held.sum(), 0.0) * self.spread.weights
        likely = stands * held / held.sum() + (1 - stands) * otherwise > UNLIKELY
        held, otherwise = held[likely], otherwise[likely]
        spread = Spread(self.spread.scales[likely], held / held.sum(), otherwise / otherwise.sum(), True)
        if likely.all():
            return self.spreading(spread)
        return replace(
            self, windows=tuple(window.like(window.values[likely]) for window in self.windows), spread=spread
        )

    def opened(self, look: Look) -> Standing:
        """With windows at the detections of a look that is about to be added, where there are none yet."""
        found = self
        centres, widths = look.centres
        if not len(centres):
            return self
        widest = WIDE / self.spread.scales.min()
        reached = self.field.smooth(centres, 1) + look.at(centres, np.zeros(1), np.ones(1))[0] - self.log_mean
        for centre, width, rise in zip(centres, widths, reached, strict=True):
            if width > widest or len(found.windows) >= 2 * MOST or math.exp(min(rise, 50.0)) * width**2 < LEAST:
                continue
            if any(window.holds(centre, width) for window in found.windows):
                continue
            found = found._with_window(centre, width)
        return found

    def focused(self, fresh: bool = False) -> Standing:
        """With windows refined to the width of their peaks; `fresh` windows are fine enough already."""
        found, windows = self, self.windows
        if not fresh:
            windows = tuple(
                window
                if window.peak_at_border(patch.values)
                else self._filled(*window.focused(self._prior(window), border))
                for window, patch, border in zip(self.windows, self.field.patches, self._borders(), strict=True)
            )
        if any(a is not b for a, b in zip(windows, self.windows, strict=True)):
            found = replace(self, windows=windows)
            patches = tuple(
                patch if a is b else a.patch(self._prior(a))
                for a, b, patch in zip(windows, self.windows, self.field.patches, strict=True)
            )
            found.__dict__["field"] = replace(self.field, patches=patches)
        found = found._searched()
        masses = found.masses()
        alone = with_own_peaks(found.windows, found.field.patches)
        keep = [i for i in np.argsort(-masses, kind="stable") if masses[i] > LEAST and i in alone][:MOST]
        return found if len(keep) == len(found.windows) else found._kept(sorted(int(i) for i in keep))

    def _borders(self) -> list[float]:
        """The half width that each window needs, to cover the skirts of the field around it."""
        found = [0.0] * len(self.windows)
        if not any(window.border for window in self.windows):
            return found
        around, grid = skirts(self.degree), self.field.grid
        for index, (window, mass) in enumerate(zip(self.windows, self.masses(), strict=True)):
            if not window.border:
                continue
            cosine = grid.directions @ window.frame[0]
            peak = math.atan(REACH * float(window.spacing.max()))
            beside = (cosine > math.cos(around)) & (cosine < math.cos(peak))
            held = np.exp(self.field.values[beside] - self.log_mean) @ grid.weights[beside] / (4 * math.pi)
            found[index] = math.tan(around) if held > SPILL * mass else 0.0
        return found

    def masses(self) -> np.ndarray:
        """The share of the belief in each window."""
        pairs = zip(self.field.patches, self.field.shares, strict=True)
        found = [np.sum(np.exp(patch.values - self.log_mean) * share) for patch, share in pairs]
        return np.array(found) / (4 * math.pi)

    def _kept(self, places: list[int]) -> Standing:
        found = replace(self, windows=tuple(self.windows[i] for i in places))
        found.__dict__["field"] = replace(self.field, patches=tuple(self.field.patches[i] for i in places))
        return found

    def _searched(self) -> Standing:
        """With a window about the highest peak without one, if it holds enough of the belief."""
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
        """With a window about `centre` ``(3,)`` for a peak of this `width` (radians).

        Its values come from an existing window there, or from the coarse field.
        """
        window = Window.about(centre, width, self.degree)
        if isinstance(self.coarse, RangedBelief):
            limits = math.log(self.coarse.ranges[0]), math.log(self.coarse.ranges[-1])
            window = replace(window, logs=np.linspace(*limits, RANGES), limits=limits)
        inside = [other for other in self.windows if other.places(centre)[1]]
        if inside:
            finest = min(inside, key=lambda other: float(other.spacing.max()))
            window = self._filled(*finest.drawn(window))
        else:
            window = window.like(self._coarse_at(window.directions, window.logs))
        found = replace(self, windows=(*self.windows, window))
        patch = window.patch(self._prior(window))
        found.__dict__["field"] = replace(self.field, patches=(*self.field.patches, patch))
        return found

    def _coarse_at(self, directions: np.ndarray, logs: np.ndarray | None) -> np.ndarray:
        """The coarse field ``(S, K, ...)`` at directions ``(..., 3)`` and these logarithms of ranges."""
        if isinstance(self.coarse, RangedBelief):
            assert logs is not None
            coefficients = self.coarse.between(logs)
        else:
            coefficients = self.coarse.coefficients[None]
        found = RealHarmonics(self.degree).synthesise(coefficients, directions)
        return np.add.outer(np.log(self.spread.weights), found)

    def _filled(self, window: Window, beyond: np.ndarray | None) -> Window:
        """A window whose nodes `beyond` its former ones are filled from the coarse field."""
        if beyond is None:
            return window
        nodes, values = beyond.any(axis=0), window.values.copy()
        if values[..., nodes].max() < values.max() - NOTHING:
            return window
        found = self._coarse_at(window.directions[nodes], window.logs)
        values[..., nodes] = np.where(beyond[:, nodes], found, values[..., nodes])
        return window.like(values)

    def distance(self, about: np.ndarray) -> tuple[float, float] | None:
        """Mean distance (metres) and standard deviation of its logarithm near a direction; None without ranges."""
        if not isinstance(self.coarse, RangedBelief):
            return None
        for window in self.windows:
            inside = window.directions @ about > math.cos(NEAR)
            if window.places(about)[1] and inside.any():
                prior = self._prior(window)
                values = (window.by_range if prior is None else window.by_range + prior)[:, inside]
                mass = np.exp(values - values.max()) @ window.weights[inside] * window.shares
                assert window.logs is not None
                ranges = np.exp(window.logs)
                return float(mean_range(mass / mass.sum(), ranges)), float(range_spread(mass / mass.sum(), ranges))
        probabilities = self.coarse.range_probabilities(about)
        ranges = self.coarse.ranges
        return float(mean_range(probabilities, ranges)), float(range_spread(probabilities, ranges))

    def _prior(self, window: Window) -> np.ndarray | None:
        """The prior of heights at the nodes of a window ``(K, n, n)``, log ratios."""
        if self.height is None or window.logs is None or not isinstance(self.coarse, RangedBelief):
            return None
        rise = np.exp(window.logs)[:, None, None] * window.directions[..., 2]
        return log_heights(self.coarse, self.height, rise)


def _least(look: Look, window: Window) -> np.ndarray:
    """The least width (radians, ``(n,)``) at which a window can hold each detection of a look."""
    return np.zeros(1) if look.world is None else window.finest(look.world.directions)
