"""Carrying out a run: many units of work on one or several workers, one writer, each result kept when it is there.

What is recorded decides what is left to do. A unit that raises, or takes its process down, has had an attempt. Workers
are processes here, threads (for work that waits for servers), or actors on a Ray cluster; each has a thread of this
process that talks with it, so all three are run by one loop, which alone decides and writes. Not the pools of
concurrent.futures: they break as a whole when one worker dies, and do not tell whose unit that was.
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
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Literal

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
Result = tuple[str, float, Record]  # of an attempt: the status, the seconds, and what to record


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
                    _together(schedule, lambda: _OnRay(ray, work, dict(config)), workers)
            elif schedule.left and workers == 1:
                do, group = load(work, config), None
                while schedule.left:
                    unit, number = schedule.take(group, ())
                    group = unit.group
                    schedule.end(unit, number, *attempt(do, unit.payload))
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
    """What is left to do, by group; how often it was tried; what came of it."""

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
        self._task, self._keep, self._on_done = task, keep, on_done
        self._queues: dict[str, deque[tuple[Unit, int]]] = {}
        self._last: dict[str, int] = {}  # the number of the last attempt that each unit may have
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

    def take(self, group: str | None, busy: Collection[str]) -> tuple[Unit, int]:
        """The next of the units that wait, and its attempt, for a worker that has just done one of `group`.

        Its own group first, then one that no other worker is at (`busy` ones are), then help with the longest.
        """
        waiting = [name for name, queue in self._queues.items() if queue]
        if group not in waiting:
            free = [name for name in waiting if name not in busy]
            group = free[0] if free else max(waiting, key=lambda name: len(self._queues[name]))
        return self._queues[group].popleft()

    def end(self, unit: Unit, attempt: int, status: str, seconds: float, body: Record) -> None:
        """Record what came of an attempt. Raises `StorageError`."""
        try:
            record = self._record(unit, attempt, status, seconds, body)
        except StorageError:
            raise
        except EagorError as error:  # JSON cannot hold it
            record = self._record(unit, attempt, "failed", seconds, {"error": f"{type(error).__name__}: {error}"})
        if record["status"] == "failed" and attempt < self._last[unit.key]:
            self._queues[unit.group].append((unit, attempt + 1))
            return
        self.done += record["status"] == "ok"
        self.failed += record["status"] == "failed"
        if self._on_done is not None:
            self._on_done({name: value for name, value in record.items() if name not in ("methods", "truth")})

    def _record(self, unit: Unit, attempt: int, status: str, seconds: float, body: Record) -> Record:
        task = body.get("task", self._task)
        if status == "failed":
            body = body | {"error": body["error"][:LONGEST_ERROR]}
        head = {"key": unit.key, "task": task, "attempt": attempt, "status": status, "seconds": seconds}
        record = {**head, **body, **head}  # the head stands first, and what the work says changes none of it
        self._keep(record)
        return record


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


def attempt(do: Do, payload: Any) -> Result:
    """What came of doing `payload`. Raises `StorageError`: no other unit would fare better."""
    began, status = time.perf_counter(), "ok"
    try:
        body = do(payload)
        if not isinstance(body, Mapping):
            raise EagorError(f"the work returned a {type(body).__name__}; wanted a dict")
    except StorageError:
        raise
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        if not isinstance(error, EagorError):  # whoever wrote the plugin wants to know where
            last = traceback.extract_tb(error.__traceback__)[-1]
            text = f"{text[: LONGEST_ERROR - 100]} ({Path(last.filename).name}:{last.lineno})"
        status, body = "failed", {"error": text}
    return status, round(time.perf_counter() - began, 3), dict(body)


# --- workers, and the thread that talks with each ---------------------------------------------------------------------


class WorkerDiedError(Exception):
    """The worker has died."""


class _Here:
    """This process, or a thread of it.

    As every worker: making one raises `WorkerDiedError` if it dies, `EagorError` if it cannot work. `alive`: False if
    it is known to have died while it waited.
    """

    alive = True

    def __init__(self, do: Do) -> None:
        self._do = do

    def do(self, payload: Any) -> Result:
        """As `attempt`. Raises `WorkerDiedError`; what pickling raises."""
        return attempt(self._do, payload)

    def close(self, at_once: bool) -> None:
        """See it leave. From any thread."""


class _Process:
    """A process on this machine."""

    def __init__(self, work: str, config: dict[str, Any]) -> None:
        self._worker = Worker(_serve, work, config)
        self._answer()

    def do(self, payload: Any) -> Result:
        with suppress(WorkerEnded):  # the answer says how
            self._worker.send(payload)
        return self._answer()

    @property
    def alive(self) -> bool:
        return self._worker.alive

    def close(self, at_once: bool) -> None:
        self._worker.close(0.0 if at_once else PATIENCE)

    def _answer(self) -> Any:
        try:
            return self._worker.receive()
        except WorkerEnded:
            code = self._worker.close(PATIENCE)
            if code == -signal.SIGTERM:
                time.sleep(0.2)  # who ends a worker so ends us too, as a rule: then the unit has had no attempt
            raise WorkerDiedError(f"signal {-code}" if code < 0 else f"exit code {code}") from None


def _serve(line: Connection, work: str, config: dict[str, Any]) -> None:
    """The life of a worker process. Raises what ends the run."""
    with readable_lists():
        do = load(work, config)
    line.send(None)
    while True:
        line.send(attempt(do, line.recv()))


class _OnRay:
    """An actor somewhere on the cluster."""

    alive = True  # as far as anybody knows before it is asked

    def __init__(self, ray: Any, work: str, config: dict[str, Any]) -> None:
        self._ray, self._actor = ray, ray.remote(num_cpus=1, max_restarts=0)(_Actor).remote()
        self._answer(self._actor.load.remote(work, config))

    def do(self, payload: Any) -> Result:
        return self._answer(self._actor.do.remote(payload))

    def close(self, at_once: bool) -> None:
        if at_once:
            self._ray.kill(self._actor)

    def _answer(self, promise: Any) -> Any:
        try:
            return self._ray.get(promise)
        except self._ray.exceptions.RayTaskError as error:  # it lives, and raised this
            raise error.cause from None
        except self._ray.exceptions.RayError as error:
            raise WorkerDiedError(type(error).__name__) from error


class _Actor:
    """The work, set up once, on some machine of the cluster."""

    def load(self, work: str, config: dict[str, Any]) -> None:
        self._do = load(work, config)

    def do(self, payload: Any) -> Result:
        return attempt(self._do, payload)


Hire = Callable[[], _Here | _Process | _OnRay]


class _Lane:
    """A worker and its successors, and the thread that talks with them.

    It gives each payload that is put `into` it to the worker, and puts itself and the `Result` into `answers`, or what
    ends the run.
    """

    def __init__(self, hire: Hire, answers: SimpleQueue[tuple[_Lane, Any]]) -> None:
        self.group: str | None = None
        self.into: SimpleQueue[Any] = SimpleQueue()
        self._worker: Any = None
        self._closed = False
        # A daemon: a thread that waits for a server must not keep the process alive after Ctrl-C.
        threading.Thread(target=self._talk, args=(hire, answers), daemon=True).start()

    def close(self, at_once: bool) -> None:
        """See the worker leave."""
        self._closed = True
        self.into.put(None)
        if self._worker is not None:
            self._worker.close(at_once)

    def _talk(self, hire: Hire, answers: SimpleQueue[tuple[_Lane, Any]]) -> None:
        while not self._closed:
            payload = self.into.get()
            if not self._closed:
                try:
                    answers.put((self, self._attempt(hire, payload)))
                except BaseException as fault:
                    answers.put((self, fault))

    def _attempt(self, hire: Hire, payload: Any) -> Result:
        if self._worker is not None and not self._worker.alive:  # no unit's fault
            self._worker.close(True)
            self._worker = None
        if self._worker is None:
            self._worker = self._ready(hire)
            if self._closed:  # it came too late to be closed with the others
                self._worker.close(True)
        began = time.perf_counter()
        try:
            return self._worker.do(payload)
        except EagorError:
            raise
        except WorkerDiedError as died:
            self._worker = None
            error = f"the worker died in this unit ({died})"
            return "failed", round(time.perf_counter() - began, 3), {"error": error}
        except Exception as error:
            return "failed", 0.0, {"error": f"cannot be sent: {type(error).__name__}: {error}"}

    def _ready(self, hire: Hire) -> _Here | _Process | _OnRay:
        """A worker; another one if it dies before it is ready. Raises `WorkError` where several do."""
        died = None
        for _ in range(STARTS):
            try:
                return hire()
            except WorkerDiedError as error:
                died = error
            if self._closed:  # it was ended with the run
                break
        raise WorkError(
            f"{STARTS} workers in a row ended before they were ready ({died}); what they wrote to stderr says why. Try "
            "workers=1"
        )


def _together(schedule: Scheduler, hire: Hire, count: int) -> None:
    """All units on at most `count` workers. Raises what ended the run."""
    answers: SimpleQueue[tuple[_Lane, Any]] = SimpleQueue()
    lanes = [_Lane(hire, answers) for _ in range(min(count, schedule.left))]
    idle, busy = list(lanes), {}
    fine = False
    try:
        while schedule.left or busy:
            while idle and schedule.left:
                lane = idle.pop()
                unit, number = schedule.take(lane.group, [unit.group for unit, _ in busy.values()])
                lane.group, busy[lane] = unit.group, (unit, number)
                lane.into.put(unit.payload)
            lane, answer = answers.get()
            if isinstance(answer, BaseException):
                raise answer
            schedule.end(*busy.pop(lane), *answer)
            idle.append(lane)
        fine = True
    finally:
        for lane in lanes:
            lane.close(at_once=not fine)


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
