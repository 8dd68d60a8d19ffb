"""The sRGB curve (IEC 61966-2-1), between linear light and the numbers in an image file."""

from __future__ import annotations

import numpy as np


def to_linear(coded: np.ndarray) -> np.ndarray:
    """Linear values of sRGB-coded ones, both in [0, 1]."""
    coded = np.clip(coded, 0, 1)
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def to_coded(linear: np.ndarray) -> np.ndarray:
    """sRGB-coded values of linear ones, both in [0, 1]."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
