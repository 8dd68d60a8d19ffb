"""A simulated Go2 with a 360-degree camera in a simulated house, on DDS in real time.

`SimulatedGo2` is the robot; `Rehearsal` is one in a process of its own, to walk with before a real one.
"""

from __future__ import annotations

import json
import signal
import threading
import time
import warnings
from collections import deque
from contextlib import ExitStack
from functools import partial
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._processes import Worker, WorkerEnded, WorkerSilent
from eagor.conventions import xyzw_from_rotation
from eagor.errors import DeviceError
from eagor.robots.dds import Participant, Writer, free_domain, raw
from eagor.robots.go2 import state as idl
from eagor.robots.go2.house import CAMERA_TOPIC, TRUTH, SimSettings, SimWorld, camera_pose, film
from eagor.robots.go2.plant import GRAVITY, LIMP, LYING, STEP, BodyState, Plant
from eagor.robots.go2.sport import API_VERSION, AVOID, OK, SPORT, checked_velocity
from eagor.robots.go2.state import SOURCES, low_state, sport_state

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["INTERFACE", "TRUTH", "Rehearsal", "SimSettings", "SimulatedGo2"]

LISTENING = 1.0  # seconds to hear whether another robot is there
SLOW = 10  # steps between messages of the slow topics: 20 Hz at 200 Hz
LATEST = 0.1  # seconds by which the simulation may lag behind before it skips
VERSIONS = {"sport": "1.0.0.1", "obstacles_avoid": "1.0.0.2"}
NOT_KNOWN, NOT_UNDERSTOOD = 3203, 3204
POSTURES = {
    SPORT["Damp"]: partial(Plant.rest, mode=LIMP), SPORT["StandDown"]: partial(Plant.rest, mode=LYING),
    SPORT["StopMove"]: Plant.stop_move, SPORT["BalanceStand"]: Plant.balance_stand, SPORT["StandUp"]: Plant.stand_up,
    SPORT["RecoveryStand"]: Plant.recovery_stand,
}  # fmt: skip
SWITCHES = {AVOID["SwitchSet"]: "enable", AVOID["UseRemoteCommandFromApi"]: "is_remote_commands_from_api"}

INTERFACE = "lo"  # of a rehearsal
STARTING, ENDING = 300.0, 10.0  # seconds for the house and its light on a busy machine; for the process to leave


def _odometry(motion: BodyState, stamp: float, frame: str) -> Any:
    """A nav_msgs/Odometry of the body, at `stamp` seconds; its twist is in the body frame."""
    pose, none = motion.pose, [0.0] * 36
    assert pose.position is not None
    turned = idl.Quaternion(*xyzw_from_rotation(pose.world_R_body).tolist())
    place = idl.RosPoses(idl.RosPose(idl.Point(*pose.position.tolist()), turned), none)
    velocity = idl.Vector3(*(pose.world_R_body.T @ motion.velocity).tolist())
    twist = idl.Twists(idl.Twist(velocity, idl.Vector3(*motion.rates.tolist())), none)
    time = idl.Time(*divmod(int(1e9 * stamp), 10**9))
    return idl.Odometry(idl.Header(time, frame), "base_link", place, twist)


