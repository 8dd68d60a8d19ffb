"""``eagor bench list``, ``info``, ``run`` and ``score``; `eagor.cli.results` has the other commands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from tyro.conf import Positional, arg, subcommand

from eagor.cli import terminal
from eagor.cli.options import (
    Common,
    DataOfRun,
    Detector,
    Flag,
    ForceRun,
    Labels,
    Rows,
    Scoring,
    TaskOfRun,
    Whole,
    bare,
    given,
    pairs_of,
)
from eagor.cli.results import BenchCompare, BenchFailures, BenchReport
from eagor.errors import EagorError, FormatError

if TYPE_CHECKING:
    from eagor.lab.eval.study import Planned, Study


@dataclass(frozen=True, kw_only=True)
class BenchRun(Common):
    """Run a simulated task or a benchmark and record each episode. Run the same command again to resume.

    Every method plays a simulated task: waypoint (name the direction along a route), navigation (walk to the object),
    tracking (follow a moving ball). One agent plays a benchmark with published data (hstar-hos, hstar-hps, osr), which
    needs --data; `eagor bench list` shows agents and options.
    """

    runs: ClassVar[str] = "run"

    task: Annotated[str, Positional, arg(metavar="TASK")]
    """waypoint, navigation, tracking, an installed task, or a benchmark: hstar-hos, hstar-hps, osr, ..."""
    perception: Annotated[str | None, bare("NAME")] = None
    (
        "The detector: scout (default of simulated tasks), a small network on the rendered pictures; truth, a noisy "
        "detector with the ground truth of the simulator or the annotations (truth:ideal has no noise, "
        "truth:miss=0.5,spread=4 sets it); a model (FOLDER, Qwen/Qwen2.5-VL-7B-Instruct, "
        "endpoint:MODEL@http://HOST:PORT/v1); or another."
    )
    data: Annotated[Path | None, bare("DIR")] = None
    """Benchmarks: the folder with the published files."""
    agent: Annotated[str | None, bare("NAME")] = None
    """Benchmarks: the agent (default: eagor)."""
    model: Annotated[str | None, bare("MODEL")] = None
    (
        "Benchmarks: the model of the agent vlm: FOLDER or hub name on this machine, or MODEL@ADDRESS on a server; "
        "options after ?."
    )
    scoring: Scoring = None
    labels: Labels = None
    limit: Annotated[int | None, bare("N")] = None
    """Benchmarks: only the first N cases."""
    shard: Annotated[str | None, bare("I/N")] = None
    """Benchmarks: every N-th case from the I-th on, for several machines, which may share one --out."""
    engine: Literal["processes", "threads", "ray"] = "processes"
    """Kind of --workers: processes; threads, for perceptions and models on servers; ray, for a Ray cluster."""
    address: Annotated[str | None, bare("ADDRESS")] = None
    """Address of the Ray cluster (default: RAY_ADDRESS, else this machine)."""
    methods: Annotated[tuple[str, ...], bare("NAME ...")] = ()
    (
        "The methods (default: all eight, and for a vision-language model plain, its own answer); variants such as "
        "eagor:degree=7,decode=mean; in navigation also oracle."
    )
    episodes: Annotated[int | None, bare("N")] = None
    """Number of episodes; five in each apartment (default: 20, or all of --episodes-file)."""
    episodes_file: Annotated[Path | None, bare("FILE.json.gz")] = None
    (
        "navigation: play the ObjectNav episodes of this file (HM3D, MP3D, `eagor export habitat`), judged as Habitat "
        "does. Ours are played in our own world too, others need --world habitat."
    )
    scenes: Annotated[Path | None, bare("DIR")] = None
    """With --episodes-file: the folder of its scenes (default: the nearest scene_datasets above the file)."""
    seed: Annotated[int | None, bare("N")] = None
    (
        "The first apartment (default 2000). 0 to 1999 are for development, 2000 to 9999 for results. Benchmarks: seed "
        "of truth and of random agents (default 0)."
    )
    out: Annotated[Path | None, bare("RUN")] = None
    """The folder of the run (default: runs/TASK-PERCEPTION-SEED). Finished episodes in it are not played again."""
    workers: Whole = 1
    """Number of parallel workers."""
    ablations: Flag = False
    (
        "Run also variants of our method and of the published one: degree, decode, calibration, shells (in navigation: "
        "the oracle, which is told the true direction)."
    )
    walking: Flag = False
    """The camera bobs and sways, and the odometry drifts."""
    latency: Whole = 0
    """Delay of responses in steps."""
    set: Annotated[tuple[str, ...], bare("RULE=VALUE ...")] = ()
    (
        "Rules to change, such as success_distance=0.5 max_steps=200 stop=call sliding=false. Benchmarks: other "
        "options, such as sure=0.8."
    )
    world: Annotated[str, arg(metavar="WORLD")] = "apartment"
    """apartment, an installed world, or a GLB file."""
    rows: Rows = None
    calibration: Annotated[Path | None, bare("FILE.json")] = None
    """Calibration of our tracker, from `eagor calibrate`."""
    detector: Detector = None
    force: ForceRun = False
    retry_failed: Flag = False
    """Run failed episodes again."""


@dataclass(frozen=True, kw_only=True)
class BenchList(Common):
    """List simulated tasks and benchmarks, with their agents and options."""

    runs: ClassVar[str] = "listed"


@dataclass(frozen=True, kw_only=True)
class BenchInfo(Common):
    """Describe a folder with a benchmark's published files."""

    runs: ClassVar[str] = "info"

    data: Annotated[Path, Positional, arg(metavar="DATA")]
    """The folder."""
    task: Annotated[str | None, bare("NAME")] = None
    """The benchmark (default: all that can read the folder)."""


