"""Plugins: perceptions, cameras, poses, worlds and tasks of other packages, by name.

A package adds its own under an entry-point group in its ``pyproject.toml``; they are known wherever it is installed:

- ``eagor.perceptions``: a class or function that makes a perception (`eagor.perception`);
- ``eagor.cameras``: a function that makes a source of pictures (`eagor.sources.camera_sources`);
- ``eagor.poses``: a function that makes a source of poses (`eagor.sources.odometry`);
- ``eagor.worlds``: a world, a function from a seed to a scene (`eagor.lab.worlds`);
- ``eagor.tasks``: a task, simulated or with published data, or a function that makes it (`eagor.lab.tasks.task.Task`).

Ours are known even if the package runs from a folder, without installed metadata. Plugins cannot take our names: such a
plugin is left out, with a warning when the name is loaded, and in ``eagor doctor``.

Plugins may be broken in any way. They are imported only when needed; `faults` tests the import in other processes; and
a package whose list of entry points cannot be read counts as having none.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from functools import lru_cache
from importlib.metadata import Distribution, EntryPoint, EntryPoints, distributions, entry_points
from typing import Any

from eagor.errors import EagorError, MissingExtraError

__all__ = ["bring", "brought", "faults", "known", "left_out", "readable_lists", "unreadable", "version_of"]

_READ: Any = Distribution.entry_points.fget  # as it is outside of `readable_lists`
PATIENCE = 30.0  # seconds that an import may take when all are tested; importing torch takes ten
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
    """Everything in `group` by name, `built_in` (name: ``"package.module:object"``) first. Imports none of it."""
    ours = {name: EntryPoint(name, value, group) for name, value in built_in.items()}
    return ours | {point.name: point for point in _installed(group) if point.name not in ours}


def brought(group: str, built_in: Mapping[str, str]) -> list[EntryPoint]:
    """The entry points of other packages in `group`."""
    return [point for name, point in known(group, built_in).items() if name not in built_in]


def left_out(point: EntryPoint, kind: str) -> list[str]:
    """A line about each entry point hidden behind `point` because of the same name; `kind` as in `bring`."""
    return [
        f"the {kind} {other.name!r} ({other.value}) of {version_of(other) or 'another package'} is left out: "
        f"{point.value} has the same name. Give it another name"
        for other in _installed(point.group)
        if other.name == point.name and other.value != point.value
    ]


def bring(point: EntryPoint, kind: str) -> Any:
    """The object that `point` names; warns of what is `left_out`. Raises `EagorError`; `kind`: "perception", ..."""
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
    """Those of `points` that cannot be imported, with the reason; all tried at once in separate processes."""
    from concurrent.futures import ThreadPoolExecutor

    points = list(points)
    with ThreadPoolExecutor(len(points) or 1) as pool:
        return {point: why for point, why in zip(points, pool.map(_fault, points), strict=True) if why}


def _fault(point: EntryPoint) -> str:
    process = subprocess.Popen(
        [sys.executable, "-c", _PROBE, point.name, point.value, point.group],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,  # so that its child processes can be ended with it
    )
    try:
        _, ended, said = process.communicate(timeout=PATIENCE)[0].rpartition(b"\0")
        return said.decode() if ended else "its import ends the process"
    except subprocess.TimeoutExpired:
        return f"its import took longer than {PATIENCE:.0f} s"
    finally:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@contextmanager
def readable_lists() -> Iterator[None]:
    """Within this context, a package whose list of entry points cannot be read has none, for every caller.

    For our own processes only, not for programs that use us as a library. tyro and gymnasium read the lists while they
    are imported, and would fail because of any such package.
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


def version_of(point: EntryPoint) -> str | None:
    """Name and version of the package of `point`, such as ``"eagor-example 1.0"``; None for our own."""
    return _name(point.dist) if point.dist is not None else None


def _installed(group: str) -> tuple[EntryPoint, ...]:
    """The entry points of installed packages in `group`."""
    return _listed(group, tuple((place, _changed(place)) for place in sys.path))


@lru_cache(maxsize=32)
def _listed(group: str, places: tuple[tuple[str, int | None], ...]) -> tuple[EntryPoint, ...]:
    """Those of `_installed`, read again once a folder of `places` has changed: it takes as long as a unit of work."""
    try:
        return tuple(entry_points(group=group))
    except Exception:  # one unreadable list makes the call fail for all
        return tuple(point for each in distributions() for point in _points(each)[0] if point.group == group)


def _changed(place: str) -> int | None:
    """When something was last put into a folder of `sys.path` or taken from it; None if it is not there."""
    try:
        return os.stat(place or ".").st_mtime_ns
    except (OSError, ValueError):
        return None


def _points(package: Distribution) -> tuple[list[EntryPoint], str]:
    """The entry points of `package`, or none and the reason why they cannot be read."""
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
