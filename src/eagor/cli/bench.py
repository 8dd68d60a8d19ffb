"""``eagor bench list``, ``info``, ``run`` and ``score``; `eagor.cli.results` has the other commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor.cli import terminal
from eagor.cli.options import Bench, BenchInfo, BenchList, BenchRun, BenchScore, pairs_of
from eagor.cli.results import COMMANDS as RESULTS
from eagor.cli.shared_options import given
from eagor.errors import EagorError, FormatError

if TYPE_CHECKING:
    from eagor.evaluation.study import Planned, Study

SEED = 2000
PERCEPTION = "scout"
# Options that only benchmarks with published data have, and those that only simulated tasks have.
PUBLISHED_ONLY = ("data", "agent", "model", "scoring", "labels", "limit", "shard")
SIMULATED_ONLY = (
    "methods", "episodes", "episodes_file", "scenes", "ablations", "walking", "latency", "world", "rows", "detector",
)  # fmt: skip
FLAGS = ("scoring", "labels")  # options of benchmarks that have a flag of their own


def bench(options: Bench) -> int:
    """Run the command; returns its exit code."""
    commands = {BenchList: listed, BenchInfo: info, BenchRun: run, BenchScore: score, **RESULTS}
    return commands[type(options.action)](options.action)


def listed(options: BenchList) -> int:
    """``eagor bench list``."""
    from eagor import worlds
    from eagor.evaluation.studies import SIMULATED, offers

    found = offers()
    if options.json:
        terminal.emit(found)
        return terminal.OK
    simulated = {name: entry for name, entry in found.items() if entry["kind"] == SIMULATED}
    print("Simulated, no data needed (eagor bench run TASK)")
    terminal.columns(
        {name: entry.get("what", f"not available ({entry.get('unavailable')})") for name, entry in simulated.items()}
    )
    print(f"  worlds (--world): {', '.join(sorted(worlds.known()))}, or a GLB file\n")
    for name, entry in found.items():
        if name in simulated:
            continue
        if "unavailable" in entry:
            print(f"{name}: not available ({entry['unavailable']})\n")
            continue
        print(f"{name}  {entry['title']} (eagor bench run {name} --data DIR)")
        print("  agents")
        terminal.columns(entry["agents"])
        print("  options (--scoring, --labels, others with --set OPTION=VALUE)")
        terminal.columns(
            {key: f"{value['what']} (default {value['default']})" for key, value in entry["options"].items()}
        )
        print("  exports")
        terminal.columns(entry["exports"])
        print()
    return terminal.OK


def info(options: BenchInfo) -> int:
    """``eagor bench info``."""
    from eagor.evaluation.studies import unimportable
    from eagor.tasks import benchmark

    found: dict[str, dict[str, Any]] = {}
    refused: dict[str, list[str]] = {}
    broken = {} if options.task else unimportable((benchmark.GROUP, benchmark.BUILT_IN))
    for name in [options.task] if options.task else sorted(benchmark.known()):
        if name in broken:
            refused.setdefault(broken[name], []).append(name)
            continue
        try:
            told = benchmark.load(name).info(options.data)
        except EagorError as error:
            refused.setdefault(str(error), []).append(name)
            continue
        if told not in found.values():
            found[name] = told
    if not found:
        reasons = "; ".join(f"as {', '.join(names)}: {why}" for why, names in refused.items())
        raise FormatError(f"{options.data} holds the data of no known benchmark; " + reasons)
    if options.json:
        terminal.emit(found)
    else:
        for told in found.values():
            terminal.facts(told)
    return terminal.OK


def run(options: BenchRun) -> int:
    """``eagor bench run``."""
    from eagor.evaluation import ledger, studies
    from eagor.evaluation.workers import carry_out

    kind = studies.known().get(options.task)
    if kind is None:
        studies.load(options.task)  # says what there is
    simulated = kind == studies.SIMULATED
    what, others = ("a simulated task", PUBLISHED_ONLY) if simulated else (
        "a benchmark with published data", SIMULATED_ONLY
    )  # fmt: skip
    if wrong := given(options, others):
        raise terminal.UsageError(f"{options.task} is {what} and takes no --{wrong[0]}")
    if options.workers < 1:
        raise terminal.UsageError(f"--workers {options.workers}; wanted 1 or more")
    if options.address is not None and options.engine != "ray":
        raise terminal.UsageError(f"--address {options.address} needs a Ray cluster; add --engine ray")
    planned = (_simulated if simulated else _published)(options)
    config = planned.config()  # wrong settings are reported before the run is announced
    units, study = planned.units(config), studies.load(options.task)
    out = options.out or Path("runs") / _folder(config)
    terminal.log(f"{options.task}: {len(units)} units of work; records go to {out}")
    with terminal.progress(options.task, len(units)) as advance:

        def done(record: dict[str, Any]) -> None:
            advance()
            if record["status"] == "failed":
                terminal.warning(f"{record['key']} could not be run: {record['error']}")

        names = "workers", "retry_failed", "engine", "address", "force"
        how = {name: getattr(options, name) for name in names}
        try:
            outcome = carry_out(units, study.work, config, out, on_done=done, **how)
        except KeyboardInterrupt:
            recorded = {record["key"] for record in ledger.read(out)} & {unit.key for unit in units}
            terminal.log(f"{len(recorded)} of {len(units)} units are in {out}; the same command goes on from there")
            raise
    if outcome.skipped:
        terminal.log(f"{outcome.skipped} of {len(units)} units were already in {out}")
    return _said(study, studies.read(out).summary, out, options.json)


def _folder(config: dict[str, Any]) -> str:
    """The default name of a run's folder."""
    from eagor.perception import short_name

    who = config.get("perception") or (config.get("model") or "").partition("@")[0]
    listed = Path(config["episodes_file"]).name.partition(".")[0] if "episodes_file" in config else ""
    parts = config["task"], config.get("agent"), short_name(who) if who else "", listed or str(config["seed"])
    return "-".join(part for part in parts if part)


