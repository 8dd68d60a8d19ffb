"""What a Go2 says of itself: where it is and how it moves, its battery, its remote control.

Places come from its state messages, or from its lidar's odometry; battery and remote control from ``rt/lf/lowstate``
(20 Hz) or ``rt/lowstate``.

Messages are read as bytes (CDR, OMG DDSI-RTPS 10.2), since 200 of them come per second. The prefix of
``SportModeState`` is the same in both forms of the message, with and without the planned path, so that one decoder
reads both; types that cyclonedds decodes fit one form only.
"""

from __future__ import annotations

import struct
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from eagor.errors import DeviceError, FormatError
from eagor.media import Pose
from eagor.media.clocks import RelatedClock
from eagor.media.ros_messages import Encoded
from eagor.robots.dds import Link, Reader

__all__ = [
    "BUTTONS", "LONG", "LOW", "MODES", "MOTORS", "SHORT", "SOURCES", "BodyState", "Go2Low", "Go2State", "LowFields",
    "LowReading", "Remote", "SportFields", "checksum", "raw",
]  # fmt: skip

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
UNREADABLE = (  # a topic that is written, and of which nothing is heard
    "in a form that is not known, or nothing arrives: the robot's firmware is newer or another one than these, or a "
    "firewall holds back UDP"
)
KEPT = 2000  # states that wait for whoever iterates: 10 s at 200 Hz
LOOK = 1.0  # seconds between looks at who publishes

# The remote control's buttons by their bit in bytes 2 and 3, lowest first (Unitree's SDK: wireless_controller).
BUTTONS = (
    "R1", "L1", "start", "select", "R2", "L2", "F1", "F3", "A", "B", "X", "Y", "up", "right", "down", "left",
)  # fmt: skip
_STICKS = struct.Struct("<2x H f f f 4x f")  # buttons, left x, right x, right y, (unused), left y


@dataclass(frozen=True, eq=False)
class BodyState:
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
    mode: int | None = None
    error_code: int = 0
    gyroscope: np.ndarray | None = None
    accelerometer: np.ndarray | None = None
    body_height: float | None = None
    robot_stamp: float = 0.0
    received: float = 0.0

    @classmethod
    def of(cls, fields: SportFields, stamp: float, received: float) -> BodyState:
        """From the robot's own message, with its time on this machine's clock. Raises `FormatError` for no pose."""
        w, *xyz = fields.quaternion
        return cls(
            stamp, _rotation((*xyz, w)), _finite(fields.position), _finite(fields.velocity),
            float(_finite([fields.yaw_speed])[0]), fields.mode, fields.error_code, np.array(fields.gyroscope),
            np.array(fields.accelerometer), fields.body_height, fields.sec + 1e-9 * fields.nanosec, received,
        )  # fmt: skip

    @property
    def speed(self) -> float:
        """Metres per second over the ground."""
        return float(np.hypot(self.velocity[0], self.velocity[1]))


