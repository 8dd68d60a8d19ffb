"""Frames of footage in order of time: images, a video, the pictures of a bag; each read when it is its turn.

A long video needs no more memory than a short one. Frames are whole panoramas, are stitched from pictures of lenses, or
are ordinary pictures with the grid of their lens (`eagor.media.rig_videos`).
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from eagor._checks import is_twice_as_wide
from eagor.errors import EagorError, ImageError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.media import Frame
from eagor.media.animations import is_animation
from eagor.media.bag_sources import BagCamera
from eagor.media.defects import TWICE, fisheye_circles, problems, two_eyes
from eagor.media.intrinsics import ASK, Camera, ShapeError, Told, in_words, ordinary_grid, told_by_photograph
from eagor.media.metadata import Projection
from eagor.media.panorama import (
    IMAGES,
    Picture,
    in_order,
    is_whole,
    pictures_in,
    placed,
    read_panorama,
    read_photograph,
    resized,
    resized_mask,
)
from eagor.media.rig_videos import LensVideos, are_ordinary, ordinary_cameras
from eagor.media.rigs import Rig, sizes_of
from eagor.media.stitching import Panoramas
from eagor.media.video import plays
from eagor.odometry.times import times_of

__all__ = [
    "LEAST_ROWS", "VIDEOS", "BagFrames", "Footage", "FrameCheck", "ImageFrames", "LensPictures", "Read", "ShapeError",
    "VideoFrames", "images", "is_video",
]  # fmt: skip

VIDEOS = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".insv", ".avi", ".ts", ".mpg", ".mpeg", ".360")  # without a look
RATE = 1.0  # pictures per second where nothing tells
LEAST_ROWS = 960  # of a video's frames: enough to look nice, and little memory

NOTHING = Told()
Read = Callable[[], Picture]  # gives a picture, or raises `EagorError`
Item = tuple[float, int, str, Read]  # of a frame: its stamp (seconds), which lens took it, its name, its picture
Say = Callable[[str], object]


@dataclass
class FrameCheck:
    """Checks that frames are whole panoramas, or gives them the grid of an ordinary `camera`.

    `say` gets facts that files tell, and what looks odd. Only the first whole frame is judged by its pixels, and a
    wrong shape is mentioned once. With `force`, pictures that are not 2:1 are accepted as panoramas. Without a `camera`
    all have to be panoramas; with one that knows nothing itself, those that are not have a lens that files tell.
    """

    force: bool = False
    say: Say = lambda text: None
    camera: Camera | None = None
    _said: set[str] = field(default_factory=set)
    _wide: dict[tuple[int, int], Panoramas] = field(default_factory=dict)

    def read(self, path: Path) -> Picture:
        """The picture in a file, and what the file says of it; raises `ImageError`, and as the check of a frame."""
        found = read_photograph(path, warn=False, force=self.force)
        return self(found, str(path), told_by_photograph(path) if self._is_ordinary(found) else NOTHING)

    def __call__(self, frame: Picture, name: str, told: Told = NOTHING) -> Picture:
        """`frame`, with its grid if it is an ordinary picture; `told`: what its file says of the lens, if it has none.

        Raises `ShapeError` if nothing is known of the lens, and it is not 2:1, or shows the circles of fisheye lenses,
        unless `force`.
        """
        if frame.grid is not None:
            return frame
        eyes = None if self.camera is None else self.camera.eyes
        if eyes not in (None, "mono"):
            frame = replace(
                placed(frame.picture, Projection.of_eyes(eyes), frame.unseen), level_R_body=frame.level_R_body
            )
        elif eyes is None and not self.force and frame.unseen is None and "eyes" not in self._said:
            unknown = (self.camera is None or not self.camera.known) and not fisheye_circles(frame.picture)
            if unknown and (twice := two_eyes(frame.picture)):
                raise ShapeError(f"{name} {TWICE[twice]}")
            self._said.add("eyes")
        if self._is_ordinary(frame):
            return self._ordinary(frame, name, told)
        if not is_whole(frame.picture):
            height, width = frame.picture.shape[:2]
            what = f"{name} is {width} x {height}, not 2:1"
            if not self.force:
                raise ShapeError(f"{what}; wanted a whole panorama, twice as wide as high ({2 * height} x {height})")
            if "shape" not in self._said:
                self._said.add("shape")
                self.say(f"warning: {what}; accepted, with all columns for 360 degrees and all rows for 180")
        if "pixels" in self._said:
            return frame
        found = problems(frame.picture)
        if not self.force and fisheye_circles(frame.picture):
            raise ShapeError(f"{name}: {found[0]}. To look at it all the same, add --force")
        self._said.add("pixels")  # not before: who reads a frame again that was refused is told again
        for fact in frame.facts:
            self.say(f"{name}: {fact}")
        for problem in found if frame.unseen is None else ():  # a part has no seam
            self.say(f"warning: {name}: {problem}")
        return frame

    def takes_as_ordinary(self, height: int, width: int) -> bool:
        """Whether pictures of this size, of which a file says nothing, are those of an ordinary camera."""
        if self.camera is None or self.camera.eyes is not None:
            return False
        return self.camera.known or not (self.force or is_twice_as_wide(height, width))

    def _is_ordinary(self, frame: Picture) -> bool:
        placed = frame.unseen is not None and is_whole(frame.picture)  # its file says where, or it is a panorama
        return not placed and self.takes_as_ordinary(*frame.picture.shape[:2])

    def _ordinary(self, frame: Picture, name: str, told: Told) -> Picture:
        """An ordinary picture with its grid; that of a fisheye as a panorama, with what it does not see."""
        assert self.camera is not None
        height, width = size = frame.picture.shape[:2]
        if self.camera.wide:
            if size not in self._wide:
                self._wide[size] = Panoramas(((width, height),), self.camera.rig, None, name)
                self.say(f"{name}: {in_words(self.camera.name, None)}")
            return Picture(self._wide[size].make(frame.picture), self._wide[size].unseen)
        grid = ordinary_grid(self.camera, told, (width, height), name)
        if grid is None:
            what = f"{name} is {width} x {height}, not 2:1 as a whole panorama is, and does not tell its lens"
            why = f" ({'; '.join(told.facts)})" if told.facts else ""
            raise ShapeError(f"{what}{why}. {ASK}. A panorama all the same: --force (all columns for 360 degrees)")
        if "lens" not in self._said:
            self._said.add("lens")
            self.say(f"{name}: {in_words(self.camera.name or told.source, grid)}")
            for fact in (*frame.facts, *told.facts):
                self.say(fact if fact.startswith("warning: ") else f"{name}: {fact}")
        return replace(frame, grid=grid)


@dataclass(frozen=True)
class ImageFrames:
    """Pictures in files, `rate` per second; `read` gives one of them.

    `beside`: of each path, the pictures that further cameras of a rig took at the same moment. `stamps`: when the
    pictures were taken, if that is known.
    """

    paths: tuple[Path, ...]
    rate: float
    read: Callable[[Path], Picture]
    beside: Mapping[Path, tuple[Path, ...]] = field(default_factory=dict)
    stamps: tuple[float, ...] = ()
    level_R_body = motion = None
    begins = 0.0

    @property
    def count(self) -> int:
        return len(self.paths) + sum(map(len, self.beside.values()))

    def items(self) -> Iterator[Item]:
        for number, path in enumerate(self.paths):
            others = self.beside.get(path, ())
            for lens, each in enumerate((path, *others)):
                name = f"{each.parent.name}/{each.name}" if others else each.name
                yield self.stamps[number] if self.stamps else number / self.rate, lens, name, partial(self.read, each)


@dataclass(frozen=True)
class VideoFrames:
    """The frames of a video, as `eagor.media.rig_videos.open_video` gives it; `rig`: with a rig of lenses."""

    video: Any
    check: FrameCheck
    rig: bool = False
    begins = 0.0

    @property
    def level_R_body(self) -> np.ndarray | None:
        return self.video.level_R_body

    @property
    def motion(self) -> Any:
        return self.video.motion

    def items(self) -> Iterator[Item]:
        for frame in self.video:
            found = Picture(frame.picture, self.video.unseen, grid=frame.grid)
            yield frame.stamp, frame.lens, frame.name, partial(self.check, found, frame.name, self.video.told)


@dataclass(frozen=True)
class BagFrames:
    """The pictures of a bag's `camera`, `rate` of each lens per second, from `start` to `end` (seconds from the first).

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
        ticks = [-math.inf] * len(self.camera.views)
        for stamp, lens, read in self.camera.pictures():
            at = stamp - self.begins
            if at < self.start:
                continue
            if self.end is not None and at > self.end:
                return
            if self.rate is not None:
                if (number := math.floor(at * self.rate + 1e-6)) <= ticks[lens]:
                    continue
                ticks[lens] = number
            name = f"{self.camera.topics[lens]} at {stamp:.3f} s"
            yield stamp, lens, name, partial(self._checked, read, name, self.camera.views[lens])

    def _checked(self, read: Callable[[], np.ndarray], name: str, view: PerspectiveGrid | None) -> Picture:
        if view is not None:
            return Picture(read(), grid=view)
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
        """Whether its pictures are those of ordinary cameras, as far as that is known without one."""
        frames = self.frames
        if isinstance(frames, BagFrames):
            return frames.camera.views[0] is not None
        if isinstance(frames, VideoFrames):
            several = isinstance(frames.video, LensVideos)
            return several or (not frames.rig and frames.check.takes_as_ordinary(*frames.video.shape))
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
        for stamp, lens, name, read in self.frames.items():
            if self._closed:
                return
            first = last == -math.inf
            last = max(stamp - self.latency, math.nextafter(last, math.inf))  # lenses may see at the same moment
            try:
                found = _shrunk(read(), self.rows)
            except EagorError as error:
                if first and isinstance(error, ShapeError):  # hardly any other will do better
                    raise
                self.dropped += 1
                yield Frame(last, None, name, None, lens, problem=str(error))
            else:
                yield Frame(last, found.picture, name, found.grid, lens, found.unseen)

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


