"""What a Go2 is told: requests and responses of its services ``sport`` and ``obstacles_avoid``; who else tells it.

Only the commands in `ALLOWED` are ever sent: walking, standing, asking. Jumps, flips and handstands (1030
to 1032, 2041 to 2047) have no way out of this module. A robot obeys whoever spoke last, so the commands of others are
listened to. `check_robot` tells whether a Go2 can be heard and spoken to, without moving it.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np

from eagor.errors import DeviceError
from eagor.robots.dds import Participant
from eagor.robots.go2 import state as idl
from eagor.robots.go2.state import LONG, MODES, SOURCES, BodyState, Go2Low, Go2State

__all__ = [
    "ALLOWED", "AVOID", "CODES", "OK", "SEND", "SPORT", "TIMEOUT", "AvoidClient", "Service",
    "SportClient", "check_robot", "checked_velocity", "hear_commands", "in_words",
]  # fmt: skip

OK, SEND, TIMEOUT = 0, 3102, 3104
FLOAT32 = 3.4028234663852886e38  # the largest number of 32 bits
API_VERSION = 1

# Codes of responses, and those that a client gives itself (Unitree's SDK).
CODES = {
    OK: "done", SEND: "could not be sent: no robot listens", TIMEOUT: "no answer in time",
    3202: "the robot failed inside", 3203: "the robot does not know this command",
    3204: "the robot does not understand the parameters", 3205: "the robot obeys somebody else now (lease)",
    3207: "somebody else has the lease", 4201: "the robot took too long",
    4202: "the robot's walking has not started yet",
}  # fmt: skip


# Commands of the services by their names in Unitree's SDK, and those that a request may have.
SPORT = {
    "Damp": 1001, "BalanceStand": 1002, "StopMove": 1003, "StandUp": 1004, "StandDown": 1005, "RecoveryStand": 1006,
    "Move": 1008,
}  # fmt: skip
AVOID = {"SwitchSet": 1001, "SwitchGet": 1002, "Move": 1003, "UseRemoteCommandFromApi": 1004}
COMMANDS = {"sport": SPORT, "obstacles_avoid": AVOID}
ALLOWED = {"sport": {API_VERSION, 1002, 1003, 1004, 1008}, "obstacles_avoid": {API_VERSION, 1001, 1003, 1004}}
# Those that only ask: versions, heights, the speed level, the state.
ASKING = {"sport": {API_VERSION, 1024, 1025, 1026, 1034}, "obstacles_avoid": {API_VERSION, AVOID["SwitchGet"]}}


def in_words(code: int) -> str:
    """A status code in words."""
    return CODES.get(code, f"refused with code {code}, which is not known here")


class Service:
    """Requests to the service `name` of the robot, ``rt/api/NAME/request``, and the responses by their numbers.

    `timeout`: seconds to wait for a response. May be used by several threads.
    """

    name = ""

    def __init__(self, link: Participant, *, timeout: float = 1.0) -> None:
        self.timeout = timeout
        self._writer = link.publish(f"rt/api/{self.name}/request", idl.Request)
        # Best effort takes responses from every writer, as the robot's own SDK does.
        self._reader = link.subscribe(f"rt/api/{self.name}/response", idl.Response, self._received)
        self._turn = threading.Condition()
        self._answers: dict[int, Any] = {}  # by the number of the request; None until it comes
        self._last = 0

    def wait(self, timeout: float = 5.0) -> bool:
        """Wait until somebody takes requests and gives responses; whether somebody does."""
        end = time.monotonic() + timeout
        while not (matched := self._writer.readers > 0 and bool(self._reader.matched)) and time.monotonic() < end:
            time.sleep(0.01)
        return matched

    def request(self, api_id: int, parameter: dict[str, Any] | None = None, *, reply: bool = True) -> tuple[int, str]:
        """Send a request and wait for its response: the status code, and what it says.

        Without a `reply` the code is 0 once it is on its way, which does not mean that it is obeyed.
        """
        if api_id not in ALLOWED[self.name]:
            raise DeviceError(f"command {api_id} of {self.name!r} is never sent; allowed are {ALLOWED[self.name]}")
        end = time.monotonic() + self.timeout
        if not (self.wait(self.timeout) if reply else self._writer.readers):
            return SEND, ""
        with self._turn:
            number = self._last = max(self._last + 1, time.monotonic_ns())
            if reply:
                self._answers[number] = None
        about = idl.RequestIdentity(number, api_id), idl.RequestLease(0), idl.RequestPolicy(0, not reply)
        try:
            self._writer.write(idl.Request(idl.RequestHeader(*about), json.dumps(parameter or {}, allow_nan=False), []))
            if not reply:
                return OK, ""
            with self._turn:
                self._turn.wait_for(lambda: self._answers[number] is not None, max(0.0, end - time.monotonic()))
                response = self._answers[number]
        except DeviceError:
            return SEND, ""
        finally:
            self._answers.pop(number, None)
        return (TIMEOUT, "") if response is None else (response.header.status.code, response.data)

    def _received(self, response: Any, when: float) -> None:
        with self._turn:
            if (number := response.header.identity.id) in self._answers:
                self._answers[number] = response
                self._turn.notify_all()


class SportClient(Service):
    """Walking. Each command returns its status code: 0, or what `in_words` says.

    A `move` holds for about a second, so it has to be sent again and again; its 0 means that it was sent. After
    `stand_up` a robot needs `balance_stand` and up to ten seconds before it heeds `move`.
    """

    name = "sport"

    def move(self, vx: float, vy: float, wz: float) -> int:
        """Walk forward and left (metres per second), turn left (radians per second). Raises `DeviceError` for NaN."""
        velocity = dict(zip("xyz", checked_velocity(vx, vy, wz), strict=True))
        return self.request(SPORT["Move"], velocity, reply=False)[0]

    def stop(self) -> int:
        """Stand still; 0 once the robot says so."""
        return self.request(SPORT["StopMove"])[0]

    def balance_stand(self) -> int:
        return self.request(SPORT["BalanceStand"])[0]

    def stand_up(self) -> int:
        """Stand up, with locked joints."""
        return self.request(SPORT["StandUp"])[0]


class AvoidClient(Service):
    """Walking that heeds obstacles by itself: ``obstacles_avoid``. Turn it on with `start` before `move`."""

    name = "obstacles_avoid"

    def start(self) -> int:
        """Heed obstacles, and take velocities from here instead of from the remote control; the first code not 0."""
        code, _ = self.request(AVOID["SwitchSet"], {"enable": True})
        return code or self.request(AVOID["UseRemoteCommandFromApi"], {"is_remote_commands_from_api": True})[0]

    def end(self) -> int:
        """Give velocities back to the remote control, and heed obstacles no more; the first code not 0."""
        code, _ = self.request(AVOID["UseRemoteCommandFromApi"], {"is_remote_commands_from_api": False})
        return code or self.request(AVOID["SwitchSet"], {"enable": False})[0]

    def move(self, vx: float, vy: float, wz: float) -> int:
        """As `SportClient.move`; the robot goes around obstacles, or stops before them."""
        x, y, yaw = checked_velocity(vx, vy, wz)
        return self.request(AVOID["Move"], {"x": x, "y": y, "yaw": yaw, "mode": 0}, reply=False)[0]

    def stop(self) -> int:
        """Walk no further; a `SportClient.stop` is answered, this is not."""
        return self.move(0.0, 0.0, 0.0)


def checked_velocity(vx: float, vy: float, wz: float) -> tuple[float, float, float]:
    """The three as floats. Raises `DeviceError` for what is no number of 32 bits, with which a robot computes."""
    numbers = float(vx), float(vy), float(wz)
    if not all(abs(number) <= FLOAT32 for number in numbers):  # neither does NaN
        raise DeviceError(f"velocities {numbers}; wanted three finite numbers of 32 bits (m/s, m/s, rad/s)")
    return numbers


def hear_commands(link: Participant, heard: Callable[[str], None], services: Iterable[str] = ALLOWED) -> None:
    """Call `heard("Move on rt/api/sport/request")`, in a thread, for what `services` are told by others than `link`.

    The robot's own remote control does not speak on these topics: only how the robot moves tells of it.
    """

    def received(service: str, request: Any, _: float) -> None:
        if (number := request.header.identity.api_id) not in ASKING[service]:
            names = {known: name for name, known in COMMANDS[service].items()}
            heard(f"{names.get(number, f'command {number}')} on rt/api/{service}/request")

    for service in services:
        link.subscribe(f"rt/api/{service}/request", idl.Request, partial(received, service), own=False)


# --- whether a Go2 can be heard and spoken to -------------------------------------------------------------------------

SLOW = {SOURCES["sport"]: 100.0, SOURCES["slow"]: 10.0}  # messages per second: less is a bad network
FINDING = 1.0  # seconds in which processes find each other
LATE = 0.05  # seconds by which one state in a hundred may come later than the quickest
MOVES = 0.15, 0.2  # m/s and rad/s beyond which a robot moves, in more than half of its states
EMPTY = 15  # per cent of charge below which a walk may end on the way
PICTURES = ("sensor_msgs::msg::dds_::CompressedImage_", "sensor_msgs::msg::dds_::Image_")
BUSY = "use a cable instead of Wi-Fi, or relieve this machine's processor"


def check_robot(link: Participant, seconds: float = 3.0) -> dict[str, Any]:
    """Listen for `seconds`, ask for the version of the walking service, and tell. Nothing is moved or changed.

    `problems`: sentences, each with what to change; empty if a Go2 can be used. `topics`: with their types; `cameras`:
    those of pictures; `rates`: messages per second by topic; `commands`: how many were sent by others meanwhile.
    Where it was heard: `firmware`, `mode`, `error_code`; `clock`: seconds by which the robot's clock is ahead of this
    machine's, as the quickest message tells; `lateness`: seconds after the quickest, median and 99 of 100; `battery`
    (per cent) and `volts`; `sport_version`, and the seconds to its `answer`. Raises `DeviceError` if nobody is there.
    """
    topics = link.topics(FINDING)  # before this process writes any itself
    states, others = list[BodyState](), list[str]()
    main = Go2State(link, received=states.append)
    odometry = [main, Go2State(link, "slow"), Go2State(link, "lidar")]
    low, sport = Go2Low(link), SportClient(link, timeout=2.0)
    hear_commands(link, others.append)
    time.sleep(FINDING)  # until readers and writers have found each other
    before, begun = [source.count for source in odometry], time.monotonic()
    states.clear()
    time.sleep(seconds)
    took = time.monotonic() - begun
    heard = {source.topic: source.count - count for source, count in zip(odometry, before, strict=True) if source.count}
    if not heard and not any(topic in SOURCES.values() or topic.startswith("rt/api/") for topic in topics):
        speak = f"; others speak here: {', '.join(topics)}" if topics else ""
        raise DeviceError(
            f"no Go2 is heard within {took + 2 * FINDING:.0f} s ({link}{speak}). Is it on? Is this machine on its "
            "network (address 192.168.123.x, mask 255.255.255.0), and is that --interface? Does a firewall hold back "
            "UDP?"
        )
    rates = {topic: round(count / took, 1) for topic, count in heard.items()}
    cameras = [topic for topic, kind in topics.items() if kind in PICTURES]
    found: dict[str, Any] = {"topics": topics, "cameras": cameras, "rates": rates, "commands": len(others)}
    problems = [fault for source in odometry if (fault := source.fault)]
    if main.bytes:
        path = "with" if main.bytes == LONG else "without"
        found["firmware"] = f"states of {main.bytes} bytes, {path} a planned path"
    if states:
        newest, late = states[-1], np.quantile([state.received - state.stamp for state in states], (0.5, 0.99))
        found |= {"mode": MODES.get(newest.mode or 0, f"mode {newest.mode}"), "error_code": newest.error_code}
        found |= {"clock": -(main.clock.offsets.offset or 0.0), "lateness": late.tolist()}
        problems += [
            f"{topic} comes only {rates[topic]:g} times per second (wanted {least:g} or more): {BUSY}"
            for topic, least in SLOW.items()
            if rates.get(topic, least) < least
        ]
        if late[1] > LATE:
            problems.append(f"one state in a hundred comes {late[1]:.3f} s late: {BUSY}")
        if newest.error_code:
            problems.append(f"the robot reports error {newest.error_code}: look at its own app")
    elif main.fault is None:
        nobody = f"nobody publishes {main.topic}: the robot's walking has not started; restart it"
        problems.append(main.silence(topics) or nobody)
    moving = sum(each.speed > MOVES[0] or abs(each.yaw_rate) > MOVES[1] for each in states)
    if others:
        problems.append(
            f"somebody else commands this robot ({len(others)} times, the last {others[-1]}): end that program or app, "
            "for a robot obeys whoever spoke last"
        )
    elif moving > 0.5 * len(states):
        problems.append("the robot moves although nobody tells it to on its topics: is it led by its remote control?")
    asked = time.monotonic()
    code, version = sport.request(API_VERSION)
    if code == OK:
        found |= {"sport_version": version, "answer": time.monotonic() - asked}
    else:
        problems.append(f"a question to the walking service: {in_words(code)} ({code}); start its walking again")
    if (reading := low.newest) is None:
        problems.append(f"nobody tells the battery and the remote control ({low.topic}): no dead-man switch there")
    else:
        found |= {"battery": reading.soc, "volts": reading.volts}
        if reading.soc < EMPTY:
            problems.append(f"the battery is at {reading.soc} %: charge it before a walk")
    return found | {"problems": problems}
