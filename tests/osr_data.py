"""A small data set in OSR-Bench's layout, made up for tests, with the published questions."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from eagor.lab.tasks.osr import (
    COUNTING,
    DIRECTION,
    DISTANCE,
    MAP,
    NO_CANDIDATE,
    NO_POSITION,
    NOT_UNIQUE,
    Grid,
    Layout,
    Scene,
    cells,
    named,
    ranked,
    steps,
)
from eagor.lab.tasks.osr.geometry import Detection, SceneLayout, Spot, layout_from, place

NAME = "ReplicaPano-made-here"
TRUTH = "physical_truth.json"  # of each thing the name, where its middle is (x right, y forward), and how high
PLACES: dict[str, list[Spot]] = {
    "tv": [(3.5, 0.3)],
    "sofa": [(-3.0, 0.5)],
    "chair": [(1.2, 2.4), (-0.8, -2.5)],
    "table": [(1.5, -1.4)],
    "lamp": [(-2.0, 3.0)],
    "plant": [(3.2, -2.9)],
}


def write(tmp_path: Path) -> Path:
    """A scene in the published layout, with its true places; one label is empty. Returns the folder of the data."""
    folder = tmp_path / "data" / "nested" / NAME
    folder.mkdir(parents=True)
    Image.fromarray(np.full((64, 128, 3), 90, dtype=np.uint8)).save(folder / "rgb.png")
    bodies = [{"name": name, "xy": [-y, x], "z_centre": 0.35} for name, where in PLACES.items() for x, y in where]
    (folder / TRUTH).write_text(json.dumps({"objects": bodies}))
    layout = layout_from({name: [(x, -y) for x, y in where] for name, where in PLACES.items()})  # mirrored
    counts = {name: len(where) for name, where in PLACES.items()}
    (folder / "cognitive_map.json").write_text(json.dumps({"cognitive_map": grid_of(layout), "class_count": counts}))
    rng = np.random.default_rng(5)
    for kind, absent in (("qa", []), ("qa_with_negative", ["bed", "piano"])):
        turns = [
            {"turn_id": number, "question": question, "answer": answer, "skills_tested": skill}
            for number, (skill, question, answer) in enumerate(conversation(layout, counts, [*counts, *absent], rng))
        ]
        turns.append({**turns[-1], "turn_id": 99, "answer": ""})
        entry = {"image_id": f"data/{NAME}/rgb.png", "pre_prompt": "", "conversation": turns}
        (folder / f"{NAME}_{kind}.json").write_text(json.dumps(entry))
    return tmp_path / "data"


def conversation(
    layout: Layout, counts: Mapping[str, int], names: Sequence[str], rng: np.random.Generator
) -> Iterator[tuple[str, str, object]]:
    """Skill, question and answer: the map, how many of each of `names`, then eight distances and eight directions.

    As published, where all `names` are present nothing is asked that an error would answer.
    """
    yield MAP, f"[Task] Draw the plan of the categories in this scene: {{{', '.join(names)}}}.", grid_of(layout)
    for name in names:
        yield COUNTING, counting(name), str(counts.get(name, 0))
    complete, three = all(name in layout for name in names), [*itertools.permutations(names, 3)]
    order = rng.permutation(len(three))
    for skill, question, label in ((DISTANCE, distance, distance_label), (DIRECTION, direction, direction_label)):
        asked = ((skill, question(*three[at]), label(layout, *three[at])) for at in order)
        yield from itertools.islice((q for q in asked if q[2] and not (complete and q[2].endswith("picture."))), 8)


def counting(name: str) -> str:
    """The published question about the number of things."""
    return f"How many {name}(s) are in this room?"


def distance(name: str, *choices: str) -> str:
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


def distance_label(layout: Layout, category: str, *choices: str) -> str:
    """The published answer to "which of the choices is the closest to the category?": the first of the nearest."""
    start = cells(layout, category)
    if len(start) != 1:
        return NOT_UNIQUE if start else NO_POSITION
    ways = {choice: ranked(start[0], cells(layout, choice)) for choice in choices}
    away = {choice: way[0][0] ** 2 + way[0][1] ** 2 for choice, way in ways.items() if way}
    return min(away, key=lambda choice: away[choice], default=NO_CANDIDATE)


def direction_label(layout: Layout, P: str, O: str, Q: str) -> str:
    """The published answer to "standing by P and facing the closest O, where is the closest Q?"."""
    found = steps(layout, P, O, Q)
    return found if isinstance(found, str) else named(*found)


def true_layout(scene: Scene) -> SceneLayout:
    """The true places in a scene, as if a camera at 1.5 metres saw the things and the floor points below them."""
    found = []
    for body in json.loads((scene.folder / TRUTH).read_text())["objects"]:
        azimuth, away = math.atan2(-body["xy"][0], body["xy"][1]), math.hypot(*body["xy"])
        middle, foot = (math.atan2(z - 1.5, away) for z in (body["z_centre"], 0.0))
        if body["name"] in scene.categories:
            found.append(Detection(body["name"], azimuth, middle, bottom=foot))
    return SceneLayout(place(found))


def grid_of(layout: Layout, size: int = 10) -> Grid:
    """The grid of a layout, as published."""
    grid: Grid = [[[] for _ in range(size)] for _ in range(size)]
    for name, where in layout.items():
        for row, column in where:
            grid[row][column].append(name)
    return grid
