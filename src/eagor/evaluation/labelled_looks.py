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
from eagor.errors import DirectionError, EagorError, ResponseError
from eagor.evidence import Evidence
from eagor.evidence.detections import Detections, bump_norms, tangent_frames
from eagor.evidence.detector import DetectorModel
from eagor.sphere import unit

__all__ = ["Assigned", "LabelledLook", "Rows", "rows_of"]

IN_VIEW = 0.5  # share v of a target's direction from which on the look counts as having looked at it
ROUNDS, SETTLED = 100, 1e-6  # of belief propagation: most rounds, and the change of a message at which it ends
LEAST = 1e-300  # a likelihood below it is rounded zero


@dataclass(frozen=True, eq=False)
class LabelledLook:
    """One look and the directions of ALL true instances of the thing, both in the body frame at capture.

    `evidence`: detections, from `Evidence.from_boxes`, `from_points`, `from_mask` or a perception; not a response map.
    `targets` ``(n, 3)``; n = 0: the thing is absent. `stamp`: seconds (default: that of the evidence). `group`: looks
    of one recording of one thing. Groups are taken to be independent of each other, looks of one group are not.

    Raises `ResponseError` for a response map, `DirectionError` for targets of another shape.
    """

    evidence: Evidence
    targets: np.ndarray
    stamp: float | None = None
    group: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.evidence, Evidence):
            raise ResponseError(f"evidence is a {type(self.evidence).__name__}; wanted eagor.Evidence of detections")
        if self.evidence.detections is None:
            raise ResponseError(
                "a response map has no detections to count; wanted boxes, points or masks. Response maps are read by a "
                "Calibration (docs/how-to/detector.md)"
            )
        targets = np.asarray(self.targets, dtype=np.float64)
        targets = np.zeros((0, 3)) if targets.size == 0 else targets
        targets = targets[None] if targets.ndim == 1 else targets
        if targets.ndim != 2 or targets.shape[1] != 3:
            raise DirectionError(f"targets have shape {targets.shape}; wanted (n, 3), or (0, 3) if the thing is absent")
        stamp = self.evidence.stamp if self.stamp is None else self.stamp
        object.__setattr__(self, "targets", unit(targets) if len(targets) else targets)
        object.__setattr__(self, "stamp", None if stamp is None else checked_stamp(stamp))

    @property
    def detections(self) -> Detections:
        """The set of detections."""
        assert self.evidence.detections is not None
        return self.evidence.detections

    @property
    def in_view(self) -> np.ndarray:
        """The targets ``(m, 3)`` in what the look covered."""
        if not len(self.targets):
            return self.targets
        return self.targets[np.broadcast_to(self.detections.share(self.targets) >= IN_VIEW, len(self.targets))]


@dataclass(frozen=True, eq=False)
class Rows:
    """Labelled looks as flat tables: L looks, D detections, T targets in view, P pairs of both in one look.

    `look_of_detection` ``(D,)``, `look_of_target` ``(T,)``; `detection` ``(P,)``, `target` ``(P,)``. `areas` ``(L,)``:
    what each look covered, steradians. `scores`, `clutter` ``(D,)``; `own` ``(D, 2)``: variances of each detection
    along its axes before the model's spread is added, such as a box's size. `squares` ``(P, 2)``: squared offsets along
    these axes, in Lambert's plane; `offsets` ``(P, 2)``: to the left and up, in the target's tangent plane.
    """

    count: int
    areas: np.ndarray
    look_of_detection: np.ndarray
    look_of_target: np.ndarray
    scores: np.ndarray
    clutter: np.ndarray
    own: np.ndarray
    detection: np.ndarray
    target: np.ndarray
    squares: np.ndarray
    offsets: np.ndarray

    def log_densities(self, spread: float) -> np.ndarray:
        """log g(z | w) ``(P,)``, per steradian, with this spread (radians)."""
        lengths = (self.own + spread**2) ** -0.5
        norms = np.log(bump_norms(lengths))
        return norms[self.detection] - 0.5 * np.einsum("pi,pi->p", self.squares, lengths[self.detection] ** 2)

    def assigned(self, recall: float, alarms: float, spread: float, log_ratios: np.ndarray) -> Assigned:
        """Which detections are of which targets, for these rates and this spread; `log_ratios` ``(D,)`` of scores."""
        areas = self.areas[self.look_of_detection]
        odds = math.log(recall / (1 - recall)) + log_ratios - np.log(alarms * self.clutter / areas)
        pairs = np.exp(
            np.clip(odds[self.detection] + self.log_densities(spread), math.log(LEAST), -math.log(LEAST) / 4)
        )
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

    def log_likelihoods(self, recall: float, alarms: float) -> np.ndarray:
        """Log likelihood of each look's detections ``(L,)``, up to what depends neither on the rates nor the spread."""
        rows = self.rows
        targets = np.bincount(rows.look_of_target, minlength=rows.count)
        detections = np.bincount(rows.look_of_detection, minlength=rows.count)
        return self.logs + targets * math.log(1 - recall) + detections * math.log(alarms) - alarms


def rows_of(looks: Sequence[LabelledLook], base: DetectorModel) -> Rows:
    """The looks as tables; `base` gives the relative clutter. Raises `EagorError` without looks."""
    if not looks:
        raise EagorError("there are no labelled looks; wanted at least one, with the targets' true directions")
    read = [look.detections.read(base) for look in looks]
    seen = [look.in_view for look in looks]
    counts, targets = [len(found) for found in read], [len(at) for at in seen]
    first_detection, first_target = np.cumsum([0, *counts]), np.cumsum([0, *targets])
    detection, target, squares, offsets, own = [], [], [], [], []
    for number, (found, at) in enumerate(zip(read, seen, strict=True)):
        lengths = np.linalg.norm(found.axes, axis=-1)
        own.append(np.maximum(lengths**-2 - base.spread**2, 0.0))
        axes = found.axes / lengths[..., None]
        near = np.maximum(1 + at @ found.directions.T, 1e-9)
        squares.append((2 * np.einsum("nij,mj->mni", axes, at) ** 2 / near[..., None]).reshape(-1, 2))
        offsets.append(np.einsum("mij,nj->mni", tangent_frames(at), found.directions).reshape(-1, 2))
        detection.append(np.tile(first_detection[number] + np.arange(len(found)), len(at)))
        target.append(np.repeat(first_target[number] + np.arange(len(at)), len(found)))
    every = np.arange(len(looks))
    return Rows(
        len(looks),
        np.array([found.area for found in read]),
        np.repeat(every, counts),
        np.repeat(every, targets),
        np.concatenate([found.scores for found in read]),
        np.concatenate([found.clutter for found in read]),
        np.concatenate(own),
        np.concatenate(detection).astype(int),
        np.concatenate(target).astype(int),
        np.concatenate(squares),
        np.concatenate(offsets),
    )


def sums(groups: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """The sum of the `values` ``(n,)`` of each of `count` groups."""
    return np.bincount(groups, values, count).astype(np.float64)


def _others(values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """For each of `values` ``(P,)`` the sum of the others of its group."""
    return np.maximum(sums(groups, values, 0)[groups] - values, 0.0)
