"""The `eagor` agent: what a perception sees becomes places on the floor, and the places answer."""

from __future__ import annotations

import zlib
from collections import Counter
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from eagor.tasks.osr.agents import Reply, answerable, error_for, map_text
from eagor.tasks.osr.dataset import Scene
from eagor.tasks.osr.drawing import Drawings, draw, layout_from
from eagor.tasks.osr.eyes import Looker, Seen
from eagor.tasks.osr.geometry import SURE, Placed, direction_between, nearest, place, place_on_circle
from eagor.tasks.osr.questions import Question
from eagor.tasks.osr.scoring import COUNTING, DIRECTION, DISTANCE, MAP

Reading = Literal["auto", "cells", "metres"]
Ranges = Literal["floor", "depth", "unit"]


@dataclass(frozen=True, eq=False)
class Around:
    """One scene as it was seen: things on the floor, and layouts drawn of them."""

    scene: str
    seen: Seen
    placed: tuple[Placed, ...]
    drawings: Drawings

    def members(self, name: str) -> list[int]:
        """The things of this name, the likeliest first."""
        found = [k for k, each in enumerate(self.placed) if each.name == name]
        return sorted(found, key=lambda k: -self.placed[k].weight)


def laid_out(scene: str, seen: Seen, ranges: Ranges = "floor", seed: int = 0) -> Around:
    """What was seen in the scene of this name, on the floor and drawn."""
    if ranges == "unit":
        seen = replace(seen, walls=None)
    placed = place_on_circle(seen.things) if ranges == "unit" else place(seen.things, seen.height, seen.walls)
    rng = np.random.default_rng([seed, zlib.crc32(scene.encode())])
    return Around(scene, seen, tuple(placed), draw(placed, seen.walls, rng))


class Eagor:
    """Answers from geometry.

    Args:
        look: gives the sightings of a scene.
        reading: "cells": the likeliest label under the benchmark's rounding (`eagor.tasks.osr.drawing`); "metres": the
            answer of the places as they are; "auto": cells where the foot of the walls is known, metres else (then
            nobody knows how a layout would lie in the room, and guessing it costs more than rounding does).
        ranges: "floor" or "depth": as `place` has it, with a depth cue where the looker gives one; "unit": all
            things equally far away, which is what directions alone can tell.
        negative: whether questions may ask about what is not there; only then are errors answered.
        seed: of the drawings.
    """

    def __init__(
        self,
        look: Looker,
        reading: Reading = "auto",
        ranges: Ranges = "floor",
        negative: bool = False,
        seed: int = 0,
    ) -> None:
        self._look, self._negative, self._seed = look, negative, seed
        self._reading: Reading = reading
        self._ranges: Ranges = ranges
        self._kept: Around | None = None

    def answer(self, scene: Scene, question: Question) -> Reply:
        around = self.around(scene)
        count = Counter(each.name for each in around.placed)
        names = question.names
        if question.skill == MAP:
            names = names or scene.categories
            there = {name: [around.placed[k].xy for k in around.members(name)] for name in names if count[name]}
            return Reply(map_text(layout_from(there)))
        if not names:
            return Reply(_guess(question), None, {"problem": "the question was not understood"})
        if question.skill == COUNTING:
            return Reply(str(count[names[0]]), None, _notes(around, names))
        notes = _notes(around, names)
        error = error_for(names, count, question.skill) if self._negative else None
        if error is not None:
            return Reply(error, None, notes)
        if not answerable(names, count, question.skill):
            notes["problem"] = "not seen: " + ", ".join(name for name in names if not count[name])
            return Reply(_guess(question), None, notes)
        if question.skill == DIRECTION:
            found, stated, shares = self.where(around, *names)
            notes["shares"] = {word: round(share, 3) for word, share in list(shares.items())[:4]}
            return Reply(found or _guess(question), stated, notes)
        return self._distance(around, names[0], names[1:], count, notes)

    def around(self, scene: Scene) -> Around:
        """The scene as it is seen: looked at once, for all names in its questions."""
        if self._kept is None or self._kept.scene != scene.id:
            self._kept = laid_out(scene.id, self._look(scene, scene.categories), self._ranges, self._seed)
        return self._kept

    def _rounded(self, around: Around) -> bool:
        return self._reading == "cells" or (self._reading == "auto" and around.seen.walls is not None)

    def where(self, around: Around, P: str, O: str, Q: str) -> tuple[str, float | None, dict[str, float]]:
        """Where the nearest Q is for one at P who faces the nearest O; how sure that is; and the share of each label.

        All three must be there; of several P the likeliest is taken.
        """
        start, facing, asked = around.members(P)[0], around.members(O), around.members(Q)
        shares = around.drawings.directions(start, facing, asked)
        placed = around.placed
        plain = direction_between(placed[start], [placed[k] for k in facing], [placed[k] for k in asked])
        if not self._rounded(around) or not shares:
            return plain, shares.get(plain), shares
        best = max(shares, key=lambda word: (shares[word], word == plain))
        return best, shares[best], shares

    def _distance(
        self, around: Around, name: str, choices: tuple[str, ...], count: Counter[str], notes: dict[str, Any]
    ) -> Reply:
        start = around.members(name)[0]
        groups = {name: around.members(name) for name in choices if count[name]}
        shares = around.drawings.nearest(start, groups)
        placed = around.placed
        plain = nearest(placed[start], [placed[k] for members in groups.values() for k in members]).name
        if not self._rounded(around):
            return Reply(plain, shares.get(plain), notes)
        best = max(shares, key=lambda name: (shares[name], name == plain))
        return Reply(best, shares[best], notes)


def _guess(question: Question) -> str:
    """An answer to a question about what was not seen: ahead, on either side; the first choice; none."""
    if question.skill == DIRECTION:
        return ("Front Left", "Front Right")[zlib.crc32(question.id.encode()) % 2]
    return question.names[1] if question.skill == DISTANCE and len(question.names) > 1 else "0"


def _notes(around: Around, names: tuple[str, ...]) -> dict[str, Any]:
    """How the things asked for were seen and placed."""
    found = []
    for name in dict.fromkeys(names):
        for k in around.members(name):
            each, thing = around.placed[k], around.seen.things[k]
            found.append(
                {
                    "name": name,
                    "azimuth_deg": round(float(np.degrees(thing.azimuth)), 1),
                    "elevation_deg": round(float(np.degrees(thing.elevation)), 1),
                    "xy": [round(value, 2) for value in each.xy],
                    "range_from": each.source,
                }
            )
    notes: dict[str, Any] = {"things": found}
    if any(each["range_from"] not in SURE for each in found):
        notes["guessed"] = True
    if strange := [name for name in names if name in around.seen.strange]:
        notes["strange"] = strange
    return notes
