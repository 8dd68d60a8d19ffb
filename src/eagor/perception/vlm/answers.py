"""What a model's answer says: boxes, or yes or no, each with its probability where the tokens' are known.

`parse_boxes` reads lenient JSON, lists in prose, and the markup of some families: lists of objects with a box under any
usual key (``bbox_2d``, ``box_2d``, ``bbox``, ``box``, ...), bare lists of four numbers, pairs of corners, named
corners, and InternVL's and Qwen2-VL's markup; within fences, prose or a model's thoughts, complete or cut off. The
caller says what the coordinates count: 0..1000 and pixels look alike (Qwen2.5-VL counts pixels of the RESIZED picture,
Bai et al. 2025, arXiv:2502.13923).
"""

from __future__ import annotations

import math
import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from eagor.errors import AnswerError

__all__ = ["AnswerError", "Box", "Frame", "Order", "Token", "parse_boxes", "without_thoughts"]

_SPACE = re.compile(r"(?:\s|//[^\n]*|#[^\n]*)*")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
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
        return Node(float(number.group()), place, number.end(), whole=number.end() < len(text))
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
    pairs: dict[str, list[Node]] = {}
    at, whole = place + 1, False
    while True:
        at = _skip(text, at)
        while at < len(text) and text[at] in ",;":
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
        return Node(entries, place, at, whole)
    # A key that occurs several times holds all its values, in one list.
    held = {key: Node(several, several[0].start, several[-1].end) for key, several in pairs.items()}
    single = {key: several[0] for key, several in pairs.items() if len(several) == 1}
    return Node(held | single, place, at, whole)


def _torn(node: Node) -> bool:
    """Whether `node` is a number at the end of a text that stops within a list: digits may be missing."""
    return isinstance(node.value, float) and not node.whole


# --- what a model's answer says ---------------------------------------------------------------------------------------

Frame = Literal["pixels", "thousand", "unit"]  # pixels of the image that the model saw; 0..1000 per side; 0..1
Order = Literal["xyxy", "yxyx"]

_BOX_KEYS = (
    *("bbox_2d", "box_2d", "bbox2d", "box2d", "bbox", "box", "bounding_box", "boundingbox", "bndbox"),
    *("coordinates", "coords", "xyxy", "position", "location"),
)
_LABEL_KEYS = ("label", "name", "class", "category", "object", "description", "text")
_SCORE_KEYS = ("score", "confidence", "probability", "prob", "conf")
_GENERIC = {
    *_BOX_KEYS,
    *("boxes", "bboxes", "objects", "detections", "results", "instances", "items", "answer", "output", "data"),
}
_CORNERS = ("xmin ymin xmax ymax", "x_min y_min x_max y_max", "x0 y0 x1 y1", "x1 y1 x2 y2", "left top right bottom")
_SIDES = ("x y width height", "x y w h", "left top width height")
_ABSENT = re.compile(
    r"\A\W*(?:no|none|null|nothing)\b(?! problem)|\bthere(?: is|'s| are| was| were) (?:no|none|nothing|not)\b"
    r"|\bno \w[\w ]{0,80} (?:in|visible|present|found|detected|shown|here|can be)\b"
    r"|\b(?:not|isn't|aren't) (?:any|visible|present|found|there|detected|shown|seen|in (?:the|this|view))\b"
    r"|\b(?:not|doesn't|don't) (?:contain|show|appear|include|have|see|find|depict|feature)\b"
    r"|\b(?:cannot|can't|can not|couldn't|could not|unable to) (?:be )?(?:see|seen|find|found|locate|located|detect)\b"
)
# Some chat templates open the thoughts themselves, so that the answer only closes them.
_THOUGHTS = re.compile(r"\A(?:(?!<think).)*</think(?:ing)?>|<think(?:ing)?>.*?(?:</think(?:ing)?>|\Z)", re.DOTALL)
_LONGEST = 200_000  # characters of an answer: thousands of boxes
_MOST_THOUGHTS = 1_000_000  # characters, with the answer
_LEAST = 1e-6  # of the image's sides: anything smaller has no area
_PAST = 1.1  # coordinates beyond this many image sides are in another frame, not just inaccurate


