"""What a record has to look like before it is counted: one that does not is named, and nothing is made of the rest.

A shape is a `Kind`; a list of one shape, for lists of such; or a dict of shapes by name, where a name that ends in "?"
may be missing, and "*" is for all others. What a shape does not mention may be anything.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eagor._checks import whole, within
from eagor._json import shown
from eagor.errors import FormatError
from eagor.evaluation.samples import Record

Shape = Any
_MOST = 1e12  # what is measured is never as large, and sums of such numbers stay finite


@dataclass(frozen=True)
class Kind:
    """A plain value: whether one fits, and what is wanted in words."""

    fits: Callable[[Any], bool]
    wanted: str


def _is_number(value: Any) -> bool:
    return within(value, -_MOST, _MOST)


def _or_null(kind: Kind) -> Kind:
    return Kind(lambda value: value is None or kind.fits(value), f"{kind.wanted}, or null")


def _all(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list) and bool(value) and all(map(fits, value))


NUMBER = Kind(_is_number, "a number")
SHARE = Kind(lambda value: isinstance(value, bool) or within(value, 0, 1), "a number from 0 to 1")
COUNT = Kind(lambda value: whole(value, 0, _MOST), "a whole number from 0 on")
TEXT = Kind(lambda value: isinstance(value, str), "text")
LABEL = Kind(lambda value: isinstance(value, str | bool) or _is_number(value), "text or a number")
FIGURE = _or_null(Kind(lambda value: isinstance(value, bool) or _is_number(value), "a number"))
NUMBERS = Kind(_all(_is_number), "a list of numbers")
FIGURES = Kind(_all(FIGURE.fits), "a list of numbers and nulls")
OBJECT = Kind(lambda value: isinstance(value, dict), "an object")
FLAGS = Kind(_all(lambda value: isinstance(value, bool)), "a list of true and false")
LABELS = Kind(_all(LABEL.fits), "a list of texts")
TAGS = Kind(lambda value: isinstance(value, list) and all(isinstance(tag, str) for tag in value), "a list of texts")
POSES = Kind(
    _all(lambda pose: isinstance(pose, list) and len(pose) == 7 and all(map(_is_number, pose)) and any(pose[3:])),
    "a list of x, y, z, qw, qx, qy, qz",
)
PLACES = Kind(
    _all(lambda at: at is None or (isinstance(at, list) and len(at) == 3 and all(map(_is_number, at)))),
    "a list of x, y, z and nulls",
)

WOULD = Kind(
    lambda value: isinstance(value, dict) and (value.get("p") is None or SHARE.fits(value["p"])),
    "an object, whose p is a number from 0 to 1",
)

_LOOKED = {"looks": COUNT, "unread": COUNT, "milliseconds": _or_null(NUMBER), "source": _or_null(OBJECT)}
SIMULATED: Shape = {
    "episode": {
        "id": TEXT, "seed?": COUNT, "query": TEXT, "scene?": TEXT, "scene_hash?": TEXT, "world?": TEXT,
        "targets": [COUNT], "stratum?": {"*": LABEL}, "balls?": _or_null(PLACES), "radius?": NUMBER,
    },
    "truth?": {
        "pose": POSES, "azimuth_deg": NUMBERS, "elevation_deg": NUMBERS, "range_m": NUMBERS, "visible": FLAGS,
        "present?": FLAGS, "leg?": LABELS, "seam": FLAGS,
    },
    "methods": {
        "*": {
            "metrics": {"*": FIGURE},
            "trace": {
                "azimuth_deg": NUMBERS, "elevation_deg": NUMBERS, "error_deg": FIGURES, "inside?": _or_null(FIGURES),
                "mass_above?": _or_null(FIGURES), "distance_m?": _or_null(FIGURES), "pose?": POSES,
                "true_azimuth_deg?": NUMBERS, "true_elevation_deg?": NUMBERS, "true_range_m?": NUMBERS,
                "visible?": FLAGS, "searching?": FLAGS,
            },
            "looked?": _LOOKED,
        }
    },
    "looked?": _LOOKED,
}  # fmt: skip
WALKED: Shape = {
    "methods": {
        "*": {
            "metrics": {"success": NUMBER, "spl": NUMBER, "mae": NUMBER},
            "trace": {"pose": POSES, "true_azimuth_deg": NUMBERS, "true_range_m": NUMBERS, "visible": FLAGS},
        }
    }
}
WATCHED: Shape = {"truth": {}}  # all methods saw the same
IN_LEGS: Shape = {"truth": {"leg": LABELS}}
PUBLISHED: Shape = {
    "case": TEXT, "cluster": LABEL, "score": SHARE, "level?": TEXT, "tags?": TAGS, "views?": COUNT,
    "by_turn?": Kind(_all(SHARE.fits), "a list of numbers from 0 to 1"), "stated?": _or_null(SHARE),
    "cause?": _or_null(TEXT), "sure?": _or_null(SHARE), "scoring?": TEXT, "scores?": {"*": FIGURE},
    "error?": _or_null(NUMBER), "steps?": [{"would?": _or_null(WOULD)}],
}  # fmt: skip

_WORDS: dict[str, Shape] = {"text": TEXT, "texts": TAGS, "figures": {"*": FIGURE}, "object": OBJECT}


def published(more: Mapping[str, str]) -> Shape:
    """The shape of a benchmark's records, with what it says `more` of them (`eagor.tasks.benchmark.Benchmark`)."""
    return PUBLISHED | {name: _WORDS[kind] for name, kind in more.items()}


