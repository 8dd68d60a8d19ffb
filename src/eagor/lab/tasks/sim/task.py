"""What simulated tasks share: an environment with rules, methods that play its episodes, the metrics of each method.

Every method that `config.methods` names plays each episode. Where the answer steers the body (`SimTask.walked`) each
goes its own way, and an episode is one sample per method; else all methods get the same evidence.
`eagor.lab.tasks.sim.rollout.check_simulation` tests a task.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import msgspec
import numpy as np
from msgspec import Meta

from eagor._values import lazy
from eagor._version import __version__
from eagor.errors import EagorError
from eagor.lab.agents.methods import ORACLE, default_methods, fitted, make_estimator
from eagor.lab.envs.episodes import EpisodeSpec, episode_specs
from eagor.lab.envs.places import APARTMENT, DEVELOPMENT
from eagor.lab.envs.rules import Camera, NoiseModel
from eagor.lab.tasks.task import Metric, Payload, Record, Sample

if TYPE_CHECKING:
    from eagor.lab.envs.place_env import PlaceEnv
    from eagor.lab.tasks.sim.rollout import Rollout

RANKED = ("success", "spl", "mae")  # figures that every walked task measures
OURS = "eagor"  # the method whose answer decides whether an episode is a failure, where it has played

COVERAGE = Metric(
    "coverage", "Coverage", "share of steps with the truth inside the 90 % region; 90 is right", better=None
)  # of several of the built-in tasks
JUMP = "jump of the estimate from step to step that the true motion does not explain"
CALM = "an estimate that hardly moves hardly jumps: compare the errors, too"


class SimConfig(msgspec.Struct, kw_only=True):
    """The settings of a run; `SimTask.Config` has the rules of the task."""

    task: str
    perception: Annotated[str, Meta(description="detector on the rendered pictures")] = "scout"
    episodes: Annotated[int, Meta(description="number of episodes, five in each apartment")] = 20
    seed: Annotated[int, Meta(ge=0, description="first apartment")] = 2000
    development: Annotated[bool, Meta(description="whether parameters were chosen on these apartments")] = False
    methods: list[str] = []
    fitted: dict[str, str] = {}
    world: Annotated[str, Meta(description="apartment, an installed world, or a GLB file")] = APARTMENT
    rows: Annotated[int | None, Meta(description="of the rendered panoramas")] = None
    rules: Any = None
    camera: Camera = msgspec.field(default_factory=Camera)
    disturbances: NoiseModel = msgspec.field(default_factory=NoiseModel)
    calibrated: dict[str, Any] | None = None
    versions: dict[str, str] = {}


Number = Annotated[float, Meta(ge=-1e12, le=1e12)]  # what is measured is never as large, and sums stay finite
Figure = Number | bool | None
Count = Annotated[int, Meta(ge=0)]
Columns = dict[str, Annotated[list[Figure | str | list[Number]], Meta(min_length=1)]]  # a value for each step
POSE = 7  # x, y, z, and the quaternion w, x, y, z
SAID = ("azimuth_deg", "elevation_deg", "error_deg")
TRUE = ("pose", "azimuth_deg", "elevation_deg", "range_m", "visible", "seam")
WALKED = ("pose", "true_azimuth_deg", "true_range_m", "visible")


class EpisodeInRecord(msgspec.Struct, kw_only=True):
    """Which episode a record is of."""

    id: str
    query: str
    targets: list[Count]
    seed: Count | None = None
    scene: str = ""
    scene_hash: str = ""
    world: str = ""
    stratum: dict[str, str | bool | Number] = {}
    balls: list[tuple[Number, Number, Number] | None] | None = None
    radius: Number = 0.0


class MethodRecord(msgspec.Struct, kw_only=True):
    """What one method said at each step (`trace`), and its figures."""

    metrics: dict[str, Figure]
    trace: Columns
    looked: dict[str, Any] | None = None


class SimRecord(msgspec.Struct, kw_only=True):
    """The record of an episode; without `truth` each method went its own way."""

    episode: EpisodeInRecord
    methods: dict[str, MethodRecord]
    truth: Columns | None = None
    looked: dict[str, Any] | None = None
    seconds: Number | None = None

    def __post_init__(self) -> None:
        for name, result in self.methods.items():
            alone = self.truth is None
            columns = result.trace | {f"truth/{key}": value for key, value in (self.truth or {}).items()}
            wanted = SAID + (WALKED if alone else tuple(f"truth/{key}" for key in TRUE))
            lacks = [key for key in wanted if key not in columns]
            lacks += [key for key in (RANKED if alone else ()) if result.metrics.get(key) is None]
            if lacks:
                raise ValueError(f"{name} has no {', '.join(lacks)}{', and the record no truth' if alone else ''}")
            if len(counts := {len(column) for column in columns.values()}) > 1:
                raise ValueError(f"the lists of {name} are of different lengths ({sorted(counts)})")
            poses: Any = columns["pose" if alone else "truth/pose"]
            if not all(isinstance(pose, list) and len(pose) == POSE and any(pose[3:]) for pose in poses):
                raise ValueError(f"a pose of {name} is none: three numbers, and a quaternion that is a rotation")


@dataclass(frozen=True, eq=False)
class SimTask:
    """A simulated task; see `eagor.lab.tasks.task.Task`.

    - `environment`: a subclass of `PlaceEnv` that takes rules, camera, disturbances and panorama; its `plan` makes the
      episode of a spec. `rules`: a frozen dataclass of plain values, each with a default.
    - `measure`: the figures of one method in one episode; None where one does not apply. `headline`: the key of the
      most important metric; `ranked_by`: those that rank episodes; `strata`: keys of `Episode.stratum` to report
      separately, and their titles.
    - `walked`: the estimate steers the body, so each method plays alone: `step` takes (heading, distance), and
      success, spl and mae are among its figures. Otherwise all methods get the same evidence.
    """

    name: str
    title: str
    what: str
    environment: Callable[..., PlaceEnv]
    rules: type
    measure: Callable[[Rollout], Mapping[str, Any]]
    metrics: tuple[Metric, ...]
    headline: str
    ranked_by: tuple[str, ...] = ()
    strata: Mapping[str, str] = field(default_factory=dict)
    walked: bool = False
    case: ClassVar[str] = "episode"
    Record: ClassVar[type[msgspec.Struct]] = SimRecord

    @lazy
    def Config(self) -> type[SimConfig]:
        """`SimConfig` with the rules of this task."""
        rules: Any = ("rules", self.rules, msgspec.field(default_factory=self.rules))
        made: Any = msgspec.defstruct("Config", [rules], bases=(SimConfig,), kw_only=True)
        return made

    def samples(self, config: Any) -> list[Sample]:
        played = [(f"/{name}", [name]) for name in config.methods] if self.walked else [("", list(config.methods))]
        return [
            Sample(spec.id + end, str(spec.seed), {"slot": asdict(spec), "methods": names})
            for spec in episode_specs(config.task, config.episodes, config.seed, config.world)
            for end, names in played
        ]

    def runner(self, config: Any) -> Callable[[Payload], Record]:
        from eagor.lab.tasks.sim.rollout import Runner

        runner = Runner(config, kind=self)
        return lambda payload: runner.run_episode(EpisodeSpec(**payload["slot"]), payload["methods"])

    def failure(self, record: Record) -> str | None:
        """Of a walked task: that the target was not reached by ours, or by the method that played alone."""
        if not self.walked:
            return None
        result = record["methods"].get(OURS) or next(iter(record["methods"].values()))
        missed = "not reached" if any(result["trace"]["visible"]) else "never in sight"
        return None if result["metrics"]["success"] else missed

    def resolve(self, config: Any) -> Any:
        """The config with all that follows from it. Raises `EagorError` for what does not exist or cannot be played."""
        from eagor.lab import worlds
        from eagor.lab.agents.models import shared
        from eagor.lab.worlds.apartment import VERSION
        from eagor.perception import rows_of

        names = list(config.methods) or list(default_methods(config.perception))
        for name in (each for each in names if each != ORACLE or not self.walked):
            make_estimator(name, np.random.default_rng(0))  # complains about unknown ones
        if len(set(names)) != len(names):
            raise EagorError(f"methods {names}; wanted each once")
        seeds = [spec.seed for spec in episode_specs(config.task, config.episodes, config.seed, config.world)]
        made = worlds.load(config.world)
        scene = None if config.world in worlds.known() else made(0)  # a bad file is no failure of every episode
        if isinstance(scene, worlds.SimulatedScene):
            scene.close()  # the processes that play open their own
        return msgspec.structs.replace(
            config,
            methods=names,
            development=config.world == APARTMENT and any(seed in DEVELOPMENT for seed in seeds),
            fitted={name: text for name in names if (text := fitted(config.perception, name.partition(":")[0]))},
            rows=config.rows or rows_of(shared(config.perception)),
            versions={"eagor": __version__, "apartment": VERSION},
        )


def variants(task: SimTask) -> tuple[str, ...]:
    """The ablations of our tracker and of the published one, as methods; of a walked task who is told the truth."""
    paper, ours = (
        ("degree=3", "degree=15", "degree=31", "decode=mode"),
        ("decode=mean", "shells=0", "wander=0", "jump=0"),
    )
    return (ORACLE,) if task.walked else (*(f"eagor_paper:{each}" for each in paper), *(f"eagor:{e}" for e in ours))


def split_methods(words: Sequence[str]) -> list[str]:
    """The methods in `words`, which may also be joined by commas: ``eagor,vmf eagor:degree=7,decode=mean``."""
    return [each for word in words for each in re.split(r",(?![^,:]+=)", word) if each]


def success_where(condition: str) -> Callable[[Record], float | None]:
    """Reads the success of the episodes whose metric `condition` is above 0."""
    return lambda result: result["metrics"]["success"] if result["metrics"].get(condition) else None
