"""Rotation from pictures alone: panoramas that turn, and an ordinary camera that pans and walks.

python benchmarks/rotation.py panoramas [--frames 12] [--seeds 2] [--photographs ../shared/panoramas]
python benchmarks/rotation.py cameras [--fields 60 90 120] [--walks 4] [--first N, so many photographs only]

Panoramas: known rotations turn each photograph; nothing moves. "fails": sequences that end more than a degree off, or
are lost. Errors: degrees, mean over the others, with a 95 % bootstrap interval over sequences. The last lines are CPU
seconds per picture, one thread, while the camera turns by 4.5 degrees a picture (45 degrees a second at ten pictures).

Cameras: of 640 x 360 pixels at ten pictures a second, which pan by 170 degrees in three seconds and back, with a wobble
in pitch and roll, inside each photograph: as it is; blurred by an exposure of 1/20 s, 4 degrees at most; with three
things that move on their own and cover a fifth of the picture. Then one walks, with the head turning, through built-in
apartments (seeds from 100 on): parallax. The rival is rotation alone from picture to picture (`turn_between`
without the model of a moving camera, chained).
"drift": degrees per minute on the way out, as the median over sequences of error / time; nothing was seen twice there.
"end": the error after the way back, degrees, median, and the worst. "over": share of pictures whose error exceeds three
times what the odometer says (0.03 for a Gaussian of three equal axes). "told": the deviation of the angle that it says
of the end, degrees, median. "within": share of sequences whose error is within twice of that, on the way out and at the
end. "lost": sequences with a picture that was lost.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator

import common
import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from eagor.grids import PerspectiveGrid
from eagor.media.features import Views, match
from eagor.media.panorama import cut, read_panorama, turn
from eagor.media.rotation import VisualOdometer
from eagor.media.two_views import turn_between
from eagor.sphere import world_R_body

ROWS, COLUMNS, RATE, SECONDS = 360, 640, 10, 6
EXPOSURE, PARTS = 0.05, 8  # seconds; pictures that are averaged
Pictures = list[np.ndarray]
Answers = Iterator[tuple[np.ndarray, float, bool]]  # of each picture: pose, spread in degrees, lost


def off(pose: np.ndarray, truth: np.ndarray) -> float:
    return math.degrees(Rotation.from_matrix(pose @ truth.T).magnitude())


# --- panoramas ---


def paths(frames: int, seed: int) -> Iterator[tuple[str, list[np.ndarray]]]:
    random, index = np.random.default_rng(seed), np.arange(frames)
    yield "yaw, 9 degrees a frame", [world_R_body(0.157 * k) for k in index]
    for name, step in (("tumbling, 1 degree a frame", 1.0), ("tumbling, 15", 15.0), ("tumbling, 75", 75.0)):
        axis = random.normal(size=3)
        axis *= np.radians(step) / np.linalg.norm(axis)
        yield name, [Rotation.from_rotvec(axis * k).as_matrix() for k in index]


def panoramas(photographs: Pictures, options: argparse.Namespace) -> None:
    errors: dict[str, list[float]] = {}
    for seed in range(options.seeds):
        for photograph in photographs:
            for path, poses in paths(options.frames, seed):
                own = VisualOdometer()
                last = [own.add(turn(photograph, pose.T)) for pose in poses][-1]
                errors.setdefault(path, []).append(math.inf if last.lost else off(last.world_R_body, poses[-1]))
    for path, values in errors.items():
        good = [value for value in values if value < 1]
        print(f"{path:28} {common.shown(good, 4):26} fails {len(values) - len(good)} of {len(values)}")
    for rows in (240, 512):
        large = cv2.resize(photographs[0], (2 * rows, rows), interpolation=cv2.INTER_CUBIC)
        own, times = VisualOdometer(), []
        for number in range(8):
            picture = turn(large, world_R_body(np.radians(4.5) * number).T)
            start = time.process_time()
            own.add(picture)
            times.append(time.process_time() - start)
        print(f"{2 * rows} x {rows}: {min(times[1:]):.3f} CPU s a picture")


# --- ordinary cameras ---


def odometer(pictures: Pictures, grid: PerspectiveGrid) -> Answers:
    own = VisualOdometer()
    for number, picture in enumerate(pictures):
        turned = own.add(picture, number / RATE, grid)
        yield turned.world_R_body, math.degrees(turned.spread), turned.lost


def rotation_only(pictures: Pictures, grid: PerspectiveGrid) -> Answers:
    pose, before = np.eye(3), None
    for picture in pictures:
        views = Views.of_picture(picture, grid)
        now, step = views.features, None
        if before is not None:
            a, b = match(before, now)
            step = turn_between(before.directions[a], now.directions[b], moves=False, area=views.area)
            pose = pose if step is None else pose @ step.old_R_new
        yield pose, math.nan, before is not None and step is None
        before = now


METHODS = {"odometer": odometer, "rotation only, chained": rotation_only}


def pose_at(seconds: float, far: float = math.radians(170)) -> np.ndarray:
    """Out by `far` and back, with a wobble."""
    yaw = far * (1 - math.cos(2 * math.pi * seconds / SECONDS)) / 2
    return world_R_body(yaw, math.radians(12) * math.sin(1.3 * seconds), math.radians(5) * math.sin(1.7 * seconds))


def pans(photograph: np.ndarray, hfov: float, blurred: bool, things: Pictures) -> Pictures:
    pictures = []
    for number in range(SECONDS * RATE + 1):
        at = number / RATE
        moments = at + EXPOSURE * (np.arange(PARTS) / PARTS - 0.5) if blurred else [at]
        grids = [PerspectiveGrid(ROWS, COLUMNS, hfov, pose_at(moment)) for moment in moments]
        picture = np.rint(np.mean(cut(photograph, *grids), axis=0)).astype(np.uint8)
        for index, (thing, speed) in enumerate(zip(things, (110.0, -70.0, 160.0), strict=False)):  # they cross it
            height, width = thing.shape[:2]
            left, top = round((200 * index + speed * at) % (COLUMNS + width)) - width, 40 + 70 * index
            seen = slice(max(left, 0), min(left + width, COLUMNS))
            picture[top : top + height, seen] = thing[: ROWS - top, seen.start - left : seen.stop - left]
        pictures.append(picture)
    return pictures


def walk(seed: int, hfov: float) -> tuple[Pictures, list[np.ndarray]]:
    """One metre a second through an apartment; the head turns about the way."""
    from eagor.lab.worlds import ground_of
    from eagor.lab.worlds.apartment import generate
    from eagor.lab.worlds.navmesh import stroll
    from eagor.lab.worlds.render import Renderer

    scene, random = generate(seed), np.random.default_rng(seed)
    ground, renderer = ground_of(scene, 0.3), Renderer(scene)
    points = stroll(ground, ground.sample(random), 1.0 / RATE, random)
    poses = [pose_at(number / RATE, math.radians(60)) for number in range(SECONDS * RATE + 1)]
    pictures = []
    for pose in poses:
        x, y, *_ = next(points)
        grid = PerspectiveGrid(ROWS, COLUMNS, hfov)
        frame = renderer.view((x, y, 1.4), pose, grid, range=False, ids=False)
        assert frame.rgb is not None
        pictures.append(frame.rgb)
    return pictures, poses


def show(condition: str, hfov: float, sequences: list[tuple[Pictures, list[np.ndarray]]], methods: list[str]) -> None:
    """A line for each method, over all sequences of pictures and their true poses."""
    grid, middle = PerspectiveGrid(ROWS, COLUMNS, hfov), SECONDS * RATE // 2
    for method in methods if sequences else ():
        errors, spreads, lost, begun = [], [], 0, time.process_time()
        for pictures, poses in sequences:
            found = list(METHODS[method](pictures, grid))
            errors.append([off(pose, poses[0].T @ truth) for (pose, *_), truth in zip(found, poses, strict=True)])
            spreads.append([spread for _, spread, _ in found])
            lost += any(gone for *_, gone in found)
        seconds = (time.process_time() - begun) / sum(len(pictures) for pictures, _ in sequences)
        errors, spreads = np.array(errors), np.array(spreads)
        told = "over    -  told       -  within    -"
        if method == "odometer":
            over = np.mean(errors[:, 1:] > 3 * spreads[:, 1:])
            sigmas = math.sqrt(3) * spreads[:, [middle, -1]]
            within = np.mean(errors[:, [middle, -1]] <= 2 * sigmas)
            told = f"over {over:4.2f}  told {np.median(sigmas[:, 1]):7.3f}  within {within:4.2f}"
        drift, ends = np.median(errors[:, middle]) * 60 / (SECONDS / 2), errors[:, -1]
        print(
            f"{condition:14} {math.degrees(hfov):4.0f}  {method:23} drift {drift:7.3f}  end {np.median(ends):7.3f}  "
            f"worst {max(ends):7.3f}  {told}  lost {lost} of {len(sequences)}  CPU {seconds:.3f} s",
            flush=True,
        )


def cameras(photographs: Pictures, options: argparse.Namespace) -> None:
    # As fine as the narrowest pictures, or flow would follow the corners of pixels.
    fine = [cv2.resize(each, (2048, 1024), interpolation=cv2.INTER_CUBIC) for each in photographs]
    things = [np.ascontiguousarray(each[400:580, 600:720]) for each in fine[1:4]]
    conditions = {"as it is": (False, []), "blurred": (True, []), "moving things": (False, things)}
    poses = [pose_at(number / RATE) for number in range(SECONDS * RATE + 1)]
    for hfov in map(math.radians, options.fields):
        for condition, (blurred, pasted) in conditions.items():
            sequences = [(pans(each, hfov, blurred, pasted), poses) for each in fine[: options.first or None]]
            show(condition, hfov, sequences, options.methods)
        show("walking", hfov, [walk(100 + seed, hfov) for seed in range(options.walks)], options.methods)


def main() -> None:
    """Print the tables."""
    parser = common.parser(
        __doc__, photographs=common.PANORAMAS, frames=12, seeds=2,
        fields=[60.0, 90.0, 120.0], walks=4, methods=tuple(METHODS), first=0,
    )  # fmt: skip
    parser.add_argument("what", choices=("panoramas", "cameras"))
    options = parser.parse_args()
    cv2.setNumThreads(1)
    photographs = [read_panorama(path) for path in sorted(options.photographs.glob("*.png"))]
    if not photographs:
        parser.error(f"no PNG files in {options.photographs}; give a folder with panoramas")
    (panoramas if options.what == "panoramas" else cameras)(photographs, options)


if __name__ == "__main__":
    main()
