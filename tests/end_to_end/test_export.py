"""`eagor export habitat`: what it prints, and that what it writes is what was named."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from listed_rooms import contents, room

from eagor.cli import main
from eagor.cli.export import scenes_of
from eagor.lab.envs.place_env import MobileBase
from eagor.lab.worlds.glb import export_glb


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
