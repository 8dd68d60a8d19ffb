"""The axes that poses of other programs have: told by the file's form, or found from how the pictures turn.

A turn to the left is about another axis, or the other way round, for each convention: so a few pairs of pictures tell
which it is.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from eagor.conventions import HABITAT_R_BODY, OPTICAL_R_BODY
from eagor.errors import EagorError, PoseError
from eagor.media import Pose
from eagor.media.footage import Read
from eagor.media.pose_files import FramePose, Poses, read_poses

__all__ = ["AXES", "odometry_of_file", "settled", "with_axes"]

AXES = {  # the axes of the poses in the body: body_R_pose; x, y, z in words
    "body": (np.eye(3), "x ahead, y left, z up"),
    "optical": (OPTICAL_R_BODY.T, "x right, y down, z ahead"),
    "opengl": (HABITAT_R_BODY.T, "x right, y up, z back"),
    "euroc": (np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]), "x up, y right, z ahead"),
}
LEAST, MOST = math.radians(5), math.radians(60)  # of a turn between two pictures that are compared
PAIRS, LOOKED = 6, 400  # pairs that are compared, pictures that are looked through for them
FITS, DIFFERS = 0.3, 0.6  # of the squares: what is left over of turns that fit, and of others
LEVEL = 0.7  # cosine: a camera whose up is mostly this near to the world's
STILL = 0.05  # metres: a camera that moves no farther stands


def with_axes(poses: Poses, axes: str) -> Poses:
    """The poses of a camera that has these `axes`, in ours: x ahead, y left, and a world whose z is up.

    Where the world's z is not, it is that of the first camera (SLAM), or turned by what is up for most of them.
    """
    if axes == "body":
        return poses
    body_R_pose = AXES[axes][0]
    turns = np.array([pose.world_R_body for pose in poses]) @ body_R_pose.T
    up = turns[:, :, 2].mean(axis=0)
    if up[2] > LEVEL:
        level = np.eye(3)
    elif (body_R_pose @ up)[2] > LEVEL or np.linalg.norm(up) < 0.5:
        level = body_R_pose
    else:
        level = Rotation.align_vectors([[0.0, 0, 1]], [up])[0].as_matrix()
    made = (
        FramePose(pose.stamp, level @ turn, None if pose.position is None else level @ pose.position, pose.frame)
        for pose, turn in zip(poses, turns, strict=True)
    )
    return poses.made(made)


def settled(
    poses: Poses,
    axes: str,
    name: str,
    frames: Callable[[], Iterable[tuple[FramePose, Read | None]]] | None,
    say: Callable[[str], object],
) -> Poses:
    """The poses in our axes. `axes`: "auto", or a name of `AXES`; `frames`: poses with what reads their pictures.

    Raises `PoseError` where nothing tells the axes of a file in which they may be others.
    """
    if axes == "auto" and poses.small and frames is not None:
        _check_degrees(list(_turns(frames(), math.degrees(1))), name)
    if axes == "auto" and poses.axes in AXES:
        axes = poses.axes
        if poses.form:
            say(f"{name} is {poses.form}: its axes are {AXES[axes][1]}")
    if axes != "auto":
        return with_axes(poses, axes)
    odd = _is_odd(poses)
    if not odd and poses.axes == "body?":
        return poses
    found = _fitting([] if frames is None else list(_turns(frames(), 1.0)))
    if found is None and (odd or not _tells(poses)) and poses.axes != "body?":
        raise PoseError(
            f"{name} does not tell the axes of its poses, and the pictures do not show how they turn: wanted --axes "
            f"{', '.join(f'{each} ({words})' for each, (_, words) in AXES.items())}"
        )
    if found is None and odd:
        say(
            f"warning: {name}: the camera turns or leans as if its axes were others than x ahead, y left, z up, as "
            "those of SLAM (optical: x right, y down, z ahead). They are read as they stand; --axes optical reads them "
            "so, and --axes body says that nothing is wrong"
        )
    if found not in (None, "body"):
        say(f"{name}: its axes are {AXES[found][1]}, as the pictures turn (--axes {found}); --axes body: as they stand")
    return with_axes(poses, found or "body")


def odometry_of_file(path: str | Path, axes: str = "auto") -> list[Pose]:
    """The poses of a file, in our axes, as those of odometry; raises as `read_poses` and `settled`."""
    poses = settled(
        read_poses(path), axes, str(path), None, lambda text: warnings.warn(text, UserWarning, stacklevel=2)
    )
    return [Pose(each.stamp, each.world_R_body, each.position) for each in poses]


def _relative(poses: Sequence[FramePose]) -> np.ndarray:
    """Rotation vectors ``(n, 3)`` from the first pose to some others, in its axes."""
    turns = np.array([pose.world_R_body for pose in poses[:: 1 + len(poses) // 1000]])
    return Rotation.from_matrix(turns[0].T @ turns).as_rotvec()


def _is_odd(poses: Sequence[FramePose]) -> bool:
    """Whether a camera with our axes would hardly turn about its vertical, lie on its side or back, or fly up."""
    bent, gone = _relative(poses), _gone(poses)
    squares = (bent**2).sum(axis=0)
    turned = np.linalg.norm(bent, axis=1).max() > LEAST
    ups = np.array([pose.world_R_body[2, 2] for pose in poses[:: 1 + len(poses) // 1000]])
    rises = gone[2] > max(STILL, LEVEL * float(np.linalg.norm(gone)))
    return bool((turned and squares[2] < 0.5 * squares.sum()) or ups.mean() < 0.5 or rises)


def _gone(poses: Sequence[FramePose]) -> np.ndarray:
    """How far it went along each axis of its world ``(3,)``, metres."""
    places = np.array([pose.position for pose in poses if pose.position is not None and pose.near]).reshape(-1, 3)
    return np.ptp(places, axis=0) if len(places) else np.zeros(3)


def _tells(poses: Sequence[FramePose]) -> bool:
    """Whether how it turns and stands tells axes at all: it turned, or does not move, or has a heading."""
    bent, moved = _relative(poses), float(_gone(poses).max()) > STILL
    turned = np.linalg.norm(bent, axis=1).max() > LEAST
    return bool(turned or not moved or np.arccos(np.clip((np.trace(poses[0].world_R_body) - 1) / 2, -1, 1)) > LEAST)


def _turns(frames: Iterable[tuple[FramePose, Read | None]], scale: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Rotation vectors ``(3,)`` of the poses, and of the pictures that were taken there, of some pairs."""
    from eagor._extras import need
    from eagor.media.rotation import VisualOdometer

    try:
        need("the rotation from pictures", "photos", "cv2")
    except EagorError:
        return
    last, found = None, 0
    for pose, read in islice((each for each in frames if each[1] is not None), LOOKED):
        turn = np.zeros(3) if last is None else Rotation.from_matrix(last[0].T @ pose.world_R_body).as_rotvec()
        far = scale * float(np.linalg.norm(turn))
        if found >= PAIRS:
            return
        if last is not None and far < LEAST:
            continue
        try:
            assert read is not None
            picture = read()
            if last is not None and far < MOST:
                odometer = VisualOdometer()
                odometer.add(last[1].picture, 0.0, last[1].grid)
                seen = odometer.add(picture.picture, 1.0, picture.grid)
                if not seen.lost and seen.matches:
                    found += 1
                    yield turn, Rotation.from_matrix(seen.world_R_body).as_rotvec()
        except EagorError:  # who looks at it meets it again, and says so
            continue
        last = pose.world_R_body, picture


def _fitting(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> str | None:
    """The one convention in which the turns of the poses are those of the pictures."""
    if not pairs:
        return None
    told, seen = map(np.array, zip(*pairs, strict=True))
    left = {
        axes: float(((seen - told @ body_R_pose.T) ** 2).sum() / (told**2).sum())
        for axes, (body_R_pose, _) in AXES.items()
    }
    best, other = sorted(left, key=left.__getitem__)[:2]
    return best if left[best] < FITS and left[other] > DIFFERS else None


def _check_degrees(pairs: Sequence[tuple[np.ndarray, np.ndarray]], name: str) -> None:
    if not pairs:
        return
    told, seen = (float(np.linalg.norm(each, axis=1).sum()) for each in map(np.array, zip(*pairs, strict=True)))
    if seen > 30 * told:
        raise PoseError(
            f"{name}: the pictures turn {seen / told:.0f} times as far as its angles in degrees say: they are radians. "
            "Name the columns yaw_rad,pitch_rad,roll_rad"
        )
