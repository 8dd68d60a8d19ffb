"""``eagor look``: a detector goes through footage once, and what it saw is kept for any question.

`eagor track LOOKS.jsonl QUERY` answers from the file at once, and without QUERY lists what was seen: see `answers`.
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from eagor.cli import checks, terminal
from eagor.cli.answers import appended
from eagor.cli.frames import Tally, open_stream
from eagor.cli.options import Footage
from eagor.errors import ImageError, PoseError

if TYPE_CHECKING:
    from eagor.perception.views import Detector


@dataclass(frozen=True, kw_only=True)
class Look(Footage):
    """Look through footage once with a detector, and keep all that it sees: eagor track LOOKS.jsonl then answers."""

    words: Annotated[tuple[str, ...], Positional, arg(metavar="FRAMES", help_behavior_hint="(required)")]
    """A picture, a video, a folder, several image files, or a ROS 2 bag: panoramas, or of an ordinary camera."""
    out: Annotated[Path, arg(metavar="LOOKS.jsonl")]
    """Where to write what was seen: all things in all views, and the poses. Nothing of the pictures is kept."""
    perception: Annotated[str, arg(metavar="NAME")] = "coco"
    """The detector, one that has classes: coco, or onnx:MODEL.onnx. For one that takes any words, see --for."""
    queries: Annotated[tuple[str, ...], arg(name="for", metavar="QUERY", help_behavior_hint="")] = ()
    """What to look for, with a detector that takes any words: only this can be asked later."""


def look(options: Look) -> int:
    """Run the command; returns its exit code."""
    from eagor.perception.partial import ValidMasks
    from eagor.perception.replay import detection_lines, first_line
    from eagor.sources.odometry import PosedFrames, prefetched

    queries = checks.checked_queries(options.queries)
    places = checks.places_of(options.words, options.rig is not None)
    checks.check_outputs(options, [*places, options.poses], out="looks")
    views = _views(options, queries)
    stream = open_stream(options, places, views)
    of = ", ".join(place.name for place in places[:3]) + (" and more" if len(places) > 3 else "")
    tally, last, labels = Tally(), 0.0, Counter[str]()
    with appended(options.out) as add, terminal.progress("looking", stream.count, shown=not options.json) as advance:
        head = [first_line(of, options.perception, views, stream.told, stream.begins)]
        frames = PosedFrames(stream.source, stream.poses, stream.looks, terminal.log)
        try:
            for posed, entries in detection_lines(prefetched(frames), views, queries, ValidMasks(say=terminal.log)):
                add("".join(f"{line}\n" for line in [*head, *map(json.dumps, entries)]))
                head.clear()
                if not posed.looked:
                    continue
                tally.add(posed.frame.name, entries[-1].get("problem"), posed.frame.picture is not None)
                last = posed.frame.stamp
                for entry in entries:
                    found = [box for view in entry.get("views", ()) for box in view["boxes"]]
                    labels.update(entry.get("query") or box.get("label", "") for box in found)
                advance()
        except (ImageError, PoseError) as error:
            if tally.bad == tally.frames:
                raise
            tally.broken = str(error)
        except KeyboardInterrupt:
            if looks := tally.frames - tally.bad:
                terminal.log(f"kept: {options.out}, {terminal.many(looks, 'look')} to {last - stream.begins:.2f} s")
            raise
    code = tally.end(frames.left_out)
    tally.check()
    looks = tally.frames - tally.bad
    told = {"of": of, "perception": options.perception, "poses": stream.told, "looks": looks, "left_out": tally.bad}
    told |= {"boxes": dict(labels.most_common()), "out": str(options.out)}
    example = next(iter([*told["boxes"], *queries, *(views.classes or ())]))
    terminal.give(
        options.json, told,
        f"{labels.total()} boxes of {len(labels)} things in {terminal.many(looks, 'look')}: {options.out}",
        f"what there is:  eagor track {options.out}",
        f'where it is:    eagor track {options.out} "{example}"',
    )  # fmt: skip
    return code


def _views(options: Look, queries: list[str]) -> Detector:
    """The detector in its views. Raises `UsageError` for a perception that has none, or wants queries."""
    from eagor.perception.views import Detector

    views = checks.make_perception(options.perception, busy=True)
    if not isinstance(views, Detector):
        raise terminal.UsageError(
            f"--perception {options.perception} gives no boxes that can be kept for later questions; wanted a detector "
            "in views: coco, or onnx:MODEL.onnx. Any other answers one question at a time: eagor track"
        )
    if views.classes is None and not queries:
        raise terminal.UsageError(
            f"--perception {options.perception} takes any words, and sees only what it is asked for; say what to look "
            "for: --for chair sofa"
        )
    if views.classes is not None and queries:
        raise terminal.UsageError(
            f"--for {queries[0]}: {options.perception} sees all of its {len(views.classes)} classes at once; leave it "
            "out, and ask afterwards"
        )
    return views
