"""The paper's dynamic tracking, on a simulated Go2: every method on the same recorded runs.

python benchmarks/dynamic_tracking.py record RUNS [--runs 30] [--seed 8400] [--domain 121]
python benchmarks/dynamic_tracking.py judge RUNS [--workers 2]

Three scenes, each with a red ball in a built-in apartment, in sight at first: the robot stands and the ball rolls; the
robot walks and the ball lies; both move. A run is a ROS 2 bag: the camera's pictures, the robot's own odometry, and,
for the judge alone, the true poses and the ball's true places. The robot, its camera and whoever steers it are
processes that talk over DDS in real time, as with a real Go2: clocks apart, states at 200 Hz, pictures as JPEG; nobody
else may use the ten domains from --domain on. What
steers the robot knows the floor plan and goes from one random place to another: it is the same for all methods.

The perception (`scout`) looks at one picture after the other. It is given 0, 0.4 or 1.6 s for each, as a larger model
would take, and looks at the newest picture whenever it is free. "late" uses a look at the time of its picture; "as new"
takes it for a look at the moment it arrives. Figures are means over runs, with 95 % bootstrap intervals:

- error: degrees, ten times a second, from the first look on.
- TC: how far an answer is, in degrees per 0.1 s, from the one before it, moved as the true bearing moved.
- recovery: seconds from where a ball comes into sight again, after two seconds or more out of sight, until the error is
  below 15 degrees.
- covered: share of the time in which the 90 % region holds the truth.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import shutil
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import common
import numpy as np

from eagor.conventions import rotation_from_xyzw
from eagor.evidence import Evidence
from eagor.lab.agents.methods import NAMES, Estimator, make_estimator
from eagor.lab.worlds.navmesh import along, length_of
from eagor.lab.worlds.render import Renderer
from eagor.perception import load
from eagor.robots.dds import Participant
from eagor.robots.go2.camera import PICTURE
from eagor.robots.go2.house import CAMERA_TOPIC, MOUNT, SimWorld
from eagor.robots.go2.plant import HEIGHT
from eagor.robots.go2.sim import TRUTH as TRUTH_POSE
from eagor.robots.go2.sim import SimSettings, SimulatedGo2
from eagor.robots.go2.sport import SportClient
from eagor.robots.go2.state import BodyState, Go2State, Odometry
from eagor.sources import Pose, bags
from eagor.sources import ros_messages as ros
from eagor.sources.bags import BagWriter
from eagor.sphere import angular_distance, unit
from eagor.tracking.poses import PoseHistory

SCENES = ("standing robot, rolling ball", "walking robot, lying ball", "walking robot, rolling ball")
QUERY, SPEED = "red ball", 0.3  # m/s, of a ball that rolls
SECONDS, SETTLE = 24.0, 1.0  # of a run; before the robot may walk
STEERING, STEP = 10.0, 0.1  # commands per second; seconds between answers
LATENCIES = (0.0, 0.4, 1.6)
DOMAINS = 10
REGIONS = 5  # answers from one check of the region to the next
NEAR, GONE = math.radians(15), 2.0
AHEAD, GAINS = 12.5, 2e-5  # seconds by which the robot's clock is ahead, and seconds per second
EYES = HEIGHT + MOUNT[2]  # metres
IMAGE, ODOMETRY, TRUTH, BALL = "/image/compressed", "/odom", "/truth", "/ball"


@dataclass(eq=False)
class Run:
    """A recorded run: `pictures` and `balls` by stamp, the robot's own poses and the true ones (of the body)."""

    seed: int
    scene: str
    pictures: list[tuple[float, np.ndarray]]
    odometry: PoseHistory
    truth: PoseHistory
    balls: list[tuple[float, np.ndarray]]

    @property
    def begin(self) -> float:
        """From when on all is known."""
        return max(self.pictures[0][0], self.balls[0][0], self.odometry.first, self.truth.first)

    def __post_init__(self) -> None:
        # All methods are asked at the same times.
        self.bearing, self.told = lru_cache(None)(self._bearing), lru_cache(None)(self.odometry.at)
        self.turned = lru_cache(None)(lambda stamp: self.truth.at(stamp)[0])

    def _bearing(self, stamp: float) -> tuple[np.ndarray, np.ndarray]:
        """The true direction ``(3,)`` to the ball in the body frame, and the camera's place ``(3,)``."""
        turn, place = self.truth.at(stamp)
        assert place is not None
        eye = place + turn @ np.asarray(MOUNT)
        return unit(turn.T @ (self.ball(stamp) - eye)), eye

    def ball(self, stamp: float) -> np.ndarray:
        """Where the ball is, ``(3,)``."""
        times = np.array([at for at, _ in self.balls])
        return np.array([np.interp(stamp, times, [where[axis] for _, where in self.balls]) for axis in range(3)])


