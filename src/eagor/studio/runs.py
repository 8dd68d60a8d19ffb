"""The runs of a folder: which there are, which episodes each has, and one episode again, or as a page of its own.

A name from a page is only ever compared with the names in the folder; it is never a path. A page of its own needs no
server: all of it is in one file, which opens from disk and sends no request.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from importlib.resources import files
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from eagor._files import write_atomic
from eagor.errors import EagorError
from eagor.lab.eval import log
from eagor.lab.eval.results import OURS, Run, read
from eagor.lab.tasks.task import finished, load, sample_of
from eagor.live.recording import Replay
from eagor.sources.bags import is_bag
from eagor.studio.messages import rounded
from eagor.studio.replays import Advance, EpisodeReplay, data_url, recorded, redraw

__all__ = [
    "again", "episode_of", "episodes_of", "folder_of", "key_of", "listed", "opened", "page_of", "runs_in", "serve",
    "write",
]  # fmt: skip

KEPT = 8  # episodes that have been played
MOST = 200  # runs that are listed
ITSELF = "."  # the name of a folder that is a run itself
STILL = "episodes of a benchmark of still pictures cannot be played again; see its report (eagor bench report RUN)"
TEMPLATE = Path(str(files("eagor.studio") / "static" / "export.html"))  # the page, with a place for the episode
PLACE = '<script type="application/json" id="episode"></script>'


def key_of(case: str) -> str:
    """A case as a part of an address: no slash, no percent sign."""
    return quote(case, safe="").replace("~", "~7E").replace("%", "~")


def kind_of(folder: Path) -> str | None:
    """What a folder holds: "bench", "live", or nothing that is known here."""
    with suppress(OSError):
        return "live" if is_bag(folder) else "bench" if (folder / log.RUN).is_file() else None
    return None


def runs_in(root: Path) -> dict[str, Path]:
    """The runs by name: those below `root`, newest first, or `root` itself."""
    if not root.is_dir():
        return {}
    if kind_of(root) is not None:
        return {ITSELF: root}
    inside = [path for path in root.iterdir() if not path.name.startswith(".") and path.is_dir()]
    found = [path for path in inside if not path.is_symlink() and kind_of(path) is not None]  # links lead anywhere
    found.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    return {path.name: path for path in found[:MOST]}


def folder_of(root: Path, name: str) -> Path:
    """The folder of the run called `name`. Raises `EagorError` for any other name."""
    runs = runs_in(root)
    if name not in runs:
        raise EagorError(f"there is no run {name[:80]!r}; there are {(', '.join(runs) or 'none')[:400]}")
    return runs[name]


def listed(root: Path) -> list[dict[str, Any]]:
    """A line about each run."""
    lines = []
    for name, folder in runs_in(root).items():
        kind = kind_of(folder)
        line = {"name": name, "kind": kind, "task": "recording", "episodes": 1, "done": 1, "problem": ""}
        if kind == "bench":
            try:
                settings = log.description(folder)
                run = Run(load(str(settings.get("task"))), settings, log.read(folder))
                still = "" if run.simulated else "still pictures, see its report"
                line |= {"task": str(settings["task"]), "episodes": settings.get("episodes"), "done": len(run.records)}
                line["problem"] = still if run.records else "It has no records yet."
            except (EagorError, OSError) as error:
                line |= {"task": "", "episodes": 0, "done": 0, "problem": str(error)}
        lines.append(line)
    return lines


def opened(folder: Path) -> dict[str, Any]:
    """The episodes of a run: those that failed first, then by error, the worst first. Raises `EagorError`."""
    if kind_of(folder) == "bench":
        return episodes_of(read(folder))
    queries = Replay(folder).settings.queries
    return {"episodes": [_entry(query, f"Recording {folder.name}", query) for query in queries], "problem": ""}


def episodes_of(run: Run) -> dict[str, Any]:
    """The episodes of a bench run, as `opened` gives them; `problem`: why none can be played again, or empty."""
    queries, parts, done = dict[str, str](), dict[str, dict[str, Any]](), finished(run.records)
    for record in done:
        case = sample_of(record)
        queries.setdefault(case, str((record.get("episode") or record).get("query", "")))
        parts.setdefault(case, {}).update(record.get("methods", {}))
    found = [
        _entry(case, case, queries[case], methods.get(OURS) or next(iter(methods.values()), {}))
        for case, methods in parts.items()
    ]
    found.sort(key=lambda each: (each["success"] is not False, -_or(each["error_deg"], math.inf)))
    problem = "" if run.simulated else STILL
    if not found and not problem:
        failed = len(run.records) - len(done)
        problem = f"no episode has a result, {failed} could not be run; eagor bench failures RUN says why"
    return {"episodes": found, "problem": problem}


def _or(value: float | None, default: float) -> float:
    return default if value is None else value


def _entry(case: str, title: str, query: str, part: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """An episode, with a method's mean error, and whether it reached the target, where the task has such a thing."""
    part = part or {}
    errors = [error for error in part.get("trace", {}).get("error_deg", ()) if error is not None]
    success = part.get("metrics", {}).get("success")
    return {
        "key": key_of(case), "title": title, "query": query,
        "error_deg": rounded(float(np.mean(errors)), 2) if errors else None,
        "success": None if success is None else bool(success),
    }  # fmt: skip


