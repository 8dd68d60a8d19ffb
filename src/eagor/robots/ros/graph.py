"""The graph of ROS 2, as far as we need it: topics that are written and read. Over DDS here, or through `rclpy`."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from typing import Any, Protocol, Self

from eagor.errors import DeviceError
from eagor.media.bags.ros_types import ros_names
from eagor.robots.dds import Link
from eagor.robots.dds.discovery import ENCLAVE, Announcement

__all__ = ["DdsGraph", "Graph", "GraphReader", "GraphWriter", "default_domain"]

NAME = "/eagor"


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
