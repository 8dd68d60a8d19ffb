"""The graph of ROS 2, as far as we need it: topics that are written and read, over DDS here, or through `rclpy`.

Nodes of ROS know each other over DDS by what each participant writes on ``ros_discovery_info``: which nodes it has,
with the ids of their readers and writers. Ours does, so that ``ros2 node list`` and ``ros2 node info`` show it. Since
ROS 2 Iron an id has 16 bytes; before, it had 24, the last 8 of them zero. Since Iron, too, each endpoint tells the hash
of its type (REP-2016) in its user data, so a writer of others that tells one reads the newer form. Newer nodes take the
older form for a participant without nodes, but older ones take the newer form for damage: the older one is written
until a hash is seen.
"""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Protocol, Self

import numpy as np

from eagor.errors import DeviceError, EagorError, FormatError
from eagor.media.bags import listed
from eagor.media.ros_messages import (
    COMPRESSED,
    IMAGE,
    IMU,
    ODOMETRY,
    POSE,
    TRANSFORMS,
    encoded_type,
    hash_of,
    ros_names,
    store,
)
from eagor.robots.dds import Link

__all__ = [
    "DISCOVERY", "DISCOVERY_TYPE", "ENCLAVE", "MOTION", "PICTURES", "TF", "TF_STATIC", "Announcement", "DdsGraph",
    "Graph", "GraphReader", "GraphWriter", "announced", "default_domain", "find_topic", "joined", "pick",
]  # fmt: skip

DISCOVERY, DISCOVERY_TYPE = "ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo"
ENCLAVE = b"enclave=/;"  # of a participant: nodes of ROS take no notice of one that tells none
LOOKED = 0.5  # seconds between two looks at who has come

NAME = "/eagor"

PICTURES = (IMAGE, COMPRESSED)
MOTION = (ODOMETRY, POSE, IMU, TRANSFORMS)  # the best first
TF, TF_STATIC = "/tf", "/tf_static"
FOUND = 5.0  # seconds in which a topic that is written must have been found
LOOK = 0.5  # seconds of each look around
WAITING = 0.1  # seconds after which who waits for a message looks whether to go on


def announced(participant: bytes, node: str, readers: list[bytes], writers: list[bytes], newer: bool) -> bytes:
    """The message, in CDR, that a participant has one `node` ("/robot1/eagor"); ids of DDS have 16 bytes."""
    types, size = store(newer).types, 16 if newer else 24

    def gid(guid: bytes) -> Any:
        return types["rmw_dds_common/msg/Gid"](data=np.frombuffer(guid.ljust(size, b"\0"), dtype=np.uint8))

    space, _, name = node.rpartition("/")
    told = types["rmw_dds_common/msg/NodeEntitiesInfo"](
        node_namespace=space or "/",
        node_name=name,
        reader_gid_seq=[gid(guid) for guid in readers],
        writer_gid_seq=[gid(guid) for guid in writers],
    )
    found = types[DISCOVERY_TYPE](gid=gid(participant), node_entities_info_seq=[told])
    return bytes(store(newer).serialize_cdr(found, DISCOVERY_TYPE))


