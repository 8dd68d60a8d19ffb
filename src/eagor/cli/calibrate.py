"""``eagor calibrate``: fit a calibration on episodes, or a detector's model on labelled looks; find a model's heads."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg

from eagor.cli import checks, terminal
from eagor.cli.options import Common, Rows, Whole, bare, given, refuse
from eagor.errors import EagorError, PoseError


@dataclass(frozen=True, kw_only=True)
class Calibrate(Common):
    """Calibrate a perception by log score, fit a detector on labelled looks, or find a model's heads."""

    what: Annotated[Literal["responses", "heads"], Positional, arg(metavar="WHAT")] = "responses"
    """responses: calibrate any perception. heads: find the heads of a local model (Qwen2.5-VL, Gemma 3, ...)."""
    perception: Annotated[str, bare("NAME")] = "scout"
    """The perception. For heads a model (FOLDER, Qwen/Qwen2.5-VL-7B-Instruct, options after ?)."""
    replay: Annotated[Path | None, bare("FILE.jsonl")] = None
    """Fit the error model of the detector that wrote this replay file (as `eagor look` does); needs --truth."""
    truth: Annotated[Path | None, bare("FILE.jsonl")] = None
    """The true directions: lines {"stamp", "query", "targets": [{"azimuth_deg", "elevation_deg"}, ...]}; none: []."""
    poses: Annotated[Path | None, bare("CSV")] = None
    """How the camera turned and moved while --replay was seen, as for track: it tells what comes again."""
    out: Annotated[Path | None, bare("FILE.json")] = None
    """File for the result (default: calibration-PERCEPTION.json or heads-MODEL.json)."""
    labels: Annotated[Path | None, bare("FILE.jsonl")] = None
    """heads: lines {"image", "query", "azimuth_deg", "elevation_deg", "radius_deg"}, or "box": [x0, y0, x1, y1]."""
    take: Whole = 3
    """heads: number of heads."""
    episodes: Whole = 60
    """Number of episodes, four in an apartment: routes past an object, and balls. heads: of panoramas."""
    seed: Whole = 100
    """The first apartment; 0 to 1999 are for development."""
    trials: Whole = 96
    """Number of settings to try, for response maps."""
    workers: Whole = 1
    """Number of processes."""
    rows: Rows = None


TAKES = {  # options of each kind of calibration
    "responses": ("perception", "episodes", "seed", "rows", "trials", "workers"),
    "heads": ("perception", "episodes", "seed", "rows", "labels", "take"),
    "replay": ("replay", "truth", "poses"),
}


def calibrate(options: Calibrate) -> int:
    """Run the command; returns its exit code."""
    kind = "replay" if given(options, TAKES["replay"]) else options.what
    for other, names in TAKES.items():
        refuse(options, sorted({*names} - {*TAKES[kind]}), f"is for eagor calibrate {other}")
    checks.check_outputs(options, [options.replay, options.truth, options.poses])
    return {"responses": responses, "heads": heads, "replay": replay}[kind](options)


def responses(options: Calibrate) -> int:
    """``eagor calibrate``."""
    from eagor.lab.eval.calibration import PER_PLACE, TASKS, fit, record_episodes
    from eagor.perception import short_name

    name = options.perception
    checks.check_looks(name)
    if options.episodes <= PER_PLACE * len(TASKS):
        raise terminal.UsageError(
            f"--episodes {options.episodes} are all in one apartment; wanted {1 + PER_PLACE * len(TASKS)} or more: one "
            "half of the apartments fits, the other half judges"
        )
    out = options.out or Path(f"calibration-{short_name(name)}.json")
    with terminal.progress("looking", options.episodes) as advance:
        recordings = record_episodes(name, options.episodes, options.seed, options.rows, advance, terminal.warning)
    with terminal.progress("fitting", options.trials) as advance:
        best = fit(name, recordings, options.trials, options.workers, advance)
    best.write(out)
    stored, by = best.as_json(), best.found_by
    reading = ", ".join(f"{name} {value}" for name, value in (stored.get("detector") or stored["calibration"]).items())
    lines = [f"{name}: {reading}", f"On the other {len(by['judged by'])} apartments, means with 95 % intervals:"]
    for what in by["after"]:
        sides = [" ".join(f"{x:.2f}" for x in by[side][what] if x is not None) for side in ("before", "after")]
        lines.append("  {}: {} before, {} after".format(what, *sides))
    return _finish(options, stored, out, lines)


