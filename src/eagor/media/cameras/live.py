"""A camera that is there now: frames of one or several live streams, newest first, made to panoramas."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Iterator, Sequence

import numpy as np

from eagor.errors import EagorError, ImageError, TimeError
from eagor.media.cameras.feeds import Feed, Opening, Shot
from eagor.media.cameras.making import Panoramas
from eagor.media.cameras.rig import Rig
from eagor.media.decoding import to_rgb
from eagor.media.frames import Frame

__all__ = ["LiveCamera"]

APART = 0.1  # seconds by which the newest pictures of two lenses may differ before it is said


class LiveCamera:
    """A `CameraSource` of one stream, or of one per picture of a `rig`.

    Only the newest picture is kept (`keeps_newest`): it is made a panorama when it is asked for. `dropped` counts those
    that nobody took in time and those that were damaged; `rate`: the most pictures per second to take, which are not
    counted. Streams that break off are opened again. `problem`: what is wrong right now, in words, or None. Iterating
    twice shares the frames.

    Raises `DeviceError` if a stream cannot be opened, or nothing comes; `ImageError` for pictures that are no
    panoramas, or do not fit the rig.
    """

    live = True
    keeps_newest = True

    def __init__(
        self,
        openings: Sequence[Opening],
        *,
        rig: Rig | None = None,
        rows: int | None = None,
        rate: float | None = None,
        latency: float = 0.0,
    ) -> None:
        if not math.isfinite(latency):
            raise TimeError(f"latency = {latency!r}; wanted seconds from capture to arrival, 0 or more")
        if rate is not None and not (math.isfinite(rate) and rate > 0):
            raise TimeError(f"rate = {rate!r}; wanted pictures per second, more than 0")
        if latency and any(opening.stamped for opening in openings):
            raise TimeError(f"latency = {latency:g} s, but the pictures come with their times of capture; leave it out")
        self.latency = latency
        self._name = openings[0].name
        self._broken: str | None = None
        self._unfit = 0
        self._warned: set[str] = set()
        self._feeds: list[Feed] = []
        try:
            for opening in openings:
                self._feeds.append(Feed(opening, latency=latency, rate=rate))
            shots = [shot for feed in self._feeds if (shot := feed.seen) is not None]
            sizes = tuple((shot.picture.width, shot.picture.height) for shot in shots)
            self._sizes = sizes
            self._panoramas = Panoramas(sizes, rig, rows, self._name)
            self._panoramas.check(*self._pictures(shots))
        except BaseException:
            self.close()
            raise
        self.grid, self.unseen = self._panoramas.grid, self._panoramas.unseen

    @property
    def dropped(self) -> int:
        return sum(feed.dropped for feed in self._feeds[:1]) + self._unfit

    @property
    def problem(self) -> str | None:
        """What is wrong right now, in words; None if nothing is."""
        return next((said for feed in self._feeds if (said := feed.problem)), self._broken)

    def __iter__(self) -> Iterator[Frame]:
        first, *others = self._feeds
        while (shot := first.take()) is not None:
            shots = [shot, *(found for feed in others if (found := feed.newest()) is not None)]
            try:
                panorama = self._panorama(shots)
            except EagorError as error:
                self._unfit += 1
                self._broken = f"{self._name}: a picture is left out: {error}"
                self._warn(self._broken)
                continue
            if first.timeless:
                self._warn(
                    f"{self._name} tells no times, or not those of the pictures: each is stamped with its arrival less "
                    f"the latency ({self.latency:g} s), and carries the jitter of its way"
                )
            yield Frame(shot.stamp, panorama, f"{self._name} {_clock(shot.stamp)}")
        if first.error is not None:
            raise first.error

    def close(self) -> None:
        for feed in self._feeds:
            feed.close()

    def _panorama(self, shots: Sequence[Shot]) -> np.ndarray:
        sizes = tuple((shot.picture.width, shot.picture.height) for shot in shots)
        if len(sizes) != len(self._sizes):
            raise ImageError("one of the lenses' streams gave no picture")
        for now, before in zip(sizes, self._sizes, strict=True):
            if abs(now[0] * before[1] - now[1] * before[0]) > 0.02 * before[1] * now[0]:
                raise ImageError(
                    f"it is {now[0]} x {now[1]}, and the first was {before[0]} x {before[1]}: another camera or mode? "
                    "Set it back, or start again"
                )
        apart = max(shot.stamp for shot in shots) - min(shot.stamp for shot in shots)
        self._broken = None
        if apart > APART:
            self._broken = f"{self._name}: the pictures of its lenses are {apart:.2f} s apart"
        return self._panoramas.make(*self._pictures(shots))

    def _pictures(self, shots: Sequence[Shot]) -> list[np.ndarray]:
        return [to_rgb(shot.picture, *size) for shot, size in zip(shots, self._panoramas.wanted, strict=True)]

    def _warn(self, text: str) -> None:
        """Once for each source and kind of trouble."""
        kind = text[:60]
        if kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(text, UserWarning, stacklevel=3)


def _clock(stamp: float) -> str:
    """The time of day in UTC, such as 13:05:07.250."""
    return time.strftime("%H:%M:%S", time.gmtime(stamp)) + f"{stamp % 1:.3f}"[1:]
