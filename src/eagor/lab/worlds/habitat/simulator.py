"""Habitat-Sim: its simulators, and what a camera sees in them, in our coordinates.

A wrong device, a missing EGL or a damaged scene ends the process that tries it, not with a Python exception. So another
process tries first, and its end is told in one sentence. The result holds for this process and for those that it
starts.

A session is all that touches Habitat-Sim's simulator. A session that looks closes that of another, which opens again at
its next look: each holds the textures of a whole building, and all simulators of a process draw with the graphics
context of the first, so that the process ends when one draws after the first was closed.

Habitat's world has Y up; its x is ours, its Z is our -y (`eagor.conventions.to_gltf`), as in exported GLB files and
ObjectNav episodes. Heights differ by the floor of the chosen storey: our z = 0 is Habitat's y = `Frames.floor`. A
camera's own axes are x right, y up, z backward.
"""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from eagor._arrays import frozen
from eagor.conventions import from_gltf, pose_to_habitat, to_gltf, wxyz_from_rotation
from eagor.errors import MissingExtraError, WorldError
from eagor.grids import ErpGrid
from eagor.lab.worlds.render import Frame, checked_pose
from eagor.queries import SYNONYMS

HOW_TO_GET = (
    "it is on no package registry: conda install -c conda-forge -c aihabitat habitat-sim headless, or build it from "
    "the sources of facebookresearch/habitat-sim (pip install . there)"
)
PATIENCE = 300.0  # seconds for a process of its own: opening a scene or making a mesh takes a few
FIRST_ROWS = 64  # of the sensors with which a simulator is made; others are added when they are asked for
KINDS = ("color", "depth", "semantic")
FAR = 999.0  # metres: the far plane is at 1000


@dataclass(frozen=True)
class Source:
    """What Habitat-Sim opens: `scene_id`, the scene dataset's configuration, and the GPU (None: found by trying).

    `name`: the same in every process, unlike the path of a written stage configuration.
    """

    scene_id: str
    dataset: str = "default"
    gpu: int | None = None
    name: str = ""


def import_habitat() -> Any:
    """The module `habitat_sim`, with its logging silenced. Raises `MissingExtraError`, or `WorldError` if it fails."""
    _need()
    _quieten()
    try:
        import habitat_sim  # pyright: ignore[reportMissingImports]
    except Exception as error:  # a broken build raises what it likes
        raise WorldError(BROKEN.format(f"{type(error).__name__}: {error}"[:300])) from error
    return habitat_sim


def _need() -> None:
    if "habitat_sim" not in sys.modules and find_spec("habitat_sim") is None:
        raise MissingExtraError(f"the world habitat needs Habitat-Sim (the module habitat_sim); {HOW_TO_GET}")


def _quieten() -> None:
    """Let Habitat-Sim and its libraries write nothing but errors: they would write to stdout, which is for results."""
    for name, level in (("MAGNUM_LOG", "quiet"), ("HABITAT_SIM_LOG", "quiet"), ("GLOG_minloglevel", "2")):
        os.environ.setdefault(name, level)


def simulator_of(habitat_sim: Any, source: Source, device: int, kinds: Sequence[str] = KINDS) -> Any:
    """A simulator with equirectangular sensors at the agent's origin.

    With a sensor of colour, each simulator prepares lights: on the CPU, that takes most of the time that it starts.
    """
    settings = habitat_sim.SimulatorConfiguration()
    settings.scene_id = source.scene_id
    settings.scene_dataset_config_file = source.dataset
    settings.gpu_device_id = device
    settings.allow_sliding = False
    settings.enable_physics = False
    settings.random_seed = 0
    agent = habitat_sim.agent.AgentConfiguration()
    agent.sensor_specifications = [sensor_of(habitat_sim, kind, FIRST_ROWS) for kind in kinds]
    return habitat_sim.Simulator(habitat_sim.Configuration(settings, [agent]))


def sensor_of(habitat_sim: Any, kind: str, rows: int) -> Any:
    """An equirectangular sensor of this kind at the agent's origin."""
    spec = habitat_sim.EquirectangularSensorSpec()
    spec.uuid = f"{kind} {rows}"
    spec.sensor_type = getattr(habitat_sim.SensorType, kind.upper())
    spec.sensor_subtype = habitat_sim.SensorSubType.EQUIRECTANGULAR
    spec.resolution = [rows, 2 * rows]
    spec.position = [0.0, 0.0, 0.0]  # floats: whole numbers are refused
    spec.channels = 4 if kind == "color" else 1
    return spec


def mesh_settings(habitat_sim: Any, chosen: Mapping[str, Any]) -> Any:
    """Habitat's NavMeshSettings: its own defaults but for what is chosen."""
    settings = habitat_sim.NavMeshSettings()
    settings.set_defaults()
    for name, value in chosen.items():
        setattr(settings, name, value)
    return settings


# --- whether Habitat-Sim can open a scene here, and on which device, found out in another process ---------------------

