"""One protocol for everything that can be run, scored and reported: simulated tasks and tasks with published data.

A task names its samples, makes a runner that turns a sample into a record, and says how to read figures from records.
`eagor.lab.eval` does the rest for all tasks. Packages add theirs under the entry-point group ``eagor.tasks``: a `Task`,
or a function that makes one without arguments. `check_task` tests it. `eagor.lab.tasks.sim.task` has what simulated
tasks share, `eagor.lab.tasks.published` what tasks with data share.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from inspect import signature
from typing import Any, Literal, Protocol, runtime_checkable

import msgspec
from msgspec import inspect

from eagor import plugins
from eagor._checks import shown
from eagor.errors import EagorError, FormatError

GROUP = "eagor.tasks"
BUILT_IN = {
    "waypoint": "eagor.lab.tasks.sim.waypoint:WAYPOINT",
    "navigation": "eagor.lab.tasks.sim.navigation:NAVIGATION",
    "tracking": "eagor.lab.tasks.sim.tracking:TRACKING",
    "hstar-hos": "eagor.lab.tasks.hstar.bench:HOS",
    "hstar-hps": "eagor.lab.tasks.hstar.bench:HPS",
    "osr": "eagor.lab.tasks.osr.bench:OSR",
    "eagle360": "eagor.lab.tasks.eagle360:EAGLE360",
}
WORK = "eagor.lab.tasks.task:work"  # for `eagor.lab.eval.runner.run`

Record = Mapping[str, Any]
Payload = Any


@dataclass(frozen=True)
class Sample:
    """One unit of work: an episode, a question.

    `id` depends on the world or the data alone, never on order, limit or shard. Samples of one `group` (an apartment, a
    picture) share their luck: one worker plays them, and intervals resample them together. `payload`: JSON.
    """

    id: str
    group: str
    payload: Payload


@dataclass(frozen=True)
class Metric:
    """A column of the task's table: the mean over all results that have it.

    - `read`: what a result contributes; None where the metric does not apply. A result is ``record["methods"][name]``
      of a record with several methods, else the record itself. None: ``result["metrics"][key]``.
    - `scale`: from there to `unit`; `digits` of the figure in tables; `share`: each value is 0 or 1 before scaling.
    - `better`: the better side, None if neither is. `why`: why a worse method may look better here.
    - `over`: kinds of results; the figure is then the mean of the means of the kinds.
    """

    key: str
    title: str
    what: str
    read: Callable[[Record], float | None] | None = None
    unit: str = "%"
    better: Literal["low", "high"] | None = "high"
    scale: float = 100.0
    digits: int = 1
    share: bool = False
    over: Callable[[Record], str] | None = None
    why: str = ""

    def of(self, result: Record) -> float | None:
        """The value of one result, in `unit`."""
        value = result["metrics"].get(self.key) if self.read is None else self.read(result)
        return None if value is None else self.scale * float(value)


def degrees(key: str, title: str, what: str, unit: str = "°", **more: Any) -> Metric:
    """A metric of `key` in degrees, the lower the better."""
    return Metric(key, title, what, unit=unit, better="low", scale=1.0, **more)


@runtime_checkable
class Task(Protocol):
    """What can be run, scored and reported.

    - `name`: for typing; `title`: for tables; `what`: one line for ``eagor bench list``.
    - `metrics`: the columns of the table, the most important one first or named by ``headline``.
    - `Config`: a `msgspec.Struct` of everything that decides the results, with a description of each field
      (`msgspec.Meta`); ``--set FIELD=VALUE`` sets one, and every report prints them. One field is `task`.

    A record is a JSON object with "case" (the sample's id), "cluster", and either the figures of one answer ("score" in
    [0, 1], ...) or "methods" {name: {"metrics": {...}, ...}}.

    A task may also have

    - ``resolve(config)``: the config completed and checked (a perception that cannot be made fails the run, no sample);
    - ``Record``: a `msgspec.Struct` that says what its metrics read; each record is checked before it is counted;
    - ``agents`` {name: what it does}, where one of them plays a run instead of several methods, and ``info(data)``,
      ``score(sample, prediction, config)``: of published data (`eagor.lab.tasks.published`);
    - ``causes`` {cause: meaning}, ``strata`` {key: title}, ``ranked_by``: keys of the metrics that rank results.
    """

    name: str
    title: str
    what: str
    metrics: Sequence[Metric]
    Config: type[msgspec.Struct]

    def samples(self, config: Any) -> list[Sample]:
        """All samples, in the task's own order. Raises `EagorError` for what cannot be played."""
        ...

    def runner(self, config: Any) -> Callable[[Payload], Record]:
        """What turns a payload into a record; made once per worker. It may raise: that is no wrong answer."""
        ...

    def failure(self, record: Record) -> str | None:
        """Why a record is a failure; None where it is none."""
        ...


