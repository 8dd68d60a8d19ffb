"""OSR-Bench's scorer and labels against what the published code gave, and against the published scenes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from osr_data import direction_label, distance_label

from eagor.lab.tasks.osr import COUNTING, DIRECTION, DISTANCE, MAP, SUFFIXES, layout_of, load, score

SAMPLES = Path(__file__).parents[2] / ".." / "shared" / "bench_samples"
pytestmark = pytest.mark.skipif(not SAMPLES.exists(), reason="the shared benchmark samples are not here")


def vectors(name: str) -> list[Any]:
    return json.loads((SAMPLES / name).read_text())["vectors"]


def test_every_score_is_the_published_one() -> None:
    found = vectors("conformance_osr_score.json")
    assert len(found) > 100
    assert [score(skill, truth, said, think) for skill, truth, said, think, _ in found] == [
        wanted for *_, wanted in found
    ]


def test_every_label_is_the_published_one() -> None:
    found = vectors("conformance_osr_direction.json")
    assert len(found) > 100
    assert [direction_label(v["map"], v["P"], v["O"], v["Q"]) for v in found] == [v["answer"] for v in found]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_answers_of_the_scenes_follow_from_their_layouts(suffix: str) -> None:
    scenes = load(SAMPLES, suffix)
    assert len(scenes) == 3
    for scene in scenes:
        layout = scene.layout
        assert layout is not None
        counts = {name: len(where) for name, where in layout.items()}
        for question in scene.questions:
            names = question.names
            if question.skill == MAP:
                assert layout_of(question.answer) == layout
                continue
            if question.skill == DIRECTION:
                made = direction_label(layout, *names)
            elif question.skill == DISTANCE:
                made = distance_label(layout, *names)
            else:
                assert question.skill == COUNTING
                made = str(counts.get(names[0], 0))
            assert made == question.answer, question.id


def test_an_empty_label_is_skipped_and_a_missing_kind_of_file_is_made_of_the_one_with_a_map() -> None:
    scenes = {scene.id: scene for scene in load(SAMPLES / "osr_real", "qa_without_cogmap")}
    pomaria = next(scene for name, scene in scenes.items() if "Pomaria" in name)
    assert pomaria.skipped == 1
    assert all(question.answer for question in pomaria.questions)
    assert all(question.skill != MAP for scene in scenes.values() for question in scene.questions)
