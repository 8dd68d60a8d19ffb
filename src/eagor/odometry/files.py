"""Poses from a file, in the forms in which programs write them; docs/how-to/robot-log.md has the columns.

Ours is CSV whose first line names the columns, in any order; others are ignored, and so are blank lines, and lines that
begin with ``#``. Tables of others have other names, also in a comment, or none (TUM, EuRoC), and other marks between.
COLMAP's images.txt tells from the world to the camera, transforms.json of nerfstudio and Instant NGP the other way
round. Counts of milli-, micro- or nanoseconds since 1970 are read as such, others where the name says so
(``stamp_ms``). Which axes they have: `eagor.odometry.axes`.
"""

from __future__ import annotations

import csv
import math
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import takewhile
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from eagor._checks import LATEST, checked_stamp, parsed
from eagor._files import natural, read_file
from eagor.conventions import rotation_from_wxyz
from eagor.errors import EagorError, FormatError, PoseError, RotationError, TimeError
from eagor.odometry import Pose
from eagor.sphere import interpolate_rotation
from eagor.tracking.poses import FARTHEST

__all__ = ["BEYOND", "GivenPoses", "interpolated", "is_near", "pair", "read_poses", "times_of", "usable"]

QUATERNION, ANGLES, POSITION = ("qw", "qx", "qy", "qz"), ("yaw_deg", "pitch_deg", "roll_deg"), ("x", "y", "z")
HEADERS = "stamp,qw,qx,qy,qz[,x,y,z][,frame] or stamp,yaw_deg,pitch_deg,roll_deg[,x,y,z][,frame]"
# Units in brackets or at the end of a name, and how many of them make a second, a metre or a degree.
UNITS = {
    **{"s": 1.0, "sec": 1.0, "ms": 1e3, "msec": 1e3, "us": 1e6, "usec": 1e6, "ns": 1e9, "nsec": 1e9},
    **{"m": 1.0, "cm": 1e2, "mm": 1e3, "deg": 1.0, "degrees": 1.0},
    **dict.fromkeys(("rad", "radians"), math.radians(1)),
}
# Columns as others call them, in small letters and without brackets; our own names count first.
_PLACE = r"(?:t|p|p_rs_r_|p_|pos_|pos\.|position_|(?:.*[./])?position[./])?"
_TURN = r"(?:q|q_rs_|q_|quat_|orientation_|(?:.*[./])?orientation[./]|(?:rot|rotation|quaternion|quat)[._])"
ALIASES = {
    "stamp": r"(?:__)?(?:stamp|timestamp|time|t)(?:_(?P<unit>s|sec|ms|msec|us|usec|ns|nsec))?",
    **{axis: rf"{_PLACE}{axis}(?:_(?P<unit>mm|cm|m))?" for axis in "xyz"},
    **{f"q{axis}": _TURN + axis for axis in "wxyz"},
    **{angle: angle.replace("_deg", "(?:_(?P<unit>deg|rad))?") for angle in ANGLES},
}
NUMBERS = ("stamp", *QUATERNION, *ANGLES, *POSITION)
_FILE = re.compile(r".+\.[a-z]\w{2,3}", re.IGNORECASE)  # a picture's name, whatever its column is called
_COMMENT = re.compile(r"\s*(?:#|%|//)")
_UNIT = re.compile(r"[\[(]\s*(\w*)[^\])]*[\])]\s*$")
# Tables without names: their mark (None: blanks), how many columns they have, from which stamp on (EuRoC's count
# nanoseconds since 1970; others have a matrix in so many columns), and the columns that begin a line.
UNNAMED = (
    *((mark, {8}, -math.inf, ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")) for mark in (None, "\t")),  # TUM
    (",", range(17, 1000), 1e17, ("stamp", "x", "y", "z", "qw", "qx", "qy", "qz")),  # EuRoC, with velocities and biases
)
EPOCH = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))  # from this size on a clock that counts since 1970 counts these
# Names without their endings, after what is no number; of two numbers the second is a part of a second.
_NAMES = tuple(
    re.compile(rf"(?!.*\d\d[-_:.]\d\d[-_:.]\d\d\.\d+$)(?:.*[^\d.])?{form}")
    for form in (r"(\d+\.\d+)", r"(\d{9,10})[_-](\d{6}|\d{9})", r"(\d{10}|\d{13}|\d{16}|\d{19})")
)
COUNTS = ((1e4, ("milliseconds", "ms")), (1e7, ("microseconds", "us")), (math.inf, ("nanoseconds", "ns")))
APART = 10.0  # seconds between poses from which on they are rather counts of something shorter
WHOLE, MANY = 2.0, 100  # the same, of so many poses with whole numbers
FASTEST = 60.0  # metres per second, from which on positions are rather counts of something shorter
MUCH = 1e100  # of anything: products of more have no end
NORM = 0.01  # by which the length of a quaternion may differ from 1: printed with three digits
BEYOND = 0.05  # seconds: what lies so far outside of the poses still takes the nearest one


