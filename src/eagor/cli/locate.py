"""``eagor locate``: one picture, one look, one answer: the loop with one frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from eagor.cli import answers, checks, terminal
from eagor.cli.frames import say_of_video
from eagor.cli.options import Answering, bare

if TYPE_CHECKING:
    from eagor.sources.panorama import Picture
    from eagor.tracking.estimate import Estimate


@dataclass(frozen=True, kw_only=True)
class Locate(Answering):
    """Find the direction of an object in one picture: a panorama, or one of an ordinary camera."""

    file: Annotated[str, Positional, arg(metavar="PICTURE")]
    """A panorama, an ordinary picture (--hfov, --camera), or a video; its centre is forward. Of a rig FRONT,BACK."""
    query: Annotated[str, Positional, arg(metavar="QUERY")]
    """What to look for, in words."""
    stamp: Annotated[float | None, bare("SECONDS")] = None
    """Time of the replay record to use (default: the first record for this query), or of a video's frame."""
    picture: Annotated[Path | None, bare("FILE.png")] = None
    """Draw the belief over the picture."""
    out: Annotated[Path | None, bare("FILE")] = None
    """Write the answer, one line, to FILE.csv or FILE.jsonl."""


def locate(options: Locate) -> int:
    """Run the command; returns its exit code."""
    import numpy as np

    from eagor.live.in_turn import ByFrame, Followed
    from eagor.live.loop import Loop
    from eagor.perception import rows_of
    from eagor.perception.replay import ReplayPerception
    from eagor.sources import Pose
    from eagor.sources.camera_sources import Footage
    from eagor.sources.odometry import GivenPoses

    query, floor = checks.checked_query(options.query), options.floor
    spec = checks.perception_for([query], options.perception)
    places = checks.places_of([options.file], options.rig is not None)
    checks.check_outputs(options, places, out="table")
    if floor is not None and floor >= 0:
        raise terminal.UsageError(
            f"--floor {floor:g}: the camera of locate is at height 0; wanted a floor below it, such as -1.3"
        )
    config = checks.tracker_config(spec, options)
    with answers.table(options.out) if options.out else nullcontext() as write:
        perception, stamp = checks.make_perception(spec, busy=True), options.stamp
        if isinstance(perception, ReplayPerception):  # a replay answers at its own times
            first = next((record.stamp for record in perception.records if record.answers(query)), 0.0)
            perception.looks(query, stamp := first if stamp is None else stamp)  # raises where it has none
        picture, stamp = _picture(options, places, rows_of(perception)), stamp or 0.0
        name, results = ", ".join(place.name for place in places), list[Followed]()
        turn = np.eye(3) if picture.level_R_body is None else picture.level_R_body
        poses = GivenPoses([Pose(stamp, turn, None if floor is None else np.zeros(3))])  # heights are from the camera
        source = Footage(lambda: iter([(stamp, name, lambda: picture)]))
        mask, sinks = checks.mask_of(options.mask), [ByFrame(results.append)]
        for _ in Loop(source, poses, perception, query, sinks=sinks, config=config, mask=mask):
            pass
        (result,) = results
        if result.problem is not None:
            raise terminal.RunError(result.problem)
        checks.warn_of_detector(options.detector, result.evidence)
        if options.picture is not None:
            answers.draw(result, options.picture, options.modes)
        found = {"query": options.query, "perception": spec, "frame": name}
        found |= result.estimate.as_dict(options.modes, answers.NEAR)
        if write is not None:
            write(found)
    checks.say_of_replay(perception, query, len(result.evidence))
    if options.json:  # with the source that the looks name (model, pixels, tokens, milliseconds), if any
        source = next((evidence.source for evidence in result.evidence if evidence.source is not None), None)
        found |= {} if source is None else {"source": dict(source)}
    return terminal.give(options.json, found, *_in_words(options, name, spec, result.estimate))


def _picture(options: Locate, places: Sequence[Path], rows: int) -> Picture:
    """The photograph, or the frame of a video at ``--stamp`` seconds."""
    from eagor.sources.camera_sources import LEAST_ROWS, FrameCheck, is_video
    from eagor.sources.panorama import Picture
    from eagor.sources.video import Video

    lens = checks.lens_of(options)
    rig = lens["rig"]
    check = FrameCheck(options.force, terminal.log, lens["camera"], rig)
    if not is_video(places, rig is not None):
        return check.read(*places)
    how = {"rig": rig, "camera": lens["camera"], "force": options.force}
    video = Video(*places, **how, start=options.stamp or 0.0, rows=max(rows, LEAST_ROWS))
    say_of_video(places[0].name, video)
    first = next(iter(video))
    found = Picture(first.picture, first.unseen, first.grid, video.level_R_body)
    return check.look(found, first.name, video.builder, video.hint)


def _in_words(options: Locate, name: str, spec: str, e: Estimate) -> list[str]:
    from eagor.drawing.style import answer_in_words, far_in_words, in_words, signed, status_in_words
    from eagor.perception import short_name

    facts = {
        "status": f"{e.status}: {status_in_words(e.status, e.presence)}",
        "direction": answer_in_words(e).removeprefix("direction "),
    }
    known, listed = e.direction is not None, []
    if known:
        several = e.status == "ambiguous" and len(e.modes) > 1
        why = "it reaches from one candidate to others" if several else "looks that agree narrow it"
        facts["azimuth"] = f"{signed(e.azimuth)} deg (positive to the left)"
        facts["elevation"] = f"{signed(e.elevation)} deg"
        cone = math.degrees(e.credible_angle)
        facts["credible angle"] = f"{cone:.1f} deg (a cone about it that holds 90 %; {why})"
    if options.floor is not None:
        facts["distance"] = f"{far_in_words(e) or '-'} (90 %, if it stands on the floor)"
    facts["presence"] = f"{100 * e.presence:.0f} %"
    if known:
        near = f"{100 * e.within(math.radians(answers.NEAR)):.0f} %"
        facts["how sure"] = f"{near} (that it is here, and within {answers.NEAR} degrees of that direction)"
        facts["candidates"] = "azimuth elevation  weight (probability that it is thereabouts, if it is here)"
        for mode in (shown := e.modes[: options.modes]):
            azimuth, elevation = signed(mode.azimuth), signed(mode.elevation)
            words = in_words(mode.azimuth, mode.elevation)
            listed.append(f"{'':18}{azimuth:>7} {elevation:>9}{100 * mode.weight:6.0f} %  {words}")
        rest = max(0.0, 1 - sum(mode.weight for mode in shown))
        listed.append(f"{'':35}{100 * rest:6.0f} %  elsewhere")
    head = f"{options.query}, in {name}, as {short_name(spec)} sees it"
    return [head, *(f"  {what:15} {text}" for what, text in facts.items()), *listed]
