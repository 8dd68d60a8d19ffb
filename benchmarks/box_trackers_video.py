"""A video cut from a photograph, ours beside BoT-SORT on the same boxes: a film of both, and how far each is off.

    python benchmarks/box_trackers_video.py PANORAMAS [OUT.webp] [--photograph NAME] [--query QUERY]

A camera turns in the photograph by 30 degrees a second and tumbles, as in docs/figures/footage.py: 10 s, two looks a
second. `coco` looks (eagor models get coco), and the rotation comes from the pictures alone. Truth was marked by hand
(tests/photographs.json). Without options it takes the first photograph, by name, with things that there is one of, and
films the first of these; the table has all of them, over the last half of the looks.

Rows: `eagor`; `bot_sort`, whose boxes are turned with the poses into a panorama that stands still (`box_trackers`); and
`as it comes`, BoT-SORT on the boxes of the pictures themselves, as for any video.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import box_trackers
import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "docs" / "figures"))

from footage import FRAMES, LOOKS, SECONDS, pose_at

from eagor import DirectionTracker, TrackerConfig
from eagor.drawing import paint_belief
from eagor.drawing.style import INK, figure, image, plain
from eagor.drawing.video import Animation
from eagor.evidence import Evidence
from eagor.media.panorama import read_panorama, turn
from eagor.media.rotation import VisualOdometer
from eagor.perception.coco import DETECTOR, coco_detector
from eagor.perception.views import Views
from eagor.sphere import angular_distance, azimuth_elevation, direction

ANNOTATIONS = ROOT / "tests" / "photographs.json"
OURS, TURNED, PLAIN = "eagor", "bot_sort", "as it comes"
ROWS, WIDTH, HEIGHT = 256, 960, 300  # of what is drawn


def singles(things: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """The directions ``(3,)`` in the photograph of what there is one of, by name."""
    counts = Counter(name for thing in things for name in thing["names"])
    return {
        name: direction(*np.radians([thing["azimuth_deg"], thing["elevation_deg"]]))
        for thing in things
        for name in thing["names"]
        if counts[name] == 1
    }


class Rivals:
    """All three methods on the looks at one thing."""

    def __init__(self, true: np.ndarray) -> None:
        self.true = true
        self.tracker = DirectionTracker(TrackerConfig(detector=DETECTOR))
        self.boxes = {TURNED: box_trackers.BoxTracker(TURNED), PLAIN: box_trackers.BoxTracker(TURNED, turned=False)}
        self.seen: Evidence | None = None
        self.errors: dict[str, list[float]] = {OURS: [], TURNED: [], PLAIN: []}

    def move(self, stamp: float, pose: np.ndarray) -> None:
        """To the pose of a picture."""
        self.tracker.add_pose(stamp, pose)
        for method in self.boxes.values():
            method.move(stamp, pose, None)

    def see(self, evidence: Evidence) -> None:
        """A look."""
        self.seen = evidence
        self.tracker.observe(evidence)
        for method in self.boxes.values():
            method.see(evidence)

    def answers(self, stamp: float) -> dict[str, np.ndarray]:
        """Directions ``(3,)`` in the body frame; straight ahead while nothing is known."""
        found = self.tracker.estimate(stamp).direction
        ours = np.array([1.0, 0.0, 0.0]) if found is None else found
        return {OURS: ours} | {name: method.direction() for name, method in self.boxes.items()}

    def judge(self, stamp: float, pose: np.ndarray) -> None:
        """Note the errors, degrees; `pose` is the true one."""
        for name, answer in self.answers(stamp).items():
            self.errors[name].append(float(np.degrees(angular_distance(answer, pose.T @ self.true))))


def draw(picture: np.ndarray, rivals: Rivals, stamp: float, pose: np.ndarray, query: str) -> np.ndarray:
    """Ours on the left, the boxes of the newest look and BoT-SORT's answers on the right."""
    sheet = figure(WIDTH, HEIGHT)
    small, true = picture[:: picture.shape[0] // ROWS, :: picture.shape[0] // ROWS], pose.T @ rivals.true
    left, right = sheet.add_axes((0.01, 0.05, 0.485, 0.82)), sheet.add_axes((0.505, 0.05, 0.485, 0.82))
    paint_belief(left, small, rivals.tracker.estimate(stamp), true, modes=())
    right.imshow(small, extent=(180, -180, -90, 90), aspect="auto")
    marks = {"truth": (true, "o", "#35ff6b", 17), **{
        name: (rivals.answers(stamp)[name], marker, colour, 9)
        for name, marker, colour in ((TURNED, "s", "#ffb000"), (PLAIN, "X", "#ff5fa2"))
    }}  # fmt: skip
    for name, (where, marker, colour, size) in marks.items():
        azimuth, elevation = np.degrees(azimuth_elevation(where))
        face = "none" if name == "truth" else colour
        edge = colour if name == "truth" else "black"
        label = name if name != PLAIN else f"{name} (boxes not turned)"
        right.plot(azimuth, elevation, marker, mfc=face, mec=edge, mew=2, ms=size, ls="none", label=label)
    if rivals.seen is not None and rivals.seen.detections is not None:
        found = rivals.seen.detections
        for box in box_trackers.on_panorama(found.directions, found.axes):
            x0, y0, x1, y1 = box  # one pixel a degree, from the upper left corner
            right.plot(180 - np.array([x0, x1, x1, x0, x0]), 90 - np.array([y0, y0, y1, y1, y0]), color="#ffb000", lw=1)
    right.set_xlim(180, -180)
    right.set_ylim(-90, 90)
    right.legend(loc="lower center", ncols=3, fontsize=8, framealpha=0.8)
    off = {name: errors[-1] for name, errors in rivals.errors.items()}
    plain(right)
    for axes, text in (
        (left, f"eagor: {query}, off by {off[OURS]:.0f}°"),
        (right, f"BoT-SORT: off by {off[TURNED]:.0f}°; as it comes {off[PLAIN]:.0f}°"),
    ):
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_title(text, loc="left", fontsize=11, color=INK, weight="bold")
    return np.asarray(image(sheet).convert("RGB"))


def main() -> int:
    """Play, film, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("panoramas", type=Path, help="the folder of the photographs")
    parser.add_argument("out", nargs="?", type=Path, default=ROOT / "docs" / "images" / "side-by-side.webp")
    parser.add_argument("--photograph", help="name of a photograph")
    parser.add_argument("--query", help="what is filmed")
    given = parser.parse_args()
    if not box_trackers.NAMES:
        parser.error("BoT-SORT is not installed: pip install --no-deps trackers, beside the extra dev")
    known = {name: singles(told["things"]) for name, told in json.loads(ANNOTATIONS.read_text()).items()}
    name = given.photograph or next(name for name in sorted(known) if known[name])
    things = known[name]
    filmed = given.query or next(iter(things))
    photograph, odometer = read_panorama(given.panoramas / name), VisualOdometer()
    views = Views(coco_detector(), detector=DETECTOR)
    rivals = {query: Rivals(true) for query, true in things.items()}
    film = Animation(given.out, FRAMES)
    for number, stamp in enumerate(np.arange(0, SECONDS, 1 / FRAMES).tolist()):
        true = pose_at(stamp)
        picture = turn(photograph, true.T)
        pose = odometer.add(picture).world_R_body
        for each in rivals.values():
            each.move(stamp, pose)
        if number % round(FRAMES / LOOKS) == 0:
            looks, _ = views.around(picture, [*things], stamp, pose)
            for each, evidence in zip(rivals.values(), looks, strict=True):
                each.see(evidence)
                each.judge(stamp, true)
        film.add(draw(picture, rivals[filmed], stamp, true, filmed), stamp)
    film.close()
    print(f"{name}: degrees off, over the last half of {len(rivals[filmed].errors[OURS])} looks")
    print(f"{'':14}" + "".join(f"{method:>14}" for method in (OURS, TURNED, PLAIN)))
    for query, each in rivals.items():
        halves = [errors[len(errors) // 2 :] for errors in each.errors.values()]
        print(f"{query:14}" + "".join(f"{np.mean(errors):14.1f}" for errors in halves))
    print(f"{given.out}: {given.out.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
