"""What a model's answer says: boxes, or yes or no, each with its probability where the tokens' are known.

`parse_boxes` finds four numbers that belong together, however they are written: lists, pairs of corners and named
corners, in JSON of any kind, XML or prose, complete or cut off; Florence-2's and PaliGemma's ``<loc>`` tokens; points;
numbers without any brackets. The caller says what the coordinates count: 0..1000 and pixels look alike (families.json
says what each family counts).
"""

from __future__ import annotations

import math
import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

from eagor._checks import shown
from eagor.errors import AnswerError
from eagor.perception.vlm.thoughts import CHANGED, TABLES, any_of, without_thoughts

__all__ = ["AnswerError", "Box", "Frame", "Order", "Token", "parse_boxes", "parse_presence", "verdict"]

Frame = Literal["pixels", "thousand", "percent", "unit"]  # pixels of the image that the model saw; parts of each side
Order = Literal["xyxy", "yxyx"]
Token = tuple[str, float]  # a piece of the answer and the natural logarithm of its probability

_PLACES = {"xyxy": (0, 1, 2, 3), "yxyx": (1, 0, 3, 2)}
_PARTS = {"thousand": 1000, "percent": 100, "unit": 1}  # of a side
_WIDE = str.maketrans("（）［］｛｝，、：；％", "()[]{},,:;%")  # as Chinese and Japanese texts have them
# How models say that there is none (these count only where an answer has no coordinates), that they saw no picture,
# and yes or no; what four numbers can be.
_ABSENT, _BLIND = (any_of(*(way for ways in TABLES[table].values() for way in ways)) for table in ("absent", "blind"))
_UNSURE, _DENIED = any_of(TABLES["unsure"]), any_of(TABLES["denied"])
_QUOTED = re.compile(r"\"[^\"]*\"|(?<!\w)'[^']*'(?!\w)")
_NAMING = r"[\"']?\b(?:label|name|class|category)[\"']?\s*[:=]\s*"
_LABEL = any_of(rf"{_NAMING}(?:([\"'])(.*?)\1|([^\W\d][^\"',{{}}\[\]\n]*))")
# What stands before a box and names it: the key of its list, or of the object around it; a tag; a line or an item.
_KEYED = r"[\[({\s]*(?:[\"']?\w+[\"']?\s*[:=]\s*[\[({\s]*)?\Z"
_CALLED = any_of(
    rf"[\"']([^\"'{{}}\[\]:<>]{{1,60}})[\"']\s*:\s*{_KEYED}",
    r"<\|?(?:object_)?ref(?:_start)?\|?>([^<]{1,60})<[^<>]*>\s*(?:<[^<>]*>)?[\[({\s]*\Z",
    r"<(?:name|label|class)>([^<]{1,60})</[^\"']{0,100}\Z",
    rf"(?:^|\n)[ \t]*(?:[-*]|\d+[.)])[ \t*]*(?:{_NAMING})?([^\W\d][\w ]{{0,40}}?)\**\s*[:,\n]\s*{_KEYED}",
)
_NO_LABEL = any_of(TABLES["no labels"])  # keys of boxes, whatever they show
_EMPTY = any_of(r"\[\s*\]|\{\s*\}|\(\s*\)|<(\w+)>\s*</\1>|[\[{(:,]\s*(?:null|none|false|nan)\s*[\]}),]")
# Words that decide by themselves, and those that do where none of these is.
_SURE, _WEAK = (
    {word: side == "yes" for side, words in TABLES[table].items() for word in words.split()}
    for table in ("verdicts", "weak verdicts")
)
_WORDS = re.compile(r"[^\W\d_]+")
_NO_VERDICT = any_of(r"[\"']\w+[\"']\s*:|\byes\s*(?:/|\bor\b|\band\b)\s*no\b|\bno (?:doubt|problem|question)\b")
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
_LIST = re.compile(rf"[\[(;]\s*({_N}(?:{_SEP}{_N}){{1,7}})(?=\s*,?\s*([\]);]|,\Z))")
_BETWEEN = re.compile(r"\s*,?\s*[\])][^\[\](){}\d]{0,60}")
_KEY = re.compile(r"[\"']?([A-Za-z_][\w -]*?)[\"']?\s*[:=]\s*[\"']?[\s\[({]*\Z")
_POINTS = {"point_2d", "point", "points", "point2d", "xy", "center", "centre"}
_CORNER_KEYS = ("box_2d", "box2d", "bbox_2d")  # which never mean sides: corners may be exchanged
_NO_BOX = re.compile(r"colou?rs?|\w*_rgba?|rgba?|\w*size|resolution|dimensions?|shape|mask|out_of|\w*range")
# What four numbers are, by words near them: `_form`. Gemini's key, whose boxes are y first whatever is asked for.
_BETWEEN_NAMES = r"[\s,_/'\"*-]*"
_FORM = any_of(*(f"(?P<{form}>(?<![a-z])(?:{'|'.join(ways).replace(' ', _BETWEEN_NAMES)})n?(?![a-z]))"
               for form, ways in TABLES["forms"].items()))  # fmt: skip
