"""Answers about frames: as lines of a table on the terminal, and as rows of a file, the same for every command.

And answers from what `eagor look` has seen (``eagor track LOOKS.jsonl``): no detector runs, and no picture is read.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor._files import append_all, as_csv, redacted
from eagor.cli import terminal
from eagor.cli.checks import checked_out
from eagor.cli.options import Common, given
from eagor.cli.terminal import UsageError
from eagor.errors import StorageError

if TYPE_CHECKING:
    import numpy as np

    from eagor.live.in_turn import Followed
    from eagor.perception.recordings import HiddenParts, RecordedLooks, ThingSeen
    from eagor.tracking.config import TrackerConfig
    from eagor.tracking.estimate import Estimate

# --- on the terminal: at most 120 columns wide also with every method side by side ----------------------------------

# A rival's column shows azimuth/elevation in whole degrees, "-180/-90" at most; longer names are shortened to fit.
CELL = len("-180/-90")
SHORT = {
    "cent_circ": "circular", "eagor_paper": "paper", "best_detection": "bestdet", "last_detection": "lastdet",
    "grid_filter": "gridfilt", "particle_filter": "particle",
}  # fmt: skip


def header(rivals: Sequence[str] = (), several: bool = False) -> str:
    """The names of the columns, in the order of `line`.

    `rivals` are the other methods to compare with; of `several` queries each line has its own.
    """
    last = "  query" if several else ""
    if not rivals:
        ours = f"{'stamp':>10}{'azimuth':>9}{'elevation':>11}{'cone 90%':>10}{'distance 90%':>14}{'modes':>7}"
        return f"{ours}  {'status':{9 if several else 0}}{last}"
    ours = f"{'stamp':>9}{'azimuth':>8}{'elev':>6}{'cone':>6} {'status':9}"
    return (ours + "".join(f" {SHORT.get(name, name)[:CELL]:>{CELL}}" for name in rivals)).rstrip() + last


def line(frame: Followed, begins: float = 0.0, several: bool = False) -> str:
    """One frame as a line under `header`, its stamp counted from `begins`. "-" is what is not known.

    With other methods the distance and the number of candidates are left out.
    """
    from eagor.drawing.style import far_in_words, signed

    e, stamp = frame.estimate, frame.stamp - begins
    azimuth, elevation = signed(e.azimuth), signed(e.elevation)
    cone = "-" if e.direction is None else signed(e.credible_angle)[1:]
    if not frame.others:
        far = far_in_words(e) or "-"
        ours = f"{stamp:10.3f}{azimuth:>9}{elevation:>11}{cone:>10}{far:>14}{len(e.modes):>7}"
        return f"{ours}  {e.status:9}  {frame.query}" if several else f"{ours}  {e.status}"
    ours = f"{stamp:9.3f}{azimuth:>8}{elevation:>6}{cone:>6} {e.status:9}"
    ours += "".join(f" {_cell(direction):>{CELL}}" for direction in frame.others.values())
    return f"{ours}  {frame.query}" if several else ours


def in_words(e: Estimate, query: str, seconds: float) -> str:
    """The answer after so many seconds as a sentence."""
    from eagor.drawing.style import candidates_in_words, status_in_words

    said = f"at {seconds:.2f} s “{query}”: {candidates_in_words(e)}"
    return f"{said} ({e.status}: {status_in_words(e.status, e.presence)})"


def _cell(direction: np.ndarray | None) -> str:
    """A direction ``(3,)`` as azimuth/elevation in whole degrees; "-" for None."""
    if direction is None:
        return "-"
    azimuth, elevation = _angles(direction)
    return f"{azimuth:+.0f}/{elevation:+.0f}"


def _angles(direction: np.ndarray) -> tuple[float, float]:
    """Azimuth and elevation of a direction ``(3,)``, degrees."""
    import numpy as np

    from eagor.sphere import azimuth_elevation

    azimuth, elevation = np.degrees(azimuth_elevation(direction))
    return float(azimuth), float(elevation)


def methods_as_dict(directions: Mapping[str, np.ndarray]) -> dict[str, dict[str, float]]:
    """The directions ``(3,)`` of other methods, for ``--json`` and for files."""
    found = {name: _angles(direction) for name, direction in directions.items()}
    return {
        name: {"azimuth_deg": round(azimuth, 4), "elevation_deg": round(elevation, 4)}
        for name, (azimuth, elevation) in found.items()
    }


# --- in a file: CSV or JSON lines -----------------------------------------------------------------------------------

COLUMNS = (
    "frame", "stamp", "azimuth_deg", "elevation_deg", "credible_angle_deg", "presence", "distance_m", "distance_spread",
    "status", "looked_for",
)  # fmt: skip
SUFFIXES = (".csv", ".jsonl")

Entry = Mapping[str, Any]


class Lines:
    """A text file that grows by whole lines. The first line creates the file."""

    def __init__(self, path: Path) -> None:
        self.path, self._file = path, -1

    def add(self, text: str) -> None:
        """Append `text`. Raises `StorageError` if it cannot be written; the file is then as it was before."""
        data = redacted(text).encode("utf-8", "backslashreplace")
        try:
            if self._file < 0:
                self._file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
            append_all(self._file, data)
        except OSError as error:
            raise StorageError(
                f"{self.path} takes no more ({error.strerror or error}); {len(data)} bytes are needed. What was "
                "written before is intact. Make room, or name another place, then start again"
            ) from error

    def __enter__(self) -> Lines:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


@contextmanager
def table(path: Path, rivals: Sequence[str] = ()) -> Iterator[Callable[[Entry], None]]:
    """The file `path`; the yielded function adds one answer, as ``--json`` shows it. The first one creates the file.

    It is flushed after every answer. `rivals` are the other methods that the answers have under "methods". Raises
    `UsageError` before the first answer if the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(f"--out {path}: wanted a file name that ends in .csv or .jsonl")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"--out {path}: there is no folder {path.absolute().parent}; make it first")
    checked_out(path)
    columns = columns_of(rivals)
    with Lines(path) as file:
        head = [columns]

        def write(entry: Entry) -> None:
            if suffix == ".jsonl":
                file.add(json.dumps(entry) + "\n")
            else:
                file.add(as_csv([*head, row_of(entry, columns)], "\r\n"))
                head.clear()

        yield write


