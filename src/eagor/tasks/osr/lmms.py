"""What the exported task files for lmms-eval call."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from eagor.tasks.chat import IMAGE
from eagor.tasks.osr.prompts import asked
from eagor.tasks.osr.questions import Question
from eagor.tasks.osr.scoring import COUNTING, DIRECTION, DISTANCE, MAP, score


def doc_to_visual(doc: Mapping[str, Any]) -> list[Any]:
    """The panorama, as a PIL image."""
    from PIL import Image

    from eagor.worlds.panorama import FORMATS

    with Image.open(doc["image"], formats=FORMATS) as file:
        return [file.convert("RGB")]


def doc_to_text(doc: Mapping[str, Any], settings: Mapping[str, Any] | None = None) -> str:
    """The words of the question, with the instructions for the form of the answer."""
    text = doc["question"] if doc["skill"] == MAP else asked(doc["question"], doc["prompt"])
    return text.replace(IMAGE, "").strip()


def doc_to_target(doc: Mapping[str, Any]) -> str:
    """The published answer."""
    return doc["answer"]


def process_results(doc: Mapping[str, Any], results: Sequence[str]) -> dict[str, float]:
    """The scores of one reply, under the names of the metrics that it belongs to."""
    skill, think = doc["skill"], doc["prompt"] == "think"
    truth = json.loads(doc["answer"]) if skill == MAP else doc["answer"]
    question = Question(doc["id"], doc["scene"], doc["turn"], skill, doc["question"], truth)
    official = score(skill, truth, results[0], think)
    if skill == DIRECTION:
        corrected = score(skill, question.corrected, results[0], think)
        return {"direction_official": official, "direction_corrected": corrected}
    return {{DISTANCE: "distance", COUNTING: "counting", MAP: "map"}[skill]: official}


def mean(values: Sequence[float]) -> float:
    """The mean; 0 of nothing."""
    return sum(values) / len(values) if values else 0.0
