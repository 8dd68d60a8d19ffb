"""Unitree's DDS messages, as types of cyclonedds. Needs the extra ``robot``.

Names, members and their order are those of Unitree's SDK (``unitree_go``, ``unitree_api``); they are the wire. Every
octet is a `byte`: ``uint8`` and ``int8`` have the same bytes, but cyclonedds 11 announces them in a way that ends every
process with Cyclone 0.10 that hears it, and such processes run on the robot (measured).
"""
# No `from __future__ import annotations`: cyclonedds reads the annotations themselves.

from dataclasses import dataclass
from typing import TypeVar, dataclass_transform

from eagor._extras import need

need("Unitree's messages", "robot", "cyclonedds")

from cyclonedds.idl import IdlStruct, make_idl_struct  # noqa: E402
from cyclonedds.idl.annotations import autoid, final  # noqa: E402
from cyclonedds.idl.types import array, byte, float32, int16, int32, int64, sequence, uint16, uint32  # noqa: E402

__all__ = [
    "BmsState", "IMUState", "LowState", "MotorState", "PathPoint", "Request", "RequestHeader", "RequestIdentity",
    "RequestLease", "RequestPolicy", "Response", "ResponseHeader", "ResponseStatus", "ShortSportModeState",
    "SportModeState", "TimeSpec",
]  # fmt: skip


Kind = TypeVar("Kind", bound=type[IdlStruct])


@dataclass_transform()
def _message(kind: Kind) -> Kind:
    """A message as Unitree's compiler makes it: it cannot grow, and its members are numbered in their order."""
    return dataclass(final(autoid("sequential")(kind)))


@_message
class TimeSpec(IdlStruct, typename="unitree_go.msg.dds_.TimeSpec_"):
    """A time of the robot's clock."""

    sec: int32
    nanosec: uint32


@_message
class IMUState(IdlStruct, typename="unitree_go.msg.dds_.IMUState_"):
    """`quaternion` w, x, y, z (world_R_body); rad/s, m/s^2 and radians in the body frame; degrees Celsius."""

    quaternion: array[float32, 4]
    gyroscope: array[float32, 3]
    accelerometer: array[float32, 3]
    rpy: array[float32, 3]
    temperature: byte


@_message
class PathPoint(IdlStruct, typename="unitree_go.msg.dds_.PathPoint_"):
    """A point of a planned path."""

    t_from_start: float32
    x: float32
    y: float32
    yaw: float32
    vx: float32
    vy: float32
    vyaw: float32


@_message
class SportModeState(IdlStruct, typename="unitree_go.msg.dds_.SportModeState_"):
    """What the robot's walking says of itself: ``rt/sportmodestate``, ``rt/lf/sportmodestate``."""

    stamp: TimeSpec
    error_code: uint32
    imu_state: IMUState
    mode: byte
    progress: float32
    gait_type: byte
    foot_raise_height: float32
    position: array[float32, 3]
    body_height: float32
    velocity: array[float32, 3]
    yaw_speed: float32
    range_obstacle: array[float32, 4]
    foot_force: array[int16, 4]
    foot_position_body: array[float32, 12]
    foot_speed_body: array[float32, 12]
    path_point: array[PathPoint, 10]


# The same without the planned path, as Unitree's ROS 2 package has it.
_SHORT = {name: kind for name, kind in SportModeState.__annotations__.items() if name != "path_point"}
ShortSportModeState = _message(make_idl_struct("ShortSportModeState", SportModeState.__idl_typename__, _SHORT))


@_message
class MotorState(IdlStruct, typename="unitree_go.msg.dds_.MotorState_"):
    """One of the motors."""

    mode: byte
    q: float32
    dq: float32
    ddq: float32
    tau_est: float32
    q_raw: float32
    dq_raw: float32
    ddq_raw: float32
    temperature: byte
    lost: uint32
    reserve: array[uint32, 2]


@_message
class BmsState(IdlStruct, typename="unitree_go.msg.dds_.BmsState_"):
    """The battery: `soc` in percent, `current` in milliamperes, voltages of the cells in millivolts."""

    version_high: byte
    version_low: byte
    status: byte
    soc: byte
    current: int32
    cycle: uint16
    bq_ntc: array[byte, 2]
    mcu_ntc: array[byte, 2]
    cell_vol: array[uint16, 15]


@_message
class LowState(IdlStruct, typename="unitree_go.msg.dds_.LowState_"):
    """Motors, battery, remote control: ``rt/lowstate``, ``rt/lf/lowstate``. `tick`: milliseconds; no time of day."""

    head: array[byte, 2]
    level_flag: byte
    frame_reserve: byte
    sn: array[uint32, 2]
    version: array[uint32, 2]
    bandwidth: uint16
    imu_state: IMUState
    motor_state: array[MotorState, 20]
    bms_state: BmsState
    foot_force: array[int16, 4]
    foot_force_est: array[int16, 4]
    tick: uint32
    wireless_remote: array[byte, 40]
    bit_flag: byte
    adc_reel: float32
    temperature_ntc1: byte
    temperature_ntc2: byte
    power_v: float32
    power_a: float32
    fan_frequency: array[uint16, 4]
    reserve: uint32
    crc: uint32


@_message
class RequestIdentity(IdlStruct, typename="unitree_api.msg.dds_.RequestIdentity_"):
    """A request's number, which its response repeats, and what is asked for."""

    id: int64
    api_id: int64


@_message
class RequestLease(IdlStruct, typename="unitree_api.msg.dds_.RequestLease_"):
    """Who may command; 0 without a lease."""

    id: int64


@_message
class RequestPolicy(IdlStruct, typename="unitree_api.msg.dds_.RequestPolicy_"):
    """Whether a response is wanted."""

    priority: int32
    noreply: bool


@_message
class RequestHeader(IdlStruct, typename="unitree_api.msg.dds_.RequestHeader_"):
    """What every request begins with."""

    identity: RequestIdentity
    lease: RequestLease
    policy: RequestPolicy


@_message
class Request(IdlStruct, typename="unitree_api.msg.dds_.Request_"):
    """``rt/api/SERVICE/request``; `parameter` is JSON."""

    header: RequestHeader
    parameter: str
    binary: sequence[byte]


@_message
class ResponseStatus(IdlStruct, typename="unitree_api.msg.dds_.ResponseStatus_"):
    """0, or what went wrong (`eagor.robots.go2.sport.CODES`)."""

    code: int32


@_message
class ResponseHeader(IdlStruct, typename="unitree_api.msg.dds_.ResponseHeader_"):
    """What every response begins with."""

    identity: RequestIdentity
    status: ResponseStatus


@_message
class Response(IdlStruct, typename="unitree_api.msg.dds_.Response_"):
    """``rt/api/SERVICE/response``; `data` is JSON or empty."""

    header: ResponseHeader
    data: str
    binary: sequence[byte]
