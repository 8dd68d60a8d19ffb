"""Over DDS, against a robot of the tests' own: the time from each fault to zero and to standing."""

import math
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from processes import wait_for

from eagor.robots.dds import free_domain

pytest.importorskip("cyclonedds")

from go2_peer import Peer, Simulated
from guard_driving import PEERS, TRIALS, Driver, Time, begun_by, bring_to_speed, measured, until

from eagor.errors import DeviceError
from eagor.robots.safety.guard import Guard
from eagor.robots.safety.limits import Limits
from eagor.robots.safety.messages import GuardState

pytestmark = pytest.mark.xdist_group("real time")

ZERO = 0.5  # seconds from a fault to the command being zero, at most; 0.25 for a stale command
QUICK = Limits(acceleration=4.0, turn_acceleration=4.0, settle=0.1)  # so that the tests are quick
LONG = 180.0  # seconds for a guard to start on a busy machine
COASTING = 1.0  # seconds that the body needs after that: 0.15 dead time, then a third of the speed each 0.33 s
TRIES = 8  # a busy machine holds processes up, so a trial that is late is repeated


def in_time(trial, zero=ZERO):
    """Repeat a trial until the robot stood in time; fails if it never does."""
    late = []
    for _ in range(TRIES):
        took = trial()
        if took.zero <= zero and took.standing <= zero + COASTING:
            return
        late.append(took)
    pytest.fail(f"never in time: {late}")


@pytest.fixture(scope="module")
def driven():
    domain = free_domain()
    with (
        Peer(domain=domain) as peer,
        Guard(armed=True, deadman="none", domain=domain, interface="lo", limits=QUICK, patience=LONG) as guard,
        Driver(guard) as driver,
    ):
        yield driver, peer


# Faults that the gate is only told of are one of a kind: tests/laws/test_safety_gate.py tries each of them.
KINDS = (
    "stale command", "stale image", "NaN wanted", "program hangs", "tilt", "robot falls silent",
    "robot's states come later and later", "somebody else commands", "emergency stop", "stop",
)  # fmt: skip


@pytest.mark.parametrize(
    "name", [name if name in KINDS else pytest.param(name, marks=pytest.mark.slow) for name in TRIALS]
)
def test_each_fault_stops_the_robot_in_time(driven, name):
    driver, peer = driven
    trial = TRIALS[name]

    def once():
        bring_to_speed(driver, peer)
        begun = begun_by(trial, driver, peer)
        try:
            took = measured(peer, begun)
            if name in ("robot falls silent", "robot's states come later and later"):
                assert driver.guard.state.mode == "stopping"  # nobody knows whether it stands
            else:
                until(lambda: driver.guard.state.mode in ("standing", "latched"))
            assert driver.guard.state.reasons
        finally:
            trial.end(driver, peer)
        until(lambda: driver.guard.state.mode == "armed")  # and it goes on when all is well again
        return took

    in_time(once)


@pytest.fixture(scope="module")
def simulated():
    domain = free_domain()
    guard = Guard(armed=True, deadman="none", domain=domain, interface="lo", limits=QUICK, patience=LONG)
    with Simulated(domain=domain) as robot, guard, Driver(guard) as driver:
        yield driver, robot


@pytest.mark.slow  # each fault is tried with the tests' own robot, too
@pytest.mark.parametrize("name", [name for name in TRIALS if name not in PEERS])
def test_the_simulated_go2_stops_in_time_too(simulated, name):
    driver, robot = simulated
    trial = TRIALS[name]

    def once():
        bring_to_speed(driver, robot)
        begun = begun_by(trial, driver, robot)
        try:
            took = measured(robot, begun)
            until(lambda: driver.guard.state.mode in ("standing", "latched"))
        finally:
            trial.end(driver, robot)
        return took

    in_time(once)


@pytest.mark.slow
def test_the_robot_may_be_told_to_walk_around_obstacles_by_itself():
    domain = free_domain()
    with Simulated(domain=domain) as robot:
        server = robot.server
        guard = Guard(
            armed=True, deadman="none", domain=domain, interface="lo", limits=QUICK, patience=LONG, avoid=True
        )
        with guard, Driver(guard) as driver:
            until(lambda: robot.moves)
            assert all(server.avoid.values())
            walked = [service for service, api_id, _ in server.requests if api_id in (1003, 1008)]
            assert set(walked) == {"obstacles_avoid"}
            begun = time.monotonic()
            driver.wrong = {"presence": 0.1}
            until(lambda: robot.still_since(begun))
            until(lambda: driver.guard.state.mode == "standing")
        assert not any(server.avoid.values())  # the remote control has its robot back


