"""The belief about a standing target: what all looks say together.

In world axes such a target has one place, so looks add. A coarse field over the whole sphere (with shells of range, if
positions are known) is searched for peaks, and a `Window` about each peak holds the finer detail. These hold log T, the
support of the looks for each place, and beside it the habits of places (`eagor.belief.bank`).

A place is a basin of the likelihood ratio T' of look-alikes. Where anything was detected at all, they have there

    Q = D / (4 pi) * integral of T' over the basin,

and `Bank.judged` gives the likelihood ratio of a target. Within a basin its shape is that of T: look-alikes limit how
much a place tells about who is there, not where.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor._values import altered, given, inherited, known, lazy
from eagor.belief.bank import Bank, log_detected, log_over
from eagor.belief.basins import Places, labelled, log_sums
from eagor.belief.direction import Belief
from eagor.belief.field import Patch, SphereField
from eagor.belief.ranged import NEAR, RangedBelief, log_heights, mean_range, range_spread, with_heights
from eagor.belief.windows import RANGES, REACH, Window, skirts, with_own_peaks
from eagor.evidence.detector import STATED, UNLIKELY, Spread
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import decoding_grid, neighbours, refine
from eagor.tracking.scan import Measurement

MOST = 4  # windows
WORTH = 0.02  # share of the belief: a peak that holds less gets no window
LEAST = 0.002  # share of the belief: a window that holds less is closed
LEAST_OF_MANY = 0.01  # the same with look-alikes, where each place with a detection keeps a small share for long
MOST_OF_IT = 0.5  # share of the belief: with capped shells, a window that holds more is kept, wherever its peak lies
SPILL = 0.02  # of a window's mass: skirts around it that hold less are left out
NOTHING = 12.0  # nats below a peak: if a window's border is lower, there is nothing beyond it
HIGHEST = 12.0  # nats over a target that was never detected: as high as coarse shells get, if there are look-alikes
NEVER = 1e-12  # least weight of a scale of the spread
WIDE = math.radians(14)  # the coarse field represents wider peaks well


@dataclass(frozen=True, eq=False)
class StationaryTarget:
    """log T, against "not here": `coarse` over the whole sphere, and `windows` about its peaks; world axes.

    `bank`: the habits of the cells of the decoding grid; None before any look. `height`: of the camera above the floor,
    metres, if known. `spread`: of the detector; windows have values for each of its scales, `coarse` the sum over them.
    """

    coarse: Belief | RangedBelief
    windows: tuple[Window, ...] = ()
    height: float | None = None
    spread: Spread = STATED
    bank: Bank | None = None

    @classmethod
    def uniform(cls, degree: int, ranges: np.ndarray | None, height: float | None = None) -> StationaryTarget:
        """A uniform belief."""
        if ranges is None:
            return cls(Belief.uniform(degree))
        return cls(with_heights(RangedBelief.uniform(degree, ranges), height), (), height)

    def restarted(self, density: np.ndarray) -> StationaryTarget:
        """A target that has just come to stand, with this density over a uniform one ``(H, W)``.

        What is known of look-alikes stays, and what they explained until now says nothing of the target.
        """
        ranges = self.coarse.ranges if isinstance(self.coarse, RangedBelief) else None
        blank, values, bank = StationaryTarget.uniform(self.degree, ranges, self.height), np.log(density), self.bank
        if bank is not None:
            alike = self.support.plus(bank.lead, [window.habits.lead for window in self.windows])
            level = alike.log_mean
            lead = np.log(np.maximum(alike.averaged(level), 1e-300)) + level - values
            explained = self.log_other_intensity
            excused = np.zeros(values.shape) if explained is None else explained[self.places.cells]
            bank = bank.restarted(lead, excused)
        coarse = blank.coarse.plus(RealHarmonics(self.degree).analyse(values, self.grid))
        spread = altered(self.spread, weights=self.spread.otherwise)
        return altered(blank, coarse=coarse, spread=spread, bank=bank)

    @property
    def degree(self) -> int:
        """The degree of `coarse`."""
        return self.coarse.degree

    @property
    def grid(self) -> ErpGrid:
        """The decoding grid."""
        return decoding_grid(self.degree)

    @given
    def support(self) -> SphereField:
        """log T over directions: log of the mean likelihood over the ranges."""
        grid = self.grid
        if isinstance(self.coarse, RangedBelief):
            values = self.coarse.posterior.coarse
        else:
            values = RealHarmonics(self.degree).synthesise(self.coarse.coefficients, grid)
        return SphereField(grid, values, tuple(window.patch(self._prior(window)) for window in self.windows))

    @lazy
    def places(self) -> Places:
        """The basins of the log likelihood ratio of look-alikes."""
        return Places.of(self.support, self.labels)

    @lazy
    def labels(self) -> tuple[int, np.ndarray]:
        """The number of places, and that of each cell ``(H, W)``."""
        values = self.support.values
        return labelled(values if self.bank is None else values + self.bank.lead)

    @lazy
    def field(self) -> SphereField:
        """log LR over directions."""
        bank = self.bank
        if bank is None:
            return self.support
        support, explained = self.support, self.log_other_intensity
        if explained is None:
            patches = [w.habits.judged(p.values, None) for w, p in zip(self.windows, support.patches, strict=True)]
            return support.like(bank.judged(support.values, None), patches)
        cells = explained[self.places.cells]
        if isinstance(self.coarse, RangedBelief):
            # Near shells turn fast: what was detected at one place has left traces in the directions of others.
            cells = np.full(cells.shape, explained.max())
        parts = zip(self.windows, support.patches, self.places.patches, strict=True)
        patches = [window.habits.judged(patch.values, explained[home]) for window, patch, home in parts]
        return support.like(bank.judged(support.values, cells), patches)

    @lazy
    def log_other_intensity(self) -> np.ndarray | None:
        """log(1 + Q) ``(m,)`` of each of the `places`; None without look-alikes."""
        bank = self.bank
        if bank is None or not len(bank.alike):
            return None
        support = self.support
        held = [(bank, support.values)]
        held += [(w.habits, patch.values) for w, patch in zip(self.windows, support.patches, strict=True)]
        # Shells carry along what was detected from elsewhere; the bank of the cells does not know of it.
        ranged = isinstance(self.coarse, RangedBelief)
        cells, *patches = (
            each.lead + (log_over(values, each.missed) if ranged else log_detected(each)) for each, values in held
        )
        alike = support.plus(cells, patches)
        many = math.log(bank.habits.look_alikes / (4 * math.pi))
        return np.logaddexp(0.0, log_sums(alike, self.places) + many)

    @lazy
    def log_mean(self) -> float:
        """log of the mean likelihood ratio over all directions and ranges."""
        return self.field.log_mean

    def moved(self, step: np.ndarray, height: float | None = None) -> StationaryTarget:
        """After the body has moved by `step` ``(3,)`` metres, world axes."""
        if not isinstance(self.coarse, RangedBelief):
            return self
        coarse = with_heights(self.coarse.predict(np.eye(3), step), height)
        found = altered(self, coarse=coarse, windows=(), height=height)
        pairs = zip(self.windows, self._borders(), strict=True)
        return altered(
            found, windows=tuple(found._filled(*w.moved(step, self._prior(w), border)) for w, border in pairs)
        )

    def ranged(self, ranges: np.ndarray, height: float | None) -> StationaryTarget:
        """The same belief over direction and range: what is known so far holds for all ranges."""
        found = RangedBelief.uniform(self.degree, ranges).plus(self.coarse.coefficients)  # type: ignore[union-attr]
        logs = np.log(ranges)
        limits = float(logs[0]), float(logs[-1])
        windows = tuple(
            altered(w, values=np.repeat(w.values, RANGES, axis=1), logs=np.linspace(*limits, RANGES), limits=limits)
            for w in self.windows
        )
        return altered(self, coarse=with_heights(found, height), windows=windows, height=height)

    def plus(self, look: Measurement) -> StationaryTarget:
        """With one more look."""
        found = self if look.scan.response_map is None else self.with_response_map(look)
        return found if look.world is None else found._detected(look)

    def with_response_map(
        self, look: Measurement, share: float = 1.0, since: np.ndarray | None = None
    ) -> StationaryTarget:
        """With `share` of a look's response maps; the body has moved by `since` ``(3,)`` from where it was taken."""
        coefficients = look.scan.response_map
        assert coefficients is not None
        if since is None or not since.any() or not isinstance(self.coarse, RangedBelief):
            windows, patches = [], []
            for window, patch in zip(self.windows, self.support.patches, strict=True):
                found = share * look.response_map_at(window.directions)
                windows.append(window.plus(found[None, None]))
                patches.append(patch.like(patch.values + found) if len(window.values) == 1 else None)
            found = altered(self, coarse=self.coarse.plus(share * coefficients), windows=tuple(windows))
            # What is said of all ranges alike adds as much to the field over directions.
            drawn = tuple(w.patch(self._prior(w)) if p is None else p for w, p in zip(windows, patches, strict=True))
            return known(found, support=self.support.redrawn(self.support.values + share * look.values, drawn))
        ranges = self.coarse.ranges
        alike = np.broadcast_to(share * coefficients, (len(ranges), len(coefficients)))
        carried = RangedBelief(alike, ranges).predict(np.eye(3), since).shells
        windows = []
        for window in self.windows:
            points = window.points() + since
            points /= np.sqrt(np.einsum("...i,...i->...", points, points))[..., None]
            windows.append(window.plus(share * look.response_map_at(points)[None]))
        return altered(self, coarse=self.coarse.plus(carried), windows=tuple(windows))

    def _detected(self, look: Measurement) -> StationaryTarget:
        """With the detections of a look."""
        habits = look.scan.habits
        assert habits is not None
        bank = self._ready(look)
        added, values = look.added(bank)
        taken: np.ndarray | float = 1.0
        if isinstance(self.coarse, RangedBelief) and len(bank.alike):
            # Truncated, a peak of hundreds of nats would ring everywhere; more than this tells nothing of who is there.
            most = np.maximum(HIGHEST + bank.missed - self.support.values, 0.0)
            taken = np.where(values > most, most / np.maximum(values, 1e-300), 1.0)
            values = np.minimum(values, most)
            added = RealHarmonics(self.degree).analyse(values, self.grid)
        bank = bank.after(look.shown, self.spread.weights, taken)
        windows, patches = [], []
        for window, patch in zip(self.windows, self.support.patches, strict=True):
            own = Bank.blank(habits, patch.values.shape) if window.bank is None else window.bank.for_sensor(habits)
            shown = look.at(window.directions, window.finest(look.world.directions), self.spread.scales)  # type: ignore[union-attr]
            total = np.log(shown.gains(own.recall))
            windows.append(altered(window.plus(total[:, None]), bank=own.after(shown, self.spread.weights)))
            if len(total) == 1:  # what is said of all ranges alike
                patches.append(patch.like(patch.values + total[0]))
            else:
                patches.append(windows[-1].patch(self._prior(window)))
        found = altered(self, coarse=self.coarse.plus(added), windows=tuple(windows), bank=bank)
        return known(found, support=self.support.redrawn(self.support.values + values, tuple(patches)))

    def _ready(self, look: Measurement) -> Bank:
        """The habits of the cells, for the detector of this look."""
        habits = look.scan.habits
        assert habits is not None
        return Bank.blank(habits, self.grid.shape) if self.bank is None else self.bank.for_sensor(habits)

    def renewed(self, share: float) -> StationaryTarget:
        """After a `share` of the places has drawn its habit anew."""
        if self.bank is None or share <= 0:
            return self
        windows = tuple(altered(window, bank=window.habits.renewed(share)) for window in self.windows)
        return self._alike(bank=self.bank.renewed(share), windows=windows)

    def _alike(self, **changes: Any) -> StationaryTarget:
        """With other parts, but the same `field`."""
        names = "support", "labels", "places", "log_other_intensity", "field", "log_mean", "masses"
        return inherited(altered(self, **changes), self, *names)

    def _with(self, patches: tuple[Patch, ...] | None = None, **changes: Any) -> StationaryTarget:
        """With other parts, but the same `coarse`; `patches` of the `support`, if they differ."""
        found = inherited(altered(self, **changes), self, "labels", "support")
        return found if patches is None else known(found, support=altered(self.support, patches=patches))

    def scaled(self, factor: float) -> StationaryTarget:
        """With all log ratios scaled by `factor` in [0, 1]: the covariance of each peak grows by 1 / factor."""
        kept = (1 - factor) * self.spread.logs  # what is known of the spread
        windows = tuple(window.like(window.values * factor + kept) for window in self.windows)
        return altered(self, coarse=self.coarse.forget(factor), windows=windows)

    def detecting(self) -> StationaryTarget:
        """With a spread that is learnt, from the first detections on."""
        if self.spread.doubted:
            return self
        spread = Spread.unsure()
        windows = tuple(window.like(window.values + spread.logs) for window in self.windows)
        return altered(self, windows=windows, spread=spread)

    def spreading(self, spread: Spread) -> StationaryTarget:
        """With other weights of the scales."""
        return self._alike(spread=spread) if self.spread.doubted else self

    def judged(self, stands: float, otherwise: np.ndarray) -> StationaryTarget:
        """With the spread as learnt from the windows.

        `stands`: probability that the target stands; `otherwise` ``(S,)``: weights of the scales if it does not.
        """
        if len(self.spread.scales) == 1:
            return self
        held = np.zeros(len(self.spread.scales))
        patches = zip(self.windows, self.field.patches, self.support.patches, self.field.layout.shares, strict=True)
        for window, judged, patch, share in patches:
            values = window.by_scale(self._prior(window)) + (judged.values - patch.values) - self.log_mean
            held += np.exp(values).reshape(len(held), -1) @ share.ravel()
        held /= 4 * math.pi
        held += max(1 - held.sum(), 0.0) * self.spread.weights
        held = np.maximum(held / held.sum(), NEVER)  # `otherwise` alone may keep a scale
        likely = stands * held + (1 - stands) * otherwise > UNLIKELY
        held, otherwise = held[likely], otherwise[likely]
        spread = Spread(self.spread.scales[likely], held / held.sum(), otherwise / otherwise.sum(), True)
        if likely.all():
            return self.spreading(spread)
        return altered(
            self, windows=tuple(window.like(window.values[likely]) for window in self.windows), spread=spread
        )

    def opened(self, look: Measurement) -> StationaryTarget:
        """With windows at the detections of a look that is about to be added, where there are none yet."""
        found = self
        centres, widths = look.centres
        if not len(centres):
            return self
        widest = WIDE / self.spread.scales.min()
        reached = self.field.smooth(centres, 1) - self.log_mean
        habits = look.scan.habits
        assert habits is not None
        reached = reached + np.log(look.at(centres, 0.0, np.ones(1)).gains(habits.mean)[0])
        if look.scan.response_map is not None:
            reached = reached + look.response_map_at(centres)
        for centre, width, rise in zip(centres, widths, reached, strict=True):
            if width > widest or len(found.windows) >= 2 * MOST or math.exp(min(rise, 50.0)) * width**2 < LEAST:
                continue
            if any(window.holds(centre, width) for window in found.windows):
                continue
            found = found._with_window(centre, width, look)
        return found

    def focused(self, fresh: bool = False) -> StationaryTarget:
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
            patches = tuple(
                patch if a is b else a.patch(self._prior(a))
                for a, b, patch in zip(windows, self.windows, self.support.patches, strict=True)
            )
            found = self._with(patches, windows=windows)
        found = found._searched()
        masses, least = found.masses, LEAST if found.log_other_intensity is None else LEAST_OF_MANY
        alone = with_own_peaks(found.windows, found.field.patches)
        if found.log_other_intensity is not None and isinstance(found.coarse, RangedBelief):
            alone |= {int(i) for i in np.flatnonzero(masses > MOST_OF_IT)}  # capped shells could not stand in for it
        keep = [i for i in np.argsort(-masses, kind="stable") if masses[i] > least and i in alone][:MOST]
        return found if len(keep) == len(found.windows) else found._kept(sorted(int(i) for i in keep))

    def _borders(self) -> list[float]:
        """The half width that each window needs, to cover the skirts of the field around it."""
        found = [0.0] * len(self.windows)
        if not any(window.border for window in self.windows):
            return found
        around, grid = skirts(self.degree), self.field.grid
        for index, (window, mass) in enumerate(zip(self.windows, self.masses, strict=True)):
            if not window.border:
                continue
            cosine = grid.directions @ window.frame[0]
            peak = math.atan(REACH * float(window.spacing.max()))
            beside = (cosine > math.cos(around)) & (cosine < math.cos(peak))
            held = np.exp(self.field.values[beside] - self.log_mean) @ grid.weights[beside] / (4 * math.pi)
            found[index] = math.tan(around) if held > SPILL * mass else 0.0
        return found

    @lazy
    def masses(self) -> np.ndarray:
        """The share of the belief in each window."""
        pairs = zip(self.field.patches, self.field.layout.shares, strict=True)
        found = [np.sum(np.exp(patch.values - self.log_mean) * share) for patch, share in pairs]
        return np.array(found) / (4 * math.pi)

    def _kept(self, places: list[int]) -> StationaryTarget:
        patches = tuple(self.support.patches[i] for i in places)
        return self._with(patches, windows=tuple(self.windows[i] for i in places))

    def _searched(self) -> StationaryTarget:
        """With a window about the highest peak without one, if it holds enough of the belief."""
        if len(self.windows) >= MOST:
            return self
        field, grid = self.field, self.field.grid
        values = np.where(field.layout.outside, field.values, -np.inf) if self.windows else field.values
        best = int(values.argmax())
        flat = field.values.reshape(-1)
        if not math.isfinite(values.reshape(-1)[best]) or flat[neighbours(grid, best)].max() > flat[best]:
            return self
        peak, sigma = refine(grid, flat, best)
        if sigma > WIDE or math.exp(min(flat[best] - self.log_mean, 50.0)) * sigma**2 / 2 < WORTH:
            return self
        return self._with_window(peak, sigma)

    def _with_window(self, centre: np.ndarray, width: float, look: Measurement | None = None) -> StationaryTarget:
        """With a window about `centre` ``(3,)`` for a peak of this `width` (radians), before a `look`.

        Its values come from an existing window there, or from the coarse field.
        """
        bank = self.bank if look is None else self._ready(look)
        window = Window.about(centre, width, self.degree)
        if isinstance(self.coarse, RangedBelief):
            limits = math.log(self.coarse.ranges[0]), math.log(self.coarse.ranges[-1])
            window = altered(window, logs=np.linspace(*limits, RANGES), limits=limits)
        inside = [other for other in self.windows if other.places(centre)[1]]
        if inside:
            finest = min(inside, key=lambda other: float(other.spacing.max()))
            window = self._filled(*finest.drawn(window))
        else:
            window = window.like(self._coarse_at(window.directions, window.logs))
            if bank is not None:
                window = altered(window, bank=bank.at_cells(self.grid, window.directions))
        patches = (*self.support.patches, window.patch(self._prior(window)))
        return self._with(patches, windows=(*self.windows, window), bank=bank)

    def _coarse_at(self, directions: np.ndarray, logs: np.ndarray | None) -> np.ndarray:
        """The coarse field ``(S, K, ...)`` at directions ``(..., 3)`` and these logarithms of ranges."""
        if isinstance(self.coarse, RangedBelief):
            assert logs is not None
            found = RealHarmonics(self.degree).synthesise(self.coarse.between(logs), directions)
        elif self.bank is not None:  # not truncated: a peak of hundreds of nats rings everywhere
            found = self.support.smooth(directions, 1)[None]
        else:
            found = RealHarmonics(self.degree).synthesise(self.coarse.coefficients[None], directions)
        return np.add.outer(np.log(self.spread.weights), found)

    def _filled(self, window: Window, beyond: np.ndarray | None) -> Window:
        """A window whose nodes `beyond` its former ones are filled from the coarse field."""
        if beyond is None:
            return window
        nodes, values = np.asarray(beyond.any(axis=0)), window.values.copy()
        if values[..., nodes].max() < values.max() - NOTHING:
            return window
        found = self._coarse_at(window.directions[nodes], window.logs)
        values[..., nodes] = np.where(beyond[:, nodes], found, values[..., nodes])
        if self.bank is None or window.bank is None:
            return window.like(values)
        around = self.bank.at_cells(self.grid, window.directions[nodes])
        return altered(window.like(values), bank=window.bank.with_nodes(nodes, around))

    def size(self, about: np.ndarray) -> float:
        """Half the angular size (radians) of what was detected in a direction ``(3,)``; 0 if that is not known."""
        if self.bank is None or not self.bank.sized:
            return 0.0
        for window in self.windows:
            places, inside = window.places(about)
            if inside:
                at = (places + 1) * ((window.values.shape[-1] - 1) / 2)
                return float(window.habits.at_nodes(at[:, None]).size[0])
        return float(self.bank.at_cells(self.grid, about[None]).size[0])

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
        ranges, within = self.coarse.ranges, self.coarse.within_shell
        return float(mean_range(probabilities, ranges)), math.hypot(range_spread(probabilities, ranges), within)

    def _prior(self, window: Window) -> np.ndarray | None:
        """The prior of heights at the nodes of a window ``(K, n, n)``, log ratios."""
        if self.height is None or window.logs is None or not isinstance(self.coarse, RangedBelief):
            return None
        rise = np.exp(window.logs)[:, None, None] * window.directions[..., 2]
        return log_heights(self.coarse, self.height, rise)
