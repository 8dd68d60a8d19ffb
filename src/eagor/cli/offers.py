"""``eagor bench list`` and ``info``: which benchmarks there are, and what a folder with published files holds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from eagor.cli import terminal
from eagor.cli.columns import columns, facts
from eagor.cli.options import BenchInfo, BenchList
from eagor.errors import EagorError, FormatError


def listed(options: BenchList) -> int:
    """``eagor bench list``."""
    from eagor import worlds
    from eagor.tasks import benchmark, task

    places = sorted(worlds.known())
    broken = _broken(task, benchmark)
    found = {name: _told("simulated", name, broken, lambda name: _simulated(name, places)) for name in task.known()}
    found |= {name: _told("published data", name, broken, _published) for name in benchmark.known()}
    if options.json:
        terminal.emit(found)
        return terminal.OK
    simulated = {name: entry for name, entry in found.items() if entry["kind"] == "simulated"}
    print("Simulated, no data needed (eagor bench run TASK)")
    columns(
        {name: entry.get("what", f"not available ({entry.get('unavailable')})") for name, entry in simulated.items()}
    )
    print(f"  worlds (--world): {', '.join(places)}, or a GLB file\n")
    for name, entry in found.items():
        if name in simulated:
            continue
        if "unavailable" in entry:
            print(f"{name}: not available ({entry['unavailable']})\n")
            continue
        print(f"{name}  {entry['title']} (eagor bench run {name} --data DIR)")
        print("  agents")
        columns(entry["agents"])
        print("  options (--scoring, --labels, others with --set OPTION=VALUE)")
        columns({key: f"{value['what']} (default {value['default']})" for key, value in entry["options"].items()})
        print("  exports")
        columns(entry["exports"])
        print()
    return terminal.OK


def info(options: BenchInfo) -> int:
    """``eagor bench info``."""
    from eagor.tasks import benchmark

    found: dict[str, dict[str, Any]] = {}
    refused: dict[str, list[str]] = {}
    broken = {} if options.task else _broken(benchmark)
    for name in [options.task] if options.task else sorted(benchmark.known()):
        if name in broken:
            refused.setdefault(broken[name], []).append(name)
            continue
        try:
            told = benchmark.load(name).info(options.data)
        except EagorError as error:
            refused.setdefault(str(error), []).append(name)
            continue
        if told not in found.values():
            found[name] = told
    if not found:
        reasons = "; ".join(f"as {', '.join(names)}: {why}" for why, names in refused.items())
        raise FormatError(f"{options.data} is no benchmark's data that is known here; " + reasons)
    if options.json:
        terminal.emit(found)
        return terminal.OK
    for told in found.values():
        facts(told)
    return terminal.OK


def _broken(*parts: Any) -> dict[str, str]:
    """What others bring to `parts` and cannot be imported, by name, and why."""
    from eagor import plugins

    theirs = [point for part in parts for point in plugins.brought(part.GROUP, part.BUILT_IN)]
    return {point.name: f"cannot be imported ({why})" for point, why in plugins.faults(theirs).items()}


def _told(kind: str, name: str, broken: dict[str, str], tell: Callable[[str], dict[str, Any]]) -> dict[str, Any]:
    """What `tell` says of a task or benchmark, or why nothing can be said of it."""
    if name in broken:
        return {"kind": kind, "unavailable": broken[name]}
    try:
        return {"kind": kind, **tell(name)}
    except Exception as error:  # a broken plugin may raise anything
        return {"kind": kind, "unavailable": str(error) if isinstance(error, EagorError) else repr(error)}


def _simulated(name: str, places: list[str]) -> dict[str, Any]:
    from eagor.tasks import task

    found = task.load(name)
    return {"title": found.title, "what": found.what, "worlds": places}


def _published(name: str) -> dict[str, Any]:
    from eagor.tasks import benchmark

    found = benchmark.load(name)
    return {
        "title": found.title,
        "agents": dict(found.agents),
        "options": {
            key: {"default": o.default, "what": o.what, "choices": _short(o.choices)}
            for key, o in found.options.items()
        },
        "exports": {"jsonl": "samples as JSON lines with lmms-eval's keys", **found.exports},
    }


def _short(choices: tuple[Any, ...]) -> Any:
    """Ranges of numbers as their ends: nobody reads fifty of them."""
    if len(choices) > 8 and all(isinstance(choice, int) for choice in choices):
        return f"{min(choices)} to {max(choices)}"
    return list(choices)
