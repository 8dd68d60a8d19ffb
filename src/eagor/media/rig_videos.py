"""Videos, and videos of a camera with lenses, which are stitched: one panorama a moment, masked where no lens sees."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

from eagor.cameras import Rig
from eagor.errors import ImageError
from eagor.media import Frame
from eagor.media.animations import Animation, is_animation
from eagor.media.intrinsics import IntrinsicsHint
from eagor.media.stitching import PanoramaBuilder
from eagor.media.video import Video, tracks_of

__all__ = ["StitchedVideo", "lens_files", "lens_videos", "open_video", "partner_of"]

APART = 0.02  # seconds by which the pictures of two lenses may differ in time, beside half an interval
_LENS = re.compile(r"(VID_\d+_\d+_)(00|10)(_\d+\.insv)$", re.IGNORECASE)


def open_video(
    paths: Sequence[Path],
    rig: Rig | None = None,
    *,
    rate: float | None = None,
    start: float = 0.0,
    end: float | None = None,
    rows: int | None = None,
) -> Video | Animation | StitchedVideo:
    """A video of panoramas or of an ordinary camera; or of the lenses of a `rig`, in a file, or one for each picture.

    The rest as for `eagor.media.video.Video`. Raises `ImageError`, also for files that do not belong to the rig.
    """
    if rig is not None:
        return StitchedVideo(paths, rig, rate=rate, start=start, end=end, rows=rows)
    if len(paths) > 1:
        raise ImageError(f"{len(paths)} files are given, and no rig says how they belong together: --rig FILE")
    kind = Animation if is_animation(paths[0]) else Video
    return kind(paths[0], rate=rate, start=start, end=end, rows=rows)


def partner_of(path: Path) -> Path | None:
    """The recording of the other lens, as Insta360 names the two of one moment (``_00_``, ``_10_``), if it is there."""
    found = _LENS.search(path.name)
    if found is None:
        return None
    other = path.with_name(path.name[: found.start(2)] + ("10" if found[2] == "00" else "00") + found[3])
    return other if other.is_file() else None


def lens_files(paths: Sequence[Path], count: int | None) -> list[tuple[Path, int]]:
    """Path and track of each of `count` pictures: files of their own, tracks of one, or a file and its partner.

    None: as many as a file has tracks, or it and its partner.
    """
    if len(paths) > 1 or count == 1 or not paths[0].is_file():
        return [(path, 0) for path in paths]
    tracks, other = tracks_of(paths[0]), partner_of(paths[0])
    if tracks > 1 and tracks >= (count or 0):
        return [(paths[0], track) for track in range(count or tracks)]
    both = [paths[0]] if other is None or count not in (None, 2) else sorted([paths[0], other])
    return [(path, 0) for path in both]


def lens_videos(
    paths: Sequence[Path], count: int | None = None, *, rate: float | None = None, start: float = 0.0
) -> Iterator[tuple[Frame, ...]]:
    """The lenses' pictures as they are, of each moment of a video; `count`: how many there are, if known."""
    files = lens_files([Path(path) for path in paths], count)
    yield from _together([Video(path, track=track, lenses=True, rate=rate, start=start) for path, track in files])


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
    Insta360 recordings of the same moment one path is enough. `rows`: the most rows of the panoramas; `rate`, `start`,
    `end`: as for `Video`. Raises `ImageError`, also where the pictures do not fit the rig.
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
        self.path = str(paths[0])
        videos = [Video(path, track=track, lenses=True, rate=rate, start=start, end=end) for path, track in files]
        sizes = [(video.shape[1], video.shape[0]) for video in videos]
        self.builder = PanoramaBuilder(sizes, self.path, rig=rig, rows=rows)
        self._videos = [
            Video(path, track=track, lenses=True, rate=rate, start=start, end=end, rows=height)
            for (path, track), (height, _) in zip(files, self.builder.wanted, strict=True)
        ]
        first = self._videos[0]
        self.shape, self.unseen = self.builder.grid.shape, self.builder.unseen
        self.duration, self.frame_rate, self.count = first.duration, first.frame_rate, first.count
        self.facts, self.motion, self.level_R_body, self.hint = first.facts, first.motion, None, IntrinsicsHint()

    def __iter__(self) -> Iterator[Frame]:
        for frames in _together(self._videos):
            pictures = (frame.picture for frame in frames)
            yield Frame(frames[0].stamp, self.builder.make(*pictures), frames[0].name)
