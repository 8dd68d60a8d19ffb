"""``eagor bench``: methods are run on tasks, and runs are reported and compared."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from eagor.cli import checks, terminal
from eagor.cli.options import Common, Detector, Flag, Rows, Whole, bare, grouped, refuse
from eagor.errors import EagorError, FormatError

if TYPE_CHECKING:
    from eagor.lab.eval.results import Run
    from eagor.lab.tasks.task import Task


@dataclass(frozen=True, kw_only=True)
class BenchRun(Common):
    """Run a simulated task or a benchmark and record each episode. Run the same command again to resume.

    Every method plays a simulated task: waypoint (name the direction along a route), navigation (walk to the object),
    tracking (follow a moving ball). One agent plays a task with published data (hstar-hos, hstar-hps, osr, eagle360),
    which needs --data; `eagor bench list` shows agents and options.
    """

    task: Annotated[str, Positional, arg(metavar="TASK")]
    """waypoint, navigation, tracking, an installed task, or one with data: hstar-hos, hstar-hps, osr, eagle360"""
    perception: Annotated[str | None, bare("NAME")] = None
    """scout (default of simulated tasks), truth (the true places, with noise), a model, or another detector."""
    data: Annotated[Path | None, bare("DIR")] = None
    """Benchmarks: the folder with the published files."""
    agent: Annotated[str | None, bare("NAME")] = None
    """Benchmarks: the agent (default: eagor)."""
    model: Annotated[str | None, bare("MODEL")] = None
    """Benchmarks: the model of the agent vlm: MODEL@ADDRESS on a server; options after ?."""
    limit: Annotated[int | None, bare("N")] = None
    """Benchmarks: only the first N cases."""
    shard: Annotated[str | None, bare("I/N")] = None
    """Benchmarks: every N-th case from the I-th on, for several machines."""
    engine: Literal["processes", "threads", "ray"] = "processes"
    """Kind of --workers: processes; threads, for models on servers; ray, for a Ray cluster (RAY_ADDRESS)."""
    methods: Annotated[tuple[str, ...], bare("NAME ...")] = ()
    """The methods (default: all), or variants, such as eagor:degree=7; plain for language models; oracle."""
    episodes: Annotated[int | None, bare("N")] = None
    """Number of episodes; five in each apartment (default: 20)."""
    seed: Annotated[int | None, bare("N")] = None
    """The first apartment (default 2000; lower ones are for development). Benchmarks: seed of truth and chance."""
    out: Annotated[Path | None, bare("RUN")] = None
    """The folder of the run (default: runs/TASK-PERCEPTION-SEED). Finished episodes in it are not played again."""
    workers: Whole = 1
    """Number of parallel workers."""
    ablations: Flag = False
    """Run also variants of our method and of the published one (in navigation: the oracle, told the direction)."""
    walking: Flag = False
    """The camera bobs and sways, and the odometry drifts."""
    set: Annotated[tuple[str, ...], bare("RULE=VALUE ...")] = ()
    """Rules to change, such as success_distance=0.5 max_steps=200, or options of benchmarks (see bench list)."""
    world: Annotated[str, arg(metavar="WORLD")] = "apartment"
    """apartment, an installed world, or a GLB file."""
    rows: Rows = None
    calibration: Annotated[Path | None, bare("FILE.json")] = None
    """Calibration of our tracker, from `eagor calibrate`."""
    detector: Detector = None
    force: Annotated[bool, bare()] = False
    """Accept a calibration of another perception, and resume a run although code, data or model have changed."""
    retry_failed: Flag = False
    """Run failed episodes again."""


@dataclass(frozen=True, kw_only=True)
class BenchList(Common):
    """List simulated tasks and benchmarks, with their agents and options."""


@dataclass(frozen=True, kw_only=True)
class BenchInfo(Common):
    """Describe a folder with a benchmark's published files."""

    place: Annotated[str, Positional, arg(metavar="DATA|TASK")]
    """The folder (all benchmarks that can read it tell of it), or a benchmark whose folder is --data."""
    data: Annotated[Path | None, bare("DIR")] = None
    """The folder, where TASK is named first."""


@dataclass(frozen=True, kw_only=True)
class BenchScore(Common):
    """Score predictions from elsewhere, or a run by other rules; nothing is run."""

    predictions: Annotated[Path, Positional, arg(metavar="PRED")]
    """The folder of a run; or JSON lines, one for each "case" (or "doc_id"), as the predictions.jsonl of a report."""
    task: Annotated[str | None, bare("NAME")] = None
    """The benchmark (default: that of the run)."""
    data: Annotated[Path | None, bare("DIR")] = None
    """Its published files (default: those of the run)."""
    set: Annotated[tuple[str, ...], bare("OPTION=VALUE ...")] = ()
    """Options of the benchmark, such as scoring=strict."""
    out: Annotated[Path | None, bare("RUN")] = None
    """Save the records as a run, for report, compare and failures."""


