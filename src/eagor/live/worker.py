"""A thread that has the perception look at the newest picture, whenever it is done with the one before."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.errors import EagorError
from eagor.live.keeper import Failed, Keeper, Looked, UnusableError

__all__ = ["Picture", "Worker"]


@dataclass(frozen=True, eq=False)
class Picture:
    """A panorama ``(H, W, 3)`` to look at. `stamp`: of its source; `told`: the stamp that the perception is told."""

    stamp: float
    told: float
    panorama: np.ndarray


class Worker:
    """Looks at the newest of the pictures that are given to it; those that it does not come to are `skipped`.

    All of these are called in the worker's thread. `found`: for each look, with the picture (None for what happens
    while loading); `ended`: once, with the error if the perception cannot be loaded; `ready`: once it is. `pose` gives
    the orientation ``(3, 3)`` at a picture that is about to be looked at, or None.
    """

    def __init__(
        self,
        keeper: Keeper,
        queries: Sequence[str],
        found: Callable[[Picture | None, Looked | Failed], Any],
        ended: Callable[[EagorError | None], Any] = lambda _: None,
        ready: Callable[[], Any] = lambda: None,
        pose: Callable[[float], np.ndarray | None] = lambda _: None,
    ) -> None:
        self.keeper, self.queries = keeper, tuple(queries)
        self.looked = self.skipped = 0
        self._found, self._ended, self._ready, self._pose = found, ended, ready, pose
        self._news = threading.Condition()
        self._next: Picture | None = None
        self._busy = self._stopped = False
        self._refused: set[str] = set()
        self._thread = threading.Thread(target=self._serve, name="eagor perception", daemon=True)
        self._thread.start()

    def give(self, picture: Picture) -> None:
        """Offer a picture; it replaces one that still waits."""
        with self._news:
            self.skipped += self._next is not None
            self._next = picture
            self._news.notify_all()

    @property
    def idle(self) -> bool:
        """Whether every picture has been looked at or skipped, or nothing will be looked at any more."""
        with self._news:
            return not self._thread.is_alive() or (self._next is None and not self._busy)

    def wait(self, seconds: float) -> None:
        """Wait so long, or until the next picture is wanted."""
        with self._news:
            self._news.wait_for(lambda: self._stopped or (self._next is None and not self._busy), seconds)

    def stop(self) -> None:
        """End the perception's process and the thread, at once."""
        with self._news:
            self._stopped = True
            self._news.notify_all()
        self.keeper.kill()
        self._thread.join()

    def _serve(self) -> None:
        error: EagorError | None = None
        try:
            for failed in self.keeper.start():  # before the first picture: loading takes time
                self._found(None, failed)
            self._ready()
            while (picture := self._taken()) is not None:
                self._look(picture)
                with self._news:
                    self._busy = False
                    self._news.notify_all()
        except UnusableError as unusable:
            error = unusable
        finally:
            self.keeper.close()
            self._ended(error)

    def _taken(self) -> Picture | None:
        with self._news:
            while self._next is None and not self._stopped:
                self._news.wait()
            picture, self._next = self._next, None
            self._busy = picture is not None
            return None if self._stopped else picture

    def _look(self, picture: Picture) -> None:
        queries = [query for query in self.queries if query not in self._refused]
        if not queries:
            return
        self.looked += 1
        pose = self._pose(picture.stamp)
        for said in self.keeper.look(picture.panorama, queries, picture.told, pose):
            if self._stopped:
                return
            if isinstance(said, Failed) and said.refused and said.query is not None:
                self._refused.add(said.query)
            self._found(picture, said)
