"""Import and export of scenes as GLB (binary glTF 2.0), to exchange them with other simulators and viewers.

glTF has Y up: our (x, y, z) is its (x, z, -y), see `eagor.conventions.to_gltf`. Beside `<name>.glb` an export writes

- `<name>.semantic.json`: the instances of the triangles, and everything else that does not fit into GLB;
- `<name>.stage_config.json`: for Habitat, which assumes Z up for any bare GLB;
- `<name>.navmesh.json`: Habitat's NavMeshSettings for the same body as `eagor.worlds.ground`;
- if `annotated`, the ids of all instances for Habitat, as in HM3D: see `eagor.worlds.semantic_glb`.

Textures in KTX2 and geometry in Draco are not supported: they are imported as plain colour, or not at all.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from eagor._extras import need
from eagor._files import written
from eagor.conventions import to_gltf
from eagor.worlds.glb_reader import import_glb
from eagor.worlds.gltf import FOOTING, FORMAT, material_name, node_name, split_at_seams, to_pbr, write_exactly
from eagor.worlds.habitat_mesh import footing_of, voxel_for
from eagor.worlds.occupancy import floor_height, level_triangles
from eagor.worlds.scene import Scene
from eagor.worlds.semantic_glb import FIRST_ID, semantic_glb, semantic_text

__all__ = ["export_glb", "import_glb"]

FRAME = (
    "metres, z up, floor along x and y: low, high, rectangles, positions. A point (x, y, z) here is (x, z, -y) in the "
    "GLB, which has Y up"
)


def export_glb(
    scene: Scene, target: Path | str, *,
    cell: float = 0.05, radius: float = 0.18, height: float = 1.5, climb: float = 0.12, annotated: bool = False,
) -> Path:  # fmt: skip
    """Write a scene and its companions; returns the path of the GLB.

    `target`: a file name that ends in .glb, or a folder, in which the file is named after `scene.source`. Each material
    of each instance is a node, `<category>_<id>`, or `<category>_<id>_m<material>` if the instance has several.
    `cell`, `radius`, `height` and `climb` (metres, as in `Ground.from_scene`) go into `<name>.navmesh.json`; its voxels
    are of about the size of a cell and fit the radius. Existing files are overwritten. Raises `StorageError` if a file
    cannot be written.
    """
    need("a GLB file", "sim", "trimesh")
    import trimesh
    from trimesh.exchange.gltf import export_glb as to_bytes
    from trimesh.visual.texture import TextureVisuals

    target = Path(target)
    if target.suffix.lower() != ".glb":
        target = target / (re.sub(r"\W+", "_", scene.source).strip("_").lower() + ".glb")
    looks = [to_pbr(index, material) for index, material in enumerate(scene.materials)]
    parts = np.unique(np.stack([scene.instance, scene.material], axis=1), axis=0)
    several = np.bincount(parts[:, 0], minlength=len(scene.instances)) > 1
    model = trimesh.Scene()
    nodes: list[list[str]] = [[] for _ in scene.instances]
    for owner, look in parts.tolist():
        chosen = (scene.instance == owner) & (scene.material == look)
        vertices, triangles, uv = split_at_seams(scene.vertices, scene.triangles[chosen], scene.uv[chosen])
        visual = TextureVisuals(uv=uv, material=looks[look])
        mesh = trimesh.Trimesh(to_gltf(vertices), triangles, visual=visual, process=False)
        name = node_name(scene.instances[owner].category, owner, look if several[owner] else None)
        nodes[owner].append(name)
        model.add_geometry(mesh, node_name=name, geom_name=name)
    corners = scene.vertices[scene.triangles].astype(np.float64)
    level = level_triangles(corners)
    if level[0].any():
        below = footing_of(corners, floor_height(corners, *level))
        mesh = trimesh.Trimesh(to_gltf(below), [[0, 1, 2]], process=False)
        model.add_geometry(mesh, node_name=FOOTING, geom_name=FOOTING)
    blob = to_bytes(model, include_normals=False, tree_postprocessor=lambda tree: write_exactly(tree, scene.materials))
    written(target, blob)
    stage = {
        "render_asset": target.name, "collision_asset": target.name, "up": [0, 1, 0], "front": [0, 0, -1],
        "units_to_meters": 1.0, "is_collidable": True, "shader_type": "flat",
    }  # fmt: skip
    if annotated:
        painted, listed = target.with_suffix(".semantic.glb"), target.with_suffix(".semantic.txt")
        written(painted, semantic_glb(scene))
        written(listed, semantic_text(scene))
        stage |= {
            "semantic_asset": painted.name, "semantic_descriptor_filename": listed.name, "has_semantic_textures": True,
            "nav_asset": target.with_suffix(".navmesh").name,
        }  # fmt: skip
    navmesh = {
        "cell_size": voxel_for(radius, cell), "cell_height": 0.05, "agent_height": height, "agent_radius": radius,
        "agent_max_climb": climb, "agent_max_slope": 45.0,
    }  # fmt: skip
    semantic = {
        "format": FORMAT,
        "frame": FRAME,
        "glb": target.name,
        "glb_sha256": hashlib.sha256(blob).hexdigest(),
        "scene_hash": scene.hash,
        "source": scene.source,
        "instances": [
            {
                "id": index, "category": thing.category, "colour": thing.colour, "room": thing.room,
                "low": _numbers(thing.low), "high": _numbers(thing.high), "nodes": nodes[index],
                **({"semantic_id": index + FIRST_ID} if annotated else {}),
            }
            for index, thing in enumerate(scene.instances)
        ],
        "materials": [
            {
                "gltf": material_name(index, material), "name": material.name,
                "colour": _numbers(material.colour), "emission": float(material.emission),
            }
            for index, material in enumerate(scene.materials)
        ],
        "rooms": [{"name": r.name, "kind": r.kind, "rectangles": _numbers(r.rectangles)} for r in scene.rooms],
        "lamps": [{"position": _numbers(x.position), "power": _numbers(x.power)} for x in scene.lamps],
        "daylight": list(scene.daylight),
        "facts": scene.facts,
    }  # fmt: skip
    for kind, content in (("semantic", semantic), ("stage_config", stage), ("navmesh", navmesh)):
        written(target.with_suffix(f".{kind}.json"), json.dumps(content, indent=1) + "\n")
    return target


def _numbers(values: Sequence[float] | np.ndarray) -> list[float]:
    return np.asarray(values, dtype=np.float64).tolist()
