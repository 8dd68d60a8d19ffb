"""OSR-Bench for `eagor bench`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

from eagor.errors import EagorError, FormatError
from eagor.lab.tasks.benchmark import (
    Case,
    Figure,
    Option,
    PublishedBenchmark,
    Record,
    picture_size,
)
from eagor.lab.tasks.osr.agents import AGENTS, FORMS, LOOKING, Reply, score_reply
from eagor.lab.tasks.osr.data import SUFFIXES, Scene, load, load_kept
from eagor.lab.tasks.osr.detections import DEPTH_FILE, FILE, HEIGHT, TRUTH, open_detector
from eagor.lab.tasks.osr.scoring import COUNTING, DIRECTION, DISTANCE, MAP, SKILLS

OPTIONS = {
    "labels": Option(
        "official",
        "left and right as published (mirrored), as they are in the room, or both side by side",
        ("official", "corrected", "both"),
    ),
    "suffix": Option(SUFFIXES[0], "which of the published files", SUFFIXES),
    "skill": Option("all", "questions of one kind only", ("all", *SKILLS)),
    "prompt": Option(FORMS[0], "what the model is asked for: a brief answer, or its reasoning first", FORMS),
    "range": Option("floor", "where eagor takes ranges from; unit: no ranges", ("floor", "depth", "unit")),
    "reading": Option(
        "auto",
        "eagor answers with the likeliest label after rounding (cells), or from the places; auto: cells if the walls "
        "are known",
        ("auto", "cells", "metres"),
    ),
    "camera_height": Option(HEIGHT, "metres above the floor; it scales the room, and matters with depth values"),
    "degree": Option(15, "of eagor's harmonics", tuple(range(3, 64))),
}

Reader = Callable[[Record], float | None]


def _score(record: Record) -> float | None:
    return record["score"]


def _lenient(record: Record) -> float | None:
    return next(iter(record.get("lenient", {}).values()), None)


def _by(labels: str) -> Reader:
    return lambda record: record["scores"].get(labels)


def _of(skill: str, read: Reader = _score) -> Reader:
    return lambda record: read(record) if record["skill"] == skill else None


def _tagged(tag: str) -> Reader:
    return lambda record: record["score"] if tag in record["tags"] else None


class OsrBench(PublishedBenchmark):
    """OSR-Bench; see `eagor.lab.tasks.benchmark.Benchmark`."""

    name = "osr"
    title = "OSR-Bench"
    work = "eagor.lab.tasks.osr.agents:work"
    agents, options = AGENTS, OPTIONS
    looking, truth = LOOKING, f"the true places, for data that has a {FILE} in each scene"
    record: ClassVar = {
        "skill": "text", "tags": "texts", "scores": "figures", "question": "text", "answer": "text",
        "lenient?": "figures", "map_range?": "figures",
    }  # fmt: skip
    figures = (
        Figure("overall", "Overall", "mean over the kinds of questions", _score, lambda record: record["skill"]),
        Figure("direction", "Direction", "relative direction, by the labels of the run", _of(DIRECTION)),
        Figure("direction_official", "official", "by the published labels", _of(DIRECTION, _by("official"))),
        Figure("direction_corrected", "corrected", "with left and right put right", _of(DIRECTION, _by("corrected"))),
        Figure("direction_clear", "clear", "both products above one squared cell", _tagged("clear")),
        Figure("direction_border", "border", "a product of at most one squared cell", _tagged("near a border")),
        Figure("direction_lenient", "lenient", "whatever the form of the answer", _of(DIRECTION, _lenient)),
        Figure("distance", "Distance", "which is the closest", _of(DISTANCE)),
        Figure("counting", "Counting", "how many, with the partial credit of the benchmark", _of(COUNTING)),
        Figure("map", "Map F1", "the map: the least that the published code gives", _of(MAP)),
        Figure(
            "map_most",
            "at most",
            "the most it gives: it depends on PYTHONHASHSEED",
            lambda r: r.get("map_range", {}).get("most"),
        ),
    )

    def info(self, data: Path) -> dict[str, Any]:
        """Counts and oddities of each kind of file in the data."""
        found: dict[str, Any] = {}
        seen: dict[str, Scene] = {}
        for suffix in SUFFIXES:
            try:
                scenes = load(Path(data), suffix)
            except FormatError:
                continue
            seen |= {scene.id: scene for scene in scenes}
            questions = [question for scene in scenes for question in scene.questions]
            labels = Counter(question.answer for question in questions if question.skill == DIRECTION)
            found[suffix] = {
                "scenes": len(scenes),
                "questions": dict(Counter(question.skill for question in questions)),
                "empty_labels_skipped": sum(scene.skipped for scene in scenes),
                "direction_labels": dict(labels.most_common()),
                "not_understood": sum(not question.names for question in questions),
            }
        if not found:
            load(Path(data))  # raises with the reason
        return {
            "files": found,
            "pictures": dict(Counter(_size(scene.image) for scene in seen.values())),
            "with_true_places": sum((scene.folder / FILE).is_file() for scene in seen.values()),
            "with_depth": sum((scene.folder / DEPTH_FILE).is_file() for scene in seen.values()),
        }

    def cases(self, data: Path, settings: Mapping[str, Any]) -> list[Case]:
        return [
            Case(question.id, scene.id, scene.id, {"scene": scene.id, "question": question.id})
            for scene in load(Path(data), settings["suffix"])
            for question in scene.questions
            if settings["skill"] in ("all", question.skill)
        ]

    def check(self, settings: Mapping[str, Any]) -> None:
        if settings["camera_height"] <= 0:
            raise EagorError(f"camera_height = {settings['camera_height']}; wanted metres above the floor, above 0")
        if settings["perception"]:
            _check_files(settings)
            open_detector(settings["perception"], settings)

    def judge(self, case: Case, prediction: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
        told = next((prediction[key] for key in ("text", "answer", "model_answer") if key in prediction), None)
        if not isinstance(told, str):
            raise FormatError(f'the prediction for {case.id} has the keys {sorted(prediction)}; wanted "text": words')
        scenes = load_kept(str(settings["data"]), settings["suffix"])
        scene = next(scene for scene in scenes if scene.id == case.payload["scene"])
        return score_reply(scene, scene.by_id[case.payload["question"]], Reply(told), settings)


OSR = OsrBench()


def _size(image: Path | None) -> str:
    if image is None:
        return "missing"
    size = picture_size(image)
    return "unreadable" if size is None else f"{size[0]} x {size[1]}"


def _check_files(found: Mapping[str, Any]) -> None:
    """Raise `FormatError` if scenes lack a file that the settings need."""
    truth = found["perception"].partition(":")[0] == TRUTH
    wanted = FILE if truth else DEPTH_FILE if found["range"] == "depth" else None
    if wanted is None:
        return
    scenes = load_kept(str(found["data"]), found["suffix"])
    without = [scene.id for scene in scenes if not (scene.folder / wanted).is_file()]
    if without:
        why = "the perception truth reads" if truth else "range=depth reads"
        raise FormatError(
            f"{len(without)} of {len(scenes)} scenes have no {wanted}, which {why}, such as {without[0]}; "
            "give the folder of those that have it, or choose another setting"
        )
