"""Unitree's state messages as bytes (CDR, OMG DDSI-RTPS 10.2): 200 of them come per second.

The prefix of ``SportModeState`` is the same in both forms of the message, with and without the planned path, so that
one decoder reads both; types that cyclonedds decodes fit one form only.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from eagor.errors import FormatError
from eagor.media.ros_messages import Encoded

__all__ = ["LONG", "LOW", "MOTORS", "SHORT", "LowFields", "SportFields", "checksum", "raw"]

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
            sec=values[0],
            nanosec=values[1],
            error_code=values[2],
            quaternion=values[3:7],
            gyroscope=values[7:10],
            accelerometer=values[10:13],
            rpy=values[13:16],  # then the temperature
            mode=values[17],
            progress=values[18],
            gait_type=values[19],
            foot_raise_height=values[20],
            position=values[21:24],
            body_height=values[24],
            velocity=values[25:28],
            yaw_speed=values[28],
        )

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
            values[imu : imu + 4],
            values[imu + 4 : imu + 7],
            values[imu + 7 : imu + 10],
            values[imu + 10 : imu + 13],
            soc=values[bms + 3],
            current=values[bms + 4],
            tick=values[tick],
            wireless_remote=values[tick + 1],
            power_v=values[tick + 6],
            power_a=values[tick + 7],
            angles=values[motors + 1 : motors + 12 * MOTORS : 12],
            rates=values[motors + 2 : motors + 12 * MOTORS : 12],
        )

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
