"""``eagor calibrate``: fit a calibration on episodes, or a detector's model on labelled looks; find a model's heads."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from eagor.cli import terminal
from eagor.cli.checks import check_looks, check_not_read, checked_number, checked_out
from eagor.cli.options import Common, Rows, Whole, bare, given
from eagor.errors import EagorError, PoseError

if TYPE_CHECKING:
    from eagor.lab.eval.detector_fit import DetectorFit
    from eagor.lab.eval.labelled_looks import Pose
    from eagor.perception.calibrated import Labelled


@dataclass(frozen=True, kw_only=True)
class Calibrate(Common):
    """Calibrate a perception by log score, fit a detector on labelled looks, or find a model's heads."""

    runs: ClassVar[str] = "calibrate"

    what: Annotated[str, Positional, arg(metavar="WHAT")] = "responses"
    """responses: calibrate any perception. heads: find the heads of a local model (Qwen2.5-VL, Gemma 3, ...)."""
    perception: Annotated[str | None, bare("NAME")] = None
    """The perception (default: scout). For heads a model (FOLDER, Qwen/Qwen2.5-VL-7B-Instruct, options after ?)."""
    replay: Annotated[Path | None, bare("FILE.jsonl")] = None
    """Fit the error model of the detector that wrote this replay file (docs/replay-format.md); needs --truth."""
    truth: Annotated[Path | None, bare("FILE.jsonl")] = None
    """The true directions for --replay: lines of stamp, query and targets (docs/replay-format.md)."""
    poses: Annotated[Path | None, bare("CSV")] = None
    """How the camera turned and moved while --replay was seen, as for track: it tells what comes again."""
    out: Annotated[Path | None, bare("FILE.json")] = None
    (
        "File for the calibration (default: calibration-PERCEPTION.json; pass it to other commands as --calibration) "
        "or for the heads (default: heads-MODEL.json; pass it to a model as FOLDER?heads=FILE.json)."
    )
    labels: Annotated[Path | None, bare("FILE.jsonl")] = None
    """heads: labelled panoramas of your own (docs/models.md), instead of apartments."""
    take: Whole = 3
    """heads: number of heads."""
    episodes: Whole = 60
    (
        "Number of episodes. responses: alternately routes past an object and balls, two of each in an apartment. "
        "heads: panoramas, four in an apartment."
    )
    seed: Whole = 100
    """The first apartment; 0 to 1999 are for development."""
    trials: Whole = 96
    """Number of settings to try, for response maps."""
    workers: Whole = 1
    """Number of processes."""
    rows: Rows = None


REPLAY = ("replay", "truth", "poses")
ONLY = {"responses": ("trials", "workers"), "heads": ("labels", "take")}  # options that no other takes


def calibrate(options: Calibrate) -> int:
    """Run the command; returns its exit code."""
    if options.what not in ONLY:
        raise terminal.UsageError(
            f"WHAT {options.what!r}: wanted responses or heads; or labelled looks, as --replay FILE --truth FILE"
        )
    other = "responses" if options.what == "heads" else "heads"
    if wrong := given(options, ONLY[other]):
        raise terminal.UsageError(f"--{wrong[0]} {getattr(options, wrong[0])} is for eagor calibrate {other}")
    if given(options, REPLAY):
        return replay(options)
    checked_number(options.rows, "--rows")
    for name in ("episodes", "trials", "workers", "take"):
        if getattr(options, name) < 1:
            raise terminal.UsageError(f"--{name} {getattr(options, name)}; wanted 1 or more")
    return heads(options) if options.what == "heads" else responses(options)


