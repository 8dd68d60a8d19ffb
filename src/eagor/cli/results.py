"""``eagor bench report``, ``compare`` and ``failures``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from eagor.cli import terminal
from eagor.cli.options import Common, Flag, Whole, bare
from eagor.errors import EagorError

if TYPE_CHECKING:
    from eagor.lab.eval.results import Run


@dataclass(frozen=True, kw_only=True)
class BenchReport(Common):
    """Write the report of a run into its folder: report.html, tables.md and (to watch) episode.html.

    The report of one run of a benchmark also has predictions.jsonl, which `eagor bench score` reads.
    """

    runs: ClassVar[str] = "report"

    folders: Annotated[tuple[Path, ...], Positional, arg(metavar="RUN ...", help_behavior_hint="(required)")]
    """The folder of the run; for benchmarks also several."""
    out: Annotated[Path | None, bare("DIR")] = None
    """Folder for the report (default: the first run's)."""
    without_episode: Flag = False
    """Leave out episode.html, for which the worst episode of a simulated task is played again."""


@dataclass(frozen=True, kw_only=True)
class BenchCompare(Common):
    """Compare two runs, or two methods of one run, on the cases that both have."""

    runs: ClassVar[str] = "compare"

    a: Annotated[Path, Positional, arg(metavar="A")]
    """The folder of a run."""
    b: Annotated[Path | None, Positional, bare("[B]")] = None
    """The folder of another run; without it, two methods of A are compared."""
    methods: Annotated[tuple[str, ...], bare("METHOD ...")] = ()
    """Simulated tasks: one method for both runs, or one for A and one for B (default: eagor)."""


@dataclass(frozen=True, kw_only=True)
class BenchFailures(Common):
    """List the worst cases of a run; of a benchmark, also count failures by kind of question and by cause."""

    runs: ClassVar[str] = "failures"

    run: Annotated[Path, Positional, arg(metavar="RUN")]
    """The folder of the run."""
    method: Annotated[str | None, bare("NAME")] = None
    """Of a simulated task: whose episodes (default: eagor)."""
    limit: Whole = 20
    """Number of cases to list."""


def report(options: BenchReport) -> int:
    """``eagor bench report``. Raises `StorageError` if it cannot be written."""
    from eagor._extras import need
    from eagor.cli.checks import checked_out
    from eagor.lab.eval.report import write_report
    from eagor.lab.eval.results import read

    if not options.folders:
        raise terminal.UsageError("no run was given; wanted the folder of a run")
    need("a report", "report", "jinja2")  # before an episode is played for it
    if options.out is not None:
        checked_out(options.out, folder=True)
    episode, out = None, options.out or options.folders[0]
    runs = [read(folder) for folder in options.folders]
    if len(runs) == 1 and not options.without_episode:
        from eagor.cli.studio import beside_report

        episode = beside_report(runs[0], out)
    page = write_report(options.folders, out, episode)
    counts = [_counted(folder, run) for folder, run in zip(options.folders, runs, strict=True)]
    if options.json:
        terminal.emit({"report": str(page), "episode": None if episode is None else str(out / episode), "runs": counts})
    else:
        print(f"The report: {page}")
        if episode is not None:
            print(f"The worst episode, to watch: {out / episode}")
    return terminal.OK


def _counted(folder: Path, run: Run) -> dict[str, Any]:
    """How many records a run has, and how many it is to have; said, if these are fewer."""
    planned, there = run.planned, len(run.records)
    if planned is not None and there < planned:
        terminal.warning(
            f"{folder} has {there} of {planned} records; the figures are about these. The command of the run, without "
            "--limit and --shard, plays the rest"
        )
    return {"folder": str(folder), "records": there, "planned": planned}


def compare(options: BenchCompare) -> int:
    """``eagor bench compare``."""
    from eagor.lab.eval import report, results
    from eagor.lab.tasks.sim.task import split_methods

    methods = split_methods(options.methods)
    if options.b is None and len(methods) != 2:
        raise terminal.UsageError("name a second run, or two methods of this one with --methods")
    a = results.read(options.a)
    found = report.compare(a, a if options.b is None else results.read(options.b), methods)
    if options.json:
        terminal.emit(found)
    else:
        terminal.say(*report.comparison_in_words(found, a))
    return terminal.OK


def failures(options: BenchFailures) -> int:
    """``eagor bench failures``."""
    from eagor.lab.eval import results, tables
    from eagor.lab.tasks.task import sample_of

    if options.limit < 0:
        raise terminal.UsageError(f"--limit {options.limit}; wanted 0 or more")
    run = results.read(options.run)
    summary, method, layers = results.summarise(run), _method(run, options.method), []
    found = {key: summary[key] for key in ("task", "episodes", "failed", "failures")}
    if run.simulated:
        found["method"], lines, cases = method, [], []
        for result in results.rank(run, method)[::-1]:
            case, episode = sample_of(result.record), result.record["episode"]
            figures = {metric.key: metric.of(result.answer) for metric in run.task.metrics}
            cause, scene = run.task.failure(result.record), episode.get("scene")
            cases.append({"case": case, "query": episode["query"], "cause": cause, "figures": figures, "scene": scene})
            lines.append(f"{case}  {episode['query']!r}  {tables.figures_of(result.record, run.task, method)}")
    else:
        (part,) = summary["answers"].values()
        found |= {"agent": run.settings.get("agent"), "tags": part["tags"], "causes": part["causes"]}
        keys = ("case", "tags", "answer", "error")
        cases = [{**{key: r.get(key) for key in keys}, "cause": cause} for r, cause in tables.failures(run)]
        lines, layers = tables.failed_lines(run), tables.failure_tables(run.task, part)
    if options.json:
        terminal.emit(found | {"cases": cases[: options.limit]})
        return terminal.OK
    for table in layers:
        terminal.say(table.title, *table.lines(tables.WIDTH), "")
    if not lines:
        print("No case failed." if summary["episodes"] else "No case has a result.")
    terminal.say(*lines[: options.limit])
    if len(lines) > options.limit:
        print(f"... and {len(lines) - options.limit} more (--limit)")
    for failure in summary["failures"]:
        terminal.say(f"could not be run: {failure['key']} (attempt {failure['attempt']}): {failure['error']}")
    return terminal.OK


def _method(run: Run, name: str | None) -> str:
    """Whose cases are listed: ours, else the first that has played. Raises `EagorError` for one that has not."""
    from eagor.lab.eval.results import OURS

    names = list(run.results())
    if not run.simulated and name:
        raise EagorError(f"a run of {run.task.name} has one agent; leave out the method {name}")
    if name and names and name not in names:
        raise EagorError(f"the run has no method {name!r}; it has {', '.join(names)}")
    return name or (OURS if OURS in names else next(iter(names), OURS))
