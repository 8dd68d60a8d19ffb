"""What a picture of the built-in world costs, against the bare ray casting that no picture can do without.

    python benchmarks/world.py [--seed 1] [--repeats 15] [--json FILE]

CPU time (time.process_time) on one thread. The unit of each row is `EmbreeScene.run(o, d, output=True)` over the same
rays and the same triangles. The contestants take turns, so that a change of the machine's speed hits all of them. The
table gives the ratio of the medians, and the range of that ratio over five parts of the run. Steps of an episode are
measured 20 together, with the milliseconds of all of them. Also told: what making and lighting the apartment costs
once.
"""

from __future__ import annotations

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from eagor import Belief, DirectionTracker, Evidence, TrackerConfig
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.perception.truth import TruthPerception
from eagor.sphere import world_R_body
from eagor.tasks import waypoint
from eagor.tasks.episodes import Slot
from eagor.tasks.places import APARTMENT, DEVELOPMENT, LOOK_ROWS, load_place
from eagor.tasks.rules import Camera, WaypointRules
from eagor.worlds.apartment import generate
from eagor.worlds.lattice import Lattice
from eagor.worlds.light import bake
from eagor.worlds.raycast import make_raycaster
from eagor.worlds.render import Renderer
from eagor.worlds.scene import Scene

EYE_HEIGHT = 1.3
STEPS = 20  # of an episode
DEGREE = 15
YAW, TILTED = world_R_body(0.4), world_R_body(0.4, 0.1, 0.05)

Row = tuple[str, str, str, str]  # title, contestant, unit, aim


def eye(scene: Scene) -> np.ndarray:
    """A place in the largest room."""
    room = max(scene.rooms, key=lambda room: room.area)
    x0, y0, x1, y1 = max(room.rectangles, key=lambda r: (r[2] - r[0]) * (r[3] - r[1]))
    return np.array([x0 + 0.4 * (x1 - x0), y0 + 0.45 * (y1 - y0), EYE_HEIGHT])


