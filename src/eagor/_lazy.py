"""What is computed when it is first asked for, and kept.

`functools.cached_property` of Python 3.11 holds one lock per class while it computes, so that threads with objects that
share nothing wait for each other, and two such properties that ask for one another from two threads wait for ever. This
one holds no lock: at worst two threads compute the same value.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

Value = TypeVar("Value")


class lazy(Generic[Value]):
    """A property that replaces itself by its value. Objects are pickled and copied without such values."""

    def __init__(self, compute: Callable[[Any], Value]) -> None:
        self.compute = compute
        self.name = compute.__name__
        self.__doc__ = compute.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name
        if owner.__getstate__ is object.__getstate__:
            owner.__getstate__ = state_of  # type: ignore[method-assign]

    @overload
    def __get__(self, instance: None, owner: type) -> lazy[Value]: ...
    @overload
    def __get__(self, instance: object, owner: type | None = None) -> Value: ...
    def __get__(self, instance: object | None, owner: type | None = None) -> Any:
        if instance is None:
            return self
        value = self.compute(instance)
        instance.__dict__[self.name] = value
        return value


class given(lazy[Value]):
    """A lazy value that others may set, when they know better than what is computed: it is pickled and copied."""


def state_of(owner: Any) -> dict[str, Any]:
    """The attributes of `owner` but for lazy values, which may hold functions, and which another thread may add to."""
    kind, found = type(owner), owner.__dict__.copy()
    return {name: value for name, value in found.items() if type(getattr(kind, name, None)) is not lazy}
