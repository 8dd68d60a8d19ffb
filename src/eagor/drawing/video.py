"""A track as a video: each frame with the belief, the answer in words, and the time line so far."""

from __future__ import annotations

import math
from pathlib import Path
from types import TracebackType

import numpy as np

from eagor.drawing.animation import ANIMATIONS, Animation
from eagor.drawing.movies import VIDEOS, Movie
from eagor.drawing.step import DESIGN, StepPainter
from eagor.errors import EagorError, StorageError
from eagor.tracking.estimate import Estimate

__all__ = ["BeliefVideo"]

SMALL = 760  # columns of an animated picture, unless told


class BeliefVideo:
    """Writes the steps of a track to `path`, as pictures of `StepPainter`, each shown at its own time.

    mp4 and mkv (H.264, or MPEG-4 where PyAV lacks it) and webm (VP9) need the extra ``photos``; webp and gif do not,
    and hold at most 240 pictures. Use it as a context manager. The file takes its place when it is closed, also after
    Ctrl-C or an error: it then holds the pictures so far. Without pictures no file is written, and an old one stays.

    Args:
        path: the file; its suffix chooses the format.
        rate: pictures per second that will come, if known; the last picture is shown for so long if it is alone.
        size: width in pixels, 320 to 3840, made even; default 1280, or 760 for webp and gif. The height is two thirds
            of it: the panorama, the answer above it and the time line below.
        span: length of the clip in seconds, for the time line; None: the time line grows.

    Raises `EagorError` for an unknown suffix, an impossible rate or size, a folder that does not exist; `StorageError`
    if that cannot be written to; `MissingExtraError` without PyAV.
    """

    def __init__(
        self, path: str | Path, *, rate: float | None = None, size: int | None = None, span: float | None = None
    ) -> None:
        self.path = Path(path)
        video, rate = _kind(self.path) in VIDEOS, _checked(rate)
        self.painter = StepPainter(size or (DESIGN if video else SMALL), span)
        folder = self.path.absolute().parent
        if not folder.is_dir():
            raise EagorError(f"{self.path} cannot be written: there is no folder {folder}; make it first")
        if self.path.is_dir():
            raise EagorError(f"{self.path} is a folder; name a file")
        whole = (self.painter.width, self.painter.height)
        self._movie = Movie(self.path, whole, rate) if video else Animation(self.path, rate)

    @property
    def count(self) -> int:
        """Pictures in the file so far; of a webp or gif, those that will be in it."""
        return self._movie.count

    def add(
        self,
        panorama: np.ndarray | None,
        estimate: Estimate,
        *,
        stamp: float | None = None,
        query: str = "",
        problem: str | None = None,
    ) -> None:
        """Append one step; arguments as for `StepPainter.paint`. Stamps grow.

        Raises `TimeError` for a stamp that is not later than the last one, `StorageError` when there is no more room:
        the file then holds the pictures before.
        """
        picture = self.painter.paint(panorama, estimate, stamp=stamp, query=query, problem=problem)
        self._movie.add(picture, self.painter.line.now)

    def close(self) -> None:
        """Finish the file. Raises `StorageError`."""
        self._movie.close()

    def __enter__(self) -> BeliefVideo:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except StorageError:
            if error is None:  # else the first error says what was wrong
                raise


def _kind(path: Path) -> str:
    """The suffix of a movie that can be written, in lower case. Raises `EagorError` for any other."""
    suffix = path.suffix.lower()
    if suffix not in VIDEOS and suffix not in ANIMATIONS:
        raise EagorError(
            f"{path} ends in {suffix or 'nothing'}; wanted a video ({', '.join(VIDEOS)}) or a moving picture "
            f"({', '.join(ANIMATIONS)})"
        )
    return suffix


def _checked(rate: float | None) -> float | None:
    """Pictures per second. Raises `EagorError` unless above 0."""
    if rate is not None and not (math.isfinite(rate) and rate > 0):
        raise EagorError(f"{rate} pictures per second; wanted a number above 0")
    return rate
