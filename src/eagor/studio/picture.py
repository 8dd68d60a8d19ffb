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
from eagor.studio.session import LOOKS, Opened, Opening, Outbox, Refused, See, Seen, Turn, Turned

__all__ = ["PictureSession", "VideoSession"]

BETWEEN = 0.5  # seconds from one look to the next: time goes on with looks alone
TICK = 1e-3  # of such a second, from one step to the next
TURNED = math.radians(5)  # of the camera, which are worth another look
SOON = 0.02  # seconds
OTHER_FILE, OTHER_QUERY = "Drop another file.", "Ask for something else, or choose another perception."


class PictureSession(FollowingSession):
    """One person's view of one photograph; see `eagor.studio.session.Session`.

    A photograph does not change, so its time passes with looks: each is half a second after the one before.
    """

    def __init__(self, number: int, opening: Opening, out: Outbox) -> None:
        super().__init__(number, opening, out)
        assert opening.picture is not None
        self._file: Path = opening.picture
        self._angles = (0.0, 0.0, 0.0)
        self._opened: Opened | None = None
        self._seeing = False
        out.eye(("picture", number, opening.picture, opening.perception))
        out.status(number, f"Reading {opening.name or 'the picture'}.")

    def saw(self, said: Any, now: float) -> None:
        """What the eye says."""
        if isinstance(said, Opened):
            self._opened = said
            self._follow(now)
        elif isinstance(said, Seen):
            self._seeing = False
            if said.query == self._query and said.stamp in self._poses:
                self._take(said.looks, said.stamp, self._poses.pop(said.stamp))
            self.due = now
        elif isinstance(said, Refused):
            self._seeing = False
            if not self._concerns(said):
                self.due = now
                return
            fatal = said.part == "picture"
            self._out.problem(self.number, said.problem, OTHER_FILE if fatal else OTHER_QUERY, fatal)

    def told(self, message: dict[str, Any], now: float) -> None:
        """What the page says; its fields have been checked."""
        kind = message["type"]
        if kind == "pause":
            self._paused = message["on"]
        elif kind == "camera":
            self._angles = (message["yaw"], message["pitch"], message["roll"])
        elif self._opened is None:
            return
        elif self._changes(message):
            self._follow(now)
        elif kind == "methods":
            self._compare(message)
        elif kind == "restart":
            self._angles = (0.0, 0.0, 0.0)
            self._follow(now)
        if self._opened is not None:
            self.due = min(self.due, now + SOON)  # drags come in bursts

    def tick(self, now: float, soonest: float = SOONEST) -> float:
        """Turn, look if that is worth it, answer."""
        self.due = math.inf
        if self._opened is None or self._paused:
            return 0.0
        self._stamp += TICK
        yaw, pitch, roll = self._angles
        pose = world_R_body(yaw, -pitch, roll)
        self._following.pose(self._stamp, pose, None)
        self._see(pose)
        estimate = self._following.answer(self._stamp, 0.0)
        attitude = {"yaw": rounded(yaw), "pitch": rounded(pitch), "roll": rounded(roll)}
        self._step(estimate, self._stamp, attitude=attitude)
        return self._following.took

    def _follow(self, now: float) -> None:
        """Follow the query, with nothing known."""
        assert self._opened is not None
        self._forget()
        self._stamp, self._poses, self._looked_from, self._refused = 0.0, {}, None, None
        self._picture(0.0, np.eye(3), self._opened.jpeg)
        title, facts = self.opening.name or "Picture", list(self._opened.facts)
        self._scene("picture", title, self._opened.calibrated, facts=facts)
        self.due = now

    def _see(self, pose: np.ndarray) -> None:
        """Ask for a look, if the camera looks another way than before."""
        if self._seeing or self._refused == self._query:
            return
        before = self._looked_from
        if before is not None and max(float(angular_distance(before[:, k], pose[:, k])) for k in range(3)) < TURNED:
            return
        self._stamp += BETWEEN
        self._following.pose(self._stamp, pose, None)
        self._looked_from, self._seeing = pose, True
        self._poses = {self._stamp: pose}
        job = See(self.number, self._stamp, pose, None, self.opening.perception, self._query, 0, picture=self._file)
        self._out.eye(job)


class VideoSession(FollowingSession):
    """One person's view of one video; see `eagor.studio.session.Session`. Its time is that of the video.

    It is played as fast as it can be looked at, at its own speed at most; one can pause and seek.
    """

    def __init__(self, number: int, opening: Opening, out: Outbox) -> None:
        super().__init__(number, opening, out)
        assert opening.picture is not None
        self._file: Path = opening.picture
        self._opened: Opened | None = None
        self._over = self._asking = False
        self._start: float | None = 0.0  # where to seek with the next frame
        self._anchor: tuple[float, float] | None = None  # time of the video, and ours
        out.eye(("video", number, opening.perception))
        out.status(number, f"Reading {opening.name or 'the video'}.")

    def saw(self, said: Any, now: float) -> None:
        """What the eye says."""
        if isinstance(said, Opened):
            self._opened = said
            self._show_all()
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
            if self._concerns(said):
                self._out.problem(self.number, said.problem, OTHER_FILE if fatal else OTHER_QUERY, fatal)

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
        elif kind == "methods":
            self._compare(message)
        elif self._opened is None:
            return
        elif self._changes(message):
            self._show_all()
        self.due = min(self.due, now) if self._opened is not None else self.due

    def tick(self, now: float, soonest: float = SOONEST) -> float:
        """Ask for the next frame; one frame is shown after a seek even while the video is paused."""
        self.due = math.inf
        wanted = self._start is not None or not (self._paused or self._over)
        if self._opened is None or self._asking or not wanted:
            return 0.0
        query = None if self._refused == self._query else self._query
        self._out.eye(Turn(self.number, self._file, self.opening.perception, query, self._start))
        self._start, self._asking = None, True
        return 0.0

    def _seek(self, seconds: float) -> None:
        """Go to a time; the belief begins anew there."""
        last = max(0.0, (self.opening.frames - 1) / LOOKS)
        self._start, self._over = min(seconds, last), False
        self._begin()

    def _begin(self) -> None:
        self._forget()
        self._anchor = None

    def _show_all(self) -> None:
        """Begin, and say what is shown."""
        assert self._opened is not None
        self._begin()
        self._scene("picture", self.opening.name or "Video", self._opened.calibrated, frames=self.opening.frames)

    def _show(self, said: Turned, now: float) -> None:
        """One frame: take in its looks, and say what is believed."""
        if said.lost:
            self._begin()
            self._out.status(self.number, "A picture does not fit to those before it: the belief starts anew.")
        stamp, pose = said.stamp, said.world_R_body
        self._following.pose(stamp, pose, None)
        self._picture(stamp, pose, said.jpeg)
        if said.looks and said.query == self._query:
            self._take([replace(evidence, stamp=stamp) for evidence in said.looks], stamp, pose)
        frame = {"n": round(stamp * LOOKS), "of": self.opening.frames, "stamp": rounded(stamp, 3)}
        self._step(self._following.answer(stamp, 0.0), stamp, frame=frame)
        if self._anchor is None:
            self._anchor = stamp, now
        # At the video's speed at most: the next frame is due when its time has come.
        self.due = max(now, self._anchor[1] + (stamp + 1 / LOOKS - self._anchor[0]))
