"""Whether Habitat-Sim can open a scene here, and on which device, found out in another process.

A wrong device, a missing EGL or a damaged scene ends the process that tries it, not with a Python exception. So another
process tries first, and its end is told in one sentence. The result holds for this process and for those that it
starts.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from eagor.errors import MissingExtraError, WorldError

__all__ = ["HOW_TO_GET", "device_for", "import_habitat"]

HOW_TO_GET = (
    "it is on no package registry: conda install -c conda-forge -c aihabitat habitat-sim headless, or build it from "
    "the sources of facebookresearch/habitat-sim (pip install . there)"
)
GPU = "EAGOR_HABITAT_GPU"  # environment: the device for all scenes, -1 for the CPU
PROBED = "EAGOR_HABITAT_PROBED"  # environment of the processes that this one starts: what was found out
PATIENCE = 300.0  # seconds until a scene that opens so slowly counts as one that cannot be opened
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


def device_for(scene_id: str, dataset: str, gpu: int | None = None, name: str = "") -> int:
    """The device with which this scene opens: `gpu`, $EAGOR_HABITAT_GPU, an NVIDIA card if there is one, or the CPU.

    `name`: of the scene, if its id differs from process to process. Raises `MissingExtraError` without Habitat-Sim, and
    `WorldError` if no simulator can be made, or not of this scene.
    """
    _need()
    if gpu is None:
        gpu = _from_environment()
    key = json.dumps([name or scene_id, dataset, gpu])
    _found.update(json.loads(os.environ.get(PROBED, "{}")))
    if key not in _found:
        chosen, why = [gpu] if gpu is not None else [0, CPU] if _has_nvidia() else [CPU], None
        for device in chosen:
            why = _try(scene_id, dataset, device, name)
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


def _try(scene_id: str, dataset: str, device: int, name: str) -> str | None:
    """Why the scene cannot be opened on this device, as a sentence; None if it can."""
    there, here = os.pipe()  # its end tells the other process that this one is gone
    code = f"from eagor.worlds.habitat.probe import main; main({[scene_id, dataset, device]!r}, {there})"
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            pass_fds=(there,),
            text=True,
            errors="replace",
        )
    finally:
        os.close(there)
    late = False
    try:
        out, err = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        out, err = process.communicate()
        late = True
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
        os.close(here)
    said = [line.removeprefix(_MARK) for line in out.splitlines() if line.startswith(_MARK)]
    stage = said[-1] if said else ""
    if stage == "done":
        return None
    words = [line.strip() for line in err.splitlines() if line.strip()]
    last = f"it took longer than {PATIENCE:.0f} s" if late else words[-1][:300] if words else "it ended without a word"
    return _sentence(stage, name or scene_id, dataset, device, last)


def _sentence(stage: str, scene_id: str, dataset: str, device: int, last: str) -> str:
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
            f"the scene dataset {dataset} has no scene {scene_id!r}; wanted one that its stages or scene instances "
            "list, or the scene's own file"
        )
    return f"Habitat-Sim cannot open the scene {scene_id!r} ({last}); is it complete, and does the dataset list it?"


def _broken(why: str) -> str:
    return (
        f"Habitat-Sim is installed, but cannot be imported ({why[:300]}); it needs the NumPy that it was built for, "
        "and libEGL: install it again"
    )


def main(asked: list[Any], line: int) -> None:
    """Try to open a scene, and say before each stage which it is. Runs in a process of its own, until `line` ends."""

    def leave() -> None:
        os.read(line, 1)
        os._exit(1)

    threading.Thread(target=leave, daemon=True).start()
    scene_id, dataset, device = asked
    _quieten()
    import habitat_sim  # pyright: ignore[reportMissingImports]

    from eagor.worlds.habitat.configuring import Source, configured

    _say("context")
    for stage, source in (("scene", Source("NONE")), ("done", Source(scene_id, dataset))):
        habitat_sim.Simulator(configured(habitat_sim, source, device, 8, ("depth",))).close()
        _say(stage)
    sys.stdout.flush()
    os._exit(0)  # libraries may fail while they are unloaded


def _say(stage: str) -> None:
    print(f"{_MARK}{stage}", flush=True)