class Go2State:
    """The states of the Go2 on `link`; iterating gives `Pose` of the body, as `eagor.media.PoseSource`.

    `source`: a name of `SOURCES`. `received(state)` is called for each state, in a thread. `mount` ``(3,)``: the point
    of the body whose position is given when iterating, metres in the body frame (where the camera is). States come on
    this machine's clock: the robot's is related to it by `eagor.media.clocks.RelatedClock`; `news` says how.

    Both forms of the message are read. A message of another length, two publishers of the same topic, or a pose that is
    no pose are faults: everything here then raises `DeviceError` that says so; with two publishers, until one ends.
    """

    def __init__(
        self,
        link: Link,
        source: str = "sport",
        *,
        received: Callable[[BodyState], None] | None = None,
        mount: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        if source not in SOURCES:
            raise DeviceError(f"there is no odometry {source!r} of a Go2; wanted one of {', '.join(SOURCES)}")
        self.topic = SOURCES[source]
        self.clock = RelatedClock("Go2")
        self.count = self.dropped = 0
        self.news: deque[str] = deque(maxlen=20)  # about the robot's clock, in words
        self.bytes: int | None = None  # length of the message, which tells the firmware's form
        self._link, self._mount = link, np.asarray(mount, dtype=np.float64)
        self._told = received
        self._newest: BodyState | None = None
        self._wrong: str | None = None  # for good
        self._crowd = 0  # publishers, at the last look
        self._looked = 0.0
        self._ended = False
        self._turn = threading.Condition()
        self._waiting: deque[BodyState] = deque(maxlen=KEPT)
        self._readers = self._subscribed(source)

    # --- asking ---

    @property
    def newest(self) -> BodyState | None:
        """The last state; None before the first. Raises `DeviceError` for a fault."""
        self._check()
        return self._newest

    @property
    def fault(self) -> str | None:
        """What is wrong, in words; None if nothing is."""
        self._look()
        if self._wrong is None and self._crowd > 1:
            return (
                f"{self._crowd} publish {self.topic}, so the poses of different robots would mix: end all but one "
                "(a simulator?), or use another DDS domain or interface"
            )
        return self._wrong

    def wait(self, timeout: float = 5.0) -> BodyState:
        """The newest state; waits for the first. Raises `DeviceError` if none comes within `timeout` seconds."""
        end = time.monotonic() + timeout
        while True:
            with self._turn:
                self._turn.wait_for(lambda: self._newest is not None, min(0.1, max(0.0, end - time.monotonic())))
            self._check()
            if self._newest is not None:
                return self._newest
            if time.monotonic() >= end:
                raise DeviceError(self._silence(timeout))

    def __iter__(self) -> Iterator[Pose]:
        while True:
            with self._turn:
                self._turn.wait_for(lambda: self._waiting or self._ended, LOOK)
                state = self._waiting.popleft() if self._waiting else None
            if state is not None:
                yield Pose(state.stamp, state.world_R_body, state.position + state.world_R_body @ self._mount)
            elif self._ended:
                return
            self._check()

    def close(self) -> None:
        """Stop listening; who iterates comes to the end."""
        with self._turn:
            self._ended = True
            self._turn.notify_all()
        for reader in self._readers:
            reader.close()

    # --- listening ---

    def _subscribed(self, source: str) -> tuple[Reader, ...]:
        if source == "lidar":
            return (self._link.subscribe(self.topic, "nav_msgs/msg/Odometry", self._odometry),)
        from eagor.robots.go2.idl import ShortSportModeState, SportModeState

        # DDS hands over only what is announced as the reader's own type, so each form has a reader. A writer that
        # announces no type reaches both; the reader of the long form then takes the long ones.
        whole = self._link.subscribe(self.topic, raw(SportModeState), self._sport)

        def short(message: Any, when: float) -> None:
            if len(message.data) != LONG or not whole.matched:
                self._sport(message, when)

        return whole, self._link.subscribe(self.topic, raw(ShortSportModeState), short)

    def _sport(self, message: Any, when: float) -> None:
        try:
            fields = SportFields.from_bytes(message.data)
        except FormatError as error:
            self._wrong = str(error)
            raise
        self.bytes = len(message.data)
        self._take(BodyState.of(fields, when, when))

    def _odometry(self, message: Any, when: float) -> None:
        pose, twist, stamp = message.pose.pose, message.twist.twist, message.header.stamp
        turned = _rotation((pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w))
        place = _finite((pose.position.x, pose.position.y, pose.position.z))
        speed = _finite((twist.linear.x, twist.linear.y, twist.linear.z))  # in the body frame (nav_msgs/Odometry)
        turning = float(_finite([twist.angular.z])[0])
        said = stamp.sec + 1e-9 * stamp.nanosec
        self._take(BodyState(when, turned, place, turned @ speed, turning, robot_stamp=said, received=when))

    def _take(self, state: BodyState) -> None:
        if state.robot_stamp > 0:  # otherwise the robot tells no time, and the arrival counts
            stamp, news = self.clock.take(state.robot_stamp, state.received)
            if news:
                self.news.append(news)
            if stamp is None:
                return
            state = replace(state, stamp=stamp)
        with self._turn:
            self.dropped += len(self._waiting) == KEPT
            self._waiting.append(state)
            self._newest = state
            self.count += 1
            self._turn.notify_all()
        if self._told is not None:
            self._told(state)

    # --- faults ---

    def _check(self) -> None:
        if (fault := self.fault) is not None:
            raise DeviceError(fault)

    def _look(self) -> None:
        """Count who publishes, once in a while."""
        now = time.monotonic()
        if now - self._looked >= LOOK or self._crowd > 1:
            self._looked = now
            self._crowd = len(frozenset().union(*(reader.matched for reader in self._readers)))

    def _silence(self, timeout: float) -> str:
        """Why no state came."""
        where = f"domain {self._link.domain}, {self._link.interface or 'automatic interface'}"
        if kind := self._link.topics(0.5).get(self.topic):
            return f"somebody publishes {self.topic} as {kind}, but {UNREADABLE}"
        return (
            f"no robot is heard within {timeout:g} s ({self.topic}, {where}): is it on, is this machine on its network "
            "(192.168.123.x), and is the interface right?"
        )


def _rotation(xyzw: tuple[float, ...]) -> np.ndarray:
    """The rotation of a quaternion that may be somewhat too long or short."""
    size = float(np.linalg.norm(xyzw))
    if not abs(size - 1.0) < 0.1:
        raise FormatError(f"a state with the orientation {xyzw}; wanted a quaternion of length 1")
    return Rotation.from_quat(xyzw).as_matrix()


def _finite(values: Any) -> np.ndarray:
    array = np.array(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise FormatError(f"a state with the numbers {array.tolist()}; wanted finite ones")
    return array


@dataclass(frozen=True)
class Remote:
    """The remote control: `pressed` buttons of `BUTTONS`, and its sticks, -1 to 1 (right and forward are positive)."""

    pressed: frozenset[str] = frozenset()
    left: tuple[float, float] = (0.0, 0.0)
    right: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def from_bytes(cls, data: bytes) -> Remote:
        """From the 40 bytes of `wireless_remote`."""
        keys, left_x, right_x, right_y, left_y = _STICKS.unpack_from(data)
        pressed = frozenset(name for bit, name in enumerate(BUTTONS) if keys >> bit & 1)
        return cls(pressed, (left_x, left_y), (right_x, right_y))

    def to_bytes(self) -> bytes:
        """The 40 bytes."""
        keys = sum(1 << bit for bit, name in enumerate(BUTTONS) if name in self.pressed)
        return _STICKS.pack(keys, self.left[0], *self.right, self.left[1]).ljust(40, b"\0")


@dataclass(frozen=True)
class LowReading:
    """`received`: when, on this machine's clock; `soc`: the battery's charge, per cent; `tick`: the robot's own, ms."""

    received: float
    tick: int
    soc: int
    volts: float
    amperes: float
    remote: Remote


class Go2Low:
    """The newest of what a Go2 says of its battery and remote control. `fast`: the topic of 500 Hz instead of 20 Hz."""

    def __init__(self, link: Link, *, fast: bool = False) -> None:
        from eagor.robots.go2.idl import LowState

        self.topic = "rt/lowstate" if fast else "rt/lf/lowstate"
        self.newest: LowReading | None = None
        self._came = threading.Event()
        self._reader = link.subscribe(self.topic, raw(LowState), self._received)

    def wait(self, timeout: float = 5.0) -> LowReading:
        """The newest reading; waits for the first. Raises `DeviceError` if none comes within `timeout` seconds."""
        if not self._came.wait(timeout) or self.newest is None:
            raise DeviceError(f"no robot tells its battery within {timeout:g} s ({self.topic}); is one here?")
        return self.newest

    def close(self) -> None:
        """Stop listening."""
        self._reader.close()

    def _received(self, message: object, when: float) -> None:
        fields = LowFields.from_bytes(message.data)  # type: ignore[attr-defined]
        remote = Remote.from_bytes(fields.wireless_remote)
        self.newest = LowReading(when, fields.tick, fields.soc, fields.power_v, fields.power_a, remote)
        self._came.set()


# --- messages as bytes ------------------------------------------------------------------------------------------------

_STATE = "iI I 4f 3f 3f 3f B B2x f B3x f 3f f 3f f 4f 4h 12f 12f"
_MOTOR = "7f B3x I 2I"
_LOW = (
    "2B 2B 2I 2I H2x 4f 3f 3f 3f B "  # to the IMU's temperature; the first motor begins right after it
    + f"B2x {_MOTOR} "
    + f"B3x {_MOTOR} " * 19
    + "4B i H 2B 2B 15H 4h 4h I 40s B3x f 2B2x 2f 4H I I"
)
# The same members as a C++ compiler lays them out, which is what the checksum is of: structures begin at 4 bytes.
_LOW_NATIVE = "4B 4I H2x 13f B3x " + "B3x 7f B3x 3I" * 20 + "4B i H 4B 15H 8h I 40s B3x f 2B2x 2f 4H I"
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))  # bytes with their bits from right to left
MOTORS = 12  # of 20 places in the message: three joints of four legs
_PATH = 280  # bytes of the planned path: ten points of seven numbers
_HEAD = 4  # bytes before the message: how it is written
_LITTLE, _BIG = (b"\x00\x01", b"\x00\x07"), (b"\x00\x00", b"\x00\x06")  # CDR and plain CDR 2: alike for such members
SHORT = _HEAD + struct.calcsize("<" + _STATE)  # 236 bytes: without the planned path
LONG = SHORT + _PATH  # 516
LOW = _HEAD + struct.calcsize("<" + _LOW)  # 1180


