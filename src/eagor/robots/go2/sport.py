"""What a Go2 is told: requests and responses of its services ``sport`` and ``obstacles_avoid``; who else tells it.

Only the commands in `ALLOWED` are ever sent: walking, standing, lying down, asking. Jumps, flips and handstands (1030
to 1032, 2041 to 2047) have no way out of this module. A robot obeys whoever spoke last, so the commands of others are
listened to.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from typing import Any

from eagor.errors import DeviceError
from eagor.robots.dds import Link

__all__ = [
    "ALLOWED", "CODES", "OK", "SEND", "TIMEOUT", "AvoidClient", "ForeignCommand", "ForeignCommands", "Service",
    "SportClient", "checked_velocity", "in_words",
]  # fmt: skip

OK, SEND, TIMEOUT = 0, 3102, 3104
FLOAT32 = 3.4028234663852886e38  # the largest number of 32 bits
API_VERSION = 1

# Codes of responses, and those that a client gives itself (Unitree's SDK).
CODES = {
    OK: "done",
    3001: "failed, nobody knows why",
    SEND: "could not be sent: no robot listens",
    3103: "the client does not know this command",
    TIMEOUT: "no answer in time",
    3105: "an answer to another command came",
    3106: "the answer cannot be read",
    3107: "somebody else has the lease",
    3201: "the robot could not send its answer",
    3202: "the robot failed inside",
    3203: "the robot does not know this command",
    3204: "the robot does not understand the parameters",
    3205: "the robot obeys somebody else now (lease)",
    3206: "the lease has ended",
    3207: "somebody else has the lease",
    4101: "the path is wrong",
    4201: "the robot took too long",
    4202: "the robot's walking has not started yet",
}


class Sport(IntEnum):
    """Commands of the service ``sport``, by their names in Unitree's SDK."""

    DAMP = 1001
    BALANCE_STAND = 1002
    STOP_MOVE = 1003
    STAND_UP = 1004
    STAND_DOWN = 1005
    RECOVERY_STAND = 1006
    MOVE = 1008


class Avoid(IntEnum):
    """Commands of the service ``obstacles_avoid``."""

    SWITCH_SET = 1001
    SWITCH_GET = 1002
    MOVE = 1003
    USE_REMOTE_COMMAND_FROM_API = 1004


COMMANDS: dict[str, type[IntEnum]] = {"sport": Sport, "obstacles_avoid": Avoid}
# Numbers that a request of each service may have.
ALLOWED = {
    "sport": frozenset({API_VERSION, *Sport} - {Sport.DAMP, Sport.RECOVERY_STAND}),
    "obstacles_avoid": frozenset({API_VERSION, *Avoid}),
}
# Those that only ask: versions, heights, the speed level, the state.
ASKING = {"sport": {API_VERSION, 1024, 1025, 1026, 1034}, "obstacles_avoid": {API_VERSION, Avoid.SWITCH_GET}}


def in_words(code: int) -> str:
    """A status code in words."""
    return CODES.get(code, f"refused with code {code}, which is not known here")


class Service:
    """Requests to one service of the robot, ``rt/api/NAME/request``, and the responses by their numbers.

    `timeout`: seconds to wait for a response. May be used by several threads.
    """

    def __init__(self, link: Link, name: str, *, timeout: float = 1.0) -> None:
        from eagor.robots.go2.idl import Request, Response

        self.name, self.timeout = name, timeout
        self._allowed = ALLOWED[name]
        self._writer = link.publish(f"rt/api/{name}/request", Request)
        # Best effort takes responses from every writer, as the robot's own SDK does.
        self._reader = link.subscribe(f"rt/api/{name}/response", Response, self._received)
        self._turn = threading.Condition()
        self._answers: dict[int, Any] = {}  # by the number of the request; None until it comes
        self._last = 0

    @property
    def heard(self) -> bool:
        """Whether somebody takes requests and gives responses."""
        return self._writer.readers > 0 and self._reader.writers > 0

    def wait(self, timeout: float = 5.0) -> bool:
        """Wait until the service is `heard`; whether it is."""
        end = time.monotonic() + timeout
        while not (heard := self.heard) and time.monotonic() < end:
            time.sleep(0.01)
        return heard

    def call(self, api_id: int, parameter: dict[str, Any] | None = None) -> tuple[int, str]:
        """Send a request and wait for its response: the status code, and what it says."""
        end = time.monotonic() + self.timeout
        if not self.wait(self.timeout):
            return SEND, ""
        with self._turn:
            number = self._number()
            self._answers[number] = None
        try:
            if (code := self._send(number, api_id, parameter, reply=True)) != OK:
                return code, ""
            with self._turn:
                self._turn.wait_for(lambda: self._answers[number] is not None, max(0.0, end - time.monotonic()))
        finally:
            with self._turn:
                response = self._answers.pop(number)
        if response is None:
            return TIMEOUT, ""
        if response.header.identity.api_id != api_id:
            return 3105, ""
        return response.header.status.code, response.data

    def tell(self, api_id: int, parameter: dict[str, Any] | None = None) -> int:
        """Send a request that has no response: 0 once it is on its way, which does not mean that it is obeyed."""
        if self._writer.readers == 0:
            return SEND
        with self._turn:
            number = self._number()
        return self._send(number, api_id, parameter, reply=False)

    def api_version(self) -> tuple[int, str]:
        """The version of the service; moves nothing."""
        return self.call(API_VERSION)

    def close(self) -> None:
        """Stop listening."""
        self._reader.close()
        self._writer.close()

    def _number(self) -> int:
        self._last = max(self._last + 1, time.monotonic_ns())
        return self._last

    def _send(self, number: int, api_id: int, parameter: dict[str, Any] | None, *, reply: bool) -> int:
        from eagor.robots.go2.idl import Request, RequestHeader, RequestIdentity, RequestLease, RequestPolicy

        if api_id not in self._allowed:
            known = ", ".join(map(str, sorted(self._allowed)))
            raise DeviceError(f"command {api_id} of {self.name!r} is never sent; allowed are {known}")
        header = RequestHeader(RequestIdentity(number, api_id), RequestLease(0), RequestPolicy(0, not reply))
        try:
            self._writer.write(Request(header, json.dumps(parameter or {}, allow_nan=False), []))  # type: ignore[arg-type]
        except DeviceError:
            return SEND
        return OK

    def _received(self, response: Any, when: float) -> None:
        number = response.header.identity.id
        with self._turn:
            if number in self._answers and self._answers[number] is None:
                self._answers[number] = response
                self._turn.notify_all()


