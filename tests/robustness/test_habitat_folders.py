"""Folders and files of episodes that are wrong: one sentence each, nothing half written, nothing lost of a run."""

import gzip
import shutil

import pytest
from commands import eagor, refused
from listed_rooms import exported, rewrite, room
from processes import little_room

from eagor.errors import StorageError, WorldError
from eagor.lab.eval import log
from eagor.lab.worlds import objectnav
from eagor.lab.worlds.glb import export_glb
from eagor.lab.worlds.objectnav import SceneSource, export_dataset

# --- export ---


SCENES = [
    (["9999-10000"], "there are no apartments 9999-10000; wanted seeds from 0 to 9999"),
    (["7-3"], "there are no apartments 7-3"),
    (["10000"], "there are no apartments 10000"),
    (["0-x"], "'0-x' names no apartment; wanted seeds, such as 0-4,7, or GLB files"),
    (["-1"], "-1"),
    ([","], "no apartment is named"),
    (["nowhere.glb"], "there is no file nowhere.glb"),
    (["3", "--episodes", "0"], "0 episodes of each scene; wanted 1 or more"),
    (["3", "--name", "a/b"], "name = 'a/b'; wanted letters, digits"),
    (["3", "--split", ""], "split = ''; wanted letters, digits"),
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
        export_dataset([SceneSource(0, "room", room)], tmp_path / "data", categories=("bed",), episodes=1)
    assert list(tmp_path.iterdir()) == []


# --- episodes of a file ---


def bench(file, out, *more):
    return ["bench", "run", "navigation", "--perception", "truth", "--methods", "oracle", "--episodes-file", file,
            "--out", out, "--set", "max_steps=40", *more]  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    exported(folder, names=("room", "other"))
    return folder / "data"


@pytest.fixture
def file(made, tmp_path):
    """The episodes of two rooms, in a folder of their own."""
    shutil.copytree(made, tmp_path / "data")
    return tmp_path / "data" / "datasets" / "objectnav" / "eagor" / "v1" / "val" / "val.json.gz"


def strange(found):
    for episode in found["episodes"]:
        del episode["info"]["eagor"]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (strange, "do not say which of our scenes they were made for, so they can only be played in Habitat: --world"),
        (lambda found: found["episodes"][0]["info"].pop("eagor"), "do not say which of our scenes"),
        (
            lambda found: [each["info"]["eagor"].update(version="apartment 0 seed 7") for each in found["episodes"]],
            "made for apartment 0 seed 7; this version makes apartments 2",
        ),
        (lambda found: found["episodes"][0].update(object_category="piano"), "its category has no goals"),
        (
            lambda found: found["episodes"][0].pop("start_position"),
            "field `start_position` - at `$.episodes[0]`",
        ),
    ],
)
def test_episodes_of_others_and_of_other_versions_are_refused(file, tmp_path, change, says):
    rewrite(file, change)
    assert says in refused(*bench(file, tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_files_that_cannot_be_read_are_refused(file, tmp_path):
    path = file.parent / "content" / "room.json.gz"
    whole = path.read_bytes()
    for blob, says in ((whole[:400], "cut off or corrupt"), (b"{}", "gzipped"), (gzip.compress(b"{"), "JSON")):
        path.write_bytes(blob)
        assert says in refused(*bench(file, tmp_path / "run"))
    shutil.rmtree(file.parent / "content")
    assert "has no episodes" in refused(*bench(file, tmp_path / "run"))
    assert "cannot be read" in refused(*bench(file.with_name("nothing.json.gz"), tmp_path / "run"))


def test_scenes_that_are_not_there_are_named(file, tmp_path):
    scenes = tmp_path / "data" / "scene_datasets"
    scenes.rename(tmp_path / "elsewhere")
    line = refused(*bench(file, tmp_path / "run"))
    assert "no folder scene_datasets is above" in line
    assert "--scenes DIR" in line
    line = refused(*bench(file, tmp_path / "run", "--scenes", tmp_path))
    assert "none of the 2 scenes of" in line
    assert "eagor/val/00001-other/other.glb" in line
    assert eagor(*bench(file, tmp_path / "run", "--scenes", tmp_path / "elsewhere")).returncode == 0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--seed", "3"], "--seed chooses apartments, and --episodes-file says which"),
        (["--episodes", "0"], "0 episodes; wanted 1 or more"),
        (["--world", "somewhere.glb"], "has episodes in 2 scenes, but --world somewhere.glb is one of them"),
        (["--set", "goal=nowhere"], "footprint, view_points"),
        (["--set", "success_distance=0"], "success_distance"),
    ],
)
def test_options_that_do_not_go_with_a_file_are_refused(file, tmp_path, words, says):
    assert says in refused(*bench(file, tmp_path / "run", *words))


def test_options_that_need_a_file_and_tasks_that_take_none_say_so(file, tmp_path):
    words = ["bench", "run", "navigation", "--perception", "truth", "--out", tmp_path / "run"]
    assert "--scenes is the folder of the scenes of --episodes-file" in refused(*words, "--scenes", tmp_path)
    assert "goal=view_points needs episodes that have view points" in refused(*words, "--set", "goal=view_points")
    for task in ("waypoint", "tracking"):
        words = ["bench", "run", task, "--perception", "truth", "--episodes-file", file, "--out", tmp_path / "run"]
        assert f"{task} plays no episodes of a file; navigation does" in refused(*words)
    assert not (tmp_path / "run").exists()


def place(index, position):
    def change(found):
        found["episodes"][index]["start_position"] = position

    return change


def walled(found):
    """No view point of the chairs is left but one inside the bed."""
    (goals,) = found["goals_by_category"].values()
    for goal in goals:
        goal["view_points"] = goal["view_points"][:1]
        goal["view_points"][0]["agent_state"]["position"] = [4.0, 0.0, -3.0]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (place(1, [4.0, 0.0, -3.0]), "starts at (4.00, 3.00), which is not on free ground for a body of radius 0.18 m"),
        (place(1, [90.0, 0.0, 0.0]), "which is not on free ground"),
        (lambda found: found["episodes"][1]["info"]["eagor"].update(scene_hash="0" * 16), "made for the scene 0000"),
        (lambda found: found["episodes"][1]["info"]["eagor"].update(radius=0.3), "radius 0.3 m"),
    ],
)
def test_one_episode_that_cannot_be_played_costs_only_itself(file, tmp_path, change, says):
    rewrite(file, change)
    said = eagor(*bench(file, tmp_path / "run"))
    assert said.returncode == 3
    assert "7 episodes, 2 scenes; 1 could not be run" in said.stdout
    assert says in said.stderr
    failed = [record for record in log.read(tmp_path / "run") if record["status"] == "failed"]
    assert [record["key"] for record in failed] == ["navigation/room-1/oracle"]


def test_goals_without_a_way_to_them_cost_their_scene_alone(file, tmp_path):
    rewrite(file, walled)
    said = eagor(*bench(file, tmp_path / "run"))
    assert said.returncode == 3
    assert "4 episodes, 1 scene; 4 could not be run" in said.stdout
    assert "no way leads from (" in said.stderr
    assert "to a view point of any chair" in said.stderr
    rewrite(file, walled, "other")
    said = eagor(*bench(file, tmp_path / "none"))
    assert said.returncode == 1
    assert "no episode could be run" in said.stderr
