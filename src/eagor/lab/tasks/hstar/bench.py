"""H*Bench for `eagor bench`: object search (HOS) and path search (HPS)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from eagor._checks import shown
from eagor.errors import FormatError
from eagor.lab.tasks.hstar import data as files
from eagor.lab.tasks.hstar.agents import AGENTS, CAUSES, LOOKING, SWEEP, open_perception, score_submission, work
from eagor.lab.tasks.hstar.data import LEVELS, Episode, Kind
from eagor.lab.tasks.hstar.prompts import WINDOW
from eagor.lab.tasks.hstar.rules import (
    FARTHEST_ANSWER,
    MAX_TURNS,
    RESOLUTION,
    Scoring,
    checked_scoring,
    parse_action,
)
from eagor.lab.tasks.hstar.search import SearchRules
from eagor.lab.tasks.published import PublishedConfig, PublishedTask, score_metric
from eagor.lab.tasks.task import Metric, Payload, Record, Sample, settings_of

DEFAULT = SearchRules()


class HStarConfig(PublishedConfig, kw_only=True):
    """The settings of a run of H*Bench."""

    scoring: Annotated[Scoring, Meta(description="what counts as success")] = "official"
    turns: Annotated[int, Meta(ge=1, le=50, description="views at most; the benchmark allows ten")] = MAX_TURNS
    sure: Annotated[float, Meta(description="probability from which on eagor submits")] = DEFAULT.sure
    degree: Annotated[int, Meta(ge=3, le=63, description="of eagor's harmonics")] = DEFAULT.degree
    tilt: Annotated[float, Meta(description="spread of eagor's prior of the elevation, degrees; 0: even")] = (
        DEFAULT.tilt
    )
    height: Annotated[float, Meta(description="mean of that prior, degrees")] = DEFAULT.height
    elsewhere: Annotated[float, Meta(description="share of that prior that is even over the sphere")] = (
        DEFAULT.elsewhere
    )
    views: Annotated[int, Meta(ge=1, le=len(SWEEP), description="views of the fixed sweep")] = len(SWEEP)
    resolution: Annotated[int, Meta(ge=18, le=8640, description="rows of a view; 1080 is official")] = RESOLUTION
    form: Annotated[Literal["free_think", "no_think", "grounding"], Meta(description="of the model's replies")] = (
        "free_think"
    )
    window: Annotated[int, Meta(ge=1, le=50, description="turns of conversation that the model is shown")] = WINDOW


def _at(level: str) -> Callable[[Record], float | None]:
    return lambda record: record["score"] if record.get("level") == level else None


def _scored(way: str) -> Callable[[Record], float | None]:
    return lambda record: record.get("scores", {}).get(way)


def _views(record: Record) -> float | None:
    return record.get("views")


class HStar(PublishedTask):
    """One half of H*Bench; see `eagor.lab.tasks.task.Task`."""

    Config = HStarConfig
    agents, causes, looking = AGENTS, CAUSES, LOOKING
    truth: ClassVar = "the annotations through noise, for studies"

    def __init__(self, kind: Kind, title: str, what: str) -> None:
        self.kind: Kind = kind
        self.title, self.what, self.name = title, what, f"hstar-{kind}"
        self.metrics: tuple[Metric, ...] = (
            score_metric("overall", "Overall", "success of all episodes", lambda record: record["score"]),
            *(
                score_metric(level, level.capitalize(), f"success of episodes of level {level}", _at(level))
                for level in LEVELS[kind]
            ),
            score_metric("official", "Official", "success by the published rule", _scored("official")),
            score_metric("strict", "Strict", "success with the pitch always counted", _scored("strict")),
            Metric("views", "Views", "number of views", _views, unit="", better="low", scale=1.0, digits=2),
        )

    def info(self, data: Path) -> dict[str, Any]:
        return files.info(data)

    def samples(self, config: HStarConfig) -> list[Sample]:
        entries = {scene.name: scene.items for scene in files.read_scenes(Path(config.data))}
        found = []
        for episode in files.read_episodes(Path(config.data), self.kind):
            others = [
                {key: item[key] for key in ("task", "yaw", "pitch") if item.get(key) is not None}
                for index, item in enumerate(entries[episode.scene])
                if index != episode.entry
            ]
            found.append(Sample(episode.id, episode.scene, {"episode": episode.as_json(), "siblings": others}))
        return found

    def check(self, config: HStarConfig) -> None:
        SearchRules.of(settings_of(config))  # complains about what nothing can be searched with
        if config.perception:
            open_perception(config.perception)

    def runner(self, config: HStarConfig) -> Callable[[Payload], Record]:
        return work(settings_of(config))

    def score(self, sample: Sample, prediction: Mapping[str, Any], config: HStarConfig) -> Record:
        answer, reason = _submission(prediction, config.form)
        episode, scoring = Episode.from_json(sample.payload["episode"]), checked_scoring(config.scoring)
        return score_submission(episode, answer, scoring, sample.payload["siblings"], [{"shown": 1.0}], reason)


def _submission(prediction: Mapping[str, Any], form: str) -> tuple[dict[str, int] | None, str | None]:
    """The submission of a prediction, or the reason why there is none."""
    found = prediction.get("submit")
    if found is None and "yaw" in prediction:
        found = prediction["yaw"], prediction.get("pitch", 0)
    if found is not None:
        try:
            yaw, pitch = (round(float(value)) for value in found)
        except (TypeError, ValueError, OverflowError):
            raise FormatError(f"a prediction submits {shown(found)}; wanted yaw and pitch in degrees") from None
        if max(abs(yaw), abs(pitch)) > FARTHEST_ANSWER:
            raise FormatError(f"a prediction submits {shown(found)}; wanted degrees, at most {FARTHEST_ANSWER}")
        return {"yaw": yaw, "pitch": pitch}, None
    texts = prediction.get("replies", prediction.get("text"))
    if texts is None:
        raise FormatError(
            f"a prediction has {shown(', '.join(prediction), 200)}; wanted submit: [yaw, pitch], or yaw and "
            "pitch, or text (the model's last reply), or replies (all of them)"
        )
    if not isinstance(texts, str | list):
        raise FormatError(f"a prediction says {shown(texts)}; wanted the model's reply, or a list of all of them")
    read = [parse_action(str(text), form).action for text in ([texts] if isinstance(texts, str) else texts)]
    for action in read[:MAX_TURNS]:
        if action is not None and action.kind == "submit":
            return {"yaw": action.yaw, "pitch": action.pitch}, None
    return None, "format" if None in read else "budget"


HOS = HStar("hos", "H*Bench: object search (HOS)", "look around in a photograph for a thing, and name its direction")
HPS = HStar("hps", "H*Bench: path search (HPS)", "look around in a photograph for the way to go, and name it")
