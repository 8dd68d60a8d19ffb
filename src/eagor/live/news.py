"""What to tell a person about faults: when one begins, changes and ends, and now and then while it lasts."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from eagor.live.answers import Fault

__all__ = ["AGAIN", "CALM", "News"]

CALM = 3.0  # seconds without a fault after which a part counts as well again
AGAIN = 30.0  # seconds after which a fault that lasts is told again


@dataclass
class _Bad:
    """A part with faults: when each was told last, when one was seen last, and how long it has to be without."""

    calm: float
    told: dict[str, float] = field(default_factory=dict)
    last: float = -math.inf


class News:
    """Turns the faults of answers, one after the other, into lines for a log.

    A fault is told when it begins, and while it lasts every `AGAIN` seconds, but not again while its part has faults
    every few seconds: words that differ in numbers alone are the same ("no picture for 2.1 s"). That a part is well
    again is told after `CALM` seconds; if it was well for less than `AGAIN` seconds before, after `AGAIN`, so that a
    part that comes and goes does not fill the log.
    """

    def __init__(self) -> None:
        self._bad: dict[str, _Bad] = {}
        self._well: dict[str, float] = {}  # when a part was said to be well

    def of(self, faults: Sequence[Fault], now: float) -> list[tuple[str, bool]]:
        """New lines at `now` (seconds, never going back), each with whether something is wrong."""
        lines = [(fault.text, True) for fault in faults if self.worth(fault, now)]
        for part in [part for part, bad in self._bad.items() if now - bad.last >= bad.calm]:
            del self._bad[part]
            self._well[part] = now
            lines.append((f"{part}: all is well again", False))
        return lines

    def worth(self, fault: Fault, now: float) -> bool:
        """Whether a fault that is there at `now` is worth a line."""
        if fault.part not in self._bad:
            soon = now - self._well.get(fault.part, -math.inf) < AGAIN
            self._bad[fault.part] = _Bad(AGAIN if soon else CALM)
        bad, words = self._bad[fault.part], re.sub(r"\d+(\.\d+)?", "#", fault.text)
        bad.last = now
        if now - bad.told.get(words, -math.inf) < AGAIN:
            return False
        bad.told[words] = now
        return True
