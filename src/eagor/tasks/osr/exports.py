"""OSR-Bench for other software: the published table of answers, and task files for lmms-eval."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eagor._csv import as_csv
from eagor._files import written
from eagor._json import shown
from eagor.errors import EagorError, FormatError
from eagor.tasks.benchmark import Record
from eagor.tasks.osr.dataset import load
from eagor.tasks.osr.scoring import MAP
from eagor.tasks.task_files import write_task

COLUMNS = ("image_id", "model", "turn_id", "skills_tested", "question", "model_answer", "ground_truth", "score")
TASK = "eagor_osr"


def csv_files(records: Sequence[Record], settings: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write ``<scene>_<suffix>_results.csv`` with the columns of the published runner; returns the files.

    Scores are those of the run's labels. Raises `EagorError` without records, `FormatError` for a record whose scene
    can be no part of a file's name.
    """
    done = [record for record in records if record.get("status", "ok") == "ok"]
    if not done:
        raise EagorError("the tables hold a run's answers; name a run with results")
    folder = Path(folder)
    model = settings.get("model") or settings["agent"]
    by_scene: dict[str, list[Record]] = {}
    for record in done:
        by_scene.setdefault(_scene(record), []).append(record)
    files = []
    for scene, answers in sorted(by_scene.items()):
        path = folder / f"{scene}_{settings['suffix']}_results.csv"
        rows: list[tuple[Any, ...]] = [COLUMNS]
        for record in sorted(answers, key=lambda each: _turn(each["case"])):
            turn, image = _turn(record["case"])[0], f"data/{scene}/rgb.png"
            said = (record["question"], record["answer"], record.get("truth", ""), record["score"])
            rows.append((image, model, turn, record["skill"], *said))
        files.append(written(path, as_csv(rows, "\r\n")))
    return files


def lmms_eval(settings: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the task ``eagor_osr`` into `folder` (`eagor.tasks.task_files`); returns the files.

    Each question is asked alone, so that files with a map give their map's question as one of them. The questions hold
    the paths of their pictures on this machine. Raises `FormatError` where a picture is missing.
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
    metrics = ["direction_official", "direction_corrected", "distance", "counting", "map"]
    return write_task(folder, TASK, "eagor.tasks.osr.lmms", documents, metrics)


def _scene(record: Record) -> str:
    """The scene of a record: part of a file's name, and never of another folder's."""
    scene = record["cluster"]
    if not isinstance(scene, str) or not scene.isprintable() or "/" in scene or "\\" in scene:
        raise FormatError(
            f"the record {record['key']!r} has the cluster {shown(scene)}; wanted a scene's name, which a file can have"
        )
    return scene


def _turn(case: str) -> tuple[int, str]:
    """The turn in a case's id, and the id, to sort by."""
    number = case.rsplit("/", 1)[-1].partition("-")[0]
    if not number.isdecimal():
        raise FormatError(f"the record of the case {case!r} names no turn; wanted an id such as scene/3-counting")
    return int(number), case
