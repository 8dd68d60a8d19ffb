"""What tests of processes share: waiting for something, who is alive, little memory, and a disk that is full."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest


def wait_for(what: Callable[[], object]) -> None:
    """Until `what` is true; for five minutes, since a machine may be busy."""
    for _ in range(6000):
        if what():
            return
        time.sleep(0.05)
    raise AssertionError("waited for five minutes in vain")


def begun(*words: object, path: object = "", **pipes: Any) -> subprocess.Popen[Any]:
    """``eagor WORDS`` in a session of its own; modules in `path` can be imported."""
    paths = os.pathsep.join([str(path), *(entry for entry in sys.path if entry)])
    return subprocess.Popen(
        [sys.executable, "-m", "eagor", *map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"}, start_new_session=True, **pipes,
    )  # fmt: skip


def sessions_of(process: int) -> set[int]:
    """The sessions of a process that leads one and of all that it has started, and they have. Linux."""
    family, sessions, grown = {process}, {process}, True
    while grown:
        found = [(pid, session) for pid, parent, session in _processes() if parent in family]
        grown = not family.issuperset(pid for pid, _ in found)
        family.update(pid for pid, _ in found)
        sessions.update(session for _, session in found)
    return sessions


def alive(sessions: set[int]) -> dict[int, str]:
    """The processes of these sessions that are alive, with their command lines. Linux."""
    found = {}
    for pid, _, session in _processes():
        if session in sessions:
            with suppress(OSError):  # it has just ended
                found[pid] = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    return found


def _processes() -> Iterator[tuple[int, int, int]]:
    """Each process that is alive, its parent and its session."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, parent, _, session = stat.read_text().rpartition(")")[2].split()[:4]
        except (OSError, ValueError):
            continue  # it has just ended
        if state != "Z":
            yield int(stat.parent.name), int(parent), int(session)


def limited(imports: str, code: str, folder: Path, mebibytes: int) -> list[str]:
    """The lines that `code` prints, which knows `folder`, and after its `imports` may take so much more memory."""
    head = "import resource, sys, warnings\nwarnings.simplefilter('ignore')\nfrom pathlib import Path\n"
    limit = (
        "size = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        f"resource.setrlimit(resource.RLIMIT_AS, (size + ({mebibytes} << 20), resource.RLIM_INFINITY))\n"
        "folder = Path(sys.argv[1])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", head + imports + limit + code, folder],
        capture_output=True, text=True, timeout=300, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@contextmanager
def little_room(most: int) -> Iterator[None]:
    """Files of this process, and of those that it starts, may hold so many bytes, as if the disk were full. POSIX."""
    resource = pytest.importorskip("resource")
    before, kept = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    sys.dont_write_bytecode = True  # half a module would stay
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = kept
