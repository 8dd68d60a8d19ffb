"""A Go2 over DDS: what our client says, a simulated robot does; what it says, our client reads."""

from __future__ import annotations

import math
import threading
import warnings
from contextlib import contextmanager

import numpy as np
import pytest
from processes import wait_for

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from eagor.errors import DeviceError
from eagor.robots import Go2Poses
from eagor.robots.dds import Participant, free_domain, raw
from eagor.robots.go2 import sport
from eagor.robots.go2 import state as idl
from eagor.robots.go2.sim import SimSettings, SimulatedGo2
from eagor.robots.go2.state import Go2Low, Go2State, sport_state
from eagor.sources import PoseSource
from eagor.sources.odometry import open_poses

pytestmark = pytest.mark.xdist_group("real time")

LONG = 20.0  # seconds for an answer: this machine may be busy


@contextmanager
def robot(**settings):
    """A link, and a simulated robot there."""
    with Participant(free_domain(), "lo") as link, SimulatedGo2(SimSettings(None, **settings), link.domain) as server:
        yield link, server


@pytest.mark.parametrize(("source", "short"), [("sport", False), ("slow", True), ("lidar", False)])
def test_states_come_in_both_forms_and_from_the_lidar_on_our_clock(short, source):
    with robot(short=short, clock_offset=-4000.5) as (link, server):
        state = Go2State(link, source)
        first = state.wait(20)
        assert first.robot_stamp < first.received - 4000
        assert abs(first.stamp - first.received) < 10
        wait_for(lambda: state.count > 20)
        newest = state.newest
        np.testing.assert_allclose(newest.world_R_body, server.plant.truth.pose.world_R_body, atol=1e-6)
        assert (newest.mode, newest.error_code) == ((1, 0) if source != "lidar" else (None, 0))
        assert state.bytes == (0 if source == "lidar" else 236 if short else 516)
        poses = Go2Poses(link.domain, "lo", source, (0.0, 0.0, 0.4))
        assert isinstance(poses, PoseSource)
        np.testing.assert_allclose(next(iter(poses)).position, [0, 0, 0.72], atol=1e-6)
        threading.Timer(0.3, poses.close).start()
        stamps = [pose.stamp for pose in poses]
        assert stamps == sorted(stamps)


def test_a_robot_walks_where_it_is_told_and_stops_and_tells_its_battery_and_its_remote_control():
    with robot(battery=55) as (link, server):
        state, low, client = Go2State(link), Go2Low(link), sport.SportClient(link, timeout=LONG)
        assert client.wait(20)
        assert client.balance_stand() == sport.OK
        for _ in range(4):
            assert client.move(0.5, 0.0, 0.4) == sport.OK
            seen = state.count
            wait_for(lambda: state.count > seen + 60)  # noqa: B023
        newest = state.newest
        assert newest.mode == 3
        assert min(newest.speed, newest.yaw_rate) > 0.2
        assert client.stop() == sport.OK
        wait_for(lambda: state.newest.speed < 0.01 and abs(state.newest.yaw_rate) < 0.02)
        assert state.newest.position[0] > 0.2
        assert [number for _, number, _ in server.requests] == [1002, 1008, 1008, 1008, 1008, 1003]
        np.testing.assert_allclose(server.plant.odometry.pose.position[:2], state.newest.position[:2], atol=0.02)
        server.pressed = frozenset({"L2", "B"})
        wait_for(lambda: low.newest is not None and low.newest.pressed == server.pressed)
        assert low.newest.soc in (54, 55)
        assert 20 < low.newest.volts < 35


def test_two_robots_on_one_domain_are_refused():
    with robot() as (link, _):
        state, poses = Go2State(link), Go2Poses(link.domain, "lo")
        state.wait(20)
        with Participant(link.domain, "lo") as other:
            other.publish("rt/sportmodestate", raw(idl.SportModeState))
            wait_for(lambda: state.fault)
            for ask in (state.wait, lambda: list(poses)):
                with pytest.raises(DeviceError, match="2 publish rt/sportmodestate"):
                    ask()
        poses.close()
        wait_for(lambda: state.fault is None)
        assert state.wait() is not None


