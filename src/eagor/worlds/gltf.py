"""The differences between glTF and `eagor.worlds.scene`: names, materials, texture seams."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from eagor._srgb import to_coded, to_linear
from eagor.queries import COLOURS, SYNONYMS, singular
from eagor.worlds.scene import Material

FORMAT = "eagor semantic 1"  # of the JSON beside an exported GLB
FOOTING = "eagor_footing"  # the node of an exported GLB that is no thing: see `eagor.worlds.habitat_mesh`

# Words of node names without meaning: of modelling programs, and of places.
_EMPTY_WORDS = {
    "mesh", "node", "object", "obj", "geometry", "geom", "primitive", "default", "group", "root", "scene", "world",
    "model", "material", "instance", "sm", "lod", "polysurface", "gltf", "armature", "collection", "untitled", "north",
    "south", "east", "west", "left", "right", "front", "back", "upper", "lower", "top", "bottom", "inner", "outer",
    "interior", "exterior",
}  # fmt: skip
_DARK = 0.02  # linear: a darker colour cannot carry the light of a lamp


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
