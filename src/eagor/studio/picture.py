"""Sessions of a photograph, in which the person turns the camera, and of a video, which is played."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from eagor.sphere import angular_distance, world_R_body
from eagor.studio.messages import Blob, Message, rounded
from eagor.studio.session import LOOKS, Opened, Opening, Outbox, Refused, See, Seen, Turn, Turned
from eagor.studio.steps import (
    FLOATS,
    OFFERED,
    SOONEST,
    Following,
    Rivals,
    estimate_json,
    evidence_of,
    modes_json,
    stage,
)
from eagor.tasks.methods import BASE

__all__ = ["PictureSession", "VideoSession"]

BETWEEN = 0.5  # seconds from one look to the next: time goes on with looks alone
TICK = 1e-3  # of such a second, from one step to the next
TURNED = math.radians(5)  # of the camera, which are worth another look
SOON = 0.02  # seconds


class PictureSession:
    """One person's view of one photograph; see `eagor.studio.session.Session`.

    A photograph does not change, so its time passes with looks: each is half a second after the one before.
    """

    def __init__(self, number: int, opening: Opening, out: Outbox) -> None:
        assert opening.picture is not None
        self.number, self.opening, self._out = number, opening, out
        self.due = math.inf
        self._picture: Path = opening.picture
        self._query, self._degree = opening.query, BASE.degree
        self._angles = (0.0, 0.0, 0.0)
        self._opened: Opened | None = None
        self._seeing = self._paused = False
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
                pose = self._poses.pop(said.stamp)
                for evidence in said.looks:
                    self._following.look(evidence)
                self._rivals.look(said.stamp, pose, None, said.looks)
                if said.looks:
                    header, blob = evidence_of(said.looks[0], pose, said.stamp, self._degree)
                    self._parts["evidence"], self._blobs["evidence"] = header, blob
                self._fresh = True
            self.due = now
        elif isinstance(said, Refused):
            self._seeing = False
            fatal = said.part == "picture"
            if said.part == "query":
                self._refused = said.query
                if said.query != self._query:
                    self.due = now
                    return
            change = "Drop another file." if fatal else "Ask for something else, or choose another perception."
            self._out.problem(self.number, said.problem, change, fatal)

    def told(self, message: dict[str, Any], now: float) -> None:
        """What the page says; its fields have been checked."""
        kind = message["type"]
        if kind == "pause":
            self._paused = message["on"]
        elif kind == "camera":
            self._angles = (message["yaw"], message["pitch"], message["roll"])
        elif self._opened is None:
            return
        elif kind == "query":
            self._query = message["text"]
            self.opening = replace(self.opening, query=self._query)
            self._follow(now)
        elif kind == "degree":
            self._degree = message["L"]
            self._follow(now)
        elif kind == "methods":
            self._rivals.choose(message["names"])
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
        pose = self._pose()
        self._following.pose(self._stamp, pose, None)
        self._see(pose)
        estimate = self._following.answer(self._stamp, 0.0)
        yaw, pitch, roll = self._angles
        header: dict[str, Any] = {
            "type": "step",
            **stage(estimate, self._stamp, None),
            "attitude": {"yaw": rounded(yaw), "pitch": rounded(pitch), "roll": rounded(roll)},
            "estimate": estimate_json(estimate, self._following.entropy),
            "modes": modes_json(estimate),
            "rivals": self._rivals.answers(pose, None),
            "truth": {"direction": None},
            "error_deg": None,
            "goal": None,
            **self._parts,
        }
        header["look"]["fresh"], self._fresh = self._fresh, False
        if self._following.news:
            header["belief"] = self._following.belief
            self._blobs["belief"] = Blob(FLOATS, self._following.coefficients)
            self._following.news = False
        self._out.step(self.number, Message(header, self._blobs))
        self._parts, self._blobs = {}, {}
        return self._following.took

    def _pose(self) -> np.ndarray:
        yaw, pitch, roll = self._angles
        return world_R_body(yaw, -pitch, roll)

    def _follow(self, now: float) -> None:
        """Follow the query, with nothing known."""
        assert self._opened is not None
        self._following = Following(replace(BASE, degree=self._degree))
        self._rivals = Rivals(self.opening.perception)
        self._rivals.choose(self.opening.methods)
        self._stamp, self._poses, self._looked_from = 0.0, {}, None
        self._refused, self._fresh = None, False
        here = {"stamp": 0.0, "world_R_camera": [1, 0, 0, 0, 1, 0, 0, 0, 1]}
        self._parts: dict[str, Any] = {"panorama": here}
        self._blobs: dict[str, Blob] = {"panorama": Blob("image/jpeg", self._opened.jpeg)}
        scene = {
            "type": "scene",
            "view": "picture",
            "title": self.opening.name or "Picture",
            "session": str(self.number),
            "query": self._query,
            "targets": [],
            "facts": list(self._opened.facts),
            "plan": None,
            "degree": self._degree,
            "calibration": self._opened.calibrated,
            "perception": self.opening.perception,
            "methods": list(OFFERED),
            "region": 0.9,
        }
        self._out.send(self.number, Message(scene))
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
        job = See(
            self.number, self._stamp, pose, None, self.opening.perception, self._query, 0, picture=self._picture
        )  # fmt: skip
        self._out.eye(job)


class VideoSession:
    """One person's view of one video; see `eagor.studio.session.Session`. Its time is that of the video."""

    def __init__(self, number: int, opening: Opening, out: Outbox) -> None:
        assert opening.picture is not None
        self.number, self.opening, self._out = number, opening, out
        self.due = math.inf
        self._path: Path = opening.picture
        self._query, self._degree = opening.query, BASE.degree
        self._refused: str | None = None
        self._names = opening.methods
        self._opened: Opened | None = None
        self._paused = self._over = self._asking = False
        self._start: float | None = 0.0  # where to seek with the next frame
        out.eye(("video", number, opening.perception))
        out.status(number, f"Reading {opening.name or 'the video'}.")

    def saw(self, said: Any, now: float) -> None:
        """What the eye says."""
        if isinstance(said, Opened):
            self._opened = said
            self._follow()
            self._scene()
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
            if said.part == "query":
                self._refused = said.query
                if said.query != self._query:
                    return
            change = "Drop another file." if fatal else "Ask for something else, or choose another perception."
            self._out.problem(self.number, said.problem, change, fatal)

    def told(self, message: dict[str, Any], now: float) -> None:
        """What the page says; its fields have been checked."""
        kind = message["type"]
        if kind == "pause":
            self._paused = message["on"]
            if self._opened is not None:
                self._anchor = None  # time has stood still
        elif kind == "seek":
            self._seek(message["frame"] / LOOKS)
        elif kind == "restart":
            self._seek(0.0)
        elif kind == "methods":
            self._names = tuple(message["names"])
            if self._opened is not None:
                self._rivals.choose(self._names)
        elif self._opened is None:
            return
        elif kind in ("query", "degree"):
            self._query = message.get("text", self._query)
            self.opening = replace(self.opening, query=self._query)
            self._degree = message.get("L", self._degree)
            self._refused = None
            self._follow()
            self._scene()
        self.due = min(self.due, now) if self._opened is not None else self.due

    def tick(self, now: float, soonest: float = SOONEST) -> float:
        """Ask for the next frame; one frame is shown after a seek even while the video is paused."""
        self.due = math.inf
        wanted = self._start is not None or not (self._paused or self._over)
        if self._opened is None or self._asking or not wanted:
            return 0.0
        query = None if self._refused == self._query else self._query
        self._out.eye(Turn(self.number, self._path, self.opening.perception, query, self._start))
        self._start, self._asking = None, True
        return 0.0

    def _seek(self, seconds: float) -> None:
        """Go to a time; the belief begins anew there."""
        last = max(0.0, (self.opening.frames - 1) / LOOKS)
        self._start, self._over = min(seconds, last), False
        if self._opened is not None:
            self._follow()

    def _follow(self) -> None:
        self._following = Following(replace(BASE, degree=self._degree))
        self._rivals = Rivals(self.opening.perception)
        self._rivals.choose(self._names)
        self._anchor: tuple[float, float] | None = None  # time of the video, and ours

    def _show(self, said: Turned, now: float) -> None:
        """One frame: take in its looks, and say what is believed."""
        if said.lost:
            self._follow()
            self._out.status(self.number, "A picture does not fit to those before it: the belief starts anew.")
        stamp, pose = said.stamp, said.world_R_body
        self._following.pose(stamp, pose, None)
        parts: dict[str, Any] = {}
        blobs = {"panorama": Blob("image/jpeg", said.jpeg)}
        looks = said.looks if said.query == self._query else ()
        for evidence in looks:
            self._following.look(replace(evidence, stamp=stamp))
        if looks:
            self._rivals.look(stamp, pose, None, looks)
            header, blob = evidence_of(looks[0], pose, stamp, self._degree)
            parts["evidence"], blobs["evidence"] = header, blob
        estimate = self._following.answer(stamp, 0.0)
        step: dict[str, Any] = {
            "type": "step",
            **stage(estimate, stamp, None),
            "panorama": {"stamp": rounded(stamp), "world_R_camera": rounded(pose.reshape(9), 6)},
            "estimate": estimate_json(estimate, self._following.entropy),
            "modes": modes_json(estimate),
            "rivals": self._rivals.answers(pose, None),
            "truth": {"direction": None},
            "error_deg": None,
            "goal": None,
            "frame": {"n": round(stamp * LOOKS), "of": self.opening.frames, "stamp": rounded(stamp, 3)},
            **parts,
        }
        step["look"]["fresh"] = bool(looks)
        if self._following.news:
            step["belief"] = self._following.belief
            blobs["belief"] = Blob(FLOATS, self._following.coefficients)
            self._following.news = False
        self._out.step(self.number, Message(step, blobs))
        if self._anchor is None:
            self._anchor = stamp, now
        # At the video's speed at most: the next frame is due when its time has come.
        self.due = max(now, self._anchor[1] + (stamp + 1 / LOOKS - self._anchor[0]))

    def _scene(self) -> None:
        assert self._opened is not None
        scene = {
            "type": "scene",
            "view": "picture",
            "title": self.opening.name or "Video",
            "session": str(self.number),
            "query": self._query,
            "targets": [],
            "plan": None,
            "degree": self._degree,
            "calibration": self._opened.calibrated,
            "perception": self.opening.perception,
            "methods": list(OFFERED),
            "region": 0.9,
            "frames": self.opening.frames,
        }
        self._out.send(self.number, Message(scene))
