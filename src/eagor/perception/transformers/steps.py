"""Limits untrusted programs, such as chat templates, to a number of lines of Python."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


class Endless(Exception):
    """A program exceeded its number of steps."""


@contextmanager
def limited_steps(most: int) -> Iterator[None]:
    """Raise `Endless` in the code inside (this thread) after `most` lines of Python. Suspends a debugger."""
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
