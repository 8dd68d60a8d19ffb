"""``eagor demo``: one search in a furnished apartment, every method on its own way, and a report of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from eagor.cli import terminal
from eagor.cli.demo_report import write_report
from eagor.cli.demo_search import Search, play, summary
from eagor.cli.looking import check_looks, checked_folder
from eagor.cli.options import Demo
from eagor.tasks.episodes import PER_PLACE
from eagor.tasks.methods import DESCRIPTIONS, NAMES
from eagor.tasks.places import SEEDS


def demo(options: Demo) -> int:
    """Run the command; returns its exit code."""
    if not 0 <= options.seed < SEEDS:
        raise terminal.UsageError(f"--seed {options.seed}; wanted an apartment, 0 to {SEEDS - 1}")
    if not 0 <= options.episode < PER_PLACE:
        raise terminal.UsageError(f"--episode {options.episode}; wanted 0 to {PER_PLACE - 1}")
    checked_folder(options.out)
    check_looks(options.perception)
    search = play(options.seed, options.episode, options.perception, say=not options.json)
    report = write_report(search, options.out)
    if options.json:
        terminal.emit(_as_json(search, options, report))
    else:
        print("\n" + "\n".join(as_text(search)) + "\n\n" + "\n".join(summary(search)))
        print(f"\nThe report with pictures: {report}")
    return terminal.OK


def as_text(search: Search) -> list[str]:
    """One line per method."""
    lines = [f"{'':18}{'found':>7}{'steps':>7}{'walked':>9}{'SPL':>6}{'error':>9}"]
    for name in sorted(search.methods, key=NAMES.index):
        m = search.methods[name]["metrics"]
        lines.append(
            f"{name:18}{'yes' if m['success'] else 'no':>7}{m['steps']:>7}{m['path_m']:>7.1f} m{100 * m['spl']:>6.0f}"
            f"{m['mae']:>7.1f} °"
        )
    return lines


def _as_json(search: Search, options: Demo, report: Path) -> dict[str, Any]:
    return {
        "query": search.thing,
        "scene": search.episode["scene"],
        "seed": options.seed,
        "episode": options.episode,
        "perception": options.perception,
        "methods": {name: part["metrics"] for name, part in search.methods.items()},
        "what": {name: DESCRIPTIONS[name] for name in search.methods},
        "summary": summary(search),
        "report": str(report),
    }
