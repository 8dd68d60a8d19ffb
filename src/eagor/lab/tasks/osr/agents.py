"""The agents of OSR-Bench, `eagor` from geometry, a model, and reference agents; and the record of an answer.

The questions are the data's own. The published runner puts a sentence before a question without a map, and instructions
for the form of the answer after it: "vanilla" (brief) or "think" (reasoning and answer between tags). Ours are worded
differently but ask for the same: the same tags, the same eight directions, an integer, a name, or "the exact error
message if applicable" without saying which messages there are.
"""

from __future__ import annotations

import json
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from eagor._values import lazy
from eagor.errors import EagorError
from eagor.lab.agents.models import shared_chat
from eagor.lab.tasks.osr.data import Question, Scene, load
from eagor.lab.tasks.osr.detections import Detector, SceneDetections, open_detector
from eagor.lab.tasks.osr.geometry import (
    SURE,
    LayoutSamples,
    Placed,
    direction_between,
    draw,
    layout_from,
    nearest,
    place,
    place_on_circle,
)
from eagor.lab.tasks.osr.scoring import (
    COUNTING,
    DIRECTION,
    DIRECTIONS,
    DISTANCE,
    ERRORS,
    MAP,
    NO_CANDIDATE,
    NO_OBJECT,
    NO_POSITION,
    NOT_UNIQUE,
    Layout,
    extracted,
    is_direction,
    is_tied,
    layout_of,
    lenient,
    products,
    score,
    score_map,
    steps,
    swapped,
)
from eagor.lab.tasks.published import case_seed
from eagor.perception.vlm import IMAGE, Chat, Message

FORMS = ("vanilla", "think")

_BEFORE = "Answer this question about the PANORAMA, using where the centers of its objects are:"
_DIRECTIONS = "front, back, left, right, front-left, front-right, back-left or back-right"
_RULES = (
    "- how many: one integer, 0 if there are none;\n"
    "- which is the closest: the name of that object alone, or the exact error message if one applies;\n"
    f"- in which direction: one of {_DIRECTIONS}, or the exact error message if one applies."
)
_AFTER = {
    "vanilla": f"Keep the answer brief, without explanation or any other text. It is for questions that ask\n{_RULES}",
    "think": (
        "Think step by step and put all of your reasoning between <think> and </think>. To count, find the objects one "
        "by one; for the closest, find the object and every candidate and compare the distances; for a direction, "
        "locate all objects that are named and work out how they lie to each other. Then give the final answer, and "
        f"nothing else, between <answer> and </answer>. It is for questions that ask\n{_RULES}"
    ),
}
AGENTS = {
    "eagor": "bearings from a belief, ranges from floor contacts, and geometry",
    "vlm": "asks the model, with the map or without it (--set suffix=...)",
    "constant": "gives the same answer to every question of a kind",
    "majority": "gives the most frequent right answer of the other scenes",
    "random": "draws a random answer of the right form",
    "oracle": "knows the label (the official one, if both are asked for)",
}
LOOKING = ("eagor",)
TITLES = {COUNTING: "Counting", DISTANCE: "Distance", DIRECTION: "Direction", MAP: "Map"}


@dataclass(frozen=True)
class Reply:
    """An answer for scoring; `stated`: the agent's probability that it is right; and notes for the record."""

    text: str
    stated: float | None = None
    notes: dict[str, Any] = field(default_factory=dict)


# Answers one question about one scene. Raises if there is no reply: a failed attempt is not a wrong answer.
Agent = Callable[[Scene, Question], Reply]


def map_text(layout: Layout) -> str:
    """A layout in the benchmark's format: {"name": [[x, y], ...]}, x the column and y the row."""
    return json.dumps({name: [[column, row] for row, column in where] for name, where in layout.items()})


def oracle(labels: str, scene: Scene, question: Question) -> Reply:
    """Answers with the label."""
    truth = question.truth(labels)
    return Reply(map_text(layout_of(truth)) if question.skill == MAP else str(truth))


