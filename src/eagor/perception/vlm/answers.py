"""What a model's answer says: boxes, or yes or no, each with its probability where the tokens' are known.

`parse_boxes` reads lenient JSON, lists in prose, and the markup of some families: lists of objects with a box under any
usual key (``bbox_2d``, ``box_2d``, ``bbox``, ``box``, ...), bare lists of four numbers, pairs of corners, named
corners, points, XML, Florence-2's and PaliGemma's ``<loc>`` tokens, and numbers without any brackets; within fences,
prose or a model's thoughts, complete or cut off. The caller says what the coordinates count: 0..1000 and pixels look
alike (families.toml says what each family counts).
"""

from __future__ import annotations

import math
import re
import tomllib
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from eagor.errors import AnswerError
from eagor.perception.vlm.lenient import Node, share, values

__all__ = ["AnswerError", "Box", "Frame", "Order", "Token", "parse_boxes", "without_thoughts"]

# --- what a model's answer says ---------------------------------------------------------------------------------------

Frame = Literal["pixels", "thousand", "percent", "unit"]  # pixels of the image that the model saw; parts of each side
Order = Literal["xyxy", "yxyx"]

_BOX_KEYS = (
    *("bbox_2d", "box_2d", "bbox2d", "box2d", "bbox", "box", "bounding_box", "boundingbox", "bndbox"),
    *("coordinates", "coords", "xyxy", "position", "location"),
)
_Y_FIRST = "box_2d"  # Gemini's key, whose boxes are y0 x0 y1 x1 whatever is asked for
_POINT_KEYS = ("point_2d", "point", "points", "point2d", "xy", "center", "centre")
_LABEL_KEYS = ("label", "name", "class", "category", "object", "description", "text")
_SCORE_KEYS = ("score", "confidence", "probability", "prob", "conf")
_GENERIC = {
    *_BOX_KEYS,
    *_POINT_KEYS,
    *("boxes", "bboxes", "objects", "detections", "results", "instances", "items", "answer", "output", "data"),
}
_CORNERS = ("xmin ymin xmax ymax", "x_min y_min x_max y_max", "x0 y0 x1 y1", "x1 y1 x2 y2", "left top right bottom")
_SIDES = ("x y width height", "x y w h", "left top width height")
_OPPOSITE = (("top_left", "bottom_right"), ("topleft", "bottomright"), ("upper_left", "lower_right"), ("min", "max"))
_WIDE = str.maketrans("（）［］｛｝，：；％", "()[]{},:;%")  # as Chinese and Japanese texts have them
_WORDS_OF = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_ABSENT = re.compile("|".join(line for each in _WORDS_OF["absent"].values() for line in each.strip().splitlines()))
# Marks of thoughts; some chat templates open them themselves, so that the answer only closes them.
_THOUGHT = re.compile(r"[<◁\[](?P<end>/?)\|?(?:seed:)?(?:think(?:ing)?|thoughts?|reasoning)\|?[>▷\]]", re.IGNORECASE)
# Marks of the answer, of GLM and others: what is outside leads to it.
_ANSWER = re.compile(
    r"<answer>(.*?)(?:</answer>|\Z)|<\|begin_of_box\|>(.*?)(?:<\|end_of_box\|>|\Z)|<\|channel\|>final<\|message\|>(.*?)(?:<\||\Z)",
    re.DOTALL | re.IGNORECASE,
)
_LONGEST = 200_000  # characters of an answer: thousands of boxes
_MOST_THOUGHTS = 1_000_000  # characters, with the answer
_LEAST = 1e-6  # of the image's sides: anything smaller has no area
_POINT = 0.01  # of the image's sides: half of what a point without a size stands for
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
    None: unknown. A point has equal corners.
    """

    numbers: tuple[Node, ...]
    decided: tuple[int, int] | None = None
    label: str = ""
    score: float | None = None
    point: bool = False


def parse_boxes(
    text: str, frame: Frame, size: tuple[int, int], order: Order = "xyxy", tokens: Sequence[Token] | None = None
) -> list[Box]:
    """The boxes in a model's answer; [] where the answer says that there is none.

    Args:
        text: the answer.
        frame: what its coordinates count. Fractions below 1 are read as fractions in every frame.
        size: (height, width) of the image that the model saw, after any resizing.
        order: of bare numbers; named corners go by their names, Gemini's ``box_2d`` is always y first.
        tokens: the pieces of the answer with log probabilities, which give the scores (`_confidence`); without them 1.

    A point becomes a small box. Boxes without area ([0, 0, 0, 0] says that there is none), duplicates, and boxes far
    outside are left out. Raises `AnswerError` if nothing can be read,
    or if all coordinates lie far outside the frame.
    """
    answer = spoken(text)
    nodes = values(answer)
    found = [box for node in _joined(nodes) for box in _boxes(node, order, "", node.start)]
    if not found and not any(_cut_off(node) for node in nodes):
        found = [*_marked(answer, order)]
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
    answer = without_thoughts(text).translate(_WIDE) if len(text) <= _MOST_THOUGHTS else text
    if len(answer.strip()) > _LONGEST:
        raise AnswerError(
            f"the model answered {shortened(text)} and so on, {len(text)} characters; wanted a short answer. Allow "
            "fewer tokens (max_tokens=...)"
        )
    return answer


def without_thoughts(text: str) -> str:
    """`text` with all thoughts blanked out, and all outside of the marks of an answer; the rest keeps its places."""
    kept, place, thinks = [], 0, False
    for mark in _THOUGHT.finditer(text):
        if mark["end"]:
            kept.append((place, place))  # what came before was thought, opened or not
            place, thinks = mark.end(), False
        elif not thinks:
            kept.append((place, mark.start()))
            place, thinks = mark.start(), True
    kept.append((place, place if thinks else len(text)))
    bare = _only(text, kept)
    marked = [answer.span(answer.lastindex or 0) for answer in _ANSWER.finditer(bare)]
    return _only(bare, marked) if any(bare[start:end].strip() for start, end in marked) else bare


def _only(text: str, spans: Sequence[tuple[int, int]]) -> str:
    """`text` with blanks outside of `spans`, which are in order."""
    parts, place = [], 0
    for start, end in spans:
        parts += [" " * (start - place), text[start:end]]
        place = end
    return "".join(parts) + " " * (len(text) - place)


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


def _cut_off(node: Node) -> bool:
    """Whether the text ended within a list or object that has numbers."""
    inner = node.value.values() if isinstance(node.value, dict) else node.value if isinstance(node.value, list) else ()
    return not node.whole and any(isinstance(entry.value, float) or _cut_off(entry) for entry in inner)


def _emptied(node: Node) -> bool:
    """Whether a value is or contains a complete list or object without entries, "null" or "false"."""
    if node.value is None or node.value is False:
        return True
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
    corners = _named_corners(fields) or _opposite_corners(fields, order)
    if corners:
        yield _Found(corners, (since, node.start + 1), label, score)
        return
    if key := next((key for key in _BOX_KEYS if key in fields and fields[key].value is not None), None):
        decided = (since, node.start + 1)
        own_order: Order = "yxyx" if key == _Y_FIRST else order
        for index, found in enumerate(_boxes(fields[key], own_order, label, since)):
            own = score if found.score is None else found.score
            yield replace(found, score=own, decided=decided if index == 0 and found.decided else found.decided)
        return
    places = [fields[key] for key in _POINT_KEYS if key in fields] or [node]
    if points := [point for each in places for point in _points(each, order)]:
        yield from (_Found(point, None, label, score, point=True) for point in points)
        return
    for key, inner in node.value.items():
        generic = key.strip().lower() in _GENERIC or key.isdigit()
        yield from _boxes(inner, order, label or ("" if generic else key), inner.start)


def _points(node: Node, order: Order) -> Iterator[tuple[Node, ...]]:
    """The points in a value, each as x y x y: two numbers, x and y by name, or a list of these."""
    if isinstance(node.value, dict):
        pair = tuple(node.value[key] for key in ("x", "y") if key in node.value)
        if len(pair) == 2 and all(isinstance(entry.value, float) for entry in pair):
            yield pair * 2
    elif len(pair := _numbers(node)) == 2:
        yield (pair if order == "xyxy" else pair[::-1]) * 2
    elif isinstance(node.value, list):
        for entry in node.value:
            yield from _points(entry, order)


def _named_corners(fields: dict[str, Node]) -> tuple[Node, ...]:
    for names in (*_CORNERS, *_SIDES):
        found = tuple(fields[name] for name in names.split() if name in fields)
        if len(found) == 4 and all(isinstance(entry.value, float) for entry in found):
            x, y, across, down = found
            if names in _SIDES:
                across, down = replace(across, value=x.value + across.value), replace(down, value=y.value + down.value)
            return x, y, across, down
    return ()


def _opposite_corners(fields: dict[str, Node], order: Order) -> tuple[Node, ...]:
    for names in _OPPOSITE:
        points = [[*_points(fields[name], order)] for name in names if name in fields]
        if [len(each) for each in points] == [1, 1]:
            return (*points[0][0][:2], *points[1][0][:2])
    return ()


# Without lists: XML, names, tokens of places, or bare numbers.
_N = r"[-+]?(?:\d+(?:\.\d+)?|\.\d+)"
_NAMES = sorted({name for names in (*_CORNERS, *_SIDES) for name in names.split()}, key=len, reverse=True)
_RANGE = r"(?!\d|\.\d|\s?%|\s*(?:[-–—~]|to\b)\s*[\d.])"  # x: 30 to 50 is no corner
_NAMED = re.compile(rf"\b({'|'.join(_NAMES)})[\"'`*]*\s*(?:=|:|>|\bis\b)\s*[\"'`]?({_N})(\s?%)?{_RANGE}", re.IGNORECASE)
_POINT_TAG = re.compile(r"<points?\b([^<>]*)>([^<]*)", re.IGNORECASE)
_ATTRIBUTE = re.compile(rf"\b[xy]\d*\s*=\s*[\"']?({_N})", re.IGNORECASE)
_LOC = re.compile(r"<loc(_?)(\d+)>" + r"\s*<loc_?(\d+)>" * 3)
_RUN = re.compile(rf"(?<![\w.]){_N}(?:[^\S\n]*[,;][^\S\n]*{_N}|[^\S\n]+{_N})*(?![\w])")


def _marked(text: str, order: Order) -> Iterator[_Found]:
    """The boxes or points in a text without lists: of the first kind that there is."""

    def nodes(matches: Iterable[re.Match[str]], group: int = 0, after: int = 0) -> tuple[Node, ...]:
        return tuple(Node(float(m[group]), after + m.start(group), after + m.end(group)) for m in matches)

    found: list[_Found] = []
    for loc in _LOC.finditer(text):  # Florence-2: thousandths, x first; PaliGemma: of 1024, y first
        parts = [(int(loc[group]) + 0.5) / (1000 if loc[1] else 1024) for group in range(2, 6)]
        written = tuple(Node(part, loc.start(), loc.end()) for part in parts)
        found.append(_Found(written if loc[1] else tuple(written[place] for place in (1, 0, 3, 2))))
    for tag in _POINT_TAG.finditer(text):
        if numbers := nodes(_ATTRIBUTE.finditer(tag[1]), 1, tag.start(1)):
            pairs = zip(numbers[::2], numbers[1::2], strict=False)
        else:
            numbers = nodes(re.finditer(_N, tag[2]), 0, tag.start(2))
            pairs = zip(*(numbers[place::2] for place in ((0, 1) if order == "xyxy" else (1, 0))), strict=False)
        found += [_Found((x, y, x, y), point=True) for x, y in pairs]
    if found:
        yield from found
        return
    fields: dict[str, Node] = {}
    for match in _NAMED.finditer(text):
        name = match[1].lower()
        fields = {} if name in fields else fields
        (fields[name],) = nodes([match], 2)
        if match[3]:
            fields[name] = replace(fields[name], value=share(fields[name].value))
        if corners := _named_corners(fields):
            found.append(_Found(corners))
            fields = {}
    if not found and {"x", "y"} <= fields.keys():
        found.append(_Found((fields["x"], fields["y"]) * 2, point=True))
    if not found:
        places = (0, 1, 2, 3) if order == "xyxy" else (1, 0, 3, 2)
        runs = [nodes(re.finditer(_N, run[0]), 0, run.start()) for run in _RUN.finditer(text)]
        found = [_Found(tuple(run[place] for place in places)) for run in runs if len(run) == 4]
    yield from found


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
    if not all(math.isfinite(number) for number in written) or max(written) <= 0:  # [0, 0, 0, 0], [-1, -1, -1, -1]
        return "empty"
    parts = {"thousand": 1000, "percent": 100, "unit": 1}
    across, down = (width, height) if frame == "pixels" else (parts[frame],) * 2
    if max(written) <= 1 and not all(number.is_integer() for number in written):
        across = down = 1
    xs, ys = sorted((written[0] / across, written[2] / across)), sorted((written[1] / down, written[3] / down))
    if found.point:
        (xs, ys) = ([centre[0] - _POINT, centre[1] + _POINT] for centre in (xs, ys))
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

_YES, _NO = (frozenset(_WORDS_OF["verdicts"][side].split()) for side in ("yes", "no"))
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
