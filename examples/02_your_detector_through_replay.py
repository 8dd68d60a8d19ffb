"""Your detector, through a file.

What is learnt: any detector can feed a tracker without a line of glue: it writes what it found as JSON lines, and the
perception `replay` reads them (docs/replay-format.md). The stand-in for your detector here is a threshold on red.
"""

import math
import tempfile
from pathlib import Path

import numpy as np

import eagor
from eagor.lab.worlds.painted import EYE, Room, bearing, paint
from eagor.perception import load
from eagor.perception.replay import write_record
from eagor.sphere import world_R_body

HEIGHT, WIDTH = 128, 256


def your_detector(picture: np.ndarray) -> list[dict]:
    """Boxes of one panorama ``(H, W, 3)``, in pixels from the upper left corner."""
    red, green, blue = picture.astype(int).transpose(2, 0, 1)
    rows, columns = np.nonzero((red > 90) & (green < red / 2) & (blue < red / 2))
    if len(rows) == 0:
        return []  # looked and saw nothing: that is information too
    box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    return [{"box": [int(value) for value in box], "score": 0.9, "label": "red ball"}]


room = Room()
poses = [(0.25 * step, world_R_body(math.radians(20 * step))) for step in range(6)]  # 20 degrees left per look

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder, "detections.jsonl")
    with path.open("w", encoding="utf-8") as file:  # this part runs wherever your detector runs
        for stamp, pose in poses:
            found = your_detector(paint(room, EYE, pose, HEIGHT, WIDTH))
            write_record(file, stamp, image={"width": WIDTH, "height": HEIGHT}, boxes=found)
    print(path.read_text().splitlines()[0])

    perceive = load(f"replay:{path}")  # and this part wherever the tracker runs
    tracker = eagor.DirectionTracker()
    for stamp, pose in poses:
        tracker.add_pose(stamp, pose)
        tracker.observe(perceive(np.zeros((HEIGHT, WIDTH, 3), np.uint8), "the red ball", stamp=stamp))
        estimate, truth = tracker.estimate(stamp), bearing(room.balls[0], EYE, pose)[0]
        error = math.degrees(eagor.angular_distance(estimate.direction, truth))
        print(f"t = {stamp:.2f} s: {math.degrees(estimate.azimuth):7.1f} deg, {error:.1f} deg off, {estimate.status}")
