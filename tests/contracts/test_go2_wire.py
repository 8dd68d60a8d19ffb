"""A Go2 over DDS: what our client says, a simulated robot does; what it says, our client reads."""

from __future__ import annotations

import itertools
import json
import math
import threading
import warnings

import numpy as np
import pytest
from processes import wait_for

from eagor.errors import DeviceError
from eagor.media import PoseSource
from eagor.robots.dds import Link, free_domain
from eagor.robots.go2 import idl, sport
from eagor.robots.go2.plant import Plant, PlantSettings
from eagor.robots.go2.sim_wire import Go2Server, WireSettings
from eagor.robots.go2.state import Go2Low, Go2State, Remote, SportFields, raw

LONG = 20.0  # seconds for an answer: this machine may be busy


def robot(link: Link, wire: WireSettings | None = None, **settings) -> Go2Server:
    plant = Plant(PlantSettings(**settings), np.random.default_rng(3))
    return Go2Server(plant, link, wire, rng=np.random.default_rng(4))


@pytest.mark.parametrize(
    ("source", "short"),
    [("sport", False), ("slow", True), ("lidar", False),
     *(pytest.param(*each, marks=pytest.mark.slow) for each in [("sport", True), ("slow", False), ("lidar", True)])],
)  # fmt: skip
def test_states_come_in_both_forms_and_from_the_lidar_on_our_clock(short, source):
    domain = free_domain()
    wire = WireSettings(short=short, clock_offset=-4000.5)
    with Link(domain, "lo") as link, robot(link, wire) as server:
        state = Go2State(link, source, mount=(0.0, 0.0, 0.4))
        assert isinstance(state, PoseSource)
        first = state.wait(20)
        assert first.robot_stamp < first.received - 4000
        assert abs(first.stamp - first.received) < 10
        wait_for(lambda: state.count > 20)
        newest = state.newest
        np.testing.assert_allclose(newest.world_R_body, server.truth.pose.world_R_body, atol=1e-6)
        assert (newest.mode, newest.error_code) == ((1, 0) if source != "lidar" else (None, 0))
        pose = next(iter(state))
        np.testing.assert_allclose(pose.position, [0, 0, 0.72], atol=1e-6)
        ender = threading.Timer(0.3, state.close)
        ender.start()
        stamps = [pose.stamp for pose in state]
        assert stamps == sorted(stamps)
        ender.join()
    if source != "lidar":
        assert state.bytes == (236 if short else 516)


def test_a_robot_walks_where_it_is_told_and_stops():
    domain = free_domain()
    with Link(domain, "lo") as link, robot(link, scale_drift=0, turn_drift=0, yaw_drift=0) as server:
        state, client = Go2State(link), sport.SportClient(link, timeout=LONG)
        assert client.wait(20)
        assert client.api_version() == (0, "1.0.0.1")
        assert client.balance_stand() == sport.OK
        for _ in range(4):
            assert client.move(0.5, 0.0, 0.4) == sport.OK
            seen = state.count
            wait_for(lambda: state.count > seen + 60)  # noqa: B023
        newest = state.newest
        assert newest.mode == 3
        assert newest.speed > 0.2
        assert newest.yaw_rate > 0.2
        assert client.stop() == sport.OK
        wait_for(lambda: state.newest.speed < 0.01 and abs(state.newest.yaw_rate) < 0.02)
        assert state.newest.position[0] > 0.2
        assert [number for _, number, _ in server.requests] == [1002, 1008, 1008, 1008, 1008, 1003]
        np.testing.assert_allclose(server.truth.pose.position[:2], state.newest.position[:2], atol=0.02)


def test_the_remote_control_and_the_battery_are_read():
    domain = free_domain()
    with Link(domain, "lo") as link, robot(link, WireSettings(battery=55)) as server:
        server.remote = Remote(frozenset({"L2", "B"}), (0.5, -1.0), (0.25, 0.0))
        low = Go2Low(link)
        assert low.wait(20).soc == 55
        assert low.wait().remote == server.remote
        assert 20 < low.wait().volts < 35


