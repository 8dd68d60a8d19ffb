"""Pictures and videos that are dropped on the page: bounded, kept in a folder of this run, then removed."""

from __future__ import annotations

import secrets
import shutil
import tempfile
import warnings
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

from eagor.errors import EagorError
from eagor.studio.messages import PageError

__all__ = ["BYTES", "PIXELS", "Upload", "Uploads"]

BYTES = 1 << 30  # of a file: more than a minute of a 5.7K camera
PIXELS = 64_000_000  # of a picture
KEPT = 12  # files; the oldest goes when another one comes
NAME = 80  # letters of a name that is shown
DROP = "Drop a picture (JPEG, PNG, WebP) or a video (MP4, MKV)."
_VIDEOS = {b"ftyp": 4, b"\x1a\x45\xdf\xa3": 0}  # how MP4 and Matroska begin, and where


@dataclass(frozen=True)
class Upload:
    """A file that has come: a "photo" or a "video", the `name` that a person gave it, and the `source` to open."""

    id: str
    kind: str
    name: str
    source: str


class Uploads:
    """The files of one server, each in a folder of its own in the system's place for temporary files."""

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="eagor-studio-"))
        self._kept: dict[str, Upload] = {}

    def get(self, identifier: str) -> Upload:
        """The file of this id. Raises `PageError`."""
        if (found := self._kept.get(identifier)) is None:
            raise PageError("That picture is not here any more.", "Drop the file again.", 404)
        return found

    async def receive(self, declared: int, chunks: AsyncIterator[bytes], name: str) -> Upload:
        """Write what comes to a file, as far as it may be large (`declared` bytes, if known), and check it.

        Raises `PageError`.
        """
        identifier, size = secrets.token_hex(8), 0  # never the name that the page gives
        folder = self._folder / identifier
        folder.mkdir()
        name = "".join(each for each in name.replace("\\", "/").rpartition("/")[2] if each.isprintable())[:NAME]
        try:
            with (folder / "file").open("xb") as file:
                async for chunk in chunks:
                    size += len(chunk)
                    if max(size, declared) > BYTES:
                        change = "Make it smaller. Or leave it where it is: eagor studio --source FILE."
                        raise PageError(f"The file is larger than {BYTES >> 20} MB.", change, 413)
                    file.write(chunk)
            found = Upload(identifier, *_checked(folder / "file", name or "picture"))
        except BaseException as error:
            shutil.rmtree(folder, ignore_errors=True)
            if isinstance(error, OSError):
                raise PageError(f"The file cannot be kept ({error.strerror}).", "Make room here.", 507) from error
            raise
        self._kept[identifier] = found
        while len(self._kept) > KEPT:
            shutil.rmtree(self._folder / self._kept.pop(next(iter(self._kept))).id, ignore_errors=True)
        return found

    def close(self) -> None:
        """Remove all files."""
        shutil.rmtree(self._folder, ignore_errors=True)


def _checked(path: Path, name: str) -> tuple[str, str, str]:
    """What a file is, its name, and the source to open: of a photograph, a folder. Raises `PageError`."""
    from eagor.sources.animations import is_animation
    from eagor.sources.panorama import BOXED, IMAGES, opened

    with path.open("rb") as file:
        head = file.read(12)
    if any(head[at:].startswith(mark) for mark, at in _VIDEOS.items()) and head[8:] not in BOXED:
        return "video", name, str(path)
    try:
        with warnings.catch_warnings(), opened(path) as image:
            warnings.simplefilter("ignore")
            pixels, suffix = image.width * image.height, f".{(image.format or '').lower()}"
    except Exception as error:  # Pillow raises anything for what is no picture
        what = str(error).replace(repr(str(path)), name) if isinstance(error, EagorError) else type(error).__name__
        raise PageError(f"{name} is no picture that can be read: {' '.join(what.split())}.", DROP, 415) from error
    if pixels > PIXELS:
        raise PageError(f"{name} has more than {PIXELS // 10**6} million pixels.", "Make it smaller.", 413)
    if is_animation(path):
        return "video", name, str(path)
    path.rename(path.with_suffix(suffix if suffix in IMAGES else ".jpg"))
    return "photo", name, str(path.parent)
