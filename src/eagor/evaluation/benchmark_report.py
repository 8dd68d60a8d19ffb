"""The report of runs of a benchmark: report.html (needs nothing else), tables.md, tables.csv, tables.tex.

Every number in them comes from the runs' records or from `eagor.evaluation.published_search`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eagor._csv import as_csv
from eagor._files import written
from eagor._version import __version__
from eagor.errors import EagorError
from eagor.evaluation import benchmark_sheets, export, page, scores
from eagor.evaluation.benchmarks import read_run
from eagor.evaluation.charts import Series, legend, line_chart
from eagor.evaluation.curves import Curve
from eagor.evaluation.samples import LEVEL, RESAMPLES, Record, computing_time
from eagor.evaluation.sheets import Sheet
from eagor.tasks.benchmark import load


def write_report(folders: Sequence[Path], out: Path | None = None) -> Path:
    """Write the report of the runs in `folders`, all of one benchmark, into `out` (None: the first folder).

    Returns the path of its page. Raises `EagorError` where there are no records, or several benchmarks; `StorageError`.
    """
    runs = [read_run(Path(folder)) for folder in folders]
    if not runs:
        raise EagorError("no run is named; wanted the folder of one or several")
    tasks = {str(settings["task"]) for settings, _ in runs}
    if len(tasks) > 1:
        raise EagorError(f"the runs are of {', '.join(sorted(tasks))}; one report is about one benchmark")
    out = Path(out or folders[0])
    summaries = [scores.summarise(settings, records) for settings, records in runs]
    sheets = [benchmark_sheets.main_sheet(summaries)]
    turns, views = benchmark_sheets.turn_sheet(summaries), benchmark_sheets.views_sheet(summaries)
    sections = [("figures", "Figures", page.table(sheets[0]))]
    if turns is not None:
        sections.append(("turns", "By turn", _turn_chart(summaries) + page.details("The numbers", page.table(turns))))
        sheets.append(turns)
    if views is not None:
        sections.append(("views", "Views, and stopping", page.table(views) + _reliability_chart(summaries)))
        sheets.append(views)
    for label, summary, (settings, records) in zip(benchmark_sheets.labels_of(summaries), summaries, runs, strict=True):
        found = failure_sheets(settings, summary)
        if found:
            lines = benchmark_sheets.failed_lines(records, 200)
            listed = page.details(f"The cases that failed ({len(lines)} shown)", page.items(lines)) if lines else ""
            sections.append(
                (f"failures-{len(sections)}", f"Failures: {label}", "".join(map(page.table, found)) + listed)
            )
            sheets += [Sheet(f"{sheet.title}: {label}", sheet.heads, sheet.rows, sheet.notes) for sheet in found]
        if summary["failed"]:
            errors = [f"{f['key']} (attempt {f['attempt']}): {f['error']}" for f in summary["failures"]]
            note = page.paragraph("These are errors, not wrong answers: they are in no figure above.")
            sections.append((f"errors-{len(sections)}", f"What could not be run: {label}", note + page.items(errors)))
    title = f"{load(tasks.pop()).title}: {summaries[0]['episodes']} cases" + (
        f", {len(runs)} runs" if len(runs) > 1 else ""
    )
    facts: list[tuple[str, str]] = []
    for label, summary, (settings, records) in zip(benchmark_sheets.labels_of(summaries), summaries, runs, strict=True):
        facts += [("Run", label)] if len(runs) > 1 else []
        facts += _facts(settings, summary, records)
    lead = page.paragraph(_outcome(summaries)) + page.details("What was run", page.facts(facts))
    path = out / "report.html"
    written(path, page.document(title, lead, sections, f"Made by eagor {__version__}."))
    written(out / "tables.md", export.markdown(title, facts, sheets))
    written(out / "tables.csv", figures_csv(summaries))
    written(out / "tables.tex", latex(sheets[0]))
    return path


def failure_sheets(settings: Mapping[str, Any], summary: Mapping[str, Any]) -> list[Sheet]:
    """Both layers of the failure table of one run."""
    meanings = getattr(load(str(settings["task"])), "causes", {})
    found = benchmark_sheets.tag_sheet(summary), benchmark_sheets.cause_sheet(summary, meanings)
    return [sheet for sheet in found if sheet is not None]


def figures_csv(summaries: Sequence[Mapping[str, Any]]) -> str:
    """One row per run and figure, at full precision; empty where there is no case."""
    names = (
        "task", "run", "agent", "perception", "model", "figure", "value", "n",
        "wilson_low", "wilson_high", "cluster_low", "cluster_high",
    )  # fmt: skip
    rows: list[dict[str, Any]] = []
    for label, summary in zip(benchmark_sheets.labels_of(summaries), summaries, strict=True):
        for figure in load(str(summary["task"])).figures:
            ends = summary["intervals"][figure.key]
            wilson, cluster = ends["wilson"] or (None, None), ends["cluster"] or (None, None)
            row = {key: summary.get(key) for key in ("task", "agent", "perception", "model")}
            row |= {
                "run": label,
                "figure": figure.key,
                "value": summary[figure.key],
                "n": summary["counts"][figure.key],
            }
            row |= {"wilson_low": wilson[0], "wilson_high": wilson[1]}
            rows.append(row | {"cluster_low": cluster[0], "cluster_high": cluster[1]})
    return as_csv([names, *([row.get(name) for name in names] for row in rows)])


def latex(sheet: Sheet) -> str:
    """The main table as a LaTeX tabular, without its intervals."""
    marks = str.maketrans({
        "%": r"\%", "&": r"\&", "_": r"\_", "#": r"\#", "$": r"\$", "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}", "\\": r"\textbackslash{}", "·": r"$\cdot$", "↑": r"$\uparrow$",
        "↓": r"$\downarrow$", "–": "--",
    })  # fmt: skip

    def plain(text: str) -> str:
        return text.translate(marks)

    lines = [rf"\begin{{tabular}}{{l{'r' * (len(sheet.heads) - 1)}}}", r"\toprule"]
    lines += [" & ".join(map(plain, sheet.heads)) + r" \\", r"\midrule"]
    lines += [" & ".join([plain(row.head), *(plain(box.text) for box in row.boxes)]) + r" \\" for row in sheet.rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _outcome(summaries: Sequence[Mapping[str, Any]]) -> str:
    said = []
    for label, summary in zip(benchmark_sheets.labels_of(summaries), summaries, strict=True):
        if summary["overall"] is None:
            said.append(f"{label}: no results")
            continue
        ends = summary["intervals"]["overall"]["cluster"] or summary["intervals"]["overall"]["wilson"]
        span = f" ({ends[0]:.1f} to {ends[1]:.1f})" if ends else ""
        said.append(f"{label}: {summary['overall']:.1f} %{span}")
    return "Overall: " + "; ".join(said) + "."


def _facts(settings: Mapping[str, Any], summary: Mapping[str, Any], records: Sequence[Record]) -> list[tuple[str, str]]:
    pairs = [
        (key.capitalize(), export.words(value))
        for key, value in settings.items()
        if key != "kind" and value is not None
    ]
    pairs.append(("Cases", f"{summary['episodes']} with results, {summary['failed']} without"))
    pairs.append(("Computing time", computing_time(records)))
    return [*pairs, ("Intervals", f"{100 * LEVEL:.0f} %; Wilson's, and {RESAMPLES} resamples of whole clusters")]


def _turn_chart(summaries: Sequence[Mapping[str, Any]]) -> str:
    series = []
    for index, (label, summary) in enumerate(zip(benchmark_sheets.labels_of(summaries), summaries, strict=True)):
        if curve := summary.get("by_turn"):
            count = len(curve["success"])
            points = Curve(
                tuple(float(k + 1) for k in range(count)),
                tuple(curve["success"]),
                tuple(curve["low"]),
                tuple(curve["high"]),
                (summary["episodes"],) * count,
            )
            ours = summary["agent"] == benchmark_sheets.OURS
            series.append(Series(label, points, f"x{index % 8}", ours))
    chart = line_chart(series, "Success by turn", "turn", "success, %", (0.0, 100.0))
    return page.figures([(f"{chart}{legend(series)}", "Success had the answer been given at this turn; 95 % bands.")])


def _reliability_chart(summaries: Sequence[Mapping[str, Any]]) -> str:
    """Stated against found: of the submissions, and of what would have been submitted at every turn."""
    pictures = []
    for key, title in (("reliability", "of submissions"), ("reliability_by_step", "of the answers at every turn")):
        series = []
        for index, (label, summary) in enumerate(zip(benchmark_sheets.labels_of(summaries), summaries, strict=True)):
            rows = [row for row in summary.get(key, ()) if row[2]]
            if rows:
                none = (None,) * len(rows)
                points = Curve(
                    tuple(row[3] for row in rows), tuple(row[4] for row in rows), none, none, tuple(r[2] for r in rows)
                )
                series.append(Series(label, points, f"x{index % 8}", summary["agent"] == benchmark_sheets.OURS))
        if series and any(len(line.curve.x) > 1 for line in series):
            chart = line_chart(
                series, f"Reliability {title}", "stated probability of success", "share that succeeded", (0.0, 1.0),
                diagonal=True,
            )  # fmt: skip
            counts = "; ".join(f"{line.name}: {' '.join(map(str, line.curve.n))}" for line in series)
            caption = (
                f"Reliability {title}: on the dotted line what is stated is what happens. Cases per mark, {counts}."
            )
            pictures.append((f"{chart}{legend(series)}", caption))
    return page.figures(pictures) if pictures else ""
