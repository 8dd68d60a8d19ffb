"""Whether a Go2 can be heard and spoken to: what it says within a few seconds, without moving it."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from eagor.errors import DeviceError
from eagor.robots.dds import Link
from eagor.robots.go2.sport import OK, ForeignCommands, SportClient, in_words
from eagor.robots.go2.state import MODES, SOURCES, UNREADABLE, BodyState, Go2Low, Go2State
from eagor.robots.go2.wire import LONG

__all__ = ["Report", "examine"]

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
    return Report(
        topics,
        rates,
        firmware=None if main.bytes is None else f"states of {main.bytes} bytes, {_form(main.bytes)}",
        mode=None if newest is None else MODES.get(newest.mode or 0, f"mode {newest.mode}"),
        error_code=None if newest is None else newest.error_code,
        clock=None if offset is None or newest is None else -offset,
        lateness=lateness,
        battery=None if reading is None else reading.soc,
        volts=None if reading is None else reading.volts,
        sport_version=version,
        answer=answer,
        commands=others.count,
        cameras=tuple(topic for topic, kind in topics.items() if kind in PICTURES),
        problems=tuple(problems),
    )


def _form(size: int) -> str:
    return "with a planned path" if size == LONG else "without a planned path"


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
