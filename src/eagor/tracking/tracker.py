"""Following targets over time: poses and evidence at different rates, late or out of order; answers at any time.

The belief is in world axes, so turning the camera costs nothing and loses nothing: evidence is rotated once, with the
pose at its CAPTURE, and an answer with the pose at the time of the question. Evidence within the history is kept in
order of capture. Late evidence is inserted there, and the next answer recomputes the belief from that point on.
"""

from __future__ import annotations

import math
import threading
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._values import altered
from eagor.errors import EagorError, FormatError, PoseError, TimeError
from eagor.evidence.evidence import Evidence
from eagor.tracking import checkpoint
from eagor.tracking.config import PARALLAX, TrackerConfig
from eagor.tracking.estimate import Estimate
from eagor.tracking.next_view import Heights, NextLook, TurningCamera, TurningRig
from eagor.tracking.poses import HELD, PoseHistory
from eagor.tracking.tracks import PENDING, SAME_MOMENT, PosedEvidence, State, Track

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

__all__ = ["DirectionTracker"]

TARGETS = 100  # most targets at a time


class DirectionTracker:
    """Follows any number of targets from stamped poses and stamped evidence.

    Call `add_pose` with every pose of the odometry, `observe` with every evidence as it arrives, and `estimate` for an
    answer. Stamps are seconds on one clock. Without any pose the camera stands still. Threads may share a tracker. It
    follows at most `TARGETS` targets; for one more, it forgets the one that was used least recently, with a warning.

        >>> tracker = eagor.DirectionTracker()
        >>> tracker.observe(eagor.Evidence.from_points([[0, 1, 0]], stamp=0.0))
        >>> round(math.degrees(tracker.estimate(0.1).azimuth))
        90
    """

    def __init__(self, config: TrackerConfig | None = None) -> None:
        if config is not None and not isinstance(config, TrackerConfig):
            raise EagorError(f"config is {type(config).__name__}; wanted eagor.TrackerConfig(degree=..., ...)")
        self.config = config or TrackerConfig()
        self._poses = PoseHistory(self.config.history)
        self._tracks: dict[str, Track] = {}
        self._uses = 0
        self._turn = threading.RLock()

    def __getstate__(self) -> dict[str, Any]:
        with self._turn:
            tracks = {name: track.copied() for name, track in self._tracks.items()}
            return {"config": self.config, "_poses": self._poses.copied(), "_tracks": tracks, "_uses": self._uses}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _turn=threading.RLock())

    def __repr__(self) -> str:
        return f"DirectionTracker({len(self._poses)} poses, targets: {', '.join(self.targets) or 'none yet'})"

    @property
    def targets(self) -> tuple[str, ...]:
        """The targets that have evidence."""
        with self._turn:
            return tuple(self._tracks)

    def add_pose(self, stamp: float, world_R_body: np.ndarray | Rotation, position: np.ndarray | None = None) -> None:
        """Add a pose of the body: orientation ``(3, 3)`` or a Rotation of SciPy, and `position` ``(3,)``, if known.

        The position is in metres, in the world frame.

        Raises `TimeError` if `stamp` is earlier than the last pose, `RotationError` if the matrix is not a rotation,
        and `PoseError` if the position is not three finite numbers, is missing after earlier ones were given, or is not
        above the floor. Poses an hour or more ahead of those before and after them have wrong stamps. They are dropped
        with a warning, unless they span the whole history.
        """
        if position is not None:
            self._check_height(np.asarray(position, dtype=np.float64).reshape(-1))
        with self._turn:
            wrong = self._poses.add(stamp, world_R_body, position)
            ahead = [name for name, track in self._tracks.items() if (track.newest or -math.inf) > stamp + HELD]
            for name, track in self._tracks.items():
                if wrong or name in ahead:
                    track.cut(stamp, stamp + HELD)
                self._place_again(track)
        if ahead and not wrong:
            warnings.warn(
                f"evidence about {', '.join(map(repr, ahead))} lies over {HELD:g} s ahead of the pose at "
                f"t = {stamp:.3f} s: it is left out. Are both stamps of one clock?",
                stacklevel=2,
            )
        if wrong:
            warnings.warn(
                f"the poses from t = {wrong[0]:.3f} s on ({len(wrong)}) were followed by one at {stamp:.3f} s, and lie "
                f"over {HELD:g} s ahead of all others: they and evidence of that time are left out. Check the clock "
                "that made their stamps",
                stacklevel=2,
            )

    def expect_parallax(self) -> None:
        """From now on the camera walks, and nobody knows where: near things pass it, as if its odometry drifted.

        By `PARALLAX`; looks that are kept are read anew. Nothing changes where `TrackerConfig.drift` is told.
        """
        with self._turn:
            if self.config.drift is not None:
                return
            self.config = replace(self.config, drift=PARALLAX)
            for track in self._tracks.values():
                track.forget_from(0)
                if track.base is not None:
                    hypotheses = altered(track.base.hypotheses, told_drift=PARALLAX)
                    track.base = altered(track.base, hypotheses=hypotheses)

    def pose_at(self, stamp: float) -> tuple[np.ndarray, np.ndarray | None]:
        """`world_R_body` ``(3, 3)`` and position ``(3,)`` or None at a time, as `estimate` uses them.

        Interpolated between poses; the last pose holds beyond its stamp. Raises `PoseError` before all known poses.
        """
        with self._turn:
            return self._poses.at(stamp)

    def observe(self, evidence: Evidence, target: str = "target") -> None:
        """Add evidence about `target`, placed by its time of capture; it may be late and out of order.

        Evidence of one moment (views of one panorama) is one look. A look newer than the last pose uses that pose until
        a newer one arrives. Raises `TimeError` without a stamp, or if the stamp is older than the history or more than
        an hour (`eagor.tracking.poses.HELD`) ahead of the last pose, `PoseError` if the pose of that time is gone, and
        `EagorError` for what is no evidence.
        """
        if not isinstance(evidence, Evidence):
            what = f"an array of shape {evidence.shape}" if hasattr(evidence, "shape") else type(evidence).__name__
            raise EagorError(
                f"observe() got {what}; wanted eagor.Evidence: what a perception returns, perception(panorama, query, "
                "stamp=t), or Evidence.from_points(directions, stamp=t), from_boxes, from_mask, from_response"
            )
        if evidence.drawn is not None and len(evidence.drawn.shape) > 2:
            raise EagorError(
                f"the evidence is a batch of shape {tuple(evidence.drawn.shape)}; wanted one look (H, W): make it of "
                "response[0], response[1], ..., and observe each with its own stamp"
            )
        if evidence.stamp is None:
            raise TimeError(
                "the evidence has no time stamp; pass stamp=... (time of capture, seconds) where it is made"
            )
        stamp, looked_for = evidence.stamp, evidence.looked_for
        if evidence.detections is not None and self.config.detector is not None:
            evidence = evidence.with_detector(self.config.detector)
        elif self.config.calibration is not None:
            evidence = evidence.with_calibration(self.config.calibration)
        evidence = replace(evidence, source=None)  # it may be large, and nothing here reads it
        with self._turn:
            self._poses.check_ahead(stamp)
            track = self._tracks.get(target) or Track()
            track.looked_for = looked_for
            place, moment = track.place_of(stamp)
            if moment is None:
                pose, position = self._poses.at(stamp)
                turning = self._poses.turning_rate(stamp)
                moment = PosedEvidence(stamp, [evidence], pose, position, self._poses.reach(stamp), turning)
                track.moments.insert(place, moment)
            else:
                moment.looks.append(evidence)
            track.forget_from(place)
            self._tracks[target] = track
            self._use(track)
            if len(track.moments) - track.taken_in > PENDING:
                track.state(self.config)
            dropped = None
            if len(self._tracks) > TARGETS:
                dropped = min(self._tracks, key=lambda name: self._tracks[name].used)
                del self._tracks[dropped]
        if dropped is not None:
            warnings.warn(
                f"{TARGETS} targets are followed, as many as there may be; for {target!r}, {dropped!r} is forgotten, "
                "which was spoken of least recently. Call tracker.forget(name) for those that are done with",
                stacklevel=2,
            )

    def estimate(self, now: float, target: str = "target") -> Estimate:
        """The answer at time `now`, in the body frame of that time (the last pose holds beyond its stamp).

        Raises `TimeError` if `now` is before the newest evidence, `PoseError` if it is before all known poses, and
        `EagorError` for an unknown target, if there are others.
        """
        with self._turn:
            pose, position = self._poses.at(now)
            track = None
            if target in self._tracks or (target != "target" and self._tracks):
                track = self._track(target)
                self._use(track)
            if track is None or track.newest is None:
                blank = State.blank(self.config, now, position)
                return Estimate(now, math.inf, blank.hypotheses, pose, self.config)
            if track.newest - SAME_MOMENT <= now < track.newest:
                now = track.newest  # rounding: 0.3 is not 3 * 0.1
            if now < track.newest:
                raise TimeError(
                    f"asked for t = {now:.6f} s, but evidence up to {track.newest:.6f} s is already in; ask for that "
                    f"time or later. If the stamp of that evidence is wrong, call tracker.reset({target!r})"
                )
            state = track.state(self.config)
            assert state is not None
            state = state.at(now, position, self.config)
            return Estimate(now, now - state.stamp, state.hypotheses, pose, self.config, state.alarms, track.looked_for)

    def next_look(
        self,
        camera: TurningCamera | TurningRig | float,
        now: float,
        target: str = "target",
        usual: Heights | None = None,
    ) -> NextLook:
        """Where a camera that sees only a part of the sphere, and looks ahead now, should look next, or several.

        As `Estimate.next_look` of the `estimate` at time `now`; errors of both.
        """
        return self.estimate(now, target).next_look(camera, usual)

    def save(self, path: str | Path) -> Path:
        """Write the whole state to a file, atomically, and return its path; `load` continues from it.

        Raises `StorageError` if the file cannot be written.
        """
        return checkpoint.save(Path(path), self.__getstate__())

    @classmethod
    def load(cls, path: str | Path) -> DirectionTracker:
        """The tracker that `save` wrote. No code of the file is run.

        Raises `FormatError` if the file is something else, damaged, or of another version.
        """
        state = checkpoint.load(Path(path))
        tracker = cls()
        blank = tracker.__getstate__()
        alike = isinstance(state, dict) and {key: type(each) for key, each in state.items()} == {
            key: type(each) for key, each in blank.items()
        }
        if not alike or not all(isinstance(track, Track) for track in state["_tracks"].values()):
            raise FormatError(f"{path} holds no tracker; wanted a file of tracker.save")
        tracker.__setstate__(state)
        return tracker

    def reset(self, target: str | None = None) -> None:
        """Forget all evidence about `target`; without a name, all targets and all poses (for a new clock).

        Raises `EagorError` for a target without evidence.
        """
        with self._turn:
            if target is not None:
                used = self._track(target).used
                self._tracks[target] = Track(used=used)
                return
            self._poses = PoseHistory(self.config.history)
            self._tracks.clear()

    def forget(self, target: str) -> None:
        """Stop following `target`. Raises `EagorError` for a target without evidence."""
        with self._turn:
            self._track(target)
            del self._tracks[target]

    def _track(self, target: str) -> Track:
        if target not in self._tracks:
            known = ", ".join(map(repr, self._tracks)) or "nothing yet"
            raise EagorError(f"there is no evidence about {target!r}; there is about {known}")
        return self._tracks[target]

    def _use(self, track: Track) -> None:
        self._uses += 1
        track.used = self._uses

    def _place_again(self, track: Track) -> None:
        """Place looks again that were newer than their pose, now that there is a newer pose: the last ones, if any."""
        for index in reversed(range(len(track.moments))):
            moment = track.moments[index]
            if moment.firm:
                break
            pose, position = self._poses.at(max(moment.stamp, self._poses.first))
            moment.world_R_body, moment.position = pose, position
            moment.firm, moment.turning = self._poses.reach(moment.stamp), self._poses.turning_rate(moment.stamp)
            track.forget_from(index)

    def _check_height(self, position: np.ndarray) -> None:
        floor = self.config.floor_height
        if floor is not None and len(position) == 3 and not position[2] - floor >= 0.01:
            raise PoseError(
                f"the camera is at z = {position[2]:.3f} m, and TrackerConfig.floor_height = {floor:g} m is not below "
                "it; give the floor's z in the odometry's world, or None if it is not known"
            )
