"""One episode from its first view to its submission, and the record of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from eagor.conventions import direction_from_hstar
from eagor.perception.calibrated import Calibrated
from eagor.sphere import angular_distance
from eagor.tasks.chat import Chat, shared_chat
from eagor.tasks.eyes import recalibration
from eagor.tasks.hstar.agents import LOOKING, Agent, make_agent
from eagor.tasks.hstar.camera import View, visible_share
from eagor.tasks.hstar.causes import cause_of
from eagor.tasks.hstar.data import Episode
from eagor.tasks.hstar.eyes import Eye, open_eye, open_perception
from eagor.tasks.hstar.rules import MAX_TURNS, SCORINGS, Action, checked_scoring, submit_succeeds, turned, window_of
from eagor.tasks.hstar.search import SearchRules
from eagor.tasks.hstar.talking import VlmAgent
from eagor.tasks.hstar.words import tag_of


def work(settings: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """What a worker does for each episode of a run with these settings; the perception is made once."""
    agent = settings["agent"]
    perception = open_perception(settings["perception"]) if agent in LOOKING else None
    chat = shared_chat(settings["model"]) if agent == "vlm" else None
    calibrated = recalibration(settings)

    def do(payload: Mapping[str, Any]) -> dict[str, Any]:
        episode = Episode.from_json(payload["episode"])
        eye = None
        if perception is not None:
            eye = open_eye(perception, episode, settings["seed"], settings["resolution"])
            eye = _Recalibrated(eye, calibrated) if calibrated else eye
        player = open_agent(episode, settings, eye, chat)
        return play(episode, player, settings["scoring"], settings["turns"], payload.get("siblings", ()))

    return do


def open_agent(episode: Episode, settings: Mapping[str, Any], eye: Eye | None, chat: Chat | None = None) -> Agent:
    """The agent that `settings` name, for one episode."""
    if settings["agent"] == "vlm":
        assert chat is not None
        return VlmAgent(episode, chat, settings["form"], settings["window"], settings["resolution"])
    rules = SearchRules(degree=settings["degree"], sure=settings["sure"])
    return make_agent(settings["agent"], episode, eye, rules, settings["views"], settings["seed"])


def play(
    episode: Episode,
    agent: Agent,
    scoring: str = "official",
    turns: int = MAX_TURNS,
    siblings: Any = (),
) -> dict[str, Any]:
    """The record of one episode; see `eagor.tasks.benchmark.Benchmark` for what every record has.

    Args:
        episode: what is played.
        agent: who plays it.
        scoring: what "score" and "by_turn" go by; "scores" has both.
        turns: views at most; at the last one only a submission makes sense.
        siblings: the scene's other entries of annotation.json, for causes and tags.

    Each step has "turn", "view" (yaw, pitch), "shown" (how much of the target is in view), "action" (as text, None:
    invalid), "would" (what it would submit: yaw, pitch, official, strict, p), "ms", and what the agent noted.
    """
    scoring = checked_scoring(scoring)
    item, view = episode.item, View(float(episode.start), 0.0)
    steps: list[dict[str, Any]] = []
    answer: Action | None = None
    last: dict[str, Any] = {}
    for number in range(1, turns + 1):
        began = time.perf_counter()
        turn = agent.step(view, number == turns)
        last = dict(turn.notes)
        would = None
        if turn.would is not None:
            p = turn.would.probability
            would = {
                "yaw": turn.would.yaw,
                "pitch": turn.would.pitch,
                **{way: submit_succeeds(item, turn.would.yaw, turn.would.pitch, way) for way in SCORINGS},
                "p": None if math.isnan(p) else round(p, 4),
            }
        steps.append(
            {
                "turn": number,
                "view": {"yaw": view.yaw, "pitch": view.pitch},
                "shown": round(visible_share(view, episode.yaw, episode.pitch), 3),
                "action": None if turn.action is None else str(turn.action),
                "would": would,
                "ms": round(1000 * (time.perf_counter() - began), 2),
                **last,
            }
        )
        if turn.action is None:
            continue
        if turn.action.kind == "submit":
            answer = turn.action
            break
        view = View(*map(float, turned(view.yaw, view.pitch, turn.action)))
    submitted = None if answer is None else {"yaw": answer.yaw, "pitch": answer.pitch}
    scores = scores_of(episode, submitted)
    by_turn = [int(bool(step["would"] and step["would"][scoring])) for step in steps]
    by_turn += [int(scores[scoring])] * (turns - len(steps))
    stated = steps[-1]["would"]["p"] if answer is not None and steps[-1]["would"] else None
    return {
        **identity(episode, siblings),
        "scoring": scoring,
        "score": scores[scoring],
        "scores": scores,
        "cause": None if scores[scoring] else cause_of(item, steps, submitted, siblings, scoring),
        "by_turn": by_turn,
        "views": len(steps),
        "stated": stated,
        "sure": bool(last.get("sure", False)) and answer is not None,
        "reason": "submitted" if answer is not None else cause_of(item, steps, None, (), scoring),
        "answer": submitted,
        **errors(episode, submitted),
        "steps": steps,
    }


def identity(episode: Episode, siblings: Any = ()) -> dict[str, Any]:
    """What a record says of its episode."""
    return {
        "case": episode.id,
        "cluster": cluster_of(episode),
        "level": episode.level_name,
        "tags": [tag_of(episode.item, siblings)],
        "words": episode.task,
        "start": episode.start,
        "target": {"yaw": list(episode.yaw), "pitch": None if episode.pitch is None else list(episode.pitch)},
    }


def cluster_of(episode: Episode) -> str:
    """What the four starts of one target share."""
    return f"{episode.scene}/{episode.entry}"


def scores_of(episode: Episode, answer: Mapping[str, Any] | None) -> dict[str, float]:
    """1 or 0 for a submission (None: none) in degrees, by each way of scoring."""
    if answer is None:
        return dict.fromkeys(SCORINGS, 0.0)
    return {way: float(submit_succeeds(episode.item, answer["yaw"], answer["pitch"], way)) for way in SCORINGS}


def errors(episode: Episode, answer: Mapping[str, Any] | None) -> dict[str, float | None]:
    """Degrees between the submission and the middle of the target: in yaw, in pitch, and on the great circle."""
    if answer is None:
        return {"yaw_error": None, "pitch_error": None, "error": None}
    yaw, pitch = window_of(episode.item).centre
    turn = abs((answer["yaw"] - yaw + 180.0) % 360.0 - 180.0)
    ends = direction_from_hstar(np.array([answer["yaw"], yaw]), np.array([answer["pitch"], pitch]))
    apart = float(np.degrees(angular_distance(ends[0], ends[1])))
    lift = None if episode.pitch is None else round(abs(answer["pitch"] - pitch), 2)
    return {"yaw_error": round(turn, 2), "pitch_error": lift, "error": round(apart, 2)}


class _Recalibrated:
    """An eye whose evidence is read with another calibration or detector."""

    def __init__(self, eye: Eye, calibrated: Calibrated) -> None:
        self._eye, self._calibrated = eye, calibrated

    def look(self, view: View) -> Any:
        look = self._eye.look(view)
        return replace(look, evidence=self._calibrated.reread(look.evidence))
