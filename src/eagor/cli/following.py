"""Feeds poses and looks to the tracker (and other methods); one result per frame."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from eagor.cli.locate import as_angles, degrees, mode_as_json
from eagor.cli.looking import ShapeError, is_input_fault, is_whole, look_if_recorded, read_frame
from eagor.cli.poses import Step
from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.perception import Perception
from eagor.tasks.methods import NAMES, Method, make_method
from eagor.tracking import Estimate, TrackerConfig
from eagor.tracking.tracker import DirectionTracker

RIVALS = tuple(name for name in NAMES if name != "eagor")  # in the order of the columns


@dataclass(frozen=True, eq=False)
class Result:
    """The result of one frame.

    `problem` says why the frame could not be used, if so; `evidence` has several items for several views; `others` are
    the other methods' directions ``(3,)`` by name, None before their first.
    """

    image: Path
    stamp: float
    estimate: Estimate
    panorama: np.ndarray | None
    evidence: tuple[Evidence, ...]
    problem: str | None
    others: dict[str, np.ndarray | None] = field(default_factory=dict)

    @property
    def distance(self) -> float | None:
        """Metres; None without positions or while searching."""
        return None if self.estimate.status == "searching" else self.estimate.distance

    @property
    def distance_spread(self) -> float | None:
        """Standard deviation of the logarithm of the distance: large until the camera has moved; None as `distance`."""
        return None if self.distance is None else self.estimate.distance_spread

    def as_json(self) -> dict[str, Any]:
        """This frame for ``--json`` and for .jsonl files."""
        e, distance, spread = self.estimate, self.distance, self.distance_spread
        entry: dict[str, Any] = {
            "frame": self.image.name,
            "stamp": self.stamp,
            "azimuth_deg": degrees(e.azimuth),
            "elevation_deg": degrees(e.elevation),
            "credible_angle_deg": None if e.direction is None else degrees(e.credible_angle),
            "presence": round(e.presence, 6),
            "distance_m": None if distance is None else round(distance, 4),
            "distance_spread": None if spread is None else round(spread, 4),
            "status": e.status,
            "held": e.held,
            "modes": [mode_as_json(mode) for mode in e.modes],
            "looks": len(self.evidence),
        }
        if self.problem is not None:
            entry["problem"] = self.problem
        if self.others:
            entry["methods"] = {name: as_angles(direction) for name, direction in self.others.items()}
        return entry


def follow(
    steps: Sequence[Step],
    perception: Perception,
    query: str,
    config: TrackerConfig,
    rivals: Mapping[str, Method],
    force: bool = False,
) -> Iterator[Result]:
    """One result per image, in order of time, with the directions of the `rivals` (`make_rivals`).

    An image that cannot be used gives a result with a problem; the poses carry the belief over it. Raises `EagorError`
    if no other frame could do better: a query without meaning, or a first image that is not 2:1 (unless `force`).
    """
    tracker = DirectionTracker(config)
    poses, fed, warned = [step.pose for step in steps], 0, False
    frames = [step.pose.stamp for step in steps if step.image is not None]
    for index, step in enumerate(steps):
        # One pose ahead, so that a replay record from shortly after this frame gets the pose of its own time.
        while fed < min(index + 2, len(poses)):
            tracker.add_pose(poses[fed].stamp, poses[fed].world_R_body, poses[fed].position)
            fed += 1
        if step.image is None:
            continue
        stamp, now = step.pose.stamp, step.pose.stamp
        panorama, problem = None, None
        looks: tuple[Evidence, ...] = ()
        try:
            panorama = read_frame(step.image, force, warn=not warned)
            warned = warned or not is_whole(panorama)
            looks = _own(look_if_recorded(perception, panorama, query, stamp, step.pose.world_R_body), stamp, frames)
        except EagorError as error:
            if is_input_fault(error) or (isinstance(error, ShapeError) and stamp == frames[0]):
                raise
            problem = str(error)
        for evidence in looks:
            placed = _within(evidence, poses[0].stamp, poses[fed - 1].stamp)
            tracker.observe(placed)
            now = now if placed.stamp is None else max(now, float(placed.stamp))
        for method in rivals.values():
            method.move(stamp, step.pose.world_R_body, step.pose.position)
            for evidence in looks:
                method.see(replace(evidence, stamp=stamp))
        yield Result(
            image=step.image,
            stamp=stamp,
            estimate=tracker.estimate(now),
            panorama=panorama,
            evidence=looks,
            problem=problem,
            others={name: method.direction() for name, method in rivals.items()},
        )


def make_rivals(perception: str) -> dict[str, Method]:
    """Every other method by name, with its settings for `perception`."""
    return {name: make_method(name, np.random.default_rng(0), perception) for name in RIVALS}


def _own(looks: Sequence[Evidence], stamp: float, frames: Sequence[float]) -> tuple[Evidence, ...]:
    """Those of `looks` for which the frame at `stamp` is the nearest of the `frames` (sorted times).

    Frames closer together than a replay's tolerance find the same line, which is evidence only once.
    """

    def nearest(look: Evidence) -> float:
        at = stamp if look.stamp is None else float(look.stamp)
        place = bisect_left(frames, at)
        return min(frames[max(place - 1, 0) : place + 1], key=lambda frame: abs(frame - at))

    return tuple(look for look in looks if nearest(look) == stamp)


def _within(evidence: Evidence, first: float, last: float) -> Evidence:
    """The evidence with its stamp clipped to the known poses (a replay may be off by its tolerance)."""
    stamp = evidence.stamp
    return evidence if stamp is None else replace(evidence, stamp=min(max(stamp, first), last))
