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

from eagor._checks import parsed
from eagor._files import written
from eagor.errors import EagorError
from eagor.lab.eval import log
from eagor.lab.eval.results import OURS, Run, read
from eagor.lab.tasks.task import finished, load, sample_of
from eagor.live.recording import Replay
from eagor.media.bags import is_bag
from eagor.studio.messages import rounded
from eagor.studio.replays import Advance, EpisodeReplay, data_url, recorded, redraw, report_of, walked

__all__ = [
    "again", "built", "episode_of", "episodes_of", "export", "folder_of", "key_of", "listed", "opened", "page_of",
    "runs_in", "serve", "write",
]  # fmt: skip

KEPT = 8  # episodes that have been played
MOST = 200  # runs that are listed
LARGEST = 1 << 22  # bytes of a run.json that is listed
ITSELF = "."  # the name of a folder that is a run itself
STILL = "episodes of a benchmark of still pictures cannot be played again; see its report (eagor bench report RUN)"


def key_of(case: str) -> str:
    """A case as a part of an address: no slash, no percent sign."""
    return quote(case, safe="").replace("~", "~7E").replace("%", "~")


def kind_of(folder: Path) -> str | None:
    """What a folder holds: "bench", "robot", "live", or nothing that is known here."""
    path = folder / log.RUN
    with suppress(OSError, ValueError):
        if is_bag(folder):
            return "live"
        if path.is_file():
            found = parsed(path.read_bytes()) if path.stat().st_size <= LARGEST else {"samples": []}  # a long walk
            return "robot" if isinstance(found, dict) and isinstance(found.get("samples"), list) else "bench"
    return None


def runs_in(root: Path) -> dict[str, Path]:
    """The runs by name: those below `root`, newest first, or `root` itself."""
    root = Path(root)
    if not root.is_dir():
        return {}
    if kind_of(root) is not None:
        return {ITSELF: root}
    found = [
        path
        for path in root.iterdir()  # a link may lead anywhere
        if not path.name.startswith(".") and path.is_dir() and not path.is_symlink() and kind_of(path) is not None
    ]
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
    return [{"name": name, **_line(folder)} for name, folder in runs_in(root).items()]


def _line(folder: Path) -> dict[str, Any]:
    kind = kind_of(folder)
    line: dict[str, Any] = {"kind": kind, "task": "walk" if kind == "robot" else "recording", "episodes": 1, "done": 1,
                            "problem": ""}  # fmt: skip
    if kind != "bench":
        return line
    try:
        settings = log.description(folder)
        run = Run(load(str(settings.get("task"))), settings, log.read(folder))
    except (EagorError, OSError) as error:
        return line | {"task": "", "episodes": 0, "done": 0, "problem": str(error)}
    done = len(run.records)
    problem = "It has no records yet." if not done else "" if run.simulated else "still pictures, see its report"
    planned = settings.get("episodes")
    return line | {"task": str(settings["task"]), "episodes": planned, "done": done, "problem": problem}


def opened(folder: Path) -> dict[str, Any]:
    """The episodes of a run: those that failed first, then by error, the worst first. Raises `EagorError`."""
    kind = kind_of(folder)
    if kind == "bench":
        return episodes_of(read(folder))
    if kind == "live":
        cases = [(query, f"Recording {folder.name}", query) for query in Replay(folder).settings.queries]
    else:
        report = report_of(folder)
        cases = [("walk", f"Walk: {report.get('ended') or 'it did not end'}", str(report.get("query", "")))]
    return {"episodes": [_entry(*case) for case in cases], "problem": ""}


def episodes_of(run: Run) -> dict[str, Any]:
    """The episodes of a bench run, as `opened` gives them; `problem`: why none can be played again, or empty."""
    episodes: dict[str, dict[str, Any]] = {}
    parts: dict[str, dict[str, Any]] = {}
    for record in finished(run.records):
        case = sample_of(record)
        episodes.setdefault(case, _entry(case, case, str((record.get("episode") or record).get("query", ""))))
        parts.setdefault(case, {}).update(record.get("methods", {}))
    for case, methods in parts.items():
        episodes[case] |= _figures(methods.get(OURS) or next(iter(methods.values()), {}))
    failed, problem = len(run.records) - len(finished(run.records)), ""
    if not run.simulated:
        problem = STILL
    elif not episodes:
        problem = f"no episode has a result, {failed} could not be run; eagor bench failures RUN says why"
    return {"episodes": sorted(episodes.values(), key=_badness), "problem": problem}


