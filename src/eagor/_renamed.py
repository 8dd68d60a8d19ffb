"""Old names of settings: they still work, and warn."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

Kind = TypeVar("Kind", bound=type)


def renamed(**names: str) -> Callable[[Kind], Kind]:
    """A decorator for dataclasses: each old name, as argument and as attribute, stands for the new one.

    A new name may be that of a nested setting: ``decode="answers.decode"``.
    """

    def decorate(kind: Kind) -> Kind:
        made: Any = kind
        init = made.__init__

        @functools.wraps(init)
        def __init__(self: Any, *args: Any, **settings: Any) -> None:
            nested: dict[str, dict[str, Any]] = {}
            for old in names.keys() & settings.keys():
                _warn(kind, old, names[old])
                outer, _, inner = names[old].partition(".")
                if inner:
                    nested.setdefault(outer, {})[inner] = settings.pop(old)
                else:
                    settings[outer] = settings.pop(old)
            init(self, *args, **settings)
            for outer, changes in nested.items():
                object.__setattr__(self, outer, type(getattr(self, outer))(**{**vars(getattr(self, outer)), **changes}))

        made.__init__ = __init__
        for old, new in names.items():
            setattr(made, old, property(functools.partial(_read, kind=kind, old=old, new=new)))
        return kind

    return decorate


def _read(owner: Any, kind: type, old: str, new: str) -> Any:
    _warn(kind, old, new)
    return functools.reduce(getattr, new.split("."), owner)


def _warn(kind: type, old: str, new: str) -> None:
    warnings.warn(f"{kind.__name__}.{old} is now {kind.__name__}.{new}", DeprecationWarning, stacklevel=3)
