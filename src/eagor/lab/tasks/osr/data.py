"""OSR-Bench's published files, and the parser of their questions.

``<scene>/rgb.png``, ``<scene>/cognitive_map.json`` and ``<scene>/<scene>_<suffix>.json`` with a suffix of `SUFFIXES`,
at any depth below the given folder. The hosted edition has the questions in ``qa.csv`` (columns image_id, turn_id,
question, answer and, optionally, skills_tested), which is read too. Questions with an empty answer are left out, as the
benchmark's authors do.
"""

from __future__ import annotations

import ast
import csv
import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any, Literal, get_args

import msgspec

from eagor._checks import shown
from eagor._values import lazy
from eagor.errors import FormatError
from eagor.lab.tasks.osr import COUNTING, DIRECTION, DISTANCE, MAP, SKILLS, Grid, layout_of, swapped
from eagor.lab.tasks.published import read_json

Suffix = Literal["qa_without_cogmap", "qa", "qa_with_negative", "qa_with_negative_without_cogmap"]
SUFFIXES: tuple[Suffix, ...] = get_args(Suffix)
WITHOUT = "_without_cogmap"
FAULT = "cannot be read as JSON of OSR-Bench"
# The text of each kind of question, with names of things in groups, the last of several separated by commas.
_WORDS = {
    DIRECTION: r"standing by the (.+?) and facing the closest (.+?), is the closest (.+?) to my front",
    DISTANCE: r"which of these objects \(([^)]*)\) is the closest to the (.+?) in this PANO",
    MAP: r"in this scene: \{([^}]*)\}",
    COUNTING: r"How many (.+?)\(s\) are in this room",
}


class Turn(msgspec.Struct):
    """A question as published; the answer of a map is its grid, as text in a table."""

    question: str
    answer: str | int | Grid | None
    turn_id: int | None = None  # None: its place among the turns
    skills_tested: str | None = None


class _Conversation(msgspec.Struct):
    conversation: list[Turn]
    image_id: str = ""


class _Map(msgspec.Struct):
    cognitive_map: Grid


@dataclass(frozen=True)
class Question:
    """One question about a picture, with the published answer: text, or a map's grid; `id` as "scene/qa/18"."""

    id: str
    skill: str
    text: str
    answer: Any

    @property
    def names(self) -> tuple[str, ...]:
        """The names in it; empty if the text is not the benchmark's.

        The category counted; the category and then the choices; P, O and Q; or all categories of the map.
        """
        found = re.search(_WORDS[self.skill], self.text)
        if not found or self.skill in (COUNTING, DIRECTION):
            return found.groups() if found else ()
        return (*found.groups()[1:], *(name for part in found[1].split(",") if (name := part.strip())))

    def truth(self, labels: str) -> Any:
        """The answer according to the labels "official" or "corrected": left and right as they are in the room."""
        if labels == "official":
            return self.answer
        if self.skill == MAP:
            return [row[::-1] for row in self.answer]
        return swapped(self.answer) if self.skill == DIRECTION else self.answer


@dataclass(frozen=True, eq=False)
class Scene:
    """One picture and its questions. `image` is None without a picture; `skipped` questions had no answer."""

    id: str
    folder: Path
    image: Path | None
    questions: tuple[Question, ...]
    skipped: int

    @lazy
    def categories(self) -> tuple[str, ...]:
        """All names in the questions, in order of first appearance."""
        return tuple(dict.fromkeys(name for question in self.questions for name in question.names))

    @lazy
    def layout(self) -> dict[str, list[list[int]]] | None:
        """The published layout, None if the folder has none. Raises `FormatError` if it is malformed."""
        path = self.folder / "cognitive_map.json"
        if path.is_file():
            return layout_of(read_json(path, _Map, FAULT).cognitive_map)
        return None if self.map_question is None else layout_of(self.map_question.answer)

    @property
    def picture(self) -> Path:
        """`image`. Raises `FormatError` if there is none."""
        if self.image is None:
            raise FormatError(f"the scene {self.id} has no picture (rgb.png); the data set is incomplete")
        return self.image

    @property
    def map_question(self) -> Question | None:
        """The first question that asks for the map; None if this kind of file has none."""
        return next((question for question in self.questions if question.skill == MAP), None)


