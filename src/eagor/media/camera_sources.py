"""Where panoramas come from: `open_camera` for what SOURCE on the command line means, videos, folders; `Newest` of any.

Packages add cameras of their own under the entry points ``eagor.cameras``; `eagor.media.check_camera` tests one.
"""

from __future__ import annotations

import math
import os
import re
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from io import FileIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from eagor import plugins
from eagor.errors import DeviceError, EagorError, TimeError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.media import CameraSource, Frame
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

__all__ = [
    "BUILT_IN", "GROUP", "SOURCES", "FolderCamera", "Newest", "VideoCamera", "open_camera",
]  # fmt: skip

GROUP = "eagor.cameras"
BUILT_IN = {"bag": "eagor.robots.ros.sources:BagCamera", "ros": "eagor.robots.ros.sources:RosCamera"}
SOURCES = (
    "a folder of panoramas, a video file, a ROS 2 bag (BAG?topic=/image), /dev/video0 or v4l2:0 "
    "(?size=1920x960&rate=30&format=mjpeg), rtsp://..., rtmp://..., http://..., udp://..., ros:/image_topic, - "
    "(encoded pictures on standard input) or pipe:rgb24:1920x960 (raw ones)"
)
_DEVICE = re.compile(r"(?:v4l2:)?(/dev/[^?]+)|v4l2:(\d+)")
_ADDRESS = re.compile(rf"(?:{'|'.join(SCHEMES)})://", re.IGNORECASE)
_NAME = re.compile(r"([A-Za-z][\w-]+):(.*)", re.DOTALL)

RATE = 1.0  # pictures per second of a folder whose files do not tell times
_TIME = re.compile(r"\d+\.\d+")  # a file's name without its ending that is a time: 12.350.png

PATIENCE = 5.0  # seconds that `close` waits for the thread; one that hangs in a driver is left behind


# --- what a source is ---


def open_camera(
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
    if camera is not None and camera.known:  # else not given: cameras of other packages need not know of it
        settings["camera"] = camera
    if len(set(kinds)) > 1:
        raise DeviceError(f"{text} mixes {' and '.join(sorted(set(kinds)))}; wanted the same kind for each lens")
    if kinds[0] == "folder":
        return FolderCamera([Path(part) for part in parts], **settings, stitched=stitched)
    if kinds[0] == "file":
        return VideoCamera([Path(part) for part in parts], **settings, stitched=stitched)
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
        self.video: Video | StitchedVideo | LensVideos = open_video(paths, rig, stitched=stitched, rate=rate, rows=rows)
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
    names = [path.stem for path in paths]
    if len(names) > 1 and all(_TIME.fullmatch(name) for name in names):
        stamps = [float(name) for name in names]
        if any(later <= earlier for earlier, later in pairwise(stamps)):
            raise TimeError(f"{paths[0].parent}: its names are times, and do not increase; rename the pictures")
        return stamps
    if not (math.isfinite(rate) and rate > 0):
        raise TimeError(f"rate = {rate!r}; wanted pictures per second, more than 0")
    return [number / rate for number in range(len(names))]


# --- the newest frame, for a slow reader ---


class Newest:
    """A thread reads `source`; `take` gives the newest frame that was not taken yet.

    Of a live source, frames that came meanwhile are skipped and counted in `skipped`. A source that keeps only the
    newest itself (its attribute `keeps_newest`; its `dropped` counts) is asked when somebody wants a frame: what nobody
    takes is not even stitched. Of a file, nothing is skipped: the next picture is read once the last one was taken.

    `problem`: what is wrong with the source now, in words, or None; `ended`: whether no frame can come any more. A
    context manager; `close` also closes the source, and may be called twice.
    """

    def __init__(self, source: CameraSource) -> None:
        self.source = source
        self.skipped = 0
        self._eager = source.live and not getattr(source, "keeps_newest", False)
        self._changed = threading.Condition()
        self._frame: Frame | None = None
        self._wanted = self._closed = self._ended = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._read, name="eagor-newest-frame", daemon=True)
        self._thread.start()

    def __enter__(self) -> Newest:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def ended(self) -> bool:
        """Whether the source has ended, or was closed, and its last frame was taken."""
        with self._changed:
            return (self._ended or self._closed) and self._frame is None

    @property
    def problem(self) -> str | None:
        """What is wrong right now, in words; None if nothing is."""
        with self._changed:
            if self._error is not None:
                return str(self._error)
        return getattr(self.source, "problem", None)

    @property
    def dropped(self) -> int:
        """Frames of the source that nobody got: skipped here, or dropped by the source itself."""
        return self.skipped + self.source.dropped

    def take(self, timeout: float | None = None) -> Frame | None:
        """The newest frame that was not taken yet; waits for one up to `timeout` seconds (None: for ever).

        None if none came in time, or none can come any more (`ended`). Raises the source's error, once, if it ended in
        one.
        """
        end = None if timeout is None else time.monotonic() + timeout
        with self._changed:
            self._wanted = True
            self._changed.notify_all()
            while self._frame is None and not (self._ended or self._closed):
                left = None if end is None else end - time.monotonic()
                if left is not None and left <= 0:
                    return None
                self._changed.wait(left)
            frame, self._frame = self._frame, None
            if frame is not None:
                self._wanted = False
                self._changed.notify_all()
            elif self._error is not None and not self._closed:
                error, self._error = self._error, None
                raise error
            return frame

    def close(self) -> None:
        """Close the source and end the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self.source.close()
        if self._thread is not threading.current_thread():
            self._thread.join(PATIENCE)

    def _read(self) -> None:
        frames: Iterator[Frame] | None = None
        try:
            frames = iter(self.source)
            while self._asked():
                frame = next(frames, None)
                if frame is None:
                    break
                with self._changed:
                    self.skipped += self._frame is not None
                    self._frame = frame
                    self._changed.notify_all()
        except Exception as error:  # whoever takes the next frame is told
            with self._changed:
                self._error = error
        finally:
            if frames is not None and hasattr(frames, "close"):
                with suppress(Exception):
                    frames.close()  # type: ignore[attr-defined]
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _asked(self) -> bool:
        """Wait until the next frame is to be read; False after `close`."""
        with self._changed:
            while not self._closed and not self._eager and (self._frame is not None or not self._wanted):
                self._changed.wait()
            return not self._closed
