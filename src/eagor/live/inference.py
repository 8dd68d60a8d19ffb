"""The perception of a loop: in this process, or in one of its own with a watchdog.

The pictures go there through shared memory, or where there is too little of that through the line.
"""

from __future__ import annotations

import ctypes
import math
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any

import numpy as np

from eagor._processes import Worker, WorkerEnded, WorkerSilent, of_script
from eagor.errors import EagorError, ImageError, QueryError
from eagor.evidence import BodyMask, Evidence
from eagor.live.events import Diagnostic, Event, ObservationReceived
from eagor.perception import NoEvidenceError, Perception, knows_classes, load
from eagor.perception.partial import ValidMasks
from eagor.perception.replay import infer_or_replay
from eagor.sources import Frame
from eagor.sources.panorama import Picture

__all__ = ["InferenceWorker", "Inferred", "error_text", "why_here"]

PATIENCE = 60.0  # seconds for one look
LOADING = 600.0  # seconds at least for a model to load
PAUSES = (0.5, 30.0)  # seconds before a perception that died starts anew: at first, and at most; doubled each time
ENDING = 0.2  # seconds for an idle process to leave by itself
GUARD = 'if __name__ == "__main__"'
DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of Linux's prctl


@dataclass(frozen=True, eq=False)
class Inferred:
    """What the perception says about `query` in a picture: several pieces of evidence for several views of it.

    `problem`: why it says nothing; of all queries where `query` is None. `refused`: this query will never be
    understood; `malformed`: what came is no evidence.
    """

    query: str | None
    evidence: tuple[Evidence, ...] = ()
    seconds: float = 0.0
    problem: str = ""
    refused: bool = False
    malformed: bool = False

    def events(self, now: float, stamp: float, told: float) -> Iterator[Event]:
        """What the core gets of it at a time; `stamp` and `told`: as of `ObservationReceived`."""
        if self.problem or self.query is None:
            yield Diagnostic(now, "perception", self.problem, self.query or "")
            return
        yield Diagnostic(now, "perception")
        yield Diagnostic(now, "perception", about=self.query)
        yield ObservationReceived(now, stamp, told, self.query, self.evidence, self.seconds)


def error_text(error: Exception) -> str:
    """An error in words, with its type where it is none of ours."""
    text = " ".join(str(error).split())
    return text if text and isinstance(error, EagorError | OSError) else f"{type(error).__name__}: {text}".rstrip(": ")


def why_here(perception: str | Perception) -> str:
    """Why a perception cannot work in a process of its own, in words, such as a lambda; "" if it can."""
    try:
        pickled = pickle.dumps(perception)
    except Exception as error:
        return str(error)
    if not of_script(pickled):
        return ""
    try:
        guarded = "__main__" in Path(getattr(sys.modules["__main__"], "__file__", "")).read_text(errors="replace")
    except OSError:  # of a prompt or a notebook
        guarded = False
    return "" if guarded else f"another process cannot import it from what was started, which lacks {GUARD}"


