"""Where pictures come from: `open_source` for what SOURCE on the command line means; `open_footage` for recordings.

Recorded pictures come in order of time, each read when it is its turn: a long video needs no more memory than a short
one. Packages add cameras of their own under the entry points ``eagor.cameras``; `eagor.sources.check_camera` tests one.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from eagor import plugins
from eagor._checks import above, is_twice_as_wide
from eagor.cameras import Rig
from eagor.errors import DeviceError, EagorError, ImageError, TimeError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.odometry.files import times_of
from eagor.sources import CameraSource, Frame
from eagor.sources.animations import is_animation, selected
from eagor.sources.bags import is_bag, split_bag
from eagor.sources.defects import problems
from eagor.sources.intrinsics import Camera, IntrinsicsHint, ShapeError, in_words, intrinsics_from_exif
from eagor.sources.live_camera import SCHEMES, STREAMS, LiveCamera
from eagor.sources.panorama import IMAGES, Picture, in_order, pictures_in, read_stored
from eagor.sources.rigs import read_rig
from eagor.sources.ros_sources import BagCamera
from eagor.sources.stitching import PanoramaBuilder, sizes_of
from eagor.sources.video import Video, plays

__all__ = [
    "BUILT_IN", "GROUP", "LEAST_ROWS", "SOURCES", "Footage", "FrameCheck", "Images", "ShapeError", "is_video",
    "open_footage", "open_source",
]  # fmt: skip

GROUP = "eagor.cameras"
BUILT_IN = {"apartment": "eagor.lab.tasks.sim.walk:open_walk", "ros": "eagor.robots.ros:RosCamera"}
SOURCES = (
    "a folder of pictures, a picture, a video file, a ROS 2 bag (BAG?topic=/image), /dev/video0 or v4l2:0 "
    "(?size=1920x960&rate=30&format=mjpeg), rtsp://..., rtmp://..., http://..., udp://..., ros:/image_topic, - "
    "(encoded pictures on standard input) or pipe:rgb24:1920x960 (raw ones)"
)
_NAME = re.compile(r"([A-Za-z][\w-]+):(.*)", re.DOTALL)

VIDEOS = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".insv", ".avi", ".ts", ".mpg", ".mpeg", ".360")  # without a look
RATE = 1.0  # pictures per second where nothing tells
LEAST_ROWS = 960  # of a video's frames: enough to look nice, and little memory

NOTHING = IntrinsicsHint()
Shown = TypeVar("Shown", Picture, Frame)
Item = tuple[float, str, Callable[[], Picture | Frame]]  # stamp (seconds), name, what gives the picture, or raises


def open_source(
    text: str,
    *,
    latency: float = 0.0,
    rows: int | None = None,
    rig: Rig | str | os.PathLike[str] | None = None,
    rate: float | None = None,
    camera: Camera | None = None,
    **more: Any,
) -> CameraSource:
    """The source of pictures that `text` names (`SOURCES`), or that another package brings (``NAME:REST``).

    `latency`: seconds from capture to arrival, taken off the stamps. `rows`: the most rows of a panorama. `rig`: the
    lenses (`eagor.sources.rigs`) or their YAML file, if the pictures are not panoramas; for a rig with several
    pictures, `text` is as many sources with commas between, unless one gives all; of topics of ROS or of a bag, as many
    topics (``ros:/front/image,/back/image``), which may also do without a rig. `rate`: the most pictures per second
    to take; for a folder, how many per second were taken. `camera`: an ordinary one, if it is known to be that.
    `more`: for recordings, as `open_footage` takes it.

    Other packages add cameras under the entry points ``eagor.cameras``: a name, and a function ``(rest, *, latency,
    rows, rig, rate) -> CameraSource``. Raises `DeviceError`, `ImageError`, `FormatError` for the rig, and
    `MissingExtraError`.
    """
    lenses = rig if rig is None or isinstance(rig, Rig) else read_rig(rig)
    parts = [text]
    if lenses is not None and len(lenses.sizes) > 1 and "," in text and not (os.path.exists(text) or _has_topics(text)):
        parts = text.split(",")
    kinds = [_kind(part) for part in parts]
    if len(set(kinds)) > 1:
        raise DeviceError(f"{text} mixes {' and '.join(sorted(set(kinds)))}; wanted the same kind for each lens")
    settings: dict[str, Any] = {"latency": latency, "rows": rows, "rig": lenses, "rate": rate}
    if kinds[0] == "file":
        return open_footage(parts, **settings, camera=camera, **more)
    if camera is not None and (camera.known or camera.eyes):  # cameras of other packages need not know of it
        settings["camera"] = camera
    if kinds[0] == "plugin":
        name, _, rest = text.partition(":")
        return plugins.bring(plugins.known(GROUP, BUILT_IN)[name], "camera")(rest, **settings)
    return LiveCamera([STREAMS[kinds[0]][1](part) for part in parts], **settings)


def open_footage(
    places: Sequence[str | Path],
    *,
    latency: float = 0.0,
    rows: int | None = None,
    rig: Rig | None = None,
    rate: float | None = None,
    camera: Camera | None = None,
    start: float = 0.0,
    end: float | None = None,
    force: bool = False,
    info: str | None = None,
    say: Callable[[str], object] | None = None,
) -> Footage:
    """Recorded pictures: a video, a bag (``BAG?topic=/image``), a folder, image files; of a `rig`, one for each lens.

    `start`, `end`: seconds of a video or bag. `force`: pictures that are not 2:1 are panoramas all the same. `info`:
    the topic of a bag's CameraInfo. `say` is told what files say of themselves, and what looks odd in a line that
    begins with "warning: " (default: that is a `UserWarning`). The rest, and errors, as for `open_source`.
    """
    if not (rate is None or above(rate, 0)):
        raise TimeError(f"rate = {rate!r}; wanted pictures per second, more than 0")
    check = FrameCheck(force, say or warned, camera or Camera(), rig, rows)
    path, topic = split_bag(str(places[0]))
    if is_bag(path):
        bag = BagCamera(path, topic, rows=rows, rig=rig, camera=check.camera, info=info)
        if bag.lens is not None:
            check.say(f"{bag.topic}: {in_words(bag.lens.name, bag.builder.view)}")
        return Footage(partial(_of_bag, bag, check, rate, start, end), latency, bag.begins - latency, bag=bag)
    paths = [Path(place) for place in places]
    if is_video(paths, rig is not None):
        how: dict[str, Any] = {"rig": rig, "camera": camera, "force": force, "rows": rows}
        video = Video(*paths, rate=rate, start=start, end=end, **how)
        return Footage(partial(_of_video, video, check), latency, video=video)
    found = images_of(paths, rate, check)
    return Footage(found.items, latency, images=found)


def _kind(text: str) -> str:
    for kind, (form, _) in STREAMS.items():
        if form.match(text):
            return kind
    if is_bag(split_bag(text)[0]) or os.path.exists(text):
        return "file"
    if (named := _NAME.fullmatch(text)) is None:
        raise DeviceError(f"there is no file or folder {text!r}; wanted {SOURCES}")
    known = plugins.known(GROUP, BUILT_IN)
    if named[1] in known:
        return "plugin"
    names = ", ".join(f"{name}:" for name in sorted({*known, "v4l2", "pipe", *SCHEMES}))
    raise DeviceError(f"there is no file {text!r}, and no source is called {named[1]}: ({names}). Wanted {SOURCES}")


def _has_topics(text: str) -> bool:
    """Whether commas in a source are those between the topics of a bag or of ROS."""
    return is_bag(split_bag(text)[0]) or text.partition(":")[0] in BUILT_IN


# --- recorded pictures ---


@dataclass
class FrameCheck:
    """Reads pictures from files, as what `PanoramaBuilder` says that they are, and says once what looks odd.

    `say` gets facts that files tell, and what looks odd. `force`: pictures that are not 2:1 are panoramas, and circles
    are looked at. Without a `camera` all have to be panoramas; with one that knows nothing itself, those that are not
    have a lens that files tell. `rig`: files hold the pictures of its lenses. `rows`: the most rows of a picture.
    """

    force: bool = False
    say: Callable[[str], object] = lambda text: None
    camera: Camera | None = None
    rig: Rig | None = None
    rows: int | None = None
    _looked: bool = False
    _builders: dict[Any, PanoramaBuilder] = field(default_factory=dict)

    def read(self, *paths: Path) -> Picture:
        """The picture in a file, or in those of a rig's lenses, as what it is. Raises `ImageError`, `ShapeError`."""
        stored, name = [read_stored(path) for path in paths], str(paths[0])
        hint = NOTHING if self.camera is None or self.rig is not None else intrinsics_from_exif(paths[0])
        pictures, (_, hidden, projection, facts) = [each.picture for each in stored], stored[0]
        key = sizes_of(pictures), hint
        builder = self._builders.get(key) if projection is None else None
        if builder is None:
            known: dict[str, Any] = {"rig": self.rig, "camera": self.camera, "rows": self.rows, "force": self.force}
            builder = PanoramaBuilder(key[0], name, hint=hint, projection=projection, **known)
            if projection is None:  # which may differ from picture to picture
                self._builders[key] = builder
        if builder.refused or not self._looked:
            builder.check(*pictures, name=name)
        found = Picture(builder.make(*pictures), builder.hidden(hidden), builder.view, builder.level_R_body)
        return self.look(found, name, builder, hint, (*builder.facts, *facts))

    def look(
        self,
        frame: Shown,
        name: str,
        builder: PanoramaBuilder | None = None,
        hint: IntrinsicsHint = NOTHING,
        facts: Sequence[str] = (),
    ) -> Shown:
        """The `frame`; of the first one it is said what the file tells (`facts`, and the lens), and what looks odd."""
        if self._looked:
            return frame
        self._looked = True  # not before: who reads a frame again that was refused is told again
        (high, wide), odd = frame.picture.shape[:2], ()
        if frame.grid is not None or (builder is not None and builder.fisheye):
            words = in_words((self.camera and self.camera.name) or hint.source, frame.grid)
            facts = (words, *facts, *(hint.facts if frame.grid is not None else ()))
        elif not is_twice_as_wide(high, wide):
            odd = (f"it is {wide} x {high}, not 2:1; accepted, with all columns for 360 degrees, all rows for 180",)
        elif frame.unseen is None:  # a part has no seam
            odd = problems(frame.picture)
        for fact in facts:
            self.say(f"{name}: {fact}")
        for problem in odd:
            self.say(f"warning: {name}: {problem}")
        return frame


