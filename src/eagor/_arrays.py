"""Arrays of the caller's kind: a thin layer over the array API.

Plans (Legendre tables, Wigner blocks, trigonometric matrices) are computed once, in float64 NumPy. `constant` returns
them with the namespace, dtype and device of a given array. This module imports no array library but NumPy: whoever
passes a torch tensor has imported torch.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from functools import lru_cache
from threading import Lock
from typing import Any

import numpy as np
from array_api_compat import array_namespace, device, to_device

# Arrays are whatever the caller brought: ndarray, torch.Tensor, ... The array API has no common base class.
Array = Any


def namespace(*arrays: Array) -> Any:
    """The array API namespace of `arrays`; plain NumPy for ndarrays, numbers and lists."""
    if all(type(a) is np.ndarray for a in arrays):  # the hot path: array_namespace costs microseconds
        return np
    foreign = [a for a in arrays if hasattr(a, "shape") and not isinstance(a, np.ndarray | np.generic)]
    return array_namespace(*foreign) if foreign else np


def as_float(values: Array) -> Array:
    """`values` as a floating array; other dtypes, half precision too, become float64 (NumPy) or float32 (others)."""
    if type(values) is np.ndarray and values.dtype.kind == "f" and values.dtype.itemsize > 2:
        return values
    xp = namespace(values)
    if xp is np:
        array = np.asarray(values)
        return array if array.dtype.kind == "f" and array.dtype.itemsize > 2 else array.astype(np.float64)
    return values if xp.isdtype(values.dtype, "real floating") else xp.astype(values, xp.float32)


def to_library(values: Array, reference: Array) -> Array:
    """`values` as an array of the library of `reference`, on its device.

    Values of that library keep their precision; other floats take the precision of `reference`.
    """
    if isinstance(values, np.ndarray) and isinstance(reference, np.ndarray):
        return values
    if hasattr(values, "shape") and namespace(values) is namespace(reference) is not np:
        return to_device(values, device(reference))
    return table_like(to_numpy(values), reference)


def frozen(values: Array) -> Array:
    """`values` itself, made read-only if it is NumPy: for new arrays that are kept and handed out."""
    if isinstance(values, np.ndarray):
        values.setflags(write=False)
    return values


def to_numpy(values: Array) -> np.ndarray:
    """`values` as an ndarray on the host (a copy where it lives elsewhere)."""
    if isinstance(values, np.ndarray):
        return values
    if hasattr(values, "detach"):  # torch, without importing it
        values = values.detach().cpu()
        if str(values.dtype) == "torch.bfloat16":  # NumPy has no such numbers
            values = values.float()
    return np.asarray(values)


def table_like(table: np.ndarray, reference: Array) -> Array:
    """`table` as an array of the library of `reference`; floats take its precision, integers stay integers.

    For tables that are new at every call; `constant` caches.
    """
    precision = {"dtype": reference.dtype} if table.dtype.kind == "f" else {}
    if isinstance(reference, np.ndarray):
        return table.astype(reference.dtype, copy=False) if precision else table
    return namespace(reference).asarray(table.copy(), device=device(reference), **precision)


def constant(plan: Callable[..., np.ndarray], *key: Any, like: Array) -> Array:
    """``plan(*key)``, a pure function of hashable arguments, as an array like `like` (cached)."""
    if type(like) is np.ndarray:  # the hot path
        return _cached(plan, key, like.dtype.char)
    return _cached(plan, key, *_kind(like))


def recent(plan: Callable[..., np.ndarray], *key: Any, like: Array) -> Array:
    """As `constant`, for large plans that may differ at every look: it caches the last `RECENT_BYTES` of them."""
    wanted = plan, key, _kind(like)
    with _turn:
        if wanted in _recent:
            _recent.move_to_end(wanted)
            return _recent[wanted]
    # Outside the lock: a plan may ask for another. Two threads may compute the same plan; that is harmless.
    made = _made(plan, key, *wanted[2])
    with _turn:
        _recent[wanted] = made
        while len(_recent) > 1 and sum(map(_size, _recent.values())) > RECENT_BYTES:
            _recent.popitem(last=False)
    return made


RECENT_BYTES = 1 << 29
_recent: OrderedDict[tuple, Array] = OrderedDict()
_turn = Lock()


def _size(kept: Array) -> int:
    return math.prod(kept.shape) * getattr(kept, "itemsize", 8)


def _kind(like: Array) -> tuple:
    """What `_made` has to know of an array: its dtype; of other libraries' arrays also the namespace and the device."""
    return (like.dtype.char,) if type(like) is np.ndarray else (like.dtype, namespace(like), device(like))


def _made(plan: Callable[..., np.ndarray], key: tuple, dtype: Any, xp: Any = np, place: Any = None) -> Array:
    table = np.ascontiguousarray(plan(*key))
    floats = table.dtype.kind == "f"
    if xp is np:
        return frozen(table.astype(dtype, copy=False) if floats else table)
    return xp.asarray(table.copy(), device=place, **({"dtype": dtype} if floats else {}))


_cached = lru_cache(maxsize=256)(_made)
