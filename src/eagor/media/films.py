"""Recordings beside plain videos: pictures that move (GIF, APNG, WebP, AVIF; by Pillow), and videos of a rig's lenses.

The lenses' pictures of a moment are stitched to one panorama, masked where no lens sees.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

from eagor.cameras import Rig
from eagor.errors import ImageError, TimeError
from eagor.media import Frame
from eagor.media.intrinsics import IntrinsicsHint
from eagor.media.panorama import Picture, decoded_bytes, opened, photograph_of, shrunk_picture
from eagor.media.stitching import PanoramaBuilder
from eagor.media.video import Video, selected, tracks_of

__all__ = ["Animation", "StitchedVideo", "is_animation", "lens_videos", "open_video"]

KINDS = ("GIF", "PNG", "WEBP", "AVIF")  # the pages of a TIFF, or of an MPO, are not pictures one after the other
SHORTEST, USUAL = 0.0101, 0.1  # seconds: shorter ones are shown as long as this, as browsers do
LARGEST = 1 << 29  # bytes of a picture in memory


def is_animation(path: str | os.PathLike[str]) -> bool:
    """Whether the file is a picture that moves."""
    try:
        with opened(path) as image:
            return image.format in KINDS and getattr(image, "n_frames", 1) > 1
    except Exception:  # Pillow may raise anything for what is no picture
        return False


class Animation:
    """The pictures of a picture that moves, with their times: as `eagor.media.video.Video`, with the same attributes.

    What is transparent in the first picture counts as not seen. Raises `ImageError`, `TimeError`.
    """

    duration = count = motion = None
    hint = IntrinsicsHint()

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        rate: float | None = None,
        start: float = 0.0,
        end: float | None = None,
        rows: int | None = None,
    ) -> None:
        self.path, self._rows, self._taken = os.fspath(path), rows, (start, end, rate)
        found, lasts = next(self._all(), (0.0, (None, 0.0)))[1]
        if found is None:
            raise ImageError(f"{self.path} holds no picture that can be read; fetch or export it again")
        self.shape, self.unseen, self.level_R_body = found.picture.shape[:2], found.unseen, found.level_R_body
        self.frame_rate: float | None = 1 / lasts
        with opened(self.path) as image:
            about = f"{image.format}, {image.width} x {image.height} pixels, {image.n_frames} pictures"  # type: ignore[attr-defined]
        self.facts = (f"{about}, one after the other", *found.facts)

    def __iter__(self) -> Iterator[Frame]:
        stamp = None
        for stamp, (found, _) in selected(self._all(), *self._taken, 1e-6):
            yield Frame(stamp, found.picture, f"{os.path.basename(self.path)} at {stamp:.2f} s")
        if stamp is None:
            raise TimeError(f"{self.path} has no picture from {self._taken[0]:g} s on; it ends before that")

    def _all(self) -> Iterator[tuple[float, tuple[Picture, float]]]:
        """Time and picture of each, and for how long it is shown; raises `ImageError` where it is damaged."""
        stamp = 0.0
        try:
            with opened(self.path) as image:
                if decoded_bytes(image) > LARGEST:
                    raise ImageError(
                        f"{self.path} claims {image.width} x {image.height} pixels; it is corrupt, or large"
                    )
                # Of an APNG the first may be one for programs that know no animations.
                for number in range(int(bool(image.info.get("default_image"))), image.n_frames):  # type: ignore[attr-defined]
                    image.seek(number)
                    image.load()
                    lasts = float(image.info.get("duration") or 0) / 1000
                    lasts = lasts if lasts >= SHORTEST else USUAL
                    yield stamp, (shrunk_picture(photograph_of(image, self.path), self._rows), lasts)
                    stamp += lasts
        except ImageError:
            raise
        except Exception as error:  # Pillow's decoders may raise anything for damaged files
            what = f"its picture after {stamp:.2f} s cannot be read ({type(error).__name__}: {error})"
            raise ImageError(f"{self.path} is damaged: {what}; fetch or export it again") from error


# --- videos of lenses ---

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
