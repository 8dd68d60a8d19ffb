"""An ordinary camera turns in a photograph: its picture, and what is believed all around.

    python docs/figures/ordinary_camera.py PHOTOGRAPH [OUT.jpg] [--query bed] [--azimuths 180,120,60]

The camera looks with `coco` (``pip install '.[photos]'``, ``eagor models get coco``) at the azimuths, one a second, 90
degrees wide and 20 degrees down. The docs' picture is Lythwood Room of Poly Haven (CC0), 1024 x 512 pixels.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

from eagor import DirectionTracker
from eagor.drawing import Mosaic, draw_belief
from eagor.drawing.style import answer_in_words
from eagor.grids import PerspectiveGrid
from eagor.perception.coco import from_text
from eagor.sources.panorama import cut, read_panorama
from eagor.sphere import world_R_body

DOWN = math.radians(20)
OUT = Path(__file__).parents[1] / "images" / "ordinary-camera.jpg"


def main() -> int:
    """Draw it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photograph", type=Path, help="a panorama, 2:1")
    parser.add_argument("out", nargs="?", type=Path, default=OUT)
    parser.add_argument("--query", default="bed")
    parser.add_argument("--azimuths", default="180,120,60", help="degrees, positive to the left")
    given = parser.parse_args()
    photograph, perception = read_panorama(given.photograph), from_text()
    tracker, mosaic, grid = DirectionTracker(), Mosaic(), PerspectiveGrid(480, 640, math.radians(90))
    drawn = None
    for stamp, azimuth in enumerate(map(float, given.azimuths.split(","))):
        pose = world_R_body(math.radians(azimuth), DOWN)
        picture = cut(photograph, replace(grid, body_R_view=pose))[0]
        tracker.add_pose(stamp, pose)
        tracker.observe(perception.view(picture, grid, given.query, stamp=stamp))
        estimate = tracker.estimate(stamp)
        title = f"“{given.query}”: {answer_in_words(estimate)} ({estimate.status})"
        drawn = draw_belief(picture, estimate, title=title, width=1000, grid=grid, mosaic=mosaic)
    assert drawn is not None
    drawn.save(given.out, quality=85)
    print(f"   {given.out}: {given.out.stat().st_size / 1e3:.0f} kB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
