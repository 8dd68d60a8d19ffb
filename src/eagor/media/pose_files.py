"""Poses from a file, and their frames.

The first line names the columns, in any order; other columns are ignored:

- ``stamp``: seconds, on the clock of the frames, increasing. Counts of milli-, micro- or nanoseconds since 1970 are
  read as such, others where the name says so (``stamp_ms``).
- the orientation ``world_R_body`` (REP-103: x forward, y left, z up), either as the unit quaternion ``qw,qx,qy,qz`` or
  as ``yaw_deg,pitch_deg,roll_deg`` (or ``_rad``): yaw to the left, then pitch (positive: nose DOWN), then roll.
- ``x,y,z`` (optional): position in metres in the world frame.
- ``frame`` (optional): the image captured in this pose; empty for odometry between the frames. Without this column,
  lines and frames are paired in order, one each.

Blank lines, and lines that begin with ``#``, are skipped. The forms of other programs: `eagor.media.pose_forms`; which
axes they have: `eagor.media.pose_axes`.
"""

from __future__ import annotations

import csv
import io
import math
import warnings
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from eagor._checks import LATEST, checked_stamp
from eagor._files import read_file
from eagor.conventions import rotation_from_wxyz, wxyz_from_rotation
from eagor.errors import EagorError, FormatError, PoseError, RotationError, TimeError
from eagor.media import Pose
from eagor.media.pose_forms import MUCH, Placed, Table, base_name, colmap, nerfstudio, table_of
from eagor.sphere import world_R_body
from eagor.tracking.poses import FARTHEST, PoseHistory

QUATERNION = ("qw", "qx", "qy", "qz")
ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")
POSITION = ("x", "y", "z")
HEADERS = "stamp,qw,qx,qy,qz[,x,y,z][,frame] or stamp,yaw_deg,pitch_deg,roll_deg[,x,y,z][,frame]"
COUNTS = ((1e4, ("milliseconds", "ms")), (1e7, ("microseconds", "us")), (math.inf, ("nanoseconds", "ns")))
APART = 10.0  # seconds between poses from which on they are rather counts of something shorter
_NORM_TOLERANCE = 0.01  # a quaternion printed with three digits is still one
BEYOND = 0.05  # seconds: what lies so far outside of the poses still takes the nearest one


class FramePose(NamedTuple):
    """One line: stamp in seconds, `world_R_body` ``(3, 3)``, `position` ``(3,)`` in metres or None, frame's name."""

    stamp: float
    world_R_body: np.ndarray
    position: np.ndarray | None
    frame: str | None

    @property
    def near(self) -> bool:
        """Whether the position can be one: a lost estimate of a robot's place often ends in numbers without end."""
        return self.position is None or bool((np.abs(self.position) <= FARTHEST).all())


class Poses(tuple[FramePose, ...]):
    """The poses of a file. `axes`: those of `eagor.media.pose_axes` that its form tells, "" if none, "body?": ours.

    `form`: that of another program, in words. `partial`: it may lack pictures.
    """

    axes = form = ""
    partial = False

    def made(self, poses: Iterable[FramePose]) -> Poses:
        """Others of the same file."""
        found = Poses(poses)
        found.__dict__.update(self.__dict__)
        return found


