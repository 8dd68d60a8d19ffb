"""Keeps keys and passwords of this process out of everything that it writes.

Code that reads a secret passes it to `keep_out`. Code that writes text to a file, a report or a terminal passes the
text through `redacted`.
"""

from __future__ import annotations

import re

_SHORTEST = 6  # letters: shorter ones occur in ordinary words
_GONE = "***"
_LOGIN = re.compile(r"(?<=://)[^/\s@\"']*:[^/\s@\"']*(?=@)")  # user and password in an address
_secrets: set[str] = set()


def keep_out(*secrets: str) -> None:
    """Remember `secrets`, so that `redacted` hides them; very short ones are ignored."""
    _secrets.update(secret for secret in secrets if len(secret) >= _SHORTEST)


def redacted(text: str) -> str:
    """`text` with stars in place of every secret, and of user and password in every address."""
    for secret in sorted(_secrets, key=len, reverse=True):  # longest first: one may be part of another
        text = text.replace(secret, _GONE)
    return _LOGIN.sub(_GONE, text)