def known() -> dict[str, EntryPoint]:
    """The tasks that `load` can make, by name, simulated ones first. Imports none of them."""
    return plugins.known(GROUP, BUILT_IN)


def load(name: str) -> Any:
    """The `Task` with this name. Raises `EagorError` if it is unknown, cannot be imported, or is no task."""
    choices = known()
    if name not in choices:
        raise EagorError(f"there is no task {name!r}; known are {', '.join(map(str, choices))}")
    made: Any = plugins.bring(choices[name], "task")
    if callable(made) and not signature(made).parameters:  # a class would pass for a task itself
        made = made()
    if not (isinstance(made, Task) and made.name == name):
        what = f"the task {made.name!r}" if isinstance(made, Task) else f"a {type(made).__name__}"
        raise EagorError(
            f"the entry point {name!r} of {GROUP} ({choices[name].value}) is {what}; wanted an {Task.__module__}.Task "
            "whose name is that of the entry point, or a function that makes it"
        )
    return made


def work(settings: Mapping[str, Any]) -> Callable[[Payload], Record]:
    """The runner of the run that these settings (the JSON of ``run.json``) describe."""
    task = load(settings["task"])
    return task.runner(config_of(task, settings))


def configure(task: Task, values: Mapping[str, Any], changes: Mapping[str, str] | None = None) -> Any:
    """The config of a run, completed and checked; arguments and errors as of `read_config`."""
    config = read_config(task, values, changes)
    return task.resolve(config) if hasattr(task, "resolve") else config  # type: ignore[attr-defined]


def read_config(task: Task, values: Mapping[str, Any], changes: Mapping[str, str] | None = None) -> Any:
    """The config as it was given: `values` by field, None for the default; `changes`: text by the name of a field.

    Or of one within a field (``max_steps`` of the rules). Raises `EagorError` for unknown names and wrong values.
    """
    found = {"task": task.name, **{key: value for key, value in values.items() if value is not None}}
    options = options_of(task)
    names = {path.rpartition(".")[2]: path for path in options}
    for key, value in (changes or {}).items():
        if key not in names:
            can = [name for name, path in names.items() if "." in path or options[path][1]]
            raise EagorError(f"{task.name} has no {key!r} to set; it has {', '.join(can)}")
        home, within, _ = names[key].partition(".")
        found[home] = settings_of(found.get(home, {})) | {key: value} if within else value
    if unknown := [key for key in found if key not in options]:
        fields = ", ".join(path for path in options if "." not in path)
        raise EagorError(f"{task.name} has no {', '.join(unknown)}; it has {fields}")
    return config_of(task, found)


def config_of(task: Task, values: Mapping[str, Any]) -> Any:
    """`values`, perhaps text, as the task's `Config`; unknown ones are left out. Raises `EagorError`."""
    try:
        return msgspec.convert(values, task.Config, strict=False)
    except msgspec.ValidationError as error:
        why, _, path = str(error).partition(" - at `$.")
    path, value = path.rstrip("`").partition("[")[0], values
    for name in path.split("."):
        value = value.get(name, value) if isinstance(value, Mapping) else value
    _, what, choices = options_of(task).get(path, (None, "", ()))
    wanted = (f"; wanted {', '.join(map(str, choices))}" if choices else "") + (f" ({what})" if what else "")
    raise EagorError(f"{path} = {shown(value)}: {why}{wanted}" if path else f"{task.name}: {why}")


