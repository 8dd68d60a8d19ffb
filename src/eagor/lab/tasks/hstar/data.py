"""H*Bench's published data: scenes with one panorama and annotations, in folders or in the original zip archives.

The layout is ``<anything>/<scene>/annotation.json`` beside the scene's panorama: the first ``*.png`` by name, otherwise
the first ``*.jpg``. As in the published environment, ``.PNG`` and ``.jpeg`` are other endings, whose scenes are skipped
(`info` names them), and a picture is turned by its orientation tag (Exif). An entry with ``pitch`` is an object to find
(HOS), one without is a path to take (HPS). There is one episode per entry and start.
"""

from __future__ import annotations

import io
import random
import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from eagor._checks import number, parsed, shown
from eagor._files import most_unpacked
from eagor._values import lazy
from eagor.errors import EagorError, FormatError, ImageError
from eagor.lab.tasks.hstar.rules import FARTHEST, View, level_of, window_of
from eagor.lab.tasks.published import picture_size

Kind = Literal["hos", "hps"]
Angle = int | float  # degrees, as the file has them

ANNOTATION = "annotation.json"
PICTURES = (".png", ".jpg")  # as published: in lower case, and no .jpeg
STARTS = (0, 90, 180, 270)  # degrees of yaw, for entries without any
SHUFFLE = 42  # the published environment shuffles its episodes with this seed
LEVELS = {"hos": ("easy", "medium", "hard"), "hps": ("easy", "medium", "hard", "extreme")}


@dataclass(frozen=True)
class Stored:
    """A file, or a member of a zip archive."""

    path: str
    member: str = ""

    def read(self) -> bytes:
        """Its content. Raises `OSError`, whatever `zipfile` raises for damage, or `FormatError` for a zip bomb."""
        if not self.member:
            return Path(self.path).read_bytes()
        archive = _archive(self.path)
        entry = archive.getinfo(self.member)
        most = most_unpacked(entry.compress_size)
        if entry.file_size > most:  # zipfile reads no more than the claimed size
            raise FormatError(
                f"it claims {entry.file_size} bytes, packed in {entry.compress_size}; wanted at most {most}"
            )
        return archive.read(self.member)

    def __str__(self) -> str:
        return f"{self.path}: {self.member}" if self.member else self.path


@dataclass(frozen=True)
class Scene:
    """A folder of the data: its name, its picture, and its annotations."""

    name: str
    panorama: Stored
    annotation: Stored

    @lazy
    def items(self) -> tuple[Mapping[str, Any], ...]:
        """The annotations as in the file. Raises `FormatError` if they are malformed."""
        return _items(self.annotation)


@dataclass(frozen=True)
class Episode:
    """One start for one target; `id` is ``scene/entry/start``, `entry` its index in annotation.json.

    `task`: the instruction. `yaw`, `pitch`: the annotated box, degrees, as written (pitch None in HPS). `start`: yaw
    of the first view, whose pitch is 0. `level`: 0, 1, ..., None if unknown.
    """

    id: str
    scene: str
    entry: int
    kind: Kind
    task: str
    yaw: tuple[Angle, Angle]
    pitch: tuple[Angle, Angle] | None
    start: Angle
    level: int | None
    panorama: Stored

    @property
    def item(self) -> dict[str, Any]:
        """As an entry of annotation.json, for `eagor.lab.tasks.hstar.rules`."""
        return {"task": self.task, "yaw": self.yaw, **({"pitch": self.pitch} if self.pitch is not None else {})}

    @property
    def level_name(self) -> str:
        """The level in words; "unknown" if there is none."""
        names = LEVELS[self.kind]
        return names[self.level] if self.level is not None and self.level < len(names) else "unknown"

    @property
    def cluster(self) -> str:
        """The id that all starts for one target share."""
        return f"{self.scene}/{self.entry}"

    @property
    def first_view(self) -> View:
        """The view at the start."""
        return View(float(self.start), 0.0)

    def as_json(self) -> dict[str, Any]:
        """Plain JSON, for `from_json`."""
        return msgspec.json.decode(msgspec.json.encode(self))

    @classmethod
    def from_json(cls, entry: Mapping[str, Any]) -> Episode:
        """The episode from the output of `as_json`."""
        return msgspec.convert(entry, cls)


