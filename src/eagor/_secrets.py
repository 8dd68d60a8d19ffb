"""What must not be written anywhere: keys and passwords that this process has been given.

Who reads a secret names it here; who lets text out (to a file, a report, a terminal) passes it through `redacted`. The
values themselves are known, so that little has to be guessed from the look of a text.
"""

from __future__ import annotations

import re

_SHORTEST = 6  # letters: what is shorter is part of ordinary words, and no secret
_GONE = "***"
_LOGIN = re.compile(r"(?<=://)[^/\s@\"']*:[^/\s@\"']*(?=@)")  # of an address, known as one or not
_secrets: set[str] = set()


def keep_out(*secrets: str) -> None:
    """Never let these out again; those that are too short to be secrets are passed over."""
    _secrets.update(secret for secret in secrets if len(secret) >= _SHORTEST)


def redacted(text: str) -> str:
    """`text` with stars in place of every secret, and of user and password in every address."""
    for secret in sorted(_secrets, key=len, reverse=True):  # the whole first, where one is part of another
        text = text.replace(secret, _GONE)
    return _LOGIN.sub(_GONE, text)
