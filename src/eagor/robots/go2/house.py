"""Where a simulated Go2 walks: a scene with its floor, things to be asked for, and perhaps a ball that rolls about."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from eagor import worlds
from eagor.errors import QueryError, WorldError
from eagor.queries import COLOURS, Query, parse_query
from eagor.worlds.ground import Ground
from eagor.worlds.render import PAINTS, Ball
from eagor.worlds.scene import STRUCTURE, Scene
from eagor.worlds.walkable import stroll

__all__ = ["House", "RollingBall", "Thing", "load_house"]

RADIUS = 0.22  # metres: half the width of a Go2 with its legs, and some; it is longer, but turns through doors
TALL = 0.9  # metres from the floor to the top of the camera
BALL = 0.25  # metres, radius
TICK = 0.1  # seconds between the points of a ball's way
BALL_ID = 1 << 20  # among instances: no scene has as many
NEAR, FAR = 2.0, 6.0  # metres to walk to the target from where the robot starts
TRIES = 400


@dataclass(frozen=True, eq=False)
class Thing:
    """What the robot may be asked for: `id` (its instance, or `BALL_ID`), `category`, `colour`, `centre` ``(3,)``, m.

    `name`: colour and category.
    """

    id: int
    category: str
    colour: str | None
    centre: np.ndarray

    @property
    def name(self) -> str:
        """Colour and category in words."""
        return f"{self.colour} {self.category}" if self.colour else self.category


class RollingBall:
    """A ball that rolls over the floor to one random place after another, at `speed` metres per second; 0: it lies."""

    def __init__(self, ground: Ground, start: np.ndarray, speed: float, colour: str, rng: np.random.Generator) -> None:
        self.colour, self.speed = colour, speed
        self._height = ground.floor + BALL
        self._points: Iterator[np.ndarray] = stroll(ground, start, max(speed, 1e-3) * TICK, rng)
        self._way = [next(self._points)]

    def at(self, seconds: float) -> Ball:
        """The ball at a time since the start; any time, again and again."""
        place = max(0.0, seconds) / TICK if self.speed > 0 else 0.0
        while len(self._way) < place + 2:
            self._way.append(next(self._points))
        before = int(place)
        x, y = self._way[before] + (place - before) * (self._way[before + 1] - self._way[before])
        return Ball(np.array([x, y, self._height]), BALL, self.colour)


@dataclass(frozen=True, eq=False)
class House:
    """A scene and its floor for a body as wide as a Go2. `ball`: one that rolls in it, or None."""

    scene: Scene
    ground: Ground
    ball: RollingBall | None = None

    def slide(self, start: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Where a step ends: along walls, not through them."""
        return self.ground.move(start, step)[0]

    def ahead(self, xy: np.ndarray, heading: float) -> float:
        """Metres of free floor in a direction, at most 3."""
        way = np.array([math.cos(heading), math.sin(heading)])
        free, cell = 0.0, self.ground.cell
        while free < 3.0 and self.ground.is_free(xy + free * way):
            free += cell / 2
        return free

    def things(self, seconds: float = 0.0) -> tuple[Thing, ...]:
        """All that can be asked for by name, where it is at this time."""
        found = [
            Thing(index, thing.category, thing.colour, thing.centre)
            for index, thing in enumerate(self.scene.instances)
            if thing.category not in STRUCTURE
        ]
        if self.ball is not None:
            found.append(Thing(BALL_ID, "ball", self.ball.colour, self.ball.at(seconds).centre))
        return tuple(found)

    def targets(self, query: str) -> tuple[Thing, ...]:
        """The things that a query names. Raises `QueryError`, which lists what there is, if it names none."""
        things = self.things()
        asked = parse_query(query, {thing.category for thing in things})
        found = tuple(thing for thing in things if asked.matches(thing))
        if not found:
            count = Counter(thing.name for thing in things)
            raise QueryError(f"there is no {asked} in {self.scene.source}; it has {', '.join(sorted(count))}")
        return found

    def start(self, rng: np.random.Generator, targets: tuple[Thing, ...] = ()) -> tuple[float, float, float]:
        """A place and a heading to start from; with `targets`, some metres of walking from the nearest of them."""
        instances = self.scene.instances
        fields = [
            self.ground.field(thing.centre[:2]) if thing.id == BALL_ID else self.ground.footprint(instances[thing.id])
            for thing in targets
        ]
        way = fields[0].union(*fields[1:]) if len(fields) > 1 else (fields[0] if fields else None)
        roomy = min(0.35, float(self.ground.clearance[self.ground.free].max()))
        spot = self.ground.sample(rng, roomy)
        for _ in range(TRIES if way is not None else 0):
            if NEAR <= float(way.distance(spot)) <= FAR:  # type: ignore[union-attr]
                break
            spot = self.ground.sample(rng, roomy)
        return float(spot[0]), float(spot[1]), float(rng.uniform(-math.pi, math.pi))


def load_house(
    world: str, seed: int, *, ball: str | None = None, speed: float = 0.0, rng: np.random.Generator | None = None
) -> House:
    """The scene of this seed in the world that `eagor.worlds.load` finds, with a ball of a colour if one is asked for.

    `rng` draws the ball's way. Raises `WorldError` if there is no such world, or no room in it; `QueryError` for a ball
    of another colour.
    """
    if ball is not None and ball not in PAINTS:
        raise QueryError(f"there is no {ball} ball; balls are {', '.join(sorted(PAINTS))}")
    if seed < 0:
        raise WorldError(f"seed = {seed}; wanted 0 or a positive whole number")
    scene = worlds.load(world)(seed)
    if not isinstance(scene, Scene):
        raise WorldError(
            f"a simulated Go2 walks among triangles, but {scene.source} is held by another simulator; give it an "
            "apartment or a GLB file"
        )
    ground = Ground.from_scene(scene, radius=RADIUS, height=TALL)
    rolling = None
    if ball is not None:
        rng = rng or np.random.default_rng(seed)
        rolling = RollingBall(ground, ground.sample(rng, BALL), speed, ball, rng)
    return House(scene, ground, rolling)


def ball_of(target: str | None) -> str | None:
    """The colour of the ball that a query asks for, or None if it asks for none: "red ball" is "red"."""
    if target is None or "ball" not in target.lower().split():
        return None
    asked: Query = parse_query(target, {"ball"})
    assert asked.colour is None or asked.colour in COLOURS
    return asked.colour or "red"
