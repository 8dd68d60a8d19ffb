"""Units of work, and several workers that do them: processes, threads, or Ray's actors (`workers`).

A `Book` knows which units are left to do and how often each was tried. Each worker has a `Seat` here, whose thread
talks with it; what is given to it comes back in a future. Not the pools of concurrent.futures: one breaks as a whole
when a worker dies, does not tell whose unit that was, outlives a killed parent, and the end of the process waits for
its threads.
"""

from __future__ import annotations

import importlib
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from eagor._processes import Worker, WorkerEnded
from eagor.errors import EagorError, StorageError, WorkError
from eagor.evaluation.ledger import Ledger, read, records
from eagor.plugins import readable_lists

LONGEST_ERROR = 2000  # characters of an error's text that are kept
STARTS = 3  # so many workers in a row that die before they are ready mean that none ever will be
PATIENCE = 3.0  # seconds that workers have to leave by themselves, all together

Do = Callable[[Any], Mapping[str, Any]]


@dataclass(frozen=True)
class Unit:
    """One piece of work: its `key` in the ledger, the `group` whose things it shares, and its `payload` for the work.

    Units of one group (the episodes of one apartment) go to one process as long as there are others to give.
    """

    key: str
    group: str
    payload: Any = None


class Book:
    """What is left to do, by group; how often it was tried; what came of it."""

    def __init__(
        self,
        units: Sequence[Unit],
        folder: Path,
        task: str | None,
        attempts: int,
        retry_failed: bool = False,
        on_done: Callable[[dict[str, Any]], object] | None = None,
    ) -> None:
        self.folder, self.task, self._on_done = folder, task, on_done
        self.ledger = Ledger(folder)
        self.done = self.failed = self.skipped = 0
        self._queues: dict[str, deque[tuple[Unit, int]]] = {}
        self._last: dict[str, int] = {}  # the number of the last attempt that each unit may have
        before = {record["key"]: (record["attempt"], record["status"]) for record in read(folder)}
        for unit in units:
            if unit.key in self._last:
                raise EagorError(f"the key {unit.key!r} is given to two units; each needs one of its own")
            tried, status = before.get(unit.key, (0, "new"))
            self._last[unit.key] = tried + attempts if tried >= attempts else attempts
            if status == "ok":
                self.skipped += 1
            elif tried >= attempts and not retry_failed:
                self.failed += 1
            else:
                self._queues.setdefault(unit.group, deque()).append((unit, tried + 1))

    @property
    def left(self) -> int:
        """How many units wait."""
        return sum(map(len, self._queues.values()))

    def next(self, group: str | None, taken: set[str]) -> tuple[Unit, int] | None:
        """The next unit and its attempt, for a worker that has just done one of `group`; None: all given out.

        Its own group first, then one that is not among those `taken` by others, then help with the longest.
        """
        waiting = [name for name, queue in self._queues.items() if queue]
        if not waiting:
            return None
        if group not in waiting:
            free = [name for name in waiting if name not in taken]
            group = free[0] if free else max(waiting, key=lambda name: len(self._queues[name]))
        return self._queues[group].popleft()

    def give_back(self, unit: Unit, attempt: int) -> None:
        """`unit` has not been begun after all."""
        self._queues[unit.group].appendleft((unit, attempt))

    def lost(self, unit: Unit, attempt: int, error: str, seconds: float) -> None:
        """Record an attempt at `unit` that no worker can: it has died, or the unit could not be sent."""
        record = failure(unit, attempt, self.task, error, seconds)
        self.ledger.append(record)
        self.ended(unit, record)

    def ended(self, unit: Unit, head: dict[str, Any]) -> None:
        """The attempt with this record (or its head) is over: count the unit, or have it tried again."""
        if head["status"] == "ok":
            self.done += 1
        elif head["attempt"] < self._last[unit.key]:
            self._queues[unit.group].append((unit, head["attempt"] + 1))
            return
        else:
            self.failed += 1
        if self._on_done is not None:
            self._on_done(head_of(head))


def load(work: str, config: dict[str, Any]) -> Do:
    """What does the units: ``function(config)`` of ``"package.module:function"``. Raises `WorkError`."""
    module, _, name = work.partition(":")
    try:
        begin = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise WorkError(f"cannot find the work {work!r} ({error}); wanted 'package.module:function'") from error
    return begin(config)


