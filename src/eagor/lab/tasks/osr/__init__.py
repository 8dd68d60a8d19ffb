"""OSR-Bench: questions about one panorama; here its files, the answers that follow from its maps, and its scoring.

A layout lists the cells of each category on a grid of 10 x 10: ``{name: [[row, column], ...]}``; row 0 is at the top.
All answers of the benchmark derive from such a layout (Dongfang et al., arXiv 2505.11907, and the code published with
it), so labels depend on cells, not on metres.

The published layouts are mirrored against the pictures: what lies to the left in the room is drawn to the right. The
published answers follow the layouts, so left and right are exchanged in them. `swapped` gives the answer that is right
in the room.

`score` is the published scorer (`evaluation_re` and the map's score) with one deviation: the published code computes a
map's precision, recall and F1 when it comes to the last category that both maps have, from the categories so far. Their
order is that of a Python set, which differs from process to process unless PYTHONHASHSEED is set. Here all categories
count, which is the least that the published code can give; "most" of `score_map` is the most.

The files are ``<scene>/rgb.png``, ``<scene>/cognitive_map.json`` and ``<scene>/<scene>_<suffix>.json`` with a suffix of
`SUFFIXES`, at any depth. The hosted edition has the questions in ``qa.csv`` (columns image_id, turn_id, question,
answer and, optionally, skills_tested). Questions with an empty answer are left out, as the benchmark's authors do.
"""

from __future__ import annotations

import ast
import csv
import json
import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any, Literal, get_args

import msgspec
import numpy as np

from eagor._checks import parsed, shown
from eagor._values import lazy
from eagor.errors import FormatError
from eagor.lab.tasks.published import answer_in, read_json

__all__ = [
    "SIZE", "SKILLS", "SUFFIXES", "Question", "Scene", "Turn", "cells", "extracted", "layout_of",
    "load", "map_text", "mistake", "named", "products", "questions_of", "ranked", "read_map", "score", "score_map",
    "steps", "swapped", "tags", "turned",
]  # fmt: skip

SIZE = 10  # rows and columns of a layout
Cell = tuple[int, int]
Layout = Mapping[str, Sequence[Sequence[int]]]
Grid = list[list[list[str]]]  # rows of cells, each a list of names, as maps are published
Number = int | float | bool

NO_POSITION = "The positioning object is not found in the picture."
NOT_UNIQUE = "The positioning object is not unique in the picture."
NO_OBJECT = "The orienting object or querying object is not found in the picture."
NO_CANDIDATE = "None of the candidates were found in the picture."
ERRORS = (NO_POSITION, NOT_UNIQUE, NO_OBJECT, NO_CANDIDATE)
DIRECTIONS = ("Front", "Back", "Left", "Right", "Front Left", "Front Right", "Back Left", "Back Right")
COUNTING, DISTANCE, DIRECTION, MAP = "object_counting", "relative_distance", "relative_direction", "cognitive_map"
SKILLS = (COUNTING, DISTANCE, DIRECTION, MAP)
NEAR = 2.0  # cells: a thing of a map is right if it is at most this far from its place
FAR = 15.0  # cells: the mean distance of a map without any match
_SIDES = {"Left": "Right", "Right": "Left"}
_HYPHENS = {f"{a} {b}": f"{a}-{b}" for a in ("front", "back") for b in ("left", "right")}


def steps(layout: Layout, P: str, O: str, Q: str) -> tuple[Cell, Cell] | str:
    """The steps (rows, columns) from P to the nearest O and to the nearest Q, or the error that is the answer.

    "Unique" counts cells, not things. Raises `FormatError` for an invalid layout.
    """
    start = cells(layout, P)
    if len(start) != 1:
        return NOT_UNIQUE if start else NO_POSITION
    facing, asked = ranked(start[0], cells(layout, O)), ranked(start[0], cells(layout, Q))
    return (facing[0], asked[0]) if facing and asked else NO_OBJECT


def products(v1: Any, v2: Any) -> tuple[Any, Any]:
    """Dot product and cross product r1 c2 - c1 r2 of two steps (rows, columns)."""
    return v1[0] * v2[0] + v1[1] * v2[1], v1[0] * v2[1] - v1[1] * v2[0]


def named(v1: Any, v2: Any) -> str:
    """The published words for the side of v1 (somebody by P faces O) on which v2 (from P to Q) lies.

    "Front" if v1 . v2 > 0, "Back" if it is negative, "Left" if r1 c2 - c1 r2 > 0, "Right" if it is negative. Empty if
    both are zero (an object in the cell of P); the benchmark leaves such questions out.
    """
    dot, cross = products(v1, v2)
    along = "Front" if dot > 0 else "Back" if dot < 0 else ""
    aside = "Left" if cross > 0 else "Right" if cross < 0 else ""
    return f"{along} {aside}".strip()


