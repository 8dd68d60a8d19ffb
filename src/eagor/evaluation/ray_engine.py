"""Units on a Ray cluster: many machines, each worker an actor, each result kept by the process that started the run.

Workers may be anywhere and share no disk, so they send their records back; the one ledger is written here, and a unit
counts as done once its record is on this disk. An actor, or a whole machine, that dies takes its unit's attempt with
it; the unit is tried again elsewhere. Ray's own authentication is left as the cluster has it.
"""

from __future__ import annotations

import atexit
import importlib
import signal
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from eagor.errors import EagorError
from eagor.evaluation.units import Book, Unit, WorkError, attempt_unit, failure, head_of, load

if TYPE_CHECKING:
    import psutil

PATIENCE = 2.0  # seconds that Ray has to end by itself
STARTS = 3  # so many actors in a row that die before they are ready mean that none ever will be


def work_on_ray(book: Book, work: str, config: dict[str, Any], count: int, address: str | None = None) -> None:
    """All units of `book` on at most `count` actors of the cluster at `address`.

    Args:
        book: what is left to do.
        work: ``"package.module:function"``; has to be importable on every machine, as eagor itself.
        config: settings for `work`; files that it names must be there under the same path.
        count: actors, one processor each.
        address: of the cluster, such as ``auto`` or ``ray://head:10001``; None: RAY_ADDRESS, else this machine alone.

    Raises as `eagor.evaluation.workers.run_units` does, and `EagorError` without ray, or where no cluster answers.
    """
    try:
        ray: Any = importlib.import_module("ray")  # optional: the name is found at run time
        import psutil
    except ImportError as error:
        raise EagorError(
            "--engine ray needs ray: pip install 'eagor[ray]' (the same version on all machines)"
        ) from error
    ours = not ray.is_initialized()
    here, servers = psutil.Process(), []
    if ours:
        others = here.children()
        heed = signal.getsignal(signal.SIGTERM)
        try:
            ray.init(address=address, log_to_driver=False, configure_logging=False)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise EagorError(
                f"no Ray cluster at {address or 'RAY_ADDRESS'} ({error}); start one with `ray start`"
            ) from error
        finally:
            with suppress(ValueError):  # not in the main thread
                signal.signal(signal.SIGTERM, heed)  # Ray takes it, and then ends this process without a word
        servers = [child for child in here.children() if child not in others]
    try:
        _work(ray, book, work, config, count)
    finally:
        if ours:
            _shut_down(ray, servers)


def _shut_down(ray: Any, servers: list[psutil.Process]) -> None:
    """End Ray here. Where a signal has ended some of its `servers` first, it would wait far longer than `PATIENCE`."""
    ending = threading.Thread(target=ray.shutdown, daemon=True)
    ending.start()
    ending.join(PATIENCE)
    if ending.is_alive():
        atexit.unregister(ray.shutdown)  # it would begin to wait once more
        _kill(servers)


def _kill(servers: list[psutil.Process]) -> None:
    """Kill processes and all that they have started, whichever of them are still there."""
    import psutil

    doomed = [*servers]
    for server in servers:
        with suppress(psutil.NoSuchProcess):
            doomed += server.children(recursive=True)
    for process in doomed:
        with suppress(psutil.NoSuchProcess):
            process.kill()


def _work(ray: Any, book: Book, work: str, config: dict[str, Any], count: int) -> None:
    actor = ray.remote(num_cpus=1, max_restarts=0)(Worker)
    crew: list[Any] = []  # actors that wait for a unit
    starting: dict[Any, Any] = {}  # the promise that an actor is ready -> the actor
    busy: dict[Any, tuple[Any, Unit, int, float]] = {}  # the promise of a record -> who does what since when
    stillborn = 0
    while book.left or busy:
        while len(crew) + len(starting) + len(busy) < min(count, book.left + len(busy)):
            new = actor.remote(work, config, book.task)
            starting[new.ready.remote()] = new
        while crew and (found := book.next(None, set())) is not None:
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
            book.ledger.append(record)
            book.ended(unit, head_of(record))


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
