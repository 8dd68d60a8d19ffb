"""OSR-Bench scenes made from a built-in apartment: our agent answers them from true places, not from bearings alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import osr_data
import pytest

from eagor.lab.envs.places import APARTMENT, load_place
from eagor.lab.envs.rules import Camera
from eagor.lab.tasks.osr import DIRECTION, Question, Scene, load
from eagor.lab.tasks.osr.bench import Eagor, Reply, record_of
from eagor.lab.tasks.osr.geometry import SceneLayout, Spot
from eagor.lab.tasks.task import configure
from eagor.lab.tasks.task import load as load_task
from eagor.sphere import world_R_body

SEED = 30
HEIGHT = 1.5  # metres of the camera
CLEARANCE = 0.35  # metres around it
VISIBLE = 6  # pixels of a panorama of 64 x 128 from which on a thing counts as seen
UNNAMED = ("wall", "floor", "ceiling", "ceiling lamp")  # the room itself, and what touches neither floor nor wall


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A view in every room with enough visible categories; layouts follow the axes of the building, as published."""
    place, folder = load_place(APARTMENT, SEED, Camera().radius), tmp_path_factory.mktemp("osr")
    free = place.ground.points[place.ground.clearance[place.ground.free] >= CLEARANCE]
    for number, room in enumerate(place.scene.rooms):
        rng = np.random.default_rng([SEED, number])
        low, high = room.rectangles[:, None, :2], room.rectangles[:, None, 2:]
        inside = free[((low <= free) & (free <= high)).all(axis=2).any(axis=0)]
        if not len(inside):
            continue
        spot, turn = rng.choice(inside), world_R_body(rng.uniform(-math.pi, math.pi))
        ids = place.ids(np.array([*spot, HEIGHT]), turn)
        seen = np.bincount(ids.reshape(-1) + 1, minlength=len(place.scene.instances) + 1)[1:]
        along: dict[str, list[Spot]] = {}
        ahead: dict[str, list[Spot]] = {}
        for index, thing in enumerate(place.scene.instances):
            if thing.category not in UNNAMED and thing.room == room.name and seen[index] >= VISIBLE:
                name, way = thing.category.replace(" ", "_"), thing.centre[:2] - spot
                along.setdefault(name, []).append(tuple(way.tolist()))
                ahead.setdefault(name, []).append(tuple((way @ turn[:2, :2]).tolist()))
        if len(along) >= osr_data.LEAST:
            target = folder / f"EagorApartment-{number}"
            target.mkdir()
            osr_data.write_scene(target, ahead, osr_data.published_layout(along), [], 30, rng)
    return folder


def scores(data: Path, agent: Callable[[Scene, Question], Reply], tag: str) -> list[float]:
    """The scores of the questions for directions with this tag, left and right as in the room."""
    config = configure(load_task("osr"), {"data": str(data), "agent": "oracle", "labels": "corrected"})
    asked = [(scene, q) for scene in load(data) for q in scene.questions if q.skill == DIRECTION]
    records = [record_of(scene, question, agent(scene, question), config) for scene, question in asked]
    return [record["score"] for record in records if tag in ("", *record["tags"])]


def on_a_circle(scene: Scene) -> SceneLayout:
    """All that bearings tell: every thing at the same range."""
    placed = osr_data.true_layout(scene).placed
    return SceneLayout([replace(each, xy=tuple(np.divide(each.xy, math.hypot(*each.xy)))) for each in placed])


def test_true_places_answer_almost_all_that_is_clear_and_bearings_do_not(data: Path) -> None:
    clear = scores(data, Eagor(osr_data.true_layout), "clear")
    assert len(clear) >= 40
    assert np.mean(clear) >= 0.9
    assert np.mean(scores(data, Eagor(on_a_circle), "")) < 0.8
