"""Commands as they are typed, run in this process: a process of its own costs two seconds each."""

import io
import json
import os
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

from eagor.cli import main

# Several tests run side by side: threads inside the matrix library would only stand in each other's way.
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "EAGOR_DEBUG"} | {
    "OPENBLAS_NUM_THREADS": "1"
}


@dataclass(frozen=True)
class Done:
    """What a command has said."""

    returncode: int
    stdout: str
    stderr: str


def eagor(*words: object) -> Done:
    """Run ``eagor WORDS`` to its end."""
    said = [io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2)]
    with redirect_stdout(said[0]), redirect_stderr(said[1]), patch.dict(os.environ, ENVIRONMENT):
        os.environ.pop("EAGOR_DEBUG", None)
        code = main([*map(str, words)])
    return Done(code, *(each.buffer.getvalue().decode() for each in said))


def answer(*words: object, code: int = 0) -> Any:
    """The one JSON object on stdout."""
    done = eagor(*words, "--json")
    assert done.returncode == code, done.stderr
    return json.loads(done.stdout)


def refused(*words: object, code: int = 2) -> str:
    """The last line on stderr, which says why; nothing on stdout, and no traceback."""
    done = eagor(*words)
    assert (done.returncode, done.stdout) == (code, ""), done.stderr
    assert "Traceback" not in done.stderr
    return done.stderr.splitlines()[-1]
