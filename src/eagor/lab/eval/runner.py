"""Carrying out a run: many units of work on one or several workers, one writer, each result kept when it is there.

What is recorded decides what is left to do. A unit that raises, or takes its process down, has had an attempt. Workers
are processes here, threads (for work that waits for servers), or actors on a Ray cluster; each has a thread of this
process that talks with it, so all three are run by one loop. Not the pools of concurrent.futures and joblib: they break
as a whole when one worker dies, and do not tell whose unit that was.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal, Protocol

from eagor._extras import need
from eagor._processes import Worker, WorkerEnded
from eagor.errors import EagorError, StorageError, WorkError
from eagor.lab.agents.models import release
from eagor.lab.eval import log
from eagor.lab.tasks.task import WORK, Task, configure, settings_of
from eagor.lab.tasks.task import load as load_task
from eagor.plugins import readable_lists

Engine = Literal["processes", "threads", "ray"]
"""Who the workers of a run are."""
LONGEST_ERROR = 2000  # characters of an error's text that are kept
STARTS = 3  # so many workers in a row that die before they are ready mean that none ever will be
PATIENCE = 3.0  # seconds that a worker has to leave by itself

Do = Callable[[Any], Mapping[str, Any]]
Record = dict[str, Any]


@dataclass(frozen=True)
class Unit:
    """One piece of work: its `key` in the log, the `group` whose things it shares, and its `payload` for the work.

    Units of one group (the episodes of one apartment) go to one worker as long as there are others to give.
    """

    key: str
    group: str
    payload: Any = None


@dataclass(frozen=True)
class Outcome:
    """How many units were done now, have failed for good, and had been done before. Together: all that were asked."""

    done: int
    failed: int
    skipped: int


def run(
    units: Sequence[Unit],
    work: str,
    config: Mapping[str, Any],
    folder: Path,
    workers: int = 1,
    attempts: int = 2,
    on_done: Callable[[Record], object] | None = None,
    retry_failed: bool = False,
    engine: Engine = "processes",
    address: str | None = None,
) -> Outcome:
    """Do all of `units` that `folder` has no result of, and record each as soon as it ends. `config`: of the run.

    `work` is ``"package.module:function"``: ``function(config)`` is called once per worker and returns a callable,
    payload -> dict; the dict becomes the record, together with key, task, attempt, status and seconds. One worker works
    in this process (a unit that kills it ends the run, and has had no attempt); several are new processes with one BLAS
    thread each, threads, or actors of the Ray cluster at `address` (None: RAY_ADDRESS, else this machine; `work` and
    the files that `config` names have to be on every machine). A unit has so many `attempts`, earlier runs included;
    `retry_failed` gives as many again. `on_done` gets the record of each unit that is finished, without its "methods"
    and "truth".

    Raises `EagorError` for two units of one key, a number below 1, a folder that holds another run or is being written
    to, a missing extra, or no cluster; `WorkError` if `work` cannot be set up, or workers die before they have begun;
    `StorageError` if the disk does not take the results. `KeyboardInterrupt` is passed on after the workers have been
    stopped.
    """
    if workers < 1 or attempts < 1:
        raise EagorError(f"got {workers} workers and {attempts} attempts; wanted at least 1 of each")
    log.begin(folder, config, _samples(units))
    try:
        with log.Log(folder) as book:
            before = {record["key"]: (record["attempt"], record["status"]) for record in log.read(folder)}
            schedule = Scheduler(units, before, attempts, retry_failed, config.get("task"), book.append, on_done)
            if schedule.left and engine == "ray":
                need("--engine ray (the same version on all machines)", "ray", "ray")
                release()
                with _cluster(address) as ray:
                    actor = ray.remote(num_cpus=1, max_restarts=0)(_Actor)
                    _together(schedule, lambda: _OnRay(ray, actor.remote(work, dict(config)), work), workers)
            elif schedule.left and workers == 1:
                _lane(schedule, lambda: _Here(load(work, config)))
            elif schedule.left and engine == "threads":
                shared = _Here(load(work, config))
                _together(schedule, lambda: shared, workers)
            elif schedule.left:
                release()  # the workers make their own
                _together(schedule, lambda: _Process(work, dict(config)), workers)
        return Outcome(schedule.done, schedule.failed, schedule.skipped)
    finally:
        release()


def units_of(task: Task, config: Any, limit: int | None = None, shard: tuple[int, int] = (1, 1)) -> list[Unit]:
    """The units of a run. `limit`: only the first so many samples; `shard`: (i, n), every n-th from the i-th on.

    Neither changes what a sample is called, so any parts of a run fit into one folder. Raises `EagorError`.
    """
    part, parts = shard
    if not 1 <= part <= parts:
        raise EagorError(f"shard {part}/{parts}; wanted i/n with 1 <= i <= n, such as 1/4")
    if limit is not None and limit < 1:
        raise EagorError(f"a limit of {limit} samples; wanted 1 or more")
    samples = task.samples(config)[:limit][part - 1 :: parts]
    return [Unit(f"{task.name}/{sample.id}", sample.group, sample.payload) for sample in samples]


def run_task(task: str | Task, folder: Path, values: Mapping[str, Any], **how: Any) -> Outcome:
    """Do what `folder` has no record of yet of the run whose settings are `values`; `how` as in `run`.

    Raises as `eagor.lab.tasks.task.configure` and `run`.
    """
    loaded: Task = load_task(task) if isinstance(task, str) else task
    config = configure(loaded, values)
    return run(units_of(loaded, config), WORK, settings_of(config), folder, **how)


def _samples(units: Sequence[Unit]) -> dict[str, Any]:
    """How many units were asked for, and a digest of what they are."""
    text = json.dumps(sorted((unit.key, repr(unit.payload)) for unit in units))
    return {"count": len(units), "digest": hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:16]}


class Scheduler:
    """What is left to do, by group; how often it was tried; what came of it. For several threads; writes alone."""

    def __init__(
        self,
        units: Sequence[Unit],
        before: Mapping[str, tuple[int, str]],
        attempts: int,
        retry_failed: bool,
        task: Any,
        keep: Callable[[Record], object],
        on_done: Callable[[Record], object] | None,
    ) -> None:
        self.done = self.failed = self.skipped = 0
        self.fault: BaseException | None = None
        self._task, self._keep, self._on_done = task, keep, on_done
        self._queues: dict[str, deque[tuple[Unit, int]]] = {}
        self._busy: dict[int, str] = {}  # the group that each thread works on
        self._last: dict[str, int] = {}  # the number of the last attempt that each unit may have
        self._changed = threading.Condition(threading.RLock())
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

    def take(self, group: str | None) -> tuple[Unit, int] | None:
        """The next unit and its attempt, for a worker that has just done one of `group`; None: nothing more will come.

        Its own group first, then one that no other worker is at, then help with the longest.
        """
        with self._changed:
            while not self.left and self._busy and self.fault is None:
                self._changed.wait()  # what others do now may have to be tried again
            if not self.left or self.fault is not None:
                return None
            waiting = [name for name, queue in self._queues.items() if queue]
            if group not in waiting:
                free = [name for name in waiting if name not in self._busy.values()]
                group = free[0] if free else max(waiting, key=lambda name: len(self._queues[name]))
            self._busy[threading.get_ident()] = group
            return self._queues[group].popleft()

    def give_back(self, unit: Unit, attempt: int) -> None:
        """`unit` has not been begun after all."""
        with self._changed:
            self._queues[unit.group].appendleft((unit, attempt))
            self._over()

    def end(self, unit: Unit, attempt: int, found: Mapping[str, Any]) -> None:
        """Record what came of an attempt: "seconds", and a "body" or an "error". Raises `StorageError`."""
        head = {"key": unit.key, "task": self._task, "attempt": attempt, "status": "ok", "seconds": found["seconds"]}
        body = found.get("body")
        with self._changed:
            try:
                if body is not None:
                    record = {**head, "task": body.get("task", self._task)}
                    record |= {name: value for name, value in body.items() if name not in head}
                else:
                    record = _failed(head, found["error"])
                self._keep(record)
            except StorageError:
                raise
            except EagorError as error:  # JSON cannot hold it
                record = _failed(head, f"{type(error).__name__}: {error}")
                self._keep(record)
            if record["status"] == "failed" and attempt < self._last[unit.key]:
                self._queues[unit.group].append((unit, attempt + 1))
            else:
                self.done += record["status"] == "ok"
                self.failed += record["status"] == "failed"
                if self._on_done is not None:
                    self._on_done({name: value for name, value in record.items() if name not in ("methods", "truth")})
            self._over()

    def stop(self, fault: BaseException) -> None:
        """Give nothing more; the first fault counts."""
        with self._changed:
            self.fault = self.fault or fault
            self._over()

    def _over(self) -> None:
        self._busy.pop(threading.get_ident(), None)
        self._changed.notify_all()


def _failed(head: Record, error: str) -> Record:
    return {**head, "status": "failed", "error": error[:LONGEST_ERROR]}


def load(work: str, config: Mapping[str, Any]) -> Do:
    """What does the units: ``function(config)`` of ``"package.module:function"``. Raises `WorkError`."""
    module, _, name = work.partition(":")
    try:
        begin = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise WorkError(f"cannot find the work {work!r} ({error}); wanted 'package.module:function'") from error
    try:
        return begin(config)
    except EagorError:
        raise
    except Exception as error:
        raise WorkError(f"{work} cannot be set up: {type(error).__name__}: {error}") from error


def attempt(do: Do, payload: Any) -> dict[str, Any]:
    """What came of doing `payload`, for `Scheduler.end`. Raises `StorageError`: no other unit would fare better."""
    began = time.perf_counter()
    try:
        body = do(payload)
        if not isinstance(body, Mapping):
            raise EagorError(f"the work returned a {type(body).__name__}; wanted a dict")
        found: dict[str, Any] = {"body": dict(body)}
    except StorageError:
        raise
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        if not isinstance(error, EagorError):  # whoever wrote the plugin wants to know where
            last = traceback.extract_tb(error.__traceback__)[-1]
            text = f"{text[: LONGEST_ERROR - 100]} ({Path(last.filename).name}:{last.lineno})"
        found = {"error": text}
    return found | {"seconds": round(time.perf_counter() - began, 3)}


# --- workers, and the thread that talks with each ---------------------------------------------------------------------


class WorkerDiedError(Exception):
    """The worker has died. `begun`: whether in the middle of a unit."""

    def __init__(self, how: str, begun: bool = True) -> None:
        super().__init__(how)
        self.begun = begun


class WorkerHandle(Protocol):
    """One worker that is ready. Making one raises `WorkerDiedError` if it dies, `EagorError` if it cannot work."""

    def do(self, payload: Any) -> dict[str, Any]:
        """As `attempt`. Raises `WorkerDiedError`; what pickling raises."""
        ...

    def close(self, at_once: bool) -> None:
        """See it leave. From any thread."""
        ...


def _together(schedule: Scheduler, hire: Callable[[], WorkerHandle], count: int) -> None:
    """All units on at most `count` workers. Raises what ended the run."""
    hired: list[WorkerHandle] = []

    def keep(make: Callable[[], WorkerHandle]) -> WorkerHandle:
        worker = make()
        hired.append(worker)
        if schedule.fault is not None:  # it came too late to be stopped with the others
            worker.close(True)
        return worker

    def lane() -> None:
        try:
            _lane(schedule, partial(keep, hire))
        except BaseException as fault:
            schedule.stop(fault)

    # Daemons: a thread that waits for a server must not keep the process alive after Ctrl-C.
    threads = [threading.Thread(target=lane, daemon=True) for _ in range(min(count, schedule.left))]
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if schedule.fault is not None:
            raise schedule.fault
    except BaseException as fault:
        schedule.stop(fault)
        raise
    finally:
        for worker in hired:
            worker.close(schedule.fault is not None)


def _lane(schedule: Scheduler, hire: Callable[[], WorkerHandle]) -> None:
    """The life of a worker and its successors: one unit after the other."""
    worker, group, stillborn = None, None, 0
    while (given := schedule.take(group)) is not None:
        unit, number = given
        group, began, ready = unit.group, time.perf_counter(), worker is not None
        try:
            worker = worker or hire()
            ready, stillborn = True, 0
            found = worker.do(unit.payload)
        except WorkerDiedError as died:
            worker = None
            stillborn += not ready
            if stillborn >= STARTS:
                raise WorkError(
                    f"{STARTS} workers in a row ended before they were ready ({died}); what they wrote to stderr says "
                    "why. Try workers=1"
                ) from None
            if not (ready and died.begun) or schedule.fault is not None:
                schedule.give_back(unit, number)
                continue
            seconds = round(time.perf_counter() - began, 3)
            found = {"error": f"the worker died in this unit ({died})", "seconds": seconds}
        schedule.end(unit, number, found)


class _Here:
    """This process, or a thread of it."""

    def __init__(self, do: Do) -> None:
        self._do = do

    def do(self, payload: Any) -> dict[str, Any]:
        return attempt(self._do, payload)

    def close(self, at_once: bool) -> None:
        pass


class _Process:
    """A process on this machine."""

    def __init__(self, work: str, config: dict[str, Any]) -> None:
        self._worker = Worker(_serve, work, config)
        self._ask()

    def do(self, payload: Any) -> dict[str, Any]:
        try:
            self._worker.send(payload)
        except WorkerEnded:
            raise WorkerDiedError(self._end(), begun=False) from None
        except Exception as error:
            return {"error": f"cannot be sent: {type(error).__name__}: {error}", "seconds": 0.0}
        return self._ask()

    def close(self, at_once: bool) -> None:
        self._worker.close(0.0 if at_once else PATIENCE)

    def _ask(self) -> Any:
        try:
            return self._worker.receive()
        except WorkerEnded:
            raise WorkerDiedError(self._end()) from None

    def _end(self) -> str:
        """See it end; how it did."""
        code = self._worker.close(PATIENCE)
        if code == -signal.SIGTERM:
            time.sleep(0.2)  # who ends a worker so ends us too, as a rule: then the unit has had no attempt
        return f"signal {-code}" if code < 0 else f"exit code {code}"


def _serve(line: Connection, work: str, config: dict[str, Any]) -> None:
    """The life of a worker process. Raises what ends the run."""
    with readable_lists():
        do = load(work, config)
    line.send(None)
    while True:
        line.send(attempt(do, line.recv()))


class _OnRay:
    """An actor somewhere on the cluster."""

    def __init__(self, ray: Any, actor: Any, work: str) -> None:
        self._ray, self._actor = ray, actor
        if (fault := self._ask(actor.ready.remote())) is not None:
            raise WorkError(fault)

    def do(self, payload: Any) -> dict[str, Any]:
        try:
            promise = self._actor.do.remote(payload)
        except Exception as error:
            return {"error": f"cannot be sent: {type(error).__name__}: {error}", "seconds": 0.0}
        return self._ask(promise)

    def close(self, at_once: bool) -> None:
        if at_once:
            self._ray.kill(self._actor)

    def _ask(self, promise: Any) -> Any:
        try:
            return self._ray.get(promise)
        except self._ray.exceptions.RayError as error:
            raise WorkerDiedError(type(error).__name__) from error


class _Actor:
    """The work, set up once, on some machine of the cluster."""

    def __init__(self, work: str, config: dict[str, Any]) -> None:
        self._fault = None
        try:
            self._do: Any = load(work, config)
        except Exception as error:
            self._fault = f"{type(error).__name__}: {error}"

    def ready(self) -> str | None:
        """None, or what is wrong."""
        return self._fault

    def do(self, payload: Any) -> dict[str, Any]:
        """As `attempt`."""
        return attempt(self._do, payload)


@contextmanager
def _cluster(address: str | None) -> Iterator[Any]:
    """Ray, connected; left as it was found. Raises `EagorError` where no cluster answers."""
    ray: Any = importlib.import_module("ray")  # optional: the name is found at run time
    if ray.is_initialized():  # the caller has joined a cluster
        yield ray
        return
    handler = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(address=address, log_to_driver=False, configure_logging=False)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise EagorError(
            f"no Ray cluster at {address or 'RAY_ADDRESS'} ({error}); start one with `ray start`"
        ) from error
    if threading.current_thread() is threading.main_thread() and handler is not None:
        signal.signal(signal.SIGTERM, handler)  # Ray has taken it
    try:
        yield ray
    finally:
        ray.shutdown()
