"""Looks with known truth: from a replay file and a file of true directions; and labelled panoramas of apartments."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Annotated

import msgspec
import numpy as np

from eagor._checks import checked_stamp
from eagor.errors import DirectionError, EagorError, FormatError, ResponseError
from eagor.evidence import Evidence
from eagor.evidence.detections import Detections
from eagor.grids import ErpGrid
from eagor.lab.envs.episodes import EpisodeSpec
from eagor.lab.envs.places import APARTMENT, DEVELOPMENT, load_place
from eagor.lab.envs.rules import Camera
from eagor.perception.calibrated import Labelled, cap_radius
from eagor.perception.json_files import Finite, Tilt, Turn, checked, need, object_of, parsed_lines
from eagor.perception.records import words_of
from eagor.perception.replay import ReplayPerception
from eagor.sphere import checked_pose, direction, unit, world_R_body

__all__ = ["LabelledLook", "Truth", "apartment_labels", "read_truth", "replayed_looks"]

IN_VIEW = 0.5  # share v of a target's direction from which on the look counts as having looked at it


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
        targets = np.atleast_2d(np.asarray(self.targets, dtype=np.float64))
        targets = targets.reshape(-1, 3) if targets.size == 0 else targets
        if targets.ndim != 2 or targets.shape[1] != 3:
            raise DirectionError(f"targets have shape {targets.shape}; wanted (n, 3), or (0, 3) if the thing is absent")
        stamp = self.evidence.stamp if self.stamp is None else self.stamp
        pose = None if self.world_R_body is None else checked_pose(self.world_R_body)
        values = {"targets": unit(targets), "stamp": None if stamp is None else checked_stamp(stamp)}
        for name, value in (values | {"world_R_body": pose}).items():
            object.__setattr__(self, name, value)

    @property
    def detections(self) -> Detections:
        """The set of detections."""
        assert self.evidence.detections is not None
        return self.evidence.detections

    @property
    def world(self) -> np.ndarray:
        """Its `world_R_body`; the identity where that is not known."""
        return np.eye(3) if self.world_R_body is None else self.world_R_body

    @property
    def in_view(self) -> np.ndarray:
        """The targets ``(m, 3)`` in what the look covered."""
        return self.targets[self.covers(self.targets)]

    def covers(self, directions: np.ndarray) -> np.ndarray:
        """Which of the directions ``(n, 3)``, body frame, it looked at ``(n,)``."""
        return np.broadcast_to(np.asarray(self.detections.share(directions)) >= IN_VIEW, len(directions))


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
    truths: dict[tuple[float, str, str], Truth] = {}
    for truth, where in parsed_lines(path, _parsed):
        key = truth.stamp, " ".join(words_of(truth.query)), truth.group
        if key in truths:
            raise FormatError(
                f"{where}: is a second line for {truth.query!r} at {truth.stamp:g} s; wanted all targets in one"
            )
        truths[key] = truth
    if not truths:
        raise FormatError(f"{os.fspath(path)} holds no true directions; wanted one JSON object per line, at least one")
    return tuple(sorted(truths.values(), key=lambda each: each.stamp))


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
    time. Raises `QueryError` where no label fits a query that has targets, `ResponseError` for response maps.
    """
    present = {truth.query for truth in truths if len(truth.targets)}
    pairs: list[tuple[float, float, Truth, Evidence]] = []
    for truth in truths:
        # What is never there may have no label either: the detector looked and saw none.
        if views := replay.looks_near(truth.query, truth.stamp, strict=truth.query in present):
            stamp = float(views[0].stamp or 0.0)
            pairs.append((abs(stamp - truth.stamp), stamp, truth, _joined(views)))
    nearest: dict[tuple[str, float], tuple[Truth, LabelledLook]] = {}
    for _, stamp, truth, evidence in sorted(pairs, key=lambda pair: pair[0]):
        if (key := (truth.group, stamp)) not in nearest:
            at = (None, None) if pose is None else pose(stamp)
            nearest[key] = truth, LabelledLook(evidence, truth.targets, None, truth.group, *at)
    used = dict(nearest.values())
    return [used[truth] for truth in truths if truth in used], [truth for truth in truths if truth not in used]


def _joined(views: Sequence[Evidence]) -> Evidence:
    """The views of one moment as one look."""
    sets = [view.detections for view in views if view.detections is not None]
    if len(sets) < len(views):  # a response map: `LabelledLook` refuses it
        return next(view for view in views if view.detections is None)
    return Evidence.from_detections(reduce(Detections.joined, sets), views[0].grid, views[0].stamp)


# --- labelled panoramas of the built-in apartments, from what the simulator knows -------------------------------------

PER_PLACE = 4  # panoramas in an apartment
TRIES = 12  # places to stand that are looked at for one panorama
SIZES = (math.radians(3), math.radians(35))  # angular radii of the things that are asked for
LOOK_ROWS = 128  # of the id panoramas that labels are measured in


def check_development(count: int, what: str, seed: int, per_place: int) -> None:
    """Raise `EagorError` unless `count` of `what`, from apartment `seed` on, stay clear of those for results."""
    last = seed + (count - 1) // per_place
    if count < 1 or seed not in DEVELOPMENT or last not in DEVELOPMENT:
        raise EagorError(
            f"{count} {what} from apartment {seed} on reach apartment {last}; wanted all between {DEVELOPMENT.start} "
            f"and {DEVELOPMENT.stop - 1}: the others are for results"
        )


def apartment_labels(count: int, seed: int, rows: int) -> Iterator[Labelled]:
    """`count` panoramas of `rows` rows from development apartments, each with one thing that a query singles out.

    A panorama is left out where no thing is of a suitable size. Raises `EagorError` where the seeds reach apartments
    that results are taken from.
    """
    check_development(count, "panoramas", seed, PER_PLACE)
    specs = (EpisodeSpec("labels", APARTMENT, seed + n // PER_PLACE, n % PER_PLACE, n) for n in range(count))
    return (label for spec in specs if (label := _labelled(spec, rows)) is not None)


def _labelled(spec: EpisodeSpec, rows: int) -> Labelled | None:
    camera, grid, rng = Camera(), ErpGrid(LOOK_ROWS, 2 * LOOK_ROWS), spec.rng("labels")
    place = load_place(spec.world, spec.seed, camera.radius)
    names = place.nameable()
    for _ in range(TRIES):
        position = np.array([*place.ground.sample(rng), camera.height])
        turned = world_R_body(float(rng.uniform(-math.pi, math.pi)))
        ids = place.ids(position, turned, LOOK_ROWS)
        shown = {thing: grid.weights * (ids == thing) for thing in names}
        sizes = {thing: cap_radius(float(share.sum())) for thing, share in shown.items()}
        if fit := [thing for thing, size in sizes.items() if SIZES[0] <= size <= SIZES[1]]:
            thing = int(rng.choice(fit))
            centre = unit((shown[thing][..., None] * grid.directions).sum(axis=(0, 1)))
            picture = place.renderer.panorama(position, turned, rows, range=False, ids=False).rgb
            assert picture is not None
            return Labelled(picture, str(names[thing]), centre, sizes[thing])
    return None
