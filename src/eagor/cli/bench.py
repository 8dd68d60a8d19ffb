"""``eagor bench``: run a simulated task with every method, and report it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from eagor.cli import terminal
from eagor.cli.options import Bench, BenchReport, BenchRun
from eagor.errors import EagorError


def bench(options: Bench) -> int:
    """Run the command; returns its exit code."""
    if isinstance(options.action, BenchRun):
        return run(options.action)
    return report(options.action)


def run(options: BenchRun) -> int:
    """``eagor bench run``."""
    from eagor.evaluation import bench, ledger, tables
    from eagor.perception import short_name
    from eagor.perception.calibrated import read_calibrated
    from eagor.tasks.methods import default_methods
    from eagor.tasks.rules import Disturbances

    methods = bench.named(options.methods) or default_methods(options.perception)
    if options.ablations:
        methods += tuple(name for name in bench.variants(options.task) if name not in methods)
    disturbances = Disturbances.walking(options.latency) if options.walking else Disturbances(latency=options.latency)
    wanted = bench.Run(
        task=options.task,
        perception=options.perception,
        episodes=options.episodes,
        seed=options.seed,
        methods=methods,
        world=options.world,
        rows=options.rows,
        disturbances=disturbances,
        calibrated=read_calibrated(options.calibration) if options.calibration else None,
        settings=_settings(options.set),
    )
    out = options.out or Path("runs") / f"{options.task}-{short_name(options.perception)}-{options.seed}"
    if options.workers < 1:
        raise terminal.UsageError(f"--workers {options.workers}; wanted 1 or more")
    units = wanted.units()
    terminal.log(f"{options.episodes} episodes, {len(methods)} methods; records go to {out}")
    with terminal.progress(f"{options.task}", len(units)) as advance:

        def done(record: dict[str, Any]) -> None:
            advance()
            if record["status"] == "failed":
                terminal.warning(f"{record['key']} could not be run: {record['error']}")

        outcome = bench.start(wanted, out, options.workers, options.retry_failed, done)
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


def report(options: BenchReport) -> int:
    """``eagor bench report``."""
    from eagor.evaluation.report import write_report

    try:
        page = write_report(options.run)
    except OSError as error:
        raise terminal.RunError(f"the report cannot be written into {options.run} ({error})") from error
    if options.json:
        terminal.emit({"report": str(page)})
    else:
        print(f"The report: {page}")
    return terminal.OK


def _settings(pairs: tuple[str, ...]) -> dict[str, str]:
    found = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not (key and equals and value):
            raise EagorError(f"--set {pair}; wanted RULE=VALUE, such as success_distance=0.5")
        found[key] = value
    return found
