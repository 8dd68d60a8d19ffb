"""OSR-Bench as a task of lmms-eval: its files, and the functions that they call."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eagor.perception.vlm import IMAGE
from eagor.tasks.osr.data import Question, load
from eagor.tasks.osr.play import plain_text
from eagor.tasks.osr.scoring import COUNTING, DIRECTION, DISTANCE, MAP, score
from eagor.tasks.published import write_task

TASK = "eagor_osr"
METRICS = {DISTANCE: "distance", COUNTING: "counting", MAP: "map"}
BY_LABELS = ("direction_official", "direction_corrected")


def write(settings: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the task ``eagor_osr`` into `folder` (`eagor.tasks.published`); returns the files.

    Each question is asked alone; in files with a map, the map's question is one of them. The questions hold the paths
    of their pictures on this machine. Raises `FormatError` if a picture is missing.
    """
    pictures = {scene: str(scene.picture.resolve()) for scene in load(Path(settings["data"]), settings["suffix"])}
    documents = (
        {"id": question.id, "scene": scene.id, "turn": question.turn, "skill": question.skill}
        | {"question": question.text, "image": picture, "prompt": settings["prompt"]}
        | {"answer": json.dumps(question.answer) if question.skill == MAP else question.answer}
        for scene, picture in pictures.items()
        for question in scene.questions
        if settings["skill"] in ("all", question.skill)
    )
    return write_task(folder, TASK, __name__, documents, (*BY_LABELS, *METRICS.values()))


def doc_to_visual(doc: Mapping[str, Any]) -> list[Any]:
    """The panorama, as a PIL image."""
    from PIL import Image

    from eagor.media.panorama import FORMATS

    with Image.open(doc["image"], formats=FORMATS) as file:
        return [file.convert("RGB")]


def doc_to_text(doc: Mapping[str, Any], settings: Mapping[str, Any] | None = None) -> str:
    """The question with the instructions for the form of the answer."""
    text = doc["question"] if doc["skill"] == MAP else plain_text(doc["question"], doc["prompt"])
    return text.replace(IMAGE, "").strip()


def doc_to_target(doc: Mapping[str, Any]) -> str:
    """The published answer."""
    return doc["answer"]


def process_results(doc: Mapping[str, Any], results: Sequence[str]) -> dict[str, float]:
    """The scores of one reply, by the names of its metrics."""
    skill, think = doc["skill"], doc["prompt"] == "think"
    truth = json.loads(doc["answer"]) if skill == MAP else doc["answer"]
    if skill != DIRECTION:
        return {METRICS[skill]: score(skill, truth, results[0], think)}
    question = Question(doc["id"], doc["scene"], doc["turn"], skill, doc["question"], truth)
    truths = zip(BY_LABELS, (truth, question.corrected), strict=True)
    return {metric: score(skill, each, results[0], think) for metric, each in truths}


def mean(values: Sequence[float]) -> float:
    """The mean; 0 without values."""
    return sum(values) / len(values) if values else 0.0