_Y_FIRST = any_of(r"(?<![a-z])box_?2d\W*\Z")
# Signs about numbers, and pictures as text: read as blanks.
_SIGNS = any_of(rf"data:image[^\"'\s]*|(?<=\d)px\b|(?<=[\[,:\s])[\"'](?={_N}[\"'])|(?<=[\d.%])[\"'](?=\s*[,\]])")
_CUT = re.compile(r"[^\[({]*[\[({]\D*\d")  # after the last bracket that closes
_SCORE = re.compile(rf"[\"']?\b(?:score|confidence|probability|prob|conf)[\"']?\s*[:=]\s*[\"']?({_N})", re.IGNORECASE)
_CORNERS = ("xmin ymin xmax ymax", "x_min y_min x_max y_max", "x0 y0 x1 y1", "x1 y1 x2 y2", "left top right bottom")
_MIDDLES = ("cx cy w h", "cx cy width height", "x_center y_center width height", "center_x center_y width height")
_SIDES = ("x y width height", "x y w h", "left top width height", *_MIDDLES)
_CENTRED = any_of(r"cent(?:er|re)[\"']?\s*[:=]\s*[{(]\s*[\"']?x\W*\Z")
_NAMES = sorted({name for names in (*_CORNERS, *_SIDES) for name in names.split()}, key=len, reverse=True)
_RANGE = r"(?![\d.%]|\s*(?:[-–—~]|to\b)\s*[\d.])"  # x: 30 to 50 is no corner
_NAMED = re.compile(rf"\b({'|'.join(_NAMES)})[\"'`*]*\s*(?:=|:|>|\bis\b)\s*[\"'`]?({_N}){_RANGE}", re.IGNORECASE)
_POINT_TAG = re.compile(r"<(?:points?|tracks)\b([^<>]*)>([^<]*)", re.IGNORECASE)
_MOLMO2 = re.compile(r"\b\d+ (\d{3,4}) (\d{3,4})\b")  # in coords="...": number, x, y in thousandths
_ATTRIBUTE = re.compile(rf"\b[xy]\d*\s*=\s*[\"']?({_N})", re.IGNORECASE)
_LOC = re.compile(r"<loc(_?)(\d+)>" + r"\s*<loc_?(\d+)>" * 3)
_RUN = re.compile(rf"(?<![\w.]){_N}(?:[^\S\n]*[,;][^\S\n]*{_N}|[^\S\n]+{_N})*(?![\w])")


class Box(NamedTuple):
    """A detection in fractions of the image's width and height, [0, 1], with x0 < x1 and y0 < y1; y grows down.

    `label`: what the model calls it, "" where it does not say.
    """

    x0: float
    y0: float
    x1: float
    y1: float
    score: float = 1.0
    label: str = ""


