"""Runs that are killed, torn, starved of disk, or poisoned keep what they had, and go on."""

import json
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from functools import partial
from queue import SimpleQueue

import numpy as np
import pytest
from processes import wait_for

from eagor.errors import EagorError, FormatError
from eagor.lab.eval import log, runner
from eagor.lab.eval.log import RECORDS, Log, begin, description, read
from eagor.lab.eval.runner import Outcome, Scheduler, Unit, WorkError

WORK = "units_of_work:squares"


def record(key, attempt=1, status="ok", **more):
    return {"key": key, "attempt": attempt, "status": status, **more}


def units(count, trouble=None, groups=3):
    return [Unit(f"square/{n}", f"house {n % groups}", (n, (trouble or {}).get(n))) for n in range(count)]


@pytest.fixture
def config(tmp_path):
    notes = tmp_path / "notes"
    notes.mkdir()
    return {"task": "square", "notes": str(notes)}


def results(folder):
    return {r["key"]: r["methods"] for r in read(folder) if r["status"] == "ok"}


# The log


def test_what_is_appended_is_read(tmp_path):
    with Log(tmp_path) as book:
        book.append(record("b", x=np.float32(0.5), n=np.int64(3), flags=np.array([True, False]), none=None))
        book.append(record("a", words="größer 30°", trace=[(1.5, 2), [3]]))
    assert read(tmp_path) == [
        record("a", words="größer 30°", trace=[[1.5, 2], [3]]),
        record("b", x=0.5, n=3, flags=[True, False], none=None),
    ]


def test_a_result_is_never_hidden_by_a_failure_and_else_the_highest_attempt_counts(tmp_path):
    with Log(tmp_path) as book:
        book.append(record("a", 2, x=1))
        book.append(record("a", 3, "failed"))
        book.append(record("b", x=1))
        book.append(record("b", x=2))
    assert [(r["attempt"], r["x"]) for r in read(tmp_path)] == [(2, 1), (1, 2)]


def test_one_process_writes_at_a_time(tmp_path):
    with Log(tmp_path), pytest.raises(EagorError, match="another process is writing"):
        Log(tmp_path)
    with Log(tmp_path) as book:
        book.append(record("a"))


def test_a_torn_last_line_is_left_out_and_the_next_record_begins_a_line(tmp_path):
    with Log(tmp_path) as book:
        for key in "abc":
            book.append(record(key, filler="é" * 50_000))  # longer than what is read at once when the end is mended
    path = tmp_path / RECORDS
    whole = path.read_bytes()
    for cut in (1, 7, 60_003):  # the newline alone, a bracket, the middle of a letter of two bytes
        path.write_bytes(whole[:-cut])
        kept = ["a", "b", "c"] if cut == 1 else ["a", "b"]
        assert [r["key"] for r in read(tmp_path)] == kept
        with Log(tmp_path) as book:
            book.append(record("d"))
        assert [r["key"] for r in read(tmp_path)] == [*kept, "d"]


@pytest.mark.parametrize(
    "line", [b'{"key": "b", "att', b"", b"[1]", b'{"key": "b"}', b'{"key":"b","attempt":1,"status":"?"}']
)
def test_any_other_broken_line_is_an_error_that_names_it(tmp_path, line):
    good = json.dumps(record("a")).encode()
    (tmp_path / "records.jsonl").write_bytes(good + b"\n" + line + b"\n" + good + b"\n")
    with pytest.raises(FormatError, match=r"records\.jsonl, line 2"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("value", "said"), [(float("nan"), "nan"), (np.array([1.0, np.inf]), "inf"), ({3}, "set"), ({1: 2}, "key 1")]
)
def test_what_json_cannot_hold_is_refused_by_name_and_nothing_is_written(tmp_path, value, said):
    with Log(tmp_path) as book:
        book.append(record("a"))
        with pytest.raises(EagorError, match=f"(?s)b: metrics: mae.*{said}"):
            book.append(record("b", metrics={"mae": value}))
        book.append(record("c"))
    assert [r["key"] for r in read(tmp_path)] == ["a", "c"]


