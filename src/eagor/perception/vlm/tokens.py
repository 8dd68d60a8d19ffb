"""Which token of an answer a character came from, and how likely it was."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence

Token = tuple[str, float]  # a piece of the answer and the natural logarithm of its probability
_AHEAD = 64  # characters to search ahead to find the place again


class Trace:
    """The log probabilities of an answer's tokens by place in its text.

    Args:
        text: the answer.
        tokens: its pieces in order. Special tokens that the text lacks, and garbled pieces of characters that take
            several tokens, are skipped.
    """

    def __init__(self, text: str, tokens: Sequence[Token]) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []
        self._logs: list[float] = []
        place = 0
        for piece, log in tokens:
            at = place if piece and text.startswith(piece, place) else -1
            if at < 0 and len(piece.strip()) > 1:
                at = text.find(piece, place, place + _AHEAD)
            if at >= 0:
                place = at + len(piece)
                self._starts.append(at)
                self._ends.append(place)
                self._logs.append(min(float(log), 0.0))

    def log_probability(self, start: int, stop: int) -> float:
        """Of all tokens together that have a character in [`start`, `stop`); 0 where none is known."""
        first, last = bisect_right(self._ends, start), bisect_left(self._starts, stop)
        return sum(self._logs[first:last])
