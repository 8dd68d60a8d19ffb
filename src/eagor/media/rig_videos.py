"""Videos, and videos of a camera with lenses, which are stitched: one panorama a moment, masked where no lens sees."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

from eagor.cameras import Rig
from eagor.errors import ImageError
from eagor.media import Frame
from eagor.media.animations import Animation, is_animation
from eagor.media.intrinsics import IntrinsicsHint
from eagor.media.stitching import PanoramaBuilder
from eagor.media.video import Video, tracks_of

__all__ = ["StitchedVideo", "lens_videos", "open_video"]

APART = 0.02  # seconds by which the pictures of two lenses may differ in time, beside half an interval
_LENS = re.compile(r"(VID_\d+_\d+_)(00|10)(_\d+\.insv)$", re.IGNORECASE)


def open_video(paths: Sequence[Path], rig: Rig | None = None, **taken: Any) -> Video | Animation | StitchedVideo:
    """A video of panoramas or of an ordinary camera; or of the lenses of a `rig`, in a file, or one for each picture.

    `taken`: rate, start, end, rows, as of `eagor.media.video.Video`. Raises `ImageError`, also for files that do not
    belong to the rig.
    """
    if rig is not None:
        return StitchedVideo(paths, rig, **taken)
    if len(paths) > 1:
        raise ImageError(f"{len(paths)} files are given, and no rig says how they belong together: --rig FILE")
    return (Animation if is_animation(paths[0]) else Video)(paths[0], **taken)


def lens_videos(paths: Sequence[Path], count: int | None = None, **taken: Any) -> Iterator[tuple[Frame, ...]]:
    """The lenses' pictures as they are, of each moment of a video; `count`: how many there are, if known."""
    yield from _together([Video(path, track=track, lenses=True, **taken) for path, track in _files(paths, count)])


def _files(paths: Sequence[Path], count: int | None) -> list[tuple[Path, int]]:
    """Path and track of each of `count` pictures: files of their own, tracks of one, or a file and its partner.

    None: as many as a file has tracks, or it and its partner: the recording of the other lens, as Insta360 names the
    two of one moment (``_00_``, ``_10_``).
    """
    first, *others = map(Path, paths)
    if others or count == 1 or not first.is_file():
        return [(path, 0) for path in (first, *others)]
    tracks = tracks_of(first)
    if tracks > 1 and tracks >= (count or 0):
        return [(first, track) for track in range(count or tracks)]
    if count in (None, 2) and (found := _LENS.search(first.name)) is not None:
        other = f"{found[1]}{'10' if found[2] == '00' else '00'}{found[3]}"
        others = [each for each in [first.with_name(first.name[: found.start()] + other)] if each.is_file()]
    return [(path, 0) for path in sorted([first, *others])]


def _together(videos: Sequence[Video]) -> Iterator[tuple[Frame, ...]]:
    """The frames of several lenses at each moment. Raises `ImageError` where their times differ."""
    interval = 1 / (videos[0].frame_rate or 25.0)
    for frames in zip_longest(*videos):
        if None in frames:
            name = videos[0].path
            raise ImageError(f"{name}: the video of one lens ends before that of the other; what both have was taken")
        stamps = [frame.stamp for frame in frames]
        if max(stamps) - min(stamps) > interval / 2 + APART:
            raise ImageError(
                f"{frames[0].name} and {frames[1].name} are {max(stamps) - min(stamps):.3f} s apart: these are not the "
                "lenses of one recording. Give the files of one moment"
            )
        yield frames


class StitchedVideo:
    """A video of lenses, stitched: iterate over it as over `eagor.media.video.Video`, and with the same attributes.

    `paths`: one file, or one per picture of the `rig`. One file may also hold a track for each picture, and of two
    Insta360 recordings of the same moment one path is enough. `rows`: the most rows of the panoramas; `taken`: rate,
    start, end as of `Video`. Raises `ImageError`, also where the pictures do not fit the rig.
    """

    level_R_body, hint = None, IntrinsicsHint()

    def __init__(self, paths: Sequence[Path], rig: Rig, *, rows: int | None = None, **taken: Any) -> None:
        self.path, files = str(paths[0]), _files(paths, len(rig.sizes))
        videos = [Video(path, track=track, lenses=True, **taken) for path, track in files]
        sizes = [(video.shape[1], video.shape[0]) for video in videos]
        self.builder = PanoramaBuilder(sizes, self.path, rig=rig, rows=rows)
        self._videos = [
            Video(path, track=track, lenses=True, rows=height, **taken)
            for (path, track), (height, _) in zip(files, self.builder.wanted, strict=True)
        ]
        first = self._videos[0]
        self.shape, self.unseen, self.facts = self.builder.grid.shape, self.builder.unseen, first.facts
        self.duration, self.frame_rate, self.count, self.motion = (
            first.duration, first.frame_rate, first.count, first.motion,
        )  # fmt: skip

    def __iter__(self) -> Iterator[Frame]:
        for frames in _together(self._videos):
            pictures = (frame.picture for frame in frames)
            yield Frame(frames[0].stamp, self.builder.make(*pictures), frames[0].name)
