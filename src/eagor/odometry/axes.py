"""The axes that poses of other programs have: told by the file's form, or found from how the pictures turn.

A turn to the left is about another axis, or the other way round, for each convention: so a few pairs of pictures tell
which it is. They also tell where a file contradicts its pictures: radians for degrees, rotations that are inverted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from eagor.conventions import HABITAT_R_BODY, OPTICAL_R_BODY
from eagor.errors import EagorError, PoseError
from eagor.odometry import Pose
from eagor.odometry.files import GivenPoses, is_near

__all__ = ["AXES", "contradicted", "settled", "with_axes"]

AXES = {  # the axes of the poses in the body: body_R_pose; x, y, z in words
    "body": (np.eye(3), "x ahead, y left, z up"),
    "optical": (OPTICAL_R_BODY.T, "x right, y down, z ahead"),
    "opengl": (HABITAT_R_BODY.T, "x right, y up, z back"),
    "euroc": (np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]), "x up, y right, z ahead"),
}
LEAST, MOST = math.radians(5), math.radians(60)  # of a turn between two pictures that are compared
# Pairs that tell how the camera turns, those that are compared at most, pictures that are looked through for them, and
# seconds after which two are compared although the poses hardly turn.
PAIRS, TRIED, LOOKED, APART = 6, 9, 400, 1.0
SIZE = 256  # pixels of views of panoramas that are compared: half as many still tell their turn to half a degree
FITS, DIFFERS = 0.3, 0.6  # of the squares: what is left over of turns that fit, and of others
# Poses contradict where most turns differ from those of the pictures by half, and by these degrees; what is wrong with
# them fits where it leaves less. Of a camera that walks, one pair in ten may be off by 20 degrees: without a reason,
# many have to be.
OFF, CLOSE, MANY = math.radians(8), math.radians(3), 4
LEVEL = 0.7  # cosine: a camera whose up is mostly this near to the world's
STILL = 0.05  # metres: a camera that moves no farther stands

Shown = Any  # an object with a `picture`, and the `grid` of an ordinary one


def with_axes(poses: GivenPoses, axes: str) -> GivenPoses:
    """The poses of a camera that has these `axes`, in ours: x ahead, y left, and a world whose z is up.

    Where the world's z is not, it is that of the first camera (SLAM), or turned by what is up for most of them.
    """
    if axes == "body":
        return poses
    body_R_pose = AXES[axes][0]
    turns = np.array([pose.world_R_body for pose in poses]) @ body_R_pose.T
    up = turns[:, :, 2].mean(axis=0)
    level = np.eye(3)
    if up[2] <= LEVEL:
        first_camera = (body_R_pose @ up)[2] > LEVEL or np.linalg.norm(up) < 0.5
        level = body_R_pose if first_camera else Rotation.align_vectors([[0.0, 0, 1]], [up])[0].as_matrix()
    return poses.made(
        replace(pose, world_R_body=level @ turn, position=None if pose.position is None else level @ pose.position)
        for pose, turn in zip(poses, turns, strict=True)
    )


def settled(
    poses: GivenPoses,
    axes: str,
    name: str,
    frames: Callable[[], Iterable[tuple[Pose, Shown]]] | None,
    say: Callable[[str], object],
) -> GivenPoses:
    """The poses in our axes. `axes`: "auto", or a name of `AXES`; `frames`: poses with their pictures.

    Raises `PoseError` where nothing tells the axes of a file in which they may be others, and where the pictures tell
    what is wrong with the poses. With `axes` that is only said, and of "body" nothing is.
    """
    if axes == "body":
        return poses
    given, pairs = axes != "auto", list[_Pair]()
    with suppress(EagorError):  # who looks at the frames meets it again, and says so
        pairs += () if frames is None else _pairs(frames(), poses[-1].stamp - poses[0].stamp)
    if not given and poses.axes in AXES:
        axes = poses.axes
        if poses.form:
            say(f"{name} is {poses.form}: its axes are {AXES[axes][1]}")
    elif not given:
        axes = _found(poses, pairs, name, say)
    wrong = _contradiction(pairs, axes)
    if wrong is not None:
        text, reason = wrong
        if reason and not given:
            raise PoseError(f"{name} contradicts the pictures: {text}; --axes body reads them as they stand")
        say(f"warning: {name} contradicts the pictures: {text}")
    return with_axes(poses, axes)


def contradicted(frames: Iterable[tuple[Pose, Shown]], axes: Callable[[], str]) -> str | None:
    """In words, where poses of ROS contradict the pictures that were taken there, or None; `axes`: those they had."""
    pairs = list[_Pair]()
    with suppress(EagorError):  # who looks at the frames meets it again, and says so
        pairs += _pairs(frames)
    wrong = _contradiction(pairs, axes(), ("body", "optical"))  # REP-103 has no others
    return wrong and wrong[0]


def _found(poses: GivenPoses, pairs: Sequence[_Pair], name: str, say: Callable[[str], object]) -> str:
    """The axes of a file that does not tell them. Raises `PoseError` where it has to."""
    some = poses[:: 1 + len(poses) // 1000]
    turns = np.array([pose.world_R_body for pose in some])
    bent = Rotation.from_matrix(turns[0].T @ turns).as_rotvec()
    squares, turned = (bent**2).sum(axis=0), np.linalg.norm(bent, axis=1).max() > LEAST
    places = np.array([pose.position for pose in poses if pose.position is not None and is_near(pose)]).reshape(-1, 3)
    gone = np.ptp(places, axis=0) if len(places) else np.zeros(3)  # along each axis of its world
    # With our axes a camera would hardly turn about its vertical, or lie on its side or back, or fly up.
    odd = (turned and squares[2] < 0.5 * squares.sum()) or turns[:, 2, 2].mean() < 0.5
    odd = bool(odd or gone[2] > max(STILL, LEVEL * float(np.linalg.norm(gone))))
    if not odd and poses.axes == "body?":
        return "body"
    found = _fitting(pairs)
    if found != "body" and any(_other_order(turns, pairs)):
        raise PoseError(
            f"{name}: its quaternions have another order: with the scalar part at the other end, it turns as the "
            "pictures do. Name the columns so (the scalar part is qw); --axes body reads them as they stand"
        )
    if found is None and poses.axes != "body?":
        # It tells axes at all if it turned, or does not move, or has a heading.
        if odd or not (turned or gone.max() <= STILL or _angle(turns[0]) > LEAST):
            known = [wrong[0] for axes in AXES if (wrong := _contradiction(pairs, axes, ())) and wrong[1]]
            shown = f"{known[0]}; or" if known else "the pictures do not show how they turn: wanted"
            raise PoseError(
                f"{name} does not tell the axes of its poses, and {shown} "
                f"--axes {', '.join(f'{each} ({words})' for each, (_, words) in AXES.items())}"
            )
    elif found is None:
        say(
            f"warning: {name}: the camera turns or leans as if its axes were others than x ahead, y left, z up, as "
            "those of SLAM (optical: x right, y down, z ahead). They are read as they stand; --axes optical reads them "
            "so, and --axes body says that nothing is wrong. Or are its quaternions xyzw? The scalar part is qw"
        )
    elif found != "body":
        say(f"{name}: its axes are {AXES[found][1]}, as the pictures turn (--axes {found}); --axes body: as they stand")
    return found or "body"


class _Pair(NamedTuple):
    """Two poses of a file ``(3, 3)`` at their stamps, and the turn ``(3, 3)`` of the pictures that were taken there."""

    stamps: tuple[float, float]
    before: np.ndarray
    after: np.ndarray
    seen: np.ndarray


def _pairs(frames: Iterable[tuple[Pose, Shown]], lasts: float = math.inf) -> Iterator[_Pair]:
    """Pairs of pictures between which the camera turns, by its poses or by the pictures themselves; of `lasts` s."""
    from eagor.odometry.features import Views, match
    from eagor.odometry.two_views import estimate_relative_rotation

    last, found, tried, apart = None, 0, 0, min(APART, lasts / PAIRS)
    for pose, frame in islice(frames, LOOKED):
        if found >= PAIRS or tried >= TRIED:
            return
        far = 0.0 if last is None else _angle(last[0].world_R_body.T @ pose.world_R_body)
        if last is not None and far < LEAST and pose.stamp - last[0].stamp < apart:
            continue
        with suppress(EagorError):  # who looks at it meets it again, and says so
            views = Views.of(frame.picture, frame.grid, SIZE)
            if last is not None and far < MOST:
                tried += 1
                a, b = match(here := last[1].features, there := views.features)
                area = views.area
                turn = estimate_relative_rotation(here.directions[a], there.directions[b], area=area)
                if turn is None:  # too far apart, perhaps
                    apart /= 2
                elif max(far, _angle(turn.old_R_new)) < LEAST:  # what stands may stand for long
                    apart *= 2
                else:
                    found += 1
                    yield _Pair((last[0].stamp, pose.stamp), last[0].world_R_body, pose.world_R_body, turn.old_R_new)
            last = pose, views


def _angle(rotation: np.ndarray) -> float:
    return float(Rotation.from_matrix(rotation).magnitude())


def _fitting(pairs: Sequence[_Pair]) -> str | None:
    """The one convention in which the turns of the poses are those of the pictures."""
    if not pairs:
        return None
    told = Rotation.from_matrix([pair.before.T @ pair.after for pair in pairs]).as_rotvec()
    seen = Rotation.from_matrix([pair.seen for pair in pairs]).as_rotvec()
    left = {
        axes: float(((seen - told @ body_R_pose.T) ** 2).sum() / (told**2).sum())
        for axes, (body_R_pose, _) in AXES.items()
    }
    best, other = sorted(left, key=left.__getitem__)[:2]
    return best if left[best] < FITS and left[other] > DIFFERS else None


def _other_order(turns: np.ndarray, pairs: Sequence[_Pair]) -> Iterator[bool]:
    """Whether it is a level camera with our axes, turning as the pictures do, with the scalar at the other end."""
    for by in (1, -1):

        def other(turn: np.ndarray, by: int = by) -> np.ndarray:
            return Rotation.from_quat(np.roll(Rotation.from_matrix(turn).as_quat(), by, axis=-1)).as_matrix()

        exchanged = [pair._replace(before=other(pair.before), after=other(pair.after)) for pair in pairs]
        yield _fitting(exchanged) == "body" and bool(other(turns)[:, 2, 2].mean() > LEVEL)


def _contradiction(pairs: Sequence[_Pair], axes: str, others: Iterable[str] = tuple(AXES)) -> tuple[str, bool] | None:
    """Where poses with these axes contradict the pictures, in words, and whether it is known why: `others` may be."""
    if not pairs:
        return None
    before, after, seen = (np.array(each) for each in list(zip(*pairs, strict=True))[1:])

    def turns(relative: np.ndarray, axes: str = axes) -> np.ndarray:
        return AXES[axes][0] @ relative @ AXES[axes][0].T

    def off(turned: np.ndarray) -> np.ndarray:
        return Rotation.from_matrix(turned.transpose(0, 2, 1) @ seen).magnitude()

    relative = before.transpose(0, 2, 1) @ after
    told = turns(relative)
    size = np.maximum(Rotation.from_matrix(told).magnitude(), Rotation.from_matrix(seen).magnitude())
    if (off(told) > np.maximum(OFF, size / 2)).mean() < 0.75:
        return None
    worst = int(np.argmax(off(told)))
    begin, end = pairs[worst].stamps
    text = (
        f"from {begin:.12g} to {end:.12g} s the camera turns {_in_words(told[worst])} by its poses, and "
        f"{_in_words(seen[worst])} by what it shows"
    )
    mirror = np.diag([1.0, -1, 1])
    inverted = "the other way round. Wanted are rotations of the camera in the world (world_R_body), with yaw positive "
    inverted += "to the left: transpose them, or change the sign of the yaw"
    radians = "57 times as far: its angles are radians. Name the columns yaw_rad,pitch_rad,roll_rad"
    larger = Rotation.from_rotvec(np.degrees(Rotation.from_matrix(told).as_rotvec())).as_matrix()
    reasons = [
        (inverted, turns(before @ after.transpose(0, 2, 1))),
        (inverted, mirror @ told @ mirror),
        (radians, larger),
    ]
    reasons += [(f"its axes are {AXES[other][1]}: --axes {other}", turns(relative, other)) for other in others]
    left, best = min((float(np.median(off(fits))), reason) for reason, fits in reasons)
    if left < max(CLOSE, 0.4 * float(np.median(size))):
        return f"{text}: {best}", True
    if len(pairs) < MANY:
        return None
    return f"{text}. Are they the poses of this camera, with stamps of the pictures' clock?", False


def _in_words(turn: np.ndarray) -> str:
    vector = np.degrees(Rotation.from_matrix(turn).as_rotvec())
    angle, side = float(np.linalg.norm(vector)), "left" if vector[2] > 0 else "right"
    return f"by {angle:.0f} degrees" + (f" to the {side}" if abs(vector[2]) > 0.8 * angle and angle >= 0.5 else "")