@dataclass(frozen=True)
class SportFields:
    """What is used of ``SportModeState``: as `eagor.robots.go2.idl.SportModeState`, with times in seconds."""

    sec: int = 0
    nanosec: int = 0
    error_code: int = 0
    quaternion: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    gyroscope: tuple[float, ...] = (0.0, 0.0, 0.0)
    accelerometer: tuple[float, ...] = (0.0, 0.0, 0.0)
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)
    mode: int = 0
    progress: float = 0.0
    gait_type: int = 0
    foot_raise_height: float = 0.0
    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    body_height: float = 0.0
    velocity: tuple[float, ...] = (0.0, 0.0, 0.0)
    yaw_speed: float = 0.0

    @classmethod
    def from_bytes(cls, data: bytes) -> SportFields:
        """From a whole message. Raises `FormatError` for lengths that are neither form's."""
        if len(data) not in (SHORT, LONG):
            raise FormatError(
                f"the robot's state has {len(data)} bytes; known are {LONG} and {SHORT} (without a planned path). Its "
                "firmware is newer or another one than these: update this program, or the robot"
            )
        values = _values(_STATE, data)
        return cls(
            values[0], values[1], values[2], values[3:7], values[7:10], values[10:13], values[13:16],  # the temperature
            values[17], values[18], values[19], values[20], values[21:24], values[24], values[25:28], values[28],
        )  # fmt: skip

    def to_bytes(self, short: bool = False) -> bytes:
        """The whole message; nothing is planned, and no obstacle is near."""
        values = (
            self.sec, self.nanosec, self.error_code, *self.quaternion, *self.gyroscope, *self.accelerometer, *self.rpy,
            0, self.mode, self.progress, self.gait_type, self.foot_raise_height, *self.position, self.body_height,
            *self.velocity, self.yaw_speed,
        )  # fmt: skip
        packed = struct.pack("<" + _STATE, *values, *(0,) * 32)
        return b"\x00\x01\x00\x00" + packed + (b"" if short else bytes(_PATH))


