"""A simulated Go2 with a 360-degree camera in a simulated house, on DDS in real time.

`SimulatedGo2` is the robot; `LiveGo2` puts it on DDS; `Rehearsal` is that in a process of its own, to walk with before
a real one.
"""

from __future__ import annotations

import json
import math
import signal
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any, Self

import numpy as np

from eagor._checks import require, within
from eagor._processes import Worker, WorkerEnded, WorkerSilent
from eagor.errors import DeviceError
from eagor.robots.dds import Link, Writer, free_domain, raw
from eagor.robots.go2 import state as idl
from eagor.robots.go2.house import CAMERA_TOPIC, TRUTH, CameraSettings, SimWorld, clear_start, film, pose_of
from eagor.robots.go2.plant import GRAVITY, Motion, Plant, PlantSettings
from eagor.robots.go2.sport import API_VERSION, OK, Avoid, Sport, checked_velocity
from eagor.robots.go2.state import SOURCES, Remote, low_state, split_time, sport_state

__all__ = ["INTERFACE", "TRUTH", "LiveGo2", "Rehearsal", "SimSettings", "SimulatedGo2", "clear_start"]

LISTENING = 1.0  # seconds to hear whether another robot is there
SLOW = 10  # steps between messages of the slow topics: 20 Hz at 200 Hz
LATEST = 0.1  # seconds by which the simulation may lag behind before it skips
VERSIONS = {"sport": "1.0.0.1", "obstacles_avoid": "1.0.0.2"}
NOT_KNOWN, NOT_UNDERSTOOD = 3203, 3204

INTERFACE = "lo"  # of a rehearsal
STARTING, ENDING = 300.0, 10.0  # seconds for the house and its light on a busy machine; for the process to leave


@dataclass(frozen=True)
class SimSettings:
    """What is simulated: a body `plant` and perhaps a `camera`, in the house `world` of this `seed` (`SimWorld`).

    `world` None: an endless empty floor, without pictures. `target`, `speed`: what it is to find, and how fast that
    rolls if it is a ball. `start`: x, y (metres), heading (radians); None: some metres from the target. The robot's
    clock is ahead by `clock_offset` seconds at first, and gains `clock_drift` seconds per second. `short`: states
    without the planned path. `battery`: per cent at the start.
    """

    world: str | None = "apartment"
    seed: int = 7
    target: str | None = None
    speed: float = 0.0
    start: tuple[float, float, float] | None = None
    plant: PlantSettings = field(default_factory=PlantSettings)
    camera: CameraSettings | None = field(default_factory=CameraSettings)
    clock_offset: float = 0.0
    clock_drift: float = 0.0
    short: bool = False
    battery: int = 87

    def __post_init__(self) -> None:
        require(self, {"clock_offset": (within(self.clock_offset, -1e8, 1e8), "seconds")}, DeviceError)


class SimulatedGo2:
    """A Go2 that stands in a house, with the things that it is to find there: `plant`, `house` and `targets`.

    Everything random comes from the seed. Raises `WorldError`, `QueryError`, `DeviceError` for settings that cannot be.
    """

    def __init__(self, settings: SimSettings | None = None) -> None:
        self.settings = settings = settings or SimSettings()
        self.draws, _, body = np.random.SeedSequence(settings.seed).spawn(3)  # of the ball's way, and of the body
        self.house: SimWorld | None = None
        start, slide = settings.start or (0.0, 0.0, 0.0), None
        if settings.world is not None:
            self.house = SimWorld(settings.world, settings.seed, settings.target, settings.speed, self.draws)
            start, slide = self._start(self.house), self.house.move_and_slide
        elif settings.target is not None:
            raise DeviceError("a robot on an empty floor has no target; give a world, or no target")
        self.targets = [] if self.house is None else self.house.targets()
        self.plant = Plant(settings.plant, np.random.default_rng(body), start, slide)

    def _start(self, house: SimWorld) -> tuple[float, float, float]:
        rng = np.random.default_rng(self.settings.seed)
        start = self.settings.start or clear_start(house, house.targets(), rng) or clear_start(house, (), rng)
        assert start is not None
        if (spot := house.ground.snap(np.array(start[:2]))) is None:
            raise DeviceError(f"start = {start}; wanted x, y (metres) and heading (radians), finite")
        return float(spot[0]), float(spot[1]), float(start[2])


def _odometry(motion: Motion, stamp: float, frame: str) -> Any:
    """A nav_msgs/Odometry of the body, at `stamp` seconds; its twist is in the body frame."""
    pose, none = motion.pose, [0.0] * 36
    assert pose.position is not None
    turned = idl.Quaternion(*_xyzw(*motion.rpy))
    place = idl.RosPoses(idl.RosPose(idl.Point(*pose.position.tolist()), turned), none)
    velocity = idl.Vector3(*(pose.world_R_body.T @ motion.velocity).tolist())
    twist = idl.Twists(idl.Twist(velocity, idl.Vector3(*motion.rates.tolist())), none)
    return idl.Odometry(idl.Header(idl.Time(*split_time(stamp)), frame), "base_link", place, twist)


