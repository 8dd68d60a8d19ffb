"""Checked fields of the JSON lines that people write: replay files and files of true directions.

Every fault is a `FormatError` that says what came and what was wanted.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import stat
from collections.abc import Collection, Iterator
from json import JSONDecodeError
from typing import Any

import numpy as np

from eagor._json import parsed
from eagor._json import shown as _short
from eagor.errors import EagorError, FormatError
from eagor.grids import PerspectiveGrid
from eagor.sphere import rotation, world_R_body

LARGEST = 65536  # pixels along one side; more is taken for a mistake
LONGEST = 32  # a view this many times longer than wide is taken for a mistake, too
MOST_BYTES = 1 << 30  # of a file: more is taken for something that never ends
UNIT = 1e-3  # by how much the length of a quaternion may differ from 1
LEAN = ("yaw_left_deg", "pitch_up_deg", "roll_right_deg")
TURN = ("qw", "qx", "qy", "qz")
OF_VIEWS = ("hfov_deg", *LEAN, *TURN)
HINTS = {  # for keys that others use, and whose sign or unit may differ
    "pitch_deg": "pitch_up_deg is positive UP, like elevation_deg; pitch_deg of a pose file is positive nose DOWN",
    "pitch": "pitch_up_deg is positive UP, in degrees",
    "yaw": "yaw_left_deg is positive to the LEFT, in degrees",
    "yaw_deg": "yaw_left_deg is positive to the LEFT",
    "roll": "roll_right_deg is positive where the camera leans to its RIGHT, in degrees",
    "roll_deg": "roll_right_deg is positive where the camera leans to its RIGHT",
    "fov": "hfov_deg is the HORIZONTAL field of view, in degrees",
    "vfov_deg": "hfov_deg is the HORIZONTAL field of view",
    "bbox": "box is x0, y0, x1, y1, not x, y, width, height",
}


def json_lines(path: str | os.PathLike[str]) -> Iterator[tuple[bytes, str]]:
    """The lines of a file that are not blank, each with where it stands, for errors: ``looks.jsonl, line 3``.

    Raises `FormatError` for a file that cannot be read: also a device or a pipe, which may never end.
    """
    name = os.fspath(path)
    try:
        with open(path, "rb", opener=_open_at_once) as file:
            kind = os.fstat(file.fileno()).st_mode
            content = file.read(MOST_BYTES + 1) if stat.S_ISREG(kind) else None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise FormatError(f"{name} cannot be read ({error}); give the path of a JSONL file") from error
    if content is None:
        raise FormatError(f"{name} cannot be read (it is a device or a pipe); wanted a JSONL file on a disk")
    if len(content) > MOST_BYTES:
        raise FormatError(f"{name} has more than {MOST_BYTES >> 20} MiB; wanted a JSONL file of less: split it")
    lines = content.removeprefix(b"\xef\xbb\xbf").split(b"\n")
    for number, line in enumerate(lines, 1):
        if line.strip():
            yield line, f"{name}, line {number}" + (" (the last)" if number == len(lines) else "")


def _open_at_once(path: str, flags: int) -> int:
    """A descriptor; opening a pipe without a writer does not wait for one."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def misplaced(error: EagorError, where: str) -> FormatError:
    """`error` with its place in the file; a torn last line gets a hint."""
    torn = isinstance(error.__cause__, JSONDecodeError | UnicodeDecodeError) and where.endswith(" (the last)")
    hint = ". The last line is incomplete: the writer was probably interrupted; remove the line" if torn else ""
    return FormatError(f"{where.removesuffix(' (the last)')}: {error}{hint}")


def object_of(line: str | bytes) -> dict[str, Any]:
    """The JSON object in a line."""
    try:
        entry = parsed(line.decode("utf-8") if isinstance(line, bytes) else line, strict=True)
    except ValueError as error:  # UnicodeDecodeError and JSONDecodeError are ValueErrors
        raise FormatError(f"is not JSON ({error}); wanted one JSON object") from error
    need(isinstance(entry, dict), "the line", entry, "one JSON object")
    return entry


def only(entry: Collection[str], known: Collection[str], where: str) -> None:
    """Refuse a key that is not `known`, with the nearest that is. Keys that begin with ``_`` are notes."""
    for key in entry:
        if key in known or key.startswith("_"):
            continue
        near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}? Known are" if near else "known are"
        note = f" ({HINTS[key]})" if key in HINTS else ""
        raise FormatError(
            f"{_short(key)} is no key of {where}; {hint} {', '.join(known)}{note}. A note of your own begins with _"
        )


