"""``eagor track``: a sequence of panoramas and the camera's poses, one line per frame.

A frame that cannot be read is reported on stderr; the poses carry the belief over it, and the exit code is 3. A first
frame that is not 2:1 ends the run, because the others will hardly be. ``--out`` is flushed after every line.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from eagor._csv import as_csv
from eagor._files import Lines
from eagor.cli import terminal
from eagor.cli.following import RIVALS, Result, follow, make_rivals
from eagor.cli.looking import (
    check_not_read,
    checked_folder,
    checked_out,
    checked_query,
    find_frames,
    keep_picture,
    make_perception,
    perception_for,
    tracker_config,
    warn_of_detector,
)
from eagor.cli.options import Track
from eagor.cli.poses import Step, pair, read_poses
from eagor.cli.words import answer_in_words, signed
from eagor.sphere import azimuth_elevation

COLUMNS = (
    "frame", "stamp", "azimuth_deg", "elevation_deg", "credible_angle_deg", "presence", "distance_m", "distance_spread",
    "status", "held",
)  # fmt: skip
MOST_DRIFT = 90  # degrees
STATUS_WIDTH = len("ambiguous, held")
WIDTH = 2 + max(len("-180.0/-90.0"), *map(len, RIVALS))  # of a rival's column


def track(options: Track) -> int:
    """Run the command; returns its exit code."""
    if len(options.words) < 2:
        raise terminal.UsageError(f"got {' '.join(options.words)!r}; wanted FRAMES (a folder or images), then QUERY")
    query = checked_query(options.words[-1])
    spec = perception_for(query, options.perception)
    places = [Path(word) for word in options.words[:-1]]
    check_not_read(options.out, "--out", [options.poses])
    check_not_read(options.picture, "--picture", places)
    images = find_frames(places)
    steps = pair(read_poses(options.poses), images, options.poses)
    config = tracker_config(options.degree, spec, options.calibration, options.detector, options.force)
    floor, drift = _checked_floor(options.floor, steps), _checked_drift(options.drift)
    config = replace(config, floor_height=floor, drift=drift)
    perception = make_perception(spec)
    rivals = make_rivals(spec) if options.compare else {}
    entries, bad, looked = [], 0, 0
    with ExitStack() as stack:
        write = stack.enter_context(_table(options.out, options.compare)) if options.out else None
        draw = _painter(options.picture, query) if options.picture else None
        advance = stack.enter_context(terminal.progress("looking", len(images), shown=options.json))
        for number, result in enumerate(follow(steps, perception, query, config, rivals, options.force)):
            if number == 0 and not options.json:
                print(_header(options.compare), flush=True)
            if result.evidence and not looked:
                warn_of_detector(options.detector, result.evidence)
            if result.problem is not None:
                terminal.warning(f"{result.image.name} is left out: {result.problem}")
                bad += 1
            looked += len(result.evidence)
            if write is not None:
                write(result)
            if draw is not None:
                draw(number, result)
            if options.json:
                entries.append(result.as_json())
            else:
                print(_line(result), flush=True)
            advance()
    if options.json:
        summary = {"query": query, "perception": spec, "frames": entries, "left_out": bad}
        terminal.emit(summary)
    if bad == len(images):
        raise terminal.RunError(f"none of the {bad} frames could be used; the reasons are above")
    if looked == 0:
        raise terminal.RunError(
            f"{spec} has no record for any of the {len(images)} frames; its stamps must use the clock of "
            f"{options.poses} ({steps[0].pose.stamp:g} to {steps[-1].pose.stamp:g} s)"
        )
    if bad:
        terminal.log(f"{bad} of {len(images)} frames were left out")
    return terminal.INCOMPLETE if bad else terminal.OK


def _header(compare: bool) -> str:
    others = "".join(f"{name:>{WIDTH}}" for name in RIVALS) if compare else ""
    angles = "   (degrees; azimuth/elevation)" if compare else ""
    ours = f"     stamp  azimuth  elevation  cone 90%  distance  give or take  modes  {'status':{STATUS_WIDTH}}"
    return f"{ours}{others}{angles}".rstrip()


def _line(result: Result) -> str:
    e, distance, spread = result.estimate, result.distance, result.distance_spread
    far = "-" if distance is None else f"{distance:.2f} m"
    cone = "-" if e.direction is None else signed(e.credible_angle)[1:]
    status = f"{e.status}, held" if e.held else e.status
    give_or_take = "-" if spread is None else f"{100 * math.expm1(spread):.0f} %"
    line = f"{result.stamp:10.3f} {signed(e.azimuth):>8} {signed(e.elevation):>10} {cone:>9}"
    line += f" {far:>9} {give_or_take:>13} {len(e.modes):>6}  {status:{STATUS_WIDTH}}"
    for direction in result.others.values():
        line += f"{_pair(direction):>{WIDTH}}"
    return line.rstrip()


def _pair(direction: np.ndarray | None) -> str:
    """A direction ``(3,)`` as azimuth/elevation."""
    if direction is None:
        return "-"
    azimuth, elevation = azimuth_elevation(direction)
    return f"{signed(float(azimuth))}/{signed(float(elevation))}"


def _checked_drift(drift: float) -> float:
    """``--drift`` in radians."""
    if not 0 <= drift <= MOST_DRIFT:
        raise terminal.UsageError(f"--drift {drift:g}; wanted degrees from 0 to {MOST_DRIFT}")
    return math.radians(drift)


def _checked_floor(floor: float | None, steps: Sequence[Step]) -> float | None:
    """The floor's height, if every pose with a position is above it; else raises `UsageError`."""
    heights = [float(step.pose.position[2]) for step in steps if step.pose.position is not None]
    if floor is not None and not math.isfinite(floor):
        raise terminal.UsageError(f"--floor {floor:g}; wanted a height in metres")
    if floor is not None and heights and min(heights) <= floor:
        raise terminal.UsageError(
            f"--floor {floor:g}: the camera comes down to z = {min(heights):g} m; wanted a floor below that"
        )
    return floor


