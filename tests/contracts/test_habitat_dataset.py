"""The folder that `eagor export habitat` writes: HM3D's layout, episodes on the floor.

What Habitat itself makes of it is tested where Habitat is installed: `tests/oracles/test_habitat_lab.py`.
"""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from box_scenes import scene_of, shell, thing
from listed_rooms import contents

from eagor.conventions import from_gltf, pose_from_habitat, rotation_from_xyzw
from eagor.errors import WorldError
from eagor.lab.worlds.glb import import_glb
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.objectnav import export_dataset, make_goals, roomy_ground
from eagor.lab.worlds.render import Renderer
from eagor.lab.worlds.scene import Room

SCENES = {"00007-first": lambda: furnished(), "00012-second": lambda: furnished("other")}


def furnished(source="room"):
    """Two rooms with a door between them, chairs, a bed, a tv on the wall behind a screen."""
    things = [
        *shell(8.0, 5.0),
        thing("wall", (4.0, 0, 0), (4.1, 3.6, 2.5)),
        thing("chair", (1.0, 1.0, 0), (1.4, 1.4, 0.9), "living room", "red"),
        thing("chair", (6.5, 0.6, 0), (6.9, 1.0, 0.9), "bedroom", "blue"),
        thing("bed", (6.0, 2.5, 0), (7.9, 4.2, 0.5), "bedroom"),
        thing('coffee "table"', (2.0, 3.0, 0), (2.6, 3.4, 0.4), "living room"),
        thing("tv", (0.0, 1.5, 0.9), (0.08, 2.5, 1.5)),
    ]
    rooms = [
        Room("living room", "living room", np.array([[0, 0, 4.0, 5.0]])),
        Room("bedroom", "bedroom", np.array([[4.1, 0, 8.0, 5.0]])),
    ]
    return scene_of(things, rooms, source=source)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("habitat") / "data"
    file, found = export_dataset(SCENES, path, episodes=9)
    assert [each["episodes"] for each in found] == [9, 9]
    return path, file, found


def test_everything_lies_where_hm3d_has_it(folder):
    path, file, found = folder
    assert file == path / "datasets/objectnav/eagor/v1/val/val.json.gz"
    home = path / "scene_datasets" / "eagor"
    assert found[1]["scene"] == str(home / "val/00012-second/second.glb")
    endings = (".glb", ".navmesh.json", ".semantic.json", ".stage_config.json")
    wanted = {home / "eagor.scene_dataset_config.json", file}
    wanted |= {home / f"val/{place}/{place[6:]}{end}" for place in ("00007-first", "00012-second") for end in endings}
    wanted |= {file.parent / f"content/{name}.json.gz" for name in ("first", "second")}
    assert {each for each in path.rglob("*") if each.is_file()} == wanted
    config = json.loads((home / "eagor.scene_dataset_config.json").read_text())
    assert [str(home / each) for each in config["stages"]["paths"][".glb"]] == [each["scene"] for each in found]
    default = config["stages"]["default_attributes"]
    stage = json.loads(Path(found[0]["scene"]).with_suffix(".stage_config.json").read_text())
    assert (default["up"], default["front"]) == (stage["up"], stage["front"]) == ([0, 1, 0], [0, 0, -1])


def test_the_same_call_gives_the_same_bytes(folder, tmp_path):
    path, _, _ = folder
    export_dataset(SCENES, tmp_path / "again", episodes=9)
    for one in path.rglob("*"):
        if one.is_file():
            assert one.read_bytes() == (tmp_path / "again" / one.relative_to(path)).read_bytes(), one


# --- episodes ---


def places_of(goal):
    """The view points of a goal, in our world."""
    return from_gltf(np.array([view["agent_state"]["position"] for view in goal["view_points"]]))