@dataclass(frozen=True, kw_only=True)
class BenchReport(Common):
    """Write the report of a run into its folder: report.html, tables.md and (to watch) episode.html.

    The report of one run of a benchmark also has predictions.jsonl, which `eagor bench score` reads.
    """

    folders: Annotated[tuple[Path, ...], Positional, arg(metavar="RUN ...", help_behavior_hint="(required)")]
    """The folder of the run; for benchmarks also several."""
    out: Annotated[Path | None, bare("DIR")] = None
    """Folder for the report (default: the first run's)."""
    without_episode: Flag = False
    """Leave out episode.html, for which the worst episode of a simulated task is played again."""


@dataclass(frozen=True, kw_only=True)
class BenchCompare(Common):
    """Compare two runs, or two methods of one run, on the cases that both have."""

    a: Annotated[Path, Positional, arg(metavar="A")]
    """The folder of a run."""
    b: Annotated[Path | None, Positional, bare("[B]")] = None
    """The folder of another run; without it, two methods of A are compared."""
    methods: Annotated[tuple[str, ...], bare("METHOD ...")] = ()
    """Simulated tasks: one method for both runs, or one for A and one for B (default: eagor)."""


@dataclass(frozen=True, kw_only=True)
class BenchFailures(Common):
    """List the worst cases of a run; of a benchmark, also count failures by kind of question and by cause."""

    run: Annotated[Path, Positional, arg(metavar="RUN")]
    """The folder of the run."""
    method: Annotated[str | None, bare("NAME")] = None
    """Of a simulated task: whose episodes (default: eagor)."""
    limit: Whole = 20
    """Number of cases to list."""


Bench = grouped(
    "Bench", "Run and compare methods, in simulated apartments and on published benchmarks.",
    BenchRun, BenchReport, BenchList, BenchInfo, BenchScore, BenchCompare, BenchFailures,
)  # fmt: skip


PERCEPTION = "scout"
GIVEN = (  # fields of tasks' configs that have a flag of the same name
    "perception", "data", "agent", "model", "methods", "episodes", "seed", "world", "rows",
)  # fmt: skip


def bench_list(options: BenchList) -> int:
    """``eagor bench list``."""
    from eagor.lab import worlds

    found = {name: _described(task) for name, task in _tasks().items()}
    published = {name: entry for name, entry in found.items() if "agents" in entry}
    what = {n: e.get("what") or f"not available ({e['unavailable']})" for n, e in found.items() if n not in published}
    lines = ["Simulated, no data needed (eagor bench run TASK)", *terminal.facts(what, 4)]
    lines.append(f"  worlds (--world): {', '.join(sorted(worlds.known()))}, or a GLB file")
    for name, entry in published.items():
        options_of = {k: f"{v['what']} (default {v['default']})" for k, v in entry["options"].items()}
        lines += ["", f"{name}  {entry['title']} (eagor bench run {name} --data DIR)"]
        lines += ["  agents", *terminal.facts(entry["agents"], 4)]
        lines += ["  options (--set OPTION=VALUE)", *terminal.facts(options_of, 4)]
    return terminal.give(options.json, found, *lines)


def _tasks() -> dict[str, Any]:
    """The tasks by name; of one that cannot be loaded the error."""
    from eagor.cli.models import READY, tried
    from eagor.lab.tasks import task as tasks

    found, states = dict[str, Any](), tried(tasks)
    for name in tasks.known():
        try:
            found[name] = tasks.load(name) if states[name] == READY else EagorError(states[name])
        except EagorError as error:
            found[name] = error
    return found


def _described(task: Any) -> dict[str, Any]:
    """What ``eagor bench list --json`` says of a task, or of the error that it has instead."""
    from eagor.lab import worlds
    from eagor.lab.tasks.task import options_of

    if isinstance(task, EagorError):
        return {"unavailable": str(task)}
    published = hasattr(task, "agents")
    return {
        "title": task.title,
        "what": task.what,
        "kind": "published data" if published else "simulated",
        **({"agents": dict(task.agents)} if published else {"worlds": sorted(worlds.known())}),
        "options": {
            name: {"default": default, "what": what, "choices": choices}
            for name, (default, what, choices) in options_of(task).items()
            if what and name not in GIVEN
        },
    }


