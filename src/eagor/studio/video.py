"""A video to watch: it is played as fast as it can be looked at, at its own speed at most; one can pause and seek."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from eagor.studio.following import SOONEST, Following
from eagor.studio.orders import LOOKS, Opened, Refused, Turn, Turned
from eagor.studio.rivals import OFFERED, Rivals
from eagor.studio.session import Opening, Outbox
from eagor.studio.steps import FLOATS, estimate_json, evidence_of, modes_json, stage
from eagor.studio.wire import Blob, Message, rounded
from eagor.tasks.methods import BASE

__all__ = ["VideoSession"]


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
