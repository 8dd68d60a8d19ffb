"""What to tell a person about faults: each once, also where one comes and goes."""

from __future__ import annotations

import re
from collections.abc import Sequence

from eagor.robots.live.answers import Fault

__all__ = ["CALM", "News"]

CALM = 3.0  # seconds without a fault after which a part counts as well again


class News:
    """Turns the faults of answers, one after the other, into lines for a log.

    A fault is told when it begins, and not again while its part has faults every few seconds: words that differ in
    numbers alone are the same ("no picture for 2.1 s"). That a part is well again is told after `CALM` seconds.
    """

    def __init__(self) -> None:
        self._told: dict[str, set[str]] = {}
        self._last: dict[str, float] = {}

    def of(self, faults: Sequence[Fault], now: float) -> list[tuple[str, bool]]:
        """New lines at `now` (seconds, as the answers' stamps), each with whether something is wrong."""
        lines: list[tuple[str, bool]] = []
        for fault in faults:
            self._last[fault.part] = now
            told, words = self._told.setdefault(fault.part, set()), re.sub(r"\d+(\.\d+)?", "#", fault.text)
            if words not in told:
                told.add(words)
                lines.append((fault.text, True))
        for part in [part for part, last in self._last.items() if now - last >= CALM]:
            del self._last[part], self._told[part]
            lines.append((f"{part}: all is well again", False))
        return lines
