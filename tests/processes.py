"""What tests of other processes share: waiting for something, and a reader with little memory."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path


def wait_for(what: Callable[[], object]) -> None:
    """Until `what` is true; for a minute."""
    for _ in range(1200):
        if what():
            return
        time.sleep(0.05)
    raise AssertionError("waited for a minute in vain")


def limited(imports: str, code: str, folder: Path, mebibytes: int) -> list[str]:
    """The lines that `code` prints, which knows `folder`, and after its `imports` may take so much more memory."""
    head = "import resource, sys, warnings\nwarnings.simplefilter('ignore')\nfrom pathlib import Path\n"
    limit = (
        "size = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        f"resource.setrlimit(resource.RLIMIT_AS, (size + ({mebibytes} << 20), resource.RLIM_INFINITY))\n"
        "folder = Path(sys.argv[1])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", head + imports + limit + code, folder],
        capture_output=True, text=True, timeout=300, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()
