"""The process that reads runs and draws episodes again, and what the server remembers of its results."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor.errors import EagorError
from eagor.studio.backends import Backend
from eagor.studio.caching import weighed
from eagor.studio.messages import PageError

if TYPE_CHECKING:
    from eagor.studio.replays import Redrawn

__all__ = ["Library", "serve"]

PROCESS = "eagor.studio.library:serve"
KEPT = 8  # episodes
TOGETHER = 1 << 27  # bytes of all of them; the newest is kept anyway
LASTING = 300.0  # seconds for which an episode is kept: a recording may grow
CHANGE = "Choose another run or episode; eagor bench info and eagor bench failures say more."


def serve(line: Connection) -> None:
    """The life of the process: one job after the other, ``(number, what, root, name, key)``.

    It says ``(number, "step", n)``, ``(number, "done", (result, its bytes))`` or ``(number, "refused", text)``.
    """
    from eagor.studio import runs

    with suppress(EOFError, OSError):
        while (job := line.recv()) is not None:
            number, what, root, name, key = job
            try:
                if what == "listed":
                    found: Any = runs.listed(root)
                elif what == "opened":
                    found = runs.opened(runs.folder_of(root, name))
                else:
                    folder = runs.folder_of(root, name)
                    found = runs.again(folder, key, lambda step, number=number: line.send((number, "step", step)))
                line.send((number, "done", (found, weighed(found))))
            except Exception as error:
                known = isinstance(error, EagorError | OSError)
                line.send((number, "refused", str(error) if known else f"{type(error).__name__}: {error}"))


@dataclass(eq=False)
class _Job:
    """Work under way: its future, and the step that has been reached."""

    future: asyncio.Future[Any]
    step: int = 0
    begun: float = field(default_factory=time.monotonic)
    bytes: int = 0  # of its result


class Library:
    """Asks the process, from the event loop's thread, and keeps the newest episodes. Starts late."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._backend: Backend | None = None
        self._numbers = itertools.count(1)
        self._jobs: dict[int, _Job] = {}
        self._episodes: OrderedDict[tuple[str, str], _Job] = OrderedDict()

    def warm(self) -> None:
        """Start the process, so that the first question is answered soon."""
        if self._backend is None:
            self._backend = Backend(PROCESS, (), self._heard, self._died)

    def close(self) -> None:
        """End the process."""
        if self._backend is not None:
            self._backend.close()

    async def listed(self) -> list[dict[str, Any]]:
        """A line about each run."""
        return await self._ask("listed").future

    async def opened(self, name: str) -> dict[str, Any]:
        """The episodes of a run. Raises `PageError`."""
        return await self._ask("opened", name).future

    async def episode(self, name: str, key: str) -> Redrawn | int:
        """An episode of a run, or the step that drawing it has reached. Raises `PageError`."""
        job = self._episodes.get((name, key))
        if job is None or (job.future.done() and time.monotonic() - job.begun > LASTING):
            job = self._episodes[name, key] = self._ask("again", name, key)
            while len(self._episodes) > KEPT:
                self._episodes.popitem(last=False)
        self._episodes.move_to_end((name, key))
        while len(self._episodes) > 1 and sum(each.bytes for each in self._episodes.values()) > TOGETHER:
            self._episodes.popitem(last=False)
        with suppress(TimeoutError):  # most are drawn soon
            await asyncio.wait_for(asyncio.shield(job.future), 0.3)
        if not job.future.done():
            return job.step
        if job.future.exception() is not None:
            self._episodes.pop((name, key), None)  # it may be finished next time
        return job.future.result()

    def _ask(self, what: str, name: str = "", key: str | None = None) -> _Job:
        self.warm()
        assert self._backend is not None
        number = next(self._numbers)
        job = self._jobs[number] = _Job(asyncio.get_running_loop().create_future())
        job.future.add_done_callback(lambda done: done.cancelled() or done.exception())  # nobody may be waiting
        self._backend.tell((number, what, self.root, name, key))
        return job

    def _heard(self, said: tuple[int, str, Any]) -> None:
        number, what, found = said
        job = self._jobs.get(number)
        if job is None:
            return
        if what == "step":
            job.step = found
            return
        del self._jobs[number]
        if what == "done":
            result, job.bytes = found
            job.future.set_result(result)
        else:
            words = " ".join(str(found).split())
            job.future.set_exception(PageError(f"{words[:1].upper()}{words[1:]}.".replace("..", "."), CHANGE, 422))

    def _died(self) -> None:
        for number in list(self._jobs):
            self._heard((number, "refused", "the process that reads runs has ended unexpectedly"))