def read_poses(path: str | Path) -> Poses:
    """The poses in the file, sorted by time (format: this module's text).

    Raises `FormatError` for a violation of the format, `RotationError` for a quaternion that is not of unit length,
    `TimeError` if the stamps do not increase; each error names the file and the line.
    """
    try:
        data = read_file(path)
        text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except (OSError, ValueError) as error:  # UnicodeDecodeError, and null characters in the path
        raise FormatError(f"{path} cannot be read as text ({error}); give a CSV file of poses: {HEADERS}") from error
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    try:
        placed = nerfstudio(text) if text.lstrip().startswith("{") else colmap(text)
    except FormatError as error:
        raise FormatError(f"{path} {error}") from error
    if placed is not None:
        return _of_placed(placed)
    try:
        table = table_of(text)
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from error
    if table is None:
        raise FormatError(f"{path} is empty; wanted a line with the names of the columns: {HEADERS}")
    names = table.names
    try:
        _check_header(names)
    except FormatError as error:
        raise FormatError(f"{path}, line {table.first}: {error}") from error
    poses = Poses(_at_once(table) or _one_by_one(path, table))
    if not poses:
        raise FormatError(f"{path} has a header but no poses; wanted one line per frame: {HEADERS}")
    poses.axes = ("body?" if table.ours else "") if "qw" in names else "body"
    _say_units(path, table, poses)
    if "qw" in names and _is_another_order(poses):
        warnings.warn(
            f"{path}: the camera is upside down, or leans as no robot does. xyzw? The scalar part is qw, which "
            "messages of ROS have last; nothing is wrong if the camera hangs upside down, or tumbles",
            UserWarning,
            stacklevel=2,
        )
    return poses


def _of_placed(placed: Placed) -> Poses:
    every = zip(placed.stamps, placed.turns, placed.places, placed.names, strict=True)
    poses = Poses(FramePose(*each) for each in every)
    poses.axes, poses.form, poses.partial = placed.axes, placed.form, True
    return poses


def _say_units(path: str | Path, table: Table, poses: Poses) -> None:
    """Warn of stamps that are hardly seconds."""
    stamps = np.array([pose.stamp for pose in poses])
    apart = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    if table.unit == 1 and apart >= APART:
        what, short = next(names for most, names in COUNTS if apart < most)
        text = f"{path}: its poses are {apart:g} s apart. Are the stamps {what}? Then call that column stamp_{short}"
        warnings.warn(text, UserWarning, stacklevel=3)


