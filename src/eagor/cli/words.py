"""Answers in words; they live in `eagor.drawing.words`, since pictures and pages say the same."""

from eagor.drawing.words import STATUS, answer_in_words, in_words, signed

__all__ = ["STATUS", "answer_in_words", "in_words", "signed"]
