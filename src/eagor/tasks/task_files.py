"""Task folders for lmms-eval's ``--include_path``: the task, the functions that it calls, and its documents."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from eagor._files import written

_CALLED = ("doc_to_target", "doc_to_text", "doc_to_visual", "mean", "process_results")


def write_task(
    folder: Path,
    name: str,
    module: str,
    documents: Iterable[Mapping[str, Any]],
    metrics: Sequence[str],
    turns: int | None = None,
) -> list[Path]:
    """Write ``NAME.yaml``, ``NAME_utils.py`` and ``NAME.jsonl`` into `folder`; returns the files.

    `module` has the functions that lmms-eval calls: doc_to_text, doc_to_visual, doc_to_target, process_results, and
    mean, which aggregates each of `metrics`. `documents`: one object per case, with the same keys in all and no nested
    lists. `turns`: most turns of a conversation (an agentic task); None: one question, one answer.
    """
    folder = Path(folder).resolve()
    task, utils, data = (folder / f"{name}{ending}" for ending in (".yaml", "_utils.py", ".jsonl"))
    written(data, "".join(json.dumps(document, ensure_ascii=False) + "\n" for document in documents))
    written(
        utils,
        f'''"""What the task file beside this one calls; all of it is in the package."""

from {module} import {", ".join(_CALLED)}

__all__ = [{", ".join(f'"{function}"' for function in _CALLED)}]
''',
    )
    calls = "".join(f"{key}: !function {utils.stem}.{key}\n" for key in _CALLED if key != "mean")
    measured = "".join(
        f"  - metric: {metric}\n    aggregation: !function {utils.stem}.mean\n    higher_is_better: true\n"
        for metric in metrics
    )
    steps = f"  max_agentic_steps: {turns}\n" if turns else ""
    written(
        task,
        f"""task: {name}
dataset_path: json
dataset_kwargs:
  data_files:
    test: {json.dumps(str(data))}
test_split: test
output_type: {"generate_until_agentic" if turns else "generate_until"}
{calls}generation_kwargs:
  max_new_tokens: 512
  temperature: 0
  do_sample: false
{steps}metric_list:
{measured}metadata:
  - version: 1.0
""",
    )
    return [task, utils, data]