def test_run_json_is_written_once_and_held_against_later_runs(tmp_path):
    config = {"task": "waypoint", "seed": 3, "rules": {"step": 0.25}, "methods": ("eagor", "grid")}
    begin(tmp_path / "run", config)
    before = (tmp_path / "run" / "run.json").stat().st_mtime_ns
    begin(tmp_path / "run", config)
    assert (tmp_path / "run" / "run.json").stat().st_mtime_ns == before
    found = description(tmp_path / "run")
    assert found == {**config, "methods": ["eagor", "grid"], "commit": found["commit"], "samples": None}
    other = {"task": "search", "seed": 4, "rules": {"step": 0.5, "slide": True}, "methods": ("eagor",), "rows": 3}
    with pytest.raises(EagorError) as refused:
        begin(tmp_path / "run", other)
    first, second, third = refused.value.lines
    assert first.endswith("run holds another run, of waypoint")
    assert second.startswith("it differs in task, seed, rules, methods and 1 more")
    assert "another folder" in third
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["run.json"]


def test_the_commit_and_the_samples_are_information_and_no_lock(tmp_path, config, monkeypatch):
    folder = tmp_path / "run"
    runner.run(units(2), WORK, config, folder)
    first = description(folder)
    assert first["samples"]["count"] == 2
    assert len(first["samples"]["digest"]) == 16
    monkeypatch.setattr(log, "commit", lambda: "another")
    assert runner.run(units(5), WORK, config, folder) == Outcome(3, 0, 2)
    assert description(folder) == first


def test_a_run_can_get_more_episodes(tmp_path):
    for episodes in (3, 5, 4):
        begin(tmp_path, {"task": "x", "episodes": episodes, "development": episodes > 3})
    assert (description(tmp_path)["episodes"], description(tmp_path)["development"]) == (5, True)


def test_a_folder_without_a_run_or_with_a_broken_one_is_named(tmp_path):
    with pytest.raises(FormatError, match=r"no run\.json"):
        description(tmp_path)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(FormatError, match=r"run\.json is no JSON"):
        begin(tmp_path, {"task": "waypoint"})
    (tmp_path / "run.json").write_text("[]")
    with pytest.raises(FormatError, match="list"):
        description(tmp_path)


# Workers


@pytest.mark.parametrize("workers", [1, 2])
def test_every_unit_is_done_once_and_told_of(tmp_path, config, workers):
    told = []
    outcome = runner.run(units(8), WORK, config, tmp_path / "run", workers, on_done=told.append)
    assert outcome == Outcome(done=8, failed=0, skipped=0)
    assert results(tmp_path / "run") == {f"square/{n}": {"ours": {"metrics": {"square": n * n}}} for n in range(8)}
    assert sorted(head["key"] for head in told) == [f"square/{n}" for n in range(8)]
    assert all(head["status"] == "ok" and head["task"] == "square" and "methods" not in head for head in told)
    processes = {r["process"] for r in read(tmp_path / "run")}
    assert (processes == {os.getpid()}) == (workers == 1)
    if workers == 2:
        assert os.getpid() not in processes
        assert {r["threads"] for r in read(tmp_path / "run")} == {"1"}
    again = runner.run(units(9), WORK, config, tmp_path / "run", workers=1)
    assert again == Outcome(done=1, failed=0, skipped=8)


def test_alone_units_go_group_by_group(tmp_path, config):
    runner.run(units(6, groups=2), WORK, config, tmp_path / "run")
    written = [json.loads(line)["key"] for line in (tmp_path / "run" / RECORDS).read_bytes().splitlines()]
    assert written == [f"square/{n}" for n in (0, 2, 4, 1, 3, 5)]


