"""Where a simulated Go2 walks: a scene with its floor, things to be asked for, perhaps a ball that rolls about.

And its camera there, whose pictures a process of its own draws and sends where the robot is on DDS, as drawing must not
hold up 200 states per second.
"""

from __future__ import annotations

import math
import signal
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from eagor._checks import require, whole, within
from eagor._processes import Worker, WorkerEnded, WorkerSilent
from eagor.errors import DeviceError, EagorError, QueryError, WorldError
from eagor.lab import worlds
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.navmesh import stroll
from eagor.lab.worlds.render import PAINTS, Ball, Renderer, with_ball
from eagor.lab.worlds.scene import STRUCTURE, Instance, Scene
from eagor.queries import matching, parse_query
from eagor.robots.dds import Link, Raw
from eagor.robots.go2.camera import PICTURE, picture_message

__all__ = [
    "CAMERA_FRAME", "CAMERA_TOPIC", "CameraSettings", "PictureProcess", "RenderRequest", "SimWorld", "clear_start",
    "panorama",
]  # fmt: skip

RADIUS = 0.22  # metres: half the width of a Go2 with its legs, and some; it is longer, but turns through doors
TALL = 0.9  # metres from the floor to the top of the camera
BALL = 0.25  # metres, radius
TICK = 0.1  # seconds between the points of a ball's way
BALL_ID = 1 << 20  # among instances: no scene has as many
TRIES, ROOM, NEAR, FAR = 2000, 0.35, 2.5, 5.0  # draws; metres around the start; metres to the target
BEFORE = 1.0  # metres before the target's centre at which the way may end: things fill some floor


