"""Threads that look at the newest picture whenever they are done with the one before: for things, and for turns."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor._extras import need
from eagor.errors import EagorError
from eagor.grids import PerspectiveGrid
from eagor.live.events import Event, PoseCame, PosesLost, Trouble
from eagor.live.keeper import Failed, Keeper, Looked, UnusableError
from eagor.media import Pose
from eagor.media.rotation import VisualOdometer

__all__ = ["NewestPicture", "PerceptionThread", "Picture", "VisualPoses", "VisualPosesThread"]


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture ``(H, W, 3)`` to look at: a panorama, or an ordinary one with its `grid`.

    `stamp`: of its source; `told`: the stamp that the perception is told.
    """

    stamp: float
    told: float
    picture: np.ndarray
    grid: PerspectiveGrid | None = None


class NewestPicture:
    """Where a thread takes the newest of the pictures that are given; those that it does not come to are `skipped`."""

    def __init__(self) -> None:
        self.skipped = 0
        self._changed = threading.Condition()
        self._waiting: Picture | None = None
        self._busy = self._ended = False

    def give(self, picture: Picture) -> None:
        """A picture; it replaces one that still waits."""
        with self._changed:
            self.skipped += self._waiting is not None
            self._waiting = picture
            self._changed.notify_all()

    def take(self) -> Picture | None:
        """Be done with the one before, and wait for the next; None if no more comes."""
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._waiting is not None or self._ended)
            picture, self._waiting = self._waiting, None
            self._busy = picture is not None
            return picture

    def end(self) -> None:
        """Nothing more comes; what waits is still to be taken."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    @property
    def idle(self) -> bool:
        """Whether every picture has been dealt with or skipped."""
        with self._changed:
            return self._waiting is None and not self._busy

    def wait(self, seconds: float) -> None:
        """Wait so long, or until the next picture is wanted."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended or (self._waiting is None and not self._busy), seconds)


class PerceptionThread:
    """Has the perception of `keeper` look for `queries` at the newest of its `pictures`.

    All of these are called in the thread. `found`: for each look, with the picture (None for what happens while
    loading); `ready`: once the perception is loaded; `ended`: once, with the error if it cannot be. `pose` gives the
    orientation ``(3, 3)`` at a picture that is about to be looked at, or None.
    """

    def __init__(
        self,
        keeper: Keeper,
        queries: Sequence[str],
        *,
        found: Callable[[Picture | None, Looked | Failed], Any],
        ready: Callable[[], Any],
        ended: Callable[[EagorError | None], Any],
        pose: Callable[[float], np.ndarray | None],
    ) -> None:
        self.keeper, self.queries, self.pictures = keeper, tuple(queries), NewestPicture()
        self._found, self._ready, self._ended, self._pose = found, ready, ended, pose
        self._stopped = False
        self._refused: set[str] = set()
        self._thread = threading.Thread(target=self._serve, name="eagor perception", daemon=True)
        self._thread.start()

    @property
    def idle(self) -> bool:
        """Whether every picture has been looked at or skipped, or nothing will be looked at any more."""
        return not self._thread.is_alive() or self.pictures.idle

    def stop(self) -> None:
        """End the perception's process and the thread, at once."""
        self._stopped = True
        self.pictures.end()
        self.keeper.kill()
        self._thread.join()

    def _serve(self) -> None:
        error: EagorError | None = None
        try:
            for failed in self.keeper.start():  # before the first picture: loading takes time
                self._found(None, failed)
            self._ready()
            while (picture := self.pictures.take()) is not None and not self._stopped:
                self._look(picture)
        except UnusableError as unusable:
            error = unusable
        finally:
            self.keeper.close()
            self._ended(error)

    def _look(self, picture: Picture) -> None:
        queries = [query for query in self.queries if query not in self._refused]
        if not queries:
            return
        pose = self._pose(picture.stamp)
        for said in self.keeper.look(picture.picture, queries, picture.told, pose, picture.grid):
            if self._stopped:
                return
            if isinstance(said, Failed) and said.refused and said.query is not None:
                self._refused.add(said.query)
            self._found(picture, said)


class VisualPoses:
    """How the camera turns, picture by picture (`eagor.media.rotation`). `level`: only its heading does."""

    def __init__(self, level: bool) -> None:
        need("the rotation from pictures", "photos", "cv2")
        self._odometer = VisualOdometer(level=level)

    def of(self, picture: Picture, now: Callable[[], float]) -> Iterator[Event]:
        """The pose at a picture, after what is to be said of it. `now` gives the times of arrival."""
        try:
            turned = self._odometer.add(picture.picture, picture.stamp, picture.grid)
        except EagorError as error:
            yield Trouble(now(), "poses", str(error))
            return
        if turned.lost:
            yield PosesLost(now(), "a picture does not fit to those before it: the belief starts anew")
        yield PoseCame(now(), Pose(picture.stamp, np.asarray(turned.world_R_body)), of_picture=True)


class VisualPosesThread:
    """Finds the turn of the newest of its `pictures`; `post` gets what `VisualPoses` says, in the thread."""

    def __init__(self, poses: VisualPoses, post: Callable[[Event], Any], now: Callable[[], float]) -> None:
        self.pictures = NewestPicture()
        self._poses, self._post, self._now = poses, post, now
        self._thread = threading.Thread(target=self._serve, name="eagor visual poses", daemon=True)
        self._thread.start()

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return not self._thread.is_alive()

    def close(self, patience: float) -> None:
        """End, and wait so many seconds for the picture that is being compared."""
        self.pictures.end()
        self._thread.join(patience)

    def _serve(self) -> None:
        while (picture := self.pictures.take()) is not None:
            for event in self._poses.of(picture, self._now):
                self._post(event)
