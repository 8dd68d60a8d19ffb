"""Looks with known truth, and which of their detections are of a target.

Detections and targets are assigned by the likelihood of the measurement model itself (`eagor.evidence.detector`): each
target causes at most one detection, and what no target caused is a false alarm. The probabilities of the assignments
come from belief propagation (Williams and Lau, IEEE Transactions on Aerospace and Electronic Systems 50(4), 2014). It
is exact for one target in a look.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np

from eagor._checks import checked_stamp
from eagor._values import lazy
from eagor.errors import DirectionError, EagorError, FormatError, ResponseError
from eagor.evidence import Evidence
from eagor.evidence.detections import Detections, bump_norms, tangent_frames
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid
from eagor.perception.calibrated import Labelled, cap_radius
from eagor.perception.json_files import Finite, Tilt, Turn, checked, need, object_of, parsed_lines
from eagor.perception.records import words_of
from eagor.perception.replay import ReplayPerception
from eagor.sphere import angular_distance, check_rotation, direction, unit, world_R_body
from eagor.tasks.episodes import Slot
from eagor.tasks.places import APARTMENT, DEVELOPMENT, Place, load_place
from eagor.tasks.rules import Camera

__all__ = [
    "Assigned", "LabelledLook", "Rows", "Truth", "joined", "read_truth", "replayed_looks", "rows_of", "stretches",
]  # fmt: skip

IN_VIEW = 0.5  # share v of a target's direction from which on the look counts as having looked at it
ROUNDS, SETTLED = 100, 1e-6  # of belief propagation: most rounds, and the change of a message at which it ends
LEAST = 1e-300  # a likelihood below it is rounded zero
APART = math.radians(10)  # from where it was first seen: the same thing, seen from elsewhere, is another place


@dataclass(frozen=True, eq=False)
class LabelledLook:
    """One look and the directions of ALL true instances of the thing, both in the body frame at capture.

    `evidence`: detections, from `Evidence.from_boxes`, `from_points`, `from_mask` or a perception; not a response map.
    `targets` ``(n, 3)``; n = 0: the thing is absent. `stamp`: seconds (default: that of the evidence). `group`: looks
    of one recording of one thing. Groups are taken to be independent of each other, looks of one group are not.

    `world_R_body` ``(3, 3)``, `position` ``(3,)`` in metres: the camera's pose. It tells what is the same place in
    other looks of the group. Without an orientation, targets are the same where they have the same index, and nothing
    is known of look-alikes.

    Raises `ResponseError` for a response map, `DirectionError` for targets of another shape, `RotationError`.
    """

    evidence: Evidence
    targets: np.ndarray
    stamp: float | None = None
    group: str = ""
    world_R_body: np.ndarray | None = None
    position: np.ndarray | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.evidence, Evidence):
            raise ResponseError(f"evidence is a {type(self.evidence).__name__}; wanted eagor.Evidence of detections")
        if self.evidence.detections is None:
            raise ResponseError(
                "a response map has no detections to count; wanted boxes, points or masks. Response maps are read by a "
                "Calibration (docs/how-to/detector-errors.md)"
            )
        targets = np.asarray(self.targets, dtype=np.float64)
        targets = np.zeros((0, 3)) if targets.size == 0 else targets
        targets = targets[None] if targets.ndim == 1 else targets
        if targets.ndim != 2 or targets.shape[1] != 3:
            raise DirectionError(f"targets have shape {targets.shape}; wanted (n, 3), or (0, 3) if the thing is absent")
        stamp = self.evidence.stamp if self.stamp is None else self.stamp
        if self.world_R_body is not None:
            check_rotation(np.asarray(self.world_R_body, dtype=np.float64), "world_R_body")
        object.__setattr__(self, "targets", unit(targets) if len(targets) else targets)
        object.__setattr__(self, "stamp", None if stamp is None else checked_stamp(stamp))

    @property
    def detections(self) -> Detections:
        """The set of detections."""
        assert self.evidence.detections is not None
        return self.evidence.detections

    @property
    def world(self) -> np.ndarray:
        """Its `world_R_body`; the identity where that is not known."""
        return np.eye(3) if self.world_R_body is None else np.asarray(self.world_R_body, dtype=np.float64)

    @property
    def in_view(self) -> np.ndarray:
        """The targets ``(m, 3)`` in what the look covered."""
        return self.targets[self.covers(self.targets)]

    def covers(self, directions: np.ndarray) -> np.ndarray:
        """Which of the directions ``(n, 3)``, body frame, it looked at ``(n,)``."""
        if not len(directions):
            return np.zeros(0, dtype=bool)
        return np.broadcast_to(np.asarray(self.detections.share(directions)) >= IN_VIEW, len(directions))


@dataclass(frozen=True)
class Deviations:
    """How far a detection lies from its thing, as the fields of `DetectorModel` say."""

    spread: float
    offset: float
    spread_of_size: float
    offset_of_size: float

    @classmethod
    def stated(cls, model: DetectorModel, spread: float | None = None) -> Deviations:
        """Those of a model; with another `spread`, where that is known better."""
        spread = model.spread if spread is None else spread
        return cls(spread, model.offset, model.spread_of_size, model.offset_of_size)

    def each(self, own: np.ndarray) -> np.ndarray:
        """The variance ``(n, 2)`` of what differs from look to look; `own` ``(n, 2)``: of the box's area."""
        return self.spread**2 + self.spread_of_size**2 * own

    def kept(self, own: np.ndarray) -> np.ndarray:
        """The variance of what a place keeps."""
        return self.offset**2 + self.offset_of_size**2 * own

    def both(self, own: np.ndarray) -> np.ndarray:
        """The variance of one detection about the thing."""
        return self.each(own) + self.kept(own)


