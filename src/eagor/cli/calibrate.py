"""``eagor calibrate``: record development episodes, fit, and write the calibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from eagor.cli import terminal
from eagor.cli.options import Calibrate

if TYPE_CHECKING:
    from eagor.perception.calibrated import Calibrated


def calibrate(options: Calibrate) -> int:
    """Run the command; returns its exit code."""
    from eagor.evaluation.calibration import record_episodes
    from eagor.evaluation.fitting import DRAWS, fit

    if min(options.workers, options.trials, options.episodes) < 1:
        raise terminal.UsageError(
            f"--workers {options.workers} --trials {options.trials} --episodes {options.episodes}; wanted 1 or more"
        )
    out = options.out or Path(f"calibration-{options.perception.partition(':')[0]}.json")
    with terminal.progress("looking", options.episodes) as advance:
        recordings = record_episodes(
            options.perception, options.episodes, options.seed, options.rows, advance, terminal.warning
        )
    terminal.log(f"{len(recordings)} episodes; trying {options.trials} settings, {DRAWS} at a time")
    with terminal.progress("fitting", options.trials) as advance:
        # Each round's best is kept, so that a fit that is stopped early is not lost.
        best = fit(options.perception, recordings, options.trials, options.workers, advance, lambda at: at.write(out))
    best.write(out)
    if options.json:
        terminal.emit(best.as_json() | {"out": str(out)})
    else:
        _print(best, out)
    return terminal.OK


def _print(best: Calibrated, out: Path) -> None:
    reading = best.as_json()["calibration"]
    print(f"{best.perception}: " + ", ".join(f"{name} {value}" for name, value in reading.items()))
    print("  " + ", ".join(f"{name} {value}" for name, value in best.forgetting.items()))
    print(f"On the other half of the apartments ({len(best.found_by['judged by'])}), means with 95 % intervals:")
    print(f"  {'':13s}{'before':>24s}{'after':>24s}")
    for name, after in best.found_by["after"].items():
        print(f"  {name:13s}" + "".join(map(_cell, (best.found_by["before"][name], after))))
    print(f"Written to {out}; other commands take it as --calibration {out}")


def _cell(values: list[float | None]) -> str:
    mean, *ends = values
    interval = "" if None in ends else " [{:5.2f} {:5.2f}]".format(*ends)
    return f"{mean:9.2f}{interval:15s}"
