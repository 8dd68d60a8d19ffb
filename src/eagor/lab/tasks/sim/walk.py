"""``apartment:7``: a body that walks through a built-in apartment, in real time, as a source of pictures and of poses.

It takes a short way on which a wall hides what was seen ("tour"), follows the answers of the loop that looks at its
pictures ("policy"), or goes where a person steers ("person").
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from eagor.errors import DeviceError, QueryError
from eagor.grids import ErpGrid
from eagor.lab.agents.steering import Policy
from eagor.lab.envs.episodes import PER_PLACE, EpisodeSpec
from eagor.lab.envs.places import APARTMENT, SEEDS, load_place
from eagor.lab.envs.rules import Camera, NavigationRules
from eagor.lab.tasks.sim import navigation
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.navmesh import DistanceField
from eagor.live.events import Answer, Event, EvidenceCame
from eagor.live.threads import LoopClock
from eagor.media import Frame, Pose
from eagor.queries import matching, parse_query
from eagor.sphere import azimuth_elevation, world_R_body

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
    """A clock that stands still while it is `paused`."""

    def __init__(self) -> None:
        super().__init__()
        self._lost, self._since = 0.0, math.nan

    @property
    def paused(self) -> bool:
        return not math.isnan(self._since)

    def now(self) -> float:
        return (self._since if self.paused else super().now()) - self._lost

    def slip(self) -> float:
        return 0.0

    def pause(self, on: bool) -> None:
        """Stand still, or go on."""
        if on != self.paused:
            now = super().now()
            self._lost += 0.0 if on else now - self._since
            self._since = now if on else math.nan


class Walker:
    """A round body with a camera on the `ground`, at `xy` ``(2,)``, metres; `yaw` in radians.

    It moves `by` the policy or along a `way` of points ``(2,)`` ("tour") as time passes, or by the person, who says
    how. A point of the way at which the body is already is a stop.
    """

    def __init__(
        self, ground: Ground, xy: np.ndarray, yaw: float, by: str = "policy", way: Sequence[np.ndarray] = ()
    ) -> None:
        self.ground, self.xy, self.yaw, self.by, self.way = ground, np.array(xy), yaw, by, list(way)
        self._policy = Policy(Camera().step)
        self._heading: float | None = None  # of the straight part that is under way
        self._left = self._waits = 0.0  # metres of it; seconds of a stop

    @property
    def position(self) -> np.ndarray:
        """The camera ``(3,)``, world frame."""
        return np.array([*self.xy, Camera().height + self.ground.height(self.xy)])

    def steer(self, forward: float, turn: float, seconds: float) -> None:
        """What the person has steered, m/s and rad/s to the left, and how long; the body stands without it."""
        if self.by == "person":
            self._turn(float(np.clip(turn, -QUICKEST, QUICKEST)) * seconds)
            self._advance(float(np.clip(forward, -FASTEST, FASTEST)) * seconds)

    def drive(self, by: str) -> None:
        """Hand over to "policy", "person" or "tour"."""
        if by != self.by:
            self.by, self._heading, self._policy = by, None, Policy(Camera().step)

    def move(self, seconds: float, direction: np.ndarray | None, arrived: bool) -> None:
        """Let time pass; `direction` ``(3,)``: the answer, body frame, or None: it looks around, or waits for it."""
        seconds = min(seconds, LATE)
        if self.by == "person" or (self.by == "policy" and arrived):
            return
        if direction is None:
            self._turn(TURN / 2 * seconds * (self.by == "policy"))
            return
        if self._heading is None and not self._begin(seconds, direction):
            return
        assert self._heading is not None
        off = math.remainder(self._heading - self.yaw, math.tau)
        turned = min(abs(off), TURN * seconds)
        self._turn(math.copysign(turned, off))
        metres = min(self._left, SPEED * (seconds - turned / TURN))
        self._advance(metres)
        self._left -= metres
        if self._left <= 1e-9:
            self._heading = None

    def _begin(self, seconds: float, direction: np.ndarray) -> bool:
        """Choose the next straight part; whether there is one."""
        if self.by == "policy":
            azimuth = float(azimuth_elevation(direction)[0])
            self._heading = self.yaw + self._policy.heading(azimuth, self.xy, self.yaw)
            self._left = Camera().step
            return True
        self._waits = max(0.0, self._waits - seconds)
        if self._waits or not self.way:
            return False
        ahead = self.way.pop(0) - self.xy
        if float(np.hypot(*ahead)) < HERE:
            self._waits = STOP
            return False
        self._heading, self._left = math.atan2(ahead[1], ahead[0]), float(np.hypot(*ahead))
        return True

    def _advance(self, metres: float) -> None:
        """Go ahead (back, if negative), sliding along walls."""
        if metres:
            self.xy, _ = self.ground.move(self.xy, metres * np.array([math.cos(self.yaw), math.sin(self.yaw)]))

    def _turn(self, angle: float) -> None:
        self.yaw = math.remainder(self.yaw + angle, math.tau)


class _Poses:
    """The poses of a walk, as a source of odometry; the body moves while they are read."""

    def __init__(self, walk: Walk) -> None:
        self._walk = walk

    def __iter__(self) -> Iterator[Pose]:
        while not self._walk.closed.wait(POSES):
            if (pose := self._walk.step()) is not None:
                yield pose

    def close(self) -> None:
        """The walk ends with its pictures."""
        self._walk.close()


class Walk:
    """A `CameraSource`, a `PoseSource` (`poses`) and a sink of the loop, whose first answer the policy follows.

    `query`: what there is to look for; `names`: what can be asked for without doubt. It has a `clock` of its own, which
    stands still while it is paused.
    """

    live, latency, dropped, problem = True, 0.0, 0, None

    def __init__(self, seed: int, drive: str = "", rows: int | None = None) -> None:
        self.seed, self._rows = seed, rows
        self.place = load_place(APARTMENT, seed, Camera().radius)
        self.names = tuple(sorted(str(name) for name in self.place.nameable().values()))
        self.clock, self.closed, self.poses = WalkClock(), threading.Event(), _Poses(self)
        self.grid = ErpGrid(rows or MOVING_ROWS, 2 * (rows or MOVING_ROWS))
        toured = seed == TOUR_SEED and bool(self._named(TOUR_QUERY))  # apartments of another version have another one
        drive = drive or ("tour" if toured else "policy")
        self.query, self.walker = self._tour() if drive == "tour" and toured else self._episode(drive)
        self._lock = threading.Lock()  # the person steers from another thread than time passes in
        # The first picture takes seconds, for its light.
        self.place.renderer.panorama(self.walker.position, np.eye(3), 32, range=False, ids=False)
        self._moved = now = self.clock.now()
        self._pose = Pose(now, world_R_body(self.walker.yaw), self.walker.position)
        self._direction: np.ndarray | None = None
        self._looks, self._arrived = 0, False
        self._asked: str | None = None  # what `_targets`, `_way` and `_hidden` are about
        self._targets: list[int] = []
        self._way: DistanceField | None = None
        self._hidden: float | None = None  # since when a wall hides the thing

    def _tour(self) -> tuple[str, Walker]:
        way = [np.array(point.split(","), dtype=float) for point in TOUR.split()]
        ahead = self.place.scene.instances[self._named(TOUR_QUERY)[0]].centre[:2] - way[0]
        yaw = math.atan2(ahead[1], ahead[0])
        return TOUR_QUERY, Walker(self.place.ground, way[0], yaw, "tour", [*way[1:], *reversed(way)])

    def _episode(self, drive: str) -> tuple[str, Walker]:
        number = self.seed % PER_PLACE
        spec = EpisodeSpec("navigation", APARTMENT, self.seed, number, number)
        found = navigation.plan(spec, Camera(), NavigationRules())
        return str(found.query), Walker(self.place.ground, np.array(found.start), found.yaw, drive)

    def _named(self, query: str) -> list[int]:
        """The things that a query names; none if it names nothing that is known here."""
        things = self.place.scene.instances
        try:
            return matching(parse_query(query, {thing.category for thing in things}), things)
        except QueryError:
            return []

    def __iter__(self) -> Iterator[Frame]:
        """A picture whenever the body has moved, a finer one once it stands, and that again for further looks."""
        shown: Pose | None = None
        picture, rows, last, due = np.zeros(0), 0, -math.inf, -math.inf
        while not self.closed.wait(POSES / 4):
            pose, now = self._pose, self.clock.now()
            moved = shown is None or not _same(pose, shown)
            rests = self.clock.paused or now - self._moved > RESTED
            wanted = self._rows or (FINE_ROWS if rests else MOVING_ROWS)
            if moved or wanted > rows:
                assert pose.position is not None
                found = self.place.renderer.panorama(pose.position, pose.world_R_body, wanted, range=False, ids=False)
                picture, rows = np.asarray(found.rgb), wanted
            elif now < due:
                continue
            shown, due, last = pose, now + STILL, max(pose.stamp, last + TICK)
            yield Frame(last, picture, f"apartment {self.seed}")
            self.closed.wait(PICTURES - POSES / 4)

    def close(self) -> None:
        self.closed.set()

    def step(self) -> Pose | None:
        """Let the body move until now; its pose, or None while the walk is paused."""
        with self._lock:
            now = self.clock.now()
            if now <= self._pose.stamp:
                return None
            known = None if self.walker.by == "tour" and self._looks < SURE else self._direction
            self.walker.move(now - self._pose.stamp, known, self._arrived)
            pose = Pose(now, world_R_body(self.walker.yaw), self.walker.position)
            self._moved = self._moved if _same(pose, self._pose) else now
            self._pose = pose
            return pose

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """As a sink of the loop: the policy follows its first answer."""
        self._looks += isinstance(event, EvidenceCame)
        if answers:
            self._direction = answers[0].direction

    def drive(self, by: str, forward: float = 0.0, turn: float = 0.0, seconds: float = 0.0) -> None:
        """Who moves the body; and how the person has moved it (`Walker.steer`)."""
        with self._lock:
            self.walker.drive(by)
            if not self.clock.paused:
                self.walker.steer(forward, turn, seconds)

    def pause(self, on: bool) -> None:
        """Let time stand still, or go on."""
        self.clock.pause(on)

    def truth(self, query: str, body_R_world: np.ndarray) -> tuple[np.ndarray | None, dict[str, Any] | None]:
        """The true direction ``(3,)`` of the nearest thing that a query names, body frame, and the way to it.

        None if it names nothing here. The way has the thing's place ``(2,)``, the metres left, and says whether a wall
        hides it.
        """
        if query != self._asked:
            self._asked, self._targets, self._arrived, self._hidden = query, self._named(query), False, None
            ways = [self.place.ground.footprint(self.place.scene.instances[index]) for index in self._targets]
            self._way = ways[0].union(*ways[1:]) if ways else None
        if self._way is None:
            return None, None
        here, now = self.walker.position, self.clock.now()
        centres = np.array([self.place.scene.instances[index].centre for index in self._targets])
        nearest = centres[int(np.linalg.norm(centres - here, axis=1).argmin())]
        left = float(self._way.distance(here[:2]))
        self._arrived = left < NavigationRules().success_distance
        hidden = walled(self.place.ground, here[:2], nearest[:2])
        self._hidden = (now if self._hidden is None else self._hidden) if hidden else None
        words = f"{left:.1f} m of walking left." if math.isfinite(left) else "No way leads there on foot."
        if self._hidden is not None:
            words = f"A wall has hidden the {query} for {now - self._hidden:.0f} s. {words}"
        elif self.walker.by == "tour":
            words = f"The {query} is in sight."
        elif self._arrived:
            words = "Reached."
        away = nearest - here
        goal = {"position": nearest[:2], "metres": left, "words": words}
        return body_R_world @ (away / max(float(np.linalg.norm(away)), 1e-9)), goal

    def targets(self, query: str) -> set[str]:
        """The names in the scene of what a query names."""
        return {self.place.scene.instances[index].name for index in self._named(query)}


def _same(one: Pose, other: Pose) -> bool:
    """Whether the body stands where it stood."""
    assert one.position is not None
    assert other.position is not None
    return bool((one.position == other.position).all() and (one.world_R_body == other.world_R_body).all())


def walled(ground: Ground, xy: np.ndarray, point: np.ndarray) -> bool:
    """Whether a wall (or a door's or a window's frame) of the plan stands between two points ``(2,)``.

    The last half metre does not count: things stand against walls.
    """
    gap = float(np.linalg.norm(point - xy))
    count = math.ceil(gap / ground.cell * 4) + 1
    line = xy + np.linspace(0.0, max(0.0, 1 - 0.5 / max(gap, 0.5)), count)[:, None] * (point - xy)
    col, row = np.floor((line - ground.origin) / ground.cell).astype(np.intp).T
    inside = (row >= 0) & (row < ground.structure.shape[0]) & (col >= 0) & (col < ground.structure.shape[1])
    return bool(np.any(np.asarray(ground.structure)[row[inside], col[inside]]))
