"""Keeps a perception running in a process of its own: whatever happens to it, the next picture finds a new one."""

from __future__ import annotations

import math
import os
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.shared_memory import SharedMemory

import numpy as np

from eagor._processes import Worker, WorkerEnded, WorkerSilent
from eagor.errors import EagorError, ImageError
from eagor.evidence import BodyMask, Evidence
from eagor.grids import PerspectiveGrid
from eagor.live.looker import serve
from eagor.perception import Perception
from eagor.tracking.checkpoint import unpacked

__all__ = ["Failed", "Keeper", "Looked", "UnusableError"]

PATIENCE = 60.0  # seconds for one look
LOADING = 600.0  # seconds at least for a model to load
PAUSES = (0.5, 30.0)  # seconds before a perception that died starts anew: at first, and at most; doubled each time
ENDING = 0.2  # seconds for an idle process to leave by itself


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
    """Why there is no look; `query`: None if it concerns all. `refused`: this query will never be understood."""

    query: str | None
    text: str
    refused: bool = False


class Keeper:
    """A perception in a process of its own, given as text for `eagor.perception.load` or as an object to pickle.

    `patience`: seconds that a look may take; then the process is killed, and started anew with the next picture. One
    that dies is started anew after a pause, which grows while that goes on. Loading may take `LOADING` seconds, or
    `patience` if that is longer. `masks`: where looks say nothing; where all pictures are black about a pole, they do
    not either. Not for several threads, except `kill`.
    """

    def __init__(
        self, perception: str | Perception, *, patience: float = PATIENCE, masks: Sequence[BodyMask] = ()
    ) -> None:
        self.perception, self.patience, self.masks = perception, patience, tuple(masks)
        self.starts = 0
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
            except Exception as error:  # the perception cannot be pickled, or the system has no more processes
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

    def look(
        self,
        picture: np.ndarray,
        queries: Sequence[str],
        stamp: float,
        world_R_body: np.ndarray | None = None,
        grid: PerspectiveGrid | None = None,
    ) -> Iterator[Looked | Failed]:
        """Look at a picture ``(H, W, 3)`` uint8 for each query in turn; what is found comes as it is found.

        It is a panorama, or an ordinary one with its `grid`.

        Raises `UnusableError` if the perception cannot be loaded, `ImageError` for another array.
        """
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
            raise ImageError(f"a picture is {picture.dtype} {picture.shape}; wanted uint8 (H, W, 3)")
        yield from self.start()
        if (worker := self._worker) is None:
            return
        name = self._show(picture)
        try:
            worker.send((name, tuple(queries), stamp, picture.shape, world_R_body, grid))
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
