"""Carrying out a run: many units of work on one or several workers, one writer, each result kept when it is there.

What is recorded decides what is left to do. A unit that raises, or takes its process down, has had an attempt. Workers
are processes here, threads (for work that waits for servers), or actors on a Ray cluster. Not the pools of
concurrent.futures: they break as a whole when one worker dies, and do not tell whose unit that was. Nor pebble's: units
of one group belong to one worker, which has its apartment already.
"""

from __future__ import annotations

import hashlib
import importlib
import signal
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import repeat
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
Result = tuple[str, Record]  # of an attempt: its status, and what to record


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
    on_done: Callable[[Record], object] = lambda record: None,
    retry_failed: bool = False,
    engine: Engine = "processes",
) -> Outcome:
    """Do all of `units` that `folder` has no result of, and record each as soon as it ends. `config`: of the run.

    `work` is ``"package.module:function"``: ``function(config)`` is called once per worker and returns a callable,
    payload -> dict; the dict becomes the record, together with key, task, attempt, status and seconds. One worker works
    in this process (a unit that kills it ends the run, and has had no attempt); several are new processes with one BLAS
    thread each, threads, or actors of a Ray cluster (that of RAY_ADDRESS, else this machine; `work` and the files
    that `config` names have to be on every machine). A unit has so many `attempts`, earlier runs included;
    `retry_failed` gives as many again. `on_done` gets the record of each unit that is finished, without its "methods"
    and "truth".

    Raises `EagorError` for two units of one key, a number below 1, a folder that holds another run or is being written
    to, a missing extra, or no cluster; `WorkError` if `work` cannot be set up, or workers die before they have begun;
    `StorageError` if the disk does not take the results. `KeyboardInterrupt` is passed on after the workers have been
    stopped.
    """
    if workers < 1 or attempts < 1:
        raise EagorError(f"got {workers} workers and {attempts} attempts; wanted at least 1 of each")
    samples, done, failed = repr(sorted((unit.key, repr(unit.payload)) for unit in units)), 0, 0
    with ExitStack() as stack:
        book = stack.enter_context(log.Log(folder))
        digest = hashlib.sha256(samples.encode("utf-8", "surrogatepass")).hexdigest()[:16]
        book.begin(config, {"count": len(units), "digest": digest})
        before = {record["key"]: (record["attempt"], record["status"]) for record in log.read(folder)}
        queue = Queue(units, before, attempts, retry_failed)
        stack.callback(release)
        if queue.left and engine == "ray":
            need("--engine ray (the same version on all machines)", "ray", "ray")
            stack.enter_context(_cluster())
        alone = not queue.left or (workers == 1 and engine != "ray")
        if not alone and engine != "threads":
            release()  # the workers make their own
        hire: Any = partial(_OnRay if engine == "ray" else _Here if alone else _Process, work, dict(config))
        if engine == "threads" and not alone:
            hire = repeat(_Here(work, dict(config))).__next__  # they share one
        results = _lane(queue, hire) if alone else _together(queue, hire, min(workers, queue.left))
        stack.enter_context(closing(results))
        for unit, number, final, (status, body), seconds in results:
            task = body.get("task", config.get("task"))
            head = {"key": unit.key, "task": task, "attempt": number, "status": status, "seconds": seconds}
            record = {**head, **body, **head}  # the head stands first, and what the work says changes none of it
            book.append(record)
            if final:
                done, failed = done + (status == "ok"), failed + (status == "failed")
                on_done({name: record[name] for name in record if name not in ("methods", "truth")})
    return Outcome(done, queue.failed + failed, queue.skipped)


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