class _Coordinates(NamedTuple):
    """Four coordinates as written, x0 y0 x1 y1 (equal corners for a point), where they stand, and a written score.

    `decided`: the text in which the model decided to write them, from the list's opening, or the last entry, on.
    `score`: below 0 where the entry says that there is none. `ordered`: the first corner is the upper left one.
    """

    numbers: tuple[float, ...]
    places: tuple[int, ...] = ()
    decided: tuple[int, int] | None = None
    score: float | None = None
    point: bool = False
    ordered: bool = False


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

    A point becomes a small box. [0, 0, 0, 0] says that there is none; duplicates, and boxes without area or far outside
    are left out beside others. Raises `AnswerError` if nothing can be read, for a model that saw no picture, for boxes
    that it takes back, and where numbers seem to count something else: all without area or far outside, some in pixels.
    """
    answer = _spoken(text)
    found = _listed(answer, order) or [*_tagged(answer, order)] or [*_named(answer)]
    if not found and not _CUT.match(answer, max(map(answer.rfind, "])}")) + 1):
        found = [*_bare(answer, order)]
    if not found:
        lower = _plain(answer)
        if not _BLIND.search(lower) and any(way.search(lower) for way in (_EMPTY, _DENIED, _ABSENT)):
            return []
        raise AnswerError(
            f"the model answered {_shortened(text)}; wanted boxes as a JSON list, [] if there are none. If it was cut "
            "off, allow more tokens; if the model does not write boxes, use extractor 'views' (or 'attention', "
            "locally); if it sees no pictures, name a vision-language model"
        )
    trace = Trace(text, tokens) if tokens else None
    read = [_box(box, frame, size, trace) for box in found]
    pairs = zip(read, _labels(answer, found), strict=True)
    boxes = [box._replace(label=label) for box, label in pairs if isinstance(box, Box)]
    wrong = next((reason for reason in _WRONG if reason in read), "")
    numbers = [number for box in found for number in box.numbers]
    if frame == "thousand" and 1 < max(numbers) <= 100 and not all(number.is_integer() for number in numbers):
        wrong = "percent"
    if wrong in ("inverted", "pixels", "percent") or (wrong and not boxes):
        raise AnswerError(f"the model answered {_shortened(text)}, {_WRONG[wrong].format(frame, *size[::-1])}")
    first = min((min(box.places) for box in found if box.places), default=0)
    if _ABSENT.search(_QUOTED.sub(" ", _plain(answer[:first]))):
        raise AnswerError(f"the model answered {_shortened(text)}: that there is none, and boxes; wanted one of them")
    ends = [(min(box.places), max(box.places)) for box in found if box.places]
    if any(CHANGED.search(answer, one[1], other[0]) for one, other in pairwise(ends)):
        raise AnswerError(f"the model answered {_shortened(text)}, and takes boxes back; wanted the last ones alone")
    best: dict[tuple[float, ...], Box] = {}
    for box in boxes:
        best[box[:4]] = max(best.get(box[:4], box), box, key=lambda each: each.score)
    return list(best.values())


_WRONG = {  # why boxes are none; of several reasons the first
    "inverted": "with corners in the wrong order; wanted x0, y0, x1, y1. Are they x, y, width, height?",
    "pixels": "which lies outside the frame {!r}, but inside the {} x {} image: does this model count its pixels "
    "(frame=pixels)?",
    "flat": "which has no area; wanted x0, y0, x1, y1. Are they x, y, width, height?",
    "outside": "which lies outside the frame {!r} of a {} x {} image; is that what this model's coordinates count, and "
    "does its server leave the image's size alone?",
    "percent": "where whole numbers up to 1000 were wanted: does this model count percents (frame=percent)?",
}


def parse_presence(text: str, first: Sequence[Token] | None = None) -> float:
    """The probability in [0, 1] that a model's answer to `eagor.perception.vlm.ask_presence` means yes.

    `first` holds the likeliest tokens at the place of the answer, with log probabilities. The result is then the share
    of yes among yes and no; if only one side is listed, the other gets the rest of the probability. Without `first` it
    is 1 for yes and 0 for no. Raises `AnswerError` if the answer is neither.
    """
    answer = _plain(_spoken(text))
    if _BLIND.search(answer):
        raise AnswerError(f"the model answered {_shortened(text)}: it saw no picture; name a vision-language model")
    _, meant = verdict(text)
    if meant is None:
        raise AnswerError(f"the model answered {_shortened(text)}; wanted yes or no. Can it see images?")
    shares, listed = [0.0, 0.0], 0.0
    for piece, log in first or ():
        probability, side = math.exp(min(float(log), 0.0)), means(piece)
        listed += probability
        if side is not None:
            shares[side] += probability
    if sum(shares) > 0:
        if min(shares) == 0:
            shares[shares.index(0.0)] = max(0.0, 1 - listed)
        return shares[1] / sum(shares)
    return float(meant)


def verdict(text: str) -> tuple[int, bool | None]:
    """Where the word stands that decides, and whether it means yes; -1 where no single word does, None for neither.

    A word that always decides ("no") comes before one that may not ("not").
    """
    answer = _NO_VERDICT.sub(lambda part: " " * len(part[0]), _plain(_spoken(text)))
    tables = (_SURE,) if _UNSURE.search(answer) else (_SURE, _WEAK)
    words = [*_WORDS.finditer(answer)]
    found = ((word.start(), table[word[0]]) for table in tables for word in words if word[0] in table)
    return next(found, (-1, False if len(tables) > 1 and _ABSENT.search(answer) else None))


def means(word: str) -> bool | None:
    """True for yes, False for no, None for neither."""
    bare = "".join(_WORDS.findall(word.lower()))
    return _SURE.get(bare, _WEAK.get(bare))


def _spoken(text: str) -> str:
    """`text` without thoughts. Raises `AnswerError` if it is far too long."""
    answer = text
    if len(text) <= _MOST_THOUGHTS:
        answer = without_thoughts(text).translate(_WIDE)
        answer = _SIGNS.sub(lambda sign: " " * len(sign[0]), answer)
    if len(answer.strip()) > _LONGEST:
        raise AnswerError(
            f"the model answered {_shortened(text)} and so on, {len(text)} characters; wanted a short answer. Allow "
            "fewer tokens (max_tokens=...)"
        )
    return answer


def _plain(text: str) -> str:
    """In small letters, with straight apostrophes."""
    return text.lower().replace("\N{RIGHT SINGLE QUOTATION MARK}", "'")


def _shortened(text: str) -> str:
    """`text` on one line and in quotes, for an error."""
    return shown(" ".join(text.split()), 200)


# --- where the numbers are --------------------------------------------------------------------------------------------


def _number(written: str) -> float:
    """A number; a share with a sign of percent, by which it is no whole number."""
    bare = written.rstrip("% \t\n")
    return math.nextafter(float(bare) / 100, 0.5) if written.endswith("%") else float(bare)


def _listed(text: str, order: Order) -> list[_Coordinates]:
    """The boxes that are lists of four numbers, pairs of corners or polygons, or else the points that are lists of two.

    Lists of other things (colours, sizes) are left out.
    """
    lists: list[tuple[int, int, str, list[re.Match[str]]]] = []  # start, stop, key, numbers
    last, key = 0, ""
    for match in _LIST.finditer(text):
        before = text[max(last, match.start() - 200) : match.start()]
        if not lists or not re.fullmatch(r"[\s,;()\[\]]*", before):  # else one of several values of a key
            named = _KEY.search(before)
            key = named[1].strip().lower().replace(" ", "_").replace("-", "_") if named else ""
        numbers, last = [*_NUMBER.finditer(text, *match.span(1))], match.end()
        if not _NO_BOX.fullmatch(key):
            lists.append((match.start(), match.end(), key, numbers))
    boxes: list[_Coordinates] = []
    points: list[_Coordinates] = []
    end, at, forms = 0, 0, [*_FORM.finditer(text)]
    while at < len(lists):
        (start, stop, key, found), at = lists[at], at + 1
        chain, axes, tight = [found], key, text[start] == "["
        while len(found) == 2 and at < len(lists):
            begin, behind, name, more = lists[at]
            if len(more) > 2 or not _BETWEEN.fullmatch(text, stop, begin):
                break
            tight = tight and not text[stop:begin].strip(" \t\r\n,])")
            chain, axes, stop, at = [*chain, more], axes + name, behind, at + 1
        if key in _POINTS:
            pairs = chain if len(found) == 2 and (key == "points" or len(chain) == 1) else []
            for x, y in ((_number(pair[place][0]) for place in _PLACES[order][:2]) for pair in pairs):
                points.append(_Coordinates((x, y, x, y), point=True))
            continue
        form = "yxyx" if key in _CORNER_KEYS[:2] else _form(text, forms, start, order)
        for numbers in _boxes_in(chain, tight):
            values = [_number(each[0]) for each in numbers]
            listed = len(chain) == 1 and len(values) < 8
            if listed and not all(0 <= fifth <= 1 for fifth in values[4:5]):
                continue
            decided, score = _entry(text, start if listed else numbers[0].start() - 1, numbers[-1].end(), end)
            score, end = (*values[4:5], score)[0] if listed else score, numbers[-1].end()
            if not listed:
                x, y = values[::2], values[1::2]
                x, y = (values[:2], values[2:]) if axes == "xy" else (y, x) if form == "yxyx" else (x, y)
                values = [min(x), min(y), max(x), max(y)]
            places = _PLACES.get(form, _PLACES["xyxy"]) if listed else (0, 1, 2, 3)
            starts = tuple(numbers[place].start() for place in places)
            corners = _decode_xyxy(values, form) if listed else tuple(values)
            ordered = listed and key not in _CORNER_KEYS
            boxes.append(_Coordinates(corners, starts, decided, score, ordered=ordered))
    return boxes or points


def _boxes_in(chain: list[list[re.Match[str]]], tight: bool) -> Iterator[list[re.Match[str]]]:
    """The numbers of each box in a list, or in a chain of pairs: corners by two, or (`tight`: in a list) a polygon."""
    if len(chain) == 1:
        yield from (found for found in chain if len(found) in (4, 5, 6, 8))
        return
    flat = any(one[at][0] == two[at][0] for one, two in zip(chain[::2], chain[1::2], strict=False) for at in (0, 1))
    step = len(chain) if len(chain) > 2 and (tight or flat or len(chain) % 2) else 2
    for at in range(0, len(chain), step):
        yield [number for pair in chain[at : at + step] for number in pair]


def _form(text: str, forms: Sequence[re.Match[str]], start: int, order: Order) -> str:
    """What four numbers at `start` are: by Gemini's key, the last words before them, or else the first behind."""
    if _Y_FIRST.search(text, max(0, start - 40), start):
        return "yxyx"
    place = bisect_right(forms, start, key=lambda each: each.end()) - 1
    return str(forms[max(place, 0)].lastgroup) if forms else order