@dataclass(frozen=True)
class Images:
    """Pictures in files, `rate` per second; `read` gives one of them; `stamps`: when they were taken, if known."""

    paths: tuple[Path, ...]
    rate: float
    read: Callable[[Path], Picture]
    stamps: tuple[float, ...] = ()

    def items(self) -> Iterator[Item]:
        """Stamp, name, and what gives the picture, of each."""
        for number, path in enumerate(self.paths):
            yield self.stamps[number] if self.stamps else number / self.rate, path.name, partial(self.read, path)


def _of_video(video: Video, check: FrameCheck) -> Iterator[Item]:
    for frame in video:
        yield frame.stamp, frame.name, partial(check.look, frame, frame.name, video.builder, video.hint)


def _of_bag(bag: BagCamera, check: FrameCheck, rate: float | None, start: float, end: float | None) -> Iterator[Item]:
    """By the headers' stamps; `start` and `end` count from the first."""

    def seen(read: Callable[[], np.ndarray], name: str) -> Picture:
        found = Picture(read(), bag.builder.unseen, bag.builder.view)
        return check.look(found, name) if found.grid is None else found  # an ordinary lens is said already

    last = math.inf if end is None else end
    coming = ((stamp - bag.begins, (stamp, read)) for stamp, read in bag.pictures() if stamp - bag.begins >= start)
    for _, (stamp, read) in selected(takewhile(lambda each: each[0] <= last, coming), 0.0, None, rate, 1e-6):
        yield stamp, (name := f"{bag.topics[0]} at {stamp:.3f} s"), partial(seen, read, name)


