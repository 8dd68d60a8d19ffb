"""From a response to a log-likelihood ratio, and how far looks repeat each other.

    r = temperature * log((l + floor) / (neutral + floor))

for a response l in [0, 1]: positive above `neutral`, and bounded from below.

`log_ratios` applies it to whole maps, after their checks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor._arrays import Array, namespace, table_like, to_numpy
from eagor._checks import above, require, within
from eagor._values import changed
from eagor.errors import ResponseError
from eagor.evidence.detector import RESPONSES, Habits
from eagor.grids import Grid

__all__ = ["Calibration"]

SPREADS = math.radians(1), math.radians(30)


@dataclass(frozen=True)
class Calibration:
    """How a response becomes a log-likelihood ratio: ``temperature * log((l + floor) / (neutral + floor))``.

    - `floor` (epsilon): the probability of missing a visible target; it bounds what one empty look can take away.
    - `neutral` (l0): the response that says nothing.
    - `temperature` (beta): a factor on the logarithm; a smaller one tempers overconfident evidence.
    - `persistence`: how much of one look the next one repeats, in [0, 1): what a response mistakes once it mistakes
      again. The share 1 - persistence of each look adds up; the rest counts only while the look is the newest. (The
      errors of looks follow an autoregression of first order.)
    - `spread`: angular error of responses, radians (standard deviation per axis): the evidence about a direction is the
      mean likelihood ratio around it. 0: no error.
    - `scale_to_max`: divide each response by its own maximum first. Only the published settings do so: it turns
      "nothing here" into a detection.

    The ratios of three responses:

        >>> calibration = eagor.Calibration(floor=0.1, neutral=0.1, temperature=1.0)
        >>> [round(float(calibration.log_ratio(np.array(response))), 2) for response in (0.0, 0.1, 1.0)]
        [-0.69, 0.0, 1.7]
    """

    floor: float = 0.4
    neutral: float = 0.05
    temperature: float = 3.0
    persistence: float = 0.0
    spread: float = 0.0
    scale_to_max: bool = False

    def __post_init__(self) -> None:
        least, most = SPREADS
        wanted = {
            "floor": (above(self.floor, 0, 1), "a number above 0 and up to 1"),
            "neutral": (within(self.neutral, 0, 1), "a number from 0 to 1"),
            "temperature": (above(self.temperature, 0), "a number above 0"),
            "persistence": (within(self.persistence, 0, 1) and self.persistence < 1, "a number from 0, below 1"),
            "spread": (
                self.spread == 0 or within(self.spread, least, most),
                f"0, or radians from {least:.4f} to {most:.4f} (1 to 30 degrees)",
            ),
        }
        require(self, wanted, ResponseError)

    def __repr__(self) -> str:
        return changed(self)

    @classmethod
    def paper(cls) -> Calibration:
        """The published form, log(l + 1e-3), with each frame's response scaled to a maximum of 1."""
        return cls(floor=1e-3, neutral=1 - 1e-3, temperature=1.0, scale_to_max=True)

    @property
    def offset(self) -> float:
        """The part of the angular error (radians) that the next look repeats: `persistence` of its variance."""
        return self.spread * math.sqrt(self.persistence)

    @property
    def habits(self) -> Habits:
        """A response says of each place what it says: it has no look-alikes and no habits of its own."""
        return RESPONSES

    def log_ratio(self, response: Array) -> Array:
        """r of a response, elementwise; for checking and plotting (`Evidence.from_response` checks its input too)."""
        xp = namespace(response)
        return self.temperature * xp.log((response + self.floor) / (self.neutral + self.floor))

    @property
    def empty(self) -> float:
        """r where we looked and saw nothing: the lowest value there is."""
        return float(self.log_ratio(np.array(0.0)))

    @property
    def full(self) -> float:
        """r of a response of 1: the highest value there is."""
        return float(self.log_ratio(np.array(1.0)))


SILENT = 1e-6  # a smaller response is rounded zero, and must not be scaled up to a detection
_LEAST_PEAK = 1e-30  # dividing by a smaller maximum overflows float32
_BLOCK = 1 << 16  # values at a time, so that they stay in the cache


