"""Habitat-Sim: its simulators, and what a camera sees in them, in our coordinates.

A wrong device, a missing EGL or a damaged scene ends the process that tries it, not with a Python exception. So another
process tries first, and its end is told in one sentence.

A session is all that touches Habitat-Sim's simulator. A session that looks closes that of another, which opens again at
its next look: each holds the textures of a whole building, and all simulators of a process draw with the graphics
context of the first, so that the process ends when one draws after the first was closed.

Habitat's world has Y up; its x is ours, its Z is our -y (`eagor.conventions.to_gltf`), as in exported GLB files and
ObjectNav episodes. Heights differ by the floor of the chosen storey: our z = 0 is Habitat's y = `Frames.floor`. A
camera's own axes are x right, y up, z backward.
"""

from __future__ import annotations

import atexit
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
from eagor.lab.worlds.scene import Instance
from eagor.queries import SYNONYMS

__all__ = [
    "Frames", "HabitatView", "Session", "close_all", "device_for", "import_habitat", "read_category", "simulator_of",
    "try_to_open",
]  # fmt: skip

HOW_TO_GET = (
    "it is on no package registry: conda install -c conda-forge -c aihabitat habitat-sim headless, or build it from "
    "the sources of facebookresearch/habitat-sim (pip install . there)"
)
TIMEOUT = 300.0  # seconds for a process of its own: opening a scene or making a mesh takes a few
FIRST_ROWS = 64  # of the sensors with which a simulator is made; others are added when they are asked for
KINDS = ("color", "depth", "semantic")
FAR = 999.0  # metres: the far plane is at 1000
LOOSE = 0.03  # metres by which a box is widened: depth is exact to a centimetre


@dataclass(frozen=True)
class Source:
    """What Habitat-Sim opens: `scene_id`, the scene dataset's configuration, and the GPU (None: found by trying).

    `name`: for errors, as the path of a written stage configuration says nothing.
    """

    scene_id: str
    dataset: str = "default"
    gpu: int | None = None
    name: str = ""


def import_habitat() -> Any:
    """The module `habitat_sim`, with its logging silenced. Raises `MissingExtraError`, or `WorldError` if it fails."""
    _need()
    try:
        import habitat_sim  # pyright: ignore[reportMissingImports]
    except Exception as error:  # a broken build raises what it likes
        raise WorldError(BROKEN.format(f"{type(error).__name__}: {error}"[:300])) from error
    return habitat_sim


def _need() -> None:
    """Raise `MissingExtraError` without Habitat-Sim; if it is there, keep its logs off stdout, which is for results."""
    if "habitat_sim" not in sys.modules and find_spec("habitat_sim") is None:
        raise MissingExtraError(f"the world habitat needs Habitat-Sim (the module habitat_sim); {HOW_TO_GET}")
    for name, level in (("MAGNUM_LOG", "quiet"), ("HABITAT_SIM_LOG", "quiet"), ("GLOG_minloglevel", "2")):
        os.environ.setdefault(name, level)


def simulator_of(source: Source, device: int, kinds: Sequence[str] = KINDS) -> Any:
    """A simulator with equirectangular sensors at the agent's origin, which needs no graphics without any.

    With a sensor of colour, each simulator prepares lights: on the CPU, that takes most of the time that it starts.
    """
    habitat_sim = import_habitat()
    settings = habitat_sim.SimulatorConfiguration()
    settings.scene_id = source.scene_id
    settings.scene_dataset_config_file = source.dataset
    settings.gpu_device_id = device
    settings.allow_sliding = False
    settings.enable_physics = False
    settings.create_renderer = settings.load_semantic_mesh = bool(kinds)
    settings.random_seed = 0
    agent = habitat_sim.agent.AgentConfiguration()
    agent.sensor_specifications = [sensor_of(kind, FIRST_ROWS) for kind in kinds]
    return habitat_sim.Simulator(habitat_sim.Configuration(settings, [agent]))


def sensor_of(kind: str, rows: int) -> Any:
    """An equirectangular sensor of this kind at the agent's origin."""
    habitat_sim = import_habitat()
    spec = habitat_sim.EquirectangularSensorSpec()
    spec.uuid = f"{kind} {rows}"
    spec.sensor_type = getattr(habitat_sim.SensorType, kind.upper())
    spec.sensor_subtype = habitat_sim.SensorSubType.EQUIRECTANGULAR
    spec.resolution = [rows, 2 * rows]
    spec.position = [0.0, 0.0, 0.0]  # floats: whole numbers are refused
    spec.channels = 4 if kind == "color" else 1
    return spec


def mesh_settings(chosen: Mapping[str, Any]) -> Any:
    """Habitat's NavMeshSettings: its own defaults but for what is chosen."""
    settings = import_habitat().NavMeshSettings()
    settings.set_defaults()
    for name, value in chosen.items():
        setattr(settings, name, value)
    return settings


# --- whether Habitat-Sim can open a scene here, and on which device, found out in another process ---------------------

CPU = -1
_MARK = "eagor probe: "  # of our lines: libraries write to stdout, too
BROKEN = (
    "Habitat-Sim is installed, but cannot be imported ({}); it needs the NumPy that it was built for, and libEGL: "
    "install it again"
)


