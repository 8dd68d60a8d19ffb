"""OSR-Bench for `eagor bench`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import Meta

from eagor.errors import EagorError, FormatError
from eagor.lab.tasks.osr.agents import AGENTS, LOOKING, Reply, score_reply, work
from eagor.lab.tasks.osr.data import SUFFIXES, Scene, load, load_kept
from eagor.lab.tasks.osr.detections import DEPTH_FILE, FILE, HEIGHT, TRUTH, open_detector
from eagor.lab.tasks.osr.scoring import COUNTING, DIRECTION, DISTANCE, MAP, SKILLS
from eagor.lab.tasks.published import PublishedConfig, PublishedRecord, PublishedTask, picture_size, score_metric
from eagor.lab.tasks.task import Payload, Record, Sample, settings_of

ALL = "all"
Reader = Callable[[Record], float | None]


class OsrConfig(PublishedConfig, kw_only=True):
    """The settings of a run of OSR-Bench."""

    labels: Annotated[
        Literal["official", "corrected", "both"],
        Meta(description="left and right as published (mirrored), as they are in the room, or both side by side"),
    ] = "official"
    suffix: Annotated[
        Literal["qa_without_cogmap", "qa", "qa_with_negative", "qa_with_negative_without_cogmap"],
        Meta(description="which of the published files"),
    ] = "qa_without_cogmap"
    skill: Annotated[str, Meta(description=f"questions of one kind only: {', '.join((ALL, *SKILLS))}")] = ALL
    prompt: Annotated[
        Literal["vanilla", "think"],
        Meta(description="what the model is asked for: an answer, or its reasoning first"),
    ] = "vanilla"
    range: Annotated[
        Literal["floor", "depth", "unit"], Meta(description="where eagor takes ranges from; unit: no ranges")
    ] = "floor"
    reading: Annotated[
        Literal["auto", "cells", "metres"],
        Meta(
            description="eagor answers with the likeliest label after rounding (cells), or from the places; auto: "
            "cells if the walls are known"
        ),
    ] = "auto"
    camera_height: Annotated[
        float, Meta(gt=0, description="metres above the floor; it scales the room, and matters with depth values")
    ] = HEIGHT
    degree: Annotated[int, Meta(ge=3, le=63, description="of eagor's harmonics")] = 15


class OsrRecord(PublishedRecord, kw_only=True):
    """What the metrics of OSR-Bench read."""

    skill: str
    question: str
    answer: str
    tags: list[str]  # pyright: ignore[reportGeneralTypeIssues] (here it has no default)
    scores: dict[str, float | None]  # pyright: ignore[reportGeneralTypeIssues]
    lenient: dict[str, float | None] = msgspec.field(default_factory=dict)
    map_range: dict[str, float | None] = msgspec.field(default_factory=dict)


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


class OsrBench(PublishedTask):
    """OSR-Bench; see `eagor.lab.tasks.task.Task`."""

    name = "osr"
    title = "OSR-Bench"
    what = "questions about what stands where around a camera"
    Config, Record = OsrConfig, OsrRecord
    agents, looking = AGENTS, LOOKING
    truth: ClassVar = f"the true places, for data that has a {FILE} in each scene"
    metrics = (
        score_metric("overall", "Overall", "mean over the kinds of questions", _score, lambda record: record["skill"]),
        score_metric("direction", "Direction", "relative direction, by the labels of the run", _of(DIRECTION)),
        score_metric("direction_official", "official", "by the published labels", _of(DIRECTION, _by("official"))),
        score_metric(
            "direction_corrected", "corrected", "with left and right put right", _of(DIRECTION, _by("corrected"))
        ),
        score_metric("direction_clear", "clear", "both products above one squared cell", _tagged("clear")),
        score_metric("direction_border", "border", "a product of at most one squared cell", _tagged("near a border")),
        score_metric("direction_lenient", "lenient", "whatever the form of the answer", _of(DIRECTION, _lenient)),
        score_metric("distance", "Distance", "which is the closest", _of(DISTANCE)),
        score_metric("counting", "Counting", "how many, with the partial credit of the benchmark", _of(COUNTING)),
        score_metric("map", "Map F1", "the map: the least that the published code gives", _of(MAP)),
        score_metric(
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

    def samples(self, config: OsrConfig) -> list[Sample]:
        return [
            Sample(question.id, scene.id, {"scene": scene.id, "question": question.id})
            for scene in load(Path(config.data), config.suffix)
            for question in scene.questions
            if config.skill in (ALL, question.skill)
        ]

    def check(self, config: OsrConfig) -> None:
        if config.skill not in (ALL, *SKILLS):
            raise EagorError(f"skill = {config.skill!r}; wanted {', '.join((ALL, *SKILLS))}")
        if config.perception:
            settings = settings_of(config)
            _check_files(settings)
            open_detector(config.perception, settings)

    def runner(self, config: OsrConfig) -> Callable[[Payload], Record]:
        return work(settings_of(config))

    def score(self, sample: Sample, prediction: Mapping[str, Any], config: OsrConfig) -> Record:
        answer = next((prediction[key] for key in ("text", "answer", "model_answer") if key in prediction), None)
        if not isinstance(answer, str):
            raise FormatError(f'the prediction for {sample.id} has the keys {sorted(prediction)}; wanted "text": words')
        scenes = load_kept(config.data, config.suffix)
        scene = next(scene for scene in scenes if scene.id == sample.payload["scene"])
        return score_reply(scene, scene.by_id[sample.payload["question"]], Reply(answer), settings_of(config))


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
