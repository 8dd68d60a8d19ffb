"""Predictions as JSON lines: those of a run, and those that were made elsewhere, scored by the task's rules."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eagor._checks import shown
from eagor.errors import EagorError, FormatError
from eagor.lab.eval import log
from eagor.lab.eval.results import Run, read
from eagor.lab.tasks.task import Record, finished, load, read_config, settings_of
from eagor.perception.json_files import object_of, parsed_lines

IDS = ("case", "id", "doc_id")  # what names the sample in a line: its id, or its number in the task's own order


def score_predictions(
    source: Path, task: str | None, data: Path | None, changes: Mapping[str, str]
) -> tuple[Run, int, int]:
    """The run of scored predictions, how many samples there are, and how many have none.

    `source`: a JSON lines file, for which `task` and `data` are needed, or the folder of a run. `changes` go over the
    settings of the run. Raises `EagorError` or `FormatError`, naming the line or the sample.
    """
    source = Path(source)
    run = read(source) if source.is_dir() else None
    if run is None and (task is None or data is None):
        raise EagorError(f"{source} is no run; say with --task and --data what it predicts")
    scorer = load(task or (run.task.name if run else ""))
    if not hasattr(scorer, "score"):
        raise EagorError(
            f"{scorer.name} is a simulated task, whose answers depend on what was seen: it scores no predictions"
        )
    values = {**(run.settings if run else {"agent": "predictions"}), **({} if data is None else {"data": str(data)})}
    fields = [name for name in scorer.Config.__struct_fields__ if name != "task"]
    config = read_config(scorer, {name: values[name] for name in fields if name in values}, changes)
    samples, records = scorer.samples(config), []
    given = answers_of(run.records) if run else predicted(source, [each.id for each in samples])
    for sample in samples:
        if sample.id in given:
            try:
                body = scorer.score(sample, given[sample.id], config)
            except FormatError as error:
                raise FormatError(f"the prediction for {sample.id}: {error}") from error
            key = f"{scorer.name}/{sample.id}"
            records.append({"key": key, "task": scorer.name, "attempt": 1, "status": "ok", "seconds": 0.0, **body})
    if not records:
        raise EagorError(f"{source} has no prediction for any of the {len(samples)} cases")
    return Run(scorer, settings_of(config), records), len(samples), len(samples) - len(records)


def keep(run: Run, folder: Path) -> None:
    """Write the records of a run of predictions. Raises `EagorError` if the folder has others for the same samples."""
    with log.Log(folder) as book:
        book.begin(run.settings)
        there = {record["key"]: record for record in log.read(folder)}
        new = {record["key"]: json.loads(log.as_line(record)) for record in run.records}
        for key in new.keys() & there.keys():
            # The settings do not name the file that was scored: those of another one are the same.
            if there[key] | {"attempt": 1, "seconds": 0.0} != new[key]:
                raise EagorError(f"{folder} holds another result for {new[key]['case']}; choose another folder")
        for record in run.records:
            if record["key"] not in there:
                book.append(record)


def answers_of(records: Sequence[Record]) -> dict[str, dict[str, Any]]:
    """The predictions, as `score_predictions` reads them, in records of ours: what was answered in each sample."""
    found = {}
    for record in finished(records):
        answer = record.get("answer")
        text = {"text": "" if answer is None else str(answer)} | ({} if answer is None else {"answer": answer})
        found[record["case"]] = dict(answer) if isinstance(answer, Mapping) else text
    return found


def predicted(source: Path, ids: Sequence[str]) -> dict[str, dict[str, Any]]:
    """The predictions in a file by the samples' `ids`. Raises `FormatError`, which names the line."""
    known: dict[Any, str] = {**dict(enumerate(ids)), **{each: each for each in ids}}
    found: dict[str, dict[str, Any]] = {}
    for given, where in parsed_lines(source, object_of):
        named = {key: given[key] for key in IDS if key in given}
        name = next((known[each] for each in named.values() if type(each) in (int, str) and each in known), None)
        if name is None:
            raise FormatError(
                f"{where}: names no case of this data ({shown(named, 200) if named else 'none of ' + ', '.join(IDS)}); "
                f"wanted an id such as {ids[0]!r}, or a number from 0 to {len(ids) - 1} as doc_id"
            )
        if name in found:
            raise FormatError(f"{where}: a second prediction for {name}; wanted one each")
        found[name] = {key: value for key, value in given.items() if key not in IDS}
    return found
