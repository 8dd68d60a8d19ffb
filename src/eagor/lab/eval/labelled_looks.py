"""Looks with known truth, from a replay file and a file of true directions, as tables; panoramas of apartments."""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import Annotated

import msgspec
import numpy as np
from scipy.cluster.hierarchy import fclusterdata
from scipy.optimize import linear_sum_assignment

from eagor._checks import checked_stamp
from eagor.errors import EagorError, FormatError, ResponseError
from eagor.evidence import Evidence
from eagor.evidence.detections import Detections, tangent_frames
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid
from eagor.lab.envs.episodes import EpisodeSpec
from eagor.lab.envs.places import APARTMENT, DEVELOPMENT, load_place
from eagor.lab.envs.rules import Camera
from eagor.perception.calibrated import Labelled, cap_radius
from eagor.perception.json_files import Finite, Tilt, Turn, checked, object_of, parsed_lines
from eagor.perception.replay import ReplayPerception
from eagor.perception.vocabulary import plain
from eagor.sphere import angular_distance, checked_pose, direction, unit, world_R_body

IN_VIEW = 0.5  # share v of a target's direction from which on the look counts as having looked at it
APART = math.radians(10)  # from where it was first seen: the same thing, seen from elsewhere, is another place
FAR = 3.5  # deviations: mean distance of the detections of one place


@dataclass(frozen=True, eq=False)
class LabelledLook:
    """One look and the directions of ALL true instances of the thing, both in the body frame at capture.

    `evidence`: detections, from `Evidence.from_boxes`, `from_points`, `from_mask` or a perception; not a response map.
    `targets` ``(n, 3)``; n = 0: the thing is absent. `stamp`: seconds (default: that of the evidence). `group`: looks
    of one recording of one thing. Groups are taken to be independent of each other, looks of one group are not.

    `world_R_body` ``(3, 3)``, `position` ``(3,)`` in metres: the camera's pose. It tells what is the same place in
    other looks of the group. Where a look has no orientation, targets are the same where they have the same index, and
    nothing is known of look-alikes.

    Raises `ResponseError` without detections, `DirectionError` for targets that are none, `RotationError`.
    """

    evidence: Evidence
    targets: np.ndarray
    stamp: float | None = None
    group: str = ""
    world_R_body: np.ndarray | None = None
    position: np.ndarray | None = None

    def __post_init__(self) -> None:
        if getattr(self.evidence, "detections", None) is None:
            raise ResponseError(
                f"{type(self.evidence).__name__} without detections to count; wanted eagor.Evidence of boxes, points "
                "or masks. Response maps are read by a Calibration"
            )
        targets = unit(np.asarray(self.targets, dtype=np.float64)) if np.size(self.targets) else np.zeros((0, 3))
        stamp = self.evidence.stamp if self.stamp is None else self.stamp
        object.__setattr__(self, "targets", targets.reshape(-1, 3))
        object.__setattr__(self, "stamp", None if stamp is None else checked_stamp(stamp))
        if self.world_R_body is not None:
            object.__setattr__(self, "world_R_body", checked_pose(self.world_R_body))

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


class DetectionTable:
    """Labelled `looks` as flat tables: L looks, D detections, T targets in view, P pairs of both in one look.

    - Of looks: `areas` (covered, steradians), `segment` (`segments`). `posed`: whether all have an orientation.
    - Of detections: `look`; `directions` ``(D, 3)`` in the axes of the world, or of the body without a pose; `scores`,
      relative `clutter`; `own`: the mean variance of a box's area along its axes, 0 for points; `score_weights`: one
      over the number of detections at its place, since a score is a habit, too.
    - Of targets: `target_look`, and `place`, the same number for one thing in one segment, of `places`.
    - Of pairs: `detection`, `target`; `offsets` ``(P, 2)`` of the detection in the target's tangent plane (Lambert's);
      `home`, of `homes`, where errors are kept: the place, or without poses one for each pair.

    `revisits`: whether any place was looked at again, with poses. `base`: the model by which boxes and habits are read,
    the prior of a fit. Raises `EagorError` without looks.
    """

    def __init__(self, looks: Sequence[LabelledLook], base: DetectorModel) -> None:
        if not looks:
            raise EagorError("there are no looks with detections; wanted at least one")
        sets = [look.detections.read(base).turned(look.world) for look in looks]
        targets = [look.in_view @ look.world.T for look in looks]
        self.looks, self.base, self.segment = tuple(looks), base, segments(looks, base)
        self.posed = all(look.world_R_body is not None for look in looks)
        self.areas = np.array([each.area for each in sets])
        self.look, self.target_look = (np.repeat(np.arange(len(looks)), list(map(len, of))) for of in (sets, targets))
        self.directions, self.scores, self.clutter = (
            np.concatenate([getattr(each, name) for each in sets]) for name in ("directions", "scores", "clutter")
        )
        self.own = np.concatenate([each.own.mean(axis=1) for each in sets])
        self.place = _places(looks, self.segment, targets if self.posed else None)
        self.places = int(self.place.max(initial=-1)) + 1
        self.revisits = self.posed and len(self.place) > self.places
        spans = np.searchsorted(self.look, [self.target_look, self.target_look + 1]).T  # the detections of its look
        pairs = [(target, detection) for target, span in enumerate(spans) for detection in range(*span)]
        self.target, self.detection = np.reshape(pairs, (-1, 2)).astype(int).T
        centres, seen = np.concatenate(targets)[self.target], self.directions[self.detection]
        scale = np.sqrt(2 / np.maximum(1 + np.einsum("pi,pi->p", seen, centres), 1e-9))
        self.offsets = np.einsum("pij,pj->pi", tangent_frames(centres), seen) * scale[:, None]
        self.home = self.place[self.target] if self.posed else np.arange(len(self.target))
        self.homes = self.places if self.posed else len(self.target)
        self.score_weights = np.ones(len(self.scores))
        for members in self.clusters(self.score_weights > 0, base.spread**2 + base.spread_of_size**2 * self.own):
            self.score_weights[members] = 1 / len(members)

    def clusters(self, wanted: np.ndarray, variances: np.ndarray) -> list[np.ndarray]:
        """Indices of the `wanted` detections ``(D,)``, place by place of each segment; none without poses.

        `variances` ``(D,)``, per axis, of their errors.
        """
        found, segment = [], self.segment[self.look]
        for number in np.unique(segment[wanted]) if self.posed else ():
            members = np.flatnonzero(wanted & (segment == number))
            most, labels = FAR * math.sqrt(variances[members].mean()), np.ones(1)
            if len(members) > 1:
                labels = fclusterdata(self.directions[members], most, "distance", method="average")
            found += [members[labels == label] for label in np.unique(labels)]
        return found


