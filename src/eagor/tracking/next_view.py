"""Where to look next: what one more look of a camera that sees only a part of the sphere is expected to tell.

The measure is that of all searches (`information`): the mutual information of the outcome of the look, and
of whether the thing is present and where. A place counts by its probability and by how likely a look detects a thing
there, which earlier looks have taught (`eagor.belief.bank`): where looks were silent, a further one is likely silent
too. Known look-alikes are likely reported again, and that tells less.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial import KDTree

from eagor._arrays import frozen
from eagor._checks import above, require, within
from eagor._values import where
from eagor.cameras import Lens
from eagor.errors import GridError
from eagor.evidence.detector import ClutterRate
from eagor.grids import ErpGrid, PerspectiveGrid, ViewKey, forward_view, view_key
from eagor.sphere import azimuth_elevation, direction, world_R_body
from eagor.tracking.imm import TargetHypotheses

__all__ = ["Heights", "NextLook", "TurningCamera", "TurningRig", "best_look"]

CELLS = 2000  # of equal area: a square of 4.5 degrees each
PLACES, SAME = 200, math.radians(15)  # 14 degrees each; of a mode: within this angle a report is of the same place
STEP = math.radians(15)  # between the azimuths, and about so between the elevations, that are weighed
MARGIN = math.radians(12)  # inside the border of a view: what is nearer to it is cut off, and tells less
ALIKE = 0.97  # looks that tell this share of the most are alike: the nearest of them is taken
FIELDS = (math.radians(20) - 1e-9, math.radians(170))  # of a view: a narrower one falls between those that are weighed
RECALL, ALARM = 0.7, 0.2  # of a perception whose habits are not known: found where it is; a false report


@dataclass(frozen=True)
class Heights:
    """Where things usually are: elevations about `height` (standard deviation `tilt`, radians), seen from a camera.

    A share `elsewhere` of the probability is even over the sphere. The defaults are those of furnished rooms, as in
    `eagor.lab.tasks.hstar.agents`.
    """

    height: float = math.radians(-15)
    tilt: float = math.radians(20)
    elsewhere: float = 0.5

    def __post_init__(self) -> None:
        wanted = {
            "height": (within(self.height, -math.pi / 2, math.pi / 2), "radians from -pi/2 to pi/2"),
            "tilt": (above(self.tilt, 0), "radians above 0"),
            "elsewhere": (above(self.elsewhere, 0, 1), "a share above 0 (nowhere is a thing impossible), at most 1"),
        }
        require(self, wanted, GridError)


@dataclass(frozen=True)
class TurningCamera:
    """A camera that turns, and stands level: its fields across and down (radians), and what it can do.

    `reach`: the largest elevation, up or down, to which its axis can be tilted. `turn_rate`: radians per second; None:
    turning costs nothing, and the nearest of looks that tell as much is taken. `look_time`: seconds for a look.

    Raises `GridError` for numbers out of range.
    """

    hfov: float
    vfov: float | None = None
    reach: float = math.radians(60)
    turn_rate: float | None = None
    look_time: float = 1.0

    def __post_init__(self) -> None:
        field = "radians, from 20 to 170 degrees (given in degrees? use math.radians)"
        wanted = {
            "hfov": (within(self.hfov, *FIELDS), field),
            "vfov": (self.vfov is None or within(self.vfov, *FIELDS), field),
            "reach": (within(self.reach, 0, math.pi / 2), "radians from 0 to pi/2"),
            "turn_rate": (self.turn_rate is None or above(self.turn_rate, 0), "radians per second above 0, or None"),
            "look_time": (above(self.look_time, 0), "seconds above 0"),
        }
        require(self, wanted, GridError)

    @classmethod
    def of_view(cls, view: PerspectiveGrid) -> TurningCamera:
        """The camera that takes the pictures of a `view`; the other fields are the defaults."""
        return cls(view.hfov, 2 * math.atan(math.tan(view.hfov / 2) * view.height / view.width))

    @property
    def grid(self) -> PerspectiveGrid:
        """A view of it that looks forward; without `vfov`, its picture is 4:3."""
        across = math.tan(self.hfov / 2)
        down = across * 3 / 4 if self.vfov is None else math.tan(self.vfov / 2)
        return PerspectiveGrid(max(1, round(1000 * down / across)), 1000, self.hfov)


@dataclass(frozen=True)
class TurningRig:
    """Cameras that are fixed to a body: it turns about the vertical, and they look at the same time.

    `views`: the pixels of each, with its place on the body (``body_R_view``). They may overlap or leave gaps.
    `turn_rate`, `look_time`: as of `TurningCamera`. Raises `GridError` for numbers out of range, and without a view.
    """

    views: Sequence[PerspectiveGrid]
    turn_rate: float | None = None
    look_time: float = 1.0

    def __post_init__(self) -> None:
        if not self.views:
            raise GridError("a rig without cameras; wanted at least one view")
        for view in self.views:
            TurningCamera(view.hfov, turn_rate=self.turn_rate, look_time=self.look_time)


@dataclass(frozen=True, eq=False)
class NextLook:
    """Where to look: `direction` ``(3,)``, body frame; azimuth and elevation in radians.

    It is that of the camera's axis; of a rig, that to which the body's own x axis should turn. `tells`: what the look
    is expected to tell about presence and direction, nats. `turn`: radians from where the camera, or the body, points
    now.
    """

    direction: np.ndarray
    azimuth: float
    elevation: float
    tells: float
    turn: float

    def __repr__(self) -> str:
        turn = f"{math.degrees(self.turn):.0f}° from here"
        return f"NextLook({where(self.azimuth, self.elevation)}, {turn}, tells {self.tells:.3f} nats)"


@dataclass(frozen=True, eq=False)
class Known:
    """What is believed before a look; directions in world axes, z up.

    `mass` ``(n,)``, which sums to 1, at `directions` ``(n, 3)``: where the thing is, if it is present. `modes`
    ``(m, 3)``: the candidates.
    """

    hypotheses: TargetHypotheses
    mass: np.ndarray
    directions: np.ndarray
    modes: np.ndarray
    alarms: ClutterRate | None


@dataclass(frozen=True, eq=False)
class Views:
    """The looks that are weighed: `axes` ``(n, 3)``, world axes, and the `turns` ``(n,)`` to them, radians.

    `seen` ``(n, k)``: the cells that each shows; `shown` ``(n, k)``: how well. Shares from 0 to 1 rise from the border
    of a view as sin^2; 0 where it has fewer cells than others. `count`: of the pictures that are taken at a time.
    """

    axes: np.ndarray
    turns: np.ndarray
    seen: np.ndarray
    shown: np.ndarray
    count: int = 1


def best_look(
    known: Known, camera: TurningCamera | TurningRig, usual: Heights | None, pose: np.ndarray, axis: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """The axis ``(3,)`` of the look that tells most for its time, world axes; what it tells, nats; the turn, radians.

    `pose` ``(3, 3)``: that of the body now; `axis` ``(3,)``: that of a camera on it, body axes.
    """
    views = views_of(camera, pose, axis)
    told = tell(known, views, usual)
    worth = told if camera.turn_rate is None else told / (camera.look_time + views.turns / camera.turn_rate)
    good = np.flatnonzero(worth >= ALIKE * worth.max())
    best = int(good[np.argmin(views.turns[good])])
    return views.axes[best], float(told[best]), float(views.turns[best])


def views_of(camera: TurningCamera | TurningRig, pose: np.ndarray, axis: np.ndarray) -> Views:
    """The looks that are weighed; arguments as for `best_look`."""
    if isinstance(camera, TurningRig):
        return _views_of_rig(camera, pose)
    axes, seen, shown = _level_views(view_key(camera.grid), round(camera.reach, 6))
    return Views(axes, np.arccos(np.clip(axes @ (pose @ axis), -1.0, 1.0)), seen, shown)


def tell(known: Known, views: Views, usual: Heights | None) -> np.ndarray:
    """What a look at each of the `views` is expected to tell ``(n,)``, nats."""
    seen, shown = views.seen, views.shown
    cells, hypotheses = _cells(CELLS), known.hypotheses
    mass = np.bincount(_nearest(known.directions), known.mass, minlength=CELLS)
    if usual is not None:
        height, tilt = math.degrees(usual.height), math.degrees(usual.tilt)
        elevations = np.degrees(azimuth_elevation(cells)[1])
        mass *= even_and_usual(elevations, np.ones(CELLS), height, tilt, usual.elsewhere)
        mass /= mass.sum()
    if hypotheses.standing.bank is None:
        recall, alike, number = np.full(CELLS, RECALL), np.zeros(CELLS), ALARM
    else:
        recall, reports = hypotheses.recall(cells), hypotheses.alike_reports()
        alike = np.bincount(_cells_of(hypotheses.grid), reports.reshape(-1), minlength=CELLS)
        number = 0.0 if known.alarms is None else float(known.alarms.weights @ known.alarms.numbers)
    here = hypotheses.presence * mass[seen] * (shown > 0)
    false = views.count * number * shown / shown.sum(axis=1, keepdims=True) + alike[seen] * shown
    at = _places(known.modes)[seen]
    here, there, false = (_summed(values, at) for values in (here, here * shown * recall[seen], false))
    expected = false.sum(axis=1, keepdims=True)
    share = np.minimum(there / np.maximum(here, 1e-300), 1.0)
    alarm = -np.expm1(-expected[:, 0])
    return information(here, share, alarm, false / np.maximum(expected, 1e-300))


def _places(modes: np.ndarray) -> np.ndarray:
    """The place ``(CELLS,)`` of each cell: the nearest of the `modes` ``(m, 3)`` about it, or one of `PLACES` others.

    A report tells in which place the thing is. Finer ones would promise more: a detection of the same thing, off by as
    much as the one before, would count as news each time.
    """
    found = _nearest(_cells(CELLS), PLACES)
    if len(modes):
        cosines = _cells(CELLS) @ modes.T
        near = cosines.max(axis=1) > math.cos(SAME)
        found = np.where(near, PLACES + cosines.argmax(axis=1), found)
    return found


def _summed(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The sums of `values` ``(n, k)`` over the cells of each place ``(n, p)``."""
    count = int(places.max()) + 1
    flat = (np.arange(len(values))[:, None] * count + places).reshape(-1)
    return np.bincount(flat, values.reshape(-1), minlength=len(values) * count).reshape(len(values), count)


