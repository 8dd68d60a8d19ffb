"""OSR-Bench's published files, folders of scenes with JSON or one CSV, and the parser of their questions.

``<scene>/rgb.png``, ``<scene>/cognitive_map.json`` and ``<scene>/<scene>_<suffix>.json`` with a suffix of `SUFFIXES`,
at any depth below the given folder. The hosted edition of the data has the questions in CSV files (columns image_id,
turn_id, question, answer and, optionally, skills_tested), which are read too.

Questions with an empty answer are left out, as the benchmark's authors do.
"""

from __future__ import annotations

import ast
import csv
import os
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any

from eagor._checks import parsed, shown
from eagor._values import lazy
from eagor.errors import FormatError
from eagor.lab.tasks.osr.scoring import COUNTING, DIRECTION, DISTANCE, MAP, SKILLS, layout_of, mirrored, swapped

SUFFIXES = ("qa_without_cogmap", "qa", "qa_with_negative", "qa_with_negative_without_cogmap")
WITHOUT = "_without_cogmap"
# The text of each kind of question, with names of things in groups: one name, or several separated by commas.
_WORDS = {
    DIRECTION: r"standing by the (.+?) and facing the closest (.+?), is the closest (.+?) to my front",
    DISTANCE: r"which of these objects \((?P<several>[^)]*)\) is the closest to the (?P<first>.+?) in this PANO",
    MAP: r"in this scene: \{(?P<several>[^}]*)\}",
    COUNTING: r"How many (.+?)\(s\) are in this room",
}


@dataclass(frozen=True)
class Question:
    """One question about a picture, with the published answer: text, or a map's grid; `id` as "scene/qa/18"."""

    id: str
    scene: str
    turn: int
    skill: str
    text: str
    answer: Any

    @property
    def names(self) -> tuple[str, ...]:
        """The names in it; empty if the text is not the benchmark's.

        The category counted; the category and then the choices; P, O and Q; or all categories of the map.
        """
        skill, names = read(self.text) or ("", ())
        return names if skill == self.skill else ()

    @property
    def corrected(self) -> Any:
        """The answer with left and right exchanged, which is right in the room; the published one is mirrored."""
        if self.skill == MAP:
            return mirrored(self.answer)
        return swapped(self.answer) if self.skill == DIRECTION else self.answer

    def truth(self, labels: str) -> Any:
        """The answer according to the labels "official" or "corrected"."""
        return self.corrected if labels == "corrected" else self.answer


def read(text: str) -> tuple[str, tuple[str, ...]] | None:
    """The skill that `text` asks for, and the names in it; None if it is not a question of this benchmark."""
    for skill, words in _WORDS.items():
        if found := re.search(words, text):
            groups = found.groupdict()
            if not groups:
                return skill, found.groups()
            listed = tuple(name.strip() for name in groups["several"].split(",") if name.strip())
            return skill, ((groups["first"], *listed) if "first" in groups else listed)
    return None


@dataclass(frozen=True, eq=False)
class Scene:
    """One picture and its questions. `image` is None without a picture; `skipped` questions had no answer."""

    id: str
    folder: Path
    image: Path | None
    questions: tuple[Question, ...]
    skipped: int = 0

    @lazy
    def by_id(self) -> dict[str, Question]:
        """The questions by id."""
        return {question.id: question for question in self.questions}

    @lazy
    def categories(self) -> tuple[str, ...]:
        """All names in the questions, in order of first appearance."""
        return tuple(dict.fromkeys(name for question in self.questions for name in question.names))

    @lazy
    def layout(self) -> dict[str, list[list[int]]] | None:
        """The published layout, None if the folder has none. Raises `FormatError` if it is malformed."""
        path = self.folder / "cognitive_map.json"
        if not path.is_file():
            return None if self.map_question is None else layout_of(self.map_question.answer)
        entry = _json(path)
        if not isinstance(entry, dict) or "cognitive_map" not in entry:
            raise FormatError(f'{path} has no "cognitive_map"; wanted {{"cognitive_map": 10 x 10 lists of names, ...}}')
        return _layout_in(entry["cognitive_map"], str(path))

    @property
    def picture(self) -> Path:
        """`image`. Raises `FormatError` if there is none."""
        if self.image is None:
            raise FormatError(f"the scene {self.id} has no picture (rgb.png); the data set is incomplete")
        return self.image

    @property
    def map_question(self) -> Question | None:
        """The question of turn 0 that asks for the map; None if this kind of file has none."""
        return next((question for question in self.questions if question.skill == MAP), None)


def load(data: Path, suffix: str = SUFFIXES[0]) -> tuple[Scene, ...]:
    """All scenes with questions in `data`, by name.

    If there are only files with the map's question, files without it are derived from them (the questions are the
    same). Raises `FormatError` if there are none, or one cannot be read.
    """
    if suffix not in SUFFIXES:
        raise FormatError(f"there is no kind of file {suffix!r}; known are {', '.join(SUFFIXES)}")
    if not data.exists():
        raise FormatError(f"there is no folder {data}; give the one that holds the scenes of OSR-Bench")
    files = _found(data, suffix)
    if suffix.endswith(WITHOUT):
        have = {path.parent for path in files}
        files += [path for path in _found(data, suffix.removesuffix(WITHOUT)) if path.parent not in have]
    scenes = sorted([_scene(path, suffix) for path in files] or _tables(data, suffix), key=lambda scene: scene.id)
    if not scenes:
        there = sorted(kind for kind in SUFFIXES if _found(data, kind))
        hint = f"it has files of the kind {', '.join(there)}: choose one with --set suffix=KIND"
        raise FormatError(
            f"{data} has no <scene>_{suffix}.json and no CSV with questions; {hint if there else 'is it OSR-Bench?'}"
        )
    for scene, other in pairwise(scenes):
        if scene.id == other.id:
            raise FormatError(f"{data} has several scenes {scene.id!r}; give the folder of one copy of the data")
    return tuple(scenes)


