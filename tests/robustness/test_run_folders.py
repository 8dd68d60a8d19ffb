"""Promised: a result that was kept stays a result, a run folder is of one run, and only regular files are worked on."""

import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest

from eagor.errors import EagorError, FormatError, StorageError
from eagor.lab.eval import log
from eagor.lab.eval.log import Log, begin, claimed, description, read


def test_of_runs_with_different_settings_that_start_together_one_goes_on(tmp_path):
    gate = threading.Barrier(4)

    def start(folder, seed):
        gate.wait(60)
        try:
            begin(folder, {"task": "x", "seed": seed})
        except EagorError as error:
            return str(error)
        return None

    with ThreadPoolExecutor(4) as pool:
        for turn in range(10):
            folder = tmp_path / str(turn)
            said = list(pool.map(partial(start, folder), range(4)))
            assert said.index(None) == description(folder)["seed"]
            assert sum("it differs in seed" in error for error in said if error) == 3
            assert [path.name for path in folder.iterdir()] == ["run.json"]


def test_a_name_is_claimed_once_also_where_there_are_no_hard_links(tmp_path, monkeypatch):
    def no_links(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", no_links)
    assert claimed(tmp_path / "a", "first")
    assert not claimed(tmp_path / "a", "second")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "first")]


def special(kind, path, target):
    if kind == "link":
        path.symlink_to(target)
    elif kind == "dangling":
        path.symlink_to(target.with_name("not there"))
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.mkdir()


@pytest.fixture
def soon():
    """A call that hangs is ended, and fails."""

    def late(*_):
        raise AssertionError("still waiting after 20 s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(20)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("kind", ["link", "dangling", "device", "pipe", "folder"])
def test_what_is_no_regular_file_is_named_and_left_alone(tmp_path, soon, kind):
    target, run = tmp_path / "letter.txt", tmp_path / "run"
    run.mkdir()
    target.write_text("{}")  # no newline
    special(kind, run / log.RECORDS, target)
    special(kind, run / log.RUN, target)
    with pytest.raises(StorageError, match=r"records\.jsonl is a link, a pipe"), Log(run) as book:
        book.append({"key": "a", "attempt": 1, "status": "ok"})
    with pytest.raises(FormatError, match=r"records\.jsonl cannot be read .* is a link, a pipe"):
        read(run)
    with pytest.raises(FormatError, match=r"run\.json is a link, a pipe"):
        begin(run, {"task": "x"})
    assert target.read_text() == "{}"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["letter.txt", "run"]
