"""A simulated Go2 with a 360-degree camera in a simulated house: on a clock of its own, or live over DDS.

`SimulatedGo2` alone has a simulated clock: `advance` gives what arrives meanwhile, as fast as it can be computed, and
the same again for the same seed. `LiveGo2` puts the same robot on DDS, in real time; `Rehearsal` is that in a process
of its own, to walk with before a real one.
"""

from __future__ import annotations

import json
import math
import signal
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any, Self

import numpy as np

from eagor._processes import Worker, WorkerEnded, WorkerSilent
from eagor._values import lazy
from eagor.conventions import rotation_from_wxyz
from eagor.errors import DeviceError
from eagor.media import Frame
from eagor.media.clocks import RelatedClock
from eagor.media.ros_messages import TEXT, text_message
from eagor.robots.dds import Link, free_domain
from eagor.robots.go2.house import (
    CAMERA_TOPIC,
    CameraSettings,
    House,
    Moment,
    PictureProcess,
    SimulatedCamera,
    Thing,
    ball_of,
    load_house,
)
from eagor.robots.go2.plant import Motion, Plant, PlantSettings
from eagor.robots.go2.sim_wire import TRUTH, Go2Server, SimulatedWire, WireSettings, sport_fields
from eagor.robots.go2.sport import OK, checked_velocity
from eagor.robots.go2.state import SOURCES, BodyState, SportFields

__all__ = ["CAMERA", "INTERFACE", "TRUTH_THINGS", "LiveGo2", "Rehearsal", "SimSettings", "SimulatedGo2", "clear_start"]

TRUTH_THINGS = f"{TRUTH}/things"  # std_msgs/String: JSON of all things and where they are; no robot has this topic
LISTENING = 1.0  # seconds to hear whether another robot is there
THINGS_EVERY = 0.2  # seconds

INTERFACE = "lo"  # of a rehearsal
CAMERA = "ros:" + CAMERA_TOPIC.removeprefix("rt")
STARTING = 300.0  # seconds for the house and its light, on a busy machine
ENDING = 10.0
TRIES, ROOM, NEAR, FAR = 2000, 0.35, 2.5, 5.0  # draws; metres around the start; metres to the target
BEFORE = 1.0  # metres before the target's centre at which the way may end: things fill some floor


@dataclass(frozen=True)
class SimSettings:
    """What is simulated.

    - `world`, `seed`: the house, as `eagor.lab.worlds.load` has it; None: an endless empty floor, without pictures.
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


class LiveGo2:
    """`robot` on DDS domain `domain`, in real time; a context manager.

    Raises `DeviceError` if a robot, real or simulated, already speaks there: commands would reach both.
    """

    def __init__(self, robot: SimulatedGo2, domain: int = 0, interface: str | None = "lo") -> None:
        self.robot = robot
        self.pictures: PictureProcess | None = None
        self._told = 0.0
        self._broken = False
        self.link = Link(domain, interface)
        try:
            self._alone()
            settings = robot.settings
            if settings.world is not None and settings.camera is not None:
                self.pictures = PictureProcess(settings.world, settings.seed, settings.camera, domain, interface)
            self._things = self.link.publish(TRUTH_THINGS, TEXT, transient=True, depth=1)
            self.server = Go2Server(
                robot.plant, self.link, settings.wire, rng=robot.wire_rng, every_step=self._every_step
            )
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        try:
            self.robot.begun = time.time() - self.robot.plant.seconds
            self.server.__enter__()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the robot, its camera and its place on the network. May be called twice."""
        if (server := getattr(self, "server", None)) is not None:
            server.close()
        if self.pictures is not None:
            self.pictures.close()
            self.pictures = None
        self.link.close()

    def wait_for_camera(self) -> None:
        """Wait until pictures come. Raises `DeviceError` if they cannot."""
        if self.pictures is not None:
            self.pictures.wait()

    @property
    def topics(self) -> dict[str, str]:
        """The topics for other programs, in words."""
        found = {
            "rt/sportmodestate": "state, 200 per second",
            "rt/lf/sportmodestate": "state, 20 per second",
            "rt/utlidar/robot_odom": "odometry (nav_msgs/Odometry), 20 per second",
            "rt/lowstate": "battery, remote control, 200 per second",
            "rt/lf/lowstate": "battery, remote control, 20 per second",
            "rt/api/sport/request": "commands",
            "rt/api/obstacles_avoid/request": "commands that heed obstacles",
        }
        camera = self.robot.settings.camera
        if camera is not None and self.robot.house is not None:
            what = "both fisheyes" if camera.kind == "fisheye" else "panorama"
            wide, high = camera.size
            found[CAMERA_TOPIC] = f"camera ({what}, {wide} x {high}, JPEG), {camera.rate:g} per second"
        found[TRUTH] = "the true pose, which no robot has"
        if self.robot.house is not None:
            found[TRUTH_THINGS] = "the true places of things, which no robot has"
        return found

    def _alone(self) -> None:
        taken = self.link.topics(LISTENING)
        if there := sorted({*SOURCES.values()} & {*taken}):
            where = f"domain {self.link.domain} on {self.link.interface or 'an automatic interface'}"
            raise DeviceError(
                f"a robot already speaks on DDS {where} ({', '.join(there)}), and commands would reach both: take "
                "another --domain, or end the other one if it is simulated"
            )

    def _every_step(self, motion: Motion, host: float) -> None:
        """In the server's thread: offer a picture if one is due, tell where things are."""
        if self.pictures is not None and not self._broken and self.robot.picture_due():
            self._offer(motion, host)
        if self.robot.house is not None and host - self._told >= THINGS_EVERY:
            if self._told == 0.0 or self.robot.house.ball is not None:
                self._things.write(text_message(json.dumps(self._truth(host))))
            self._told = host

    def _offer(self, motion: Motion, host: float) -> None:
        camera, house = self.robot.settings.camera, self.robot.house
        assert camera is not None
        assert house is not None
        assert self.pictures is not None
        ball = None if house.ball is None else house.ball.at(motion.pose.stamp)
        try:
            self.pictures.offer(Moment(host, camera.pose(motion.pose), ball))
        except DeviceError as error:
            self._broken = True
            warnings.warn(str(error), stacklevel=2)

    def _truth(self, host: float) -> dict[str, Any]:
        things = [
            {"id": each.id, "category": each.category, "colour": each.colour, "position": each.centre.round(4).tolist()}
            for each in self.robot.things()
        ]
        targets = [thing.id for thing in self.robot.targets]
        return {"stamp": host, "target": self.robot.settings.target, "targets": targets, "things": things}