def _xyzw(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """The quaternion of a body turned by `yaw`, then `pitch`, then `roll`: half angles, multiplied out."""
    a, b, c = math.cos(roll / 2), math.cos(pitch / 2), math.cos(yaw / 2)
    x, y, z = math.sin(roll / 2), math.sin(pitch / 2), math.sin(yaw / 2)
    return x * b * c - a * y * z, a * y * c + x * b * z, a * b * z - x * y * c, a * b * c + x * y * z


class LiveGo2:
    """`robot` on DDS domain `domain`, in real time, as a context manager: its states, commands and camera.

    `begun`: its start, seconds of this machine's clock. `remote`: what the simulated remote control shows, which may be
    replaced at any time; `error_code` likewise. `requests`: the last of those that were `asked`, by service, number and
    parameter; `skipped`: steps that no state tells of, as this machine was too slow. Raises `DeviceError` if a robot,
    real or simulated, already speaks there: commands would reach both.
    """

    def __init__(self, robot: SimulatedGo2, domain: int = 0, interface: str | None = INTERFACE) -> None:
        self.robot, self.plant, settings = robot, robot.plant, robot.settings
        self.remote, self.error_code = Remote(), 0
        self.asked = self.skipped = 0
        self.requests: deque[tuple[str, int, dict[str, Any]]] = deque(maxlen=1000)
        self.avoid = {"enable": False, "is_remote_commands_from_api": False}
        self._camera: Worker | None = None
        self._turn, self._ended = threading.RLock(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulated Go2", daemon=True)
        self._state = raw(idl.ShortSportModeState if settings.short else idl.SportModeState)
        self.link = Link(domain, interface)
        try:
            if there := sorted({*SOURCES.values()} & {*self.link.topics(LISTENING)}):
                raise DeviceError(
                    f"a robot already speaks on DDS {self.link} ({', '.join(there)}), and commands would reach both: "
                    "take another --domain, or end the other one if it is simulated"
                )
            if settings.world is not None and settings.camera is not None:
                house = settings.world, settings.seed, settings.target, settings.speed, robot.draws
                self._camera = Worker(film, house, settings.camera, domain, interface)
            kinds = {
                "rt/sportmodestate": self._state, "rt/lf/sportmodestate": self._state, "rt/lf/lowstate": idl.LowState,
                "rt/utlidar/robot_odom": idl.Odometry, TRUTH: idl.Odometry,
            }  # fmt: skip
            self._writers = {topic: self.link.publish(topic, kind) for topic, kind in kinds.items()}
            for name in VERSIONS:
                self._serve(name)
        except BaseException:
            self.close()
            raise
        requests, camera = [f"rt/api/{name}/request" for name in VERSIONS], [CAMERA_TOPIC] if self._camera else []
        self.topics = [*kinds, *requests, *camera]

    def __enter__(self) -> Self:
        try:
            if self._camera is not None:
                self._camera.receive(STARTING)
            self.begun = time.time() - self.plant.seconds
            if self._camera is not None:
                self._camera.send(self.begun)
        except (WorkerEnded, WorkerSilent):
            self.close()
            raise DeviceError("the simulated camera's process ended by itself, or is not ready in time") from None
        except BaseException:
            self.close()
            raise
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the robot, its camera and its place on the network. May be called twice."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        if self._camera is not None:
            self._camera.close(ENDING)
        self.link.close()

    @property
    def alive(self) -> bool:
        """Whether all its processes run."""
        return self._camera is None or self._camera.alive

    @property
    def truth(self) -> Motion:
        """The body as it is now."""
        with self._turn:
            return self.plant.truth

    # --- states ---

    def _run(self) -> None:
        step = self.plant.settings.step
        start = time.monotonic() - self.plant.seconds
        while not self._ended.is_set():
            behind = time.monotonic() - start - self.plant.seconds
            if behind < step:
                self._ended.wait(step - behind)
                continue
            with self._turn:
                while behind > LATEST and time.monotonic() - start - self.plant.seconds > step:
                    self.plant.advance()  # states of the past help nobody; the body moves on all the same
                    self.skipped += 1
                self.plant.advance()
                try:
                    self._send_states()
                except DeviceError as error:
                    warnings.warn(f"the simulated Go2 cannot send: {error}", stacklevel=2)

    def _send_states(self) -> None:
        plant, settings, write = self.plant, self.robot.settings, self._writers
        host = self.begun + plant.seconds
        stamp = host + settings.clock_offset + settings.clock_drift * plant.seconds
        believed = plant.odometry
        x, y, z, w = _xyzw(*believed.rpy)
        felt, position = GRAVITY * believed.pose.world_R_body[2], believed.pose.position
        state = self._state(
            sport_state(
                stamp, (w, x, y, z), believed.rates, felt, believed.rpy, believed.mode, position, believed.velocity,
                believed.yaw_rate, self.error_code, short=settings.short,
            )
        )  # fmt: skip
        write["rt/sportmodestate"].write(state)
        if plant.steps % SLOW == 0:
            write["rt/lf/sportmodestate"].write(state)
            write["rt/utlidar/robot_odom"].write(_odometry(believed, stamp, "odom"))
            write[TRUTH].write(_odometry(plant.truth, host, "world"))
            battery = settings.battery - int(plant.seconds / 60)  # a full one lasts for an hour and a half or so
            write["rt/lf/lowstate"].write(low_state(self.remote, max(0, battery), seconds=plant.seconds))

    # --- requests ---

    def _serve(self, service: str) -> None:
        responses: Writer = self.link.publish(f"rt/api/{service}/response", idl.Response)

        def received(request: Any, _: float) -> None:
            identity = request.header.identity
            code, data = self.obey(service, identity.api_id, request.parameter)
            if not request.header.policy.noreply:
                header = idl.ResponseHeader(identity, idl.ResponseStatus(code))
                responses.write(idl.Response(header, data, []))

        self.link.subscribe(f"rt/api/{service}/request", idl.Request, received, reliable=True)

    def obey(self, service: str, api_id: int, parameter: str) -> tuple[int, str]:
        """The status code and the data of a request, after doing it."""
        if api_id == API_VERSION:
            return OK, VERSIONS[service]
        try:
            asked = json.loads(parameter) if parameter else {}
            with self._turn:
                self.requests.append((service, api_id, asked))
                self.asked += 1
                return (self._sport if service == "sport" else self._avoiding)(api_id, asked)
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
            return NOT_UNDERSTOOD, ""

    def _sport(self, api_id: int, asked: dict[str, Any]) -> tuple[int, str]:
        plant = self.plant
        plain: dict[int, Callable[[], None]] = {
            Sport.DAMP: plant.damp, Sport.BALANCE_STAND: plant.balance_stand, Sport.STOP_MOVE: plant.stop,
            Sport.STAND_UP: plant.stand_up, Sport.STAND_DOWN: plant.stand_down, Sport.RECOVERY_STAND: plant.recover,
        }  # fmt: skip
        if api_id == Sport.MOVE:
            plant.move(*checked_velocity(asked["x"], asked["y"], asked["z"]))
        elif api_id in plain:
            plain[api_id]()
        else:
            return NOT_KNOWN, ""
        return OK, ""

    def _avoiding(self, api_id: int, asked: dict[str, Any]) -> tuple[int, str]:
        """Without eyes of its own: it takes velocities once it is turned on, and slides along walls as ever."""
        if api_id == Avoid.MOVE:
            wanted = checked_velocity(asked["x"], asked["y"], asked["yaw"])
            if all(self.avoid.values()):
                self.plant.move(*wanted)
        elif api_id in (Avoid.SWITCH_SET, Avoid.USE_REMOTE_COMMAND_FROM_API):
            name = "enable" if api_id == Avoid.SWITCH_SET else "is_remote_commands_from_api"
            self.avoid[name] = bool(asked[name])
        else:
            return NOT_KNOWN, ""
        return OK, ""


class Rehearsal:
    """A simulated Go2 on a free DDS domain of this machine; a context manager. It ends with this process.

    `truth()` is the camera's true place ``(3,)`` and orientation ``(3, 3)``, None before the first message;
    `targets()` where the things ``(n, 3)`` that were asked for lie at first. Raises what the simulation raises.
    """

    def __init__(self, settings: SimSettings) -> None:
        self.settings, self.domain = settings, free_domain()
        self._pose: tuple[np.ndarray, np.ndarray] | None = None

    def __enter__(self) -> Self:
        self._worker = Worker(_rehearse, self.settings, self.domain, name="simulated Go2", parent=True)
        try:
            self._targets = np.reshape(self._worker.receive(STARTING), (-1, 3))
            self._link = Link(self.domain, INTERFACE)
        except (WorkerSilent, WorkerEnded):
            code = self._worker.close(ENDING)
            raise DeviceError(f"the simulated robot does not start: its process ended (exit code {code})") from None
        except BaseException:
            self._worker.close(ENDING)
            raise
        self._link.subscribe(TRUTH, idl.Odometry, self._received_pose)
        return self

    def __exit__(self, *_: object) -> None:
        self._link.close()
        self._worker.close(ENDING)

    def truth(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Where the camera really is, and how it is turned."""
        return self._pose

    def targets(self) -> np.ndarray:
        """Where the things that were asked for lie."""
        return self._targets

    def _received_pose(self, message: Any, _: float) -> None:
        _, at, world_R_body = pose_of(message)
        mount = (0.0, 0.0, 0.0) if self.settings.camera is None else self.settings.camera.mount
        self._pose = at + world_R_body @ np.asarray(mount), world_R_body


def _rehearse(line: Connection, settings: SimSettings, domain: int) -> None:
    """The life of the process."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends with its parent, which is told as well
    with LiveGo2(SimulatedGo2(settings), domain) as live:
        line.send([each.centre for each in live.robot.targets])
        line.recv()  # until the parent closes it
