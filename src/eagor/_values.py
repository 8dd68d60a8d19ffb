"""Immutable values: properties that are computed at first use, altered copies, and short `repr` texts.

Why not `functools.cached_property`: in Python 3.11 it holds one lock per class while it computes. Threads with
unrelated objects then wait for each other, and two such properties that use one another can deadlock. Here, at worst,
two threads compute the same value.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

_LONGEST = 6  # in a repr; longer rows of numbers are cut

Value = TypeVar("Value")
Owner = TypeVar("Owner")

if TYPE_CHECKING:
    from functools import cached_property as lazy  # noqa: TID251
else:

    class lazy:
        """A property that replaces itself by its value. Pickles and copies leave such values out."""

        def __init__(self, compute: Callable[[Any], Any]) -> None:
            self.compute, self.__doc__ = compute, compute.__doc__

        def __set_name__(self, owner: type, name: str) -> None:
            self.name = name
            if owner.__getstate__ is object.__getstate__:
                owner.__getstate__ = state_of

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            if instance is None:
                return self
            value = instance.__dict__[self.name] = self.compute(instance)
            return value


class given(lazy):
    """A lazy value that may also be known when the object is made (see `known`). Pickles and copies keep it."""


def known(made: Owner, **values: Any) -> Owner:
    """`made`, a new object, with these lazy `values`, which its maker knows already."""
    made.__dict__.update(values)
    return made


def inherited(made: Owner, source: Any, *names: str) -> Owner:
    """`made`, a new object, with those of these lazy values that `source` has computed: they are the same for both."""
    return known(made, **{name: source.__dict__[name] for name in names if name in source.__dict__})


def altered(source: Owner, **values: Any) -> Owner:
    """As `dataclasses.replace`, at a tenth of its cost, for a dataclass that checks nothing when it is made."""
    made, old = object.__new__(type(source)), source.__dict__
    made.__dict__.update({name: old[name] for name in type(source).__dataclass_fields__}, **values)  # type: ignore[attr-defined]
    return made


def bare(value: Value) -> Value:
    """A copy without lazy values, of an immutable object and of those that it consists of; arrays are shared."""
    kind = type(value)
    if kind is tuple:
        return tuple(map(bare, value))  # type: ignore[return-value, arg-type]
    if not is_dataclass(kind) or kind.__eq__ is not object.__eq__:  # what is equal by value is shared
        return value
    made = object.__new__(kind)
    made.__dict__.update({name: bare(each) for name, each in state_of(value).items()})
    return made


def state_of(owner: Any) -> dict[str, Any]:
    """The attributes of `owner` without its lazy values."""
    kind, found = type(owner), owner.__dict__.copy()
    return {name: value for name, value in found.items() if type(getattr(kind, name, None)) is not lazy}


def changed(self: Any) -> str:
    """`__repr__` of a dataclass: only the fields that differ from their defaults."""
    told = []
    for field in fields(self):
        value = getattr(self, field.name)
        default = field.default if field.default_factory is MISSING else field.default_factory()
        same = np.array_equal if isinstance(value, np.ndarray) or isinstance(default, np.ndarray) else operator.eq
        if field.repr and (default is MISSING or not (value is default or same(value, default))):
            told.append(f"{field.name}={_value(value)}")
    return f"{type(self).__name__}({', '.join(told)})"


def where(azimuth: float, elevation: float) -> str:
    """A direction (radians): 29° left, 6° up."""
    side, height = "left" if azimuth >= 0 else "right", "up" if elevation >= 0 else "down"
    return f"{abs(math.degrees(azimuth)):.0f}° {side}, {abs(math.degrees(elevation)):.0f}° {height}"


def wide(angle: float) -> str:
    """An angle (radians) that something lies within: 12°, and 0.4° where whole degrees would say nothing."""
    degrees = math.degrees(angle)
    return f"{degrees:.0f}°" if degrees >= 1 else f"{max(degrees, 0.1):.1f}°"


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