def checked_response(response: Array, grid: Grid) -> Array:
    """`response` as a floating array, once its shape fits `grid`."""
    if not hasattr(response, "shape"):
        response = np.asarray(response)
    if tuple(response.shape[-2:]) != tuple(grid.shape) or 0 in tuple(response.shape):
        raise ResponseError(
            f"response has shape {tuple(response.shape)}; the grid wants (..., {grid.shape[0]}, {grid.shape[1]}) "
            "and at least one value. Pass the grid that the response was computed on"
        )
    if isinstance(response, np.ndarray):
        return response.astype(_working(response), copy=False)
    xp = namespace(response)
    if xp.isdtype(response.dtype, "complex floating"):
        raise ResponseError(_NO_NUMBERS.format(response.dtype))
    return response if xp.isdtype(response.dtype, "real floating") else xp.astype(response, xp.float32)


def _working(response: np.ndarray) -> np.dtype:
    """The type to compute in: float32 or float64, in this machine's order of bytes (`log_ratios` reads the bits)."""
    if response.dtype.kind not in "fiub" or isinstance(response, np.ma.MaskedArray):
        kind = "a masked array" if isinstance(response, np.ma.MaskedArray) else response.dtype
        raise ResponseError(_NO_NUMBERS.format(kind))
    return np.dtype(np.float64 if response.dtype.kind == "f" and response.dtype.itemsize > 4 else np.float32)


_NO_NUMBERS = (
    "response is {}; wanted an array of real numbers in [0, 1] (any float type). What is masked goes into coverage, a "
    "complex response wants its magnitude"
)


def where_covered(response: Array, mask: np.ndarray) -> Array:
    """`response` ``(..., H, W)`` with zeros where `mask` ``(H, W)`` says that nothing was covered."""
    xp = namespace(response)
    return xp.where(table_like(mask, response), response, xp.zeros_like(response))


def log_ratios(response: Array, calibration: Calibration, peak: float) -> Array:
    """The checked log ratio of ``response / peak``.

    NumPy arrays are processed in blocks, and the division is folded into the gain: a second full map would cost more
    than all the rest.
    """
    offset = calibration.floor / (calibration.neutral + calibration.floor)
    gain = 1 / (calibration.neutral + calibration.floor) / peak
    if not isinstance(response, np.ndarray):
        xp = namespace(response)
        if not (float(xp.min(response)) >= 0 and float(xp.max(response)) <= 1):
            raise ResponseError(_what_is_wrong(to_numpy(response)))
        return calibration.temperature * xp.log(response * gain + offset)
    flat = np.ascontiguousarray(response).reshape(-1)
    # Read as unsigned integers, floats in [0, 1] are the smallest: negative numbers have the sign bit set, NaN and
    # infinity the largest exponents. So one maximum checks range and finiteness.
    bits = flat.view(np.uint32 if flat.dtype.char == "f" else np.uint64)
    one = 0x3F800000 if flat.dtype.char == "f" else 0x3FF0000000000000
    out = np.empty_like(flat)
    for start in range(0, flat.size, _BLOCK):
        part = slice(start, start + _BLOCK)
        # The slow, exact check after the fast one, which also rejects -0.0.
        if bits[part].max() > one and not (response.min() >= 0 and response.max() <= 1):
            raise ResponseError(_what_is_wrong(response))
        block = out[part]
        np.multiply(flat[part], gain, out=block)
        np.add(block, offset, out=block)
        np.log(block, out=block)
        if calibration.temperature != 1.0:
            np.multiply(block, calibration.temperature, out=block)
    return out.reshape(response.shape)


def _what_is_wrong(response: np.ndarray) -> str:
    if not np.isfinite(response).all():
        count = int((~np.isfinite(response)).sum())
        return (
            f"response has {count} values that are NaN or infinite; wanted numbers in [0, 1]. Give coverage (H, W) "
            "that is 0 where they stand: what was not covered is not looked at"
        )
    return (
        f"response runs from {response.min():g} to {response.max():g}; wanted [0, 1]. Logits want a sigmoid, "
        "attention wants a fixed scale (not the frame's own maximum)"
    )


def peak_of(response: Array) -> float:
    """What a single response is divided by, in the published scaling: its maximum, or 1 where that is 0."""
    if len(response.shape) != 2:
        raise ResponseError("scale_to_max reads one response (H, W) at a time; loop over the batch")
    peak = float(namespace(response).max(response))
    return peak if peak >= _LEAST_PEAK else 1.0


def checked_coverage(coverage: np.ndarray, grid: Grid) -> np.ndarray:
    """A copy of `coverage` ``(H, W)``, once its values are in [0, 1]."""
    coverage = np.array(to_numpy(coverage), dtype=np.float64)
    if coverage.shape != tuple(grid.shape) or not (coverage.min() >= 0 and coverage.max() <= 1):
        raise ResponseError(f"coverage must have the grid's shape {tuple(grid.shape)} and values in [0, 1]")
    return coverage