class GivenPoses(tuple[Pose, ...]):
    """A `PoseSource` of poses that are there already, in order of time; `name`: where they are from.

    Of a file: `axes`: those of `eagor.odometry.axes` that its form tells, "" if none, "body?": ours; `form`: that of
    another program, in words, which may lack pictures; `unit`: how many of what its stamps count are a second;
    `guessed`: its frames are from a column that is called otherwise, and need not be pictures of this camera.
    """

    axes, form, name, unit, guessed = "", "", "the poses", 1.0, False

    def __new__(cls, poses: Iterable[Pose], name: str = name) -> GivenPoses:
        found = super().__new__(cls, poses)
        found.name = name
        return found

    def close(self) -> None:
        """Nothing is held."""

    def made(self, poses: Iterable[Pose]) -> GivenPoses:
        """Others of the same file."""
        found = GivenPoses(poses)
        found.__dict__.update(self.__dict__)
        return found


def read_poses(path: str | Path) -> GivenPoses:
    """The poses in the file, sorted by time.

    Raises `FormatError` for a violation of the format, `RotationError` for a quaternion that is not of unit length,
    `TimeError` if the stamps do not increase; each error names the file and the line. Stamps that are hardly seconds
    are a `UserWarning`.
    """
    try:
        data = read_file(path)
        text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except (OSError, ValueError) as error:  # UnicodeDecodeError, and null characters in the path
        binary = (
            "; COLMAP's become text by: colmap model_converter --output_type TXT" if str(path)[-4:] == ".bin" else ""
        )
        wanted = f"give a CSV file of poses: {HEADERS}{binary}"
        raise FormatError(f"{path} cannot be read as text ({error}); {wanted}") from error
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    try:
        poses = _nerfstudio(text) if text.lstrip().startswith("{") else _colmap(lines) or _of_table(lines)
    except EagorError as error:
        raise type(error)(f"{path}{error}") from error
    poses.name = str(path)
    for text in () if poses.form or len(poses) < 2 else _doubtful_units(poses):
        warnings.warn(f"{path}: {text}", UserWarning, stacklevel=2)
    return poses


def _doubtful_units(poses: GivenPoses) -> Iterator[str]:
    """What looks as if it counted milliseconds or millimetres, say."""
    stamps = np.array([pose.stamp for pose in poses])
    steps = np.diff(stamps)
    apart = float(np.median(steps))
    if apart >= APART or (apart >= WHOLE and len(poses) >= MANY and (stamps == stamps.round()).all()):
        what, short = next(names for most, names in COUNTS if apart * poses.unit < most)
        yield f"its poses are {apart:g} s apart. Are the stamps {what}? Then call that column stamp_{short}"
        return
    places = [pose.position for pose in poses if pose.position is not None and is_near(pose)]
    if len(places) == len(poses):
        speed = float(np.median(np.linalg.norm(np.diff(places, axis=0), axis=1) / steps))
        if speed > FASTEST:
            yield f"it moves at {speed:.0f} m/s. Are the positions millimetres? Then call the columns x_mm, y_mm, z_mm"