def again(folder: Path, key: str | None, advance: Advance = lambda _: None) -> EpisodeReplay:
    """One episode of a run, for the page; `key` None: the worst one.

    A recording of ``eagor live`` or ``eagor robot run`` has one for each query. Raises `EagorError`.
    """
    if kind_of(folder) != "live":
        return episode_of(read(folder), key, advance)
    replay = Replay(folder)
    query = next((each for each in replay.settings.queries if key in (each, key_of(each))), key)
    return recorded(replay, query, advance)


def episode_of(run: Run, key: str | None, advance: Advance = lambda _: None) -> EpisodeReplay:
    """One episode of a bench run, as `again` gives it. Raises `EagorError` where there is none to be played again."""
    found = episodes_of(run)
    if found["problem"]:
        raise EagorError(found["problem"])
    cases = [each["title"] for each in found["episodes"]]
    case = cases[0] if key is None else next((each for each in cases if key in (each, key_of(each))), None)
    if case is None:
        raise EagorError(f"the run has no episode {key!r}; it has {', '.join(sorted(cases)[:8])}")
    return redraw(run, case, advance)


def serve(line: Connection) -> None:
    """The life of the process that reads runs: questions ``(root, what, ...)``, answers ``(refused, found)``.

    What: "listed"; "opened" and a name; "episode", a name and a key; or "picture" and the number of a step, too.
    """
    played = lru_cache(maxsize=KEPT)(again)
    while True:
        root, what, *about = line.recv()
        try:
            folder = folder_of(root, about[0]) if about else root
            if what == "episode":
                here = f"api/runs/{quote(about[0], safe='')}/episodes/{quote(about[1], safe='')}/panorama"
                found: Any = played(folder, about[1]).as_json(lambda number, here=here: f"{here}/{number}")
            elif what == "picture":
                found = played(folder, about[1]).pictures[about[2]]
            else:
                found = {"folder": str(root), "runs": listed(root)} if what == "listed" else opened(folder)
            line.send((False, found))
        except Exception as error:  # a record of another version may lack anything
            plain = isinstance(error, EagorError | OSError)
            line.send((True, str(error) if plain else f"{type(error).__name__}: {error}"))


def write(found: EpisodeReplay, path: Path) -> None:
    """Write an episode to `path`. Raises `EagorError` if the page has not been built, `StorageError`."""
    write_atomic(path, page_of(found))


def page_of(found: EpisodeReplay) -> str:
    """The whole page as text, with the episode's pictures as data URLs. Raises `EagorError` if it is not built."""
    template = TEMPLATE.read_text(encoding="utf-8") if TEMPLATE.is_file() else ""
    if template.count(PLACE) != 1:
        raise EagorError("the studio's page has not been built in this clone: run make page there (it needs Node)")
    episode = found.as_json(lambda number: data_url(found.pictures[number]))
    text = json.dumps(rounded(episode, 6), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    # Text from outside (queries, names) must not end the script, nor begin a comment in it.
    text = text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
    return template.replace(PLACE, PLACE.replace("></", f">{text}</"))
