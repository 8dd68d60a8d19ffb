"""The first picture of the README: a camera turns and tumbles in a photograph, and ``eagor track`` follows a thing.

    python docs/figures/footage.py PHOTOGRAPH [OUT.webp] [--query backpack]

The photograph is turned by known rotations and written as a video. The command gets only this video: it reads the
rotation from the pictures and looks with `coco` (``pip install '.[photos]'``, ``eagor models get coco``). Nobody tells
it the truth, so none is drawn. The docs' picture is St. Fagans Interior of Poly Haven (CC0), 1024 x 512 pixels.

The pages that docs/index.md shows are made so (extras photos, robot, sim):

    python docs/figures/footage.py brown_photostudio_02_1k.png room.webp --query bed --clip clip.mp4
    eagor live clip.mp4 "bed" --fast --record photograph
    eagor studio export photograph --out docs/episodes/photograph.html
    eagor bench run navigation --perception scout --episodes 6 --seed 40 --methods eagor vmf cent_circ
        --set max_steps=60 --out run
    eagor studio export run --episode 40-1 --out docs/episodes/search.html
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path

import numpy as np

from eagor.cli import main as eagor
from eagor.drawing.video import Movie
from eagor.sources.panorama import read_panorama, turn
from eagor.sphere import world_R_body

SECONDS, LOOKS = 10.0, 2.0  # of the clip; looks per second
FRAMES = 4.0  # per second, of the clip and of the picture that is drawn
BEGIN, SWEEP = math.radians(-105), math.radians(30)  # heading of the first frame, and turn to the left per second
TUMBLE = math.radians(14)  # of pitch and roll


def pose_at(stamp: float) -> np.ndarray:
    """The camera's ``world_R_body`` ``(3, 3)`` at a time: it turns to the left and tumbles; at first it is level."""
    pitch, roll = TUMBLE * math.sin(0.9 * stamp), TUMBLE * math.sin(1.3 * stamp)
    return world_R_body(BEGIN + SWEEP * stamp, pitch, roll)


def clip(photograph: np.ndarray, path: Path) -> None:
    """Write what a camera sees that turns to the left and tumbles; the first frame is level."""
    rows, columns = photograph.shape[:2]
    film = Movie(path, (columns, rows), FRAMES)
    for stamp in np.arange(0, SECONDS, 1 / FRAMES):
        film.add(turn(photograph, pose_at(float(stamp)).T), float(stamp))
    film.close()


def main() -> int:
    """Draw it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photograph", type=Path, help="a panorama, 2:1")
    parser.add_argument("out", nargs="?", type=Path, default=Path(__file__).parents[1] / "images" / "footage.webp")
    parser.add_argument("--query", default="backpack")
    parser.add_argument("--clip", type=Path, help="keep the video here, an mp4")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        film = given.clip or Path(folder) / "clip.mp4"
        clip(read_panorama(given.photograph), film)
        drawn = ["--perception", "coco", "--rate", f"{LOOKS:g}", "--fps", f"{FRAMES:g}", "--video", str(given.out)]
        code = eagor(["track", str(film), given.query, *drawn])
    print(f"   {given.out}: {given.out.stat().st_size / 1e6:.2f} MB")
    return code


if __name__ == "__main__":
    raise SystemExit(main())