def _views_of_rig(rig: TurningRig, pose: np.ndarray) -> Views:
    """What all cameras of a body show together, each time that it has turned about the vertical by a `STEP`.

    `pose` ``(3, 3)``: that of the body now. A cell counts as the camera shows it that shows it best.
    """
    turns = np.arange(round(2 * math.pi / STEP)) * STEP
    turned = np.array([world_R_body(turn) @ pose for turn in map(float, turns)])
    lenses = [(replace(view.lens, body_R_lens=np.eye(3)), view.body_R_view) for view in rig.views]
    shown = np.max([[_shown(lens, each @ place) for each in turned] for lens, place in lenses], axis=0)
    away = np.abs(np.remainder(turns + math.pi, 2 * math.pi) - math.pi)
    return Views(turned[:, :, 0], away, *_packed(shown), len(lenses))


@lru_cache(maxsize=8)
def _level_views(lens: ViewKey, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The axes ``(n, 3)`` of level views with this lens, the cells in each ``(n, k)``, and how well it shows them."""
    ideal = forward_view(lens).lens
    azimuths = np.arange(round(2 * math.pi / STEP)) * STEP
    elevations = np.linspace(-reach, reach, 2 * math.ceil(reach / (2 * STEP)) + 1)  # the horizon is among them
    poses = [(float(yaw), float(pitch)) for pitch in elevations for yaw in azimuths]
    shown = np.stack([_shown(ideal, world_R_body(yaw, -pitch)) for yaw, pitch in poses])
    seen, shown = _packed(shown)
    return frozen(direction(*np.array(poses).T)), frozen(seen), frozen(shown)


def _shown(lens: Lens, world_R_view: np.ndarray) -> np.ndarray:
    """How well a lens that looks forward shows each of the cells ``(CELLS,)`` from this pose."""
    margin = min(MARGIN, float(lens.project(np.array([1.0, 0.0, 0.0]))[2]) / 2)
    depth = lens.project(_cells(CELLS) @ world_R_view)[2]
    return np.sin(np.clip(depth / margin, 0, 1) * (math.pi / 2)) ** 2


def _packed(shown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cells that are seen ``(n, k)`` and how well, of what each of n looks shows of all cells ``(n, CELLS)``."""
    most = int(np.count_nonzero(shown, axis=1).max())
    seen = np.argsort(shown == 0, axis=1, kind="stable")[:, :most]
    return seen, np.take_along_axis(shown, seen, axis=1)


@lru_cache(maxsize=2)
def _cells(count: int) -> np.ndarray:
    """The middles ``(count, 3)`` of cells of equal area: a Fibonacci lattice (Gonzalez, Math. Geosci. 42, 2010)."""
    at = np.arange(count) + 0.5
    return frozen(direction(at * (math.pi * (3 - math.sqrt(5))), np.arcsin(1 - 2 * at / count)))


@lru_cache(maxsize=2)
def _tree(count: int) -> KDTree:
    return KDTree(_cells(count))


def _nearest(directions: np.ndarray, count: int = CELLS) -> np.ndarray:
    """Which of so many cells each of the directions ``(n, 3)`` is in ``(n,)``."""
    return np.asarray(_tree(count).query(directions)[1])


@lru_cache(maxsize=4)
def _cells_of(grid: ErpGrid) -> np.ndarray:
    """The cell ``(H * W,)`` of each cell of a grid of the whole sphere."""
    return frozen(_nearest(grid.directions.reshape(-1, 3)))


def information(
    here: np.ndarray, share: np.ndarray, alarm: float | np.ndarray = 0.0, falls: np.ndarray | None = None
) -> np.ndarray:
    """Mutual information ``(n,)``, nats, of the outcome of each of n looks and the thing's cell.

    `here` ``(n, k)``: probability that the thing is in each of the k cells that a look shows; the rest is elsewhere, or
    nowhere. `share` ``(n, k)``: probability that the look reports it, if it is there. `alarm`, of all looks or
    ``(n,)``: probability of a false report where there is no true one, which falls on the cells with the probabilities
    `falls` ``(k,)`` or ``(n, k)``.

    The outcome is a report in one of the cells, or none: I = H(outcome) - sum_i p_i H(outcome | thing in cell i).
    """
    there = here * share
    reported = there.sum(axis=1, keepdims=True)
    if falls is None or not np.any(alarm):
        given = -_xlog(1 - share) - _xlog(share)
        return -_xlog(there).sum(axis=1) - _xlog(1 - reported[:, 0]) - (here * given).sum(axis=1)
    alarms = np.broadcast_to(alarm, len(here))[:, None]
    false = alarms * falls
    there = there + (1 - reported) * false
    outcome = -_xlog(there).sum(axis=1) - _xlog((1 - reported) * (1 - alarms))[:, 0]
    spread = -np.atleast_2d(_xlog(falls)).sum(axis=1)[:, None]  # entropy of a false report's place

    def without(left: np.ndarray) -> np.ndarray:
        """Entropy of the outcome without a true report, which has the probability `left`: no report, or a false one."""
        return -_xlog(left * (1 - alarms)) - _xlog(left * alarms) + left * alarms * spread

    false = (1 - share) * false  # in the cell of the true report
    given = without(1 - share) + (-_xlog(share + false) + _xlog(false))
    out = 1.0 - here.sum(axis=1)
    return outcome - (here * given).sum(axis=1) - out * without(np.ones((1, 1)))[:, 0]


def even_and_usual(
    elevations: np.ndarray, weights: np.ndarray, height: float, tilt: float, elsewhere: float
) -> np.ndarray:
    """Prior probabilities of cells ``(...)`` with these elevations (degrees) and `weights` (solid angles); sum to 1.

    A share `elsewhere` is even over the sphere. The rest has a normal density in the elevation, with the mean `height`
    and the standard deviation `tilt`, degrees. Silent looks where things usually are then move the belief to the even
    part, without any further rule.
    """
    squared = (elevations - height) ** 2
    beyond = squared - squared.min()  # so that the nearest row keeps its weight, however narrow the density is
    usual = np.exp(-0.5 * beyond / max(tilt, 1e-3) ** 2) * weights
    return (1 - elsewhere) * usual / usual.sum() + elsewhere * weights / weights.sum()


def _xlog(x: np.ndarray) -> np.ndarray:
    return x * np.log(np.maximum(x, 1e-300))