@dataclass(eq=False)
class Footage:
    """A `CameraSource` of recorded pictures: of files, a video or a bag; each is read and checked when it is its turn.

    `items` gives stamp, name, and what gives the picture. One that cannot be used comes without, with the `problem`.
    `latency` is taken off the stamps. `begins`: the stamp of the first picture of a bag, else 0. One of `images`,
    `video` and `bag` is what they are from. Iterating raises what ends the footage, and `ShapeError` if it is the first
    picture that has the wrong shape.
    """

    items: Callable[[], Iterator[Item]]
    latency: float = 0.0
    begins: float = 0.0
    images: Images | None = None
    video: Video | None = None
    bag: BagCamera | None = None
    dropped: int = 0
    closed: bool = False
    live = False
    problem = None

    @property
    def ordinary(self) -> bool:
        """Whether its pictures are those of an ordinary camera, as far as that is known without one."""
        known = self.video or self.bag
        return known is not None and known.builder.view is not None

    @property
    def grid(self) -> ErpGrid | PerspectiveGrid:
        """The pixels of its first picture."""
        first = next(iter(Footage(self.items)), None)
        if first is None or first.picture is None:
            raise ImageError("there is no frame to look at" if first is None else first.problem)
        return first.grid or ErpGrid(*first.picture.shape[:2])

    def __iter__(self) -> Iterator[Frame]:
        last = -math.inf
        for stamp, name, read in self.items():
            if self.closed:
                return
            first = last == -math.inf
            last = max(stamp - self.latency, math.nextafter(last, math.inf))
            try:
                found = read()
            except EagorError as error:
                if first and isinstance(error, ShapeError):  # hardly any other will do better
                    raise
                self.dropped += 1
                yield Frame(last, None, name, problem=str(error))
            else:
                yield Frame(last, found.picture, name, found.grid, unseen=found.unseen)

    def close(self) -> None:
        self.closed = True


