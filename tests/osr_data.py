"""A small data set in OSR-Bench's layout, made up for tests, and the published questions."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np
from PIL import Image

from eagor.lab.tasks.osr.geometry import FILE, Body, Room, Spot, layout_from
from eagor.lab.tasks.osr.scoring import (
    COUNTING,
    DIRECTION,
    DISTANCE,
    MAP,
    Grid,
    Layout,
    direction_label,
    distance_label,
)

NAME = "ReplicaPano-made-here"
PLACES: dict[str, list[Spot]] = {
    "tv": [(3.5, 0.3)],
    "sofa": [(-3.0, 0.5)],
    "chair": [(1.2, 2.4), (-0.8, -2.5)],
    "table": [(1.5, -1.4)],
    "lamp": [(-2.0, 3.0)],
    "plant": [(3.2, -2.9)],
}


def write(tmp_path: Path) -> Path:
    """A scene in the published layout, with its true places; returns the folder of the data.

    The files with negative questions ask for a bed and a piano, too. The last turn of each file has an empty answer.
    """
    folder, rng = tmp_path / "data" / "nested" / NAME, np.random.default_rng(5)
    folder.mkdir(parents=True)
    Image.fromarray(np.full((64, 128, 3), 90, dtype=np.uint8)).save(folder / "rgb.png")
    bodies = [Body(name, (-y, x), 0.35) for name, where in PLACES.items() for x, y in where]
    (folder / FILE).write_bytes(msgspec.json.encode(Room(bodies)))
    layout, counts = layout_from(PLACES, mirror=True), {name: len(where) for name, where in PLACES.items()}
    (folder / "cognitive_map.json").write_text(json.dumps({"cognitive_map": grid_of(layout), "class_count": counts}))
    for kind, more in (("qa", []), ("qa_with_negative", ["bed", "piano"])):
        turns = list(conversation(layout, counts, [*counts, *more], 8, rng))
        turns.append({**turns[-1], "turn_id": 99, "answer": ""})
        entry = {"image_id": f"data/{NAME}/rgb.png", "pre_prompt": "", "conversation": turns}
        (folder / f"{NAME}_{kind}.json").write_text(json.dumps(entry))
    return tmp_path / "data"


def grid_of(layout: Layout, size: int = 10) -> Grid:
    """The grid of a layout, as published."""
    grid: Grid = [[[] for _ in range(size)] for _ in range(size)]
    for name, where in layout.items():
        for row, column in where:
            grid[row][column].append(name)
    return grid


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
    for kind in (DISTANCE, DIRECTION):
        kept = 0
        for _ in range(2 * most if complete else most):
            first = str(rng.choice(singles))
            others = rng.permutation([name for name in names if name != first]).tolist()
            if kind == DISTANCE:
                question, answer = distance(first, others[:4]), distance_label(layout, first, others[:4])
            else:
                question, answer = direction(first, *others[:2]), direction_label(layout, first, *others[:2])
            if kept < most and not (complete and answer.endswith("picture.")):
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
