"""GLB files as scenes; `eagor.worlds.glb` is the way in."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eagor._extras import need
from eagor._json import number, parsed, shown
from eagor.conventions import from_gltf
from eagor.errors import WorldError
from eagor.worlds.gltf import FORMAT, from_pbr, name_from_nodes
from eagor.worlds.panorama import FORMATS, decoded_bytes
from eagor.worlds.scene import Instance, Lamp, Material, Room, Scene

# A few kilobytes can ask for anything: nodes that share a mesh, accessors without data, textures of nothing. What a
# file asks for is counted before room is made for it.
_FREE_ENTRIES = 2_000_000  # corners, indices and the like that any file may ask for, and of larger ones ...
_ENTRIES_PER_BYTE = 1  # ... three times what a file without shared parts needs
_FREE_BYTES = 1 << 27  # that the pictures of any file may have when they are decoded, and of larger ones ...
_BYTES_PER_BYTE = 600  # ... this for each byte of the file
_DEEPEST = 256  # nodes below each other


def import_glb(path: Path | str) -> Scene:
    """The scene in a GLB (or .gltf) file, turned from Y up to z up and otherwise left where it is.

    With the semantic JSON that `export_glb` wrote beside it, instances, rooms, lamps and materials come back exactly;
    `facts["exported hash"]` is the hash of the scene that was exported, if the GLB was not changed since. Without it
    every node with triangles is an instance, with the category (and colour, if it says one) that the words of its name,
    or of a parent's, give. Normals, vertex colours and all textures but the base colour's are ignored; what has no
    texture coordinates gets (0, 0), what has no material is white.

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
    """The triangles of a node, in our frame. `names`: its own, those of its parents, that of its mesh."""

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
            if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
                continue
            pbr = getattr(mesh.visual, "material", None)
            if id(pbr) not in known:
                known[id(pbr)] = len(materials)
                materials.append(from_pbr(pbr, entries, pixels))
            names = (*_lineage(model, node), str(geometry))
            parts.append(_part(mesh, np.asarray(transform), names, known[id(pbr)]))
    except Exception as error:  # trimesh raises whatever its parsing runs into
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
    """Bytes of the file, and of those that a .gltf has beside it."""
    beside = [str(part.get("uri", "")) for kind in ("buffers", "images") for part in tree.get(kind, [])]
    files = {path.parent / name for name in beside if name and len(name) < 256 and not name.startswith("data:")}
    return len(blob) + sum(file.stat().st_size for file in files if file.is_file())


def _lineage(model: Any, node: str) -> list[str]:
    """The name of a node and those of its parents, without the root's."""
    parents, names = model.graph.transforms.parents, []
    while parents.get(node, node) != node:  # some versions have the root below itself
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
    """The scene that was exported, from its parts and the semantic JSON."""
    if known["format"] != FORMAT:
        raise WorldError(f"the semantic JSON of {path.name} has format {shown(known['format'])}; wanted {FORMAT!r}")
    owner = {name: index for index, thing in enumerate(known["instances"]) for name in thing["nodes"]}
    by_name = {part.names[0]: part for part in parts}
    if set(owner) != set(by_name):
        strange = sorted(set(owner) ^ set(by_name))
        raise WorldError(
            f"{path.name} and its semantic JSON do not have the same nodes: {shown(', '.join(strange[:3]), 200)} only "
            "in one of them; export again, or remove the JSON to import the GLB by itself"
        )
    parts = [by_name[name] for name in owner]
    place = {entry["gltf"]: index for index, entry in enumerate(known["materials"])}
    textures = {material.name: material.texture for material in materials}
    exact = [
        Material(str(entry["name"]), _triple(entry["colour"]), textures.get(entry["gltf"]), number(entry["emission"]))
        for entry in known["materials"]
    ]
    looks = np.array([place[materials[part.material].name] for part in parts])
    instances = []
    for thing in known["instances"]:
        low, high = np.array(_triple(thing["low"])), np.array(_triple(thing["high"]))
        instances.append(Instance(str(thing["category"]), _words(thing["colour"]), _words(thing["room"]), low, high))
    facts = dict(known["facts"])
    if known["glb_sha256"] == hashlib.sha256(blob).hexdigest():
        facts["exported hash"] = known["scene_hash"]
    rooms = tuple(Room(str(r["name"]), str(r["kind"]), _rectangles(r["rectangles"])) for r in known["rooms"])
    lamps = tuple(Lamp(np.array(_triple(x["position"])), np.array(_triple(x["power"]))) for x in known["lamps"])
    more = {"rooms": rooms, "lamps": lamps, "daylight": _triple(known["daylight"]), "facts": facts}
    owners = np.array([owner[part.names[0]] for part in parts])
    return _joined(path, parts, owners, looks, instances, exact, **more)


