"""``eagor robot run``: walk a Go2 to an object, through the safety gate."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from eagor.cli import checks, terminal
from eagor.cli.options import Flag, Looking, Name, Static, Whole, bare, refuse
from eagor.errors import DeviceError

if TYPE_CHECKING:
    from eagor.live.loop import Loop
    from eagor.robots.go2.sim import Rehearsal
    from eagor.robots.safety.walking import Step
    from eagor.sources import CameraSource


@dataclass(frozen=True, kw_only=True)
class RobotRun(Looking):
    """Walk a Unitree Go2 to an object. Without --arm nothing is commanded: a dry run says what it would do.

    Before the first --arm try it with --sim, a simulated robot, then without --arm. Clear five metres around the robot
    and have its remote control in your hand: L2+B makes it limp. It sees no stairs, glass, cables or people: you do.
    """

    query: Annotated[str, Positional, arg(metavar="QUERY")]
    """What to walk to, in words."""
    sim: Flag = False
    """A simulated Go2 in a built-in apartment, on this machine alone (interface lo, a free DDS domain)."""
    arm: Flag = False
    """Let the robot move. Somebody has to hold the dead-man switch."""
    deadman: Annotated[Literal["remote", "none"] | None, bare("SWITCH")] = None
    """Held while it may move: remote (L1 of its remote control; the default), none (--sim, simulated robots)."""
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
    seconds: Annotated[float | None, bare("SECONDS")] = None
    """Stop after this time (default: 240 with --sim, else at Ctrl-C)."""
    stay: Flag = False
    """Go on when it has arrived: follow the thing if it moves (default: end 2 s after it has arrived)."""
    record: Annotated[Path | None, bare("DIR")] = None
    """A new folder for a bag of all that happens: pictures, poses, answers (as for `eagor live`)."""
    patience: Annotated[float, arg(metavar="SECONDS")] = 10.0
    """Time that one look may take; then the detector is ended and started anew."""
    latency: Annotated[float, arg(metavar="SECONDS")] = 0.15
    """Time from capture to arrival of the camera's pictures."""
    rows: Annotated[int | None, bare("N")] = None
    """Rows of the pictures at most."""
    mount: Annotated[tuple[float, float, float], arg(metavar="X Y Z")] = (0.0, 0.0, 0.4)
    """Where the camera is on the body: metres forward, left and up from the body's centre."""
    odometry: Annotated[Literal["sport", "slow", "lidar"], arg(metavar="NAME")] = "sport"
    """Odometry of the robot: sport (its state, 200 Hz), slow (the same at 20 Hz), lidar."""
    seed: Whole = 7
    """--sim: the apartment, 0 to 1999, and what chance decides."""
    start: Annotated[tuple[float, float, float] | None, bare("X Y DEG")] = None
    """--sim: where it starts, metres, and its heading (default: somewhere with a free way to the object)."""
    world: Name = "apartment"
    """--sim: apartment, an installed world, or a GLB file."""
    static: Static = False


ROS, INTERFACE = "ros:", "lo"
DEADMEN = {
    "remote": "hold L1 on the robot's remote control; B stops for good, start releases that",
    "none": "nobody holds anything: only for a simulated robot",
}
RATE = 20.0  # answers, and so commands, per second
THERE = 2.0  # seconds for which it has to have arrived
QUIET, LOUD = 1.0, ("stopping", "latched")  # seconds between two lines; modes that are told at once
LONGEST = 240.0  # seconds of a simulated walk: a busy machine needs many
SWAY = 0.1  # metres: a robot that walks sways, so only what adds up is a way
PICTURE, PICTURES = 128, 8.0  # rows of a simulated picture, and pictures per second
REACH = 2.0  # metres from the body's centre at which no camera is any more: a Go2 is 0.7 m long
FLOOR = 0.0  # metres: the odometry of a Go2 begins on the floor


@dataclass(frozen=True)
class Place:
    """Where to walk: the robot's network, its camera, and the `robot` itself, which knows the truth, if simulated."""

    domain: int
    interface: str | None
    camera: Callable[[], CameraSource]
    robot: Rehearsal | None = None


