"""Unitree's messages, and what a Go2 says in them: where it is and how it moves, its battery, its remote control.

Needs the extra ``robot``. Names, members and their order are those of Unitree's SDK (``unitree_go``, ``unitree_api``)
and of ROS 2; they are the wire. Every octet is a `byte`: ``uint8`` and ``int8`` have the same bytes, but cyclonedds 11
announces them in a way that ends every process with Cyclone 0.10 that hears it, and such processes run on the robot
(measured).

States are read as bytes (CDR, OMG DDSI-RTPS 10.2), since 200 of them come per second. The beginning of
``SportModeState`` is the same in both forms of the message, with and without the planned path, so that one decoder
reads both; types that cyclonedds decodes fit one form only.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from eagor._extras import need
from eagor.errors import DeviceError, FormatError
from eagor.odometry.clocks import ClockSync
from eagor.robots.dds import Participant, raw

need("Unitree's messages", "robot", "cyclonedds")

from cyclonedds.idl import make_idl_struct  # noqa: E402
from cyclonedds.idl.annotations import autoid, final  # noqa: E402
from cyclonedds.idl.types import array, byte, float32, float64, int16, int32, int64, sequence, uint16, uint32  # noqa: E402

__all__ = [
    "BUTTONS", "LONG", "MODES", "SHORT", "SOURCES", "BodyState", "Go2Low", "Go2State", "LowReading", "low_state",
    "sport_state",
]  # fmt: skip

# --- messages as types ------------------------------------------------------------------------------------------------


def _message(name: str, package: str, /, **members: Any) -> Any:
    """A message as Unitree's compiler makes it: it cannot grow, and its members are numbered in their order."""
    return final(autoid("sequential")(make_idl_struct(name, f"{package}.msg.dds_.{name}_", members)))


_GO, _API = "unitree_go", "unitree_api"
_STAMP = _message("TimeSpec", _GO, sec=int32, nanosec=uint32)
_IMU = _message(
    "IMUState", _GO, quaternion=array[float32, 4], gyroscope=array[float32, 3], accelerometer=array[float32, 3],
    rpy=array[float32, 3], temperature=byte,
)  # fmt: skip
_POINT = _message(
    "PathPoint", _GO, t_from_start=float32, x=float32, y=float32, yaw=float32, vx=float32, vy=float32, vyaw=float32,
)  # fmt: skip
_SPORT = dict(
    stamp=_STAMP, error_code=uint32, imu_state=_IMU, mode=byte, progress=float32,
    gait_type=byte, foot_raise_height=float32, position=array[float32, 3], body_height=float32,
    velocity=array[float32, 3], yaw_speed=float32, range_obstacle=array[float32, 4], foot_force=array[int16, 4],
    foot_position_body=array[float32, 12], foot_speed_body=array[float32, 12],
)  # fmt: skip
SportModeState = _message("SportModeState", _GO, **_SPORT, path_point=array[_POINT, 10])
ShortSportModeState = _message("SportModeState", _GO, **_SPORT)  # as Unitree's ROS 2 package has it

_MOTOR = _message(
    "MotorState", _GO, mode=byte, q=float32, dq=float32, ddq=float32, tau_est=float32, q_raw=float32, dq_raw=float32,
    ddq_raw=float32, temperature=byte, lost=uint32, reserve=array[uint32, 2],
)  # fmt: skip
_BATTERY = _message(
    "BmsState", _GO, version_high=byte, version_low=byte, status=byte, soc=byte, current=int32, cycle=uint16,
    bq_ntc=array[byte, 2], mcu_ntc=array[byte, 2], cell_vol=array[uint16, 15],
)  # fmt: skip
LowState = _message(
    "LowState", _GO, head=array[byte, 2], level_flag=byte, frame_reserve=byte, sn=array[uint32, 2],
    version=array[uint32, 2], bandwidth=uint16, imu_state=_IMU, motor_state=array[_MOTOR, 20],
    bms_state=_BATTERY, foot_force=array[int16, 4], foot_force_est=array[int16, 4], tick=uint32,
    wireless_remote=array[byte, 40], bit_flag=byte, adc_reel=float32, temperature_ntc1=byte, temperature_ntc2=byte,
    power_v=float32, power_a=float32, fan_frequency=array[uint16, 4], reserve=uint32, crc=uint32,
)  # fmt: skip

