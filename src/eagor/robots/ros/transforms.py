"""The tree of frames of ``/tf`` and ``/tf_static`` (REP-105): where one is in another, at a time.

A transform is (R, t): a point p of the child frame is ``R @ p + t`` in the parent frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from eagor.conventions import OPTICAL_R_BODY
from eagor.errors import EagorError
from eagor.media.bags.messages import rotation_of, seconds, triple
from eagor.tracking.poses import PoseHistory

__all__ = ["BACK", "Transform", "TransformTree", "composed", "inverse", "optical"]

KEPT = 10.0  # seconds of moving transforms, as tf2 keeps them
MOST = 100  # links from a frame to the root: more are a circle
BACK = 1.0  # seconds by which stamps have to go back before it is a clock that was set, not a message out of order
OPTICAL = "_optical_frame"  # REP-103: the suffix of frames with x right, y down, z forward

Transform = tuple[np.ndarray, np.ndarray]
IDENTITY: Transform = (np.eye(3), np.zeros(3))


def composed(a: Transform, b: Transform) -> Transform:
    """First `b`, then `a`."""
    return a[0] @ b[0], a[0] @ b[1] + a[1]


def inverse(a: Transform) -> Transform:
    """The way back."""
    return a[0].T, -a[0].T @ a[1]


def optical(frame: str) -> np.ndarray:
    """The rotation ``frame_R_camera`` ``(3, 3)`` of a camera's own axes (x forward) in the frame that names it."""
    return OPTICAL_R_BODY if frame.endswith(OPTICAL) else np.eye(3)


class TransformTree:
    """The frames that have been told of. Not for several threads."""

    def __init__(self) -> None:
        self._fixed: dict[str, tuple[str, Transform]] = {}
        self._moving: dict[str, tuple[str, PoseHistory]] = {}
        self._newest: dict[str, float] = {}

    @property
    def frames(self) -> set[str]:
        """All that are known, parents included."""
        links = {**self._fixed, **self._moving}
        return {*links, *(parent for parent, _ in links.values())}

    def add(self, received: Any, fixed: bool) -> set[str]:
        """Take in a TFMessage; returns the frames that have been moved. What is damaged or out of order is left out.

        Where the stamps of a frame go back by more than `BACK` its older transforms are forgotten, as tf2 does.
        """
        news = set()
        for each in received.transforms:
            parent, child = _named(each.header.frame_id), _named(each.child_frame_id)
            try:
                rotation, place = rotation_of(each.transform.rotation), triple(each.transform.translation)
                if fixed:
                    self._fixed[child] = parent, (rotation, place)
                    self._moving.pop(child, None)
                else:
                    known, stamp = self._moving.get(child), seconds(each.header.stamp)
                    if known is None or known[0] != parent or stamp < self._newest[child] - BACK:
                        known = self._moving[child] = parent, PoseHistory(KEPT)
                        self._fixed.pop(child, None)
                    known[1].add(stamp, rotation, place)
                    self._newest[child] = stamp
            except EagorError:
                continue
            news.add(child)
        return news

    def between(self, parent: str, child: str) -> list[str] | None:
        """The frames whose links lead from `child` to `parent`, in no order; None if these are not connected."""
        up, down = self._ancestors(_named(child)), self._ancestors(_named(parent))
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            return None
        return up[: up.index(common)] + down[: down.index(common)]

    def moving(self, parent: str, child: str) -> list[str]:
        """Those of `between` that move."""
        return [frame for frame in self.between(parent, child) or () if frame in self._moving]

    def root(self, frame: str) -> str:
        """The last of the frame's parents."""
        return self._ancestors(_named(frame))[-1]

    def newest(self, frame: str) -> float:
        """The stamp of the newest transform of a moving frame."""
        return self._newest[frame]

    def fixed(self, parent: str, child: str) -> Transform | None:
        """Where `child` is in `parent`, if only fixed transforms connect them; else None."""
        links = self.between(parent, child)
        if links is None or any(frame in self._moving for frame in links):
            return None
        return self.at(parent, child, 0.0)

    def at(self, parent: str, child: str, stamp: float) -> Transform | None:
        """Where `child` is in `parent` at a time; None if they are not connected, or the time is too long ago.

        Moving transforms are interpolated; the newest one holds beyond its stamp.
        """
        up, down = self._ancestors(_named(child)), self._ancestors(_named(parent))
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            return None
        try:
            below = self._climbed(up[: up.index(common)], stamp)
            above = self._climbed(down[: down.index(common)], stamp)
        except EagorError:
            return None
        return composed(inverse(above), below)

    def _climbed(self, frames: list[str], stamp: float) -> Transform:
        found = IDENTITY
        for frame in frames:
            if frame in self._fixed:
                step = self._fixed[frame][1]
            else:
                rotation, place = self._moving[frame][1].at(stamp)
                assert place is not None
                step = rotation, place
            found = composed(step, found)
        return found

    def _ancestors(self, frame: str) -> list[str]:
        found = [frame]
        while len(found) <= MOST:
            link = self._fixed.get(found[-1]) or self._moving.get(found[-1])
            if link is None:
                break
            found.append(link[0])
        return found


def _named(frame: str) -> str:
    return frame.lstrip("/")  # as tf of ROS 1 began them
