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
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from eagor._checks import require, whole, within
from eagor.errors import DeviceError, QueryError, WorldError
from eagor.lab import worlds
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.render import PAINTS, Ball, Renderer, with_ball
from eagor.lab.worlds.scene import STRUCTURE, Instance, Scene
from eagor.queries import matching, parse_query
from eagor.robots.dds import Participant, Raw
from eagor.robots.go2.camera import PICTURE, picture_message
from eagor.robots.go2.state import Odometry
from eagor.sources.ros_messages import pose_from_msg

__all__ = [
    "CAMERA_FRAME", "CAMERA_TOPIC", "MOUNT", "TRUTH", "SimSettings", "SimWorld", "camera_pose", "film", "panorama",
]  # fmt: skip

RADIUS = 0.22  # metres: half the width of a Go2 with its legs, and some; it is longer, but turns through doors
TALL = 0.9  # metres from the floor to the top of the camera
BALL = 0.25  # metres, radius
TICK = 0.1  # seconds between the points of a ball's way
BALL_ID = 1 << 20  # among instances: no scene has as many
TRIES, ROOM, NEAR, FAR = 2000, 0.35, 2.5, 5.0  # draws; metres around the start; metres to the target
BEFORE = 1.0  # metres before the target's centre at which the way may end: things fill some floor

CAMERA_TOPIC = "rt/x3/image/compressed"  # /x3/image/compressed in ROS
CAMERA_FRAME = "x3_link"
MOUNT = (0.0, 0.0, 0.40)  # metres from the body's centre to the camera, body frame: a short stick on its back
TRUTH = "rt/eagor/truth"  # the true pose of the body (nav_msgs/Odometry), which no robot tells


@dataclass(frozen=True)
class SimSettings:
    """What is simulated: a robot in the house `world` (of `eagor.lab.worlds`) of this `seed`.

    - `world` None: an endless empty floor, without pictures. `start`: x, y (metres), heading (radians); None: some
      metres from the target. `upright`: whether it stands at first, or lies. `target`: what is to be found there, in
      words: a "red ball" is brought along, and rolls at `speed` metres per second.
    - The camera: `rows` of its panoramas (None: no camera), `rate` per second, `latency`: seconds from capture to
      arrival, `mount` ``(3,)``: where it is on the body, metres.
    - The robot's clock is ahead by `clock_offset` seconds at first, and gains `clock_drift` seconds per second.
      `short`: states without the planned path. `battery`: per cent at the start.
    """

    world: str | None = "apartment"
    seed: int = 7
    target: str | None = None
    speed: float = 0.0
    start: tuple[float, float, float] | None = None
    upright: bool = True
    rows: int | None = 128
    rate: float = 5.0
    latency: float = 0.15
    mount: tuple[float, float, float] = MOUNT
    clock_offset: float = 0.0
    clock_drift: float = 0.0
    short: bool = False
    battery: int = 87

    def __post_init__(self) -> None:
        even = self.rows is None or (whole(self.rows, 16, 4096) and self.rows % 2 == 0)
        fields = {
            "seed": (whole(self.seed, 0), "0 or a positive whole number"),
            "rows": (even, "an even number of rows, 16 to 4096"),
            "rate": (within(self.rate, 0.01, 60), "0.01 to 60 pictures per second"),
            "latency": (within(self.latency, 0, 60), "0 to 60 s"),
            "clock_offset": (within(self.clock_offset, -1e8, 1e8), "seconds"),
        }
        require(self, fields, DeviceError)


