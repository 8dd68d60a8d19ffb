"""The files of Habitat beside an exported GLB: the ids of its things, and its navigation mesh.

`<name>.semantic.glb` and `<name>.semantic.txt` hold the instances of a scene as Habitat reads them from HM3D. The GLB
has the triangles of the scene in flat colours, one per instance, as a texture and as vertex colours. The text file has
one line per instance, ``id,RRGGBB,"category",region``, below its header. Habitat makes its ids from the colours. Its id
0 means "Unknown", so ours are the index in `Scene.instances` plus `FIRST_ID`. Regions are rooms.

habitat-lab makes its own mesh of a scene for the body that its configuration names (`default_agent_navmesh`), with
voxels of 0.05 m that are 0.2 m high. Recast, which does it, counts them from the lowest corner of the scene, and puts
the mesh on top of the voxel that a floor is in. So the mesh of a scene that begins at its floor lies 0.2 m above it,
which habitat-lab counts as distance. Exported scenes begin `FOOTING` below their floor: there the mesh is `ON_MESH`
above it.
"""

from __future__ import annotations

import io
import json
import math
import os
import struct
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from eagor._srgb import to_linear
from eagor.conventions import to_gltf
from eagor.errors import WorldError
from eagor.worlds.scene import Scene

# What a stage configuration says of a scene of ours: a GLB has Y up, which Habitat does not assume.
STAGE = {
    "up": [0, 1, 0], "front": [0, 0, -1], "units_to_meters": 1.0, "is_collidable": True, "shader_type": "flat",
}  # fmt: skip
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


# --- navigation meshes ------------------------------------------------------------------------------------------------

LAB_BODY = 0.88  # metres: height of the body in habitat-lab's configurations of ObjectNav on HM3D and MP3D
LAB_CLIMB, LAB_SLOPE = 0.2, 45.0  # metres and degrees: what habitat-lab's bodies climb by default
LAB_VOXEL = 0.2  # metres: the height of habitat-lab's voxels
ON_MESH = 0.01  # metres of habitat-lab's mesh above the floor of an exported scene: rugs are in the same voxel
FOOTING = LAB_VOXEL - ON_MESH  # metres below the floor at which an exported scene begins
LAB_CELL = 0.05  # metres: the side of its voxels

WITHOUT = (
    "habitat_sim is not installed here, so there are no .navmesh files: habitat-lab and eagor make them when they open "
    "a scene; in Habitat-Sim, call recompute_navmesh with the settings in <scene>.navmesh.json"
)
LEVEL = 0.05  # metres: triangles this close to the height of the floor are part of it
MARGIN = 1.6  # voxels: the 1.3 of straightened edges, and some for what is full; more closes passages that are open
SHRUNK = 0.5  # side of the footing in those of the triangle above it: no corner of it shows at the edge of the floor
PATIENCE = 300.0  # seconds for one mesh, of which an apartment takes less than one, or for opening a scene
_PROGRAM = """
import json, os, sys, threading
stage, target, settings, line = sys.argv[1:]
threading.Thread(target=lambda: (os.read(int(line), 1), os._exit(1)), daemon=True).start()  # ends with its parent
import habitat_sim
simulator = habitat_sim.SimulatorConfiguration()
simulator.scene_id, simulator.create_renderer, simulator.load_semantic_mesh = stage, False, False
simulator.gpu_device_id = -1
agent = habitat_sim.agent.AgentConfiguration()
agent.sensor_specifications = []
with habitat_sim.Simulator(habitat_sim.Configuration(simulator, [agent])) as sim:
    wanted = habitat_sim.NavMeshSettings()
    wanted.set_defaults()
    for name, value in json.load(open(settings)).items():
        setattr(wanted, name, value)
    made = sim.recompute_navmesh(sim.pathfinder, wanted) and sim.pathfinder.save_nav_mesh(target)
sys.exit(0 if made else 3)
"""


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


def roomy_radius(radius: float) -> float:
    """Metres from the next obstacle at which a place is on habitat-lab's mesh for a body of this radius.

    Recast rounds the radius up to whole voxels, counts a voxel as full if anything touches it, and straightens the
    edges of the mesh by up to 1.3 voxels.
    """
    return (math.ceil(radius / LAB_CELL - 1e-6) + MARGIN) * LAB_CELL


def voxel_for(radius: float, cell: float) -> float:
    """The size (metres) of voxels of about `cell` of which a whole number makes up the radius of a body.

    Recast, which makes the meshes, rounds the radius up to whole voxels: with 0.05 m it keeps a body of 0.18 m off the
    walls by 0.20 m.
    """
    return round(radius / max(1, round(radius / cell)) * (1 + 1e-6), 9) if radius > 0 else cell


def mesh_writer() -> Callable[[Path], None] | None:
    """What writes ``<name>.navmesh`` beside a ``<name>.stage_config.json``; None without habitat_sim."""
    return _write if find_spec("habitat_sim") is not None else None


def _write(stage: Path) -> None:
    """Write the mesh with the settings beside the stage. Raises `WorldError` if Habitat-Sim makes none."""
    base = stage.with_name(stage.name.removesuffix(".stage_config.json"))
    target, settings = base.with_name(f"{base.name}.navmesh"), base.with_name(f"{base.name}.navmesh.json")
    code, _, said = run_apart(_PROGRAM, str(stage), str(target), str(settings))
    if code is None:
        raise WorldError(f"Habitat-Sim took longer than {PATIENCE:.0f} s for the mesh of {base.name}")
    if code or not target.is_file():
        last = (said.strip().splitlines() or ["it said nothing"])[-1]
        raise WorldError(f"Habitat-Sim made no navigation mesh of {base.name} (exit code {code}): {last}")


def run_apart(program: str, *arguments: str) -> tuple[int | None, str, str]:
    """Run Python code in a process of its own, as Habitat-Sim may end the process that it runs in.

    Its exit code (None: it was ended after `PATIENCE`), what it wrote to stdout, and to stderr. Its last argument is
    the number of a pipe: when that ends, this process is gone, and so it should be, too.
    """
    there, here = os.pipe()
    command = [sys.executable, "-c", program, *arguments, str(there)]
    path = os.pathsep.join(filter(None, sys.path))
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=PATIENCE, pass_fds=(there,),
            env={**os.environ, "PYTHONPATH": path},
        )  # fmt: skip
        code, said = done.returncode, (done.stdout, done.stderr)
    except subprocess.TimeoutExpired as late:
        code, said = None, (late.stdout or b"", late.stderr or b"")
    finally:
        os.close(there)
        os.close(here)
    out, err = (text.decode(errors="replace") for text in said)
    return code, out, err
