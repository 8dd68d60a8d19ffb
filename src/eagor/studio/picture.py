"""A photograph to look around in: the camera turns as the person drags, and the belief stays with the world."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from eagor.sphere import angular_distance, world_R_body
from eagor.studio.following import SOONEST, Following
from eagor.studio.orders import Opened, Refused, See, Seen
from eagor.studio.rivals import OFFERED, Rivals
from eagor.studio.session import Opening, Outbox
from eagor.studio.steps import FLOATS, estimate_json, evidence_of, modes_json, stage
from eagor.studio.wire import Blob, Message, rounded
from eagor.tasks.methods import BASE

__all__ = ["PictureSession"]

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