def attempt_unit(
    do: Do, unit: Unit, attempt: int, task: str | None, keep: Callable[[Mapping[str, Any]], None]
) -> dict[str, Any]:
    """Do `unit`, `keep` the record of what came of it, and return its head. Raises only what ends the run."""
    began = time.perf_counter()
    try:
        body = do(unit.payload)
        if not isinstance(body, Mapping):
            raise EagorError(f"the work returned a {type(body).__name__}; wanted a dict")
        head = {
            "key": unit.key,
            "task": body.get("task", task),
            "attempt": attempt,
            "status": "ok",
            "seconds": round(time.perf_counter() - began, 3),
        }
        record = head | {name: value for name, value in body.items() if name not in head}
        keep(record)
    except StorageError:
        raise
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        if not isinstance(error, EagorError):  # whoever wrote the plugin wants to know where
            last = traceback.extract_tb(error.__traceback__)[-1]
            text = f"{text[: LONGEST_ERROR - 100]} ({Path(last.filename).name}:{last.lineno})"
        record = failure(unit, attempt, task, text, time.perf_counter() - began)
        keep(record)
    return head_of(record)


def failure(unit: Unit, attempt: int, task: str | None, error: str, seconds: float) -> dict[str, Any]:
    """The record of an attempt that came to nothing."""
    return {
        "key": unit.key,
        "task": task,
        "attempt": attempt,
        "status": "failed",
        "error": error[:LONGEST_ERROR],
        "seconds": round(seconds, 3),
    }


def head_of(record: Mapping[str, Any]) -> dict[str, Any]:
    """`record` without its long parts."""
    return {name: value for name, value in record.items() if name not in ("methods", "truth")}


class Lost(Exception):
    """The worker has died. `begun`: whether in the middle of a unit; `kept`: the unit's record, if it got so far."""

    def __init__(self, how: str, begun: bool = True, kept: dict[str, Any] | None = None) -> None:
        super().__init__(how)
        self.begun, self.kept = begun, kept


class Unsent(Exception):
    """The payload of a unit cannot be pickled."""


