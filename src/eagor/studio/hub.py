"""The server's state: which pages watch what, what waits for each of them, and the processes that work for them.

Nothing is computed here. Sessions run in the engine's process, a live source in its own, runs are read in a third.
"""

from __future__ import annotations

import asyncio
import itertools
import math
import time
from collections import deque
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from eagor._extras import how_to_install
from eagor._version import __version__
from eagor.perception import short_name
from eagor.studio.backends import Backend
from eagor.studio.guard import Gate
from eagor.studio.library import Library
from eagor.studio.messages import LONGEST, SEED, Message, PageError, merged
from eagor.studio.session import Opening, Question
from eagor.studio.uploads import BYTES, PIXELS, Uploads

__all__ = ["Channel", "LiveSource", "Offer", "Page", "Settings", "Slot", "Studio", "offers"]

WALK, PICTURE = "walk", "picture"
_BUILT_IN = {
    "scout": ("a small network for the rendered apartments", (WALK,)),
    "truth": ("told by the simulator, with a detector's mistakes", (WALK,)),
    "coco": ("a small network for 80 everyday things in photographs", (PICTURE,)),
    "colour": ("where the colour is that the query names", (WALK, PICTURE)),
}


@dataclass(frozen=True)
class Offer:
    """A perception: its `name` for opening, and `words` about it; `problem`: why it is not `ready` (else empty)."""

    name: str
    words: str
    views: tuple[str, ...]
    ready: bool = True
    problem: str = ""


def offers(given: str | None = None) -> list[Offer]:
    """The built-in ones, and the `given` one of the command line first."""
    found = [Offer(name, words, views, not (why := _missing(name)), why) for name, (words, views) in _BUILT_IN.items()]
    if given is None or given in _BUILT_IN:
        return sorted(found, key=lambda offer: offer.name != given)
    return [Offer(given, f"{short_name(given)}, given with --perception", (WALK, PICTURE)), *found]


def _missing(name: str) -> str:
    if name == "coco":
        from eagor.perception.coco import wanted

        if steps := wanted():
            return f"It is not here yet: {'; then '.join(steps)}; then reload the page."
    if name in ("scout", "truth"):
        lacking = [each for each in ("onnxruntime", "trimesh", "gymnasium") if find_spec(each) is None]
        if lacking:
            return f"It needs {' and '.join(lacking)}: {how_to_install('sim')}"
    return ""


WAITING = 32  # scenes, problems and words; older ones are dropped


class Slot:
    """Filled and emptied in the loop's thread. However slow its page is, it never grows."""

    def __init__(self) -> None:
        self._said: deque[Message] = deque(maxlen=WAITING)
        self._step: Message | None = None
        self._news = asyncio.Event()

    def put(self, message: Message) -> None:
        """A step replaces the one before it (`merged`); a new scene drops the steps of the old one."""
        if message.header["type"] == "step":
            self._step = merged(self._step, message)
        else:
            if message.header["type"] == "scene":
                self._step = None
            self._said.append(message)
        self._news.set()

    def clear(self) -> None:
        """Forget all: another view is opened."""
        self._said.clear()
        self._step = None
        self._news.clear()

    async def get(self) -> Message:
        """The next message, once there is one: words before steps."""
        while not self._said and self._step is None:  # cleared, perhaps, since it was woken
            await self._news.wait()
        if self._said:
            message = self._said.popleft()
        else:
            assert self._step is not None
            message, self._step = self._step, None
        if not self._said and self._step is None:
            self._news.clear()
        return message


@dataclass(eq=False)
class Channel:
    """The slots of those who watch, and what was said last."""

    slots: list[Slot] = field(default_factory=list)
    _said: dict[str, Message] = field(default_factory=dict)
    _step: Message | None = None

    def join(self, slot: Slot) -> None:
        """Watch from now on."""
        self.slots.append(slot)
        for message in self._said.values():
            slot.put(message)
        if self._step is not None:
            slot.put(self._step)

    def leave(self, slot: Slot) -> None:
        """Watch no more."""
        if slot in self.slots:
            self.slots.remove(slot)

    def put(self, message: Message) -> None:
        """Give a message to all."""
        if message.header["type"] == "step":
            self._step = merged(self._step, message)
        else:
            self._said[message.header["type"]] = message
            if message.header["type"] == "scene":
                self._step = None
                for kind in ("status", "problem"):  # what was said while it was being opened
                    self._said.pop(kind, None)
        for slot in self.slots:
            slot.put(message)


