"""Who answers the questions of OSR-Bench."""

from __future__ import annotations

import json
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np

from eagor.tasks.chat import Chat, Message
from eagor.tasks.osr.dataset import Scene
from eagor.tasks.osr.layout import DIRECTIONS, NO_CANDIDATE, NO_OBJECT, NO_POSITION, NOT_UNIQUE, layout_of
from eagor.tasks.osr.prompts import Form, map_turn, next_turn, plain_turn
from eagor.tasks.osr.questions import Question
from eagor.tasks.osr.scoring import COUNTING, DIRECTION, DISTANCE, MAP

Labels = Literal["official", "corrected"]
AGENTS = {
    "eagor": "bearings from a belief, ranges from floor contacts, and geometry",
    "vlm": "asks the model, with the map or without it (--set suffix=...)",
    "constant": "says the same to every question of a kind",
    "majority": "says what is most often right in the other scenes",
    "random": "draws an answer of the right form",
    "oracle": "knows the label (the official one, where both are asked for)",
}
LOOKING = ("eagor",)


@dataclass(frozen=True)
class Reply:
    """An answer as it is scored; `stated`: the probability that it is right, by who gave it; and notes on how."""

    text: str
    stated: float | None = None
    notes: dict[str, Any] = field(default_factory=dict)


class Agent(Protocol):
    """Answers one question about one scene."""

    def answer(self, scene: Scene, question: Question) -> Reply:
        """The reply. Raises where there is none: that is a failed attempt, never a wrong answer."""
        ...


@dataclass(frozen=True)
class Oracle:
    """Says the label."""

    labels: Labels = "official"

    def answer(self, scene: Scene, question: Question) -> Reply:
        truth = question.truth(self.labels)
        return Reply(map_text(layout_of(truth)) if question.skill == MAP else str(truth))


@dataclass(frozen=True)
class Constant:
    """Says the likeliest thing without looking; with absent categories about (`negative`), that something is absent."""

    negative: bool = False

    def answer(self, scene: Scene, question: Question) -> Reply:
        if question.skill == MAP:
            return Reply(map_text({name: [[5, 5]] for name in question.names or scene.categories}))
        if question.skill == DIRECTION:
            return Reply(NO_OBJECT if self.negative else "Front Left")
        if question.skill == DISTANCE:
            return Reply(question.names[1] if len(question.names) > 1 else NO_CANDIDATE)
        return Reply("1")


@dataclass(frozen=True, eq=False)
class Majority:
    """Says what is the most frequent answer to such questions in the other scenes; of choices, the likeliest."""

    scenes: Sequence[Scene]
    labels: Labels = "official"
    negative: bool = False
    _counts: dict[str, dict[str, Counter[str]]] = field(default_factory=dict)

    def answer(self, scene: Scene, question: Question) -> Reply:
        if not self._counts:
            for each in self.scenes:
                for other in each.questions:
                    if other.skill != MAP:
                        counts = self._counts.setdefault(other.skill, {}).setdefault(each.id, Counter())
                        counts[str(other.truth(self.labels))] += 1
        told: Counter[str] = Counter()
        for name, counts in self._counts.get(question.skill, {}).items():
            if name != scene.id:
                told.update(counts)
        fits = set(question.names[1:]) | {NO_CANDIDATE} if question.skill == DISTANCE else set(told)
        ranked = sorted((word for word in told if word in fits), key=lambda word: (-told[word], word))
        return Reply(ranked[0]) if ranked else Constant(self.negative).answer(scene, question)


@dataclass(frozen=True)
class Random:
    """Draws an answer; the same for the same question and seed."""

    seed: int = 0

    def answer(self, scene: Scene, question: Question) -> Reply:
        rng = np.random.default_rng([self.seed, zlib.crc32(question.id.encode())])
        if question.skill == MAP:
            return Reply(
                map_text({name: [rng.integers(0, 10, 2).tolist()] for name in question.names or scene.categories})
            )
        if question.skill == DISTANCE and len(question.names) > 1:
            return Reply(str(rng.choice(question.names[1:])))
        if question.skill == COUNTING:
            return Reply(str(rng.integers(0, 6)))
        return Reply(str(rng.choice(DIRECTIONS)))


class Vlm:
    """Asks a model as the benchmark's runner does; where the scene asks for a map, after it has drawn one."""

    def __init__(self, chat: Chat, form: Form = "vanilla") -> None:
        self._chat = chat
        self._form: Form = form
        self._drawn: tuple[str, list[Message], str] | None = None  # the last scene's map: it is asked for once

    def answer(self, scene: Scene, question: Question) -> Reply:
        from eagor.worlds.panorama import read_panorama

        mapped = scene.map_question
        if mapped is None:
            image = read_panorama(scene.picture)
            return Reply(self._chat(plain_turn(question.text, image, self._form)).text)
        if self._drawn is None or self._drawn[0] != scene.id:
            asked = map_turn(mapped.text, read_panorama(scene.picture))
            self._drawn = scene.id, asked, self._chat(asked).text
        _, asked, drawn = self._drawn
        if question.skill == MAP:
            return Reply(drawn)
        return Reply(self._chat(next_turn(asked, drawn, question.text, self._form)).text, notes={"map": drawn})


def map_text(layout: dict[str, list[list[int]]]) -> str:
    """A layout in the form that the benchmark asks for: {"name": [[x, y], ...]}, x the column and y the row."""
    return json.dumps({name: [[column, row] for row, column in where] for name, where in layout.items()})


def error_for(names: Sequence[str], count: Counter[str], skill: str) -> str | None:
    """The error that is the answer where `names` were not seen as the question wants them; None where they were."""
    if count[names[0]] > 1:
        return NOT_UNIQUE
    if not count[names[0]]:
        return NO_POSITION
    if answerable(names, count, skill):
        return None
    return NO_OBJECT if skill == DIRECTION else NO_CANDIDATE


def answerable(names: Sequence[str], count: Counter[str], skill: str) -> bool:
    """Whether enough of `names` was seen: P, O and Q; or the category and one of the choices."""
    enough = all if skill == DIRECTION else any
    return count[names[0]] > 0 and enough(count[name] > 0 for name in names[1:])
