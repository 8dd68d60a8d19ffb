"""``eagor doctor``: what is installed, what is missing, and which models can run."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from typing import Any, ClassVar

from eagor._extras import EXTRAS
from eagor._processes import usable_cores
from eagor._version import __version__
from eagor.cli import models, terminal
from eagor.cli.options import Common
from eagor.errors import MissingExtraError
from eagor.perception.coco import MODELS


@dataclass(frozen=True, kw_only=True)
class Doctor(Common):
    """Show what is installed (with plugins), which models this machine can run, and what to install for them."""

    runs: ClassVar[str] = "doctor"


PACKAGES = ("numpy", "scipy", "array-api-compat", "pillow", "matplotlib", "tyro", "rich", "msgspec")
USES = {
    **models.USES, "ray": "runs on a cluster", "parquet": "tables as Parquet files",
    "robot": "live cameras, ROS 2, robots", "rerun": "logs for the Rerun viewer",
}  # fmt: skip
OPTIONAL = {
    name: "; ".join(f"{USES[extra]}: the extra '{extra}'" for extra, names in EXTRAS.items() if name in names)
    for name in dict.fromkeys(name for names in EXTRAS.values() for name in names)
}
OPTIONAL |= {"embreex": "faster rays in simulated worlds: the extra 'sim'"}
WANTS = {
    "endpoint": "endpoint",
    "onnx": "photos",
    "scout": "sim",
}  # perceptions, and the extra that they want beyond what they import
READY = "ready"


def doctor(options: Doctor) -> int:
    """Run the command; exit code 1 if a required package is missing."""
    from eagor import perception, plugins, worlds
    from eagor.tasks import benchmark, task

    found = {name: models.version_of(name) for name in PACKAGES}
    optional = {name: models.version_of(name) for name in OPTIONAL}
    here = models.this_machine()
    parts = (perception, worlds, task, benchmark)  # what plugins can extend
    points = {part.GROUP.removeprefix("eagor."): part.known() for part in parts}
    theirs = [point for part in parts for point in plugins.brought(part.GROUP, part.BUILT_IN)]
    faults = plugins.faults(theirs)
    known = {
        kind: {name: _state(each[name], faults, each[name] in theirs) for name in sorted(each)}
        for kind, each in points.items()
    }
    for name, extra in WANTS.items():
        if known["perceptions"][name] == READY and (short := models.lacking(extra)):
            known["perceptions"][name] = f"wants {', '.join(short)} (the extra '{extra}')"
    if known["worlds"]["habitat"] == READY and find_spec("habitat_sim") is None:
        known["worlds"]["habitat"] = "wants Habitat-Sim (docs/how-to/habitat.md)"
    left_out = [
        text for kind, each in points.items() for at in each.values() for text in plugins.left_out(at, kind[:-1])
    ] + plugins.unreadable()
    detectors = {model.name: models.in_words(model) for model in MODELS.values()}
    cpu = {"name": _processor(), "cores": usable_cores()}
    healthy = all(found.values())
    if options.json:
        result: dict[str, Any] = {"eagor": __version__, "python": platform.python_version()}
        result |= {"platform": platform.platform(), "cpu": cpu, "packages": found, "optional": optional}
        result |= models.report(here) | known | {"detectors": detectors}
        terminal.emit(result | {"left_out": left_out, "healthy": healthy})
        return terminal.OK if healthy else terminal.FAILED
    print(f"eagor        {__version__}")
    print(f"python       {platform.python_version()} on {platform.platform()}")
    print(f"processor    {cpu['name']}, {cpu['cores']} cores for this process")
    print("packages     " + ", ".join(f"{name} {number or 'MISSING'}" for name, number in found.items()))
    for name, use in OPTIONAL.items():
        print(f"{name:12} " + (optional[name] or f"not installed ({use})"))
    for kind, states in known.items():
        for label, (name, state) in zip([kind, *[""] * len(states)], states.items(), strict=False):
            package = plugins.version_of(points[kind][name])
            print(f"{label:12} {name}: {state}" + (f" ({package})" if package else ""))
    for label, (name, state) in zip(["detectors", *[""] * len(detectors)], detectors.items(), strict=False):
        print(f"{label:12} {name}: {state}")
    for line in left_out:
        print(f"{'left out':12} {line}")
    for label, text in models.lines(here):
        print(f"{label:12} {text}")
    print("all there that eagor itself needs" if healthy else "something is missing: install eagor again with pip")
    return terminal.OK if healthy else terminal.FAILED


def _state(point: EntryPoint, faults: dict[EntryPoint, str], theirs: bool) -> str:
    """Whether `point` can be imported ("ready"), or why not; `theirs` (plugins) were tried in another process."""
    why = faults.get(point)
    if not theirs:
        try:
            point.load()
        except MissingExtraError as error:
            return str(error)
        except Exception as error:  # a broken installation may raise anything
            why = f"{type(error).__name__}: {error}"
    return f"cannot be imported ({why})" if why else READY


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.partition(":")[2].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.processor() or platform.machine()
