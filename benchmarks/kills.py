"""What is killed or frozen at any moment: runs come to what they would have come to, and a robot comes to stand.

    python benchmarks/kills.py [--kills 20] [--workers 2] [--engine processes] [--task waypoint] [--data DIR]
                               [--who all parent worker] [--episodes 10] [--perception truth:miss=0.5] [--seed 0]
    python benchmarks/kills.py --robot [--repeats 3]

Runs: one is made without a stop. Then the same is run into another folder, killed (kill -9) at a moment drawn evenly
from the time that the first one took, and started again, until it is complete; and so on until there were so many
kills. `all` kills every process of the run, `parent` only the one that was started (its workers have to leave by
themselves), `worker` only one worker (the run itself has to go on). After each kill the log must be readable, with
everything that it held before; at the end the records must be those of the run without a stop, but for the times that
things took and, where a worker was killed, the number of the attempt. Benchmarks take their published files from
--data. Linux.

--robot: whole processes walk a simulated Go2 in a circle over DDS at 0.5 m/s and 0.3 rad/s: the program (the live loop
with its odometry, and the steering), the guard, the detector (`colour`), and a camera with ten pictures per second,
which arrive 0.1 s after their capture. Each is killed (SIGKILL), and frozen for 4 s (SIGSTOP); then there is a
recording, and the disk is full. The table has the seconds from then until nothing is commanded any more, and until the
body is below 0.05 m/s and 0.05 rad/s, by this machine's monotonic clock; the body has the dead time and the lag of a
real Go2.

Exit code 1 where something else is found than promised.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import common
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from processes import alive, sessions_of

from eagor.lab.eval import log

PATIENCE = 240.0  # seconds that processes have to leave (agents of Ray take more than one minute)
TIMES = ("seconds", "ms", "milliseconds")
SIMULATED = ("waypoint", "navigation", "tracking")


def check(holds: bool, what: str) -> None:
    """Stop with exit code 1 unless it holds."""
    if not holds:
        sys.exit(f"FAILED: {what}")


def begun(options: argparse.Namespace, out: Path) -> subprocess.Popen[bytes]:
    """The run, begun in a session of its own, so that what belongs to it can be found."""
    words = [sys.executable, "-m", "eagor", "bench", "run", options.task, "--perception", options.perception]
    words += ["--workers", str(options.workers), "--engine", options.engine, "--out", str(out), "--json"]
    if options.task in SIMULATED:
        words += ["--episodes", str(options.episodes), "--methods", "eagor", "vmf", "--rows", "32"]
    else:
        words += ["--data", str(options.data), "--limit", str(options.episodes)]
    return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True)


def ended(run: subprocess.Popen[bytes], what: str, patience: float | None = None) -> None:
    """Check that a run ends well."""
    _, said = run.communicate(timeout=patience)
    check(run.returncode == 0, f"{what} ended with {run.returncode}: {said.decode()[-500:]}")


def kill(who: str, run: subprocess.Popen[bytes], sessions: set[int], luck: random.Random) -> bool:
    """Kill; False if there was nobody to be killed any more."""
    victims = [run.pid]
    if who == "worker":
        workers = [one for one, words in alive(sessions).items() if "--multiprocessing-fork" in words]
        victims = [luck.choice(workers)] if workers else []
    elif who == "all":  # the parent first: it would record that others have died
        victims = sorted(alive(sessions), key=lambda one: one != run.pid)
    if not victims or run.poll() is not None:
        return False
    for victim in victims:
        with suppress(ProcessLookupError):
            os.kill(victim, signal.SIGKILL)
    return True


def timeless(value: Any) -> Any:
    """A record without the times that its parts took, however deep they stand."""
    if isinstance(value, dict):
        return {key: timeless(inner) for key, inner in value.items() if key not in TIMES}
    return [timeless(inner) for inner in value] if isinstance(value, list) else value


def records(folder: Path) -> dict[str, dict]:
    """The records by key, without times."""
    return {record["key"]: timeless(record) for record in (log.read(folder) if folder.exists() else ())}


def same(found: dict[str, dict], wanted: dict[str, dict], who: list[str]) -> None:
    """Check the records of a run that was killed against those of one that was not."""
    if "worker" in who:
        found, wanted = ({k: v | {"attempt": 0} for k, v in each.items()} for each in (found, wanted))
    odd = [key for key in found.keys() | wanted.keys() if found.get(key) != wanted.get(key)]
    check(not odd, f"{len(odd)} of {len(wanted)} records differ, such as {sorted(odd)[:3]}")


def runs(options: argparse.Namespace, home: Path) -> None:
    """Run, kill, go on, compare."""
    luck, start, out = random.Random(options.seed), time.monotonic(), home / "killed"
    ended(begun(options, home / "whole"), "the run without a stop")
    long, wanted = time.monotonic() - start, records(home / "whole")
    print(f"{len(wanted)} records in {long:.1f} s without a stop")
    kills = done = caught = 0
    while kills < options.kills:
        before, who = records(out), options.who[kills % len(options.who)]
        run = begun(options, out)
        time.sleep(luck.uniform(0, long))
        sessions = sessions_of(run.pid)
        hit = kill(who, run, sessions, luck)
        if not hit or who == "worker":
            ended(run, "a run that lost a worker" if hit else "a run that nobody killed", 3 * PATIENCE)
        else:
            run.communicate(timeout=3 * PATIENCE)  # ends when the last process of the run has left
        end = time.monotonic() + PATIENCE
        while (there := alive(sessions)) and time.monotonic() < end:
            time.sleep(0.05)
        check(not there, f"processes were left behind: {there}")
        after = records(out)
        lost = [(record, after.get(key)) for key, record in before.items() if after.get(key) != record]
        check(not lost, f"records were lost or changed by a kill: {lost}")
        kills, caught = kills + hit, caught + (hit and 0 < len(after) < len(wanted))
        if not hit or who == "worker":
            same(after, wanted, options.who)
            done += 1
            shutil.rmtree(out)
    ended(begun(options, out), "the last run")
    same(records(out), wanted, options.who)
    print(
        f"{kills} kills ({', '.join(options.who)}), {caught} of them with some but not all records written; {done + 1} "
        f"runs completed, each with the {len(wanted)} records of the run without a stop; no process left behind"
    )


# --- the robot --------------------------------------------------------------------------------------------------------

SPEED, TURN, FROZEN = 0.5, 0.3, 4.0  # m/s and rad/s of the circle; seconds for which a process is frozen
RATE, ARRIVES = 10.0, 0.1  # pictures per second, and seconds from capture to arrival
MOST = {"program": 0.25, "guard": 0.5, "detector": 2.25, "camera": 0.75}  # seconds until zero, at most


def program(domain: int, folder: str) -> None:
    """The program that steers: says the numbers of its processes, and what becomes of its recording."""
    from eagor.live.loop import Loop
    from eagor.robots import Go2Poses
    from eagor.robots.go2.camera import DdsCamera
    from eagor.robots.go2.house import CAMERA_TOPIC
    from eagor.robots.safety.guard import Guard
    from eagor.robots.safety.walking import Odometer, WalkSettings, steer

    class Circling(Guard):
        """A guard that always wants the same velocity, for a thing that is always there; the ages are the loop's."""

        def set_velocity(self, *_: float) -> None:
            super().set_velocity(SPEED, 0.0, TURN)

        def report(self, *, presence: float | None, **known: Any) -> None:
            super().report(presence=None if presence is None else 1.0, **known)

    with Circling(armed=True, remote=False, domain=domain, interface="lo") as guard:
        odometer = Odometer(guard, lambda: loop.clock.now())
        loop = Loop(
            lambda: DdsCamera(CAMERA_TOPIC, domain, "lo"), lambda: Go2Poses(domain, "lo"), "colour", "red chair", True,
            [odometer], record=Path(folder) if folder else None,
        )  # fmt: skip
        said: set[str] = set()
        for step in steer(loop, guard, odometer, WalkSettings()):
            words = loop.recording_problem or ""
            if not said and math.isfinite(step.answer.look_age):
                words = json.dumps({"guard": guard.pid, "detector": loop._inference._worker.process.pid})
            if words and words not in said:
                print(words, flush=True)
                said.add(words)


