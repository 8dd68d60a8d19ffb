"""``eagor studio``: the page in the browser; ``eagor studio export``: one episode as a file."""

from __future__ import annotations

import secrets
import socket
from typing import TYPE_CHECKING

from eagor._extras import need
from eagor.cli import terminal
from eagor.cli.shared_options import given
from eagor.cli.studio_options import Studio

if TYPE_CHECKING:
    from eagor.studio.hub import LiveSource, Settings

SHORTEST = 16  # letters of a token
WAITING = 1 << 14  # bytes on their way to a page
RATE = 10.0  # answers per second of a live source
LAST_SEED = 9999
FOR_EXPORT = ("out", "episode", "methods")
FOR_SOURCE = ("query", "poses", "rig")


def studio(options: Studio) -> int:
    """Run the command; returns its exit code."""
    if options.words[:1] == ("export",):
        from eagor.cli.studio_export import export

        return export(options)
    if options.words:
        raise terminal.UsageError(f"got {' '.join(options.words)!r}; wanted nothing, or: export RUN")
    if mistaken := given(options, FOR_EXPORT):
        raise terminal.UsageError(f"--{mistaken[0]} is for eagor studio export RUN")
    if options.source is None and (mistaken := given(options, FOR_SOURCE)):
        raise terminal.UsageError(f"--{mistaken[0]} is for --source SOURCE, which is not given")
    need("eagor studio", "studio", "starlette", "uvicorn", "websockets")
    settings = _settings(options)
    from eagor.studio.server import serve

    taken = _listening(options.host, options.port)
    port = taken.getsockname()[1]
    name = f"[{options.host}]" if ":" in options.host else options.host
    token = settings.gate.token
    address = f"http://{name}:{port}/" + (f"?token={token}" if token else "")
    if options.json:
        terminal.emit({"address": address})
    else:
        print(f"The studio: {address}  (Ctrl-C ends it)", flush=True)
    serve(settings, taken, address if options.open else None)
    return terminal.OK


def _settings(options: Studio) -> Settings:
    from eagor.studio.guard import Gate, is_loopback
    from eagor.studio.hub import Settings

    if not 0 <= options.port <= 65535:
        raise terminal.UsageError(f"--port {options.port}; wanted a port from 0 to 65535")
    if not 0 <= options.seed <= LAST_SEED:
        raise terminal.UsageError(f"--seed {options.seed}; wanted an apartment, 0 to {LAST_SEED}")
    token = secrets.token_urlsafe(24) if options.token == "auto" else options.token
    if token is not None and (len(token) < SHORTEST or not token.isascii() or not token.isprintable()):
        raise terminal.UsageError(f"--token has {len(token)} letters; wanted {SHORTEST} ASCII letters or more, or auto")
    if token is None and not is_loopback(options.host):
        raise terminal.UsageError(
            f"--host {options.host} lets other machines in; give a --token that they have to know, or --token auto"
        )
    if options.folder.exists() and not options.folder.is_dir():
        raise terminal.UsageError(f"--runs {options.folder} is no folder; name the one that holds your runs")
    live = None if options.source is None else _live(options, options.source)
    settings = Settings(Gate(options.host, token), options.folder, options.perception, options.seed, live)
    if options.perception is not None:
        from eagor.cli.looking import make_perception

        make_perception(options.perception)  # raises for what does not exist, before anything is started
    return settings


def _live(options: Studio, source: str) -> LiveSource:
    """The source, as ``eagor live`` would open it. Raises `UsageError`, `QueryError`."""
    from eagor.cli import live
    from eagor.cli.live_options import Live
    from eagor.cli.studio_live import SERVE
    from eagor.studio.hub import LiveSource

    if options.query is None:
        raise terminal.UsageError(f"--source {source} needs --query: say what to look for at first")
    wanted = Live(
        words=(source, options.query), poses=options.poses, rig=options.rig, perception=options.perception, rate=RATE
    )
    live.asked(wanted)
    return LiveSource(source, SERVE, (wanted,))


def _listening(host: str, port: int) -> socket.socket:
    """A socket that listens there. Raises `UsageError` if that cannot be."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        taken = socket.socket(family, socket.SOCK_STREAM)
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # What waits in the network for a slow page cannot be replaced by newer steps any more: keep that little.
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WAITING)
        taken.bind((host, port))
        taken.listen(128)  # whoever reads the address may connect at once
    except OSError as error:
        raise terminal.UsageError(
            f"--host {host} --port {port} cannot be used ({error.strerror or error}); another studio may be running "
            "there: choose another port, or 0 for any free one"
        ) from error
    return taken
