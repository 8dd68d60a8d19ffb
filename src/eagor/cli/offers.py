"""``eagor bench list`` and ``info``: which benchmarks there are, and what a folder with published files holds."""

from __future__ import annotations

from typing import Any

from eagor.cli import terminal
from eagor.cli.columns import columns, facts
from eagor.cli.options import BenchInfo, BenchList
from eagor.errors import EagorError, FormatError


def listed(options: BenchList) -> int:
    """``eagor bench list``."""
    from eagor import worlds
    from eagor.tasks import benchmark, task

    found: dict[str, Any] = {}
    places = sorted(worlds.known())
    for name in task.known():
        try:
            simulated = task.load(name)
        except EagorError as error:
            found[name] = {"kind": "simulated", "unavailable": str(error)}
            continue
        found[name] = {"kind": "simulated", "title": simulated.title, "what": simulated.what, "worlds": places}
    for name in benchmark.known():
        try:
            known = benchmark.load(name)
        except EagorError as error:
            found[name] = {"kind": "published data", "unavailable": str(error)}
            continue
        found[name] = {
            "kind": "published data",
            "title": known.title,
            "agents": dict(known.agents),
            "options": {
                key: {"default": o.default, "what": o.what, "choices": _short(o.choices)}
                for key, o in known.options.items()
            },
            "exports": {"jsonl": "samples as JSON lines with lmms-eval's keys", **known.exports},
        }
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
    for name in [options.task] if options.task else sorted(benchmark.known()):
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


def _short(choices: tuple[Any, ...]) -> Any:
    """Ranges of numbers as their ends: nobody reads fifty of them."""
    if len(choices) > 8 and all(isinstance(choice, int) for choice in choices):
        return f"{min(choices)} to {max(choices)}"
    return list(choices)
