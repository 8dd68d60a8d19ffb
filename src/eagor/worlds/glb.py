"""Import and export of scenes as GLB (binary glTF 2.0), to exchange them with other simulators and viewers.

glTF has Y up: our (x, y, z) is its (x, z, -y), see `eagor.conventions.to_gltf`. Beside `<name>.glb` an export writes

- `<name>.semantic.json`: the instances of the triangles, and everything else that does not fit into GLB;
- `<name>.stage_config.json`: for Habitat, which assumes Z up for any bare GLB;
- `<name>.navmesh.json`: Habitat's NavMeshSettings for the same body as `eagor.worlds.ground`;
- if `annotated`, the ids of all instances for Habitat, as in HM3D: see `eagor.worlds.habitat_files`.

Textures in KTX2 and geometry in Draco are not supported: they are imported as plain colour, or not at all.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import numpy as np

from eagor._checks import number, parsed, shown
from eagor._extras import need
from eagor._files import written
from eagor._srgb import to_coded, to_linear
from eagor.conventions import from_gltf, to_gltf
from eagor.errors import WorldError
from eagor.media.panorama import FORMATS, decoded_bytes
from eagor.queries import COLOURS, SYNONYMS, singular
from eagor.worlds.ground import floor_height, level_triangles
from eagor.worlds.habitat_files import FIRST_ID, STAGE, footing_of, semantic_glb, semantic_text, voxel_for
from eagor.worlds.scene import Instance, Lamp, Material, Room, Scene

__all__ = ["export_glb", "import_glb"]

FORMAT = "eagor semantic 1"  # of the JSON beside an exported GLB
FOOTING = "eagor_footing"  # the node of an exported GLB that is no thing: see `eagor.worlds.habitat_files`

# Words of node names without meaning: of modelling programs, and of places.
_EMPTY_WORDS = {
    "mesh", "node", "object", "obj", "geometry", "geom", "primitive", "default", "group", "root", "scene", "world",
    "model", "material", "instance", "sm", "lod", "polysurface", "gltf", "armature", "collection", "untitled", "north",
    "south", "east", "west", "left", "right", "front", "back", "upper", "lower", "top", "bottom", "inner", "outer",
    "interior", "exterior",
}  # fmt: skip
_DARK = 0.02  # linear: a darker colour cannot carry the light of a lamp
FRAME = (
    "metres, z up, floor along x and y: low, high, rectangles, positions. A point (x, y, z) here is (x, z, -y) in the "
    "GLB, which has Y up"
)
# A few kilobytes can ask for anything: nodes that share a mesh, accessors without data, blank textures. So the size of
# the result is computed before memory is allocated.
_FREE_ENTRIES = 2_000_000  # corners, indices and similar entries allowed for any file, and for larger files ...
_ENTRIES_PER_BYTE = 1  # ... three times the need of a file without shared parts
_FREE_BYTES = 1 << 27  # decoded bytes of pictures allowed for any file, and for larger files ...
_BYTES_PER_BYTE = 600  # ... this per byte of the file
_DEEPEST = 256  # nesting of nodes


def node_name(category: str, owner: int, material: int | None) -> str:
    """`<category>_<id>`, and `_m<material>` if an instance has several."""
    words = re.sub(r"\W+", "_", category)
    return f"{words}_{owner}" if material is None else f"{words}_{owner}_m{material}"


def name_from_nodes(names: Iterable[str]) -> tuple[str, str | None]:
    """Category and colour in the first meaningful name ("RedChair.001": a red chair; default "object")."""
    for name in names:
        apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
        words = [word for word in re.findall(r"[a-z]+", apart.lower()) if len(word) > 1 and word not in _EMPTY_WORDS]
        first = SYNONYMS.get(words[0], words[0]) if words else None  # "gray" is "grey"
        colour = first if len(words) > 1 and first in COLOURS else None
        words = words[1:] if colour else words
        if words:
            return singular(" ".join(words)), colour
    return "object", None


def material_name(index: int, material: Material) -> str:
    """The name of a material in the file, with its index."""
    return f"{index} {material.name}"


def to_pbr(index: int, material: Material) -> Any:
    """Our material as trimesh's; `write_exactly` adds what trimesh rounds."""
    from PIL import Image
    from trimesh.visual.material import PBRMaterial

    image = None if material.texture is None else Image.fromarray(np.ascontiguousarray(material.texture[..., :3]))
    return PBRMaterial(
        name=material_name(index, material),
        baseColorTexture=image,
        emissiveTexture=image if material.emission > 0 else None,
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=True,
    )