def responses(options: Calibrate) -> int:
    """``eagor calibrate``."""
    from eagor.lab.eval.calibration import DRAWS, PER_PLACE, TASKS, development_specs, fit, record_episodes
    from eagor.perception import short_name

    perception = options.perception or "scout"
    check_looks(perception)
    if len({spec.seed for spec in development_specs(options.episodes, options.seed)}) < 2:
        raise terminal.UsageError(
            f"--episodes {options.episodes} are all in one apartment; wanted {1 + PER_PLACE * len(TASKS)} or more: one "
            "half of the apartments fits, the other half judges"
        )
    out = checked_out(options.out or Path(f"calibration-{short_name(perception)}.json"))
    with terminal.progress("looking", options.episodes) as advance:
        recordings = record_episodes(
            perception, options.episodes, options.seed, options.rows, advance, terminal.warning
        )
    terminal.log(f"{len(recordings)} episodes; of response maps {options.trials} settings are tried, {DRAWS} at a time")
    with terminal.progress("fitting", options.trials) as advance:
        # Each round writes its best result, so that a fit that is stopped early is not lost.
        best = fit(perception, recordings, options.trials, options.workers, advance, lambda at: at.write(out))
    best.write(out)
    stored, by = best.as_json(), best.found_by
    reading = ", ".join(f"{name} {value}" for name, value in (stored.get("detector") or stored["calibration"]).items())
    judges = f"On the other half of the apartments ({len(by['judged by'])}), means with 95 % intervals:"
    lines = [f"{perception}: {reading}", judges]
    for name in by["after"]:
        before, after = (_interval(*by[side][name]) for side in ("before", "after"))
        lines.append(f"  {name}: {before} before, {after} after")
    return _finish(options, stored, out, lines)


def _interval(mean: float, *ends: float | None) -> str:
    return f"{mean:.2f}" + ("" if None in ends else " [{:.2f} {:.2f}]".format(*ends))


def replay(options: Calibrate) -> int:
    """``eagor calibrate --replay FILE --truth FILE``."""
    from eagor._version import __version__
    from eagor.lab.eval.detector_fit import RESAMPLES, fit_detector
    from eagor.lab.eval.labelled_looks import read_truth, replayed_looks
    from eagor.perception.calibrated import Calibrated
    from eagor.perception.replay import ReplayPerception

    if wrong := given(options, ("perception", "take", "labels", "trials", "workers", "episodes", "seed", "rows")):
        raise terminal.UsageError(f"--{wrong[0]} has no meaning with --replay and --truth")
    if options.what == "heads" or options.replay is None or options.truth is None:
        raise terminal.UsageError("--replay FILE and --truth FILE belong together, and not to eagor calibrate heads")
    out = checked_out(options.out or Path("calibration-replay.json"))
    check_not_read(out, "--out", [path for path in (options.replay, options.truth, options.poses) if path is not None])
    truths = read_truth(options.truth)
    pose = None if options.poses is None else _poses(str(options.poses))
    looks, left_out = replayed_looks(ReplayPerception(options.replay), truths, pose)
    if not looks:
        raise terminal.UsageError(
            f"{options.replay} has no line at any of the {len(truths)} stamps of {options.truth}; wanted one clock"
        )
    if left_out:
        terminal.warning(f"{len(left_out)} of {len(truths)} lines of {options.truth} have no look of their own")
    with terminal.progress("fitting", RESAMPLES) as advance:
        result = fit_detector(looks, on_step=advance)
    fitted = Calibrated("replay", None, found_by=result.as_json() | {"version": __version__}, detector=result.model)
    fitted.write(out)
    return _finish(options, fitted.as_json() | {"left_out": len(left_out)}, out, fit_in_words(result))


def _finish(options: Calibrate, result: dict[str, Any], out: Path, lines: list[str]) -> int:
    """Give the result of a calibration that is in `out`: as JSON, or in words."""
    if options.json:
        terminal.emit(result | {"out": str(out)})
    else:
        terminal.say(*lines, f"Written to {out}; other commands take it as --calibration {out}")
    return terminal.OK


def _poses(path: str) -> Callable[[float], Pose]:
    """The camera's pose at any stamp, from a file of poses."""
    from eagor.odometry.axes import settled
    from eagor.odometry.files import BEYOND, interpolated, read_poses, usable

    poses = usable(settled(read_poses(path), "auto", path, None, terminal.log), path)
    first, last, pose = poses[0].stamp, poses[-1].stamp, interpolated(poses)

    def at(stamp: float) -> Pose:
        if not first - BEYOND <= stamp <= last + BEYOND:
            raise PoseError(
                f"the look at {stamp:.10g} s has no pose: {path} tells those from {first:.10g} to {last:.10g} s. Both "
                "files must use one clock"
            )
        return pose(stamp)

    return at


