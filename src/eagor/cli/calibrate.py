"""``eagor calibrate``: fit a calibration on episodes, or a detector's model on labelled looks; find a model's heads."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor.cli import terminal
from eagor.cli.looking import check_looks, check_not_read, checked_out, checked_rows
from eagor.cli.options import Calibrate
from eagor.cli.shared_options import given
from eagor.errors import EagorError

if TYPE_CHECKING:
    from eagor.evaluation.detector_fit import DetectorFit
    from eagor.perception.calibrated import Calibrated
    from eagor.perception.vlm.labelled import Labelled

RESPONSES_ONLY = ("trials", "workers")
HEADS_ONLY = ("labels", "take")
NOT_OF_REPLAYS = ("perception", "labels", "take", "episodes", "seed", "trials", "workers", "rows")
DEGREES = math.degrees(1)


def calibrate(options: Calibrate) -> int:
    """Run the command; returns its exit code."""
    other, others = ("responses", RESPONSES_ONLY) if options.what == "heads" else ("heads", HEADS_ONLY)
    if wrong := given(options, others):
        raise terminal.UsageError(f"--{wrong[0]} {getattr(options, wrong[0])} is for eagor calibrate {other}")
    if options.replay is not None or options.truth is not None:
        return replay(options)
    checked_rows(options.rows)
    return heads(options) if options.what == "heads" else responses(options)


def responses(options: Calibrate) -> int:
    """``eagor calibrate``."""
    from eagor.evaluation.calibration import PER_PLACE, TASKS, development_slots, record_episodes
    from eagor.evaluation.fitting import DRAWS, fit
    from eagor.perception import short_name

    if min(options.workers, options.trials, options.episodes) < 1:
        raise terminal.UsageError(
            f"--workers {options.workers} --trials {options.trials} --episodes {options.episodes}; wanted 1 or more"
        )
    check_looks(options.perception)
    if len({slot.seed for slot in development_slots(options.episodes, options.seed)}) < 2:
        raise terminal.UsageError(
            f"--episodes {options.episodes} are all in one apartment; wanted {1 + PER_PLACE * len(TASKS)} or more: one "
            "half of the apartments fits, the other half judges"
        )
    out = checked_out(options.out or Path(f"calibration-{short_name(options.perception)}.json"))
    with terminal.progress("looking", options.episodes) as advance:
        recordings = record_episodes(
            options.perception, options.episodes, options.seed, options.rows, advance, terminal.warning
        )
    terminal.log(f"{len(recordings)} episodes; trying {options.trials} settings, {DRAWS} at a time")
    with terminal.progress("fitting", options.trials) as advance:
        # Each round writes its best result, so that a fit that is stopped early is not lost.
        best = fit(options.perception, recordings, options.trials, options.workers, advance, lambda at: at.write(out))
    best.write(out)
    if options.json:
        terminal.emit(best.as_json() | {"out": str(out)})
    else:
        _print(best, out)
    return terminal.OK


def replay(options: Calibrate) -> int:
    """``eagor calibrate --replay FILE --truth FILE``."""
    from eagor._version import __version__
    from eagor.evaluation.detector_fit import RESAMPLES, fit_detector
    from eagor.evaluation.replayed import read_truth, replayed_looks
    from eagor.perception.calibrated import Calibrated
    from eagor.perception.replay import ReplayPerception

    if wrong := given(options, NOT_OF_REPLAYS):
        raise terminal.UsageError(f"--{wrong[0]} {getattr(options, wrong[0])} has no meaning with --replay and --truth")
    if options.what == "heads" or options.replay is None or options.truth is None:
        raise terminal.UsageError("--replay FILE and --truth FILE belong together, and not to eagor calibrate heads")
    out = checked_out(options.out or Path("calibration-replay.json"))
    check_not_read(out, "--out", [options.replay, options.truth])
    truths = read_truth(options.truth)
    looks, left_out = replayed_looks(ReplayPerception(options.replay), truths)
    if not looks:
        raise terminal.UsageError(
            f"{options.replay} has no line at any of the {len(truths)} stamps of {options.truth}; wanted one clock"
        )
    if left_out:
        terminal.warning(f"{len(left_out)} of {len(truths)} lines of {options.truth} have no look of their own")
    with terminal.progress("fitting", RESAMPLES) as advance:
        found = fit_detector(looks, on_step=advance)
    told = found.as_json()
    found_by = {key: told[key] for key in ("counts", "intervals", "held_out")} | {"version": __version__}
    fitted = Calibrated("replay", None, found_by=found_by, detector=found.model)
    fitted.write(out)
    if options.json:
        terminal.emit(fitted.as_json() | {"left_out": len(left_out), "out": str(out)})
    else:
        print_fit(found)
        print(f"Written to {out}; locate and track take it as --calibration {out}")
    return terminal.OK


def print_fit(found: DetectorFit) -> None:
    """A fitted detector model, with its intervals and its worth."""
    model, wide = found.model, 24
    print(
        f"{found.looks} looks in {found.groups} group{'' if found.groups == 1 else 's'}: {found.targets} targets in "
        f"view, {found.detections} detections ({found.matched:.0f} right, {found.false_alarms:.0f} false alarms)"
    )
    for name, scale in (
        ("detection_probability", 1),
        ("false_alarms_per_look", 1),
        ("spread", DEGREES),
        ("repeats", 1),
    ):
        value, ends = getattr(model, name), found.intervals.get(name)
        number = "not known" if value is None else f"{scale * value:.3g}{' deg' if scale == DEGREES else ''}"
        interval = "" if ends is None else f"  [{scale * ends[0]:.3g} {scale * ends[1]:.3g}]"
        print(f"  {name.replace('_', ' '):{wide}}{number}{interval}")
    for score, ratio in model.score_ratios or ():
        print(f"  {f'score {score:.2f}':{wide}}{ratio:.3g} times likelier of the thing than of a false alarm")
    if found.groups == 1:
        print("All looks are of one group: the intervals say nothing of other recordings. Give more, with a group each")
    if (judged := found.held_out) is None:
        print("One look is not enough to judge the fit")
        return
    print("Mean over looks that the fit had not seen, with the default model and with this one:")
    rows = [("log density at the truth", judged.density), ("log probability of presence", judged.presence)]
    for name, values in rows:
        if values is not None:
            print(f"  {name:28s}{values[0]:8.3f}{values[1]:8.3f}")
    low, high = judged.interval
    print(f"  {'gain of both, per look':28s}{'':8s}{judged.gain:8.3f}  [{low:.3f} {high:.3f}]")
    if low <= 0:
        terminal.warning("the fit is not surely better than the default model on looks that it has not seen")


def heads(options: Calibrate) -> int:
    """``eagor calibrate heads``."""
    from eagor.perception import is_model, load, short_name
    from eagor.perception.vlm.labelled import labelled_lines, read_labelled
    from eagor.worlds.panorama import read_panorama

    if min(options.episodes, options.take) < 1:
        raise terminal.UsageError(f"--episodes {options.episodes} --take {options.take}; wanted 1 or more")
    if not is_model(options.perception) or options.perception.startswith("endpoint"):
        raise terminal.UsageError(
            f"--perception {options.perception} has no attention heads; wanted a model on this machine: a folder, "
            "or a hub name such as Qwen/Qwen2.5-VL-7B-Instruct"
        )
    count = options.episodes if options.labels is None else len(labelled_lines(options.labels))
    perception: Any = load(options.perception)
    if "attention" not in perception.family.extractors:
        raise terminal.UsageError(f"{perception.family.title} has no attention heads; wanted a language model")
    if options.labels is None:
        from eagor.evaluation.labelled import apartment_labels
        from eagor.perception import rows_of

        examples = apartment_labels(count, options.seed, options.rows or rows_of(perception))
    else:
        examples = read_labelled(options.labels, read_panorama)
    out = checked_out(options.out or Path(f"heads-{short_name(options.perception)}.json"))
    with terminal.progress("looking", count) as advance:
        try:
            found = perception.find_heads(_counted(examples, advance), options.take)
        except EagorError as error:
            if type(error) is EagorError:  # the labels are valid, but no head is good enough: not an input error
                raise terminal.RunError(str(error)) from error
            raise
    found.write(out)
    if options.json:
        terminal.emit(asdict(found) | {"out": str(out)})
        return terminal.OK
    print(f"{found.model}: {len(found.heads)} heads, found on {found.found_by['panoramas']} panoramas")
    for entry in found.found_by["heads"]:
        layer, head = entry["head"]
        print(f"  layer {layer:3d}, head {head:3d}: {entry['gain']:.1f} times an even spread on the target")
    if held_out := found.found_by.get("held_out"):
        print(f"On {held_out['panoramas']} others they are off by {held_out['median_error_deg']:.1f} degrees (median)")
    model, _, written = options.perception.partition("?")
    rest = "&".join(part for part in written.split("&") if part and not part.startswith("heads="))
    print(f'Written to {out}; use them as --perception "{model}?heads={out}{"&" if rest else ""}{rest}"')
    return terminal.OK


def _counted(examples: Iterator[Labelled], advance: Callable[[], None]) -> Iterator[Labelled]:
    for example in examples:
        yield example
        advance()


def _print(best: Calibrated, out: Path) -> None:
    stored = best.as_json()
    reading = stored.get("detector") or stored["calibration"]
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