ENGINE = "eagor.studio.engine:serve"
RATE, BURST = 60.0, 120.0  # messages per second of a page, and at once


@dataclass(frozen=True)
class LiveSource:
    """A live source: its name, and the function ``(line, *arguments)`` of the process that watches it."""

    words: str
    serve: str
    arguments: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Settings:
    """What the command line says. `perception`: a further one; `seed`: the apartment to begin with (None: none)."""

    gate: Gate
    runs: Path = Path("runs")
    perception: str | None = None
    seed: int | None = SEED
    live: LiveSource | None = None


@dataclass(eq=False)
class Page:
    """A browser's page: its slot, and its session (0: none is open)."""

    slot: Slot = field(default_factory=Slot)
    session: int = 0
    view: str = ""  # of the session
    watches: bool = False  # the live source
    rubbish: int = 0
    allowance: float = BURST
    counted: float = field(default_factory=time.monotonic)

    def may_speak(self) -> bool:
        """Whether it keeps to the rate: a bucket of messages that fills with time."""
        now = time.monotonic()
        self.allowance = min(BURST, self.allowance + RATE * (now - self.counted))
        self.counted = now
        if self.allowance < 1:
            return False
        self.allowance -= 1
        return True


class Studio:
    """The server's state. Used in the loop's thread alone."""

    def __init__(self, settings: Settings) -> None:
        self.settings, self.ready = settings, False
        self.offers: list[Offer] = offers(settings.perception)
        self.pages: dict[int, Page] = {}  # by session
        self.uploads, self.library = Uploads(), Library(settings.runs)
        self.open = 0
        self._numbers, self._steps = itertools.count(1), itertools.count(1)
        self._engine: Backend | None = None
        self._live: Backend | None = None
        self._channel = Channel()

    def start(self) -> None:
        """Start the processes; from the loop's thread."""
        walks = [offer.name for offer in self.offers if offer.ready and "walk" in offer.views]
        names = tuple(walks) or ("colour",)
        seed = self.settings.seed if walks else None
        self._engine = Backend(ENGINE, (names, seed), self._heard, self._died)
        self.ready = seed is None
        if (live := self.settings.live) is not None:
            self._live = Backend(live.serve, live.arguments, self._seen, self._unseen)

    def close(self) -> None:
        """End the processes, remove the uploads."""
        for backend in (self._engine, self._live):
            if backend is not None:
                backend.close()
        self.library.close()
        self.uploads.close()

    def opening(self, message: dict[str, Any]) -> Opening:
        """What a page wants to open. Raises `PageError` for what there is not."""
        view, methods = message["view"], tuple(message["methods"])
        asked = Question(message["query"], self._usable(message["perception"], view), message["question"])
        if view == "picture":
            found = self.uploads.get(message["id"])
            if not asked.query:
                raise PageError("There is no query.", "Say what to look for, such as 'red chair'.")
            hfov = message["hfov"] or found.hfov_deg
            if found.ordinary and hfov is None:
                raise PageError("This picture does not tell how wide its camera sees.", "Give its field of view.")
            kind = "video" if found.kind == "video" else view
            return Opening(
                kind, asked, picture=found.path, name=found.name, frames=found.frames, methods=methods,
                hfov=math.radians(hfov) if found.ordinary and hfov else None,
            )  # fmt: skip
        seed = self._seed if message["seed"] is None else message["seed"]
        return Opening(view, asked, seed=seed, drive=message["drive"], methods=methods)

    @property
    def _seed(self) -> int:
        return SEED if self.settings.seed is None else self.settings.seed

    def _usable(self, name: str, view: str) -> str:
        """This perception, or the first one for a view if none is named. Raises `PageError` for what cannot be used."""
        offered = [offer for offer in self.offers if view in offer.views]
        usable = [offer.name for offer in offered if offer.ready]
        if name in usable or (not name and usable):
            return name or usable[0]
        raise self._unusable(name or offered[0].name, view)

    def _unusable(self, name: str, view: str) -> PageError:
        offer = next((offer for offer in self.offers if offer.name == name), None)
        if offer is None or view not in offer.views:
            there = ", ".join(each.name for each in self.offers if view in each.views)
            return PageError(f"There is no perception {name!r} for this view.", f"Choose one of {there}.", 404)
        return PageError(f"The perception {name!r} cannot be used here.", offer.problem, 503)

    def show(self, page: Page, message: dict[str, Any]) -> None:
        """Open a view on a page, in place of the one before. Raises `PageError`."""
        if message["view"] == "live":
            self._watch(page, message)
            return
        opening = self.opening(message)
        self.hide(page)
        page.slot.clear()
        page.session, page.view = next(self._numbers), message["view"]
        self.pages[page.session] = page
        assert self._engine is not None
        self._engine.tell(("open", page.session, opening))

    def _watch(self, page: Page, message: dict[str, Any]) -> None:
        if self._live is None:
            raise PageError("There is no live source.", "Start eagor studio with --source.", 404)
        self.hide(page)
        page.slot.clear()
        page.watches = True
        if message["hfov"] is not None:
            self._live.tell(("hfov", message["hfov"]))
        if message["query"]:
            self._live.tell(("query", message["query"], message["question"]))
        self._channel.join(page.slot)

    def tell(self, page: Page, message: dict[str, Any]) -> None:
        """Pass a message on to the page's session. Raises `PageError` if it has none."""
        if page.watches:
            self._direct(page, message)
            return
        if not page.session:
            raise PageError("No view is open.", "Open one first.")
        if message.get("perception"):
            self._usable(message["perception"], page.view)
        assert self._engine is not None
        self._engine.tell(("told", page.session, message))

    def _direct(self, page: Page, message: dict[str, Any]) -> None:
        """What a page says to the live source, which others watch, too."""
        assert self._live is not None
        if message["type"] == "query":
            self._live.tell(("query", message["text"], message["question"]))
        elif message["type"] == "pause":
            self._channel.leave(page.slot)
            if not message["on"]:
                self._channel.join(page.slot)

    def hide(self, page: Page) -> None:
        """Close the page's view, if it has one."""
        if page.watches:
            self._channel.leave(page.slot)
            page.watches = False
        if page.session:
            self.pages.pop(page.session, None)
            assert self._engine is not None
            self._engine.tell(("close", page.session))
            page.session = 0

    def _heard(self, said: tuple[int, Message]) -> None:
        number, message = said
        if number == 0:
            self.ready = True
            self.library.warm()  # now that nobody waits for the first apartment
        elif (page := self.pages.get(number)) is not None:
            page.slot.put(message)

    def _seen(self, message: Message) -> None:
        """What the live source says; a step with its number and the time."""
        if message.header["type"] == "step":
            told = {**message.header, "number": next(self._steps), "sent": time.time()}
            message = Message(told, message.blobs)
        self._channel.put(message)

    def _unseen(self) -> None:
        words = {"problem": "The process that watches the source has ended.", "change": "It is started anew; wait."}
        self._seen(Message({"type": "problem", **words, "fatal": False}))

    def _died(self) -> None:
        """The engine has died: every page is told to open its view again."""
        words = {"problem": "The process of all views has ended unexpectedly.", "change": "Open the view again."}
        for page in list(self.pages.values()):
            page.session = 0
            page.slot.put(Message({"type": "problem", **words, "fatal": True}))
        self.pages.clear()

    def state(self) -> dict[str, Any]:
        """What ``/api/state`` says."""
        walk = [offer for offer in self.offers if "walk" in offer.views]
        picture = [offer for offer in self.offers if "picture" in offer.views]
        views = [
            _view("walk", any(offer.ready for offer in walk), walk[0].problem),
            _view("run", True, ""),
            _view("picture", any(offer.ready for offer in picture), picture[0].problem),
            _view("live", self._live is not None, "Start eagor studio with --source to see a camera here."),
        ]
        return {
            "version": __version__,
            "ready": self.ready,
            "views": views,
            "perceptions": [vars(offer) | {"views": list(offer.views)} for offer in self.offers],
            "houses": {"first": 0, "last": 9999, "offered": [SEED, 3, 8, 12, 17, 602]},
            "default": {"seed": self._seed, "tour": SEED, "perception": walk[0].name},
            "limits": {"message_bytes": LONGEST, "upload_bytes": BYTES, "pixels": PIXELS},
            "source": None if self.settings.live is None else self.settings.live.words,
            "token": self.settings.gate.token is not None,
        }


def _view(name: str, usable: bool, problem: str) -> dict[str, Any]:
    return {"name": name, "usable": usable, "problem": "" if usable else problem}
