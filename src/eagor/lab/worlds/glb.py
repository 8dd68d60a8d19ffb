"""Scenes as GLB (binary glTF 2.0): import of any, export of ours.

glTF has Y up: our (x, y, z) is its (x, z, -y), see `eagor.conventions.to_gltf`. Beside `<name>.glb` an export writes

- `<name>.semantic.json`: the instances of the triangles, and everything else that does not fit into GLB;
- `<name>.stage_config.json`: for Habitat, which assumes Z up for any bare GLB;
- `<name>.navmesh.json`: Habitat's NavMeshSettings for the same body as `eagor.lab.worlds.ground`.

habitat-lab makes its own mesh of a scene, with voxels of 0.05 m that are 0.2 m high. Recast, which does it, counts them
from the lowest corner of the scene, and puts the mesh on top of the voxel that a floor is in: a scene that begins at
its floor has its mesh 0.2 m above it, which habitat-lab counts as distance. Exported scenes begin `FOOTING` below their
floor: there the mesh is `ON_MESH` above it.

Textures in KTX2 and geometry in Draco are not supported: they are imported as plain colour, or not at all.
"""

from __future__ import annotations

import hashlib
import io
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from eagor._checks import parsed, shown
from eagor._extras import need
from eagor._files import written
from eagor._srgb import to_coded, to_linear
from eagor.conventions import from_gltf, to_gltf
from eagor.errors import WorldError
from eagor.lab.worlds.ground import floor_height, level_triangles
from eagor.lab.worlds.scene import Instance, Lamp, Material, Room, Scene
from eagor.queries import COLOURS, SYNONYMS, singular
from eagor.sources.panorama import FORMATS, decoded_bytes

__all__ = ["export_glb", "import_glb"]

FORMAT: Literal["eagor semantic 1"] = "eagor semantic 1"
LAB_VOXEL = 0.2  # metres: the height of habitat-lab's voxels
ON_MESH = 0.01  # metres of habitat-lab's mesh above the floor of an exported scene: rugs are in the same voxel
FOOTING = LAB_VOXEL - ON_MESH  # metres below the floor at which an exported scene begins ...
FOOTING_NODE = "eagor_footing"  # ... with this node, which is no thing
LEVEL = 0.05  # metres: triangles this close to the height of the floor are part of it
SHRUNK = 0.5  # side of the footing in those of the triangle above it: no corner of it shows at the edge of the floor
# What a stage configuration says of a scene of ours: a GLB has Y up, which Habitat does not assume.
STAGE = {
    "up": [0, 1, 0], "front": [0, 0, -1], "units_to_meters": 1.0, "is_collidable": True, "shader_type": "flat",
}  # fmt: skip

# Words of node names without meaning: of modelling programs, and of places.
_EMPTY_WORDS = {
    "mesh", "node", "object", "obj", "geometry", "geom", "primitive", "default", "group", "root", "scene", "world",
    "model", "material", "instance", "sm", "lod", "polysurface", "gltf", "armature", "collection", "untitled", "north",
    "south", "east", "west", "left", "right", "front", "back", "upper", "lower", "top", "bottom", "inner", "outer",
    "interior", "exterior",
}  # fmt: skip
_DARK = 0.02  # linear: a darker colour cannot carry the light of a lamp
# A few kilobytes can ask for anything: nodes that share a mesh, accessors without data, blank textures. So the size of
# the result is computed before memory is allocated.
_FREE_ENTRIES = 2_000_000  # corners, indices and similar entries allowed for any file, and for larger files ...
_ENTRIES_PER_BYTE = 1  # ... three times the need of a file without shared parts
_FREE_BYTES = 1 << 27  # decoded bytes of pictures allowed for any file, and for larger files ...
_BYTES_PER_BYTE = 600  # ... this per byte of the file
_DEEPEST = 256  # nesting of nodes


def name_from_nodes(names: Iterable[str]) -> tuple[str, str | None]:
    """Category and colour in the first meaningful name ("RedChair.001": a red chair; default "object")."""
    for name in names:
        apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
        words = [word for word in re.findall(r"[a-z]+", apart.lower()) if len(word) > 1 and word not in _EMPTY_WORDS]
        first = SYNONYMS.get(words[0], words[0]) if words else None  # "gray" is "grey"
        colour = first if len(words) > 1 and first in COLOURS else None
        if words:
            return singular(" ".join(words[1:] if colour else words)), colour
    return "object", None