class SimWorld:
    """The `scene` of these settings, and its `ground` for a body as wide as a Go2.

    `things`: all that can be asked for by name; `targets`: those that the target names. A ball rolls from where it is
    listed to one random place after another. Raises `WorldError` if there is no such world, or no room in it;
    `QueryError` for a target that is not there, which lists what is.
    """

    def __init__(self, settings: SimSettings) -> None:
        target, self._speed = settings.target, settings.speed
        self._colour: str | None = None  # of the ball
        if target is not None and "ball" in target.lower().split():
            self._colour = parse_query(target, {"ball"}).colour or "red"
            if self._colour not in PAINTS:
                raise QueryError(f"there is no {self._colour} ball; balls are {', '.join(sorted(PAINTS))}")
        scene = worlds.load(settings.world or "")(settings.seed)
        if not isinstance(scene, Scene):
            raise WorldError(
                f"a simulated Go2 walks among triangles, but {scene.source} is held by another simulator; give it an "
                "apartment or a GLB file"
            )
        self.scene, self.ground = scene, Ground.from_scene(scene, radius=RADIUS, height=TALL)
        self.things = [each for each in scene.instances if each.category not in STRUCTURE]
        if self._colour is not None:
            rng = np.random.default_rng(np.random.SeedSequence(settings.seed).spawn(1)[0])
            self._points = self.ground.stroll(self.ground.sample(rng, BALL), max(self._speed, 1e-3) * TICK, rng)
            self._way = [next(self._points)]
        if (ball := self.ball_at(0.0)) is not None:
            self.things.append(Instance("ball", ball.colour, None, ball.centre - BALL, ball.centre + BALL))
        self.targets: list[Instance] = []
        if target is not None:
            asked = parse_query(target, {thing.category for thing in self.things})
            self.targets = [self.things[index] for index in matching(asked, self.things)]
            if not self.targets:
                names = sorted({thing.name for thing in self.things})
                raise QueryError(f"there is no {asked} in {scene.source}; it has {', '.join(names)}")

    def move_and_slide(self, start: np.ndarray, step: np.ndarray) -> np.ndarray:
        return self.ground.move(start, step)[0]

    def ball_at(self, seconds: float) -> Ball | None:
        """The ball at a time since the start, if there is one; any time, again and again."""
        if self._colour is None:
            return None
        place = max(0.0, seconds) / TICK if self._speed > 0 else 0.0
        while len(self._way) < place + 2:
            self._way.append(next(self._points))
        before = int(place)
        x, y = self._way[before] + (place - before) * (self._way[before + 1] - self._way[before])
        return Ball(np.array([x, y, self.ground.floor + BALL]), BALL, self._colour)

    def clear_start(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """A place (x, y in metres) and a heading (radians) some metres from a target, with a straight way there.

        The policy goes straight, and around nothing. Any place where there is none, and without a target.
        """
        room = min(ROOM, float(self.ground.clearance[self.ground.free].max()))
        spots = (self.ground.sample(rng, room) for _ in range(TRIES if self.targets else 0))
        clear = (spot for spot in spots if any(self._leads(spot, thing.centre[:2]) for thing in self.targets))
        spot = next(clear, None)
        x, y = self.ground.sample(rng, room) if spot is None else spot
        return float(x), float(y), float(rng.uniform(-math.pi, math.pi))

    def _leads(self, spot: np.ndarray, target: np.ndarray) -> bool:
        """Whether a target is some metres away, and the straight way there is free."""
        way = target - spot
        if not NEAR <= (far := float(np.hypot(*way))) <= FAR:
            return False
        steps = np.arange(0.0, far - BEFORE, self.ground.cell / 2)[:, None] * way / far
        return bool(self.ground.is_free(spot + steps).all())


# --- its camera -------------------------------------------------------------------------------------------------------


def panorama(
    renderer: Renderer, rows: int, position: np.ndarray, world_R_body: np.ndarray, ball: Ball | None = None
) -> np.ndarray:
    """The panorama ``(rows, 2 rows, 3)`` uint8 that the camera takes there, with the ball where there is one."""
    seen = renderer.panorama(position, world_R_body, rows, range=ball is not None, ids=False)
    if ball is not None:
        seen = with_ball(seen, position, world_R_body, ball, BALL_ID)
    assert seen.rgb is not None
    return seen.rgb


def film(line: Connection, settings: SimSettings, domain: int, interface: str | None) -> None:
    """The life of the camera's process: pictures of the house, from where the robot truly is.

    On the `line`: it says when it can draw, and hears when the robot began, seconds of this machine's clock.
    """
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends with its parent, which is told as well
    world, newest, rows = SimWorld(settings), deque[Any](maxlen=1), settings.rows or 0
    renderer = Renderer(world.scene)
    panorama(renderer, rows, np.zeros(3), np.eye(3))  # the light, and what else comes first
    # Pictures that are on their way arrive before the link closes.
    with Participant(domain, interface) as link, ThreadPoolExecutor(1) as sender:
        writer = link.publish(CAMERA_TOPIC, PICTURE, reliable=False)
        link.subscribe(TRUTH, Odometry, lambda message, _: newest.append(message))

        def send(message: Raw, when: float) -> None:
            time.sleep(max(0.0, when - time.time()))
            writer.write(message)

        line.send(None)
        begun, due = line.recv(), time.time()
        while not line.poll(max(0.0, due - time.time())):
            if not newest:
                due = time.time() + 0.01
                continue
            stamp, at, turned = camera_pose(newest.pop(), settings.mount)
            picture = panorama(renderer, rows, at, turned, world.ball_at(stamp - begun))
            sender.submit(send, picture_message(picture, stamp, CAMERA_FRAME), stamp + settings.latency)
            due = max(due + 1 / settings.rate, time.time())


def camera_pose(truth: Any, mount: Sequence[float]) -> tuple[float, np.ndarray, np.ndarray]:
    """Seconds, and the camera's place ``(3,)`` and orientation ``(3, 3)``, from a message of `TRUTH`."""
    pose = pose_from_msg(truth)
    assert pose.position is not None
    return pose.stamp, pose.position + pose.world_R_body @ mount, pose.world_R_body
