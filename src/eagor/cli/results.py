"""``eagor bench report``, ``compare``, ``failures`` and ``export``."""

from __future__ import annotations

from eagor._extras import need
from eagor.cli import terminal
from eagor.cli.columns import words
from eagor.cli.options import BenchCompare, BenchExport, BenchFailures, BenchReport, pairs_of


def report(options: BenchReport) -> int:
    """``eagor bench report``. Raises `StorageError` if it cannot be written."""
    from eagor.cli.looking import checked_folder
    from eagor.evaluation import studies
    from eagor.evaluation.report import write_report

    need("a report page", "sim", "jinja2")
    if not options.folders:
        raise terminal.UsageError("no run was given; wanted the folder of a run")
    if options.out is not None:
        if not studies.of(options.folders[0]).several:
            raise terminal.UsageError("--out is for benchmarks; a simulated task's report goes into its own folder")
        checked_folder(options.out)
    page = write_report(options.folders, out=options.out)
    if options.json:
        terminal.emit({"report": str(page)})
    else:
        print(f"The report: {page}")
    return terminal.OK


def compare(options: BenchCompare) -> int:
    """``eagor bench compare``."""
    from eagor.evaluation import benchmarks, scores
    from eagor.evaluation.page import in_columns
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
    print(*in_columns(rows), sep="\n")
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
    from eagor.evaluation.page import in_columns
    from eagor.evaluation.samples import cause_of
    from eagor.tasks import benchmark

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
    for sheet in benchmarks.Published(benchmark.load(str(settings["task"]))).failure_sheets(summary):
        rows = [list(sheet.heads), *([row.head, *(box.text for box in row.boxes)] for row in sheet.rows)]
        print(sheet.title, *in_columns(rows), "", sep="\n")
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
    from eagor.evaluation import benchmarks, predictions
    from eagor.tasks import benchmark

    if options.run is not None:
        if options.task or options.set:
            raise terminal.UsageError(f"{options.run} names its task and options; leave out --task and --set")
        settings, records = benchmarks.read_run(options.run)
        settings |= {"data": str(options.data.resolve())} if options.data else {}
    else:
        if not (options.task and options.data):
            raise terminal.UsageError("give a run, or --task and --data")
        settings, records = predictions.bare_settings(options.task, options.data, pairs_of(options.set)), []
    out = options.out or options.run
    if out is None:
        raise terminal.UsageError("without a run, give the folder to write to with --out")
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


COMMANDS = {BenchReport: report, BenchCompare: compare, BenchFailures: failures, BenchExport: export}