def _decode_xyxy(numbers: Sequence[float], form: str) -> tuple[float, ...]:
    """x0 y0 x1 y1 of numbers in some `form`, by its name."""
    a, b, c, d = numbers[:4]
    across, down = (c / 2, d / 2) if form == "cxcywh" else (0.0, 0.0)
    return {
        "yxyx": (b, a, d, c), "xywh": (a, b, a + c, b + d), "cxcywh": (a - across, b - down, a + across, b + down),
    }.get(form, (a, b, c, d))  # fmt: skip


def _entry(text: str, start: int, stop: int, end: int) -> tuple[tuple[int, int], float | None]:
    """Where the model decided to write the box in [`start`, `stop`), and its written score; `end`: of the last box.

    That is where the object with the box opens, or the list itself, and the brackets and commas right before that.
    """
    entry = text.rfind("{", end, start)
    entry = start if entry < text.rfind("}", end, start) or entry < 0 else entry
    before = text[end:entry]
    decided = entry - len(before[len(before.rstrip(" \t\r\n,[({")) :].lstrip()), entry + 1
    close = text.find("}", stop, stop + _LONGEST_ENTRY)
    if text[entry] == "{" and _DENIED.search(text, entry, close + 1):
        return decided, -1.0
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
            middle = names in _MIDDLES or _CENTRED.search(text, max(0, places[0] - 40), places[0])
            x, y, across, down = _decode_xyxy((x, y, across, down), "cxcywh" if middle else "xywh")
        opened = text.rfind("{", end, min(places))
        decided, score = _entry(text, opened, match.end(), end) if opened >= 0 else (None, None)
        yield _Coordinates((x, y, across, down), places, decided, score)
        fields, end = {}, match.end()
    if not end and count == 2 and {"x", "y"} <= fields.keys():
        yield _Coordinates((fields["x"][0], fields["y"][0]) * 2, point=True)


