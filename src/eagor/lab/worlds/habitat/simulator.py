"""Habitat-Sim: its simulators, and what a camera sees in them, in our coordinates.

A wrong device, a missing EGL or a damaged scene ends the process that tries it, not with a Python exception. So another
process tries first, and its end is told in one sentence. The result holds for this process and for those that it
starts.

A session is all that touches Habitat-Sim's simulator. Another session may close its simulator; the next look opens it
again. All simulators of a process draw with the graphics context of the first, and the process ends when one draws
after the first was closed. So the first is one without a scene, which is closed last.

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
import threading
from collections.abc import Callable, Sequence
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

FIRST_ROWS = 64  # of the sensors with which a simulator is made; others are added when they are asked for
KINDS = ("color", "depth", "semantic")
PATIENCE = (
    300.0  # seconds for a process of its own: a mesh, of which an apartment takes less than one, or opening a scene
)


@dataclass(frozen=True)
class Source:
    """What Habitat-Sim opens: `scene_id`, the scene dataset's configuration, and the GPU (None: found by the probe).

    `name`: the same in every process, unlike the path of a written stage configuration.
    """

    scene_id: str
    dataset: str = "default"
    gpu: int | None = None
    name: str = ""

    @property
    def title(self) -> str:
        """Its name, or its id."""
        return self.name or self.scene_id


def configured(habitat_sim: Any, source: Source, gpu: int, rows: int = FIRST_ROWS, kinds: Sequence[str] = KINDS) -> Any:
    """The configuration of a simulator with equirectangular sensors at the agent's origin, without sliding.

    With a sensor of colour, each simulator prepares lights: on the CPU, that takes most of the time that it starts.
    """
    settings = habitat_sim.SimulatorConfiguration()
    settings.scene_id = source.scene_id
    settings.scene_dataset_config_file = source.dataset
    settings.gpu_device_id = gpu
    settings.allow_sliding = False
    settings.enable_physics = False
    settings.random_seed = 0
    agent = habitat_sim.agent.AgentConfiguration()
    agent.sensor_specifications = [sensor_of(habitat_sim, kind, rows) for kind in kinds]
    return habitat_sim.Configuration(settings, [agent])


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


# --- whether Habitat-Sim can open a scene here, and on which device, found out in another process ---------------------

HOW_TO_GET = (
    "it is on no package registry: conda install -c conda-forge -c aihabitat habitat-sim headless, or build it from "
    "the sources of facebookresearch/habitat-sim (pip install . there)"
)
GPU = "EAGOR_HABITAT_GPU"  # environment: the device for all scenes, -1 for the CPU
PROBED = "EAGOR_HABITAT_PROBED"  # environment of the processes that this one starts: what was found out
CPU = -1
_MARK = "eagor probe: "  # of our lines: libraries write to stdout, too
_found: dict[str, int] = {}


def import_habitat() -> Any:
    """The module `habitat_sim`, with its logging silenced. Raises `MissingExtraError`, or `WorldError` if it fails."""
    _need()
    _quieten()
    try:
        import habitat_sim  # pyright: ignore[reportMissingImports]
    except Exception as error:  # a broken build raises what it likes
        raise WorldError(_broken(f"{type(error).__name__}: {error}")) from error
    return habitat_sim


def device_for(source: Source) -> int:
    """The device with which a scene opens: its GPU, $EAGOR_HABITAT_GPU, an NVIDIA card if there is one, or the CPU.

    Raises `MissingExtraError` without Habitat-Sim, and `WorldError` if no simulator can be made, or not of this scene.
    """
    _need()
    gpu = _from_environment() if source.gpu is None else source.gpu
    key = json.dumps([source.title, source.dataset, gpu])
    _found.update(json.loads(os.environ.get(PROBED, "{}")))
    if key not in _found:
        chosen, why = [gpu] if gpu is not None else [0, CPU] if _has_nvidia() else [CPU], None
        for device in chosen:
            why = _try(source, device)
            if why is None:
                _found[key] = device
                break
        else:
            raise WorldError(why)
        os.environ[PROBED] = json.dumps(_found)
    return _found[key]


def _need() -> None:
    if "habitat_sim" not in sys.modules and find_spec("habitat_sim") is None:
        raise MissingExtraError(f"the world habitat needs Habitat-Sim (the module habitat_sim); {HOW_TO_GET}")


def _from_environment() -> int | None:
    text = os.environ.get(GPU, "")
    if not text:
        return None
    try:
        return int(text)
    except ValueError:
        raise WorldError(f"{GPU} = {text!r}; wanted the number of a GPU, or -1 for the CPU") from None


def _has_nvidia() -> bool:
    return Path("/proc/driver/nvidia/version").exists() or Path("/dev/nvidia0").exists()


def _quieten() -> None:
    """Let Habitat-Sim and its libraries write nothing but errors: they would write to stdout, which is for results."""
    for name, level in (("MAGNUM_LOG", "quiet"), ("HABITAT_SIM_LOG", "quiet"), ("GLOG_minloglevel", "2")):
        os.environ.setdefault(name, level)


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


def _try(source: Source, device: int) -> str | None:
    """Why the scene cannot be opened on this device, as a sentence; None if it can."""
    program = "import sys; from eagor.lab.worlds.habitat.simulator import main; main(*sys.argv[1:])"
    code, out, err = run_apart(program, source.scene_id, source.dataset, str(device))
    said = [line.removeprefix(_MARK) for line in out.splitlines() if line.startswith(_MARK)]
    stage = said[-1] if said else ""
    if stage == "done":
        return None
    words = [line.strip() for line in err.splitlines() if line.strip()]
    last = words[-1][:300] if words else "it ended without a word"
    last = f"it took longer than {PATIENCE:.0f} s" if code is None else last
    return _sentence(stage, source, device, last)


def _sentence(stage: str, source: Source, device: int, last: str) -> str:
    """What failed after `stage`, whose process last said `last`, and what to do."""
    if stage == "":
        return _broken(last)
    if stage == "context" and device != CPU:
        return (
            f"Habitat-Sim cannot draw on GPU {device} ({last}): there is no such NVIDIA card with EGL here; use "
            f"another number, or the CPU: habitat:SCENE?gpu=-1, or {GPU}=-1"
        )
    if stage == "context":
        return (
            f"Habitat-Sim cannot draw on the CPU ({last}): it needs EGL with Mesa's software renderer (Debian, Ubuntu: "
            "libegl1, libgl1-mesa-dri), and a headless build of Habitat-Sim"
        )
    if "No Stage Attributes exists" in last:
        return (
            f"the scene dataset {source.dataset} has no scene {source.title!r}; wanted one that its stages or scene "
            "instances list, or the scene's own file"
        )
    return f"Habitat-Sim cannot open the scene {source.title!r} ({last}); is it complete, and does the dataset list it?"


def _broken(why: str) -> str:
    return (
        f"Habitat-Sim is installed, but cannot be imported ({why[:300]}); it needs the NumPy that it was built for, "
        "and libEGL: install it again"
    )


def main(scene_id: str, dataset: str, device: str, line: str) -> None:
    """Try to open a scene, and say before each stage which it is. Runs in a process of its own, until `line` ends."""
    threading.Thread(target=lambda: (os.read(int(line), 1), os._exit(1)), daemon=True).start()
    _quieten()
    import habitat_sim  # pyright: ignore[reportMissingImports]

    _say("context")
    for stage, source in (("scene", Source("NONE")), ("done", Source(scene_id, dataset))):
        habitat_sim.Simulator(configured(habitat_sim, source, int(device), 8, ("depth",))).close()
        _say(stage)
    sys.stdout.flush()
    os._exit(0)  # libraries may fail while they are unloaded


def _say(stage: str) -> None:
    print(f"{_MARK}{stage}", flush=True)


# --- the simulators that are open in this process ---------------------------------------------------------------------

MOST = 2  # simulators open at a time: each holds the textures of a whole building

_open: list[Session] = []  # least recently used first
_keeper: list[Any] = []  # a simulator without a scene, open as long as any other is


class Session:
    """One scene, whose simulator is opened on demand."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self._sim: Any = None
        self._sensors: set[str] = set()

    @property
    def sim(self) -> Any:
        """The simulator (`habitat_sim.Simulator`). Raises `WorldError` if it cannot be made."""
        if self._sim is None:
            while len(_open) >= MOST:
                _open[0].close()
            device = device_for(self.source)
            if not _keeper:
                _keeper.append(_made(Source("NONE"), device, 8, ("depth",)))
            self._sim = _made(self.source, device)
            self._sensors = {f"{kind} {FIRST_ROWS}" for kind in KINDS}
        else:
            _open.remove(self)
        _open.append(self)
        return self._sim

    def look(
        self, kinds: Sequence[str], rows: int, position: np.ndarray, quaternion: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Equirectangular pictures by kind ("color", "depth", "semantic"), of `rows` rows, in Habitat's world.

        `position` ``(3,)`` and `quaternion` ``(4,)``, w first, of the camera.
        """
        import magnum  # pyright: ignore[reportMissingImports]

        sim, names = self.sim, {kind: f"{kind} {rows}" for kind in kinds}
        for kind, name in names.items():
            if name not in self._sensors:
                sim.add_sensor(sensor_of(import_habitat(), kind, rows))
                self._sensors.add(name)
        body = sim.agents[0].scene_node
        w, x, y, z = (float(value) for value in quaternion)
        body.translation = magnum.Vector3(*(float(value) for value in position))
        body.rotation = magnum.Quaternion(magnum.Vector3(x, y, z), w)
        registry = getattr(sim, "sensors", None) or sim._sensors  # 0.3.3 has no public name for it
        sensors = {kind: registry[name] for kind, name in names.items()}
        for sensor in sensors.values():
            sensor.draw_observation()
        return {kind: sensor.get_observation() for kind, sensor in sensors.items()}

    def close(self) -> None:
        """Close the simulator, if it is open."""
        if self._sim is not None:
            _open.remove(self)
            sim, self._sim, self._sensors = self._sim, None, set()
            sim.close()
        if not _open:
            _close_keeper()


def close_all() -> None:
    """Close all simulators of this process."""
    while _open:
        _open[0].close()
    _close_keeper()


def _close_keeper() -> None:
    while _keeper:
        _keeper.pop().close()


atexit.register(close_all)


def _made(source: Source, gpu: int, rows: int = FIRST_ROWS, kinds: Sequence[str] = KINDS) -> Any:
    habitat_sim = import_habitat()
    try:
        return habitat_sim.Simulator(configured(habitat_sim, source, gpu, rows, kinds))
    except Exception as error:  # C++ errors come as RuntimeError, among others
        raise WorldError(
            f"Habitat-Sim cannot open {source.title!r} on device {gpu} ({type(error).__name__}: "
            f"{str(error).strip()[:300]}); is the scene complete?"
        ) from error


# --- what a camera sees in Habitat-Sim, in our coordinates ------------------------------------------------------------


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

    def box_from_habitat(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner ``(3,)`` of an axis-aligned box, in our world."""
        corners = self.from_habitat(np.stack([low, high]))
        return corners.min(axis=0), corners.max(axis=0)

    def quaternion(self, world_R_body: np.ndarray) -> np.ndarray:
        """Habitat's rotation ``(4,)``, w first, of a camera with our pose `world_R_body`. Raises `RotationError`."""
        return wxyz_from_rotation(pose_to_habitat(world_R_body))


FAR = 999.0  # metres: the far plane is at 1000


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
        by_ids, by_points = (labels is not None and labels.raw is raw for raw in (True, False))
        wanted = {"color": rgb, "depth": range or by_points, "semantic": by_ids}
        kinds = [kind for kind in KINDS if wanted[kind]]
        seen = self.session.look(kinds, height, self.frames.to_habitat(place), self.frames.quaternion(rotation))
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
