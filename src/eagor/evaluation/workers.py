"""Many units of work on one or several processes, each result kept the moment it is there.

What has been recorded decides what is left to do, so a run that was stopped, by whatever, goes on where it stopped. A
unit that raises, or takes its process down with it, has had an attempt; after so many it is left alone as failed.
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
from eagor.tasks.eyes import release

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

    Args:
        units: what to do; their keys must differ.
        work: ``"package.module:function"``. ``function(config)`` is called once per process and returns a callable,
            payload -> dict; the dict becomes the record, together with key, attempt, status and seconds.
        config: settings for `work`. Its "task", where it has one, is put into records that do not say theirs.
        folder: of the run; see `eagor.evaluation.ledger`.
        workers: 1 works in this process (a unit that kills its process then ends the run, and has had no attempt).
            More start that many new ones with one BLAS thread each; one that dies is replaced, and its unit has had
            an attempt.
        attempts: how often a unit is tried, earlier runs on the same folder included.
        on_done: called, in this process, with the record of each unit that is finished (done, or failed for good), but
            without its "methods" and "truth".
        retry_failed: give units that failed for good as many attempts again.
        engine: who the workers are: ``processes`` of this machine; ``threads`` of this process, for work that waits
            for servers; ``ray``, actors on the cluster at `address` (see `eagor.evaluation.ray_engine`).
        address: of the Ray cluster.

    Raises:
        EagorError: two units have the same key, or a number is below 1.
        WorkError: `work` cannot be imported or set up, or workers die before they have begun.
        StorageError: the disk does not take the results.
        KeyboardInterrupt: passed on, after the workers have been stopped; what was done is kept.
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
            elif engine == "threads":
                from eagor.evaluation.fanout import work_in_threads

                work_in_threads(book, work, config, workers)
            else:
                from eagor.evaluation.crew import work_together

                work_together(book, work, config, workers)
    return Outcome(book.done, book.failed, book.skipped)


def carry_out(
    units: Sequence[Unit],
    work: str,
    config: dict[str, Any],
    folder: Path,
    workers: int = 1,
    on_done: Told | None = None,
    retry_failed: bool = False,
    engine: Engine = "processes",
    address: str | None = None,
    force: bool = False,
) -> Outcome:
    """A whole run: `run_units` into the folder of the run that `config` describes.

    What was made for making sure that it can be made (a perception, a model that talks) is let go of before workers
    make their own, beside which it would only take room, and after the run. Raises as `run_units`, and `EagorError` if
    the folder holds another run, or without `force` one of other inputs (`eagor.evaluation.ledger.begin`).
    """
    ledger.begin(folder, config, inputs_of(config), force)
    here = engine == "threads" or (engine == "processes" and workers == 1)
    if not here:
        release()
    try:
        return run_units(units, work, config, folder, workers, 2, on_done, retry_failed, engine=engine, address=address)
    finally:
        release()


def _alone(book: Book, work: str, config: dict[str, Any]) -> None:
    """All units, one after the other, in this process."""
    do, group = load(work, config), None
    while (found := book.next(group, set())) is not None:
        unit, attempt = found
        group = unit.group
        book.ended(unit, attempt_unit(do, unit, attempt, book.task, book.ledger))