def score(options: BenchScore) -> int:
    """``eagor bench score``."""
    from eagor.evaluation import predictions

    bare, cases, told = predictions.read(options.predictions, options.task, options.data, _options(options))
    records, missing = predictions.judged(bare.settings, cases, told)
    if not records:
        raise EagorError(f"{options.predictions} has no prediction for any of the {len(cases)} cases")
    if options.out:
        predictions.keep(bare.settings, records, options.out)
    summary = bare.study.loaded(bare.settings, records).summary | {"missing": missing}
    if missing:
        terminal.warning(f"{missing} of {len(cases)} cases have no prediction; the figures cover the others")
    code = _said(bare.study, summary, options.out, options.json)
    return terminal.INCOMPLETE if missing and code == terminal.OK else code


def _simulated(options: BenchRun) -> Planned:
    from eagor.cli.looking import calibrated, check_looks, checked_rows
    from eagor.evaluation import bench
    from eagor.tasks.methods import default_methods
    from eagor.tasks.rules import Disturbances

    checked_rows(options.rows)
    if options.scenes is not None and options.episodes_file is None:
        raise terminal.UsageError("--scenes is the folder of the scenes of --episodes-file, which is not given")
    if options.seed is not None and options.episodes_file is not None:
        raise terminal.UsageError("--seed chooses apartments, and --episodes-file says which are played; leave one out")
    if options.engine == "threads":
        raise terminal.UsageError("--engine threads is for models on servers; use processes or ray for simulated tasks")
    perception = options.perception or PERCEPTION
    check_looks(perception)
    methods = bench.named(options.methods) or default_methods(perception)
    if options.ablations:
        methods += tuple(name for name in bench.variants(options.task) if name not in methods)
    return bench.Run(
        task=options.task,
        perception=perception,
        episodes=options.episodes,
        seed=SEED if options.seed is None else options.seed,
        methods=methods,
        world=options.world,
        rows=options.rows,
        disturbances=(Disturbances.walking if options.walking else Disturbances)(latency=options.latency),
        calibrated=calibrated(perception, options.calibration, options.detector, options.force),
        settings=pairs_of(options.set),
        episodes_file=options.episodes_file,
        scenes=options.scenes,
    )


def _published(options: BenchRun) -> Planned:
    from eagor.cli.looking import calibrated
    from eagor.evaluation.benchmarks import BenchmarkRun

    if options.data is None:
        raise terminal.UsageError(f"{options.task} needs its published files; give their folder with --data")
    wanted = BenchmarkRun(
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
    if not options.calibration:
        return wanted
    found = calibrated(str(wanted.config().get("perception")), options.calibration, None, options.force)
    return replace(wanted, calibrated=found.as_json() if found else None)


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


def _said(study: Study, summary: dict[str, Any], out: Path | None, as_json: bool) -> int:
    """Print the summary of a run or of scores; returns the exit code."""
    if as_json:
        terminal.emit(study.as_json(summary) | ({"out": str(out)} if out else {}))
    else:
        terminal.say(*study.as_text(summary))
        if out:
            print(f"\nFor pictures and intervals: eagor bench report {out}")
    if not summary["episodes"]:
        terminal.error(f"no {study.case} could be run" + (f"; {out} says why" if out else ""))
        return terminal.FAILED
    return terminal.INCOMPLETE if summary["failed"] else terminal.OK
