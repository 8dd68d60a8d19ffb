"""Units on a Ray cluster: each worker an actor; their records come back and are kept by the process that began the run.

An actor or a machine that dies takes its unit's attempt with it. Ray lives in a process of its own
(`eagor.evaluation.ray_driver`): it takes over signals, and waits for a minute where one of its servers has gone.
"""

from __future__ import annotations

import multiprocessing
import pickle
import sys
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from eagor._extras import need
from eagor.evaluation.ray_driver import OVER, READY, drive, end_session
from eagor.evaluation.units import Book, Unit, WorkError, head_of

PATIENCE = 2.0  # seconds that Ray has to end by itself


def work_on_ray(book: Book, work: str, config: dict[str, Any], count: int, address: str | None = None) -> None:
    """All units of `book` on at most `count` actors, one processor each, of the cluster at `address`.

    `work` and the files that `config` names have to be on every machine. Without an address: the cluster that this
    process has joined, RAY_ADDRESS, else this machine alone. Raises as `eagor.evaluation.workers.run_units`, and
    `EagorError` without ray, or where no cluster answers.
    """
    need("--engine ray (the same version on all machines)", "ray", "ray", "psutil")
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    arguments = (there, work, config, count, address or _joined(), book.task)
    process = context.Process(target=drive, args=arguments, daemon=True)
    begun = []
    try:
        process.start()
        there.close()  # so that the line ends when the process does
        _serve(book, here, begun)
        process.join(PATIENCE)
    except EOFError:
        process.join(PATIENCE)
        raise WorkError(
            f"the process that talks to Ray ended (exit code {process.exitcode}); what it wrote to stderr says why"
        ) from None
    finally:
        _end(process, bool(begun))
        here.close()


def _joined() -> str | None:
    """The address of the cluster that this process is part of already."""
    ray: Any = sys.modules.get("ray")
    return ray.get_runtime_context().gcs_address if ray is not None and ray.is_initialized() else None


def _serve(book: Book, line: Connection, begun: list[bool]) -> None:
    """Answer what is asked about the book until all is done; `begun` is filled once Ray is there."""

    def record(unit: Unit, found: dict[str, Any]) -> None:
        book.ledger.append(found)
        book.ended(unit, head_of(found))

    answers = {"left": lambda: book.left, "next": lambda *now: _next(book, *now), "record": record}
    while True:
        what, said = line.recv()
        if what == READY:
            begun.append(True)
        elif what == OVER:
            if said[0] is not None:
                raise said[0]
            return
        else:
            line.send(answers[what](*said))


def _next(book: Book, group: str | None, taken: set[str]) -> bytes:
    """The next unit that can be sent, pickled with the number of its attempt; None, pickled, if there is none."""
    while (found := book.next(group, taken)) is not None:
        try:
            return pickle.dumps(found)
        except Exception as error:
            book.lost(*found, f"cannot be sent: {type(error).__name__}: {error}", 0.0)
    return pickle.dumps(None)


def _end(process: BaseProcess, begun: bool) -> None:
    """End Ray: by itself if it can in time (a cluster elsewhere hears of it), else by force."""
    if process.pid is None:
        return
    if begun and process.is_alive():
        process.terminate()
        process.join(PATIENCE)
    process.kill()
    process.join()
    end_session(process.pid)