def bench_info(options: BenchInfo) -> int:
    """``eagor bench info``."""
    from eagor.lab.tasks.task import load

    found: dict[str, dict[str, Any]] = {}
    refused: dict[str, list[str]] = {}
    if options.data is None:
        tasks, data = _tasks(), Path(options.place)
    else:
        tasks, data = {options.place: load(options.place)}, options.data
    for name, task in tasks.items():
        try:
            if isinstance(task, EagorError):
                raise task
            content = task.info(data) if hasattr(task, "info") else None
        except EagorError as error:
            refused.setdefault(str(error), []).append(name)
            continue
        if content is not None and content not in found.values():
            found[name] = content
    if not found:
        reasons = "; ".join(f"as {', '.join(names)}: {why}" for why, names in refused.items())
        raise FormatError(f"{data} holds the data of no known task; {reasons or 'name one that has data'}")
    lines = (terminal.facts(content) for content in found.values())
    return terminal.give(options.json, found, *(each for part in lines for each in part))


def bench_run(options: BenchRun) -> int:
    """``eagor bench run``."""
    from eagor.lab.eval import log, results, runner
    from eagor.lab.tasks.task import WORK, configure, load, settings_of
    from eagor.perception import short_name

    task = load(options.task)
    if not (shard := re.fullmatch(r"(\d+)/(\d+)", options.shard or "1/1")):
        raise terminal.UsageError(f"--shard {options.shard}; wanted I/N, such as 1/4")
    config = configure(task, _values(options, task), pairs_of(options.set))  # wrong ones are said before the run begins
    samples = runner.samples_of(task, config, options.limit, (int(shard[1]), int(shard[2])))
    settings = settings_of(config)
    who = settings.get("perception") or (settings.get("model") or "").partition("@")[0]
    parts = task.name, settings.get("agent"), short_name(who) if who else "", settings.get("seed", "")
    out = options.out or Path("runs") / "-".join(str(part) for part in parts if part not in ("", None))
    terminal.log(f"{task.name}: {len(samples)} units of work; records go to {out}")
    with terminal.progress(task.name, len(samples)) as advance:

        def done(record: dict[str, Any]) -> None:
            advance()
            if record["status"] == "failed":
                terminal.warning(f"{record['key']} could not be run: {record['error']}")

        how = {name: getattr(options, name) for name in ("workers", "retry_failed", "engine")}
        try:
            outcome = runner.run(samples, WORK, settings, out, on_done=done, **how)
        except KeyboardInterrupt:
            recorded = {record["key"] for record in log.read(out)} & {f"{task.name}/{each.id}" for each in samples}
            terminal.log(f"{len(recorded)} of {len(samples)} units are in {out}; the same command goes on from there")
            raise
    if outcome.skipped:
        terminal.log(f"{outcome.skipped} of {len(samples)} units were already in {out}")
    return _summarised(results.read(out), out, options.json)


def _values(options: BenchRun, task: Task) -> dict[str, Any]:
    """The settings of a run by field. Raises `UsageError` for an option that the task does not have."""
    fields = task.Config.__struct_fields__
    simulated = "methods" in fields
    more = () if simulated else ("ablations", "walking", "detector")
    refuse(options, [*(name for name in GIVEN if name not in fields), *more], f"is no option of {task.name}")
    values = {name: getattr(options, name) for name in GIVEN if name in fields}
    values |= {name: str(value) for name, value in values.items() if isinstance(value, Path)}
    perception = options.perception or (PERCEPTION if simulated else "")
    made = checks.calibrated(perception, options.calibration, options.detector, options.force)
    values["calibrated"] = made.as_json() if made else None
    if not simulated:
        if "data" in fields and options.data is None:
            raise terminal.UsageError(f"{task.name} needs its published files; give their folder with --data")
        return values
    from eagor.lab.agents.methods import default_methods
    from eagor.lab.envs.rules import NoiseModel
    from eagor.lab.tasks.sim.task import split_methods, variants

    if options.engine == "threads":
        raise terminal.UsageError("--engine threads is for models on servers; use processes or ray for simulated tasks")
    checks.check_looks(perception)
    methods = split_methods(options.methods) or list(default_methods(perception))
    if options.ablations:
        methods += [name for name in variants(task) if name not in methods]  # type: ignore[arg-type]
    disturbances = NoiseModel.walking() if options.walking else NoiseModel()
    return values | {"perception": perception, "methods": methods, "disturbances": disturbances}


def pairs_of(pairs: tuple[str, ...]) -> dict[str, str]:
    """The values of --set by name. Raises `UsageError` unless each is RULE=VALUE, and each rule has one value."""
    found = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not (key and equals and value):
            raise terminal.UsageError(f"--set {pair}; wanted RULE=VALUE, such as success_distance=0.5")
        if key in found and found[key] != value:
            raise terminal.UsageError(f"--set {key}={found[key]} {pair}: two values of {key}; leave one of them out")
        found[key] = value
    return found


