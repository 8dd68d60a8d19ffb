"""Predictions that were made elsewhere: read, judged by a benchmark's rules, kept as a run; and samples written out."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eagor._files import written
from eagor._json import parsed, shown
from eagor.errors import EagorError, FormatError
from eagor.evaluation import ledger
from eagor.evaluation.benchmarks import KIND, BenchmarkRun, read_run
from eagor.evaluation.samples import finished
from eagor.tasks.benchmark import Case, Record, load, read_options

SAMPLES = "samples.jsonl"
IDS = ("case", "id", "doc_id")  # what names the case in a line: its id, or its number in the benchmark's own order


def read(
    source: Path, task: str | None = None, data: Path | None = None, options: Mapping[str, Any] | None = None
) -> tuple[dict[str, Any], list[Case], dict[str, dict[str, Any]]]:
    """Settings, cases, and predictions by case, from a JSON lines file or the folder of a run.

    `task` and `data` are needed where `source` is no run; `options` go over those of the run. Raises `EagorError` or
    `FormatError`, naming the line.
    """
    source = Path(source)
    if source.is_dir():
        settings, records = read_run(source)
        options = {k: v for k, v in settings.items() if k in load(str(settings["task"])).options} | dict(options or {})
        task, data = task or str(settings["task"]), Path(data or str(settings["data"])).resolve()
        merged = {**settings, "task": task, "data": str(data), **read_options(load(task), options)}
        cases = load(task).cases(data, merged)
        return merged, cases, {str(record["case"]): _of_record(record) for record in finished(records)}
    if not (task and data):
        raise EagorError(f"{source} is no run; say with --task and --data what it predicts")
    settings = bare_settings(task, data, options or {})
    cases = load(task).cases(data, settings)
    return settings, cases, _lines(source, [case.id for case in cases])


def bare_settings(task: str, data: Path, options: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of something that nobody here plays. Raises `EagorError`."""
    told = {"task": task, "data": str(Path(data).resolve()), "agent": "predictions", "perception": None, "model": None}
    return {"kind": KIND, **told, "seed": 0, **read_options(load(task), options)}


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


def samples(settings: Mapping[str, Any], records: Sequence[Record], folder: Path) -> Path:
    """Write one line per case with lmms-eval's keys, and ours beside them; returns the file.

    doc_id is the case's number in the benchmark's own order; resps and filtered_resps hold the answer as text, empty
    where there is none.
    """
    run = BenchmarkRun(str(settings["task"]), Path(str(settings["data"])))
    cases = run.benchmark.cases(run.data, settings)
    by_case = {str(record["case"]): record for record in finished(records)}
    lines = []
    for number, case in enumerate(cases):
        record = by_case.get(case.id)
        if records and record is None:
            continue
        text = "" if record is None or record.get("answer") is None else _text(record["answer"])
        content = json.dumps(case.payload, sort_keys=True)
        line = {
            "doc_id": number,
            "doc_hash": hashlib.sha256(content.encode()).hexdigest(),
            "input": None if record is None else record.get("words", record.get("question")),
            "target": None if record is None else record.get("target", record.get("truth")),
            "resps": [[text]],
            "filtered_resps": [text],
            "case": case.id,
            "cluster": case.cluster,
        }
        if record is not None:
            left_out = ("key", "attempt", "status", "seconds", "case", "cluster")
            line |= {key: value for key, value in record.items() if key not in left_out and key not in line}
        lines.append(json.dumps(line, ensure_ascii=False) + "\n")
    return written(folder / SAMPLES, "".join(lines))


def _of_record(record: Record) -> dict[str, Any]:
    """The prediction in a record of ours."""
    answer = record.get("answer")
    if isinstance(answer, Mapping):
        return dict(answer)
    return {"text": "" if answer is None else str(answer), **({"answer": answer} if answer is not None else {})}


def _lines(source: Path, ids: Sequence[str]) -> dict[str, dict[str, Any]]:
    try:
        text = source.read_bytes().decode("utf-8-sig")
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


def _text(answer: Any) -> str:
    return answer if isinstance(answer, str) else json.dumps(answer, ensure_ascii=False)
