"""How long a Go2 needs from each fault to standing, through the guard over DDS, on this machine.

    python benchmarks/safety.py [--robot peer] [--repeats 20] [--faults NAME ...]

The robot is the peer of the tests, or the package's own simulated Go2 (--robot sim, which cannot lean or fall silent).
Both note each request when it comes, and their bodies have the dead time (0.15 s) and the lag (0.30 s) that were fitted
to a real Go2. It walks at 0.5 m/s and turns at 0.4 rad/s, as commanded, when the fault begins. `zero`: seconds from the
fault until nothing is commanded any more, for good. `standing`: until its body is below 0.05 m/s and 0.05 rad/s. Both
are read from the monotonic clock of this machine. A fault begins when it holds: a picture that is older than its limit,
a key that is no longer held. Exit code 1 if `zero` is ever above 0.25 s. `benchmarks/safety_kills.py` kills and freezes
the detector and the camera, too.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

TESTS = str(Path(__file__).parents[1] / "tests")
sys.path.insert(0, TESTS)

from go2_peer import Peer, Simulated
from guard_driving import PEERS, TRIALS, Driver, Time, begun_by, bring_to_speed, fast_enough, measured

from eagor.robots.dds import free_domain
from eagor.robots.safety.guard import Guard

LIMIT = 0.25  # seconds
ENDED = {
    "kill -9 of the program": (signal.SIGKILL, "program"), "SIGSTOP of the program": (signal.SIGSTOP, "program"),
    "SIGTERM of the program": (signal.SIGTERM, "program"), "SIGINT of the guard": (signal.SIGINT, "guard"),
    "SIGTERM of the guard": (signal.SIGTERM, "guard"), "kill -9 of the guard": (signal.SIGKILL, "guard"),
    "SIGSTOP of the guard": (signal.SIGSTOP, "guard"),
}  # fmt: skip
CHILD = """
import sys, time
sys.path.insert(0, {tests!r})
from guard_driving import Driver
from eagor.robots.safety.guard import Guard
with Guard(armed=True, deadman="none", domain={domain}, interface="lo") as guard, Driver(guard):
    print(guard.pid, flush=True)
    time.sleep(600)
"""


def of_a_fault(name: str, repeats: int, robot: type) -> list[Time]:
    """The times of a fault that the guard survives."""
    trial, domain, found = TRIALS[name], free_domain(), []
    guard = Guard(armed=True, deadman="none", domain=domain, interface="lo")
    with robot(domain=domain) as peer, guard, Driver(guard) as driver:
        for _ in range(repeats):
            peer.told.clear()
            peer.speeds.clear()
            bring_to_speed(driver, peer)
            begun = begun_by(trial, driver, peer)
            if name == "stale command":
                begun = guard._said.command  # its age counts from when it was given
            found.append(measured(peer, begun))
            trial.end(driver, peer)
    return found


def of_an_end(name: str, repeats: int, robot: type) -> list[Time]:
    """The times of a program or guard that is ended from outside."""
    number, whom = ENDED[name]
    found, domain = [], free_domain()  # a process keeps the ports of every domain that it was on
    for _ in range(repeats):
        with robot(domain=domain) as peer:
            code = CHILD.format(tests=TESTS, domain=domain)
            child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
            assert child.stdout is not None
            guard = int(child.stdout.readline())
            fast_enough(peer, Driver.velocity)
            begun = time.monotonic()
            os.kill(child.pid if whom == "program" else guard, number)
            found.append(measured(peer, begun))
            child.kill()
            child.wait()
            if whom == "guard":
                with suppress(ProcessLookupError):  # one that is frozen does not hear of its program's end
                    os.kill(guard, signal.SIGKILL)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", choices=("peer", "sim"), default="peer")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--faults", nargs="*", default=[*TRIALS, *ENDED])
    options = parser.parse_args()
    if options.robot == "sim":
        options.faults = [name for name in options.faults if name not in PEERS]
    bad, robot = 0, Peer if options.robot == "peer" else Simulated
    print(f"| fault | zero p50 (ms) | zero max (ms) | standing p50 (ms) | standing max (ms) | n = {options.repeats} |")
    print("|---|---:|---:|---:|---:|---|")
    for name in options.faults:
        measure: Callable[[str, int, type], list[Time]] = of_a_fault if name in TRIALS else of_an_end
        times = measure(name, options.repeats, robot)
        zero, standing = (1000 * np.array([getattr(t, what) for t in times]) for what in ("zero", "standing"))
        fine = zero.max() <= 1000 * LIMIT
        bad += not fine
        row = (np.median(zero), zero.max(), np.median(standing), standing.max())
        print(f"| {name} | {' | '.join(f'{value:.0f}' for value in row)} | {'' if fine else 'TOO LATE'} |", flush=True)
    return bool(bad)


if __name__ == "__main__":
    sys.exit(main())