def write_exactly(tree: dict[str, Any], materials: tuple[Material, ...]) -> None:
    """Write colours and emission into the JSON of a glTF as linear numbers, which trimesh rounds to 8 bits."""
    ours = {material_name(index, material): material for index, material in enumerate(materials)}
    for entry in tree.get("materials", []):
        material = ours[entry["name"]]
        linear = to_linear(np.asarray(material.colour, dtype=np.float64))
        entry["pbrMetallicRoughness"]["baseColorFactor"] = [*linear.tolist(), 1.0]
        if material.emission > 0:
            light = linear * material.emission
            strength = max(1.0, float(light.max()))
            entry["emissiveFactor"] = (light / strength).tolist()
            if strength > 1:
                entry["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
                tree["extensionsUsed"] = sorted({*tree.get("extensionsUsed", []), "KHR_materials_emissive_strength"})


def from_pbr(pbr: Any, entries: list[dict[str, Any]], pixels: dict[int, np.ndarray]) -> Material:
    """trimesh's material (or None) as ours, with the JSON `entries`; `pixels` caches decoded pictures by identity."""
    if pbr is None:
        return Material("default")
    name = str(getattr(pbr, "name", None) or "material")
    same = [entry for entry in entries if entry.get("name") == name]
    entry = same[0] if len(same) == 1 else {}
    rounded = getattr(pbr, "baseColorFactor", None)
    linear = np.ones(3) if rounded is None else np.asarray(rounded, dtype=np.float64)[:3] / 255
    linear = np.asarray(entry.get("pbrMetallicRoughness", {}).get("baseColorFactor", linear), dtype=np.float64)[:3]
    image = getattr(pbr, "baseColorTexture", None)
    if image is not None and id(image) not in pixels:
        pixels[id(image)] = np.asarray(image.convert("RGB"))
    texture = None if image is None else pixels[id(image)]
    light = getattr(pbr, "emissiveFactor", None)
    light = np.zeros(3) if light is None else np.asarray(light, dtype=np.float64)
    extension = entry.get("extensions", {}).get("KHR_materials_emissive_strength", {})
    light = light * float(extension.get("emissiveStrength", 1.0))
    emission = 0.0
    if light.max() > 0 and linear.max() < _DARK:  # a lamp of black material: its light is its colour
        linear, emission = light / light.max(), float(light.max())
    elif light.max() > 0:
        emission = float(light.max() / linear.max())
    red, green, blue = to_coded(np.clip(linear, 0, 1)).tolist()
    return Material(name, (red, green, blue), texture, emission)


def split_at_seams(
    vertices: np.ndarray, triangles: np.ndarray, uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles and texture coordinates per vertex: one vertex for each pair of position and coordinates."""
    corners = np.column_stack([vertices[triangles].reshape(-1, 3), uv.reshape(-1, 2)]).astype(np.float32)
    distinct, index = np.unique(corners, axis=0, return_inverse=True)
    return distinct[:, :3], index.reshape(-1, 3), distinct[:, 3:]


def export_glb(scene: Scene, target: Path | str, *, radius: float = 0.18, annotated: bool = False) -> Path:
    """Write a scene and its companions; returns the path of the GLB.

    `target`: a file name that ends in .glb, or a folder, in which the file is named after `scene.source`. Each material
    of each instance is a node, `<category>_<id>`, or `<category>_<id>_m<material>` if the instance has several.
    `<name>.navmesh.json` is for a body of this `radius` (metres) that is as high and climbs as `Ground.from_scene`
    takes it for; its voxels are of about the size of a cell there and fit the radius. Existing files are overwritten.
    Raises `StorageError` if a file cannot be written.
    """
    target = Path(target)
    if target.suffix.lower() != ".glb":
        target = target / (re.sub(r"\W+", "_", scene.source).strip("_").lower() + ".glb")
    blob, nodes = _blob(scene)
    written(target, blob)
    stage: dict[str, Any] = {"render_asset": target.name, "collision_asset": target.name, **STAGE}
    if annotated:
        painted, listed = target.with_suffix(".semantic.glb"), target.with_suffix(".semantic.txt")
        written(painted, semantic_glb(scene))
        written(listed, semantic_text(scene))
        stage |= {
            "semantic_asset": painted.name, "semantic_descriptor_filename": listed.name, "has_semantic_textures": True,
            "nav_asset": target.with_suffix(".navmesh").name,
        }  # fmt: skip
    navmesh = {
        "cell_size": voxel_for(radius, 0.05), "cell_height": 0.05, "agent_height": 1.5, "agent_radius": radius,
        "agent_max_climb": 0.12, "agent_max_slope": 45.0,
    }  # fmt: skip
    identity = {"glb": target.name, "glb_sha256": hashlib.sha256(blob).hexdigest()}
    semantic = {"format": FORMAT, "frame": FRAME} | identity | _companion(scene, nodes, annotated)
    for kind, content in (("semantic", semantic), ("stage_config", stage), ("navmesh", navmesh)):
        written(target.with_suffix(f".{kind}.json"), json.dumps(content, indent=1) + "\n")
    return target


def _blob(scene: Scene) -> tuple[bytes, list[list[str]]]:
    """A scene as the content of a GLB, and the names of the nodes of each instance."""
    need("a GLB file", "sim", "trimesh")
    import trimesh
    from trimesh.exchange.gltf import export_glb as to_bytes
    from trimesh.visual.texture import TextureVisuals

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
    return blob, nodes


def _companion(scene: Scene, nodes: list[list[str]], annotated: bool) -> dict[str, Any]:
    """What does not fit into the GLB, for the semantic JSON: `nodes` of each instance, as `_blob` named them."""
    return {
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


def _numbers(values: Sequence[float] | np.ndarray) -> list[float]:
    return np.asarray(values, dtype=np.float64).tolist()


def import_glb(path: Path | str) -> Scene:
    """The scene in a GLB (or .gltf) file, converted from Y up to z up; its position is kept.

    With the semantic JSON of `export_glb` beside it, instances, rooms, lamps and materials are restored exactly;
    `facts["exported hash"]` is the hash of the exported scene, if the GLB was not changed since. Without it every node
    with triangles is an instance; its category and colour (if any) come from the words of its name or of a parent's.
    Normals, vertex colours and all textures except the base colour's are ignored. Missing texture coordinates become
    (0, 0), missing materials white.

    Raises `WorldError` if the file is missing, empty, corrupt or without triangles, or does not fit the JSON.
    """
    path = Path(path)
    blob = _read(path)
    parts, materials = _load(path, blob)
    companion = path.with_suffix(".semantic.json")
    if companion.is_file():
        try:
            return _annotated(path, parts, materials, parsed(companion.read_bytes()), blob)
        except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
            if isinstance(error, WorldError):
                raise WorldError(f"{companion}: {error}") from error
            raise WorldError(
                f"{companion} cannot be read ({type(error).__name__}: {str(error)[:200]}); wanted what export_glb "
                "writes; export again, or remove it to import the GLB by itself"
            ) from error
    corners = [part.vertices[part.triangles].reshape(-1, 3) for part in parts]
    instances = [
        Instance(*name_from_nodes(part.names), None, where.min(axis=0), where.max(axis=0))
        for part, where in zip(parts, corners, strict=True)
    ]
    looks = np.array([part.material for part in parts])
    return _joined(path, parts, np.arange(len(parts)), looks, instances, materials)


@dataclass(frozen=True, eq=False)
class _Part:
    """The triangles of a node, in our frame. `names`: its own, its parents', and its mesh's."""

    names: tuple[str, ...]
    vertices: np.ndarray
    triangles: np.ndarray
    uv: np.ndarray
    material: int


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


def _load(path: Path, blob: bytes) -> tuple[list[_Part], list[Material]]:
    """The parts of a file, and its materials."""
    need("a GLB file", "sim", "trimesh")
    import trimesh

    try:
        text = path.suffix.lower() == ".gltf"
        tree = parsed(blob if text else blob[20 : 20 + int.from_bytes(blob[12:16], "little")])
        size = _size(path, tree, blob)
        _check_tree(tree, size)
        model = trimesh.load_scene(path) if text else trimesh.load_scene(io.BytesIO(blob), file_type="glb")
        looks = [getattr(getattr(mesh, "visual", None), "material", None) for mesh in model.geometry.values()]
        _check_pictures((getattr(look, "baseColorTexture", None) for look in looks), size)
        entries, pixels = tree.get("materials", []), {}
        parts, materials, known = [], [], {}
        for node in model.graph.nodes_geometry:
            transform, geometry = model.graph[node]
            mesh: Any = model.geometry[geometry]
            if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0 or node == FOOTING:
                continue
            pbr = getattr(mesh.visual, "material", None)
            if id(pbr) not in known:
                known[id(pbr)] = len(materials)
                materials.append(from_pbr(pbr, entries, pixels))
            names = (*_lineage(model, node), str(geometry))
            parts.append(_part(mesh, np.asarray(transform), names, known[id(pbr)]))
    except Exception as error:  # trimesh may raise anything
        if isinstance(error, WorldError):
            raise WorldError(f"{path}: {error}") from error
        raise WorldError(
            f"{path} cannot be read as glTF 2.0 ({type(error).__name__}: {str(error)[:300]}); is it complete? "
            "Export it again"
        ) from error
    if not parts:
        raise WorldError(f"{path} holds no triangles; wanted a GLB with at least one mesh")
    return parts, materials


def _size(path: Path, tree: Any, blob: bytes) -> int:
    """Bytes of the file, including the files beside a .gltf."""
    beside = [str(part.get("uri", "")) for kind in ("buffers", "images") for part in tree.get(kind, [])]
    files = {path.parent / name for name in beside if name and len(name) < 256 and not name.startswith("data:")}
    return len(blob) + sum(file.stat().st_size for file in files if file.is_file())


def _lineage(model: Any, node: str) -> list[str]:
    """The name of a node and those of its parents, without the root's."""
    parents, names = model.graph.transforms.parents, []
    while parents.get(node, node) != node:  # in some versions the root is its own child
        names.append(str(node))
        node = parents[node]
    return names


def _part(mesh: Any, transform: np.ndarray, names: tuple[str, ...], material: int) -> _Part:
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    triangles = np.asarray(mesh.faces, dtype=np.int64)
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise WorldError(
            f"triangles of node {names[0]!r} point outside its {len(vertices)} vertices; the GLB is corrupt"
        )
    if not np.array_equal(transform, np.eye(4)):
        vertices = vertices @ transform[:3, :3].T + transform[:3, 3]
        if np.linalg.det(transform[:3, :3]) < 0:
            triangles = triangles[:, ::-1]
    uv = getattr(mesh.visual, "uv", None)
    uv = np.zeros((len(vertices), 2)) if uv is None or np.shape(uv) != (len(vertices), 2) else np.asarray(uv)
    return _Part(names, from_gltf(vertices).astype(np.float32), triangles, uv[triangles].astype(np.float32), material)


def _annotated(path: Path, parts: list[_Part], materials: list[Material], known: dict[str, Any], blob: bytes) -> Scene:
    """The exported scene, from its parts and the semantic JSON."""
    if known["format"] != FORMAT:
        raise WorldError(f"the semantic JSON of {path.name} has format {shown(known['format'])}; wanted {FORMAT!r}")
    owner = {name: index for index, thing in enumerate(known["instances"]) for name in thing["nodes"]}
    by_name = {part.names[0]: part for part in parts}
    if set(owner) != set(by_name):
        strange = sorted(set(owner) ^ set(by_name))
        raise WorldError(
            f"{path.name} and its semantic JSON do not have the same nodes: {shown(', '.join(strange[:3]), 200)} only "
            "in one of the two; export again, or remove the JSON to import the GLB by itself"
        )
    parts = [by_name[name] for name in owner]
    place = {entry["gltf"]: index for index, entry in enumerate(known["materials"])}
    textures = {material.name: material.texture for material in materials}
    exact = [
        Material(str(entry["name"]), _triple(entry["colour"]), textures.get(entry["gltf"]), number(entry["emission"]))
        for entry in known["materials"]
    ]
    looks = np.array([place[materials[part.material].name] for part in parts])
    instances = [instance_in(entry) for entry in known["instances"]]
    facts = dict(known["facts"])
    if known["glb_sha256"] == hashlib.sha256(blob).hexdigest():
        facts["exported hash"] = known["scene_hash"]
    rooms = tuple(room_in(entry) for entry in known["rooms"])
    lamps = tuple(Lamp(np.array(_triple(x["position"])), np.array(_triple(x["power"]))) for x in known["lamps"])
    more = {"rooms": rooms, "lamps": lamps, "daylight": _triple(known["daylight"]), "facts": facts}
    owners = np.array([owner[part.names[0]] for part in parts])
    return _joined(path, parts, owners, looks, instances, exact, **more)


def _triple(values: Any) -> tuple[float, float, float]:
    a, b, c = (number(value) for value in values)
    return a, b, c


def instance_in(entry: dict[str, Any]) -> Instance:
    """The instance in an entry of a semantic JSON; a malformed entry may raise anything."""
    low, high = np.array(_triple(entry["low"])), np.array(_triple(entry["high"]))
    return Instance(str(entry["category"]), _words(entry.get("colour")), _words(entry.get("room")), low, high)


def room_in(entry: dict[str, Any]) -> Room:
    """The room in an entry of a semantic JSON; a malformed entry may raise anything."""
    sides = [[number(side) for side in rectangle] for rectangle in entry["rectangles"]]
    if any(len(rectangle) != 4 for rectangle in sides):
        raise ValueError(f"the rectangles are {shown(entry['rectangles'])}; wanted [x0, y0, x1, y1] each")
    return Room(str(entry["name"]), str(entry["kind"]), np.array(sides).reshape(-1, 4))


def _words(value: Any) -> str | None:
    if not (value is None or isinstance(value, str)):
        raise ValueError(f"a name is {shown(value)}; wanted text")
    return value


def _joined(
    path: Path, parts: list[_Part], owners: np.ndarray, looks: np.ndarray,
    instances: list[Instance], materials: list[Material], **more: Any,
) -> Scene:  # fmt: skip
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    counts = [len(part.triangles) for part in parts]
    return Scene(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.triangles + start for part, start in zip(parts, starts, strict=False)]).astype(np.int32),
        np.repeat(owners, counts).astype(np.int32), np.repeat(looks, counts).astype(np.int32),
        np.concatenate([part.uv for part in parts]), tuple(instances), tuple(materials), source=f"glb {path.name}",
        **more,
    )  # fmt: skip


