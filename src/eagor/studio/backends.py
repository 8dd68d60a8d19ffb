"""A process that works for the server: what it says comes by a thread of its own, what it is told goes by another."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from typing import Any

from eagor._processes import Worker, WorkerEnded
from eagor.errors import EagorError

__all__ = ["Backend"]

ENDING = 2.0  # seconds for the process to leave by itself
PAUSE = 0.3  # seconds before one that has died is started anew


class Backend:
    """Runs a function ``(line, *arguments)`` in a process of its own, and starts it anew if it dies.

    `serve`: its name, ``package.module:function``.

    `heard` is called with everything that it says, `died` after it has died, both by the event loop that runs where the
    backend is made. Telling never waits. A process that dies three times without having said anything is not started
    any more.
    """

    def __init__(
        self, serve: str, arguments: tuple[Any, ...], heard: Callable[[Any], None],
        died: Callable[[], None],
    ) -> None:  # fmt: skip
        self._serve, self._arguments, self._heard, self._died = serve, arguments, heard, died
        self._orders: SimpleQueue[Any] = SimpleQueue()
        self._closed, self._turn = threading.Event(), threading.Lock()
        self._loop = asyncio.get_running_loop()
        self._start()
        threading.Thread(target=self._listen, name="eagor studio hears", daemon=True).start()
        threading.Thread(target=self._speak, name="eagor studio tells", daemon=True).start()

    def tell(self, order: Any) -> None:
        """Tell it something, soon."""
        self._orders.put(order)

    @property
    def pid(self) -> int | None:
        """Of the process that is running now."""
        return self._worker.process.pid

    def close(self) -> None:
        """End the process."""
        with self._turn:
            self._closed.set()
        self._orders.put(None)
        self._worker.close(ENDING)

    def _start(self) -> None:
        with self._turn:
            if not self._closed.is_set():
                self._worker = Worker(self._serve, *self._arguments, parent=True)

    def _listen(self) -> None:
        silent = 0
        while not self._closed.is_set():
            try:
                said = self._worker.receive()
            except (WorkerEnded, EagorError):
                if self._closed.wait(PAUSE):  # whoever ends us may have ended it first
                    return
                silent += 1
                self._worker.close(ENDING)
                self._soon(self._died)
                if silent == 3:
                    return
                self._start()
                continue
            silent = 0
            self._soon(self._heard, said)

    def _soon(self, call: Callable[..., None], *arguments: Any) -> None:
        with suppress(RuntimeError):  # the loop is closed: the server ends
            self._loop.call_soon_threadsafe(call, *arguments)

    def _speak(self) -> None:
        while (order := self._orders.get()) is not None:
            with suppress(WorkerEnded):
                self._worker.send(order)
