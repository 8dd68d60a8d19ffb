"""The folder that `eagor export habitat` writes: HM3D's layout, ids that fit the triangles, episodes on the floor.

What Habitat itself makes of it is tested where Habitat is installed: `tests/oracles/test_habitat_lab.py`.
"""

import io
import json
import re

import numpy as np
import pytest
import trimesh
from box_scenes import scene_of, shell, thing
from PIL import Image

from eagor._srgb import to_coded
from eagor.conventions import from_gltf
from eagor.errors import WorldError
from eagor.worlds.glb import import_glb
from eagor.worlds.ground import Ground
from eagor.worlds.habitat_dataset import Source, export_dataset, make_goals
from eagor.worlds.habitat_files import FIRST_ID, colours_of, semantic_glb, semantic_text
from eagor.worlds.objectnav import check_scene, read_episodes
from eagor.worlds.render import Renderer
from eagor.worlds.scene import Room


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
    sources = [Source(7, "first", furnished), Source(12, "second", lambda: furnished("other"))]
    file, found = export_dataset(sources, path, episodes=9)
    assert [each.episodes for each in found] == [9, 9]
    return path, file, found


def test_everything_lies_where_hm3d_has_it(folder):
    path, file, found = folder
    assert file == path / "datasets/objectnav/eagor/v1/val/val.json.gz"
    home = path / "scene_datasets" / "eagor"
    assert found[1].scene == home / "val/00012-second/second.glb"
    endings = (
        ".glb",
        ".navmesh.json",
        ".semantic.glb",
        ".semantic.json",
        ".semantic.txt",
        ".stage_config.json",
    )
    wanted = {home / "eagor.scene_dataset_config.json", file}
    wanted |= {home / f"val/{place}/{place[6:]}{end}" for place in ("00007-first", "00012-second") for end in endings}
    wanted |= {file.parent / f"content/{name}.json.gz" for name in ("first", "second")}
    assert {each for each in path.rglob("*") if each.is_file()} == wanted
    config = json.loads((home / "eagor.scene_dataset_config.json").read_text())
    assert [home / each for each in config["stages"]["paths"][".glb"]] == [each.scene for each in found]
    default = config["stages"]["default_attributes"]
    stage = json.loads(found[0].scene.with_suffix(".stage_config.json").read_text())
    assert (default["up"], default["front"]) == (stage["up"], stage["front"]) == ([0, 1, 0], [0, 0, -1])
    for key in ("semantic_asset", "semantic_descriptor_filename"):
        named = default[key].replace("%%CONFIG_NAME_AS_ASSET_FILENAME%%", "first")
        assert named == stage[key]
        assert (found[0].scene.parent / named).is_file()
    assert stage["has_semantic_textures"] is default["has_semantic_textures"] is True


def test_the_same_call_gives_the_same_bytes(folder, tmp_path):
    path, _, _ = folder
    export_dataset(
        [Source(7, "first", furnished), Source(12, "second", lambda: furnished("other"))],
        tmp_path / "again",
        episodes=9,
    )
    for one in path.rglob("*"):
        if one.is_file():
            assert one.read_bytes() == (tmp_path / "again" / one.relative_to(path)).read_bytes(), one


def test_the_folder_may_have_the_names_of_hm3d(tmp_path):
    file, found = export_dataset([Source(800, "room", furnished)], tmp_path, name="hm3d", split="minival", episodes=1)
    assert file.relative_to(tmp_path).as_posix() == "datasets/objectnav/hm3d/v1/minival/minival.json.gz"
    (each,) = read_episodes(file)
    assert each.episodes[0].scene == "hm3d/minival/00800-room/room.glb"
    assert found[0].scene == tmp_path / "scene_datasets" / each.episodes[0].scene
    assert each.episodes[0].dataset_config == "./data/scene_datasets/hm3d/hm3d.scene_dataset_config.json"


# --- ids ---


def lines_of(text):
    """The lines as Habitat-Sim splits them: what stands in quotes is the category, the region comes after it."""
    header, *lines = text.splitlines()
    assert header == "HM3D Semantic Annotations"
    found = {}
    for line in lines:
        match = re.fullmatch(r'(\d+),([0-9A-F]{6}),"([^"]*)",(-?\d+)', line)
        found[int(match[1])] = (tuple(bytes.fromhex(match[2])), match[3], int(match[4]))
    return found


def test_ids_colours_and_regions_of_the_text_are_those_of_the_scene():
    scene = furnished()
    found = lines_of(semantic_text(scene))
    assert list(found) == [index + FIRST_ID for index in range(len(scene.instances))]
    assert 0 not in found  # which is Habitat's "Unknown"
    assert len({colour for colour, _, _ in found.values()}) == len(found)
    assert {category for _, category, _ in found.values()} == {
        "floor", "wall", "chair", "bed", "coffee table", "tv"
    }  # fmt: skip
    regions = {found[index + FIRST_ID][2] for index, each in enumerate(scene.instances) if each.room == "bedroom"}
    assert regions == {1}
    assert found[1][2] == 2  # no room


