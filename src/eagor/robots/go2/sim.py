"""A simulated Go2 with a 360-degree camera in a simulated house: on a clock of its own, or live over DDS.

`SimulatedGo2` alone has a simulated clock: `advance` gives what arrives meanwhile, as fast as it can be computed, and
the same again for the same seed. `eagor.robots.go2.sim_live.LiveGo2` puts the same robot on DDS, in real time.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from eagor._checks import require, stretch, whole, within
from eagor._lazy import lazy
from eagor.errors import DeviceError
from eagor.media import Frame, Pose
from eagor.media.clocks import RelatedClock
from eagor.robots.go2.house import BALL_ID, House, Thing, ball_of, load_house
from eagor.robots.go2.plant import GRAVITY, LIFT, WALKING, Motion, Plant, PlantSettings
from eagor.robots.go2.sport import OK, checked_velocity
from eagor.robots.go2.state import BodyState
from eagor.robots.go2.wire import SportFields
from eagor.worlds.render import Ball, Renderer, with_ball
from eagor.worlds.scene import Scene

__all__ = [
    "CameraSettings", "SimSettings", "SimulatedCamera", "SimulatedGo2", "SimulatedWire", "WireSettings", "odometry_of",
    "sport_fields",
]  # fmt: skip

MOUNT = (0.0, 0.0, 0.40)  # metres from the body's centre to the camera, body frame: a short stick on its back
FIELD = math.radians(200.0)  # of each fisheye of an X3


@dataclass(frozen=True)
class WireSettings:
    """How a simulated Go2's wire behaves.

    `clock_offset`: seconds by which the robot's clock is ahead of this machine's at first; `clock_drift`: seconds per
    second by which it gains. `drop`: share of messages that get lost, in both directions. `delay`: from and to how many
    seconds messages take. `short`: states without the planned path. `battery`: per cent at the start.
    """

    clock_offset: float = 0.0
    clock_drift: float = 0.0
    drop: float = 0.0
    delay: tuple[float, float] = (0.0, 0.0)
    short: bool = False
    battery: int = 87

    def __post_init__(self) -> None:
        require(
            self,
            {
                "clock_offset": (within(self.clock_offset, -1e8, 1e8), "seconds"),
                "clock_drift": (within(self.clock_drift, -0.01, 0.01), "at most 0.01 s per second"),
                "drop": (within(self.drop, 0, 1), "a share, 0 to 1"),
                "delay": (stretch(self.delay, 0, 10), "seconds (from, to), at most 10"),
                "battery": (within(self.battery, 0, 100), "0 to 100"),
            },
            DeviceError,
        )

    def robot_time(self, host: float, seconds: float) -> float:
        """The robot's clock at `host` on ours, `seconds` after its start."""
        return host + self.clock_offset + self.clock_drift * seconds


class SimulatedWire:
    """What is on its way to or from a simulated robot; `rng` draws what gets lost, and how long the rest takes.

    Not for several threads.
    """

    def __init__(self, settings: WireSettings, rng: np.random.Generator) -> None:
        self.settings, self._rng = settings, rng
        self._numbers = itertools.count()
        self._late: list[tuple[float, int, Any]] = []

    def loses(self) -> bool:
        """Whether the next message gets lost."""
        return self.settings.drop > 0 and bool(self._rng.random() < self.settings.drop)

    def delay(self) -> float:
        """Seconds that the next message takes."""
        low, high = self.settings.delay
        return float(self._rng.uniform(low, high)) if high > 0 else 0.0

    def put(self, when: float, message: Any) -> None:
        """A message that arrives then."""
        heapq.heappush(self._late, (when, next(self._numbers), message))

    def arrived(self, now: float) -> Iterator[tuple[float, Any]]:
        """What has arrived by now, in order, each with its time; it is taken away."""
        while self._late and self._late[0][0] <= now:
            when, _, message = heapq.heappop(self._late)
            yield when, message


