"""The named things of a scene in Habitat, and how to tell which one a pixel shows.

In this order, the things are those of

1. a file of boxes: one that is given (``boxes=FILE``), or ``<scene>.semantic.json`` or ``<scene>.boxes.json`` beside
   the scene's file;
2. Habitat's own semantic scene (HM3D, MP3D, Gibson, Replica);
3. the nodes of the GLB file: category and colour are words of a node's name, as in `eagor.lab.worlds.glb`.

Where Habitat draws semantic ids, they decide which thing a pixel shows; a file of boxes then only adds names, colours
and rooms. Otherwise it is the smallest box that contains the point.

A file of boxes is what `export_glb` writes (``"format": "eagor semantic 1"``, our frame), or
``{"format": "eagor boxes 1", "boxes": [{"category": "chair", "colour": "red", "low": [x, y, z], "high": [x, y, z]}]}``
in Habitat's world: metres, Y up, as in the GLB file. Colour and "room" may be left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from eagor._checks import shown
from eagor.errors import WorldError
from eagor.grids import ErpGrid
from eagor.lab.worlds.glb import read_semantics
from eagor.lab.worlds.habitat.simulator import Frames, Labels, Session, euclidean
from eagor.lab.worlds.objectnav import read_category
from eagor.lab.worlds.scene import Instance, Room
from eagor.queries import COLOURS

LOOSE = 0.03  # metres by which a box is widened: depth is exact to a centimetre
_CHUNK = 1 << 22  # comparisons of a point with a box at a time


def id_labels(place: np.ndarray) -> Labels:
    """Labels by Habitat's semantic ids: `place` ``(n,)``, our index (or -1) of each id."""
    table = np.append(place, -1).astype(np.int32)  # the last for ids beyond the table
    return Labels(True, lambda semantic: table[np.minimum(semantic, len(table) - 1).astype(np.intp)])


