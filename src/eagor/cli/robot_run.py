"""``eagor robot run``: walk a Go2 to an object, through the safety gate, and leave a report."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from tyro.conf import Positional, arg

from eagor._version import __version__
from eagor.cli import terminal
from eagor.cli.checks import (
    check_looks,
    checked_folder,
    checked_latency,
    checked_query,
    checked_seconds,
    mask_of,
    perception_for,
    rows_for,
    tracker_config,
    wants_panoramas,
)
from eagor.cli.options import Common, Detector, Flag, Force, Mask, Name, Static, Whole, bare
from eagor.errors import DeviceError, EagorError

if TYPE_CHECKING:
    import numpy as np

    from eagor.live.loop import LiveLoop
    from eagor.media import CameraSource
    from eagor.robots.run_page import Plan, RobotPage, Sample
    from eagor.robots.safety.limits import Limits
    from eagor.robots.safety.walking import Step, WalkSettings


@dataclass(frozen=True, kw_only=True)
class RobotRun(Common):
    """Walk a Unitree Go2 to an object. Without --arm nothing is commanded: a dry run says what it would do.

    Read docs/how-to/robot-safety.md before the first --arm. --sim does all of it with a simulated robot.
    """

    runs: ClassVar[str] = "robot_run"

    query: Annotated[str, Positional, arg(metavar="QUERY")]
    """What to walk to, in words."""
    sim: Flag = False
    """A simulated Go2 in a built-in apartment, on this machine alone (interface lo, a free DDS domain)."""
    arm: Flag = False
    """Let the robot move. Somebody has to hold the dead-man switch."""
    deadman: Annotated[Literal["key", "remote", "none"] | None, bare("SWITCH")] = None
    (
        "What is held while it may move: key (the space bar of this terminal; x stops for good, r releases that), "
        "remote (L1 of the robot's remote control; B stops for good, start releases that), none (only with --sim). "
        "Default: key; with --sim none."
    )
    source: Annotated[str | None, bare("SOURCE")] = None
    """The camera, as for `eagor live`: /dev/video0, rtsp://HOST/PATH, ros:/image_topic, ...; with --sim its own."""
    interface: Annotated[str | None, bare("NAME")] = None
    """Network interface to the robot, such as eth0 (this machine has 192.168.123.x on it)."""
    domain: Whole = 0
    """DDS domain of the robot."""
    distance: Annotated[float, arg(metavar="METRES")] = 1.0
    """Stop at this distance over the ground, from the camera."""
    speed: Annotated[float, arg(metavar="M/S")] = 0.4
    """Fastest walk that is wanted; the gate never lets more than 0.5 through."""
    avoid: Flag = False
    """Let the robot walk around obstacles by itself (its own obstacle avoidance)."""
    blind: Annotated[float, arg(metavar="METRES")] = 3.0
    """How far to walk while the distance is not known."""
    calm: Annotated[tuple[int, ...], bare("CODE ...")] = ()
    """Error codes of the robot that are no error: some firmware tells its mode there."""
    belief_age: Annotated[float, arg(metavar="SECONDS")] = 3.0
    (
        "Age of the newest look beyond which it stands, at most: three usual intervals between looks are less for a "
        "quick detector. A detector needs less than half of that per look."
    )
    seconds: Annotated[float | None, bare("SECONDS")] = None
    """Stop after this time (default: 120 with --sim, else at Ctrl-C)."""
    stay: Flag = False
    """Go on when it has arrived: follow the thing if it moves (default: end 2 s after it has arrived)."""
    report: Annotated[Path | None, bare("DIR")] = None
    """Folder for report.html and run.json (default: eagor-walk with --sim, else none)."""
    perception: Annotated[str | None, bare("NAME")] = None
    """The detector: colour, coco, onnx:MODEL.onnx, a model, or an installed one (as for locate)."""
    patience: Annotated[float, arg(metavar="SECONDS")] = 10.0
    """Time that one look may take; then the detector is ended and started anew."""
    latency: Annotated[float, arg(metavar="SECONDS")] = 0.15
    """Time from capture to arrival of the camera's pictures."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """The lenses, if the pictures are those of fisheye or ordinary lenses."""
    rows: Annotated[int | None, bare("N")] = None
    """Rows of the pictures at most."""
    mount: Annotated[tuple[float, float, float], arg(metavar="X Y Z")] = (0.0, 0.0, 0.4)
    """Where the camera is on the body: metres forward, left and up from the body's centre."""
    odometry: Annotated[Literal["sport", "slow", "lidar"], arg(metavar="NAME")] = "sport"
    """Odometry of the robot: sport (its state, 200 Hz), slow (the same at 20 Hz), lidar."""
    seed: Whole = 602
    """--sim: the apartment, 0 to 1999, and what chance decides."""
    start: Annotated[tuple[float, float, float] | None, bare("X Y DEG")] = None
    """--sim: where it starts, metres, and its heading (default: somewhere with a free way to the object)."""
    world: Name = "apartment"
    """--sim: apartment, an installed world, or a GLB file."""
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63."""
    calibration: Annotated[Path | None, bare("FILE.json")] = None
    """Calibration of the perception and of forgetting, from `eagor calibrate`."""
    detector: Detector = None
    static: Static = False
    mask: Mask = None
    force: Force = False


ROS, INTERFACE = "ros:", "lo"
RATE = 20.0  # answers, and so commands, per second
THERE = 2.0  # seconds for which it has to have arrived
QUIET, LOUD = 1.0, ("stopping", "latched")  # seconds between two lines; modes that are told at once
HELD = 0.2  # of the time: a gate that held the robot for longer is named as a cause
LONGEST = 120.0  # seconds of a simulated walk
PICTURE, PICTURES = 128, 5.0  # rows of a simulated picture, and pictures per second
REACH = 2.0  # metres from the body's centre at which no camera is any more: a Go2 is 0.7 m long
FLOOR = 0.0  # metres: the odometry of a Go2 begins on the floor


@dataclass(frozen=True)
class Place:
    """Where to walk: the robot's network, its camera, and what only a simulation knows.

    `truth()` gives the true position ``(3,)`` and orientation ``(3, 3)`` of the camera now, `targets()` the true places
    ``(n, 3)`` of the things.
    """

    domain: int
    interface: str | None
    camera: Callable[[], CameraSource]
    truth: Callable[[], tuple[np.ndarray, np.ndarray] | None] = lambda: None
    targets: Callable[[], np.ndarray | tuple[()]] = tuple
    plan: Plan | None = None


def robot_run(options: RobotRun) -> int:
    """Run the command; returns its exit code."""
    from eagor.live.loop import LiveLoop
    from eagor.robots import Go2Poses
    from eagor.robots.run_page import RobotPage
    from eagor.robots.safety.guard import Guard
    from eagor.robots.safety.limits import Limits
    from eagor.robots.safety.messages import DEADMEN
    from eagor.robots.safety.walking import Odometer, WalkSettings, steer

    query = checked_query(options.query)
    _check(options)
    # In a rendered house the network for such pictures is better than a colour alone.
    spec = "scout" if options.sim and options.perception is None else perception_for(query, options.perception)
    check_looks(spec)
    config = tracker_config(options.degree, spec, options.calibration, options.detector, options.force, options.static)
    config = replace(config, floor_height=FLOOR)
    mask = mask_of(options.mask)
    folder = options.report or (Path("eagor-walk") if options.sim else None)
    if folder is not None:
        checked_folder(folder, "--report")
    deadman = options.deadman or ("none" if options.sim or not options.arm else "key")
    limits = replace(Limits(), belief_age=options.belief_age, calm_codes=(0, *options.calm))
    walking = WalkSettings(distance=options.distance, speed=options.speed, blind=options.blind)
    loops: list[LiveLoop] = []
    # As soon as the loop ends, nothing stops the cleanup and the report any more.
    with terminal.unhurried(lambda: any(each.stopped for each in loops)), ExitStack() as stack:
        place = stack.enter_context(_simulated(options, query, spec) if options.sim else _real(options, spec))
        guard = stack.enter_context(
            Guard(
                armed=options.arm, deadman=deadman, limits=limits, domain=place.domain, interface=place.interface,
                avoid=options.avoid,
            )
        )  # fmt: skip
        loop: LiveLoop
        odometer = Odometer(guard, lambda: loop.clock.now())
        loop = LiveLoop(
            place.camera, spec, [query], config=config, rate=RATE, patience=options.patience, mask=mask,
            poses=lambda: Go2Poses(place.domain, place.interface, options.odometry, options.mount),
            watchers=[odometer],
        )  # fmt: skip
        loops.append(loop)
        used = {
            "robot": "simulated Go2" if options.sim else "Go2", "perception": spec,
            "dead-man switch": f"{deadman}: {DEADMEN[deadman]}", "armed": "yes" if options.arm else "no (dry run)",
            "distance": f"{options.distance:g} m", "version": f"eagor {__version__}",
        }  # fmt: skip
        page = RobotPage(query, used, place.plan)
        terminal.log("armed: " + DEADMEN[deadman] if options.arm else "dry run: nothing is commanded (--arm moves it)")
        why, report = None, None
        try:
            why = _walk(options, steer(loop, guard, odometer, walking), page, place)
        except KeyboardInterrupt:
            why = "interrupted"
            raise
        except DeviceError as error:  # the guard has ended, or hangs: it was there, so no option is wrong
            raise terminal.RunError(str(error)) from error
        finally:
            with suppress(DeviceError):  # Ctrl-C in a terminal ends the guard as well
                guard.stop()
            loop.stop()
            if folder is not None and page.samples:
                if why == "interrupted":
                    terminal.log("interrupted; writing the report")
                report = _leave(folder, page, options, walking, limits, why)
            if why is not None:
                _tell(options, page, report, why)
    return _end(options, page, why, lost=folder is not None and report is None)


def _check(options: RobotRun) -> None:
    """Raise `UsageError` for what cannot be, before anything is started."""
    from eagor.robots.safety.limits import Limits

    if options.sim:
        if options.source is not None or options.interface is not None:
            raise terminal.UsageError("--sim brings its own camera and network: leave out --source and --interface")
    elif options.source is None:
        raise terminal.UsageError("a robot needs a camera: --source /dev/video0, rtsp://..., ros:/image; or take --sim")
    elif options.source.startswith(ROS) and "," in options.source and options.rig is None:
        raise terminal.UsageError(
            f"--source {options.source} names several cameras; give --rig with their lenses, and where on the "
            "robot's body these look"
        )
    elif options.deadman == "none" and options.arm and options.interface != INTERFACE:
        raise terminal.UsageError(
            "--deadman none is only for simulated robots (--sim, --interface lo): a real one moves while somebody "
            "holds a switch"
        )
    if not all(abs(each) <= REACH for each in options.mount):  # so is no NaN
        raise terminal.UsageError(
            f"--mount {' '.join(f'{each:g}' for each in options.mount)}; wanted metres forward, left and up from the "
            f"body's centre, each at most {REACH:g} either way"
        )
    checked_seconds(options.seconds)
    oldest = Limits().image_age
    if checked_latency(options.latency) >= oldest:
        raise terminal.UsageError(
            f"--latency {options.latency:g}: the robot never moves by pictures older than {oldest:g} s; wanted seconds "
            "from capture to arrival, less than that"
        )


@contextmanager
def _real(options: RobotRun, spec: str) -> Iterator[Place]:
    from eagor.media.camera_sources import open_camera
    from eagor.media.rig_videos import are_ordinary
    from eagor.media.rigs import read_rig

    source = options.source
    assert source is not None
    rig = None if options.rig is None else read_rig(options.rig)
    stitched = rig is not None and are_ordinary(rig) and wants_panoramas(spec)
    lenses: dict[str, Any] = {"rows": rows_for(spec, options.rows), "rig": rig, "stitched": stitched}

    def camera() -> CameraSource:
        if source.startswith(ROS):  # on the robot's network, not on that of the environment
            from eagor.robots.ros import RosCamera

            network = {"domain": options.domain, "interface": options.interface}
            return RosCamera(source.removeprefix(ROS) or None, latency=options.latency, **lenses, **network)
        found = open_camera(source, latency=options.latency, **lenses)
        if not found.live:
            found.close()
            raise DeviceError(f"--source {source} is a recording; a robot that walks needs a live camera")
        return found

    yield Place(options.domain, options.interface, camera)


@contextmanager
def _simulated(options: RobotRun, query: str, spec: str) -> Iterator[Place]:
    import numpy as np

    from eagor.robots.go2.house import CameraSettings
    from eagor.robots.go2.sim import CAMERA, Rehearsal, SimSettings, SimulatedGo2, clear_start
    from eagor.robots.ros import RosCamera
    from eagor.robots.run_page import Plan

    rows = rows_for(spec, options.rows, PICTURE)
    camera = CameraSettings(rows=rows, rate=PICTURES, latency=options.latency, mount=options.mount)
    start = options.start and (*options.start[:2], math.radians(options.start[2]))
    settings = SimSettings(options.world, options.seed, query, start=start, camera=camera)
    twin = SimulatedGo2(settings)  # knows where things are before the robot starts
    house = twin.house
    assert house is not None
    if settings.start is None:
        settings = replace(settings, start=clear_start(house, twin.targets, np.random.default_rng(options.seed)))
    terminal.log("the simulated robot starts")
    with Rehearsal(settings) as robot:
        terminal.log(f"it stands in {options.world} {options.seed}, on DDS domain {robot.domain} of the interface lo")
        ground = house.ground
        places = [(float(thing.centre[0]), float(thing.centre[1])) for thing in twin.targets]
        plan = Plan(
            ground.free, ground.structure, (float(ground.origin[0]), float(ground.origin[1])), ground.cell, places
        )
        # Its stamps are those of capture.
        yield Place(
            robot.domain,
            INTERFACE,
            lambda: RosCamera(CAMERA.partition(":")[2], domain=robot.domain, interface=INTERFACE, rows=rows),
            robot.truth,
            robot.targets,
            plan,
        )


def _walk(options: RobotRun, steps: Iterator[Step], page: RobotPage, place: Place) -> str:
    """Walk until it is over; why it is."""
    from eagor.robots.safety.gate import ZERO

    begun, there, said, spoke = time.monotonic(), None, None, -math.inf
    longest = options.seconds or (LONGEST if options.sim else math.inf)
    for step in steps:
        now = time.monotonic()
        sample = _sample(step, now - begun, place)
        frame = step.frame
        picture, grid = (None, None) if frame is None else (frame.picture, frame.grid)
        page.add(sample, picture, step.answer.estimate, grid)
        # Where the gate has no objection, why it stands is what the policy says.
        why = (sample.words,) if sample.reasons == (ZERO,) else sample.reasons
        words = f"{sample.mode}, {sample.doing}: {'; '.join(why) or sample.words}"
        told = sample.mode, sample.doing, why[:1] and why[0][:12]  # no numbers, which change all the time
        if told != said and (now - spoke >= QUIET or sample.mode in LOUD):
            said, spoke = told, now
            terminal.log(f"{sample.time:6.2f} s  {words}")
        there = (there or now) if sample.doing == "arrived" else None
        if there is not None and now - there >= THERE and not options.stay:
            return "arrived"
        if now - begun >= longest:
            return "time"
    return "ended"


def _sample(step: Step, seconds: float, place: Place) -> Sample:
    import numpy as np

    from eagor.robots.run_page import Sample

    estimate, state = step.answer.estimate, step.state
    known = estimate.direction is not None
    far = step.sight.distance if step.sight.distance is not None and math.isfinite(step.sight.distance) else None
    error, true_xy = None, None
    if (truth := place.truth()) is not None:
        at, world_R_body = truth
        true_xy = float(at[0]), float(at[1])
        targets = np.asarray(place.targets())
        if estimate.direction is not None and len(targets):
            ways = (targets - at) / np.linalg.norm(targets - at, axis=1, keepdims=True)
            error = float(np.arccos(np.clip(ways @ (world_R_body @ estimate.direction), -1, 1)).min())
    return Sample(
        seconds, estimate.status, estimate.presence, estimate.azimuth, estimate.credible_angle if known else None,
        far, step.wish.doing, step.wish.words, step.wish.velocity.parts,
        None if state.sent is None else state.sent.parts, state.stops, state.mode, state.reasons, state.speed,
        state.turn, step.sight.xy, step.sight.yaw or 0.0, true_xy, error,
    )  # fmt: skip


def _leave(
    folder: Path, page: RobotPage, options: RobotRun, walking: WalkSettings, limits: Limits, why: str | None
) -> Path | None:
    """The report: report.html and run.json. None if they cannot be written, which is said.

    That raises nothing: what ended the walk matters more.
    """
    from eagor._files import written
    from eagor.robots.run_page import summary

    record = {
        "query": options.query, "ended": why, "armed": options.arm, "simulated": options.sim, "used": page.used,
        "summary": summary(page.samples), "walking": asdict(walking), "limits": asdict(limits),
        "samples": [_plain(asdict(sample)) for sample in page.samples],
    }  # fmt: skip
    try:
        written(folder / "run.json", json.dumps(record, ensure_ascii=False, allow_nan=False))
        report = page.write(folder / "report.html")
    except (EagorError, OSError) as error:
        terminal.error(f"no report: {error}")
        return None
    terminal.log(f"report: {report}")
    return report


def _plain(value: Any) -> Any:
    """Numbers that are not finite as None, and none longer than it needs to be."""
    if isinstance(value, float):
        return round(value, 5) if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value


def _held(page: RobotPage) -> str:
    """For how long the gate did not let it go, and why at last; nothing if that was short."""
    samples = page.samples
    held = [each for each in samples if any(each.wanted) and each.mode != "armed" and each.reasons]
    if len(held) < HELD * len(samples):
        return ""
    share, why = len(held) / len(samples), held[-1].reasons[0]
    return (
        f"; for {100 * share:.0f} % of the time the gate held it, last because {why}. "
        "Where ages are too high, this machine is too slow or too busy for the simulation"
    )


def _tell(options: RobotRun, page: RobotPage, report: Path | None, why: str) -> None:
    """Say on stdout how it ended."""
    from eagor.robots.run_page import summary

    facts, last = summary(page.samples), page.samples[-1].words if page.samples else "there was no answer"
    if options.json:
        where = None if report is None else str(report)
        terminal.emit({"query": options.query, "ended": why, "report": where, "at_the_end": last} | facts)
    elif facts:
        print(f"{why}: {last}; {facts['metres']:.2f} m in {facts['seconds']:.1f} s")


def _end(options: RobotRun, page: RobotPage, why: str | None, lost: bool) -> int:
    """The exit code; `lost`: there should be a report, and is none."""
    if not page.samples:
        raise terminal.RunError("there was no answer")
    seconds, last = page.samples[-1].time - page.samples[0].time, page.samples[-1]
    if why == "time" and options.sim and options.arm and last.doing != "arrived":
        raise terminal.RunError(f"it did not get there in {seconds:.0f} s: {last.words}{_held(page)}")
    return terminal.FAILED if lost else terminal.OK