class SimWorld:
    """A `scene` and its `ground` for a body as wide as a Go2: the one of this seed in a world of `eagor.lab.worlds`.

    `target`: what is to be found there, in words, if anything: a "red ball" is brought along, and rolls from one random
    place to another at `speed` metres per second, as `rng` draws them. Raises `WorldError` if there is no such world,
    or no room in it; `QueryError` for a target that is not there, which lists what is.
    """

    def __init__(
        self, world: str, seed: int, target: str | None = None, speed: float = 0.0,
        rng: np.random.Generator | None = None,
    ) -> None:  # fmt: skip
        if seed < 0:
            raise WorldError(f"seed = {seed}; wanted 0 or a positive whole number")
        asks_ball = target is not None and "ball" in target.lower().split()
        self.ball = (parse_query(target or "", {"ball"}).colour or "red") if asks_ball else None
        if self.ball not in (None, *PAINTS):
            raise QueryError(f"there is no {self.ball} ball; balls are {', '.join(sorted(PAINTS))}")
        scene = worlds.load(world)(seed)
        if not isinstance(scene, Scene):
            raise WorldError(
                f"a simulated Go2 walks among triangles, but {scene.source} is held by another simulator; give it an "
                "apartment or a GLB file"
            )
        self.scene, self.target, self.speed = scene, target, speed
        self.ground = Ground.from_scene(scene, radius=RADIUS, height=TALL)
        if self.ball is not None:
            rng = rng or np.random.default_rng(seed)
            self._points = stroll(self.ground, self.ground.sample(rng, BALL), max(speed, 1e-3) * TICK, rng)
            self._way = [next(self._points)]
        self.targets()

    def move_and_slide(self, start: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Where a step ends: along walls, not through them."""
        return self.ground.move(start, step)[0]

    def ball_at(self, seconds: float) -> Ball | None:
        """The ball at a time since the start, if there is one; any time, again and again."""
        if self.ball is None:
            return None
        place = max(0.0, seconds) / TICK if self.speed > 0 else 0.0
        while len(self._way) < place + 2:
            self._way.append(next(self._points))
        before = int(place)
        x, y = self._way[before] + (place - before) * (self._way[before + 1] - self._way[before])
        return Ball(np.array([x, y, self.ground.floor + BALL]), BALL, self.ball)

    def things(self, seconds: float = 0.0) -> list[Instance]:
        """All that can be asked for by name, where it is at this time."""
        found = [each for each in self.scene.instances if each.category not in STRUCTURE]
        if (ball := self.ball_at(seconds)) is not None:
            found.append(Instance("ball", ball.colour, None, ball.centre - BALL, ball.centre + BALL))
        return found

    def targets(self, seconds: float = 0.0) -> list[Instance]:
        """The things that the target names, where they are at this time; none without a target."""
        if self.target is None:
            return []
        things = self.things(seconds)
        asked = parse_query(self.target, {thing.category for thing in things})
        if not (found := [things[index] for index in matching(asked, things)]):
            names = sorted({thing.name for thing in things})
            raise QueryError(f"there is no {asked} in {self.scene.source}; it has {', '.join(names)}")
        return found


def clear_start(
    house: SimWorld, targets: Sequence[Instance], rng: np.random.Generator
) -> tuple[float, float, float] | None:
    """A place (x, y in metres) and a heading (radians) some metres from a target, with a straight way there.

    The policy goes straight, and around nothing. Any place without targets; None if no such place was found.
    """
    ground = house.ground
    for _ in range(TRIES):
        spot = ground.sample(rng, min(ROOM, float(ground.clearance[ground.free].max())))
        clear = not targets
        for way in [thing.centre[:2] - spot for thing in targets]:
            if NEAR <= (far := float(np.hypot(*way))) <= FAR:
                steps = np.arange(0.0, far - BEFORE, ground.cell / 2)[:, None] * way / far
                clear = clear or bool(ground.is_free(spot + steps).all())
        if clear:
            return float(spot[0]), float(spot[1]), float(rng.uniform(-math.pi, math.pi))
    return None


# --- its camera -------------------------------------------------------------------------------------------------------

CAMERA_TOPIC = "rt/x3/image/compressed"  # /x3/image/compressed in ROS
CAMERA_FRAME = "x3_link"
MOUNT = (0.0, 0.0, 0.40)  # metres from the body's centre to the camera, body frame: a short stick on its back
LOADING = 300.0  # seconds for the scene and its light
ENDING = 5.0  # seconds for the process to leave by itself


@dataclass(frozen=True)
class CameraSettings:
    """A simulated panoramic camera.

    `rows`: of its panoramas. `rate`: pictures per second. `latency`: seconds from capture to arrival. `mount` ``(3,)``:
    where it is on the body, metres.
    """

    rows: int = 128
    rate: float = 5.0
    latency: float = 0.15
    mount: tuple[float, float, float] = MOUNT

    def __post_init__(self) -> None:
        fields = {
            "rows": (whole(self.rows, 16, 4096) and self.rows % 2 == 0, "an even number of rows, 16 to 4096"),
            "rate": (within(self.rate, 0.01, 60), "0.01 to 60 pictures per second"),
            "latency": (within(self.latency, 0, 60), "0 to 60 s"),
        }
        require(self, fields, DeviceError)


class RenderRequest(NamedTuple):
    """When and where a picture is taken: the host's clock, the camera's place and rotation, the ball."""

    stamp: float
    position: np.ndarray
    world_R_body: np.ndarray
    ball: Ball | None = None


def panorama(renderer: Renderer, request: RenderRequest, rows: int) -> np.ndarray:
    """The panorama ``(rows, 2 rows, 3)`` uint8 that the camera takes, with the ball where there is one."""
    _, at, turned, ball = request
    seen = renderer.panorama(at, turned, rows, range=ball is not None, ids=False)
    if ball is not None:
        seen = with_ball(seen, at, turned, ball, BALL_ID)
    assert seen.rgb is not None
    return seen.rgb


class PictureProcess:
    """A process with a renderer of its own, which writes `CAMERA_TOPIC`; it ends with this one.

    Raises `DeviceError` if it cannot draw.
    """

    def __init__(self, world: str, seed: int, camera: CameraSettings, domain: int, interface: str | None) -> None:
        self.skipped = self.drawn = 0
        self._worker = Worker(_draw, world, seed, camera, domain, interface)
        self._idle = True

    def wait(self) -> None:
        """Wait until it can draw."""
        try:
            self._worker.receive(LOADING)
        except WorkerEnded:
            code = self._worker.close(ENDING)
            raise DeviceError(f"the camera's process ended by itself (exit code {code})") from None
        except WorkerSilent:
            raise DeviceError(f"the camera is not ready after {LOADING:g} s") from None

    def offer(self, request: RenderRequest) -> None:
        """Have this picture drawn, unless another one still is: then it is `skipped`. Never waits."""
        try:
            while self._worker.line.poll():
                self.drawn += self._worker.receive()
                self._idle = True
            if self._idle:
                self._worker.send(request)
        except (WorkerEnded, OSError, EagorError):
            pass  # nothing more comes; `alive` says so
        self.skipped += not self._idle
        self._idle = False

    @property
    def alive(self) -> bool:
        """Whether it still draws."""
        return self._worker.alive

    def close(self) -> None:
        """End the process."""
        self._worker.close(ENDING)


def _draw(line: Connection, world: str, seed: int, camera: CameraSettings, domain: int, interface: str | None) -> None:
    """The life of the process."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends with its parent, which is told as well
    scene = worlds.load(world)(seed)
    assert isinstance(scene, Scene)  # `SimWorld` takes no other
    renderer = Renderer(scene)
    panorama(renderer, RenderRequest(0.0, np.zeros(3), np.eye(3)), camera.rows)  # the light, and what else comes first
    with Link(domain, interface) as link:
        writer = link.publish(CAMERA_TOPIC, PICTURE, reliable=False)
        waiting: deque[tuple[float, Raw]] = deque()  # pictures on their way: when they arrive
        line.send(0)
        while True:
            if line.poll(max(0.0, waiting[0][0] - time.time()) if waiting else None):
                request: RenderRequest = line.recv()
                message = picture_message(panorama(renderer, request, camera.rows), request.stamp, CAMERA_FRAME)
                waiting.append((request.stamp + camera.latency, message))
                line.send(1)
            while waiting and waiting[0][0] <= time.time():
                writer.write(waiting.popleft()[1])
