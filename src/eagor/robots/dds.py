"""DDS, the transport of ROS 2 and of Unitree's robots: topics are written and read without ROS being installed.

A `Link` is a process's place on a domain: it writes topics, and reads them in threads of its own.
"""

from __future__ import annotations

import os
import random
import socket
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Self

from eagor._checks import whole
from eagor._extras import need
from eagor.errors import DeviceError
from eagor.media.ros_messages import encoded_type, hash_of, store, topic_name

__all__ = ["LAST_DOMAIN", "Link", "Reader", "Writer", "checked_domain", "default_domain", "free_domain"]

LAST_DOMAIN = 232  # above, the ports that the standard derives from the number do not exist (DDSI-RTPS 9.6.1.1)
PARTICIPANTS = 64  # most processes of one domain on this machine: each has ports of its own
LOOPBACK = "lo"
FIRST_PORT, PORTS = 7400, 250  # of domain 0, and per domain (DDSI-RTPS 9.6.1.1)
LOOKED_AT = 8  # participants of a domain whose ports tell whether it is in use
FREE = range(1, 120)  # above, ports meet those that the system gives away

# The loopback interface has no multicast, so processes ask each other's ports one by one.
_LOCAL = f"""<CycloneDDS><Domain Id="any">
<General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{PARTICIPANTS}</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
# Cyclone 0.10, which robots run, finds a newer one on the same machine only by an index (measured).
_NETWORK = """<CycloneDDS><Domain Id="any">
<General><Interfaces><NetworkInterface {which} multicast="default"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{most}</MaxAutoParticipantIndex></Discovery>
</Domain></CycloneDDS>"""

BLOCKED = 0.1  # seconds that a reliable writer waits for a reader that does not keep up
WAIT = 0.2  # seconds after which a reader's thread looks whether it is to end
_DOMAINS: dict[int, tuple[str | None, Any]] = {}  # cyclonedds settles a domain once per process
_TURN = threading.Lock()


def checked_domain(domain: int) -> int:
    """The domain's number. Raises `DeviceError` if no such domain can be."""
    if not whole(domain, 0, LAST_DOMAIN):
        raise DeviceError(f"DDS domain {domain!r}; wanted a whole number from 0 to {LAST_DOMAIN} (ROS_DOMAIN_ID)")
    return int(domain)


def default_domain() -> int:
    """The domain of the environment (ROS_DOMAIN_ID), else 0. Raises `DeviceError` if it is no number."""
    told = os.environ.get("ROS_DOMAIN_ID", "").strip()
    try:
        return int(told or 0)
    except ValueError:
        raise DeviceError(f"ROS_DOMAIN_ID is {told!r}; wanted a whole number from 0 to {LAST_DOMAIN}") from None


def _domain_xml(interface: str | None) -> str:
    """Cyclone DDS's XML for a network interface ("eth0"); None lets it choose, "lo" stays on this machine.

    Raises `DeviceError` if there is no such interface.
    """
    if interface is None:
        return _NETWORK.format(which='autodetermine="true"', most=PARTICIPANTS)
    known = [name for _, name in socket.if_nameindex()]
    if interface not in known:
        raise DeviceError(f"there is no network interface {interface!r}; this machine has {', '.join(known)}")
    return _LOCAL if interface == LOOPBACK else _NETWORK.format(which=f'name="{interface}"', most=PARTICIPANTS)


def free_domain() -> int:
    """A DDS domain on which nobody of this machine listens, chosen at random: others may look for one right now.

    Raises `DeviceError` if there is none.
    """
    for domain in random.SystemRandom().sample(FREE, len(FREE)):
        if all(_is_free(FIRST_PORT + PORTS * domain + 10 + 2 * index) for index in range(LOOKED_AT)):
            return domain
    raise DeviceError("every DDS domain of this machine is in use: end some programs that use DDS")


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