def _entry(case: str, title: str, query: str) -> dict[str, Any]:
    """An episode without a figure."""
    return {"key": key_of(case), "title": title, "query": query, "error_deg": None, "success": None}


def _figures(part: Mapping[str, Any]) -> dict[str, Any]:
    """A method's mean error, and whether it reached the target, where the task has such a thing."""
    errors = [error for error in part.get("trace", {}).get("error_deg", ()) if error is not None]
    success = part.get("metrics", {}).get("success")
    error = rounded(float(np.mean(errors)), 2) if errors else None
    return {"error_deg": error, "success": None if success is None else bool(success)}


def _badness(entry: Mapping[str, Any]) -> tuple[bool, float]:
    error = entry["error_deg"]
    return entry["success"] is not False, -(math.inf if error is None else error)


def again(folder: Path, key: str | None, advance: Advance = lambda _: None) -> EpisodeReplay:
    """One episode of a run, for the page; `key` None: the worst one. Raises `EagorError`."""
    kind = kind_of(folder)
    if kind == "live":
        replay = Replay(folder)
        query = next((each for each in replay.settings.queries if key in (each, key_of(each))), key)
        return recorded(replay, query, advance)
    if kind == "robot":
        return walked(folder)
    return episode_of(read(folder), key, advance)


def episode_of(run: Run, key: str | None, advance: Advance = lambda _: None) -> EpisodeReplay:
    """One episode of a bench run, as `again` gives it. Raises `EagorError` where there is none to be played again."""
    told = episodes_of(run)
    if told["problem"]:
        raise EagorError(told["problem"])
    key = told["episodes"][0]["key"] if key is None else key
    case = next((each["title"] for each in told["episodes"] if key in (each["key"], each["title"])), None)
    if case is None:
        there = ", ".join(sorted(each["title"] for each in told["episodes"])[:8])
        raise EagorError(f"the run has no episode {key!r}; it has {there}")
    return redraw(run, case, advance)


def serve(line: Connection) -> None:
    """The life of the process that reads runs: questions ``(root, what, ...)``, answers ``(refused, found)``.

    What: "listed"; "opened" and a name; "episode", a name and a key; or "picture" and the number of a step, too.
    """
    played = lru_cache(maxsize=KEPT)(again)
    while (question := line.recv()) is not None:
        root, what, *about = question
        try:
            folder = folder_of(root, about[0]) if about else root
            if what == "episode":
                here = f"api/runs/{quote(about[0], safe='')}/episodes/{quote(about[1], safe='')}/panorama"
                found: Any = played(folder, about[1]).as_json(lambda number, here=here: f"{here}/{number}")
            elif what == "picture":
                found = played(folder, about[1]).pictures[about[2]]
            else:
                found = listed(root) if what == "listed" else opened(folder)
            line.send((False, found))
        except (EagorError, OSError) as error:
            line.send((True, str(error)))
        except Exception as error:  # a record of another version may lack anything
            line.send((True, f"{type(error).__name__}: {error}"))


TEMPLATE = Path(str(files("eagor.studio") / "static" / "export.html"))  # the page, with a place for the episode
PLACE = '<script type="application/json" id="episode"></script>'


def built() -> bool:
    """Whether the page has been built here; it is in every wheel."""
    return TEMPLATE.is_file()


def export(folder: Path, path: Path, episode: str | None, advance: Advance = lambda _: None) -> EpisodeReplay:
    """Write an episode of the run in `folder` (None: the worst one) to `path`; returns it.

    A recording of ``eagor live`` and the report of ``eagor robot run`` are one episode each. Raises `EagorError` for an
    unknown episode, or if the page has not been built, `StorageError`.
    """
    if not built():
        raise EagorError("the studio's page has not been built in this clone: run make page there (it needs Node)")
    found = again(Path(folder), episode, advance)
    write(found, path)
    return found


def write(found: EpisodeReplay, path: Path) -> None:
    """Write an episode to `path`. Raises `EagorError` if the page has not been built, `StorageError`."""
    written(path, page_of(found))


def page_of(found: EpisodeReplay) -> str:
    """The whole page as text, with the episode's pictures as data URLs."""
    template = TEMPLATE.read_text(encoding="utf-8")
    if template.count(PLACE) != 1:
        raise EagorError(f"{TEMPLATE.name} of the studio has no place for an episode: build the page anew (make page)")
    episode = found.as_json(lambda number: data_url(found.pictures[number]))
    text = json.dumps(rounded(episode, 6), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    # Text from outside (queries, names) must not end the script, nor begin a comment in it.
    text = text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
    return template.replace(PLACE, PLACE.replace("></", f">{text}</"))