@dataclass
class Summary:
    """What is told at the end: why it ended, what the policy said last, seconds, metres by odometry, StopMove sent.

    `errors`: angles between answer and truth while it was tracking, where the truth is known, degrees.
    """

    ended: str = "interrupted"
    doing: str = ""
    words: str = "there was no answer"
    seconds: float = 0.0
    metres: float = 0.0
    stops: int = 0
    errors: list[float] = field(default_factory=list)
    mark: tuple[float, float] | None = None

    def add(self, step: Step, seconds: float, robot: Rehearsal | None) -> None:
        """One answer, `seconds` after the start."""
        import numpy as np

        from eagor.sphere import angular_distance

        command, estimate, xy = step.command, step.answer.estimate, step.view.xy
        self.doing, self.words, self.seconds, self.stops = command.doing, command.words, seconds, step.state.stops
        if xy is not None and (self.mark is None or math.dist(xy, self.mark) >= SWAY):
            self.metres += 0.0 if self.mark is None else math.dist(xy, self.mark)
            self.mark = xy
        toward = estimate.direction if estimate.status == "tracking" else None
        if robot is not None and robot.truth is not None and toward is not None and len(robot.targets):
            at, world_R_body = robot.truth
            angles = angular_distance(robot.targets - at, world_R_body @ toward)
            self.errors.append(math.degrees(float(np.min(angles))))

    def tell(self, query: str, as_json: bool) -> None:
        """Say it on stdout."""
        from statistics import median

        found = {"query": query} | {
            name: getattr(self, name) for name in ("ended", "doing", "words", "seconds", "metres", "stops")
        }
        found["median_error_deg"] = median(self.errors) if self.errors else None
        words = f"{self.ended}: {self.words}; {self.metres:.2f} m in {self.seconds:.1f} s"
        terminal.give(as_json, found, words)


def robot_run(options: RobotRun) -> int:
    """``eagor robot run``."""
    from eagor.live.loop import Loop
    from eagor.robots import Go2Poses
    from eagor.robots.safety.guard import Guard
    from eagor.robots.safety.walking import Odometer, WalkSettings, steer

    query = checks.checked_query(options.query)
    _check(options)
    # In a rendered house the network for such pictures is better than a colour alone.
    spec = "scout" if options.sim and options.perception is None else checks.perception_for([query], options.perception)
    checks.check_looks(spec)
    config = replace(checks.tracker_config(spec, options), floor_height=FLOOR)
    mask = checks.mask_of(options.mask)
    deadman = options.deadman or ("none" if options.sim or not options.arm else "remote")
    walking = WalkSettings(distance=options.distance, speed=options.speed, blind=options.blind)
    loops: list[Loop] = []
    summary = Summary()
    # As soon as the loop ends, nothing stops the cleanup any more.
    with terminal.unhurried(lambda: any(each.stopped for each in loops)), ExitStack() as stack:
        place = stack.enter_context(_simulated(options, query, spec) if options.sim else _real(options, spec))
        guard = stack.enter_context(
            Guard(
                armed=options.arm, remote=deadman == "remote", domain=place.domain, interface=place.interface,
                avoid=options.avoid, ignored_codes=(0, *options.calm),
            )
        )  # fmt: skip
        odometer = Odometer(guard, lambda: loops[0].clock.now())
        loop = Loop(
            place.camera, lambda: Go2Poses(place.domain, place.interface, options.odometry, options.mount), spec,
            query, True, [odometer], config=config, rate=RATE, patience=options.patience, mask=mask,
            record=options.record,
        )  # fmt: skip
        loops.append(loop)
        terminal.log(f"armed: {DEADMEN[deadman]}" if options.arm else "dry run: nothing is commanded (--arm moves it)")
        try:
            _walk(options, steer(loop, guard, odometer, walking), summary, place)
        except DeviceError as error:  # the guard has ended, or hangs: it was there, so no option is wrong
            summary.ended = "failed"
            raise terminal.RunError(str(error)) from error
        finally:
            with suppress(DeviceError):  # Ctrl-C in a terminal ends the guard as well
                guard.set_velocity(0.0, 0.0, 0.0)
            loop.stop()
            summary.tell(query, options.json)
    if not summary.seconds:
        raise terminal.RunError("there was no answer")
    if summary.ended == "time" and options.sim and options.arm and summary.doing != "arrived":
        raise terminal.RunError(f"it did not get there in {summary.seconds:.0f} s: {summary.words}")
    return terminal.INCOMPLETE if loop.recording_problem else terminal.OK