class InferenceWorker:
    """A perception, given as text for `eagor.load` or as an object, in this process or, `isolated`, in one of its own.

    What fails is said, and nothing is raised for it. `masks`: where looks say nothing; where all pictures are black
    about a pole, they do not either, which `say` is told once (in this process).

    `patience`: seconds that a look may take in a process of its own; then that is killed, and started anew with the
    next picture. One that dies is started anew after a pause, which grows while that goes on. Loading may take
    `LOADING` seconds, or `patience` if that is longer. Not for several threads, except `kill`.
    """

    def __init__(
        self,
        perception: str | Perception,
        *,
        isolated: bool = False,
        patience: float = PATIENCE,
        masks: Sequence[BodyMask] = (),
        say: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.perception, self.isolated, self.patience = perception, isolated, patience
        self.knows_classes: bool | None = None  # not known before it is loaded
        self._masks, self._say = tuple(masks), say
        self._model: _Model | None = None
        self._worker: Worker | None = None
        self._memory: SharedMemory | None = None
        self._pause, self._rest_until = PAUSES[0], -math.inf
        self._killed, self._lock = threading.Event(), threading.Lock()

    def start(self) -> str:
        """Load the perception; why that failed for now, or "". Raises `EagorError` where it will fail again, too."""
        if not self.isolated:
            self._model = self._model or _Model(self.perception, self._masks, self._say)
            self.knows_classes = self._model.knows_classes
            return ""
        if self._worker is not None or self._killed.wait(max(0.0, self._rest_until - time.monotonic())):
            return ""
        with self._lock:
            if self._killed.is_set():
                return ""
            try:
                self._worker = Worker(_serve, self.perception, self._masks)
            except Exception as error:  # the system has no more processes
                raise EagorError(f"the perception's process cannot be started: {error}") from error
        found = self._receive(max(LOADING, self.patience), "load")
        if isinstance(found, Inferred):
            return found.problem
        self.knows_classes = found
        return ""

    def infer(self, frame: Frame, queries: Sequence[str], world_R_body: np.ndarray | None = None) -> Iterator[Inferred]:
        """Look at a frame for each query in turn; what is found comes as it is found.

        A perception that plays recorded looks needs no picture. Raises as `start`, and `ImageError` for a picture that
        is not ``(H, W, 3)`` uint8.
        """
        picture = frame.picture
        if picture is not None and (picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8):
            raise ImageError(f"a picture is {picture.dtype} {picture.shape}; wanted uint8 (H, W, 3)")
        if problem := self.start():
            yield Inferred(None, problem=problem)
        elif self._model is not None:
            yield from self._model.infer(frame, queries, world_R_body)
        elif self._worker is not None and picture is not None:
            name = self._share(picture)
            there = replace(frame, picture=None) if name else frame
            with suppress(WorkerEnded):  # to receive meets that again
                self._worker.send((there, (name, picture.shape), tuple(queries), world_R_body))
            while self._worker is not None and (found := self._receive(self.patience, "look")) is not None:
                yield found

    def kill(self) -> None:
        """End its own process at once, from any thread; nothing is started any more."""
        self._killed.set()
        with self._lock:
            if self._worker is not None:
                self._worker.kill()

    def close(self) -> None:
        """End its own process and let go of the shared memory. May be called twice."""
        self._killed.set()
        self._end()

    def _receive(self, patience: float, what: str) -> Any:
        """What its own process says next, or an `Inferred` that tells why it is gone."""
        assert self._worker is not None
        try:
            found = self._worker.receive(patience)
        except WorkerSilent:
            self._end()
            problem = f"the perception did not {what} within {patience:g} s; it was ended, and starts anew"
        except WorkerEnded:
            code, pause = self._end(), self._pause
            self._rest_until, self._pause = time.monotonic() + pause, min(2 * pause, PAUSES[1])
            how = f"exit code {code}" if code >= 0 else signal.strsignal(-code)
            problem = f"the perception's process died ({how}); it starts anew after {pause:g} s"
        else:
            if isinstance(found, Inferred):
                self._pause = PAUSES[0]
            return found
        return Inferred(None, problem=problem)

    def _share(self, picture: np.ndarray) -> str:
        """Put the picture into shared memory; its name there, "" if the system has no room for it."""
        if self._memory is None or self._memory.size < picture.nbytes:
            self._free()
            try:
                self._memory = SharedMemory(create=True, size=picture.nbytes)
                if sys.platform == "linux":  # what is only promised (64 MB in a container) ends who writes there
                    with open(f"/dev/shm/{self._memory.name}", "r+b") as file:
                        os.posix_fallocate(file.fileno(), 0, picture.nbytes)
            except OSError:
                self._free()
                return ""
        np.ndarray(picture.shape, dtype=np.uint8, buffer=self._memory.buf)[...] = picture
        return self._memory.name

    def _free(self) -> None:
        memory, self._memory = self._memory, None
        if memory is not None:
            memory.close()
            with suppress(FileNotFoundError):
                memory.unlink()

    def _end(self) -> int:
        """End the process, and let go of the memory; its exit code, 0 if there was none."""
        with self._lock:
            worker, self._worker = self._worker, None
        code = 0 if worker is None else worker.close(ENDING)
        self._free()
        return code


class _Model:
    """The perception itself, in whichever process it is. Raises `EagorError` if it cannot be loaded."""

    def __init__(
        self,
        perception: str | Perception,
        masks: Sequence[BodyMask],
        say: Callable[[str], object] = lambda text: None,
    ) -> None:
        try:
            self._perception: Any = load(perception) if isinstance(perception, str) else perception
        except Exception as error:
            raise EagorError(error_text(error)) from error
        self.knows_classes = knows_classes(self._perception)
        self._masks = ValidMasks(masks, say)

    def infer(self, frame: Frame, queries: Sequence[str], pose: np.ndarray | None) -> Iterator[Inferred]:
        picture, stamp, grid = frame.picture, frame.stamp, frame.grid
        if picture is not None:
            picture = picture.view()
            picture.flags.writeable = False
        try:
            masks = self._masks.masks(None if picture is None else Picture(picture, frame.unseen, grid=grid))
        except ImageError as error:
            yield Inferred(None, problem=str(error))
            return
        one_pass = self.knows_classes and picture is not None
        for group in [queries] if one_pass else [[query] for query in queries]:
            began = time.perf_counter()
            found: list[tuple[Any, ...]]
            try:
                if one_pass:
                    found = [(each,) for each in self._perception.answers(picture, group, stamp, pose, grid)]
                else:
                    found = [infer_or_replay(self._perception, picture, group[0], stamp, pose, grid)]
                found = [tuple(_masked(each, masks) for each in looks) for looks in found]
            except Exception as error:  # whatever the perception raises
                found = [(error,) for _ in group]
            seconds = (time.perf_counter() - began) / len(group)
            for query, looks in zip(group, found, strict=True):
                error = looks[0] if looks else None
                if isinstance(error, Exception):
                    kind = isinstance(error, QueryError), isinstance(error, NoEvidenceError)
                    yield Inferred(query, (), seconds, error_text(error), *kind)
                else:
                    yield Inferred(query, looks, seconds)


def _masked(look: Any, masks: Sequence[BodyMask]) -> Any:
    """A look that says nothing where the masks are; an error in its place as it is."""
    if not isinstance(look, QueryError):
        for mask in masks:
            look = look.covered(mask)
    return look


def _serve(line: Connection, perception: str | Perception, masks: Sequence[BodyMask]) -> None:
    """The life of the process that looks; it ends when the line or its parent does."""
    if sys.platform == "linux":  # also a perception that never returns to Python ends with the thread that started it
        ctypes.CDLL(None).prctl(DEATH_SIGNAL, signal.SIGKILL)
    model, memory = _Model(perception, masks), None
    line.send(model.knows_classes)
    while True:
        frame, (name, shape), queries, pose = line.recv()
        picture = frame.picture
        if name:
            memory = memory if memory is not None and memory.name == name else SharedMemory(name)
            picture = np.ndarray(shape, dtype=np.uint8, buffer=memory.buf)
        for found in model.infer(replace(frame, picture=picture), queries, pose):
            try:
                line.send(found)
            except (pickle.PicklingError, TypeError, AttributeError):  # what a look says of its source may be anything
                line.send(replace(found, evidence=tuple(replace(each, source=None) for each in found.evidence)))
        del picture  # so that the memory can be let go
        line.send(None)
