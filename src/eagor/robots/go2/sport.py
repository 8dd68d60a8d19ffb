"""What a Go2 is told: requests and responses of its services ``sport`` and ``obstacles_avoid``; who else tells it.

Only the commands in `ALLOWED` are ever sent: walking, standing, lying down, asking. Jumps, flips and handstands (1030
to 1032, 2041 to 2047) have no way out of this module. A robot obeys whoever spoke last, so the commands of others are
listened to. `examine` tells whether a Go2 can be heard and spoken to, without moving it.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from typing import Any

import numpy as np

from eagor.errors import DeviceError
from eagor.robots.dds import Link
from eagor.robots.go2.state import LONG, MODES, SOURCES, UNREADABLE, BodyState, Go2Low, Go2State

__all__ = [
    "ALLOWED", "CODES", "OK", "SEND", "TIMEOUT", "AvoidClient", "ForeignCommand", "ForeignCommands", "Report",
    "Service", "SportClient", "checked_velocity", "examine", "in_words",
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


# --- whether a Go2 can be heard and spoken to -------------------------------------------------------------------------

SLOW = {SOURCES["sport"]: 100.0, SOURCES["slow"]: 10.0}  # messages per second: less is a bad network
FINDING = 1.0  # seconds in which processes find each other
LATE = 0.05  # seconds by which one state in a hundred may come later than the quickest
MOVES, LONG_ENOUGH = (0.15, 0.2), 0.5  # m/s and rad/s beyond which a robot moves; seconds of that in a row
EMPTY = 15  # per cent of charge below which a walk may end on the way
PICTURES = ("sensor_msgs::msg::dds_::CompressedImage_", "sensor_msgs::msg::dds_::Image_")


@dataclass(frozen=True)
class Report:
    """What was heard. `problems`: sentences, each with what to change; empty if a Go2 can be used.

    `rates`: messages per second by topic. `clock`: seconds by which the robot's clock is ahead of this machine's, as
    the quickest message tells. `lateness`: seconds after the quickest, median and 99 of 100. `answer`: seconds to
    the answer of a question. `commands`: how many were sent by others meanwhile. None where nothing was heard.
    """

    topics: dict[str, str]
    rates: dict[str, float]
    firmware: str | None = None
    mode: str | None = None
    error_code: int | None = None
    clock: float | None = None
    lateness: tuple[float, float] | None = None
    battery: int | None = None
    volts: float | None = None
    sport_version: str | None = None
    answer: float | None = None
    commands: int = 0
    cameras: tuple[str, ...] = ()
    problems: tuple[str, ...] = field(default=())


def examine(link: Link, seconds: float = 3.0) -> Report:
    """Listen for `seconds`, ask for the version of the walking service, and tell. Nothing is moved or changed.

    Raises `DeviceError` if nobody is there.
    """
    topics = link.topics(FINDING)  # before this process writes any itself
    states: list[BodyState] = []
    odometry = {name: Go2State(link, name, received=states.append if name == "sport" else None) for name in SOURCES}
    low, sport, others = Go2Low(link), SportClient(link), ForeignCommands(link)
    time.sleep(FINDING)  # until readers and writers have found each other
    before = {name: source.count for name, source in odometry.items()}
    states.clear()
    begun = time.monotonic()
    time.sleep(seconds)
    took = time.monotonic() - begun
    robots = {topic for topic in topics if topic in SOURCES.values() or topic.startswith("rt/api/")}
    if not robots and not any(source.count for source in odometry.values()):
        where = f"domain {link.domain}, {link.interface or 'automatic interface'}"
        others = f"; others speak here: {', '.join(topics)}" if topics else ""
        raise DeviceError(
            f"no Go2 is heard within {took + 2 * FINDING:.0f} s ({where}{others}). Is it on? Is this machine on its "
            "network (address 192.168.123.x, mask 255.255.255.0), and is that --interface? Does a firewall hold back "
            "UDP?"
        )
    problems = [source.fault for source in odometry.values() if source.fault]
    rates = {
        source.topic: round((source.count - before[name]) / took, 1)
        for name, source in odometry.items()
        if source.count
    }
    newest = states[-1] if states else None
    main = odometry["sport"]
    if newest is None and main.fault is None:
        problems.append(_unheard(main, topics))
    else:
        problems += _slow(rates)
    late = np.array([state.received - state.stamp for state in states])
    lateness = (float(np.median(late)), float(np.quantile(late, 0.99))) if len(late) else None
    if lateness is not None and lateness[1] > LATE:
        problems.append(
            f"one state in a hundred comes {lateness[1]:.3f} s late: use a cable instead of Wi-Fi, or relieve this "
            "machine's processor"
        )
    if newest is not None and newest.error_code:
        problems.append(f"the robot reports error {newest.error_code}: look at its own app")
    problems += _commanded(others, states)
    version, answer, trouble = _asked(sport)
    if trouble:
        problems.append(trouble)
    reading = low.newest
    if reading is None:
        problems.append(f"nothing tells the battery and the remote control ({low.topic}): a deadman there cannot work")
    elif reading.soc < EMPTY:
        problems.append(f"the battery is at {reading.soc} %: charge it before a walk")
    offset = main.clock.offsets.offset
    for part in (*odometry.values(), low, sport, others):
        part.close()
    form = "with" if main.bytes == LONG else "without"
    return Report(
        topics, rates, firmware=None if main.bytes is None else f"states of {main.bytes} bytes, {form} a planned path",
        mode=None if newest is None else MODES.get(newest.mode or 0, f"mode {newest.mode}"),
        error_code=None if newest is None else newest.error_code,
        clock=None if offset is None or newest is None else -offset, lateness=lateness,
        battery=None if reading is None else reading.soc, volts=None if reading is None else reading.volts,
        sport_version=version, answer=answer, commands=others.count,
        cameras=tuple(topic for topic, kind in topics.items() if kind in PICTURES), problems=tuple(problems),
    )  # fmt: skip


def _unheard(main: Go2State, topics: dict[str, str]) -> str:
    if main.topic in topics:
        return f"{main.topic} is published, but {UNREADABLE}"
    return f"nobody publishes {main.topic}: the robot's walking has not started; restart it, or look at its app"


def _slow(rates: dict[str, float]) -> list[str]:
    return [
        f"{topic} comes only {rates[topic]:g} times per second (wanted {least:g} or more): use a cable instead of "
        "Wi-Fi, or relieve this machine's processor"
        for topic, least in SLOW.items()
        if rates.get(topic, least) < least
    ]


def _commanded(others: ForeignCommands, states: list[BodyState]) -> list[str]:
    """Whether somebody else commands the robot: on its topics, or because it moves and nobody here told it to."""
    if others.newest is not None:
        return [
            f"somebody else commands this robot ({others.count} times, the last {others.newest.words}): end that "
            "program or app, for a robot obeys whoever spoke last"
        ]
    since = None
    for state in states:
        if state.speed <= MOVES[0] and abs(state.yaw_rate) <= MOVES[1]:
            since = None
        elif state.received - (since := state.received if since is None else since) >= LONG_ENOUGH:
            return ["the robot moves although nobody tells it to on its topics: is it led by its remote control?"]
    return []


def _asked(sport: SportClient) -> tuple[str | None, float | None, str | None]:
    """The version of the walking service, how long the answer took, and what is wrong."""
    if not sport.wait(2.0):
        return None, None, "nobody takes commands (rt/api/sport/request): the robot's walking has not started"
    begun = time.monotonic()
    code, version = sport.api_version()
    if code != OK:
        return None, None, f"a question to the walking service: {in_words(code)} ({code}); restart the robot"
    return version, time.monotonic() - begun, None
