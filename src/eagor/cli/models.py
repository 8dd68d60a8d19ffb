"""``eagor models``: detectors that install by name. List, get; and what to get for a query."""

from __future__ import annotations

from typing import Any

from eagor._extras import how_to_install
from eagor.cli import terminal
from eagor.cli.machine import lacking
from eagor.cli.options import Models, ModelsGet, ModelsList
from eagor.errors import QueryError
from eagor.perception.coco import CLASSES, COCO, MODELS, Model, install, model_named
from eagor.perception.words import for_any_words, meant


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


def how_to_find(query: str) -> str:
    """Why `query` cannot be answered, and what to type: the small detector if it knows `query`, else other models."""
    own = "a detector of your own is --perception onnx:MODEL.onnx or replay:FILE.jsonl (docs/how-to/detector.md)"
    try:
        meant(query, CLASSES, described=True)
    except QueryError:
        return (
            f"no detector for {query!r} is installed, and the small one for everyday things (eagor models get coco) "
            f"does not know it either. For any words: {for_any_words()}. And {own}"
        )
    first = f"{how_to_install('photos')}; then " if lacking("photos") else ""
    return (
        f"no detector for {query!r} is installed. To get a small one for everyday things: {first}eagor models get "
        f"{COCO.name} (fetches {COCO.package.size / 1e6:.0f} MB once). Or {own}"
    )