def test_a_worker_keeps_its_group_while_there_are_others_and_nobody_idles():
    schedule = Scheduler(units(7, groups=2), {}, 1, False, None, lambda _: None, None)
    mine = schedule.take(None, ())[0].group
    other = schedule.take(None, [mine])[0].group
    assert other != mine
    for _ in range(3):
        assert schedule.take(mine, [other])[0].group == mine
    assert schedule.take(mine, [other])[0].group == other  # mine is done: help
    assert schedule.left == 1


@pytest.mark.parametrize("how", [{}, {"workers": 4, "engine": "threads"}], ids=["alone", "threads"])
def test_a_unit_that_raises_is_tried_again_and_then_left_alone(tmp_path, config, how):
    trouble = {1: "raise", 2: "raise once", 3: "nan"}
    told = []
    outcome = runner.run(units(5, trouble), WORK, config, tmp_path / "run", on_done=told.append, **how)
    assert outcome == Outcome(done=3, failed=2, skipped=0)
    found = {r["key"]: r for r in read(tmp_path / "run")}
    assert [found[f"square/{n}"]["attempt"] for n in range(5)] == [1, 2, 2, 2, 1]
    assert re.fullmatch(r"ValueError: cannot square 1 \(units_of_work\.py:\d+\)", found["square/1"]["error"])
    assert "square is nan" in found["square/3"]["error"]
    assert Counter(head["status"] for head in told) == {"ok": 3, "failed": 2}
    assert runner.run(units(5, trouble), WORK, config, tmp_path / "run") == Outcome(done=0, failed=2, skipped=3)
    assert len(list((tmp_path / "notes").glob("1-*"))) == 2
    cured = runner.run(units(5, {1: "raise"}), WORK, config, tmp_path / "run", retry_failed=True)
    assert cured == Outcome(done=1, failed=1, skipped=3)
    found = {r["key"]: r["attempt"] for r in read(tmp_path / "run")}
    assert (found["square/1"], found["square/3"]) == (4, 3), "attempts are counted across runs"


def test_units_that_kill_their_workers_or_cannot_be_sent_are_counted_and_the_rest_is_done(tmp_path, config):
    trouble = {0: "die", 2: "kill", 4: "die once"}
    unsent = Unit("square/unsent", "house 0", lambda: None)
    outcome = runner.run([unsent, *units(8, trouble)], WORK, config, tmp_path / "run", workers=2)
    assert outcome == Outcome(done=6, failed=3, skipped=0)
    found = {r["key"]: r for r in read(tmp_path / "run")}
    assert found["square/unsent"]["status"] == "failed"
    assert "exit code 7" in found["square/0"]["error"]
    assert "signal 9" in found["square/2"]["error"]
    assert (found["square/4"]["status"], found["square/4"]["attempt"]) == ("ok", 2)
    assert len(list((tmp_path / "notes").glob("0-*"))) == 2


def test_a_worker_that_dies_while_it_waits_costs_no_attempt():
    class Idle:
        alive = True

        def do(self, payload):
            if not self.alive:
                raise runner.WorkerDiedError("signal 9")
            return "ok", 0.0, {"payload": payload}

        def close(self, at_once):
            pass

    hired, answers = [], SimpleQueue()

    def hire():
        hired.append(Idle())
        return hired[-1]

    lane = runner._Lane(hire, answers)
    for payload in (1, 2):
        lane.into.put(payload)
        assert answers.get() == (lane, ("ok", 0.0, {"payload": payload}))
        hired[-1].alive = False
    lane.close(True)
    assert len(hired) == 2


RUN = """
import sys
from functools import partial
from pathlib import Path
from eagor.lab.eval.runner import Unit, run

if __name__ == "__main__":
    folder, notes, workers, sleep = sys.argv[1:]
    units = [Unit(f"square/{n}", f"house {n % 3}", (n, None)) for n in range(24)]
    config = {"task": "square", "notes": notes, "sleep": float(sleep)}
    run(units, "units_of_work:squares", config, Path(folder), workers=int(workers))
"""


