"""Carrying out a run: many units of work on one or several workers, each result kept the moment it is there.

What is recorded decides what is left to do. A unit that raises, or takes its process down, has had an attempt. What a
run is made of besides its settings (the data, files and models that these name, and this code) stands as digests in
run.json, so that nobody goes on with a run after something below it has changed.

On a Ray cluster each worker is an actor; its records come back and are kept by the process that began the run. An actor
or a machine that dies takes its unit's attempt with it. Ray takes over the signals of the process that talks to it, and
waits for a minute where one of its servers has gone. So that is a process of its own, the driver: it joins the cluster,
or begins one here, gives units to actors, and asks this process what is left to do. It has a session of its own, so
that all that Ray starts can be ended together, and a signal for the run ends none of Ray's servers.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import pickle
import re
import signal
import sys
import time
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal

import eagor
from eagor._extras import need
from eagor._processes import Worker, WorkerEnded
from eagor.errors import EagorError, FormatError
from eagor.evaluation import ledger
from eagor.evaluation.worker_pool import (
    Book,
    Lost,
    ProcessSeat,
    Seat,
    ThreadSeat,
    Unit,
    WorkError,
    attempt_unit,
    failure,
    head_of,
    load,
    work_together,
)
from eagor.tasks.models import release

__all__ = ["Engine", "Outcome", "Unit", "WorkError", "carry_out", "run_units"]

Engine = Literal["processes", "threads", "ray"]
"""Who the workers of a run are."""
LEFT_OUT = {"__pycache__", "static"}  # the studio's page is built anew at times; it decides no result
READ = (".json", ".jsonl", ".csv", ".tsv", ".txt")  # annotations: their content counts, of other files the size


@dataclass(frozen=True)
class Outcome:
    """How many units were done now, have failed for good, and had been done before. Together: all that were asked."""

    done: int
    failed: int
    skipped: int


def run_units(
    units: Sequence[Unit],
    work: str,
    config: dict[str, Any],
    folder: Path,
    workers: int = 1,
    attempts: int = 2,
    on_done: Callable[[dict[str, Any]], object] | None = None,
    retry_failed: bool = False,
    engine: Engine = "processes",
    address: str | None = None,
) -> Outcome:
    """Do all of `units` that `folder` has no result of, and record each as soon as it ends.

    `work` is ``"package.module:function"``: ``function(config)`` is called once per process and returns a callable,
    payload -> dict; the dict becomes the record, together with key, attempt, status and seconds. One worker works in
    this process (a unit that kills it ends the run, and has had no attempt); several are new `engine`s: processes with
    one BLAS thread each, threads, or Ray actors on the cluster at `address`. A unit has so many `attempts`, earlier
    runs included; `retry_failed` gives as many again. `on_done` gets the record of each unit that is finished, without
    its "methods" and "truth".

    Raises `EagorError` for two units of one key or a number below 1; `WorkError` if `work` cannot be set up, or workers
    die before they have begun; `StorageError` if the disk does not take the results. `KeyboardInterrupt` is passed on
    after the workers have been stopped.
    """
    if workers < 1 or attempts < 1:
        raise EagorError(f"got {workers} workers and {attempts} attempts; wanted at least 1 of each")
    book = Book(units, Path(folder), config.get("task"), attempts, retry_failed, on_done)
    if book.left:
        with book.ledger:
            if engine == "ray":
                work_on_ray(book, work, config, workers, address)
            elif workers == 1:
                _alone(book, work, config)
            elif engine == "threads":
                do = load(work, config)  # which they share
                work_together(book, lambda: ThreadSeat(do, book), workers)
            else:
                work_together(book, lambda: ProcessSeat(book, work, config), workers)
    return Outcome(book.done, book.failed, book.skipped)


def carry_out(
    units: Sequence[Unit],
    work: str,
    config: dict[str, Any],
    folder: Path,
    workers: int = 1,
    engine: Engine = "processes",
    force: bool = False,
    **how: Any,
) -> Outcome:
    """A whole run: `run_units`, which `how` is for as well, into the folder of the run that `config` describes.

    What was made to check `config` (a perception, a model) is released before workers make their own, and after the
    run. Raises as `run_units` and `eagor.evaluation.ledger.begin`.
    """
    ledger.begin(folder, config, inputs_of(config), force)
    if engine == "ray" or (engine == "processes" and workers > 1):
        release()
    try:
        return run_units(units, work, config, folder, workers, engine=engine, **how)
    finally:
        release()


def _alone(book: Book, work: str, config: dict[str, Any]) -> None:
    """All units, one after the other, in this process."""
    do, group = load(work, config), None
    while (found := book.next(group, set())) is not None:
        unit, attempt = found
        group = unit.group
        book.ended(unit, attempt_unit(do, unit, attempt, book.task, book.ledger.append))


def inputs_of(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Digests, by name: code, and what the settings data, perception, model and world name on this machine.

    Raises `FormatError` for what cannot be read.
    """
    found: dict[str, Any] = {"code": _code()}
    try:
        if settings.get("data"):
            found["data"] = _folder(Path(settings["data"]))
        for name in ("perception", "model", "world"):
            if places := list(_places(str(settings.get(name) or ""))):
                found[name] = " ".join(map(_contents, places))
        if settings.get("episodes_file"):
            found |= _episodes(Path(settings["episodes_file"]), settings)
    except OSError as error:
        raise FormatError(f"{error.filename} cannot be read ({error.strerror}); a run goes by what it holds") from error
    return found