RequestIdentity = _message("RequestIdentity", _API, id=int64, api_id=int64)
RequestLease = _message("RequestLease", _API, id=int64)
RequestPolicy = _message("RequestPolicy", _API, priority=int32, noreply=bool)
RequestHeader = _message("RequestHeader", _API, identity=RequestIdentity, lease=RequestLease, policy=RequestPolicy)
Request = _message("Request", _API, header=RequestHeader, parameter=str, binary=sequence[byte])
ResponseStatus = _message("ResponseStatus", _API, code=int32)
ResponseHeader = _message("ResponseHeader", _API, identity=RequestIdentity, status=ResponseStatus)
Response = _message("Response", _API, header=ResponseHeader, data=str, binary=sequence[byte])

Time = _message("Time", "builtin_interfaces", sec=int32, nanosec=uint32)
Header = _message("Header", "std_msgs", stamp=Time, frame_id=str)
CompressedImage = _message("CompressedImage", "sensor_msgs", header=Header, format=str, data=sequence[byte])
Vector3 = _message("Vector3", "geometry_msgs", x=float64, y=float64, z=float64)
Point = _message("Point", "geometry_msgs", x=float64, y=float64, z=float64)
Quaternion = _message("Quaternion", "geometry_msgs", x=float64, y=float64, z=float64, w=float64)
RosPose = _message("Pose", "geometry_msgs", position=Point, orientation=Quaternion)
RosPoses = _message("PoseWithCovariance", "geometry_msgs", pose=RosPose, covariance=array[float64, 36])
Twist = _message("Twist", "geometry_msgs", linear=Vector3, angular=Vector3)
Twists = _message("TwistWithCovariance", "geometry_msgs", twist=Twist, covariance=array[float64, 36])
Odometry = _message("Odometry", "nav_msgs", header=Header, child_frame_id=str, pose=RosPoses, twist=Twists)

# --- what is said -----------------------------------------------------------------------------------------------------

# Topics of the robot's own estimate of its pose, by the name that options give them.
SOURCES = {
    "sport": "rt/sportmodestate",  # 200 Hz or more
    "slow": "rt/lf/sportmodestate",  # 20 Hz
    "lidar": "rt/utlidar/robot_odom",  # nav_msgs/Odometry
}
# `BodyState.mode` in words (Unitree's sports services).
MODES = {
    0: "idle", 1: "standing", 2: "posing", 3: "walking", 5: "lying", 6: "standing with locked joints", 7: "limp",
    8: "getting up", 10: "sitting",
}  # fmt: skip
WALKING = 3

# The remote control's buttons by their bit in bytes 2 and 3, lowest first (Unitree's SDK: wireless_controller).
BUTTONS = (
    "R1", "L1", "start", "select", "R2", "L2", "F1", "F3", "A", "B", "X", "Y", "up", "right", "down", "left",
)  # fmt: skip

# The beginning of ``SportModeState``: stamp, error, quaternion; mode; position; velocity and yaw speed.
_STATE = struct.Struct("<iI I 4f 37x B 14x 3f 4x 4f")
SHORT, LONG = 236, 516  # bytes without and with the planned path, of which 4 say how the message is written
_LITTLE = (b"\x00\x01", b"\x00\x07")  # CDR and plain CDR 2, little-endian: alike for such members


class BodyState(NamedTuple):
    """What the robot says at one time.

    `stamp`: of the measurement, on this machine's clock (``time.time()``). `world_R_body` ``(3, 3)`` and `position`
    ``(3,)`` (metres) of the body in the robot's odometry frame, whose z points up. `velocity` ``(3,)``: metres per
    second along the axes of that frame (the firmware's documents do not say which frame; its size is sure). `yaw_rate`:
    radians per second, left is positive. `mode` (`MODES`) is None where the source knows none. `error_code`: 0 if the
    robot is well. `robot_stamp`: on the robot's clock; `received`: when it came.
    """

    stamp: float
    world_R_body: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    yaw_rate: float
    mode: int | None
    error_code: int
    robot_stamp: float
    received: float

    @property
    def speed(self) -> float:
        """Metres per second over the ground."""
        return float(np.hypot(self.velocity[0], self.velocity[1]))


