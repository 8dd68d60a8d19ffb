"""Frames of footage in order of time: images, a video, the pictures of a bag; each read when it is its turn.

A long video needs no more memory than a short one. Frames are whole panoramas, are stitched from pictures of lenses, or
are ordinary pictures with the grid of their lens.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from eagor.cameras import Rig
from eagor.errors import EagorError, ImageError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.media import Frame
from eagor.media.animations import is_animation
from eagor.media.bag_sources import BagCamera
from eagor.media.defects import TWICE, problems, two_eyes
from eagor.media.intrinsics import Camera, IntrinsicsHint, ShapeError, in_words, intrinsics_from_exif
from eagor.media.panorama import (
    IMAGES,
    Picture,
    in_order,
    is_whole,
    pictures_in,
    read_panorama,
    read_photograph,
    resized,
    resized_mask,
)
from eagor.media.rig_videos import StitchedVideo
from eagor.media.stitching import PanoramaBuilder, sizes_of
from eagor.media.video import plays
from eagor.odometry.times import times_of

__all__ = [
    "LEAST_ROWS", "VIDEOS", "BagFrames", "Footage", "FrameCheck", "ImageFrames", "LensPictures", "Read", "ShapeError",
    "VideoFrames", "images", "is_video",
]  # fmt: skip

VIDEOS = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".insv", ".avi", ".ts", ".mpg", ".mpeg", ".360")  # without a look
RATE = 1.0  # pictures per second where nothing tells
LEAST_ROWS = 960  # of a video's frames: enough to look nice, and little memory

NOTHING = IntrinsicsHint()
Read = Callable[[], Picture]  # gives a picture, or raises `EagorError`
Item = tuple[float, str, Read]  # of a frame: its stamp (seconds), its name, its picture
Say = Callable[[str], object]


@dataclass
class FrameCheck:
    """Has `PanoramaBuilder` say what each frame is, and lay it out as that.

    `say` gets facts that files tell, and what looks odd, once. `force`: pictures that are not 2:1 are panoramas, and
    circles are looked at. Without a `camera` all have to be panoramas; with one that knows nothing itself, those that
    are not have a lens that files tell.
    """

    force: bool = False
    say: Say = lambda text: None
    camera: Camera | None = None
    _looked: bool = False
    _builders: dict[Any, PanoramaBuilder] = field(default_factory=dict)

    def read(self, path: Path) -> Picture:
        """The picture in a file, and what the file says of it; raises `ImageError`, and as the check of a frame."""
        return self(read_photograph(path, warn=False, force=self.force), str(path), intrinsics_from_exif(path))

    def builder(self, size: tuple[int, int], name: str, hint: IntrinsicsHint) -> PanoramaBuilder:
        """What makes frames of pictures of a `size` (width, height); errors as of `PanoramaBuilder`."""
        hint = NOTHING if self.camera is None else hint
        if (size, hint) not in self._builders:
            made = PanoramaBuilder([size], name, camera=self.camera, hint=hint, force=self.force)
            self._builders[size, hint] = made
        return self._builders[size, hint]

    def __call__(self, frame: Picture, name: str, hint: IntrinsicsHint = NOTHING) -> Picture:
        """`frame`, as a panorama, or with the grid of an ordinary picture; `hint`: what its file says of the lens.

        Raises `ShapeError` as `PanoramaBuilder` does.
        """
        eyes, view, words = self.camera is not None and self.camera.eyes is not None, None, ""
        if eyes or frame.unseen is None or not is_whole(frame.picture):  # else its file says where it is
            try:
                builder = self.builder(sizes_of([frame.picture])[0], name, hint)
            except ShapeError as error:  # of any shape, two eyes are told by their likeness
                twice = two_eyes(frame.picture)
                raise ShapeError(f"{name} {TWICE[twice]}" if twice else str(error)) from error
            if not self._looked:
                builder.check(frame.picture)
            picture, view = builder.make(frame.picture), builder.view
            if view is not None or builder.rig is not None:
                words = in_words((self.camera and self.camera.name) or hint.source, view)
            frame = replace(frame, picture=picture, unseen=builder.hidden(frame.unseen), grid=view)
        if not self._looked:
            self._looked = True  # not before: who reads a frame again that was refused is told again
            odd = () if words or frame.unseen is not None else problems(frame.picture)  # a part has no seam
            if not words and not is_whole(frame.picture):
                high, wide = frame.picture.shape[:2]
                odd = (f"it is {wide} x {high}, not 2:1; accepted, with all columns for 360 degrees, all rows for 180",)
            for fact in (*filter(None, [words]), *frame.facts, *(hint.facts if view is not None else ())):
                self.say(fact if fact.startswith("warning: ") else f"{name}: {fact}")
            for problem in odd:
                self.say(f"warning: {name}: {problem}")
        return frame


@dataclass(frozen=True)
class ImageFrames:
    """Pictures in files, `rate` per second; `read` gives one of them.

    `stamps`: when the pictures were taken, if that is known.
    """

    paths: tuple[Path, ...]
    rate: float
    read: Callable[[Path], Picture]
    stamps: tuple[float, ...] = ()
    level_R_body = motion = None
    begins = 0.0

    @property
    def count(self) -> int:
        return len(self.paths)

    def items(self) -> Iterator[Item]:
        for number, path in enumerate(self.paths):
            yield self.stamps[number] if self.stamps else number / self.rate, path.name, partial(self.read, path)


@dataclass(frozen=True)
class VideoFrames:
    """The frames of a video, as `eagor.media.rig_videos.open_video` gives it."""

    video: Any
    check: FrameCheck
    begins = 0.0

    @property
    def level_R_body(self) -> np.ndarray | None:
        return self.video.level_R_body

    @property
    def motion(self) -> Any:
        return self.video.motion

    def items(self) -> Iterator[Item]:
        for frame in self.video:
            found = Picture(frame.picture, self.video.unseen)
            yield frame.stamp, frame.name, partial(self.check, found, frame.name, self.video.hint)


@dataclass(frozen=True)
class BagFrames:
    """The pictures of a bag's `camera`, `rate` per second, from `start` to `end` (seconds from the first).

    Stamps are those of the messages' headers.
    """

    camera: BagCamera
    check: FrameCheck
    rate: float | None = None
    start: float = 0.0
    end: float | None = None
    level_R_body = motion = None

    @property
    def begins(self) -> float:
        return self.camera.begins

    def items(self) -> Iterator[Item]:
        tick = -math.inf
        for stamp, read in self.camera.pictures():
            at = stamp - self.begins
            if at < self.start:
                continue
            if self.end is not None and at > self.end:
                return
            if self.rate is not None:
                if (number := math.floor(at * self.rate + 1e-6)) <= tick:
                    continue
                tick = number
            name = f"{self.camera.topics[0]} at {stamp:.3f} s"
            yield stamp, name, partial(self._checked, read, name)

    def _checked(self, read: Callable[[], np.ndarray], name: str) -> Picture:
        if self.camera.view is not None:
            return Picture(read(), grid=self.camera.view)
        return self.check(Picture(read(), self.camera.unseen), name)


class Footage:
    """A `CameraSource` of recorded pictures: of files, a video or a bag; each is read and checked when it is its turn.

    One that cannot be used comes without a picture, with the `problem`. `rows`: the most rows; larger pictures are
    shrunk. `latency` is taken off the stamps. `begins`: the stamp of the first picture of a bag, else 0. Iterating
    raises what ends the footage, and `ShapeError` if it is the first picture that has the wrong shape.
    """

    live = False

    def __init__(self, frames: ImageFrames | VideoFrames | BagFrames, latency: float = 0.0, rows: int | None = None):
        self.frames, self.latency, self.rows, self.dropped, self.problem = frames, latency, rows, 0, None
        self._closed = False

    @property
    def begins(self) -> float:
        return self.frames.begins - self.latency

    @property
    def level_R_body(self) -> np.ndarray | None:
        """The rotation ``(3, 3)`` that makes the first picture level, if the file says so."""
        return self.frames.level_R_body

    @property
    def motion(self) -> Any:
        """The `MotionTrack` of a video's IMU, if it has one."""
        return self.frames.motion

    @property
    def ordinary(self) -> bool:
        """Whether its pictures are those of an ordinary camera, as far as that is known without one."""
        frames = self.frames
        if isinstance(frames, BagFrames):
            return frames.camera.view is not None
        if isinstance(frames, VideoFrames) and not isinstance(frames.video, StitchedVideo):
            high, wide = frames.video.shape
            return frames.check.builder((wide, high), frames.video.path, frames.video.hint).view is not None
        return False

    @property
    def bag(self) -> BagCamera | None:
        """The camera of a bag, if it is one."""
        return self.frames.camera if isinstance(self.frames, BagFrames) else None

    @property
    def grid(self) -> ErpGrid | PerspectiveGrid:
        """The pixels of its first picture."""
        first = next(iter(Footage(self.frames, rows=self.rows)), None)
        if first is None or first.picture is None:
            raise ImageError("there is no frame to look at" if first is None else first.problem)
        return first.grid or ErpGrid(*first.picture.shape[:2])

    def __iter__(self) -> Iterator[Frame]:
        last = -math.inf
        for stamp, name, read in self.frames.items():
            if self._closed:
                return
            first = last == -math.inf
            last = max(stamp - self.latency, math.nextafter(last, math.inf))
            try:
                found = _shrunk(read(), self.rows)
            except EagorError as error:
                if first and isinstance(error, ShapeError):  # hardly any other will do better
                    raise
                self.dropped += 1
                yield Frame(last, None, name, problem=str(error))
            else:
                yield Frame(last, found.picture, name, found.grid, unseen=found.unseen)

    def close(self) -> None:
        self._closed = True


