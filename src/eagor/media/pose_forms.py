"""The forms in which programs write poses, by what is in the file; tables become ours (`eagor.media.pose_files`).

- A table with a first line of names, also as a comment, with commas, semicolons, tabs or blanks between (EuRoC's
  ``#timestamp [ns],p_RS_R_x [m],...,q_RS_w []``; names of units tell those of the stamps).
- TUM and ORB-SLAM: eight numbers with blanks between, without names: stamp, x, y, z, qx, qy, qz, qw.
- COLMAP's ``images.txt``: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, from the world to the camera.
- nerfstudio's and Instant NGP's ``transforms.json``: file_path and transform_matrix, from the camera to the world.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np

from eagor._checks import parsed
from eagor.conventions import rotation_from_wxyz
from eagor.errors import EagorError, FormatError
from eagor.media.panorama import natural
from eagor.media.times import UNITS, times_of, unit_of

__all__ = ["MUCH", "Placed", "Table", "base_name", "colmap", "nerfstudio", "table_of"]

# Columns as others call them, in small letters and without units in brackets; our own names count first.
_POSITION = r"(?:t|p_rs_r_|p_|pos_|pos\.|position_|(?:.*[./])?position[./])"
_TURN = r"(?:q_rs_|q_|quat_|orientation_|(?:.*[./])?orientation[./])"
ALIASES = {
    "stamp": re.compile(r"(?:__|%)?(?:stamp|timestamp|time|t)(?:_(?P<unit>s|sec|ms|msec|us|usec|ns|nsec))?"),
    **{axis: re.compile(rf"{_POSITION}{axis}") for axis in "xyz"},
    **{f"q{axis}": re.compile(rf"{_TURN}{axis}") for axis in "wxyz"},
    **{f"{angle}_deg": re.compile(rf"{angle}_rad") for angle in ("yaw", "pitch", "roll")},
}
TUM = ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")
EUROC = ("stamp", "x", "y", "z", "qw", "qx", "qy", "qz")
EUROC_COLUMNS = 17  # with velocities and biases
MUCH = 1e100  # of anything: products of more have no end
_UNIT = re.compile(r"[\[(]\s*(\w*)[^\])]*[\])]\s*$")


@dataclass(frozen=True)
class Table:
    """`names`: of the columns, ours where they are known. `body`: the lines after line `first`, with commas.

    `unit`: of the stamps, in a second; `degree`: what one unit of an angle is, degrees. `ours`: whether the names are.
    """

    names: tuple[str, ...]
    first: int
    body: str
    unit: float
    degree: float = 1.0
    ours: bool = True


def table_of(text: str) -> Table | None:
    """The table in `text`; None if there is none. Raises `FormatError` where nothing tells the columns."""
    lines = text.split("\n")
    told = [number for number, line in enumerate(lines) if line.strip()]
    at = next((number for number in told if not lines[number].lstrip().startswith("#")), None)
    if at is None:
        return None
    fields = _fields(lines[at])
    body = "\n".join(lines[at + 1 :])
    mark = _mark(lines[at])
    if not all(map(_is_number, fields[:7])) or len(fields) < 2:
        names, unit, degree, ours = _named(fields)
    else:  # no names, or in the comment above
        above = next((lines[number].strip().lstrip("#").strip() for number in reversed(told) if number < at), "")
        names, unit, degree, ours = _named(_fields(above))
        if len(names) != len(fields) or "stamp" not in names:
            names, unit, ours = _unnamed(fields, mark), 0.0, False
        at, body = at - 1, "\n".join(lines[at:])
    if mark != ",":
        body = "\n".join(",".join(line.split(mark)) for line in body.split("\n"))
    if not unit:
        values = dict(zip(names, _fields(body.lstrip().split("\n", 1)[0]), strict=False))
        stamp = values.get("stamp", "")
        unit = unit_of(float(stamp)) if _is_number(stamp) and math.isfinite(float(stamp)) else 1.0
    return Table(names, at + 1, body, unit, degree, ours)


def _mark(line: str) -> str | None:
    return next((mark for mark in ",;\t" if mark in line), None)


def _fields(line: str) -> list[str]:
    mark = _mark(line)
    if mark == ",":
        try:
            return next(csv.reader(io.StringIO(line), strict=True), [])
        except csv.Error:
            return line.split(",")
    return line.split(mark)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _named(fields: Sequence[str]) -> tuple[tuple[str, ...], float, float, bool]:
    """Our names of columns, the unit of the stamps (0: not told), that of the angles, whether the names are ours."""
    bare = [_UNIT.sub("", field).strip().lower() for field in fields]
    names, unit, degree = list(bare), 0.0, 1.0
    for name, form in ALIASES.items():
        found = [number for number, each in enumerate(bare) if form.fullmatch(each)]
        if name not in bare and len(found) == 1:
            names[found[0]] = name
            if name.endswith("_deg"):
                degree = math.degrees(1)
        if name == "stamp" and names.count(name) == 1:
            at = names.index(name)
            match, bracket = form.fullmatch(bare[at]), _UNIT.search(fields[at])
            told = (match["unit"] if match else None) or (bracket[1].lower() if bracket else "")
            unit = UNITS.get(told, 0.0)
    return tuple(names), unit, degree, all(each in bare for each in names)


def _unnamed(fields: Sequence[str], mark: str | None) -> tuple[str, ...]:
    if mark == "," and len(fields) >= EUROC_COLUMNS:
        return (*EUROC, *(f"column {k}" for k in range(len(EUROC), len(fields))))
    if mark is None and len(fields) == len(TUM):
        return TUM
    if len(fields) == 12:
        raise FormatError("twelve numbers a line are KITTI's poses, which have no times; wanted a column stamp")
    raise FormatError(
        f"{len(fields)} numbers a line, and no names of columns; wanted a first line of names (with a # or without), "
        "or TUM's eight numbers with blanks between: stamp x y z qx qy qz qw"
    )


# --- poses of pictures, without times ---


@dataclass(frozen=True)
class Placed:
    """Pictures by name, with ``world_R_camera`` (n, 3, 3) and places (n, 3); `axes` of the camera, `form` in words."""

    names: list[str]
    stamps: list[float]
    turns: np.ndarray
    places: np.ndarray
    axes: str
    form: str


def _placed(names: Sequence[str], turns: np.ndarray, places: np.ndarray, axes: str, form: str) -> Placed:
    """In order of the names; one a second where they are no times."""
    order = sorted(range(len(names)), key=lambda k: natural(base_name(names[k])))
    stamps = times_of([PurePath(base_name(name)).stem for name in names])
    if stamps is not None and len(set(stamps)) == len(stamps):
        order = sorted(order, key=stamps.__getitem__)
        told = [stamps[k] for k in order]
    else:
        told = [float(k) for k in range(len(order))]
    return Placed([names[k] for k in order], told, turns[order], places[order], axes, form)


def base_name(path: str) -> str:
    """The last part of a path, of Windows too."""
    return path.replace("\\", "/").rstrip("/").rpartition("/")[2]


def colmap(text: str) -> Placed | None:
    """The pictures of COLMAP's images.txt; None if it is another file."""
    rows = [line.split(maxsplit=9) for line in text.splitlines() if not line.lstrip().startswith("#")]
    rows = [row for row in rows if len(row) == 10 and not all(map(_is_number, row[9].split()))]
    if not rows or not all(map(_is_number, rows[0][:9])) or "," in "".join(rows[0][:9]):
        return None
    try:
        table = np.array([[float(field) for field in row[1:8]] for row in rows])
        if not (np.abs(table) < MUCH).all():
            raise ValueError("a number without end")
        turns = np.swapaxes(rotation_from_wxyz(table[:, :4]), -1, -2)
    except (ValueError, EagorError) as error:
        raise FormatError(f"COLMAP's images.txt has a line that cannot be: {str(error)[:300]}") from error
    places = -np.einsum("nij,nj->ni", turns, table[:, 4:])
    return _placed([row[9].strip() for row in rows], turns, places, "optical", "COLMAP's images.txt")


def nerfstudio(text: str) -> Placed:
    """The pictures of a transforms.json. Raises `FormatError`."""
    try:
        found: Any = parsed(text)
        names = [str(frame["file_path"]) for frame in found["frames"]]
        matrices = np.array([frame["transform_matrix"] for frame in found["frames"]], dtype=np.float64)
        if matrices.ndim != 3 or matrices.shape[1] not in (3, 4) or matrices.shape[2] != 4:
            raise ValueError(f"the matrices have the shape {matrices.shape}")
        if not (np.abs(matrices) < MUCH).all():  # of some, no decomposition ends
            raise ValueError("a matrix has a number without end")
        turns, places = matrices[:, :3, :3], matrices[:, :3, 3]
        left, lengths, right = np.linalg.svd(turns)
        turns = left @ right
        if not (np.allclose(lengths, 1, atol=0.01) and (np.linalg.det(turns) > 0).all()):
            raise ValueError("a matrix is no rotation")
    except (ValueError, TypeError, KeyError, OverflowError, np.linalg.LinAlgError) as error:
        raise FormatError(
            f"is JSON, but no transforms.json of nerfstudio: frames with file_path and transform_matrix ({error})"
        ) from error
    return _placed(names, turns, places, "opengl", "a transforms.json")