def segments(looks: Sequence[LabelledLook], base: DetectorModel) -> np.ndarray:
    """A number for each look ``(L,)``, the same as long as a group's view stays the same.

    A view ends where places have lost their habits, by `kept_for` and `kept_within` of `base`.
    """
    numbers, starts = np.empty(len(looks), dtype=int), {}
    for index in np.argsort([look.stamp or 0.0 for look in looks], kind="stable"):
        look = looks[index]
        first = looks[starts.setdefault(look.group, index)]
        faded = ((look.stamp or 0.0) - (first.stamp or 0.0)) / (base.kept_for or math.inf)
        if look.position is not None and first.position is not None:
            faded += float(np.linalg.norm(look.position - first.position)) / (base.kept_within or math.inf)
        if faded > 1:
            starts[look.group] = index
        numbers[index] = starts[look.group]
    return np.unique(numbers, return_inverse=True)[1]


def _places(looks: Sequence[LabelledLook], segment: np.ndarray, targets: Sequence[np.ndarray] | None) -> np.ndarray:
    """A number for each target in view ``(T,)``, the same for one thing in one segment.

    `targets`: their directions ``(m, 3)`` of each look, in the world. The thing is what is nearest to where it first
    was, within `APART`. None, without poses: it is what has the same index.
    """
    anchors, names = defaultdict(list), []
    for index, (look, number) in enumerate(zip(looks, segment.tolist(), strict=True)):
        if targets is None:
            names += [(number, index) for index in np.flatnonzero(look.covers(look.targets))]
            continue
        known, directions = anchors[number], targets[index]
        apart = angular_distance(directions[:, None], np.reshape(known, (-1, 3)))
        pairs = dict(zip(*linear_sum_assignment(apart), strict=True))
        for row, at in enumerate(directions):
            if row not in pairs or apart[row, pairs[row]] >= APART:
                pairs[row] = len(known)
                known.append(at)
            names.append((number, pairs[row]))
    return np.unique(np.reshape(names, (-1, 2)).astype(int), axis=0, return_inverse=True)[1].ravel()


# --- labelled looks from a replay file (docs/replay-format.md) and a file of true directions --------------------------


class _Target(msgspec.Struct, forbid_unknown_fields=True):
    azimuth_deg: Turn
    elevation_deg: Tilt


class Truth(msgspec.Struct, forbid_unknown_fields=True, eq=False):
    """A line: ALL that `query` names at `stamp`, body frame; no `targets`: it is absent. `group`: which recording."""

    stamp: Finite
    query: Annotated[str, msgspec.Meta(pattern=r"[^\W_]")]
    targets: list[_Target]
    group: Annotated[str, msgspec.Meta(min_length=1)] | None = None


def read_truth(path: str | os.PathLike[str]) -> tuple[Truth, ...]:
    """The lines of a file of true directions. `FormatError` names the file and the line of a fault."""
    truths: dict[tuple[float, str, str | None], Truth] = {}
    parse = partial(checked, kind=Truth, name="a line of true directions", noted=True)
    for truth, where in parsed_lines(path, lambda line: parse(object_of(line))):
        if truths.setdefault((truth.stamp, plain(truth.query), truth.group), truth) is not truth:
            raise FormatError(
                f"{where}: is a second line for {truth.query!r} at {truth.stamp:g} s; wanted all targets in one"
            )
    if not truths:
        raise FormatError(f"{os.fspath(path)} holds no true directions; wanted one JSON object per line, at least one")
    return tuple(sorted(truths.values(), key=lambda each: each.stamp))


