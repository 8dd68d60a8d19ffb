"""H*Bench's published data: scenes with one panorama and annotations, and their episodes.

Where they are is told in `eagor.tasks.hstar.files`. An entry with ``pitch`` is an object to find (HOS), one
without a way to take (HPS); one episode per entry and start.
"""

from __future__ import annotations

import io
import json
import random
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from eagor._json import number, parsed, shown
from eagor.errors import EagorError, FormatError
from eagor.tasks.hstar.files import Stored, find_scenes
from eagor.tasks.hstar.rules import FARTHEST, window_of

Kind = Literal["hos", "hps"]

STARTS = (0, 90, 180, 270)  # degrees of yaw, where an entry names none
SHUFFLE = 42  # the published environment shuffles its episodes with this seed
LEVELS = {"hos": ("easy", "medium", "hard"), "hps": ("easy", "medium", "hard", "extreme")}


@dataclass(frozen=True)
class Scene:
    """A folder of the data: its name, its picture, and its annotations as they stand in the file."""

    name: str
    panorama: Stored
    items: tuple[Mapping[str, Any], ...]


@dataclass(frozen=True)
class Episode:
    """One start in front of one target.

    Attributes:
        id: ``scene/entry/start``.
        scene: name of the scene.
        entry: place of the target in annotation.json.
        kind: ``hos`` or ``hps``.
        task: the words.
        yaw, pitch: the annotated box, degrees (pitch None in HPS), as written.
        start: yaw of the first view, degrees; its pitch is 0.
        level: 0, 1, ..., None where the file has none and it cannot be told.
        panorama: where the picture is.
        others: the boxes of the scene's other targets, ``(yaw, pitch)``: what an eye could take for it.
    """

    id: str
    scene: str
    entry: int
    kind: Kind
    task: str
    yaw: tuple[float, float]
    pitch: tuple[float, float] | None
    start: float
    level: int | None
    panorama: Stored
    others: tuple[tuple[tuple[float, float], tuple[float, float] | None], ...] = ()

    @property
    def item(self) -> dict[str, Any]:
        """As an entry of annotation.json, for `eagor.tasks.hstar.rules`."""
        return {"task": self.task, "yaw": self.yaw, **({"pitch": self.pitch} if self.pitch is not None else {})}

    @property
    def level_name(self) -> str:
        """The level in words; "unknown" where there is none."""
        names = LEVELS[self.kind]
        return names[self.level] if self.level is not None and self.level < len(names) else "unknown"

    def as_json(self) -> dict[str, Any]:
        """Plain JSON; `from_json` brings it back."""
        return json.loads(json.dumps(asdict(self)))

    @classmethod
    def from_json(cls, found: Mapping[str, Any]) -> Episode:
        """The episode that `as_json` wrote."""
        values: dict[str, Any] = dict(found) | {"panorama": Stored(**found["panorama"]), "yaw": tuple(found["yaw"])}
        values["pitch"] = None if found["pitch"] is None else tuple(found["pitch"])
        values["others"] = tuple((tuple(y), None if p is None else tuple(p)) for y, p in found["others"])
        return cls(**values)


def read_scenes(data: Path) -> list[Scene]:
    """All scenes in the folder (or archive) `data`, by name; those without a picture are left out, as published.

    Raises `FormatError` where there is none at all, or an annotation.json is not what was wanted.
    """
    return [Scene(found.name, found.panorama, _items(found.annotation)) for found in find_scenes(data)]


def read_episodes(data: Path, kind: Kind) -> list[Episode]:
    """The episodes of one kind, in the published order: by folder, then shuffled with the seed 42.

    Raises `FormatError` if there is none of this kind, or the data is not H*Bench's.
    """
    scenes = read_scenes(data)
    found = [episode for scene in scenes for episode in _episodes(scene) if episode.kind == kind]
    if not found:
        wanted = "with pitch (objects)" if kind == "hos" else "without pitch (paths)"
        raise FormatError(f"{data} has {len(scenes)} scenes, but no annotation {wanted}: it is not {kind.upper()} data")
    random.Random(SHUFFLE).shuffle(found)
    return found