class Announcement:
    """Tells the others of a `link` that its endpoints are those of one `node`, until it is closed."""

    def __init__(self, link: Link, node: str) -> None:
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication

        self._link, self._node = link, node
        self._turn, self._ended = threading.Lock(), threading.Event()
        self._newer: set[Any] = set()  # writers of others that tell a hash
        self._form: bool | None = None  # whether the newer one is written
        self._writer: Any = None
        self._seen: Any = BuiltinDataReader(link.participant, BuiltinTopicDcpsPublication)
        self.tell()
        self._thread = threading.Thread(target=self._look, name="eagor discovery", daemon=True)
        self._thread.start()

    def tell(self) -> None:
        """Say which endpoints there are now."""
        with self._turn:
            form = bool(self._newer)
            if form != self._form:  # each form is a type of its own
                if self._writer is not None:
                    self._writer.close()
                self._form, self._kind = form, encoded_type(DISCOVERY_TYPE, form)
                self._writer = self._link.publish(
                    DISCOVERY, self._kind, depth=1, transient=True, user_data=hash_of(DISCOVERY_TYPE)
                )
            ends = [part for part in self._link.parts if part is not self._writer]
            readers = [part.guid for part in ends if part.reads]
            writers = [part.guid for part in ends if not part.reads]
            data = announced(self._link.participant.guid.bytes, self._node, readers, writers, form)
            with suppress(DeviceError):  # somebody does not keep up: the newest message is kept for who comes late
                self._writer.write(self._kind(data))

    def close(self) -> None:
        """Say nothing more."""
        self._ended.set()
        self._thread.join()
        self._seen = None

    def _look(self) -> None:
        """Find out what the others read."""
        while not self._ended.wait(LOOKED):
            for sample in self._seen.take(N=100):
                if getattr(sample, "topic_name", None) != DISCOVERY:  # another topic, or a writer that has gone
                    self._newer.discard(getattr(sample, "key", None))
                elif sample.participant_key != self._link.participant.guid and _tells_hash(sample):
                    self._newer.add(sample.key)
            if bool(self._newer) != self._form:
                self.tell()


def _tells_hash(sample: Any) -> bool:
    return any(b"typehash=" in getattr(policy, "data", b"") for policy in sample.qos)


class GraphWriter(Protocol):
    """Writes one topic."""

    def write(self, message: Any) -> None: ...

    def close(self) -> None: ...


class GraphReader(Protocol):
    """Reads one topic, until it is closed. `writers`: how many write it now."""

    @property
    def writers(self) -> int: ...

    def close(self) -> None: ...


class Graph(Protocol):
    """Where topics are. A name that begins with ``~/`` lies in the node's own namespace.

    Messages are `rosbags`' dataclasses, or others with the same fields. `reliable`, `depth` (messages that are kept),
    `transient` (who comes later gets what was said before): the quality of service.
    """

    def publish(
        self, topic: str, kind: str, *, reliable: bool = True, depth: int = 10, transient: bool = False
    ) -> GraphWriter: ...

    def subscribe(
        self,
        topic: str,
        kind: str,
        received: Callable[[Any, float], None],
        *,
        reliable: bool = False,
        depth: int = 10,
        transient: bool = False,
    ) -> GraphReader:
        """Calls ``received(message, when)`` in a thread; `when` is ``time.time()`` at arrival."""
        ...

    def topics(self, wait: float = 1.0) -> dict[str, tuple[str, int]]:
        """Topics that others write, with their types and how many write them, as found within `wait` seconds."""
        ...

    def close(self) -> None: ...


def default_domain() -> int:
    """The domain of the environment (ROS_DOMAIN_ID), else 0. Raises `DeviceError` if it is no number."""
    told = os.environ.get("ROS_DOMAIN_ID", "").strip()
    try:
        return int(told or 0)
    except ValueError:
        raise DeviceError(f"ROS_DOMAIN_ID is {told!r}; wanted a whole number from 0 to 232") from None


