"""Videos of a rig's ordinary lenses, looked at picture by picture: no panorama in between.

A picture is what its lens saw at its own time, with its own grid. So the lenses need not be synchronous, they may
overlap or leave gaps, and nothing is resampled. Where a rig has a fisheye, or several lenses share a picture, it is
stitched instead (`eagor.media.camera_sources.StitchedVideo`).
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from eagor.errors import ImageError
from eagor.grids import PerspectiveGrid
from eagor.lenses import Lens, PinholeLens
from eagor.media.camera_sources import lens_files
from eagor.media.footage import Read
from eagor.media.intrinsics import PLANE_WIDEST
from eagor.media.panorama import Picture
from eagor.media.rigs import Rig
from eagor.media.video import Video

__all__ = ["LensVideos", "are_ordinary"]


def are_ordinary(rig: Rig) -> bool:
    """Whether each picture of the rig is that of one ordinary lens, which need not be stitched."""
    alone = sorted(lens.picture for lens in rig.lenses) == list(range(len(rig.sizes)))
    return alone and all(
        isinstance(lens, PinholeLens) and PerspectiveGrid.of_lens(lens).hfov <= PLANE_WIDEST for lens in rig.lenses
    )


class LensVideos:
    """`Frames` of a rig's ordinary lenses, in order of time: each picture with the grid of its lens in the body.

    `paths`: one video with a track for each picture of the `rig`, or as many videos; they begin at the same moment.
    `rate`, `start`, `end`, `rows`: as for `eagor.media.video.Video`, of each lens. The attributes are those of a video.
    Raises `ImageError`, also where the pictures do not fit the rig.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        rig: Rig,
        *,
        rate: float | None = None,
        start: float = 0.0,
        end: float | None = None,
        rows: int | None = None,
    ) -> None:
        files = lens_files([Path(path) for path in paths], len(rig.sizes))
        if len(files) != len(rig.sizes):
            raise ImageError(
                f"{len(files)} videos are given, and the rig lists {len(rig.sizes)} pictures; wanted a video for each, "
                "in its order"
            )
        self.videos = [
            Video(path, track=track, lenses=True, rate=rate, start=start, end=end, rows=rows) for path, track in files
        ]
        lenses = sorted(rig.lenses, key=lambda lens: lens.picture)
        self.grids = [_grid(*each) for each in zip(lenses, self.videos, strict=True)]
        first, counts = self.videos[0], [video.count for video in self.videos]
        self.path, self.facts, self.duration, self.motion = first.path, first.facts, first.duration, first.motion
        self.count = None if None in counts else sum(count for count in counts if count is not None)

    @property
    def level_R_body(self) -> np.ndarray | None:
        """None: the files of a rig's lenses do not say it."""
        return None

    def frames(self) -> Iterator[tuple[float, str, Read]]:
        """Each picture of each lens: its stamp, its name, and what gives it."""
        for stamp, _, name, found in heapq.merge(*map(self._of, range(len(self.videos)))):
            yield stamp, name, lambda found=found: found

    def _of(self, index: int) -> Iterator[tuple[float, int, str, Picture]]:
        for frame in self.videos[index]:
            yield frame.stamp, index, frame.name, Picture(frame.picture, grid=self.grids[index])


def _grid(lens: Lens, video: Video) -> PerspectiveGrid:
    """The pixels of a lens in its video. Raises `ImageError` where they have another shape."""
    assert isinstance(lens, PinholeLens)  # `are_ordinary`
    height, width = video.shape
    Rig((lens.size,), (replace(lens, picture=0),)).factor_of(((width, height),), video.path)
    return PerspectiveGrid.of_lens(lens).resized(height, width)
