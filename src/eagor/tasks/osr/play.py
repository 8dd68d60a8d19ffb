"""Answers and scores one question of OSR-Bench: the work of a worker."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from eagor.errors import EagorError
from eagor.tasks.models import shared_chat
from eagor.tasks.osr.agents import AGENTS, Agent, Eagor, Majority, Reply, Vlm, constant, oracle, random
from eagor.tasks.osr.data import Question, Scene, load
from eagor.tasks.osr.layout import ERRORS, is_tied, products, steps, swapped
from eagor.tasks.osr.looking import open_looker
from eagor.tasks.osr.scoring import (
    COUNTING,
    DIRECTION,
    DISTANCE,
    MAP,
    extracted,
    is_direction,
    lenient,
    score,
    score_map,
)

TITLES = {COUNTING: "Counting", DISTANCE: "Distance", DIRECTION: "Direction", MAP: "Map"}


def work(settings: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function for one case: payload {"scene", "question"} (ids) -> record. Made once per process."""
    scenes = {scene.id: scene for scene in load(Path(settings["data"]), settings["suffix"])}
    agent = open_agent(settings, tuple(scenes.values()))

    def do(payload: Mapping[str, Any]) -> dict[str, Any]:
        scene = scenes[payload["scene"]]
        question = scene.by_id[payload["question"]]
        return judged(scene, question, agent(scene, question), settings)

    return do


def open_agent(settings: Mapping[str, Any], scenes: tuple[Scene, ...]) -> Agent:
    """The agent of these settings. Raises `EagorError` if it does not exist or cannot be made."""
    name, seed, negative = settings["agent"], settings["seed"], "with_negative" in settings["suffix"]
    labels = "corrected" if settings["labels"] == "corrected" else "official"
    makers: dict[str, Callable[[], Agent]] = {
        "eagor": lambda: Eagor(
            open_looker(settings["perception"], settings), settings["reading"], settings["range"], negative, seed
        ),
        "vlm": lambda: Vlm(shared_chat(settings["model"]), settings["prompt"]),
        "constant": lambda: partial(constant, negative),
        "majority": lambda: Majority(scenes, labels, negative),
        "random": lambda: partial(random, seed),
        "oracle": lambda: partial(oracle, labels),
    }
    if name not in makers:
        raise EagorError(f"osr has no agent {name!r}; it has {', '.join(AGENTS)}")
    return makers[name]()


def judged(scene: Scene, question: Question, reply: Reply, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The record of a reply."""
    skill, think = question.skill, settings["prompt"] == "think"
    wanted = ("official", "corrected") if settings["labels"] == "both" else (settings["labels"],)
    truths = {labels: question.truth(labels) for labels in wanted}
    scores = {labels: score(skill, truth, reply.text, think) for labels, truth in truths.items()}
    main = wanted[0]
    record: dict[str, Any] = {
        "case": question.id,
        "cluster": scene.id,
        "score": scores[main],
        "scores": scores,
        "skill": skill,
        "level": TITLES[skill],
        "question": question.text,
        "tags": tags(scene, question),
        "answer": reply.text,
        "cause": cause(question, reply, main, think) if scores[main] < 1 else None,
    }
    if skill == MAP:
        found = score_map(truths[main], reply.text)
        record["map"] = found.as_published() | {"truth": truths[main], "rotation": found.rotation}
        record["map_range"] = {"least": found.f1, "most": found.f1_most}
    else:
        record["truth"] = truths[main]
        record["lenient"] = {labels: lenient(skill, truth, reply.text) for labels, truth in truths.items()}
    if reply.stated is not None:
        record["stated"] = reply.stated
    if reply.notes:
        record["steps"] = [reply.notes]
    return record


def tags(scene: Scene, question: Question) -> list[str]:
    """What makes a question hard, known before it is asked; only direction questions have any.

    "absent": the label says that something is absent; "near a border": the dot or the cross product is at most one
    squared cell, otherwise "clear"; "tied": several things are equally near; "several": several things have the name.
    """
    if question.skill != DIRECTION:
        return []
    if question.answer in ERRORS:
        return ["absent"]
    layout, names = scene.layout, question.names
    found = steps(layout, *names) if layout is not None and len(names) == 3 else ""
    if layout is None or isinstance(found, str):
        return []
    kinds = ["clear" if min(map(abs, products(*found))) > 1 else "near a border"]
    kinds += ["tied"] if any(is_tied(layout, names[0], name) for name in names[1:]) else []
    kinds += ["several"] if any(len(layout[name]) > 1 for name in names[1:]) else []
    return kinds


def cause(question: Question, reply: Reply, labels: str, think: bool) -> str:
    """The cause of a wrong answer."""
    if reply.notes.get("problem"):
        return "missed"
    if question.skill == DIRECTION:
        said, truth = extracted(reply.text, think), str(question.truth(labels))
        if truth not in ERRORS and not is_direction(said) and said.strip() not in ERRORS:
            return "format"
        if score(DIRECTION, swapped(truth), said) and swapped(truth) != truth:
            return "left and right exchanged"
    return "range guessed" if reply.notes.get("guessed") else "wrong"