def images(
    places: Sequence[Path], rate: float | None, check: FrameCheck, rig: Rig | None = None, stitched: bool = False
) -> ImageFrames:
    """The pictures in `places` (one folder, or image files), sorted by name; numbers in names sort by value.

    Without a `rate` they were taken at the times that their names are (`eagor.odometry.times`: 12.350.png), or else one
    per second. With a `rig` they are pictures of its lenses, as `LensPictures` reads them; of one for several pictures,
    a folder for each. Raises `ImageError` for anything else.
    """
    found = _images(places, rate or RATE, check, rig, stitched)
    times = times_of([path.stem for path in found.paths]) if rate is None and len(found.paths) > 1 else None
    if times is None or len({*times}) < len(times):
        return found
    stamps, paths = zip(*sorted(zip(times, found.paths, strict=True)), strict=True)
    return replace(found, paths=paths, stamps=stamps)


def _images(places: Sequence[Path], rate: float, check: FrameCheck, rig: Rig | None, stitched: bool) -> ImageFrames:
    if rig is not None and len(rig.sizes) > 1:
        return _of_folders(places, rate, rig, stitched)
    if films := list(filter(_is_film, places)):
        raise ImageError(f"{films[0]} is a video, beside other files; give one video, a folder, or image files")
    read = check.read if rig is None else LensPictures(rig, stitched).read
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


