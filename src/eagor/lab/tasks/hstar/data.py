"""H*Bench's published data: folders with one panorama and annotations each; and the words of their tasks.

The layout is ``<anything>/<scene>/annotation.json`` beside the scene's panorama, as in the unpacked archives: the first
``*.png`` by name, otherwise the first ``*.jpg``. As in the published environment, ``.PNG`` and ``.jpeg`` are other
endings, whose scenes are skipped (`info` names them), and a picture is turned by its orientation tag (Exif). An entry
with ``pitch`` is an object to find (HOS), one without is a path to take (HPS). There is one episode per entry and
start.
"""

from __future__ import annotations

import os
import random
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta, field
from PIL import ImageOps

from eagor._checks import parsed
from eagor.errors import FormatError, ImageError
from eagor.lab.tasks.hstar.rules import FARTHEST, TEXTS, View, level_of, window_of
from eagor.lab.tasks.published import picture_size
from eagor.media.panorama import read_image
from eagor.queries import singular

Kind = Literal["hos", "hps"]
Level = Annotated[int, Meta(ge=0)]
Real = Annotated[float, Meta(ge=-FARTHEST, le=FARTHEST)]  # degrees
Degrees = Annotated[int, Meta(ge=-int(FARTHEST), le=int(FARTHEST))] | Real  # records show them as the file has them

ANNOTATION = "annotation.json"
STARTS = (0, 90, 180, 270)  # degrees of yaw, for entries without any
SHUFFLE = 42  # the published environment shuffles its episodes with this seed
LEVELS = {"hos": ("easy", "medium", "hard"), "hps": ("easy", "medium", "hard", "extreme")}


class Entry(msgspec.Struct):
    """One target in annotation.json: its box in degrees, the yaws to begin at, and the level of each or of all."""

    task: str
    yaw: tuple[Degrees, Degrees]
    pitch: tuple[Degrees, Degrees] | None = None
    starts: list[Real] | None = field(name="initial yaw", default=None)
    level: list[Level | None] | Level | None = None

    @property
    def item(self) -> dict[str, Any]:
        """What `eagor.lab.tasks.hstar.rules` reads: task, yaw and, for an object, pitch."""
        pitch = {} if self.pitch is None else {"pitch": list(self.pitch)}
        return {"task": self.task, "yaw": list(self.yaw), **pitch}


Scene = tuple[Path, list[Entry]]  # its picture and its targets


class Episode(msgspec.Struct, frozen=True):
    """One start for one target; `id` is ``scene/entry/start``, which share all but the start in a `cluster`.

    `item`: the task, and the annotated box in degrees, as written (without pitch in HPS); `others`: those of the rest
    of the scene. `start`: yaw of the first view, whose pitch is 0. `level`: 0, 1, ..., None if unknown.
    """

    id: str
    cluster: str
    scene: str
    kind: Kind
    item: dict[str, Any]
    others: list[dict[str, Any]]
    start: int | float
    level: int | None
    panorama: str

    @property
    def level_name(self) -> str:
        """The level in words; "unknown" if there is none."""
        names = LEVELS[self.kind]
        return names[self.level] if self.level is not None and self.level < len(names) else "unknown"


def read_scenes(data: Path) -> tuple[dict[str, Scene], list[str]]:
    """All scenes in the folder `data`, by name, and the folders with annotations that have no such picture.

    Those are left out, as published. A scene is named by its folder alone if that is unique, so that parent folders do
    not matter. Raises `FormatError` if there is no scene, or for malformed annotations.
    """
    if not data.exists():
        raise FormatError(f"there is no {data}; name the folder with H*Bench's scenes")
    pictures, skipped = dict[Path, Path](), list[str]()
    for folder in sorted(path.parent for path in data.rglob(ANNOTATION)):
        names = sorted(path.name for path in folder.iterdir())
        if picture := next((name for end in (".png", ".jpg") for name in names if name.endswith(end)), None):
            pictures[folder] = folder / picture
        else:
            skipped.append(str(folder))
    if not pictures:
        also = f"; {skipped[0]} has {ANNOTATION}, but no such picture" if skipped else ""
        raise FormatError(
            f"{data} has no scene; wanted folders with {ANNOTATION} and one .png or .jpg each, in lower case (.PNG and "
            f".jpeg do not count, as published), as they are in hos_bench.zip and hps_bench.zip: unpack those{also}"
        )
    count, scenes = Counter(folder.name for folder in pictures), {}
    for folder, picture in pictures.items():
        name = folder.name if count[folder.name] == 1 else folder.relative_to(data).as_posix()
        scenes[name] = picture, _entries(folder / ANNOTATION)
    return dict(sorted(scenes.items())), skipped