class SportClient(Service):
    """Walking. Each command returns its status code: 0, or what `in_words` says.

    A `move` holds for about a second, so it has to be sent again and again; its 0 means that it was sent. After
    `stand_up` a robot needs `balance_stand` and up to ten seconds before it heeds `move`.
    """

    def __init__(self, link: Link, *, timeout: float = 1.0) -> None:
        super().__init__(link, "sport", timeout=timeout)

    def move(self, vx: float, vy: float, wz: float) -> int:
        """Walk forward and left (metres per second), turn left (radians per second). Raises `DeviceError` for NaN."""
        x, y, z = checked_velocity(vx, vy, wz)
        return self.tell(Sport.MOVE, {"x": x, "y": y, "z": z})

    def stop(self) -> int:
        """Stand still; 0 once the robot says so."""
        return self.call(Sport.STOP_MOVE)[0]

    def balance_stand(self) -> int:
        """Stand, ready to walk."""
        return self.call(Sport.BALANCE_STAND)[0]

    def stand_up(self) -> int:
        """Stand up, with locked joints."""
        return self.call(Sport.STAND_UP)[0]

    def stand_down(self) -> int:
        """Lie down."""
        return self.call(Sport.STAND_DOWN)[0]


class AvoidClient(Service):
    """Walking that heeds obstacles by itself: ``obstacles_avoid``. Turn it on with `start` before `move`."""

    def __init__(self, link: Link, *, timeout: float = 1.0) -> None:
        super().__init__(link, "obstacles_avoid", timeout=timeout)

    def start(self) -> int:
        """Heed obstacles, and take velocities from here instead of from the remote control; the first code not 0."""
        return self._both(True)

    def end(self) -> int:
        """Give velocities back to the remote control, and heed obstacles no more; the first code not 0."""
        return self._both(False)

    def on(self) -> bool | None:
        """Whether obstacles are heeded; None if the robot does not say."""
        code, said = self.call(Avoid.SWITCH_GET)
        try:
            return bool(json.loads(said)["enable"]) if code == OK else None
        except (ValueError, KeyError, TypeError):
            return None

    def move(self, vx: float, vy: float, wz: float) -> int:
        """As `SportClient.move`; the robot goes around obstacles, or stops before them."""
        x, y, yaw = checked_velocity(vx, vy, wz)
        return self.tell(Avoid.MOVE, {"x": x, "y": y, "yaw": yaw, "mode": 0})

    def stop(self) -> int:
        """Walk no further; a `SportClient.stop` is answered, this is not."""
        return self.move(0.0, 0.0, 0.0)

    def _both(self, on: bool) -> int:
        first = (Avoid.SWITCH_SET, {"enable": on})
        second = (Avoid.USE_REMOTE_COMMAND_FROM_API, {"is_remote_commands_from_api": on})
        for api_id, parameter in (first, second) if on else (second, first):
            if (code := self.call(api_id, parameter)[0]) != OK:
                return code
        return OK


def checked_velocity(vx: float, vy: float, wz: float) -> tuple[float, float, float]:
    """The three as floats. Raises `DeviceError` for what is no number of 32 bits, with which a robot computes."""
    x, y, z = numbers = float(vx), float(vy), float(wz)
    if not all(abs(number) <= FLOAT32 for number in numbers):  # neither does NaN
        raise DeviceError(f"velocities {numbers}; wanted three finite numbers of 32 bits (m/s, m/s, rad/s)")
    return x, y, z


@dataclass(frozen=True)
class ForeignCommand:
    """A command of somebody else. `when`: ``time.monotonic()`` of its arrival."""

    when: float
    service: str
    api_id: int

    @property
    def words(self) -> str:
        """The command and its topic: "Move on rt/api/sport/request"."""
        try:
            name = COMMANDS[self.service](self.api_id).name.title().replace("_", "")
        except ValueError:
            name = f"command {self.api_id}"
        return f"{name} on rt/api/{self.service}/request"


class ForeignCommands:
    """Listens to the commands that `services` of a Go2 are given by others than `link`.

    `newest`: the last of them; `count`: how many came.
    The robot's own remote control does not speak on these topics: only how the robot moves tells of it.
    """

    def __init__(self, link: Link, services: Iterable[str] = ALLOWED) -> None:
        from eagor.robots.go2.idl import Request

        self.newest: ForeignCommand | None = None
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
            self.newest = ForeignCommand(time.monotonic(), service, api_id)
            self.count += 1
