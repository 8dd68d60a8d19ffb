"""The graph that the node of eagor speaks to, through rclpy: topics, and messages of both kinds."""

from __future__ import annotations

import time
from array import array
from typing import Any

import numpy as np


def as_ros(message: Any) -> Any:
    """The rclpy message that says the same as a message of `rosbags`."""
    from rosidl_runtime_py.utilities import get_message

    kind = get_message(message.__msgtype__)
    types = kind.get_fields_and_field_types()
    return kind(**{name: _value(getattr(message, name), about) for name, about in types.items()})


def _value(value: Any, kind: str) -> Any:
    if hasattr(value, "__msgtype__"):
        return as_ros(value)
    if kind == "octet":  # a byte of its own is bytes in Python
        return bytes([value])
    if isinstance(value, np.ndarray):
        if "[" in kind:  # of fixed length
            return value
        return array({"u1": "B", "f4": "f", "f8": "d", "i4": "i"}[value.dtype.str[1:]], value.tobytes())
    if isinstance(value, list):
        return [_value(each, "") for each in value]
    return value


class RclpyGraph:
    """An `eagor.robots.ros.graph.Graph` of an rclpy node, which somebody else spins."""

    def __init__(self, node: Any) -> None:
        self.node = node

    def publish(
        self, topic: str, kind: str, *, reliable: bool = True, depth: int = 10, transient: bool = False
    ) -> _Writer:
        """As `Graph.publish`."""
        from rosidl_runtime_py.utilities import get_message

        return _Writer(
            self.node, self.node.create_publisher(get_message(kind), topic, _qos(reliable, depth, transient))
        )

    def subscribe(
        self,
        topic: str,
        kind: str,
        received: Any,
        *,
        reliable: bool = False,
        depth: int = 10,
        transient: bool = False,
    ) -> _Reader:
        """As `Graph.subscribe`."""
        from rosidl_runtime_py.utilities import get_message

        reader = self.node.create_subscription(
            get_message(kind), topic, lambda message: received(message, time.time()), _qos(reliable, depth, transient)
        )
        return _Reader(self.node, reader)

    def topics(self, wait: float = 1.0) -> dict[str, tuple[str, int]]:
        """As `Graph.topics`."""
        time.sleep(wait)
        own = {
            name
            for name, _ in self.node.get_publisher_names_and_types_by_node(
                self.node.get_name(), self.node.get_namespace()
            )
        }
        found = {}
        for name, kinds in sorted(self.node.get_topic_names_and_types()):
            writers = self.node.count_publishers(name)
            if writers > (name in own):
                found[name] = kinds[0], writers - (name in own)
        return found

    def close(self) -> None:
        """The node is ended by who made it."""


class _Writer:
    def __init__(self, node: Any, publisher: Any) -> None:
        self._node, self._publisher = node, publisher

    def write(self, message: Any) -> None:
        self._publisher.publish(as_ros(message))

    def close(self) -> None:
        self._node.destroy_publisher(self._publisher)


class _Reader:
    def __init__(self, node: Any, subscription: Any) -> None:
        self._node, self._subscription = node, subscription

    @property
    def writers(self) -> int:
        return self._node.count_publishers(self._subscription.topic_name)

    def close(self) -> None:
        self._node.destroy_subscription(self._subscription)


def _qos(reliable: bool, depth: int, transient: bool) -> Any:
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if transient else DurabilityPolicy.VOLATILE,
    )