def voxel_for(radius: float, cell: float) -> float:
    """The size (metres) of voxels of about `cell` of which a whole number makes up the radius of a body.

    Recast, which makes the meshes, rounds the radius up to whole voxels: with 0.05 m it keeps a body of 0.18 m off the
    walls by 0.20 m.
    """
    return round(radius / max(1, round(radius / cell)) * (1 + 1e-6), 9) if radius > 0 else cell


def footing_of(corners: np.ndarray, floor: float) -> np.ndarray:
    """A triangle ``(3, 3)`` that puts habitat-lab's mesh `ON_MESH` above the floor: metres, z up, facing down.

    `corners` ``(n, 3, 3)``: the triangles of the scene, of which those at the height `floor` are its floor. It lies
    below the largest of them, out of sight, and a whole number of voxels lower if the scene goes deeper.
    """
    z = corners[..., 2]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    largest = corners[np.where(np.abs(z - floor).max(axis=1) < LEVEL, np.abs(normals[:, 2]), -1.0).argmax()]
    voxels = max(0, math.ceil((floor - FOOTING - float(z.min())) / LAB_VOXEL))
    found = largest[::-1] if np.cross(*(largest[1:] - largest[:1]))[2] > 0 else largest.copy()
    found = found.mean(axis=0) + SHRUNK * (found - found.mean(axis=0))
    found[:, 2] = floor - FOOTING - voxels * LAB_VOXEL
    return found


# --- export -----------------------------------------------------------------------------------------------------------


def export_glb(scene: Scene, target: Path | str, *, radius: float = 0.18) -> Path:
    """Write a scene to the file `target` (.glb), and its companions beside it; returns the path of the GLB.

    Each material of each instance is a node, `<category>_<id>_m<material>`; lights are in the JSON alone.
    `<name>.navmesh.json` is for a body of this `radius` (metres) that is as high and climbs as `Ground.from_scene`
    takes it for; its voxels are of about the size of a cell there and fit the radius. Existing files are overwritten.
    Raises `StorageError` if a file cannot be written.
    """
    target = Path(target)
    blob = _blob(scene)
    written(target, blob)
    navmesh = {
        "cell_size": voxel_for(radius, 0.05), "cell_height": 0.05, "agent_height": 1.5, "agent_radius": radius,
        "agent_max_climb": 0.12, "agent_max_slope": 45.0,
    }  # fmt: skip
    semantic = Semantics(
        FORMAT, hashlib.sha256(blob).hexdigest(), scene.hash, scene.source, [*scene.instances], [*scene.rooms],
        [*scene.lamps], [replace(each, texture=None) for each in scene.materials], scene.daylight, scene.facts,
    )  # fmt: skip
    stage = {"render_asset": target.name, "collision_asset": target.name, **STAGE}
    for kind, content in (("semantic", semantic), ("stage_config", stage), ("navmesh", navmesh)):
        text = msgspec.json.format(
            msgspec.json.encode(content, enc_hook=lambda value: value.tolist()), indent=1
        ).decode()
        written(target.with_suffix(f".{kind}.json"), text + "\n")
    return target


