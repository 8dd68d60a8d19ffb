"""Videos of a camera with lenses: stitched to panoramas, or picture by picture, each with the grid of its lens.

Pictures of ordinary lenses need no panorama in between (`LensVideos`): a picture is what its lens saw at its own time.
So the lenses need not be synchronous, they may overlap or leave gaps, and nothing is resampled. Where a rig has a
fisheye, or several lenses share a picture, or whoever looks knows panoramas alone, it is stitched (`StitchedVideo`).
"""

from __future__ import annotations

import heapq
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path

import numpy as np

from eagor.errors import ImageError
from eagor.grids import PerspectiveGrid
from eagor.lenses import PinholeLens
from eagor.media import Frame
from eagor.media.animations import Animation, is_animation
from eagor.media.intrinsics import PLANE_WIDEST, Camera, Told, ordinary_grid
from eagor.media.metadata import read_metadata
from eagor.media.rigs import Rig
from eagor.media.stitching import Panoramas
from eagor.media.video import Video

__all__ = [
    "LensVideos", "StitchedVideo", "are_ordinary", "lens_files", "lens_videos", "made_of", "makers", "open_video",
    "ordinary_cameras", "partner_of",
]  # fmt: skip

APART = 0.02  # seconds by which the pictures of two lenses may differ in time, beside half an interval
_LENS = re.compile(r"(VID_\d+_\d+_)(00|10)(_\d+\.insv)$", re.IGNORECASE)


def open_video(
    paths: Sequence[Path],
    rig: Rig | None = None,
    *,
    stitched: bool = False,
    rate: float | None = None,
    start: float = 0.0,
    end: float | None = None,
    rows: int | None = None,
) -> Video | Animation | StitchedVideo | LensVideos:
    """A video of panoramas or of an ordinary camera; or of the lenses of a `rig`, in a file, or one for each picture.

    Pictures of ordinary lenses (`are_ordinary`) come as they are, each with its grid, unless `stitched`. The rest as
    for `eagor.media.video.Video`. Raises `ImageError`, also for files that do not belong to the rig.
    """
    if rig is None:
        if len(paths) > 1:
            raise ImageError(f"{len(paths)} files are given, and no rig says how they belong together: --rig FILE")
        kind = Animation if is_animation(paths[0]) else Video
        return kind(paths[0], rate=rate, start=start, end=end, rows=rows)
    if len(paths) > len(rig.sizes):
        raise ImageError(f"{len(paths)} videos are given, and the rig is for {len(rig.sizes)}; give one per lens")
    kind = StitchedVideo if stitched or not are_ordinary(rig) else LensVideos
    return kind(paths, rig, rate=rate, start=start, end=end, rows=rows)


def are_ordinary(rig: Rig) -> bool:
    """Whether each picture of the rig is that of one ordinary lens, which need not be stitched."""
    alone = sorted(lens.picture for lens in rig.lenses) == list(range(len(rig.sizes)))
    return alone and all(
        isinstance(lens, PinholeLens) and PerspectiveGrid.of_lens(lens).hfov <= PLANE_WIDEST for lens in rig.lenses
    )


def ordinary_cameras(rig: Rig) -> tuple[Camera, ...]:
    """The lenses of a rig (`are_ordinary`) as cameras of their own, in the order of their pictures."""
    lenses = sorted(rig.lenses, key=lambda lens: lens.picture)
    sizes = (rig.sizes[lens.picture] for lens in lenses)
    return tuple(
        Camera(Rig((size,), (replace(lens, picture=0),)), name=f"the lens {lens.name!r} of the rig")
        for lens, size in zip(lenses, sizes, strict=True)
    )


def makers(
    sizes: tuple[tuple[int, int], ...],
    rig: Rig | None,
    rows: int | None,
    name: str,
    camera: Camera | None = None,
    stitched: bool = False,
) -> list[Panoramas]:
    """What makes frames of the pictures of one moment: one for all, or one for each of a rig's ordinary lenses.

    The latter unless `stitched`; the rest as for `eagor.media.stitching.Panoramas`, with its errors.
    """
    if rig is None or stitched or not are_ordinary(rig) or len(sizes) != len(rig.sizes):
        return [Panoramas(sizes, rig, rows, name, camera)]
    cameras = ordinary_cameras(rig)
    return [Panoramas((size,), None, rows, name, each) for size, each in zip(sizes, cameras, strict=True)]


