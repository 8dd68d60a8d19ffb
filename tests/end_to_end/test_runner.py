"""Runs that are killed, torn, starved of disk, or poisoned keep what they had, and go on."""

import json
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from functools import partial

import numpy as np
import pytest
from processes import alive, sessions_of, wait_for

from eagor.errors import EagorError, FormatError, StorageError, WorkError
from eagor.lab.eval import log
from eagor.lab.eval.log import RECORDS, RUN, Log, description, read
from eagor.lab.eval.runner import Outcome, Queue, run
from eagor.lab.tasks.task import Sample

WORK = "units_of_work:squares"


def record(key, attempt=1, status="ok", **more):
    return {"key": key, "attempt": attempt, "status": status, **more}


def units(count, trouble=None, groups=3):
    return [Sample(str(n), f"house {n % groups}", (n, (trouble or {}).get(n))) for n in range(count)]


@pytest.fixture
def config(tmp_path):
    notes = tmp_path / "notes"
    notes.mkdir()
    return {"task": "square", "notes": str(notes)}


def results(folder):
    return {r["key"]: r["methods"] for r in read(folder) if r["status"] == "ok"}


# The log


def test_what_is_appended_is_read_and_no_failure_hides_a_result(tmp_path):
    with Log(tmp_path) as book:
        book.append(record("b", x=np.float32(0.5), n=np.int64(3), flags=np.array([True, False]), none=None))
        for kept in (record("a", 2, words="größer 30°", trace=[(1.5, 2), [3]]), record("a", 3, "failed")):
            book.append(kept)
        for kept in (record("c", x=1), record("c", x=2)):
            book.append(kept)
        with pytest.raises(EagorError, match="another process is writing"):
            Log(tmp_path)
    assert read(tmp_path) == [
        record("a", 2, words="größer 30°", trace=[[1.5, 2], [3]]),
        record("b", x=0.5, n=3, flags=[True, False], none=None),
        record("c", x=2),
    ]


def test_a_torn_last_line_is_left_out_and_the_next_record_begins_a_line(tmp_path):
    with Log(tmp_path) as book:
        for key in "abc":
            book.append(record(key, filler="é" * 50_000))
    path = tmp_path / RECORDS
    whole = path.read_bytes()
    for cut in (1, 7, 60_003):  # the newline alone, a bracket, the middle of a letter of two bytes
        path.write_bytes(whole[:-cut])
        kept = ["a", "b", "c"] if cut == 1 else ["a", "b"]
        assert [r["key"] for r in read(tmp_path)] == kept
        with Log(tmp_path) as book:
            book.append(record("d"))
        assert [r["key"] for r in read(tmp_path)] == [*kept, "d"]


@pytest.mark.parametrize("line", ['{"key": "b", "att', "", "[1]", '{"key":"b","attempt":1,"status":"?"}'])
def test_any_other_broken_line_is_an_error_that_names_it(tmp_path, line):
    good = json.dumps(record("a"))
    (tmp_path / RECORDS).write_text(f"{good}\n{line}\n{good}\n")
    with pytest.raises(FormatError, match=r"records\.jsonl, line 2"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("value", "said"), [(float("nan"), "nan"), (np.array([1.0, np.inf]), "inf"), ({3}, "set"), ({1: 2}, "key 1")]
)
def test_what_json_cannot_hold_is_refused_by_name_and_nothing_is_written(tmp_path, value, said):
    with Log(tmp_path) as book:
        with pytest.raises(EagorError, match=f"(?s)b: metrics: mae.*{said}"):
            book.append(record("b", metrics={"mae": value}))
        book.append(record("c"))
    assert [r["key"] for r in read(tmp_path)] == ["c"]


def test_run_json_is_held_against_later_runs_but_for_what_is_information(tmp_path, config, monkeypatch):
    folder = tmp_path / "run"
    run(units(2), WORK, config, folder)
    first = description(folder)
    assert first == {**config, "commit": first["commit"], "samples": first["samples"]}
    assert (first["samples"]["count"], len(first["samples"]["digest"])) == (2, 16)
    monkeypatch.setattr(log, "commit", lambda: "another")
    assert run(units(5), WORK, config, folder) == Outcome(3, 0, 2)
    assert description(folder) == first
    other = {"task": "search", "seed": 4, "rules": {"step": 0.5}, "rows": 3}
    with pytest.raises(EagorError) as refused:
        run(units(2), WORK, other, folder)
    one, two, three = refused.value.lines
    assert one.endswith("run holds another run, of square")
    assert two.startswith("it differs in task, notes, seed, rules and 1 more")
    assert "another folder" in three
    with Log(tmp_path / "grown") as book:
        for episodes in (3, 5, 4):
            book.begin({"task": "x", "episodes": episodes, "development": episodes > 3})
    grown = description(tmp_path / "grown")
    assert (grown["episodes"], grown["development"]) == (5, True)


