"""Habitat's navigation mesh of an exported scene, made by Habitat-Sim in a process of its own.

A wrong setting ends the process in which Habitat-Sim runs. No picture is drawn, so no graphics are needed.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

from eagor.errors import WorldError

__all__ = ["WITHOUT", "mesh_writer", "voxel_for"]

WITHOUT = (
    "habitat_sim is not installed here, so there are no .navmesh files: habitat-lab and eagor make them when they open "
    "a scene; in Habitat-Sim, call recompute_navmesh with the settings in <scene>.navmesh.json"
)
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
