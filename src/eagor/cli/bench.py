"""``eagor bench``: run simulated tasks and benchmarks with published data, and score predictions.

What there is to run is told in `eagor.cli.offers`, what came of runs in `eagor.cli.results`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor.cli import terminal
from eagor.cli.columns import table
from eagor.cli.offers import info, listed
from eagor.cli.options import (
    Bench,
    BenchCompare,
    BenchExport,
    BenchFailures,
    BenchInfo,
    BenchList,
    BenchReport,
    BenchRun,
    BenchScore,
    given,
    pairs_of,
)
from eagor.cli.results import compare, export, failures, report
from eagor.errors import EagorError

if TYPE_CHECKING:
    from eagor.evaluation.workers import Unit

SEED = 2000
PERCEPTION = "scout"
# Options that only benchmarks with published data have, and those that only simulated tasks have.
PUBLISHED_ONLY = ("data", "agent", "model", "scoring", "labels", "limit", "shard")
SIMULATED_ONLY = ("methods", "episodes", "ablations", "walking", "latency", "world", "rows", "detector")
FLAGS = ("scoring", "labels")  # options of benchmarks that have a flag of their own


def bench(options: Bench) -> int:
    """Run the command; returns its exit code."""
    return _COMMANDS[type(options.action)](options.action)


def run(options: BenchRun) -> int:
    """``eagor bench run``."""
    from eagor.tasks import benchmark, task

    if options.task in task.known():
        return _simulated(options)
    if options.task in benchmark.known():
        return _published(options)
    known = ", ".join((*task.known(), *sorted(benchmark.known())))
    raise terminal.UsageError(f"there is no task {options.task!r}; known are {known}")


def score(options: BenchScore) -> int:
    """``eagor bench score``."""
    from eagor.evaluation import predictions, scores

    settings, cases, given = predictions.read(options.predictions, options.task, options.data, _options(options))
    records, missing = predictions.judged(settings, cases, given)
    if not records:
        raise EagorError(f"{options.predictions} has no prediction for any of the {len(cases)} cases")
    if options.out:
        predictions.keep(settings, records, options.out)
    summary = scores.summarise(settings, records) | {"missing": missing}
    if missing:
        terminal.warning(f"{missing} of {len(cases)} cases have no prediction; the figures are about the others")
    code = _said(summary, options.out, options.json)
    return terminal.INCOMPLETE if missing and code == terminal.OK else code


_COMMANDS: dict[type, Callable[[Any], int]] = {
    BenchList: listed,
    BenchInfo: info,
    BenchRun: run,
    BenchScore: score,
    BenchReport: report,
    BenchCompare: compare,
    BenchFailures: failures,
    BenchExport: export,
}


def _simulated(options: BenchRun) -> int:
    """``eagor bench run`` of a simulated task."""
    from eagor.cli.looking import calibrated, check_looks, checked_rows
    from eagor.evaluation import bench, ledger, tables
    from eagor.perception import short_name
    from eagor.tasks.methods import default_methods
    from eagor.tasks.rules import Disturbances

    _check(options, "a simulated task", PUBLISHED_ONLY)
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
    config = wanted.config()  # what cannot be is told before anything is said to go on
    terminal.log(f"{options.episodes} episodes, {len(methods)} methods; records go to {out}")
    _play(options, units, bench.WORK, config, out, "units")
    summary = tables.summarise(ledger.read(out))
    if options.json:
        terminal.emit({key: summary[key] for key in ("task", "episodes", "failed", "methods")} | {"out": str(out)})
    else:
        print("\n".join(tables.as_text(summary)))
        print(f"\nFor pictures and intervals: eagor bench report {out}")
    return _code(summary, "episode", out)


def _published(options: BenchRun) -> int:
    """``eagor bench run`` of a benchmark with published data."""
    from eagor.cli.looking import calibrated
    from eagor.evaluation import benchmarks, scores
    from eagor.perception import short_name

    _check(options, "a benchmark with published data", SIMULATED_ONLY)
    if options.data is None:
        raise terminal.UsageError(f"{options.task} needs its published files; name their folder with --data")
    wanted = benchmarks.BenchmarkRun(
        task=options.task,
        data=options.data,
        agent=options.agent,
        perception=options.perception,
        model=options.model,
        seed=options.seed or 0,
        options=_options(options),
        limit=options.limit,
        shard=_shard(options.shard),
    )
    settings = wanted.settings()
    if options.calibration:
        found = calibrated(str(settings.get("perception")), options.calibration, None, options.force)
        wanted = replace(wanted, calibrated=found.as_json() if found else None)
        settings = wanted.settings()
    who = settings.get("perception") or (settings.get("model") or "").partition("@")[0]
    parts = [options.task, settings["agent"], short_name(who) if who else "", str(wanted.seed)]
    out = options.out or Path("runs") / "-".join(part for part in parts if part)
    cases = wanted.cases(settings)
    terminal.log(f"{len(cases)} cases for the agent {settings['agent']}; records go to {out}")
    _play(options, benchmarks.units(settings, cases), wanted.benchmark.work, settings, out, "cases")
    summary = scores.summarise(settings, benchmarks.read_run(out)[1])
    return _said(summary, out, options.json)


def _check(options: BenchRun, what: str, others: tuple[str, ...]) -> None:
    """Raise `UsageError` for an option among `others`, which `what` does not have, and for workers that cannot be."""
    if wrong := given(options, others):
        raise terminal.UsageError(f"{options.task} is {what} and takes no --{wrong[0]}")
    if options.workers < 1:
        raise terminal.UsageError(f"--workers {options.workers}; wanted 1 or more")
    if options.address is not None and options.engine != "ray":
        raise terminal.UsageError(f"--address {options.address} is of a Ray cluster; add --engine ray")


def _play(options: BenchRun, units: list[Unit], work: str, config: dict[str, Any], out: Path, what: str) -> None:
    """Do those of `units` that `out` has no record of yet; a bar goes on, and what could not be run is told."""
    from eagor.evaluation.workers import carry_out

    with terminal.progress(options.task, len(units)) as advance:

        def done(record: dict[str, Any]) -> None:
            advance()
            if record["status"] == "failed":
                terminal.warning(f"{record['key']} could not be run: {record['error']}")

        how = options.workers, done, options.retry_failed, options.engine, options.address, options.force
        outcome = carry_out(units, work, config, out, *how)
    if outcome.skipped:
        terminal.log(f"{outcome.skipped} of {len(units)} {what} were already in {out}")


def _options(options: BenchRun | BenchScore) -> dict[str, Any]:
    flags = {name: getattr(options, name) for name in FLAGS if getattr(options, name) is not None}
    given = pairs_of(options.set)
    if twice := sorted(flags.keys() & given.keys()):
        raise terminal.UsageError(f"{twice[0]} is given twice, as --{twice[0]} and with --set")
    return flags | given


def _shard(text: str | None) -> tuple[int, int]:
    if text is None:
        return 1, 1
    part, slash, parts = text.partition("/")
    if not (slash and part.isdecimal() and parts.isdecimal()):
        raise terminal.UsageError(f"--shard {text}; wanted I/N, such as 1/4")
    return int(part), int(parts)


def _said(summary: dict[str, Any], out: Path | None, as_json: bool) -> int:
    from eagor.evaluation import benchmark_sheets

    if as_json:
        terminal.emit(summary | ({"out": str(out)} if out else {}))
    else:
        sheet = benchmark_sheets.main_sheet([summary], published=False)
        boxes = [
            [row.head, *(f"{box.text} ({box.small})" if box.small else box.text for box in row.boxes)]
            for row in sheet.rows
        ]
        print(f"{sheet.title}: {summary['episodes']} cases in {summary['clusters']} clusters")
        table([list(sheet.heads), *boxes])
        print("In brackets: 95 %, Wilson's | cluster bootstrap.")
        if summary["failed"]:
            print(f"{summary['failed']} could not be run; they are in no figure.")
        if out:
            print(f"\nFor pictures, turns and failures: eagor bench report {out}")
    return _code(summary, "case", out)


def _code(summary: dict[str, Any], what: str, out: Path | None) -> int:
    """The exit code of a run or of scores."""
    if not summary["episodes"]:
        terminal.error(f"no {what} could be run" + (f"; {out} says why" if out else ""))
        return terminal.FAILED
    return terminal.INCOMPLETE if summary["failed"] else terminal.OK
