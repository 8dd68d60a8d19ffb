"""Predictions as JSON lines: those of a run, and those that were made elsewhere, scored by the task's rules."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eagor._checks import parsed, shown
from eagor._files import read_file
from eagor.errors import EagorError, FormatError
from eagor.lab.eval import log
from eagor.lab.eval.results import Run, read
from eagor.lab.tasks.task import Record, finished, load, read_config, settings_of

IDS = ("case", "id", "doc_id")  # what names the sample in a line: its id, or its number in the task's own order


def score_predictions(
    source: Path, task: str | None, data: Path | None, changes: Mapping[str, str]
) -> tuple[Run, int, int]:
    """The run of scored predictions, how many samples there are, and how many have none.

    `source`: a JSON lines file, for which `task` and `data` are needed, or the folder of a run. `changes` go over the
    settings of the run. Raises `EagorError` or `FormatError`, naming the line or the sample.
    """
    source = Path(source)
    settings: Mapping[str, Any] = {"agent": "predictions"}
    records: Sequence[Record] = ()
    if source.is_dir():
        run = read(source)
        settings, records, task = run.settings, run.records, task or run.task.name
    if task is None or (data is None and not source.is_dir()):
        raise EagorError(f"{source} is no run; say with --task and --data what it predicts")
    made_for = load(task)
    if not hasattr(made_for, "score"):
        raise EagorError(f"{task} is a simulated task, whose answers depend on what was seen: it scores no predictions")
    values = {**settings, "task": task, **({"data": str(data)} if data is not None else {})}
    fields = made_for.Config.__struct_fields__
    config = read_config(made_for, {key: value for key, value in values.items() if key in fields}, changes)
    samples = made_for.samples(config)
    if source.is_dir():
        given = {str(record["case"]): _of_record(record) for record in finished(records)}
    else:
        given = _predicted(source, [sample.id for sample in samples])
    scored = []
    for sample in samples:
        if sample.id not in given:
            continue
        try:
            body = made_for.score(sample, given[sample.id], config)  # type: ignore[attr-defined]
        except FormatError as error:
            raise FormatError(f"the prediction for {sample.id}: {error}") from error
        head = {"key": f"{task}/{sample.id}", "task": task, "attempt": 1, "status": "ok", "seconds": 0.0}
        scored.append(head | dict(body))
    if not scored:
        raise EagorError(f"{source} has no prediction for any of the {len(samples)} cases")
    return Run(made_for, settings_of(config), scored), len(samples), len(samples) - len(scored)


def keep(run: Run, folder: Path) -> None:
    """Write the records of a run of predictions. Raises `EagorError` if the folder has others for the same samples."""
    log.begin(folder, run.settings)
    there = {record["key"]: record for record in log.read(folder)}
    new = [record for record in run.records if record["key"] not in there]
    for record in run.records:
        if (before := there.get(record["key"])) is None:
            continue
        plain: dict[str, Any] = json.loads(log.as_line(record))
        # The settings do not name the file that was scored: those of another one are the same.
        if any(before.get(name) != value for name, value in plain.items() if name not in ("attempt", "seconds")):
            raise EagorError(f"{folder} holds another result for {record['case']}; choose another folder")
    with log.Log(folder) as file:
        for record in new:
            file.append(record)


def predictions_of(records: Sequence[Record]) -> str:
    """JSON lines that `score_predictions` reads: what was answered in each finished sample."""
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
        name = _sample(given, ids, known, where)
        if name in found:
            raise FormatError(f"{where}: a second prediction for {name}; wanted one each")
        found[name] = {key: value for key, value in given.items() if key not in IDS}
    return found


def _sample(given: Mapping[str, Any], ids: Sequence[str], known: set[str], where: str) -> str:
    for key in IDS:
        value = given.get(key)
        if isinstance(value, str) and value in known:
            return value
        if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < len(ids):
            return ids[value]
    named = {key: given[key] for key in IDS if key in given}
    raise FormatError(
        f"{where}: names no case of this data ({shown(named, 200) if named else 'none of ' + ', '.join(IDS)}); wanted "
        f"an id such as {ids[0]!r}, or a number from 0 to {len(ids) - 1} as doc_id"
    )