def camera(domain: int, _: str) -> None:
    """The camera: a painted room far away, which turns as the robot does."""
    from eagor.lab.worlds.painted import painted_room
    from eagor.robots.dds import Participant
    from eagor.robots.go2.camera import PICTURE, picture_message
    from eagor.robots.go2.house import CAMERA_FRAME, CAMERA_TOPIC
    from eagor.robots.go2.sim import TRUTH
    from eagor.robots.go2.state import Odometry
    from eagor.sources.ros_messages import pose_from_msg
    from eagor.sphere import heading

    room, turned = painted_room(128, 256), [0.0]
    with Participant(domain, "lo") as link:
        link.subscribe(TRUTH, Odometry, lambda message, _: turned.append(heading(pose_from_msg(message).world_R_body)))
        writer = link.publish(CAMERA_TOPIC, PICTURE)
        while True:
            stamp, columns = time.time(), round(turned[-1] / (2 * math.pi) * room.shape[1])
            time.sleep(ARRIVES)
            writer.write(picture_message(np.roll(room, columns, axis=1), stamp, CAMERA_FRAME))
            time.sleep(max(0.0, stamp + 1 / RATE - time.time()))


class Walk:
    """The robot, and the processes that walk it, anew for each fault; a context manager. `pids`: by their names.

    `recorded`: whether the program keeps a recording; `told`: what it says.
    """

    def __init__(self, recorded: bool = False) -> None:
        self.recorded = recorded

    def __enter__(self) -> Walk:
        from go2_peer import Peer
        from guard_driving import fast_enough

        from eagor.robots.dds import free_domain

        with ExitStack() as stack:
            self.robot = stack.enter_context(Peer(free_domain()))
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="eagor-kills-"))
            record = f"{folder}/walk" if self.recorded else ""
            for name in ("camera", "program"):
                words = [sys.executable, __file__, "--part", name, str(self.robot.link.domain), record]
                process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
                stack.callback(process.wait)
                stack.callback(process.kill)
                self.pids = {"camera": process.pid} if name == "camera" else self.pids | {"program": process.pid}
            self.told = process.stdout
            self.pids |= json.loads(self.told.readline())
            fast_enough(self.robot, (SPEED, 0.0, TURN), PATIENCE)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(ProcessLookupError):  # one that was frozen
            os.kill(self.pids["guard"], signal.SIGCONT)
        self._stack.close()