def _of_folders(places: Sequence[Path], rate: float, rig: Rig, stitched: bool) -> ImageFrames:
    """A folder for each camera of a rig, whose pictures belong together in order of their names."""
    count = len(rig.sizes)
    if len(places) != count or not all(map(os.path.isdir, places)):
        raise ImageError(
            f"the rig is for {count} pictures at a time, one for each lens; give {count} folders with commas between, "
            "one for each lens in its order, a video, or pictures with all lenses in one. One moment alone: eagor "
            "locate FRONT,BACK"
        )
    moments = list(zip(*_lens_folders(places), strict=True))
    lenses = LensPictures(rig, stitched)
    if not lenses.ordinary:
        together = {moment[0]: moment for moment in moments}
        return ImageFrames(tuple(together), rate, lambda path: lenses.moment(together[path])[0])
    lens_of = {path: lens for moment in moments for lens, path in enumerate(moment)}
    beside = {first: tuple(others) for first, *others in moments}
    return ImageFrames(tuple(beside), rate, lambda path: lenses.alone(lens_of[path], path), beside=beside)


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
    """Reads pictures of a `rig`: as panoramas, or those of ordinary lenses as they are, unless `stitched`."""

    def __init__(self, rig: Rig, stitched: bool = False) -> None:
        self.rig = rig
        self._cameras = () if stitched or not are_ordinary(rig) else ordinary_cameras(rig)
        self._sizes: tuple[tuple[int, int], ...] = ()
        self._panoramas: Panoramas | None = None

    @property
    def ordinary(self) -> bool:
        """Whether pictures of ordinary lenses stay what they are."""
        return bool(self._cameras)

    def alone(self, lens: int, path: Path) -> Picture:
        """The picture at `path` of one ordinary lens. Raises `ImageError`."""
        with warnings.catch_warnings():  # of its shape: it is no panorama
            warnings.simplefilter("ignore")
            return self._with_grid(lens, path, read_panorama(path))

    def _with_grid(self, lens: int, path: Path, picture: np.ndarray) -> Picture:
        (size,) = sizes_of([picture])
        return Picture(picture, grid=ordinary_grid(self._cameras[lens], told_by_photograph(path), size, str(path)))

    def read(self, path: Path) -> Picture:
        """The picture at `path`, which shows all lenses. Raises `ImageError`."""
        (found,) = self.moment([path])
        return found

    def moment(self, paths: Sequence[Path]) -> tuple[Picture, ...]:
        """The pictures at `paths`, of one moment: one panorama, or one picture for each lens. Raises `ImageError`."""
        with warnings.catch_warnings():  # of their shapes: they are no panoramas
            warnings.simplefilter("ignore")
            pictures = [read_panorama(path) for path in paths]
        sizes, name = sizes_of(pictures), str(paths[0])
        if self._cameras and len(paths) == len(self._cameras):
            return tuple(self._with_grid(lens, *each) for lens, each in enumerate(zip(paths, pictures, strict=True)))
        if self._panoramas is None or sizes != self._sizes:
            self._panoramas, self._sizes = Panoramas(sizes, self.rig, None, name), sizes
        return (Picture(self._panoramas.make(*pictures), self._panoramas.unseen),)
