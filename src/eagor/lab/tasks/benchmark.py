"""The interface of a benchmark with published data: it reads the data, runs and scores cases, and names its figures.

Packages add theirs under the entry-point group ``eagor.benchmarks`` (a benchmark, or a function that makes one without
arguments); `check_benchmark` tests them. Everything else is common to all benchmarks (`eagor.lab.eval`). What H*Bench
and OSR-Bench have in common comes below: their skeleton; seeds and pictures of their cases.
"""

from __future__ import annotations

import importlib
import json
import math
import warnings
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import IO, Any, ClassVar, Protocol, cast, runtime_checkable

from eagor import plugins
from eagor._checks import shown, whole, within
from eagor._version import __version__
from eagor.errors import EagorError

GROUP = "eagor.benchmarks"
TALKING = "vlm"  # the agent that asks a model, in every benchmark
BUILT_IN = {
    "hstar-hos": "eagor.lab.tasks.hstar.bench:HOS",
    "hstar-hps": "eagor.lab.tasks.hstar.bench:HPS",
    "osr": "eagor.lab.tasks.osr.bench:OSR",
}

Record = Mapping[str, Any]


@dataclass(frozen=True)
class Case:
    """One unit of work: an episode of H*Bench, one question of OSR-Bench.

    `id` depends on the data alone, never on order, limit or shard. Cases of one `group` (its image) go to one process.
    Cases of one `cluster` are correlated (one target, one scene) and are resampled together. `payload`: JSON for the
    worker.
    """

    id: str
    group: str
    cluster: str
    payload: Any


@dataclass(frozen=True)
class Option:
    """A setting that only some benchmarks have, such as ``scoring``: its default and its choices."""

    default: Any
    what: str
    choices: tuple[Any, ...] = ()

    def read(self, name: str, value: Any) -> Any:
        """`value`, possibly text, as this option's type. Raises `EagorError` if it is not among the choices."""
        if isinstance(self.default, bool):
            found: Any = {"true": True, "false": False, "1": True, "0": False}.get(str(value).lower(), value)
        elif isinstance(self.default, int | float):
            found = _number(type(self.default), value)
        else:
            found = value
        fits = found in self.choices if self.choices else isinstance(found, type(self.default))
        if not fits:
            many = isinstance(self.default, int | float) and len(self.choices) > 8
            listed = (*self.choices[:2], "...", *self.choices[-1:]) if many else self.choices
            wanted = ", ".join(map(str, listed)) or f"something like {self.default!r}"
            raise EagorError(f"{name} = {shown(value)}; wanted {wanted} ({self.what})")
        return found


def _number(kind: type[int] | type[float], value: Any) -> Any:
    """`value` as a finite number of this kind, None for a wrong one; other text stays (a choice may be a word)."""
    try:
        found = kind(value)
    except (TypeError, ValueError, OverflowError):
        return value if isinstance(value, str) else None
    same = isinstance(value, str) or (found == value and not isinstance(value, bool))
    return found if same and within(found, -math.inf) else None


@dataclass(frozen=True)
class Figure:
    """One column of the benchmark's table: the mean of `read` over the records that have it, in per cent.

    `read`: the record's score in [0, 1], None if it does not belong here. `over`: groups records; the figure is then
    the mean of the group means. The first figure of a benchmark is its headline, with the key "overall".
    """

    key: str
    title: str
    what: str
    read: Callable[[Record], float | None]
    over: Callable[[Record], str] | None = None
    unit: ClassVar[str] = "%"
    better: ClassVar[str] = "high"
    scale: ClassVar[float] = 100.0
    digits: ClassVar[int] = 2
    share: ClassVar[bool] = True

    def of(self, record: Record, method: str | None = None) -> float | None:
        """What a record contributes, per cent; None if it does not belong here. No benchmark's record has methods."""
        value = self.read(record)
        return None if value is None else self.scale * value


