"""CPU time of cutting views from a large panorama: ours against a view at a time in NumPy, alternating.

python benchmarks/cutting.py [--rows 2880] [--size 512] [--rounds 5]

Six views that cover the sphere. One core; the least of the rounds counts, since other processes only add.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np

from eagor.media.cutting import cut, tangent_views
from eagor.media.panorama import view


def main() -> None:
    """Print a line for each way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=2880)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    shape = (options.rows, 2 * options.rows, 3)
    panorama = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    views = tangent_views(options.size)
    ways: dict[str, Callable[[], object]] = {
        "perception.cutting.cut (shrinks first)": lambda: cut(panorama, *views),
        "worlds.panorama.view (no low-pass filter)": lambda: [view(panorama, each) for each in views],
    }
    spent: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(options.rounds + 1):  # the first fills the caches
        for name, way in ways.items():
            start = time.process_time()
            way()
            spent[name].append(time.process_time() - start)
    best = {name: min(times[1:]) for name, times in spent.items()}
    print(f"{len(views)} views of {options.size} px from {shape[1]} x {shape[0]}")
    for name, seconds in best.items():
        print(f"{name:44} {seconds:6.3f} s   {seconds / min(best.values()):5.1f} x")


if __name__ == "__main__":
    main()