def _shrunk(found: Picture, rows: int | None) -> Picture:
    """The picture with `rows` at the most."""
    height, width = found.picture.shape[:2]
    if rows is None or height <= rows:
        return found
    shape = (rows, 2 * rows) if found.grid is None else (rows, max(1, round(width * rows / height)))
    unseen = None if found.unseen is None else resized_mask(found.unseen, shape)
    grid = None if found.grid is None else found.grid.resized(*shape)
    return replace(found, picture=resized(found.picture, shape, wrap=grid is None), unseen=unseen, grid=grid)


def is_video(places: Sequence[Path], rig: bool = False) -> bool:
    """Whether the one place is a video, or a picture that moves; with a `rig` there may be a video for each lens."""
    if len(places) == 1 and is_animation(places[0]):
        return True
    many = len(places) > 1 and not rig
    return not many and all(map(_is_film, places))


def images(places: Sequence[Path], rate: float | None, check: FrameCheck, rig: Rig | None = None) -> ImageFrames:
    """The pictures in `places` (one folder, or image files), sorted by name; numbers in names sort by value.

    Without a `rate` they were taken at the times that their names are (`eagor.odometry.times`: 12.350.png), or else one
    per second. With a `rig` they are pictures of its lenses, as `LensPictures` reads them; of one for several pictures,
    a folder for each. Raises `ImageError` for anything else.
    """
    found = _images(places, rate or RATE, check, rig)
    times = times_of([path.stem for path in found.paths]) if rate is None and len(found.paths) > 1 else None
    if times is None or len({*times}) < len(times):
        return found
    stamps, paths = zip(*sorted(zip(times, found.paths, strict=True)), strict=True)
    return replace(found, paths=paths, stamps=stamps)