@pytest.mark.parametrize("kind", ["link", "dangling", "pipe"])
def test_what_is_no_regular_file_is_named_and_left_alone(tmp_path, kind):
    target, folder = tmp_path / "letter.txt", tmp_path / "run"
    folder.mkdir()
    target.write_text("{}")  # no newline
    for path in (folder / RECORDS, folder / RUN):
        if kind == "pipe":
            os.mkfifo(path)
        else:
            path.symlink_to({"link": target, "dangling": tmp_path / "not there"}[kind])
    with pytest.raises(StorageError, match=r"records\.jsonl is a link, a pipe"):
        Log(folder)
    with pytest.raises(FormatError, match=r"records\.jsonl cannot be read .* is a link, a pipe"):
        read(folder)
    with pytest.raises(FormatError, match=r"run\.json .*is a link, a pipe"):
        description(folder)
    assert target.read_text() == "{}"


# Workers


@pytest.mark.parametrize("workers", [1, 2])
def test_every_unit_is_done_once_and_told_of(tmp_path, config, workers):
    told, folder = [], tmp_path / "run"
    assert run(units(8), WORK, config, folder, workers, on_done=told.append) == Outcome(8, 0, 0)
    assert results(folder) == {f"square/{n}": {"ours": {"metrics": {"square": n * n}}} for n in range(8)}
    assert sorted(head["key"] for head in told) == [f"square/{n}" for n in range(8)]
    assert all(head["status"] == "ok" and head["task"] == "square" and "methods" not in head for head in told)
    processes = {r["process"] for r in read(folder)}
    assert (processes == {os.getpid()}) == (workers == 1)
    if workers == 2:
        assert os.getpid() not in processes
        assert {r["threads"] for r in read(folder)} == {"1"}
    assert run(units(9), WORK, config, folder) == Outcome(1, 0, 8)


def test_a_worker_keeps_its_group_while_there_are_others_and_nobody_idles():
    queue = Queue("square", units(7, groups=2), [], False)
    mine, other = (queue.take()[1].group for _ in range(2))
    assert other != mine
    for _ in range(3):
        assert queue.take(mine)[1].group == mine
    assert queue.take(mine)[1].group == other  # mine is done: help
    assert [queue.take(other)[1].group, queue.take(other)] == [other, None]


@pytest.mark.parametrize("how", [{}, {"workers": 4, "engine": "threads"}], ids=["alone", "threads"])
def test_a_unit_that_raises_is_tried_again_and_then_left_alone(tmp_path, config, how):
    trouble, told, folder = {1: "raise", 2: "raise once", 3: "nan"}, [], tmp_path / "run"
    assert run(units(5, trouble), WORK, config, folder, on_done=told.append, **how) == Outcome(3, 2, 0)
    found = {r["key"]: r for r in read(folder)}
    assert [found[f"square/{n}"]["attempt"] for n in range(5)] == [1, 2, 2, 2, 1]
    assert re.fullmatch(r"ValueError: cannot square 1 \(units_of_work\.py:\d+\)", found["square/1"]["error"])
    assert "square is nan" in found["square/3"]["error"]
    assert Counter(head["status"] for head in told) == {"ok": 3, "failed": 2}
    assert run(units(5, trouble), WORK, config, folder) == Outcome(0, 2, 3)
    assert len(list((tmp_path / "notes").glob("1-*"))) == 2
    assert run(units(5, {1: "raise"}), WORK, config, folder, retry_failed=True) == Outcome(1, 1, 3)
    found = {r["key"]: r["attempt"] for r in read(folder)}
    assert (found["square/1"], found["square/3"]) == (4, 3), "attempts are counted across runs"


