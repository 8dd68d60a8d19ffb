"""Pictures and videos that are dropped on the page: bounded, checked, kept in a folder of this run, then removed."""

from __future__ import annotations

import asyncio
import math
import secrets
import shutil
import tempfile
import warnings
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from eagor._checks import is_twice_as_wide
from eagor.errors import EagorError
from eagor.studio.messages import PageError

if TYPE_CHECKING:
    from eagor.media.intrinsics import IntrinsicsHint

__all__ = ["BYTES", "PIXELS", "Upload", "Uploads"]

BYTES = 1 << 30  # of a file: more than a minute of a 5.7K camera
PIXELS = 64_000_000  # of a picture
KEPT = 12  # files; the oldest goes when another one comes
TOGETHER = 2 << 30  # bytes of all files
PATIENCE = 15.0  # seconds of silence in which an upload is given up
SLOWEST = 1 << 16  # bytes per second of an upload on the whole; less is given up after as many seconds more
NAME = 80  # letters of a name that is shown
LENSES = "Stitch it first, or give its lenses: eagor studio --source FILE --rig LENSES.yaml --query WORDS."
_VIDEOS = {b"ftyp": 4, b"\x1a\x45\xdf\xa3": 0}  # how MP4 and Matroska begin, and where


@dataclass(frozen=True)
class Upload:
    """A file that has been checked: a "photo" or a "video" of so many pixels (and about so many frames).

    `ordinary`: of an ordinary camera, not a panorama; `hfov_deg`: its field of view, where the file tells it.
    """

    id: str
    kind: str
    path: Path
    name: str
    height: int
    width: int
    frames: int
    warnings: tuple[str, ...] = ()
    ordinary: bool = False
    hfov_deg: float | None = None

    def as_json(self) -> dict[str, object]:
        """For the page."""
        shown = ("id", "kind", "name", "height", "width", "frames", "warnings", "ordinary", "hfov_deg")
        return {name: getattr(self, name) for name in shown}


class Uploads:
    """The files of one server, in a folder of their own in the system's place for temporary files."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._kept: dict[str, Upload] = {}

    def get(self, identifier: str) -> Upload:
        """The file of this id. Raises `PageError`."""
        if (found := self._kept.get(identifier)) is None:
            raise PageError("That picture is not here any more.", "Drop the file again.", 404)
        return found

    async def receive(self, declared: int | None, chunks: AsyncIterator[bytes]) -> Path:
        """Write what comes to a file, as far as it may be large and slow; returns its path. Raises `PageError`."""
        too_large = PageError(
            f"The file is larger than {BYTES >> 20} MB.",
            "Cut it, or make it smaller: 4096 columns are plenty. Or leave it where it is: eagor studio --source FILE.",
            413,
        )
        if declared is not None and declared > BYTES:
            raise too_large
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="eagor-studio-"))
        free = shutil.disk_usage(self._folder).free
        if declared is not None and declared > free:
            raise PageError(
                f"The file has {declared >> 20} MB, and {free >> 20} MB are free.", "Make room on the server.", 507
            )
        path = self._folder / secrets.token_hex(8)  # never the name that the page gives
        size = 0
        try:
            with path.open("xb") as file:
                async for chunk in _in_time(chunks):
                    size += len(chunk)
                    if size > BYTES:
                        raise too_large
                    file.write(chunk)
        except OSError as error:
            path.unlink(missing_ok=True)
            raise PageError(f"The file cannot be kept ({error.strerror}).", "Make room on the server.", 507) from error
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        if not size:
            path.unlink(missing_ok=True)
            raise PageError("The file is empty.", "Drop a panorama (JPEG, PNG, WebP) or a 360-degree video.", 400)
        return path

    def keep(self, path: Path, name: str) -> Upload:
        """Check a file that has come and keep it; one that is refused is removed. Raises `PageError`. Takes a while."""
        try:
            found = _video(path, shown(name)) if _is_video(path) else _photo(path, shown(name))
        except PageError:
            path.unlink(missing_ok=True)
            raise
        self._kept[found.id] = found
        while len(self._kept) > KEPT or sum(_size(each.path) for each in self._kept.values()) > TOGETHER:
            if (oldest := next(iter(self._kept))) == found.id:
                break
            self._kept.pop(oldest).path.unlink(missing_ok=True)
        return found

    def close(self) -> None:
        """Remove all files."""
        self._kept.clear()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)


async def _in_time(chunks: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """The same, as long as they come fast enough. Raises `PageError`."""
    now = asyncio.get_running_loop().time
    begun, size = now(), 0
    while True:
        try:
            async with asyncio.timeout_at(min(now(), begun + size / SLOWEST) + PATIENCE):
                chunk = await anext(chunks)
        except StopAsyncIteration:
            return
        except TimeoutError as error:
            raise PageError(
                f"The file comes too slowly: {size} bytes in {now() - begun:.0f} seconds.", "Drop it again.", 408
            ) from error
        size += len(chunk)
        yield chunk


def shown(name: str) -> str:
    """A file's name, for showing: the last part, without what does not print."""
    last = name.replace("\\", "/").rpartition("/")[2]
    return "".join(each for each in last if each.isprintable())[:NAME] or "picture"


