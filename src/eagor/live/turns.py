"""Poses from the pictures themselves, of the newest picture each time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from eagor._extras import need
from eagor.errors import EagorError
from eagor.live.events import Event, PoseCame, PosesLost, Trouble
from eagor.live.worker import Picture
from eagor.media.frames import Pose
from eagor.media.rotation import VisualOdometer

__all__ = ["Turns", "TurnsThread"]


class Turns:
    """How the camera turns, picture by picture (`eagor.media.rotation`). `level`: only its heading does."""

    def __init__(self, level: bool) -> None:
        need("the rotation from pictures", "photos", "cv2")
        self._odometer = VisualOdometer(level=level)

    def of(self, picture: Picture, now: Callable[[], float]) -> Iterator[Event]:
        """The pose at a picture, after what is to be said of it. `now` gives the times of arrival."""
        try:
            turned = self._odometer.add(picture.panorama, picture.stamp)
        except EagorError as error:
            yield Trouble(now(), "poses", str(error))
            return
        if turned.lost:
            yield PosesLost(now(), "a picture does not fit to those before it: the belief starts anew")
        yield PoseCame(now(), Pose(picture.stamp, np.asarray(turned.world_R_body)), of_picture=True)


class TurnsThread:
    """A thread that finds the turn of the newest picture; `post` gets what `Turns` says, in the thread."""

    def __init__(self, turns: Turns, post: Callable[[Event], Any], now: Callable[[], float]) -> None:
        self._turns, self._post, self._now = turns, post, now
        self._news = threading.Condition()
        self._picture: Picture | None = None
        self._over = False
        self._thread = threading.Thread(target=self._serve, name="eagor turns", daemon=True)
        self._thread.start()

    def give(self, picture: Picture) -> None:
        """A picture; it replaces one that still waits."""
        with self._news:
            self._picture = picture
            self._news.notify()

    def end(self) -> None:
        """Nothing more comes."""
        with self._news:
            self._over = True
            self._news.notify()

    def close(self, patience: float) -> None:
        """End, and wait so many seconds for the picture that is being compared."""
        self.end()
        self._thread.join(patience)

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return not self._thread.is_alive()

    def _serve(self) -> None:
        while True:
            with self._news:
                while self._picture is None and not self._over:
                    self._news.wait()
                picture, self._picture = self._picture, None
            if picture is None:
                return
            for event in self._turns.of(picture, self._now):
                self._post(event)
