"""Where a simulated Go2 walks: a scene with its floor, things to be asked for, perhaps a ball that rolls about.

And its camera there: a simulated Insta360 X3, whose pictures a process of its own draws and sends where the robot is on
DDS, as drawing must not hold up 200 states per second.
"""

from __future__ import annotations

import math
import signal
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Literal, NamedTuple

import numpy as np

from eagor._checks import require, whole, within
from eagor._processes import Worker, WorkerEnded
from eagor._values import lazy
from eagor.errors import DeviceError, EagorError, QueryError, WorldError
from eagor.lab import worlds
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.navmesh import stroll
from eagor.lab.worlds.render import PAINTS, Ball, Renderer, with_ball
from eagor.lab.worlds.scene import STRUCTURE, Scene
from eagor.media import Pose
from eagor.queries import COLOURS, Query, parse_query
from eagor.sphere import world_R_body

__all__ = [
    "CAMERA_FRAME", "CAMERA_TOPIC", "CameraSettings", "House", "Moment", "PictureProcess", "RollingBall",
    "SimulatedCamera", "Thing", "load_house",
]  # fmt: skip

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
        return str(Query(self.category, self.colour))


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
    """The scene of this seed in a world that `eagor.lab.worlds.load` finds, with a ball of a colour if one is asked.

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


# --- its camera -------------------------------------------------------------------------------------------------------

CAMERA_TOPIC = "rt/x3/image/compressed"  # /x3/image/compressed in ROS
CAMERA_FRAME = "x3_link"
MOUNT = (0.0, 0.0, 0.40)  # metres from the body's centre to the camera, body frame: a short stick on its back
FIELD = math.radians(200.0)  # of each fisheye of an X3
LOADING = 300.0  # seconds for the scene and its light
ENDING = 5.0  # seconds for the process to leave by itself


@dataclass(frozen=True)
class CameraSettings:
    """A simulated Insta360 X3.

    `kind`: what its pictures are: "erp" (equirectangular) or "fisheye" (both circles side by side, the front one left).
    `rows`: of its panoramas, and of the circles. `rate`: pictures per second. `latency`: seconds from capture to
    arrival. `mount` ``(3,)``: where it is on the body, metres. `quality`: of the JPEG, 1 to 100.
    """

    kind: Literal["erp", "fisheye"] = "erp"
    rows: int = 128
    rate: float = 5.0
    latency: float = 0.15
    mount: tuple[float, float, float] = MOUNT
    quality: int = 90

    def __post_init__(self) -> None:
        require(
            self,
            {
                "kind": (self.kind in ("erp", "fisheye"), "erp or fisheye"),
                "rows": (whole(self.rows, 16, 4096) and self.rows % 2 == 0, "an even number of rows, 16 to 4096"),
                "rate": (within(self.rate, 0.01, 60), "0.01 to 60 pictures per second"),
                "latency": (within(self.latency, 0, 60), "0 to 60 s"),
                "quality": (whole(self.quality, 1, 100), "1 to 100"),
            },
            DeviceError,
        )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its pictures."""
        return 2 * self.rows, self.rows

    def pose(self, body: Pose) -> Pose:
        """The camera's pose on a body at this pose."""
        assert body.position is not None
        return Pose(body.stamp, body.world_R_body, body.position + body.world_R_body @ np.asarray(self.mount))


