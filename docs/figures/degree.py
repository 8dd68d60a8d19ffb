"""Draw what cutting the harmonics at a degree does: how wide a point becomes, how high it rings, what stays apart.

python docs/figures/degree.py [FOLDER]

The band-limited point at angle t from its centre is ``K(t) = sum over l <= L of (2 l + 1) / (4 pi) P_l(cos t)``.
"""

from __future__ import annotations

import math

import numpy as np
from common import OURS, TARGET, THEIRS, THIRD, figure, keep, lines, titled
from scipy.special import eval_legendre

from eagor import PatchGrid, RealHarmonics, angular_distance, direction

DEGREES = {5: THIRD, 7: THEIRS, 15: OURS, 31: TARGET}
GRID = PatchGrid(180, 360)
SPREAD = math.radians(3)  # of a thing as a detector shows it
_ANGLES = np.linspace(0.0, math.pi, 36001)  # 0.005 degrees apart


def kernel(degree: int, angles: np.ndarray) -> np.ndarray:
    """``K(t) / K(0)`` at `angles` (radians)."""
    orders = np.arange(degree + 1)
    terms = (2 * orders[:, None] + 1) * eval_legendre(orders[:, None], np.cos(np.ravel(angles))[None, :])
    return terms.sum(axis=0).reshape(np.shape(angles)) / (degree + 1) ** 2


def half_width_deg(degree: int) -> float | None:
    """The angle (degrees) at which the kernel has fallen to half of its height; None if it never does (degree 0)."""
    values = kernel(degree, _ANGLES)
    below = np.flatnonzero(values <= 0.5)
    if not len(below):
        return None
    k = int(below[0])
    share = (values[k - 1] - 0.5) / (values[k - 1] - values[k])
    return math.degrees(float(_ANGLES[k - 1] + share * (_ANGLES[k] - _ANGLES[k - 1])))


def highest_sidelobe(degree: int) -> float | None:
    """The largest ``|K(t)| / K(0)`` beyond the kernel's first zero; None if it has none (degree 0)."""
    values = kernel(degree, _ANGLES)
    below = np.flatnonzero(values <= 0.0)
    return float(np.abs(values[below[0] :]).max()) if len(below) else None


def separation(degree: int) -> int:
    """How many degrees two small equal things must lie apart for the field between them to dip."""
    basis, azimuths = RealHarmonics(degree), np.radians(np.arange(-60, 61))
    for apart in range(2, 90):
        field = np.zeros(GRID.shape)
        for side in (-1, 1):
            off = angular_distance(GRID.directions, direction(side * math.radians(apart / 2), 0.0))
            field += np.exp(-0.5 * (off / SPREAD) ** 2)
        along = basis.synthesise(basis.analyse(field, GRID), direction(azimuths, np.zeros(len(azimuths))))
        if along[60] < 0.95 * along.max():
            return apart
    return 90


def table() -> list[str]:
    """What the figure shows, as numbers."""
    rows = ["degree  numbers  half-width  highest ripple  two things apart from"]
    for degree in DEGREES:
        width, ripple = half_width_deg(degree), highest_sidelobe(degree)
        assert width is not None
        assert ripple is not None
        rows.append(f"{degree:6}{(degree + 1) ** 2:9}{width:10.1f} °{100 * ripple:14.0f} %{separation(degree):20} °")
    return rows


def main() -> None:
    """Draw it, and print the table."""
    sheet = figure(1100, 400)
    left, right = sheet.add_axes((0.06, 0.14, 0.43, 0.7)), sheet.add_axes((0.56, 0.14, 0.42, 0.7))
    angles = np.linspace(0, 90, 721)
    for degree, colour in DEGREES.items():
        left.plot(angles, kernel(degree, np.radians(angles)), color=colour, lw=2.6 if degree == 15 else 1.7)
    left.set_xlim(0, 90)
    left.set_xlabel("degrees from the point")
    left.set_ylabel("height, of the peak")
    left.legend([f"degree {d}" for d in DEGREES], frameon=False, fontsize=10)
    titled(left, "One point, cut at a degree", "a higher degree is narrower; the ripples hardly get lower")
    azimuths = np.radians(np.linspace(-60, 60, 481))
    row = direction(azimuths, np.zeros(len(azimuths)))
    field = sum(
        np.exp(-0.5 * (angular_distance(GRID.directions, direction(s * math.radians(10), 0.0)) / SPREAD) ** 2)
        for s in (-1, 1)
    )
    for degree, colour in DEGREES.items():
        basis = RealHarmonics(degree)
        along = basis.synthesise(basis.analyse(field, GRID), row)
        right.plot(-np.degrees(azimuths), along / along.max(), color=colour, lw=2.6 if degree == 15 else 1.7)
    for place in (-10, 10):
        right.axvline(place, color="#1f2430", lw=1, ls=(0, (2, 3)))
    right.set_xlim(-60, 60)
    right.set_xlabel("degrees from the middle between them")
    titled(right, "Two small things, 20 degrees apart", "below degree 15 they are one")
    for axes in (left, right):
        axes.axhline(0, color="#1f2430", lw=0.8)
        lines(axes)
    keep(sheet, "method-degree.png")
    print("\n".join(table()))


if __name__ == "__main__":
    main()