def _images(places: Sequence[Path], rate: float, check: FrameCheck, rig: Rig | None) -> ImageFrames:
    if rig is not None and len(rig.sizes) > 1:
        return _of_folders(places, rate, rig)
    if films := list(filter(_is_film, places)):
        raise ImageError(f"{films[0]} is a video, beside other files; give one video, a folder, or image files")
    read = check.read if rig is None else LensPictures(rig).read
    if len(places) == 1 and os.path.isdir(places[0]):
        return ImageFrames(pictures_in(places[0]), rate, read)
    for place in places:  # os.path returns False where Path would raise: a name too long, a closed folder
        if os.path.isdir(place):
            raise ImageError(f"{place} is a folder; give one folder, or only image files")
        if not os.path.exists(place):
            raise ImageError(
                f"there is no file {place}; give a video, a recorded ROS 2 bag, a folder of pictures, or image files"
            )
    return ImageFrames(in_order(places), rate, read)


def _of_folders(places: Sequence[Path], rate: float, rig: Rig) -> ImageFrames:
    """A folder for each camera of a rig, whose pictures belong together in order of their names."""
    count = len(rig.sizes)
    if len(places) != count or not all(map(os.path.isdir, places)):
        raise ImageError(
            f"the rig is for {count} pictures at a time, one for each lens; give {count} folders with commas between, "
            "one for each lens in its order, a video, or pictures with all lenses in one. One moment alone: eagor "
            "locate FRONT,BACK"
        )
    together = {moment[0]: moment for moment in zip(*_lens_folders(places), strict=True)}
    lenses = LensPictures(rig)
    return ImageFrames(tuple(together), rate, lambda path: lenses.read(*together[path]))


def _lens_folders(folders: Sequence[Path]) -> list[tuple[Path, ...]]:
    """The pictures in the folders of a rig's lenses. Raises `ImageError` where their numbers differ."""
    lists = [pictures_in(Path(folder)) for folder in folders]
    if len({len(each) for each in lists}) > 1:
        counts = ", ".join(f"{len(each)} in {folder}" for each, folder in zip(lists, folders, strict=True))
        raise ImageError(f"the folders of the lenses hold different numbers of pictures: {counts}")
    return lists


def _is_film(place: Path) -> bool:
    """Whether it is a video: by its name, or where that tells nothing, by what is in it."""
    suffix = place.suffix.lower()
    if suffix in VIDEOS:
        return not place.is_dir()
    return suffix not in IMAGES and os.path.isfile(place) and plays(place)


class LensPictures:
    """Reads pictures of a `rig`, stitched."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self._sizes = rig, ()
        self._builder: PanoramaBuilder | None = None

    def read(self, *paths: Path) -> Picture:
        """The panorama of the pictures at `paths`, of one moment. Raises `ImageError`."""
        with warnings.catch_warnings():  # of their shapes: they are no panoramas
            warnings.simplefilter("ignore")
            pictures = [read_panorama(path) for path in paths]
        sizes = sizes_of(pictures)
        if self._builder is None or sizes != self._sizes:
            self._builder, self._sizes = PanoramaBuilder(sizes, str(paths[0]), rig=self.rig), sizes
        return Picture(self._builder.make(*pictures), self._builder.unseen)
