"""Yes or no: the probability that a thing is in the picture, from an answer and, if available, its tokens."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from eagor.errors import AnswerError
from eagor.perception.vlm.boxes import shortened, spoken
from eagor.perception.vlm.tokens import Token

_YES, _NO = ("yes", "true", "present", "visible"), ("no", "false", "none", "not", "absent")
_WORDS = re.compile(r"[^\W\d_]+")


def parse_presence(text: str, first: Sequence[Token] | None = None) -> float:
    """The probability in [0, 1] that a model's answer to `prompts.ask_presence` means yes.

    `first` holds the likeliest tokens at the place of the answer, with log probabilities. The result is then the share
    of yes among yes and no; if only one side is listed, the other gets the rest of the probability. Without `first` it
    is 1 for yes and 0 for no. Raises `AnswerError` if the answer is neither.
    """
    answer = spoken(text)
    shares, listed = [0.0, 0.0], 0.0
    for piece, log in first or ():
        probability, meant = math.exp(min(float(log), 0.0)), means(piece)
        listed += probability
        if meant is not None:
            shares[meant] += probability
    if sum(shares) > 0:
        if min(shares) == 0:
            shares[shares.index(0.0)] = max(0.0, 1 - listed)
        return shares[1] / sum(shares)
    for word in _WORDS.findall(answer.lower()):
        meant = means(word)
        if meant is not None:
            return float(meant)
    raise AnswerError(f"the model answered {shortened(text)}; wanted yes or no. Can it see images?")


def means(word: str) -> bool | None:
    """True for yes, False for no, None for neither."""
    bare = "".join(_WORDS.findall(word.lower()))
    return True if bare in _YES else False if bare in _NO else None
