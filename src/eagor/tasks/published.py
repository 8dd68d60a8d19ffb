"""What the benchmarks with published data have in common, H*Bench and OSR-Bench.

Their skeleton; seeds, pictures and recalibration of their cases; and task folders for lmms-eval's ``--include_path``.
"""

from __future__ import annotations

import json
import warnings
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, ClassVar, cast

import numpy as np

from eagor._checks import whole
from eagor._files import written
from eagor._version import __version__
from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.sphere import world_R_body
from eagor.tasks.benchmark import TALKING, Benchmark, Option, Record, read_options
from eagor.tasks.models import recalibration, shared_chat
from eagor.tasks.places import Place

_CALLED = ("doc_to_target", "doc_to_text", "doc_to_visual", "mean", "process_results")


@dataclass(frozen=True)
class Export:
    """What a run, or the data, is written as: in words, and the function (records, settings, folder) that does it."""

    what: str
    write: Callable[[Sequence[Record], Mapping[str, Any], Path], list[Path]]


class PublishedBenchmark:
    """The parts of an `eagor.tasks.benchmark.Benchmark` that do not depend on its data.

    A benchmark adds `name`, `title`, `work`, `figures`, `info`, `cases` and `judge`, and says

    - `agents`, `options`: as there; `looking`: the agents that need a perception; `truth`: what the perception truth is
      in this benchmark, in words;
    - `writers`: its exports.
    """

    name: Any
    agents: ClassVar[Mapping[str, str]]
    options: ClassVar[Mapping[str, Option]]
    looking: ClassVar[Sequence[str]]
    truth: ClassVar[str]

    @property
    def writers(self) -> Mapping[str, Export]:
        raise NotImplementedError

    def check(self, settings: Mapping[str, Any]) -> None:
        """Raise `EagorError` for settings that this benchmark cannot run with; makes the perception, if any."""
        raise NotImplementedError

    @property
    def exports(self) -> Mapping[str, str]:
        return {to: export.what for to, export in self.writers.items()}

    def settle(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        agent = settings.get("agent") or next(iter(self.agents))
        if agent not in self.agents:
            raise EagorError(f"{self.name} has no agent {agent!r}; it has {', '.join(self.agents)}")
        perception, model = settings.get("perception"), settings.get("model")
        if agent in self.looking and not perception:
            raise EagorError(
                f"the agent {agent} needs a perception: name one with --perception, such as a model (folder or hub "
                f"name), endpoint:MODEL@ADDRESS, or truth ({self.truth})"
            )
        if agent == TALKING and not model:
            raise EagorError(
                f"the agent {agent} asks a model; name it with --model, such as MODEL@http://localhost:8000/v1, a "
                "folder or hub name, or package.module:function"
            )
        seed = settings.get("seed") or 0
        if not whole(seed, 0):
            raise EagorError(f"seed = {seed!r}; wanted a whole number, 0 or more")
        found = {
            "task": self.name,
            "data": str(settings["data"]),
            "agent": agent,
            "perception": perception if agent in self.looking else None,
            "model": model if agent == TALKING else None,
            "seed": int(seed),
            **read_options(cast(Benchmark, self), {name: settings.get(name) for name in self.options}),
            **({"calibrated": settings["calibrated"]} if settings.get("calibrated") and agent in self.looking else {}),
            "versions": {"eagor": __version__},
        }
        self.check(found)
        if found["model"]:
            shared_chat(found["model"])
        return found

    def export(self, to: str, records: Sequence[Record], settings: Mapping[str, Any], folder: Path) -> list[Path]:
        if to not in self.writers:
            raise EagorError(f"{self.name} has no export {to!r}; it has {', '.join(self.writers)}")
        return self.writers[to].write(records, settings, folder)


def finished(records: Iterable[Record], wanted: str) -> list[Record]:
    """The records of finished cases. Raises `EagorError` with what is `wanted` if there are none."""
    done = [record for record in records if record.get("status", "ok") == "ok"]
    if not done:
        raise EagorError(f"{wanted}; name a run with results")
    return done


def recalibrator(settings: Mapping[str, Any]) -> Callable[[Evidence], Evidence]:
    """The recalibration of looks in a run: from its settings, otherwise none."""
    calibrated = recalibration(settings)
    return calibrated.reread if calibrated is not None else lambda evidence: evidence


def case_seed(seed: int, case: str) -> list[int]:
    """The seed of one case; independent of all other cases."""
    return [seed, zlib.crc32(case.encode())]


def picture_size(file: Path | IO[bytes], upright: bool = False) -> tuple[int, int] | None:
    """Width and height of a picture, None if it cannot be read; `upright`: after its orientation tag was followed."""
    from PIL import Image

    from eagor.media.panorama import FORMATS, ORIENTATION

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with Image.open(file, formats=FORMATS) as picture:
                turned = upright and picture.getexif().get(ORIENTATION, 1) >= 5  # by a quarter
                width, height = picture.size
                return (height, width) if turned else (width, height)
        except Exception:  # decoders may raise anything for damaged files
            return None


def save_panorama(place: Place, position: np.ndarray, yaw: float, rows: int, path: Path) -> None:
    """Save what a camera at `position` ``(3,)`` sees of a place, as a panorama of `rows` rows."""
    from PIL import Image

    rgb = place.renderer.panorama(position, world_R_body(yaw), rows, range=False, ids=False).rgb
    assert rgb is not None
    Image.fromarray(rgb).save(path)


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
