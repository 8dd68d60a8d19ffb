"""The server's state: which pages watch which stream, what waits for each of them, and the processes that work.

Nothing is computed here. Several pages may watch one stream, and one at a time steers it: whoever speaks to it, for
`LEASE` seconds from each word.
"""

from __future__ import annotations

import asyncio
import re
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from eagor._extras import how_to_install
from eagor._processes import Worker, WorkerEnded
from eagor._version import __version__
from eagor.errors import EagorError
from eagor.perception import short_name
from eagor.sources.intrinsics import camera_of
from eagor.studio.messages import Ask, FromPage, Message, Open, Opening, PageError, merged
from eagor.studio.uploads import BYTES, PIXELS, Uploads

__all__ = ["Page", "RunReader", "SessionManager", "Settings", "StreamHandle"]

STREAM, RUNS = "eagor.studio.stream:serve", "eagor.studio.runs:serve"
OFFERED = (5, 3, 8, 12, 17, 602)  # apartments: the first has the tour (`eagor.lab.tasks.sim.walk`)
LAST_SEED = 9999
WAITING = 32  # scenes, problems and words that wait for a page; older ones are dropped
MOST = 6  # streams at a time
LEASE = 20.0  # seconds for which a page steers after each word
LINGER = 15.0  # seconds after which a stream that nobody watches ends: a page may be loaded again
ENDING = 5.0  # seconds for a process to leave by itself
APARTMENT = re.compile(r"apartment:(\d{1,4})")
SIMULATED, PICTURES = "simulated", "pictures"


@dataclass(frozen=True)
class Settings:
    """What the command line says.

    `host` that is bound, and the `token` that is wanted (None: none, on the loopback alone); the folder with `runs`; a
    further `perception`; a `live` source that the page opens on.
    """

    host: str = "127.0.0.1"
    token: str | None = None
    runs: Path = Path("runs")
    perception: str | None = None
    live: Opening | None = None


class Page:
    """A browser's page: the `stream` that it watches, and what waits for it: of steps the newest alone."""

    def __init__(self) -> None:
        self.stream: StreamHandle | None = None
        self._said: deque[Message] = deque(maxlen=WAITING)
        self._step: Message | None = None
        self._news = asyncio.Event()

    def put(self, message: Message) -> None:
        """A step replaces the one before it (`merged`); a new scene drops the steps of the old one."""
        if message.header["type"] == "step":
            self._step = merged(self._step, message)
        else:
            self._step = None if message.header["type"] == "scene" else self._step
            self._said.append(message)
        self._news.set()

    def clear(self) -> None:
        """Forget all: another source is opened."""
        self._said.clear()
        self._step = None

    async def get(self) -> Message:
        """The next message, once there is one: words before steps."""
        while True:
            if self._said:
                return self._said.popleft()
            message, self._step = self._step, None
            if message is not None:
                return message
            self._news.clear()
            await self._news.wait()


