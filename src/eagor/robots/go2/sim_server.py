"""A simulated Go2 on DDS, in real time: the topics, services and faults of the wire of a real one."""

from __future__ import annotations

import heapq
import itertools
import json
import threading
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation

from eagor._checks import require, stretch, within
from eagor.errors import DeviceError
from eagor.robots.dds import Link
from eagor.robots.dds.ros_types import store
from eagor.robots.go2.low import Remote
from eagor.robots.go2.plant import GRAVITY, Motion, Plant
from eagor.robots.go2.wire import LowFields, SportFields, raw

__all__ = ["TRUTH", "Go2Server", "WireSettings"]

TRUTH = "rt/eagor/truth"  # the true pose (nav_msgs/Odometry): no robot has this topic
SLOW = 10  # steps between messages of the slow topics: 20 Hz at 200 Hz
VERSIONS = {"sport": "1.0.0.1", "obstacles_avoid": "1.0.0.2"}
NOT_KNOWN, NOT_UNDERSTOOD = 3203, 3204
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
        self.requests: list[tuple[str, int, dict[str, Any]]] = []  # (service, number, parameter): the last 1000
        self.skipped = 0  # steps that no state tells of: this machine was too slow
        self._rng = rng or np.random.default_rng()
        self._every_step = every_step
        self._avoid = {"enable": False, "is_remote_commands_from_api": False}
        self._turn = threading.RLock()
        self._ended = threading.Event()
        self._late: list[tuple[float, int, Any, Any]] = []  # when to send, number, writer, message
        self._numbers = itertools.count()
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
        self._begun = time.time()
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
            except DeviceError as error:
                warnings.warn(f"the simulated Go2 cannot send: {error}", stacklevel=2)
            self._send_late()

    def _tell(self, truth: Motion, believed: Motion, steps: int) -> None:
        host = self._begun + truth.pose.stamp
        robot = host + self.wire.clock_offset + self.wire.clock_drift * truth.pose.stamp
        fields = self._fields(believed, robot)
        slow = steps % SLOW == 0
        data = fields.to_bytes(self.wire.short)
        self._send("rt/sportmodestate", self._state(data))
        if slow:
            self._send("rt/lf/sportmodestate", self._state(data))
            self._send("rt/utlidar/robot_odom", odometry_message(believed, robot, "odom", "base_link"))
            self._send(TRUTH, odometry_message(truth, host, "world", "base_link"))
        battery = self.wire.battery - int(truth.pose.stamp / 60)  # a full battery lasts for an hour and a half or so
        low = LowFields(
            fields.quaternion, fields.gyroscope, fields.accelerometer, fields.rpy,
            soc=max(0, battery), current=-3000, tick=int(1000 * truth.pose.stamp),
            wireless_remote=self.remote.to_bytes(), power_v=29.0, power_a=3.0,
        ).to_bytes()  # fmt: skip
        self._send("rt/lowstate", self._low(low))
        if slow:
            self._send("rt/lf/lowstate", self._low(low))

    def _fields(self, motion: Motion, stamp: float) -> SportFields:
        pose = motion.pose
        assert pose.position is not None
        up = pose.world_R_body.T @ (0.0, 0.0, GRAVITY)
        turned = Rotation.from_matrix(pose.world_R_body)
        x, y, z, w = turned.as_quat()
        yaw, pitch, roll = turned.as_euler("ZYX")
        return SportFields(
            int(stamp),
            int(1e9 * (stamp - int(stamp))),
            self.error_code,
            (w, x, y, z),
            tuple(motion.rates),
            tuple(up),
            (roll, pitch, yaw),
            motion.mode,
            gait_type=1 if motion.mode == 3 else 0,
            foot_raise_height=0.09,
            position=tuple(pose.position),
            body_height=float(pose.position[2]),
            velocity=tuple(motion.velocity),
            yaw_speed=motion.yaw_rate,
        )

    # --- requests ---

    def _request(self, service: str, request: Any) -> None:
        if self._lost():
            return
        identity = request.header.identity
        code, data = self._obey(service, identity.api_id, request.parameter)
        if not request.header.policy.noreply:
            from eagor.robots.go2.idl import RequestIdentity, Response, ResponseHeader, ResponseStatus

            header = ResponseHeader(RequestIdentity(identity.id, identity.api_id), ResponseStatus(code))
            self._give(self._responses[service], Response(header, data, []))  # type: ignore[arg-type]

    def _obey(self, service: str, api_id: int, parameter: str) -> tuple[int, str]:
        """The status code and the data of a request, after doing it."""
        if api_id == 1:
            return 0, VERSIONS[service]
        try:
            asked = json.loads(parameter) if parameter else {}
            with self._turn:
                self.requests = [*self.requests[-999:], (service, api_id, asked)]
                return (self._sport if service == "sport" else self._avoiding)(api_id, asked)
        except (ValueError, KeyError, TypeError, AttributeError):
            return NOT_UNDERSTOOD, ""

    def _sport(self, api_id: int, asked: dict[str, Any]) -> tuple[int, str]:
        plain = {
            1001: self.plant.damp, 1002: self.plant.balance_stand, 1003: self.plant.stop, 1004: self.plant.stand_up,
            1005: self.plant.stand_down, 1006: self.plant.recover,
        }  # fmt: skip
        if api_id == 1008:
            self.plant.move(float(asked["x"]), float(asked["y"]), float(asked["z"]))
        elif api_id in plain:
            plain[api_id]()
        else:
            return NOT_KNOWN, ""
        return 0, ""

    def _avoiding(self, api_id: int, asked: dict[str, Any]) -> tuple[int, str]:
        if api_id == 1001:
            self._avoid["enable"] = bool(asked["enable"])
        elif api_id == 1002:
            return 0, json.dumps({"enable": self._avoid["enable"]})
        elif api_id == 1003:
            if all(self._avoid.values()) and asked.get("mode", 0) == 0:
                self.plant.move(float(asked["x"]), float(asked["y"]), float(asked["yaw"]), careful=True)
        elif api_id == 1004:
            self._avoid["is_remote_commands_from_api"] = bool(asked["is_remote_commands_from_api"])
        else:
            return NOT_KNOWN, ""
        return 0, ""

    # --- the wire ---

    def _send(self, topic: str, message: Any) -> None:
        if not self._lost():
            self._give(self._writers[topic], message)

    def _lost(self) -> bool:
        return self.wire.drop > 0 and bool(self._rng.random() < self.wire.drop)

    def _give(self, writer: Any, message: Any) -> None:
        low, high = self.wire.delay
        if high == 0:
            writer.write(message)
            return
        with self._turn:
            due = time.monotonic() + float(self._rng.uniform(low, high))
            heapq.heappush(self._late, (due, next(self._numbers), writer, message))

    def _send_late(self) -> None:
        while True:
            with self._turn:
                if not self._late or self._late[0][0] > time.monotonic():
                    return
                _, _, writer, message = heapq.heappop(self._late)
            writer.write(message)


def odometry_message(motion: Motion, stamp: float, frame: str, child: str) -> Any:
    """A nav_msgs/Odometry of `motion`; the twist is in the body frame, as that message wants it."""
    types = store().types
    pose = motion.pose
    assert pose.position is not None
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    x, y, z, w = Rotation.from_matrix(pose.world_R_body).as_quat().tolist()
    velocity = pose.world_R_body.T @ motion.velocity
    second = int(stamp)
    time_of = types["builtin_interfaces/msg/Time"](sec=second, nanosec=int(1e9 * (stamp - second)))
    header = types["std_msgs/msg/Header"](stamp=time_of, frame_id=frame)
    placed = types["geometry_msgs/msg/Pose"](
        position=point(*map(float, pose.position)),
        orientation=types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
    )
    twist = types["geometry_msgs/msg/Twist"](
        linear=vector(*map(float, velocity)), angular=vector(*map(float, motion.rates))
    )
    nothing = np.zeros(36)
    return types["nav_msgs/msg/Odometry"](
        header=header,
        child_frame_id=child,
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=placed, covariance=nothing),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=nothing),
    )
