"""What a message on ``~/query`` means."""

from __future__ import annotations

import re
from collections.abc import Sequence

__all__ = ["after"]

MOST = 16  # queries at a time


def after(now: Sequence[str], text: str) -> tuple[str, ...]:
    """The queries that are followed after a message.

    "red chair" replaces all by one; "red chair; blue ball" by two. "+blue ball" is followed as well, "-blue ball" no
    longer. An empty text ends them all. At most `MOST` are followed; further ones are left out.
    """
    found, fresh = list(now), False
    for part in (part.strip() for part in re.split(r"[;\n]", text)):
        word = part.lstrip("+-").strip()
        if not re.search(r"\w", word):
            continue
        if part.startswith("-"):
            found = [each for each in found if each != word]
            fresh = True
            continue
        if not part.startswith("+") and not fresh:
            found, fresh = [], True
        if word not in found:
            found.append(word)
    if not text.strip():
        return ()
    return tuple(found[:MOST])