class StreamHandle:
    """A stream's process, those who watch it, and what it said last. For the event loop's thread.

    `died` is called if the process has.
    """

    def __init__(self, died: Callable[[StreamHandle], Any]) -> None:
        self.opening: Opening | None = None
        self.pages: list[Page] = []
        self._said: dict[str, Message] = {}  # the newest of each type
        self._driver: Page | None = None
        self._until = -1.0  # when its lease ends
        self._loop, self._died, self._closed = asyncio.get_running_loop(), died, False
        self._worker = Worker(STREAM, parent=True)
        threading.Thread(target=self._listen, name="eagor studio stream", daemon=True).start()

    def steer(self, page: Page, order: FromPage | Opening) -> None:
        """What a page wants shown, or says. Raises `PageError` while another page steers."""
        now = time.monotonic()
        if self._driver not in (None, page) and self._driver in self.pages and now < self._until:
            change = f"Try again in {self._until - now:.0f} s."
            raise PageError("Somebody else steers this at the moment; you can watch.", change, 409)
        self._driver, self._until = page, now + LEASE
        if isinstance(order, Opening):
            self.opening = order
            self._said.clear()
        elif isinstance(order, Ask) and self.opening is not None:
            perception = order.perception or self.opening.perception
            self.opening = replace(self.opening, query=order.query, perception=perception)
        with suppress(WorkerEnded):
            self._worker.send(order)

    def join(self, page: Page) -> None:
        """Watch from now on."""
        self.pages.append(page)
        page.stream = self
        for message in self._said.values():
            page.put(message)

    def close(self) -> None:
        """End the process. Takes a while."""
        self._closed = True
        self._worker.close(ENDING)

    def _listen(self) -> None:
        with suppress(WorkerEnded, EagorError, RuntimeError):  # the last: the loop is closed, the server ends
            while True:
                self._loop.call_soon_threadsafe(self._heard, self._worker.receive())
        if not self._closed:
            problem = Message.problem("the process of this view has ended unexpectedly", "Open it again.", True)
            with suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._heard, problem)
                self._loop.call_soon_threadsafe(self._died, self)

    def _heard(self, message: Message) -> None:
        kind = message.header["type"]
        if kind == "scene":
            self._said.clear()  # what was said while it was being opened
        if kind != "problem" or message.header["fatal"]:  # who comes later need not hear of others' questions
            self._said[kind] = merged(self._said.get(kind), message) if kind == "step" else message
        for page in self.pages:
            page.put(message)


class RunReader:
    """Asks a process of its own (`eagor.studio.runs.serve`), one question after the other."""

    def __init__(self, root: Path) -> None:
        self._root, self._turn = root, asyncio.Lock()
        self._worker: Worker | None = None

    async def ask(self, what: str, *about: Any) -> Any:
        """What the process answers. Raises `PageError`."""
        refused, found = True, "the process that reads runs has ended unexpectedly"
        async with self._turn:
            if self._worker is None or not self._worker.alive:
                self._worker = await asyncio.to_thread(Worker, RUNS)
            with suppress(WorkerEnded):
                self._worker.send((self._root, what, *about))
                refused, found = await asyncio.to_thread(self._worker.receive)
        if refused:
            words = " ".join(found.split())
            raise PageError(f"{words[:1].upper()}{words[1:]}.", "Choose another; eagor bench info RUN says more.", 422)
        return found

    def close(self) -> None:
        """End the process."""
        if self._worker is not None:
            self._worker.close(ENDING)


