"""Lenient JSON in prose: lists, tuples and objects wherever they stand, with the places that they were read from."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

_SPACE = re.compile(r"(?:\s|//[^\n]*|#[^\n]*)*")
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(\s?%)?")
_WORD = re.compile(r"[^\s,:\[\](){}\"'<>]+")
_STRING = {quote: re.compile(rf"(?:[^{quote}\\]|\\.)*", re.DOTALL) for quote in "\"'"}
_ESCAPE = re.compile(r"\\(u[0-9a-fA-F]{4}|U00[0-9a-fA-F]{6}|x[0-9a-fA-F]{2}|.|\Z)", re.DOTALL)
_CLOSING = {"[": "]", "(": ")", "{": "}"}
_CONSTANTS = {"true": True, "false": False, "null": None, "none": None, "nan": None}
_DEEPEST = 40  # nesting of lists; deeper ones are not answers


@dataclass(frozen=True)
class Node:
    """A value and the half-open range of characters that it was read from.

    `value` is a list of nodes, a dict of nodes by key, a string, a float, a bool or None. `whole` is False if the text
    ended before the value did.
    """

    value: Any
    start: int
    end: int
    whole: bool = True


def values(text: str) -> list[Node]:
    """All top-level lists and objects in `text`, in order."""
    found, place = [], 0
    while place < len(text):
        if text[place] in _CLOSING:
            node = _collection(text, place, 0)
            found.append(node)
            place = max(node.end, place + 1)
        else:
            place += 1
    return found


def share(percent: float) -> float:
    """What a number with a sign of percent is, by which it is no whole number."""
    return math.nextafter(percent / 100, 0.5)


def _skip(text: str, place: int) -> int:
    """The place after white space and comments."""
    match = _SPACE.match(text, place)
    assert match is not None  # it may be empty
    return match.end()


def _value(text: str, place: int, depth: int) -> Node | None:
    """The value that begins at `place`, None if nothing known begins there."""
    if place >= len(text):
        return None
    first = text[place]
    if first in _CLOSING:
        return _collection(text, place, depth) if depth < _DEEPEST else None
    if first in _STRING and (string := _STRING[first].match(text, place + 1)):
        end = string.end()
        return Node(_unescaped(text[place + 1 : end]), place, min(end + 1, len(text)), whole=end < len(text))
    number = _NUMBER.match(text, place)
    if number:
        value = share(float(number[1])) if number[2] else float(number[1])
        return Node(value, place, number.end(), whole=number.end() < len(text))
    word = _WORD.match(text, place)
    if word is None:
        return None
    written = word.group()
    return Node(_CONSTANTS.get(written.lower(), written), place, word.end())


def _unescaped(written: str) -> str:
    """The text of a string literal of JSON or Python."""
    meant = _ESCAPE.sub(_letter, written)
    return meant.encode("utf-16", "surrogatepass").decode("utf-16", "replace")  # joins pairs of surrogates


def _letter(match: re.Match[str]) -> str:
    code = match.group(1)
    if len(code) > 1:
        return chr(min(int(code[1:], 16), 0x10FFFF))
    return {"n": "\n", "t": "\t", "r": "\r", "b": "\b", "f": "\f"}.get(code, code)


def _collection(text: str, place: int, depth: int) -> Node:
    """The list, tuple or object that opens at `place`; it ends early where the text is no longer valid."""
    opening = text[place]
    closing, keyed = _CLOSING[opening], opening == "{"
    entries: list[Node] = []
    parted: list[int] = []  # how many entries there are before each semicolon
    pairs: dict[str, list[Node]] = {}
    at, whole = place + 1, False
    while True:
        at = _skip(text, at)
        while at < len(text) and text[at] in ",;":
            parted += [len(entries)] * (text[at] == ";")
            at = _skip(text, at + 1)
        if at < len(text) and text[at] == closing:
            at, whole = at + 1, True
            break
        node = _value(text, at, depth + 1)
        if node is None or _torn(node):
            break
        at = _skip(text, node.end)
        if keyed and at < len(text) and text[at] in ":=":
            key, inner = str(node.value), _value(text, _skip(text, at + 1), depth + 1)
            if inner is None or _torn(inner):
                break
            pairs.setdefault(key, []).append(inner)
            node, at = inner, inner.end
        elif keyed:  # {[...], [...]}: a set of values without keys
            pairs[f"{len(pairs)}"] = [node]
        else:
            entries.append(node)
        if not node.whole:
            break
    if not keyed:
        places = [*range(0, len(entries), 4)]
        if parted and [0, *parted] == places and len(entries) % 4 == 0:  # of CogVLM: one box after the other
            fours = [entries[k : k + 4] for k in places]
            entries = [Node(four, four[0].start, four[-1].end) for four in fours]
        return Node(entries, place, at, whole)
    # A key that occurs several times holds all its values, in one list.
    held = {key: Node(several, several[0].start, several[-1].end) for key, several in pairs.items()}
    single = {key: several[0] for key, several in pairs.items() if len(several) == 1}
    return Node(held | single, place, at, whole)


def _torn(node: Node) -> bool:
    """Whether `node` is a number at the end of a text that stops within a list: digits may be missing."""
    return isinstance(node.value, float) and not node.whole
