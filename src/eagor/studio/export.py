"""One episode as a page that needs no server: all of it in one file, which opens from disk and sends no request."""

from __future__ import annotations

import base64
import json
from importlib.resources import files
from pathlib import Path

from eagor._files import written
from eagor.errors import EagorError
from eagor.studio.replays import Advance, Redrawn
from eagor.studio.runs import again
from eagor.studio.wire import rounded

__all__ = ["built", "export", "page_of", "write"]

TEMPLATE = "export.html"  # the built page, with a place for the episode
PLACE = '<script type="application/json" id="episode"></script>'


def built() -> bool:
    """Whether the page has been built here; it is in every wheel."""
    return _template().is_file()


def _template() -> Path:
    return Path(str(files("eagor.studio") / "static" / TEMPLATE))


def export(
    folder: Path,
    path: Path,
    episode: str | None = None,
    methods: tuple[str, ...] = (),
    advance: Advance = lambda _: None,
) -> Redrawn:
    """Write an episode of the run in `folder` (None: the worst one) to `path`; returns it.

    `methods`: those that are shown beside the one with the belief (none: all). A recording of ``eagor live`` and the
    report of ``eagor robot run`` are one episode each. Raises `EagorError` for an unknown episode or method, or if the
    page has not been built, `StorageError`.
    """
    check_built()
    found = again(Path(folder), episode, advance)
    if methods:
        only(found, methods)
    write(found, path)
    return found


def write(found: Redrawn, path: Path) -> None:
    """Write an episode to `path`. Raises `EagorError` if the page has not been built, `StorageError`."""
    written(path, page_of(found))


def check_built() -> None:
    """Raise `EagorError` if there is no page to put an episode into."""
    if not built():
        raise EagorError("the studio's page has not been built in this clone: run make page there (it needs Node)")


def only(found: Redrawn, methods: tuple[str, ...]) -> None:
    """Leave out the methods that are not asked for. Raises `EagorError` for one that the episode does not have."""
    there = [each["name"] for each in found.scene["methods"]]
    if unknown := [name for name in methods if name not in there]:
        raise EagorError(f"the episode has no method {unknown[0]!r}; it has {', '.join(there)}")
    kept = {*methods, found.scene["method"]}
    found.scene["methods"] = [each for each in found.scene["methods"] if each["name"] in kept]
    found.scene["paths"] = {name: path for name, path in found.scene["paths"].items() if name in kept}
    for step in found.steps:
        for part in ("methods", "rivals"):
            step[part] = {name: each for name, each in step.get(part, {}).items() if name in kept}


def page_of(found: Redrawn) -> str:
    """The whole page as text, with the episode's pictures as data URLs."""
    template = _template().read_text(encoding="utf-8")
    if template.count(PLACE) != 1:
        raise EagorError(f"{TEMPLATE} of the studio has no place for an episode: build the page anew (make page)")
    episode = found.as_json(lambda number: _as_address(found.pictures[number]))
    text = json.dumps(rounded(episode, 6), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    # Text from outside (queries, names) must not end the script, nor begin a comment in it.
    text = text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
    return template.replace(PLACE, PLACE.replace("></", f">{text}</"))


def _as_address(picture: bytes) -> str:
    return f"data:image/jpeg;base64,{base64.b64encode(picture).decode('ascii')}"
