"""The walk: a body in an apartment, steered by the policy or by the person, with live looks and a live belief."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np

from eagor.lab.envs.rules import NavigationRules
from eagor.lab.worlds.navmesh import GeodesicDistance
from eagor.studio.following import SOONEST, FollowingSession
from eagor.studio.houses import Body, House, Walker, walled
from eagor.studio.messages import rounded
from eagor.studio.session import Built, Loaded, Opening, Outbox, Panorama, Refused, See, Seen
from eagor.tracking import Estimate

__all__ = ["WalkSession"]

PERIOD = 0.1  # seconds between two steps
RESTING = 0.5  # between two steps while nothing moves
STILL = 1.0  # seconds between two looks from the same place
SURE = 3  # looks before the first walk begins
MOVING = (256, 384, 512)  # rows of panoramas while the body moves: the most that come
QUICK = 0.1  # seconds after they were ordered
FINE = ((0.5, 512), (1.5, 1024))  # seconds of rest, and rows of the panorama that is shown from then on


class WalkSession(FollowingSession):
    """One person's walk."""

    def __init__(self, number: int, opening: Opening, out: Outbox) -> None:
        super().__init__(number, opening, out)
        self.house: House | None = None
        self._seeing = self._looking = False  # something is under way, with a look
        self._cost = 0.0  # seconds of a panorama, by the square of its rows, with what it waits for other pages
        self._ordered = 0.0, 1  # when the newest one was ordered, and its rows
        self._rows = 0  # of the panorama that is shown from here
        self._seen_from: tuple[float, ...] | None = None  # and where that is
        self._poses: dict[float, tuple[np.ndarray, np.ndarray]] = {}
        self._hidden: float | None = None  # since when a wall hides the thing
        self._estimate: Estimate | None = None
        out.eye(("house", number, opening.seed))
        out.status(number, f"Building apartment {opening.seed}. The first time takes some seconds.")

    def saw(self, said: Any, now: float) -> None:
        """What the eye says."""
        if isinstance(said, Loaded):
            self._loaded(said)
        elif isinstance(said, Built):
            self.house = said.house
        elif isinstance(said, Panorama) and self._running:
            self._seeing = self._seeing and self._looking  # the look is still to come
            ordered, rows = self._ordered
            self._cost = (time.monotonic() - ordered) / rows**2
            if said.stamp in self._poses:  # else it is from before the walk began again
                self._picture(said.stamp, said.world_R_body, said.jpeg)
        elif isinstance(said, Seen) and self._running:
            self._seeing = False
            pose = self._poses.get(said.stamp)
            if pose is not None and self._answers(said.question):
                self._take(said.looks, said.stamp, *pose, around=said.around)
        elif isinstance(said, Refused):
            self._seeing = False
            change = "Ask for one of the things that are offered." if said.part == "query" else "Choose another one."
            self._refuse(said, change)
        self.due = now
        if self.house is not None and not self._running and self._wanted is not None:
            self._running = True
            self._begin(now)

    def told(self, message: dict[str, Any], now: float) -> None:
        """What the page says; its fields have been checked."""
        kind = message["type"]
        if kind == "pause":
            if self._running and message["on"] != self._paused:  # its time stands still, too
                self._stopped, self._begun = now, self._begun + (now - self._stopped) * self._paused
            self._paused, self._last = message["on"], now
        elif not self._told(message) and self._running:
            if kind == "restart":
                self.opening = replace(self.opening, drive=self._walker.by)
                self._begin(now)
            elif kind == "drive":
                self._walker.drive(message["by"])
                if message["by"] == "person" and not self._paused:
                    self._walker.steer(message["forward"], message["turn"], message["seconds"])
        self.due = min(self.due, now)

    def tick(self, now: float, soonest: float = SOONEST) -> float:
        """Move, look, answer; `soonest`: seconds between two computations of the belief, as all sessions can bear."""
        idle = self._paused and self._next is None and not self._due_once
        if not self._running or (idle and self._rows == FINE[-1][1] and "panorama" not in self._parts):
            self.due = math.inf
            return 0.0
        stamp = (self._stopped if self._paused else now) - self._begun
        body, before = self._walker.body, self._estimate
        known = None if before is None else before.direction
        if self._walker.by == "tour" and self._looks < SURE:
            known = None  # it waits at the beginning
        moved = not self._paused and self._walker.move(now - self._last, known, self._arrived)
        self._last = now
        self._pose(stamp, body.world_R_body, body.position)
        self._estimate = estimate = self._following.answer(stamp, soonest)
        self._moved = now if moved else self._moved
        goal = self._goal(stamp)
        self._work(now, soonest, stamp)
        self._step(estimate, stamp, body.position, self._truth(), goal=goal, drive=self._walker.by)
        self._see(stamp, now - self._moved)
        self.due = now + (PERIOD if now - self._moved < STILL else RESTING)
        return self._following.took

    def _begin(self, now: float) -> None:
        """Stand where the episode or the first walk begins."""
        assert self.house is not None
        tour = self.house.tour if self.opening.drive == "tour" else None
        if not self._asked.query:
            self._asked = replace(self._asked, query=self.house.query if tour is None else tour.query)
        if tour is None:
            body = Body(self.house.ground, self.house.start.copy(), self.house.yaw)
            by = "person" if self.opening.drive == "person" else "policy"
            self._walker = Walker(body, by)
        else:
            self._walker = Walker(Body(self.house.ground, tour.way[0].copy(), tour.yaw), "tour", [*tour.way[1:]])
        self._begun = self._last = self._moved = self._stopped = now
        self._looked, self._seen_from, self._poses, self._paused = -math.inf, None, {}, False
        self._follow()

    def _follow(self) -> None:
        """Forget what was believed, and follow what is asked from here."""
        assert self.house is not None
        self._forget()
        self._estimate = None
        self._rows = 0  # the newest picture may have been overtaken by the scene
        self._targets = self.house.targets(self._asked.query)
        ground = self.house.ground
        ways = [ground.footprint(self.house.things[index]) for index in self._targets]
        self._way: GeodesicDistance | None = ways[0].union(*ways[1:]) if ways else None
        self._arrived, self._hidden = False, None
        plan = dict(self.house.plan)
        names = {self.house.things[index].name for index in self._targets}
        plan["things"] = [thing | {"target": thing["name"] in names} for thing in plan["things"]]
        self._scene(
            "walk", f"Apartment {self.house.seed}", seed=self.house.seed, targets=list(self.house.names), plan=plan,
            drive=self._walker.by,
        )  # fmt: skip

    def _truth(self) -> np.ndarray | None:
        """The direction of the nearest thing that the query names, body frame; None if it names none here."""
        assert self.house is not None
        if not self._targets:
            return None
        body = self._walker.body
        nearest = self._nearest - body.position
        return body.world_R_body.T @ (nearest / max(float(np.linalg.norm(nearest)), 1e-9))

    @property
    def _nearest(self) -> np.ndarray:
        """The centre ``(3,)`` of the nearest thing that the query names; it names one."""
        assert self.house is not None
        centres = np.array([self.house.things[index].centre for index in self._targets])
        return centres[int(np.linalg.norm(centres - self._walker.body.position, axis=1).argmin())]

    def _goal(self, stamp: float) -> dict[str, Any] | None:
        """How far it is to the thing, whether a wall hides it, and whether the body has arrived."""
        if self._way is None:
            return None
        assert self.house is not None
        body, thing = self._walker.body, self._nearest
        left = float(self._way.distance(body.xy))
        self._arrived = left < NavigationRules().success_distance
        hidden = walled(self.house.ground, body.xy, thing[:2])
        self._hidden = (stamp if self._hidden is None else self._hidden) if hidden else None
        words = f"{left:.1f} m of walking left." if math.isfinite(left) else "No way leads there on foot."
        if self._hidden is not None:
            words = f"A wall has hidden the {self._asked.query} for {stamp - self._hidden:.0f} s. {words}"
        elif self._walker.by == "tour":
            words = f"The {self._asked.query} is in sight."
        elif self._arrived:
            words = "Reached."
        return {
            "position": rounded(thing[:2], 3), "metres": rounded(left, 2), "reached": self._arrived, "words": words,
        }  # fmt: skip

    def _see(self, stamp: float, rested: float) -> None:
        """Ask for the next picture or look, once the one before has come.

        A body at rest is shown a finer picture the longer it stands; a look comes before that.
        """
        if self._seeing:
            return
        body = self._walker.body
        here = (*body.xy, body.yaw)
        stands, first = here == self._seen_from, self._seen_from is None
        wanted = self._wanted
        waits = self._paused or (stands and stamp - self._looked < STILL)  # only a new question does not
        if first or (waits and wanted != self._next):
            wanted = None  # a picture at once; looks take their turns with those of other pages
        rows = max(each for each in MOVING if each == MOVING[0] or self._cost * each**2 < QUICK)
        rows = max((each for after, each in FINE if stands and rested >= after), default=rows)
        if stands and (wanted is not None or rows <= self._rows):
            rows = 0
        if wanted is None and not rows:
            return
        self._seen_from, self._rows = here, rows or self._rows
        self._looked = self._looked if wanted is None else stamp
        self._seeing, self._looking, self._ordered = True, wanted is not None, (time.monotonic(), rows)
        self._poses = {stamp: (body.world_R_body, body.position)}
        self._out.eye(See(
            self.number, stamp, body.world_R_body, body.position, wanted, rows, seed=self.opening.seed,
        ))  # fmt: skip
