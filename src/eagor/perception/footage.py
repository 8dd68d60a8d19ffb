"""A perception looks at the frames of footage, and our tracker (with other methods) follows; one answer per frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeVar

import numpy as np

from eagor.errors import EagorError, QueryError
from eagor.evidence import BodyMask, Evidence
from eagor.grids import PerspectiveGrid
from eagor.media.defects import NeverSeen
from eagor.media.footage import ShapeError
from eagor.media.panorama import Picture
from eagor.media.pose_files import FramePose
from eagor.media.posed_frames import PosedFrame
from eagor.perception import NoEvidenceError, Perception
from eagor.perception.replay import ReplayPerception, look_if_recorded
from eagor.tracking import Estimate, TrackerConfig
from eagor.tracking.follower import Follower

__all__ = ["FollowedFrame", "HiddenParts", "Method", "follow", "look_at"]

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
            return None
        black = self._black.add(frame.picture)
        hidden = black if frame.unseen is None else black | frame.unseen
        if not hidden.any():
            return None
        mask = BodyMask(~hidden)
        self._tell(mask, black)
        return mask

    def _tell(self, mask: BodyMask, black: np.ndarray) -> None:
        share = 1 - float(np.sum(mask.seen * mask.grid.weights)) / (4 * np.pi)
        if not self._said and share > WORTH_SAYING and black.any():
            self._said = True
            self._say(f"{100 * share:.1f} % of the sphere is black around a pole, or missing: taken as not seen")


class Method(Protocol):
    """Another method to compare with, as `eagor.tasks.methods` makes them."""

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
        picture, (looks,), problem = _seen(frame, perception, (query,), before, upcoming, hidden)
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


def look_at(
    frames: Iterable[PosedFrame], perception: Perception, queries: Sequence[str], hidden: HiddenParts | None = None
) -> Iterator[tuple[PosedFrame, tuple[Looks, ...], str | None]]:
    """Each frame, the evidence for each of `queries` there, and why it could not be used, if so; raises as `follow`."""
    hidden, before = hidden or HiddenParts(), -math.inf
    for (_, frame), after in _with_next(_by_frame(frames)):
        upcoming = math.inf if after is None else after[1].pose.stamp
        _, looks, problem = _seen(frame, perception, queries, before, upcoming, hidden)
        yield frame, looks, problem
        before = frame.pose.stamp


def _seen(
    frame: PosedFrame, perception: Perception, queries: Sequence[str], before: float, after: float, hidden: HiddenParts
) -> tuple[Picture | None, tuple[Looks, ...], str | None]:
    """The picture of a frame, the evidence for each query, and what is wrong with it.

    `before`, `after`: the stamps of its neighbours; infinite where there is none.
    """
    picture, stamp = None, frame.pose.stamp
    looks: tuple[Looks, ...] = ((),) * len(queries)
    try:
        picture = None if frame.read is None else frame.read()
        if frame.looked and (picture is not None or isinstance(perception, ReplayPerception)):
            turn = frame.pose.world_R_body
            shown, grid = (None, None) if picture is None else (picture.picture, picture.grid)
            found = (look_if_recorded(perception, shown, query, stamp, turn, grid) for query in queries)
            looks = tuple(hidden.covered(_own(each, before, stamp, after), picture) for each in found)
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
