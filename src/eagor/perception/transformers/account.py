"""What a look cost, for `Evidence.source`."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path


@dataclass
class Account:
    """Images, image tokens, and tokens of questions and answers that went through a model, added up."""

    images: int = 0
    image_tokens: int = 0
    prompt_tokens: int = 0
    answer_tokens: int = 0

    def as_source(self) -> dict[str, int]:
        """As it stands in `Evidence.source`."""
        return dict(vars(self))


def revision_of(name: str, commit: str | None) -> str:
    """The commit of a hub checkpoint; for a folder a digest of its configuration and of its weight files' sizes."""
    if commit:
        return str(commit)
    folder = Path(name)
    if not (folder / "config.json").is_file():
        return "unknown"
    digest = hashlib.sha256((folder / "config.json").read_bytes())
    for file in sorted(folder.glob("*.safetensors")):
        digest.update(f"{file.name} {file.stat().st_size}".encode())
    return f"folder:{digest.hexdigest()[:12]}"
