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
from pathlib import Path
from typing import Any

import numpy as np

from eagor.statistics import bootstrap_interval

PANORAMAS = Path(__file__).parents[1] / ".." / "shared" / "panoramas"


def parser(doc: str | None, **options: Any) -> argparse.ArgumentParser:
    """A parser that shows the study's docstring as it is written; an option for each keyword, with its default.

    False makes a switch; a type is that of an option without a default; a list takes several values; a tuple is what
    may be chosen, several or (by default) all.
    """
    made = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in options.items():
        flag, kind = f"--{name.replace('_', '-')}", type(default)
        if default is False:
            made.add_argument(flag, action="store_true")
        elif kind is type:
            made.add_argument(flag, type=default)
        elif kind in (list, tuple):
            choices = default if kind is tuple else None
            made.add_argument(flag, nargs="+", default=[*default], type=type(default[0]), choices=choices)
        else:
            made.add_argument(flag, default=default, type=kind)
    return made


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


def shown(values: Any, digits: int = 2, groups: Any = None) -> str:
    """The mean with its interval, of the values that are finite: "1.23 [0.91, 1.55]"; "-" where there is none."""
    values = np.asarray(values, dtype=np.float64)
    finite = np.isfinite(values)
    mean, low, high = mean_of(values[finite], None if groups is None else np.asarray(groups)[finite])
    if math.isnan(low):
        return "-" if math.isnan(mean) else f"{mean:.{digits}f}"
    return f"{mean:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
