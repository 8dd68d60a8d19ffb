"""Sessions of a photograph, in which the person turns the camera, and of a video, which is played."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from eagor.sphere import angular_distance, world_R_body
from eagor.studio.following import SOONEST, FollowingSession
from eagor.studio.messages import rounded
from eagor.studio.session import LOOKS, Loaded, Opened, Opening, Outbox, Refused, See, Seen, Turn, Turned

__all__ = ["PictureSession", "VideoSession"]

BETWEEN = 0.5  # seconds from one look to the next: time goes on with looks alone
TICK = 1e-3  # of such a second, from one step to the next
TURNED = math.radians(5)  # of the camera, which are worth another look
SOON = 0.02  # seconds
OTHER_FILE, OTHER_QUERY = "Drop another file.", "Ask for something else, or choose another perception."


class PictureSession(FollowingSession):
    """One person's view of one photograph.

    A photograph does not change, so its time passes with looks: each is half a second after the one before.
    """

    _looked_from: np.ndarray | None
    _poses: dict[float, np.ndarray]

    def __init__(self, number: int, opening: Opening, out: Outbox) -> None:
        super().__init__(number, opening, out)
        assert opening.picture is not None
        self._file: Path = opening.picture
        self._angles = (0.0, 0.0, 0.0)
        self._opened: Opened | None = None
        self._seeing, self._looked_from = False, None
        self._same = False  # what is looked at was looked at before
        self._stamp, self._poses = 0.0, {}
        out.eye(("picture", number, opening.picture, opening.hfov))
        out.status(number, f"Reading {opening.name or 'the picture'}.")

    def saw(self, said: Any, now: float) -> None:
        """What the eye says."""
        self.due = now
        if isinstance(said, Loaded):
            self._loaded(said)
        elif isinstance(said, Opened):
            self._opened = said
        elif isinstance(said, Seen):
            self._seeing = False
            pose = self._poses.get(said.stamp)
            if pose is not None and self._answers(said.question):
                self._take(said.looks, said.stamp, pose, None, said.around, self._same)
        elif isinstance(said, Refused):
            self._seeing = False
            self._refuse(said, OTHER_FILE if said.part == "picture" else OTHER_QUERY)
        if not self._running and self._opened is not None and self._wanted is not None:
            self._running = True
            self._follow()

    def told(self, message: dict[str, Any], now: float) -> None:
        """What the page says; its fields have been checked."""
        kind = message["type"]
        if kind == "pause":
            self._paused = message["on"]
        elif kind == "camera":
            self._angles = (message["yaw"], message["pitch"], message["roll"])
        elif not self._told(message) and kind == "restart" and self._running:
            self._angles, self._looked_from, self._paused = (0.0, 0.0, 0.0), None, False
            self._follow()
        self.due = min(self.due, now + SOON)  # drags come in bursts

    def tick(self, now: float, soonest: float = SOONEST) -> float:
        """Turn, look if that is worth it, answer."""
        self.due = math.inf
        if not self._running or (self._paused and self._next is None and not self._due_once):
            return 0.0
        self._stamp += TICK
        yaw, pitch, roll = self._angles
        pose = world_R_body(yaw, -pitch, roll)
        self._pose(self._stamp, pose, None)
        self._see(pose)
        estimate = self._following.answer(self._stamp, 0.0)
        if self._work(now, soonest, self._stamp):
            self.due = now + 2 * soonest
        attitude = {"yaw": rounded(yaw), "pitch": rounded(pitch), "roll": rounded(roll)}
        self._step(estimate, self._stamp, attitude=attitude)
        return self._following.took

    def _follow(self) -> None:
        """Follow what is asked, with nothing known."""
        assert self._opened is not None
        self._forget()
        self._picture(self._stamp, np.eye(3), self._opened.jpeg)
        about = {} if self._opened.lens is None else {"lens": self._opened.lens}
        self._scene("picture", self.opening.name or "Picture", facts=list(self._opened.facts), **about)

    def _see(self, pose: np.ndarray) -> None:
        """Ask for a look, if the question is new or the camera looks another way than before."""
        if self._seeing or (wanted := self._wanted) is None:
            return
        before = self._looked_from
        turned = before is None or max(float(angular_distance(before[:, k], pose[:, k])) for k in range(3)) >= TURNED
        if not turned and wanted != self._next:
            return
        self._stamp += BETWEEN
        self._pose(self._stamp, pose, None)
        self._looked_from, self._seeing, self._same = pose, True, not turned
        self._poses = {self._stamp: pose}
        self._out.eye(See(self.number, self._stamp, pose, None, wanted, 0, picture=self._file, hfov=self.opening.hfov))


class VideoSession(FollowingSession):
    """One person's view of one video. Its time is that of the video.

    It is played as fast as it can be looked at, at its own speed at most; one can pause and seek.
    """

    def __init__(self, number: int, opening: Opening, out: Outbox) -> None:
        super().__init__(number, opening, out)
        assert opening.picture is not None
        self._file: Path = opening.picture
        self._over = self._asking = self._again = False  # the last: look at the frame that is shown once more
        self._start: float | None = 0.0  # where to seek with the next frame
        self._lens: dict[str, Any] | None = None  # of an ordinary camera: the first frame tells
        self._anchor: tuple[float, float] | None = None  # time of the video, and ours
        self._frame: tuple[float, np.ndarray, dict[str, Any]] | None = None  # that is shown: its time, pose, and number
        self._same = False  # it was looked at before
        out.status(number, f"Reading {opening.name or 'the video'}.")

    def saw(self, said: Any, now: float) -> None:
        """What the eye says."""
        if isinstance(said, Loaded):
            self._loaded(said)
            if not self._running and self._wanted is not None:
                self._running = True
                self._follow()
            self.due = now
        elif isinstance(said, Turned):
            self._asking = False
            if said.over:
                self._over = True
                self._out.status(self.number, "The video has ended. Seek, or restart it.")
            elif self._start is None:  # else it is from before a seek
                self._show(said, now)
            else:
                self.due = now
        elif isinstance(said, Refused):
            fatal = said.part == "picture"
            self._asking = self._asking and not fatal
            self._refuse(said, OTHER_FILE if fatal else OTHER_QUERY)

    def told(self, message: dict[str, Any], now: float) -> None:
        """What the page says; its fields have been checked."""
        kind = message["type"]
        if kind == "pause":
            self._paused = message["on"]
            self._anchor = None  # time has stood still
        elif kind == "seek":
            self._seek(message["frame"] / LOOKS)
        elif kind == "restart":
            self._seek(0.0)
        elif self._told(message) and self._next is not None and (self._paused or self._over):
            self._again = True
        self.due = min(self.due, now)

    def tick(self, now: float, soonest: float = SOONEST) -> float:
        """Ask for the next frame; one frame is shown after a seek even while the video is paused."""
        more = self._work(now, soonest, 0.0)
        self.due = now + 2 * soonest if more else math.inf
        news = self._due_once or (not more and "things" in self._parts)
        if news and self._frame is not None and (self._paused or self._over):
            self._say(*self._frame)
        wanted = self._start is not None or self._again or not (self._paused or self._over)
        if not self._running or self._asking or not wanted:
            return 0.0
        self._out.eye(Turn(self.number, self._file, self._wanted, self._start, self._again, self.opening.hfov))
        self._start, self._same, self._again, self._asking = None, self._again, False, True
        return 0.0

    def _seek(self, seconds: float) -> None:
        """Go to a time; the belief begins anew there."""
        last = max(0.0, (self.opening.frames - 1) / LOOKS)
        self._start, self._over = min(seconds, last), False
        self._begin()

    def _begin(self) -> None:
        self._forget()
        self._anchor = None

    def _follow(self) -> None:
        """Begin, and say what is shown."""
        self._begin()
        about = {} if self._lens is None else {"lens": self._lens}
        self._scene("picture", self.opening.name or "Video", frames=self.opening.frames, **about)

    def _say(self, stamp: float, pose: np.ndarray, frame: dict[str, Any]) -> None:
        """Say what is believed at a frame."""
        self._pose(stamp, pose, None)
        self._step(self._following.answer(stamp, 0.0), stamp, frame=frame)

    def _show(self, said: Turned, now: float) -> None:
        """One frame: take in its looks, and say what is believed."""
        if said.lens != self._lens:
            self._lens = said.lens
            self._follow()
        if said.lost:
            self._begin()
            self._out.status(self.number, "A picture does not fit to those before it: the belief starts anew.")
        stamp, pose = said.stamp, said.world_R_body
        looks = said.looks if said.question is not None and self._answers(said.question) else ()
        self._pose(stamp, pose, None)
        self._picture(stamp, pose, said.jpeg)
        if looks:
            looks = [replace(evidence, stamp=stamp) for evidence in looks]
            self._take(looks, stamp, pose, None, said.around, self._same)
        frame = {"n": round(stamp * LOOKS), "of": self.opening.frames, "stamp": rounded(stamp, 3)}
        self._frame = stamp, pose, frame
        self._say(*self._frame)
        if self._anchor is None:
            self._anchor = stamp, now
        # At the video's speed at most: the next frame is due when its time has come.
        self.due = max(now, self._anchor[1] + (stamp + 1 / LOOKS - self._anchor[0]))