def _blob(scene: Scene) -> bytes:
    """A scene as the content of a GLB."""
    need("a GLB file", "sim", "trimesh")
    import trimesh
    from PIL import Image
    from trimesh.exchange.gltf import export_glb as to_bytes
    from trimesh.visual.material import PBRMaterial
    from trimesh.visual.texture import TextureVisuals

    looks = []
    for index, look in enumerate(scene.materials):
        image = None if look.texture is None else Image.fromarray(np.ascontiguousarray(look.texture[..., :3]))
        linear = to_linear(np.asarray(look.colour, dtype=np.float64))
        light = np.minimum(linear * look.emission, 1.0) if look.emission > 0 else None
        looks.append(
            PBRMaterial(
                name=f"{index} {look.name}", baseColorFactor=[*linear, 1.0], baseColorTexture=image, metallicFactor=0.0,
                roughnessFactor=1.0, doubleSided=True, emissiveFactor=light,
            )
        )  # fmt: skip
    model = trimesh.Scene()
    for owner, look in np.unique(np.stack([scene.instance, scene.material], axis=1), axis=0).tolist():
        chosen = (scene.instance == owner) & (scene.material == look)
        corners = [scene.vertices[scene.triangles[chosen]].reshape(-1, 3), scene.uv[chosen].reshape(-1, 2)]
        # One vertex for each pair of position and texture coordinates.
        distinct, index = np.unique(np.column_stack(corners).astype(np.float32), axis=0, return_inverse=True)
        visual = TextureVisuals(uv=distinct[:, 3:], material=looks[look])
        mesh = trimesh.Trimesh(to_gltf(distinct[:, :3]), index.reshape(-1, 3), visual=visual, process=False)
        name = re.sub(r"\W+", "_", scene.instances[owner].category) + f"_{owner}_m{look}"
        model.add_geometry(mesh, node_name=name, geom_name=name)
    corners = scene.vertices[scene.triangles].astype(np.float64)
    level = level_triangles(corners)
    if level[0].any():
        mesh = trimesh.Trimesh(to_gltf(footing_of(corners, floor_height(corners, *level))), [[0, 1, 2]], process=False)
        model.add_geometry(mesh, node_name=FOOTING_NODE, geom_name=FOOTING_NODE)
    return to_bytes(model, include_normals=False)


# --- import -----------------------------------------------------------------------------------------------------------


def import_glb(path: Path | str) -> Scene:
    """The scene in a GLB (or .gltf) file, converted from Y up to z up; its position is kept.

    With the semantic JSON of `export_glb` beside it, instances, rooms, lamps and materials are restored exactly;
    `facts["exported hash"]` is the hash of the exported scene. Without it every node with triangles is an instance; its
    category and colour (if any) come from the words of its name or of a parent's. Normals, vertex colours and all
    textures except the base colour's are ignored. Missing texture coordinates become (0, 0), missing materials white.

    Raises `WorldError` if the file is missing, empty, corrupt or without triangles, or is not that of the JSON.
    """
    path = Path(path)
    blob = _read(path)
    need("a GLB file", "sim", "trimesh")
    try:
        scene, nodes = _load(path, blob)
    except Exception as error:  # trimesh may raise anything
        if isinstance(error, WorldError):
            raise WorldError(f"{path}: {error}") from error
        raise WorldError(
            f"{path} cannot be read as glTF 2.0 ({type(error).__name__}: {str(error)[:300]}); is it complete? "
            "Export it again"
        ) from error
    companion = path.with_suffix(".semantic.json")
    if not companion.is_file():
        return scene
    try:
        known = read_semantics(companion.read_bytes())
        if known.glb_sha256 != hashlib.sha256(blob).hexdigest():
            raise WorldError("the GLB is not the one that was exported with it")
        owners = [int(re.findall(r"_(\d+)(?:_m\d+)?$", node)[0]) for node in nodes]
        places = [int(look.name.partition(" ")[0]) for look in scene.materials]
        textures = {place: look.texture for place, look in zip(places, scene.materials, strict=True)}
        return replace(
            scene, instance=np.array(owners, dtype=np.int32)[scene.instance], instances=tuple(known.instances),
            material=np.array(places, dtype=np.int32)[scene.material], rooms=tuple(known.rooms),
            materials=tuple(replace(each, texture=textures.get(k)) for k, each in enumerate(known.materials)),
            lamps=tuple(known.lamps), daylight=known.daylight,
            facts=known.facts | {"exported hash": known.scene_hash},
        )  # fmt: skip
    except (WorldError, ValueError, IndexError, OverflowError) as error:
        raise WorldError(
            f"{companion} cannot be used ({str(error)[:300]}); wanted what export_glb writes; export again, or "
            "remove it to import the GLB by itself"
        ) from error


