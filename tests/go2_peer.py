"""The simulated Go2 as tests of the guard need it: it notes what it is told, and when, and can be made to go wrong."""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass

from eagor.robots.go2.plant import STEP
from eagor.robots.go2.sim import SimSettings, SimulatedGo2
from eagor.robots.go2.state import low_state, sport_state

STOP, MOVE, UNHEARD, EXPIRY = 1003, 1008, -1003, 1.0


@dataclass
class Told:
    """A request: when it came (monotonic), its number, the velocity of a Move."""

    when: float
    api_id: int
    velocity: tuple[float, float, float] | None = None


class Peer(SimulatedGo2):
    """A robot on `domain` (interface lo); a context manager. Change its fields to make something wrong.

    `told`: its requests; `speeds`: of its body, with times (monotonic). `mute`: it tells no state; `silent`: nothing of
    its remote control; `growing`: seconds per second by which states come later and later; `roll`: radians by which it
    says that it leans; `deaf`: so many StopMove are neither obeyed nor acknowledged.
    """

    def __init__(self, domain: int) -> None:
        super().__init__(SimSettings(None), domain)
        self.told: list[Told] = []
        self.speeds: list[tuple[float, tuple[float, float, float]]] = []
        self.mute = self.silent = False
        self.deaf, self.growing, self.late, self.roll = 0, 0.0, 0.0, 0.0

    def _answer(self, service, responses, request, when):
        told = Told(time.monotonic(), request.header.identity.api_id)
        if service == "sport":
            if told.api_id == STOP and self.deaf > 0:
                self.deaf, told.api_id = self.deaf - 1, UNHEARD
            if told.api_id == MOVE:
                told.velocity = tuple(json.loads(request.parameter).values())
            self.told.append(told)
        if told.api_id != UNHEARD:
            super()._answer(service, responses, request, when)

    def _send_states(self) -> None:
        motion = self.plant.truth
        x, y, _ = (motion.pose.world_R_body.T @ motion.velocity).tolist()
        self.speeds.append((time.monotonic(), (x, y, motion.yaw_rate)))
        self.late = self.late + self.growing * STEP if self.growing else 0.0
        if not (self.mute or self.silent or self.late or self.roll):
            super()._send_states()
        elif not self.mute:
            turned = math.cos(self.roll / 2), math.sin(self.roll / 2), 0.0, 0.0
            state = sport_state(time.time() - self.late, turned, velocity=(x, y, 0.0), yaw_speed=motion.yaw_rate)
            self._writers["rt/sportmodestate"].write(self._state(state))
            if not self.silent and self.plant.steps % 10 == 0:
                self._writers["rt/lf/lowstate"].write(low_state(self.pressed))

    def _velocities(self) -> list[Told]:
        return [told for told in self.told if told.api_id in (STOP, MOVE)]

    @property
    def commanded(self) -> tuple[float, float, float]:
        """The velocity that holds now, as far as requests have come."""
        last = next(reversed(self._velocities()), Told(0.0, STOP))
        return (last.velocity if time.monotonic() - last.when <= EXPIRY else None) or (0.0, 0.0, 0.0)

    def zero_since(self, when: float) -> float | None:
        """The first time from `when` on from which nothing is commanded any more; None: something still is."""
        told = self._velocities()
        last = max((at for at, each in enumerate(told) if any(each.velocity or ())), default=None)
        if last is None:
            return when
        end = min([told[last].when + EXPIRY, *(each.when for each in told[last + 1 : last + 2])])
        return max(end, when) if end <= time.monotonic() else None

    def still_since(self, when: float) -> float | None:
        """The time since when the body is below 0.05 m/s and 0.05 rad/s; None if it is not."""
        found = None
        for stamp, speed in reversed(self.speeds):
            if moves(speed):
                break
            found = stamp
        return None if found is None else max(found, when)

    @property
    def moves(self) -> bool:
        return bool(self.speeds) and moves(self.speeds[-1][1])


def moves(speed: tuple[float, float, float]) -> bool:
    return math.hypot(*speed[:2]) >= 0.05 or abs(speed[2]) >= 0.05
