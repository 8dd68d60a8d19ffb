"""Videos for sessions: the next frame that is wanted, with how the camera has turned until then."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from eagor.errors import EagorError
from eagor.media.frames import Frame
from eagor.media.rotation import VisualOdometer
from eagor.media.video import Video
from eagor.studio.orders import LOOKS

__all__ = ["ROWS", "Reel"]

ROWS = 512  # of a frame, at most


@dataclass(eq=False)
class Reel:
    """The frames of a video from `start` on (seconds), `LOOKS` per second at most.

    The camera's rotation is that of the file's motion track, if it has one, else that of the pictures themselves.
    """

    path: Path
    start: float = 0.0
    _video: Video = field(init=False)
    _frames: Iterator[Frame] = field(init=False)
    _odometer: VisualOdometer = field(init=False)

    def __post_init__(self) -> None:
        self._video = Video(self.path, rate=LOOKS, start=self.start, rows=ROWS)
        self._frames, self._odometer = iter(self._video), VisualOdometer()

    def next(self) -> tuple[Frame, np.ndarray, bool] | None:
        """The next frame, the camera's rotation ``(3, 3)`` there, and whether the world starts anew; None at the end.

        Raises `EagorError` for a file that is cut off.
        """
        frame = next(self._frames, None)
        if frame is None:
            return None
        if (motion := self._video.motion) is not None:
            try:
                return frame, motion.world_R_body(frame.stamp), False
            except EagorError:  # the track is shorter than the video
                pass
        turned = self._odometer.add(frame.panorama)
        return frame, np.asarray(turned.world_R_body), turned.lost