class Seat:
    """One worker, and the thread that talks with it. `group`: of the unit that it did last."""

    def __init__(self) -> None:
        self.group: str | None = None
        self.ready: Future[None] = Future()
        self._orders: SimpleQueue[tuple[Unit, int, Future[dict[str, Any]]] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def give(self, unit: Unit, attempt: int) -> Future[dict[str, Any]]:
        """Have a unit done: its record's head, `Lost`, `Unsent`, or what ends the run."""
        future: Future[dict[str, Any]] = Future()
        self._orders.put((unit, attempt, future))
        return future

    def leave(self) -> None:
        """Nothing more will be given."""
        self._orders.put(None)

    def stop(self, late: float) -> None:
        """After `leave`: see that it is gone by `late` (of time.monotonic), where that matters."""

    def _settle(self) -> None:
        """Wait until the worker can begin."""

    def _do(self, unit: Unit, attempt: int) -> dict[str, Any]:
        raise NotImplementedError

    def _serve(self) -> None:
        future: Future[Any] = self.ready
        try:
            self._settle()
            future.set_result(None)
            while (order := self._orders.get()) is not None:
                unit, attempt, future = order
                try:
                    future.set_result(self._do(unit, attempt))
                except Unsent as error:
                    future.set_exception(error)
        except BaseException as error:  # raised where it ends the run, or the seat
            future.set_exception(error)


def work_together(book: Any, hire: Callable[[], Seat], count: int) -> None:
    """All units of `book` on at most `count` seats; one that is lost is replaced, and its unit has had an attempt.

    Raises as `eagor.evaluation.workers.run_units` does.
    """
    seats: list[Seat] = []
    starting: dict[Future[Any], Seat] = {}
    busy: dict[Future[Any], tuple[Seat, Unit, int, float]] = {}
    idle: list[Seat] = []
    stillborn = 0
    try:
        while book.left or busy:
            while len(seats) < min(count, book.left + len(busy)):
                seats.append(hire())
                starting[seats[-1].ready] = seats[-1]
            while idle:
                seat = idle[-1]
                taken = {other.group for other in seats if other is not seat and other.group is not None}
                if (found := book.next(seat.group, taken)) is None:
                    seat.group = None
                    break
                seat.group = found[0].group
                busy[seat.give(*found)] = (idle.pop(), *found, time.perf_counter())
            if not (starting or busy):
                break  # the last units could not be sent
            for future in wait([*starting, *busy], return_when=FIRST_COMPLETED).done:
                if future in starting:
                    seat = starting.pop(future)
                    try:
                        future.result()
                        stillborn = 0
                        idle.append(seat)
                    except Lost as lost:
                        seats.remove(seat)
                        stillborn += 1
                        if stillborn >= STARTS:
                            raise WorkError(
                                f"{STARTS} workers in a row ended before they were ready ({lost}); what they wrote to "
                                "stderr says why. Try workers=1"
                            ) from None
                    continue
                seat, unit, attempt, began = busy.pop(future)
                try:
                    book.ended(unit, future.result())
                    idle.append(seat)
                except Unsent as error:
                    book.lost(unit, attempt, f"cannot be sent: {error}", 0.0)
                    idle.append(seat)
                except Lost as lost:
                    seats.remove(seat)
                    if lost.kept is not None:
                        book.ended(unit, lost.kept)
                    elif lost.begun:
                        how = f"the worker died in this unit ({lost})"
                        book.lost(unit, attempt, how, time.perf_counter() - began)
                    else:
                        book.give_back(unit, attempt)
    finally:
        for seat in seats:
            seat.leave()
        late = time.monotonic() + PATIENCE
        for seat in seats:
            seat.stop(late)


class ThreadSeat(Seat):
    """A thread of this process: for work that waits for servers, and is safe to use from several threads."""

    def __init__(self, do: Do, book: Book) -> None:
        self._work, self._book = do, book
        super().__init__()

    def _do(self, unit: Unit, attempt: int) -> dict[str, Any]:
        return attempt_unit(self._work, unit, attempt, self._book.task, self._book.ledger.append)


class ProcessSeat(Seat):
    """A process, which keeps its results itself."""

    def __init__(self, book: Book, work: str, config: dict[str, Any]) -> None:
        self._worker = Worker(_serve, work, config, book.folder, book.task)
        self._path: Path | None = None
        self._busy, self._how = True, ""
        super().__init__()

    def leave(self) -> None:
        super().leave()
        if self._busy:  # in the middle of a unit, or of its start
            self._worker.process.terminate()

    def stop(self, late: float) -> None:
        self._thread.join(max(0.0, late - time.monotonic()))
        self._worker.kill()
        self._thread.join()

    def _serve(self) -> None:
        try:
            super()._serve()
        finally:
            self._gone()

    def _settle(self) -> None:
        try:
            self._path = Path(self._worker.receive())
        except WorkerEnded:
            raise Lost(self._gone()) from None
        self._busy = False

    def _do(self, unit: Unit, attempt: int) -> dict[str, Any]:
        try:
            self._worker.send((unit, attempt))
        except WorkerEnded:
            raise Lost(self._gone(), begun=False) from None
        except Exception as error:
            raise Unsent(f"{type(error).__name__}: {error}") from error
        self._busy = True
        try:
            return self._worker.receive()
        except WorkerEnded:
            how = self._gone()
        finally:
            self._busy = False
        assert self._path is not None
        mine = (unit.key, attempt)
        kept = next((found for found in records(self._path) if (found["key"], found["attempt"]) == mine), None)
        raise Lost(how, kept=kept)

    def _gone(self) -> str:
        """See the process end; how it did."""
        if not self._how:
            code = self._worker.close(PATIENCE)
            if code == -signal.SIGTERM:
                time.sleep(0.2)  # who ends a worker so ends us too, as a rule: then the unit has had no attempt
            self._how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return self._how


def _serve(line: Connection, work: str, config: dict[str, Any], folder: Path, task: str | None) -> None:
    """The life of a worker process. Raises what ends the run."""
    with Ledger(folder, first=1) as ledger:  # 0: the parent's
        try:
            with readable_lists():
                do = load(work, config)
        except Exception as error:
            raise WorkError(f"{work} cannot be set up: {type(error).__name__}: {error}") from error
        line.send(str(ledger.open()))
        while True:
            unit, attempt = line.recv()
            line.send(attempt_unit(do, unit, attempt, task, ledger.append))