def constant(negative: bool, scene: Scene, question: Question) -> Reply:
    """A fixed answer, without looking; with absent categories (`negative`), that something is absent."""
    if question.skill == MAP:
        return Reply(map_text({name: [[5, 5]] for name in question.names or scene.categories}))
    if question.skill == DIRECTION:
        return Reply(NO_OBJECT if negative else "Front Left")
    if question.skill == DISTANCE:
        return Reply(question.names[1] if len(question.names) > 1 else NO_CANDIDATE)
    return Reply("1")


def random(seed: int, scene: Scene, question: Question) -> Reply:
    """Draws an answer; the same for the same question and seed."""
    rng = np.random.default_rng(case_seed(seed, question.id))
    if question.skill == MAP:
        names = question.names or scene.categories
        return Reply(map_text({name: [rng.integers(0, 10, 2).tolist()] for name in names}))
    if question.skill == DISTANCE and len(question.names) > 1:
        return Reply(str(rng.choice(question.names[1:])))
    return Reply(str(rng.integers(0, 6) if question.skill == COUNTING else rng.choice(DIRECTIONS)))


@dataclass(frozen=True, eq=False)
class Majority:
    """The most frequent answer to such questions in the other scenes; for choices, the likeliest choice."""

    scenes: Sequence[Scene]
    labels: str = "official"
    negative: bool = False

    def __call__(self, scene: Scene, question: Question) -> Reply:
        answers = self._counts[question.skill].copy()
        answers.subtract(
            str(each.truth(self.labels)) for each in scene.questions if each.skill == question.skill != MAP
        )
        choices = {*question.names[1:], NO_CANDIDATE} if question.skill == DISTANCE else {*answers}
        ranked = sorted((-count, answer) for answer, count in answers.items() if count > 0 and answer in choices)
        return Reply(ranked[0][1]) if ranked else constant(self.negative, scene, question)

    @lazy
    def _counts(self) -> dict[str, Counter[str]]:
        """How often each answer is right, by skill."""
        counts: dict[str, Counter[str]] = {skill: Counter() for skill in TITLES}
        for question in (question for scene in self.scenes for question in scene.questions if question.skill != MAP):
            counts[question.skill][str(question.truth(self.labels))] += 1
        return counts


class Vlm:
    """Asks a model as the benchmark's runner does; if the scene asks for a map, after the model has drawn it."""

    def __init__(self, chat: Chat, form: str = "vanilla") -> None:
        self._chat, self._form = chat, form
        self._drawn: tuple[str, list[Message], str] | None = None  # the last scene's map, which is asked for once

    def __call__(self, scene: Scene, question: Question) -> Reply:
        mapped, text = scene.map_question, f"{question.text} {_AFTER[self._form]}"
        if mapped is None:
            return Reply(self._chat([_with_picture(f"{_BEFORE} {text}", scene)]).text)
        if self._drawn is None or self._drawn[0] != scene.id:
            request = _with_picture(mapped.text, scene)
            self._drawn = scene.id, [request], self._chat([request]).text
        _, requests, drawn = self._drawn
        if question.skill == MAP:
            return Reply(drawn)
        messages = [*requests, Message("assistant", drawn), Message("user", text)]
        return Reply(self._chat(messages).text, notes={"map": drawn})


def _with_picture(text: str, scene: Scene) -> Message:
    from eagor.media.panorama import read_panorama

    return Message("user", f"{text}\n{IMAGE}", (read_panorama(scene.picture),))