def _check(options: RobotRun) -> None:
    """Raise `UsageError` for what cannot be, before anything is started."""
    from eagor.robots.safety.limits import Limits

    checks.check_outputs(options)
    source, oldest = options.source, Limits().image_age
    if options.sim:
        refuse(options, ("source", "interface"), "is for a real robot: --sim brings its own camera and network")
    elif source is None:
        raise terminal.UsageError("a robot needs a camera: --source /dev/video0, rtsp://..., ros:/image; or take --sim")
    elif source.startswith(ROS) and "," in source and options.rig is None:
        raise terminal.UsageError(
            f"--source {source} names several cameras; give --rig with their lenses, and where on the robot's body "
            "these look"
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
    if options.latency >= oldest:
        raise terminal.UsageError(
            f"--latency {options.latency:g}: the robot never moves by pictures older than {oldest:g} s; wanted seconds "
            "from capture to arrival, less than that"
        )


@contextmanager
def _real(options: RobotRun, spec: str) -> Iterator[Place]:
    from eagor.sources.camera_sources import open_source

    source, lenses, rows = options.source or "", checks.lens_of(options), checks.rows_for(spec, options.rows)

    def camera() -> CameraSource:
        found = open_source(source, latency=options.latency, rows=rows, **lenses)
        if not found.live:
            found.close()
            raise DeviceError(f"--source {source} is a recording; a robot that walks needs a live camera")
        return found

    yield Place(options.domain, options.interface, camera)


@contextmanager
def _simulated(options: RobotRun, query: str, spec: str) -> Iterator[Place]:
    from eagor.robots.go2.camera import DdsCamera
    from eagor.robots.go2.house import CAMERA_TOPIC
    from eagor.robots.go2.sim import Rehearsal, SimSettings

    rows = checks.rows_for(spec, options.rows, PICTURE)
    start = options.start and (*options.start[:2], math.radians(options.start[2]))
    settings = SimSettings(
        options.world, options.seed, query, start=start, rows=rows, rate=PICTURES, latency=options.latency,
        mount=options.mount,
    )  # fmt: skip
    terminal.log("the simulated robot starts")
    with Rehearsal(settings) as robot:
        terminal.log(f"it stands in {options.world} {options.seed}, on DDS domain {robot.domain} of the interface lo")
        # Its stamps are those of capture.
        yield Place(robot.domain, INTERFACE, lambda: DdsCamera(CAMERA_TOPIC, robot.domain, INTERFACE, rows), robot)


def _walk(options: RobotRun, steps: Iterator[Step], summary: Summary, place: Place) -> None:
    """Walk until it is over."""
    begun, there, said, spoke, lost = time.monotonic(), math.inf, None, -math.inf, False
    longest = options.seconds or (LONGEST if options.sim else math.inf)
    for step in steps:
        now, mode, command = time.monotonic(), step.state.mode, step.command
        summary.add(step, now - begun, place.robot)
        # Where the gate has no objection, why it stands is what the policy says.
        why = step.state.reasons or (command.words,)
        told = mode, command.doing, why[0].partition(":")[0][:16]  # no numbers, which change all the time
        if told != said and (now - spoke >= QUIET or mode in LOUD):
            said, spoke = told, now
            terminal.log(f"{now - begun:6.2f} s  {mode}, {command.doing}: {'; '.join(why)}")
        if not lost and (faults := [each.text for each in step.answer.faults if each.part == "recording"]):
            lost = True
            terminal.warning(faults[0])
        there = min(there, now) if command.doing == "arrived" else math.inf
        if now - there >= THERE and not options.stay:
            summary.ended = "arrived"
            return
        if now - begun >= longest:
            summary.ended = "time"
            return
    summary.ended = "ended"
