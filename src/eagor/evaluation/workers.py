"""Many units of work on one or several workers, each result kept the moment it is there.

What is recorded decides what is left to do. A unit that raises, or takes its process down, has had an attempt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from eagor.errors import EagorError
from eagor.evaluation import ledger
from eagor.evaluation.inputs import inputs_of
from eagor.evaluation.units import Book, Told, Unit, WorkError, attempt_unit, load
from eagor.tasks.models import release

__all__ = ["Engine", "Outcome", "Unit", "WorkError", "carry_out", "run_units"]

Engine = Literal["processes", "threads", "ray"]
"""Who the workers of a run are."""


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
    on_done: Told | None = None,
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
                from eagor.evaluation.ray_engine import work_on_ray

                work_on_ray(book, work, config, workers, address)
            elif workers == 1:
                _alone(book, work, config)
            else:
                from eagor.evaluation.crew import ProcessSeat, in_threads, work_together

                threads = in_threads(book, work, config) if engine == "threads" else None
                work_together(book, threads or (lambda: ProcessSeat(book, work, config)), workers)
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
        book.ended(unit, attempt_unit(do, unit, attempt, book.task, book.ledger))
