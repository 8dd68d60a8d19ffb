"""The navigation mesh for a body, and the true floor below it, looked at from above.

A mesh floats above the floor by up to a voxel, and Habitat's heights have no zero. So the floor is what the camera sees
below points of the mesh. This also shows whether mesh and scene have the same way up.
"""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.habitat.navmesh import NavMesh, Storey
from eagor.worlds.habitat.options import Options, existing, is_bare
from eagor.worlds.habitat.simulator import Frames, HabitatView, import_habitat
from eagor.worlds.habitat_files import LAB_SLOPE, voxel_for

__all__ = ["EYE", "ROWS", "mesh_for", "roofed", "settings_for", "true_floor"]

HEIGHT, CLIMB = 1.5, 0.2  # metres: of a body, and of the steps that it climbs (Habitat's defaults)
CELL, CELL_HEIGHT = 0.05, 0.05  # metres: of a new mesh's voxels; Habitat's own height is 0.2, four times as coarse
EYE = 1.25  # metres above the ground from which things and floors are looked at
ROWS = 64  # of these panoramas
FLAT = 0.02  # metres: a floor this close to y = 0 is meant to be there
SUNK = 0.4  # metres between the mesh and what is below it that are not the mesh's own roughness
TALL = 4.5  # metres from the floor to the ceiling, beyond which a scene may lie on its side
NARROW = 3.5  # metres: a scene that is narrower than this and than it is high may lie on its side, too


def mesh_for(options: Options, file: Path | None, sim: Any, radius: float) -> tuple[Any, str]:
    """A PathFinder for a body of this radius, and where its mesh comes from. Raises `WorldError`."""
    habitat_sim = import_habitat()
    given = existing(options.navmesh, "the navigation mesh")
    if given is not None:
        found = habitat_sim.PathFinder()
        if not found.load_nav_mesh(str(given)) or not found.is_loaded:
            raise WorldError(f"{given} is no navigation mesh that Habitat-Sim reads; wanted what save_nav_mesh writes")
        return found, given.name
    settings = settings_for(habitat_sim, options, file, radius)
    for own in (sim.pathfinder, _beside(habitat_sim, file)):
        if own is not None and own.is_loaded and _fits(own.nav_mesh_settings, settings, options):
            return own, "the scene's"
    found = habitat_sim.PathFinder()
    if not sim.recompute_navmesh(found, settings) or not found.is_loaded:
        raise WorldError(
            f"Habitat-Sim finds no ground for a body of radius {radius:g} m in {options.scene}; is it the right way up "
            "(habitat:SCENE?up=y or ?up=z), in metres, and complete?"
        )
    return found, "computed"


def settings_for(habitat_sim: Any, options: Options, file: Path | None, radius: float) -> Any:
    """Habitat's NavMeshSettings: those of habitat-lab for `Options.body`, otherwise finer ones."""
    settings = habitat_sim.NavMeshSettings()
    settings.set_defaults()
    settings.agent_radius = radius
    if options.body is not None:
        # habitat-lab's `default_agent_navmesh`: what is not named is Habitat's default, static objects do not count.
        settings.agent_height, settings.agent_max_climb = options.body, options.climb
        settings.cell_height, settings.agent_max_slope = options.voxel, LAB_SLOPE
        settings.include_static_objects = False
        return settings
    settings.cell_size, settings.cell_height = voxel_for(radius, CELL), CELL_HEIGHT
    settings.agent_height, settings.agent_max_climb = HEIGHT, CLIMB
    wanted = file.with_suffix(".navmesh.json") if file is not None else None
    if wanted is not None and wanted.is_file():
        for name, value in json.loads(wanted.read_text(encoding="utf-8")).items():
            if hasattr(settings, name):
                setattr(settings, name, value)
    settings.agent_radius = radius
    settings.include_static_objects = True
    return settings


