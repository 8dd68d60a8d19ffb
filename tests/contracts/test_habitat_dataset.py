"""The folder that `eagor export habitat` writes: HM3D's layout, episodes on the floor.

What Habitat itself makes of it is tested where Habitat is installed: `tests/oracles/test_habitat_lab.py`.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from box_scenes import scene_of, shell, thing

from eagor.errors import WorldError
from eagor.lab.worlds.glb import import_glb
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.objectnav import SceneSource, check_scene, export_dataset, make_goals, read_episodes, roomy_ground
from eagor.lab.worlds.render import Renderer
from eagor.lab.worlds.scene import Room


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
    sources = [SceneSource(7, "first", furnished), SceneSource(12, "second", lambda: furnished("other"))]
    file, found = export_dataset(sources, path, episodes=9)
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
    export_dataset(
        [SceneSource(7, "first", furnished), SceneSource(12, "second", lambda: furnished("other"))],
        tmp_path / "again",
        episodes=9,
    )
    for one in path.rglob("*"):
        if one.is_file():
            assert one.read_bytes() == (tmp_path / "again" / one.relative_to(path)).read_bytes(), one


# --- episodes ---


def test_episodes_start_on_free_ground_and_their_distances_are_those_of_the_floor(folder):
    _, file, _ = folder
    scene = furnished()
    ground = Ground.from_scene(scene, radius=0.18)
    mine = next(each for each in read_episodes(file) if "first" in each.episodes[0].scene)
    assert set(mine.goals) == {"chair", "bed", "tv"}
    assert len(mine.goals["chair"]) == 2
    renderer = Renderer(scene)
    for category, things in mine.goals.items():
        for goal in things:
            instance = goal.instance
            assert category == scene.instances[instance].category
            assert np.allclose(goal.position, scene.instances[instance].centre)
            assert len(goal.view_positions) > 20
            assert ground.is_free(goal.view_positions[:, :2]).all()
            low, high = scene.instances[instance].low[:2], scene.instances[instance].high[:2]
            away = np.maximum(np.maximum(low - goal.view_positions[:, :2], goal.view_positions[:, :2] - high), 0)
            assert np.hypot(*away.T).max() <= 0.75 + 1e-6
            for place in goal.view_positions[::40]:
                ids = renderer.panorama(place + np.array([0, 0, 0.88]), np.eye(3), 64, rgb=False, range=False).ids
                assert (ids == instance).any()
    for episode in mine.episodes:
        start = episode.position[:2]
        assert ground.is_free(start)
        views = np.concatenate([goal.view_positions[:, :2] for goal in mine.goals[episode.category]])
        assert episode.geodesic == pytest.approx(float(ground.field(views).distance(start)), abs=1e-9)
        assert episode.euclidean == pytest.approx(np.hypot(*(views - start).T).min(), abs=1e-9)
        assert 1.0 <= episode.geodesic <= 30.0
        nearest = next(goal for goal in mine.goals[episode.category] if goal.instance == episode.nearest)
        assert float(ground.field(nearest.view_positions[:, :2]).distance(start)) == pytest.approx(episode.geodesic)
    assert len({tuple(episode.position) for episode in mine.episodes}) == len(mine.episodes)
    assert {episode.category for episode in mine.episodes} == set(mine.goals)


def test_an_exported_scene_is_the_one_that_its_episodes_were_made_for(folder):
    _, file, found = folder
    for each, scene_file in zip(read_episodes(file), (Path(exported["scene"]) for exported in found), strict=True):
        scene = import_glb(scene_file)
        (mine,) = read_episodes(file.parent / "content" / f"{scene_file.stem}.json.gz")
        assert len(mine.episodes) == len(each.episodes) == 9
        for episode in mine.episodes:
            check_scene(episode, scene, Ground.from_scene(scene))


def test_what_is_in_sight_from_nowhere_is_no_goal():
    scene = furnished()
    hidden = thing("plant", (3.0, 4.3, 0.2), (3.3, 4.6, 1.0))
    boxed = [*scene.instances, thing("cabinet", (2.9, 4.2, 0), (3.5, 4.8, 1.2)), hidden]
    high = scene_of(boxed, scene.rooms, source="high")
    ground = Ground.from_scene(high)
    assert "plant" not in make_goals(high, roomy_ground(high, ground))
    with pytest.raises(WorldError, match="no plant"):
        make_goals(high, roomy_ground(high, ground), ("plant",))


@pytest.mark.parametrize(
    ("asked", "says"),
    [(("piano",), "has no piano; it has bed, chair"), (("tv_monitor",), None), (("couch",), "has no sofa")],
)
def test_categories_are_asked_for_in_our_words_or_in_habitats(asked, says):
    scene = furnished()
    if says is None:
        assert list(make_goals(scene, roomy_ground(scene, Ground.from_scene(scene)), asked)) == ["tv"]
    else:
        with pytest.raises(WorldError, match=says):
            make_goals(scene, roomy_ground(scene, Ground.from_scene(scene)), asked)
