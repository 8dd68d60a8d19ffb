"""A simulated task as a study: its runs, how they are counted, what their report says, and an episode played again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from eagor import plugins
from eagor._version import __version__
from eagor.errors import EagorError
from eagor.lab import worlds
from eagor.lab.agents.methods import NAMES, ORACLE, TrackerEstimator, fitted, make_estimator
from eagor.lab.agents.models import shared
from eagor.lab.envs.episodes import (
    PER_PLACE,
    EpisodeSpec,
    episode_specs,
    file_episode_specs,
    scene_files,
    spec_from_json,
)
from eagor.lab.envs.places import APARTMENT, DEVELOPMENT
from eagor.lab.envs.rules import Camera, NoiseModel, as_dict, from_dict
from eagor.lab.eval import page, runner, scenes, sheets, tables
from eagor.lab.eval.page import Part, Section, Sheet, could_not
from eagor.lab.eval.runner import Outcome, Unit
from eagor.lab.eval.samples import LEVEL, RESAMPLES, Record, computing_time, finished
from eagor.lab.eval.study import LoadedRun, Report, Settings, Study, Summary, Worst, table_csv, words
from eagor.lab.eval.tables import OURS, PAPERS, is_rival, shown
from eagor.lab.tasks import task as tasks
from eagor.lab.tasks.sim.play import Runner, StepInfo
from eagor.lab.tasks.task import Task
from eagor.perception import rows_of
from eagor.perception.calibrated import Calibrated

WORK = "eagor.lab.tasks.sim.play:work"
PER_RUN = 20  # episodes of a run that names no number and no file
LOGGED_ROWS = 256  # of panoramas of an episode that is logged


@dataclass(frozen=True)
class Run:
    """What is run. `settings` override single rules, of the task, the camera or the disturbances, by name.

    `rows` of the panoramas; None: what the perception works at. `calibrated`: how our tracker reads and forgets; None:
    as the perception and the tracker have it. `episodes_file`: play what this file lists
    (`eagor.lab.envs.episodes`), in scenes below the folder `scenes`; then `episodes` None means all of them, and
    `seed` nothing.
    """

    task: str
    perception: str
    episodes: int | None
    seed: int
    methods: tuple[str, ...] = NAMES
    world: str = APARTMENT
    rows: int | None = None
    disturbances: NoiseModel = field(default_factory=NoiseModel)
    calibrated: Calibrated | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    episodes_file: Path | None = None
    scenes: Path | None = None

    def config(self) -> dict[str, Any]:
        """Everything that decides the results, as the JSON of run.json.

        Raises `EagorError` for what does not exist, and for rules that nothing can be played under.
        """
        import numpy as np

        from eagor.lab.worlds.apartment import VERSION

        task = tasks.load(self.task)
        for name in self.methods:
            if name != ORACLE or not task.walked:
                make_estimator(name, np.random.default_rng(0))  # complains about unknown ones
        if len(set(self.methods)) != len(self.methods) or not self.methods:
            raise EagorError(f"methods {list(self.methods)}; wanted at least one, each once")
        if self.episodes_file is None and self.world != APARTMENT:
            _read_world(self.world)  # complains about one that cannot be read
        if self.episodes_file is not None and task.listed is None:
            able = ", ".join(name for name in tasks.known() if tasks.load(name).listed is not None)
            raise EagorError(f"{self.task} plays no episodes of a file; {able} does")
        specs = self.specs()  # complains about a file that cannot be played
        if self.episodes_file is not None and self.world != APARTMENT:
            _try_world(specs)
        begin = task.rules() if self.episodes_file is None else task.rules.objectnav()  # type: ignore[attr-defined]
        parts = {"rules": begin, "camera": Camera(), "disturbances": self.disturbances}
        values = {name: as_dict(part) for name, part in parts.items()}
        for key, value in self.settings.items():
            homes = [name for name in values if key in values[name]]
            if not homes:
                known = ", ".join(sorted(key for part in values.values() for key in part))
                raise EagorError(f"there is no rule {key!r}; known are {known}")
            values[homes[0]][key] = _like(values[homes[0]][key], value, key)
        for name, part in parts.items():
            from_dict(type(part), values[name])  # complains about rules that nothing can be played under
        if self.episodes_file is None and values["rules"].get("goal") == "view_points":
            raise EagorError("goal=view_points needs episodes that have view points: --episodes-file")
        return {
            "task": self.task,
            "perception": self.perception,
            "episodes": len(specs),
            "seed": self.seed,
            "development": _tuned_on(specs),
            **self._listed(),
            "methods": list(self.methods),
            "fitted": {
                name: text for name in self.methods if (text := fitted(self.perception, name.partition(":")[0]))
            },
            "world": self.world,
            "rows": self.rows or rows_of(shared(self.perception)),
            **({"calibrated": self.calibrated.as_json()} if self.calibrated else {}),
            **values,
            "versions": {"eagor": __version__, "apartment": VERSION, **self._plugins()},
        }

    def specs(self) -> list[EpisodeSpec]:
        """The specs of the episodes. Raises `WorldError`."""
        if self.episodes_file is not None:
            return [*file_episode_specs(self.task, self.episodes_file, self.episodes, self.world, self.scenes)]
        return list(
            episode_specs(self.task, PER_RUN if self.episodes is None else self.episodes, self.seed, self.world)
        )

    def _listed(self) -> dict[str, Any]:
        """The settings of episodes from a file."""
        if self.episodes_file is None:
            return {}
        return {"episodes_file": str(self.episodes_file), **({"scenes": str(self.scenes)} if self.scenes else {})}

    def _plugins(self) -> dict[str, str]:
        """The versions of what other packages bring to this run, by kind and name."""
        from eagor import perception

        used = (
            ("perception", perception.known(), self.perception.partition(":")[0]),
            ("world", worlds.known(), self.world.partition(":")[0]),
            ("task", tasks.known(), self.task),
        )
        found = {f"{kind} {name}": plugins.version_of(known[name]) for kind, known, name in used if name in known}
        return {name: version for name, version in found.items() if version is not None}

    def units(self, config: object = None) -> list[Unit]:
        """One unit per episode; where the task is walked, one per episode and method: each goes its own way there."""
        found, walked = [], tasks.load(self.task).walked
        for spec in self.specs():
            name = f"{self.task}/{spec.id}"
            if walked:
                keys = [(f"{name}/{method}", [method]) for method in self.methods]
            else:
                keys = [(name, list(self.methods))]
            for key, methods in keys:
                found.append(Unit(key, str(spec.seed), {"slot": asdict(spec), "methods": methods}))
        return found


def start(run: Run, folder: Path, **how: Any) -> Outcome:
    """Play what `folder` has no record of yet, and record it; `how` as in `eagor.lab.eval.runner.run`.

    Raises `EagorError` if the folder holds another run, or for anything that `run` names and does not exist;
    `StorageError` if the disk does not take the results.
    """
    config = run.config()  # makes the perception: one that cannot be made is no failure of an episode
    return runner.run(run.units(), WORK, config, folder, **how)


def _tuned_on(listed: Sequence[EpisodeSpec]) -> bool:
    """Whether one of these is in an apartment on which parameters were chosen."""
    return any(spec.world == APARTMENT and spec.seed in DEVELOPMENT for spec in listed)


def _try_world(listed: Sequence[EpisodeSpec]) -> None:
    """Open the first scene that is there: a missing simulator is no failure of every episode. Raises `EagorError`."""
    there = [spec for spec in listed if (files := scene_files([spec])) and files[0].exists()]
    if there:
        _read_world(there[0].world)
    else:
        worlds.load(listed[0].world)  # complains about one that does not exist


@lru_cache(maxsize=1)
def _read_world(world: str) -> None:
    """Read a GLB file or a simulator's scene once, so that one that cannot be read is no failure of every episode.

    Raises `WorldError`, `MissingExtraError`.
    """
    made = worlds.load(world)
    if world not in worlds.known():  # worlds of other packages need not have a scene of seed 0
        scene = made(0)
        if isinstance(scene, worlds.SimulatedScene):
            scene.close()  # the processes that play open their own


def variants(task: str) -> tuple[str, ...]:
    """The ablations of our tracker and of the published one, as methods."""
    if tasks.load(task).walked:
        return (ORACLE,)
    degrees = (3, 5, 7, 11, 15, 21, 31)
    return (
        *(f"eagor:degree={degree}" for degree in degrees if degree != 15),
        *(f"eagor_paper:degree={degree}" for degree in (3, 15)),
        "eagor_paper:decode=mode",
        "eagor:decode=mean",
        "eagor:shells=0",
        "eagor:wander=0",
        "eagor:jump=0",
        *(f"eagor:floor={floor}" for floor in (0.05, 0.4, 0.8)),
        *(f"eagor:temperature={beta}" for beta in (1, 3, 6)),
        *(f"eagor:neutral={neutral}" for neutral in (0.02, 0.05, 0.2)),
    )


def named(words: Sequence[str]) -> tuple[str, ...]:
    """The methods in `words`, which may also be joined by commas: ``eagor,vmf eagor:degree=7,decode=mean``."""
    found: list[str] = []
    for word in ",".join(words).split(","):
        if "=" in word and ":" not in word and found:
            found[-1] += f",{word}"  # a further setting of the same method
        elif word:
            found.append(word)
    return tuple(found)


def _like(old: Any, value: Any, key: str) -> Any:
    """`value`, perhaps text, in the type of the rule that it replaces."""
    if isinstance(old, list):
        raise EagorError(f"the rule {key} is a list of ranges; change it from Python (eagor.lab.envs.rules)")
    try:
        if isinstance(old, bool):
            return {"true": True, "false": False, "1": True, "0": False}[str(value).lower()]
        return type(old)(value)
    except (KeyError, ValueError):
        raise EagorError(f"{key} = {value!r}; wanted something like {old!r}") from None


# --- the study --------------------------------------------------------------------------------------------------------


class Simulated(Study):
    """See `eagor.lab.eval.study.Study`."""

    work = WORK
    case, several = "episode", False
    alike = ("world",)

    def __init__(self, task: Task) -> None:
        self.task, self.name, self.columns = task, task.name, task.columns

    def offer(self) -> dict[str, Any]:
        return {"title": self.task.title, "what": self.task.what, "worlds": sorted(worlds.known())}

    def loaded(self, settings: Settings, records: Sequence[Record]) -> LoadedRun:
        judged = _judged(self.task, settings)
        return LoadedRun(self, settings, records, tables.summarise(records) | ({"judged": judged} if judged else {}))

    def as_text(self, summary: Summary) -> list[str]:
        return tables.as_text(summary)

    def as_json(self, summary: Summary) -> dict[str, Any]:
        return {key: summary[key] for key in ("task", "episodes", "failed", "methods", "judged") if key in summary}

    def planned(self, settings: Settings) -> int | None:
        count, methods = settings.get("episodes"), settings.get("methods")
        if type(count) is not int or not isinstance(methods, list):
            return None
        return count * len(methods) if self.task.walked else count

    def report(self, runs: Sequence[LoadedRun], open_place: Any = None) -> Report:
        (run,) = runs
        summary, task, good, degrees = run.summary, self.task, finished(run.records), _degrees(run.settings)
        main = [sheets.main_sheet(summary)] if summary["methods"] else []
        ordering = _there(sheets.ordering_sheet(good, task.name))
        made_of = _there(sheets.parts_sheet(good, summary))
        covered = _there(sheets.coverage_sheet(good, summary))
        strata = sheets.strata_sheets(summary)
        varied = sheets.ablation_sheets(summary, degrees)
        named = [(f"{c.title}{f' ({c.unit})' if c.unit else ''}", c.what) for c in task.columns]
        honest = [*covered, *sheets.reliability_chart(good)] if covered else []
        variants = [*varied, *sheets.kernel_chart(summary, degrees)] if varied else []
        sections = [
            Section(
                "figures", "Figures", [*main, page.folded("What the columns are", page.facts(named))] if main else []
            ),
            Section("ordering", "How far the paper's ordering carries over", ordering),
            Section("parts", "What the errors are made of", made_of),
            *sheets.curve_sections(good, task),
            Section("strata", "By kind of episode", strata),
            Section("coverage", "How honest the stated regions are", honest),
            Section("variants", "Variants", variants),
            Section("episodes", "Three episodes to look at", scenes.three(good, task, run.settings, open_place)),
            Section("failed", "What could not be run", could_not(summary) if summary["failed"] else []),
        ]
        facts = _facts(run, task)
        return Report(
            f"{task.title}: {summary['episodes']} episodes, {len(summary['methods'])} methods",
            [*_lead(run, task), page.facts(facts)],
            [section for section in sections if section.parts],
            facts,
            [*main, *ordering, *made_of, *strata, *covered, *varied],
            {"tables.csv": table_csv(summary)},
        )

    def worst(self, run: LoadedRun, method: str | None = None) -> Worst:
        named = method or (OURS if OURS in run.methods else next(iter(run.methods), OURS))
        if run.methods and named not in run.methods:
            raise EagorError(f"the run has no method {named!r}; it has {', '.join(run.methods)}")
        ranked = scenes.ranked(run.records, self.task, named)[::-1]
        said = {key: run.summary[key] for key in ("task", "episodes", "failed", "failures")} | {"method": named}
        lines, cases = [], []
        for record in ranked:
            episode = record["episode"]
            lines.append(f"{episode['id']}  {episode['query']!r}  {scenes.figures_of(record, self.task, named)}")
            cases.append(
                {
                    "case": episode["id"],
                    "query": episode["query"],
                    "figures": {column.key: column.of(record, named) for column in self.columns},
                    "scene": episode.get("scene"),
                    "unit": _unit(run, record, named),
                }
            )
        return Worst(lines, cases, [], said)


def _unit(run: LoadedRun, record: Record, method: str) -> dict[str, Any] | None:
    """What `eagor.lab.tasks.sim.play.work` is given to play an episode again; None where the record does not say."""
    episode, first = record["episode"], run.settings.get("seed")
    if "slot" in episode:  # of an episode that a file lists
        return {"slot": episode["slot"], "methods": [method]}
    world, seed, index = (episode.get(key) for key in ("world", "seed", "index"))
    if world is None or not all(isinstance(value, int) for value in (first, seed, index)):
        return None
    number = (seed - first) * PER_PLACE + index  # by which some tasks deal their scenarios
    spec = {"task": run.study.name, "world": world, "seed": seed, "index": index, "number": number}
    return {"slot": spec, "methods": [method]}


def _judged(task: Task, settings: Settings) -> str:
    """What success means in this run; empty where its task has no such thing, or its rules are not known."""
    rules = settings.get("rules")
    try:
        return str(getattr(from_dict(task.rules, dict(rules)), "success_criterion", "")) if rules else ""
    except EagorError:  # of another version
        return ""


def _there(sheet: Sheet | None) -> list[Sheet]:
    return [] if sheet is None else [sheet]


def _lead(run: LoadedRun, task: Task) -> list[Part]:
    """The outcome in a sentence (ours, the published method, the best other one), and warnings."""
    summary, said = run.summary, []
    column = next(c for c in task.columns if c.key == task.headline)
    figures = {name: row[column.key] for name, row in summary["methods"].items() if is_rival(name)}
    figures = {name: value for name, value in figures.items() if value is not None}
    others = [name for name in figures if name not in (OURS, PAPERS)]
    others.sort(key=lambda name: figures[name] * (1 if column.better == "low" else -1))
    for name in [name for name in (OURS, PAPERS, *others[:1]) if name in figures]:
        interval = summary["intervals"][name][column.key]
        ends = f" ({shown(interval[0], column)} to {shown(interval[1], column)})" if interval else ""
        what = {OURS: "our default", PAPERS: "the method as published"}.get(name, "the best of the others")
        said.append(f"{name}, {what}: {shown(figures[name], column)}{column.unit}{ends}")
    lead: list[Part] = [
        page.text(f"{column.title}, {column.what}: {'; '.join(said)}." if said else "There are no results.")
    ]
    if run.settings.get("development"):
        text = "These are development seeds: parameters were chosen on them. The figures are no results."
        lead.append(page.text(text, "warn"))
    if summary.get("judged"):
        lead.append(page.text(f"{summary['judged'].capitalize()}.", "note"))
    if summary["failed"]:
        lead.append(page.text(f"{summary['failed']} units could not be run and are in no figure.", "warn"))
    return lead


def _facts(run: LoadedRun, task: Task) -> list[tuple[str, str]]:
    """What was run, from run.json and the records."""
    config, records, summary = run.settings, run.records, run.summary
    seeds = sorted({record["episode"]["seed"] for record in finished(records) if "seed" in record["episode"]})
    pairs = [("Task", task.title)]
    pairs += [(name.capitalize(), words(config[name])) for name in ("perception", "world", "rows") if name in config]
    if "episodes_file" in config:
        pairs.append(("Scenes played", str(len({record["episode"]["scene"] for record in finished(records)}))))
    elif seeds:
        spread = f"{seeds[0]} to {seeds[-1]} ({len(seeds)} of them)" if len(seeds) > 1 else str(seeds[0])
        kinds = {True: "development seeds, not results", False: "not development seeds"}
        kind = kinds.get(config.get("development", ""), "run.json does not say whether they are development seeds")
        pairs.append(("Seeds", f"{spread}; {kind}" if config.get("world", APARTMENT) == APARTMENT else spread))
    if summary.get("judged"):
        pairs.append(("Success", summary["judged"].removeprefix("success: ")))
    asked = words(config.get("episodes", "unknown"))
    pairs.append(("Episodes", f"{summary['episodes']} with results of {asked} asked"))
    pairs.append(("Units of work", f"{len(records)} recorded, {summary['failed']} of them failed"))
    pairs.append(("Methods", ", ".join(summary["methods"]) or "none has a result"))
    before = {"task", "perception", "world", "rows", "seed", "episodes", "development", "methods"}
    others = [(name.capitalize(), words(value)) for name, value in config.items() if name not in before]
    pairs += [(name, text) for name, text in others if text]
    pairs += _looked(records)
    pairs.append(("Computing time", computing_time(records)))
    means = "a mean is over the episodes that have a case"
    how = f"of whole apartments: Wilson's for shares of success, else {RESAMPLES} resamples; {means}"
    return [*pairs, ("Intervals", f"{100 * LEVEL:.0f} %; {how}")]


def _looked(records: Sequence[Record]) -> list[tuple[str, str]]:
    """Which model looked, how long a look took, and how many answers could not be read, where the records say so."""
    accounts = [r["looked"] for r in finished(records) if "looked" in r]
    accounts += [m["looked"] for r in finished(records) for m in r["methods"].values() if "looked" in m]
    if not accounts:
        return []
    looks, unread = (sum(account[key] for account in accounts) for key in ("looks", "unread"))
    times = [account["milliseconds"] for account in accounts if account["milliseconds"] is not None]
    sources = [source for account in accounts if (source := account["source"])]
    models = sorted({f"{s.get('model')} ({s.get('revision') or 'revision unknown'})" for s in sources})
    cost = f"; {sum(times) / len(times):.0f} ms each on average" if times else ""
    return [
        ("Model", ", ".join(models) or "unknown"),
        ("Looks", f"{looks}, of which {unread} with an answer that could not be read{cost}"),
    ]


def _degrees(config: Settings) -> dict[str, int]:
    """The degrees of our default and of the published method, where this code is the one that was run."""
    if config.get("versions", {}).get("eagor") != __version__:
        return {}
    from eagor.tracking.config import TrackerConfig

    return {OURS: TrackerConfig().degree, PAPERS: TrackerConfig.paper().degree}


def log_case(run: LoadedRun, worst: Worst, name: str | None, path: str | Path) -> str:
    """Play case `name` of a run (None: the worst one) again and log it; returns the case's name.

    Every method sees again what it saw in the run, so the figures are the recorded ones. The method has to have a
    belief: ours, or one of its variants.

    Raises `EagorError` for a benchmark of still pictures, an unknown case, or another method.
    """
    from eagor.drawing.rerun_log import RerunLog

    case = _named(run, worst, name)
    runner, spec = runner_of(run, case)
    (method,) = case["unit"]["methods"]
    if not isinstance(runner.method(method, spec), TrackerEstimator):
        raise EagorError(f"{method} keeps no belief that could be logged; give --method eagor, or a variant of it")
    with RerunLog(path, f"{run.study.name} {case['case']}: {case['query']}") as log:

        def add(seen: StepInfo) -> None:
            assert isinstance(seen.method, TrackerEstimator)
            log.add(
                seen.picture(LOGGED_ROWS), seen.method.estimate, stamp=seen.stamp, query=case["query"],
                position=seen.position, truth=seen.truth,
            )  # fmt: skip

        runner.run_episode(spec, [method], add)
    return str(case["case"])


def runner_of(run: LoadedRun, case: Mapping[str, Any]) -> tuple[Runner, EpisodeSpec]:
    """What plays a case of a run again. Raises `EagorError` for a benchmark of still pictures."""
    if case.get("unit") is None:
        raise EagorError(f"only episodes of simulated tasks can be played again, and {run.study.name} has none")
    return Runner(dict(run.settings)), spec_from_json(case["unit"]["slot"])


def _named(run: LoadedRun, worst: Worst, name: str | None) -> Mapping[str, Any]:
    if not worst.cases:
        raise EagorError(f"the run of {run.study.name} has no case to show")
    if name is None:
        return worst.cases[0]
    for case in worst.cases:
        if case["case"] == name:
            return case
    shown = ", ".join(str(case["case"]) for case in worst.cases[:5])
    raise EagorError(f"the run has no case {name!r}; it has {shown}{', ...' if len(worst.cases) > 5 else ''}")
