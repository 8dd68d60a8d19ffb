"""The moving picture of the front page: one search in a built-in apartment, through the camera.

    python docs/figures/moving.py [OUT.webp] [--seed 600] [--episode 1] [--width 760]

The search is played as `eagor bench run navigation --perception scout` plays it: while nothing is believed, the body
looks where that tells most. Then its way is gone once more through the public face alone (a tracker, the perception,
poses by time stamp), and drawn, also in poses between two looks, where nothing but the odometry is new.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import eagor
from eagor.conventions import rotation_from_wxyz
from eagor.drawing import paint_belief
from eagor.drawing.marks import OURS, TRUTH
from eagor.drawing.style import INK, QUIET, far_in_words, figure, image
from eagor.lab.agents.methods import BASE
from eagor.lab.envs.episodes import EpisodeSpec
from eagor.lab.envs.places import APARTMENT, load_place
from eagor.lab.envs.rules import Camera
from eagor.lab.tasks.sim.play import Runner
from eagor.lab.worlds import View
from eagor.perception import load
from eagor.sphere import interpolate_rotation, unit

if TYPE_CHECKING:
    from PIL.Image import Image

ROWS = 256  # of the panoramas that are drawn
BETWEEN = 3  # pictures per step
HIGHEST = 60  # degrees of elevation that are shown
MILLISECONDS = 120  # per picture
QUALITY = 76


@dataclass(frozen=True)
class Way:
    """Where the search went: what was looked for and where it is, and the camera's poses, one per step."""

    query: str
    target: np.ndarray
    positions: np.ndarray
    rotations: np.ndarray


def search(seed: int, index: int) -> Way:
    """Play the episode with our tracker."""
    runner = Runner({"task": "navigation", "perception": "scout"})
    record = runner.run_episode(EpisodeSpec("navigation", APARTMENT, seed, index, index), ["eagor"])
    poses = np.array(record["methods"]["eagor"]["trace"]["pose"])
    thing = load_place(APARTMENT, seed, runner.camera.radius).scene.instances[record["episode"]["targets"][0]]
    rotations = np.array([rotation_from_wxyz(pose[3:]) for pose in poses])
    return Way(record["episode"]["query"], thing.centre, poses[:, :3], rotations)


def photograph(renderer: View, position: np.ndarray, world_R_body: np.ndarray, rows: int) -> np.ndarray:
    """What the camera sees ``(rows, 2 rows, 3)``."""
    rgb = renderer.panorama(position, world_R_body, rows, range=False, ids=False).rgb
    assert rgb is not None
    return rgb


def pictures(way: Way, seed: int, width: int) -> list[Image]:
    """Go the way again, and draw it."""
    camera, perceive = Camera(), load("scout")
    tracker = eagor.DirectionTracker(BASE)
    renderer = load_place(APARTMENT, seed, camera.radius).renderer
    drawn = []
    for step in range(len(way.positions)):
        for part in range(BETWEEN if step else 1):
            share = (part + 1) / BETWEEN if step else 1.0  # the last part of a step is the pose of its look
            position, turned = way.positions[step], way.rotations[step]
            if share < 1:
                position = way.positions[step - 1] + share * (position - way.positions[step - 1])
                turned = interpolate_rotation(way.rotations[step - 1], turned, share)
            stamp = (step - 1 + share) * camera.seconds
            seen = photograph(renderer, position, turned, ROWS)
            tracker.add_pose(stamp, turned, position)
            if share == 1:  # it looks at what it looked at in the search
                small = photograph(renderer, position, turned, perceive.rows)  # type: ignore[attr-defined]
                tracker.observe(perceive(small, way.query, stamp=stamp))
            truth = unit(turned.T @ (way.target - position))
            drawn.append(draw(seen, tracker.estimate(stamp), truth, way, stamp, width))
    return drawn


def draw(seen: np.ndarray, estimate: eagor.Estimate, truth: np.ndarray, way: Way, stamp: float, width: int) -> Image:
    """One picture."""
    tall, head, foot = round(width * HIGHEST / 180), 34, 26
    sheet = figure(width, tall + head + foot)
    axes = sheet.add_axes((0, foot / (tall + head + foot), 1, tall / (tall + head + foot)))
    paint_belief(axes, seen, estimate, truth=truth, modes=())
    axes.set_ylim(-HIGHEST, HIGHEST)
    axes.set_axis_off()
    off = "not known"
    if estimate.direction is not None:
        off = f"off by {math.degrees(float(eagor.angular_distance(estimate.direction, truth))):.0f}°"
    top, low = 1 - head / 2 / (tall + head + foot), foot / 2 / (tall + head + foot)
    sheet.text(0.012, top, f"Where is the {way.query}?", fontsize=13, color=INK, weight="bold", va="center")
    far = far_in_words(estimate)  # only where it is well known
    said = f"{stamp:4.1f} s   {estimate.status}{f'   {far} away' if far else ''}   {off}"
    sheet.text(0.988, top, said, fontsize=11, color=INK, va="center", ha="right")
    for x, mark, colour, what in (
        (0.012, "●", OURS, "estimate, and which way to turn"),
        (0.345, "○", TRUTH, "truth"),
        (0.43, "▬", "#e8602d", "belief"),
        (0.52, "▭", QUIET, "its 90 % region"),
    ):
        sheet.text(x, low, mark, fontsize=12, color=colour, va="center", weight="bold")
        sheet.text(x + 0.026, low, what, fontsize=9.5, color=INK, va="center")
    sheet.text(0.988, low, "middle: forward   edges: behind", fontsize=9.5, color=QUIET, va="center", ha="right")
    return image(sheet)


def main() -> None:
    """Draw it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", nargs="?", type=Path, default=Path(__file__).parents[1] / "images" / "search.webp")
    parser.add_argument("--seed", type=int, default=600, help="of the apartment")
    parser.add_argument("--episode", type=int, default=1, help="which search in it, 0 to 4")
    parser.add_argument("--width", type=int, default=760)
    given = parser.parse_args()
    way = search(given.seed, given.episode)
    print(f"   {len(way.positions)} looks for the {way.query}", flush=True)
    first, *others = pictures(way, given.seed, given.width)
    times = [900, *[MILLISECONDS] * (len(others) - 1), 2500]
    first.save(given.out, save_all=True, append_images=others, duration=times, loop=0, quality=QUALITY, method=6)
    print(f"   {given.out}: {given.out.stat().st_size / 1e6:.2f} MB, {1 + len(others)} pictures", flush=True)


if __name__ == "__main__":
    main()
