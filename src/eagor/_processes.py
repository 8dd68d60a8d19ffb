"""Processes of our own: they end with their parent, leave Ctrl-C to it, and start with one BLAS thread."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker

THREADS = (
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


@contextmanager
def starting() -> Iterator[None]:
    """Start processes of our own inside.

    They have one BLAS thread each (the libraries read that once, when they are loaded), and are not interrupted: Ctrl-C
    reaches every process of a terminal, and one that still imports would print a traceback. Each has to call
    `leave_ctrl_c` first.
    """
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    mask = None
    if hasattr(signal, "pthread_sigmask"):  # not on Windows
        resource_tracker.ensure_running()  # it starts with the first process, and clears the mask
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def leave_ctrl_c() -> None:
    """Ignore Ctrl-C in this process from now on: the parent hears it, too, and decides."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # for processes that this one starts


def leave_with_parent(first: Callable[[], object] = lambda: None) -> None:
    """End this process, after `first`, once its parent has ended, however that came about: nobody gives it work."""

    def wait_for_it() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            first()
            os._exit(1)

    threading.Thread(target=wait_for_it, daemon=True).start()