@runtime_checkable
class Benchmark(Protocol):
    """What `eagor bench` runs, scores and reports.

    `agents`, `options`: each with a one-line description; the first agent is the default. `figures`: the columns of its
    table. `work`: ``"package.module:function"``; ``function(settings)`` is called once per process and
    returns a callable, payload -> record. It may raise: that is a failed attempt, never a wrong answer.

    A record is a JSON object with "case" (the id), "cluster" and "score" in [0, 1] (1 is success). Optional keys:
    "level" (the stratum's title); "tags", known before the run; "cause", why it failed (default: "wrong"); "by_turn":
    1 if an answer at that turn would have succeeded; "views": number of looks; "stated": the probability of success
    stated with the answer; "sure": whether it stopped because it was sure; "steps", "answer", and anything else. A
    benchmark may also have ``causes``, {cause: meaning}, and ``record``, {field: "text", "texts" or "figures"}: what
    its figures read in a record ("field?": it may be missing).
    """

    @property
    def name(self) -> str: ...
    @property
    def title(self) -> str: ...
    @property
    def agents(self) -> Mapping[str, str]: ...
    @property
    def options(self) -> Mapping[str, Option]: ...
    @property
    def work(self) -> str: ...
    @property
    def figures(self) -> Sequence[Figure]: ...

    def info(self, data: Path) -> dict[str, Any]:
        """The content of the folder `data`, as JSON: counts and oddities. Raises `FormatError` for other data."""
        ...

    def cases(self, data: Path, settings: Mapping[str, Any]) -> list[Case]:
        """All cases in `data`, in the benchmark's own order. Raises `FormatError` for other data."""
        ...

    def settle(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """The settings of a run, completed and checked, as stored in run.json; raises `EagorError` for invalid ones.

        They have "task", "data", "agent", "perception", "model", "seed" and the `options`. The perception is made here
        once, so that a perception that cannot be made fails the run and not a case.
        """
        ...

    def judge(self, case: Case, prediction: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
        """The record of a prediction made elsewhere: {"text": the model's words} or the benchmark's own keys.

        Raises `FormatError` for a prediction without any of the keys.
        """
        ...


def known() -> dict[str, EntryPoint]:
    """The benchmarks that `load` can make, by name. Imports none of them."""
    return plugins.known(GROUP, BUILT_IN)


def load(name: str) -> Benchmark:
    """The benchmark with this name. Raises `EagorError` if it is unknown, cannot be imported, or is not a benchmark."""
    choices = known()
    if name not in choices:
        raise EagorError(f"there is no benchmark {name!r}; known are {', '.join(sorted(choices))}")
    found: Any = plugins.bring(choices[name], "benchmark")
    if callable(found):  # a class would pass for a benchmark itself
        found = found()
    plugins.check_named(found, choices[name], "benchmark", Benchmark, or_maker=True)
    return found


def read_options(benchmark: Benchmark, values: Mapping[str, Any]) -> dict[str, Any]:
    """Every option of `benchmark`, given or default. Raises `EagorError` for unknown options and wrong values."""
    given = {name: value for name, value in values.items() if value is not None}
    if unknown := sorted(set(given) - set(benchmark.options)):
        has = ", ".join(benchmark.options) or "none"
        raise EagorError(f"{benchmark.name} has no option {', '.join(unknown)}; it has {has}")
    return {
        name: option.read(name, given[name]) if name in given else option.default
        for name, option in benchmark.options.items()
    }


def check_benchmark(benchmark: Benchmark, data: Path, agent: str) -> list[dict[str, Any]]:
    """Raise `AssertionError` unless `benchmark` keeps the contract on `data`; returns the records of `agent`."""
    options = read_options(benchmark, {})
    told = {"task": benchmark.name, "data": str(data), "agent": agent, "perception": None, "model": None, "seed": 0}
    settings = benchmark.settle(told | options)
    plain = "numbers, texts, lists and dicts with texts as keys"
    _require(_survives(settings), f"settles {settings}, which JSON does not preserve; wanted {plain}")
    again = benchmark.settle(settings)
    _require(again == settings, f"settles {settings}, and that again to {again}; wanted the same")
    cases = benchmark.cases(data, settings)
    _require(bool(cases), f"has no cases in {data}; wanted at least one. Is that its data?")
    ids = [case.id for case in cases]
    twice = sorted({name for name in ids if ids.count(name) > 1}) if len(set(ids)) < len(ids) else []
    _require(not twice, f"gives several cases the id {', '.join(twice)}; wanted a unique id for each")
    _require(
        cases == benchmark.cases(data, settings),
        "gives other cases the second time; wanted the same in the same order: sort file lists, use no random numbers",
    )
    for case in cases:
        _require(_survives(case.payload), f"gives {case.id} the payload {case.payload!r}; wanted {plain}")
    first = benchmark.figures[0].key if benchmark.figures else None
    _require(first == "overall", f'has {first!r} as its first figure; wanted "overall": the headline comes first')
    told = benchmark.info(data)
    _require(isinstance(told, dict), f"tells info in a {type(told).__name__}; wanted a dict")
    module, _, function = benchmark.work.partition(":")
    do = getattr(importlib.import_module(module), function)(settings)
    records = []
    for case in cases:
        record = dict(do(case.payload))
        _require(_survives(record), f"records {record} of {case.id}, which JSON does not preserve; wanted {plain}")
        named = record.get("case"), record.get("cluster")
        _require(
            named == (case.id, case.cluster),
            f"records case and cluster {named} of {case.id}; wanted {(case.id, case.cluster)}, those of the case",
        )
        score = record.get("score")
        _require(
            isinstance(score, int | float) and 0 <= score <= 1,
            f"records the score {score!r} of {case.id}; wanted a number in [0, 1], 1 being success",
        )
        for figure in benchmark.figures:
            value = figure.read(record)
            _require(
                value is None or 0 <= value <= 1,
                f"reads {value!r} from the record of {case.id} as the figure {figure.key}; wanted a number in [0, 1], "
                "or None where the record does not belong to it",
            )
        records.append(record)
    return records


def _survives(value: Any) -> bool:
    """Whether JSON preserves `value`."""
    try:
        return json.loads(json.dumps(value, allow_nan=False)) == value
    except (TypeError, ValueError):
        return False


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(f"the benchmark {text}")


# --- what H*Bench and OSR-Bench have in common -----------------------------------------------------------------------


class PublishedBenchmark:
    """The parts of an `eagor.lab.tasks.benchmark.Benchmark` that do not depend on its data.

    A benchmark adds `name`, `title`, `work`, `figures`, `info`, `cases` and `judge`, and says

    - `agents`, `options`: as there; `looking`: the agents that need a perception; `truth`: what the perception truth is
      in this benchmark, in words.
    """

    name: Any
    agents: ClassVar[Mapping[str, str]]
    options: ClassVar[Mapping[str, Option]]
    looking: ClassVar[Sequence[str]]
    truth: ClassVar[str]

    def check(self, settings: Mapping[str, Any]) -> None:
        """Raise `EagorError` for settings that this benchmark cannot run with; makes the perception, if any."""
        raise NotImplementedError

    def settle(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        agent = settings.get("agent") or next(iter(self.agents))
        if agent not in self.agents:
            raise EagorError(f"{self.name} has no agent {agent!r}; it has {', '.join(self.agents)}")
        perception, model = settings.get("perception"), settings.get("model")
        if agent in self.looking and not perception:
            raise EagorError(
                f"the agent {agent} needs a perception: name one with --perception, such as a model (folder or hub "
                f"name), endpoint:MODEL@ADDRESS, or truth ({self.truth})"
            )
        if agent == TALKING and not model:
            raise EagorError(
                f"the agent {agent} asks a model; name it with --model, such as MODEL@http://localhost:8000/v1, a "
                "folder or hub name, or package.module:function"
            )
        seed = settings.get("seed") or 0
        if not whole(seed, 0):
            raise EagorError(f"seed = {seed!r}; wanted a whole number, 0 or more")
        found = {
            "task": self.name,
            "data": str(settings["data"]),
            "agent": agent,
            "perception": perception if agent in self.looking else None,
            "model": model if agent == TALKING else None,
            "seed": int(seed),
            **read_options(cast(Benchmark, self), {name: settings.get(name) for name in self.options}),
            **({"calibrated": settings["calibrated"]} if settings.get("calibrated") and agent in self.looking else {}),
            "versions": {"eagor": __version__},
        }
        self.check(found)
        if found["model"]:
            from eagor.lab.agents.models import (
                shared_chat,  # imports perceptions: not for those who only list benchmarks
            )

            shared_chat(found["model"])
        return found


def case_seed(seed: int, case: str) -> list[int]:
    """The seed of one case; independent of all other cases."""
    return [seed, zlib.crc32(case.encode())]


def picture_size(file: Path | IO[bytes], upright: bool = False) -> tuple[int, int] | None:
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
