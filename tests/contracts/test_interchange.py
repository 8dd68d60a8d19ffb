"""GLB scenes, ours and those of others."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from box_scenes import scene_of, shell, thing

from eagor.errors import WorldError
from eagor.lab.worlds.glb import FOOTING, FOOTING_NODE, ON_MESH, export_glb, footing_of, import_glb, name_from_nodes
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.scene import Lamp, Material, Room


def furnished():
    """A room with things of several materials, textures, a lamp, and texture seams."""
    rng = np.random.default_rng(3)
    materials = (
        Material("oak", (0.8, 0.61, 0.37), rng.integers(0, 256, size=(8, 16, 3), dtype=np.uint8)),
        Material("shade", (1.0, 0.93, 0.8), None, 1.7),
        Material("screen", (0.01, 0.02, 0.3), rng.integers(0, 256, size=(4, 4, 3), dtype=np.uint8), 0.4),
        Material("plain"),
        Material("oak", (0.3, 0.3, 0.3)),  # two of one name
    )
    things = [
        *shell(5.0, 4.0, "living room 1"),
        thing("coffee table", (1, 1, 0.4), (2, 1.6, 0.45), "living room 1", "brown"),
        thing("chair", (3, 1, 0), (3.4, 1.4, 0.9), "living room 1", "red"),
        thing("chair", (3, 2.5, 0), (3.4, 2.9, 0.9), "living room 1"),
        thing("tv", (0.02, 1.5, 0.9), (0.1, 2.5, 1.5), "living room 1", "black"),
    ]
    plain = scene_of(
        things,
        [Room("living room 1", "living room", np.array([[0, 0, 5, 4.0]]))],
        materials,
        lamps=(Lamp(np.array([2.5, 2, 2.3]), np.array([1, 0.9, 0.7])),),
        daylight=(0.9, 1.0, 1.1),
        source="apartment 1 seed 17",
        facts={"family": "corridor"},
    )
    look = rng.integers(0, 5, size=len(plain.triangles)).astype(np.int32)
    uv = rng.uniform(-2, 9, size=(len(look), 3, 2)).astype(np.float32)
    return replace(plain, material=look, uv=uv)


def canonical(scene):
    """Everything of the triangles, in an order that does not depend on that of the file."""
    order = np.lexsort((scene.material, scene.instance))
    corners = scene.vertices[scene.triangles][order]
    return corners, scene.uv[order], scene.instance[order], scene.material[order]


# --- GLB: ours ---


def test_a_scene_comes_back_from_its_export(tmp_path):
    scene = furnished()
    path = export_glb(scene, tmp_path / "room.glb")
    back = import_glb(path)
    for ours, theirs in zip(canonical(scene), canonical(back), strict=True):
        assert np.allclose(ours, theirs, atol=2e-6)
    assert np.array_equal(canonical(scene)[0], canonical(back)[0])
    for ours, theirs in zip(scene.instances, back.instances, strict=True):
        assert (ours.category, ours.colour, ours.room) == (theirs.category, theirs.colour, theirs.room)
        assert np.array_equal(ours.low, theirs.low)
        assert np.array_equal(ours.high, theirs.high)
    for ours, theirs in zip(scene.materials, back.materials, strict=True):
        assert (ours.name, ours.colour, ours.emission) == (theirs.name, theirs.colour, theirs.emission)
        assert (ours.texture is None) == (theirs.texture is None)
        assert ours.texture is None or np.array_equal(ours.texture, theirs.texture)
    assert back.rooms[0].name == "living room 1"
    assert np.array_equal(back.rooms[0].rectangles, scene.rooms[0].rectangles)
    assert np.array_equal(back.lamps[0].position, scene.lamps[0].position)
    assert back.daylight == scene.daylight
    assert back.facts == {"family": "corridor", "exported hash": scene.hash}
    assert back.source == "glb room.glb"
    assert np.array_equal(Ground.from_scene(back).free, Ground.from_scene(scene).free)


@pytest.mark.parametrize("deep", [0.0, 0.1, 0.19, 0.2, 1.07])
def test_voxels_of_habitat_lab_end_a_centimetre_above_the_floor(deep):
    """However deep the scene goes: Recast counts from its lowest corner, and puts the mesh on top of a voxel."""
    floor = np.array([[[0, 0, 0], [4, 0, 0], [4, 4, 0]], [[0, 0, 0], [4, 4, 0], [0, 4, 0]]], dtype=float) + 0.3
    cellar = np.array([[[1, 1, 0.3 - deep], [2, 1, 0.3 - deep], [2, 2, 0.3 - deep]]])
    found = footing_of(np.concatenate([floor, cellar]), 0.3)
    lowest = found[:, 2].max()
    assert found[:, 2].min() == lowest <= 0.3 - deep
    top = lowest + 0.2 * math.ceil(round((0.3 - lowest) / 0.2, 9))
    assert top == pytest.approx(0.3 + ON_MESH)
    assert lowest + 0.2 * math.ceil((0.3 + 0.008 - lowest) / 0.2) == pytest.approx(top), "a rug"
    assert np.cross(*(found[1:] - found[:1]))[2] < 0, "seen from above it is not there"
    assert ((found[:, :2] > 0.3) & (found[:, :2] < 4.3)).all(), "below the floor"


def test_others_find_named_nodes_with_y_up_beside_a_stage_and_the_settings_of_the_navmesh(tmp_path):
    scene = furnished()
    path = export_glb(scene, tmp_path / "room.glb", radius=0.2)
    model = trimesh.load_scene(path)
    nodes = set(model.graph.nodes_geometry)
    assert {node.split("_m")[0] for node in nodes} >= {"coffee_table_5", "chair_6", "chair_7", "tv_8", "wall_1"}
    low, high = model.bounds
    ours_low, ours_high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    assert np.allclose(low, [ours_low[0], -FOOTING, -ours_high[1]], atol=1e-6)
    assert np.allclose(high, [ours_high[0], ours_high[2], -ours_low[1]], atol=1e-6)
    blob = path.read_bytes()
    entries = json.loads(blob[20 : 20 + int.from_bytes(blob[12:16], "little")])["materials"]
    emissive = [entry["emissiveFactor"] for entry in entries if "emissiveFactor" in entry]
    assert len(emissive) == 2
    assert np.max(emissive) <= 1  # as glTF demands; what shines brighter says so in an extension
    stage = json.loads(path.with_suffix(".stage_config.json").read_text())
    assert (stage["render_asset"], stage["up"], stage["front"]) == ("room.glb", [0, 1, 0], [0, 0, -1])
    assert stage["shader_type"] == "flat"
    navmesh = json.loads(path.with_suffix(".navmesh.json").read_text())
    assert (navmesh["agent_radius"], navmesh["agent_height"]) == (0.2, 1.5)
    assert navmesh["cell_size"] == pytest.approx(0.05, rel=1e-5)
    semantic = json.loads(path.with_suffix(".semantic.json").read_text())
    assert semantic["scene_hash"] == scene.hash
    assert semantic["source"] == "apartment 1 seed 17"
    assert FOOTING_NODE in nodes


def test_a_changed_file_is_no_longer_the_exported_scene(tmp_path):
    path = export_glb(furnished(), tmp_path / "room.glb")
    other = export_glb(scene_of(shell(3, 3)), tmp_path / "other.glb")
    path.write_bytes(other.read_bytes())
    with pytest.raises(WorldError, match="not the one that was exported with it"):
        import_glb(path)
    path = export_glb(furnished(), tmp_path / "room.glb")
    companion = path.with_suffix(".semantic.json")
    for text in ("{", "[]", "{}", companion.read_text().replace("eagor semantic 1", "eagor semantic 99")):
        companion.write_text(text)
        with pytest.raises(WorldError, match="room"):
            import_glb(path)


# --- GLB: those of others ---


def foreign(tmp_path):
    """A room with Y up, its floor 1.3 above the origin, made with trimesh alone."""
    model = trimesh.Scene()

    def add(mesh, name, centre, parent=None, geometry=None):
        transform = np.eye(4)
        transform[:3, 3] = centre
        model.add_geometry(mesh, node_name=name, geom_name=geometry, transform=transform, parent_node_name=parent)

    add(trimesh.creation.box((6, 0.2, 4)), "Floor", (0, 1.2, 0))
    for k, (x, z) in enumerate([(0, 2), (0, -2), (3, 0), (-3, 0)]):
        add(trimesh.creation.box((0.1, 2.6, 4) if x else (6, 2.6, 0.1)), f"Wall_North.00{k}", (x, 2.5, z))
    pbr = trimesh.visual.material.PBRMaterial(name="velvet", baseColorFactor=[0.5, 0.02, 0.01, 1.0])
    chair = trimesh.creation.box((0.4, 0.8, 0.4))
    chair.visual = trimesh.visual.TextureVisuals(uv=None, material=pbr)
    add(chair, "SM_ArmChair_03", (2, 1.7, 1))
    painted = trimesh.creation.icosphere(radius=0.2)
    painted.visual.vertex_colors = [0, 255, 0, 255]
    mirror = np.diag([-1.0, 1, 1, 1])
    mirror[:3, 3] = (-2, 1.5, 1)
    model.graph.update("RedCouch", "world", matrix=mirror)
    model.add_geometry(painted, node_name="mesh_7", geom_name="mesh_7", parent_node_name="RedCouch")
    model.add_geometry(trimesh.load_path([[[0, 0, 0], [1, 1, 1]]]), node_name="line", geom_name="line")
    path = tmp_path / "foreign.glb"
    path.write_bytes(trimesh.exchange.gltf.export_glb(model))
    return path


def test_a_glb_of_others_becomes_a_scene(tmp_path):
    scene = import_glb(foreign(tmp_path))
    names = [(each.category, each.colour) for each in scene.instances]
    assert sorted(map(str, names)) == sorted(
        map(str, [("floor", None), *[("wall", None)] * 4, ("arm chair", None), ("sofa", "red")])
    )
    chair = next(each for each in scene.instances if each.category == "arm chair")
    assert np.allclose(chair.centre, [2, -1, 1.7])  # Y up at (2, 1.7, 1)
    assert scene.vertices[:, 2].min() == pytest.approx(1.1)
    velvet = next(material for material in scene.materials if material.name == "velvet")
    assert velvet.colour == pytest.approx((0.735, 0.151, 0.1), abs=0.02)
    assert (scene.uv[scene.instance == scene.instances.index(chair)] == 0).all()
    # Outward normals stay outward, also in the mirrored node.
    ball = next(index for index, each in enumerate(scene.instances) if each.category == "sofa")
    corners = scene.vertices[scene.triangles[scene.instance == ball]].astype(np.float64)
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((corners.mean(axis=1) - scene.instances[ball].centre) * outward).sum(axis=1).min() > 0
    assert np.allclose(scene.instances[ball].centre, [-2, -1, 1.5], atol=1e-6)
    ground = Ground.from_scene(scene)
    assert ground.floor == pytest.approx(1.3)
    assert ground.is_free([0.0, 0.0])
    assert not ground.is_free([2.0, -1.0])
    assert ground.footprint(chair).distance([0.0, -1.0]) == pytest.approx(1.8, abs=0.03)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["CoffeeTable_01"], ("coffee table", None)),
        (["gray couch.003"], ("sofa", "grey")),
        (["Walls"], ("wall", None)),
        (["mesh_3", "Node 12", "dining_table_b"], ("table", None)),
        (["Object_4", "17", ""], ("object", None)),
        (["black"], ("black", None)),
        (["floor_lamp_left"], ("lamp", None)),
        (["glass"], ("glass", None)),
    ],
)
def test_names_of_nodes(names, said):
    assert name_from_nodes(names) == said


def test_what_is_no_glb_is_refused_by_name(tmp_path):
    good = export_glb(scene_of(shell(3, 3)), tmp_path / "good.glb").read_bytes()
    cloud = trimesh.Scene(trimesh.load_path([[[0, 0, 0], [1, 1, 1]]])).export(file_type="glb")
    outside = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 7]], process=False, validate=False)
    bad = tmp_path / "bad.glb"
    for content, reason in (
        (b"", "empty"),
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        (good[:900], "complete"),
        (good[:300] + b"\x00" * 50 + good[350:], "complete"),
        (cloud, "no triangles"),
        (trimesh.exchange.gltf.export_glb(trimesh.Scene(outside), include_normals=False), "corrupt"),
    ):
        bad.write_bytes(content)
        with pytest.raises(WorldError, match=reason):
            import_glb(bad)
    with pytest.raises(WorldError, match=r"nowhere\.glb cannot be read"):
        import_glb(tmp_path / "nowhere.glb")
