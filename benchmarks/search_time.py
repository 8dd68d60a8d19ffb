"""Where does the time of active search go, and how long do 3,000 episodes take?

    python benchmarks/search_time.py [--episodes 150] [--perception truth|colour|...] [--agent eagor] [--workers 1]
                                     [--data DIR] [--resolution 1080] [--json FILE]

Plays so many episodes of H*Bench's kind as `eagor bench run hstar-hos` does, ledger and worker processes included, and
prints the wall time of an episode and what that makes of 3,000. With one worker every step is taken apart as well:
drawing the view, the perception, the belief, the answer, the choice of the next view, the ledger. Without --data the
episodes are those of built-in apartments (pictures are rendered only for perceptions that look at them).
"""

from __future__ import annotations

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import argparse
import functools
import json
import math
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

from eagor.evaluation import ledger
from eagor.evaluation.benchmarks import BenchmarkRun
from eagor.evaluation.workers import carry_out
from eagor.tasks.hstar import perception, play
from eagor.tasks.hstar.apartments import spot, write_scene
from eagor.tasks.hstar.search import Search
from eagor.tasks.searcher import Searcher

FIRST = 1200  # apartments for development
MANY = 3000
PER_APARTMENT = 12  # episodes, at least
PARTS: dict[str, tuple[tuple[Any, str], ...]] = {
    "reading the picture": ((perception, "open_panorama"),),
    "drawing the view": ((perception, "render_view"),),
    "perception": ((perception.PixelEye, "__call__"), (perception.TruthEye, "look")),
    "belief": ((Search, "seen"),),
    "answer": ((Search, "answer"),),
    "next view": ((Searcher, "face"),),
    "peak, for the record": ((play, "peak_of"),),
    "ledger": ((ledger.Ledger, "append"),),
}


class Clock:
    """Wall time by part; a part that is called inside another counts for itself alone."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._inside: list[float] = []

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            self._inside.append(0.0)
            began = time.perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                took = time.perf_counter() - began
                self.seconds[part] += took - self._inside.pop()
                if self._inside:
                    self._inside[-1] += took

        return call


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=150)
    parser.add_argument("--perception", default="truth")
    parser.add_argument("--agent", default="eagor")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--resolution", type=int, default=1080)
    parser.add_argument("--data", type=Path, help="H*Bench's layout; without it, apartments")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        data = options.data or apartments(Path(temporary), options.episodes, options.perception)
        found = measured(options, data, Path(temporary) / "run")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


def apartments(folder: Path, episodes: int, perception: str) -> Path:
    """Scenes enough for so many episodes; panoramas only where the perception looks at them."""
    rows = 0 if perception.partition(":")[0] == "truth" else 1024
    for seed in range(FIRST, FIRST + math.ceil(episodes / PER_APARTMENT)):
        write_scene(spot(seed), folder / "hos_bench", rows=rows)
    return folder


def measured(options: argparse.Namespace, data: Path, out: Path) -> dict[str, Any]:
    clock = Clock()
    if options.workers == 1:
        for part, places in PARTS.items():
            for owner, name in places:
                setattr(owner, name, clock.timed(part, getattr(owner, name)))
    run = BenchmarkRun(
        "hstar-hos", data, options.agent, options.perception, options={"resolution": options.resolution},
        limit=options.episodes,
    )  # fmt: skip
    began = time.perf_counter()
    settings = run.config()
    outcome = carry_out(run.units(settings), run.benchmark.work, settings, out, options.workers)
    asked = outcome.done + outcome.failed + outcome.skipped
    wall = time.perf_counter() - began
    records = [record for record in ledger.read(out) if record["status"] == "ok"]
    views = sum(record["views"] for record in records)
    each = wall / asked
    minutes = MANY * each / 60
    print(f"{outcome.done} episodes of {asked}, {views} views, {options.workers} workers: {wall:.1f} s with the start")
    print(
        f"{1000 * each:.1f} ms per episode, {1000 * wall / views:.2f} per view; {MANY} episodes: {minutes:.1f} minutes"
    )
    parts = {part: 1000 * seconds / views for part, seconds in clock.seconds.items()}
    if parts:
        parts["everything else"] = 1000 * wall / views - sum(parts.values())
        for part, milliseconds in sorted(parts.items(), key=lambda item: -item[1]):
            print(f"  {part:22s} {milliseconds:7.3f} ms per view")
    return {"episodes": asked, "views": views, "workers": options.workers, "seconds": wall, "minutes": minutes} | {
        "milliseconds_per_view": parts
    }


if __name__ == "__main__":
    sys.exit(main())
