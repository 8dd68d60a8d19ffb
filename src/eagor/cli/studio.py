"""``eagor studio``: the page in the browser; ``eagor studio export``: one episode as a file."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from tyro.conf import Positional, arg

from eagor._extras import need
from eagor.cli import terminal
from eagor.cli.checks import checked_out, make_perception, ordinary
from eagor.cli.live import Live, asked, loop_of
from eagor.cli.options import CameraFile, Common, Flag, Hfov, RigFile, bare, given
from eagor.errors import EagorError

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from eagor.lab.eval.results import Run
    from eagor.live.loop import Loop, Sink
    from eagor.studio.hub import LiveSource, Settings


@dataclass(frozen=True, kw_only=True)
class Studio(Common):
    """Open a page in the browser: walk in an apartment, look through runs and pictures, watch a camera, live.

    `eagor studio export RUN --out page.html` writes one episode of a run as a page that needs no server.
    """

    runs: ClassVar[str] = "studio"

    words: Annotated[tuple[str, ...], Positional, bare("[export RUN]")] = ()
    """Nothing, for the page; or: export, and the folder of a run."""
    port: Annotated[int, arg(metavar="N")] = 8360
    """Port to listen at; 0: any free one."""
    open: Flag = False
    """Open the page in the browser of this desktop."""
    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address to listen at. Other machines reach the page only with another one, which needs --token."""
    token: Annotated[str | None, bare("TEXT")] = None
    """What everybody has to know who opens the page (at least 16 letters); auto: one is made and printed."""
    folder: Annotated[Path, arg(name="runs", metavar="DIR")] = Path("runs")
    """The folder with the runs to choose from; the folder of a run itself works, too."""
    perception: Annotated[str | None, bare("NAME")] = None
    """A further detector to choose, as for locate; --source looks with it (default: as for live)."""
    seed: Annotated[int | None, bare("N")] = None
    """The apartment that is shown first, 0 to 9999 (default: that of the first walk)."""
    source: Annotated[str | None, bare("SOURCE")] = None
    """A live camera, a video, a folder or a bag to watch, as for live."""
    query: Annotated[str | None, bare("QUERY")] = None
    """With --source: what to look for at first."""
    poses: Annotated[str, arg(metavar="SOURCE")] = "auto"
    """With --source: how the camera turns and moves, as for live (auto, level, still, ros:/odom, go2, CSV)."""
    rig: RigFile = None
    hfov: Hfov = None
    camera: CameraFile = None
    out: Annotated[Path | None, bare("FILE.html")] = None
    """With export: the page to write."""
    episode: Annotated[str | None, bare("NAME")] = None
    """With export: the episode, as bench failures names it (default: the worst one)."""
    methods: Annotated[tuple[str, ...], bare("NAME ...")] = ()
    """With export: the methods to show (default: all that the run has, at most 8)."""


SHORTEST = 16  # letters of a token
WAITING = 1 << 14  # bytes on their way to a page
RATE = 10.0  # answers per second of a live source
LAST_SEED = 9999
FOR_EXPORT = ("out", "episode", "methods")
FOR_SOURCE = ("query", "poses", "rig", "hfov", "camera")


def studio(options: Studio) -> int:
    """Run the command; returns its exit code."""
    if options.words[:1] == ("export",):
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
    from eagor.studio.messages import SEED

    if not 0 <= options.port <= 65535:
        raise terminal.UsageError(f"--port {options.port}; wanted a port from 0 to 65535")
    seed = SEED if options.seed is None else options.seed
    if not 0 <= seed <= LAST_SEED:
        raise terminal.UsageError(f"--seed {seed}; wanted an apartment, 0 to {LAST_SEED}")
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
    settings = Settings(Gate(options.host, token), options.folder, options.perception, seed, live)
    if options.perception is not None:
        make_perception(options.perception)  # raises for what does not exist, before anything is started
    return settings


def _live(options: Studio, source: str) -> LiveSource:
    """The source, as ``eagor live`` would open it. Raises `UsageError`, `QueryError`."""
    from eagor.studio.hub import LiveSource

    if options.query is None:
        raise terminal.UsageError(f"--source {source} needs --query: say what to look for at first")
    wanted = Live(
        words=(source, options.query), poses=options.poses, rig=options.rig, perception=options.perception, rate=RATE,
        hfov=options.hfov, camera=options.camera,
    )  # fmt: skip
    asked(wanted)
    ordinary(options.hfov, options.camera, options.rig)
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


EPISODE = "episode.html"  # beside a report
FOR_SERVING = ("port", "open", "host", "token", "folder", "perception", "seed", *FOR_SOURCE, "source")


def export(options: Studio) -> int:
    """Run the command; returns its exit code."""
    if len(options.words) != 2:
        raise terminal.UsageError("wanted the folder of one run: eagor studio export RUN --out page.html")
    if mistaken := given(options, FOR_SERVING):
        name = "runs" if mistaken[0] == "folder" else mistaken[0]
        raise terminal.UsageError(f"--{name} is for the page in the browser; leave it out with export")
    folder, out = Path(options.words[1]), options.out
    if not folder.is_dir():
        raise terminal.UsageError(f"there is no folder {folder}; name the folder of a run")
    if out is None:
        raise terminal.UsageError("say where to write the page: --out page.html")
    if out.suffix.lower() not in (".html", ".htm"):
        raise terminal.UsageError(f"--out {out} ends in {out.suffix or 'nothing'}; wanted a page, .html")
    checked_out(out)
    need("an exported episode", "sim", "gymnasium", "trimesh")
    from eagor.studio.runs import export as write

    with terminal.progress("playing the episode again", None) as advance:
        found = write(folder, out, options.episode, options.methods, lambda _: advance())
    size = out.stat().st_size
    if options.json:
        terminal.emit({"page": str(out), "bytes": size, "title": found.scene["title"], "steps": len(found.steps)})
    else:
        print(f"{found.scene['title']}, {len(found.steps)} steps: {out} ({size / 1e6:.1f} MB)")
    return terminal.OK


def beside_report(run: Run, out: Path) -> str | None:
    """Write ``episode.html`` of a run's worst episode into `out`; its name, or None where that cannot be.

    A report is not lost for it: what is wrong is said as a warning. A run with a model gets none: to play it again
    would load the model, or ask its server.
    """
    from eagor.lab.agents.models import release
    from eagor.perception import is_model
    from eagor.studio.runs import built, episode_of, episodes_of, write

    try:
        if is_model(str(run.settings.get("perception", ""))) or not episodes_of(run)["playable"]:
            return None
    except (EagorError, OSError, KeyError, IndexError, TypeError, AttributeError):  # the report says what is wrong
        return None
    if not built():
        terminal.warning(f"no {EPISODE}: the studio's page has not been built in this clone (make page)")
        return None
    try:
        with terminal.progress("playing the worst episode again", None) as advance:
            write(episode_of(run, None, lambda _: advance()), out / EPISODE)
    except (EagorError, ImportError, OSError, KeyError, IndexError, TypeError) as error:
        terminal.warning(f"no {EPISODE}: {error if isinstance(error, EagorError) else repr(error)}")
        return None
    finally:
        release()
    return EPISODE


SERVE = "eagor.cli.studio:serve"


def serve(line: Connection, options: Live) -> None:
    """The life of the process; `options` as of ``eagor live``."""
    from eagor.studio.live import watch

    source, _ = asked(options)

    def opens(sinks: Sequence[Sink], hfov: float | None) -> Loop:
        return loop_of(options if hfov is None else replace(options, hfov=hfov), sinks, around=True)

    watch(line, source, options.perception or "", opens)
