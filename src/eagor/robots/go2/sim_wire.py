"""The wire of a simulated Go2: how it delays and loses messages, and a body on DDS in real time.

`Go2Server` has the topics, services and faults of a real one's wire, and the truth beside. Programs of Unitree's SDK
that command motors release the mode of motion first, or switch off ``sport_mode``; the joints are limp then, and nobody
answers commands to walk until a mode is selected again.
"""

from __future__ import annotations

import heapq
import itertools
import json
import math
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np

from eagor._checks import require, stretch, within
from eagor.errors import DeviceError
from eagor.media import Pose
from eagor.robots.dds import Link
from eagor.robots.go2.plant import GRAVITY, LIFT, LIMP, WALKING, Motion, Plant
from eagor.robots.go2.sport import API_VERSION, Avoid, Sport, checked_velocity
from eagor.robots.go2.state import LowFields, Remote, SportFields, raw

__all__ = [
    "SERVICES", "TRUTH", "VERSIONS", "Go2Server", "ServiceError", "ServiceSwitches", "SimulatedWire", "WireSettings",
    "odometry_of", "sport_fields",
]  # fmt: skip

VERSIONS = {
    "sport": "1.0.0.1", "obstacles_avoid": "1.0.0.2", "robot_state": "1.0.0.1", "motion_switcher": "1.0.0.1",
}  # fmt: skip
MOTION_MODES = ("normal", "ai", "mcf", "advanced")  # of motion; the first is on at the start
# Names of services, and whether they are protected from being switched off.
SERVICES = {"sport_mode": False, "obstacles_avoid": False, "robot_state": True, "motion_switcher": True}
WALKS = {"sport": "sport_mode", "obstacles_avoid": "obstacles_avoid"}  # the service behind a topic
NOT_KNOWN, NOT_UNDERSTOOD = 3203, 3204
SWITCH_FAILED, MODE_NOT_KNOWN = 5201, 7004
PROTECTED = 5  # status of a service that cannot be switched

TRUTH = "rt/eagor/truth"  # the true pose (nav_msgs/Odometry): no robot has this topic
SLOW = 10  # steps between messages of the slow topics: 20 Hz at 200 Hz
KEPT = 1000  # requests
LATEST = 0.1  # seconds by which the simulation may lag behind before it skips


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
        second, min(int(1e9 * (stamp - second)), 999_999_999), error_code, _wxyz(roll, pitch, yaw),
        tuple(motion.rates.tolist()), (GRAVITY * m20, GRAVITY * m21, GRAVITY * m22), (roll, pitch, yaw), motion.mode,
        gait_type=1 if motion.mode == WALKING else 0, foot_raise_height=LIFT, position=tuple(pose.position.tolist()),
        body_height=float(pose.position[2]), velocity=tuple(motion.velocity.tolist()), yaw_speed=motion.yaw_rate,
    )  # fmt: skip


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


class ServiceError(Exception):
    """A request that is refused with a code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class ServiceSwitches:
    """Which services of a robot with this body run, and in which mode of motion it is ("": released)."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self.mode, self._silent = MOTION_MODES[0], False
        self._on = dict.fromkeys(SERVICES, True)

    def answers(self, topic: str) -> bool:
        """Whether somebody answers requests to a service by its topic ("sport")."""
        name = WALKS.get(topic, topic)
        return self._on[name] and (bool(self.mode) or topic not in WALKS)

    def obey(self, topic: str, api_id: int, asked: dict[str, Any]) -> str:
        """The data of the response. Raises `ServiceError`; `KeyError`, `ValueError` for what is not understood."""
        return (self._robot_state if topic == "robot_state" else self._motion)(api_id, asked)

    def _robot_state(self, api_id: int, asked: dict[str, Any]) -> str:
        if api_id == 1001:
            name, on = str(asked["name"]), bool(int(asked["switch"]))
            if name not in SERVICES:
                raise ServiceError(SWITCH_FAILED)
            if not SERVICES[name]:
                self._switch(name, on)
                self.mode = self.mode or (MOTION_MODES[0] if name == "sport_mode" and on else "")
            return json.dumps({"name": name, "status": PROTECTED if SERVICES[name] else int(on)})
        if api_id == 1003:
            return json.dumps(
                [{"name": name, "status": int(self._on[name]), "protect": int(SERVICES[name])} for name in SERVICES]
            )
        raise ServiceError(NOT_KNOWN)

    def _motion(self, api_id: int, asked: dict[str, Any]) -> str:
        if api_id == 1001:
            return json.dumps({"form": "0", "name": self.mode})
        if api_id == 1002:
            if asked["name"] not in MOTION_MODES:
                raise ServiceError(MODE_NOT_KNOWN)
            self.mode = asked["name"]
            self._switch("sport_mode", True)
        elif api_id == 1003:
            self.mode = ""
            self._switch("sport_mode", False)
        elif api_id == 1004:
            self._silent = bool(asked["silent"])
        elif api_id == 1005:
            return json.dumps({"silent": self._silent})
        else:
            raise ServiceError(NOT_KNOWN)
        return ""

    def _switch(self, name: str, on: bool) -> None:
        self._on[name] = on
        if name == "sport_mode":
            if not on:
                self._plant.damp()
            elif self._plant.mode == LIMP:  # somebody holds the joints again, where they are
                self._plant.stand_down()
        else:
            self._plant.stop()


