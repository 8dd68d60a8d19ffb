"""What a glTF file may ask for: room in proportion to what it holds, and no nests to get lost in.

A few kilobytes can ask for anything: nodes that share a mesh, accessors without data, textures of nothing. All of it
is counted here before room is made for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from eagor.errors import WorldError
from eagor.worlds.panorama import FORMATS, decoded_bytes

_FREE_ENTRIES = 2_000_000  # corners, indices and the like that any file may ask for, and of larger ones ...
_ENTRIES_PER_BYTE = 1  # ... three times what a file without shared parts needs
_FREE_BYTES = 1 << 27  # that the pictures of any file may have when they are decoded, and of larger ones ...
_BYTES_PER_BYTE = 600  # ... this for each byte of the file
_DEEPEST = 256  # nodes below each other


def check_tree(tree: Any, size: int) -> None:
    """Raise `WorldError` for what the JSON of a file of `size` bytes in all asks for beyond measure."""
    counts = [int(entry["count"]) for entry in tree.get("accessors", [])]
    meshes = [sum(_corners(part, counts) for part in mesh["primitives"]) for mesh in tree.get("meshes", [])]
    nodes = tree.get("nodes", [])
    asked = sum(counts) + sum(meshes[node["mesh"]] for node in nodes if "mesh" in node)
    most = max(_FREE_ENTRIES, _ENTRIES_PER_BYTE * size)
    if min(counts, default=0) < 0 or asked > most:
        raise WorldError(f"its nodes ask for {asked} corners and indices, in {size} bytes; wanted at most {most}")
    _check_nest(nodes)


def check_pictures(pictures: Iterable[Any], size: int) -> None:
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
