"""The live source of ``eagor studio --source``, in a process of its own: opened as ``eagor live`` opens it."""

from __future__ import annotations

from multiprocessing.connection import Connection

from eagor.cli.live import asked, loop_of
from eagor.cli.live_options import Live

__all__ = ["SERVE", "serve"]

SERVE = "eagor.cli.studio_live:serve"


def serve(line: Connection, options: Live) -> None:
    """The life of the process; `options` as of ``eagor live``."""
    from eagor.studio.live import watch

    source, _ = asked(options)
    watch(line, source, options.perception or "", lambda watchers: loop_of(options, watchers))
