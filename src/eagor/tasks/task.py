"""A simulated task: what `eagor bench run` has to know of one, and nothing more.

A task is a `Task`: an environment with its rules, what is measured of a method that has played an episode, and the
columns of the table. `load` finds one by its name, and packages add their own under the entry-point group
``eagor.tasks`` (a name, and the `Task`). `eagor.tasks.checking.check_task` is the test that every one of them has to
pass. Perceptions, methods, the ledger, workers, intervals, comparisons and reports are the same for all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor import metrics, plugins
from eagor.errors import EagorError

if TYPE_CHECKING:
    from eagor.tasks.place_env import PlaceEnv
    from eagor.tasks.rules import Camera

GROUP = "eagor.tasks"
BUILT_IN = {
    "waypoint": "eagor.tasks.simulated:WAYPOINT",
    "navigation": "eagor.tasks.simulated:NAVIGATION",
    "tracking": "eagor.tasks.simulated:TRACKING",
}


@dataclass(frozen=True)
class Column:
    """A column of a task's table.

    `metric` is the name in the records' metrics; figures there times `scale` are what is shown. `better` is "low",
    "high", or None where neither is better. `share`: the metric is 0 or 1 per episode, so its interval is Wilson's.
    `only_if`: count only episodes whose metric of this name is above 0. `why`: what makes a method that is worse in all
    other columns better in this one, for where ours is behind.
    """

    key: str
    title: str
    unit: str
    better: str | None
    metric: str
    what: str
    scale: float = 1.0
    digits: int = 1
    share: bool = False
    only_if: str | None = None
    why: str = ""


@dataclass(frozen=True, eq=False)
class Played:
    """What one method did in one episode of n steps.

    - `truth`: lists of n values: pose, azimuth_deg, elevation_deg, range_m, visible, present, and leg where the
      environment tells of legs. Of a task that is walked they are in `trace`, with true_ before their names.
    - `trace`: lists of n values: azimuth_deg, elevation_deg, error_deg (None while the target is away), mass_above,
      inside, distance_m.
    - `directions` and `estimates` ``(n, 3)``: the true ones (held while the target is away) and the method's, body
      frame.
    - `rotations` ``(n - 1, 3, 3)`` and `translations` ``(n - 1, 3)``: the camera's true motions, as
      `eagor.metrics.ego_motion` gives them.
    - `info`: the environment's last one; `walked`: metres that the body has gone; `shortest`: the episode's, metres.
      Nothing of a task that is not walked, where they are the same for all methods.
    """

    truth: dict[str, list[Any]]
    trace: dict[str, list[Any]]
    directions: np.ndarray
    estimates: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray
    rules: Any
    camera: Camera
    info: Mapping[str, Any] = field(default_factory=dict)
    walked: float = 0.0
    shortest: float = math.inf

    @property
    def coverage(self) -> float | None:
        """The share of steps with the truth inside the stated 90 % region; None for methods that state none."""
        inside = [value for value in self.trace["inside"] if value is not None]
        return metrics.credible_coverage(inside) if inside else None


@dataclass(frozen=True, eq=False)
class Task:
    """A simulated task.

    Attributes:
        name: as typed, in lower-case letters, digits and dashes.
        title: of tables.
        what: one line for ``eagor bench list``.
        environment: a subclass of `PlaceEnv` (of `AnsweringEnv`, mostly) that takes rules, camera, disturbances and
            panorama by name; its `plan` says what the episode of a slot is.
        rules: a frozen dataclass of plain numbers, texts and tuples, each with a default; every report prints them.
        measure: the figures of one method in one episode, by name; None where there is no case.
        columns: of the table.
        headline: the key of the column that says most.
        strata: kinds of episode to be reported apart: keys of `Episode.stratum`, with what they are called.
        walked: whether the estimate decides where the body goes, so that each method plays alone: `step` then takes
            (heading, distance), as `MapFreeNavigationEnv` does, and success, spl and mae are among its figures. Else
            the camera goes its way whatever is answered, and all methods get the same evidence.
    """

    name: str
    title: str
    what: str
    environment: Callable[..., PlaceEnv]
    rules: type
    measure: Callable[[Played], Mapping[str, Any]]
    columns: tuple[Column, ...]
    headline: str
    strata: Mapping[str, str] = field(default_factory=dict)
    walked: bool = False


def known() -> dict[str, EntryPoint]:
    """The tasks that `load` knows by name; nothing is imported yet."""
    return plugins.known(GROUP, BUILT_IN)


def load(name: str) -> Task:
    """The task with this name. Raises `EagorError` for an unknown one, or one that cannot be imported."""
    choices = known()
    if name not in choices:
        raise EagorError(f"there is no task {name!r}; known are {', '.join(choices)}")
    found = plugins.bring(choices[name], "task")
    plugins.check_named(found, choices[name], "task", Task)
    return found