def info(data: Path) -> dict[str, Any]:
    """What the folder holds: counts, sizes of pictures, and what is unusual about it. Raises `FormatError`."""
    from PIL import Image

    from eagor.worlds.panorama import FORMATS

    scenes = read_scenes(data)
    episodes = [episode for scene in scenes for episode in _episodes(scene)]
    items = [item for scene in scenes for item in scene.items]
    sizes: list[tuple[int, int]] = []
    unreadable: list[str] = []
    for scene in scenes:
        try:
            stored = scene.panorama
            with Image.open(io.BytesIO(stored.read()) if stored.member else stored.path, formats=FORMATS) as file:
                sizes.append(file.size)
        except Exception:
            unreadable.append(scene.name)
    levels = {
        kind: {
            name: count
            for name in (*LEVELS[kind], "unknown")
            if (count := sum(e.kind == kind and e.level_name == name for e in episodes))
        }
        for kind in ("hos", "hps")
    }
    return {
        "benchmark": "H*Bench",
        "scenes": len(scenes),
        "targets": len(items),
        "episodes": {kind: sum(e.kind == kind for e in episodes) for kind in ("hos", "hps")},
        "levels": {kind: found for kind, found in levels.items() if found},
        "widths": [min(w for w, _ in sizes), max(w for w, _ in sizes)] if sizes else None,
        "heights": [min(h for _, h in sizes), max(h for _, h in sizes)] if sizes else None,
        "not_2_to_1": sum(w != 2 * h for w, h in sizes),
        "unreadable": unreadable,
        "without_initial_yaw": sum("initial yaw" not in item for item in items),
        "without_level": sum("level" not in item for item in items),
        "windows_across_yaw_0": sum(window_of(item).wraps for item in items),
        "archives": len({scene.panorama.path for scene in scenes if scene.panorama.member}),
    }


def _episodes(scene: Scene) -> Iterator[Episode]:
    for entry, item in enumerate(scene.items):
        pitch = tuple(item["pitch"]) if item.get("pitch") is not None else None
        kind: Kind = "hos" if pitch is not None else "hps"
        others = tuple(
            (tuple(other["yaw"]), tuple(other["pitch"]) if other.get("pitch") is not None else None)
            for index, other in enumerate(scene.items)
            if index != entry
        )
        seen: dict[str, int] = {}
        for start, level in _starts(item):
            name = f"{scene.name}/{entry}/{start:g}"
            seen[name] = seen.get(name, 0) + 1
            name += f"-{seen[name]}" if seen[name] > 1 else ""
            if level is None and kind == "hos":
                level = _level(item, start)
            task, yaw = str(item["task"]), tuple(item["yaw"])
            yield Episode(name, scene.name, entry, kind, task, yaw, pitch, start, level, scene.panorama, others)


def _starts(item: Mapping[str, Any]) -> list[tuple[float, int | None]]:
    """Starts with their levels; the shorter of two lists decides, as published."""
    level = item.get("level")
    if "initial yaw" not in item:
        starts: list[float] = list(STARTS)
    else:
        given = item["initial yaw"]
        if not isinstance(given, list):
            raise FormatError(f"initial yaw is {shown(given)}; wanted a list of angles in degrees")
        starts = [number(start) for start in given]
        if any(abs(start) > FARTHEST for start in starts):
            raise FormatError(f"initial yaw is {shown(given)}; wanted angles of at most {FARTHEST:g} degrees")
    levels = level if isinstance(level, list) else [level] * len(starts)
    return [(start, None if one is None else _rank(one)) for start, one in zip(starts, levels, strict=False)]


def _rank(level: Any) -> int:
    found = number(level)
    if found < 0 or not found.is_integer():
        raise FormatError(f"level is {shown(level)}; wanted 0, 1, 2, ...")
    return int(found)


def _level(item: Mapping[str, Any], start: float) -> int:
    """0 if at least half of the target's box is in the first view, 1 if some of it is, 2 if none."""
    from eagor.tasks.hstar.camera import View, visible_share

    share = visible_share(View(start, 0.0), tuple(item["yaw"]), tuple(item["pitch"]))
    return 0 if share >= 0.5 else 1 if share > 0 else 2


def _items(where: Stored) -> tuple[Mapping[str, Any], ...]:
    name = str(where)
    try:
        text = where.read()
    except Exception as error:  # zipfile raises whatever the damage leads it to
        raise FormatError(f"{name} cannot be read ({type(error).__name__}: {error}); fetch it again") from None
    try:
        found = parsed(text.decode("utf-8-sig"))
    except ValueError as error:
        raise FormatError(f"{name} is no JSON ({error}); restore it from the published archive") from None
    if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
        raise FormatError(f"{name} is no list of objects; wanted [{{task, yaw, pitch, initial yaw, level}}, ...]")
    for index, item in enumerate(found):
        try:
            if not isinstance(item.get("task"), str):
                raise FormatError(f'task is {shown(item.get("task"))}; wanted words such as "Find the red chair"')
            window_of(item)
            _starts(item)
        except (EagorError, TypeError, ValueError) as error:
            raise FormatError(f"{name}, entry {index}: {error}") from None
    return tuple(found)
