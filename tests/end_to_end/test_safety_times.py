"""The guard over DDS, against a robot of the tests' own: each fault of a kind, and whoever is killed or frozen."""

import math
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from processes import alive, sessions_of, wait_for

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from go2_peer import MOVE, STOP, UNHEARD, Peer
from guard_driving import Driver, Time, fast_enough, measured, other_commander, until

from eagor.errors import DeviceError
from eagor.robots.dds import free_domain
from eagor.robots.safety.guard import Guard
from eagor.robots.safety.limits import Limits

pytestmark = pytest.mark.xdist_group("real time")

QUICK = Limits(acceleration=4.0, turn_acceleration=4.0)  # so that the tests are quick
LONG = 180.0  # seconds for a guard to start on a busy machine
ZERO, GUARD = 0.25, 0.5  # seconds from a fault, or from the end of the guard, to the command being zero
COASTING = 1.0  # seconds that the body needs after that: 0.15 dead time, then a third of the speed each 0.33 s
SLACK = 0.25  # seconds that this machine may be busy with something else
TRIES = 8  # a busy machine holds processes up, so a trial that is late is repeated


def in_time(trial, zero=ZERO):
    """Repeat a trial until the robot stood in time; fails if it never does."""
    late = []
    for _ in range(TRIES):
        took = trial()
        if took.zero <= zero + SLACK and took.standing <= zero + SLACK + COASTING:
            return
        late.append(took)
    pytest.fail(f"never in time: {late}")


@contextmanager
def driven(remote=False, **options):
    """A robot, a guard on its domain, and a program that drives with it."""
    with Peer(free_domain()) as peer:
        guard = Guard(remote=remote, domain=peer.link.domain, interface="lo", limits=QUICK, patience=LONG, **options)
        with guard, Driver(guard) as driver:
            yield driver, peer


@pytest.fixture(scope="module")
def driving():
    with driven(armed=True) as both:
        yield both


def stops_since(peer, begun, number=STOP):
    return [told for told in peer.told if told.api_id == number and told.when > begun]


def says(driver, words):
    return lambda: any(words in reason for reason in driver.guard.state.reasons)


# Faults that the gate is only told of are one of a kind: tests/laws/test_safety_gate.py tries each of them.
@pytest.mark.parametrize(("whose", "name", "value", "normal", "words"), [
    (0, "wrong", {"image_age": 0.51}, {}, "the newest picture is"),
    (0, "wrong", {"velocity": (math.nan, 0.0, 0.0)}, {}, "not finite"),
    (0, "wrong", {"faults": ("the camera is unplugged",)}, {}, "the camera is unplugged"),
    (0, "mumbles", True, False, "velocity is"), (0, "silent", True, False, "the newest p"),
    (1, "roll", 0.6, 0.0, "tilted"), (1, "error_code", 7, 0, "error code 7"),
    (1, "mute", True, False, "state of the robot is"), (1, "growing", 1.0, 0.0, "state of the robot is"),
    (2, "mode", 5, 1, "the robot cannot walk: it is"),
])  # fmt: skip
def test_each_fault_stops_the_robot_in_time(driving, whose, name, value, normal, words):
    driver, peer = driving
    whose = (driver, peer, peer.plant)[whose]

    def once():
        fast_enough(peer, driver.velocity)
        begun = time.monotonic()
        setattr(whose, name, value)
        try:
            took = measured(peer, begun)
            until(says(driver, words))
            # Nobody knows whether a robot stands that tells no news of itself.
            until(lambda: driver.guard.state.mode == ("stopping" if name in ("mute", "growing") else "standing"))
        finally:
            setattr(whose, name, normal)
        until(lambda: driver.guard.state.mode == "armed")  # and it goes on when all is well again
        return took

    in_time(once)


def test_a_second_commander_stops_the_robot(driving):
    driver, peer = driving
    fast_enough(peer, driver.velocity)
    with other_commander(peer.link.domain) as begun:
        measured(peer, begun)
        until(says(driver, "Move on rt/api/sport/request"))


def test_stopmove_comes_again_and_again_until_it_is_acknowledged(driving):
    driver, peer = driving
    fast_enough(peer, driver.velocity)
    peer.deaf, begun = 4, time.monotonic()
    driver.wrong = {"presence": 0.1}
    measured(peer, begun)
    driver.wrong = {}
    assert len(stops_since(peer, begun, UNHEARD)) == 4


PROGRAM = """
import sys, time
sys.path.insert(0, {tests!r})
from guard_driving import Driver
from eagor.robots.safety.guard import Guard
with Guard(armed=True, remote=False, domain={domain}, interface="lo", patience={patience}) as guard, Driver(guard):
    print(guard.pid, flush=True)
    time.sleep(120)
"""


