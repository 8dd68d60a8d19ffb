"""Rotation from pictures alone: panoramas and ordinary cameras that turn, stand, and walk.

python benchmarks/odometry.py [--fields 360 65 90] [--conditions turning ...] [--methods odometer ...] [--photographs
../shared/panoramas] [--first N, so many photographs only] [--walks 4]

Pictures of 640 x 360 pixels (panoramas, field 360: 1024 x 512) at ten a second, inside each photograph. "turning":
by 170 degrees in three seconds and back, with a wobble in pitch and roll; "blurred": the same, with an exposure of 1/20
s, 4 degrees at most; "moving": with three things that move on their own and cover a fifth of the picture; "standing":
it stands, with noise; "standing, moving": and the things move. "walking": with the head turning, at a metre a second
through built-in apartments (seeds from 100 on). "floor": looking down by 40 degrees.
Methods: the odometer; the same where there is no pycolmap; and as a rival pycolmap's two-view geometry alone, on
matched features from picture to picture.
"half", "end": the error after half the time and at the end, degrees, median, and the worst at the end. "std": what the
odometer says of the angle at the end, degrees, median. "within": share of sequences whose error is within twice of
that, half way and at the end. "lost": sequences with a picture that was lost. CPU: seconds a picture, one thread.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any
from unittest import mock

import common
import cv2
import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from eagor.conventions import OPTICAL_R_BODY, to_optical
from eagor.grids import PerspectiveGrid
from eagor.odometry.features import Views, match
from eagor.odometry.visual import VisualOdometer
from eagor.sources.panorama import cut, read_panorama, turn
from eagor.sphere import world_R_body

ROWS, COLUMNS, RATE, SECONDS = 360, 640, 10, 6
EXPOSURE, PARTS = 0.05, 8  # seconds; pictures that are averaged
SPEEDS = (110.0, -70.0, 160.0)  # pixels a second of the things
Sequence = tuple[list[np.ndarray], list[np.ndarray]]  # pictures, true poses
Answers = Iterator[tuple[np.ndarray, float, bool]]  # of each picture: pose, deviation of its angle in degrees, lost


def grid_of(field: float, pose: np.ndarray | None = None) -> PerspectiveGrid | None:
    """The pixels of an ordinary camera; None for panoramas."""
    view = np.eye(3) if pose is None else pose
    return None if field == 360 else PerspectiveGrid(ROWS, COLUMNS, math.radians(field), view)


def pose_at(seconds: float, far: float = math.radians(170)) -> np.ndarray:
    """Out by `far` and back, with a wobble."""
    yaw = far * (1 - math.cos(2 * math.pi * seconds / SECONDS)) / 2
    return world_R_body(yaw, math.radians(12) * math.sin(1.3 * seconds), math.radians(5) * math.sin(1.7 * seconds))


def inside(photograph: np.ndarray, field: float, condition: str, things: list[np.ndarray]) -> Sequence:
    """What a camera shows that turns, or stands, in a photograph."""
    pictures, poses, random = [], [], np.random.default_rng(0)
    for number in range(SECONDS * RATE + 1):
        at = number / RATE
        moments = at + EXPOSURE * (np.arange(PARTS) / PARTS - 0.5) if condition == "blurred" else [at]
        seen = [np.eye(3) if "standing" in condition else pose_at(moment) for moment in moments]
        if field == 360:
            small = cv2.resize(photograph, (1024, 512), interpolation=cv2.INTER_AREA)
            shown = [turn(small, pose.T) for pose in seen]
        else:
            shown = cut(photograph, *(grid for pose in seen if (grid := grid_of(field, pose)) is not None))
        picture = np.rint(np.mean(shown, axis=0)).astype(np.uint8)
        if "standing" in condition:
            picture = np.clip(picture + random.normal(0, 3, picture.shape), 0, 255).astype(np.uint8)
        for index, (thing, speed) in enumerate(zip(things if "moving" in condition else [], SPEEDS, strict=False)):
            (high, wide), (rows, columns) = thing.shape[:2], picture.shape[:2]
            left, top = round((200 * index + speed * at) % (columns + wide)) - wide, rows // 8 + rows // 5 * index
            where = slice(max(left, 0), min(left + wide, columns))
            picture[top : top + high, where] = thing[: rows - top, where.start - left : where.stop - left]
        pictures.append(picture)
        poses.append(seen[0] if condition != "blurred" else pose_at(at))
    return pictures, poses


def walk(seed: int, field: float, condition: str) -> Sequence:
    """What a camera shows that walks through an apartment; the head turns about the way."""
    from eagor.lab.worlds import ground_of
    from eagor.lab.worlds.apartment import generate
    from eagor.lab.worlds.render import Renderer

    scene, random = generate(seed), np.random.default_rng(seed)
    ground, renderer = ground_of(scene, 0.3), Renderer(scene)
    points = ground.stroll(ground.sample(random), 1.0 / RATE, random)
    down = world_R_body(0, math.radians(40 if condition == "floor" else 0))
    poses = [pose_at(number / RATE, math.radians(60)) @ down for number in range(SECONDS * RATE + 1)]
    pictures = []
    for pose in poses:
        x, y, *_ = next(points)
        grid = grid_of(field)
        frame = renderer.panorama((x, y, 1.4), pose, 512) if grid is None else renderer.view((x, y, 1.4), pose, grid)
        pictures.append(frame.rgb)
    return pictures, poses


def odometer(pictures: list[np.ndarray], field: float) -> Answers:
    own = VisualOdometer()
    for number, picture in enumerate(pictures):
        found = own.add(picture, number / RATE, grid_of(field))
        yield found.world_R_body, math.degrees(math.sqrt(3) * found.std), found.lost


def without_pycolmap(pictures: list[np.ndarray], field: float) -> Answers:
    with mock.patch("eagor.odometry.two_views.find_spec", return_value=None):
        yield from odometer(pictures, field)


def pycolmap_alone(pictures: list[np.ndarray], field: float) -> Answers:
    camera: Any = pycolmap.Camera.create_from_model_name(1, "EQUIRECTANGULAR", 1.0, 4096, 2048)
    options = pycolmap.TwoViewGeometryOptions(compute_relative_pose=True)
    options.ransac.random_seed, pose, before = 0, np.eye(3), None
    for picture in pictures:
        now, lost = Views.of(picture, grid_of(field)).features, False
        if before is not None:
            a, b = match(before, now)
            pixels = [camera.img_from_cam(to_optical(each)) for each in (before.directions[a], now.directions[b])]
            same = np.repeat(np.arange(len(a), dtype=np.uint32)[:, None], 2, axis=1)
            found = pycolmap.estimate_calibrated_two_view_geometry(
                camera, pixels[0].reshape(-1, 2), camera, pixels[1].reshape(-1, 2), same, options
            ).cam2_from_cam1
            lost = found is None
            if found is not None:
                pose = pose @ OPTICAL_R_BODY.T @ found.rotation.matrix().T @ OPTICAL_R_BODY
        yield pose, math.nan, lost
        before = now


METHODS = {"odometer": odometer, "without pycolmap": without_pycolmap, "pycolmap alone": pycolmap_alone}
CONDITIONS = ("turning", "blurred", "moving", "standing", "standing, moving", "walking", "floor")


def show(condition: str, field: float, sequences: list[Sequence], methods: list[str]) -> None:
    """A line for each method, over all sequences."""
    half = SECONDS * RATE // 2
    for method in methods if sequences else ():
        errors, said, lost, begun = [], [], 0, time.process_time()
        for pictures, poses in sequences:
            found = list(METHODS[method](pictures, field))
            turned = [Rotation.from_matrix(pose @ (poses[0].T @ true).T).magnitude()
                      for (pose, *_), true in zip(found, poses, strict=True)]  # fmt: skip
            errors.append(np.degrees([turned[half], turned[-1]]))
            said.append([found[half][1], found[-1][1]])
            lost += any(gone for *_, gone in found)
        seconds = (time.process_time() - begun) / sum(len(pictures) for pictures, _ in sequences)
        first, ends = np.transpose(errors)
        told = "std       -  within    -"
        if method != "pycolmap alone":
            within = np.mean(np.array(errors) <= 2 * np.array(said) + 1e-9)
            told = f"std {np.median(np.array(said)[:, 1]):7.3f}  within {within:4.2f}"
        print(
            f"{condition:17} {field:4.0f}  {method:17} half {np.median(first):7.3f}  end {np.median(ends):7.3f}  worst "
            f"{max(ends):7.3f}  {told}  lost {lost} of {len(sequences)}  CPU {seconds:.3f} s",
            flush=True,
        )


def main() -> None:
    """Print the table."""
    parser = common.parser(
        __doc__, photographs=common.PANORAMAS, fields=[360.0, 65.0, 90.0], conditions=CONDITIONS,
        methods=tuple(METHODS), first=0, walks=4,
    )  # fmt: skip
    options = parser.parse_args()
    cv2.setNumThreads(1)
    photographs = [read_panorama(path) for path in sorted(options.photographs.glob("*.png"))]
    if not photographs:
        parser.error(f"no PNG files in {options.photographs}; give a folder with panoramas")
    # As fine as the narrowest pictures, or flow would follow the corners of pixels.
    fine = [cv2.resize(each, (2048, 1024), interpolation=cv2.INTER_CUBIC) for each in photographs]
    things = [np.ascontiguousarray(each[400:580, 600:720]) for each in fine[1:4]]
    for field in options.fields:
        for condition in options.conditions:
            if condition in ("walking", "floor"):
                sequences = [walk(100 + seed, field, condition) for seed in range(options.walks)]
            else:
                sequences = [inside(each, field, condition, things) for each in fine[: options.first or None]]
            show(condition, field, sequences, options.methods)


if __name__ == "__main__":
    main()
