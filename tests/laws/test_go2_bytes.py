"""Unitree's messages as bytes: the same as cyclonedds writes, with `byte` for every octet."""

from __future__ import annotations

import tokenize
from pathlib import Path
from token import NAME, OP
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("cyclonedds")

import eagor.robots
from eagor.robots.go2 import state as idl
from eagor.robots.go2.state import BUTTONS, LONG, SHORT, Go2Low, low_state, sport_state

numbers = st.floats(-1e6, 1e6, width=32)
three = st.tuples(numbers, numbers, numbers)


@given(st.floats(0, 2**31 - 1), st.tuples(*[numbers] * 4), three, three, three, st.integers(0, 255), three, three,
       numbers, st.integers(0, 2**32 - 1), st.booleans())  # fmt: skip
def test_states_are_what_cyclonedds_writes(stamp, wxyz, gyroscope, felt, rpy, mode, place, velocity, yaw, code, short):
    data = sport_state(stamp, wxyz, gyroscope, felt, rpy, mode, place, velocity, yaw, code, short=short)
    assert len(data) == (SHORT if short else LONG) == (236 if short else 516)
    theirs = (idl.ShortSportModeState if short else idl.SportModeState).deserialize(data)
    assert theirs.serialize(use_version_2=False) == data
    assert theirs.stamp.sec + 1e-9 * theirs.stamp.nanosec == pytest.approx(stamp, abs=1e-6)
    imu = theirs.imu_state
    assert [tuple(each) for each in (imu.quaternion, imu.gyroscope, imu.accelerometer, imu.rpy)] == [
        wxyz, gyroscope, felt, rpy,
    ]  # fmt: skip
    assert (theirs.error_code, theirs.mode, theirs.body_height, theirs.yaw_speed) == (code, mode, place[2], yaw)
    assert (tuple(theirs.position), tuple(theirs.velocity)) == (place, velocity)
    # What is read of it, as `Go2State` reads it.
    sec, nanosec, error_code, *numbers = idl._STATE.unpack_from(data, 4)
    assert (sec, nanosec, error_code) == (theirs.stamp.sec, theirs.stamp.nanosec, code)
    assert tuple(numbers) == (*wxyz, mode, *place, *velocity, yaw)


def read(message):
    """What `Go2Low` reads of a message."""
    low = Go2Low(SimpleNamespace(subscribe=lambda *_: None))
    low._received(message, 3.0)
    return low.newest


@given(st.sets(st.sampled_from(BUTTONS)), st.integers(0, 100))
def test_low_states_bring_the_remote_control_and_the_battery(pressed, charge):
    data = low_state(pressed, charge, 28.5, 7.25).serialize(use_version_2=False)
    theirs = idl.LowState.deserialize(data)
    assert (len(data), theirs.tick) == (1180, 7250)
    assert read(theirs) == (3.0, charge, 28.5, pressed)


def test_the_buttons_are_where_the_robot_has_them():
    message = low_state()
    message.wireless_remote = bytes((0, 0, 0b0010_0000, 0b0000_0010)).ljust(40, b"\0")
    assert read(message).pressed == {"L2", "B"}


def test_no_source_of_the_robots_names_these_types():
    """Whatever is declared anywhere: `types.uint8`, `from cyclonedds.idl.types import int8`, and the like."""
    for path in Path(eagor.robots.__file__).parent.rglob("*.py"):
        with path.open("rb") as file:
            names = [token.string for token in tokenize.tokenize(file.readline) if token.type in (NAME, OP)]
        others = [names[at - 2 : at] for at, name in enumerate(names) if name in ("uint8", "int8")]
        assert all(before == ["np", "."] for before in others), path
