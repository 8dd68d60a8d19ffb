"""Where panoramas come from: `open_source` for what SOURCE on the command line means, videos, folders.

Packages add cameras of their own under the entry points ``eagor.cameras``; `eagor.media.check_camera` tests one.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from io import FileIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from eagor import plugins
from eagor.errors import DeviceError, EagorError, TimeError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.media import CameraSource, Frame
from eagor.media.animations import Animation
from eagor.media.bags import is_bag, split_bag
from eagor.media.footage import lens_folders
from eagor.media.intrinsics import Camera
from eagor.media.live_camera import LiveCamera
from eagor.media.panorama import read_panorama, read_photograph
from eagor.media.rig_videos import LensVideos, StitchedVideo, made_of, makers, open_video
from eagor.media.rigs import Rig, read_rig, sizes_of
from eagor.media.stitching import Panoramas
from eagor.media.streams import SCHEMES, device, network, raw_pipe, standard_input
from eagor.media.video import Video
from eagor.odometry.times import times_of

__all__ = ["BUILT_IN", "GROUP", "SOURCES", "FolderCamera", "VideoCamera", "open_source"]

GROUP = "eagor.cameras"
BUILT_IN = {"bag": "eagor.media.bag_sources:BagCamera", "ros": "eagor.robots.ros:RosCamera"}
SOURCES = (
    "a folder of panoramas, a video file, a ROS 2 bag (BAG?topic=/image), /dev/video0 or v4l2:0 "
    "(?size=1920x960&rate=30&format=mjpeg), rtsp://..., rtmp://..., http://..., udp://..., ros:/image_topic, - "
    "(encoded pictures on standard input) or pipe:rgb24:1920x960 (raw ones)"
)
_DEVICE = re.compile(r"(?:v4l2:)?(/dev/[^?]+)|v4l2:(\d+)")
_ADDRESS = re.compile(rf"(?:{'|'.join(SCHEMES)})://", re.IGNORECASE)
_NAME = re.compile(r"([A-Za-z][\w-]+):(.*)", re.DOTALL)

RATE = 1.0  # pictures per second of a folder whose files do not tell times


# --- what a source is ---


def open_source(
    text: str,
    *,
    latency: float = 0.0,
    rows: int | None = None,
    rig: Rig | str | os.PathLike[str] | None = None,
    rate: float | None = None,
    camera: Camera | None = None,
    stitched: bool = False,
) -> CameraSource:
    """The source of pictures that `text` names (`SOURCES`), or that another package brings (``NAME:REST``).

    `latency`: seconds from capture to arrival, taken off the stamps. `rows`: the most rows of a panorama. `rig`: the
    lenses (`eagor.media.rigs`) or their YAML file, if the pictures are not panoramas; for a rig with several
    pictures, `text` is as many sources with commas between, unless one gives all; of topics of ROS or of a bag, as many
    topics (``ros:/front/image,/back/image``), which may also do without a rig. `rate`: the most pictures per second
    to take; for a folder, how many per second were taken. `camera`: an ordinary one, if it is known to be that.
    `stitched`: make a panorama also of pictures of a rig's ordinary lenses, which are otherwise given as they are.

    Other packages add cameras under the entry points ``eagor.cameras``: a name, and a function ``(rest, *, latency,
    rows, rig, rate) -> CameraSource``. Raises `DeviceError`, `ImageError`, `FormatError` for the rig, and
    `MissingExtraError`.
    """
    lenses = rig if rig is None or isinstance(rig, Rig) else read_rig(rig)
    parts = [text]
    if lenses is not None and len(lenses.sizes) > 1 and "," in text and not (os.path.exists(text) or _has_topics(text)):
        parts = text.split(",")
    kinds = [_kind(part) for part in parts]
    settings: dict[str, Any] = {"latency": latency, "rows": rows, "rig": lenses, "rate": rate}
    if camera is not None and (
        camera.known or camera.eyes
    ):  # else not given: cameras of other packages need not know of it
        settings["camera"] = camera
    if len(set(kinds)) > 1:
        raise DeviceError(f"{text} mixes {' and '.join(sorted(set(kinds)))}; wanted the same kind for each lens")
    if kinds[0] in ("folder", "file"):
        kind = FolderCamera if kinds[0] == "folder" else VideoCamera
        return kind([Path(part) for part in parts], **settings, stitched=stitched)
    if kinds[0] in ("bag", "plugin"):
        name, _, rest = ("bag", "", text) if kinds[0] == "bag" else text.partition(":")
        if stitched and name in BUILT_IN:  # those of other packages need not know of it
            settings["stitched"] = True
        return plugins.bring(plugins.known(GROUP, BUILT_IN)[name], "camera")(rest, **settings)
    streams = [_STREAMS[kind](part) for kind, part in zip(kinds, parts, strict=True)]
    return LiveCamera(streams, **settings, stitched=stitched)


def _kind(text: str) -> str:
    if text in ("-", "pipe:", "pipe:0"):
        return "input"
    if text.startswith("pipe:"):
        return "pipe"
    if _DEVICE.match(text):
        return "device"
    if _ADDRESS.match(text):
        return "stream"
    if is_bag(split_bag(text)[0]):
        return "bag"
    if os.path.isdir(text):
        return "folder"
    if os.path.exists(text):
        return "file"
    named = _NAME.fullmatch(text)
    if named is not None and named[1] in plugins.known(GROUP, BUILT_IN):
        return "plugin"
    if named is not None:
        known = ", ".join(f"{name}:" for name in sorted({*plugins.known(GROUP, BUILT_IN), "v4l2", "pipe", *SCHEMES}))
        raise DeviceError(f"there is no file {text!r}, and no source is called {named[1]}: ({known}). Wanted {SOURCES}")
    raise DeviceError(f"there is no file or folder {text!r}; wanted {SOURCES}")


def _has_topics(text: str) -> bool:
    """Whether commas in a source are those between the topics of a bag or of ROS."""
    return is_bag(split_bag(text)[0]) or text.partition(":")[0] in BUILT_IN


def _device(text: str) -> Any:
    place, _, query = text.partition("?")
    found = _DEVICE.fullmatch(place)
    if found is None:
        raise DeviceError(f"{text}: wanted a camera such as /dev/video0, or v4l2:0")
    pairs = (pair.partition("=") for pair in query.split("&") if pair)
    settings = {key: value for key, _, value in pairs}
    return device(found[1] or f"/dev/video{found[2]}", settings)


_STREAMS: dict[str, Callable[[str], Any]] = {
    "input": lambda _: standard_input(),
    # Not sys.stdin: a thread that waits for it holds its lock, and Python then aborts at exit.
    "pipe": lambda text: raw_pipe(text, FileIO(0, closefd=False)),
    "device": _device,
    "stream": network,
}


# --- videos and folders; with a rig, those of lenses ---


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
        camera: Camera | None = None,
        stitched: bool = False,
    ) -> None:
        self.latency, self.dropped, self.problem = latency, 0, None
        self._closed = False
        self._panoramas: Panoramas | None = None  # of a video without a rig: checks its pictures
        self.video: Video | Animation | StitchedVideo | LensVideos = open_video(
            paths, rig, stitched=stitched, rate=rate, rows=rows
        )
        height, width = self.video.shape
        self.grid: ErpGrid | PerspectiveGrid = ErpGrid(height, width)
        self.unseen, self.motion = self.video.unseen, self.video.motion
        if isinstance(self.video, LensVideos):
            self.grid = self.video.grids[0]
        if rig is None:
            self._panoramas = Panoramas(((width, height),), None, rows, self.video.path, camera)
            self.grid = self._panoramas.grid
            self.unseen = self.unseen if self._panoramas.unseen is None else self._panoramas.unseen

    def __iter__(self) -> Iterator[Frame]:
        last = -math.inf
        for number, frame in enumerate(self.video):
            if self._closed:
                return
            picture, view = frame.picture, frame.grid
            if self._panoramas is not None:
                if number == 0:
                    self._panoramas.check(picture)
                picture, view = self._panoramas.make(picture), self._panoramas.view
            last = _after(last, frame.stamp - self.latency)
            yield Frame(last, picture, frame.name, view, frame.lens)

    def close(self) -> None:
        self._closed = True


class FolderCamera:
    """A `CameraSource` of folders of pictures, one per picture of the `rig`, in order of their names.

    Stamps: the names, where all are times (`eagor.odometry.times`: 12.350.png); otherwise `rate` pictures per second
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
        camera: Camera | None = None,
        stitched: bool = False,
    ) -> None:
        self.latency, self.dropped, self.problem = latency, 0, None
        self._closed, self._rig, self._camera = False, rig, camera
        self._moments = list(zip(*lens_folders(folders), strict=True))
        self._stamps = _stamps([moment[0] for moment in self._moments], RATE if rate is None else rate)
        first = self._read(self._moments[0])
        self._makers = makers(sizes_of(first), rig, rows, str(folders[0]), camera, stitched)
        if len(self._makers) == 1:
            self._makers[0].check(*first)
        self.grid, self.unseen = self._makers[0].grid, self._makers[0].unseen

    def __iter__(self) -> Iterator[Frame]:
        last = -math.inf
        for moment, stamp in zip(self._moments, self._stamps, strict=True):
            if self._closed:
                return
            try:
                pictures = self._read(moment)
                if self._rig is None:  # raises for another shape
                    Panoramas(sizes_of(pictures), None, None, str(moment[0]), self._camera)
                made = made_of(self._makers, pictures)
            except EagorError as error:
                if not self.dropped:
                    warnings.warn(f"a picture is left out: {error}", UserWarning, stacklevel=2)
                self.dropped += 1
                continue
            for lens, picture in enumerate(made):
                last = _after(last, stamp - self.latency)
                yield Frame(last, picture, moment[lens].name, self._makers[lens].view, lens)

    def _read(self, moment: tuple[Path, ...]) -> list[np.ndarray]:
        if self._rig is None:
            return [read_photograph(moment[0], warn=False).picture]
        with warnings.catch_warnings():  # of shapes, which are checked here
            warnings.simplefilter("ignore")
            return [read_panorama(path) for path in moment]

    def close(self) -> None:
        self._closed = True


def _after(last: float, stamp: float) -> float:
    """The stamp, or the next one after the last: lenses see at the same moment, and no two frames have one stamp."""
    return max(stamp, math.nextafter(last, math.inf))


def _stamps(paths: Sequence[Path], rate: float) -> list[float]:
    stamps = times_of([path.stem for path in paths])
    if len(paths) > 1 and stamps is not None:
        if any(later <= earlier for earlier, later in pairwise(stamps)):
            raise TimeError(f"{paths[0].parent}: its names are times, and do not increase; rename the pictures")
        return stamps
    if not (math.isfinite(rate) and rate > 0):
        raise TimeError(f"rate = {rate!r}; wanted pictures per second, more than 0")
    return [number / rate for number in range(len(paths))]