class SimulatedCamera:
    """Pictures of a scene, as the camera sends them."""

    def __init__(self, scene: Scene, settings: CameraSettings) -> None:
        self.settings = settings
        self._renderer = Renderer(scene)
        self._rig = None
        if settings.kind == "fisheye":
            from eagor.media.rigs import dual_fisheye

            self._rig = dual_fisheye(*settings.size, FIELD)

    def panorama(self, camera: Pose, ball: Ball | None = None) -> np.ndarray:
        """The panorama ``(rows, 2 rows, 3)`` uint8 from the camera's pose, with the ball where there is one."""
        return self._rendered(camera, ball, self.settings.rows)

    def picture(self, camera: Pose, ball: Ball | None = None) -> np.ndarray:
        """What it sends ``(H, W, 3)`` uint8: the panorama, or both fisheye circles."""
        if self._rig is None:
            return self.panorama(camera, ball)
        from eagor.media.stitching import seen_by

        (picture,) = seen_by(self._rig, self._rendered(camera, ball, self._rig.rows))
        return picture

    def received(self, picture: np.ndarray) -> np.ndarray:
        """The panorama ``(rows, 2 rows, 3)`` that whoever receives such a picture makes of it."""
        return picture if self._rig is None else self._stitcher.stitch(picture)

    @lazy
    def _stitcher(self):
        from eagor.media.stitching import Stitcher

        assert self._rig is not None
        return Stitcher(self._rig, self.settings.rows)

    def _rendered(self, camera: Pose, ball: Ball | None, rows: int) -> np.ndarray:
        assert camera.position is not None
        seen = self._renderer.panorama(camera.position, camera.world_R_body, rows, range=ball is not None, ids=False)
        if ball is not None:
            seen = with_ball(seen, camera.position, camera.world_R_body, ball, BALL_ID)
        assert seen.rgb is not None
        return seen.rgb


class Moment(NamedTuple):
    """When and where a picture is taken: the host's clock, the camera's pose, the ball."""

    stamp: float
    pose: Pose
    ball: Ball | None


class PictureProcess:
    """A process with a renderer of its own, which writes `CAMERA_TOPIC`.

    `offer` gives it a moment if it is idle; moments that come while it draws are `skipped`. It ends with this one.
    """

    def __init__(self, world: str, seed: int, camera: CameraSettings, domain: int, interface: str | None) -> None:
        self.skipped = self.drawn = 0
        self._idle = False
        self._worker = Worker(_draw, world, seed, camera, domain, interface)

    def wait(self, timeout: float = LOADING) -> None:
        """Wait until it can draw. Raises `DeviceError` if it cannot."""
        end = time.monotonic() + timeout
        while not self._heard() and not self._idle:
            if not self.alive and not self._worker.line.poll():
                code = self._worker.process.exitcode
                raise DeviceError(f"the camera's process ended by itself (exit code {code})")
            if time.monotonic() > end:
                raise DeviceError(f"the camera is not ready after {timeout:g} s")
            self._worker.line.poll(0.1)

    def offer(self, moment: Moment) -> bool:
        """Have a picture of this moment drawn; whether it is. Never waits."""
        self._heard()
        if not self._idle:
            self.skipped += 1
            return False
        try:
            self._worker.send(moment)
        except WorkerEnded:
            return False
        self._idle = False
        return True

    @property
    def alive(self) -> bool:
        """Whether it still draws."""
        return self._worker.alive

    def close(self) -> None:
        """End the process."""
        self._worker.close(ENDING)

    def _heard(self) -> bool:
        """Take in what it says; whether it said that it is ready for the next."""
        try:
            while self._worker.line.poll():
                self.drawn += self._worker.receive()
                self._idle = True
        except (WorkerEnded, OSError):
            pass  # nothing more comes
        except EagorError as error:
            raise DeviceError(f"the simulated camera cannot draw: {error}") from error
        return self._idle


def _draw(line: Connection, world: str, seed: int, camera: CameraSettings, domain: int, interface: str | None) -> None:
    """The life of the process."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends with its parent, which is told as well
    from eagor.media.ros_messages import COMPRESSED, compressed_message
    from eagor.robots.dds import Link

    scene = worlds.load(world)(seed)
    assert isinstance(scene, Scene)  # `load_house` takes no other
    drawer = SimulatedCamera(scene, camera)
    drawer.picture(Pose(0.0, world_R_body(0.0), np.zeros(3)))  # the light, and what else comes first
    with Link(domain, interface) as link:
        writer = link.publish(CAMERA_TOPIC, COMPRESSED, reliable=False, depth=5)
        waiting: list[tuple[float, Any]] = []  # pictures on their way: when they arrive
        line.send(0)
        while True:
            pause = max(0.0, waiting[0][0] - time.time()) if waiting else None
            if line.poll(pause):
                moment: Moment = line.recv()
                picture = drawer.picture(moment.pose, moment.ball)
                message = compressed_message(picture, moment.stamp, CAMERA_FRAME, quality=camera.quality)
                waiting.append((moment.stamp + camera.latency, message))
                line.send(1)
            while waiting and waiting[0][0] <= time.time():
                writer.write(waiting.pop(0)[1])