def launch(tmp_path, config, workers, sleep):
    script = tmp_path / "run.py"
    script.write_text(RUN)
    path = os.pathsep.join(entry for entry in sys.path if entry)
    arguments = [sys.executable, str(script), str(tmp_path / "run"), config["notes"], str(workers), str(sleep)]
    # A test run in the background of a shell ignores interrupts, and its children would too.
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    return subprocess.Popen(arguments, env={**os.environ, "PYTHONPATH": path}, preexec_fn=heed)


def kept(folder):
    return (folder / RECORDS).read_bytes().count(b"\n") if (folder / RECORDS).exists() else 0


@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_run_killed_in_the_middle_goes_on_to_what_it_would_have_been(tmp_path, config, workers):
    run = launch(tmp_path, config, workers, sleep=0.1)
    wait_for(lambda: kept(tmp_path / "run") >= 3)
    run.send_signal(signal.SIGKILL)
    run.wait()
    before = kept(tmp_path / "run")
    assert before < 24
    wanted = [Unit(f"square/{n}", f"house {n % 3}", (n, None)) for n in range(24)]
    outcome = runner.run(wanted, WORK, {**config, "sleep": 0.1}, tmp_path / "run")
    assert outcome.skipped >= before
    assert outcome.done == 24 - outcome.skipped
    (tmp_path / "other").mkdir()
    assert runner.run(wanted, WORK, {**config, "notes": str(tmp_path / "other")}, tmp_path / "whole").done == 24
    assert results(tmp_path / "run") == results(tmp_path / "whole")
    assert {r["attempt"] for r in read(tmp_path / "run")} == {1}


def test_workers_leave_when_their_parent_is_killed(tmp_path, config):
    run = launch(tmp_path, config, workers=2, sleep=60)
    wait_for(lambda: len(list((tmp_path / "notes").iterdir())) == 2)
    processes = [int(path.name.split("-")[2]) for path in (tmp_path / "notes").iterdir()]
    run.send_signal(signal.SIGKILL)
    run.wait()
    wait_for(lambda: not any(alive(process) for process in processes))


def test_ctrl_c_stops_the_workers_and_keeps_what_was_done(tmp_path, config):
    run = launch(tmp_path, config, workers=2, sleep=0.2)
    wait_for(lambda: kept(tmp_path / "run") >= 2)
    run.send_signal(signal.SIGINT)
    assert run.wait(30) == -signal.SIGINT  # Python's way to end after an unhandled KeyboardInterrupt
    processes = {int(path.name.split("-")[2]) for path in (tmp_path / "notes").iterdir()}
    assert not any(alive(process) for process in processes)
    found = read(tmp_path / "run")
    assert 2 <= len(found) < 24
    assert {r["status"] for r in found} == {"ok"}


def alive(process):
    try:
        with open(f"/proc/{process}/stat") as stat:
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize(
    ("work", "workers"),
    [("units_of_work:nothing", 1), ("no_such_module:squares", 1), ("units_of_work", 1), ("units_of_work:nothing", 2)],
)
def test_work_that_cannot_be_found_is_named(tmp_path, config, work, workers):
    with pytest.raises(WorkError, match=work):
        runner.run(units(2), work, config, tmp_path / "run", workers)
    assert read(tmp_path / "run") == []


def test_work_that_cannot_be_set_up_ends_the_run(tmp_path, config):
    with pytest.raises(WorkError, match="no such world"):
        runner.run(units(2), "units_of_work:hopeless", config, tmp_path / "run", workers=2)
    with pytest.raises(WorkError, match="exit code 3"):
        runner.run(units(2), "units_of_work:stillborn", config, tmp_path / "run", workers=2)


def test_impossible_numbers_and_double_keys_are_refused(tmp_path, config):
    with pytest.raises(EagorError, match="0 workers"):
        runner.run(units(1), WORK, config, tmp_path, workers=0)
    with pytest.raises(EagorError, match="square/0"):
        runner.run([*units(2), *units(1)], WORK, config, tmp_path)
