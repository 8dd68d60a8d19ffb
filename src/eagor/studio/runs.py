"""The runs of a folder: which there are, which episodes each has, and one episode again, or as a page of its own.

A name from a page is only ever compared with the names in the folder; it is never a path. A page of its own needs no
server: all of it is in one file, which opens from disk and sends no request.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from eagor._checks import parsed
from eagor._files import written
from eagor.errors import EagorError, FormatError
from eagor.lab.eval import log
from eagor.lab.eval.results import OURS, Run, read
from eagor.lab.tasks.task import finished, load, sample_of
from eagor.live.recording import Replay
from eagor.media.bags import is_bag
from eagor.studio.messages import media_type, rounded
from eagor.studio.replays import Advance, Redrawn, recorded, redraw, report_of, walked

__all__ = [
    "again", "built", "episode_of", "episodes_of", "export", "folder_of", "key_of", "kind_of", "listed", "opened",
    "page_of", "runs_in", "write",
]  # fmt: skip

MOST = 200  # runs that are listed
LARGEST = 1 << 22  # bytes of a run.json that is listed
ITSELF = "."  # the name of a folder that is a run itself
WALK = "walk"  # the only case of a robot's report
STILL = "episodes of a benchmark of still pictures cannot be played again; see its report (eagor bench report RUN)"


def key_of(case: str) -> str:
    """A case as a part of an address: no slash, no percent sign."""
    return quote(case, safe="").replace("~", "~7E").replace("%", "~")


def kind_of(folder: Path) -> str | None:
    """What a folder holds: "bench", "robot", "live", or nothing that is known here."""
    with suppress(OSError, ValueError):
        if is_bag(folder):
            return "live"
        path = folder / log.RUN
        if path.is_file() and path.stat().st_size <= LARGEST:
            found = parsed(path.read_bytes())
            if isinstance(found, dict):
                return "robot" if isinstance(found.get("samples"), list) else "bench"
            return "bench"
        if path.is_file():
            return "robot"  # a long walk
    return None


def runs_in(root: Path) -> dict[str, Path]:
    """The runs by name: those below `root`, newest first, or `root` itself."""
    root = Path(root)
    if not root.is_dir():
        return {}
    if kind_of(root) is not None:
        return {ITSELF: root}
    found = []
    for path in root.iterdir():
        # A link may lead anywhere.
        if not path.name.startswith(".") and path.is_dir() and not path.is_symlink() and kind_of(path) is not None:
            found.append(path)
    found.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    return {path.name: path for path in found[:MOST]}


def folder_of(root: Path, name: str) -> Path:
    """The folder of the run called `name`. Raises `EagorError` for any other name."""
    runs = runs_in(root)
    if name not in runs:
        there = ", ".join(runs) or "none"
        raise EagorError(f"there is no run {name[:80]!r}; there are {there[:400]}")
    return runs[name]


def listed(root: Path) -> list[dict[str, Any]]:
    """A line about each run."""
    return [_line(name, folder) for name, folder in runs_in(root).items()]


def _line(name: str, folder: Path) -> dict[str, Any]:
    kind = kind_of(folder)
    line: dict[str, Any] = {"name": name, "kind": kind, "task": "", "episodes": 1, "done": 1, "problem": ""}
    if kind != "bench":
        return line | {"task": {"live": "recording", "robot": "walk"}[str(kind)]}
    try:
        settings = log.description(folder)
        run = Run(load(str(settings.get("task"))), settings, log.read(folder))
    except (EagorError, OSError) as error:
        return line | {"episodes": 0, "done": 0, "problem": str(error)}
    done = len(run.records)
    seen = "" if run.simulated else "still pictures, see its report"
    problem = seen if done else "It has no records yet."
    line |= {"task": str(settings.get("task", "")), "perception": str(settings.get("perception", ""))}
    return line | {"episodes": settings.get("episodes"), "done": done, "problem": problem}


def opened(folder: Path) -> dict[str, Any]:
    """The episodes of a run: those that failed first, then by error, the worst first. Raises `EagorError`."""
    kind = kind_of(folder)
    if kind == "live":
        return _few(kind, [(query, f"Recording {folder.name}", query) for query in Replay(folder).settings.queries])
    if kind == "robot":
        report = report_of(folder)
        title = f"Walk: {report.get('ended') or 'it did not end'}"
        return _few(kind, [(WALK, title, str(report.get("query", "")))])
    if kind is None:
        raise FormatError(f"{folder.name} holds no run: no {log.RUN} and no recording")
    return episodes_of(read(folder))


def episodes_of(run: Run) -> dict[str, Any]:
    """The episodes of a bench run, as `opened` gives them."""
    methods = list(run.results()) if run.simulated else []
    episodes: dict[str, dict[str, Any]] = {}
    for record in finished(run.records):
        case = sample_of(record)
        entry = episodes.setdefault(case, _entry(case, record))
        for name, part in record.get("methods", {}).items():
            entry["methods"][name] = _figures(part)
    for entry in episodes.values():
        ours = entry["methods"].get(OURS) or next(iter(entry["methods"].values()), {})
        entry |= {"error_deg": ours.get("error_deg"), "success": ours.get("success")}
    order = sorted(episodes.values(), key=_badness)
    failed, problem = len(run.records) - len(finished(run.records)), ""
    if not run.simulated:
        problem = STILL
    elif not order:
        problem = f"no episode has a result, {failed} could not be run; eagor bench failures RUN says why"
    return {"kind": "bench", "task": run.task.name, "methods": methods, "episodes": order, "failed": failed,
            "playable": not problem, "problem": problem}  # fmt: skip


def _few(kind: str, cases: list[tuple[str, str, str]]) -> dict[str, Any]:
    """Cases without a figure: a case, its title and its query each."""
    unknown = {"error_deg": None, "success": None, "methods": {}}
    entries = [{"key": key_of(case), "title": title, "query": query, **unknown} for case, title, query in cases]
    return {"kind": kind, "task": kind, "methods": [OURS], "episodes": entries, "failed": 0, "playable": True,
            "problem": ""}  # fmt: skip


def _entry(case: str, record: Mapping[str, Any]) -> dict[str, Any]:
    query = str((record.get("episode") or record).get("query", ""))
    return {"key": key_of(case), "title": case, "query": query, "methods": {}}


def _figures(part: Mapping[str, Any]) -> dict[str, Any]:
    """A method's mean error, and whether it reached the target, where the task has such a thing."""
    errors = [error for error in part.get("trace", {}).get("error_deg", ()) if error is not None]
    metrics = part.get("metrics", {})
    found: dict[str, Any] = {"error_deg": rounded(float(np.mean(errors)), 2) if errors else None}
    if "success" in metrics:
        found["success"] = bool(metrics["success"])
    return found


