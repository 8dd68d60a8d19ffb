"""Unitree's DDS messages, as types of cyclonedds. Needs the extra ``robot``.

Names, members and their order are those of Unitree's SDK (``unitree_go``, ``unitree_api``); they are the wire. Every
octet is a `byte`: ``uint8`` and ``int8`` have the same bytes, but cyclonedds 11 announces them in a way that ends every
process with Cyclone 0.10 that hears it, and such processes run on the robot (measured).
"""

from __future__ import annotations

from typing import Any

from eagor._extras import need

need("Unitree's messages", "robot", "cyclonedds")

from cyclonedds.idl import make_idl_struct  # noqa: E402
from cyclonedds.idl.annotations import autoid, final  # noqa: E402
from cyclonedds.idl.types import array, byte, float32, int16, int32, int64, sequence, uint16, uint32  # noqa: E402

__all__ = [
    "BmsState", "IMUState", "LowState", "MotorState", "PathPoint", "Request", "RequestHeader", "RequestIdentity",
    "RequestLease", "RequestPolicy", "Response", "ResponseHeader", "ResponseStatus", "ShortSportModeState",
    "SportModeState", "TimeSpec",
]  # fmt: skip


def _message(name: str, /, package: str = "unitree_go", **members: Any) -> Any:
    """A message as Unitree's compiler makes it: it cannot grow, and its members are numbered in their order."""
    return final(autoid("sequential")(make_idl_struct(name, f"{package}.msg.dds_.{name}_", members)))


TimeSpec = _message("TimeSpec", sec=int32, nanosec=uint32)
"""A time of the robot's clock."""

IMUState = _message(
    "IMUState", quaternion=array[float32, 4], gyroscope=array[float32, 3], accelerometer=array[float32, 3],
    rpy=array[float32, 3], temperature=byte,
)  # fmt: skip
"""`quaternion` w, x, y, z (world_R_body); rad/s, m/s^2 and radians in the body frame; degrees Celsius."""

PathPoint = _message(
    "PathPoint", t_from_start=float32, x=float32, y=float32, yaw=float32, vx=float32, vy=float32, vyaw=float32,
)  # fmt: skip
"""A point of a planned path."""

_SPORT = dict(
    stamp=TimeSpec, error_code=uint32, imu_state=IMUState, mode=byte, progress=float32,
    gait_type=byte, foot_raise_height=float32, position=array[float32, 3], body_height=float32,
    velocity=array[float32, 3], yaw_speed=float32, range_obstacle=array[float32, 4], foot_force=array[int16, 4],
    foot_position_body=array[float32, 12], foot_speed_body=array[float32, 12],
)  # fmt: skip

SportModeState = _message("SportModeState", **_SPORT, path_point=array[PathPoint, 10])
"""What the robot's walking says of itself: ``rt/sportmodestate``, ``rt/lf/sportmodestate``."""

ShortSportModeState = _message("SportModeState", **_SPORT)
"""The same without the planned path, as Unitree's ROS 2 package has it."""

MotorState = _message(
    "MotorState", mode=byte, q=float32, dq=float32, ddq=float32, tau_est=float32, q_raw=float32, dq_raw=float32,
    ddq_raw=float32, temperature=byte, lost=uint32, reserve=array[uint32, 2],
)  # fmt: skip
"""One of the motors."""

BmsState = _message(
    "BmsState", version_high=byte, version_low=byte, status=byte, soc=byte, current=int32, cycle=uint16,
    bq_ntc=array[byte, 2], mcu_ntc=array[byte, 2], cell_vol=array[uint16, 15],
)  # fmt: skip
"""The battery: `soc` in percent, `current` in milliamperes, voltages of the cells in millivolts."""

LowState = _message(
    "LowState", head=array[byte, 2], level_flag=byte, frame_reserve=byte, sn=array[uint32, 2],
    version=array[uint32, 2], bandwidth=uint16, imu_state=IMUState, motor_state=array[MotorState, 20],
    bms_state=BmsState, foot_force=array[int16, 4], foot_force_est=array[int16, 4], tick=uint32,
    wireless_remote=array[byte, 40], bit_flag=byte, adc_reel=float32, temperature_ntc1=byte, temperature_ntc2=byte,
    power_v=float32, power_a=float32, fan_frequency=array[uint16, 4], reserve=uint32, crc=uint32,
)  # fmt: skip
"""Motors, battery, remote control: ``rt/lowstate``, ``rt/lf/lowstate``. `tick`: milliseconds; no time of day."""

RequestIdentity = _message("RequestIdentity", package="unitree_api", id=int64, api_id=int64)
"""A request's number, which its response repeats, and what is asked for."""

RequestLease = _message("RequestLease", package="unitree_api", id=int64)
"""Who may command; 0 without a lease."""

RequestPolicy = _message("RequestPolicy", package="unitree_api", priority=int32, noreply=bool)
"""Whether a response is wanted."""

RequestHeader = _message(
    "RequestHeader", package="unitree_api", identity=RequestIdentity, lease=RequestLease, policy=RequestPolicy,
)  # fmt: skip
"""What every request begins with."""

Request = _message("Request", package="unitree_api", header=RequestHeader, parameter=str, binary=sequence[byte])
"""``rt/api/SERVICE/request``; `parameter` is JSON."""

ResponseStatus = _message("ResponseStatus", package="unitree_api", code=int32)
"""0, or what went wrong (`eagor.robots.go2.sport.CODES`)."""

ResponseHeader = _message("ResponseHeader", package="unitree_api", identity=RequestIdentity, status=ResponseStatus)
"""What every response begins with."""

Response = _message("Response", package="unitree_api", header=ResponseHeader, data=str, binary=sequence[byte])
"""``rt/api/SERVICE/response``; `data` is JSON or empty."""
