"""A process that works for the server: what it says comes by a thread of its own, what it is told goes by another."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from queue import SimpleQueue
from typing import Any

from eagor._processes import starting

__all__ = ["Backend", "run"]

ENDING = 2.0  # seconds for the process to leave by itself
PAUSE = 0.3  # seconds before one that has died is started anew


def run(name: str, line: Any, *arguments: Any) -> None:
    """Call ``package.module:function`` with the line and arguments: the first thing that a new process does.

    What the function needs is imported in that process alone.
    """
    module, _, function = name.partition(":")
    getattr(import_module(module), function)(line, *arguments)


class Backend:
    """Runs a function ``(line, *arguments)`` in a process of its own, and starts it anew if it dies.

    `serve`: its name, ``package.module:function``.

    `heard` is called with everything that it says, `died` after it has died, both in another thread. Telling never
    waits. A process that dies three times without having said anything is not started any more.
    """

    def __init__(
        self, serve: str, arguments: tuple[Any, ...], heard: Callable[[Any], None],
        died: Callable[[], None],
    ) -> None:  # fmt: skip
        self._serve, self._arguments, self._heard, self._died = serve, arguments, heard, died
        self._orders: SimpleQueue[Any] = SimpleQueue()
        self._closed, self._turn = threading.Event(), threading.Lock()
        self._process: Any = None
        self._line: Any = None
        self._start()
        threading.Thread(target=self._listen, name="eagor studio hears", daemon=True).start()
        threading.Thread(target=self._speak, name="eagor studio tells", daemon=True).start()

    def tell(self, order: Any) -> None:
        """Tell it something, soon."""
        self._orders.put(order)

    @property
    def pid(self) -> int | None:
        """Of the process that is running now."""
        return self._process.pid

    def close(self) -> None:
        """End the process."""
        with self._turn:
            self._closed.set()
        self._orders.put(None)
        with suppress(OSError):
            self._line.close()
        self._process.join(ENDING)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        with self._turn:
            if self._closed.is_set():
                return
            self._line, there = context.Pipe()
            self._process = context.Process(target=run, args=(self._serve, there, *self._arguments))
            with starting():
                self._process.start()
            there.close()

    def _listen(self) -> None:
        silent = 0
        while not self._closed.is_set():
            try:
                said = self._line.recv()
            except (EOFError, OSError, TypeError):
                if self._closed.wait(PAUSE):  # whoever ends us may have ended it first
                    return
                silent += 1
                self._process.join(ENDING)
                if self._process.is_alive():
                    self._process.kill()
                self._died()
                if silent == 3:
                    return
                self._start()
                continue
            silent = 0
            self._heard(said)

    def _speak(self) -> None:
        while (order := self._orders.get()) is not None:
            with suppress(OSError, ValueError):
                self._line.send(order)
