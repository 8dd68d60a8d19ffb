"""Draw what a belief looks like: from the response of a detector to evidence, and from evidence to a probability.

    python docs/figures/belief.py [FOLDER]

A search in a built-in apartment with `scout`, seven looks into it, played as `eagor bench run navigation` plays it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from common import INK, SIGNED, figure, keep, plain, titled

import eagor
from eagor.conventions import rotation_from_wxyz
from eagor.drawing import paint_belief
from eagor.lab.agents.methods import BASE
from eagor.lab.envs.episodes import EpisodeSpec
from eagor.lab.envs.places import APARTMENT, load_place
from eagor.lab.envs.rules import Camera
from eagor.lab.tasks.sim.rollout import Runner
from eagor.lab.worlds import View
from eagor.perception import load
from eagor.sphere import unit, wrap

SEED, EPISODE, LOOKS = 604, 2, 7
ROWS, DEGREE = 320, 15
WHOLE: Any = (180, -180, -90, 90)


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


def signed(axes: Any, values: np.ndarray, most: float) -> Any:
    """A field that is for or against the target: nothing is white."""
    return axes.imshow(values, extent=WHOLE, aspect="auto", cmap=SIGNED, vmin=-most, vmax=most, interpolation="nearest")


def framed(axes: Any, left: bool) -> None:
    """Degrees along the sides."""
    axes.set_xlim(180, -180)
    axes.set_xticks(range(180, -181, -90))
    axes.set_yticks([-90, -45, 0, 45, 90])
    axes.set_yticklabels(["−90", "−45", "0", "45", "90"] if left else [])
    axes.set_xticklabels(["180", "90", "0", "−90", "−180"])
    plain(axes)


def main() -> None:
    """Draw it."""
    way, camera, perceive = search(SEED, EPISODE), Camera(), load("scout")
    renderer = load_place(APARTMENT, SEED, camera.radius).renderer
    tracker = eagor.DirectionTracker(BASE)

    def looked(step: int) -> eagor.Evidence:
        small = photograph(renderer, way.positions[step], way.rotations[step], perceive.rows)  # type: ignore[attr-defined]
        return perceive(small, way.query, stamp=step * camera.seconds)

    for step in range(LOOKS):
        tracker.add_pose(step * camera.seconds, way.rotations[step], way.positions[step])
        tracker.observe(looked(step))
    last = LOOKS - 1
    stamp, position, turned = last * camera.seconds, way.positions[last], way.rotations[last]
    look, seen = looked(last), photograph(renderer, position, turned, ROWS)
    response, grid = np.asarray(look.response), look.grid
    sheet = figure(1180, 700)
    place = [(0.04, 0.565), (0.51, 0.565), (0.04, 0.075), (0.51, 0.075)]
    a, b, c, d = (sheet.add_axes((x, y, 0.435, 0.37)) for x, y in place)
    grey = seen.mean(axis=-1, keepdims=True)
    a.imshow((0.45 * grey + 0.45 * seen).astype(np.uint8), extent=WHOLE, aspect="auto")
    over = np.zeros((*response.shape, 4))
    over[..., :3], over[..., 3] = (0.0, 0.9, 1.0), np.clip(1.4 * response, 0, 0.95)
    a.imshow(over, extent=WHOLE, aspect="auto", interpolation="nearest")
    titled(a, f"1  One look for the {way.query}: the response (bright)")
    whole, most = np.asarray(look.log_ratio), float(np.abs(look.log_ratio).max())
    shown = signed(b, whole, most)
    titled(b, "2  Read as evidence, in nats: red for it, blue against it")
    bar = sheet.colorbar(shown, cax=sheet.add_axes((0.955, 0.565, 0.012, 0.37)))
    bar.ax.tick_params(labelsize=8.5)
    # The same look through a camera that sees 100 degrees about there, and nothing else.
    truth = unit(turned.T @ (way.target - position))
    azimuth, elevation = (np.asarray(angle) for angle in eagor.azimuth_elevation(grid.directions))
    across = wrap(azimuth - eagor.azimuth_elevation(truth)[0] - 0.2)
    part = (np.abs(across) < 0.87) & (np.abs(elevation) < 0.7)
    some = eagor.Evidence.from_response(response, grid, look.calibration, coverage=part)
    fine = eagor.PatchGrid(90, 180)
    field = np.asarray(eagor.RealHarmonics(DEGREE).synthesise(some.coefficients(DEGREE), fine))
    signed(c, field, float(np.abs(field).max()))
    titled(c, "3  Had only this part been looked at (degree 15)")
    paint_belief(d, seen, tracker.estimate(stamp), truth=truth)
    titled(d, f"4  {LOOKS} looks: belief, candidates, estimate, truth (green)")
    for axes, left in ((a, True), (b, False), (c, True), (d, False)):
        framed(axes, left)
    for axes in (c, d):
        axes.set_xlabel("azimuth in degrees, positive to the left", color=INK, fontsize=9.5)
    keep(sheet, "method-belief.webp")


if __name__ == "__main__":
    main()
