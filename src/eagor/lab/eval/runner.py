"""Carrying out a run: many samples on one or several workers, one writer, each result kept when it is there.

What is recorded decides what is left to do. A sample that raises, or takes its process down, has had an attempt. Not
the pools of concurrent.futures: they break as a whole when one worker dies, and do not tell whose sample that was. Nor
pebble's: samples of one group belong to one worker, which has its apartment already.
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
from functools import partial
from itertools import count, repeat
from multiprocessing.connection import Connection
from pathlib import Path
from pkgutil import resolve_name
from queue import SimpleQueue
from typing import Any, Literal, NamedTuple

from eagor._extras import require_extra
from eagor._processes import Worker, WorkerEnded
from eagor.errors import EagorError, StorageError, WorkError
from eagor.lab.agents.models import release
from eagor.lab.eval import log
from eagor.lab.tasks.task import Sample, Task
from eagor.plugins import readable_lists

ATTEMPTS = 2  # at a sample, earlier runs included; as many again where failed ones are retried
LONGEST_ERROR = 2000  # characters of an error's text that are kept
STARTS = 3  # so many workers in a row that die before they are ready mean that none ever will be
PATIENCE = 3.0  # seconds that a worker has to leave by itself

Record = dict[str, Any]
Result = tuple[str, Record]  # of an attempt: its status, and what to record


class Outcome(NamedTuple):
    """How many samples were done now, have failed for good, and had been done before. Together: all."""

    done: int
    failed: int
    skipped: int


def run(
    samples: Sequence[Sample],
    work: str,
    config: Mapping[str, Any],
    folder: Path,
    workers: int = 1,
    on_done: Callable[[Record], object] = lambda record: None,
    retry_failed: bool = False,
    engine: Literal["processes", "threads", "ray"] = "processes",
) -> Outcome:
    """Do all of `samples` that `folder` has no result of, and record each as soon as it ends. `config`: of the run.

    `work` is ``"package.module:function"``: ``function(config)`` is called once per worker and returns a callable,
    payload -> dict; the dict becomes the record, together with key (task and sample), task, attempt, status and
    seconds. Samples of one group go to one worker as long as there are others to give. One worker works in this process
    (what kills it ends the run, and was no attempt); several are new processes with one BLAS thread each, threads (for
    work that waits for servers), or actors of a Ray cluster (that of RAY_ADDRESS, else this machine; `work` and the
    files that `config` names have to be on every machine). `retry_failed` gives samples that have failed as many
    attempts again. `on_done` gets the record of each that is finished, without its "methods" and "truth".

    Raises `EagorError` for two samples of one id, no worker, a folder that holds another run or is being written to, a
    missing extra, or no cluster; `WorkError` if `work` cannot be set up, or workers die before they have begun;
    `StorageError` if the disk does not take the results; `KeyboardInterrupt` after the workers have been stopped.
    """
    if workers < 1:
        raise EagorError(f"got {workers} workers; wanted at least 1")
    given = repr(sorted((f"{config['task']}/{each.id}", repr(each.payload)) for each in samples))
    digest = hashlib.sha256(given.encode("utf-8", "surrogatepass")).hexdigest()[:16]
    with ExitStack() as stack:
        book = stack.enter_context(log.Log(folder))
        book.begin(config, {"count": len(samples), "digest": digest})
        queue = Queue(config["task"], samples, log.read(folder), retry_failed)
        if not queue.groups:
            return Outcome(0, queue.failed, queue.skipped)
        stack.callback(release)
        kind = {"threads": _Here, "processes": _Here if workers == 1 else _Process, "ray": _OnRay}[engine]
        if engine == "ray":
            require_extra("--engine ray (the same version on all machines)", "ray", "ray")
            stack.enter_context(_cluster())
        if kind is not _Here:
            release()  # the workers make their own
        hire: Any = partial(kind, work, dict(config))
        if engine == "threads":
            hire = repeat(hire()).__next__  # they share one
        alone = workers == 1 and engine != "ray"
        results = _lane(queue, hire, []) if alone else _together(queue, hire, workers)
        stack.enter_context(closing(results))
        ended = Counter[str]()
        for record, final in results:
            record["task"] = config["task"]
            book.append(record)
            if final:
                ended[record["status"]] += 1
                on_done({name: record[name] for name in record if name not in ("methods", "truth")})
    return Outcome(ended["ok"], queue.failed + ended["failed"], queue.skipped)


def samples_of(task: Task, config: Any, limit: int | None = None, shard: tuple[int, int] = (1, 1)) -> list[Sample]:
    """The samples of a run. `limit`: only the first so many; `shard`: (i, n), every n-th from the i-th on.

    Neither changes what a sample is called, so any parts of a run fit into one folder. Raises `EagorError`.
    """
    part, parts = shard
    if not 1 <= part <= parts:
        raise EagorError(f"shard {part}/{parts}; wanted i/n with 1 <= i <= n, such as 1/4")
    if limit is not None and limit < 1:
        raise EagorError(f"a limit of {limit} samples; wanted 1 or more")
    return task.samples(config)[:limit][part - 1 :: parts]


class Queue:
    """The samples that are left, by group, each with its key and the number of its next attempt. Threads share it.

    `failed`, `skipped`: how many have no attempt left, and how many have a result, by the `records` of earlier runs.
    Raises `EagorError` for two samples of one id.
    """

    def __init__(self, task: str, samples: Sequence[Sample], records: Sequence[Record], retry_failed: bool) -> None:
        self.failed = self.skipped = 0
        self.groups: dict[str, deque[tuple[str, Sample, int]]] = {}
        self.closed, self._lock = False, threading.Lock()
        before = {record["key"]: (record["attempt"], record["status"]) for record in records}
        if twice := [key for key, count in Counter(sample.id for sample in samples).items() if count > 1]:
            raise EagorError(f"the id {twice[0]!r} is given to two samples; each needs one of its own")
        for sample in samples:
            tried, status = before.get(key := f"{task}/{sample.id}", (0, "new"))
            if status == "ok":
                self.skipped += 1
            elif tried and tried % ATTEMPTS == 0 and not retry_failed:
                self.failed += 1
            else:
                self.groups.setdefault(sample.group, deque()).append((key, sample, tried + 1))

    def take(self, group: str | None = None) -> tuple[str, Sample, int] | None:
        """The next one for a worker that has just done one of `group`; None where there is none.

        Its own group first, then the one that has waited longest: one that no other worker is at, if there is any.
        """
        with self._lock:
            if self.closed or not self.groups:
                return None
            waiting = self.groups.pop(name := group if group in self.groups else next(iter(self.groups)))
            taken = waiting.popleft()
            if waiting:
                self.groups[name] = waiting  # at the end
            return taken


class WorkerDiedError(Exception):
    """The worker has died."""


class _Here:
    """This process, or threads of it.

    As every worker: making one raises `WorkerDiedError` if it dies, `EagorError` if it cannot work.
    """

    def __init__(self, work: str, config: dict[str, Any]) -> None:
        try:
            self._do = resolve_name(work)(config)
        except EagorError:
            raise
        except Exception as error:
            raise WorkError(
                f"{work} cannot be set up: {type(error).__name__}: {error}; wanted 'package.module:function'"
            ) from error

    def do(self, payload: Any) -> Result:
        """What came of it. Raises `WorkerDiedError`; `StorageError`: no other sample would fare better."""
        try:
            return "ok", log.as_plain(dict(self._do(payload)), "the record")
        except StorageError:
            raise
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            if not isinstance(error, EagorError):  # whoever wrote the plugin wants to know where
                last = traceback.extract_tb(error.__traceback__)[-1]
                text = f"{text[: LONGEST_ERROR - 100]} ({Path(last.filename).name}:{last.lineno})"
            return "failed", {"error": text[:LONGEST_ERROR]}

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
        here = _Here(work, config)
    line.send(None)
    while True:
        line.send(here.do(line.recv()))


class _OnRay(_Here):
    """An actor somewhere on the cluster, which is a `_Here` there, and leaves with the last that knows of it."""

    def __init__(self, work: str, config: dict[str, Any]) -> None:
        self._ray: Any = importlib.import_module("ray")
        self._actor = self._ray.remote(num_cpus=1, max_restarts=0)(_Here).remote(work, config)
        self._answer(self._actor.__ray_ready__)

    def do(self, payload: Any) -> Result:
        return self._answer(self._actor.do, payload)

    def _answer(self, method: Any, *arguments: Any) -> Any:
        try:
            return self._ray.get(method.remote(*arguments))
        except self._ray.exceptions.RayTaskError as error:  # it lives, and raised this
            raise error.cause from None
        except self._ray.exceptions.RayError as error:
            raise WorkerDiedError(type(error).__name__) from error


@contextmanager
def _cluster() -> Iterator[None]:
    """With Ray connected; it is left as it was found. Raises `EagorError` where no cluster answers."""
    ray: Any = importlib.import_module("ray")  # optional: the name is found at run time
    joined, handler = ray.is_initialized(), signal.getsignal(signal.SIGTERM)
    try:
        if not joined:
            ray.init(log_to_driver=False, configure_logging=False)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise EagorError(f"no Ray cluster at RAY_ADDRESS ({error}); start one with `ray start`") from error
    except SystemExit:  # Ray, which has taken SIGTERM, was told to end
        if callable(handler):
            handler(signal.SIGTERM, None)
        raise
    if threading.current_thread() is threading.main_thread() and handler is not None:
        signal.signal(signal.SIGTERM, handler)  # Ray has taken it
    try:
        yield
    finally:
        if not joined:
            ray.shutdown()


def _lane(queue: Queue, hire: Callable[[], Any], team: list[Any]) -> Generator[tuple[Record, bool], None, None]:
    """The records of the attempts at the samples that one worker and its successors take, and whether it is the last.

    Workers join the `team`. Raises `WorkError` where `STARTS` workers in a row die before they are ready.
    """
    worker, group, starts = None, None, 0
    while (taken := queue.take(group)) is not None:
        key, sample, first = taken
        group = sample.group
        for number in count(first):
            while worker is None and not queue.closed:
                try:
                    team.append(worker := hire())
                    starts = 0
                except WorkerDiedError as died:
                    if (starts := starts + 1) == STARTS:
                        raise WorkError(
                            f"{STARTS} workers in a row ended before they were ready ({died}); what they wrote to "
                            "stderr says why. Try workers=1"
                        ) from died
            if queue.closed or worker is None:  # the worker may have come too late to be closed with the others
                return worker.close(0.0) if worker else None
            began = time.perf_counter()
            try:
                status, body = worker.do(sample.payload)
            except WorkerDiedError as died:
                worker, status, body = None, "failed", {"error": f"the worker died in this unit ({died})"}
            seconds = round(time.perf_counter() - began, 3)
            head = {"key": key, "task": None, "attempt": number, "status": status, "seconds": seconds}
            final = status == "ok" or number % ATTEMPTS == 0
            yield {**head, **body, **head}, final  # the head stands first, and what the work says changes none of it
            if final:
                break


def _together(queue: Queue, hire: Callable[[], Any], workers: int) -> Generator[tuple[Record, bool], None, None]:
    """What comes of all samples on so many workers, each with a thread of its own. Raises what ended the run."""
    answers: SimpleQueue[Any] = SimpleQueue()
    team: list[Any] = []

    def talk() -> None:
        try:
            for answer in _lane(queue, hire, team):
                answers.put(answer)
            answers.put(None)
        except BaseException as fault:
            answers.put(fault)

    for _ in range(workers):
        # Daemons: a thread that waits for a server must not keep the process alive after Ctrl-C.
        threading.Thread(target=talk, daemon=True).start()
    try:
        while workers:
            answer = answers.get()
            if isinstance(answer, BaseException):
                raise answer
            if answer is None:
                workers -= 1
            else:
                yield answer
    finally:
        queue.closed = True
        for worker in team:
            worker.close(0.0 if workers else PATIENCE)