@dataclass(frozen=True, eq=False)
class SceneLayout:
    """One scene as seen: things on the floor, and layouts drawn from them."""

    scene: str
    seen: SceneDetections
    placed: tuple[Placed, ...]
    samples: LayoutSamples

    def members(self, name: str) -> list[int]:
        """The things of this name, the likeliest first."""
        found = [k for k, each in enumerate(self.placed) if each.name == name]
        return sorted(found, key=lambda k: -self.placed[k].weight)

    def notes(self, names: Sequence[str]) -> dict[str, Any]:
        """Where the things with these names were seen and placed."""
        found = [
            {
                "name": name,
                "azimuth_deg": round(float(np.degrees(self.seen.things[k].azimuth)), 1),
                "elevation_deg": round(float(np.degrees(self.seen.things[k].elevation)), 1),
                "xy": [round(value, 2) for value in self.placed[k].xy],
                "range_from": self.placed[k].source,
            }
            for name in dict.fromkeys(names)
            for k in self.members(name)
        ]
        notes: dict[str, Any] = {"things": found}
        if any(each["range_from"] not in SURE for each in found):
            notes["guessed"] = True
        if unknown := [name for name in names if name in self.seen.unknown_queries]:
            notes["strange"] = unknown
        return notes


def sample_layout(scene: str, seen: SceneDetections, ranges: str = "floor", seed: int = 0) -> SceneLayout:
    """The things seen in this scene, placed on the floor and drawn as layouts; `ranges` as in `Eagor`."""
    if ranges == "unit":
        seen = replace(seen, walls=None)
    placed = place_on_circle(seen.things) if ranges == "unit" else place(seen.things, seen.height, seen.walls)
    return SceneLayout(
        scene, seen, tuple(placed), draw(placed, seen.walls, np.random.default_rng(case_seed(seed, scene)))
    )


class Eagor:
    """Answers from the geometry of what `look` sees.

    - `reading`: "cells": the likeliest label under the benchmark's rounding (`eagor.lab.tasks.osr.geometry`); "metres":
      from the places as they are; "auto": cells if the foot of the walls is known, otherwise metres (the layout's axes
      are then unknown, and guessing them costs more than rounding does).
    - `ranges`: "floor" or "depth": as `place` computes them, with depth values if the detector gives any; "unit": all
      things at the same distance, which is all that directions alone can tell.
    - `negative`: whether questions may ask about absent things; only then does it answer with errors.
    """

    def __init__(
        self, look: Detector, reading: str = "auto", ranges: str = "floor", negative: bool = False, seed: int = 0
    ) -> None:
        self._look, self._reading, self._ranges, self._negative, self._seed = look, reading, ranges, negative, seed
        self._kept: SceneLayout | None = None

    def __call__(self, scene: Scene, question: Question) -> Reply:
        around, skill, names = self.around(scene), question.skill, question.names
        count = Counter(each.name for each in around.placed)
        if skill == MAP:
            places = {name: [around.placed[k].xy for k in around.members(name)] for name in names or scene.categories}
            return Reply(map_text(layout_from({name: where for name, where in places.items() if where})))
        if not names:
            return Reply(_guess(question), None, {"problem": "the question was not understood"})
        notes, first = around.notes(names), count[names[0]]
        if skill == COUNTING:
            return Reply(str(first), None, notes)
        enough = (all if skill == DIRECTION else any)(count[name] for name in names[1:])  # O and Q; one of the choices
        if self._negative and not (first == 1 and enough):
            missing = NO_OBJECT if skill == DIRECTION else NO_CANDIDATE
            return Reply(NOT_UNIQUE if first > 1 else missing if first else NO_POSITION, None, notes)
        if not (first and enough):
            notes["problem"] = "not seen: " + ", ".join(name for name in names if not count[name])
            return Reply(_guess(question), None, notes)
        if skill == DIRECTION:
            found, stated, shares = self.where(around, *names)
            notes["shares"] = {word: round(share, 3) for word, share in list(shares.items())[:4]}
            return Reply(found or _guess(question), stated, notes)
        return Reply(*self._closest(around, names[0], names[1:]), notes)

    def around(self, scene: Scene) -> SceneLayout:
        """The scene as seen: looked at once, for all names in its questions."""
        if self._kept is None or self._kept.scene != scene.id:
            self._kept = sample_layout(scene.id, self._look(scene, scene.categories), self._ranges, self._seed)
        return self._kept

    def where(self, around: SceneLayout, P: str, O: str, Q: str) -> tuple[str, float | None, dict[str, float]]:
        """The direction of the nearest Q from P facing the nearest O; its probability; and the share of each label.

        All three must be there; of several P the likeliest is taken.
        """
        start, facing, asked = around.members(P)[0], around.members(O), around.members(Q)
        shares, placed = around.samples.directions(start, facing, asked), around.placed
        plain = direction_between(placed[start], [placed[k] for k in facing], [placed[k] for k in asked])
        return *self._chosen(around, plain, shares), shares

    def _closest(self, around: SceneLayout, name: str, choices: Sequence[str]) -> tuple[str, float | None]:
        start, placed = around.members(name)[0], around.placed
        groups = {name: members for name in choices if (members := around.members(name))}
        plain = nearest(placed[start], [placed[k] for members in groups.values() for k in members]).name
        return self._chosen(around, plain, around.samples.nearest(start, groups))

    def _chosen(self, around: SceneLayout, plain: str, shares: dict[str, float]) -> tuple[str, float | None]:
        """The answer from the places as they are, or that of most layouts, and its share."""
        rounded = self._reading == "cells" or (self._reading == "auto" and around.seen.walls is not None)
        best = max(shares, key=lambda word: (shares[word], word == plain)) if rounded and shares else plain
        return best, shares.get(best)