@dataclass(frozen=True, kw_only=True)
class BenchScore(Common):
    """Score predictions from elsewhere, or a run by other rules; nothing is run."""

    runs: ClassVar[str] = "score"

    predictions: Annotated[Path, Positional, arg(metavar="PRED")]
    (
        'A JSON lines file with one object per case: its id ("case"; or "doc_id", its number) and the answer '
        '("submit": [yaw, pitch], "text": the model\'s text, ...), such as the predictions.jsonl of a report. Or the '
        "folder of a run."
    )
    task: TaskOfRun = None
    data: DataOfRun = None
    scoring: Scoring = None
    labels: Labels = None
    set: Annotated[tuple[str, ...], bare("OPTION=VALUE ...")] = ()
    """Other options of the benchmark."""
    out: Annotated[Path | None, bare("RUN")] = None
    """Save the records as a run, for report, compare and failures."""


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Run and compare methods, in simulated apartments and on published benchmarks."""

    action: Annotated[
        Annotated[BenchRun, subcommand("run")]
        | Annotated[BenchReport, subcommand("report")]
        | Annotated[BenchList, subcommand("list")]
        | Annotated[BenchInfo, subcommand("info")]
        | Annotated[BenchScore, subcommand("score")]
        | Annotated[BenchCompare, subcommand("compare")]
        | Annotated[BenchFailures, subcommand("failures")],
        # Without a name, its options are listed with those of every command, and its text appears once in the help.
        # (Help would show a comment above the field.)
        arg(name=""),
    ]


SEED = 2000
PERCEPTION = "scout"
# Options that only benchmarks with published data have, and those that only simulated tasks have.
PUBLISHED_ONLY = ("data", "agent", "model", "scoring", "labels", "limit", "shard")
SIMULATED_ONLY = (
    "methods", "episodes", "episodes_file", "scenes", "ablations", "walking", "latency", "world", "rows", "detector",
)  # fmt: skip
FLAGS = ("scoring", "labels")  # options of benchmarks that have a flag of their own


def listed(options: BenchList) -> int:
    """``eagor bench list``."""
    from eagor.lab import worlds
    from eagor.lab.eval.studies import SIMULATED, offers

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
        print()
    return terminal.OK


def info(options: BenchInfo) -> int:
    """``eagor bench info``."""
    from eagor.lab.eval.studies import unimportable
    from eagor.lab.tasks import benchmark

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
    from eagor.lab.eval import log, runner, studies

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

        names = "workers", "retry_failed", "engine", "address"
        how = {name: getattr(options, name) for name in names}
        try:
            outcome = runner.run(units, study.work, config, out, on_done=done, **how)
        except KeyboardInterrupt:
            recorded = {record["key"] for record in log.read(out)} & {unit.key for unit in units}
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
    from eagor.lab.eval import benchmarks

    bare, cases, told = benchmarks.read_predictions(options.predictions, options.task, options.data, _options(options))
    records, missing = benchmarks.judged_predictions(bare.settings, cases, told)
    if not records:
        raise EagorError(f"{options.predictions} has no prediction for any of the {len(cases)} cases")
    if options.out:
        benchmarks.keep_predictions(bare.settings, records, options.out)
    summary = bare.study.loaded(bare.settings, records).summary | {"missing": missing}
    if missing:
        terminal.warning(f"{missing} of {len(cases)} cases have no prediction; the figures cover the others")
    code = _said(bare.study, summary, options.out, options.json)
    return terminal.INCOMPLETE if missing and code == terminal.OK else code


def _simulated(options: BenchRun) -> Planned:
    from eagor.cli.checks import calibrated, check_looks, checked_rows
    from eagor.lab.agents.methods import default_methods
    from eagor.lab.envs.rules import NoiseModel
    from eagor.lab.eval.simulated import Run, named, variants

    checked_rows(options.rows)
    if options.scenes is not None and options.episodes_file is None:
        raise terminal.UsageError("--scenes is the folder of the scenes of --episodes-file, which is not given")
    if options.seed is not None and options.episodes_file is not None:
        raise terminal.UsageError("--seed chooses apartments, and --episodes-file says which are played; leave one out")
    if options.engine == "threads":
        raise terminal.UsageError("--engine threads is for models on servers; use processes or ray for simulated tasks")
    perception = options.perception or PERCEPTION
    check_looks(perception)
    methods = named(options.methods) or default_methods(perception)
    if options.ablations:
        methods += tuple(name for name in variants(options.task) if name not in methods)
    return Run(
        task=options.task,
        perception=perception,
        episodes=options.episodes,
        seed=SEED if options.seed is None else options.seed,
        methods=methods,
        world=options.world,
        rows=options.rows,
        disturbances=(NoiseModel.walking if options.walking else NoiseModel)(latency=options.latency),
        calibrated=calibrated(perception, options.calibration, options.detector, options.force),
        settings=pairs_of(options.set),
        episodes_file=options.episodes_file,
        scenes=options.scenes,
    )


def _published(options: BenchRun) -> Planned:
    from eagor.cli.checks import calibrated
    from eagor.lab.eval.benchmarks import BenchmarkRun

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
