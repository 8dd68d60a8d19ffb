"""Looks with known truth, and which of their detections are of a target.

Detections and targets are assigned by the likelihood of the measurement model itself (`eagor.evidence.detector`): each
target causes at most one detection, and what no target caused is a false alarm. The probabilities of the assignments
come from belief propagation (Williams and Lau, IEEE Transactions on Aerospace and Electronic Systems 50(4), 2014). It
is exact for one target in a look.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eagor._checks import checked_stamp
from eagor._lazy import lazy
from eagor.errors import DirectionError, EagorError, ResponseError
from eagor.evidence import Evidence
from eagor.evidence.detections import Detections, bump_norms, tangent_frames
from eagor.evidence.detector import DetectorModel
from eagor.sphere import angular_distance, check_rotation, unit

__all__ = ["Assigned", "LabelledLook", "Rows", "rows_of", "stretches"]

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


@dataclass(frozen=True, eq=False)
class Rows:
    """Labelled `looks` as flat tables: L looks, D detections, T targets in view, P pairs of both in one look.

    `look_of_detection` ``(D,)``, `look_of_target` ``(T,)``; `detection` ``(P,)``, `target` ``(P,)``. `areas` ``(L,)``:
    what each look covered, steradians. `stretch` ``(L,)``: a number for the looks of one view (`stretches`); `place`
    ``(T,)``: one for each thing in each stretch.

    `directions` ``(D, 3)`` and unit `axes` ``(D, 2, 3)`` of the detections in the axes of the world (of the body, where
    the pose is not known), with `scores`, `clutter` ``(D,)``; `own` ``(D, 2)``: variances along these axes before the
    model's spread is added, such as a box's size. `offsets` ``(P, 2)``: of the detection from the target along these
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

    def log_densities(self, spread: float) -> np.ndarray:
        """log g(z | w) ``(P,)``, per steradian, with this spread (radians)."""
        lengths = (self.own + spread**2) ** -0.5
        norms = np.log(bump_norms(lengths))
        return norms[self.detection] - 0.5 * np.einsum("pi,pi->p", self.offsets**2, lengths[self.detection] ** 2)

    def assigned(self, recall: float | np.ndarray, alarms: float, spread: float, log_ratios: np.ndarray) -> Assigned:
        """Which detections are of which targets, for these rates and this spread.

        `recall`: of all targets, or ``(T,)``. `log_ratios` ``(D,)``: of the scores.
        """
        areas = self.areas[self.look_of_detection]
        recalls = np.broadcast_to(recall, self.place.shape)
        odds = log_ratios - np.log(alarms * self.clutter / areas)
        found = np.log(recalls / (1 - recalls))[self.target] + odds[self.detection] + self.log_densities(spread)
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
    lengths = np.linalg.norm(np.concatenate([found.axes for found in read]), axis=-1)
    axes = np.concatenate([found.axes for found in read]) / lengths[..., None]
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
        tuple(looks),
        np.array([found.area for found in read]),
        stretch,
        np.repeat(every, counts),
        np.repeat(every, targets),
        _places(looks, stretch, seen),
        directions,
        axes,
        np.concatenate([found.scores for found in read]),
        np.concatenate([found.clutter for found in read]),
        np.maximum(lengths**-2 - base.spread**2, 0.0),
        detection,
        target,
        offsets_along(axes[detection], directions[detection], at[target]),
        np.einsum("pij,pkj->pik", axes[detection], tangent_frames(at)[target]),
    )


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