def columns_of(rivals: Sequence[str]) -> list[str]:
    """The columns of CSV; `modes` is the number of candidates."""
    angles = (f"{name}_{angle}_deg" for name in rivals for angle in ("azimuth", "elevation"))
    return [*COLUMNS, "modes", "problem", *angles]


def row_of(entry: Entry, columns: Sequence[str]) -> list[Any]:
    """The values of an answer in these columns; None where it has none."""
    flat = {**entry, "modes": len(entry["modes"]), "problem": entry.get("problem", "")}
    for name, found in entry.get("methods", {}).items():
        flat |= {f"{name}_{angle}": value for angle, value in found.items()}
    return [flat.get(name) for name in columns]


# --- from a file of looks ---------------------------------------------------------------------------------------------

# What belongs to footage: a file of looks has its poses and times, and no pictures.
_OF_FOOTAGE = (
    "poses", "rate", "start", "end", "image_topic", "odom_topic", "camera_info", "perception", "rig", "hfov", "camera",
    "force",
)  # fmt: skip
_OF_PICTURES = ("video", "fps", "page", "picture", "rerun")
_OF_ONE = ("out", "compare")


def recorded(options: Common, places: Sequence[Path]) -> RecordedLooks | None:
    """The file of looks that the one place is; None for footage.

    Raises `UsageError` for options that only footage has a use for, `FormatError` for a file that is none.
    """
    if len(places) != 1 or places[0].suffix.lower() != ".jsonl":
        return None
    from eagor.perception.recordings import RecordedLooks
    from eagor.perception.replay import ReplayPerception

    looks = RecordedLooks(ReplayPerception(places[0]))
    of = looks.about.of
    if wrong := given(options, _OF_FOOTAGE):
        raise UsageError(f"--{wrong[0].replace('_', '-')} is for footage; {places[0]} has its looks and poses")
    if wrong := given(options, _OF_PICTURES):
        name = "pictures" if wrong[0] == "picture" else wrong[0]
        raise UsageError(
            f"--{name} needs pictures, and {places[0]} holds none; draw over the footage with the same answers: eagor "
            f"track {of} QUERY --perception replay:{places[0]} --{name} ..."
        )
    return looks


def list_seen(options: Common, looks: RecordedLooks, config: TrackerConfig, hidden: HiddenParts, modes: int) -> int:
    """Print what was seen where, the surest first; returns the exit code."""
    from eagor.perception.recordings import asked_for, things_seen

    if wrong := given(options, _OF_ONE):
        raise UsageError(f"--{wrong[0]} is for one question: eagor track {looks.replay.name} QUERY --{wrong[0]}")
    footage, queries = looks.about, asked_for(looks.replay)
    with terminal.progress("adding up", len(queries), shown=not options.json) as advance:
        found = things_seen(looks, config, hidden, advance)
    if options.json:
        about_it = {"of": footage.of, "perception": footage.perception, "poses": footage.poses}
        terminal.emit(about_it | {"things": entries(found, modes)})
    else:
        say_things(found, footage.perception, footage.of, footage.begins)
    return terminal.OK


def say_things(found: Sequence[ThingSeen], perception: str, source: str, begins: float) -> None:
    """Print a table of all that was seen in a source, which `begins` at this stamp; one line where that is nothing."""
    if not found:
        terminal.say(f"{perception} saw nothing in {source}")
        return
    end = found[0].estimate.stamp - begins
    terminal.say(f"seen in {source} by {perception}; directions are those of the camera at {end:.2f} s")
    terminal.say(f"{'thing':<16}{'azimuth':>9}{'elevation':>11}{'cone 90%':>10}{'sure':>7}{'presence':>10}{'looks':>9}"
                 f"{'last seen':>11}  status")  # fmt: skip
    terminal.say(*(_line(each, begins) for each in found))


def entries(found: Sequence[ThingSeen], modes: int) -> list[dict[str, Any]]:
    """The same for JSON, each with at most so many candidates."""
    return [_entry(each, modes) for each in found]


def _line(thing: ThingSeen, begins: float) -> str:
    from eagor.drawing.style import signed

    e = thing.estimate
    cone = "-" if e.direction is None else signed(e.credible_angle)[1:]
    many = f"{thing.looks}/{thing.among}"
    return (
        f"{thing.query:<16}{signed(e.azimuth):>9}{signed(e.elevation):>11}{cone:>10}{100 * thing.sure:>5.0f} %"
        f"{100 * e.presence:>8.0f} %{many:>9}{thing.last - begins:>11.2f}  {e.status}"
    )


def _entry(thing: ThingSeen, modes: int) -> dict[str, Any]:
    from eagor.perception.recordings import NEAR

    near = round(math.degrees(NEAR))
    about = {"query": thing.query, **thing.estimate.as_dict(modes, near)}
    return about | {"seen_in": thing.looks, "looks": thing.among, "last_seen": thing.last}
