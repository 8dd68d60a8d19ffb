"""The process that talks to Ray: it joins the cluster, or begins one here, and gives units to actors.

It has a session of its own, so that all that Ray starts can be ended together (`end_session`), and a signal meant for
the run ends none of Ray's servers. It asks the process that started it what is left to do.
"""

from __future__ import annotations

import importlib
import os
import pickle
import signal
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from eagor._processes import leave_with_parent
from eagor.errors import EagorError
from eagor.evaluation.crew import Lost, Seat, work_together
from eagor.evaluation.units import Unit, WorkError, attempt_unit, failure, load

OVER, READY = "over", "ready"


def drive(line: Connection, work: str, config: dict[str, Any], count: int, address: str | None, task: Any) -> None:
    """The life of this process; the last word on the line is `OVER`, with the error if there was one."""
    os.setsid()
    leave_with_parent(lambda: end_session(os.getpid()))  # Ray itself would stay for a minute
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):  # the parent has gone
        line.send((OVER, (_trouble(line, work, config, count, address, task),)))


def _trouble(line: Connection, work: str, config: dict[str, Any], count: int, address: str | None, task: Any) -> Any:
    """Do all units; what went wrong, None if nothing did."""
    try:
        ray: Any = importlib.import_module("ray")  # optional: the name is found at run time
        _join(ray, address)
        signal.signal(signal.SIGTERM, _quiet_end)  # Ray takes it, and would end this process with a trace
        line.send((READY, ()))
        _work(ray, _Book(line, task), work, config, count)
    except (EagorError, EOFError, BrokenPipeError, ConnectionResetError) as known:
        return known
    except Exception as unknown:
        return WorkError(f"the run on Ray ended: {type(unknown).__name__}: {unknown}")


def end_session(leader: int) -> None:
    """Kill all processes of this session but the one that calls."""
    import psutil

    for _ in range(200):  # whoever is killed may have begun another just before
        there = [each for each in psutil.process_iter() if each.pid != os.getpid() and _lives_in(each, leader)]
        if not there:
            return
        for process in there:
            process.kill()
        time.sleep(0.02)


def _lives_in(process: Any, leader: int) -> bool:
    import psutil

    try:
        return os.getsid(process.pid) == leader and process.status() != psutil.STATUS_ZOMBIE
    except (psutil.Error, OSError):
        return False  # it has just ended, or is somebody else's


def _join(ray: Any, address: str | None) -> None:
    try:
        ray.init(address=address, log_to_driver=False, configure_logging=False)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise EagorError(
            f"no Ray cluster at {address or 'RAY_ADDRESS'} ({error}); start one with `ray start`"
        ) from error


def _quiet_end(number: int, _: Any) -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
    sys.exit(128 + number)  # Ray shuts down by itself then


class _Book:
    """The parent's `Book`, as far as it is needed here."""

    def __init__(self, line: Connection, task: Any) -> None:
        self._line, self.task = line, task

    def _ask(self, what: str, *said: Any) -> Any:
        self._line.send((what, said))
        return self._line.recv()

    @property
    def left(self) -> int:
        return self._ask("left")

    def next(self, group: str | None, taken: set[str]) -> tuple[Unit, int] | None:
        return pickle.loads(self._ask("next", group, taken))

    def ended(self, unit: Unit, record: Mapping[str, Any]) -> None:
        """An attempt at `unit` is over: keep its record."""
        self._ask("record", unit, record)

    def lost(self, unit: Unit, attempt: int, error: str, seconds: float) -> None:
        self.ended(unit, failure(unit, attempt, self.task, error, seconds))


class _ActorSeat(Seat):
    """An actor somewhere on the cluster; its records come back whole."""

    def __init__(self, ray: Any, actor: Any, work: str) -> None:
        self._ray, self._actor, self._work = ray, actor, work
        super().__init__()

    def _settle(self) -> None:
        if (said := self._got(self._actor.ready.remote())) is not None:
            raise WorkError(f"{self._work} cannot be set up on a worker: {said}")

    def _do(self, unit: Unit, attempt: int) -> dict[str, Any]:
        return self._got(self._actor.do.remote(unit, attempt))

    def _got(self, promise: Any) -> Any:
        try:
            return self._ray.get(promise)
        except self._ray.exceptions.RayError as error:
            raise Lost(type(error).__name__) from error


def _work(ray: Any, book: _Book, work: str, config: dict[str, Any], count: int) -> None:
    actor = ray.remote(num_cpus=1, max_restarts=0)(Worker)
    work_together(book, lambda: _ActorSeat(ray, actor.remote(work, config, book.task), work), count)


class Worker:
    """What lives on the cluster: the work, set up once."""

    def __init__(self, work: str, config: dict[str, Any], task: str | None) -> None:
        self._task, self._fault = task, None
        try:
            self._do: Any = load(work, config)
        except Exception as error:
            self._fault = f"{type(error).__name__}: {error}"

    def ready(self) -> str | None:
        """None, or what is wrong."""
        return self._fault

    def do(self, unit: Unit, attempt: int) -> dict[str, Any]:
        """The record of one attempt."""
        kept = _Kept()
        attempt_unit(self._do, unit, attempt, self._task, kept)  # type: ignore[arg-type]
        return kept.record


class _Kept:
    """Takes the one record of an attempt, and checks that it can be written."""

    record: dict[str, Any]

    def append(self, record: Mapping[str, Any]) -> None:
        from eagor.evaluation.ledger import as_line

        as_line(record)
        self.record = dict(record)