@contextmanager
def _table(path: Path, compare: bool) -> Iterator[Callable[[Result], None]]:
    """The file of ``--out``; the yielded function writes and flushes one line. The first line creates the file."""
    if path.suffix.lower() not in (".csv", ".jsonl"):
        raise terminal.UsageError(f"--out {path}: wanted a file name that ends in .csv or .jsonl")
    if not path.absolute().parent.is_dir():
        raise terminal.UsageError(f"--out {path}: there is no folder {path.absolute().parent}; make it first")
    checked_out(path)
    extra = [f"{name}_{angle}_deg" for name in RIVALS for angle in ("azimuth", "elevation")]
    head = [[*COLUMNS, "modes", "problem", *(extra if compare else [])]]
    with Lines(path) as file:

        def write(result: Result) -> None:
            entry = result.as_json()
            if path.suffix.lower() == ".jsonl":
                file.add(json.dumps(entry) + "\n")
                return
            row = [entry[name] for name in COLUMNS] + [len(entry["modes"]), entry.get("problem", "")]
            row += [angle for method in entry.get("methods", {}).values() for angle in method.values()]
            file.add(as_csv([*head, row], "\r\n"))
            head.clear()

        yield write


def _painter(folder: Path, query: str) -> Callable[[int, Result], None]:
    """A function that draws a frame with its belief into `folder`; unreadable frames are skipped."""
    from eagor.drawing import draw_belief

    checked_folder(folder, "--picture")

    def draw(number: int, result: Result) -> None:
        if result.panorama is None:
            return
        estimate = result.estimate
        held = ", held" if estimate.held else ""
        title = f"“{query}” at {result.stamp:.2f} s: {answer_in_words(estimate)} ({estimate.status}{held})"
        shown = {name: result.others[name] for name in ("centroid", "eagor_paper") if name in result.others}
        picture = draw_belief(result.panorama, estimate, others=shown, title=title)
        keep_picture(picture, folder / f"{number:04d}.png")

    return draw
