"""Unitree's messages as bytes: the same as cyclonedds writes, with `byte` for every octet."""

from __future__ import annotations

import ast
import ctypes
import dataclasses
import typing
from pathlib import Path

import numpy as np
import pytest
from cyclonedds.idl import types as idl_types
from hypothesis import given, settings
from hypothesis import strategies as st

import eagor.robots
from eagor.errors import FormatError
from eagor.robots.go2 import idl
from eagor.robots.go2.state import BUTTONS, LONG, LOW, MOTORS, SHORT, LowFields, Remote, SportFields, checksum

KINDS = [getattr(idl, name) for name in idl.__all__]
octets = st.integers(0, 255)
numbers = st.floats(-1e6, 1e6, width=32)


def vector(size):
    return st.tuples(*[numbers] * size)


states = st.builds(
    SportFields,
    st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1),
    vector(4), vector(3), vector(3), vector(3), octets, numbers, octets, numbers,
    vector(3), numbers, vector(3), numbers,
)  # fmt: skip
lows = st.builds(
    LowFields,
    vector(4), vector(3), vector(3), vector(3), octets, st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1),
    st.binary(min_size=40, max_size=40), numbers, numbers, vector(MOTORS), vector(MOTORS),
)  # fmt: skip


def plain(value):
    """A message of cyclonedds as nested tuples."""
    if dataclasses.is_dataclass(value):
        return tuple(plain(getattr(value, field.name)) for field in dataclasses.fields(value))
    return tuple(map(plain, value)) if isinstance(value, list | tuple | bytes) else value


@given(states, st.booleans())
def test_states_are_what_cyclonedds_writes_and_come_back(fields, short):
    data = fields.to_bytes(short)
    assert len(data) == (SHORT if short else LONG) == (236 if short else 516)
    assert SportFields.from_bytes(data) == fields
    kind = idl.ShortSportModeState if short else idl.SportModeState
    theirs = kind.deserialize(data)
    assert theirs.serialize(use_version_2=False) == data
    assert (theirs.stamp.sec, theirs.stamp.nanosec, theirs.error_code) == (
        fields.sec,
        fields.nanosec,
        fields.error_code,
    )
    assert (theirs.mode, theirs.progress, theirs.gait_type) == (fields.mode, fields.progress, fields.gait_type)
    assert plain(theirs.imu_state)[:4] == (fields.quaternion, fields.gyroscope, fields.accelerometer, fields.rpy)
    assert plain([theirs.position, theirs.velocity]) == (fields.position, fields.velocity)
    assert (theirs.body_height, theirs.yaw_speed) == (fields.body_height, fields.yaw_speed)


@given(lows)
def test_low_states_are_what_cyclonedds_writes_and_come_back(fields):
    data = fields.to_bytes()
    assert len(data) == LOW == 1180
    assert LowFields.from_bytes(data) == fields
    theirs = idl.LowState.deserialize(data)
    assert theirs.serialize(use_version_2=False) == data
    assert (theirs.bms_state.soc, theirs.bms_state.current) == (fields.soc, fields.current)
    assert (theirs.tick, theirs.power_v, theirs.power_a) == (fields.tick, fields.power_v, fields.power_a)
    assert plain(theirs.wireless_remote) == tuple(fields.wireless_remote)
    assert plain(theirs.imu_state)[:4] == (fields.quaternion, fields.gyroscope, fields.accelerometer, fields.rpy)
    motors = theirs.motor_state[:MOTORS]
    assert tuple(motor.q for motor in motors) == fields.angles
    assert tuple(motor.dq for motor in motors) == fields.rates
    assert {motor.mode for motor in motors} == {1}
    assert plain(theirs.motor_state[MOTORS]) == (0,) * 10 + ((0, 0),)


BITS = {"byte": ctypes.c_uint8, "int16": ctypes.c_int16, "uint16": ctypes.c_uint16, "int32": ctypes.c_int32,
        "uint32": ctypes.c_uint32, "float32": ctypes.c_float}  # fmt: skip


def as_c(kind):
    """The type of a member as a C++ compiler lays it out."""
    if dataclasses.is_dataclass(kind):
        members = [(field.name, as_c(kind.__annotations__[field.name])) for field in dataclasses.fields(kind)]
        return type(kind.__name__, (ctypes.Structure,), {"_fields_": members})
    said = typing.get_args(kind)[-1]
    if isinstance(said, idl_types.array):
        return as_c(said.subtype) * said.length
    return BITS[said]


def fill(there, value):
    for name, *_ in there._fields_:
        part = getattr(value, name)
        if dataclasses.is_dataclass(part):
            fill(getattr(there, name), part)
        elif isinstance(part, list | tuple | bytes):
            for index, each in enumerate(part):
                if dataclasses.is_dataclass(each):
                    fill(getattr(there, name)[index], each)
                else:
                    getattr(there, name)[index] = each
        else:
            setattr(there, name, part)


