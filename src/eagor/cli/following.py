"""Feeds poses and looks to the tracker (and other methods); one result per frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from eagor.cli.locate import as_angles, degrees, mode_as_json
from eagor.cli.looking import ShapeError, is_input_fault
from eagor.cli.poses import Pose
from eagor.cli.steps import Step
from eagor.cli.unseen import Unseen
from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.perception import NoEvidenceError, Perception
from eagor.perception.replay import look_if_recorded
from eagor.tasks.methods import NAMES, Method, make_method
from eagor.tracking import Estimate, TrackerConfig
from eagor.tracking.tracker import DirectionTracker

T = TypeVar("T")
RIVALS = tuple(name for name in NAMES if name != "eagor")  # in the order of the columns


@dataclass(frozen=True, eq=False)
class Result:
    """The result of one frame.

    `problem` says why the frame could not be used, if so; `evidence` has several items for several views; `looked` and
    `lost` as in `Step`; `position` of the camera, if known; `others` are the other methods' directions ``(3,)`` by
    name, None before their first.
    """

    frame: str
    stamp: float
    estimate: Estimate
    panorama: np.ndarray | None
    evidence: tuple[Evidence, ...]
    problem: str | None
    looked: bool = True
    lost: bool = False
    position: np.ndarray | None = None
    others: dict[str, np.ndarray | None] = field(default_factory=dict)

    @property
    def told(self) -> bool:
        """Whether it has a line of its own: it was looked at, or could not be."""
        return self.looked or self.problem is not None

    @property
    def distance(self) -> float | None:
        """Metres; None without positions or while searching."""
        return None if self.estimate.status == "searching" else self.estimate.distance

    @property
    def distance_spread(self) -> float | None:
        """Standard deviation of the logarithm of the distance: large until the camera has moved; None as `distance`."""
        return None if self.distance is None else self.estimate.distance_spread

    def as_json(self, modes: int) -> dict[str, Any]:
        """This frame for ``--json`` and for .jsonl files, with at most so many candidates."""
        e, distance, spread = self.estimate, self.distance, self.distance_spread
        entry: dict[str, Any] = {
            "frame": self.frame,
            "stamp": self.stamp,
            "azimuth_deg": degrees(e.azimuth),
            "elevation_deg": degrees(e.elevation),
            "credible_angle_deg": None if e.direction is None else degrees(e.credible_angle),
            "presence": round(e.presence, 6),
            "distance_m": None if distance is None else round(distance, 4),
            "distance_spread": None if spread is None else round(spread, 4),
            "status": e.status,
            "modes": [mode_as_json(mode) for mode in e.modes[:modes]],
            "looks": len(self.evidence),
        }
        if self.lost:
            entry["lost"] = True
        if self.problem is not None:
            entry["problem"] = self.problem
        if self.others:
            entry["methods"] = {name: as_angles(direction) for name, direction in self.others.items()}
        return entry


def follow(
    steps: Iterable[Step],
    perception: Perception,
    query: str,
    config: TrackerConfig,
    rivals: Callable[[], Mapping[str, Method]] = dict,
    mask: Path | None = None,
) -> Iterator[Result]:
    """One result per frame, in order of time, with the directions of the `rivals`, which the function makes.

    A frame that cannot be used gives a result with a problem; the poses carry the belief over it. Where the poses are
    lost, everything starts anew. What `mask` hides, or no frame shows, says nothing. Raises `EagorError` if no other
    frame could do better: a query without meaning, or a first frame that is not 2:1, or
    to which the perception returns no evidence.
    """
    tracker, others, unseen = DirectionTracker(config), rivals(), Unseen(mask)
    before = first = fed = -math.inf
    for (poses, step), after in _with_next(_by_frame(steps)):
        stamp = step.pose.stamp
        if step.lost:
            tracker, others, first, poses = DirectionTracker(config), rivals(), -math.inf, [step.pose]
        # One pose ahead, so that a replay record from shortly after this frame gets the pose of its own time.
        ahead = [] if after is None or after[1].lost else [after[0][0]]
        for pose in [*poses, *ahead]:
            if pose.stamp > fed:
                tracker.add_pose(pose.stamp, pose.world_R_body, pose.position)
                fed, first = pose.stamp, pose.stamp if first == -math.inf else first
        upcoming = math.inf if after is None else after[1].pose.stamp
        panorama, (looks,), problem = _seen(step, perception, (query,), before, upcoming, unseen)
        now = stamp
        for evidence in looks:
            placed = _within(evidence, first, fed)
            tracker.observe(placed)
            now = now if placed.stamp is None else max(now, float(placed.stamp))
        for method in others.values():
            method.move(stamp, step.pose.world_R_body, step.pose.position)
            for evidence in looks:
                method.see(replace(evidence, stamp=stamp))
        yield Result(
            frame=step.frame or "",
            stamp=stamp,
            estimate=tracker.estimate(now),
            panorama=panorama,
            evidence=looks,
            problem=problem,
            looked=step.looked,
            lost=step.lost,
            position=step.pose.position,
            others={name: method.direction() for name, method in others.items()},
        )
        before = stamp


def look_at(
    steps: Iterable[Step], perception: Perception, queries: Sequence[str], mask: Path | None = None
) -> Iterator[tuple[Step, tuple[tuple[Evidence, ...], ...], str | None]]:
    """Each frame, the evidence for each of `queries` there, and why it could not be used, if so; raises as `follow`."""
    unseen, before = Unseen(mask), -math.inf
    for (_, step), after in _with_next(_by_frame(steps)):
        upcoming = math.inf if after is None else after[1].pose.stamp
        _, looks, problem = _seen(step, perception, queries, before, upcoming, unseen)
        yield step, looks, problem
        before = step.pose.stamp


def _seen(
    step: Step, perception: Perception, queries: Sequence[str], before: float, after: float, unseen: Unseen
) -> tuple[np.ndarray | None, tuple[tuple[Evidence, ...], ...], str | None]:
    """The panorama of a frame, the evidence for each query, and what is wrong with it.

    `before`, `after`: the stamps of its neighbours; infinite where there is none.
    """
    panorama, stamp = None, step.pose.stamp
    looks: tuple[tuple[Evidence, ...], ...] = ((),) * len(queries)
    try:
        frame = None if step.read is None else step.read()
        panorama = None if frame is None else frame.panorama
        if step.looked and frame is not None:
            turn = step.pose.world_R_body
            found = (look_if_recorded(perception, frame.panorama, query, stamp, turn) for query in queries)
            looks = tuple(unseen.covered(_own(each, before, stamp, after), frame) for each in found)
    except EagorError as error:
        if is_input_fault(error) or (isinstance(error, ShapeError | NoEvidenceError) and before == -math.inf):
            raise
        return panorama, looks, str(error)
    return panorama, looks, None


def _by_frame(steps: Iterable[Step]) -> Iterator[tuple[list[Pose], Step]]:
    """Each frame, with the poses since the frame before, its own included."""
    poses: list[Pose] = []
    for step in steps:
        poses.append(step.pose)
        if step.frame is not None:
            yield poses, step
            poses = []


def _with_next(items: Iterable[T]) -> Iterator[tuple[T, T | None]]:
    """Each item, with the one after it."""
    held: list[T] = []
    try:
        for item in items:
            if held:
                yield held.pop(), item
            held.append(item)
    except EagorError:  # the one before is whole
        for item in held:
            yield item, None
        raise
    for item in held:
        yield item, None


def make_rivals(perception: str) -> dict[str, Method]:
    """Every other method by name, with its settings for `perception`."""
    return {name: make_method(name, np.random.default_rng(0), perception) for name in RIVALS}


def _own(looks: Sequence[Evidence], before: float, stamp: float, after: float) -> tuple[Evidence, ...]:
    """Those of `looks` to which the frame at `stamp` is nearer than the frames before and after it.

    Frames closer together than a replay's tolerance find the same line, which is evidence only once.
    """

    def nearest(look: Evidence) -> float:
        at = stamp if look.stamp is None else float(look.stamp)
        return min((before, stamp, after), key=lambda frame: abs(frame - at))

    return tuple(look for look in looks if nearest(look) == stamp)


def _within(evidence: Evidence, first: float, last: float) -> Evidence:
    """The evidence with its stamp clipped to the known poses (a replay may be off by its tolerance)."""
    stamp = evidence.stamp
    return evidence if stamp is None else replace(evidence, stamp=min(max(stamp, first), last))
