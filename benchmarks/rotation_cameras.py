"""Rotation from an ordinary camera's pictures alone: how far it drifts, by field of view and by what disturbs it.

python benchmarks/rotation_cameras.py [--photographs ../shared/panoramas] [--fields 60 90 120] [--walks 4]

A camera of 640 x 360 pixels at ten pictures a second pans by 170 degrees in three seconds and back, with a wobble in
pitch and roll, inside each photograph. Conditions: as it is; blurred by an exposure of 1/20 s, 4 degrees at most; with
three things that move on their own and cover a fifth of the picture. Then it walks, with the head turning, through
built-in apartments (seeds from 100 on): parallax. Rivals: rotation alone from picture to picture (`turn_between`
without the model of a moving camera, chained), and OpenCV's five-point essential matrix, chained, on the same matches.

"drift": degrees per minute on the way out, as the median over sequences of error / time; nothing was seen twice there.
"end": the error after the way back, degrees, median, and the worst. "over": share of pictures whose error exceeds three
times what the odometer says (0.03 for a Gaussian of three equal axes). "told": the deviation of the angle that it says
of the end, degrees, median. "within": share of sequences whose error is within twice of that, on the way out and at the
end. "lost": sequences with a picture that was lost.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import common
import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from eagor.grids import PerspectiveGrid
from eagor.media.features import Views, match
from eagor.media.panorama import cut, read_panorama
from eagor.media.rotation import VisualOdometer
from eagor.media.two_views import turn_between
from eagor.sphere import world_R_body

ROWS, COLUMNS, RATE, SECONDS = 360, 640, 10, 6
EXPOSURE, PARTS = 0.05, 8  # seconds; pictures that are averaged
TO_BODY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # FLU from OpenCV's right, down, forward
Pictures = list[np.ndarray]


@dataclass
class Answers:
    """The errors (degrees) of one method in one sequence, what it said of them, and its CPU seconds a picture."""

    errors: list[float] = field(default_factory=list)
    spreads: list[float] = field(default_factory=list)
    lost: bool = False
    seconds: float = 0.0


def odometer(pictures: Pictures, grid: PerspectiveGrid) -> Iterator[tuple[np.ndarray, float, bool]]:
    own = VisualOdometer()
    for number, picture in enumerate(pictures):
        turned = own.add(picture, number / RATE, grid)
        yield turned.world_R_body, math.degrees(turned.spread), turned.lost


def chained(
    pictures: Pictures, grid: PerspectiveGrid, step: Callable[[np.ndarray, np.ndarray, float], np.ndarray | None]
) -> Iterator[tuple[np.ndarray, float, bool]]:
    pose, before = np.eye(3), None
    for picture in pictures:
        views = Views.of_picture(picture, grid)
        now, turn = views.features, None
        if before is not None:
            a, b = match(before, now)
            turn = step(before.directions[a], now.directions[b], views.area)
            pose = pose if turn is None else pose @ turn
        yield pose, math.nan, before is not None and turn is None
        before = now


def rotation_only(old: np.ndarray, new: np.ndarray, area: float) -> np.ndarray | None:
    found = turn_between(old, new, moves=False, area=area)
    return None if found is None else found.old_R_new


def five_points(old: np.ndarray, new: np.ndarray, area: float) -> np.ndarray | None:
    """OpenCV's essential matrix (Nister 2004) on the plane at distance 1."""
    if len(old) < 8:
        return None
    a, b = (rays @ TO_BODY for rays in (old, new))
    a, b = (rays[:, :2] / rays[:, 2:] for rays in (a, b))
    cv2.setRNGSeed(0)
    essential, mask = cv2.findEssentialMat(a, b, np.eye(3), cv2.RANSAC, 0.999, 2e-3)
    if essential is None or essential.shape != (3, 3):
        return None
    new_R_old = cv2.recoverPose(essential, a, b, np.eye(3), mask=mask)[1]
    return TO_BODY @ new_R_old.T @ TO_BODY.T


METHODS: dict[str, Callable[[Pictures, PerspectiveGrid], Iterator[tuple[np.ndarray, float, bool]]]] = {
    "odometer": odometer,
    "rotation only, chained": lambda pictures, grid: chained(pictures, grid, rotation_only),
    "five points, chained": lambda pictures, grid: chained(pictures, grid, five_points),
}


def pose_at(seconds: float, far: float = math.radians(170)) -> np.ndarray:
    """Out by `far` and back, with a wobble."""
    half = SECONDS / 2
    yaw = far * (1 - math.cos(math.pi * seconds / half)) / 2
    return world_R_body(yaw, math.radians(12) * math.sin(1.3 * seconds), math.radians(5) * math.sin(1.7 * seconds))


def pans(photograph: np.ndarray, hfov: float, blurred: bool, things: Pictures) -> Pictures:
    pictures = []
    for number in range(SECONDS * RATE + 1):
        at = number / RATE
        moments = at + EXPOSURE * (np.arange(PARTS) / PARTS - 0.5) if blurred else [at]
        grids = [PerspectiveGrid(ROWS, COLUMNS, hfov, pose_at(moment)) for moment in moments]
        picture = np.mean(cut(photograph, *grids), axis=0)
        pictures.append(pasted(np.rint(picture).astype(np.uint8), things, at))
    return pictures