class DdsGraph:
    """A `Graph` over a DDS link of its own, without ROS. `domain`: None is that of the environment.

    Nodes of ROS list it by its `name`, with its topics.
    """

    def __init__(self, domain: int | None = None, interface: str | None = None, name: str = NAME) -> None:
        self.name = name
        self.link = Link(default_domain() if domain is None else domain, interface, ENCLAVE)
        self._announcement = Announcement(self.link, name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def publish(
        self, topic: str, kind: str, *, reliable: bool = True, depth: int = 10, transient: bool = False
    ) -> GraphWriter:
        writer = self.link.publish(self._full(topic), kind, reliable=reliable, depth=depth, transient=transient)
        self._announcement.tell()
        return writer

    def subscribe(
        self,
        topic: str,
        kind: str,
        received: Callable[[Any, float], None],
        *,
        reliable: bool = False,
        depth: int = 10,
        transient: bool = False,
    ) -> GraphReader:
        reader = self.link.subscribe(
            self._full(topic), kind, received, reliable=reliable, depth=depth, transient=transient
        )
        self._announcement.tell()
        return reader

    def topics(self, wait: float = 1.0) -> dict[str, tuple[str, int]]:
        names = Counter(ros_names(*each) for each in self.link.publications(wait, own=False))
        return dict(sorted((each[0], (each[1], count)) for each, count in names.items() if each is not None))

    def close(self) -> None:
        self._announcement.close()
        self.link.close()

    def _full(self, topic: str) -> str:
        return f"{self.name}{topic[1:]}" if topic.startswith("~/") else topic


def joined(
    text: str | None, domain: int | None, interface: str | None, graph: Graph | None
) -> tuple[str | None, Graph, DdsGraph | None]:
    """The topic that a text such as ``/image?domain=3&interface=eth0`` names, None for "", and the graph that it is on.

    That is `graph`; without one a graph of its own, which is given last, for whoever has to close it. Raises
    `DeviceError`.
    """
    topic, _, query = (text or "").partition("?")
    settings: dict[str, Any] = {"domain": domain, "interface": interface}
    for pair in filter(None, query.split("&")):
        name, _, value = pair.partition("=")
        if name not in settings or (name == "domain" and not value.isdigit()):
            raise DeviceError(f"ros:{text}: {pair!r}; wanted ros:/topic?domain=N&interface=NAME, both optional")
        settings[name] = int(value) if name == "domain" else value
    own = DdsGraph(**settings) if graph is None else None
    return topic or None, graph or own, own  # type: ignore[return-value]


def pick(
    topics: Mapping[str, str],
    kinds: Sequence[str],
    asked: str | None,
    *,
    where: str,
    option: str,
    error: type[EagorError] = FormatError,
) -> tuple[str, str]:
    """The topic `asked` for, or the only one of the first of `kinds` that there is; with its type.

    Of an Image and a CompressedImage with the same pictures (``name``, ``name/compressed``) the first kind is taken.
    `where` ("the bag x.mcap") and `option` ("--image-topic") are for the text of the error: the topic is not there, has
    another type, or there are several.
    """
    has = f"{where} has {listed(topics)}"
    if asked is not None:
        name = asked if asked.startswith("/") else f"/{asked}"
        if name not in topics:
            raise error(f"{where} has no topic {name}; it has {listed(topics)}")
        if topics[name] not in kinds:
            raise error(f"{name} is of type {topics[name]}; wanted {' or '.join(kinds)}. {has}")
        return name, topics[name]
    fit = [(name, kind) for name, kind in topics.items() if kind in kinds and name != TF_STATIC]
    if not fit:
        raise error(f"{where} has no topic of type {' or '.join(kinds)}; it has {listed(topics)}")
    kind = next(kind for kind in kinds if any(each[1] == kind for each in fit))
    found = [name for name, its in fit if its == kind]
    if set(kinds) == set(PICTURES):
        base = {name.removesuffix("/compressed") for name, _ in fit}
        found = found if len(base) == 1 else sorted(base)
    if len(found) > 1:
        raise error(f"{where} has several topics that fit: {', '.join(found)}; say which one with {option}")
    return found[0], kind


def find_topic(
    graph: Graph,
    kinds: Sequence[str],
    asked: str | None,
    *,
    option: str,
    wait: float = FOUND,
    ended: Callable[[], bool] = lambda: False,
) -> tuple[str, str, int]:
    """As `pick`, on a graph: the topic, its type, and how many write it. Raises `DeviceError`.

    Waits for it, unless `ended` says that nobody wants it any more.
    """
    end = time.monotonic() + wait
    while True:
        found = graph.topics(LOOK)
        try:
            topic, kind = pick(
                {name: kind for name, (kind, _) in found.items()},
                kinds, asked, where="the ROS 2 graph", option=option, error=DeviceError,
            )  # fmt: skip
            return topic, kind, found[topic][1]
        except DeviceError as error:
            if time.monotonic() >= end or ended():
                more = "" if found else ": is the domain (ROS_DOMAIN_ID), or the network interface, another one?"
                raise DeviceError(f"{error}{more}") from None