def _is_another_order(poses: Sequence[FramePose]) -> bool:
    """Whether quaternions seem to be in another order than their columns say; some of the lines tell.

    Either the camera is upside down in every line, or it leans by more than 60 degrees in some, and would in none if
    the scalar part were in the last column of the four, or if the columns qx, qy, qz, qw held w, x, y, z.
    """
    some = poses[:: 1 + len(poses) // 1000]
    w, x, y, z = wxyz_from_rotation(np.array([pose.world_R_body for pose in some])).T ** 2
    up, last, first = 1 - 2 * (x + y), 1 - 2 * (w + x), 1 - 2 * (y + z)
    return bool((up < 0).all() or ((up < 0.5).any() and ((last > 0.5).all() or (first > 0.5).all())))


def _at_once(table: Table) -> tuple[FramePose, ...] | None:
    """The poses of a log of odometry, all lines below the header together: there may be millions.

    None where a line is wrong, for `_one_by_one` to say, and for what NumPy's reader does not take as it is meant:
    names of frames, quotes, comments.
    """
    names, body = table.names, table.body
    if "frame" in names or not body.strip() or any(mark in body for mark in '#"'):
        return None
    try:
        rows = np.loadtxt(io.StringIO(body), delimiter=",", ndmin=2)
    except ValueError:
        return None
    if rows.shape[1] != len(names):
        return None
    stamps, turns, places = (
        rows[:, [names.index(name) for name in columns if name in names]]
        for columns in (("stamp",), QUATERNION if "qw" in names else ANGLES, POSITION)
    )
    stamps = stamps / table.unit
    if not all((np.abs(part) < MUCH).all() for part in (turns, places)) or not (np.abs(stamps) <= LATEST).all():
        return None
    lengths = np.linalg.norm(turns, axis=1) if "qw" in names else np.ones(1)
    if (np.abs(lengths - 1) > _NORM_TOLERANCE).any() or (np.diff(stamps[:, 0]) <= 0).any():
        return None
    if "qw" in names:
        matrices = rotation_from_wxyz(turns / lengths[:, None])
    else:
        matrices = Rotation.from_euler("ZYX", turns * table.degree, degrees=True).as_matrix()
    nothing = [None] * len(rows)
    return tuple(map(FramePose, stamps[:, 0].tolist(), matrices, places if "x" in names else nothing, nothing))


def _one_by_one(path: str | Path, table: Table) -> tuple[FramePose, ...]:
    """The same, line by line. Raises the error of the first line that has one."""
    poses: list[FramePose] = []
    for number, fields in _lines(path, table):
        try:
            pose = _pose(table, [field.strip() for field in fields])
            if poses and pose.stamp <= poses[-1].stamp:
                raise TimeError(
                    f"stamp {pose.stamp:.6f} comes after {poses[-1].stamp:.6f}; wanted increasing stamps. "
                    "Sort the lines by stamp, and split the file where the clock was reset"
                )
        except EagorError as error:
            raise type(error)(f"{path}, line {number}: {error}") from error
        poses.append(pose)
    return tuple(poses)


def usable(poses: Sequence[FramePose], name: str | Path) -> Sequence[FramePose]:
    """Those that are `near`; that others are left out is a `UserWarning`. Raises `PoseError` if none is left."""
    if poses[0].position is None or (np.abs([pose.position for pose in poses]) <= FARTHEST).all():  # type: ignore[arg-type]
        return poses
    near = tuple(pose for pose in poses if pose.near)
    first = next(pose for pose in poses if not pose.near)
    text = (
        f"{name}: the position at {first.stamp:.10g} s is {first.position.tolist()}; wanted metres, each within "  # type: ignore[union-attr]
        f"{FARTHEST:g} of the origin"
    )
    if not near:
        raise PoseError(f"{text}. So are all others: are they metres?")
    warnings.warn(f"{text}. Left out: {len(poses) - len(near)} of {len(poses)} poses", UserWarning, stacklevel=2)
    return near


def interpolated(poses: Sequence[FramePose]) -> Callable[[float], tuple[np.ndarray, np.ndarray | None]]:
    """The pose at any time, as `between` tells it, however many `poses` there are: a tracker keeps fewer."""
    stamps = [pose.stamp for pose in poses]

    def at(stamp: float) -> tuple[np.ndarray, np.ndarray | None]:
        after = bisect_left(stamps, stamp)
        return between(poses[after - 1] if after else None, poses[after] if after < len(poses) else None, stamp)

    return at


def between(
    last: FramePose | Pose | None, ahead: FramePose | Pose | None, stamp: float
) -> tuple[np.ndarray, np.ndarray | None]:
    """Orientation ``(3, 3)`` and position ``(3,)`` at `stamp`, from the poses before and after it, if there are any."""
    if last is None:
        assert ahead is not None
        return ahead.world_R_body, ahead.position
    if ahead is None:
        return last.world_R_body, last.position
    two = PoseHistory(math.inf)
    for each in (last, ahead):
        two.add(each.stamp, each.world_R_body, each.position)
    return two.at(stamp)


def pair(
    poses: Sequence[FramePose], images: Sequence[Path], name: str | Path = "the pose file"
) -> tuple[tuple[FramePose, Path | None], ...]:
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
    by_name = {image.name: image for image in images}
    by_stem = {image.stem: image for image in images}
    if len(by_name) < len(images):
        twice = sorted(n for n in by_name if sum(image.name == n for image in images) > 1)
        raise PoseError(f"two frames are called {twice[0]}; rename one, because poses refer to frames by name")
    told = [base_name(pose.frame) if pose.frame else "" for pose in poses]  # nerfstudio may leave out the ending
    pairs = tuple((pose, by_name.get(each) or by_stem.get(each)) for pose, each in zip(poses, told, strict=True))
    used = [image.name for _, image in pairs if image is not None]
    missing = [n for n in by_name if n not in used]
    if missing and used and getattr(poses, "partial", False):
        text = f"{name} has no pose for {_some(missing)}, {len(missing)} of {len(images)} pictures: left out"
        warnings.warn(text, UserWarning, stacklevel=2)
    elif missing:
        raise PoseError(
            f"{name} has no pose for {_some(missing)}: its column 'frame' must name each image. "
            "Add a line for it, or leave that image out"
        )
    if len(used) > len(by_name):
        twice = sorted(n for n in by_name if used.count(n) > 1)
        raise PoseError(f"{name} has several poses for {_some(twice)}; leave 'frame' empty on all lines but one")
    return pairs


def _lines(path: str | Path, table: Table) -> Iterator[tuple[int, list[str]]]:
    """Line numbers and fields, without blank lines and comments."""
    reader = csv.reader(io.StringIO(table.body, newline=""), strict=True)
    try:
        for fields in reader:
            if fields and (fields[0].strip() or any(map(str.strip, fields))) and not fields[0].lstrip().startswith("#"):
                yield table.first + reader.line_num, fields
    except csv.Error as error:
        raise FormatError(
            f"{path}, line {table.first + reader.line_num}: is not CSV ({error}); wanted {HEADERS}"
        ) from error


def _check_header(names: Sequence[str]) -> None:
    """Raise `FormatError` unless there is a stamp and exactly one form of orientation, each column once."""
    known = ("stamp", *QUATERNION, *ANGLES, *POSITION, "frame")
    twice = sorted({n for n in names if n in known and names.count(n) > 1})
    if twice:
        raise FormatError(f"the column {twice[0]!r} appears twice")
    groups = {group: [n for n in group if n in names] for group in (QUATERNION, ANGLES, POSITION)}
    for group, found in groups.items():
        if found and len(found) < len(group):
            raise FormatError(f"has {', '.join(found)} but not {', '.join(n for n in group if n not in found)}")
    if "stamp" not in names or bool(groups[QUATERNION]) == bool(groups[ANGLES]):
        hint = " (fields must be separated by commas)" if len(names) == 1 else ""
        hint += "; yaw in degrees or radians? Name it yaw_deg or yaw_rad" if "yaw" in names else ""
        raise FormatError(f"the columns are {_cut(', '.join(names))}{hint}; wanted {HEADERS}")


def _pose(table: Table, fields: Sequence[str]) -> FramePose:
    names = table.names
    if len(fields) != len(names):
        raise FormatError(f"has {len(fields)} fields where the header has {len(names)}; cut off, or a comma too many?")
    row = dict(zip(names, fields, strict=True))
    if "qw" in row:
        matrix = _from_quaternion([_number(row, n) for n in QUATERNION])
    else:
        matrix = world_R_body(*(math.radians(_number(row, n) * table.degree) for n in ANGLES))
    position = np.array([_number(row, n) for n in POSITION]) if "x" in row else None
    stamp = checked_stamp(_number(row, "stamp") / table.unit)
    return FramePose(stamp, matrix, position, row.get("frame") or None)


def _from_quaternion(wxyz: Sequence[float]) -> np.ndarray:
    norm = math.hypot(*wxyz)
    if abs(norm - 1) > _NORM_TOLERANCE:
        raise RotationError(
            f"qw,qx,qy,qz = {', '.join(f'{v:g}' for v in wxyz)} is not a rotation: its length is {norm:.3g}, wanted 1. "
            "Normalise it; the scalar part comes first"
        )
    return rotation_from_wxyz(np.asarray(wxyz) / norm)


def _number(row: dict[str, str], name: str) -> float:
    try:
        value = float("x" if "_" in row[name] else row[name])  # Python would take 1_0 for 10
    except ValueError:
        raise FormatError(f"{name} is {_cut(repr(row[name]))}; wanted a number") from None
    if not math.isfinite(value):
        raise FormatError(f"{name} is {_cut(row[name])}; wanted a finite number. Leave out lines without a known pose")
    return value


def _cut(text: str) -> str:
    return text if len(text) <= 200 else text[:197] + "..."


def _some(names: Sequence[str]) -> str:
    """The first few names."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more
