"""What every session follows: one query, with our tracker and with other methods; and what a step says of both."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eagor.errors import EagorError, PoseError, TimeError
from eagor.evidence import Evidence
from eagor.grids import ErpGrid
from eagor.studio.messages import Blob, Message, rounded
from eagor.studio.session import Opening, Outbox, Refused
from eagor.studio.steps import FLOATS, belief_of, believed, error_deg, estimate_json, evidence_of
from eagor.tasks.methods import BASE, DESCRIPTIONS, NAMES, Method, make_method
from eagor.tracking import Estimate, TrackerConfig
from eagor.tracking.follower import Follower, Refresh

__all__ = ["SOONEST", "Following", "FollowingSession", "Rivals", "warm"]

SOONEST = 0.05  # seconds between two computations, at least: every step, where the machine can bear it
LATEST = 1.0  # seconds after which the belief is computed anew without news: targets may come and go
HISTORY = 60.0  # seconds by which a look may be late: many pages share one eye
MOVED = 0.02  # metres of the camera that are worth a computation


class Following:
    """One query, followed with one configuration; stamps are seconds of the session.

    `entropy`, `belief` and `coefficients` are those of the newest computation; `news` says whether the last two have
    been taken.
    """

    def __init__(self, config: TrackerConfig) -> None:
        self.follower = Follower(replace(config, history=max(config.history, HISTORY)))
        self.entropy = math.log(4 * math.pi)
        self.belief: dict[str, Any] = {}
        self.coefficients, self.news = b"", False
        self.took = 0.0  # seconds of the newest answer, if it was a computation

    def pose(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        """A pose of the camera; once for every stamp, in order."""
        self.follower.move(stamp, world_R_body, position)

    def look(self, evidence: Evidence) -> None:
        """A look, stamped with the time of a pose. One that comes later than the history reaches is left out."""
        with suppress(PoseError, TimeError):
            self.follower.look(evidence)

    def answer(self, stamp: float, soonest: float = SOONEST) -> Estimate:
        """The estimate at the newest pose, computed anew not more often than every `soonest` seconds."""
        began, before, self.took = time.perf_counter(), self.follower.computed, 0.0
        estimate = self.follower.estimate(stamp, Refresh(soonest, max(LATEST, soonest), MOVED))
        if estimate is not before and estimate is self.follower.computed:
            self.entropy = estimate.posterior.entropy()
            self.belief, self.coefficients = belief_of(estimate, stamp, estimate.config.degree)
            self.news, self.took = True, time.perf_counter() - began
        return estimate


def warm(config: TrackerConfig) -> None:
    """Make the tables that the first answers need, which take tenths of a second."""
    following = Following(config)
    for number in range(3):
        stamp = float(number)
        following.pose(stamp, np.eye(3), np.array([0.1 * number, 0.0, 1.25]))
        following.look(Evidence.from_points(np.array([[1.0, 0.1, 0.0]]), scores=np.full(1, 0.8), stamp=stamp))
        following.look(Evidence.from_response(np.full((32, 64), 0.1), ErpGrid(32, 64), stamp=stamp))
        estimate_json(following.answer(stamp, 0.0), following.entropy)


OURS = "eagor"
OFFERED = tuple({"name": name, "words": DESCRIPTIONS[name]} for name in NAMES if name != OURS)


@dataclass
class Rivals:
    """The chosen methods, with settings for `perception`. A method that is chosen late begins with the next look."""

    perception: str
    _methods: dict[str, Method] = field(default_factory=dict)
    _answers: dict[str, np.ndarray] = field(default_factory=dict)  # world frame
    _last: float = -np.inf

    def choose(self, names: Sequence[str]) -> None:
        """Keep those that are chosen still, begin the others. Unknown names are left out."""
        wanted = [name for name in NAMES if name in names and name != OURS]
        made = {}
        for name in wanted:
            made[name] = self._methods.get(name) or make_method(name, np.random.default_rng(0), self.perception)
        self._methods = made
        self._answers = {name: each for name, each in self._answers.items() if name in made}

    def look(
        self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None, looks: Sequence[Evidence]
    ) -> None:
        """A look from a pose; looks come in order of time."""
        if stamp <= self._last:
            return
        self._last = stamp
        for name, method in self._methods.items():
            try:
                method.move(stamp, world_R_body, position)
                for evidence in looks:
                    method.see(replace(evidence, stamp=stamp))
                self._answers[name] = world_R_body @ method.direction()
            except EagorError:  # it cannot read such evidence: it has no answer
                self._answers.pop(name, None)

    def answers(self, world_R_body: np.ndarray, truth: np.ndarray | None) -> dict[str, Any]:
        """Each one's direction in the body frame now, and its error, if the truth is known."""
        found = {name: world_R_body.T @ direction for name, direction in self._answers.items()}
        return {
            name: {"direction": rounded(direction), "error_deg": error_deg(direction, truth)}
            for name, direction in found.items()
        }


