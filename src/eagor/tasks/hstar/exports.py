"""H*Bench for other software: task files for lmms-eval, and the published level file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eagor._files import written
from eagor.errors import EagorError
from eagor.tasks.benchmark import Record
from eagor.tasks.hstar.data import LEVELS, Kind, read_episodes
from eagor.tasks.hstar.rules import MAX_TURNS
from eagor.tasks.task_files import write_task


def lmms_eval(kind: Kind, data: Path, settings: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the task ``eagor_hstar_<kind>`` into `folder` (`eagor.tasks.task_files`); returns the files.

    The episodes hold the paths of their panoramas on this machine.
    """
    levels = list(LEVELS[kind])
    kept = {key: settings[key] for key in ("turns", "window", "form", "resolution", "scoring") if key in settings}
    documents = (
        # The episode as text: a table of nested lists would have to agree on their types over all rows.
        {"id": episode.id, "task": episode.task, "level": episode.level_name, "levels": levels, **kept}
        | {"episode": json.dumps(episode.as_json())}
        for episode in read_episodes(data, kind)
    )
    metrics = ["success", *(f"success_{level}" for level in levels)]
    turns = int(settings.get("turns", MAX_TURNS))
    return write_task(folder, f"eagor_hstar_{kind}", "eagor.tasks.hstar.lmms", documents, metrics, turns)


def level_file(kind: Kind, records: Sequence[Record], folder: Path) -> list[Path]:
    """Write ``hstar_<kind>.txt``: per level its number, successes and episodes; then successes by step, 0 to 10.

    The published evaluation writes these numbers; a success is counted at the turn of its submission. Raises
    `EagorError` without records.
    """
    done = [record for record in records if record.get("status") == "ok"]
    if not done:
        raise EagorError("the level file counts a run's successes; name a run with results")
    lines = []
    for number, level in enumerate(LEVELS[kind]):
        part = [record for record in done if record.get("level") == level]
        if part:
            lines.append(f"{number} {sum(record['score'] == 1 for record in part)} {len(part)}")
    steps = [0] * (MAX_TURNS + 1)
    for record in done:
        if record["score"] == 1:
            steps[min(int(record.get("views", 1)), MAX_TURNS)] += 1
    text = "\n".join([*lines, f"step_success {' '.join(map(str, steps))}", ""])
    return [written(Path(folder) / f"hstar_{kind}.txt", text)]
