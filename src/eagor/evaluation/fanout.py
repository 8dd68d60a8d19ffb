"""Units whose work is waiting for servers: many at once in one process, each result kept the moment it is there.

All threads share what `work` set up (one perception, one client per server), so the work has to be safe to use from
several threads; those of `eagor.perception.endpoint` are, and deal their requests out among their servers.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any

from eagor.evaluation.ledger import Ledger
from eagor.evaluation.units import Book, Unit, attempt_unit, load


def work_in_threads(book: Book, work: str, config: dict[str, Any], count: int) -> None:
    """All units of `book`, at most `count` at once. Raises as `eagor.evaluation.workers.run_units` does.

    On an error that ends the run, and on Ctrl-C, nothing more is begun; what is under way is not waited for.
    """
    do = load(work, config)
    kept = _Shared(book.ledger)
    pool = ThreadPoolExecutor(count, thread_name_prefix="eagor-unit")
    running: dict[Future[dict[str, Any]], Unit] = {}
    try:
        while book.left or running:
            while len(running) < count and (found := book.next(None, set())) is not None:
                unit, attempt = found
                running[pool.submit(attempt_unit, do, unit, attempt, book.task, kept)] = unit
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                book.ended(running.pop(future), future.result())
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


class _Shared(Ledger):
    """A ledger that several threads append to, one at a time."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger, self._lock = ledger, threading.Lock()

    def append(self, record: Mapping[str, Any]) -> None:
        with self._lock:
            self._ledger.append(record)
