"""What the studies share: one thread, the parser of their options, means with intervals.

Import it before NumPy: libraries read how many threads they may use when they are imported.
"""

from __future__ import annotations

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import argparse
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from eagor.statistics import bootstrap_interval


def parser(doc: str | None) -> argparse.ArgumentParser:
    """A parser of options that shows the study's docstring as it is written."""
    return argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


def mean_of(
    values: Sequence[float] | np.ndarray, groups: Sequence[Any] | np.ndarray | None = None
) -> tuple[float, float, float]:
    """The mean of the values and its 95 % bootstrap interval; values of one of the `groups` are drawn together.

    NaN where there is no value. The interval is NaN where there is only one value, or group: it says nothing about the
    spread.
    """
    if not len(values):
        return math.nan, math.nan, math.nan
    if len({*(range(len(values)) if groups is None else groups)}) < 2:
        return float(np.mean(values)), math.nan, math.nan
    found = bootstrap_interval(values, np.random.default_rng(0), groups=groups)
    return float(np.mean(values)), found.low, found.high