def _read(path: Path) -> bytes:
    try:
        blob = path.read_bytes()
    except OSError as error:
        raise WorldError(f"{path} cannot be read: {error.strerror}; wanted a GLB file") from error
    if not blob:
        raise WorldError(f"{path} is empty; wanted a GLB file. Was the download or the export cut off?")
    if path.suffix.lower() != ".gltf" and not blob.startswith(b"glTF"):
        lfs = blob.startswith(b"version https://git-lfs")
        pointer = " This is a Git LFS pointer: run `git lfs pull`." if lfs else ""
        raise WorldError(f"{path} starts with {blob[:8]!r}, wanted a GLB file, which starts with b'glTF'.{pointer}")
    return blob


def _load(path: Path, blob: bytes) -> tuple[Scene, list[str]]:
    """The scene in a file with an instance for each node with triangles, and their names. Raises what it likes."""
    import trimesh

    text = path.suffix.lower() == ".gltf"
    tree = parsed(blob if text else blob[20 : 20 + int.from_bytes(blob[12:16], "little")])
    beside = [str(part.get("uri", "")) for kind in ("buffers", "images") for part in tree.get(kind, [])]
    files = {path.parent / name for name in beside if name and len(name) < 256 and not name.startswith("data:")}
    size = len(blob) + sum(file.stat().st_size for file in files if file.is_file())
    _check_tree(tree, size)
    model = trimesh.load_scene(path) if text else trimesh.load_scene(io.BytesIO(blob), file_type="glb")
    looks = [getattr(getattr(mesh, "visual", None), "material", None) for mesh in model.geometry.values()]
    _check_pictures((getattr(look, "baseColorTexture", None) for look in looks), size)
    nodes, things, materials, known, pixels = [], [], [], {}, {}
    columns: list[tuple[np.ndarray, ...]] = []
    start = 0
    for mesh in model.dump():  # with the transforms of their nodes
        node, geometry = mesh.metadata["node"], mesh.metadata["name"]
        if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0 or node == FOOTING_NODE:
            continue
        pbr = getattr(model.geometry[geometry].visual, "material", None)
        if id(pbr) not in known:
            known[id(pbr)] = len(materials)
            materials.append(from_pbr(pbr, pixels))
        vertices = from_gltf(np.asarray(mesh.vertices, dtype=np.float64)).astype(np.float32)
        triangles = np.asarray(mesh.faces, dtype=np.int64)
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise WorldError(f"triangles of node {node!r} point outside its {len(vertices)} vertices; it is corrupt")
        uv = getattr(mesh.visual, "uv", None)
        uv = np.zeros((len(vertices), 2)) if uv is None or np.shape(uv) != (len(vertices), 2) else np.asarray(uv)
        names = (*model.graph.transforms.shortest_path(model.graph.base_frame, node)[:0:-1], str(geometry))
        corners = vertices[triangles].reshape(-1, 3)
        things.append(Instance(*name_from_nodes(names), None, corners.min(axis=0), corners.max(axis=0)))
        whose = np.broadcast_to([[len(nodes)], [known[id(pbr)]]], (2, len(triangles)))
        columns.append((vertices, triangles + start, *whose, uv[triangles]))
        nodes.append(node)
        start += len(vertices)
    if not columns:
        raise WorldError("it holds no triangles; wanted a GLB with at least one mesh")
    kinds = (np.float32, np.int32, np.int32, np.int32, np.float32)
    vertices, triangles, instance, material, uv = (
        np.concatenate(part).astype(kind) for part, kind in zip(zip(*columns, strict=True), kinds, strict=True)
    )
    source = f"glb {path.name}"
    return Scene(vertices, triangles, instance, material, uv, tuple(things), tuple(materials), source=source), nodes


def from_pbr(pbr: Any, pixels: dict[int, np.ndarray]) -> Material:
    """trimesh's material (or None) as ours; `pixels` caches decoded pictures by identity."""
    if pbr is None:
        return Material("default")
    factor, image = getattr(pbr, "baseColorFactor", None), getattr(pbr, "baseColorTexture", None)
    linear = np.ones(3) if factor is None else np.asarray(factor, dtype=np.float64)[:3] / 255
    if image is not None and id(image) not in pixels:
        pixels[id(image)] = np.asarray(image.convert("RGB"))
    light = getattr(pbr, "emissiveFactor", None)
    light = np.zeros(3) if light is None else np.asarray(light, dtype=np.float64)
    emission = brightest = float(light.max())
    if brightest > 0 and linear.max() < _DARK:  # a lamp of black material: its light is its colour
        linear = light / brightest
    elif brightest > 0:
        emission = brightest / float(linear.max())
    red, green, blue = to_coded(np.clip(linear, 0, 1)).tolist()
    name = str(getattr(pbr, "name", None) or "material")
    return Material(name, (red, green, blue), None if image is None else pixels[id(image)], emission)