class Bare:
    """Embree and nothing else, on the triangles of a scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene = EmbreeScene(robust=True)
        self.mesh = TriangleMesh(self.scene, scene.vertices, scene.triangles)

    def trace(self, position: np.ndarray, directions: np.ndarray) -> Callable[[], object]:
        directions = np.ascontiguousarray(directions.reshape(-1, 3), dtype=np.float32)
        origins = np.ascontiguousarray(np.broadcast_to(position.astype(np.float32), directions.shape))
        return lambda: self.scene.run(origins, directions, output=True)


def pictures(scene: Scene, folder: Path) -> tuple[dict[str, Callable[[], object]], list[Row]]:
    """Contestants and rows: one frame of each kind."""
    renderer, bare, place = Renderer(scene, cache=folder), Bare(scene), eye(scene)
    photo = PerspectiveGrid(240, 320, 1.4)
    contestants: dict[str, Callable[[], object]] = {"photo bare": bare.trace(place, photo.directions @ YAW.T)}
    for height in (64, 128, 256, 512):
        contestants[f"{height} bare"] = bare.trace(place, ErpGrid(height, 2 * height).directions @ YAW.T)
    ids = {"rgb": False, "range": False}
    contestants |= {
        "64 ids": lambda: renderer.panorama(place, YAW, 64, **ids),
        "64 all": lambda: renderer.panorama(place, YAW, 64),
        "128 all": lambda: renderer.panorama(place, YAW, 128),
        "256 ids, range": lambda: renderer.panorama(place, YAW, 256, rgb=False),
        "256 all": lambda: renderer.panorama(place, YAW, 256),
        "256 tilted": lambda: renderer.panorama(place, TILTED, 256),
        "512 all": lambda: renderer.panorama(place, YAW, 512),
        "photo all": lambda: renderer.view(place, YAW, photo),
    }
    rows: list[Row] = [
        ("ids, 64 x 128", "64 ids", "64 bare", "<= 1.2"),
        ("RGB, range, ids, 64 x 128", "64 all", "64 bare", ""),
        ("RGB, range, ids, 128 x 256", "128 all", "128 bare", ""),
        ("ids, range, 256 x 512", "256 ids, range", "256 bare", ""),
        ("RGB, range, ids, 256 x 512", "256 all", "256 bare", "<= 2.2"),
        ("RGB, range, ids, 256 x 512, tilted", "256 tilted", "256 bare", "<= 2.2"),
        ("RGB, range, ids, 512 x 1024", "512 all", "512 bare", ""),
        ("RGB, range, ids, perspective 240 x 320", "photo all", "photo bare", ""),
    ]
    return contestants, rows


def engines(scene: Scene) -> tuple[dict[str, Callable[[], object]], list[Row]]:
    """The fallback without embreex, on few rays."""
    place = eye(scene)
    directions = ErpGrid(32, 64).directions.reshape(-1, 3).astype(np.float32)
    origins = np.broadcast_to(place.astype(np.float32), directions.shape)
    fallback = make_raycaster(scene.vertices, scene.triangles, "numpy")
    contestants = {
        "fallback bare": Bare(scene).trace(place, directions),
        "fallback": lambda: fallback.cast(origins, directions),
    }
    return contestants, [("fallback engine (NumPy alone), 32 x 64", "fallback", "fallback bare", "")]


def episode_step(seed: int) -> tuple[dict[str, Callable[[], object]], list[Row]]:
    """Contestants and rows for the first steps of an episode with the truth as evidence, as the tasks go through it.

    Every run goes through all the steps with a detector and a belief that begin afresh.
    """
    if seed not in DEVELOPMENT:
        raise SystemExit(f"seed {seed} is kept for results; wanted one of {DEVELOPMENT.start} to {DEVELOPMENT[-1]}")
    camera = Camera()
    episode = waypoint.plan(Slot("waypoint", APARTMENT, seed, 0, 0), camera, WaypointRules())
    place = load_place(APARTMENT, seed, camera.radius)
    bare, directions = Bare(place.scene), ErpGrid(LOOK_ROWS, 2 * LOOK_ROWS).directions
    poses = [(np.array([x, y, camera.height]), world_R_body(yaw)) for x, y, yaw in episode.route[:STEPS]]
    traces = [bare.trace(position, directions @ pose.T) for position, pose in poses]
    images = [place.ids(*pose) for pose in poses]
    perception = TruthPerception()

    def detector() -> Callable[[np.ndarray, int], Evidence]:
        looking = perception.episode(place.scene.instances, 0)
        return lambda ids, k: looking(ids, episode.query, stamp=k * camera.seconds, world_R_body=poses[k][1])

    def evidence() -> list[Evidence]:
        look = detector()
        return [look(ids, k) for k, ids in enumerate(images)]

    looks = evidence()

    def believe(evidence_of: Callable[[int], Evidence]) -> None:
        belief, before = Belief.uniform(DEGREE), poses[0][1]
        for k, (_, pose) in enumerate(poses):
            belief, before = belief.predict(pose.T @ before).update(evidence_of(k)), pose
            belief.mode()

    def track(evidence_of: Callable[[int], Evidence]) -> None:
        tracker = DirectionTracker(TrackerConfig())
        for k, (position, pose) in enumerate(poses):
            tracker.add_pose(k * camera.seconds, pose, position)
            tracker.observe(evidence_of(k))
            _ = tracker.estimate(k * camera.seconds).direction

    def stepping(follow: Callable[[Callable[[int], Evidence]], None]) -> Callable[[], None]:
        def run() -> None:
            look = detector()
            follow(lambda k: look(place.ids(*poses[k]), k))

        return run

    contestants: dict[str, Callable[[], object]] = {
        "step bare": lambda: [trace() for trace in traces],
        "step ids": lambda: [place.ids(*pose) for pose in poses],
        "step truth": evidence,
        "step coefficients": lambda: [look.coefficients(DEGREE) for look in looks],
        "step belief": lambda: believe(lambda k: looks[k]),
        "step tracker": lambda: track(lambda k: looks[k]),
        "step with belief": stepping(believe),
        "step with tracker": stepping(track),
    }
    rows: list[Row] = [
        ("episode step: ids, truth, belief", "step with belief", "step bare", "<= 2.0"),
        ("episode step: ids, truth, default tracker", "step with tracker", "step bare", ""),
        ("  ids, 64 x 128, alone", "step ids", "step bare", ""),
        ("  truth evidence alone", "step truth", "step bare", ""),
        ("  its coefficients alone", "step coefficients", "step bare", ""),
        (f"  belief of degree {DEGREE}: turn, update, mode", "step belief", "step bare", ""),
        ("  tracker: pose, evidence, direction", "step tracker", "step bare", ""),
    ]
    return contestants, rows


def once(scene: Scene, seed: int) -> dict[str, float]:
    """CPU seconds of what is done once for a scene."""
    lattice = Lattice.of(scene)
    found = {}
    for title, work in (
        ("making the apartment (textures drawn already)", lambda: generate(seed)),
        ("embree tree of its triangles", lambda: Bare(scene).trace(eye(scene), np.array([[1.0, 0, 0]]))()),
        ("its light", lambda: bake(scene, lattice)),
    ):
        start = time.process_time()
        work()
        found[title] = time.process_time() - start
    return found


def measure(contestants: dict[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """CPU seconds per run, contestants in turn; quick ones run several times in each turn, after one that warms up."""
    times: dict[str, list[float]] = {name: [] for name in contestants}
    turns = {}
    for name, run in contestants.items():
        run()
        start = time.process_time()
        run()
        turns[name] = max(1, int(0.02 / max(time.process_time() - start, 1e-4)))
    for _ in range(max(5, repeats)):
        for name, run in contestants.items():
            run()
            start = time.process_time()
            for _ in range(turns[name]):
                run()
            times[name].append((time.process_time() - start) / turns[name])
    return times


def ratio(times: dict[str, list[float]], name: str, unit: str) -> dict[str, float]:
    blocks = [
        np.median(a) / np.median(b)
        for a, b in zip(np.array_split(times[name], 5), np.array_split(times[unit], 5), strict=True)
    ]
    return {
        "ratio": float(np.median(times[name]) / np.median(times[unit])),
        "low": float(min(blocks)),
        "high": float(max(blocks)),
        "unit_ms": float(np.median(times[unit]) * 1e3),
    }


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--repeats", type=int, default=15)
    arguments.add_argument("--json", metavar="FILE")
    options = arguments.parse_args()

    scene = generate(options.seed)
    report: dict[str, dict[str, float]] = {}
    print(f"{scene.source}: {len(scene.triangles)} triangles, {Lattice.of(scene).size} samples of light\n")
    print(f"{'CPU time, in units of the bare embree trace':46s} {'ratio':>6s}   {'blocks':12s} {'unit':>9s}   aim")
    with tempfile.TemporaryDirectory() as folder:
        for contestants, rows in (
            pictures(scene, Path(folder)),
            episode_step(options.seed),
            engines(scene),
        ):
            times = measure(contestants, options.repeats)
            for title, contestant, unit, aim in rows:
                found = report[title] = ratio(times, contestant, unit)
                blocks = f"{found['low']:.2f}..{found['high']:.2f}"
                unit_ms = found["unit_ms"]
                print(f"  {title:44s} {found['ratio']:6.2f}   {blocks:12s} {unit_ms:6.2f} ms   {aim}".rstrip())
    seconds = once(scene, options.seed)
    print("\nonce for a scene, CPU seconds")
    for title, value in seconds.items():
        print(f"  {title:44s} {value:6.2f}")
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump({"ratios": report, "once_seconds": seconds, "triangles": len(scene.triangles)}, file, indent=1)


if __name__ == "__main__":
    main()