def find_scenes(data: Path) -> list[Scene]:
    """All scenes in the folder (or archive) `data`, by name; scenes without a picture are left out, as published.

    A scene is named by its folder alone if that is unique, so that parent folders do not matter. Raises `FormatError`
    if there is none. Annotations are not read yet.
    """
    scenes, skipped = _scan(data)
    if not scenes:
        also = f"; {skipped[0]} has {ANNOTATION}, but no such picture" if skipped else ""
        raise FormatError(
            f"{data} has no scene; wanted folders with {ANNOTATION} and one .png or .jpg each, in lower case (.PNG and "
            f".jpeg do not count, as published), or hos_bench.zip and hps_bench.zip as published{also}"
        )
    last = Counter(scene.name.rpartition("/")[2] for scene in scenes)
    short = [replace(one, name=end) if last[end := one.name.rpartition("/")[2]] == 1 else one for one in scenes]
    return sorted(short, key=lambda scene: scene.name)


def _scan(data: Path) -> tuple[list[Scene], list[str]]:
    """The scenes in `data`, and the folders with annotations, but without a picture of one of the two endings."""
    data = Path(data)
    if not data.exists():
        raise FormatError(f"there is no {data}; name the folder (or zip) with H*Bench's scenes")
    scenes: list[Scene] = []
    skipped: list[str] = []
    for folder in sorted({path.parent for path in data.rglob(ANNOTATION)} if data.is_dir() else ()):
        picture = _picture(sorted(path.name for path in folder.iterdir() if path.is_file()))
        if picture:
            name = folder.relative_to(data).as_posix() if folder != data else data.name
            scenes.append(Scene(name, Stored(str(folder / picture)), Stored(str(folder / ANNOTATION))))
        else:
            skipped.append(str(folder))
    extracted = {Path(scene.name).parts[0] for scene in scenes}
    for archive in sorted(data.rglob("*.zip")) if data.is_dir() else [data]:
        if data.is_dir() and archive.stem in extracted:
            continue  # its folder lies beside it
        for folder, names in _folders_in(archive).items():
            if ANNOTATION in names and (picture := _picture(names)):
                files = (Stored(str(archive), folder + name) for name in (picture, ANNOTATION))
                scenes.append(Scene(f"{archive.stem}/{folder}".rstrip("/"), *files))
            elif ANNOTATION in names:
                skipped.append(f"{archive}: {folder}")
    return scenes, skipped


def _folders_in(archive: Path) -> dict[str, list[str]]:
    """The folders in an archive, each with a slash at its end, and the files in them, by name."""
    try:
        with zipfile.ZipFile(archive) as file:
            names = sorted(name for name in file.namelist() if not name.startswith("__MACOSX"))
    except Exception as error:  # zipfile may raise anything for damaged files
        raise FormatError(f"{archive} cannot be read as a zip archive ({error}); fetch it again") from error
    folders: dict[str, list[str]] = {}
    for name in names:
        folder, slash, last = name.rpartition("/")
        folders.setdefault(folder + slash, []).append(last)
    return folders


def _picture(names: Sequence[str]) -> str | None:
    return next((name for ending in PICTURES for name in names if name.endswith(ending)), None)


@lru_cache(maxsize=4)
def _archive(path: str) -> zipfile.ZipFile:
    return zipfile.ZipFile(path)


@lru_cache(maxsize=2)
def open_panorama(panorama: Stored) -> np.ndarray:
    """The picture ``(H, W, 3)`` uint8 of any proportions: columns span 360 degrees, rows 180.

    It is turned by its orientation tag, as the published environment reads it. Read-only, as it is cached. Raises
    `ImageError` if it is missing or not a picture.
    """
    from PIL import ImageOps

    from eagor.media.panorama import read_image

    try:
        data = panorama.read()
        image = read_image(io.BytesIO(data), len(data), ImageOps.exif_transpose)
    except Exception as error:  # decoders may raise anything for damaged files
        raise ImageError(
            f"the panorama {panorama} cannot be read ({type(error).__name__}: {error}); fetch it again"
        ) from error
    image.setflags(write=False)
    return image


def read_scenes(data: Path) -> list[Scene]:
    """`find_scenes` with all annotations read. Raises `FormatError` also for malformed annotations."""
    scenes = find_scenes(data)
    for scene in scenes:
        _ = scene.items
    return scenes


def read_episodes(data: Path, kind: Kind) -> list[Episode]:
    """The episodes of one kind, in the published order: by folder, then shuffled with the seed 42.

    Raises `FormatError` if there is none of this kind, or the data is not H*Bench's.
    """
    scenes = read_scenes(data)
    episodes = [episode for scene in scenes for episode in _episodes(scene) if episode.kind == kind]
    if not episodes:
        wanted = "with pitch (objects)" if kind == "hos" else "without pitch (paths)"
        raise FormatError(f"{data} has {len(scenes)} scenes, but no annotation {wanted}: it is not {kind.upper()} data")
    random.Random(SHUFFLE).shuffle(episodes)
    return episodes


