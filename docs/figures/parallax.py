"""Draw what parallax does: a camera walks past a thing, with and without shells of range.

    python docs/figures/parallax.py [FOLDER]

One walk of 30 steps of 0.25 m, one noisy bearing per step (8 degrees; three of ten are missed, every fifth look has a
false alarm besides), the same evidence for both beliefs.
"""

from __future__ import annotations

import math

import numpy as np
from common import INK, OURS, QUIET, TARGET, THEIRS, figure, keep, lines, plain, titled

from eagor import Belief, Evidence, RangedBelief, angular_distance, azimuth_elevation, direction
from eagor.sphere import unit

TARGET_AT = np.array([3.1, 2.2, 0.0])
STEPS, STEP, NOISE = 30, 0.25, math.radians(8)
DEGREE, SEED = 15, 4
SHOWN = (4, 13, 24)  # steps that are drawn from above


def walk() -> tuple[list[Belief], list[RangedBelief], np.ndarray]:
    """Both beliefs after each step, and the camera's places ``(n, 3)``; it looks along x and never turns."""
    rng = np.random.default_rng(SEED)
    turning, ranged = Belief.uniform(DEGREE), RangedBelief.uniform(DEGREE)
    plain_, shells, places = [], [], STEP * np.arange(STEPS)[:, None] * np.array([1.0, 0.0, 0.0])
    for step, place in enumerate(places):
        bearing = unit(TARGET_AT - place)
        seen = [unit(bearing + rng.normal(0, NOISE, 3))] if rng.random() >= 0.3 else []
        seen += [unit(rng.normal(size=3))] if rng.random() < 0.2 else []
        look = Evidence.from_points(np.reshape(seen, (-1, 3)), 1 / NOISE**2)
        moved = np.array([STEP if step else 0.0, 0.0, 0.0])
        turning = turning.predict(np.eye(3)).update(look)  # the published prediction: it only turns
        ranged = ranged.predict(np.eye(3), moved).update(look)
        plain_.append(turning)
        shells.append(ranged)
    return plain_, shells, places


def errors(beliefs: list[Belief] | list[RangedBelief], places: np.ndarray) -> np.ndarray:
    """Degrees by which each mode is off ``(n,)``."""
    modes = np.array([np.asarray(belief.mode()) for belief in beliefs])
    return np.degrees(angular_distance(modes, unit(TARGET_AT - places)))


def from_above(belief: RangedBelief, azimuths: np.ndarray) -> np.ndarray:
    """How likely each range and azimuth of the horizon is ``(K, n)``, of the most likely one."""
    field = np.asarray(belief.basis.synthesise(belief.shells, direction(azimuths, np.zeros(len(azimuths)))))
    return np.exp(field - field.max())


def table() -> list[str]:
    """What the figure shows, as numbers."""
    turning, ranged, places = walk()
    rows = [f"{'degrees off':24}{'before passing':>16}{'last ten steps':>16}"]
    for name, beliefs in (("turned only", turning), ("shells of range", ranged)):
        off = errors(beliefs, places)
        rows.append(f"{name:24}{off[:12].mean():16.0f}{off[-10:].mean():16.0f}")
    far = np.linalg.norm(TARGET_AT - places[-1])
    rows.append(f"distance at the end: {ranged[-1].distance():.1f} m, true {far:.1f} m")
    return rows


def main() -> None:
    """Draw it, and print the table."""
    turning, ranged, places = walk()
    sheet = figure(1100, 580)
    edges = np.linspace(-math.pi, math.pi, 241)
    ranges = ranged[0].ranges
    rings = np.concatenate([[0.35], np.sqrt(ranges[1:] * ranges[:-1]), [ranges[-1] * 1.1]])
    for column, step in enumerate(SHOWN):
        axes = sheet.add_axes((0.06 + 0.317 * column, 0.535, 0.295, 0.42))
        place, belief = places[step], ranged[step]
        heat = from_above(belief, (edges[1:] + edges[:-1]) / 2)
        x = place[0] + rings[:, None] * np.cos(edges)
        y = rings[:, None] * np.sin(edges)
        axes.pcolormesh(x, y, np.sqrt(heat), cmap="YlOrBr", vmin=0, vmax=1.15, rasterized=True, zorder=0)
        axes.plot(places[: step + 1, 0], places[: step + 1, 1], color=INK, lw=1.6, zorder=3)
        for belief_, colour, style in ((turning[step], THEIRS, (0, (4, 2))), (belief, OURS, "-")):
            azimuth = float(azimuth_elevation(np.asarray(belief_.mode()))[0])
            far = belief.distance() if belief_ is belief else 9.0
            end = place[:2] + far * np.array([math.cos(azimuth), math.sin(azimuth)])
            axes.plot([place[0], end[0]], [0, end[1]], color=colour, ls=style, lw=2, zorder=4)
            if belief_ is belief:
                axes.plot(*end, "o", color=OURS, mec="white", markersize=8, zorder=6)
        axes.plot(place[0], 0, "o", color=INK, markersize=7, zorder=5)
        axes.plot(*TARGET_AT[:2], "o", mfc="none", mec=TARGET, mew=2.4, markersize=15, zorder=5)
        axes.set_xlim(-1.2, 8.2)
        axes.set_ylim(-1.5, 4.7)
        axes.set_aspect("equal")
        plain(axes)
        titled(axes, f"after {step + 1} looks")
        axes.set_xlabel("metres", color=INK, fontsize=9.5)
        if column:
            axes.set_yticklabels([])
    axes = sheet.add_axes((0.06, 0.095, 0.58, 0.32))
    steps = np.arange(1, STEPS + 1)
    axes.plot(steps, errors(turning, places), color=THEIRS, lw=2, ls=(0, (4, 2)))
    axes.plot(steps, errors(ranged, places), color=OURS, lw=2.6)
    axes.axvline(1 + TARGET_AT[0] / STEP, color=QUIET, lw=1)
    axes.text(1.2 + TARGET_AT[0] / STEP, 100, "beside it", fontsize=9, color=QUIET)
    axes.set_xlim(1, STEPS)
    axes.set_ylim(0, None)
    axes.set_xlabel("looks, one every 0.25 m", color=INK)
    axes.set_ylabel("degrees off", color=INK)
    lines(axes)
    for row, (mark, colour, what) in enumerate((
        ("○", TARGET, "the thing"),
        ("●", INK, "the camera, walking to the right"),
        ("┅", THEIRS, "belief that only turns"),
        ("━", OURS, "belief with shells, and its distance"),
        ("■", "#d9781e", "how likely each place is"),
    )):  # fmt: skip
        y = 0.39 - 0.062 * row
        sheet.text(0.675, y, mark, color=colour, fontsize=14, weight="bold", va="center")
        sheet.text(0.705, y, what, color=INK, fontsize=10, va="center")
    keep(sheet, "method-parallax.png")
    print("\n".join(table()))


if __name__ == "__main__":
    main()
