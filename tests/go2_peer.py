"""A Go2's wire as the tests of the guard need it, written apart from the simulator: it notes what it is told, and when.

Its body is the same physics in another form: after a dead time the speed goes to what is commanded, first order.
"""

from __future__ import annotations

import json
import math
import threading
import time
from dataclasses import dataclass, field

from eagor.robots.dds import Link, raw
from eagor.robots.go2 import state as idl
from eagor.robots.go2.sim import LiveGo2, SimSettings, SimulatedGo2
from eagor.robots.go2.state import Remote, low_state, sport_state

GAINS, LAG, DEAD, EXPIRY = (0.80, 0.74, 0.90), 0.30, 0.15, 1.0


@dataclass
class Told:
    """A request: when it came (monotonic), its number, the velocity of a Move."""

    when: float
    api_id: int
    velocity: tuple[float, float, float] | None = None


@dataclass
class Noted:
    """What a robot was told and how its body moved, with times (monotonic)."""

    told: list[Told] = field(default_factory=list)
    speeds: list[tuple[float, tuple[float, ...]]] = field(default_factory=list)

    def commanded(self, when: float) -> tuple[float, float, float]:
        """The velocity that holds at a time, as far as requests have come."""
        for told in reversed(self.told):
            if told.when > when or told.api_id not in (1003, 1008):
                continue
            return told.velocity if told.velocity and when - told.when < EXPIRY else (0.0, 0.0, 0.0)
        return (0.0, 0.0, 0.0)

    def zero_since(self, when: float) -> float | None:
        """The first time from `when` on at which nothing is commanded, and from which nothing is; None: it still is."""
        now, zero = time.monotonic(), (when if not any(self.commanded(when)) else None)
        last = max((told.when for told in self.told if told.velocity and told.when <= when), default=-math.inf)
        for told in [*self.told, Told(now, 0)]:
            if told.when < when or told.api_id not in (0, 1003, 1008):
                continue
            if zero is None and told.when - last > EXPIRY:
                zero = last + EXPIRY
            moves = told.velocity is not None and any(told.velocity)
            last = told.when if moves else last
            if told.api_id:
                zero = None if moves else (told.when if zero is None else zero)
        return zero

    def still_since(self, when: float) -> float | None:
        """The time since when the body is below 0.05 m/s and 0.05 rad/s; None if it is not, or was not seen since."""
        found = None
        for stamp, (x, y, turn) in list(self.speeds):
            still = math.hypot(x, y) < 0.05 and abs(turn) < 0.05
            found = (stamp if found is None else found) if still else None
        return None if found is None else max(found, when)

    @property
    def moves(self) -> bool:
        x, y, turn = self.speeds[-1][1] if self.speeds else (0.0, 0.0, 0.0)
        return math.hypot(x, y) > 0.05 or abs(turn) > 0.05


@dataclass
class Peer(Noted):
    """A robot on `domain` (interface lo); a context manager. Change the fields to make something wrong."""

    domain: int = 0
    roll: float = 0.0
    error_code: int = 0
    mute: bool = False  # tells no state
    growing: float = 0.0  # seconds per second by which its states come later and later
    deaf: int = 0  # so many StopMove are neither obeyed nor acknowledged
    stuck: bool = False  # Move has no effect
    mode: int = 1
    pressed: frozenset[str] | None = frozenset()  # buttons of its remote control; None: it tells nothing of them

    def __enter__(self):
        self._ended, self._turn = threading.Event(), threading.Lock()
        self._link = Link(self.domain, "lo")
        self._state = self._link.publish("rt/sportmodestate", raw(idl.SportModeState))
        self._low = self._link.publish("rt/lf/lowstate", idl.LowState)
        self._reply = self._link.publish("rt/api/sport/response", idl.Response)
        self._link.subscribe("rt/api/sport/request", idl.Request, self._request, reliable=True)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()
        self._link.close()

    def _request(self, request, _):
        now, identity = time.monotonic(), request.header.identity
        told = Told(now, identity.api_id)
        if told.api_id == 1003 and self.deaf > 0:
            self.deaf -= 1
            told.api_id = -1003
        if told.api_id == 1008:
            asked = json.loads(request.parameter)
            told.velocity = (asked["x"], asked["y"], asked["z"])
        with self._turn:
            self.told.append(told)
        if told.api_id > 0 and not request.header.policy.noreply:
            head = idl.ResponseHeader(idl.RequestIdentity(identity.id, identity.api_id), idl.ResponseStatus(0))
            self._reply.write(idl.Response(head, "", []))

    def _run(self):
        before, speed, count, late = time.monotonic(), (0.0, 0.0, 0.0), 0, 0.0
        kind = raw(idl.SportModeState)
        while not self._ended.wait(0.005):
            now = time.monotonic()
            share = 1 - math.exp(-(now - before) / LAG)
            told = (0.0, 0.0, 0.0) if self.stuck else self.commanded(now - DEAD)
            speed = tuple(v + share * (g * c - v) for v, g, c in zip(speed, GAINS, told, strict=True))
            late = late + self.growing * (now - before) if self.growing else 0.0
            before = now
            self.speeds.append((now, speed))
            stamp, half = time.time() - late, self.roll / 2
            if not self.mute:
                data = sport_state(
                    stamp, (math.cos(half), math.sin(half), 0.0, 0.0), rpy=(self.roll, 0.0, 0.0), mode=self.mode,
                    velocity=(*speed[:2], 0.0), yaw_speed=speed[2], error_code=self.error_code,
                )  # fmt: skip
                self._state.write(kind(data))
            if self.pressed is not None and (count := count + 1) % 10 == 0:
                self._low.write(low_state(Remote(self.pressed)))


@dataclass
class Simulated(Noted):
    """The package's own simulated Go2 on `domain` (interface lo), and a reader beside it that notes what it is told."""

    domain: int = 0

    def __enter__(self):
        self._link = Link(self.domain, "lo")
        self.server = LiveGo2(SimulatedGo2(SimSettings(None)), self.domain).__enter__()
        self._link.subscribe("rt/api/sport/request", idl.Request, self._request, reliable=True)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()
        self.server.close()
        self._link.close()

    @property
    def error_code(self) -> int:
        return self.server.error_code

    @error_code.setter
    def error_code(self, code: int) -> None:
        self.server.error_code = code

    def _request(self, request, _):
        told = Told(time.monotonic(), request.header.identity.api_id)
        if told.api_id == 1008:
            asked = json.loads(request.parameter)
            told.velocity = (asked["x"], asked["y"], asked["z"])
        self.told.append(told)

    def _watch(self):
        while not self._ended.wait(0.005):
            motion = self.server.truth
            velocity = motion.pose.world_R_body.T @ motion.velocity
            self.speeds.append((time.monotonic(), (float(velocity[0]), float(velocity[1]), motion.yaw_rate)))
