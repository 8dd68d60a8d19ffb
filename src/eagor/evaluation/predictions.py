"""Predictions that were made elsewhere: read, judged by a benchmark's rules, kept as a run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eagor._files import read_file
from eagor._json import parsed, shown
from eagor.errors import EagorError, FormatError
from eagor.evaluation import ledger
from eagor.evaluation.benchmarks import KIND, Published
from eagor.evaluation.samples import finished
from eagor.evaluation.study import LoadedRun
from eagor.tasks.benchmark import Case, Record, load, read_options

IDS = ("case", "id", "doc_id")  # what names the case in a line: its id, or its number in the benchmark's own order


def read(
    source: Path, task: str | None = None, data: Path | None = None, options: Mapping[str, Any] | None = None
) -> tuple[LoadedRun, list[Case], dict[str, dict[str, Any]]]:
    """What is predicted, its cases, and predictions by case, from a JSON lines file or the folder of a run.

    `task` and `data` are needed where `source` is no run; `options` go over those of the run. Raises `EagorError` or
    `FormatError`, naming the line.
    """
    source = Path(source)
    if source.is_dir():
        settings = ledger.description(source)
        study = Published.of(settings, source)
        records = study.checked(ledger.recorded(source))
        benchmark = load(task) if task else study.benchmark
        known = {key: value for key, value in settings.items() if key in study.benchmark.options}
        told = {"task": benchmark.name, "data": str(Path(data or settings["data"]).resolve())}
        settings = {**settings, **told, **read_options(benchmark, known | dict(options or {}))}
        given = {str(record["case"]): _of_record(record) for record in finished(records)}
        cases = benchmark.cases(Path(told["data"]), settings)
        return LoadedRun(Published(benchmark), settings, [], {}), cases, given
    if not (task and data):
        raise EagorError(f"{source} is no run; say with --task and --data what it predicts")
    run = bare(task, data, options or {})
    cases = load(task).cases(data, run.settings)
    return run, cases, _lines(source, [case.id for case in cases])


def bare(task: str, data: Path, options: Mapping[str, Any]) -> LoadedRun:
    """A run of a benchmark that nobody here plays: no records. Raises `EagorError`."""
    told = {"task": task, "data": str(Path(data).resolve()), "agent": "predictions", "perception": None, "model": None}
    settings = {"kind": KIND, **told, "seed": 0, **read_options(load(task), options)}
    return LoadedRun(Published(load(task)), settings, [], {})


def judged(
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


def keep(settings: Mapping[str, Any], records: Sequence[Record], folder: Path) -> None:
    """Write `records` as a run, so that it can be reported and compared. Raises `EagorError` if another is there."""
    ledger.begin(folder, settings)
    there = {record["key"]: record for record in ledger.read(folder)}
    for record in records:
        # The settings do not name the file that was judged: those of another one are the same.
        if record["key"] in there and not _same(record, there[record["key"]]):
            raise EagorError(f"{folder} holds another result for {record['case']}; choose another folder")
    with ledger.Ledger(folder) as file:
        for record in records:
            if record["key"] not in there:
                file.append(record)


def _same(record: Record, kept: Record) -> bool:
    """Whether a result that is kept says what `record` says, whenever and however quickly it came about."""
    found = json.loads(ledger.as_line(record))
    return all(kept.get(name) == value for name, value in found.items() if name not in ("attempt", "seconds"))


def _of_record(record: Record) -> dict[str, Any]:
    """The prediction in a record of ours."""
    answer = record.get("answer")
    if isinstance(answer, Mapping):
        return dict(answer)
    return {"text": "" if answer is None else str(answer), **({"answer": answer} if answer is not None else {})}


def _lines(source: Path, ids: Sequence[str]) -> dict[str, dict[str, Any]]:
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
        found[case] = _prediction(given)
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


def _prediction(given: Mapping[str, Any]) -> dict[str, Any]:
    """The answer in a line: its own keys, or the last response of one of lmms-eval's samples."""
    replies = given.get("filtered_resps", given.get("resps"))
    if replies is None:
        return {key: value for key, value in given.items() if key not in IDS}
    while isinstance(replies, list) and replies:
        replies = replies[-1]
    text = replies if isinstance(replies, str) else ""
    try:
        held = parsed(text)
    except ValueError:
        held = None
    return held if isinstance(held, dict) else {"text": text}