@pytest.mark.slow
def test_a_guard_that_is_killed_while_the_robot_avoids_obstacles_is_stood_in_for():
    domain = free_domain()
    with Simulated(domain=domain) as robot:
        server = robot.server
        guard = Guard(
            armed=True, deadman="none", domain=domain, interface="lo", limits=QUICK, patience=LONG, avoid=True
        )
        with guard, Driver(guard):
            until(lambda: robot.moves)
            begun = time.monotonic()
            os.kill(guard.pid, signal.SIGKILL)
            until(lambda: robot.still_since(begun))
            last = {service: (api_id, asked) for service, api_id, asked in server.requests}
            assert last["sport"][0] == last["obstacles_avoid"][0] == 1003
            assert (last["obstacles_avoid"][1]["x"], last["obstacles_avoid"][1]["yaw"]) == (0.0, 0.0)
        assert not any(server.avoid.values())  # the remote control has its robot back


def test_a_stale_command_is_zero_within_a_quarter_of_a_second(driven):
    driver, peer = driven

    def once():
        bring_to_speed(driver, peer)
        driver.mumbles = True
        last = driver.guard._said["command"]
        took = measured(peer, last)
        driver.mumbles = False
        return took

    in_time(once, Limits().command_age + 0.05)  # and the way over DDS


def test_stopmove_comes_again_and_again_until_it_is_acknowledged(driven):
    driver, peer = driven

    def once():
        bring_to_speed(driver, peer)
        peer.deaf = 4
        begun = time.monotonic()
        driver.wrong = {"presence": 0.1}
        took = measured(peer, begun)
        driver.wrong = {}
        assert len([told for told in peer.told if told.api_id == -1003 and told.when > begun]) == 4
        return took

    in_time(once)


CHILD = """
import sys, time
sys.path.insert(0, {tests!r})
from guard_driving import Driver
from eagor.robots.safety import Limits
from eagor.robots.safety.guard import Guard
QUICK = Limits(acceleration=4.0, turn_acceleration=4.0, settle=0.1)
guard = Guard(armed=True, deadman="none", domain={domain}, interface="lo", limits=QUICK, patience={patience})
with guard, Driver(guard):
    print(guard.pid, flush=True)
    time.sleep(120)
"""


def program(domain):
    """A program that drives, and the number of its guard's process."""
    code = CHILD.format(tests=str(Path(__file__).parents[1]), domain=domain, patience=LONG)
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert child.stdout is not None
    return child, int(child.stdout.readline())