def test_two_robots_on_one_domain_are_refused():
    domain = free_domain()
    with Link(domain, "lo") as link, robot(link):
        state = Go2State(link)
        state.wait(20)
        with Link(domain, "lo") as other, robot(other):
            wait_for(lambda: state.fault)
            with pytest.raises(DeviceError, match="2 publish rt/sportmodestate"):
                _ = state.newest
        wait_for(lambda: state.fault is None)
        assert state.wait() is not None


def test_nobody_there_is_said_and_commands_have_a_code():
    with Link(free_domain(), "lo") as link:
        with pytest.raises(DeviceError, match=r"no robot is heard within 0\.2 s"):
            Go2State(link).wait(0.2)
        client = sport.SportClient(link, timeout=0.2)
        assert client.stop() == client.move(0.1, 0, 0) == sport.SEND
        assert sport.in_words(sport.SEND) == "could not be sent: no robot listens"


def test_what_a_robot_does_not_know_or_understand_has_a_code():
    with Link(free_domain(), "lo") as link, robot(link):
        client = sport.SportClient(link, timeout=LONG)
        client.wait(20)
        client._allowed = frozenset(range(3000))
        assert client.call(1030)[0] == 3203
        assert client.call(sport.Sport.MOVE, {"x": "?"})[0] == 3204


ODD = ["NaN", "Infinity", "1e308", "-1e39", '"nan"', "1" + 400 * "0", "null", "[]"]


@pytest.mark.parametrize("service", ["sport", "obstacles_avoid"])
def test_a_move_that_is_no_velocity_is_refused_and_moves_nothing(service):
    with Link(free_domain(), "lo") as link, robot(link, dead_time=0.0) as server:
        client = (
            sport.AvoidClient(link, timeout=LONG)
            if service == "obstacles_avoid"
            else sport.SportClient(link, timeout=LONG)
        )
        assert client.wait(20)
        if service == "obstacles_avoid":
            assert client.start() == sport.OK
        number, turn = (1003, "yaw") if service == "obstacles_avoid" else (1008, "z")
        for wrong, odd in itertools.product(("x", "y", turn), ODD):
            parts = {"x": "0.3", "y": "0.0", turn: "0.2"} | {wrong: odd}
            text = "{" + ", ".join(f'"{name}": {value}' for name, value in parts.items()) + "}"
            assert server._obey(service, number, text) == (3204, "")
        with pytest.raises(DeviceError, match="wanted three finite numbers of 32 bits"):
            client.move(1e308, 0.0, 0.0)
        steps = server.plant.steps
        wait_for(lambda: server.plant.steps > steps + 20)
        assert server.plant.walked == 0.0
        assert np.isfinite(server.truth.pose.position).all()


def asked(link, service, api_id, **parameter):
    """A request to a service that our clients never use, as another program sends it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sport.ALLOWED, service, frozenset({1, *range(1001, 1007)}))
        client = sport.Service(link, service, timeout=LONG)
    assert client.wait(20)
    code, data = client.call(api_id, parameter)
    client.close()
    return code, json.loads(data) if data else None


def test_programs_that_command_motors_can_be_rehearsed_release_the_mode_and_select_it_again():
    """As Unitree's examples do: lie down and release until no mode is on; later select one and stand up."""
    with Link(free_domain(), "lo") as link, robot(link, deaf=(0.0, 0.0)) as server:
        client = sport.SportClient(link, timeout=LONG)
        assert client.wait(20)
        assert asked(link, "motion_switcher", 1001) == (0, {"form": "0", "name": "normal"})
        assert client.stand_down() == sport.OK
        assert asked(link, "motion_switcher", 1003) == (0, None)
        assert asked(link, "motion_switcher", 1001)[1]["name"] == ""
        assert server.truth.mode == 7  # limp
        assert client.move(0.3, 0.0, 0.0) == sport.OK  # it was sent
        client.timeout = 0.5
        assert client.stop() == sport.TIMEOUT  # nobody answers
        client.timeout = LONG
        assert server.plant.walked == 0.0
        assert asked(link, "motion_switcher", 1002, name="moonwalk") == (7004, None)
        assert asked(link, "motion_switcher", 1002, name="ai") == (0, None)
        assert asked(link, "motion_switcher", 1001)[1]["name"] == "ai"
        assert client.stand_up() == client.balance_stand() == sport.OK
        client.move(0.3, 0.0, 0.0)
        wait_for(lambda: server.plant.walked > 0.02)
        assert asked(link, "motion_switcher", 1004, silent=True) == (0, None)
        assert asked(link, "motion_switcher", 1005) == (0, {"silent": True})
        assert asked(link, "motion_switcher", 1006)[0] == 3203