def sport_fields(motion: Motion, stamp: float, error_code: int = 0) -> SportFields:
    """The state message of a body that moves so, at `stamp` seconds of the robot's clock."""
    pose = motion.pose
    assert pose.position is not None
    (m00, _, _), (m10, _, _), (m20, m21, m22) = pose.world_R_body.tolist()
    roll, pitch, yaw = math.atan2(m21, m22), -math.asin(max(-1.0, min(1.0, m20))), math.atan2(m10, m00)
    second = math.floor(stamp)
    return SportFields(
        second,
        min(int(1e9 * (stamp - second)), 999_999_999),
        error_code,
        _wxyz(roll, pitch, yaw),
        tuple(motion.rates.tolist()),
        (GRAVITY * m20, GRAVITY * m21, GRAVITY * m22),
        (roll, pitch, yaw),
        motion.mode,
        gait_type=1 if motion.mode == WALKING else 0,
        foot_raise_height=LIFT,
        position=tuple(pose.position.tolist()),
        body_height=float(pose.position[2]),
        velocity=tuple(motion.velocity.tolist()),
        yaw_speed=motion.yaw_rate,
    )


def _wxyz(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """The quaternion of a body turned by `yaw`, then `pitch`, then `roll`: half angles, multiplied out."""
    a, b, c = math.cos(roll / 2), math.cos(pitch / 2), math.cos(yaw / 2)
    x, y, z = math.sin(roll / 2), math.sin(pitch / 2), math.sin(yaw / 2)
    return a * b * c + x * y * z, x * b * c - a * y * z, a * y * c + x * b * z, a * b * z - x * y * c


def odometry_of(motion: Motion, stamp: float, frame: str = "odom") -> Any:
    """A nav_msgs/Odometry of the body, at `stamp` seconds; its twist is in the body frame."""
    from eagor.media.ros_messages import odometry_message

    pose = Pose(stamp, motion.pose.world_R_body, motion.pose.position)
    return odometry_message(
        pose, frame, velocity=pose.world_R_body.T @ motion.velocity, turning=np.asarray(motion.rates)
    )


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


@dataclass(frozen=True)
class SimSettings:
    """What is simulated.

    - `world`, `seed`: the house, as `eagor.worlds.load` has it; None: an endless empty floor, without pictures.
    - `target`: what the robot is to find, in words, such as "red chair". A ball ("red ball") is brought into the house,
      and rolls at `speed` metres per second.
    - `start`: x, y (metres) and heading (radians); None: drawn from the seed, some metres from the target.
    - `plant`, `wire`, `camera`: body, wire and camera; `camera` None: no pictures.
    """

    world: str | None = "apartment"
    seed: int = 7
    target: str | None = None
    speed: float = 0.0
    start: tuple[float, float, float] | None = None
    plant: PlantSettings = field(default_factory=PlantSettings)
    wire: WireSettings = field(default_factory=WireSettings)
    camera: CameraSettings | None = field(default_factory=CameraSettings)


class SimulatedGo2:
    """A Go2 that walks in a house. `begun`: seconds of the host's clock at its start.

    It is told what to do as `eagor.robots.go2.sport.SportClient` is: `move`, `stop`, `balance_stand`, `stand_up`,
    `stand_down`, each with a status code. Everything random comes from the seed. Raises `WorldError`, `QueryError`,
    `DeviceError` for settings that cannot be.
    """

    def __init__(self, settings: SimSettings | None = None, *, begun: float = 0.0) -> None:
        self.settings = settings = settings or SimSettings()
        self.begun = begun
        draws = [np.random.default_rng(part) for part in np.random.SeedSequence(settings.seed).spawn(4)]
        self.house: House | None = None
        if settings.world is not None:
            colour = ball_of(settings.target)
            self.house = load_house(settings.world, settings.seed, ball=colour, speed=settings.speed, rng=draws[0])
        elif settings.target is not None:
            raise DeviceError("a robot on an empty floor has no target; give a world, or no target")
        self.targets: tuple[Thing, ...] = ()
        start = settings.start or (0.0, 0.0, 0.0)
        slide = ahead = None
        if self.house is not None:
            if settings.target is not None:
                self.targets = self.house.targets(settings.target)
            start = self._start(draws[1])
            slide, ahead = self.house.slide, self.house.ahead
        self.plant = Plant(settings.plant, draws[2], start, slide, ahead)
        self.wire_rng = draws[3]
        self._clock = RelatedClock("Go2")
        self._commands = SimulatedWire(settings.wire, self.wire_rng)  # to the robot
        self._messages = SimulatedWire(settings.wire, self.wire_rng)  # from it: `Frame`, `SportFields`
        self._pictures = 0

    def _start(self, rng: np.random.Generator) -> tuple[float, float, float]:
        assert self.house is not None
        if (start := self.settings.start) is None:
            return self.house.start(rng, self.targets)
        spot = self.house.ground.snap(np.array(start[:2]))
        if spot is None:
            raise DeviceError(f"start = {start}; wanted x, y (metres) and heading (radians), finite")
        return float(spot[0]), float(spot[1]), float(start[2])

    # --- time ---

    @property
    def now(self) -> float:
        """The host's clock, seconds."""
        return self.begun + self.plant.seconds

    def advance(self, seconds: float) -> list[BodyState | Frame]:
        """Let time pass; the states and pictures that arrive meanwhile, in the order of arrival.

        Stamps are on the host's clock: a state's as related by its messages, a picture's of its capture.
        """
        end = self.plant.steps + round(seconds / self.settings.plant.step)
        came: list[BodyState | Frame] = []
        while self.plant.steps < end:
            for _, command in self._commands.arrived(self.now):
                command()
            self.plant.advance()
            self._send_state()
            self._send_picture()
            for when, message in self._messages.arrived(self.now):
                if not isinstance(message, SportFields):
                    came.append(message)
                    continue
                stamp, _ = self._clock.take(message.sec + 1e-9 * message.nanosec, when)
                if stamp is not None:
                    came.append(BodyState.of(message, stamp, when))
        return came

    # --- commands ---

    def move(self, vx: float, vy: float, wz: float) -> int:
        """Walk forward and left (m/s), turn left (rad/s), for about a second. Raises `DeviceError` for NaN."""
        wanted = checked_velocity(vx, vy, wz)
        return self._do(lambda: self.plant.move(*wanted))

    def stop(self) -> int:
        """Stand still."""
        return self._do(self.plant.stop)

    def balance_stand(self) -> int:
        """Stand, ready to walk."""
        return self._do(self.plant.balance_stand)

    def stand_up(self) -> int:
        """Stand up, with locked joints."""
        return self._do(self.plant.stand_up)

    def stand_down(self) -> int:
        """Lie down."""
        return self._do(self.plant.stand_down)

    def _do(self, command: Callable[[], None]) -> int:
        if not self._commands.loses():
            self._commands.put(self.now + self._commands.delay(), command)
        return OK

    # --- truth ---

    @property
    def truth(self) -> Motion:
        """The body as it is."""
        return self.plant.truth

    def things(self) -> tuple[Thing, ...]:
        """All that could be asked for, where it is now."""
        return () if self.house is None else self.house.things(self.plant.seconds)

    def targets_now(self) -> tuple[Thing, ...]:
        """The things that the target names, where they are now."""
        wanted = {thing.id for thing in self.targets}
        return tuple(thing for thing in self.things() if thing.id in wanted)

    def bearing(self, thing: Thing) -> tuple[np.ndarray, float]:
        """True direction ``(3,)`` from the camera (body axes) and distance, metres, of a thing, now."""
        mount = self.settings.camera or CameraSettings()
        camera = mount.pose(self.plant.truth.pose)
        assert camera.position is not None
        offset = camera.world_R_body.T @ (thing.centre - camera.position)
        distance = float(np.linalg.norm(offset))
        return offset / distance, distance

    # --- the wire ---

    @lazy
    def camera(self) -> SimulatedCamera:
        """The camera. Raises `DeviceError` if there is none."""
        if self.house is None or self.settings.camera is None:
            raise DeviceError("this simulated robot has no camera; give it a world and a camera")
        return SimulatedCamera(self.house.scene, self.settings.camera)

    def picture_due(self) -> bool:
        """Whether the camera takes a picture at this step; asking counts it as taken."""
        camera = self.settings.camera
        if camera is None or self.house is None or self.plant.seconds < self._pictures / camera.rate:
            return False
        self._pictures = math.floor(self.plant.seconds * camera.rate) + 1
        return True

    def _send_state(self) -> None:
        if not self._messages.loses():
            stamp = self.settings.wire.robot_time(self.now, self.plant.seconds)
            self._messages.put(self.now + self._messages.delay(), sport_fields(self.plant.odometry, stamp))

    def _send_picture(self) -> None:
        if not self.picture_due() or self._messages.loses():
            return
        assert self.house is not None
        assert self.settings.camera is not None
        pose = self.settings.camera.pose(self.plant.truth.pose)
        ball = None if self.house.ball is None else self.house.ball.at(self.plant.seconds)
        panorama = self.camera.received(self.camera.picture(pose, ball))
        frame = Frame(self.now, panorama, f"picture {self._pictures}")
        self._messages.put(self.now + self.settings.camera.latency, frame)