@dataclass(frozen=True, eq=False)
class Rows:
    """Labelled `looks` as flat tables: L looks, D detections, T targets in view, P pairs of both in one look.

    `look_of_detection` ``(D,)``, `look_of_target` ``(T,)``; `detection` ``(P,)``, `target` ``(P,)``. `areas` ``(L,)``:
    what each look covered, steradians. `stretch` ``(L,)``: a number for the looks of one view (`stretches`); `place`
    ``(T,)``: one for each thing in each stretch.

    `directions` ``(D, 3)`` and unit `axes` ``(D, 2, 3)`` of the detections in the axes of the world (of the body, where
    the pose is not known), with `scores`, `clutter` ``(D,)``; `own` ``(D, 2)``: variances along these axes of a box's
    area, 0 for points. `offsets` ``(P, 2)``: of the detection from the target along these
    axes, in Lambert's plane; `turns` ``(P, 2, 2)``: the axes in the target's tangent plane.
    """

    looks: tuple[LabelledLook, ...]
    areas: np.ndarray
    stretch: np.ndarray
    look_of_detection: np.ndarray
    look_of_target: np.ndarray
    place: np.ndarray
    directions: np.ndarray
    axes: np.ndarray
    scores: np.ndarray
    clutter: np.ndarray
    own: np.ndarray
    detection: np.ndarray
    target: np.ndarray
    offsets: np.ndarray
    turns: np.ndarray

    @property
    def count(self) -> int:
        """How many looks there are."""
        return len(self.looks)

    @lazy
    def placed(self) -> np.ndarray:
        """Whether each look ``(L,)`` has a known orientation."""
        return np.array([look.world_R_body is not None for look in self.looks])

    def log_densities(self, errors: Deviations) -> np.ndarray:
        """log g(z | w) ``(P,)``, per steradian."""
        lengths = errors.both(self.own) ** -0.5
        norms = np.log(bump_norms(lengths))
        return norms[self.detection] - 0.5 * np.einsum("pi,pi->p", self.offsets**2, lengths[self.detection] ** 2)

    def assigned(
        self, recall: float | np.ndarray, alarms: float, errors: Deviations, log_ratios: np.ndarray
    ) -> Assigned:
        """Which detections are of which targets, for these rates and errors.

        `recall`: of all targets, or ``(T,)``. `log_ratios` ``(D,)``: of the scores.
        """
        areas = self.areas[self.look_of_detection]
        recalls = np.broadcast_to(recall, self.place.shape)
        odds = log_ratios - np.log(alarms * self.clutter / areas)
        found = np.log(recalls / (1 - recalls))[self.target] + odds[self.detection] + self.log_densities(errors)
        pairs = np.exp(np.clip(found, math.log(LEAST), -math.log(LEAST) / 4))
        back, there = np.ones_like(pairs), np.zeros_like(pairs)  # messages from detections to targets, and there
        for _ in range(ROUNDS):
            there = pairs / (1 + _others(pairs * back, self.target))
            before, back = back, 1 / (1 + _others(there, self.detection))
            if not len(pairs) or float(np.abs(back - before).max()) < SETTLED:
                break
        heard = pairs * back
        taken = sums(self.target, heard, len(self.look_of_target))
        shares = heard / (1 + taken[self.target])
        claimed = sums(self.detection, there, len(self.scores))
        logs = sums(self.look_of_target, np.log1p(taken), self.count)
        logs += sums(self.look_of_detection, np.log1p(claimed), self.count)
        logs -= sums(self.look_of_target[self.target], np.log1p(there * back), self.count)
        return Assigned(self, shares, logs)


