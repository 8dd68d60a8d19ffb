"""``eagor bench`` on benchmarks with published data: list, info, run, score, report, compare, failures, export."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from eagor.cli import terminal
from eagor.cli.bench import SIMULATED_ONLY, check_options, pairs_of, reported, told
from eagor.cli.columns import table, words
from eagor.cli.offers import info, listed
from eagor.cli.options import (
    BenchCompare,
    BenchExport,
    BenchFailures,
    BenchInfo,
    BenchList,
    BenchReport,
    BenchRun,
    BenchScore,
)
from eagor.errors import EagorError

FLAGS = ("scoring", "labels")  # options of benchmarks that have a flag of their own


def bench(action: Any) -> int:
    """Run the command; returns its exit code."""
    return _COMMANDS[type(action)](action)


def run(options: BenchRun) -> int:
    """``eagor bench run`` of a benchmark."""
    from eagor.cli.looking import calibrated
    from eagor.evaluation import benchmarks, scores
    from eagor.perception import short_name
    from eagor.tasks import benchmark, task

    if options.task not in benchmark.known():
        known = ", ".join((*task.known(), *sorted(benchmark.known())))
        raise terminal.UsageError(f"there is no task {options.task!r}; known are {known}")
    check_options(options, "a benchmark with published data", SIMULATED_ONLY)
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
    with terminal.progress(options.task, len(cases)) as advance:
        done = told(advance)
        outcome = benchmarks.start(
            wanted, out, options.workers, options.retry_failed, done, options.engine, options.address, options.force
        )
    if outcome.skipped:
        terminal.log(f"{outcome.skipped} of {len(cases)} cases were already in {out}")
    summary = scores.summarise(settings, benchmarks.read_run(out)[1])
    return _said(summary, out, options.json)


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


def report(options: BenchReport) -> int:
    """``eagor bench report`` of benchmarks' runs."""
    from eagor.cli.looking import checked_folder
    from eagor.evaluation.benchmark_report import write_report

    if options.out is not None:
        checked_folder(options.out)
    return reported(lambda: write_report(options.folders, options.out), options.json)


def compare(options: BenchCompare) -> int:
    """``eagor bench compare``."""
    from eagor.evaluation import benchmarks, scores
    from eagor.evaluation.samples import FEW, lowest_p

    found = scores.compare(benchmarks.read_run(options.a), benchmarks.read_run(options.b))
    if options.json:
        terminal.emit(found)
        return terminal.OK
    print(
        f"{found['task']}: {found['cases']} cases that both have "
        f"(a only: {found['only_in_a']}, b only: {found['only_in_b']})"
    )
    for key, (a, b) in found["settings"].items():
        print(f"  {key}: a {words(a)}, b {words(b)}")
    rows = [["", "a, %", "b, %", "a - b", "95 % interval", "p", "only a", "only b", "McNemar p"]]
    for figure in found["figures"].values():
        test = figure.get("mcnemar", {})
        span = f"{figure['low']:+.1f} to {figure['high']:+.1f}" if "low" in figure else "-"
        rows.append(
            [
                f"{figure['title']} ({figure['n']})",
                f"{figure['a']:.1f}",
                f"{figure['b']:.1f}",
                f"{figure['difference']:+.1f}",
                span,
                f"{figure['p']:.2g}" if "p" in figure else "-",
                str(test.get("only_a", "-")),
                str(test.get("only_b", "-")),
                f"{test['p']:.2g}" if test else "-",
            ]
        )
    table(rows)
    print("p: sign flips of whole clusters; McNemar takes cases as independent.")
    clusters = max((figure.get("clusters", 1) for figure in found["figures"].values()), default=1)
    if clusters == 1:
        print("Only one cluster: nothing can be said about how far the differences carry over to others.")
    elif clusters < FEW:
        print(
            f"Only {clusters} clusters: intervals that resample so few are too narrow, and p cannot be below "
            f"{lowest_p(clusters):.2g}."
        )
    return terminal.OK


def failures(options: BenchFailures) -> int:
    """``eagor bench failures``."""
    from eagor.evaluation import benchmark_sheets, benchmarks, scores
    from eagor.evaluation.benchmark_report import failure_sheets
    from eagor.evaluation.samples import cause_of

    if options.limit < 0:
        raise terminal.UsageError(f"--limit {options.limit}; wanted 0 or more")
    settings, records = benchmarks.read_run(options.run)
    summary = scores.summarise(settings, records)
    lines = benchmark_sheets.failed_lines(records)
    if options.json:
        keys = ("task", "agent", "episodes", "failed", "tags", "causes", "failures")
        listed = [
            {key: record.get(key) for key in ("case", "cause", "tags", "answer", "error")} | {"cause": cause}
            for record in records
            if (cause := cause_of(record))
        ]
        terminal.emit({key: summary[key] for key in keys} | {"cases": listed[: options.limit]})
        return terminal.OK
    for sheet in failure_sheets(settings, summary):
        print(sheet.title)
        table([list(sheet.heads), *([row.head, *(box.text for box in row.boxes)] for row in sheet.rows)])
        print()
    if not lines:
        print("No case failed." if summary["episodes"] else "No case has a result.")
    for line in lines[: options.limit]:
        print(line)
    if len(lines) > options.limit:
        print(f"... and {len(lines) - options.limit} more (--limit)")
    for failure in summary["failures"]:
        print(f"could not be run: {failure['key']} (attempt {failure['attempt']}): {failure['error']}")
    return terminal.OK


def export(options: BenchExport) -> int:
    """``eagor bench export``."""
    from eagor.cli.looking import checked_folder
    from eagor.evaluation import predictions
    from eagor.tasks import benchmark

    if options.run is not None:
        from eagor.evaluation import benchmarks

        if options.task or options.set:
            raise terminal.UsageError(f"{options.run} says what it is a run of; leave out --task and --set")
        settings, records = benchmarks.read_run(options.run)
        settings |= {"data": str(options.data.resolve())} if options.data else {}
    else:
        if not (options.task and options.data):
            raise terminal.UsageError("name a run, or --task and --data")
        settings, records = predictions.bare_settings(options.task, options.data, pairs_of(options.set)), []
    out = options.out or options.run
    if out is None:
        raise terminal.UsageError("without a run, name the folder to write into with --out")
    checked_folder(out)
    known = benchmark.load(str(settings["task"]))
    if options.to == "jsonl" and "jsonl" not in known.exports:
        files = [predictions.samples(settings, records, out)]
    elif options.to in known.exports:
        files = known.export(options.to, records, settings, out)
    else:
        offers = ", ".join(("jsonl", *known.exports))
        raise terminal.UsageError(f"{settings['task']} cannot be exported to {options.to!r}; it offers {offers}")
    if options.json:
        terminal.emit({"files": [str(file) for file in files]})
    else:
        print("\n".join(str(file) for file in files))
    return terminal.OK


_COMMANDS: dict[type, Any] = {
    BenchList: listed,
    BenchInfo: info,
    BenchRun: run,
    BenchScore: score,
    BenchReport: report,
    BenchCompare: compare,
    BenchFailures: failures,
    BenchExport: export,
}


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
    if not summary["episodes"]:
        terminal.error("no case could be run" + (f"; {out} says why" if out else ""))
        return terminal.FAILED
    return terminal.INCOMPLETE if summary["failed"] else terminal.OK