def tags(layout: Layout | None, names: Sequence[str], label: str) -> list[str]:
    """What makes a question for a direction hard, known before it is asked; `names`: P, O and Q.

    "absent": the label says that something is absent; "near a border": the dot or the cross product is at most one
    squared cell, otherwise "clear"; "tied": several things are equally near; "several": several things have the name.
    """
    if label in ERRORS:
        return ["absent"]
    if layout is None or len(names) != 3 or isinstance(found := steps(layout, *names), str):
        return []
    start, *others = (cells(layout, name) for name in names)
    near = [[r * r + c * c for r, c in ranked(start[0], where)[:2]] for where in others]
    kinds = ["clear" if min(map(abs, products(*found))) > 1 else "near a border"]
    kinds += ["tied"] if any(len(two) == 2 and two[0] == two[1] for two in near) else []
    return kinds + (["several"] if any(len(layout[name]) > 1 for name in names[1:]) else [])


def cells(layout: Layout, name: str) -> list[Cell]:
    """The cells of `name`, row by row, each once. Raises `FormatError` for what is no cell."""
    try:
        return sorted(set(msgspec.convert(layout.get(name, ()), list[Cell])))
    except msgspec.ValidationError as error:
        raise FormatError(f"the layout has {name!r} at {layout[name]!r}; wanted [row, column] ({error})") from None


def ranked(start: Cell, where: Iterable[Cell]) -> list[Cell]:
    """The steps from `start` to each of `where`, nearest first; equally near ones by angle.

    Angles go from the direction of growing columns to that of growing rows, from 0 up to a full turn.
    """
    ways = [(row - start[0], column - start[1]) for row, column in where]
    return sorted(ways, key=lambda way: (way[0] ** 2 + way[1] ** 2, math.atan2(*way) % (2 * math.pi)))


def swapped(answer: str) -> str:
    """`answer` with left and right exchanged; any other answer as it is."""
    return " ".join(_SIDES.get(word, word) for word in answer.split(" ")) if answer in DIRECTIONS else answer


def score(skill: str, truth: Any, answer: str, think: bool = False) -> float:
    """The score in [0, 1] of `answer`, the model's words, given the published answer `truth`.

    - object_counting: 1 - |difference| / larger of the first whole number in the answer and the truth (0 without one).
    - relative_distance: 1 if the whole answer is the truth, except for letter case and spaces around it.
    - relative_direction: the same, with "front left" and "front-left" alike. A full stop is one character too many.
    - cognitive_map: F1 of the map, see `score_map`; `truth` is the grid.

    `think`: use the text between <answer> and </answer>, if there is any. Raises `FormatError` for an unknown skill or
    an invalid truth.
    """
    if skill == MAP:
        return score_map(truth, answer)["overall"]["f1"]
    reply, true = extracted(answer, think).strip().lower(), str(truth).strip().lower()
    if skill == DISTANCE:
        return float(reply == true)
    if skill == DIRECTION:
        return float(_HYPHENS.get(reply, reply) == _HYPHENS.get(true, true))
    if skill != COUNTING:
        raise FormatError(f"there is no skill {skill!r}; known are {', '.join(SKILLS)}")
    number = re.search(r"\d+", reply)
    if not re.fullmatch(r"[+-]?\d{1,9}", true):
        raise FormatError(f"the true count is {shown(true)}; wanted a whole number")
    if number is None or len(number.group()) > 4000:  # more digits than Python reads: practically infinite
        return 0.0
    count, wanted = int(number.group()), int(true)
    return 1.0 if count == wanted else max(0.0, 1 - abs(count - wanted) / max(count, wanted))


def extracted(answer: str, think: bool) -> str:
    """The part of an answer that counts: with `think`, the text between the tags, or all of it without tags."""
    reply = answer_in(answer) if think else None
    return answer if reply is None else reply


def mistake(truth: str, answer: str, think: bool) -> str | None:
    """What is wrong with a wrong answer to a question for a direction, if it is its form or its side."""
    answer = extracted(answer, think).strip()
    readable = answer in ERRORS or answer.lower() in {*map(str.lower, DIRECTIONS), *_HYPHENS.values()}
    if truth not in ERRORS and not readable:
        return "format"
    mirrored = swapped(truth) != truth and score(DIRECTION, swapped(truth), answer)
    return "left and right exchanged" if mirrored else None


def score_map(truth: Grid, reply: str) -> dict[str, Any]:
    """The score of the last JSON object of a reply, ``{"name": [[x, y], ...]}`` with x the column and y the row.

    It is turned by the multiple of 90 degrees with the highest F1 (of equal ones the smallest), not mirrored. Things of
    a category are paired with the smallest sum of distances, and found if at most `NEAR` cells apart. Without a usable
    map a reply scores 0.

    "rotation": degrees clockwise; "overall" and "per_class" (by name): the figures that the published runner writes
    into its tables; "most": the highest F1 that the published code can give, that of "overall" is the lowest.
    """
    there, prediction, turns = layout_of(truth), read_map(reply) or {}, []
    for rotation in (0, 90, 180, 270):
        turns.append({"rotation": rotation, **_compared(there, prediction)})
        prediction = turned(prediction)
    return max(turns, key=lambda each: each["overall"]["f1"])  # the first of equal ones


