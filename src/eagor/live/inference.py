"""A perception at work: in this process (`Inference`), or in one of its own (`InferenceWorker`).

In its own, whatever happens to it, the next picture finds a new one. That process sees one picture at a time in shared
memory. It is told: ``(name, queries, stamp, shape, world_R_body, grid)`` for each picture. It says: ``("ready", knows
its classes)`` once, or ``("unusable", text)``; then what `Inference.look` gives, and at the end of each picture
``("done",)``. Evidence comes as bytes of `eagor.tracking.checkpoint`.
"""

from __future__ import annotations

import ctypes
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from pickle import Pickler
from typing import Any

import numpy as np

from eagor._processes import Worker, WorkerEnded, WorkerSilent
from eagor.errors import EagorError, FormatError, ImageError, QueryError
from eagor.evidence import BodyMask, Evidence
from eagor.grids import PerspectiveGrid
from eagor.media.panorama import Picture
from eagor.perception import NoEvidenceError, Perception, knows_classes, load
from eagor.perception.recordings import HiddenParts
from eagor.perception.replay import look_if_recorded
from eagor.tracking.checkpoint import packed, unpacked

__all__ = ["Failed", "Inference", "InferenceWorker", "Looked", "UnusableError", "why_here"]

PATIENCE = 60.0  # seconds for one look
LOADING = 600.0  # seconds at least for a model to load
PAUSES = (0.5, 30.0)  # seconds before a perception that died starts anew: at first, and at most; doubled each time
ENDING = 0.2  # seconds for an idle process to leave by itself
DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of Linux's prctl


class UnusableError(EagorError):
    """The perception cannot be loaded, and will not be the next time either."""


@dataclass(frozen=True, eq=False)
class Looked:
    """What the perception says about `query`: several pieces of evidence for several views of the picture."""

    query: str
    looks: tuple[Evidence, ...]
    seconds: float


@dataclass(frozen=True)
class Failed:
    """Why there is no look; `query`: None if it concerns all.

    `refused`: this query will never be understood; `malformed`: what the perception returned is no evidence.
    """

    query: str | None
    text: str
    refused: bool = False
    malformed: bool = False


