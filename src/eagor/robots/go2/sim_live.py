"""A simulated Go2 on DDS in real time: the topics, services and faults of a real one's wire, and the truth beside.

Programs of Unitree's SDK that command motors release the mode of motion first, or switch off ``sport_mode``; the joints
are limp then, and nobody answers commands to walk until a mode is selected again.
"""

from __future__ import annotations

import json
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, Self

import numpy as np

from eagor.errors import DeviceError
from eagor.robots.dds import Link
from eagor.robots.go2.plant import LIMP, Motion, Plant
from eagor.robots.go2.sim import SimulatedGo2, SimulatedWire, WireSettings, odometry_of, sport_fields
from eagor.robots.go2.sim_pictures import CAMERA_TOPIC, Moment, PictureProcess
from eagor.robots.go2.sport import API_VERSION, Avoid, Sport, checked_velocity
from eagor.robots.go2.state import SOURCES, Remote
from eagor.robots.go2.wire import LowFields, raw

__all__ = ["SERVICES", "TRUTH", "TRUTH_THINGS", "VERSIONS", "Go2Server", "LiveGo2", "ServiceError", "ServiceSwitches"]

VERSIONS = {
    "sport": "1.0.0.1", "obstacles_avoid": "1.0.0.2", "robot_state": "1.0.0.1", "motion_switcher": "1.0.0.1",
}  # fmt: skip
MOTION_MODES = ("normal", "ai", "mcf", "advanced")  # of motion; the first is on at the start
# Names of services, and whether they are protected from being switched off.
SERVICES = {"sport_mode": False, "obstacles_avoid": False, "robot_state": True, "motion_switcher": True}
WALKS = {"sport": "sport_mode", "obstacles_avoid": "obstacles_avoid"}  # the service behind a topic
NOT_KNOWN = 3203
SWITCH_FAILED, MODE_NOT_KNOWN = 5201, 7004
PROTECTED = 5  # status of a service that cannot be switched

TRUTH = "rt/eagor/truth"  # the true pose (nav_msgs/Odometry): no robot has this topic
SLOW = 10  # steps between messages of the slow topics: 20 Hz at 200 Hz
NOT_UNDERSTOOD = 3204
KEPT = 1000  # requests
LATEST = 0.1  # seconds by which the simulation may lag behind before it skips

TRUTH_THINGS = f"{TRUTH}/things"  # std_msgs/String: JSON of all things and where they are; no robot has this topic
LISTENING = 1.0  # seconds to hear whether another robot is there
THINGS_EVERY = 0.2  # seconds


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


class LiveGo2:
    """`robot` on DDS domain `domain`, in real time; a context manager.

    Raises `DeviceError` if a robot, real or simulated, already speaks there: commands would reach both.
    """

    def __init__(self, robot: SimulatedGo2, domain: int = 0, interface: str | None = "lo") -> None:
        from eagor.media.ros_messages import TEXT

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
            from eagor.media.ros_messages import text_message

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
