"""How a camera turns, from its pictures alone: panoramas, or those of an ordinary camera."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from eagor._values import lazy
from eagor.errors import ImageError
from eagor.grids import PerspectiveGrid
from eagor.media.consensus import Inertia
from eagor.media.features import SIZE, Features, Views, corners_of, followed, lens_of, match, overlap, steadied, warped
from eagor.media.two_views import Turn, angle_between, turn_between

__all__ = ["Turned", "VisualOdometer"]

MOST_KEYS = 48  # key frames in memory, about 1 MB each
MOST_KEYS_ALONE = 96  # of an ordinary camera, to which each shows a part of the sphere
THIN = 0.15  # share of a frame's points found again in a key frame; below it the frame becomes a key frame itself
THIN_ALONE = 0.3  # of an ordinary camera: the views of neighbouring key frames have to overlap
OVERLAP = 0.2  # share of an ordinary picture that a key frame has to show to be compared with it
TRIED = 8  # key frames of an ordinary camera that a picture is compared with if none of those expected fits
BESIDE = 0.25  # seconds within which another lens of the rig tells how this one has turned
SLACK = 0.3  # of a turn that is taken from another lens' pictures: the camera may not have turned on steadily
PUSHED = 10.0  # radians per second squared: few cameras change their rate of turning faster
FASTEST = 10.0  # radians per second: few cameras turn faster
STEADY = math.radians(2)  # of a turn that is expected, whatever the time
WAIT = 2.0  # seconds for which an ordinary picture that fits to none before it is waited out
FOLLOWED = 0.4  # share of a frame's corners found again by optical flow; with fewer, features are matched anew
NEAR = math.radians(2)  # of the guess: flow from farther away is repeated, since views change with the turn
ROUNDS = 3  # of that, at most
SMALLEST = 128  # pixels of a view, however small the pictures are
FEWEST = 8  # points: so few that match cannot be told from chance, or hardly
_CONSISTENT = 16.3  # chi-square with three degrees of freedom, exceeded once in 1000
_UNKNOWN = math.sqrt(math.pi**2 / 9 + 2 / 3)  # radians per axis: a rotation of which nothing is known (uniform, SO(3))
_UNKNOWN_YAW = math.pi / math.sqrt(3)  # radians: a heading of which nothing is known


@dataclass(frozen=True, eq=False)
class Turned:
    """Where the camera points.

    `world_R_body` ``(3, 3)``; the first picture's body frame is the world, or that of the last picture with `lost`.
    `spread`: standard deviation of the error, radians per axis (of the heading, if level). `lost`: True if this picture
    could not be related to those before it, so that the world starts anew. `matches`: points that agree; 0 for a
    picture in which there is nothing to see: then the rotation is the last known one, and the spread grows.
    """

    world_R_body: np.ndarray
    spread: float
    lost: bool
    matches: int


@dataclass(frozen=True, eq=False)
class _Key:
    """A frame to compare with: its views, its pose, the covariance ``(3, 3)`` of the pose (world axes).

    `doubt`: deviation of the pose's angle because models may be wrong (`Turn.doubt`), radians. Those of the turns that
    lead here are added, not their squares: a camera that walks is misled in the same way at each step.
    """

    views: Views
    world_R_body: np.ndarray
    covariance: np.ndarray
    doubt: float = 0.0

    @lazy
    def error(self) -> float:
        """The expected square of the pose's angle of error, radians squared."""
        return float(np.trace(self.covariance)) + self.doubt**2

    @lazy
    def corners(self) -> tuple[np.ndarray, ...]:
        """The corners of its views."""
        return corners_of(self.views)


