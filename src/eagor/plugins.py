"""Finding what other packages bring: perceptions, worlds, tasks and benchmarks, by name.

A package adds its own under an entry-point group in its ``pyproject.toml``, and it is known wherever that package is
installed:

- ``eagor.perceptions``: what makes a perception, a class or function (`eagor.perception`);
- ``eagor.worlds``: a world, a function from a seed to a scene (`eagor.worlds`);
- ``eagor.tasks``: a simulated task, an `eagor.tasks.task.Task`;
- ``eagor.benchmarks``: a benchmark with published data, or what makes it (`eagor.tasks.benchmark`).

Our own are known even where the package runs from a folder, without installed metadata. A name of ours cannot be taken:
who brings it too is left out, and loading what has the name warns of that, as ``eagor doctor`` does.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from eagor.errors import EagorError


def known(group: str, built_in: Mapping[str, str]) -> dict[str, EntryPoint]:
    """Everything in `group` by name, `built_in` (name: ``"package.module:object"``) first; nothing is imported yet."""
    ours = {name: EntryPoint(name, value, group) for name, value in built_in.items()}
    return ours | {point.name: point for point in entry_points(group=group) if point.name not in ours}


def left_out(point: EntryPoint, kind: str) -> list[str]:
    """A line about each of what is installed under the name of `point` too, and never reached; `kind` as in `bring`."""
    return [
        f"the {kind} {other.name!r} ({other.value}) of {version_of(other) or 'another package'} is left out: "
        f"the name is that of {point.value}. Give it another name"
        for other in entry_points(group=point.group)
        if other.name == point.name and other.value != point.value
    ]


def bring(point: EntryPoint, kind: str) -> Any:
    """The object that `point` names; `kind` says what it is ("perception"). Raises `EagorError` if it cannot be had.

    Warns of what is `left_out` for it.
    """
    for line in left_out(point, kind):
        warnings.warn(line, stacklevel=2)
    try:
        return point.load()
    except Exception as error:  # a broken plugin may raise anything
        raise EagorError(
            f"the {kind} {point.name!r} ({point.value}) cannot be imported ({type(error).__name__}: {error}). Install "
            "what it needs"
        ) from error


def check_named(found: Any, point: EntryPoint, kind: str, wanted: Any, *, or_maker: bool = False) -> None:
    """Raises `EagorError` unless `found` is a `wanted` with the name of `point`; `or_maker`: its maker would do too."""
    if isinstance(found, wanted) and found.name == point.name:
        return
    what = f"the {kind} {found.name!r}" if isinstance(found, wanted) else f"a {type(found).__name__}"
    raise EagorError(
        f"the entry point {point.name!r} of {point.group} ({point.value}) is {what}; wanted an "
        f"{wanted.__module__}.{wanted.__name__} whose name is that of the entry point"
        + (", or what makes it" if or_maker else "")
    )


def version_of(point: EntryPoint) -> str | None:
    """Name and version of the package that `point` came with, such as ``"eagor-example 1.0"``; None for our own."""
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else None