def bit_by_bit(words):
    """The checksum as Unitree's SDK for C++ goes through words: the polynomial of CRC-32, highest bits first."""
    crc = 0xFFFFFFFF
    for word in words:
        for bit in range(31, -1, -1):
            carry = (crc >> 31) ^ (word >> bit & 1)
            crc = (crc << 1 & 0xFFFFFFFF) ^ (0x04C11DB7 if carry else 0)
    return crc


@settings(max_examples=10, deadline=None)
@given(lows)
def test_the_checksum_is_that_of_the_message_as_a_compiler_lays_it_out(fields):
    theirs = idl.LowState.deserialize(fields.to_bytes())
    there = as_c(idl.LowState)()
    fill(there, theirs)
    assert ctypes.sizeof(there) == 1180
    assert type(there).crc.offset == 1176
    words = np.frombuffer(bytes(there), "<u4")[:-1]
    assert theirs.crc == bit_by_bit(words.tolist()) != 0


def test_the_checksum_is_crc_32_mpeg_2():
    """Which has a published check value, of the text 123456789: two words and eight bits."""
    crc = checksum(np.frombuffer(b"12345678", ">u4").astype("<u4").tobytes()) ^ ord("9") << 24
    for _ in range(8):
        crc = (crc << 1 & 0xFFFFFFFF) ^ (0x04C11DB7 if crc >> 31 else 0)
    assert crc == 0x0376E6E7


@given(states, st.booleans())
def test_the_other_byte_order_and_cdr_2_are_read_too(fields, short):
    kind = idl.ShortSportModeState if short else idl.SportModeState
    message = kind.deserialize(fields.to_bytes(short))
    big = bytearray(message.serialize(use_version_2=False))
    assert SportFields.from_bytes(bytes([0, 7]) + bytes(big[2:])) == fields
    body = np.frombuffer(bytes(big[4:]), np.uint8).copy()
    words = [slice(at, at + 4) for at in range(0, 232, 4) if at not in (64, 72, *range(128, 136, 4))]
    for part in words:
        body[part] = body[part][::-1]
    assert SportFields.from_bytes(bytes([0, 0, 0, 0]) + body.tobytes()) == fields


@given(st.binary(max_size=600))
def test_bytes_that_are_no_state_are_refused_in_words(data):
    if len(data) not in (SHORT, LONG):
        with pytest.raises(FormatError, match=f"has {len(data)} bytes; known are 516 and 236"):
            SportFields.from_bytes(data)
    elif data[:2] not in (b"\0\0", b"\0\1", b"\0\6", b"\0\7"):
        with pytest.raises(FormatError, match="wanted plain CDR"):
            SportFields.from_bytes(data)
    if len(data) != LOW:
        with pytest.raises(FormatError, match="its firmware is another one"):
            LowFields.from_bytes(data)


@given(st.sets(st.sampled_from(BUTTONS)), vector(2), vector(2))
def test_the_remote_control_comes_back(pressed, left, right):
    remote = Remote(frozenset(pressed), left, right)
    assert len(remote.to_bytes()) == 40
    assert Remote.from_bytes(remote.to_bytes()) == remote


def test_the_buttons_are_where_the_robot_has_them():
    data = bytearray(40)
    data[2], data[3] = 0b0010_0000, 0b0000_0010
    assert Remote.from_bytes(bytes(data)).pressed == {"L2", "B"}


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_no_member_is_a_uint8_or_int8(kind):
    """Which would end every process with Cyclone 0.10 that hears of it, the robot's own among them."""
    said = {field.name: repr(kind.__annotations__[field.name]) for field in dataclasses.fields(kind)}
    assert all("int8" not in about for about in said.values()), said


def test_no_source_of_the_robots_names_these_types():
    """Whatever is declared anywhere: `types.uint8`, `from cyclonedds.idl.types import int8`, and the like."""
    for path in Path(eagor.robots.__file__).parent.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        theirs = {
            alias.asname or alias.name: alias.name
            for node in ast.walk(tree)
            if isinstance(node, ast.Import | ast.ImportFrom)
            for alias in node.names
            if isinstance(node, ast.Import) or (node.module or "").startswith("cyclonedds")
        }
        assert not {"uint8", "int8"} & {*theirs, *theirs.values()}, path
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and node.attr in ("uint8", "int8"):
                root = node.value
                while isinstance(root, ast.Attribute):
                    root = root.value
                assert not (isinstance(root, ast.Name) and root.id in theirs and theirs[root.id] != "numpy"), path
