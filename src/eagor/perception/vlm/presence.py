"""Yes or no: the probability that a thing is in the picture, from an answer and, where given, its tokens."""

from __future__ import annotations

from collections.abc import Sequence

from eagor.perception.vlm.boxes import Token


def parse_presence(text: str, first: Sequence[Token] | None = None) -> float:
    """The probability of yes; `first` holds the likeliest first tokens with their log probabilities.

    Raises `AnswerError` if the answer is neither.
    """
    raise NotImplementedError
