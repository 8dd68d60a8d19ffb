"""Fitting a `DetectorModel` on looks with known truth: the numbers, and how sure they are.

How far scores are believed, and what the fit is worth, is judged on groups of looks that were left out in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eagor.evaluation.detector_em import Estimate, Fitting
from eagor.evaluation.detector_places import ALARMS_PRIOR, HABIT_PRIOR, NUMBER_PRIOR, candidates, rate_interval
from eagor.evaluation.labelled_looks import Deviations, LabelledLook, in_time, rows_of
from eagor.evidence.detector import Alarms, DetectorModel, model_as_json
from eagor.statistics import bootstrap_interval

__all__ = ["DetectorFit", "HeldOut", "fit_detector", "fitted_model"]

DEVIATIONS = (0.0, 0.5, 1.0, 2.0, 4.0)  # of the score curve's prior, tried on what is left out
FOLDS, BLOCKS = 5, 10  # parts that are left out in turn; stretches of consecutive looks, where there is one group
RESAMPLES, LEVEL = 200, 0.95
PRIOR = 0.5  # probability of presence before a look
# Numbers that have an interval, and when they have none.
NUMBERS: dict[str, Callable[[Estimate], float]] = {
    "detection_share": lambda found: found.share,
    "false_alarms_per_look": lambda found: found.transient,
    "look_alikes": lambda found: math.nan if found.split is None else found.split.numbers[0],
    "spread": lambda found: found.errors.spread,
    "offset": lambda found: found.errors.offset,
    "spread_of_size": lambda found: found.errors.spread_of_size,
    "offset_of_size": lambda found: found.errors.offset_of_size,
}
UNKNOWN_WITHOUT: dict[str, Callable[[Estimate], object]] = {
    "detection_share": lambda found: found.targets,
    "look_alikes": lambda found: found.split is not None,
}


@dataclass(frozen=True)
class HeldOut:
    """Means over looks that the fit had not seen, nats: (with the model before, with the fitted one).

    `density`: log density (per steradian) at the truth after this look alone; None without targets. `presence`: log of
    the probability given to the truth about presence, from 0.5 before the look. `gain`: by how much the two together
    rose, with a 95 % interval over the parts that were left out.
    """

    density: tuple[float, float] | None
    presence: tuple[float, float]
    gain: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class DetectorFit:
    """A fitted `model`, and what it rests on.

    `targets` in view; `matched`: how many of the `detections` are of a target (a sum of probabilities). `intervals`:
    95 % intervals by name of the number, over `groups`. With one group they are over stretches of its looks, and say
    nothing of other recordings. `held_out`: None for a single look.
    """

    model: DetectorModel
    looks: int
    groups: int
    targets: int
    detections: int
    matched: float
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    held_out: HeldOut | None = None

    @property
    def false_alarms(self) -> float:
        """How many detections are of no target."""
        return self.detections - self.matched

    def as_json(self) -> dict[str, Any]:
        """Plain values, for files and ``--json``."""
        counts = {name: getattr(self, name) for name in ("looks", "groups", "targets", "detections")}
        counts |= {"matched": round(self.matched, 1), "false_alarms": round(self.false_alarms, 1)}
        judged = None
        if (told := self.held_out) is not None:
            judged = {
                "log_density": None if told.density is None else _rounded(told.density),
                "log_presence": _rounded(told.presence),
                "gain": round(told.gain, 4),
                "interval": _rounded(told.interval),
            }
        intervals = {name: _rounded(ends) for name, ends in self.intervals.items()}
        return {"detector": model_as_json(self.model), "counts": counts, "intervals": intervals, "held_out": judged}


def fit_detector(
    looks: Sequence[LabelledLook],
    base: DetectorModel | None = None,
    *,
    rng: np.random.Generator | None = None,
    resamples: int = RESAMPLES,
    on_step: Callable[[], object] = lambda: None,
) -> DetectorFit:
    """The model of the detector that gave `looks`, fitted by penalised maximum likelihood.

    `base` (default: `DetectorModel()`): the prior of each number. What the looks cannot tell is taken from it: the
    habit without a target in view, the offset and the look-alikes without orientations, `kept_for` and `kept_within`
    always. `resamples`: draws of whole groups, for the intervals; `on_step` is called after each. `rng` draws them.

    Raises `EagorError` without looks.
    """
    base, looks = base or DetectorModel(), list(looks)
    fitting, deviation, found = _fitted(looks, base)
    rows, parts = fitting.rows, _parts(looks)
    drawn, names = [], np.unique(parts)
    rng = rng or np.random.default_rng(0)
    for _ in range(resamples if len(names) > 1 else 0):
        times = np.bincount(rng.integers(len(names), size=len(names)), minlength=len(names))
        drawn.append(fitting.estimate(times[np.searchsorted(names, parts)].astype(float), deviation, found))
        on_step()
    return DetectorFit(
        found.model(base), len(looks), len({look.group for look in looks}), len(rows.look_of_target), len(rows.scores),
        found.matched, _intervals(found, drawn, fitting, len(names)),
        _held_out(looks, fitting, deviation, found, parts) if len(names) > 1 else None,
    )  # fmt: skip


def fitted_model(looks: Sequence[LabelledLook], base: DetectorModel) -> DetectorModel:
    """The model alone, as `fit_detector` finds it."""
    return _fitted(looks, base)[2].model(base)


def _fitted(looks: Sequence[LabelledLook], base: DetectorModel) -> tuple[Fitting, float, Estimate]:
    """The looks, how far their scores are believed, and the likeliest numbers."""
    rows = rows_of(looks, base)
    fitting, every = Fitting(rows, base), np.ones(rows.count)
    deviation = _deviation(fitting, _folds(_parts(looks)))
    found = fitting.estimate(every, deviation)
    if rows.placed.any():
        false = found.false(rows)
        around = candidates(rows, false, Deviations.stated(base, found.errors.spread))
        fitting = replace(fitting, found=around, false=1 - found.of(rows).right)
        found = fitting.estimate(every, deviation, found)
    return fitting, deviation, found


def _parts(looks: Sequence[LabelledLook]) -> np.ndarray:
    """A number for each look ``(L,)``: its group; where all are of one group, its stretch of consecutive looks."""
    names = list(dict.fromkeys(look.group for look in looks))
    if len(names) > 1:
        return np.array([names.index(look.group) for look in looks])
    parts = np.empty(len(looks), dtype=int)
    parts[in_time(looks)] = np.arange(len(looks)) * min(BLOCKS, len(looks)) // len(looks)
    return parts


def _folds(parts: np.ndarray) -> list[np.ndarray]:
    """Which looks ``(L,)`` are left out, in turn."""
    names = np.unique(parts)
    count = min(FOLDS, len(names))
    return [np.isin(parts, names[fold::count]) for fold in range(count)] if len(names) > 1 else []


def _deviation(fitting: Fitting, folds: Sequence[np.ndarray]) -> float:
    """How far scores are believed: what gives the looks that were left out the best likelihood.

    Of those that are within a standard error of the best, the one that believes least (Breiman et al., Classification
    and Regression Trees, 1984).
    """
    if len(fitting.knots) < 2 or not folds:
        return 0.0
    totals = np.zeros((len(folds), len(DEVIATIONS)))
    for row, left_out in zip(totals, folds, strict=True):
        found: Estimate | None = None
        for place, deviation in enumerate(DEVIATIONS):
            found = fitting.estimate((~left_out).astype(float), deviation, found)
            row[place] = left_out @ found.log_likelihoods(fitting.rows)
    behind = totals[:, [totals.sum(axis=0).argmax()]] - totals
    doubt = behind.std(axis=0, ddof=1) / math.sqrt(len(folds))
    return DEVIATIONS[int(np.flatnonzero(behind.mean(axis=0) <= doubt)[0])]


def _intervals(
    found: Estimate, drawn: Sequence[Estimate], fitting: Fitting, parts: int
) -> dict[str, tuple[float, float]]:
    """The bootstrap's intervals; those of rates at least as wide as their posteriors for independent places.

    Wider for few `parts`: expanded percentiles (Hesterberg, The American Statistician 69(4), 2015).
    """
    from scipy.special import betaincinv, ndtr, stdtrit

    ends = np.array([(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    drawn_ends = ndtr(math.sqrt(parts / (parts - 1)) * stdtrit(parts - 1, ends)) if parts > 1 else ends
    values = {name: [of(each) for each in drawn] for name, of in NUMBERS.items()}
    looks = found.looks + ALARMS_PRIOR[1]
    wide = {"false_alarms_per_look": rate_interval(found.transient * looks - ALARMS_PRIOR[0], looks, LEVEL)}
    if found.targets:
        # Looks at one place count for less than looks at as many places: that is what its habit means.
        seen = np.bincount(fitting.rows.place)
        strength = float(found.habit.sum())
        worth = float((seen * (strength + 1) / (strength + seen)).sum()) + HABIT_PRIOR
        low, high = betaincinv(worth * found.share, worth * (1 - found.share), ends).tolist()
        wide["detection_share"] = low, high
    if found.split is not None:
        views = len(np.unique(fitting.rows.stretch[fitting.rows.placed])) + NUMBER_PRIOR
        wide["look_alikes"] = rate_interval(found.split.numbers[0] * views, views, LEVEL)
    intervals = {}
    for name, of_drawn in values.items():
        if name in UNKNOWN_WITHOUT and not UNKNOWN_WITHOUT[name](found):
            continue
        least, most = wide.get(name, (math.inf, -math.inf))
        low, high = np.quantile(of_drawn, drawn_ends) if drawn else (least, most)
        low, high = float(min(low, least)), float(max(high, most))
        if low <= high:
            intervals[name] = (low, high)
    return intervals


def _held_out(
    looks: Sequence[LabelledLook], fitting: Fitting, deviation: float, found: Estimate, parts: np.ndarray
) -> HeldOut:
    """Each look read by `base`, and by the model that was fitted without it."""
    told = np.empty((len(looks), 2, 2))  # before and after; density and presence
    for left_out in _folds(parts):
        model = fitting.estimate((~left_out).astype(float), deviation, found).model(fitting.base)
        for index in np.flatnonzero(left_out).tolist():
            told[index] = [_told(looks[index], each) for each in (fitting.base, model)]
    density, presence = told[..., 0], told[..., 1]
    known = np.asarray(np.isfinite(density).all(axis=1))
    gains = np.where(known, np.diff(np.where(known[:, None], density, 0))[:, 0], 0.0) + np.diff(presence)[:, 0]
    ends = bootstrap_interval(gains, np.random.default_rng(0), LEVEL, groups=parts)
    before, after = presence.mean(axis=0).tolist()
    there = tuple(density[known].mean(axis=0).tolist()) if known.any() else None
    return HeldOut(there, (before, after), float(gains.mean()), (ends.low, ends.high))


def _told(look: LabelledLook, model: DetectorModel) -> tuple[float, float]:
    """Log density at the truth (its mean over targets; NaN without), and log probability of the truth about presence.

    Both after this look alone, from a uniform direction and `PRIOR`. One look cannot tell a look-alike from a false
    alarm, nor an offset from a spread.
    """
    spread = min(math.hypot(model.spread, model.offset), math.radians(60))
    of_size = min(math.hypot(model.spread_of_size, model.offset_of_size), 2.0)
    found = look.detections.read(replace(model, spread=spread, spread_of_size=of_size))
    targets, habits = look.in_view, model.habits
    lasting = habits.look_alikes * float(habits.alike_levels @ habits.alike_shares)
    alarms = Alarms.prior(model).after(np.full(len(found), lasting))
    inverse, covered = float(alarms.weights @ (1 / (alarms.numbers + lasting))), found.area / (4 * math.pi)
    mean = 1 + habits.mean * covered * (inverse * float((found.ratios / found.clutter).sum()) - 1)
    if not len(targets):
        return math.nan, -math.log1p(PRIOR / (1 - PRIOR) * mean) if not len(look.targets) else 0.0
    speaks = (
        inverse * found.area * found.densities(targets, np.ones(1), found.ratios[None])[0, 0] if len(found) else 0.0
    )
    at = np.log1p(habits.mean * (speaks - np.ones(len(targets)))) - math.log(4 * math.pi * mean)
    return float(at.mean()), -math.log1p((1 - PRIOR) / PRIOR / mean)


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(float(value), 4) for value in values]
