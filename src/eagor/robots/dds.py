"""DDS, the transport of Unitree's robots: topics are written and read without ROS or an SDK being installed.

A `Participant` is a process's place on a domain: it writes topics, and reads them in threads of its own.
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
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from eagor._checks import whole
from eagor._extras import need
from eagor.errors import DeviceError

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Participant", "Raw", "Reader", "Writer", "default_domain", "free_domain", "raw"]

LAST_DOMAIN = 232  # above, the ports that the standard derives from the number do not exist (DDSI-RTPS 9.6.1.1)
FIRST_PORT, PORTS = 7400, 250  # of domain 0, and per domain (DDSI-RTPS 9.6.1.1)
LOOKED_AT = 8  # participants of a domain whose ports tell whether it is in use
FREE = range(1, 120)  # above, ports meet those that the system gives away

# Each of up to 64 processes of a domain on this machine has ports of its own; Cyclone 0.10, which robots run, finds a
# newer one on the same machine only by such an index (measured).
_SETTINGS = """<CycloneDDS><Domain Id="any">
<General><Interfaces><NetworkInterface {}/></Interfaces>{}</General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>64</MaxAutoParticipantIndex>{}
</Discovery></Domain></CycloneDDS>"""
# The loopback interface has no multicast: processes ask each other's ports one by one.
_LOCAL = (
    'name="lo" multicast="false"', "<AllowMulticast>false</AllowMulticast>",
    '<Peers><Peer address="127.0.0.1"/></Peers>',
)  # fmt: skip

DEPTH = 10  # messages that are kept for a reader that is late
BLOCKED = 0.1  # seconds that a reliable writer waits for a reader that does not keep up
WAIT = 0.2  # seconds after which a reader's thread looks whether it is to end
_DOMAINS: dict[int, tuple[str | None, Any]] = {}  # cyclonedds settles a domain once per process
_TURN = threading.Lock()


def default_domain() -> int:
    """The domain of the environment (ROS_DOMAIN_ID), else 0. Raises `DeviceError` if it is no number."""
    value = os.environ.get("ROS_DOMAIN_ID", "").strip()
    try:
        return int(value or 0)
    except ValueError:
        raise DeviceError(f"ROS_DOMAIN_ID is {value!r}; wanted a whole number from 0 to {LAST_DOMAIN}") from None


def free_domain() -> int:
    """A DDS domain on which nobody of this machine listens, chosen at random: others may look for one right now.

    Raises `DeviceError` if there is none.
    """
    for domain in random.SystemRandom().sample(FREE, len(FREE)):
        with suppress(OSError):
            for index in range(LOOKED_AT):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.bind(("127.0.0.1", FIRST_PORT + PORTS * domain + 10 + 2 * index))
            return domain
    raise DeviceError("every DDS domain of this machine is in use: end some programs that use DDS")


@dataclass(eq=False)
class Raw:
    """A message as the bytes that are sent; stands in for cyclonedds' own encoding, which takes 50 times as long."""

    data: bytes

    def serialize(self, **_: Any) -> bytes:
        return self.data

    @classmethod
    def deserialize(cls, data: bytes, *_: Any, **__: Any) -> Raw:
        return cls(bytes(data))

    deserialize_key = deserialize


@cache
def raw(kind: type) -> type[Raw]:
    """A class for `Participant` whose messages are bytes, announced as the type `kind` of cyclonedds' IDL."""
    about = {"__idl__": kind.__idl__, "__idl_typename__": kind.__idl_typename__}  # type: ignore[attr-defined]
    return type(kind.__name__, (Raw,), about)


