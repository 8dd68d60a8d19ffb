"""Output of commands: results to stdout, everything else to stderr, progress only on a terminal."""

from __future__ import annotations

import json
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from eagor._files import redacted
from eagor.errors import EagorError

OK, FAILED, USAGE, INCOMPLETE = 0, 1, 2, 3


# What steers a terminal, or writes from right to left: of words from elsewhere, none of it may reach one.
_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")


class UsageError(EagorError):
    """Wrong usage (exit code 2, as for every `EagorError` about input)."""


class RunError(EagorError):
    """The input was valid, but the run failed (exit code 1)."""


def plain(text: str) -> str:
    """`text` without secrets, and with a mark in place of each control character but tabs and ends of lines."""
    return _STEERING.sub("\N{REPLACEMENT CHARACTER}", redacted(text))


def say(*lines: str) -> None:
    """Print lines on stdout, with words that others have written in them."""
    print(*map(plain, lines), sep="\n", flush=True)


def log(text: str) -> None:
    """Print one line on stderr."""
    print(plain(f"eagor: {text}"), file=sys.stderr, flush=True)


def warning(text: str) -> None:
    """Print a warning on stderr; the run continues."""
    log(f"warning: {text}")


def error(*lines: str) -> None:
    """Print an error on stderr; each text stays on a line of its own."""
    for number, line in enumerate(lines):
        print(plain(f"{'' if number else 'eagor: error:'} {' '.join(line.split())}"), file=sys.stderr, flush=True)


def emit(result: dict[str, Any]) -> None:
    """Print the one JSON object on stdout."""
    text = redacted(json.dumps(result, allow_nan=False, ensure_ascii=False))
    print(_STEERING.sub(lambda found: f"\\u{ord(found[0]):04x}", text), flush=True)


def give(as_json: bool, found: dict[str, Any], *lines: str) -> int:
    """Print a command's result on stdout, as the one JSON object or in words; returns `OK`."""
    if as_json:
        emit(found)
    else:
        say(*lines)
    return OK


def many(count: int, what: str) -> str:
    """So many of something: "1 look", "3 looks"."""
    return f"{count} {what}{'s' * (count != 1)}"


def facts(pairs: Mapping[str, Any], indent: int = 0) -> list[str]:
    """Lines with names and what was found, and what consists of parts below its name, indented."""
    flat = {name: _words(value) for name, value in pairs.items() if not (isinstance(value, Mapping) and value)}
    wide, lines = max(map(len, flat), default=0), list[str]()
    for name, value in pairs.items():
        lines.append(" " * indent + (f"{name:{wide}}  {flat[name]}" if name in flat else name))
        lines += facts(value, indent + 2) if name not in flat else []
    return lines


def _words(value: Any) -> str:
    """Text as it is, a list with commas, what is empty as "none", anything else as JSON."""
    if isinstance(value, str):
        return value
    if isinstance(value, list | tuple) or value == {}:
        return ", ".join(map(_words, value)) or "none"
    return json.dumps(value, ensure_ascii=False)


@contextmanager
def _handled(handlers: Mapping[int, Any]) -> Iterator[None]:
    """Handle signals so; not outside of the main thread, which alone may."""
    before = {}
    try:
        with suppress(ValueError):
            for number, handler in handlers.items():
                before[number] = signal.signal(number, handler)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def heeding_sigterm() -> Iterator[list[int]]:
    """Turn SIGTERM into KeyboardInterrupt, so that it is handled like Ctrl-C; the yielded list gets its number.

    Only the first one counts: later ones must not stop the cleanup.
    """
    told: list[int] = []

    def stop(number: int, _: Any) -> None:
        if not told:
            told.append(number)
            raise KeyboardInterrupt

    with _handled({signal.SIGTERM: stop}):
        yield told


@contextmanager
def unhurried(ending: Callable[[], bool]) -> Iterator[None]:
    """Heed one Ctrl-C or SIGTERM, and none once `ending()`: a second one must not stop the cleanup after the first."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    before: dict[int, Any] = {number: handler for number, handler in handlers.items() if callable(handler)}
    heeded: list[int] = []

    def heed(number: int, frame: FrameType | None) -> None:
        if not heeded and not ending():
            heeded.append(number)
            before[number](number, frame)

    with _handled(dict.fromkeys(before, heed)):
        yield


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print the package's own warnings (an image that is not 2:1, ...) as lines on stderr, each text once."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.filterwarnings("once", category=UserWarning, module=r"eagor(\.|$)")

        def show(message: Warning | str, *_: Any, **__: Any) -> None:
            warning(str(message))

        warnings.showwarning = show
        yield


@contextmanager
def progress(what: str, total: int | None, shown: bool = True) -> Iterator[Callable[[], None]]:
    """A progress bar on stderr; call the yielded function to advance it. Silent unless `shown` and on a terminal.

    `total`: how often it will be called; None if nobody knows. Results go on to stdout, where that is a file or a pipe.
    """
    if not (shown and sys.stderr.isatty()):
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # Lines for the same terminal have to go above the bar; rich would send those for a file there, too.
    above = sys.stdout.isatty()
    with Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=above) as bar:
        task = bar.add_task(what, total=total)
        yield lambda: bar.advance(task)
