"""What cutting the harmonics at a degree does to a point: how wide it becomes, and how high its ripples are.

The band-limited delta at angle t from its centre is ``K(t) = sum over l <= L of (2 l + 1) / (4 pi) P_l(cos t)``.
"""

from __future__ import annotations

import math

import numpy as np

_ANGLES = np.linspace(0.0, math.pi, 36001)  # 0.005 degrees apart


def kernel(degree: int, angles: np.ndarray) -> np.ndarray:
    """``K(t) / K(0)`` at `angles` (radians)."""
    from scipy.special import eval_legendre

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