class VisualOdometer:
    """The rotation of a camera, picture by picture. `level`: the pictures stay level, and only the heading turns.

    Corners are followed by optical flow from one frame, the anchor, to each picture, as long as many are found again.
    Where they are not, the picture's features are matched with key frames: the one that fitted last, the first one, and
    one of the others in turn, so that a camera that comes back loses its drift. The answer with the least uncertainty
    counts, and the picture is the next anchor. A new key frame is made where few points are found again. The state
    grows to at most `MOST_KEYS` key frames. Not for several threads.

    An ordinary camera soon loses sight of the first key frame. So its pictures are compared with the key frames that
    overlap most with where it should look now. One that fits to none is waited out for `WAIT` seconds, since it may be
    blurred, covered, or of a side not seen before: the last rotation holds, and the spread grows.

    Several ordinary cameras that are fixed to each other may give their pictures in turn, each with the grid of its
    lens: what one does not recognise, the others tell, and each sees key frames of all.
    """

    def __init__(self, *, level: bool = False) -> None:
        self.level = level
        self._keys: list[_Key] = []
        self._reference = 0  # the key frame that fitted last
        self._turn = 0  # the key frame whose turn it is
        self._anchors: dict[bytes, _Key] = {}  # the frame of each lens from which corners are followed
        self._latest: dict[bytes, tuple[np.ndarray, float]] = {}  # where each lens was found last: pose and stamp
        self._previous: _Key | None = None  # the last picture that was found
        self._step = np.zeros(3)  # the turn (rotation vector) from the picture before that one to it, and the seconds
        self._lasted = 1.0
        self._moving = False  # whether that is known
        self._stamp = 0.0  # of that one
        self._held = 0  # pictures without information since then
        self._squares, self._steps = 0.0, 0  # of the turns from picture to picture (radians), and how many
        self._shares = (1.0, 4.0)  # points found again and points there, in frames found (a guess to begin with)

    def add(self, picture: np.ndarray, stamp: float | None = None, grid: PerspectiveGrid | None = None) -> Turned:
        """The rotation of the body at the next picture ``(H, W, 3)`` uint8: a panorama, or an ordinary one with `grid`.

        `stamp`: seconds, rising; it helps where pictures are left out. Without stamps they count as evenly spaced, a
        second each. Sizes of panoramas may change from picture to picture; of ordinary ones `grid` has to fit each. The
        camera stays what it is. Raises `ImageError` for another array or size and for another kind of camera, and
        `MissingExtraError` without OpenCV.
        """
        stamp = self._stamp + self._held + 1 if stamp is None else stamp
        self._check_kind(grid)
        anchor = self._anchors.get(lens_of(grid))
        if grid is None:
            views, flown = self._steadied(anchor, picture, stamp)
        else:
            views = Views.of_picture(picture, grid)
            flown = self._flown(anchor, views, stamp)
        if flown is not None:
            return self._now(*flown, stamp)
        features = views.features
        if not self._keys:
            blind = self._previous is not None and len(features) < FEWEST
            return self._hold() if blind else self._begin(views, stamp)
        found = self._found(views, stamp)
        if found is None and self._beside(views.lens, stamp):
            return self._carried(views, stamp)
        if found is None:
            expected = len(features) * self._shares[0] / self._shares[1]
            waits = grid is not None and stamp - self._stamp <= WAIT
            return self._hold() if waits or expected < FEWEST else self._begin(views, stamp)
        now, turn, share = found
        again, there = self._shares
        self._shares = again + share, there + 1
        if share < (THIN if grid is None else THIN_ALONE):
            self._add_key(now)
        self._anchors[views.lens] = now
        return self._now(now, turn, stamp)

    def _now(self, now: _Key, turn: Turn, stamp: float) -> Turned:
        """What is said of a picture that was found."""
        self._learn(now, stamp)
        self._previous, self._held = now, 0
        return Turned(now.world_R_body, self._spread(now), False, int(turn.inliers.sum()))

    def _check_kind(self, grid: PerspectiveGrid | None) -> None:
        """Raise `ImageError` for a panorama among ordinary pictures, or the other way round."""
        if self._previous is not None and (self._previous.views.whole != (grid is None)):
            came, before = ("a panorama", "ordinary pictures") if grid is None else ("an ordinary picture", "panoramas")
            raise ImageError(f"{came} (grid = {grid!r}) after {before}; wanted one camera: take another VisualOdometer")

    def _steadied(
        self, anchor: _Key | None, panorama: np.ndarray, stamp: float
    ) -> tuple[Views, tuple[_Key, Turn] | None]:
        """A panorama's views, and where it points if enough of the anchor's corners are found again."""
        if anchor is None:
            return Views.of(panorama, min(max(np.shape(panorama)[0], SMALLEST), SIZE)), None
        return self._followed(anchor, lambda guess: steadied(panorama, anchor.views, guess), stamp)

    def _flown(self, anchor: _Key | None, views: Views, stamp: float) -> tuple[_Key, Turn] | None:
        """Where an ordinary picture points, if enough of the anchor's corners are found again."""
        if anchor is None or anchor.views.lens != views.lens:
            return None
        _, found = self._followed(anchor, lambda guess: warped(views, anchor.views, guess), stamp)
        return None if found is None else (replace(found[0], views=views), found[1])

    def _followed(
        self, anchor: _Key, seen: Callable[[np.ndarray], Views], stamp: float
    ) -> tuple[Views, tuple[_Key, Turn] | None]:
        """The same, and the views in which corners were looked for: `seen` makes them from a guess of the turn."""
        guess = anchor.world_R_body.T @ self._expected(stamp)
        inertia = self._inertia(anchor, stamp)
        enough = max(FEWEST, FOLLOWED * sum(map(len, anchor.corners)))
        left = ROUNDS
        while True:
            left -= 1
            views = seen(guess)
            old, new = followed(anchor.views, anchor.corners, views)
            if len(old) < enough:
                return views, None
            turn = turn_between(old, new, level=self.level, area=anchor.views.area, inertia=inertia)
            if turn is None or turn.inliers.sum() < enough:
                return views, None
            if angle_between(guess, turn.old_R_new) < NEAR or not left:
                return views, (_placed(anchor, views, turn), turn)
            guess = turn.old_R_new

    def _expected(self, stamp: float) -> np.ndarray:
        """Where a camera that has been found before should point now, if it turns on."""
        assert self._previous is not None
        step = Rotation.from_rotvec(self._step * (stamp - self._stamp) / self._lasted)
        pose = self._previous.world_R_body @ step.as_matrix()
        return Rotation.from_matrix(pose).as_matrix()  # orthogonal: else rounding grows from picture to picture

    def _begin(self, views: Views, stamp: float) -> Turned:
        """The world starts with this picture, unless there is nothing in it."""
        anew = self._previous is not None
        start = _Key(views, np.eye(3), np.zeros((3, 3)))
        self._previous, self._held = start, 0
        self._step, self._stamp = np.zeros(3), stamp
        self._keys = [start] if len(views.features) >= FEWEST else []
        self._anchors = {views.lens: start} if self._keys else {}
        self._latest = {views.lens: (start.world_R_body, stamp)}
        self._reference = self._turn = 0
        self._moving = False
        return Turned(start.world_R_body, 0.0, anew, 0)

    def _beside(self, lens: bytes, stamp: float) -> bool:
        """Whether another lens of the rig has been found just now."""
        return any(other != lens and stamp - at <= BESIDE for other, (_, at) in self._latest.items())

    def _carried(self, views: Views, stamp: float) -> Turned:
        """Where a picture points by what the other lenses saw; of a side not seen before it becomes a key frame."""
        assert self._previous is not None
        pose = self._expected(stamp)
        slack = SLACK * angle_between(self._previous.world_R_body, pose)
        now = _Key(views, pose, self._previous.covariance + slack**2 * np.eye(3), self._previous.doubt)
        if len(views.features) >= FEWEST and not self._overlapping(views, stamp):
            self._add_key(now)
            self._anchors[views.lens] = now
        return Turned(pose, self._spread(now), False, 0)

    def _hold(self) -> Turned:
        """The last known rotation; the camera may go on turning as fast as it did."""
        assert self._previous is not None
        self._held += 1
        most = _UNKNOWN_YAW if self.level else _UNKNOWN
        axes = 1 if self.level else 3
        rate = math.sqrt(self._squares / self._steps / axes) if self._steps else most
        spread = math.hypot(self._spread(self._previous), rate * self._held)
        return Turned(self._previous.world_R_body, min(spread, most), False, 0)

    def _found(self, views: Views, stamp: float) -> tuple[_Key, Turn, float] | None:
        """This picture as a key frame, the turn that tells most about it, and the largest share of points found."""
        near = self._overlapping(views, stamp)
        indices: dict[int, None] = {}
        if near:
            self._turn = (self._turn + 1) % len(near)
            surest = min(near, key=lambda index: self._keys[index].error)
            indices = dict.fromkeys((self._reference, near[0], surest, near[self._turn]))
        results = {index: self._compared(self._keys[index], views, stamp) for index in indices}
        agreed = {index: result for index, result in results.items() if result is not None}
        best, most = None, 0.0
        if agreed:
            clearest = max(agreed.values(), key=lambda result: result[1].inliers.sum())
            most = _share(clearest[1], views.features)
            alike = [index for index, result in agreed.items() if _alike(clearest[0], result[0])]
            self._reference = min(alike, key=lambda index: agreed[index][0].error)
            best = agreed[self._reference]
        if best is None and self._previous is not None:
            best = self._compared(self._previous, views, stamp)
            if best is not None:  # no key frame shows enough; the previous picture does
                self._add_key(self._previous)
                most = _share(best[1], views.features)
        if best is None and not views.whole:  # both may be blurred, along the same way
            best = self._flown(self._previous, views, stamp)
            most = 1.0 if best is not None and self._overlapping(views, stamp, best[0].world_R_body) else 0.0
        if best is None:
            for index in self._others(views, stamp):
                best = self._compared(self._keys[index], views, stamp)
                if best is not None:
                    self._reference, most = index, _share(best[1], views.features)
                    break
        return None if best is None else (*best, most)

    def _overlapping(self, views: Views, stamp: float, pose: np.ndarray | None = None) -> list[int]:
        """The key frames that should show a part of this picture; of an ordinary camera those that show most first.

        `pose`: where it points, if known.
        """
        if views.whole or self._previous is None:
            return list(range(len(self._keys)))
        pose = self._expected(stamp) if pose is None else pose
        shares = [overlap(views, key.views, key.world_R_body.T @ pose) for key in self._keys]
        order = sorted(range(len(shares)), key=lambda index: -shares[index])
        return [index for index in order if shares[index] >= OVERLAP]

    def _others(self, views: Views, stamp: float) -> list[int]:
        """Key frames to try where none of the likely ones fits: all, or of an ordinary camera a few, in turn."""
        every = list(range(len(self._keys)))
        if views.whole:
            return every
        axis = self._expected(stamp) @ views.grids[0].body_R_view[:, 0]
        axes = [key.world_R_body @ key.views.grids[0].body_R_view[:, 0] for key in self._keys]
        every.sort(key=lambda index: -float(axes[index] @ axis))
        start = self._held * TRIED % len(every)
        return (every + every)[start : start + min(TRIED, len(every))]

    def _inertia(self, key: _Key, stamp: float) -> Inertia | None:
        """What an ordinary camera's turn from a key frame can be: the less time since the last picture, the less.

        Above all, lenses of one moment share its pose, whatever looks alike before and behind: corners of a room do.
        """
        if key.views.whole or self._previous is None:
            return None
        since = stamp - self._stamp
        most = STEADY + (PUSHED * since**2 / 2 if self._moving else FASTEST * since)
        return Inertia(key.world_R_body.T @ self._expected(stamp), most)

    def _compared(self, key: _Key, views: Views, stamp: float) -> tuple[_Key, Turn] | None:
        """This picture's pose by way of one key frame."""
        here, there = key.views.features, views.features
        old, new = match(here, there)
        old, new, inertia = here.directions[old], there.directions[new], self._inertia(key, stamp)
        turn = turn_between(old, new, level=self.level, area=views.area, inertia=inertia)
        return None if turn is None else (_placed(key, views, turn), turn)

    def _add_key(self, key: _Key) -> None:
        """Keep a key frame; beyond the limit the oldest but one goes."""
        self._keys.append(key)
        if len(self._keys) > (MOST_KEYS if key.views.whole else MOST_KEYS_ALONE):
            del self._keys[1]
        self._reference = len(self._keys) - 1

    def _learn(self, now: _Key, stamp: float) -> None:
        """How fast the camera turns."""
        before, at = self._latest.get(now.views.lens, (None, stamp))
        self._latest[now.views.lens], self._stamp = (now.world_R_body, stamp), stamp
        if before is None:
            return
        self._step = Rotation.from_matrix(before.T @ now.world_R_body).as_rotvec()
        self._lasted, self._moving = max(stamp - at, 1e-6), True
        if not self._held:
            self._squares += float(self._step @ self._step)
            self._steps += 1

    def _spread(self, key: _Key) -> float:
        most, axes = (_UNKNOWN_YAW, 1) if self.level else (_UNKNOWN, 3)
        return min(math.sqrt(key.error / axes), most)


def _placed(key: _Key, views: Views, turn: Turn) -> _Key:
    """A picture that has turned since a key frame."""
    covariance = key.covariance + key.world_R_body @ turn.covariance @ key.world_R_body.T
    return _Key(views, key.world_R_body @ turn.old_R_new, covariance, key.doubt + turn.doubt)


def _share(turn: Turn, features: Features) -> float:
    """The share of the picture's points that were found again."""
    return float(turn.inliers.sum()) / max(len(features), 1)


def _alike(a: _Key, b: _Key) -> bool:
    """Whether two poses differ by no more than their uncertainties explain."""
    gap = Rotation.from_matrix(a.world_R_body @ b.world_R_body.T).as_rotvec()
    doubt = (a.doubt**2 + b.doubt**2) / 3 * np.eye(3)
    return float(gap @ np.linalg.pinv(a.covariance + b.covariance + doubt) @ gap) < _CONSISTENT