def warned(text: str) -> None:
    """A `UserWarning` for what begins with "warning: ": where nobody else listens."""
    if text.startswith("warning: "):
        warnings.warn(text.removeprefix("warning: "), UserWarning, stacklevel=4)


def is_video(places: Sequence[Path], rig: bool = False) -> bool:
    """Whether the one place is a video, or a picture that moves; with a `rig` there may be a video for each lens."""
    if len(places) == 1 and is_animation(places[0]):
        return True
    return (len(places) == 1 or rig) and all(map(_is_film, places))


def images_of(places: Sequence[Path], rate: float | None, check: FrameCheck) -> Images:
    """The pictures in `places` (one folder, or image files), sorted by name; numbers in names sort by value.

    Without a `rate` they were taken at the times that their names are (12.350.png), or else one per second. Of a rig
    for several pictures, `places` are a folder for each. Raises `ImageError` for anything else.
    """
    count = 1 if check.rig is None else len(check.rig.sizes)
    together = _together(places, count) if count > 1 else [(path,) for path in _single(places)]
    with_first = {each[0]: each for each in together}
    paths, stamps = tuple(with_first), ()
    times = times_of([path.stem for path in paths]) if rate is None and len(paths) > 1 else None
    if times is not None and len({*times}) == len(times):
        stamps, paths = zip(*sorted(zip(times, paths, strict=True)), strict=True)
    return Images(paths, rate or RATE, lambda path: check.read(*with_first[path]), stamps)


def _single(places: Sequence[Path]) -> tuple[Path, ...]:
    if films := list(filter(_is_film, places)):
        raise ImageError(f"{films[0]} is a video, beside other files; give one video, a folder, or image files")
    if len(places) == 1 and os.path.isdir(places[0]):
        return pictures_in(places[0])
    for place in places:  # os.path returns False where Path would raise: a name too long, a closed folder
        if os.path.isdir(place):
            raise ImageError(f"{place} is a folder; give one folder, or only image files")
        if not os.path.exists(place):
            wanted = "give a video, a recorded ROS 2 bag, a folder of pictures, or image files"
            raise ImageError(f"there is no file {place}; {wanted}")
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
