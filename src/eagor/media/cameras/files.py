"""Cameras that are files: a video, or a folder of pictures; with a rig, those of lenses."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator, Sequence
from itertools import pairwise, zip_longest
from pathlib import Path

import numpy as np

from eagor.errors import EagorError, ImageError, TimeError
from eagor.grids import ErpGrid
from eagor.media.cameras.making import Panoramas
from eagor.media.cameras.rig import Rig
from eagor.media.frames import Frame
from eagor.media.motion import MotionTrack
from eagor.media.panorama import read_panorama
from eagor.media.pictures import pictures_in, read_photograph
from eagor.media.said import read_said
from eagor.media.video import Video

__all__ = ["Film", "FolderCamera", "VideoCamera", "lens_videos", "partner_of"]

RATE = 1.0  # pictures per second of a folder whose files do not tell times
APART = 0.02  # seconds by which the pictures of two lenses may differ in time, beside half an interval
_TIME = re.compile(r"\d+\.\d+")  # a file's name without its ending that is a time: 12.350.png
_LENS = re.compile(r"(VID_\d+_\d+_)(00|10)(_\d+\.insv)$", re.IGNORECASE)


def partner_of(path: Path) -> Path | None:
    """The recording of the other lens, as Insta360 names the two of one moment (``_00_``, ``_10_``), if it is there."""
    found = _LENS.search(path.name)
    if found is None:
        return None
    other = path.with_name(path.name[: found.start(2)] + ("10" if found[2] == "00" else "00") + found[3])
    return other if other.is_file() else None


class Film:
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
        files = _lens_files([Path(path) for path in paths], len(rig.sizes))
        settings = {"rate": rate, "start": start, "end": end, "lenses": True}
        videos = [Video(path, track=track, **settings) for path, track in files]
        self.path = str(paths[0])
        self.panoramas = Panoramas(tuple((v.shape[1], v.shape[0]) for v in videos), rig, rows, self.path)
        self._videos = [
            Video(path, track=track, rows=height, **settings)
            for (path, track), (height, _) in zip(files, self.panoramas.wanted, strict=True)
        ]
        first = self._videos[0]
        self.shape, self.unseen = self.panoramas.grid.shape, self.panoramas.unseen
        self.duration, self.frame_rate, self.count = first.duration, first.frame_rate, first.count
        self.facts, self.motion, self.level_R_body = first.facts, first.motion, None

    def __iter__(self) -> Iterator[Frame]:
        for frames in _together(self._videos):
            pictures = (frame.panorama for frame in frames)
            yield Frame(frames[0].stamp, self.panoramas.make(*pictures), frames[0].name)


def lens_videos(
    paths: Sequence[Path], count: int | None = None, *, rate: float | None = None, start: float = 0.0
) -> Iterator[tuple[Frame, ...]]:
    """The lenses' pictures as they are, of each moment of a video; `count`: how many there are, if known.

    Unless it is, a file with several tracks has as many, and of two Insta360 recordings both are taken.
    """
    found = [Path(path) for path in paths]
    if count is None and len(found) == 1 and found[0].is_file():
        tracks = read_said(str(found[0]), lenses=True).tracks
        count = tracks if tracks > 1 else 2 if partner_of(found[0]) else 1
    files = _lens_files(found, len(found) if count is None else count)
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
                "two lenses of one recording. Give the two files of one moment"
            )
        yield frames


def _lens_files(paths: Sequence[Path], count: int) -> list[tuple[Path, int]]:
    """Path and track of each of `count` pictures."""
    if len(paths) == 1 and count > 1:
        if paths[0].is_file() and read_said(str(paths[0]), lenses=True).tracks >= count:
            return [(paths[0], track) for track in range(count)]
        if count == 2 and (other := partner_of(paths[0])) is not None:
            return [(path, 0) for path in sorted([paths[0], other])]
    return [(path, 0) for path in paths]


class VideoCamera:
    """A `CameraSource` of a video file: each iteration begins at its start. `latency` is taken off its stamps."""

    live = False

    def __init__(
        self,
        paths: Sequence[Path],
        *,
        rig: Rig | None = None,
        rows: int | None = None,
        rate: float | None = None,
        latency: float = 0.0,
    ) -> None:
        self.latency, self.dropped, self.problem = latency, 0, None
        self._closed = False
        self.motion: MotionTrack | None = None
        if rig is not None:
            self.video: Film | Video = Film(paths, rig, rate=rate, rows=rows)
        else:
            if len(paths) > 1:
                raise ImageError(f"{len(paths)} files are given, and no rig says how they belong together: --rig FILE")
            self.video = Video(paths[0], rate=rate, rows=rows)
        self._panoramas = (
            None
            if rig is not None
            else Panoramas(((self.video.shape[1], self.video.shape[0]),), None, rows, self.video.path)
        )
        self.grid, self.unseen, self.motion = ErpGrid(*self.video.shape), self.video.unseen, self.video.motion

    def __iter__(self) -> Iterator[Frame]:
        first = True
        for frame in self.video:
            if self._closed:
                return
            if first and self._panoramas is not None:
                self._panoramas.check(frame.panorama)
            first = False
            yield Frame(frame.stamp - self.latency, frame.panorama, frame.name)

    def close(self) -> None:
        self._closed = True


class FolderCamera:
    """A `CameraSource` of folders of pictures, one per picture of the `rig`, in order of their names.

    Stamps: the names, where all are times in seconds with a point (12.350.png); otherwise `rate` pictures per second
    (default: 1), from 0. Pictures that cannot be read or have another shape are left out, counted in `dropped`.
    """

    live = False

    def __init__(
        self,
        folders: Sequence[Path],
        *,
        rig: Rig | None = None,
        rows: int | None = None,
        rate: float | None = None,
        latency: float = 0.0,
    ) -> None:
        self.latency, self.dropped, self.problem = latency, 0, None
        self._closed, self._rig = False, rig
        lists = [pictures_in(Path(folder)) for folder in folders]
        if len({len(each) for each in lists}) > 1:
            counts = ", ".join(f"{len(each)} in {folder}" for each, folder in zip(lists, folders, strict=True))
            raise ImageError(f"the folders of the lenses hold different numbers of pictures: {counts}")
        self._moments = list(zip(*lists, strict=True))
        self._stamps = _stamps([moment[0] for moment in self._moments], RATE if rate is None else rate)
        first = self._read(self._moments[0])
        sizes = tuple((picture.shape[1], picture.shape[0]) for picture in first)
        self._panoramas = Panoramas(sizes, rig, rows, str(folders[0]))
        self._panoramas.check(*first)
        self.grid, self.unseen = self._panoramas.grid, self._panoramas.unseen

    def __iter__(self) -> Iterator[Frame]:
        for moment, stamp in zip(self._moments, self._stamps, strict=True):
            if self._closed:
                return
            try:
                pictures = self._read(moment)
                sizes = tuple((picture.shape[1], picture.shape[0]) for picture in pictures)
                Panoramas(sizes, None, None, str(moment[0])) if self._rig is None else None
                panorama = self._panoramas.make(*pictures)
            except EagorError as error:
                if not self.dropped:
                    warnings.warn(f"a picture is left out: {error}", UserWarning, stacklevel=2)
                self.dropped += 1
                continue
            yield Frame(stamp - self.latency, panorama, moment[0].name)

    def _read(self, moment: tuple[Path, ...]) -> list[np.ndarray]:
        with warnings.catch_warnings():  # of shapes, which are checked here
            warnings.simplefilter("ignore")
            if self._rig is None:
                return [read_photograph(moment[0]).panorama]
            return [read_panorama(path) for path in moment]

    def close(self) -> None:
        self._closed = True


def _stamps(paths: Sequence[Path], rate: float) -> list[float]:
    names = [path.stem for path in paths]
    if len(names) > 1 and all(_TIME.fullmatch(name) for name in names):
        stamps = [float(name) for name in names]
        if any(later <= earlier for earlier, later in pairwise(stamps)):
            raise TimeError(f"{paths[0].parent}: its names are times, and do not increase; rename the pictures")
        return stamps
    if not (math.isfinite(rate) and rate > 0):
        raise TimeError(f"rate = {rate!r}; wanted pictures per second, more than 0")
    return [number / rate for number in range(len(names))]
