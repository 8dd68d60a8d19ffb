"""H*Bench for `eagor bench`: object search (HOS) and path search (HPS); episodes, their records, causes of failures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np

from eagor._checks import shown
from eagor.conventions import direction_from_hstar
from eagor.errors import FormatError
from eagor.lab.agents.models import recalibrator, shared_chat
from eagor.lab.tasks.hstar import data as files
from eagor.lab.tasks.hstar.agents import (
    AGENTS,
    LOOKING,
    RESPONDS,
    Agent,
    HStarConfig,
    make_agent,
    open_detector,
    open_perception,
)
from eagor.lab.tasks.hstar.data import LEVELS, Episode, Kind, head_of, tag_of
from eagor.lab.tasks.hstar.rules import (
    FARTHEST_ANSWER,
    MAX_TURNS,
    SCORINGS,
    Scoring,
    View,
    parse_action,
    submit_succeeds,
    visible_share,
    window_of,
)
from eagor.lab.tasks.published import PublishedTask, score_metric
from eagor.lab.tasks.task import Metric, Payload, Record, Sample, settings_of
from eagor.sphere import angular_distance

# In order of precedence: the first that applies is the cause.
CAUSES = {
    "format": "no valid submission: replies could not be read",
    "budget": "no submission within the turns",
    "wrong_instance": "submitted another annotated target with the same noun",
    "stopped_wrongly": "an answer at an earlier turn would have succeeded",
    "never_in_view": "no part of the target was ever in view",
    "fusion_error": "some view's strongest response was at the target, the answer was not",
    "missed": "the target was in view and nothing responded there",
    "false_detection": "something else responded, or was taken for it",
}
NEAR = 25.0  # degrees from the answer: a response there counts as taken for the target


def _at(level: str, record: Record) -> float | None:
    return record["score"] if record.get("level") == level else None


def _by(way: Scoring, record: Record) -> float | None:
    return record.get("scores", {}).get(way)


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
                score_metric(level, level.capitalize(), f"success of episodes of level {level}", partial(_at, level))
                for level in LEVELS[kind]
            ),
            score_metric("official", "Official", "success by the published rule", partial(_by, "official")),
            score_metric("strict", "Strict", "success with the pitch always counted", partial(_by, "strict")),
            Metric("views", "Views", "number of views", lambda r: r.get("views"), "", "low", 1.0, 2),
        )

    def info(self, data: Path) -> dict[str, Any]:
        return files.info(data)

    def samples(self, config: HStarConfig) -> list[Sample]:
        episodes = files.read_episodes(Path(config.data), self.kind)
        return [Sample(episode.id, episode.scene, msgspec.to_builtins(episode)) for episode in episodes]

    def check(self, config: HStarConfig) -> None:
        if config.perception:
            open_perception(config.perception)

    def runner(self, config: HStarConfig) -> Callable[[Payload], Record]:
        perception = open_perception(config.perception) if config.perception else None
        chat, read = shared_chat(config.model) if config.model else None, recalibrator(settings_of(config))

        def run(payload: Payload) -> Record:
            episode = msgspec.convert(payload, Episode)
            detector = None
            if perception is not None:
                detector = open_detector(perception, episode, config.seed, config.resolution, read)
            return run_episode(episode, make_agent(config, episode, detector, chat), config.scoring, config.turns)

        return run

    def score(self, sample: Sample, prediction: Mapping[str, Any], config: HStarConfig) -> Record:
        answer, reason = _submission(prediction, config.form)
        return record_of(msgspec.convert(sample.payload, Episode), config.scoring, answer, [{"shown": 1.0}], reason)


def _submission(prediction: Mapping[str, Any], form: str) -> tuple[dict[str, int] | None, str]:
    """The submission of a prediction, or None and the reason why there is none."""
    given = prediction.get("submit")
    if given is None and "yaw" in prediction:
        given = prediction["yaw"], prediction.get("pitch", 0)
    if given is None:
        text = prediction.get("text")
        if not isinstance(text, str):
            raise FormatError(
                f"a prediction has {shown(', '.join(prediction), 200)}; wanted submit: [yaw, pitch], or yaw and pitch, "
                "or text, the model's last reply"
            )
        action = parse_action(text, form).action
        if action is None or action.kind != "submit":
            return None, "format" if action is None else "budget"
        return {"yaw": action.yaw, "pitch": action.pitch}, "submitted"
    try:
        yaw, pitch = (round(float(value)) for value in given)
    except (TypeError, ValueError, OverflowError):
        raise FormatError(f"a prediction submits {shown(given)}; wanted yaw and pitch in degrees") from None
    if max(abs(yaw), abs(pitch)) > FARTHEST_ANSWER:
        raise FormatError(f"a prediction submits {shown(given)}; wanted degrees, at most {FARTHEST_ANSWER}")
    return {"yaw": yaw, "pitch": pitch}, "submitted"


HOS = HStar("hos", "H*Bench: object search (HOS)", "look around in a photograph for a thing, and name its direction")
HPS = HStar("hps", "H*Bench: path search (HPS)", "look around in a photograph for the way to go, and name it")


# --- an episode and its record ----------------------------------------------------------------------------------------


def run_episode(episode: Episode, agent: Agent, scoring: Scoring = "official", turns: int = MAX_TURNS) -> Record:
    """The record of one episode; see `eagor.lab.tasks.published.PublishedRecord` for the common keys.

    `scoring` decides "score" and "by_turn" ("scores" has both); `turns`: views at most.

    Each step has "turn", "view" (yaw, pitch), "shown" (visible fraction of the target), "action" (as text, None if
    invalid), "would" (its answer at this turn: yaw, pitch, official, strict, p), and the agent's notes.
    """
    item, view, answer = episode.item, View(float(episode.start), 0.0), None
    steps: list[dict[str, Any]] = []
    while answer is None and len(steps) < turns:
        turn = agent(view, len(steps) + 1 == turns)
        yaw, pitch, p = turn.would
        succeeds = {each: submit_succeeds(item, yaw, pitch, each) for each in SCORINGS}
        steps.append(
            {
                "turn": len(steps) + 1,
                "view": {"yaw": view.yaw, "pitch": view.pitch},
                "shown": round(visible_share(view, item["yaw"], item.get("pitch")), 3),
                "action": None if turn.action is None else str(turn.action),
                "would": {"yaw": yaw, "pitch": pitch, **succeeds, "p": None if math.isnan(p) else round(p, 4)},
                **turn.notes,
            }
        )
        if turn.action is not None and turn.action.kind == "submit":
            answer = {"yaw": turn.action.yaw, "pitch": turn.action.pitch}
        view = view.after(turn.action)
    unread = any(step.get("valid") is False for step in steps)
    reason = "submitted" if answer is not None else "format" if unread else "budget"
    record = record_of(episode, scoring, answer, steps, reason)
    by_turn = [int(step["would"][scoring]) for step in steps]
    return record | {
        "scoring": scoring,
        "by_turn": by_turn + [int(record["score"])] * (turns - len(steps)),
        "views": len(steps),
        "stated": steps[-1]["would"]["p"] if answer is not None else None,
        "sure": bool(steps[-1].get("sure", False)) and answer is not None,
        "steps": steps,
    }


def record_of(
    episode: Episode,
    scoring: Scoring,
    answer: Mapping[str, Any] | None,
    steps: Sequence[Mapping[str, Any]],
    reason: str,
) -> dict[str, Any]:
    """The part of a record about the submission, with the errors in degrees.

    `answer`: None if there was none, for the `reason`, which is then also the cause of the failure.
    """
    item, pitch = episode.item, episode.item.get("pitch")
    scores = dict.fromkeys(SCORINGS, 0.0)
    errors: dict[str, float | None] = {"yaw_error": None, "pitch_error": None, "error": None}
    cause: str | None = reason
    if answer is not None:
        at, middle = (answer["yaw"], answer["pitch"]), window_of(item).centre
        scores = {way: float(submit_succeeds(item, *at, way)) for way in SCORINGS}
        turn = abs((at[0] - middle[0] + 180.0) % 360.0 - 180.0)
        lift = None if pitch is None else round(abs(at[1] - middle[1]), 2)
        errors = {"yaw_error": round(turn, 2), "pitch_error": lift, "error": round(_apart(at, middle), 2)}
        cause = None if scores[scoring] else cause_of(item, steps, at, episode.others, scoring)
    return {
        "case": episode.id,
        "cluster": episode.cluster,
        "level": episode.level_name,
        "tags": [tag_of(item, episode.others)],
        "words": item["task"],
        "start": episode.start,
        "target": {"yaw": item["yaw"], "pitch": pitch},
        "score": scores[scoring],
        "scores": scores,
        "cause": cause,
        "reason": reason,
        "answer": answer,
        **errors,
    }


def cause_of(
    item: Mapping[str, Any],
    steps: Sequence[Mapping[str, Any]],
    at: tuple[float, float],
    others: Sequence[Mapping[str, Any]],
    scoring: Scoring,
) -> str:
    """The cause of a failure of an answer `at` (yaw, pitch), one of `CAUSES`.

    `item` and `others` are entries of annotation.json, the target and the rest of its scene; `steps`: of the record.
    """
    same = [other for other in others if head_of(other["task"]) == head_of(item["task"])]
    if any(window_of(other).contains(*at, "strict") for other in same):
        return "wrong_instance"
    if any((step.get("would") or {}).get(scoring) for step in steps):
        return "stopped_wrongly"
    if all(step["shown"] == 0 for step in steps):
        return "never_in_view"
    peaks = [step["peak"] for step in steps if "peak" in step]
    if not peaks:
        return "false_detection"
    loud = [(peak["yaw"], peak["pitch"]) for peak in peaks if peak["score"] >= RESPONDS]
    if any(window_of(item).contains(*peak, "strict") for peak in loud):
        return "fusion_error"
    return "false_detection" if any(_apart(peak, at) <= NEAR for peak in loud) else "missed"


def _apart(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Degrees between two directions (yaw, pitch) on the great circle."""
    ends = direction_from_hstar(*np.array([a, b], dtype=np.float64).T)
    return float(np.degrees(angular_distance(ends[0], ends[1])))
