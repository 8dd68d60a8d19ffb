"""Absent, standing, wandering or turning: one filter over these hypotheses.

The target is absent, stands still, wanders (a random walk of so many degrees per root second), or turns at a steady
rate (`turning`). Each case with a target holds a belief over directions and is weighted by how well it predicted the
looks; a Markov chain links the hypotheses. This is a Bernoulli filter (Ristic et al., IEEE Transactions on Signal
Processing 61(13), 2013) with interacting multiple models (Blom and Bar-Shalom, IEEE Transactions on Automatic Control
33(8), 1988). The presence is the sum of the weights of the hypotheses with a target.

A wandering target is a density on a grid (`wandering`). A standing target is the sum of all looks since it came to
stand (`standing`). Such a sum cannot absorb a target that stops only now, so the likelier of the two is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor._values import altered, lazy
from eagor.belief.bank import Bank, linear, log_detected
from eagor.belief.density import Density
from eagor.belief.field import LARGEST, Patch, SphereField, bent, blurred
from eagor.belief.ranged import RangedBelief
from eagor.belief.windows import REACH
from eagor.evidence.detections import Detections, resolved
from eagor.evidence.detector import ClutterRate
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.tracking.config import MotionModel
from eagor.tracking.look_alikes import LookAlikes, LookAlikesByDrift
from eagor.tracking.moving import FAINTEST, TurningTarget, WanderingTarget
from eagor.tracking.scan import NOTHING_SHARED, Measurement, Scan, SharedError, Shares
from eagor.tracking.stationary import StationaryTarget

_RISE = 0.35  # nats over the typical place: less is no peak, where most of the sphere was never detected
_FAR = 4.0  # standard deviations from a detection: cells beyond do not count when movers are judged
_UNHEARD = 1e-5  # of the belief: cells with less do not count when the detector is learnt
_LEAST_NEW = 1e-6  # of a mean density: the lowest density of a target that comes to stand
_UNLIKELY = 0.05  # if turning is less likely than this, it counts as standing


@dataclass(frozen=True, eq=False)
class TargetHypotheses:
    """The hypotheses about a target and their probabilities, in world axes.

    It is absent, stands, wanders in one of several ways, or turns.

    `weights` ``(2 + M,)`` or, with `turning`, ``(3 + M,)`` sum to 1; M is the number of paces of `wandering`. `moves`:
    the habits of a moving target, and of a look-alike that moves as it does, which explains as well what the target
    would; `alike`: log(1 + Q) of that. `known`: look-alikes that stand, for what moves; they tell how far the odometry
    drifts, if `told_drift` (radians per root second) is None. `shared`: by how much all looks together may be off.
    """

    weights: np.ndarray
    standing: StationaryTarget
    wandering: WanderingTarget
    turning: TurningTarget | None = None
    moves: Bank | None = None
    alike: float = 0.0
    known: LookAlikesByDrift | None = None
    told_drift: float | None = None
    shared: SharedError = NOTHING_SHARED

    @classmethod
    def prior(
        cls, motion: MotionModel, standing: StationaryTarget, presence: float = 0.5, drift: float | None = None
    ) -> TargetHypotheses:
        """Before any look; `standing` is a uniform belief. `drift`: of the odometry, None if it is not known."""
        moving = motion.moving
        weights = np.array([1 - presence, presence * (1 - moving), *(presence * moving * motion.kinds)])
        turning = TurningTarget.prior(motion.turn) if motion.turn else None
        return cls(weights, standing, WanderingTarget.prior(motion, standing.degree), turning, told_drift=drift)

    @property
    def grid(self) -> ErpGrid:
        """On which densities and fields are kept."""
        return self.wandering.grid

    @property
    def presence(self) -> float:
        """Probability that the target is here."""
        return float(1 - self.weights[0])

    @property
    def moving(self) -> float:
        """Probability that it moves, if it is here."""
        here = self.weights[1:].sum()
        return float(self.weights[2:].sum() / here) if here > 0 else 0.0

    @property
    def look_alikes(self) -> LookAlikes | None:
        """The known look-alikes, for the likeliest drift; None before any detection."""
        return None if self.known is None else self.known.likeliest

    @property
    def drift(self) -> float:
        """How far the odometry drifts, radians per root second: as told, or as known look-alikes say."""
        if self.told_drift is not None:
            return self.told_drift
        return 0.0 if self.known is None else self.known.drift

    @lazy
    def field(self) -> SphereField:
        """log of (density / uniform density), given that the target is present; answers are read from it."""
        shares = self.weights[1:] / max(float(self.weights[1:].sum()), 1e-300)
        stands = self.standing.field
        if self.shared.looks:
            sized = self.shared.of_size > 0
            sizes = np.array([self.standing.size(patch.top) for patch in stands.patches]) if sized else 0.0
            stands = _blurred(stands, self.shared.angle(sizes))
        turns = float(shares[-1]) if self.turning is not None else 0.0
        stays = float(shares[0])
        if turns < _UNLIKELY:
            stays, turns = stays + turns, 0.0
        level = math.log(max(stays, 1e-300)) - self.standing.log_mean
        stands = stands.plus(level, [level] * len(stands.patches))
        if not len(self.wandering) and not turns:
            return stands
        wandering = self.wandering.mixed(shares[1 : 1 + len(self.wandering)])
        elsewhere = SphereField(self.grid, np.log(np.maximum(wandering, 1e-300)))
        turning = self.turning if turns > 0 else None

        def moves(wanders: np.ndarray, where: np.ndarray) -> np.ndarray:
            return wanders if turning is None else wanders + turns * turning.density(where)

        fine = stands.patches
        if turning is not None:
            narrow = 2 * math.pi / self.grid.height
            new = [patch for patch in turning.patches(narrow, 0.02 / turns) if not _is_covered(patch, stands)]
            fine += tuple(patch.like(stands.smooth(patch.directions)) for patch in new)
        patches = []
        for patch in fine:
            moving = moves(np.exp(elsewhere.smooth(patch.directions, 1)), patch.directions)
            patches.append(patch.like(np.logaddexp(patch.values, np.log(moving))))
        moving = moves(wandering, self.grid.directions)
        # Like `logaddexp`, ten times as fast; values are too large for it only where patches lie.
        values = np.log(np.exp(np.minimum(stands.values, LARGEST)) + np.maximum(moving, 1e-300))
        found = SphereField(self.grid, values, tuple(patches))
        return found if len(fine) > len(stands.patches) else stands.redrawn(values, found.patches)

    @property
    def reading(self) -> Density:
        """The `Density` of `field`."""
        return self.widened(0.0)

    @lazy
    def _readings(self) -> dict[float, Density]:
        return {}

    def widened(self, spread: float) -> Density:
        """The reading if all directions together may be off by `spread` radians per axis."""
        if spread not in self._readings:
            field = self.field if spread == 0 else _widened(self.field, spread)
            least, middle = -math.inf, field.values.size // 2
            if self.standing.bank is not None:  # over the median, as of `np.median`
                ranked = np.partition(field.values.reshape(-1), (middle - 1, middle))
                least = float(ranked[middle - 1] + ranked[middle]) / 2 + _RISE
            self._readings[spread] = Density(field, least)
        return self._readings[spread]

    def recall(self, directions: np.ndarray) -> np.ndarray:
        """The probability ``(...)`` that a look detects the target, if it is at directions ``(..., 3)``; world axes.

        As earlier looks have taught it; of detections only.
        """
        bank, moving = self.standing.bank, self.moving
        assert bank is not None
        found = linear(self.grid, bank.recall[None], directions)[0]
        return found if self.moves is None else (1 - moving) * found + moving * float(self.moves.recall)

    def alike_reports(self) -> np.ndarray:
        """The number of standing look-alikes in each cell of `grid` ``(H, W)`` that a look is expected to report."""
        bank, explained = self.standing.bank, self.standing.log_other_intensity
        if bank is None or explained is None:
            return np.zeros(self.grid.shape)
        there = self.standing.support.values + bank.lead - explained[self.standing.places.cells]
        number = bank.habits.look_alikes * np.exp(np.minimum(there, LARGEST)) * bank.alike_recall
        return number * self.grid.weights / (4 * math.pi)

    def distance(self, about: np.ndarray) -> tuple[float, float] | None:
        """Mean distance (metres) and standard deviation of its logarithm near a direction; None without ranges."""
        found = self.standing.distance(about)
        if found is None or self.shared.last is None:
            return found
        bank, (distance, spread) = self.standing.bank, found
        kept_within = math.inf if bank is None else bank.habits.kept_within or math.inf
        size = self.standing.size(about) if self.shared.of_size > 0 else 0.0
        off = self.shared.of_log_distance(about, distance, size, kept_within)
        if self.standing.height is not None:  # the floor tells the distance by the elevation
            off = min(off, float(self.shared.angle(size)) * math.hypot(*about[:2]) / max(abs(float(about[2])), 1e-9))
        more = math.hypot(spread, off)
        assert isinstance(self.standing.coarse, RangedBelief)
        first, last = np.log(self.standing.coarse.ranges[[0, -1]])
        return distance, max(spread, min(more, (last - first) / math.sqrt(12)))  # at most as before any look

    def ranged(self, ranges: np.ndarray, height: float | None) -> TargetHypotheses:
        """With positions from here on: what is known so far holds for all `ranges` ``(K,)``, metres."""
        known = None if self.known is None else self.known.ranged(ranges)
        return altered(self, standing=self.standing.ranged(ranges, height), known=known)

    def after(
        self, elapsed: float, motion: MotionModel, step: np.ndarray | None, height: float | None
    ) -> TargetHypotheses:
        """After `elapsed` seconds, in which the body has moved by `step` ``(3,)`` metres."""
        standing, moves, known = self.standing, self.moves, self.known
        if step is not None and step.any():
            standing = standing.moved(step, height)
        if standing.bank is not None:
            own = standing.bank.habits
            moved = 0.0 if step is None else float(np.linalg.norm(step))
            anew = own.renewal_probability(elapsed, moved)
            standing = standing.renewed(anew)
            moves = None if moves is None else moves.renewed(anew)
        if known is not None:
            known = known.after(max(elapsed, 0.0), step)
        kept = self
        if standing is not self.standing or moves is not self.moves or known is not self.known:
            kept = altered(self, standing=standing, moves=moves, known=known)
        if elapsed <= 0:
            return kept
        drift = self.drift
        flows = self.weights[:, None] * motion.transitions(elapsed)
        stands = self._standing_density() if len(self.wandering) and flows[1, 2:].any() else 0.0
        wandering = self.wandering.after(elapsed, motion, drift, flows, stands)
        turning = self._turned(flows, elapsed, motion, drift)
        lost = 0.0
        if drift > 0:
            sharp, standing = standing, _drifted(standing, drift, elapsed)
            if sharp.log_other_intensity is not None:  # else looks at a look-alike would regain it again and again
                lost = standing.log_mean - sharp.log_mean
        others, spread = np.concatenate([flows[:, :1], flows[:, 2:]], axis=1), standing.spread
        stays, newly = flows[1, 1], np.concatenate([flows[:1, 1], flows[2:, 1]])
        left = float(others[1].sum() / max(others.sum(), 1e-300))  # the share that stood before
        if left > 0:
            standing = standing.spreading(altered(spread, otherwise=spread.mixed(left).weights))
        if newly.sum() > stays:  # it has stopped just now
            standing = self._restarted(standing, newly)
        weights = flows.sum(axis=0)
        weights[1] *= math.exp(lost)
        weights = weights / weights.sum()
        return altered(kept, weights=weights, standing=standing, wandering=wandering, turning=turning)

    def _turned(self, flows: np.ndarray, elapsed: float, motion: MotionModel, drift: float) -> TurningTarget | None:
        """The turning target after `elapsed` seconds, with the inflow from the other hypotheses."""
        if self.turning is None:
            return None
        turned = self.turning.after(elapsed, motion.jumped(elapsed), drift)
        inflow = flows[:2, -1]
        total = float(inflow.sum() + flows[-1, -1])
        if total <= 0:
            return turned
        patches = self.standing.field.patches
        masses = self.standing.masses
        widths = np.array([patch.spacing for patch in patches]).reshape(-1, 2)
        across = np.array([patch.frame[1:] for patch in patches]).reshape(-1, 2, 3) * widths[..., None]
        covariances = np.einsum("nai,naj->nij", across, across)
        tops = np.array([patch.top for patch in patches])
        begun = float(inflow[1] / max(inflow.sum(), 1e-300))
        return turned.mixed(float(inflow.sum()) / total, tops.reshape(-1, 3), begun * masses, covariances)

    def _standing_density(self) -> np.ndarray:
        """The standing target's density over a uniform one, on the grid ``(H, W)``."""
        return self.standing.field.averaged(self.standing.log_mean)

    def _restarted(self, standing: StationaryTarget, newly: np.ndarray) -> StationaryTarget:
        """A target that has just come to stand, where it was wandering, or anywhere.

        `newly`: what flows in from the absent target, and from each wanderer.
        """
        density = newly[0] + self.wandering.mixed(newly[1 : 1 + len(self.wandering)])
        if self.turning is not None and newly[-1] > 0:
            density = density + newly[-1] * self.turning.density(self.grid.directions)
        density = np.broadcast_to(density, self.grid.shape)
        return standing.restarted(np.maximum(density / _mean(density, self.grid), _LEAST_NEW))

    def updated(
        self, scan: Scan, alarms: ClutterRate | None, passing: Measurement | None, since: np.ndarray | None
    ) -> tuple[TargetHypotheses, Measurement, ClutterRate | None]:
        """After one more look; also returns the look, and the number of false alarms after it.

        `passing`: the look before it, of whose response maps this one repeats a share; the body has moved by `since`
        from there.
        """
        standing, before, habits = self.standing, self.standing.log_mean, scan.habits
        repeated = 0.0 if passing is None else passing.scan.repeats
        if passing is not None and repeated > 0:
            standing = standing.with_response_map(passing, -repeated, since)
        look, alarms, known = self._read(scan, alarms)
        if scan.detections is not None:
            standing = standing.detecting()
        # If the body has moved, windows with ranges were already redrawn for this place.
        fresh = since is not None and bool(since.any()) and isinstance(standing.coarse, RangedBelief)
        standing = standing.opened(look).plus(look).focused(fresh)
        gains = np.zeros(len(self.weights))
        gains[1] = standing.log_mean - before
        moves, recall = self.moves, 1.0
        if habits is not None:
            moves = Bank.blank(habits, ()) if moves is None else moves.for_sensor(habits)
            recall = float(moves.recall)
        log = look.moving(recall)
        ratio = np.exp(log)
        new = ratio if repeated == 0 or passing is None else ratio * np.exp(-repeated * passing.values)
        wandering, gains[2 : 2 + len(self.wandering)] = self.wandering.updated(ratio, new)
        turning, foretold = self.turning, np.zeros(1)
        if turning is not None:
            last = None if passing is None else SphereField(self.grid, passing.values)
            turning, gains[-1], foretold = turning.updated(look.sightings(recall), last, repeated)
        spread = self._otherwise(look, foretold, recall)
        weights, moves, alike = self._weighed(gains, look, moves)
        standing = standing.judged(float(weights[1]), spread)
        kept = self.told_drift, self.shared.and_of(scan.shared)
        return TargetHypotheses(weights, standing, wandering, turning, moves, alike, known, *kept), look, alarms

    def _read(
        self, scan: Scan, alarms: ClutterRate | None
    ) -> tuple[Measurement, ClutterRate | None, LookAlikesByDrift | None]:
        """A look as likelihood ratios; the number of false alarms and the known look-alikes after it."""
        found, spread, known = scan.detections, self.standing.detecting().spread, self.known
        if found is None or scan.habits is None:
            return scan.read(None, self.standing.spread), alarms, known
        before = ClutterRate.prior(found.model) if alarms is None else alarms
        if not scan.habits.look_alikes:
            return scan.read(before.after(found.again), spread), before.after(found.again + self._caused(scan)), known
        coarse = self.standing.coarse
        ranges = coarse.ranges if isinstance(coarse, RangedBelief) else None
        if known is None:
            known = LookAlikesByDrift.prior(scan.habits, ranges, self.told_drift)
        known = known.for_sensor(scan.habits)
        heard = known.heard(scan, spread)
        density = known.density(heard)
        given, passing = before.after(density + found.again), self._passing(scan)
        their = 0.0 if self.moves is None else -math.expm1(-self.alike) * float(self.moves.alike_recall)
        shares = Shares(given.share(their * passing), given.share(density), passing)
        look = scan.read(given, spread, shares)
        moving = float(self.weights[2:].sum()) * (scan.habits.mean if self.moves is None else float(self.moves.recall))
        known = known.updated(scan, heard, given, look.shown.share, (moving + their) * passing)
        return look, before.after(density + found.again + self._caused(scan)), known

    def _weighed(
        self, gains: np.ndarray, look: Measurement, moves: Bank | None
    ) -> tuple[np.ndarray, Bank | None, float]:
        """The weights of the hypotheses after these `gains` in log likelihood; habits and `alike` of what moves."""
        log = np.log(np.maximum(self.weights, 1e-300)) + gains
        alike = 0.0
        moving = self.weights[2:]
        if moves is not None and look.world is not None and moving.sum() > 0:
            before = 0.0 if self.moves is None else float(self.moves.log_score)
            told = float(moving @ np.exp(gains[2:])) / float(moving.sum())
            moves = moves.after(look.heard(told, float(moves.recall)), np.ones(1))
            log[2:] += self.alike + float(moves.log_score) - before
            if len(moves.alike):  # it explains as well what a moving target would
                many = math.log(moves.habits.look_alikes) + float(moves.lead + log_detected(moves))
                alike = float(np.logaddexp(0.0, np.logaddexp.reduce(log[2:]) - log[0] + many))
                log[2:] -= alike
        weights = np.exp(log - log.max())
        return weights / weights.sum(), moves, alike

    def _passing(self, scan: Scan) -> np.ndarray:
        """The density of detections at each of those of a look ``(n,)`` that one moving thing causes if detected.

        Relative to that of one false alarm a look.
        """
        found, moving = scan.detections, self.weights[2:]
        assert found is not None
        if not len(found) or not moving.sum():
            return np.zeros(len(found))
        shares, spread, least = moving / moving.sum(), self.standing.spread, resolved(scan.degree)
        world = scan.world
        assert world is not None
        near = _near(self.grid, world, float(spread.scales.max()), least)
        directions = self.grid.directions.reshape(-1, 3)[near]
        density = np.zeros(len(near))
        if len(self.wandering):
            density += self.wandering.mixed(shares[: len(self.wandering)]).reshape(-1)[near]
        if self.turning is not None and shares[-1] > _UNLIKELY:
            density += shares[-1] * self.turning.density(directions)
        amounts = density * self.grid.weights[:, 0][near // self.grid.width] / (4 * math.pi)
        drawn = world.densities(directions, spread.scales, np.eye(len(found)), least)
        return found.area * (spread.otherwise @ (drawn @ amounts))

    def _otherwise(self, look: Measurement, turns: np.ndarray, recall: float) -> np.ndarray:
        """The weights of the scales ``(S,)`` if the target does not stand, after a look.

        `turns` ``(S,)``: how likely it was for each of them if the target turns.
        """
        otherwise = look.spread.otherwise
        if look.world is None or len(otherwise) == 1:
            return otherwise
        foretold = np.full(len(otherwise), self.weights[0])
        if len(self.wandering):
            roams = self.wandering.mixed(self.weights[2 : 2 + len(self.wandering)])
            told = look.fresh.gains(recall)
            foretold += told.reshape(len(foretold), -1) @ (roams * self.grid.weights / (4 * math.pi)).ravel()
        if self.turning is not None:
            foretold += self.weights[-1] * turns
        return otherwise * foretold / (otherwise @ foretold)

    def _caused(self, scan: Scan) -> np.ndarray:
        """The density ``(n,)`` of detections at each of those of a look that the target causes.

        Relative to that of one false alarm a look.
        """
        found, bank, habits = scan.detections, self.standing.bank, scan.habits
        assert found is not None
        assert habits is not None
        if not len(found) or found.model.false_alarms_per_look is not None:
            return np.zeros(len(found))
        world = scan.world
        assert world is not None
        if bank is None or not habits.same(bank.habits):  # nothing is known
            return np.full(len(found), self.presence * habits.mean)
        standing, spread = self.standing, self.standing.spread
        field, layout = standing.field, standing.field.layout
        parts = [window.habits.recall.reshape(-1) for window in standing.windows]
        mass = np.exp(np.minimum(field.logs - field.log_mean, LARGEST)) * layout.weights
        amounts = mass * np.concatenate([bank.recall[layout.outside], *parts]) * (self.presence / mass.sum())
        heard, cells = np.flatnonzero(amounts > _UNHEARD), len(layout.free)
        density = np.zeros((len(spread.scales), len(found)))
        # Between two cells a sharp detection would be heard by neither.
        for counts, least in ((heard[heard < cells], resolved(scan.degree)), (heard[heard >= cells], 0.0)):
            drawn = world.densities(layout.directions[counts], spread.scales, np.eye(len(found)), least)
            density += drawn @ amounts[counts]
        return spread.weights @ density * found.area


def _near(grid: ErpGrid, found: Detections, scale: float, least: float) -> np.ndarray:
    """The flat indices ``(m,)`` of the cells that any detection speaks for, widened by `scale`, or to `least`."""
    widths = np.maximum(scale / np.sqrt((found.axes**2).sum(axis=-1)).min(axis=-1), least)
    reach = np.cos(np.minimum(_FAR * widths, math.pi))
    return np.flatnonzero((grid.directions.reshape(-1, 3) @ found.directions.T > reach).any(axis=1))


def _is_covered(patch: Patch, field: SphereField) -> bool:
    """Whether the middle of a patch lies in one of the field's."""
    return any(other.places(patch.frame[0])[1] for other in field.patches)


def _mean(density: np.ndarray, grid: ErpGrid) -> float:
    """Over the sphere."""
    return float(np.sum(density * grid.weights)) / (4 * math.pi)


def _blurred(field: SphereField, offsets: np.ndarray | float) -> SphereField:
    """A field with patches blurred by `offsets` ``(patches,)``; where they grow over the grid, its values are kept."""
    patches = []
    for patch, offset in zip(field.patches, np.broadcast_to(offsets, len(field.patches)), strict=True):
        if offset < patch.spacing.min() / 2:  # less than the nodes can show
            patches.append(patch)
            continue
        wide = blurred(patch, offset, REACH)
        directions = wide.directions
        outside = ~patch.places(directions)[1]
        around = np.full(wide.values.shape, -np.inf)
        around[outside] = SphereField(field.grid, field.values).smooth(directions[outside], 1)
        patches.append(wide.like(np.maximum(wide.values, around)))
    if all(new is old for new, old in zip(patches, field.patches, strict=True)):
        return field  # with the layout that it has
    return altered(field, patches=tuple(patches))


def _widened(field: SphereField, spread: float) -> SphereField:
    """The density convolved with a Gaussian: about peaks in their planes, or if it is wide, by the grid's harmonics."""
    if spread < 2 * math.pi / field.grid.height:  # two cells
        return _blurred(field, spread)
    basis = RealHarmonics(field.grid.height // 2 - 1)
    wide = basis.smooth(basis.analyse(field.averaged(field.log_mean), field.grid), spread)
    return SphereField(field.grid, np.log(np.maximum(basis.synthesise(wide, field.grid), FAINTEST)))


def _drifted(standing: StationaryTarget, drift: float, elapsed: float) -> StationaryTarget:
    """With peaks widened by `elapsed` seconds of odometry drift (`drift` radians per root second).

    Scaling a log-likelihood by s scales the variance of its peak by 1 / s: P + q = P / s.
    """
    patches = standing.field.patches
    width = math.radians(8)
    if patches:
        best = max(patches, key=lambda patch: float(patch.values.max()))
        shares = np.exp(best.values - best.values.max()) * best.weights
        u, v = bent(np.linspace(-1, 1, len(best.values)), best.half, best.bend)[0]
        width = max(math.sqrt(float(np.sum(shares * ((u * u)[:, None] + v * v)) / shares.sum() / 2)), 1e-3)
    return standing.scaled(width**2 / (width**2 + drift**2 * elapsed))