GPU = "EAGOR_HABITAT_GPU"  # environment: the device for all scenes, -1 for the CPU
PROBED = "EAGOR_HABITAT_PROBED"  # environment of the processes that this one starts: what was found out
CPU = -1
_MARK = "eagor probe: "  # of our lines: libraries write to stdout, too

BROKEN = (
    "Habitat-Sim is installed, but cannot be imported ({}); it needs the NumPy that it was built for, and libEGL: "
    "install it again"
)
NO_GPU = (
    "Habitat-Sim cannot draw on GPU {} ({}): there is no such NVIDIA card with EGL here; use another number, or the "
    f"CPU: habitat:SCENE?gpu=-1, or {GPU}=-1"
)
NO_CPU = (
    "Habitat-Sim cannot draw on the CPU ({}): it needs EGL with Mesa's software renderer (Debian, Ubuntu: libegl1, "
    "libgl1-mesa-dri), and a headless build of Habitat-Sim"
)
NO_SCENE = "Habitat-Sim cannot open the scene {!r} ({}); is it complete, and does the dataset list it?"


def device_for(source: Source) -> int:
    """The device with which a scene opens: its GPU, $EAGOR_HABITAT_GPU, an NVIDIA card if there is one, or the CPU.

    Raises `MissingExtraError` without Habitat-Sim, and `WorldError` if no simulator can be made, or not of this scene.
    """
    _need()
    asked = os.environ.get(GPU, "") if source.gpu is None else str(source.gpu)
    known = json.loads(os.environ.get(PROBED, "{}"))
    key = f"{source.name or source.scene_id}, {source.dataset}, {asked}"
    if key not in known:
        known[key] = _first_that_opens(source, asked)
        os.environ[PROBED] = json.dumps(known)
    return known[key]


def _first_that_opens(source: Source, asked: str) -> int:
    """The first device that opens the scene, of the one that is `asked` for, or of those that may be here."""
    try:
        devices = [int(asked)] if asked else [0, CPU] if Path("/proc/driver/nvidia/version").exists() else [CPU]
    except ValueError:
        raise WorldError(f"{GPU} = {asked!r}; wanted the number of a GPU, or -1 for the CPU") from None
    why = ""
    for device in devices:
        out, last = run_apart(try_to_open, source.scene_id, source.dataset, str(device))
        stage = next((line for line in reversed(out.splitlines()) if line.startswith(_MARK)), "").removeprefix(_MARK)
        if stage == "opened":
            return device
        if stage == "drawn":
            why = NO_SCENE.format(source.name or source.scene_id, last)
        elif stage == "imported":
            why = NO_CPU.format(last) if device == CPU else NO_GPU.format(device, last)
        else:
            why = BROKEN.format(last)
    raise WorldError(why)


def try_to_open(scene_id: str, dataset: str, device: str) -> None:
    """Open a scene, and say after each stage what has worked. Runs in a process of its own."""
    _quieten()
    import habitat_sim  # pyright: ignore[reportMissingImports]

    print(f"{_MARK}imported", flush=True)
    simulator_of(habitat_sim, Source("NONE"), int(device), ("depth",)).close()
    print(f"{_MARK}drawn", flush=True)
    simulator_of(habitat_sim, Source(scene_id, dataset), int(device), ("depth",)).close()
    print(f"{_MARK}opened", flush=True)


def run_apart(work: Callable[..., None], *words: str) -> tuple[str, str]:
    """Call a function of ours in a process of its own, as Habitat-Sim may end the process that it runs in.

    What it wrote to stdout, and the last line of stderr, or why there is none.
    """
    program = f"import sys; from {work.__module__} import {work.__name__} as work; work(*sys.argv[1:])"
    try:
        done = subprocess.run(
            [sys.executable, "-c", program, *words], stdin=subprocess.DEVNULL, capture_output=True, timeout=PATIENCE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )  # fmt: skip
    except subprocess.TimeoutExpired as late:
        return (late.stdout or b"").decode(errors="replace"), f"it took longer than {PATIENCE:.0f} s"
    said = done.stderr.decode(errors="replace").split("\n")
    last = next((line.strip() for line in reversed(said) if line.strip()), "it ended without a word")
    return done.stdout.decode(errors="replace"), last[:300]


# --- the simulator that is open in this process -----------------------------------------------------------------------

_open: list[Session] = []  # one at most