def _entries(path: Path) -> list[Entry]:
    try:
        items = parsed(path.read_text("utf-8-sig"))
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error}); fetch it again") from None
    except ValueError as error:
        raise FormatError(f"{path} is not JSON ({error}); restore it from the published archive") from None
    if not isinstance(items, list):
        raise FormatError(f"{path} is not a list of objects; wanted [{{task, yaw, pitch, initial yaw, level}}, ...]")
    entries = []
    for index, item in enumerate(items):
        try:
            entries.append(msgspec.convert(item, Entry))
        except msgspec.ValidationError as error:
            raise FormatError(
                f'{path}, entry {index}: {error}; wanted a task such as "Find the red chair", yaw and pitch as two '
                f"angles of at most {FARTHEST:g} degrees, initial yaw as a list of such, level as 0, 1, 2, ..."
            ) from None
    return entries


def read_episodes(data: Path, kind: Kind) -> list[Episode]:
    """The episodes of one kind, in the published order: by folder, then shuffled with the seed 42.

    Raises `FormatError` if there is none of this kind, or the data is not H*Bench's.
    """
    scenes, _ = read_scenes(data)
    episodes = [each for name, scene in scenes.items() for each in _episodes(name, *scene) if each.kind == kind]
    if not episodes:
        wanted = "with pitch (objects)" if kind == "hos" else "without pitch (paths)"
        raise FormatError(f"{data} has {len(scenes)} scenes, but no annotation {wanted}: it is not {kind.upper()} data")
    random.Random(SHUFFLE).shuffle(episodes)
    return episodes


def _episodes(scene: str, panorama: Path, entries: list[Entry]) -> Iterator[Episode]:
    items = [entry.item for entry in entries]
    for index, entry in enumerate(entries):
        kind: Kind = "hos" if entry.pitch is not None else "hps"
        starts = STARTS if entry.starts is None else entry.starts
        levels = entry.level if isinstance(entry.level, list) else [entry.level] * len(starts)
        cluster, others = f"{scene}/{index}", items[:index] + items[index + 1 :]
        names = Counter[str]()
        for start, level in zip(starts, levels, strict=False):  # the shorter of the two lists decides, as published
            name = f"{cluster}/{start:g}"
            names[name] += 1
            name += f"-{names[name]}" if names[name] > 1 else ""
            if level is None and entry.pitch is not None:
                level = level_of(View(start, 0.0), entry.yaw, entry.pitch)
            yield Episode(name, cluster, scene, kind, items[index], others, start, level, str(panorama))


def info(data: Path) -> dict[str, Any]:
    """The content of the folder: counts, and oddities. Raises `FormatError`."""
    scenes, skipped = read_scenes(Path(data))
    sizes = {name: picture_size(picture, upright=True) for name, (picture, _) in scenes.items()}
    widths = [size[0] for size in sizes.values() if size is not None]
    entries = [entry for _, entries in scenes.values() for entry in entries]
    episodes = [each for name, scene in scenes.items() for each in _episodes(name, *scene)]
    levels = {kind: Counter(each.level_name for each in episodes if each.kind == kind) for kind in LEVELS}
    return {
        "scenes": len(scenes),
        "targets": len(entries),
        "episodes": {kind: count.total() for kind, count in levels.items()},
        "levels": {kind: dict(count) for kind, count in levels.items() if count},
        "widths": [min(widths), max(widths)] if widths else None,
        "not_2_to_1": sum(size is not None and size[0] != 2 * size[1] for size in sizes.values()),
        "skipped": skipped,
        "unreadable": [name for name, size in sizes.items() if size is None],
        "without_initial_yaw": sum(entry.starts is None for entry in entries),
        "without_level": sum(entry.level is None for entry in entries),
        "windows_across_yaw_0": sum(window_of(entry.item).wraps for entry in entries),
    }