def layout_of(grid: Grid) -> dict[str, list[list[int]]]:
    """The layout of a published grid."""
    found: dict[str, list[list[int]]] = {}
    for i, row in enumerate(grid):
        for j, names in enumerate(row):
            for name in names:
                found.setdefault(name, []).append([i, j])
    return found


def turned(layout: Layout) -> dict[str, list[list[int]]]:
    """The layout turned clockwise by a quarter."""
    return {name: sorted([column, SIZE - 1 - row] for row, column in where) for name, where in layout.items()}


def map_text(layout: Layout) -> str:
    """A layout in the benchmark's format: {"name": [[x, y], ...]}, x the column and y the row."""
    return json.dumps({name: [[column, row] for row, column in where] for name, where in layout.items()})


def read_map(reply: str) -> dict[str, list[list[int]]] | None:
    """The layout, name -> [[row, column], ...] row by row, in the last JSON object of a reply; None without one.

    As published, cells outside of the grid are dropped, and a map with fractions is none.
    """
    end, depth = reply.rfind("}"), 0
    for start in range(end, -1, -1):
        depth += {"}": 1, "{": -1}.get(reply[start], 0)
        if not depth:
            break
    else:
        return None
    try:
        named = msgspec.convert(parsed(reply[start : end + 1]), dict[str, list[tuple[Number, Number]]])
    except (ValueError, msgspec.ValidationError):
        return None
    found = {name: [cell for cell in where if all(0 <= k < SIZE for k in cell)] for name, where in named.items()}
    if any(isinstance(k, float) for where in found.values() for cell in where for k in cell):
        return None
    return {name: sorted([int(y), int(x)] for x, y in where) for name, where in found.items() if where}


def _compared(there: dict[str, list[list[int]]], prediction: dict[str, list[list[int]]]) -> dict[str, Any]:
    from scipy.optimize import linear_sum_assignment

    common, absent = {*there} & {*prediction}, sorted({*prediction} - {*there})
    if not common:  # as published, nothing is counted
        nothing = {"chair_s": 0, "chair_i": 0.0, "chair_instance": 0.0, "hallucinated_classes": []}
        return {"most": 0.0, "overall": _figures(0, 0, 0, FAR, 0.0) | nothing, "per_class": {}}
    categories: dict[str, dict[str, Any]] = {}
    pairs, total = 0, 0.0
    for name in sorted({*there} | {*prediction}):
        true, named, found = there.get(name, []), prediction.get(name, []), np.zeros(0)
        if name in common:
            distances = np.linalg.norm(np.array(true)[:, None] - np.array(named)[None], axis=-1)
            found = distances[linear_sum_assignment(distances)]
            pairs, total = pairs + len(found), total + float(found.sum())
        right, away = int((found <= NEAR).sum()), float(found.mean()) if len(found) else FAR
        # As published, a category without any thing to find (or named) has the recall (or precision) 1.
        categories[name] = _figures(right, len(named), len(true), away, 1.0)
    right = sum(each["tp"] for each in categories.values())
    true, named = sum(map(len, there.values())), sum(map(len, prediction.values()))
    overall = _figures(right, named, true, total / pairs, 0.0) | {
        "chair_s": int(bool(absent)),
        "chair_i": len(absent) / len(prediction),
        "chair_instance": sum(len(prediction[name]) for name in absent) / named,
        "hallucinated_classes": absent,
    }
    both = sum(len(each[name]) for each in (prediction, there) for name in common)
    return {"most": 2 * right / both, "overall": overall, "per_class": categories}


def _figures(right: int, named: int, true: int, away: float, empty: float) -> dict[str, Any]:
    """The published figures of `right` things of those `named`, with `true` things there; `empty`: shares of none."""
    shares = {"precision": right / named if named else empty, "recall": right / true if true else empty}
    f1 = 2 * right / (named + true) if right else 0.0
    return {**shares, "f1": f1, "avg_distance": away, "tp": right, "fp": named - right, "fn": true - right}


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
    """One picture, which may be missing, and its questions; `skipped` questions had no answer."""

    id: str
    folder: Path
    image: Path
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
        kinds = ", ".join(kind for kind in SUFFIXES if any(data.rglob(f"*_{kind}.json")))
        hint = f"it has files of the kind {kinds}: choose one with --set suffix=KIND" if kinds else "is it OSR-Bench?"
        raise FormatError(f"{data} has no <scene>_{suffix}.json and no qa.csv; {hint}")
    if len({scene.id for scene in scenes}) < len(scenes):
        raise FormatError(f"{data} has several scenes of one name; give the folder of one copy of the data")
    return tuple(sorted(scenes, key=lambda scene: scene.id))


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
    image = next((picture for picture in pictures if os.path.isfile(picture)), pictures[0])  # False for invalid names
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
