"""OSR-Bench scenes from the built-in apartments: a room, the camera in it, what it sees, and the questions.

The layout follows the published ones: cells are square, the longer side of the area with things is ten of them, the
axes are those of the building and not of the camera, and left and right are exchanged.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image

from eagor.lab.envs.places import APARTMENT, Place, load_place
from eagor.lab.envs.rules import Camera
from eagor.lab.tasks.osr.detections import FILE, Body, Room
from eagor.lab.tasks.osr.geometry import FloorLine, layout_from
from eagor.lab.tasks.osr.scoring import (
    COUNTING,
    DIRECTION,
    DISTANCE,
    MAP,
    Layout,
    direction_label,
    distance_label,
    grid_of,
)
from eagor.lab.worlds.raycast import Raycaster
from eagor.lab.worlds.scene import Scene
from eagor.sphere import world_R_body

# Walls, floor and ceiling are the room itself; a ceiling lamp touches neither floor nor wall.
UNNAMED = ("wall", "floor", "ceiling", "ceiling lamp")
LEAST = 5  # categories: with fewer the benchmark does not ask about distances and directions
VISIBLE = 6  # pixels of a panorama of 64 x 128 from which on a thing counts as seen
ROWS = 64
CLEARANCE = 0.35  # metres around the camera
TRIES = 6  # spots tried per room
WALL_RAYS = 360
SKIRTING = 0.3  # metres above the floor at which the walls are sensed, below all window sills


@dataclass(frozen=True, eq=False)
class View:
    """A camera in a room of an apartment: what it sees, the published layout, its position (metres) and its yaw."""

    id: str
    room: Room
    layout: dict[str, list[list[int]]]
    position: np.ndarray
    yaw: float
    place: Place

    @property
    def counts(self) -> dict[str, int]:
        """The number of things of each category."""
        return dict(Counter(body.name for body in self.room.bodies))


def views(seed: int, height: float = 1.5) -> Iterator[View]:
    """One view of every room of this apartment with at least `LEAST` visible categories; `height` metres.

    The same seed gives the same views. Raises `WorldError` for a seed without an apartment.
    """
    place = load_place(APARTMENT, seed, Camera().radius)
    for number, room in enumerate(place.scene.rooms):
        rng = np.random.default_rng([seed, number, 0x05B])
        for _ in range(TRIES):
            spot = _spot(place, room.name, rng)
            if spot is None:
                break
            yaw = float(rng.uniform(-math.pi, math.pi))
            found = _view(place, room.name, spot, height, yaw, f"{seed:04d}_{number}")
            if len(found.counts) >= LEAST:
                yield found
                break


def write_scene(view: View, folder: Path, rows: int = 512, questions: int = 5, seed: int = 0) -> Path:
    """Write a view in the published format, with its picture and its truth; returns the scene's folder.

    `rows`: of the picture, 0 for none. `questions`: at most this many of each kind, drawn with `seed`. Files with and
    without the map's question are written, also those with absent categories.
    """
    name = f"EagorApartment-{view.id}"
    target = folder / name
    target.mkdir(parents=True, exist_ok=True)
    if rows:
        shown = view.place.renderer.panorama(view.position, world_R_body(view.yaw), rows, range=False, ids=False).rgb
        assert shown is not None
        Image.fromarray(shown).save(target / "rgb.png")
    grid = grid_of(view.layout)
    whole = {"cognitive_map": grid, "class_count": view.counts}
    (target / "cognitive_map.json").write_text(json.dumps(whole), encoding="utf-8")
    write_room(view.room, target)
    present = list(view.counts)
    absent = sorted({"bed", "fridge", "piano", "picture", "sink", "stool", "table", "tv"} - set(present))
    for kind, extra in (("qa", []), ("qa_with_negative", absent[:LEAST])):
        names = present + extra
        rng = np.random.default_rng([seed, *view.id.encode(), len(extra)])
        turns = list(conversation(view.layout, view.counts, names, questions, rng))
        for suffix, part in (("", turns), ("_without_cogmap", turns[1:])):
            entry = {"image_id": f"data/{name}/rgb.png", "pre_prompt": "", "conversation": part}
            (target / f"{name}_{kind}{suffix}.json").write_text(json.dumps(entry, indent=1), encoding="utf-8")
    return target


def write_room(room: Room, folder: Path) -> None:
    """Write the truth about a room into a scene's folder."""
    objects = []
    for body in room.bodies:
        (x, y), sides = _to_right(body.centre[None])[0], np.ptp(body.footprint, axis=0)[::-1]
        objects.append({
            "name": body.name, "xy": [x, y], "size": [*sides, body.high - body.low],
            "z_centre": (body.low + body.high) / 2, "corners": _to_right(body.footprint),
        })  # fmt: skip
    walls = {} if room.walls is None else {"walls": _to_right(room.walls.points)}
    (folder / FILE).write_text(json.dumps({"camera": room.camera, "objects": objects, **walls}))


def _to_right(points: np.ndarray) -> list[list[float]]:
    """From x forward, y left to x right, y forward."""
    return np.stack([-points[:, 1], points[:, 0]], axis=1).round(4).tolist()


