"""The packages of the extras, the command that installs them, and the error if one is missing."""

from __future__ import annotations

import json
import re
import shlex
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from eagor.errors import MissingExtraError


@lru_cache(maxsize=1)
def extras() -> dict[str, dict[str, str]]:
    """Of each extra its packages and their oldest versions, from our metadata; empty where these are not installed.

    Not the packages that only some platforms get.
    """
    found: dict[str, dict[str, str]] = {}
    with suppress(PackageNotFoundError):
        for line in distribution("eagor").requires or ():
            if part := re.fullmatch(r"""([\w-]+)[^;]*>=([\d.]+)[^;]*; extra == ['"](\w+)['"]""", line):
                found.setdefault(part[3], {})[part[1]] = part[2]
    return found


def how_to_install(extra: str) -> str:
    """The command that installs an extra. The package is on no registry, so it names the clone, or the wheel."""
    try:  # where pip installed this package from, and whether as editable (PEP 610)
        told = json.loads(distribution("eagor").read_text("direct_url.json") or "{}")
        url, editable = urlsplit(told["url"]), "-e " if told.get("dir_info", {}).get("editable") else ""
        source = Path(unquote(url.path))
        if url.scheme == "file" and source.exists():
            return f"pip install {editable}{shlex.quote(f'{source}[{extra}]')}"
    except (PackageNotFoundError, OSError, ValueError, KeyError, TypeError, AttributeError):
        pass  # from elsewhere, or no metadata
    return f"pip install 'FILE[{extra}]', FILE being the wheel or the clone of eagor that you installed"


def require_extra(what: str, extra: str, *packages: str) -> None:
    """Raise `MissingExtraError` unless all `packages`, which `what` needs and `extra` brings, are installed."""
    if lacking := [name for name in packages if find_spec(name) is None]:
        raise MissingExtraError(f"{what} needs {' and '.join(lacking)}: {how_to_install(extra)}")


@lru_cache(maxsize=1)
def opencv() -> Any:
    """The module cv2, or None where it is not installed."""
    try:
        import cv2
    except ImportError:
        return None
    return cv2


def is_older(version: str, least: str) -> bool:
    """Whether a version such as ``"2.13.0+cpu"`` comes before another; its first three numbers count."""
    first, second = (
        [int(re.sub(r"\D", "", part) or 0) for part in each.split("+")[0].split(".")[:3]] for each in (version, least)
    )
    return first < second
