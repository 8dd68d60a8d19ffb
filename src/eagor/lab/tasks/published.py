"""What tasks with published data share: a config with a folder and an agent, the record of one answer, seeds.

One agent plays such a run. Predictions that were made elsewhere are scored by the same rules (`PublishedTask.score`).
"""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import msgspec
from msgspec import Meta

from eagor._version import __version__
from eagor.errors import EagorError, QueryError
from eagor.evidence import Evidence
from eagor.lab.tasks.task import Metric, Record, Sample

TALKING = "vlm"  # the agent that asks a model, in every task

Share = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=0)]


class PublishedConfig(msgspec.Struct, kw_only=True):
    """The settings that all of them have; a task adds its own."""

    task: str
    data: Annotated[str, Meta(description="folder with the published files")]
    agent: Annotated[str, Meta(description="who plays")] = ""
    perception: Annotated[str | None, Meta(description="detector of the agents that look")] = None
    model: Annotated[str | None, Meta(description=f"model of the agent {TALKING}")] = None
    seed: Annotated[int, Meta(ge=0, description="seed of the perception truth and of random agents")] = 0
    calibrated: dict[str, Any] | None = None
    versions: dict[str, str] = {}

    def __post_init__(self) -> None:
        self.data = str(Path(self.data).resolve())


class Would(msgspec.Struct):
    """The answer that would have been given at a step: the probability of success that it states."""

    p: Share | None = None


class AnswerStep(msgspec.Struct):
    """A step before the answer."""

    would: Would | None = None


class PublishedRecord(msgspec.Struct, kw_only=True):
    """What reports read in a record; anything else may be there, too.

    `score`: 1 is success. `level`: the stratum's title; `tags`: known before the run; `cause`: why it failed;
    `by_turn`: 1 if an answer at that turn would have succeeded; `views`: number of looks; `stated`: probability of
    success, stated with the answer; `sure`: whether it stopped because it was sure.
    """

    case: str
    cluster: str | float
    score: Share
    level: str = ""
    tags: list[str] = []
    cause: str | None = None
    by_turn: list[bool | Share] = []
    views: Count = 0
    stated: Share | None = None
    sure: bool | float | None = None
    scoring: str = ""
    scores: dict[str, float | None] = {}
    error: float | None = None
    steps: list[AnswerStep] = []
    seconds: float | None = None


class PublishedTask:
    """The parts of an `eagor.lab.tasks.task.Task` that do not depend on its data.

    A task adds `name`, `title`, `what`, `metrics`, `samples`, `runner`, `info` and `score`, and says

    - `agents`: {name: what it does}, the default first; `looking`: those that need a perception;
    - `truth`: what the perception truth is in this task, in words; "" if there is none.
    """

    agents: ClassVar[Mapping[str, str]]
    looking: ClassVar[Sequence[str]] = ()
    truth: ClassVar[str] = "the annotations"
    causes: ClassVar[Mapping[str, str]] = {}
    strata: ClassVar[Mapping[str, str]] = {}
    ranked_by: ClassVar[Sequence[str]] = ("overall",)
    name: Any
    metrics: Any
    Config: ClassVar[type[PublishedConfig]] = PublishedConfig
    Record: ClassVar[type[msgspec.Struct]] = PublishedRecord

    def check(self, config: Any) -> None:
        """Raise `EagorError` for a config that this task cannot run with; makes the perception, if any."""

    def resolve(self, config: Any) -> Any:
        """The config with its agent, what that agent needs, and no more. Raises `EagorError`."""
        agent = config.agent or next(iter(self.agents))
        if agent not in self.agents:
            raise EagorError(f"{self.name} has no agent {agent!r}; it has {', '.join(self.agents)}")
        looks, talks = agent in self.looking, agent == TALKING
        if looks and not config.perception:
            truth = f", or truth ({self.truth})" if self.truth else ""
            raise EagorError(
                f"the agent {agent} needs a perception: name one with --perception, such as a model (folder or hub "
                f"name) or endpoint:MODEL@ADDRESS{truth}"
            )
        if talks and not config.model:
            raise EagorError(
                f"the agent {agent} asks a model; name it with --model, such as MODEL@http://localhost:8000/v1, "
                "or package.module:function"
            )
        found = msgspec.structs.replace(
            config,
            agent=agent,
            perception=config.perception if looks else None,
            model=config.model if talks else None,
            calibrated=config.calibrated if looks else None,
            versions={"eagor": __version__},
        )
        self.check(found)
        if found.model:
            from eagor.lab.agents.models import shared_chat  # imports perceptions: not for those who only list tasks

            shared_chat(found.model)
        return found

    def failure(self, record: Record) -> str | None:
        """Its cause; "wrong" where the record names none."""
        cause = record.get("cause")
        return str(cause or "wrong") if cause or record.get("score", 1) < 1 else None

    def info(self, data: Path) -> dict[str, Any]:
        """The content of the folder `data`, as JSON: counts and oddities. Raises `FormatError` for other data."""
        raise NotImplementedError

    def score(self, sample: Sample, prediction: Mapping[str, Any], config: Any) -> Record:
        """The record of a prediction made elsewhere: {"text": the model's words} or the task's own keys.

        Raises `FormatError` for a prediction without any of the keys.
        """
        raise NotImplementedError


def score_metric(
    key: str, title: str, what: str, read: Callable[[Record], float | None], over: Callable[[Record], str] | None = None
) -> Metric:
    """A metric in per cent of what `read` finds in a record."""
    return Metric(key, title, what, read, digits=2, share=True, over=over)


def first_known(queries: Sequence[str], look: Callable[[str], Evidence]) -> tuple[str, Evidence]:
    """The first of `queries` that a perception knows, and its `look` for it. Raises `QueryError` if it knows none."""
    *others, last = dict.fromkeys(queries)
    for query in others:
        try:
            return query, look(query)
        except QueryError:
            continue
    return last, look(last)


def case_seed(seed: int, case: str) -> list[int]:
    """The seed of one case; independent of all other cases."""
    return [seed, zlib.crc32(case.encode())]


def picture_size(file: Path, upright: bool = False) -> tuple[int, int] | None:
    """Width and height of a picture, None if it cannot be read; `upright`: after its orientation tag was followed."""
    from PIL import Image

    from eagor.media.panorama import FORMATS, ORIENTATION

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with Image.open(file, formats=FORMATS) as picture:
                turned = upright and picture.getexif().get(ORIENTATION, 1) >= 5  # by a quarter
                width, height = picture.size
                return (height, width) if turned else (width, height)
        except Exception:  # decoders may raise anything for damaged files
            return None
