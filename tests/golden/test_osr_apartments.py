"""OSR-Bench scenes made from the built-in apartments: true bearings and floor contacts answer them."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from osr_apartments import LEAST, views, write_scene

from eagor.lab.tasks.task import configure, load

SEED = 30


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("osr")
    for view in views(SEED):
        write_scene(view, folder, rows=0, questions=30)
    return folder


def test_views_are_the_same_each_time_and_see_enough() -> None:
    first, second = next(views(SEED)), next(views(SEED))
    assert len(first.counts) >= LEAST
    assert first.layout == second.layout
    assert first.yaw == second.yaw
    assert {row for where in first.layout.values() for cell in where for row in cell} <= set(range(10))


def test_true_contacts_answer_almost_all_that_is_clear(scenes: Path) -> None:
    task = load("osr")
    values = {"data": str(scenes), "agent": "eagor", "perception": "truth"}
    config = configure(task, values, {"labels": "corrected", "skill": "relative_direction"})
    do = task.runner(config)
    records = [do(sample.payload) for sample in task.samples(config)]
    clear = [record["score"] for record in records if "clear" in record["tags"]]
    assert len(clear) >= 40
    assert sum(clear) / len(clear) >= 0.9
    unit = task.runner(msgspec.structs.replace(config, range="unit"))
    blind = [unit(sample.payload)["score"] for sample in task.samples(config)]
    assert sum(blind) / len(blind) < 0.8


def test_a_scene_is_written_with_its_picture(tmp_path: Path) -> None:
    from PIL import Image

    folder = write_scene(next(views(SEED)), tmp_path, rows=32)
    with Image.open(folder / "rgb.png") as picture:
        assert picture.size == (64, 32)
    info = load("osr").info(tmp_path)
    assert info["with_true_places"] == 1
    assert info["files"]["qa"]["questions"]["cognitive_map"] == 1
