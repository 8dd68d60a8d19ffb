"""Units on a Ray cluster: each worker an actor; their records come back and are kept by the process that began the run.

An actor or a machine that dies takes its unit's attempt with it. Ray takes over the signals of the process that talks
to it, and waits for a minute where one of its servers has gone. So that is a process of its own, the driver: it joins
the cluster, or begins one here, gives units to actors, and asks this process what is left to do. It has a session of
its own, so that all that Ray starts can be ended together, and a signal for the run ends none of Ray's servers.
"""

from __future__ import annotations

import importlib
import os
import pickle
import signal
import sys
import time
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from typing import Any

from eagor._extras import need
from eagor._processes import Worker, WorkerEnded
from eagor.errors import EagorError
from eagor.evaluation.ledger import as_line
from eagor.evaluation.worker_pool import (
    Book,
    Lost,
    Seat,
    Unit,
    WorkError,
    attempt_unit,
    failure,
    head_of,
    load,
    work_together,
)

PATIENCE = 2.0  # seconds that Ray has to end by itself (a cluster elsewhere hears of it)
READY, OVER = "ready", "over"  # what the driver says, beside its questions


def work_on_ray(book: Book, work: str, config: dict[str, Any], count: int, address: str | None = None) -> None:
    """All units of `book` on at most `count` actors, one processor each, of the cluster at `address`.

    `work` and the files that `config` names have to be on every machine. Without an address: the cluster that this
    process has joined, RAY_ADDRESS, else this machine alone. Raises as `eagor.evaluation.workers.run_units`, and
    `EagorError` without ray, or where no cluster answers.
    """
    need("--engine ray (the same version on all machines)", "ray", "ray", "psutil")
    answers = _answers(book)
    driver = Worker(_drive, work, config, count, address or _joined(), book.task, at_parents_end=_end_own_session)
    begun = False
    try:
        while (said := driver.receive())[0] != OVER:
            if said[0] == READY:
                begun = True
            else:
                driver.send(answers[said[0]](*said[1:]))
        driver.process.join(PATIENCE)
    except WorkerEnded:
        code = driver.close(PATIENCE)
        raise WorkError(
            f"the process that talks to Ray ended (exit code {code}); what it wrote to stderr says why"
        ) from None
    finally:
        if begun and driver.alive:
            driver.process.terminate()
            driver.process.join(PATIENCE)
        driver.close(0.0)
        assert driver.process.pid is not None
        _end_session(driver.process.pid)


def _joined() -> str | None:
    """The address of the cluster that this process is part of already."""
    ray: Any = sys.modules.get("ray")
    return ray.get_runtime_context().gcs_address if ray is not None and ray.is_initialized() else None


def _answers(book: Book) -> dict[str, Callable[..., Any]]:
    """What the driver may ask about `book`, by name; see `_AskedBook`."""

    def following(group: str | None, taken: set[str]) -> bytes:
        """The next unit that can be sent, pickled with the number of its attempt; None, pickled, if there is none."""
        while (found := book.next(group, taken)) is not None:
            try:
                return pickle.dumps(found)
            except Exception as error:
                book.lost(*found, f"cannot be sent: {type(error).__name__}: {error}", 0.0)
        return pickle.dumps(None)

    def ended(unit: Unit, record: dict[str, Any]) -> None:
        book.ledger.append(record)
        book.ended(unit, head_of(record))

    return {"left": lambda: book.left, "next": following, "ended": ended}


def _end_own_session() -> None:
    _end_session(os.getpid())


def _end_session(leader: int) -> None:
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


# In the driver


def _drive(line: Connection, work: str, config: dict[str, Any], count: int, address: str | None, task: Any) -> None:
    """The life of the driver: do all units. Raises what ends the run."""
    os.setsid()
    try:
        ray: Any = importlib.import_module("ray")  # optional: the name is found at run time
        try:
            ray.init(address=address, log_to_driver=False, configure_logging=False)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise EagorError(
                f"no Ray cluster at {address or 'RAY_ADDRESS'} ({error}); start one with `ray start`"
            ) from error
        signal.signal(signal.SIGTERM, _quiet_end)  # Ray takes it, and would end this process with a trace
        line.send((READY,))
        actor = ray.remote(num_cpus=1, max_restarts=0)(_Actor)
        book = _AskedBook(line, task)
        work_together(book, lambda: _ActorSeat(ray, actor.remote(work, config, task), work), count)
    except (EagorError, EOFError, BrokenPipeError, ConnectionResetError):
        raise
    except Exception as unknown:
        raise WorkError(f"the run on Ray ended: {type(unknown).__name__}: {unknown}") from unknown
    line.send((OVER,))


def _quiet_end(number: int, _: Any) -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
    sys.exit(128 + number)  # Ray shuts down by itself then


class _AskedBook:
    """The `Book` of the process that began the run, as far as `work_together` needs it."""

    def __init__(self, line: Connection, task: Any) -> None:
        self._line, self._task = line, task

    def _ask(self, *question: Any) -> Any:
        self._line.send(question)
        return self._line.recv()

    @property
    def left(self) -> int:
        return self._ask("left")

    def next(self, group: str | None, taken: set[str]) -> tuple[Unit, int] | None:
        return pickle.loads(self._ask("next", group, taken))

    def ended(self, unit: Unit, record: Mapping[str, Any]) -> None:
        """An attempt at `unit` is over: keep its record."""
        self._ask("ended", unit, record)

    def lost(self, unit: Unit, attempt: int, error: str, seconds: float) -> None:
        self.ended(unit, failure(unit, attempt, self._task, error, seconds))


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


# On the cluster


class _Actor:
    """The work, set up once. It is itself the ledger of an attempt, which takes one record."""

    def __init__(self, work: str, config: dict[str, Any], task: str | None) -> None:
        self._task, self._fault = task, None
        self._record: dict[str, Any] = {}
        try:
            self._do: Any = load(work, config)
        except Exception as error:
            self._fault = f"{type(error).__name__}: {error}"

    def ready(self) -> str | None:
        """None, or what is wrong."""
        return self._fault

    def do(self, unit: Unit, attempt: int) -> dict[str, Any]:
        """The record of one attempt."""
        attempt_unit(self._do, unit, attempt, self._task, self)
        return self._record

    def append(self, record: Mapping[str, Any]) -> None:
        """Take the record. Raises `EagorError` for one that cannot be written."""
        as_line(record)
        self._record = dict(record)