class Rehearsal:
    """A simulated Go2 on a free DDS domain of this machine; a context manager. It ends with this process.

    `truth()` is the camera's true place ``(3,)`` and orientation ``(3, 3)``, None before the first message;
    `targets()` the true places ``(n, 3)`` of the things that were asked for. Raises what the simulation raises.
    """

    def __init__(self, settings: SimSettings, domain: int | None = None) -> None:
        self.settings = settings
        self.domain = free_domain() if domain is None else domain
        self._pose: tuple[np.ndarray, np.ndarray] | None = None
        self._things: dict[str, Any] = {"targets": [], "things": []}
        self._worker: Worker | None = None

    def __enter__(self) -> Self:
        self._worker = Worker(_robot, self.settings, self.domain, name="simulated Go2", parent=True)
        try:
            self._worker.receive(STARTING)
        except WorkerSilent:
            self.close()
            raise DeviceError("the simulated robot does not start: it is not ready in time") from None
        except WorkerEnded:
            how = f"its process ended by itself (exit code {self._worker.close(ENDING)})"
            raise DeviceError(f"the simulated robot does not start: {how}") from None
        except BaseException:
            self.close()
            raise
        self._link = Link(self.domain, INTERFACE)
        self._link.subscribe(TRUTH, "nav_msgs/msg/Odometry", self._told_pose)
        self._link.subscribe(TRUTH_THINGS, TEXT, self._told_things, reliable=True, transient=True)
        return self

    def __exit__(self, *_: object) -> None:
        self._link.close()
        self.close()

    def close(self) -> None:
        """End the robot."""
        if self._worker is not None:
            self._worker.close(ENDING)

    def truth(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Where the camera really is, and how it is turned."""
        return self._pose

    def targets(self) -> np.ndarray:
        """Where the things that were asked for really are."""
        asked = {*self._things["targets"]}
        places = [thing["position"] for thing in self._things["things"] if thing["id"] in asked]
        return np.array(places, dtype=np.float64).reshape(-1, 3)

    def _told_pose(self, message: Any, _: float) -> None:
        pose = message.pose.pose
        turned = pose.orientation
        world_R_body = rotation_from_wxyz(np.array([turned.w, turned.x, turned.y, turned.z]))
        place = np.array([pose.position.x, pose.position.y, pose.position.z])
        mount = (0.0, 0.0, 0.0) if self.settings.camera is None else self.settings.camera.mount
        self._pose = place + world_R_body @ np.asarray(mount), world_R_body

    def _told_things(self, message: Any, _: float) -> None:
        self._things = json.loads(message.data)


def clear_start(house: House, targets: Sequence[Thing], rng: np.random.Generator) -> tuple[float, float, float] | None:
    """A place (x, y in metres) and a heading (radians) some metres from a target, with a straight way there.

    The policy goes straight, and around nothing. None if no such place was found.
    """
    ground = house.ground
    for _ in range(TRIES):
        spot = ground.sample(rng, min(ROOM, float(ground.clearance[ground.free].max())))
        for thing in targets:
            way = thing.centre[:2] - spot
            far = float(np.hypot(*way))
            if not NEAR <= far <= FAR:
                continue
            steps = np.arange(0.0, far - BEFORE, ground.cell / 2)[:, None] * way / far
            if bool(ground.is_free(spot + steps).all()):
                return float(spot[0]), float(spot[1]), float(rng.uniform(-math.pi, math.pi))
    return None


def _robot(line: Connection, settings: SimSettings, domain: int) -> None:
    """The life of the process."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends with its parent, which is told as well
    with LiveGo2(SimulatedGo2(settings), domain, INTERFACE) as robot:
        robot.wait_for_camera()
        line.send(None)
        line.recv()  # until the parent closes it
