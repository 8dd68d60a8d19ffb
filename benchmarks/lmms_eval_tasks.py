"""Are the exported task files read and played by lmms-eval itself?

    python benchmarks/lmms_eval_tasks.py FOLDER [--packages DIR ...]

FOLDER is what `eagor bench export --to lmms-eval` wrote, of one benchmark or of both. Each task is loaded by
lmms-eval's `TaskManager` with `include_path`, its documents are read, and the first is played to its end, by
lmms-eval's own loop where it is a conversation, with a model that always says the same. What the task makes of the
replies is printed.

lmms-eval wants torchvision, which this project does without. Its loader runs without it: `pip install --no-deps
lmms-eval` into a folder, and what its import then misses (datasets, evaluate, loguru, tenacity, pytz, sacrebleu,
pytablewriter, sqlitedict, ...) into another; name both with --packages.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

REPLY = "<answer>rotate(40,0)</answer>"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--packages", type=Path, nargs="*", default=[])
    options = parser.parse_args()
    sys.path += [str(folder) for folder in options.packages]  # behind what is installed: that wins
    from lmms_eval.tasks import TaskManager, get_task_dict  # pyright: ignore[reportMissingImports]

    manager = TaskManager(include_path=str(options.folder), include_defaults=False)
    names = sorted(path.stem for path in options.folder.glob("eagor_*.yaml"))
    missing = set(names) - set(manager.all_tasks)
    if missing or not names:
        print(f"not found by lmms-eval: {', '.join(sorted(missing)) or 'any task'}")
        return 1
    for name, task in get_task_dict(names, manager, "simple").items():
        print(f"{name}: {len(task.test_docs())} documents, {task.config.output_type}")
        print(f"  {play(task, name)}")
    return 0


def play(task: Any, name: str) -> dict[str, Any]:
    """The scores of the first document, by lmms-eval's own loop where the task is a conversation."""
    from lmms_eval.api.instance import Instance  # pyright: ignore[reportMissingImports]
    from lmms_eval.evaluator import _run_generate_until_agentic  # pyright: ignore[reportMissingImports]

    doc, split, config = task.test_docs()[0], task.config.test_split, task.config
    model = Scripted({name: {split: task.test_docs()}})
    about = {"task": name, "doc_id": 0, "repeats": 1}
    kind, told = config.output_type, dict(config.generation_kwargs)
    if kind == "generate_until_agentic":
        arguments = (task.doc_to_text(doc), told, task.doc_to_visual, config.doc_to_text, 0, name, split)
        (reply,) = _run_generate_until_agentic(model, [Instance(kind, arguments, 0, about)])
    else:
        arguments = (task.doc_to_text(doc), told, task.doc_to_visual, 0, name, split)
        (reply,) = model.generate_until([Instance(kind, arguments, 0, about)])
    aggregate = task.aggregation()
    scores = {key: aggregate[key]([score]) for key, score in task.process_results(doc, [reply]).items()}
    return {"asked": model.asked, "pictures": model.pictures, **scores}


class Scripted:
    """A model of lmms-eval's simple kind that always says the same."""

    is_simple = True

    def __init__(self, task_dict: dict[str, Any]) -> None:
        self.task_dict, self.asked, self.pictures = task_dict, 0, 0

    def generate_until(self, requests: list[Any]) -> list[str]:
        for request in requests:
            text, _, visual, doc, name, split = request.args
            assert isinstance(text, str)
            self.asked += 1
            self.pictures += len(visual(self.task_dict[name][split][doc]))
        return [REPLY] * len(requests)


if __name__ == "__main__":
    sys.exit(main())