def _check_tree(tree: Any, size: int) -> None:
    """Raise `WorldError` if the JSON of a file of `size` bytes in total asks for too much."""
    counts = [int(entry["count"]) for entry in tree.get("accessors", [])]
    meshes = [sum(_corners(part, counts) for part in mesh["primitives"]) for mesh in tree.get("meshes", [])]
    nodes = tree.get("nodes", [])
    asked = sum(counts) + sum(meshes[node["mesh"]] for node in nodes if "mesh" in node)
    most = max(_FREE_ENTRIES, _ENTRIES_PER_BYTE * size)
    if min(counts, default=0) < 0 or asked > most:
        raise WorldError(f"its nodes ask for {asked} corners and indices, in {size} bytes; wanted at most {most}")
    _check_nest(nodes)


def _check_pictures(pictures: Iterable[Any], size: int) -> None:
    """Raise `WorldError` for pictures of unusual formats, or too large for a file of `size` bytes."""
    found = {id(picture): picture for picture in pictures if picture is not None}
    for picture in found.values():
        if picture.format not in (*FORMATS, "MPO"):  # MPO: a JPEG with more in it
            raise WorldError(f"it has a texture in the format {picture.format}; wanted PNG, JPEG or WebP")
    asked, most = sum(decoded_bytes(picture) for picture in found.values()), max(_FREE_BYTES, _BYTES_PER_BYTE * size)
    if asked > most:
        raise WorldError(f"its textures have {asked} bytes when decoded; wanted at most {most}")


def _corners(primitive: Mapping[str, Any], counts: list[int]) -> int:
    used = (primitive["attributes"].get("POSITION"), primitive.get("indices"))
    return sum(counts[index] for index in used if index is not None)


def _check_nest(nodes: list[Any]) -> None:
    children = {index: node.get("children", []) for index, node in enumerate(nodes)}
    height: dict[int, int] = {}  # of the tree below each node, itself included
    try:
        for index in TopologicalSorter(children).static_order():  # children first
            height[index] = 1 + max((height[child] for child in children[index]), default=0)
    except CycleError as error:
        raise WorldError(
            f"{len(error.args[1]) - 1} of its {len(nodes)} nodes are in a cycle; export it again"
        ) from None
    if max(height.values(), default=0) > _DEEPEST:
        raise WorldError(f"its nodes are nested {max(height.values())} deep; wanted at most {_DEEPEST}")
