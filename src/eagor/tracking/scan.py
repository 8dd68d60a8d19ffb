"""A look as a tracker uses it: all evidence of one moment, in world axes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from eagor._arrays import to_numpy
from eagor._values import altered, lazy
from eagor.belief.bank import Bank, Shown, linear, mixed
from eagor.belief.field import SphereField
from eagor.evidence import Evidence
from eagor.evidence.coverage import confine
from eagor.evidence.detections import Detections, resolved
from eagor.evidence.detector import STATED, ClutterRate, Habits, Spread
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import decoding_grid, neighbours, refine

SIGHTINGS = 4  # of a response map


@dataclass(frozen=True, eq=False)
class SharedError:
    """The errors that looks have in common: no number of looks averages them out.

    `variance`: radians squared per axis, the mean over the `looks` that showed anything; `of_size`: what the square of
    half a thing's size adds to it. Where the camera walks, the view changes, and a new view errs anew: `place`
    ``(3,)``, metres, is the mean of where the looks were taken, `scatter` ``(3, 3)`` the sum of squares about it,
    `last` where the newest was taken, and `way` the metres from look to look.
    """

    variance: float = 0.0
    of_size: float = 0.0
    looks: int = 0
    place: np.ndarray | None = None
    last: np.ndarray | None = None
    scatter: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    way: float = 0.0

    def and_of(self, look: SharedError) -> SharedError:
        """With those of one more look; it counts if it showed anything."""
        if not look.looks or not self.looks:
            return look if look.looks else self
        count, own = self.looks + 1, 1 / (self.looks + 1)
        found = altered(
            self,
            variance=self.variance + own * (look.variance - self.variance),
            of_size=self.of_size + own * (look.of_size - self.of_size),
            looks=count,
        )
        if look.place is None:
            return found
        if self.place is None or self.last is None:  # both come with the first position
            return altered(found, place=look.place, last=look.place)
        from_mean = look.place - self.place
        return altered(
            found,
            place=self.place + own * from_mean,
            last=look.place,
            scatter=self.scatter + (1 - own) * np.outer(from_mean, from_mean),
            way=self.way + float(np.linalg.norm(look.place - self.last)),
        )

    def angle(self, half_size: np.ndarray | float = 0.0) -> np.ndarray | float:
        """Radians per axis ``(...)``, for things of these half angular sizes ``(...)``."""
        return np.sqrt(self.variance + self.of_size * np.square(half_size))

    def of_log_distance(self, direction: np.ndarray, distance: float, half_size: float, kept_within: float) -> float:
        """The error of the logarithm of a distance (metres) in a `direction` ``(3,)``.

        It is the angle over the parallax of the looks, the angle by which they were apart as seen from there. Views
        that are `kept_within` metres apart err independently.
        """
        across = np.trace(self.scatter) - direction @ self.scatter @ direction
        base = math.sqrt(max(float(across), 0.0) / max(self.looks, 1))
        views = 1 + self.way / kept_within
        return float(self.angle(half_size)) * distance / max(base * math.sqrt(views), 1e-9)


NOTHING_SHARED = SharedError()


@dataclass(frozen=True, eq=False)
class Scan:
    """All evidence of one moment, in world axes, before the number of false alarms is applied.

    Views of one moment are one look, in any order: response maps add, detections form one set. `habits`: of the
    detections; None without any. `repeats`: the share of the response maps that an immediate next look repeats.
    `shared`: the errors that it shares with other looks.
    """

    stamp: float
    position: np.ndarray | None
    world_R_body: np.ndarray
    degree: int
    detections: Detections | None
    response_map: np.ndarray | None  # coefficients of the response maps
    habits: Habits | None
    repeats: float
    shared: SharedError

    @classmethod
    def of(
        cls,
        looks: Sequence[Evidence],
        degree: int,
        stamp: float,
        world_R_body: np.ndarray,
        position: np.ndarray | None,
        pose_error: float = 0.0,
    ) -> Scan:
        """The looks of one moment, seen from `position` with this orientation; `pose_error`: of that, radians."""
        joint: Detections | None = None
        response_map: np.ndarray | None = None
        for look in looks:
            if look.detections is not None:
                joint = look.detections if joint is None else joint.joined(look.detections)
            else:
                found = to_numpy(look.coefficients(degree)).astype(np.float64)
                response_map = found if response_map is None else response_map + found
        if response_map is not None:
            response_map = RealHarmonics(degree).rotate(response_map, world_R_body)
        models = [look.detections.model for look in looks if look.detections is not None]
        habits = models[0].habits if models else None
        repeats = max((look.calibration.persistence for look in looks if look.detections is None), default=0.0)
        offset = max(look.sensor_model.offset for look in looks)
        # The area of a box that goes r to each side has the standard deviation r / sqrt(3).
        of_size = max((model.offset_of_size for model in models), default=0.0) / math.sqrt(3)
        shows = joint is None or len(joint) > 0
        shared = SharedError(offset**2 + pose_error**2, of_size**2, int(shows), position, position)
        return cls(stamp, position, world_R_body, degree, joint, response_map, habits, repeats, shared)

    @lazy
    def world(self) -> Detections | None:
        """The `detections` in world axes."""
        return None if self.detections is None else self.detections.turned(self.world_R_body)

    def read(self, alarms: ClutterRate | None, spread: Spread = STATED, shares: Shares | None = None) -> Measurement:
        """The look as likelihood ratios; `alarms` and `spread` are the detector's, with this look counted.

        `shares`: None where nothing is known that may have caused its detections.
        """
        return Measurement(self, self.world, alarms, spread, shares)


@dataclass(frozen=True, eq=False)
class Shares:
    """How much each detection ``(n,)`` says, where other causes of it are known: from 0 to 1.

    Of what stands (moving look-alikes may have caused it), and of what moves (standing ones may). `passing`: how likely
    what moves is to cause each detection, up to a factor.
    """

    standing: np.ndarray
    moving: np.ndarray
    passing: np.ndarray


@dataclass(frozen=True, eq=False)
class Sightings:
    """A likelihood ratio as a sum: a background, and a Gaussian about each detection.

    `directions` ``(n, 3)``; `amplitudes` ``(n,)``: their integrals over the sphere; `covariances` ``(n, 3, 3)``.
    `beside`: the background. `scaled` ``(S, n, 3, 3)``: the covariances at each scale of the spread.
    """

    directions: np.ndarray
    amplitudes: np.ndarray
    covariances: np.ndarray
    beside: SphereField
    scaled: np.ndarray

    def missed(self, where: np.ndarray) -> np.ndarray:
        """The background ``(n,)`` at directions ``(n, 3)``."""
        return self.beside.smooth(where, 1) if len(where) else np.zeros(0)

    @lazy
    def mean_missed(self) -> float:
        """The mean of the background over the sphere."""
        return float(np.sum(self.beside.values * self.beside.grid.weights)) / (4 * np.pi)


@dataclass(frozen=True, eq=False)
class Measurement:
    """What a `Scan` says; `world`: its detections in world axes; `shares` as for `Scan.read`."""

    scan: Scan
    world: Detections | None
    alarms: ClutterRate | None
    spread: Spread
    shares: Shares | None = None

    @property
    def grid(self) -> ErpGrid:
        """The grid of the whole sphere, world axes."""
        return decoding_grid(self.scan.degree)

    @lazy
    def values(self) -> np.ndarray:
        """The log ratios of the response maps on the grid ``(H, W)``; 0 without any."""
        if self.scan.response_map is None:
            return np.zeros(self.grid.shape)
        return RealHarmonics(self.scan.degree).synthesise(self.scan.response_map, self.grid)

    def response_map_at(self, directions: np.ndarray) -> np.ndarray:
        """The log ratios of the response maps at directions ``(..., 3)``."""
        assert self.scan.response_map is not None
        return RealHarmonics(self.scan.degree).synthesise(self.scan.response_map, directions)

    def at(self, directions: np.ndarray, least: np.ndarray | float, scales: np.ndarray) -> Shown:
        """What the detections say of directions ``(..., 3)``, widened to `least` ``(n,)`` radians.

        For each of `scales` ``(S,)`` of their spread.
        """
        assert self.world is not None
        assert self.alarms is not None
        share: np.ndarray | float = 1.0
        if self.world.views:
            share = self.world.share(directions @ self.scan.world_R_body)
        return Shown(share, *self.world.speaks(directions, scales, self.alarms, least, self._told)[:3])

    @property
    def _told(self) -> np.ndarray | float:
        """The shares of what stands; 1 if nothing else is known."""
        return 1.0 if self.shares is None else self.shares.standing

    @property
    def shown(self) -> Shown:
        """What the detections say of the cells of the grid ``(H, W)``, at the width that the degree can hold."""
        return self._drawn[0]

    @property
    def fresh(self) -> Shown:
        """The same of a moving target."""
        return self._drawn[1]

    @lazy
    def _drawn(self) -> tuple[Shown, Shown]:
        """What the detections say of the cells for a target that stands, and for one that moves."""
        assert self.world is not None
        assert self.alarms is not None
        share: np.ndarray | float = 1.0
        directions = self.grid.directions
        if self.world.views:
            share = self.world.share(directions @ self.scan.world_R_body)
        moving = None if self.shares is None else self.shares.moving
        least = resolved(self.scan.degree)
        ratio, score, size, fresh = self.world.speaks(
            directions, self.spread.scales, self.alarms, least, self._told, moving
        )
        shown = Shown(share, ratio, score, size)
        return shown, shown if moving is None else Shown(share, fresh, score, size)

    def added(self, bank: Bank) -> tuple[np.ndarray, np.ndarray]:
        """The detections' log ratio for a standing target with these habits ``(C, H, W)``: coefficients, and values."""
        assert self.scan.detections is not None
        assert self.alarms is not None
        recall, basis, degree = bank.recall, RealHarmonics(self.scan.degree), self.scan.degree
        if not self.scan.detections.views:
            drawn = np.log(mixed(self.spread.weights, self.shown.gains(recall)))
            return basis.analyse(drawn, self.grid), drawn
        # What a view shows fades to 0 inside its border, in the axes of the camera.
        turn = self.scan.world_R_body
        share, where = self.scan.detections.grid_share(degree)
        there = linear(self.grid, recall[None], self.grid.directions @ turn.T)[0]
        ratio = self.scan.detections.speaks(
            self.grid.directions, self.spread.scales, self.alarms, resolved(degree), self._told
        )[0]
        drawn = np.log(mixed(self.spread.weights, Shown(share, ratio).gains(there)))
        found = basis.analyse(drawn, self.grid)
        found = basis.rotate(found if where is None else confine(degree, found, where), turn)
        return found, basis.synthesise(found, self.grid)

    def moving(self, recall: float) -> np.ndarray:
        """The log ratio on the grid ``(H, W)`` for a moving target that looks detect with probability `recall`."""
        if self.world is None:
            return self.values
        said = self.fresh.share * (self._fresh_ratio - 1)
        return self.values + np.log1p(recall * said)

    @property
    def _fresh_ratio(self) -> np.ndarray:
        """S of a moving target ``(H, W)``."""
        ratio = self.fresh.ratio
        return mixed(self.spread.otherwise, ratio)

    def heard(self, told: float, recall: float) -> Shown:
        """What the detections say of a moving target, wherever it is.

        `told`: their mean ratio for it, if looks detect it with probability `recall`.
        """
        ratio = np.full(1, max(1 + (told - 1) / recall, 0.0))
        if self.world is None or not len(self.world) or (self.world.ratios == 1).all():
            return Shown(1.0, ratio)
        heard = np.ones(len(self.world)) if self.shares is None else self.shares.passing * self.shares.moving
        return Shown(1.0, ratio, heard @ self.world.log_ratios / max(float(heard.sum()), 1e-300))

    @lazy
    def centres(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions ``(n, 3)`` of the strongest detections, and the larger standard deviation ``(n,)`` of each."""
        if self.world is None or not len(self.world):
            return np.zeros((0, 3)), np.zeros(0)
        order = np.argsort(-self.world.ratios, kind="stable")[:8]
        widths = 1 / np.sqrt((self.world.axes[order] ** 2).sum(axis=-1)).min(axis=-1)
        return self.world.directions[order], widths

    def sightings(self, recall: float) -> Sightings:
        """The look as a sum of Gaussians: its detections, or the peaks of its response map.

        For a moving target that looks detect with probability `recall`.
        """
        if self.world is None or self.alarms is None:
            return self._peaks()
        shown = self.shown
        beside = np.broadcast_to(1 - np.asarray(shown.share) * recall, self.grid.shape)
        amplitudes = recall * self.alarms.mean_inverse_rate * self.world.area / self.world.clutter
        if self.shares is not None:
            amplitudes = amplitudes * self.shares.moving
        scales = self.spread.scales if len(self.spread.scales) > 1 else self.spread.scales[:0]
        covariances = self.world.covariances(np.array([self.spread.precision**-0.5, *scales]))
        beside_field = SphereField(self.grid, beside)
        return Sightings(self.world.directions, amplitudes, covariances[0], beside_field, covariances[1:])

    def _peaks(self) -> Sightings:
        """The peaks of the response map with positive log ratio."""
        grid, values = self.grid, self.values
        left, flat = values.reshape(-1).copy(), values.reshape(-1)
        found: list[tuple[np.ndarray, float, float]] = []
        while len(found) < SIGHTINGS and left[best := int(left.argmax())] > 0:
            centre, width = refine(grid, flat, best)
            if flat[neighbours(grid, best)].max() <= flat[best] and np.isfinite(width):
                found.append((centre, min(width, 1.0), float(np.expm1(min(flat[best], 50.0)))))
            near = grid.directions.reshape(-1, 3) @ centre > np.cos(
                min(max(2 * width, resolved(self.scan.degree)), 1.0)
            )
            left[near] = -np.inf
            left[best] = -np.inf
        directions = np.array([centre for centre, _, _ in found]).reshape(-1, 3)
        widths = np.array([width for _, width, _ in found])
        heights = np.array([height for _, _, height in found])
        across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
        beside = SphereField(grid, np.exp(np.minimum(values, 0.0)))
        covariances = across * (widths**2)[:, None, None]
        return Sightings(directions, heights * 2 * np.pi * widths**2, covariances, beside, covariances[None][:0])
