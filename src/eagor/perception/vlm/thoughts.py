"""What a model thought, and what it answers: the marks between them, and headings."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

__all__ = ["CHANGED", "TABLES", "any_of", "without_thoughts"]

TABLES = json.loads(Path(__file__).with_name("answers.json").read_text(encoding="utf-8"))


def any_of(*ways: str, flags: int = re.IGNORECASE) -> re.Pattern[str]:
    """One pattern for all of `ways`."""
    return re.compile("|".join(ways), flags)


# Marks of thoughts; some chat templates open them themselves, so that the answer only closes them.
_THOUGHT = any_of(
    r"(?:<|&lt;|◁|\[)\s*\|?(?P<end>/|end_(?:of_)?)?(?:start_|begin_(?:of_)?)?\|?(?:\w+[:_])?"
    rf"(?P<name>{TABLES['thoughts']['names']})(?:\s[^<>]{{0,80}})?\s*\|?(?:>|&gt;|▷|\])",
    rf"(?P<opens>{TABLES['thoughts']['open']})",
    rf"(?P<closes>{TABLES['thoughts']['close']})",
)
# Marks of the answer, and headings before it: what is outside leads to it.
_ANSWER = any_of(
    rf"<\|?(?:start_|begin_of_)?({TABLES['answers']['names']})\|?>(.*?)(?:<(?:/|\|end_(?:of_)?)\1\|?>|\Z)",
    *TABLES["answers"]["pairs"],
    flags=re.DOTALL | re.IGNORECASE,
)
_HEADING = any_of(
    rf"^[ \t#>*_-]*(?:(?P<last>{TABLES['headings']['last']})|{TABLES['headings']['first']})[*_\s]*[:：]",
    flags=re.IGNORECASE | re.MULTILINE,
)
CHANGED = any_of(
    r"\b(?:wait|actually|correction|on second thought|let me (?:correct|re\w+)|i meant|or rather)\b|\? no\b"
)


def without_thoughts(text: str) -> str:
    """`text` with all thoughts blanked out, and all outside of the marks of an answer; the rest keeps its places."""
    spans, place, opened = [], 0, list[str]()
    for mark in _THOUGHT.finditer(text):
        name = (mark["name"] or "").lower()
        if mark["end"] or mark["closes"]:  # what came before was thought, opened or not (of the usual marks)
            if name in opened or not name or name[:5] in ("think", "thoug", "reaso"):
                place = mark.end()
                del opened[opened.index(name) if name in opened else 0 :]
        else:
            if not opened:
                spans.append((place, mark.start()))
            opened.append(name)
    bare = only(text, spans if opened else [*spans, (place, len(text))])
    marked = [answer.span(answer.lastindex or 0) for answer in _ANSWER.finditer(bare)]
    changed = any(CHANGED.search(bare, one[1], other[0]) for one, other in pairwise(marked))
    if not changed and any(bare[start:end].strip() for start, end in marked):
        bare = only(bare, marked)
    headings = [*_HEADING.finditer(bare)]
    heading = next((each for each in reversed(headings) if each["last"]), headings[0] if headings else None)
    return only(bare, [(heading.end(), len(bare))]) if heading and bare[heading.end() :].strip() else bare


def only(text: str, spans: Sequence[tuple[int, int]]) -> str:
    """`text` with blanks outside of `spans`, which are in order."""
    parts, place = [], 0
    for start, end in spans:
        parts += [" " * (start - place), text[start:end]]
        place = end
    return "".join(parts) + " " * (len(text) - place)
