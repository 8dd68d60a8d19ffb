"""What tasks with published data share: settings, the record of one answer, the reading of files, the words of tasks.

One agent plays such a run. Predictions that were made elsewhere are scored by the same rules (`PublishedTask.score`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import msgspec
from msgspec import Meta

from eagor._checks import parsed, shown
from eagor._version import __version__
from eagor.errors import EagorError, FormatError, QueryError
from eagor.evidence import Evidence
from eagor.lab.tasks.task import Metric, Payload, Record
from eagor.queries import singular

TALKING = "vlm"  # the agent that asks a model, in every task

Share = Annotated[float, Meta(ge=0, le=1)]
Recalibrate = Callable[[Evidence], Evidence]  # what the calibration of a run makes of a look
Read = Callable[[Record], float | None]  # what a metric reads in a record
Kind = TypeVar("Kind")


class PublishedConfig(msgspec.Struct, kw_only=True):
    """The settings that all of them have; a task adds its own."""

    task: str
    data: Annotated[str, Meta(description="folder with the published files")]
    agent: Annotated[str, Meta(description="who plays")] = ""
    perception: Annotated[str | None, Meta(description="detector of the agents that look")] = None
    model: Annotated[str | None, Meta(description=f"model of the agent {TALKING}")] = None
    seed: Annotated[int, Meta(ge=0, description="seed of the perception truth")] = 0
    calibrated: dict[str, Any] | None = None
    versions: dict[str, str] = {}

    def __post_init__(self) -> None:
        self.data = str(Path(self.data).resolve())


class PublishedRecord(msgspec.Struct, kw_only=True):
    """What reports read in a record; anything else may be there, too.

    `score`: 1 is success. `level`: the stratum's title; `tags`: known before the run; `by_turn`: 1 if an answer at that
    turn would have succeeded; `views`: number of looks; `stated`: probability of success; `sure`: why it stopped.
    """

    case: str
    cluster: str | float
    score: Share
    level: str = ""
    tags: list[str] = []
    cause: str | None = None
    by_turn: list[bool | Share] = []
    views: Annotated[int, Meta(ge=0)] = 0
    stated: Share | None = None
    sure: bool | float | None = None
    scores: dict[str, float | None] = {}
    error: float | None = None
    seconds: float | None = None


class PublishedTask:
    """The parts of an `eagor.lab.tasks.task.Task` that do not depend on its data.

    A task adds `name`, `title`, `what`, `metrics`, `samples`, and

    - `agents`: {name: what it does}, the default first; `looking`: those that need a perception;
    - `truth`: what the perception truth is in this task, in words; "" if there is none;
    - `player(config, perception, chat, read)`: what plays a sample with the perception and the model of the config,
      None where it names none, and the calibration of looks; or `runner`;
    - `info(data)`: the content of the folder, as JSON: counts and oddities; raises `FormatError` for other data;
    - `score(sample, prediction, config)`: the record of a prediction made elsewhere, with "text" or own keys; raises
      `FormatError` without any of them.
    """

    agents: ClassVar[Mapping[str, str]]
    looking: ClassVar[Sequence[str]] = ()
    truth: ClassVar[str] = ""
    causes: ClassVar[Mapping[str, str]] = {}
    ranked_by: ClassVar[Sequence[str]] = ("overall",)
    name: Any
    metrics: Any
    player: Any
    Config: ClassVar[type[PublishedConfig]] = PublishedConfig
    Record: ClassVar[type[msgspec.Struct]] = PublishedRecord

    def open_perception(self, config: Any) -> Any:
        """The perception that the config names, made once per process. Raises `EagorError` if it cannot be."""
        from eagor.lab.agents import models  # imports perceptions: not for those who only list tasks

        made = models.shared(config.perception)
        if models.is_privileged(made):
            raise EagorError(f"{config.perception} reads what a simulator knows; {self.name} has photographs only")
        return made

    def _tools(self, config: Any) -> tuple[Any, Any]:
        """The perception and the model of the config, None where it names none."""
        from eagor.lab.agents.models import shared_chat

        perception = self.open_perception(config) if config.perception else None
        return perception, shared_chat(config.model) if config.model else None

    def runner(self, config: Any) -> Callable[[Payload], Record]:
        from eagor.perception.calibrated import from_json

        own: Recalibrate = lambda evidence: evidence  # noqa: E731
        read = from_json(config.calibrated, "the settings").reread if config.calibrated else own
        return self.player(config, *self._tools(config), read)

    def resolve(self, config: Any) -> Any:
        """The config with its agent, what that agent needs, and no more. Raises `EagorError`."""
        agent = config.agent or next(iter(self.agents))
        if agent not in self.agents:
            raise EagorError(f"{self.name} has no agent {agent!r}; it has {', '.join(self.agents)}")
        looks, talks = agent in self.looking, agent == TALKING
        if looks and not config.perception:
            truth = f", or truth ({self.truth})" if self.truth else ""
            wanted = f"a model (folder or hub name) or endpoint:MODEL@ADDRESS{truth}"
            raise EagorError(f"the agent {agent} needs a perception: name one with --perception, such as {wanted}")
        if talks and not config.model:
            wanted = "MODEL@http://localhost:8000/v1, or package.module:function"
            raise EagorError(f"the agent {agent} asks a model; name it with --model, such as {wanted}")
        needs = {"perception": looks, "model": talks, "calibrated": looks}
        kept = {name: getattr(config, name) if need else None for name, need in needs.items()}
        found = msgspec.structs.replace(config, agent=agent, versions={"eagor": __version__}, **kept)
        self._tools(found)
        return found

    def failure(self, record: Record) -> str | None:
        """Its cause; "wrong" where the record names none."""
        cause = record.get("cause")
        return str(cause or "wrong") if cause or record.get("score", 1) < 1 else None


def score_metric(
    key: str, title: str, what: str, read: Read | None = None, over: Any = None, of: str = "", by: str = ""
) -> Metric:
    """A metric in per cent of what `read` finds in a record: by default its score.

    `of`: only of records of this level, or with this tag; `by`: the one of its scores with this name; `over`: as there.
    """

    def own(record: Record) -> float | None:
        if of and of not in (record.get("level"), *record.get("tags", ())):
            return None
        return record.get("scores", {}).get(by) if by else record["score"]

    return Metric(key, title, what, read or own, digits=2, share=True, over=over)


def words_of(prediction: Mapping[str, Any], keys: Sequence[str], wanted: str) -> str:
    """The text in a prediction: of the first of the `keys` that it has. Raises `FormatError`: it `wanted` that."""
    text = next((prediction[key] for key in keys if key in prediction), None)
    if not isinstance(text, str):
        raise FormatError(f"a prediction has {shown(', '.join(prediction), 200)}; wanted {wanted}")
    return text


def answer_in(text: str) -> str | None:
    """What is between the first ``<answer>`` in a model's reply and the next ``</answer>``; None without them."""
    _, opened, rest = text.partition("<answer>")
    answer, closed, _ = rest.partition("</answer>")
    return answer if opened and closed else None


