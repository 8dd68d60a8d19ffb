"""Answers about frames: lines of a table on the terminal, rows of a file, pictures; the same for every command.

And what `eagor look` has seen (``eagor track LOOKS.jsonl``): no detector runs, and no picture is read.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor._files import append_all, redacted, write_atomic
from eagor.cli import terminal
from eagor.cli.options import Answering, Common, Footage, refuse
from eagor.cli.terminal import UsageError
from eagor.errors import StorageError

if TYPE_CHECKING:
    import numpy as np
    from PIL import Image

    from eagor.live.in_turn import Followed
    from eagor.perception.replay import RecordedLooks
    from eagor.tracking.config import TrackerConfig
    from eagor.tracking.estimate import Estimate

# --- on the terminal: at most 120 columns wide also with every method side by side ----------------------------------

NEAR = 15  # degrees: the error that still leads a person to the object
ALONE = "{:>10}{:>9}{:>11}{:>10}{:>14}{:>7}  {:9}  {}"
COMPARED = "{:>9}{:>8}{:>6}{:>6} {:9}{}  {}"  # distance and number of candidates are left out
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
    last = "query" if several else ""
    if not rivals:
        names = "stamp", "azimuth", "elevation", "cone 90%", "distance 90%", "modes", "status"
        return ALONE.format(*names, last).rstrip()
    beside = "".join(f" {SHORT.get(name, name)[:CELL]:>{CELL}}" for name in rivals)
    return COMPARED.format("stamp", "azimuth", "elev", "cone", "status", beside, last).rstrip()


def line(frame: Followed, begins: float = 0.0, several: bool = False) -> str:
    """One frame as a line under `header`, its stamp counted from `begins`. "-" is what is not known."""
    from eagor.drawing.style import far_in_words

    e, last = frame.estimate, frame.query if several else ""
    ours = f"{frame.stamp - begins:.3f}", *_signed(e)
    if not frame.others:
        return ALONE.format(*ours, far_in_words(e) or "-", len(e.modes), e.status, last).rstrip()
    cells = ("-" if each is None else "{:+.0f}/{:+.0f}".format(*_angles(each)) for each in frame.others.values())
    return COMPARED.format(*ours, e.status, "".join(f" {cell:>{CELL}}" for cell in cells), last).rstrip()


def in_words(e: Estimate, query: str, seconds: float) -> str:
    """The answer after so many seconds as a sentence."""
    from eagor.drawing.style import candidates_in_words, status_in_words

    said = f"at {seconds:.2f} s “{query}”: {candidates_in_words(e)}"
    return f"{said} ({e.status}: {status_in_words(e.status, e.presence)})"


def _signed(e: Estimate) -> tuple[str, str, str]:
    """Azimuth, elevation, and the half-angle of the cone that holds 90 %, in degrees."""
    from eagor.drawing.style import signed

    return signed(e.azimuth), signed(e.elevation), "-" if e.direction is None else signed(e.credible_angle)[1:]


def _angles(direction: np.ndarray) -> list[float]:
    """Azimuth and elevation of a direction ``(3,)``, degrees."""
    from eagor.sphere import azimuth_elevation

    return [math.degrees(angle) for angle in azimuth_elevation(direction)]


# --- in a file: CSV or JSON lines -----------------------------------------------------------------------------------

COLUMNS = (
    "frame", "stamp", "azimuth_deg", "elevation_deg", "credible_angle_deg", "presence", "distance_m", "distance_spread",
    "status", "looked_for",
)  # fmt: skip

Entry = Mapping[str, Any]


def entry_of(result: Followed, modes: int) -> dict[str, Any]:
    """A frame for ``--json`` and for files, with at most so many candidates."""
    entry = {"query": result.query, "frame": result.frame, **result.estimate.as_dict(modes), "stamp": result.stamp}
    entry["looks"] = len(result.evidence)
    more = {"lost": result.lost or None, "problem": result.problem}
    more["methods"] = {
        name: dict(zip(("azimuth_deg", "elevation_deg"), (round(angle, 4) for angle in _angles(each)), strict=True))
        for name, each in result.others.items()
    } or None
    return entry | {name: value for name, value in more.items() if value is not None}


@contextmanager
def appended(path: Path) -> Iterator[Callable[[str], None]]:
    """A text file that grows by whole lines, which the yielded function takes. The first creates the file.

    It raises `StorageError` if they cannot be written; the file is then as it was before.
    """
    with ExitStack() as stack:
        files: list[int] = []

        def add(text: str) -> None:
            data = redacted(text).encode("utf-8", "backslashreplace")
            try:
                if not files:
                    files.append(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644))
                    stack.callback(os.close, files[0])
                append_all(files[0], data)
            except OSError as error:
                raise StorageError(
                    f"{path} takes no more ({error.strerror or error}); {len(data)} bytes are needed. What was "
                    "written before is intact. Make room, or name another place, then start again"
                ) from error

        yield add


@contextmanager
def table(path: Path, rivals: Sequence[str] = ()) -> Iterator[Callable[[Entry], None]]:
    """The file `path`; the yielded function adds one answer, as ``--json`` shows it. The first one creates the file.

    It is flushed after every answer. `rivals` are the other methods that the answers have under "methods". Raises
    `UsageError` before the first answer if the file cannot be written. In CSV, `modes` is the number of candidates.
    """
    suffix = path.suffix.lower()
    if not path.absolute().parent.is_dir():
        raise UsageError(f"--out {path}: there is no folder {path.absolute().parent}; make it first")
    columns = [*COLUMNS, "modes", "problem"]
    columns += [f"{name}_{angle}_deg" for name in rivals for angle in ("azimuth", "elevation")]
    head = [columns]
    with appended(path) as add:

        def write(entry: Entry) -> None:
            if suffix == ".jsonl":
                add(json.dumps(entry) + "\n")
                return
            flat = {**entry, "modes": len(entry["modes"]), "problem": entry.get("problem", "")}
            for name, found in entry.get("methods", {}).items():
                flat |= {f"{name}_{angle}": value for angle, value in found.items()}
            add(as_csv([*head, [flat.get(name) for name in columns]]))
            head.clear()

        yield write


def as_csv(rows: Iterable[Sequence[Any]]) -> str:
    """`rows` as CSV. Text that a spreadsheet would take for a formula gets an apostrophe before it."""
    text = io.StringIO(newline="")
    csv.writer(text).writerows(map(_cell, row) for row in rows)
    return text.getvalue()


def _cell(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    value = value.replace("\r", "\n")  # the writer does not always quote \r, which would start a new row
    try:
        float(value)
    except ValueError:
        return f"'{value}" if value.startswith(("=", "+", "-", "@", "\t", "\n")) else value
    return value


# --- in pictures ------------------------------------------------------------------------------------------------------


def draw(result: Followed, path: Path, most: int, when: str = "", mosaic: Any = None) -> None:
    """Draw the belief over the frame of a result, with at most so many candidates; `when`: words for the title.

    `mosaic`: what an ordinary camera was shown before. Raises `StorageError`.
    """
    from eagor.drawing import draw_belief
    from eagor.drawing.style import answer_in_words

    e = result.estimate
    assert result.picture is not None
    drawn = draw_belief(
        result.picture, e, title=f"“{result.query}”{when}: {answer_in_words(e)} ({e.status})", grid=result.grid,
        modes=[mode.direction for mode in e.modes[:most]], mosaic=mosaic,
        others={name: result.others[name] for name in ("centroid", "eagor_paper") if name in result.others},
    )  # fmt: skip
    save_image(drawn, path)


def save_image(picture: Image.Image, path: Path) -> None:
    """Write a picture atomically, in the format of its name. Raises `StorageError`."""
    from PIL import Image

    buffer = io.BytesIO()
    picture.save(buffer, Image.registered_extensions()[path.suffix.lower()])
    write_atomic(path, buffer.getvalue())


# --- from a file of looks: it has poses, times and the answers of a detector, and no pictures ------------------------


def recorded(options: Footage, places: Sequence[Path]) -> RecordedLooks | None:
    """The file of looks that the one place is; None for footage.

    Raises `UsageError` for options that only footage has a use for, `FormatError` for a file that is none.
    """
    if len(places) != 1 or places[0].suffix.lower() != ".jsonl":
        return None
    from eagor.perception.replay import RecordedLooks, ReplayPerception

    looks, common = RecordedLooks(ReplayPerception(file := places[0])), {each.name for each in fields(Common)}
    of_footage = ["perception", *(each.name for each in fields(Footage) if each.name not in common)]
    refuse(options, of_footage, f"is for footage; {file} has its looks and poses")
    over = f"eagor track {looks.about.of} QUERY --perception replay:{file}"
    why = f"needs pictures, and {file} holds none; draw over the footage with the same answers: {over}"
    refuse(options, ("video", "fps", "page", "pictures", "rerun"), why)
    return looks


def list_seen(options: Answering, looks: RecordedLooks, config: TrackerConfig) -> int:
    """Print what was seen where, the surest first; returns the exit code."""
    from eagor.cli.checks import mask_of
    from eagor.live.objects import summarise_objects

    refuse(options, ("out", "compare"), f"is for one question: eagor track {looks.replay.name} QUERY")
    about, queries, mask = looks.about, looks.asked_for(), mask_of(options.mask)
    with terminal.progress("adding up", len(queries), shown=not options.json) as advance:
        found = summarise_objects(looks, config, [mask] if mask else [], advance)
    form, things = "{:<16}{:>9}{:>11}{:>10}{:>7}{:>10}{:>9}{:>11}  {}", []
    heads = "thing", "azimuth", "elevation", "cone 90%", "sure", "presence", "looks", "last seen", "status"
    lines = [form.format(*heads)]
    for each in found:
        e, counts = each.estimate, {"seen_in": each.looks, "looks": each.among, "last_seen": each.last}
        things.append({"query": each.query, **e.as_dict(options.modes, NEAR), **counts})
        sure, present = f"{100 * each.sure:.0f} %", f"{100 * e.presence:.0f} %"
        share, last = f"{each.looks}/{each.among}", f"{each.last - about.begins:.2f}"
        lines.append(form.format(each.query, *_signed(e), sure, present, share, last, e.status))
    if not found:
        lines = [f"{about.perception} saw nothing in {about.of}"]
    else:
        end = f"directions are those of the camera at {found[0].estimate.stamp - about.begins:.2f} s"
        lines.insert(0, f"seen in {about.of} by {about.perception}; {end}")
    told = {"of": about.of, "perception": about.perception, "poses": about.poses, "things": things}
    return terminal.give(options.json, told, *lines)
