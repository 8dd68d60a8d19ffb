"""A bound on programs that others wrote, such as chat templates: so many lines of Python, whatever they do."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


class Endless(Exception):
    """A program took more steps than it may."""


@contextmanager
def limited_steps(most: int) -> Iterator[None]:
    """Raise `Endless` in what runs inside, in this thread, once it has taken more than `most` lines of Python.

    The interpreter's tracing counts them; a debugger that traces waits meanwhile.
    """
    left = most

    def step(frame: FrameType, event: str, argument: Any) -> Any:
        nonlocal left
        left -= event == "line"
        if left < 0:
            raise Endless(f"more than {most} lines were run")
        return step

    before = sys.gettrace()
    sys.settrace(step)
    try:
        yield
    finally:
        sys.settrace(before)
