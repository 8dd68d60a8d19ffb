"""``eagor studio``: the page in the browser; ``eagor studio export``: one episode as a file."""

from __future__ import annotations

import secrets
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from eagor._extras import require_extra
from eagor.cli import checks, terminal
from eagor.cli.options import Flag, Lens, bare, refuse
from eagor.errors import EagorError

if TYPE_CHECKING:
    from eagor.lab.eval.results import Run


@dataclass(frozen=True, kw_only=True)
class Studio(Lens):
    """Open a page in the browser: walk in an apartment, look through runs and pictures, watch a camera, live.

    `eagor studio export RUN --out page.html` writes one episode of a run as a page that needs no server.
    """

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
    runs: Annotated[Path, arg(metavar="DIR")] = Path("runs")
    """The folder with the runs to choose from; the folder of a run itself works, too."""
    perception: Annotated[str | None, bare("NAME")] = None
    """A further detector to choose, as for locate; --source looks with it (default: as for live)."""
    source: Annotated[str | None, bare("SOURCE")] = None
    """What the page opens on, as for live: a camera, a video, a folder, a bag, or apartment:SEED."""
    query: Annotated[str | None, bare("QUERY")] = None
    """With --source: what to look for at first."""
    poses: Annotated[str, arg(metavar="SOURCE")] = "auto"
    """With --source: how the camera turns and moves, as for live (auto, level, still, ros:/odom, go2, CSV)."""
    out: Annotated[Path | None, bare("FILE.html")] = None
    """With export: the page to write."""
    episode: Annotated[str | None, bare("NAME")] = None
    """With export: the episode, as bench failures names it (default: the worst one)."""


SHORTEST = 16  # letters of a token
FOR_EXPORT = ("out", "episode")
FOR_SOURCE = ("query", "poses", "rig", "hfov", "camera", "eyes")
FOR_SERVING = ("port", "open", "host", "token", "runs", "perception", *FOR_SOURCE, "source")
EPISODE = "episode.html"  # beside a report


def studio(options: Studio) -> int:
    """Run the command; returns its exit code."""
    if options.words[:1] == ("export",):
        return export(options)
    if options.words:
        raise terminal.UsageError(f"got {' '.join(options.words)!r}; wanted nothing, or: export RUN")
    refuse(options, FOR_EXPORT, "is for eagor studio export RUN")
    if options.source is None:
        refuse(options, FOR_SOURCE, "is for --source SOURCE, which is not given")
    require_extra("eagor studio", "studio", "starlette", "uvicorn", "websockets")
    from eagor.studio.messages import Opening
    from eagor.studio.server import is_loopback, serve
    from eagor.studio.sessions import Settings

    host, token = options.host, secrets.token_urlsafe(24) if options.token == "auto" else options.token
    if token is not None and (len(token) < SHORTEST or not token.isascii() or not token.isprintable()):
        raise terminal.UsageError(f"--token has {len(token)} letters; wanted {SHORTEST} ASCII letters or more, or auto")
    if token is None and not is_loopback(host):
        raise terminal.UsageError(
            f"--host {host} lets other machines in; give a --token that they have to know, or --token auto"
        )
    if options.runs.exists() and not options.runs.is_dir():
        raise terminal.UsageError(f"--runs {options.runs} is no folder; name the one that holds your runs")
    if options.perception is not None:
        checks.make_perception(options.perception)  # raises for what does not exist, before anything is started
    live, source, query = None, options.source, options.query or ""
    if source is not None:
        simulated = source.startswith("apartment:")
        if not (query or simulated):
            raise terminal.UsageError(f"--source {source} needs --query: say what to look for at first")
        perception = options.perception or ("scout" if simulated else checks.perception_for([query], None))
        rig, camera = options.rig and str(options.rig), checks.lens_of(options)["camera"]
        live = Opening(source, source, query, perception, poses=options.poses, rig=rig, camera=camera)
    try:
        family = socket.getaddrinfo(host, options.port, type=socket.SOCK_STREAM)[0][0]
        taken = socket.create_server((host, options.port), family=family, backlog=128)
    except OSError as error:
        raise terminal.UsageError(
            f"--host {host} --port {options.port} cannot be used ({error.strerror or error}); another studio may be "
            "running there: choose another port, or 0 for any free one"
        ) from error
    name = f"[{host}]" if ":" in host else host
    address = f"http://{name}:{taken.getsockname()[1]}/" + (f"?token={token}" if token else "")
    terminal.give(options.json, {"address": address}, f"The studio: {address}  (Ctrl-C ends it)")
    serve(Settings(host, token, options.runs, options.perception, live), taken, address if options.open else None)
    return terminal.OK


def export(options: Studio) -> int:
    """``eagor studio export``."""
    if len(options.words) != 2:
        raise terminal.UsageError("wanted the folder of one run: eagor studio export RUN --out page.html")
    refuse(options, FOR_SERVING, "is for the page in the browser; leave it out with export")
    folder, out = Path(options.words[1]), options.out
    if not folder.is_dir():
        raise terminal.UsageError(f"there is no folder {folder}; name the folder of a run")
    if out is None or out.suffix.lower() not in (".html", ".htm"):
        raise terminal.UsageError(f"--out {out or '...'}; wanted where to write the page, such as --out page.html")
    checks.check_outputs(options)
    require_extra("an exported episode", "sim", "gymnasium", "trimesh")
    from eagor.studio.runs import again, write

    with terminal.progress("playing the episode again", None) as advance:
        found = again(folder, options.episode, lambda _: advance())
    write(found, out)
    size, title, steps = out.stat().st_size, found.scene["title"], len(found.steps)
    told = {"page": str(out), "bytes": size, "title": title, "steps": steps}
    return terminal.give(options.json, told, f"{title}, {steps} steps: {out} ({size / 1e6:.1f} MB)")


def beside_report(run: Run, out: Path) -> str | None:
    """Write ``episode.html`` of a run's worst episode into `out`; its name, or None where that cannot be.

    A report is not lost for it: what is wrong is said as a warning. A run with a model gets none: to play it again
    would load the model, or ask its server.
    """
    from eagor.lab.agents.models import release
    from eagor.perception import is_model
    from eagor.studio.runs import episode_of, episodes_of, write

    try:
        if is_model(str(run.settings.get("perception", ""))) or episodes_of(run)["problem"]:
            return None
        with terminal.progress("playing the worst episode again", None) as advance:
            write(episode_of(run, None, lambda _: advance()), out / EPISODE)
    except (EagorError, ImportError, OSError, KeyError, IndexError, TypeError, AttributeError) as error:
        terminal.warning(f"no {EPISODE}: {error if isinstance(error, EagorError) else repr(error)}")
        return None
    finally:
        release()
    return EPISODE
