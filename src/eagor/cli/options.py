"""What can be typed: one frozen dataclass per command, and where the function is that runs it.

Nothing heavy is imported here, so that help and typing errors come at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, arg, subcommand

Name = Annotated[str, arg(metavar="NAME")]
Whole = Annotated[int, arg(metavar="N")]


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options of every command."""

    json: bool = False
    """Print exactly one JSON object on stdout."""
    debug: bool = False
    """Show the traceback of an error."""


@dataclass(frozen=True, kw_only=True)
class Locate(Common):
    """In which direction of one panorama is it?"""

    runs: ClassVar[str] = "eagor.cli.locate:locate"

    panorama: Annotated[Path, Positional, arg(metavar="PANO")]
    """An equirectangular image; its middle is forward."""
    query: Annotated[str, Positional, arg(metavar="QUERY")]
    """What to look for, in words."""
    perception: Name = "colour"
    """Who looks: colour (the colour that the query names), replay:FILE.jsonl (what a detector wrote), a model (FOLDER,
    Qwen/Qwen2.5-VL-7B-Instruct, endpoint:MODEL@http://HOST:PORT/v1, options after ?), or an installed one; `eagor
    doctor` lists them."""
    modes: Annotated[int, arg(metavar="K")] = 3
    """At most so many candidate directions."""
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63; resolution is about 180 / N degrees."""
    calibration: Annotated[Path | None, arg(metavar="FILE.json")] = None
    """How responses are read, from `eagor calibrate`."""
    stamp: Annotated[float | None, arg(metavar="SECONDS")] = None
    """Which record of a replay to take (default: the first for this query)."""
    picture: Annotated[Path | None, arg(metavar="FILE.png")] = None
    """Draw the belief over the panorama."""


@dataclass(frozen=True, kw_only=True)
class Track(Common):
    """Follow it through a series of panoramas, with the camera's poses."""

    runs: ClassVar[str] = "eagor.cli.track:track"

    words: Annotated[tuple[str, ...], Positional, arg(metavar="FRAMES QUERY", help_behavior_hint="(required)")]
    """A folder of panoramas (or several image files, taken in the order of their names), then what to look for."""
    poses: Annotated[Path, arg(metavar="CSV")]
    """The camera's poses: a CSV file with the columns stamp,qw,qx,qy,qz (world_R_body) or
    stamp,yaw_deg,pitch_deg,roll_deg (yaw left, pitch nose DOWN); also x,y,z (metres) and frame (file name)."""
    perception: Name = "colour"
    """Who looks: colour, replay:FILE.jsonl, a model (as for locate), or an installed one."""
    floor: Annotated[float | None, arg(metavar="Z")] = None
    """Height of the floor in the poses' world, metres, where it is known: things stand on it, which tells distances."""
    calibration: Annotated[Path | None, arg(metavar="FILE.json")] = None
    """How responses are read and forgotten, from `eagor calibrate`."""
    compare: bool = False
    """Run the baselines on the same evidence, side by side."""
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63."""
    picture: Annotated[Path | None, arg(metavar="DIR")] = None
    """Draw each frame with the belief into this folder."""
    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write the estimates as they come into FILE.csv or FILE.jsonl."""


@dataclass(frozen=True, kw_only=True)
class Demo(Common):
    """Search a furnished apartment for a thing, every method on its own way, and leave a report with pictures."""

    runs: ClassVar[str] = "eagor.cli.demo:demo"

    out: Annotated[Path, arg(metavar="DIR")] = Path("eagor-demo")
    """Where the report and the pictures go."""
    seed: Whole = 600
    """Of the apartment, 0 to 9999. The search that is shown without being asked for was chosen for what it shows."""
    episode: Whole = 1
    """Which search in it, 0 to 4."""
    perception: Name = "scout"
    """Who looks: scout (a small network that sees the pictures), truth (a noisy detector, made from what the simulator
    knows), or another perception."""