class Go2State:
    """The states of the Go2 on `link`, on this machine's clock, to which the robot's `clock` is related.

    `source`: a name of `SOURCES`. `received(state)` is called for each state, in a thread. `newest`: the last one;
    `count`: how many came; `bytes`: the length of the message, which tells the firmware's form.

    Both forms of the message are read. A state without a pose is left out. A message of another length, and two
    publishers of the same topic until one ends, are a `fault`.
    """

    def __init__(
        self, link: Participant, source: str = "sport", *, received: Callable[[BodyState], None] = lambda state: None
    ) -> None:
        if source not in SOURCES:
            raise DeviceError(f"there is no odometry {source!r} of a Go2; wanted one of {', '.join(SOURCES)}")
        self.topic, self.clock = SOURCES[source], ClockSync("Go2")
        self.count, self.bytes = 0, 0
        self.newest: BodyState | None = None
        self._link, self._received, self._turn = link, received, threading.Lock()
        self._wrong: str | None = None  # for good
        if source == "lidar":
            self._readers = [link.subscribe(self.topic, Odometry, self._odometry)]
            return
        # DDS hands over only what is announced as the reader's own type, so each form has a reader. A writer that
        # announces no type reaches both; the reader of the long form then takes the long ones.
        whole = link.subscribe(self.topic, raw(SportModeState), self._sport)

        def short(message: Any, when: float) -> None:
            if len(message.data) != LONG or not whole.matched:
                self._sport(message, when)

        self._readers = [whole, link.subscribe(self.topic, raw(ShortSportModeState), short)]

    @property
    def fault(self) -> str | None:
        """What is wrong, in words; None if nothing is."""
        writers = len({writer for reader in self._readers for writer in reader.matched})
        if self._wrong is None and writers > 1:
            return (
                f"{writers} publish {self.topic}, so the poses of different robots would mix: end all but one (a "
                "simulator?), or use another DDS domain or interface"
            )
        return self._wrong

    def silence(self, topics: dict[str, str]) -> str | None:
        """Why there is no state although somebody publishes it, as `topics` tell; None if nobody does."""
        if self.topic not in topics:
            return None
        why = next((reader.problem for reader in self._readers if reader.problem), None) or (
            "in a form that is not known, or nothing arrives: the robot's firmware is newer or another one than these, "
            "or a firewall holds back UDP"
        )
        return f"{self.topic} is published as {topics[self.topic]}, but {why}"

    def wait(self, timeout: float = 5.0) -> BodyState:
        """The newest state; waits for the first. Raises `DeviceError` if none comes in time, and for a `fault`."""
        end = time.monotonic() + timeout
        while (fault := self.fault) is None and self.newest is None and time.monotonic() < end:
            time.sleep(0.01)
        if fault is not None:
            raise DeviceError(fault)
        if self.newest is None:
            raise DeviceError(
                self.silence(self._link.topics(0.5))
                or f"no robot is heard within {timeout:g} s ({self.topic}, {self._link}): is it on, is this machine on "
                "its network (192.168.123.x), and is the interface right?"
            )
        return self.newest

    def _sport(self, message: Any, when: float) -> None:
        data = message.data
        if len(data) not in (SHORT, LONG) or data[:2] not in _LITTLE:
            self._wrong = (
                f"the robot's state has {len(data)} bytes, written in way {data[:2].hex()}; known are {LONG} and "
                f"{SHORT} (without a planned path) in way 0001. Its firmware is newer or another one than these: "
                "update this program, or the robot"
            )
            raise FormatError(self._wrong)
        self.bytes = len(data)
        sec, nanosec, error_code, w, x, y, z, mode, *motion = _STATE.unpack_from(data, 4)
        self._take(when, sec + 1e-9 * nanosec, _rotation(x, y, z, w), np.array(motion), mode, error_code)

    def _odometry(self, message: Any, when: float) -> None:
        at, q, stamp = message.pose.pose.position, message.pose.pose.orientation, message.header.stamp
        v, turning = message.twist.twist.linear, message.twist.twist.angular.z
        turned = _rotation(q.x, q.y, q.z, q.w)
        motion = np.array([at.x, at.y, at.z, *(turned @ (v.x, v.y, v.z)), turning])  # it was in the body frame
        self._take(when, stamp.sec + 1e-9 * stamp.nanosec, turned, motion, None, 0)

    def _take(
        self, when: float, stamp: float, turned: np.ndarray, motion: np.ndarray, mode: int | None, error_code: int
    ) -> None:
        if not np.isfinite(motion).all():
            raise FormatError(f"a state has the numbers {motion.tolist()}; wanted finite ones")
        # A robot that tells no time: the arrival counts.
        ours = self.clock.take(stamp, when)[0] if stamp > 0 else when
        if ours is None:
            return
        state = BodyState(ours, turned, motion[:3], motion[3:6], float(motion[6]), mode, error_code, stamp, when)
        with self._turn:  # there may be two readers
            self.newest, self.count = state, self.count + 1
        self._received(state)