def made_of(made_by: Sequence[Panoramas], pictures: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The frames that `makers` make of the pictures ``(H, W, 3)`` uint8 of one moment. Raises `ImageError`."""
    if len(made_by) == 1:
        return [made_by[0].make(*pictures)]
    return [each.make(picture) for each, picture in zip(made_by, pictures, strict=True)]


# --- which files belong together ---


def partner_of(path: Path) -> Path | None:
    """The recording of the other lens, as Insta360 names the two of one moment (``_00_``, ``_10_``), if it is there."""
    found = _LENS.search(path.name)
    if found is None:
        return None
    other = path.with_name(path.name[: found.start(2)] + ("10" if found[2] == "00" else "00") + found[3])
    return other if other.is_file() else None


def lens_files(paths: Sequence[Path], count: int) -> list[tuple[Path, int]]:
    """Path and track of each of `count` pictures: files of their own, tracks of one, or a file and its partner."""
    if len(paths) == 1 and count > 1:
        if paths[0].is_file() and read_metadata(str(paths[0]), lenses=True).tracks >= count:
            return [(paths[0], track) for track in range(count)]
        if count == 2 and (other := partner_of(paths[0])) is not None:
            return [(path, 0) for path in sorted([paths[0], other])]
    return [(path, 0) for path in paths]


def lens_videos(
    paths: Sequence[Path], count: int | None = None, *, rate: float | None = None, start: float = 0.0
) -> Iterator[tuple[Frame, ...]]:
    """The lenses' pictures as they are, of each moment of a video; `count`: how many there are, if known.

    Unless it is, a file with several tracks has as many, and of two Insta360 recordings both are taken.
    """
    found = [Path(path) for path in paths]
    if count is None and len(found) == 1 and found[0].is_file():
        tracks = read_metadata(str(found[0]), lenses=True).tracks
        count = tracks if tracks > 1 else 2 if partner_of(found[0]) else 1
    files = lens_files(found, len(found) if count is None else count)
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


# --- the two ways to look at them ---


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
        self.facts, self.motion, self.level_R_body, self.told = first.facts, first.motion, None, Told()

    def __iter__(self) -> Iterator[Frame]:
        for frames in _together(self._videos):
            pictures = (frame.picture for frame in frames)
            yield Frame(frames[0].stamp, self.panoramas.make(*pictures), frames[0].name)


class LensVideos:
    """Videos of a rig's ordinary lenses: iterate for each picture of each lens, in order of time, with its grid.

    `paths`: one video with a track for each picture of the `rig`, or as many videos; they begin at the same moment.
    `rate`, `start`, `end`, `rows`: as for `eagor.media.video.Video`, of each lens. The attributes are those of a video;
    `shape` is that of the first lens' pictures. Raises `ImageError`, also where the pictures do not fit the rig.
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
        self.grids = [_grid(*each) for each in zip(ordinary_cameras(rig), self.videos, strict=True)]
        first, counts = self.videos[0], [video.count for video in self.videos]
        self.path, self.shape, self.facts, self.duration = first.path, first.shape, first.facts, first.duration
        self.motion, self.unseen, self.level_R_body, self.told = first.motion, None, None, Told()
        self.frame_rate = first.frame_rate
        self.count = None if None in counts else sum(count for count in counts if count is not None)

    def __iter__(self) -> Iterator[Frame]:
        for _, _, frame in heapq.merge(*map(self._of, range(len(self.videos)))):
            yield frame

    def moment(self) -> list[Frame]:
        """The first picture of each lens, in the order of the rig. Raises `ImageError` where there is none."""
        found = [next(self._of(lens), None) for lens in range(len(self.videos))]
        if None in found:
            raise ImageError(f"{self.videos[found.index(None)].path} has no picture from there on")
        return [each[2] for each in found if each is not None]

    def _of(self, lens: int) -> Iterator[tuple[float, int, Frame]]:
        for frame in self.videos[lens]:
            yield frame.stamp, lens, replace(frame, grid=self.grids[lens], lens=lens)


def _grid(camera: Camera, video: Video) -> PerspectiveGrid:
    """The pixels of a lens in its video. Raises `ImageError` where they have another shape."""
    grid = ordinary_grid(camera, video.told, (video.shape[1], video.shape[0]), video.path)
    assert grid is not None  # it is calibrated
    return grid
