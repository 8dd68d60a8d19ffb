"""ROS 2 messages over DDS without ROS: types from `rosbags`' definitions, bytes from its serialiser.

A ROS 2 topic ``/name`` of type ``package/msg/Type`` is the DDS topic ``rt/name`` of type ``package::msg::dds_::Type_``.

Octets are declared as ``byte``, never as ``uint8`` or ``int8``: these are the same on the wire, but the type
information of the latter two, as cyclonedds 11 sends it, ends every process with Cyclone 0.10 that meets it (measured).
"""

from __future__ import annotations

import threading
from functools import cache
from typing import Any

from eagor.errors import FormatError

__all__ = ["Encoded", "encoded_type", "hash_of", "ros_names", "store", "topic_name"]

_BASES = {
    "bool": bool,
    "string": str,
    "float32": "float32", "float64": "float64",
    "int16": "int16", "int32": "int32", "int64": "int64",
    "uint16": "uint16", "uint32": "uint32", "uint64": "uint64",
    "uint8": "byte", "int8": "byte", "byte": "byte", "char": "byte", "octet": "byte",
}  # fmt: skip
_NO_MEMBER = "structure_needs_at_least_one_member"  # as ROS 2 names it in an empty message
_TURN = threading.RLock()


class Encoded:
    """A message as the bytes that are sent; stands in for cyclonedds' own encoding, which takes 50 times as long."""

    __slots__ = ("data", "sample_info")

    def __init__(self, data: bytes) -> None:
        self.data = data

    def serialize(self, **_: Any) -> bytes:
        return self.data

    @classmethod
    def deserialize(cls, data: bytes, *_: Any, **__: Any) -> Encoded:
        return cls(bytes(data))

    deserialize_key = deserialize


@cache
def store(newer: bool = False) -> Any:
    """`rosbags`' types of ROS 2 Humble, which later releases share; `newer`: of Jazzy, for the few that differ."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY if newer else Stores.ROS2_HUMBLE)


def hash_of(name: str) -> bytes:
    """What an endpoint of this ROS type says in its user data, so that nodes since Iron know the type (REP-2016)."""
    return f"typehash={store(newer=True).hash_rihs01(name)};".encode()


def topic_name(ros_name: str) -> str:
    """The DDS topic of a ROS 2 topic: "/odom" or "odom" is "rt/odom"; a name that begins with "rt/" stays."""
    return ros_name if ros_name.startswith("rt/") else "rt/" + ros_name.strip("/")


def ros_names(topic: str, kind: str) -> tuple[str, str] | None:
    """The ROS 2 names of a DDS topic and its type, or None if they are none of ROS: the way back of `topic_name`."""
    package, _, rest = kind.partition("::msg::dds_::")
    if not topic.startswith("rt/") or not rest.endswith("_"):
        return None
    return topic[2:], f"{package}/msg/{rest[:-1]}"


def encoded_type(name: str, newer: bool = False) -> type[Encoded]:
    """The class to give to cyclonedds for the ROS type `name`, such as "sensor_msgs/msg/Imu" (`newer`: as `store`).

    Raises `FormatError` for a type that is not known.
    """
    with _TURN:
        return _encoded_type(name, newer)


@cache
def _encoded_type(name: str, newer: bool) -> type[Encoded]:
    struct = _struct(name, newer)
    return type(struct.__name__, (Encoded,), {"__idl__": struct.__idl__, "__idl_typename__": struct.__idl_typename__})


@cache
def _struct(name: str, newer: bool = False) -> Any:
    """cyclonedds' class for a ROS type and all that it holds."""
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.idl.annotations import final
    from cyclonedds.idl.types import byte

    if name not in store(newer).fielddefs:
        raise FormatError(f"{name!r} is no known ROS 2 type; wanted one such as sensor_msgs/msg/Imu")
    _, members = store(newer).fielddefs[name]
    package, kind = name.split("/")[0], name.split("/")[-1]
    fields = {field: _field(about, newer) for field, about in members} or {_NO_MEMBER: byte}
    return final(make_idl_struct(f"{kind}_", f"{package}.msg.dds_.{kind}_", fields))


def _field(about: tuple[Any, Any], newer: bool) -> Any:
    """cyclonedds' type of a member."""
    from cyclonedds.idl import types
    from rosbags.interfaces import Nodetype

    node, value = about
    if node == Nodetype.NAME:
        return _struct(value, newer)
    if node == Nodetype.BASE:
        kind, limit = value
        if kind == "string" and limit:
            return types.bounded_str[limit]
        try:
            found = _BASES[kind]
        except KeyError:
            raise FormatError(f"members of type {kind} cannot be sent") from None
        return getattr(types, found) if isinstance(found, str) else found
    inner, size = value
    if node == Nodetype.ARRAY:
        return types.array[_field(inner, newer), size]
    return types.sequence[_field(inner, newer), size] if size else types.sequence[_field(inner, newer)]