def conversation(
    layout: Layout, counts: Mapping[str, int], names: Sequence[str], most: int, rng: np.random.Generator
) -> Iterator[dict[str, object]]:
    """The turns about one layout: the map, then at most `most` questions of each kind over `names`.

    As published, the positioning object is of a category with one thing, if there is one. If all `names` are present,
    questions that an error would answer are not asked.
    """
    names = list(names)
    asked: list[tuple[str, str, object]] = [(MAP, mapping(names), grid_of(layout))]
    asked += [(COUNTING, counting(name), str(counts.get(name, 0))) for name in rng.permutation(names)[:most].tolist()]
    singles = [name for name in names if counts.get(name) == 1] or names
    complete = all(name in layout for name in names)
    if len(counts) >= LEAST:
        for kind in (DISTANCE, DIRECTION):
            kept = 0
            for _ in range(2 * most if complete else most):
                first = str(rng.choice(singles))
                others = rng.permutation([name for name in names if name != first]).tolist()
                if kind == DISTANCE:
                    question, answer = distance(first, others[:4]), distance_label(layout, first, others[:4])
                else:
                    question = direction(first, *others[:2])
                    answer = direction_label(layout, first, *others[:2])
                if kept == most or (complete and answer.endswith("picture.")):
                    continue
                kept += 1
                asked.append((kind, question, answer))
    for number, (skill, question, answer) in enumerate(asked):
        yield {"turn_id": number, "question": question, "answer": answer, "skills_tested": skill}


def counting(name: str) -> str:
    """The published question about the number of things."""
    return f"How many {name}(s) are in this room?"


def distance(name: str, choices: Sequence[str]) -> str:
    """The published question about the nearest of the choices."""
    return (
        f"Measuring from the closest point of each object, which of these objects ({', '.join(choices)}) is the "
        f"closest to the {name} in this PANORAMA?"
    )


def direction(P: str, O: str, Q: str) -> str:
    """The published question about the direction of Q for someone who stands by P and faces O."""
    return (
        f"If I am standing by the {P} and facing the closest {O}, is the closest {Q} to my front, back, left, right, "
        "front-left, front-right, back-left, or back-right in this PANORAMA?"
    )


def mapping(names: Sequence[str]) -> str:
    """The question for the map, in our words, with the benchmark's list of categories and format."""
    return (
        "[Task] This PANORAMA shows a room all around. Draw its plan: say where the middle of each object lies on a "
        "10x10 grid that covers the whole room. [Rule] Care only about the categories in this scene: "
        f"{{{', '.join(names)}}}. List every instance of each of them, keep their positions to one another, put what "
        "is near the camera near the middle of the grid and what is far away near its edges, and place an object that "
        "is partly hidden where all of it must be. [Output] One JSON object with integer coordinates from 0 to 9: "
        '{"category name": [[x_1, y_1], ...], ...}'
    )


def _spot(place: Place, room: str, rng: np.random.Generator) -> np.ndarray | None:
    """A free place ``(2,)`` in the room, away from things; None if there is none."""
    ground, inside = place.ground, next(each for each in place.scene.rooms if each.name == room)
    free = ground.points[ground.clearance[ground.free] >= CLEARANCE]
    x, y = free.T[..., None]
    x0, y0, x1, y1 = inside.rectangles.T
    within = np.flatnonzero(((x0 <= x) & (x <= x1) & (y0 <= y) & (y <= y1)).any(axis=1))
    return free[rng.choice(within)] if len(within) else None


def _view(place: Place, room: str, spot: np.ndarray, height: float, yaw: float, identity: str) -> View:
    position = np.array([*spot, height])
    turn = world_R_body(yaw)
    seen = np.bincount(place.ids(position, turn, ROWS).reshape(-1) + 1, minlength=len(place.scene.instances) + 1)[1:]
    bodies, axes = [], {}
    for index, thing in enumerate(place.scene.instances):
        if thing.category in UNNAMED or thing.room != room or seen[index] < VISIBLE:
            continue
        name = thing.category.replace(" ", "_")
        (x0, y0, _), (x1, y1, _) = thing.low, thing.high
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]) - spot
        bodies.append(Body(name, corners @ turn[:2, :2], float(thing.low[2]), float(thing.high[2])))
        axes.setdefault(name, []).append(tuple((thing.centre[:2] - spot).tolist()))
    walls = _walls(place, position, turn)
    return View(identity, Room(tuple(bodies), height, walls), layout_from(axes, mirror=True), position, yaw, place)


def _walls(place: Place, position: np.ndarray, turn: np.ndarray) -> FloorLine:
    """The foot of the surrounding walls, in the body frame, ignoring furniture and doors."""
    azimuth = (np.arange(WALL_RAYS) + 0.5) / WALL_RAYS * 2 * math.pi
    ways = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1)
    origins = np.broadcast_to([position[0], position[1], SKIRTING], ways.shape).astype(np.float32)
    hits = _bare_walls(place).cast(origins, (ways @ turn.T).astype(np.float32))
    reached = np.where(np.isfinite(hits.distance), hits.distance, 0.0)
    return FloorLine((ways[:, :2] * reached[:, None])[reached > 0])


@lru_cache(maxsize=2)
def _bare_walls(place: Place) -> Raycaster:
    scene = place.scene
    assert isinstance(scene, Scene)  # an apartment
    bare = np.array([thing.category in ("wall", "window") for thing in scene.instances])[scene.instance]
    return Raycaster(scene.vertices, scene.triangles[bare])
