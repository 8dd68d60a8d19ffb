"""The walk: a body in an apartment, steered by the policy or by the person, with live looks and a live belief."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from eagor.studio.following import SOONEST, FollowingSession
from eagor.studio.houses import Body, House, Walker
from eagor.studio.messages import rounded
from eagor.studio.session import Built, Opening, Outbox, Panorama, Refused, See, Seen
from eagor.tasks.rules import NavigationRules
from eagor.worlds.walkable import Way

__all__ = ["WalkSession"]

PERIOD = 0.1  # seconds between two steps
RESTING = 0.5  # between two steps while nothing moves
STILL = 1.0  # seconds between two looks from the same place
ROWS, FINE = 192, 384  # of panoramas: while the body moves, and when it has come to rest


class WalkSession(FollowingSession):
    """One person's walk; see `eagor.studio.session.Session`."""

    def __init__(self, number: int, opening: Opening, out: Outbox) -> None:
        super().__init__(number, opening, out)
        self.house: House | None = None
        self._seeing = self._looking = self._fine = False  # something is under way, with a look; the picture is fine
        out.eye(("house", number, opening.seed, opening.perception))
        out.status(number, f"Building apartment {opening.seed}. The first time takes some seconds.")

    def saw(self, said: Any, now: float) -> None:
        """What the eye says."""
        if isinstance(said, Built):
            self.house, self._calibration = said.house, said.calibrated
            self._query = self.opening.query or said.house.query
            self._begin(now)
        elif isinstance(said, Panorama) and self.house is not None:
            self._seeing = self._seeing and self._looking  # the look is still to come
            if said.stamp < self._since:
                return
            self._picture(said.stamp, said.world_R_body, said.jpeg)
            self.due = now
        elif isinstance(said, Seen) and self.house is not None:
            self._seeing = False
            if said.query == self._query and said.stamp >= self._since:
                if (pose := self._poses.pop(said.stamp, None)) is not None:
                    self._take(said.looks, said.stamp, *pose)
                self.due = now
        elif isinstance(said, Refused):
            self._seeing = False
            if not self._concerns(said):
                return
            change = "Ask for one of the things that are offered." if said.part == "query" else "Choose another one."
            self._out.problem(self.number, said.problem, change, fatal=said.part == "house")

    def told(self, message: dict[str, Any], now: float) -> None:
        """What the page says; its fields have been checked."""
        kind = message["type"]
        if kind == "pause":
            self._paused = message["on"]
            self._last = now
        elif self.house is None:
            return
        elif kind == "drive":
            self._walker.drive(message["by"])
            if message["by"] == "person" and not self._paused:
                self._walker.steer(message["forward"], message["turn"], message["seconds"])
        elif self._changes(message):
            self._follow(now)
        elif kind == "methods":
            self._compare(message)
        elif kind == "restart":
            self._begin(now)
        self.due = min(self.due, now)

    def tick(self, now: float, soonest: float = SOONEST) -> float:
        """Move, look, answer; `soonest`: seconds between two computations of the belief, as all sessions can bear."""
        if self.house is None or self._paused:
            self.due = math.inf
            return 0.0
        stamp = now - self._begun
        body, before = self._walker.body, self._estimate
        known = None if before is None else before.direction
        moved = self._walker.move(now - self._last, known, self._arrived)
        self._last = now
        self._following.pose(stamp, body.world_R_body, body.position)
        self._estimate = estimate = self._following.answer(stamp, soonest)
        self._rested = 0.0 if moved else self._rested + PERIOD
        self._arrive()
        goal, truth = self._goal(), self._truth()
        self._step(estimate, stamp, body.position, truth, goal=goal, drive=self._walker.by)
        self._see(stamp)
        self.due = now + (PERIOD if moved or self._rested < 1.0 else RESTING)
        return self._following.took

    def _begin(self, now: float) -> None:
        """Stand where the episode begins."""
        assert self.house is not None
        self._walker = Walker(Body(self.house.ground, self.house.start.copy(), self.house.yaw), self.opening.drive)
        self._begun = now
        self._follow(now)

    def _follow(self, now: float) -> None:
        """Forget what was believed, and follow the query from here."""
        assert self.house is not None
        self._forget()
        self._estimate, self._refused = None, None
        self._since = now - self._begun
        self._poses: dict[float, tuple[np.ndarray, np.ndarray]] = {}
        self._looked, self._rested, self._seen_from = -math.inf, 0.0, None
        self._last = now
        self._targets = self.house.targets(self._query)
        ground = self.house.ground
        ways = [ground.footprint(self.house.things[index]) for index in self._targets]
        self._way: Way | None = ways[0].union(*ways[1:]) if ways else None
        self._arrived = False
        plan = dict(self.house.plan)
        names = {self.house.things[index].name for index in self._targets}
        plan["things"] = [thing | {"target": thing["name"] in names} for thing in plan["things"]]
        self._scene(
            "walk", f"Apartment {self.house.seed}", self._calibration, seed=self.house.seed,
            targets=list(self.house.names), plan=plan, drive=self._walker.by,
        )  # fmt: skip
        self.due = now

    def _truth(self) -> np.ndarray | None:
        """The direction of the nearest thing that the query names, body frame; None if it names none here."""
        assert self.house is not None
        if not self._targets:
            return None
        body = self._walker.body
        offsets = np.array([self.house.things[index].centre for index in self._targets]) - body.position
        nearest = offsets[int(np.linalg.norm(offsets, axis=1).argmin())]
        return body.world_R_body.T @ (nearest / max(float(np.linalg.norm(nearest)), 1e-9))

    def _arrive(self) -> None:
        reached = (
            self._way is not None
            and float(self._way.distance(self._walker.body.xy)) < NavigationRules().success_distance
        )
        self._arrived = bool(reached)

    def _goal(self) -> dict[str, Any] | None:
        assert self.house is not None
        if self._way is None:
            return None
        left = float(self._way.distance(self._walker.body.xy))
        centre = self.house.things[self._targets[0]].centre
        words = "Reached." if self._arrived else f"{left:.1f} m of walking left."
        if not math.isfinite(left):
            words = "No way leads there on foot."
        return {
            "position": rounded(centre[:2], 3), "metres": rounded(left, 2), "reached": self._arrived, "words": words,
        }  # fmt: skip

    def _see(self, stamp: float) -> None:
        """Ask for the next picture, and a look at it, once the one before has come."""
        if self._seeing:
            return
        body = self._walker.body
        here = (*body.xy, body.yaw)
        rested = self._rested > 0.5
        if here == self._seen_from and stamp - self._looked < STILL:
            return
        rows = ROWS if here != self._seen_from else 0
        if here == self._seen_from and rested and not self._fine:
            rows = FINE
        self._fine = rows == FINE or (rows == 0 and self._fine)
        first = self._seen_from is None  # a picture at once; looks take their turns with those of other pages
        query = None if first or self._refused == self._query else self._query
        self._seen_from, self._looked = here, -math.inf if first else stamp
        if query is None and not rows:
            return
        self._seeing, self._looking = True, query is not None
        self._poses = {stamp: (body.world_R_body, body.position)}
        job = See(
            self.number, stamp, body.world_R_body, body.position, self.opening.perception, query, rows,
            seed=self.opening.seed,
        )  # fmt: skip
        self._out.eye(job)