def bench_score(options: BenchScore) -> int:
    """``eagor bench score``."""
    from eagor.lab.eval.predictions import keep, score_predictions

    made, count, missing = score_predictions(options.predictions, options.task, options.data, pairs_of(options.set))
    if options.out:
        keep(made, options.out)
    if missing:
        terminal.warning(f"{missing} of {count} cases have no prediction; the figures cover the others")
    code = _summarised(made, options.out, options.json, {"missing": missing})
    return terminal.INCOMPLETE if missing and code == terminal.OK else code


def _summarised(run: Run, out: Path | None, as_json: bool, more: dict[str, Any] | None = None) -> int:
    """Print the summary of a run or of scores; returns the exit code."""
    from eagor.lab.eval import report, results, tables

    summary = results.summarise(run)
    if success := report.criterion_of(run):
        summary["success"] = success
    more_in = ["", f"For pictures and intervals: eagor bench report {out}"] if out else []
    found = results.as_json(summary, run) | (more or {}) | ({"out": str(out)} if out else {})
    terminal.give(as_json, found, *tables.as_text(run, summary), *more_in)
    if not summary["episodes"]:
        terminal.error(f"no {getattr(run.task, 'case', 'case')} could be run" + (f"; {out} says why" if out else ""))
        return terminal.FAILED
    return terminal.INCOMPLETE if summary["failed"] else terminal.OK


def bench_report(options: BenchReport) -> int:
    """``eagor bench report``. Raises `StorageError` if it cannot be written."""
    from eagor._extras import require_extra
    from eagor.lab.eval.report import write_report
    from eagor.lab.eval.results import read

    if not options.folders:
        raise terminal.UsageError("no run was given; wanted the folder of a run")
    require_extra("a report", "report", "jinja2")  # before an episode is played for it
    checks.check_outputs(options, out="folder")
    episode, out = None, options.out or options.folders[0]
    runs = [read(folder) for folder in options.folders]
    if len(runs) == 1 and not options.without_episode:
        from eagor.cli.studio import beside_report

        episode = beside_report(runs[0], out)
    page = write_report(options.folders, out, episode)
    counts = []
    for folder, run in zip(options.folders, runs, strict=True):
        planned, there = run.planned, len(run.records)
        counts.append({"folder": str(folder), "records": there, "planned": planned})
        if planned is not None and there < planned:
            terminal.warning(
                f"{folder} has {there} of {planned} records; the figures are about these. The command of the run, "
                "without --limit and --shard, plays the rest"
            )
    shown = None if episode is None else str(out / episode)
    lines = [f"The report: {page}", *([f"The worst episode, to watch: {shown}"] if shown else [])]
    return terminal.give(options.json, {"report": str(page), "episode": shown, "runs": counts}, *lines)


def bench_compare(options: BenchCompare) -> int:
    """``eagor bench compare``."""
    from eagor.lab.eval import report, results
    from eagor.lab.tasks.sim.task import split_methods

    methods = split_methods(options.methods)
    if options.b is None and len(methods) != 2:
        raise terminal.UsageError("name a second run, or two methods of this one with --methods")
    a = results.read(options.a)
    found = report.compare(a, a if options.b is None else results.read(options.b), methods)
    return terminal.give(options.json, found, *report.comparison_in_words(found, a))


def bench_failures(options: BenchFailures) -> int:
    """``eagor bench failures``."""
    from eagor.lab.eval import results, tables
    from eagor.lab.tasks.task import sample_of

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
    shown = lines[: options.limit]
    if not lines:
        shown = ["No case failed." if summary["episodes"] else "No case has a result."]
    if len(lines) > options.limit:
        shown.append(f"... and {len(lines) - options.limit} more (--limit)")
    shown += [f"could not be run: {f['key']} (attempt {f['attempt']}): {f['error']}" for f in summary["failures"]]
    above = [line for table in layers for line in (table.title, *table.lines(tables.WIDTH), "")]
    return terminal.give(options.json, found | {"cases": cases[: options.limit]}, *above, *shown)


def _method(run: Run, name: str | None) -> str:
    """Whose cases are listed: ours, else the first that has played. Raises `EagorError` for one that has not."""
    from eagor.lab.eval.results import OURS

    names = list(run.results())
    if not run.simulated and name:
        raise EagorError(f"a run of {run.task.name} has one agent; leave out the method {name}")
    if name and names and name not in names:
        raise EagorError(f"the run has no method {name!r}; it has {', '.join(names)}")
    return name or (OURS if OURS in names else next(iter(names), OURS))