def _fits(own: Any, wanted: Any, options: Options) -> bool:
    """Whether a scene's own mesh is used: habitat-lab takes it only if all of its settings are those wanted."""
    return own == wanted if options.body is not None else abs(own.agent_radius - wanted.agent_radius) < 1e-3


def _beside(habitat_sim: Any, file: Path | None) -> Any:
    """The mesh in ``<scene>.navmesh``, None if there is none that can be read."""
    place = None if file is None else file.with_suffix(".navmesh")
    if place is None or not place.is_file():
        return None
    found = habitat_sim.PathFinder()
    return found if found.load_nav_mesh(str(place)) else None


def _looks(view: HabitatView, feet: np.ndarray) -> np.ndarray:
    """Metres ``(n, 2)`` up and down from the eye above points ``(n, 3)`` of Habitat's world."""
    found = []
    for point in view.frames.from_habitat(feet):
        metres = view.panorama(point + np.array([0.0, 0.0, EYE]), np.eye(3), ROWS, rgb=False, ids=False).range
        assert metres is not None
        found.append(np.median(metres[[0, -1]], axis=1) * math.cos(math.pi / (2 * ROWS)))
    return np.array(found).reshape(-1, 2)


def _extent(sim: Any) -> np.ndarray:
    """Metres ``(3,)`` that the scene extends along x, y (up) and z of Habitat's world."""
    box = sim.get_active_scene_graph().get_root_node().cumulative_bb
    return np.array(box.max, dtype=np.float64) - np.array(box.min, dtype=np.float64)


def _check_upright(name: str, height: float, extent: np.ndarray, up: str | None) -> None:
    """Judge whether a scene with rooms of this height and this `extent` ``(3,)`` seems to lie on its side.

    Raises `WorldError` if nobody has said which way is up; who has said it is warned.
    """
    narrow, upwards = float(extent[[0, 2]].min()), float(extent[1])
    if not (TALL < height < math.inf or (narrow < NARROW and narrow < upwards)):
        return
    seems = (
        f"{name} seems to lie on its side (it is {extent[0]:.1f} x {extent[2]:.1f} m large and {upwards:.1f} m high)"
    )
    if up is None:
        raise WorldError(
            f"{seems}: Habitat takes z for up in a bare GLB file, glTF says y; say which with habitat:SCENE?up=y or "
            "?up=z"
        )
    warnings.warn(f"{seems} with up={up}; if it does, say up={'z' if up == 'y' else 'y'}", UserWarning, stacklevel=2)


def roofed(view: HabitatView, feet: np.ndarray) -> float:
    """The share of points of the mesh with something above them."""
    return float(np.isfinite(_looks(view, feet)[:, 0]).mean()) if len(feet) else 0.0


def true_floor(view: HabitatView, pathfinder: Any, storey: Storey, name: str, options: Options) -> float:
    """The height of the true floor, Habitat's y: what lies below points of the mesh.

    Raises `WorldError` if the mesh does not lie on what is drawn, or if the scene seems to lie on its side and nothing
    says which way is up.
    """
    mesh = NavMesh(pathfinder, storey, Frames(), 0.18, source=name)
    level = np.abs(mesh.surface.heights[mesh.free] - storey.level) <= 0.1
    spots = mesh.points[level][:: max(1, int(level.sum()) // 25)]
    feet = np.array([mesh.feet(xy) for xy in spots]).reshape(-1, 3)
    above, below = _looks(view, feet).T
    gap = below - EYE  # the mesh floats above the floor
    if not (np.abs(gap) < SUNK).mean() > 0.5:
        raise WorldError(
            f"under most of the navigation mesh of {name} there is no floor within {SUNK:g} m: mesh and scene do not "
            "have the same way up, or belong to different scenes; try habitat:SCENE?up=y or ?up=z, or leave out navmesh"
        )
    if is_bare(options) or options.up is not None:
        _check_upright(name, float(np.median(above)) + EYE, _extent(view.session.sim), options.up)
    floor = float(np.median(feet[:, 1] - gap))
    return 0.0 if abs(floor) < FLAT else floor
