"""`eagor export habitat`: what it prints, what it writes, and that what is wrong leaves nothing half written."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commands import eagor, refused
from listed_rooms import contents, room
from processes import little_room

from eagor.cli import main
from eagor.cli.export import scenes_of
from eagor.errors import StorageError, WorldError
from eagor.lab.envs.place_env import MobileBase
from eagor.lab.worlds import objectnav
from eagor.lab.worlds.glb import export_glb
from eagor.lab.worlds.objectnav import export_dataset


def test_a_dataset_is_announced_as_it_is(tmp_path, capsys):
    path = export_glb(room(), tmp_path / "my kitchen (2).glb")
    words = ["export", "habitat", str(path), "--out", str(tmp_path / "data"), "--episodes", "2", "--json"]
    assert main([*words, "--categories", "bed", "--name", "hm3d"]) == 0
    out, err = capsys.readouterr()
    said = json.loads(out)
    assert "eagor: my_kitchen_2_: 8 instances, 1 goals with" in err
    assert "habitat_sim is not installed here" in err or said["meshes"]
    (scene,) = said["scenes"]
    assert scene["scene"] == str(tmp_path / "data/scene_datasets/hm3d/val/10000-my_kitchen_2_/my_kitchen_2_.glb")
    assert (scene["instances"], scene["goals"], scene["episodes"]) == (8, 1, 2)
    (read,) = contents(Path(said["episodes_file"]))
    assert [each["object_category"] for each in read["episodes"]] == ["bed", "bed"]
    assert json.loads(Path(said["config"]).read_text())["stages"]["paths"][".glb"] == [
        "val/10000-my_kitchen_2_/my_kitchen_2_.glb"
    ]


def test_a_radius_is_that_of_starts_and_of_the_mesh(tmp_path):
    path = export_glb(room(), tmp_path / "room.glb")
    words = ["export", "habitat", str(path), "--out", str(tmp_path / "data"), "--episodes", "1", "--radius", "0.3"]
    assert main(words) == 0
    (read,) = contents(tmp_path / "data/datasets/objectnav/eagor/v1/val/val.json.gz")
    assert read["episodes"][0]["info"]["eagor"]["radius"] == 0.3
    (settings,) = (tmp_path / "data").rglob("*.navmesh.json")
    assert json.loads(settings.read_text())["agent_radius"] == 0.3


def test_seeds_are_written_as_ranges_and_counted_once():
    found = scenes_of(("0-2,7", "5", "2-3", "7"))
    assert list(found) == [f"{seed:05d}-apartment{seed:04d}" for seed in (0, 1, 2, 7, 5, 3)]


def test_a_path_over_steps_is_as_long_as_in_space():
    """habitat-lab sums the moves of the feet in three dimensions."""
    stairs = SimpleNamespace(height=lambda xy: 4.0 * (xy[0] > 0))
    body = MobileBase(stairs, np.zeros(2), 0.0)
    body.carry(np.array([3.0, 0.0]), 0.0)
    assert body.walked == 5.0
    body.carry(np.array([3.0, 0.0]), 1.0)
    assert body.walked == 5.0


# --- what is wrong ---


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
