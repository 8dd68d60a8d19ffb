"""Look once, ask often: what a detector sees in footage is written to a file that answers any query.

`looked_at` makes the lines of a replay file (docs/replay-format.md), a first line about the footage, then one for each
look, with the pose of the camera and all boxes of all views, and one for each pose between the looks. `RecordedLooks`
gives poses and looks back as a source without pictures; `summarise_objects` lists what there is.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eagor.conventions import wxyz_from_rotation
from eagor.errors import EagorError, FormatError, ImageError, PoseError, QueryError
from eagor.evidence import BodyMask, Evidence, model_as_json
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.perception.fusion import ViewDetections
from eagor.perception.replay import ReplayPerception
from eagor.perception.views import Detector
from eagor.sources import Frame, Pose
from eagor.sources.defects import InvalidMask
from eagor.sources.odometry import PosedFrame
from eagor.sources.panorama import Picture
from eagor.tracking import DirectionTracker, Estimate, TrackerConfig

__all__ = ["NEAR", "ObjectSummary", "RecordedLooks", "ValidMasks", "first_line", "looked_at", "summarise_objects"]

UNSURE = math.radians(10)  # of a pose: a look from there says nothing of directions
NEAR = math.radians(15)  # the error that still leads a person to the thing
WORTH_SAYING = 0.002  # share of the sphere from which on a black region is worth a sentence
PIXELS, SCORES, TURNS, METRES = 3, 6, 12, 6  # decimals that are written


class ValidMasks:
    """What the camera never sees: looks say nothing there.

    That is each of the `masks` that are given, what a file says that its picture lacks, and black around a pole in all
    frames so far; of the last two `say` is told, once.
    """

    def __init__(self, masks: Sequence[BodyMask] = (), say: Callable[[str], object] = lambda text: None) -> None:
        self._given, self._say, self._black = tuple(masks), say, InvalidMask()

    def masks(self, frame: Picture | None) -> tuple[BodyMask, ...]:
        """All masks of a frame; those that are given for a look without a picture, whose record says what is black."""
        own = None if frame is None else self.of(frame)
        return self._given if own is None else (*self._given, own)

    def covered(self, looks: tuple[Evidence, ...], frame: Picture | None) -> tuple[Evidence, ...]:
        """The looks at `frame`, without what is not seen."""
        for mask in self.masks(frame):
            looks = tuple(look.covered(mask) for look in looks)
        return looks

    def of(self, frame: Picture) -> BodyMask | None:
        """What `frame` shows, beside the masks that are given; None if that is all."""
        if frame.grid is not None:  # an ordinary picture has no poles
            return None if frame.unseen is None else _around(frame.grid, ~frame.unseen)
        black = self._black.add(frame.picture)
        hidden = black if frame.unseen is None else black | frame.unseen
        if not hidden.any():
            return None
        if hidden.all():
            raise ImageError("the picture is black or transparent everywhere: nothing can be seen in it")
        mask = BodyMask(~hidden)
        share = 1 - float(np.sum(mask.seen * mask.grid.weights)) / (4 * np.pi)
        if share > WORTH_SAYING and black.any():
            self._say(f"{100 * share:.1f} % of the sphere is black around a pole, or missing: taken as not seen")
            self._say = lambda text: None
        return mask


def _around(grid: PerspectiveGrid, seen: np.ndarray) -> BodyMask:
    """What an ordinary picture shows, ``(H, W)``, as a mask of the sphere; what is beside it says nothing anyway."""
    x, y, inside = grid.project(ErpGrid(512, 1024).directions)
    cells = (
        np.clip(np.where(inside, at, 0).astype(int), 0, most - 1) for at, most in zip((y, x), seen.shape, strict=True)
    )
    return BodyMask(inside & seen[tuple(cells)])


# --- a file of looks: writing -----------------------------------------------------------------------------------------


def first_line(of: str, perception: str, views: Detector, poses: str, begins: float = 0.0) -> str:
    """The line about the footage: what was looked at, by which perception, where its poses come from, in words."""
    about: dict[str, Any] = {"of": of, "perception": perception, "poses": poses, "begins": begins}
    about |= {"detector": model_as_json(views.detector), "classes": list(views.classes or ())}
    return json.dumps({"footage": {key: value for key, value in about.items() if value}})


def looked_at(
    frames: Iterable[PosedFrame], views: Detector, queries: Sequence[str] = (), hidden: ValidMasks | None = None
) -> Iterator[tuple[PosedFrame, list[dict[str, Any]]]]:
    """Each frame, and its entries, one for each line: the poses before it, then one for a look.

    Without classes there is one for each of `queries`; of a frame that cannot be used one with the reason. What is
    `hidden` is written as not seen. Raises `EagorError` for a query without meaning, and what `frames` raise.
    """
    hidden = hidden or ValidMasks()
    for posed in frames:
        frame, pose = posed.frame, posed.pose or Pose(posed.frame.stamp, np.eye(3))
        *entries, at = ({"stamp": float(each.stamp), "pose": _pose(each)} for each in (*posed.before, pose))
        at["stamp"] = float(frame.stamp)
        if not posed.looked:
            yield posed, [*entries, at]
            continue
        at |= {"frame": frame.name} | ({"lost": True} if posed.lost else {})
        try:
            if frame.picture is None:
                raise ImageError(frame.problem)
            mask = hidden.of(Picture(frame.picture, frame.unseen, grid=frame.grid))
            if mask is not None:
                at["unseen"] = _runs(mask)
            for query in queries or (None,):
                views_of_look = views.seen(frame.picture, pose.world_R_body, query or "", frame.grid)
                entries.append(at | ({"query": query} if query else {}) | {"views": [*map(_view, views_of_look)]})
        except QueryError:
            raise
        except EagorError as error:
            entries.append(at | {"problem": str(error)})
        yield posed, entries


def _pose(pose: Pose) -> dict[str, float]:
    place = () if pose.position is None else pose.position.tolist()
    entry = _quaternion(pose.world_R_body) | dict(zip("xyz", (round(value, METRES) for value in place), strict=False))
    return entry | ({"spread_deg": round(math.degrees(pose.spread), TURNS)} if pose.spread else {})


def _quaternion(turn: np.ndarray) -> dict[str, float]:
    wxyz = wxyz_from_rotation(turn).round(TURNS).tolist()
    return dict(zip(("qw", "qx", "qy", "qz"), wxyz, strict=True))


def _view(seen: ViewDetections) -> dict[str, Any]:
    grid, (boxes, scores, labels) = seen
    image = {"projection": "perspective", "width": grid.width, "height": grid.height}
    if (lens := grid.optics) is None:
        image |= {"hfov_deg": round(math.degrees(grid.hfov), TURNS)}
    else:  # exactly: a millionth of distortion may be pixels at the border
        image |= {"focal": list(lens.focal), "centre": list(lens.centre), "distortion": list(lens.distortion)}
    inside = np.clip(boxes, 0, [grid.width, grid.height] * 2).round(PIXELS)
    entries = [
        {"box": box.tolist(), "score": round(float(score), SCORES)} | ({} if label is None else {"label": label})
        for box, score, label in zip(inside, scores, labels or [None] * len(inside), strict=True)
        if (box[2:] > box[:2]).all()
    ]
    return {"image": image | _quaternion(grid.body_R_view), "boxes": entries}


def _runs(mask: BodyMask) -> dict[str, Any]:
    """A mask as the lengths of runs: seen, not seen, seen, ..., along the rows of a panorama twice as wide as high."""
    rows = mask.seen.shape[0]
    seen = mask.at(ErpGrid(rows, 2 * rows).directions).ravel()
    runs = np.diff(np.flatnonzero(np.diff(seen, prepend=True, append=~seen[-1])), prepend=0).tolist()
    return {"rows": rows, "runs": runs}


# --- a file of looks: reading -----------------------------------------------------------------------------------------


class RecordedLooks:
    """A source of what `eagor look` wrote: frames without pictures, `posed`, for which `replay` answers.

    `about`: what the first line says, `count`: how many frames there are; `after`: the poses after the last one. Raises
    `FormatError` without that line, `PoseError` for a look without a pose.
    """

    live = False
    latency, dropped = 0.0, 0

    def __init__(self, replay: ReplayPerception) -> None:
        if replay.footage is None:
            raise FormatError(
                f"{replay.name} does not begin with a line about its footage; wanted a file that eagor look wrote, or "
                '{"footage": {"of": "clip.mp4", "perception": "NAME"}} as its first line'
            )
        self.replay, self.about = replay, replay.footage
        self.posed: list[PosedFrame] = []
        before: list[Pose] = []
        for record in replay.records:
            if self.posed and not before and self.posed[-1].frame.stamp == record.stamp:
                continue  # a further view or query of the same moment
            if record.pose is None:
                raise PoseError(
                    f"{replay.name} has a look at {record.stamp:g} s without a pose; wanted "
                    '"pose": {"qw", "qx", "qy", "qz"} (world_R_body) in its line, as eagor look writes it. With the '
                    "footage or its poses at hand: eagor track FRAMES QUERY --perception replay:FILE.jsonl"
                )
            pose = replace(record.pose, stamp=record.stamp)
            if record.kind == "pose" and record.problem is None:
                before.append(pose)
                continue
            frame = Frame(record.stamp, None, record.frame or f"{record.stamp:.2f} s", problem=record.problem or "")
            self.posed.append(PosedFrame(frame, pose, tuple(before), lost=record.lost))
            before = []
        self.after, self.count = tuple(before), len(self.posed)

    @property
    def grid(self) -> ErpGrid:
        """There are no pictures."""
        raise FormatError(f"{self.replay.name} holds no pictures")

    def __iter__(self) -> Iterator[Frame]:
        return (each.frame for each in self.posed)

    def close(self) -> None:
        """Nothing is held."""


# --- what there is ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ObjectSummary:
    """What is known of one thing: `looks`, in how many looks it was seen, of `among`; `last`, the stamp of the last.

    `query`: its class, or the words that were looked for.
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