class FollowingSession:
    """What all sessions share: the query, what is believed about it, and how that is said to the page.

    A session of a kind says when it looks, and when it takes a step; see `eagor.studio.session.Session`.
    """

    def __init__(self, number: int, opening: Opening, out: Outbox) -> None:
        self.number, self.opening, self._out = number, opening, out
        self.due = math.inf
        self._query, self._degree, self._names = opening.query, BASE.degree, opening.methods
        self._refused: str | None = None  # a query that cannot be looked for
        self._paused = False
        self._forget()

    def _forget(self) -> None:
        """Follow the query, with nothing known."""
        self._following = Following(replace(BASE, degree=self._degree))
        self._rivals = Rivals(self.opening.perception)
        self._rivals.choose(self._names)
        self._parts: dict[str, Any] = {}  # of the next step
        self._blobs: dict[str, Blob] = {}
        self._fresh = False

    def _changes(self, message: dict[str, Any]) -> bool:
        """Take in another query or degree; whether the message was one, so that all begins anew."""
        if message["type"] == "query":
            self._query = message["text"]
            self.opening = replace(self.opening, query=self._query)
        elif message["type"] == "degree":
            self._degree = message["L"]
        else:
            return False
        self._refused = None
        return True

    def _compare(self, message: dict[str, Any]) -> None:
        """Take in the choice of other methods."""
        self._names = tuple(message["names"])
        self._rivals.choose(self._names)

    def _concerns(self, said: Refused) -> bool:
        """Whether a refusal is of what is wanted now; one of a query may come late."""
        if said.part == "query":
            self._refused = said.query
        return said.part != "query" or said.query == self._query

    def _take(
        self, looks: Sequence[Evidence], stamp: float, world_R_body: np.ndarray, position: np.ndarray | None = None
    ) -> None:
        """Take in the looks at what was seen from a pose."""
        for evidence in looks:
            self._following.look(evidence)
        self._rivals.look(stamp, world_R_body, position, looks)
        if looks:
            found = evidence_of(looks[0], world_R_body, stamp, self._degree)
            self._parts["evidence"], self._blobs["evidence"] = found
        self._fresh = True

    def _picture(self, stamp: float, world_R_body: np.ndarray, jpeg: bytes) -> None:
        """The next step has a panorama."""
        self._parts["panorama"] = {"stamp": rounded(stamp), "world_R_camera": rounded(world_R_body.reshape(9), 6)}
        self._blobs["panorama"] = Blob("image/jpeg", jpeg)

    def _step(
        self,
        estimate: Estimate,
        stamp: float,
        position: np.ndarray | None = None,
        truth: np.ndarray | None = None,
        **about: Any,
    ) -> None:
        """Say what is believed now, and what is new. `truth`: the true direction ``(3,)``, body frame, if known."""
        header: dict[str, Any] = {
            "type": "step",
            **believed(estimate, stamp, position, truth, self._following.entropy),
            "rivals": self._rivals.answers(estimate.world_R_body, truth),
            "goal": None,
            **about,
            **self._parts,
        }
        header["look"]["fresh"], self._fresh = self._fresh, False
        if self._following.news:
            header["belief"] = self._following.belief
            self._blobs["belief"] = Blob(FLOATS, self._following.coefficients)
            self._following.news = False
        self._out.step(self.number, Message(header, self._blobs))
        self._parts, self._blobs = {}, {}

    def _scene(self, view: str, title: str, calibration: dict[str, Any], **about: Any) -> None:
        """Say what is shown."""
        scene = {
            "type": "scene",
            "view": view,
            "title": title,
            "session": str(self.number),
            "query": self._query,
            "targets": [],
            "plan": None,
            "degree": self._degree,
            "calibration": calibration,
            "perception": self.opening.perception,
            "methods": list(OFFERED),
            "region": 0.9,
        }
        self._out.send(self.number, Message(scene | about))