@dataclass(frozen=True)
class Box:
    """A detection in fractions of the image's width and height, [0, 1], with x0 < x1 and y0 < y1; y grows down."""

    x0: float
    y0: float
    x1: float
    y1: float
    label: str = ""
    score: float = 1.0


@dataclass(frozen=True)
class _Found:
    """Four coordinates as written, x0 y0 x1 y1, and the span of text in which the model decided to write them.

    The span begins at the list's opening or after the previous box, and ends with the opening bracket of this entry.
    None: unknown.
    """

    numbers: tuple[Node, ...]
    decided: tuple[int, int] | None
    label: str
    score: float | None


def parse_boxes(
    text: str, frame: Frame, size: tuple[int, int], order: Order = "xyxy", tokens: Sequence[Token] | None = None
) -> list[Box]:
    """The boxes in a model's answer; [] where the answer says that there is none.

    Args:
        text: the answer.
        frame: what its coordinates count. Fractions below 1 are read as fractions in every frame.
        size: (height, width) of the image that the model saw, after any resizing.
        order: of four bare numbers; named corners go by their names.
        tokens: the pieces of the answer with log probabilities, which give the scores (`_confidence`); without them 1.

    Boxes without area, duplicates, and boxes far outside are left out. Raises `AnswerError` if nothing can be read,
    or if all coordinates lie far outside the frame.
    """
    answer = spoken(text)
    nodes = values(answer)
    found = [box for node in _joined(nodes) for box in _boxes(node, order, "", node.start)]
    if not found:
        said = answer.lower().replace("\N{RIGHT SINGLE QUOTATION MARK}", "'")
        if any(_emptied(node) for node in nodes) or _ABSENT.search(said):
            return []
        raise AnswerError(
            f"the model answered {shortened(text)}; wanted boxes as a JSON list, [] if there are none. If it was cut "
            "off, allow more tokens; if the model does not write boxes, use extractor 'views' (or 'attention', locally)"
        )
    trace = Trace(text, tokens) if tokens else None
    read = [_box(box, frame, size, trace) for box in found]
    if all(box == "outside" for box in read):
        raise AnswerError(
            f"the model answered {shortened(text)}, which lies outside the frame {frame!r} of a {size[1]} x {size[0]} "
            "image; is that what this model's coordinates count, and does its server leave the image's size alone?"
        )
    kept: dict[tuple[float, ...], Box] = {}
    for box in read:
        if isinstance(box, Box):
            corners = (box.x0, box.y0, box.x1, box.y1)
            if corners not in kept or kept[corners].score < box.score:
                kept[corners] = box
    return list(kept.values())


def spoken(text: str) -> str:
    """`text` without thoughts. Raises `AnswerError` if it is far too long."""
    answer = without_thoughts(text) if len(text) <= _MOST_THOUGHTS else text
    if len(answer.strip()) > _LONGEST:
        raise AnswerError(
            f"the model answered {shortened(text)} and so on, {len(text)} characters; wanted a short answer. Allow "
            "fewer tokens (max_tokens=...)"
        )
    return answer


def without_thoughts(text: str) -> str:
    """`text` with everything between <think> tags blanked out; all other characters keep their places."""
    return _THOUGHTS.sub(lambda match: " " * len(match.group()), text)


def shortened(text: str, most: int = 200) -> str:
    """`text` on one line and in quotes, for an error."""
    line = " ".join(text.split())
    return repr(line if len(line) <= most else line[: most - 3] + "...")


def _numbers(node: Node) -> tuple[Node, ...]:
    """The entries of a list of numbers, () for anything else."""
    if not isinstance(node.value, list):
        return ()
    found = tuple(node.value)
    return found if all(isinstance(entry.value, float) for entry in found) else ()


def _joined(nodes: list[Node]) -> list[Node]:
    """`nodes` with two consecutive pairs of numbers, such as ``(12,30),(40,80)``, joined to one list of four."""
    joined: list[Node] = []
    for node in nodes:
        pair = _numbers(node)
        before = _numbers(joined[-1]) if joined else ()
        if len(pair) == 2 == len(before):
            joined[-1] = Node([*before, *pair], joined[-1].start, node.end)
        else:
            joined.append(node)
    return joined