class Steering:
    """Goes from one random place of the floor to another; where to go next, from where the body truly is."""

    def __init__(self, house: SimWorld, rng: np.random.Generator) -> None:
        self._house, self._rng = house, rng
        self._path = np.zeros((0, 2))

    def towards(self, pose: Pose) -> tuple[float, float, float]:
        """Forward, sideways (m/s), turning (rad/s)."""
        assert pose.position is not None
        xy, ahead = pose.position[:2], pose.world_R_body[:, 0]
        yaw = math.atan2(ahead[1], ahead[0])
        if len(self._path) < 2 or np.linalg.norm(self._path[-1] - xy) < 0.4:
            ground = self._house.ground
            start = ground.snap(xy)
            assert start is not None
            self._path = ground.path(start, ground.sample(self._rng, 0.3))
        nearest = min(
            np.arange(0, length_of(self._path) + 0.1, 0.1), key=lambda way: float(np.linalg.norm(self._at(way) - xy))
        )
        way = self._at(nearest + 0.5) - xy
        turn = math.remainder(math.atan2(way[1], way[0]) - yaw, 2 * math.pi)
        forward = 0.5 if abs(turn) < math.radians(25) else 0.0
        return forward, 0.0, float(np.clip(2.0 * turn, -0.8, 0.8))

    def _at(self, way: float) -> np.ndarray:
        return along(self._path, np.array([way]))[0]


def settings(seed: int, scene: str) -> SimSettings:
    """The robot, its house and its ball. It starts with the ball in sight, 1.5 to 5 m away, with any heading."""
    speed = 0.0 if "lying" in scene else SPEED
    found = SimSettings(seed=seed, target=QUERY, speed=speed, clock_offset=AHEAD, clock_drift=GAINS)
    house, rng = SimulatedGo2(found).house, np.random.default_rng([seed, SCENES.index(scene)])
    assert house is not None
    ball, rays = house.targets[0].centre, Renderer(house.scene).raycaster
    for _ in range(2000):
        spot = house.ground.sample(rng, 0.3)
        eye = np.array([*spot, EYES])
        far = float(np.linalg.norm(ball - eye))
        if 1.5 <= far <= 5.0 and not rays.occluded(eye[None], (ball - eye)[None] / far, np.array([far]))[0]:
            return replace(found, start=(float(spot[0]), float(spot[1]), float(rng.uniform(-math.pi, math.pi))))
    raise RuntimeError(f"{house.scene.source} shows the ball from nowhere")


def _live(ready: Any, settings: SimSettings, domain: int) -> None:
    """A process: the robot on DDS."""
    with SimulatedGo2(settings, domain) as live:
        ready.send(live.begun)
        ready.recv()


def record(seed: int, scene: str, path: Path, domain: int) -> None:
    """Record a run in real time: the robot and its camera are other processes."""
    wanted = settings(seed, scene)
    house = SimulatedGo2(wanted).house  # its ball rolls as the robot's
    assert house is not None
    steering, now_at = Steering(house, np.random.default_rng([seed, 7])), {}
    context = multiprocessing.get_context("spawn")
    line, there = context.Pipe()
    robot = context.Process(target=_live, args=(there, wanted, domain))
    robot.start()
    there.close()
    try:
        begun = line.recv()
        with BagWriter(path) as bag, Participant(domain, "lo") as link:

            def pose(topic: str, found: Pose) -> None:
                bag.write(topic, ros.ODOMETRY, ros.odometry_message(found), found.stamp)

            def state(state: BodyState) -> None:
                pose(ODOMETRY, Pose(state.stamp, state.world_R_body, state.position))

            def true(message: Any, _: float) -> None:
                now_at["pose"] = ros.pose_from_msg(message)
                pose(TRUTH, now_at["pose"])
                now = now_at["pose"].stamp
                ball = house.ball_at(now - begun)
                assert ball is not None
                bag.write(BALL, ros.TEXT, ros.message(ros.TEXT, data=json.dumps([now, *ball.centre.tolist()])), now)

            def picture(message: Any, _: float) -> None:
                received = ros.store().deserialize_cdr(message.data, ros.COMPRESSED)
                bag.write(IMAGE, ros.COMPRESSED, received, ros.stamp_of(received))

            link.subscribe(CAMERA_TOPIC, PICTURE, picture)
            link.subscribe(TRUTH_POSE, Odometry, true)
            states = Go2State(link, received=state)
            sport = SportClient(link)
            states.wait()
            end = time.monotonic() + SECONDS
            settle = time.monotonic() + SETTLE
            while (now := time.monotonic()) < end:
                if "walking" in scene and now >= settle and "pose" in now_at:
                    sport.move(*steering.towards(now_at["pose"]))
                time.sleep(1 / STEERING)
        line.send("end")
    finally:
        robot.join(20)
        if robot.is_alive():
            robot.kill()


