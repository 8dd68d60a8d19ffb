"""Short `repr` texts: only fields that differ from the default, arrays by their shape."""

from __future__ import annotations

import math
from dataclasses import MISSING, fields
from typing import Any

import numpy as np

_LONGEST = 6  # longer rows of numbers are cut


def changed(self: Any) -> str:
    """`__repr__` of a dataclass: only the fields that differ from their defaults."""
    told = []
    for field in fields(self):
        value = getattr(self, field.name)
        default = field.default if field.default_factory is MISSING else field.default_factory()
        if field.repr and (default is MISSING or not _same(value, default)):
            told.append(f"{field.name}={_value(value)}")
    return f"{type(self).__name__}({', '.join(told)})"


def where(azimuth: float, elevation: float) -> str:
    """A direction (radians): 29° left, +6° up."""
    side = "left" if azimuth >= 0 else "right"
    return f"{abs(math.degrees(azimuth)):.0f}° {side}, {math.degrees(elevation):+.0f}° up"


def _same(value: Any, default: Any) -> bool:
    if value is default:
        return True
    if isinstance(value, np.ndarray) or isinstance(default, np.ndarray):
        return np.array_equal(value, default)
    return bool(value == default)


def _value(value: Any) -> str:
    if isinstance(value, np.ndarray):
        if value.size <= _LONGEST:
            return str([float(f"{number:.3g}") for number in value.reshape(-1).tolist()])
        return f"<{' x '.join(map(str, value.shape))} numbers>"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple | list) and len(value) > _LONGEST and all(isinstance(one, int | float) for one in value):
        return f"({_value(value[0])}, {_value(value[1])}, ..., {_value(value[-1])})"
    return repr(value)
