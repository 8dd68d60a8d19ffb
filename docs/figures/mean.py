"""Draw why the mean of a log field is no answer: three fields along the horizon, their mean and their highest point.

    python docs/figures/mean.py [FOLDER]

Each response is read as published, log(l + 0.001), on the whole sphere, at degree 15; the mean does not depend on the
degree. The target is 60 degrees to the left.
"""

from __future__ import annotations

import math

import numpy as np
from common import INK, OURS, QUIET, TARGET, THEIRS, figure, keep, plain, titled

from eagor import Belief, Calibration, Evidence, PatchGrid, angular_distance, azimuth_elevation, direction

GRID = PatchGrid(90, 180)
TRUTH = direction(math.radians(60), 0.0)
DEGREE = 15


def blob(azimuth_deg: float, elevation_deg: float, spread_deg: float, height: float) -> np.ndarray:
    """A response ``(H, W)`` that is high about one direction."""
    centre = direction(math.radians(azimuth_deg), math.radians(elevation_deg))
    return height * np.exp(-0.5 * (np.degrees(angular_distance(GRID.directions, centre)) / spread_deg) ** 2)


def responses() -> dict[str, np.ndarray]:
    """The three responses ``(H, W)`` in [0, 1]."""
    target = blob(60, 0, 8, 1.0)
    return {
        "one clean blob": target,
        "a second, weaker one behind": np.maximum(target, blob(-150, 0, 8, 0.6)),
        "half the room at 5 %": np.maximum(target, 0.05 * (GRID.directions @ direction(math.radians(-100), -0.3) > 0)),
    }


def read(response: np.ndarray) -> Belief:
    """The published evidence of one look as a belief."""
    return Belief.uniform(DEGREE).update(Evidence.from_response(response, GRID, Calibration.paper()))


def errors(belief: Belief) -> tuple[float, float]:
    """Degrees by which the mean and the mode are off."""
    found = (np.asarray(belief.mean_direction()), np.asarray(belief.mode()))
    mean, mode = (math.degrees(float(angular_distance(where, TRUTH))) for where in found)
    return mean, mode


def table() -> list[str]:
    """What the figure shows, as numbers."""
    rows = [f"{'':28}mean is off by  mode is off by  published confidence"]
    for name, response in responses().items():
        belief = read(response)
        mean, mode = errors(belief)
        rows.append(f"{name:28}{mean:12.0f} °{mode:14.1f} °{float(belief.resultant()):18.2f}")
    return rows


def main() -> None:
    """Draw it, and print the table."""
    sheet = figure(1100, 560)
    for column, (name, response) in enumerate(responses().items()):
        belief = read(response)
        x = 0.045 + 0.322 * column
        above, below = sheet.add_axes((x, 0.56, 0.295, 0.3)), sheet.add_axes((x, 0.11, 0.295, 0.36))
        above.imshow(np.sqrt(response), extent=(180, -180, -90, 90), aspect="auto", cmap="Greys", vmin=0, vmax=1.1)
        mean, mode = errors(belief)
        for where, colour, mark, size in (
            (TRUTH, TARGET, "o", 15),
            (np.asarray(belief.mean_direction()), THEIRS, "X", 11),
            (np.asarray(belief.mode()), OURS, "o", 7),
        ):
            azimuth, elevation = (math.degrees(float(a)) for a in azimuth_elevation(where))
            hollow = size == 15
            style = {
                "mfc": "none" if hollow else colour,
                "mec": colour if hollow else "white",
                "mew": 2 if hollow else 1,
            }
            above.plot(azimuth, elevation, mark, markersize=size, **style)
        azimuths = np.radians(np.linspace(180, -180, 721))
        along = np.asarray(belief.log_ratio(direction(azimuths, np.zeros(len(azimuths)))))
        below.fill_between(np.degrees(azimuths), along, along.min(), color=QUIET, alpha=0.18, linewidth=0)
        below.plot(np.degrees(azimuths), along, color=INK, lw=1.4)
        turn = math.degrees(float(azimuth_elevation(np.asarray(belief.mean_direction()))[0]))
        below.axvline(60, color=TARGET, lw=3, alpha=0.6)
        below.axvline(turn, color=THEIRS, lw=2, ls=(0, (4, 2)))
        below.axvline(math.degrees(float(azimuth_elevation(np.asarray(belief.mode()))[0])), color=OURS, lw=1.6)
        titled(above, name)
        above.text(0.01, 0.05, f"mean off by {mean:.0f}°, mode by {mode:.1f}°", transform=above.transAxes, fontsize=9.5,
                   color=INK)  # fmt: skip
        for axes in (above, below):
            axes.set_xlim(180, -180)
            axes.set_xticks([90, 0, -90])
            plain(axes)
        above.set_yticks([-90, 0, 90])
        below.set_xlabel("azimuth, positive to the left", color=INK, fontsize=9.5)
        if column:
            above.set_yticklabels([])
    sheet.text(0.045, 0.95, "the response (dark: high) and what it is read as along the horizon, in nats", fontsize=11,
               color=QUIET)  # fmt: skip
    for x, colour, mark, what in (
        (0.30, TARGET, "○", "truth"), (0.40, THEIRS, "✖", "published mean"), (0.56, OURS, "●", "mode"),
    ):  # fmt: skip
        sheet.text(x + 0.28, 0.95, mark, color=colour, fontsize=12, weight="bold")
        sheet.text(x + 0.30, 0.95, what, color=INK, fontsize=10.5)
    keep(sheet, "method-mean.png")
    print("\n".join(table()))


if __name__ == "__main__":
    main()
