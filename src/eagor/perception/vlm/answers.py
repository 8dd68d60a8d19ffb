"""What a model's answer says: boxes, or yes or no, each with its probability where the tokens' are known.

`parse_boxes` finds four numbers that belong together, however they are written: lists, pairs of corners and named
corners, in JSON of any kind, XML or prose, complete or cut off; Florence-2's and PaliGemma's ``<loc>`` tokens; points;
numbers without any brackets. The caller says what the coordinates count: 0..1000 and pixels look alike (families.json
says what each family counts).
"""

from __future__ import annotations

import json
import math
import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from eagor._checks import shown
from eagor.errors import AnswerError

__all__ = ["AnswerError", "Box", "Frame", "Order", "Token", "parse_boxes", "parse_presence", "without_thoughts"]

Frame = Literal["pixels", "thousand", "percent", "unit"]  # pixels of the image that the model saw; parts of each side
Order = Literal["xyxy", "yxyx"]
Token = tuple[str, float]  # a piece of the answer and the natural logarithm of its probability

_PLACES = {"xyxy": (0, 1, 2, 3), "yxyx": (1, 0, 3, 2)}
_PARTS = {"thousand": 1000, "percent": 100, "unit": 1}  # of a side
_WIDE = str.maketrans("（）［］｛｝，：；％", "()[]{},:;%")  # as Chinese and Japanese texts have them
# How models say that there is none (these count only where an answer has no coordinates), and yes or no.
_WORDS_OF = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))
_ABSENT = re.compile("|".join(each for language in _WORDS_OF["absent"].values() for each in language))
_EMPTY = re.compile(r"\[\s*\]|\{\s*\}|\(\s*\)|[\[{(:,]\s*(?:null|none|false|nan)\s*[\]}),]", re.IGNORECASE)
_VERDICTS = {word: side == "yes" for side, words in _WORDS_OF["verdicts"].items() for word in words.split()}
_WORDS = re.compile(r"[^\W\d_]+")
# Marks of thoughts; some chat templates open them themselves, so that the answer only closes them.
_THOUGHT = re.compile(r"[<◁\[](?P<end>/?)\|?(?:seed:)?(?:think(?:ing)?|thoughts?|reasoning)\|?[>▷\]]", re.IGNORECASE)
# Marks of the answer, of GLM and others: what is outside leads to it.
_ANSWER = re.compile(
    r"<answer>(.*?)(?:</answer>|\Z)|<\|begin_of_box\|>(.*?)(?:<\|end_of_box\|>|\Z)|<\|channel\|>final<\|message\|>(.*?)(?:<\||\Z)",
    re.DOTALL | re.IGNORECASE,
)
_LONGEST = 200_000  # characters of an answer: thousands of boxes
_MOST_THOUGHTS = 1_000_000  # characters, with the answer
_LONGEST_ENTRY = 1000  # characters behind a box in which its score is looked for
_LEAST = 1e-6  # of the image's sides: anything smaller has no area
_POINT = 0.01  # of the image's sides: half of what a point without a size stands for
_PAST = 1.1  # coordinates beyond this many image sides are in another frame, not just inaccurate

# Numbers; lists of two to five; what is between two corners; what comes before and around them.
_N = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?(?:\s?%)?"
_SEP = r"(?:\s*,\s*|\s+)"
_NUMBER = re.compile(_N)
_LIST = re.compile(rf"[\[(;]\s*({_N}(?:{_SEP}{_N}){{1,4}})(?=\s*,?\s*([\]);]|,\Z))")
_BETWEEN = re.compile(r"\s*,?\s*[\])][^\[\](){}\d]{0,60}")
_KEY = re.compile(r"[\"']?([A-Za-z_][\w -]*?)[\"']?\s*[:=]\s*[\"']?[\s\[({]*\Z")
_POINTS = {"point_2d", "point", "points", "point2d", "xy", "center", "centre"}
_Y_FIRST = "box_2d"  # Gemini's key, whose boxes are y0 x0 y1 x1 whatever is asked for
_CUT = re.compile(r"[^\[({]*[\[({]\D*\d")  # after the last bracket that closes
_SCORE = re.compile(rf"[\"']?\b(?:score|confidence|probability|prob|conf)[\"']?\s*[:=]\s*[\"']?({_N})", re.IGNORECASE)
_CORNERS = ("xmin ymin xmax ymax", "x_min y_min x_max y_max", "x0 y0 x1 y1", "x1 y1 x2 y2", "left top right bottom")
_SIDES = ("x y width height", "x y w h", "left top width height")
_NAMES = sorted({name for names in (*_CORNERS, *_SIDES) for name in names.split()}, key=len, reverse=True)
_RANGE = r"(?![\d.%]|\s*(?:[-–—~]|to\b)\s*[\d.])"  # x: 30 to 50 is no corner
_NAMED = re.compile(rf"\b({'|'.join(_NAMES)})[\"'`*]*\s*(?:=|:|>|\bis\b)\s*[\"'`]?({_N}){_RANGE}", re.IGNORECASE)
_POINT_TAG = re.compile(r"<points?\b([^<>]*)>([^<]*)", re.IGNORECASE)
_ATTRIBUTE = re.compile(rf"\b[xy]\d*\s*=\s*[\"']?({_N})", re.IGNORECASE)
_LOC = re.compile(r"<loc(_?)(\d+)>" + r"\s*<loc_?(\d+)>" * 3)
_RUN = re.compile(rf"(?<![\w.]){_N}(?:[^\S\n]*[,;][^\S\n]*{_N}|[^\S\n]+{_N})*(?![\w])")


