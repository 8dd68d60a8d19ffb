"""Rotation from panoramas alone: the odometer against rivals on turned photographs, and its CPU time.

python benchmarks/rotation.py [--frames 12] [--seeds 2] [--photographs ../shared/panoramas]

Known rotations turn each photograph; nothing moves. Rivals: the same comparison chained from picture to picture without
key frames, the odometer without the model of a moving camera, and the best rotation of the grey picture's spherical
harmonics (degree 15, least squares from the last answer), also chained. "fails": sequences that end more than a degree
off, or are lost. Errors: degrees, mean over the others, with a 95 % bootstrap interval over sequences. CPU: per
picture of 1024 x 512, one thread, in units of the odometer's; the last lines are the odometer's own seconds while the
camera turns by 4.5 degrees a picture (45 degrees a second at ten pictures).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import common
import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.media.features import features_of, match
from eagor.media.panorama import read_panorama, turn
from eagor.media.rotation import VisualOdometer
from eagor.media.two_views import turn_between
from eagor.sphere import world_R_body

BASIS, SMALL = RealHarmonics(15), ErpGrid(64, 128)
Answers = list[np.ndarray | None]


def odometer(pictures: list[np.ndarray]) -> Answers:
    own = VisualOdometer()
    found = [own.add(picture) for picture in pictures]
    return [None if each.lost else each.world_R_body for each in found]


def chained(pictures: list[np.ndarray], moves: bool = True) -> Answers:
    poses: Answers = [np.eye(3)]
    before = features_of(pictures[0])
    for picture in pictures[1:]:
        now = features_of(picture)
        a, b = match(before, now)
        step = turn_between(before.directions[a], now.directions[b], moves=moves)
        last, before = poses[-1], now
        poses.append(None if last is None or step is None else last @ step.old_R_new)
    return poses


def harmonics(pictures: list[np.ndarray]) -> Answers:
    poses: Answers = [np.eye(3)]
    before, guess = spectrum(pictures[0]), np.zeros(3)
    for picture in pictures[1:]:
        now = spectrum(picture)

        def gaps(vector: np.ndarray, before: np.ndarray = before, now: np.ndarray = now) -> np.ndarray:
            return BASIS.rotate(before, Rotation.from_rotvec(vector).as_matrix().T) - now

        guess = least_squares(gaps, guess).x
        last, before = poses[-1], now
        assert last is not None
        poses.append(last @ Rotation.from_rotvec(guess).as_matrix())
    return poses


def spectrum(picture: np.ndarray) -> np.ndarray:
    grey = cv2.resize(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), SMALL.shape[::-1], interpolation=cv2.INTER_AREA)
    found = BASIS.analyse(grey.astype(float) / 255, SMALL)
    found[0] = 0  # brightness
    return found


METHODS: dict[str, Callable[[list[np.ndarray]], Answers]] = {
    "odometer": odometer,
    "chained": chained,
    "chained, rotation only": lambda pictures: chained(pictures, moves=False),
    "harmonics, chained": harmonics,
}


def paths(frames: int, seed: int) -> Iterator[tuple[str, list[np.ndarray]]]:
    random = np.random.default_rng(seed)
    index = np.arange(frames)
    yield "yaw, 9 degrees a frame", [world_R_body(0.157 * k) for k in index]
    for name, step in (("tumbling, 1 degree a frame", 1.0), ("tumbling, 15", 15.0), ("tumbling, 75", 75.0)):
        axis = random.normal(size=3)
        axis *= np.radians(step) / np.linalg.norm(axis)
        yield name, [Rotation.from_rotvec(axis * k).as_matrix() for k in index]


def main() -> None:
    """Print the tables."""
    parser = common.parser(__doc__)
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--photographs", type=Path, default=Path(__file__).parents[1] / ".." / "shared" / "panoramas")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    photographs = [read_panorama(path) for path in sorted(options.photographs.glob("*.png"))]
    if not photographs:
        parser.error(f"no PNG files in {options.photographs}; give a folder with panoramas")
    errors: dict[tuple[str, str], list[float]] = {}
    spent = dict.fromkeys(METHODS, 0.0)
    for seed in range(options.seeds):
        for photograph in photographs:
            for path, poses in paths(options.frames, seed):
                pictures = [turn(photograph, pose.T) for pose in poses]
                for method, run in METHODS.items():
                    start = time.process_time()
                    last = run(pictures)[-1]
                    spent[method] += time.process_time() - start
                    off = np.inf if last is None else np.degrees(Rotation.from_matrix(last @ poses[-1].T).magnitude())
                    errors.setdefault((path, method), []).append(float(off))
    for (path, method), values in errors.items():
        good = [value for value in values if value < 1]
        text = "-"
        if len(good) > 1:
            text = "{:.4f} [{:.4f}, {:.4f}]".format(*common.mean_of(good))
        cost = spent[method] / spent["odometer"]
        print(f"{path:28} {method:24} {text:26} fails {len(values) - len(good)} of {len(values)}   CPU {cost:4.2f} x")
    for rows in (240, 512, 2880):
        large = cv2.resize(photographs[0], (2 * rows, rows), interpolation=cv2.INTER_CUBIC)
        own, times = VisualOdometer(), []
        for number in range(8):
            picture = turn(large, world_R_body(np.radians(4.5) * number).T)
            start = time.process_time()
            own.add(picture)
            times.append(time.process_time() - start)
        print(f"{2 * rows} x {rows}: {min(times[1:]):.3f} CPU s a picture")


if __name__ == "__main__":
    main()
