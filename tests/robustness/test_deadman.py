"""The dead-man switch: a key counts as held only while it repeats, and without a switch nothing real is armed."""

import os
import pty
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import HOSTILE

from eagor.errors import DeviceError
from eagor.robots.dds import free_domain
from eagor.robots.safety.guard import Guard
from eagor.robots.safety.messages import REPEAT, HeldKey, checked_deadman

pytestmark = pytest.mark.xdist_group("real time")


def test_a_key_is_held_from_its_first_repeat_until_it_no_longer_comes():
    key = HeldKey()
    assert not key.held(0.0)
    key.press(1.0)
    assert not key.held(1.0)  # one press is not holding
    key.press(1.5)  # the pause before a keyboard repeats
    assert not key.held(1.5)
    for index in range(1, 30):
        key.press(1.5 + index / 30)
        assert key.held(1.5 + index / 30)
    assert key.held(1.5 + 29 / 30 + REPEAT - 0.01)
    assert not key.held(1.5 + 29 / 30 + REPEAT + 0.01)


@HOSTILE
@given(st.lists(st.floats(0, 10), max_size=30), st.floats(0, 12))
def test_nobody_holds_a_key_that_did_not_just_come_twice(presses, now):
    key = HeldKey()
    before = sorted(press for press in presses if press <= now)
    for press in before:
        key.press(press)
    twice = len(before) > 1 and before[-1] - before[-2] <= REPEAT and now - before[-1] <= REPEAT
    assert key.held(now) == twice


def test_nothing_real_is_armed_without_a_switch():
    assert checked_deadman("none", True, "lo") == "none"
    assert checked_deadman("none", False, "eth0") == "none"
    for interface in ("eth0", None):
        with pytest.raises(DeviceError, match="may lead to a real robot"):
            checked_deadman("none", True, interface)
        with pytest.raises(DeviceError, match="may lead to a real robot"):
            Guard(armed=True, deadman="none", interface=interface)
    with pytest.raises(DeviceError, match="wanted one of key, remote, none"):
        checked_deadman("foot", True, "lo")


def test_no_robot_and_no_interface_are_said_in_words():
    pytest.importorskip("cyclonedds")
    with (
        pytest.raises(DeviceError, match="no robot is heard"),
        Guard(deadman="none", domain=free_domain(), interface="lo", patience=0.5),
    ):
        pass
    with (
        pytest.raises(DeviceError, match="no network interface 'eth7'"),
        Guard(deadman="none", domain=free_domain(), interface="eth7"),
    ):
        pass


def test_without_a_terminal_no_key_can_be_held():
    pytest.importorskip("cyclonedds")
    code = (
        "from eagor.robots.safety.guard import Guard\n"
        "try:\n"
        "    with Guard(armed=True, deadman='key', interface='lo', domain=1): pass\n"
        "except ValueError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, stdin=subprocess.DEVNULL, start_new_session=True,
        timeout=60,
    )  # fmt: skip
    assert "there is no terminal to hold a key in" in done.stdout
    assert "--deadman remote" in done.stdout


PROGRAM = """
import fcntl, sys, termios, time
fcntl.ioctl(0, termios.TIOCSCTTY, 0)  # the terminal of this process is the pseudo terminal
sys.path.insert(0, {tests!r})
from guard_driving import Driver
from eagor.robots.safety import Limits
from eagor.robots.safety.guard import Guard
quick = Limits(acceleration=4.0, turn_acceleration=4.0, settle=0.1)
with Guard(armed=True, deadman="key", domain={domain}, interface="lo", limits=quick) as guard, Driver(guard):
    print("ready", flush=True)
    time.sleep(60)
"""


def test_a_robot_moves_while_the_space_bar_is_held_and_x_latches():
    pytest.importorskip("cyclonedds")
    from go2_peer import Peer
    from guard_driving import until

    domain = free_domain()
    code = PROGRAM.format(tests=str(Path(__file__).parents[1]), domain=domain)

    def hold(seconds, key=b" "):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            os.write(terminal, key)
            time.sleep(1 / 30)

    with Peer(domain=domain) as peer:
        terminal, inside = pty.openpty()
        child = subprocess.Popen(
            [sys.executable, "-c", code], stdin=inside, stdout=inside, stderr=inside, start_new_session=True
        )
        os.close(inside)
        try:
            said = b""
            while b"ready" not in said:
                said += os.read(terminal, 1024)
            os.write(terminal, b" ")
            time.sleep(0.5)
            assert not peer.moves
            for _ in range(20):  # on a busy machine the guard takes its time
                hold(0.5)
                if peer.moves:
                    break
            assert peer.moves
            begun = time.monotonic()  # released
            until(lambda: peer.zero_since(begun))
            assert peer.zero_since(begun) - begun < 0.5
            hold(1.5)
            until(lambda: peer.moves)
            os.write(terminal, b"x")
            begun = time.monotonic()
            hold(1.5)
            assert peer.zero_since(begun) is not None
            os.write(terminal, b"r")
            hold(1.5)
            until(lambda: peer.moves)
            begun = time.monotonic()
            os.write(terminal, b"\x03")  # Ctrl-C
            until(lambda: peer.zero_since(begun))
            assert peer.zero_since(begun) - begun < 0.5
        finally:
            os.close(terminal)
            assert child.wait(20) != 0  # interrupted


@pytest.mark.slow
def test_a_robot_moves_while_l1_of_its_remote_control_is_held():
    pytest.importorskip("cyclonedds")
    from go2_peer import Peer
    from guard_driving import Driver, until

    from eagor.robots.safety import Limits

    domain, quick = free_domain(), Limits(acceleration=4.0, turn_acceleration=4.0, settle=0.1)
    with (
        Peer(domain=domain) as peer,
        Guard(armed=True, deadman="remote", domain=domain, interface="lo", limits=quick) as guard,
        Driver(guard),
    ):
        peer.pressed = frozenset({"R2"})
        until(lambda: any("dead-man" in reason for reason in guard.state.reasons))
        time.sleep(0.5)
        assert not peer.moves
        peer.pressed = frozenset({"L1"})
        until(lambda: peer.moves)
        for gone in (frozenset(), None):  # released; or the remote control is out of reach
            begun = time.monotonic()
            peer.pressed = gone
            until(lambda begun=begun: peer.zero_since(begun))
            assert peer.zero_since(begun) - begun < 0.5
            peer.pressed = frozenset({"L1"})
            until(lambda: peer.moves)
        peer.pressed = frozenset({"L1", "B"})
        until(lambda: guard.state.mode == "latched")
        peer.pressed = frozenset({"L1"})
        time.sleep(0.5)
        assert guard.state.mode == "latched"
        peer.pressed = frozenset({"L1", "start"})
        until(lambda: peer.moves)