# --- times, as other programs write them ---


def unit_of(stamp: float) -> float:
    """How many of what `stamp` counts make a second, if it counts from 1970 on; else 1."""
    return next((UNITS[unit] for least, unit in EPOCH if abs(stamp) >= least), 1.0)


def times_of(names: Sequence[str]) -> list[float] | None:
    """Seconds, if names (without endings) are times, all in one form: 12.350, left_1700000000500000000; else None.

    The seconds of a time of day (22-13-20.500) are none: they begin anew with each minute.
    """
    for form in _NAMES:
        found = [form.fullmatch(name) for name in names]
        if found and all(found):
            parts = [each.groups() for each in found if each is not None]
            whole = [float(first) / (1.0 if "." in first else unit_of(float(first))) for first, *_ in parts]
            if max(whole) > LATEST:
                return None
            return [at + sum(float(f"0.{part}") for part in more) for at, (_, *more) in zip(whole, parts, strict=True)]
    return None


# --- tables ---


def _of_table(lines: Sequence[str]) -> GivenPoses:
    """The poses of a table; errors begin with what comes after the file's name."""
    comments = [line.strip() for line in takewhile(lambda line: not line.strip() or _COMMENT.match(line), lines)]
    if len(comments) == len(lines):
        raise FormatError(f" is empty; wanted a line with the names of the columns: {HEADERS}")
    mark = _mark(lines[len(comments)])
    rows = _rows(lines, len(comments), mark)
    line, first = next(rows, (len(comments) + 1, [""]))
    rows = [*rows]
    names, units, ours = _named(first)
    if len(first) > 1 and _is_number(first[0]):  # no names, or in the comment above
        rows.insert(0, (line, first))
        above = next((each.lstrip("#%/ ").strip() for each in reversed(comments) if each), "")
        names, units, ours = _named(above.split(_mark(above)))
        if len(names) != len(first) or "stamp" not in names:
            names, units, ours = _unnamed(first, mark), {}, False
    _check_names(names, line)
    if not rows:
        raise FormatError(f" has a header but no poses; wanted one line per frame: {HEADERS}")
    for number, row in rows:
        if len(row) != len(names):
            found = f"has {len(row)} fields where the header has {len(names)}"
            raise FormatError(f", line {number}: {found}; cut off, or a comma too many?")
    files = [column for column in range(len(names)) if all(_FILE.fullmatch(row[column]) for _, row in rows)]
    if guessed := "frame" not in names and bool(files):
        names[files[0]] = "frame"
    at = {name: names.index(name) for name in (*NUMBERS, "frame") if name in names}
    point = "," if mark == "," else "."  # else a comma is a decimal one
    table = {
        name: np.array([_number(name, row[column].replace(",", point), number) for number, row in rows])
        for name, column in at.items() if name in NUMBERS
    }  # fmt: skip
    units.setdefault("stamp", unit_of(table["stamp"][0]))
    table |= {name: table[name] / unit for name, unit in units.items()}
    stamps = table["stamp"]
    for index in np.flatnonzero(~((np.diff(stamps, prepend=-math.inf) > 0) & (np.abs(stamps) <= LATEST)))[:1]:
        try:
            text = f"stamp {checked_stamp(float(stamps[index])):.6f} comes after {stamps[index - 1]:.6f}; wanted"
            text += " increasing stamps. Sort the lines by stamp, and split the file where the clock was reset"
        except TimeError as error:
            text = str(error)
        raise TimeError(f", line {rows[index][0]}: {text}")
    if "qw" in at:
        wxyz = np.stack([table[name] for name in QUATERNION], axis=1)
        with np.errstate(over="ignore"):
            lengths = np.sqrt((wxyz**2).sum(axis=1))
        for index in np.flatnonzero(~(np.abs(lengths - 1) <= NORM))[:1]:
            raise RotationError(
                f", line {rows[index][0]}: qw,qx,qy,qz = {', '.join(f'{v:g}' for v in wxyz[index])} is not a rotation: "
                f"its length is {lengths[index]:.3g}, wanted 1. Normalise it; the scalar part comes first"
            )
        turns = rotation_from_wxyz(wxyz / lengths[:, None])
    else:
        angles = np.stack([table[name] for name in ANGLES], axis=1)
        turns = Rotation.from_euler("ZYX", np.fmod(angles, 360), degrees=True).as_matrix()
    places = np.stack([table[name] for name in POSITION], axis=1) if "x" in at else [None] * len(rows)
    frames = [row[at["frame"]] or None if "frame" in at else None for _, row in rows]
    frames = [_base(frame or "") for frame in frames] if guessed else frames
    each = zip(stamps.tolist(), turns, places, frames, strict=True)
    poses = GivenPoses(Pose(stamp, turn, place, frame=frame) for stamp, turn, place, frame in each)
    poses.guessed = guessed
    poses.axes, poses.unit = "body" if "qw" not in at else "body?" if ours else "", units["stamp"]
    return poses


