"""Lenses: what a round trip through a dual fisheye loses, how long stitching takes, how well calibration finds them.

python benchmarks/lenses.py [--photographs ../shared/panoramas] [--height 512] [--turns 8] [--still 3]

Round trip: photograph -> two ideal circles of 200 degrees -> panorama; PSNR in dB, each pixel with its solid angle, and
plain. "smooth": without detail finer than the lens (the photograph has passed it once). Stitching: CPU milliseconds per
frame, one thread. Calibration: pictures of two distorted lenses (fields 197 and 203 degrees, curves off by up to 6 %,
centres by 1 %, tilts by 1.5 degrees) in the photograph; from pictures of a camera that turned in place, and from the
overlap alone. Errors in degrees over all pixels, with the rig as a whole turned to fit best; "says": what the
calibration itself states (largest standard deviation).
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

import common
import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from rigs import distorted_rig, off

from eagor.grids import ErpGrid
from eagor.media.lens_calibration import calibrate
from eagor.media.panorama import read_panorama, turn
from eagor.media.rigs import dual_fisheye
from eagor.media.stitching import Stitcher, seen_by
from eagor.sphere import world_R_body


def loss(found: np.ndarray, wanted: np.ndarray) -> tuple[float, float]:
    """PSNR with solid angles, and plain."""
    weights = ErpGrid(*wanted.shape[:2]).weights
    error = ((found.astype(float) - wanted) ** 2).mean(axis=2)
    means = float((error * weights).sum() / weights.sum()), float(error.mean())
    return tuple(10 * math.log10(255**2 / mean) for mean in means)  # type: ignore[return-value]


def round_trip(photograph: np.ndarray) -> None:
    rig = dual_fisheye(1920, 960)
    stitcher = Stitcher(rig)
    panorama = cv2.resize(photograph, stitcher.grid.shape[::-1], interpolation=cv2.INTER_CUBIC)
    pictures = seen_by(rig, panorama)
    found = stitcher.stitch(*pictures)
    smooth = stitcher.stitch(*seen_by(rig, found))
    begin = time.process_time()
    for _ in range(10):
        stitcher.stitch(*pictures)
    took = (time.process_time() - begin) / 10
    print(
        "  round trip {:5.1f} dB ({:5.1f} plain); smooth {:5.1f} dB ({:5.1f} plain)".format(
            *loss(found, panorama), *loss(smooth, found)
        ),
        f"  stitching {1e3 * took:5.1f} ms of CPU for {2 * stitcher.grid.height} x {stitcher.grid.height}",
    )


def calibration(photograph: np.ndarray, height: int, count: int, turned: bool) -> None:
    true, moments = distorted_rig(height), []
    for k in range(count):
        pose = world_R_body(2 * math.pi * k / count + 0.1 * k, 0.03 * math.sin(k), 0.02 * math.cos(k))
        moments.append(seen_by(true, turn(photograph, pose.T)))
    begin = time.process_time()
    found = calibrate(moments, turned=turned)
    errors = off(found.rig, true)
    how = "turned in place" if turned else "overlap alone"
    error = f"error {math.sqrt((errors**2).mean()):6.3f} (max {errors.max():6.3f}) deg"
    took = f"{time.process_time() - begin:.0f} s of CPU"
    print(f"  {how:16s} {count} pictures: {error}, says {math.degrees(found.worst):5.2f}; pairs {found.pairs}; {took}")


def main() -> None:
    parser = common.parser(__doc__)
    parser.add_argument("--photographs", type=Path, default=Path(__file__).parents[2] / "shared" / "panoramas")
    parser.add_argument("--height", type=int, default=512)
    parser.add_argument("--turns", type=int, default=8)
    parser.add_argument("--still", type=int, default=3)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    for path in sorted(options.photographs.glob("*.png")):
        print(path.name)
        photograph = read_panorama(path)
        round_trip(photograph)
        calibration(photograph, options.height, options.turns, turned=True)
        calibration(photograph, options.height, options.still, turned=False)


if __name__ == "__main__":
    main()
