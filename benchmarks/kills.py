"""Runs that are killed at random moments (kill -9) come to what they would have come to: the proof, as often as wanted.

    python benchmarks/kills.py [--kills 20] [--workers 2] [--engine processes] [--task waypoint] [--data DIR]
                               [--who all parent worker] [--episodes 10] [--perception truth:miss=0.5] [--seed 0]

The task is a simulated one, or a benchmark, whose published files --data names; the seed is that of the moments.

A run is made once without a stop. Then the same is run into another folder, killed at a moment drawn evenly from the
time that the first one took, and started again, until it is complete; and so on until there were so many kills. `all`
kills every process of the run, `parent` only the one that was started (its workers have to leave by themselves),
`worker` only one worker (the run itself has to go on). After each kill the log must be readable, with everything
that it held before; at the end the records must be those of the run without a stop, but for the times that things took
and, where a worker was killed, the number of the attempt. Exit code 1 where something else is found. Linux.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import common

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from processes import alive, sessions_of

from eagor.lab.eval import log

PATIENCE = 240.0  # seconds that processes have to leave (agents of Ray take more than one minute)
TIMES = ("seconds", "ms", "milliseconds")
SIMULATED = ("waypoint", "navigation", "tracking")


def begun(options: argparse.Namespace, out: Path) -> subprocess.Popen[bytes]:
    """The run, begun in a session of its own, so that what belongs to it can be found."""
    words = [sys.executable, "-m", "eagor", "bench", "run", options.task, "--perception", options.perception]
    words += ["--workers", str(options.workers), "--engine", options.engine, "--out", str(out), "--json"]
    if options.task in SIMULATED:
        words += ["--episodes", str(options.episodes), "--methods", "eagor", "vmf", "--rows", "32"]
    else:
        words += ["--data", str(options.data), "--limit", str(options.episodes)]
    return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True)


def ended(run: subprocess.Popen[bytes], what: str, patience: float | None = None) -> None:
    """Check that a run ends well."""
    _, said = run.communicate(timeout=patience)
    check(run.returncode == 0, f"{what} ended with {run.returncode}: {said.decode()[-500:]}")


def kill(who: str, run: subprocess.Popen[bytes], sessions: set[int], luck: random.Random) -> bool:
    """Kill; False if there was nobody to be killed any more."""
    victims = [run.pid]
    if who == "worker":
        workers = [one for one, words in alive(sessions).items() if "--multiprocessing-fork" in words]
        victims = [luck.choice(workers)] if workers else []
    elif who == "all":  # the parent first: it would record that others have died
        victims = sorted(alive(sessions), key=lambda one: one != run.pid)
    if not victims or run.poll() is not None:
        return False
    for victim in victims:
        with suppress(ProcessLookupError):
            os.kill(victim, signal.SIGKILL)
    return True


def left_behind(sessions: set[int]) -> dict[int, str]:
    """What is still there of these sessions when everybody had time to leave."""
    end = time.monotonic() + PATIENCE
    while (there := alive(sessions)) and time.monotonic() < end:
        time.sleep(0.05)
    return there


def timeless(value: Any) -> Any:
    """A record without the times that its parts took, however deep they stand."""
    if isinstance(value, dict):
        return {key: timeless(inner) for key, inner in value.items() if key not in TIMES}
    return [timeless(inner) for inner in value] if isinstance(value, list) else value


def records(folder: Path) -> dict[str, dict]:
    """The records by key, without times."""
    return {record["key"]: timeless(record) for record in (log.read(folder) if folder.exists() else ())}


def check(holds: bool, what: str) -> None:
    """Stop with exit code 1 unless it holds."""
    if not holds:
        sys.exit(f"FAILED: {what}")


def same(found: dict[str, dict], wanted: dict[str, dict], who: list[str]) -> None:
    """Check the records of a run that was killed against those of one that was not."""
    if "worker" in who:
        found, wanted = ({k: v | {"attempt": 0} for k, v in each.items()} for each in (found, wanted))
    odd = [key for key in found.keys() | wanted.keys() if found.get(key) != wanted.get(key)]
    check(not odd, f"{len(odd)} of {len(wanted)} records differ, such as {sorted(odd)[:3]}")


def main(options: argparse.Namespace, home: Path) -> None:
    """Run, kill, go on, compare."""
    luck, start, out = random.Random(options.seed), time.monotonic(), home / "killed"
    ended(begun(options, home / "whole"), "the run without a stop")
    long, wanted = time.monotonic() - start, records(home / "whole")
    print(f"{len(wanted)} records in {long:.1f} s without a stop")
    kills = runs = caught = 0
    while kills < options.kills:
        before, who = records(out), options.who[kills % len(options.who)]
        run = begun(options, out)
        time.sleep(luck.uniform(0, long))
        sessions = sessions_of(run.pid)
        hit = kill(who, run, sessions, luck)
        if not hit or who == "worker":
            ended(run, "a run that lost a worker" if hit else "a run that nobody killed", 3 * PATIENCE)
        else:
            run.communicate(timeout=3 * PATIENCE)  # ends when the last process of the run has left
        check(not (there := left_behind(sessions)), f"processes were left behind: {there}")
        after = records(out)
        lost = [(record, after.get(key)) for key, record in before.items() if after.get(key) != record]
        check(not lost, f"records were lost or changed by a kill: {lost}")
        kills, caught = kills + hit, caught + (hit and 0 < len(after) < len(wanted))
        if not hit or who == "worker":
            same(after, wanted, options.who)
            runs += 1
            shutil.rmtree(out)
    ended(begun(options, out), "the last run")
    same(records(out), wanted, options.who)
    print(
        f"{kills} kills ({', '.join(options.who)}), {caught} of them with some but not all records written; {runs + 1} "
        f"runs completed, each with the {len(wanted)} records of the run without a stop; no process left behind"
    )


def parsed() -> argparse.Namespace:
    """The options."""
    known = {"kills": 20, "workers": 2, "task": "waypoint", "data": Path, "episodes": 10, "seed": 0}
    parser = common.parser(__doc__, perception="truth:miss=0.5", **known)
    parser.add_argument("--engine", choices=["processes", "ray"], default="processes")
    parser.add_argument("--who", nargs="+", choices=["all", "parent", "worker"], default=["all"])
    options = parser.parse_args()
    if options.task not in SIMULATED and options.data is None:
        parser.error(f"{options.task} needs --data")
    if "worker" in options.who and options.engine == "ray":
        parser.error("Ray's workers look after themselves; --engine ray takes --who all parent")
    if "worker" in options.who and options.workers < 2:
        parser.error("one worker is the run itself; --who worker wants --workers 2 or more")
    return options


if __name__ == "__main__":
    told = parsed()
    with tempfile.TemporaryDirectory(prefix="eagor-kills-") as place:
        main(told, Path(place))