def test_services_are_listed_and_switched_unless_they_are_protected():
    with Link(free_domain(), "lo") as link, robot(link) as server:
        code, listed = asked(link, "robot_state", 1003)
        assert code == 0
        assert {each["name"]: (each["status"], each["protect"]) for each in listed} == {
            "sport_mode": (1, 0), "obstacles_avoid": (1, 0), "robot_state": (1, 1), "motion_switcher": (1, 1),
        }  # fmt: skip
        assert asked(link, "robot_state", 1001, name="sport_mode", switch=0) == (
            0, {"name": "sport_mode", "status": 0},
        )  # fmt: skip
        assert server.truth.mode == 7
        client = sport.SportClient(link, timeout=0.5)
        client.wait(20)
        assert client.stand_up() == sport.TIMEOUT
        client.timeout = LONG
        assert asked(link, "robot_state", 1001, name="motion_switcher", switch=0)[1]["status"] == 5
        assert asked(link, "robot_state", 1001, name="lidar", switch=0)[0] == 5201
        assert asked(link, "robot_state", 1001, name="sport_mode")[0] == 3204
        assert asked(link, "robot_state", 1001, name="sport_mode", switch=1)[1]["status"] == 1
        assert client.stand_up() == sport.OK


def test_the_motors_tell_their_angles_and_rates():
    with Link(free_domain(), "lo") as link, robot(link) as server:
        seen = []
        link.subscribe("rt/lowstate", idl.LowState, lambda message, when: seen.append(message))
        wait_for(lambda: len(seen) > 5)
        np.testing.assert_allclose([motor.q for motor in seen[-1].motor_state[:12]], server.plant.joints, atol=1e-6)
        assert {motor.dq for motor in seen[-1].motor_state[:12]} == {0.0}
        assert seen[-1].crc != 0
        client = sport.SportClient(link, timeout=LONG)
        client.wait(20)
        client.move(0.5, 0.0, 0.0)
        wait_for(lambda: server.plant.walked > 0.1)
        walking = seen[-1].motor_state
        assert max(abs(motor.dq) for motor in walking[:12]) > 0.1
        assert {motor.q for motor in walking[12:]} == {0.0}


def test_dangerous_commands_are_never_sent():
    with Link(free_domain(), "lo") as link, robot(link) as server:
        client = sport.SportClient(link, timeout=LONG)
        client.wait(20)
        for number in (1030, 1031, 1032, *range(2041, 2048), 1006, 1001, 0):
            with pytest.raises(DeviceError, match=f"command {number} of 'sport' is never sent"):
                client.call(number)
        with pytest.raises(DeviceError, match="three finite numbers"):
            client.move(math.nan, 0, 0)
        assert client.api_version()[0] == 0
        assert server.requests == []


def test_exactly_these_commands_may_be_sent():
    walking, avoiding = sport.ALLOWED["sport"], sport.ALLOWED["obstacles_avoid"]
    assert walking == {1, 1002, 1003, 1004, 1005, 1008}
    assert avoiding == {1, 1001, 1002, 1003, 1004}


def test_a_robot_of_another_firmware_is_said_in_words():
    """A known type with another length (nothing else reaches us), and a type that is not known at all."""
    with Link(free_domain(), "lo") as link:
        kind = raw(idl.SportModeState)
        writer = link.publish("rt/sportmodestate", kind)
        state = Go2State(link)
        wait_for(lambda: writer.readers)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            writer.write(kind(SportFields(sec=5).to_bytes() + bytes(100)))
            wait_for(lambda: state.fault)
            wait_for(lambda: said)
        with pytest.raises(DeviceError, match="the robot's state has 616 bytes; known are 516 and 236"):
            next(iter(state))
        with pytest.raises(DeviceError, match="Its firmware is newer or another one"):
            state.wait(1)
    with Link(free_domain(), "lo") as link:
        link.publish("rt/sportmodestate", idl.LowState)
        with pytest.raises(DeviceError, match="in a form that is not known"):
            Go2State(link).wait(0.3)