@dataclass(frozen=True, kw_only=True)
class BenchRun(Common):
    """Play a simulated task with every method, and keep a record of each episode; again, to go on after a stop."""

    task: Annotated[Literal["waypoint", "navigation", "tracking"], Positional]
    """Name the direction along a route; walk to the thing; follow a moving ball."""
    perception: Name = "scout"
    """Who looks: scout, a small network that sees the pictures; truth, a noisy detector made from what the simulator
    knows (truth:ideal has no noise, truth:miss=0.5,spread=4 its own); a model (FOLDER, Qwen/Qwen2.5-VL-7B-Instruct,
    endpoint:MODEL@http://HOST:PORT/v1); or another."""
    methods: Annotated[tuple[str, ...], arg(metavar="NAME ...")] = ()
    """Which methods (default: all eight, and plain, the model's own answer, where a vision-language model looks);
    variants as eagor:degree=7,decode=mean; in navigation also oracle."""
    episodes: Whole = 20
    """How many; five in each apartment."""
    seed: Whole = 2000
    """The first apartment. 0 to 1999 are for choosing parameters, 2000 to 9999 for results."""
    out: Annotated[Path | None, arg(metavar="RUN")] = None
    """The folder of the run (default: runs/TASK-PERCEPTION-SEED). What it holds already is not played again."""
    workers: Whole = 1
    """Processes."""
    ablations: bool = False
    """Variants of ours and of the published method as well: degree, decode, calibration, shells (in navigation: the
    oracle, which is told the true direction)."""
    walking: bool = False
    """The camera bobs and sways, and the odometry drifts."""
    latency: Whole = 0
    """Responses arrive so many steps late."""
    set: Annotated[tuple[str, ...], arg(metavar="RULE=VALUE ...")] = ()
    """Other rules, such as success_distance=0.5 max_steps=200 stop=call sliding=false."""
    world: Annotated[str, arg(metavar="WORLD")] = "apartment"
    """apartment, or a GLB file."""
    rows: Annotated[int | None, arg(metavar="N")] = None
    """Rows of the panoramas (default: what the perception works at, else 256; truth reads ids instead)."""
    calibration: Annotated[Path | None, arg(metavar="FILE.json")] = None
    """How our tracker reads and forgets, from `eagor calibrate`."""
    retry_failed: bool = False
    """Try episodes again that failed before."""


@dataclass(frozen=True, kw_only=True)
class BenchReport(Common):
    """Write report.html, tables.md and tables.csv of a run into its folder."""

    run: Annotated[Path, Positional, arg(metavar="RUN")]
    """The folder of the run."""


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Measured comparisons in simulated apartments: run, report."""

    runs: ClassVar[str] = "eagor.cli.bench:bench"

    action: Annotated[BenchRun, subcommand("run")] | Annotated[BenchReport, subcommand("report")]


@dataclass(frozen=True, kw_only=True)
class Calibrate(Common):
    """Fit how a perception's responses are read and forgotten, by log score; or find a model's localisation heads."""

    runs: ClassVar[str] = "eagor.cli.calibrate:calibrate"

    what: Annotated[Literal["responses", "heads"], Positional] = "responses"
    """responses: of any perception, read by log score. heads: of a local model (Qwen2.5-VL, Gemma 3, ...)."""
    perception: Name = "scout"
    """Whose responses, or whose heads (FOLDER, Qwen/Qwen2.5-VL-7B-Instruct, options after ?)."""
    out: Annotated[Path | None, arg(metavar="FILE.json")] = None
    """Where the calibration goes (default: calibration-PERCEPTION.json; other commands take it as --calibration), or
    the heads (default: heads-MODEL.json; models take it as FOLDER?heads=FILE.json)."""
    labels: Annotated[Path | None, arg(metavar="FILE.jsonl")] = None
    """heads: panoramas of your own and where the things are in them (docs/models.md), instead of apartments."""
    take: Whole = 3
    """heads: how many."""
    episodes: Whole = 60
    """How many to look at. responses: routes past a thing and balls in turn, two of each in an apartment; heads:
    panoramas, four in an apartment."""
    seed: Whole = 100
    """The first apartment; 0 to 1999 are for choosing parameters."""
    trials: Whole = 96
    """How many settings to try."""
    workers: Whole = 1
    """Processes."""
    rows: Annotated[int | None, arg(metavar="N")] = None
    """Rows of the panoramas (default: what the perception works at, else 256)."""


@dataclass(frozen=True, kw_only=True)
class Doctor(Common):
    """What is installed here, which models this machine could run, and what to install for them."""

    runs: ClassVar[str] = "eagor.cli.doctor:doctor"


Command = (
    Annotated[Locate, subcommand("locate")]
    | Annotated[Track, subcommand("track")]
    | Annotated[Demo, subcommand("demo")]
    | Annotated[Bench, subcommand("bench")]
    | Annotated[Calibrate, subcommand("calibrate")]
    | Annotated[Doctor, subcommand("doctor")]
)
