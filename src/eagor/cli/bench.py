"""``eagor bench``: run a simulated task with every method, and report it.

Benchmarks with published data go on from here to `eagor.cli.benchmarks`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from eagor.cli import terminal
from eagor.cli.options import Bench, BenchReport, BenchRun, given
from eagor.errors import EagorError

SEED = 2000
PERCEPTION = "scout"
# Options that only benchmarks with published data have, and those that only simulated tasks have.
PUBLISHED_ONLY = ("data", "agent", "model", "scoring", "labels", "limit", "shard")
SIMULATED_ONLY = ("methods", "episodes", "ablations", "walking", "latency", "world", "rows", "detector")


def bench(options: Bench) -> int:
    """Run the command; returns its exit code."""
    from eagor.tasks import task

    action = options.action
    if isinstance(action, BenchRun) and action.task in task.known():
        return run(action)
    if isinstance(action, BenchReport) and not _is_benchmark(action.folders):
        return report(action)
    from eagor.cli import benchmarks

    return benchmarks.bench(action)


def run(options: BenchRun) -> int:
    """``eagor bench run``."""
    from eagor.cli.looking import calibrated, check_looks, checked_rows
    from eagor.evaluation import bench, ledger, tables
    from eagor.perception import short_name
    from eagor.tasks.methods import default_methods
    from eagor.tasks.rules import Disturbances

    check_options(options, "a simulated task", PUBLISHED_ONLY)
    checked_rows(options.rows)
    if options.engine == "threads":
        raise terminal.UsageError("--engine threads is for work that waits for servers; simulated tasks compute")
    perception = options.perception or PERCEPTION
    check_looks(perception)
    seed = SEED if options.seed is None else options.seed
    methods = bench.named(options.methods) or default_methods(perception)
    if options.ablations:
        methods += tuple(name for name in bench.variants(options.task) if name not in methods)
    disturbances = Disturbances.walking(options.latency) if options.walking else Disturbances(latency=options.latency)
    wanted = bench.Run(
        task=options.task,
        perception=perception,
        episodes=options.episodes,
        seed=seed,
        methods=methods,
        world=options.world,
        rows=options.rows,
        disturbances=disturbances,
        calibrated=calibrated(perception, options.calibration, options.detector, options.force),
        settings=pairs_of(options.set),
    )
    out = options.out or Path("runs") / f"{options.task}-{short_name(perception)}-{seed}"
    units = wanted.units()
    wanted.config()  # what cannot be is told before anything is said to go on
    terminal.log(f"{options.episodes} episodes, {len(methods)} methods; records go to {out}")
    with terminal.progress(f"{options.task}", len(units)) as advance:
        done = told(advance)
        outcome = bench.start(
            wanted, out, options.workers, options.retry_failed, done, options.engine, options.address, options.force
        )
    summary = tables.summarise(ledger.read(out))
    if outcome.skipped:
        terminal.log(f"{outcome.skipped} of {len(units)} units were already in {out}")
    if options.json:
        terminal.emit({key: summary[key] for key in ("task", "episodes", "failed", "methods")} | {"out": str(out)})
    else:
        print("\n".join(tables.as_text(summary)))
        print(f"\nFor pictures and intervals: eagor bench report {out}")
    if not summary["episodes"]:
        terminal.error(f"no episode could be run; {out} says why")
        return terminal.FAILED
    return terminal.INCOMPLETE if summary["failed"] else terminal.OK


def check_options(options: BenchRun, what: str, others: tuple[str, ...]) -> None:
    """Raise `UsageError` for an option among `others`, which `what` does not have, and for workers that cannot be."""
    if wrong := given(options, others):
        raise terminal.UsageError(f"{options.task} is {what} and takes no --{wrong[0]}")
    if options.workers < 1:
        raise terminal.UsageError(f"--workers {options.workers}; wanted 1 or more")
    if options.address is not None and options.engine != "ray":
        raise terminal.UsageError(f"--address {options.address} is of a Ray cluster; add --engine ray")


def told(advance: Callable[[], None]) -> Callable[[dict[str, Any]], None]:
    """What takes each record of a run: it moves the bar on, and says what could not be run."""

    def done(record: dict[str, Any]) -> None:
        advance()
        if record["status"] == "failed":
            terminal.warning(f"{record['key']} could not be run: {record['error']}")

    return done


def report(options: BenchReport) -> int:
    """``eagor bench report``."""
    from eagor.evaluation.report import write_report

    folder = next(iter(options.folders))
    if len(options.folders) > 1 or options.out:
        raise terminal.UsageError("a run of a simulated task is reported alone, into its own folder")
    return reported(lambda: write_report(folder), options.json)


def reported(write: Callable[[], Path], as_json: bool) -> int:
    """Write a report, and say where it is. Raises `StorageError` where the disk does not take it."""
    page = write()
    if as_json:
        terminal.emit({"report": str(page)})
    else:
        print(f"The report: {page}")
    return terminal.OK


def _is_benchmark(folders: tuple[Path, ...]) -> bool:
    from eagor.evaluation.benchmarks import is_benchmark

    if not folders:
        raise terminal.UsageError("no run is named; wanted the folder of one")
    return is_benchmark(folders[0])


def pairs_of(pairs: tuple[str, ...]) -> dict[str, str]:
    """What was set with --set. Raises `EagorError` for what is no RULE=VALUE."""
    found = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not (key and equals and value):
            raise EagorError(f"--set {pair}; wanted RULE=VALUE, such as success_distance=0.5")
        found[key] = value
    return found