@lru_cache(maxsize=2)
def open_panorama(path: str) -> np.ndarray:
    """The picture ``(H, W, 3)`` uint8 of any proportions: columns span 360 degrees, rows 180.

    It is turned by its orientation tag, as the published environment reads it. Read-only, as it is cached. Raises
    `ImageError` if it is missing or not a picture.
    """
    try:
        image = read_image(path, os.path.getsize(path), ImageOps.exif_transpose)
    except Exception as error:  # decoders may raise anything for damaged files
        raise ImageError(f"the panorama {path} cannot be read ({type(error).__name__}: {error}); fetch it") from error
    image.setflags(write=False)
    return image


# --- the words of a task ----------------------------------------------------------------------------------------------

FINE = 4.0  # degrees: a box smaller than this in both directions is fine detail
COMMON = frozenset(TEXTS["nouns"].split())
_VERBS = r"(?:please\s+)?(?:find|locate|look for|search for|go to|navigate to|get to|move to|reach|walk to|show me)\s+"
_ARTICLES = r"^(?:the|a|an|some|any|your|my|one of the|way to the|path to the|way to|path to)\s+"
_BREAKS = re.compile(
    r"\s+(?:of|on|in|at|by|with|near|next|under|above|behind|below|beside|between|from|that|which|whose|to|for|along|"
    r"inside|outside|against|across|around|where|labell?ed|named|called|saying|showing|reading)\s+|[,;(]"
)
_TEXT = re.compile(
    r"""["“”«»]|(?<!\w)'[^']+'|\b(?:sign|says?|saying|labell?ed|logo|number|letters?|word|text|reading|written|named|"""
    r"""called|brand)\b|\d"""
)


def thing_of(task: str) -> str:
    """The target of a task such as "Find the red chair by the door.": "red chair by the door"."""
    text = " ".join(task.split()).rstrip(".!? ")
    text = re.sub(f"^{_VERBS}", "", text, flags=re.IGNORECASE)
    text = re.sub(_ARTICLES, "", text, flags=re.IGNORECASE)
    return text or task


def phrase_of(task: str) -> str:
    """The target without its surroundings: "red chair"."""
    return _BREAKS.split(thing_of(task), maxsplit=1)[0].strip() or thing_of(task)


def head_of(task: str) -> str:
    """The noun of the target, singular and lower case: "chair"."""
    words = re.findall(r"[a-z][a-z-]*", phrase_of(task).lower())
    return singular(words[-1]) if words else thing_of(task).lower()


def tag_of(item: Mapping[str, Any], others: Sequence[Mapping[str, Any]] = ()) -> str:
    """The tag of a target; `others` are the scene's other entries. The paper names the tags; the rules are ours.

    ``ocr_fine``: the words quote or name text, numbers or a brand (a capital inside the words), or the box is tiny.
    ``multi_instance``: another entry of the scene has the same noun. ``rare``: the noun is not among `COMMON`.
    """
    task, yaw, pitch = str(item["task"]), item["yaw"], item.get("pitch")
    phrase, head = phrase_of(task), head_of(task)
    branded = phrase.isupper() or any(word[:1].isupper() for word in phrase.split())
    tiny = pitch is not None and (yaw[1] - yaw[0]) % 360.0 < FINE and pitch[1] - pitch[0] < FINE
    if _TEXT.search(thing_of(task).lower()) or branded or tiny:
        return "ocr_fine"
    if any(head_of(str(other["task"])) == head for other in others):
        return "multi_instance"
    return "plain" if head in COMMON or singular(head) in COMMON else "rare"
