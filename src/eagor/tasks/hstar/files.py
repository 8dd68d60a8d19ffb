"""Where H*Bench's scenes are: in folders, or in the published zip archives as they are.

``<anything>/<scene>/annotation.json`` beside the scene's panorama: the first ``*.png`` by name, else the first
``*.jpg``.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from eagor._files import most_unpacked
from eagor.errors import FormatError, ImageError

ANNOTATION = "annotation.json"


@dataclass(frozen=True)
class Stored:
    """A file, or a member of a zip archive."""

    path: str
    member: str = ""

    def read(self) -> bytes:
        """What it holds. Raises whatever `zipfile` is led to by damage, `OSError`, or `FormatError` if it is a bomb."""
        if not self.member:
            return Path(self.path).read_bytes()
        archive = _archive(self.path)
        entry = archive.getinfo(self.member)
        most = most_unpacked(entry.compress_size)
        if entry.file_size > most:  # zipfile reads no more than that
            raise FormatError(
                f"it claims {entry.file_size} bytes, packed in {entry.compress_size}; wanted at most {most}"
            )
        return archive.read(self.member)

    def __str__(self) -> str:
        return f"{self.path}: {self.member}" if self.member else self.path


@dataclass(frozen=True)
class Found:
    """A scene: its name, its picture, its annotations."""

    name: str
    panorama: Stored
    annotation: Stored


def find_scenes(data: Path) -> list[Found]:
    """All scenes in the folder (or archive) `data`, by name; those without a picture are left out, as published.

    Scenes go by the name of their folder alone where that is unique, so that it does not depend on what is above.
    Raises `FormatError` where there is none at all.
    """
    data = Path(data)
    if not data.exists():
        raise FormatError(f"there is no {data}; name the folder (or zip) with H*Bench's scenes")
    found: list[Found] = []
    for folder in sorted({path.parent for path in data.rglob(ANNOTATION)} if data.is_dir() else ()):
        picture = _picture(sorted(path.name for path in folder.iterdir() if path.is_file()))
        if picture:
            relative = folder.relative_to(data)
            name = relative.as_posix() if relative.parts else data.name
            found.append(Found(name, Stored(str(folder / picture)), Stored(str(folder / ANNOTATION))))
    extracted = {Path(scene.name).parts[0] for scene in found}
    for archive in sorted(data.rglob("*.zip")) if data.is_dir() else [data]:
        if data.is_dir() and archive.stem in extracted:
            continue  # its folder lies beside it
        found += _in_archive(archive)
    if not found:
        raise FormatError(
            f"{data} has no scene; wanted folders with {ANNOTATION} and one .png or .jpg each, or hos_bench.zip and "
            "hps_bench.zip as published"
        )
    last = [scene.name.rpartition("/")[2] for scene in found]
    short = [replace(one, name=end) if last.count(end) == 1 else one for end, one in zip(last, found, strict=True)]
    return sorted(short, key=lambda scene: scene.name)


@lru_cache(maxsize=2)
def open_panorama(panorama: Stored) -> np.ndarray:
    """The picture ``(H, W, 3)`` uint8, whatever its proportions: columns span 360 degrees, rows 180.

    Read-only: it is kept. Raises `ImageError` if it is not there or no picture.
    """
    from eagor.worlds.panorama import read_image

    try:
        data = panorama.read()
        image = read_image(io.BytesIO(data), len(data))
    except Exception as error:  # decoders raise whatever the damage leads them to
        raise ImageError(
            f"the panorama {panorama} cannot be read ({type(error).__name__}: {error}); fetch it again"
        ) from error
    image.setflags(write=False)
    return image


def _picture(names: list[str]) -> str | None:
    for ending in (".png", ".jpg", ".jpeg"):
        for name in names:
            if name.lower().endswith(ending):
                return name
    return None


def _in_archive(archive: Path) -> list[Found]:
    try:
        with zipfile.ZipFile(archive) as file:
            names = sorted(name for name in file.namelist() if not name.startswith("__MACOSX"))
    except Exception as error:  # zipfile raises whatever the damage leads it to
        raise FormatError(f"{archive} is no zip archive that can be read ({error}); fetch it again") from error
    found = []
    folders: dict[str, list[str]] = {}
    for name in names:
        folder, _, last = name.rpartition("/")
        folders.setdefault(folder, []).append(last)
    for folder, inside in folders.items():
        if ANNOTATION not in inside:
            continue
        annotation, picture = f"{folder}/{ANNOTATION}" if folder else ANNOTATION, _picture(inside)
        if picture:
            path = f"{folder}/{picture}" if folder else picture
            name = f"{archive.stem}/{folder}" if folder else archive.stem
            found.append(Found(name, Stored(str(archive), path), Stored(str(archive), annotation)))
    return found


@lru_cache(maxsize=4)
def _archive(path: str) -> zipfile.ZipFile:
    return zipfile.ZipFile(path)