class SimulatedGo2:
    """A Go2 in a house, on DDS domain `domain` in real time while it is entered: its states, commands and camera.

    `plant`: its body; `house`: where it stands. Everything random comes from the seed. `begun`: its start,
    seconds of this machine's clock. `pressed`: the buttons of its remote control, which may be replaced at any time;
    `error_code` likewise. `requests`: the last of those that were `asked`, by service, number and parameter; `skipped`:
    steps that no state tells of, as this machine was too slow. Raises `WorldError`, `QueryError`, `DeviceError` for
    settings that cannot be, or if a robot, real or simulated, already speaks there: commands would reach both.
    """

    def __init__(self, settings: SimSettings, domain: int = 0, interface: str | None = INTERFACE) -> None:
        self.settings, self._network = settings, (domain, interface)
        self.house = None if settings.world is None else SimWorld(settings)
        start, slide = settings.start or (0.0, 0.0, 0.0), np.add
        if self.house is not None:
            x, y, heading = settings.start or self.house.clear_start(np.random.default_rng(settings.seed))
            if (spot := self.house.ground.snap(np.array([x, y]))) is None:
                raise DeviceError(f"start = {settings.start}; wanted x, y (metres) and heading (radians), finite")
            start, slide = (*spot.tolist(), heading), self.house.move_and_slide
        elif settings.target is not None:
            raise DeviceError("a robot on an empty floor has no target; give a world, or no target")
        chance = np.random.SeedSequence(settings.seed).spawn(3)[2]  # the ball has the first
        self.plant = Plant(np.random.default_rng(chance), start, slide, settings.upright)
        self.pressed: frozenset[str] = frozenset()
        self.error_code = self.asked = self.skipped = 0
        self.requests: deque[tuple[str, int, dict[str, Any]]] = deque(maxlen=1000)
        self.avoid = dict.fromkeys(SWITCHES.values(), False)
        self._camera: Worker | None = None
        self._turn, self._ended = threading.RLock(), threading.Event()
        self._state = raw(idl.ShortSportModeState if settings.short else idl.SportModeState)

    def __enter__(self) -> Self:
        kinds = {
            "rt/sportmodestate": self._state, "rt/lf/sportmodestate": self._state, "rt/lf/lowstate": idl.LowState,
            "rt/utlidar/robot_odom": idl.Odometry, TRUTH: idl.Odometry,
        }  # fmt: skip
        self.topics = [*kinds, *(f"rt/api/{name}/request" for name in VERSIONS)]
        with ExitStack() as stack:
            self.link = link = stack.enter_context(Participant(*self._network))
            if there := sorted({*SOURCES.values()} & {*link.topics(LISTENING)}):
                raise DeviceError(
                    f"a robot already speaks on DDS {link} ({', '.join(there)}), and commands would reach both: "
                    "take another --domain, or end the other one if it is simulated"
                )
            self._writers = {topic: link.publish(topic, kind) for topic, kind in kinds.items()}
            for name in VERSIONS:
                answer = partial(self._answer, name, link.publish(f"rt/api/{name}/response", idl.Response))
                link.subscribe(f"rt/api/{name}/request", idl.Request, answer, reliable=True)
            if self.house is not None and self.settings.rows is not None:
                self.topics.append(CAMERA_TOPIC)
                self._camera = Worker(film, self.settings, *self._network)
                stack.callback(self._camera.close, ENDING)
                try:
                    self._camera.receive(STARTING)
                    self._camera.send(time.time())
                except (WorkerEnded, WorkerSilent):
                    raise DeviceError("the simulated camera's process ended, or is not ready in time") from None
            self.begun = time.time()
            thread = threading.Thread(target=self._run, name="simulated Go2", daemon=True)
            thread.start()
            stack.callback(thread.join)
            stack.callback(self._ended.set)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def alive(self) -> bool:
        return self._camera is None or self._camera.alive

    # --- states ---

    def _run(self) -> None:
        plant, start = self.plant, time.monotonic()
        while not self._ended.wait(max(0.0, start + plant.seconds + STEP - time.monotonic())):
            behind = time.monotonic() - start - plant.seconds
            with self._turn:
                if behind > LATEST:  # states of the past help nobody; the body moves on all the same
                    for _ in range(missed := int(behind / STEP) - 1):
                        plant.advance()
                    self.skipped += missed
                plant.advance()
                try:
                    self._send_states()
                except DeviceError as error:
                    warnings.warn(f"the simulated Go2 cannot send: {error}", stacklevel=2)

    def _send_states(self) -> None:
        plant, settings, write = self.plant, self.settings, self._writers
        host = self.begun + plant.seconds
        stamp = host + settings.clock_offset + settings.clock_drift * plant.seconds
        believed = plant.odometry
        x, y, z, w = xyzw_from_rotation(believed.pose.world_R_body)
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
            write["rt/lf/lowstate"].write(low_state(self.pressed, max(0, battery), seconds=plant.seconds))

    # --- requests ---

    def _answer(self, service: str, responses: Writer, request: Any, _: float) -> None:
        identity = request.header.identity
        code, data = self.obey(service, identity.api_id, request.parameter)
        if not request.header.policy.noreply:
            header = idl.ResponseHeader(identity, idl.ResponseStatus(code))
            responses.write(idl.Response(header, data, []))

    def obey(self, service: str, api_id: int, parameter: str) -> tuple[int, str]:
        """The status code and the data of a request, after doing it."""
        if api_id == API_VERSION:
            return OK, VERSIONS[service]
        try:
            asked = json.loads(parameter) if parameter else {}
            with self._turn:
                self.requests.append((service, api_id, asked))
                self.asked += 1
                return self._do(service == "sport", api_id, asked), ""
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
            return NOT_UNDERSTOOD, ""

    def _do(self, sport: bool, api_id: int, asked: dict[str, Any]) -> int:
        """Avoiding obstacles, it has no eyes of its own: it takes velocities once that is on, and walls stop it."""
        if api_id == (SPORT if sport else AVOID)["Move"]:
            wanted = checked_velocity(asked["x"], asked["y"], asked["z" if sport else "yaw"])
            if sport or all(self.avoid.values()):
                self.plant.move(*wanted)
        elif sport and api_id in POSTURES:
            POSTURES[api_id](self.plant)
        elif not sport and api_id in SWITCHES:
            self.avoid[SWITCHES[api_id]] = bool(asked[SWITCHES[api_id]])
        else:
            return NOT_KNOWN
        return OK


class Rehearsal:
    """A simulated Go2 on a free DDS domain of this machine; a context manager. It ends with this process.

    `truth`: the camera's true place ``(3,)`` and orientation ``(3, 3)`` now, None before the first message; `targets`:
    where the things ``(n, 3)`` that were asked for lie at first. Raises what the simulation raises.
    """

    def __init__(self, settings: SimSettings) -> None:
        self.settings, self.domain = settings, free_domain()
        self.truth: tuple[np.ndarray, np.ndarray] | None = None

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            worker = Worker(_rehearse, self.settings, self.domain, name="simulated Go2", parent=True)
            stack.callback(worker.close, ENDING)
            try:
                self.targets = np.reshape(worker.receive(STARTING), (-1, 3))
            except (WorkerSilent, WorkerEnded):
                code = worker.close(ENDING)
                raise DeviceError(f"the simulated robot does not start: its process ended (exit code {code})") from None
            stack.enter_context(Participant(self.domain, INTERFACE)).subscribe(TRUTH, idl.Odometry, self._moved)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _moved(self, message: Any, _: float) -> None:
        self.truth = camera_pose(message, self.settings.mount)[1:]


def _rehearse(line: Connection, settings: SimSettings, domain: int) -> None:
    """The life of the process."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends with its parent, which is told as well
    with SimulatedGo2(settings, domain) as robot:
        line.send([each.centre for each in robot.house.targets] if robot.house else [])
        line.recv()  # until the parent closes it
