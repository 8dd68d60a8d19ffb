"""H*Bench for `eagor bench`: object search (HOS) and path search (HPS)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eagor._checks import shown
from eagor.errors import EagorError, FormatError
from eagor.lab.tasks.benchmark import Case, Figure, Option, PublishedBenchmark
from eagor.lab.tasks.hstar import data as files
from eagor.lab.tasks.hstar.agents import AGENTS, CAUSES, LOOKING, SWEEP, open_perception, score_submission
from eagor.lab.tasks.hstar.data import LEVELS, Episode, Kind
from eagor.lab.tasks.hstar.prompts import WINDOW
from eagor.lab.tasks.hstar.rules import (
    FARTHEST_ANSWER,
    FORMS,
    MAX_TURNS,
    RESOLUTION,
    SCORINGS,
    checked_scoring,
    parse_action,
)
from eagor.lab.tasks.hstar.search import SearchRules

OPTIONS = {
    "scoring": Option("official", "what counts as success", SCORINGS),
    "turns": Option(MAX_TURNS, "views at most; the benchmark allows ten", tuple(range(1, 51))),
    "sure": Option(SearchRules().sure, "probability from which on eagor submits"),
    "degree": Option(SearchRules().degree, "of eagor's harmonics", tuple(range(3, 64))),
    "tilt": Option(SearchRules().tilt, "standard deviation of eagor's prior of the elevation, degrees; 0: even"),
    "height": Option(SearchRules().height, "mean of that prior, degrees"),
    "elsewhere": Option(SearchRules().elsewhere, "share of that prior that is even over the sphere"),
    "views": Option(len(SWEEP), "views of the fixed sweep", tuple(range(1, len(SWEEP) + 1))),
    "resolution": Option(RESOLUTION, "rows of a view; 1080 is official"),
    "form": Option(FORMS[0], "of the model's replies", FORMS),
    "window": Option(WINDOW, "turns of conversation that the model is shown", tuple(range(1, 51))),
}
MOST_ROWS = 8640  # of a view: more is taken for a mistake


@dataclass(frozen=True)
class HStar(PublishedBenchmark):
    """One half of H*Bench; see `eagor.lab.tasks.benchmark.Benchmark`."""

    kind: Kind
    title: str
    work = "eagor.lab.tasks.hstar.agents:work"
    agents, options, causes = AGENTS, OPTIONS, CAUSES
    looking, truth = LOOKING, "the annotations through noise, for studies"

    @property
    def name(self) -> str:
        return f"hstar-{self.kind}"

    @property
    def figures(self) -> Sequence[Figure]:
        return (
            Figure("overall", "Overall", "success of all episodes", lambda record: record["score"]),
            *(
                Figure(level, level.capitalize(), f"success of episodes of level {level}", _at(level))
                for level in LEVELS[self.kind]
            ),
            Figure("official", "Official", "success by the published rule", _scored("official")),
            Figure("strict", "Strict", "success with the pitch always counted", _scored("strict")),
        )

    def info(self, data: Path) -> dict[str, Any]:
        return files.info(data)

    def cases(self, data: Path, settings: Mapping[str, Any]) -> list[Case]:
        entries = {scene.name: scene.items for scene in files.read_scenes(data)}
        found = []
        for episode in files.read_episodes(data, self.kind):
            others = [
                {key: item[key] for key in ("task", "yaw", "pitch") if item.get(key) is not None}
                for index, item in enumerate(entries[episode.scene])
                if index != episode.entry
            ]
            payload = {"episode": episode.as_json(), "siblings": others}
            found.append(Case(episode.id, episode.scene, episode.cluster, payload))
        return found

    def check(self, settings: Mapping[str, Any]) -> None:
        SearchRules.of(settings)  # complains about what nothing can be searched with
        if not 18 <= settings["resolution"] <= MOST_ROWS:
            raise EagorError(f"resolution = {settings['resolution']}; wanted rows of a picture, 18 to {MOST_ROWS}")
        if settings["perception"]:
            open_perception(settings["perception"])

    def judge(self, case: Case, prediction: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
        answer, reason = _submission(prediction, settings.get("form", FORMS[0]))
        episode, scoring = Episode.from_json(case.payload["episode"]), checked_scoring(settings["scoring"])
        return score_submission(episode, answer, scoring, case.payload["siblings"], [{"shown": 1.0}], reason)


HOS = HStar("hos", "H*Bench: object search (HOS)")
HPS = HStar("hps", "H*Bench: path search (HPS)")


def _at(level: str):
    return lambda record: record["score"] if record.get("level") == level else None


def _scored(way: str):
    return lambda record: record.get("scores", {}).get(way)


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
