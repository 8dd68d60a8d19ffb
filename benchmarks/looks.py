"""What a look of `coco` costs, and what smaller views lose, on photographs. The first argument is their folder.

python benchmarks/looks.py PANORAMAS [--widths 1024,640] [--sizes 512,320] [--frames 8] [--together 1,2] [--repeat 3]

Each photograph (tests/photographs.json, truth marked by hand) is shrunk to each of the widths and turned as in
`photographs.py` (yaw, tumble). The sizes are pixels along the side of a view and of the network's input. Printed are the recall per frame (a marked thing counts as found if a detection of
its class lies within 15 degrees of it, or within half its size), how many detections per look are of nothing that is
marked, and CPU and wall seconds of a look: the least of the repetitions, by how many views are looked at at a time.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from pathlib import Path

import numpy as np
from photographs import ANNOTATIONS, NEAR, places, pictures, poses
from PIL import Image

from eagor.media.panorama import read_panorama
from eagor.perception.coco import CLASSES, from_text
from eagor.perception.views import Views
from eagor.sphere import angular_distance


def recall(views: Views, folder: Path, width: int, frames: int) -> tuple[int, int, int, int]:
    """Marked things found, marked things, detections of nothing that is marked, and looks."""
    found = marked = wrong = looks = 0
    for name, notes in json.loads(ANNOTATIONS.read_text()).items():
        photograph = shrunk(read_panorama(folder / name), width)
        classes = sorted({each for thing in notes["things"] for each in thing["names"]} | set(notes["absent"]))
        for condition in ("yaw", "tumble"):
            turned = zip(poses(condition)[:frames], pictures(photograph, condition), strict=False)
            for pose, picture in turned:
                looks += 1
                seen = dict(zip(classes, views.things(picture, classes, pose), strict=True))
                for query, things in seen.items():
                    at, sizes = places([thing for thing in notes["things"] if query in thing["names"]])
                    near = np.maximum(math.radians(NEAR), sizes / 2)
                    angles = [angular_distance(at @ pose, thing.direction) for thing in things]
                    hits = np.array([each <= near for each in angles]).reshape(len(things), len(at))
                    found, marked = found + int(hits.any(axis=0).sum()), marked + len(at)
                    wrong += int((~hits.any(axis=1)).sum())
    return found, marked, wrong, looks


def shrunk(photograph: np.ndarray, width: int) -> np.ndarray:
    """The photograph with so many columns."""
    image = Image.fromarray(photograph)
    return np.asarray(image.resize((width, width // 2), Image.Resampling.BOX if width < image.width else Image.Resampling.BICUBIC))


def cost(views: Views, panorama: np.ndarray, repeat: int) -> tuple[float, float]:
    """CPU and wall seconds of one look for all classes: the least of the repetitions."""
    taken = []
    for _ in range(repeat + 1):
        before = time.process_time(), time.perf_counter()
        views.things(panorama, CLASSES, np.eye(3))
        taken.append((time.process_time() - before[0], time.perf_counter() - before[1]))
    cpu, wall = zip(*taken[1:], strict=True)
    return min(cpu), min(wall)


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("panoramas", type=Path, help="the folder of the photographs")
    parser.add_argument("--widths", default="1024,640", help="of the panoramas, pixels, with commas")
    parser.add_argument("--sizes", default="512,416,320", help="of the views, pixels, with commas")
    parser.add_argument("--frames", type=int, default=8, help="of each photograph and way of turning")
    parser.add_argument("--together", default="1,2", help="views at a time, with commas")
    parser.add_argument("--repeat", type=int, default=3, help="looks of which the quickest counts")
    options = parser.parse_args()
    widths, sizes, many = ([int(each) for each in text.split(",")] for text in (options.widths, options.sizes, options.together))
    print(f"{'panorama':>12}{'views':>7}{'found':>11}{'recall':>8}{'wrong/look':>12}")
    for width in widths if options.frames else ():
        for size in sizes:
            views = from_text(f"size={size}&together={many[-1]}")
            found, marked, wrong, looks = recall(views, options.panoramas, width, options.frames)
            print(f"{width:>7} x {width // 2:<4}{size:>5}{found:>6}/{marked:<5}{found / marked:>7.3f}{wrong / looks:>12.2f}", flush=True)
    print(f"\n{os.cpu_count()} cores\n{'panorama':>12}{'views':>7}{'together':>10}{'CPU s':>8}{'wall s':>8}")
    name = next(iter(json.loads(ANNOTATIONS.read_text())))
    for width in widths:
        panorama = shrunk(read_panorama(options.panoramas / name), width)
        for size in sizes:
            for together in many:
                cpu, wall = cost(from_text(f"size={size}&together={together}"), panorama, options.repeat)
                print(f"{width:>7} x {width // 2:<4}{size:>5}{together:>9}{cpu:>9.3f}{wall:>8.3f}", flush=True)


if __name__ == "__main__":
    main()
