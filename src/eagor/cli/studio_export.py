"""``eagor studio export RUN --out page.html``: one episode as a page that needs no server."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from eagor._extras import need
from eagor.cli import terminal
from eagor.cli.looking import checked_out
from eagor.cli.shared_options import given
from eagor.cli.studio_options import Studio
from eagor.errors import EagorError

if TYPE_CHECKING:
    from eagor.evaluation.study import Told

__all__ = ["beside_report", "export"]

EPISODE = "episode.html"  # beside a report
FOR_SERVING = ("port", "open", "host", "token", "folder", "perception", "seed", "source", "query", "poses", "rig")


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


def beside_report(run: Told, out: Path) -> str | None:
    """Write ``episode.html`` of a run's worst episode into `out`; its name, or None where that cannot be.

    A report is not lost for it: what is wrong is said as a warning. A run with a model gets none: to play it again
    would load the model, or ask its server.
    """
    from eagor.perception import is_model
    from eagor.studio.runs import built, episode_of, episodes_of, write
    from eagor.tasks.eyes import release

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
