"""A hook of MkDocs: links that leave `docs/` work on the site as they do in the repository.

A page may link to any file of the repository ("../training/scout/README.md", "../benchmarks/core.py"). What is linked
to is copied into the site under its path from the repository's root, Markdown as a page, anything else as it is.
"""

from __future__ import annotations

import os
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

LINK = re.compile(r"(\]\()((?:\.\./)+[^)#\s]+)")


def _outside(page: str, link: str) -> str | None:
    """The path from the repository's root that `link` on the page docs/`page` leads to, None if it stays in docs/."""
    target = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), link))
    return None if target.startswith(("docs/", "..")) else target


def on_files(files: Files, config: Any) -> Files:
    """Add what pages link to outside of docs/, and what these link to in turn."""
    root = Path(config["config_file_path"]).parent
    waiting = [(file.src_uri, Path(str(file.abs_src_path))) for file in files.documentation_pages()]
    while waiting:
        page, source = waiting.pop()
        for _, link in LINK.findall(source.read_text(encoding="utf-8")):
            target = _outside(page, link)
            if target is None or files.get_file_from_path(target) or not (root / target).is_file():
                continue  # a link that leads nowhere is left as it is, and MkDocs warns of it
            added = File.generated(config, target, abs_src_path=os.fspath(root / target))
            files.append(added)
            if added.is_documentation_page():
                waiting.append((target, root / target))
    return files


def on_page_markdown(markdown: str, page: Any, files: Files, **_: Any) -> str:
    """Let the links of a page lead to the copies."""
    where = page.file.src_uri

    def moved(found: re.Match[str]) -> str:
        target = _outside(where, found[2])
        if target is None or not files.get_file_from_path(target):
            return found[0]
        return found[1] + posixpath.relpath(target, posixpath.dirname(where) or ".")

    return LINK.sub(moved, markdown)