def test_the_files_say_what_habitat_reads(folder):
    """Keys, order of quaternions, axes and names of `ObjectNavDatasetV1`, spelt out."""
    _, file, _ = folder
    head, (content, _) = json.loads(gzip.decompress(file.read_bytes())), contents(file)
    assert head["episodes"] == []
    for part in (head, content):
        assert part["category_to_task_category_id"] == {"chair": 0, "bed": 1, "tv_monitor": 4}
        assert part["category_to_scene_annotation_category_id"] == part["category_to_task_category_id"]
    goals = content["goals_by_category"]
    assert set(goals) == {"first.glb_chair", "first.glb_bed", "first.glb_tv_monitor"}
    for episode in content["episodes"]:
        # The arguments of ObjectGoalNavEpisode; any other would stop Habitat.
        assert set(episode) == {
            "episode_id", "scene_id", "scene_dataset_config", "additional_obj_config_paths", "start_position",
            "start_rotation", "info", "goals", "start_room", "shortest_paths", "object_category",
        }  # fmt: skip
        assert episode["scene_id"] == "eagor/val/00007-first/first.glb"
        assert episode["info"]["eagor"].keys() == {"scene_hash", "version", "radius", "cell"}
    (goal,) = goals["first.glb_tv_monitor"]
    assert set(goal) == {
        "position", "radius", "object_id", "object_name", "object_name_id", "object_category", "room_id", "room_name",
        "view_points",
    }  # fmt: skip
    assert goal["object_name"] == f"tv_monitor_{goal['object_id']}"
    for view, place in zip(goal["view_points"], places_of(goal), strict=True):
        assert view.keys() == {"agent_state", "iou"}
        assert view["agent_state"].keys() == {"position", "rotation"}
        turn = pose_from_habitat(rotation_from_xyzw(np.array(view["agent_state"]["rotation"])))
        ahead = from_gltf(np.array(goal["position"]))[:2] - place[:2]
        assert np.allclose(turn @ [1, 0, 0], [*ahead / np.hypot(*ahead), 0])


def test_episodes_start_on_free_ground_and_their_distances_are_those_of_the_floor(folder):
    _, file, _ = folder
    scene = furnished()
    ground, mine = Ground.from_scene(scene, radius=0.18), contents(file)[0]
    goals = {name.removeprefix("first.glb_"): each for name, each in mine["goals_by_category"].items()}
    assert len(goals["chair"]) == 2
    renderer = Renderer(scene)
    for category, things in goals.items():
        for goal in things:
            instance, views = goal["object_id"], places_of(goal)
            assert category.removesuffix("_monitor") == scene.instances[instance].category
            assert np.allclose(from_gltf(np.array(goal["position"])), scene.instances[instance].centre)
            assert len(views) > 20
            assert ground.is_free(views[:, :2]).all()
            low, high = scene.instances[instance].low[:2], scene.instances[instance].high[:2]
            away = np.maximum(np.maximum(low - views[:, :2], views[:, :2] - high), 0)
            assert np.hypot(*away.T).max() <= 0.75 + 1e-6
            for place in views[::40]:
                ids = renderer.panorama(place + np.array([0, 0, 0.88]), np.eye(3), 64, rgb=False, range=False).ids
                assert (ids == instance).any()
    for episode in mine["episodes"]:
        start, info = from_gltf(np.array(episode["start_position"]))[:2], episode["info"]
        assert ground.is_free(start)
        things = goals[episode["object_category"]]
        views = np.concatenate([places_of(goal)[:, :2] for goal in things])
        assert info["geodesic_distance"] == pytest.approx(float(ground.field(views).distance(start)), abs=1e-9)
        assert info["euclidean_distance"] == pytest.approx(np.hypot(*(views - start).T).min(), abs=1e-9)
        assert 1.0 <= info["geodesic_distance"] <= 30.0
        nearest = next(goal for goal in things if goal["object_id"] == info["closest_goal_object_id"])
        way = ground.field(places_of(nearest)[:, :2])
        assert float(way.distance(start)) == pytest.approx(info["geodesic_distance"])
    assert len({tuple(each["start_position"]) for each in mine["episodes"]}) == len(mine["episodes"])
    assert {each["object_category"] for each in mine["episodes"]} == set(goals)


def test_an_exported_scene_is_the_one_that_its_episodes_were_made_for(folder):
    _, file, found = folder
    for content, exported in zip(contents(file), found, strict=True):
        hashes = {each["info"]["eagor"]["scene_hash"] for each in content["episodes"]}
        assert hashes == {import_glb(exported["scene"]).facts["exported hash"]}


def test_what_is_in_sight_from_nowhere_is_no_goal():
    scene = furnished()
    hidden = thing("plant", (3.0, 4.3, 0.2), (3.3, 4.6, 1.0))
    boxed = [*scene.instances, thing("cabinet", (2.9, 4.2, 0), (3.5, 4.8, 1.2)), hidden]
    high = scene_of(boxed, scene.rooms, source="high")
    ground = Ground.from_scene(high)
    assert "plant" not in make_goals(high, roomy_ground(high, ground))
    for asked, says in (
        ("plant", "no plant"),
        ("piano", "has no piano; it has bed, cabinet"),
        ("couch", "has no sofa"),
    ):
        with pytest.raises(WorldError, match=says):
            make_goals(high, roomy_ground(high, ground), (asked,))
    assert list(make_goals(high, roomy_ground(high, ground), ("tv_monitor",))) == ["tv"], "in Habitat's words, too"
