"""The report of a run: report.html (one file that needs nothing else), tables.md and tables.csv, in its folder.

Every number in them comes from the run's records or from `eagor.evaluation.published`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eagor._files import written
from eagor._version import __version__
from eagor.errors import EagorError
from eagor.evaluation import export, figures, ledger, page, scenes, sheets
from eagor.evaluation.charts import Series, legend, look_of
from eagor.evaluation.curves import Curve
from eagor.evaluation.published import OURS, PAPERS, is_ablation, is_rival, ordered
from eagor.evaluation.samples import LEVEL, RESAMPLES, Record, computing_time, finished
from eagor.evaluation.tables import shown, summarise
from eagor.tasks.rules import Camera
from eagor.tasks.task import Task, load


def write_report(folder: Path, open_place: scenes.OpenPlace | None = None) -> Path:
    """Write the report of the run in `folder`; returns the path of its page.

    Args:
        folder: of the run.
        open_place: makes a world again from its name, its seed and the body's radius;
            `eagor.tasks.places.load_place` where it is None.

    Raises:
        EagorError: there are no records, or of several tasks. FormatError: the folder is not a run's. OSError.
    """
    folder = Path(folder)
    config = ledger.description(folder)
    records = ledger.read(folder)
    if not records:
        raise EagorError(f"{folder} has no records yet; run something into it first")
    summary = summarise([{"task": config.get("task"), **record} for record in records])
    task = load(summary["task"])
    good = finished(records)
    degrees = _degrees(config)
    main = sheets.main_sheet(summary)
    ordering = sheets.ordering_sheet(good, task.name)
    made_of = sheets.parts_sheet(good, summary)
    covered = sheets.coverage_sheet(good, summary)
    strata = sheets.strata_sheets(summary)
    varied = sheets.ablation_sheets(summary, degrees)
    sections: list[figures.Section] = [("figures", "Figures", page.table(main) + _column_notes(task))]
    if ordering is not None:
        sections.append(("ordering", "How far the paper's ordering carries over", page.table(ordering)))
    if made_of is not None:
        sections.append(("parts", "What the errors are made of", page.table(made_of)))
    sections += figures.curve_sections(good, task)
    if strata:
        sections.append(("strata", "By kind of episode", "".join(map(page.table, strata))))
    if covered is not None:
        sections.append(
            ("coverage", "How honest the stated regions are", page.table(covered) + figures.reliability_chart(good))
        )
    if varied:
        sections.append(
            ("variants", "Variants", "".join(map(page.table, varied)) + figures.kernel_chart(summary, degrees))
        )
    sections.append(("episodes", "Three episodes to look at", _episodes(good, task, config, open_place)))
    if summary["failed"]:
        sections.append(("failed", "What could not be run", _failures(summary)))
    title = f"{task.title}: {summary['episodes']} episodes, {len(summary['methods'])} methods"
    facts = _facts(config, records, summary)
    path = folder / "report.html"
    written(path, page.document(title, _lead(config, summary, facts), sections, f"Made by eagor {__version__}."))
    tables = [sheet for sheet in (main, ordering, made_of, *strata, covered, *varied) if sheet is not None]
    written(folder / "tables.md", export.markdown(title, facts, tables))
    written(folder / "tables.csv", export.table_csv(summary))
    return path


def _lead(config: dict[str, Any], summary: dict[str, Any], facts: Sequence[tuple[str, str]]) -> str:
    """What stands before the contents: the outcome in a sentence or two, warnings, and what was run."""
    parts = [page.paragraph(text) for text in _outcome(summary)]
    if config.get("development"):
        parts.append(
            page.paragraph(
                "These are development seeds: parameters were chosen on them. The figures are no results.", "warn"
            )
        )
    if summary["failed"]:
        parts.append(page.paragraph(f"{summary['failed']} units could not be run and are in no figure.", "warn"))
    parts.append(page.facts(facts))
    return "\n".join(parts)


def _outcome(summary: dict[str, Any]) -> list[str]:
    """Ours, the published method and the best other one, in the column that says most."""
    task = load(summary["task"])
    column = next(c for c in task.columns if c.key == task.headline)
    figures = {name: row[column.key] for name, row in summary["methods"].items() if is_rival(name)}
    figures = {name: value for name, value in figures.items() if value is not None}
    others = [name for name in figures if name not in (OURS, PAPERS)]
    others.sort(key=lambda name: figures[name] * (1 if column.better == "low" else -1))
    named = [name for name in (OURS, PAPERS, *others[:1]) if name in figures]
    said = []
    for name in named:
        interval = summary["intervals"][name][column.key]
        ends = f" ({shown(interval[0], column)} to {shown(interval[1], column)})" if interval else ""
        what = {OURS: "our default", PAPERS: "the method as published"}.get(name, "the best of the others")
        said.append(f"{name}, {what}: {shown(figures[name], column)}{column.unit}{ends}")
    return [f"{column.title}, {column.what}: {'; '.join(said)}."] if said else ["There are no results."]


def _facts(config: dict[str, Any], records: Sequence[Record], summary: dict[str, Any]) -> list[tuple[str, str]]:
    """What was run, from run.json and the records."""
    seeds = sorted({record["episode"]["seed"] for record in finished(records) if "seed" in record["episode"]})
    kinds = {True: "development seeds, not results", False: "not development seeds"}
    pairs = [("Task", load(summary["task"]).title)]
    pairs += [
        (name.capitalize(), export.words(config[name])) for name in ("perception", "world", "rows") if name in config
    ]
    if seeds:
        spread = f"{seeds[0]} to {seeds[-1]} ({len(seeds)} of them)" if len(seeds) > 1 else str(seeds[0])
        kind = kinds.get(config.get("development", ""), "run.json does not say whether they are development seeds")
        pairs.append(("Seeds", f"{spread}; {kind}"))
    pairs.append(
        ("Episodes", f"{summary['episodes']} with results of {export.words(config.get('episodes', 'unknown'))} asked")
    )
    units = f"{len(records)} recorded, {summary['failed']} of them failed"
    pairs.append(("Units of work", units))
    shown_before = {"task", "perception", "world", "rows", "seed", "episodes", "development", "methods"}
    pairs.append(("Methods", ", ".join(summary["methods"])))
    pairs += [(name.capitalize(), export.words(value)) for name, value in config.items() if name not in shown_before]
    pairs += _looked(records)
    pairs.append(("Computing time", computing_time(records)))
    pairs.append(
        (
            "Intervals",
            f"{100 * LEVEL:.0f} %; Wilson's for shares of success, else {RESAMPLES} resamples of whole apartments; "
            "a mean is over the episodes that have a case",
        )
    )
    return pairs


def _looked(records: Sequence[Record]) -> list[tuple[str, str]]:
    """Which model looked, how long a look took, and how many answers could not be read, where the records say so."""
    accounts = [r["looked"] for r in finished(records) if "looked" in r]
    accounts += [m["looked"] for r in finished(records) for m in r["methods"].values() if "looked" in m]
    if not accounts:
        return []
    looks, unread = (sum(account[key] for account in accounts) for key in ("looks", "unread"))
    times = [account["milliseconds"] for account in accounts if account["milliseconds"] is not None]
    models = sorted(
        {f"{s.get('model')} ({s.get('revision') or 'revision unknown'})" for a in accounts if (s := a["source"])}
    )
    cost = f"; {sum(times) / len(times):.0f} ms each on average" if times else ""
    return [
        ("Model", ", ".join(models) or "unknown"),
        ("Looks", f"{looks}, of which {unread} with an answer that could not be read{cost}"),
    ]


def _column_notes(task: Task) -> str:
    pairs = [(f"{c.title}{f' ({c.unit})' if c.unit else ''}", c.what) for c in task.columns]
    return page.details("What the columns are", page.facts(pairs))


def _degrees(config: dict[str, Any]) -> dict[str, int]:
    """The degrees of our default and of the published method, where this code is the one that was run."""
    if config.get("versions", {}).get("eagor") != __version__:
        return {}
    from eagor.estimate import TrackerConfig

    return {OURS: TrackerConfig().degree, PAPERS: TrackerConfig.paper().degree}


def _episodes(
    records: Sequence[Record], task: Task, config: dict[str, Any], open_place: scenes.OpenPlace | None
) -> str:
    """The best, the median and the worst episode of our default method: a map, and six moments."""
    chosen = scenes.chosen(records, task)
    if not chosen:
        return page.paragraph(f"There is no episode with a result of {OURS}.")
    if open_place is None:
        from eagor.tasks.places import load_place

        open_place = load_place
    radius = float(config.get("camera", {}).get("radius", Camera().radius))
    parts = [
        page.paragraph(
            f"Chosen by the error of {OURS}" + (", after success and path length." if task.walked else "."),
            "note",
        )
    ]
    for kind, record in chosen.items():
        episode = record["episode"]
        parts.append(page.heading(f"The {kind}: {episode['query']}, episode {episode['id']}"))
        parts.append(page.paragraph(_said(record, task)))
        try:
            place = scenes.open_episode(record, radius, open_place)
            parts.append(_pictures(place, record, records, task))
        except (EagorError, ImportError, OSError) as error:
            parts.append(page.paragraph(f"No pictures: {error}", "note"))
        except (KeyError, IndexError) as error:  # only pictures need it: its place, its balls
            lacks = f"the record {record['key']!r} does not hold all that they need ({type(error).__name__}: {error})"
            parts.append(page.paragraph(f"No pictures: {lacks}", "note"))
    return "".join(parts)


def _pictures(place: Any, record: Record, records: Sequence[Record], task: Task) -> str:
    """The map and the strip of one episode, with a legend."""
    others = []
    if task.walked:
        same = [r for r in records if r["episode"]["id"] == record["episode"]["id"]]
        others = [r for r in same if (name := next(iter(r["methods"]))) != OURS and not is_ablation(name)]
    from_above = page.figures([(scenes.floor_map(place, record, others), "From above; numbers: the moments.")], "map")
    names = [*(next(iter(r["methods"])) for r in others), *(n for n in record["methods"] if is_rival(n))]
    empty = Curve((), (), (), (), ())
    key = legend([Series(name, empty, look_of(name), name == OURS) for name in ordered(names)])
    caption = "White ring: the truth. Marks: what each method says. The middle is straight ahead, the edges are behind."
    return from_above + key + page.figures(scenes.strip(place, record), "strip") + page.paragraph(caption, "note")


def _said(record: Record, task: Task) -> str:
    """The episode's figures in words."""
    metrics = record["methods"][OURS]["metrics"]
    found = []
    for column in task.columns:
        value = metrics.get(column.metric)
        if value is None or (column.only_if and not metrics.get(column.only_if)):
            continue
        found.append(f"{column.title} {shown(column.scale * value, column)}{column.unit}")
    return f"{OURS}: {', '.join(found)}."


def _failures(summary: dict[str, Any]) -> str:
    lines = [f"{f['key']} (attempt {f['attempt']}): {f['error']}" for f in summary["failures"]]
    return page.paragraph("These units are in no figure above.") + page.items(lines)
