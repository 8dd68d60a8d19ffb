"""``eagor robot``: one command of it."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eagor.cli.robot_options import Robot


def robot(options: Robot) -> int:
    """Run the command; returns its exit code."""
    module, _, function = options.action.runs.partition(":")
    return getattr(import_module(module), function)(options.action)
