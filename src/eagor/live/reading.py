"""A thread that reads a source, and opens it again when it is gone."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, Generic, TypeVar

from eagor.errors import EagorError

__all__ = ["Reader", "opener"]

REOPENED = (0.5, 10.0)  # seconds before a source that is gone is opened again: at first, and at most; doubled each time

Item = TypeVar("Item")


def opener(source: Any) -> tuple[Callable[[], Any] | None, Any]:
    """The function that opens a source, and the source itself, as far as each of them is given."""
    return (None, source) if hasattr(source, "close") else (source, None)


class Reader(Generic[Item]):
    """Reads `source` in a thread of its own, item by item, until `close`.

    `open`: opens it again; None: the same object is read again. `items`: what to read of it. `again`: whether it is
    read again when it ends; otherwise it is a recording. These are called in the thread: `give` with each item;
    `trouble` with what is wrong, in words, and "" once it works again; `ended` at the end of a recording, with what
    went wrong or "". Anything may be raised by a source. What it raises is said, and it is opened again.
    """

    def __init__(
        self,
        name: str,
        source: Any,
        open: Callable[[], Any] | None,
        *,
        items: Callable[[Any], Iterable[Item]],
        again: bool,
        give: Callable[[Item], Any],
        trouble: Callable[[str], Any],
        ended: Callable[[str], Any],
    ) -> None:
        self.name, self._open = name, open
        self._source: Any = source
        self._items, self._again = items, again
        self._give, self._trouble, self._ended = give, trouble, ended
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._read, name=f"eagor {name}", daemon=True)

    @property
    def source(self) -> Any:
        """What is read now; None while it is gone."""
        return self._source

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def interrupt(self) -> None:
        """Close the source if it can be opened again, so that its thread comes back and does so."""
        if self._open is not None and self._source is not None:
            with suppress(Exception):
                self._source.close()

    def close(self, patience: float) -> None:
        """Close the source, and wait so many seconds for the thread to come back from it."""
        self._stopped.set()
        if self._source is not None:
            with suppress(Exception):
                self._source.close()
        if self._thread.is_alive():
            self._thread.join(patience)

    def _read(self) -> None:
        pause, bad = REOPENED[0], False
        while not self._stopped.is_set():
            text = ""
            try:
                if self._source is None:
                    assert self._open is not None
                    self._source = self._open()
                for item in self._items(self._source):
                    if self._stopped.is_set():
                        return
                    if bad:
                        self._trouble("")
                    pause, bad = REOPENED[0], False
                    self._give(item)
            except (EagorError, OSError) as error:
                text = str(error)
            except Exception as error:
                text = f"{type(error).__name__}: {error}"
            if self._stopped.is_set():
                return
            if not self._again:
                self._ended(text)
                return
            bad = True
            self._trouble(f"{text or f'the {self.name} ended'}; opened again")
            if self._open is not None:
                gone: Any = self._source
                self._source = None
                with suppress(Exception):
                    gone.close()
            self._stopped.wait(pause)
            pause = min(2 * pause, REOPENED[1])