def replayed_looks(
    replay: ReplayPerception, truths: Sequence[Truth], pose: Callable[[float], tuple] = lambda stamp: (None, None)
) -> tuple[list[LabelledLook], list[Truth]]:
    """The looks of `replay` at the stamps of `truths`, and the truths without one.

    `pose` tells how the camera stood at a stamp: `world_R_body` and `position`, as for `LabelledLook`. A look is used
    once for each query, with the truth that is nearest in time. Raises `QueryError` where no label fits a query that
    has targets, `ResponseError` for response maps.
    """
    present = {truth.query for truth in truths if truth.targets}
    nearest: dict[tuple[str, float], tuple[Truth, Sequence[Evidence]]] = {}
    for truth in truths:
        # What is never there may have no label either: the detector looked and saw none.
        if views := replay.looks_near(truth.query, truth.stamp, strict=truth.query in present):
            stamp, group = float(views[0].stamp or 0.0), "" if truth.group is None else f"{truth.group}: "
            other, _ = nearest.setdefault((group + truth.query, stamp), (truth, views))
            if abs(truth.stamp - stamp) < abs(other.stamp - stamp):
                nearest[group + truth.query, stamp] = truth, views
    looks = []
    for (group, stamp), (truth, views) in nearest.items():
        angles = np.radians([(target.azimuth_deg, target.elevation_deg) for target in truth.targets]).reshape(-1, 2)
        look = min(views, key=lambda view: view.detections is not None)  # a response map if any: it is refused
        if look.detections is not None:
            sets = [view.detections for view in views if view.detections is not None]
            look = Evidence.from_detections(reduce(Detections.joined, sets), look.grid, stamp)
        looks.append(LabelledLook(look, direction(*angles.T).reshape(-1, 3), stamp, group, *pose(stamp)))
    used = {truth for truth, _ in nearest.values()}
    return looks, [truth for truth in truths if truth not in used]


# --- development apartments, and labelled panoramas of them from what the simulator knows -----------------------------

PER_PLACE = 4  # panoramas in an apartment
TRIES = 12  # places to stand that are looked at for one panorama
SIZES = (math.radians(3), math.radians(35))  # angular radii of the things that are asked for
LOOK_ROWS = 128  # of the id panoramas that labels are measured in


def development_specs(tasks: Sequence[str], count: int, seed: int, per_place: int) -> list[EpisodeSpec]:
    """`count` specs of the `tasks` in turn, `per_place` of each in an apartment, from apartment `seed` on.

    Raises `EagorError` where they reach apartments that results are taken from.
    """
    last = seed + (count - 1) // (per_place * len(tasks))
    if count < 1 or seed not in DEVELOPMENT or last not in DEVELOPMENT:
        raise EagorError(
            f"{count} episodes from apartment {seed} on reach apartment {last}; wanted all between {DEVELOPMENT.start} "
            f"and {DEVELOPMENT.stop - 1}: the others are for results"
        )
    numbers = (divmod(number, len(tasks)) for number in range(count))
    return [EpisodeSpec(tasks[task], APARTMENT, seed + n // per_place, n % per_place, n) for n, task in numbers]


def apartment_labels(count: int, seed: int, rows: int) -> Iterator[Labelled]:
    """`count` panoramas of `rows` rows from `development_specs`, each with one thing that a query singles out.

    A panorama is left out where no thing is of a suitable size.
    """
    specs = development_specs(("labels",), count, seed, PER_PLACE)
    return filter(None, (_apartment_label(spec, rows) for spec in specs))


def _apartment_label(spec: EpisodeSpec, rows: int) -> Labelled | None:
    camera, grid = Camera(), ErpGrid(LOOK_ROWS, 2 * LOOK_ROWS)
    rng, place = spec.rng("labels"), load_place(spec.world, spec.seed, camera.radius)
    names = place.nameable()
    for _ in range(TRIES):
        position = np.array([*place.ground.sample(rng), camera.height])
        turned = world_R_body(float(rng.uniform(-math.pi, math.pi)))
        ids = place.ids(position, turned, LOOK_ROWS)
        sizes = {thing: cap_radius(float(grid.weights[ids == thing].sum())) for thing in names}
        if fit := [thing for thing, size in sizes.items() if SIZES[0] <= size <= SIZES[1]]:
            thing = int(rng.choice(fit))
            centre = unit(((grid.weights * (ids == thing))[..., None] * grid.directions).sum(axis=(0, 1)))
            picture = place.renderer.panorama(position, turned, rows, range=False, ids=False).rgb
            assert picture is not None
            return Labelled(picture, str(names[thing]), centre, sizes[thing])
    return None
