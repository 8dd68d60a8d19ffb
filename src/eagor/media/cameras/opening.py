"""What SOURCE on the command line means: `open_camera`."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from io import FileIO
from pathlib import Path
from typing import Any

from eagor import plugins
from eagor.errors import DeviceError
from eagor.media.bags.reader import is_bag, split_bag
from eagor.media.camera_sources import FolderCamera, VideoCamera
from eagor.media.frames import CameraSource
from eagor.media.live_camera import LiveCamera
from eagor.media.rigs import Rig, read_rig
from eagor.media.streams import SCHEMES, device, network, raw_pipe, standard_input

__all__ = ["BUILT_IN", "GROUP", "SOURCES", "open_camera"]

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


def open_camera(
    text: str,
    *,
    latency: float = 0.0,
    rows: int | None = None,
    rig: Rig | str | os.PathLike[str] | None = None,
    rate: float | None = None,
) -> CameraSource:
    """The source of pictures that `text` names (`SOURCES`), or that another package brings (``NAME:REST``).

    `latency`: seconds from capture to arrival, taken off the stamps. `rows`: the most rows of a panorama. `rig`: the
    lenses (`eagor.media.cameras.rig`) or their YAML file, if the pictures are not panoramas; for a rig with several
    pictures, `text` is as many sources with commas between, unless one gives all. `rate`: the most pictures per second
    to take; for a folder, how many per second were taken.

    Other packages add cameras under the entry points ``eagor.cameras``: a name, and a function ``(rest, *, latency,
    rows, rig, rate) -> CameraSource``. Raises `DeviceError`, `ImageError`, `FormatError` for the rig, and
    `MissingExtraError`.
    """
    lenses = rig if rig is None or isinstance(rig, Rig) else read_rig(rig)
    parts = [text]
    if lenses is not None and len(lenses.sizes) > 1 and "," in text and not os.path.exists(text):
        parts = text.split(",")
    kinds = [_kind(part) for part in parts]
    settings: dict[str, Any] = {"latency": latency, "rows": rows, "rig": lenses, "rate": rate}
    if len(set(kinds)) > 1:
        raise DeviceError(f"{text} mixes {' and '.join(sorted(set(kinds)))}; wanted the same kind for each lens")
    if kinds[0] == "folder":
        return FolderCamera([Path(part) for part in parts], **settings)
    if kinds[0] == "file":
        return VideoCamera([Path(part) for part in parts], **settings)
    if kinds[0] == "bag":
        return plugins.bring(plugins.known(GROUP, BUILT_IN)["bag"], "camera")(text, **settings)
    if kinds[0] == "plugin":
        return _plugin(text, settings)
    return LiveCamera([_OPENINGS[kind](part) for kind, part in zip(kinds, parts, strict=True)], **settings)


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


def _device(text: str) -> Any:
    place, _, query = text.partition("?")
    found = _DEVICE.fullmatch(place)
    if found is None:
        raise DeviceError(f"{text}: wanted a camera such as /dev/video0, or v4l2:0")
    pairs = (pair.partition("=") for pair in query.split("&") if pair)
    settings = {key: value for key, _, value in pairs}
    return device(found[1] or f"/dev/video{found[2]}", settings)


_OPENINGS: dict[str, Callable[[str], Any]] = {
    "input": lambda _: standard_input(),
    # Not sys.stdin: a thread that waits for it holds its lock, and Python then aborts at exit.
    "pipe": lambda text: raw_pipe(text, FileIO(0, closefd=False)),
    "device": _device,
    "stream": network,
}


def _plugin(text: str, settings: dict[str, Any]) -> CameraSource:
    """The camera of another package, or that of ROS."""
    name, _, rest = text.partition(":")
    point = plugins.known(GROUP, BUILT_IN)[name]
    make = plugins.bring(point, "camera")
    return make(rest, **settings)
