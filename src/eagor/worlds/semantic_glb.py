"""The instances of a scene as Habitat reads them from HM3D: `<name>.semantic.glb` and `<name>.semantic.txt`.

The GLB has the triangles of the scene in flat colours, one per instance, as a texture and as vertex colours. The text
file has one line per instance, ``id,RRGGBB,"category",region``, below its header. Habitat makes its ids from the
colours. Its id 0 means "Unknown", so ours are the index in `Scene.instances` plus `FIRST_ID`. Regions are rooms.
"""

from __future__ import annotations

import io
import json
import struct
from typing import Any

import numpy as np

from eagor._srgb import to_linear
from eagor.conventions import to_gltf
from eagor.errors import WorldError
from eagor.worlds.scene import Scene

__all__ = ["FIRST_ID", "MOST", "colours_of", "semantic_glb", "semantic_text"]

FIRST_ID = 1  # the id of the first instance: Habitat's 0 is "Unknown"
MOST = 65535 - FIRST_ID  # instances: Habitat's ids have 16 bits
HEADER = "HM3D Semantic Annotations"
_MIXER = 0x9E3779  # odd, so that multiples are all different modulo 2**24: 2**24 times the golden ratio's fraction
_PATCH = 4  # pixels of one colour on each side: no filter of a texture reaches a neighbour
_FLOAT, _UINT, _ARRAY, _ELEMENTS, _NEAREST, _CLAMP = 5126, 5125, 34962, 34963, 9728, 33071  # constants of glTF


def colours_of(count: int) -> np.ndarray:
    """The colours of the first `count` instances, ``(count, 3)`` uint8 sRGB: all different, none black."""
    if count > MOST:
        raise WorldError(f"the scene has {count} instances; Habitat's ids have room for {MOST}: leave some out")
    mixed = (np.arange(FIRST_ID, FIRST_ID + count, dtype=np.int64) * _MIXER) & 0xFFFFFF
    return np.stack([mixed >> 16, (mixed >> 8) & 255, mixed & 255], axis=-1).astype(np.uint8)


def semantic_text(scene: Scene) -> str:
    """The text file. Instances in no room are in a region of their own, behind those of the rooms."""
    regions = {room.name: index for index, room in enumerate(scene.rooms)}
    lines = [HEADER]
    for index, (thing, colour) in enumerate(zip(scene.instances, colours_of(len(scene.instances)), strict=True)):
        category = " ".join(thing.category.replace('"', " ").split())
        region = regions.get(thing.room or "", len(regions))
        lines.append(f'{index + FIRST_ID},{bytes(colour).hex().upper()},"{category}",{region}')
    return "\n".join(lines) + "\n"


def semantic_glb(scene: Scene) -> bytes:
    """The binary glTF: Y up, as of `eagor.worlds.glb`; the same scene gives the same bytes."""
    from PIL import Image

    colours = colours_of(len(scene.instances))
    side = max(1, int(np.ceil(np.sqrt(len(colours)))))
    palette = np.zeros((side * side, 3), dtype=np.uint8)
    palette[: len(colours)] = colours
    picture = np.kron(palette.reshape(side, side, 3), np.ones((_PATCH, _PATCH, 1), dtype=np.uint8))
    png = io.BytesIO()
    Image.fromarray(picture).save(png, format="PNG")

    # One vertex per corner and instance: a colour belongs to a vertex.
    corners = np.stack([np.repeat(scene.instance, 3), scene.triangles.ravel()], axis=-1)
    distinct, index = np.unique(corners, axis=0, return_inverse=True)
    owner, vertex = distinct.T
    positions = to_gltf(scene.vertices[vertex].astype(np.float64)).astype(np.float32)
    row, column = np.divmod(owner, side)
    uv = (np.stack([column, row], axis=-1).astype(np.float32) + 0.5) / side  # the middle of the patch
    linear = to_linear(colours.astype(np.float64) / 255).astype(np.float32)  # glTF's vertex colours are linear
    parts = [
        (index.reshape(-1).astype(np.uint32), _ELEMENTS),
        (positions, _ARRAY),
        (linear[owner], _ARRAY),
        (uv, _ARRAY),
        (np.frombuffer(png.getvalue(), dtype=np.uint8), None),
    ]
    return _packed(parts, positions)


def _packed(parts: list[tuple[np.ndarray, int | None]], positions: np.ndarray) -> bytes:
    """A GLB of one mesh: indices, positions, colours, texture coordinates, and the PNG of its texture."""
    views: list[dict[str, Any]] = []
    blob = b""
    for values, target in parts:
        data = np.ascontiguousarray(values).tobytes()
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        if target is not None:
            views[-1]["target"] = target
        blob += data + b"\0" * (-len(data) % 4)
    indices, vertices = len(parts[0][0]), len(positions)

    def accessor(view: int, kind: str) -> dict[str, Any]:
        return {"bufferView": view, "componentType": _FLOAT, "count": vertices, "type": kind}

    tree = {
        "asset": {"version": "2.0", "generator": "eagor"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "semantic", "mesh": 0}],
        "meshes": [
            {
                "name": "semantic",
                "primitives": [
                    {"attributes": {"POSITION": 1, "COLOR_0": 2, "TEXCOORD_0": 3}, "indices": 0, "material": 0}
                ],
            }
        ],
        "accessors": [
            {"bufferView": 0, "componentType": _UINT, "count": indices, "type": "SCALAR"},
            accessor(1, "VEC3") | {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()},
            accessor(2, "VEC3"),
            accessor(3, "VEC2"),
        ],
        "materials": [
            {
                "name": "semantic",
                "doubleSided": True,
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0},
            }
        ],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"magFilter": _NEAREST, "minFilter": _NEAREST, "wrapS": _CLAMP, "wrapT": _CLAMP}],
        "images": [{"bufferView": 4, "mimeType": "image/png"}],
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + blob
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks
