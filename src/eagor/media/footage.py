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
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from eagor.cameras import Rig
from eagor.errors import EagorError, ImageError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.media import Frame
from eagor.media.bag_sources import BagCamera
from eagor.media.defects import TWICE, problems, two_eyes
from eagor.media.films import StitchedVideo, is_animation
from eagor.media.intrinsics import Camera, IntrinsicsHint, ShapeError, in_words, intrinsics_from_exif
from eagor.media.panorama import (
    IMAGES,
    Picture,
    in_order,
    is_whole,
    pictures_in,
    read_panorama,
    read_photograph,
    shrunk_picture,
)
from eagor.media.stitching import PanoramaBuilder, sizes_of
from eagor.media.video import plays, selected
from eagor.odometry.times import times_of

__all__ = ["LEAST_ROWS", "BagFrames", "Footage", "FrameCheck", "ImageFrames", "ShapeError", "VideoFrames", "is_video"]

VIDEOS = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".insv", ".avi", ".ts", ".mpg", ".mpeg", ".360")  # without a look
RATE = 1.0  # pictures per second where nothing tells
LEAST_ROWS = 960  # of a video's frames: enough to look nice, and little memory

NOTHING = IntrinsicsHint()
Item = tuple[float, str, Callable[[], Picture]]  # stamp (seconds), name, and what gives the picture or `EagorError`


@dataclass
class FrameCheck:
    """Has `PanoramaBuilder` say what each frame is, and lay it out as that.

    `say` gets facts that files tell, and what looks odd, once. `force`: pictures that are not 2:1 are panoramas, and
    circles are looked at. Without a `camera` all have to be panoramas; with one that knows nothing itself, those that
    are not have a lens that files tell. `rig`: files hold the pictures of its lenses.
    """

    force: bool = False
    say: Callable[[str], object] = lambda text: None
    camera: Camera | None = None
    rig: Rig | None = None
    _looked: bool = False
    _builders: dict[Any, PanoramaBuilder] = field(default_factory=dict)

    def read(self, *paths: Path) -> Picture:
        """The picture in a file, or in those of a rig's lenses, as what it is. Raises `ImageError`, and as a frame."""
        if self.rig is None:
            (path,) = paths
            found = read_photograph(path, warn=False, force=self.force)
            return self(found, str(path), intrinsics_from_exif(path))
        with warnings.catch_warnings():  # of their shapes: they are no panoramas
            warnings.simplefilter("ignore")
            pictures = [read_panorama(path) for path in paths]
        builder = self.builder(sizes_of(pictures), str(paths[0]), rig=self.rig)
        return Picture(builder.make(*pictures), builder.unseen)

    def builder(
        self, sizes: tuple[tuple[int, int], ...], name: str, hint: IntrinsicsHint = NOTHING, rig: Rig | None = None
    ) -> PanoramaBuilder:
        """What makes frames of pictures of `sizes` (width, height); errors as of `PanoramaBuilder`."""
        hint = NOTHING if self.camera is None else hint
        if (sizes, hint) not in self._builders:
            made = PanoramaBuilder(sizes, name, rig=rig, camera=self.camera, hint=hint, force=self.force)
            self._builders[sizes, hint] = made
        return self._builders[sizes, hint]

    def __call__(self, frame: Picture, name: str, hint: IntrinsicsHint = NOTHING) -> Picture:
        """`frame`, as a panorama, or with the grid of an ordinary picture; `hint`: what its file says of the lens.

        Raises `ShapeError` as `PanoramaBuilder` does.
        """
        eyes, view, words = self.camera is not None and self.camera.eyes is not None, None, ""
        if eyes or frame.unseen is None or not is_whole(frame.picture):  # else its file says where it is
            try:
                builder = self.builder(sizes_of([frame.picture]), name, hint)
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


class _Frames:
    """Where recorded pictures come from; `begins`: the stamp of the first on a clock of its own."""

    begins = 0.0
    level_R_body: np.ndarray | None = None
    motion: Any = None
    ordinary = False  # as far as that is known without a picture

    def items(self) -> Iterator[Item]:
        raise NotImplementedError


@dataclass(frozen=True)
class ImageFrames(_Frames):
    """Pictures in files, `rate` per second; `read` gives one of them.

    `stamps`: when the pictures were taken, if that is known.
    """

    paths: tuple[Path, ...]
    rate: float
    read: Callable[[Path], Picture]
    stamps: tuple[float, ...] = ()

    @property
    def count(self) -> int:
        return len(self.paths)

    def items(self) -> Iterator[Item]:
        for number, path in enumerate(self.paths):
            yield self.stamps[number] if self.stamps else number / self.rate, path.name, partial(self.read, path)


