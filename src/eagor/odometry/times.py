"""Times as other programs write them: their units, and names of pictures that are times."""

from __future__ import annotations

import re
from collections.abc import Sequence

from eagor._checks import LATEST

__all__ = ["UNITS", "times_of", "unit_of"]

UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e3, "msec": 1e3, "us": 1e6, "usec": 1e6, "ns": 1e9, "nsec": 1e9}  # in a second
EPOCH = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))  # from this size on a clock that counts since 1970 counts these
# Names without their endings, after what is no number; of two numbers the second is a part of a second.
_NAMES = tuple(
    re.compile(rf"(?:.*[^\d.])?{form}")
    for form in (r"(\d+\.\d+)", r"(\d{9,10})[_-](\d{6}|\d{9})", r"(\d{10}|\d{13}|\d{16}|\d{19})")
)


def unit_of(stamp: float) -> float:
    """How many of what `stamp` counts make a second, if it counts from 1970 on; else 1."""
    return next((UNITS[unit] for least, unit in EPOCH if abs(stamp) >= least), 1.0)


def times_of(names: Sequence[str]) -> list[float] | None:
    """Seconds, if names (without endings) are times, all in one form: 12.350, left_1700000000500000000; else None."""
    for form in _NAMES:
        found = [form.fullmatch(name) for name in names]
        if found and all(found):
            parts = [each.groups() for each in found if each is not None]
            whole = [float(first) / (1.0 if "." in first else unit_of(float(first))) for first, *_ in parts]
            if max(whole) > LATEST:
                return None
            return [at + sum(float(f"0.{part}") for part in more) for at, (_, *more) in zip(whole, parts, strict=True)]
    return None