def _emptied(node: Node) -> bool:
    """Whether a value is or contains a complete list or object without entries."""
    if isinstance(node.value, dict | list):
        inner = node.value.values() if isinstance(node.value, dict) else node.value
        return (node.whole and not node.value) or any(_emptied(entry) for entry in inner)
    return False


def _boxes(node: Node, order: Order, label: str, since: int) -> Iterator[_Found]:
    """The boxes in a value, at any depth; `since`: where the decision to write the first one began."""
    if isinstance(node.value, dict):
        yield from _boxes_of_object(node, order, label, since)
    elif isinstance(node.value, list):
        corners = _four(node, order)
        if corners:
            score = corners[4].value if len(corners) == 5 else None
            yield _Found(corners[:4], (since, node.start + 1), label, score)
            return
        for entry in node.value:
            yield from _boxes(entry, order, label, since)
            since = entry.end
    elif isinstance(node.value, str) and node.value.lstrip()[:1] in ("[", "("):
        for inner in values(node.value):  # a list written as a string: its places are not those of the text
            for found in _boxes(inner, order, label, 0):
                yield replace(found, decided=None)


def _four(node: Node, order: Order) -> tuple[Node, ...]:
    """x0 y0 x1 y1 of a list of four numbers (or five, the last a score) or of two corners; () for anything else."""
    flat = _numbers(node)
    if not flat and isinstance(node.value, list) and len(node.value) == 2:
        flat = (*_numbers(node.value[0]), *_numbers(node.value[1]))
        flat = flat if len(flat) == 4 and len(_numbers(node.value[0])) == 2 else ()
    if len(flat) not in (4, 5) or (len(flat) == 5 and not 0 <= flat[4].value <= 1):
        return ()
    places = (0, 1, 2, 3) if order == "xyxy" else (1, 0, 3, 2)
    return (*(flat[place] for place in places), *flat[4:])


def _boxes_of_object(node: Node, order: Order, label: str, since: int) -> Iterator[_Found]:
    fields = {key.strip().lower().replace(" ", "_").replace("-", "_"): inner for key, inner in node.value.items()}
    named = next((fields[key].value for key in _LABEL_KEYS if key in fields), None)
    label = named if isinstance(named, str) else label
    score = _score(next((fields[key].value for key in _SCORE_KEYS if key in fields), None))
    corners = _named_corners(fields)
    if corners:
        yield _Found(corners, (since, node.start + 1), label, score)
        return
    key = next((key for key in _BOX_KEYS if key in fields), None)
    if key is not None:
        decided = (since, node.start + 1)
        for index, found in enumerate(_boxes(fields[key], order, label, since)):
            own = score if found.score is None else found.score
            yield replace(found, score=own, decided=decided if index == 0 and found.decided else found.decided)
        return
    for key, inner in node.value.items():
        generic = key.strip().lower() in _GENERIC or key.isdigit()
        yield from _boxes(inner, order, label or ("" if generic else key), inner.start)


def _named_corners(fields: dict[str, Node]) -> tuple[Node, ...]:
    for names in (*_CORNERS, *_SIDES):
        found = tuple(fields[name] for name in names.split() if name in fields)
        if len(found) == 4 and all(isinstance(entry.value, float) for entry in found):
            x, y, across, down = found
            if names in _SIDES:
                across, down = replace(across, value=x.value + across.value), replace(down, value=y.value + down.value)
            return x, y, across, down
    return ()


def _score(written: object) -> float | None:
    """A score in [0, 1] (percentages are divided); None for anything else."""
    if isinstance(written, str):
        try:
            written = float(written.strip(" %"))
        except ValueError:
            return None
    if not isinstance(written, float) or not 0 <= written <= 100:
        return None
    return written if written <= 1 else written / 100