@dataclass(frozen=True)
class LowFields:
    """What is used of ``LowState``: as `eagor.robots.go2.idl.LowState`."""

    quaternion: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    gyroscope: tuple[float, ...] = (0.0, 0.0, 0.0)
    accelerometer: tuple[float, ...] = (0.0, 0.0, 0.0)
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)
    soc: int = 0  # per cent
    current: int = 0  # milliamperes
    tick: int = 0  # milliseconds
    wireless_remote: bytes = field(default=bytes(40))
    power_v: float = 0.0  # volts
    power_a: float = 0.0  # amperes
    angles: tuple[float, ...] = (0.0,) * MOTORS  # radians, of the motors as in `eagor.robots.go2.plant.JOINTS`
    rates: tuple[float, ...] = (0.0,) * MOTORS  # radians per second

    @classmethod
    def from_bytes(cls, data: bytes) -> LowFields:
        """From a whole message. Raises `FormatError` for another length."""
        if len(data) != LOW:
            raise FormatError(f"the robot's low state has {len(data)} bytes; wanted {LOW}: its firmware is another one")
        values = _values(_LOW, data)
        imu, motors, bms = 9, 9 + 14, 9 + 14 + 20 * 12
        tick = bms + 5 + 1 + 4 + 15 + 8
        return cls(
            values[imu : imu + 4], values[imu + 4 : imu + 7], values[imu + 7 : imu + 10], values[imu + 10 : imu + 13],
            soc=values[bms + 3], current=values[bms + 4], tick=values[tick], wireless_remote=values[tick + 1],
            power_v=values[tick + 6], power_a=values[tick + 7], angles=values[motors + 1 : motors + 12 * MOTORS : 12],
            rates=values[motors + 2 : motors + 12 * MOTORS : 12],
        )  # fmt: skip

    def to_bytes(self) -> bytes:
        """The whole message with its checksum; all that is not here is 0. Motors that are there run in mode 1."""
        head = (0,) * 9
        joints = zip(self.angles, self.rates, strict=True)
        motors = [part for angle, rate in joints for part in (1, angle, rate, *(0,) * 9)] + [0] * (12 * (20 - MOTORS))
        values = (
            *head, *self.quaternion, *self.gyroscope, *self.accelerometer, *self.rpy, 0, *motors,
            0, 0, 0, self.soc, self.current, 0, *(0,) * 4, *(0,) * 15, *(0,) * 8,
            self.tick, self.wireless_remote, 0, 0.0, 0, 0, self.power_v, self.power_a, *(0,) * 4, 0,
        )  # fmt: skip
        crc = checksum(struct.pack("<" + _LOW_NATIVE, *values))
        return b"\x00\x01\x00\x00" + struct.pack("<" + _LOW, *values, crc)


def checksum(data: bytes) -> int:
    """Unitree's checksum of whole 32-bit words (little-endian): CRC-32/MPEG-2, each word from its highest bit on.

    That is the CRC of `zlib` with all bits the other way round and without the inversion at its end.
    """
    words = np.frombuffer(data, "<u4").byteswap().tobytes()
    return int(f"{zlib.crc32(words.translate(_REVERSED)) ^ 0xFFFFFFFF:032b}"[::-1], 2)


def _values(layout: str, data: bytes) -> tuple[Any, ...]:
    """The members of a message."""
    how = bytes(data[:2])
    if how not in _LITTLE + _BIG:
        raise FormatError(f"the robot's message is written in way {how.hex()}; wanted plain CDR (0001 or 0000)")
    order = "<" if how in _LITTLE else ">"
    return struct.unpack_from(order + layout, data, _HEAD)


@cache
def raw(kind: type) -> type[Encoded]:
    """A class for `Link` whose messages are bytes, announced as `kind` of `eagor.robots.go2.idl`."""
    about = {"__idl__": kind.__idl__, "__idl_typename__": kind.__idl_typename__}  # type: ignore[attr-defined]
    return type(kind.__name__, (Encoded,), about)
