"""A graph of ROS 2 in this process: what a node writes is kept, what it reads is fed to it."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

from eagor.media import ros_messages as m


class FakeGraph:
    """Keeps `sent` (topic, message); `feed` hands a message to who reads its topic, now or (`latched`) later."""

    def __init__(self, topics):
        self.found = {topic: (kind, 1) for topic, kind in topics.items()}
        self.sent, self.latched = [], {}
        self.news = threading.Condition()
        self._readers = {}

    def publish(self, topic, kind, **_):
        return SimpleNamespace(write=lambda message: self._keep(topic, message), close=lambda: None)

    def _keep(self, topic, message):
        with self.news:
            self.sent.append((topic, message))
            self.news.notify_all()

    def subscribe(self, topic, kind, received, **_):
        self._readers[topic] = received
        if topic in self.latched:
            received(self.latched[topic], time.time())
        return SimpleNamespace(writers=1, close=lambda: self._readers.pop(topic, None))

    def feed(self, topic, message):
        if topic in self._readers:
            self._readers[topic](message, time.time())

    def topics(self, wait=1.0):
        time.sleep(min(wait, 0.02))
        return dict(self.found)

    def close(self):
        """Nothing is held."""

    def of(self, topic):
        """What was sent on a topic so far."""
        with self.news:
            return [message for name, message in self.sent if name == topic]

    def until(self, what, why, seconds=60.0):
        """Wait until ``what()`` is true."""
        with self.news:
            assert self.news.wait_for(what, seconds), why


def clock_message(stamp):
    return m.message(m.CLOCK, clock=m.time_message(stamp))