def _mark(line: str) -> str | None:
    """What separates columns; None: blanks."""
    return next((mark for mark in ",;\t" if mark in line), None)


def _rows(lines: Sequence[str], begin: int, mark: str | None) -> Iterator[tuple[int, list[str]]]:
    """Number and fields of each line from `begin` on that is neither blank nor a comment. Raises `FormatError`."""
    text = (f"{line if mark else ' '.join(line.split())}\n" for line in lines[begin:])
    reader = csv.reader(text, delimiter=mark or " ", strict=True)
    try:
        for fields in reader:
            if any(map(str.strip, fields)) and not _COMMENT.match(fields[0]):
                yield begin + reader.line_num, [field.strip() for field in fields]
    except csv.Error as error:
        raise FormatError(f", line {begin + reader.line_num}: is not CSV ({error}); wanted {HEADERS}") from error


def _number(name: str, text: str, line: int) -> float:
    if not _is_number(text) or "_" in text:  # Python would take 1_0 for 10
        raise FormatError(f", line {line}: {name} is {_cut(repr(text))}; wanted a number")
    if not math.isfinite(number := float(text)):
        wanted = "wanted a finite number. Leave out lines without a known pose"
        raise FormatError(f", line {line}: {name} is {_cut(text)}; {wanted}")
    return number


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _named(fields: Sequence[str]) -> tuple[list[str], dict[str, float], bool]:
    """Our names of columns, the units of those that tell theirs, and whether the names are ours."""
    bare, units = [_UNIT.sub("", field).strip().lower() for field in fields], dict[str, float]()
    names = list(bare)
    for name, form in ALIASES.items():
        found = [(at, match) for at, each in enumerate(bare) if (match := re.fullmatch(form, each))]
        found = [each for each in found if bare[each[0]] == name] or found
        if len(found) == 1:
            (at, match), bracket = found[0], _UNIT.search(fields[found[0][0]])
            unit = UNITS.get(match.groupdict().get("unit") or (bracket[1].lower() if bracket else ""))
            if unit or name not in ANGLES:  # a yaw may be degrees or radians
                names[at] = name
                units |= {name: unit} if unit else {}
    return names, units, all(each in bare for each in names)


def _unnamed(first: Sequence[str], mark: str | None) -> list[str]:
    count = len(first)
    for each, counts, least, names in UNNAMED:
        if each == mark and count in counts and float(first[0]) >= least:
            return [*names, *(f"column {k}" for k in range(len(names), count))]
    if count == 12:
        raise FormatError(": twelve numbers a line are KITTI's poses, which have no times; wanted a column stamp")
    wanted = "wanted a first line of names (with a # or without), or TUM's eight numbers with blanks between"
    raise FormatError(f": {count} numbers a line, and no names of columns; {wanted}: stamp x y z qx qy qz qw")