def _rotation(*xyzw: float) -> np.ndarray:
    """The rotation of a quaternion that may be somewhat too long or short."""
    size = float(np.linalg.norm(xyzw))
    if size == 0:
        raise FormatError(
            "the robot has not told its orientation yet (its quaternion is [0, 0, 0, 0], which is unset): its IMU or "
            "its walking has not started; wait until it stands, or restart it"
        )
    if not abs(size - 1.0) < 0.1:
        raise FormatError(f"a state has the orientation {xyzw}; wanted a quaternion of length 1")
    return Rotation.from_quat(xyzw).as_matrix()


class LowReading(NamedTuple):
    """`received`: when; the battery's charge `soc`, per cent, and `volts`; which `BUTTONS` are `pressed`."""

    received: float
    soc: int
    volts: float
    pressed: frozenset[str]


class Go2Low:
    """The newest of what a Go2 says of its battery and remote control, 20 times a second."""

    topic = "rt/lf/lowstate"

    def __init__(self, link: Participant) -> None:
        self.newest: LowReading | None = None
        link.subscribe(self.topic, LowState, self._received)

    def _received(self, message: Any, when: float) -> None:
        low, high = message.wireless_remote[2:4]
        pressed = frozenset(name for bit, name in enumerate(BUTTONS) if (low | high << 8) >> bit & 1)
        self.newest = LowReading(when, message.bms_state.soc, message.power_v, pressed)


# --- what a simulated robot says --------------------------------------------------------------------------------------


def sport_state(
    stamp: float, wxyz: Any = (1, 0, 0, 0), gyroscope: Any = (0, 0, 0), accelerometer: Any = (0, 0, 0),
    rpy: Any = (0, 0, 0), mode: int = 1, position: Any = (0, 0, 0), velocity: Any = (0, 0, 0), yaw_speed: float = 0.0,
    error_code: int = 0, *, short: bool = False,
) -> bytes:  # fmt: skip
    """A ``SportModeState`` at `stamp` seconds of the robot's clock, as bytes; all that is not here is 0."""
    body = struct.pack(
        "<iI I 4f 3f 3f 3f x B 2x 4x B 3x 4x 3f f 3f f", *divmod(int(1e9 * stamp), 10**9), error_code, *wxyz,
        *gyroscope, *accelerometer, *rpy, mode, mode == WALKING, *position, position[2], *velocity, yaw_speed,
    )  # fmt: skip
    return (b"\x00\x01\x00\x00" + body).ljust(SHORT if short else LONG, b"\0")


def low_state(pressed: Iterable[str] = (), soc: int = 100, volts: float = 29.0, seconds: float = 0.0) -> Any:
    """A ``LowState`` that many seconds after the robot's start; all that is not here is 0."""
    message = LowState.deserialize(b"\x00\x01\x00\x00" + bytes(1176))
    keys = sum(1 << BUTTONS.index(name) for name in pressed)
    message.wireless_remote = bytes(2) + keys.to_bytes(2, "little") + bytes(36)
    message.bms_state.soc, message.power_v, message.tick = soc, volts, int(1000 * seconds)
    return message
