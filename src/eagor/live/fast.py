"""A recording, as fast as the perception can look at every picture; time is that of the recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from eagor.errors import EagorError
from eagor.live.answers import Answer
from eagor.live.core import LiveCore
from eagor.live.events import Asked, Event, FrameCame, PoseCame
from eagor.live.keeper import Failed, Keeper, Looked
from eagor.live.turns import Turns
from eagor.live.worker import Picture
from eagor.media.frames import CameraSource, Pose

__all__ = ["at_once"]


def at_once(
    camera: CameraSource,
    poses: Iterable[Pose],
    turns: Turns | None,
    keeper: Keeper,
    core: LiveCore,
    rate: float,
    taken: Callable[[Event], Sequence[Answer]],
    found: Callable[[Picture, Looked | Failed, float], Any],
    queries: Callable[[], Sequence[str]],
) -> Iterator[Answer]:
    """Answers at `rate` per second of the recording, in which evidence takes no time.

    Each event goes to `taken`, what the perception says to `found`. Raises `EagorError` if it cannot be started.
    """
    ahead, begun, ticks, now = _Ahead(poses), None, 0, 0.0

    def feed(until: float) -> None:
        for pose in ahead.until(until):
            taken(PoseCame(pose.stamp, pose))

    for failed in keeper.start():
        raise EagorError(failed.text)
    for frame in camera:
        now = frame.stamp
        begun = now if begun is None else begun
        while (tick := begun + ticks / rate) < now:
            feed(tick)
            yield from taken(Asked(tick))
            ticks += 1
        feed(now)
        taken(FrameCame(now, now, frame.name, frame.panorama))
        picture = Picture(now, now, frame.panorama)
        for event in () if turns is None else turns.of(picture, lambda at=now: at):
            taken(event)
        for said in keeper.look(frame.panorama, queries(), now, core.orientation(now)):
            found(picture, said, now)
    if begun is not None:
        yield from taken(Asked(now))


class _Ahead:
    """Poses up to a time; the one after it waits."""

    def __init__(self, poses: Iterable[Pose]) -> None:
        self._poses = iter(poses)
        self._next: Pose | None = next(self._poses, None)

    def until(self, stamp: float) -> Iterator[Pose]:
        while self._next is not None and self._next.stamp <= stamp:
            yield self._next
            self._next = next(self._poses, None)