class Link:
    """A participant of DDS domain `domain` on a network interface; a context manager.

    `interface`: such as "eth0"; "lo" stays on this machine; None lets the library choose. A process has one interface
    per domain. `user_data`: what the participant says of itself. Raises `MissingExtraError`, and `DeviceError` for a
    domain or interface that cannot be had.
    """

    def __init__(self, domain: int = 0, interface: str | None = None, user_data: bytes = b"") -> None:
        need("DDS (ROS 2, Unitree)", "robot", "cyclonedds", "rosbags")
        from cyclonedds.core import DDSException
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.qos import Policy, Qos

        self.domain, self.interface = checked_domain(domain), interface
        _settle(self.domain, interface)
        try:
            self._participant = DomainParticipant(self.domain, Qos(Policy.Userdata(user_data)))
        except DDSException as error:
            raise DeviceError(
                f"DDS domain {domain} cannot be joined on {interface or 'this machine'} ({error.msg}): too many "
                "processes may use it. End some, or take another domain"
            ) from error
        self._parts: list[Reader | Writer] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End all readers and writers. May be called twice."""
        for part in self._parts:
            part.leave()  # all at once: each waits for its thread
        while self._parts:
            self._parts.pop().close()
        participant, self._participant = self._participant, None
        del participant  # cyclonedds lets go of it when nothing refers to it

    def publish(
        self,
        topic: str,
        kind: str | type,
        *,
        reliable: bool = True,
        depth: int = 10,
        transient: bool = False,
        user_data: bytes = b"",
    ) -> Writer:
        """A writer of `topic`.

        `kind`: a ROS type's name ("sensor_msgs/msg/Imu"; messages are `rosbags`' dataclasses, and the topic is named as
        ROS names it), or a class of cyclonedds' IDL. `depth`: how many messages are kept for a reader that is late.
        `transient`: whether readers that come later get them, too. `user_data`: what it says of itself; a ROS type says
        its hash. Defaults: those of ROS 2.
        """
        from cyclonedds.pub import DataWriter

        made = self._topic(topic, kind)
        qos = _qos(reliable, depth, transient, hash_of(kind) if isinstance(kind, str) else user_data)
        writer = Writer(kind, DataWriter(self.participant, made, qos))
        self._parts.append(writer)
        return writer

    def subscribe(
        self,
        topic: str,
        kind: str | type,
        received: Callable[[Any, float], None],
        *,
        reliable: bool = False,
        depth: int = 10,
        transient: bool = False,
        own: bool = True,
    ) -> Reader:
        """Call ``received(message, when)`` for every message, in a thread; `when` is ``time.time()`` at arrival.

        An exception in `received`, or a message that cannot be decoded, is told once as a `UserWarning`, and counted
        (`Reader.damaged`). A best-effort reader (default) takes from every writer, a reliable one from reliable ones.
        `own`: also what this link itself writes.
        """
        from cyclonedds.sub import DataReader

        made = self._topic(topic, kind)
        qos = _qos(reliable, depth, transient, hash_of(kind) if isinstance(kind, str) else b"", own)
        reader = Reader(topic, kind, DataReader(self.participant, made, qos), received)
        self._parts.append(reader)
        return reader

    def topics(self, wait: float = 1.0) -> dict[str, str]:
        """Topics that are written on this domain, with their types' DDS names, as found within `wait` seconds."""
        return dict(sorted(self.publications(wait)))

    def publications(self, wait: float = 1.0, *, own: bool = True) -> list[tuple[str, str]]:
        """Topic and type's DDS name of every writer on this domain, as found within `wait` seconds.

        `own`: also those of this link.
        """
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication

        reader = BuiltinDataReader(self.participant, BuiltinTopicDcpsPublication)
        found: dict[Any, tuple[str, str]] = {}
        end = time.monotonic() + wait
        while True:
            for sample in reader.take(N=100):
                if (name := getattr(sample, "topic_name", None)) is None:  # a writer that has gone
                    continue
                if own or sample.participant_key != self.participant.guid:
                    found[sample.key] = name, sample.type_name
            if time.monotonic() >= end:
                return list(found.values())
            time.sleep(0.02)

    @property
    def parts(self) -> list[Reader | Writer]:
        """Its readers and writers that are not closed."""
        return [part for part in [*self._parts] if part.open]

    @property
    def participant(self) -> Any:
        """cyclonedds' participant. Raises `DeviceError` once the link is closed."""
        if self._participant is None:
            raise DeviceError("this link is closed; make another one")
        return self._participant

    def _topic(self, topic: str, kind: str | type) -> Any:
        from cyclonedds.topic import Topic

        if isinstance(kind, str):
            return Topic(self.participant, topic_name(topic), encoded_type(kind))  # type: ignore[type-var]
        return Topic(self.participant, topic, kind)


class Writer:
    """Writes messages of one topic (`Link.publish`). `guid`: its id, 16 bytes."""

    reads = False

    def __init__(self, kind: str | type, writer: Any) -> None:
        self._kind, self.guid = kind, writer.guid.bytes
        self._writer: Any = writer
        self._encoded = encoded_type(kind) if isinstance(kind, str) else None

    @property
    def readers(self) -> int:
        """How many readers it has now."""
        return len(self._writer.get_matched_subscriptions())

    def write(self, message: Any) -> None:
        """Send `message`. Raises `DeviceError` if the network does not take it."""
        from cyclonedds.core import DDSException

        if self._encoded is not None:
            message = self._encoded(bytes(store().serialize_cdr(message, self._kind)))
        try:
            self._writer.write(message)
        except DDSException as error:
            raise DeviceError(f"a message of {self._writer.topic.name} could not be sent: {error.msg}") from error

    @property
    def open(self) -> bool:
        """Whether it is not closed."""
        return self._writer is not None

    def leave(self) -> None:
        """Nothing is to be waited for."""

    def close(self) -> None:
        """Stop writing."""
        self._writer = None