def gone(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"


@pytest.mark.parametrize(("whom", "how"), [
    ("program", signal.SIGKILL), ("both", signal.SIGINT),
    *(pytest.param(*each, marks=pytest.mark.slow) for each in [
        ("guard", signal.SIGTERM), ("program", signal.SIGSTOP), ("program", signal.SIGTERM),
        ("guard", signal.SIGINT), ("guard", signal.SIGHUP),
    ]),
])  # fmt: skip
def test_a_program_or_guard_that_is_ended_leaves_a_robot_that_stands_and_no_process(whom, how):
    def once():
        domain = free_domain()
        with Peer(domain=domain) as peer:
            child, guard = program(domain)
            try:
                until(lambda: peer.moves)
                time.sleep(0.5)
                until(lambda: any(peer.commanded(time.monotonic())))  # a busy machine may have stopped it just now
                begun = time.monotonic()
                if whom == "both":
                    os.killpg(child.pid, how)
                else:
                    os.kill(child.pid if whom == "program" else guard, how)
                took = measured(peer, begun)
                with suppress(AssertionError):
                    until(lambda: stops_since(peer, begun), 5.0)
                if not stops_since(peer, begun):  # or was about to
                    took = Time(math.inf, math.inf)
            finally:
                child.kill()
                child.wait()
                child.stdout.close()
            wait_for(lambda: gone(guard))
        return took

    in_time(once)


@pytest.fixture(
    params=[
        pytest.param((0.15, 0.0, 0.2), marks=pytest.mark.slow, id="slow"),
        pytest.param((0.5, 0.0, 0.4), id="quick"),
    ]
)
def driving(request):
    """A robot that walks, the guard and the program that walk it."""
    domain = free_domain()
    with (
        Peer(domain=domain) as peer,
        Guard(armed=True, deadman="none", domain=domain, interface="lo", limits=QUICK, patience=LONG) as guard,
        Driver(guard, request.param) as driver,
    ):
        bring_to_speed(driver, peer)
        yield driver, peer


def stops_since(peer, begun):
    return [told for told in peer.told if told.api_id == 1003 and told.when > begun]


def test_a_guard_that_is_killed_is_stood_in_for_by_the_program_which_hears_of_it(driving):
    driver, peer = driving
    begun = time.monotonic()
    os.kill(driver.guard.pid, signal.SIGKILL)
    measured(peer, begun)  # it comes to stand
    assert stops_since(peer, begun)
    with pytest.raises(DeviceError, match="the guard has ended; this program sent StopMove itself, and the robot ack"):
        driver.say(time.monotonic())
    with pytest.raises(DeviceError, match="the guard has ended; this program sent StopMove itself, and the robot ack"):
        _ = driver.guard.state


def test_a_guard_that_is_killed_and_a_robot_that_does_not_listen_is_said(driving):
    driver, peer = driving
    peer.deaf = 1000
    os.kill(driver.guard.pid, signal.SIGKILL)

    def say_until_the_pipe_is_closed():
        for _ in range(500):
            driver.say(time.monotonic())
            time.sleep(0.01)

    with pytest.raises(DeviceError, match="the robot acknowledged none: if none came, it walks on until its last Move"):
        say_until_the_pipe_is_closed()


@pytest.mark.slow
def test_a_guard_that_is_frozen_is_stood_in_for_and_goes_on_afterwards(driving):
    driver, peer = driving
    guard, begun = driver.guard, time.monotonic()
    os.kill(guard.pid, signal.SIGSTOP)
    try:
        measured(peer, begun)
        assert stops_since(peer, begun)
        with suppress(DeviceError):  # on a busy machine it may have been silent for too long by now
            state = guard.state
            assert state.mode == "stopping"
            assert "this program sent StopMove itself, and the robot acknowledged it" in state.reasons[0]
        for _ in range(200):  # more than a pipe holds: a guard that hangs holds up nobody
            driver.say(time.monotonic())
        time.sleep(max(0.0, begun + 3.0 - time.monotonic()))
        with pytest.raises(DeviceError, match="has not said a word for "):
            _ = guard.state
    finally:
        thawed = time.monotonic()
        os.kill(guard.pid, signal.SIGCONT)
    until(lambda: any(told.velocity and any(told.velocity) for told in peer.told if told.when > thawed))

    def since():
        return [told.api_id for told in peer.told if told.when > thawed and told.api_id in (1003, 1008)]

    until(lambda: len(since()) >= 2)
    assert 1003 in since()[:2]  # before anything else, except for what was just being sent


def test_a_dry_run_says_what_it_would_do_and_has_no_voice():
    domain, seen = free_domain(), []
    with (
        Peer(domain=domain) as peer,
        Guard(deadman="none", domain=domain, interface="lo", limits=QUICK, patience=LONG, watch=seen.append) as guard,
        Driver(guard),
    ):
        until(lambda: guard.state.would is not None and guard.state.would.forward > 0.4)
        assert guard.state.mode == "dry run"
    assert peer.told == []
    assert all(isinstance(state, GuardState) and state.sent is None and state.stops == 0 for state in seen)


@pytest.mark.slow
def test_a_robot_that_ignores_move_is_told_little():
    domain = free_domain()
    with (
        Peer(domain=domain, stuck=True) as peer,
        Guard(armed=True, deadman="none", domain=domain, interface="lo", limits=QUICK, patience=LONG) as guard,
        Driver(guard),
    ):
        until(lambda: any("does not move" in reason for reason in guard.state.reasons))
        until(lambda: peer.told[-1].velocity == (Limits().creep, 0.0, Limits().creep_turn))


@pytest.mark.slow
def test_a_robot_that_lies_is_not_told_to_walk():
    domain = free_domain()
    with (
        Peer(domain=domain, mode=5) as peer,
        Guard(armed=True, deadman="none", domain=domain, interface="lo", limits=QUICK, patience=LONG) as guard,
        Driver(guard),
    ):
        until(lambda: any("lying" in reason for reason in guard.state.reasons))
        time.sleep(1.0)
        assert not [told for told in peer.told if told.api_id == 1008]
