"""Units of work: which are left to do, how one is done and recorded, and how often it may be tried."""

from __future__ import annotations

import importlib
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from eagor.errors import EagorError, StorageError, WorkError
from eagor.evaluation.ledger import Ledger, read

LONGEST_ERROR = 2000  # characters of an error's text that are kept

Do = Callable[[Any], Mapping[str, Any]]
Told = Callable[[dict[str, Any]], object]


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
        on_done: Told | None = None,
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


class Keeps(Protocol):
    """What keeps records: a `Ledger`, or what passes them on to one."""

    def append(self, record: Mapping[str, Any]) -> None: ...


def load(work: str, config: dict[str, Any]) -> Do:
    """What does the units: ``function(config)`` of ``"package.module:function"``. Raises `WorkError`."""
    module, _, name = work.partition(":")
    try:
        begin = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise WorkError(f"cannot find the work {work!r} ({error}); wanted 'package.module:function'") from error
    return begin(config)


def attempt_unit(do: Do, unit: Unit, attempt: int, task: str | None, ledger: Keeps) -> dict[str, Any]:
    """Do `unit`, record what came of it, and return the record's head. Raises only what ends the run."""
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
        ledger.append(record)
    except StorageError:
        raise
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        record = failure(unit, attempt, task, text, time.perf_counter() - began)
        ledger.append(record)
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
