"""A small data set in OSR-Bench's layout, made up for tests."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from osr_apartments import conversation, write_room
from PIL import Image

from eagor.lab.tasks.osr.detections import Body, Room
from eagor.lab.tasks.osr.geometry import FloorLine, layout_from
from eagor.lab.tasks.osr.scoring import grid_of

NAME = "ReplicaPano-made-here"
CORNERS = np.array([[4.0, 3.5], [-4.0, 3.5], [-4.0, -3.5], [4.0, -3.5]])
PLACES = {
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
    square = 0.2 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    bodies = [Body(name, np.array(xy) + square, 0.0, 0.7) for name, where in PLACES.items() for xy in where]
    write_room(Room(tuple(bodies), 1.5, FloorLine(CORNERS)), folder)
    layout = layout_from(PLACES, mirror=True)
    counts = {name: len(where) for name, where in PLACES.items()}
    (folder / "cognitive_map.json").write_text(json.dumps({"cognitive_map": grid_of(layout), "class_count": counts}))
    for kind, more in (("qa", []), ("qa_with_negative", ["bed", "piano"])):
        turns = list(conversation(layout, counts, [*counts, *more], 8, np.random.default_rng(5)))
        turns.append({**turns[-1], "turn_id": 99, "answer": ""})
        entry = {"image_id": f"data/{NAME}/rgb.png", "pre_prompt": "", "conversation": turns}
        (folder / f"{NAME}_{kind}.json").write_text(json.dumps(entry))
    return tmp_path / "data"
