"""``eagor calibrate``: fit a calibration on episodes, or a detector's model on labelled looks; find a model's heads."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from eagor.cli import terminal
from eagor.cli.checks import check_looks, check_not_read, checked_out, checked_rows
from eagor.cli.options import Common, Rows, Whole, bare, given
from eagor.errors import EagorError, PoseError

if TYPE_CHECKING:
    from eagor.lab.eval.detector_fit import DetectorFit
    from eagor.lab.eval.labelled_looks import Pose
    from eagor.perception.calibrated import Calibrated, Labelled


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
    """Number of settings to try."""
    workers: Whole = 1
    """Number of processes."""
    rows: Rows = None


# Options that only some of what can be calibrated take.
RESPONSES, HEADS = ("trials", "workers"), ("labels", "take")
EPISODES = ("episodes", "seed", "rows")  # responses and heads
REPLAY = ("replay", "truth", "poses")
REPORTED = (
    "habit", "false_alarms_per_look", "look_alikes", "look_alike_habit", "spread", "spread_of_size", "offset",
    "offset_of_size",
)  # fmt: skip


def calibrate(options: Calibrate) -> int:
    """Run the command; returns its exit code."""
    if options.what not in ("responses", "heads"):
        raise terminal.UsageError(
            f"WHAT {options.what!r}: wanted responses or heads; or labelled looks, as --replay FILE --truth FILE"
        )
    of_heads = options.what == "heads"
    other, others = ("responses", RESPONSES) if of_heads else ("heads", HEADS)
    _refuse(options, others, f"is for eagor calibrate {other}")
    if given(options, REPLAY):
        return replay(options)
    checked_rows(options.rows)
    for name in ("episodes", "trials", "workers", "take"):
        if getattr(options, name) < 1:
            raise terminal.UsageError(f"--{name} {getattr(options, name)}; wanted 1 or more")
    return heads(options) if of_heads else responses(options)


def _refuse(options: Calibrate, names: Sequence[str], why: str) -> None:
    """Raise `UsageError` if one of these options is given."""
    if wrong := given(options, names):
        raise terminal.UsageError(f"--{wrong[0]} {getattr(options, wrong[0])} {why}")


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
    terminal.log(f"{len(recordings)} episodes; trying {options.trials} settings, {DRAWS} at a time")
    with terminal.progress("fitting", options.trials) as advance:
        # Each round writes its best result, so that a fit that is stopped early is not lost.
        best = fit(perception, recordings, options.trials, options.workers, advance, lambda at: at.write(out))
    best.write(out)
    return _finish(options, best.as_json(), out, partial(print_scores, best))


def replay(options: Calibrate) -> int:
    """``eagor calibrate --replay FILE --truth FILE``."""
    from eagor._version import __version__
    from eagor.lab.eval.detector_fit import RESAMPLES, fit_detector
    from eagor.lab.eval.labelled_looks import read_truth, replayed_looks
    from eagor.perception.calibrated import Calibrated
    from eagor.perception.replay import ReplayPerception

    _refuse(options, ("perception", *HEADS, *RESPONSES, *EPISODES), "has no meaning with --replay and --truth")
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
    found_by = {key: value for key, value in result.as_json().items() if key != "detector"} | {"version": __version__}
    fitted = Calibrated("replay", None, found_by=found_by, detector=result.model)
    fitted.write(out)
    return _finish(options, fitted.as_json() | {"left_out": len(left_out)}, out, partial(print_fit, result))


def _finish(options: Calibrate, result: dict[str, Any], out: Path, show: Callable[[], None]) -> int:
    """Give the result of a calibration that is in `out`: as JSON, or in words."""
    if options.json:
        terminal.emit(result | {"out": str(out)})
    else:
        show()
        print(f"Written to {out}; other commands take it as --calibration {out}")
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


def print_fit(result: DetectorFit) -> None:
    """A fitted detector model, with its intervals and its worth."""
    print(
        f"{result.looks} looks in {terminal.many(result.groups, 'group')}: {result.targets} targets in view, "
        f"{result.detections} detections ({result.matched:.0f} right, {result.false_alarms:.0f} false alarms)"
    )
    model, rows = result.model, []
    for name in REPORTED:
        value, ends = getattr(model, name), result.intervals.get("detection_share" if name == "habit" else name, ())
        scale, unit = (math.degrees(1), " deg") if name in ("spread", "offset") else (1, "")
        values = value if isinstance(value, tuple) else () if value is None else (value,)
        numbers, interval = (" ".join(f"{scale * each:.3g}" for each in some) for some in (values, ends))
        text = f"{numbers}{unit}" if values else "not known"
        text += f", mean {model.habits.mean:.2g}" if name == "habit" else ""
        rows.append((name.replace("_", " "), text, f"[{interval}]" if interval else ""))
    rows += [
        (f"score {score:.2f}", f"{ratio:.3g}", "times likelier of the thing than of a false alarm")
        for score, ratio in model.score_ratios or ()
    ]
    terminal.table(rows)
    if "look_alikes" not in result.intervals:
        print("Without poses (--poses) nothing is known of look-alikes and of the offset: they are as they were")
    if result.groups == 1:
        print("All looks are of one group: the intervals say nothing of other recordings. Give more, with a group each")
    if (judged := result.held_out) is None:
        print("One look is not enough to judge the fit")
        return
    print("Mean over looks that the fit had not seen, with the default model and with this one:")
    pairs = {"log density at the truth": judged.log_density, "log probability of presence": judged.log_presence}
    rows = [(name, *(f"{value:.3f}" for value in pair), "") for name, pair in pairs.items() if pair is not None]
    low, high = judged.interval
    terminal.table([*rows, ("gain of both, per look", "", f"{judged.gain:.3f}", f"[{low:.3f} {high:.3f}]")])
    if low <= 0:
        terminal.warning("the fit is not surely better than the default model on looks that it has not seen")


def heads(options: Calibrate) -> int:
    """``eagor calibrate heads``."""
    from eagor.media.panorama import read_panorama
    from eagor.perception import is_model, load, short_name
    from eagor.perception.calibrated import labelled_lines, read_labelled

    name = options.perception or "scout"
    if not is_model(name) or name.startswith("endpoint"):
        raise terminal.UsageError(
            f"--perception {name} has no attention heads; wanted a model on this machine: a folder, "
            "or a hub name such as Qwen/Qwen2.5-VL-7B-Instruct"
        )
    count = options.episodes if options.labels is None else len(labelled_lines(options.labels))
    perception: Any = load(name)
    if "attention" not in perception.family.extractors:
        raise terminal.UsageError(f"{perception.family.title} has no attention heads; wanted a language model")
    if options.labels is None:
        from eagor.lab.eval.labelled_looks import apartment_labels
        from eagor.perception import rows_of

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


def print_scores(best: Calibrated) -> None:
    """A fitted calibration, with its scores before and after."""
    stored = best.as_json()
    reading = stored.get("detector") or stored["calibration"]
    print(f"{best.perception}: " + ", ".join(f"{name} {value}" for name, value in reading.items()))
    print("  " + ", ".join(f"{name} {value}" for name, value in best.forgetting.items()))
    print(f"On the other half of the apartments ({len(best.found_by['judged by'])}), means with 95 % intervals:")
    before, after = best.found_by["before"], best.found_by["after"]
    terminal.table([("", "before", "after"), *((name, _cell(before[name]), _cell(after[name])) for name in after)])


def _cell(values: list[float | None]) -> str:
    mean, *ends = values
    return f"{mean:.2f}" + ("" if None in ends else " [{:.2f} {:.2f}]".format(*ends))