def pasted(picture: np.ndarray, things: Pictures, seconds: float) -> np.ndarray:
    """With things that cross the picture at speeds of their own."""
    for number, thing in enumerate(things):
        height, width = thing.shape[:2]
        speed = (110.0, -70.0, 160.0)[number]
        left = round((200 * number + speed * seconds) % (COLUMNS + width)) - width
        top = 40 + 70 * number
        visible = slice(max(left, 0), min(left + width, COLUMNS))
        picture[top : top + height, visible] = thing[: ROWS - top, visible.start - left : visible.stop - left]
    return picture


def walk(seed: int, hfov: float) -> tuple[Pictures, list[np.ndarray]]:
    """One metre a second through an apartment; the head turns about the way."""
    from eagor.worlds import ground_of
    from eagor.worlds.apartment import generate
    from eagor.worlds.render import Renderer
    from eagor.worlds.walkable import stroll

    scene, random = generate(seed), np.random.default_rng(seed)
    ground, renderer = ground_of(scene, 0.3), Renderer(scene)
    grid = PerspectiveGrid(ROWS, COLUMNS, hfov)
    points = stroll(ground, ground.sample(random), 1.0 / RATE, random)
    places = [next(points) for _ in range(SECONDS * RATE + 1)]
    poses = [pose_at(number / RATE, math.radians(60)) for number in range(len(places))]
    pictures = []
    for place, pose in zip(places, poses, strict=True):
        frame = renderer.view((place[0], place[1], 1.4), pose, grid, range=False, ids=False)
        assert frame.rgb is not None
        pictures.append(frame.rgb)
    return pictures, poses


def judged(method: str, pictures: Pictures, grid: PerspectiveGrid, poses: list[np.ndarray]) -> Answers:
    answers, begun = Answers(), time.process_time()
    for number, (pose, spread, lost) in enumerate(METHODS[method](pictures, grid)):
        truth = poses[0].T @ poses[number]
        answers.errors.append(math.degrees(Rotation.from_matrix(pose @ truth.T).magnitude()))
        answers.spreads.append(spread)
        answers.lost |= lost
    answers.seconds = (time.process_time() - begun) / len(pictures)
    return answers


def show(condition: str, field_: float, method: str, found: list[Answers]) -> None:
    middle = SECONDS * RATE // 2
    drift = np.median([each.errors[middle] for each in found]) * 60 / (SECONDS / 2)
    ends = [each.errors[-1] for each in found]
    over = np.mean([np.array(each.errors[1:]) > 3 * np.array(each.spreads[1:]) for each in found])
    told = "over    -  told       -  within    -"
    if method == "odometer":
        sigmas = math.sqrt(3) * np.array([[each.spreads[at] for at in (middle, -1)] for each in found])
        off = np.array([[each.errors[at] for at in (middle, -1)] for each in found])
        within = np.mean(off <= 2 * sigmas)
        told = f"over {over:4.2f}  told {np.median(sigmas[:, 1]):7.3f}  within {within:4.2f}"
    lost = sum(each.lost for each in found)
    seconds = np.mean([each.seconds for each in found])
    print(
        f"{condition:22} {field_:4.0f}  {method:23} drift {drift:7.3f}  end {np.median(ends):7.3f}  worst "
        f"{max(ends):7.3f}  {told}  lost {lost} of {len(found)}  CPU {seconds:.3f} s",
        flush=True,
    )


def main() -> None:
    """Print the table."""
    parser = common.parser(__doc__)
    parser.add_argument("--photographs", type=Path, default=Path(__file__).parents[1] / ".." / "shared" / "panoramas")
    parser.add_argument("--fields", type=float, nargs="+", default=[60.0, 90.0, 120.0])
    parser.add_argument("--walks", type=int, default=4)
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=list(METHODS))
    parser.add_argument("--first", type=int, default=0, help="so many photographs only (0: all)")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    photographs = [read_panorama(path) for path in sorted(options.photographs.glob("*.png"))]
    if not photographs:
        parser.error(f"no PNG files in {options.photographs}; give a folder with panoramas")
    # As fine as the narrowest pictures, or flow would follow the corners of pixels.
    fine = [cv2.resize(each, (2048, 1024), interpolation=cv2.INTER_CUBIC) for each in photographs]
    things = [np.ascontiguousarray(each[400:580, 600:720]) for each in fine[1:4]]
    conditions: dict[str, tuple[bool, Pictures]] = {
        "as it is": (False, []),
        "blurred": (True, []),
        "moving things": (False, things),
    }
    poses = [pose_at(number / RATE) for number in range(SECONDS * RATE + 1)]
    chosen = fine[: options.first or None]
    for degrees in options.fields:
        hfov = math.radians(degrees)
        grid = PerspectiveGrid(ROWS, COLUMNS, hfov)
        for condition, (blurred, pasted_on) in conditions.items():
            sequences = [pans(each, hfov, blurred, pasted_on) for each in chosen]
            for method in options.methods:
                show(condition, degrees, method, [judged(method, each, grid, poses) for each in sequences])
        walks = [walk(100 + seed, hfov) for seed in range(options.walks)]
        for method in options.methods:
            if walks:
                show("walking", degrees, method, [judged(method, *each[:1], grid, each[1]) for each in walks])


if __name__ == "__main__":
    main()