def test_nobody_there_is_said_and_commands_have_a_code():
    with pytest.raises(DeviceError, match="sonar"):
        open_poses("go2:sonar", domain=free_domain(), interface="lo")
    with Participant(free_domain(), "lo") as link:
        with pytest.raises(DeviceError, match=r"no robot is heard within 0\.2 s"):
            Go2State(link).wait(0.2)
        client = sport.SportClient(link, timeout=0.2)
        assert client.stop() == client.move(0.1, 0, 0) == sport.SEND
        assert sport.in_words(sport.SEND) == "could not be sent: no robot listens"


def test_dangerous_commands_are_never_sent():
    assert {"sport": {1, 1002, 1003, 1004, 1008}, "obstacles_avoid": {1, 1001, 1003, 1004}} == sport.ALLOWED
    with robot() as (link, server):
        client = sport.SportClient(link, timeout=LONG)
        client.wait(20)
        for number in (1030, 1031, 1032, *range(2041, 2048), 1006, 1005, 1001, 0):
            with pytest.raises(DeviceError, match=f"command {number} of 'sport' is never sent"):
                client.request(number)
        for velocity in (math.nan, 1e308):
            with pytest.raises(DeviceError, match="three finite numbers"):
                client.move(velocity, 0, 0)
        assert client.request(1) == (sport.OK, "1.0.0.1")
        assert [*server.requests] == []


def test_moving_carefully_needs_to_be_turned_on():
    with robot() as (link, server):
        client = sport.AvoidClient(link, timeout=LONG)
        assert client.wait(20)
        assert client.move(0.3, 0.0, 0.0) == sport.OK
        wait_for(lambda: server.asked == 1)
        assert server.plant.walked == 0.0
        assert client.start() == sport.OK
        client.move(0.3, 0.0, 0.0)
        wait_for(lambda: server.plant.walked > 0.02)
        assert client.stop() == client.end() == sport.OK
        assert not any(server.avoid.values())


@contextmanager
def published(kind=idl.SportModeState):
    """What sends states on a link, and what reads them there."""
    with Participant(free_domain(), "lo") as link, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        came = []
        writer, state = link.publish("rt/sportmodestate", raw(kind)), Go2State(link, received=came.append)
        wait_for(lambda: writer.readers)
        yield link, lambda data: writer.write(raw(kind)(data)), state, came


def test_a_robot_of_another_firmware_is_said_in_words():
    """A known type with another length, and a type that is not known at all."""
    with published() as (_, send, state, _):
        send(sport_state(5) + bytes(100))
        wait_for(lambda: state.fault)
        with pytest.raises(DeviceError, match="has 616 bytes, written in way 0001; known are 516 and 236"):
            state.wait()
    with Participant(free_domain(), "lo") as link:
        link.publish("rt/sportmodestate", idl.LowState)
        with pytest.raises(DeviceError, match="in a form that is not known"):
            Go2State(link).wait(0.3)


@pytest.mark.parametrize(("wrong", "said"), [
    ({"wxyz": (0.0,) * 4}, r"the robot has not told its orientation yet .*\[0, 0, 0, 0\], which is unset"),
    ({"wxyz": (math.nan,) * 4}, "wanted a quaternion of length 1"),
    ({"position": (math.inf, 0, 0)}, "wanted finite ones"),
])  # fmt: skip
def test_states_without_a_pose_are_left_out_and_named_and_without_a_time_stamped_at_arrival(wrong, said):
    with published() as (_, send, state, _):
        send(sport_state(5, **wrong))
        with pytest.raises(DeviceError, match=f"rt/sportmodestate is published as .*, but .*{said}"):
            state.wait(1.0)
        send(sport_state(0, position=(1.0, 2.0, 3.0)))
        newest = state.wait(20)
        assert newest.position.tolist() == [1.0, 2.0, 3.0]
        assert newest.stamp == newest.received
