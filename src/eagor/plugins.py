"""Finding what other packages bring: perceptions, worlds, tasks and benchmarks, by name.

A package adds its own under an entry-point group in its ``pyproject.toml``, and it is known wherever that package is
installed:

- ``eagor.perceptions``: what makes a perception, a class or function (`eagor.perception`);
- ``eagor.worlds``: a world, a function from a seed to a scene (`eagor.worlds`);
- ``eagor.tasks``: a simulated task, an `eagor.tasks.task.Task`;
- ``eagor.benchmarks``: a benchmark with published data, or what makes it (`eagor.tasks.benchmark`).

Our own are known even where the package runs from a folder, without installed metadata. A name of ours cannot be taken:
who brings it too is left out, and loading what has the name warns of that, as ``eagor doctor`` does.

What others bring may be broken in any way. It is imported only by what needs it, `faults` finds out elsewhere whether
that would work, and a package whose list of entry points cannot be read is as if it brought nothing.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from importlib.metadata import Distribution, EntryPoint, EntryPoints, distributions, entry_points
from typing import Any

from eagor.errors import EagorError, MissingExtraError

__all__ = [
    "bring", "brought", "check_named", "faults", "known", "left_out", "readable_lists", "unreadable", "version_of",
]  # fmt: skip

_READ: Any = Distribution.entry_points.fget  # as it is outside of `readable_lists`
PATIENCE = 30.0  # seconds that an import may take where many are tried; one that draws in torch takes ten
_PROBE = """
import os, sys
from importlib.metadata import EntryPoint
try:
    EntryPoint(*sys.argv[1:]).load()
    said = ""
except BaseException as error:
    said = f"{type(error).__name__}: {error}"
os.write(1, b"\\0" + said.encode("utf-8", "backslashreplace"))
os._exit(0)
"""


def known(group: str, built_in: Mapping[str, str]) -> dict[str, EntryPoint]:
    """Everything in `group` by name, `built_in` (name: ``"package.module:object"``) first; nothing is imported yet."""
    ours = {name: EntryPoint(name, value, group) for name, value in built_in.items()}
    return ours | {point.name: point for point in _installed(group) if point.name not in ours}


def brought(group: str, built_in: Mapping[str, str]) -> list[EntryPoint]:
    """What others bring to `group`."""
    return [point for name, point in known(group, built_in).items() if name not in built_in]


def left_out(point: EntryPoint, kind: str) -> list[str]:
    """A line about each of what is installed under the name of `point` too, and never reached; `kind` as in `bring`."""
    return [
        f"the {kind} {other.name!r} ({other.value}) of {version_of(other) or 'another package'} is left out: "
        f"the name is that of {point.value}. Give it another name"
        for other in _installed(point.group)
        if other.name == point.name and other.value != point.value
    ]


def bring(point: EntryPoint, kind: str) -> Any:
    """The object that `point` names; `kind` says what it is ("perception"). Raises `EagorError` if it cannot be had.

    Warns of what is `left_out` for it.
    """
    for line in left_out(point, kind):
        warnings.warn(line, stacklevel=2)
    try:
        with redirect_stdout(sys.stderr):  # stdout is for results
            return point.load()
    except MissingExtraError:
        raise
    except (Exception, SystemExit) as error:  # a broken plugin may raise anything
        raise EagorError(
            f"the {kind} {point.name!r} ({point.value}) cannot be imported ({type(error).__name__}: {error}). Install "
            "what it needs"
        ) from error


def faults(points: Iterable[EntryPoint]) -> dict[EntryPoint, str]:
    """Those of `points` that cannot be imported, and why; all are tried at once, each in a process of its own.

    So one that hangs, ends its process or prints disturbs nobody.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    tried = {}
    for point in points:
        tried[point] = subprocess.Popen(
            [sys.executable, "-c", _PROBE, point.name, point.value, point.group],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,  # so that what it starts can be ended with it
        )
    found, late = {}, time.monotonic() + PATIENCE
    try:
        for point, process in tried.items():
            try:
                out, _ = process.communicate(timeout=max(0.5, late - time.monotonic()))
            except subprocess.TimeoutExpired:
                why = f"its import has not come to an end in {PATIENCE:.0f} s"
            else:
                _, ended, said = out.rpartition(b"\0")
                why = said.decode() if ended else "its import ends the process"
            if why:
                found[point] = why
    finally:
        for process in tried.values():
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    return found


@contextmanager
def readable_lists() -> Iterator[None]:
    """Inside, a package whose list of entry points cannot be read has none, whoever asks.

    For a process of ours, not for one that uses us: tyro and gymnasium ask while they are imported, and would end with
    an error for the sake of any package that happens to be installed.
    """
    before = Distribution.entry_points
    Distribution.entry_points = property(lambda self: EntryPoints(_points(self)[0]))  # type: ignore[method-assign]
    try:
        yield
    finally:
        Distribution.entry_points = before  # type: ignore[method-assign]


def unreadable() -> list[str]:
    """A line about each installed package whose list of entry points cannot be read."""
    return [
        f"the entry points of {_name(each) or 'a package without a name'} cannot be read ({why}); install it again, or "
        "remove it"
        for each in distributions()
        if (why := _points(each)[1])
    ]


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
    return _name(point.dist) if point.dist is not None else None


def _installed(group: str) -> list[EntryPoint]:
    """What installed packages have in `group`."""
    try:
        return list(entry_points(group=group))
    except Exception:  # one list that cannot be read spoils the call for all
        return [point for each in distributions() for point in _points(each)[0] if point.group == group]


def _points(package: Distribution) -> tuple[list[EntryPoint], str]:
    """The entry points of `package`, or none and why they cannot be read."""
    try:
        return list(_READ(package)), ""
    except Exception as error:
        return [], f"{type(error).__name__}: {error}"


def _name(package: Distribution) -> str | None:
    try:
        name, version = package.name, package.version
    except Exception:  # its metadata is broken
        return None
    return f"{name} {version}" if name else None  # None: its metadata is gone
