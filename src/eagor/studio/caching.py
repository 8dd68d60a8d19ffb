"""What is kept because it takes long to make: as many bytes as are stated, and less once nobody uses it any more."""

from __future__ import annotations

import ctypes
import gc
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable
from contextlib import suppress
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import Any, Generic, TypeVar

import numpy as np

__all__ = ["Kept", "given_back", "weighed"]

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")
_CODE = (type, ModuleType, FunctionType, BuiltinFunctionType)


class Kept(Generic[K, V]):
    """The newest values of `make`, weighed when they are made: together at most `most` bytes, and always one.

    Several threads may ask. They do not wait for each other, so two that ask for the same may both make it.
    """

    def __init__(self, make: Callable[[K], V], most: int) -> None:
        self._make, self.most = make, most
        self._values: OrderedDict[K, tuple[V, int]] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, key: K) -> V:
        """The value, made if it is not kept. Raises what `make` raises."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key][0]
        value = self._make(key)
        size = weighed(value)
        with self._lock:
            self._values[key] = value, size
            self._values.move_to_end(key)
            self._shrink(self.most, (key,))
        return value

    @property
    def bytes(self) -> int:
        """Of all that is kept."""
        return sum(size for _, size in self._values.values())

    def release(self, used: Collection[K], spare: int) -> None:
        """Keep what is `used`, and of the rest the newest, as far as all have at most `spare` bytes."""
        with self._lock:
            self._shrink(spare, used)

    def _shrink(self, most: int, used: Collection[K]) -> None:
        for key in list(self._values):
            if self.bytes <= most:
                return
            if key not in used:
                del self._values[key]


def weighed(value: Any) -> int:
    """The bytes of `value` and of all that it holds, arrays with what they are views of; code is not counted."""
    seen: set[int] = set()
    waiting, total = [value], 0
    while waiting:
        each = waiting.pop()
        if id(each) in seen or isinstance(each, _CODE):
            continue
        seen.add(id(each))
        total += sys.getsizeof(each)  # of an array that is a view: without its data
        waiting += gc.get_referents(each)
        if isinstance(each, np.ndarray) and each.base is not None:
            waiting.append(each.base)
    return total


def given_back() -> None:
    """Give the memory that is free within this process back to the system, where the C library can (glibc)."""
    gc.collect()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