def _triple(values: Any) -> tuple[float, float, float]:
    a, b, c = (number(value) for value in values)
    return a, b, c


def _rectangles(values: Any) -> np.ndarray:
    sides = [[number(side) for side in rectangle] for rectangle in values]
    if any(len(rectangle) != 4 for rectangle in sides):
        raise ValueError(f"{shown(values)} where rectangles [x0, y0, x1, y1] were wanted")
    return np.array(sides).reshape(-1, 4)


def _words(value: Any) -> str | None:
    if not (value is None or isinstance(value, str)):
        raise ValueError(f"{shown(value)} where words were wanted")
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
        np.repeat(owners, counts).astype(np.int32),
        np.repeat(looks, counts).astype(np.int32),
        np.concatenate([part.uv for part in parts]),
        tuple(instances),
        tuple(materials),
        source=f"glb {path.name}",
        **more,
    )


def _check_tree(tree: Any, size: int) -> None:
    """Raise `WorldError` for what the JSON of a file of `size` bytes in all asks for beyond measure."""
    counts = [int(entry["count"]) for entry in tree.get("accessors", [])]
    meshes = [sum(_corners(part, counts) for part in mesh["primitives"]) for mesh in tree.get("meshes", [])]
    nodes = tree.get("nodes", [])
    asked = sum(counts) + sum(meshes[node["mesh"]] for node in nodes if "mesh" in node)
    most = max(_FREE_ENTRIES, _ENTRIES_PER_BYTE * size)
    if min(counts, default=0) < 0 or asked > most:
        raise WorldError(f"its nodes ask for {asked} corners and indices, in {size} bytes; wanted at most {most}")
    _check_nest(nodes)


def _check_pictures(pictures: Iterable[Any], size: int) -> None:
    """Raise `WorldError` for pictures that are no usual ones, or too large for a file of `size` bytes."""
    found = {id(picture): picture for picture in pictures if picture is not None}
    for picture in found.values():
        if picture.format not in (*FORMATS, "MPO"):  # a JPEG with more in it
            raise WorldError(f"it has a texture of the kind {picture.format}; wanted PNG, JPEG or WebP")
    asked, most = sum(decoded_bytes(picture) for picture in found.values()), max(_FREE_BYTES, _BYTES_PER_BYTE * size)
    if asked > most:
        raise WorldError(f"its textures have {asked} bytes when they are decoded; wanted at most {most}")


def _corners(primitive: Mapping[str, Any], counts: list[int]) -> int:
    used = (primitive["attributes"].get("POSITION"), primitive.get("indices"))
    return sum(counts[index] for index in used if index is not None)


def _check_nest(nodes: list[Any]) -> None:
    parents, depth = [0] * len(nodes), [1] * len(nodes)
    for child in (child for node in nodes for child in node.get("children", [])):
        parents[child] += 1
    ready, reached = [index for index, count in enumerate(parents) if count == 0], 0
    while ready:
        reached += 1
        index = ready.pop()
        for child in nodes[index].get("children", []):
            depth[child] = max(depth[child], depth[index] + 1)
            parents[child] -= 1
            if parents[child] == 0:
                ready.append(child)
    if reached < len(nodes):
        raise WorldError(f"{len(nodes) - reached} of its {len(nodes)} nodes are below themselves; export it again")
    if max(depth, default=0) > _DEEPEST:
        raise WorldError(f"its nodes are {max(depth)} deep below each other; wanted at most {_DEEPEST}")
