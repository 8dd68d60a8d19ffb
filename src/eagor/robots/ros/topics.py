"""Which topic is meant: the one that was named, or the only one of its kind."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

from eagor.errors import DeviceError, EagorError, FormatError
from eagor.media.bags.messages import COMPRESSED, IMAGE, IMU, ODOMETRY, POSE, TRANSFORMS
from eagor.media.bags.reader import listed
from eagor.robots.ros.graph import Graph

__all__ = ["MOTION", "PICTURES", "TF", "TF_STATIC", "find_topic", "pick"]

PICTURES = (IMAGE, COMPRESSED)
MOTION = (ODOMETRY, POSE, IMU, TRANSFORMS)  # the best first
TF, TF_STATIC = "/tf", "/tf_static"
FOUND = 5.0  # seconds in which a topic that is written must have been found
LOOK = 0.5  # seconds of each look around


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
