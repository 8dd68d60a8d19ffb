"""A recording, look after look: the perception looks at every picture, time is that of the recording.

`answers_in_turn` makes the events of a loop; `ByFrame` is a sink that puts together what belongs to one picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeVar

import numpy as np

from eagor.errors import EagorError, QueryError
from eagor.evidence import Evidence
from eagor.grids import PerspectiveGrid
from eagor.live.core import UNSURE, LiveCore
from eagor.live.events import Answer, Asked, Event, EvidenceCame, FrameCame, PoseCame, PosesLost, Trouble
from eagor.live.inference import Failed, Inference, Looked
from eagor.media import Pose
from eagor.media.posed_frames import PosedFrame
from eagor.perception import NoEvidenceError
from eagor.tracking.estimate import Estimate

__all__ = ["ByFrame", "Followed", "Method", "answers_in_turn"]

LOST = "it does not fit to the frames before it: the belief starts anew"

T = TypeVar("T")


def answers_in_turn(
    frames: Iterable[PosedFrame],
    core: LiveCore,
    inference: Inference,
    take: Callable[[Event], list[Answer]],
    waits: bool = False,
) -> Iterator[Answer]:
    """An answer to each query at each frame. `take` gives events to the `core`, and returns its answers.

    `waits`: a frame is answered before the next one is read. Raises `QueryError` for a query of the beginning that the
    perception does not understand, `NoEvidenceError` if what comes for the
    first frame is no evidence, and what `frames` raise, after the answer at the frame before.
    """
    for failed in inference.start():
        raise EagorError(failed.text)
    before, fed, asked = -math.inf, -math.inf, core.queries
    for posed, after in ((each, None) for each in frames) if waits else _with_next(frames):
        frame, stamp, poses = posed.frame, posed.frame.stamp, posed.poses
        if posed.lost:
            take(PosesLost(stamp, f"{frame.name}: {LOST}"))
            fed, poses = -math.inf, poses[-1:]
        # One pose ahead, so that a recorded look from shortly after this frame gets the pose of its own time.
        ahead = () if after is None or after.lost else after.poses[:1]
        for pose in (*poses, None, *ahead):
            if pose is None:
                shown = frame.name, frame.picture, frame.grid, frame.problem, posed.looked
                take(FrameCame(stamp, stamp, *shown))
            elif pose.stamp > fed:
                take(PoseCame(pose.stamp, replace(pose, spread=0.0)))
                fed = pose.stamp
        now, first = stamp, before == -math.inf
        upcoming = math.inf if after is None else after.frame.stamp
        turn = None if posed.pose is None else posed.pose.world_R_body
        looking = () if frame.problem or not posed.looked else core.queries
        for said in inference.look(frame.picture, looking, stamp, turn, frame.grid, frame.unseen) if looking else ():
            if isinstance(said, Failed):
                if said.refused and said.query in asked:
                    raise QueryError(said.text)
                if said.malformed and first:
                    raise NoEvidenceError(said.text)
                take(Trouble(stamp, "perception", said.text, said.query or ""))
            elif isinstance(said, Looked):
                looks = _placed(_own(said.looks, before, stamp, upcoming), posed, fed)
                now = max([now, *(float(look.stamp) for look in looks if look.stamp is not None)])
                take(Trouble(stamp, "perception"))
                take(Trouble(stamp, "perception", about=said.query))
                take(EvidenceCame(stamp, stamp, stamp, said.query, looks, said.seconds))
        yield from take(Asked(now))
        before = stamp


def _own(looks: Sequence[Evidence], before: float, stamp: float, after: float) -> Iterator[Evidence]:
    """Those of `looks` to which the frame at `stamp` is nearer than the frames before and after it.

    Frames closer together than a replay's tolerance find the same line, which is evidence only once.
    """
    for look in looks:
        at = stamp if look.stamp is None else float(look.stamp)
        if min((before, stamp, after), key=lambda frame: abs(frame - at)) == stamp:
            yield look


def _placed(looks: Iterator[Evidence], posed: PosedFrame, last: float) -> tuple[Evidence, ...]:
    """Looks with their stamp clipped to the known poses, as wide as the pose is unsure; none where that is too much."""
    if posed.pose is None:
        return tuple(looks)
    spread = posed.pose.spread
    if spread >= UNSURE:
        return ()
    placed = (look if look.stamp is None else replace(look, stamp=min(float(look.stamp), last)) for look in looks)
    return tuple(look.widened(spread) for look in placed)


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


# --- what belongs to one picture ---


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
class Followed:
    """The answer to one query at one frame.

    `picture` ``(H, W, 3)`` uint8, and `grid` its pixels if an ordinary camera took it (None: a whole panorama).
    `problem` says why the frame could not be used, if so; `evidence` has several items for several views; `looked` and
    `lost` as in `PosedFrame`; `position` of the camera, if known; `others` are the other methods' directions ``(3,)``
    by name.
    """

    query: str
    frame: str
    stamp: float
    estimate: Estimate
    picture: np.ndarray | None
    grid: PerspectiveGrid | None
    evidence: tuple[Evidence, ...]
    problem: str | None
    looked: bool
    lost: bool
    position: np.ndarray | None
    others: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def told(self) -> bool:
        """Whether it has a line of its own: it was looked at, or could not be."""
        return self.looked or self.problem is not None


class ByFrame:
    """A sink of a loop in turn: `take` is called for each query at each frame, in their order.

    `rivals`: makes the methods to compare with, for each query anew, and again where the poses are lost.
    """

    def __init__(self, each: Callable[[Followed], object], rivals: Callable[[], Mapping[str, Method]] = dict) -> None:
        self._each, self._rivals = each, rivals
        self._others: dict[str, Mapping[str, Method]] = {}
        self._poses: list[Pose] = []  # the last one that is not later than the frame, and those after it
        self._frame: FrameCame | None = None
        self._problems: dict[str, str] = {}
        self._evidence: dict[str, tuple[Evidence, ...]] = {}
        self._lost = False

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop."""
        if isinstance(event, PosesLost):
            self._lost, self._others, self._poses = True, {}, []
        elif isinstance(event, PoseCame):
            self._poses.append(event.pose)
        elif isinstance(event, FrameCame):
            self._frame, self._problems, self._evidence = event, {}, {}
            while len(self._poses) > 1 and self._poses[1].stamp <= event.stamp:
                del self._poses[0]
        elif isinstance(event, Trouble) and event.part == "perception" and event.text:
            self._problems[event.about] = event.text
        elif isinstance(event, EvidenceCame):
            self._evidence[event.query] = event.looks
        for answer in answers:
            self._each(self._followed(answer))
        self._lost = self._lost and not answers

    def close(self) -> None:
        """Nothing is held."""

    def _followed(self, answer: Answer) -> Followed:
        frame, query = self._frame, answer.query
        assert frame is not None
        pose = self._poses[0] if self._poses else Pose(frame.stamp, np.eye(3))
        looks = self._evidence.get(query, ())
        others = self._others[query] = self._others.get(query) or self._rivals()
        for method in others.values():
            method.move(frame.stamp, pose.world_R_body, pose.position)
            for look in looks:
                method.see(replace(look, stamp=frame.stamp))
        return Followed(
            query, frame.name, frame.stamp, answer.estimate, frame.picture, frame.grid, looks,
            problem=frame.problem or self._problems.get(query) or self._problems.get("") or None,
            looked=frame.looked, lost=self._lost, position=pose.position,
            others={name: method.direction() for name, method in others.items()},
        )  # fmt: skip
