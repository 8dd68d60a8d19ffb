"""Who else commands a Go2: requests to its walking that come from elsewhere. A robot obeys whoever spoke last."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

from eagor.robots.dds import Link
from eagor.robots.go2.sport import ALLOWED, API_VERSION, AVOID_GET

__all__ = ["Heard", "Others"]

# Requests that only ask, by service: versions, heights, the speed level, the state (Unitree's SDK).
ASKING = {"sport": {API_VERSION, 1024, 1025, 1026, 1034}, "obstacles_avoid": {API_VERSION, AVOID_GET}}
WORDS = {
    "sport": {1001: "Damp", 1002: "BalanceStand", 1003: "StopMove", 1004: "StandUp", 1005: "StandDown", 1008: "Move"},
    "obstacles_avoid": {1001: "SwitchSet", 1003: "Move", 1004: "UseRemoteCommandFromApi"},
}


@dataclass(frozen=True)
class Heard:
    """A command of somebody else. `when`: ``time.monotonic()`` of its arrival."""

    when: float
    service: str
    api_id: int

    @property
    def words(self) -> str:
        """The command and its topic: "Move on rt/api/sport/request"."""
        name = WORDS[self.service].get(self.api_id, f"command {self.api_id}")
        return f"{name} on rt/api/{self.service}/request"


class Others:
    """Listens to the commands that `services` of a Go2 are given by others than `link`.

    `newest`: the last of them; `count`: how many came.
    The robot's own remote control does not speak on these topics: only how the robot moves tells of it.
    """

    def __init__(self, link: Link, services: Iterable[str] = ALLOWED) -> None:
        from eagor.robots.go2.idl import Request

        self.newest: Heard | None = None
        self.count = 0
        self._readers = [
            link.subscribe(f"rt/api/{name}/request", Request, partial(self._came, name), own=False) for name in services
        ]

    def close(self) -> None:
        """Stop listening."""
        for reader in self._readers:
            reader.close()

    def _came(self, service: str, request: Any, _: float) -> None:
        if (api_id := request.header.identity.api_id) not in ASKING[service]:
            self.newest = Heard(time.monotonic(), service, api_id)
            self.count += 1
