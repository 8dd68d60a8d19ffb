"""One question of OSR-Bench answered and judged: what a worker does."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from eagor.errors import EagorError
from eagor.tasks.chat import shared_chat
from eagor.tasks.eyes import recalibration, shared
from eagor.tasks.osr.agents import AGENTS, Agent, Constant, Labels, Majority, Oracle, Random, Reply, Vlm
from eagor.tasks.osr.dataset import Scene, load
from eagor.tasks.osr.eyes import BeliefLooker, Looker, TruthLooker
from eagor.tasks.osr.layout import ERRORS, is_tied, products, steps, swapped
from eagor.tasks.osr.ours import Eagor
from eagor.tasks.osr.questions import Question
from eagor.tasks.osr.scoring import COUNTING, DIRECTION, DISTANCE, MAP, extracted, is_direction, lenient, score

TITLES = {COUNTING: "Counting", DISTANCE: "Distance", DIRECTION: "Direction", MAP: "Map"}
TRUTH = "truth"


def work(settings: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """What does one case: payload {"scene", "question"} (ids) -> record. Made once per process."""
    scenes = {scene.id: scene for scene in load(Path(settings["data"]), settings["suffix"])}
    agent = open_agent(settings, tuple(scenes.values()))

    @cache
    def questions(scene: str) -> dict[str, Question]:
        return {question.id: question for question in scenes[scene].questions}

    def do(payload: Mapping[str, Any]) -> dict[str, Any]:
        scene = scenes[payload["scene"]]
        question = questions(scene.id)[payload["question"]]
        return judged(scene, question, agent.answer(scene, question), settings)

    return do


def open_agent(settings: Mapping[str, Any], scenes: tuple[Scene, ...]) -> Agent:
    """The agent of these settings. Raises `EagorError` if there is no such agent, or it cannot be made."""
    name, negative = settings["agent"], "with_negative" in settings["suffix"]
    labels: Labels = "corrected" if settings["labels"] == "corrected" else "official"
    if name == "eagor":
        look = open_looker(settings["perception"], settings)
        return Eagor(look, settings["reading"], settings["range"], negative, settings["seed"])
    if name == "vlm":
        return Vlm(shared_chat(settings["model"]), settings["prompt"])
    made: dict[str, Agent] = {
        "constant": Constant(negative),
        "majority": Majority(scenes, labels, negative),
        "random": Random(settings["seed"]),
        "oracle": Oracle(labels),
    }
    if name not in made:
        raise EagorError(f"osr has no agent {name!r}; it has {', '.join(AGENTS)}")
    return made[name]


def open_looker(perception: str, settings: Mapping[str, Any]) -> Looker:
    """What looks: truth (true places, where the data has them; truth:outline without feet), or any perception."""
    name, _, how = perception.partition(":")
    if name == TRUTH:
        if how not in ("", "exact", "outline"):
            raise EagorError(f"perception {perception!r}; wanted truth, truth:exact or truth:outline for osr")
        return TruthLooker(exact=how != "outline")
    depth, calibrated = settings["range"] == "depth", recalibration(settings)
    return BeliefLooker(shared(perception), settings["degree"], settings["camera_height"], depth, calibrated)


def judged(scene: Scene, question: Question, reply: Reply, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The record of a reply."""
    think = settings["prompt"] == "think"
    wanted = ("official", "corrected") if settings["labels"] == "both" else (settings["labels"],)
    scores = {labels: score(question.skill, question.truth(labels), reply.text, think) for labels in wanted}
    main = wanted[0]
    record: dict[str, Any] = {
        "case": question.id,
        "cluster": scene.id,
        "score": scores[main],
        "scores": scores,
        "skill": question.skill,
        "level": TITLES[question.skill],
        "question": question.text,
        "tags": tags(scene, question),
        "answer": reply.text,
        "cause": None,
    }
    if question.skill != MAP:
        truths = {labels: question.truth(labels) for labels in wanted}
        record["truth"] = truths[main]
        record["lenient"] = {labels: lenient(question.skill, truth, reply.text) for labels, truth in truths.items()}
    if scores[main] < 1:
        record["cause"] = cause(question, reply, main, think)
    if reply.stated is not None:
        record["stated"] = reply.stated
    if reply.notes:
        record["steps"] = [reply.notes]
    return record


def tags(scene: Scene, question: Question) -> list[str]:
    """What makes a question hard, known before it is asked; direction questions alone have any.

    "absent": the label says that something is not there; "near a border": the dot or the cross product is at most one
    squared cell; "tied": several things are equally near; "several": more than one thing has the name.
    """
    if question.skill != DIRECTION:
        return []
    if question.answer in ERRORS:
        return ["absent"]
    layout = scene.layout
    if layout is None or len(question.names) != 3:
        return []
    found = steps(layout, *question.names)
    if isinstance(found, str):
        return []
    kinds = ["clear" if min(map(abs, products(*found))) > 1 else "near a border"]
    kinds += ["tied"] if any(is_tied(layout, question.names[0], name) for name in question.names[1:]) else []
    kinds += ["several"] if any(len(layout[name]) > 1 for name in question.names[1:]) else []
    return kinds


def cause(question: Question, reply: Reply, labels: str, think: bool) -> str:
    """Why the answer is not right."""
    if reply.notes.get("problem"):
        return "missed"
    if question.skill == DIRECTION:
        said = extracted(reply.text, think)
        truth = str(question.truth(labels))
        if truth not in ERRORS and not is_direction(said) and said.strip() not in ERRORS:
            return "format"
        if score(DIRECTION, swapped(truth), said) and swapped(truth) != truth:
            return "left and right exchanged"
    if reply.notes.get("guessed"):
        return "range guessed"
    return "wrong"
