"""Look once, ask often: all that a detector saw in footage, with the poses, in one file that answers any query.

The file is a replay file (docs/replay-format.md): a first line about the footage, then a line for each look, with the
pose of the camera and all boxes of all views, and a line for each pose between the looks. `looked_at` makes them;
`recorded_frames` gives poses and looks back as footage without pictures, which `eagor.perception.footage.follow`
follows as it follows any; `things_seen` lists what there is.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from eagor.conventions import wxyz_from_rotation
from eagor.errors import EagorError, FormatError, PoseError, QueryError
from eagor.evidence import BodyMask, model_as_json
from eagor.grids import ErpGrid
from eagor.media.footage import ShapeError
from eagor.media.pose_files import FramePose
from eagor.media.posed_frames import PosedFrame
from eagor.perception.footage import UNSURE, HiddenParts
from eagor.perception.records import Footage
from eagor.perception.replay import ReplayPerception
from eagor.perception.views import Seen, Views
from eagor.tracking import DirectionTracker, Estimate, TrackerConfig

__all__ = ["ThingSeen", "first_line", "looked_at", "recorded_frames", "things_seen"]

PIXELS, SCORES, TURNS, METRES = 3, 6, 12, 6  # decimals that are written
NEAR = math.radians(15)  # the error that still leads a person to the thing


# --- writing --------------------------------------------------------------------------------------------------------


def first_line(of: str, perception: str, views: Views, poses: str, begins: float = 0.0) -> str:
    """The line about the footage: what was looked at, by which perception, where its poses come from, in words."""
    about: dict[str, Any] = {"of": of, "perception": perception, "poses": poses, "begins": begins}
    about["detector"] = model_as_json(views.detector)
    if views.classes is not None:
        about["classes"] = list(views.classes)
    return json.dumps({"footage": {key: value for key, value in about.items() if value}})


def looked_at(
    frames: Iterable[PosedFrame], views: Views, queries: Sequence[str] = (), hidden: HiddenParts | None = None
) -> Iterator[tuple[PosedFrame, list[dict[str, Any]]]]:
    """Each pose, and its entries, one for each line: one for a look; without classes, one for each of `queries`.

    A frame that cannot be used has one with the reason. What is `hidden` is written as not seen. Raises `EagorError`
    as `eagor.perception.footage.follow` does.
    """
    hidden, first = hidden or HiddenParts(), True
    for frame in frames:
        at = {"stamp": float(frame.pose.stamp), "pose": _pose(frame.pose, frame.spread)}
        if frame.frame is None or not frame.looked or frame.read is None:
            yield frame, [at]
            continue
        at |= {"frame": frame.frame} | ({"lost": True} if frame.lost else {})
        try:
            picture = frame.read()
            if picture.grid is not None and picture.grid.optics is not None:
                raise ShapeError(
                    f"{frame.frame} has a lens that a file of looks cannot hold (distortion, or an axis beside the "
                    "middle); follow the footage itself: eagor track FRAMES QUERY. Of an ideal lens give --hfov"
                )
            mask = hidden.of(picture)
            if mask is not None:
                at["unseen"] = _runs(mask)
            turn = frame.pose.world_R_body
            entries = [
                at | ({} if query is None else {"query": query}) | {"views": [*map(_view, seen)]}
                for query in (queries or (None,))
                for seen in [views.seen(picture.picture, turn, query or "", picture.grid)]
            ]
        except EagorError as error:
            if isinstance(error, QueryError) or (isinstance(error, ShapeError) and first):
                raise
            entries = [at | {"problem": str(error)}]
        first = False
        yield frame, entries


def _pose(pose: FramePose, spread: float) -> dict[str, float]:
    place = () if pose.position is None else pose.position.tolist()
    found = _quaternion(pose.world_R_body) | dict(zip("xyz", (round(value, METRES) for value in place), strict=False))
    return found | ({"spread_deg": round(math.degrees(spread), TURNS)} if spread else {})


def _quaternion(turn: np.ndarray) -> dict[str, float]:
    return {
        f"q{axis}": round(value, TURNS) for axis, value in zip("wxyz", wxyz_from_rotation(turn).tolist(), strict=True)
    }


def _view(seen: Seen) -> dict[str, Any]:
    grid, (boxes, scores, labels) = seen
    image = {"projection": "perspective", "width": grid.width, "height": grid.height}
    image |= {"hfov_deg": round(math.degrees(grid.hfov), TURNS)} | _quaternion(grid.body_R_view)
    inside = np.clip(boxes, 0, [grid.width, grid.height] * 2).round(PIXELS)
    real = np.all(inside[:, 2:] > inside[:, :2], axis=1).tolist()
    found = [
        {"box": box.tolist(), "score": round(float(score), SCORES)} | ({} if label is None else {"label": label})
        for box, score, label, kept in zip(inside, scores, labels or [None] * len(inside), real, strict=True)
        if kept
    ]
    return {"image": image, "boxes": found}


def _runs(mask: BodyMask) -> dict[str, Any]:
    """A mask as the lengths of runs: seen, not seen, seen, ..., along the rows of a panorama twice as wide as high."""
    rows = mask.seen.shape[0]
    seen = mask.at(ErpGrid(rows, 2 * rows).directions).ravel()
    ends = np.flatnonzero(np.diff(seen)) + 1
    runs = np.diff(np.concatenate([[0], ends, [len(seen)]])).tolist()
    return {"rows": rows, "runs": runs if seen[0] else [0, *runs]}


# --- reading --------------------------------------------------------------------------------------------------------


def recorded_frames(replay: ReplayPerception) -> list[PosedFrame]:
    """The poses of a file, and its looks as frames that have no picture: `replay` answers for them.

    Raises `PoseError` for a look without a pose.
    """
    found: list[PosedFrame] = []
    for record in replay.records:
        pose, before = record.pose, found[-1] if found else None
        if before is not None and before.frame is not None and before.pose.stamp == record.stamp:
            continue  # a further view or query of the same moment
        if pose is None:
            raise PoseError(
                f"{replay.name} has a look at {record.stamp:g} s without a pose; wanted "
                '"pose": {"qw", "qx", "qy", "qz"} (world_R_body) in its line, as eagor look writes it. With the '
                "footage or its poses at hand: eagor track FRAMES QUERY --perception replay:FILE.jsonl"
            )
        pose = pose._replace(stamp=record.stamp)
        if record.problem is not None:
            name = record.frame or f"the frame at {record.stamp:g} s"
            found.append(PosedFrame(pose, name, partial(_refuse, record.problem), True, record.lost, record.spread))
        elif record.kind == "pose":
            found.append(PosedFrame(pose))
        else:
            name = record.frame or f"{record.stamp:.2f} s"
            found.append(PosedFrame(pose._replace(frame=name), name, None, True, record.lost, record.spread))
    return found


def _refuse(problem: str) -> Any:
    raise EagorError(problem)


def about(replay: ReplayPerception) -> Footage:
    """What the first line says. Raises `FormatError` where there is none."""
    if replay.footage is None:
        raise FormatError(
            f"{replay.name} does not begin with a line about its footage; wanted a file that eagor look wrote, or "
            '{"footage": {"of": "clip.mp4", "perception": "NAME"}} as its first line'
        )
    return replay.footage


# --- what there is --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ThingSeen:
    """What is known of one thing at the end of the footage.

    `looks`: in how many looks it was seen, of `among` since the poses were last lost; `last`: the stamp of the last.
    """

    query: str
    estimate: Estimate
    looks: int
    among: int
    last: float

    @property
    def sure(self) -> float:
        """The probability that it is here, and within 15 degrees of the answer."""
        return self.estimate.within(NEAR) if self.estimate.direction is not None else 0.0


def things_seen(
    replay: ReplayPerception,
    config: TrackerConfig,
    hidden: HiddenParts | None = None,
    done: Callable[[], object] = lambda: None,
) -> list[ThingSeen]:
    """What was seen, the surest first; `done` is called after each. Errors as those of `recorded_frames`."""
    frames = recorded_frames(replay)
    begins = max((number for number, each in enumerate(frames) if each.lost), default=0)
    frames, found = frames[begins:], []
    for query in asked_for(replay):
        thing = _thing(replay, frames, query, config, hidden or HiddenParts())
        if thing is not None:
            found.append(thing)
        done()
    return sorted(found, key=lambda each: -each.sure)


def asked_for(replay: ReplayPerception) -> list[str]:
    """What a file can be asked for, each once: the labels of what was seen, and the queries that were looked for."""
    queries = [record.query for record in replay.records if record.query is not None and record.kind != "pose"]
    return [*dict.fromkeys([*sorted(replay.labels), *queries])]


def _thing(
    replay: ReplayPerception, frames: Sequence[PosedFrame], query: str, config: TrackerConfig, hidden: HiddenParts
) -> ThingSeen | None:
    """What is known of one thing; None if it was not seen in these frames."""
    tracker, looks, among, last = DirectionTracker(config), 0, 0, -math.inf
    for frame in frames:
        pose = frame.pose
        tracker.add_pose(pose.stamp, pose.world_R_body, None if config.ranges is None else pose.position)
        if frame.frame is None or frame.read is not None:
            continue
        if frame.spread >= UNSURE:
            continue
        evidence = hidden.covered(replay.looks_near(query, pose.stamp), None)
        evidence = tuple(each.widened(frame.spread) for each in evidence)
        among += 1
        for each in evidence:
            tracker.observe(each)
        if any(each.detections is None or len(each.detections) for each in evidence):
            looks, last = looks + 1, pose.stamp
    return ThingSeen(query, tracker.estimate(frames[-1].pose.stamp), looks, among, last) if looks else None
