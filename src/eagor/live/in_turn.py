"""A recording, look after look: the perception looks at every picture, time is that of the recording.

`answers_in_turn` makes the events of a loop; `ByFrame` is a sink that puts together what belongs to one picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from eagor.errors import EagorError, QueryError
from eagor.evidence import Evidence
from eagor.grids import PerspectiveGrid
from eagor.live.core import UNSURE, LiveCore
from eagor.live.events import (
    Answer,
    Diagnostic,
    Event,
    ImageReceived,
    ObservationReceived,
    OdometryReset,
    PoseReceived,
    Tick,
)
from eagor.live.inference import InferenceWorker
from eagor.perception import NoEvidenceError
from eagor.sources import Pose
from eagor.sources.odometry import PosedFrame
from eagor.tracking.estimate import Estimate

__all__ = ["ByFrame", "Followed", "answers_in_turn"]

LOST = "it does not fit to the frames before it: the belief starts anew"

T = TypeVar("T")


def answers_in_turn(
    frames: Iterable[PosedFrame],
    core: LiveCore,
    inference: InferenceWorker,
    take: Callable[[Event], list[Answer]],
    waits: bool = False,
) -> Iterator[Answer]:
    """An answer to each query at each frame. `take` gives events to the `core`, and returns its answers.

    `waits`: a frame is answered before the next one is read. Raises `QueryError` for a query of the beginning that the
    perception does not understand, `NoEvidenceError` if what comes for the first frame is no evidence, and what
    `frames` raise, after the answer at the frame before.
    """
    inference.start()
    before, fed, asked = -math.inf, -math.inf, core.queries
    for posed, after in ((each, None) for each in frames) if waits else _with_next(frames):
        frame, stamp, poses = posed.frame, posed.frame.stamp, posed.poses
        if posed.lost:
            take(OdometryReset(stamp, f"{frame.name}: {LOST}"))
            fed, poses = -math.inf, poses[-1:]
        # One pose ahead, so that a recorded look from shortly after this frame gets the pose of its own time.
        ahead = () if after is None or after.lost else after.poses[:1]
        for pose in (*poses, None, *ahead):
            if pose is None:
                take(ImageReceived(stamp, stamp, frame.name, frame.picture, frame.grid, frame.problem, posed.looked))
            elif pose.stamp > fed:
                take(PoseReceived(pose.stamp, replace(pose, spread=0.0)))
                fed = pose.stamp
        near = before, stamp, math.inf if after is None else after.frame.stamp
        turn = None if posed.pose is None else posed.pose.world_R_body
        now, looking = stamp, () if frame.problem or not posed.looked else core.queries
        for found in inference.infer(frame, looking, turn) if looking else ():
            if found.refused and found.query in asked:
                raise QueryError(found.problem)
            if found.malformed and before == -math.inf:
                raise NoEvidenceError(found.problem)
            looks = tuple(_placed(found.evidence, posed, near, fed))
            now = max([now, *(float(look.stamp) for look in looks if look.stamp is not None)])
            for event in replace(found, evidence=looks).events(stamp, stamp, stamp):
                take(event)
        yield from take(Tick(now))
        before = stamp


def _placed(
    looks: Sequence[Evidence], posed: PosedFrame, near: tuple[float, float, float], last: float
) -> Iterator[Evidence]:
    """Those of `looks` that belong to a frame, at the pose of their time.

    Frames closer together than a replay's tolerance find the same line, which is evidence only once: where the frame is
    nearest, of the stamps `near` it (of the frame before, its own, of the one after). Stamps are clipped to the `last`
    known pose. A look is as wide as its pose is unsure; there is none where that is too much.
    """
    pose = posed.pose
    for look in looks if pose is None or pose.spread < UNSURE else ():
        stamp = near[1] if look.stamp is None else float(look.stamp)
        if min(near, key=lambda frame: abs(frame - stamp)) != near[1]:
            continue
        if pose is not None:
            look = look if look.stamp is None else replace(look, stamp=min(stamp, last))
            look = look.widened(pose.spread)
        yield look


def _with_next(items: Iterable[T]) -> Iterator[tuple[T, T | None]]:
    """Each item with the one after it; what getting that raises comes after the item."""
    held: list[T] = []
    try:
        for item in items:
            yield from ((each, item) for each in held)
            held = [item]
    except EagorError:
        yield from ((each, None) for each in held)
        raise
    yield from ((each, None) for each in held)


# --- what belongs to one picture ---


@dataclass(frozen=True, eq=False)
class Followed:
    """The answer to one query at one frame.

    `picture` ``(H, W, 3)`` uint8 with its `grid`, `looked` and `lost`: as of `Frame` and `PosedFrame`. `problem`: why
    the frame could not be used, if so. `evidence`: several items for several views. `position` of the camera, if known.
    `others`: the other methods' directions ``(3,)`` by name.
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
    """A sink of a loop in turn: `each` is called for each query at each frame, in their order.

    `rivals`: makes the methods to compare with (`eagor.lab.agents.methods`), for each query anew, and again where the
    poses are lost. `say` is told what the loop has to say of the footage, each once.
    """

    def __init__(
        self,
        each: Callable[[Followed], object],
        rivals: Callable[[], Mapping[str, Any]] = dict,
        say: Callable[[str], object] = lambda text: None,
    ) -> None:
        self._each, self._rivals, self._say, self._said = each, rivals, say, set[str]()
        self._others: dict[str, Mapping[str, Any]] = {}
        self._poses: list[Pose] = []  # the last one that is not later than the frame, and those after it
        self._frame: ImageReceived | None = None
        self._problems: dict[str, str] = {}
        self._evidence: dict[str, tuple[Evidence, ...]] = {}
        self._lost = False

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop."""
        if isinstance(event, OdometryReset):
            self._lost, self._others, self._poses = True, {}, []
        elif isinstance(event, PoseReceived):
            self._poses.append(event.pose)
        elif isinstance(event, ImageReceived):
            self._frame, self._problems, self._evidence = event, {}, {}
            while len(self._poses) > 1 and self._poses[1].stamp <= event.stamp:
                del self._poses[0]
        elif isinstance(event, Diagnostic):
            if event.passing and event.text not in self._said:
                self._said.add(event.text)
                self._say(event.text)
            elif event.part == "perception" and event.text:
                self._problems[event.about] = event.text
        elif isinstance(event, ObservationReceived):
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