def _check_names(names: Sequence[str], line: int) -> None:
    """Raise `FormatError` unless there is a stamp and exactly one form of orientation, each column once."""
    wrong = next(
        (f"the column {each!r} appears twice" for each in sorted((*NUMBERS, "frame")) if names.count(each) > 1), ""
    )
    groups = {group: [name for name in group if name in names] for group in (QUATERNION, ANGLES, POSITION)}
    for group, found in groups.items():
        if found and len(found) < len(group):
            wrong = wrong or f"has {', '.join(found)} but not {', '.join(n for n in group if n not in found)}"
    if not wrong and ("stamp" not in names or bool(groups[QUATERNION]) == bool(groups[ANGLES])):
        hint = " (fields must be separated by commas)" if len(names) == 1 else ""
        hint += "; yaw in degrees or radians? Name it yaw_deg or yaw_rad" if "yaw" in names else ""
        wrong = f"the columns are {_cut(', '.join(names))}{hint}; wanted {HEADERS}"
    if wrong:
        raise FormatError(f", line {line}: {wrong}")


# --- poses of pictures, without times ---


def _colmap(lines: Sequence[str]) -> GivenPoses | None:
    """The pictures of COLMAP's images.txt; None if it is another file."""
    rows = [line.split(maxsplit=9) for line in lines if not line.lstrip().startswith("#")]
    rows = [row for row in rows if len(row) == 10 and not all(map(_is_number, row[9].split()))]
    if not rows or not all(map(_is_number, rows[0][:9])) or "," in "".join(rows[0][:9]):
        return None
    try:
        table = np.array([[float(field) for field in row[1:8]] for row in rows])
        if not (np.abs(table) < MUCH).all():
            raise ValueError("a number without end")
        turns = np.swapaxes(rotation_from_wxyz(table[:, :4]), -1, -2)
    except (ValueError, EagorError) as error:
        raise FormatError(f" COLMAP's images.txt has a line that cannot be: {str(error)[:300]}") from error
    places = -np.einsum("nij,nj->ni", turns, table[:, 4:])
    return _placed([row[9].strip() for row in rows], turns, places, "optical", "COLMAP's images.txt")


def _nerfstudio(text: str) -> GivenPoses:
    """The pictures of a transforms.json. Raises `FormatError`."""
    try:
        found: Any = parsed(text)
        names = [str(frame["file_path"]) for frame in found["frames"]]
        matrices = np.array([frame["transform_matrix"] for frame in found["frames"]], dtype=np.float64)
        if matrices.ndim != 3 or matrices.shape[1] not in (3, 4) or matrices.shape[2] != 4:
            raise ValueError(f"the matrices have the shape {matrices.shape}")
        if not (np.abs(matrices) < MUCH).all():  # of some, no decomposition ends
            raise ValueError("a matrix has a number without end")
        left, lengths, right = np.linalg.svd(matrices[:, :3, :3])
        if not (np.allclose(lengths, 1, atol=0.01) and (np.linalg.det(left @ right) > 0).all()):
            raise ValueError("a matrix is no rotation")
    except (ValueError, TypeError, KeyError, OverflowError, np.linalg.LinAlgError) as error:
        raise FormatError(
            f" is JSON, but no transforms.json of nerfstudio: frames with file_path and transform_matrix ({error})"
        ) from error
    return _placed(names, left @ right, matrices[:, :3, 3], "opengl", "a transforms.json")


def _placed(names: Sequence[str], turns: np.ndarray, places: np.ndarray, axes: str, form: str) -> GivenPoses:
    """Pictures by name in order of the names, one a second where these are no times."""
    order = sorted(range(len(names)), key=lambda k: natural(_base(names[k])))
    stamps = times_of([PurePath(_base(names[k])).stem for k in order])
    if stamps is None or len({*stamps}) < len(stamps):
        stamps = [float(k) for k in range(len(names))]
    made = (Pose(at, turns[k], places[k], frame=names[k]) for at, k in zip(stamps, order, strict=True))
    found = GivenPoses(sorted(made, key=lambda pose: pose.stamp))
    found.axes, found.form = axes, form
    return found


# --- at a time, and with pictures ---


def is_near(pose: Pose) -> bool:
    """Whether the position can be one: a lost estimate of a robot's place often ends in numbers without end."""
    return pose.position is None or bool((np.abs(pose.position) <= FARTHEST).all())