@lru_cache
def device_for(source: Source) -> int:
    """The device with which a scene opens: the source's GPU, or an NVIDIA card if there is one, or the CPU.

    Raises `MissingExtraError` without Habitat-Sim, and `WorldError` if no simulator can be made, or not of this scene.
    """
    _need()
    found = [0, CPU] if Path("/proc/driver/nvidia/version").exists() else [CPU]
    device, stage, last = CPU, "", ""
    for device in found if source.gpu is None else [source.gpu]:
        out, last = run_apart(try_to_open, source.scene_id, source.dataset, str(device))
        stage = next((line for line in reversed(out.splitlines()) if line.startswith(_MARK)), "").removeprefix(_MARK)
        if stage == "opened":
            return device
    if stage == "drawn":
        name = source.name or source.scene_id
        raise WorldError(
            f"Habitat-Sim cannot open the scene {name!r} ({last}); is it complete, and does the dataset list it?"
        )
    if stage == "imported" and device == CPU:
        raise WorldError(
            f"Habitat-Sim cannot draw on the CPU ({last}): it needs EGL with Mesa's software renderer (Debian, Ubuntu: "
            "libegl1, libgl1-mesa-dri), and a headless build of Habitat-Sim"
        )
    if stage == "imported":
        raise WorldError(
            f"Habitat-Sim cannot draw on GPU {device} ({last}): there is no such NVIDIA card with EGL here; use "
            "another number, or the CPU: habitat:SCENE?gpu=-1"
        )
    raise WorldError(BROKEN.format(last))


def try_to_open(scene_id: str, dataset: str, device: str) -> None:
    """Open a scene, and say after each stage what has worked. Runs in a process of its own."""
    _need()
    import habitat_sim  # noqa: F401  # pyright: ignore[reportMissingImports]

    print(f"{_MARK}imported", flush=True)
    simulator_of(Source("NONE"), int(device), ("depth",)).close()
    print(f"{_MARK}drawn", flush=True)
    simulator_of(Source(scene_id, dataset), int(device), ("depth",)).close()
    print(f"{_MARK}opened", flush=True)


def run_apart(work: Callable[..., None], *words: str) -> tuple[str, str]:
    """Call a function of ours in a process of its own, as Habitat-Sim may end the process that it runs in.

    What it wrote to stdout, and the last line of stderr, or why there is none.
    """
    program = f"import sys; from {work.__module__} import {work.__name__} as work; work(*sys.argv[1:])"
    try:
        done = subprocess.run(
            [sys.executable, "-c", program, *words], stdin=subprocess.DEVNULL, capture_output=True, timeout=TIMEOUT,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )  # fmt: skip
    except subprocess.TimeoutExpired as late:
        return (late.stdout or b"").decode(errors="replace"), f"it took longer than {TIMEOUT:.0f} s"
    errors = done.stderr.decode(errors="replace").split("\n")
    last = next((line.strip() for line in reversed(errors) if line.strip()), "it ended without a word")
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
            self._sim = simulator_of(self.source, device)
            _open.append(self)
        return self._sim

    def render(
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
                sim.add_sensor(sensor_of(kind, rows))
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
        return to_gltf(np.asarray(points, dtype=np.float64)) + np.array([0.0, self.floor, 0.0])

    def from_habitat(self, points: np.ndarray) -> np.ndarray:
        """Points ``(..., 3)`` of Habitat's world in ours."""
        return from_gltf(np.asarray(points, dtype=np.float64)) - np.array([0.0, 0.0, self.floor])


def read_category(category: str) -> str:
    """A category of Habitat's files and scenes in our words: lower case, our spelling."""
    words = " ".join(category.replace("_", " ").replace("/", " ").lower().split())
    return SYNONYMS.get(words, words)


class HabitatView:
    """The renderer of one scene: an `eagor.lab.worlds.View`.

    `index`: our index of each of Habitat's semantic ids, ``(n,)`` int32, the last (-1) for ids beyond; None: a pixel
    shows the smallest box of `instances` that contains its point.
    """

    def __init__(
        self, session: Session, frames: Frames, instances: Sequence[Instance] = (), index: np.ndarray | None = None
    ) -> None:
        self.session, self.frames, self.instances, self.index = session, frames, instances, index

    def panorama(
        self, position: np.ndarray | tuple[float, float, float], world_R_body: np.ndarray, height: int, *,
        rgb: bool = True, range: bool = True, ids: bool = True,
    ) -> Frame:  # fmt: skip
        """The panorama ``(height, 2 height)`` from `position` ``(3,)``, metres, in the pose `world_R_body`.

        Cube maps of Habitat hold depth along the axis of each face; ranges here are metres along the ray. Raises
        `PoseError`, `RotationError`, `GridError`, and `WorldError` if the simulator cannot be opened.
        """
        place, rotation = checked_pose(position, world_R_body, height)
        by_box = ids and self.index is None
        kinds = [kind for kind, wanted in zip(KINDS, (rgb, range or by_box, ids and not by_box), strict=True) if wanted]
        seen = self.session.render(kinds, height, self.frames.to_habitat(place), rotation)
        metres = euclidean(seen["depth"]) if "depth" in seen else None
        shown = None
        if by_box and metres is not None:
            finite = np.where(np.isfinite(metres), metres, np.nan)[..., None]
            shown = self._in_boxes(place + finite * (ErpGrid(height, 2 * height).directions @ rotation.T))
        elif ids and self.index is not None:
            shown = self.index[np.minimum(seen["semantic"], len(self.index) - 1).astype(np.intp)]
        return Frame(
            np.ascontiguousarray(seen["color"][..., :3]) if rgb else None, metres if range else None, shown
        )  # fmt: skip

    def _in_boxes(self, points: np.ndarray) -> np.ndarray:
        """The smallest box around each point ``(H, W, 3)``, the first of equal ones, -1 if there is none."""
        sizes = [float(np.prod(np.maximum(thing.high - thing.low, LOOSE))) for thing in self.instances]
        found = np.full(points.shape[:-1], -1, dtype=np.int32)
        for index in reversed(np.argsort(sizes, kind="stable")):  # smaller ones over larger ones
            low, high = self.instances[index].low - LOOSE, self.instances[index].high + LOOSE
            found[((points >= low) & (points <= high)).all(axis=-1)] = index
        return found


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