def test_units_that_kill_their_workers_are_counted_and_the_rest_is_done(tmp_path, config):
    trouble, folder = {0: "die", 2: "kill", 4: "die once"}, tmp_path / "run"
    assert run(units(8, trouble), WORK, config, folder, workers=2) == Outcome(6, 2, 0)
    found = {r["key"]: r for r in read(folder)}
    assert "exit code 7" in found["square/0"]["error"]
    assert "signal 9" in found["square/2"]["error"]
    assert (found["square/4"]["status"], found["square/4"]["attempt"]) == ("ok", 2)
    assert len(list((tmp_path / "notes").glob("0-*"))) == 2


RUN_24 = """
import sys
from pathlib import Path
from eagor.lab.eval.runner import run
from eagor.lab.tasks.task import Sample

if __name__ == "__main__":
    folder, notes, workers, sleep = sys.argv[1:]
    units = [Sample(str(n), f"house {n % 3}", (n, None)) for n in range(24)]
    config = {"task": "square", "notes": notes, "sleep": float(sleep)}
    run(units, "units_of_work:squares", config, Path(folder), workers=int(workers))
"""


def launch(tmp_path, config, workers, sleep):
    script = tmp_path / "run.py"
    script.write_text(RUN_24)
    path = os.pathsep.join(entry for entry in sys.path if entry)
    arguments = [sys.executable, str(script), str(tmp_path / "run"), config["notes"], str(workers), str(sleep)]
    # A test run in the background of a shell ignores interrupts, and its children would too.
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    environment = {**os.environ, "PYTHONPATH": path}
    return subprocess.Popen(arguments, env=environment, preexec_fn=heed, start_new_session=True)


def kept(folder):
    return (folder / RECORDS).read_bytes().count(b"\n") if (folder / RECORDS).exists() else 0


@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_run_killed_in_the_middle_goes_on_to_what_it_would_have_been(tmp_path, config, workers):
    killed = launch(tmp_path, config, workers, sleep=0.1)
    wait_for(lambda: kept(tmp_path / "run") >= 3)
    sessions = sessions_of(killed.pid)
    killed.kill()
    killed.wait()
    wait_for(lambda: not alive(sessions))  # its workers leave by themselves
    before = kept(tmp_path / "run")
    assert before < 24
    outcome = run(units(24), WORK, {**config, "sleep": 0.1}, tmp_path / "run")
    assert outcome == Outcome(24 - before, 0, before)
    assert results(tmp_path / "run") == {f"square/{n}": {"ours": {"metrics": {"square": n * n}}} for n in range(24)}
    assert {r["attempt"] for r in read(tmp_path / "run")} == {1}


@pytest.mark.parametrize(
    ("work", "workers", "says"),
    [
        ("units_of_work:nothing", 1, "units_of_work:nothing"), ("no_such_module:squares", 1, "no_such_module"),
        ("units_of_work", 1, "wanted 'package.module:function'"), ("units_of_work:nothing", 2, "units_of_work:nothing"),
        ("units_of_work:hopeless", 2, "no such world"), ("units_of_work:stillborn", 2, "exit code 3"),
    ],
)  # fmt: skip
def test_work_that_cannot_be_found_or_set_up_ends_the_run(tmp_path, config, work, workers, says):
    with pytest.raises(WorkError, match=says):
        run(units(2), work, config, tmp_path / "run", workers)
    assert read(tmp_path / "run") == []


def test_impossible_numbers_and_double_keys_are_refused(tmp_path, config):
    with pytest.raises(EagorError, match="0 workers"):
        run(units(1), WORK, config, tmp_path, workers=0)
    with pytest.raises(EagorError, match="the id '0'"):
        run([*units(2), *units(1)], WORK, config, tmp_path)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="finds processes as Linux shows them")
def test_ray_does_everything_outlives_its_workers_and_leaves_no_process(tmp_path, config, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))  # what its workers import
    trouble = {3: "raise", 5: "die once", 7: "die"}
    processes = {}

    def rays():
        return {pid: words for pid, words in alive(sessions_of(os.getpid())).items() if "ray" in words}

    def look_around(_):
        processes.update(rays())

    folder = tmp_path / "run"
    assert run(units(12, trouble), WORK, config, folder, 2, engine="ray", on_done=look_around) == Outcome(10, 2, 0)
    assert all(any(name in words for words in processes.values()) for name in ("gcs_server", "raylet"))
    wait_for(lambda: not processes.keys() & rays().keys())
    found = {record["key"]: record for record in read(folder)}
    assert found["square/5"]["attempt"] == 2
    assert "died" in found["square/7"]["error"]