def _size(path: Path) -> int:
    with suppress(OSError):
        return path.stat().st_size
    return 0


def _is_video(path: Path) -> bool:
    from eagor.media.panorama import BOXED

    with path.open("rb") as file:
        head = file.read(12)
    return head[8:] not in BOXED and any(head[at:].startswith(mark) for mark, at in _VIDEOS.items())


def _photo(path: Path, name: str) -> Upload:
    from eagor.media.defects import fisheye_circles, problems
    from eagor.media.intrinsics import intrinsics_from_exif
    from eagor.media.panorama import is_whole, opened, read_photograph

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with opened(path) as image:
                width, height = image.size
            if width * height > PIXELS:
                raise PageError(
                    f"{name} has {width} x {height} pixels, more than {PIXELS // 10**6} million.",
                    "Make it smaller: 8192 x 4096 are plenty.", 413,
                )  # fmt: skip
            found = read_photograph(path).picture
    except PageError:
        raise
    except EagorError as error:
        words = " ".join(str(error).replace(str(path), name).replace(repr(str(path)), name).split())
        raise PageError(f"{name} cannot be used: {words}.", "Drop an equirectangular panorama.", 422) from error
    except Exception as error:  # Pillow raises anything for what is no picture
        raise PageError(
            f"{name} is no picture that can be read ({type(error).__name__}).",
            "Drop a panorama (JPEG, PNG, WebP) or a 360-degree video (MP4, MKV).", 415,
        ) from error  # fmt: skip
    if not is_whole(found):
        high, wide = found.shape[:2]
        hfov = _field(intrinsics_from_exif(path), wide, high, name)
        return Upload(path.name, "photo", path, name, high, wide, 1, ordinary=True, hfov_deg=hfov)
    if fisheye_circles(found):
        raise PageError(f"{name} shows the circles of a fisheye camera.", LENSES, 422)
    return Upload(path.name, "photo", path, name, found.shape[0], found.shape[1], 1, tuple(problems(found)))


def _field(hint: IntrinsicsHint, width: int, height: int, name: str) -> float | None:
    """The horizontal field in degrees that a file tells of its ordinary camera; None: nothing."""
    from eagor.media.intrinsics import Camera, ordinary_grid

    grid = ordinary_grid(Camera(), hint, (width, height), name)
    return None if grid is None else round(math.degrees(grid.hfov), 1)


def _video(path: Path, name: str) -> Upload:
    from eagor.media.video import Video
    from eagor.studio.eye import ROWS
    from eagor.studio.session import LOOKS

    try:
        found = Video(path, rate=LOOKS, rows=ROWS)
    except EagorError as error:
        words = " ".join(str(error).replace(str(path), name).split())
        change = LENSES if "circles" in words else "Drop an equirectangular video (MP4, MKV)."
        raise PageError(f"{name} cannot be used: {words}.", change, 422) from error
    height, width = found.shape
    if not is_twice_as_wide(height, width):
        hfov = _field(found.hint, width, height, name)
        return Upload(path.name, "video", path, name, height, width, found.count or 0, ordinary=True, hfov_deg=hfov)
    return Upload(path.name, "video", path, name, height, width, found.count or 0)