class VideoFrames(_Frames):
    """The frames of a `video`, as `eagor.media.films.open_video` gives it."""

    def __init__(self, video: Any, check: FrameCheck) -> None:
        self.video, self.check = video, check
        self.level_R_body, self.motion = video.level_R_body, video.motion

    @property
    def ordinary(self) -> bool:
        high, wide = self.video.shape
        stitched = isinstance(self.video, StitchedVideo)
        return not stitched and self.check.builder(((wide, high),), self.video.path, self.video.hint).view is not None

    def items(self) -> Iterator[Item]:
        for frame in self.video:
            found = Picture(frame.picture, self.video.unseen)
            yield frame.stamp, frame.name, partial(self.check, found, frame.name, self.video.hint)


class BagFrames(_Frames):
    """The pictures of a bag's `camera`, `rate` per second, from `start` to `end` (seconds from the first).

    Stamps are those of the messages' headers.
    """

    def __init__(
        self, camera: BagCamera, check: FrameCheck, rate: float | None = None, start: float = 0.0,
        end: float | None = None,
    ) -> None:  # fmt: skip
        self.camera, self.check, self._taken = camera, check, (rate, start, math.inf if end is None else end)
        self.begins, self.ordinary = camera.begins, camera.view is not None

    def items(self) -> Iterator[Item]:
        rate, start, end = self._taken
        coming = ((stamp - self.begins, (stamp, read)) for stamp, read in self.camera.pictures())
        inside = takewhile(lambda each: each[0] <= end, (each for each in coming if each[0] >= start))
        for _, (stamp, read) in selected(inside, 0.0, None, rate, 1e-6):
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
        return self.frames.ordinary

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
                found = shrunk_picture(read(), self.rows)
            except EagorError as error:
                if first and isinstance(error, ShapeError):  # hardly any other will do better
                    raise
                self.dropped += 1
                yield Frame(last, None, name, problem=str(error))
            else:
                yield Frame(last, found.picture, name, found.grid, unseen=found.unseen)

    def close(self) -> None:
        self._closed = True


def warned(text: str) -> None:
    """A `UserWarning` for what begins with "warning: ": where nobody else listens."""
    if text.startswith("warning: "):
        warnings.warn(text.removeprefix("warning: "), UserWarning, stacklevel=4)


def is_video(places: Sequence[Path], rig: bool = False) -> bool:
    """Whether the one place is a video, or a picture that moves; with a `rig` there may be a video for each lens."""
    if len(places) == 1 and is_animation(places[0]):
        return True
    many = len(places) > 1 and not rig
    return not many and all(map(_is_film, places))


def images(places: Sequence[Path], rate: float | None, check: FrameCheck) -> ImageFrames:
    """The pictures in `places` (one folder, or image files), sorted by name; numbers in names sort by value.

    Without a `rate` they were taken at the times that their names are (`eagor.odometry.times`: 12.350.png), or else one
    per second. Of a rig for several pictures, `places` are a folder for each. Raises `ImageError` for anything else.
    """
    count = 1 if check.rig is None else len(check.rig.sizes)
    together = _together(places, count) if count > 1 else [(path,) for path in _single(places)]
    with_first = {each[0]: each for each in together}
    paths, stamps = tuple(with_first), ()
    times = times_of([path.stem for path in paths]) if rate is None and len(paths) > 1 else None
    if times is not None and len({*times}) == len(times):
        stamps, paths = zip(*sorted(zip(times, paths, strict=True)), strict=True)
    return ImageFrames(paths, rate or RATE, lambda path: check.read(*with_first[path]), stamps)


def _single(places: Sequence[Path]) -> tuple[Path, ...]:
    if films := list(filter(_is_film, places)):
        raise ImageError(f"{films[0]} is a video, beside other files; give one video, a folder, or image files")
    if len(places) == 1 and os.path.isdir(places[0]):
        return pictures_in(places[0])
    for place in places:  # os.path returns False where Path would raise: a name too long, a closed folder
        if os.path.isdir(place):
            raise ImageError(f"{place} is a folder; give one folder, or only image files")
        if not os.path.exists(place):
            raise ImageError(
                f"there is no file {place}; give a video, a recorded ROS 2 bag, a folder of pictures, or image files"
            )
    return in_order(places)


def _together(places: Sequence[Path], count: int) -> list[tuple[Path, ...]]:
    """Of a folder for each of `count` cameras, the pictures that belong together, in order of their names."""
    if len(places) != count or not all(map(os.path.isdir, places)):
        raise ImageError(
            f"the rig is for {count} pictures at a time, one for each lens; give {count} folders with commas between, "
            "one for each lens in its order, a video, or pictures with all lenses in one. One moment alone: eagor "
            "locate FRONT,BACK"
        )
    lists = [pictures_in(Path(folder)) for folder in places]
    if len({len(each) for each in lists}) > 1:
        counts = ", ".join(f"{len(each)} in {folder}" for each, folder in zip(lists, places, strict=True))
        raise ImageError(f"the folders of the lenses hold different numbers of pictures: {counts}")
    return [*zip(*lists, strict=True)]


def _is_film(place: Path) -> bool:
    """Whether it is a video: by its name, or where that tells nothing, by what is in it."""
    suffix = place.suffix.lower()
    if suffix in VIDEOS:
        return not place.is_dir()
    return suffix not in IMAGES and os.path.isfile(place) and plays(place)
