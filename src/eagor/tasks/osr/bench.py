"""OSR-Bench as `eagor bench` knows it."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from eagor.errors import EagorError, FormatError
from eagor.tasks.benchmark import Case, Figure, Option, Record, settled
from eagor.tasks.chat import shared_chat
from eagor.tasks.osr import exports
from eagor.tasks.osr.agents import AGENTS, LOOKING, Reply
from eagor.tasks.osr.dataset import SUFFIXES, Scene, load, load_kept
from eagor.tasks.osr.eyes import DEPTH_FILE
from eagor.tasks.osr.play import TRUTH, judged, open_looker
from eagor.tasks.osr.prompts import FORMS
from eagor.tasks.osr.scoring import COUNTING, DIRECTION, DISTANCE, MAP, SKILLS
from eagor.tasks.osr.truth import FILE, HEIGHT

OPTIONS = {
    "labels": Option(
        "official",
        "left and right as published (mirrored), as they are in the room, or both side by side",
        ("official", "corrected", "both"),
    ),
    "suffix": Option(SUFFIXES[0], "which of the published files", SUFFIXES),
    "skill": Option("all", "questions of one kind only", ("all", *SKILLS)),
    "prompt": Option("vanilla", "what the model is asked for: a brief answer, or its thoughts first", FORMS),
    "range": Option("floor", "where eagor takes ranges from; unit: nowhere", ("floor", "depth", "unit")),
    "reading": Option(
        "auto",
        "eagor says the likeliest label after rounding (cells), or what the places say; auto: cells where the walls "
        "are known",
        ("auto", "cells", "metres"),
    ),
    "camera_height": Option(HEIGHT, "metres above the floor; it scales the room, and matters beside a depth cue"),
    "degree": Option(15, "of eagor's harmonics", tuple(range(3, 64))),
}
EXPORTS = {
    "osr-csv": "the table of answers and scores that the published runner writes, one file for each scene",
    "lmms-eval": "a folder of task files for lmms_eval --include_path, with the questions and their pictures' paths",
}


class OsrBench:
    """OSR-Bench; see `eagor.tasks.benchmark.Benchmark`."""

    name = "osr"
    title = "OSR-Bench"
    work = "eagor.tasks.osr.play:work"
    agents, options, exports = AGENTS, OPTIONS, EXPORTS
    record: ClassVar = {
        "skill": "text", "tags": "texts", "scores": "figures", "question": "text", "answer": "text",
        "lenient?": "figures",
    }  # fmt: skip

    @property
    def figures(self) -> Sequence[Figure]:
        return (
            Figure("overall", "Overall", "mean over the kinds of questions", _score, lambda record: record["skill"]),
            Figure("direction", "Direction", "relative direction, by the labels of the run", _of(DIRECTION, _score)),
            Figure("direction_official", "official", "by the published labels", _of(DIRECTION, _by("official"))),
            Figure(
                "direction_corrected", "corrected", "with left and right put right", _of(DIRECTION, _by("corrected"))
            ),
            Figure("direction_clear", "clear", "both products above one squared cell", _tagged("clear")),
            Figure("direction_border", "border", "a product of at most one squared cell", _tagged("near a border")),
            Figure("direction_lenient", "lenient", "whatever the form of the answer", _of(DIRECTION, _lenient)),
            Figure("distance", "Distance", "which is the closest", _of(DISTANCE, _score)),
            Figure("counting", "Counting", "how many, with the partial credit of the benchmark", _of(COUNTING, _score)),
            Figure("map", "Map F1", "the map, by the benchmark's rule", _of(MAP, _score)),
        )

    def info(self, data: Path) -> dict[str, Any]:
        """Counts and oddities of each kind of file that is there."""
        found: dict[str, Any] = {}
        sizes: Counter[str] = Counter()
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
            load(Path(data))  # says what is wrong
        for scene in seen.values():
            sizes[_size(scene)] += 1
        return {
            "files": found,
            "pictures": dict(sizes),
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

    def settle(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        truth = f"the true places, for data that has a {FILE} in each scene"
        found = settled(self, settings, LOOKING, truth)
        if found["camera_height"] <= 0:
            raise EagorError(f"camera_height = {found['camera_height']}; wanted metres above the floor, above 0")
        if found["perception"]:
            _check_files(settings["data"], found["perception"], found)
            open_looker(found["perception"], found)
        if found["model"]:
            shared_chat(found["model"])
        return found

    def judge(self, case: Case, prediction: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
        told = next((prediction[key] for key in ("text", "answer", "model_answer") if key in prediction), None)
        if not isinstance(told, str):
            raise FormatError(f'the prediction for {case.id} has the keys {sorted(prediction)}; wanted "text": words')
        scenes = load_kept(str(settings["data"]), settings["suffix"])
        scene = next(scene for scene in scenes if scene.id == case.payload["scene"])
        question = next(question for question in scene.questions if question.id == case.payload["question"])
        return judged(scene, question, Reply(told), settings)

    def export(self, to: str, records: Sequence[Record], settings: Mapping[str, Any], folder: Path) -> list[Path]:
        if to == "osr-csv":
            return exports.csv_files(records, settings, folder)
        if to == "lmms-eval":
            return exports.lmms_eval(settings, folder)
        raise EagorError(f"{self.name} has no export {to!r}; it has {', '.join(EXPORTS)}")


OSR = OsrBench()


def _check_files(data: Any, perception: str, options: Mapping[str, Any]) -> None:
    """Raise `FormatError` where scenes lack a file that all of them would be answered from."""
    truth = perception.partition(":")[0] == TRUTH
    wanted = FILE if truth else DEPTH_FILE if options["range"] == "depth" else None
    if wanted is None:
        return
    scenes = load_kept(str(data), options["suffix"])
    without = [scene.id for scene in scenes if not (scene.folder / wanted).is_file()]
    if without:
        why = "the perception truth reads" if truth else "range=depth reads"
        raise FormatError(
            f"{len(without)} of {len(scenes)} scenes have no {wanted}, which {why}, such as {without[0]}; "
            "give the folder of those that have it, or choose another way"
        )


def _score(record: Record) -> float | None:
    return record["score"]


def _lenient(record: Record) -> float | None:
    return next(iter(record.get("lenient", {}).values()), None)


def _by(labels: str) -> Callable[[Record], float | None]:
    return lambda record: record["scores"].get(labels)


def _of(skill: str, read: Callable[[Record], float | None]) -> Callable[[Record], float | None]:
    return lambda record: read(record) if record["skill"] == skill else None


def _tagged(tag: str) -> Callable[[Record], float | None]:
    return lambda record: record["score"] if tag in record["tags"] else None


def _size(scene: Scene) -> str:
    if scene.image is None:
        return "missing"
    from PIL import Image

    from eagor.worlds.panorama import FORMATS

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with Image.open(scene.image, formats=FORMATS) as picture:
                return f"{picture.width} x {picture.height}"
        except Exception:  # decoders raise whatever the damage leads them to
            return "unreadable"
