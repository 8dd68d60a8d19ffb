"""What every session follows: one question, with our tracker and with other methods; and what a step says of both."""

from __future__ import annotations

import itertools
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
from eagor.lab.agents.methods import BASE, DESCRIPTIONS, NAMES, Estimator, make_estimator
from eagor.studio.messages import Blob, Message, rounded
from eagor.studio.session import Loaded, Opening, Outbox, Question, Refused
from eagor.studio.steps import (
    FLOATS,
    LISTED,
    Listing,
    belief_of,
    believed,
    error_deg,
    estimate_json,
    evidence_of,
    scene_of,
)
from eagor.tracking import Around, Estimate, Surroundings, TrackerConfig
from eagor.tracking.follower import Follower, Refresh

__all__ = ["SOONEST", "Following", "FollowingSession", "Rivals", "warm"]

SOONEST = 0.05  # seconds between two computations, at least: every step, where the machine can bear it
LATEST = 1.0  # seconds after which the belief is computed anew without news: targets may come and go
HISTORY = 60.0  # seconds by which a look may be late: many pages share one eye
MOVED = 0.02  # metres of the camera that are worth a computation
MOST = 24  # things of a session that are followed without being asked for


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
        self.posed = -math.inf  # stamp of the newest pose

    def pose(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        """A pose of the camera, in order; the first of a stamp counts."""
        if stamp > self.posed:
            self.posed = stamp
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
    _methods: dict[str, Estimator] = field(default_factory=dict)
    _answers: dict[str, np.ndarray] = field(default_factory=dict)  # world frame
    _last: float = -np.inf

    def choose(self, names: Sequence[str]) -> None:
        """Keep those that are chosen still, begin the others. Unknown names are left out."""
        wanted = [name for name in NAMES if name in names and name != OURS]
        made = {}
        for name in wanted:
            made[name] = self._methods.get(name) or make_estimator(name, np.random.default_rng(0), self.perception)
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
    """What all sessions share: the question, what is believed about it, and how that is said to the page.

    A new question changes nothing until a look for it has been taken: so one that is refused changes nothing at all.
    One for a thing that was seen already is answered at once. A session of a kind says when it looks, and when it
    takes a step. `due`: when `tick` is to be called, on `time.monotonic`.
    """

    def __init__(self, number: int, opening: Opening, out: Outbox) -> None:
        self.number, self.opening, self._out = number, opening, out
        self.due = math.inf
        self._asked: Question = opening.question  # what is answered,
        self._next: Question | None = None  # and what is looked for in its place
        self._refused = False  # what is asked cannot be looked for
        self._names, self._steps = opening.methods, itertools.count(1)
        self._calibrated: dict[str, dict[str, Any]] = {}  # of the perceptions that are loaded
        self._running = self._paused = self._due_once = False  # the last: a step, though it is paused
        self._worked = -math.inf  # when something was computed of what else is here
        self._load()
        self._forget()

    def _load(self) -> None:
        """Have the perception of what is asked loaded."""
        self._out.eye(("perception", self.number, (self._next or self._asked).perception))

    def _loaded(self, said: Loaded) -> None:
        self._calibrated[said.perception] = said.calibrated

    def _forget(self) -> None:
        """Follow what is asked, with nothing known."""
        self._following = Following(replace(BASE, degree=self._asked.degree))
        self._rivals = Rivals(self._asked.perception)
        self._rivals.choose(self._names)
        self._refused = False
        self._around = Surroundings(replace(BASE, history=max(BASE.history, HISTORY)), MOST)
        self._listing, self._unlisted = Listing(), 0  # what else is here, and how many rows of it are to be made anew
        self._parts: dict[str, Any] = {"things": []}  # of the next step
        self._blobs: dict[str, Blob] = {}
        self._fresh, self._looks = False, 0

    def _told(self, message: dict[str, Any]) -> bool:
        """Take in what all sessions understand: another question, other methods. Whether the message was one."""
        if message["type"] == "methods":
            self._names = tuple(message["names"])
            self._rivals.choose(self._names)
            return True
        before = self._next or self._asked
        if message["type"] == "query":
            perception = message["perception"] or before.perception
            asked = replace(before, query=message["text"], perception=perception, number=message["question"])
        elif message["type"] == "degree":
            asked = replace(before, degree=message["L"])
        else:
            return False
        if self._running:
            self._next = asked
        else:  # there is nothing to keep yet
            self._asked = asked
        if asked.perception not in self._calibrated:
            self._load()
        if asked == self._next and self._knows(asked):
            self._answers(asked)
        return True

    def _knows(self, asked: Question) -> bool:
        """Whether it is one of the things that were seen already, by the same eyes."""
        same = asked.perception == self._asked.perception and asked.degree == self._asked.degree == BASE.degree
        return same and asked.query in self._around.names

    @property
    def _wanted(self) -> Question | None:
        """What the next look is for; None: nothing."""
        wanted = self._next or (None if self._refused else self._asked)
        return wanted if wanted is not None and wanted.perception in self._calibrated else None

    def _answers(self, question: Question | None) -> bool:
        """Whether a look for this question says something now; the first one for a new question takes it up."""
        if question is not None and question == self._next:
            kept, known = question.perception == self._asked.perception, self._knows(question)
            around, listing = self._around, self._listing
            self._asked, self._next, self._due_once = question, None, True
            self.opening = replace(self.opening, question=self._asked)
            self._follow()
            if kept:  # the same eyes: what they have seen of it counts
                self._around, self._listing, self._unlisted = around, listing, len(around.names)
                self._parts["things"] = listing.rows[:LISTED]
                if known:
                    self._following.follower.tracker.begin("target", question.query, around.tracker)
            return True
        return question == self._asked

    def tick(self, now: float, soonest: float = SOONEST) -> float:
        """Go on; `soonest`: seconds between two computations of the belief. Returns the seconds of one, or 0."""
        raise NotImplementedError

    def saw(self, said: Any, now: float) -> None:
        """Take in what the eye says."""
        raise NotImplementedError

    def told(self, message: dict[str, Any], now: float) -> None:
        """Take in what the page says, which has been checked."""
        raise NotImplementedError

    def _follow(self) -> None:
        """Forget what was believed, and say what is followed from now on."""
        raise NotImplementedError

    def _refuse(self, said: Refused, change: str) -> None:
        """Say what is refused, unless nobody asks for it any more; what was followed before goes on."""
        of, wanted = said.question, self._next or self._asked
        if of is not None:
            if of != (Question("", wanted.perception) if said.part == "perception" else wanted):
                return
            if self._next is None:
                self._refused = said.part == "query"
            self._next = None
        number = 0 if of is None else wanted.number
        fatal = said.part in ("house", "picture") or not self._running
        self._out.problem(self.number, said.problem, change, fatal, number)

    def _pose(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        """A pose of the camera, in order; the first of a stamp counts."""
        with suppress(TimeError):
            self._around.move(stamp, world_R_body, position)
        self._following.pose(stamp, world_R_body, position)

    def _take(
        self,
        looks: Sequence[Evidence],
        stamp: float,
        world_R_body: np.ndarray,
        position: np.ndarray | None = None,
        around: Around | None = None,
        again: bool = False,
    ) -> None:
        """Take in the looks at what was seen from a pose, and at all else; `again`: at a picture that has counted."""
        self._pose(stamp, world_R_body, position)  # if the question is as new as the look, there is none yet
        for evidence in looks:
            self._following.look(evidence)
        if around is not None and not again:
            with suppress(PoseError, TimeError):
                if self._around.look(around.at(stamp)):
                    self._unlisted = len(self._around.names)
        self._rivals.look(stamp, world_R_body, position, looks)
        if looks:
            found = evidence_of(looks[0], world_R_body, stamp, self._asked.degree)
            self._parts["evidence"], self._blobs["evidence"] = found
        self._fresh, self._looks = True, self._looks + 1

    def _work(self, now: float, soonest: float, stamp: float) -> bool:
        """Compute one thing more of what else is here, if it is time; whether there is more to do."""
        if (self._around.behind or self._unlisted) and now - self._worked >= 2 * soonest:
            self._worked = now
            if self._around.behind:
                self._around.take_in()
            else:
                self._unlisted -= 1
                self._parts["things"] = self._listing.renew(self._around, stamp)
        return self._around.behind or self._unlisted > 0

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
            "number": next(self._steps),
            "sent": time.time(),
            "question": self._asked.number,
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
        self._out.send(self.number, Message(header, self._blobs))
        self._parts, self._blobs, self._due_once = {}, {}, False

    def _scene(self, view: str, title: str, **about: Any) -> None:
        """Say what is shown."""
        asked = self._asked
        told = scene_of(
            view, title, asked.query, question=asked.number, degree=asked.degree, perception=asked.perception,
            calibration=self._calibrated[asked.perception], methods=list(OFFERED), **about,
        )  # fmt: skip
        self._out.send(self.number, Message({"type": "scene", **told}))