def _tagged(text: str, order: Order) -> Iterator[_Coordinates]:
    """The boxes as tokens of places, and the points as tags."""
    for loc in _LOC.finditer(text):  # Florence-2: thousandths, x first; PaliGemma: of 1024, y first
        bins = [int(loc[group]) for group in range(2, 6)]
        parts = [(each + 0.5) / (1000 if loc[1] else 1024) if any(bins) else 0.0 for each in bins]
        yield _Coordinates(tuple(parts[place] for place in _PLACES["xyxy" if loc[1] else "yxyx"]))
    for tag in _POINT_TAG.finditer(text):
        numbers, own = [*map(_number, _ATTRIBUTE.findall(tag[1]))], (0, 1)
        if "coords" in tag[1]:
            numbers = [int(part) / 1000 for point in _MOLMO2.findall(tag[1]) for part in point]
        if not numbers:
            numbers, own = [*map(_number, _NUMBER.findall(tag[2]))], _PLACES[order][:2]
        for xy in zip(*(numbers[place::2] for place in own), strict=False):
            yield _Coordinates(xy * 2, point=True)


def _bare(text: str, order: Order) -> Iterator[_Coordinates]:
    """Four numbers side by side."""
    runs = [(run.start(), [*map(_number, _NUMBER.findall(run[0]))]) for run in _RUN.finditer(text)]
    forms = [*_FORM.finditer(text)]
    for start, run in runs:
        if len(run) == 4:
            yield _Coordinates(_decode_xyxy(run, _form(text, forms, start, order)), ordered=True)