class Session:
    """One scene, whose simulator is opened on demand."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self._sim: Any = None

    @property
    def sim(self) -> Any:
        """The simulator (`habitat_sim.Simulator`). Raises as `device_for` if it cannot be made."""
        if self._sim is None:
            device = device_for(self.source)
            close_all()
            self._sim = simulator_of(import_habitat(), self.source, device)
            _open.append(self)
        return self._sim

    def look(
        self, kinds: Sequence[str], rows: int, position: np.ndarray, world_R_body: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Equirectangular pictures by kind ("color", "depth", "semantic"), of `rows` rows.

        `position` ``(3,)``, in Habitat's world; `world_R_body`: our pose. Raises `RotationError`, and as `sim`.
        """
        import magnum  # pyright: ignore[reportMissingImports]

        sim = self.sim
        body = sim.agents[0].scene_node
        w, x, y, z = wxyz_from_rotation(pose_to_habitat(world_R_body)).tolist()
        body.translation = magnum.Vector3(*(float(value) for value in position))
        body.rotation = magnum.Quaternion(magnum.Vector3(x, y, z), w)
        sensors = getattr(sim, "sensors", None) or sim._sensors  # 0.3.3 has no public name for it
        for kind in kinds:
            if f"{kind} {rows}" not in sensors:
                sim.add_sensor(sensor_of(import_habitat(), kind, rows))
            sensors[f"{kind} {rows}"].draw_observation()
        return {kind: sensors[f"{kind} {rows}"].get_observation() for kind in kinds}

    def close(self) -> None:
        """Close the simulator, if it is open."""
        if self._sim is not None:
            _open.remove(self)
            sim, self._sim = self._sim, None
            sim.close()


def close_all() -> None:
    """Close the simulator that is open in this process."""
    for session in [*_open]:
        session.close()


atexit.register(close_all)


# --- what a camera sees in Habitat-Sim, in our coordinates and words --------------------------------------------------


@dataclass(frozen=True)
class Frames:
    """The change of coordinates for a scene whose floor is at the height `floor`, metres, in Habitat's world."""

    floor: float = 0.0

    def to_habitat(self, points: np.ndarray) -> np.ndarray:
        """Points ``(..., 3)`` of our world in Habitat's."""
        found = to_gltf(np.asarray(points, dtype=np.float64))
        found[..., 1] += self.floor
        return found

    def from_habitat(self, points: np.ndarray) -> np.ndarray:
        """Points ``(..., 3)`` of Habitat's world in ours."""
        found = from_gltf(np.asarray(points, dtype=np.float64))
        found[..., 2] -= self.floor
        return found


def read_category(category: str) -> str:
    """A category of Habitat's files and scenes in our words: lower case, our spelling."""
    words = " ".join(category.replace("_", " ").replace("/", " ").lower().split())
    return SYNONYMS.get(words, words)


@dataclass(frozen=True, eq=False)
class Labels:
    """Finds the instance in each direction of a panorama: `ids` ``(H, W)`` int32, -1 for none.

    If `raw`, of Habitat's semantic ids ``(H, W)``; otherwise of points ``(H, W, 3)``: what is seen, our world, NaN for
    no hit.
    """

    raw: bool
    ids: Callable[[np.ndarray], np.ndarray]


class HabitatView:
    """The renderer of one scene: an `eagor.lab.worlds.View`."""

    def __init__(self, session: Session, frames: Frames, labels: Labels | None) -> None:
        self.session, self.frames, self.labels = session, frames, labels

    def panorama(
        self, position: np.ndarray | tuple[float, float, float], world_R_body: np.ndarray, height: int, *,
        rgb: bool = True, range: bool = True, ids: bool = True,
    ) -> Frame:  # fmt: skip
        """The panorama ``(height, 2 height)`` from `position` ``(3,)``, metres, in the pose `world_R_body`.

        Cube maps of Habitat hold depth along the axis of each face; ranges here are metres along the ray. Raises
        `PoseError`, `RotationError`, `GridError`, and `WorldError` if the simulator cannot be opened.
        """
        place, rotation = checked_pose(position, world_R_body, height)
        labels = self.labels if ids else None
        by_ids, by_points = labels is not None and labels.raw, labels is not None and not labels.raw
        kinds = [kind for kind, wanted in zip(KINDS, (rgb, range or by_points, by_ids), strict=True) if wanted]
        seen = self.session.look(kinds, height, self.frames.to_habitat(place), rotation)
        metres = euclidean(seen["depth"]) if "depth" in seen else None
        shown = seen.get("semantic")
        if by_points and metres is not None:
            finite = np.where(np.isfinite(metres), metres, np.nan)[..., None]
            shown = place + finite * (ErpGrid(height, 2 * height).directions @ rotation.T)
        return Frame(
            np.ascontiguousarray(seen["color"][..., :3]) if rgb else None,
            metres if range else None,
            None if labels is None or shown is None else labels.ids(shown),
        )


def euclidean(depth: np.ndarray) -> np.ndarray:
    """Metres along the ray ``(H, 2 H)`` float32, inf for no hit, from the depth of an equirectangular sensor.

    That depth is measured along the axis of the face of a cube map that a pixel was taken from. The axis is the one
    along which the ray is longest: range = depth / max(abs(ray)). Depth is 0 where nothing is hit.
    """
    hit = (depth > 0) & (depth < FAR)
    return np.where(hit, depth * _stretch(len(depth)), np.float32(np.inf)).astype(np.float32)


@lru_cache(maxsize=4)
def _stretch(height: int) -> np.ndarray:
    """Range per depth ``(H, 2 H)`` float32: 1 at the middle of a face, sqrt(3) at the corners of the cube."""
    return frozen((1 / np.abs(ErpGrid(height, 2 * height).directions).max(axis=-1)).astype(np.float32))