class Queue:
    """The units that are left, by group, each with the numbers of the attempts that it may have. Threads share it.

    `failed`, `skipped`: how many have no attempt left, and how many have a result. Raises `EagorError`.
    """

    def __init__(
        self, units: Sequence[Unit], before: Mapping[str, tuple[int, str]], attempts: int, retry_failed: bool = False
    ) -> None:
        self.left = self.failed = self.skipped = 0
        self._groups: dict[str, deque[tuple[Unit, range]]] = {}
        self._workers: Counter[str | None] = Counter()  # at each group
        self._lock, self.closed = threading.Lock(), False
        keys = Counter(unit.key for unit in units)
        if twice := next((key for key, count in keys.items() if count > 1), None):
            raise EagorError(f"the key {twice!r} is given to two units; each needs one of its own")
        for unit in units:
            tried, status = before.get(unit.key, (0, "new"))
            if status == "ok":
                self.skipped += 1
            elif tried >= attempts and not retry_failed:
                self.failed += 1
            else:
                self.left += 1
                last = tried + attempts if tried >= attempts else attempts
                self._groups.setdefault(unit.group, deque()).append((unit, range(tried + 1, last + 1)))

    def take(self, group: str | None = None) -> tuple[Unit, range] | None:
        """The next unit and its attempts for a worker that has just done one of `group`; None where there is none.

        Its own group first, then one that no other worker is at, then help with the longest.
        """
        with self._lock:
            waiting = [name for name, units in self._groups.items() if units]
            if self.closed or not waiting:
                return None
            self._workers[group] -= 1
            if group not in waiting:
                free = [name for name in waiting if self._workers[name] <= 0]
                group = free[0] if free else max(waiting, key=lambda name: len(self._groups[name]))
            self._workers[group] += 1
            self.left -= 1
            return self._groups[group].popleft()


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
    try:
        body = do(payload)
        if not isinstance(body, Mapping):
            raise EagorError(f"the work returned a {type(body).__name__}; wanted a dict")
        return "ok", log.as_plain(body, "the record")
    except StorageError:
        raise
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        if not isinstance(error, EagorError):  # whoever wrote the plugin wants to know where
            last = traceback.extract_tb(error.__traceback__)[-1]
            text = f"{text[: LONGEST_ERROR - 100]} ({Path(last.filename).name}:{last.lineno})"
        return "failed", {"error": text[:LONGEST_ERROR]}


# --- workers ----------------------------------------------------------------------------------------------------------


class WorkerDiedError(Exception):
    """The worker has died."""


class _Here:
    """This process, or threads of it.

    As every worker: making one raises `WorkerDiedError` if it dies, `EagorError` if it cannot work.
    """

    def __init__(self, work: str, config: dict[str, Any]) -> None:
        self._do = load(work, config)

    def do(self, payload: Any) -> Result:
        """As `attempt`. Raises `WorkerDiedError`; what pickling raises."""
        return attempt(self._do, payload)

    def close(self, patience: float) -> object:
        """See it leave within so many seconds. From any thread."""


class _Process:
    """A process on this machine."""

    def __init__(self, work: str, config: dict[str, Any]) -> None:
        self._worker = Worker(_serve, work, config)
        self.close = self._worker.close
        self._answer()

    def do(self, payload: Any) -> Result:
        with suppress(WorkerEnded):  # the answer says how
            self._worker.send(payload)
        return self._answer()

    def _answer(self) -> Any:
        try:
            return self._worker.receive()
        except WorkerEnded:
            code = self._worker.close(PATIENCE)
            if code == -signal.SIGTERM:
                time.sleep(2.0)  # who ends a worker so ends us too, as a rule: then the unit has had no attempt
            raise WorkerDiedError(f"signal {-code}" if code < 0 else f"exit code {code}") from None


def _serve(line: Connection, work: str, config: dict[str, Any]) -> None:
    """The life of a worker process. Raises what ends the run."""
    with readable_lists():
        do = load(work, config)
    line.send(None)
    while True:
        line.send(attempt(do, line.recv()))