def _episodes(file: Path, settings: Mapping[str, Any]) -> dict[str, str]:
    """Of the files that list episodes their content, of the scenes (gigabytes) names and sizes."""
    from eagor.tasks.episodes import listed_slots, scene_files

    scenes = Path(settings["scenes"]) if settings.get("scenes") else None
    slots = listed_slots(settings["task"], file, None, settings["world"], scenes)
    parts = [file, *sorted((file.parent / "content").glob("*.json.gz"))]
    there = [path for path in scene_files(slots) if path.is_file()]
    found = {"episodes_file": _digest(part for path in parts for part in (path.name.encode(), path))}
    if there:
        found["scenes"] = _digest(part for path in there for part in (path.name.encode(), *_sizes(path)))
    return found


def _places(text: str) -> Iterator[Path]:
    """The files and model folders that stand in an option such as ``replay:FILE`` or ``FOLDER?heads=FILE``.

    Their names may have in them what separates the parts of options: the longest that is there counts.
    """
    ends = [mark.start() for mark in re.finditer("[:?&=,@]", text)] + [len(text)]
    start = 0
    while start < len(text):
        for end in reversed([each for each in ends if each > start]):
            place = os.path.expanduser(text[start:end])
            if os.path.isfile(place) or os.path.isfile(os.path.join(place, "config.json")):
                yield Path(place)
                break
        else:
            end = min(each for each in ends if each >= start)
        start = end + 1


@lru_cache(maxsize=1)
def _code() -> str:
    """All of this package, weights included: its version alone does not tell one checkout from another."""
    home = Path(eagor.__file__).parent
    files = (
        path for path in sorted(home.rglob("*")) if path.is_file() and not LEFT_OUT & {*path.relative_to(home).parts}
    )
    return _digest(part for path in files for part in (_name(path, home), path))


def _contents(model: Path) -> str:
    """All of a model's file or folder, each byte of its weights: this may read gigabytes, once a run."""
    named = (part for path in _files(model) for part in (_name(path, model), path))
    return _digest(named if model.is_dir() else [model])


def _folder(data: Path) -> dict[str, Any]:
    """Of a folder (or one file): how many files, the content of annotations, names and sizes of all others."""
    annotations: list[bytes | Path] = []
    others: list[bytes | Path] = []
    for path in _files(data) if data.is_dir() else [data]:
        name = _name(path, data)
        if path.suffix.lower() in READ:
            annotations += [name, path]
        else:
            others += [name, b"".join(_sizes(path))]
    count = (len(annotations) + len(others)) // 2
    return {"files": count, "annotations": _digest(annotations), "sizes": _digest(others)}


def _files(data: Path) -> Iterator[Path]:
    """What belongs to the data: no hidden files, and no runs that were put there."""
    for place, folders, names in os.walk(data):
        here = Path(place)
        if here != data and "run.json" in names:
            folders.clear()
            continue
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        yield from (here / name for name in sorted(names) if not name.startswith(".") and (here / name).is_file())


def _sizes(path: Path) -> Iterator[bytes]:
    if path.suffix.lower() == ".zip":
        try:
            with zipfile.ZipFile(path) as archive:
                yield from (f"{item.filename} {item.file_size} {item.CRC};".encode() for item in archive.infolist())
            return
        except (zipfile.BadZipFile, ValueError, NotImplementedError):
            pass  # whoever wants to read it will say what is wrong
    yield str(path.stat().st_size).encode()


def _name(path: Path, home: Path) -> bytes:
    return path.relative_to(home).as_posix().encode("utf-8", "surrogateescape")


def _digest(parts: Iterable[bytes | Path]) -> str:
    """Of bytes and of what files hold, which is read a piece at a time."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, bytes):
            digest.update(f"{len(part)}:".encode() + part)
            continue
        with part.open("rb") as file:
            digest.update(f"{part.stat().st_size}:".encode())
            hashlib.file_digest(file, lambda: digest)
    return digest.hexdigest()[:16]


# --- on a Ray cluster: in the process that began the run --------------------------------------------------------------

PATIENCE = 2.0  # seconds that Ray has to end by itself (a cluster elsewhere hears of it)
RAY_STARTS = 3  # attempts
READY, OVER = "ready", "over"  # what the driver says, beside its questions


def work_on_ray(book: Book, work: str, config: dict[str, Any], count: int, address: str | None = None) -> None:
    """All units of `book` on at most `count` actors, one processor each, of the cluster at `address`.

    `work` and the files that `config` names have to be on every machine. Without an address: the cluster that this
    process has joined, RAY_ADDRESS, else this machine alone. Raises as `run_units`, and
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


# --- in the driver ----------------------------------------------------------------------------------------------------


def _drive(line: Connection, work: str, config: dict[str, Any], count: int, address: str | None, task: Any) -> None:
    """The life of the driver: do all units. Raises what ends the run."""
    os.setsid()
    try:
        ray: Any = importlib.import_module("ray")  # optional: the name is found at run time
        try:
            _started(ray, address)
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


def _started(ray: Any, address: str | None) -> None:
    """Ray, or what it raises. It gives its own processes thirty seconds, which a busy machine may exceed."""
    for left in reversed(range(RAY_STARTS)):
        try:
            ray.init(address=address, log_to_driver=False, configure_logging=False)
            return
        except Exception as error:
            if not left or "timed out during startup" not in str(error):
                raise
            ray.shutdown()


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


# --- on the cluster ---------------------------------------------------------------------------------------------------


class _Actor:
    """The work, set up once. Each attempt gives one record."""

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
        attempt_unit(self._do, unit, attempt, self._task, self._keep)
        return self._record

    def _keep(self, record: Mapping[str, Any]) -> None:
        """Take the record. Raises `EagorError` for one that cannot be written."""
        ledger.as_line(record)
        self._record = dict(record)
