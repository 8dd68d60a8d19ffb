"""A perception looks at footage: it is followed, or what is seen is written to a file that answers any query.

`follow` gives one answer per frame, of our tracker and of other methods. Look once, ask often: `looked_at` makes the
lines of a replay file (docs/replay-format.md), a first line about the footage, then one for each look, with the pose of
the camera and all boxes of all views, and one for each pose between the looks. `recorded_frames` gives poses and looks
back as footage without pictures, which `follow` follows as it follows any; `things_seen` lists what there is.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Protocol, TypeVar

import numpy as np

from eagor.conventions import wxyz_from_rotation
from eagor.errors import EagorError, FormatError, ImageError, PoseError, QueryError
from eagor.evidence import BodyMask, Evidence, model_as_json
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.media.defects import NeverSeen
from eagor.media.footage import ShapeError
from eagor.media.panorama import Picture
from eagor.media.posed_frames import PosedFrame
from eagor.odometry.files import FramePose
from eagor.perception import NoEvidenceError, Perception
from eagor.perception.records import Footage
from eagor.perception.replay import ReplayPerception, look_if_recorded
from eagor.perception.things import Seen
from eagor.perception.views import Detector
from eagor.tracking import DirectionTracker, Estimate, ThingSeen, TrackerConfig
from eagor.tracking.follower import Follower

__all__ = [
    "FollowedFrame", "HiddenParts", "Method", "first_line", "follow", "looked_at", "recorded_frames",
    "things_seen",
]  # fmt: skip

T = TypeVar("T")
UNSURE = math.radians(10)  # of a pose: a look from there says nothing of directions
WORTH_SAYING = 0.002  # share of the sphere from which on a black region is worth a sentence
Looks = tuple[Evidence, ...]


class HiddenParts:
    """What the camera never sees: looks say nothing there.

    That is the `mask` that is given, what a file says that its picture lacks, and black around a pole in all frames so
    far; of the last two `say` is told, once.
    """

    def __init__(self, mask: BodyMask | None = None, say: Callable[[str], object] = lambda text: None) -> None:
        self._given, self._say = mask, say
        self._black, self._said = NeverSeen(), False

    def covered(self, looks: Looks, frame: Picture | None) -> Looks:
        """The looks at `frame`, without what is not seen; of recorded ones (None) the record says what is black."""
        own = None if frame is None else self.of(frame)
        for mask in (self._given, own):
            looks = looks if mask is None else tuple(look.covered(mask) for look in looks)
        return looks

    def of(self, frame: Picture) -> BodyMask | None:
        """What `frame` shows, beside the mask that is given; None if that is all."""
        if frame.grid is not None:  # an ordinary picture has no poles
            return None if frame.unseen is None else _around(frame.grid, ~frame.unseen)
        black = self._black.add(frame.picture)
        hidden = black if frame.unseen is None else black | frame.unseen
        if not hidden.any():
            return None
        if hidden.all():
            raise ImageError("the picture is black or transparent everywhere: nothing can be seen in it")
        mask = BodyMask(~hidden)
        self._tell(mask, black)
        return mask

    def _tell(self, mask: BodyMask, black: np.ndarray) -> None:
        share = 1 - float(np.sum(mask.seen * mask.grid.weights)) / (4 * np.pi)
        if not self._said and share > WORTH_SAYING and black.any():
            self._said = True
            self._say(f"{100 * share:.1f} % of the sphere is black around a pole, or missing: taken as not seen")


def _around(grid: PerspectiveGrid, seen: np.ndarray) -> BodyMask:
    """What an ordinary picture shows, ``(H, W)``, as a mask of the sphere; what is beside it says nothing anyway."""
    x, y, inside = grid.project(ErpGrid(512, 1024).directions)
    rows, columns = (
        np.clip(np.where(inside, at, 0).astype(int), 0, most - 1) for at, most in zip((y, x), seen.shape, strict=True)
    )
    return BodyMask(inside & seen[rows, columns])


class Method(Protocol):
    """Another method to compare with, as `eagor.lab.agents.methods` makes them."""

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        """The camera's pose, before the evidence of its time."""
        ...

    def see(self, evidence: Evidence) -> None:
        """A look at the last pose."""
        ...

    def direction(self) -> np.ndarray:
        """The answer ``(3,)``, body frame."""
        ...


