"""Plays one episode, writes its record, and finds the cause of a failure."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from eagor.conventions import direction_from_hstar
from eagor.sphere import angular_distance
from eagor.tasks.hstar.agents import LOOKING, RESPONDS, Agent, VlmAgent, make_agent
from eagor.tasks.hstar.camera import visible_share
from eagor.tasks.hstar.data import Episode
from eagor.tasks.hstar.looking import open_eye, open_perception
from eagor.tasks.hstar.rules import MAX_TURNS, SCORINGS, Scoring, checked_scoring, submit_succeeds, window_of
from eagor.tasks.hstar.search import SearchRules
from eagor.tasks.hstar.words import head_of, tag_of
from eagor.tasks.models import shared_chat
from eagor.tasks.published import reader

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


def work(settings: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that plays each episode of a run with these settings; the perception is made once."""
    agent = settings["agent"]
    perception = open_perception(settings["perception"]) if agent in LOOKING else None
    chat = shared_chat(settings["model"]) if agent == "vlm" else None
    rules, read = SearchRules.of(settings), reader(settings)

    def do(payload: Mapping[str, Any]) -> dict[str, Any]:
        episode, eye = Episode.from_json(payload["episode"]), None
        if perception is not None:
            eye = open_eye(perception, episode, settings["seed"], settings["resolution"], read)
        if chat is not None:
            player: Agent = VlmAgent(episode, chat, settings["form"], settings["window"], settings["resolution"])
        else:
            player = make_agent(agent, episode, eye, rules, settings["views"], settings["seed"])
        return play(episode, player, settings["scoring"], settings["turns"], payload.get("siblings", ()))

    return do


def play(
    episode: Episode, agent: Agent, scoring: str = "official", turns: int = MAX_TURNS, siblings: Any = ()
) -> dict[str, Any]:
    """The record of one episode; see `eagor.tasks.benchmark.Benchmark` for the common keys.

    `scoring` decides "score" and "by_turn" ("scores" has both); `turns`: views at most; `siblings`: the scene's other
    entries of annotation.json, for causes and tags.

    Each step has "turn", "view" (yaw, pitch), "shown" (visible fraction of the target), "action" (as text, None if
    invalid), "would" (its answer at this turn: yaw, pitch, official, strict, p), "ms", and the agent's notes.
    """
    way, view = checked_scoring(scoring), episode.first_view
    steps: list[dict[str, Any]] = []
    answer = None
    while answer is None and len(steps) < turns:
        began = time.perf_counter()
        turn = agent(view, len(steps) + 1 == turns)
        yaw, pitch, p = turn.would.yaw, turn.would.pitch, turn.would.probability
        succeeds = {each: submit_succeeds(episode.item, yaw, pitch, each) for each in SCORINGS}
        steps.append(
            {
                "turn": len(steps) + 1,
                "view": {"yaw": view.yaw, "pitch": view.pitch},
                "shown": round(visible_share(view, episode.yaw, episode.pitch), 3),
                "action": None if turn.action is None else str(turn.action),
                "would": {"yaw": yaw, "pitch": pitch, **succeeds, "p": None if math.isnan(p) else round(p, 4)},
                "ms": round(1000 * (time.perf_counter() - began), 2),
                **turn.notes,
            }
        )
        if turn.action is not None and turn.action.kind == "submit":
            answer = {"yaw": turn.action.yaw, "pitch": turn.action.pitch}
        view = view.after(turn.action)
    record = judged(episode, answer, way, siblings, steps)
    by_turn = [int(step["would"][way]) for step in steps]
    return record | {
        "scoring": way,
        "by_turn": by_turn + [int(record["score"])] * (turns - len(steps)),
        "views": len(steps),
        "stated": steps[-1]["would"]["p"] if answer is not None else None,
        "sure": bool(steps[-1].get("sure", False)) and answer is not None,
        "steps": steps,
    }


def judged(
    episode: Episode,
    answer: Mapping[str, Any] | None,
    scoring: Scoring,
    siblings: Any,
    steps: Sequence[Mapping[str, Any]],
    reason: str | None = None,
) -> dict[str, Any]:
    """The part of a record about the submission (None: none, for the `reason`), with the errors in degrees."""
    scores = dict.fromkeys(SCORINGS, 0.0)
    errors: dict[str, float | None] = {"yaw_error": None, "pitch_error": None, "error": None}
    if answer is not None:
        at = answer["yaw"], answer["pitch"]
        scores = {way: float(submit_succeeds(episode.item, *at, way)) for way in SCORINGS}
        middle = window_of(episode.item).centre
        turn = abs((at[0] - middle[0] + 180.0) % 360.0 - 180.0)
        lift = None if episode.pitch is None else round(abs(at[1] - middle[1]), 2)
        errors = {"yaw_error": round(turn, 2), "pitch_error": lift, "error": round(_apart(at, middle), 2)}
    reason = reason or ("submitted" if answer is not None else cause_of(episode.item, steps, None, (), scoring))
    cause = None
    if not scores[scoring]:
        cause = reason if answer is None else cause_of(episode.item, steps, answer, siblings, scoring)
    return {
        "case": episode.id,
        "cluster": episode.cluster,
        "level": episode.level_name,
        "tags": [tag_of(episode.item, siblings)],
        "words": episode.task,
        "start": episode.start,
        "target": {"yaw": list(episode.yaw), "pitch": None if episode.pitch is None else list(episode.pitch)},
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
    answer: Mapping[str, Any] | None,
    others: Sequence[Mapping[str, Any]],
    scoring: Scoring,
) -> str:
    """The cause of a failure, one of `CAUSES`.

    `item` and `others` are entries of annotation.json, the target and the rest of its scene; `steps` and `answer` (None
    if there was none) are those of the record.
    """
    if answer is None:
        return "format" if any(step.get("valid") is False for step in steps) else "budget"
    at = answer["yaw"], answer["pitch"]
    same = [other for other in others if head_of(str(other["task"])) == head_of(str(item["task"]))]
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