def _check_tree(tree: Any, size: int) -> None:
    """Raise `WorldError` if the JSON of a file of `size` bytes in total asks for too much."""
    counts = [int(entry["count"]) for entry in tree.get("accessors", [])]
    nodes, meshes = tree.get("nodes", []), []
    for mesh in tree.get("meshes", []):
        used = [(part["attributes"].get("POSITION"), part.get("indices")) for part in mesh["primitives"]]
        meshes.append(sum(counts[index] for pair in used for index in pair if index is not None))
    asked = sum(counts) + sum(meshes[node["mesh"]] for node in nodes if "mesh" in node)
    most = max(_FREE_ENTRIES, _ENTRIES_PER_BYTE * size)
    if min(counts, default=0) < 0 or asked > most:
        raise WorldError(f"its nodes ask for {asked} corners and indices, in {size} bytes; wanted at most {most}")
    below = set(range(len(nodes)))
    for _ in range(_DEEPEST):
        below = {child for index in below for child in nodes[index].get("children", [])}
    if below:
        raise WorldError(f"its nodes are nested more than {_DEEPEST} deep, or in a cycle; export it again")


def _check_pictures(pictures: Iterable[Any], size: int) -> None:
    """Raise `WorldError` for pictures of unusual formats, or too large for a file of `size` bytes."""
    distinct = {id(picture): picture for picture in pictures if picture is not None}.values()
    for picture in distinct:
        if picture.format not in (*FORMATS, "MPO"):  # MPO: a JPEG with more in it
            raise WorldError(f"it has a texture in the format {picture.format}; wanted PNG, JPEG or WebP")
    asked, most = sum(map(decoded_bytes, distinct)), max(_FREE_BYTES, _BYTES_PER_BYTE * size)
    if asked > most:
        raise WorldError(f"its textures have {asked} bytes when decoded; wanted at most {most}")


# --- the semantic JSON ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Semantics:
    """What a semantic JSON says of a scene; the first two and the instances' names and bounds suffice by hand."""

    format: Literal["eagor semantic 1"]
    glb_sha256: str = ""
    scene_hash: str = ""
    source: str = ""
    instances: list[Instance] = field(default_factory=list)
    rooms: list[Room] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    materials: list[Material] = field(default_factory=list)
    daylight: tuple[float, float, float] = (1.0, 1.0, 1.0)
    facts: dict[str, Any] = field(default_factory=dict)


def read_semantics(text: bytes) -> Semantics:
    """The content of a semantic JSON. Raises `ValueError`, msgspec's errors among them."""
    tree = parsed(text)
    if isinstance(tree, dict) and isinstance(tree.get("instances"), list):
        bare = {"colour": None, "room": None}
        tree["instances"] = [bare | each if isinstance(each, dict) else each for each in tree["instances"]]
    known = msgspec.convert(tree, Semantics, dec_hook=_array)
    triples = [a for thing in known.instances for a in (thing.low, thing.high)]
    triples += [a for lamp in known.lamps for a in (lamp.position, lamp.power)]
    if any(a.shape != (3,) for a in triples) or any(r.rectangles.shape[1:] != (4,) for r in known.rooms):
        raise ValueError("a corner, a lamp or a room without its three or four numbers")
    for thing in known.instances:
        if (thing.low > thing.high).any():
            raise ValueError(f"a box from {thing.low.tolist()} to {thing.high.tolist()}")
        if thing.colour is not None and thing.colour not in COLOURS:
            raise ValueError(f"the colour {shown(thing.colour)}, which is none of {', '.join(COLOURS)}")
    return known


def _array(_: type, value: Any) -> np.ndarray:
    array = np.array(value, dtype=np.float64)
    if not (np.abs(array) <= 1e9).all():
        raise ValueError("a number that is not finite, or above 1e9")
    return array
