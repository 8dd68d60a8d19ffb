"""Attacks on what this package promises (docs/promises.md), longer than the tests of tests/robustness.

    python benchmarks/attack.py [--only records claims signals] [--repeat 10]

Each attack prints OK and what was tried, or what was lost; exit code 1 if anything was. Linux.
"""

from __future__ import annotations

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import argparse
import copy
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import types
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from functools import lru_cache
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # small data sets are made there

from kills import left_behind
from processes import sessions_of

from eagor.cli import main as command
from eagor.evaluation import ledger

Attack = Callable[[Path, int], Iterator[str]]
EAGOR = (sys.executable, "-m", "eagor")
BAD = (None, "x", "", [], {}, [None], {"a": 1}, -1, 1e308, True, "\ud800", [[]], 10**30)
PATIENCE = 5.0  # seconds that everybody has to leave after SIGTERM or SIGINT


def records(home: Path, repeat: int) -> Iterator[str]:
    """Every part of a record is taken away or made something else: reports work, or name the record."""
    tried: Counter[str] = Counter()
    luck = random.Random(repeat)
    for run in _runs(home):
        whole = ledger.read(run)
        crafted = [(place, value) for place in _places(whole[0]) for value in (_GONE, *BAD)]
        for place, value in luck.sample(crafted, min(len(crafted), 40 * repeat)):
            bad = copy.deepcopy(whole)
            _put(bad[0], place, value)
            said = _crash(run, bad)
            tried[run.name] += 1
            if said is not None:
                yield f"{run.name}, {'.'.join(map(str, place))} = {value!r:.40}: {said}"
    print(f"  {sum(tried.values())} records: {dict(tried)}")


def claims(home: Path, repeat: int) -> Iterator[str]:
    """Two runs with different settings start together on one folder: one goes on."""
    for turn in range(repeat):
        out = home / f"claim-{turn}"
        words = ("bench", "run", "waypoint", "--perception", "truth", "--methods", "vmf", "--rows", "32")
        both = [_begun(*words, "--episodes", "1", "--seed", str(seed), "--out", str(out)) for seed in (2000, 2001)]
        codes = sorted((run.communicate(), run.returncode)[1] for run in both)
        if codes != [0, 2]:
            yield f"turn {turn}: exit codes {codes}; wanted one 0 and one 2"
    print(f"  {repeat} pairs")


def signals(home: Path, repeat: int) -> Iterator[str]:
    """SIGTERM and Ctrl-C, to the process or to all of its session, under every engine."""
    slowest = 0.0
    for turn in range(repeat):
        for engine in ("processes", "ray"):
            for number, code, said in ((signal.SIGTERM, 143, "terminated"), (signal.SIGINT, 130, "interrupted")):
                for whom in (os.kill, os.killpg):
                    what = f"{engine}, {number.name}, {whom.__name__}"
                    out = home / f"{turn} {what}"
                    run = _begun(
                        "bench", "run", "waypoint", "--perception", "truth", "--methods", "vmf", "eagor", "--rows",
                        "32", "--episodes", "500", "--workers", "2", "--engine", engine, "--out", str(out),
                    )  # fmt: skip
                    while run.poll() is None and len(_kept(out)) < 2:
                        time.sleep(0.05)
                    before, sessions, start = _kept(out), sessions_of(run.pid), time.monotonic()
                    whom(run.pid, number)
                    _, error = run.communicate()
                    if left := left_behind(sessions):
                        yield f"{what}: left behind {left}"
                    took = time.monotonic() - start
                    slowest = max(slowest, took)
                    if took > PATIENCE:
                        yield f"{what}: gone after {took:.1f} s; wanted {PATIENCE:g}"
                    if run.returncode != code or said not in error or "Traceback" in error:
                        yield f"{what}: exit code {run.returncode}, said {error[-300:]!r}"
                    if any(record not in _kept(out) for record in before):
                        yield f"{what}: records were lost"
    print(f"  {8 * repeat} ends; everybody gone after {slowest:.1f} s at most")


ATTACKS: dict[str, Attack] = {each.__name__: each for each in (records, claims, signals)}
_GONE = object()


def _begun(*words: str) -> subprocess.Popen[str]:
    def heed() -> None:  # a shell in the background ignores interrupts, and its children would too
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    pipe = subprocess.PIPE
    return subprocess.Popen(
        [*EAGOR, *words], stdout=pipe, stderr=pipe, text=True, start_new_session=True, preexec_fn=heed
    )