class Participant:
    """A participant of DDS domain `domain` on a network interface; a context manager.

    `interface`: such as "eth0"; "lo" stays on this machine; None lets the library choose. A process has one interface
    per domain. Raises `MissingExtraError`, and `DeviceError` for a domain or interface that cannot be had.
    """

    def __init__(self, domain: int = 0, interface: str | None = None) -> None:
        need("DDS (Unitree)", "robot", "cyclonedds", "rosbags")
        from cyclonedds.core import DDSException
        from cyclonedds.domain import Domain, DomainParticipant

        if not whole(domain, 0, LAST_DOMAIN):
            raise DeviceError(f"DDS domain {domain!r}; wanted a whole number from 0 to {LAST_DOMAIN} (ROS_DOMAIN_ID)")
        known = [name for _, name in socket.if_nameindex()]
        if interface is not None and interface not in known:
            raise DeviceError(f"there is no network interface {interface!r}; this machine has {', '.join(known)}")
        which = 'autodetermine="true"' if interface is None else f'name="{interface}"'
        settings = _LOCAL if interface == "lo" else (f'{which} multicast="default"', "", "")
        self.domain, self.interface = int(domain), interface
        self._parts: list[Reader | Writer] = []
        try:
            with _TURN:
                if self.domain not in _DOMAINS:
                    _DOMAINS[self.domain] = interface, Domain(self.domain, _SETTINGS.format(*settings))
            self._participant: Any = DomainParticipant(self.domain)
        except DDSException as error:
            raise DeviceError(
                f"DDS domain {domain} cannot be joined on {interface or 'any interface'} ({error.msg}): too many "
                "processes, or another library of this one, may use it. End some, or take another domain"
            ) from error
        if (before := _DOMAINS[self.domain][0]) != interface:
            raise DeviceError(
                f"DDS domain {domain} is already used on {before or 'an automatic interface'} in this process, and "
                f"{interface or 'an automatic one'} was asked for; take another domain, or one process each"
            )

    def __str__(self) -> str:
        return f"domain {self.domain}, {self.interface or 'automatic interface'}"

    def __enter__(self) -> Self:
        return self

    def close(self, *_: object) -> None:
        """End all readers and writers. May be called twice."""
        while self._parts:
            self._parts.pop().close()
        self._participant = None  # cyclonedds lets go of it when nothing refers to it

    __exit__ = close

    def publish(self, topic: str, kind: type, *, reliable: bool = True) -> Writer:
        """A writer of `topic`; `kind`: a class of cyclonedds' IDL, or `raw` of one.

        ROS 2 knows a topic ``rt/name`` of a type ``package::msg::dds_::Type_`` as ``/name`` of ``package/msg/Type``.
        """
        from cyclonedds.pub import DataWriter

        self._parts.append(writer := Writer(topic, DataWriter(*self._topic(topic, kind), _qos(reliable))))
        return writer

    def subscribe(
        self, topic: str, kind: type, received: Callable[[Any, float], None], *, reliable: bool = False,
        own: bool = True,
    ) -> Reader:  # fmt: skip
        """Call ``received(message, when)`` for every message, in a thread; `when` is ``time.time()`` at arrival.

        A best-effort reader (default) takes from every writer, a reliable one from reliable ones. `own`: also what this
        link itself writes.
        """
        from cyclonedds.sub import DataReader

        reader = Reader(topic, DataReader(*self._topic(topic, kind), _qos(reliable, own)), received)
        self._parts.append(reader)
        return reader

    def topics(self, wait: float = 1.0) -> dict[str, str]:
        """Topics that are written on this domain, with their types' DDS names, as found within `wait` seconds."""
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication

        reader = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        time.sleep(wait)
        found: dict[str, str] = {}
        while samples := reader.take(N=100):  # one without a name: a writer that has gone
            found |= {each.topic_name: each.type_name for each in samples if hasattr(each, "topic_name")}
        return dict(sorted(found.items()))

    def _topic(self, topic: str, kind: type) -> tuple[Any, Any]:
        from cyclonedds.topic import Topic

        if self._participant is None:
            raise DeviceError("this link is closed; make another one")
        return self._participant, Topic(self._participant, topic, kind)


class Writer:
    """Writes messages of one topic (`Participant.publish`)."""

    def __init__(self, topic: str, writer: Any) -> None:
        self.topic, self._writer = topic, writer

    @property
    def readers(self) -> int:
        writer = self._writer
        return 0 if writer is None else len(writer.get_matched_subscriptions())

    def write(self, message: Any) -> None:
        """Send `message`. Raises `DeviceError` if the network does not take it, or the link is closed."""
        from cyclonedds.core import DDSException

        if (writer := self._writer) is None:
            raise DeviceError(f"a message of {self.topic} cannot be sent: its link is closed")
        try:
            writer.write(message)
        except DDSException as error:
            raise DeviceError(f"a message of {self.topic} could not be sent: {error.msg}") from error

    def close(self) -> None:
        self._writer = None


class Reader:
    """Reads one topic in a thread (`Participant.subscribe`).

    An exception of who receives, or a message that cannot be decoded, is told once as a `UserWarning`; `problem`: the
    last, in words.
    """

    def __init__(self, topic: str, reader: Any, received: Callable[[Any, float], None]) -> None:
        from cyclonedds.core import GuardCondition

        self.topic, self.problem, self._received = topic, "", received
        self._reader: Any = reader
        self._wake: Any = GuardCondition(reader.participant)
        self._thread = threading.Thread(target=self._read, name=f"DDS reader of {topic}", daemon=True)
        self._thread.start()

    @property
    def matched(self) -> frozenset[int]:
        """Numbers of its writers; the same writer has the same number at every reader of this link."""
        reader = self._reader
        return frozenset() if reader is None else frozenset(reader.get_matched_publications())

    def close(self) -> None:
        """Stop reading, and wait for the thread. May be called twice."""
        if (wake := self._wake) is not None:
            wake.set(True)
        self._thread.join()

    def _read(self) -> None:
        from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
        from cyclonedds.util import duration

        reader, wake = self._reader, self._wake
        condition = ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any)
        waiting = WaitSet(reader.participant)
        waiting.attach(condition)
        waiting.attach(wake)
        while not wake.read():
            with suppress(DDSException):
                waiting.wait(duration(seconds=WAIT))
            try:  # one by one, so that a damaged one takes no other with it
                while not wake.read() and (samples := reader.take(N=1)):
                    if samples[0].sample_info.valid_data:  # else a writer has gone
                        self._received(samples[0], time.time())
            except Exception as error:
                if not self.problem:
                    text = f"a message cannot be used ({type(error).__name__}: {error})"
                    warnings.warn(f"{self.topic}: {text}; it is left out, and others like it", stacklevel=2)
                self.problem = str(error) or type(error).__name__
        self._reader = self._wake = None


def _qos(reliable: bool, own: bool = True) -> Any:
    from cyclonedds.core import Policy
    from cyclonedds.qos import Qos
    from cyclonedds.util import duration

    return Qos(
        Policy.Reliability.Reliable(duration(seconds=BLOCKED)) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.Volatile,
        Policy.History.KeepLast(DEPTH),
        Policy.IgnoreLocal.Nothing if own else Policy.IgnoreLocal.Participant,
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
