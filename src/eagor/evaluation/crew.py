"""Worker processes: one unit at a time is given to each, and each keeps its own results.

Not concurrent.futures: a pool there breaks as a whole when one worker dies, does not tell whose unit it was, and its
workers outlive a killed parent. Workers are new processes (spawn): they inherit no threads, locks or open files.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from eagor.errors import StorageError, WorkError
from eagor.evaluation.ledger import Ledger, records
from eagor.evaluation.units import Book, Unit, attempt_unit, failure, load
from eagor.plugins import readable_lists

THREADS = (
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
STARTS = 3  # so many workers in a row that die before they are ready mean that none ever will be
PATIENCE = 3.0  # seconds that workers have to leave by themselves, all together


@dataclass
class _Worker:
    """A process, the line to it, and what it is busy with."""

    process: BaseProcess
    line: Connection
    ready: bool = False
    gone: bool = False
    group: str | None = None
    unit: Unit | None = None
    attempt: int = 0
    began: float = 0.0
    path: Path | None = None
    news: deque[tuple[str, Any]] = field(default_factory=deque)


def work_together(book: Book, work: str, config: dict[str, Any], count: int) -> None:
    """All units of `book`, on at most `count` processes. Raises as `eagor.evaluation.workers.run_units` does."""
    crew: list[_Worker] = []
    stillborn = 0
    try:
        while book.left or any(worker.unit for worker in crew):
            busy = sum(worker.unit is not None for worker in crew)
            while len(crew) < min(count, book.left + busy):
                crew.append(_start(book, work, config))
            for worker in crew:
                if worker.ready and worker.unit is None:
                    _hand_out(book, worker, crew)
            if not book.left and not any(worker.unit for worker in crew):
                break  # the last units could not be sent: nobody will say anything more
            _listen(crew)
            for worker in list(crew):
                while worker.news:
                    _hear(book, worker, *worker.news.popleft())
                if not worker.gone:
                    continue
                crew.remove(worker)
                stillborn = 0 if worker.ready else stillborn + 1
                _bury(book, worker)
                if stillborn >= STARTS:
                    raise WorkError(
                        f"{STARTS} workers in a row ended before they were ready (exit code "
                        f"{worker.process.exitcode}); what they wrote to stderr says why. Try workers=1"
                    )
    finally:
        _dismiss(crew)


def _start(book: Book, work: str, config: dict[str, Any]) -> _Worker:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there, work, config, book.folder, book.task), daemon=True)
    with _one_thread():
        process.start()
    there.close()  # so that the line ends when the process does
    return _Worker(process, here)


def _hand_out(book: Book, worker: _Worker, crew: list[_Worker]) -> None:
    taken = {other.group for other in crew if other is not worker and other.group is not None}
    while (found := book.next(worker.group, taken)) is not None:
        unit, attempt = found
        worker.group = unit.group
        try:
            worker.line.send((unit, attempt))
        except OSError:  # it has died; we hear of that soon
            book.give_back(unit, attempt)
            return
        except Exception as error:  # try the next unit
            book.cannot_be_sent(unit, attempt, error)
        else:
            worker.unit, worker.attempt, worker.began = unit, attempt, time.perf_counter()
            return
    worker.group = None


def _listen(crew: list[_Worker]) -> None:
    """Wait until some worker says something or ends, and note what they say."""
    wait([worker.line for worker in crew] + [worker.process.sentinel for worker in crew])
    for worker in crew:
        alive = worker.process.is_alive()  # asked first: what it said before its end is still in the line
        try:
            while worker.line.poll():
                worker.news.append(worker.line.recv())
        except (EOFError, OSError):
            alive = False
        if not alive:
            worker.gone = True
            _end(worker.process)


def _hear(book: Book, worker: _Worker, what: str, said: Any) -> None:
    if what == "ready":
        worker.ready, worker.path = True, Path(said)
    elif what == "ended" and worker.unit is not None:
        unit, worker.unit = worker.unit, None
        book.ended(unit, said)
    elif what == "storage":
        raise StorageError(said)
    elif what == "work":
        raise WorkError(said)


def _bury(book: Book, worker: _Worker) -> None:
    """A worker has ended. Its unit has had an attempt, unless the result had been kept already."""
    worker.line.close()
    if worker.unit is None:
        return
    unit, worker.unit = worker.unit, None
    if worker.path is not None:
        for record in records(worker.path):
            if (record["key"], record["attempt"]) == (unit.key, worker.attempt):
                book.ended(unit, record)
                return
    code = worker.process.exitcode
    if code == -signal.SIGTERM:
        time.sleep(0.2)  # who ends a worker so ends us too, as a rule: then the unit has had no attempt
    how = f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
    seconds = time.perf_counter() - worker.began
    record = failure(unit, worker.attempt, book.task, f"the worker died in this unit ({how})", seconds)
    book.ledger.append(record)
    book.ended(unit, record)


def _dismiss(crew: list[_Worker]) -> None:
    """Send everybody home; whoever is in the middle of a unit, or of its start, is stopped."""
    for worker in crew:
        with suppress(OSError):
            worker.line.send(None)
        if worker.unit is not None or not worker.ready:
            worker.process.terminate()
    late = time.monotonic() + PATIENCE
    for worker in crew:
        _end(worker.process, late - time.monotonic())
        worker.line.close()


def _end(process: BaseProcess, patience: float = PATIENCE) -> None:
    process.join(max(0.0, patience))
    if process.is_alive():
        process.kill()
        process.join()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Processes started inside have one BLAS thread each: the libraries read these once, when they are loaded."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _serve(line: Connection, work: str, config: dict[str, Any], folder: Path, task: str | None) -> None:
    """The life of a worker process."""
    import threading

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process of the terminal; the parent decides
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    ledger = Ledger(folder, first=1)  # 0 is the parent's
    try:
        try:
            with readable_lists():
                do = load(work, config)
        except Exception as error:
            line.send(("work", f"{work} cannot be set up: {type(error).__name__}: {error}"))
            return
        line.send(("ready", str(ledger.open())))
        while (order := line.recv()) is not None:
            unit, attempt = order
            line.send(("ended", attempt_unit(do, unit, attempt, task, ledger)))
    except StorageError as error:
        line.send(("storage", str(error)))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return  # the parent has gone
    finally:
        ledger.close()


def _leave_with_parent() -> None:
    """End this process when its parent has ended, however that came about: nobody is left to give it work."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
