"""What the node sends: the newest answers, in a thread of its own, so that a reader that hangs holds up no answer."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from eagor.errors import EagorError
from eagor.live.events import Answer
from eagor.media.bags.messages import IMAGE, POSE, VECTOR
from eagor.robots.node import answers as made
from eagor.robots.ros.graph import Graph, GraphWriter

__all__ = ["Outbox"]

DIAGNOSED = 1.0  # seconds between two diagnostics
PARTS = ("camera", "poses", "perception", "clock", "recording")


@dataclass(frozen=True, eq=False)
class _Item:
    answer: Answer
    given: float
    number: int
    count: int
    body_R_camera: np.ndarray
    camera: str
    told: Mapping[str, str]


class Outbox:
    """Publishes answers on a `graph`, as `settings` (`NodeSettings`) say; a context manager.

    ``~/direction``, ``~/direction_pose``, ``~/belief_image`` and ``~/belief`` are of the first query; every further one
    has ``~/NAME/direction`` and ``~/NAME/direction_pose``. ``~/markers`` and ``/diagnostics`` are of all. `now`: the
    time of the node, for what rests on no picture. `failed`: how many messages could not be sent.
    """

    def __init__(self, graph: Graph, settings: Any, now: Callable[[], float]) -> None:
        self.failed = 0
        self._graph, self._settings, self._now = graph, settings, now
        self._writers: dict[str, GraphWriter] = {}
        self._news = threading.Condition()
        self._items: dict[str, _Item] = {}
        self._words: list[Any] = []
        self._shown: set[str] = set()
        self._newest: dict[str, _Item] = {}
        self._diagnosed = self._believed = 0.0
        self._closed = False
        for topic in ("~/direction", "~/direction_pose", "~/markers", "~/belief_image", "~/belief"):
            self._writer(topic)
        self._thread = threading.Thread(target=self._serve, name="eagor outbox", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def put(
        self,
        answer: Answer,
        given: float,
        number: int,
        count: int,
        body_R_camera: np.ndarray,
        camera: str,
        told: Mapping[str, str],
    ) -> None:
        """Send the `answer`, `given` then, to the query of this `number` of `count`; it replaces one that waits."""
        with self._news:
            self._items[answer.query] = _Item(answer, given, number, count, body_R_camera, camera, told)
            self._news.notify()

    def say(self, diagnostic: Any) -> None:
        """Send a DiagnosticArray, beside those of the answers."""
        with self._news:
            self._words.append(diagnostic)
            self._news.notify()

    def close(self) -> None:
        """Say the words that wait, take the markers away, and end; answers are of no use any more."""
        with self._news:
            self._closed = True
            self._news.notify()
        self._thread.join()
        for writer in self._writers.values():
            writer.close()

    def _serve(self) -> None:
        while True:
            with self._news:
                while not (self._items or self._words or self._closed):
                    self._news.wait()
                items, self._items = self._items, {}
                words, self._words = self._words, []
                closed = self._closed
                if closed:
                    items = {}
            for diagnostic in words:
                self._send("/diagnostics", diagnostic)
            for item in items.values():
                self._publish(item)
            if items:
                self._tidy(items)
                self._diagnose(items)
            if closed:
                for query in self._shown:
                    self._send("~/markers", made.gone(query, self._now(), self._settings.body))
                return

    def _publish(self, item: _Item) -> None:
        answer, turn, body = item.answer, item.body_R_camera, self._settings.body
        space = "~" if item.number == 0 else f"~/{made.topic_of(answer.query)}"
        if (direction := made.direction_message(answer, turn, body)) is not None:
            self._send(f"{space}/direction", direction)
            self._send(f"{space}/direction_pose", made.direction_pose(answer, turn, body))
        self._send("~/markers", made.markers(answer, turn, body, item.number))
        self._shown.add(answer.query)
        rate = self._settings.belief_rate
        due = rate > 0 and _over(item.given - self._believed, 1 / rate)
        if item.number == 0 and due and answer.direction is not None:
            self._believed = item.given
            self._send(
                "~/belief_image", made.belief_image(answer, item.camera, encoding=self._settings.belief_encoding)
            )
            self._send("~/belief", made.belief_coefficients(answer))

    def _tidy(self, items: Mapping[str, _Item]) -> None:
        """Take away the markers of what is no longer followed."""
        self._newest |= items
        newest = max(items.values(), key=lambda item: item.given)
        now = sorted(self._newest.values(), key=lambda item: -item.given)[: newest.count]
        self._newest = {item.answer.query: item for item in now}
        for query in self._shown - self._newest.keys():
            self._send("~/markers", made.gone(query, newest.answer.stamp, self._settings.body))
            self._shown = self._shown - {query}

    def _diagnose(self, items: Mapping[str, _Item]) -> None:
        now = max(item.given for item in items.values())
        if not _over(now - self._diagnosed, DIAGNOSED):
            return
        self._diagnosed = now
        order = sorted(self._newest.values(), key=lambda item: item.number)
        told = {**order[0].told, "not_sent": str(self.failed)}
        found = made.diagnostics(self._now(), [item.answer for item in order], order[0].body_R_camera, PARTS, told)
        self._send("/diagnostics", found)

    def _send(self, topic: str, message: Any) -> None:
        try:
            self._writer(topic).write(message)
        except EagorError:  # a reader that does not keep up
            self.failed += 1

    def _writer(self, topic: str) -> GraphWriter:
        if topic not in self._writers:
            kinds = {
                "direction": VECTOR, "direction_pose": POSE, "markers": made.MARKERS, "belief_image": IMAGE,
                "belief": made.NUMBERS, "diagnostics": made.DIAGNOSTICS,
            }  # fmt: skip
            self._writers[topic] = self._graph.publish(topic, kinds[topic.rpartition("/")[2]], reliable=True, depth=10)
        return self._writers[topic]


def _over(gone: float, seconds: float) -> bool:
    """Whether so many seconds have gone; also where the clock has been set back."""
    return not 0 <= gone < seconds