def _badness(entry: Mapping[str, Any]) -> tuple[bool, float]:
    error = entry["error_deg"]
    return entry["success"] is not False, -(math.inf if error is None else error)


def again(folder: Path, key: str | None, advance: Callable[[int], object] = lambda _: None) -> Redrawn:
    """One episode of a run, for the page; `key` None: the worst one. Raises `EagorError`."""
    kind = kind_of(folder)
    if kind == "live":
        replay = Replay(folder)
        query = next((query for query in replay.settings.queries if key in (query, key_of(query))), key)
        return recorded(replay, query, advance)
    if kind == "robot":
        return walked(folder)
    return episode_of(read(folder), key, advance)


def episode_of(run: Run, key: str | None, advance: Callable[[int], object] = lambda _: None) -> Redrawn:
    """One episode of a bench run, as `again` gives it. Raises `EagorError` where there is none to be played again."""
    told = episodes_of(run)
    if told["problem"]:
        raise EagorError(told["problem"])
    if key is None:
        key = told["episodes"][0]["key"]
    cases = {key_of(case): case for record in finished(run.records) for case in (sample_of(record),)}
    cases |= {case: case for case in cases.values()}
    if key not in cases:
        raise EagorError(f"the run has no episode {key!r}; it has {', '.join(sorted(cases.values())[:8])}")
    return redraw(run, cases[key], advance)


TEMPLATE = "export.html"  # the built page, with a place for the episode
PLACE = '<script type="application/json" id="episode"></script>'


def built() -> bool:
    """Whether the page has been built here; it is in every wheel."""
    return _template().is_file()


def _template() -> Path:
    return Path(str(files("eagor.studio") / "static" / TEMPLATE))


def export(
    folder: Path,
    path: Path,
    episode: str | None = None,
    methods: tuple[str, ...] = (),
    advance: Advance = lambda _: None,
) -> Redrawn:
    """Write an episode of the run in `folder` (None: the worst one) to `path`; returns it.

    `methods`: those that are shown beside the one with the belief (none: all). A recording of ``eagor live`` and the
    report of ``eagor robot run`` are one episode each. Raises `EagorError` for an unknown episode or method, or if the
    page has not been built, `StorageError`.
    """
    check_built()
    found = again(Path(folder), episode, advance)
    if methods:
        only(found, methods)
    write(found, path)
    return found


def write(found: Redrawn, path: Path) -> None:
    """Write an episode to `path`. Raises `EagorError` if the page has not been built, `StorageError`."""
    written(path, page_of(found))


def check_built() -> None:
    """Raise `EagorError` if there is no page to put an episode into."""
    if not built():
        raise EagorError("the studio's page has not been built in this clone: run make page there (it needs Node)")


def only(found: Redrawn, methods: tuple[str, ...]) -> None:
    """Leave out the methods that are not asked for. Raises `EagorError` for one that the episode does not have."""
    there = [each["name"] for each in found.scene["methods"]]
    if unknown := [name for name in methods if name not in there]:
        raise EagorError(f"the episode has no method {unknown[0]!r}; it has {', '.join(there)}")
    kept = {*methods, found.scene["method"]}
    found.scene["methods"] = [each for each in found.scene["methods"] if each["name"] in kept]
    found.scene["paths"] = {name: path for name, path in found.scene["paths"].items() if name in kept}
    for step in found.steps:
        for part in ("methods", "rivals"):
            step[part] = {name: each for name, each in step.get(part, {}).items() if name in kept}


def page_of(found: Redrawn) -> str:
    """The whole page as text, with the episode's pictures as data URLs."""
    template = _template().read_text(encoding="utf-8")
    if template.count(PLACE) != 1:
        raise EagorError(f"{TEMPLATE} of the studio has no place for an episode: build the page anew (make page)")
    episode = found.as_json(lambda number: _as_address(found.pictures[number]))
    text = json.dumps(rounded(episode, 6), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    # Text from outside (queries, names) must not end the script, nor begin a comment in it.
    text = text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
    return template.replace(PLACE, PLACE.replace("></", f">{text}</"))


def _as_address(picture: bytes) -> str:
    return f"data:{media_type(picture)};base64,{base64.b64encode(picture).decode('ascii')}"
