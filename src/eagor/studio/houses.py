"""An apartment as a walk knows it (its ground, its things, its plan, where to begin), and the body that moves in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eagor.errors import QueryError
from eagor.lab.agents.steering import Policy
from eagor.lab.envs.episodes import PER_PLACE, EpisodeSpec
from eagor.lab.envs.places import APARTMENT, Place, load_place
from eagor.lab.envs.rules import Camera, NavigationRules
from eagor.lab.tasks.sim import navigation
from eagor.lab.worlds.navmesh import NavMesh
from eagor.lab.worlds.scene import STRUCTURE, Instance
from eagor.queries import matching, parse_query
from eagor.sphere import azimuth_elevation, world_R_body
from eagor.studio.messages import LATE, SEED, rounded

__all__ = ["Body", "House", "Tour", "Walker", "house_of", "place_of", "plan_of", "walled"]

# The first walk, in the apartment `SEED`: `docs/figures/studio.py choose` says by which rule it is chosen.
TOUR = "purple sofa", "2.78,1.93 4.03,4.18 4.18,4.28 4.48,4.28 5.38,3.43 6.53,3.13 6.98,3.13"


@dataclass(frozen=True, eq=False)
class Tour:
    """The first walk: what it looks for, points ``(2,)`` of the `way` there and back, and the `yaw` to begin with."""

    query: str
    way: tuple[np.ndarray, ...]
    yaw: float

    @classmethod
    def to(cls, query: str, thing: np.ndarray, way: Sequence[np.ndarray]) -> Tour:
        """It faces the `thing` ``(3,)``, walks along the way, stops at its end, and walks back."""
        ahead = thing[:2] - way[0]
        return cls(query, (*way, *reversed(way)), math.atan2(ahead[1], ahead[0]))


@dataclass(frozen=True, eq=False)
class House:
    """An apartment as a session needs it: it can be pickled, and renders nothing.

    `names`: what can be asked for without doubt; `start` ``(2,)``, `yaw` and `query` of an episode in it; `tour`: the
    first walk, if it is the apartment for that.
    """

    seed: int
    ground: NavMesh
    things: tuple[Instance, ...]
    names: tuple[str, ...]
    start: np.ndarray
    yaw: float
    query: str
    plan: dict[str, Any]
    tour: Tour | None = None

    def targets(self, query: str) -> list[int]:
        """The things that a query names; none if it names nothing that is known here."""
        try:
            asked = parse_query(query, {thing.category for thing in self.things})
        except QueryError:
            return []
        return matching(asked, self.things)


def place_of(seed: int) -> Place:
    """The apartment itself, with its renderer."""
    return load_place(APARTMENT, seed, Camera().radius)


def house_of(seed: int, place: Place) -> House:
    """The apartment `place`, of this seed, for a session. Raises `WorldError` if nobody can walk to anything in it."""
    number = seed % PER_PLACE
    episode = navigation.plan(EpisodeSpec("navigation", APARTMENT, seed, number, number), Camera(), NavigationRules())
    found = House(
        seed,
        replace(place.ground),  # type: ignore[type-var]  # without what it keeps for itself, so that it can be pickled
        tuple(place.scene.instances),
        tuple(sorted(str(name) for name in place.nameable().values())),
        np.array(episode.start),
        episode.yaw,
        str(episode.query),
        plan_of(place.ground, place.scene.instances),
    )
    if seed != SEED:
        return found
    query, points = TOUR
    way = [np.array(point.split(","), dtype=float) for point in points.split()]
    return replace(found, tour=Tour.to(query, np.asarray(found.things[found.targets(query)[0]].centre), way))


def plan_of(ground: NavMesh, things: Any) -> dict[str, Any]:
    """The plan from above, metres: walls and floor as closed polylines, things as boxes."""
    origin, cell = np.asarray(ground.origin), ground.cell
    return {
        "walls": [_metres(line, origin, cell) for line in outlines(ground.structure)],
        "floor": [_metres(line, origin, cell) for line in outlines(ground.free)],
        "things": [
            {"name": thing.name, "low": rounded(thing.low[:2], 3), "high": rounded(thing.high[:2], 3)}
            for thing in things
            if thing.category not in (*STRUCTURE, "ceiling lamp", "rug", "curtain")
        ],
    }


def walled(ground: NavMesh, xy: np.ndarray, point: np.ndarray) -> bool:
    """Whether a wall (or a door's or a window's frame) of the plan stands between two points ``(2,)``.

    The last half metre does not count: things stand against walls.
    """
    gap = float(np.linalg.norm(point - xy))
    count = math.ceil(gap / ground.cell * 4) + 1
    line = xy + np.linspace(0.0, max(0.0, 1 - 0.5 / max(gap, 0.5)), count)[:, None] * (point - xy)
    col, row = np.floor((line - ground.origin) / ground.cell).astype(np.intp).T
    inside = (row >= 0) & (row < ground.structure.shape[0]) & (col >= 0) & (col < ground.structure.shape[1])
    return bool(np.any(np.asarray(ground.structure)[row[inside], col[inside]]))


def outlines(mask: np.ndarray) -> list[np.ndarray]:
    """The borders of the True cells of a mask ``(rows, cols)`` as closed lines ``(n, 2)`` of corners (column, row).

    Borders have the True cells on their left; at corners where two of them touch, they stay apart.
    """
    grid = np.pad(np.asarray(mask, dtype=bool), 1)
    follows: dict[tuple[int, int], list[tuple[int, int]]] = {}
    # Each edge between a True and a False cell, directed; (row, column) of a cell's low corner is its own index - 1.
    for rows, cols, begin, end in (
        (*np.nonzero(grid[1:-1, 1:-1] & ~grid[:-2, 1:-1]), (0, 0), (1, 0)),
        (*np.nonzero(grid[1:-1, 1:-1] & ~grid[2:, 1:-1]), (1, 1), (0, 1)),
        (*np.nonzero(grid[1:-1, 1:-1] & ~grid[1:-1, 2:]), (1, 0), (1, 1)),
        (*np.nonzero(grid[1:-1, 1:-1] & ~grid[1:-1, :-2]), (0, 1), (0, 0)),
    ):
        for row, col in zip(rows.tolist(), cols.tolist(), strict=True):
            follows.setdefault((col + begin[0], row + begin[1]), []).append((col + end[0], row + end[1]))
    lines = []
    while follows:
        start = here = next(iter(follows))
        line, ahead = [start], (0, 0)
        while True:
            choices = follows[here]
            # Where two borders touch, turn left: the cells on the left belong together.
            left = (here[0] - ahead[1], here[1] + ahead[0])
            there = left if left in choices else choices[0]
            choices.remove(there)
            if not choices:
                del follows[here]
            ahead, here = (there[0] - here[0], there[1] - here[1]), there
            line.append(here)
            if here == start:
                break
        lines.append(_straight(np.array(line)))
    return lines


def _straight(line: np.ndarray) -> np.ndarray:
    """A closed line without the points in the middle of straight stretches."""
    steps = np.diff(line, axis=0)
    turns = np.any(steps != np.roll(steps, 1, axis=0), axis=1)
    kept = line[:-1][turns]
    return np.concatenate([kept, kept[:1]])


def _metres(line: np.ndarray, origin: np.ndarray, cell: float) -> list[list[float]]:
    return rounded(origin + line * cell, 3)


STOP, HERE = 5.0, 0.05  # seconds of a stop on a way, and metres from a point at which the body is there
SPEED, TURN = 0.5, math.radians(75)  # metres and radians per second, of the policy
FASTEST, QUICKEST = 1.2, math.radians(150)  # of the person


@dataclass
class Body:
    """A round body with a camera on the ground of a house; x, y in metres, yaw in radians."""

    ground: NavMesh
    xy: np.ndarray
    yaw: float
    height: float = Camera().height
    walked: float = 0.0

    @property
    def position(self) -> np.ndarray:
        """The camera ``(3,)``, world frame."""
        return np.array([*self.xy, self.height + self.ground.height(self.xy)])

    @property
    def world_R_body(self) -> np.ndarray:
        return world_R_body(self.yaw)

    def advance(self, metres: float) -> None:
        """Go ahead (back, if negative), sliding along walls."""
        if metres == 0:
            return
        ahead = metres * np.array([math.cos(self.yaw), math.sin(self.yaw)])
        before = self.xy
        self.xy, _ = self.ground.move(self.xy, ahead)
        self.walked += float(np.hypot(*(self.xy - before)))


@dataclass
class Walker:
    """Moves a body: `by` the policy or along a `way` ("tour") as time passes, or by the person, who says how.

    A point of the way at which the body is already is a stop.
    """

    body: Body
    by: str = "policy"
    way: list[np.ndarray] = field(default_factory=list)  # points ``(2,)`` that are still to come
    policy: Policy = field(default_factory=lambda: Policy(Camera().step))
    _heading: float | None = None  # of the straight part that is under way
    _left: float = 0.0  # metres of it
    _waits: float = 0.0  # seconds of a stop that are left
    _stood: tuple[float, ...] = field(init=False)  # where it stood when it was last asked

    def __post_init__(self) -> None:
        self._stood = (*self.body.xy, self.body.yaw)

    def steer(self, forward: float, turn: float, seconds: float) -> None:
        """What the person has steered: m/s and rad/s (left), limited, and how long. The body stands without it."""
        if self.by == "person":
            self._turned(min(max(turn, -QUICKEST), QUICKEST) * seconds)
            self.body.advance(min(max(forward, -FASTEST), FASTEST) * seconds)

    def drive(self, by: str) -> None:
        """Hand over to "policy", "person" or "tour"."""
        if by != self.by:
            self.by, self._heading = by, None
            self.policy = Policy(self.policy.step)

    def move(self, seconds: float, direction: np.ndarray | None, arrived: bool) -> bool:
        """Let time pass; `direction` ``(3,)``: the estimate, body frame. Returns whether the body has moved since."""
        if self.by == "tour" or (self.by == "policy" and not arrived):
            self._walk(min(seconds, LATE), direction)
        before, self._stood = self._stood, (*self.body.xy, self.body.yaw)
        return before != self._stood

    def _walk(self, seconds: float, direction: np.ndarray | None) -> None:
        if direction is None:  # nothing is known: look around, or wait for the first look
            self._turned(TURN / 2 * seconds * (self.by == "policy"))
            return
        if self._heading is None and self.by == "tour":
            self._waits = max(0.0, self._waits - seconds)
            if self._waits or not self.way:
                return
            ahead = self.way.pop(0) - self.body.xy
            if float(np.hypot(*ahead)) < HERE:
                self._waits = STOP
                return
            self._heading, self._left = math.atan2(ahead[1], ahead[0]), float(np.hypot(*ahead))
        elif self._heading is None:
            azimuth = float(azimuth_elevation(direction)[0])
            self._heading = self.body.yaw + self.policy.heading(azimuth, self.body.xy, self.body.yaw)
            self._left = self.policy.step
        off = math.remainder(self._heading - self.body.yaw, math.tau)
        turned = min(abs(off), TURN * seconds)
        self._turned(math.copysign(turned, off))
        rest = seconds - turned / TURN
        if rest > 0:
            metres = min(self._left, SPEED * rest)
            self.body.advance(metres)
            self._left -= metres
            if self._left <= 1e-9:
                self._heading = None

    def _turned(self, angle: float) -> None:
        self.body.yaw = math.remainder(self.body.yaw + angle, math.tau)