def robot(repeats: int) -> None:
    """The table of the robot."""
    from guard_driving import measured

    late = []
    print("| fault | zero, median (s) | zero, longest | standing, median | standing, longest | at most |")
    print("|---|---:|---:|---:|---:|---:|")
    for whom, most in MOST.items():
        for how in (signal.SIGKILL, signal.SIGSTOP):
            took = []
            for _ in range(repeats):
                with Walk() as walk:
                    begun = time.monotonic()
                    os.kill(walk.pids[whom], how)
                    took.append(measured(walk.robot, begun))
                    if how == signal.SIGSTOP:
                        time.sleep(max(0.0, begun + FROZEN - time.monotonic()))
                        os.kill(walk.pids[whom], signal.SIGCONT)
            zero, standing = np.array([(each.zero, each.standing) for each in took]).T
            name = f"{whom} {'killed' if how == signal.SIGKILL else 'frozen'}"
            values = (np.median(zero), zero.max(), np.median(standing), standing.max(), most)
            print(f"| {name} | {' | '.join(f'{value:.2f}' for value in values)} |", flush=True)
            late += [name] if zero.max() > most else []
    with Walk(recorded=True) as walk:
        resource.prlimit(walk.pids["program"], resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
        words, begun = walk.told.readline().strip(), time.monotonic()
        time.sleep(3.0)
        check(any(told.when > begun + 2.5 and any(told.velocity or ()) for told in walk.robot.told), "it stands")
        print(f"disk full: it walks on, and says: {words}")
    check(not late, f"too late: {', '.join(late)}")


def parsed() -> argparse.Namespace:
    """The options."""
    known = {"kills": 20, "workers": 2, "task": "waypoint", "data": Path, "episodes": 10, "seed": 0}
    parser = common.parser(__doc__, perception="truth:miss=0.5", robot=False, repeats=3, **known)
    parser.add_argument("--engine", choices=["processes", "ray"], default="processes")
    parser.add_argument("--who", nargs="+", choices=["all", "parent", "worker"], default=["all"])
    parser.add_argument("--part", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.task not in SIMULATED and options.data is None:
        parser.error(f"{options.task} needs --data")
    if "worker" in options.who and options.engine == "ray":
        parser.error("Ray's workers look after themselves; --engine ray takes --who all parent")
    if "worker" in options.who and options.workers < 2:
        parser.error("one worker is the run itself; --who worker wants --workers 2 or more")
    return options


if __name__ == "__main__":
    told = parsed()
    if told.part:
        {"camera": camera, "program": program}[told.part[0]](int(told.part[1]), told.part[2])
    elif told.robot:
        robot(told.repeats)
    else:
        with tempfile.TemporaryDirectory(prefix="eagor-kills-") as place:
            runs(told, Path(place))