@pytest.mark.parametrize(("whom", "how"), [
    ("program", signal.SIGKILL), ("both", signal.SIGINT), ("program", signal.SIGSTOP),
    *(pytest.param("guard", how, marks=pytest.mark.slow) for how in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)),
])  # fmt: skip
def test_a_program_or_guard_that_is_ended_leaves_a_robot_that_stands_and_no_process(whom, how):
    def once():
        with Peer(free_domain()) as peer:
            code = PROGRAM.format(tests=str(Path(__file__).parents[1]), domain=peer.link.domain, patience=LONG)
            words = [sys.executable, "-c", code]
            child = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, start_new_session=True)
            try:
                guard, sessions = int(child.stdout.readline()), sessions_of(child.pid)
                fast_enough(peer, Driver.velocity)
                begun = time.monotonic()
                kill = os.killpg if whom == "both" else os.kill
                kill(guard if whom == "guard" else child.pid, how)
                took = measured(peer, begun)
                if not stops_since(peer, begun):  # or was about to
                    took = Time(math.inf, math.inf)
            finally:
                child.kill()
                child.wait()
                child.stdout.close()
            wait_for(lambda: guard not in alive(sessions))
        return took

    in_time(once)


def test_a_guard_that_is_killed_is_stood_in_for_and_told():
    def once():
        with driven(armed=True) as (driver, peer):
            fast_enough(peer, driver.velocity)
            begun = time.monotonic()
            os.kill(driver.guard.pid, signal.SIGKILL)
            took = measured(peer, begun)
            assert stops_since(peer, begun)
            with pytest.raises(DeviceError, match="the guard has ended; this program sent StopMove itself, and the ro"):
                _ = driver.guard.state
            return took

    in_time(once, GUARD)


def test_a_guard_that_is_frozen_is_stood_in_for_holds_up_nobody_and_goes_on_afterwards():
    with driven(armed=True) as (driver, peer):
        fast_enough(peer, driver.velocity)
        begun = time.monotonic()
        os.kill(driver.guard.pid, signal.SIGSTOP)
        try:
            measured(peer, begun)
            assert stops_since(peer, begun)
            for _ in range(2000):  # more than a pipe holds
                driver.say()
            until(lambda: time.monotonic() > begun + 3.0)
            with pytest.raises(DeviceError, match=r"has not said a word for .* StopMove itself, and the robot ackno"):
                _ = driver.guard.state
        finally:
            thawed = time.monotonic()
            os.kill(driver.guard.pid, signal.SIGCONT)
        until(lambda: any(any(told.velocity or ()) for told in peer.told if told.when > thawed))
        since = [told.api_id for told in peer.told if told.when > thawed and told.api_id in (STOP, MOVE)]
        assert STOP in since[:2]  # before anything else, except for what was just being sent


def test_a_dry_run_says_what_it_would_do_and_has_no_voice():
    with driven() as (driver, peer):
        until(lambda: getattr(driver.guard.state.would, "forward", 0.0) > 0.4)
        assert (driver.guard.state.mode, driver.guard.state.stops) == ("dry run", 0)
    assert peer.told == []


def test_a_robot_moves_while_l1_of_its_remote_control_is_held_and_b_latches():
    with driven(armed=True, remote=True) as (driver, peer):
        peer.pressed = frozenset({"R2"})
        until(says(driver, "dead-man"))
        time.sleep(0.7)
        assert not peer.moves
        peer.pressed = frozenset({"L1"})
        until(lambda: peer.moves)
        for change in ({"pressed": frozenset()}, {"silent": True}):  # released, or the remote control is out of reach
            begun = time.monotonic()
            vars(peer).update(change)
            measured(peer, begun)
            vars(peer).update(pressed=frozenset({"L1"}), silent=False)
            until(lambda: peer.moves)
        peer.pressed = frozenset({"L1", "B"})
        until(lambda: driver.guard.state.mode == "latched")
        peer.pressed = frozenset({"L1"})
        time.sleep(0.7)
        assert driver.guard.state.mode == "latched"
        peer.pressed = frozenset({"L1", "start"})
        until(lambda: peer.moves)


def test_no_robot_no_interface_and_no_switch_are_said():
    for interface in ("eth0", None):
        with pytest.raises(DeviceError, match="may lead to a real robot"):
            Guard(armed=True, remote=False, interface=interface)
    for interface, words in (("lo", "no robot is heard"), ("eth7", "no network interface")):
        with pytest.raises(DeviceError, match=words):
            Guard(domain=free_domain(), patience=0.5, interface=interface).__enter__()


@pytest.mark.slow
@pytest.mark.parametrize("killed", [False, True])
def test_the_robot_may_be_told_to_walk_around_obstacles_by_itself(killed):
    with driven(armed=True, avoid=True) as (driver, peer):
        until(lambda: peer.moves)
        assert all(peer.avoid.values())
        begun, driver.wrong = time.monotonic(), {"presence": 0.1}
        if killed:
            os.kill(driver.guard.pid, signal.SIGKILL)
        until(lambda: peer.still_since(begun))
        last = {service: (api_id, asked) for service, api_id, asked in peer.requests}
        assert last["sport"][0] == last["obstacles_avoid"][0] == STOP
        assert (last["obstacles_avoid"][1]["x"], last["obstacles_avoid"][1]["yaw"]) == (0.0, 0.0)
    assert not any(peer.avoid.values())  # the remote control has its robot back
