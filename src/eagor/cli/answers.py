"""Answers about frames: as lines of a table on the terminal, and as rows of a file, the same for every command."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor._tables import as_csv
from eagor.cli.checks import checked_out
from eagor.cli.terminal import UsageError

if TYPE_CHECKING:
    import numpy as np

    from eagor.perception.footage import FollowedFrame

# --- on the terminal: at most 120 columns wide also with every method side by side ----------------------------------

# A rival's column shows azimuth/elevation in whole degrees, "-180/-90" at most; longer names are shortened to fit.
CELL = len("-180/-90")
SHORT = {
    "cent_circ": "circular", "eagor_paper": "paper", "best_detection": "bestdet", "last_detection": "lastdet",
    "grid_filter": "gridfilt", "particle_filter": "particle",
}  # fmt: skip


def header(rivals: Sequence[str] = ()) -> str:
    """The names of the columns; `rivals` are the other methods to compare with, in the order of `line`."""
    if not rivals:
        return f"{'stamp':>10}{'azimuth':>9}{'elevation':>11}{'cone 90%':>10}{'distance 90%':>14}{'modes':>7}  status"
    ours = f"{'stamp':>9}{'azimuth':>8}{'elev':>6}{'cone':>6} {'status':9}"
    return (ours + "".join(f" {SHORT.get(name, name)[:CELL]:>{CELL}}" for name in rivals)).rstrip()


def line(frame: FollowedFrame, begins: float = 0.0) -> str:
    """One frame as a line under `header`, its stamp counted from `begins`. "-" is what is not known.

    With other methods the distance and the number of candidates are left out.
    """
    from eagor.drawing.style import far_in_words, signed

    e, stamp = frame.estimate, frame.stamp - begins
    azimuth, elevation = signed(e.azimuth), signed(e.elevation)
    cone = "-" if e.direction is None else signed(e.credible_angle)[1:]
    if not frame.others:
        far = far_in_words(e) or "-"
        return f"{stamp:10.3f}{azimuth:>9}{elevation:>11}{cone:>10}{far:>14}{len(e.modes):>7}  {e.status}"
    ours = f"{stamp:9.3f}{azimuth:>8}{elevation:>6}{cone:>6} {e.status:9}"
    return ours + "".join(f" {_cell(direction):>{CELL}}" for direction in frame.others.values())


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


# --- in a file: CSV, JSON lines or Parquet --------------------------------------------------------------------------

COLUMNS = (
    "frame", "stamp", "azimuth_deg", "elevation_deg", "credible_angle_deg", "presence", "distance_m", "distance_spread",
    "status",
)  # fmt: skip
SUFFIXES = (".csv", ".jsonl", ".parquet")

Entry = Mapping[str, Any]


@contextmanager
def table(path: Path, rivals: Sequence[str] = ()) -> Iterator[Callable[[Entry], None]]:
    """The file `path`; the yielded function adds one answer, as ``--json`` shows it. The first one creates the file.

    CSV and JSON lines are flushed after every answer. A Parquet file is written at the end, also if the run fails.
    `rivals` are the other methods that the answers have under "methods". Raises `UsageError` if the file cannot be
    written, `MissingExtraError` for Parquet without pyarrow, both before the first answer.
    """
    from eagor._files import Lines, written
    from eagor._tables import as_parquet, need_parquet

    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(f"--out {path}: wanted a file name that ends in .csv, .jsonl or .parquet")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"--out {path}: there is no folder {path.absolute().parent}; make it first")
    checked_out(path)
    columns = columns_of(rivals)
    if suffix == ".parquet":
        need_parquet()
        rows: list[list[Any]] = []
        try:
            yield lambda entry: rows.append(row_of(entry, columns))
        finally:
            if rows:
                written(path, as_parquet(columns, rows))
        return
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
    """The columns of CSV and Parquet; `modes` is the number of candidates."""
    angles = (f"{name}_{angle}_deg" for name in rivals for angle in ("azimuth", "elevation"))
    return [*COLUMNS, "modes", "problem", *angles]


def row_of(entry: Entry, columns: Sequence[str]) -> list[Any]:
    """The values of an answer in these columns; None where it has none."""
    flat = {**entry, "modes": len(entry["modes"]), "problem": entry.get("problem", "")}
    for name, found in entry.get("methods", {}).items():
        flat |= {f"{name}_{angle}": value for angle, value in found.items()}
    return [flat.get(name) for name in columns]