class Inference:
    """A perception that looks at pictures in this process, given as text for `eagor.perception.load` or as an object.

    What fails is said, and nothing is raised for it. `masks`: where looks say nothing; where all pictures are black
    about a pole, they do not either, which `say` is told once.
    """

    def __init__(
        self,
        perception: str | Perception,
        *,
        masks: Sequence[BodyMask] = (),
        say: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.perception = perception
        self.knows_classes: bool | None = None  # not known before it is loaded
        self._loaded: Perception | None = None
        self._hidden = HiddenParts(masks, say)

    def start(self) -> Iterator[Failed]:
        """Load the perception. Nothing comes. Raises `UnusableError`."""
        if self._loaded is None:
            try:
                self._loaded = load(self.perception) if isinstance(self.perception, str) else self.perception
            except Exception as error:
                raise UnusableError(_said(error)) from error
            self.knows_classes = knows_classes(self._loaded)
        return iter(())

    def look(
        self,
        picture: np.ndarray | None,
        queries: Sequence[str],
        stamp: float,
        world_R_body: np.ndarray | None = None,
        grid: PerspectiveGrid | None = None,
        unseen: np.ndarray | None = None,
    ) -> Iterator[Looked | Failed]:
        """Look at a picture ``(H, W, 3)`` uint8 for each query in turn; what is found comes as it is found.

        It is a panorama, or an ordinary one with its `grid`, without what is `unseen`; None for a perception that plays
        recorded looks.

        Raises `UnusableError` if the perception cannot be loaded, `ImageError` for another array.
        """
        self.start()
        covers, seen = self._hidden.masks(None), None
        if picture is not None:
            check_picture(picture)
            seen = picture.view()
            seen.flags.writeable = False
            try:
                covers = self._hidden.masks(Picture(seen, unseen, grid=grid))
            except ImageError as error:
                yield Failed(None, str(error))
                return
        if self.knows_classes and seen is not None:
            yield from self._at_once(seen, queries, stamp, world_R_body, grid, covers)
            return
        assert self._loaded is not None
        for query in queries:
            began = time.perf_counter()
            try:
                looks = look_if_recorded(self._loaded, seen, query, stamp, world_R_body, grid)
                looks = tuple(_covered(look, covers) for look in looks)
            except Exception as error:  # whatever the perception raises
                yield Failed(query, _said(error), isinstance(error, QueryError), isinstance(error, NoEvidenceError))
            else:
                yield Looked(query, looks, time.perf_counter() - began)

    def _at_once(
        self,
        seen: np.ndarray,
        queries: Sequence[str],
        stamp: float,
        pose: np.ndarray | None,
        grid: PerspectiveGrid | None,
        covers: Sequence[BodyMask],
    ) -> Iterator[Looked | Failed]:
        """All queries from one pass of a perception that knows its classes."""
        perception: Any = self._loaded
        began = time.perf_counter()
        try:
            looks = perception.answers(seen, queries, stamp, pose, grid)
            looks = [look if isinstance(look, QueryError) else _covered(look, covers) for look in looks]
        except Exception as error:
            looks = [error] * len(queries)
        seconds = (time.perf_counter() - began) / max(len(queries), 1)
        for query, look in zip(queries, looks, strict=True):
            if isinstance(look, Exception):
                yield Failed(query, _said(look), isinstance(look, QueryError))
            else:
                yield Looked(query, (look,), seconds)

    def kill(self) -> None:
        """Nothing can end a look in this process."""

    def close(self) -> None:
        """Nothing is held."""


def why_here(perception: str | Perception) -> str:
    """Why a perception cannot work in a process of its own, in words, such as a lambda; "" if it can."""

    class Nowhere:
        def write(self, _: bytes) -> None: ...

    if not isinstance(perception, str):
        try:
            Pickler(Nowhere()).dump(perception)
        except Exception as error:
            return str(error)
    return ""


class InferenceWorker:
    """The same in a process of its own; a perception that is an object is pickled.

    `patience`: seconds that a look may take; then the process is killed, and started anew with the next picture. One
    that dies is started anew after a pause, which grows while that goes on. Loading may take `LOADING` seconds, or
    `patience` if that is longer. Not for several threads, except `kill`.
    """

    def __init__(
        self,
        perception: str | Perception,
        *,
        patience: float = PATIENCE,
        masks: Sequence[BodyMask] = (),
    ) -> None:
        self.perception, self.patience, self.masks = perception, patience, tuple(masks)
        self.starts = 0
        self.knows_classes: bool | None = None  # not known before it is loaded
        self._worker: Worker | None = None
        self._memory: SharedMemory | None = None
        self._pause = PAUSES[0]
        self._rest_until = -math.inf
        self._killed = threading.Event()
        self._lock = threading.Lock()

    def start(self) -> Iterator[Failed]:
        """Start the process and wait until it is ready. Nothing comes if it is. Raises `UnusableError`."""
        if self._worker is not None:
            return
        rest = self._rest_until - time.monotonic()
        if self._killed.wait(max(0.0, rest)):
            return
        with self._lock:
            if self._killed.is_set():
                return
            try:
                self._worker = worker = Worker(serve, self.perception, self.masks, os.getpid())
            except Exception as error:  # the system has no more processes
                raise UnusableError(f"the perception's process cannot be started: {error}") from error
        self.starts += 1
        patience = max(LOADING, self.patience)
        try:
            said = worker.receive(patience)
        except WorkerSilent:
            yield Failed(None, self._hung(patience, "load"))
            return
        except WorkerEnded:
            yield Failed(None, self._died())
            return
        if said[0] == "unusable":
            self._end()
            raise UnusableError(said[1])
        self.knows_classes = said[1]

    def look(
        self,
        picture: np.ndarray,
        queries: Sequence[str],
        stamp: float,
        world_R_body: np.ndarray | None = None,
        grid: PerspectiveGrid | None = None,
        unseen: np.ndarray | None = None,
    ) -> Iterator[Looked | Failed]:
        """As `Inference.look`."""
        check_picture(picture)
        yield from self.start()
        if (worker := self._worker) is None:
            return
        name = self._show(picture)
        try:
            worker.send((name, tuple(queries), stamp, picture.shape, world_R_body, grid, unseen))
            while (said := worker.receive(self.patience))[0] != "done":
                self._pause = PAUSES[0]
                if said[0] == "looked":
                    yield Looked(said[1], unpacked(said[2]), said[3])
                else:
                    yield Failed(said[1], said[2], said[3])
        except WorkerSilent:
            yield Failed(None, self._hung(self.patience, "look"))
        except (WorkerEnded, ValueError):
            yield Failed(None, self._died())

    def kill(self) -> None:
        """End the process at once, from any thread; nothing is started any more."""
        self._killed.set()
        with self._lock:
            if self._worker is not None:
                self._worker.kill()

    def close(self) -> None:
        """End the process and let go of the shared memory. May be called twice."""
        self._killed.set()
        self._end()

    def _show(self, picture: np.ndarray) -> str:
        """Put the picture into shared memory; its name there."""
        if self._memory is None or self._memory.size < picture.nbytes:
            self._free()
            self._memory = SharedMemory(create=True, size=picture.nbytes)
        np.ndarray(picture.shape, dtype=np.uint8, buffer=self._memory.buf)[...] = picture
        return self._memory.name

    def _free(self) -> None:
        """Let go of the shared memory."""
        memory, self._memory = self._memory, None
        if memory is not None:
            memory.close()
            with suppress(FileNotFoundError):
                memory.unlink()

    def _hung(self, patience: float, what: str) -> str:
        """End a process that hangs; how to say it."""
        self._end()
        return f"the perception did not {what} within {patience:g} s; it was ended, and starts anew"

    def _died(self) -> str:
        """See a process end that has died; how to say it."""
        code = self._end()
        pause = self._pause
        self._rest_until = time.monotonic() + pause
        self._pause = min(2 * pause, PAUSES[1])
        how = f"exit code {code}"
        if code is not None and code < 0:
            with suppress(ValueError):
                how = signal.Signals(-code).name
        return f"the perception's process died ({how}); it starts anew after {pause:g} s"

    def _end(self) -> int | None:
        """The exit code of the process, which is gone then."""
        with self._lock:
            worker, self._worker = self._worker, None
        code = None if worker is None else worker.close(ENDING)
        self._free()
        return code


# --- the process that looks ---


def serve(line: Connection, perception: str | Perception, masks: Sequence[BodyMask], parent: int) -> None:
    """The life of the process; it ends when the line or its parent does. `masks`: see `Inference`."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _die_with(parent)
    memory: SharedMemory | None = None
    inference = Inference(perception, masks=masks)
    with suppress(EOFError, OSError):
        try:
            inference.start()
        except UnusableError as error:
            line.send(("unusable", str(error)))
            return
        line.send(("ready", inference.knows_classes))
        while (order := line.recv()) is not None:
            name, queries, stamp, shape, pose, grid, unseen = order
            if memory is None or memory.name != name:
                if memory is not None:
                    memory.close()
                memory = SharedMemory(name)
            seen = np.ndarray(shape, dtype=np.uint8, buffer=memory.buf)
            for said in inference.look(seen, queries, stamp, pose, grid, unseen):
                line.send(_in_bytes(said))
            del seen
            line.send(("done",))
    if memory is not None:
        with suppress(BufferError):  # a perception that has kept the picture
            memory.close()


def _in_bytes(said: Looked | Failed) -> tuple[Any, ...]:
    """What is said, as it is sent."""
    match said:
        case Looked(query, looks, seconds):
            return "looked", query, looks_in_bytes(looks), seconds
        case Failed(query, text, refused):
            return "failed", query, text, refused


def looks_in_bytes(looks: tuple[Evidence, ...]) -> bytes:
    """Looks as bytes of `eagor.tracking.checkpoint`, without what they say of their source where that cannot be."""
    try:
        return packed(looks)
    except FormatError:  # what it says of its source may be anything
        return packed(tuple(replace(look, source=None) for look in looks))


def check_picture(picture: np.ndarray) -> None:
    """Raise `ImageError` unless it is ``(H, W, 3)`` uint8."""
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise ImageError(f"a picture is {picture.dtype} {picture.shape}; wanted uint8 (H, W, 3)")


def _covered(look: Any, masks: Sequence[BodyMask]) -> Any:
    """A look that says nothing where the masks are."""
    for mask in masks:
        look = look.covered(mask)
    return look


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
