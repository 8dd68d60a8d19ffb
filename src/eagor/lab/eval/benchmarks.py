"""A benchmark with published data as a study: its runs, how they are counted, and what their report says.

Predictions that were made elsewhere are read, judged by the benchmark's rules, and kept as a run.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from eagor._checks import parsed, shown
from eagor._files import read_file
from eagor._tables import as_csv
from eagor.errors import EagorError, FormatError
from eagor.lab.eval import benchmark_tables, log, page
from eagor.lab.eval.benchmark_tables import OURS, labels_of
from eagor.lab.eval.page import Curve, Part, Section, Series, Sheet, could_not, line_chart, lines_of
from eagor.lab.eval.runner import Unit
from eagor.lab.eval.samples import FEW, LEVEL, RESAMPLES, checked, computing_time, finished, published
from eagor.lab.eval.study import LoadedRun, Report, Settings, Study, Summary, Worst, words
from eagor.lab.tasks.benchmark import Benchmark, Case, Record, load, read_options

KIND = "benchmark"  # in run.json: which kind of run this is
LISTED = 200  # failed cases in a report


@dataclass(frozen=True)
class BenchmarkRun:
    """What is run. `options` are the benchmark's own; None in them is "as it is by default".

    `limit`: only the first so many cases; `shard`: (i, n), every n-th case from the i-th on, counted from 1. Neither
    changes what a case is called, so any parts of a run fit into one folder.
    """

    task: str
    data: Path
    agent: str | None = None
    perception: str | None = None
    model: str | None = None
    seed: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)
    calibrated: Mapping[str, Any] | None = None
    limit: int | None = None
    shard: tuple[int, int] = (1, 1)

    @property
    def benchmark(self) -> Benchmark:
        """The benchmark of the task."""
        return load(self.task)

    def config(self) -> dict[str, Any]:
        """Everything that decides the results, as the JSON of run.json. Raises `EagorError` for what does not fit."""
        benchmark = self.benchmark
        if self.seed < 0:
            raise EagorError(f"seed {self.seed}; wanted a whole number from 0 on")
        told: dict[str, Any] = {
            "task": self.task,
            "data": str(Path(self.data).resolve()),
            "agent": self.agent or next(iter(benchmark.agents)),
            "perception": self.perception,
            "model": self.model,
            "seed": self.seed,
            **read_options(benchmark, self.options),
        }
        if self.calibrated:
            told["calibrated"] = dict(self.calibrated)
        return {"kind": KIND, **benchmark.settle(told)}

    def cases(self, config: Settings) -> list[Case]:
        """The cases of this part of the run. Raises `EagorError` for an impossible limit or shard."""
        part, parts = self.shard
        if not (1 <= part <= parts):
            raise EagorError(f"shard {part}/{parts}; wanted i/n with 1 <= i <= n, such as 1/4")
        if self.limit is not None and self.limit < 1:
            raise EagorError(f"a limit of {self.limit} cases; wanted 1 or more")
        found = self.benchmark.cases(Path(self.data), config)[: self.limit]
        return found[part - 1 :: parts]

    def units(self, config: Settings) -> list[Unit]:
        """One unit of work per case."""
        return [Unit(f"{self.task}/{case.id}", case.group, case.payload) for case in self.cases(config)]


class Published(Study):
    """See `eagor.lab.eval.study.Study`."""

    case, several = "case", True
    alike = ("data",)

    def __init__(self, benchmark: Benchmark) -> None:
        self.benchmark, self.name, self.work = benchmark, benchmark.name, benchmark.work
        self.columns = benchmark.figures

    @classmethod
    def of(cls, settings: Settings, folder: Path) -> Published:
        """The study of the run in `folder`. Raises `EagorError` if it is no run of a benchmark."""
        if settings.get("kind") != KIND:
            task = settings.get("task")
            raise EagorError(f"{folder} holds a run of {task}, which is no benchmark with published data")
        for key in ("task", "data"):
            if not isinstance(settings.get(key), str):
                raise FormatError(f"{Path(folder) / log.RUN} does not name its {key}; restore it")
        return cls(load(settings["task"]))

    def offer(self) -> dict[str, Any]:
        options = self.benchmark.options.items()
        return {
            "title": self.benchmark.title,
            "agents": dict(self.benchmark.agents),
            "options": {
                key: {"default": o.default, "what": o.what, "choices": _short(o.choices)} for key, o in options
            },
        }

    def checked(self, records: Sequence[Record]) -> Sequence[Record]:
        """`records`, as this benchmark writes them. Raises `FormatError`, which names it, for a malformed one."""
        return checked(records, published(getattr(self.benchmark, "record", {})))

    def loaded(self, settings: Settings, records: Sequence[Record]) -> LoadedRun:
        return LoadedRun(
            self, settings, self.checked(records), benchmark_tables.summarise(settings, records, self.benchmark)
        )

    def as_text(self, summary: Summary) -> list[str]:
        sheet = benchmark_tables.main_sheet(self.benchmark, [summary], published=False)
        lines = [f"{sheet.title}: {summary['episodes']} cases in {summary['clusters']} clusters"]
        lines += [*lines_of(sheet), "In brackets: 95 %, Wilson's | cluster bootstrap."]
        lines += benchmark_tables.few_clusters([summary])
        return lines + ([f"{summary['failed']} could not be run; they are in no figure."] if summary["failed"] else [])

    def as_json(self, summary: Summary) -> dict[str, Any]:
        return summary

    def failure_sheets(self, summary: Summary) -> list[Sheet]:
        """Both layers of the failure table of one run."""
        meanings = getattr(self.benchmark, "causes", {})
        found = benchmark_tables.tag_sheet(summary), benchmark_tables.cause_sheet(summary, meanings)
        return [sheet for sheet in found if sheet is not None]

    def planned(self, settings: Settings) -> int | None:
        try:
            return len(self.benchmark.cases(Path(str(settings["data"])), settings))
        except (EagorError, OSError, LookupError, TypeError, ValueError):  # the data, or what run.json says of them
            return None

    def report(self, runs: Sequence[LoadedRun], open_place: Any = None) -> Report:
        summaries = [run.summary for run in runs]
        labels, planned = labels_of(summaries), [self.planned(run.settings) for run in runs]
        turns, views = benchmark_tables.turn_sheet(summaries), benchmark_tables.views_sheet(summaries)
        sheets = [benchmark_tables.main_sheet(self.benchmark, summaries)]
        sections = [Section("figures", "Figures", [*sheets])]
        if turns is not None:
            sheets.append(turns)
            sections.append(Section("turns", "By turn", [_turn_chart(summaries), page.folded("The numbers", turns)]))
        if views is not None:
            sheets.append(views)
            sections.append(Section("views", "Views, and stopping", [views, *_reliability_charts(summaries)]))
        facts: list[tuple[str, str]] = []
        for label, run, whole in zip(labels, runs, planned, strict=True):
            if found := self.failure_sheets(run.summary):
                parts: list[Part] = [*found]
                if lines := self.worst(run).lines[:LISTED]:
                    parts.append(page.folded(f"The cases that failed ({len(lines)} shown)", page.items(lines)))
                sections.append(Section(f"failures-{len(sections)}", f"Failures: {label}", parts))
                sheets += [Sheet(f"{sheet.title}: {label}", sheet.heads, sheet.rows, sheet.notes) for sheet in found]
            if run.summary["failed"]:
                title = f"What could not be run: {label}"
                sections.append(Section(f"errors-{len(sections)}", title, could_not(run.summary)))
            facts += [("Run", label)] if len(runs) > 1 else []
            facts += _facts(run, whole)
        counts = [_of(summary["episodes"], whole) for summary, whole in zip(summaries, planned, strict=True)]
        many = f", {len(runs)} runs" if len(runs) > 1 else ""
        return Report(
            f"{self.benchmark.title}: {' and '.join(dict.fromkeys(counts))} cases{many}",
            [page.text(_outcome(labels, summaries)), page.folded("What was run", page.facts(facts))],
            sections,
            facts,
            sheets,
            {"tables.csv": _csv(self.benchmark, labels, summaries)}
            | ({"predictions.jsonl": predictions_of(runs[0].records)} if len(runs) == 1 else {}),
        )

    def worst(self, run: LoadedRun, method: str | None = None) -> Worst:
        if method:
            raise EagorError(f"a run of {self.name} has one agent; leave out the method {method}")
        keys = ("task", "agent", "episodes", "failed", "tags", "causes", "failures")
        failed = benchmark_tables.failed(run.records)
        cases = [
            {key: record.get(key) for key in ("case", "cause", "tags", "answer", "error")} | {"cause": cause}
            for record, cause in failed
        ]
        said = {key: run.summary[key] for key in keys}
        return Worst(benchmark_tables.failed_lines(failed), cases, self.failure_sheets(run.summary), said)


def _short(choices: tuple[Any, ...]) -> Any:
    """Ranges of numbers as their ends: nobody reads fifty of them."""
    if len(choices) > 8 and all(isinstance(choice, int) for choice in choices):
        return f"{min(choices)} to {max(choices)}"
    return list(choices)


def _outcome(labels: Sequence[str], summaries: Sequence[Summary]) -> str:
    said = []
    for label, summary in zip(labels, summaries, strict=True):
        if summary["overall"] is None:
            said.append(f"{label}: no results")
            continue
        both = summary["intervals"]["overall"]
        ends, few = both["cluster"], summary["clusters"] < FEW
        if few or not ends or ends[0] == ends[1]:  # resampling cannot tell how uncertain the figure is
            ends = both["wilson"]
        span = f" ({ends[0]:.1f} to {ends[1]:.1f})" if ends else " (too few clusters for an interval)" if few else ""
        said.append(f"{label}: {summary['overall']:.1f} %{span}")
    return "Overall: " + "; ".join(said) + "."


def _of(there: int, planned: int | None) -> str:
    """How many cases there are, and of how many, where that is a part."""
    return str(there) if planned is None or there >= planned else f"{there} of {planned}"


def _facts(run: LoadedRun, planned: int | None) -> list[tuple[str, str]]:
    settings = [(key, value) for key, value in run.settings.items() if key != "kind" and value is not None]
    return [
        *((key.capitalize(), words(value)) for key, value in settings),
        ("Cases", f"{_of(run.summary['episodes'], planned)} with results, {run.summary['failed']} could not be run"),
        ("Computing time", computing_time(run.records)),
        ("Intervals", f"{100 * LEVEL:.0f} %; Wilson's, and {RESAMPLES} resamples of whole clusters"),
    ]


def _csv(benchmark: Benchmark, labels: Sequence[str], summaries: Sequence[Summary]) -> str:
    """One row per run and figure, at full precision; empty where there is no case."""
    heads = (
        "task", "run", "agent", "perception", "model", "figure", "value", "n",
        "wilson_low", "wilson_high", "cluster_low", "cluster_high",
    )  # fmt: skip
    rows: list[Sequence[Any]] = []
    for label, summary in zip(labels, summaries, strict=True):
        who = summary.get("task"), label, *(summary.get(key) for key in ("agent", "perception", "model"))
        for figure in benchmark.figures:
            ends = summary["intervals"][figure.key]
            both = (*(ends["wilson"] or (None, None)), *(ends["cluster"] or (None, None)))
            rows.append((*who, figure.key, summary[figure.key], summary["counts"][figure.key], *both))
    return as_csv([heads, *rows])


def _curves(summaries: Sequence[Summary], curve_of: Callable[[Summary], Curve | None]) -> Iterator[Series]:
    """A line of a chart for each run that has one."""
    for index, (label, summary) in enumerate(zip(labels_of(summaries), summaries, strict=True)):
        if (curve := curve_of(summary)) is not None:
            yield Series(label, curve, f"x{index % 8}", summary["agent"] == OURS)


def _turn_chart(summaries: Sequence[Summary]) -> Part:
    def curve(summary: Summary) -> Curve | None:
        if not (told := summary.get("by_turn")):
            return None
        count = len(told["success"])
        x = tuple(float(k + 1) for k in range(count))
        return Curve(x, tuple(told["success"]), tuple(told["low"]), tuple(told["high"]), (summary["episodes"],) * count)

    series = list(_curves(summaries, curve))
    chart = line_chart(series, "Success by turn", "turn", "success, %", (0.0, 100.0))
    return page.pictures([(chart, f"Success had the answer been given at this turn{page.bands(series)}.")])


def _reliability_charts(summaries: Sequence[Summary]) -> list[Part]:
    """Stated against found: of the submissions, and of what would have been submitted at every turn."""
    pictures = []
    for key, title in (("reliability", "of submissions"), ("reliability_by_step", "of the answers at every turn")):

        def curve(summary: Summary, key: str = key) -> Curve | None:
            rows = [row for row in summary.get(key, ()) if row[2]]
            none = (None,) * len(rows)
            x, y, n = (tuple(row[k] for row in rows) for k in (3, 4, 2))
            return Curve(x, y, none, none, n) if rows else None

        series = list(_curves(summaries, curve))
        if any(len(line.curve.x) > 1 for line in series):
            labels = "stated probability of success", "share that succeeded"
            chart = line_chart(series, f"Reliability {title}", *labels, (0.0, 1.0), diagonal=True)
            counts = "; ".join(f"{line.name}: {' '.join(map(str, line.curve.n))}" for line in series)
            caption = "on the dotted line what is stated is what happens. Cases per mark"
            pictures.append((chart, f"Reliability {title}: {caption}, {counts}."))
    return [page.pictures(pictures)] if pictures else []


# --- predictions that were made elsewhere -----------------------------------------------------------------------------

IDS = ("case", "id", "doc_id")  # what names the case in a line: its id, or its number in the benchmark's own order


def read_predictions(
    source: Path, task: str | None = None, data: Path | None = None, options: Mapping[str, Any] | None = None
) -> tuple[LoadedRun, list[Case], dict[str, dict[str, Any]]]:
    """What is predicted, its cases, and predictions by case, from a JSON lines file or the folder of a run.

    `task` and `data` are needed where `source` is no run; `options` go over those of the run. Raises `EagorError` or
    `FormatError`, naming the line.
    """
    source = Path(source)
    if source.is_dir():
        settings = log.description(source)
        study = Published.of(settings, source)
        records = study.checked(log.recorded(source))
        benchmark = load(task) if task else study.benchmark
        known = {key: value for key, value in settings.items() if key in study.benchmark.options}
        told = {"task": benchmark.name, "data": str(Path(data or settings["data"]).resolve())}
        settings = {**settings, **told, **read_options(benchmark, known | dict(options or {}))}
        given = {str(record["case"]): _of_record(record) for record in finished(records)}
        cases = benchmark.cases(Path(told["data"]), settings)
        return LoadedRun(Published(benchmark), settings, [], {}), cases, given
    if not (task and data):
        raise EagorError(f"{source} is no run; say with --task and --data what it predicts")
    run = bare_run(task, data, options or {})
    cases = load(task).cases(data, run.settings)
    return run, cases, _predicted(source, [case.id for case in cases])


def bare_run(task: str, data: Path, options: Mapping[str, Any]) -> LoadedRun:
    """A run of a benchmark that nobody here plays: no records. Raises `EagorError`."""
    told = {"task": task, "data": str(Path(data).resolve()), "agent": "predictions", "perception": None, "model": None}
    settings = {"kind": KIND, **told, "seed": 0, **read_options(load(task), options)}
    return LoadedRun(Published(load(task)), settings, [], {})


def judged_predictions(
    settings: Mapping[str, Any], cases: Sequence[Case], given: Mapping[str, Mapping[str, Any]]
) -> tuple[list[dict[str, Any]], int]:
    """A record per case that has a prediction, and how many have none. Raises `FormatError`, naming the case."""
    benchmark, records = load(str(settings["task"])), []
    for case in cases:
        if case.id not in given:
            continue
        try:
            body = benchmark.judge(case, given[case.id], settings)
        except FormatError as error:
            raise FormatError(f"the prediction for {case.id}: {error}") from error
        key = f"{settings['task']}/{case.id}"
        records.append({"key": key, "task": settings["task"], "attempt": 1, "status": "ok", "seconds": 0.0, **body})
    return records, len(cases) - len(records)


def keep_predictions(settings: Mapping[str, Any], records: Sequence[Record], folder: Path) -> None:
    """Write `records` as a run, so that it can be reported and compared. Raises `EagorError` if another is there."""
    log.begin(folder, settings)
    there = {record["key"]: record for record in log.read(folder)}
    for record in records:
        # The settings do not name the file that was judged: those of another one are the same.
        if record["key"] in there and not _same(record, there[record["key"]]):
            raise EagorError(f"{folder} holds another result for {record['case']}; choose another folder")
    with log.Log(folder) as file:
        for record in records:
            if record["key"] not in there:
                file.append(record)


def _same(record: Record, kept: Record) -> bool:
    """Whether a result that is kept says what `record` says, whenever and however quickly it came about."""
    found = json.loads(log.as_line(record))
    return all(kept.get(name) == value for name, value in found.items() if name not in ("attempt", "seconds"))


def predictions_of(records: Sequence[Record]) -> str:
    """JSON lines that `read_predictions` reads: what was answered in each finished case."""
    lines = ({"case": record["case"], **_of_record(record)} for record in finished(records))
    return "".join(json.dumps(line, ensure_ascii=False) + "\n" for line in lines)


def _of_record(record: Record) -> dict[str, Any]:
    """The prediction in a record of ours."""
    answer = record.get("answer")
    if isinstance(answer, Mapping):
        return dict(answer)
    return {"text": "" if answer is None else str(answer), **({"answer": answer} if answer is not None else {})}


def _predicted(source: Path, ids: Sequence[str]) -> dict[str, dict[str, Any]]:
    try:
        text = read_file(source).decode("utf-8-sig")
    except FileNotFoundError:
        raise FormatError(f"there is no {source}; wanted a JSON lines file, or the folder of a run") from None
    except (OSError, ValueError) as error:
        raise FormatError(f"{source} cannot be read as text ({error}); wanted a JSON lines file") from None
    known, found = set(ids), {}
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        where = f"{source}, line {number}"
        try:
            given = parsed(line)
        except ValueError as error:
            raise FormatError(f"{where}: no JSON ({error})") from None
        if not isinstance(given, dict):
            raise FormatError(f"{where}: {type(given).__name__}; wanted an object with {', '.join(IDS)} and an answer")
        case = _case(given, ids, known, where)
        if case in found:
            raise FormatError(f"{where}: a second prediction for {case}; wanted one each")
        found[case] = {key: value for key, value in given.items() if key not in IDS}
    return found


def _case(given: Mapping[str, Any], ids: Sequence[str], known: set[str], where: str) -> str:
    for name in IDS:
        value = given.get(name)
        if isinstance(value, str) and value in known:
            return value
        if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < len(ids):
            return ids[value]
    said = {name: given[name] for name in IDS if name in given}
    raise FormatError(
        f"{where}: names no case of this data ({shown(said, 200) if said else 'none of ' + ', '.join(IDS)}); wanted an "
        f"id such as {ids[0]!r}, or a number from 0 to {len(ids) - 1} as doc_id"
    )