class Go2Server:
    """`plant` on `link`, in real time, as a context manager. `rng` draws which messages are lost and how late they are.

    `every_step(motion, host_stamp)`, if given, is called after each step, in the server's thread. `remote` is what the
    simulated remote control shows, and may be replaced at any time; `error_code` likewise.
    """

    def __init__(
        self,
        plant: Plant,
        link: Link,
        wire: WireSettings | None = None,
        *,
        rng: np.random.Generator | None = None,
        every_step: Callable[[Motion, float], None] | None = None,
    ) -> None:
        from eagor.robots.go2 import idl

        self.plant, self.wire = plant, wire or WireSettings()
        self.remote, self.error_code = Remote(), 0
        self._requests: deque[tuple[str, int, dict[str, Any]]] = deque(maxlen=KEPT)
        self.asked = 0  # requests that came, except for the version
        self.skipped = 0  # steps that no state tells of: this machine was too slow
        self._every_step = every_step
        self.switches = ServiceSwitches(plant)
        self._joints, self._told = plant.joints, plant.steps  # at the last message of the motors
        self._avoid = {"enable": False, "is_remote_commands_from_api": False}
        self._turn = threading.RLock()
        self._ended = threading.Event()
        self._way = SimulatedWire(self.wire, rng or np.random.default_rng())  # of functions that send
        state = raw(idl.ShortSportModeState if self.wire.short else idl.SportModeState)
        low = raw(idl.LowState)
        self._state, self._low = state, low
        self._writers = {
            topic: link.publish(topic, kind)
            for topic, kind in (
                ("rt/sportmodestate", state), ("rt/lf/sportmodestate", state), ("rt/lowstate", low),
                ("rt/lf/lowstate", low), ("rt/utlidar/robot_odom", "nav_msgs/msg/Odometry"),
                (TRUTH, "nav_msgs/msg/Odometry"),
            )
        }  # fmt: skip
        self._responses = {name: link.publish(f"rt/api/{name}/response", idl.Response) for name in VERSIONS}
        self._readers = [
            link.subscribe(
                f"rt/api/{name}/request",
                idl.Request,
                lambda request, when, name=name: self._request(name, request),
                reliable=True,
            )
            for name in VERSIONS
        ]
        self._thread = threading.Thread(target=self._run, name="simulated Go2", daemon=True)
        self._begun = 0.0

    def __enter__(self) -> Self:
        self._begun = time.time() - self.plant.seconds
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the robot: its topics fall silent."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        for reader in self._readers:
            reader.close()

    @property
    def requests(self) -> list[tuple[str, int, dict[str, Any]]]:
        """The last requests: service, number, parameter."""
        with self._turn:
            return list(self._requests)

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
                self._send_late()
                self._ended.wait(step - behind)
                continue
            if behind > LATEST:  # states of the past help nobody; the body moves on all the same
                with self._turn:
                    while time.monotonic() - start - self.plant.seconds > step:
                        self.plant.advance()
                        self.skipped += 1
            with self._turn:
                self.plant.advance()
                truth, believed, steps = self.plant.truth, self.plant.odometry, self.plant.steps
            try:
                self._tell(truth, believed, steps)
                if self._every_step is not None:
                    self._every_step(truth, self._begun + truth.pose.stamp)
            except DeviceError as error:
                warnings.warn(f"the simulated Go2 cannot send: {error}", stacklevel=2)
            self._send_late()

    def _tell(self, truth: Motion, believed: Motion, steps: int) -> None:
        host = self._begun + truth.pose.stamp
        robot = self.wire.robot_time(host, truth.pose.stamp)
        fields = sport_fields(believed, robot, self.error_code)
        slow = steps % SLOW == 0
        data = fields.to_bytes(self.wire.short)
        self._send("rt/sportmodestate", self._state(data))
        if slow:
            self._send("rt/lf/sportmodestate", self._state(data))
            self._send("rt/utlidar/robot_odom", odometry_of(believed, robot))
            self._send(TRUTH, odometry_of(truth, host, "world"))
        battery = self.wire.battery - int(truth.pose.stamp / 60)  # a full battery lasts for an hour and a half or so
        joints, gone = self.plant.joints, self.plant.settings.step * max(1, steps - self._told)
        rates = tuple((now - before) / gone for now, before in zip(joints, self._joints, strict=True))
        self._joints, self._told = joints, steps
        low = LowFields(
            fields.quaternion, fields.gyroscope, fields.accelerometer, fields.rpy,
            soc=max(0, battery), current=-3000, tick=int(1000 * truth.pose.stamp),
            wireless_remote=self.remote.to_bytes(), power_v=29.0, power_a=3.0,
            angles=joints, rates=rates,
        ).to_bytes()  # fmt: skip
        self._send("rt/lowstate", self._low(low))
        if slow:
            self._send("rt/lf/lowstate", self._low(low))

    # --- requests ---

    def _request(self, service: str, request: Any) -> None:
        if self._way.loses() or not self.switches.answers(service):
            return
        identity = request.header.identity
        code, data = self._obey(service, identity.api_id, request.parameter)
        if not request.header.policy.noreply:
            from eagor.robots.go2.idl import RequestIdentity, Response, ResponseHeader, ResponseStatus

            header = ResponseHeader(RequestIdentity(identity.id, identity.api_id), ResponseStatus(code))
            self._give(self._responses[service], Response(header, data, []))  # type: ignore[arg-type]

    def _obey(self, service: str, api_id: int, parameter: str) -> tuple[int, str]:
        """The status code and the data of a request, after doing it."""
        if api_id == API_VERSION:
            return 0, VERSIONS[service]
        try:
            asked = json.loads(parameter) if parameter else {}
            with self._turn:
                self._requests.append((service, api_id, asked))
                self.asked += 1
                if service == "sport":
                    return self._sport(api_id, asked)
                if service == "obstacles_avoid":
                    return self._avoiding(api_id, asked)
                return 0, self.switches.obey(service, api_id, asked)
        except ServiceError as error:
            return error.code, ""
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, DeviceError):
            return NOT_UNDERSTOOD, ""

    def _sport(self, api_id: int, asked: dict[str, Any]) -> tuple[int, str]:
        plain: dict[int, Callable[[], None]] = {
            Sport.DAMP: self.plant.damp, Sport.BALANCE_STAND: self.plant.balance_stand,
            Sport.STOP_MOVE: self.plant.stop, Sport.STAND_UP: self.plant.stand_up,
            Sport.STAND_DOWN: self.plant.stand_down, Sport.RECOVERY_STAND: self.plant.recover,
        }  # fmt: skip
        if api_id == Sport.MOVE:
            self.plant.move(*checked_velocity(asked["x"], asked["y"], asked["z"]))
        elif api_id in plain:
            plain[api_id]()
        else:
            return NOT_KNOWN, ""
        return 0, ""

    def _avoiding(self, api_id: int, asked: dict[str, Any]) -> tuple[int, str]:
        if api_id == Avoid.SWITCH_SET:
            self._avoid["enable"] = bool(asked["enable"])
        elif api_id == Avoid.SWITCH_GET:
            return 0, json.dumps({"enable": self._avoid["enable"]})
        elif api_id == Avoid.MOVE:
            wanted = checked_velocity(asked["x"], asked["y"], asked["yaw"])
            if all(self._avoid.values()) and asked.get("mode", 0) == 0:
                self.plant.move(*wanted, careful=True)
        elif api_id == Avoid.USE_REMOTE_COMMAND_FROM_API:
            self._avoid["is_remote_commands_from_api"] = bool(asked["is_remote_commands_from_api"])
        else:
            return NOT_KNOWN, ""
        return 0, ""

    # --- the wire ---

    def _send(self, topic: str, message: Any) -> None:
        if not self._way.loses():
            self._give(self._writers[topic], message)

    def _give(self, writer: Any, message: Any) -> None:
        if self.wire.delay[1] == 0:
            writer.write(message)
            return
        with self._turn:
            self._way.put(time.monotonic() + self._way.delay(), partial(writer.write, message))

    def _send_late(self) -> None:
        with self._turn:
            due = [*self._way.arrived(time.monotonic())]
        for _, send in due:
            send()
