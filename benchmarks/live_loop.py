"""What the live loop costs beside the perception: poses, evidence, answers.

python benchmarks/live_loop.py                    # CPU per simulated second, as fast as it goes
python benchmarks/live_loop.py --positions        # the same with positions (distances are tracked too)
python benchmarks/live_loop.py --in-turn          # a picture is searched for one of the targets
python benchmarks/live_loop.py --turning          # a camera that turns, in real time: do cones hold the truth?
python benchmarks/live_loop.py --clip CLIP --query tv --checkouts . ../before   # `eagor live` with coco, in turns

--runs of each kind of turn, with other things and other --photographs, each of so many --seconds.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import common
import numpy as np

from eagor import DetectorModel, Evidence
from eagor.live.core import LiveCore, LoopSettings
from eagor.live.events import ImageReceived, ObservationReceived, PoseReceived, Tick
from eagor.sources import Frame, Pose
from eagor.sources.panorama import read_panorama
from eagor.sphere import angular_distance, unit, world_R_body
from eagor.tracking import TrackerConfig

POSES, LOOKS, ANSWERS, TARGETS = 200, 10, 50, 3  # per second, and how many things are followed
LATENCY = 0.4  # seconds from a picture to its evidence
TURN, SPEED = 0.5, 0.3  # radians and metres per second
FINER = 8  # columns of the turntable's picture for each one that is shown
QUERIES = tuple(f"thing {number}" for number in range(TARGETS))


def pose(now: float, positions: bool) -> Pose:
    """The body walks a circle and trots."""
    tilt = 0.03 * np.sin(2 * np.pi * 3 * now)
    angle = TURN * now
    where = np.array([SPEED / TURN * np.sin(angle), SPEED / TURN * (1 - np.cos(angle)), 0.4]) if positions else None
    return Pose(now, world_R_body(angle, tilt, tilt), where)


def looks(draw: np.random.Generator, world: np.ndarray, at: Pose) -> list[Evidence]:
    """What a detector says of each thing ``(n, 3)``, metres: sometimes missed, sometimes elsewhere too."""
    found = []
    for thing in world:
        directions = []
        if draw.random() < 0.85:
            seen = thing - (np.zeros(3) if at.position is None else at.position)
            directions.append(seen / np.linalg.norm(seen) + 0.03 * draw.normal(size=3))
        directions += [draw.normal(size=3) for _ in range(draw.poisson(0.2))]
        body = np.array(directions).reshape(-1, 3) @ at.world_R_body
        scores = draw.uniform(0.4, 0.95, len(body))
        found.append(Evidence.from_points(body, scores=scores, stamp=at.stamp))
    return found


def use(answer) -> None:
    """What the status line and the lines of JSON take from an answer."""
    estimate = answer.estimate
    _ = answer.status_words, answer.direction, estimate.credible_angle, estimate.presence, estimate.modes


class Run:
    """Events of a simulated run, handed to a core second by second."""

    def __init__(self, positions: bool, in_turn: bool) -> None:
        self.in_turn = in_turn
        self.core = LiveCore(LoopSettings(QUERIES, TrackerConfig(history=60.0)))  # as the loop has it
        self.draw, self.positions, self.second = np.random.default_rng(0), positions, 0
        angles = 2 * np.pi * np.arange(TARGETS) / TARGETS
        self.world = np.stack([4 * np.cos(angles), 4 * np.sin(angles), 0.2 * np.ones(TARGETS)], axis=-1)
        self.made = 0.0  # seconds of CPU that making the events took, which is not the loop's
        self.waiting: list[ObservationReceived] = []

    def one_second(self) -> None:
        """Take in a second of events."""
        events, began = [], time.process_time()
        for number in range(POSES):
            now = self.second + number / POSES
            events.append(PoseReceived(now, pose(now, self.positions)))
        for number in range(LOOKS):
            now = self.second + number / LOOKS
            events.append(ImageReceived(now, now, ""))
            seen = looks(self.draw, self.world, pose(now, self.positions))
            come = list(zip(QUERIES, seen, strict=True))
            come = come[number % TARGETS :][:1] if self.in_turn else come
            self.waiting += [ObservationReceived(now + LATENCY, now, now, query, (look,)) for query, look in come]
        events += [Tick(self.second + number / ANSWERS) for number in range(ANSWERS)]
        end = self.second + 1
        events += [event for event in self.waiting if event.arrival < end]
        self.waiting = [event for event in self.waiting if event.arrival >= end]
        events.sort(key=lambda each: each.arrival)
        self.made += time.process_time() - began
        for event in events:
            for answer in self.core.take(event):
                use(answer)
        self.second += 1


def cost(positions: bool, in_turn: bool, seconds: int) -> None:
    run = Run(positions, in_turn)
    for _ in range(3):
        run.one_second()  # tables are made and cached
    shares = []
    for _ in range(seconds):
        run.made, began = 0.0, time.process_time()
        run.one_second()
        shares.append(100 * (time.process_time() - began - run.made))
    where = "with positions" if positions else "without positions"
    about = f"{'one' if in_turn else 'each'} of {TARGETS} targets"
    print(
        f"{POSES} Hz poses {where}, {LOOKS} Hz evidence about {about}, {ANSWERS} Hz answers: "
        f"{np.mean(shares):.1f} % of one core (quietest second {min(shares):.1f} %)"
    )


class Turntable:
    """A camera that turns at `rate` (radians per second): ten pictures a second of a photograph, 480 x 240."""

    latency, dropped, live = 0.0, 0, True

    def __init__(self, photograph: Path, rate: float) -> None:
        import cv2

        picture = read_panorama(photograph)
        wide = cv2.resize(picture, (FINER * 480, 240), interpolation=cv2.INTER_AREA)
        self.wide = cv2.blur(wide, (FINER, 1))  # each column shows as much as one of the picture does
        self.rate, self.over = rate, False

    def __iter__(self):
        next_time = time.time()
        while not self.over:
            next_time += 1 / LOOKS
            time.sleep(max(0.0, next_time - time.time()))
            now = time.time()
            columns = np.arange(480) * FINER - round(self.rate * now / (2 * np.pi) * self.wide.shape[1])
            shown = np.ascontiguousarray(self.wide[:, columns % self.wide.shape[1]])
            yield Frame(now, shown, str(now))

    def close(self) -> None:
        self.over = True


class Compass:
    """200 poses a second of a turntable."""

    def __init__(self, rate: float) -> None:
        self.rate, self.over = rate, False

    def __iter__(self):
        while not self.over:
            time.sleep(1 / POSES)
            now = time.time()
            yield Pose(now, world_R_body(self.rate * now))

    def close(self) -> None:
        self.over = True


class Noisy:
    """A detector that errs as its model says, and takes 0.3 seconds: it knows where the camera points by itself."""

    def __init__(self, rate: float, model: DetectorModel) -> None:
        self.rate, self.model, self.draw = rate, model, None

    def __call__(self, panorama, query, *, stamp=None):
        self.draw = self.draw or np.random.default_rng(int(query.split()[-1]))
        time.sleep(0.1)
        found = []
        if self.draw.random() < self.model.detection_probability:
            found.append(bearing(query) + self.model.spread * self.draw.normal(size=3))
        found += [self.draw.normal(size=3) for _ in range(self.draw.poisson(self.model.false_alarms_per_look))]
        seen = unit(np.array(found).reshape(-1, 3)) @ world_R_body(self.rate * stamp)
        return Evidence.from_points(seen, detector=self.model, stamp=stamp)


def bearing(query: str) -> np.ndarray:
    """Where in the world the thing of a query is: a unit vector ``(3,)``."""
    return unit(np.random.default_rng(int(query.split()[-1]) + 1000).normal(size=3) * [1, 1, 0.3])


def turning(photographs: Path, seconds: float, runs: int) -> None:
    """Print a table: a turning camera, with odometry of 200 poses a second and with poses from its pictures."""
    from eagor.live.loop import Loop

    model = DetectorModel(detection_probability=0.9, false_alarms_per_look=0.1, spread=np.radians(3))
    files = sorted(photographs.glob("*.png"))
    print("poses     deg/s  in cone  error  cone  answers/s  late  CPU  pose age: median, 99 %, longest (s)")
    for odometry in (True, False):
        for degrees in (0, 15, 45, 90):
            rate, rows, gaps, used = np.radians(degrees), [], [], 0.0
            for run in range(runs):
                queries = tuple(f"thing {TARGETS * run + number}" for number in range(TARGETS))
                camera = Turntable(files[run % len(files)], rate)
                poses = Compass(rate) if odometry else "auto"
                loop = Loop(camera, poses, Noisy(rate, model), queries)
                begun = cpu = last = None
                for answer in loop:
                    use(answer)
                    if begun is None and loop.counts.looks >= 6 * TARGETS:
                        begun, cpu = answer.stamp, time.process_time()
                    if begun is None or answer.direction is None:
                        continue
                    pointed = world_R_body(rate * answer.stamp)
                    off = angular_distance(answer.direction, bearing(answer.query) @ pointed)
                    rows.append((off, answer.estimate.credible_angle, answer.pose_age))
                    if answer.query == queries[0]:
                        gaps += [] if last is None else [answer.stamp - last]
                        last = answer.stamp
                    if answer.query == queries[-1] and answer.stamp - begun > seconds:
                        used += time.process_time() - cpu
                        loop.stop()
            off, cone, age = np.array(rows).T
            print(
                f"{'odometry' if odometry else 'pictures'} {degrees:6d} {100 * np.mean(off <= cone):6.0f} % "
                f"{np.degrees(np.median(off)):6.1f} {np.degrees(np.median(cone)):5.1f} {1 / np.mean(gaps):10.1f} "
                f"{100 * np.mean(np.array(gaps) > 0.1):4.0f} % {100 * used / (runs * seconds):3.0f} %  "
                f"{np.median(age):.3f} {np.quantile(age, 0.99):.3f} {age.max():.3f}",
                flush=True,
            )


def commands(clip: Path, query: str, checkouts: list[str], seconds: int, runs: int) -> None:
    """Print what `eagor live` uses on a film with coco in its process: of each checkout, one after the other."""
    command = [sys.executable, "-m", "eagor", "live", str(clip.resolve()), query, "--perception", "coco", "--json"]
    command += ["--seconds", str(seconds)]
    used: dict[str, list[float]] = {checkout: [] for checkout in checkouts}
    answers = {checkout: 0 for checkout in checkouts}
    for _ in range(runs):
        for checkout in checkouts:
            environment = os.environ | {"PYTHONPATH": str(Path(checkout, "src").resolve())}
            streams = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
            with subprocess.Popen(command, env=environment, **streams) as running:
                answers[checkout] += sum(b'"status"' in line for line in running.stdout)
                _, status, usage = os.wait4(running.pid, 0)  # with the detector's process
                running.returncode = os.waitstatus_to_exitcode(status)
            used[checkout].append(usage.ru_utime + usage.ru_stime)
    for checkout, times in used.items():
        ratios = common.mean_of(np.divide(times, used[checkouts[0]]))
        print(
            f"{checkout}: {np.mean(times):.1f} s of CPU, start and detector with it, {answers[checkout] / runs:.0f} "
            f"answers in {seconds} s; times the first: {ratios[0]:.2f} [{ratios[1]:.2f}, {ratios[2]:.2f}]"
        )


def main() -> None:
    known: dict[str, Any] = {"clip": Path, "query": "tv", "checkouts": ["."]}
    known |= {"seconds": 20, "positions": False, "in_turn": False, "turning": False, "runs": 4}
    given = common.parser(__doc__, photographs=common.PANORAMAS, **known).parse_args()
    if given.clip:
        commands(given.clip, given.query, given.checkouts, given.seconds, given.runs)
    elif given.turning:
        turning(given.photographs, given.seconds, given.runs)
    else:
        cost(given.positions, given.in_turn, given.seconds)


if __name__ == "__main__":
    main()
