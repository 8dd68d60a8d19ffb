"""Processes of our own: they end with their parent, leave Ctrl-C to it, and start with one BLAS thread."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from pkgutil import resolve_name
from types import ModuleType
from typing import Any, NamedTuple

from eagor.errors import EagorError

__all__ = ["Worker", "WorkerEnded", "WorkerSilent", "of_script"]

THREADS = *(f"{name}_NUM_THREADS" for name in ("OPENBLAS", "OMP", "MKL", "NUMEXPR")), "VECLIB_MAXIMUM_THREADS"
_START = threading.Lock()  # the environment is that of all threads


class WorkerEnded(Exception):
    """Nothing can be said to a worker, or heard from it, any more: it has ended, or its line was closed here."""


class WorkerSilent(Exception):
    """A worker has said nothing for as long as it may."""


class Worker:
    """A new process (spawn: it inherits no threads, locks or open files) that talks with this one over a `line`.

    It calls ``serve(line, *arguments)``; `serve` may be named as ``"package.module:function"``, which is then imported
    in that process alone. It ends when that returns, which it should when reading the line raises EOFError: then this
    process has closed it, or is gone. An `EagorError` there is its last word, and raised here by `receive`. Ctrl-C is
    left to this process, and it never outlives it, however that ends. It imports the script that was started only where
    the arguments need it, so that a script without ``if __name__ == "__main__"`` does not run again there.

    `parent`: whether it starts processes itself. Such a worker has to be closed before this process can end.

    Raises what pickling the arguments raises, and `OSError` if the system has no more processes.
    """

    def __init__(
        self, serve: Callable[..., object] | str, *arguments: Any, name: str | None = None, parent: bool = False
    ) -> None:
        context, work = multiprocessing.get_context("spawn"), bytes(ForkingPickler.dumps((serve, arguments)))
        self.line, there = context.Pipe()
        self._closing = threading.Lock()
        self.process = context.Process(target=_live, args=(there, work), name=name, daemon=not parent)
        try:
            with _START, _starting(with_script=of_script(work)):
                self.process.start()
        except BaseException:
            self.line.close()
            raise
        finally:
            there.close()  # so that the line ends when the process does

    @property
    def alive(self) -> bool:
        """Whether the process is running."""
        return self.process.is_alive()

    def send(self, item: Any) -> None:
        """Say something. Raises `WorkerEnded`, and what pickling `item` raises."""
        try:
            self.line.send(item)
        except (OSError, TypeError) as error:
            raise self._ended(error) from None

    def receive(self, timeout: float | None = None) -> Any:
        """What it says next.

        Raises `WorkerEnded`, its last word (an `EagorError`), and `WorkerSilent` after so many seconds (None: never).
        """
        try:
            if not self.line.poll(timeout):
                raise WorkerSilent(f"nothing was heard for {timeout} s")
            said = self.line.recv()
        except (EOFError, OSError, TypeError) as error:
            raise self._ended(error) from None
        if isinstance(said, _LastWord):
            raise said.error
        return said

    def kill(self) -> None:
        """End it at once. From any thread."""
        self.process.kill()

    def close(self, patience: float) -> int:
        """See it end, and return its exit code. May be called twice, and from several threads.

        The closed line tells it to leave; after so many seconds it is killed.
        """
        with self._closing:
            with suppress(OSError):
                self.line.close()
            self.process.join(patience)
            if self.process.is_alive():
                self.process.kill()
                self.process.join()
            assert self.process.exitcode is not None
            return self.process.exitcode

    def _ended(self, error: Exception) -> Exception:
        """What to raise for an error of the line."""
        of_caller = isinstance(error, TypeError) and not self.line.closed  # else closed by a thread while one used it
        return error if of_caller else WorkerEnded()


class _LastWord(NamedTuple):
    """The error that a worker ended with."""

    error: EagorError


def of_script(pickled: bytes) -> bool:
    """Whether something that was pickled is defined in the script that was started."""
    return b"__main__" in pickled


def _live(line: Connection, work: bytes) -> None:
    """The life of a worker."""
    serve, arguments = pickle.loads(work)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears it, too, and decides
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # for processes that this one starts
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    try:
        with suppress(EOFError, BrokenPipeError, ConnectionResetError):  # the line has been closed there
            (resolve_name(serve) if isinstance(serve, str) else serve)(line, *arguments)
    except EagorError as error:
        with suppress(OSError):
            line.send(_LastWord(error))


def _leave_with_parent() -> None:
    """End this process and those it has started once its parent has ended: nobody gives it work."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    for process in multiprocessing.active_children():
        process.kill()
    os._exit(1)


@contextmanager
def _starting(with_script: bool) -> Iterator[None]:
    """Start processes of our own inside, `with_script` those that import the script that was started.

    They have one BLAS thread each (the libraries read that once, when they are loaded), and are not interrupted: Ctrl-C
    reaches every process of a terminal, and one that still imports would print a traceback. `_live` undoes that.
    """
    before = {name: os.environ[name] for name in THREADS if name in os.environ}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    mask, script = None, sys.modules["__main__"]
    if hasattr(signal, "pthread_sigmask"):  # not on Windows
        resource_tracker.ensure_running()  # it starts with the first process, and clears the mask
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    if not with_script:
        sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name in THREADS:
            os.environ.pop(name, None)
        os.environ.update(before)