class Box(NamedTuple):
    """A detection in fractions of the image's width and height, [0, 1], with x0 < x1 and y0 < y1; y grows down."""

    x0: float
    y0: float
    x1: float
    y1: float
    score: float = 1.0


class _Coordinates(NamedTuple):
    """Four coordinates as written, x0 y0 x1 y1 (equal corners for a point), where they stand, and a written score.

    `decided`: the text in which the model decided to write them, from the list's opening, or the last entry, on.
    """

    numbers: tuple[float, ...]
    places: tuple[int, ...] = ()
    decided: tuple[int, int] | None = None
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
        tokens: the pieces of the answer with log probabilities, which give the scores (`_box`); without them 1.

    A point becomes a small box. Boxes without area ([0, 0, 0, 0] says that there is none), duplicates, and boxes far
    outside are left out. Raises `AnswerError` if nothing can be read, or if all coordinates lie far outside the frame.
    """
    answer = _spoken(text)
    found = _listed(answer, order) or [*_tagged(answer, order)] or [*_named(answer)]
    if not found and not _CUT.match(answer, max(map(answer.rfind, "])}")) + 1):
        found = [*_bare(answer, order)]
    if not found:
        lower = answer.lower().replace("\N{RIGHT SINGLE QUOTATION MARK}", "'")
        if _EMPTY.search(lower) or _ABSENT.search(lower):
            return []
        raise AnswerError(
            f"the model answered {_shortened(text)}; wanted boxes as a JSON list, [] if there are none. If it was cut "
            "off, allow more tokens; if the model does not write boxes, use extractor 'views' (or 'attention', locally)"
        )
    trace = Trace(text, tokens) if tokens else None
    read = [_box(box, frame, size, trace) for box in found]
    if all(box == "outside" for box in read):
        raise AnswerError(
            f"the model answered {_shortened(text)}, which lies outside the frame {frame!r} of a {size[1]} x {size[0]} "
            "image; is that what this model's coordinates count, and does its server leave the image's size alone?"
        )
    best: dict[tuple[float, ...], Box] = {}
    for box in read:
        if isinstance(box, Box):
            best[box[:4]] = max(best.get(box[:4], box), box, key=lambda each: each.score)
    return list(best.values())


def parse_presence(text: str, first: Sequence[Token] | None = None) -> float:
    """The probability in [0, 1] that a model's answer to `eagor.perception.vlm.ask_presence` means yes.

    `first` holds the likeliest tokens at the place of the answer, with log probabilities. The result is then the share
    of yes among yes and no; if only one side is listed, the other gets the rest of the probability. Without `first` it
    is 1 for yes and 0 for no. Raises `AnswerError` if the answer is neither.
    """
    answer = _spoken(text)
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
    meant = next((meant for word in _WORDS.findall(answer.lower()) if (meant := means(word)) is not None), None)
    if meant is None:
        raise AnswerError(f"the model answered {_shortened(text)}; wanted yes or no. Can it see images?")
    return float(meant)


def means(word: str) -> bool | None:
    """True for yes, False for no, None for neither."""
    return _VERDICTS.get("".join(_WORDS.findall(word.lower())))


# --- what was thought, and what was said ------------------------------------------------------------------------------


def _spoken(text: str) -> str:
    """`text` without thoughts. Raises `AnswerError` if it is far too long."""
    answer = without_thoughts(text).translate(_WIDE) if len(text) <= _MOST_THOUGHTS else text
    if len(answer.strip()) > _LONGEST:
        raise AnswerError(
            f"the model answered {_shortened(text)} and so on, {len(text)} characters; wanted a short answer. Allow "
            "fewer tokens (max_tokens=...)"
        )
    return answer


def without_thoughts(text: str) -> str:
    """`text` with all thoughts blanked out, and all outside of the marks of an answer; the rest keeps its places."""
    spans, place, thinks = [], 0, False
    for mark in _THOUGHT.finditer(text):
        if mark["end"]:  # what came before was thought, opened or not
            place, thinks = mark.end(), False
        elif not thinks:
            spans.append((place, mark.start()))
            place, thinks = mark.start(), True
    bare = _only(text, spans if thinks else [*spans, (place, len(text))])
    marked = [answer.span(answer.lastindex or 0) for answer in _ANSWER.finditer(bare)]
    return _only(bare, marked) if any(bare[start:end].strip() for start, end in marked) else bare


def _only(text: str, spans: Sequence[tuple[int, int]]) -> str:
    """`text` with blanks outside of `spans`, which are in order."""
    parts, place = [], 0
    for start, end in spans:
        parts += [" " * (start - place), text[start:end]]
        place = end
    return "".join(parts) + " " * (len(text) - place)


def _shortened(text: str) -> str:
    """`text` on one line and in quotes, for an error."""
    return shown(" ".join(text.split()), 200)


# --- where the numbers are --------------------------------------------------------------------------------------------


def _number(written: str) -> float:
    """A number; a share with a sign of percent, by which it is no whole number."""
    bare = written.rstrip("% \t\n")
    return math.nextafter(float(bare) / 100, 0.5) if written.endswith("%") else float(bare)


def _listed(text: str, order: Order) -> list[_Coordinates]:
    """The boxes that are lists of four numbers or pairs of corners, or else the points that are lists of two."""
    lists: list[tuple[int, int, list[re.Match[str]]]] = []  # start, stop, numbers
    for match in _LIST.finditer(text):
        numbers = [*_NUMBER.finditer(text, *match.span(1))]
        start, stop, before = lists[-1] if lists else (0, 0, [])
        two = len(numbers) == 2 and match[0][0] != ";" and match[2] in ("]", ")")
        if two and len(before) == 2 and _BETWEEN.fullmatch(text, stop, match.start()):
            lists[-1] = (start, match.end(2), before + numbers)
        elif two or len(numbers) > 3:
            lists.append((match.start(), match.end(), numbers))
    boxes: list[_Coordinates] = []
    points: list[_Coordinates] = []
    end, last, key = 0, 0, None
    for start, stop, found in lists:
        before = text[max(last, start - 200) : start]
        if key is None or not re.fullmatch(r"[\s,;()\[\]]*", before):  # else one of several values of a key
            named = _KEY.search(before)
            key = named[1].strip().lower().replace(" ", "_").replace("-", "_") if named else ""
        numbers, last = [_number(each[0]) for each in found], stop
        if len(numbers) == 2 and key in _POINTS:
            points.append(_Coordinates(tuple(numbers if order == "xyxy" else numbers[::-1]) * 2, point=True))
        if len(numbers) == 2 or key in _POINTS or not all(0 <= fifth <= 1 for fifth in numbers[4:]):
            continue
        places = _PLACES["yxyx" if key == _Y_FIRST else order]
        decided, score = _entry(text, start, stop, end)
        score, end = (*numbers[4:], score)[0], stop
        ordered, starts = tuple(numbers[at] for at in places), tuple(found[at].start() for at in places)
        boxes.append(_Coordinates(ordered, starts, decided, score))
    return boxes or points


def _entry(text: str, start: int, stop: int, end: int) -> tuple[tuple[int, int], float | None]:
    """Where the model decided to write the box in [`start`, `stop`), and its written score; `end`: of the last box.

    That is where the object with the box opens, or the list itself, and the brackets and commas right before that.
    """
    entry = text.rfind("{", end, start)
    entry = start if entry < text.rfind("}", end, start) or entry < 0 else entry
    before = text[end:entry]
    decided = entry - len(before[len(before.rstrip(" \t\r\n,[({")) :].lstrip()), entry + 1
    close = text.find("}", stop, stop + _LONGEST_ENTRY)
    for part in (text[max(entry, end) : start], text[stop : close if close >= 0 else stop + _LONGEST_ENTRY]):
        if written := _SCORE.search(part):
            score = float(written[1].rstrip("% "))
            return decided, None if not 0 <= score <= 100 else score if score <= 1 else score / 100
    return decided, None


def _named(text: str) -> Iterator[_Coordinates]:
    """The boxes whose corners have names: in objects, in XML, in prose; or one point x, y."""
    fields: dict[str, tuple[float, int]] = {}
    end, count = 0, 0
    for match in _NAMED.finditer(text):
        name, count = match[1].lower(), count + 1
        fields = {} if name in fields else fields
        fields[name] = _number(match[2]), match.start(2)
        names = next((each for each in (*_CORNERS, *_SIDES) if {*each.split()} <= fields.keys()), None)
        if names is None:
            continue
        (x, y, across, down), places = zip(*(fields[each] for each in names.split()), strict=True)
        if names in _SIDES:
            across, down = x + across, y + down
        opened = text.rfind("{", end, min(places))
        decided, score = _entry(text, opened, match.end(), end) if opened >= 0 else (None, None)
        yield _Coordinates((x, y, across, down), places, decided, score)
        fields, end = {}, match.end()
    if not end and count == 2 and {"x", "y"} <= fields.keys():
        yield _Coordinates((fields["x"][0], fields["y"][0]) * 2, point=True)


def _tagged(text: str, order: Order) -> Iterator[_Coordinates]:
    """The boxes as tokens of places, and the points as tags."""
    for loc in _LOC.finditer(text):  # Florence-2: thousandths, x first; PaliGemma: of 1024, y first
        parts = [(int(loc[group]) + 0.5) / (1000 if loc[1] else 1024) for group in range(2, 6)]
        yield _Coordinates(tuple(parts[place] for place in _PLACES["xyxy" if loc[1] else "yxyx"]))
    for tag in _POINT_TAG.finditer(text):
        numbers, own = [*map(_number, _ATTRIBUTE.findall(tag[1]))], (0, 1)
        if not numbers:
            numbers, own = [*map(_number, _NUMBER.findall(tag[2]))], _PLACES[order][:2]
        for xy in zip(*(numbers[place::2] for place in own), strict=False):
            yield _Coordinates(xy * 2, point=True)


def _bare(text: str, order: Order) -> Iterator[_Coordinates]:
    """Four numbers side by side."""
    runs = ([*map(_number, _NUMBER.findall(run[0]))] for run in _RUN.finditer(text))
    yield from (_Coordinates(tuple(run[place] for place in _PLACES[order])) for run in runs if len(run) == 4)


# --- from coordinates to boxes, and which token a character came from -------------------------------------------------


def _box(found: _Coordinates, frame: Frame, size: tuple[int, int], trace: Trace | None) -> Box | str:
    """The box in fractions, or the reason for none: "outside" or "empty"."""
    written = found.numbers
    if not all(math.isfinite(number) for number in written) or max(written) <= 0:  # [0, 0, 0, 0], [-1, -1, -1, -1]
        return "empty"
    across, down = size[::-1] if frame == "pixels" else (_PARTS[frame],) * 2
    if max(written) <= 1 and not all(number.is_integer() for number in written):
        across = down = 1
    xs, ys = sorted((written[0] / across, written[2] / across)), sorted((written[1] / down, written[3] / down))
    if found.point:
        xs, ys = ([centre[0] - _POINT, centre[1] + _POINT] for centre in (xs, ys))
    if min(xs[0], ys[0]) < 1 - _PAST or max(xs[1], ys[1]) > _PAST or max(xs[0], ys[0]) >= 1 or min(xs[1], ys[1]) <= 0:
        return "outside"
    x0, y0, x1, y1 = (min(max(value, 0.0), 1.0) for value in (xs[0], ys[0], xs[1], ys[1]))
    if not (x1 - x0 > _LEAST and y1 - y0 > _LEAST):
        return "empty"
    score = found.score
    if score is None and trace and found.decided:
        # The probability of opening the entry, times the geometric mean over the first tokens of its numbers.
        begun = sum(trace.log_probability(place, place + 1) for place in found.places) / len(found.places)
        score = math.exp(trace.log_probability(*found.decided) + begun)
    return Box(x0, y0, x1, y1, 1.0 if score is None else score)


class Trace:
    """The log probabilities of an answer's `tokens` by place in its text; those that it does not hold are skipped."""

    def __init__(self, text: str, tokens: Sequence[Token]) -> None:
        self._pieces: list[tuple[int, int, float]] = []  # start, end, logarithm
        place = 0
        for piece, log in tokens:
            at = place if piece and text.startswith(piece, place) else -1
            if at < 0 and len(piece.strip()) > 1:
                at = text.find(piece, place, place + 64)
            if at >= 0:
                place = at + len(piece)
                self._pieces.append((at, place, min(float(log), 0.0)))

    def log_probability(self, start: int, stop: int) -> float:
        """Of all tokens together that have a character in [`start`, `stop`); 0 where none is known."""
        first = bisect_right(self._pieces, start, key=lambda piece: piece[1])
        return sum(log for _, _, log in self._pieces[first : bisect_left(self._pieces, (stop,))])
