"""The mean of likelihood ratios over the angle by which a response may lie beside what it means.

The direction of a response is itself uncertain: a network's peak lies beside the thing, and a cell is a region. If the
offset has a density k, the likelihood ratio of a target in direction omega is the mean of the ratios around it,

    r'(omega) = log integral k(angle(omega, omega')) exp(r(omega')) d omega',

which is no mean of logarithms. The difference matters most where it is not expected: to a field that is cut at a low
degree. A truncation averages LOGARITHMS over its resolution, so that a small thing, however surely it was seen, comes
out below a weak response that is wide. Averaged as a ratio first, it keeps nearly all of its height: a tenth of the
area costs 2.3 nats.

k is the heat kernel of the sphere (its spectrum is exp(-l (l + 1) sigma^2 / 2)), near a Gaussian at these widths.
"""

from __future__ import annotations

import math

from eagor._arrays import Array, namespace
from eagor.grids import ErpGrid, Grid, PatchGrid
from eagor.harmonics import RealHarmonics

_MARGIN = 3.0  # nats by which what is cut off the kernel's spectrum stays below the lowest ratio


def averaged(log_ratio: Array, grid: Grid, spread: float, least: float, most: float) -> tuple[Array, ErpGrid]:
    """r' of log ratios ``(..., H, W)`` on `grid`, with the grid of the whole sphere ``(..., H', W')`` that it lies on.

    `spread`: of the kernel, radians per axis. `least` and `most`: the lowest and highest log ratio there can be. What
    `grid` does not see counts as 0, where nothing is known.
    """
    # Beyond this degree a kernel as high as the highest ratio has faded into the lowest.
    basis = RealHarmonics(math.ceil(math.sqrt(2 * (most - least + _MARGIN)) / spread))
    whole, xp = basis.quadrature(1), namespace(log_ratio)
    if isinstance(grid, ErpGrid):  # samples of a coarse picture say nothing at so high a degree: take them as cells
        grid = PatchGrid(*grid.shape)
    gain = basis.synthesise(basis.smooth(basis.analyse(xp.expm1(log_ratio), grid), spread), whole)
    # 1 + gain, kept from what truncation may leave below the lowest ratio.
    return xp.log1p(xp.clip(gain, math.expm1(least), math.expm1(most))), whole