@dataclass(frozen=True, eq=False)
class Assigned:
    """Probabilities `shares` ``(P,)`` that a detection is of a target.

    `logs` ``(L,)``: log of the sum over all assignments, over that of "all are false alarms, all targets are missed".
    """

    rows: Rows
    shares: np.ndarray
    logs: np.ndarray

    @property
    def right(self) -> np.ndarray:
        """The probability of each detection ``(D,)`` to be of any target."""
        return np.minimum(sums(self.rows.detection, self.shares, len(self.rows.scores)), 1.0)

    @property
    def found(self) -> np.ndarray:
        """The probability of each target ``(T,)`` to have been detected."""
        return np.minimum(sums(self.rows.target, self.shares, len(self.rows.look_of_target)), 1.0)

    def log_likelihoods(self, recall: np.ndarray, alarms: float) -> np.ndarray:
        """Log likelihood of each look's detections ``(L,)``, up to what depends neither on the rates nor the spread.

        `recall` ``(T,)``.
        """
        rows = self.rows
        missed = sums(rows.look_of_target, np.log(1 - recall), rows.count)
        detections = np.bincount(rows.look_of_detection, minlength=rows.count)
        return self.logs + missed + detections * math.log(alarms) - alarms


def rows_of(looks: Sequence[LabelledLook], base: DetectorModel) -> Rows:
    """The looks as tables; `base` gives the relative clutter. Raises `EagorError` without looks."""
    if not looks:
        raise EagorError("there are no looks with detections; wanted at least one")
    read = [look.detections.read(base).turned(look.world) for look in looks]
    seen = [look.in_view @ look.world.T for look in looks]
    counts, targets = [len(found) for found in read], [len(at) for at in seen]
    first_detection, first_target = np.cumsum([0, *counts]), np.cumsum([0, *targets])
    axes = np.concatenate([found.axes for found in read])
    axes = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    directions = np.concatenate([found.directions for found in read])
    pairs = [
        (
            first_detection[number] + np.tile(np.arange(count), many),
            first_target[number] + np.repeat(range(many), count),
        )
        for number, (count, many) in enumerate(zip(counts, targets, strict=True))
    ]
    detection, target = np.concatenate(pairs, axis=1).astype(int)
    at, every = np.concatenate(seen), np.arange(len(looks))
    stretch = stretches(looks, base)
    return Rows(
        tuple(looks), np.array([found.area for found in read]), stretch, np.repeat(every, counts),
        np.repeat(every, targets), _places(looks, stretch, seen), directions, axes,
        np.concatenate([found.scores for found in read]), np.concatenate([found.clutter for found in read]),
        np.concatenate([found.own for found in read]), detection, target,
        offsets_along(axes[detection], directions[detection], at[target]),
        np.einsum("pij,pkj->pik", axes[detection], tangent_frames(at)[target]),
    )  # fmt: skip