def _box(found: _Found, frame: Frame, size: tuple[int, int], trace: Trace | None) -> Box | str:
    """The box in fractions, or the reason for none: "outside" or "empty"."""
    height, width = size
    written = [entry.value for entry in found.numbers]
    if not all(math.isfinite(number) for number in written):
        return "empty"
    across, down = {"pixels": (width, height), "thousand": (1000, 1000), "unit": (1, 1)}[frame]
    if max(written) <= 1 and not all(number.is_integer() for number in written):
        across = down = 1
    xs, ys = sorted((written[0] / across, written[2] / across)), sorted((written[1] / down, written[3] / down))
    if min(xs[0], ys[0]) < 1 - _PAST or max(xs[1], ys[1]) > _PAST or max(xs[0], ys[0]) >= 1 or min(xs[1], ys[1]) <= 0:
        return "outside"
    x0, y0, x1, y1 = (min(max(value, 0.0), 1.0) for value in (xs[0], ys[0], xs[1], ys[1]))
    if not (x1 - x0 > _LEAST and y1 - y0 > _LEAST):
        return "empty"
    score = found.score
    if score is None:
        score = _confidence(found.numbers, found.decided, trace) if trace and found.decided else 1.0
    return Box(x0, y0, x1, y1, found.label, score)


def _confidence(numbers: tuple[Node, ...], decided: tuple[int, int], trace: Trace) -> float:
    """The probability of opening the entry times the geometric mean over the first tokens of its numbers."""
    begun = sum(trace.log_probability(number.start, number.start + 1) for number in numbers) / len(numbers)
    return math.exp(trace.log_probability(*decided) + begun)


# --- yes or no --------------------------------------------------------------------------------------------------------

_YES, _NO = ("yes", "true", "present", "visible"), ("no", "false", "none", "not", "absent")
_WORDS = re.compile(r"[^\W\d_]+")


def parse_presence(text: str, first: Sequence[Token] | None = None) -> float:
    """The probability in [0, 1] that a model's answer to `eagor.perception.vlm.ask_presence` means yes.

    `first` holds the likeliest tokens at the place of the answer, with log probabilities. The result is then the share
    of yes among yes and no; if only one side is listed, the other gets the rest of the probability. Without `first` it
    is 1 for yes and 0 for no. Raises `AnswerError` if the answer is neither.
    """
    answer = spoken(text)
    shares, listed = [0.0, 0.0], 0.0
    for piece, log in first or ():
        probability, meant = math.exp(min(float(log), 0.0)), means(piece)
        listed += probability
        if meant is not None:
            shares[meant] += probability
    if sum(shares) > 0:
        if min(shares) == 0:
            shares[shares.index(0.0)] = max(0.0, 1 - listed)
        return shares[1] / sum(shares)
    for word in _WORDS.findall(answer.lower()):
        meant = means(word)
        if meant is not None:
            return float(meant)
    raise AnswerError(f"the model answered {shortened(text)}; wanted yes or no. Can it see images?")


def means(word: str) -> bool | None:
    """True for yes, False for no, None for neither."""
    bare = "".join(_WORDS.findall(word.lower()))
    return True if bare in _YES else False if bare in _NO else None


# --- which token of an answer a character came from -------------------------------------------------------------------

Token = tuple[str, float]  # a piece of the answer and the natural logarithm of its probability
_AHEAD = 64  # characters to search ahead to find the place again


class Trace:
    """The log probabilities of an answer's tokens by place in its text.

    Args:
        text: the answer.
        tokens: its pieces in order. Special tokens that the text lacks, and garbled pieces of characters that take
            several tokens, are skipped.
    """

    def __init__(self, text: str, tokens: Sequence[Token]) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []
        self._logs: list[float] = []
        place = 0
        for piece, log in tokens:
            at = place if piece and text.startswith(piece, place) else -1
            if at < 0 and len(piece.strip()) > 1:
                at = text.find(piece, place, place + _AHEAD)
            if at >= 0:
                place = at + len(piece)
                self._starts.append(at)
                self._ends.append(place)
                self._logs.append(min(float(log), 0.0))

    def log_probability(self, start: int, stop: int) -> float:
        """Of all tokens together that have a character in [`start`, `stop`); 0 where none is known."""
        first, last = bisect_right(self._ends, start), bisect_left(self._starts, stop)
        return sum(self._logs[first:last])
