"""A simulated task: an environment with its rules, the measures of a method, and the columns of the table.

Packages add theirs under the entry-point group ``eagor.tasks``; `eagor.lab.tasks.sim.checking.check_task` tests them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from eagor import metrics, plugins
from eagor.errors import EagorError

if TYPE_CHECKING:
    from eagor.lab.envs.episodes import Episode
    from eagor.lab.envs.place_env import PlaceEnv
    from eagor.lab.envs.rules import Camera

GROUP = "eagor.tasks"
BUILT_IN = {
    "waypoint": "eagor.lab.tasks.sim.waypoint:WAYPOINT",
    "navigation": "eagor.lab.tasks.sim.navigation:NAVIGATION",
    "tracking": "eagor.lab.tasks.sim.tracking:TRACKING",
}


@dataclass(frozen=True)
class Column:
    """A column of a task's table: statistics of the records' `metric` times `scale`.

    `better` is "low", "high", or None if neither. `share`: the metric is 0 or 1, so its interval is one of a share.
    `only_if`: count only episodes whose metric of this name is above 0. `why`: why a worse method can look better here.
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
    over: ClassVar[None] = None

    def of(self, record: Mapping[str, Any], method: str | None) -> float | None:
        """The figure of `method` in a record, in `unit`; None where there is no case."""
        metrics = record["methods"][method]["metrics"] if method in record["methods"] else {}
        value = metrics.get(self.metric)
        if value is None or (self.only_if and not metrics.get(self.only_if)):
            return None
        return self.scale * float(value)


# Of several of the built-in tasks.
COVERAGE = Column(
    "coverage", "Coverage", "%", None, "coverage", "share of steps with the truth inside the 90 % region; 90 is right",
    scale=100.0,
)  # fmt: skip
JUMP = "jump of the estimate from step to step that the true motion does not explain"
CALM = "an estimate that hardly moves hardly jumps: compare the errors, too"


@dataclass(frozen=True, eq=False)
class EpisodeResult:
    """The results of one method in one episode of n steps, for `Task.measure`.

    - `truth`: lists of n values: pose, azimuth_deg, elevation_deg, range_m, visible, present, optionally leg. For a
      walked task they are in `trace`, with the prefix true_.
    - `trace`: lists of n values: azimuth_deg, elevation_deg, error_deg (None while the target is away), mass_above,
      inside, distance_m.
    - `directions`, `estimates` ``(n, 3)``: the true ones (held while the target is away) and the method's, body frame.
    - `rotations` ``(n - 1, 3, 3)``, `translations` ``(n - 1, 3)``: the camera's true motions
      (`eagor.metrics.ego_motion`).
    - `info`: the environment's last one; metres `walked` and `shortest`. Only for a walked task.
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
        """The share of steps with the truth inside the stated 90 % region; None for methods without regions."""
        inside = [value for value in self.trace["inside"] if value is not None]
        return metrics.credible_coverage(inside) if inside else None


@dataclass(frozen=True, eq=False)
class Task:
    """A simulated task.

    - `name`: for typing; `title`: for tables; `what`: one line for ``eagor bench list``.
    - `environment`: a subclass of `PlaceEnv` that takes rules, camera, disturbances and panorama; its `plan` makes the
      episode of a spec. `rules`: a frozen dataclass of plain values, each with a default.
    - `measure`: the figures of one method in one episode; None where one does not apply. `columns`: of the table;
      `headline`: the key of the most important one; `strata`: keys of `Episode.stratum` to report separately, and
      their titles.
    - `listed`: makes the episode of a file (`eagor.lab.envs.episodes`) of the spec, the file, the camera and the
      rules; None where the task takes no such files. `rules` then has ``objectnav()``: Habitat's.
    - `walked`: the estimate steers the body, so each method plays alone: `step` takes (heading, distance), and
      success, spl and mae are among its figures. Otherwise all methods get the same evidence.
    """

    name: str
    title: str
    what: str
    environment: Callable[..., PlaceEnv]
    rules: type
    measure: Callable[[EpisodeResult], Mapping[str, Any]]
    columns: tuple[Column, ...]
    headline: str
    strata: Mapping[str, str] = field(default_factory=dict)
    walked: bool = False
    listed: Callable[..., Episode] | None = None


def known() -> dict[str, EntryPoint]:
    """The tasks that `load` can make, by name. Imports none of them."""
    return plugins.known(GROUP, BUILT_IN)


def load(name: str) -> Task:
    """The task with this name. Raises `EagorError` if it is unknown or cannot be imported."""
    choices = known()
    if name not in choices:
        raise EagorError(f"there is no task {name!r}; known are {', '.join(choices)}")
    found = plugins.bring(choices[name], "task")
    plugins.check_named(found, choices[name], "task", Task)
    return found