def read(path: Path) -> Run:
    """A run as it was recorded."""
    _, seed, scene = path.name.split("-")
    odometry, truth = PoseHistory(math.inf), PoseHistory(math.inf)
    pictures: list[tuple[float, np.ndarray]] = []
    balls: list[tuple[float, np.ndarray]] = []
    for _, topic, _, message in bags.read_bag(path):
        if topic == IMAGE:
            pictures.append((ros.stamp_of(message), ros.image_from_msg(message)))
        elif topic == BALL:
            now, *where = json.loads(message.data)
            balls.append((now, np.array(where)))
        else:
            pose = ros.pose_from_msg(message)
            (odometry if topic == ODOMETRY else truth).add(pose.stamp, pose.world_R_body, pose.position)
    return Run(int(seed), SCENES[int(scene)], pictures, odometry, truth, balls)


def look_at(run: Run, perception: Any) -> list[Evidence]:
    """What the perception says of every picture."""
    return [perception(panorama, QUERY, stamp=stamp) for stamp, panorama in run.pictures if stamp >= run.begin]


def arrivals(looks: Sequence[Evidence], seconds: float) -> list[tuple[float, Evidence]]:
    """When which looks are there, from a perception that takes so long and then takes the newest picture."""
    found, free = [], -math.inf
    for index, look in enumerate(looks):
        assert look.stamp is not None
        begins = max(look.stamp, free)
        following = looks[index + 1].stamp if index + 1 < len(looks) else None
        if following is not None and following <= begins:
            continue  # there is a newer picture by then
        free = begins + seconds
        found.append((free, look))
    return found


def play(run: Run, looks: Sequence[tuple[float, Evidence]], method: Estimator, late: bool) -> dict[str, np.ndarray]:
    """The answers of a method, ten times a second: stamps, directions, mass above the truth (NaN without a belief)."""
    begin, end = run.begin, min(run.pictures[-1][0], run.balls[-1][0])
    grid = begin + STEP * np.arange(1, int((end - begin) / STEP))
    events: list[tuple[float, int, Any]] = [(float(now), 2, None) for now in grid]
    for arrival, look in looks:
        assert look.stamp is not None
        if late:
            events += [(look.stamp, 0, None), (arrival, 1, look)]
        else:
            events += [(arrival, 0, None), (arrival, 1, replace(look, stamp=arrival))]
    stamps, said, mass = [], [], []
    last = -math.inf
    for now, kind, look in sorted(events, key=lambda event: event[:2]):
        if now > end:
            break
        if kind != 1 and now > last:
            turn, place = run.told(now)
            method.move(now, turn, place + turn @ np.asarray(MOUNT))  # type: ignore[operator]
            last = now
        if kind == 1:
            method.see(look)
        if kind == 2:
            stamps.append(now)
            said.append(method.direction())
            above = method.mass_above(run.bearing(now)[0]) if len(stamps) % REGIONS == 0 else None
            mass.append(math.nan if above is None else above)
    return {"stamps": np.array(stamps), "said": np.array(said), "mass": np.array(mass)}


def in_sight(run: Run, house: SimWorld, stamps: np.ndarray) -> np.ndarray:
    """Whether the ball's centre is in sight at each time: walls and furniture are in the way, or not."""
    eyes = np.array([run.bearing(float(now))[1] for now in stamps])
    ways = np.array([run.ball(float(now)) for now in stamps]) - eyes
    far = np.linalg.norm(ways, axis=1)
    return ~Renderer(house.scene).raycaster.occluded(eyes, ways / far[:, None], far)


