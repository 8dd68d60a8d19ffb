"""Where panoramas come from: `open_source` for what SOURCE on the command line means, videos, folders.

Packages add cameras of their own under the entry points ``eagor.cameras``; `eagor.media.check_camera` tests one.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from io import FileIO
from pathlib import Path
from typing import Any

from eagor import plugins
from eagor._checks import above
from eagor.cameras import Rig
from eagor.errors import DeviceError, TimeError
from eagor.media import CameraSource
from eagor.media.bag_sources import BagCamera
from eagor.media.bags import is_bag, split_bag
from eagor.media.films import open_video
from eagor.media.footage import BagFrames, Footage, FrameCheck, VideoFrames, images, is_video, warned
from eagor.media.intrinsics import Camera, in_words
from eagor.media.live_camera import SCHEMES, LiveCamera, device, network, raw_pipe, standard_input
from eagor.media.rigs import read_rig

__all__ = ["BUILT_IN", "GROUP", "SOURCES", "open_footage", "open_source"]

GROUP = "eagor.cameras"
BUILT_IN = {"apartment": "eagor.lab.tasks.sim.walk:open_walk", "ros": "eagor.robots.ros:RosCamera"}
SOURCES = (
    "a folder of pictures, a picture, a video file, a ROS 2 bag (BAG?topic=/image), /dev/video0 or v4l2:0 "
    "(?size=1920x960&rate=30&format=mjpeg), rtsp://..., rtmp://..., http://..., udp://..., ros:/image_topic, - "
    "(encoded pictures on standard input) or pipe:rgb24:1920x960 (raw ones)"
)
_DEVICE = re.compile(r"(?:v4l2:)?(/dev/[^?]+)|v4l2:(\d+)")
_ADDRESS = re.compile(rf"(?:{'|'.join(SCHEMES)})://", re.IGNORECASE)
_NAME = re.compile(r"([A-Za-z][\w-]+):(.*)", re.DOTALL)


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
    lenses (`eagor.media.rigs`) or their YAML file, if the pictures are not panoramas; for a rig with several
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
    streams = [_STREAMS[kind](part) for kind, part in zip(kinds, parts, strict=True)]
    return LiveCamera(streams, **settings)


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
    say, camera = say or warned, camera or Camera()
    path, topic = split_bag(str(places[0]))
    if is_bag(path):
        bag = BagCamera(path, topic, rows=rows, rig=rig, camera=camera, info=info)
        if bag.lens is not None:
            say(f"{bag.topic}: {in_words(bag.lens.name, bag.view)}")
        check = FrameCheck(force, say, Camera(eyes="mono") if camera.eyes else None)  # of two eyes it takes one
        return Footage(BagFrames(bag, check, rate, start, end), latency)
    paths, check = [Path(place) for place in places], FrameCheck(force, say, camera, rig)
    if is_video(paths, rig is not None):
        video = open_video(paths, rig, rate=rate, start=start, end=end, rows=rows)
        return Footage(VideoFrames(video, check), latency)
    return Footage(images(paths, rate, check), latency, rows)


def _kind(text: str) -> str:
    if text in ("-", "pipe:", "pipe:0"):
        return "input"
    if text.startswith("pipe:"):
        return "pipe"
    if _DEVICE.match(text):
        return "device"
    if _ADDRESS.match(text):
        return "stream"
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


def _device(text: str) -> Any:
    place, _, query = text.partition("?")
    if (found := _DEVICE.fullmatch(place)) is None:
        raise DeviceError(f"{text}: wanted a camera such as /dev/video0, or v4l2:0")
    settings = {key: value for key, _, value in (pair.partition("=") for pair in query.split("&") if pair)}
    return device(found[1] or f"/dev/video{found[2]}", settings)


_STREAMS: dict[str, Callable[[str], Any]] = {
    "input": lambda _: standard_input(),
    # Not sys.stdin: a thread that waits for it holds its lock, and Python then aborts at exit.
    "pipe": lambda text: raw_pipe(text, FileIO(0, closefd=False)),
    "device": _device,
    "stream": network,
}