def summarise_objects(
    recorded: RecordedLooks,
    config: TrackerConfig,
    hidden: ValidMasks | None = None,
    done: Callable[[], object] = lambda: None,
) -> list[ObjectSummary]:
    """What was seen, the surest first; `done` is called after each.

    The looks of an `ObjectSummary` are those since the poses were last lost.
    """
    begins = max((number for number, each in enumerate(recorded.posed) if each.lost), default=0)
    hidden, found = hidden or ValidMasks(), []
    for query in asked_for(recorded.replay):
        tracker, looks, among, last, now = DirectionTracker(config), 0, 0, -math.inf, 0.0
        for posed in (*recorded.posed[begins:], None):
            poses = recorded.after if posed is None else posed.poses[-1:] if posed.lost else posed.poses
            for pose in poses:
                tracker.add_pose(pose.stamp, pose.world_R_body, None if config.ranges is None else pose.position)
                now = pose.stamp
            if posed is None or posed.frame.problem or poses[-1].spread >= UNSURE:
                continue
            evidence = hidden.covered(recorded.replay.looks_near(query, now), None)
            among += 1
            for each in evidence:
                tracker.observe(each.widened(poses[-1].spread))
            if any(each.detections is None or len(each.detections) for each in evidence):
                looks, last = looks + 1, now
        if looks:
            found.append(ObjectSummary(query, tracker.estimate(now), looks, among, last))
        done()
    return sorted(found, key=lambda each: -each.sure)


def asked_for(replay: ReplayPerception) -> list[str]:
    """What a file can be asked for, each once: the labels of what was seen, and the queries that were looked for."""
    queries = [record.query for record in replay.records if record.query is not None and record.kind != "pose"]
    return [*dict.fromkeys([*sorted(replay.labels), *queries])]
