"""The data set: panoramas of built-in apartments with the instance that every pixel shows.

One file per apartment, ``apartment-<seed>.npz``, which is skipped where it exists; the same seed and arguments give the
same arrays. All apartments come from the development seeds; no split holds those of the results
(`eagor.lab.envs.places.REPORT`).

    python data.py FOLDER --split train --apartments 260 --workers 2
    python data.py FOLDER --split held-out --apartments 40 --views 12

Arrays of a file (V views, I instances, H rows):

- ``rgb`` ``(V, H, 2H, 3)`` uint8 sRGB and ``ids`` ``(V, H, 2H)`` int16, in the layout of `eagor.sphere`;
- ``category`` ``(I,)``, ``colour`` ``(I,)``: places in `CLASSES` and `eagor.queries.COLOURS`, -1 for neither;
- ``nameable`` ``(I,)``: 1 if the category alone, 2 if colour and category single the thing out in its apartment,
  else 0 (`eagor.lab.envs.places.Place.nameable`);
- ``pixels`` ``(V, I)`` int32: pixels of an id panorama of 64 rows, by which the tasks decide what is visible;
- ``area`` ``(V, I)`` steradians, ``mean`` ``(V, I, 3)``, ``moment`` ``(V, I, 3, 3)``: solid angle, mean direction
  (unit) and second moments in the tangent plane there (squared chords) of what is visible of a thing, body frame.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import time
from pathlib import Path

import numpy as np

ROWS = 160
LOOK_ROWS = 64
SPLITS = {"train": range(0, 1200), "validation": range(1200, 1400), "held-out": range(1500, 1600)}
HEIGHTS = (1.0, 1.6)  # metres: of the camera
TILT = math.radians(3.0)  # standard deviation of roll and of pitch, in every other view


def classes() -> tuple[str, ...]:
    """Everything that a pixel can show: what can be asked for (balls are put in by `balls`), then the building."""
    from eagor.lab.worlds.apartment import CATEGORIES

    rest = ("wall", "floor", "ceiling")
    return (*sorted({*CATEGORIES, "ball"} - {*rest}), *rest)


def moments(ids: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solid angle ``(I,)``, mean direction ``(I, 3)`` and tangent moments ``(I, 3, 3)`` of each id in ``(H, 2H)``."""
    from eagor.grids import PatchGrid

    grid = PatchGrid(*ids.shape)
    flat, weight, way = ids.ravel().astype(np.intp) + 1, grid.weights.ravel(), grid.directions.reshape(-1, 3)
    area = np.bincount(flat, weight, count + 1)[1:]
    first = np.stack([np.bincount(flat, weight * way[:, i], count + 1)[1:] for i in range(3)], axis=1)
    second = np.empty((count, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            second[:, i, j] = second[:, j, i] = np.bincount(flat, weight * way[:, i] * way[:, j], count + 1)[1:]
    mean = first / np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    plane = np.eye(3) - mean[:, :, None] * mean[:, None, :]
    return area, mean, plane @ (second / np.maximum(area, 1e-12)[:, None, None]) @ plane


def make(job: tuple[int, Path, int, int, bool]) -> tuple[int, float]:
    """Write the file of one apartment: (seed, folder, views, rows, quick light). The seed, and the seconds it took."""
    seed, folder, views, rows, quick = job
    started = time.process_time()
    file = folder / f"apartment-{seed:05d}.npz"
    if file.exists():
        return seed, 0.0
    from scipy.spatial.transform import Rotation

    from eagor.lab.envs.places import Place
    from eagor.lab.worlds import light
    from eagor.lab.worlds.apartment import generate
    from eagor.lab.worlds.ground import Ground
    from eagor.lab.worlds.light import STEP, Lattice
    from eagor.lab.worlds.render import Renderer, Shader
    from eagor.queries import COLOURS

    scene = generate(seed)
    place = Place(scene, Ground.from_scene(scene), Renderer(scene))
    # Light of its own, so that no cache fills. The quick one, coarser than what the package draws, is half the work;
    # at the size of these pictures they look the same.
    lattice = Lattice.of(scene, 0.35 if quick else STEP)
    if quick:
        light.DIRECTIONS, light.BOUNCES = 12, 2
    shade = Shader(scene, lattice, light.bake(scene, lattice).astype(np.float32))
    vars(place.renderer).update(_lattice=lattice, _shader=shade)

    rng = np.random.default_rng([seed, 7])
    names = classes()
    count = len(scene.instances)
    kept: dict[str, list[np.ndarray]] = {key: [] for key in ("rgb", "ids", "pixels", "area", "mean", "moment")}
    for view in range(views):
        x, y = place.ground.sample(rng, clearance=0.05)
        yaw, height = rng.uniform(-math.pi, math.pi), rng.uniform(*HEIGHTS)
        pitch, roll = rng.normal(scale=TILT, size=2) * (view % 2)
        turn = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        frame = place.renderer.panorama((x, y, height), turn, rows, range=False)
        assert frame.rgb is not None
        assert frame.ids is not None
        look = place.ids(np.array([x, y, height]), turn, LOOK_ROWS)
        area, mean, moment = moments(frame.ids, count)
        kept["rgb"].append(frame.rgb)
        kept["ids"].append(frame.ids.astype(np.int16))
        kept["pixels"].append(np.bincount(look.ravel() + 1, minlength=count + 1)[1:].astype(np.int32))
        for key, value in (("area", area), ("mean", mean), ("moment", moment)):
            kept[key].append(value.astype(np.float32))
    nameable = np.zeros(count, dtype=np.int8)
    for index, query in place.nameable().items():
        nameable[index] = 2 if query.colour else 1
    labels = {
        "category": np.array([names.index(thing.category) for thing in scene.instances], dtype=np.int16),
        "colour": np.array([COLOURS.index(t.colour) if t.colour in COLOURS else -1 for t in scene.instances], np.int16),
        "nameable": nameable,
    }
    part = file.with_suffix(f".{os.getpid()}.part")
    with part.open("wb") as out:
        np.savez(out, **{key: np.stack(values) for key, values in kept.items()}, **labels)  # type: ignore[arg-type]
    part.replace(file)
    return seed, time.process_time() - started


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description="Make the scout's data set.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--split", choices=SPLITS, default="train")
    parser.add_argument("--apartments", type=int, default=260)
    parser.add_argument("--views", type=int, default=32)
    parser.add_argument("--rows", type=int, default=ROWS)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--full-light", action="store_true", help="as the package draws; always so for held-out")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no new apartment after so long")
    given = parser.parse_args()
    folder = given.folder / given.split
    folder.mkdir(parents=True, exist_ok=True)
    quick = not (given.full_light or given.split == "held-out")
    seeds = SPLITS[given.split][: given.apartments]
    jobs = [(seed, folder, given.views, given.rows, quick) for seed in seeds]
    began = time.monotonic()
    with multiprocessing.get_context("spawn").Pool(given.workers) as pool:
        results = pool.imap_unordered(make, jobs) if given.workers > 1 else map(make, jobs)
        for done, (seed, seconds) in enumerate(results, 1):
            print(f"{done}/{len(jobs)} apartment {seed}: {seconds:.1f} s of CPU", flush=True)
            if time.monotonic() - began > 60 * given.minutes:
                pool.terminate()
                break


if __name__ == "__main__":
    main()
