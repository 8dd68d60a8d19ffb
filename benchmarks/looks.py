"""What a look of `coco` at footage costs. The first argument is a photograph, the second how many looks.

python benchmarks/looks.py PHOTOGRAPH [--looks 10] [--repeat 3] [--widths 1024,640] [--cores 2]

A camera turns in the photograph: a video with ten frames a second, of which two are looked at. Printed are CPU and wall
seconds per look, of everything that `eagor track` does: decoding, the rotation from the pictures, the detector, the
answer. "one by one": on one core; "together": as the command does it on so many cores, frames made ahead by a thread,
views seen at the same time. The two take turns, and the least of the repetitions counts.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from eagor.drawing.video import Movie
from eagor.media.footage import LEAST_ROWS, FrameCheck, VideoFrames
from eagor.media.panorama import read_panorama, turn
from eagor.media.posed_frames import ahead, posed_by_sight
from eagor.media.rig_videos import open_video
from eagor.perception.coco import from_text
from eagor.perception.footage import follow
from eagor.sphere import world_R_body
from eagor.tracking import TrackerConfig

RATE, FRAMES = 2.0, 10.0  # looks and frames per second


def film(photograph: np.ndarray, width: int, looks: int, path: Path) -> None:
    """Write the video of a camera that turns and nods."""
    size = (width, width // 2)
    small = cv2.resize(photograph, size, interpolation=cv2.INTER_AREA)
    movie = Movie(path, size, rate=FRAMES)
    for stamp in np.arange(0, looks / RATE, 1 / FRAMES):
        movie.add(turn(small, world_R_body(0.3 * stamp, 0.15 * np.sin(stamp)).T), stamp)
    movie.close()


def tracked(path: Path, cores: int) -> Callable[[], None]:
    """A function that answers about all looks; `cores` above 1: as the command does it."""
    perception = from_text(f"together={cores}")

    def run() -> None:
        frames = posed_by_sight(VideoFrames(open_video([path], rate=RATE, rows=LEAST_ROWS), FrameCheck()), False)
        for _ in follow(ahead(frames) if cores > 1 else frames, perception, "chair", TrackerConfig()):
            pass

    return run


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("photograph", type=Path, help="a panorama")
    parser.add_argument("--looks", type=int, default=10, help="in the video")
    parser.add_argument("--repeat", type=int, default=3, help="runs, of which the least counts")
    parser.add_argument("--widths", default="1024,640", help="of the video, pixels, with commas")
    parser.add_argument("--cores", type=int, default=2, help="to take")
    options = parser.parse_args()
    print(f"{'video':>12}  {'':14}{'CPU s':>8}{'wall s':>8}  per look")
    photograph = read_panorama(options.photograph)
    for width in map(int, options.widths.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "clip.mp4"
            film(photograph, width, options.looks, path)
            ways = {"one by one": tracked(path, 1), "together": tracked(path, options.cores)}
            taken: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
            for _ in range(options.repeat):
                for name, run in ways.items():
                    before = time.process_time(), time.perf_counter()
                    run()
                    taken[name].append((time.process_time() - before[0], time.perf_counter() - before[1]))
            for name, found in taken.items():
                cpu, wall = (min(each) / options.looks for each in zip(*found, strict=True))
                print(f"{width:>5} x {width // 2:<4}  {name:14}{cpu:>8.3f}{wall:>8.3f}", flush=True)


if __name__ == "__main__":
    main()