class SessionManager:
    """Opens streams for pages. For the event loop's thread."""

    def __init__(self, settings: Settings) -> None:
        self.settings, self.uploads, self.runs = settings, Uploads(), RunReader(settings.runs)
        self.perceptions = offers(settings.perception)
        self._streams: dict[str, StreamHandle] = {}

    def close(self) -> None:
        """End the processes, remove the uploads."""
        for each in (*self._streams.values(), self.runs, self.uploads):
            each.close()

    def open(self, page: Page, message: Open) -> None:
        """Show a source on a page, in place of the one before. Raises `PageError`."""
        opening, stream = self._opening(message), self._streams.get(message.source)
        if stream is None and len(self._streams) >= MOST:
            raise PageError(f"{MOST} sources are open already.", "Close a page, or watch one of them.", 429)
        self.leave(page)
        if stream is None:
            stream = self._streams[message.source] = StreamHandle(self._forget)
        shown = stream.opening
        asks = shown and message.query and (shown.query, shown.perception) != (opening.query, opening.perception)
        if shown is None or asks or message.hfov or message.drive:  # else it is watched as it is
            stream.steer(page, opening)
        stream.join(page)

    def tell(self, page: Page, message: FromPage) -> None:
        """Pass a message on to the stream that a page watches. Raises `PageError`."""
        if page.stream is None or page.stream.opening is None:
            raise PageError("Nothing is open.", "Open a source first.")
        if isinstance(message, Ask):
            self._checked(message.perception, page.stream.opening.simulated)
        page.stream.steer(page, message)

    def leave(self, page: Page) -> None:
        """The page watches nothing any more; a stream that nobody watches ends soon."""
        stream, page.stream = page.stream, None
        page.clear()
        if stream is not None:
            stream.pages.remove(page)
            asyncio.get_running_loop().call_later(LINGER, self._end, stream)

    def _end(self, stream: StreamHandle) -> None:
        if not stream.pages and stream in self._streams.values():
            self._forget(stream)
            threading.Thread(target=stream.close, daemon=True).start()

    def _forget(self, stream: StreamHandle) -> None:
        self._streams = {name: each for name, each in self._streams.items() if each is not stream}

    def _opening(self, message: Open) -> Opening:
        """What a page opens. Raises `PageError` for what there is not."""
        source, query, number, live = message.source, message.query, message.question, self.settings.live
        camera = camera_of(message.hfov, None)
        if (found := APARTMENT.fullmatch(source)) is not None:
            drive = f"?drive={message.drive}" if message.drive else ""
            return Opening(
                source + drive, f"Apartment {found[1]}", query, self._checked(message.perception, True), number
            )
        if source.startswith("upload:"):
            upload, perception = self.uploads.get(source[7:]), self._checked(message.perception, False)
            if not query:
                raise PageError("There is no query.", "Say what to look for, such as 'red chair'.")
            poses = "still" if upload.kind == "photo" else "auto"
            return Opening(upload.source, upload.name, query, perception, number, poses, camera=camera)
        if source != "live" or live is None:
            raise PageError("There is no such source.", "Start eagor studio with --source to see a camera here.", 404)
        live = replace(live, query=query, question=number) if query else live
        live = replace(live, camera=camera) if message.hfov else live
        perception = self._checked(message.perception, live.simulated) if message.perception else live.perception
        return replace(live, perception=perception)

    def _usable(self, simulated: bool) -> list[str]:
        """The names of the perceptions that can look at such sources."""
        kind = SIMULATED if simulated else PICTURES
        return [each["name"] for each in self.perceptions if kind in each["for"] and not each["problem"]]

    def _checked(self, name: str, simulated: bool) -> str:
        """This perception, or the first one if none is named; a page may name no other. Raises `PageError`."""
        usable = self._usable(simulated)
        if usable and name in ("", *usable):
            return name or usable[0]
        problem = next((each["problem"] for each in self.perceptions if each["name"] == name), "")
        change = problem or f"Choose one of {', '.join(usable)}."
        raise PageError(f"The perception {name!r} cannot be used here.", change, 404)

    def state(self) -> dict[str, Any]:
        """What ``/api/state`` says."""
        live = self.settings.live
        return {
            "version": __version__, "ready": True, "opens": "walk" if live is None else "live",
            "perceptions": self.perceptions, "houses": {"last": LAST_SEED, "offered": OFFERED},
            "limits": {"upload_bytes": BYTES, "pixels": PIXELS}, "source": None if live is None else live.title,
        }  # fmt: skip


def offers(given: str | None) -> list[dict[str, Any]]:
    """The perceptions that a page may choose, the `given` one first: what each is for, and why it cannot be used."""
    from eagor.perception.coco import wanted

    lacking = [each for each in ("onnxruntime", "trimesh", "gymnasium") if find_spec(each) is None]
    scout = f"It needs {' and '.join(lacking)}: {how_to_install('sim')}" if lacking else ""
    coco = f"It is not here yet: {'; then '.join(steps)}; then start the studio again." if (steps := wanted()) else ""
    found = [
        ("scout", "a small network for the rendered apartments", (SIMULATED,), scout),
        ("coco", "a small network for 80 everyday things in photographs", (PICTURES,), coco),
        ("colour", "where the colour is that the query names", (SIMULATED, PICTURES), ""),
    ]
    if given is not None:
        mine = given, f"{short_name(given)}, given with --perception", (SIMULATED, PICTURES), ""
        found = [mine, *(each for each in found if each[0] != given)]
    return [{"name": name, "words": words, "for": kinds, "problem": problem} for name, words, kinds, problem in found]