def read_json(path: Path, kind: type[Kind], fault: str) -> Kind:
    """The content of a file. Raises `FormatError`, which says its `fault`, if it cannot be read as this kind."""
    try:
        return msgspec.convert(parsed(path.read_bytes().decode("utf-8-sig"), strict=True), kind)
    except (OSError, ValueError, msgspec.ValidationError) as error:
        raise FormatError(f"{path} {fault} ({error})") from None


_VERBS = r"^(?:please\s+)?(?:find|locate|look for|search for|go to|navigate to|get to|move to|reach|walk to|show me)\s+"
_ARTICLES = r"^(?:the|a|an|some|any|your|my|one of the|way to the|path to the|way to|path to)\s+"
_BREAKS = (
    r"\s+(?:of|on|in|at|by|with|near|next|under|above|behind|below|beside|between|from|that|which|whose|to|for|along|"
    r"inside|outside|against|across|around|where|labell?ed|named|called|saying|showing|reading)\s+|[,;(]"
)


def thing_of(task: str) -> str:
    """The target of a task such as "Find the red chair by the door.": "red chair by the door"."""
    text = " ".join(task.split()).rstrip(".!? ")
    for part in (_VERBS, _ARTICLES):
        text = re.sub(part, "", text, flags=re.IGNORECASE)
    return text or task


def phrase_of(task: str) -> str:
    """The target without its surroundings: "red chair"."""
    return re.split(_BREAKS, thing_of(task), maxsplit=1)[0].strip() or thing_of(task)


def head_of(task: str) -> str:
    """The noun of the target, singular and lower case: "chair"."""
    words = re.findall(r"[a-z][a-z-]*", phrase_of(task).lower())
    return singular(words[-1]) if words else thing_of(task).lower()


def first_known(task: str, look: Callable[[str], Evidence]) -> tuple[str, Evidence]:
    """What a perception is asked for, and its `look` for it: the task's words, or shorter ones that it knows.

    Raises `QueryError` if it knows none.
    """
    words = [thing_of(task), phrase_of(task)]
    for query in dict.fromkeys(words):
        try:
            return query, look(query)
        except QueryError:
            continue
    return head_of(task), look(head_of(task))
