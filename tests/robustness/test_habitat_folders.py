"""Folders and files of episodes that are wrong: one sentence each, nothing half written, nothing lost of a run."""

import pytest
from commands import eagor, refused
from listed_rooms import room
from processes import little_room

from eagor.errors import StorageError, WorldError
from eagor.lab.worlds import objectnav
from eagor.lab.worlds.glb import export_glb
from eagor.lab.worlds.objectnav import export_dataset

# --- export ---


SCENES = [
    (["9999-10000"], "there are no apartments 9999-10000; wanted seeds from 0 to 9999"),
    (["0-x"], "'0-x' names no apartment; wanted seeds, such as 0-4,7, or GLB files"),
    (["nowhere.glb"], "there is no file nowhere.glb"),
    (["3", "--episodes", "0"], "--episodes 0; wanted 1 or more"),
    (["3", "--name", "a/b"], "name = 'a/b'; wanted letters, digits"),
    (["3", "--radius", "-1"], "radius = -1"),
]


@pytest.mark.parametrize(("words", "says"), SCENES)
def test_impossible_scenes_are_refused_before_anything_is_made(tmp_path, words, says):
    assert says in refused("export", "habitat", *words, "--out", tmp_path / "data")
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_is_left_alone(tmp_path):
    path = tmp_path / "room.glb"
    path.write_bytes(b"no GLB at all")
    assert "room.glb" in refused("export", "habitat", path, "--out", tmp_path / "new")
    assert list(tmp_path.iterdir()) == [path], "a corrupt one leaves nothing"
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "mine").write_text("kept")
    assert "data holds something; name a new folder, or an empty one" in refused(
        "export", "habitat", path, "--out", tmp_path / "data"
    )
    assert "mine is a file" in refused("export", "habitat", path, "--out", tmp_path / "data" / "mine")
    assert [each.name for each in (tmp_path / "data").iterdir()] == ["mine"]
    assert (tmp_path / "data" / "mine").read_text() == "kept"


def test_a_disk_that_fills_up_leaves_nothing_and_says_where(tmp_path):
    path = export_glb(room(), tmp_path / "made" / "room.glb")
    with little_room(path.stat().st_size // 2):
        done = eagor("export", "habitat", path, "--out", tmp_path / "data")
    assert (done.returncode, done.stdout) == (1, "")
    (line,) = done.stderr.splitlines()
    assert "cannot be written (File too large)" in line
    assert "bytes are needed there" in line
    assert [each.name for each in tmp_path.iterdir()] == ["made"]


@pytest.mark.parametrize("stopped", [KeyboardInterrupt, StorageError, WorldError])
def test_whatever_stops_an_export_leaves_nothing(tmp_path, monkeypatch, stopped):
    def stop(*_, **__):
        raise stopped("enough")

    monkeypatch.setattr(objectnav, "write_episodes", stop)
    with pytest.raises(stopped):
        export_dataset({"00000-room": room}, tmp_path / "data", categories=("bed",), episodes=1)
    assert list(tmp_path.iterdir()) == []
