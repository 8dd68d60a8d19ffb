"""How nodes of ROS 2 know each other over DDS, so that ``ros2 node list`` and ``ros2 node info`` show ours.

Each participant writes on ``ros_discovery_info`` which nodes it has, with the ids of their readers and writers. Since
ROS 2 Iron an id has 16 bytes; before, it had 24, the last 8 of them zero. Since Iron, too, each endpoint tells the hash
of its type (REP-2016) in its user data, so a writer of others that tells one reads the newer form. Newer nodes take the
older form for a participant without nodes, but older ones take the newer form for damage: the older one is written
until a hash is seen.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import Any

import numpy as np

from eagor.errors import DeviceError
from eagor.media.bags.ros_types import encoded_type, hash_of, store
from eagor.robots.dds.link import Link

__all__ = ["ENCLAVE", "INFO", "TOPIC", "Announcement", "announced"]

TOPIC, INFO = "ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo"
ENCLAVE = b"enclave=/;"  # of a participant: nodes of ROS take no notice of one that tells none
LOOKED = 0.5  # seconds between two looks at who has come


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
    found = types[INFO](gid=gid(participant), node_entities_info_seq=[told])
    return bytes(store(newer).serialize_cdr(found, INFO))


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
                self._form, self._kind = form, encoded_type(INFO, form)
                self._writer = self._link.publish(TOPIC, self._kind, depth=1, transient=True, user_data=hash_of(INFO))
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
                if getattr(sample, "topic_name", None) != TOPIC:  # another topic, or a writer that has gone
                    self._newer.discard(getattr(sample, "key", None))
                elif sample.participant_key != self._link.participant.guid and _tells_hash(sample):
                    self._newer.add(sample.key)
            if bool(self._newer) != self._form:
                self.tell()


def _tells_hash(sample: Any) -> bool:
    return any(b"typehash=" in getattr(policy, "data", b"") for policy in sample.qos)