def load(data: Path, suffix: str = SUFFIXES[0]) -> tuple[Scene, ...]:
    """All scenes with questions of this kind of file (of `SUFFIXES`) in `data`, by name.

    If there are only files with the map's question, files without it are derived from them (the questions are the
    same). Raises `FormatError` if there are none, or one cannot be read.
    """
    plain, scenes = suffix.removesuffix(WITHOUT), list[Scene]()
    files = list(data.rglob(f"*_{suffix}.json"))
    have = {path.parent for path in files}
    for path in [*files, *(path for path in data.rglob(f"*_{plain}.json") if path.parent not in have)]:
        found = read_json(path, _Conversation, FAULT)
        scenes.append(_scene(found.conversation, found.image_id, path.parent.name, path.parent, suffix, path))
    for path in data.rglob("qa.csv") if plain == "qa" and not scenes else ():
        for image_id, turns in _table(path).items():  # a scene for each picture
            place = PurePosixPath(image_id)
            name = place.parent.name or place.stem
            scenes.append(_scene(turns, image_id, name, path.parent / place.parent, suffix, path))
    if not scenes:
        there = sorted(kind for kind in SUFFIXES if any(data.rglob(f"*_{kind}.json")))
        hint = f"it has files of the kind {', '.join(there)}: choose one with --set suffix=KIND"
        raise FormatError(f"{data} has no <scene>_{suffix}.json and no qa.csv; {hint if there else 'is it OSR-Bench?'}")
    scenes.sort(key=lambda scene: scene.id)
    for scene, other in pairwise(scenes):
        if scene.id == other.id:
            raise FormatError(f"{data} has several scenes {scene.id!r}; give the folder of one copy of the data")
    return tuple(scenes)


@lru_cache(maxsize=2)
def questions_of(data: str, suffix: str) -> dict[str, tuple[Scene, Question]]:
    """The questions that `load` finds, and their scenes, by id; cached, since workers ask for each picture."""
    return {question.id: (scene, question) for scene in load(Path(data), suffix) for question in scene.questions}


def _scene(turns: Sequence[Turn], image_id: str, name: str, folder: Path, suffix: str, path: Path) -> Scene:
    """The scene in `folder` with those questions in the file `path` that have an answer."""
    found: list[Question] = []
    skipped, taken = 0, Counter[int]()
    for place, turn in enumerate(turns):
        skill = turn.skills_tested or next((s for s, words in _WORDS.items() if re.search(words, turn.question)), None)
        if skill not in SKILLS:
            raise FormatError(
                f"{path}, {shown(turn.question)}: the skill is {shown(skill)}; known are {', '.join(SKILLS)}"
            )
        if skill == MAP and suffix.endswith(WITHOUT):
            continue
        if turn.answer is None or turn.answer == "":
            skipped += 1
            continue
        number = place if turn.turn_id is None else turn.turn_id
        taken[number] += 1
        again = f"-{taken[number]}" if taken[number] > 1 else ""
        answer = _grid(turn.answer, path) if skill == MAP else str(turn.answer)
        found.append(Question(f"{name}/{suffix}/{number}{again}", skill, turn.question, answer))
    pictures = [folder / "rgb.png", *(above / image_id for above in (folder, *folder.parents[:3]))]
    image = next((picture for picture in pictures if os.path.isfile(picture)), None)  # False for invalid names
    return Scene(name, folder, image, tuple(found), skipped)


def _grid(answer: str | int | Grid, path: Path) -> Grid:
    """A map's grid; in tables it is text."""
    try:
        return msgspec.convert(ast.literal_eval(answer) if isinstance(answer, str) else answer, Grid)
    except (ValueError, SyntaxError, MemoryError, RecursionError, msgspec.ValidationError) as error:
        raise FormatError(f"{path}: the map is {shown(answer)}; wanted rows of lists of names ({error})") from None


def _table(path: Path) -> dict[str, list[Turn]]:
    """The turns in a table, by picture."""
    turns: dict[str, list[Turn]] = {}
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            for row in csv.DictReader(file, restkey=""):
                turns.setdefault(row["image_id"], []).append(msgspec.convert(row, Turn, strict=False))
    except (OSError, UnicodeError, csv.Error, KeyError, msgspec.ValidationError) as error:
        raise FormatError(f"{path} cannot be read as CSV with image_id, question and answer ({error})") from None
    return turns