@pytest.mark.parametrize(
    "wrong", [{"quaternion": (0.0,) * 4}, {"quaternion": (math.nan,) * 4}, {"position": (math.inf, 0, 0)}]
)
def test_states_without_a_pose_are_left_out_and_counted(wrong):
    with Link(free_domain(), "lo") as link, warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        kind = raw(idl.SportModeState)
        writer = link.publish("rt/sportmodestate", kind)
        state = Go2State(link)
        wait_for(lambda: writer.readers)
        writer.write(kind(SportFields(sec=5, **wrong).to_bytes()))
        wait_for(lambda: said)
        assert state.newest is None
        writer.write(kind(SportFields(sec=6, position=(1.0, 2.0, 3.0)).to_bytes()))
        assert state.wait(20).position.tolist() == [1.0, 2.0, 3.0]
        assert state.fault is None


def test_a_robot_that_tells_no_time_is_stamped_at_arrival():
    with Link(free_domain(), "lo") as link:
        kind = raw(idl.SportModeState)
        writer = link.publish("rt/sportmodestate", kind)
        state = Go2State(link)
        wait_for(lambda: writer.readers)
        writer.write(kind(SportFields().to_bytes()))
        newest = state.wait(20)
        assert newest.stamp == newest.received


@pytest.mark.slow
def test_lost_and_late_messages_are_lost_and_late_but_commands_are_asked_again():
    domain = free_domain()
    with Link(domain, "lo") as link, robot(link, WireSettings(drop=0.3, delay=(0.0, 0.05))) as server:
        state, client = Go2State(link), sport.SportClient(link, timeout=0.5)
        state.wait(20)
        client.wait(20)
        codes = [client.stop() for _ in range(25)]
        assert set(codes) <= {sport.OK, sport.TIMEOUT}
        assert sport.OK in codes
        assert sport.TIMEOUT in codes  # 51 % of the answers come on average
        steps, count = server.plant.steps, state.count
        wait_for(lambda: state.count > count + 200)
        assert state.count - count < 0.9 * (server.plant.steps - steps)  # 0.7 come, and on a busy machine fewer


def test_moving_carefully_needs_to_be_turned_on():
    domain = free_domain()
    with Link(domain, "lo") as link, robot(link, dead_time=0.0) as server:
        state, client = Go2State(link), sport.AvoidClient(link, timeout=LONG)
        assert client.wait(20)
        assert client.api_version() == (0, "1.0.0.2")
        assert client.on() is False
        assert client.move(0.3, 0.0, 0.0) == sport.OK
        wait_for(lambda: any(number == 1003 for _, number, _ in server.requests))
        assert server.plant.walked == 0.0
        assert client.start() == sport.OK
        assert client.on() is True
        client.move(0.3, 0.0, 0.0)
        wait_for(lambda: server.plant.walked > 0.02)
        assert client.stop() == sport.OK
        assert client.end() == sport.OK
        assert client.on() is False
        assert state.wait(20).error_code == 0


def test_a_message_that_reaches_both_readers_counts_once():
    """Writers that announce no type reach the readers of both forms."""
    with Link(free_domain(), "lo") as link:
        short = raw(idl.ShortSportModeState)
        writer = link.publish("rt/sportmodestate", short)
        state = Go2State(link)
        wait_for(lambda: writer.readers)
        writer.write(short(SportFields(sec=5).to_bytes()))  # the long form, on the reader of the short one alone
        state.wait(20)
        other = link.publish("rt/sportmodestate", raw(idl.SportModeState))
        wait_for(lambda: other.readers)
        for _ in range(4):
            writer.write(short(SportFields(sec=5).to_bytes()))
        writer.write(short(SportFields(sec=5, error_code=7).to_bytes(short=True)))
        wait_for(lambda: state.count >= 2)
        assert [each.error_code for each in state._waiting] == [0, 7]