@dataclass(frozen=True, eq=False)
class FollowedFrame:
    """The answer at one frame.

    `picture` ``(H, W, 3)`` uint8, and `grid` its pixels if an ordinary camera took it (None: a whole panorama).
    `problem` says why the frame could not be used, if so; `evidence` has several items for several views; `looked` and
    `lost` as in `PosedFrame`; `position` of the camera, if known; `others` are the other methods' directions ``(3,)``
    by name.
    """

    frame: str
    stamp: float
    estimate: Estimate
    picture: np.ndarray | None
    evidence: Looks
    problem: str | None
    looked: bool = True
    lost: bool = False
    position: np.ndarray | None = None
    others: dict[str, np.ndarray] = field(default_factory=dict)
    grid: PerspectiveGrid | None = None

    @property
    def told(self) -> bool:
        """Whether it has a line of its own: it was looked at, or could not be."""
        return self.looked or self.problem is not None


def follow(
    frames: Iterable[PosedFrame],
    perception: Perception,
    query: str,
    config: TrackerConfig,
    rivals: Callable[[], Mapping[str, Method]] = dict,
    hidden: HiddenParts | None = None,
) -> Iterator[FollowedFrame]:
    """One answer per frame, in order of time, with the directions of the `rivals`, which the function makes.

    A frame that cannot be used gives an answer with a problem; the poses carry the belief over it. Where the poses are
    lost, everything starts anew. What is `hidden` says nothing. Raises `EagorError` if no other frame could do better:
    a query without meaning, or a first frame that is not 2:1, or to which the perception returns no evidence.
    """
    hidden = hidden or HiddenParts()
    follower, others, fed, before = Follower(config), rivals(), -math.inf, -math.inf
    for (poses, frame), after in _with_next(_by_frame(frames)):
        stamp = frame.pose.stamp
        if frame.lost:
            follower, others, poses = Follower(config), rivals(), [frame.pose]
        # One pose ahead, so that a replay record from shortly after this frame gets the pose of its own time.
        ahead = [] if after is None or after[1].lost else [after[0][0]]
        for pose in [*poses, *ahead]:
            if pose.stamp > fed:
                follower.move(pose.stamp, pose.world_R_body, pose.position)
                fed = pose.stamp
        upcoming = math.inf if after is None else after[1].pose.stamp
        picture, looks, problem = _seen(frame, perception, query, before, upcoming, hidden)
        looks = tuple(look.widened(frame.spread) for look in looks) if frame.spread < UNSURE else ()
        now = stamp
        for evidence in map(follower.placed, looks):
            follower.look(evidence)
            now = now if evidence.stamp is None else max(now, float(evidence.stamp))
        for method in others.values():
            method.move(stamp, frame.pose.world_R_body, frame.pose.position)
            for evidence in looks:
                method.see(replace(evidence, stamp=stamp))
        yield FollowedFrame(
            frame=frame.frame or "",
            stamp=stamp,
            estimate=follower.estimate(now),
            picture=None if picture is None else picture.picture,
            evidence=looks,
            problem=problem,
            looked=frame.looked,
            lost=frame.lost,
            position=frame.pose.position,
            others={name: method.direction() for name, method in others.items()},
            grid=None if picture is None else picture.grid,
        )
        before = stamp


