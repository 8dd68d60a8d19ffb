"""The process that talks to Ray: it joins the cluster, or begins one here, and gives units to actors.

It has a session of its own, so that all that Ray starts can be ended together (`end_session`), and a signal meant for
the run ends none of Ray's servers. It asks the process that started it what is left to do.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from eagor.errors import EagorError
from eagor.evaluation.units import Unit, WorkError, attempt_unit, failure, load

STARTS = 3  # so many actors in a row that die before they are ready mean that none ever will be
OVER, READY = "over", "ready"


def drive(line: Connection, work: str, config: dict[str, Any], count: int, address: str | None, task: Any) -> None:
    """The life of this process; the last word on the line is `OVER`, with the error if there was one."""
    os.setsid()
    threading.Thread(target=_leave_with_parent, daemon=True).start()
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


def _leave_with_parent() -> None:
    """End the whole session when the parent has ended, however that came about: Ray itself would stay for a minute."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        end_session(os.getpid())
        os._exit(1)


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

    def next(self) -> tuple[Unit, int] | None:
        return pickle.loads(self._ask("next"))

    def record(self, unit: Unit, record: Mapping[str, Any]) -> None:
        """Keep the record of an attempt at `unit`, which is over."""
        self._ask("record", unit, record)


def _work(ray: Any, book: _Book, work: str, config: dict[str, Any], count: int) -> None:
    actor = ray.remote(num_cpus=1, max_restarts=0)(Worker)
    crew: list[Any] = []  # actors that wait for a unit
    starting: dict[Any, Any] = {}  # the promise that an actor is ready -> the actor
    busy: dict[Any, tuple[Any, Unit, int, float]] = {}  # the promise of a record -> who does what since when
    stillborn = 0
    while book.left or busy:
        while len(crew) + len(starting) + len(busy) < min(count, book.left + len(busy)):
            new = actor.remote(work, config, book.task)
            starting[new.ready.remote()] = new
        while crew and (found := book.next()) is not None:
            unit, attempt = found
            worker = crew.pop()
            busy[worker.do.remote(unit, attempt)] = (worker, unit, attempt, time.perf_counter())
        done, _ = ray.wait([*starting, *busy], num_returns=1)
        for promise in done:
            if promise in starting:
                worker = starting.pop(promise)
                try:
                    said = ray.get(promise)
                except ray.exceptions.RayError as error:
                    stillborn += 1
                    if stillborn >= STARTS:
                        raise WorkError(f"{STARTS} actors in a row died before they were ready: {error}") from error
                    continue
                if said is not None:
                    raise WorkError(f"{work} cannot be set up on a worker: {said}")
                stillborn = 0
                crew.append(worker)
                continue
            worker, unit, attempt, began = busy.pop(promise)
            try:
                record = ray.get(promise)
                crew.append(worker)
            except ray.exceptions.RayError as error:
                text = f"the worker died in this unit ({type(error).__name__})"
                record = failure(unit, attempt, book.task, text, time.perf_counter() - began)
            book.record(unit, record)


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
        from eagor.evaluation.lines import as_line

        as_line(record)
        self.record = dict(record)