def replay(options: Calibrate) -> int:
    """``eagor calibrate --replay FILE --truth FILE``."""
    from eagor._version import __version__
    from eagor.lab.eval.detector_fit import RESAMPLES, fit_detector
    from eagor.lab.eval.labelled_looks import read_truth, replayed_looks
    from eagor.odometry.axes import settled
    from eagor.odometry.files import BEYOND, interpolated, read_poses, usable
    from eagor.perception.calibrated import Calibrated
    from eagor.perception.replay import ReplayPerception

    if options.what == "heads" or options.replay is None or options.truth is None:
        raise terminal.UsageError("--replay FILE and --truth FILE belong together, and not to eagor calibrate heads")
    out = options.out or Path("calibration-replay.json")
    truths, pose = read_truth(options.truth), []
    if options.poses is not None:
        path = str(options.poses)
        poses = usable(settled(read_poses(path), "auto", path, None, terminal.log), path)
        first, last = poses[0].stamp, poses[-1].stamp
        if not first - BEYOND <= truths[0].stamp <= truths[-1].stamp <= last + BEYOND:
            raise PoseError(
                f"{options.truth} has no pose at some of its stamps: {path} tells those from {first:.10g} to "
                f"{last:.10g} s. Both files must use one clock"
            )
        pose = [interpolated(poses)]
    looks, left_out = replayed_looks(ReplayPerception(options.replay), truths, *pose)
    if not looks:
        raise terminal.UsageError(
            f"{options.replay} has no line at any of the {len(truths)} stamps of {options.truth}; wanted one clock"
        )
    if left_out:
        terminal.warning(f"{len(left_out)} of {len(truths)} lines of {options.truth} have no look of their own")
    with terminal.progress("fitting", RESAMPLES) as advance:
        result = fit_detector(looks, on_step=advance)
    model, judged = result.model, result.held_out
    found_by = {"counts": result.counts, "intervals": result.intervals, "held_out": judged and asdict(judged)}
    fitted = Calibrated("replay", None, found_by=found_by | {"version": __version__}, detector=model)
    fitted.write(out)
    lines = [", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in result.counts.items())]
    numbers = asdict(model) | {"detection_share": model.habit[0] / sum(model.habit)}
    for name, ends in result.intervals.items():
        scale, unit = (math.degrees(1), " deg") if name in ("spread", "offset") else (1.0, "")
        found, low, high = (f"{scale * value:.3g}" for value in (numbers[name], *ends))
        lines.append(f"  {name.replace('_', ' ')}: {found}{unit} [{low} {high}]")
    if "look_alikes" not in result.intervals:
        lines.append("Without poses (--poses) nothing is known of look-alikes and of the offset: they are as they were")
    if result.counts["groups"] == 1:
        lines.append("All looks are of one group: the intervals say nothing of other recordings. Give more groups")
    if judged is None:
        lines.append("One look is not enough to judge the fit")
    else:
        gain = f"{judged.difference:.3f} [{judged.interval.low:.3f} {judged.interval.high:.3f}]"
        lines.append(f"On looks that the fit had not seen, the log score gains {gain} per look over the default model")
        if judged.interval.low <= 0:
            terminal.warning("the fit is not surely better than the default model on looks that it has not seen")
    return _finish(options, fitted.as_json() | {"left_out": len(left_out)}, out, lines)


def _finish(options: Calibrate, result: dict[str, Any], out: Path, lines: list[str], use: str = "") -> int:
    """Give the result that is in `out`: as JSON, or in words that end with what it is of `use` for."""
    use = use or f"other commands take it as --calibration {out}"
    return terminal.give(options.json, result | {"out": str(out)}, *lines, f"Written to {out}; {use}")


def heads(options: Calibrate) -> int:
    """``eagor calibrate heads``."""
    from eagor.perception import is_model, load, rows_of, short_name
    from eagor.perception.calibrated import labelled_lines, read_labelled
    from eagor.sources.panorama import read_panorama

    name = options.perception
    count = options.episodes if options.labels is None else len(labelled_lines(options.labels))
    perception: Any = load(name) if is_model(name) and not name.startswith("endpoint") else None
    if not hasattr(perception, "find_heads"):
        raise terminal.UsageError(
            f"--perception {name} has no attention heads; wanted a language model on this machine: a folder, or a hub "
            "name such as Qwen/Qwen2.5-VL-7B-Instruct"
        )
    if options.labels is None:
        from eagor.lab.eval.labelled_looks import apartment_labels

        examples = apartment_labels(count, options.seed, options.rows or rows_of(perception))
    else:
        examples = read_labelled(options.labels, read_panorama)
    out = options.out or Path(f"heads-{short_name(name)}.json")
    with terminal.progress("looking", count) as advance:
        try:
            result = perception.find_heads((example for example in examples if not advance()), options.take)
        except EagorError as error:
            if type(error) is EagorError:  # the labels are valid, but no head is good enough: not an input error
                raise terminal.RunError(str(error)) from error
            raise
    result.write(out)
    lines = [f"{result.model}: {len(result.heads)} heads, found on {result.found_by['panoramas']} panoramas"]
    if held_out := result.found_by.get("held_out"):
        lines.append("On {panoramas} others they are off by {median_error_deg:.1f} degrees (median)".format(**held_out))
    model, _, written = name.partition("?")
    rest = "".join(f"&{part}" for part in written.split("&") if part and not part.startswith("heads="))
    return _finish(options, asdict(result), out, lines, f'use them as --perception "{model}?heads={out}{rest}"')