def _seen(
    frame: PosedFrame, perception: Perception, query: str, before: float, after: float, hidden: HiddenParts
) -> tuple[Picture | None, Looks, str | None]:
    """The picture of a frame, the evidence there, and what is wrong with it.

    `before`, `after`: the stamps of its neighbours; infinite where there is none.
    """
    picture, stamp = None, frame.pose.stamp
    looks: Looks = ()
    try:
        picture = None if frame.read is None else frame.read()
        if frame.looked and (picture is not None or isinstance(perception, ReplayPerception)):
            turn = frame.pose.world_R_body
            shown, grid = (None, None) if picture is None else (picture.picture, picture.grid)
            found = look_if_recorded(perception, shown, query, stamp, turn, grid)
            looks = hidden.covered(_own(found, before, stamp, after), picture)
    except EagorError as error:
        # Every other frame would fail in the same way, or hardly any other would do better than the first.
        if isinstance(error, QueryError) or (isinstance(error, ShapeError | NoEvidenceError) and before == -math.inf):
            raise
        return picture, looks, str(error)
    return picture, looks, None


def _own(looks: Sequence[Evidence], before: float, stamp: float, after: float) -> Looks:
    """Those of `looks` to which the frame at `stamp` is nearer than the frames before and after it.

    Frames closer together than a replay's tolerance find the same line, which is evidence only once.
    """

    def nearest(look: Evidence) -> float:
        at = stamp if look.stamp is None else float(look.stamp)
        return min((before, stamp, after), key=lambda frame: abs(frame - at))

    return tuple(look for look in looks if nearest(look) == stamp)


def _by_frame(frames: Iterable[PosedFrame]) -> Iterator[tuple[list[FramePose], PosedFrame]]:
    """Each frame, with the poses since the frame before, its own included."""
    poses: list[FramePose] = []
    for each in frames:
        poses.append(each.pose)
        if each.frame is not None:
            yield poses, each
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


PIXELS, SCORES, TURNS, METRES = 3, 6, 12, 6  # decimals that are written


# --- a file of looks: writing -----------------------------------------------------------------------------------------


def first_line(of: str, perception: str, views: Detector, poses: str, begins: float = 0.0) -> str:
    """The line about the footage: what was looked at, by which perception, where its poses come from, in words."""
    about: dict[str, Any] = {"of": of, "perception": perception, "poses": poses, "begins": begins}
    about["detector"] = model_as_json(views.detector)
    if views.classes is not None:
        about["classes"] = list(views.classes)
    return json.dumps({"footage": {key: value for key, value in about.items() if value}})


def looked_at(
    frames: Iterable[PosedFrame], views: Detector, queries: Sequence[str] = (), hidden: HiddenParts | None = None
) -> Iterator[tuple[PosedFrame, list[dict[str, Any]]]]:
    """Each pose, and its entries, one for each line: one for a look; without classes, one for each of `queries`.

    A frame that cannot be used has one with the reason, and no `read` if there was no picture. What is `hidden` is
    written as not seen. Raises `EagorError` as `eagor.perception.footage.follow` does.
    """
    hidden, first = hidden or HiddenParts(), True
    for frame in frames:
        at = {"stamp": float(frame.pose.stamp), "pose": _pose(frame.pose, frame.spread)}
        if frame.frame is None or not frame.looked or frame.read is None:
            yield frame, [at]
            continue
        at |= {"frame": frame.frame} | ({"lost": True} if frame.lost else {})
        picture = None
        try:
            picture = frame.read()
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
        yield (replace(frame, read=None) if picture is None else frame), entries


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
    if (lens := grid.optics) is None:
        image |= {"hfov_deg": round(math.degrees(grid.hfov), TURNS)}
    else:  # exactly: a millionth of distortion may be pixels at the border
        image |= {"focal": list(lens.focal), "centre": list(lens.centre), "distortion": list(lens.distortion)}
    image |= _quaternion(grid.body_R_view)
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


# --- a file of looks: reading -----------------------------------------------------------------------------------------


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


# --- what there is ----------------------------------------------------------------------------------------------------


def things_seen(
    replay: ReplayPerception,
    config: TrackerConfig,
    hidden: HiddenParts | None = None,
    done: Callable[[], object] = lambda: None,
) -> list[ThingSeen]:
    """What was seen, the surest first; `done` is called after each. Errors as those of `recorded_frames`.

    The looks of a `ThingSeen` are those since the poses were last lost.
    """
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
