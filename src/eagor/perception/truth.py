"""The answers of an ideal or a noisy detector, computed from the instance ids that a simulator renders.

It separates the evaluation of the filter from the quality of a model: `Noise` sets the detector's error rates. Every
thing has a state (found or missed, score, displacement). From frame to frame it is kept with probability `persistence`
or drawn anew from the same distribution, so the rates per frame do not depend on `persistence`. Each look draws the
same number of random values: comparisons between methods on one seed are paired (docs/simulation.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from eagor._checks import require, whole, within
from eagor.errors import EagorError, GridError, ImageError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.grids import PatchGrid, PerspectiveGrid
from eagor.perception.vocabulary import named
from eagor.queries import Named, matching, parse_query
from eagor.sphere import check_rotation

CALIBRATION = Calibration(floor=0.2, neutral=0.1, temperature=2.0)  # fitted to moderate noise: benchmarks/fit.py
WIDEST = 0.7  # radians: square root of the sum of the variances along both axes
_FARTHEST = 3.0  # radians: a displacement of pi would have no unique direction
_KINDS = ("nothing", "found", "category", "colour")
_FOUND = 1
_WANTED_IDS = (
    "truth reads instance ids (H, 2 H), which only a simulator has: use it with `eagor bench run`, or call "
    "TruthPerception(...).episode(labels, seed) and give that the ids"
)


@dataclass(frozen=True)
class Noise:
    """Error rates of a detector; docs/simulation.md explains each. The defaults are those of an ideal detector.

    Rates are per frame, for a thing of at least the size `smallest`, and independent of `persistence`. Things wider
    than `WIDEST`, such as a floor, are never confused with the target. `spread` is in radians.

    Raises `EagorError` for numbers out of range.
    """

    miss: float = 0.0
    false_alarm: float = 0.0
    confuse_category: float = 0.0
    confuse_colour: float = 0.0
    spread: float = 0.0
    floor: float = 0.0
    persistence: float = 0.0
    smallest: float = 0.0
    weakest: float = 1.0

    def __post_init__(self) -> None:
        most = {field.name: 1.0 for field in fields(self)} | {"smallest": math.inf, "spread": math.pi / 2}
        wanted = {name: f"a number from 0 to {highest:.4g}" for name, highest in most.items()}
        wanted["spread"] += " radians (degrees in the text form)"
        require(self, {name: (within(getattr(self, name), 0, most[name]), text) for name, text in wanted.items()})

    @classmethod
    def parse(cls, text: str) -> Noise:
        """The noise from text: "ideal", "moderate" (also ""), "miss=0.1,spread=4", "ideal,miss=0.3".

        Pairs change the profile named first, or "moderate"; here `spread` is in degrees. Raises `EagorError`, which
        lists the keys, for other text.
        """
        first, *rest = [part.strip() for part in text.split(",")]
        names, changes = [field.name for field in fields(cls)], dict[str, float]()
        for pair in rest if first in ("", *PROFILES) else [first, *rest]:
            key, _, value = (part.strip() for part in pair.partition("="))
            try:
                if key in changes or key not in names:
                    raise ValueError(key)
                changes[key] = math.radians(float(value)) if key == "spread" else float(value)
            except ValueError:
                raise EagorError(
                    f"truth settings {text!r}: cannot read {pair!r}. Wanted 'ideal', 'moderate' or key=number pairs, "
                    f"separated by commas, each key once, such as 'miss=0.1,spread=4'; keys: {', '.join(names)} "
                    "(spread in degrees)"
                ) from None
        return replace(PROFILES.get(first, PROFILES["moderate"]), **changes)


PROFILES = {
    "ideal": Noise(),  # no mistakes: each matching thing at its place with score 1, response 0 elsewhere
    # A usable detector: 30 % missed, a false alarm in every fifth frame, 8 degrees of error, some confusions.
    "moderate": Noise(0.3, 0.2, 0.1, 0.02, math.radians(8), floor=0.02, persistence=0.3, smallest=0.1, weakest=0.6),
}


@dataclass(frozen=True, eq=False)
class Report:
    """One reported detection, in the body frame.

    `kind`: "found", "category" or "colour" (a confusion with a thing of the same category or colour), "false alarm".
    `thing`: its id, None for a false alarm away from all things. `covariance` ``(3, 3)``, square radians: its extent
    in the tangent plane at `direction` ``(3,)``, so that covariance @ direction = 0. `score` in [0, 1].
    """

    kind: str
    thing: int | None
    direction: np.ndarray
    covariance: np.ndarray
    score: float


class TruthPerception:
    """A detector of known quality. Make an `episode` of it for each walk through a simulated scene.

    `noise`: a `Noise` or text for `Noise.parse`. `rows`: of its patch map (default: that of a model with patches of
    28 pixels on a panorama of 504 x 1008).

    Raises `EagorError` for settings that cannot be read, `GridError` for less than one row.
    """

    def __init__(self, noise: str | Noise = "", calibration: Calibration = CALIBRATION, rows: int = 18) -> None:
        self.noise = noise if isinstance(noise, Noise) else Noise.parse(noise)
        self.calibration = calibration
        if not whole(rows, 1):
            raise GridError(f"rows = {rows!r}; wanted a whole number, 1 or more")
        self.grid = PatchGrid(rows, 2 * rows)

    def episode(self, labels: Sequence[Named], seed: int) -> TruthEpisode:
        """The detector for one episode, in which ``labels[i]`` names the instance with id i."""
        return TruthEpisode(self, labels, seed)

    def __call__(self, panorama: np.ndarray, query: str, *, stamp: float | None = None) -> Evidence:
        """Raises `ImageError`: the truth cannot be computed from an image."""
        raise ImageError(_WANTED_IDS)


class TruthEpisode:
    """The detector in one episode. It remembers its mistakes from look to look; each look is a new frame.

    The same seed, labels and sequence of looks give identical evidence.
    """

    def __init__(self, perception: TruthPerception, labels: Sequence[Named], seed: int) -> None:
        self._noise, self._grid, self._calibration = perception.noise, perception.grid, perception.calibration
        self._labels = tuple(labels)
        self._rng = np.random.default_rng(seed)
        # One row per thing, one for the false alarm, and one for its direction if it lies on no thing.
        self._luck = np.zeros((len(self._labels) + 2, 2))  # uniform in [0, 1): reported or not, and the score
        self._error = np.zeros((len(self._labels) + 2, 3))  # standard normal, world frame
        self._appeal = np.zeros(len(self._labels))  # the order in which things attract the false alarm
        self._alarm: int | None = None  # the thing that the false alarm lies on
        self._started = False

    def __call__(
        self, panorama: np.ndarray, query: str, *, stamp: float | None = None, world_R_body: np.ndarray | None = None
    ) -> Evidence:
        """The next look: evidence on the perception's patch grid, body frame.

        `panorama`: instance ids ``(H, 2 H)``, integers, in the layout of `eagor.sphere`; -1 where no ray hits.
        `query`: "[colour] category", over the categories of the labels (see `eagor.queries`). `world_R_body`: attitude
        ``(3, 3)`` of the camera. Persistent mistakes stay at their place in the world while the camera turns; without
        the attitude, at their place in the image.

        Raises `QueryError` if the query names no category of the labels, `ImageError` for any other array,
        `RotationError` if the attitude is not a rotation.
        """
        response = render_response(self.detect(panorama, query, world_R_body), self._grid, self._noise.floor)
        meant = parse_query(query, [thing.category for thing in self._labels]).category
        return named(Evidence.from_response(response, self._grid, self._calibration, stamp), query, (meant,))

    def detect(self, ids: np.ndarray, query: str, world_R_body: np.ndarray | None = None) -> list[Report]:
        """The next look as a list of reports; arguments and errors as for a call."""
        relation = self._relation(query)
        turn = np.eye(3) if world_R_body is None else np.asarray(check_rotation(world_R_body, "world_R_body"))
        flat, areas = _areas(ids, len(self._labels))
        self._advance()
        noise, patch = self._noise, math.pi / self._grid.rows
        rates = np.array([0.0, 1 - noise.miss, noise.confuse_category, noise.confuse_colour])[relation]
        seen = ramp(areas, noise.smallest * patch**2)
        reports = []
        for thing in np.flatnonzero(self._luck[:-2, 0] < rates * seen).tolist():
            centre, covariance = _moments(flat, thing)
            if relation[thing] == _FOUND or np.trace(covariance) <= WIDEST**2:
                reports.append(self._report(_KINDS[relation[thing]], thing, centre, covariance, turn))
        if self._luck[-2, 0] < noise.false_alarm:
            candidates = np.where((relation != _FOUND) & (seen > 0), self._appeal, -1.0)
            reports.append(self._false_alarm(candidates, flat, turn))
        return reports

    def _relation(self, query: str) -> np.ndarray:
        """The relation of each thing to the query, as an index of `_KINDS`."""
        asked = parse_query(query, [thing.category for thing in self._labels])
        relation = np.zeros(len(self._labels), dtype=np.intp)
        if asked.colour is not None:
            relation[[thing.category == asked.category for thing in self._labels]] = _KINDS.index("category")
            relation[[thing.colour == asked.colour for thing in self._labels]] = _KINDS.index("colour")
        relation[matching(asked, self._labels)] = _FOUND
        return relation

    def _advance(self) -> None:
        """Advance by one frame: each row is kept or drawn anew."""
        drawn = self._rng.random((len(self._luck), 4))
        error = self._rng.standard_normal(self._error.shape)
        anew = drawn[:, 0] >= self._noise.persistence if self._started else np.ones(len(drawn), dtype=bool)
        anew[-1] = anew[-2]
        self._luck[anew], self._error[anew] = drawn[anew, 1:3], error[anew]
        if anew[-2]:
            self._appeal, self._alarm = drawn[:-2, 3], None
        self._started = True

    def _false_alarm(self, candidates: np.ndarray, flat: np.ndarray, turn: np.ndarray) -> Report:
        """A report without a cause. `candidates` ``(n,)``: appeal of each thing, negative if it is no candidate."""
        order = np.argsort(-candidates)[: int((candidates >= 0).sum())].tolist()
        if self._alarm in order:  # it stays where it is
            order.insert(0, self._alarm)
        for thing in order:
            centre, covariance = _moments(flat, thing)
            if np.trace(covariance) <= WIDEST**2:
                self._alarm = thing
                return self._report("false alarm", thing, centre, covariance, turn)
        self._alarm = None
        away = turn.T @ self._error[-1]
        return self._report("false alarm", None, away / np.linalg.norm(away), np.zeros((3, 3)), turn)

    def _report(
        self, kind: str, thing: int | None, centre: np.ndarray, covariance: np.ndarray, turn: np.ndarray
    ) -> Report:
        """A report of a thing at `centre`: displaced by the error of its row, widened, with a score."""
        row, noise = -2 if kind == "false alarm" else thing, self._noise
        placed, carry = displaced(centre, turn.T @ self._error[row] * noise.spread)
        width = noise.spread**2 + (math.pi / self._grid.rows / 2) ** 2
        covariance = carry @ covariance @ carry.T + width * (np.eye(3) - np.outer(placed, placed))
        return Report(kind, thing, placed, covariance, noise.weakest + (1 - noise.weakest) * float(self._luck[row, 1]))


@lru_cache(maxsize=8)
def _pixels(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions ``(n, 3)`` and solid angles ``(n,)`` of the pixels of a panorama, row by row."""
    grid = PatchGrid(rows, 2 * rows)
    return grid.directions.reshape(-1, 3), grid.weights.reshape(-1)


