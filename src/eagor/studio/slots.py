"""What waits to be sent to one page: words in order, and of the steps only the newest."""

from __future__ import annotations

import asyncio
from collections import deque

from eagor.studio.wire import Message, merged

__all__ = ["Slot"]

WAITING = 32  # scenes, problems and words; older ones are dropped


class Slot:
    """Filled and emptied in the loop's thread. However slow its page is, it never grows."""

    def __init__(self) -> None:
        self._said: deque[Message] = deque(maxlen=WAITING)
        self._step: Message | None = None
        self._news = asyncio.Event()

    def put(self, message: Message) -> None:
        """A step replaces the one before it (`merged`); a new scene drops the steps of the old one."""
        if message.header["type"] == "step":
            self._step = merged(self._step, message)
        else:
            if message.header["type"] == "scene":
                self._step = None
            self._said.append(message)
        self._news.set()

    def clear(self) -> None:
        """Forget all: another view is opened."""
        self._said.clear()
        self._step = None
        self._news.clear()

    async def get(self) -> Message:
        """The next message, once there is one: words before steps."""
        while not self._said and self._step is None:  # cleared, perhaps, since it was woken
            await self._news.wait()
        if self._said:
            message = self._said.popleft()
        else:
            assert self._step is not None
            message, self._step = self._step, None
        if not self._said and self._step is None:
            self._news.clear()
        return message
