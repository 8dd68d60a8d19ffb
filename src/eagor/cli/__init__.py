"""The command line: each command is a dataclass of options, and a function of its name (`bench_run` of `BenchRun`).

Exit codes:

- 0: success.
- 1: the input was valid, but the run failed (nothing could be looked at, a server did not answer, a model's answer
  could not be read, a result could not be written, a bug).
- 2: usage: an option, a query or an input file is wrong, or no picture of the footage can be read. Nothing was
  computed.
- 3: finished, but some frames or episodes could not be run; the output has the others.
- 130: interrupted (Ctrl-C). 143: terminated (SIGTERM). Records are kept, and no process is left running.
- 141: the reader of the output closed it (``eagor track ... | head``).

Results go to stdout (with ``--json`` exactly one object), everything else to stderr. An error is one line; ``--debug``
or EAGOR_DEBUG adds its traceback.
"""

from __future__ import annotations

import io
import os
import re
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from importlib import import_module
from typing import Annotated, Any, Union

# Our matrices are small: threads in the matrix library cost far more than they gain (several times the time of the demo
# on shared cores). The library reads this when NumPy is first imported; a value that is set already counts.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if sys.stdout is None or sys.stderr is None:  # closed by who started us; the next file would take their place
    sys.stdout, sys.stderr = (stream or open(os.devnull, "w") for stream in (sys.stdout, sys.stderr))  # noqa: SIM115

if not sys.stderr.isatty():  # read by transformers: no progress bars without a terminal
    os.environ.setdefault("HF_HUB_DISABLE_PROGRESS_BARS", "1")

from eagor._version import __version__
from eagor.cli import terminal
from eagor.cli.checks import check_numbers
from eagor.errors import AnswerError, EagorError, ServerError, StorageError, WorkError
from eagor.plugins import readable_lists

__all__ = ["main"]

DESCRIPTION = """Track the direction of an object with a 360-degree camera, with its uncertainty.

Azimuth is positive to the LEFT, elevation positive up, both in degrees. The centre of a panorama is forward.

Exit codes: 0 success, 1 the run failed, 2 usage or input, 3 finished but some could not be run,
130 interrupted (Ctrl-C), 143 terminated (SIGTERM).
`eagor --version` prints the version, `eagor --tyro-print-completion bash` (zsh, fish) a completion script."""

_NO_FAULT_OF_THE_INPUT = (terminal.RunError, ServerError, AnswerError, StorageError, WorkError)
COMPLETION, ROS_ARGS = "--tyro-print-completion", "--ros-args"
COMMANDS = (
    "locate", "look", "track", "live", "ros", "robot", "demo", "studio", "bench", "export", "calibrate", "camera",
    "models", "doctor",
)  # fmt: skip
SHELLS = ("bash", "zsh", "fish")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command in `argv` (default: the process's own) and return its exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in arguments or bool(os.environ.get("EAGOR_DEBUG"))
    with suppress(AttributeError):  # file names and queries may contain bytes that are not text
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    ended: list[int] = []
    try:
        with terminal.heeding_sigterm() as ended, terminal.warnings_as_lines(), readable_lists():
            code = _run(arguments)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        terminal.log("terminated" if ended else "interrupted")
        return 143 if ended else 130
    except BrokenPipeError:
        # The reader is gone, which is no failure of the run. The rest of the buffer must not be written at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except Exception as error:
        if debug:
            import traceback

            print(terminal.plain(traceback.format_exc()), file=sys.stderr)
        known = isinstance(error, EagorError | OSError)
        unknown = f"{type(error).__name__}: {error} (a bug; --debug shows where)"
        terminal.error(*(getattr(error, "lines", [str(error)]) if known else [unknown]))
        return 2 if isinstance(error, EagorError) and not isinstance(error, _NO_FAULT_OF_THE_INPUT) else 1


def _run(arguments: list[str]) -> int:
    if arguments in (["--version"], ["-V"]):
        print(f"eagor {__version__}")
        return 0
    if arguments[:1] == [COMPLETION]:
        if len(arguments) != 2 or arguments[1] not in SHELLS:
            raise terminal.UsageError(f"{COMPLETION} needs a shell: {', '.join(SHELLS)}")
        with redirect_stdout(io.StringIO()) as script, suppress(SystemExit):
            _parse(arguments)
        # In bash, files are completed everywhere, not after options alone.
        print(script.getvalue().replace("complete -F", "complete -o default -F"), end="")
        return 0
    try:
        command = _parse(arguments)
    except SystemExit:  # tyro has printed help
        return 0
    command = getattr(command, "action", command)  # `bench run` is an action of `bench`
    check_numbers(command)
    kind = type(command)
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", kind.__name__).lower()
    return getattr(sys.modules[kind.__module__], name)(command)


def _parse(arguments: list[str]) -> Any:
    """The command with its options. Raises `UsageError`, or `SystemExit` after help.

    What follows ``--ros-args`` is left as it is.
    """
    import tyro

    end = next((at for at, word in enumerate(arguments) if word in ("--", ROS_ARGS)), len(arguments))
    counts = Counter(word.partition("=")[0] for word in arguments[:end] if word.startswith("--"))
    if twice := [name for name in counts if counts[name] > 1 and name not in ("--json", "--debug")]:
        raise terminal.UsageError(f"{twice[0]} comes twice, and only the last would count; write all after one")
    if arguments[end:][:1] == [ROS_ARGS]:
        arguments = [*arguments[:end], "--", *arguments[end:]]
    modules = {name: import_module(f"eagor.cli.{'models' if name == 'doctor' else name}") for name in COMMANDS}
    kinds = (Annotated[getattr(m, n.capitalize()), tyro.conf.subcommand(n)] for n, m in modules.items())
    said = io.StringIO()
    try:
        with redirect_stderr(said):
            return tyro.cli(
                Union[tuple(kinds)],  # type: ignore[arg-type]  # noqa: UP007
                prog="eagor",
                description=DESCRIPTION,
                args=arguments,
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitSubcommandPrefixes),
            )
    except SystemExit as stop:
        if stop.code:
            raise terminal.UsageError(_suggest_option(said.getvalue())) from None
        print(said.getvalue(), end="", file=sys.stderr)
        raise


def _suggest_option(box: str) -> str:
    """What tyro says in a box, as a line: what is wrong, and the nearest option that there is."""
    lines = [line.strip("\u2502| ") for line in box.splitlines()]
    rule = "-+\u2500\u256d\u256e\u2570\u256f"  # the box; its first line has a title
    parts = " ".join("\n" if line.lstrip(rule) == "" or line[-1] in rule else line for line in lines).split("\n")
    told = [part.strip() for part in parts if part.strip()]
    wrong = told[0 if "\u256d" in box else 1]  # without a box the title comes first
    near = lines[lines.index("Perhaps you meant:") + 1].split()[0] if "Perhaps you meant:" in lines else ""
    return f"{wrong}{f'; did you mean {near}?' if near else ''}; eagor --help describes all"