class _OnRay:
    """An actor somewhere on the cluster, which has a `_Here` of its own."""

    def __init__(self, work: str, config: dict[str, Any]) -> None:
        self._ray: Any = importlib.import_module("ray")
        self._actor = self._ray.remote(num_cpus=1, max_restarts=0)(_Here).remote(work, config)
        self._answer(self._actor.__ray_ready__.remote())

    def do(self, payload: Any) -> Result:
        return self._answer(self._actor.do.remote(payload))

    def close(self, patience: float) -> None:
        if not patience:
            self._ray.kill(self._actor)

    def _answer(self, promise: Any) -> Any:
        try:
            return self._ray.get(promise)
        except self._ray.exceptions.RayTaskError as error:  # it lives, and raised this
            raise error.cause from None
        except self._ray.exceptions.RayError as error:
            raise WorkerDiedError(type(error).__name__) from error


def _lane(queue: Queue, hire: Callable[[], Any]) -> Generator[tuple[Any, ...], None, None]:
    """What comes of the units that one worker and its successors take.

    Of each attempt: the unit, its number, whether it is the last, the result, the seconds.
    """
    worker = group = None
    while (taken := queue.take(group)) is not None:
        unit, numbers = taken
        group = unit.group
        for number in numbers:
            worker = worker or _ready(hire)
            began = time.perf_counter()
            try:
                result = worker.do(unit.payload)
            except EagorError:
                raise
            except WorkerDiedError as died:
                worker, result = None, ("failed", {"error": f"the worker died in this unit ({died})"})
            except Exception as error:
                result = "failed", {"error": f"cannot be sent: {type(error).__name__}: {error}"}
            final = result[0] == "ok" or number == numbers[-1]
            yield unit, number, final, result, round(time.perf_counter() - began, 3)
            if final:
                break


def _ready(hire: Callable[[], Any]) -> Any:
    """A worker; another one if it dies before it is ready. Raises `WorkError` where several do."""
    died = None
    for _ in range(STARTS):
        try:
            return hire()
        except WorkerDiedError as error:
            died = error
    raise WorkError(
        f"{STARTS} workers in a row ended before they were ready ({died}); what they wrote to stderr says why. Try "
        "workers=1"
    )


def _together(queue: Queue, hire: Callable[[], Any], count: int) -> Generator[tuple[Any, ...], None, None]:
    """What comes of all units on so many workers, each with a thread that talks with it. Raises what ended the run."""
    answers: SimpleQueue[Any] = SimpleQueue()
    team: list[Any] = []

    def hired() -> Any:
        if queue.closed:  # it died with the run
            raise WorkerDiedError("the run has ended")
        team.append(worker := hire())
        if queue.closed:  # it came too late to be closed with the others
            worker.close(0.0)
        return worker

    def talk() -> None:
        try:
            for answer in _lane(queue, hired):
                answers.put(answer)
            answers.put(None)
        except BaseException as fault:
            answers.put(fault)

    for _ in range(count):
        # Daemons: a thread that waits for a server must not keep the process alive after Ctrl-C.
        threading.Thread(target=talk, daemon=True).start()
    try:
        while count:
            answer = answers.get()
            if isinstance(answer, BaseException):
                raise answer
            if answer is None:
                count -= 1
            else:
                yield answer
    finally:
        queue.closed = True
        for worker in team:
            worker.close(PATIENCE if not count else 0.0)


@contextmanager
def _cluster() -> Iterator[None]:
    """With Ray connected; it is left as it was found. Raises `EagorError` where no cluster answers."""
    ray: Any = importlib.import_module("ray")  # optional: the name is found at run time
    if ray.is_initialized():  # the caller has joined a cluster
        yield
        return
    handler = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(log_to_driver=False, configure_logging=False)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise EagorError(f"no Ray cluster at RAY_ADDRESS ({error}); start one with `ray start`") from error
    if threading.current_thread() is threading.main_thread() and handler is not None:
        signal.signal(signal.SIGTERM, handler)  # Ray has taken it
    try:
        yield
    finally:
        ray.shutdown()