def test_texture_and_vertex_colours_show_the_instance_of_each_triangle():
    scene = furnished()
    blob = semantic_glb(scene)
    assert blob == semantic_glb(furnished())
    length = int.from_bytes(blob[12:16], "little")
    tree, data = json.loads(blob[20 : 20 + length]), blob[28 + length :]
    assert int.from_bytes(blob[8:12], "little") == len(blob)

    def values(name):
        accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"][name]]
        view = tree["bufferViews"][accessor["bufferView"]]
        width = int(accessor["type"][-1])
        return np.frombuffer(data, np.float32, width * accessor["count"], view["byteOffset"]).reshape(-1, width)

    faces = tree["bufferViews"][0]
    index = np.frombuffer(data, np.uint32, faces["byteLength"] // 4, faces["byteOffset"])
    image = tree["bufferViews"][tree["images"][0]["bufferView"]]
    picture = np.asarray(Image.open(io.BytesIO(data[image["byteOffset"] :][: image["byteLength"]])))
    assert picture.shape[2] == 3  # Habitat-Sim reads it as RGB
    wanted = np.array([lines_of(semantic_text(scene))[owner + FIRST_ID][0] for owner in scene.instance])
    corners = from_gltf(values("POSITION").astype(float))[index].reshape(-1, 3, 3)
    assert np.allclose(corners, scene.vertices[scene.triangles], atol=1e-6)
    painted = np.rint(255 * to_coded(values("COLOR_0").astype(float)))[index].reshape(-1, 3, 3)
    assert np.array_equal(painted, np.repeat(wanted[:, None], 3, axis=1))
    column, row = (values("TEXCOORD_0") * picture.shape[1::-1]).astype(int).T
    assert np.array_equal(picture[row, column][index].reshape(-1, 3, 3), np.repeat(wanted[:, None], 3, axis=1))


def test_others_read_the_semantic_glb(tmp_path):
    path = tmp_path / "room.semantic.glb"
    path.write_bytes(semantic_glb(furnished()))
    model = trimesh.load_scene(path)
    assert sum(len(each.faces) for each in model.geometry.values()) == len(furnished().triangles)


def test_a_million_colours_differ_and_too_many_instances_are_refused():
    colours = colours_of(65534).astype(int) @ [65536, 256, 1]
    assert len(set(colours.tolist())) == len(colours)
    assert 0 not in colours
    with pytest.raises(WorldError, match="65536 instances"):
        colours_of(65536)


# --- episodes ---


def test_episodes_start_on_free_ground_and_their_distances_are_those_of_the_floor(folder):
    _, file, _ = folder
    scene = furnished()
    ground = Ground.from_scene(scene, radius=0.18)
    mine = next(each for each in read_episodes(file) if "first" in each.episodes[0].scene)
    assert set(mine.goals) == {"chair", "bed", "tv"}
    assert len(mine.goals["chair"]) == 2
    renderer = Renderer(scene)
    text = lines_of(semantic_text(scene))
    for category, things in mine.goals.items():
        for goal in things:
            instance = goal.instance - FIRST_ID
            assert text[goal.instance][1] == category == scene.instances[instance].category
            assert np.allclose(goal.position, scene.instances[instance].centre)
            assert len(goal.view_positions) > 20
            assert ground.is_free(goal.view_positions[:, :2]).all()
            low, high = scene.instances[instance].low[:2], scene.instances[instance].high[:2]
            away = np.maximum(np.maximum(low - goal.view_positions[:, :2], goal.view_positions[:, :2] - high), 0)
            assert np.hypot(*away.T).max() <= 0.75 + 1e-6
            for place, turn in list(zip(goal.view_positions, goal.view_rotations, strict=True))[::40]:
                ids = renderer.panorama(place + np.array([0, 0, 0.88]), turn, 64, rgb=False, range=False).ids
                assert (ids == instance).any()
                towards = turn.T @ (goal.position - place)
                assert abs(np.arctan2(towards[1], towards[0])) < 1e-6
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
    for each, scene_file in zip(read_episodes(file), (exported.scene for exported in found), strict=True):
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
    assert "plant" not in make_goals(high, ground)
    with pytest.raises(WorldError, match="no plant"):
        make_goals(high, ground, ("plant",))


@pytest.mark.parametrize(
    ("asked", "says"),
    [(("piano",), "has no piano; it has bed, chair"), (("tv_monitor",), None), (("couch",), "has no sofa")],
)
def test_categories_are_asked_for_in_our_words_or_in_habitats(asked, says):
    scene = furnished()
    if says is None:
        assert list(make_goals(scene, Ground.from_scene(scene), asked)) == ["tv"]
    else:
        with pytest.raises(WorldError, match=says):
            make_goals(scene, Ground.from_scene(scene), asked)


def test_a_scene_without_the_six_categories_says_what_it_has(tmp_path):
    plain = scene_of([*shell(4, 4), thing("piano", (1, 1, 0), (2, 2, 1))], source="plain")
    with pytest.raises(WorldError, match=r"plain has none of chair.*; it has piano"):
        export_dataset([Source(0, "plain", lambda: plain)], tmp_path / "data")
    assert not (tmp_path / "data").exists()
    file, _ = export_dataset([Source(0, "plain", lambda: plain)], tmp_path / "data", categories=("piano",), episodes=2)
    assert read_episodes(file)[0].episodes[0].category == "piano"


def test_a_place_too_small_for_a_start_is_refused(tmp_path):
    small = scene_of([*shell(1.6, 1.6), thing("chair", (0.6, 0.6, 0), (1.0, 1.0, 0.9))], source="closet")
    with pytest.raises(WorldError, match="every place in closet is nearer than 1 m to a chair"):
        export_dataset([Source(0, "closet", lambda: small)], tmp_path / "data")
    assert list(tmp_path.iterdir()) == []
