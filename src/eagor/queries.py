"""Queries of the form "[colour] category", such as "red chair", "the grey couch", "plant".

All synonyms are here. Perceptions with a fixed vocabulary and tasks that choose targets both parse queries with it.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from eagor.errors import QueryError

__all__ = ["COLOURS", "SYNONYMS", "Named", "Query", "matching", "parse_query", "singular"]

COLOURS = (
    "black", "white", "grey", "red", "orange", "yellow", "green", "blue", "purple", "pink", "brown", "beige",
)  # fmt: skip
# Synonyms, also those of ObjectNav, COCO and ScanNet.
SYNONYMS = {
    "couch": "sofa", "settee": "sofa", "potted plant": "plant", "house plant": "plant", "houseplant": "plant",
    "tv monitor": "tv", "television": "tv", "tv set": "tv", "monitor": "tv", "screen": "tv",
    "fridge": "refrigerator", "bookcase": "bookshelf", "shelf": "bookshelf", "wardrobe cabinet": "wardrobe",
    "closet": "wardrobe", "cupboard": "cabinet", "bedside table": "nightstand", "night table": "nightstand",
    "bath": "bathtub", "tub": "bathtub", "wash basin": "sink", "washbasin": "sink", "basin": "sink",
    "carpet": "rug", "picture": "painting", "dining table": "table", "writing desk": "desk", "easy chair": "armchair",
    "light": "lamp", "floor lamp": "lamp", "cooker": "stove", "oven": "stove",
    "gray": "grey", "violet": "purple", "cream": "beige",
}  # fmt: skip
_FILLERS = {"the", "a", "an", "that", "my", "our"}


class Named(Protocol):
    """Anything with a category and optionally a colour."""

    @property
    def category(self) -> str: ...
    @property
    def colour(self) -> str | None: ...


@dataclass(frozen=True)
class Query:
    """A category, and a colour if the query names one."""

    category: str
    colour: str | None = None

    def __str__(self) -> str:
        return f"{self.colour} {self.category}" if self.colour else self.category

    def matches(self, thing: Named) -> bool:
        """Whether `thing` fits the query."""
        return thing.category == self.category and self.colour in (None, thing.colour)


def parse_query(text: str, categories: Iterable[str]) -> Query:
    """The query in `text`, over these categories. Raises `QueryError`, which lists the known words."""
    known = sorted(set(categories))
    words = re.findall(r"[a-z]+", text.lower()) if isinstance(text, str) else []
    words = [word for word in words if word not in _FILLERS]
    colour = None
    if words and singular(words[0]) in COLOURS and " ".join(words) not in known:
        colour, words = singular(words[0]), words[1:]
    name = " ".join(words)
    # The world's own words come first, synonyms second.
    spelt = {" ".join(re.findall(r"[a-z]+", category.lower())): category for category in reversed(known)}
    meant = {singular(words): category for words, category in spelt.items()} | spelt
    category = meant.get(name) or meant.get(singular(name))
    if category is None:
        near = difflib.get_close_matches(name, known, n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise QueryError(
            f"the query {text!r} names nothing known here.{hint} Wanted '[colour] category'; categories: "
            f"{', '.join(known)}; colours: {', '.join(COLOURS)}"
        )
    return Query(category, colour)


def matching(query: Query, things: Sequence[Named]) -> list[int]:
    """The indices in `things` of those that fit `query`."""
    return [index for index, thing in enumerate(things) if query.matches(thing)]


def singular(words: str) -> str:
    """`words` in our vocabulary, singular."""
    for ending, instead in (("", ""), ("ves", "f"), ("es", ""), ("s", "")):
        if words.endswith(ending):
            stem = words.removesuffix(ending) + instead
            if stem in SYNONYMS:
                return SYNONYMS[stem]
    if words.endswith(("ches", "shes", "sses", "xes")):
        return words.removesuffix("es")
    return words.removesuffix("s") if words.endswith("s") and not words.endswith("ss") else words
