"""``eagor --tyro-print-completion SHELL``: the script with which a shell completes commands, options and files."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout, suppress

from eagor.cli.terminal import UsageError

OPTION = "--tyro-print-completion"
# tyro completes a file after an option, but not in place of a positional argument. Bash and fish can offer files there
# if nothing else fits.
_FILES_TOO = {
    "bash": ("complete -F ", "complete -o default -F "),
    "zsh": ("", ""),
    "fish": ("complete --no-files ", "complete "),
}


def script(arguments: Sequence[str], parse: Callable[[list[str]], object]) -> str:
    """The script for the shell that `arguments` name, which `parse` (with tyro) prints. Raises `UsageError`."""
    if len(arguments) != 2 or arguments[1] not in _FILES_TOO:
        raise UsageError(f"{OPTION} needs a shell: bash, zsh or fish")
    printed = io.StringIO()
    with redirect_stdout(printed), suppress(SystemExit):
        parse(list(arguments))
    old, new = _FILES_TOO[arguments[1]]
    return printed.getvalue().replace(old, new) if old else printed.getvalue()
