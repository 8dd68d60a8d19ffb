"""The questions of OSR-Bench: what each asks, read from its words, and its words for what is asked.

The words are those of the published data, which answers are compared with; only the map's question is our own text
where we make data ourselves.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from eagor.tasks.osr.layout import mirrored, swapped
from eagor.tasks.osr.scoring import COUNTING, DIRECTION, DISTANCE, MAP

_COUNT = re.compile(r"How many (?P<name>.+?)\(s\) are in this room")
_NEAREST = re.compile(r"which of these objects \((?P<choices>[^)]*)\) is the closest to the (?P<name>.+?) in this PANO")
_WHERE = re.compile(
    r"standing by the (?P<P>.+?) and facing the closest (?P<O>.+?), is the closest (?P<Q>.+?) to my front"
)
_LISTED = re.compile(r"in this scene: \{(?P<names>[^}]*)\}")


@dataclass(frozen=True)
class Asked:
    """What a question is about: the `skill`, and the names in it.

    `names`: the category counted; the category and then the choices; P, O and Q; or all categories of the map.
    """

    skill: str
    names: tuple[str, ...]


@dataclass(frozen=True)
class Question:
    """One question of one picture, with the published answer: text, or the grid of a map.

    `id`: of the scene, the kind of file and the turn, such as "scene/qa/18".
    """

    id: str
    scene: str
    turn: int
    skill: str
    text: str
    answer: Any

    @property
    def names(self) -> tuple[str, ...]:
        """The names in it, in the order of `Asked.names`; none where the words are not those of the benchmark."""
        asked = read(self.text)
        return asked.names if asked is not None and asked.skill == self.skill else ()

    @property
    def corrected(self) -> Any:
        """The answer that is right in the room: with left and right exchanged, which the published ones have wrong."""
        if self.skill == MAP:
            return mirrored(self.answer)
        return swapped(self.answer) if self.skill == DIRECTION else self.answer

    def truth(self, labels: str) -> Any:
        """The answer by the labels "official" or "corrected"."""
        return self.corrected if labels == "corrected" else self.answer


def read(text: str) -> Asked | None:
    """What `text` asks, None where it is no question of this benchmark."""
    if found := _WHERE.search(text):
        return Asked(DIRECTION, (found["P"], found["O"], found["Q"]))
    if found := _NEAREST.search(text):
        return Asked(DISTANCE, (found["name"], *_split(found["choices"])))
    if found := _LISTED.search(text):
        return Asked(MAP, _split(found["names"]))
    if found := _COUNT.search(text):
        return Asked(COUNTING, (found["name"],))
    return None


def counting(name: str) -> str:
    """The question how many there are."""
    return f"How many {name}(s) are in this room?"


def distance(name: str, choices: Sequence[str]) -> str:
    """The question which of the choices is nearest."""
    return (
        f"Measuring from the closest point of each object, which of these objects ({', '.join(choices)}) is the "
        f"closest to the {name} in this PANORAMA?"
    )


def direction(P: str, O: str, Q: str) -> str:
    """The question in which direction Q lies for one who stands by P and faces O."""
    return (
        f"If I am standing by the {P} and facing the closest {O}, is the closest {Q} to my front, back, left, right, "
        "front-left, front-right, back-left, or back-right in this PANORAMA?"
    )


def mapping(names: Sequence[str]) -> str:
    """The question for the map, in our words, with the list of categories and the format as the benchmark has them."""
    return (
        "[Task] This PANORAMA shows a room all around. Draw its plan: say where the middle of each object lies on a "
        "10x10 grid that covers the whole room. [Rule] Care only about the categories in this scene: "
        f"{{{', '.join(names)}}}. List every instance of each of them, keep their positions to one another, put what "
        "is near the camera near the middle of the grid and what is far away near its edges, and place an object that "
        "is partly hidden where all of it must be. [Output] One JSON object with integer coordinates from 0 to 9: "
        '{"category name": [[x_1, y_1], ...], ...}'
    )


def _split(names: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in names.split(",") if name.strip())