def _kept(folder: Path) -> list[dict[str, Any]]:
    return ledger.read(folder) if folder.exists() else []


def _runs(home: Path) -> Iterator[Path]:
    """A small run of every task and benchmark."""
    import hstar_data  # pyright: ignore[reportMissingImports]
    import osr_data  # pyright: ignore[reportMissingImports]

    for task in ("waypoint", "navigation", "tracking"):
        out = home / task
        _quiet(
            "bench", "run", task, "--perception", "truth", "--methods", "vmf", "eagor", "--rows", "32",
            "--episodes", "2", "--out", str(out),
        )  # fmt: skip
        yield out
    hstar, osr = hstar_data.write(home / "hstar"), osr_data.write(home / "osr")
    for task, data in (("hstar-hos", hstar), ("osr", osr)):
        out = home / task
        _quiet("bench", "run", task, "--data", str(data), "--perception", "truth", "--limit", "6", "--out", str(out))
        yield out


def _quiet(*words: str) -> str:
    """Run the command here; what it said on stderr. Raises whatever a bug raises."""
    said = StringIO()
    with redirect_stdout(StringIO()), redirect_stderr(said):
        command([*words, "--debug"])
    return said.getvalue()


def _crash(run: Path, bad: list[dict[str, Any]]) -> str | None:
    """What is wrong with how a run with these records is reported; None if nothing is."""
    for path in ledger.files(run):
        path.write_text("")
    lines = "".join(json.dumps(record) + "\n" for record in bad)
    (run / "worker-0.jsonl").write_text(lines)
    commands = [("report", str(run))]
    if run.name in ("hstar-hos", "osr"):
        commands += [("compare", str(run), str(run)), ("failures", str(run)), ("export", str(run))]
        commands += [("export", str(run), "--to", "osr-csv" if run.name == "osr" else "hstar-txt")]
    for words in commands:
        said = _quiet("bench", *words)
        if "(a bug;" in said:
            return f"{words[0]}: {said.strip().splitlines()[-1][:200]}"
        key = str(bad[0].get("key"))[:40]
        if "error:" in said and key not in said and "line 1" not in said:
            return f"{words[0]} does not name the record: {said.strip().splitlines()[-1][:200]}"
    return None


def _places(value: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where the parts of a record are; of lists the first two entries."""
    parts = value.items() if isinstance(value, dict) else enumerate(value[:2]) if isinstance(value, list) else ()
    for key, inner in parts:
        yield (*place, key)
        yield from _places(inner, (*place, key))


def _put(record: Any, place: tuple[Any, ...], value: Any) -> None:
    for key in place[:-1]:
        record = record[key]
    if value is _GONE:
        del record[place[-1]]
    else:
        record[place[-1]] = value


@lru_cache
def _place(world: str, seed: int, radius: float) -> Any:
    """A world whose pictures cost nothing: what is attacked is how records are read."""
    from eagor.tasks import places

    found = places.load_place(world, seed, radius)
    black = types.SimpleNamespace(rgb=np.zeros((270, 540, 3), np.uint8), range=np.ones((270, 540)), ids=None)
    renderer = types.SimpleNamespace(panorama=lambda *_, **__: black)
    return types.SimpleNamespace(scene=found.scene, ground=found.ground, renderer=renderer)


def main(options: argparse.Namespace) -> int:
    """Run the attacks; the exit code."""
    from eagor.evaluation import studies

    really = studies.write_report
    studies.write_report = lambda folder: really(folder, _place)
    lost = 0
    for name in options.only or ATTACKS:
        print(f"{name}: {ATTACKS[name].__doc__}", flush=True)
        with tempfile.TemporaryDirectory(prefix="eagor-attack-") as home, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = 0
            try:
                for line in ATTACKS[name](Path(home), options.repeat):
                    found += 1
                    print(f"  LOST {line}", flush=True)
            except Exception:
                traceback.print_exc(file=sys.stdout)
                found += 1
        print(f"  {found} lost" if found else "  OK", flush=True)
        lost += found
    return 1 if lost else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=ATTACKS, help="these attacks")
    parser.add_argument("--repeat", type=int, default=3, help="of what depends on luck")
    sys.exit(main(parser.parse_args()))
