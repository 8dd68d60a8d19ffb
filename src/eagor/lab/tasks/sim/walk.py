"""``apartment:7``: a body that walks through a built-in apartment, in real time, as a source of pictures and of poses.

It takes a short way on which a wall hides what was seen ("tour"), follows the answers of the loop that looks at its
pictures ("policy"), or goes where a person steers ("person").
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eagor.errors import DeviceError, QueryError
from eagor.grids import ErpGrid
from eagor.lab.agents.steering import Policy
from eagor.lab.envs.episodes import PER_PLACE, EpisodeSpec
from eagor.lab.envs.place_env import MobileBase
from eagor.lab.envs.places import APARTMENT, SEEDS, load_place
from eagor.lab.envs.rules import Camera, NavigationRules
from eagor.lab.tasks.sim.navigation import MapFreeNavigationEnv
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.navmesh import sees, walls_below
from eagor.live.events import Answer, Event, ObservationReceived
from eagor.live.threads import LoopClock
from eagor.queries import matching, parse_query
from eagor.sources import Frame, Pose
from eagor.sphere import azimuth_elevation

__all__ = ["DRIVERS", "TOUR_SEED", "Walk", "Walker", "open_walk", "walled"]

DRIVERS = ("tour", "policy", "person")
# The tour: `docs/figures/studio.py choose` says by which rule it is chosen.
TOUR_SEED, TOUR_QUERY = 5, "orange sofa"
TOUR = "0.97,9.28 3.57,9.90 3.72,10.08 3.82,10.53 3.80,10.83 3.77,10.88 1.47,12.18"

STOP, HERE = 5.0, 0.05  # seconds of a stop at the end of the way, and metres from a point at which the body is there
SPEED, TURN = 0.5, math.radians(75)  # metres and radians per second, of the policy
FASTEST, QUICKEST = 1.2, math.radians(150)  # of the person
LATE = 0.5  # seconds that a body moves at once at most: what was held up makes no leap
POSES, PICTURES = 0.1, 0.2  # seconds between two poses, and two pictures of a body that moves
STILL, TICK = 1.0, 1e-3  # seconds between two pictures from the same place, and between the stamps of those of one pose
MOVING_ROWS, FINE_ROWS, RESTED = 384, 1024, 1.0  # of pictures: while it moves, and after so many seconds of rest
SURE = 3  # looks before the tour begins


def open_walk(
    rest: str, *, latency: float = 0.0, rows: int | None = None, rig: Any = None, rate: float | None = None
) -> Walk:
    """The source that ``apartment:REST`` names: ``7``, or ``7?drive=person``. Raises `DeviceError`.

    `rows`: of all pictures (default: finer ones while the body stands). The others are for cameras: leave them out.
    """
    seed, _, drive = rest.partition("?drive=")
    if not seed.isdecimal() or int(seed) >= SEEDS or (drive and drive not in DRIVERS):
        raise DeviceError(
            f"apartment:{rest}; wanted apartment:SEED with a seed from 0 to {SEEDS - 1}, and after it, if you like, "
            f"?drive= and one of {', '.join(DRIVERS)}"
        )
    if rig is not None or rate is not None or latency:
        raise DeviceError(f"apartment:{rest} has a camera of its own; leave out the rig, the rate and the latency")
    return Walk(int(seed), drive, rows)


class WalkClock(LoopClock):
    """A clock that can be stopped."""

    paused, _stopped = False, 0.0

    def now(self) -> float:
        return self._stopped if self.paused else super().now()

    def pause(self, on: bool) -> None:
        """Stand still, or go on."""
        if on != self.paused:
            now = super().now()
            self._steady += 0.0 if on else now - self._stopped
            self._stopped, self.paused = now, on


class Walker:
    """Moves a `body` by the policy or along a `way` of points ``(2,)`` ("tour") as time passes, or as a person steers.

    A point of the way at which the body is already is a stop.
    """

    def __init__(self, body: MobileBase, by: str = "policy", way: Sequence[np.ndarray] = ()) -> None:
        self.body, self.way = body, list(way)
        self.drive(by)
        self._left = self._waits = 0.0  # metres of the straight part that is under way; seconds of a stop

    def drive(self, by: str) -> None:
        """Hand over to "policy", "person" or "tour"."""
        self.by, self._policy = by, Policy(self.body.camera.step)
        self._heading: float | None = None  # of the straight part that is under way

    def steer(self, forward: float, turn: float, seconds: float) -> None:
        """What the person has steered, m/s and rad/s to the left, and how long; the body stands without it."""
        if self.by == "person":
            turn, forward = np.clip([turn, forward], [-QUICKEST, -FASTEST], [QUICKEST, FASTEST]) * seconds
            self.body.walk(float(turn), float(forward))

    def move(self, seconds: float, direction: np.ndarray | None, arrived: bool) -> None:
        """Let time pass; `direction` ``(3,)``: the answer, body frame, or None: it looks around, or waits for it."""
        seconds = min(seconds, LATE)
        if self.by == "person" or (self.by == "policy" and arrived):
            return
        if direction is None:
            self.body.walk(TURN / 2 * seconds * (self.by == "policy"), 0.0)
            return
        self._waits = max(0.0, self._waits - seconds)
        if self._heading is None and not self._waits:
            self._begin(direction)
        if self._heading is not None:
            off = math.remainder(self._heading - self.body.yaw, math.tau)
            turned = min(abs(off), TURN * seconds)
            metres = min(self._left, SPEED * (seconds - turned / TURN))
            self.body.walk(math.copysign(turned, off), metres)
            self._left -= metres
            self._heading = self._heading if self._left > 1e-9 else None

    def _begin(self, direction: np.ndarray) -> None:
        """Choose the next straight part, or a stop."""
        if self.by == "policy":
            azimuth = float(azimuth_elevation(direction)[0])
            self._heading = self.body.yaw + self._policy.heading(azimuth, self.body.xy, self.body.yaw)
            self._left = self._policy.step
        elif self.way:
            ahead = self.way.pop(0) - self.body.xy
            self._left = float(np.hypot(*ahead))
            if self._left < HERE:
                self._waits = STOP
            else:
                self._heading = math.atan2(ahead[1], ahead[0])


class _Poses:
    """The poses of a walk, as a source of odometry; the body moves while they are read."""

    def __init__(self, walk: Walk) -> None:
        self._walk, self.close = walk, walk.close

    def __iter__(self) -> Iterator[Pose]:
        while not self._walk.closed.wait(POSES):
            if (pose := self._walk.step()) is not None:
                yield pose


class Walk:
    """A `CameraSource`, a `PoseSource` (`poses`) and a sink of the loop, whose first answer the policy follows.

    It walks in the environment of Map-Free Navigation, in an episode of it or on the tour. `query`: what there is to
    look for; `names`: what can be asked for without doubt. It has a `clock` of its own, which can be paused.
    """

    live, latency, dropped, problem = True, 0.0, 0, None

    def __init__(self, seed: int, drive: str = "", rows: int | None = None) -> None:
        self.seed, self._rows, self._env = seed, rows, MapFreeNavigationEnv(panorama=None)
        spec, way = EpisodeSpec("navigation", APARTMENT, seed, seed % PER_PLACE, seed % PER_PLACE), list[np.ndarray]()
        episode, self.place = self._env.plan(spec), load_place(APARTMENT, seed, Camera().radius)
        # Apartments of another version have another tour.
        if seed == TOUR_SEED and drive in ("", "tour") and (targets := self._named(TOUR_QUERY)):
            way = [np.array(point.split(","), dtype=float) for point in TOUR.split()]
            x, y = self.place.scene.instances[targets[0]].centre[:2] - way[0]
            start = {"start": tuple(way[0].tolist()), "yaw": math.atan2(y, x)}
            episode = replace(episode, query=TOUR_QUERY, targets=targets, **start)
        self._env.reset(options={"episode": episode})
        self.query, self.names = str(episode.query), tuple(sorted(map(str, self.place.nameable().values())))
        self.walker = Walker(self._env.body, drive or ("tour" if way else "policy"), [*way[1:], *reversed(way)])
        self.clock, self.closed = WalkClock(), threading.Event()
        self.pause, self.close = self.clock.pause, self.closed.set
        self.poses = _Poses(self)
        self.grid = ErpGrid(rows or MOVING_ROWS, 2 * (rows or MOVING_ROWS))
        self._lock = threading.Lock()  # the person steers from another thread than time passes in
        self._env.view()(32)  # the first takes seconds, for its light
        now = self.clock.now()
        self._now = self._pose(now), now  # and since when the body has been there
        self._at: tuple[float, ...] = ()  # that is, x, y, yaw
        self._direction: np.ndarray | None = None
        self._looks, self._arrived = 0, False
        self._hidden: tuple[str, float] | None = None  # what a wall hides, and since when

    def _pose(self, now: float) -> Pose:
        here = self.walker.body.pose
        return Pose(now, here.world_R_body, here.position)

    def _named(self, query: str) -> tuple[int, ...]:
        """The things that a query names; none if it names nothing that is known here."""
        things = self.place.scene.instances
        try:
            return tuple(matching(parse_query(query, {thing.category for thing in things}), things))
        except QueryError:
            return ()

    def __iter__(self) -> Iterator[Frame]:
        """A picture whenever the body has moved, a finer one once it stands, and that again for further looks."""
        picture, rows, seen, last, due = np.zeros(0), 0, -math.inf, -math.inf, -math.inf
        while not self.closed.wait(POSES / 4):
            (pose, moved), now = self._now, self.clock.now()
            rests = self.clock.paused or now - moved > RESTED
            wanted = self._rows or (FINE_ROWS if rests else MOVING_ROWS)
            if moved != seen or wanted > rows:
                assert pose.position is not None
                found = self.place.renderer.panorama(pose.position, pose.world_R_body, wanted, range=False, ids=False)
                picture, rows = np.asarray(found.rgb), wanted
            elif now < due:
                continue
            seen, due, last = moved, now + STILL, max(pose.stamp, last + TICK)
            yield Frame(last, picture, f"apartment {self.seed}")
            self.closed.wait(PICTURES - POSES / 4)

    def step(self) -> Pose | None:
        """Let the body move until now; its pose, or None while the walk is paused."""
        with self._lock:
            now, then = self.clock.now(), self._now[0].stamp
            if now <= then:
                return None
            known = None if self.walker.by == "tour" and self._looks < SURE else self._direction
            self.walker.move(now - then, known, self._arrived)
            at = (*self.walker.body.xy.tolist(), self.walker.body.yaw)
            pose, since = self._pose(now), self._now[1] if at == self._at else now
            self._now, self._at = (pose, since), at
            return pose

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """As a sink of the loop: the policy follows its first answer."""
        self._looks += isinstance(event, ObservationReceived)
        if answers:
            self._direction = answers[0].direction

    def drive(self, by: str, forward: float = 0.0, turn: float = 0.0, seconds: float = 0.0) -> None:
        """Who moves the body; and how the person has moved it (`Walker.steer`)."""
        with self._lock:
            if by != self.walker.by:
                self.walker.drive(by)
            if not self.clock.paused:
                self.walker.steer(forward, turn, seconds)

    def truth(self, query: str, body_R_world: np.ndarray) -> tuple[np.ndarray | None, dict[str, Any] | None]:
        """The true direction ``(3,)`` of the nearest thing that a query names, body frame, and the way to it.

        None if it names nothing here. The way has the thing's place ``(2,)``, the metres left, and says whether a wall
        hides it.
        """
        targets = self._named(query)
        if not targets:
            return None, None
        self._env.episode = replace(self._env.episode, targets=targets)
        here, nearest, left, now = self.walker.body.pose.position, self._env.target(), self._env.left, self.clock.now()
        assert nearest is not None
        self._arrived = left < NavigationRules().success_distance
        words = f"{left:.1f} m of walking left." if math.isfinite(left) else "No way leads there on foot."
        if walled(self.place.ground, here[:2], nearest[:2]):
            self._hidden = self._hidden if self._hidden and self._hidden[0] == query else (query, now)
            words = f"A wall has hidden the {query} for {now - self._hidden[1]:.0f} s. {words}"
        else:
            self._hidden = None
            if self.walker.by == "tour" or self._arrived:
                words = f"The {query} is in sight." if self.walker.by == "tour" else "Reached."
        away = nearest - here
        goal = {"position": nearest[:2], "metres": left, "words": words}
        return body_R_world @ (away / max(float(np.linalg.norm(away)), 1e-9)), goal

    def targets(self, query: str) -> set[str]:
        """The names in the scene of what a query names."""
        return {self.place.scene.instances[index].name for index in self._named(query)}


def walled(ground: Ground, xy: np.ndarray, point: np.ndarray) -> bool:
    """Whether a wall (or a door's or a window's frame) of the plan stands between two points ``(2,)``.

    The last half metre does not count: things stand against walls.
    """
    gap = max(float(np.linalg.norm(point - xy)), 0.5)
    line = (np.array([xy, xy + (1 - 0.5 / gap) * (point - xy)]) - ground.origin) / ground.cell
    structure = np.asarray(ground.structure)
    line = np.clip(line, 0.0, np.array(structure.shape[::-1]) - 1e-6)
    return not sees(walls_below(~structure), line[0], line[1:])[0]