def figures(run: Run, seen: np.ndarray, played: dict[str, np.ndarray], first: float) -> dict[str, float]:
    """The figures of one method in one run; NaN where one does not apply.

    `seen`: whether the ball is in sight at each step. `first`: when the first look was there.
    """
    keep = played["stamps"] >= first
    stamps, said = played["stamps"][keep], played["said"][keep]
    true = np.array([run.bearing(float(now))[0] for now in stamps])
    errors = angular_distance(said, true)
    turned = [run.turned(float(b)).T @ run.turned(float(a)) for a, b in pairwise(stamps)]
    moved = []  # each answer, as the true bearing moved: with the body, then by the smallest rotation
    for k, turn in enumerate(turned):
        start, end = turn @ true[k], true[k + 1]
        moved.append(rotation_from_xyzw(np.append(np.cross(start, end), 1 + start @ end)) @ turn @ said[k])
    seen = seen[keep]
    mass = played["mass"][keep]
    return {
        "error": math.degrees(float(errors.mean())),
        "in sight": math.degrees(float(errors[seen].mean())) if seen.any() else math.nan,
        "TC": math.degrees(float(angular_distance(np.array(moved), said[1:]).mean())),
        "recovery": _recovery(stamps, seen, errors),
        "covered": math.nan if np.isnan(mass).all() else float((mass[~np.isnan(mass)] < 0.9).mean()),
    }


def _recovery(stamps: np.ndarray, seen: np.ndarray, errors: np.ndarray) -> float:
    found, gone = [], 0.0
    for k in range(1, len(stamps)):
        if not seen[k]:
            gone = gone + stamps[k] - stamps[k - 1] if not seen[k - 1] else 0.0
        elif not seen[k - 1] and gone >= GONE:
            good = np.flatnonzero(errors[k:] <= NEAR)
            found.append(float((stamps[k + good[0]] if len(good) else stamps[-1]) - stamps[k]))
    return float(np.mean(found)) if found else math.nan


def conditions() -> Iterator[tuple[str, float, bool]]:
    """Name, seconds per look, whether looks count for the time of their picture."""
    for seconds in LATENCIES:
        yield f"{seconds:g} s late" if seconds else "at once", seconds, True
        if seconds:
            yield f"{seconds:g} s as new", seconds, False


def judge_run(path: str) -> tuple[str, dict[tuple[str, str], dict[str, float]]]:
    """All figures of one run, by condition and method."""
    run = read(Path(path))
    house = SimWorld(SimSettings(seed=run.seed))
    perception = load("scout")
    calibration, detector = (getattr(perception, key, None) for key in ("calibration", "detector"))
    looks = look_at(run, perception)
    found, seen = {}, None
    for condition, seconds, late in conditions():
        coming = arrivals(looks, seconds)
        for name in NAMES:
            method = make_estimator(name, np.random.default_rng(0), "scout", calibration, detector=detector)
            played = play(run, coming, method, late)
            seen = in_sight(run, house, played["stamps"]) if seen is None else seen
            found[condition, name] = figures(run, seen, played, coming[0][0])
    return run.scene, found


def judge(folder: Path, workers: int) -> None:
    """Print a table per scene."""
    from concurrent.futures import ProcessPoolExecutor

    paths = sorted(str(path) for path in folder.glob("run-*") if path.is_dir() or path.suffix == ".mcap")
    if not paths:
        sys.exit(f"{folder} holds no runs; record some first")
    rows: dict[tuple[str, str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    with ProcessPoolExecutor(workers) as pool:
        for number, (scene, found) in enumerate(pool.map(judge_run, paths), start=1):
            print(f"{number} of {len(paths)} runs judged", file=sys.stderr, flush=True)
            for (condition, name), values in found.items():
                for key, value in values.items():
                    rows[scene, condition, name][key].append(value)
    heads = ("error, deg", "in sight, deg", "TC, deg", "recovery, s", "covered")
    for scene in SCENES:
        if not any(key[0] == scene for key in rows):
            continue
        runs = len(rows[scene, "at once", "eagor"]["error"])
        print(f"\n{scene} ({runs} runs)")
        print(f"{'look':14}{'method':17}" + "".join(f"{head:>22}" for head in heads))
        for condition, _, _ in conditions():
            for name in NAMES:
                values = rows[scene, condition, name]
                print(f"{condition:14}{name:17}" + "".join(f"{common.shown(values[key]):>22}" for key in values))


def main() -> None:
    parser = common.parser(__doc__, runs=30, seed=8400, domain=121, workers=2)
    parser.add_argument("command", choices=("record", "judge"))
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    if options.command == "judge":
        judge(options.folder, options.workers)
        return
    options.folder.mkdir(parents=True, exist_ok=True)
    for number in range(options.runs):
        for index, scene in enumerate(SCENES):
            path = options.folder / f"run-{options.seed + number}-{index}"
            if not path.exists():
                part = path.with_name(f"part-{path.name}")  # an interrupted run is recorded again
                shutil.rmtree(part, ignore_errors=True)
                turn = (number * len(SCENES) + index) % DOMAINS  # the robot of the last run may not be forgotten yet
                record(options.seed + number, scene, part, options.domain + turn)
                part.rename(path)
                print(f"{path}: {scene}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
