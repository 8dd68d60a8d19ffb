"""Units whose work is waiting for servers: many at once in one process.

Not concurrent.futures: the end of the process would wait for a pool's threads. All share what `work` set up, which has
to be safe for several threads.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from queue import SimpleQueue
from typing import Any

from eagor.evaluation.ledger import Ledger
from eagor.evaluation.units import Book, Unit, attempt_unit, load


def work_in_threads(book: Book, work: str, config: dict[str, Any], count: int) -> None:
    """All units of `book`, at most `count` at once. Raises as `eagor.evaluation.workers.run_units` does.

    On an error that ends the run, and on Ctrl-C, nothing more is begun, and what is under way is not waited for.
    """
    do = load(work, config)
    kept = _Shared(book.ledger)
    orders: SimpleQueue[tuple[Unit, int] | None] = SimpleQueue()
    news: SimpleQueue[tuple[Unit, dict[str, Any] | BaseException]] = SimpleQueue()

    def serve() -> None:
        while (order := orders.get()) is not None:
            unit, attempt = order
            try:
                news.put((unit, attempt_unit(do, unit, attempt, book.task, kept)))
            except BaseException as error:  # handed over: it is raised where it ends the run
                news.put((unit, error))

    count, running = min(count, book.left), 0
    for number in range(count):
        threading.Thread(target=serve, name=f"eagor-unit-{number}", daemon=True).start()
    try:
        while book.left or running:
            while running < count and (found := book.next(None, set())) is not None:
                orders.put(found)
                running += 1
            unit, head = news.get()
            running -= 1
            if isinstance(head, BaseException):
                raise head
            book.ended(unit, head)
    finally:
        for _ in range(count):
            orders.put(None)


class _Shared(Ledger):
    """A ledger that several threads append to, one at a time."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger, self._lock = ledger, threading.Lock()

    def append(self, record: Mapping[str, Any]) -> None:
        with self._lock:
            self._ledger.append(record)
