"""The process that looks: it sees one picture at a time in shared memory, and says what the perception found.

It is told: ``(name, queries, stamp, shape, world_R_body, grid)`` for each picture. It says: ``("ready",)`` once, or
``("unusable", text)``; then for each query ``("looked", query, evidence, seconds)`` or ``("failed", query, text,
refused)``, and at the end of each picture ``("done",)``. Evidence comes as bytes of `eagor.tracking.checkpoint`.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from typing import Any

import numpy as np

from eagor.errors import EagorError, FormatError, QueryError
from eagor.evidence import BodyMask, Evidence
from eagor.grids import PerspectiveGrid
from eagor.media.defects import NeverSeen
from eagor.perception import Perception, load
from eagor.perception.replay import look_if_recorded
from eagor.tracking.checkpoint import packed

DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of Linux's prctl


def serve(line: Connection, perception: str | Perception, masks: Sequence[BodyMask], parent: int) -> None:
    """The life of the process; it ends when the line or its parent does. `masks`: where looks say nothing."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _die_with(parent)
    memory: SharedMemory | None = None
    with suppress(EOFError, OSError):
        try:
            looking = load(perception) if isinstance(perception, str) else perception
        except Exception as error:
            line.send(("unusable", _said(error)))
            return
        line.send(("ready",))
        black = NeverSeen()
        while (order := line.recv()) is not None:
            name, queries, stamp, shape, pose, grid = order
            if memory is None or memory.name != name:
                if memory is not None:
                    memory.close()
                memory = SharedMemory(name)
            seen = np.ndarray(shape, dtype=np.uint8, buffer=memory.buf)
            seen.flags.writeable = False
            covers = list(masks)
            if grid is None:  # an ordinary picture has no poles
                hidden = black.add(seen)
                covers += [BodyMask(~hidden)] if hidden.any() and not hidden.all() else []
            for query in queries:
                line.send(_looked(looking, seen, query, stamp, pose, grid, covers))
            del seen
            line.send(("done",))
    if memory is not None:
        with suppress(BufferError):  # a perception that has kept the picture
            memory.close()


def _looked(
    perception: Perception,
    seen: np.ndarray,
    query: str,
    stamp: float,
    pose: Any,
    grid: PerspectiveGrid | None,
    covers: Sequence[BodyMask],
) -> tuple[Any, ...]:
    """One look, as it is said; whatever the perception raises is said too."""
    began = time.perf_counter()
    try:
        looks = look_if_recorded(perception, seen, query, stamp, pose, grid)
        for mask in covers:
            looks = tuple(look.covered(mask) for look in looks)
        return "looked", query, looks_in_bytes(looks), time.perf_counter() - began
    except Exception as error:
        return "failed", query, _said(error), isinstance(error, QueryError)


def looks_in_bytes(looks: tuple[Evidence, ...]) -> bytes:
    """Looks as bytes of `eagor.tracking.checkpoint`, without what they say of their source where that cannot be."""
    try:
        return packed(looks)
    except FormatError:  # what it says of its source may be anything
        return packed(tuple(replace(look, source=None) for look in looks))


def _said(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, EagorError) and text else f"{type(error).__name__}: {text}".rstrip(": ")


def _die_with(parent: int) -> None:
    """Have Linux kill this process with the thread that started it, even if the perception never returns to Python."""
    if sys.platform != "linux":
        return
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(DEATH_SIGNAL, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)