def box_labels(instances: Sequence[Instance]) -> Labels:
    """Labels by points: the smallest box that contains a point, -1 if none does."""
    size = [float(np.prod(np.maximum(thing.high - thing.low, LOOSE))) for thing in instances]
    order = np.argsort(size, kind="stable")
    low, high = (np.array([getattr(instances[k], end) for k in order]).reshape(-1, 3) for end in ("low", "high"))

    def ids(points: np.ndarray) -> np.ndarray:
        flat = points.reshape(-1, 3)
        found = np.full(len(flat), -1, dtype=np.int32)
        for start in range(0, len(flat) if instances else 0, step := max(1, _CHUNK // max(len(order), 1))):
            part = flat[start : start + step, None]
            inside = np.all((part >= low - LOOSE) & (part <= high + LOOSE), axis=-1)
            first = inside.argmax(axis=1)
            hit = inside[np.arange(len(first)), first]
            found[start : start + step] = np.where(hit, order[first], -1)
        return found.reshape(points.shape[:-1])

    return Labels(False, ids)


# --- what is seen of things: it repairs their boxes -------------------------------------------------------------------

Box = tuple[np.ndarray, np.ndarray]
ROWS = 128  # of the panoramas
FEWEST = 12  # pixels that a thing has to show
TRIM = 0.5  # per cent of the points at each end: edges of things mix near and far


def seen_boxes(session: Session, eyes: np.ndarray) -> Mapping[int, Box]:
    """The extent of what is seen of each semantic id from points ``(n, 3)``, all in Habitat's world."""
    still = Frames()
    directions = ErpGrid(ROWS, 2 * ROWS).directions
    ids, points = [], []
    for eye in eyes:
        looks = session.look(("depth", "semantic"), ROWS, eye, still.quaternion(np.eye(3)))
        metres = euclidean(looks["depth"])
        hit = np.isfinite(metres)
        ids.append(looks["semantic"][hit])
        points.append(eye + still.to_habitat(metres[hit][:, None] * directions[hit]))
    every, where = np.concatenate(ids), np.concatenate(points)
    order = np.argsort(every, kind="stable")
    names, starts = np.unique(every[order], return_index=True)
    parts = zip(names.tolist(), np.split(where[order], starts[1:]), strict=True)
    return {
        name: (np.percentile(part, TRIM, axis=0), np.percentile(part, 100 - TRIM, axis=0))
        for name, part in parts
        if len(part) >= FEWEST
    }


# --- things by their names --------------------------------------------------------------------------------------------

BOXES = "eagor boxes 1"
UNNAMED = {"", "unknown", "unlabeled", "unlabelled", "void", "misc", "undefined", "object", "objects", "other"}
Look = Callable[[], Mapping[int, Box]]  # what is seen of each semantic id, Habitat's world


@dataclass(frozen=True, eq=False)
class Things:
    """The instances and rooms of a scene, in our frame, and how pixels are labelled. `told`: where they come from."""

    instances: tuple[Instance, ...]
    rooms: tuple[Room, ...]
    labels: Labels
    told: str


def things_of(sim: Any, scene_file: Path | None, boxes: Path | None, frames: Frames, look: Look) -> Things:
    """The things of the scene that `sim` has opened; `look` finds extents where Habitat's are wrong.

    Raises `WorldError` if it has none, or for a malformed file.
    """
    found = _objects(getattr(sim, "semantic_scene", None), frames)
    rooms: tuple[Room, ...] = ()
    file = boxes or beside(scene_file)
    if file is not None:
        instances, rooms = read_boxes(file, frames)
        place = _same_things(found, instances)
        if place is not None:
            return Things(instances, rooms, id_labels(place), f"ids of Habitat, names of {file.name}")
        if boxes is not None or not found:
            return Things(instances, rooms, box_labels(instances), f"boxes of {file.name}")
    if found:
        if len(found) > 2 and all((low <= 0).all() and (high >= 0).all() for low, high in (each.box for each in found)):
            seen = look()  # boxes that all contain the origin are wrong
            found = [each.repaired(seen[each.semantic_id], frames) for each in found if each.semantic_id in seen]
        place = np.full(max(each.semantic_id for each in found) + 1, -1)
        place[[each.semantic_id for each in found]] = np.arange(len(found))
        instances = tuple(each.instance for each in found)
        return Things(instances, _rooms(sim.semantic_scene, frames), id_labels(place), "Habitat's semantic scene")
    if scene_file is not None and scene_file.suffix.lower() in (".glb", ".gltf"):
        instances = _nodes(scene_file, frames)
        if instances:
            return Things(instances, (), box_labels(instances), f"nodes of {scene_file.name}")
    raise WorldError(
        f"{scene_file or 'the scene'} names no things: it has no semantic annotations, its nodes have no names, and no "
        "file of boxes lies beside it; give one: habitat:SCENE?boxes=FILE.json"
    )


def beside(scene_file: Path | None) -> Path | None:
    """The file of boxes beside a scene's file, if there is one."""
    if scene_file is None:
        return None
    stem = scene_file.name.split(".")[0]
    places = (scene_file.with_name(f"{stem}.{kind}.json") for kind in ("boxes", "semantic"))
    return next((place for place in places if place.is_file()), None)


def read_boxes(file: Path, frames: Frames) -> tuple[tuple[Instance, ...], tuple[Room, ...]]:
    """The instances and rooms in a file of boxes. Raises `WorldError` if it is missing or malformed."""
    try:
        known = read_semantics(file.read_bytes())
        ours = known.format != BOXES
        instances = []
        for thing in known.instances if ours else known.boxes:
            low, high, colour = thing.low, thing.high, thing.colour
            if bool(np.any(low > high)):
                raise ValueError(f"a box from {low.tolist()} to {high.tolist()}")
            if ours:  # z up, but heights as in the file
                low[2], high[2] = low[2] - frames.floor, high[2] - frames.floor
            else:
                low, high = frames.box_from_habitat(low, high)
            if colour is not None and colour not in COLOURS:
                raise ValueError(f"the colour {shown(colour)}, which is none of {', '.join(COLOURS)}")
            instances.append(replace(thing, category=read_category(thing.category), low=low, high=high))
    except OSError as error:
        raise WorldError(f"{file} cannot be read ({error.strerror}); wanted a file of boxes") from error
    except ValueError as error:
        raise WorldError(
            f"{file} cannot be used ({str(error)[:200]}); wanted what export_glb writes, or "
            f'{{"format": "{BOXES}", "boxes": [{{"category", "low", "high"}}, ...]}}'
        ) from error
    return tuple(instances), tuple(known.rooms if ours else ())


@dataclass(frozen=True, eq=False)
class _Object:
    """An object of Habitat's semantic scene."""

    semantic_id: int
    instance: Instance
    box: Box  # in Habitat's world

    def repaired(self, seen: Box, frames: Frames) -> _Object:
        """The same with the sides of its box at 0 replaced by those of what was seen."""
        (low, high), (first, last) = self.box, seen
        sides = np.where(low == 0, np.clip(first, low, high), low), np.where(high == 0, np.clip(last, low, high), high)
        low, high = frames.box_from_habitat(*sides)
        return replace(self, instance=replace(self.instance, low=low, high=high))


def _objects(semantic: Any, frames: Frames) -> list[_Object]:
    """The named objects of a semantic scene that have an extent."""
    found = []
    for thing in getattr(semantic, "objects", None) or []:
        if thing is None or thing.category is None:
            continue
        category, box = read_category(str(thing.category.name())), thing.aabb
        low, high = np.array(box.min, dtype=np.float64), np.array(box.max, dtype=np.float64)
        if category in UNNAMED or not np.isfinite([low, high]).all() or not (high > low).any():
            continue
        region = thing.region
        room = None if region is None or _box(region) is None else str(region.id)
        instance = Instance(category, None, room, *frames.box_from_habitat(low, high))
        found.append(_Object(int(thing.semantic_id), instance, (low, high)))
    return found


def _box(region: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """The bounds of a region, None if it has none (in HM3D no region has)."""
    low, high = np.array(region.aabb.min, dtype=np.float64), np.array(region.aabb.max, dtype=np.float64)
    return (low, high) if np.isfinite([low, high]).all() and (high > low).all() else None


def _rooms(semantic: Any, frames: Frames) -> tuple[Room, ...]:
    """The regions that have bounds, as rooms of one rectangle each."""
    found = []
    for region in getattr(semantic, "regions", None) or []:
        box = _box(region)
        if box is not None:
            low, high = frames.box_from_habitat(*box)
            kind = read_category(str(region.category.name())) if region.category is not None else "room"
            found.append(Room(str(region.id), kind, np.array([[*low[:2], *high[:2]]])))
    return tuple(found)


def _same_things(found: Sequence[_Object], instances: Sequence[Instance]) -> np.ndarray | None:
    """The index among `instances` of each semantic id; None unless each of Habitat's objects is one of them.

    An object is the thing of the same category whose box is nearest, at most 0.25 m off at any corner.
    """
    table = np.full(max((each.semantic_id for each in found), default=-1) + 1, -1)
    for each in found:
        mine = each.instance
        off = {
            index: float(np.abs([thing.low - mine.low, thing.high - mine.high]).max())
            for index, thing in enumerate(instances)
            if thing.category == mine.category
        }
        nearest = min(off, key=lambda index: off[index], default=None)
        if nearest is None or off[nearest] > 0.25:
            return None
        table[each.semantic_id] = nearest
    return table if found else None


def _nodes(file: Path, frames: Frames) -> tuple[Instance, ...]:
    """The nodes of a GLB file with a name that says something. Its coordinates are Habitat's if it has Y up."""
    from eagor.lab.worlds.glb import import_glb

    lift = np.array([0.0, 0.0, frames.floor])
    return tuple(
        Instance(thing.category, thing.colour, None, thing.low - lift, thing.high - lift)
        for thing in import_glb(file).instances
        if thing.category not in UNNAMED
    )
