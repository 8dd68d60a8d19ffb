"""Navigation meshes of Habitat: what habitat-lab makes of a scene, and the mesh that is written beside an exported one.

habitat-lab makes its own mesh of a scene for the body that its configuration names (`default_agent_navmesh`), with
voxels of 0.05 m that are 0.2 m high. Recast, which does it, counts them from the lowest corner of the scene, and puts
the mesh on top of the voxel that a floor is in. So the mesh of a scene that begins at its floor lies 0.2 m above it,
which habitat-lab counts as distance. Exported scenes begin `FOOTING` below their floor: there the mesh is `ON_MESH`
above it.

Habitat-Sim writes meshes in a process of its own: a wrong setting ends the process in which it runs. No picture is
drawn, so no graphics are needed.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from eagor.errors import WorldError

__all__ = [
    "FOOTING", "LAB_BODY", "LAB_CLIMB", "LAB_SLOPE", "LAB_VOXEL", "ON_MESH", "WITHOUT",
    "footing_of", "mesh_writer", "roomy_radius", "voxel_for",
]  # fmt: skip

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
PATIENCE = 300.0  # seconds for one mesh; an apartment takes less than one
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
    there, here = os.pipe()  # its end tells the other process that this one is gone
    command = [sys.executable, "-c", _PROGRAM, str(stage), str(target), str(settings), str(there)]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", timeout=PATIENCE,
            pass_fds=(there,),
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise WorldError(f"Habitat-Sim took longer than {PATIENCE:.0f} s for the mesh of {base.name}") from None
    finally:
        os.close(there)
        os.close(here)
    if done.returncode or not target.is_file():
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise WorldError(f"Habitat-Sim made no navigation mesh of {base.name} (exit code {done.returncode}): {last}")
