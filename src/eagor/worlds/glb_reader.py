"""GLB files as scenes; the public entry point is `eagor.worlds.glb`."""

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
from eagor.media.panorama import FORMATS, decoded_bytes
from eagor.worlds.gltf import FOOTING, FORMAT, from_pbr, name_from_nodes
from eagor.worlds.scene import Instance, Lamp, Material, Room, Scene

# A few kilobytes can ask for anything: nodes that share a mesh, accessors without data, blank textures. So the size of
# the result is computed before memory is allocated.
_FREE_ENTRIES = 2_000_000  # corners, indices and similar entries allowed for any file, and for larger files ...
_ENTRIES_PER_BYTE = 1  # ... three times the need of a file without shared parts
_FREE_BYTES = 1 << 27  # decoded bytes of pictures allowed for any file, and for larger files ...
_BYTES_PER_BYTE = 600  # ... this per byte of the file
_DEEPEST = 256  # nesting of nodes


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
        raise ValueError(f"the rectangles are {shown(values)}; wanted [x0, y0, x1, y1] each")
    return np.array(sides).reshape(-1, 4)


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
        np.repeat(owners, counts).astype(np.int32),
        np.repeat(looks, counts).astype(np.int32),
        np.concatenate([part.uv for part in parts]),
        tuple(instances),
        tuple(materials),
        source=f"glb {path.name}",
        **more,
    )


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
        raise WorldError(f"{len(nodes) - reached} of its {len(nodes)} nodes are in a cycle; export it again")
    if max(depth, default=0) > _DEEPEST:
        raise WorldError(f"its nodes are nested {max(depth)} deep; wanted at most {_DEEPEST}")
