"""A simulated Go2 on DDS, in real time: the topics, services and faults of the wire of a real one."""

from __future__ import annotations

import heapq
import itertools
import json
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable
from typing import Any, Self

import numpy as np

from eagor.errors import DeviceError
from eagor.robots.dds import Link
from eagor.robots.go2.low import Remote
from eagor.robots.go2.plant import Motion, Plant
from eagor.robots.go2.sim_services import NOT_KNOWN, VERSIONS, ServiceError, Switches
from eagor.robots.go2.sim_state import odometry_of, sport_fields
from eagor.robots.go2.sport import checked_velocity
from eagor.robots.go2.wire import LowFields, raw
from eagor.robots.go2.wire_settings import WireSettings

__all__ = ["TRUTH", "Go2Server"]

TRUTH = "rt/eagor/truth"  # the true pose (nav_msgs/Odometry): no robot has this topic
SLOW = 10  # steps between messages of the slow topics: 20 Hz at 200 Hz
NOT_UNDERSTOOD = 3204
KEPT = 1000  # requests
LATEST = 0.1  # seconds by which the simulation may lag behind before it skips


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
        self._rng = rng or np.random.default_rng()
        self._every_step = every_step
        self.switches = Switches(plant)
        self._joints, self._told = plant.joints, plant.steps  # at the last message of the motors
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
        if self._lost() or not self.switches.answers(service):
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
        plain = {
            1001: self.plant.damp, 1002: self.plant.balance_stand, 1003: self.plant.stop, 1004: self.plant.stand_up,
            1005: self.plant.stand_down, 1006: self.plant.recover,
        }  # fmt: skip
        if api_id == 1008:
            self.plant.move(*checked_velocity(asked["x"], asked["y"], asked["z"]))
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
            wanted = checked_velocity(asked["x"], asked["y"], asked["yaw"])
            if all(self._avoid.values()) and asked.get("mode", 0) == 0:
                self.plant.move(*wanted, careful=True)
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