class Reader:
    """Reads one topic in a thread (`Link.subscribe`). `damaged`: messages that could not be used; `guid`: its id."""

    reads = True

    def __init__(self, topic: str, kind: str | type, reader: Any, received: Callable[[Any, float], None]) -> None:
        from cyclonedds.core import GuardCondition

        self.topic, self.damaged, self.guid = topic, 0, reader.guid.bytes
        self._kind, self._received = kind, received
        self._reader: Any = reader
        self._ended = threading.Event()
        self._wake: Any = GuardCondition(reader.participant)
        self._thread = threading.Thread(target=self._read, name=f"DDS reader of {topic}", daemon=True)
        self._thread.start()

    @property
    def writers(self) -> int:
        """How many writers it has now."""
        return len(self.matched)

    @property
    def matched(self) -> frozenset[int]:
        """Numbers of its writers; the same writer has the same number at every reader of this link."""
        reader = self._reader
        return frozenset() if reader is None else frozenset(reader.get_matched_publications())

    @property
    def open(self) -> bool:
        """Whether it is not closed."""
        return not self._ended.is_set()

    def leave(self) -> None:
        """Tell the thread to end."""
        if self._wake is not None:
            self._wake.set(True)
        self._ended.set()

    def close(self) -> None:
        """Stop reading; waits for the thread unless it is the caller's."""
        self.leave()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _read(self) -> None:
        from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
        from cyclonedds.util import duration

        condition = ReadCondition(self._reader, SampleState.Any | ViewState.Any | InstanceState.Any)
        waiting = WaitSet(self._reader.participant)
        waiting.attach(condition)
        waiting.attach(self._wake)
        while not self._ended.is_set():
            with suppress(DDSException):
                waiting.wait(duration(seconds=WAIT))
            while not self._ended.is_set() and (samples := self._taken()):
                when = time.time()
                for sample in samples:
                    self._give(sample, when)
        self._reader = self._wake = None

    def _taken(self) -> list[Any]:
        """The messages that have come; one by one, so that one that cannot be decoded takes no other with it."""
        try:
            return self._reader.take(N=1)
        except Exception as error:
            self._tell(f"a message cannot be decoded ({type(error).__name__}: {error})")
            return []

    def _give(self, sample: Any, when: float) -> None:
        if not sample.sample_info.valid_data:  # a writer has gone
            return
        try:
            message = store().deserialize_cdr(sample.data, self._kind) if isinstance(self._kind, str) else sample
            self._received(message, when)
        except Exception as error:
            self._tell(f"a message cannot be used ({type(error).__name__}: {error})")

    def _tell(self, what: str) -> None:
        self.damaged += 1
        if self.damaged == 1:
            warnings.warn(f"{self.topic}: {what}; it is left out, and others like it", stacklevel=2)


def _settle(domain: int, interface: str | None) -> None:
    """Give the domain its settings; once per process."""
    from cyclonedds.core import DDSException
    from cyclonedds.domain import Domain

    xml = _domain_xml(interface)
    with _TURN:
        if domain in _DOMAINS:
            if _DOMAINS[domain][0] != interface:
                raise DeviceError(
                    f"DDS domain {domain} is already used on {_DOMAINS[domain][0] or 'an automatic interface'} in "
                    f"this process, and {interface or 'an automatic one'} was asked for; take another domain, or one "
                    "process each"
                )
            return
        try:
            _DOMAINS[domain] = interface, Domain(domain, xml)
        except DDSException as error:
            raise DeviceError(
                f"DDS domain {domain} cannot be set up on {interface or 'any interface'} ({error.msg}): another "
                "library of this process may use it. Take another domain, or an interface that is up"
            ) from error


def _qos(reliable: bool, depth: int, transient: bool, user_data: bytes, own: bool = True) -> Any:
    from cyclonedds.core import Policy
    from cyclonedds.qos import Qos
    from cyclonedds.util import duration

    return Qos(
        Policy.Reliability.Reliable(duration(seconds=BLOCKED)) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if transient else Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
        Policy.IgnoreLocal.Nothing if own else Policy.IgnoreLocal.Participant,
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(user_data),
    )
