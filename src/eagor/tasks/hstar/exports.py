"""H*Bench for other software: task files for lmms-eval, and the published level file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor._files import written
from eagor.errors import EagorError
from eagor.tasks.benchmark import Record
from eagor.tasks.hstar.data import LEVELS, Kind, read_episodes
from eagor.tasks.hstar.rules import MAX_TURNS

if TYPE_CHECKING:
    from eagor.tasks.hstar.bench import HStar

_UTILS = '''"""What the task file beside this one calls; all of it is in the package."""

from eagor.tasks.hstar.lmms import doc_to_target, doc_to_text, doc_to_visual, mean, process_results

__all__ = ["doc_to_target", "doc_to_text", "doc_to_visual", "mean", "process_results"]
'''


def lmms_eval(benchmark: HStar, data: Path, settings: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write ``eagor_hstar_<kind>.yaml``, ``utils.py`` and the episodes into `folder`; returns the files.

    Run them with ``python -m lmms_eval --include_path FOLDER --tasks eagor_hstar_hos --model ...`` where eagor is
    installed. The episodes hold the paths of their panoramas on this machine.
    """
    folder = Path(folder).resolve()
    name = f"eagor_hstar_{benchmark.kind}"
    levels = list(LEVELS[benchmark.kind])
    kept = {key: settings[key] for key in ("turns", "window", "form", "resolution", "scoring") if key in settings}
    episodes = folder / f"{name}.jsonl"
    lines = []
    for episode in read_episodes(data, benchmark.kind):
        # As text: a table of nested lists would have to agree on their types over all rows.
        line = {"id": episode.id, "task": episode.task, "level": episode.level_name, "levels": levels, **kept}
        lines.append(json.dumps(line | {"episode": json.dumps(episode.as_json())}, ensure_ascii=False) + "\n")
    written(episodes, "".join(lines))
    metrics = "".join(
        f"  - metric: {metric}\n    aggregation: !function utils.mean\n    higher_is_better: true\n"
        for metric in ("success", *(f"success_{level}" for level in levels))
    )
    turns = int(settings.get("turns", MAX_TURNS))
    task = folder / f"{name}.yaml"
    written(
        task,
        f"""task: {name}
dataset_path: json
dataset_kwargs:
  data_files:
    test: {json.dumps(str(episodes))}
test_split: test
output_type: generate_until_agentic
doc_to_visual: !function utils.doc_to_visual
doc_to_text: !function utils.doc_to_text
doc_to_target: !function utils.doc_to_target
process_results: !function utils.process_results
generation_kwargs:
  max_new_tokens: 512
  temperature: 0
  do_sample: false
  max_agentic_steps: {turns}
metric_list:
{metrics}metadata:
  - version: 1.0
""",
    )
    utils = folder / "utils.py"
    written(utils, _UTILS)
    return [task, utils, episodes]


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
