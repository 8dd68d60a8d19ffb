"""How a camera turns, from its pictures alone: panoramas, or those of an ordinary camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from eagor._values import lazy
from eagor.errors import ImageError
from eagor.grids import PerspectiveGrid
from eagor.odometry.features import SIZE, Views, match
from eagor.odometry.two_views import RelativeRotation, angle_between, estimate_relative_rotation

__all__ = ["WALKS", "OdometryEstimate", "VisualOdometer"]

MOST_KEYS = (
    48  # key frames in memory, about 1 MB each; of an ordinary camera, to which each shows a part, twice as many
)
THIN, THIN_ALONE = 0.15, 0.3  # share of points found again below which a picture becomes a key frame: panoramas, others
OVERLAP = 0.2  # share of an ordinary picture that a key frame has to show to be compared with it
TRIED = 8  # key frames that a picture is compared with if none of those expected fits
FOLLOWED = 0.4  # share of a frame's corners found again by optical flow; with fewer, features are matched anew
CLOSE = math.radians(2)  # of the guess: flow from farther away is repeated, since views change with the turn
REPEATED = 3  # times, at most
SMALLEST = 128  # pixels of a view, however small the pictures are
FEWEST, FEW = 8, 32  # points: so few that match cannot be told from chance; a picture with so few shows hardly anything
WAIT = 2.0  # seconds for which an ordinary picture that fits to none before it is waited out
PUSHED, FASTEST = 10.0, 10.0  # rad/s^2 and rad/s: few cameras change their rate of turning, or turn, faster
STEADY = math.radians(2)  # of a turn that is expected, whatever the time
CONSISTENT = 16.3  # chi-square with three degrees of freedom, exceeded once in 1000
UNKNOWN = math.pi / math.sqrt(3), math.sqrt(math.pi**2 / 9 + 2 / 3)  # radians per axis: any heading, any rotation


WALKED = 3  # pictures in a row taken elsewhere than a frame before: of a camera that turns hardly one seems to be
WALKS = (
    "the camera walks, and its pictures tell how it turns, not how far it goes: what is near passes, so answers are "
    "less sure. Poses with positions mend that (--poses)"
)


@dataclass(frozen=True, eq=False)
class OdometryEstimate:
    """Where the camera points.

    `world_R_body` ``(3, 3)``; the first picture's body frame is the world, or that of the last picture with `lost`.
    `std`: standard deviation of the error, radians per axis (of the heading, if level). `lost`: True if this picture
    could not be related to those before it, so that the world starts anew. `matches`: points that agree; 0 for a
    picture in which there is nothing to see: then the rotation is the last known one, and the deviation grows.
    """

    world_R_body: np.ndarray
    std: float
    lost: bool
    matches: int


@dataclass(frozen=True, eq=False)
class _KeyFrame:
    """A picture to compare with: its pose, the `covariance` ``(3, 3)`` of that (world axes), and its `model_std`."""

    views: Views
    world_R_body: np.ndarray
    covariance: np.ndarray
    model_std: float = 0.0

    @lazy
    def error(self) -> float:
        """The expected square of the pose's angle of error, radians squared."""
        return float(np.trace(self.covariance)) + self.model_std**2

    def then(self, views: Views, turn: RelativeRotation) -> _KeyFrame:
        """The frame after a turn. A camera that walks is misled in the same way each time: model errors are added."""
        covariance = self.covariance + self.world_R_body @ turn.covariance @ self.world_R_body.T
        return _KeyFrame(views, self.world_R_body @ turn.old_R_new, covariance, self.model_std + turn.model_std)

    def agrees(self, other: _KeyFrame) -> bool:
        """Whether two poses differ by no more than their uncertainties explain."""
        gap = Rotation.from_matrix(self.world_R_body @ other.world_R_body.T).as_rotvec()
        both = self.covariance + other.covariance + (self.model_std**2 + other.model_std**2) / 3 * np.eye(3)
        return float(gap @ np.linalg.pinv(both) @ gap) < CONSISTENT


_Found = tuple[_KeyFrame, RelativeRotation]


