"""A simulated task as a study: how its runs are counted, what their report says, and an episode of one played again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eagor import worlds
from eagor._version import __version__
from eagor.errors import EagorError
from eagor.evaluation import export, scenes, sheets, tables
from eagor.evaluation.page import Facts, Folded, Heading, Part, Pictures, Section, Sheet, Text, could_not, legend
from eagor.evaluation.samples import LEVEL, RESAMPLES, Record, computing_time, finished
from eagor.evaluation.study import LoadedRun, Report, Settings, Summary, Worst
from eagor.evaluation.tables import OURS, PAPERS, is_ablation, is_rival, ordered, shown
from eagor.tasks.episodes import PER_PLACE, Slot, slot_of
from eagor.tasks.methods import TrackerMethod
from eagor.tasks.play import Player, Seen
from eagor.tasks.rules import Camera, from_dict
from eagor.tasks.task import Task

EXPORTS = {
    "jsonl": "all records as JSON lines, one per unit of work",
    "csv": "a row per episode and method with its figures",
    "parquet": "the same as a Parquet file (extra parquet)",
}
LOGGED_ROWS = 256  # of panoramas of an episode that is logged


class Simulated:
    """See `eagor.evaluation.study.Study`."""

    work = "eagor.tasks.play:work"
    case, several = "episode", False
    alike, exports = ("world",), EXPORTS

    def __init__(self, task: Task) -> None:
        self.task, self.name, self.columns = task, task.name, task.columns

    def offer(self) -> dict[str, Any]:
        known = {"worlds": sorted(worlds.known()), "exports": EXPORTS}
        return {"title": self.task.title, "what": self.task.what, **known}

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
        main = sheets.main_sheet(summary)
        ordering = _there(sheets.ordering_sheet(good, task.name))
        made_of = _there(sheets.parts_sheet(good, summary))
        covered = _there(sheets.coverage_sheet(good, summary))
        strata = sheets.strata_sheets(summary)
        varied = sheets.ablation_sheets(summary, degrees)
        named = [(f"{c.title}{f' ({c.unit})' if c.unit else ''}", c.what) for c in task.columns]
        honest = [*covered, *sheets.reliability_chart(good)] if covered else []
        variants = [*varied, *sheets.kernel_chart(summary, degrees)] if varied else []
        sections = [
            Section("figures", "Figures", [main, Folded("What the columns are", [Facts(named)])]),
            Section("ordering", "How far the paper's ordering carries over", ordering),
            Section("parts", "What the errors are made of", made_of),
            *sheets.curve_sections(good, task),
            Section("strata", "By kind of episode", strata),
            Section("coverage", "How honest the stated regions are", honest),
            Section("variants", "Variants", variants),
            Section("episodes", "Three episodes to look at", _episodes(good, task, run.settings, open_place)),
            Section("failed", "What could not be run", could_not(summary) if summary["failed"] else []),
        ]
        facts = _facts(run, task)
        return Report(
            f"{task.title}: {summary['episodes']} episodes, {len(summary['methods'])} methods",
            [*_lead(run, task), Facts(facts)],
            [section for section in sections if section.parts],
            facts,
            [main, *ordering, *made_of, *strata, *covered, *varied],
            {"tables.csv": export.table_csv(summary)},
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
            lines.append(f"{episode['id']}  {episode['query']!r}  {_said(record, self.task, named)}")
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

    def export(self, to: str, run: LoadedRun, folder: Path) -> list[Path]:
        return [export.TABLES.get(to, export.records_jsonl)(run, folder)]


def _unit(run: LoadedRun, record: Record, method: str) -> dict[str, Any] | None:
    """What `eagor.tasks.play.work` is given to play an episode again; None where the record does not say."""
    episode, first = record["episode"], run.settings.get("seed")
    if "slot" in episode:  # of an episode that a file lists
        return {"slot": episode["slot"], "methods": [method]}
    world, seed, index = (episode.get(key) for key in ("world", "seed", "index"))
    if world is None or not all(isinstance(value, int) for value in (first, seed, index)):
        return None
    number = (seed - first) * PER_PLACE + index  # by which some tasks deal their scenarios
    slot = {"task": run.study.name, "world": world, "seed": seed, "index": index, "number": number}
    return {"slot": slot, "methods": [method]}


def _judged(task: Task, settings: Settings) -> str:
    """What success means in this run; empty where its task has no such thing, or its rules are not known."""
    rules = settings.get("rules")
    try:
        return str(getattr(from_dict(task.rules, dict(rules)), "judged", "")) if rules else ""
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
    lead: list[Part] = [Text(f"{column.title}, {column.what}: {'; '.join(said)}." if said else "There are no results.")]
    if run.settings.get("development"):
        text = "These are development seeds: parameters were chosen on them. The figures are no results."
        lead.append(Text(text, "warn"))
    if summary.get("judged"):
        lead.append(Text(f"{summary['judged'].capitalize()}.", "note"))
    if summary["failed"]:
        lead.append(Text(f"{summary['failed']} units could not be run and are in no figure.", "warn"))
    return lead


def _facts(run: LoadedRun, task: Task) -> list[tuple[str, str]]:
    """What was run, from run.json and the records."""
    config, records, summary, words = run.settings, run.records, run.summary, export.words
    seeds = sorted({record["episode"]["seed"] for record in finished(records) if "seed" in record["episode"]})
    pairs = [("Task", task.title)]
    pairs += [(name.capitalize(), words(config[name])) for name in ("perception", "world", "rows") if name in config]
    if "episodes_file" in config:
        pairs.append(("Scenes played", str(len({record["episode"]["scene"] for record in finished(records)}))))
    elif seeds:
        spread = f"{seeds[0]} to {seeds[-1]} ({len(seeds)} of them)" if len(seeds) > 1 else str(seeds[0])
        kinds = {True: "development seeds, not results", False: "not development seeds"}
        kind = kinds.get(config.get("development", ""), "run.json does not say whether they are development seeds")
        pairs.append(("Seeds", f"{spread}; {kind}"))
    if summary.get("judged"):
        pairs.append(("Success", summary["judged"].removeprefix("success: ")))
    asked = words(config.get("episodes", "unknown"))
    pairs.append(("Episodes", f"{summary['episodes']} with results of {asked} asked"))
    pairs.append(("Units of work", f"{len(records)} recorded, {summary['failed']} of them failed"))
    pairs.append(("Methods", ", ".join(summary["methods"])))
    before = {"task", "perception", "world", "rows", "seed", "episodes", "development", "methods"}
    others = [(name.capitalize(), words(value)) for name, value in config.items() if name not in before]
    pairs += [(name, text) for name, text in others if text]
    pairs += _looked(records)
    pairs.append(("Computing time", computing_time(records)))
    means = "a mean is over the episodes that have a case"
    how = f"Wilson's for shares of success, else {RESAMPLES} resamples of whole apartments; {means}"
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


def _episodes(
    records: Sequence[Record], task: Task, config: Settings, open_place: scenes.OpenPlace | None
) -> list[Part]:
    """The best, the median and the worst episode of our default method: a map, and six moments."""
    chosen = scenes.chosen(records, task)
    if not chosen:
        return [Text(f"There is no episode with a result of {OURS}.")]
    if open_place is None:
        from eagor.tasks.places import load_place as open_place
    radius = float(config.get("camera", {}).get("radius", Camera().radius))
    by = f"Chosen by the error of {OURS}" + (", after success and path length." if task.walked else ".")
    parts: list[Part] = [Text(by, "note")]
    for kind, record in chosen.items():
        episode = record["episode"]
        parts.append(Heading(f"The {kind}: {episode['query']}, episode {episode['id']}"))
        parts.append(Text(_said(record, task)))
        try:
            place = scenes.open_episode(record, radius, open_place)
            parts += _pictures(place, record, records, task, scenes.search_of(place, record, _camera(config)))
        except (EagorError, ImportError, OSError) as error:
            parts.append(Text(f"No pictures: {error}", "note"))
        except (KeyError, IndexError) as error:  # only pictures need it: its place, its balls
            lacks = f"the record {record['key']!r} does not hold all that they need ({type(error).__name__}: {error})"
            parts.append(Text(f"No pictures: {lacks}", "note"))
    return parts


def _camera(config: Settings) -> Camera | None:
    """The camera of a run; None if it is one of another version."""
    try:
        return from_dict(Camera, dict(config.get("camera", {})))
    except EagorError:
        return None


def _pictures(
    place: Any, record: Record, records: Sequence[Record], task: Task, search: scenes.Search | None
) -> list[Part]:
    """The map and the strip of one episode, with a legend; with a key to its `search`, if it was one."""
    others = []
    if task.walked:
        same = [r for r in records if r["episode"]["id"] == record["episode"]["id"]]
        others = [r for r in same if (name := next(iter(r["methods"]))) != OURS and not is_ablation(name)]
    names = ordered([*(next(iter(r["methods"])) for r in others), *(n for n in record["methods"] if is_rival(n))])
    above = [
        (scenes.floor_map(place, record, others, search), "From above; numbers: the moments."),
        *([(scenes.key_to_search(search, str(record["key"])), search.caption)] if search is not None else []),
        (legend(names, OURS, str(record["key"])), "Each method's line and mark."),
    ]
    caption = "White ring: the truth. Marks: what each method says. The middle is straight ahead, the edges are behind."
    return [Pictures(above, "map"), Pictures(scenes.strip(place, record), "strip"), Text(caption, "note")]


def _said(record: Record, task: Task, method: str = OURS) -> str:
    """The figures of a method in an episode, in words."""
    values = [(column, column.of(record, method)) for column in task.columns]
    told = ", ".join(f"{c.title} {shown(value, c)}{c.unit}" for c, value in values if value is not None)
    return f"{method}: {told}."


def log_case(run: LoadedRun, worst: Worst, name: str | None, path: str | Path) -> str:
    """Play case `name` of a run (None: the worst one) again and log it; returns the case's name.

    Every method sees again what it saw in the run, so the figures are the recorded ones. The method has to have a
    belief: ours, or one of its variants.

    Raises `EagorError` for a benchmark of still pictures, an unknown case, or another method.
    """
    from eagor.drawing.rerun_log import RerunLog

    case = _named(run, worst, name)
    player, slot = player_of(run, case)
    (method,) = case["unit"]["methods"]
    if not isinstance(player.method(method, slot), TrackerMethod):
        raise EagorError(f"{method} keeps no belief that could be logged; give --method eagor, or a variant of it")
    with RerunLog(path, f"{run.study.name} {case['case']}: {case['query']}") as log:

        def add(seen: Seen) -> None:
            assert isinstance(seen.method, TrackerMethod)
            log.add(
                seen.picture(LOGGED_ROWS), seen.method.estimate, stamp=seen.stamp, query=case["query"],
                position=seen.position, truth=seen.truth,
            )  # fmt: skip

        player.play(slot, [method], add)
    return str(case["case"])


def player_of(run: LoadedRun, case: Mapping[str, Any]) -> tuple[Player, Slot]:
    """What plays a case of a run again. Raises `EagorError` for a benchmark of still pictures."""
    if case.get("unit") is None:
        raise EagorError(f"only episodes of simulated tasks can be played again, and {run.study.name} has none")
    return Player(dict(run.settings)), slot_of(case["unit"]["slot"])


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