def usable(poses: Sequence[Pose], name: str | Path) -> Sequence[Pose]:
    """Those that are near; that others are left out is a `UserWarning`. Raises `PoseError` if none is left."""
    near = tuple(filter(is_near, poses))
    if len(near) == len(poses):
        return poses
    first = next(pose for pose in poses if not is_near(pose))
    place = f"the position at {first.stamp:.10g} s is {np.asarray(first.position).tolist()}"
    text = f"{name}: {place}; wanted metres, each within {FARTHEST:g} of the origin"
    if not near:
        raise PoseError(f"{text}. So are all others: are they metres?")
    warnings.warn(f"{text}. Left out: {len(poses) - len(near)} of {len(poses)} poses", UserWarning, stacklevel=2)
    return near


def interpolated(poses: Sequence[Pose]) -> Callable[[float], tuple[np.ndarray, np.ndarray | None]]:
    """Orientation ``(3, 3)`` and position ``(3,)`` at any time, between `poses`; before and after them, the nearest."""
    stamps = np.array([pose.stamp for pose in poses])

    def at(stamp: float) -> tuple[np.ndarray, np.ndarray | None]:
        after = int(np.searchsorted(stamps, stamp))
        if after in (0, len(stamps)):
            nearest = poses[min(after, len(stamps) - 1)]
            return nearest.world_R_body, nearest.position
        a, b = poses[after - 1], poses[after]
        share = float((stamp - a.stamp) / (b.stamp - a.stamp))
        place = None if a.position is None or b.position is None else a.position + share * (b.position - a.position)
        return interpolate_rotation(a.world_R_body, b.world_R_body, share), place

    return at


def pair(
    poses: Sequence[Pose], images: Sequence[Path], name: str | Path = "the pose file"
) -> tuple[tuple[Pose, Path | None], ...]:
    """Each pose with its image, sorted by time: by file name if the file has names, else in order.

    Poses of other images are kept as odometry. Raises `PoseError` for an image with no pose or with two, and for
    different numbers of poses and images without names.
    """
    if all(pose.frame is None for pose in poses):
        if len(poses) != len(images):
            raise PoseError(
                f"{name} has {len(poses)} poses for {len(images)} frames; without a column 'frame' they are paired in "
                "order. Add that column with the file names, or give as many poses as frames"
            )
        return tuple(zip(poses, images, strict=True))
    by_name, by_stem = {image.name: image for image in images}, {image.stem: image for image in images}
    for called, count in Counter(image.name for image in images).items():
        if count > 1:
            raise PoseError(f"{count} frames are called {called}; rename them, because poses name frames")
    bases = [_base(pose.frame) if pose.frame else "" for pose in poses]  # nerfstudio may leave out the ending
    pairs = tuple((pose, by_name.get(each) or by_stem.get(each)) for pose, each in zip(poses, bases, strict=True))
    used = Counter(image.name for _, image in pairs if image is not None)
    missing, twice = [n for n in by_name if n not in used], sorted(n for n, count in used.items() if count > 1)
    lacks = f"{name} has no pose for {_some(missing)}"
    if missing and used and getattr(poses, "form", ""):
        warnings.warn(f"{lacks}, {len(missing)} of {len(images)} pictures: left out", UserWarning, stacklevel=2)
    elif missing:
        names = _some([each for each in bases if each])
        column = f"its column 'frame' must name each image, and has {names}. Add a line for it, or leave that image out"
        raise PoseError(f"{lacks}: {column}")
    if twice:
        raise PoseError(f"{name} has several poses for {_some(twice)}; leave 'frame' empty on all lines but one")
    return pairs


def _base(path: str) -> str:
    """The last part of a path, of Windows too."""
    return path.replace("\\", "/").rstrip("/").rpartition("/")[2]


def _cut(text: str) -> str:
    return text if len(text) <= 200 else text[:197] + "..."


def _some(names: Sequence[str]) -> str:
    """The first few names."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more