class VisualOdometer:
    """The rotation of a camera, picture by picture. `level`: the pictures stay level, and only the heading turns.

    Corners are followed by optical flow from one frame, the anchor, to each picture, as long as many are found again.
    Where they are not, the picture's features are matched with key frames: the one that fitted last, the surest, and
    one of the others in turn, so that a camera that comes back loses its drift; the picture is the next anchor. A key
    frame is added where few points are found again. Not for several threads.

    Pictures of an ordinary camera are compared with the key frames that overlap with where it should look now. One that
    fits to none is waited out for `WAIT` seconds, since it may be blurred, covered, or of a side not seen before: the
    last rotation holds, and its deviation grows.
    """

    def __init__(self, *, level: bool = False) -> None:
        self.level = level
        self._keys: list[_KeyFrame] = []
        self._reference = self._next = 0  # the key frame that fitted last, and the one whose turn it is
        self._anchor: _KeyFrame | None = None
        self._previous: _KeyFrame | None = None  # the last picture that was found, and when
        self._stamp, self._missed = 0.0, 0  # and pictures without information since then
        self._rate: np.ndarray | None = None  # rotation vector per second, if two were found
        self._moved = 0  # pictures one after the other, in which it was elsewhere
        self.walks = False  # whether the camera has gone from place to place: how far, its pictures do not tell

    def add(
        self, picture: np.ndarray, stamp: float | None = None, grid: PerspectiveGrid | None = None
    ) -> OdometryEstimate:
        """The rotation of the body at the next picture ``(H, W, 3)`` uint8: a panorama, or an ordinary one with `grid`.

        `stamp`: seconds, rising; it helps where pictures are left out. Without stamps they count as evenly spaced, a
        second each. Sizes of panoramas may change from picture to picture; of ordinary ones `grid` has to fit each. The
        camera stays what it is. Raises `ImageError` for another array or size and for another kind of camera, and
        `MissingExtraError` without OpenCV.
        """
        stamp = self._stamp + self._missed + 1 if stamp is None else stamp
        before = self._previous
        if before is not None and before.views.whole != (grid is None):
            came, others = ("a panorama", "ordinary pictures") if grid is None else ("an ordinary picture", "panoramas")
            raise ImageError(f"{came} (grid = {grid!r}) after {others}; wanted one camera: take another VisualOdometer")
        source = picture if grid is None else Views.of(picture, grid)
        found = self._followed(self._anchor, source, stamp)
        if found is None:
            size = min(max(len(picture), SMALLEST), SIZE)
            views = source if isinstance(source, Views) else Views.of(picture, size=size)
            found = self._recognised(views, stamp)
            if found is None:
                return self._not_found(views, stamp)
            self._anchor = found[0]
        now, turn = found
        if before is not None:
            step = Rotation.from_matrix(before.world_R_body.T @ now.world_R_body).as_rotvec()
            self._rate = step / max(stamp - self._stamp, 1e-6)
        self._previous, self._stamp, self._missed = now, stamp, 0
        self._moved = 0 if turn.direction is None else self._moved + 1
        self.walks = self.walks or self._moved >= WALKED
        return OdometryEstimate(now.world_R_body, self._std(now), False, int(turn.inliers.sum()))

    def _not_found(self, views: Views, stamp: float) -> OdometryEstimate:
        """Of a picture that fits to none: it is waited out, or the world starts anew."""
        before, count = self._previous, len(views.features)
        few = count < (FEW if self._keys else FEWEST)
        if before is not None and (few or (not views.whole and stamp - self._stamp <= WAIT)):
            self._missed += 1
            std = UNKNOWN[not self.level]
            if self._rate is not None:
                turned = STEADY * self._missed + float(np.linalg.norm(self._rate)) * (stamp - self._stamp)
                std = min(std, math.hypot(self._std(before), turned / math.sqrt(1 if self.level else 3)))
            return OdometryEstimate(before.world_R_body, std, False, 0)
        start = _KeyFrame(views, np.eye(3), np.zeros((3, 3)))
        self._previous, self._stamp, self._missed, self._rate = start, stamp, 0, None
        self._keys, self._anchor = ([start], start) if count >= FEWEST else ([], None)
        self._reference = self._next = 0
        return OdometryEstimate(start.world_R_body, 0.0, before is not None, 0)

    def _followed(self, anchor: _KeyFrame | None, source: np.ndarray | Views, stamp: float) -> _Found | None:
        """Where a panorama, or an ordinary camera's view, points, if enough of the anchor's corners are found again."""
        if anchor is None:
            return None
        guess = anchor.world_R_body.T @ self._expected(stamp)
        enough = max(FEWEST, FOLLOWED * sum(map(len, anchor.views.corners)))
        for left in reversed(range(REPEATED)):
            views = anchor.views.steadied(source, guess)
            turn = self._turn(anchor, *anchor.views.followed(views), stamp)
            if turn is None or turn.inliers.sum() < enough:
                return None
            if not left or angle_between(guess, turn.old_R_new) < CLOSE:
                return anchor.then(source if isinstance(source, Views) else views, turn), turn
            guess = turn.old_R_new
        return None

    def _recognised(self, views: Views, stamp: float) -> _Found | None:
        """Where a picture points by its features; it may become a key frame, or the picture before it."""
        if not self._keys or self._previous is None:
            return None
        near, others = self._candidates(views, self._expected(stamp))
        found: dict[int, _Found] = {}
        if near:
            self._next = (self._next + 1) % len(near)
            surest = min(near, key=lambda index: self._keys[index].error)
            for index in dict.fromkeys((self._reference, surest, near[self._next])):
                if (each := self._matched(self._keys[index], views, stamp)) is not None:
                    found[index] = each
        if not found and (best := self._matched(self._previous, views, stamp)) is not None:
            self._add_key(self._previous)  # no key frame shows enough; the picture before does
            found[self._reference] = best
        if not found and not views.whole and (best := self._followed(self._previous, views, stamp)) is not None:
            if not self._candidates(views, best[0].world_R_body)[0]:  # both may be blurred, along the same way
                self._add_key(best[0])
            return best
        start = self._missed * TRIED % len(others) if others else 0
        for index in (others + others)[start : start + min(TRIED, len(others))] if not found else ():
            if (each := self._matched(self._keys[index], views, stamp)) is not None:
                found[index] = each
                break
        if not found:
            return None
        clearest, turn = max(found.values(), key=lambda each: each[1].inliers.sum())
        self._reference = min(
            (k for k, each in found.items() if clearest.agrees(each[0])), key=lambda k: found[k][0].error
        )
        best = found[self._reference]
        if turn.inliers.sum() < (THIN if views.whole else THIN_ALONE) * len(views.features):
            self._add_key(best[0])
        return best

    def _candidates(self, views: Views, pose: np.ndarray) -> tuple[list[int], list[int]]:
        """The key frames that show a part of a picture with this pose, and all, those first that look there."""
        axis = pose @ views.grids[0].body_R_view[:, 0]
        axes = [float(axis @ key.world_R_body @ key.views.grids[0].body_R_view[:, 0]) for key in self._keys]
        near = [
            index for index, key in enumerate(self._keys)
            if key.views.overlap(views, key.world_R_body.T @ pose) >= OVERLAP
        ]  # fmt: skip
        return near, sorted(range(len(axes)), key=lambda index: -axes[index])

    def _matched(self, key: _KeyFrame, views: Views, stamp: float) -> _Found | None:
        """A picture's pose by way of features that a key frame has, too."""
        here, there = key.views.features, views.features
        old, new = match(here, there)
        turn = self._turn(key, here.directions[old], there.directions[new], stamp)
        return None if turn is None else (key.then(views, turn), turn)

    def _turn(self, key: _KeyFrame, old: np.ndarray, new: np.ndarray, stamp: float) -> RelativeRotation | None:
        """The turn from a key frame; of an ordinary camera, what it can be: the less time has passed, the less."""
        guess, since = None, stamp - self._stamp
        if not key.views.whole:
            most = STEADY + (FASTEST * since if self._rate is None else PUSHED * since**2 / 2)
            guess = key.world_R_body.T @ self._expected(stamp), most
        return estimate_relative_rotation(old, new, level=self.level, area=key.views.area, guess=guess)

    def _expected(self, stamp: float) -> np.ndarray:
        """Where a camera that has been found before should point now, if it turns on."""
        assert self._previous is not None
        turn = Rotation.from_rotvec(np.zeros(3) if self._rate is None else self._rate * (stamp - self._stamp))
        return (Rotation.from_matrix(self._previous.world_R_body) * turn).as_matrix()  # orthogonal: no rounding grows

    def _add_key(self, key: _KeyFrame) -> None:
        """Keep a key frame; beyond the limit the oldest but one goes."""
        self._keys.append(key)
        if len(self._keys) > MOST_KEYS * (1 if key.views.whole else 2):
            del self._keys[1]
        self._reference = len(self._keys) - 1

    def _std(self, key: _KeyFrame) -> float:
        return min(math.sqrt(key.error / (1 if self.level else 3)), UNKNOWN[not self.level])
