"""``eagor track LOOKS.jsonl``: answers from what `eagor look` has seen. No detector runs, and no picture is read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor.cli import terminal
from eagor.cli.options import Common, given

if TYPE_CHECKING:
    from eagor.perception.footage import HiddenParts, ThingSeen
    from eagor.perception.replay import ReplayPerception
    from eagor.tracking.config import TrackerConfig

# What belongs to footage: a file of looks has its poses and times, and no pictures.
_OF_FOOTAGE = (
    "poses", "rate", "start", "end", "image_topic", "odom_topic", "camera_info", "perception", "rig", "hfov", "camera",
    "force",
)  # fmt: skip
_OF_PICTURES = ("video", "fps", "page", "picture", "rerun")
_OF_ONE = ("out", "compare")


def recorded(options: Common, places: Sequence[Path]) -> ReplayPerception | None:
    """The file of looks that the one place is; None for footage.

    Raises `UsageError` for options that only footage has a use for, `FormatError` for a file that is none.
    """
    if len(places) != 1 or places[0].suffix.lower() != ".jsonl":
        return None
    from eagor.perception.footage import about
    from eagor.perception.replay import ReplayPerception

    replay = ReplayPerception(places[0])
    of = about(replay).of
    if wrong := given(options, _OF_FOOTAGE):
        raise terminal.UsageError(f"--{wrong[0].replace('_', '-')} is for footage; {places[0]} has its looks and poses")
    if wrong := given(options, _OF_PICTURES):
        name = "pictures" if wrong[0] == "picture" else wrong[0]
        raise terminal.UsageError(
            f"--{name} needs pictures, and {places[0]} holds none; draw over the footage with the same answers: eagor "
            f"track {of} QUERY --perception replay:{places[0]} --{name} ..."
        )
    return replay


def list_seen(options: Common, replay: ReplayPerception, config: TrackerConfig, hidden: HiddenParts, modes: int) -> int:
    """Print what was seen where, the surest first; returns the exit code."""
    from eagor.perception.footage import about, asked_for, things_seen

    if wrong := given(options, _OF_ONE):
        raise terminal.UsageError(f"--{wrong[0]} is for one question: eagor track {replay.name} QUERY --{wrong[0]}")
    footage, queries = about(replay), asked_for(replay)
    with terminal.progress("adding up", len(queries), shown=not options.json) as advance:
        found = things_seen(replay, config, hidden, advance)
    if options.json:
        things = [_entry(each, modes) for each in found]
        terminal.emit({"of": footage.of, "perception": footage.perception, "poses": footage.poses, "things": things})
        return terminal.OK
    if not found:
        terminal.say(f"{footage.perception} saw nothing in {footage.of}")
        return terminal.OK
    end = found[0].estimate.stamp - footage.begins
    terminal.say(f"seen in {footage.of} by {footage.perception}; directions are those of the camera at {end:.2f} s")
    terminal.say(f"{'thing':<16}{'azimuth':>9}{'elevation':>11}{'cone 90%':>10}{'sure':>7}{'presence':>10}{'looks':>9}"
                 f"{'last seen':>11}  status")  # fmt: skip
    terminal.say(*(_line(each, footage.begins) for each in found))
    return terminal.OK


def _line(thing: ThingSeen, begins: float) -> str:
    from eagor.drawing.style import signed

    e = thing.estimate
    cone = "-" if e.direction is None else signed(e.credible_angle)[1:]
    many = f"{thing.looks}/{thing.among}"
    return (
        f"{thing.query:<16}{signed(e.azimuth):>9}{signed(e.elevation):>11}{cone:>10}{100 * thing.sure:>5.0f} %"
        f"{100 * e.presence:>8.0f} %{many:>9}{thing.last - begins:>11.2f}  {e.status}"
    )


def _entry(thing: ThingSeen, modes: int) -> dict[str, Any]:
    from eagor.perception.footage import NEAR

    near = round(math.degrees(NEAR))
    about = {"query": thing.query, **thing.estimate.as_dict(modes, near)}
    return about | {"seen_in": thing.looks, "looks": thing.among, "last_seen": thing.last}
