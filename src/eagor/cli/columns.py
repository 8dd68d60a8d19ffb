"""The table of ``eagor track``: one line per frame, at most 120 columns wide also with every method side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from eagor.drawing.words import distance_in_words, signed
from eagor.sphere import azimuth_elevation
from eagor.tracking.estimate import Estimate

# A rival's column shows azimuth/elevation in whole degrees, "-180/-90" at most; longer names are shortened to fit.
CELL = len("-180/-90")
SHORT = {
    "cent_circ": "circular", "eagor_paper": "paper", "best_detection": "bestdet", "last_detection": "lastdet",
    "grid_filter": "gridfilt", "particle_filter": "particle",
}  # fmt: skip


class Row(Protocol):
    """One frame: its `stamp` (seconds), our estimate, and other methods' directions ``(3,)`` by name, None if unknown.

    `distance` (metres) and `distance_spread` (standard deviation of its logarithm) are None if they are not known.
    """

    @property
    def stamp(self) -> float: ...
    @property
    def estimate(self) -> Estimate: ...
    @property
    def distance(self) -> float | None: ...
    @property
    def distance_spread(self) -> float | None: ...
    @property
    def others(self) -> Mapping[str, np.ndarray | None]: ...


def header(rivals: Sequence[str] = ()) -> str:
    """The names of the columns; `rivals` are the other methods to compare with, in the order of `line`."""
    if not rivals:
        return f"{'stamp':>10}{'azimuth':>9}{'elevation':>11}{'cone 90%':>10}{'distance 90%':>14}{'modes':>7}  status"
    ours = f"{'stamp':>9}{'azimuth':>8}{'elev':>6}{'cone':>6} {'status':9}"
    return (ours + "".join(f" {SHORT.get(name, name)[:CELL]:>{CELL}}" for name in rivals)).rstrip()


def line(row: Row) -> str:
    """One frame as a line under `header`. "-" is what is not known.

    With other methods the distance and the number of candidates are left out.
    """
    e = row.estimate
    azimuth, elevation = signed(e.azimuth), signed(e.elevation)
    cone = "-" if e.direction is None else signed(e.credible_angle)[1:]
    if not row.others:
        far = distance_in_words(row.distance, row.distance_spread)
        return f"{row.stamp:10.3f}{azimuth:>9}{elevation:>11}{cone:>10}{far:>14}{len(e.modes):>7}  {e.status}"
    ours = f"{row.stamp:9.3f}{azimuth:>8}{elevation:>6}{cone:>6} {e.status:9}"
    return ours + "".join(f" {_cell(direction):>{CELL}}" for direction in row.others.values())


def _cell(direction: np.ndarray | None) -> str:
    """A direction ``(3,)`` as azimuth/elevation in whole degrees."""
    if direction is None:
        return "-"
    azimuth, elevation = np.degrees(azimuth_elevation(direction))
    return f"{azimuth:+.0f}/{elevation:+.0f}"