def settings_of(config: Any) -> dict[str, Any]:
    """A config as the JSON of ``run.json``."""
    return msgspec.json.decode(msgspec.json.encode(config))


def options_of(task: Task) -> dict[str, tuple[Any, str, tuple[Any, ...]]]:
    """The default of each field of the config, what it is in words, and what it can be, where that is a short list.

    By name, those within a field as "rules.max_steps".
    """
    found = {}
    for field in getattr(inspect.type_info(task.Config), "fields", ()):
        within = [(f"{field.name}.{each.name}", each) for each in getattr(field.type, "fields", ())]
        for path, each in [(field.name, field), *within]:
            words = (getattr(each.type, "extra_json_schema", None) or {}).get("description", "")
            choices = getattr(getattr(each.type, "type", each.type), "values", ())
            found[path] = None if each.default is msgspec.NODEFAULT else each.default, words, choices
    return found


def finished(records: Iterable[Record]) -> list[Record]:
    """The records that hold a result."""
    return [record for record in records if record["status"] == "ok"]


def sample_of(record: Record) -> str:
    """The sample that a record is of."""
    return record["case"] if "case" in record else record["episode"]["id"]


def group_of(record: Record) -> Any:
    """Which records share their luck: those of one cluster, or of one scene, whatever its seed is."""
    if "cluster" in record:
        return record["cluster"]
    episode = record["episode"]
    return episode.get("scene_hash", episode.get("seed", episode["id"]))


def check_records(task: Task, records: Sequence[Record]) -> None:
    """Raise `FormatError`, which names the record and the place, for one that does not fit the task's ``Record``."""
    shape = getattr(task, "Record", None)
    for record in finished(records) if shape is not None else ():
        try:
            msgspec.convert(record, shape)
        except msgspec.ValidationError as error:
            raise FormatError(
                f"the record {shown(record['key'], 200)} (attempt {record['attempt']}): {error}. Restore its line, or "
                "delete it: its unit is then done again"
            ) from None


def check_task(task: Task, **values: Any) -> list[Record]:
    """Raise `AssertionError` unless `task` keeps the contract with the config of `values`; returns all its records."""
    require(isinstance(task, Task), f"is a {type(task).__name__}; wanted an eagor.lab.tasks.task.Task")
    config = configure(task, values)
    plain = settings_of(config)
    require(configure(task, plain) == config, f"resolves {plain} to another config the second time")
    samples = task.samples(config)
    require(samples, "has no samples; wanted at least one. Is that its data?")
    twice = sorted(name for name, count in Counter(sample.id for sample in samples).items() if count > 1)
    require(not twice, f"gives several samples the id {', '.join(twice)}; wanted a unique id for each")
    same = samples == task.samples(config)
    require(same, "gives other samples the second time; wanted the same in the same order: sort files, draw nothing")
    run, records = task.runner(config), []
    for sample in samples:
        _plain(sample.payload, f"gives {sample.id} a payload")
        record = _plain(run(sample.payload), f"records of {sample.id} something")
        case, score = sample_of(record), record.get("score", 0)
        own = sample.id == case or sample.id.startswith(f"{case}/")  # an episode may have a sample for each method
        require(own, f"records the case {case} of the sample {sample.id}; wanted the sample's id")
        fits = isinstance(score, int | float) and 0 <= score <= 1
        require(fits, f"records the score {score!r} of {sample.id}; wanted a number in [0, 1], 1 being success")
        for metric in task.metrics:
            for result in record.get("methods", {"": record}).values():
                metric.of(result)
        records.append(record)
    check_records(task, [{"key": sample_of(r), "attempt": 1, "status": "ok", **r} for r in records])
    return records


def _plain(value: Any, what: str) -> Any:
    """`value` as it comes back from JSON: finite numbers, texts, lists and dicts."""
    try:
        return json.loads(json.dumps(value, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise AssertionError(f"the task {what} that JSON cannot hold ({error}): {shown(value, 200)}") from None


def require(holds: Any, text: str) -> None:
    """Raise `AssertionError` unless a task keeps a part of its contract; `text`: what it does, and what was wanted."""
    if not holds:
        raise AssertionError(f"the task {text}")
