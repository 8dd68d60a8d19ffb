"""Which paths are ROS 2 bags, and their topics in words; nothing is read here (`eagor.media.bags.reader`)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

__all__ = ["SUFFIXES", "is_bag", "listed", "split_bag"]

SUFFIXES = (".mcap", ".db3")
ROS_1 = ".bag"


def is_bag(path: str | os.PathLike[str]) -> bool:
    """Whether `path` looks like a bag: a file by its name, a folder by what is in it."""
    path = Path(path)
    try:
        if path.is_dir():
            return (path / "metadata.yaml").is_file() or any(file.suffix in SUFFIXES for file in path.iterdir())
        return path.suffix.lower() in (*SUFFIXES, ROS_1)
    except OSError:
        return False


def split_bag(text: str) -> tuple[str, str | None]:
    """Path and topic of ``BAG`` or ``BAG?topic=/image``."""
    place, found, topic = text.partition("?topic=")
    return (place, topic) if found and not os.path.exists(text) else (text, None)


def listed(topics: Mapping[str, str]) -> str:
    """Topics and their types in words."""
    return ", ".join(f"{name} ({kind})" for name, kind in topics.items()) or "none"
