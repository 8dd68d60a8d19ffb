"""A robot that turns and walks, whose looks share their errors: do the 90 % cones hold the thing?

python benchmarks/moving_robot.py [--runs 60] [--seed 8900] [--moves turning walking both]

Twenty looks a second for a minute, at one thing. A box is off the thing's middle by the same angle in every look, white
noise of 0.3 degrees comes on top, and the stamps of all looks are late. Poses are true, a hundred a second. Three ways
to move: turning to and fro at up to 60 degrees a second on the spot; walking to and fro past the thing, 3 m away, with
positions; and both. `fixed` is one run of each: 0.7 degrees to the left and up, 10 ms late. In the others each run
draws its own error with the widths that the tracker counts on (`DetectorModel.offset`, `TrackerConfig.clock_error`).

An answer is asked for twice a second. Printed are the share of the answers whose cone (`credible_angle`) holds
the thing, with the 95 % interval over runs, the median and the smallest cone, and the mean error. The rival is the same
tracker with `offset=0, clock_error=0`, which takes looks as independent.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import common
import numpy as np

from eagor.evidence import DetectorModel, Evidence
from eagor.sphere import angular_distance, azimuth_elevation, direction, world_R_body
from eagor.tracking import DirectionTracker, TrackerConfig

RATE, POSES, SECONDS, EVERY = 20, 100, 60.0, 10
WHITE, FIXED, LATE = math.radians(0.3), math.radians(0.7), 0.01
FASTEST = math.radians(60)  # a second
PERIOD = 6.0  # seconds, of turning to and fro
WAY, WALK = 2.0, 24.0  # metres to each side, and seconds there and back
THING = np.array([0.5, 3.0, 0.3])  # metres
MOVES = "turning", "walking", "both"


def pose(move: str, t: float) -> tuple[np.ndarray, np.ndarray | None]:
    """``world_R_body`` ``(3, 3)`` at a time, and the position ``(3,)`` where the robot walks."""
    yaw = FASTEST * PERIOD / math.tau * math.sin(math.tau * t / PERIOD) if move != "walking" else 0.0
    place = None if move == "turning" else np.array([WAY * math.sin(math.tau * t / WALK), 0.0, 0.0])
    return world_R_body(yaw), place


def truth(move: str, t: float) -> np.ndarray:
    """The direction ``(3,)`` of the thing in the body frame."""
    turn, place = pose(move, t)
    apart = THING if place is None else THING - place
    return apart / np.linalg.norm(apart) @ turn


def play(
    move: str, off: np.ndarray, late: float, rng: np.random.Generator, plain: bool
) -> Iterator[tuple[float, float]]:
    """Error and cone of each answer, degrees; `off` ``(2,)``: of all boxes, `plain`: looks taken as independent."""
    config = TrackerConfig(clock_error=0.0) if plain else TrackerConfig()
    model = DetectorModel(offset=0.0) if plain else DetectorModel()
    tracker = DirectionTracker(config)
    ahead = 0
    for count in range(round(SECONDS * RATE)):
        taken = count / RATE
        stamp = max(taken + late, 0.0)
        while ahead / POSES <= stamp + 1 / POSES:
            tracker.add_pose(ahead / POSES, *pose(move, ahead / POSES))
            ahead += 1
        azimuth, elevation = (float(angle) for angle in azimuth_elevation(truth(move, taken)))
        noise = off + WHITE * rng.standard_normal(2)
        box = direction(azimuth + noise[0] / math.cos(elevation), elevation + noise[1])
        tracker.observe(Evidence.from_points(box[None], scores=np.array([0.6]), detector=model, stamp=stamp))
        if count % EVERY == EVERY - 1:
            found = tracker.estimate(stamp)
            assert found.direction is not None
            error = float(angular_distance(found.direction, truth(move, stamp)))
            yield math.degrees(error), math.degrees(found.credible_angle)


def line(name: str, runs: list[list[tuple[float, float]]]) -> str:
    """One row of the table; `runs`: error and cone of each answer."""
    held = [float(np.mean([error <= cone for error, cone in run])) for run in runs]
    errors, cones = np.array([pair for run in runs for pair in run]).T
    return f"{name:24s} {common.shown(held):>20s} {np.median(cones):8.2f} {cones.min():9.3g} {errors.mean():8.2f}"


def main() -> None:
    """Play and print."""
    options = common.parser(__doc__, runs=60, seed=8900, moves=MOVES).parse_args()
    fixed = np.array([FIXED, FIXED])
    width, clock = DetectorModel().offset, TrackerConfig().clock_error
    print(f"{'':24s} {'cones hold it':>20s} {'median':>8s} {'smallest':>9s} {'error':>8s}   (degrees)")
    for move in options.moves:
        for plain in (True, False):
            words = f"{move}, fixed{', independent' if plain else ''}"
            rng = np.random.default_rng(options.seed)
            print(line(words, [[*play(move, fixed, LATE, rng, plain)]]), flush=True)
        runs = []
        for seed in range(options.seed, options.seed + options.runs):
            rng = np.random.default_rng(seed)
            off, late = width * rng.standard_normal(2), clock * rng.standard_normal()
            runs.append([*play(move, off, late, rng, plain=False)])
        if runs:
            print(line(move, runs), flush=True)


if __name__ == "__main__":
    main()