def checked(records: Sequence[Record], shape: Shape) -> Sequence[Record]:
    """`records`, those with a result as `shape` says. Raises `FormatError`, which names the record and the place."""
    for record in records:
        wanted = shape if record["status"] == "ok" else {"error?": TEXT}
        fault = _fault(record, {"task?": _or_null(TEXT), "seconds?": _or_null(NUMBER), **wanted}, "") or _uneven(record)
        if fault:
            raise FormatError(
                f"the record {shown(record['key'], 200)} (attempt {record['attempt']}): {fault}. Restore its line, or "
                "delete it: its unit is then done again"
            )
    return records


def _fault(value: Any, shape: Shape, place: str) -> str | None:
    """What is wrong with `value`, in words; None if nothing is."""
    if isinstance(shape, Kind):
        return None if shape.fits(value) else f"{place} is {shown(value)}; wanted {shape.wanted}"
    kind, wanted = (list, "a list") if isinstance(shape, list) else (dict, "an object")
    if not isinstance(value, kind):
        return f"{place} is {shown(value)}; wanted {wanted}"
    for name, inner, each in _parts(value, shape):
        where = f"{place}.{shown(name)[1:-1] if isinstance(name, str) else name}".lstrip(".")
        if each is _MISSING:
            return f"there is no {where}"
        if found := _fault(each, inner, where):
            return found
    return None


_MISSING = object()


def _parts(value: Any, shape: Shape) -> list[tuple[Any, Shape, Any]]:
    """The name, the shape and the value of each part that is to be looked at."""
    if isinstance(shape, list):
        return [(index, shape[0], each) for index, each in enumerate(value)]
    found = []
    for name, inner in shape.items():
        plain = name.removesuffix("?")
        if plain == "*":
            found += [(key, inner, each) for key, each in value.items() if not {key, f"{key}?"} & shape.keys()]
        elif plain == name or plain in value:
            found.append((plain, inner, value.get(plain, _MISSING)))
    return found


def _uneven(record: Record) -> str | None:
    """Lists of one episode must be of one length: of each step there is one value."""
    entries = record.get("methods")
    if record["status"] != "ok" or not isinstance(entries, Mapping):
        return None
    truth = record.get("truth") or {}
    for name, entry in entries.items():
        lists = {f"truth.{key}": each for key, each in truth.items()} | entry["trace"]
        counts = {key: len(each) for key, each in lists.items() if isinstance(each, list)}
        if len(set(counts.values())) > 1:
            return f"the lists of {name} are of different lengths ({shown(counts, 200)})"
    return None
