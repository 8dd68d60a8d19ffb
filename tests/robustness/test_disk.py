"""Disks that are full, folders that are not ours: what was computed stays, and it is said where room is wanted.

A limit on the size of files stands for a full disk: the kernel then refuses to write on, in the middle of a line too.
"""

import os
import shutil

import commands
import hstar_data
import pytest
from PIL import Image
from processes import little_room

from eagor._files import write_atomic
from eagor.cli.answers import appended
from eagor.errors import StorageError
from eagor.lab.eval import log
from eagor.lab.worlds.painted import painted_room

pytest.importorskip("resource")  # POSIX


def eagor(*words, room):
    """The command, whose files may hold so many bytes."""
    with little_room(room):
        return commands.eagor(*words)


def refused(*words, room, says):
    """Exit code 1, one line that says where and how much, nothing on stdout."""
    done = eagor(*words, room=room)
    assert (done.returncode, done.stdout) == (1, ""), done.stderr
    assert "Traceback" not in done.stderr
    line = done.stderr.splitlines()[-1]
    assert line.startswith("eagor: error: ")
    assert "File too large" in line
    assert "bytes" in line
    assert says in line


def timeless(value):
    if isinstance(value, dict):
        return {key: timeless(inner) for key, inner in value.items() if key not in ("seconds", "ms", "milliseconds")}
    return [timeless(inner) for inner in value] if isinstance(value, list) else value


def records(folder):
    return {record["key"]: timeless(record) for record in log.read(folder)}


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    data = hstar_data.write(tmp_path_factory.mktemp("data"))
    return ("bench", "run", "hstar-hos", "--data", data, "--perception", "truth:miss=0.5")


@pytest.fixture(scope="module")
def whole(told, tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "run"
    assert commands.answer(*told, "--out", out)["episodes"] == 16
    return out


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_run_without_room_says_where_and_goes_on_when_there_is_room_again(told, whole, tmp_path, workers):
    out = tmp_path / "run"
    words = (*told, "--out", out, "--workers", workers)
    room = (whole / "records.jsonl").stat().st_size // 4
    refused(*words, room=room, says=str(out))
    kept = records(out)
    assert 0 < len(kept) < 16
    assert (out / log.RECORDS).read_bytes()[-2:] in (b"", b"}\n")
    assert commands.answer(*words)["episodes"] == 16
    assert records(out) == records(whole)
    assert all(records(out)[key] == record for key, record in kept.items())


def test_pictures_and_tables_are_whole_or_not_there(tmp_path):
    frames = tmp_path / "frames"
    frames.mkdir()
    for name in "abcd":
        Image.fromarray(painted_room(24, 48)).save(frames / f"{name}.png")
    poses = tmp_path / "poses.csv"
    poses.write_text("stamp,yaw_deg,pitch_deg,roll_deg\n0,0,0,0\n1,9,0,0\n2,9,0,0\n3,9,0,0\n")
    picture, out = tmp_path / "where.png", tmp_path / "out.csv"
    refused("locate", frames / "a.png", "red", "--picture", picture, room=1000, says=str(picture))
    assert not picture.exists()
    done = eagor("track", frames, "red", "--poses", poses, "--out", out, room=300)
    assert done.returncode == 1
    assert str(out) in done.stderr
    text = out.read_text()
    assert text.endswith("\n")
    assert 2 <= len(text.splitlines()) < 5


def test_what_was_there_stays_where_the_new_one_has_no_room(tmp_path, monkeypatch):
    path = write_atomic(tmp_path / "new" / "kept.txt", "old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match=r"kept\.txt.*No space left.*3 bytes"):
        write_atomic(path, "new")
    assert path.read_text() == "old"
    assert [place.name for place in path.parent.iterdir()] == ["kept.txt"]


def test_lines_are_made_with_the_first_and_stay_whole(tmp_path):
    path = tmp_path / "lines.txt"
    with appended(path) as add:
        assert not path.exists()
        add("a\n")
        add("half a letter: \ud800\n")
    assert path.read_text() == "a\nhalf a letter: \\ud800\n"
    with appended(tmp_path / "nowhere" / "x") as add, pytest.raises(StorageError, match="2 bytes"):
        add("a\n")


def test_a_file_in_place_of_the_folder_and_a_folder_of_another_run_are_refused(told, whole, tmp_path):
    (tmp_path / "file").write_text("x")
    for out, says in ((tmp_path / "file", "cannot be made a folder"), (whole, "holds another run")):
        done = commands.eagor(*told, "--out", out, "--set", "sure=0.7")
        assert (done.returncode, done.stdout) == (2, "")
        assert says in done.stderr
    assert (tmp_path / "file").read_text() == "x"


def test_a_folder_that_vanishes_is_named(tmp_path):
    with log.Log(tmp_path / "run") as book:
        book.append({"key": "a", "attempt": 1, "status": "ok"})
        shutil.rmtree(tmp_path / "run")
        with pytest.raises(StorageError, match="somebody has removed"):
            book.append({"key": "b", "attempt": 1, "status": "ok"})