@lru_cache(maxsize=2)
def load_kept(data: str, suffix: str) -> tuple[Scene, ...]:
    """`load`, cached: workers call it again for each picture."""
    return load(Path(data), suffix)


def _found(data: Path, suffix: str) -> list[Path]:
    return sorted(data.rglob(f"*_{suffix}.json"))


def _scene(path: Path, suffix: str) -> Scene:
    entry = _json(path)
    turns = entry.get("conversation") if isinstance(entry, dict) else None
    if not isinstance(turns, list):
        raise FormatError(f'{path} has no list "conversation"; wanted the JSON of OSR-Bench')
    name = path.parent.name
    questions, skipped = _questions(((f"turn {k}", k, turn) for k, turn in enumerate(turns)), name, suffix, path)
    return Scene(name, path.parent, _image(path.parent, str(entry.get("image_id", ""))), questions, skipped)


def _questions(
    turns: Iterable[tuple[str, int, Any]], scene: str, suffix: str, path: Path
) -> tuple[tuple[Question, ...], int]:
    """The questions, and how many had no answer; `turns`: place in the file, number and content of each."""
    found: list[Question] = []
    skipped, taken = 0, {}
    for where, number, turn in turns:
        place = f"{path}, {where}"
        if not isinstance(turn, dict) or not isinstance(turn.get("question"), str) or "answer" not in turn:
            raise FormatError(f"{place}: {shown(turn)}; wanted an object with question and answer")
        asked = read(turn["question"])
        skill = turn.get("skills_tested") or turn.get("follow_up") or (asked[0] if asked else None)
        if skill not in SKILLS:
            raise FormatError(f"{place}: the skill is {shown(skill)}; known are {', '.join(SKILLS)}")
        if skill == MAP and suffix.endswith(WITHOUT):
            continue
        answer = turn["answer"]
        if answer is None or answer == "":
            skipped += 1
            continue
        try:
            index = int(turn.get("turn_id", number))
        except (TypeError, ValueError, OverflowError):
            raise FormatError(f"{place}: turn_id = {shown(turn['turn_id'])}; wanted a number") from None
        answer = _grid(answer, place) if skill == MAP else str(answer)
        again = taken[index] = taken.get(index, 0) + 1
        identity = f"{scene}/{suffix}/{index}" + (f"-{again}" if again > 1 else "")
        found.append(Question(identity, scene, index, skill, turn["question"], answer))
    return tuple(found), skipped


def _grid(answer: Any, where: str) -> Any:
    """A map's grid; in CSV it is text."""
    if isinstance(answer, str):
        try:
            answer = parsed(answer)
        except ValueError:
            try:
                answer = ast.literal_eval(answer)
            except (ValueError, SyntaxError, MemoryError, RecursionError):
                raise FormatError(f"{where}: the map is {answer[:40]!r}; wanted rows of lists of names") from None
    _layout_in(answer, where)
    return answer


def _layout_in(grid: Any, where: str) -> dict[str, list[list[int]]]:
    try:
        return layout_of(grid)
    except FormatError as error:
        raise FormatError(f"{where}: {error}") from None


def _image(folder: Path, image_id: str) -> Path | None:
    """rgb.png beside the questions, otherwise the path `image_id` from a folder above."""
    choices = [folder / "rgb.png", folder / PurePosixPath(image_id).name]
    if image_id:
        choices += [above / image_id for above in (folder, *folder.parents[:3])]
        choices += [above / PurePosixPath(image_id).parent.name / "rgb.png" for above in (folder, *folder.parents[:2])]
    return next((path for path in choices if os.path.isfile(path)), None)  # False for invalid file names


def _tables(data: Path, suffix: str) -> Iterator[Scene]:
    """The scenes of CSV files: those named after the suffix, otherwise all that have the right columns."""
    paths = sorted(data.rglob(f"*{suffix}.csv")) if data.is_dir() else [data]
    if data.is_dir() and suffix == "qa":
        paths = [path for path in paths if path.stem == "qa" or path.stem.endswith("_qa")]
    if not paths and suffix == "qa_without_cogmap":
        paths = sorted(data.rglob("qa.csv"))
    for path in (path for path in paths if path.suffix == ".csv"):
        rows: dict[str, list[tuple[str, int, dict[str, Any]]]] = {}
        csv.field_size_limit(min(sys.maxsize, 2**31 - 1))
        try:
            with path.open(newline="", encoding="utf-8-sig") as file:
                reader = csv.DictReader(file)
                for row in reader:
                    if missing := {"image_id", "question", "answer"} - {key for key in row if key}:
                        raise FormatError(f"{path} has no column {', '.join(sorted(missing))}")
                    turns = rows.setdefault(str(row["image_id"]), [])
                    given = {key: value for key, value in row.items() if value is not None}
                    turns.append((f"line {reader.line_num}", len(turns), given))
        except (OSError, UnicodeError, csv.Error) as error:
            raise FormatError(f"{path} cannot be read as CSV ({error})") from None
        for image_id, turns in rows.items():
            name = PurePosixPath(image_id).parent.name or PurePosixPath(image_id).stem
            questions, skipped = _questions(turns, name, suffix, path)
            image = _image(path.parent, image_id)
            yield Scene(name, image.parent if image else path.parent / name, image, questions, skipped)


def _json(path: Path) -> Any:
    try:
        return parsed(path.read_bytes().decode("utf-8-sig"))
    except (OSError, ValueError) as error:
        raise FormatError(f"{path} cannot be read as JSON ({error})") from None