def fit_in_words(result: DetectorFit) -> list[str]:
    """A fitted detector model, with its intervals and its worth."""
    model, intervals = result.model, result.intervals
    lines = [
        f"{result.looks} looks in {terminal.many(result.groups, 'group')}: {result.targets} targets in view, "
        f"{result.detections} detections ({result.matched:.0f} right, {result.detections - result.matched:.0f} false "
        "alarms)"
    ]
    shares = {"habit": model.habit, "look_alike_habit": model.look_alike_habit}
    numbers = {**shares, **{name: (getattr(model, name),) for name in intervals if name != "detection_share"}}
    for name, values in numbers.items():
        scale, unit = (math.degrees(1), " deg") if name in ("spread", "offset") else (1.0, "")
        ends = intervals.get("detection_share" if name == "habit" else name, ())
        found, interval = (" ".join(f"{scale * each:.3g}" for each in some) for some in (values, ends))
        mean = f", mean {model.habits.mean:.2g}" if name == "habit" else ""
        lines.append(f"  {name.replace('_', ' ')}: {found}{unit}{mean}{f' [{interval}]' if interval else ''}")
    ratios = ", ".join(f"{ratio:.3g} at {score:.2f}" for score, ratio in model.score_ratios or ())
    lines += [f"  a score is so many times likelier of the thing than of a false alarm: {ratios}"] if ratios else []
    if "look_alikes" not in intervals:
        lines.append("Without poses (--poses) nothing is known of look-alikes and of the offset: they are as they were")
    if result.groups == 1:
        lines.append("All looks are of one group: the intervals say nothing of other recordings. Give more groups")
    if (judged := result.held_out) is None:
        return [*lines, "One look is not enough to judge the fit"]
    lines.append(
        "On looks that the fit had not seen, log density and log probability of presence together gain "
        f"{judged.gain:.3f} [{judged.low:.3f} {judged.high:.3f}] per look over the default model"
    )
    if judged.low <= 0:
        terminal.warning("the fit is not surely better than the default model on looks that it has not seen")
    return lines


def heads(options: Calibrate) -> int:
    """``eagor calibrate heads``."""
    from eagor.media.panorama import read_panorama
    from eagor.perception import is_model, load, rows_of, short_name
    from eagor.perception.calibrated import labelled_lines, read_labelled

    name = options.perception or "scout"
    if not is_model(name) or name.startswith("endpoint"):
        raise terminal.UsageError(
            f"--perception {name} has no attention heads; wanted a model on this machine: a folder, "
            "or a hub name such as Qwen/Qwen2.5-VL-7B-Instruct"
        )
    count = options.episodes if options.labels is None else len(labelled_lines(options.labels))
    perception: Any = load(name)
    if not hasattr(perception, "find_heads"):
        raise terminal.UsageError(f"{name} is a detector and has no attention heads; wanted a language model")
    if options.labels is None:
        from eagor.lab.eval.labelled_looks import apartment_labels

        examples = apartment_labels(count, options.seed, options.rows or rows_of(perception))
    else:
        examples = read_labelled(options.labels, read_panorama)
    out = checked_out(options.out or Path(f"heads-{short_name(name)}.json"))
    with terminal.progress("looking", count) as advance:
        try:
            result = perception.find_heads(_counted(examples, advance), options.take)
        except EagorError as error:
            if type(error) is EagorError:  # the labels are valid, but no head is good enough: not an input error
                raise terminal.RunError(str(error)) from error
            raise
    result.write(out)
    if options.json:
        terminal.emit(asdict(result) | {"out": str(out)})
        return terminal.OK
    print(f"{result.model}: {len(result.heads)} heads, found on {result.found_by['panoramas']} panoramas")
    for entry in result.found_by["heads"]:
        layer, head = entry["head"]
        print(f"  layer {layer:3d}, head {head:3d}: {entry['gain']:.1f} times an even spread on the target")
    if held_out := result.found_by.get("held_out"):
        print(f"On {held_out['panoramas']} others they are off by {held_out['median_error_deg']:.1f} degrees (median)")
    model, _, written = name.partition("?")
    rest = "&".join(part for part in written.split("&") if part and not part.startswith("heads="))
    print(f'Written to {out}; use them as --perception "{model}?heads={out}{"&" if rest else ""}{rest}"')
    return terminal.OK


def _counted(examples: Iterator[Labelled], advance: Callable[[], None]) -> Iterator[Labelled]:
    for example in examples:
        yield example
        advance()