def _areas(ids: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The ids in a row, checked, and the solid angle ``(count,)`` that each thing covers."""
    table = isinstance(ids, np.ndarray) and ids.dtype.kind in "iu" and ids.ndim == 2 and ids.size > 0
    if not table or ids.shape[1] != 2 * len(ids):
        what = f"shape {ids.shape}, {ids.dtype}" if isinstance(ids, np.ndarray) else type(ids).__name__
        raise ImageError(f"the panorama is not a map of ids ({what}): {_WANTED_IDS}")
    flat = ids.reshape(-1)
    if flat.min() < -1 or flat.max() >= count:
        raise ImageError(
            f"the ids run from {flat.min()} to {flat.max()}; wanted -1 (nothing) to {count - 1}, the places in the "
            f"{count} labels of this episode. Are the labels those of this scene?"
        )
    return flat, np.bincount(flat.astype(np.intp) + 1, _pixels(ids.shape[0])[1], count + 1)[1:]


def ramp(areas: np.ndarray, smallest: float) -> np.ndarray:
    """Visibility of things by solid angle: 0 up to a quarter of `smallest`, 1 from `smallest` on, smooth between."""
    if smallest == 0:
        return (areas > 0).astype(float)
    t = np.clip((areas / smallest - 0.25) / 0.75, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def _moments(flat: np.ndarray, thing: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean direction ``(3,)`` of the visible part of a thing, and its covariance ``(3, 3)`` in the tangent plane."""
    where = np.flatnonzero(flat == thing)
    directions, weights = _pixels(math.isqrt(len(flat) // 2))
    points, share = directions[where], weights[where]
    share = share / share.sum()
    centre = share @ points
    length = math.sqrt(centre @ centre)
    if length < 1e-9:  # it surrounds the camera: any direction will do
        centre, length = points[0], 1.0
    centre = centre / length
    cosine = points @ centre
    offsets = (points - cosine[:, None] * centre) * np.sqrt(_stretch(cosine))[:, None]
    return centre, (offsets * share[:, None]).T @ offsets


def _stretch(cosine: np.ndarray) -> np.ndarray:
    """(angle / sin(angle))^2: converts squared chords in the tangent plane to squared angles."""
    cosine = np.clip(cosine, -1.0, 1.0)
    return np.arccos(cosine) ** 2 / np.maximum(1 - cosine * cosine, 1e-15)


def displaced(centre: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`centre` moved by the part of `error` in its tangent plane, and the rotation ``(3, 3)`` of that move.

    The part of an isotropic error in a plane is isotropic there, with the same standard deviation per axis.
    """
    along = error - (error @ centre) * centre
    length = math.sqrt(along @ along)
    if length < 1e-12:
        return centre, np.eye(3)
    angle = min(length, _FARTHEST)
    placed = math.cos(angle) * centre + (math.sin(angle) / length) * along
    placed = placed / math.sqrt(placed @ placed)
    middle = centre + placed
    return placed, np.eye(3) - np.outer(middle, middle) / (1 + centre @ placed) + 2 * np.outer(placed, centre)


@lru_cache(maxsize=8)
def _products(grid: PatchGrid | PerspectiveGrid) -> tuple[np.ndarray, np.ndarray]:
    """Directions ``(n, 3)`` of the cells and their outer products ``(n, 9)``."""
    cells = grid.directions.reshape(-1, 3)
    return cells, (cells[:, :, None] * cells[:, None, :]).reshape(-1, 9)


def render_response(reports: list[Report], grid: PatchGrid | PerspectiveGrid, floor: float) -> np.ndarray:
    """The response ``(rows, columns)``: a Gaussian for each report, the highest where they overlap."""
    if not reports:
        return np.full(grid.shape, floor, dtype=np.float32)
    cells, products = _products(grid)
    centres = np.stack([report.direction for report in reports])
    along = centres[:, :, None] * centres[:, None, :]
    # Inverse within the tangent plane: complete the covariance along the direction, and subtract that again.
    precision = np.linalg.inv(np.stack([report.covariance for report in reports]) + along) - along
    cosine = cells @ centres.T
    squared = (products @ precision.reshape(-1, 9).T) * _stretch(cosine)
    # At the antipode the direction is undefined and the quotient above is noise: take the mean over all directions.
    squared = np.where(cosine > -0.999999, squared, 0.5 * math.pi**2 * np.trace(precision, axis1=1, axis2=2))
    scores = np.array([report.score for report in reports])
    response = (scores * np.exp(-0.5 * squared)).max(axis=1)
    return np.maximum(response, floor).astype(np.float32).reshape(grid.shape)