# --- from coordinates to boxes, and which token a character came from -------------------------------------------------


def _box(found: _Coordinates, frame: Frame, size: tuple[int, int], trace: Trace | None) -> Box | str:
    """The box in fractions, or the reason for none: a key of `_WRONG`, or "empty" where it says that there is none."""
    written, (height, width) = found.numbers, size
    if max(written) <= 0 or (found.score is not None and found.score <= 0):  # [0, 0, 0, 0], [-1, -1, -1, -1]
        return "empty"
    if not all(map(math.isfinite, written)):
        return "outside"
    if found.ordered and (written[0] > written[2] or written[1] > written[3]):
        return "inverted"
    across, down = (width, height) if frame == "pixels" else (_PARTS[frame],) * 2
    if max(written) <= 1:
        across = down = 1
    xs, ys = sorted((written[0] / across, written[2] / across)), sorted((written[1] / down, written[3] / down))
    if found.point:
        xs, ys = ([centre[0] - _POINT, centre[1] + _POINT] for centre in (xs, ys))
    if min(xs[0], ys[0]) < 1 - _PAST or max(xs[1], ys[1]) > _PAST or max(xs[0], ys[0]) >= 1 or min(xs[1], ys[1]) <= 0:
        inside = min(written) >= 0 and max(written[::2]) <= width and max(written[1::2]) <= height
        return "pixels" if inside and frame != "pixels" else "outside"
    x0, y0, x1, y1 = (min(max(value, 0.0), 1.0) for value in (xs[0], ys[0], xs[1], ys[1]))
    if not (x1 - x0 > _LEAST and y1 - y0 > _LEAST):
        return "flat"
    score = found.score
    if score is None and trace and found.decided:
        # The probability of opening the entry, times the geometric mean over the first tokens of its numbers.
        begun = sum(trace.log_probability(place, place + 1) for place in found.places) / len(found.places)
        score = math.exp(trace.log_probability(*found.decided) + begun)
    return Box(x0, y0, x1, y1, 1.0 if score is None else score)


def _labels(text: str, found: Sequence[_Coordinates]) -> Iterator[str]:
    """What the model calls each box: in the object that holds it, else before it; further boxes there are called so."""
    end, label = 0, ""
    for each in found:
        opened, first = each.decided[1] - 1 if each.decided else 0, min(each.places, default=0)
        close = text.find("}", opened, opened + _LONGEST_ENTRY)
        match = _LABEL.search(text, opened, max(close, opened)) if text[opened] == "{" else None
        before = text[max(end, first - 200) : first]
        if match is None and (match := _CALLED.search(before)) and _NO_LABEL.search(match[match.lastindex or 0]):
            match = None
        if match or not re.fullmatch(r"[\d.\s,;()\[\]]+", before):
            label = match[match.lastindex or 0].strip() if match else ""
        end = max(each.places, default=end)
        yield label


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