def _guess(question: Question) -> str:
    """An answer about things that were not seen: ahead, on either side; the first choice; none."""
    if question.skill == DIRECTION:
        return ("Front Left", "Front Right")[zlib.crc32(question.id.encode()) % 2]
    return question.names[1] if question.skill == DISTANCE and len(question.names) > 1 else "0"


def work(settings: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function for one case: payload {"scene", "question"} (ids) -> record. Made once per process."""
    scenes = {scene.id: scene for scene in load(Path(settings["data"]), settings["suffix"])}
    agent = open_agent(settings, tuple(scenes.values()))

    def do(payload: Mapping[str, Any]) -> dict[str, Any]:
        scene = scenes[payload["scene"]]
        question = scene.by_id[payload["question"]]
        return score_reply(scene, question, agent(scene, question), settings)

    return do


def open_agent(settings: Mapping[str, Any], scenes: tuple[Scene, ...]) -> Agent:
    """The agent of these settings. Raises `EagorError` if it does not exist or cannot be made."""
    name, seed, negative = settings["agent"], settings["seed"], "with_negative" in settings["suffix"]
    labels = "corrected" if settings["labels"] == "corrected" else "official"
    if name == "eagor":
        detector = open_detector(settings["perception"], settings)
        return Eagor(detector, settings["reading"], settings["range"], negative, seed)
    if name == "vlm":
        return Vlm(shared_chat(settings["model"]), settings["prompt"])
    if name == "majority":
        return Majority(scenes, labels, negative)
    blind = {
        "constant": partial(constant, negative),
        "random": partial(random, seed),
        "oracle": partial(oracle, labels),
    }
    if name not in blind:
        raise EagorError(f"osr has no agent {name!r}; it has {', '.join(AGENTS)}")
    return blind[name]


def score_reply(scene: Scene, question: Question, reply: Reply, settings: Mapping[str, Any]) -> dict[str, Any]:
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
        record["map"] = {
            "overall": found.overall, "per_class": found.per_class, "truth": truths[main], "rotation": found.rotation
        }  # fmt: skip
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
        answer, truth = extracted(reply.text, think), str(question.truth(labels))
        if truth not in ERRORS and not is_direction(answer) and answer.strip() not in ERRORS:
            return "format"
        if score(DIRECTION, swapped(truth), answer) and swapped(truth) != truth:
            return "left and right exchanged"
    return "range guessed" if reply.notes.get("guessed") else "wrong"
