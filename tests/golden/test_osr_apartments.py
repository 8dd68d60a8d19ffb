"""OSR-Bench scenes made from the built-in apartments: true bearings and floor contacts answer them."""

from __future__ import annotations

from pathlib import Path

import pytest
from osr_apartments import views, write_scene

from eagor.lab.tasks.benchmark import load
from eagor.lab.tasks.osr.agents import work

SEED = 30


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("osr")
    for view in views(SEED):
        write_scene(view, folder, rows=0, questions=30)
    return folder


def test_true_contacts_answer_almost_all_that_is_clear(scenes: Path) -> None:
    bench = load("osr")
    settings = bench.settle(
        {
            "data": str(scenes),
            "agent": "eagor",
            "perception": "truth",
            "labels": "corrected",
            "skill": "relative_direction",
        }
    )
    do = work(settings)
    records = [do(case.payload) for case in bench.cases(scenes, settings)]
    clear = [record["score"] for record in records if "clear" in record["tags"]]
    assert len(clear) >= 40
    assert sum(clear) / len(clear) >= 0.9
    unit = work(settings | {"range": "unit"})
    blind = [unit(case.payload)["score"] for case in bench.cases(scenes, settings)]
    assert sum(blind) / len(blind) < 0.8


def test_a_scene_is_written_with_its_picture(tmp_path: Path) -> None:
    from PIL import Image

    folder = write_scene(next(views(SEED)), tmp_path, rows=32)
    with Image.open(folder / "rgb.png") as picture:
        assert picture.size == (64, 32)
    info = load("osr").info(tmp_path)
    assert info["with_true_places"] == 1
    assert info["files"]["qa"]["questions"]["cognitive_map"] == 1