def offsets_along(axes: np.ndarray, directions: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """How far `directions` ``(n, 3)`` lie from `centres` ``(n, 3)`` along `axes` ``(n, 2, 3)``: ``(n, 2)``, radians.

    In Lambert's plane.
    """
    near = np.maximum(1 + np.einsum("ni,ni->n", directions, centres), 1e-9)
    return -np.einsum("nij,nj->ni", axes, centres) * np.sqrt(2 / near)[:, None]


def in_time(looks: Sequence[LabelledLook]) -> list[int]:
    """Indices of the looks by stamp; without stamps, as they came."""
    return sorted(range(len(looks)), key=lambda index: looks[index].stamp or 0.0)


def stretches(looks: Sequence[LabelledLook], base: DetectorModel) -> np.ndarray:
    """A number for each look ``(L,)``, the same as long as a group's view stays the same.

    A view ends where places have lost their habits, by `kept_for` and `kept_within` of `base`.
    """
    found, begun = np.empty(len(looks), dtype=int), {}
    for count, index in enumerate(in_time(looks)):
        look = looks[index]
        first, number = begun.get(look.group, (look, -1))
        elapsed = (look.stamp or 0.0) - (first.stamp or 0.0)
        here, there = look.position, first.position
        moved = 0.0 if here is None or there is None else float(np.linalg.norm(here - there))
        if number < 0 or elapsed / (base.kept_for or math.inf) + moved / (base.kept_within or math.inf) > 1:
            begun[look.group] = (look, count)
        found[index] = begun[look.group][1]
    return np.unique(found, return_inverse=True)[1]


def _places(looks: Sequence[LabelledLook], stretch: np.ndarray, seen: Sequence[np.ndarray]) -> np.ndarray:
    """A number for each target in view ``(T,)``, the same for one thing in one stretch.

    `seen`: their directions ``(m, 3)`` of each look. Where poses are known, the thing is what is nearest in the world
    to where it was first seen, within `APART`.
    """
    anchors: dict[int, list[np.ndarray]] = {}
    names: list[tuple[int, int]] = []
    for look, number, directions in zip(looks, stretch.tolist(), seen, strict=True):
        if look.world_R_body is None:
            names += [(number, -1 - index) for index in np.flatnonzero(look.covers(look.targets)).tolist()]
            continue
        known = anchors.setdefault(number, [])
        free = list(range(len(known)))
        for at in directions:
            apart = [float(angular_distance(known[index], at)) for index in free]
            if apart and min(apart) < APART:
                names.append((number, free.pop(int(np.argmin(apart)))))
            else:
                names.append((number, len(known)))
                known.append(at)
    numbers = {name: index for index, name in enumerate(dict.fromkeys(names))}
    return np.array([numbers[name] for name in names], dtype=int)


def sums(groups: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """The sum of the `values` ``(n,)`` of each of `count` groups."""
    return np.bincount(groups, values, count).astype(np.float64)


def _others(values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """For each of `values` ``(P,)`` the sum of the others of its group."""
    return np.maximum(sums(groups, values, 0)[groups] - values, 0.0)


# --- labelled panoramas of the built-in apartments, from what the simulator knows -------------------------------------

PER_PLACE = 4  # panoramas in an apartment
TRIES = 12  # places to stand that are looked at for one panorama
SIZES = (math.radians(3), math.radians(35))  # angular radii of the things that are asked for
LOOK_ROWS = 128  # of the id panoramas that labels are measured in


def apartment_labels(count: int, seed: int, rows: int) -> Iterator[Labelled]:
    """`count` panoramas of `rows` rows from development apartments, each with one thing that a query singles out.

    Raises `EagorError` where the seeds reach apartments that results are taken from.
    """
    last = seed + (count - 1) // PER_PLACE
    if count < 1 or seed not in DEVELOPMENT or last not in DEVELOPMENT:
        raise EagorError(
            f"{count} panoramas from apartment {seed} on reach apartment {last}; wanted all between "
            f"{DEVELOPMENT.start} and {DEVELOPMENT.stop - 1}: the others are for results"
        )
    return _labels(count, seed, rows)


def _labels(count: int, seed: int, rows: int) -> Iterator[Labelled]:
    camera, grid = Camera(), ErpGrid(LOOK_ROWS, 2 * LOOK_ROWS)
    for number in range(count):
        apartment, index = divmod(number, PER_PLACE)
        place = load_place(APARTMENT, seed + apartment, camera.radius)
        rng = Slot("labels", APARTMENT, seed + apartment, index, number).rng("labels")
        found = _one(place, grid, camera.height, rows, rng)
        if found is not None:
            yield found


def _one(place: Place, grid: ErpGrid, height: float, rows: int, rng: np.random.Generator) -> Labelled | None:
    names = place.nameable()
    for _ in range(TRIES):
        position = np.array([*place.ground.sample(rng), height])
        turned = world_R_body(float(rng.uniform(-math.pi, math.pi)))
        ids = place.ids(position, turned, LOOK_ROWS)
        shown = {thing: grid.weights * (ids == thing) for thing in names}
        sizes = {thing: cap_radius(float(share.sum())) for thing, share in shown.items()}
        fit = [thing for thing, size in sizes.items() if SIZES[0] <= size <= SIZES[1]]
        if not fit:
            continue
        thing = int(rng.choice(fit))
        centre = unit((shown[thing][..., None] * grid.directions).sum(axis=(0, 1)))
        picture = place.renderer.panorama(position, turned, rows, range=False, ids=False).rgb
        assert picture is not None
        return Labelled(picture, str(names[thing]), centre, sizes[thing])
    return None


# --- labelled looks from a replay file (docs/replay-format.md) and a file of true directions --------------------------

_TARGETS = "a list of objects with azimuth_deg and elevation_deg; [] if the thing is absent"
Pose = tuple[np.ndarray, np.ndarray | None]  # world_R_body ``(3, 3)``, and the position ``(3,)`` if it is known


@dataclass(frozen=True, eq=False)
class Truth:
    """The directions `targets` ``(n, 3)``, body frame, of all that `query` names at `stamp`; n = 0: it is absent.

    `group`: which recording of which thing (default in a file: the query).
    """

    stamp: float
    query: str
    targets: np.ndarray
    group: str


def read_truth(path: str | os.PathLike[str]) -> tuple[Truth, ...]:
    """The lines of a file of true directions. `FormatError` names the file and the line of a fault."""
    found: dict[tuple[float, str, str], Truth] = {}
    for truth, where in parsed_lines(path, _parsed):
        key = truth.stamp, " ".join(words_of(truth.query)), truth.group
        if key in found:
            raise FormatError(
                f"{where}: is a second line for {truth.query!r} at {truth.stamp:g} s; wanted all targets in one"
            )
        found[key] = truth
    if not found:
        raise FormatError(f"{os.fspath(path)} holds no true directions; wanted one JSON object per line, at least one")
    return tuple(sorted(found.values(), key=lambda each: each.stamp))


class _Target(msgspec.Struct, forbid_unknown_fields=True):
    azimuth_deg: Turn
    elevation_deg: Tilt


class _Line(msgspec.Struct, forbid_unknown_fields=True):
    stamp: Finite
    query: Annotated[str, msgspec.Meta(description="words")]
    targets: Annotated[list[_Target], msgspec.Meta(description=_TARGETS)]
    group: Annotated[str, msgspec.Meta(min_length=1, description="text, or no such key")] | None = None


def _parsed(line: bytes) -> Truth:
    entry = checked(object_of(line), _Line, "a line of true directions", noted=True)
    need(words_of(entry.query) != [], "query", entry.query, "words")
    angles = [(target.azimuth_deg, target.elevation_deg) for target in entry.targets]
    azimuths, elevations = np.radians(angles).reshape(-1, 2).T
    name = entry.query if entry.group is None else f"{entry.group}: {entry.query}"
    return Truth(entry.stamp, entry.query, direction(azimuths, elevations).reshape(-1, 3), name)


def replayed_looks(
    replay: ReplayPerception, truths: Sequence[Truth], pose: Callable[[float], Pose] | None = None
) -> tuple[list[LabelledLook], list[Truth]]:
    """The looks of `replay` at the stamps of `truths`, and the truths without one.

    `pose` tells how the camera stood at a stamp. A look is used once for each query, with the truth that is nearest in
    time. Raises `QueryError` where no label fits
    a query that has targets, `ResponseError` for response maps.
    """
    present = {truth.query for truth in truths if len(truth.targets)}
    found: dict[tuple[str, float], tuple[float, Truth, LabelledLook]] = {}
    left_out: list[Truth] = []
    for truth in truths:
        # What is never there may have no label either: the detector looked and saw none.
        looks = replay.looks_near(truth.query, truth.stamp, strict=truth.query in present)
        if not looks:
            left_out.append(truth)
            continue
        evidence = joined(looks)
        at = (None, None) if pose is None else pose(truth.stamp if evidence.stamp is None else float(evidence.stamp))
        look = LabelledLook(evidence, truth.targets, None, truth.group, *at)
        key, apart = (truth.group, float(look.stamp or 0.0)), abs(float(look.stamp or 0.0) - truth.stamp)
        before = found.get(key)
        if before is not None:
            left_out.append(truth if before[0] <= apart else before[1])
        if before is None or apart < before[0]:
            found[key] = apart, truth, look
    return [look for _, _, look in found.values()], left_out


def joined(looks: Sequence[Evidence]) -> Evidence:
    """The views of one moment as one look."""
    first, *others = looks
    if not others or any(look.detections is None for look in looks):
        return next((look for look in looks if look.detections is None), first)
    joint = first.detections
    for look in others:
        assert joint is not None
        assert look.detections is not None
        joint = joint.joined(look.detections)
    assert joint is not None
    return Evidence.from_detections(joint, first.grid, first.stamp)
