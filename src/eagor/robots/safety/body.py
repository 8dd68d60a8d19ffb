"""The robot's side of the guard: what is said to a Go2, without ever waiting, and what is read from it.

The guard's process has a `Go2Body`. The program beside it has a `Standby`, for the case that this process is gone.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Self

from eagor.errors import DeviceError
from eagor.media.clocks import Lateness
from eagor.robots.dds import Link
from eagor.robots.go2.sport import OK, AvoidClient, ForeignCommands, SportClient, in_words
from eagor.robots.go2.state import MODES, BodyState, Go2Low, Go2State
from eagor.robots.safety.limits import Body, Velocity
from eagor.robots.safety.messages import GuardSettings

__all__ = ["Go2Body", "Standby"]

PATIENCE = 0.1  # seconds until a StopMove counts as not acknowledged; others follow at once, or are on their way

AT_ONCE = 4  # StopMove that may wait for their answers
STARTING = 5.0  # seconds that commands before the first move may take
LOCKED = 6  # `MODES`: stands with locked joints
ABLE = (0, 1, 2, 3, 6, 9)  # modes from which it can walk


class Standby:
    """A second voice beside the guard, which can say StopMove and nothing else; a context manager.

    It is opened beforehand: processes need a second to find each other on DDS, and a robot walks on meanwhile.
    `avoid`: velocities go through the robot's obstacle avoidance, so that these are stopped as well. `sent`: StopMove
    so far; `acknowledged`: whether the robot acknowledged the newest. Raises `DeviceError`, `MissingExtraError`.
    """

    def __init__(self, domain: int, interface: str | None, *, avoid: bool = False) -> None:
        self.sent, self.acknowledged = 0, False
        self._link = Link(domain, interface)
        self._sport = SportClient(self._link, timeout=PATIENCE)
        self._avoid = AvoidClient(self._link, timeout=PATIENCE) if avoid else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._avoid is not None and self.sent:  # whoever turned this on may be gone
            self._avoid.end()
        self._link.close()

    def wait(self, timeout: float) -> None:
        """Wait until the robot listens. Raises `DeviceError` if it does not within `timeout` seconds."""
        if not self._sport.wait(timeout):
            raise DeviceError(
                f"the robot does not listen to this program's own StopMove within {timeout:g} s, which has to work if "
                "the guard ends: relieve this machine's processor, look at the network, start the program again"
            )

    def stop(self) -> bool:
        """Send StopMove; whether the robot acknowledged it, for which it has `PATIENCE`."""
        if self._avoid is not None:
            self._avoid.stop()
        self.acknowledged = self._sport.stop() == OK
        self.sent += 1
        return self.acknowledged


class Go2Body:
    """A Go2 as the guard sees it, by its `settings`; a context manager.

    One that is not armed never has a writer, so it cannot command anything. Raises `DeviceError`, `MissingExtraError`.
    """

    def __init__(self, settings: GuardSettings) -> None:
        self.body: Body | None = None
        self.mode: int | None = None
        self.acknowledged: int | None = None
        self.problem: str | None = None  # of the last command
        self._lateness = Lateness()
        self._aside = settings.limits.aside
        self._link = Link(settings.domain, settings.interface)
        # A robot that avoids obstacles may command its own walking.
        self._others = ForeignCommands(
            self._link, ["obstacles_avoid"] if settings.avoid else ["sport", "obstacles_avoid"]
        )
        self._state = Go2State(self._link, received=self._received)
        self._low = Go2Low(self._link) if settings.deadman == "remote" else None
        self._sport = SportClient(self._link, timeout=PATIENCE) if settings.armed else None
        avoids = settings.armed and settings.avoid
        self._avoid = AvoidClient(self._link, timeout=STARTING) if avoids else None
        self._stoppers = ThreadPoolExecutor(AT_ONCE, "StopMove")
        self._stops = 0

    def __enter__(self) -> Go2Body:
        return self

    def __exit__(self, *_: object) -> None:
        self._stoppers.shutdown(cancel_futures=True)
        if self._avoid is not None:
            self._avoid.end()
        self._state.close()
        self._link.close()

    def start(self, timeout: float) -> None:
        """Wait for the robot, and make it ready to walk if it is armed. Raises `DeviceError`."""
        self._state.wait(timeout)
        if self._sport is None:
            return
        if not self._sport.wait(timeout):
            raise DeviceError(
                "the robot tells its state, but nobody takes commands (rt/api/sport/request): its walking service is "
                "off, or another program holds it; switch to sport mode in the robot's app"
            )
        if self.mode == LOCKED:
            self._started("BalanceStand", SportClient(self._link, timeout=STARTING).balance_stand())
        if self._avoid is not None:
            self._started("obstacle avoidance", self._avoid.start())

    @staticmethod
    def _started(what: str, code: int) -> None:
        if code != OK:
            raise DeviceError(f"{what}: {in_words(code)}; look at the robot, then try again")

    def move(self, wanted: Velocity) -> None:
        """Send a velocity. Nothing comes back."""
        client = self._avoid or self._sport
        assert client is not None
        self._note("Move", client.move(*wanted.parts))

    def stop(self, number: int) -> None:
        """Send StopMove number `number`; `acknowledged` becomes that when the robot says so. Returns at once."""
        assert self._sport is not None
        if self._avoid is not None:
            self._avoid.stop()
        self._stoppers.submit(self._stop, number)

    def _stop(self, number: int) -> None:
        assert self._sport is not None
        code = self._sport.stop()
        self._note("StopMove", code)
        if code == OK:
            self.acknowledged = max(self.acknowledged or 0, number)

    def _note(self, what: str, code: int) -> None:
        self.problem = None if code == OK else f"{what}: {in_words(code)}"

    def faults(self) -> tuple[str, ...]:
        """What is wrong with the robot beside what `Body` tells, in words."""
        found = [] if (fault := self._state.fault) is None else [fault]
        if self.mode is not None and self.mode not in ABLE:
            found.append(
                f"the robot cannot walk: it is {MODES.get(self.mode, f'in mode {self.mode}')}; let it stand first"
            )
        other = self._others.newest
        if other is not None and (ago := time.monotonic() - other.when) < self._aside:
            found.append(f"somebody else commands the robot ({other.words}, {ago:.1f} s ago): end that program or app")
        return tuple(found)

    @property
    def pressed(self) -> frozenset[str] | None:
        """The buttons of the remote control that are pressed; None if that was not heard within 0.2 s."""
        reading = self._low and self._low.newest
        if reading is None or abs(time.time() - reading.received) > 0.2:
            return None
        return reading.remote.pressed

    def _received(self, state: BodyState) -> None:
        now = time.monotonic()
        self.mode = state.mode
        stamp = now - self._lateness.of(state.robot_stamp, now)
        self.body = Body.of(stamp, state.world_R_body, state.speed, state.yaw_rate, state.error_code)