def info(data: Path) -> dict[str, Any]:
    """The content of the folder: counts, picture sizes, and oddities. Raises `FormatError`."""
    scenes = read_scenes(data)
    episodes = [episode for scene in scenes for episode in _episodes(scene)]
    items = [item for scene in scenes for item in scene.items]
    sizes = {scene.name: _size(scene.panorama) for scene in scenes}
    readable = [size for size in sizes.values() if size is not None]
    widths, heights = zip(*readable, strict=True) if readable else ((), ())
    counts = {kind: Counter(each.level_name for each in episodes if each.kind == kind) for kind in LEVELS}
    return {
        "benchmark": "H*Bench",
        "scenes": len(scenes),
        "targets": len(items),
        "episodes": {kind: count.total() for kind, count in counts.items()},
        "levels": {
            kind: {name: count[name] for name in (*LEVELS[kind], "unknown") if count[name]}
            for kind, count in counts.items()
            if count
        },
        "widths": [min(widths), max(widths)] if widths else None,
        "heights": [min(heights), max(heights)] if heights else None,
        "not_2_to_1": sum(width != 2 * height for width, height in readable),
        "skipped": _scan(data)[1],
        "unreadable": [name for name, size in sizes.items() if size is None],
        "without_initial_yaw": sum("initial yaw" not in item for item in items),
        "without_level": sum("level" not in item for item in items),
        "windows_across_yaw_0": sum(window_of(item).wraps for item in items),
        "archives": len({scene.panorama.path for scene in scenes if scene.panorama.member}),
    }


def _size(stored: Stored) -> tuple[int, int] | None:
    try:
        return picture_size(io.BytesIO(stored.read()) if stored.member else Path(stored.path), upright=True)
    except Exception:  # zipfile may raise anything for damaged files
        return None


def _episodes(scene: Scene) -> Iterator[Episode]:
    for entry, item in enumerate(scene.items):
        yaw, pitch = tuple(item["yaw"]), tuple(item["pitch"]) if item.get("pitch") is not None else None
        names: Counter[str] = Counter()
        for start, level in _starts(item):
            name = f"{scene.name}/{entry}/{start:g}"
            names[name] += 1
            name += f"-{names[name]}" if names[name] > 1 else ""
            if level is None and pitch is not None:
                level = level_of(View(start, 0.0), yaw, pitch)
            kind: Kind = "hps" if pitch is None else "hos"
            yield Episode(name, scene.name, entry, kind, item["task"], yaw, pitch, start, level, scene.panorama)


def _starts(item: Mapping[str, Any]) -> list[tuple[float, int | None]]:
    """Starts with their levels; the shorter of the two lists decides, as published."""
    given, level = item.get("initial yaw", list(STARTS)), item.get("level")
    if not isinstance(given, list):
        raise FormatError(f"initial yaw is {shown(given)}; wanted a list of angles in degrees")
    starts = [number(start) if "initial yaw" in item else start for start in given]
    if any(abs(start) > FARTHEST for start in starts):
        raise FormatError(f"initial yaw is {shown(given)}; wanted angles of at most {FARTHEST:g} degrees")
    levels = level if isinstance(level, list) else [level] * len(starts)
    return [(start, None if one is None else _rank(one)) for start, one in zip(starts, levels, strict=False)]


def _rank(level: Any) -> int:
    rank = number(level)
    if rank < 0 or not rank.is_integer():
        raise FormatError(f"level is {shown(level)}; wanted 0, 1, 2, ...")
    return int(rank)


def _items(where: Stored) -> tuple[Mapping[str, Any], ...]:
    try:
        items = parsed(where.read().decode("utf-8-sig"))
    except ValueError as error:
        raise FormatError(f"{where} is not JSON ({error}); restore it from the published archive") from None
    except Exception as error:  # zipfile may raise anything for damaged files
        raise FormatError(f"{where} cannot be read ({type(error).__name__}: {error}); fetch it again") from None
    if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
        raise FormatError(f"{where} is not a list of objects; wanted [{{task, yaw, pitch, initial yaw, level}}, ...]")
    for index, item in enumerate(items):
        try:
            if not isinstance(item.get("task"), str):
                raise FormatError(f'task is {shown(item.get("task"))}; wanted words such as "Find the red chair"')
            window_of(item)
            _starts(item)
        except (EagorError, TypeError, ValueError) as error:
            raise FormatError(f"{where}, entry {index}: {error}") from None
    return tuple(items)