def view_of(image: dict, rows: int | None = None, columns: int | None = None) -> PerspectiveGrid | None:
    """The perspective view that `image` describes, in pixels or in `rows` and `columns`; None for a panorama."""
    only(image, ("projection", "width", "height", *OF_VIEWS), "image")
    projection = "equirectangular" if image.get("projection") is None else image["projection"]
    need(
        projection in ("equirectangular", "perspective"),
        "projection", projection, '"equirectangular" or "perspective"',
    )  # fmt: skip
    if projection == "equirectangular":
        if told := [key for key in OF_VIEWS if image.get(key) is not None]:
            raise FormatError(
                f"{told[0]} is for a perspective image, and this one is a panorama; add "
                '"projection": "perspective" to image, or leave the key out'
            )
        return None
    height, width = rows or size(image, "height"), columns or size(image, "width")
    need(max(height, width) <= LONGEST * min(height, width), "image", (width, height), f"sides up to {LONGEST}:1")
    return PerspectiveGrid(height, width, math.radians(number(image, "hfov_deg", 0.1, 179)), _body_R_view(image))


def _body_R_view(image: dict) -> np.ndarray:
    """Where a view looks ``(3, 3)``: a quaternion, or angles."""
    told = [key for key in TURN if image.get(key) is not None]
    if not told:
        yaw, pitch, roll = (
            math.radians(number(image, key, -most, most, default=0.0))
            for key, most in zip(LEAN, (360, 90, 360), strict=True)
        )
        return world_R_body(yaw, -pitch, roll)  # in REP-103 a positive pitch turns the nose down
    if also := [key for key in LEAN if image.get(key) is not None]:
        raise FormatError(f"has {told[0]} and {also[0]}; wanted the quaternion qw, qx, qy, qz or angles, not both")
    wxyz = np.array([number(image, key, -2, 2) for key in TURN])
    length = float(np.linalg.norm(wxyz))
    need(abs(length - 1) <= UNIT, "the length of qw, qx, qy, qz", round(length, 4), "1 (a rotation, body_R_view)")
    sine = float(np.linalg.norm(wxyz[1:]))
    return rotation(wxyz[1:], 2 * math.atan2(sine, wxyz[0])) if sine > 0 else np.eye(3)


def probability(value: float, scores: str) -> float:
    """A score as the line states it (`score_kind`), in [0, 1]."""
    if scores == "logit":
        need(is_number(value), "score", value, "a finite number: the logit of a probability")
        return 1 / (1 + math.exp(-min(max(value, -500), 500)))
    need(
        is_number(value) and 0 <= value <= 1,
        "score", value,
        'a number from 0 to 1. Of logits, say so: "scores": "logit" in the line; divide percentages by 100',
    )  # fmt: skip
    return float(value)


def score_kind(entry: dict) -> str:
    """What the scores of a line are: "probability" or "logit"."""
    kind = "probability" if entry.get("scores") is None else entry["scores"]
    need(kind in ("probability", "logit"), "scores", kind, '"probability" (the default) or "logit"')
    return kind


def number(entry: dict, key: str, low: float = -1e300, high: float = 1e300, default: float | None = None) -> float:
    """A number between `low` and `high`."""
    value: Any = default if entry.get(key) is None else entry[key]
    bounds = f"a number from {low:g} to {high:g}" if high < 1e300 else "a finite number"
    need(is_number(value) and low <= value <= high, key, value, bounds)
    return float(value)


def size(entry: dict, key: str) -> int:
    """A number of pixels."""
    value: Any = entry.get(key)
    fine = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= LARGEST
    need(fine, key, value, f"a whole number from 1 to {LARGEST}")
    return int(value)


def is_number(value: Any) -> bool:
    """Whether it is a finite number; True and text are not."""
    return isinstance(value, int | float) and not isinstance(value, bool) and -1e300 <= value <= 1e300


def need(holds: bool, what: str, came: Any, wanted: str) -> None:
    """Raise `FormatError` unless it holds."""
    if not holds:
        found = "is missing" if came is None else f"is {_short(came)}"
        raise FormatError(f"{what} {found}; wanted {wanted}")


def words_of(text: str) -> list[str]:
    """Lower-case words: runs of letters and digits of any script."""
    return re.findall(r"\w+", text.casefold())
